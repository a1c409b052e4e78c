use std::path::PathBuf;
use std::sync::Arc;

use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;

use super::rolling::SegmentLimits;
use super::*;
use crate::recording::{
    ArmDrawing, Inspector, ReadRecording, RecordingError, RecordingMeta, Selection, SessionLog,
    Window, each_snapshot, segment_path,
};
use crate::signal::*;

fn temp(name: &str) -> PathBuf {
    std::env::temp_dir().join(format!("springtwin-rrd-{name}-{}.rrd", std::process::id()))
}

fn meta() -> RecordingMeta {
    RecordingMeta {
        name: "test".into(),
        robot: "reference".into(),
        robot_hash: "00ff".into(),
        source: "virtual rig".into(),
        simulated: Some(true),
        payload_kg: 0.1,
        begun: "2026-11-23T14:05:12+01:00".into(),
        calibration: "name = \"arm 7\"\n".into(),
        corrected_by: Some({
            let mut errors = SensorErrors::default();
            errors.spring[3] = [1.0625, 0.25e-3];
            errors
        }),
        program: env!("CARGO_PKG_VERSION").into(),
        id: "one".into(),
        registration: "scale = 1\n".into(),
        networks: "0a".into(),
        firmware: "3, 4".into(),
        controller: "null-space QP".into(),
        note: "a note".into(),
        derived_from: String::new(),
        drawing: Some(ArmDrawing {
            bellows_m: std::array::from_fn(|i| {
                let a = (i as f64 * 120.0 + if i < 3 { 0.0 } else { 60.0 }).to_radians();
                [0.062 * a.cos(), 0.062 * a.sin(), 0.0]
            }),
            bellows_radius_m: 0.03,
            pad_radius_m: 0.1,
            pad_thickness_m: 0.01,
        }),
    }
}

/// An arm bent by an angle, as a constant curve over both segments.
fn shape(angle_rad: f64) -> ArmShape {
    let at = |s: f64| {
        let turn = nalgebra::UnitQuaternion::from_euler_angles(0.0, angle_rad * s, 0.0);
        let z = -0.15 * s * (1.0 - 0.1 * angle_rad * s);
        let x = -0.15 * s * 0.5 * angle_rad * s;
        Pose::from_parts(nalgebra::Translation3::new(x, 0.0, z), turn)
    };
    let ends = |i: usize| {
        let a = (i as f64 * 60.0).to_radians();
        let p = nalgebra::Point3::new(0.075 * a.cos(), 0.075 * a.sin(), 0.0);
        let top = if i < 6 { 0.0 } else { 1.0 };
        [at(top) * p, at(top + 1.0) * p].map(|p| [p.x, p.y, p.z])
    };
    ArmShape {
        base_from_section: [
            (0..=8).map(|i| at(i as f64 / 8.0)).collect(),
            (0..=8).map(|i| at(1.0 + i as f64 / 8.0)).collect(),
        ],
        base_from_pad: [at(0.0), at(1.0), at(2.0)],
        spring_ends_m: std::array::from_fn(ends),
    }
}

