//! The messages that a bag of this program has: their definitions, and their bytes.

use super::cdr::CdrWriter;
use crate::signal::{ImuRaw, Pose, Stamp};

/// What is not measured, in the first element of a covariance of sensor_msgs/Imu.
const NOT_MEASURED: f64 = -1.0;

/// A type of message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum MessageKind {
    Float64,
    Imu,
    FluidPressure,
    JointState,
    Pose,
    Wrench,
    Transforms,
    Diagnostics,
}

const HEADER: &str = "std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id";
const TIME: &str = "builtin_interfaces/Time\nint32 sec\nuint32 nanosec";
const QUATERNION: &str = "geometry_msgs/Quaternion\nfloat64 x\nfloat64 y\nfloat64 z\nfloat64 w";
const VECTOR: &str = "geometry_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64 z";
const POINT: &str = "geometry_msgs/Point\nfloat64 x\nfloat64 y\nfloat64 z";
const POSE: &str =
    "geometry_msgs/Pose\ngeometry_msgs/Point position\ngeometry_msgs/Quaternion orientation";
const WRENCH: &str =
    "geometry_msgs/Wrench\ngeometry_msgs/Vector3 force\ngeometry_msgs/Vector3 torque";
const TRANSFORM: &str =
    "geometry_msgs/Transform\ngeometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation";
const TRANSFORM_STAMPED: &str = "geometry_msgs/TransformStamped\nstd_msgs/Header header\nstring child_frame_id\n\
    geometry_msgs/Transform transform";
const STATUS: &str = "diagnostic_msgs/DiagnosticStatus\nbyte OK=0\nbyte WARN=1\nbyte ERROR=2\nbyte STALE=3\nbyte level\n\
    string name\nstring message\nstring hardware_id\ndiagnostic_msgs/KeyValue[] values";
const KEY_VALUE: &str = "diagnostic_msgs/KeyValue\nstring key\nstring value";

impl MessageKind {
    /// Its name in ROS 2.
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Float64 => "std_msgs/msg/Float64",
            Self::Imu => "sensor_msgs/msg/Imu",
            Self::FluidPressure => "sensor_msgs/msg/FluidPressure",
            Self::JointState => "sensor_msgs/msg/JointState",
            Self::Pose => "geometry_msgs/msg/PoseStamped",
            Self::Wrench => "geometry_msgs/msg/WrenchStamped",
            Self::Transforms => "tf2_msgs/msg/TFMessage",
            Self::Diagnostics => "diagnostic_msgs/msg/DiagnosticArray",
        }
    }

    /// Its definition with those of the messages in it.
    pub(super) fn definition(self) -> String {
        let (own, others): (&str, &[&str]) = match self {
            Self::Float64 => ("float64 data", &[]),
            Self::Imu => (
                "std_msgs/Header header\ngeometry_msgs/Quaternion orientation\nfloat64[9] orientation_covariance\n\
                 geometry_msgs/Vector3 angular_velocity\nfloat64[9] angular_velocity_covariance\n\
                 geometry_msgs/Vector3 linear_acceleration\nfloat64[9] linear_acceleration_covariance",
                &[HEADER, TIME, QUATERNION, VECTOR],
            ),
            Self::FluidPressure => (
                "std_msgs/Header header\nfloat64 fluid_pressure\nfloat64 variance",
                &[HEADER, TIME],
            ),
            Self::JointState => (
                "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort",
                &[HEADER, TIME],
            ),
            Self::Pose => (
                "std_msgs/Header header\ngeometry_msgs/Pose pose",
                &[HEADER, TIME, POSE, POINT, QUATERNION],
            ),
            Self::Wrench => (
                "std_msgs/Header header\ngeometry_msgs/Wrench wrench",
                &[HEADER, TIME, WRENCH, VECTOR],
            ),
            Self::Transforms => (
                "geometry_msgs/TransformStamped[] transforms",
                &[
                    TRANSFORM_STAMPED,
                    HEADER,
                    TIME,
                    TRANSFORM,
                    VECTOR,
                    QUATERNION,
                ],
            ),
            Self::Diagnostics => (
                "std_msgs/Header header\ndiagnostic_msgs/DiagnosticStatus[] status",
                &[HEADER, TIME, STATUS, KEY_VALUE],
            ),
        };
        let line = "=".repeat(80);
        let others = others.iter().map(|text| format!("{line}\nMSG: {text}\n"));
        std::iter::once(format!("{own}\n")).chain(others).collect()
    }
}

