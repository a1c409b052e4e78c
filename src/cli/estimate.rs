//! `estimate`: pose from springs and IMUs of a session, against its motion capture where there is one.

use std::path::PathBuf;

use anyhow::Result;
use clap::Args;
use serde_json::json;

use super::outputs::Overwrite;
use super::{Report, model};
use springtwin::drive::measures::spread;
use springtwin::lab::columns;
use springtwin::learn::{Model, PoseEval, to_pose};
use springtwin::recording::{SessionLog, Table, read_log};
use springtwin::robot::RobotSpec;
use springtwin::signal::{Pose, pose_error, ypr_from_rotation};

#[derive(Args)]
pub struct EstimateArgs {
    /// Session folder, session.toml or recording
    session: PathBuf,
    /// Networks; the shipped ones without it
    #[arg(long, value_name = "F.safetensors")]
    model: Option<PathBuf>,
    /// Write estimated poses with their standard deviations, and their residuals to the motion capture where there is
    /// one; a row per sample
    #[arg(long, value_name = "F.csv|F.parquet")]
    out: Option<PathBuf>,
    #[command(flatten)]
    overwrite: Overwrite,
    /// Estimate all the same when session, networks and robot file are of different robots
    #[arg(long)]
    any_robot: bool,
}

/// One row of a session whose sensors are all there.
struct Estimated {
    row: usize,
    pose: Pose,
    /// Predicted standard deviations: position, m, then rotation, rad.
    sd: [f64; 6],
    /// Estimated less captured: position, m, then rotation vector, rad; `None` without motion capture.
    residual: Option<[f64; 6]>,
}

impl Estimated {
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

/// Refuses a session and networks that are not of this robot, as far as they say.
fn same_robot(log: &SessionLog, networks: &Model, robot: &RobotSpec) -> Result<()> {
    const OR: &str = "or --any-robot to estimate all the same";
    springtwin::gap::recorded_with(robot, &log.name, &log.robot)
        .map_err(|e| anyhow::anyhow!("{e}, {OR}"))?;
    if let Some(notice) = model::trained_for_another(networks, robot) {
        let of_its_base = networks.scores.smap.data.robot_hash == robot.base_hash;
        anyhow::ensure!(of_its_base, "{notice}, {OR}");
        log::warn!("{notice}");
    }
    Ok(())
}

/// `estimate`.
pub fn estimate(a: &EstimateArgs, robot: &RobotSpec) -> Result<Report> {
    a.overwrite.table(a.out.as_deref())?;
    let log = read_log(&a.session)?;
    let networks = model::model(a.model.as_deref())?;
    if !a.any_robot {
        same_robot(&log, &networks, robot)?;
    }
    let maps = networks.into();
    let estimated: Vec<Estimated> = model::estimates(&log, &maps)
        .map(|(row, eval)| Estimated::new(row, &eval, &log))
        .collect();
    anyhow::ensure!(
        !estimated.is_empty(),
        "{} has no row with all springs and IMUs: there is nothing to estimate from",
        a.session.display()
    );
    let left_out = log.len() - estimated.len();
    let mut report = match compared(&log, &estimated) {
        Some(report) => report,
        None => Report {
            text: format!(
                "{}: {} poses; no motion capture to compare them with",
                log.name,
                estimated.len()
            ),
            json: json!({"error": null, "n": 0, "coverage": null}),
        },
    };
    if left_out > 0 {
        report.text += &format!("; {left_out} rows with gaps left out");
    }
    report.json["poses"] = json!(estimated.len());
    report.json["left_out"] = json!(left_out);
    if let Some(out) = &a.out {
        table(&log, &estimated).write(out)?;
        report.text += &format!("\nevery pose in {}", out.display());
        report.json["out"] = json!(out);
    }
    Ok(report)
}

/// How the estimates compare with the motion capture; `None` where there is none.
fn compared(log: &SessionLog, estimated: &[Estimated]) -> Option<Report> {
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
            angle_deg[i].push((a[i] - b[i]).to_degrees().abs());
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
    let [yaw, pitch, roll] = [0, 1, 2].map(|i| mean(&angle_deg[i]));
    let coverage = inside.map(|c| c as f64 / (3 * n) as f64);
    Some(Report {
        text: format!(
            "{}: {n} samples, translation {:.2} mm mean, {:.2} mm P95; yaw {yaw:.2}, pitch {pitch:.2}, roll {roll:.2} deg mean; \
             {:.0} % / {:.0} % inside the 68 % / 95 % band",
            log.name,
            spread.mean,
            spread.p95,
            coverage[0] * 100.0,
            coverage[1] * 100.0,
        ),
        json: json!({
            "error": {
                "mean_mm": spread.mean, "rmse_mm": spread.rmse, "p95_mm": spread.p95, "max_mm": spread.max,
                "yaw_deg": yaw, "pitch_deg": pitch, "roll_deg": roll,
            },
            "n": n,
            "coverage": {"68": coverage[0], "95": coverage[1]},
        }),
    })
}

/// Every estimate, in mm and degrees.
fn table(log: &SessionLog, estimated: &[Estimated]) -> Table {
    let each = |what: &str| {
        ["x_mm", "y_mm", "z_mm", "rx_deg", "ry_deg", "rz_deg"].map(|name| format!("{what}_{name}"))
    };
    let names = ["t_s".to_owned()].into_iter();
    let names = names.chain(columns::pose_names());
    let mut table = Table::new(names.chain(each("sd")).chain(each("residual")));
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
