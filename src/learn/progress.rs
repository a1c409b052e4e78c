//! How far a training has got, and why it gave nothing.

use serde::{Deserialize, Serialize};

use super::cascade::ShapeError;
use super::recipe::RecipeError;

/// Fewest samples a network is trained on.
pub(super) const SAMPLES_MIN: usize = 50;

/// Which network is being trained.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Stage {
    /// Sensors to pose.
    SensorMap,
    /// The correction of the translation.
    TranslationCorrection,
    /// The correction of the rotation.
    RotationCorrection,
    /// Pressures to sensors.
    Plant,
}

/// Progress of a training, reported once per epoch.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Progress {
    /// The network.
    pub stage: Stage,
    /// Member of the ensemble, 0-based.
    pub member: usize,
    /// Epochs done.
    pub epoch: usize,
    /// Most epochs there will be.
    pub epochs: usize,
    /// Mean squared error over the epoch, scaled outputs.
    pub train_loss: f64,
    /// Mean squared error on the validation part, scaled outputs.
    pub validation_loss: f64,
}

/// Why training gave nothing.
#[derive(Debug, thiserror::Error)]
pub enum TrainError {
    /// Too little data.
    #[error("{what} has {got} samples, but at least {SAMPLES_MIN} are needed; generate more")]
    TooFew {
        /// Which data.
        what: &'static str,
        /// How many there are.
        got: usize,
    },
    /// Blocks too long for the data.
    #[error(
        "{what} has {samples} samples: in blocks of {block} they do not fill training, validation and test; \
         give more samples, or make {key} smaller in the recipe"
    )]
    Split {
        /// Which data.
        what: &'static str,
        /// How many there are.
        samples: usize,
        /// Consecutive samples that stay together.
        block: usize,
        /// Key of the recipe that decides it.
        key: &'static str,
    },
    /// A sample is not a number.
    #[error("sample {index} of {what} holds a value that is not finite; generate the data again")]
    NotFinite {
        /// Which data.
        what: &'static str,
        /// 0-based.
        index: usize,
    },
    /// The recipe makes no sense.
    #[error(transparent)]
    Recipe(#[from] RecipeError),
    /// The error became infinite.
    #[error("training of the {stage:?} network diverged in epoch {epoch}; lower its learning_rate")]
    Diverged {
        /// The network.
        stage: Stage,
        /// 1-based.
        epoch: usize,
    },
    /// Cancelled by the caller.
    #[error("training was cancelled")]
    Cancelled,
    /// Networks do not fit together.
    #[error(transparent)]
    Shape(#[from] ShapeError),
}
