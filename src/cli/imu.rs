//! `imu`: the orientation filter on its own.

use std::path::PathBuf;

use anyhow::Result;
use clap::{Args, Subcommand};
use serde_json::json;

use super::Report;
use springtwin::recording::{ImuSample, read_imu_log};
use springtwin::sensing::imu::{ImuFilter, Tuning};
use springtwin::sensing::score::{Judged, score};

/// The heading is aligned over the first so many seconds with a reference.
const ALIGN_S: f64 = 1.0;

#[derive(Subcommand)]
pub enum ImuCommand {
    /// The filter on a log with an optical reference: gyro and accelerometer only, heading aligned over
    /// the first second, errors over the movement
    Eval(EvalArgs),
}

#[derive(Args)]
pub struct EvalArgs {
    /// Parquet with t_s, gyro_*_rad_s, accel_*_m_s2, ref_q_* and movement, as in BROAD
    #[arg(value_name = "F.parquet")]
    file: PathBuf,
}

/// `imu`.
pub fn run(command: &ImuCommand) -> Result<Report> {
    match command {
        ImuCommand::Eval(a) => eval(a),
    }
}

fn eval(a: &EvalArgs) -> Result<Report> {
    let log = read_imu_log(&a.file)?;
    let (Some(first), Some(last)) = (log.first(), log.last()) else {
        anyhow::bail!("{} is empty: give a log with samples", a.file.display());
    };
    let period_s = (last.t_s - first.t_s) / (log.len() - 1).max(1) as f64;
    let mut filter = ImuFilter::new(period_s, Tuning::General);
    let mut before_s = first.t_s - period_s;
    let mut step = |s: &ImuSample| {
        let estimate = filter.update(s.t_s - before_s, s.gyro_rad_s, s.accel_m_s2);
        before_s = s.t_s;
        s.reference.map(|reference| Judged {
            estimate,
            reference,
            counts: s.movement,
        })
    };
    let pairs: Vec<Judged> = log.iter().filter_map(&mut step).collect();
    let s = score(&pairs, (ALIGN_S / period_s) as usize);
    anyhow::ensure!(
        s.samples > 0,
        "{} has no sample with movement and a reference: nothing can be scored",
        a.file.display()
    );
    let [inclination, heading, total] =
        [s.inclination_rad, s.heading_rad, s.total_rad].map(f64::to_degrees);
    let seconds = last.t_s - first.t_s;
    Ok(Report {
        text: format!(
            "{seconds:.1} s at {:.1} Hz, {} samples scored: inclination {inclination:.2}, heading {heading:.2}, \
             total {total:.2} deg RMSE",
            1.0 / period_s,
            s.samples
        ),
        json: json!({
            "inclination_rmse_deg": inclination, "heading_rmse_deg": heading,
            "total_rmse_deg": total, "seconds": seconds, "samples": s.samples,
        }),
    })
}
