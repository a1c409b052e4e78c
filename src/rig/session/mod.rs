//! Sessions of the virtual rig, made offline: a log of an hour at the bench, in a
//! second or two of computing, with anything of [`super::hidden`] hidden in it.
//!
//! The rig of a session hangs on a regulated supply (40 kPa/s), not on the pumps of the live rig:
//! these would need most of 90 s for a single stroke. Its arm has other elements than the twin's
//! model, free shear, hardening, a little friction, viscous rubber, and scatter that belongs to the
//! specimen; its sensors have offsets, noise and resolution. All of it is simulated.

mod arm;
pub mod excitation;
mod plan;
mod readings;
mod supply;
#[cfg(test)]
mod tests;

use rand::Rng as _;

use super::hidden::Defects;
use crate::robot::RobotSpec;
use crate::sim::dataset::{normal, sample_rng};
use arm::Arm;
pub use excitation::{Drive, Excitation};
pub use plan::{Fineness, Noise, Session, SessionError, SessionPlan};
use supply::Supply;

/// Step of the gas, s.
const GAS_STEP_S: f64 = 0.0025;
/// Longest step of the arm, s: its memory forces are one step behind.
const ARM_STEP_S: f64 = 0.02;
/// Fastest rate of a healthy supply, Pa/s.
const FLOW_PA_S: f64 = 40e3;

/// The log of a session.
///
/// # Errors
/// [`SessionError`] when the plan makes no sense or the arm cannot hold what acts on it.
pub fn session(robot: &RobotSpec, plan: &SessionPlan) -> Result<Session, SessionError> {
    generate(robot, plan, Noise::On, Fineness::Full)
}

/// A session with or without noise, fine or as a draft; the same plan makes the same motion.
///
/// # Errors
/// As [`session`].
pub fn generate(
    robot: &RobotSpec,
    plan: &SessionPlan,
    noise: Noise,
    fineness: Fineness,
) -> Result<Session, SessionError> {
    let sound = (1.0..=3600.0).contains(&plan.seconds)
        && (5.0..=400.0).contains(&plan.rate_hz)
        && (0.0..=5.0).contains(&plan.payload_kg);
    if !sound {
        return Err(SessionError::Plan {
            seconds: plan.seconds,
            rate_hz: plan.rate_hz,
            payload_kg: plan.payload_kg,
        });
    }
    let mut defects = Defects::of(&plan.hidden);
    for rate in defects.flow_pa_s.as_flattened_mut() {
        *rate = rate.min(FLOW_PA_S);
    }
    let d = &defects;
    let drive = Drive::new(plan.excitation, plan.seed, plan.seconds);
    let dt_s = 1.0 / plan.rate_hz;
    let n = (plan.seconds * plan.rate_hz).round() as usize;
    let watched = n + (readings::capture_margin_s(d, plan.seconds) * plan.rate_hz).ceil() as usize;

    let failed = |t_s: f64| move |reason| SessionError::Arm { t_s, reason };
    let mut arm =
        Arm::new(robot, plan.specimen, plan.payload_kg, d, fineness).map_err(failed(0.0))?;
    let mut supply = Supply::new(supply::Fittings::new(plan.specimen), d, plan.seed);
    let mut gauge_rng = sample_rng(plan.seed, 0x6a06);
    let arm_steps = (dt_s / ARM_STEP_S - 1e-9).ceil().max(1.0) as usize;
    let arm_s = dt_s / arm_steps as f64;
    let gas_steps = (arm_s / GAS_STEP_S - 1e-9).ceil().max(1.0) as usize;
    let gas_s = arm_s / gas_steps as f64;
    let mut motion = Vec::with_capacity(watched);
    let mut activity_pa_s = Vec::with_capacity(watched);
    let mut out = Session {
        name: plan.name.clone(),
        rate_hz: plan.rate_hz,
        payload_kg: plan.payload_kg,
        t_s: Vec::with_capacity(n),
        commanded_pa: Vec::with_capacity(n),
        chamber_pa: Vec::with_capacity(n),
        sensors: Vec::new(),
        captured: Vec::new(),
    };
    for k in 0..watched {
        let t_s = k as f64 * dt_s;
        let steps = if k > 0 { arm_steps } else { 0 };
        for step in 0..steps {
            let from_s = t_s - dt_s + step as f64 * arm_s;
            for j in 0..gas_steps {
                let at_s = from_s + j as f64 * gas_s;
                supply.step(at_s, &drive.at(at_s), gas_s);
            }
            arm.step(from_s + arm_s, &supply.chamber_pa(), arm_s)
                .map_err(failed(t_s))?;
        }
        motion.push(arm.moment());
        activity_pa_s.push(supply.activity_pa_s());
        if k < n {
            out.t_s.push(t_s);
            out.commanded_pa.push(drive.at(t_s));
            let read = supply.gauge_pa().map(|p| match noise {
                Noise::On => {
                    let noisy = p + supply::GAUGE_NOISE_PA * normal(&mut gauge_rng);
                    (noisy / supply::GAUGE_STEP_PA).round() * supply::GAUGE_STEP_PA
                }
                Noise::Off => p,
            });
            out.chamber_pa.push(read);
        }
    }
    let fittings = readings::Fittings::new(plan.specimen);
    let seen = readings::Seen {
        robot,
        fittings: &fittings,
        defects: d,
        motion: &motion,
        activity_pa_s: &activity_pa_s,
        n,
        dt_s,
        seed: plan.seed,
        noise,
    };
    out.sensors = readings::sensors(&seen);
    out.captured = readings::capture(&seen);
    Ok(out)
}

/// A seed for one purpose out of another one.
pub(super) fn sub_seed(seed: u64, purpose: usize) -> u64 {
    sample_rng(seed, purpose).random()
}
