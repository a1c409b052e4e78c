//! The registration file: TOML with mm, degrees and ms in, [`Registration`] in SI out.

use serde::{Deserialize, Serialize};

use super::{FAR_M, FrameFit, Frames, HeldOutSummary, Noise, POSES_MIN, StreamRegistration};
use crate::signal::{Pose, exactly, pose_from_ypr, toml_error, ypr_from_rotation};

/// The only format there is so far.
const FORMAT: u32 = 1;
const MM: f64 = 1e-3;
const MS: f64 = 1e-3;
/// As many seconds as a century has.
const OFFSET_MAX_S: f64 = 3.2e9;

/// A transform and its one sigma, in the worst direction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placed {
    /// The transform, as the name of the field that holds it states.
    pub pose: Pose,
    /// One sigma; 0 where it was held.
    pub sigma: Noise,
}

/// What motion capture's clock reads, where that was measured.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MeasuredOffset {
    /// t_robot = t_mocap + offset, s.
    pub offset_s: f64,
    /// One sigma of it, s.
    pub sigma_s: f64,
}

/// How motion capture lies on a robot, as it is kept in a file.
#[derive(Clone, Debug, PartialEq)]
pub struct Registration {
    /// Name of the tracked object.
    pub object: String,
    /// When it was registered, as the operator states it.
    pub date: String,
    /// SHA-256 of the data it was fitted to, hexadecimal.
    pub data_sha256: String,
    /// X.
    pub base_from_world: Placed,
    /// Y.
    pub object_from_tip: Placed,
    /// The clock's offset; `None` for settled poses, which state nothing of it.
    pub clock: Option<MeasuredOffset>,
    /// Poses it rests on.
    pub poses: usize,
    /// Leave-one-out residuals over them.
    pub held_out: HeldOutSummary,
}

/// Why a registration file was refused.
#[derive(Debug, thiserror::Error)]
pub enum RegistrationFileError {
    /// Not valid TOML, or a key is missing, unknown or of the wrong type (the message has line and
    /// column).
    #[error("the registration file is not valid: {0}")]
    Syntax(String),
    /// A value makes no sense.
    #[error(
        "the registration file has {key} = {value}, but it must be {must}; run springtwin calibrate mocap again"
    )]
    Value {
        /// The key.
        key: String,
        /// Value in the file.
        value: String,
        /// What it must be.
        must: &'static str,
    },
    /// Could not be written as TOML.
    #[error("the registration cannot be written: {0}")]
    Write(#[from] toml::ser::Error),
}

impl Registration {
    /// What `register_streams` found, for a file.
    pub fn new(found: &StreamRegistration, object: &str, date: &str, data_sha256: &str) -> Self {
        Self {
            clock: Some(MeasuredOffset {
                offset_s: found.clock.offset_s,
                sigma_s: found.clock.sigma_s,
            }),
            ..Self::of_poses(&found.fit, object, date, data_sha256)
        }
    }

    /// What `register` found from settled poses, for a file: they say nothing of the clock.
    pub fn of_poses(fit: &FrameFit, object: &str, date: &str, data_sha256: &str) -> Self {
        Self {
            object: object.to_owned(),
            date: date.to_owned(),
            data_sha256: data_sha256.to_owned(),
            base_from_world: Placed {
                pose: fit.frames.base_from_world,
                sigma: fit.base_from_world_sigma(),
            },
            object_from_tip: Placed {
                pose: fit.frames.object_from_tip,
                sigma: fit.object_from_tip_sigma(),
            },
            clock: None,
            poses: fit.used(),
            held_out: fit.summary,
        }
    }

    /// The two transforms.
    pub fn frames(&self) -> Frames {
        Frames {
            base_from_world: self.base_from_world.pose,
            object_from_tip: self.object_from_tip.pose,
        }
    }

    /// Tip in the base frame, by the pose of the tracked object in motion capture's world.
    pub fn ground_truth_pose(&self, world_from_object: &Pose) -> Pose {
        self.frames().base_from_tip(world_from_object)
    }

    /// The robot's time of a motion-capture time, s; `None` while the clock's offset is not known.
    pub fn robot_time_s(&self, mocap_s: f64) -> Option<f64> {
        Some(mocap_s + self.clock?.offset_s)
    }

