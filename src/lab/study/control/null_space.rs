//! Study of the null space: spare pressures in the middle of their range, where the baseline runs into its bounds.

use std::ops::Range;

use anyhow::Result;

use super::tasks::{TARGETS_M, UNITS};
use super::trial::{Measured, Task, Trial, mean, run_all};
use crate::control::Gains;
use crate::drive::Shape;
use crate::lab::study::item::{Found, Study, each};
use crate::lab::study::setup::Setup;
use crate::lab::table::{Drawn, Table};
use crate::signal::ControllerKind;
use crate::signal::Goal;

/// The study; an item is a row of the table.
pub const NULL_SPACE: Study = Study {
    name: "null-space",
    about: "Saturation avoided in the null space",
    items: |_| conditions().len(),
    find,
    table,
};

/// Task with its name, payload, kg, controller with its name, and gains.
type Condition = (&'static str, Task, f64, &'static str, Gains);

fn conditions() -> Vec<Condition> {
    let ours = Gains::of(ControllerKind::NullSpaceQp);
    let left = Gains {
        centring: 0.0,
        ..ours.clone()
    };
    let ways = [
        ("paper's controller", Gains::of(ControllerKind::PaperAdrc)),
        ("ours, spare pressures left alone", left),
        ("ours", ours),
    ];
    let far = TARGETS_M[2].1;
    let tasks = [
        ("circle, twice", Task::Path(Shape::Circle, 2)),
        ("8, twice", Task::Path(Shape::Eight, 2)),
        ("far", Task::Goto(Goal::position(far))),
    ];
    let mut out = Vec::new();
    for (what, task) in tasks {
        for payload_kg in [0.0, 0.5] {
            for (who, gains) in &ways {
                out.push((what, task.clone(), payload_kg, *who, gains.clone()));
            }
        }
    }
    out
}

fn find(setup: &mut Setup, items: Range<usize>) -> Result<Vec<Found>> {
    let conditions = conditions();
    each(&*setup.progress.clone(), items, |k| {
        let (what, task, payload_kg, who, gains) = &conditions[k];
        let trials = UNITS.map(|unit| Trial {
            payload_kg: *payload_kg,
            declared_kg: *payload_kg,
            ..Trial::new(gains.clone(), task.clone(), unit)
        });
        let group = run_all(setup, trials.into(), |o| {
            let largest = |q: &[f64; 6]| q.iter().fold(0.0_f64, |m, p| m.max(p.abs()));
            let set = o.driven.rows.iter().filter(|r| r.steered);
            let largest = mean(set.filter_map(|r| r.set_pa.as_ref()).map(largest));
            let (saturated, error_mm, steps) = match &o.measured {
                Some(Measured::Path(m)) if o.driven.finished_s.is_some() => (
                    Some(m.saturated_ratio),
                    m.spread.map(|s| s.mean),
                    Some(m.steps),
                ),
                Some(Measured::Move(m)) => {
                    (Some(m.saturated_ratio), m.final_mm.map(|e| e.mean), m.steps)
                }
                _ => (None, None, None),
            };
            (saturated, error_mm, largest, steps)
        })?;
        let found = &group.kept;
        let all_steps = found.iter().all(|f| f.3.is_some());
        Ok(Found::row(
            format!("{what}, {:.0} g: {who}", payload_kg * 1e3),
            vec![
                mean(found.iter().filter_map(|f| f.0).map(|s| 100.0 * s)),
                mean(found.iter().filter_map(|f| f.1)),
                mean(found.iter().filter_map(|f| f.2).map(|p| p * 1e-3)),
                mean(found.iter().filter_map(|f| f.3).map(|s| s as f64)).filter(|_| all_steps),
            ],
        )
        .after(group.simulated_s))
    })
}

fn table(found: Vec<Found>) -> Table {
    let mut t = Table::new(
        "null-space",
        "Saturation avoided in the null space",
        &[
            "saturated, % of steps",
            "mean error, mm",
            "largest pressure, kPa",
            "steps",
        ],
        Drawn::Bars,
    );
    t.notes.push(
        "Goals that ask for a position alone leave three pressures spare. Ours draws them towards the middle of \
         their range (on a path) or to the reachability solution with most pressure to spare (to a goal), within the \
         null space; the row without that leaves them where they are. Without load and with 500 g; the three test units \
         per row, each with a seed of its own. Largest: of the set pressures of all chambers, mean over the steps."
            .to_owned(),
    );
    t.take(found);
    t
}
