//! A twin on a rig carries out a plan, and everything that happens is kept.

use std::ops::ControlFlow;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};

use anyhow::Result;

use super::driver::{Observer, TwinBuilder};
use super::limits::LimitWatch;
use super::ports::Script;
use super::run::recording;
use super::start::{HELLO_S, Resets, Start, check_link};
use crate::control::SEGMENTS;
use crate::learn::PlantMap;
use crate::rig::Object;
use crate::robot::RobotSpec;
use crate::signal::{CHAMBERS, Goal, LinkStatus, Mode, Pose, SensorRef, Snapshot, Stamp};
use crate::task::Plan;
use crate::twin::{Command, Event, Pace, TICK_S};

/// A plan to be carried out.
pub struct Drive {
    /// What to do.
    pub plan: Plan,
    /// Payload that is declared to the twin at the start, kg.
    pub declared_kg: f64,
    /// Longest time, s.
    pub seconds: f64,
    /// How long to go on once the plan is carried out, s.
    pub after_s: f64,
    /// Where to record; `None`: nowhere.
    pub record: Option<PathBuf>,
    /// The operator's note on the recording; may be empty.
    pub note: String,
    /// For which causes boards that are SAFE from before may leave it.
    pub reset: Resets,
}

/// One tick on the way.
#[derive(Clone, Debug)]
pub struct Row {
    /// Since the start of the program, s.
    pub t_s: f64,
    /// Legs done.
    pub legs_done: usize,
    /// Index of the waypoint travelled to; `None` off a path.
    pub waypoint: Option<usize>,
    /// Where the tip shall be now; `None` without a goal.
    pub goal: Option<Goal>,
    /// The point that moves along a path, in the base frame, m; `None` where none leads.
    pub via_m: Option<[f64; 3]>,
    /// Where the tip truly is, base from tip: exactly for a rig in this process, else by motion capture; `None` while that
    /// does not see it.
    pub truth: Option<Pose>,
    /// The twin's estimate of it, base from tip; `None` before there is one.
    pub estimate: Option<Pose>,
    /// Set gauge pressures of chambers 1 to 6, Pa; `None` before a command.
    pub set_pa: Option<[f64; CHAMBERS]>,
    /// Measured gauge pressures of chambers 1 to 6, Pa.
    pub chamber_pa: [f64; CHAMBERS],
    /// Measured signals, m and rad.
    pub sensors: SensorRef,
    /// Reference signals, m and rad; `None` where no controller has any.
    pub sensor_ref: Option<SensorRef>,
    /// Time the controller took, s; `None` if it did not solve in this tick or was not timed.
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
    /// Frames received and lost, in this order.
    pub frames: [u64; 2],
    /// When the plan was carried out, s after it was given; `None` if it was not.
    pub finished_s: Option<f64>,
    /// Why it was refused or stopped; `None` if it was not.
    pub refused: Option<String>,
    /// Why the arm went SAFE; `None` if it did not.
    pub safe: Option<String>,
    /// Whether the rig is simulated.
    pub simulated: bool,
    /// The objects where they are at the end; `None` where that is not known.
    pub objects: Option<Vec<Object>>,
    /// Payload declared at the start, kg.
    pub declared_kg: f64,
    /// The twin's plant.
    pub plant: Arc<dyn PlantMap>,
    /// What the controller has learned of the arm's stiffness: gain of each segment over the plant map, upper segment first;
    /// `None` before the first tick.
    pub plant_gains: Option<[f64; SEGMENTS]>,
}

/// Ground truth of a rig in this process.
#[derive(Clone, Debug, Default)]
struct Plant {
    base_from_tip: Option<Pose>,
    objects: Vec<Object>,
    violation: Option<String>,
}

/// Gives the plan to a twin that is ready for it, and keeps what happens.
struct Execution<'a> {
    drive: &'a Drive,
    limits: LimitWatch<'a>,
    /// Where the rig is in this process.
    plant: Option<Arc<Mutex<Plant>>>,
    start_up: Start,
    first: bool,
    /// When the plan was given, s.
    given_s: Option<f64>,
    /// The link before the plan was given.
    link: LinkStatus,
    /// Why the rig cannot become ready.
    unfit: Option<String>,
    out: Driven,
}

impl Execution<'_> {
    /// Gives the plan once the rig is ready.
    fn begin(&mut self, snapshot: &Snapshot, commands: &mut Vec<Command>) {
        if std::mem::take(&mut self.first) {
            commands.push(Command::DeclarePayload(self.drive.declared_kg));
            commands.extend(recording(self.drive.record.as_deref(), &self.drive.note));
        }
        if self.given_s.is_some() {
            return;
        }
        match self.start_up.ready(snapshot, commands) {
            Ok(false) => {}
            Ok(true) => {
                self.given_s = Some(snapshot.stamp.seconds());
                commands.extend([Command::Arm, Command::Start(self.drive.plan.clone())]);
            }
            Err(why) => self.unfit = Some(why),
        }
    }

    fn keep(&mut self, snapshot: &Snapshot, events: &[Event]) {
        let (t_s, out) = (snapshot.stamp.seconds(), &mut self.out);
        for event in events {
            match event {
                Event::Refused { reason, .. } => out.refused = Some(reason.clone()),
                Event::Finished { .. } => out.finished_s = self.given_s.map(|g| t_s - g),
                _ => {}
            }
            out.events.push(event.clone());
        }
        if let Mode::Safe(reason) = &snapshot.mode
            && self.given_s.is_some()
        {
            out.safe.get_or_insert(reason.clone());
        }
        out.frames = [snapshot.link.frames, snapshot.link.frames_lost];
        if self.given_s.is_none() {
            self.link.clone_from(&snapshot.link);
        }
        out.simulated = snapshot.link.simulated;
        out.plant_gains = snapshot.plant_gains;
        self.limits.check(snapshot);
        let plant = self.plant.as_ref();
        let plant = plant.map(|p| p.lock().unwrap_or_else(PoisonError::into_inner).clone());
        if self.given_s.is_some() {
            let truth = plant.as_ref().and_then(|p| p.base_from_tip);
            out.rows.push(row(snapshot, truth));
        }
        if let Some(plant) = plant {
            self.limits.violation = self.limits.violation.take().or(plant.violation);
            out.objects = Some(plant.objects);
        }
    }

    fn is_over(&self, snapshot: &Snapshot) -> bool {
        let t_s = snapshot.stamp.seconds();
        let finished_s = self.out.finished_s.zip(self.given_s);
        let done = finished_s.is_some_and(|(f, g)| t_s >= g + f + self.drive.after_s);
        let stopped = self.out.refused.is_some()
            || self.out.safe.is_some()
            || self.limits.violation.is_some()
            || self.unfit.is_some();
        let late = t_s > HELLO_S && !snapshot.link.connected && self.given_s.is_none();
        done || stopped || late || t_s >= self.drive.seconds
    }
}

