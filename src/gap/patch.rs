//! What was found, as a file: it turns the factory model into the commissioned one and adds the
//! missing effects. Patches stack in order and can be taken back.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::replay::{Knob, knobs, nominal};
use crate::robot::RobotSpec;
use crate::sim::effects::{Active, EffectError};

/// Version of the format that is written.
pub const VERSION: u32 = 1;

/// A patch of the model.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Patch {
    /// Format.
    pub version: u32,
    /// For people.
    pub name: String,
    /// Hash of the robot file it was made for.
    pub robot: String,
    /// The verdict behind it.
    #[serde(default)]
    pub verdict: String,
    /// Hashes of the data behind it, by role.
    #[serde(default)]
    pub data: BTreeMap<String, String>,
    /// Departures of this rig from the nominal one, SI, by knob.
    #[serde(default)]
    pub rig: BTreeMap<String, f64>,
    /// Errors on data that were not fitted, SI.
    #[serde(default)]
    pub floor: BTreeMap<String, f64>,
    /// Effects to add.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub effects: Vec<PatchEffect>,
}

/// An effect of a patch.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PatchEffect {
    /// Which effect.
    pub id: String,
    /// Chamber, spring, IMU or segment (1-based); all of them without it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub target: Option<usize>,
    /// Its parameters.
    pub params: BTreeMap<String, PatchValue>,
}

/// A parameter of a patch.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PatchValue {
    /// Value in `unit`.
    pub value: f64,
    /// SI unit.
    #[serde(default)]
    pub unit: String,
    /// 95 % interval.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ci95: Option<[f64; 2]>,
}

/// Why a patch is not accepted.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum PatchError {
    /// Not TOML of this form.
    #[error("the patch does not read: {0}")]
    Syntax(String),
    /// Another format.
    #[error("the patch has format {0}: this program reads format {VERSION}")]
    Version(u32),
    /// Another robot.
    #[error(
        "the patch was made for robot file {made_for}, but this robot file is {given}: \
         give the robot file it was made for with --robot"
    )]
    Robot {
        /// Start of the hash in the patch.
        made_for: String,
        /// Start of the hash of the robot in use.
        given: String,
    },
    /// A knob that does not exist.
    #[error("the patch sets '{0}', which this program does not know")]
    Knob(String),
    /// A value is not finite.
    #[error("the patch sets '{0}' to a value that is not finite")]
    NotFinite(String),
    /// A parameter is missing or not known.
    #[error("the patch gives effect '{id}' the wrong parameters: it has {wanted}")]
    Parameters {
        /// The effect.
        id: String,
        /// Names of its parameters.
        wanted: String,
    },
    /// The effect cannot be.
    #[error(transparent)]
    Effect(#[from] EffectError),
}

fn short(hash: &str) -> String {
    hash.chars().take(12).collect()
}

impl Knob {
    /// Its name in a patch file.
    pub fn id(self) -> String {
        match self {
            Self::Stiffness(i) => format!("chamber-{}-stiffness", i + 1),
            Self::Area(i) => format!("chamber-{}-area", i + 1),
            Self::RestLength(i) => format!("chamber-{}-rest-length", i + 1),
            Self::Hardening => "hardening".to_owned(),
            Self::Bending(s) => format!("segment-{}-bending", s + 1),
            Self::Torsion(s) => format!("segment-{}-torsion", s + 1),
            Self::Gripper => "gripper-mass".to_owned(),
            Self::Tilt(a) => format!("base-tilt-{}", ["x", "y"][a]),
            Self::Damping => "damping".to_owned(),
            Self::SpringOffset(i) => format!("spring-{}-offset", i + 1),
            Self::SpringGain(i) => format!("spring-{}-gain", i + 1),
            Self::Mounting(i, a) => format!("imu-{}-{}", i + 1, ["x", "y", "z"][a]),
            Self::Frame(k) => format!("mocap-{}", ["x", "y", "z", "rx", "ry", "rz"][k]),
            Self::Clock => "mocap-clock".to_owned(),
            Self::Body(k) => format!("tracked-body-{}", ["x", "y", "z", "rx", "ry", "rz"][k]),
            Self::SpringEnds(s) => format!("segment-{}-spring-ends", s + 1),
        }
    }
}

impl Patch {
    /// Reads a patch.
    ///
    /// # Errors
    /// [`PatchError`] for text that is no patch of this format, or names what does not exist.
    pub fn from_toml(text: &str) -> Result<Self, PatchError> {
        let patch: Self = toml::from_str(text)
            .map_err(|e| PatchError::Syntax(e.to_string().trim().replace('\n', " ")))?;
        if patch.version != VERSION {
            return Err(PatchError::Version(patch.version));
        }
        patch.values()?;
        patch.active()?;
        Ok(patch)
    }

    /// The patch as text.
    pub fn to_toml(&self) -> String {
        match toml::to_string(self) {
            Ok(text) => text,
            // Strings, numbers and maps with string keys always have a TOML form.
            Err(e) => unreachable!("a patch cannot be written: {e}"),
        }
    }

