//! The whole way: commission, replay, locate, explain, decide, patch, prove.

use std::collections::BTreeMap;

use nalgebra::{DMatrix, DVector};
use rand::SeedableRng as _;

use super::actuation::{
    Lag, PressureGrid, PressureLog, commission_supply, decide_supply, supply_stages,
};
use super::candidates::{Candidate, starts_in};
use super::commission::{Baseline, commission, factory};
use super::explain::{Explained, admitted, chance, columns, explain, form_sd, weak_prior};
use super::finding::{Finding, FoundEffect, GapSize, Ranked, SeparateBy, Verdict};
use super::fit::{cost, fit};
use super::noise::{bridged, start};
use super::patch::{Patch, PatchEffect, PatchValue, VERSION};
use super::problem::{Problem, Replayed};
use super::prove::prove;
use super::session::{CHANNELS, Grid, same_robot};
use super::{GapError, Progress, Stage};
use crate::robot::RobotSpec;
use crate::sim::effects::{Side, Trajectory};

/// What may be asked of the finder.
#[derive(Clone, Debug, Default)]
pub struct Options {
    /// Effects (ids) to leave out of the table.
    pub without: Vec<String>,
    /// Seed of the chance sessions.
    pub seed: u64,
    /// Excitations that could be run, by name, to tell alternatives apart: times (s) and pressures (Pa).
    pub excitations: Vec<(String, Trajectory)>,
}

/// A finding with the patch that brings it into the model.
#[derive(Clone, Debug)]
pub struct Found {
    /// What was found.
    pub finding: Finding,
    /// The rig's nuisance parameters and the effects; the first alternative of a set.
    pub patch: Patch,
}

/// At most so many effects at once.
const EFFECTS_MAX: usize = 3;
/// Times the threshold from which a gain counts: chance is drawn from one healthy session, and the
/// model's own error is not quite the same in the next.
const WEAK: f64 = 2.0;
/// Chance sessions behind the threshold.
const DRAWS: usize = 100;
/// Share of the excess over the floor that has to go before an effect is named.
const CLOSED_MIN: f64 = 0.5;
/// Share of the held-out gap that has to close before an effect is named.
const PROVEN_MIN: f64 = 0.5;
/// A best effect that leaves more than this share of the excess is not at the floor.
const AT_FLOOR: f64 = 0.05;
/// A rival is excluded when it leaves this many times what the best one leaves.
const RIVAL_LEAVES: f64 = 1.2;
/// A further effect has to bring some combination of channels this much closer to its floor.
const FURTHER_MIN: f64 = 0.6;
/// Pressures that all stay within this excite little, Pa.
const EXCITED_PA: f64 = 8e3;

