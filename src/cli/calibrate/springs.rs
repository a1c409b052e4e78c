//! `calibrate springs`, and the virtual rig's bench.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result};
use clap::{Args, ValueEnum};
use rand::SeedableRng as _;
use rand_pcg::Pcg64Mcg;
use serde_json::{Value, json};
use sha2::{Digest as _, Sha256};

use crate::cli::outputs::{Overwrite, replace_keeping};
use crate::cli::{Failed, Report, args};
use springtwin::drive::{read_bench, read_toml};
use springtwin::recording::write_text;
use springtwin::rig::circuit::{self, BenchPlan};
use springtwin::rig::circuit_of;
use springtwin::robot::RobotSpec;
use springtwin::sensing::bench::{
    CAPACITANCE_F, COMPENSATION_H, FitError, SpringVerdicts, calibrate,
};
use springtwin::sensing::calibration::{Calibration, Curve, FitQuality, SpringCalibration};
use springtwin::signal::{SPRINGS, hex};

#[derive(Args)]
pub struct SpringsArgs {
    /// The bench's log: CSV with spring, length_mm and frequency_hz or reading; or inductance_uh with capacitance_pf and
    /// compensation_uh as measured on the spring's channel
    #[arg(value_name = "BENCH.csv", required_unless_present = "preset")]
    bench: Option<PathBuf>,
    /// Where to put the calibration. With --overwrite the springs of the log take the place of those in a file that is
    /// there; its other springs and its IMUs stay, and the file before is kept as `F.toml.~1~`, `F.toml.~2~` and so on
    #[arg(long, value_name = "F.toml")]
    out: PathBuf,
    #[command(flatten)]
    overwrite: Overwrite,
    /// Write the springs that passed although others did not, or have no curve yet
    #[arg(long)]
    partial: bool,
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
    let former = former(a)?;
    if let Some(preset) = a.preset {
        return from_paper(a, former, preset);
    }
    let bench = a.bench.as_deref().context("name the bench's log")?;
    let log = read_bench(bench)?;
    let (fresh, verdicts) = calibrate(&log, &a.name, &a.date, robot.spring.range_m);
    let good = fresh.springs.len();
    let merged = merged(a, former, fresh);
    let without = without_curve(&merged);
    let mut why: Vec<String> = verdicts
        .iter()
        .filter_map(|(id, v)| Some(format!("spring {id}: {}", v.as_ref().err()?)))
        .collect();
    if verdicts.is_empty() {
        why.push(format!("{} holds no springs", bench.display()));
    }
    // Of those that are not in the log.
    let undrawn: Vec<usize> = without
        .iter()
        .copied()
        .filter(|id| verdicts.iter().all(|(i, _)| i != id))
        .collect();
    let is_written = good > 0 && (a.partial || (why.is_empty() && without.is_empty()));
    if !is_written {
        if !undrawn.is_empty() && !verdicts.is_empty() {
            why.push(format!(
                "springs without a curve in the log and in {}: {}",
                a.out.display(),
                listed(&undrawn)
            ));
        }
        let instead = match good {
            0 => String::new(),
            _ => format!(": draw these springs again, or write the other {good} with --partial"),
        };
        why.push(format!("nothing was written{instead}"));
        let report = report(&verdicts, &merged, robot, None);
        let why = why.join("; ");
        return Err(Failed { report, why }.into());
    }
    let kept = replace_keeping(&a.out, &merged.to_toml()?)?;
    let mut report = report(&verdicts, &merged, robot, Some(&a.out));
    if !without.is_empty() {
        report.text += &format!(
            "\nwithout a curve: springs {}; they will read as missing",
            listed(&without)
        );
    }
    if let Some(kept) = &kept {
        report.text += &format!("\nthe file before is kept in {}", kept.display());
    }
    report.json["without"] = json!(without);
    report.json["kept"] = json!(kept);
    if why.is_empty() {
        return Ok(report);
    }
    why.push(format!(
        "the other {good} are in {}, where these springs are as they were",
        a.out.display()
    ));
    let why = why.join("; ");
    Err(Failed { report, why }.into())
}

/// The calibration in the file that is replaced, if there is one.
fn former(a: &SpringsArgs) -> Result<Option<Calibration>> {
    if !a.out.is_file() {
        return Ok(None);
    }
    let former = Calibration::from_toml(&read_toml(&a.out)?).with_context(|| {
        format!(
            "{} exists and is no calibration: give --out another name",
            a.out.display()
        )
    })?;
    if let (Some(was), Some(is)) = (former.rig, a.arm) {
        anyhow::ensure!(
            was == is,
            "{} is the calibration of arm {was}, not of arm {is}: give --out another name",
            a.out.display()
        );
    }
    Ok(Some(former))
}

