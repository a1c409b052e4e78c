//! A twin with the product's controllers on a virtual rig in this process, over the wire protocol and on simulated time.

use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use anyhow::{Context as _, Result, bail, ensure};
use numpy::PyReadonlyArray2;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use serde_json::json;
use springtwin::control::{Gains, ReachConfig, reach};
use springtwin::drive::measures::{self, MoveMeasures};
use springtwin::drive::{
    DEFAULT_RIG, Driven, Driver, Instruments, PATH_CENTRE_M, PATH_SIZE_M, Resets, Script, Shape,
    Start, TwinBuilder, along, goal, longest_s, model, over_limits, row,
};
use springtwin::robot::RobotSpec;
use springtwin::signal::{
    CHAMBERS, ControllerKind, Mode, Pose, PressureCommand, SIGNALS, Snapshot, Stamp,
};
use springtwin::sim::Model;
use springtwin::task::{PATH_WAYPOINTS, Path, Plan};
use springtwin::twin::{Command, Event, Maps, Pace, TICK_S};

use crate::arrays::{flat, pose_values, rows, shaped};
use crate::error::{Error, refused};
use crate::rig::RigChoice;
use crate::robot::Robot;

/// How long a motion is watched after its end, s.
const AFTER_S: f64 = 2.0;
/// Ticks between looks for Ctrl-C.
const LOOK_EVERY: u64 = 100;

/// A twin on a virtual rig: it stays on it from one motion to the next.
#[pyclass(frozen, module = "springtwin._springtwin")]
pub struct Twin {
    robot: RobotSpec,
    maps: Maps,
    declared_kg: f64,
    running: Mutex<Running>,
}

/// A twin that runs.
struct Running {
    driver: Driver,
    /// Where the tip truly is.
    truth: Arc<Mutex<Option<Pose>>>,
    ticks: u64,
    start_up: Start,
    /// The command of the last tick.
    last: Option<PressureCommand>,
    mode: Mode,
    /// Commands of the next tick.
    commands: Vec<Command>,
    ready: bool,
}

/// What became of a plan.
struct Outcome {
    driven: Driven,
    violation: Option<String>,
}

#[pymethods]
impl Twin {
    #[new]
    fn new(
        py: Python<'_>,
        robot: &Robot,
        choice: RigChoice,
        seed: u64,
        paper: bool,
        networks: Option<PathBuf>,
    ) -> PyResult<Self> {
        let kind = match paper {
            true => ControllerKind::PaperAdrc,
            false => ControllerKind::NullSpaceQp,
        };
        py.detach(|| Self::on_rig(&robot.spec, &choice, seed, kind, networks))
            .map_err(refused)
    }

    #[getter]
    fn mode(&self) -> String {
        match &self.running().mode {
            Mode::Disarmed => "disarmed".to_owned(),
            Mode::Hold => "hold".to_owned(),
            Mode::Moving => "moving".to_owned(),
            Mode::AtGoal => "at goal".to_owned(),
            Mode::Safe(reason) => format!("SAFE: {reason}"),
        }
    }

    #[getter]
    fn t_s(&self) -> f64 {
        self.running().ticks as f64 * TICK_S
    }

    /// Whether a position can be reached (JSON), as `reach` prints it; nothing moves.
    #[pyo3(signature = (position_m, direction))]
    fn reach(&self, position_m: [f64; 3], direction: Option<[f64; 3]>) -> PyResult<String> {
        let ask = || -> Result<String> {
            let goal = goal(position_m, direction)?;
            let carried_kg = Model::nominal(&self.robot).carried_kg(self.declared_kg);
            let config = ReachConfig::default();
            let (pose, plant) = (self.maps.pose.as_ref(), self.maps.plant.as_ref());
            let seeds = &self.maps.seeds;
            let found = reach(&goal, &self.robot, pose, plant, carried_kg, seeds, &config)?;
            let chamber = found.limiting_chamber;
            let json = json!({
                "state": found.state, "distance_m": found.distance_m, "nearest_m": found.nearest_m,
                "limiting_chamber": chamber.map(|(i, pa)| json!({"chamber": i, "pa": pa})),
                "chamber_pa": found.chamber_pa,
            });
            Ok(json.to_string())
        };
        ask().map_err(refused)
    }

