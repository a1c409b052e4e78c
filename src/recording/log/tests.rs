use std::path::{Path, PathBuf};

use super::*;
use crate::recording::RecordingError;
use crate::signal::{
    CHAMBERS, ChannelHealth, Delivered, GroundTruth, Health, IMUS, Pose, Quality, SIGNALS, SPRINGS,
    SensorFrame, SensorVec, Snapshot, Stamp, Trace, TruthSource, ypr_from_rotation,
};
use proptest::prelude::*;

fn header() -> String {
    column_names().join(",")
}

fn row(t_s: f64) -> Vec<String> {
    let mut cells = vec![t_s.to_string()];
    cells.extend((0..CHAMBERS).map(|i| format!("{}", i as f64 * 2.5)));
    cells.extend((0..SPRINGS).map(|i| format!("{}", 150 + i)));
    cells.extend((0..3 * IMUS).map(|i| format!("{}", i as f64 * 0.5 - 3.0)));
    cells.extend(["10", "-20", "-300", "1", "2", "3"].map(str::to_owned));
    cells
}

fn table(rows: &[Vec<String>]) -> String {
    let mut text = header();
    for r in rows {
        text.push('\n');
        text.push_str(&r.join(","));
    }
    text.push('\n');
    text
}

fn parse(text: &str) -> Result<SessionLog, RecordingError> {
    parse_log(text.as_bytes(), Path::new("log.csv"))
}

#[test]
fn reading_a_log_tells_how_far_it_is_and_can_be_given_up() {
    let rows: Vec<_> = (0..2_000).map(|i| row(f64::from(i) * 0.02)).collect();
    let name = format!("springtwin-log-progress-{}.csv", std::process::id());
    let path = std::env::temp_dir().join(name);
    std::fs::write(&path, table(&rows)).expect("written");
    let mut shares = Vec::new();
    let whole = read_session_with(&path, &mut |share| {
        shares.push(share);
        true
    });
    let stopped = read_session_with(&path, &mut |share| share < 0.5);
    std::fs::remove_file(&path).expect("removed");
    assert_eq!(whole.expect("a log").len(), 2_000);
    assert!(shares.len() > 2 && shares.is_sorted() && shares.last() == Some(&1.0));
    let Err(RecordingError::Io { source, .. }) = stopped else {
        panic!("it was given up");
    };
    assert_eq!(source.kind(), std::io::ErrorKind::Interrupted);
}

/// Line, column and sentence of a refused table.
fn refused(text: &str) -> (usize, usize, String) {
    match parse(text) {
        Err(RecordingError::Cell {
            line, column, text, ..
        }) => (line, column, text),
        other => panic!("expected a refused cell, got {other:?}"),
    }
}

#[test]
fn reads_si() {
    let log = parse(&table(&[row(0.0), row(0.02)])).unwrap();
    assert_eq!(log.len(), 2);
    assert_eq!(log.chamber_pa[1][2], 5000.0);
    assert!((log.sensors[0].spring_m[11] - 0.161).abs() < 1e-12);
    assert!((log.sensors[0].imu_ypr_rad[3][2] - (2.5f64).to_radians()).abs() < 1e-12);
    let pose = log.truth[0].unwrap();
    assert!((pose.translation.vector.z + 0.3).abs() < 1e-12);
    let ypr = ypr_from_rotation(&pose.rotation);
    for (a, deg) in ypr.iter().zip([1.0, 2.0, 3.0f64]) {
        assert!((a - deg.to_radians()).abs() < 1e-12);
    }
}

#[test]
fn order_mark_line_ends_and_quotes_do_not_matter() {
    let plain = parse(&table(&[row(0.0), row(0.02)])).unwrap();
    let reversed = |line: &str| line.rsplit(',').collect::<Vec<_>>().join(",");
    let text: String = table(&[row(0.0), row(0.02)])
        .lines()
        .map(|l| reversed(l) + ",,\r\n")
        .collect();
    let mut odd = parse(&format!("\u{feff}{text}\r\n")).unwrap();
    odd.hash = plain.hash.clone();
    assert_eq!(odd, plain);
    let quoted: String = table(&[row(0.0), row(0.02)])
        .lines()
        .map(|l| format!("\"{}\"\n", l.replace(',', "\", \"")))
        .collect();
    let mut odd = parse(&quoted).unwrap();
    odd.hash = plain.hash.clone();
    assert_eq!(odd, plain);
}

