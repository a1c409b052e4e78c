//! Bags of other labs, by maps.

use std::collections::BTreeMap;
use std::io::Cursor;
use std::path::Path;

use ::mcap::records::MessageHeader;
use ::mcap::{Compression, WriteOptions};

use super::{MAP, NAME, bag_of, session};
use crate::recording::hostile::assert_sentence;
use crate::recording::mcap::messages::{self, MessageKind};
use crate::recording::mcap::rows::{held, nearest};
use crate::recording::{BagMap, MappedBag, parse_mcap};
use crate::signal::{CHAMBERS, Stamp, pose_from_ypr, spring_name};

/// A message of another program: type, bytes, stamp of the header and time of the bag in s.
pub(super) type Foreign = (&'static str, MessageKind, f64, Vec<u8>);

pub(super) fn foreign(messages: &[Foreign], compression: Option<Compression>) -> Vec<u8> {
    let mut out = Cursor::new(Vec::new());
    let options = WriteOptions::new()
        .compression(compression)
        .chunk_size(Some(2000));
    let mut writer = options.create(&mut out).expect("a writer");
    for (topic, kind, log_s, bytes) in messages {
        let definition = kind.definition();
        let schema = writer
            .add_schema(kind.name(), "ros2msg", definition.as_bytes())
            .expect("a schema");
        let channel_id = writer
            .add_channel(schema, topic, "cdr", &BTreeMap::new())
            .expect("a channel");
        let log_time = Stamp::from_seconds(*log_s).0 as u64;
        let header = MessageHeader {
            channel_id,
            sequence: 0,
            log_time,
            publish_time: log_time,
        };
        writer
            .write_to_known_channel(&header, bytes)
            .expect("writes");
    }
    writer.finish().expect("ends");
    drop(writer);
    out.into_inner()
}

fn lengths(t_s: f64, m: f64) -> Vec<u8> {
    let springs: Vec<(String, f64)> = (0..12).map(|i| (spring_name(i), m)).collect();
    messages::joint_state(Stamp::from_seconds(t_s), &springs)
}

fn pressure(t_s: f64, pa: f64) -> Vec<u8> {
    messages::fluid_pressure(Stamp::from_seconds(t_s), "", pa)
}

const LAB: &str = r#"
rows = "/springs"
near_s = 0.004
[pressure]
fields = ["/p.fluid_pressure", 0, 0, 0, 0, 0]
unit = "Pa"
zero = [101325.0, 0, 0, 0, 0, 0]
[command]
fields = ["/set.fluid_pressure", 0, 0, 0, 0, 0]
unit = "kPa"
hold = true
[springs]
fields = ["/springs.position[1A]", 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0]
unit = "mm"
[bodies]
end = "/cameras.transforms[child_frame_id=end].transform"
"#;

/// Springs every 10 ms from 1000 s on, pressures every 20 ms and 1 ms later, one command, cameras between them.
pub(super) fn lab() -> Vec<Foreign> {
    let mut out: Vec<Foreign> = Vec::new();
    for k in 0..10 {
        let t_s = 1000.0 + 0.01 * f64::from(k) + if k > 6 { 2.0 } else { 0.0 };
        out.push((
            "/springs",
            MessageKind::JointState,
            t_s,
            lengths(t_s, 150.0 + f64::from(k)),
        ));
        if k % 2 == 0 {
            let p_s = t_s + 0.001;
            let pa = 101_325.0 + 100.0 * f64::from(k);
            out.push(("/p", MessageKind::FluidPressure, p_s, pressure(p_s, pa)));
            let pose = pose_from_ypr([0.0, 0.0, -0.001 * f64::from(k)], [0.0; 3]);
            let stamp = Stamp::from_seconds(p_s);
            let bytes = messages::transforms(stamp, "w", &[("other", pose), ("end", pose)]);
            out.push(("/cameras", MessageKind::Transforms, p_s, bytes));
        }
    }
    let set = pressure(1000.025, 7.0);
    out.push(("/set", MessageKind::FluidPressure, 1000.025, set));
    out
}

pub(super) fn map(text: &str, bytes: &[u8]) -> Result<MappedBag, String> {
    let map = BagMap::from_toml(text)?;
    let read = map.read_bag(bytes, Path::new(NAME));
    read.map_err(|e| e.to_string())
}

#[test]
fn a_bag_of_another_lab_is_read_by_a_map() {
    for compression in [None, Some(Compression::Zstd), Some(Compression::Lz4)] {
        let MappedBag { log, notes } = map(LAB, &foreign(&lab(), compression)).expect("reads");
        assert_eq!(log.t_s.len(), 10);
        assert!((log.t_s[9] - 2.09).abs() < 1e-9 && log.t_s[0] == 0.0);
        assert!((log.sensors[3].spring_m[0] - 0.153).abs() < 1e-12);
        assert!(log.sensors[3].spring_m[1].is_nan());
        // Nothing is interpolated: every other row has a pressure.
        let p: Vec<f64> = log.gauge_pa.iter().map(|p| p[0]).collect();
        assert!(
            (p[2] - 200.0).abs() < 1e-9 && p[3].is_nan() && (p[8] - 800.0).abs() < 1e-9,
            "{p:?}"
        );
        let set = log.commanded_pa.expect("set");
        assert!(set[2][0].is_nan() && set[3][0] == 7e3 && set[9][0] == 7e3);
        assert_eq!(log.bodies.tracked, [false, false, true]);
        assert_eq!(log.bodies.poses[2].iter().flatten().count(), 5);
        assert!(
            notes
                .iter()
                .any(|n| n.contains("longest gap between rows is 2.01 s, at 0.06 s")),
            "{notes:?}"
        );
        assert!(
            notes
                .iter()
                .any(|n| n.contains("the stamps of the headers")),
            "{notes:?}"
        );
    }
}

#[test]
fn clocks_that_jump_or_differ_are_refused() {
    let refused = |text: &str, messages: &[Foreign], wrong: &str| {
        let e = map(text, &foreign(messages, None)).expect_err(wrong);
        assert_sentence(&e);
        assert!(e.contains(wrong), "{e}");
    };
    let mut back = lab();
    let last = back.len();
    back.push((
        "/springs",
        MessageKind::JointState,
        1002.2,
        lengths(1000.0, 1.0),
    ));
    refused(
        LAB,
        &back,
        "/springs: its clock jumps back by 2.090 s at message 11",
    );
    // By the times of the bag it does not.
    let by_log = format!("clock = \"log\"\n{LAB}");
    assert_eq!(
        map(&by_log, &foreign(&back, None))
            .expect("reads")
            .log
            .t_s
            .len(),
        11
    );
    back[last] = back[9].clone();
    back.swap(9, last);
    let twice = map(LAB, &foreign(&back, None)).expect("reads");
    assert!(
        twice.notes.iter().any(|n| n.contains("1 of ")),
        "{:?}",
        twice.notes
    );

    // A board's clock that is 900 s behind, and a bag of which a topic was recorded 900 s earlier.
    let mut other = lab();
    for m in other.iter_mut().filter(|m| m.0 == "/p") {
        m.3 = pressure(m.2 - 900.0, 1e5);
    }
    refused(
        LAB,
        &other,
        "the stamps of /p are 900.0 s off the times at which the bag received them, and those of /springs 0.0 s: set",
    );
    for m in other.iter_mut().filter(|m| m.0 == "/p") {
        m.2 -= 900.0;
    }
    refused(
        LAB,
        &other,
        "no message of /p belongs to a row: its clock runs from 100.001",
    );
    for m in other.iter_mut().filter(|m| m.0 == "/p") {
        // A header that was not filled in, beside one of the board's own time.
        m.3 = pressure(0.0, 1e5);
    }
    for m in other.iter_mut().filter(|m| m.0 == "/springs") {
        m.3 = lengths(m.2 - 990.0, 1.0);
    }
    refused(LAB, &other, "set clock = \"log\"");
}

#[test]
fn what_does_not_fit_the_map_is_refused() {
    let bytes = foreign(&lab(), Some(Compression::Zstd));
    for (from, to, wrong) in [
        (
            "\"/p.fluid",
            "\"/q.fluid",
            "the topic /q, and its topics are /cameras, /p, /set, /springs",
        ),
        (
            "fluid_pressure\", 0, 0, 0, 0, 0]\nunit = \"Pa",
            "pressure\", 0, 0, 0, 0, 0]\nunit = \"Pa",
            "has header, fluid_pressure, variance",
        ),
        ("unit = \"mm\"", "unit = \"inch\"", "it can be m, mm"),
        (
            "[\"/p.fluid_pressure\", 0,",
            "[\"/p.fluid_pressure\",",
            "[pressure] names 5 fields",
        ),
        (
            "[\"/p.fluid_pressure\", 0,",
            "[\"/p.fluid_pressure\", 3,",
            "a number that is no field",
        ),
        (
            "rows = \"/springs\"",
            "rows = \"/x\"",
            "of which the map reads nothing",
        ),
        ("near_s = 0.004", "near_s = -1.0", "near_s"),
        ("near_s = 0.004", "nears = 1.0", "unknown field `nears`"),
        (
            "\"/p.fluid_pressure\"",
            "\"p.fluid_pressure\"",
            "names no topic",
        ),
        ("101325.0, 0, ", "101325.0, ", "zero needs 6 numbers"),
        (".transform\"", "\"", "a pose or transform is needed"),
    ] {
        let text = LAB.replacen(from, to, 1);
        assert_ne!(text, LAB, "{from}");
        let e = map(&text, &bytes).expect_err(wrong);
        assert_sentence(&e);
        assert!(e.contains(wrong), "{e}");
    }
    let e = parse_mcap(bytes.as_slice(), Path::new(NAME)).expect_err("of another program");
    let e = e.to_string();
    assert!(
        e.contains("import log MAP.toml")
            && e.contains("/springs (sensor_msgs/msg/JointState, 10)"),
        "{e}"
    );
    let mut cut = lab();
    cut[0].3.truncate(20);
    let e = map(LAB, &foreign(&cut, None)).expect_err("cut");
    assert!(
        e.contains("/springs: message 1 does not fit its definition") && e.contains("field"),
        "{e}"
    );
}

#[test]
fn the_map_of_our_own_topics_gives_the_session_too() {
    let log = session(40);
    let bytes = bag_of(&log, "mapped");
    let read = map(MAP, &bytes).expect("reads").log;
    // A row of springs for each sample, since no sample lacks all of them.
    assert_eq!(read.t_s.len(), log.len());
    for k in 0..log.len() {
        let same = |a: f64, b: f64| a == b || a.is_nan() && b.is_nan();
        for i in 0..12 {
            assert!(same(
                read.sensors[k].spring_m[i],
                log.sensors[k].spring_m[i]
            ));
        }
        for i in 0..CHAMBERS {
            assert!(same(read.gauge_pa[k][i], log.chamber_pa[k][i]));
        }
        assert_eq!(
            read.payload_kg.as_ref().map(|m| m[k]),
            Some(log.payload_at_kg(k))
        );
    }
    let poses = log.truth.iter().flatten().count();
    assert_eq!(read.bodies.poses[2].iter().flatten().count(), poses);
}

#[test]
fn messages_belong_to_the_nearest_row() {
    let rows = [0, 10, 20, 30];
    assert_eq!(
        nearest(&rows, &[4, 6, 9, 29, 31, 45], 6),
        [Some(0), Some(2), None, Some(3)]
    );
    assert_eq!(nearest(&rows, &[], 6), [None; 4]);
    assert!(nearest(&[], &[1], 6).is_empty());
    assert_eq!(
        held(&rows, &[10, 15, 40]),
        [None, Some(0), Some(1), Some(1)]
    );
}
