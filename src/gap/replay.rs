//! Replay of a session through the model: predictions, residuals and the arm-to-arm scatter of the parameters.

use nalgebra::{UnitQuaternion, Vector3};

use super::session::{CHANNELS, Grid, IMU_0, SPRING_0, within};
use crate::robot::RobotSpec;
use crate::signal::{CHAMBERS, IMUS, Pose, SPRINGS, pose_error};
use crate::sim::Model;
use crate::sim::effects::{self, Active, EffectError, Simulated};
pub use crate::sim::patch::{
    CalibrationParameter, calibration_parameters, nominal, parameters, readings,
};
use crate::sim::patch::{Correction, motions};

impl CalibrationParameter {
    /// Standard deviation of the parameter among well-made arms, in its unit.
    pub fn prior(self) -> f64 {
        match self {
            Self::Stiffness(_) | Self::Area(_) => 0.03,
            Self::RestLength(_) => 0.01,
            Self::Hardening => 0.2,
            Self::Bending(_) => 0.2,
            Self::Torsion(_) => 0.3,
            Self::Gripper => 0.05,
            Self::Tilt(_) => 0.01,
            Self::Damping => 0.05,
            Self::Friction(_) => 2.0,
            Self::FrictionTravel => 3e-3,
            Self::Creep => 0.05,
            Self::CreepTime => 3.0,
            Self::Lag => 0.02,
            // What a gyroscope's zero leaves after it was taken at rest, 0.05 deg/s.
            Self::Drift(_) => 1e-3,
            Self::SpringOffset(_) => 2e-3,
            Self::SpringGain(_) | Self::SpringLag => 0.02,
            Self::Mounting(..) => 0.02,
            Self::Frame(k) | Self::Body(k) if k < 3 => 10e-3,
            Self::Frame(_) | Self::Body(_) => 0.01,
            Self::SpringEnds(_) => 10e-3,
            Self::Clock => 0.03,
        }
    }
}

/// Whether a parameter restarts in every session: a gyroscope's zero is taken whenever its board starts.
pub fn is_of_session(k: CalibrationParameter) -> bool {
    matches!(k, CalibrationParameter::Drift(_))
}

/// The tracked body in the end pad's frame.
pub(super) fn pad_from_body(values: &[f64]) -> Pose {
    let mut b = [0.0; 6];
    for (parameter, &v) in calibration_parameters().iter().zip(values) {
        if let CalibrationParameter::Body(k) = *parameter {
            b[k] = v;
        }
    }
    Pose::from_parts(
        Vector3::new(b[0], b[1], b[2]).into(),
        UnitQuaternion::from_scaled_axis(Vector3::new(b[3], b[4], b[5])),
    )
}

/// One row of residuals in the order and units of [`CHANNELS`], measured − predicted; NaN where nothing was measured.
pub type Row = [f64; CHANNELS];

/// Moves the arm of these calibration parameters (`values`, in their order), with `effects`, through the grid's measured
/// pressures. Both act on top of the robot's own patches.
///
/// # Errors
/// [`EffectError::Sim`] when the arm finds no equilibrium.
pub fn move_arm(
    robot: &RobotSpec,
    grid: &Grid,
    values: &[f64],
    effects: &[Active],
) -> Result<Simulated, EffectError> {
    let (model, acting) = corrected(robot, values, effects);
    let mut effects = acting.effects;
    let fine = &grid.session.t_s;
    let chamber_pa = grid.binned(&effects::behind_gauges(
        robot,
        fine,
        &grid.gauge_pa,
        &effects,
    ));
    effects.retain(is_mechanical);
    effects::arm_only(&model, &grid.t_s, &chamber_pa, &grid.payload_kg(), &effects)
}

/// The arm of a robot with calibration parameters and effects on top of its patches, and all that acts in it.
fn corrected(robot: &RobotSpec, values: &[f64], effects: &[Active]) -> (Model, Correction) {
    let mut all = Correction::known(robot).and(values, effects);
    all.effects.extend(motions(&all.values));
    (crate::sim::patch::model(robot, &all.values), all)
}

