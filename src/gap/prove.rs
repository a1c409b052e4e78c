//! Held-out proof. In every fold the effects are chosen and fitted on its training part alone, the session is simulated again
//! with that choice, and the error is taken on the blocks that were held out. A fold that cannot be fitted proves nothing: its
//! blocks count with the error of the model without the effects.
//!
//! The list of effects that are compared comes from the whole session; which of them a fold takes, and every number, from its
//! training part.

use std::borrow::Cow;
use std::ops::Range;

use nalgebra::DVector;

use super::GapError;
use super::commission::Baseline;
use super::config::CONFIG;
use super::describe::T_95;
use super::explain::Explained;
use super::finding::{ChannelError, Confirmed, FailedFold, Finding, FoldChoice, GapSize, Traces};
use super::fit::fit;
use super::folds::{Fold, folds};
use super::noise::bridged;
use super::problem::{Problem, Replayed, Run};
use super::replay::{Row, captured_poses, move_arm};
use super::select::Selected;
use super::session::{CHANNELS, GRID_HZ, Grid, IMU_0, SPRING_0, channel_name};
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
    /// What each fold chose.
    pub folds: Vec<FoldChoice>,
    /// Folds that could not be computed.
    pub failed: Vec<FailedFold>,
    /// What was kept between training and held-out blocks, s.
    pub embargo_s: f64,
    /// Whether the response to the pressures in another order helps as much, although it differs.
    pub helps_anyway: bool,
    /// For pictures.
    pub traces: Traces,
}

/// A group of channels whose errors are reported together.
struct Group {
    name: String,
    channels: Range<usize>,
    unit: &'static str,
    /// Unit per SI unit.
    factor: f64,
}

/// The group of the end pad's position.
pub(super) const TIP: &str = "r2 tip position";

