//! The finding: verdict, effects, errors, in the form that is printed, drawn and written.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::config::CONFIG;
use super::patch::PatchValue;
use crate::sim::effects::term;

/// The verdict.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Verdict {
    /// No effect has a significant gain, and the residuals are at the noise floor.
    NothingMissing,
    /// One set of effects explains it, and no other does nearly as well.
    Named,
    /// Several effects explain it equally well.
    Indistinguishable,
    /// A significant residual that no known effect explains, or none that held-out data confirm.
    Unknown,
    /// The excitation is too small for a verdict.
    NotExcited,
}

impl Verdict {
    /// Whether effects come with it: those that are named, or those of which it is one.
    pub fn has_effects(self) -> bool {
        matches!(self, Self::Named | Self::Indistinguishable)
    }
}

/// An effect that was found.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FoundEffect {
    /// Its id in the table.
    pub id: String,
    /// Where it sits.
    pub side: String,
    /// Chamber, spring, IMU or segment (1-based); `None` for the whole.
    pub target: Option<usize>,
    /// Its parameters with 95 % intervals, SI.
    pub params: BTreeMap<String, PatchValue>,
    /// Place (0-based) in the list of the effect that this one could be instead of; `None` for what no other is known to
    /// replace.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub instead_of: Option<usize>,
    /// Share of the held-out folds that chose it, 0..1; `None` where folds do not choose.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub chosen_by: Option<f64>,
}

/// A candidate and how much better it predicts held-out data than the model without it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Ranked {
    /// Effect.
    pub id: String,
    /// Its channel (1-based); `None`: all of them, or there are none.
    pub target: Option<usize>,
    /// Gain in held-out log-likelihood, nats.
    pub gain: f64,
    /// Its standard error.
    pub se: f64,
}

/// A residual that is correlated with a regressor.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Located {
    /// `r1` .. `r5`.
    pub residual: String,
    /// Channel of the residual.
    pub channel: String,
    /// The regressor.
    pub regressor: String,
    /// Share of the variance that it explains on held-out blocks, 0..1.
    pub share: f64,
}

/// The gap, in the unit of the residual that shows it best, on held-out data.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct GapSize {
    /// Root mean square without the effects.
    pub before: f64,
    /// With them.
    pub after: f64,
    /// Of a healthy session.
    pub floor: f64,
    /// (before − after)/(before − floor).
    pub closed: f64,
    /// mm, deg or kPa.
    pub unit: String,
}

impl GapSize {
    /// From the errors before and after, and of a healthy session, in this order and in `unit`.
    pub fn of([before, after, floor]: [f64; 3], unit: &str) -> Self {
        Self {
            before,
            after,
            floor,
            closed: closed(before, after, floor),
            unit: unit.to_owned(),
        }
    }

    /// Where no effect is accepted.
    pub fn left_open(self) -> Self {
        Self {
            after: self.before,
            closed: 0.0,
            ..self
        }
    }

    /// Whether there is a gap at all: errors beyond those of a healthy session.
    pub fn shows(&self) -> bool {
        self.before > CONFIG.at_floor * self.floor
    }
}

impl From<&ChannelError> for GapSize {
    /// A floor that is not known counts as none.
    fn from(c: &ChannelError) -> Self {
        Self::of([c.before, c.after, c.floor.unwrap_or(0.0)], &c.unit)
    }
}

/// Share of a gap that is closed: (before − after)/(before − floor), at most 1 where the rest lies below the floor, 0 where
/// there is no gap. Values below 0 mean worse.
fn closed(before: f64, after: f64, floor: f64) -> f64 {
    match before > floor {
        true => ((before - after) / (before - floor)).min(1.0),
        false => 0.0,
    }
}

/// Error of one group of channels on held-out data.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ChannelError {
    /// Residual (`r1`..`r4`) and channel group.
    pub name: String,
    /// mm, deg or kPa.
    pub unit: String,
    /// Root mean square without the effects.
    pub before: f64,
    /// With them.
    pub after: f64,
    /// 95 % interval of `after`, from block to block, lower end first.
    pub after_ci95: [f64; 2],
    /// With the effects' response to the session's pressures in another order (r1: with their change half a session late):
    /// what helps as much as the true one does not depend on them. `None` where that was not computed.
    pub shuffled: Option<f64>,
    /// Of a healthy session; `None` where it is not known.
    pub floor: Option<f64>,
}

/// Share of the excess of all channels over their floors that is closed: Σ((before/floor)² − 1), as far as it is positive.
/// 0 where nothing exceeds its floor, or no floor is known.
pub fn closed_excess(channels: &[ChannelError]) -> f64 {
    let excess = |error: fn(&ChannelError) -> f64| -> f64 {
        let ratios = channels.iter().filter_map(|c| Some(error(c) / c.floor?));
        ratios.map(|r| (r * r - 1.0).max(0.0)).sum()
    };
    let before = excess(|c| c.before);
    match before > 0.0 {
        true => 1.0 - excess(|c| c.after) / before,
        false => 0.0,
    }
}

