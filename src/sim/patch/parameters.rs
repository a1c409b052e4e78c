//! The departures of one rig from the robot that it was made for.

use super::acts::Acts;
use crate::robot::RobotSpec;
use crate::signal::{CHAMBERS, IMUS, SPRINGS};
use crate::sim::Parameters;

/// One number that differs from arm to arm and from mounting to mounting: a nuisance parameter. Chambers, springs, IMUs,
/// segments and axes are 0-based.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum CalibrationParameter {
    /// Axial stiffness of a bellows, as a factor less one.
    Stiffness(usize),
    /// Effective area of a chamber, as a factor less one.
    Area(usize),
    /// Rest length of a bellows, as a factor less one.
    RestLength(usize),
    /// Cubic hardening of all bellows.
    Hardening,
    /// Bending stiffness of a segment, as a factor less one.
    Bending(usize),
    /// Torsional stiffness of a segment, as a factor less one.
    Torsion(usize),
    /// Mass of the gripper, as a factor less one.
    Gripper,
    /// Tilt of the base about x, y, rad.
    Tilt(usize),
    /// Time constant of the arm's own damping, s.
    Damping,
    /// Dry friction of a bellows, N.
    Friction(usize),
    /// Travel over which it builds up, m.
    FrictionTravel,
    /// Share of every bellows' rate that creeps.
    Creep,
    /// How long that takes, s.
    CreepTime,
    /// Lag of the chambers behind their gauges, s.
    Lag,
    /// Drift of an IMU's heading, rad/s.
    Drift(usize),
    /// Offset of a spring, m.
    SpringOffset(usize),
    /// Gain of a spring about its rest length, less one.
    SpringGain(usize),
    /// Lag of the springs' readings behind their lengths, s: a reading is counted over a gate.
    SpringLag,
    /// Turn of an IMU on its pad (IMU, axis), rad.
    Mounting(usize, usize),
    /// Motion-capture frame against the base frame: x, y, z (m), rotation vector (rad).
    Frame(usize),
    /// Clock of the motion capture, s.
    Clock,
    /// The tracked body on the end pad against the pad itself: x, y, z (m), rotation vector (rad).
    Body(usize),
    /// Height at which a segment's springs are fixed to both of its pads, m.
    SpringEnds(usize),
}

impl CalibrationParameter {
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
            Self::Friction(i) => format!("chamber-{}-friction", i + 1),
            Self::FrictionTravel => "friction-travel".to_owned(),
            Self::Creep => "creep".to_owned(),
            Self::CreepTime => "creep-time".to_owned(),
            Self::Lag => "pressure-lag".to_owned(),
            Self::Drift(i) => format!("imu-{}-drift", i + 1),
            Self::SpringLag => "spring-lag".to_owned(),
            Self::SpringOffset(i) => format!("spring-{}-offset", i + 1),
            Self::SpringGain(i) => format!("spring-{}-gain", i + 1),
            Self::Mounting(i, a) => format!("imu-{}-{}", i + 1, ["x", "y", "z"][a]),
            Self::Frame(k) => format!("mocap-{}", ["x", "y", "z", "rx", "ry", "rz"][k]),
            Self::Clock => "mocap-clock".to_owned(),
            Self::Body(k) => format!("tracked-body-{}", ["x", "y", "z", "rx", "ry", "rz"][k]),
            Self::SpringEnds(s) => format!("segment-{}-spring-ends", s + 1),
        }
    }

    /// Whether it changes the motion of the arm, not only what is read.
    pub fn is_mechanical(self) -> bool {
        let moving = matches!(
            self,
            Self::Damping | Self::Friction(_) | Self::FrictionTravel | Self::Lag
        );
        let moving = moving || matches!(self, Self::Creep | Self::CreepTime);
        moving || self.acts() == Acts::Arm
    }

    /// Where it acts.
    pub fn acts(self) -> Acts {
        match self {
            Self::SpringOffset(_) | Self::SpringGain(_) | Self::Mounting(..) => Acts::Sensors,
            Self::Frame(_) | Self::Clock | Self::Body(_) | Self::Drift(_) => Acts::Replay,
            Self::SpringLag => Acts::Replay,
            Self::Damping | Self::Friction(_) | Self::FrictionTravel => Acts::Replay,
            Self::Creep | Self::CreepTime | Self::Lag => Acts::Replay,
            _ => Acts::Arm,
        }
    }

    /// Value of the nominal arm.
    pub fn nominal(self) -> f64 {
        match self {
            Self::Damping => 0.05,
            Self::FrictionTravel => 6e-3,
            Self::CreepTime => 5.0,
            _ => 0.0,
        }
    }

    /// The smallest value that an arm can have.
    pub fn least(self) -> f64 {
        match self {
            Self::Stiffness(_)
            | Self::Area(_)
            | Self::RestLength(_)
            | Self::Bending(_)
            | Self::Torsion(_)
            | Self::SpringGain(_) => -0.9,
            Self::Gripper => -1.0,
            Self::Damping | Self::Friction(_) | Self::Creep | Self::Lag | Self::SpringLag => 0.0,
            Self::FrictionTravel => 1e-3,
            Self::CreepTime => 0.8,
            _ => f64::MIN,
        }
    }
}

