//! The text of a finding: names, customary units, one sentence per verdict.

use super::markup::{decimals, fixed, number};
use crate::gap::finding::{ChannelError, Finding, FoundEffect, Ranked, SeparateBy, Verdict};
use crate::gap::patch::PatchValue;
use crate::sim::effects::{EFFECTS, Target, effect_or_term, plain, term};

/// Display name of an effect, or of a term of a law, with its channel (1-based; `None`: all of them, or there are none):
/// `Leak, chamber 3`. An id that is neither is shown as it is.
pub fn effect_name(id: &str, target: Option<usize>) -> String {
    let known = effect_or_term(id);
    let name = known.map_or(id, |e| e.name);
    let one = |what: &str| match target {
        Some(n) => format!("{name}, {what} {n}"),
        None => format!("{name}, every {what}"),
    };
    match (known.map(|e| e.target), target) {
        (Some(Target::Chamber), _) => one("chamber"),
        (Some(Target::Spring), _) => one("spring"),
        (Some(Target::Imu), _) => one("IMU"),
        (Some(Target::Segment), _) => one("segment"),
        (Some(Target::None), _) | (None, None) => name.to_owned(),
        (None, Some(n)) => format!("{name}, channel {n}"),
    }
}

/// The equation of a term of a law; `None` for an effect of the table.
pub fn equation(id: &str) -> Option<&'static str> {
    Some(term(id)?.effect.doc)
}

/// Factor from SI to the customary unit, and that unit.
fn friendly(id: &str, name: &str, unit: &str) -> (f64, &'static str) {
    let parameters = effect_or_term(id).map_or(&[][..], |e| e.parameters);
    if let Some(shown) = parameters
        .iter()
        .find(|p| p.name == name)
        .and_then(|p| p.shown)
    {
        return shown;
    }
    match unit {
        "m" => (1e3, "mm"),
        "Pa" => (1e-3, "kPa"),
        "Pa/s" => (1e-3, "kPa/s"),
        "rad" => (1f64.to_degrees(), "deg"),
        "rad/s" => (60f64.to_degrees(), "deg/min"),
        "m/s" => (6e4, "mm/min"),
        "kg" => (1e3, "g"),
        "N" => (1.0, "N"),
        "N/m" => (1.0, "N/m"),
        "s" => (1.0, "s"),
        "1/s" => (1.0, "1/s"),
        // Ratios: shares in percent, factors as they are.
        "" if name == "share" => (100.0, "%"),
        _ => (1.0, ""),
    }
}

/// A parameter's value in its customary unit, its 95 % interval, and the unit; the interval's width
/// determines the number of digits.
pub struct Quantity {
    /// The value.
    pub value: String,
    /// Its 95 % interval, `a to b`; `None` where none is known.
    pub interval: Option<String>,
    /// The unit of both; empty for a ratio.
    pub unit: String,
}

/// A parameter of an effect in its customary unit.
pub fn quantity(id: &str, name: &str, given: &PatchValue) -> Quantity {
    let (factor, unit) = friendly(id, name, &given.unit);
    // A unit that is not in the list is shown as it came.
    let unit = if unit.is_empty() { &given.unit } else { unit };
    let value = given.value * factor;
    let ends = given
        .ci95
        .map(|[a, b]| [a * factor, b * factor])
        .filter(|ends| ends.iter().all(|v| v.is_finite()));
    let Some([low, high]) = ends.filter(|[a, b]| b > a) else {
        return Quantity {
            value: number(value),
            interval: None,
            unit: unit.to_owned(),
        };
    };
    let decimals = decimals(0.5 * (high - low));
    Quantity {
        value: fixed(value, decimals),
        interval: Some(format!(
            "{} to {}",
            fixed(low, decimals),
            fixed(high, decimals)
        )),
        unit: unit.to_owned(),
    }
}

/// A parameter in one phrase: `mass 412 g (398 to 427)`; the interval is the 95 % interval.
pub fn parameter(id: &str, name: &str, value: &PatchValue) -> String {
    let q = quantity(id, name, value);
    let unit = match q.unit.as_str() {
        "" => String::new(),
        unit => format!(" {unit}"),
    };
    let interval = q.interval.map_or(String::new(), |i| format!(" ({i})"));
    format!("{name} {}{unit}{interval}", q.value)
}

/// What an effect of the sensors means for their readings: one plain sentence; `None` for other effects.
pub fn plainly(e: &FoundEffect) -> Option<String> {
    // What may as well be nominal is not stated.
    let value = |name: &str| {
        let v = e.params.get(name)?;
        let effect = EFFECTS.iter().find(|known| known.id == e.id)?;
        let nominal = effect.parameters.iter().find(|p| p.name == name)?.nominal;
        let is_open = v
            .ci95
            .is_some_and(|[low, high]| low <= nominal && nominal <= high);
        Some(if is_open { nominal } else { v.value })
    };
    plain(&e.id, e.target, &value)
}

fn name(e: &FoundEffect) -> String {
    effect_name(&e.id, e.target)
}

fn listed(names: &[String], last: &str) -> String {
    match names {
        [] => String::new(),
        [one] => one.clone(),
        [rest @ .., end] => format!("{} {last} {end}", rest.join("; ")),
    }
}

/// The short form of a verdict.
pub fn verdict_name(verdict: Verdict) -> &'static str {
    match verdict {
        Verdict::NothingMissing => "Nothing missing",
        Verdict::Named => "Effect found",
        Verdict::Indistinguishable => "Indistinguishable",
        Verdict::Unknown => "Unknown",
        Verdict::NotExcited => "Not excited",
    }
}