fn snapshot(n: i64, rng: &mut Pcg64Mcg) -> Snapshot {
    let stamp = Stamp(n * 10_000_000 + 7);
    let wave = (n as f64 * 0.02).sin();
    let tip = pose_from_ypr(
        [0.1 * wave, 0.02, -0.3 + rng.random_range(-0.001..0.001)],
        [0.01, wave, 0.1],
    );
    let chamber_pa: [f64; CHAMBERS] =
        std::array::from_fn(|i| 20e3 * wave * (i as f64 - 2.5) / 2.5 + rng.random_range(-9.0..9.0));
    let mut sensors = SensorFrame {
        stamp,
        extra_sigma: [0.0; SIGNALS],
        delivered: Delivered {
            spring_m: std::array::from_fn(|i| (i as i64 == n % 20).then_some(0.16)),
            imu_ypr_rad: [Some([0.1, wave, -0.2]), None, None, None],
        },
        sensors: SensorVec {
            spring_m: std::array::from_fn(|i| {
                0.15 + 0.02 * wave * (i as f64 / 12.0) + rng.random_range(-1e-4..1e-4)
            }),
            imu_ypr_rad: std::array::from_fn(|_| {
                std::array::from_fn(|_| wave + rng.random_range(-0.01..0.01))
            }),
        },
        chamber_pa,
        health: Health::default(),
        quality: Quality::default(),
    };
    sensors.health.springs[3] = ChannelHealth::Stuck;
    sensors.health.chambers[5] = ChannelHealth::Missing;
    let limits = PressureLimits {
        min_pa: -40e3,
        max_pa: 40e3,
        rate_pa_s: 1e9,
    };
    Snapshot {
        stamp,
        mode: match n {
            ..20 => Mode::Disarmed,
            20..120 => Mode::Moving,
            _ => Mode::Safe("the link is stale".into()),
        },
        link: LinkStatus {
            connected: true,
            refusal: None,
            source: "virtual rig".into(),
            simulated: true,
            practice: false,
            frames: n as u64 + 1,
            frames_lost: 2,
            // Of the moment.
            frames_late: 0,
            age_s: 0.004,
            // Of the moment, too.
            retry_in_s: None,
            gripper: None,
            board_rate_hz: [100.0, 99.5],
            // A fit of the moment: not kept.
            board_clock: [None; BOARDS],
            pumps: [None; BOARDS],
            venting: false,
            stop_open: false,
            supply_cut: false,
            board_simulated: [None; BOARDS],
            rig: [None; BOARDS],
            trouble: None,
            mocap_trouble: None,
            host_delay: None,
        },
        raw: Some(RawFrame {
            seq: n as u32,
            stamp: stamp.plus(-0.003),
            spring_counts: std::array::from_fn(|_| rng.random()),
            spring_gate_ticks: std::array::from_fn(|_| rng.random()),
            tick_rate_hz: [2.003e6, 1.998e6],
            tick_rate_sd: [3e-6, 4e-6],
            imu: std::array::from_fn(|_| ImuRaw {
                gyro_rad_s: std::array::from_fn(|_| rng.random_range(-1.0..1.0)),
                accel_m_s2: std::array::from_fn(|_| rng.random_range(-9.0..9.0)),
            }),
            chamber_pa,
            present: RawFrame::ALL_PRESENT & !8,
            board_age_s: [0.001, 0.002],
            faults: 5,
        }),
        sensors: Some(sensors),
        // Gaps: not every snapshot has everything.
        estimate: (n % 7 != 3).then(|| Estimate {
            stamp,
            base_from_tip: tip,
            covariance: {
                let m = Matrix6::from_fn(|_, _| rng.random_range(-1.0..1.0));
                m + m.transpose()
            },
            training_distance: 0.9,
        }),
        truth: (n % 5 != 1).then(|| GroundTruth {
            stamp: stamp.plus(-0.001),
            base_from_tip: pose_from_ypr([0.1 * wave, 0.021, -0.301], [0.0, wave, 0.1]),
            source: TruthSource::VirtualRig,
        }),
        goal: (n >= 30).then(|| Goal {
            point_m: [0.0, 0.0, if n >= 45 { -0.1 } else { 0.0 }],
            ..Goal::position([0.05, 0.02, -0.3])
        }),
        sensor_ref: (n >= 30).then(|| SensorRef::from_fn(|_, _| rng.random_range(0.1..0.2))),
        command: (n >= 30).then(|| {
            let wanted = std::array::from_fn(|_| rng.random_range(-50e3..50e3));
            PressureCommand::limited(stamp, wanted, Gripper::Closed, None, &[0.0; 6], &limits)
        }),
        shape: Some(Arc::new(shape(0.6 * wave))),
        payload_kg: 0.1 + n as f64 * 1e-3,
        ..Snapshot::default()
    }
}

fn snapshots(n: i64) -> Vec<Snapshot> {
    let mut rng = Pcg64Mcg::seed_from_u64(11);
    (0..n).map(|i| snapshot(i, &mut rng)).collect()
}

fn read_all(
    path: &std::path::Path,
    go_on: &mut dyn FnMut(f32) -> bool,
) -> Result<ReadRecording, RecordingError> {
    RecordingFile::open(path)?.read(&Selection::default(), go_on)
}

