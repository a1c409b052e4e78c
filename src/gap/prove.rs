//! Held-out proof: effects are refitted without some blocks, the session is simulated anew with
//! them, and the error is taken on the blocks that were left out.

use super::GapError;
use super::commission::Baseline;
use super::explain::{Explained, weak_prior};
use super::finding::{ChannelError, GapSize, Traces};
use super::noise::{bridged, start};
use super::problem::{BLOCKS, FOLDS, Problem, Replayed};
use super::replay::{Row, move_arm, told_poses};
use super::session::{CHANNELS, IMU_0, SPRING_0, channel_name};
use crate::signal::Pose;
use crate::sim::effects::{Active, Target};

/// The proof.
pub struct Proof {
    /// The gap where the effects show best.
    pub gap: GapSize,
    /// All groups.
    pub channels: Vec<ChannelError>,
    /// Those that got worse.
    pub worse: Vec<ChannelError>,
    /// For pictures.
    pub traces: Traces,
}

/// Channels whose errors are told together.
struct Group {
    name: String,
    channels: std::ops::Range<usize>,
    unit: &'static str,
    /// Unit per SI unit.
    factor: f64,
}

fn groups() -> Vec<Group> {
    let one = |name: String, channels, unit, factor| Group {
        name,
        channels,
        unit,
        factor,
    };
    let deg = 180.0 / std::f64::consts::PI;
    let mut out = vec![
        one("r2 tip position".to_owned(), 0..3, "mm", 1e3),
        one("r2 tip rotation".to_owned(), 3..6, "deg", deg),
    ];
    for c in SPRING_0..IMU_0 {
        out.push(one(format!("r3 {}", channel_name(c)), c..c + 1, "mm", 1e3));
    }
    for (i, c) in (IMU_0..CHANNELS).step_by(3).enumerate() {
        out.push(one(format!("r4 IMU {}", i + 1), c..c + 3, "deg", deg));
    }
    out
}

/// A group that got worse by this share of its floor is told.
const WORSE: f64 = 0.1;

/// Measures what `e` does on data it was not fitted to; `None` measures the model as it is.
///
/// # Errors
/// [`GapError`] when the arm cannot move with the effects.
pub fn prove(
    replayed: &Replayed,
    problem: &Problem,
    e: Option<&Explained>,
) -> Result<Proof, GapError> {
    let before = bridged(&replayed.rows(&[])?);
    let n = before.len();
    let block_of = |k: usize| (0..BLOCKS).rev().find(|b| b * n / BLOCKS <= k).unwrap_or(0);
    let mut after = before.clone();
    let mut whole: Vec<Active> = Vec::new();
    if let Some(e) = e {
        whole = e.fit.active();
        let whole_rows = replayed.rows(&whole)?;
        let misfit = |rows: &[Row], pick: &dyn Fn(usize) -> bool| -> f64 {
            let w = replayed.baseline.noise.innovations(rows);
            let columns = w.column_iter().enumerate();
            columns
                .filter(|(k, _)| pick(*k))
                .map(|(_, c)| c.norm_squared())
                .sum()
        };
        let (_, changes) = problem.folds(&e.fit.residual, &e.fit.columns, &weak_prior(&e.fit));
        for (fold, change) in changes.iter().enumerate().take(FOLDS) {
            let mut at = 0;
            let mut effects = whole.clone();
            for a in &mut effects {
                for (v, p) in a.values.iter_mut().zip(a.effect.parameters) {
                    *v = (*v + change[at]).clamp(p.bounds[0], p.bounds[1]);
                    at += 1;
                }
            }
            // The change is a linear guess. One that cannot be simulated, or does not even suit the
            // blocks it was made from, is dropped for the whole fit.
            let training = |k: usize| block_of(k) % FOLDS != fold;
            let rows = match replayed.rows(&effects) {
                Ok(rows) if misfit(&rows, &training) <= 1.05 * misfit(&whole_rows, &training) => {
                    rows
                }
                _ => whole_rows.clone(),
            };
            let rows = bridged(&rows);
            for k in (0..n).filter(|k| block_of(*k) % FOLDS == fold) {
                after[k] = rows[k];
            }
        }
    }
    let shuffled: Vec<Row> = (0..n)
        .map(|k| {
            let other = (k + n / 2) % n;
            std::array::from_fn(|c| before[k][c] - (before[other][c] - after[other][c]))
        })
        .collect();
    let mut channels = Vec::new();
    for g in groups() {
        if !g.channels.clone().all(|c| replayed.grid.present[c]) {
            continue;
        }
        let size = |rows: &[Row], pick: &dyn Fn(usize) -> bool| {
            let (mut sum, mut count) = (0.0, 0usize);
            for k in (start()..n).filter(|k| pick(*k)) {
                sum += g.channels.clone().map(|c| rows[k][c].powi(2)).sum::<f64>();
                count += 1;
            }
            (sum / count.max(1) as f64).sqrt() * g.factor
        };
        let per_block: Vec<f64> = (0..BLOCKS)
            .map(|b| size(&after, &|k| block_of(k) == b).powi(2))
            .collect();
        let mean = per_block.iter().sum::<f64>() / BLOCKS as f64;
        let var = per_block.iter().map(|x| (x - mean).powi(2)).sum::<f64>()
            / (BLOCKS * (BLOCKS - 1)) as f64;
        let reach = 2.2 * var.sqrt();
        channels.push(ChannelError {
            name: g.name.clone(),
            unit: g.unit.to_owned(),
            before: size(&before, &|_| true),
            after: size(&after, &|_| true),
            after_ci95: [(mean - reach).max(0.0).sqrt(), (mean + reach).sqrt()],
            shuffled: e.map(|_| size(&shuffled, &|_| true)),
            floor: floor(replayed.baseline, &g),
        });
    }
    let worse = channels
        .iter()
        .filter(|c| c.after - c.before > WORSE * c.floor.unwrap_or(c.before))
        .cloned()
        .collect();
    let gap = size_of(&channels, &whole);
    let traces = traces(replayed, &before, &after, &whole)?;
    Ok(Proof {
        gap,
        channels,
        worse,
        traces,
    })
}

