//! Study of learning the arm's stiffness: off, without its gate, gated.

use std::ops::Range;

use anyhow::Result;
use nalgebra::{Matrix3, SMatrix, Vector3};
use rand::Rng as _;

use super::tasks::{STIFFNESSES, UNITS};
use super::trial::{Task, Trial, mean, run_all};
use crate::control::{Adaptation, Gains, ReachConfig, SEGMENTS, judging_gains, reach};
use crate::drive::Shape;
use crate::lab::study::item::{Found, Study, each};
use crate::lab::study::setup::Setup;
use crate::lab::table::{Drawn, Table};
use crate::robot::RobotSpec;
use crate::signal::ControllerKind;
use crate::signal::{CHAMBERS, Goal, ReachState};
use crate::sim::dataset::sample_rng;
use crate::sim::{Inputs, Model, Parameters, Resolution, State, observe, sensitivity, settle};
use crate::twin::Maps;

/// Goals whose verdicts are looked at.
const GOALS: usize = 150;
/// Where they lie, m.
const BOX_M: [[f64; 2]; 3] = [[-0.20, 0.20], [-0.20, 0.20], [-0.42, -0.18]];
/// A goal this close to the reachable set counts as reachable, m; the verdict's own bound.
const NEAR_M: f64 = 2e-3;
/// Goals whose true distance is this close to the bound are left out: either verdict would be right, m.
const DOUBTFUL_M: [f64; 2] = [0.5e-3, 6e-3];
/// Goal of the move, m, and rest after it, s.
const MOVE_M: [f64; 3] = [0.06, 0.04, -0.30];
const REST_S: f64 = 120.0;

/// Least distance of the tip from a goal, m: Gauss-Newton in the box of pressures from several starts, by the
/// twin's own mechanics at the arm's true stiffness. The twin has no part in it.
fn nearest_m(arm: &Model, robot: &RobotSpec, goal_m: [f64; 3], rng: &mut impl rand::Rng) -> f64 {
    const STARTS: usize = 4;
    const STEPS: usize = 25;
    let (lo, hi) = (robot.pressure.min_pa, robot.pressure.max_pa);
    let goal = Vector3::from(goal_m);
    let mut best = f64::INFINITY;
    for start in 0..STARTS {
        let mut q: [f64; CHAMBERS] = match start {
            0 => [0.0; CHAMBERS],
            _ => std::array::from_fn(|_| rng.random_range(lo..hi)),
        };
        let mut state = State::rest(arm);
        let mut at: Option<f64> = None;
        let mut damping = 1e-3;
        for _ in 0..STEPS {
            let inputs = |q: [f64; CHAMBERS]| Inputs {
                chamber_pa: q,
                ..Inputs::default()
            };
            if at.is_none() && settle(arm, &mut state, &inputs(q)).is_err() {
                break;
            }
            let error = goal - observe(arm, &state).base_from_tip.translation.vector;
            let off = error.norm();
            at = Some(off);
            best = best.min(off);
            let Some(s) = sensitivity(arm, &state, &inputs(q)) else {
                break;
            };
            // Metres per half range; chambers at a bound that want to leave it are held.
            let half = 0.5 * (hi - lo);
            let mut j: SMatrix<f64, 3, CHAMBERS> = s.tip.fixed_view::<3, CHAMBERS>(3, 0) * half;
            let pull = j.transpose() * error;
            for i in 0..CHAMBERS {
                if q[i] >= hi && pull[i] > 0.0 || q[i] <= lo && pull[i] < 0.0 {
                    j.column_mut(i).fill(0.0);
                }
            }
            // dx = Jᵀ (J Jᵀ + λ I)⁻¹ e
            let lift = Matrix3::identity() * (damping * 1e-2);
            let Some(inverse) = (j * j.transpose() + lift).try_inverse() else {
                break;
            };
            let dx = j.transpose() * (inverse * error);
            let scale = (0.4 / dx.amax()).min(1.0);
            let next: [f64; CHAMBERS] =
                std::array::from_fn(|i| (q[i] + dx[i] * scale * half).clamp(lo, hi));
            let mut moved = State {
                strains: state.strains.clone(),
                ..State::default()
            };
            if settle(arm, &mut moved, &inputs(next)).is_err() {
                damping *= 10.0;
                continue;
            }
            let found = (goal - observe(arm, &moved).base_from_tip.translation.vector).norm();
            if found < off {
                (q, state) = (next, moved);
                damping = (damping * 0.3).max(1e-6);
                if off - found < 1e-6 {
                    best = best.min(found);
                    break;
                }
            } else {
                damping *= 10.0;
                if damping > 1e6 {
                    break;
                }
            }
        }
    }
    best
}

