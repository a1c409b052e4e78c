//! Networks, training and the estimator. Imports robot and signal alone: what a simulator or a measurement
//! contributes comes as a data set, and files come and go as bytes.
//!
//! Flow: [`train`] makes a [`Model`] from datasets by a [`Recipe`]; [`Cascade`] (sensors to pose)
//! and [`PlantNet`] (pressures to sensors) answer the control loop with exact Jacobians;
//! [`GuessSet`] finds where to start. Training runs in f32 on whole batches (`mlp`, `fit`),
//! the control loop in f64 on single samples (`kernel`).

mod calibrate;
mod cascade;
mod data;
mod files;
mod fit;
mod guess;
mod kernel;
mod lstm;
mod mlp;
mod plant;
mod progress;
mod recipe;
mod scores;
#[cfg(test)]
mod synthetic;
mod train;
mod windows;

pub use calibrate::Calibration;
pub use cascade::{Cascade, CascadeParts, Correction, SensorSpread, ShapeError, estimate};
pub use data::{data_hash, pose_vector};
pub use files::{Model, ModelError, Scores};
pub use guess::{GuessSample, GuessSet, SATURATED_RATIO};
pub use kernel::Kernel;
pub use mlp::{Mlp, Scaling};
pub use plant::{PlantBounds, PlantNet};
pub use progress::{Progress, Stage, TrainError};
pub use recipe::{
    Channels, CorrectionInput, Noise, Recipe, RecipeError, Schedule, SplitRule, Systematic,
};
pub use scores::{
    CorrectionReport, Coverage, DataOrigin, ErrorStats, Kept, PlantReport, PoseReport, PoseScores,
    RunningStats, SignalScores, pose_residual, quantile, to_pose,
};
pub use train::{Watch, adapt, train, train_plant, train_s2r, train_smap, with_guesses};
pub use windows::{WindowMap, WindowNet};

use nalgebra::{SMatrix, SVector};

use crate::signal::{CHAMBERS, Matrix6, SIGNALS};

/// A pose with its derivative, as the sensor map gives it.
#[derive(Clone, Debug, PartialEq)]
pub struct PoseEval {
    /// x, y, z in m, then yaw, pitch, roll in rad (R = Rz Ry Rx), base frame.
    pub pose: SVector<f64, 6>,
    /// Derivative of `pose` after the 24 signals (m and rad per m and rad), 6 × 24.
    pub jacobian: SMatrix<f64, 6, SIGNALS>,
    /// Covariance of `pose` (same order and units).
    pub covariance: Matrix6,
    /// Distance of the signals from the training data, standard deviations / √24.
    pub training_distance: f64,
}

impl PoseEval {
    /// Adds the covariance of signals with these extra standard deviations (m, then rad) to the pose's: J diag(σ²) Jᵀ.
    pub fn add_sigma(&mut self, sd: &[f64; SIGNALS]) {
        for (sd, column) in sd.iter().zip(self.jacobian.column_iter()) {
            if *sd > 0.0 {
                self.covariance.ger(sd * sd, &column, &column, 1.0);
            }
        }
    }
}

/// What the arm's sensors would read at given pressures, with the derivative.
#[derive(Clone, Debug, PartialEq)]
pub struct PlantEval {
    /// The 24 signals as in `SensorVec::to_vector`.
    pub sensors: SVector<f64, SIGNALS>,
    /// Derivative of `sensors` after the six gauge pressures (per Pa), 24 × 6.
    pub jacobian: SMatrix<f64, SIGNALS, CHAMBERS>,
}

/// f_smap: sensor signals to tip pose.
pub trait PoseMap: Send + Sync {
    /// Evaluates the map and its exact Jacobian at the 24 signals, in the order of `SensorVec::to_vector`.
    fn pose(&self, sensors: &SVector<f64, SIGNALS>) -> PoseEval;
}

/// Plant map: chamber pressures to sensor signals.
pub trait PlantMap: Send + Sync {
    /// Evaluates the map and its exact Jacobian at the gauge pressures of chambers 1 to 6.
    fn sensors(&self, chamber_pa: &[f64; CHAMBERS], payload_kg: f64) -> PlantEval;
}
