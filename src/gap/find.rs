//! The whole procedure: commission, replay, locate, explain, decide, patch, prove.

use std::collections::BTreeMap;

use nalgebra::{DMatrix, DVector};
use rand::SeedableRng as _;

use super::baseline::{Commissioned, Healthy, judgeable, prepared};
use super::candidates::{Candidate, Table, scene};
use super::commission::{Baseline, factory};
use super::config::CONFIG;
use super::describe::{described, notes, range_pa, separate, undetermined, unique};
use super::explain::{Column, Explained, admitted, columns, explain, significance_threshold};
use super::finding::{
    ChannelError, FailedFold, Finding, FoldChoice, FoundEffect, Located, Onset, Verdict,
    closed_excess,
};
use super::fit::{cost, fit};
use super::misfit::{Misfit, short_stretches};
use super::noise::start;
use super::onset::Begun;
use super::patch::{Patch, PatchEffect, VERSION};
use super::problem::{Problem, Replayed};
use super::prove::{Case, Proof, confirm, prove, traces_before};
use super::select::{rivals_of, select};
use super::session::{Grid, common_channels};
use super::sides::{add_supply, supply as supply_of};
use super::{GapError, Progress, Stage};
use crate::robot::RobotSpec;
use crate::sim::effects::{Active, Law, Trajectory};

/// Options of the finder.
#[derive(Clone, Debug, Default)]
pub struct Options {
    /// Seed of the resampled sessions behind the significance threshold.
    pub seed: u64,
    /// Excitations that could discriminate between alternatives, by name: times (s) and gauge pressures (Pa).
    pub excitations: Vec<(String, Trajectory)>,
    /// Sessions that have no part in the finding, and on which what it names is tested.
    pub prove: Vec<Grid>,
    /// What is missing is missing from the start: no beginning is looked for.
    pub from_start: bool,
}

/// A finding with the patch that brings it into the model.
#[derive(Clone, Debug)]
pub struct Found {
    /// What was found.
    pub finding: Finding,
    /// The rig's nuisance parameters and the effects; the first alternative of a set.
    pub patch: Patch,
    /// Gain of all effects together on held-out blocks, nats; 0 without any.
    pub gain: f64,
}

/// Finds what is missing in the model of a rig.
///
/// Looked for are the effects of `table`. `healthy` is what is known of the rig in order; without it the factory model is the
/// baseline and the verdict is weaker, as the notes state. What is missing is missing in all `suspects`: what several sessions
/// show adds up, while clock and frame belong to each.
///
/// # Errors
/// [`GapError`] when there is no suspect session, one cannot be judged, or the model cannot follow it.
pub fn find(
    robot: &RobotSpec,
    table: Table<'_>,
    healthy: Healthy<'_>,
    suspects: &[Grid],
    options: &Options,
    progress: &dyn Progress,
) -> Result<Found, GapError> {
    judgeable(robot, &options.prove)?;
    let (healthy, suspects) = prepared(robot, healthy, suspects, progress)?;
    let suspects: Vec<&Grid> = suspects.iter().map(|g| &**g).collect();
    let search = Search {
        robot,
        table,
        healthy: healthy.as_deref(),
        options,
        progress,
    };
    // Of a rig of which nothing is known no part is in order.
    let begins = search.healthy.is_some() && suspects.len() == 1 && !options.from_start;
    Ok(search.run(&suspects, begins)?.0)
}

/// What a search is given besides sessions.
struct Search<'a> {
    robot: &'a RobotSpec,
    table: Table<'a>,
    healthy: Option<&'a Commissioned>,
    options: &'a Options,
    progress: &'a dyn Progress,
}

