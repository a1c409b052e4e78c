//! A twin on a rig carries out a plan, and everything that happens is kept.

use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, OnceLock};
use std::time::{Duration, Instant};

use anyhow::Result;

use super::model;
use super::ports::{self, Instruments, Script, board_config};
use super::start::{HELLO_S, Start, check_link};
use crate::control::{Gains, SEGMENTS};
use crate::learn::PlantMap;
use crate::rig::{Object, RigOptions, VirtualRig};
use crate::robot::RobotSpec;
use crate::signal::{
    CHAMBERS, Goal, LinkStatus, Mode, Pose, PressureCommand, SensorRef, Snapshot, Stamp,
};
use crate::task::Plan;
use crate::twin::{
    Clock, Command, Event, Pace, Port, Runner, TICK_S, Twin, run_in_real_time,
    run_in_simulated_time,
};

/// What is to be driven where.
pub struct Drive<'a> {
    /// The robot.
    pub robot: &'a RobotSpec,
    /// The file it came from, if any.
    pub robot_file: Option<&'a Path>,
    /// `sim`, `pty`, or a serial port.
    pub rig: &'a str,
    /// The virtual rig.
    pub options: RigOptions,
    /// What the twin is told to be in the gripper at the start, kg.
    pub declared_kg: f64,
    /// The controller and its tuning.
    pub gains: Gains,
    /// What to do.
    pub plan: Plan,
    /// Longest time, s.
    pub seconds: f64,
    /// How long to go on once the plan is carried out, s.
    pub after_s: f64,
    /// What happens to the rig meanwhile (`sim` only).
    pub script: Option<Script>,
    /// Where to record.
    pub record: Option<PathBuf>,
    /// Whether boards that are SAFE from before may leave it.
    pub reset: bool,
    /// Its calibration, and motion capture of a rig behind serial ports.
    pub instruments: Instruments,
}

/// What was so at one tick on the way.
#[derive(Clone, Debug)]
pub struct Row {
    /// Since the start of the program, s.
    pub t_s: f64,
    /// Legs done.
    pub legs_done: usize,
    /// Index of the waypoint travelled to.
    pub waypoint: Option<usize>,
    /// Where the tip shall be now.
    pub goal: Option<Goal>,
    /// The point that moves along a path, m.
    pub via_m: Option<[f64; 3]>,
    /// Where the tip truly is: exactly for a rig in this process, else by motion capture while it sees the tip.
    pub truth: Option<Pose>,
    /// Where the twin believes it to be.
    pub estimate: Option<Pose>,
    /// Set pressures, Pa.
    pub set_pa: Option<[f64; CHAMBERS]>,
    /// Measured pressures, Pa.
    pub chamber_pa: [f64; CHAMBERS],
    /// Measured signals.
    pub sensors: SensorRef,
    /// Reference signals.
    pub sensor_ref: Option<SensorRef>,
    /// Time the controller took, s.
    pub solve_s: Option<f64>,
    /// Whether the arm is steered.
    pub steered: bool,
}

/// How a drive went.
pub struct Driven {
    /// From the moment the plan was given, one per tick.
    pub rows: Vec<Row>,
    /// In order, with the plan's own.
    pub events: Vec<Event>,
    /// Ticks run and missed.
    pub pace: Pace,
    /// Frames received and lost.
    pub frames: [u64; 2],
    /// When the plan was carried out, s after it was given.
    pub finished_s: Option<f64>,
    /// Why it was refused or stopped.
    pub refused: Option<String>,
    /// Why the arm went SAFE.
    pub safe: Option<String>,
    /// Whether the rig is simulated.
    pub simulated: bool,
    /// What lay about, where it is at the end; `None` where nobody can tell.
    pub objects: Option<Vec<Object>>,
    /// Payload declared at the start, kg.
    pub declared_kg: f64,
    /// The twin's plant.
    pub plant: Arc<dyn PlantMap>,
    /// What the controller has learned of the arm's stiffness.
    pub plant_gains: Option<[f64; SEGMENTS]>,
}

/// What the script of a rig in this process sees.
#[derive(Clone, Debug, Default)]
struct Nature {
    base_from_tip: Option<Pose>,
    objects: Vec<Object>,
    broken: Option<String>,
}

/// Time since the first call: the stopwatch that is handed to the controller.
#[expect(
    clippy::disallowed_methods,
    reason = "a stopwatch that is handed to the controller and decides nothing"
)]
pub fn stopwatch() -> Duration {
    static START: OnceLock<Instant> = OnceLock::new();
    START.get_or_init(Instant::now).elapsed()
}

