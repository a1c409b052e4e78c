//! How good the predictions are: paired errors, by workspace, load and speed, their peaks, where ground
//! truth is missing, and all of it as a table and as a report.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use super::decimate::envelope_of;
use super::history::{Channel, History, POSE_NAMES, Stats};

/// Ground truth away for longer than this while frames come is an occlusion, s.
pub const OCCLUSION_S: f64 = 0.25;
/// Peaks are at least this far apart, s.
pub const PEAK_APART_S: f64 = 1.0;
/// The tip's speed is a slope over twice this, s.
const SPEED_HALF_S: f64 = 0.1;

/// A prediction that was compared with ground truth.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scored {
    /// Instant of the snapshot that it came in, s.
    pub t_s: f64,
    /// Predicted minus measured: x, y, z in mm, yaw, pitch, roll in deg, the length of the translation
    /// error in mm and the angle of the rotation error in deg.
    pub error: [f64; 8],
    /// Predicted position in the base frame, mm.
    pub tip_mm: [f64; 3],
    /// Predicted speed, mm/s; `None` where the prediction has a gap.
    pub speed_mm_s: Option<f64>,
    /// Declared mass in the gripper, g.
    pub payload_g: f64,
}

impl Scored {
    /// Measured position in the base frame, mm.
    pub fn truth_mm(&self) -> [f64; 3] {
        std::array::from_fn(|k| self.tip_mm[k] - self.error[k])
    }
}

/// The paired errors within `[from_s, to_s]`, in order of time.
pub fn scored(history: &History, from_s: f64, to_s: f64) -> Vec<Scored> {
    // The eight errors of a pair stand in one row.
    let columns: [Vec<[f64; 2]>; 8] =
        std::array::from_fn(|i| history.points(Channel::Error(i), from_s, to_s).collect());
    let margin = 2.0 * SPEED_HALF_S;
    let tip: [Vec<[f64; 2]>; 3] = std::array::from_fn(|i| {
        let points = history.points(Channel::Tip(i), from_s - margin, to_s + margin);
        points.collect()
    });
    let payload: Vec<[f64; 2]> = history
        .points(Channel::Payload, from_s - margin, to_s)
        .collect();
    let n = columns.iter().map(Vec::len).min().unwrap_or(0);
    let [mut at, mut before, mut after] = [0; 3].map(|_| Newest::of(&tip[0]));
    let mut load = Newest::of(&payload);
    (0..n)
        .filter_map(|row| {
            let t_s = columns[0][row][0];
            let here = at.upto(t_s)?;
            let [before, after] = [
                before.upto(t_s - SPEED_HALF_S),
                after.upto(t_s + SPEED_HALF_S),
            ];
            Some(Scored {
                t_s,
                error: std::array::from_fn(|i| columns[i][row][1]),
                tip_mm: std::array::from_fn(|k| tip[k][here][1]),
                speed_mm_s: before
                    .zip(after)
                    .and_then(|(before, after)| speed(&tip, before, after)),
                payload_g: load.upto(t_s).map_or(0.0, |i| payload[i][1]),
            })
        })
        .collect()
}

/// The newest of some points at instants that only grow.
struct Newest<'a> {
    points: &'a [[f64; 2]],
    /// How many lie at or before the last instant.
    passed: usize,
}

impl<'a> Newest<'a> {
    fn of(points: &'a [[f64; 2]]) -> Self {
        Self { points, passed: 0 }
    }

    /// Index of the newest point at or before `t_s`.
    fn upto(&mut self, t_s: f64) -> Option<usize> {
        while self.points.get(self.passed).is_some_and(|q| q[0] <= t_s) {
            self.passed += 1;
        }
        self.passed.checked_sub(1)
    }
}

fn speed(tip: &[Vec<[f64; 2]>; 3], before: usize, after: usize) -> Option<f64> {
    let dt = tip[0][after][0] - tip[0][before][0];
    let squares: f64 = (0..3)
        .map(|k| (tip[k][after][1] - tip[k][before][1]).powi(2))
        .sum();
    (dt > SPEED_HALF_S && dt < 4.0 * SPEED_HALF_S).then(|| squares.sqrt() / dt)
}

