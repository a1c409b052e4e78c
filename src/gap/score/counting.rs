//! The counts.

use std::collections::BTreeMap;

use super::{
    About, Aliens, Confusion, FINDABLE, Key, KeyEffect, KeyValue, Line, Middle, Nulls, Onsets,
    Pairs, ParamLine, RUNGS, Rung, STRONG, Said, SaidEffect, Score, Scored, Share, State, Target,
};
use crate::gap::{Onset, Verdict};
use crate::sim::effects::{EFFECTS, Effect};

/// Normal quantile of a two-sided 95 % interval.
const Z95: f64 = 1.959_963_984_540_054;
/// As much short of a rung still stands on it: what sizing leaves.
const SIZED_WITHIN: f64 = 0.95;

/// Wilson's 95 % interval of a ratio, E. B. Wilson, J. Am. Stat. Assoc. 22 (1927) 209. `None` of nothing.
pub fn wilson(hits: usize, of: usize) -> Option<[f64; 2]> {
    if of == 0 {
        return None;
    }
    let n = of as f64;
    let p = hits as f64 / n;
    let z2 = Z95 * Z95;
    // (p + z²/2n ± z √(p(1−p)/n + z²/4n²)) / (1 + z²/n)
    let middle = p + z2 / (2.0 * n);
    let half = Z95 * (p * (1.0 - p) / n + z2 / (4.0 * n * n)).sqrt();
    let scale = 1.0 + z2 / n;
    Some([
        ((middle - half) / scale).max(0.0),
        ((middle + half) / scale).min(1.0),
    ])
}

/// Middle value; the mean of the two middle ones of an even number. `None` without values.
pub fn median(values: &[f64]) -> Option<f64> {
    let v = sorted(values);
    let n = v.len();
    match n {
        0 => None,
        _ if n % 2 == 1 => Some(v[n / 2]),
        _ => Some(0.5 * (v[n / 2 - 1] + v[n / 2])),
    }
}

/// 95 % interval of the median from order statistics, whatever the distribution; `None` for fewer
/// than six values, whose extremes do not hold it in 95 % of cases.
pub fn median_ci95(values: &[f64]) -> Option<[f64; 2]> {
    let v = sorted(values);
    let n = v.len();
    if n > 1000 {
        // The binomial is normal, and 2⁻ⁿ no number any more.
        let k = (0.5 * (n as f64 - Z95 * (n as f64).sqrt())) as usize;
        return Some([v[k - 1], v[n - k]]);
    }
    // The k-th smallest and the k-th largest value miss it with 2 P(B < k), B binomial (n, ½).
    let mut below = 0.5f64.powi(i32::try_from(n).ok()?);
    let mut term = below;
    let mut k = 0;
    while 2.0 * below <= 0.05 && k < n / 2 {
        k += 1;
        term *= (n - k + 1) as f64 / k as f64;
        below += term;
    }
    (k > 0).then(|| [v[k - 1], v[n - k]])
}

fn sorted(values: &[f64]) -> Vec<f64> {
    let mut v: Vec<f64> = values.iter().copied().filter(|x| x.is_finite()).collect();
    v.sort_by(f64::total_cmp);
    v
}

fn middle(values: &[f64]) -> Middle {
    let v = sorted(values);
    Middle {
        median: median(&v),
        ci95: median_ci95(&v),
        of: v.len(),
        max: v.last().copied(),
    }
}

/// The share of `of` for which `hit` holds.
fn share<T>(of: &[T], hit: impl Fn(&T) -> bool) -> Share {
    let hits = of.iter().filter(|x| hit(x)).count();
    Share {
        hits,
        of: of.len(),
        share: (!of.is_empty()).then(|| hits as f64 / of.len() as f64),
        ci95: wilson(hits, of.len()),
    }
}

fn effect(id: &str) -> Option<&'static Effect> {
    EFFECTS.iter().find(|e| e.id == id)
}

impl Key {
    /// Strength that the case has, times the floor: that of its weakest effect. `None` where that is not known.
    pub fn reached(&self) -> Option<f64> {
        let each = self.effects.iter().map(|e| match e.reached {
            Some(r) if e.capped => r,
            _ => self.strength,
        });
        each.reduce(f64::min)
    }

