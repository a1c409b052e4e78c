//! Study of tuning: the same number of candidates for both controllers, drawn alike, on the same tasks.

use std::ops::Range;

use anyhow::Result;

use super::trial::{Group, KINDS, Measured, Outcome, Task, Trial, mean, run_groups};
use crate::control::{AdrcGains, Gains, Resolve};
use crate::drive::Shape;
use crate::lab::study::item::{Found, Study};
use crate::lab::study::setup::Setup;
use crate::lab::table::{Drawn, Table};
use crate::lab::units::TRAINING;
use crate::rig::Unit;
use crate::signal::ControllerKind;
use crate::signal::Goal;
use crate::sim::dataset::sample_rng;
use rand::Rng as _;
use rand::seq::SliceRandom as _;

/// Seed of the rig's noise: no other study uses it.
const SEED: u64 = 1000;
/// Payload, kg: neither of those that the tables are made for.
const PAYLOAD_KG: f64 = 0.06;
/// Stiffness of the arms, as factors: neither of those either.
const STIFFNESSES: [f64; 2] = [0.7, 1.4];
/// Weight of a second of settling time against a millimetre on a path.
const MM_PER_S: f64 = 0.1;
/// A move that does not settle counts as long as this, s.
const NEVER_S: f64 = 90.0;

/// The moves: one short, one long, m.
const MOVES_M: [[f64; 3]; 2] = [[0.02, -0.03, -0.31], [-0.09, 0.05, -0.27]];

/// Dimensions of a candidate.
const DIMENSIONS: usize = 5;

/// A Latin hypercube: `n` points in the unit cube, one in every n-th of every dimension.
fn hypercube(n: usize) -> Vec<[f64; DIMENSIONS]> {
    let mut rng = sample_rng(SEED, 0x7e);
    let mut points = vec![[0.0; DIMENSIONS]; n];
    for d in 0..DIMENSIONS {
        let mut order: Vec<usize> = (0..n).collect();
        order.shuffle(&mut rng);
        for (point, k) in points.iter_mut().zip(order) {
            point[d] = (k as f64 + rng.random::<f64>()) / n as f64;
        }
    }
    points
}

/// A candidate: bandwidths, lead, and what each has alone: when the paper's outer loop solves again (once the inner one has
/// converged, or after a time), our pull in the null space.
fn candidate(kind: ControllerKind, at: &[f64; DIMENSIONS]) -> Gains {
    let between = |d: usize, lo: f64, hi: f64| lo * (hi / lo).powf(at[d]);
    let mut gains = Gains {
        adrc: AdrcGains {
            settle_s: between(0, 0.3, 8.0),
            observer_ratio: between(1, 3.0, 10.0),
        },
        lead_pa: between(2, 400.0, 8000.0),
        ..Gains::of(kind)
    };
    match kind {
        ControllerKind::PaperAdrc => {
            gains.resolve = match at[4] < 0.5 {
                true => Resolve::Converged(between(3, 30.0, 3000.0)),
                false => Resolve::Every(between(3, 0.02, 1.0)),
            };
        }
        ControllerKind::NullSpaceQp => gains.centring = between(3, 0.1, 3.0),
    }
    gains
}

fn cost(outcome: &Outcome) -> f64 {
    match &outcome.measured {
        Some(Measured::Path(m)) if outcome.driven.finished_s.is_some() => {
            m.spread.map_or(f64::INFINITY, |s| s.mean)
        }
        Some(Measured::Move(m)) => MM_PER_S * m.settled_s.unwrap_or(NEVER_S),
        _ => f64::INFINITY,
    }
}

/// The study; an item is a candidate, the first of each controller the gains that ship.
pub const TUNING: Study = Study {
    name: "tuning",
    about: "Both controllers tuned with the same budget",
    items: |sizes| KINDS.len() * (sizes.candidates + 1),
    find,
    table,
};

