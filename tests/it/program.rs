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
pub fn refusal(args: &[&str]) -> (i32, String) {
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
    // The window has a button for that: what is asked for here would not be done.
    let out = springtwin(&["run", "--record", "x.rrd"]);
    let text = String::from_utf8_lossy(&out.stderr);
    assert!(
        out.status.code() == Some(2) && text.contains("--headless"),
        "{text}"
    );
    for command in ["run --headless", "goto 60,40,-300"] {
        let mut args: Vec<&str> = command.split(' ').collect();
        args.extend(["--record", "/no/such/folder/x.rrd"]);
        let (code, text) = refusal(&args);
        assert!(
            code == 1 && text.contains("/no/such/folder"),
            "{code} {text}"
        );
    }
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
        "--overwrite",
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

/// A patch that hangs `kg` more on the gripper of the reference robot and turns a spring's reading.
fn payload_patch(robot_hash: &str, kg: f64) -> String {
    format!(
        "version = 1\nname = \"a forgotten weight\"\nrobot = \"{robot_hash}\"\n\
         [rig]\nspring-4-offset = 0.002\nmocap-clock = 0.01\n\
         [[effects]]\nid = \"payload\"\n[effects.params.mass]\nvalue = {kg:?}\nunit = \"kg\"\n"
    )
}

#[test]
fn patches_go_onto_a_robot_file_and_come_off_byte_for_byte() {
    let dir = scratch("patches");
    let file = |name: &str| dir.join(name).to_str().expect("path").to_owned();
    let text = include_str!("../../assets/robots/reference.toml");
    let hash = springtwin::robot::RobotSpec::reference().hash;
    let (base, one, two) = (file("base.toml"), file("one.toml"), file("two.toml"));
    std::fs::write(&base, text).expect("writes");
    let (p1, p2) = (file("p1.toml"), file("p2.toml"));
    std::fs::write(&p1, payload_patch(&hash, 0.2)).expect("writes");
    let v = json(&[
        "gap", "apply", &p1, "--robot", &base, "--out", &one, "--json",
    ]);
    assert_eq!(v["patches"], 1, "{v}");
    assert_eq!(v["acts"]["arm"][0], "payload");
    assert_eq!(v["acts"]["sensors"][0], "spring-4-offset");
    assert_eq!(v["acts"]["replay_only"][0], "mocap-clock");
    let on_one = payload_patch(v["hash"].as_str().expect("hash"), 0.1);
    std::fs::write(&p2, on_one).expect("writes");
    json(&[
        "gap", "apply", &p2, "--robot", &one, "--out", &two, "--json",
    ]);

    // The patched robot is the robot with that payload.
    let tip = |extra: &[&str]| {
        let mut args = vec!["sim", "solve", "--pressures", "20,-10,5,0,15,-5", "--json"];
        args.extend(extra);
        json(&args)["tip_mm"].clone()
    };
    let near = |a: &Value, b: &Value| {
        (0..3).all(|k| (a[k].as_f64().expect("mm") - b[k].as_f64().expect("mm")).abs() < 1e-6)
    };
    let loaded = tip(&["--payload", "0.2"]);
    assert!(near(&tip(&["--robot", &one]), &loaded));
    assert!(near(&tip(&["--patch", &p1]), &loaded));
    assert!(near(&tip(&["--robot", &two]), &tip(&["--payload", "0.3"])));
    assert!(!near(&tip(&[]), &loaded));

    let (back, again) = (file("back.toml"), file("again.toml"));
    json(&["gap", "apply", "--undo", &two, "--out", &back, "--json"]);
    assert_eq!(
        std::fs::read(&back).expect("is"),
        std::fs::read(&one).expect("is")
    );
    json(&["gap", "apply", "--undo", &back, "--out", &again, "--json"]);
    assert_eq!(std::fs::read(&again).expect("is"), text.as_bytes());

    let says = |args: &[&str], what: &str| {
        let (code, text) = refusal(args);
        assert!(code == 1 && text.contains(what), "{code} {text}");
    };
    let new = file("new.toml");
    says(
        &["gap", "apply", "--undo", &again, "--out", &new],
        "no patch",
    );
    says(
        &["gap", "apply", &p1, "--robot", &base, "--out", &one],
        "exists already",
    );
    says(
        &["gap", "apply", &p1, "--robot", &one, "--out", &new],
        "already",
    );
    says(
        &["gap", "apply", &p2, "--robot", &base, "--out", &new],
        "was made for robot file",
    );
    says(
        &["sim", "solve", "--pressures", "0,0,0,0,0,0", "--patch", &p2],
        "was made for",
    );
    std::fs::write(&p2, payload_patch(&hash, 40.0)).expect("writes");
    says(
        &["gap", "apply", &p2, "--robot", &base, "--out", &new],
        "must lie in",
    );
    let edited = std::fs::read_to_string(&one)
        .expect("is")
        .replace("54.0", "55.0");
    std::fs::write(&two, edited).expect("writes");
    says(
        &["gap", "apply", "--undo", &two, "--out", &new],
        "does not fit the text above",
    );
    says(
        &[
            "sim",
            "solve",
            "--pressures",
            "0,0,0,0,0,0",
            "--robot",
            &two,
        ],
        "does not fit",
    );
    assert!(!PathBuf::from(&new).exists());

    let v = json(&["doctor", "--robot", &one, "--json"]);
    let check = |name: &str| {
        let all = v["checks"].as_array().expect("checks").clone();
        all.into_iter()
            .find(|c| c["name"] == name)
            .expect("is there")
    };
    assert!(
        check("patches")["says"]
            .as_str()
            .expect("says")
            .contains("a forgotten weight")
    );
    let networks = check("networks");
    assert_eq!(networks["ok"], false);
    assert!(
        networks["says"]
            .as_str()
            .expect("says")
            .contains("without its patches")
    );
}

/// Twin and virtual rig with 0.2 kg that nobody declares, and a spring that reads 2 mm too long.
#[test]
fn goto_reaches_its_target_with_a_patched_robot() {
    let dir = scratch("patched-goto");
    let file = |name: &str| dir.join(name).to_str().expect("path").to_owned();
    let (patch, robot) = (file("patch.toml"), file("robot.toml"));
    let hash = springtwin::robot::RobotSpec::reference().hash;
    std::fs::write(&patch, payload_patch(&hash, 0.2)).expect("writes");
    json(&["gap", "apply", &patch, "--out", &robot, "--json"]);
    let v = json(&[
        "goto",
        "40,20,-300",
        "--robot",
        &robot,
        "--seconds",
        "60",
        "--json",
    ]);
    assert_eq!(v["reached"], true, "{v}");
    assert!(v["target_error_mm"].as_f64().expect("mm") <= 3.0, "{v}");
    assert!(
        v["tip_error_mm"]["mean"].as_f64().expect("mm") <= 3.0,
        "{v}"
    );
}

#[test]
fn both_controllers_follow_the_papers_paths() {
    for (path, controller, payload, bound_mm) in [
        ("circle", "ours", "0.115", 1.0),
        ("eight", "ours", "0.5", 2.0),
        ("eight", "paper", "0", 3.3),
    ] {
        let dir = scratch(&format!("follow-{path}-{controller}"));
        let out = dir.to_str().expect("utf-8");
        let v = json(&[
            "follow",
            "--path",
            path,
            "--controller",
            controller,
            "--payload",
            payload,
            "--out",
            out,
            "--json",
        ]);
        assert_eq!(v["success"], true, "{v}");
        assert_eq!(
            (&v["waypoints"], &v["missed_ticks"]),
            (&60.into(), &0.into()),
            "{v}"
        );
        let mean_mm = v["mean_mm"].as_f64().expect("mean_mm");
        assert!(mean_mm <= bound_mm, "{path} by {controller}: {mean_mm} mm");
        for key in [
            "rmse_mm",
            "p95_mm",
            "max_mm",
            "steps",
            "saturated_ratio",
            "off_manifold_mm",
        ] {
            assert!(v[key].is_number(), "{key} in {v}");
        }
        assert!(
            v["solve_micros"]["median"]
                .as_f64()
                .is_some_and(|us| us > 0.0),
            "{v}"
        );
        for name in [
            "trajectory.svg",
            "errors.svg",
            "pressures.svg",
            "springs.svg",
        ] {
            let text = std::fs::read_to_string(dir.join(name)).expect(name);
            assert!(
                text.contains("simulated rig") && text.contains("<poly"),
                "{name}"
            );
        }
        let log = std::fs::read_to_string(dir.join("log.csv")).expect("log");
        let columns = log.lines().next().expect("a head").split(',').count();
        assert!(
            log.lines().all(|l| l.split(',').count() == columns) && log.lines().count() > 10_000
        );
    }
}

#[test]
fn fruit_lands_in_the_basket() {
    let v = json(&["pick-place", "--json"]);
    assert_eq!(
        (&v["in_basket"], &v["success"]),
        (&3.into(), &true.into()),
        "{v}"
    );
    assert!(v["max_mm"].as_f64().expect("max_mm") < 2.0, "{v}");
    let v = json(&[
        "pick-place",
        "--item",
        "-70,0,-320,0.1",
        "--basket",
        "60,0,-310",
        "--json",
    ]);
    assert_eq!(v["in_basket"], 1, "{v}");
}

#[test]
fn a_plan_with_a_stop_out_of_reach_is_refused_as_a_whole() {
    let (code, text) = refusal(&["follow", "--path", "circle", "--size", "260"]);
    assert!(
        code == 1 && text.contains("stop 1 of the plan") && text.contains("mm short"),
        "{text}"
    );
    let (code, text) = refusal(&[
        "follow",
        "--path",
        "eight",
        "--centre",
        "60,0,-300",
        "--size",
        "190",
    ]);
    assert!(
        code == 1 && text.contains("waypoint") && text.contains("chamber"),
        "{text}"
    );
    let (code, text) = refusal(&["pick-place", "--item", "-70,0,-320,0.9"]);
    assert!(
        code == 1 && text.contains("0.9 kg") && text.contains("0.6 kg"),
        "{text}"
    );
    let (code, text) = refusal(&["follow", "--path", "circle", "--speed", "9"]);
    assert!(code == 1 && text.contains("5 mm/s"), "{text}");
    let (code, text) = refusal(&["follow", "--path", "circle", "--stiffness", "9"]);
    assert!(code == 2 && text.contains("from 0.3 to 3"), "{text}");
}

#[test]
fn a_verdict_comes_with_its_reason_and_pressures() {
    let v = json(&["reach", "60,40,-300", "--json"]);
    assert_eq!(
        (&v["state"], &v["distance_mm"]),
        (&"reachable".into(), &0.0.into()),
        "{v}"
    );
    assert_eq!(v["chamber_kpa"].as_array().map(Vec::len), Some(6));
    let v = json(&["reach", "250,0,-300", "--json"]);
    assert_eq!(v["state"], "unreachable", "{v}");
    assert!(
        v["limiting_chamber"]["chamber"].is_number() && v["micros"].is_number(),
        "{v}"
    );
    // Sideways there is no way to get there.
    let v = json(&["reach", "60,40,-300", "--direction", "1,0,0", "--json"]);
    assert_eq!(v["state"], "unreachable", "{v}");
    let (code, text) = refusal(&["reach", "60,40,-300", "--direction", "0,0,0"]);
    assert!(code == 2 && text.contains("points nowhere"), "{text}");
}

#[test]
fn a_direction_is_met_with_the_spare_pressure_within_bounds() {
    let v = json(&["goto", "60,40,-300", "--direction", "0,0,-1", "--json"]);
    assert_eq!(v["success"], true, "{v}");
    assert!(v["rotation_error_deg"].as_f64().expect("deg") < 1.0, "{v}");
    assert!(v["target_error_mm"].as_f64().expect("mm") < 2.0, "{v}");
    assert_eq!(v["saturated_ratio"], 0.0, "{v}");
}

#[test]
fn an_arm_that_turns_out_too_stiff_gives_up_on_the_way_and_says_why() {
    let (code, text) = refusal(&["goto", "-120,80,-240", "--stiffness", "2"]);
    assert!(
        code == 1 && text.contains("times as stiff") && text.contains("mm short"),
        "{text}"
    );
}

#[test]
fn ports_are_listed() {
    let report = json(&["ports", "--watch", "0.2", "--json"]);
    assert!(report["ports"].is_array());
    assert_eq!(report["changes"].as_array().map(Vec::len), Some(0));
}