    /// The rung on which it stands; 0 below the lowest.
    fn rung(&self) -> f64 {
        let reached = self.reached().unwrap_or(0.0);
        let under = RUNGS.iter().filter(|r| reached >= SIZED_WITHIN * *r);
        under.fold(0.0, |a, r| r.max(a))
    }

    fn has(&self, id: &str) -> bool {
        self.effects.iter().any(|e| e.id == id)
    }

    fn capped(&self) -> bool {
        self.effects.iter().any(|e| e.capped)
    }
}

impl Said {
    /// From the finder's JSON; what does not read is a failure.
    pub fn from_json(text: &str) -> Self {
        serde_json::from_str(text).unwrap_or_else(|e| Self {
            error: Some(format!("the finder's JSON does not read: {e}")),
            ..Self::default()
        })
    }

    fn named(&self) -> bool {
        self.verdict == Some(Verdict::Named)
    }

    fn closed(&self) -> Option<f64> {
        self.gap.as_ref().and_then(|g| g.closed)
    }

    fn is_set(&self) -> bool {
        self.verdict == Some(Verdict::Indistinguishable)
    }

    fn has(&self, id: &str) -> bool {
        self.effects.iter().any(|e| e.id == id)
    }
}

impl Scored {
    /// The first effect that is named is the one that is hidden.
    fn top1(&self) -> bool {
        let first = self.said.effects.first();
        self.said.named() && first.is_some_and(|e| self.key.has(&e.id))
    }

    fn exact(&self) -> bool {
        self.top1() && self.said.effects.len() == 1
    }

    fn in_set(&self) -> bool {
        self.said.is_set() && self.key.effects.iter().any(|e| self.said.has(&e.id))
    }

    /// Number of hidden effects that are named.
    fn found(&self) -> usize {
        if !self.said.named() {
            return 0;
        }
        let hidden = self.key.effects.iter();
        hidden.filter(|e| self.said.has(&e.id)).count()
    }

    /// Effects of the table are claimed, by name or as a set.
    fn claims(&self) -> bool {
        self.said.named() || self.said.is_set()
    }

    fn verdict(&self, v: Verdict) -> bool {
        self.said.verdict == Some(v)
    }

    /// Pairs of what is hidden and what was named with the same id.
    fn matched(&self) -> Vec<(&KeyEffect, &SaidEffect)> {
        if !self.said.named() {
            return Vec::new();
        }
        let same = |k: &KeyEffect| self.said.effects.iter().find(|s| s.id == k.id);
        let hidden = self.key.effects.iter();
        hidden.filter_map(|k| Some((k, same(k)?))).collect()
    }

    fn right(&self) -> bool {
        match self.key.kind {
            About::Single | About::Begun => self.exact(),
            About::Null => self.verdict(Verdict::NothingMissing),
            About::Alien => self.verdict(Verdict::Unknown),
            About::Pair => self.found() == 2 && self.said.effects.len() == 2,
        }
    }

    /// The answer in short form.
    fn label(&self) -> String {
        let all = |joint: &str| {
            let ids = self.said.effects.iter().map(|e| label(&e.id, e.target));
            ids.collect::<Vec<_>>().join(joint)
        };
        match self.said.verdict {
            None => "failed".to_owned(),
            Some(Verdict::NothingMissing) => "nothing missing".to_owned(),
            Some(Verdict::Named) => all(" + "),
            Some(Verdict::Indistinguishable) => format!("one of: {}", all(", ")),
            Some(Verdict::Unknown) => "unknown".to_owned(),
            Some(Verdict::NotExcited) => "not excited".to_owned(),
        }
    }

    /// The answer for the confusion matrix: ids alone.
    fn column(&self) -> String {
        match self.said.verdict {
            Some(Verdict::Named) => {
                let ids: Vec<&str> = self.said.effects.iter().map(|e| e.id.as_str()).collect();
                ids.join(" + ")
            }
            Some(Verdict::Indistinguishable) if self.in_set() => "set with it".to_owned(),
            Some(Verdict::Indistinguishable) => "set without it".to_owned(),
            _ => self.label(),
        }
    }