/// Wherever the last line of a lab's own table is cut, the lines before it are read.
#[test]
fn a_last_line_that_is_cut_is_left_out_and_reported() {
    let whole = table(&[row(0.0), row(0.02), row(0.04)]);
    let two = parse(&table(&[row(0.0), row(0.02)])).unwrap();
    let start = whole.trim_end().rfind('\n').unwrap() + 1;
    let last_cell = whole.rfind(',').unwrap() + 1;
    for at in start + 1..whole.len() {
        let log = parse(&whole[..at]).unwrap();
        if at < last_cell {
            assert!(log.cut, "cut after {at} bytes");
            assert_eq!((&log.t_s, &log.sensors), (&two.t_s, &two.sensors));
            let seen = crate::recording::inspect_log(&log);
            assert_eq!((seen.complete, seen.recovered_until), (false, Some(0.02)));
        } else {
            assert_eq!((log.cut, log.len()), (false, 3), "cut after {at} bytes");
        }
    }
    // A number of which the beginning is none, and a line that was ended all the same.
    let log = parse(&format!("{}-", &whole[..last_cell])).unwrap();
    assert_eq!((log.cut, log.len()), (true, 2));
    let log = parse(&format!("{}\n\n", &whole[..start + 20])).unwrap();
    assert_eq!((log.cut, log.len()), (true, 2));
    assert!(!two.cut);
}

#[test]
fn a_line_that_is_cut_elsewhere_is_refused() {
    let mut rows = [row(0.0), row(0.02), row(0.04)];
    rows[1].truncate(9);
    let (line, column, text) = refused(&table(&rows));
    assert_eq!((line, column), (3, 9));
    assert!(text.contains("ends after 9 of"), "{text}");
    // The only one.
    assert!(parse(&table(&rows[1..2])).is_err());
    // A whole line with a wrong cell is no cut one.
    rows[1] = row(0.02);
    rows[2][3] = "x".to_owned();
    assert_eq!(refused(&table(&rows)).0, 4);
}

#[test]
fn gaps_stay_gaps_and_are_marked() {
    let mut second = row(0.02);
    second[1].clear();
    second[7 + 4] = "NaN".to_owned();
    second[7 + 12 + 5].clear();
    let n = second.len();
    second[n - 1].clear();
    let log = parse(&table(&[row(0.0), second, row(0.04)])).unwrap();
    assert!(log.chamber_pa[1][0].is_nan());
    assert!(log.sensors[1].spring_m[4].is_nan());
    assert!(log.truth[1].is_none());
    let trace = log.to_trace();
    let frame = trace.snapshots[1].sensors.as_ref().unwrap();
    assert_eq!(frame.health.chambers[0], ChannelHealth::Missing);
    assert_eq!(frame.health.springs[4], ChannelHealth::Missing);
    assert_eq!(frame.health.imus[1], ChannelHealth::Missing);
    assert_eq!(frame.health.imus_usable(), 3);
    assert!((frame.sensors.spring_m[4] - 0.154).abs() < 1e-12);
    assert!(trace.snapshots[1].truth.is_none());
    assert_eq!(
        trace.snapshots[2].truth.as_ref().unwrap().source,
        TruthSource::Vicon
    );
}

#[test]
fn errors_name_line_and_column() {
    let mut bad = row(0.02);
    bad[8] = "15O.2".to_owned();
    let (line, column, text) = refused(&table(&[row(0.0), bad]));
    assert_eq!((line, column), (3, 9));
    assert!(text.contains("15O.2"), "{text}");

    let mut short = row(0.02);
    short.truncate(20);
    assert_eq!(refused(&table(&[row(0.0), short, row(0.04)])).1, 20);

    let (line, column, _) = refused(&table(&[row(0.5), row(0.5)]));
    assert_eq!((line, column), (3, 1));

    let mut infinite = row(0.0);
    infinite[3] = "inf".to_owned();
    assert_eq!(refused(&table(&[infinite])).1, 4);

    let (line, column, text) = refused(&header().replace("spring3_mm", "spring3_m"));
    assert_eq!((line, column), (1, 10));
    assert!(
        text.contains("spring3_mm") && text.contains("unit"),
        "{text}"
    );

    assert_eq!(refused("").0, 1);
    assert_eq!(refused(&header().replace("p2_kpa", "p1_kpa")).1, 3);
}