    /// Reads the text of a registration file.
    ///
    /// # Errors
    /// [`RegistrationFileError`] with line and column for syntax, with the key for values.
    pub fn from_toml(text: &str) -> Result<Self, RegistrationFileError> {
        let file: File = toml::from_str(text)
            .map_err(|e| RegistrationFileError::Syntax(toml_error(text, &e)))?;
        file.check()?;
        let l = &file.leave_one_out;
        Ok(Self {
            base_from_world: file.base_from_world.placed(),
            object_from_tip: file.object_from_tip.placed(),
            clock: file.clock(),
            poses: file.poses,
            held_out: HeldOutSummary {
                position_rms_m: l.position_rms_mm * MM,
                position_worst_m: l.position_worst_mm * MM,
                rotation_rms_rad: l.rotation_rms_deg.to_radians(),
                rotation_worst_rad: l.rotation_worst_deg.to_radians(),
            },
            object: file.object,
            date: file.date,
            data_sha256: file.data_sha256,
        })
    }

    /// The text of the registration file.
    ///
    /// # Errors
    /// [`RegistrationFileError::Value`] for a registration that [`Self::from_toml`] would refuse.
    pub fn to_toml(&self) -> Result<String, RegistrationFileError> {
        let h = &self.held_out;
        let file = File {
            format: FORMAT,
            object: self.object.clone(),
            date: self.date.clone(),
            data_sha256: self.data_sha256.clone(),
            poses: self.poses,
            clock_offset_ms: self.clock.map(|c| tidy(c.offset_s / MS)),
            clock_offset_sigma_ms: self.clock.map(|c| readable(c.sigma_s / MS)),
            base_from_world: Transform::of(&self.base_from_world),
            object_from_tip: Transform::of(&self.object_from_tip),
            leave_one_out: LeaveOneOut {
                position_rms_mm: readable(h.position_rms_m / MM),
                position_worst_mm: readable(h.position_worst_m / MM),
                rotation_rms_deg: readable(h.rotation_rms_rad.to_degrees()),
                rotation_worst_deg: readable(h.rotation_worst_rad.to_degrees()),
            },
        };
        file.check()?;
        Ok(format!("{HEAD}{}", toml::to_string(&file)?))
    }
}

const HEAD: &str = "\
# Registration of motion capture:
#   base_from_tip(t) = base_from_world * world_from_object(t - clock_offset) * object_from_tip.
# ypr_deg: R = Rz(yaw) Ry(pitch) Rx(roll). sigma: one standard deviation in the worst direction,
# that of base_from_world in the middle of the poses. Without clock_offset the clock was not measured. leave_one_out: each pose predicted from others.