/// Finds what is missing in the model of a rig.
///
/// `healthy` is a session of the healthy rig; without it the factory model is the baseline and the
/// verdict is weaker, which the notes say.
///
/// # Errors
/// [`GapError`] when a session says nothing, or the model cannot follow it.
pub fn find(
    robot: &RobotSpec,
    healthy: Option<&Grid>,
    suspect: &Grid,
    options: &Options,
    progress: &dyn Progress,
) -> Result<Found, GapError> {
    for grid in healthy.into_iter().chain([suspect]) {
        same_robot(robot, &grid.session)?;
    }
    let baseline = match healthy {
        Some(grid) => {
            let mut common = grid.clone();
            for (c, there) in common.present.iter_mut().zip(suspect.present) {
                *c &= there;
            }
            if !common.present.iter().any(|c| *c) {
                return Err(GapError::NothingCommon);
            }
            commission(robot, &common, progress)?
        }
        None => factory(&suspect.present),
    };
    let mut notes = notes(healthy, suspect);
    progress.at(Stage::Replay, 0.0)?;
    let replayed = Replayed::new(robot, suspect, &baseline)?;
    let problem = replayed.problem()?;
    let r0 = problem.residual(&[])?;
    if !r0.iter().all(|x| x.is_finite()) {
        return Err(GapError::Degenerate);
    }
    progress.at(Stage::Locate, 0.0)?;
    let located = super::locate::locate(&replayed)?;
    let supply = supply(robot, healthy, suspect, &options.without, progress)?;
    let mut all = admitted(suspect, |e| !options.without.iter().any(|id| id == e.id));
    all.retain(|c| c.effect.id != "gauge-error" || may_misread(supply.as_ref(), c));
    progress.at(Stage::Explain, 0.0)?;
    let ready = columns(&problem, &all, &|c| starts_in(c, suspect), &[])?;
    progress.at(Stage::Decide, 0.0)?;
    let mut rng = rand_pcg::Pcg64Mcg::seed_from_u64(options.seed);
    // Without a healthy session nothing tells noise from effects but the assumed noise itself.
    let quiet = match &baseline.healthy {
        Some(h) => h.clone(),
        None => DMatrix::from_fn(baseline.noise.channels.len(), suspect.len(), |_, _| {
            crate::sim::dataset::normal(&mut rng)
        }),
    };
    let threshold = chance(&problem, &ready, &quiet, &mut rng, DRAWS);
    let n = problem.len() as f64;
    let before = cost(&problem, &r0) / n;
    let floor = healthy_level(&problem, &quiet);

    let mut chosen: Option<Explained> = None;
    let mut rankings: Vec<Vec<Explained>> = Vec::new();
    for stage in 0..EFFECTS_MAX {
        let mut found = explain(&problem, &all, &ready, chosen.as_ref(), progress)?;
        simplest_first(&mut found);
        let best = found.first().cloned();
        rankings.push(found);
        let Some(best) = best else { break };
        if best.gain <= WEAK * threshold || !best.firm {
            break;
        }
        if let Some(so_far) = &chosen {
            // What the first one's form leaves over drives others into a bound.
            let at_bound = best.fit.on_bound.iter().any(|b| *b);
            if at_bound || !pays(&replayed, &problem, so_far, &best, floor)? {
                break;
            }
        }
        log::debug!("effect {} is {}", stage + 1, best.candidate.effect.id);
        chosen = Some(best);
    }
    let first: &[Explained] = rankings.first().map_or(&[], |r| r);
    let mut ranked: Vec<Explained> = rankings.iter().flatten().cloned().collect();
    if let Some(e) = &chosen {
        chosen = Some(dropped(&problem, e.clone(), threshold));
    }
    ranked.sort_by(|a, b| b.gain.total_cmp(&a.gain));

    log::debug!(
        "profile before {:.2?}, after {:.2?}, floor {floor:.2}",
        profile(&problem, &r0, problem.per_bin()),
        chosen
            .as_ref()
            .map(|e| profile(&problem, &e.fit.residual, problem.per_bin()))
    );
    let mut verdict = Verdict::NothingMissing;
    let mut rivals: Vec<Explained> = Vec::new();
    if let Some(best) = &chosen {
        let left = best.fit.cost / n - floor;
        let excess = before - floor;
        let closed = (excess - left) / excess;
        let on_bound = best.fit.on_bound.iter().any(|b| *b);
        verdict = if closed < CLOSED_MIN {
            // A term that gains a little where nothing is to be gained is chance, or the model's form.
            if excess > UNEXPLAINED * floor {
                Verdict::Unknown
            } else {
                Verdict::NothingMissing
            }
        } else {
            rivals = rivals_of(&rankings, best, before * n, floor * n, supply.as_ref());
            if rivals.is_empty() {
                Verdict::Named
            } else {
                Verdict::Indistinguishable
            }
        };
        if verdict == Verdict::Named
            && let Some(force_n) = weight(best)
            && !all.iter().any(|c| c.effect.id == "payload")
        {
            verdict = Verdict::Unknown;
            notes.push(format!(
                "Unmodelled term in r2, along with the direction of gravity: a force of {force_n:.2} N \
                 straight down fits, which is what a weight does, and no weight is in the table."
            ));
        }
        if on_bound && verdict == Verdict::Named {
            notes.push(
                "A parameter rests on its bound: the true value may lie beyond it.".to_owned(),
            );
        }
        if verdict == Verdict::Unknown && closed < CLOSED_MIN {
            let what = located.first().map_or_else(
                || "no single channel stands out".to_owned(),
                |l| {
                    format!(
                        "unmodelled term in {}, {}, along with {} ({:.0} % of its variance)",
                        l.residual,
                        l.channel,
                        l.regressor,
                        100.0 * l.share
                    )
                },
            );
            notes.push(format!(
                "The best effect of the table closes only {:.0} % of the excess: {what}.",
                100.0 * closed
            ));
        }
    } else if before - floor > UNEXPLAINED * floor {
        verdict = Verdict::Unknown;
        notes.push(
            "What is left over is larger than a healthy rig leaves, and no effect of the table explains it."
                .to_owned(),
        );
    } else if range_pa(suspect) < EXCITED_PA {
        verdict = Verdict::NotExcited;
        notes.push(format!(
            "No pressure moves by more than {:.1} kPa: most effects would not show. Drive the arm through its range.",
            range_pa(suspect) / 1e3
        ));
    }

    progress.at(Stage::Prove, 0.0)?;
    // For a verdict without a name the best attempt is still measured, but never patched in.
    let measured = chosen.as_ref().or(first.first());
    let proof = prove(&replayed, &problem, measured)?;
    if matches!(verdict, Verdict::Named | Verdict::Indistinguishable)
        && proof.gap.closed < PROVEN_MIN
    {
        verdict = Verdict::Unknown;
        rivals.clear();
        notes.push(format!(
            "The best effect of the table closes only {:.0} % of the held-out gap.",
            100.0 * proof.gap.closed
        ));
    }
    let accepted = match verdict {
        Verdict::Named | Verdict::Indistinguishable => chosen.as_ref(),
        _ => None,
    };
    let mut found_effects = accepted.map_or_else(Vec::new, |e| described(&problem, e));
    let mut effects = found_effects.clone();
    for r in &rivals {
        // The last one: those before it are the same.
        effects.extend(described(&problem, r).pop());
    }
    let separate_by = match (accepted, rivals.first()) {
        (Some(a), Some(b)) => separate(&replayed, a, b, &rivals, &options.excitations),
        _ => None,
    };
    let mut data = BTreeMap::new();
    if let Some([name, hash]) = &baseline.session {
        data.insert("baseline".to_owned(), name.clone());
        data.insert("baseline_sha256".to_owned(), hash.clone());
    }
    data.insert("session".to_owned(), suspect.session.name.clone());
    data.insert("session_sha256".to_owned(), suspect.session.hash.clone());
    let gap = if accepted.is_some() {
        proof.gap
    } else {
        GapSize {
            after: proof.gap.before,
            closed: 0.0,
            ..proof.gap
        }
    };
    let mut finding = Finding {
        verdict,
        effects,
        candidates: unique(&ranked),
        threshold,
        located,
        gap,
        worse: proof.worse,
        channels: proof.channels,
        separate_by,
        notes,
        data: data.clone(),
        seconds: 0.0,
        traces: proof.traces,
    };
    if let Some(supply) = supply {
        found_effects.extend(add_supply(&mut finding, supply));
    }
    let verdict = finding.verdict;
    let mut patch = Patch {
        version: VERSION,
        name: format!("found in {}", suspect.session.name),
        robot: robot.hash.clone(),
        verdict: verdict_id(verdict).to_owned(),
        data,
        rig: BTreeMap::new(),
        floor: floors(&baseline),
        effects: found_effects
            .into_iter()
            .map(|e| PatchEffect {
                id: e.id,
                target: e.target,
                params: e.params,
            })
            .collect(),
    };
    patch.set_values(&baseline.values);
    Ok(Found { finding, patch })
}

