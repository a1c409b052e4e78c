//! Size of the residuals against those of a healthy rig: innovations and persistent biases.

use nalgebra::{DMatrix, DVector};

use super::config::CONFIG;
use super::noise::start;
use super::problem::Problem;
use super::replay::Row;

/// Mean squares of the residuals of a session.
pub struct Misfit {
    /// Innovations of each combination of channels, nuisance projected out.
    pub innovations: Vec<f64>,
    /// Persistent bias of each channel in use in units of its healthy size, nuisance projected out.
    pub bias: Vec<f64>,
    /// Mean square of each channel in units of its healthy size, nuisance as commissioned: a part that
    /// nuisance could absorb counts as gap once an effect explains it.
    size: Vec<f64>,
    /// Required change of the rig's parameters, [`Problem::change`].
    pub change: f64,
    /// What a healthy session's mean square bias is in a stretch as long as this session, at most, over that of the whole.
    short: Vec<f64>,
}

/// How much larger the mean square of each channel of a healthy session gets in a stretch of `bins` than over all of it, where
/// that is longer: in a short session the model's inadequacy does not average out over motions.
pub fn short_stretches(healthy: &[Row], channels: &[usize], bins: usize) -> Vec<f64> {
    let rows = &healthy[start().min(healthy.len())..];
    let mean = |rows: &[Row], c: usize| {
        rows.iter().map(|r| r[c] * r[c]).sum::<f64>() / rows.len().max(1) as f64
    };
    let stretch = bins.saturating_sub(start()).max(1);
    let largest = |c: usize| {
        let windows = rows.windows(stretch).step_by((stretch / 4).max(1));
        let most = windows.map(|w| mean(w, c)).fold(0.0, f64::max);
        (most / mean(rows, c)).max(1.0)
    };
    channels
        .iter()
        .map(|c| largest(*c))
        .map(|x| if x.is_finite() { x } else { 1.0 })
        .collect()
}

impl Misfit {
    /// Of stacked evidence (bin by bin: innovations, then readings).
    pub fn of(problem: &Problem, r: &DVector<f64>) -> Self {
        let change = problem.change(r);
        let r = DMatrix::from_column_slice(r.len(), 1, r.as_slice());
        let clean = problem.cleaned(&r);
        let per_bin = problem.per_bin();
        let judged = problem.judged() as f64;
        let sum = |x: &DMatrix<f64>, i: usize| -> f64 {
            let rows = (i..x.nrows()).step_by(per_bin);
            rows.map(|k| x[(k, 0)].powi(2)).sum()
        };
        let combinations = per_bin / 2;
        Self {
            innovations: (0..combinations).map(|i| sum(&clean, i) / judged).collect(),
            bias: (combinations..per_bin)
                .map(|i| sum(&clean, i) / CONFIG.looks)
                .collect(),
            size: (combinations..per_bin)
                .map(|i| sum(&r, i) / CONFIG.looks)
                .collect(),
            change,
            short: Vec::new(),
        }
    }

    /// In a session that is shorter than the healthy one, `short` as [`short_stretches`] gives it.
    pub fn in_short(mut self, short: Vec<f64>) -> Self {
        self.short = short;
        self
    }

    /// Sum over the channels of what exceeds a healthy session's.
    fn excess(&self) -> f64 {
        self.size.iter().map(|x| (x - 1.0).max(0.0)).sum()
    }

    /// Mean over all combinations.
    pub fn mean_innovation(&self) -> f64 {
        self.innovations.iter().sum::<f64>() / self.innovations.len() as f64
    }

    /// Whether the residuals significantly exceed a healthy rig's. `floor` is the mean square of a
    /// healthy innovation.
    pub fn exceeds(&self, floor: f64) -> bool {
        self.innovations_exceed(floor) || self.bias_exceeds()
    }

    fn innovations_exceed(&self, floor: f64) -> bool {
        self.mean_innovation() - floor > CONFIG.innovation_excess * floor
    }

    fn bias_exceeds(&self) -> bool {
        let usual = self.short.iter().chain(std::iter::repeat(&1.0));
        let mut biases = self.bias.iter().zip(usual);
        biases.any(|(x, usual)| *x > CONFIG.bias_max * usual) || self.change > CONFIG.change_max
    }

    /// Share of the excess that `after` removes: the smallest one of innovations, biases and the
    /// rig's change, as far as they exceed a healthy rig's; biases where none does.
    pub fn closed(&self, after: &Self, floor: f64) -> f64 {
        let share = |before: f64, after: f64, floor: f64| (before - after) / (before - floor);
        let bias = 1.0 - after.excess() / self.excess().max(1e-9);
        let measures = [
            self.innovations_exceed(floor)
                .then(|| share(self.mean_innovation(), after.mean_innovation(), floor)),
            self.bias_exceeds().then_some(bias),
            (self.change > CONFIG.change_max).then(|| share(self.change, after.change, 1.0)),
        ];
        measures
            .into_iter()
            .flatten()
            .reduce(f64::min)
            .unwrap_or(bias)
    }

    /// Whether `after` brings some combination, or with `biases` some channel (nuisance projected out or as commissioned) or
    /// the rig's change, by this share closer to its floor.
    pub fn brings(&self, after: &Self, floor: f64, share: f64, biases: bool) -> bool {
        let any = |before: &[f64], after: &[f64], floor: f64, least: f64| {
            before
                .iter()
                .zip(after)
                .any(|(b, a)| *b > least * floor && (b - a) / (b - floor) >= share)
        };
        let [before, then] = [self, after].map(|l| [l.bias.as_slice(), &[l.change]].concat());
        any(&self.innovations, &after.innovations, floor, 2.0)
            || (biases && any(&before, &then, 1.0, 2.0))
            || (biases && any(&self.size, &after.size, 1.0, CONFIG.far * CONFIG.far))
    }
}
