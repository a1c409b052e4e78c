//! How the networks are trained: a TOML file with mm and degrees in, [`Recipe`] in SI out.
//!
//! The defaults follow the paper's section III (two hidden layers of 120, one of 45, Adam at 0.01,
//! batches of 128, split 0.7 / 0.2 / 0.1) with noise injection and a decaying learning rate added.

use serde::{Deserialize, Serialize};

use crate::signal::toml_error;

/// Most networks in an ensemble.
pub const MEMBERS_MAX: usize = 5;
/// Widest layer that is accepted, in recipes and in model files.
pub const WIDTH_MAX: usize = 1024;
/// Most hidden layers that are accepted there.
pub const HIDDEN_LAYERS_MAX: usize = 6;

/// Why a recipe was refused.
#[derive(Debug, thiserror::Error)]
pub enum RecipeError {
    /// Not valid TOML, or a key is unknown or of the wrong type (the message has line and column).
    #[error("the training recipe is not valid: {0}")]
    Syntax(String),
    /// A value makes no sense.
    #[error("the training recipe has {key} = {value}, but it must be {must}")]
    Value {
        /// The key, dotted.
        key: String,
        /// Value in the file.
        value: String,
        /// What it must be.
        must: &'static str,
    },
}

/// Which sensor signals a network may use; the others are switched off.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Channels {
    /// Springs and IMUs.
    #[default]
    Fusion,
    /// The twelve spring lengths only.
    Springs,
    /// The four orientations only.
    Imus,
}

/// What the sim-to-real networks see.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum CorrectionInput {
    /// The predicted pose, as the paper does.
    #[default]
    Pose,
    /// The predicted pose and the 24 signals: can also correct what depends on single sensors.
    /// For a gap that is a function of the pose it measured no better on 729 samples.
    PoseAndSensors,
}

/// Size and schedule of one training run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Schedule {
    /// Width of each hidden layer.
    pub hidden: Vec<usize>,
    /// Most passes over the training part.
    pub epochs: usize,
    /// Passes without a better validation error after which training stops.
    pub patience: usize,
    /// Samples per step.
    pub batch: usize,
    /// Adam's step at the start.
    pub learning_rate: f64,
    /// Adam's step at the end; cosine in between.
    pub learning_rate_end: f64,
    /// Decoupled weight decay, as a fraction per unit of learning rate and step.
    pub weight_decay: f64,
}

impl Schedule {
    fn new(hidden: &[usize], epochs: usize, patience: usize) -> Self {
        Self {
            hidden: hidden.to_vec(),
            epochs,
            patience,
            batch: 128,
            learning_rate: 0.01,
            learning_rate_end: 1e-5,
            weight_decay: 0.0,
        }
    }
}

/// How samples are dealt into training, validation and test.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SplitRule {
    /// Fraction for training.
    pub train: f64,
    /// Fraction for validation (early stopping and calibration).
    pub validation: f64,
    /// Consecutive samples that stay together; 1 for independent draws.
    #[serde(default = "block")]
    pub block: usize,
    /// Least time that stays together in a trajectory, whose neighbouring rows are nearly the same sample, s.
    #[serde(default = "block_s")]
    pub block_s: f64,
}

fn block() -> usize {
    1
}

fn block_s() -> f64 {
    10.0
}

impl SplitRule {
    /// Consecutive samples that stay together, where rows of a trajectory are `row_s` apart (s); `None` for independent
    /// draws.
    pub fn rows(&self, row_s: Option<f64>) -> usize {
        let in_time = row_s.map_or(1, |row_s| (self.block_s / row_s).round() as usize);
        self.block.max(in_time).max(1)
    }
}

/// Standard deviation of the noise added to the signals in every batch.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Noise {
    /// Spring lengths, m (`spring_mm` in the file).
    #[serde(rename = "spring_mm", with = "milli")]
    pub spring_m: f64,
    /// Orientation of each IMU about each of its axes, rad (`imu_deg` in the file).
    #[serde(rename = "imu_deg", with = "degrees")]
    pub imu_rad: f64,
    /// Heading of each IMU, which gravity does not correct, in addition; rad
    /// (`imu_heading_deg` in the file).
    #[serde(rename = "imu_heading_deg", with = "degrees")]
    pub imu_heading_rad: f64,
}

/// Standard uncertainty of an error that is the same in every sample, so that no difference between samples shows it. It is
/// part of every stated covariance.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Systematic {
    /// Position, per axis, m (`position_mm` in the file).
    #[serde(rename = "position_mm", with = "milli")]
    pub position_m: f64,
    /// Rotation, per axis, rad (`rotation_deg` in the file).
    #[serde(rename = "rotation_deg", with = "degrees")]
    pub rotation_rad: f64,
}