/// Spans within `[from_s, to_s]` without ground truth for more than [`OCCLUSION_S`] while predictions came,
/// s. None where there never was any truth.
pub fn occlusions(history: &History, from_s: f64, to_s: f64) -> Vec<[f64; 2]> {
    let first = history
        .points(Channel::Truth(0), f64::NEG_INFINITY, to_s)
        .next();
    let alive = history.last_before(Channel::Tip(0), to_s);
    let (Some([first, _]), Some(alive)) = (first, alive) else {
        return Vec::new();
    };
    let start = first.max(from_s - OCCLUSION_S);
    let mut spans = history.gaps(Channel::Truth(0), start, alive.min(to_s), OCCLUSION_S);
    spans.retain(|[a, b]| tips_within(history, *a, *b));
    spans.iter_mut().for_each(|[a, _]| *a = a.max(from_s));
    spans
}

// Whether predictions came in between: without them nothing was there to be scored.
fn tips_within(history: &History, from_s: f64, to_s: f64) -> bool {
    history
        .points(Channel::Tip(0), from_s, to_s)
        .any(|q| q[0] > from_s && q[0] < to_s)
}

/// [`peaks_of`] the lengths of the translation errors.
#[cfg(test)]
pub fn peaks(scored: &[Scored]) -> Vec<[f64; 2]> {
    let errors: Vec<[f64; 2]> = scored.iter().map(|s| [s.t_s, s.error[6]]).collect();
    peaks_of(&errors)
}

/// Instants (s) and lengths (mm) of the peaks of errors in order of time: the largest within [`PEAK_APART_S`] on
/// both sides, and among the worst 5 %.
pub fn peaks_of(errors: &[[f64; 2]]) -> Vec<[f64; 2]> {
    let Some(stats) = Stats::of(errors.iter().map(|e| e[1])) else {
        return Vec::new();
    };
    let worst = errors.iter().copied().filter(|e| e[1] >= stats.p95);
    let mut worst: Vec<[f64; 2]> = worst.collect();
    worst.sort_by(|a, b| b[1].total_cmp(&a[1]));
    // By the second that they lie in: only the neighbours can be too near.
    let mut found: BTreeMap<i64, Vec<[f64; 2]>> = BTreeMap::new();
    for e in worst {
        let slot = (e[0] / PEAK_APART_S).floor() as i64;
        let mut near = found.range(slot - 1..=slot + 1).flat_map(|(_, of)| of);
        if near.all(|p| (p[0] - e[0]).abs() >= PEAK_APART_S) {
            found.entry(slot).or_default().push(e);
        }
    }
    let mut found: Vec<[f64; 2]> = found.into_values().flatten().collect();
    found.sort_by(|a, b| a[0].total_cmp(&b[0]));
    found
}

/// By what errors are sorted into bins.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum By {
    /// Distance of the tip from the arm's axis at rest, mm.
    #[default]
    Radius,
    /// Height of the tip, mm.
    Height,
    /// Declared mass in the gripper, g.
    Load,
    /// Speed of the tip, mm/s.
    Speed,
}

impl By {
    /// All there are.
    pub const ALL: [Self; 4] = [Self::Radius, Self::Height, Self::Load, Self::Speed];

    /// Name on screen.
    pub fn name(self) -> &'static str {
        match self {
            Self::Radius => "Radius",
            Self::Height => "Height",
            Self::Load => "Load",
            Self::Speed => "Speed",
        }
    }

    /// Unit on screen.
    pub fn unit(self) -> &'static str {
        match self {
            Self::Radius | Self::Height => "mm",
            Self::Load => "g",
            Self::Speed => "mm/s",
        }
    }

    // Width of a bin.
    fn width(self) -> f64 {
        match self {
            Self::Radius | Self::Height | Self::Speed => 20.0,
            Self::Load => 50.0,
        }
    }

    fn value(self, s: &Scored) -> Option<f64> {
        match self {
            Self::Radius => Some(s.tip_mm[0].hypot(s.tip_mm[1])),
            Self::Height => Some(s.tip_mm[2]),
            Self::Load => Some(s.payload_g),
            Self::Speed => s.speed_mm_s,
        }
    }
}

/// The errors of one bin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bin {
    /// First and last value of the bin, the last one outside.
    pub range: [f64; 2],
    /// Translation error, mm.
    pub translation: Stats,
    /// Rotation error, deg.
    pub rotation: Stats,
}

