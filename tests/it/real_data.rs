//! Measured and independent data that are not part of the project.
//!
//! The folder is named by the environment variable `SPRINGTWIN_DATA`; without it, it is
//! `../shared/data` beside the checkout. A missing folder fails the tests that need it.

use std::path::PathBuf;

use crate::program::{json, scratch};
use springtwin::gap;
use springtwin::recording::read_session;
use springtwin::signal::TruthSource;

/// The folder with the real data.
pub fn data_dir() -> PathBuf {
    let dir = match std::env::var_os("SPRINGTWIN_DATA") {
        Some(dir) => PathBuf::from(dir),
        None => PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../shared/data"),
    };
    assert!(
        dir.join("README.md").is_file(),
        "{} holds no data: set SPRINGTWIN_DATA",
        dir.display()
    );
    dir
}

#[test]
fn rig_a_sessions_load_whole() {
    let rig = data_dir().join("sessions/rig-a");
    let mut names = Vec::new();
    for entry in std::fs::read_dir(&rig).unwrap() {
        let dir = entry.unwrap().path();
        if !dir.is_dir() {
            continue;
        }
        let log = read_session(&dir).unwrap();
        assert_eq!(Some(log.name.as_str()), dir.file_name().unwrap().to_str());
        assert_eq!((log.len(), log.rate_hz), (3750, 50.0), "{}", log.name);
        assert!((log.t_s[3749] - 74.98).abs() < 1e-9);
        assert!(log.truth.iter().all(Option::is_some));
        assert!(log.chamber_pa.iter().flatten().all(|p| p.abs() < 45e3));
        assert!(
            log.sensors
                .iter()
                .all(|s| s.to_vector().iter().all(|v| v.is_finite()))
        );
        names.push(log.name);
    }
    names.sort();
    assert!(
        names.contains(&"commissioning".to_owned()) && names.len() >= 9,
        "{names:?}"
    );
}

/// At rest the arm hangs straight: the first samples are those of the robot's description.
#[test]
fn rig_a_rest_pose_is_in_the_base_frame() {
    let log = read_session(&data_dir().join("sessions/rig-a/none")).unwrap();
    let trace = log.to_trace();
    let first = &trace.snapshots[0];
    let truth = first.truth.as_ref().unwrap();
    assert_eq!(truth.source, TruthSource::Vicon);
    // The file's first line: -0.0238, 0.0019, -299.8134 mm.
    let p = truth.base_from_tip.translation.vector;
    assert!((p.z + 0.2998134).abs() < 1e-9 && (p.x + 2.38e-5).abs() < 1e-9);
    let sensors = &first.sensors.as_ref().unwrap().sensors;
    assert!((sensors.spring_m[0] - 0.1539).abs() < 1e-12);
    assert!((sensors.imu_ypr_rad[0][0] - (-0.5366f64).to_radians()).abs() < 1e-12);
}

fn grid(name: &str) -> gap::Grid {
    let log =
        read_session(&data_dir().join("sessions/rig-a").join(name)).expect("the session reads");
    gap::Grid::new(gap::Session {
        name: log.name,
        hash: log.hash,
        robot: log.robot,
        payload_kg: log.payload_kg,
        t_s: log.t_s,
        chamber_pa: log.chamber_pa,
        commanded_pa: log.commanded_pa,
        sensors: log.sensors,
        captured: log.truth,
    })
    .expect("the session says something")
}

fn asu_arm(name: &str) -> springtwin::gap::PressureGrid {
    let path = data_dir().join("asu-arm").join(name);
    let log = springtwin::recording::read_asu_arm(&path).expect("the log reads");
    springtwin::gap::PressureGrid::new(springtwin::gap::PressureLog {
        name: log.name,
        hash: log.hash,
        t_s: log.t_s,
        commanded_pa: log.commanded_pa,
        measured_pa: log.measured_pa,
    })
    .expect("the session says something")
}