#[test]
fn not_utf8_names_its_place() {
    let mut bytes = table(&[row(0.0)]).into_bytes();
    let n = bytes.len();
    bytes[n - 2] = 0xff;
    match parse_log(bytes.as_slice(), Path::new("log.csv")) {
        Err(RecordingError::Cell { line, column, .. }) => assert_eq!((line, column), (2, 37)),
        other => panic!("{other:?}"),
    }
}

#[test]
fn wrong_units_are_refused() {
    let metres = |mut r: Vec<String>| {
        for c in &mut r[7..19] {
            *c = format!("{}", c.parse::<f64>().unwrap() * 1e-3);
        }
        r
    };
    let (line, column, text) = refused(&table(&[metres(row(0.0)), metres(row(0.02))]));
    assert_eq!((line, column), (1, 8));
    assert!(text.contains("looks like metres"), "{text}");
    let pascals = |mut r: Vec<String>| {
        for c in &mut r[1..7] {
            *c = "30000".to_owned();
        }
        r
    };
    let (_, column, text) = refused(&table(&[pascals(row(0.0))]));
    assert!(column == 2 && text.contains("looks like Pa,"), "{text}");
}

#[test]
fn tables_of_other_programs_are_told_what_they_are() {
    let rows = table(&[row(0.0), row(0.02)]);
    let (_, headless) = rows.split_once('\n').unwrap();
    let numbers = headless.replace("0.02,", "1.00000000e+00,1.00000000e+00,");
    for text in [headless, &numbers] {
        let (line, column, said) = refused(text);
        assert_eq!((line, column), (1, 1));
        assert!(said.contains("names of the columns belong"), "{said}");
    }
    let asu = vec!["1.00000000e+00"; 38].join(",");
    let (.., said) = refused(&asu);
    assert!(said.contains("--actuation-only"), "{said}");

    let semicolons = rows.replace('.', ",").replace(',', ";");
    let (line, _, said) = refused(&semicolons);
    assert!(line == 1 && said.contains("semicolons"), "{said}");
    let decimal_commas = "t_s;p1_kpa\n0,00;1,5\n";
    assert!(refused(decimal_commas).2.contains("semicolons"));
    assert!(refused(&rows.replace(',', "\t")).2.contains("tabs"));
}

#[test]
fn files_of_other_kinds_are_told_what_they_are() {
    let dir = tempdir("other_kinds");
    let read = |name: &str, bytes: &[u8]| {
        let path = dir.join(name);
        std::fs::write(&path, bytes).unwrap();
        read_session(&path).unwrap_err().to_string()
    };
    let parquet = read("x.parquet", &[b"PAR1".as_slice(), &[0; 2 << 20]].concat());
    assert!(
        parquet.contains("Parquet") && parquet.contains("springtwin train"),
        "{parquet}"
    );
    assert!(read("x.log", b"RRF2abc").contains("ends in .rrd"));
    let large = read("x.dat", &[b'a'; 2 << 20]);
    assert!(large.contains("session is a folder"), "{large}");
    std::fs::remove_dir_all(dir).unwrap();
}

#[test]
fn positions_without_orientations_are_refused_where_they_begin() {
    let half = |t_s: f64| {
        let mut r = row(t_s);
        let n = r.len();
        r[n - 3..].iter_mut().for_each(String::clear);
        r
    };
    let mut unseen = half(0.0);
    let n = unseen.len();
    unseen[n - 6..].iter_mut().for_each(String::clear);
    let (line, column, text) = refused(&table(&[unseen, half(0.02), half(0.04)]));
    assert_eq!((line, column), (3, n - 2));
    assert!(text.contains("positions and no orientations"), "{text}");
    // A pose now and then is enough; half ones are gaps.
    let log = parse(&table(&[half(0.0), row(0.02)])).unwrap();
    assert!(log.truth[0].is_none() && log.truth[1].is_some());
}