/// The errors in bins of equal width, in order, empty ones left out. At most twelve: wider bins otherwise.
pub fn bins(scored: &[Scored], by: By) -> Vec<Bin> {
    let values: Vec<(f64, &Scored)> = scored
        .iter()
        .filter_map(|s| Some((by.value(s)?, s)))
        .collect();
    let low = values.iter().map(|v| v.0).fold(f64::INFINITY, f64::min);
    let high = values.iter().map(|v| v.0).fold(f64::NEG_INFINITY, f64::max);
    if !low.is_finite() || !high.is_finite() {
        return Vec::new();
    }
    let mut width = by.width();
    while (high - low) / width > 11.0 {
        width *= 2.0;
    }
    let first = (low / width).floor() as i64;
    let last = (high / width).floor() as i64;
    (first..=last)
        .filter_map(|k| {
            let range = [k as f64 * width, (k + 1) as f64 * width];
            let inside = |v: &&(f64, &Scored)| (v.0 / width).floor() as i64 == k;
            let of = |i: usize| Stats::of(values.iter().filter(inside).map(|v| v.1.error[i]));
            Some(Bin {
                range,
                translation: of(6)?,
                rotation: of(7)?,
            })
        })
        .collect()
}

/// All pairs as a table: a line of names, then a line per pair.
pub fn csv(scored: &[Scored], origin: &str) -> String {
    let mut text = String::from("t_s");
    for i in 0..8 {
        let _ = write!(text, ",{}", error_name(i));
    }
    text.push_str(",predicted_x_mm,predicted_y_mm,predicted_z_mm,speed_mm_s,payload_g,origin\n");
    for s in scored {
        let _ = write!(text, "{:.6}", s.t_s);
        for v in s.error.iter().chain(&s.tip_mm) {
            let _ = write!(text, ",{v:.5}");
        }
        let speed = s.speed_mm_s.map_or_else(String::new, |v| format!("{v:.3}"));
        let _ = writeln!(text, ",{speed},{:.1},{origin}", s.payload_g);
    }
    text
}

fn error_name(i: usize) -> String {
    match i {
        6 => "translation_error_mm".into(),
        7 => "rotation_error_deg".into(),
        _ => format!("{}_error_{}", POSE_NAMES[i], Channel::Error(i).unit()),
    }
}

/// What a report states besides the errors.
#[derive(Clone, Debug, Default)]
pub struct ReportFacts {
    /// What was scored: a recording's name, or the live twin.
    pub source: String,
    /// `simulated` or `hardware`.
    pub origin: String,
    /// First and last instant scored, s.
    pub range_s: [f64; 2],
    /// Spans without ground truth, from and to, s.
    pub occlusions: Vec<[f64; 2]>,
    /// Poses of motion capture without a prediction at their instant.
    pub excluded: usize,
    /// Published mean absolute errors, in the order of [`Scored::error`]; `None` where none is published.
    pub paper: [Option<f64>; 8],
    /// Frame transform and clocks: one sentence each.
    pub frames: Vec<String>,
}

/// A report as one HTML file that needs nothing else.
pub fn report(scored: &[Scored], facts: &ReportFacts) -> String {
    let mut h = String::from(REPORT_HEAD);
    let source = escaped(&facts.source);
    let [from, to] = facts.range_s;
    let occluded: f64 = facts.occlusions.iter().map(|[a, b]| b - a).sum();
    let _ = write!(
        h,
        "<h1>Accuracy of the predicted pose</h1>\n<p><b>{source}</b>, <b>{origin} data</b>, {from:.1} to \
         {to:.1} s, {n} poses compared. {spans} occlusions ({occluded:.1} s) and {excluded} poses without a \
         prediction at their instant are left out. Errors are predicted minus measured at the instant of \
         each measured pose. The paper's values are means on hardware.</p>\n",
        origin = escaped(&facts.origin),
        n = scored.len(),
        spans = facts.occlusions.len(),
        excluded = facts.excluded,
    );
    h.push_str("<table><tr><th></th><th>mean</th><th>paper</th><th>RMSE</th><th>P50</th><th>P95</th><th>max</th><th>n</th></tr>\n");
    for i in [6, 0, 1, 2, 7, 3, 4, 5] {
        let Some(s) = Stats::of(scored.iter().map(|s| s.error[i])) else {
            continue;
        };
        let paper = facts.paper[i].map_or("—".into(), |v| format!("{v:.2}"));
        let _ = writeln!(
            h,
            "<tr><td>{} / {}</td><td>{:.2}</td><td>{paper}</td><td>{:.2}</td><td>{:.2}</td><td>{:.2}</td><td>{:.2}</td><td>{}</td></tr>",
            row_name(i),
            Channel::Error(i).unit(),
            s.mean,
            s.rmse,
            s.p50,
            s.p95,
            s.max,
            s.n
        );
    }
    h.push_str("</table>\n");
    for by in By::ALL {
        bins_table(&mut h, scored, by);
    }
    h.push_str("<h2>Over time</h2>\n");
    for i in 0..8 {
        strip(&mut h, scored, i, facts);
    }
    h.push_str("<h2>Frames and clocks</h2>\n<ul>\n");
    for line in &facts.frames {
        let _ = writeln!(h, "<li>{}</li>", escaped(line));
    }
    h.push_str("</ul>\n</body></html>\n");
    h
}