    /// Its row in the confusion matrix.
    fn row(&self) -> String {
        match (self.key.kind, self.key.effects.first()) {
            (About::Alien, Some(e)) if effect(&e.id).is_some() => format!("left out: {}", e.id),
            (About::Alien, Some(e)) => format!("unmodelled: {}", e.id),
            (_, Some(e)) => e.id.clone(),
            (_, None) => "nothing".to_owned(),
        }
    }

    fn line(&self) -> Line {
        let hidden = self.key.effects.iter();
        let truth: Vec<String> = hidden.map(|e| label(&e.id, e.target)).collect();
        let reached = self.key.effects.iter().filter_map(|e| e.reached);
        Line {
            name: self.name.clone(),
            kind: self.key.kind,
            strength: self.key.strength,
            reached: reached.reduce(f64::min),
            truth: if truth.is_empty() {
                "nothing".to_owned()
            } else {
                truth.join(" + ")
            },
            said: self.label(),
            right: self.right(),
            closed: self.said.closed(),
            seconds: self.said.seconds,
            error: self.said.error.clone(),
        }
    }
}

fn label(id: &str, target: Option<usize>) -> String {
    target.map_or_else(|| id.to_owned(), |t| format!("{id}:{t}"))
}

/// Counts everything.
pub fn score(cases: &[Scored]) -> Score {
    let of =
        |kind: About| -> Vec<&Scored> { cases.iter().filter(|c| c.key.kind == kind).collect() };
    let (singles, nulls) = (of(About::Single), of(About::Null));
    let (aliens, pairs) = (of(About::Alien), of(About::Pair));
    let (findable, weak): (Vec<&Scored>, Vec<&Scored>) =
        singles.iter().partition(|c| c.key.rung() >= FINDABLE);
    let mut shown = findable.clone();
    shown.extend(&nulls);
    shown.extend(&aliens);

    let right: Vec<&Scored> = findable.iter().copied().filter(|c| c.top1()).collect();
    let on_channel = |c: &&Scored| c.key.effects[0].target == c.said.effects[0].target;
    let choosy = |c: &&Scored| effect(&c.key.effects[0].id).is_some_and(|e| e.target.count() > 0);
    let of_choice: Vec<&Scored> = right.iter().copied().filter(choosy).collect();
    let given_name: Vec<&Scored> = findable
        .iter()
        .copied()
        .filter(|c| c.said.named() && !c.said.effects.is_empty())
        .collect();
    let side = |id: &str| effect(id).map(|e| e.side);
    let same_side = |c: &&Scored| side(&c.key.effects[0].id) == side(&c.said.effects[0].id);

    let values =
        |f: fn(&Scored) -> Option<f64>| -> Vec<f64> { cases.iter().filter_map(f).collect() };
    let params = Params::of(cases);
    let mut out = Score {
        cases: cases.len(),
        failed: cases.iter().filter(|c| c.said.verdict.is_none()).count(),
        targets: Vec::new(),
        ladder: ladder(&singles, Key::rung),
        ladder_asked: ladder(&singles, |k| k.strength),
        capped: singles.iter().filter(|c| c.key.capped()).count(),
        channel: share(&right, on_channel),
        channel_of_choice: share(&of_choice, on_channel),
        side: share(&given_name, same_side),
        confusion: confusion(&shown),
        confusion_weak: confusion(&weak),
        nulls: score_nulls(&nulls),
        aliens: score_aliens(&aliens),
        pairs: score_pairs(&pairs),
        onsets: score_onsets(cases),
        param_error: middle(&params.errors()),
        param_covered: params.covered(),
        params: params.lines(),
        gap_closed: middle(&values(|c| {
            // Closing a gap that is not there is no merit.
            let real = c.said.named() && c.key.kind != About::Null;
            c.said.closed().filter(|_| real)
        })),
        seconds: middle(&values(|c| c.said.seconds)),
        lines: cases.iter().map(Scored::line).collect(),
    };
    out.targets = targets(&out, &findable);
    out
}