impl Search<'_> {
    /// Looks for what is missing in `suspects`, and if it `begins` in the only one, from then on; with the effects of the arm
    /// that are named, at work.
    fn run(&self, suspects: &[&Grid], begins: bool) -> Result<(Found, Vec<Active>), GapError> {
        let Self {
            robot,
            table,
            healthy,
            options,
            progress,
        } = *self;
        let present = common_channels(suspects.iter().copied());
        let present = healthy.map_or(present, |h| h.in_common(present));
        if !present.contains(&true) {
            return Err(GapError::NothingCommon);
        }
        let baseline = match healthy {
            None => factory(&present),
            Some(healthy) => healthy.arm_in(&present),
        };
        let mut notes = notes(healthy, suspects);
        progress.at(Stage::Replay, 0.0)?;
        let replayed = Replayed::new(robot, suspects, &baseline)?;
        let bins = replayed.bins() / suspects.len();
        let problem = replayed.problem()?;
        let r0 = problem.residual(&[])?;
        if !r0.iter().all(|x| x.is_finite()) {
            return Err(GapError::Degenerate);
        }
        progress.at(Stage::Locate, 0.0)?;
        let located = super::locate::locate(&replayed)?;
        let supply = healthy.and_then(|h| h.supply.as_ref());
        let supply = supply_of(robot, supply, (suspects, &options.prove), table, progress)?;
        let all = admitted(table, &replayed.present());
        progress.at(Stage::Explain, 0.0)?;
        let ready = columns(&problem, &all, &scene(suspects), &[], begins)?;
        progress.at(Stage::Decide, 0.0)?;
        let mut rng = rand_pcg::Pcg64Mcg::seed_from_u64(options.seed);
        // Without a healthy session only the assumed noise separates noise from effects.
        let combinations = baseline.noise.channels.len();
        let quiet = match &baseline.healthy {
            Some(rows) => baseline.noise.evidence(rows, bins),
            None => {
                let mut quiet = DMatrix::zeros(2 * combinations, bins);
                for x in quiet.rows_mut(0, combinations).iter_mut() {
                    *x = crate::sim::dataset::normal(&mut rng);
                }
                quiet
            }
        };
        let threshold = significance_threshold(&problem, &ready, &quiet, &mut rng, CONFIG.draws);
        let short = baseline.healthy.as_ref().map_or_else(Vec::new, |rows| {
            short_stretches(rows, &baseline.noise.channels, bins)
        });
        let before = Misfit::of(&problem, &r0).in_short(short);
        let judged = quiet.ncols() - start();
        let floor = quiet.rows(0, combinations).norm_squared() / (combinations * judged) as f64;
        log::debug!(
            "innovations {:.3} (healthy {floor:.3}), biases {:.2?}, rig's change {:.2}, threshold {threshold:.1}",
            before.mean_innovation(),
            before.bias,
            before.change
        );

        if begins {
            let columns = (&all[..], &ready[..]);
            let begun = self.begun(&replayed, (&problem, &r0), columns, [threshold, floor])?;
            if let Some(found) = begun {
                return Ok(found);
            }
        }
        let selected = select(
            &problem,
            (&all, &ready),
            threshold,
            floor,
            supply.as_ref(),
            progress,
        )?;
        let (mut chosen, rankings) = (selected.chosen.clone(), &selected.rankings);
        let gain = selected.chosen.as_ref().map_or(0.0, |e| {
            let nothing = DMatrix::zeros(r0.len(), 0);
            let without = problem.held_out(&r0, &nothing, &DVector::zeros(0));
            e.losses.gain_over(&without).0
        });
        let mut ranked: Vec<Explained> = rankings.iter().flatten().cloned().collect();
        ranked.sort_by(|a, b| b.gain.total_cmp(&a.gain));

        progress.at(Stage::Prove, 0.0)?;
        let proof = prove(&Case {
            replayed: &replayed,
            problem: &problem,
            r0: &r0,
            selected: &selected,
            threshold,
            supply: supply.as_ref(),
        })?;
        let Judged {
            mut verdict,
            mut rivals,
            notes: reasons,
        } = match &chosen {
            Some(best) => {
                let n = problem.len() as f64;
                let healthy = quiet.norm_squared() * n / quiet.len() as f64;
                let cost = cost(&problem, &r0);
                let rivals = rivals_of(
                    &problem,
                    rankings,
                    best,
                    threshold,
                    [cost, healthy],
                    supply.as_ref(),
                );
                let after = Misfit::of(&problem, &best.fit.residual);
                log::debug!(
                    "residual: innovations {:.3}, biases {:.2?}, rig's change {:.2}; closed {:.2}",
                    after.mean_innovation(),
                    after.bias,
                    after.change,
                    before.closed(&after, floor)
                );
                let closed = before
                    .closed(&after, floor)
                    .max(closed_excess(&proof.channels));
                // At the floor of the whole, what shows in a group of its own counts there.
                let closed = match before.exceeds(floor) {
                    false if proof.shows() => closed.max(proof.gap.closed),
                    _ => closed,
                };
                judge(best, rivals, &before, (closed, floor), &located)
            }
            None => unexplained(suspects, &before, floor),
        };
        notes.extend(reasons);
        notes.extend(proof.failed.iter().map(FailedFold::text));
        if let (true, Some(best)) = (verdict.has_effects(), chosen.take()) {
            let held = hold(&problem, best, rivals, rankings, &proof);
            (chosen, verdict, rivals) = (held.chosen, held.verdict, held.rivals);
            if verdict == Verdict::Unknown && !before.exceeds(floor) {
                // Nothing is left to explain where no effect is proved at the floor.
                verdict = Verdict::NothingMissing;
            }
            notes.extend(held.notes);
        }
        if let Some((what, note)) = against_floor(verdict, &proof.channels) {
            (chosen, verdict) = (None, what);
            rivals.clear();
            notes.push(note);
        }
        let mut found_effects = match &chosen {
            Some(e) if verdict.has_effects() => described(&problem, e),
            _ => Vec::new(),
        };
        if let Some(why) = chosen
            .as_ref()
            .and_then(|e| undetermined(e, &found_effects))
        {
            verdict = Verdict::Unknown;
            notes.push(why);
            rivals.clear();
            found_effects.clear();
        }
        let accepted = chosen.as_ref().filter(|_| verdict.has_effects());
        let chosen_by = |e: &mut FoundEffect| {
            let folds = proof.support(&e.id, e.target);
            e.chosen_by = Some(folds as f64 / CONFIG.folds as f64);
        };
        found_effects.iter_mut().for_each(chosen_by);
        let mut effects = found_effects.clone();
        for r in &rivals {
            // The last one: those before it are the same.
            if let Some(mut other) = described(&problem, r).pop() {
                chosen_by(&mut other);
                other.instead_of = chosen.as_ref().map(|best| place(r, best));
                effects.push(other);
            }
        }
        let separate_by = match (accepted, rivals.first()) {
            (Some(a), Some(b)) => separate(&replayed, a, b, &rivals, &options.excitations),
            _ => None,
        };
        let active = accepted.map_or_else(Vec::new, |e| e.fit.active());
        let confirmed = match accepted {
            Some(_) if !options.prove.is_empty() => {
                let others: Vec<&Grid> = options.prove.iter().collect();
                let others = Replayed::new(robot, &others, &baseline)?;
                Some(confirm(&others, &active)?)
            }
            _ => None,
        };
        let gap = match accepted {
            Some(_) => proof.gap,
            None => proof.gap.left_open(),
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
            embargo_s: proof.embargo_s,
            folds: proof.folds,
            failed_folds: proof.failed,
            proof: confirmed,
            onset: None,
            separate_by,
            notes,
            data: origins(
                healthy.map_or_else(Vec::new, |h| h.sessions.clone()),
                suspects
                    .iter()
                    .map(|g| &g.session)
                    .map(|s| [s.name.clone(), s.hash.clone()])
                    .collect(),
            ),
            seconds: 0.0,
            traces: proof.traces,
        };
        if let Some(supply) = supply {
            found_effects.extend(add_supply(&mut finding, supply));
        }
        // What restarted with a session is not of the rig: the patch has what was commissioned.
        let mut patch = patch_of(robot, &finding, found_effects, &baseline.values);
        patch.floor = floors(&baseline);
        let found = Found {
            finding,
            patch,
            gain,
        };
        Ok((found, active))
    }

    /// What began to be missing within a session; `None` where nothing did, or it cannot be named.
    fn begun(
        &self,
        replayed: &Replayed,
        (problem, r0): (&Problem, &DVector<f64>),
        (all, ready): (&[Candidate], &[Column]),
        [threshold, floor]: [f64; 2],
    ) -> Result<Option<(Found, Vec<Active>)>, GapError> {
        let begun = Begun::new(replayed, problem, r0)?;
        let Some(bin) = begun.first_bin((all, ready), [threshold, floor]) else {
            return Ok(None);
        };
        let (mut found, active) = self.run(&[&replayed.runs[0].since_bin(bin)], false)?;
        if active.is_empty() {
            return Ok(None);
        }
        let from_start = explain(problem, all, ready, None, threshold, self.progress)?;
        let costs = from_start.iter().map(|e| e.fit.cost);
        let least = costs.fold(cost(problem, r0), f64::min);
        let Some(onset) = begun.onset(&active, bin, least) else {
            return Ok(None);
        };
        let Onset {
            t_s,
            ci95: [low_s, high_s],
        } = onset;
        let note = format!(
            "It begins at {t_s:.1} s of the session [{low_s:.1}, {high_s:.1}]; before, the session is as the rig in order. All \
             errors are those from then on."
        );
        found.finding.notes.insert(0, note);
        found.finding.onset = Some(onset);
        let whole = traces_before(replayed)?;
        let later = std::mem::take(&mut found.finding.traces);
        found.finding.traces = whole.ending_with(later);
        Ok(Some((found, active)))
    }
}

