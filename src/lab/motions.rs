//! The virtual rig without its serial line: settled samples and motions, read through its circuits,
//! the calibration and the filters. Everything is simulated.

use std::ops::ControlFlow;

use anyhow::Result;
use nalgebra::Vector3;
use rand::Rng as _;

use crate::drive::{model, rig_options};
use crate::rig::board::Readings;
use crate::rig::{PHYSICS_STEP_S, VirtualRig};
use crate::robot::RobotSpec;
use crate::signal::{BOARDS, CHAMBERS, Dataset, Pose, RawFrame, Sample, SensorFrame, Stamp};
use crate::sim::dataset::{Plan, normal, pressures, sample_rng};
use crate::sim::{Inputs, Model, State, observe, settle};

/// Frames read at each settled pose until one is kept: enough for the orientation filters to settle.
const FRAMES_PER_POSE: u32 = 200;

/// Settled samples of the virtual rig, read through its circuits, the calibration and the filters, and the number of
/// those without equilibrium, which are left out.
///
/// # Errors
/// When the rig or its sensors cannot be set up.
pub fn settled(
    robot: &RobotSpec,
    plan: &Plan,
    range: std::ops::Range<usize>,
    progress: &mut dyn FnMut(usize) -> ControlFlow<()>,
) -> Result<(Dataset, usize)> {
    let options = rig_options(0.0, plan.seed);
    let mut rig = VirtualRig::new(robot, &options)?;
    let mut sensing = model::sensing(robot, None)?;
    let mut data = Dataset {
        source: "virtual rig".to_owned(),
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
            frame = Some(sensing.update(&raw_frame(seq, rig.readings())));
        }
        let Some(frame) = frame else { continue };
        data.samples.push(Sample {
            chamber_pa,
            payload_kg: 0.0,
            tip_force_n: [0.0; 3],
            sensors: frame.sensors,
            base_from_tip: rig.mocap_pose(),
        });
        if progress(index + 1 - start).is_break() {
            break;
        }
    }
    Ok((data, left_out))
}

/// Both boards' readings as one frame, without the line in between.
fn raw_frame(seq: u32, readings: &[Readings; BOARDS]) -> RawFrame {
    let spring = |i: usize| readings[i / 6].springs[i % 6].unwrap_or_default();
    RawFrame {
        seq,
        stamp: Stamp::from_seconds(f64::from(seq) * PHYSICS_STEP_S),
        spring_counts: std::array::from_fn(|i| spring(i).count),
        spring_gate_ticks: std::array::from_fn(|i| spring(i).gate_ticks),
        tick_rate_hz: f64::from(crate::link::wire::TICK_RATE_HZ),
        imu: std::array::from_fn(|i| readings[i / 2].imus[i % 2].unwrap_or_default()),
        chamber_pa: std::array::from_fn(|i| readings[i / 3].chamber_pa[i % 3].unwrap_or(f64::NAN)),
        present: RawFrame::ALL_PRESENT,
        board_age_s: [0.0; BOARDS],
        faults: 0,
    }
}

/// Disturbance of a motion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Push {
    /// Nothing.
    None,
    /// A horizontal force at every stop, rising to this many newtons and back; only the frames under at
    /// least nine tenths of it are kept.
    Lateral(f64),
    /// Impacts of this many newtons for 0.1 s, about one every 2 s, in random directions.
    Shocks(f64),
}

/// A motion of the rig along straight lines in pressure space, each at a constant rate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motion {
    /// Mass in the gripper, kg.
    pub payload_kg: f64,
    /// Mean speed of the tip along each line, m/s.
    pub speed_m_s: f64,
    /// Its disturbance.
    pub push: Push,
    /// Least length, s; a motion with pushes or blows ends with a line.
    pub seconds: f64,
    /// Seed of the way and of all noise.
    pub seed: u64,
}

/// A frame with the true poses at its time.
#[derive(Clone)]
pub struct Moment {
    /// When, s from the start of the motion.
    pub t_s: f64,
    /// The sensors' frame.
    pub frame: SensorFrame,
    /// Top, middle and end pad as they were.
    pub base_from_pad: [Pose; 3],
}

