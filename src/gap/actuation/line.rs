//! From command to gauge: a log of pressures, its grid and the healthy regulator.
//!
//! Healthy chamber: v follows u(t − T) no faster than the pump moves air, τ dx/dt = v − x, p_gauge = g x + o, with small T, τ,
//! o and g near 1.

use crate::gap::GapError;
use crate::gap::session::{SECONDS_MIN, Sampled, Session, bridge, holes, within};
use crate::robot::RobotSpec;
use crate::signal::CHAMBERS;
use crate::sim::effects::{Active, behind_gauges, gauges, limited};

/// Unit of the pressures of a log; findings are reported in the same unit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PressureUnit {
    /// Its name.
    pub name: &'static str,
    /// One of it, Pa.
    pub pa: f64,
}

impl Default for PressureUnit {
    fn default() -> Self {
        Self {
            name: "kPa",
            pa: 1e3,
        }
    }
}

/// Commanded and measured pressures of a session, gauge, Pa; NaN marks a gap. Any of the six
/// chambers may be missing throughout.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PressureLog {
    /// Its name.
    pub name: String,
    /// Hash of its data, hexadecimal; empty if it came from no file.
    pub hash: String,
    /// Rising times, s.
    pub t_s: Vec<f64>,
    /// Commanded gauge pressures of chambers 1 to 6, Pa.
    pub commanded_pa: Vec<[f64; CHAMBERS]>,
    /// Measured gauge pressures of chambers 1 to 6, Pa.
    pub measured_pa: Vec<[f64; CHAMBERS]>,
    /// What they were given in.
    pub unit: PressureUnit,
}

impl PressureLog {
    /// Every `step`-th sample.
    pub fn thinned(&self, step: usize) -> Self {
        let kept = |all: &[[f64; CHAMBERS]]| all.iter().step_by(step).copied().collect();
        Self {
            t_s: self.t_s.iter().step_by(step).copied().collect(),
            commanded_pa: kept(&self.commanded_pa),
            measured_pa: kept(&self.measured_pa),
            ..self.clone()
        }
    }

    /// The pressures of a session; `None` when no commands were logged.
    pub fn of(session: &Session) -> Option<Self> {
        Some(Self {
            name: session.name.clone(),
            hash: session.hash.clone(),
            t_s: session.t_s.clone(),
            commanded_pa: session.commanded_pa.clone()?,
            measured_pa: session.chamber_pa.clone(),
            unit: PressureUnit::default(),
        })
    }
}

/// Rate of the grid, Hz: regulators settle in tenths of a second.
pub const LINE_HZ: f64 = 20.0;
/// Largest share of missing samples in a chamber that is used.
const GAPS_MAX: f64 = 0.5;
/// Commands that move less than this excite nothing, Pa.
const MOVES_MIN_PA: f64 = 1e3;
/// A gauge further than this from the first command shows where the chamber started, Pa.
const START_OFF_PA: f64 = 1e3;

/// Residual of one bin: measured less predicted, Pa; zero for chambers that are missing and within holes.
pub type LineRow = [f64; CHAMBERS];

/// Pressures averaged into bins of 1/[`LINE_HZ`]. Measured and predicted ones go through the same
/// average, so uneven sampling biases neither.
#[derive(Clone, Debug)]
pub struct PressureGrid {
    /// Where it is from; commands without gaps.
    pub log: PressureLog,
    /// Which chambers hold enough data.
    pub present: [bool; CHAMBERS],
    /// Middle of each bin, s.
    pub t_s: Vec<f64>,
    /// Mean measured gauge pressure per chamber, Pa.
    pub measured_pa: Vec<[f64; CHAMBERS]>,
    /// Mean commanded gauge pressure per chamber, Pa.
    pub commanded_pa: Vec<[f64; CHAMBERS]>,
    /// Bin of each sample.
    bin: Vec<usize>,
    /// Where the gauges stood at first.
    first_pa: [f64; CHAMBERS],
    /// Spans that are left out because pressures are missing, from and to, s.
    pub holes_s: Vec<[f64; 2]>,
}

