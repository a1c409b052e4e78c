//! The virtual rig without its serial line: settled samples and motions, read through its circuits,
//! the calibration and the filters. Everything is simulated.

use std::ops::ControlFlow;

use anyhow::Result;
use nalgebra::Vector3;
use rand::Rng as _;

use super::frames::raw_frame;
use crate::drive::rig_options;
use crate::rig::hidden::Hidden;
use crate::rig::inertial::InertialErrors;
use crate::rig::multibody::arm::RINGS;
use crate::rig::{PHYSICS_STEP_S, RigOptions, Unit, VirtualRig};
use crate::robot::RobotSpec;
use crate::sensing::Calibration;
use crate::signal::{CHAMBERS, Dataset, Pose, RawFrame, Sample, SensorFrame};
use crate::sim::dataset::{Plan, normal, pressures, sample_rng};
use crate::sim::{Inputs, Model, State, observe, settle};
use crate::twin::sensing_for;

/// Frames read at each settled pose until one is kept: enough for the orientation filters to settle.
const FRAMES_PER_POSE: u32 = 200;

/// Settled samples of a unit of the virtual rig, read through its circuits, a calibration and the
/// filters, and the number of those without equilibrium, which are left out.
///
/// # Errors
/// When the rig or its sensors cannot be set up.
pub fn settled(
    robot: &RobotSpec,
    (unit, calibration): (Unit, &Calibration),
    plan: &Plan,
    range: std::ops::Range<usize>,
    progress: &mut dyn FnMut(usize) -> ControlFlow<()>,
) -> Result<(Dataset, usize)> {
    let options = RigOptions {
        unit,
        ..rig_options(0.0, plan.seed)
    };
    let mut rig = VirtualRig::new(robot, &options)?;
    let mut sensing = sensing_for(robot, calibration);
    let mut data = Dataset {
        source: format!("virtual rig, unit {}", unit.0),
        seed: plan.seed,
        robot_hash: robot.hash.clone(),
        ..Dataset::default()
    };
    let (mut left_out, mut seq) = (0, 0);
    let start = range.start;
    for index in range {
        let mut rng = sample_rng(plan.seed, index);
        let chamber_pa = pressures(plan.draw, robot, index, &mut rng);
        if rig.settle_at(&chamber_pa).is_err() {
            left_out += 1;
            continue;
        }
        sensing.reset();
        let mut frame = None;
        for _ in 0..FRAMES_PER_POSE {
            seq += 1;
            rig.dwell();
            frame = Some(sensing.update(&raw_frame(seq, &rig)));
        }
        let Some(frame) = frame else { continue };
        data.samples.push(Sample {
            chamber_pa,
            payload_kg: 0.0,
            tip_force_n: [0.0; 3],
            off_nominal: false,
            sensors: frame.sensors,
            base_from_tip: rig.mocap_pose(),
        });
        if progress(index + 1 - start).is_break() {
            break;
        }
    }
    Ok((data, left_out))
}

/// Disturbance of a motion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Push {
    /// Nothing.
    None,
    /// A rest of 4 s at every stop; only the frames of its last 2 s are kept.
    Rests,
    /// A horizontal force at every stop, rising to this many newtons and back; only the frames under at
    /// least nine tenths of it are kept.
    Lateral(f64),
    /// Impacts of this many newtons for 0.1 s, about one every 2 s, in random directions.
    Shocks(f64),
    /// One such impact at every stop; only the frames of the first second after it are kept.
    Ringing(f64),
}

/// A motion of a unit along straight lines in pressure space, each at a constant rate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motion {
    /// The unit.
    pub unit: Unit,
    /// Mass in the gripper, kg.
    pub payload_kg: f64,
    /// Mean speed of the tip along each line, m/s.
    pub speed_m_s: f64,
    /// Share of the pressure range that is used.
    pub range_share: f64,
    /// Its disturbance.
    pub push: Push,
    /// Least length, s; a motion that does something at its stops, or with blows, ends with a line.
    pub seconds: f64,
    /// Seed of the way and of all noise.
    pub seed: u64,
}

