//! Columns of poses and sensor signals in tables of results.

use crate::signal::{IMUS, Pose, SPRINGS, SensorVec, ypr_from_rotation};

/// Columns of a pose of the end pad: x, y, z, then yaw, pitch, roll.
pub fn pose_names() -> [String; 6] {
    ["x_mm", "y_mm", "z_mm", "yaw_deg", "pitch_deg", "roll_deg"].map(str::to_owned)
}

/// Values of [`pose_names`]: mm, then degrees.
pub fn pose_values(pose: &Pose) -> [f64; 6] {
    let p = pose.translation.vector * 1e3;
    let [yaw, pitch, roll] = ypr_from_rotation(&pose.rotation).map(f64::to_degrees);
    [p.x, p.y, p.z, yaw, pitch, roll]
}

/// Columns of the 24 sensor signals, as a session log names them, in the order of the signals.
pub fn sensor_names() -> Vec<String> {
    let springs = (1..=SPRINGS).map(|i| format!("spring{i}_mm"));
    let imus = (1..=IMUS)
        .flat_map(|i| ["yaw", "pitch", "roll"].map(|angle| format!("imu{i}_{angle}_deg")));
    springs.chain(imus).collect()
}

/// See [`sensor_names`].
pub fn sensor_values(sensors: &SensorVec) -> Vec<f64> {
    let springs = sensors.spring_m.iter().map(|l| l * 1e3);
    let angles = sensors.imu_ypr_rad.as_flattened().iter();
    springs.chain(angles.map(|a| a.to_degrees())).collect()
}