/// The patch of a finding: what is known of the rig and the effects that were found.
pub(super) fn patch_of(
    robot: &RobotSpec,
    finding: &Finding,
    effects: Vec<FoundEffect>,
    values: &[f64],
) -> Patch {
    let effects = effects.into_iter().map(|e| PatchEffect {
        id: e.id,
        target: e.target,
        params: e.params,
    });
    let mut patch = Patch {
        version: VERSION,
        name: format!("found in {}", finding.data["session"]),
        robot: robot.hash.clone(),
        verdict: verdict_id(finding.verdict).to_owned(),
        data: finding.data.clone(),
        rig: BTreeMap::new(),
        floor: BTreeMap::new(),
        law: Vec::new(),
        effects: effects.collect(),
    };
    patch.set_values(values);
    patch
}

/// Names and hashes of the sessions.
pub(super) fn origins(
    healthy: Vec<[String; 2]>,
    suspects: Vec<[String; 2]>,
) -> BTreeMap<String, String> {
    let mut out = BTreeMap::new();
    for (key, sessions) in [("baseline", healthy), ("session", suspects)] {
        let all = |k: usize| {
            let all: Vec<&str> = sessions.iter().map(|s| s[k].as_str()).collect();
            all.join(", ")
        };
        if !sessions.is_empty() {
            out.insert(key.to_owned(), all(0));
            out.insert(format!("{key}_sha256"), all(1));
        }
    }
    out
}