/// What is to be said of the way from command to gauge, when the commands were logged.
fn supply(
    robot: &RobotSpec,
    healthy: Option<&Grid>,
    suspect: &Grid,
    without: &[String],
    progress: &dyn Progress,
) -> Result<Option<Finding>, GapError> {
    let log = |g: &Grid| {
        PressureLog::of(&g.session)
            .map(PressureGrid::new)
            .transpose()
    };
    let (Some(h), Some(s)) = (healthy.map(log).transpose()?.flatten(), log(suspect)?) else {
        return Ok(None);
    };
    if !s.moves() {
        return Ok(None);
    }
    let baseline = commission_supply(robot, &h)?;
    let stages = supply_stages(robot, &s, &baseline, Lag::BehindGauge, without, progress)?;
    decide_supply(robot, &s, &baseline, Lag::BehindGauge, &stages).map(Some)
}

/// Whether a gauge can be wrong: the regulator follows its gauge, so the way from command to gauge
/// shows it, when that was logged and understood.
fn may_misread(supply: Option<&Finding>, gauge: &Candidate) -> bool {
    supply.is_none_or(|f| f.verdict == Verdict::Unknown) || named_by(supply, gauge)
}

/// Whether the way from command to gauge has already named it.
fn named_by(supply: Option<&Finding>, c: &Candidate) -> bool {
    let target = c.target.map(|t| t + 1);
    supply.is_some_and(|f| {
        let mut named = f.effects.iter();
        named.any(|e| e.id == c.effect.id && e.target == target)
    })
}

