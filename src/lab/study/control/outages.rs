//! Study of control with one sensor out: a circle, and a point that is held, for an hour each.

use std::ops::Range;

use anyhow::Result;
use nalgebra::Vector3;

use super::tasks::{TARGETS_M, UNITS};
use super::trial::{Group, Outcome, SPEED_M_S, Task, Trial, path_of, run_groups};
use crate::control::Gains;
use crate::drive::Shape;
use crate::drive::measures::from_path_mm;
use crate::drive::{PATH_SIZE_M, Script};
use crate::lab::study::item::{Found, Study};
use crate::lab::study::setup::Setup;
use crate::lab::table::{Drawn, Table};
use crate::rig::VirtualRig;
use crate::rig::faults::{Fault, Place, Word};
use crate::signal::{ControllerKind, Goal, IMUS, Pose, SPRINGS};

/// When the sensor falls silent, s.
const BEGIN_S: f64 = 5.0;
/// Errors count from here on: the arm is on its way, or there, s.
const FROM_S: f64 = 60.0;
/// Length of each task, in lengths of the usual motion.
const LONG: f64 = 60.0;

/// The study; an item is a sensor, or none.
pub const OUTAGES: Study = Study {
    name: "outages",
    about: "A circle and a point for an hour, with one sensor out",
    items: |_| cases().len(),
    find,
    table,
};

/// A sensor and its name; none first, once per unit.
type Case = (Option<Place>, String);

fn cases() -> Vec<Case> {
    let none = UNITS.iter().map(|_| (None, "none".to_owned()));
    let springs = (0..SPRINGS).map(|i| (Some(Place::Spring(i)), format!("spring {}", i + 1)));
    let imus = (0..IMUS).map(|i| (Some(Place::Imu(i)), format!("IMU {}", i + 1)));
    none.chain(springs).chain(imus).collect()
}

fn script(place: Place) -> Script {
    Box::new(move |t_s: f64, rig: &mut VirtualRig| {
        if t_s >= BEGIN_S {
            rig.faults.begin(place, Fault::of(Word::Off));
        }
    })
}

/// What one task came to.
struct Kept {
    /// Mean and greatest true distance from path or point, mm; `None` before it was under way.
    off_mm: Option<[f64; 2]>,
    is_safe: bool,
    /// Whether the arm was steered to the end.
    is_done: bool,
}

fn kept(o: &Outcome, off_mm: impl Fn(&Pose) -> f64) -> Kept {
    let rows = o.driven.rows.iter().filter(|r| r.t_s >= FROM_S);
    let truths = rows.filter_map(|r| Some(off_mm(r.truth.as_ref()?)));
    let (mut sum, mut most, mut n) = (0.0, 0.0_f64, 0.0);
    for mm in truths {
        sum += mm;
        most = most.max(mm);
        n += 1.0;
    }
    Kept {
        off_mm: (n > 0.0).then(|| [sum / n, most]),
        is_safe: o.driven.safe.is_some(),
        is_done: o.driven.finished_s.is_some() && o.driven.refused.is_none(),
    }
}

fn find(setup: &mut Setup, items: Range<usize>) -> Result<Vec<Found>> {
    let seconds = LONG * setup.sizes.seconds;
    let target_m = TARGETS_M[1].1;
    let lap_s = std::f64::consts::TAU * PATH_SIZE_M / SPEED_M_S;
    let laps = (seconds / lap_s).ceil() as u32;
    let all = cases();
    let first = items.start;
    let cases = &all[items];
    let trial = |task: Task, place: &Option<Place>, k: usize| Trial {
        script: place.map(script),
        after_s: match task {
            Task::Goto(_) => seconds,
            _ => 2.0,
        },
        ..Trial::new(
            Gains::of(ControllerKind::NullSpaceQp),
            task,
            UNITS[k % UNITS.len()],
        )
    };
    let groups = cases.iter().enumerate().map(|(k, (place, _))| {
        let tasks = [
            Task::Path(Shape::Circle, laps),
            Task::Goto(Goal::position(target_m)),
        ];
        let trials = tasks.map(|task| trial(task, place, first + k));
        trials.into_iter().collect()
    });
    let waypoints_m = path_of(Shape::Circle).waypoints_m;
    let groups = run_groups(setup, groups.collect(), |o| {
        let is_point = o.moved().is_some();
        kept(&o, |tip| match is_point {
            true => (tip.translation.vector - Vector3::from(target_m)).norm() * 1e3,
            false => from_path_mm(tip, &waypoints_m),
        })
    })?;
    let row = |(k, ((_, what), of)): (usize, (&Case, Group<Kept>))| {
        let unit = UNITS[(first + k) % UNITS.len()].0;
        let mut cells = Vec::new();
        for kept in &of.kept {
            cells.extend(match kept.off_mm {
                Some(off_mm) => off_mm.map(Some),
                None => [None; 2],
            });
        }
        let share = |is: fn(&Kept) -> bool| {
            let n = of.kept.iter().filter(|k| is(k)).count();
            Some(100.0 * n as f64 / of.kept.len() as f64)
        };
        cells.extend([share(|k| k.is_done), share(|k| k.is_safe)]);
        Found::row(format!("{what}; unit {}", unit.0), cells).after(of.simulated_s)
    };
    let found = cases.iter().zip(groups).enumerate().map(row);
    let mut found: Vec<Found> = found.collect();
    if let Some(last) = found
        .last_mut()
        .filter(|_| first + cases.len() == all.len())
    {
        last.notes.push(format!(
            "One sensor falls silent after {BEGIN_S:.0} s and stays out; {laps} laps of the circle at {:.0} mm/s, and {:.0} min at \
             the middle target. Contact is watched for. Errors: true tip from the path or the point from {FROM_S:.0} s on.",
            SPEED_M_S * 1e3,
            seconds / 60.0
        ));
    }
    Ok(found)
}

fn table(found: Vec<Found>) -> Table {
    let mut t = Table::new(
        "outages",
        "Control with one sensor out",
        &[
            "circle, mm",
            "circle, largest, mm",
            "point, mm",
            "point, largest, mm",
            "done, %",
            "SAFE, %",
        ],
        Drawn::Bars,
    );
    t.take(found);
    t
}
