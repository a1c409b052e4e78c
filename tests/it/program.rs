//! The program as its users run it: arguments in, exit code, JSON and sentences out.

use std::io::{BufRead, BufReader};
use std::path::PathBuf;
use std::process::{Command, Output, Stdio};

use serde_json::Value;

pub fn springtwin(args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_springtwin"))
        .args(args)
        .stdin(Stdio::null())
        .output()
        .expect("the program starts")
}

pub fn json(args: &[&str]) -> Value {
    let out = springtwin(args);
    assert!(
        out.status.success(),
        "{args:?}: {}",
        String::from_utf8_lossy(&out.stderr)
    );
    serde_json::from_slice(&out.stdout).expect("one JSON object on standard output")
}

/// As [`json`], for commands that keep real time: a machine that freezes for 100 ms makes the arm go
/// SAFE, as it must, and says nothing about the program. Such an attempt is repeated, twice at most.
fn json_in_real_time(args: &[&str]) -> Value {
    for _ in 0..2 {
        let out = springtwin(args);
        let text = String::from_utf8_lossy(&out.stderr).into_owned();
        if !text.contains("no data from") {
            assert!(out.status.success(), "{args:?}: {text}");
            return serde_json::from_slice(&out.stdout).expect("one JSON object");
        }
        println!("the machine stalled: {text}");
    }
    json(args)
}

/// Exit code and the only line on standard error.
fn refusal(args: &[&str]) -> (i32, String) {
    let out = springtwin(args);
    let text = String::from_utf8_lossy(&out.stderr).trim().to_owned();
    assert_eq!(
        text.lines().count(),
        1,
        "{args:?} should give one sentence: {text}"
    );
    (out.status.code().expect("no signal"), text)
}

pub fn scratch(name: &str) -> PathBuf {
    let dir = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join(name);
    let _ = std::fs::remove_dir_all(&dir);
    std::fs::create_dir_all(&dir).expect("scratch folder");
    dir
}

#[test]
fn solving_tells_the_pose() {
    let v = json(&["sim", "solve", "--pressures", "40,40,40,40,40,40", "--json"]);
    let z = v["tip_mm"][2].as_f64().expect("tip_mm");
    assert!((z + 441.2).abs() < 8.0, "{v}");
    assert_eq!(v["springs_mm"].as_array().map(Vec::len), Some(12));
    assert_eq!(v["imu_ypr_deg"].as_array().map(Vec::len), Some(4));
}

#[test]
fn bad_input_gets_one_sentence() {
    let (code, text) = refusal(&["run", "--headless", "--target", "nan,0,-300"]);
    assert!(
        code == 2 && text.contains("'nan' is not a finite number"),
        "{code} {text}"
    );
    let (code, text) = refusal(&["estimate", "/no/such/session"]);
    assert!(
        code == 1 && text.contains("/no/such/session"),
        "{code} {text}"
    );
    let (code, text) = refusal(&[
        "run",
        "--headless",
        "--rig",
        "/dev/no-such-port",
        "--seconds",
        "1",
    ]);
    assert!(
        code == 1 && text.contains("/dev/no-such-port"),
        "{code} {text}"
    );
    let dir = scratch("bad-robot");
    let file = dir.join("robot.toml");
    std::fs::write(&file, "name = \"x\"\n[base\n").expect("write");
    let (code, text) = refusal(&[
        "--robot",
        file.to_str().expect("utf-8"),
        "sim",
        "solve",
        "--pressures",
        "0,0,0,0,0,0",
    ]);
    assert!(
        code == 1 && text.contains("line 2") && text.contains("robot.toml"),
        "{code} {text}"
    );
    let (code, text) = refusal(&[
        "sim",
        "solve",
        "--pressures",
        "0,0,0,0,0,0",
        "--payload",
        "3",
    ]);
    assert!(code == 1 && text.contains("0.6 kg"), "{code} {text}");
}