/// Puts the supply's finding beside the arm's: they come from residuals that do not share a cause,
/// except for a gauge. Gives the effects that belong into the patch.
fn add_supply(arm: &mut Finding, supply: Finding) -> Vec<FoundEffect> {
    arm.located.extend(supply.located);
    arm.channels.extend(supply.channels);
    arm.candidates.extend(supply.candidates);
    let says = |v: Verdict| matches!(v, Verdict::Named | Verdict::Indistinguishable);
    let quiet = matches!(arm.verdict, Verdict::NothingMissing | Verdict::NotExcited);
    if !says(supply.verdict) {
        if quiet && supply.verdict == Verdict::Unknown {
            arm.verdict = Verdict::Unknown;
            arm.notes.extend(supply.notes);
        }
        return Vec::new();
    }
    let new: Vec<FoundEffect> = supply
        .effects
        .into_iter()
        .filter(|s| {
            !arm.effects
                .iter()
                .any(|a| a.id == s.id && a.target == s.target)
        })
        .collect();
    arm.worse.extend(supply.worse);
    if quiet {
        arm.verdict = supply.verdict;
        arm.gap = supply.gap;
        arm.threshold = supply.threshold;
        arm.separate_by = supply.separate_by;
    } else if says(arm.verdict) && supply.verdict == Verdict::Indistinguishable {
        arm.verdict = Verdict::Indistinguishable;
    }
    arm.effects.extend(new.iter().cloned());
    // Of a set only its first alternative goes into the patch.
    match supply.verdict {
        Verdict::Indistinguishable => new.into_iter().take(1).collect(),
        _ => new,
    }
}

/// Excess over the floor, relative to it, that is not chance even when nothing explains it.
const UNEXPLAINED: f64 = 0.5;

/// A force within this of straight down is a weight, rad: a cable would not hang so by chance.
const DOWN_RAD: f64 = 0.05;

/// The size of a single tip force that points straight down, N.
fn weight(e: &Explained) -> Option<f64> {
    let [(c, values)] = e.fit.effects.as_slice() else {
        return None;
    };
    if c.effect.id != "tip-force" {
        return None;
    }
    let aside = values[0].hypot(values[1]);
    (values[2] < 0.0 && aside < DOWN_RAD * -values[2]).then_some(-values[2])
}

fn verdict_id(v: Verdict) -> &'static str {
    match v {
        Verdict::NothingMissing => "nothing-missing",
        Verdict::Named => "named",
        Verdict::Indistinguishable => "indistinguishable",
        Verdict::Unknown => "unknown",
        Verdict::NotExcited => "not-excited",
    }
}

