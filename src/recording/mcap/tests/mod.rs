//! Bags that are written and read again.

mod damaged;
mod encoding;
mod lab;

use std::path::Path;

use super::*;
use crate::recording::hostile::Scratch;
use crate::recording::{SessionLog, write_session_table};
use crate::signal::{CHAMBERS, SensorVec, pose_from_ypr};

const MAP: &str = include_str!("../../../../assets/logs/ros2-bag.toml");
const NAME: &str = "x.mcap";

/// A session with gaps everywhere.
fn session(n: usize) -> SessionLog {
    let mut log = SessionLog {
        name: "with \"gaps\"".to_owned(),
        rate_hz: 50.0,
        payload_kg: 0.1,
        robot: "ab".to_owned(),
        commanded_pa: Some(Vec::new()),
        payload_column_kg: Some(Vec::new()),
        ..SessionLog::default()
    };
    for k in 0..n {
        let x = (k as f64 * 0.7 + 0.3).sin();
        let gap = |i: usize, v: f64| if (k + i) % 5 == 3 { f64::NAN } else { v };
        log.t_s
            .push(0.02 * k as f64 + if k > n / 2 { 1.5 } else { 0.0 });
        log.chamber_pa
            .push(std::array::from_fn(|i| gap(i, 1e3 * x + i as f64)));
        log.sensors.push(SensorVec {
            spring_m: std::array::from_fn(|i| gap(i, 0.15 + 0.01 * x + 1e-3 * i as f64)),
            imu_ypr_rad: std::array::from_fn(|i| [0.3 * x, -0.2 * x, 0.1 + x].map(|a| gap(i, a))),
        });
        let pose = pose_from_ypr([0.01 * x, 0.02, -0.3], [0.1, x, 0.2 * x]);
        log.truth.push((k % 3 != 1).then_some(pose));
        let set: [f64; CHAMBERS] = std::array::from_fn(|i| gap(i + 1, 2e3 * x));
        if let (Some(u), Some(m)) = (&mut log.commanded_pa, &mut log.payload_column_kg) {
            u.push(set);
            m.push(if k < 4 { 0.0 } else { 0.2 });
        }
    }
    log
}

fn bag_of(log: &SessionLog, name: &str) -> Vec<u8> {
    let scratch = Scratch::new(name);
    let summary = write_session_mcap(log, scratch.path()).expect("writes");
    assert_eq!(summary.rows, log.len() as u64);
    std::fs::read(scratch.path()).expect("there")
}

/// The table as it is written, which has six decimals of each unit.
fn table(log: &SessionLog, name: &str) -> String {
    let scratch = Scratch::new(name);
    write_session_table(scratch.path(), log).expect("writes");
    std::fs::read_to_string(scratch.path()).expect("there")
}

#[test]
fn a_session_comes_back_value_for_value() {
    let log = session(40);
    let bytes = bag_of(&log, "whole");
    let back = parse_mcap(bytes.as_slice(), Path::new(NAME)).expect("reads");
    assert_eq!(back.log.simulated, None);
    let back = back.log;
    assert_eq!(table(&back, "back"), table(&log, "log"));
    assert_eq!(
        (&back.name, back.rate_hz, &back.robot, back.cut),
        (&log.name, 50.0, &log.robot, false)
    );
    // Without what is optional.
    let plain = SessionLog {
        commanded_pa: None,
        payload_column_kg: None,
        truth: vec![None; 40],
        ..log
    };
    let bytes = bag_of(&plain, "plain");
    let back = parse_mcap(bytes.as_slice(), Path::new(NAME))
        .expect("reads")
        .log;
    assert_eq!(table(&back, "plain-back"), table(&plain, "plain-log"));
    assert_eq!((back.payload_kg, back.payload_column_kg), (0.1, None));
}

#[test]
fn times_that_a_bag_has_no_numbers_for_are_refused() {
    for (first_s, last_s) in [(-1.0, 0.0), (0.0, 3e9)] {
        let mut log = session(2);
        log.t_s = vec![first_s, last_s];
        let scratch = Scratch::new("times");
        let e = write_session_mcap(&log, scratch.path()).expect_err("out of range");
        assert!(e.to_string().contains("2147483647"), "{e}");
        assert!(!scratch.path().exists());
    }
}

#[cfg(feature = "rrd")]
#[test]
fn a_recording_comes_back_as_the_session_that_it_is() {
    let recording = Path::new(env!("CARGO_MANIFEST_DIR")).join("recordings/payload-200g.rrd");
    let scratch = Scratch::new("recording");
    let summary = write_mcap(&recording, scratch.path()).expect("writes");
    let log = crate::recording::read_log(&recording).expect("reads");
    assert_eq!(summary.rows, log.len() as u64);
    let back = read_mcap(scratch.path()).expect("reads");
    assert_eq!(back.log.simulated, Some(true));
    assert_eq!(table(&back.log, "rrd-back"), table(&log, "rrd-log"));
    assert!(back.log.truth.iter().any(Option::is_some));
    assert_eq!((&back.log.name, &back.log.robot), (&log.name, &log.robot));
    assert!((back.log.rate_hz - log.rate_hz).abs() < 1e-6);
    let meta = crate::recording::RecordingFile::open(&recording).expect("opens");
    assert_eq!(back.begun, meta.meta().begun);
}
