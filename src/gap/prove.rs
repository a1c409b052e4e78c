//! Held-out proof: effects are refitted without some blocks, the session is simulated again with
//! them, and the error is taken on the blocks that were left out. A refit that fails proves nothing: its blocks count
//! with the error of the model without the effects, and the effects get no name.

use nalgebra::DVector;

use super::GapError;
use super::commission::Baseline;
use super::explain::{Explained, weak_prior};
use super::finding::{ChannelError, FailedFold, GapSize, Traces, closed};
use super::noise::{bridged, start};
use super::problem::{BLOCKS, FOLDS, Problem, Replayed};
use super::replay::{Row, captured_poses, move_arm};
use super::session::{CHANNELS, IMU_0, SPRING_0, channel_name};
use crate::signal::Pose;
use crate::sim::effects::{Active, Target};

/// Errors on held-out data.
pub struct Proof {
    /// The gap where the effects show best.
    pub gap: GapSize,
    /// All groups.
    pub channels: Vec<ChannelError>,
    /// Those that got worse.
    pub worse: Vec<ChannelError>,
    /// Folds that could not be computed.
    pub failed: Vec<FailedFold>,
    /// For pictures.
    pub traces: Traces,
}

/// A group of channels whose errors are reported together.
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

/// A group that got worse by this share of its noise floor is reported.
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
    let mut failed = Vec::new();
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
        let folds: Vec<_> = changes
            .iter()
            .enumerate()
            .map(|(fold, change)| {
                let training = |k: usize| block_of(k) % FOLDS != fold;
                let rows = fold_rows(
                    &whole,
                    change.as_ref(),
                    &|effects| Ok(replayed.rows(effects)?),
                    &|rows| misfit(rows, &training),
                    &whole_rows,
                );
                rows.map(|rows| bridged(&rows))
            })
            .collect();
        (after, failed) = held_out_rows(&before, &folds, &|k| block_of(k) % FOLDS);
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
        failed,
        traces,
    })
}

/// A refit may be worse on the blocks it was made from by this factor: its change is a linear guess.
const REFIT_MISFIT: f64 = 1.05;

/// The rows of a session with effects.
type Simulate<'a> = dyn Fn(&[Active]) -> Result<Vec<Row>, GapError> + 'a;

/// The arm with the effects `whole` moved by `change`, which was fitted without a fold; `misfit` is the error on the
/// blocks it was fitted to. Why there is none, where there is none: the fit to all blocks is no stand-in, it has seen
/// those that are held out.
fn fold_rows(
    whole: &[Active],
    change: Option<&DVector<f64>>,
    simulate: &Simulate<'_>,
    misfit: &dyn Fn(&[Row]) -> f64,
    whole_rows: &[Row],
) -> Result<Vec<Row>, String> {
    let Some(change) = change else {
        return Err("the effects are indistinguishable on the other blocks".to_owned());
    };
    let mut effects = whole.to_vec();
    let mut moved = change.iter();
    for a in &mut effects {
        for ((v, p), by) in a.values.iter_mut().zip(a.effect.parameters).zip(&mut moved) {
            *v = (*v + by).clamp(p.bounds[0], p.bounds[1]);
        }
    }
    let rows = simulate(&effects).map_err(|e| {
        format!("the arm cannot be simulated with the effects fitted to the other blocks ({e})")
    })?;
    let [refit, all] = [misfit(&rows), misfit(whole_rows)];
    if refit <= REFIT_MISFIT * all {
        return Ok(rows);
    }
    Err(format!(
        "the effects refitted to the other blocks suit these blocks {:.1} times worse than those fitted to all",
        (refit / all).sqrt()
    ))
}

/// Rows as each fold leaves those that it has not seen; a fold that failed leaves them as they were before.
fn held_out_rows(
    before: &[Row],
    folds: &[Result<Vec<Row>, String>],
    fold_of: &dyn Fn(usize) -> usize,
) -> (Vec<Row>, Vec<FailedFold>) {
    let unseen = |(k, row): (usize, &Row)| match &folds[fold_of(k)] {
        Ok(rows) => rows[k],
        Err(_) => *row,
    };
    let rows = before.iter().enumerate().map(unseen).collect();
    let failed = folds.iter().enumerate().filter_map(|(fold, rows)| {
        let reason = rows.as_ref().err()?.clone();
        Some(FailedFold {
            fold: fold + 1,
            of: folds.len(),
            reason,
        })
    });
    (rows, failed.collect())
}

