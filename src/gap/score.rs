//! Score of the finder on cases with a known answer.
//!
//! A case is a [`Key`] (what was hidden) and a [`Said`] (the finder's answer). [`score`]
//! counts; [`Score::markdown`] writes the tables.

mod counting;
mod tables;
#[cfg(test)]
mod tests;

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::finding::{Onset, Verdict};
pub use counting::{median, median_ci95, score, wilson};

/// Strengths of the graded cases, x noise floor.
pub const RUNGS: [f64; 5] = [0.5, 1.0, 2.0, 4.0, 8.0];
/// Strength from which an effect has to be found, x noise floor.
pub const FINDABLE: f64 = 2.0;
/// Strength from which an effect counts as strong, x noise floor.
pub const STRONG: f64 = 4.0;

/// What a case is about.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum About {
    /// One effect of the table.
    Single,
    /// Nothing.
    Null,
    /// One effect that is not in the finder's table.
    Alien,
    /// Two effects.
    Pair,
    /// One effect of the table that begins within the session.
    Begun,
}

/// The answer key of a case.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Key {
    /// What the case is about.
    pub kind: About,
    /// Requested strength, x noise floor; 0 without an effect.
    pub strength: f64,
    /// What is hidden.
    pub effects: Vec<KeyEffect>,
    /// When it begins, s; `None` for what is there from the start.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub onset_s: Option<f64>,
}

/// One hidden effect.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct KeyEffect {
    /// Its id.
    pub id: String,
    /// Channel (1-based); `None`: all of them, or there are none.
    pub target: Option<usize>,
    /// Its parameters.
    pub params: BTreeMap<String, KeyValue>,
    /// Its actual strength, x noise floor; `None` where it was not measured.
    pub reached: Option<f64>,
    /// Whether a bound limits it below the requested strength.
    pub capped: bool,
}

/// A parameter of a hidden effect.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct KeyValue {
    /// The value, SI.
    pub value: f64,
    /// Its unit.
    pub unit: String,
    /// Value without the effect, where the distance from it is what counts; else `None`.
    pub none: Option<f64>,
}

/// The finder's answer, as far as it is scored; other keys of its JSON are ignored.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
pub struct Said {
    /// The verdict; `None` when the finder failed.
    pub verdict: Option<Verdict>,
    /// The effects; for an indistinguishable set the alternatives.
    #[serde(default)]
    pub effects: Vec<SaidEffect>,
    /// The gap before and after; `None` where it was not stated.
    #[serde(default)]
    pub gap: Option<SaidGap>,
    /// When it began; `None`: from the start, or not known.
    #[serde(default)]
    pub onset: Option<Onset>,
    /// Wall time, s; `None` where it was not stated.
    #[serde(default)]
    pub seconds: Option<f64>,
    /// Why there is no verdict; `None` where there is one.
    #[serde(default)]
    pub error: Option<String>,
}

/// An effect that was named.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
pub struct SaidEffect {
    /// Its id.
    pub id: String,
    /// Channel (1-based); `None`: all of them, or there are none.
    pub target: Option<usize>,
    /// Its parameters.
    #[serde(default)]
    pub params: BTreeMap<String, SaidValue>,
}

/// A parameter that was fitted.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
pub struct SaidValue {
    /// The value, SI; `None` where it is no number.
    pub value: Option<f64>,
    /// 95 % interval, lower end first; `None` where there is none.
    #[serde(default)]
    pub ci95: Option<[f64; 2]>,
}

/// The gap.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
pub struct SaidGap {
    /// (before − after)/(before − floor); `None` where it is no number.
    #[serde(default)]
    pub closed: Option<f64>,
}

/// A case with its answer.
#[derive(Clone, Debug, PartialEq)]
pub struct Scored {
    /// Name of the case.
    pub name: String,
    /// What was hidden.
    pub key: Key,
    /// The finder's answer.
    pub said: Said,
}

/// So many of so many.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Share {
    /// Hits.
    pub hits: usize,
    /// Of so many.
    pub of: usize,
    /// Their ratio; `None` of nothing.
    pub share: Option<f64>,
    /// Wilson's 95 % interval of it; `None` of nothing.
    pub ci95: Option<[f64; 2]>,
}

/// Naming of single effects at one strength.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Rung {
    /// Strength, x noise floor; 0: below the lowest strength.
    pub strength: f64,
    /// The first effect that is named is the right one.
    pub top1: Share,
    /// It is the only one that is named.
    pub exact: Share,
    /// It is in an indistinguishable set.
    pub in_set: Share,
    /// Named first, or in the set.
    pub right_or_in_set: Share,
}

/// Results on pairs.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Pairs {
    /// Both are named.
    pub both: Share,
    /// Both, of the pairs whose members both have the requested strength.
    pub both_full_strength: Share,
    /// One of them is.
    pub one: Share,
    /// None is named, but at least one is in an indistinguishable set.
    pub in_set: Share,
}