/// Singles by strength; rungs on which nothing stands are left out.
fn ladder(singles: &[&Scored], strength: impl Fn(&Key) -> f64) -> Vec<Rung> {
    let mut at: Vec<f64> = singles.iter().map(|c| strength(&c.key)).collect();
    at.sort_by(f64::total_cmp);
    at.dedup();
    let rung = |s: f64| {
        let here: Vec<&Scored> = singles
            .iter()
            .copied()
            .filter(|c| strength(&c.key) == s)
            .collect();
        Rung {
            strength: s,
            top1: share(&here, |c| c.top1()),
            exact: share(&here, |c| c.exact()),
            in_set: share(&here, |c| c.in_set()),
            right_or_in_set: share(&here, |c| c.top1() || c.in_set()),
        }
    };
    at.into_iter().map(rung).collect()
}

fn confusion(cases: &[&Scored]) -> Confusion {
    let mut out = Confusion::new();
    for c in cases {
        *out.entry(c.row())
            .or_default()
            .entry(c.column())
            .or_default() += 1;
    }
    out
}

fn score_nulls(nulls: &[&Scored]) -> Nulls {
    let unknown = |c: &Scored| c.verdict(Verdict::Unknown);
    Nulls {
        false_positive: share(nulls, |c| c.claims() || unknown(c)),
        named: share(nulls, |c| c.claims()),
        unknown: share(nulls, |c| unknown(c)),
    }
}

fn score_aliens(aliens: &[&Scored]) -> Aliens {
    let known = |c: &&Scored| c.key.effects.iter().any(|e| effect(&e.id).is_some());
    let (left_out, never): (Vec<&Scored>, Vec<&Scored>) = aliens.iter().partition(|c| known(c));
    Aliens {
        named_wrongly: share(aliens, |c| c.claims()),
        never_known: share(&never, |c| c.claims()),
        left_out: share(&left_out, |c| c.claims()),
        unknown: share(aliens, |c| c.verdict(Verdict::Unknown)),
        nothing: share(aliens, |c| c.verdict(Verdict::NothingMissing)),
    }
}

fn score_pairs(pairs: &[&Scored]) -> Pairs {
    let full: Vec<&Scored> = pairs
        .iter()
        .copied()
        .filter(|c| c.key.reached().unwrap_or(0.0) >= SIZED_WITHIN * c.key.strength)
        .collect();
    Pairs {
        both: share(pairs, |c| c.found() == 2),
        both_full_strength: share(&full, |c| c.found() == 2),
        one: share(pairs, |c| c.found() == 1),
        in_set: share(pairs, |c| c.in_set()),
    }
}

fn score_onsets(cases: &[Scored]) -> Onsets {
    let (begun, others): (Vec<&Scored>, Vec<&Scored>) =
        cases.iter().partition(|c| c.key.onset_s.is_some());
    let named: Vec<&Scored> = begun.iter().copied().filter(|c| c.top1()).collect();
    let pair = |c: &&Scored| Some((c.key.onset_s?, c.said.onset?));
    let found: Vec<(f64, Onset)> = begun.iter().filter_map(pair).collect();
    let errors: Vec<f64> = found.iter().map(|(s, o)| (o.t_s - s).abs()).collect();
    Onsets {
        named: share(&begun, |c| c.top1()),
        found: share(&named, |c| c.said.onset.is_some()),
        covered: share(&found, |(s, o)| (o.ci95[0]..=o.ci95[1]).contains(s)),
        error_s: middle(&errors),
        claimed: share(&others, |c| c.said.onset.is_some()),
    }
}

/// Fitted parameters against true ones, by `effect.parameter`.
struct Params(BTreeMap<String, Vec<Compared>>);

struct Compared {
    error: f64,
    covered: Option<bool>,
}