/// Fastest the paper moves, m/s.
pub const FAST_M_S: f64 = 5e-3;

impl Motion {
    /// A motion of a unit without load or disturbance, as fast as the paper's fastest.
    pub fn of(unit: Unit, seconds: f64, seed: u64) -> Self {
        Self {
            unit,
            payload_kg: 0.0,
            speed_m_s: FAST_M_S,
            range_share: 0.8,
            push: Push::None,
            seconds,
            seed,
        }
    }
}

/// A frame with the true poses at its time.
#[derive(Clone)]
pub struct Moment {
    /// When, s from the start of the motion.
    pub t_s: f64,
    /// The sensors' frame.
    pub frame: SensorFrame,
    /// Top, middle and end pad as they were, base from pad.
    pub base_from_pad: [Pose; 3],
}

/// Simulated time of a motion with these moments, s.
pub fn simulated_s(moments: &[Moment]) -> f64 {
    moments.last().map_or(0.0, |m| m.t_s + REST_S)
}

/// Interval of the frames that are kept, in frames.
const EVERY: u32 = 5;
/// Rest before a motion, so that filters and monitors settle, s.
const REST_S: f64 = 3.0;

/// Moves a unit and returns its sensor frames by its calibration, at 20 frames per second. `spoil` may change what the
/// boards send, given the time.
///
/// # Errors
/// When the arm cannot hold its payload, or not follow its motion.
pub fn motion(
    robot: &RobotSpec,
    calibration: &Calibration,
    m: &Motion,
    spoil: &mut dyn FnMut(f64, &mut RawFrame),
) -> Result<Vec<Moment>> {
    let mut sensing = sensing_for(robot, calibration);
    let mut out = Vec::new();
    drive(robot, m, &Arm::default(), &mut |rig, t_s, mut raw, keep| {
        spoil(t_s, &mut raw);
        let frame = sensing.update(&raw);
        if keep && raw.seq % EVERY == 0 {
            out.push(Moment {
                t_s,
                frame,
                base_from_pad: rig.plant.truth().base_from_pad,
            });
        }
    })?;
    Ok(out)
}

/// Moves a unit and returns what a lab logs of it, so many rows per second: gauges, sensors and motion capture.
///
/// # Errors
/// As [`motion`].
pub fn session(
    robot: &RobotSpec,
    calibration: &Calibration,
    m: &Motion,
    rows_1_s: f64,
) -> Result<Vec<Sample>> {
    let mut sensing = sensing_for(robot, calibration);
    let every = (1.0 / (rows_1_s * PHYSICS_STEP_S)).round().max(1.0) as u32;
    let mut out = Vec::new();
    drive(robot, m, &Arm::default(), &mut |rig, _, raw, keep| {
        let frame = sensing.update(&raw);
        if keep && raw.seq % every == 0 && !frame.is_blind() {
            out.push(Sample {
                chamber_pa: raw.chamber_pa,
                payload_kg: m.payload_kg,
                tip_force_n: [0.0; 3],
                off_nominal: !matches!(m.push, Push::None | Push::Rests),
                sensors: frame.sensors,
                base_from_tip: rig.mocap_pose(),
            });
        }
    })?;
    Ok(out)
}

/// One frame of the boards with motion capture and the truth at its time.
#[derive(Clone)]
pub struct Raw {
    /// As the boards send it.
    pub frame: RawFrame,
    /// The end pad by motion capture, base from tip.
    pub seen: Pose,
    /// Top, middle and end pad as they were, base from pad.
    pub base_from_pad: [Pose; 3],
}

/// Moves a unit and returns what its boards and motion capture deliver, at 100 frames per second.
///
/// # Errors
/// As [`motion`].
pub fn raw(robot: &RobotSpec, m: &Motion) -> Result<Vec<Raw>> {
    let mut out = Vec::new();
    drive(robot, m, &Arm::default(), &mut |rig, _, frame, keep| {
        if keep {
            out.push(Raw {
                frame,
                seen: rig.mocap_pose(),
                base_from_pad: rig.plant.truth().base_from_pad,
            });
        }
    })?;
    Ok(out)
}

