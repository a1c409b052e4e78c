//! A trajectory through the arm with effects at work.
//!
//! The arm is settled (or, with damping, moved on) at every instant. Forces that depend on its
//! motion, friction F, viscoelastic branches B and the floor, are found together with it by a
//! relaxed fixed-point iteration; their memory moves on once per instant:
//!
//! F_k = clamp(F_{k−1} + (F_max/w) Δx, ±F_max),   B_k = a B_{k−1} + c (τ/Δt)(1 − a) Δx,  a = e^{−Δt/τ}

use nalgebra::Vector3;

use super::{Active, Call, EffectError, Line, Operator, Plant, Simulated, Trajectory};
use crate::signal::CHAMBERS;
use crate::sim::rod::PointMass;
use crate::sim::{Inputs, Model, Observation, SimError, State, creep_to, observe, settle};

/// Runs a trajectory. Effects act in the order of the table, whatever the order of `effects`.
///
/// # Errors
/// [`EffectError`] when the trajectory is empty or uneven, or the arm finds no equilibrium.
pub fn simulate(
    model: &Model,
    trajectory: &Trajectory,
    payload_kg: f64,
    effects: &[Active],
) -> Result<Simulated, EffectError> {
    let t_s = &trajectory.t_s;
    let rising = t_s.windows(2).all(|w| w[1] > w[0]);
    if t_s.is_empty() || t_s.len() != trajectory.chamber_pa.len() || !rising {
        return Err(EffectError::Trajectory {
            times: t_s.len(),
            pressures: trajectory.chamber_pa.len(),
        });
    }
    let place = |a: &&Active| super::EFFECTS.iter().position(|e| e.id == a.effect.id);
    let mut ordered: Vec<&Active> = effects.iter().collect();
    ordered.sort_by_key(place);
    let call = |a| call(model, t_s, a);
    let mut line = Line {
        chamber_pa: trajectory.chamber_pa.clone(),
        gauge_pa: trajectory.chamber_pa.clone(),
    };
    let mut plant = Plant::new(model, payload_kg);
    for a in &ordered {
        match a.effect.operator {
            Operator::Pressure(f) => f(&call(a), &mut line),
            Operator::Mechanics(f) => f(&call(a), &mut plant),
            Operator::Sensors(_) | Operator::Capture(_) => {}
        }
    }
    let mut out = plant.run(t_s, line)?;
    for a in &ordered {
        match a.effect.operator {
            Operator::Sensors(f) => f(&call(a), &mut out.sensors),
            Operator::Capture(f) => f(&call(a), &mut out.captured),
            Operator::Pressure(_) | Operator::Mechanics(_) => {}
        }
    }
    Ok(out)
}

fn call<'a>(model: &'a Model, t_s: &'a [f64], a: &'a Active) -> Call<'a> {
    Call {
        robot: &model.robot,
        t_s,
        target: a.target,
        values: &a.values,
    }
}

/// What the arm remembers from the instant before.
struct Memory {
    bellows_m: [f64; CHAMBERS],
    friction_n: [f64; CHAMBERS],
    branch_n: [f64; CHAMBERS],
    t_s: f64,
}

/// Forces that depend on the motion.
#[derive(Clone, Copy)]
struct Reaction {
    friction_n: [f64; CHAMBERS],
    branch_n: [f64; CHAMBERS],
    floor_n: f64,
}

impl Reaction {
    fn zero() -> Self {
        Self {
            friction_n: [0.0; CHAMBERS],
            branch_n: [0.0; CHAMBERS],
            floor_n: 0.0,
        }
    }

    /// `self + share (other − self)`.
    fn towards(&self, other: &Self, share: f64) -> Self {
        let mix = |a: f64, b: f64| a + share * (b - a);
        Self {
            friction_n: std::array::from_fn(|i| mix(self.friction_n[i], other.friction_n[i])),
            branch_n: std::array::from_fn(|i| mix(self.branch_n[i], other.branch_n[i])),
            floor_n: mix(self.floor_n, other.floor_n),
        }
    }

    fn distance(&self, other: &Self) -> f64 {
        (0..CHAMBERS)
            .map(|i| {
                let f = self.friction_n[i] - other.friction_n[i];
                let b = self.branch_n[i] - other.branch_n[i];
                f.abs().max(b.abs())
            })
            .fold((self.floor_n - other.floor_n).abs(), f64::max)
    }
}

/// A change of force below this ends the iteration, N.
const FORCE_TOLERANCE_N: f64 = 1e-4;
const MAX_FORCE_ITERATIONS: usize = 80;