fn write(path: &std::path::Path, snapshots: &[Snapshot]) {
    let mut w = RecordingWriter::create(path, meta()).unwrap();
    for s in snapshots {
        w.push(s).unwrap();
    }
    w.event(snapshots[0].stamp, "a line").unwrap();
    let summary = w.finish().unwrap();
    assert_eq!(summary.rows, snapshots.len() as u64);
    assert_eq!((summary.repeated, summary.rejected), (0, 0));
    assert_eq!(summary.bytes, std::fs::metadata(path).unwrap().len());
}

/// The covariance is kept in single precision.
fn assert_estimate(r: Option<&Estimate>, w: Option<&Estimate>) {
    let without = |e: &Estimate| Estimate {
        covariance: Matrix6::zeros(),
        ..e.clone()
    };
    assert_eq!(r.map(without), w.map(without));
    if let (Some(r), Some(w)) = (r, w) {
        let off = (r.covariance - w.covariance).amax();
        assert!(off <= 1e-7 * w.covariance.amax(), "{off}");
    }
}

/// What a recording keeps of a snapshot is bit for bit what was pushed, but for covariances and references.
fn assert_same(read: &[Snapshot], written: &[Snapshot]) {
    for (r, w) in read.iter().zip(written) {
        assert_eq!(r.stamp, w.stamp);
        assert_eq!(r.raw, w.raw);
        assert_eq!(r.sensors, w.sensors);
        assert_estimate(r.estimate.as_ref(), w.estimate.as_ref());
        assert_eq!(r.truth, w.truth);
        assert_eq!(r.goal, w.goal);
        assert_eq!(r.sensor_ref.is_some(), w.sensor_ref.is_some());
        if let (Some(r), Some(w)) = (&r.sensor_ref, &w.sensor_ref) {
            assert!((r - w).amax() < 1e-7);
        }
        assert_eq!(r.command, w.command);
        assert_eq!(r.mode, w.mode);
        assert_eq!(r.link, w.link);
        assert_eq!(r.payload_kg, w.payload_kg);
    }
}

#[test]
fn what_was_not_delivered_stays_unknown() {
    let path = temp("delivered");
    let mut written = snapshots(3);
    for s in &mut written {
        let frame = s.sensors.as_mut().unwrap();
        frame.delivered = Delivered::default();
        frame.delivered.spring_m[3] = Some(0.123);
        frame.health.imus[1] = ChannelHealth::Suspect;
    }
    write(&path, &written);
    let read = read_rrd(&path).unwrap().trace;
    for s in &read.snapshots {
        let measured = s.sensors.as_ref().unwrap().measured();
        assert_eq!(measured.spring_m[3], 0.123);
        assert!(measured.imu_ypr_rad[1].iter().all(|x| x.is_nan()));
        assert!(measured.imu_ypr_rad[0].iter().all(|x| x.is_finite()));
    }
    std::fs::remove_file(path).unwrap();
}

#[test]
fn round_trip_is_exact() {
    let path = temp("round");
    let written = snapshots(250);
    write(&path, &written);
    let ReadRecording {
        trace,
        meta: read_meta,
        complete,
        recovered_until,
        events,
        channels,
    } = read_rrd(&path).unwrap();
    assert!(complete && recovered_until.is_none());
    assert_eq!(trace.snapshots.len(), 250);
    assert_same(&trace.snapshots, &written);
    assert_eq!(
        read_meta,
        RecordingMeta {
            drawing: None,
            ..meta()
        }
    );
    assert!(trace.simulated == Some(true) && trace.name == "test");
    assert!(
        events
            .iter()
            .any(|e| e.log == "events" && e.text == "a line")
    );
    let springs = channels.iter().find(|c| c.name == "spring_m").unwrap();
    assert_eq!((springs.rows, springs.unit.as_str()), (250, "m"));
    assert!((springs.rate_hz - 100.0).abs() < 1e-6);
    std::fs::remove_file(path).unwrap();
}

