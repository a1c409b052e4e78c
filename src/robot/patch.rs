//! Patches at the end of a robot file: corrections found on one rig, on top of its file.
//!
//! A patched file is the text it was applied to, byte for byte, then one comment line with the
//! SHA-256 of that text, then a `[[patches]]` table. Patches stack; the last one can be reverted.
//! What the names in a patch mean is defined by the simulators, not here.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use super::{RobotError, RobotSpec};
use crate::signal::hex;

/// Version of the patch format that is written.
pub const PATCH_VERSION: u32 = 1;

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
    /// Departures of this rig from the robot it was made for, SI, by calibration parameter.
    #[serde(default)]
    pub rig: BTreeMap<String, f64>,
    /// Errors on data that were not fitted, SI.
    #[serde(default)]
    pub floor: BTreeMap<String, f64>,
    /// Effects to add.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub effects: Vec<PatchEffect>,
    /// Terms of laws to add.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub law: Vec<PatchLaw>,
}

/// A term of a law in a patch.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PatchLaw {
    /// Which term of the library.
    pub term: String,
    /// Its equation, for people.
    #[serde(default)]
    pub equation: String,
    /// Chamber, spring, IMU or segment (1-based); `None`: all of them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub target: Option<usize>,
    /// Its coefficients and what shapes it, by the name of the parameter.
    pub params: BTreeMap<String, PatchValue>,
}

/// An effect of a patch.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PatchEffect {
    /// Which effect.
    pub id: String,
    /// Chamber, spring, IMU or segment (1-based); `None`: all of them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub target: Option<usize>,
    /// Its parameters, by name.
    pub params: BTreeMap<String, PatchValue>,
}

/// A parameter of a patch.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PatchValue {
    /// Value in `unit`.
    pub value: f64,
    /// SI unit; empty for a ratio.
    #[serde(default)]
    pub unit: String,
    /// 95 % interval in `unit`, lower end first; `None` where none is known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ci95: Option<[f64; 2]>,
}

/// A patch in its place.
#[derive(Clone, Debug, PartialEq)]
pub struct Applied {
    /// Hash of the robot it was applied to.
    pub onto: String,
    /// Its value.
    pub patch: Patch,
}

/// Begins the line between a text and the patch put on it.
const MARK: &str = "\n# springtwin patch, SHA-256 of the text above: ";
const NOTE: &str =
    "# Take it back with `springtwin gap apply --undo`; a change above this line makes it void.";

/// SHA-256, hexadecimal.
pub(super) fn hash_of(text: &str) -> String {
    hex(&Sha256::digest(text.as_bytes()))
}

#[derive(Serialize)]
struct Section<'a> {
    patches: [&'a Patch; 1],
}

/// The text of a robot file with a patch applied to it. [`RobotSpec::from_toml`] checks whether the result
/// holds.
pub fn with_patch(text: &str, patch: &Patch) -> String {
    let section = match toml::to_string(&Section { patches: [patch] }) {
        Ok(section) => section,
        // Strings, numbers and maps with string keys always have a TOML form.
        Err(e) => unreachable!("a patch cannot be written: {e}"),
    };
    format!("{text}{MARK}{}\n{NOTE}\n{section}", hash_of(text))
}

/// The text of a robot file before its last patch.
///
/// # Errors
/// [`RobotError::NoPatch`] without one, [`RobotError::Patch`] when the text above it was changed.
pub fn without_last_patch(text: &str) -> Result<&str, RobotError> {
    let number = text.matches(MARK).count();
    let at = text.rfind(MARK).ok_or(RobotError::NoPatch)?;
    check_hash(text, at, number)?;
    Ok(&text[..at])
}

fn check_hash(text: &str, at: usize, number: usize) -> Result<String, RobotError> {
    let hash = hash_of(&text[..at]);
    let stated = text[at + MARK.len()..].lines().next().unwrap_or_default();
    if stated == hash {
        return Ok(hash);
    }
    Err(RobotError::Patch {
        number,
        why: "does not fit the text above it, which was changed: put that text back, or apply the patch again",
    })
}

/// Holds the patches of a file against its text.
pub(super) fn applied(text: &str, patches: Vec<Patch>) -> Result<Vec<Applied>, RobotError> {
    let marks: Vec<usize> = text.match_indices(MARK).map(|(at, _)| at).collect();
    if marks.len() != patches.len() {
        return Err(RobotError::Patch {
            number: marks.len().min(patches.len()) + 1,
            why: "and its comment line do not belong together: write patches with `springtwin gap apply`",
        });
    }
    let mut out: Vec<Applied> = Vec::new();
    for (k, (at, patch)) in marks.into_iter().zip(patches).enumerate() {
        let number = k + 1;
        let bad = |why| Err(RobotError::Patch { number, why });
        let onto = check_hash(text, at, number)?;
        if patch.version != PATCH_VERSION {
            return bad("has a format that this program does not read");
        }
        if patch.robot != onto && out.iter().all(|a| a.onto != patch.robot) {
            return bad("was made for another robot file");
        }
        let params = patch.effects.iter().flat_map(|e| e.params.values());
        let law = patch.law.iter().flat_map(|l| l.params.values());
        let mut numbers = patch
            .rig
            .values()
            .copied()
            .chain(params.chain(law).map(|p| p.value));
        if !numbers.all(f64::is_finite) {
            return bad("holds a number that is not finite");
        }
        out.push(Applied { onto, patch });
    }
    Ok(out)
}

