//! Study of the aids: each controller with and without what the paper's does not have.

use std::ops::Range;

use anyhow::Result;

use super::tasks::UNITS;
use super::trial::{KINDS, Measured, Task, Trial, mean, run_groups};
use crate::control::{Adaptation, Gains};
use crate::drive::Shape;
use crate::lab::study::item::{Found, Study};
use crate::lab::study::setup::Setup;
use crate::lab::table::{Drawn, Table};
use crate::signal::ControllerKind;

/// The study; an item is a controller with some aids on some arm.
pub const AIDS: Study = Study {
    name: "aids",
    about: "Both controllers with and without each aid",
    items: |_| conditions().len(),
    find,
    table,
};

/// Arms: stiffness as a factor, load in kg.
const ARMS: [(f64, f64); 2] = [(0.5, 0.0), (1.0, 0.27)];
/// Aids: led along the path, stiffness learned, drawn to the middle of the pressures.
const AIDS_OF: [(&str, [bool; 3]); 5] = [
    ("without aids", [false, false, false]),
    ("led along the path", [true, false, false]),
    ("stiffness learned", [false, true, false]),
    ("centred", [false, false, true]),
    ("all three", [true, true, true]),
];

type Condition = (
    (f64, f64),
    (ControllerKind, &'static str),
    (&'static str, [bool; 3]),
);

fn conditions() -> Vec<Condition> {
    let mut out = Vec::new();
    for arm in ARMS {
        for kind in KINDS {
            out.extend(AIDS_OF.map(|aids| (arm, kind, aids)));
        }
    }
    out
}

fn gains(kind: ControllerKind, [lead, learned, centred]: [bool; 3]) -> Gains {
    Gains {
        lead,
        adaptation: match learned {
            true => Adaptation::Gated,
            false => Adaptation::Off,
        },
        // As our controller ships.
        centring: match centred {
            true => Gains::of(ControllerKind::NullSpaceQp).centring,
            false => 0.0,
        },
        ..Gains::of(kind)
    }
}

fn find(setup: &mut Setup, items: Range<usize>) -> Result<Vec<Found>> {
    let conditions = &conditions()[items];
    let trials = conditions
        .iter()
        .map(|((stiffness, kg), (kind, _), (_, aids))| {
            let trial = |unit| Trial {
                payload_kg: *kg,
                declared_kg: *kg,
                stiffness: *stiffness,
                ..Trial::new(gains(*kind, *aids), Task::Path(Shape::Circle, 1), unit)
            };
            UNITS.map(trial).into()
        });
    let groups = run_groups(setup, trials.collect(), |o| match o.measured {
        Some(Measured::Path(m)) if o.driven.finished_s.is_some() => Some(m),
        _ => None,
    })?;
    let row =
        |(((stiffness, kg), (_, who), (aids, _)), group): (&Condition, super::trial::Group<_>)| {
            let finished = || group.kept.iter().flatten();
            let done = 100.0 * finished().count() as f64 / group.kept.len().max(1) as f64;
            let spread = |of: fn(&crate::learn::ErrorStats) -> f64| {
                mean(
                    finished().filter_map(|m: &crate::drive::measures::PathMeasures| {
                        m.spread.as_ref().map(of)
                    }),
                )
            };
            let cells = vec![
                spread(|s| s.mean),
                spread(|s| s.p95),
                mean(finished().filter_map(|m| m.off_path.as_ref().map(|o| o.mean))),
                mean(finished().map(|m| 100.0 * m.saturated_ratio)),
                mean(finished().map(|m| m.seconds)),
                Some(done),
            ];
            let label = format!("{who}, {aids}, {:.0} g, stiffness {stiffness}", kg * 1e3);
            Found::row(label, cells).after(group.simulated_s)
        };
    Ok(conditions.iter().zip(groups).map(row).collect())
}

fn table(found: Vec<Found>) -> Table {
    let mut t = Table::new(
        "aids",
        "A circle by both controllers, with and without each aid",
        &[
            "mean, mm",
            "95 %, mm",
            "off the path, mm",
            "saturated, % of steps",
            "time, s",
            "success, %",
        ],
        Drawn::Bars,
    );
    t.notes = vec![
        "The aids that ours ships with and the paper's controller has not, each for both: a point that moves along the path \
         leads the tip (else the waypoint ahead of it is the goal), the arm's stiffness is learned, pressures are drawn to the middle of \
         their range. The three test units per row. Error: distance from each waypoint when the point passes it; mean over the \
         paths that were finished."
            .to_owned(),
    ];
    t.take(found);
    t
}