/// A recording cut anywhere gives a prefix of what was recorded, and says that it was cut.
#[test]
fn truncation_gives_a_prefix() {
    let path = temp("cut");
    let written = snapshots(250);
    write(&path, &written);
    let bytes = std::fs::read(&path).unwrap();
    let mut most = 0;
    let cuts = (0..bytes.len()).step_by(bytes.len() / 83).chain([
        bytes.len() - 1,
        bytes.len() - 33,
        11,
        12,
        13,
    ]);
    for n in cuts {
        std::fs::write(&path, &bytes[..n]).unwrap();
        match read_rrd(&path) {
            Ok(r) => {
                assert!(!r.complete, "cut at {n}");
                assert_same(&r.trace.snapshots, &written);
                let last = r.trace.snapshots.last().map_or(Stamp::ZERO, |s| s.stamp);
                assert_eq!(r.recovered_until, Some(last));
                most = most.max(r.trace.snapshots.len());
            }
            // Before the description has arrived there is nothing to recover.
            Err(RecordingError::Corrupt { offset, .. }) => assert!(offset == 0 && n < 12),
            Err(RecordingError::Unsupported { .. }) => assert!(n < bytes.len() / 3, "{n}"),
            Err(e) => panic!("{e}"),
        }
    }
    // Without its footer the recording is whole but for the word that it is.
    assert_eq!(most, 250);
    std::fs::remove_file(path).unwrap();
}

/// After a power cut the file has some length that it had, and any of the pages that were not brought onto the disk are empty.
/// Everything that was brought there is read.
#[test]
fn a_power_cut_takes_only_what_was_not_brought_onto_the_disk() {
    const PAGE: usize = 4096;
    let path = temp("power");
    let written = snapshots(900);
    let mut w = RecordingWriter::create(&path, meta()).unwrap();
    let mut synced = Vec::new();
    for (n, s) in written.iter().enumerate() {
        w.push(s).unwrap();
        if n % 200 == 199 {
            w.sync().unwrap();
            synced.push((w.summary().bytes as usize, w.summary().rows as usize));
        }
    }
    w.flush().unwrap();
    let bytes = std::fs::read(&path).unwrap();
    w.finish().unwrap();
    let mut rng = Pcg64Mcg::seed_from_u64(8);
    let mut cut = 0;
    for (from, rows) in synced {
        for n in 0..40 {
            let end = match n {
                0 => bytes.len(),
                _ => rng.random_range(from..=bytes.len()),
            };
            let mut left = bytes[..end].to_vec();
            for page in (from.next_multiple_of(PAGE)..end).step_by(PAGE) {
                if n == 0 || rng.random_range(0..2) == 0 {
                    left[page..end.min(page + PAGE)].fill(0);
                }
            }
            std::fs::write(&path, &left).unwrap();
            let read = read_rrd(&path).unwrap_or_else(|e| panic!("{from} of {end}: {e}"));
            let recovered = &read.trace.snapshots;
            assert!(!read.complete && recovered.len() >= rows, "{from} of {end}");
            assert_same(recovered, &written);
            cut += usize::from(recovered.len() < written.len());
        }
    }
    assert!(cut > 100, "{cut}");
    std::fs::remove_file(path).unwrap();
}

#[test]
fn damage_names_a_place_or_changes_numbers_only() {
    let path = temp("flip");
    write(&path, &snapshots(90));
    let bytes = std::fs::read(&path).unwrap();
    let mut rng = Pcg64Mcg::seed_from_u64(5);
    for _ in 0..150 {
        let mut damaged = bytes.clone();
        for _ in 0..3 {
            let at = rng.random_range(0..bytes.len());
            damaged[at] ^= 1 << rng.random_range(0..8);
        }
        std::fs::write(&path, &damaged).unwrap();
        match read_rrd(&path) {
            Ok(r) => assert!(r.trace.snapshots.len() <= 90),
            Err(RecordingError::Corrupt { offset, .. }) => {
                assert!(offset < bytes.len() as u64);
            }
            Err(RecordingError::Unsupported { .. }) => {}
            Err(e) => panic!("{e}"),
        }
    }
    std::fs::remove_file(path).unwrap();
}