    /// Moves the tip to a position: rows of the way, and its measures (JSON).
    fn goto<'py>(
        &self,
        py: Python<'py>,
        position_m: [f64; 3],
        direction: Option<[f64; 3]>,
        seconds: f64,
    ) -> PyResult<(Bound<'py, PyDict>, String)> {
        let goal = goal(position_m, direction).map_err(refused)?;
        let driven = self.carry_out(py, Plan::goto(goal.clone()), seconds)?;
        let m = measures::of_move(&driven.rows, &goal, &self.robot)
            .context("there was no motion")
            .map_err(refused)?;
        Ok((self.log(py, &driven)?, move_json(&driven, &m)))
    }

    /// Follows a closed path: one of the shapes, or waypoints (n x 3).
    fn follow<'py>(
        &self,
        py: Python<'py>,
        shape: Option<&str>,
        waypoints_m: Option<PyReadonlyArray2<'py, f64>>,
        centre_m: Option<[f64; 3]>,
        size_m: Option<f64>,
        speed_m_s: f64,
        laps: u32,
    ) -> PyResult<(Bound<'py, PyDict>, String)> {
        let own = waypoints_m.map(|w| rows::<3>(&w, "the array of waypoints"));
        let path = path(shape, own.transpose()?, centre_m, size_m).map_err(refused)?;
        let plan = along(&path, speed_m_s, laps, &self.robot).map_err(refused)?;
        let seconds = longest_s(&path, speed_m_s, laps);
        let driven = self.carry_out(py, plan, seconds)?;
        if driven.finished_s.is_none() {
            return Err(Error::new_err(format!(
                "the plan was not carried out within {seconds:.0} s: the arm is held off it, or too slow for it"
            )));
        }
        let m = measures::of_path(&driven, &path.waypoints_m, &self.robot);
        let spread = m.spread;
        let json = json!({
            "name": path.name, "waypoints": m.at_waypoints_mm.len(), "at_waypoints_mm": m.at_waypoints_mm,
            "mean_mm": spread.map(|s| s.mean), "rmse_mm": spread.map(|s| s.rmse), "p95_mm": spread.map(|s| s.p95),
            "max_mm": spread.map(|s| s.max), "off_path_mm": m.off_path.map(|s| s.mean),
            "saturated_ratio": m.saturated_ratio, "steps": m.steps, "seconds": m.seconds, "simulated": driven.simulated,
        });
        Ok((self.log(py, &driven)?, json.to_string()))
    }
}

impl Twin {
    fn on_rig(
        robot: &RobotSpec,
        choice: &RigChoice,
        seed: u64,
        kind: ControllerKind,
        networks: Option<PathBuf>,
    ) -> Result<Self> {
        let maps = model::maps_for(robot, DEFAULT_RIG, networks.as_deref())?;
        let truth = Arc::new(Mutex::new(None));
        let seen = Arc::clone(&truth);
        let script: Script = Box::new(move |_, rig| {
            let mut seen = seen.lock().unwrap_or_else(PoisonError::into_inner);
            *seen = Some(rig.plant.truth().base_from_tip());
        });
        let declared_kg = choice.payload_kg();
        let driver = TwinBuilder::new(robot)
            .rig(DEFAULT_RIG, choice.options(robot, seed)?)
            .maps(maps.clone())
            .gains(Gains::of(kind))
            .instruments(Instruments::default())
            .script(Some(script))
            .timed()
            .build()?;
        Ok(Self {
            robot: robot.clone(),
            maps,
            declared_kg,
            running: Mutex::new(Running {
                driver,
                truth,
                ticks: 0,
                start_up: Start::new(Resets::usual_and(&[])),
                last: None,
                mode: Mode::default(),
                commands: vec![Command::DeclarePayload(declared_kg)],
                ready: false,
            }),
        })
    }

