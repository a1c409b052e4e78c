//! The tasks of the paper over loads, stiffnesses and seeds, by both controllers.

use anyhow::Result;

use super::super::super::drive::pictures::{Aspect, Chart, Line};
use super::super::table::{Drawn, Table};
use super::{KINDS, Measured, Outcome, SPEED_M_S, Task, Trial, mean, run_all};
use crate::cli::drive::commands::Shape;
use crate::cli::drive::measures::{PathMeasures, spread};
use springtwin::control::{Gains, InitialGuess};
use springtwin::robot::RobotSpec;
use springtwin::signal::ControllerKind;
use springtwin::signal::Goal;

/// The paper's loads, kg.
pub const LOADS_KG: [f64; 5] = [0.0, 0.035, 0.115, 0.27, 0.5];
/// Stiffness of the arms as factors on the one that the twin knows.
pub const STIFFNESSES: [f64; 3] = [0.5, 1.0, 2.0];
/// Seeds of the rig's noise.
pub const SEEDS: [u64; 3] = [1, 2, 3];

/// Near, middle, far, from the rest pose, m.
pub const TARGETS_M: [(&str, [f64; 3]); 3] = [
    ("near", [0.02, -0.01, -0.31]),
    ("middle", [0.06, 0.04, -0.30]),
    ("far", [-0.12, 0.08, -0.24]),
];

const NOT_TOLD: &str = "The twin is told the load, not the stiffness. Three seeds per row. Errors are of the true tip.";

fn percent(share: f64) -> f64 {
    100.0 * share
}

/// What a table keeps of an outcome.
struct Kept {
    /// Of a path that was finished.
    measured: Option<PathMeasures>,
    off_manifold_mm: Option<f64>,
    solve_us: Option<[f64; 2]>,
    success: bool,
}

fn keep_path(o: Outcome) -> Kept {
    let success = o.driven.finished_s.is_some();
    let Some(Measured::Path(m)) = o.measured else {
        unreachable!("a path was asked for")
    };
    Kept {
        success,
        measured: success.then_some(m),
        off_manifold_mm: o.off_manifold_mm,
        solve_us: o.solve_us,
    }
}

/// One of the two paths.
pub fn path(robot: &RobotSpec, shape: Shape) -> Result<Table> {
    let (name, title, paper_mm) = match shape {
        Shape::Circle => (
            "circle",
            "Circle under loads, arms of three stiffnesses",
            3.7,
        ),
        Shape::Eight => (
            "eight",
            "Figure 8 under loads, arms of three stiffnesses",
            3.3,
        ),
    };
    let mut t = Table {
        name,
        title,
        notes: vec![
            format!(
                "60 waypoints. A point moves along the path at {:.0} mm/s and waits for a tip that is behind it; ours is led by that \
                 point, the paper's controller is given the waypoint ahead of it. {NOT_TOLD} Error: distance from each \
                 waypoint when the point passes it; only of paths that were finished. One step is 10 ms. Off the path: distance from the path at every tick. Off the manifold: how \
                 far the springs of the reference are from what any pressures can make.",
                SPEED_M_S * 1e3
            ),
            "The paper's figure is its mean for loads below 200 g.".to_owned(),
        ],
        columns: vec![
            "mean, mm",
            "RMSE, mm",
            "95 %, mm",
            "largest, mm",
            "off the path, mm",
            "saturated, % of steps",
            "off the manifold, mm",
            "solve, us",
            "solve 95 %, us",
            "steps",
            "success, %",
        ],
        rows: Vec::new(),
        drawn: Drawn::Bars,
    };
    let mut trials = Vec::new();
    for stiffness in STIFFNESSES {
        for (kind, _) in KINDS {
            for payload_kg in LOADS_KG {
                for seed in SEEDS {
                    trials.push(Trial {
                        payload_kg,
                        declared_kg: payload_kg,
                        stiffness,
                        ..Trial::new(Gains::of(kind), Task::Path(shape, 1), seed)
                    });
                }
            }
        }
    }
    let kept = run_all(robot, trials, keep_path)?;
    let mut rows = kept.chunks(SEEDS.len());
    let mut lines = Vec::new();
    for stiffness in STIFFNESSES {
        for (kind, who) in KINDS {
            let mut points = Vec::new();
            for payload_kg in LOADS_KG {
                let group = rows.next().unwrap_or_default();
                let cells = path_cells(group);
                points.extend(cells[0].map(|mm| (payload_kg * 1e3, mm)));
                let load = payload_kg * 1e3;
                t.ours(format!("{who}, {load:.0} g, stiffness {stiffness}"), cells);
            }
            lines.push(Line {
                name: match kind {
                    ControllerKind::Paper => format!("{who} (dashed), stiffness {stiffness}"),
                    ControllerKind::Ours => format!("{who}, stiffness {stiffness}"),
                },
                points,
                dashed: kind == ControllerKind::Paper,
                colour: 1 + lines.len() / KINDS.len(),
            });
        }
    }
    t.paper("paper, below 200 g", vec![Some(paper_mm)]);
    lines.push(Line {
        name: "paper, hardware".to_owned(),
        points: vec![(0.0, paper_mm), (200.0, paper_mm)],
        dashed: true,
        colour: 0,
    });
    t.drawn = Drawn::Chart(Box::new(Chart {
        title: format!("{title} (ours simulated)"),
        x: "load, g",
        y: "mean true error at the waypoints, mm",
        lines,
        aspect: Aspect::Free,
    }));
    Ok(t)
}