/// Sessions of an engine that is not ours, with and without something hidden in them.
#[test]
fn the_gap_finder_names_what_rig_a_hides() {
    let robot = springtwin::robot::RobotSpec::reference();
    let healthy = grid("commissioning");
    let find = |name: &str, without: &[&str]| {
        let options = gap::Options {
            without: without.iter().map(|s| (*s).to_owned()).collect(),
            ..gap::Options::default()
        };
        gap::find(
            &robot,
            Some(&healthy),
            &grid(name),
            &options,
            &gap::Unwatched,
        )
        .unwrap()
        .finding
    };
    let none = find("none", &[]);
    assert_eq!(none.verdict, gap::Verdict::NothingMissing, "{none:?}");
    let payload = find("payload", &[]);
    assert_eq!(payload.verdict, gap::Verdict::Named);
    assert_eq!(payload.effects[0].id, "payload");
    // The answer: 0.396 kg.
    assert!((payload.effects[0].params["mass"].value - 0.396).abs() < 0.05);
    assert!(payload.gap.closed > 0.8, "{:?}", payload.gap);
    let drift = find("imu-drift", &[]);
    assert_eq!(drift.verdict, gap::Verdict::Named);
    assert_eq!(
        (drift.effects[0].id.as_str(), drift.effects[0].target),
        ("imu-drift", Some(2))
    );
    assert!(drift.gap.closed > 0.8, "{:?}", drift.gap);
    // A cause that is not in the table must not become another cause's name.
    let nameless = find("payload", &["payload"]);
    assert_ne!(nameless.verdict, gap::Verdict::Named, "{nameless:?}");
    assert_ne!(nameless.verdict, gap::Verdict::NothingMissing);
}

/// The factory model, commissioned on one session, follows another one of the same rig; and it does
/// so too when the patch has become part of the robot file.
#[test]
fn a_commissioned_model_replays_a_healthy_session() {
    let rig = data_dir().join("sessions/rig-a");
    let session = |name: &str| rig.join(name).to_str().unwrap().to_owned();
    let dir = scratch("commissioned");
    let file = |name: &str| dir.join(name).to_str().unwrap().to_owned();
    let (patch, robot) = (file("rig-a.toml"), file("robot.toml"));
    json(&[
        "gap",
        "commission",
        &session("commissioning"),
        "--out",
        &patch,
        "--json",
    ]);
    let none = session("none");
    let by_patch = json(&["sim", "replay", &none, "--patch", &patch, "--json"]);
    let rmse = |key: &str| by_patch["rmse"][key].as_f64().unwrap();
    assert!(rmse("pos_mm") <= 1.5, "{by_patch}");
    assert!(rmse("ori_deg") <= 0.5, "{by_patch}");
    assert!(rmse("springs_mm") <= 0.6, "{by_patch}");
    json(&["gap", "apply", &patch, "--out", &robot, "--json"]);
    let by_robot = json(&["sim", "replay", &none, "--robot", &robot, "--json"]);
    assert_eq!(by_patch["rmse"], by_robot["rmse"]);
}

/// The supply of a real arm: fitted on one run, tested on its repeat and on another day.
#[test]
fn the_supply_of_a_real_arm_is_explained() {
    use springtwin::gap::{Unwatched, Verdict, actuation_only};
    use springtwin::recording::PSI_PA;
    let robot = springtwin::robot::RobotSpec::reference();
    let others = [asu_arm("apr18-2.csv"), asu_arm("apr05-1.csv")];
    let run = asu_arm("apr18-1.csv");
    let found = actuation_only(&robot, None, &run, &others, &[], &Unwatched).unwrap();
    let psi = |pa: f64| pa / PSI_PA;
    let [repeat, other_day] = &found.proof[..] else {
        panic!("{:?}", found.proof);
    };
    assert!(psi(repeat.rmse_before_pa) > 3.0, "{repeat:?}");
    assert!(psi(repeat.rmse_after_pa) <= 0.6, "{repeat:?}");
    assert!(psi(other_day.rmse_before_pa) > 3.0, "{other_day:?}");
    assert!(psi(other_day.rmse_after_pa) <= 1.5, "{other_day:?}");
    let f = &found.finding;
    let named = [Verdict::Named, Verdict::Indistinguishable];
    assert!(named.contains(&f.verdict), "{:?}", f.verdict);
    let timing = ["flow-limit", "pressure-lag", "pressure-delay"];
    assert!(!f.effects.is_empty());
    for e in &f.effects {
        assert!(timing.contains(&e.id.as_str()), "{e:?}");
    }
}

/// Networks trained on our simulation alone, on another engine's arm with sensors of its own.
#[test]
fn the_shipped_networks_place_another_engines_arm() {
    let session = data_dir().join("sessions/rig-a/none");
    let v = json(&["estimate", session.to_str().expect("utf-8"), "--json"]);
    let e = &v["error"];
    let figure = |key: &str| e[key].as_f64().expect("a figure");
    assert!(figure("mean_mm") <= 1.2, "{e}");
    for angle in ["yaw_deg", "pitch_deg", "roll_deg"] {
        assert!(figure(angle) <= 0.5, "{angle}: {e}");
    }
}