/// Everything that decides what comes out of training, beside the data.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Recipe {
    /// Seed of weights, order, noise and split.
    pub seed: u64,
    /// Number of sensor-map networks whose mean is used, 1 to 5.
    pub members: usize,
    /// Signals the sensor map may use.
    pub channels: Channels,
    /// What the sim-to-real networks see.
    pub correction_input: CorrectionInput,
    /// Most samples kept for the initial guess.
    pub guess_samples: usize,
    /// How samples are dealt.
    pub split: SplitRule,
    /// Noise on the signals while the sensor map is trained and scored.
    pub noise: Noise,
    /// How far an arm is off the simulated one as a whole: stated as long as there are no samples of the arm itself.
    pub unit: Systematic,
    /// How far measured poses are off as a whole (where the markers sit on the pad, the registration of motion
    /// capture): stated once there are samples of the arm itself.
    pub reference: Systematic,
    /// The sensor map, 24 → 6.
    pub smap: Schedule,
    /// The two sim-to-real networks, 6 → 3 each.
    pub s2r: Schedule,
    /// The plant, 7 → 24.
    pub plant: Schedule,
}

impl Default for Recipe {
    fn default() -> Self {
        Self {
            seed: 1,
            members: 1,
            channels: Channels::Fusion,
            correction_input: CorrectionInput::Pose,
            guess_samples: 4000,
            split: SplitRule {
                train: 0.7,
                validation: 0.2,
                block: block(),
                block_s: block_s(),
            },
            noise: Noise {
                spring_m: 0.15e-3,
                imu_rad: 0.3_f64.to_radians(),
                imu_heading_rad: 0.0,
            },
            unit: Systematic::default(),
            reference: Systematic::default(),
            smap: Schedule::new(&[120, 120], 400, 120),
            s2r: Schedule {
                weight_decay: 0.01,
                ..Schedule::new(&[45], 600, 150)
            },
            plant: Schedule::new(&[96, 96], 400, 120),
        }
    }
}

impl Recipe {
    /// Reads a recipe file; keys that are left out keep their defaults.
    ///
    /// # Errors
    /// [`RecipeError`] with line and column for syntax, with key and bound for values.
    pub fn from_toml(text: &str) -> Result<Self, RecipeError> {
        let recipe: Self =
            toml::from_str(text).map_err(|e| RecipeError::Syntax(toml_error(text, &e)))?;
        recipe.check()?;
        Ok(recipe)
    }

    /// The recipe as a file.
    pub fn to_toml(&self) -> String {
        // Plain numbers and tables; nothing in a recipe can fail to serialise.
        toml::to_string(self).unwrap_or_default()
    }

    /// Whether every value makes sense.
    ///
    /// # Errors
    /// [`RecipeError::Value`] for the first one that does not.
    pub fn check(&self) -> Result<(), RecipeError> {
        require(
            self.seed <= i64::MAX as u64,
            "seed",
            self.seed,
            "at most 9223372036854775807, the largest whole number of TOML",
        )?;
        let test = 1.0 - self.split.train - self.split.validation;
        require(
            (1..=MEMBERS_MAX).contains(&self.members),
            "members",
            self.members,
            "1 to 5",
        )?;
        require(
            self.split.train > 0.0 && self.split.validation > 0.0 && test > 1e-6,
            "split.train + split.validation",
            self.split.train + self.split.validation,
            "positive fractions that leave something for the test",
        )?;
        require(
            self.split.block >= 1,
            "split.block",
            self.split.block,
            "1 or more",
        )?;
        require(
            (1.0..=3600.0).contains(&self.split.block_s),
            "split.block_s",
            self.split.block_s,
            "1 to 3600 s: neighbouring rows of a trajectory are nearly the same sample and must not be held out singly",
        )?;
        let noise = [
            ("noise.spring_mm", self.noise.spring_m * 1e3, 20.0),
            ("noise.imu_deg", self.noise.imu_rad.to_degrees(), 20.0),
            (
                "noise.imu_heading_deg",
                self.noise.imu_heading_rad.to_degrees(),
                90.0,
            ),
        ];
        for (key, value, top) in noise {
            require(
                (0.0..=top).contains(&value),
                key,
                value,
                "0 or more, and no larger than the signal itself",
            )?;
        }
        for (name, s) in [("unit", &self.unit), ("reference", &self.reference)] {
            let values = [
                ("position_mm", s.position_m * 1e3),
                ("rotation_deg", s.rotation_rad.to_degrees()),
            ];
            for (key, value) in values {
                require(
                    (0.0..=20.0).contains(&value),
                    &format!("{name}.{key}"),
                    value,
                    "0 to 20",
                )?;
            }
        }
        for (name, s) in [
            ("smap", &self.smap),
            ("s2r", &self.s2r),
            ("plant", &self.plant),
        ] {
            let hidden = !s.hidden.is_empty()
                && s.hidden.len() <= HIDDEN_LAYERS_MAX
                && s.hidden.iter().all(|w| (1..=WIDTH_MAX).contains(w));
            require(
                hidden,
                &format!("{name}.hidden"),
                format!("{:?}", s.hidden),
                "1 to 6 layers of 1 to 1024",
            )?;
            for (key, value) in [
                ("epochs", s.epochs),
                ("patience", s.patience),
                ("batch", s.batch),
            ] {
                require(
                    (1..=1_000_000).contains(&value),
                    &format!("{name}.{key}"),
                    value,
                    "1 to 1,000,000",
                )?;
            }
            require(
                s.learning_rate > 0.0
                    && s.learning_rate <= 1.0
                    && s.learning_rate_end >= 0.0
                    && s.learning_rate_end <= s.learning_rate,
                &format!("{name}.learning_rate, {name}.learning_rate_end"),
                format!("{}, {}", s.learning_rate, s.learning_rate_end),
                "falling, within 0 and 1",
            )?;
            require(
                (0.0..=1.0).contains(&s.weight_decay),
                &format!("{name}.weight_decay"),
                s.weight_decay,
                "0 to 1",
            )?;
        }
        Ok(())
    }
}

