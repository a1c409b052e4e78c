//! Packets to bytes and back.

use super::{Body, CRC32, Config, Hello, Packet, Sample, Setpoint, VERSION};

/// Bytes before the payload.
const HEADER_BYTES: usize = 11;
const CRC_BYTES: usize = 4;
/// Longest frame between delimiters that is looked at; the longest of ours takes 130.
const MAX_FRAME_BYTES: usize = 512;

/// Appends the frame of a packet to `out`, delimiters included.
pub fn encode(packet: &Packet, out: &mut Vec<u8>) {
    let mut raw = Vec::with_capacity(160);
    raw.extend([VERSION, type_code(&packet.body), packet.board]);
    raw.extend(packet.seq.to_le_bytes());
    raw.extend(packet.t_ticks.to_le_bytes());
    raw.extend(packet.flags.to_le_bytes());
    put_payload(&mut raw, &packet.body);
    let crc = CRC32.checksum(&raw);
    raw.extend(crc.to_le_bytes());

    out.push(0);
    out.extend(stuffed(&raw));
    out.push(0);
}

/// COBS of `raw`, without delimiters.
fn stuffed(raw: &[u8]) -> Vec<u8> {
    let mut bytes = vec![0; cobs::max_encoding_length(raw.len())];
    let n = cobs::encode(raw, &mut bytes);
    bytes.truncate(n);
    bytes
}

fn type_code(body: &Body) -> u8 {
    match body {
        Body::Hello(_) => 0x01,
        Body::Sample(_) => 0x02,
        Body::Pong { .. } => 0x03,
        Body::Fault { .. } => 0x04,
        Body::Setpoint(_) => 0x81,
        Body::Heartbeat => 0x82,
        Body::Estop { .. } => 0x83,
        Body::Reset { .. } => 0x84,
        Body::Config(_) => 0x85,
        Body::Ping { .. } => 0x86,
        Body::Vent { .. } => 0x87,
    }
}

fn put_payload(out: &mut Vec<u8>, body: &Body) {
    match body {
        Body::Hello(h) => {
            put_u16(out, &[h.protocol]);
            for x in [
                h.schema,
                h.firmware,
                h.tick_rate_hz,
                h.boot_nonce,
                h.config_crc,
                h.rig,
            ] {
                put_u32(out, x);
            }
        }
        Body::Sample(s) => {
            put_u16(out, &s.spring_counts);
            put_u16(out, &s.spring_gate_ticks);
            put_i16(out, s.gyro.as_flattened());
            put_i16(out, s.accel.as_flattened());
            put_u16(out, &s.pressure);
            put_u32(out, s.present);
            put_u16(out, &[s.status]);
        }
        Body::Pong { id, t_receive } => {
            put_u32(out, *id);
            put_u32(out, *t_receive);
        }
        Body::Fault { code, detail } => {
            put_u16(out, &[*code]);
            put_u32(out, *detail);
        }
        Body::Setpoint(s) => {
            put_u16(out, &s.pressure);
            put_u16(out, &[s.ttl_ms]);
        }
        Body::Heartbeat => {}
        Body::Estop { cause, cut } => put_u16(out, &[*cause, u16::from(*cut)]),
        Body::Reset { id } => put_u32(out, *id),
        Body::Config(c) => put_u16(out, &c.words()),
        Body::Ping { id } => {
            put_u32(out, *id);
            put_u32(out, 0);
        }
        Body::Vent { ttl_ms } => put_u16(out, &[*ttl_ms]),
    }
}

fn put_u16(out: &mut Vec<u8>, values: &[u16]) {
    out.extend(values.iter().flat_map(|x| x.to_le_bytes()));
}

fn put_i16(out: &mut Vec<u8>, values: &[i16]) {
    out.extend(values.iter().flat_map(|x| x.to_le_bytes()));
}

fn put_u32(out: &mut Vec<u8>, value: u32) {
    out.extend(value.to_le_bytes());
}

/// Takes integers off the front of a slice.
struct Cursor<'a>(&'a [u8]);

impl Cursor<'_> {
    fn bytes<const N: usize>(&mut self) -> Option<[u8; N]> {
        let (head, rest) = self.0.split_first_chunk::<N>()?;
        self.0 = rest;
        Some(*head)
    }

    fn u8(&mut self) -> Option<u8> {
        self.bytes().map(u8::from_le_bytes)
    }

    fn u16(&mut self) -> Option<u16> {
        self.bytes().map(u16::from_le_bytes)
    }

    fn u32(&mut self) -> Option<u32> {
        self.bytes().map(u32::from_le_bytes)
    }

    fn u16s<const N: usize>(&mut self) -> Option<[u16; N]> {
        let mut a = [0; N];
        for x in &mut a {
            *x = self.u16()?;
        }
        Some(a)
    }

    fn vectors<const N: usize>(&mut self) -> Option<[[i16; 3]; N]> {
        let mut a = [[0; 3]; N];
        for x in a.as_flattened_mut() {
            *x = i16::from_le_bytes(self.bytes()?);
        }
        Some(a)
    }
}

