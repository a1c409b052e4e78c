//! The protocol as a C header for the boards' firmware, made from what this crate sends and accepts.

use std::fmt::Write as _;

use super::{
    ALL_BOARDS, BAUD, Config, HEARTBEAT_TIMEOUT_MS, LONGEST_TTL_MS, PRELOAD_S, PRESSURE_STEP_PA,
    SAMPLE_RATE_HZ, SCHEMA, SCHEMA_HASH, SLEW_PA_S, TICK_RATE_HZ, VENT_PA_S, VENTED_PA, VERSION,
    fault, flag,
};

const FLAGS: [(&str, u16); 8] = [
    ("CONFIGURED", flag::CONFIGURED),
    ("PUMPS_ON", flag::PUMPS_ON),
    ("GRIPPER_CLOSED", flag::GRIPPER_CLOSED),
    ("SIMULATED", flag::SIMULATED),
    ("GRIPPER_AS_IT_WAS", flag::GRIPPER_AS_IT_WAS),
    ("STOP_OPEN", flag::STOP_OPEN),
    ("SUPPLY_CUT", flag::SUPPLY_CUT),
    ("VENTING", flag::VENTING),
];

const FAULTS: [(&str, u16); 12] = [
    ("SAFE", fault::SAFE),
    ("ESTOP", fault::ESTOP),
    ("HEARTBEAT_LOST", fault::HEARTBEAT_LOST),
    ("OVER_PRESSURE", fault::OVER_PRESSURE),
    ("GAUGE_LOST", fault::GAUGE_LOST),
    ("SETPOINT_EXPIRED", fault::SETPOINT_EXPIRED),
    ("SPRING_LOST", fault::SPRING_LOST),
    ("IMU_LOST", fault::IMU_LOST),
    ("BOOTED", fault::BOOTED),
    ("STOP_INPUT", fault::STOP_INPUT),
    ("ENDED", fault::ENDED),
    ("CONTROL_SILENT", fault::CONTROL_SILENT),
];

/// One struct of [`SCHEMA`]: its message type (none for the header), name, C members and size in bytes.
struct Layout<'a> {
    code: Option<&'a str>,
    name: &'a str,
    members: Vec<String>,
    bytes: usize,
}

fn layouts() -> Vec<Layout<'static>> {
    SCHEMA
        .lines()
        .filter_map(|line| line.split_once(':'))
        .filter(|(name, _)| *name != "scales")
        .map(|(head, fields)| {
            let (code, name) = match head.split_once(' ') {
                Some((code, name)) => (Some(code), name),
                None => (None, head),
            };
            let mut bytes = 0;
            let fields = fields.split(',').map(str::trim).filter(|f| !f.is_empty());
            let members = fields.map(|field| {
                let (member, kind) = field.split_once(' ').expect("a name and a type");
                let (kind, count) = match kind.split_once('*') {
                    Some((kind, n)) => (kind, Some(n)),
                    None => (kind, None),
                };
                let sign = if kind.starts_with('u') { "u" } else { "" };
                let bits: usize = kind[1..].parse().expect("a width");
                let n: usize = count.map_or(1, |n| n.parse().expect("a count"));
                bytes += bits / 8 * n;
                let array = count.map_or(String::new(), |n| format!("[{n}]"));
                format!("{sign}int{bits}_t {member}{array};")
            });
            let members = members.collect();
            Layout {
                code,
                name,
                members,
                bytes,
            }
        })
        .collect()
}

