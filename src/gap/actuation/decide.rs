//! The verdict on a pressure log, its figures and its proof.

use std::collections::BTreeMap;

use nalgebra::DMatrix;

use super::healthy::{LineBaseline, LineModel, PRIOR, commission_supply, ideal_supply};
use super::line::{
    GAIN, KNOBS, Lag, LineRow, OFFSET, PressureGrid, Regulator, gauge_pressures, line_rmse_pa,
    line_rows,
};
use super::search::{EffectSet, Stages, same, supply_stages};
use crate::gap::explain::{Explained, form_sd};
use crate::gap::finding::{
    ChannelError, Finding, FoundEffect, GapSize, Located, Ranked, SeparateBy, Traces, Verdict,
};
use crate::gap::fit::fit;
use crate::gap::patch::PatchValue;
use crate::gap::problem::{BLOCKS, FOLDS};
use crate::gap::{GapError, Progress, Stage};
use crate::robot::RobotSpec;
use crate::signal::CHAMBERS;
use crate::sim::effects::Side;

/// Margins below this many standard errors separate nothing.
const MARGIN_SE: f64 = 2.0;
/// Mean squares beyond so many times what healthy sessions reach are something.
const ABOVE_FLOOR: f64 = 2.0;
/// Share of the gap that a named effect closes at least.
const CLOSES: f64 = 0.5;
/// Gauges that differ more than this from their pressures are mentioned: gain, offset (Pa).
const GAUGE_OFF: [f64; 2] = [0.08, 5e3];

/// A finding on pressures alone.
#[derive(Clone, Debug)]
pub struct Actuation {
    /// The finding.
    pub finding: Finding,
    /// What it was taken from.
    pub stages: Option<Stages>,
    /// Test on other sessions.
    pub proof: Vec<Proof>,
}

/// Error on a session that was not fitted.
#[derive(Clone, Debug, PartialEq)]
pub struct Proof {
    /// The session.
    pub session: String,
    /// Root mean square over the chambers without the effects, Pa.
    pub rmse_before_pa: f64,
    /// With them.
    pub rmse_after_pa: f64,
}

/// What is missing between command and gauge, for sessions that hold nothing else. `healthy` is a
/// session of the same supply in order; without it the ideal supply is the measure. The result is
/// tested on the sessions of `proof`. Effects in `without` (ids) are left out of the table.
///
/// # Errors
/// [`GapError`] when stopped, or numbers are not finite.
pub fn actuation_only(
    robot: &RobotSpec,
    healthy: Option<&PressureGrid>,
    suspect: &PressureGrid,
    proof: &[PressureGrid],
    without: &[String],
    progress: &dyn Progress,
) -> Result<Actuation, GapError> {
    progress.at(Stage::Commission, 0.0)?;
    let baseline = match healthy {
        Some(grid) => commission_supply(robot, grid)?,
        None => ideal_supply(suspect),
    };
    if !suspect.moves() {
        return Ok(Actuation {
            finding: still(suspect, &baseline),
            stages: None,
            proof: Vec::new(),
        });
    }
    let found = supply_stages(
        robot,
        suspect,
        &baseline,
        Lag::BeforeGauge,
        without,
        progress,
    )?;
    progress.at(Stage::Decide, 0.0)?;
    let finding = decide_supply(robot, suspect, &baseline, Lag::BeforeGauge, &found)?;
    progress.at(Stage::Prove, 0.0)?;
    let proof = proof
        .iter()
        .map(|grid| prove_supply(robot, grid, &baseline, &found))
        .collect();
    Ok(Actuation {
        finding,
        stages: Some(found),
        proof,
    })
}

/// Error of another session without effects and with the best set, nothing fitted to it. Of gauge
/// departures that were fitted beside the effects, the share that is expected to last is carried.
pub fn prove_supply(
    robot: &RobotSpec,
    grid: &PressureGrid,
    baseline: &LineBaseline,
    found: &Stages,
) -> Proof {
    let error = |base: &LineBaseline, set: Option<&EffectSet>| {
        let effects = set.map_or_else(Vec::new, |s| s.explained.fit.active());
        let mut regulators = base.regulators;
        if baseline.healthy.is_none() {
            regulators = regulators.map(lasting);
        }
        let p = gauge_pressures(robot, grid, &regulators, &effects, Lag::BeforeGauge);
        line_rmse_pa(grid, &line_rows(grid, &p), |_| true)
    };
    let best = found.sets.first();
    Proof {
        session: grid.log.name.clone(),
        rmse_before_pa: error(baseline, None),
        rmse_after_pa: error(best.map_or(baseline, |s| &s.baseline), best),
    }
}