/// The fresh springs, and of the former file everything else: springs that are not among them, where the ends of all of
/// them lie, and the IMUs.
fn merged(a: &SpringsArgs, former: Option<Calibration>, mut fresh: Calibration) -> Calibration {
    fresh.rig = a.arm;
    let Some(mut former) = former else {
        return fresh;
    };
    let springs = std::mem::take(&mut fresh.springs).into_iter();
    fresh.springs = springs.map(|s| s.with_ends_of(&former)).collect();
    let is_fresh = |id: usize| fresh.springs.iter().any(|s| s.spring == id);
    former.springs.retain(|s| !is_fresh(s.spring));
    if !former.springs.is_empty() {
        // Curves of two logs.
        let logs = format!("{}\n{}\n", former.bench_sha256, fresh.bench_sha256);
        fresh.bench_sha256 = hex(&Sha256::digest(logs));
        fresh.springs.append(&mut former.springs);
        fresh.springs.sort_by_key(|s| s.spring);
    }
    fresh.imus = former.imus;
    fresh.base_tilt_rad = former.base_tilt_rad;
    fresh.rig = a.arm.or(former.rig);
    fresh
}

/// Springs (1-based) that a calibration has no curve of.
fn without_curve(of: &Calibration) -> Vec<usize> {
    (1..=SPRINGS)
        .filter(|id| of.springs.iter().all(|s| s.spring != *id))
        .collect()
}

fn listed(ids: &[usize]) -> String {
    let ids: Vec<String> = ids.iter().map(ToString::to_string).collect();
    ids.join(", ")
}