impl Observer for Execution<'_> {
    fn observe(
        &mut self,
        snapshot: &Arc<Snapshot>,
        events: &[Event],
        commands: &mut Vec<Command>,
    ) -> ControlFlow<()> {
        self.begin(snapshot, commands);
        self.keep(snapshot, events);
        match self.is_over(snapshot) {
            true => ControlFlow::Break(()),
            false => ControlFlow::Continue(()),
        }
    }
}

/// Carries out a plan. A pressure command beyond range or rate is an error, whoever made it. `observer` looks on and
/// may end it early; `None`: nobody does.
///
/// # Errors
/// When the twin cannot be put on the rig, the boards do not get ready, or a limit is violated.
pub fn drive(
    mut twin: TwinBuilder<'_>,
    drive: &Drive,
    observer: Option<&mut dyn Observer>,
) -> Result<Driven> {
    let (robot, rig) = (twin.robot, twin.rig);
    let mut plant = None;
    if rig == "sim" {
        let seen = Arc::new(Mutex::new(Plant::default()));
        twin.script = Some(watched(robot, twin.script.take(), Arc::clone(&seen)));
        plant = Some(seen);
    }
    let mut driver = twin.timed().build()?;
    let mut execution = Execution {
        drive,
        limits: LimitWatch::new(robot),
        plant,
        start_up: Start::new(drive.reset),
        first: true,
        given_s: None,
        link: LinkStatus::default(),
        unfit: None,
        out: Driven {
            // To grow it on the way would copy it, and miss a tick.
            rows: Vec::with_capacity((drive.seconds.min(3600.0) / TICK_S) as usize + 1),
            events: Vec::new(),
            pace: Pace::default(),
            frames: [0; 2],
            finished_s: None,
            refused: None,
            safe: None,
            simulated: false,
            objects: None,
            declared_kg: drive.declared_kg,
            plant: Arc::clone(&driver.maps.plant),
            plant_gains: None,
        },
    };
    let pace = match observer {
        Some(observer) => driver.run(&mut [&mut execution, observer]),
        None => driver.run(&mut [&mut execution]),
    };
    let Execution {
        mut out,
        link,
        unfit,
        limits,
        ..
    } = execution;
    out.pace = pace;
    let end_s = out.rows.last().map_or(0.0, |r| r.t_s);
    let was_ended = driver.was_ended();
    let last = driver.finish(Stamp::from_seconds(end_s)).events;
    for event in &last {
        if let Event::Refused { reason, .. } = event {
            out.refused.get_or_insert_with(|| reason.clone());
        }
    }
    out.events.extend(last);
    if let Some(why) = unfit {
        anyhow::bail!("{why}");
    }
    limits.ensure_none()?;
    anyhow::ensure!(!was_ended, super::ENDED);
    if out.rows.is_empty() {
        check_link(&link, rig)?;
        if let Some(why) = out.refused {
            anyhow::bail!("{why}");
        }
        anyhow::bail!(
            "the boards on {rig} did not get ready within {HELLO_S} s: check their cables and power"
        );
    }
    Ok(out)
}

/// The rig's own script, then the ground truth of the rig.
fn watched(robot: &RobotSpec, mut script: Option<Script>, plant: Arc<Mutex<Plant>>) -> Script {
    let limits = robot.pressure.clone();
    Box::new(move |t_s, rig| {
        if let Some(script) = &mut script {
            script(t_s, rig);
        }
        let Ok(mut seen) = plant.lock() else { return };
        seen.base_from_tip = Some(rig.plant.truth().base_from_tip());
        seen.objects.clear();
        seen.objects.extend_from_slice(rig.objects());
        // Codes of the wire are 1 Pa or so wide.
        let allowed = limits.min_pa - 2.0..=limits.max_pa + 2.0;
        let set_pa = rig.set_pa();
        if let Some(i) = set_pa
            .iter()
            .position(|p| p.is_some_and(|p| !allowed.contains(&p)))
        {
            seen.violation = Some(format!(
                "the boards drive chamber {} to {set_pa:?} Pa",
                i + 1
            ));
        }
    })
}

/// A tick of the way; without the true pose of the virtual rig, `truth`, that of motion capture stands for it.
pub fn row(snapshot: &Snapshot, truth: Option<Pose>) -> Row {
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