/// Share of the held-out gap that has to close before an effect is named.
const PROVEN_MIN: f64 = 0.5;

/// Why no name is given although the fit found one; `None` when the proof holds.
pub fn withheld(failed: &[FailedFold], closed: f64) -> Option<String> {
    if !failed.is_empty() {
        return Some(format!(
            "No effect is named: {} of {} held-out folds failed, so it is not known whether the effect predicts data it \
             was not fitted to. Record a longer session with more motion.",
            failed.len(),
            FOLDS
        ));
    }
    (closed < PROVEN_MIN).then(|| {
        format!(
            "The best effect of the table closes only {:.0} % of the held-out gap.",
            100.0 * closed
        )
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

/// The group of an effect counts when it exceeds its noise floor by this factor.
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
        closed: closed(c.before, c.after, floor),
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
    // In the frame of the motion capture, so that the rig's own frame and clock are no part of the gap.
    let plain = captured_poses(robot, grid, replayed.healthy(), values, &[]);
    let moved = move_arm(robot, grid, values, effects)?;
    let patched = captured_poses(robot, grid, &moved, values, effects);
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

    const FEW: [f64; CHANNELS] = [0.1; CHANNELS];
    const MANY: [f64; CHANNELS] = [1.0; CHANNELS];

    #[test]
    fn a_fold_that_failed_is_reported_and_does_not_count_as_held_out() {
        let before = vec![MANY; 8];
        let folds = [
            Ok(vec![FEW; 8]),
            Err("the arm folded up".to_owned()),
            Ok(vec![FEW; 8]),
        ];
        let (after, failed) = held_out_rows(&before, &folds, &|k| k % 3);
        for (k, row) in after.iter().enumerate() {
            let wanted = if k % 3 == 1 { MANY } else { FEW };
            assert_eq!(*row, wanted, "row {k}");
        }
        assert_eq!(failed.len(), 1);
        assert_eq!((failed[0].fold, failed[0].of), (2, 3));
        assert_eq!(
            failed[0].text(),
            "Held-out fold 2 of 3 failed, because the arm folded up: its blocks count as without the effect."
        );
    }

    #[test]
    fn a_refit_that_has_no_solution_or_cannot_move_or_does_not_suit_its_own_blocks_fails() {
        let square = |rows: &[Row]| rows.iter().flatten().map(|x| x * x).sum::<f64>();
        let none = DVector::zeros(0);
        let whole_rows = vec![FEW; 4];
        let run = |change: Option<&DVector<f64>>, rows: Result<[f64; CHANNELS], GapError>| {
            let simulate = |_: &[Active]| match &rows {
                Ok(row) => Ok(vec![*row; 4]),
                Err(_) => Err(GapError::Degenerate),
            };
            fold_rows(&[], change, &simulate, &square, &whole_rows)
        };
        assert_eq!(run(Some(&none), Ok(FEW)), Ok(vec![FEW; 4]));
        for (change, rows, words) in [
            (None, Ok(FEW), "indistinguishable"),
            (
                Some(&none),
                Err(GapError::Degenerate),
                "cannot be simulated",
            ),
            (Some(&none), Ok(MANY), "10.0 times worse"),
        ] {
            let why = run(change, rows).expect_err(words);
            assert!(why.contains(words), "{why}");
        }
    }

    #[test]
    fn no_name_is_given_while_a_fold_failed_however_much_the_others_close() {
        let fold = FailedFold {
            fold: 1,
            of: FOLDS,
            reason: "x".to_owned(),
        };
        let why = withheld(std::slice::from_ref(&fold), 0.99).expect("withheld");
        assert!(
            why.contains("1 of") && why.contains("not fitted to"),
            "{why}"
        );
        assert_eq!(withheld(&[], 0.99), None);
        assert!(withheld(&[], 0.3).is_some_and(|w| w.contains("only 30 %")));
    }
}