#[test]
#[cfg(target_os = "linux")]
fn without_a_display_the_headless_command_is_named() {
    let out = Command::new(env!("CARGO_BIN_EXE_springtwin"))
        .env_remove("DISPLAY")
        .env_remove("WAYLAND_DISPLAY")
        .output()
        .expect("the program starts");
    let text = String::from_utf8_lossy(&out.stderr);
    assert_eq!(out.status.code(), Some(1));
    assert!(
        text.contains("no display") && text.contains("--headless"),
        "{text}"
    );
}

#[test]
fn unreachable_targets_are_refused_before_motion() {
    for target in [
        "400,0,-100",
        "0,0,-600",
        "0,0,0",
        "-350,0,-300",
        "0,300,-420",
    ] {
        let (code, text) = refusal(&["goto", "--seconds", "8", target]);
        assert!(code == 1, "{target}: {text}");
        assert!(
            text.contains("mm short") && text.contains("chamber"),
            "{target}: {text}"
        );
    }
}

#[test]
fn the_same_seed_gives_the_same_bytes() {
    let dir = scratch("same-bytes");
    let file = |n: u32| {
        dir.join(format!("{n}.parquet"))
            .to_string_lossy()
            .into_owned()
    };
    for n in 1..=2 {
        json(&[
            "dataset",
            "generate",
            "--samples",
            "200",
            "--seed",
            "5",
            "--out",
            &file(n),
            "--json",
        ]);
    }
    let read = |n| std::fs::read(file(n)).expect("dataset");
    assert_eq!(read(1), read(2));
    let run = || {
        json(&[
            "run",
            "--headless",
            "--rig",
            "sim",
            "--seconds",
            "4",
            "--target",
            "20,10,-310",
            "--json",
        ])
    };
    assert_eq!(run(), run());
}

#[test]
#[cfg(unix)]
fn closed_loop_through_a_pty_reaches_its_target_and_records() {
    let dir = scratch("pty-loop");
    let file = dir.join("t.rrd").to_string_lossy().into_owned();
    let v = json_in_real_time(&[
        "run",
        "--headless",
        "--rig",
        "pty",
        "--seconds",
        "30",
        "--target",
        "60,40,-300",
        "--record",
        &file,
        "--json",
    ]);
    assert!(
        v["target_error_mm"].as_f64().expect("target_error_mm") <= 3.0,
        "{v}"
    );
    assert_eq!(v["frames_lost"], 0, "{v}");
    assert!(v["frames"].as_u64().expect("frames") > 2700, "{v}");
    assert_eq!(v["simulated"], true);
    let v = json(&["inspect", &file, "--json"]);
    assert_eq!(v["complete"], true, "{v}");
}

#[test]
#[cfg(unix)]
fn a_killed_rig_leads_to_safe_and_leaves_the_recording_intact() {
    let dir = scratch("killed-rig");
    let link = dir.join("port");
    let mut rig = Command::new(env!("CARGO_BIN_EXE_springtwin"))
        .args(["rig", "--link", link.to_str().expect("utf-8")])
        .stdout(Stdio::piped())
        .spawn()
        .expect("the rig starts");
    let mut port = String::new();
    BufReader::new(rig.stdout.take().expect("stdout"))
        .read_line(&mut port)
        .expect("port line");
    assert!(port.trim().starts_with("/dev/"), "{port}");
    let file = dir.join("k.rrd").to_string_lossy().into_owned();
    let program = Command::new(env!("CARGO_BIN_EXE_springtwin"))
        .args([
            "run",
            "--headless",
            "--seconds",
            "30",
            "--target",
            "60,40,-300",
            "--record",
            &file,
            "--json",
        ])
        .args(["--rig", link.to_str().expect("utf-8")])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("the program starts");
    std::thread::sleep(std::time::Duration::from_secs(8));
    rig.kill().expect("kill");
    rig.wait().expect("wait");
    let out = program.wait_with_output().expect("ends by itself");
    let text = String::from_utf8_lossy(&out.stderr).into_owned();
    assert_eq!(out.status.code(), Some(1), "{text}");
    assert!(text.contains("SAFE"), "{text}");
    let v = json(&["inspect", &file, "--json"]);
    assert_eq!(v["complete"], true, "{v}");
    assert!(v["seconds"].as_f64().expect("seconds") > 5.0, "{v}");
}
