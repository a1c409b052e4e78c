//! Studies on control: both controllers on the same tasks, loads, arms and seeds, with the same budget of
//! tuning. Every error is of the true tip of the virtual rig, which no controller sees. Every unit is driven after its
//! lab's calibration.

use std::collections::BTreeMap;
use std::sync::Arc;

use anyhow::{Context as _, Result};
use rayon::prelude::*;

use crate::control::Gains;
use crate::drive::measures::{self, MoveMeasures, PathMeasures};
use crate::drive::{
    BASKET_M, Drive, Driven, Instruments, LIFT_M, PATH_CENTRE_M, PATH_SIZE_M, PickPlaceMeasures,
    Resets, Script, Shape, TwinBuilder, drive, fruit, longest_s, objects, of_pick_place,
    rig_options,
};
use crate::lab::study::setup::Setup;
use crate::lab::{threads, units};
use crate::rig::Unit;
use crate::robot::RobotSpec;
use crate::sensing::Calibration;
use crate::signal::ControllerKind;
use crate::signal::Goal;
use crate::task::{Follow, PATH_WAYPOINTS, Path, Plan};
use crate::twin::{Maps, TICK_S};

/// Speed along the paths, m/s.
pub const SPEED_M_S: f64 = 3e-3;
/// Longest time of a move, s.
const MOVE_S: f64 = 90.0;

/// A task.
#[derive(Clone, Debug, PartialEq)]
pub enum Task {
    /// Once round, or more often.
    Path(Shape, u32),
    /// To a goal.
    Goto(Goal),
    /// The paper's fruit into the basket.
    PickPlace,
}

/// A drive of a task under one condition.
pub struct Trial {
    pub gains: Gains,
    pub task: Task,
    pub payload_kg: f64,
    /// Payload declared to the twin, kg.
    pub declared_kg: f64,
    pub stiffness: f64,
    pub unit: Unit,
    pub seed: u64,
    /// Time that the run continues after the task, s.
    pub after_s: f64,
    pub script: Option<Script>,
}

impl Trial {
    /// A unit without load, with a seed of its noise.
    pub fn new(gains: Gains, task: Task, (unit, seed): (Unit, u64)) -> Self {
        Self {
            gains,
            task,
            payload_kg: 0.0,
            declared_kg: 0.0,
            stiffness: 1.0,
            unit,
            seed,
            after_s: 2.0,
            script: None,
        }
    }
}

/// Measures of a drive.
pub enum Measured {
    /// A path.
    Path(PathMeasures),
    /// A move.
    Move(MoveMeasures),
    /// Pick and place.
    PickPlace(PickPlaceMeasures),
}

/// A drive with its measures.
pub struct Outcome {
    /// `None` when there was no motion.
    pub measured: Option<Measured>,
    pub solve_us: Option<[f64; 2]>,
    pub off_manifold_mm: Option<f64>,
    pub fastest_mm_s: Option<f64>,
    pub driven: Driven,
}

impl Outcome {
    /// Of a move.
    pub fn moved(&self) -> Option<&MoveMeasures> {
        match &self.measured {
            Some(Measured::Move(m)) => Some(m),
            _ => None,
        }
    }
}

/// The path of a shape, where the studies have it.
pub fn path_of(shape: Shape) -> Path {
    shape.path(PATH_CENTRE_M, PATH_SIZE_M, PATH_WAYPOINTS)
}