fn groups() -> Vec<Group> {
    let one = |name: String, channels, unit, factor| Group {
        name,
        channels,
        unit,
        factor,
    };
    let deg = 180.0 / std::f64::consts::PI;
    let mut out = vec![
        one(TIP.to_owned(), 0..3, "mm", 1e3),
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

/// What the proof is about.
pub struct Case<'a> {
    /// The session against its baseline.
    pub replayed: &'a Replayed<'a>,
    /// The same as a problem.
    pub problem: &'a Problem<'a>,
    /// Innovations without effects.
    pub r0: &'a DVector<f64>,
    /// What was compared and taken on the whole session.
    pub selected: &'a Selected,
    /// Significance threshold of a gain, nats.
    pub threshold: f64,
    /// What the way from command to gauge has shown; `None` without logged commands or a baseline of the supply.
    pub supply: Option<&'a Finding>,
}

/// Steps of a fit on the training part, which starts at that to the whole session.
const STEPS: usize = 4;

/// Measures what the effects do on data that they were neither chosen by nor fitted to.
///
/// # Errors
/// [`GapError`] when the arm cannot move with the effects.
pub fn prove(case: &Case<'_>) -> Result<Proof, GapError> {
    let Case {
        replayed, selected, ..
    } = *case;
    let e = selected.chosen.as_ref();
    let before = bridged(&replayed.rows(&[])?);
    let n = before.len();
    let mut after = before.clone();
    let (mut choices, mut failed) = (Vec::new(), Vec::new());
    let mut whole: Vec<Active> = Vec::new();
    let mut shuffled = before.clone();
    let mut embargo_s = 0.0;
    let (mut true_order, mut other_order) = (Vec::new(), Vec::new());
    if let Some(e) = e {
        whole = e.fit.active();
        let (folds, embargo) = folds(n, memory(e, replayed.baseline));
        embargo_s = embargo as f64 / GRID_HZ;
        let rows = super::parallel(&folds, |fold| fold_rows(case, fold));
        (after, choices, failed) = held_out_rows(&before, &folds, rows);
        true_order = response(replayed, &before, &whole)?;
        other_order = redriven(replayed, &whole)?;
        for (row, by) in shuffled.iter_mut().zip(&other_order) {
            row.iter_mut().zip(by).for_each(|(x, by)| *x -= by);
        }
    }
    let channels = errors(replayed, &before, &after, e.map(|_| &shuffled[..]));
    let worse = channels
        .iter()
        .filter(|c| c.after - c.before > CONFIG.worse * c.floor.unwrap_or(c.before))
        .cloned()
        .collect();
    let gap = size_of(&channels, &whole);
    let helps_anyway = e.is_some()
        && helps(
            [&before, &true_order, &other_order],
            &replayed.judged(),
            &per_floor(replayed),
        );
    let traces = traces(replayed, &before, &after, &whole)?;
    Ok(Proof {
        gap,
        worse,
        folds: choices,
        failed,
        embargo_s,
        helps_anyway,
        traces,
        channels,
    })
}

/// Errors of every group of channels before and after the effects, and with them under other pressures.
fn errors(
    replayed: &Replayed,
    before: &[Row],
    after: &[Row],
    shuffled: Option<&[Row]>,
) -> Vec<ChannelError> {
    let n = before.len();
    let (judged, present) = (replayed.judged(), replayed.present());
    let block_of = |k: usize| {
        (0..CONFIG.blocks)
            .rev()
            .find(|b| b * n / CONFIG.blocks <= k)
            .unwrap_or(0)
    };
    let mut channels = Vec::new();
    for g in groups() {
        if !g.channels.clone().all(|c| present[c]) {
            continue;
        }
        let size = |rows: &[Row], pick: &dyn Fn(usize) -> bool| {
            let (mut sum, mut count) = (0.0, 0usize);
            for k in judged.iter().filter(|k| pick(**k)) {
                let row = &rows[*k];
                sum += g.channels.clone().map(|c| row[c].powi(2)).sum::<f64>();
                count += 1;
            }
            (sum / count.max(1) as f64).sqrt() * g.factor
        };
        let per_block: Vec<f64> = (0..CONFIG.blocks)
            .map(|b| size(after, &|k| block_of(k) == b).powi(2))
            .collect();
        let mean = per_block.iter().sum::<f64>() / CONFIG.blocks as f64;
        let var = per_block.iter().map(|x| (x - mean).powi(2)).sum::<f64>()
            / (CONFIG.blocks * (CONFIG.blocks - 1)) as f64;
        let reach = T_95 * var.sqrt();
        channels.push(ChannelError {
            name: g.name.clone(),
            unit: g.unit.to_owned(),
            before: size(before, &|_| true),
            after: size(after, &|_| true),
            after_ci95: [(mean - reach).max(0.0).sqrt(), (mean + reach).sqrt()],
            shuffled: shuffled.map(|rows| size(rows, &|_| true)),
            floor: floor(replayed.baseline, &g),
        });
    }
    channels
}

/// Measures what effects do in sessions that had no part in finding them.
///
/// # Errors
/// [`GapError`] when the arm cannot follow them.
pub fn confirm(replayed: &Replayed, effects: &[Active]) -> Result<Confirmed, GapError> {
    let before = bridged(&replayed.rows(&[])?);
    let after = bridged(&replayed.rows(effects)?);
    let channels = errors(replayed, &before, &after, None);
    let gap = size_of(&channels, effects);
    let runs = replayed.runs.iter();
    let sessions = runs.map(|r| r.grid.session.name.clone()).collect();
    Ok(Confirmed::of(sessions, gap, channels, TIP))
}

/// How long the slowest thing in play is remembered, bins: the healthy rig's residuals, or an effect.
fn memory(e: &Explained, baseline: &Baseline) -> usize {
    let of_effect = |(c, values): &(super::candidates::Candidate, Vec<f64>)| {
        c.effect.memory.map_or(0.0, |i| values[i] * GRID_HZ)
    };
    let effects = e.fit.effects.iter().map(of_effect).fold(0.0, f64::max);
    // Σφᵏ = 1/(1 − φ) rows, half of (1 + φ)/(1 − φ) for what is slow.
    let residuals = 0.5 * baseline.noise.correlation_rows();
    effects.max(residuals).ceil() as usize
}

/// What a fold leaves of the session, with what it chose: `None` where nothing gained enough.
type FoldRows = Result<(Vec<Row>, Vec<(String, Option<usize>)>), String>;

/// The session with the effects chosen and fitted on the fold's training part; why there is none, where there is none.
fn fold_rows(case: &Case<'_>, fold: &Fold) -> FoldRows {
    let bins: Vec<usize> = fold.training.iter().cloned().flatten().collect();
    let part = case
        .problem
        .part(&fold.training)
        .map_err(|e| e.to_string())?;
    let chosen = case.selected.chosen_on(
        (&part, &bins),
        (case.problem, case.r0),
        case.threshold,
        case.supply,
    );
    let (mut active, mut names) = (Vec::new(), Vec::new());
    if let Some(e) = chosen {
        let Some(refit) = fit(&part, e.fit.effects, STEPS) else {
            return Err("the effects cannot be fitted to the other blocks".to_owned());
        };
        active = refit.active();
        let name = |a: &Active| (a.effect.id.to_owned(), a.target.map(|t| t + 1));
        names = active.iter().map(name).collect();
    }
    let rows = case.replayed.rows(&active).map_err(|e| {
        format!("the arm cannot be simulated with the effects fitted to the other blocks ({e})")
    })?;
    Ok((bridged(&rows), names))
}

/// Rows as each fold leaves those that it has not seen, and what each chose; a fold that failed leaves them as they were
/// before.
fn held_out_rows(
    before: &[Row],
    folds: &[Fold],
    rows: Vec<FoldRows>,
) -> (Vec<Row>, Vec<FoldChoice>, Vec<FailedFold>) {
    let mut after = before.to_vec();
    let (mut choices, mut failed) = (Vec::new(), Vec::new());
    for (i, (fold, result)) in folds.iter().zip(rows).enumerate() {
        match result {
            Ok((rows, effects)) => {
                for k in fold.held.iter().cloned().flatten() {
                    after[k] = rows[k];
                }
                choices.push(FoldChoice {
                    fold: i + 1,
                    effects,
                });
            }
            Err(reason) => failed.push(FailedFold {
                fold: i + 1,
                of: folds.len(),
                reason,
            }),
        }
    }
    (after, choices, failed)
}

/// What the effects change in the predicted readings of a session that leaves `without` without them.
fn response(here: &Replayed, without: &[Row], effects: &[Active]) -> Result<Vec<Row>, GapError> {
    let with = bridged(&here.rows(effects)?);
    let change = |(a, b): (&Row, &Row)| std::array::from_fn(|c| a[c] - b[c]);
    Ok(without.iter().zip(&with).map(change).collect())
}

/// The same when the pressures of every session come in another order: the second half, then the first.
fn redriven(replayed: &Replayed, effects: &[Active]) -> Result<Vec<Row>, GapError> {
    let run = |run: &Run| -> Result<Run<'static>, GapError> {
        let mut grid = Grid::clone(&run.grid);
        let half = grid.gauge_pa.len() / 2;
        grid.gauge_pa.rotate_left(half);
        Ok(Run {
            values: run.values.clone(),
            between: run.between.clone(),
            healthy: move_arm(replayed.robot, &grid, &run.values, &[])?,
            grid: Cow::Owned(grid),
        })
    };
    let runs = replayed.runs.iter().map(run);
    let other = Replayed {
        runs: runs.collect::<Result<_, _>>()?,
        ..*replayed
    };
    response(&other, &bridged(&other.rows(&[])?), effects)
}