/// What a healthy session looks like in this problem, per innovation.
fn healthy_level(problem: &Problem, quiet: &DMatrix<f64>) -> f64 {
    let start = super::noise::start();
    let judged = quiet.columns(start, quiet.ncols() - start);
    // The nuisance of the session at hand takes as much from chance as it has effective parameters;
    // against thousands of innovations this is left out.
    let level = judged.norm_squared() / judged.len() as f64;
    level * (problem.len() - start * quiet.nrows()) as f64 / problem.len() as f64
}

fn floors(baseline: &Baseline) -> BTreeMap<String, f64> {
    let f = baseline.floor;
    [
        ("position_m", f.position_m),
        ("rotation_rad", f.rotation_rad),
        ("spring_m", f.spring_m),
        ("imu_rad", f.imu_rad),
    ]
    .into_iter()
    .filter_map(|(k, v)| Some((k.to_owned(), v?)))
    .collect()
}

fn notes(healthy: Option<&Grid>, suspect: &Grid) -> Vec<String> {
    let mut out = Vec::new();
    match healthy {
        None => out.push(
            "No healthy session was given: the factory model is the baseline, and differences \
             between this arm and the nominal one can look like effects."
                .to_owned(),
        ),
        Some(h) => {
            if h.present != suspect.present {
                out.push(
                    "The two sessions do not hold the same channels: only the common ones count."
                        .to_owned(),
                );
            }
        }
    }
    let gone: Vec<String> = (0..super::session::CHANNELS)
        .filter(|c| !suspect.present[*c])
        .map(super::session::channel_name)
        .collect();
    if !gone.is_empty() {
        out.push(format!("Not measured: {}.", gone.join(", ")));
    }
    if suspect.session.commanded_pa.is_none() {
        out.push(
            "The commanded pressures were not logged: nothing can be said of the way from command to gauge."
                .to_owned(),
        );
    }
    out
}

fn range_pa(grid: &Grid) -> f64 {
    (0..crate::signal::CHAMBERS)
        .map(|i| {
            let values = grid.gauge_pa.iter().map(|p| p[i]);
            values.clone().fold(f64::MIN, f64::max) - values.fold(f64::MAX, f64::min)
        })
        .fold(0.0, f64::max)
}

/// Mean squared innovation per combination of channels, nuisance projected out.
fn profile(problem: &Problem, r: &DVector<f64>, per_bin: usize) -> Vec<f64> {
    let clean = problem.cleaned(&DMatrix::from_column_slice(r.len(), 1, r.as_slice()));
    let bins = r.len() / per_bin;
    (0..per_bin)
        .map(|i| {
            (0..bins)
                .map(|k| clean[(k * per_bin + i, 0)].powi(2))
                .sum::<f64>()
                / bins as f64
        })
        .collect()
}

/// The one-standard-error rule: of effects that explain as much as the best within the scatter from
/// block to block, the one with the fewest numbers leads.
fn simplest_first(found: &mut Vec<Explained>) {
    let count = |e: &Explained| e.fit.parameters().len();
    let Some(best) = found.first() else { return };
    let as_good = |e: &Explained| {
        let (margin, se) = best.losses.gain_over(&e.losses);
        margin <= se && !best.losses.firmly_over(&e.losses)
    };
    let simplest = (0..found.len())
        .filter(|k| as_good(&found[*k]))
        .min_by_key(|k| (count(&found[*k]), *k));
    if let Some(k) = simplest {
        let lead = found.remove(k);
        found.insert(0, lead);
    }
}