/// Tasks, each on a training unit of some stiffness.
fn tasks() -> [(Task, f64, Unit); 4] {
    let path = |s| Task::Path(s, 1);
    let move_to = |m| Task::Goto(Goal::position(m));
    [
        (path(Shape::Circle), STIFFNESSES[0], TRAINING[0]),
        (path(Shape::Eight), STIFFNESSES[1], TRAINING[1]),
        (move_to(MOVES_M[0]), STIFFNESSES[1], TRAINING[0]),
        (move_to(MOVES_M[1]), STIFFNESSES[0], TRAINING[1]),
    ]
}

fn find(setup: &mut Setup, items: Range<usize>) -> Result<Vec<Found>> {
    let budget = setup.sizes.candidates;
    let points = hypercube(budget);
    let gains = |item: usize| -> (ControllerKind, String, Gains) {
        let (kind, name) = KINDS[item / (budget + 1)];
        match item % (budget + 1) {
            0 => (kind, format!("{name}, as shipped"), Gains::of(kind)),
            k => (
                kind,
                format!("{name}, candidate {k}"),
                candidate(kind, &points[k - 1]),
            ),
        }
    };
    let all: Vec<_> = items.map(gains).collect();
    let trials = all.iter().map(|(_, _, gains)| {
        let trial = |(task, stiffness, unit)| Trial {
            stiffness,
            payload_kg: PAYLOAD_KG,
            declared_kg: PAYLOAD_KG,
            ..Trial::new(gains.clone(), task, (unit, SEED))
        };
        tasks().map(trial).into()
    });
    let groups = run_groups(setup, trials.collect(), |o| cost(&o))?;
    let row = |((kind, label, g), costs): (&(ControllerKind, String, Gains), Group<f64>)| {
        let (every_s, below_pa) = match (kind, g.resolve) {
            (ControllerKind::NullSpaceQp, _) => (None, None),
            (_, Resolve::Every(s)) => (Some(s), None),
            (_, Resolve::Converged(pa)) => (None, Some(pa)),
        };
        let ours = *kind == ControllerKind::NullSpaceQp;
        Found::row(
            label.as_str(),
            vec![
                mean(costs.kept.iter().copied()).or(Some(f64::INFINITY)),
                Some(g.adrc.settle_s),
                Some(g.adrc.observer_ratio),
                Some(g.lead_pa * 1e-3),
                every_s,
                below_pa,
                ours.then_some(g.centring),
            ],
        )
        .after(costs.simulated_s)
    };
    Ok(all.iter().zip(groups).map(row).collect())
}

/// Candidates of both in order of their cost, the best first, after the gains that ship.
fn table(found: Vec<Found>) -> Table {
    let each = found.len() / KINDS.len();
    let budget = each.saturating_sub(1);
    let mut t = Table::new(
        "tuning",
        "Tuning of both controllers",
        &[
            "cost",
            "settling time, s",
            "observer ratio",
            "lead, kPa",
            "solved again every, s",
            "solved again below, Pa",
            "centring",
        ],
        Drawn::Bars,
    );
    t.notes.push(format!(
            "{budget} candidates of each, a Latin hypercube over the same ranges, on a circle, an 8 and two moves with \
             {:.0} g, on an arm of {} and one of {} of the stiffness that the twin knows (a load, a seed and stiffnesses that \
             no table uses, on the training units, which no table uses either). Cost: mean true error at the waypoints in mm, and {MM_PER_S} \
             per second until a move has settled within 1 mm and stays there; mean over the four tasks. The best five of each, \
             and the gains that ship.",
            PAYLOAD_KG * 1e3,
            STIFFNESSES[0],
            STIFFNESSES[1],
        ));
    let cost = |f: &Found| f.first().unwrap_or(f64::INFINITY);
    for of_one in found.chunks(each.max(1)) {
        let Some((shipped, candidates)) = of_one.split_first() else {
            continue;
        };
        let mut order: Vec<&Found> = candidates.iter().collect();
        order.sort_by(|a, b| cost(a).total_cmp(&cost(b)));
        let best = std::iter::once(shipped).chain(order.into_iter().take(5));
        t.take(best.cloned().collect());
    }
    t
}