/// What a unit of every channel weighs: one over its floor; 0 where it was not measured.
fn per_floor(replayed: &Replayed) -> Row {
    let present = replayed.present();
    std::array::from_fn(|c| {
        let floor = replayed.baseline.channel_floor[c];
        let counts = present[c] && floor.is_finite() && floor > 0.0;
        if counts { 1.0 / floor } else { 0.0 }
    })
}

/// Whether what varies of a response helps under the pressures in another order as well: beyond its mean, which a constant
/// load, frame or offset has under any pressures. All channels count, as in one alone two orders may be alike by chance.
fn helps([before, own, other]: [&[Row]; 3], judged: &[usize], weights: &Row) -> bool {
    let (mut by_mean, mut by_own, mut by_other) = (0.0, 0.0, 0.0);
    let (mut varies, mut apart) = (0.0, 0.0);
    for (c, weight) in weights.iter().enumerate().filter(|(_, w)| **w > 0.0) {
        let mean = |rows: &[Row]| {
            judged.iter().map(|k| rows[*k][c]).sum::<f64>() / judged.len().max(1) as f64
        };
        let (own_mean, other_mean) = (mean(own), mean(other));
        let square = |x: f64| (x * weight).powi(2);
        for &k in judged {
            let left = before[k][c] - own_mean;
            by_mean += square(left);
            by_own += square(before[k][c] - own[k][c]);
            let (own, other) = (own[k][c] - own_mean, other[k][c] - other_mean);
            by_other += square(left - other);
            varies += square(own);
            apart += square(own - other);
        }
    }
    log::debug!(
        "control: left by the mean {by_mean:.3e}, in the own order {by_own:.3e}, in another {by_other:.3e}; the response varies \
         by {varies:.3e} and differs by {apart:.3e}"
    );
    // What depends on the time alone, as a drift does, is the same under any pressures.
    let differs = apart > CONFIG.same_response.powi(2) * varies;
    let matters = by_mean - by_own > CONFIG.varying_min * by_mean;
    differs && matters && by_mean - by_other > CONFIG.control_max * (by_mean - by_own)
}