    fn running(&self) -> MutexGuard<'_, Running> {
        self.running.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Carries out a plan; an error where it is refused, or the arm goes SAFE.
    fn carry_out(&self, py: Python<'_>, plan: Plan, seconds: f64) -> PyResult<Driven> {
        let outcome = py.detach(|| {
            let mut running = self.running();
            running.carry_out(&self.robot, &self.maps, self.declared_kg, plan, seconds)
        })?;
        let (driven, violation) = (outcome.driven, outcome.violation);
        if let Some(what) = violation {
            return Err(Error::new_err(format!("a limit was violated: {what}")));
        }
        match (&driven.refused, &driven.safe) {
            (Some(reason), _) => Err(Error::new_err(reason.clone())),
            (None, Some(reason)) => Err(Error::new_err(format!("the arm went SAFE: {reason}"))),
            (None, None) => Ok(driven),
        }
    }

    /// A row per tick.
    fn log<'py>(&self, py: Python<'py>, driven: &Driven) -> PyResult<Bound<'py, PyDict>> {
        let all = &driven.rows;
        let n = all.len();
        let pose = |p: Option<Pose>| p.map_or([f64::NAN; 7], |p| pose_values(&p));
        let out = PyDict::new(py);
        out.set_item("t_s", shaped(py, all.iter().map(|r| r.t_s).collect(), n)?)?;
        let truth = flat(all.iter().map(|r| pose(r.truth)));
        out.set_item("truth", shaped(py, truth, [n, 7])?)?;
        let estimate = flat(all.iter().map(|r| pose(r.estimate)));
        out.set_item("estimate", shaped(py, estimate, [n, 7])?)?;
        let goals = all
            .iter()
            .map(|r| r.via_m.or(r.goal.as_ref().map(|g| g.position_m)));
        let goals = flat(goals.map(|g| g.unwrap_or([f64::NAN; 3])));
        out.set_item("goal_m", shaped(py, goals, [n, 3])?)?;
        let set = flat(all.iter().map(|r| r.set_pa.unwrap_or([f64::NAN; CHAMBERS])));
        out.set_item("set_pa", shaped(py, set, [n, CHAMBERS])?)?;
        let gauges = flat(all.iter().map(|r| r.chamber_pa));
        out.set_item("chamber_pa", shaped(py, gauges, [n, CHAMBERS])?)?;
        let signals = all.iter().flat_map(|r| r.sensors.iter().copied()).collect();
        out.set_item("signals", shaped(py, signals, [n, SIGNALS])?)?;
        Ok(out)
    }
}

impl Running {
    /// One tick, and what happened in it.
    fn tick(&mut self) -> (Arc<Snapshot>, Vec<Event>) {
        let now = Stamp::from_seconds(self.ticks as f64 * TICK_S);
        let commands = std::mem::take(&mut self.commands);
        let (snapshot, events) = self.driver.runner.tick(now, &commands);
        self.ticks += 1;
        self.mode = snapshot.mode.clone();
        (snapshot, events)
    }