/// What was chosen in one fold of the held-out proof, from its training part alone.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FoldChoice {
    /// Which one (1-based).
    pub fold: usize,
    /// Ids of the effects with their channels (1-based; `None` as in [`Ranked::target`]); empty where nothing gained enough.
    pub effects: Vec<(String, Option<usize>)>,
}

/// What the effects do in sessions that had no part in finding them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Confirmed {
    /// Names of the sessions.
    pub sessions: Vec<String>,
    /// Root mean square error of the end pad's position without the effects, mm; `None` without motion capture.
    pub before_mm: Option<f64>,
    /// The same with them, mm; `None` likewise.
    pub after_mm: Option<f64>,
    /// Share of the gap that closes.
    pub closed: f64,
    /// The gap where the effects show.
    pub gap: GapSize,
    /// All channel groups.
    pub channels: Vec<ChannelError>,
}

impl Confirmed {
    /// From the errors in those sessions; `tip` is the channel group of the end pad's position.
    pub fn of(sessions: Vec<String>, gap: GapSize, channels: Vec<ChannelError>, tip: &str) -> Self {
        let tip = channels.iter().find(|c| c.name == tip);
        Self {
            sessions,
            before_mm: tip.map(|c| c.before),
            after_mm: tip.map(|c| c.after),
            closed: gap.closed,
            gap,
            channels,
        }
    }
}

impl FoldChoice {
    /// Whether it chose an effect on a channel (1-based; `None`: all of them, or there are none).
    pub fn chose(&self, id: &str, target: Option<usize>) -> bool {
        self.effects.iter().any(|(i, t)| i == id && *t == target)
    }
}

/// A fold of the held-out proof that could not be computed. Nothing is known of the effects on its blocks: they count
/// with the error of the model without the effects, and the fold as one that does not choose them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FailedFold {
    /// Which one (1-based).
    pub fold: usize,
    /// Of how many.
    pub of: usize,
    /// Why: the end of a sentence that begins with "because".
    pub reason: String,
}

impl FailedFold {
    /// One sentence.
    pub fn text(&self) -> String {
        format!(
            "Held-out fold {} of {} failed, because {}: its blocks count as without the effect.",
            self.fold, self.of, self.reason
        )
    }
}

/// When what is missing began, within the session.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Onset {
    /// Most likely time by the session's clock, s.
    pub t_s: f64,
    /// Its 95 % interval, begin and end, s.
    pub ci95: [f64; 2],
}

/// A discriminating excitation: a motion under which alternatives differ.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SeparateBy {
    /// Name of an excitation of the rig.
    pub excitation: String,
    /// The effects that it separates.
    pub effects: Vec<String>,
    /// Why.
    pub why: String,
}

/// Series for pictures: one entry per bin of the grid.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Traces {
    /// Times, s.
    pub t_s: Vec<f64>,
    /// Channel names of the rows of `before` and `after`.
    pub channels: Vec<String>,
    /// Residual per channel and bin without the effects, in units of the noise floor.
    pub before: Vec<Vec<f64>>,
    /// With the effects.
    pub after: Vec<Vec<f64>>,
    /// Measured end pad x, y, z in the frame of the motion capture, m; not finite where nothing was captured.
    pub measured_m: Vec<[f64; 3]>,
    /// Simulated without the effects, in the frame of the motion capture, m.
    pub before_m: Vec<[f64; 3]>,
    /// The same with the effects, m.
    pub after_m: Vec<[f64; 3]>,
    /// Orientation of the end pad in the same frame (quaternion w, x, y, z): measured (not finite where nothing was
    /// captured), without, with.
    pub turns: [Vec<[f64; 4]>; 3],
    /// How a tension that is missing depends on its input; `None` where it was not computed.
    pub tension: Option<Dependence>,
}

/// How the residual tension of a bellows depends on the input that explains most of it.
#[derive(Clone, Debug, PartialEq)]
pub struct Dependence {
    /// Which bellows, 0-based.
    pub bellows: usize,
    /// Its input, of [`FORCE_INPUTS`](super::FORCE_INPUTS).
    pub input: &'static str,
    /// Share of the square of the tension that follows it, 0..1.
    pub share: f64,
    /// Root mean square of the tension, N.
    pub rms_n: f64,
    /// Input (in its own unit) and tension (N), at every instant.
    pub points: Vec<[f64; 2]>,
}

impl Dependence {
    /// In words.
    pub fn text(&self) -> String {
        format!(
            "The tension that is missing in bellows {} ({:.2} N RMS) follows {} most: {:.0} % of its square",
            self.bellows + 1,
            self.rms_n,
            self.input,
            100.0 * self.share
        )
    }
}

impl Traces {
    /// The same with what `later` has from a time on.
    pub fn ending_with(mut self, later: Self) -> Self {
        let from = self.t_s.len().saturating_sub(later.t_s.len());
        if self.channels == later.channels {
            for (all, own) in [
                (&mut self.before, &later.before),
                (&mut self.after, &later.after),
            ] {
                for (all, own) in all.iter_mut().zip(own) {
                    all.splice(from.., own.iter().copied());
                }
            }
        }
        self.after_m.splice(from.., later.after_m);
        let [_, _, turns] = later.turns;
        self.turns[2].splice(from.., turns);
        self
    }
}