/// A line of the diagnostics.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Status {
    /// 0 is right, 1 a warning, 2 an error.
    pub(super) level: u8,
    pub(super) name: String,
    pub(super) message: String,
}

fn header(w: &mut CdrWriter, stamp: Stamp, frame: &str) {
    // Times that a bag has no numbers for were refused before.
    w.i32(stamp.0.div_euclid(1_000_000_000) as i32);
    w.u32(stamp.0.rem_euclid(1_000_000_000) as u32);
    w.text(frame);
}

fn pose(w: &mut CdrWriter, pose: &Pose) {
    w.f64s(pose.translation.vector.as_slice());
    w.f64s(pose.rotation.coords.as_slice());
}

pub(super) fn float64(value: f64) -> Vec<u8> {
    let mut w = CdrWriter::new();
    w.f64(value);
    w.finish()
}

/// An orientation alone; nothing is known of its covariance.
pub(super) fn imu_orientation(stamp: Stamp, frame: &str, of: &Pose) -> Vec<u8> {
    let mut w = CdrWriter::new();
    header(&mut w, stamp, frame);
    w.f64s(of.rotation.coords.as_slice());
    w.f64s(&[0.0; 9]);
    for _ in 0..2 {
        w.f64s(&[0.0; 3]);
        w.f64(NOT_MEASURED);
        w.f64s(&[0.0; 8]);
    }
    w.finish()
}

/// Rates and specific forces alone, in the axes of the IMU.
pub(super) fn imu_raw(stamp: Stamp, frame: &str, raw: &ImuRaw) -> Vec<u8> {
    let mut w = CdrWriter::new();
    header(&mut w, stamp, frame);
    w.f64s(&[0.0, 0.0, 0.0, 1.0]);
    w.f64(NOT_MEASURED);
    w.f64s(&[0.0; 8]);
    for values in [&raw.gyro_rad_s, &raw.accel_m_s2] {
        w.f64s(values);
        w.f64s(&[0.0; 9]);
    }
    w.finish()
}

pub(super) fn fluid_pressure(stamp: Stamp, frame: &str, pressure_pa: f64) -> Vec<u8> {
    let mut w = CdrWriter::new();
    header(&mut w, stamp, frame);
    w.f64s(&[pressure_pa, 0.0]);
    w.finish()
}

/// Positions with their names.
pub(super) fn joint_state(stamp: Stamp, joints: &[(String, f64)]) -> Vec<u8> {
    let mut w = CdrWriter::new();
    header(&mut w, stamp, "");
    w.length(joints.len());
    joints.iter().for_each(|(name, _)| w.text(name));
    w.length(joints.len());
    joints.iter().for_each(|(_, position)| w.f64(*position));
    w.length(0);
    w.length(0);
    w.finish()
}

pub(super) fn pose_stamped(stamp: Stamp, frame: &str, of: &Pose) -> Vec<u8> {
    let mut w = CdrWriter::new();
    header(&mut w, stamp, frame);
    pose(&mut w, of);
    w.finish()
}

/// A force, N, at the origin of a frame.
pub(super) fn force(stamp: Stamp, frame: &str, force_n: [f64; 3]) -> Vec<u8> {
    let mut w = CdrWriter::new();
    header(&mut w, stamp, frame);
    w.f64s(&force_n);
    w.f64s(&[0.0; 3]);
    w.finish()
}

/// Transforms of frames in the base frame.
pub(super) fn transforms(stamp: Stamp, base: &str, of: &[(&str, Pose)]) -> Vec<u8> {
    let mut w = CdrWriter::new();
    w.length(of.len());
    for (frame, base_from_frame) in of {
        header(&mut w, stamp, base);
        w.text(frame);
        pose(&mut w, base_from_frame);
    }
    w.finish()
}

pub(super) fn diagnostics(stamp: Stamp, hardware: &str, status: &[Status]) -> Vec<u8> {
    let mut w = CdrWriter::new();
    header(&mut w, stamp, "");
    w.length(status.len());
    for line in status {
        w.u8(line.level);
        w.text(&line.name);
        w.text(&line.message);
        w.text(hardware);
        w.length(0);
    }
    w.finish()
}
