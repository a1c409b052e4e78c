//! Where the program writes what it has found: standard output, and the files that were asked for.

use std::path::Path;
use std::process::{Command, Stdio};

#[cfg(unix)]
use crate::process::{Running, program, until};
use crate::program::{json, refusal, scratch, springtwin};

/// Ends with the status of a closed pipe and nothing on standard error when nobody reads what it prints.
#[cfg(unix)]
fn ends_quietly(args: &[&str]) {
    let (reader, writer) = std::io::pipe().expect("a pipe");
    drop(reader);
    let out = Command::new(env!("CARGO_BIN_EXE_springtwin"))
        .args(args)
        .stdin(Stdio::null())
        .stdout(writer)
        .stderr(Stdio::piped())
        .output()
        .expect("the program starts");
    let complaint = String::from_utf8_lossy(&out.stderr);
    assert_eq!(
        (out.status.code(), complaint.as_ref()),
        (Some(141), ""),
        "{args:?}"
    );
}

#[test]
#[cfg(unix)]
fn a_reader_that_goes_away_ends_the_program_quietly() {
    let dir = scratch("closed-pipe");
    let session = dir.join("session").to_string_lossy().into_owned();
    let make = ["rig", "session", "--seconds", "4", "--out", &session];
    json(&[&make[..], &["--json"]].concat());
    for args in [
        &["inspect", &session][..],
        &["inspect", &session, "--json"],
        &["completions", "bash"],
        &["man"],
        &["gap", "effects", "--markdown"],
        &["rig", "--seed", "1"],
    ] {
        ends_quietly(args);
    }
}

/// Standard error may be closed too: the arm's end is not decided by who reads.
#[test]
#[cfg(unix)]
fn a_run_ends_as_ever_when_nobody_reads_its_errors() {
    let (reader, writer) = std::io::pipe().expect("a pipe");
    drop(reader);
    let status = Command::new(env!("CARGO_BIN_EXE_springtwin"))
        .args(["goto", "--rig", "sim", "400,0,-100", "--seconds", "2"])
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(writer)
        .status()
        .expect("the program starts");
    assert_eq!(status.code(), Some(1));
}

#[test]
fn commissioning_warns_of_a_centimetre_and_refuses_six() {
    let dir = scratch("commission-bounds");
    let path = |name: &str| dir.join(name).to_string_lossy().into_owned();
    // Motion capture that swings by so much, which no parameter of a rig explains.
    let session = |name: &str, mm: f64| {
        edited(&dir, name, |column, t_s, cell| {
            if column == "vicon_x_mm" {
                let x_mm: f64 = cell.parse().expect("a position");
                *cell = format!("{:.4}", x_mm + mm * t_s.sin());
            }
        })
    };
    let (sound, off, wrong) = (
        session("sound", 0.0),
        session("off", 22.0),
        session("wrong", 90.0),
    );
    let patch = path("patch.toml");
    let commission = ["gap", "commission", "--out", &patch, "--json"];
    let v = json(&[&commission[..], &[&sound]].concat());
    assert_eq!(v["warnings"], serde_json::json!([]), "{v}");
    std::fs::remove_file(&patch).expect("was written");

    let v = json(&[&commission[..], &[&off]].concat());
    let warning = v["warnings"][0].as_str().expect("a warning");
    assert!(
        warning.contains("end pad 1.") && warning.contains(" cm"),
        "{v}"
    );
    std::fs::remove_file(&patch).expect("was written");

    let (code, text) = refusal(&["gap", "commission", "--out", &patch, &wrong]);
    println!("{text}");
    assert!(
        code == 1 && text.contains("end pad 6.") && text.contains("at most 3.0 cm"),
        "{text}"
    );
    assert!(!std::path::Path::new(&patch).exists());
    let v = json(&[&commission[..], &["--accept-residual", &wrong]].concat());
    assert_eq!(v["out"], patch.as_str());
}

