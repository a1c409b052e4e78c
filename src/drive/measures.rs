//! What a drive adds up to. Errors are of the true tip, which the twin never sees.

use nalgebra::Vector3;

use super::plan::{Driven, Row};
use crate::control::virtual_output;
use crate::learn::{ErrorStats, PlantMap, quantile};
use crate::robot::RobotSpec;
use crate::signal::{CHAMBERS, Goal, OrientationGoal, Pose, SPRINGS, SensorRef};
use crate::task::off_path_m;

/// A chamber set this close to its bound counts as saturated, Pa.
const SATURATED_PA: f64 = 50.0;
/// Settled: comes within so much of the goal and stays there.
const SETTLED_M: f64 = 1e-3;
const SETTLED_RAD: f64 = std::f64::consts::PI / 180.0;
/// Stretch over which a speed is taken, s.
const SPEED_OVER_S: f64 = 0.2;
/// The last stretch of a move, over which its final error is taken, s.
const FINAL_S: f64 = 1.0;
/// One row in so many is asked how far its reference is off what the arm can do.
const OFF_MANIFOLD_EVERY: usize = 20;

/// Statistics of the values; `None` of nothing.
pub fn spread(values: Vec<f64>) -> Option<ErrorStats> {
    (!values.is_empty()).then(|| ErrorStats::of(values))
}

/// Distance of the true tip from a point, mm.
fn off_mm(truth: &Pose, point_m: [f64; 3]) -> f64 {
    (truth.translation.vector - Vector3::from(point_m)).norm() * 1e3
}

/// Distance of the estimated from the true tip over a drive, mm; `None` without ground truth.
pub fn tip_error_mm(driven: &Driven) -> Option<ErrorStats> {
    let off = |r: &Row| {
        let (a, b) = (r.estimate?, r.truth?);
        Some((a.translation.vector - b.translation.vector).norm() * 1e3)
    };
    spread(driven.rows.iter().filter_map(off).collect())
}

/// How a move to a goal went.
#[derive(Clone, Debug, PartialEq)]
pub struct MoveMeasures {
    /// True position error over the last second, mm; `None` without ground truth.
    pub final_mm: Option<ErrorStats>,
    /// True orientation error over the last second, degrees; `None` where the goal has no orientation.
    pub final_deg: Option<f64>,
    /// When the true tip came within 1 mm (and 1°) and stayed there, s; `None`: never.
    pub settled_s: Option<f64>,
    /// The same in control steps; `None`: never.
    pub steps: Option<usize>,
    /// Share of the steered steps with a chamber set to its bound.
    pub saturated_ratio: f64,
}

/// Of the rows of one move, from the moment it set out. `None` without rows.
pub fn of_move(rows: &[Row], goal: &Goal, robot: &RobotSpec) -> Option<MoveMeasures> {
    let (first, last) = (rows.first()?, rows.last()?);
    let error = |r: &Row| {
        let e = goal.error(&r.truth?);
        Some([e.fixed_rows::<3>(0).norm(), e.fixed_rows::<3>(3).norm()])
    };
    let errors: Vec<(usize, [f64; 2])> = rows
        .iter()
        .enumerate()
        .filter_map(|(k, r)| Some((k, error(r)?)))
        .collect();
    let outside = |(_, e): &(usize, [f64; 2])| e[0] > SETTLED_M || e[1] > SETTLED_RAD;
    let settled = match errors.iter().rposition(outside) {
        None => errors.first().map(|(k, _)| *k),
        Some(at) => errors.get(at + 1).map(|(k, _)| *k),
    };
    let end = || {
        let late = errors
            .iter()
            .filter(|(k, _)| rows[*k].t_s > last.t_s - FINAL_S);
        late.map(|(_, e)| *e)
    };
    let deg = spread(end().map(|e| e[1].to_degrees()).collect());
    Some(MoveMeasures {
        final_mm: spread(end().map(|e| e[0] * 1e3).collect()),
        final_deg: match goal.orientation {
            OrientationGoal::Free => None,
            _ => deg.map(|d| d.mean),
        },
        settled_s: settled.map(|k| rows[k].t_s - first.t_s),
        steps: settled,
        saturated_ratio: saturated_ratio(rows, robot),
    })
}

/// How a path went.
#[derive(Clone, Debug, PartialEq)]
pub struct PathMeasures {
    /// True distance from each waypoint when its time was over, mm.
    pub at_waypoints_mm: Vec<f64>,
    /// The same from the path itself, at every tick, mm; `None` without ground truth.
    pub off_path: Option<ErrorStats>,
    /// Statistics of `at_waypoints_mm`; `None` where that is empty.
    pub spread: Option<ErrorStats>,
    /// Share of the steered steps with a chamber set to its bound.
    pub saturated_ratio: f64,
    /// Control steps on the path.
    pub steps: usize,
    /// Time on the path, s.
    pub seconds: f64,
}

/// Of the rows on a path; waypoints in the base frame, m.
pub fn of_path(driven: &Driven, waypoints_m: &[[f64; 3]], robot: &RobotSpec) -> PathMeasures {
    let on_path = driven.rows.iter().filter(|r| r.waypoint.is_some());
    let rows: Vec<&Row> = on_path.collect();
    let n = waypoints_m.len().max(1);
    let mut at_waypoints_mm = Vec::new();
    for (k, row) in rows.iter().enumerate() {
        let now = row.waypoint.unwrap_or_default();
        let next = rows.get(k + 1).and_then(|r| r.waypoint);
        let passed = next.map_or(driven.finished_s.is_some(), |next| next != now);
        if passed && let Some(truth) = &row.truth {
            at_waypoints_mm.push(off_mm(truth, waypoints_m[now % n]));
        }
    }
    let off: Vec<f64> = rows
        .iter()
        .filter_map(|r| Some(from_path_mm(r.truth.as_ref()?, waypoints_m)))
        .collect();
    PathMeasures {
        spread: spread(at_waypoints_mm.clone()),
        at_waypoints_mm,
        off_path: spread(off),
        saturated_ratio: saturated_ratio(rows.iter().copied(), robot),
        steps: rows.len(),
        seconds: match (rows.first(), rows.last()) {
            (Some(a), Some(b)) => b.t_s - a.t_s,
            _ => 0.0,
        },
    }
}