#[test]
fn full_disk_stops_cleanly_and_keeps_what_was_whole() {
    let path = temp("full");
    let written = snapshots(400);
    let mut w = RecordingWriter::create(&path, meta()).unwrap();
    let mut error = None;
    for (i, s) in written.iter().enumerate() {
        if i == 200 {
            w.fill_disk_after(5000);
        }
        if let Err(e) = w.push(s) {
            error = Some((i, e));
            break;
        }
    }
    let (at, error) = error.unwrap();
    assert!(matches!(error, RecordingError::Write { .. }) && at < 300);
    assert!(matches!(
        w.push(&written[at + 1]),
        Err(RecordingError::Stopped { .. })
    ));
    let rows = w.summary().rows as usize;
    drop(w);
    let r = read_rrd(&path).unwrap();
    assert!(!r.complete && rows > 100);
    assert_eq!(r.trace.snapshots.len(), rows);
    assert_same(&r.trace.snapshots, &written);
    std::fs::remove_file(path).unwrap();
}

#[cfg(target_os = "linux")]
#[test]
fn no_room_at_all_is_an_error() {
    let full = std::path::Path::new("/dev/full");
    assert!(matches!(
        RecordingWriter::create(full, meta()),
        Err(RecordingError::Write { .. })
    ));
}

#[test]
fn repeats_and_unsound_values_are_left_out() {
    let path = temp("unsound");
    let mut written = snapshots(3);
    written[1].raw.as_mut().unwrap().imu[2].gyro_rad_s[1] = f64::NAN;
    written[1].estimate.as_mut().unwrap().covariance[(2, 2)] = f64::INFINITY;
    let mut w = RecordingWriter::create(&path, meta()).unwrap();
    for s in &written {
        w.push(s).unwrap();
        w.push(s).unwrap();
    }
    let summary = w.finish().unwrap();
    assert_eq!(
        (summary.rows, summary.repeated, summary.rejected),
        (3, 3, 2)
    );
    let r = read_rrd(&path).unwrap();
    let middle = &r.trace.snapshots[1];
    assert!(middle.raw.is_none() && middle.estimate.is_none() && middle.sensors.is_some());
    assert_eq!(r.trace.snapshots[2].raw, written[2].raw);
    std::fs::remove_file(path).unwrap();
}

#[test]
fn dropping_ends_the_file() {
    let path = temp("drop");
    let written = snapshots(10);
    let mut w = RecordingWriter::create(&path, meta()).unwrap();
    for s in &written {
        w.push(s).unwrap();
    }
    drop(w);
    let r = read_rrd(&path).unwrap();
    assert!(r.complete && r.trace.snapshots.len() == 10);
    std::fs::remove_file(path).unwrap();
}

/// A second of data is on disk without anyone asking for it.
#[test]
fn less_than_a_second_is_at_risk() {
    let path = temp("risk");
    let written = snapshots(300);
    let mut w = RecordingWriter::create(&path, meta()).unwrap();
    for (i, s) in written.iter().enumerate() {
        w.push(s).unwrap();
        if i % 37 == 0 {
            let r = read_rrd(&path);
            let until = r.ok().and_then(|r| r.recovered_until);
            let lost_s = s.stamp.since(until.unwrap_or(Stamp::ZERO));
            assert!(lost_s < 1.0, "{lost_s} s would be lost at {i}");
        }
    }
    drop(w);
    std::fs::remove_file(path).unwrap();
}

