//! The calibration bench: its log, and the fit of one curve per spring.
//!
//! A linear motor draws each spring over its range, up and down; every row of the log holds the
//! true length and what the circuit read. The fitter takes a quartic by least squares and refuses
//! what would mislead: a curve that turns round, a log that does not span the range the robot uses,
//! a curve that misses 0.4 mm on points it has not seen.

use nalgebra::{SMatrix, SVector};
use sha2::{Digest, Sha256};

use super::calibration::{
    Calibration, Curve, FitQuality, Quantity, SpringCalibration, Variable, inductance_h,
};
use crate::signal::{SPRINGS, hex};

/// Largest root mean square error on held-out points, m (the paper's resolution).
pub const HELD_OUT_LIMIT_M: f64 = 0.4e-3;
/// How far the log may stop short of the range it must span, m.
const END_SLACK_M: f64 = 1.0e-3;
/// Fewest different lengths: twice the number of coefficients.
const LENGTHS_MIN: usize = 10;
/// The lengths are dealt into this many groups, each held out once.
const FOLDS: usize = 5;
/// Nominal capacitor of eq. (1), F (paper II-C, corrected).
pub const CAPACITANCE_F: f64 = 1000.0e-12;
/// Nominal series inductor of eq. (1), H (paper II-C, corrected).
pub const COMPENSATION_H: f64 = 10.0e-6;

/// Capacitor and series inductor of one channel of the boards: eq. (1) needs both to turn a frequency into an inductance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Channel {
    /// C of eq. (1), F.
    pub capacitance_f: f64,
    /// L_comp of eq. (1), H.
    pub compensation_h: f64,
}

impl Channel {
    /// The nominal parts. They serve where readings are frequencies of the channel itself: an error of the parts is then in
    /// the curve, too, and has no effect on the length.
    pub const NOMINAL: Self = Self {
        capacitance_f: CAPACITANCE_F,
        compensation_h: COMPENSATION_H,
    };
}

/// Capacitances that a log may state, pF: a decade on either side of the nominal one.
const CAPACITANCES_PF: [f64; 2] = [100.0, 10_000.0];
/// Series inductances that a log may state, µH: a decade on either side of the nominal one.
const COMPENSATIONS_UH: [f64; 2] = [1.0, 100.0];

/// Why a bench log was refused.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("bench log, line {line}, column {column}: {what}")]
pub struct BenchError {
    /// Line, 1-based.
    pub line: usize,
    /// Field of the line, 1-based.
    pub column: usize,
    /// What is wrong and what is expected.
    pub what: String,
}

/// Why no curve was fitted. Figures are given where they could be computed.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum FitError {
    /// Not enough different lengths.
    #[error(
        "only {lengths} different lengths were measured; measure at least {LENGTHS_MIN}, up and down"
    )]
    TooFew {
        /// Different lengths in the log.
        lengths: usize,
    },
    /// The log does not span the range the curve must cover.
    #[error(
        "the log spans {:.1} to {:.1} mm, but the robot uses {:.1} to {:.1} mm and a curve must not be extrapolated; measure the whole range",
        measured_m[0] * 1e3, measured_m[1] * 1e3, needed_m[0] * 1e3, needed_m[1] * 1e3
    )]
    Extrapolates {
        /// Shortest and longest length in the log, m.
        measured_m: [f64; 2],
        /// Shortest and longest length in use, m.
        needed_m: [f64; 2],
    },
    /// The fitted curve turns round.
    #[error(
        "the fitted curve is not monotone over its domain; look for outliers and measure again"
    )]
    NotMonotone {
        /// How well it fits all the same.
        quality: FitQuality,
    },
    /// Misses points that were held out.
    #[error(
        "the curve misses held-out points by {:.2} mm RMSE, more than 0.4 mm; check the wiring and measure again",
        quality.held_out_rmse_m * 1e3
    )]
    Inaccurate {
        /// How badly it fits.
        quality: FitQuality,
    },
    /// The normal equations have no solution: all readings equal, or not finite.
    #[error("the readings do not change with the length; check the wiring")]
    Degenerate,
}