fn path_cells(group: &[Kept]) -> Vec<Option<f64>> {
    let finished = || group.iter().filter_map(|k| k.measured.as_ref());
    let errors: Vec<f64> = finished()
        .flat_map(|m| m.at_waypoints_mm.iter().copied())
        .collect();
    let e = spread(errors);
    let of = |f: &dyn Fn(&Kept) -> Option<f64>| mean(group.iter().filter_map(f));
    vec![
        e.map(|e| e.mean),
        e.map(|e| e.rmse),
        e.map(|e| e.p95),
        e.map(|e| e.max),
        mean(finished().filter_map(|m| m.off_path.map(|o| o.mean))),
        mean(finished().map(|m| percent(m.saturated_ratio))),
        of(&|k| k.off_manifold_mm),
        of(&|k| k.solve_us.map(|s| s[0])),
        of(&|k| k.solve_us.map(|s| s[1])),
        mean(finished().map(|m| m.steps as f64)),
        of(&|k| Some(percent(f64::from(u8::from(k.success))))),
    ]
}

/// Who moves, and from what guess.
const MOVERS: [(&str, ControllerKind, InitialGuess); 3] = [
    (
        "paper's controller, without initial guess",
        ControllerKind::Paper,
        InitialGuess::Present,
    ),
    (
        "paper's controller, with initial guess",
        ControllerKind::Paper,
        InitialGuess::Nearest,
    ),
    ("ours", ControllerKind::Ours, InitialGuess::Nearest),
];