/// A goal, m, and whether the arm can get there.
type Truth = ([f64; 3], bool);

/// Goals with the truth about them, for an arm of some stiffness.
fn truths(robot: &RobotSpec, stiffness: f64) -> Vec<Truth> {
    let factors = Parameters {
        chamber_stiffness: [stiffness; CHAMBERS],
        bending: [stiffness; 2],
        torsion: [stiffness; 2],
        ..Parameters::default()
    };
    let arm = Model::new(robot, &factors, Resolution::default());
    let mut rng = sample_rng(77, 5);
    let mut out = Vec::new();
    while out.len() < GOALS {
        let goal_m = BOX_M.map(|[lo, hi]| rng.random_range(lo..hi));
        let off_m = nearest_m(&arm, robot, goal_m, &mut rng);
        if off_m <= DOUBTFUL_M[0] || off_m >= DOUBTFUL_M[1] {
            out.push((goal_m, off_m <= NEAR_M));
        }
    }
    out
}

/// Shares of the goals that are wrongly called reachable, wrongly called unreachable, and without verdict.
fn wrong(
    robot: &RobotSpec,
    maps: &Maps,
    truths: &[Truth],
    plant_gains: [f64; SEGMENTS],
) -> Result<[f64; 3]> {
    let config = ReachConfig {
        plant_gains: judging_gains(plant_gains),
        ..ReachConfig::default()
    };
    let mut counts = [0usize; 3];
    for (goal_m, reachable) in truths {
        let goal = Goal::position(*goal_m);
        let (pose, plant) = (maps.pose.as_ref(), maps.plant.as_ref());
        let found = reach(&goal, robot, pose, plant, 0.0, &maps.seeds, &config)?;
        match (found.state, reachable) {
            (ReachState::Reachable | ReachState::Marginal, false) => counts[0] += 1,
            (ReachState::Unreachable, true) => counts[1] += 1,
            (ReachState::OutsideData, _) => counts[2] += 1,
            _ => {}
        }
    }
    Ok(counts.map(|n| 100.0 * n as f64 / truths.len() as f64))
}

/// The study; an item is one way to learn on one arm.
pub const ADAPTATION: Study = Study {
    name: "adaptation",
    about: "What learning the arm's stiffness is good for",
    items: |_| STIFFNESSES.len() * WAYS.len(),
    find,
    table,
};

const WAYS: [(Adaptation, &str); 3] = [
    (Adaptation::Off, "off"),
    (Adaptation::Always, "without its gate"),
    (Adaptation::Gated, "gated"),
];

