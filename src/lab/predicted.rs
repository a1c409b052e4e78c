//! Recordings of an arm without springs or IMUs: where its model has it at the measured pressures.

use std::sync::Arc;

use nalgebra::Matrix6xX;

use crate::gap::{follow_pressures, nominal, uncertain_parameters};
use crate::robot::RobotSpec;
use crate::sensing::shape_by_pads;
use crate::signal::{CHAMBERS, Estimate, Matrix6, Snapshot, Trace, Vector6, pose_error};
use crate::sim::effects::{EffectError, Simulated};

/// Step of a derivative, as a share of a parameter's standard deviation.
const STEP: f64 = 0.1;
/// Instants at which the uncertainty is computed; between them that of the nearest holds.
const POSTURES: usize = 30;

/// Completes the snapshots of an arm that nothing estimates: pose and shape by the model, with the robot's patches, at the measured
/// pressures and declared payloads. The standard deviation of a pose is what the numbers of the robot file leave uncertain, and how
/// well the arm repeats a rest; once a patch has fitted those numbers, what the healthy sessions of that patch left. Snapshots
/// without pressures, those that have an estimate, and arms with springs and IMUs stay as they are.
///
/// # Errors
/// [`EffectError`] when the arm finds no equilibrium under these pressures.
pub fn complete(robot: &RobotSpec, trace: &mut Trace) -> Result<(), EffectError> {
    if robot.lacks().is_none() {
        return Ok(());
    }
    let open: Vec<&mut Snapshot> = trace.snapshots.iter_mut().filter(|s| is_open(s)).collect();
    let pressures =
        |s: &&mut Snapshot| s.sensors.as_ref().map_or([0.0; CHAMBERS], |f| f.chamber_pa);
    let t_s: Vec<f64> = open.iter().map(|s| s.stamp.seconds()).collect();
    let gauge_pa: Vec<_> = open.iter().map(pressures).collect();
    let payload_kg: Vec<f64> = open.iter().map(|s| s.payload_kg).collect();
    if t_s.is_empty() {
        return Ok(());
    }
    let moved = follow_pressures(robot, &nominal(), (&t_s, &gauge_pa), &payload_kg)?;
    let every = t_s.len().div_ceil(POSTURES);
    let times: Vec<f64> = t_s.iter().step_by(every).copied().collect();
    let pressures: Vec<_> = gauge_pa.iter().step_by(every).copied().collect();
    let payloads: Vec<f64> = payload_kg.iter().step_by(every).copied().collect();
    let covariances = covariances(robot, (&times, &pressures), &payloads)?;
    for (k, snapshot) in open.into_iter().enumerate() {
        let [_, middle, end] = moved.base_from_pad[k];
        snapshot.shape = Some(Arc::new(shape_by_pads(robot, [middle, end])));
        snapshot.estimate = Some(Estimate {
            stamp: snapshot.stamp,
            base_from_tip: moved.captured[k][1],
            covariance: covariances[((k + every / 2) / every).min(covariances.len() - 1)],
            training_distance: 0.0,
        });
    }
    Ok(())
}

/// Whether the model may say where the arm was.
fn is_open(s: &Snapshot) -> bool {
    let known = |pa: &[f64; CHAMBERS]| pa.iter().all(|p| p.is_finite());
    let has_pressures = s.sensors.as_ref().is_some_and(|f| known(&f.chamber_pa));
    has_pressures && s.estimate.is_none() && s.shown_shape().is_none()
}