/// How far the gauge of an unknown supply wanders from day to day: gain, offset (Pa).
const DAY: [f64; 2] = [0.04, 2e3];

/// What one session tells of a gauge on another day. Its departure there is a lasting part of
/// standard deviation σ plus one of the day, δ: of what was seen, σ²/(σ² + δ²) is expected to last.
fn lasting(seen: Regulator) -> Regulator {
    let mut out = seen;
    for (k, day) in [GAIN, OFFSET].into_iter().zip(DAY) {
        let nominal = Regulator::default().0[k];
        let [lasts, varies] = [PRIOR[k], day].map(|sd| sd * sd);
        out.0[k] = nominal + lasts / (lasts + varies) * (seen.0[k] - nominal);
    }
    out
}

/// The verdict, with its figures.
///
/// # Errors
/// [`GapError::Degenerate`] when numbers are not finite.
pub fn decide_supply(
    robot: &RobotSpec,
    grid: &PressureGrid,
    baseline: &LineBaseline,
    lag: Lag,
    found: &Stages,
) -> Result<Finding, GapError> {
    let commissioned = baseline.healthy.is_some();
    let model = LineModel {
        robot,
        grid,
        baseline: baseline.clone(),
        lag,
        seen: None,
    };
    let before = model.rows(&[]);
    let best = found.sets.first();
    let after = match best {
        Some(set) => unseen(&model, set, commissioned)?,
        None => before.clone(),
    };
    let floor_pa = baseline.floor_pa.unwrap_or_else(|| scatter_pa(grid));
    let gap = gap_size(grid, &before, &after, floor_pa);
    let alternatives = best.map_or_else(Vec::new, |b| alternatives(b, found));
    let located = located(grid, &before);
    let limit = ABOVE_FLOOR * found.chance.mean_square;
    let verdict = match best {
        None if commissioned && found.mean_square > limit => Verdict::Unknown,
        None => Verdict::NothingMissing,
        Some(set) => {
            let above = !commissioned || set.mean_square > limit;
            let fails = above && gap.closed < CLOSES;
            if fails || at_bound(&set.explained) {
                Verdict::Unknown
            } else if alternatives.is_empty() {
                Verdict::Named
            } else {
                Verdict::Indistinguishable
            }
        }
    };
    let mut effects = Vec::new();
    if let (Verdict::Named | Verdict::Indistinguishable, Some(set)) = (verdict, best) {
        add_effects(&mut effects, &model, set)?;
        for other in &alternatives {
            add_effects(&mut effects, &model, other)?;
        }
    }
    let notes = notes(grid, baseline, found, verdict, &located);
    let channels = channels(grid, &before, &after, baseline);
    let mut data = BTreeMap::from([("suspect".to_owned(), label(grid))]);
    if let Some([name, hash]) = &baseline.session {
        data.insert(
            "baseline".to_owned(),
            format!("{name} {hash}").trim().to_owned(),
        );
    }
    Ok(Finding {
        verdict,
        separate_by: (verdict == Verdict::Indistinguishable).then(|| separate(&effects)),
        effects,
        candidates: ranked(best, found),
        threshold: found.chance.gain,
        located,
        gap,
        worse: channels
            .iter()
            .filter(|c| c.after > c.before)
            .cloned()
            .collect(),
        channels,
        notes,
        data,
        seconds: 0.0,
        traces: traces(grid, &before, &after, floor_pa),
    })
}

fn label(grid: &PressureGrid) -> String {
    format!("{} {}", grid.log.name, grid.log.hash)
        .trim()
        .to_owned()
}

