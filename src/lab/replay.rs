//! A session replayed: the simulation at every sample, and its residuals.

use super::columns::{pose_names, pose_values, sensor_names, sensor_values};
use crate::gap::{self, Grid, Row};
use crate::recording::Table;
use crate::robot::RobotSpec;
use crate::signal::{IMUS, SPRINGS};
use crate::sim::effects::Simulated;

/// Simulated poses and sensors at every sample, and the residuals against the measured ones; empty where nothing was
/// measured. `values` are those of the calibration parameters, in their order.
pub fn table(
    robot: &RobotSpec,
    grid: &Grid,
    moved: &Simulated,
    values: &[f64],
    residuals: &[Row],
) -> Table {
    let poses = gap::captured_poses(robot, grid, moved, values, &[]);
    let sensors = gap::predicted(robot, grid, moved, values, &[]).sensors;
    let names = pose_names().into_iter().chain(sensor_names());
    let turn = |what: &str| ["x", "y", "z"].map(|axis| format!("{what}_residual_r{axis}_deg"));
    let mut all = vec!["t_s".to_owned()];
    all.extend(names);
    all.extend(["x", "y", "z"].map(|axis| format!("tip_residual_{axis}_mm")));
    all.extend(turn("tip"));
    all.extend((1..=SPRINGS).map(|i| format!("spring{i}_residual_mm")));
    all.extend((1..=IMUS).flat_map(|i| turn(&format!("imu{i}"))));
    let mut table = Table::new(all);
    for (k, t_s) in grid.t_s.iter().enumerate() {
        let mut row = vec![*t_s];
        row.extend(pose_values(&poses[k]));
        row.extend(sensor_values(&sensors[k]));
        let residual = residuals[k].iter().enumerate();
        row.extend(residual.map(|(c, v)| match c {
            0..3 => v * 1e3,
            c if (gap::SPRING_0..gap::IMU_0).contains(&c) => v * 1e3,
            _ => v.to_degrees(),
        }));
        table.rows.push(row);
    }
    table
}
