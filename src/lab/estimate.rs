//! Poses of a session estimated from springs and IMUs, against its motion capture.

use std::path::Path;

use anyhow::Result;

use super::{columns, provenance};
use crate::drive::measures::spread;
use crate::drive::model;
use crate::learn::{ErrorStats, Model, PoseEval, to_pose};
use crate::recording::{SessionLog, Table, read_log};
use crate::robot::RobotSpec;
use crate::signal::{Pose, pose_error, wrapped, ypr_from_rotation};

/// One row of a session whose sensors are all there.
#[derive(Clone, Debug)]
pub struct Estimated {
    /// Index of the row.
    pub row: usize,
    /// Estimated pose of the tip, base from tip.
    pub pose: Pose,
    /// Predicted standard deviations: position x, y, z, m, then yaw, pitch, roll, rad.
    pub sd: [f64; 6],
    /// Estimated less captured: position, m, then rotation vector x, y, z, rad, in the base frame; `None` without motion
    /// capture.
    pub residual: Option<[f64; 6]>,
}

impl Estimated {
    /// The estimate of a row of `log`.
    fn new(row: usize, eval: &PoseEval, log: &SessionLog) -> Self {
        let pose = to_pose(&eval.pose);
        Self {
            row,
            sd: std::array::from_fn(|i| eval.covariance[(i, i)].sqrt()),
            residual: log.truth[row].map(|truth| pose_error(&pose, &truth).into()),
            pose,
        }
    }
}

/// What became of a session.
#[derive(Clone, Debug)]
pub struct Session {
    /// Its columns.
    pub log: SessionLog,
    /// Its rows whose sensors are all there; there is one at least.
    pub rows: Vec<Estimated>,
    /// Against motion capture; `None` where there is none.
    pub comparison: Option<Comparison>,
    /// A sentence per difference between how the session was made and what it is estimated with.
    pub differences: Vec<String>,
}

impl Session {
    /// Rows without an estimate: a sensor of theirs is not there.
    pub fn left_out(&self) -> usize {
        self.log.len() - self.rows.len()
    }
}

/// Estimates a session in a file with networks in another; `None`: the shipped ones. Session and networks of other robots than
/// `robot` are refused unless `any_robot` is so, and `option` is what sets it.
///
/// # Errors
/// When a file cannot be read, or is of another robot, or no row has all sensors.
pub fn of_file(
    path: &Path,
    networks: Option<&Path>,
    robot: &RobotSpec,
    any_robot: bool,
    option: &str,
) -> Result<Session> {
    let log = read_log(path)?;
    let networks = model::model(networks)?;
    if !any_robot {
        same_robot(&log, &networks, robot, option)?;
    }
    let differences = provenance::of_estimate(path, &networks.hash)?;
    let rows = estimates(&log, networks);
    anyhow::ensure!(
        !rows.is_empty(),
        "{} has no row with all springs and IMUs: there is nothing to estimate from",
        path.display()
    );
    let comparison = compared(&log, &rows);
    Ok(Session {
        log,
        rows,
        comparison,
        differences,
    })
}

/// Estimates of all rows whose sensors are all there.
fn estimates(log: &SessionLog, networks: Model) -> Vec<Estimated> {
    let maps = networks.into();
    model::estimates(log, &maps)
        .map(|(row, eval)| Estimated::new(row, &eval, log))
        .collect()
}

/// Estimates against motion capture.
#[derive(Clone, Debug)]
pub struct Comparison {
    /// Number of samples.
    pub samples: usize,
    /// Distance of the tips, mm.
    pub translation_mm: ErrorStats,
    /// Mean errors of yaw, pitch and roll, in this order, deg.
    pub ypr_deg: [f64; 3],
    /// Shares of the position's coordinates within 1.00 and 1.96 predicted standard deviations, in this order.
    pub coverage: [f64; 2],
}

/// Refuses a session and networks that are not of this robot, as far as their files say, and names the `option` that allows
/// them.
///
/// # Errors
/// The message names both robots.
fn same_robot(log: &SessionLog, networks: &Model, robot: &RobotSpec, option: &str) -> Result<()> {
    let or = format!("or {option} to estimate all the same");
    crate::gap::recorded_with(robot, &log.name, &log.robot)
        .map_err(|e| anyhow::anyhow!("{e}, {or}"))?;
    if let Some(notice) = model::trained_for_another(networks, robot) {
        let of_its_base = networks.scores.smap.data.robot_hash == robot.base_hash;
        anyhow::ensure!(of_its_base, "{notice}, {or}");
        log::warn!("{notice}");
    }
    Ok(())
}

/// Errors of the estimates against motion capture; `None` where there is none.
fn compared(log: &SessionLog, estimated: &[Estimated]) -> Option<Comparison> {
    let mut distance_mm = Vec::new();
    let mut angle_deg = [Vec::new(), Vec::new(), Vec::new()];
    let mut inside = [0usize; 2];
    for one in estimated {
        let (Some(e), Some(truth)) = (&one.residual, &log.truth[one.row]) else {
            continue;
        };
        distance_mm.push(e[..3].iter().map(|x| x * x).sum::<f64>().sqrt() * 1e3);
        let (a, b) = (
            ypr_from_rotation(&one.pose.rotation),
            ypr_from_rotation(&truth.rotation),
        );
        for i in 0..3 {
            angle_deg[i].push(wrapped(a[i] - b[i]).to_degrees().abs());
        }
        // Share of coordinates within 1.00 and 1.96 predicted standard deviations.
        for i in 0..3 {
            inside[0] += usize::from(e[i].abs() <= one.sd[i]);
            inside[1] += usize::from(e[i].abs() <= 1.96 * one.sd[i]);
        }
    }
    let n = distance_mm.len();
    let spread = spread(distance_mm)?;
    let mean = |v: &[f64]| v.iter().sum::<f64>() / v.len() as f64;
    Some(Comparison {
        samples: n,
        translation_mm: spread,
        ypr_deg: [0, 1, 2].map(|i| mean(&angle_deg[i])),
        coverage: inside.map(|c| c as f64 / (3 * n) as f64),
    })
}

/// Every estimate, in mm and degrees.
pub fn table(log: &SessionLog, estimated: &[Estimated]) -> Table {
    let each = |what: &str, angles: [&str; 3]| {
        let names = ["x_mm", "y_mm", "z_mm"].into_iter().chain(angles);
        names
            .map(|name| format!("{what}_{name}"))
            .collect::<Vec<_>>()
    };
    let names = ["t_s".to_owned()].into_iter();
    let names = names.chain(columns::pose_names());
    let names = names.chain(each("sd", ["yaw_deg", "pitch_deg", "roll_deg"]));
    let mut table = Table::new(names.chain(each("residual", ["rx_deg", "ry_deg", "rz_deg"])));
    let shown = |v: [f64; 6]| -> [f64; 6] {
        std::array::from_fn(|i| if i < 3 { v[i] * 1e3 } else { v[i].to_degrees() })
    };
    for one in estimated {
        let mut row = vec![log.t_s[one.row]];
        row.extend(columns::pose_values(&one.pose));
        row.extend(shown(one.sd));
        row.extend(one.residual.map_or([f64::NAN; 6], shown));
        table.rows.push(row);
    }
    table
}