/// Which way the motor moved.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Direction {
    /// Towards longer.
    Up,
    /// Towards shorter.
    Down,
}

/// One row of the log.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BenchPoint {
    /// True length by the motor, m.
    pub length_m: f64,
    /// Reading, in the unit of the log's [`Quantity`].
    pub reading: f64,
    /// Which way the motor moved.
    pub direction: Direction,
}

/// A bench log.
#[derive(Clone, Debug, PartialEq)]
pub struct BenchLog {
    /// What the readings are.
    pub quantity: Quantity,
    /// Spring (1-based) and its points in the order of the log; springs in rising order.
    pub springs: Vec<(usize, Vec<BenchPoint>)>,
    /// The channel of every spring: measured where the readings are inductances, nominal otherwise.
    pub channels: [Channel; SPRINGS],
    /// SHA-256 of the log, hexadecimal.
    pub sha256: String,
}

/// How the reading's column becomes a reading.
#[derive(Clone, Copy)]
enum Source {
    Frequency { hz_per_unit: f64 },
    InductanceUh,
    Circuit,
}

const READINGS: [(&str, Source); 5] = [
    ("frequency_hz", Source::Frequency { hz_per_unit: 1.0 }),
    ("frequency_khz", Source::Frequency { hz_per_unit: 1e3 }),
    ("frequency_mhz", Source::Frequency { hz_per_unit: 1e6 }),
    ("inductance_uh", Source::InductanceUh),
    ("reading", Source::Circuit),
];

struct Columns {
    spring: usize,
    length_mm: usize,
    reading: usize,
    source: Source,
    direction: Option<usize>,
    /// Columns of the channel's capacitor and series inductor, where the readings are inductances.
    channel: Option<[usize; 2]>,
}

fn columns(line: usize, header: &str) -> Result<Columns, BenchError> {
    let names: Vec<String> = header
        .split(',')
        .map(|n| n.trim().trim_matches('"').to_ascii_lowercase())
        .collect();
    let find = |wanted: &str| names.iter().position(|n| n == wanted);
    let missing = |what: &str| BenchError {
        line,
        column: names.len(),
        what: format!(
            "no column {what}; the header must name spring, length_mm, one of frequency_hz, frequency_khz, frequency_mhz, reading, inductance_uh (with capacitance_pf and compensation_uh), and may name direction"
        ),
    };
    let (reading, source) = READINGS
        .iter()
        .find_map(|(name, source)| find(name).map(|at| (at, *source)))
        .ok_or_else(|| missing("with the reading"))?;
    let channel = match source {
        Source::InductanceUh => Some(channel_columns(line, reading, &find)?),
        Source::Frequency { .. } | Source::Circuit => None,
    };
    Ok(Columns {
        spring: find("spring").ok_or_else(|| missing("spring"))?,
        length_mm: find("length_mm").ok_or_else(|| missing("length_mm"))?,
        reading,
        source,
        direction: find("direction"),
        channel,
    })
}

/// Columns of the capacitor and the series inductor, which a log of inductances must have.
fn channel_columns(
    line: usize,
    reading: usize,
    find: &impl Fn(&str) -> Option<usize>,
) -> Result<[usize; 2], BenchError> {
    const NAMES: [&str; 2] = ["capacitance_pf", "compensation_uh"];
    if let [Some(capacitance), Some(compensation)] = NAMES.map(find) {
        return Ok([capacitance, compensation]);
    }
    let missing: Vec<&str> = NAMES
        .into_iter()
        .filter(|name| find(name).is_none())
        .collect();
    Err(BenchError {
        line,
        column: reading + 1,
        what: format!(
            "an inductance alone does not determine the capacitor and the series inductor of the spring's channel: \
             log frequency_hz with every spring plugged into its own channel, or add the missing {} with the values \
             measured on each channel's board",
            missing.join(" and ")
        ),
    })
}