/// Moves the arm of these calibration parameters (`values`, in their order) through measured gauge pressures, Pa, at
/// every one of the instants, s, with the declared payloads, kg. The end pad's captured pose is that of its tracked body.
///
/// # Errors
/// As [`move_arm`].
pub fn follow_pressures(
    robot: &RobotSpec,
    values: &[f64],
    (t_s, gauge_pa): (&[f64], &[[f64; CHAMBERS]]),
    payload_kg: &[f64],
) -> Result<Simulated, EffectError> {
    let (model, mut acting) = corrected(robot, values, &[]);
    let chamber_pa = effects::behind_gauges(robot, t_s, gauge_pa, &acting.effects);
    acting.effects.retain(is_mechanical);
    let mut moved = effects::arm_only(&model, t_s, &chamber_pa, payload_kg, &acting.effects)?;
    let pad_from_body = pad_from_body(&acting.values);
    for [_, end] in &mut moved.captured {
        *end *= pad_from_body;
    }
    Ok(moved)
}

/// Whether an effect acts on the arm itself.
pub fn is_mechanical(a: &Active) -> bool {
    matches!(a.effect.operator, effects::Operator::Mechanics(_)) || a.effect.also_moves.is_some()
}

/// The grid simulated on an arm with these calibration parameters and effects, without noise.
///
/// # Errors
/// As [`move_arm`].
pub fn simulated_grid(
    robot: &RobotSpec,
    grid: &Grid,
    values: &[f64],
    effects: &[Active],
) -> Result<Grid, EffectError> {
    let moved = move_arm(robot, grid, values, effects)?;
    let read = predicted(robot, grid, &moved, values, effects);
    let pad_from_body = pad_from_body(&Correction::known(robot).and(values, &[]).values);
    Ok(Grid {
        captured: read
            .captured
            .iter()
            .map(|pads| Some(pads[1] * pad_from_body))
            .collect(),
        sensors: read.sensors,
        ..grid.clone()
    })
}

/// Predicted readings of sensors and motion capture for a motion, without noise: the two pads' poses and the 24
/// signals at every bin, with calibration parameters and `effects` on top of the robot's own patches.
pub fn predicted(
    robot: &RobotSpec,
    grid: &Grid,
    moved: &Simulated,
    values: &[f64],
    effects: &[Active],
) -> Simulated {
    let Correction { values, effects } = Correction::known(robot).and(values, effects);
    let mut read = moved.clone();
    let mut acting = readings(robot, &values);
    acting.extend(effects);
    effects::read(robot, &grid.t_s, &mut read, &acting);
    read
}

/// Residuals of a motion, measured − predicted, with calibration parameters and `effects` on top of the
/// robot's own patches.
pub fn residuals(
    robot: &RobotSpec,
    grid: &Grid,
    moved: &Simulated,
    values: &[f64],
    effects: &[Active],
) -> Vec<Row> {
    let read = predicted(robot, grid, moved, values, effects);
    let values = &Correction::known(robot).and(values, &[]).values[..];
    let pad_from_body = pad_from_body(values);
    (0..grid.len())
        .map(|k| {
            let mut row = [f64::NAN; CHANNELS];
            if within(&grid.holes_s, grid.t_s[k]) {
                return row;
            }
            if let Some(truth) = &grid.captured[k] {
                let e = pose_error(truth, &(read.captured[k][1] * pad_from_body));
                row[..6].copy_from_slice(e.as_slice());
            }
            let (measured, predicted) = (&grid.sensors[k], &read.sensors[k]);
            for i in 0..SPRINGS {
                row[SPRING_0 + i] = measured.spring_m[i] - predicted.spring_m[i];
            }
            for i in 0..IMUS {
                // An IMU without readings has no error; the rotation of values that are not finite would be none.
                if measured.imu_ypr_rad[i].iter().any(|a| !a.is_finite()) {
                    continue;
                }
                let turn = predicted.base_from_imu_pad(i).inverse() * measured.base_from_imu_pad(i);
                let w = UnitQuaternion::from(turn).scaled_axis();
                row[IMU_0 + 3 * i..IMU_0 + 3 * i + 3].copy_from_slice(w.as_slice());
            }
            row
        })
        .collect()
}

/// Predicted poses of the tracked body on the end pad in the frame of the motion capture, with the parameters' frame, clock
/// and body; the captured poses are compared with them.
pub fn captured_poses(
    robot: &RobotSpec,
    grid: &Grid,
    moved: &Simulated,
    values: &[f64],
    effects: &[Active],
) -> Vec<Pose> {
    let read = predicted(robot, grid, moved, values, effects);
    let pad_from_body = pad_from_body(&Correction::known(robot).and(values, &[]).values);
    let captured = read.captured.iter();
    captured.map(|pads| pads[1] * pad_from_body).collect()
}