/// The verdict as one plain sentence.
pub fn sentence(finding: &Finding) -> String {
    let found: Vec<String> = finding.effects.iter().map(name).collect();
    match finding.verdict {
        Verdict::NothingMissing => {
            "Nothing is missing: the residuals are at the noise floor of the healthy rig."
                .to_owned()
        }
        Verdict::Named => {
            let closed = finding.gap.closed;
            let how_much = if closed.is_finite() {
                format!(
                    " With {} in it, {} % of the gap is closed.",
                    if found.len() > 1 { "them" } else { "it" },
                    fixed(100.0 * closed, 0)
                )
            } else {
                String::new()
            };
            let what = if found.len() > 1 { "are" } else { "is" };
            let plain = finding.effects.iter().filter_map(plainly);
            let plain: String = plain.map(|text| format!("{text} ")).collect();
            format!(
                "{plain}{} {what} missing from the model.{how_much}",
                listed(&found, "and")
            )
        }
        Verdict::Indistinguishable => {
            let next = match &finding.separate_by {
                Some(s) => format!(
                    " Record a session with the excitation “{}” to discriminate between them.",
                    s.excitation
                ),
                None => String::new(),
            };
            let (sure, open) = finding.sure_and_open();
            let sure: Vec<String> = sure.into_iter().map(name).collect();
            let open: Vec<String> = open
                .into_iter()
                .map(|c| listed(&c.into_iter().map(name).collect::<Vec<_>>(), "or"))
                .collect();
            let open = open.join(", and one of: ");
            match &sure[..] {
                [] => format!(
                    "Something is missing from the model, and this session does not identify which effect it is: {open}.{next}"
                ),
                sure => format!(
                    "{} {} missing from the model, and one more effect, which this session does not identify: {open}.{next}",
                    listed(sure, "and"),
                    if sure.len() > 1 { "are" } else { "is" }
                ),
            }
        }
        Verdict::Unknown => {
            let place = match finding.located.first() {
                Some(l) => format!(
                    " It shows in {} of {} and is correlated with {}.",
                    l.channel,
                    residual_name(&l.residual),
                    l.regressor
                ),
                None => String::new(),
            };
            let what = match finding.is_of_laws() {
                true => "no law of the library's terms",
                false => "no effect in the table",
            };
            format!("Something is missing from the model, and {what} explains it.{place}")
        }
        Verdict::NotExcited => {
            "The arm moves too little in this session for a verdict: drive it through its \
                                range and record again."
                .to_owned()
        }
    }
}

/// Names of the effects between which an excitation discriminates.
pub(super) fn separated(by: &SeparateBy) -> String {
    let names = by.effects.iter();
    let names = names.map(|id| effect_or_term(id).map_or(id.as_str(), |e| e.name));
    names.collect::<Vec<_>>().join(", ")
}

/// What to do after a verdict.
pub fn next_step(finding: &Finding) -> String {
    match finding.verdict {
        Verdict::NothingMissing => "No action is needed.".to_owned(),
        Verdict::Named => "Check whether the effect is plausible on this rig; then apply the patch, or repair the rig and record again."
            .to_owned(),
        Verdict::Indistinguishable => match &finding.separate_by {
            Some(s) => format!(
                "Run the excitation “{}”, which discriminates between {}: {}.",
                s.excitation,
                separated(s),
                s.why.trim_end_matches('.')
            ),
            None => "No known excitation of the rig discriminates between them: check by hand, for instance by removing one of them."
                .to_owned(),
        },
        Verdict::Unknown if finding.is_of_laws() => "No patch is offered: what explains too little would only hide it. The correlated channels show where to look on the rig."
            .to_owned(),
        Verdict::Unknown => "No patch is offered: fitting known effects to an unknown one would only hide it. Search for a law (springtwin gap discover); the correlated channels show where to look on the rig."
            .to_owned(),
        Verdict::NotExcited => "This is no verdict about the rig: it may be healthy or not."
            .to_owned(),
    }
}

/// Result of the shuffled control in one sentence; `None` when it was not run.
pub fn shuffled(channels: &[ChannelError]) -> Option<String> {
    let tried: Vec<(&ChannelError, f64)> = channels
        .iter()
        .filter_map(|c| Some((c, c.shuffled.filter(|s| s.is_finite())?)))
        .collect();
    if tried.is_empty() {
        return None;
    }
    // A fifth of the gain from inputs that have nothing to do with the session is too much.
    let helped: Vec<&str> = tried
        .iter()
        .filter(|(c, s)| c.after < c.before && c.before - s > 0.2 * (c.before - c.after))
        .map(|(c, _)| c.name.as_str())
        .collect();
    Some(if helped.is_empty() {
        "Shuffled control: with its inputs in shuffled order the effect does not help, so its gain \
         depends on how the rig was driven."
            .to_owned()
    } else {
        format!(
            "Shuffled control: with its inputs in shuffled order the effect still helps in {}. There \
             it compensates something that does not depend on how the rig was driven.",
            helped.join(", ")
        )
    })
}

/// The two quantities that a residual compares.
pub fn residual_name(id: &str) -> &str {
    match id {
        "r1" => "r1 (measured against commanded pressure)",
        "r2" => "r2 (motion capture against the model)",
        "r3" => "r3 (springs against motion capture)",
        "r4" => "r4 (IMUs against motion capture)",
        "r5" => "r5 (springs against IMUs)",
        other => other,
    }
}

/// Name of a ranked candidate.
pub fn ranked_name(r: &Ranked) -> String {
    effect_name(&r.id, r.target)
}
