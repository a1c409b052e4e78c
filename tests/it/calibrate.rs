//! Calibration and motion capture as their users do it: files in, files and verdicts out.

use serde_json::Value;

use crate::program::{json, refusal, scratch, springtwin};

/// A bench log with noise, slack and a loose contact: a verdict on each spring, and the good ones are kept.
#[test]
fn springs_are_calibrated_one_by_one() {
    let dir = scratch("calibrate-springs");
    let file = |name: &str| dir.join(name).display().to_string();
    let (bench, cal) = (file("bench.csv"), file("cal.toml"));
    json(&[
        "rig", "bench", "--out", &bench, "--noise", "0.15", "--slack", "0.2", "--loose", "7",
        "--json",
    ]);
    // Where the ends of the springs lie stays in the file.
    std::fs::copy("assets/calibration/virtual-rig.toml", &cal).expect("copies");
    let again = ["--overwrite", "--json"];
    let calibrate = [&["calibrate", "springs", &bench, "--out", &cal], &again[..]].concat();
    // One spring is bad: the file stays as it is.
    let out = springtwin(&calibrate);
    assert_eq!(out.status.code(), Some(1));
    let shipped = std::fs::read("assets/calibration/virtual-rig.toml").expect("there");
    assert_eq!(std::fs::read(&cal).expect("there"), shipped);
    // Into a file of its own, which then lacks that spring.
    let alone = file("alone.toml");
    let partial = ["calibrate", "springs", &bench, "--out", &alone, "--partial"];
    assert_eq!(springtwin(&partial).status.code(), Some(1));
    let text = std::fs::read_to_string(&alone).expect("written");
    assert_eq!(text.matches("[[spring]]").count(), 11);
    let out = springtwin(&[calibrate.as_slice(), &["--partial"]].concat());
    assert_eq!(out.status.code(), Some(1), "one spring is bad");
    let said = String::from_utf8_lossy(&out.stderr);
    assert!(
        said.contains("spring 7: the curve misses held-out points")
            && said.contains("the other 11"),
        "{said}"
    );
    let report: Value = serde_json::from_slice(&out.stdout).expect("one JSON object all the same");
    let springs = report["springs"].as_array().expect("springs");
    assert_eq!(springs.len(), 12);
    for s in springs {
        let good = s["id"] != 7;
        assert_eq!(s["ok"], good, "{s}");
        if good {
            let held_out_mm = s["held_out_rmse_mm"].as_f64().expect("a figure");
            assert!(held_out_mm < 0.4, "{s}");
            // The slack is there to be found, and nothing is blamed for it but the motor.
            let up_down_mm = s["hysteresis_mm"].as_f64().expect("both ways");
            assert!((0.15..0.45).contains(&up_down_mm), "{s}");
            assert_eq!(s["monotone"], true);
        }
    }
    let text = std::fs::read_to_string(&cal).expect("written");
    assert_eq!(text.matches("[[spring]]").count(), 12);
    assert_eq!(text.matches("top_off_mm = ").count(), 12);
    // An arm without one of the twelve sets out as one with all of them.
    let target = ["--target", "20,10,-300", "--seconds", "20"];
    let with = |calibration: &str| {
        let run = ["run", "--headless", "--json", "--calibration", calibration];
        json(&[run.as_slice(), &target].concat())
    };
    let run = with(&alone);
    assert_eq!(run["reached"], true, "{run}");
    json(
        &[
            &["rig", "bench", "--out", &bench, "--seed", "2"],
            &again[..],
        ]
        .concat(),
    );
    let report = json(&calibrate);
    assert_eq!(report["calibrated"], 12);
    let run = with(&cal);
    assert_eq!(run["reached"], true, "{run}");
    let error_mm = run["target_error_mm"].as_f64().expect("a figure");
    assert!(error_mm < 1.5, "{run}");
    let (_, said) = refusal(&["run", "--headless", "--calibration", &file("none.toml")]);
    assert!(said.contains("none.toml"), "{said}");
}

#[test]
fn the_papers_quartic_is_taken_corrected_and_refused_as_printed() {
    let dir = scratch("calibrate-paper");
    let out = dir.join("paper.toml").display().to_string();
    let (code, said) = refusal(&[
        "calibrate",
        "springs",
        "--preset",
        "paper-printed",
        "--out",
        &out,
    ]);
    assert_eq!(code, 1);
    assert!(
        said.contains("not monotone") && said.contains("20.5 mm"),
        "{said}"
    );
    assert!(!dir.join("paper.toml").exists());
    let report = json(&[
        "calibrate",
        "springs",
        "--preset",
        "paper-corrected",
        "--out",
        &out,
        "--json",
    ]);
    let length_mm = report["length_mm"].as_array().expect("two lengths");
    assert!(
        length_mm[0].as_f64().expect("mm") <= 70.0 && length_mm[1].as_f64().expect("mm") >= 240.0
    );
    // A file that says otherwise is refused when it is read.
    let text = std::fs::read_to_string(&out).expect("written");
    std::fs::write(
        &out,
        text.replace("0.0000001119", "-0.0000001119")
            .replace("1.119e-7", "-1.119e-7"),
    )
    .expect("writes");
    let bench = dir.join("b.csv").display().to_string();
    json(&["rig", "bench", "--out", &bench, "--json"]);
    let (_, said) = refusal(&["calibrate", "springs", &bench, "--out", &out, "--overwrite"]);
    assert!(said.contains("not monotone"), "{said}");
}