impl Plant {
    fn new(model: &Model, payload_kg: f64) -> Self {
        Self {
            model: model.clone(),
            payload_kg,
            payload_m: Vector3::new(0.0, 0.0, -model.robot.payload_com_m),
            tip_force_n: Vector3::zeros(),
            tau_s: 0.0,
            friction: [[0.0, 1.0]; CHAMBERS],
            branch: [[0.0, 1.0]; CHAMBERS],
            floor: None,
        }
    }

    fn run(mut self, t_s: &[f64], line: Line) -> Result<Simulated, SimError> {
        if let Some(end) = self.model.rod.sections.last_mut() {
            end.masses.push(PointMass {
                at_m: self.payload_m,
                kg: self.payload_kg,
            });
        }
        let mut state = State::rest(&self.model);
        let mut memory: Option<Memory> = None;
        let mut reaction = Reaction::zero();
        let mut out = Simulated::default();
        for (t, chamber_pa) in t_s.iter().zip(&line.chamber_pa) {
            let (o, found) =
                self.instant(&mut state, *t, chamber_pa, memory.as_ref(), &reaction)?;
            reaction = found;
            memory = Some(Memory {
                bellows_m: o.bellows_m,
                friction_n: reaction.friction_n,
                branch_n: reaction.branch_n,
                t_s: *t,
            });
            let pads = o.shape.base_from_pad;
            out.sensors.push(o.sensors);
            out.base_from_pad.push(pads);
            out.captured.push([pads[1], pads[2]]);
        }
        out.chamber_pa = line.chamber_pa;
        out.gauge_pa = line.gauge_pa;
        Ok(out)
    }

    /// The arm and its reactions at one instant, found together.
    fn instant(
        &self,
        state: &mut State,
        t_s: f64,
        chamber_pa: &[f64; CHAMBERS],
        memory: Option<&Memory>,
        guess: &Reaction,
    ) -> Result<(Observation, Reaction), SimError> {
        let before = state.strains.clone();
        let mut reaction = *guess;
        let mut share = 0.5;
        let mut off_before = f64::INFINITY;
        for _ in 0..MAX_FORCE_ITERATIONS {
            let mut tip_force_n = self.tip_force_n;
            tip_force_n.z += reaction.floor_n;
            let inputs = Inputs {
                chamber_pa: *chamber_pa,
                tension_n: std::array::from_fn(|i| reaction.friction_n[i] + reaction.branch_n[i]),
                payload_kg: 0.0,
                tip_force_n: tip_force_n.into(),
            };
            match memory {
                Some(m) if self.tau_s > 0.0 => {
                    state.strains.clone_from(&before);
                    creep_to(&self.model, state, &inputs, self.tau_s, t_s - m.t_s)?;
                }
                _ => {
                    settle(&self.model, state, &inputs)?;
                }
            }
            let o = observe(&self.model, state);
            let wanted = self.reaction(&o, t_s, memory);
            let off = wanted.distance(&reaction);
            if off < FORCE_TOLERANCE_N {
                return Ok((o, reaction));
            }
            if off > off_before {
                share *= 0.5;
            }
            off_before = off;
            reaction = reaction.towards(&wanted, share);
        }
        Err(SimError::NoEquilibrium {
            iterations: MAX_FORCE_ITERATIONS,
            last_step: off_before,
        })
    }

    /// The reactions at a state.
    fn reaction(&self, o: &Observation, t_s: f64, memory: Option<&Memory>) -> Reaction {
        let mut out = Reaction::zero();
        if let Some([height_m, rate_n_m]) = self.floor {
            // N = k max(0, z_floor − z)
            let depth_m = height_m - o.base_from_tip.translation.vector.z;
            out.floor_n = rate_n_m * depth_m.max(0.0);
        }
        let Some(m) = memory else { return out };
        let dt_s = t_s - m.t_s;
        for i in 0..CHAMBERS {
            let dx_m = o.bellows_m[i] - m.bellows_m[i];
            let [most_n, width_m] = self.friction[i];
            out.friction_n[i] = (m.friction_n[i] + most_n / width_m * dx_m).clamp(-most_n, most_n);
            let [rate_n_m, tau_s] = self.branch[i];
            let decay = (-dt_s / tau_s).exp();
            out.branch_n[i] =
                decay * m.branch_n[i] + rate_n_m * (tau_s / dt_s) * (1.0 - decay) * dx_m;
        }
        out
    }
}