/// Reads a bench log: CSV with a header row naming `spring` (1 … 12), `length_mm`, one of
/// `frequency_hz`, `frequency_khz`, `frequency_mhz`, `reading`, `inductance_uh`, and optionally `direction`
/// (`up` or `down`; taken from the order of the lengths when absent). `inductance_uh` needs the columns
/// `capacitance_pf` and `compensation_uh` beside it: what was measured on the board of the spring's channel. Other columns
/// are ignored, as are empty lines and lines that start with `#`.
///
/// # Errors
/// [`BenchError`] with line and column of the first thing that cannot be read.
pub fn parse_bench(text: &str) -> Result<BenchLog, BenchError> {
    let sha256 = hex(&Sha256::digest(text.as_bytes()));
    let text = text.strip_prefix('\u{feff}').unwrap_or(text);
    let mut rows = text
        .lines()
        .enumerate()
        .map(|(i, row)| (i + 1, row))
        .filter(|(_, row)| !row.trim().is_empty() && !row.trim_start().starts_with('#'));
    let (line, header) = rows.next().ok_or_else(|| BenchError {
        line: 1,
        column: 1,
        what: "the log is empty; expected a header row".into(),
    })?;
    let columns = columns(line, header)?;
    let mut springs: Vec<(usize, Vec<BenchPoint>)> = Vec::new();
    let mut channels = [Channel::NOMINAL; SPRINGS];
    for (line, row) in rows {
        let fields: Vec<&str> = row.split(',').map(|f| f.trim().trim_matches('"')).collect();
        let Row {
            spring,
            length_m,
            reading,
            direction: stated,
        } = parse_row(line, &fields, &columns)?;
        if let Some(at) = columns.channel {
            let known = springs.iter().any(|s| s.0 == spring);
            let channel = parse_channel(line, &fields, at)?;
            if known && channel != channels[spring - 1] {
                return Err(BenchError {
                    line,
                    column: at[0] + 1,
                    what: format!(
                        "spring {spring} has another capacitor or series inductor than in the rows above; a channel has one of each"
                    ),
                });
            }
            channels[spring - 1] = channel;
        }
        let at = match springs.binary_search_by_key(&spring, |s| s.0) {
            Ok(at) => at,
            Err(at) => {
                springs.insert(at, (spring, Vec::new()));
                at
            }
        };
        let points = &mut springs[at].1;
        let direction = stated.unwrap_or_else(|| match points.last() {
            Some(last) if length_m < last.length_m => Direction::Down,
            Some(last) if length_m == last.length_m => last.direction,
            _ => Direction::Up,
        });
        points.push(BenchPoint {
            length_m,
            reading,
            direction,
        });
    }
    Ok(BenchLog {
        quantity: match columns.source {
            Source::Circuit => Quantity::CircuitReading,
            _ => Quantity::InductanceUh,
        },
        springs,
        channels,
        sha256,
    })
}

/// What one row of the log states.
struct Row {
    spring: usize,
    length_m: f64,
    reading: f64,
    direction: Option<Direction>,
}

/// Field `at` of a row.
fn field<'a>(line: usize, fields: &[&'a str], at: usize) -> Result<&'a str, BenchError> {
    fields.get(at).copied().ok_or_else(|| BenchError {
        line,
        column: fields.len() + 1,
        what: "the row ends too early".into(),
    })
}

/// The finite number in field `at` of a row.
fn number(line: usize, fields: &[&str], at: usize) -> Result<f64, BenchError> {
    let text = field(line, fields, at)?;
    text.parse::<f64>()
        .ok()
        .filter(|x| x.is_finite())
        .ok_or_else(|| BenchError {
            line,
            column: at + 1,
            what: format!("expected a number, found `{text}`"),
        })
}

/// Capacitor and series inductor that a row states for its channel.
fn parse_channel(line: usize, fields: &[&str], at: [usize; 2]) -> Result<Channel, BenchError> {
    let part = |at: usize, [low, high]: [f64; 2], unit: &str| {
        let value = number(line, fields, at)?;
        if (low..=high).contains(&value) {
            return Ok(value);
        }
        Err(BenchError {
            line,
            column: at + 1,
            what: format!(
                "{value} {unit} is not a part of a channel, {low}-{high} {unit} is expected; check the unit"
            ),
        })
    };
    Ok(Channel {
        capacitance_f: part(at[0], CAPACITANCES_PF, "pF")? * 1e-12,
        compensation_h: part(at[1], COMPENSATIONS_UH, "µH")? * 1e-6,
    })
}