/// What the held-out folds leave of a choice.
struct Held {
    chosen: Option<Explained>,
    verdict: Verdict,
    rivals: Vec<Explained>,
    notes: Vec<String>,
}

/// A choice after the proof: effects that too few folds chose are left out, and what other folds chose in their place cannot
/// be excluded.
fn hold(
    problem: &Problem,
    mut best: Explained,
    mut rivals: Vec<Explained>,
    rankings: &[Vec<Explained>],
    proof: &Proof,
) -> Held {
    let refused = |note: String| Held {
        chosen: None,
        verdict: Verdict::Unknown,
        rivals: Vec::new(),
        notes: vec![note],
    };
    if let Some(why) = proof.withheld() {
        return refused(why);
    }
    let target = |c: &Candidate| c.target.map(|t| t + 1);
    let supported = |c: &Candidate| proof.supports(c.effect.id, target(c));
    let mut notes = Vec::new();
    // What a fold that lacks one of the effects chose in its place cannot be excluded.
    for fold in &proof.folds {
        let in_fold = |c: &Candidate| fold.chose(c.effect.id, target(c));
        if best.fit.effects.iter().all(|(c, _)| in_fold(c)) {
            continue;
        }
        let known = |c: &Candidate| {
            best.fit.effects.iter().any(|(b, _)| b == c) || rivals.iter().any(|r| r.candidate == *c)
        };
        let mut compared = rankings.iter().flatten();
        let other = compared.find(|e| in_fold(&e.candidate) && !known(&e.candidate));
        rivals.extend(other.cloned());
    }
    // An effect stands when enough folds chose it, or what cannot be excluded in its place; otherwise it goes.
    let unsure: Vec<Candidate> = {
        let all = best.fit.effects.iter().map(|(c, _)| *c);
        all.filter(|c| !supported(c)).collect()
    };
    let mut gone = Vec::new();
    for c in &unsure {
        notes.push(format!(
            "{} is chosen by {} of {} held-out folds.",
            c.effect.name,
            proof.support(c.effect.id, target(c)),
            CONFIG.folds
        ));
        let k = best.fit.effects.iter().position(|(b, _)| b == c);
        let in_place = rivals.iter().filter(|r| Some(place(r, &best)) == k);
        let any: Vec<Candidate> = std::iter::once(*c)
            .chain(in_place.map(|e| e.candidate))
            .collect();
        let chose = |f: &&FoldChoice| any.iter().any(|c| f.chose(c.effect.id, target(c)));
        if proof.folds.iter().filter(chose).count() < CONFIG.folds_min {
            rivals.retain(|r| Some(place(r, &best)) != k);
            gone.push(*c);
        }
    }
    if !gone.is_empty() {
        let mut rest = best.fit.effects.clone();
        rest.retain(|(c, _)| !gone.contains(c));
        let (false, Some(fit)) = (rest.is_empty(), fit(problem, rest, 6)) else {
            return refused(format!("No effect is named: {}", notes.join(" ")));
        };
        best.candidate = fit.effects[0].0;
        best.fit = fit;
    }
    Held {
        verdict: match rivals.is_empty() {
            true => Verdict::Named,
            false => Verdict::Indistinguishable,
        },
        chosen: Some(best),
        rivals,
        notes,
    }
}