/// Results on unmodelled effects.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Aliens {
    /// Effects of the table are claimed: by name, or as a set.
    pub named_wrongly: Share,
    /// Those that were never in the table.
    pub never_known: Share,
    /// Those that were removed from the table.
    pub left_out: Share,
    /// Rightly called unknown.
    pub unknown: Share,
    /// Missed.
    pub nothing: Share,
}

/// Results on effects that begin within the session.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Onsets {
    /// The first effect that is named is the right one.
    pub named: Share,
    /// Of those, a beginning is found.
    pub found: Share,
    /// Of the beginnings that are found, the 95 % interval holds the true one.
    pub covered: Share,
    /// Their error, s.
    pub error_s: Middle,
    /// Of all other sessions, a beginning is claimed.
    pub claimed: Share,
}

/// Results on sessions without an effect.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Nulls {
    /// Something is claimed: named, as a set, or unknown.
    pub false_positive: Share,
    /// Named or as a set.
    pub named: Share,
    /// Unknown.
    pub unknown: Share,
}

/// One parameter over all cases in which its effect was named on the right channel.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ParamLine {
    /// `effect.parameter`.
    pub name: String,
    /// Median of the relative error; `None` without cases.
    pub error_median: Option<f64>,
    /// Cases.
    pub cases: usize,
    /// The 95 % interval holds the true value.
    pub covered: Share,
}

/// A number with its 95 % interval.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Middle {
    /// Median; `None` without values.
    pub median: Option<f64>,
    /// Interval of the median from the order of the values; `None` for fewer than six.
    pub ci95: Option<[f64; 2]>,
    /// Values.
    pub of: usize,
    /// Largest; `None` without values.
    pub max: Option<f64>,
}

/// How a figure compares with its target.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum State {
    /// As good as wanted.
    Met,
    /// Worse.
    Missed,
    /// There was nothing to count.
    NoData,
}

/// A target and what was measured.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Target {
    /// What is measured.
    pub what: String,
    /// Smallest and largest figure that is good; `None`: no limit on that side.
    pub wanted: [Option<f64>; 2],
    /// The figure; `None` without data.
    pub measured: Option<f64>,
    /// Its 95 % interval; `None` where there is none.
    pub ci95: Option<[f64; 2]>,
    /// `%` for shares that are given as ratios, `s` for seconds.
    pub unit: String,
    /// Cases behind it.
    pub of: usize,
    /// Met or missed, by the figure itself and not by its interval.
    pub state: State,
}

/// A case in one line.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Line {
    /// Name of the case.
    pub name: String,
    /// What it is about.
    pub kind: About,
    /// Requested strength, x noise floor.
    pub strength: f64,
    /// Strength of the weakest of its effects; `None` where it is not known.
    pub reached: Option<f64>,
    /// What was hidden, `id:target` joined by ` + `.
    pub truth: String,
    /// The finder's answer.
    pub said: String,
    /// Whether that is right.
    pub right: bool,
    /// Share of the gap that was closed; `None` where it was not stated.
    pub closed: Option<f64>,
    /// Wall time, s; `None` where it was not stated.
    pub seconds: Option<f64>,
    /// Why there is no verdict; `None` where there is one.
    pub error: Option<String>,
}

/// Number of answers by truth and by answer.
pub type Confusion = BTreeMap<String, BTreeMap<String, usize>>;

/// All figures of a suite.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Score {
    /// Cases.
    pub cases: usize,
    /// Cases on which the finder failed; they count as wrong.
    pub failed: usize,
    /// Measured figures against the targets.
    pub targets: Vec<Target>,
    /// Single effects by the strength that they have.
    pub ladder: Vec<Rung>,
    /// The same by requested strength.
    pub ladder_asked: Vec<Rung>,
    /// Single effects that a bound limits below the requested strength.
    pub capped: usize,
    /// Right channel among effects that are named rightly, from [`FINDABLE`] on.
    pub channel: Share,
    /// The same among those that have a channel to choose.
    pub channel_of_choice: Share,
    /// Right side among single effects from [`FINDABLE`] on that were given a name.
    pub side: Share,
    /// Single effects from [`FINDABLE`] on, cases without an effect, unmodelled effects.
    pub confusion: Confusion,
    /// Weaker single effects.
    pub confusion_weak: Confusion,
    /// Sessions without an effect.
    pub nulls: Nulls,
    /// Unmodelled effects.
    pub aliens: Aliens,
    /// Pairs.
    pub pairs: Pairs,
    /// Effects that begin within the session.
    pub onsets: Onsets,
    /// Relative error of all parameters of effects that were named on the right channel.
    pub param_error: Middle,
    /// How often their 95 % interval holds the true value.
    pub param_covered: Share,
    /// The same by parameter.
    pub params: Vec<ParamLine>,
    /// Share of the gap that is closed where effects were named.
    pub gap_closed: Middle,
    /// Wall time, s.
    pub seconds: Middle,
    /// Every case.
    pub lines: Vec<Line>,
}