impl Sampled for PressureGrid {
    fn times_s(&self) -> &[f64] {
        &self.log.t_s
    }

    fn every(&self, step: usize) -> Result<Self, GapError> {
        Self::new(self.log.thinned(step))
    }
}

impl PressureGrid {
    /// Averages a log into bins.
    ///
    /// # Errors
    /// [`GapError::TooShort`]; [`GapError::NoCommand`] when no chamber has commands and
    /// measurements for half of the time.
    pub fn new(mut log: PressureLog) -> Result<Self, GapError> {
        let n = log.t_s.len();
        let seconds = match (log.t_s.first(), log.t_s.last()) {
            (Some(a), Some(b)) => b - a,
            _ => 0.0,
        };
        if seconds.is_nan() || seconds < SECONDS_MIN || n < 100 {
            return Err(GapError::TooShort {
                session: log.name,
                seconds,
            });
        }
        let share = |series: &[[f64; CHAMBERS]], i: usize| {
            let missing = series.iter().filter(|row| !row[i].is_finite()).count();
            missing as f64 / n as f64 <= GAPS_MAX
        };
        let present: [bool; CHAMBERS] =
            std::array::from_fn(|i| share(&log.commanded_pa, i) && share(&log.measured_pa, i));
        if !present.contains(&true) {
            return Err(GapError::NoCommand { session: log.name });
        }
        for i in 0..CHAMBERS {
            // A command holds until the next one.
            let mut last = log
                .commanded_pa
                .iter()
                .map(|row| row[i])
                .find(|u| u.is_finite() && present[i])
                .unwrap_or(0.0);
            for row in &mut log.commanded_pa {
                if row[i].is_finite() && present[i] {
                    last = row[i];
                }
                row[i] = last;
            }
        }
        let start_s = log.t_s[0];
        let bins = (seconds * LINE_HZ).floor().max(1.0) as usize;
        let bin = log
            .t_s
            .iter()
            .map(|t| (((t - start_s) * LINE_HZ + 1e-6) as usize).min(bins - 1))
            .collect();
        let first_pa = std::array::from_fn(|i| {
            let mut known = log.measured_pa.iter().map(|row| row[i]);
            known.find(|p| p.is_finite()).unwrap_or(0.0)
        });
        let known = |k: usize, i: usize| log.measured_pa[k][i].is_finite();
        let in_use: Vec<usize> = (0..CHAMBERS).filter(|i| present[*i]).collect();
        let mut grid = Self {
            holes_s: holes(&log.t_s, known, &in_use),
            present,
            t_s: (0..bins)
                .map(|k| start_s + (k as f64 + 0.5) / LINE_HZ)
                .collect(),
            measured_pa: Vec::new(),
            commanded_pa: Vec::new(),
            bin,
            first_pa,
            log,
        };
        grid.measured_pa = grid.binned(&grid.log.measured_pa);
        grid.commanded_pa = grid.binned(&grid.log.commanded_pa);
        Ok(grid)
    }

    /// Number of bins.
    pub fn len(&self) -> usize {
        self.t_s.len()
    }

    /// Whether there is no bin (never, for a grid that was made).
    pub fn is_empty(&self) -> bool {
        self.t_s.is_empty()
    }

    /// Chambers in use.
    pub fn chambers(&self) -> Vec<usize> {
        (0..CHAMBERS).filter(|i| self.present[*i]).collect()
    }

    /// Whether any command moves enough to show anything.
    pub fn moves(&self) -> bool {
        self.range_pa().iter().any(|r| *r > MOVES_MIN_PA)
    }

    /// How far each chamber is commanded, Pa.
    pub fn range_pa(&self) -> [f64; CHAMBERS] {
        std::array::from_fn(|i| {
            let all = || self.log.commanded_pa.iter().map(|row| row[i]);
            all().fold(f64::MIN, f64::max) - all().fold(f64::MAX, f64::min)
        })
    }