impl RobotSpec {
    /// Whether a patch was made for this robot, as it is or before some of its patches.
    pub fn accepts(&self, patch: &Patch) -> bool {
        patch.robot == self.hash || self.patches.iter().any(|a| a.onto == patch.robot)
    }

    /// The robot with one more patch, which it [accepts](Self::accepts). Its hash is that of no file.
    pub fn patched(&self, patch: Patch) -> Self {
        let mut out = self.clone();
        out.hash = hash_of(&with_patch(&self.hash, &patch));
        out.patches.push(Applied {
            onto: self.hash.clone(),
            patch,
        });
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::REFERENCE;

    fn patch(robot: &str, name: &str) -> Patch {
        Patch {
            version: PATCH_VERSION,
            name: name.to_owned(),
            robot: robot.to_owned(),
            verdict: "named".to_owned(),
            data: BTreeMap::new(),
            rig: BTreeMap::from([("chamber-1-stiffness".to_owned(), 0.02)]),
            floor: BTreeMap::new(),
            law: Vec::new(),
            effects: vec![PatchEffect {
                id: "payload".to_owned(),
                target: None,
                params: BTreeMap::from([(
                    "mass".to_owned(),
                    PatchValue {
                        value: 0.2,
                        unit: "kg".to_owned(),
                        ci95: None,
                    },
                )]),
            }],
        }
    }

    fn read(text: &str) -> RobotSpec {
        RobotSpec::from_toml(text).expect("reads")
    }

    #[test]
    fn patches_stack_and_come_off_byte_for_byte() {
        for base in [
            REFERENCE.to_owned(),
            REFERENCE.trim_end().to_owned(),
            REFERENCE.replace('\n', "\r\n"),
        ] {
            let plain = read(&base);
            assert_eq!((plain.patches.len(), &plain.base_hash), (0, &plain.hash));
            let one = with_patch(&base, &patch(&plain.hash, "first"));
            let r1 = read(&one);
            let two = with_patch(&one, &patch(&r1.hash, "on the first"));
            let three = with_patch(&two, &patch(&plain.hash, "for the base"));
            let r3 = read(&three);
            assert_eq!(r3.patches.len(), 3);
            assert_eq!(r3.base_hash, plain.hash);
            assert_eq!(r3.patches[1].onto, r1.hash);
            assert_ne!(r3.hash, r1.hash);
            assert!(r3.accepts(&patch(&plain.hash, "")) && r3.accepts(&patch(&r1.hash, "")));
            assert!(!plain.accepts(&patch(&r1.hash, "")));
            assert_eq!(without_last_patch(&three).expect("undone"), two);
            assert_eq!(without_last_patch(&two).expect("undone"), one);
            assert_eq!(without_last_patch(&one).expect("undone"), base);
            let e = without_last_patch(&base).expect_err("nothing there");
            assert!(e.to_string().contains("no patch"), "{e}");
        }
    }

    #[test]
    fn what_does_not_hold_together_is_refused() {
        let plain = RobotSpec::reference();
        let text = with_patch(REFERENCE, &patch(&plain.hash, "first"));
        let edited = text.replace("rate_n_m = 54.0", "rate_n_m = 55.0");
        for e in [
            RobotSpec::from_toml(&edited).expect_err("edited"),
            without_last_patch(&edited).expect_err("edited"),
        ] {
            assert!(e.to_string().contains("does not fit the text above"), "{e}");
        }
        let refused = |text: &str| {
            let e = RobotSpec::from_toml(text).expect_err("refused").to_string();
            assert!(!e.contains('\n'), "{e}");
            e
        };
        let stranger = with_patch(REFERENCE, &patch(&"0".repeat(64), "of another"));
        assert!(refused(&stranger).contains("another robot file"));
        assert!(refused(&text.replace("version = 1", "version = 2")).contains("format"));
        assert!(refused(&text.replace("value = 0.2", "value = nan")).contains("not finite"));
        assert!(refused(&text.replace("[patches.rig]", "[patches.rug]")).contains("rug"));
        let unmarked = text.replace(MARK, "\n# ");
        assert!(refused(&unmarked).contains("gap apply"));
    }
}