/// A recording that went on in further files reads as one, whole and by range, also while its last file is open.
#[test]
fn segments_are_one_recording() {
    let path = temp("segments");
    let written = snapshots(900);
    let limits = SegmentLimits {
        bytes: u64::MAX,
        ns: 2_000_000_000,
    };
    let mut w = RecordingWriter::create_with(&path, meta(), None, limits).unwrap();
    for s in &written {
        w.push(s).unwrap();
        if s.stamp.0 > 5_000_000_000 && s.stamp.0 < 5_010_000_000 {
            w.event(s.stamp, "in the middle").unwrap();
        }
    }
    let open = read_rrd(&path).unwrap();
    assert!(!open.complete && open.trace.snapshots.len() > 800);
    let summary = w.finish().unwrap();
    assert_eq!(summary.segments, 4);
    let paths: Vec<PathBuf> = (1..=4).map(|n| segment_path(&path, n)).collect();
    let bytes: u64 = paths
        .iter()
        .map(|p| std::fs::metadata(p).unwrap().len())
        .sum();
    assert_eq!(summary.bytes, bytes);

    let file = RecordingFile::open(&path).unwrap();
    assert!(file.is_complete());
    let size = (file.segments(), file.rows(), file.bytes(), file.last());
    assert_eq!(size, (4, Some(900), bytes, Some(written[899].stamp)));
    let whole = file.read(&Selection::default(), &mut |_| true).unwrap();
    assert_eq!(whole.trace.snapshots.len(), 900);
    assert_same(&whole.trace.snapshots, &written);
    assert!(whole.events.iter().any(|e| e.text == "in the middle"));

    // Over the end of a file, without what is carried over from before.
    let selection = Selection {
        from: Some(written[240].stamp),
        to: Some(written[330].stamp),
        at_least_apart_s: 0.0,
    };
    let part = file.read(&selection, &mut |_| true).unwrap();
    assert_eq!(part.trace.snapshots.len(), 91);
    assert_same(&part.trace.snapshots, &written[240..=330]);
    assert!(part.events.iter().all(|e| selection.contains(e.stamp.0)));
    let thin = Selection {
        at_least_apart_s: 0.1,
        ..Selection::default()
    };
    let thin = file.read(&thin, &mut |_| true).unwrap().trace.snapshots;
    assert!((80..=90).contains(&thin.len()), "{}", thin.len());
    assert!(
        thin.windows(2)
            .all(|w| w[1].stamp.since(w[0].stamp) >= 0.099_999)
    );

    // A segment alone is read alone; one that is gone ends the recording before it.
    assert_eq!(
        read_rrd(&paths[3]).unwrap().trace.snapshots.len(),
        900 - 3 * 244
    );
    std::fs::remove_file(&paths[2]).unwrap();
    assert_eq!(read_rrd(&path).unwrap().trace.snapshots.len(), 2 * 244);
    // Parts whose beginning is gone are not written over.
    std::fs::remove_file(&path).unwrap();
    let refused = RecordingWriter::create(&path, meta());
    assert!(matches!(refused, Err(RecordingError::Stray { .. })));
    for path in [&paths[1], &paths[3]] {
        std::fs::remove_file(path).unwrap();
    }
}

/// What was measured is the same, read at once and in windows; and so is what is found in it.
#[test]
fn windows_give_the_rows_of_the_whole() {
    let path = temp("windows");
    let written = snapshots(1500);
    write(&path, &written);
    let file = RecordingFile::open(&path).unwrap();
    let whole = file.read(&Selection::default(), &mut |_| true).unwrap();
    let expected = SessionLog::from_trace(&whole.trace, 0.0);
    let (mut log, mut inspector, mut windows) = (SessionLog::default(), Inspector::default(), 0);
    let mut each = |window: Window| {
        log.append(window.log());
        inspector.take(&window);
        windows += 1;
    };
    file.read_in_windows_of(7, &Selection::default(), &mut |_| true, &mut each)
        .unwrap();
    assert_eq!((windows, log.len()), (4, expected.len()));
    assert_eq!(log.t_s, expected.t_s);
    assert_eq!(log.truth, expected.truth);
    assert_eq!(log.payload_column_kg, expected.payload_column_kg);
    let bits = |log: &SessionLog| -> Vec<u64> {
        let rows = log.sensors.iter().flat_map(|s| {
            s.to_vector()
                .iter()
                .map(|x| x.to_bits())
                .collect::<Vec<_>>()
        });
        rows.collect()
    };
    assert!(bits(&log) == bits(&expected));
    let mut at_once = Inspector::default();
    at_once.take(&Window::alone(whole));
    let (found, expected) = (inspector.finish(), at_once.finish());
    assert_eq!(
        (found.samples, found.health),
        (expected.samples, expected.health)
    );
    for (found, expected) in found.channels.iter().zip(&expected.channels) {
        assert_eq!((&found.name, found.rows), (&expected.name, expected.rows));
        let min = |c: &crate::recording::Channel| c.values.map(|v| (v.min, v.max));
        assert_eq!(min(found), min(expected), "{}", found.name);
    }
    std::fs::remove_file(path).unwrap();
}