/// Runs one trial on a unit, with its calibration and networks.
///
/// # Errors
/// When the rig cannot be set up, the boards do not get ready, or a limit is violated.
pub fn run(
    robot: &RobotSpec,
    calibration: &Calibration,
    maps: &Maps,
    trial: Trial,
) -> Result<Outcome> {
    let mut options = rig_options(trial.payload_kg, trial.seed);
    options.unit = trial.unit;
    options.surroundings.stiffness = trial.stiffness;
    let (plan, seconds) = match &trial.task {
        Task::Path(shape, laps) => {
            let path = path_of(*shape);
            let seconds = longest_s(&path, SPEED_M_S, *laps);
            let follow = Follow {
                path,
                speed_m_s: SPEED_M_S,
                laps: *laps,
            };
            let plan = Plan::follow(follow).context("a path needs waypoints")?;
            (plan, seconds)
        }
        Task::Goto(goal) => (Plan::goto(goal.clone()), MOVE_S + trial.after_s),
        Task::PickPlace => {
            options.objects = objects(&fruit());
            (Plan::pick_and_place(&fruit(), BASKET_M, LIFT_M), 900.0)
        }
    };
    let twin = TwinBuilder::new(robot)
        .rig("sim", options)
        .calibration(calibration.clone())
        .maps(maps.clone())
        .gains(trial.gains)
        .instruments(Instruments {
            // The paper has no watch for contact, and ours knows how an arm moves that ours drives.
            expect_pushes: true,
            ..Instruments::default()
        })
        .script(trial.script);
    let what = Drive {
        plan: plan.clone(),
        declared_kg: trial.declared_kg,
        seconds,
        after_s: trial.after_s,
        record: None,
        note: String::new(),
        reset: Resets::default(),
    };
    let driven = drive(twin, &what, None)?;
    let measured = match &trial.task {
        Task::Path(shape, _) => Some(Measured::Path(measures::of_path(
            &driven,
            &path_of(*shape).waypoints_m,
            robot,
        ))),
        Task::Goto(goal) => measures::of_move(&driven.rows, goal, robot).map(Measured::Move),
        Task::PickPlace => Some(Measured::PickPlace(of_pick_place(
            &driven, &plan, BASKET_M, robot,
        ))),
    };
    let rows = &driven.rows;
    Ok(Outcome {
        measured,
        solve_us: measures::solve_micros(rows),
        fastest_mm_s: measures::fastest_mm_s(rows),
        off_manifold_mm: measures::off_manifold_mm(&driven, robot),
        driven,
    })
}

/// What was kept of some trials.
pub struct Group<T> {
    /// Of each, in order.
    pub kept: Vec<T>,
    /// Their simulated time, s.
    pub simulated_s: f64,
}

/// Runs trials on all cores; `keep`s something of each outcome.
pub fn run_all<T: Send>(
    setup: &mut Setup,
    trials: Vec<Trial>,
    keep: impl Fn(Outcome) -> T + Sync,
) -> Result<Group<T>> {
    let mut groups = run_groups(setup, vec![trials], keep)?;
    groups.pop().context("no trials were given")
}

/// The same of several groups at once, in order.
pub fn run_groups<T: Send>(
    setup: &mut Setup,
    groups: Vec<Vec<Trial>>,
    keep: impl Fn(Outcome) -> T + Sync,
) -> Result<Vec<Group<T>>> {
    let sizes: Vec<usize> = groups.iter().map(Vec::len).collect();
    let trials: Vec<Trial> = groups.into_iter().flatten().collect();
    let wanted: Vec<Unit> = trials.iter().map(|t| t.unit).collect();
    let labs: BTreeMap<u64, (Arc<units::Lab>, Maps)> = setup
        .labs(&wanted)?
        .into_iter()
        .map(|lab| {
            let maps = Maps::from(lab.networks.clone());
            (lab.unit.0, (lab, maps))
        })
        .collect();
    let (robot, progress) = (&setup.robot, &setup.progress);
    let n = trials.len();
    progress.trials(n);
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(threads().min(n.max(1)))
        .thread_name(|k| format!("trial-{k}"))
        .build()?;
    let one = |trial: Trial| -> Result<(T, f64)> {
        let (lab, maps) = labs.get(&trial.unit.0).context("the unit is calibrated")?;
        let out = run(robot, &lab.calibration, maps, trial);
        let out = out.map(|o| {
            let simulated_s = o.driven.rows.len() as f64 * TICK_S;
            (keep(o), simulated_s)
        });
        progress.trial_done();
        out
    };
    let found: Vec<Result<(T, f64)>> = pool.install(|| {
        let trials = trials.into_par_iter().with_max_len(1);
        trials.map(one).collect()
    });
    let mut found = found.into_iter();
    sizes
        .into_iter()
        .map(|size| {
            let all = found.by_ref().take(size).collect::<Result<Vec<_>>>()?;
            let simulated_s = all.iter().map(|(_, s)| s).sum();
            let kept = all.into_iter().map(|(kept, _)| kept).collect();
            Ok(Group { kept, simulated_s })
        })
        .collect()
}

/// Both, with their names.
pub const KINDS: [(ControllerKind, &str); 2] = [
    (ControllerKind::PaperAdrc, "paper's controller"),
    (ControllerKind::NullSpaceQp, "ours"),
];

/// Mean; `None` of no values.
pub fn mean(values: impl IntoIterator<Item = f64>) -> Option<f64> {
    let all: Vec<f64> = values.into_iter().collect();
    (!all.is_empty()).then(|| all.iter().sum::<f64>() / all.len() as f64)
}
