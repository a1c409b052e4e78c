//! How much is left over, against a healthy rig: in what comes anew and in what lasts.

use nalgebra::{DMatrix, DVector};

use super::noise::{LOOKS, start};
use super::problem::Problem;

/// Mean squares of what is left over.
pub struct Left {
    /// Innovations of each combination of channels, nuisance projected out.
    pub quick: Vec<f64>,
    /// Readings of each channel in units of their healthy size, nuisance projected out.
    pub lasting: Vec<f64>,
    /// Sum over the channels of what their readings have more than healthy ones, nuisance as
    /// commissioned: what may be nuisance counts as gap once an effect explains it.
    excess: f64,
    /// How far the rig's parameters would have to have moved, [`Problem::change`].
    pub change: f64,
}

/// Quick excess over the floor, relative to it, that is not chance.
const QUICK: f64 = 0.5;
/// Mean square of a channel's readings, in units of a healthy session's, that is not chance: the next
/// healthy session reaches 2 to 3 in some channel.
const LASTING: f64 = 4.0;

/// Change of the rig's parameters, over what is expected, that is not chance: a model that is a little
/// wrong in its form has its parameters change with the motion, to 6 for a healthy arm of rigid discs.
const CHANGE: f64 = 8.0;

impl Left {
    /// Of stacked evidence (bin by bin: innovations, then readings).
    pub fn of(problem: &Problem, r: &DVector<f64>) -> Self {
        let change = problem.change(r);
        let r = DMatrix::from_column_slice(r.len(), 1, r.as_slice());
        let clean = problem.cleaned(&r);
        let per_bin = problem.per_bin();
        let judged = (r.nrows() / per_bin).saturating_sub(start()).max(1) as f64;
        let sum = |x: &DMatrix<f64>, i: usize| -> f64 {
            let rows = (i..x.nrows()).step_by(per_bin);
            rows.map(|k| x[(k, 0)].powi(2)).sum()
        };
        let combinations = per_bin / 2;
        Self {
            quick: (0..combinations).map(|i| sum(&clean, i) / judged).collect(),
            lasting: (combinations..per_bin)
                .map(|i| sum(&clean, i) / LOOKS)
                .collect(),
            excess: (combinations..per_bin)
                .map(|i| (sum(&r, i) / LOOKS - 1.0).max(0.0))
                .sum(),
            change,
        }
    }

    /// Mean over all combinations.
    pub fn mean_quick(&self) -> f64 {
        self.quick.iter().sum::<f64>() / self.quick.len() as f64
    }

    /// Whether there is more than chance leaves in a healthy rig. `floor` is the mean square of a
    /// healthy innovation.
    pub fn exceeds(&self, floor: f64) -> bool {
        self.quick_exceeds(floor) || self.lasting_exceeds()
    }

    fn quick_exceeds(&self, floor: f64) -> bool {
        self.mean_quick() - floor > QUICK * floor
    }

    fn lasting_exceeds(&self) -> bool {
        self.lasting.iter().any(|x| *x > LASTING) || self.change > CHANGE
    }

    /// Share of the excess that is gone in `after`: the smallest one of innovations, readings and the
    /// rig's change, as far as they exceed a healthy rig's; readings where none does.
    pub fn closed(&self, after: &Self, floor: f64) -> f64 {
        let share = |before: f64, after: f64, floor: f64| (before - after) / (before - floor);
        let lasting = 1.0 - after.excess / self.excess.max(1e-9);
        let measures = [
            self.quick_exceeds(floor)
                .then(|| share(self.mean_quick(), after.mean_quick(), floor)),
            self.lasting_exceeds().then_some(lasting),
            (self.change > CHANGE).then(|| share(self.change, after.change, 1.0)),
        ];
        measures
            .into_iter()
            .flatten()
            .reduce(f64::min)
            .unwrap_or(lasting)
    }

    /// Whether `after` brings some combination, or with `readings` some channel or the rig's change, by
    /// this share closer to its floor.
    pub fn brings(&self, after: &Self, floor: f64, share: f64, readings: bool) -> bool {
        let any = |before: &[f64], after: &[f64], floor: f64| {
            before
                .iter()
                .zip(after)
                .any(|(b, a)| *b > 2.0 * floor && (b - a) / (b - floor) >= share)
        };
        let [before, then] = [self, after].map(|l| [l.lasting.as_slice(), &[l.change]].concat());
        any(&self.quick, &after.quick, floor) || (readings && any(&before, &then, 1.0))
    }
}