/// Whether a further effect brings some combination of channels, or some channel, close to its floor.
fn pays(
    replayed: &Replayed,
    problem: &Problem,
    so_far: &Explained,
    next: &Explained,
    floor: f64,
) -> Result<bool, GapError> {
    let per_bin = problem.per_bin();
    let closes = |before: f64, after: f64, floor: f64| {
        before > 2.0 * floor && (before - after) / (before - floor) >= FURTHER_MIN
    };
    let before = profile(problem, &so_far.fit.residual, per_bin);
    let after = profile(problem, &next.fit.residual, per_bin);
    if before
        .iter()
        .zip(&after)
        .any(|(b, a)| closes(*b, *a, floor))
    {
        return Ok(true);
    }
    if matches!(
        next.candidate.effect.side,
        Side::Actuation | Side::Mechanics
    ) {
        return Ok(false);
    }
    // What lasts in a reading is hardly seen in innovations: mean squares of the readings themselves.
    let square = |e: &Explained| -> Result<Vec<f64>, GapError> {
        let rows = bridged(&replayed.rows(&e.fit.active())?);
        let judged = &rows[start()..];
        let mean = |c: usize| judged.iter().map(|r| r[c] * r[c]).sum::<f64>() / judged.len() as f64;
        Ok((0..CHANNELS).map(mean).collect())
    };
    let (before, after) = (square(so_far)?, square(next)?);
    Ok((0..CHANNELS).any(|c| {
        closes(
            before[c],
            after[c],
            replayed.baseline.channel_floor[c].powi(2),
        )
    }))
}

/// Without the effects that the others make superfluous.
fn dropped(problem: &Problem, mut whole: Explained, threshold: f64) -> Explained {
    let mut i = 0;
    while whole.fit.effects.len() > 1 && i < whole.fit.effects.len() {
        let mut rest = whole.fit.effects.clone();
        rest.remove(i);
        if let Some(fit) = fit(problem, rest, 6) {
            let losses = problem.held_out(&fit.residual, &fit.columns, &weak_prior(&fit));
            let (lost, _) = whole.losses.gain_over(&losses);
            if lost <= threshold || !whole.losses.firmly_over(&losses) {
                let (candidate, _) = fit.effects[0].clone();
                whole = Explained {
                    candidate,
                    fit,
                    losses,
                    gain: whole.gain - lost,
                    se: whole.se,
                    firm: whole.firm,
                };
                i = 0;
                continue;
            }
        }
        i += 1;
    }
    whole
}

/// Effects that cannot be excluded in the place of one of `best`. `rankings` holds what was compared
/// at every stage, `cost` what is left without any effect, `floor` what a healthy rig leaves. What the
/// supply has named has none.
fn rivals_of(
    rankings: &[Vec<Explained>],
    best: &Explained,
    cost: f64,
    floor: f64,
    supply: Option<&Finding>,
) -> Vec<Explained> {
    // A form with more numbers that explains no more would do so by coincidence.
    let count = |e: &Explained| e.fit.parameters().len();
    let stages = best.fit.effects.len();
    let mut out = Vec::new();
    let mut without = cost;
    for (k, found) in rankings.iter().enumerate().take(stages) {
        let Some(own) = found.first() else { break };
        // An effect that was dropped later takes its stage's comparison with it.
        if own.candidate != best.fit.effects[k].0 {
            break;
        }
        let (left, excess) = (own.fit.cost - floor, without - floor);
        let rival = |e: &&Explained| {
            let explains = without - e.fit.cost >= CLOSED_MIN * (without - own.fit.cost);
            let other = !best.fit.effects.iter().any(|(c, _)| *c == e.candidate)
                && !out.iter().any(|o: &Explained| o.candidate == e.candidate);
            if !explains || !other || e.gain <= 0.0 {
                return false;
            }
            let (margin, se) = own.losses.gain_over(&e.losses);
            if !own.losses.firmly_over(&e.losses) {
                return count(e) <= count(own) || margin < -2.0 * se;
            }
            // When even the best one leaves a misfit, its form is not right, and a rival that
            // leaves little more is not excluded by likelihood.
            stages == 1
                && left > AT_FLOOR * excess
                && count(e) <= count(own)
                && e.fit.cost - floor <= RIVAL_LEAVES * left
        };
        if !named_by(supply, &own.candidate) {
            let more: Vec<Explained> = found.iter().filter(rival).cloned().collect();
            out.extend(more);
        }
        without = own.fit.cost;
    }
    out
}