/// Covariance of the end pad's pose at every instant.
fn covariances(
    robot: &RobotSpec,
    course: (&[f64], &[[f64; CHAMBERS]]),
    payload_kg: &[f64],
) -> Result<Vec<Matrix6>, EffectError> {
    let each = |m: f64, rad: f64| {
        let variance = |i: usize| if i < 3 { m * m / 3.0 } else { rad * rad / 3.0 };
        Matrix6::from_diagonal(&Vector6::from_fn(|i, _| variance(i)))
    };
    let u = &robot.uncertainty;
    let floors = robot.patches.iter().rev().map(|a| &a.patch.floor);
    let left = |key: &str| floors.clone().find_map(|f| f.get(key)).copied();
    if !robot.patches.is_empty() {
        let m = left("position_m").unwrap_or(u.repeat_m);
        let rad = left("rotation_rad").unwrap_or(u.repeat_rad);
        return Ok(vec![each(m, rad); course.0.len()]);
    }
    let values = nominal();
    let as_drawn = follow_pressures(robot, &values, course, payload_kg)?;
    let mut columns: Vec<Vec<Vector6>> = vec![Vec::new(); course.0.len()];
    for (i, sd) in uncertain_parameters(robot) {
        let mut changed = values.clone();
        changed[i] += STEP * sd;
        let moved = follow_pressures(robot, &changed, course, payload_kg)?;
        let end = |s: &Simulated, k: usize| s.captured[k][1];
        for (k, columns) in columns.iter_mut().enumerate() {
            columns.push(pose_error(&end(&moved, k), &end(&as_drawn, k)) / STEP);
        }
    }
    let repeats = each(u.repeat_m, u.repeat_rad);
    let of = |columns: Vec<Vector6>| {
        let j = Matrix6xX::from_columns(&columns);
        repeats + &j * j.transpose()
    };
    Ok(columns.into_iter().map(of).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::REFERENCE;
    use crate::signal::{Health, Quality, SIGNALS, SensorFrame, SensorVec, Stamp};
    use crate::sim::{Inputs, Model, State, observe, settle};

    /// The reference arm without its springs.
    fn bare() -> RobotSpec {
        let robot = RobotSpec::from_toml(REFERENCE).expect("the reference");
        RobotSpec {
            has_springs: false,
            has_imus: false,
            ..robot
        }
    }

    fn trace() -> Trace {
        let snapshot = |k: usize| Snapshot {
            stamp: Stamp::from_seconds(0.5 * k as f64),
            sensors: Some(SensorFrame {
                stamp: Stamp::from_seconds(0.5 * k as f64),
                extra_sigma: [0.0; SIGNALS],
                delivered: Default::default(),
                sensors: SensorVec {
                    spring_m: [0.0; 12],
                    imu_ypr_rad: [[0.0; 3]; 4],
                },
                chamber_pa: [300.0 * k as f64, 0.0, 0.0, 0.0, -200.0 * k as f64, 0.0],
                health: Health::default(),
                quality: Quality::default(),
            }),
            payload_kg: 0.1,
            ..Snapshot::default()
        };
        Trace {
            snapshots: (0..100).map(snapshot).collect(),
            ..Trace::default()
        }
    }

    #[test]
    fn an_arm_without_sensors_is_where_its_model_has_it_and_as_uncertain_as_its_file() {
        let (robot, mut trace) = (bare(), trace());
        trace.snapshots[7].sensors = None;
        complete(&robot, &mut trace).expect("stands");
        assert!(trace.snapshots[7].estimate.is_none() && trace.snapshots[7].shape.is_none());
        for k in [0, 50, 99] {
            let s = &trace.snapshots[k];
            let model = Model::nominal(&robot);
            let mut state = State::rest(&model);
            let inputs = Inputs {
                chamber_pa: s.sensors.as_ref().expect("sensors").chamber_pa,
                payload_kg: 0.1,
                ..Inputs::default()
            };
            settle(&model, &mut state, &inputs).expect("settles");
            let end = observe(&model, &state).shape.base_from_pad[2];
            let estimate = s.estimate.as_ref().expect("an estimate");
            // What friction and rubber remember of the way there is not in a settled arm.
            let off = pose_error(&estimate.base_from_tip, &end);
            assert!(off.norm() < 1e-3, "{off}");
            let shape = s.shape.as_ref().expect("a shape");
            let off = pose_error(&estimate.base_from_tip, &shape.base_from_pad[2]);
            assert!(off.norm() < 1e-12, "{off}");
            assert_eq!(shape.spring_ends_m[3], [[0.0; 3]; 2]);
            // An arm by its drawing: some millimetres, and no less than it repeats.
            let sd_m = estimate.covariance[(0, 0)].sqrt();
            assert!(
                (robot.uncertainty.repeat_m / 3_f64.sqrt()..0.03).contains(&sd_m),
                "{sd_m}"
            );
        }
        let sd = |k: usize| {
            trace.snapshots[k]
                .estimate
                .as_ref()
                .expect("one")
                .covariance[(0, 0)]
        };
        assert!(sd(99) > sd(0), "bent, its stiffness matters more");
    }

    #[test]
    fn an_arm_with_sensors_is_left_alone() {
        let mut trace = trace();
        complete(&RobotSpec::reference(), &mut trace).expect("nothing to do");
        assert!(
            trace
                .snapshots
                .iter()
                .all(|s| s.estimate.is_none() && s.shape.is_none())
        );
    }
}
