//! `rig session`: a session of the virtual rig on simulated time, with anything hidden in it.

use std::path::PathBuf;

use anyhow::Result;
use clap::Args;
use serde_json::json;

use super::outputs::Overwrite;
use super::{Report, args};
use springtwin::lab::gap_bench::cases::Answer;
use springtwin::lab::session::{Excitation, SessionPlan, session, session_log};
use springtwin::recording::{SESSION_FILES, write_session};
use springtwin::rig::hidden::{HIDDEN, Hidden};
use springtwin::robot::RobotSpec;

#[derive(Args)]
pub struct SessionArgs {
    /// Folder for log.csv and session.toml
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    #[command(flatten)]
    overwrite: Overwrite,
    /// Length, s
    #[arg(long, value_name = "S", default_value = "90", value_parser = args::not_negative)]
    seconds: f64,
    /// Samples per second
    #[arg(long, value_name = "HZ", default_value = "50", value_parser = args::not_negative)]
    rate: f64,
    /// Seed of the commands and of the noise
    #[arg(long, value_name = "N", default_value = "1")]
    seed: u64,
    /// Which manufactured rig
    #[arg(
        long = "unit",
        alias = "specimen",
        value_name = "N",
        default_value = "1"
    )]
    specimen: u64,
    /// How it is moved: mixed, holds, steps, loads, reversals, sines, single, axial or still
    #[arg(long, value_name = "NAME", default_value = "mixed", value_parser = excitation)]
    excitation: Excitation,
    /// Mass in the gripper, kg (the operator knows of it)
    #[arg(long, value_name = "KG", default_value = "0", value_parser = args::not_negative)]
    payload: f64,
    /// Hide an effect: id, channel (1-based, all without it), values in SI units (usual ones without
    /// them), and when it begins (s)
    #[arg(long, value_name = "ID[:TARGET][=VALUE,..][@S]")]
    hide: Vec<Hidden>,
    /// Write what is hidden to this file
    #[arg(long, value_name = "FILE")]
    truth: Option<PathBuf>,
}

pub fn excitation(text: &str) -> Result<Excitation, String> {
    Excitation::from_name(text).ok_or_else(|| {
        let names = Excitation::ALL.map(Excitation::name).join(", ");
        format!("there is no excitation '{text}': choose from {names}")
    })
}

/// `rig session`.
pub fn run(a: &SessionArgs, robot: &RobotSpec) -> Result<Report> {
    args::payload_in_range(robot, a.payload)?;
    // The answer must not lie beside the question.
    if let Some(truth) = &a.truth {
        let inside = std::path::absolute(truth)?.starts_with(std::path::absolute(&a.out)?);
        anyhow::ensure!(
            !inside,
            "the answer {} would lie in the session's folder: name a place outside of it",
            truth.display()
        );
        a.overwrite.file(truth)?;
    }
    a.overwrite.files(&a.out, &SESSION_FILES)?;
    // The folder's name, so that the name does not depend on what is hidden.
    let name = a.out.file_name().unwrap_or_default().to_string_lossy();
    let plan = SessionPlan {
        name: name.into_owned(),
        seed: a.seed,
        specimen: a.specimen,
        seconds: a.seconds,
        rate_hz: a.rate,
        excitation: a.excitation,
        payload_kg: a.payload,
        hidden: a.hide.clone(),
    };
    let log = session_log(session(robot, &plan)?, robot);
    write_session(&a.out, &log)?;
    if let Some(path) = &a.truth {
        let answers: Vec<Answer> = a.hide.iter().map(Answer::new).collect();
        let text = serde_json::to_string_pretty(&json!({
            "specimen": a.specimen, "seed": a.seed, "effects": answers,
        }))?;
        springtwin::recording::write_text(path, &text)?;
    }
    Ok(Report {
        text: format!(
            "{} samples of a simulated rig in {}",
            log.len(),
            a.out.display()
        ),
        json: json!({
            "samples": log.len(), "seconds": a.seconds, "rate_hz": a.rate,
            "excitation": a.excitation.name(), "simulated": true,
        }),
    })
}