impl Proof {
    /// How many folds chose an effect on a channel (1-based; `None`: all of them, or there are none).
    pub fn support(&self, id: &str, target: Option<usize>) -> usize {
        self.folds.iter().filter(|f| f.chose(id, target)).count()
    }

    /// Whether enough folds chose an effect on a channel (as in [`Self::support`]).
    pub fn supports(&self, id: &str, target: Option<usize>) -> bool {
        self.support(id, target) >= CONFIG.folds_min
    }

    /// Whether the gap exceeds its floor by so much that an effect can be named for it.
    pub fn shows(&self) -> bool {
        self.gap.before > CONFIG.own_group_min * self.gap.floor
    }

    /// Why no name is given although the fit found one; `None` when the proof holds.
    pub fn withheld(&self) -> Option<String> {
        if self.failed.len() > CONFIG.folds - CONFIG.folds_min {
            return Some(format!(
                "No effect is named: {} of {} held-out folds failed, so it is not known whether the effect predicts data \
                 it was not fitted to. Record a longer session with more motion.",
                self.failed.len(),
                CONFIG.folds,
            ));
        }
        if self.helps_anyway {
            return Some(
                "No effect is named: the best one explains as much when it is driven by the pressures in another order, so it \
                 does not depend on them as it should."
                    .to_owned(),
            );
        }
        (self.gap.closed < CONFIG.proven_min).then(|| {
            format!(
                "The best effect of the table closes only {:.0} % of the held-out gap.",
                100.0 * self.gap.closed.max(0.0)
            )
        })
    }
}

fn floor(baseline: &Baseline, g: &Group) -> Option<f64> {
    let square: f64 = g
        .channels
        .clone()
        .map(|c| baseline.channel_floor[c].powi(2))
        .sum();
    square.is_finite().then(|| square.sqrt() * g.factor)
}

/// The gap in the group that belongs to the (first) effect, or where it is largest.
fn size_of(channels: &[ChannelError], effects: &[Active]) -> GapSize {
    let own = effects.first().and_then(|a| {
        let name = match (a.effect.target, a.target) {
            (Target::Spring, Some(i)) => format!("r3 spring {}", i + 1),
            (Target::Imu, Some(i)) => format!("r4 IMU {}", i + 1),
            (Target::Spring | Target::Imu, None) => return None,
            _ => TIP.to_owned(),
        };
        channels
            .iter()
            .find(|c| c.name == name && c.before > CONFIG.own_group_min * c.floor.unwrap_or(0.0))
    });
    let excess = |c: &ChannelError| c.before / c.floor.unwrap_or(1.0).max(1e-9);
    let largest = channels
        .iter()
        .max_by(|a, b| excess(a).total_cmp(&excess(b)));
    let Some(c) = own.or(largest) else {
        return GapSize::default();
    };
    GapSize::from(c)
}

/// Place (m) and turn (quaternion w, x, y, z) of a pose; not finite where there is none.
fn drawn(pose: &Option<Pose>) -> ([f64; 3], [f64; 4]) {
    pose.map_or(([f64::NAN; 3], [f64::NAN; 4]), |p| {
        let q = p.rotation;
        (p.translation.vector.into(), [q.w, q.i, q.j, q.k])
    })
}

/// Series of a session without effects.
///
/// # Errors
/// [`GapError`] when the arm cannot follow it.
pub fn traces_before(replayed: &Replayed) -> Result<Traces, GapError> {
    let before = bridged(&replayed.rows(&[])?);
    traces(replayed, &before, &before, &[])
}