    /// Holds the patch against the robot it is to be used on.
    ///
    /// # Errors
    /// [`PatchError::Robot`] when it was made for another robot file.
    pub fn check_robot(&self, robot: &RobotSpec) -> Result<(), PatchError> {
        if self.robot == robot.hash {
            return Ok(());
        }
        Err(PatchError::Robot {
            made_for: short(&self.robot),
            given: short(&robot.hash),
        })
    }

    /// Values of all knobs.
    ///
    /// # Errors
    /// [`PatchError`] for a knob that does not exist or a value that is not finite.
    pub fn values(&self) -> Result<Vec<f64>, PatchError> {
        let mut values = nominal();
        let ids: Vec<String> = knobs().into_iter().map(Knob::id).collect();
        for (id, v) in &self.rig {
            let Some(i) = ids.iter().position(|k| k == id) else {
                return Err(PatchError::Knob(id.clone()));
            };
            if !v.is_finite() {
                return Err(PatchError::NotFinite(id.clone()));
            }
            values[i] = *v;
        }
        Ok(values)
    }

    /// Its effects, ready to act.
    ///
    /// # Errors
    /// [`PatchError`] for unknown effects, wrong parameters or values out of bounds.
    pub fn active(&self) -> Result<Vec<Active>, PatchError> {
        self.effects.iter().map(PatchEffect::active).collect()
    }

    /// Puts knob values into the patch; nominal ones are left out.
    pub fn set_values(&mut self, values: &[f64]) {
        self.rig = knobs()
            .into_iter()
            .zip(values)
            .filter(|(k, v)| **v != k.nominal())
            .map(|(k, v)| (k.id(), *v))
            .collect();
    }
}

impl PatchEffect {
    fn active(&self) -> Result<Active, PatchError> {
        let Some(effect) = crate::sim::effects::effect(&self.id) else {
            return Err(EffectError::Unknown(self.id.clone()).into());
        };
        let names: Vec<&str> = effect.parameters.iter().map(|p| p.name).collect();
        let known = self.params.keys().all(|k| names.contains(&k.as_str()));
        let values: Option<Vec<f64>> = names
            .iter()
            .map(|n| self.params.get(*n).map(|p| p.value))
            .collect();
        let (true, Some(values)) = (known, values) else {
            return Err(PatchError::Parameters {
                id: self.id.clone(),
                wanted: names.join(", "),
            });
        };
        // Files count from one; zero names nothing.
        let target = match self.target {
            Some(0) => Some(usize::MAX - 1),
            t => t.map(|t| t - 1),
        };
        Ok(Active::new(&self.id, target, &values)?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn patch() -> Patch {
        let mut patch = Patch {
            version: VERSION,
            name: "a rig".to_owned(),
            robot: RobotSpec::reference().hash,
            verdict: "named".to_owned(),
            data: BTreeMap::from([("suspect".to_owned(), "abc".to_owned())]),
            rig: BTreeMap::new(),
            floor: BTreeMap::from([("position_m".to_owned(), 1e-3)]),
            effects: vec![PatchEffect {
                id: "payload".to_owned(),
                target: None,
                params: BTreeMap::from([(
                    "mass".to_owned(),
                    PatchValue {
                        value: 0.4,
                        unit: "kg".to_owned(),
                        ci95: Some([0.38, 0.42]),
                    },
                )]),
            }],
        };
        let mut values = nominal();
        values[3] = 0.017;
        patch.set_values(&values);
        patch
    }

    #[test]
    fn a_patch_reads_back_as_it_was_written() {
        let p = patch();
        let back = Patch::from_toml(&p.to_toml()).expect("reads");
        assert_eq!(back, p);
        assert_eq!(back.rig.len(), 1);
        assert_eq!(back.values().expect("known")[3], 0.017);
        assert_eq!(back.active().expect("acts")[0].values, [0.4]);
    }

    #[test]
    fn patches_that_cannot_be_meant_are_refused() {
        let text = patch().to_toml();
        for (from, to, says) in [
            ("version = 1", "version = 9", "format 9"),
            (
                "chamber-4-stiffness",
                "chamber-9-stiffness",
                "chamber-9-stiffness",
            ),
            ("mass", "weight", "it has mass"),
            ("value = 0.4", "value = 40.0", "must lie in"),
            (
                "id = \"payload\"",
                "id = \"gremlin\"",
                "no effect 'gremlin'",
            ),
            (
                "id = \"payload\"",
                "id = \"payload\"\ntarget = 0",
                "cannot act on channel",
            ),
            ("name", "nome", "nome"),
        ] {
            assert!(text.contains(from), "{from} in {text}");
            let e = Patch::from_toml(&text.replace(from, to)).expect_err(from);
            assert!(e.to_string().contains(says), "{e}");
        }
        let mut other = RobotSpec::reference();
        other.hash = "0".repeat(64);
        assert!(patch().check_robot(&other).is_err());
        assert!(patch().check_robot(&RobotSpec::reference()).is_ok());
    }
}