fn take_body(code: u8, c: &mut Cursor<'_>) -> Option<Body> {
    Some(match code {
        0x01 => Body::Hello(Hello {
            protocol: c.u16()?,
            schema: c.u32()?,
            firmware: c.u32()?,
            tick_rate_hz: c.u32()?,
            boot_nonce: c.u32()?,
            config_crc: c.u32()?,
            rig: c.u32()?,
        }),
        0x02 => Body::Sample(Sample {
            spring_counts: c.u16s()?,
            spring_gate_ticks: c.u16s()?,
            gyro: c.vectors()?,
            accel: c.vectors()?,
            pressure: c.u16s()?,
            present: c.u32()?,
            status: c.u16()?,
        }),
        0x03 => Body::Pong {
            id: c.u32()?,
            t_receive: c.u32()?,
        },
        0x04 => Body::Fault {
            code: c.u16()?,
            detail: c.u32()?,
        },
        0x81 => Body::Setpoint(Setpoint {
            pressure: c.u16s()?,
            ttl_ms: c.u16()?,
        }),
        0x82 => Body::Heartbeat,
        0x83 => Body::Estop {
            cause: c.u16()?,
            cut: c.u16()? != 0,
        },
        0x84 => Body::Reset { id: c.u32()? },
        0x85 => Body::Config(Config {
            pressure_min: c.u16()?,
            pressure_max: c.u16()?,
            over_pressure: c.u16()?,
            heartbeat_timeout_ms: c.u16()?,
        }),
        0x86 => {
            let id = c.u32()?;
            c.u32()?;
            Body::Ping { id }
        }
        0x87 => Body::Vent { ttl_ms: c.u16()? },
        _ => return None,
    })
}

/// Result of a [`Decoder`] for a whole frame.
#[derive(Clone, Debug, PartialEq)]
pub enum Received {
    /// A sound packet of our version.
    Packet(Packet),
    /// A sound frame of another protocol version.
    OtherVersion {
        /// Its version byte.
        version: u8,
        /// Its third byte: the board, if that version still has it there.
        board: u8,
    },
}

/// Counters of a [`Decoder`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DecoderCounts {
    /// Sound packets.
    pub good: u64,
    /// Frames whose CRC did not match.
    pub bad_crc: u64,
    /// Frames that were no COBS, too short, too long, or of an unknown type or length.
    pub bad_form: u64,
    /// Sound frames of another protocol version.
    pub other_version: u64,
}

impl DecoderCounts {
    /// All frames that were thrown away.
    pub fn bad(&self) -> u64 {
        self.bad_crc + self.bad_form + self.other_version
    }
}

/// Finds packets in a stream of bytes, whatever the bytes. Holds at most 512 of them.
#[derive(Clone, Debug, Default)]
pub struct Decoder {
    frame: Vec<u8>,
    /// The frame under way is too long: everything up to the next 00 is dropped.
    overlong: bool,
    /// Counters so far.
    pub counts: DecoderCounts,
}

impl Decoder {
    /// Takes one byte; gives a result when it completes a sound frame, else `None`.
    pub fn push(&mut self, byte: u8) -> Option<Received> {
        if byte != 0 {
            if self.frame.len() == MAX_FRAME_BYTES {
                self.overlong = true;
            } else {
                self.frame.push(byte);
            }
            return None;
        }
        let received = if self.overlong {
            Err(Bad::Form)
        } else if self.frame.is_empty() {
            // Two delimiters in a row: the end of one frame and the start of the next.
            return None;
        } else {
            take_frame(&self.frame)
        };
        self.frame.clear();
        self.overlong = false;
        let counter = match &received {
            Ok(Received::Packet(_)) => &mut self.counts.good,
            Ok(Received::OtherVersion { .. }) => &mut self.counts.other_version,
            Err(Bad::Crc) => &mut self.counts.bad_crc,
            Err(Bad::Form) => &mut self.counts.bad_form,
        };
        *counter += 1;
        received.ok()
    }

    /// Forgets a frame under way, for a line that was closed and opened again.
    pub fn restart(&mut self) {
        self.frame.clear();
        self.overlong = false;
    }
}

enum Bad {
    Crc,
    Form,
}