/// A session of the virtual rig, half a minute at 20 Hz, whose table `change` has edited cell by cell: it is given
/// the column's name, the row's time and the cell.
fn edited(dir: &Path, name: &str, change: impl Fn(&str, f64, &mut String)) -> String {
    let at = dir.join(name).to_string_lossy().into_owned();
    let make = [
        "rig",
        "session",
        "--seconds",
        "90",
        "--rate",
        "20",
        "--excitation",
        "holds",
        "--json",
    ];
    json(&[&make[..], &["--out", &at]].concat());
    let file = Path::new(&at).join("log.csv");
    let text = std::fs::read_to_string(&file).expect("reads");
    let mut lines = text.lines();
    let header: Vec<String> = lines
        .next()
        .expect("a header")
        .split(',')
        .map(str::to_owned)
        .collect();
    let mut out = header.join(",") + "\n";
    for line in lines {
        let mut cells: Vec<String> = line.split(',').map(str::to_owned).collect();
        let t_s: f64 = cells[0].parse().expect("a time");
        for (name, cell) in header.iter().zip(&mut cells) {
            change(name, t_s, cell);
        }
        // A row without a time is taken out.
        if !cells[0].is_empty() {
            out += &(cells.join(",") + "\n");
        }
    }
    std::fs::write(&file, out).expect("writes");
    at
}

fn said(args: &[&str]) -> String {
    let out = springtwin(args);
    assert!(
        out.status.success(),
        "{}",
        String::from_utf8_lossy(&out.stderr)
    );
    String::from_utf8_lossy(&out.stdout).into_owned()
}

#[test]
fn inspect_tells_of_gaps_rates_values_and_units() {
    let dir = scratch("inspect-tells");
    let hole = edited(&dir, "hole", |name, t_s, cell| {
        if name == "t_s" && t_s > 10.0 && t_s < 22.0 {
            cell.clear();
        }
    });
    let text = said(&["inspect", &hole]);
    println!("{text}");
    let head = text.lines().next().expect("a line");
    assert!(
        !head.contains("complete") && head.contains("at 20.0 Hz"),
        "{head}"
    );
    // Rows are frames with stamps of their own, half a period off at most.
    assert!(head.contains("1 gap, the longest 12.0"), "{head}");
    assert!(text.contains("gap of 12.0"), "{text}");
    let v = json(&["inspect", &hole, "--json"]);
    assert_eq!(v["health"]["gaps"], 1);
    let from_s = v["health"]["longest_gaps"][0]["from_s"].as_f64();
    assert!(
        from_s.is_some_and(|t| (t - 10.0).abs() < 0.06),
        "{from_s:?}"
    );
    let spring = v["channels"].as_array().expect("a list").iter();
    let spring = spring
        .clone()
        .find(|c| c["name"] == "spring1_mm")
        .expect("there");
    let [min, mean, max] = ["min", "mean", "max"].map(|k| spring[k].as_f64().expect("a number"));
    assert!(
        70.0 < min && min < mean && mean < max && max < 240.0,
        "{spring}"
    );

    let whole = edited(&dir, "whole", |_, _, _| {});
    let text = said(&["inspect", &whole]);
    assert!(
        text.lines().next().expect("a line").contains("complete"),
        "{text}"
    );
    assert!(!text.contains("WARN"), "{text}");

    let in_unit = |name: &str, ending: &'static str, start: &'static str, factor: f64| {
        let at = edited(&dir, name, |column, _, cell| {
            if column.starts_with(start) && column.ends_with(ending) {
                let v: f64 = cell.parse().expect("a number");
                *cell = format!("{:.6}", v * factor);
            }
        });
        json(&["inspect", &at, "--json"])["units"].clone()
    };
    let psi = in_unit("psi", "_kpa", "p", 1.0 / 6.894757);
    assert!(
        psi[0]
            .as_str()
            .expect("said")
            .contains("p6_kpa look like psi"),
        "{psi}"
    );
    let rad = in_unit("rad", "_deg", "imu", 1f64.to_radians());
    assert!(
        rad[0].as_str().expect("said").contains("look like radians"),
        "{rad}"
    );
    let metres = in_unit("metres", "_mm", "vicon", 1e-3);
    assert!(
        metres[0]
            .as_str()
            .expect("said")
            .contains("look like metres"),
        "{metres}"
    );
}

#[test]
fn sensors_that_say_nothing_have_no_error() {
    let dir = scratch("blank-sensors");
    let blank = edited(&dir, "blank", |name, _, cell| {
        if name.starts_with("imu") {
            cell.clear();
        }
    });
    let text = said(&["sim", "replay", &blank]);
    assert!(text.contains("IMUs no data"), "{text}");
    let v = json(&["sim", "replay", &blank, "--json"]);
    assert_eq!(v["rmse"]["imu_deg"], serde_json::Value::Null, "{v}");

    let nothing = edited(&dir, "nothing", |name, _, cell| {
        if ["imu", "spring", "vicon"]
            .iter()
            .any(|start| name.starts_with(start))
        {
            cell.clear();
        }
    });
    for args in [
        &["gap", "commission", "--out", "x.toml", &nothing][..],
        &["gap", "run", "--session", &nothing],
    ] {
        let (code, text) = refusal(args);
        assert!(code == 1 && text.contains("no measured channel"), "{text}");
    }
}