/// A recording of two windows, or a part of it, comes snapshot by snapshot; not where there is no memory for what is kept.
#[test]
fn each_snapshot_of_several_windows_comes_once() {
    let path = temp("each");
    let mut w = RecordingWriter::create(&path, meta()).unwrap();
    for n in 0..1100 {
        w.push(&Snapshot {
            stamp: Stamp(n * 1_000_000_000),
            ..Snapshot::default()
        })
        .unwrap();
    }
    w.finish().unwrap();
    let seen = |path: &std::path::Path, kept_bytes| {
        let mut seen = Vec::new();
        let each = &mut |s: &Snapshot| seen.push(s.stamp);
        each_snapshot(path, kept_bytes, each).map(|meta| (seen, meta.name))
    };
    let (all, name) = seen(&path, 8).unwrap();
    assert_eq!(name, meta().name);
    let at =
        |range: std::ops::Range<i64>| range.map(|n| Stamp(n * 1_000_000_000)).collect::<Vec<_>>();
    assert!(all == at(0..1100), "{}", all.len());
    let part = PathBuf::from(format!("{}@998..1002", path.display()));
    assert_eq!(seen(&part, 8).unwrap().0, at(998..1003));
    let none = seen(&path, 1 << 50).unwrap_err();
    assert!(matches!(none, RecordingError::TooLarge { .. }), "{none}");
    std::fs::remove_file(path).unwrap();
}

/// The same snapshots give the same bytes, in recordings that are made of another one.
#[test]
fn equal_snapshots_make_equal_files() {
    let path = temp("equal");
    let written = snapshots(300);
    write(&path, &written);
    let source = RecordingFile::open(&path).unwrap();
    let out = temp("equal-out");
    let bytes = || {
        let mut w = RecordingWriter::create_like(&out, meta(), &source).unwrap();
        for s in &written {
            w.push(s).unwrap();
        }
        w.finish().unwrap();
        std::fs::read(&out).unwrap()
    };
    let (first, second) = (bytes(), bytes());
    let differs = first.iter().zip(&second).position(|(a, b)| a != b);
    assert_eq!((first.len(), differs), (second.len(), None));
    let read = read_rrd(&out).unwrap();
    assert!(read.complete && read.trace.snapshots.len() == 300);
    for path in [path, out] {
        std::fs::remove_file(path).unwrap();
    }
}

/// A recording of layout 1, as programs before this one made it.
#[test]
fn layout_1_is_read() {
    let path =
        std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/it/golden/layout-1.rrd");
    let read = read_rrd(&path).unwrap();
    assert!(read.complete && !read.meta.calibration.is_empty());
    assert_eq!(read.meta.robot, "reference");
    let snapshots = &read.trace.snapshots;
    assert_eq!(snapshots.len(), 151);
    let last = snapshots.last().unwrap();
    assert_eq!(last.mode, Mode::Moving);
    assert_eq!(last.goal.as_ref().unwrap().position_m, [0.02, 0.01, -0.3]);
    let frame = last.sensors.as_ref().unwrap();
    assert_eq!(frame.sensors.spring_m[4], 0.152_339_661_078_317_42);
    let some = |has: fn(&Snapshot) -> bool| snapshots.iter().filter(|s| has(s)).count();
    assert_eq!(
        [
            some(|s| s.raw.is_some()),
            some(|s| s.estimate.is_some()),
            some(|s| s.truth.is_some()),
            some(|s| s.command.is_some()),
        ],
        [150, 149, 151, 49]
    );
    let from = Selection::between(Some(1.0), None);
    let part = RecordingFile::open(&path)
        .unwrap()
        .read(&from, &mut |_| true)
        .unwrap();
    assert!(
        part.trace
            .snapshots
            .iter()
            .all(|s| s.stamp.seconds() >= 1.0)
    );
}

/// Tables that another tool has put in another order are read all the same.
#[test]
fn order_of_the_tables_does_not_matter() {
    let path = temp("order");
    let written = snapshots(500);
    write(&path, &written);
    let bytes = std::fs::read(&path).unwrap();
    let frames = frames::split(&mut std::io::Cursor::new(&bytes), bytes.len() as u64).unwrap();
    let n = frames.messages.len();
    // The description stays in front; the data come backwards.
    let order = (0..n / 4).chain((n / 4..n).rev());
    let mut turned = bytes[..frames::HEADER_BYTES].to_vec();
    for i in order {
        let place = frames.messages[i];
        turned.extend(&bytes[place.offset as usize..place.end() as usize]);
    }
    std::fs::write(&path, &turned).unwrap();
    let read = read_rrd(&path).unwrap();
    assert_eq!(read.trace.snapshots.len(), 500);
    assert_same(&read.trace.snapshots, &written);
    std::fs::remove_file(path).unwrap();
}