    /// Bin means of a series at the log's own times, over the samples that were measured; bins
    /// without any are bridged along straight lines.
    fn binned(&self, series: &[[f64; CHAMBERS]]) -> Vec<[f64; CHAMBERS]> {
        let bins = self.t_s.len();
        let mut sum = vec![[0.0; CHAMBERS]; bins];
        let mut count = vec![[0u32; CHAMBERS]; bins];
        for ((row, measured), &b) in series.iter().zip(&self.log.measured_pa).zip(&self.bin) {
            for i in 0..CHAMBERS {
                if self.present[i] && measured[i].is_finite() {
                    sum[b][i] += row[i];
                    count[b][i] += 1;
                }
            }
        }
        for (s, n) in sum.iter_mut().zip(&count) {
            for i in 0..CHAMBERS {
                s[i] /= f64::from(n[i].max(1));
            }
        }
        for i in self.chambers() {
            let known: Vec<usize> = (0..bins).filter(|k| count[*k][i] > 0).collect();
            if known.len() < bins {
                let values: Vec<f64> = sum.iter().map(|s| s[i]).collect();
                bridge(&self.t_s, &known, |k| values[k], |k, v| sum[k][i] = v);
            }
        }
        sum
    }
}

/// A healthy chamber's regulator and gauge: dead time (s), lag (s), gain and offset (Pa) of the gauge, times to fill and to
/// empty by 10 kPa (s).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Regulator(pub [f64; KNOBS]);

/// Numbers of a regulator: dead time (s), lag (s), gain, offset (Pa), and how long the pump takes to fill and to empty by
/// [`PER_PA`] (s).
pub const KNOBS: usize = 6;
/// Dead time, s.
pub const DELAY: usize = 0;
/// Time constant, s.
pub const LAG: usize = 1;
/// Gain of the gauge.
pub const GAIN: usize = 2;
/// Offset of the gauge, Pa.
pub const OFFSET: usize = 3;
/// Time to fill by [`PER_PA`], s; 0 where nothing limits the flow.
pub const FILL: usize = 4;
/// Time to empty by [`PER_PA`], s.
pub const EMPTY: usize = 5;
/// Change of pressure that [`FILL`] and [`EMPTY`] are given for, Pa.
pub const PER_PA: f64 = 10e3;

