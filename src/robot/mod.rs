//! The robot as its file describes it: geometry, stiffness, masses, limits, frames.
//!
//! One TOML file per robot (`assets/robots/`); nothing in the code repeats its numbers. Segment and
//! chamber counts are fixed: two segments, six chambers, twelve springs, four IMUs. Keys carry mm,
//! kPa and degrees; [`RobotSpec`] is SI throughout. It imports signal alone and opens no file: it is
//! given the text.

mod error;
mod file;
mod keys;
mod patch;

use nalgebra::{Rotation3, Unit, Vector3};
use serde::Deserialize;

use crate::signal::{CHAMBERS, IMUS, Pose, PressureLimits, SPRINGS};
pub use error::RobotError;
pub use keys::{KEYS, Key, Number, numbers, split_comment};
pub use patch::{
    Applied, PATCH_VERSION, Patch, PatchEffect, PatchLaw, PatchValue, with_patch,
    without_last_patch,
};

/// Text of the robot file that ships with the program.
pub const REFERENCE: &str = include_str!("../../assets/robots/reference.toml");

/// Which pad carries an IMU.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PadId {
    /// Between the segments.
    Middle,
    /// At the end; carries the gripper.
    End,
}

impl PadId {
    /// 0 for the middle pad, 1 for the end pad: also the segment above it.
    pub fn index(self) -> usize {
        match self {
            Self::Middle => 0,
            Self::End => 1,
        }
    }
}

/// Mounting of an IMU on its pad.
#[derive(Clone, Debug, PartialEq)]
pub struct ImuMount {
    /// The pad.
    pub pad: PadId,
    /// Nominal mounting, pad frame from IMU frame.
    pub pad_from_imu: Rotation3<f64>,
}

/// The extension springs, all alike.
#[derive(Clone, Debug, PartialEq)]
pub struct SpringSpec {
    /// Force rate, N/m.
    pub rate_n_m: f64,
    /// Length without load, m.
    pub free_length_m: f64,
    /// Coil outer diameter, m.
    pub outer_diameter_m: f64,
    /// Wire diameter, m.
    pub wire_diameter_m: f64,
    /// Shortest and longest length it is used at, m.
    pub range_m: [f64; 2],
}

/// Stiffness of a segment beyond that of its three bellows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SegmentSpec {
    /// Against bending, in either plane, N m/rad.
    pub bending_nm_rad: f64,
    /// Against torsion, N m/rad.
    pub torsional_nm_rad: f64,
    /// Against extension, of a core on the axis, N/m.
    pub axial_n_m: f64,
}

/// What becomes of the chambers' air when the supply is off.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum SupplyOff {
    /// It stays in the chambers.
    #[default]
    Keeps,
    /// It escapes.
    Vents,
}

/// Standard deviations of the numbers of an arm, as shares of them where no unit is given.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Uncertainty {
    /// Effective area of each chamber.
    pub area: f64,
    /// Axial stiffness of each bellows.
    pub axial_stiffness: f64,
    /// Bending stiffness of each segment.
    pub bending_stiffness: f64,
    /// Torsional stiffness of each segment.
    pub torsional_stiffness: f64,
    /// Rest length of each bellows.
    pub rest_length: f64,
    /// Hardening of the bellows: the relative gain in tension per squared strain.
    pub hardening: f64,
    /// Mass of the gripper.
    pub mass: f64,
    /// Place of a tracked body on its pad, m.
    pub body_m: f64,
    /// Turn of a tracked body on its pad, rad.
    pub body_rad: f64,
    /// From one rest at the same pressures to the next: distance of a pad (root mean square), m.
    pub repeat_m: f64,
    /// The same: turn of a pad, rad.
    pub repeat_rad: f64,
}

/// A half-space that the middle and the end pad's centres do not enter, in the base frame.
#[derive(Clone, Debug, PartialEq)]
pub struct KeepOut {
    /// What is there.
    pub name: String,
    /// A point on its surface in the base frame, m.
    pub point_m: Vector3<f64>,
    /// Direction out of it, in the base frame.
    pub outward: Unit<Vector3<f64>>,
}

impl KeepOut {
    /// How deep a point of the base frame is in it, m; negative outside.
    pub fn depth_m(&self, point_m: &Vector3<f64>) -> f64 {
        self.outward.dot(&(self.point_m - point_m))
    }
}

