//! `calibrate springs`, and the virtual rig's bench.

use std::path::PathBuf;

use anyhow::{Context as _, Result};
use clap::{Args, ValueEnum};
use rand::SeedableRng as _;
use rand_pcg::Pcg64Mcg;
use serde_json::{Value, json};

use crate::cli::outputs::Overwrite;
use crate::cli::{Failed, Report, args};
use springtwin::drive::{read_text, read_toml};
use springtwin::recording::write_text;
use springtwin::rig::circuit::{self, BenchPlan};
use springtwin::rig::{Unit, circuit_of};
use springtwin::robot::RobotSpec;
use springtwin::sensing::bench::{
    CAPACITANCE_F, COMPENSATION_H, FitError, SpringVerdicts, calibrate, parse_bench,
};
use springtwin::sensing::calibration::{Calibration, Curve, FitQuality, SpringCalibration};
use springtwin::signal::SPRINGS;

#[derive(Args)]
pub struct SpringsArgs {
    /// The bench's log: CSV with spring, length_mm and frequency_hz or reading; or inductance_uh with capacitance_pf and
    /// compensation_uh as measured on the spring's channel
    #[arg(value_name = "BENCH.csv", required_unless_present = "preset")]
    bench: Option<PathBuf>,
    /// Where to put the calibration; of one that is replaced, the IMU mountings are kept
    #[arg(long, value_name = "F.toml")]
    out: PathBuf,
    #[command(flatten)]
    overwrite: Overwrite,
    /// Instead of a log: a curve from the paper for all springs
    #[arg(long, value_enum, conflicts_with = "bench")]
    preset: Option<Preset>,
    /// Name of the unit or the occasion
    #[arg(long, value_name = "NAME", default_value = "springs")]
    name: String,
    /// Day the bench was run
    #[arg(long, value_name = "DATE", default_value = "not stated")]
    date: String,
    /// Number of the arm, as its boards report it: on another arm the calibration is refused
    #[arg(long, value_name = "NUMBER")]
    arm: Option<u32>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Preset {
    /// Eq. (2) with e = +1.119e-7: monotone, 70 to 240 mm; that the sign is a misprint is our inference
    PaperCorrected,
    /// Eq. (2) as printed, e = -1.119e-7: refused
    PaperPrinted,
}

/// `calibrate springs`.
pub fn springs(a: &SpringsArgs, robot: &RobotSpec) -> Result<Report> {
    a.overwrite.file(&a.out)?;
    if let Some(preset) = a.preset {
        return from_paper(a, preset);
    }
    let bench = a.bench.as_deref().context("name the bench's log")?;
    let log = parse_bench(&read_text(bench)?).with_context(|| bench.display().to_string())?;
    let (fresh, verdicts) = calibrate(&log, &a.name, &a.date, robot.spring.range_m);
    let good = fresh.springs.len();
    let report = report(&verdicts, &fresh, robot, &a.out);
    if good > 0 {
        save(a, fresh)?;
    }
    let bad: Vec<String> = verdicts
        .iter()
        .filter_map(|(id, v)| Some(format!("spring {id}: {}", v.as_ref().err()?)))
        .collect();
    if bad.is_empty() && good > 0 {
        return Ok(report);
    }
    let kept = match good {
        0 => "nothing was written".to_owned(),
        _ => format!(
            "the other {good} are in {}, but an arm sets out with all twelve only",
            a.out.display()
        ),
    };
    let why = match bad.is_empty() {
        true => format!("{} holds no springs", bench.display()),
        false => format!("{}; {kept}", bad.join("; ")),
    };
    Err(Failed { report, why }.into())
}

/// Writes the springs; where their ends lie and the IMUs, which the file may already hold, stay in it.
fn save(a: &SpringsArgs, mut fresh: Calibration) -> Result<()> {
    if a.out.exists() {
        let old = Calibration::from_toml(&read_toml(&a.out)?).with_context(|| {
            format!(
                "{} exists and is no calibration: give --out another name",
                a.out.display()
            )
        })?;
        let springs = std::mem::take(&mut fresh.springs).into_iter();
        fresh.springs = springs.map(|s| s.with_ends_of(&old)).collect();
        fresh.imus = old.imus;
        fresh.base_tilt_rad = old.base_tilt_rad;
        fresh.rig = old.rig;
    }
    fresh.rig = a.arm.or(fresh.rig);
    Ok(write_text(&a.out, &fresh.to_toml()?)?)
}

fn report(
    verdicts: &SpringVerdicts,
    fresh: &Calibration,
    robot: &RobotSpec,
    out: &std::path::Path,
) -> Report {
    let good = fresh.springs.len();
    let [low_m, high_m] = robot.spring.range_m;
    let mut text = format!(
        "{good} of {} springs calibrated over {:.0} to {:.0} mm{}\n\
         spring   RMSE  held out  worst  hysteresis  (mm)",
        verdicts.len(),
        low_m * 1e3,
        high_m * 1e3,
        match good {
            0 => String::new(),
            _ => format!(" in {}", out.display()),
        }
    );
    for (id, verdict) in verdicts {
        let (quality, word) = match verdict {
            Ok(q) => (Some(*q), "ok".to_owned()),
            Err(e) => (quality_of(e), format!("refused: {e}")),
        };
        text += &match quality {
            Some(q) => format!(
                "\n{id:>6}  {:>5.3}  {:>8.3}  {:>5.3}  {:>10}  {word}",
                q.rmse_m * 1e3,
                q.held_out_rmse_m * 1e3,
                q.worst_m * 1e3,
                q.hysteresis_m
                    .map_or("-".to_owned(), |h| format!("{:.3}", h * 1e3)),
            ),
            None => format!("\n{id:>6}  {word}"),
        };
    }
    let missing: Vec<String> = (1..=SPRINGS)
        .filter(|id| verdicts.iter().all(|(i, _)| i != id))
        .map(|id| id.to_string())
        .collect();
    if !missing.is_empty() {
        text += &format!(
            "\nnot in the log: springs {}; they will read as missing",
            missing.join(", ")
        );
    }
    let springs: Vec<Value> = verdicts
        .iter()
        .map(|(id, verdict)| spring_json(*id, verdict, fresh))
        .collect();
    Report {
        text,
        json: json!({"springs": springs, "calibrated": good}),
    }
}

fn quality_of(e: &FitError) -> Option<FitQuality> {
    match e {
        FitError::NotMonotone { quality } | FitError::Inaccurate { quality } => Some(*quality),
        FitError::TooFew { .. } | FitError::Extrapolates { .. } | FitError::Degenerate => None,
    }
}

fn spring_json(
    id: usize,
    verdict: &std::result::Result<FitQuality, FitError>,
    fresh: &Calibration,
) -> Value {
    let calibrated = fresh.springs.iter().find(|s| s.spring == id);
    let quality = match verdict {
        Ok(q) => Some(*q),
        Err(e) => quality_of(e),
    };
    // A curve that was refused as not monotone is known not to be; one that was never made is unknown.
    let monotone = match verdict {
        Ok(_) => Some(true),
        Err(FitError::NotMonotone { .. }) => Some(false),
        Err(_) => None,
    };
    json!({
        "id": id,
        "ok": verdict.is_ok(),
        "why": verdict.as_ref().err().map(ToString::to_string),
        "monotone": monotone,
        "rmse_mm": quality.map(|q| q.rmse_m * 1e3),
        "held_out_rmse_mm": quality.map(|q| q.held_out_rmse_m * 1e3),
        "worst_mm": quality.map(|q| q.worst_m * 1e3),
        "hysteresis_mm": quality.and_then(|q| q.hysteresis_m).map(|h| h * 1e3),
        "points": quality.map(|q| q.points),
        "domain": calibrated.map(|s| s.curve.domain),
    })
}

/// The paper's curve for all springs.
fn from_paper(a: &SpringsArgs, preset: Preset) -> Result<Report> {
    let curve = match preset {
        Preset::PaperCorrected => Curve::paper_corrected(),
        Preset::PaperPrinted => Curve::paper_printed(),
    };
    let [low, high] = curve.domain;
    if !curve.is_monotone() {
        let [at, longest_m] = curve.longest_m();
        anyhow::bail!(
            "the paper's quartic as printed (e = -1.119e-7) is not monotone over I = {low} to {high}: it turns \
             round at I = {at:.1}, where it gives {:.1} mm, so it can never give the stated 70 to 240 mm; \
             use --preset paper-corrected (e = +1.119e-7)",
            longest_m * 1e3
        );
    }
    let spring = |spring| SpringCalibration {
        spring,
        capacitance_f: CAPACITANCE_F,
        compensation_h: COMPENSATION_H,
        curve: curve.clone(),
        ends_off_m: Default::default(),
        ends_sd_m: None,
        // Nothing was measured.
        quality: FitQuality {
            rmse_m: 0.0,
            held_out_rmse_m: 0.0,
            worst_m: 0.0,
            hysteresis_m: None,
            points: 0,
        },
    };
    let calibration = Calibration {
        name: "paper-corrected".to_owned(),
        date: a.date.clone(),
        bench_sha256: String::new(),
        rig: None,
        springs: (1..=SPRINGS).map(spring).collect(),
        imus: Vec::new(),
        base_tilt_rad: [0.0; 2],
    };
    save(a, calibration)?;
    let [shortest_m, longest_m] = curve.length_range_m();
    Ok(Report {
        text: format!(
            "the paper's quartic with e = +1.119e-7 (our inference) for all springs in {}: I = {low} to {high}, \
             {:.1} to {:.1} mm. I is what the paper's circuit logs, not an inductance: boards that send \
             counts need a bench log of their own",
            a.out.display(),
            shortest_m * 1e3,
            longest_m * 1e3
        ),
        json: json!({
            "preset": "paper-corrected", "monotone": true, "domain": [low, high],
            "length_mm": [shortest_m * 1e3, longest_m * 1e3],
        }),
    })
}

#[derive(Args)]
pub struct BenchArgs {
    /// Where to put the log
    #[arg(long, value_name = "BENCH.csv")]
    out: PathBuf,
    #[command(flatten)]
    overwrite: Overwrite,
    /// Which manufactured rig
    #[arg(long, value_name = "N", default_value = "1")]
    unit: u64,
    /// Seed of the noise
    #[arg(long, value_name = "N", default_value = "1")]
    seed: u64,
    /// Vibration of the springs, mm (standard deviation of one reading)
    #[arg(long, value_name = "MM", default_value = "0.09", value_parser = args::not_negative)]
    noise: f64,
    /// Backlash of the motor's screw between up and down, mm
    #[arg(long, value_name = "MM", default_value = "0", value_parser = args::not_negative)]
    slack: f64,
    /// A spring (1 to 12) with a loose contact; may be given several times
    #[arg(long, value_name = "SPRING", value_parser = clap::value_parser!(u8).range(1..=12))]
    loose: Vec<u8>,
}

/// `rig bench`.
pub fn bench(a: &BenchArgs, robot: &RobotSpec) -> Result<Report> {
    a.overwrite.file(&a.out)?;
    let mut circuit = circuit_of(robot, Unit(a.unit));
    circuit.tremble_m = a.noise * 1e-3;
    let plan = BenchPlan {
        slack_m: a.slack * 1e-3,
        loose: a.loose.iter().map(|id| usize::from(*id) - 1).collect(),
        ..BenchPlan::for_robot(robot)
    };
    let mut rng = Pcg64Mcg::seed_from_u64(a.seed ^ 0xbe_7c4);
    let log = circuit::bench(&mut circuit, &plan, &mut rng);
    let rows = log.lines().count() - 1;
    write_text(&a.out, &log)?;
    Ok(Report {
        text: format!("{rows} rows (simulated) to {}", a.out.display()),
        json: json!({"rows": rows, "simulated": true}),
    })
}