#[test]
fn endless_line_is_refused_early() {
    let text = format!("{}\n{}", header(), "1".repeat(LINE_LIMIT_PROBE));
    assert_eq!(refused(&text).0, 2);
}
const LINE_LIMIT_PROBE: usize = 1 << 20;

#[test]
fn session_round_trip() {
    let dir = tempdir("session_round_trip");
    let mut log = parse(&table(&[row(0.0), row(0.02), row(0.04)])).unwrap();
    log.name = "a \"name\"".to_owned();
    log.rate_hz = 50.0;
    log.payload_kg = 0.2;
    log.sensors[1].spring_m[3] = f64::NAN;
    log.truth[2] = None;
    log.commanded_pa = Some(vec![[1e3; CHAMBERS]; 3]);
    write_session(&dir, &log).unwrap();
    let back = read_session(&dir).unwrap();
    assert_eq!(
        (back.name.as_str(), back.rate_hz, back.payload_kg),
        (log.name.as_str(), 50.0, 0.2)
    );
    assert_eq!(back.t_s, log.t_s);
    assert_eq!(back.commanded_pa, log.commanded_pa);
    assert!(back.sensors[1].spring_m[3].is_nan() && back.truth[2].is_none());
    for (a, b) in back.sensors.iter().zip(&log.sensors) {
        for (x, y) in a.to_vector().iter().zip(b.to_vector().iter()) {
            assert!((x - y).abs() < 1e-9 || (x.is_nan() && y.is_nan()));
        }
    }
    assert_eq!(back.hash.len(), 64);
    // A trace of the log gives the log again.
    let again = SessionLog::from_trace(&back.to_trace(), 50.0);
    assert_eq!(again.t_s, back.t_s);
    assert!(again.sensors[1].spring_m[3].is_nan());
    assert_eq!(again.truth, back.truth);
    std::fs::remove_dir_all(dir).unwrap();
}

/// Snapshots at 100 Hz whose spring 5 is stuck and whose spring 6 is read by the other springs; the link is out from the
/// fourth tick to the sixth, motion capture from the eighth on, and 200 g are declared at the ninth.
fn measured() -> Trace {
    let tick = |k: i64| Stamp(k * 10_000_000);
    let pose_at = |k: i64| Pose::translation(1e-3 * k as f64, 0.0, -0.3);
    let frame_at = |k: i64| {
        let mut health = Health::default();
        health.springs[4] = ChannelHealth::Stuck;
        health.springs[5] = ChannelHealth::Suspect;
        let mut delivered = Delivered::default();
        delivered.spring_m[4] = Some(0.171);
        SensorFrame {
            stamp: tick(k),
            sensors: SensorVec {
                spring_m: [0.150; SPRINGS],
                imu_ypr_rad: [[0.0; 3]; IMUS],
            },
            extra_sigma: [0.0; SIGNALS],
            delivered,
            chamber_pa: [0.0; CHAMBERS],
            health,
            quality: Quality::default(),
        }
    };
    // Motion capture is two ticks old, and sees every other tick.
    let seen_at = |k: i64| GroundTruth {
        stamp: tick(k),
        base_from_tip: pose_at(k),
        source: TruthSource::Vicon,
    };
    let snapshots = (0..12).map(|k| Snapshot {
        stamp: tick(k),
        sensors: Some(frame_at(if (4..6).contains(&k) { 3 } else { k })),
        truth: Some(seen_at((k - k % 2).min(8) - 2)),
        payload_kg: if k < 9 { 0.0 } else { 0.2 },
        ..Snapshot::default()
    });
    Trace {
        name: "m".to_owned(),
        snapshots: snapshots.collect(),
        ..Trace::default()
    }
}