/// Takes the rig, the time from the start of the motion (s), a frame, and whether the frame is one to be kept.
type Each<'a> = dyn FnMut(&mut VirtualRig, f64, RawFrame, bool) + 'a;

/// A frame as the boards send it, with the true poses at its time.
#[derive(Clone)]
pub struct Sent {
    /// When, s from the start of the motion; negative during the rest before it.
    pub t_s: f64,
    /// The frame.
    pub raw: RawFrame,
    /// Whether it belongs to what the motion's disturbance is about (see [`Push`]).
    pub is_scored: bool,
    /// Top, middle and end pad as they were, base from pad.
    pub base_from_pad: [Pose; 3],
}

/// Arm of a motion.
#[derive(Clone, Debug)]
pub struct Arm {
    /// Rings per segment.
    pub rings: usize,
    /// Errors of the IMUs.
    pub inertial: InertialErrors,
    /// What is hidden.
    pub hidden: Vec<Hidden>,
}

impl Default for Arm {
    fn default() -> Self {
        Self::of_rings(RINGS)
    }
}

impl Arm {
    /// An arm with so many rings per segment and usual IMUs.
    pub fn of_rings(rings: usize) -> Self {
        Self {
            rings,
            inertial: InertialErrors::default(),
            hidden: Vec::new(),
        }
    }

    /// Options of a rig that carries out `m`.
    pub fn options(&self, m: &Motion) -> RigOptions {
        RigOptions {
            unit: m.unit,
            inertial: self.inertial.clone(),
            hidden: self.hidden.clone(),
            ..rig_options(m.payload_kg, m.seed)
        }
    }
}

/// Moves a unit and hands over every frame that its boards send.
///
/// # Errors
/// As [`motion`].
pub fn each_sent(
    robot: &RobotSpec,
    m: &Motion,
    arm: &Arm,
    each: &mut dyn FnMut(Sent),
) -> Result<()> {
    drive(robot, m, arm, &mut |rig, t_s, raw, is_scored| {
        each(Sent {
            t_s,
            raw,
            is_scored,
            base_from_pad: rig.plant.truth().base_from_pad,
        });
    })
}