/// A recording of the rig's own slow motion finds the mountings it was built with.
#[test]
fn imu_mountings_come_from_a_recording() {
    let dir = scratch("calibrate-imus");
    let file = |name: &str| dir.join(name).display().to_string();
    let (rrd, cal) = (file("motion.rrd"), file("cal.toml"));
    json(&[
        "follow", "--path", "circle", "--speed", "5", "--record", &rrd, "--json",
    ]);
    let report = json(&["calibrate", "imus", &rrd, "--out", &cal, "--json"]);
    println!("{report}");
    for imu in report["imus"].as_array().expect("imus") {
        assert_eq!(imu["ok"], true, "{imu}");
        assert!(
            imu["residual_deg"].as_f64().expect("a figure") < 0.2,
            "{imu}"
        );
    }
    let text = std::fs::read_to_string(&cal).expect("written");
    assert_eq!(text.matches("[[imu]]").count(), 4);
    assert_eq!(text.matches("[[spring]]").count(), 12);
}

/// A motion that robot and motion capture both saw, from the export to poses in the robot's base: world,
/// object and clock are found, and the second import puts the poses where they were.
#[test]
fn motion_capture_is_imported_registered_and_put_into_the_base() {
    use springtwin::recording::{read_rrd, read_session};
    use springtwin::signal::pose_from_ypr;

    let dir = scratch("mocap-story");
    let file = |name: &str| dir.join(name).display().to_string();
    let rrd = file("motion.rrd");
    json(&[
        "follow", "--path", "circle", "--speed", "5", "--record", &rrd, "--seed", "4", "--json",
    ]);
    let recording = read_rrd(&dir.join("motion.rrd")).expect("reads");
    let mut truth: Vec<(f64, springtwin::signal::Pose)> = Vec::new();
    for t in recording
        .trace
        .snapshots
        .iter()
        .filter_map(|s| s.truth.as_ref())
    {
        let t_s = t.stamp.seconds();
        if truth.last().is_none_or(|last| t_s > last.0) {
            truth.push((t_s, t.base_from_tip));
        }
    }
    // As Vicon would export it: its world, its object, its clock, helical degrees, and six frames in a
    // hundred hidden in a row.
    let base_from_world = pose_from_ypr([1.1, -0.7, 0.4], [2.0, 0.3, -0.2]);
    let tip_from_object = pose_from_ypr([0.01, 0.02, -0.03], [0.5, -0.1, 3.0]);
    let first_s = truth[0].0;
    let export_of = |part: &[(f64, springtwin::signal::Pose)]| {
        let mut csv = String::from(
            "Segments\n100\n,,pad:pad,,,,,\nFrame,Sub Frame,RX,RY,RZ,TX,TY,TZ\n,,deg,deg,deg,mm,mm,mm\n",
        );
        for (t_s, base_from_tip) in part {
            let frame = 1 + ((t_s - first_s) * 100.0).round() as i64;
            let p = base_from_world.inverse() * base_from_tip * tip_from_object;
            if frame % 500 < 30 {
                csv += &format!("{frame},0,,,,,,\n");
                continue;
            }
            let r = p.rotation.scaled_axis().map(f64::to_degrees);
            let t = p.translation.vector * 1e3;
            csv += &format!(
                "{frame},0,{:.5},{:.5},{:.5},{:.4},{:.4},{:.4}\n",
                r.x, r.y, r.z, t.x, t.y, t.z
            );
        }
        csv
    };
    let export = file("trial.csv");
    std::fs::write(&export, export_of(&truth)).expect("writes");
    let seen = json(&["import", &export, "--out", &file("mocap"), "--json"]);
    assert_eq!(
        (seen["format"].as_str(), seen["rotation"].as_str()),
        (Some("vicon-segments"), Some("helical"))
    );
    assert!(seen["gaps"].as_u64().expect("gaps") > 30);
    let found = json(&[
        "calibrate",
        "mocap",
        &rrd,
        &file("mocap"),
        "--object",
        "pad:pad",
        "--out",
        &file("registration.toml"),
        "--json",
    ]);
    println!("{found}");
    let number = |path: &str| found.pointer(path).and_then(Value::as_f64).expect(path);
    // Motion capture's clock starts with its first frame; the springs lag behind the pads by 15 ms, and
    // the estimate a little more: that is part of the offset.
    let lag_ms = number("/offset_ms") - first_s * 1e3;
    assert!((10.0..40.0).contains(&lag_ms), "{lag_ms}");
    assert!(number("/poses") >= 10.0);
    assert!(number("/loo/pos_mm_rms") < 1.0 && number("/loo/rot_deg_rms") < 0.5);
    // The same take onto the robot's clock, and a later one by its own.
    let registration = file("registration.toml");
    let later = &truth[truth.len() / 2..];
    let next = file("next.csv");
    std::fs::write(&next, export_of(later)).expect("writes");
    let place = |export: &str, out: &str, more: &[&str]| {
        let out = file(out);
        let mut args = vec!["import", export, "--out", &out];
        args.extend(["--registration", &registration, "--json"]);
        args.extend(more);
        json(&args);
    };
    place(&export, "same", &["--robot-clock"]);
    place(&next, "later", &[]);
    for (name, wanted, start_s, slack_s) in [
        ("same", truth.as_slice(), 0.0, 0.05),
        ("later", later, later[0].0, 1e-6),
    ] {
        let placed = read_session(&dir.join(name)).expect("reads");
        assert_eq!(placed.len(), wanted.len());
        let (mut worst_m, mut hidden) = (0.0f64, 0);
        for (k, (t_s, truth)) in wanted.iter().enumerate() {
            let off_s = placed.t_s[k] - (t_s - start_s);
            assert!(off_s.abs() <= slack_s, "{name}: {off_s}");
            match placed.truth[k] {
                None => hidden += 1,
                Some(p) => {
                    let off = p.translation.vector - truth.translation.vector;
                    worst_m = worst_m.max(off.norm());
                }
            }
        }
        println!(
            "{name}: placed within {:.2} mm, {hidden} frames hidden",
            worst_m * 1e3
        );
        // The robot's own estimate is the yardstick: what it errs by alike everywhere comes along.
        assert!(worst_m < 2e-3, "{name}: {worst_m}");
        assert!(hidden > 30, "{name}");
    }
    // A registration of another object is no good for this one.
    let text = std::fs::read_to_string(&registration).expect("reads");
    std::fs::write(&registration, text.replace("pad:pad", "flange")).expect("writes");
    let other = file("other");
    let (_, said) = refusal(&[
        "import",
        &next,
        "--out",
        &other,
        "--registration",
        &registration,
    ]);
    assert!(said.contains("'flange', not for 'pad:pad'"), "{said}");
    assert!(!dir.join("other").exists());
}