/// Carries out the plan. A pressure command beyond range or rate is an error, whoever made it.
///
/// # Errors
/// When the twin cannot be put on the rig, the boards do not get ready, or a limit is violated.
pub fn drive(d: Drive<'_>) -> Result<Driven> {
    let robot = d.robot;
    let maps = model::maps_for(robot)?;
    let plant = Arc::clone(&maps.plant);
    let sensing = model::sensing(robot, d.instruments.calibration.as_deref())?;
    let mut twin = Twin::new(robot, maps, sensing, d.gains);
    twin.time_with(stopwatch);
    d.instruments.brief(&mut twin);
    #[expect(
        clippy::disallowed_methods,
        reason = "the command owns the main thread and its time"
    )]
    let start = Instant::now();
    let nature = Arc::new(Mutex::new(Nature::default()));
    let in_this_process = d.rig == "sim";
    let port: Box<dyn Port> = match d.rig {
        "sim" => {
            let rig = VirtualRig::new(robot, &d.options)?;
            let script = watched(robot, d.script, Arc::clone(&nature));
            Box::new(ports::in_process(rig, board_config(robot), Some(script)))
        }
        rig => ports::open(rig, &d.options, d.robot_file, robot, start, &d.instruments)?,
    };
    let mut runner = Runner::new(twin, port, robot);
    let mut out = Driven {
        // To grow it on the way would copy it, and miss a tick.
        rows: Vec::with_capacity((d.seconds.min(3600.0) / TICK_S) as usize + 1),
        events: Vec::new(),
        pace: Pace::default(),
        frames: [0; 2],
        finished_s: None,
        refused: None,
        safe: None,
        simulated: false,
        objects: None,
        declared_kg: d.declared_kg,
        plant,
        plant_gains: None,
    };
    let mut given_s = None;
    let mut last: Option<PressureCommand> = None;
    let mut broken = None;
    let mut link = LinkStatus::default();
    let mut unfit = None;
    let mut start_up = Start::new(d.reset);
    let mut first = true;
    let each = |snapshot: &Arc<Snapshot>, events: &[Event], commands: &mut Vec<Command>| {
        let t_s = snapshot.stamp.seconds();
        if std::mem::take(&mut first) {
            commands.push(Command::DeclarePayload(d.declared_kg));
            commands.extend(d.record.clone().map(Command::StartRecording));
        }
        if given_s.is_none() {
            match start_up.ready(snapshot, commands) {
                Ok(false) => {}
                Ok(true) => {
                    given_s = Some(t_s);
                    commands.extend([Command::Arm, Command::Start(d.plan.clone())]);
                }
                Err(why) => unfit = Some(why),
            }
        }
        for event in events {
            match event {
                Event::Refused { reason, .. } => out.refused = Some(reason.clone()),
                Event::Finished { .. } => out.finished_s = given_s.map(|g| t_s - g),
                _ => {}
            }
            out.events.push(event.clone());
        }
        if let Mode::Safe(reason) = &snapshot.mode
            && given_s.is_some()
        {
            out.safe.get_or_insert(reason.clone());
        }
        out.frames = [snapshot.link.frames, snapshot.link.frames_lost];
        if given_s.is_none() {
            link.clone_from(&snapshot.link);
        }
        out.simulated = snapshot.link.simulated;
        out.plant_gains = snapshot.plant_gains;
        if let Some(command) = &snapshot.command {
            broken = broken.take().or(over_limits(robot, last.as_ref(), command));
        }
        last.clone_from(&snapshot.command);
        let seen = nature.lock().map(|n| n.clone()).unwrap_or_default();
        if given_s.is_some() {
            out.rows.push(row(snapshot, seen.base_from_tip));
        }
        broken = broken.take().or(seen.broken);
        if in_this_process {
            out.objects = Some(seen.objects);
        }
        let over = out
            .finished_s
            .is_some_and(|f| given_s.is_some_and(|g| t_s >= g + f + d.after_s));
        let stopped =
            out.refused.is_some() || out.safe.is_some() || broken.is_some() || unfit.is_some();
        let late = t_s > HELLO_S && !snapshot.link.connected && given_s.is_none();
        if over || stopped || late || t_s >= d.seconds {
            ControlFlow::Break(())
        } else {
            ControlFlow::Continue(())
        }
    };
    out.pace = match runner.clock() {
        Clock::Lockstep => run_in_simulated_time(&mut runner, each),
        Clock::Host => run_in_real_time(&mut runner, start, each),
    };
    let end = out.rows.last().map_or(0.0, |r| r.t_s);
    let mut last = Vec::new();
    runner.stop_recording(Stamp::from_seconds(end), &mut last);
    for event in &last {
        if let Event::Refused { reason, .. } = event {
            out.refused.get_or_insert_with(|| reason.clone());
        }
    }
    out.events.append(&mut last);
    if let Some(why) = unfit {
        anyhow::bail!("{why}");
    }
    if let Some(what) = broken {
        anyhow::bail!("a limit was broken: {what}");
    }
    if out.rows.is_empty() {
        check_link(&link, d.rig)?;
        if let Some(why) = out.refused {
            anyhow::bail!("{why}");
        }
        anyhow::bail!(
            "the boards on {} did not get ready within {HELLO_S} s: check their cables and power",
            d.rig
        );
    }
    Ok(out)
}

