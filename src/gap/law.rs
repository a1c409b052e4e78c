//! A missing effect that no table has, as a law: where it acts, on what it depends, in which form, and with which coefficients.
//!
//! The terms of the library are tried as the effects of the table are, with the same significance threshold, held-out folds
//! and control, so a law may also be refused.

use std::borrow::Cow;
use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::baseline::{Commissioned, Healthy, prepared};
use super::candidates::Table;
use super::find::{Found, Options, find};
use super::finding::{Confirmed, FoundEffect, GapSize, Located, Verdict};
use super::patch::{Patch, PatchLaw, PatchValue};
use super::report::{effect_name, equation};
use super::session::Grid;
use super::{GapError, Progress};
use crate::robot::RobotSpec;
use crate::sim::effects::{Effect, Form, Input, Site, TERMS, term};

/// Whether there is a law.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum LawVerdict {
    /// There is one that held-out data confirm.
    Law,
    /// No term of the library is stable and pays.
    NoLaw,
}

/// A term of a law with its coefficient.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FoundTerm {
    /// Its id in the library.
    pub id: String,
    /// What it depends on.
    pub inputs: Vec<Input>,
    /// How.
    pub form: Form,
    /// Its coefficient, SI; the largest of several.
    pub coefficient: f64,
    /// Unit of the coefficient.
    pub unit: String,
    /// 95 % interval of the coefficient, lower end first; `None` where none is known.
    pub ci95: Option<[f64; 2]>,
    /// Share of the held-out folds that chose it, 0..1.
    pub stability: f64,
    /// All its numbers, shape included.
    pub parameters: BTreeMap<String, PatchValue>,
}

/// What is missing at one site.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FoundLaw {
    /// What it changes.
    pub site: Site,
    /// Chamber, segment, spring or IMU (1-based); `None`: every one, or the whole arm.
    pub target: Option<usize>,
    /// In symbols.
    pub equation: String,
    /// In words, with numbers.
    pub words: String,
    /// Its terms.
    pub terms: Vec<FoundTerm>,
}

/// The effect of the table that comes nearest.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Nearest {
    /// The effect.
    pub id: String,
    /// Its channel (1-based); `None`: all of them, or there are none.
    pub target: Option<usize>,
    /// By how much worse it predicts held-out blocks than the law, nats.
    pub worse_by_nats: f64,
}

/// What a law does in sessions that had no part in finding it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LawProof {
    /// Their names.
    pub session: String,
    /// The gap there.
    #[serde(flatten)]
    pub gap: GapSize,
}

impl From<&Confirmed> for LawProof {
    fn from(c: &Confirmed) -> Self {
        Self {
            session: c.sessions.join(", "),
            gap: c.gap.clone(),
        }
    }
}

/// What was discovered.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Discovery {
    /// Whether there is a law.
    pub verdict: LawVerdict,
    /// What is to be added to the model.
    pub laws: Vec<FoundLaw>,
    /// Terms that explain it as well in the place of one of those.
    pub alternatives: Vec<FoundLaw>,
    /// The effect of the table that comes nearest; `None` without a law, or where none was found.
    pub nearest: Option<Nearest>,
    /// The gap before and after.
    pub gap: GapSize,
    /// What the law does in other sessions; `None` where none was given, or there is no law.
    pub proof: Option<LawProof>,
    /// Where residuals are correlated with something.
    pub located: Vec<Located>,
    /// What limits the verdict, one sentence each.
    pub notes: Vec<String>,
    /// Names and hashes of the data.
    pub data: BTreeMap<String, String>,
    /// Wall time, s.
    pub seconds: f64,
}

/// A discovery with the patch that brings it into the model.
#[derive(Clone, Debug)]
pub struct Discovered {
    /// What was discovered.
    pub discovery: Discovery,
    /// The law with errors of every channel, as the finder gives them.
    pub found: Found,
    /// What is known of the rig in order; `None` without a baseline.
    pub rig: Option<Commissioned>,
}

/// Terms of the library as a table.
pub fn library() -> Vec<&'static Effect> {
    TERMS.iter().map(|t| &t.effect).collect()
}