/// Distance of the true tip from a closed path, both in the base frame, mm.
pub fn from_path_mm(truth: &Pose, waypoints_m: &[[f64; 3]]) -> f64 {
    off_path_m(&truth.translation.vector.into(), waypoints_m) * 1e3
}

/// Share of the steered rows with a chamber set to its bound.
pub fn saturated_ratio<'a>(rows: impl IntoIterator<Item = &'a Row>, robot: &RobotSpec) -> f64 {
    let limits = &robot.pressure;
    let steered: Vec<&[f64; CHAMBERS]> = rows
        .into_iter()
        .filter(|r| r.steered)
        .filter_map(|r| r.set_pa.as_ref())
        .collect();
    let saturated = steered.iter().filter(|q| {
        let spare = |p: &f64| (limits.max_pa - p).min(p - limits.min_pa);
        q.iter().any(|p| spare(p) <= SATURATED_PA)
    });
    saturated.count() as f64 / steered.len().max(1) as f64
}

/// Fastest that the true tip moved over any stretch of 0.2 s, mm/s. `None` of rows without ground truth.
pub fn fastest_mm_s(rows: &[Row]) -> Option<f64> {
    let first = rows.first()?.t_s;
    let mut behind = rows.iter().peekable();
    let mut fastest: Option<f64> = None;
    for row in rows.iter().filter(|r| r.t_s >= first + SPEED_OVER_S) {
        while behind
            .peek()
            .is_some_and(|b| b.t_s < row.t_s - SPEED_OVER_S - 1e-6)
        {
            behind.next();
        }
        let (Some(from), Some(to)) = (behind.peek().and_then(|b| b.truth), row.truth) else {
            continue;
        };
        let moved_m = (to.translation.vector - from.translation.vector).norm();
        let speed = moved_m * 1e3 / SPEED_OVER_S;
        fastest = Some(fastest.map_or(speed, |f| f.max(speed)));
    }
    fastest
}

/// Times of the controller, µs: median and 95th percentile; `None` where it was not timed.
pub fn solve_micros(rows: &[Row]) -> Option<[f64; 2]> {
    let mut us: Vec<f64> = rows
        .iter()
        .filter_map(|r| r.solve_s)
        .map(|s| s * 1e6)
        .collect();
    us.sort_by(f64::total_cmp);
    (!us.is_empty()).then(|| [quantile(&us, 0.5), quantile(&us, 0.95)])
}

/// How far the springs of the references are off what any pressures can make (by the twin's own plant), mm: norm over the
/// twelve, mean over a sample of the rows. `None` where no row has set pressures and references.
pub fn off_manifold_mm(driven: &Driven, robot: &RobotSpec) -> Option<f64> {
    let (plant, payload_kg) = (driven.plant.as_ref(), driven.declared_kg);
    let far: Vec<f64> = driven
        .rows
        .iter()
        .step_by(OFF_MANIFOLD_EVERY)
        .filter_map(|r| {
            let start = r.set_pa?;
            Some(springs_off_mm(
                &r.sensor_ref?,
                start,
                plant,
                payload_kg,
                robot,
            ))
        })
        .collect();
    spread(far).map(|s| s.mean)
}

/// Gauss-Newton over the pressures, within their bounds.
fn springs_off_mm(
    wanted: &SensorRef,
    start_pa: [f64; CHAMBERS],
    plant: &dyn PlantMap,
    payload_kg: f64,
    robot: &RobotSpec,
) -> f64 {
    const STEPS: usize = 12;
    let limits = &robot.pressure;
    let weights = crate::control::SignalSigma::default()
        .to_vector()
        .map(|s| 1.0 / s);
    let mut q = start_pa;
    let off = |q: &[f64; CHAMBERS]| {
        let e = wanted - plant.sensors(q, payload_kg).sensors;
        let weighted = e.component_mul(&weights).norm();
        (weighted, e.rows(0, SPRINGS).norm() * 1e3)
    };
    let mut best = off(&q);
    for _ in 0..STEPS {
        let at = plant.sensors(&q, payload_kg);
        // Chambers at a bound that want to leave the box stay there.
        let mut free = [true; CHAMBERS];
        for _ in 0..2 {
            let Some(y) = virtual_output(&at.sensors, wanted, &at.jacobian, &weights, &free) else {
                break;
            };
            for i in 0..CHAMBERS {
                let next = q[i] - y[i];
                if q[i] >= limits.max_pa && next > q[i] || q[i] <= limits.min_pa && next < q[i] {
                    free[i] = false;
                }
            }
        }
        let Some(y) = virtual_output(&at.sensors, wanted, &at.jacobian, &weights, &free) else {
            break;
        };
        let next: [f64; CHAMBERS] =
            std::array::from_fn(|i| (q[i] - y[i]).clamp(limits.min_pa, limits.max_pa));
        let found = off(&next);
        if found.0 >= best.0 {
            break;
        }
        (q, best) = (next, found);
    }
    best.1
}