/// The rig's own script, then a look at the rig.
fn watched(robot: &RobotSpec, mut script: Option<Script>, nature: Arc<Mutex<Nature>>) -> Script {
    let limits = robot.pressure.clone();
    Box::new(move |t_s, rig| {
        if let Some(script) = &mut script {
            script(t_s, rig);
        }
        let Ok(mut seen) = nature.lock() else { return };
        seen.base_from_tip = Some(rig.plant.observation().base_from_tip);
        seen.objects.clear();
        seen.objects.extend_from_slice(rig.objects());
        // Codes of the wire are 1 Pa or so wide.
        let allowed = limits.min_pa - 2.0..=limits.max_pa + 2.0;
        let set_pa = rig.set_pa();
        if let Some(i) = set_pa
            .iter()
            .position(|p| p.is_some_and(|p| !allowed.contains(&p)))
        {
            seen.broken = Some(format!(
                "the boards drive chamber {} to {set_pa:?} Pa",
                i + 1
            ));
        }
    })
}

/// What is wrong with a command after the one before it.
pub fn over_limits(
    robot: &RobotSpec,
    last: Option<&PressureCommand>,
    command: &PressureCommand,
) -> Option<String> {
    let limits = &robot.pressure;
    (0..CHAMBERS).find_map(|i| {
        let pa = command.chamber_pa()[i];
        if !(limits.min_pa..=limits.max_pa).contains(&pa) {
            return Some(format!("chamber {} was commanded to {pa} Pa", i + 1));
        }
        let last = last?;
        let dt_s = command.stamp().since(last.stamp());
        let step_pa = (pa - last.chamber_pa()[i]).abs();
        (step_pa > limits.rate_pa_s * dt_s + 1e-6).then(|| {
            format!(
                "chamber {} was commanded by {step_pa} Pa within {dt_s} s",
                i + 1
            )
        })
    })
}

fn row(snapshot: &Snapshot, truth: Option<Pose>) -> Row {
    let routine = snapshot.routine.as_ref();
    let frame = snapshot.sensors.as_ref();
    Row {
        t_s: snapshot.stamp.seconds(),
        legs_done: routine.map_or(0, |r| r.legs_done),
        waypoint: routine.and_then(|r| r.waypoint).map(|(k, _)| k),
        goal: snapshot.goal.clone(),
        via_m: routine.and_then(|r| r.via.as_ref()).map(|v| v.position_m),
        truth: truth.or_else(|| snapshot.fresh_truth().map(|t| t.base_from_tip)),
        estimate: snapshot.estimate.as_ref().map(|e| e.base_from_tip),
        set_pa: snapshot.command.as_ref().map(|c| *c.chamber_pa()),
        chamber_pa: frame.map_or([f64::NAN; CHAMBERS], |f| f.chamber_pa),
        sensors: frame.map_or_else(SensorRef::zeros, |f| f.sensors.to_vector()),
        sensor_ref: snapshot.sensor_ref,
        solve_s: snapshot.solve_s,
        steered: matches!(snapshot.mode, Mode::Moving | Mode::AtGoal),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::signal::{Estimate, GroundTruth, Matrix6, TruthSource};

    #[test]
    fn a_row_has_no_truth_once_motion_capture_has_stopped() {
        let seen = |late_s: f64| {
            let stamp = Stamp::from_seconds(10.0);
            let snapshot = Snapshot {
                stamp,
                estimate: Some(Estimate {
                    stamp,
                    base_from_tip: Pose::identity(),
                    covariance: Matrix6::zeros(),
                    training_distance: 1.0,
                }),
                truth: Some(GroundTruth {
                    stamp: stamp.plus(-late_s),
                    base_from_tip: Pose::identity(),
                    source: TruthSource::Vicon,
                }),
                ..Snapshot::default()
            };
            row(&snapshot, None).truth.is_some()
        };
        assert!(seen(0.02) && !seen(0.5));
    }
}