/// Looks for the law of what is missing, beside the nearest effect of `table`.
///
/// # Errors
/// As [`find`].
pub fn discover(
    robot: &RobotSpec,
    table: Table<'_>,
    healthy: Healthy<'_>,
    suspects: &[Grid],
    options: &Options,
    progress: &dyn Progress,
) -> Result<Discovered, GapError> {
    let known = Options {
        prove: Vec::new(),
        from_start: true,
        ..options.clone()
    };
    // Commissioned once for both searches.
    let (own, _) = prepared(robot, healthy, suspects, progress)?;
    let healthy = own
        .as_deref()
        .map_or(Healthy::Sessions(&[]), Healthy::Commissioned);
    let known = find(robot, table, healthy, suspects, &known, progress)?;
    let found = find_law(robot, &known, healthy, suspects, options, progress)?;
    Ok(discovered(&known, found, own.map(Cow::into_owned)))
}

/// Looks for the law of what is missing, after the effects of the table: `known` is what was found with them.
///
/// # Errors
/// As [`find`].
pub fn find_law(
    robot: &RobotSpec,
    known: &Found,
    healthy: Healthy<'_>,
    suspects: &[Grid],
    options: &Options,
    progress: &dyn Progress,
) -> Result<Found, GapError> {
    // A term that counts time can be a beginning of its own.
    let options = Options {
        from_start: true,
        ..options.clone()
    };
    let mut found = find(robot, &library(), healthy, suspects, &options, progress)?;
    if found.finding.verdict.has_effects()
        && let Some(nearest) = nearest(known, &found)
    {
        let note = format!(
            "The nearest effect of the table, {}, predicts held-out data worse by {:.0} nats than the law.",
            effect_name(&nearest.id, nearest.target),
            nearest.worse_by_nats
        );
        found.finding.notes.insert(0, note);
    }
    found.patch = as_laws(found.patch);
    Ok(found)
}

/// The effect of the table that comes nearest to a law.
fn nearest(known: &Found, found: &Found) -> Option<Nearest> {
    let first = known.finding.candidates.first()?;
    Some(Nearest {
        id: first.id.clone(),
        target: first.target,
        worse_by_nats: found.gain - known.gain.max(first.gain),
    })
}

fn discovered(known: &Found, found: Found, rig: Option<Commissioned>) -> Discovered {
    let f = &found.finding;
    let is_law = f.verdict.has_effects();
    let (own, others): (Vec<&FoundEffect>, Vec<&FoundEffect>) =
        f.effects.iter().partition(|e| e.instead_of.is_none());
    let laws = laws(&own);
    let nearest = nearest(known, &found).filter(|_| is_law);
    let mut notes = f.notes.clone();
    match f.verdict {
        Verdict::NothingMissing => {
            notes.insert(
                0,
                "Nothing is missing: there is nothing to explain.".to_owned(),
            );
        }
        Verdict::Unknown => notes.insert(
            0,
            "No law was found: no term of the library is stable and explains enough.".to_owned(),
        ),
        _ => {}
    }
    let discovery = Discovery {
        verdict: match is_law && !laws.is_empty() {
            true => LawVerdict::Law,
            false => LawVerdict::NoLaw,
        },
        alternatives: others.iter().flat_map(|e| self::laws(&[e])).collect(),
        laws,
        nearest,
        gap: f.gap.clone(),
        proof: f.proof.as_ref().map(LawProof::from),
        located: f.located.clone(),
        notes,
        data: f.data.clone(),
        seconds: 0.0,
    };
    Discovered {
        discovery,
        found,
        rig,
    }
}