/// Effects of a fit with their intervals.
fn described(problem: &Problem, e: &Explained) -> Vec<FoundEffect> {
    let fit = &e.fit;
    let columns = &fit.columns;
    let mut gram = problem.product(columns, columns);
    let free: Vec<usize> = (0..gram.nrows()).filter(|i| gram[(*i, *i)] > 0.0).collect();
    // Innovations are not quite white and the effect's form is not quite right: the spread from
    // block to block tells how much wider the interval is.
    let level = (fit.cost / problem.len() as f64).max(1.0);
    let scale: Vec<f64> = fit.effects.iter().flat_map(|(c, _)| c.scale()).collect();
    for i in 0..gram.nrows() {
        gram[(i, i)] += 1e-6 / scale[i].powi(2);
    }
    let spread = problem.sandwich(&fit.residual, columns, &weak_prior(fit));
    let plain = gram.try_inverse();
    let mut at = 0;
    let mut out = Vec::new();
    for (c, values) in &fit.effects {
        let mut params = BTreeMap::new();
        for (p, v) in c.effect.parameters.iter().zip(values) {
            let i = at;
            at += 1;
            let variance = plain.as_ref().map_or(f64::NAN, |g| g[(i, i)] * level);
            let sd = variance
                .max(spread[i])
                .sqrt()
                .hypot(form_sd(c.effect, p, *v));
            let ci95 = (free.contains(&i) && sd.is_finite()).then(|| {
                [
                    (v - 2.2 * sd).max(p.bounds[0]),
                    (v + 2.2 * sd).min(p.bounds[1]),
                ]
            });
            params.insert(
                p.name.to_owned(),
                PatchValue {
                    value: *v,
                    unit: p.unit.to_owned(),
                    ci95,
                },
            );
        }
        out.push(FoundEffect {
            id: c.effect.id.to_owned(),
            side: side(c.effect.side).to_owned(),
            target: c.target.map(|t| t + 1),
            params,
        });
    }
    out
}

fn side(s: Side) -> &'static str {
    match s {
        Side::Actuation => "actuation",
        Side::Mechanics => "mechanics",
        Side::Sensing => "sensing",
        Side::FrameAndTime => "frame-and-time",
    }
}

/// Every candidate once, with its best gain.
fn unique(ranked: &[Explained]) -> Vec<Ranked> {
    let mut seen: Vec<Candidate> = Vec::new();
    let mut out = Vec::new();
    for e in ranked {
        if seen.contains(&e.candidate) {
            continue;
        }
        seen.push(e.candidate);
        out.push(Ranked {
            id: e.candidate.effect.id.to_owned(),
            target: e.candidate.target.map(|t| t + 1),
            gain: e.gain,
            se: e.se,
        });
    }
    out
}

/// The excitation in which two alternatives differ most, after each is fitted to the other as well
/// as a linear change of its parameters allows.
fn separate(
    replayed: &Replayed,
    a: &Explained,
    b: &Explained,
    rivals: &[Explained],
    excitations: &[(String, Trajectory)],
) -> Option<SeparateBy> {
    let mut names: Vec<String> = vec![a.candidate.effect.id.to_owned()];
    names.extend(rivals.iter().map(|r| r.candidate.effect.id.to_owned()));
    let mut best: Option<(f64, &str)> = None;
    let (a, b) = (a.fit.active(), b.fit.active());
    let here = replayed.apart(replayed.grid, &a, &b)?;
    for (name, drive) in excitations {
        let Some(grid) = replayed.grid.driven_by(drive) else {
            continue;
        };
        let Some(apart) = replayed.apart(&grid, &a, &b) else {
            continue;
        };
        if best.is_none_or(|(most, _)| apart > most) {
            best = Some((apart, name));
        }
    }
    let (apart, name) = best?;
    Some(SeparateBy {
        excitation: name.to_owned(),
        effects: names,
        why: format!(
            "under '{name}' the first two alternatives would be {apart:.0} nats apart, against {here:.0} \
             under the pressures of this session"
        ),
    })
}