/// The text of `assets/firmware/protocol.h`.
fn c_header() -> String {
    let layouts = layouts();
    let built_in = Config::built_in();
    let mut h = format!(
        "/* Wire protocol and limits, made from src/link/wire. Do not edit: change them there, then run\n\
         \x20*   SPRINGTWIN_WRITE_ASSETS=1 cargo test --lib link::wire::header */\n\
         #ifndef PROTOCOL_H\n#define PROTOCOL_H\n\n#include <stdint.h>\n\n\
         /* The tests build boards that do not match by setting these from outside. */\n\
         #ifndef PROTOCOL_VERSION\n#define PROTOCOL_VERSION {VERSION}\n#endif\n\
         #ifndef SCHEMA_HASH /* CRC-32 of the layout in words */\n#define SCHEMA_HASH 0x{SCHEMA_HASH:08x}UL\n#endif\n\
         #ifndef PRESSURE_MIN\n#define PRESSURE_MIN {}U\n#endif\n#define PRESSURE_MAX {}U\n#define OVER_PRESSURE {}U\n\
         #define HEARTBEAT_TIMEOUT_MS {HEARTBEAT_TIMEOUT_MS}\n#define LONGEST_TTL_MS {LONGEST_TTL_MS}\n\
         #define PRELOAD_MS {}\n\
         /* Steps of pressure per second and of pressure, 2 Pa each. */\n\
         #define SLEW_PER_S {}UL\n#define VENT_PER_S {}UL\n#define VENTED {}U\n\n\
         #define BAUD {BAUD}UL\n#define TICK_RATE_HZ {TICK_RATE_HZ}UL\n#define SAMPLE_RATE_HZ {SAMPLE_RATE_HZ}\n\
         #define ALL_BOARDS {ALL_BOARDS:#04x}\n#define PACKED __attribute__((packed))\n\n",
        built_in.pressure_min,
        built_in.pressure_max,
        built_in.over_pressure,
        PRELOAD_S * 1e3,
        SLEW_PA_S / PRESSURE_STEP_PA,
        VENT_PA_S / PRESSURE_STEP_PA,
        VENTED_PA / PRESSURE_STEP_PA,
    );
    h.push_str("enum message {\n");
    for (code, name) in layouts.iter().filter_map(|l| Some((l.code?, l.name))) {
        let _ = writeln!(h, "    MSG_{} = 0x{code},", name.to_uppercase());
    }
    h.push_str("};\n");
    for (what, prefix, bits) in [
        ("the header's flags", "FLAG", &FLAGS[..]),
        ("a SAMPLE's status", "FAULT", &FAULTS[..]),
    ] {
        let _ = write!(h, "\n/* Bits of {what}. */\nenum {{\n");
        for (name, bit) in bits {
            let _ = writeln!(h, "    {prefix}_{name} = 1 << {},", bit.trailing_zeros());
        }
        h.push_str("};\n");
    }
    for layout in layouts.iter().filter(|l| l.bytes > 0) {
        let Layout { name, bytes, .. } = layout;
        let _ = write!(
            h,
            "\ntypedef struct PACKED {{\n    {}\n}} {name}_t;\n\
             _Static_assert(sizeof({name}_t) == {bytes}, \"{name} takes {bytes} bytes on the line\");\n",
            layout.members.join("\n    ")
        );
    }
    h.push_str("\n#endif\n");
    h
}

/// The firmware is built from the header that this crate makes.
#[test]
fn the_firmwares_header_is_the_one_made_from_this_protocol() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/assets/firmware/protocol.h");
    let fresh = c_header();
    if std::env::var_os("SPRINGTWIN_WRITE_ASSETS").is_some() {
        std::fs::write(path, &fresh).expect("writes");
    }
    let committed = std::fs::read_to_string(path).expect("the header is there");
    assert!(
        committed == fresh,
        "{path} differs from the protocol; make it with SPRINGTWIN_WRITE_ASSETS=1 cargo test --lib link::wire::header"
    );
}

/// No bit is given twice, and none of them is left out of the header.
#[test]
fn the_bits_are_one_each_and_without_a_hole() {
    for bits in [&FLAGS[..], &FAULTS[..]] {
        for (k, (name, bit)) in bits.iter().enumerate() {
            assert_eq!(*bit, 1 << k, "{name}");
        }
    }
}