/// Which effect of `best` (0-based) a rival could be instead of: it was fitted on top of those before.
fn place(rival: &Explained, best: &Explained) -> usize {
    let before = &rival.fit.effects[..rival.fit.effects.len().saturating_sub(1)];
    let in_best = |c: &Candidate| best.fit.effects.iter().any(|(b, _)| b == c);
    let place = before.iter().filter(|(c, _)| in_best(c)).count();
    place.min(best.fit.effects.len().saturating_sub(1))
}

/// A verdict that the sizes of the errors contradict: a name where all is at the floor, or nothing missing far above it.
fn against_floor(verdict: Verdict, channels: &[ChannelError]) -> Option<(Verdict, String)> {
    let most = |ratios: &mut dyn Iterator<Item = f64>| ratios.fold(0.0, f64::max);
    let each = most(&mut channels.iter().filter_map(|c| Some(c.before / c.floor?)));
    // Channels of a kind together: one spring alone may have moved a little.
    let kind = |r: &str| {
        let of_kind = channels.iter().filter(|c| c.name.starts_with(r));
        let squares = of_kind.filter_map(|c| Some([c.before.powi(2), c.floor?.powi(2)]));
        let [before, floor] = squares.fold([0.0; 2], |sum, x| [sum[0] + x[0], sum[1] + x[1]]);
        (before / floor).sqrt()
    };
    let kinds = ["r2 tip position", "r2 tip rotation", "r3", "r4"].map(|r| (r, kind(r)));
    let known = kinds.into_iter().filter(|(_, ratio)| ratio.is_finite());
    let (worst, ratio) = known.max_by(|a, b| a.1.total_cmp(&b.1))?;
    match verdict {
        v if v.has_effects() && each < CONFIG.at_floor => Some((
            Verdict::NothingMissing,
            "All errors are at the noise floor: what gains there is not named.".to_owned(),
        )),
        Verdict::NothingMissing if ratio > CONFIG.far => Some((
            Verdict::Unknown,
            format!(
                "It cannot be decided whether something is missing: no effect gains significantly, but the error of {} is {ratio:.1} times that of a healthy session. What is uncertain of the rig in order would explain it: a baseline from healthy sessions that move like this one decides.",
                match worst {
                    "r3" => "the springs",
                    "r4" => "the IMUs",
                    tip => tip.trim_start_matches("r2 "),
                }
            ),
        )),
        _ => None,
    }
}