fn take_frame(stuffed: &[u8]) -> Result<Received, Bad> {
    let mut buffer = [0; MAX_FRAME_BYTES];
    let n = cobs::decode(stuffed, &mut buffer)
        .map_err(|_| Bad::Form)?
        .frame_size();
    let raw = buffer.get(..n).ok_or(Bad::Form)?;
    let (content, crc) = raw.split_last_chunk::<CRC_BYTES>().ok_or(Bad::Form)?;
    if content.len() < HEADER_BYTES {
        return Err(Bad::Form);
    }
    if CRC32.checksum(content) != u32::from_le_bytes(*crc) {
        return Err(Bad::Crc);
    }
    take_packet(content).ok_or(Bad::Form)
}

fn take_packet(content: &[u8]) -> Option<Received> {
    let mut c = Cursor(content);
    let version = c.u8()?;
    let code = c.u8()?;
    let board = c.u8()?;
    if version != VERSION {
        return Some(Received::OtherVersion { version, board });
    }
    let (seq, t_ticks, flags) = (c.u16()?, c.u32()?, c.u16()?);
    let body = take_body(code, &mut c)?;
    c.0.is_empty().then_some(Received::Packet(Packet {
        board,
        seq,
        t_ticks,
        flags,
        body,
    }))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::link::wire::SCHEMA;

    fn decode(bytes: &[u8]) -> (Vec<Packet>, DecoderCounts) {
        let mut decoder = Decoder::default();
        let packets = bytes
            .iter()
            .filter_map(|b| match decoder.push(*b) {
                Some(Received::Packet(p)) => Some(p),
                _ => None,
            })
            .collect();
        (packets, decoder.counts)
    }

    fn any_body() -> impl Strategy<Value = Body> {
        let hello = any::<(u16, u32, u32, u32, u32, u32, u32)>().prop_map(|h| {
            Body::Hello(Hello {
                protocol: h.0,
                schema: h.1,
                firmware: h.2,
                tick_rate_hz: h.3,
                boot_nonce: h.4,
                config_crc: h.5,
                rig: h.6,
            })
        });
        let sample = any::<(
            [u16; 12],
            [u16; 12],
            [[i16; 3]; 4],
            [[i16; 3]; 4],
            [u16; 6],
            u32,
            u16,
        )>()
        .prop_map(|s| {
            Body::Sample(Sample {
                spring_counts: s.0,
                spring_gate_ticks: s.1,
                gyro: s.2,
                accel: s.3,
                pressure: s.4,
                present: s.5,
                status: s.6,
            })
        });
        let config = any::<[u16; 4]>().prop_map(|c| {
            Body::Config(Config {
                pressure_min: c[0],
                pressure_max: c[1],
                over_pressure: c[2],
                heartbeat_timeout_ms: c[3],
            })
        });
        prop_oneof![
            hello,
            sample,
            config,
            any::<(u32, u32)>().prop_map(|(id, t_receive)| Body::Pong { id, t_receive }),
            any::<(u16, u32)>().prop_map(|(code, detail)| Body::Fault { code, detail }),
            any::<([u16; 6], u16)>()
                .prop_map(|(pressure, ttl_ms)| Body::Setpoint(Setpoint { pressure, ttl_ms })),
            Just(Body::Heartbeat),
            any::<(u16, bool)>().prop_map(|(cause, cut)| Body::Estop { cause, cut }),
            any::<u16>().prop_map(|ttl_ms| Body::Vent { ttl_ms }),
            any::<u32>().prop_map(|id| Body::Reset { id }),
            any::<u32>().prop_map(|id| Body::Ping { id }),
        ]
    }

    fn any_packet() -> impl Strategy<Value = Packet> {
        (any::<(u8, u16, u32, u16)>(), any_body()).prop_map(
            |((board, seq, t_ticks, flags), body)| Packet {
                board,
                seq,
                t_ticks,
                flags,
                body,
            },
        )
    }

    proptest! {
        #[test]
        fn packets_survive_the_line(packets in prop::collection::vec(any_packet(), 1..8)) {
            let mut line = Vec::new();
            for p in &packets {
                encode(p, &mut line);
            }
            let (back, counts) = decode(&line);
            prop_assert_eq!(counts.good, packets.len() as u64);
            prop_assert_eq!(back, packets);
        }

        #[test]
        fn garbage_costs_no_frame_after_it_and_little_memory(
            garbage in prop::collection::vec(any::<u8>(), 0..3000),
            packet in any_packet(),
        ) {
            let mut decoder = Decoder::default();
            for b in &garbage {
                decoder.push(*b);
                prop_assert!(decoder.frame.capacity() <= 1024);
            }
            let mut line = Vec::new();
            encode(&packet, &mut line);
            let back = line.iter().filter_map(|b| decoder.push(*b)).last();
            prop_assert_eq!(back, Some(Received::Packet(packet)));
        }

        #[test]
        fn a_changed_byte_never_passes(
            packet in any_packet(),
            place in any::<prop::sample::Index>(),
            change in 1..=255u8,
        ) {
            let mut line = Vec::new();
            encode(&packet, &mut line);
            let i = place.index(line.len());
            line[i] ^= change;
            // A changed delimiter leaves its frame open: the next frame's closes it.
            line.push(0);
            let (back, counts) = decode(&line);
            let delimiter = i == 0 || i + 2 == line.len();
            prop_assert!(back.is_empty() || delimiter, "{back:?}");
            prop_assert!(counts.good == 0 || back == vec![packet]);
        }

        #[test]
        fn sound_frames_of_any_content_do_no_harm(content in prop::collection::vec(any::<u8>(), 0..300)) {
            let mut raw = content;
            let crc = CRC32.checksum(&raw);
            raw.extend(crc.to_le_bytes());
            let mut line = stuffed(&raw);
            line.push(0);
            let (_, counts) = decode(&line);
            prop_assert_eq!(counts.good + counts.bad(), 1);
        }
    }

    #[test]
    fn another_version_is_told_apart_from_garbage() {
        let mut raw = vec![VERSION + 1, 0x01, 1];
        raw.extend([0; 30]);
        let crc = CRC32.checksum(&raw);
        raw.extend(crc.to_le_bytes());
        let mut line = stuffed(&raw);
        line.push(0);
        let mut decoder = Decoder::default();
        let received: Vec<_> = line.iter().filter_map(|b| decoder.push(*b)).collect();
        assert_eq!(
            received,
            [Received::OtherVersion {
                version: VERSION + 1,
                board: 1
            }]
        );
    }

    /// The sizes in the schema's words are the sizes on the line.
    #[test]
    fn schema_tells_the_layout() {
        let bytes_of = |field: &str| {
            let kind = field.split_whitespace().last().unwrap_or_default();
            let (kind, n) = kind.split_once('*').unwrap_or((kind, "1"));
            let bits: usize = kind[1..].parse().expect("a width");
            bits / 8 * n.parse::<usize>().expect("a count")
        };
        let limits = crate::signal::PressureLimits {
            min_pa: -40e3,
            max_pa: 40e3,
            rate_pa_s: 12e3,
        };
        let bodies = [
            Body::Hello(Hello {
                protocol: 1,
                schema: 0,
                firmware: 0,
                tick_rate_hz: 0,
                boot_nonce: 0,
                config_crc: 0,
                rig: 0,
            }),
            Body::Sample(Sample::default()),
            Body::Pong {
                id: 0,
                t_receive: 0,
            },
            Body::Fault { code: 0, detail: 0 },
            Body::Setpoint(Setpoint {
                pressure: [0; 6],
                ttl_ms: 0,
            }),
            Body::Heartbeat,
            Body::STOP,
            Body::Vent { ttl_ms: 0 },
            Body::Reset { id: 0 },
            Body::Config(Config::new(&limits, 42e3)),
            Body::Ping { id: 0 },
        ];
        for body in bodies {
            let prefix = format!("{:02x} ", type_code(&body));
            let line = SCHEMA
                .lines()
                .find(|l| l.starts_with(&prefix))
                .expect("a line for every type");
            let (_, fields) = line.split_once(':').expect("a colon");
            let said: usize = fields
                .split(',')
                .filter(|f| !f.trim().is_empty())
                .map(bytes_of)
                .sum();
            let mut payload = Vec::new();
            put_payload(&mut payload, &body);
            assert_eq!(said, payload.len(), "{line}");
        }
        let header = SCHEMA.lines().next().expect("a header line");
        let (_, fields) = header.split_once(':').expect("a colon");
        assert_eq!(fields.split(',').map(bytes_of).sum::<usize>(), HEADER_BYTES);
    }

    #[test]
    fn two_boards_fit_the_line() {
        let mut line = Vec::new();
        let sample = Sample {
            spring_counts: [0x2b2b; 12],
            ..Sample::default()
        };
        encode(
            &Packet {
                board: 0,
                seq: 0,
                t_ticks: 0,
                flags: 0,
                body: Body::Sample(sample),
            },
            &mut line,
        );
        assert_eq!(line.len(), crate::link::wire::SAMPLE_LINE_BYTES);
        // 8N1: ten bits a byte.
        let bits_per_s = line.len() as f64 * 10.0 * crate::link::wire::SAMPLE_RATE_HZ * 2.0;
        assert!(bits_per_s < 0.54 * f64::from(crate::link::wire::BAUD));
    }
}