impl Default for Regulator {
    /// Delivers what is commanded, at once.
    fn default() -> Self {
        Self([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
    }
}

impl Regulator {
    /// How fast the pump fills and empties at most, Pa/s; `None` where nothing limits the flow.
    fn pump_pa_s(&self) -> Option<[f64; 2]> {
        let rate = |s: f64| if s > 0.0 { PER_PA / s } else { f64::INFINITY };
        let rates = [FILL, EMPTY].map(|k| rate(self.0[k]));
        rates.iter().any(|r| r.is_finite()).then_some(rates)
    }
}

/// Where the table's `pressure-lag` sits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Lag {
    /// Between gauge and chamber, as in the table: a pressure log cannot see it.
    BehindGauge,
    /// Between command and gauge: what it means where there is nothing behind the gauges.
    BeforeGauge,
}

/// What the gauges should read in every bin, in the order of the chambers, Pa.
pub fn gauge_pressures(
    robot: &RobotSpec,
    grid: &PressureGrid,
    regulators: &[Regulator; CHAMBERS],
    effects: &[Active],
    lag: Lag,
) -> Vec<[f64; CHAMBERS]> {
    // What came before the log: the chambers stood where the gauges indicate.
    const LEAD: usize = 2;
    let (t0_s, first) = (grid.log.t_s[0], grid.log.commanded_pa[0]);
    let rest: [f64; CHAMBERS] = std::array::from_fn(|i| {
        let [_, _, gain, offset, ..] = regulators[i].0;
        let there = (grid.first_pa[i] - offset) / gain;
        if grid.present[i] && (there - first[i]).abs() > START_OFF_PA {
            there
        } else {
            first[i]
        }
    });
    let mut t_s = vec![t0_s - 10.0, t0_s - 1e-3];
    t_s.extend(&grid.log.t_s);
    let mut u = vec![rest; LEAD];
    u.extend(&grid.log.commanded_pa);
    let before = |a: &&Active| lag == Lag::BeforeGauge && a.effect.is_behind_gauge();
    let others: Vec<Active> = effects.iter().filter(|a| !before(a)).cloned().collect();
    let line = gauges(robot, &t_s, &u, &others, regulators.map(|r| r.pump_pa_s()));
    let mut out = line.gauge_pa;
    let behind: Vec<Active> = effects.iter().filter(before).cloned().collect();
    if !behind.is_empty() {
        out = behind_gauges(robot, &t_s, &out, &behind);
    }
    for i in grid.chambers() {
        let mut x: Vec<f64> = out.iter().map(|row| row[i]).collect();
        let [delay_s, lag_s, gain, offset, ..] = regulators[i].0;
        x = late(&t_s, &x, delay_s);
        if let Some(pump_pa_s) = line.pump_pa_s[i] {
            x = limited(&t_s, &x, pump_pa_s);
        }
        x = followed(&t_s, &x, lag_s);
        for (row, x) in out.iter_mut().zip(x) {
            row[i] = gain * x + offset;
        }
    }
    grid.binned(&out[LEAD..])
}

/// Measured less predicted, in the order of the chambers, Pa.
pub fn line_rows(grid: &PressureGrid, predicted_pa: &[[f64; CHAMBERS]]) -> Vec<LineRow> {
    let rows = grid.measured_pa.iter().zip(predicted_pa);
    rows.zip(&grid.t_s)
        .map(|((m, p), t_s)| {
            let seen = !within(&grid.holes_s, *t_s);
            std::array::from_fn(|i| {
                if seen && grid.present[i] {
                    m[i] - p[i]
                } else {
                    0.0
                }
            })
        })
        .collect()
}

/// First-order lag of a series that runs straight between its instants:
/// y_k = x_k − m τ + (y_{k−1} − x_{k−1} + m τ) e^{−h/τ}, m = (x_k − x_{k−1})/h.
fn followed(t_s: &[f64], x: &[f64], tau_s: f64) -> Vec<f64> {
    if tau_s < 1e-6 {
        return x.to_vec();
    }
    let mut y = x.to_vec();
    for k in 1..x.len() {
        let h_s = t_s[k] - t_s[k - 1];
        let behind = (x[k] - x[k - 1]) / h_s * tau_s;
        y[k] = x[k] - behind + (y[k - 1] - x[k - 1] + behind) * (-h_s / tau_s).exp();
    }
    y
}

/// The series a little later; held at its start.
fn late(t_s: &[f64], x: &[f64], delay_s: f64) -> Vec<f64> {
    if delay_s <= 0.0 {
        return x.to_vec();
    }
    let mut j = 0;
    t_s.iter()
        .map(|t| {
            let at = t - delay_s;
            while j + 1 < t_s.len() && t_s[j + 1] <= at {
                j += 1;
            }
            if at <= t_s[0] || j + 1 == t_s.len() {
                return x[j];
            }
            x[j] + (at - t_s[j]) / (t_s[j + 1] - t_s[j]) * (x[j + 1] - x[j])
        })
        .collect()
}

/// Root mean square over the chambers in use and the bins that `pick` chooses, Pa.
pub fn line_rmse_pa(grid: &PressureGrid, rows: &[LineRow], pick: impl Fn(usize) -> bool) -> f64 {
    let (mut sum, mut n) = (0.0, 0usize);
    for (_, row) in rows.iter().enumerate().filter(|(k, _)| pick(*k)) {
        for i in grid.chambers() {
            sum += row[i] * row[i];
            n += 1;
        }
    }
    (sum / n.max(1) as f64).sqrt()
}