/// The wizard without its window, from the first check to a saved calibration: a loose plug costs one REDO, and the
/// next run starts from what was saved.
#[test]
fn the_wizard_saves_a_calibration_without_a_window() {
    let dir = scratch("calibrate-wizard");
    let wizard = |args: &[&str]| {
        let all = [&["calibrate", "wizard", "--rig", "sim"], args].concat();
        let mut program = crate::process::program(&all);
        program.env("XDG_DATA_HOME", &dir);
        crate::process::output(&mut program)
    };
    // Nobody is there to be asked.
    let out = wizard(&[]);
    let (said, why) = (
        String::from_utf8_lossy(&out.stdout),
        String::from_utf8_lossy(&out.stderr),
    );
    assert_eq!(out.status.code(), Some(1), "{said} {why}");
    assert!(
        said.contains("1 Preflight: PASS") && said.contains("REDO  Spring 7:"),
        "{said}"
    );
    assert!(why.contains("Nothing was saved"), "{why}");
    let out = wizard(&["--yes", "--name", "arm 2", "--json"]);
    let why = String::from_utf8_lossy(&out.stderr);
    assert!(out.status.success(), "{why}");
    let report: Value = serde_json::from_slice(&out.stdout).expect("one JSON object");
    println!("{report:#}");
    assert_eq!(report["passed"], true);
    let attempts = report["attempts"].as_array().expect("attempts");
    let verdicts: Vec<(&str, &str)> = attempts
        .iter()
        .filter_map(|a| Some((a["step"].as_str()?, a["verdict"].as_str()?)))
        .collect();
    assert_eq!(
        verdicts,
        [
            ("Preflight", "PASS"),
            ("Springs", "REDO"),
            ("Springs", "PASS"),
            ("IMUs", "PASS"),
            ("Vicon", "PASS"),
            ("Validate", "PASS"),
        ]
    );
    assert_eq!(report["saved"]["version"], 1);
    for (kind, tables) in [("calibration", 12), ("registration", 0)] {
        let path = report["saved"][kind].as_str().expect("where");
        let text = std::fs::read_to_string(path).expect("written");
        assert_eq!(text.matches("[[spring]]").count(), tables, "{path}");
    }
    // What is kept needs no REDO; a dry run saves nothing.
    let out = wizard(&["--keep", "springs,imus,mocap", "--dry-run", "--json"]);
    let report: Value = serde_json::from_slice(&out.stdout).expect("one JSON object");
    assert_eq!(
        (&report["passed"], &report["saved"]),
        (&true.into(), &Value::Null)
    );
}