#[test]
#[cfg(feature = "rrd")]
fn what_a_search_writes_is_told_apart_and_read_by_the_script() {
    let dir = scratch("search-writes");
    let path = |name: &str| dir.join(name).to_string_lossy().into_owned();
    let session = edited(&dir, "session", |_, _, _| {});
    let whole = path("whole");
    json(&[
        "gap",
        "run",
        "--session",
        &session,
        "--out",
        &whole,
        "--json",
    ]);
    let overlay = Path::new(&whole).join("overlay.rrd");
    let (code, text) = refusal(&["inspect", overlay.to_str().expect("UTF-8")]);
    assert!(
        code == 1 && text.contains("the comparison that `gap run` writes"),
        "{text}"
    );

    let supply = path("supply");
    let (healthy, hidden) = (path("healthy"), path("hidden"));
    let make = ["rig", "session", "--seconds", "40", "--json", "--out"];
    json(&[&make[..], &[&healthy]].concat());
    let hide = ["--seed", "2", "--hide", "flow-limit"];
    json(&[&make[..], &[&hidden], &hide].concat());
    let find = ["gap", "run", "--actuation-only", "--baseline", &healthy];
    let v = json(
        &[
            &find[..],
            &["--session", &hidden, "--out", &supply, "--json"],
        ]
        .concat(),
    );
    assert_eq!(v["verdict"], "named", "{v}");
    assert_eq!(v["effects"][0]["params"]["inflate"]["unit"], "kPa/s");
    let text = std::fs::read_to_string(Path::new(&supply).join("finding.json")).expect("written");
    let mut finding: serde_json::Value = serde_json::from_str(&text).expect("JSON");
    assert_eq!(finding["verdict"], v["verdict"]);
    let page = std::fs::read_to_string(Path::new(&supply).join("report.html")).expect("written");
    assert!(page.contains("Gap report"));
    // The session states it.
    assert!(page.contains("all its figures are simulated"));
    let patch = std::fs::read_to_string(Path::new(&supply).join("patch.toml")).expect("written");
    // A patch is in SI, whatever the finding is told in.
    assert!(
        patch.contains("flow-limit") && patch.contains("Pa/s"),
        "{patch}"
    );

    // A value at the edge of its range has no interval; the script bears that.
    for effect in finding["effects"].as_array_mut().expect("a list") {
        for (_, p) in effect["params"].as_object_mut().expect("values") {
            p.as_object_mut().expect("a value").remove("ci95");
        }
    }
    let held = path("held.json");
    std::fs::write(&held, finding.to_string()).expect("writes");
    let script = include_str!("../../examples/read_results.py");
    let (_, last) = script.rsplit_once("# %%\n").expect("cells");
    let out = Command::new("python3")
        .args([
            "-c",
            &format!("import json\nfinding_file = {held:?}\n{last}"),
        ])
        .output()
        .expect("python3");
    let told = String::from_utf8_lossy(&out.stdout);
    assert!(
        out.status.success() && told.contains("at the edge of its range"),
        "{told}{}",
        String::from_utf8_lossy(&out.stderr)
    );
}

/// Header and rows of a CSV file.
fn csv(path: &str) -> (Vec<String>, Vec<Vec<f64>>) {
    let text = std::fs::read_to_string(path).expect("reads");
    let mut lines = text.lines();
    let header = lines
        .next()
        .expect("a header")
        .split(',')
        .map(str::to_owned);
    let number = |cell: &str| match cell {
        "" => f64::NAN,
        cell => cell.parse().expect("a number"),
    };
    (
        header.collect(),
        lines.map(|l| l.split(',').map(number).collect()).collect(),
    )
}