fn floor(baseline: &Baseline, g: &Group) -> Option<f64> {
    let square: f64 = g
        .channels
        .clone()
        .map(|c| baseline.channel_floor[c].powi(2))
        .sum();
    square.is_finite().then(|| square.sqrt() * g.factor)
}

/// The group of an effect says nothing of it when it does not exceed its floor by this factor.
const OWN_MIN: f64 = 1.5;

/// The gap in the group that belongs to the (first) effect, or where it is largest.
fn size_of(channels: &[ChannelError], effects: &[Active]) -> GapSize {
    let own = effects.first().and_then(|a| {
        let name = match (a.effect.target, a.target) {
            (Target::Spring, Some(i)) => format!("r3 spring {}", i + 1),
            (Target::Imu, Some(i)) => format!("r4 IMU {}", i + 1),
            (Target::Spring | Target::Imu, None) => return None,
            _ => "r2 tip position".to_owned(),
        };
        channels
            .iter()
            .find(|c| c.name == name && c.before > OWN_MIN * c.floor.unwrap_or(0.0))
    });
    let excess = |c: &ChannelError| c.before / c.floor.unwrap_or(1.0).max(1e-9);
    let largest = channels
        .iter()
        .max_by(|a, b| excess(a).total_cmp(&excess(b)));
    let Some(c) = own.or(largest) else {
        return GapSize::default();
    };
    let floor = c.floor.unwrap_or(0.0);
    GapSize {
        before: c.before,
        after: c.after,
        floor,
        closed: if c.before > floor {
            (c.before - c.after) / (c.before - floor)
        } else {
            0.0
        },
        unit: c.unit.clone(),
    }
}

/// Place (m) and turn (quaternion w, x, y, z) of a pose; not finite where there is none.
fn drawn(pose: &Option<Pose>) -> ([f64; 3], [f64; 4]) {
    pose.map_or(([f64::NAN; 3], [f64::NAN; 4]), |p| {
        let q = p.rotation;
        (p.translation.vector.into(), [q.w, q.i, q.j, q.k])
    })
}

fn traces(
    replayed: &Replayed,
    before: &[Row],
    after: &[Row],
    effects: &[Active],
) -> Result<Traces, GapError> {
    let values = &replayed.baseline.values;
    let grid = replayed.grid;
    let robot = replayed.robot;
    // As motion capture tells them, so that the rig's own frame and clock are no part of the gap.
    let plain = told_poses(robot, grid, replayed.healthy(), values, &[]);
    let moved = move_arm(robot, grid, values, effects)?;
    let patched = told_poses(robot, grid, &moved, values, effects);
    let place = |p: &Pose| drawn(&Some(*p)).0;
    let turn = |p: &Pose| drawn(&Some(*p)).1;
    let (measured_m, measured_turns) = grid.captured.iter().map(drawn).unzip();
    let present: Vec<usize> = (0..CHANNELS).filter(|c| grid.present[*c]).collect();
    let in_floors = |rows: &[Row]| {
        present
            .iter()
            .map(|c| {
                let f = replayed.baseline.channel_floor[*c];
                let f = if f.is_finite() && f > 0.0 { f } else { 1.0 };
                rows.iter().map(|r| r[*c] / f).collect()
            })
            .collect()
    };
    Ok(Traces {
        t_s: grid.t_s.clone(),
        channels: present.iter().map(|c| channel_name(*c)).collect(),
        before: in_floors(before),
        after: in_floors(after),
        measured_m,
        before_m: plain.iter().map(place).collect(),
        after_m: patched.iter().map(place).collect(),
        turns: [
            measured_turns,
            plain.iter().map(turn).collect(),
            patched.iter().map(turn).collect(),
        ],
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_not_captured_is_not_taken_from_the_simulation() {
        let (place, turn) = drawn(&None);
        assert!(place.iter().chain(&turn).all(|v| v.is_nan()));
        let (place, turn) = drawn(&Some(Pose::translation(1.0, 2.0, 3.0)));
        assert_eq!((place, turn), ([1.0, 2.0, 3.0], [1.0, 0.0, 0.0, 0.0]));
    }
}
