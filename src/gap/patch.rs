//! Patch files: they turn the factory model into the commissioned one and add the missing effects.
//! Patches stack in order and can be reverted.

use super::replay::calibration_parameters;
use crate::robot::RobotSpec;
pub use crate::robot::{PATCH_VERSION as VERSION, Patch, PatchEffect, PatchLaw, PatchValue};
use crate::sim::patch::Acts;
pub use crate::sim::patch::PatchError;

/// Effects and terms of laws of a patch that act over time only, with their channels (1-based): a settled arm does not show them.
pub fn acts_over_time(patch: &Patch) -> Vec<(&'static str, Option<usize>)> {
    let all = patch.active().unwrap_or_default().into_iter();
    all.filter(|a| Acts::of(a.effect) == Acts::Replay)
        .map(|a| (a.effect.id, a.target.map(|t| t + 1)))
        .collect()
}

fn short(hash: &str) -> String {
    hash.chars().take(12).collect()
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

    /// Holds the patch against the robot it is to be used on: it must have been made for that robot
    /// as it is, or before some of its patches.
    ///
    /// # Errors
    /// [`PatchError::Robot`] when it was made for another robot file.
    pub fn check_robot(&self, robot: &RobotSpec) -> Result<(), PatchError> {
        if robot.accepts(self) {
            return Ok(());
        }
        Err(PatchError::Robot {
            made_for: short(&self.robot),
            given: short(&robot.hash),
        })
    }

    /// Puts the values of calibration parameters, in their order, into the patch; nominal ones are omitted.
    pub fn set_values(&mut self, values: &[f64]) {
        self.rig = calibration_parameters()
            .into_iter()
            .zip(values)
            .filter(|(k, v)| **v != k.nominal())
            .map(|(k, v)| (k.id(), *v))
            .collect();
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::*;
    use crate::gap::{Grid, Session, move_arm, nominal, residuals};
    use crate::robot::{REFERENCE, with_patch};
    use crate::signal::{Pose, SensorVec, pose_error};
    use crate::sim::{Inputs, Model, State, observe, settle};

    fn patch() -> Patch {
        let mut patch = Patch {
            version: VERSION,
            name: "a rig".to_owned(),
            robot: RobotSpec::reference().hash,
            verdict: "named".to_owned(),
            data: BTreeMap::from([("suspect".to_owned(), "abc".to_owned())]),
            rig: BTreeMap::new(),
            floor: BTreeMap::from([("position_m".to_owned(), 1e-3)]),
            law: Vec::new(),
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

    /// The robot with the patch is the arm that a replay with the patch moves.
    #[test]
    fn a_patched_robot_is_the_replayed_arm() {
        let mut patch = patch();
        for (parameter, v) in [
            ("segment-2-spring-ends", 4e-3),
            ("base-tilt-x", 0.01),
            ("damping", 0.08),
            ("spring-2-offset", 1e-3),
            ("tracked-body-x", 2e-3),
        ] {
            patch.rig.insert(parameter.to_owned(), v);
        }
        let base = RobotSpec::reference();
        let patched = RobotSpec::from_toml(&with_patch(REFERENCE, &patch)).expect("reads");
        let t_s: Vec<f64> = (0..125).map(|k| 0.2 * f64::from(k)).collect();
        let n = t_s.len();
        let at = |t: f64| std::array::from_fn(|i| 12e3 * (0.2 * t + i as f64).sin());
        let grid = Grid::new(Session {
            payload_kg: 0.1,
            chamber_pa: t_s.iter().map(|t| at(*t)).collect(),
            sensors: vec![
                SensorVec {
                    spring_m: [0.15; 12],
                    imu_ypr_rad: [[0.0; 3]; 4],
                };
                n
            ],
            captured: vec![Some(Pose::identity()); n],
            t_s,
            ..Session::default()
        })
        .expect("a session");
        let (values, effects) = (
            patch.values().expect("known"),
            patch.active().expect("acts"),
        );
        let by_patch = move_arm(&base, &grid, &values, &effects).expect("moves");
        let by_robot = move_arm(&patched, &grid, &nominal(), &[]).expect("moves");
        assert_eq!(by_patch, by_robot);
        let model = Model::nominal(&patched);
        let mut state = State::rest(&model);
        let inputs = Inputs {
            chamber_pa: by_patch.chamber_pa[0],
            payload_kg: 0.1,
            ..Inputs::default()
        };
        settle(&model, &mut state, &inputs).expect("settles");
        let tip = observe(&model, &state).base_from_tip;
        let apart = pose_error(&tip, &by_patch.base_from_pad[0][2]).norm();
        assert!(apart < 1e-9, "{apart:.1e}");
        assert_ne!(
            by_patch,
            move_arm(&base, &grid, &nominal(), &[]).expect("moves")
        );
        let rows = residuals(&base, &grid, &by_patch, &values, &effects);
        assert_eq!(rows, residuals(&patched, &grid, &by_robot, &nominal(), &[]));
        assert_ne!(rows, residuals(&base, &grid, &by_patch, &nominal(), &[]));
    }
}