const REPORT_HEAD: &str = "<!doctype html>\n<html lang=\"en\"><head><meta charset=\"utf-8\">\
<title>Accuracy of the predicted pose</title><style>body{font:15px sans-serif;max-width:56em;margin:2em auto;\
padding:0 1em;color:#171a1e}table{border-collapse:collapse}td,th{padding:.2em .8em;text-align:right;\
border-bottom:1px solid #c2c8ce}td:first-child{text-align:left}svg{display:block;margin:.4em 0}</style></head><body>\n";

/// Name of an error on screen.
pub fn row_name(i: usize) -> &'static str {
    match i {
        6 => "translation",
        7 => "rotation",
        _ => POSE_NAMES[i],
    }
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
}

fn bins_table(h: &mut String, scored: &[Scored], by: By) {
    let _ = writeln!(
        h,
        "<h2>By {}</h2>\n<table><tr><th>{} / {}</th><th>mean / mm</th><th>P95 / mm</th><th>mean / deg</th><th>P95 / deg</th><th>n</th></tr>",
        by.name().to_lowercase(),
        by.name().to_lowercase(),
        by.unit()
    );
    for b in bins(scored, by) {
        let _ = writeln!(
            h,
            "<tr><td>{:.0} to {:.0}</td><td>{:.2}</td><td>{:.2}</td><td>{:.2}</td><td>{:.2}</td><td>{}</td></tr>",
            b.range[0],
            b.range[1],
            b.translation.mean,
            b.translation.p95,
            b.rotation.mean,
            b.rotation.p95,
            b.translation.n
        );
    }
    h.push_str("</table>\n");
}