fn still(grid: &PressureGrid, baseline: &LineBaseline) -> Finding {
    let model_rows = line_rows(grid, &grid.commanded_pa);
    let size = line_rmse_pa(grid, &model_rows, |_| true);
    Finding {
        verdict: Verdict::NotExcited,
        effects: Vec::new(),
        candidates: Vec::new(),
        threshold: 0.0,
        located: Vec::new(),
        gap: GapSize {
            before: size / 1e3,
            after: size / 1e3,
            floor: baseline.floor_pa.unwrap_or(size) / 1e3,
            closed: 0.0,
            unit: "kPa".to_owned(),
        },
        worse: Vec::new(),
        channels: Vec::new(),
        separate_by: Some(SeparateBy {
            excitation: "steps".to_owned(),
            effects: Vec::new(),
            why: "no command moves: drive the chambers through their range".to_owned(),
        }),
        notes: Vec::new(),
        data: BTreeMap::from([("suspect".to_owned(), label(grid))]),
        seconds: 0.0,
        traces: Traces::default(),
    }
}

/// Everything that was compared with the best set, best first.
fn ranked(best: Option<&EffectSet>, found: &Stages) -> Vec<Ranked> {
    let mut out: Vec<Ranked> = Vec::new();
    let named = |e: &Explained, gain: f64, se: f64| Ranked {
        id: e
            .fit
            .effects
            .iter()
            .map(|(c, _)| c.effect.id)
            .collect::<Vec<_>>()
            .join(" + "),
        target: match &e.fit.effects[..] {
            [(c, _)] => c.target.map(|t| t + 1),
            _ => None,
        },
        gain,
        se,
    };
    let sets = found.sets.iter().map(|s| &s.explained);
    for e in sets.chain(found.stages.first().into_iter().flatten()) {
        let (gain, se) = e.losses.gain_over(&found.losses);
        out.push(named(e, gain, se));
    }
    let first = best.map_or(0, |_| 1).min(out.len());
    out[first..].sort_by(|a, b| b.gain.total_cmp(&a.gain));
    let mut seen: Vec<(String, Option<usize>)> = Vec::new();
    out.retain(|r| {
        let key = (r.id.clone(), r.target);
        let new = !seen.contains(&key);
        seen.push(key);
        new
    });
    out
}

/// Sets that the best one does not beat by more than two standard errors.
fn alternatives(best: &EffectSet, found: &Stages) -> Vec<EffectSet> {
    // Each block by its own scale, ln(loss/loss): what even the best leaves over is larger where
    // more happens, and a single block would decide.
    let per_block = best.explained.fit.residual.len() as f64 / BLOCKS as f64;
    let close = |e: &Explained| {
        let logs: Vec<f64> = (e.losses.0.iter().zip(&best.explained.losses.0))
            .map(|(other, best)| ((other + 0.5 * per_block) / (best + 0.5 * per_block)).ln())
            .collect();
        let n = logs.len() as f64;
        let margin = logs.iter().sum::<f64>() / n;
        let var = logs.iter().map(|d| (d - margin).powi(2)).sum::<f64>() / (n - 1.0);
        margin <= MARGIN_SE * (var / n).sqrt()
    };
    // A wordier set that explains no more would do so by coincidence.
    let numbers = |e: &Explained| e.fit.parameters().len();
    let most = numbers(&best.explained);
    let close =
        |e: &Explained| numbers(e) <= most && !same_but_for_reach(e, &best.explained) && close(e);
    let mut out: Vec<EffectSet> = found
        .sets
        .iter()
        .filter(|s| !same(&s.explained, &best.explained) && close(&s.explained))
        .cloned()
        .collect();
    let size = best.explained.fit.effects.len();
    for e in found.stages.get(size - 1).into_iter().flatten() {
        let (gain, _) = e.losses.gain_over(&found.losses);
        let known = same(e, &best.explained) || out.iter().any(|s| same(&s.explained, e));
        if e.fit.effects.len() == size && !known && gain > found.chance.gain && close(e) {
            out.push(EffectSet {
                explained: e.clone(),
                baseline: best.baseline.clone(),
                mean_square: e.fit.cost / e.fit.residual.len() as f64,
            });
        }
    }
    out
}

/// Whether two sets name the same effects, one in all chambers and the other in those that show it:
/// the name is the same, and chambers that were not driven hard enough say nothing.
fn same_but_for_reach(a: &Explained, b: &Explained) -> bool {
    let covered = |a: &Explained, b: &Explained| {
        a.fit.effects.iter().all(|(c, _)| {
            b.fit.effects.iter().any(|(d, _)| {
                c.effect.id == d.effect.id
                    && (c.target == d.target || c.target.is_none() || d.target.is_none())
            })
        })
    };
    covered(a, b) && covered(b, a)
}