fn parse_row(line: usize, fields: &[&str], columns: &Columns) -> Result<Row, BenchError> {
    let wrong = |at: usize, what: String| BenchError {
        line,
        column: at + 1,
        what,
    };
    let field = |at: usize| field(line, fields, at);
    let number = |at: usize| number(line, fields, at);
    let text = field(columns.spring)?;
    let spring = text
        .parse()
        .ok()
        .filter(|n| (1..=SPRINGS).contains(n))
        .ok_or_else(|| {
            wrong(
                columns.spring,
                format!("expected a spring 1 to 12, found `{text}`"),
            )
        })?;
    let length_mm = number(columns.length_mm)?;
    // Half the shortest and twice the longest working length.
    if !(35.0..=480.0).contains(&length_mm) {
        return Err(wrong(
            columns.length_mm,
            format!(
                "a length of {length_mm} mm is not a spring's, 70-240 mm is expected; check the unit"
            ),
        ));
    }
    let logged = number(columns.reading)?;
    let reading = match columns.source {
        Source::Frequency { hz_per_unit } if logged > 0.0 => {
            inductance_h(logged * hz_per_unit, CAPACITANCE_F, COMPENSATION_H) * 1e6
        }
        Source::Frequency { .. } => {
            return Err(wrong(
                columns.reading,
                format!("a frequency of {logged} is not possible"),
            ));
        }
        Source::InductanceUh | Source::Circuit => logged,
    };
    let direction = match columns.direction {
        None => None,
        Some(at) => match field(at)?.to_ascii_lowercase().as_str() {
            "up" | "u" | "+1" | "1" => Some(Direction::Up),
            "down" | "d" | "-1" => Some(Direction::Down),
            other => {
                return Err(wrong(at, format!("expected up or down, found `{other}`")));
            }
        },
    };
    Ok(Row {
        spring,
        length_m: length_mm * 1e-3,
        reading,
        direction,
    })
}

/// SHA-256 of points, hexadecimal, where they come from no log or from several.
pub fn digest<'a>(points: impl Iterator<Item = (usize, &'a BenchPoint)>) -> String {
    let mut hash = Sha256::new();
    for (spring, p) in points {
        hash.update((spring as u64).to_le_bytes());
        hash.update(p.length_m.to_le_bytes());
        hash.update(p.reading.to_le_bytes());
    }
    hex(&hash.finalize())
}

/// Fits one spring's curve over `needed_m`, the shortest and longest length the robot uses.
///
/// The quartic is tried in the reading and in its reciprocal; the one with the smaller held-out
/// error is kept. Lengths are dealt into five groups in turn, and each group is predicted from the
/// others (never the two end lengths: that would be extrapolation).
///
/// # Errors
/// [`FitError`]: too few lengths, range not spanned, not monotone, or more than 0.4 mm off.
pub fn fit(
    points: &[BenchPoint],
    quantity: Quantity,
    needed_m: [f64; 2],
) -> Result<(Curve, FitQuality), FitError> {
    let lengths_m = stops_m(points);
    let (Some(&shortest_m), Some(&longest_m)) = (lengths_m.first(), lengths_m.last()) else {
        return Err(FitError::TooFew { lengths: 0 });
    };
    if lengths_m.len() < LENGTHS_MIN {
        return Err(FitError::TooFew {
            lengths: lengths_m.len(),
        });
    }
    if shortest_m > needed_m[0] + END_SLACK_M || longest_m < needed_m[1] - END_SLACK_M {
        return Err(FitError::Extrapolates {
            measured_m: [shortest_m, longest_m],
            needed_m,
        });
    }
    let (curve, quality) = judged(points, quantity, &lengths_m).ok_or(FitError::Degenerate)?;
    if quality.held_out_rmse_m > HELD_OUT_LIMIT_M {
        return Err(FitError::Inaccurate { quality });
    }
    if !curve.is_monotone() {
        return Err(FitError::NotMonotone { quality });
    }
    Ok((curve, quality))
}