/// `rig effects`: what can be hidden.
pub fn effects() -> Report {
    let mut text = String::from("What `rig session --hide` can hide (values in SI units):");
    let mut list = Vec::new();
    for kind in HIDDEN {
        let names: Vec<String> = kind
            .magnitudes
            .iter()
            .map(|m| match m.unit {
                "" => m.name.to_owned(),
                unit => format!("{} ({unit})", m.name),
            })
            .collect();
        text.push_str(&format!("\n{}={}: {}", kind.id, names.join(","), kind.doc));
        list.push(json!({
            "id": kind.id, "class": format!("{:?}", kind.class).to_lowercase(), "doc": kind.doc,
            "params": kind.magnitudes.iter().map(|m| json!({
                "name": m.name, "unit": m.unit, "none": m.none, "bounds": m.bounds, "usual": m.usual,
            })).collect::<Vec<_>>(),
        }));
    }
    Report {
        text,
        json: json!({ "hidden": list }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_to_hide_is_parsed_and_refused_with_reason() {
        let h = "spring-calibration:10=0.93,0.002"
            .parse::<Hidden>()
            .expect("fits");
        assert_eq!((h.id, h.target), ("spring-calibration", Some(9)));
        assert_eq!(h.values, [0.93, 0.002]);
        assert!(
            "payload"
                .parse::<Hidden>()
                .is_ok_and(|h| h.target.is_none() && h.values[0] > 0.0)
        );
        assert!(
            "clock-offset=-0.4"
                .parse::<Hidden>()
                .is_ok_and(|h| h.values == [-0.4])
        );
        for (text, said) in [
            ("nonsense", "no hidden effect"),
            ("leak:7", "there are 6"),
            ("leak:0", "counted from 1"),
            ("leak:1=x", "VALUE"),
            ("leak:1=99", "must lie in"),
            ("leak:1@soon", "SECONDS"),
            ("leak:1=0.1,0.2", "1 parameters"),
        ] {
            let e = text.parse::<Hidden>().expect_err(text).to_string();
            assert!(e.contains(said), "{text}: {e}");
        }
    }

    #[test]
    fn the_live_rig_keeps_its_options_beside_the_offline_ones() {
        use clap::{CommandFactory as _, Parser as _};
        crate::cli::program::Cli::command().debug_assert();
        for line in [
            "springtwin rig --link /tmp/arm --seed 3",
            "springtwin rig session --out a --seed 3 --hide leak:2 --hide payload=0.2",
            "springtwin rig effects",
        ] {
            assert!(
                crate::cli::program::Cli::try_parse_from(line.split(' ')).is_ok(),
                "{line}"
            );
        }
    }

    #[test]
    fn the_folder_holds_the_log_alone_and_the_same_bytes_every_time() {
        let dir = std::env::temp_dir().join(format!("springtwin-session-{}", std::process::id()));
        let args = |out: &str, truth: &str| SessionArgs {
            overwrite: Overwrite::default(),
            out: dir.join(out),
            seconds: 4.0,
            rate: 25.0,
            seed: 3,
            specimen: 2,
            excitation: Excitation::Steps,
            payload: 0.0,
            hide: vec!["hysteresis".parse::<Hidden>().expect("kind")],
            truth: Some(dir.join(truth)),
        };
        let robot = RobotSpec::reference();
        for (out, answer) in [("one/x", "answer.json"), ("two/x", "again.json")] {
            run(&args(out, answer), &robot).expect("writes");
        }
        let mut names: Vec<_> = std::fs::read_dir(dir.join("one/x"))
            .expect("there")
            .map(|e| e.expect("entry").file_name())
            .collect();
        names.sort();
        assert_eq!(names, ["log.csv", "session.toml"]);
        for name in names {
            let read = |d: &str| std::fs::read(dir.join(d).join("x").join(&name)).expect("reads");
            assert_eq!(read("one"), read("two"));
            assert!(!String::from_utf8_lossy(&read("one")).contains("hysteresis"));
        }
        let answer = std::fs::read_to_string(dir.join("answer.json")).expect("there");
        assert!(answer.contains("\"hysteresis\""));
        let refused = run(&args("one/x", "one/x/answer.json"), &robot).expect_err("inside");
        assert!(refused.to_string().contains("outside"));
        std::fs::remove_dir_all(&dir).expect("cleans up");
    }
}