";

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    format: u32,
    object: String,
    date: String,
    data_sha256: String,
    poses: usize,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    clock_offset_ms: Option<f64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    clock_offset_sigma_ms: Option<f64>,
    base_from_world: Transform,
    object_from_tip: Transform,
    leave_one_out: LeaveOneOut,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Transform {
    #[serde(deserialize_with = "exactly")]
    position_mm: [f64; 3],
    #[serde(deserialize_with = "exactly")]
    ypr_deg: [f64; 3],
    sigma_mm: f64,
    sigma_deg: f64,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct LeaveOneOut {
    position_rms_mm: f64,
    position_worst_mm: f64,
    rotation_rms_deg: f64,
    rotation_worst_deg: f64,
}

/// Thirteen digits hide the rounding of the change of unit.
fn tidy(x: f64) -> f64 {
    format!("{x:.12e}").parse().unwrap_or(x)
}

/// A millionth is enough for figures that only people read.
fn readable(x: f64) -> f64 {
    (x * 1e6).round() / 1e6
}

impl Transform {
    fn of(placed: &Placed) -> Self {
        Self {
            position_mm: placed.pose.translation.vector.map(|x| tidy(x / MM)).into(),
            ypr_deg: ypr_from_rotation(&placed.pose.rotation).map(|a| tidy(a.to_degrees())),
            sigma_mm: readable(placed.sigma.position_m / MM),
            sigma_deg: readable(placed.sigma.rotation_rad.to_degrees()),
        }
    }

    fn placed(&self) -> Placed {
        Placed {
            pose: pose_from_ypr(
                self.position_mm.map(|x| x * MM),
                self.ypr_deg.map(f64::to_radians),
            ),
            sigma: Noise {
                position_m: self.sigma_mm * MM,
                rotation_rad: self.sigma_deg.to_radians(),
            },
        }
    }
}

fn refuse(key: impl Into<String>, value: String, must: &'static str) -> RegistrationFileError {
    RegistrationFileError::Value {
        key: key.into(),
        value,
        must,
    }
}

impl File {
    /// The clock's offset. Nothing measured has no uncertainty at all: 0 with a sigma of 0 was written for a clock
    /// that was not measured.
    fn clock(&self) -> Option<MeasuredOffset> {
        let (offset_ms, sigma_ms) = self.clock_offset_ms.zip(self.clock_offset_sigma_ms)?;
        (offset_ms != 0.0 || sigma_ms != 0.0).then_some(MeasuredOffset {
            offset_s: offset_ms * MS,
            sigma_s: sigma_ms * MS,
        })
    }

    fn check_clock(&self) -> Result<(), RegistrationFileError> {
        let (offset_ms, sigma_ms) = match (self.clock_offset_ms, self.clock_offset_sigma_ms) {
            (None, None) => return Ok(()),
            (Some(offset_ms), Some(sigma_ms)) => (offset_ms, sigma_ms),
            (offset, _) => {
                let missing = match offset {
                    None => "clock_offset_ms",
                    Some(_) => "clock_offset_sigma_ms",
                };
                let must = "there with the other one, or neither";
                return Err(refuse(missing, "nothing".into(), must));
            }
        };
        let offset_s = offset_ms * MS;
        if offset_s.is_nan() || offset_s.abs() > OFFSET_MAX_S {
            let value = offset_ms.to_string();
            return Err(refuse("clock_offset_ms", value, "within a century"));
        }
        if !(sigma_ms.is_finite() && sigma_ms >= 0.0) {
            let value = sigma_ms.to_string();
            return Err(refuse("clock_offset_sigma_ms", value, "0 or more"));
        }
        Ok(())
    }

    fn check(&self) -> Result<(), RegistrationFileError> {
        if self.format != FORMAT {
            let value = self.format.to_string();
            return Err(refuse("format", value, "1, the one this program knows"));
        }
        if self.poses < POSES_MIN {
            return Err(refuse("poses", self.poses.to_string(), "10 or more"));
        }
        let is_hash =
            self.data_sha256.len() == 64 && self.data_sha256.bytes().all(|b| b.is_ascii_hexdigit());
        if !is_hash {
            return Err(refuse(
                "data_sha256",
                format!("{:?}", self.data_sha256),
                "64 hexadecimal digits",
            ));
        }
        self.check_clock()?;
        self.check_transforms()?;
        let l = &self.leave_one_out;
        let (x, y) = (&self.base_from_world, &self.object_from_tip);
        for (key, value) in [
            ("base_from_world.sigma_mm", x.sigma_mm),
            ("base_from_world.sigma_deg", x.sigma_deg),
            ("object_from_tip.sigma_mm", y.sigma_mm),
            ("object_from_tip.sigma_deg", y.sigma_deg),
            ("leave_one_out.position_rms_mm", l.position_rms_mm),
            ("leave_one_out.position_worst_mm", l.position_worst_mm),
            ("leave_one_out.rotation_rms_deg", l.rotation_rms_deg),
            ("leave_one_out.rotation_worst_deg", l.rotation_worst_deg),
        ] {
            if !(value.is_finite() && value >= 0.0) {
                return Err(refuse(key, value.to_string(), "0 or more"));
            }
        }
        Ok(())
    }

    fn check_transforms(&self) -> Result<(), RegistrationFileError> {
        for (name, t) in [
            ("base_from_world", &self.base_from_world),
            ("object_from_tip", &self.object_from_tip),
        ] {
            if !t.position_mm.iter().all(|x| (x * MM).abs() < FAR_M) {
                return Err(refuse(
                    format!("{name}.position_mm"),
                    format!("{:?}", t.position_mm),
                    "three numbers of less than a kilometre",
                ));
            }
            if !t.ypr_deg.iter().all(|a| a.abs() <= 360.0) {
                return Err(refuse(
                    format!("{name}.ypr_deg"),
                    format!("{:?}", t.ypr_deg),
                    "three angles within 360 degrees",
                ));
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn example() -> Registration {
        Registration {
            object: "end_pad".into(),
            date: "2025-03-01".into(),
            data_sha256: "ab".repeat(32),
            base_from_world: Placed {
                pose: pose_from_ypr([0.1234567, -2.5, 1.75], [3.1, -0.4, 2.9]),
                sigma: Noise {
                    position_m: 1e-4,
                    rotation_rad: 1e-3,
                },
            },
            object_from_tip: Placed {
                pose: pose_from_ypr([0.01, -0.02, 0.03], [-1.0, 0.2, -3.0]),
                sigma: Noise {
                    position_m: 2e-4,
                    rotation_rad: 2e-3,
                },
            },
            clock: Some(MeasuredOffset {
                offset_s: -0.8123456,
                sigma_s: 3e-4,
            }),
            poses: 24,
            held_out: HeldOutSummary {
                position_rms_m: 2e-4,
                position_worst_m: 5e-4,
                rotation_rms_rad: 1e-3,
                rotation_worst_rad: 2e-3,
            },
        }
    }

    #[test]
    fn file_round_trips_and_moves_poses_as_before() {
        let one = example();
        let text = one.to_toml().expect("writes");
        let two = Registration::from_toml(&text).expect("reads");
        assert_eq!(two.to_toml().expect("writes"), text);
        let seen = pose_from_ypr([1.0, 2.0, 0.4], [0.3, 0.2, 0.1]);
        let e =
            crate::signal::pose_error(&one.ground_truth_pose(&seen), &two.ground_truth_pose(&seen));
        assert!(e.amax() < 1e-11, "{e}");
        let by_hand = one.base_from_world.pose * seen * one.object_from_tip.pose;
        assert_eq!(one.ground_truth_pose(&seen), by_hand);
        let robot_s = two.robot_time_s(1.0).expect("was measured");
        assert!((robot_s - 0.1876544).abs() < 1e-12);
    }

    #[test]
    fn a_clock_that_was_not_measured_is_no_offset_of_zero() {
        let unknown = Registration {
            clock: None,
            ..example()
        };
        let text = unknown.to_toml().expect("writes");
        assert!(!text.contains("clock_offset_"), "{text}");
        let read = Registration::from_toml(&text).expect("reads");
        assert_eq!((read.clock, read.robot_time_s(1.0)), (None, None));
        // What earlier versions wrote for it.
        let old = text.replacen(
            "[base_from_world]",
            "clock_offset_ms = 0.0\nclock_offset_sigma_ms = 0.0\n[base_from_world]",
            1,
        );
        assert_ne!(old, text);
        assert_eq!(Registration::from_toml(&old).expect("reads").clock, None);
        let half = text.replacen(
            "[base_from_world]",
            "clock_offset_ms = 1.0\n[base_from_world]",
            1,
        );
        let e = Registration::from_toml(&half)
            .expect_err("half")
            .to_string();
        assert!(e.contains("clock_offset_sigma_ms"), "{e}");
    }

    #[test]
    fn refusals_name_the_key() {
        let text = example().to_toml().expect("writes");
        let refused = |from: &str, to: &str, says: &[&str]| {
            let bad = text.replacen(from, to, 1);
            assert_ne!(bad, text, "{from}");
            let e = Registration::from_toml(&bad).expect_err(to).to_string();
            for word in says {
                assert!(e.contains(word), "{e}");
            }
        };
        refused("format = 1", "format = 2", &["format = 2"]);
        refused("poses = 24", "poses = 9", &["poses = 9", "10 or more"]);
        refused("poses = 24", "poses = \"x\"", &["line"]);
        refused("poses = 24", "pose = 24", &["line"]);
        refused("\"abab", "\"zbab", &["data_sha256"]);
        refused(
            "clock_offset_ms = ",
            "clock_offset_ms = nan #",
            &["clock_offset_ms"],
        );
        refused(
            "clock_offset_sigma_ms = ",
            "clock_offset_sigma_ms = -",
            &["clock_offset_sigma_ms"],
        );
        refused("123.4567", "1e9", &["base_from_world.position_mm"]);
        refused("ypr_deg = [", "ypr_deg = [1", &["base_from_world.ypr_deg"]);
        refused(
            "sigma_deg = ",
            "sigma_deg = inf #",
            &["base_from_world.sigma_deg"],
        );
        refused(
            "rotation_worst_deg = ",
            "rotation_worst_deg = -",
            &["leave_one_out.rotation_worst_deg"],
        );
        let unfit = Registration {
            clock: Some(MeasuredOffset {
                offset_s: f64::NAN,
                sigma_s: 1e-3,
            }),
            ..example()
        };
        assert!(unfit.to_toml().is_err());
    }

    proptest! {
        #[test]
        fn reader_never_panics(cut in 0usize..1200, noise in "\\PC{0,40}") {
            let text = example().to_toml().expect("writes");
            let at = text.char_indices().map(|(i, _)| i).nth(cut).unwrap_or(text.len());
            let _ = Registration::from_toml(&format!("{}{noise}{}", &text[..at], &text[at..]));
            let _ = Registration::from_toml(&text[..at]);
        }
    }
}