fn require(
    holds: bool,
    key: &str,
    value: impl ToString,
    must: &'static str,
) -> Result<(), RecipeError> {
    if holds {
        return Ok(());
    }
    Err(RecipeError::Value {
        key: key.to_owned(),
        value: value.to_string(),
        must,
    })
}

/// Metres in the program, mm in the file.
mod milli {
    use serde::{Deserialize, Deserializer, Serializer};

    pub fn serialize<S: Serializer>(metres: &f64, s: S) -> Result<S::Ok, S::Error> {
        s.serialize_f64(metres * 1e3)
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(d: D) -> Result<f64, D::Error> {
        Ok(f64::deserialize(d)? * 1e-3)
    }
}

/// Radians in the program, degrees in the file.
mod degrees {
    use serde::{Deserialize, Deserializer, Serializer};

    pub fn serialize<S: Serializer>(radians: &f64, s: S) -> Result<S::Ok, S::Error> {
        s.serialize_f64(radians.to_degrees())
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(d: D) -> Result<f64, D::Error> {
        Ok(f64::deserialize(d)?.to_radians())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_left_out_keep_their_defaults_and_units_convert() {
        let r = Recipe::from_toml(
            "members = 3\n[noise]\nspring_mm = 0.4\nimu_deg = 0.5\nimu_heading_deg = 0\n",
        )
        .expect("a valid recipe");
        assert_eq!(r.members, 3);
        assert!((r.noise.spring_m - 0.4e-3).abs() < 1e-12);
        assert!((r.noise.imu_rad - 0.5_f64.to_radians()).abs() < 1e-12);
        assert_eq!(r.smap, Recipe::default().smap);
        let again = Recipe::from_toml(&r.to_toml()).expect("our own file");
        assert!((again.noise.spring_m - r.noise.spring_m).abs() < 1e-15);
        assert_eq!(again.smap, r.smap);
    }

    #[test]
    fn the_recipes_that_ship_differ_in_what_a_trajectory_needs_only() {
        let shipped = include_str!("../../assets/networks/recipe.toml");
        let session = include_str!("../../assets/networks/session.toml");
        let shipped = Recipe::from_toml(shipped).expect("the shipped recipe");
        let session = Recipe::from_toml(session).expect("the recipe for sessions");
        let as_shipped = Recipe {
            split: shipped.split,
            s2r: shipped.s2r.clone(),
            unit: shipped.unit,
            reference: shipped.reference,
            ..session.clone()
        };
        assert_eq!(as_shipped, shipped);
        // A session shows what the unit has off the drawing, and motion capture is better than that.
        assert!(session.reference.position_m < shipped.unit.position_m);
        assert!(session.split.rows(Some(0.02)) == 1500);
        assert!(session.s2r.weight_decay > shipped.s2r.weight_decay);
    }

    #[test]
    fn refusals_name_key_or_line() {
        let check = |text: &str, wants: &str| {
            let e = Recipe::from_toml(text).expect_err(text).to_string();
            assert!(e.contains(wants), "{e}");
        };
        check("members = 0", "members = 0");
        check("members = 2\ncolour = 1", "colour");
        check("seed = ", "line 1");
        check(
            "[split]\ntrain = 0.9\nvalidation = 0.2\nblock = 1",
            "split.train",
        );
        check(
            "[split]\ntrain = 0.7\nvalidation = 0.2\nblock_s = 0.02",
            "split.block_s = 0.02",
        );
        check(
            "[noise]\nspring_mm = nan\nimu_deg = 0.5\nimu_heading_deg = 0",
            "noise.spring_mm",
        );
        check(
            "[reference]\nposition_mm = -1.0\nrotation_deg = 0.0",
            "reference.position_mm = -1",
        );
        let mut r = Recipe::default();
        r.smap.hidden = vec![120, 100_000];
        let e = r.check().expect_err("too wide").to_string();
        assert!(e.contains("smap.hidden"), "{e}");
    }
}