/// A robot, in SI units. Arrays by bellows are in the order of the chambers, 1 to 3 in the upper and 4 to 6 in the lower
/// segment; arrays by spring are in the order 1A, 1B to 6A, 6B; arrays by segment have the upper one first.
#[derive(Clone, Debug, PartialEq)]
pub struct RobotSpec {
    /// Name of the robot.
    pub name: String,
    /// Centre of each bellows in its segment's cross-section (x, y, 0), in the axes of the base at rest, m.
    pub bellows_m: [Vector3<f64>; CHAMBERS],
    /// Thickness of the middle and end pads, m.
    pub pad_thickness_m: f64,
    /// Bellows length at 0 Pa, m.
    pub rest_length_m: f64,
    /// Shortest and longest bellows length in use, m.
    pub length_range_m: [f64; 2],
    /// Bellows outer diameter, m.
    pub bellows_outer_diameter_m: f64,
    /// Bellows inner diameter, m.
    pub bellows_inner_diameter_m: f64,
    /// Effective area of each chamber, m².
    pub area_m2: [f64; CHAMBERS],
    /// Axial stiffness of each bellows, N/m.
    pub axial_stiffness_n_m: [f64; CHAMBERS],
    /// What resists a segment's motion beside its three bellows, upper segment first.
    pub segments: [SegmentSpec; 2],
    /// Bounds of the commanded pressure.
    pub pressure: PressureLimits,
    /// Magnitude of the gauge pressure beyond which the pumps must be off, Pa.
    pub over_pressure_pa: f64,
    /// Volume flow of a pump at atmospheric pressure, m³/s.
    pub pump_flow_m3_s: f64,
    /// Mass of each bellows, kg.
    pub bellows_kg: f64,
    /// Mass of the middle pad, kg.
    pub middle_pad_kg: f64,
    /// Mass of the end pad, kg.
    pub end_pad_kg: f64,
    /// Mass of the gripper, kg.
    pub gripper_kg: f64,
    /// Gripper's centre of mass below the end pad's origin, m.
    pub gripper_com_m: f64,
    /// Payload's centre of mass below the end pad's origin, m.
    pub payload_com_m: f64,
    /// Heaviest payload, kg.
    pub payload_max_kg: f64,
    /// Upper end of each spring in the axes of the pad above it, from the centre of that pad's lower face, m.
    pub spring_top_m: [Vector3<f64>; SPRINGS],
    /// Lower end of each spring in the frame of the pad below it, m.
    pub spring_bottom_m: [Vector3<f64>; SPRINGS],
    /// The springs' common data.
    pub spring: SpringSpec,
    /// Mounting of each IMU, 1 to 4; the nominal pads where `has_imus` is false.
    pub imus: [ImuMount; IMUS],
    /// Whether there are inductive springs; without them `spring` and their ends stand for nothing.
    pub has_springs: bool,
    /// Whether there are IMUs.
    pub has_imus: bool,
    /// Poses of motion capture's bodies: of the one on the base in the base frame, of those on the middle and the end pad in
    /// that pad's frame; the identity for a body that the file does not name.
    pub bodies: [Pose; 3],
    /// How uncertain the numbers are.
    pub uncertainty: Uncertainty,
    /// Fastest tip speed, m/s.
    pub tip_speed_max_m_s: f64,
    /// What becomes of the chambers' air when the supply is off.
    pub supply_off: SupplyOff,
    /// Half-spaces that the arm does not enter.
    pub keep_out: Vec<KeepOut>,
    /// The unit of the reference robot that the numbers were measured on, where the arm is a virtual one; the virtual rig is then
    /// that unit. `None`: the virtual rig is made of this file.
    pub virtual_unit: Option<u64>,
    /// SHA-256 of the robot file, hexadecimal.
    pub hash: String,
    /// The same of the file without its patches.
    pub base_hash: String,
    /// Patches of the file, in order. The fields above are the robot without them: the simulators apply them.
    pub patches: Vec<Applied>,
}

impl RobotSpec {
    /// The pose of a body of motion capture in the base frame. `base` is the pose of the body on the base, both in motion
    /// capture's world.
    pub fn base_from_captured(&self, base: &Pose, body: &Pose) -> Pose {
        self.bodies[0] * base.inverse() * body
    }

    /// The grip point, where the gripper holds its load, in the end pad's frame, m.
    pub fn grip_m(&self) -> [f64; 3] {
        [0.0, 0.0, -self.payload_com_m]
    }

    /// Pad of each IMU (see [`PadId::index`]), in the order of the IMUs.
    pub fn pad_of_imu(&self) -> [usize; IMUS] {
        self.imus.each_ref().map(|imu| imu.pad.index())
    }

    /// The robot that ships with the program, `assets/robots/reference.toml`.
    pub fn reference() -> Self {
        match Self::from_toml(REFERENCE) {
            Ok(spec) => spec,
            // The file is part of the binary and a test loads it.
            Err(e) => unreachable!("the built-in robot file does not load: {e}"),
        }
    }

    /// Which sensors the arm lacks, as in "no springs and no IMUs"; `None` if it has all.
    pub fn lacks(&self) -> Option<String> {
        let lacks: Vec<&str> = [(self.has_springs, "no springs"), (self.has_imus, "no IMUs")]
            .into_iter()
            .filter_map(|(has, what)| (!has).then_some(what))
            .collect();
        (!lacks.is_empty()).then(|| lacks.join(" and "))
    }

    /// Why this program cannot drive the arm; `None` if it can.
    pub fn why_not_driven(&self) -> Option<String> {
        self.lacks().map(|lacks| {
            format!(
                "the robot file '{}' has {lacks}: nothing estimates the pose of this arm, so it cannot be driven; its logs can be \
                 compared with `springtwin gap run --window`",
                self.name
            )
        })
    }

    /// Effective area of the largest chamber, which fills slowest, m².
    pub fn largest_area_m2(&self) -> f64 {
        self.area_m2.iter().copied().fold(0.0, f64::max)
    }

    /// Whether a gauge pressure (Pa) is beyond the over-pressure limit, above or below atmospheric pressure.
    pub fn is_over_pressure(&self, chamber_pa: f64) -> bool {
        chamber_pa.abs() > self.over_pressure_pa
    }
}