/// How much of a channel's residual an effect explains, instant by instant.
#[derive(Clone, Debug, PartialEq)]
pub struct Explained {
    /// The channel whose square error the effect lowers most.
    pub channel: String,
    /// The part that the effect explains and the residual without the effect, in units of the floor.
    pub points: Vec<[f64; 2]>,
}

impl Explained {
    /// Of a finding's residuals; `None` where no channel gains.
    pub fn of(traces: &Traces) -> Option<Self> {
        let rows = traces.before.iter().zip(&traces.after);
        let points = rows.map(|(before, after)| -> Vec<[f64; 2]> {
            let all = before.iter().zip(after).map(|(b, a)| [b - a, *b]);
            all.filter(|[x, y]| x.is_finite() && y.is_finite())
                .collect()
        });
        let gain = |p: &[[f64; 2]]| -> f64 { p.iter().map(|[x, y]| x * (2.0 * y - x)).sum() };
        let (channel, points) = traces
            .channels
            .iter()
            .zip(points)
            .max_by(|a, b| gain(&a.1).total_cmp(&gain(&b.1)))?;
        (gain(&points) > 0.0).then(|| Self {
            channel: channel.clone(),
            points,
        })
    }

    /// Ends of the explained part (0) or the residual (1) with a margin, zero and one floor at least among them.
    pub fn range(&self, of: usize) -> [f64; 2] {
        let all = self.points.iter().map(|p| p[of]);
        let (low, high) = all.fold((0.0, 1.0), |(low, high): (f64, f64), v| {
            (low.min(v), high.max(v))
        });
        let margin = 0.05 * (high - low);
        [low - margin, high + margin]
    }

    /// Ends of the line on which all of the residual is explained, within both ranges, lower end first.
    pub fn line(&self) -> [f64; 2] {
        let [x, y] = [self.range(0), self.range(1)];
        [x[0].max(y[0]), x[1].min(y[1])]
    }
}

impl Finding {
    /// Whether the terms of laws were tried, instead of the effects of the table.
    pub fn is_of_laws(&self) -> bool {
        self.candidates.iter().any(|c| term(&c.id).is_some())
    }

    /// What is missing: every entry is, and of an entry with several effects one, which the session does not identify.
    pub fn choices(&self) -> Vec<Vec<&FoundEffect>> {
        let all = self.effects.iter().enumerate();
        let own = all.filter(|(_, e)| e.instead_of.is_none());
        own.map(|(i, first)| {
            let others = self.effects.iter().filter(|e| e.instead_of == Some(i));
            std::iter::once(first).chain(others).collect()
        })
        .collect()
    }

    /// What is certainly missing, and sets of which one effect is.
    pub fn sure_and_open(&self) -> (Vec<&FoundEffect>, Vec<Vec<&FoundEffect>>) {
        let (sure, open): (Vec<_>, Vec<_>) = self.choices().into_iter().partition(|c| c.len() == 1);
        (sure.into_iter().flatten().collect(), open)
    }
}

/// All of it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Finding {
    /// The verdict.
    pub verdict: Verdict,
    /// What is to be added to the model; for [`Verdict::Indistinguishable`] the alternatives.
    pub effects: Vec<FoundEffect>,
    /// Everything that was fitted, best first.
    pub candidates: Vec<Ranked>,
    /// Significance threshold of the gain (5 % false-positive rate), nats.
    pub threshold: f64,
    /// Residuals that are correlated with a regressor.
    pub located: Vec<Located>,
    /// The gap before and after.
    pub gap: GapSize,
    /// Channel groups that got worse on held-out data.
    pub worse: Vec<ChannelError>,
    /// All channel groups.
    pub channels: Vec<ChannelError>,
    /// What was kept between what is fitted and what is held out, s.
    #[serde(default)]
    pub embargo_s: f64,
    /// When it began, where the session shows that it was not there from the start: all else is of the session from then on.
    /// Else `None`.
    #[serde(default)]
    pub onset: Option<Onset>,
    /// What each fold of the held-out proof chose.
    #[serde(default)]
    pub folds: Vec<FoldChoice>,
    /// Folds that could not be computed: they count against the effects.
    #[serde(default)]
    pub failed_folds: Vec<FailedFold>,
    /// What the effects do in other sessions; `None` where none was given, or nothing is named.
    #[serde(default)]
    pub proof: Option<Confirmed>,
    /// The discriminating excitation for the alternatives; `None` where there are none, or none discriminates.
    pub separate_by: Option<SeparateBy>,
    /// What limits the verdict, one sentence each; and for [`Verdict::Unknown`] what was observed.
    pub notes: Vec<String>,
    /// Names and hashes of the data by role: baseline and suspect session.
    pub data: BTreeMap<String, String>,
    /// Wall time, s.
    pub seconds: f64,
    /// For pictures.
    #[serde(skip)]
    pub traces: Traces,
}
