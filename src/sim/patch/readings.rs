//! Calibration parameters of readings and motion as effects of the table.

use super::parameters::{CalibrationParameter, calibration_parameters};
use crate::robot::RobotSpec;
use crate::signal::{CHAMBERS, IMUS, SPRINGS};
use crate::sim::effects::{self, Active};

/// Calibration parameters of the readings, as effects; `values` are in the order of [`calibration_parameters`].
pub fn readings(robot: &RobotSpec, values: &[f64]) -> Vec<Active> {
    let mut offset_m = [0.0; SPRINGS];
    let mut gain = [0.0; SPRINGS];
    let mut mounting = [[0.0; 3]; IMUS];
    let mut drift_rad_s = [0.0; IMUS];
    let mut frame = vec![0.0; 6];
    let mut clock_s = 0.0;
    let mut lag_s: f64 = 0.0;
    for (parameter, &v) in calibration_parameters().iter().zip(values) {
        match *parameter {
            CalibrationParameter::SpringOffset(i) => offset_m[i] = v,
            CalibrationParameter::SpringGain(i) => gain[i] = v,
            CalibrationParameter::Mounting(i, a) => mounting[i][a] = v,
            CalibrationParameter::Drift(i) => drift_rad_s[i] = v,
            CalibrationParameter::Frame(k) => frame[k] = v,
            CalibrationParameter::Clock => clock_s = v,
            CalibrationParameter::SpringLag => lag_s = v.max(parameter.least()),
            _ => {}
        }
    }
    let springs = (0..SPRINGS).map(|i| {
        // y = l + o + γ (l − l₀)
        let shift_m = offset_m[i] - gain[i] * robot.rest_length_m;
        ("spring-calibration", Some(i), vec![1.0 + gain[i], shift_m])
    });
    let imus = (0..IMUS).map(|i| ("imu-misalignment", Some(i), mounting[i].to_vec()));
    let drifts = (0..IMUS).map(|i| ("imu-drift", Some(i), vec![drift_rad_s[i]]));
    springs
        .chain(imus)
        .chain(drifts)
        .chain([
            ("spring-lag", None, vec![lag_s]),
            ("clock-offset", None, vec![clock_s]),
            ("mocap-frame", None, frame.clone()),
        ])
        .filter_map(|(id, target, values)| unbounded(id, target, values))
        .collect()
}

/// Calibration parameters of motion that need a history, as effects; `values` as in [`readings`].
pub fn motions(values: &[f64]) -> Vec<Active> {
    let value = |wanted: CalibrationParameter| {
        let found = calibration_parameters()
            .into_iter()
            .zip(values)
            .find(|(k, _)| *k == wanted);
        found.map_or(0.0, |(k, v)| v.max(k.least()))
    };
    let friction = |i: usize| {
        let both = vec![
            value(CalibrationParameter::Friction(i)),
            value(CalibrationParameter::FrictionTravel),
        ];
        ("hysteresis", Some(i), both)
    };
    let creep = vec![
        value(CalibrationParameter::Creep),
        value(CalibrationParameter::CreepTime),
    ];
    (0..CHAMBERS)
        .map(friction)
        .chain([
            (
                "damping",
                None,
                vec![value(CalibrationParameter::Damping), 1.0],
            ),
            ("creep", None, creep),
            (
                "pressure-lag",
                None,
                vec![value(CalibrationParameter::Lag), 0.0],
            ),
        ])
        .filter_map(|(id, target, values)| unbounded(id, target, values))
        .collect()
}

/// The effect `id` on channel `target` (0-based; `None`: every one) with values that are corrections of healthy things: the
/// bounds of faults do not bind them. `None` if there is no such effect.
pub fn unbounded(id: &str, target: Option<usize>, values: Vec<f64>) -> Option<Active> {
    effects::effect(id).map(|effect| Active {
        effect,
        target,
        values,
    })
}