/// Different lengths of the points, shortest first, m.
fn stops_m(points: &[BenchPoint]) -> Vec<f64> {
    let mut lengths_m: Vec<f64> = points.iter().map(|p| p.length_m).collect();
    lengths_m.sort_by(f64::total_cmp);
    // Stops closer than 10 µm are one stop of the motor.
    lengths_m.dedup_by(|a, b| (*a - *b).abs() < 10e-6);
    lengths_m
}

/// In what a quartic of these points can be one.
fn variables(points: &[BenchPoint]) -> Vec<Variable> {
    match points.iter().all(|p| p.reading > 0.0) {
        true => vec![Variable::Reading, Variable::Reciprocal],
        false => vec![Variable::Reading],
    }
}

/// The quartic with the smallest held-out error, and its errors; `None` where the readings determine none.
fn judged(
    points: &[BenchPoint],
    quantity: Quantity,
    lengths_m: &[f64],
) -> Option<(Curve, FitQuality)> {
    let stop = |p: &BenchPoint| {
        lengths_m
            .partition_point(|l| *l < p.length_m - 10e-6)
            .min(lengths_m.len() - 1)
    };
    let mut best: Option<(Curve, FitQuality)> = None;
    for variable in variables(points) {
        let Some(curve) = quartic(points, quantity, variable) else {
            continue;
        };
        let Some(held_out_rmse_m) = held_out(points, &curve, &stop, lengths_m.len()) else {
            continue;
        };
        if best
            .as_ref()
            .is_none_or(|(_, q)| held_out_rmse_m < q.held_out_rmse_m)
        {
            let quality = quality(points, &curve, held_out_rmse_m, &stop, lengths_m.len());
            best = Some((curve, quality));
        }
    }
    best
}

/// Least squares quartic of points so far, without a verdict: the one that [`fit`] judges, accepted or not. `None` below six
/// different lengths (a quartic through five has no residuals), and where the readings determine none.
pub fn curve_so_far(points: &[BenchPoint], quantity: Quantity) -> Option<Curve> {
    let lengths_m = stops_m(points);
    if lengths_m.len() < 6 {
        return None;
    }
    if let Some((curve, _)) = judged(points, quantity, &lengths_m) {
        return Some(curve);
    }
    let square = |c: &Curve| residuals_m(c, points).iter().map(|r| r * r).sum::<f64>();
    let curves = variables(points).into_iter();
    curves
        .filter_map(|variable| quartic(points, quantity, variable))
        .min_by(|a, b| square(a).total_cmp(&square(b)))
}

/// Length by a curve less the true length, per point, m.
pub fn residuals_m(curve: &Curve, points: &[BenchPoint]) -> Vec<f64> {
    let all = points.iter();
    all.map(|p| curve.extended_m(p.reading) - p.length_m)
        .collect()
}

/// Least squares quartic on the basis scaled to the readings' range.
fn quartic(points: &[BenchPoint], quantity: Quantity, variable: Variable) -> Option<Curve> {
    let low = points
        .iter()
        .map(|p| p.reading)
        .fold(f64::INFINITY, f64::min);
    let high = points
        .iter()
        .map(|p| p.reading)
        .fold(f64::NEG_INFINITY, f64::max);
    let (a, b) = (variable.of(low), variable.of(high));
    let mut curve = Curve {
        quantity,
        variable,
        center: 0.5 * (a + b),
        scale: 0.5 * (a - b).abs(),
        coefficients_m: [0.0; 5],
        domain: [low, high],
    };
    if !(curve.scale.is_finite() && curve.scale > 0.0) {
        return None;
    }
    curve.coefficients_m = least_squares(points.iter(), &curve)?;
    Some(curve)
}

