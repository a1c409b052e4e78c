//! The program as its users run it: arguments in, exit code, JSON and sentences out.

use std::path::PathBuf;
use std::process::Output;

use serde_json::Value;

use crate::process;

pub fn springtwin(args: &[&str]) -> Output {
    process::output(&mut process::program(args))
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
    // The rigid-disc model's, which the rod follows when it only lengthens.
    assert!((z + 441.2).abs() < 0.15, "{v}");
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
    let mut program = process::program(&[]);
    program.env_remove("DISPLAY").env_remove("WAYLAND_DISPLAY");
    let out = process::output(&mut program);
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

/// Two processes and a pseudo-terminal. Whether the machine keeps time or not: without its rig the program is SAFE and
/// ends, and what it has recorded is whole.
#[test]
#[cfg(unix)]
fn a_killed_rig_leads_to_safe_and_leaves_the_recording_intact() {
    let dir = scratch("killed-rig");
    let link = dir.join("port");
    let (mut rig, _) = process::rig(&["--link", link.to_str().expect("utf-8")]);
    let file = dir.join("k.rrd");
    let name = file.to_str().expect("utf-8");
    let mut run = process::program(&["run", "--headless", "--seconds", "40"]);
    run.args(["--reset", "booted", "--accept-simulated-boards"]);
    run.args(["--target", "60,40,-300", "--record", name, "--rig"])
        .arg(&link);
    let mut program = process::Running::start(&mut run);
    // Three seconds of snapshots, or the end of a program that a busy machine has kept from its rig.
    let recorded = || std::fs::metadata(&file).map_or(0, |m| m.len()) > 700_000;
    process::until("it records", || recorded() || program.has_ended());
    rig.kill();
    let out = program.output();
    let text = String::from_utf8_lossy(&out.stderr).into_owned();
    assert_eq!(out.status.code(), Some(1), "{text}");
    assert!(text.contains("SAFE"), "{text}");
    let v = json(&["inspect", name, "--json"]);
    assert_eq!(v["complete"], true, "{v}");
    assert!(v["samples"].as_u64() > Some(0), "{v}");
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

/// The bounds are what is measured, rounded up to the next hundredth of a millimetre.
#[test]
fn both_controllers_follow_the_papers_paths() {
    for (path, controller, payload, bound_mm) in [
        ("circle", "ours", "0.115", 0.28),
        ("eight", "ours", "0.5", 0.25),
        ("eight", "paper", "0", 0.57),
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
        assert_eq!(v["waypoints"], 60, "{v}");
        let mean_mm = v["mean_mm"].as_f64().expect("mean_mm");
        assert!(
            mean_mm < bound_mm + 0.005,
            "{path} by {controller}: {mean_mm} mm"
        );
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
                text.contains("simulated rig") && text.contains("<path d=\"M"),
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