/// The laws of a patch as Rust items: effects that a program which uses the library adds to its table.
pub fn promoted(patch: &Patch) -> String {
    let items = patch.law.iter().filter_map(|law| {
        let at = TERMS.iter().position(|t| t.effect.id == law.term)?;
        let effect = &TERMS[at].effect;
        let name = law.term.to_uppercase().replace('-', "_");
        let start: Vec<String> = effect
            .parameters
            .iter()
            .map(|p| format!("{:?}", law.params.get(p.name).map_or(p.nominal, |v| v.value)))
            .collect();
        let start = start.join(", ");
        let moved: Vec<String> = (0..effect.parameters.len())
            .filter(|i| effect.parameters[*i].unit == effect.parameters[0].unit)
            .map(|i| i.to_string())
            .collect();
        Some(format!(
            "/// {}\nstatic {name}: Effect = Effect {{\n    id: \"found-{}\",\n    source: \"{}\",\n    \
             starts: |_, _| vec![Start::new(&[{start}], &[{}])],\n    ..TERMS[{at}].effect\n}};\n",
            effect.doc,
            law.term,
            patch.name,
            moved.join(", ")
        ))
    });
    let items: Vec<String> = items.collect();
    format!(
        "use springtwin::sim::effects::{{Effect, Start, TERMS}};\n\n{}",
        items.join("\n")
    )
}

/// A patch whose terms stand as laws.
fn as_laws(mut patch: Patch) -> Patch {
    for e in std::mem::take(&mut patch.effects) {
        match patch_law(&e.id, e.target, &e.params) {
            Some(law) => patch.law.push(law),
            None => patch.effects.push(e),
        }
    }
    patch
}

/// A term with its numbers as it stands in a patch, on channel `target` (1-based; `None`: every one). `None` for an effect
/// of the table.
pub fn patch_law(
    id: &str,
    target: Option<usize>,
    params: &BTreeMap<String, PatchValue>,
) -> Option<PatchLaw> {
    Some(PatchLaw {
        term: id.to_owned(),
        equation: equation(id)?.to_owned(),
        target,
        params: params.clone(),
    })
}

/// Terms put together by the site and channel at which they act.
fn laws(effects: &[&FoundEffect]) -> Vec<FoundLaw> {
    let mut out: Vec<FoundLaw> = Vec::new();
    for e in effects {
        let Some(t) = term(&e.id) else { continue };
        let of = |i: usize| {
            let p = t.effect.parameters.get(i)?;
            Some((p, e.params.get(p.name)?))
        };
        let moved = t.effect.parameters.len();
        // Of several coefficients the largest. Shapes (a time, a length, a travel) have other units.
        let sizes = (0..moved).filter_map(of);
        let coefficients = sizes.filter(|(p, _)| p.unit == t.effect.parameters[0].unit);
        let largest = coefficients.max_by(|a, b| a.1.value.abs().total_cmp(&b.1.value.abs()));
        let Some((_, coefficient)) = largest else {
            continue;
        };
        let found = FoundTerm {
            id: e.id.clone(),
            inputs: t.inputs.to_vec(),
            form: t.form,
            coefficient: coefficient.value,
            unit: coefficient.unit.clone(),
            ci95: coefficient.ci95,
            stability: e.chosen_by.unwrap_or(0.0),
            parameters: e.params.clone(),
        };
        let equation = t.effect.doc.split(": ").next().unwrap_or(t.effect.doc);
        let words = words(t.effect.name, e);
        match out
            .iter_mut()
            .find(|l| l.site == t.site && l.target == e.target)
        {
            Some(law) => {
                law.equation = format!("{}; {equation}", law.equation);
                law.words = format!("{}; {words}", law.words);
                law.terms.push(found);
            }
            None => out.push(FoundLaw {
                site: t.site,
                target: e.target,
                equation: equation.trim_end_matches('.').to_owned(),
                words,
                terms: vec![found],
            }),
        }
    }
    out
}

/// A term in words, with its numbers and their intervals.
fn words(name: &str, e: &FoundEffect) -> String {
    let number = |(k, p): (&String, &PatchValue)| {
        let within = p
            .ci95
            .map_or(String::new(), |[a, b]| format!(" [{a:.3e}, {b:.3e}]"));
        format!("{k} {:.3e} {}{within}", p.value, p.unit)
    };
    let numbers: Vec<String> = e.params.iter().map(number).collect();
    let at = e.target.map_or(String::new(), |t| format!(" {t}"));
    format!("{name}{at}: {}", numbers.join(", "))
}