/// Normal equations over u ∈ [−1, 1], where five powers are still well apart (condition about 10³).
fn least_squares<'a>(
    points: impl Iterator<Item = &'a BenchPoint>,
    basis: &Curve,
) -> Option<[f64; 5]> {
    let mut normal = SMatrix::<f64, 5, 5>::zeros();
    let mut right = SVector::<f64, 5>::zeros();
    for p in points {
        let u = (basis.variable.of(p.reading) - basis.center) / basis.scale;
        let row = SVector::<f64, 5>::from_fn(|k, _| u.powi(k as i32));
        normal += row * row.transpose();
        right += row * p.length_m;
    }
    let c = normal.cholesky()?.solve(&right);
    c.iter().all(|x| x.is_finite()).then(|| c.into())
}

fn held_out(
    points: &[BenchPoint],
    curve: &Curve,
    stop: &impl Fn(&BenchPoint) -> usize,
    stops: usize,
) -> Option<f64> {
    let (mut sum, mut n) = (0.0, 0usize);
    for fold in 0..FOLDS {
        let out = |p: &BenchPoint| {
            let s = stop(p);
            s % FOLDS == fold && s != 0 && s != stops - 1
        };
        let mut part = curve.clone();
        part.coefficients_m = least_squares(points.iter().filter(|p| !out(p)), curve)?;
        for p in points.iter().filter(|p| out(p)) {
            sum += (part.extended_m(p.reading) - p.length_m).powi(2);
            n += 1;
        }
    }
    (n > 0).then(|| (sum / n as f64).sqrt())
}

fn quality(
    points: &[BenchPoint],
    curve: &Curve,
    held_out_rmse_m: f64,
    stop: &impl Fn(&BenchPoint) -> usize,
    stops: usize,
) -> FitQuality {
    // Mean residual per stop on the way up and on the way down.
    let mut sums = vec![[(0.0, 0usize); 2]; stops];
    let (mut squares, mut worst_m) = (0.0, 0.0_f64);
    for p in points {
        let residual_m = curve.extended_m(p.reading) - p.length_m;
        squares += residual_m.powi(2);
        worst_m = worst_m.max(residual_m.abs());
        let way = match p.direction {
            Direction::Up => 0,
            Direction::Down => 1,
        };
        let cell = &mut sums[stop(p)][way];
        cell.0 += residual_m;
        cell.1 += 1;
    }
    let hysteresis_m = sums
        .iter()
        .filter(|ways| ways.iter().all(|w| w.1 > 0))
        .map(|[up, down]| (up.0 / up.1 as f64 - down.0 / down.1 as f64).abs())
        .reduce(f64::max);
    FitQuality {
        rmse_m: (squares / points.len() as f64).sqrt(),
        held_out_rmse_m,
        worst_m,
        hysteresis_m,
        points: points.len(),
    }
}

/// The verdict on every spring of a log, in order of their numbers. Springs are 1-based.
pub type SpringVerdicts = Vec<(usize, Result<FitQuality, FitError>)>;

/// Fits every spring of a log. The calibration holds those that passed; the verdicts name all. `needed_m` is as in [`fit`].
pub fn calibrate(
    log: &BenchLog,
    name: &str,
    date: &str,
    needed_m: [f64; 2],
) -> (Calibration, SpringVerdicts) {
    let mut springs = Vec::new();
    let mut verdicts = Vec::new();
    for (spring, points) in &log.springs {
        let fitted = fit(points, log.quantity, needed_m);
        verdicts.push((*spring, fitted.as_ref().map(|f| f.1).map_err(Clone::clone)));
        if let Ok((curve, quality)) = fitted {
            let channel = log.channels[*spring - 1];
            springs.push(SpringCalibration {
                spring: *spring,
                capacitance_f: channel.capacitance_f,
                compensation_h: channel.compensation_h,
                curve,
                ends_off_m: Default::default(),
                ends_sd_m: None,
                quality,
            });
        }
    }
    let calibration = Calibration {
        name: name.into(),
        date: date.into(),
        bench_sha256: log.sha256.clone(),
        rig: None,
        springs,
        imus: Vec::new(),
        base_tilt_rad: [0.0; 2],
    };
    (calibration, verdicts)
}

#[cfg(test)]
mod tests;
