//! Fits as the entries of a finding.

use std::collections::BTreeMap;

use super::baseline::Commissioned;
use super::candidates::Candidate;
use super::config::CONFIG;
use super::explain::{Explained, weak_prior};
use super::finding::{FoundEffect, Ranked, SeparateBy};
use super::misfit::Misfit;
use super::patch::PatchValue;
use super::problem::{Problem, Replayed};
use super::session::{CHANNELS, Grid, channel_name, common_channels};
use crate::signal::CHAMBERS;
use crate::sim::effects::{Parameter, Scene, Side, Trajectory};

/// Two-sided 95 % quantile of the normal distribution: for a variance that is known.
pub const NORMAL_95: f64 = 1.960;
/// The same of Student's t with 11 degrees of freedom: for one that is estimated from twelve blocks.
pub const T_95: f64 = 2.201;
/// The two at 94 %. Of two estimates of one variance the larger counts: an interval then covers 96 % where both are right and
/// 94 % where one is.
const NORMAL_94: f64 = 1.881;
const T_94: f64 = 2.096;

/// 95 % interval of a parameter's value within its bounds: `plain` is the variance of the model, `blocks` that from block to
/// block; how far another law of the same physics would be is part of it.
pub fn interval_95(p: &Parameter, value: f64, plain: f64, blocks: f64) -> [f64; 2] {
    let reach = (NORMAL_94 * plain.sqrt())
        .max(T_94 * blocks.sqrt())
        .hypot(NORMAL_95 * p.form_sd(value));
    [
        (value - reach).max(p.bounds[0]),
        (value + reach).min(p.bounds[1]),
    ]
}

/// Effects of a fit with their intervals.
pub fn described(problem: &Problem, e: &Explained) -> Vec<FoundEffect> {
    let fit = &e.fit;
    let columns = &fit.columns;
    let mut gram = problem.product(columns, columns);
    let free: Vec<usize> = (0..gram.nrows()).filter(|i| gram[(*i, *i)] > 0.0).collect();
    // Innovations are not quite white and the effect's law is inadequate: the spread from block to
    // block determines how much wider the interval is.
    let level = Misfit::of(problem, &fit.residual)
        .mean_innovation()
        .max(1.0);
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
            let sized = variance.max(spread[i]).is_finite();
            let ci95 =
                (free.contains(&i) && sized).then(|| interval_95(p, *v, variance, spread[i]));
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
            instead_of: None,
            chosen_by: None,
        });
    }
    out
}

/// An effect whose size the session does not determine: the interval of a number that is looked for reaches from one bound to
/// the other.
pub fn undetermined(e: &Explained, found: &[FoundEffect]) -> Option<String> {
    e.fit.effects.iter().zip(found).find_map(|((c, _), f)| {
        let starts = c.starts(&Scene::default());
        let sizes = starts.first().map_or(&[0][..], |s| &s.moves);
        let fills = |i: &&usize| {
            let p = &c.effect.parameters[**i];
            let ends = f.params.get(p.name).and_then(|v| v.ci95);
            ends.is_some_and(|[low, high]| low <= p.bounds[0] && high >= p.bounds[1])
        };
        let i = sizes.iter().find(fills)?;
        Some(format!(
            "No effect is named: the session does not determine the {} of {}.",
            c.effect.parameters[*i].name,
            c.effect.name.to_lowercase()
        ))
    })
}

/// Name of a side in files.
pub fn side(s: Side) -> &'static str {
    match s {
        Side::Actuation => "actuation",
        Side::Mechanics => "mechanics",
        Side::Sensing => "sensing",
        Side::FrameAndTime => "frame-and-time",
    }
}

/// Every candidate once, with its best gain.
pub fn unique(ranked: &[Explained]) -> Vec<Ranked> {
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

/// The excitation that discriminates best between two alternatives, after each is fitted to the other
/// as well as a linear change of its parameters allows.
pub fn separate(
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
    let here = replayed
        .runs
        .iter()
        .map(|r| replayed.apart(&r.grid, &a, &b));
    let here: f64 = here.collect::<Option<Vec<f64>>>()?.iter().sum();
    for (name, drive) in excitations {
        let Some(grid) = replayed.runs[0].grid.driven_by(drive) else {
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
/// Notes on the data that limit any verdict.
pub fn notes(healthy: Option<&Commissioned>, suspects: &[&Grid]) -> Vec<String> {
    let mut out = Vec::new();
    if healthy.is_none() {
        out.push(
            "No healthy session was given: the factory model is the baseline, and differences \
             between this arm and the nominal one can look like effects."
                .to_owned(),
        );
    }
    let own = healthy.map(|h| h.present);
    let mut all = suspects.iter().map(|g| g.present).chain(own);
    if all.any(|present| present != suspects[0].present) {
        out.push(
            "The sessions do not hold the same channels: only the common ones count.".to_owned(),
        );
    }
    let common = common_channels(suspects.iter().copied());
    let gone: Vec<String> = (0..CHANNELS)
        .filter(|c| !common[*c])
        .map(channel_name)
        .collect();
    if !gone.is_empty() {
        out.push(format!("Not measured: {}.", gone.join(", ")));
    }
    out.extend(healthy.iter().flat_map(|h| h.notes.clone()));
    let beyond = |grid: &&Grid| {
        let coverage = healthy.and_then(|h| h.coverage.as_ref());
        let exceeds = |c: &super::Coverage| c.exceeded_by(grid) > CONFIG.coverage_noted;
        coverage.is_some_and(exceeds).then(|| {
            format!(
                "{} moves the arm as no session of the baseline does: errors that a healthy model has there can look like effects. A \
                 baseline with such a session too judges it better.",
                grid.session.name
            )
        })
    };
    out.extend(suspects.iter().filter_map(beyond));
    out.extend(suspects.iter().flat_map(|grid| grid.left_out()));
    if suspects.iter().all(|g| g.session.commanded_pa.is_none()) {
        out.push(
            "The commanded pressures were not logged: the path from command to gauge cannot be judged."
                .to_owned(),
        );
    }
    out
}

/// Largest movement of any pressure in any session, Pa.
pub fn range_pa(grids: &[&Grid]) -> f64 {
    let moves = |grid: &&Grid| {
        let of_chamber = |i: usize| {
            let values = grid.gauge_pa.iter().map(|p| p[i]);
            values.clone().fold(f64::MIN, f64::max) - values.fold(f64::MAX, f64::min)
        };
        (0..CHAMBERS).map(of_chamber).fold(0.0, f64::max)
    };
    grids.iter().map(moves).fold(0.0, f64::max)
}