/// The verdicts; `out` is the file, if one was written.
fn report(
    verdicts: &SpringVerdicts,
    merged: &Calibration,
    robot: &RobotSpec,
    out: Option<&Path>,
) -> Report {
    let good = verdicts.iter().filter(|(_, v)| v.is_ok()).count();
    let [low_m, high_m] = robot.spring.range_m;
    let mut text = format!(
        "{good} of {} springs calibrated over {:.0} to {:.0} mm{}\n\
         spring   RMSE  held out  worst  hysteresis  (mm)",
        verdicts.len(),
        low_m * 1e3,
        high_m * 1e3,
        out.map_or(String::new(), |out| format!(" in {}", out.display()))
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
    let springs: Vec<Value> = verdicts
        .iter()
        .map(|(id, verdict)| spring_json(*id, verdict, merged))
        .collect();
    Report {
        text,
        json: json!({"springs": springs, "calibrated": good, "written": out.is_some()}),
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
    merged: &Calibration,
) -> Value {
    // One that was refused may have a curve from before.
    let mut springs = merged.springs.iter().filter(|_| verdict.is_ok());
    let calibrated = springs.find(|s| s.spring == id);
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
fn from_paper(a: &SpringsArgs, former: Option<Calibration>, preset: Preset) -> Result<Report> {
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
    replace_keeping(&a.out, &merged(a, former, calibration).to_toml()?)?;
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
    let mut circuit = circuit_of(robot, args::unit_of(robot, a.unit)?);
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

#[cfg(test)]
mod tests {
    use super::*;
    use springtwin::rig::Unit;

    struct Bench {
        dir: PathBuf,
        robot: RobotSpec,
    }

    impl Bench {
        fn new(name: &str) -> Self {
            let dir = std::env::temp_dir()
                .join(format!("springtwin-springs-{name}-{}", std::process::id()));
            std::fs::create_dir_all(&dir).expect("makes");
            let robot = RobotSpec::reference();
            Self { dir, robot }
        }

        fn path(&self, name: &str) -> PathBuf {
            self.dir.join(name)
        }

        /// Calibrates springs that were drawn, of which one may have a loose contact.
        fn calibrate(
            &self,
            springs: &[usize],
            loose: Option<usize>,
            partial: bool,
        ) -> Result<Report> {
            let mut circuit = circuit_of(&self.robot, Unit(3));
            let plan = BenchPlan {
                loose: loose.map(|id| id - 1).into_iter().collect(),
                ..BenchPlan::for_robot(&self.robot)
            };
            let mut rng = Pcg64Mcg::seed_from_u64(5);
            let log = circuit::bench(&mut circuit, &plan, &mut rng);
            let mut rows = log.lines();
            let mut text = rows.next().expect("a header").to_owned();
            let drawn = |row: &&str| {
                let id = row.split(',').next().and_then(|id| id.parse().ok());
                id.is_some_and(|id| springs.contains(&id))
            };
            rows.filter(drawn)
                .for_each(|row| text += &format!("\n{row}"));
            std::fs::write(self.path("bench.csv"), text).expect("writes");
            let args = SpringsArgs {
                bench: Some(self.path("bench.csv")),
                out: self.path("arm.toml"),
                overwrite: Overwrite::YES,
                partial,
                preset: None,
                name: "bench".into(),
                date: "2026-03-01".into(),
                arm: None,
            };
            super::springs(&args, &self.robot)
        }

        fn file(&self) -> Calibration {
            let text = std::fs::read_to_string(self.path("arm.toml")).expect("is there");
            Calibration::from_toml(&text).expect("reads")
        }
    }

    fn ids(of: &Calibration) -> Vec<usize> {
        of.springs.iter().map(|s| s.spring).collect()
    }

    #[test]
    fn springs_that_were_not_drawn_again_stay_in_the_file() {
        let bench = Bench::new("merge");
        let shipped = Calibration::virtual_rig();
        let text = shipped.to_toml().expect("writes");
        std::fs::write(bench.path("arm.toml"), &text).expect("writes");
        let report = bench.calibrate(&[2, 5], None, false).expect("both passed");
        let merged = bench.file();
        assert_eq!(ids(&merged), (1..=12).collect::<Vec<_>>());
        for (is, was) in merged.springs.iter().zip(&shipped.springs) {
            let drawn = [2, 5].contains(&is.spring);
            assert_eq!(is.curve != was.curve, drawn, "spring {}", is.spring);
            assert_eq!(is.ends_off_m, was.ends_off_m);
        }
        assert_eq!(merged.imus, shipped.imus);
        assert!(merged.is_of_virtual_rig(), "ten curves are");
        assert_ne!(merged.bench_sha256, shipped.bench_sha256);
        let kept = std::fs::read_to_string(bench.path("arm.toml.~1~")).expect("is kept");
        assert_eq!(kept, text);
        assert!(report.text.contains("arm.toml.~1~"), "{}", report.text);
        std::fs::remove_dir_all(&bench.dir).expect("cleans up");
    }

    #[test]
    fn a_failed_verdict_leaves_a_good_file_alone() {
        let bench = Bench::new("failed");
        let text = Calibration::virtual_rig().to_toml().expect("writes");
        std::fs::write(bench.path("arm.toml"), &text).expect("writes");
        let all: Vec<usize> = (1..=12).collect();
        let e = bench
            .calibrate(&all, Some(7), false)
            .expect_err("one is bad");
        let e = e.to_string();
        assert!(
            e.contains("spring 7") && e.contains("nothing was written") && e.contains("--partial"),
            "{e}"
        );
        let is = std::fs::read_to_string(bench.path("arm.toml")).expect("is there");
        assert!(is == text && !bench.path("arm.toml.~1~").exists());
        // The others, on demand; the seventh keeps its curve.
        let e = bench
            .calibrate(&all, Some(7), true)
            .expect_err("one is bad");
        assert!(e.to_string().contains("the other 11 are in"), "{e}");
        let (is, was) = (bench.file(), Calibration::virtual_rig());
        assert_eq!(is.springs[6].curve, was.springs[6].curve);
        assert_ne!(is.springs[5].curve, was.springs[5].curve);
        std::fs::remove_dir_all(&bench.dir).expect("cleans up");
    }

    #[test]
    fn a_calibration_that_lacks_springs_is_written_on_demand_alone() {
        let bench = Bench::new("partial");
        let e = bench
            .calibrate(&[1, 2, 3], None, false)
            .expect_err("nine are missing");
        let e = e.to_string();
        assert!(e.contains("4, 5, 6, 7") && e.contains("--partial"), "{e}");
        assert!(!bench.path("arm.toml").exists());
        bench.calibrate(&[1, 2, 3], None, true).expect("on demand");
        assert_eq!(ids(&bench.file()), [1, 2, 3]);
        // The rest of them completes it.
        let rest: Vec<usize> = (4..=12).collect();
        bench
            .calibrate(&rest, None, false)
            .expect("all are there now");
        assert_eq!(ids(&bench.file()).len(), 12);
        std::fs::remove_dir_all(&bench.dir).expect("cleans up");
    }
}