#[test]
fn a_table_of_cases_is_solved_as_each_alone() {
    let dir = scratch("solve-batch");
    let path = |name: &str| dir.join(name).to_string_lossy().into_owned();
    let (cases, out) = (path("cases.csv"), path("solved.csv"));
    std::fs::write(
        &cases,
        "p1_kpa,p2_kpa,p3_kpa,p4_kpa,p5_kpa,p6_kpa,payload_kg\n0,0,0,0,0,0,0\n20,-10,5,0,15,-5,0.2\n",
    )
    .expect("writes");
    let batch = ["sim", "solve", "--batch", &cases];
    let v = json(&[&batch[..], &["--out", &out, "--json"]].concat());
    assert_eq!((&v["cases"], &v["failed"]), (&2.into(), &0.into()));
    let (header, rows) = csv(&out);
    let at = |row: usize, name: &str| rows[row][header.iter().position(|h| h == name).expect(name)];
    let one = json(&[
        "sim",
        "solve",
        "--pressures",
        "20,-10,5,0,15,-5",
        "--payload",
        "0.2",
        "--json",
    ]);
    for (k, name) in ["x_mm", "y_mm", "z_mm"].iter().enumerate() {
        let alone = one["tip_mm"][k].as_f64().expect("mm");
        assert!((at(1, name) - alone).abs() < 1e-9, "{name}");
    }
    assert_eq!(at(1, "payload_kg"), 0.2);
    assert!((at(0, "spring12_mm") - 153.0).abs() < 10.0);

    std::fs::write(
        &cases,
        "p1_kpa,p2_kpa,p3_kpa,p4_kpa,p5_kpa,p6_kpa\n0,0,0,0,0,0\n0,0,90,0,0,0\n",
    )
    .expect("writes");
    let (code, text) = refusal(&[&batch[..], &["--out", &path("more.csv")]].concat());
    assert!(
        code == 1 && text.contains("case 2") && text.contains("90 kPa in chamber 3"),
        "{text}"
    );
    let (code, text) = refusal(&[&batch[..], &["--out", "x.txt"]].concat());
    assert!(code == 1 && text.contains(".csv or .parquet"), "{text}");
}

#[test]
fn estimates_and_replays_are_written_with_and_without_motion_capture() {
    let dir = scratch("written-series");
    let path = |name: &str| dir.join(name).to_string_lossy().into_owned();
    let tracked = edited(&dir, "tracked", |_, _, _| {});
    let blind = edited(&dir, "blind", |name, _, cell| {
        if name.starts_with("vicon") {
            cell.clear();
        }
    });
    for (session, captured) in [(&tracked, true), (&blind, false)] {
        for command in [&["estimate"][..], &["sim", "replay"]] {
            let out = path(&format!("{}-{captured}.csv", command[0]));
            let v = json(&[command, &[session, "--out", &out, "--json"]].concat());
            assert_eq!(v["out"], out.as_str(), "{v}");
            let (header, rows) = csv(&out);
            assert_eq!(rows.len(), 1800, "{command:?}");
            let column = |name: &str| {
                let c = header.iter().position(|h| h == name).expect(name);
                rows.iter().map(move |r| r[c])
            };
            assert!(column("z_mm").all(|z| (-500.0..-150.0).contains(&z)));
            let residual = match command[0] {
                "sim" => "tip_residual_x_mm",
                _ => "residual_x_mm",
            };
            let mean_mm = column(residual).map(f64::abs).sum::<f64>() / 1800.0;
            match captured {
                true => assert!(mean_mm > 0.0 && mean_mm < 10.0, "{mean_mm} mm"),
                false => assert!(column(residual).all(f64::is_nan)),
            }
        }
    }
    let text = said(&["estimate", &blind]);
    assert!(
        text.contains("no motion capture to compare them with"),
        "{text}"
    );
    let parquet = path("poses.parquet");
    json(&["estimate", &tracked, "--out", &parquet, "--json"]);
    assert!(
        std::fs::read(&parquet)
            .expect("written")
            .starts_with(b"PAR1")
    );
}

/// Ctrl+C ends a run: its recording is whole, and what was asked for was not done.
#[cfg(unix)]
#[test]
fn a_run_that_is_asked_to_end_completes_its_recording() {
    use nix::sys::signal::{Signal, kill};
    let file = scratch("asked-to-end").join("t.rrd");
    let name = file.to_str().expect("utf-8");
    let args = [
        "run",
        "--headless",
        "--seconds",
        "1000000",
        "--record",
        name,
    ];
    let run = Running::start(program(&args).stdout(Stdio::piped()).stderr(Stdio::piped()));
    until("it records", || {
        std::fs::metadata(&file).is_ok_and(|f| f.len() > 100_000)
    });
    let id = nix::unistd::Pid::from_raw(run.id() as i32);
    kill(id, Signal::SIGINT).expect("runs");
    let out = run.output();
    let said = String::from_utf8_lossy(&out.stderr);
    assert_eq!(out.status.code(), Some(1), "{said}");
    assert!(said.contains("ended by a signal"), "{said}");
    let v = json(&["inspect", name, "--json"]);
    assert_eq!(v["complete"], true, "{v}");
}