#[test]
fn a_log_of_a_trace_holds_what_was_measured_and_nothing_else() {
    let trace = measured();
    let log = SessionLog::from_trace(&trace, 100.0);
    let tick = |t_s: f64| (t_s * 100.0).round() as i64;
    let ticks: Vec<i64> = log.t_s.iter().map(|t_s| tick(*t_s)).collect();
    assert_eq!(ticks, [0, 1, 2, 3, 6, 7, 8, 9, 10, 11]);
    for sensors in &log.sensors {
        // The stuck spring as it was delivered; of the other one there is only what the springs make of it.
        assert_eq!(sensors.spring_m[4], 0.171);
        assert!(sensors.spring_m[5].is_nan());
        assert_eq!(sensors.spring_m[0], 0.150);
    }
    // Motion capture at the times of the frames, and none after it was lost.
    for (t_s, pose) in log.t_s.iter().zip(&log.truth) {
        let x_m = pose.map(|p| p.translation.x);
        match tick(*t_s) {
            ..=6 => assert!((x_m.unwrap() - 0.1 * t_s).abs() < 1e-12, "{t_s}: {x_m:?}"),
            _ => assert_eq!(x_m, None, "{t_s}"),
        }
    }
    let payload_kg: Vec<f64> = (0..log.len()).map(|k| log.payload_at_kg(k)).collect();
    assert_eq!(
        payload_kg,
        [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.2, 0.2, 0.2]
    );
    // And the same through a file.
    let dir = tempdir("measured");
    write_session(&dir, &log).unwrap();
    let back = read_session(&dir).unwrap();
    assert_eq!(back.payload_column_kg, Some(payload_kg));
    assert_eq!(back.truth.iter().filter(|t| t.is_some()).count(), 5);
    std::fs::remove_dir_all(dir).unwrap();
}

#[test]
fn session_file_must_stay_in_its_folder() {
    let dir = tempdir("session_file_must_stay");
    for log in ["/etc/passwd", "../log.csv", ""] {
        let text = format!("name = \"x\"\nlog = {log:?}\nrate_hz = 50\n");
        std::fs::write(dir.join("session.toml"), text).unwrap();
        assert!(matches!(
            read_session(&dir),
            Err(RecordingError::Session { .. })
        ));
    }
    std::fs::write(dir.join("session.toml"), "name = \"x\"\nrate_hz = 'fast'\n").unwrap();
    let text = read_session(&dir).unwrap_err().to_string();
    assert!(text.contains("line 2"), "{text}");
    std::fs::remove_dir_all(dir).unwrap();
}

#[test]
fn milliseconds_are_refused() {
    let dir = tempdir("milliseconds");
    std::fs::write(
        dir.join("log.csv"),
        table(&[row(0.0), row(20.0), row(40.0)]),
    )
    .unwrap();
    std::fs::write(dir.join("session.toml"), "name = 'x'\nrate_hz = 50\n").unwrap();
    let text = read_session(&dir).unwrap_err().to_string();
    assert!(text.contains("seconds"), "{text}");
    std::fs::remove_dir_all(dir).unwrap();
}

fn tempdir(name: &str) -> PathBuf {
    let dir = std::env::temp_dir().join(format!("springtwin-log-{name}-{}", std::process::id()));
    std::fs::create_dir_all(&dir).unwrap();
    dir
}

proptest! {
    /// Whatever the bytes, the parser answers; it never panics.
    #[test]
    fn any_bytes(bytes in prop::collection::vec(any::<u8>(), 0..400)) {
        let _ = parse_log(bytes.as_slice(), Path::new("x"));
    }

    /// A good file with one byte changed either parses or names a line that exists.
    #[test]
    fn one_changed_byte(at in 0usize..2000, byte in any::<u8>()) {
        let mut bytes = table(&[row(0.0), row(0.02), row(0.04)]).into_bytes();
        let n = bytes.len();
        bytes[at % n] = byte;
        match parse_log(bytes.as_slice(), Path::new("x")) {
            Ok(log) => prop_assert!(log.len() <= 4 && log.t_s.iter().all(|t| t.is_finite())),
            Err(RecordingError::Cell { line, column, .. }) => {
                prop_assert!((1..=5).contains(&line) && (1..=80).contains(&column));
            }
            Err(other) => prop_assert!(false, "{}", other),
        }
    }

    /// Numbers survive: what is written is what is read.
    #[test]
    fn numbers_survive(values in prop::collection::vec(71.0f64..239.0, SPRINGS)) {
        let mut r = row(0.0);
        for (i, v) in values.iter().enumerate() {
            r[7 + i] = format!("{v:?}");
        }
        let log = parse(&table(&[r])).unwrap();
        for (i, v) in values.iter().enumerate() {
            prop_assert_eq!(log.sensors[0].spring_m[i], v * 1e-3);
        }
    }
}