fn traces(
    replayed: &Replayed,
    before: &[Row],
    after: &[Row],
    effects: &[Active],
) -> Result<Traces, GapError> {
    let robot = replayed.robot;
    let (mut plain, mut patched) = (Vec::new(), Vec::new());
    // In the frame of the motion capture, so that the rig's own frame and clock are no part of the gap.
    for run in &replayed.runs {
        let (grid, values) = (&run.grid, &run.values[..]);
        plain.extend(captured_poses(robot, grid, &run.healthy, values, &[]));
        let moved = run.moved(robot, effects)?;
        let moved = moved.as_ref().unwrap_or(&run.healthy);
        patched.extend(captured_poses(robot, grid, moved, values, effects));
    }
    let place = |p: &Pose| drawn(&Some(*p)).0;
    let turn = |p: &Pose| drawn(&Some(*p)).1;
    let captured = replayed.runs.iter().flat_map(|r| &r.grid.captured);
    let (measured_m, measured_turns) = captured.map(drawn).unzip();
    let all = replayed.present();
    let present: Vec<usize> = (0..CHANNELS).filter(|c| all[*c]).collect();
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
        t_s: replayed.t_s(),
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
        tension: None,
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
        let before = vec![MANY; 240];
        let (folds, _) = folds(before.len(), 0);
        let ok = || Ok((vec![FEW; 240], vec![("x".to_owned(), Some(1))]));
        let rows = vec![ok(), Err("the arm folded up".to_owned()), ok(), ok()];
        let (after, choices, failed) = held_out_rows(&before, &folds, rows);
        for (k, row) in after.iter().enumerate() {
            let wanted = if folds[1].holds_out(k) { MANY } else { FEW };
            assert_eq!(*row, wanted, "row {k}");
        }
        assert_eq!(failed.len(), 1);
        assert_eq!((failed[0].fold, failed[0].of), (2, CONFIG.folds));
        assert_eq!(
            failed[0].text(),
            "Held-out fold 2 of 4 failed, because the arm folded up: its blocks count as without the effect."
        );
        let mut proof = Proof {
            gap: GapSize {
                closed: 0.9,
                ..GapSize::default()
            },
            channels: Vec::new(),
            worse: Vec::new(),
            folds: choices,
            failed,
            embargo_s: 0.0,
            helps_anyway: false,
            traces: Traces::default(),
        };
        // Three folds chose it and one failed.
        assert_eq!(proof.support("x", Some(1)), 3);
        assert!(proof.supports("x", Some(1)) && !proof.supports("x", None));
        assert_eq!(proof.withheld(), None);
        proof.folds.pop();
        assert!(!proof.supports("x", Some(1)));
        proof.failed.push(proof.failed[0].clone());
        assert!(proof.withheld().is_some_and(|w| w.contains("2 of 4")));
        proof.failed.clear();
        proof.gap.closed = 0.3;
        assert!(proof.withheld().is_some_and(|w| w.contains("only 30 %")));
        proof.gap.closed = 0.9;
        proof.helps_anyway = true;
        assert!(
            proof
                .withheld()
                .is_some_and(|w| w.contains("another order"))
        );
    }

    /// A constant helps under any pressures and is no fault of it; a swing helps in its own order only, unless what it is
    /// compared with swings alike.
    #[test]
    fn the_control_judges_what_varies() {
        let swing = |late: i32| -> Vec<Row> {
            let at = |k: i32| 2.0 + (f64::from(k + late) * 0.3).sin();
            (0..100).map(|k| [at(k); CHANNELS]).collect()
        };
        let constant = vec![MANY; 100];
        let judged: Vec<usize> = (10..100).collect();
        let helped = |before: &[Row], own: &[Row], other: &[Row]| {
            helps([before, own, other], &judged, &[1.0; CHANNELS])
        };
        assert!(!helped(&constant, &constant, &constant));
        assert!(!helped(&swing(0), &swing(0), &swing(10)));
        assert!(helped(&swing(0), &swing(0), &swing(2)));
        let ramp: Vec<Row> = (0..100).map(|k| [f64::from(k); CHANNELS]).collect();
        assert!(!helped(&ramp, &ramp, &ramp));
        // Of a constant alone nothing follows.
        assert!(!helped(&swing(0), &vec![[2.0; CHANNELS]; 100], &constant));
    }
}