fn find(setup: &mut Setup, items: Range<usize>) -> Result<Vec<Found>> {
    let mut known: Option<(usize, Vec<Truth>)> = None;
    let maps = Maps::from(setup.shipped.clone());
    each(&*setup.progress.clone(), items, |item| {
        let (arm, (adaptation, how)) = (item / WAYS.len(), WAYS[item % WAYS.len()]);
        let stiffness = STIFFNESSES[arm];
        let truths = match known.take().filter(|k| k.0 == arm) {
            Some((_, truths)) => truths,
            None => truths(&setup.robot, stiffness),
        };
        let gains = Gains {
            adaptation,
            ..Gains::of(ControllerKind::NullSpaceQp)
        };
        let trials = |task: Task, after_s: f64| {
            UNITS.map(|unit| Trial {
                stiffness,
                after_s,
                ..Trial::new(gains.clone(), task.clone(), unit)
            })
        };
        let moves = trials(Task::Goto(Goal::position(MOVE_M)), REST_S);
        let moved = run_all(setup, moves.into(), |o| {
            (
                o.moved().and_then(|m| m.steps),
                o.fastest_mm_s,
                o.driven.plant_gains,
            )
        })?;
        let circled = run_all(
            setup,
            trials(Task::Path(Shape::Circle, 1), 2.0).into(),
            |o| match o.measured {
                Some(super::trial::Measured::Path(m)) if o.driven.finished_s.is_some() => {
                    m.spread.map(|s| (s.mean, m.steps))
                }
                _ => None,
            },
        )?;
        let (moves, circles) = (&moved.kept, &circled.kept);
        let learned: Vec<[f64; SEGMENTS]> = moves.iter().filter_map(|m| m.2).collect();
        let verdicts = learned
            .iter()
            .map(|g| wrong(&setup.robot, &maps, &truths, *g))
            .collect::<Result<Vec<_>>>()?;
        let verdict = |k: usize| mean(verdicts.iter().map(|v| v[k]));
        let settled = moves.iter().all(|m| m.0.is_some());
        let cells = vec![
            mean(moves.iter().filter_map(|m| m.0).map(|s| s as f64)).filter(|_| settled),
            mean(circles.iter().flatten().map(|c| c.0)),
            mean(circles.iter().flatten().map(|c| c.1 as f64)),
            moves.iter().filter_map(|m| m.1).reduce(f64::max),
            mean(learned.iter().map(|g| g[0])),
            mean(learned.iter().map(|g| g[1])),
            verdict(0),
            verdict(1),
            verdict(2),
        ];
        known = Some((arm, truths));
        let simulated_s = moved.simulated_s + circled.simulated_s;
        Ok(Found::row(format!("stiffness {stiffness}: {how}"), cells).after(simulated_s))
    })
}

fn table(found: Vec<Found>) -> Table {
    let mut t = Table::new(
        "adaptation",
        "Learning the arm's stiffness",
        &[
            "steps of the move",
            "circle: mean, mm",
            "circle: steps",
            "fastest, mm/s",
            "gain, segment 1",
            "gain, segment 2",
            "wrongly reachable, %",
            "wrongly unreachable, %",
            "no verdict, %",
        ],
        Drawn::Bars,
    );
    t.notes = vec![
        format!(
            "Our controller on arms of a stiffness that the twin does not know; the three test units per row, each with a seed of its own. A move to {:?} mm, \
             then {REST_S:.0} s of rest there; and the circle without load.",
            MOVE_M.map(|x| x * 1e3)
        ),
        format!(
            "Gains: how much more the segments give way than the model has it, at the end (the arm's own is one \
             over its stiffness). Verdicts after that on {GOALS} random goals, against the same mechanics at the arm's \
             true stiffness, which the twin does not see; goals whose nearest reachable point is {:.1} to {:.0} mm away are left out.",
            DOUBTFUL_M[0] * 1e3,
            DOUBTFUL_M[1] * 1e3
        ),
    ];
    t.take(found);
    t
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_the_mechanics_reach_is_known_to_be_reachable() {
        let robot = RobotSpec::reference();
        let arm = Model::nominal(&robot);
        let mut rng = sample_rng(3, 3);
        for _ in 0..5 {
            let mut state = State::rest(&arm);
            let chamber_pa = std::array::from_fn(|_| rng.random_range(-35e3..35e3));
            let inputs = Inputs {
                chamber_pa,
                ..Inputs::default()
            };
            settle(&arm, &mut state, &inputs).expect("settles");
            let tip = observe(&arm, &state).base_from_tip.translation.vector;
            let off_m = nearest_m(&arm, &robot, tip.into(), &mut rng);
            assert!(off_m < DOUBTFUL_M[0], "{off_m}");
        }
        let off_m = nearest_m(&arm, &robot, [0.0, 0.0, -0.55], &mut rng);
        assert!((off_m - 0.11).abs() < 0.02, "{off_m}");
    }
}