/// Whether a parameter rests on a bound that does not mean "no effect".
fn at_bound(e: &Explained) -> bool {
    let mut at = 0;
    e.fit.effects.iter().any(|(c, values)| {
        c.effect.parameters.iter().zip(values).any(|(p, v)| {
            let held = e.fit.on_bound[at];
            at += 1;
            held && *v != p.nominal
        })
    })
}

/// Appends the effects of a set that are not there yet, with intervals.
fn add_effects(
    out: &mut Vec<FoundEffect>,
    model: &LineModel,
    set: &EffectSet,
) -> Result<(), GapError> {
    let fitted = LineModel {
        baseline: set.baseline.clone(),
        ..model.clone()
    };
    let e = &set.explained;
    let problem = fitted.problem(&e.fit.active())?;
    let j = &e.fit.columns;
    let r = DMatrix::from_column_slice(j.nrows(), 1, e.fit.residual.as_slice());
    let clean = problem.cleaned(&r);
    let mut h = problem.product(j, j);
    for i in 0..h.nrows() {
        h[(i, i)] += 1e-12 + 1e-9 * h[(i, i)];
    }
    let inverse = h.cholesky().ok_or(GapError::Degenerate)?.inverse();
    // What the blocks say one by one counts as well: transients are not normal.
    let jc = problem.cleaned(j);
    let mut scores = DMatrix::zeros(j.ncols(), j.ncols());
    for w in fitted.edges().windows(2) {
        let (from, n) = (w[0], w[1] - w[0]);
        let g = jc.rows(from, n).tr_mul(&clean.rows(from, n));
        scores += &g * g.transpose();
    }
    let robust = &inverse * scores * &inverse;
    let mut at = 0;
    for (candidate, values) in &e.fit.effects {
        let params = candidate
            .effect
            .parameters
            .iter()
            .zip(values)
            .map(|(p, v)| {
                let model_var = inverse[(at, at)] * set.mean_square.max(1.0);
                let form = form_sd(candidate.effect, p, *v);
                let sd = model_var.max(robust[(at, at)]).sqrt().hypot(form);
                let held = e.fit.on_bound[at];
                at += 1;
                let ci95 = (!held).then(|| {
                    [
                        (v - 1.96 * sd).max(p.bounds[0]),
                        (v + 1.96 * sd).min(p.bounds[1]),
                    ]
                });
                let value = PatchValue {
                    value: *v,
                    unit: p.unit.to_owned(),
                    ci95,
                };
                (p.name.to_owned(), value)
            })
            .collect();
        let target = candidate.target.map(|t| t + 1);
        if out
            .iter()
            .any(|f| f.id == candidate.effect.id && f.target == target)
        {
            continue;
        }
        out.push(FoundEffect {
            id: candidate.effect.id.to_owned(),
            side: match candidate.effect.side {
                Side::Actuation => "actuation",
                Side::Mechanics => "mechanics",
                Side::Sensing => "sensing",
                Side::FrameAndTime => "frame and time",
            }
            .to_owned(),
            target,
            params,
        });
    }
    Ok(())
}

/// Residual rows, each as a fit to the other folds leaves it.
fn unseen(
    model: &LineModel,
    set: &EffectSet,
    commissioned: bool,
) -> Result<Vec<LineRow>, GapError> {
    let bins = model.grid.len();
    let fold_of: Vec<usize> = (0..BLOCKS)
        .flat_map(|b| {
            let bins_of_b = b * bins / BLOCKS..(b + 1) * bins / BLOCKS;
            bins_of_b.map(move |_| b % FOLDS)
        })
        .collect();
    let mut out = vec![[0.0; CHAMBERS]; bins];
    for fold in 0..FOLDS {
        let mut m = LineModel {
            baseline: set.baseline.clone(),
            seen: Some(fold_of.iter().map(|f| *f != fold).collect()),
            ..model.clone()
        };
        let mut effects = set.explained.fit.effects.clone();
        for _ in 0..2 {
            let active: Vec<_> = effects.iter().map(|(c, v)| c.with(v)).collect();
            if !commissioned {
                m.refit_regulators(&active)?;
            }
            let problem = m.problem(&active)?;
            if let Some(f) = fit(&problem, effects.clone(), 6) {
                effects = f.effects;
            }
        }
        let active: Vec<_> = effects.iter().map(|(c, v)| c.with(v)).collect();
        for (k, row) in m.rows(&active).into_iter().enumerate() {
            if fold_of[k] == fold {
                out[k] = row;
            }
        }
    }
    Ok(out)
}