/// Rerun converts what is not as this program writes it, at many times the cost: nothing of ours should need that.
#[test]
fn columns_are_read_as_they_lie_in_the_file() {
    let path = temp("columns");
    write(&path, &snapshots(250));
    let bytes = std::fs::read(&path).unwrap();
    let index = index::Index::open(&path).unwrap();
    let mut reader = index.reader(0).unwrap();
    assert!(index.data.len() > 1);
    for batch in &index.data {
        let place = batch.place;
        let message = &bytes[place.offset as usize..place.end() as usize];
        let mut unpacked = Vec::new();
        let (_, table) = frames::table(message, 1 << 24, &mut unpacked)
            .unwrap()
            .unwrap();
        let own = columns::Columns::of_ipc(table).unwrap().unwrap();
        let chunk = reader.table(place).unwrap().unwrap();
        let converted = columns::Columns::of_chunk(&chunk).unwrap();
        assert_eq!(own.times, converted.times);
        assert_eq!(own.lists, converted.lists);
        assert!(own.times.len() as u64 == batch.rows && own.lists[0].is_some());
    }
    std::fs::remove_file(path).unwrap();
}

#[test]
fn reading_reports_how_far_it_is_and_can_be_given_up() {
    let path = temp("progress");
    let written = snapshots(9000);
    write(&path, &written);
    let mut shares = Vec::new();
    let read = read_all(&path, &mut |share| {
        shares.push(share);
        true
    });
    assert_eq!(read.unwrap().trace.snapshots.len(), 9000);
    assert!(shares.len() > 3 && shares.is_sorted() && shares.last() == Some(&1.0));
    let given_up = read_all(&path, &mut |share| share < 0.5);
    let Err(RecordingError::Io { source, .. }) = given_up else {
        panic!("it was given up");
    };
    assert_eq!(source.kind(), std::io::ErrorKind::Interrupted);
    std::fs::remove_file(path).unwrap();
}

/// The shipped recordings are older than entities of their own for exact values.
#[test]
fn the_shipped_recordings_hold_what_they_show() {
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("recordings");
    for name in ["point-to-point", "payload-200g"] {
        let read = read_rrd(&folder.join(name).with_extension("rrd")).unwrap();
        let of =
            |has: fn(&Snapshot) -> bool| read.trace.snapshots.iter().filter(|s| has(s)).count();
        let n = read.trace.snapshots.len();
        assert!(n >= 500, "{name}: {n}");
        for count in [
            of(|s| s.sensors.is_some()),
            of(|s| s.estimate.is_some()),
            of(|s| s.truth.is_some()),
            of(|s| s.raw.is_some()),
        ] {
            assert!(count > n * 9 / 10, "{name}: {count} of {n}");
        }
        assert!(of(|s| s.goal.is_some()) > n / 2 && of(|s| s.command.is_some()) > n / 2);
    }
}

#[test]
fn a_recording_that_is_being_written_is_not_written_over() {
    let path = temp("in-use");
    std::fs::write(&path, "of another day").unwrap();
    let mut rng = Pcg64Mcg::seed_from_u64(3);
    let mut first = RecordingWriter::create(&path, meta()).unwrap();
    first.push(&snapshot(1, &mut rng)).unwrap();
    let Err(refused) = RecordingWriter::create(&path, meta()) else {
        panic!("two recordings in one file");
    };
    assert!(matches!(refused, RecordingError::InUse { .. }), "{refused}");
    let text = refused.to_string();
    assert!(text.contains("choose another name"), "{text}");
    first.push(&snapshot(2, &mut rng)).unwrap();
    first.finish().unwrap();
    let read = read_rrd(&path).unwrap();
    assert_eq!(read.trace.snapshots.len(), 2);
    // One that has ended is replaced.
    RecordingWriter::create(&path, meta()).unwrap();
    std::fs::remove_file(path).unwrap();
}

mod edit;
mod long;
