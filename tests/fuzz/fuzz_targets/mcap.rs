//! MCAP files: whole ones, and definitions with messages of the topics that a map reads.
//!
//! An input that does not begin like an MCAP file is a definition of messages, a zero, and messages, each behind its length (one
//! byte); they are put into a file.
#![no_main]

use std::path::Path;
use std::sync::LazyLock;

use libfuzzer_sys::fuzz_target;
use springtwin::recording::{BagMap, parse_mcap};

static MAP: LazyLock<BagMap> = LazyLock::new(|| BagMap::from_toml(TEXT).expect("the map reads"));
const TEXT: &str = r#"
rows = "/springs"
[pressure]
fields = ["/payload.data", "/springs.position[0]", 0, 0, 0, 0]
unit = "kPa"
[springs]
fields = ["/springs.position[1A]", "/springs.data", 0, 0, 0, 0, 0, 0, 0, 0, 0, 0]
unit = "mm"
[imus]
orientations = ["/imu1/data.orientation", 0, 0, 0]
[payload]
field = "/payload.data"
unit = "g"
hold = true
[bodies]
base = "/mocap/pose.pose"
end = "/mocap/pose.pose"
"#;
const MAGIC: &[u8] = b"\x89MCAP0\r\n";
const TOPICS: [&str; 4] = ["/springs", "/imu1/data", "/mocap/pose", "/payload"];

fn counted(out: &mut Vec<u8>, bytes: &[u8]) {
    out.extend_from_slice(&(bytes.len() as u32).to_le_bytes());
    out.extend_from_slice(bytes);
}

fn record(out: &mut Vec<u8>, opcode: u8, content: &[u8]) {
    out.push(opcode);
    out.extend_from_slice(&(content.len() as u64).to_le_bytes());
    out.extend_from_slice(content);
}

fn file(definition: &[u8], mut messages: &[u8]) -> Vec<u8> {
    let mut out = MAGIC.to_vec();
    let mut schema = vec![1, 0];
    for part in [b"a/msg/A".as_slice(), b"ros2msg", definition] {
        counted(&mut schema, part);
    }
    record(&mut out, 3, &schema);
    for (id, topic) in TOPICS.iter().enumerate() {
        let mut channel = vec![id as u8, 0, 1, 0];
        for part in [topic.as_bytes(), b"cdr", b""] {
            counted(&mut channel, part);
        }
        record(&mut out, 4, &channel);
    }
    let mut n = 0_u64;
    while let Some((length, rest)) = messages.split_first() {
        let (content, rest) = rest.split_at(rest.len().min(usize::from(*length)));
        messages = rest;
        n += 1;
        let mut message = vec![(n % TOPICS.len() as u64) as u8, 0, 0, 0, 0, 0];
        message.extend_from_slice(&n.to_le_bytes());
        message.extend_from_slice(&n.to_le_bytes());
        message.extend_from_slice(&[0, 1, 0, 0]);
        message.extend_from_slice(content);
        record(&mut out, 5, &message);
    }
    out
}

/// Columns are of one length, times rise, and what is refused is one sentence.
fn check(bytes: &[u8]) {
    let path = Path::new("x.mcap");
    let sentence = |text: String| assert!(!text.is_empty() && !text.contains('\n'), "{text}");
    match parse_mcap(bytes, path) {
        Ok(bag) => {
            let (log, n) = (&bag.log, bag.log.len());
            assert_eq!(
                [log.chamber_pa.len(), log.sensors.len(), log.truth.len()],
                [n; 3]
            );
            assert!(log.commanded_pa.as_ref().is_none_or(|u| u.len() == n));
            assert!(log.t_s.windows(2).all(|w| w[0] < w[1]));
        }
        Err(e) => sentence(e.to_string()),
    }
    match MAP.read_bag(bytes, path) {
        Ok(bag) => {
            let (log, n) = (&bag.log, bag.log.t_s.len());
            assert_eq!([log.gauge_pa.len(), log.sensors.len()], [n; 2]);
            assert!(log.t_s.windows(2).all(|w| w[0] < w[1]));
            let bodies = &log.bodies;
            assert!(bodies.poses.iter().all(|p| p.len() == bodies.t_s.len()));
        }
        Err(e) => sentence(e.to_string()),
    }
}

fuzz_target!(|data: &[u8]| {
    if data.starts_with(MAGIC) {
        check(data);
        return;
    }
    let end = data.iter().position(|b| *b == 0).unwrap_or(data.len());
    let messages = data.get(end + 1..).unwrap_or_default();
    check(&file(&data[..end], messages));
});