/// Moves a rig and hands over every frame.
fn drive(robot: &RobotSpec, m: &Motion, arm: &Arm, each: &mut Each<'_>) -> Result<()> {
    let mut rig = VirtualRig::of_rings(robot, &arm.options(m), arm.rings)?;
    let mut rng = sample_rng(m.seed, 0x7a7);
    let plan = Model::nominal(robot);
    let mut waypoint = || -> [f64; CHAMBERS] {
        let (lo, hi) = (robot.pressure.min_pa, robot.pressure.max_pa);
        let half = 0.5 * m.range_share * (hi - lo);
        std::array::from_fn(|_| 0.5 * (lo + hi) + half * rng.random_range(-1.0..=1.0))
    };
    let mut at_pa = waypoint();
    rig.settle_at(&at_pa)?;
    let mut seq = 0;
    let mut blows = sample_rng(m.seed, 0xb10);
    let mut direction = move || Vector3::from_fn(|_, _| normal(&mut blows)).normalize();
    let mut pauses = sample_rng(m.seed, 0xb11);
    let (mut blow_at_s, mut blow_n) = (REST_S + 1.0, [0.0; 3]);
    let mut tick = |rig: &mut VirtualRig, set_pa: &[f64; CHAMBERS], force_n: [f64; 3], keep| {
        seq += 1;
        rig.plant.surroundings.tip_force_n = force_n;
        rig.step(&set_pa.map(Some));
        let t_s = f64::from(seq) * PHYSICS_STEP_S;
        let raw = raw_frame(seq, rig);
        each(rig, t_s - REST_S, raw, keep && t_s > REST_S);
        t_s
    };
    let mut now_s = 0.0;
    while now_s < REST_S {
        now_s = tick(&mut rig, &at_pa, [0.0; 3], false);
    }
    let end_s = REST_S + m.seconds;
    let mut push_rng = sample_rng(m.seed, 0x90);
    let mut tries = 0;
    while now_s < end_s {
        let to_pa = waypoint();
        let Some(length_m) = way_length_m(&plan, m.payload_kg, &at_pa, &to_pa) else {
            tries += 1;
            anyhow::ensure!(
                tries < 100,
                "the arm can carry its load nowhere near its range"
            );
            continue;
        };
        let steps = (length_m / (m.speed_m_s * PHYSICS_STEP_S)).ceil().max(1.0) as usize;
        for k in 1..=steps {
            let share = k as f64 / steps as f64;
            let set_pa = std::array::from_fn(|i| at_pa[i] + share * (to_pa[i] - at_pa[i]));
            let mut force_n = [0.0; 3];
            if let Push::Shocks(size_n) = m.push {
                if now_s > blow_at_s + BLOW_S {
                    blow_at_s = now_s + pauses.random_range(1.0..3.0);
                    blow_n = (direction() * size_n).into();
                }
                if now_s >= blow_at_s {
                    force_n = blow_n;
                }
            }
            let keep = matches!(m.push, Push::None | Push::Shocks(_));
            now_s = tick(&mut rig, &set_pa, force_n, keep);
            if now_s >= end_s && m.push == Push::None {
                break;
            }
        }
        at_pa = to_pa;
        let heading = push_rng.random_range(0.0..std::f64::consts::TAU);
        let blow = direction();
        for k in 0..AT_STOP {
            let (force_n, keep) = match m.push {
                Push::None | Push::Shocks(_) => break,
                Push::Rests => ([0.0; 3], k >= AT_STOP / 2),
                Push::Lateral(size_n) => {
                    // Two seconds to swell, one to stay, one to go.
                    let share = (f64::from(k) / 200.0)
                        .min(1.0)
                        .min(f64::from(AT_STOP - k) / 100.0);
                    let (sin, cos) = heading.sin_cos();
                    ([cos, sin, 0.0].map(|c| c * size_n * share), share >= 0.9)
                }
                Push::Ringing(size_n) => {
                    let since_s = f64::from(k) * PHYSICS_STEP_S - 2.0;
                    let force_n = match (0.0..BLOW_S).contains(&since_s) {
                        true => (blow * size_n).into(),
                        false => [0.0; 3],
                    };
                    (force_n, (BLOW_S..BLOW_S + 1.0).contains(&since_s))
                }
            };
            now_s = tick(&mut rig, &at_pa, force_n, keep);
        }
    }
    anyhow::ensure!(
        rig.refused_steps == 0,
        "the arm could not follow {} steps of a motion: load or push it less",
        rig.refused_steps
    );
    Ok(())
}

/// Length of a blow, s.
const BLOW_S: f64 = 0.1;
/// Frames at a stop of a motion that does something there.
const AT_STOP: u32 = 400;

/// Length of the tip's way by the twin's own model, m; `None` where it finds no equilibrium.
fn way_length_m(
    plan: &Model,
    payload_kg: f64,
    from_pa: &[f64; CHAMBERS],
    to_pa: &[f64; CHAMBERS],
) -> Option<f64> {
    const POINTS: usize = 12;
    let mut state = State::rest(plan);
    let mut last: Option<Vector3<f64>> = None;
    let mut length_m = 0.0;
    for k in 0..=POINTS {
        let share = k as f64 / POINTS as f64;
        let inputs = Inputs {
            chamber_pa: std::array::from_fn(|i| from_pa[i] + share * (to_pa[i] - from_pa[i])),
            payload_kg,
            ..Inputs::default()
        };
        settle(plan, &mut state, &inputs).ok()?;
        let tip = observe(plan, &state).base_from_tip.translation.vector;
        length_m += last.map_or(0.0, |l| (tip - l).norm());
        last = Some(tip);
    }
    Some(length_m)
}