/// So does an endurance run, whose rig is a process of its own.
#[cfg(unix)]
#[test]
fn an_endurance_run_that_is_asked_to_end_stops_the_boards() {
    use nix::sys::signal::{Signal, kill};
    let run = Running::start(&mut program(&["soak", "--hours", "1"]));
    let children = format!("/proc/{0}/task/{0}/children", run.id());
    let rig = || std::fs::read_to_string(&children).is_ok_and(|c| !c.trim().is_empty());
    until("its rig runs", rig);
    let id = nix::unistd::Pid::from_raw(run.id() as i32);
    kill(id, Signal::SIGTERM).expect("runs");
    let out = run.output();
    let said = String::from_utf8_lossy(&out.stderr);
    assert_eq!(out.status.code(), Some(1), "{said}");
    assert!(said.contains("ended by a signal"), "{said}");
}

/// What an endurance run has seen is not lost when it is asked to end.
#[cfg(unix)]
#[test]
fn an_endurance_run_that_is_asked_to_end_tells_what_it_has_seen() {
    use nix::sys::signal::{Signal, kill};
    let tmp = scratch("endured");
    let args = ["soak", "--hours", "1000", "--accelerate", "--json"];
    let mut soak = program(&args);
    soak.env("TMPDIR", &tmp);
    let run = Running::start(soak.stdout(Stdio::piped()).stderr(Stdio::piped()));
    until("it records", || {
        let folder = tmp.join(format!("springtwin-soak-{}", run.id()));
        std::fs::read_dir(folder).is_ok_and(|mut files| files.next().is_some())
    });
    let id = nix::unistd::Pid::from_raw(run.id() as i32);
    kill(id, Signal::SIGTERM).expect("runs");
    let out = run.output();
    let said = String::from_utf8_lossy(&out.stderr);
    assert_eq!(out.status.code(), Some(1), "{said}");
    assert!(
        said.contains("ended by a signal after") && said.contains("no bound was missed"),
        "{said}"
    );
    let v: serde_json::Value = serde_json::from_slice(&out.stdout).expect("a report");
    assert_eq!(v["ended_of_hours"], 1000.0, "{v}");
    assert!(
        v["ticks"].as_u64() > Some(100) && v["violations"] == 0,
        "{v}"
    );
}

/// A table cannot state by what its readings are corrected, so it has them as the sensors gave them; a recording states it.
#[test]
fn converted_readings_keep_their_corrections_where_they_can_be_stated() {
    let dir = scratch("convert-corrected");
    let at = |name: &str| dir.join(name).to_string_lossy().into_owned();
    let (session, patched) = (at("session"), at("patched"));
    let make = ["rig", "session", "--seconds", "4", "--out", &session];
    json(&[&make[..], &["--json"]].concat());
    let mut errors = springtwin::signal::SensorErrors::default();
    errors.spring[3] = [1.0625, 0.5e-3];
    let mut log = springtwin::recording::read_log(Path::new(&session)).expect("reads");
    log.corrected_by = Some(errors);
    springtwin::recording::write_session(Path::new(&patched), &log).expect("written");

    let (table, recording) = (at("patched.csv"), at("patched.rrd"));
    let told = json(&["convert", &patched, &table, "--json"]);
    assert_eq!(told["corrections_taken_back"], true, "{told}");
    json(&["convert", &patched, &recording, "--json"]);
    let read = |path: &str| springtwin::recording::read_log(Path::new(path)).expect("reads");
    let (table, recording) = (read(&table), read(&recording));
    assert_eq!(table.corrected_by, None);
    assert_eq!(recording.corrected_by, log.corrected_by);
    assert_eq!(table.sensors.len(), log.sensors.len());
    for (n, was) in log.sensors.iter().enumerate() {
        let [raw, kept] = [&table, &recording].map(|l| l.sensors[n].spring_m);
        assert!((raw[3] - (1.0625 * was.spring_m[3] + 0.5e-3)).abs() < 1e-8);
        assert!((raw[4] - was.spring_m[4]).abs() < 1e-8);
        assert!((kept[3] - was.spring_m[3]).abs() < 1e-8);
    }
}