// One error over time as a picture.
fn strip(h: &mut String, scored: &[Scored], i: usize, facts: &ReportFacts) {
    const W: f64 = 860.0;
    const H: f64 = 90.0;
    let [from, to] = facts.range_s;
    let largest = scored.iter().map(|s| s.error[i].abs()).fold(0.0, f64::max);
    if largest <= 0.0 || to <= from {
        return;
    }
    let x = |t: f64| (t - from) / (to - from) * W;
    let y = |v: f64| 0.5 * H - v / largest * 0.46 * H;
    let _ = writeln!(
        h,
        "<div>{} error / {}, axis ±{largest:.2}</div><svg width=\"{W}\" height=\"{H}\" viewBox=\"0 0 {W} {H}\"><rect width=\"{W}\" height=\"{H}\" fill=\"#f6f7f8\"/>",
        row_name(i),
        Channel::Error(i).unit()
    );
    for [a, b] in &facts.occlusions {
        let _ = write!(
            h,
            "<rect x=\"{:.1}\" width=\"{:.1}\" height=\"{H}\" fill=\"#c2c8ce\"/>",
            x(*a),
            x(*b) - x(*a)
        );
    }
    let _ = write!(h, "<path d=\"M0 {0:.1}H{W}\" stroke=\"#7b8692\"/>", y(0.0));
    let points = scored.iter().map(|s| [s.t_s, s.error[i]]);
    for piece in envelope_of(points, (to - from) / W) {
        h.push_str("<polyline fill=\"none\" stroke=\"#0072b2\" points=\"");
        for [t, v] in piece {
            let _ = write!(h, "{:.1},{:.1} ", x(t), y(v));
        }
        h.push_str("\"/>");
    }
    h.push_str("</svg>\n");
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::analysis::fixture;

    fn session() -> Vec<Scored> {
        let snapshots = fixture::session(20);
        let history = History::of(snapshots.iter());
        scored(&history, f64::NEG_INFINITY, f64::INFINITY)
    }

    #[test]
    fn pairs_know_where_and_how_fast_the_tip_was() {
        let all = session();
        assert!(all.len() > 900, "{}", all.len());
        let s = all[500];
        let snapshot = fixture::snapshot(s.t_s);
        let truth = snapshot.truth.expect("has truth").base_from_tip.translation;
        for k in 0..3 {
            assert!((s.truth_mm()[k] - truth.vector[k] * 1e3).abs() < 1e-2);
        }
        assert_eq!(s.payload_g, 35.0);
        let speed = s.speed_mm_s.expect("in the middle");
        assert!(speed > 1.0 && speed < 200.0, "{speed}");
    }

    #[test]
    fn bins_share_out_every_pair() {
        let all = session();
        for by in By::ALL {
            let bins = bins(&all, by);
            let n: usize = bins.iter().map(|b| b.translation.n).sum();
            let known = all.iter().filter(|s| by.value(s).is_some()).count();
            assert_eq!(n, known, "{by:?}");
            assert!(!bins.is_empty() && bins.len() <= 13, "{by:?}");
        }
        assert_eq!(bins(&all, By::Load).len(), 1);
        assert!(bins(&[], By::Speed).is_empty());
    }

    #[test]
    fn peaks_are_the_worst_and_stand_apart() {
        let mut all = session();
        all[200].error[6] = 50.0;
        all[210].error[6] = 40.0;
        all[600].error[6] = 60.0;
        let found = peaks(&all);
        assert!(found.contains(&[all[200].t_s, 50.0]) && found.contains(&[all[600].t_s, 60.0]));
        assert!(
            !found.iter().any(|p| p[1] == 40.0),
            "within a second of a larger one"
        );
        assert!(found.windows(2).all(|w| w[1][0] - w[0][0] >= PEAK_APART_S));
        assert!(peaks(&[]).is_empty());
    }

    #[test]
    fn occlusions_are_where_truth_is_away_while_predictions_come() {
        let mut snapshots = fixture::session(20);
        for s in &mut snapshots {
            let t = s.stamp.seconds();
            if (105.0..107.0).contains(&t) || t > 118.0 {
                s.truth = None;
            }
        }
        // A pause of everything is no occlusion.
        snapshots.retain(|s| !(110.0..112.0).contains(&s.stamp.seconds()));
        let spans = occlusions(&History::of(snapshots.iter()), 100.0, 120.0);
        assert_eq!(spans.len(), 2, "{spans:?}");
        assert!((spans[0][0] - 105.0).abs() < 0.05 && (spans[0][1] - 107.0).abs() < 0.05);
        assert!((spans[1][0] - 118.0).abs() < 0.05 && spans[1][1] > 119.9);
        // Seen through a narrow window, and where there never was truth.
        let h = History::of(snapshots.iter());
        let last = h.points(Channel::Tip(0), 100.0, 106.5).last();
        let last = last.expect("predictions go on")[0];
        assert_eq!(occlusions(&h, 106.0, 106.5), [[106.0, last]]);
        for s in &mut snapshots {
            s.truth = None;
        }
        assert!(occlusions(&History::of(snapshots.iter()), 100.0, 120.0).is_empty());
    }

    #[test]
    fn the_table_holds_every_pair_and_the_report_says_what_it_rests_on() {
        let all = session();
        let table = csv(&all, "simulated");
        let mut lines = table.lines();
        let names: Vec<_> = lines.next().expect("names").split(',').collect();
        assert_eq!(names[..2], ["t_s", "x_error_mm"]);
        let rows: Vec<Vec<&str>> = lines.map(|l| l.split(',').collect()).collect();
        assert_eq!(rows.len(), all.len());
        assert!(rows.iter().all(|r| r.len() == names.len()));
        let x: f64 = rows[7][1].parse().expect("a number");
        assert!((x - all[7].error[0]).abs() < 1e-4);
        let facts = ReportFacts {
            source: "<bench>".into(),
            origin: "simulated".into(),
            range_s: [100.0, 120.0],
            occlusions: vec![[105.0, 107.0]],
            ..ReportFacts::default()
        };
        let html = report(&all, &facts);
        assert!(html.contains("&lt;bench&gt;") && html.contains("simulated data"));
        assert!(html.contains("1 occlusions (2.0 s)"));
        assert_eq!(html.matches("<svg").count(), 8);
    }
}