/// Share of the pressure range that motions use.
const RANGE_SHARE: f64 = 0.8;
/// Interval of the frames that are kept, in frames.
const EVERY: u32 = 5;
/// Rest before a motion, so that filters and monitors settle, s.
const REST_S: f64 = 3.0;

/// Moves a rig and returns its sensor frames, at 20 frames per second. `spoil` may change what the
/// boards send, given the time.
///
/// # Errors
/// When the arm cannot hold its payload, or not follow its motion.
pub fn motion(
    robot: &RobotSpec,
    m: &Motion,
    spoil: &mut dyn FnMut(f64, &mut RawFrame),
) -> Result<Vec<Moment>> {
    let options = rig_options(m.payload_kg, m.seed);
    let mut rig = VirtualRig::new(robot, &options)?;
    let mut sensing = model::sensing(robot, None)?;
    let mut rng = sample_rng(m.seed, 0x7a7);
    let plan = Model::nominal(robot);
    let mut waypoint = || -> [f64; CHAMBERS] {
        let (lo, hi) = (robot.pressure.min_pa, robot.pressure.max_pa);
        let half = 0.5 * RANGE_SHARE * (hi - lo);
        std::array::from_fn(|_| 0.5 * (lo + hi) + half * rng.random_range(-1.0..=1.0))
    };
    let mut at_pa = waypoint();
    rig.settle_at(&at_pa)?;
    let mut seq = 0;
    let mut out = Vec::new();
    let mut blows = sample_rng(m.seed, 0xb10);
    let (mut blow_at_s, mut blow_n) = (REST_S + 1.0, [0.0; 3]);
    let mut tick = |rig: &mut VirtualRig, set_pa: &[f64; CHAMBERS], level_n: [f64; 3]| {
        seq += 1;
        let t_s = f64::from(seq) * PHYSICS_STEP_S;
        let mut force_n = level_n;
        if let Push::Shocks(size_n) = m.push {
            if t_s > blow_at_s + 0.1 {
                blow_at_s = t_s + blows.random_range(1.0..3.0);
                let way = Vector3::from_fn(|_, _| normal(&mut blows)).normalize();
                blow_n = (way * size_n).into();
            }
            if t_s >= blow_at_s {
                force_n = blow_n;
            }
        }
        rig.plant.surroundings.tip_force_n = force_n;
        rig.step(&set_pa.map(Some));
        let mut raw = raw_frame(seq, rig.readings());
        spoil(t_s - REST_S, &mut raw);
        let frame = sensing.update(&raw);
        let keep = match m.push {
            Push::Lateral(size_n) => Vector3::from(level_n).norm() >= 0.9 * size_n,
            Push::None | Push::Shocks(_) => t_s > REST_S,
        };
        if keep && seq % EVERY == 0 {
            out.push(Moment {
                t_s: t_s - REST_S,
                frame,
                base_from_pad: rig.plant.observation().shape.base_from_pad,
            });
        }
        t_s
    };
    let mut now_s = 0.0;
    while now_s < REST_S {
        now_s = tick(&mut rig, &at_pa, [0.0; 3]);
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
            now_s = tick(&mut rig, &set_pa, [0.0; 3]);
            if now_s >= end_s && m.push == Push::None {
                break;
            }
        }
        at_pa = to_pa;
        if let Push::Lateral(size_n) = m.push {
            let heading = push_rng.random_range(0.0..std::f64::consts::TAU);
            for k in 0..400 {
                // Two seconds to swell, one to stay, one to go.
                let share = (f64::from(k) / 200.0)
                    .min(1.0)
                    .min(f64::from(400 - k) / 100.0);
                let (sin, cos) = heading.sin_cos();
                let force_n = [size_n * share * cos, size_n * share * sin, 0.0];
                now_s = tick(&mut rig, &at_pa, force_n);
            }
        }
    }
    anyhow::ensure!(
        rig.refused_steps == 0,
        "the arm could not follow {} steps of a motion: load or push it less",
        rig.refused_steps
    );
    Ok(out)
}

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