/// Point to point: near, middle, far.
pub fn moves(robot: &RobotSpec) -> Result<Table> {
    let mut t = Table {
        name: "moves",
        title: "Point to point",
        notes: vec![
            format!(
                "From rest to three points, without load and with 500 g. {NOT_TOLD} Steps and settling: until the true tip is \
                 within 1 mm for good; rows without settled moves have none. One step is 10 ms. Final: mean over the \
                 last second."
            ),
            "The paper counts 160 iterations with and 480 without its initial guess for its long move; its iterations \
             are not ours, their ratio can be compared."
                .to_owned(),
        ],
        columns: vec![
            "steps",
            "settling, s",
            "final error, mm",
            "saturated, % of steps",
            "off the manifold, mm",
            "solve, us",
            "fastest, mm/s",
            "settled, %",
            "given up with a reason, %",
        ],
        rows: Vec::new(),
        drawn: Drawn::Bars,
    };
    let mut conditions = Vec::new();
    for (target, position_m) in TARGETS_M {
        for stiffness in STIFFNESSES {
            for payload_kg in [0.0, 0.5] {
                for mover in MOVERS {
                    conditions.push((target, position_m, stiffness, payload_kg, mover));
                }
            }
        }
    }
    let trials = conditions.iter().flat_map(|c| {
        SEEDS.map(|seed| {
            let gains = Gains {
                guess: c.4.2,
                ..Gains::of(c.4.1)
            };
            Trial {
                payload_kg: c.3,
                declared_kg: c.3,
                stiffness: c.2,
                ..Trial::new(gains, Task::Goto(Goal::position(c.1)), seed)
            }
        })
    });
    let kept = run_all(robot, trials.collect(), |o| {
        let (solve, off) = (o.solve_us.map(|s| s[0]), o.off_manifold_mm);
        let refused = o.driven.refused.is_some();
        (o.moved().cloned(), solve, off, o.fastest_mm_s, refused)
    })?;
    for (c, group) in conditions.iter().zip(kept.chunks(SEEDS.len())) {
        let moved = || group.iter().filter_map(|g| g.0.as_ref());
        let all_settled = moved().all(|m| m.steps.is_some()) && moved().count() == SEEDS.len();
        let steps = moved().filter_map(|m| m.steps).map(|s| s as f64);
        let settled = mean(moved().map(|m| percent(f64::from(u8::from(m.steps.is_some())))));
        t.ours(
            format!("{}: {}, {:.0} g, stiffness {}", c.0, c.4.0, c.3 * 1e3, c.2),
            vec![
                mean(steps).filter(|_| all_settled),
                mean(moved().filter_map(|m| m.settled_s)).filter(|_| all_settled),
                mean(moved().filter_map(|m| m.final_mm.map(|e| e.mean))),
                mean(moved().map(|m| percent(m.saturated_ratio))),
                mean(group.iter().filter_map(|g| g.2)),
                mean(group.iter().filter_map(|g| g.1)),
                group.iter().filter_map(|g| g.3).reduce(f64::max),
                settled.or(Some(0.0)),
                mean(group.iter().map(|g| percent(f64::from(u8::from(g.4))))),
            ],
        );
    }
    t.paper("far: with initial guess (iterations)", vec![Some(160.0)]);
    t.paper("far: without initial guess (iterations)", vec![Some(480.0)]);
    Ok(t)
}

/// Tomato, lemon and guava into the basket.
pub fn pick_place(robot: &RobotSpec) -> Result<Table> {
    let mut t = Table {
        name: "pick-place",
        title: "Pick and place: 120, 210 and 170 g into a basket",
        notes: vec![format!(
            "The gripper grasps what is within 10 mm; a basket of 40 mm. {NOT_TOLD} Error: true tip from where it should \
             be when the gripper moves. The paper shows its fruit in the basket and gives no figures."
        )],
        columns: vec![
            "in the basket, %",
            "mean, mm",
            "largest, mm",
            "steps",
            "saturated, % of steps",
            "solve, us",
        ],
        rows: Vec::new(),
        drawn: Drawn::Bars,
    };
    let mut conditions = Vec::new();
    for stiffness in STIFFNESSES {
        for (kind, who) in KINDS {
            conditions.push((stiffness, kind, who));
        }
    }
    let trials = conditions.iter().flat_map(|(stiffness, kind, _)| {
        SEEDS.map(|seed| Trial {
            stiffness: *stiffness,
            ..Trial::new(Gains::of(*kind), Task::PickPlace, seed)
        })
    });
    let kept = run_all(robot, trials.collect(), |o| {
        let (solve, steps) = (o.solve_us.map(|s| s[0]), o.driven.rows.len());
        let objects = o.driven.objects.as_ref().map_or(0, Vec::len);
        match o.measured {
            Some(Measured::PickPlace(m)) => Some((m, solve, steps, objects)),
            _ => None,
        }
    })?;
    for (c, group) in conditions.iter().zip(kept.chunks(SEEDS.len())) {
        let all = || group.iter().flatten();
        let in_basket = all().map(|(m, _, _, n)| {
            percent(m.in_basket.unwrap_or_default() as f64 / (*n).max(1) as f64)
        });
        t.ours(
            format!("{}, stiffness {}", c.2, c.0),
            vec![
                mean(in_basket),
                mean(all().filter_map(|(m, ..)| m.at_grips.map(|e| e.mean))),
                all()
                    .filter_map(|(m, ..)| m.at_grips.map(|e| e.max))
                    .reduce(f64::max),
                mean(all().map(|(_, _, steps, _)| *steps as f64)),
                mean(all().map(|(m, ..)| percent(m.saturated_ratio))),
                mean(all().filter_map(|(_, solve, ..)| *solve)),
            ],
        );
    }
    Ok(t)
}