impl Params {
    fn of(cases: &[Scored]) -> Self {
        let mut out: BTreeMap<String, Vec<Compared>> = BTreeMap::new();
        for case in cases {
            for (key, said) in case.matched() {
                // On another channel the same name is another number.
                if key.target != said.target {
                    continue;
                }
                for (name, truth) in &key.params {
                    let Some(fit) = said.params.get(name) else {
                        continue;
                    };
                    let Some(value) = fit.value else { continue };
                    let compared = Compared {
                        error: (value - truth.value).abs() / size(key, truth),
                        covered: fit.ci95.map(|[a, b]| (a..=b).contains(&truth.value)),
                    };
                    let name = format!("{}.{name}", key.id);
                    out.entry(name).or_default().push(compared);
                }
            }
        }
        Self(out)
    }

    fn errors(&self) -> Vec<f64> {
        self.0.values().flatten().map(|c| c.error).collect()
    }

    fn covered(&self) -> Share {
        let covered: Vec<bool> = self
            .0
            .values()
            .flatten()
            .filter_map(|c| c.covered)
            .collect();
        share(&covered, |c| *c)
    }

    fn lines(&self) -> Vec<ParamLine> {
        let line = |(name, all): (&String, &Vec<Compared>)| {
            let errors: Vec<f64> = all.iter().map(|c| c.error).collect();
            let covered: Vec<bool> = all.iter().filter_map(|c| c.covered).collect();
            ParamLine {
                name: name.clone(),
                error_median: median(&errors),
                cases: all.len(),
                covered: share(&covered, |c| *c),
            }
        };
        self.0.iter().map(line).collect()
    }
}

/// What an error of a parameter is compared with: its distance from no effect, for components of a
/// vector that of the longest component; for a shape its value.
fn size(effect: &KeyEffect, of: &KeyValue) -> f64 {
    let away = |p: &KeyValue| p.none.map(|none| (p.value - none).abs());
    let alike = effect.params.values().filter(|p| p.unit == of.unit);
    let size = match of.none {
        Some(_) => alike.filter_map(away).fold(0.0, f64::max),
        None => of.value.abs(),
    };
    size.max(f64::MIN_POSITIVE)
}

fn targets(s: &Score, findable: &[&Scored]) -> Vec<Target> {
    let strong: Vec<&Scored> = findable
        .iter()
        .copied()
        .filter(|c| c.key.rung() >= STRONG)
        .collect();
    let of_share = |what: &str, wanted: [Option<f64>; 2], x: &Share| {
        target(what, wanted, x.share, x.ci95, "%", x.of)
    };
    let least = |x: f64| [Some(x), None];
    let most = |x: f64| [None, Some(x)];
    vec![
        of_share(
            "top-1 naming from 4 x noise floor on",
            least(0.95),
            &share(&strong, |c| c.top1()),
        ),
        of_share(
            "top-1 naming from 2 x noise floor on",
            least(0.85),
            &share(findable, |c| c.top1()),
        ),
        of_share("channel right among right names", least(0.98), &s.channel),
        of_share(
            "false positives without an effect",
            most(0.05),
            &s.nulls.false_positive,
        ),
        of_share(
            "unmodelled effects named wrongly",
            most(0.10),
            &s.aliens.named_wrongly,
        ),
        of_share("both of a pair found", least(0.80), &s.pairs.both),
        target(
            "gap closed where effects are named, median",
            least(0.85),
            s.gap_closed.median,
            s.gap_closed.ci95,
            "%",
            s.gap_closed.of,
        ),
        of_share(
            "95 % intervals hold the true value",
            [Some(0.90), Some(0.98)],
            &s.param_covered,
        ),
        target(
            "longest run of the finder",
            most(60.0),
            s.seconds.max,
            None,
            "s",
            s.seconds.of,
        ),
    ]
}

fn target(
    what: &str,
    wanted: [Option<f64>; 2],
    measured: Option<f64>,
    ci95: Option<[f64; 2]>,
    unit: &str,
    of: usize,
) -> Target {
    let good = |x: f64| wanted[0].is_none_or(|w| x >= w) && wanted[1].is_none_or(|w| x <= w);
    Target {
        what: what.to_owned(),
        wanted,
        measured,
        ci95,
        unit: unit.to_owned(),
        of,
        state: match measured {
            None => State::NoData,
            Some(x) if good(x) => State::Met,
            Some(_) => State::Missed,
        },
    }
}