/// How much gauges scatter while their commands rest: about the mean of each rest, from 4 s after
/// the last change on, Pa.
fn scatter_pa(grid: &PressureGrid) -> f64 {
    const SETTLED: usize = (4.0 * super::line::LINE_HZ) as usize;
    let (mut sum, mut n) = (0.0, 0usize);
    for i in grid.chambers() {
        let mut rest: Vec<f64> = Vec::new();
        let mut since = 0;
        let mut close = |rest: &mut Vec<f64>| {
            let mean = rest.iter().sum::<f64>() / rest.len().max(1) as f64;
            sum += rest.iter().map(|p| (p - mean).powi(2)).sum::<f64>();
            n += rest.len();
            rest.clear();
        };
        for k in 1..grid.len() {
            if (grid.commanded_pa[k][i] - grid.commanded_pa[k - 1][i]).abs() > 1.0 {
                since = k;
                close(&mut rest);
            } else if k - since > SETTLED {
                rest.push(grid.measured_pa[k][i]);
            }
        }
        close(&mut rest);
    }
    (sum / n.max(1) as f64).sqrt()
}

fn gap_size(grid: &PressureGrid, before: &[LineRow], after: &[LineRow], floor_pa: f64) -> GapSize {
    let [before, after, floor] = [
        line_rmse_pa(grid, before, |_| true),
        line_rmse_pa(grid, after, |_| true),
        floor_pa,
    ]
    .map(|pa| pa / 1e3);
    GapSize {
        before,
        after,
        floor,
        closed: (before - after) / (before - floor).max(1e-9),
        unit: "kPa".to_owned(),
    }
}

fn channels(
    grid: &PressureGrid,
    before: &[LineRow],
    after: &[LineRow],
    baseline: &LineBaseline,
) -> Vec<ChannelError> {
    let bins = grid.len();
    let rms = |rows: &[LineRow], i: usize| {
        (rows.iter().map(|r| r[i] * r[i]).sum::<f64>() / rows.len().max(1) as f64).sqrt() / 1e3
    };
    grid.chambers()
        .into_iter()
        .map(|i| {
            let squares: Vec<f64> = (0..BLOCKS)
                .map(|b| rms(&after[b * bins / BLOCKS..(b + 1) * bins / BLOCKS], i).powi(2))
                .collect();
            let mean = squares.iter().sum::<f64>() / BLOCKS as f64;
            let var = squares.iter().map(|s| (s - mean).powi(2)).sum::<f64>()
                / (BLOCKS * (BLOCKS - 1)) as f64;
            let half = 1.96 * var.sqrt();
            // The same corrections, half a session late: must not help.
            let shuffled: Vec<LineRow> = (0..bins)
                .map(|k| {
                    let other = (k + bins / 2) % bins;
                    let mut row = [0.0; CHAMBERS];
                    row[i] = before[k][i] - (before[other][i] - after[other][i]);
                    row
                })
                .collect();
            ChannelError {
                name: format!("r1 chamber {}", i + 1),
                unit: "kPa".to_owned(),
                before: rms(before, i),
                after: rms(after, i),
                after_ci95: [(mean - half).max(0.0).sqrt(), (mean + half).sqrt()],
                shuffled: Some(rms(&shuffled, i)),
                floor: baseline.healthy.is_some().then(|| {
                    let phi = baseline.noise.phi[i];
                    baseline.noise.sd_pa[i] / (1.0 - phi * phi).sqrt() / 1e3
                }),
            }
        })
        .collect()
}