/// All calibration parameters, in the order of the vectors that hold their values.
pub fn calibration_parameters() -> Vec<CalibrationParameter> {
    let mut out = Vec::new();
    out.extend((0..CHAMBERS).map(CalibrationParameter::Stiffness));
    out.extend((0..CHAMBERS).map(CalibrationParameter::Area));
    out.extend((0..CHAMBERS).map(CalibrationParameter::RestLength));
    out.push(CalibrationParameter::Hardening);
    out.extend((0..2).map(CalibrationParameter::Bending));
    out.extend((0..2).map(CalibrationParameter::Torsion));
    out.push(CalibrationParameter::Gripper);
    out.extend((0..2).map(CalibrationParameter::Tilt));
    out.push(CalibrationParameter::Damping);
    out.extend((0..CHAMBERS).map(CalibrationParameter::Friction));
    out.extend([
        CalibrationParameter::FrictionTravel,
        CalibrationParameter::Creep,
        CalibrationParameter::CreepTime,
    ]);
    out.push(CalibrationParameter::Lag);
    out.extend((0..SPRINGS).map(CalibrationParameter::SpringOffset));
    out.extend((0..SPRINGS).map(CalibrationParameter::SpringGain));
    out.push(CalibrationParameter::SpringLag);
    for i in 0..IMUS {
        out.extend((0..3).map(|a| CalibrationParameter::Mounting(i, a)));
    }
    out.extend((0..IMUS).map(CalibrationParameter::Drift));
    out.extend((0..6).map(CalibrationParameter::Frame));
    out.push(CalibrationParameter::Clock);
    out.extend((0..6).map(CalibrationParameter::Body));
    out.extend((0..2).map(CalibrationParameter::SpringEnds));
    out
}

/// Nominal values of all calibration parameters, in the order of [`calibration_parameters`].
pub fn nominal() -> Vec<f64> {
    calibration_parameters()
        .into_iter()
        .map(CalibrationParameter::nominal)
        .collect()
}

/// The model's parameters at these values of the calibration parameters, in the order of [`calibration_parameters`].
pub fn parameters(values: &[f64]) -> Parameters {
    shifted(&Parameters::default(), values)
}

pub(super) fn shifted(parameters: &Parameters, values: &[f64]) -> Parameters {
    let mut p = parameters.clone();
    for (parameter, &v) in calibration_parameters().iter().zip(values) {
        match *parameter {
            CalibrationParameter::Stiffness(i) => p.chamber_stiffness[i] += v,
            CalibrationParameter::Area(i) => p.chamber_area[i] += v,
            CalibrationParameter::RestLength(i) => p.rest_length[i] += v,
            CalibrationParameter::Hardening => p.hardening += v,
            CalibrationParameter::Bending(s) => p.bending[s] += v,
            CalibrationParameter::Torsion(s) => p.torsion[s] += v,
            CalibrationParameter::Gripper => p.gripper_mass += v,
            CalibrationParameter::Tilt(a) => p.base_tilt_rad[a] += v,
            _ => {}
        }
    }
    p
}

/// The robot with its springs fixed where these calibration parameters have them.
pub(super) fn geometry(robot: &RobotSpec, values: &[f64]) -> RobotSpec {
    let mut robot = robot.clone();
    for (parameter, &v) in calibration_parameters().iter().zip(values) {
        if let CalibrationParameter::SpringEnds(s) = *parameter {
            let (top_m, bottom_m) = (&mut robot.spring_top_m, &mut robot.spring_bottom_m);
            for i in 6 * s..6 * s + 6 {
                top_m[i].z += v;
                bottom_m[i].z += v;
            }
        }
    }
    robot
}