    /// Gives a plan once the rig is ready, and keeps what happens until it is carried out, refused or late.
    fn carry_out(
        &mut self,
        robot: &RobotSpec,
        maps: &Maps,
        declared_kg: f64,
        plan: Plan,
        seconds: f64,
    ) -> PyResult<Outcome> {
        let mut driven = Driven {
            rows: Vec::new(),
            events: Vec::new(),
            pace: Pace::default(),
            frames: [0; 2],
            finished_s: None,
            refused: None,
            safe: None,
            simulated: false,
            objects: None,
            declared_kg,
            plant: Arc::clone(&maps.plant),
            plant_gains: None,
        };
        if let Mode::Safe(reason) = &self.mode {
            return Err(Error::new_err(format!(
                "the arm is SAFE ({reason}): make a new twin"
            )));
        }
        let begun_s = self.ticks as f64 * TICK_S;
        let mut given_s = None;
        let mut violation = None;
        let mut plan = Some(plan);
        if self.ready {
            given_s = Some(begun_s);
            self.give(&mut plan);
        }
        loop {
            if self.ticks.is_multiple_of(LOOK_EVERY)
                && let Err(e) = Python::attach(|py| py.check_signals())
            {
                return Err(e);
            }
            let (snapshot, events) = self.tick();
            let t_s = snapshot.stamp.seconds();
            driven.pace.ticks += 1;
            if given_s.is_none() {
                match self.start_up.ready(&snapshot, &mut self.commands) {
                    Ok(false) => {}
                    Ok(true) => {
                        self.ready = true;
                        given_s = Some(t_s);
                        self.give(&mut plan);
                    }
                    Err(why) => return Err(Error::new_err(why)),
                }
            }
            for event in events {
                match &event {
                    Event::Refused { reason, .. } => driven.refused = Some(reason.clone()),
                    Event::Finished { .. } => driven.finished_s = given_s.map(|g| t_s - g),
                    _ => {}
                }
                driven.events.push(event);
            }
            if let Mode::Safe(reason) = &snapshot.mode
                && given_s.is_some()
            {
                driven.safe.get_or_insert(reason.clone());
            }
            if let Some(command) = &snapshot.command {
                let what = over_limits(robot, self.last.as_ref(), command);
                violation = violation.or(what);
            }
            self.last.clone_from(&snapshot.command);
            driven.frames = [snapshot.link.frames, snapshot.link.frames_lost];
            driven.simulated = snapshot.link.simulated;
            driven.plant_gains = snapshot.plant_gains;
            if given_s.is_some() {
                let truth = *self.truth.lock().unwrap_or_else(PoisonError::into_inner);
                driven.rows.push(row(&snapshot, truth));
            }
            let finished_s = driven.finished_s.zip(given_s);
            let done = finished_s.is_some_and(|(f, g)| t_s >= g + f + AFTER_S);
            let stopped = driven.refused.is_some() || driven.safe.is_some() || violation.is_some();
            if done || stopped || t_s - begun_s >= seconds {
                break;
            }
        }
        Ok(Outcome { driven, violation })
    }

    /// Arms the twin and gives it the plan with the next tick.
    fn give(&mut self, plan: &mut Option<Plan>) {
        if self.mode == Mode::Disarmed {
            self.commands.push(Command::Arm);
        }
        self.commands.extend(plan.take().map(Command::Start));
    }
}

fn path(
    shape: Option<&str>,
    waypoints_m: Option<Vec<[f64; 3]>>,
    centre_m: Option<[f64; 3]>,
    size_m: Option<f64>,
) -> Result<Path> {
    let shape = match (shape, waypoints_m) {
        (None, Some(waypoints_m)) => {
            ensure!(
                centre_m.is_none() && size_m.is_none(),
                "waypoints have their own place and size: leave centre_m and size_m out"
            );
            ensure!(
                waypoints_m.iter().flatten().all(|x| x.is_finite()),
                "a waypoint has a value that is not a number: correct it"
            );
            return Ok(Path {
                name: format!("path of {} waypoints", waypoints_m.len()),
                waypoints_m,
            });
        }
        (Some("circle"), None) => Shape::Circle,
        (Some("eight"), None) => Shape::Eight,
        (Some(other), None) => {
            bail!("there is no path '{other}': give 'circle', 'eight' or waypoints")
        }
        _ => bail!("give the name of a path, or waypoints"),
    };
    let size_m = size_m.unwrap_or(PATH_SIZE_M);
    ensure!(
        size_m.is_finite() && size_m > 0.0,
        "a path of size {size_m} m: give a number above 0"
    );
    Ok(shape.path(centre_m.unwrap_or(PATH_CENTRE_M), size_m, PATH_WAYPOINTS))
}

/// As `goto` prints it.
fn move_json(driven: &Driven, m: &MoveMeasures) -> String {
    let steps = driven.events.iter().find_map(|e| match e {
        Event::Reached { steps, .. } => Some(*steps),
        _ => None,
    });
    let reached = driven.finished_s.is_some();
    json!({
        "reached": reached, "steps": steps, "settled_steps": m.steps, "settled_s": m.settled_s,
        "mean_mm": m.final_mm.map(|e| e.mean), "rmse_mm": m.final_mm.map(|e| e.rmse),
        "p95_mm": m.final_mm.map(|e| e.p95), "max_mm": m.final_mm.map(|e| e.max),
        "rotation_error_deg": m.final_deg, "saturated_ratio": m.saturated_ratio,
        "tip_error_mm": measures::tip_error_mm(driven),
        "frames": driven.frames[0], "frames_lost": driven.frames[1], "simulated": driven.simulated,
    })
    .to_string()
}