/// What the residual of each chamber goes along with: share of variance of a straight line fitted
/// to the even blocks, on the odd ones.
fn located(grid: &PressureGrid, rows: &[LineRow]) -> Vec<Located> {
    let bins = grid.len();
    let second = super::line::LINE_HZ as usize;
    let u = &grid.commanded_pa;
    let chambers = grid.chambers();
    let mut out = Vec::new();
    for &i in &chambers {
        let rate = |k: usize, j: usize| u[k][j] - u[k.saturating_sub(second)][j];
        let regressors: [(&str, Vec<f64>); 3] = [
            ("level", (0..bins).map(|k| u[k][i]).collect()),
            ("rate", (0..bins).map(|k| rate(k, i)).collect()),
            (
                "rate of the others",
                (0..bins)
                    .map(|k| {
                        let others = chambers.iter().filter(|j| **j != i);
                        others.map(|j| rate(k, *j)).sum()
                    })
                    .collect(),
            ),
        ];
        for (name, x) in regressors {
            let even = |k: &usize| (k * BLOCKS / bins).is_multiple_of(2);
            let (mut n, mut sx, mut sy, mut sxx, mut sxy) = (0.0, 0.0, 0.0, 0.0, 0.0);
            for k in (0..bins).filter(even) {
                let (x, y) = (x[k], rows[k][i]);
                n += 1.0;
                sx += x;
                sy += y;
                sxx += x * x;
                sxy += x * y;
            }
            let spread = sxx - sx * sx / n;
            if spread < 1.0 {
                continue;
            }
            let slope = (sxy - sx * sy / n) / spread;
            let (mut left, mut whole) = (0.0, 1e-9);
            for k in (0..bins).filter(|k| !even(k)) {
                let y = rows[k][i] - sy / n;
                left += (y - slope * (x[k] - sx / n)).powi(2);
                whole += y * y;
            }
            out.push(Located {
                residual: "r1".to_owned(),
                channel: format!("chamber {}", i + 1),
                regressor: name.to_owned(),
                share: (1.0 - left / whole).clamp(0.0, 1.0),
            });
        }
    }
    out.sort_by(|a, b| b.share.total_cmp(&a.share));
    out
}

fn notes(
    grid: &PressureGrid,
    baseline: &LineBaseline,
    found: &Stages,
    verdict: Verdict,
    located: &[Located],
) -> Vec<String> {
    let mut out = Vec::new();
    if baseline.healthy.is_none() {
        out.push(
            "no healthy session: the measure is an ideal supply, and gain and offset of each gauge \
             were fitted beside the effects; the verdict is weaker"
                .to_owned(),
        );
        let fitted = found.sets.first().map_or(&found.baseline, |s| &s.baseline);
        for i in grid.chambers() {
            let r: [f64; KNOBS] = fitted.regulators[i].0;
            if (r[GAIN] - 1.0).abs() > GAUGE_OFF[0] || r[OFFSET].abs() > GAUGE_OFF[1] {
                out.push(format!(
                    "chamber {} settles at {:.2} times its command {:+.1} kPa: check its gauge",
                    i + 1,
                    r[GAIN],
                    r[OFFSET] / 1e3
                ));
            }
        }
    }
    if verdict == Verdict::Unknown {
        let (channel, regressor) = located
            .first()
            .map_or(("all chambers", "time"), |l| (&l.channel, &l.regressor));
        out.push(format!(
            "unmodelled term in actuation, {channel}, along with {regressor}"
        ));
    }
    out
}

fn separate(effects: &[FoundEffect]) -> SeparateBy {
    let ids: Vec<String> = effects.iter().map(|e| e.id.clone()).collect();
    let timing = |id: &str| matches!(id, "pressure-delay" | "flow-limit" | "pressure-lag");
    let (excitation, why) = if ids.iter().all(|id| timing(id)) {
        (
            "steps",
            "steps of different heights tell them apart: a delay shifts them, a lag takes the same \
             time for all, a flow limit takes longer for the high ones",
        )
    } else {
        (
            "single",
            "one chamber after the other shows what each does on its own and to the others",
        )
    };
    SeparateBy {
        excitation: excitation.to_owned(),
        effects: ids,
        why: why.to_owned(),
    }
}

fn traces(grid: &PressureGrid, before: &[LineRow], after: &[LineRow], floor_pa: f64) -> Traces {
    let scale = floor_pa.max(1.0);
    let series = |rows: &[LineRow]| {
        let one = |i: usize| rows.iter().map(|r| r[i] / scale).collect();
        grid.chambers().into_iter().map(one).collect()
    };
    Traces {
        t_s: grid.t_s.clone(),
        channels: grid
            .chambers()
            .iter()
            .map(|i| format!("pressure {}", i + 1))
            .collect(),
        before: series(before),
        after: series(after),
        ..Traces::default()
    }
}