/// A verdict and its reasons.
struct Judged {
    verdict: Verdict,
    /// Candidates that cannot be excluded.
    rivals: Vec<Explained>,
    notes: Vec<String>,
}

/// The verdict when an effect was taken, from the misfit before it, the share of it that the effect closes and the mean square
/// of a healthy innovation.
fn judge(
    best: &Explained,
    rivals: Vec<Explained>,
    before: &Misfit,
    (closed, floor): (f64, f64),
    located: &[Located],
) -> Judged {
    let mut effects = best.fit.effects.iter();
    let least = match effects.all(|(c, _)| c.effect.law == Law::Definition) {
        true => CONFIG.closed_min_definition,
        false => CONFIG.closed_min,
    };
    let judged = |verdict, rivals, notes| Judged {
        verdict,
        rivals,
        notes,
    };
    if closed < least {
        if !before.exceeds(floor) {
            // A term that gains a little at the noise floor is not significant, or model inadequacy.
            return judged(Verdict::NothingMissing, Vec::new(), Vec::new());
        }
        let what = located.first().map_or_else(
            || "no single channel stands out".to_owned(),
            |l| {
                format!(
                    "unmodelled term in {}, {}, correlated with {} ({:.0} % of its variance)",
                    l.residual,
                    l.channel,
                    l.regressor,
                    100.0 * l.share
                )
            },
        );
        let note = format!(
            "The best effect of the table closes only {:.0} % of the excess: {what}.",
            100.0 * closed
        );
        return judged(Verdict::Unknown, Vec::new(), vec![note]);
    }
    if !rivals.is_empty() {
        return judged(Verdict::Indistinguishable, rivals, Vec::new());
    }
    let bound =
        best.fit.on_bound.iter().any(|b| *b).then(|| {
            "A parameter rests on its bound: the true value may lie beyond it.".to_owned()
        });
    judged(Verdict::Named, rivals, bound.into_iter().collect())
}

/// The verdict when no effect was taken.
fn unexplained(suspects: &[&Grid], before: &Misfit, floor: f64) -> Judged {
    let range_pa = range_pa(suspects);
    let (verdict, note) = if before.exceeds(floor) {
        let note = "The residuals exceed the noise floor, and no effect of the table \
                    explains them.";
        (Verdict::Unknown, Some(note.to_owned()))
    } else if range_pa < CONFIG.excited_pa {
        let note = format!(
            "No pressure moves by more than {:.1} kPa: most effects would not show. Drive the arm \
             through its range.",
            range_pa / 1e3
        );
        (Verdict::NotExcited, Some(note))
    } else {
        (Verdict::NothingMissing, None)
    };
    Judged {
        verdict,
        rivals: Vec::new(),
        notes: note.into_iter().collect(),
    }
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
