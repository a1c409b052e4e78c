//! A whole link session against boards that say anything, over a line that carries anything: frames come
//! in order and finite, queues are bounded, nothing is sent on a closed line, and what is sent is sound.
#![no_main]

use libfuzzer_sys::fuzz_target;
use springtwin::link::wire::{
    Body, Config, Decoder, Hello, Packet, SCHEMA_HASH, Sample, VERSION, encode,
};
use springtwin::link::{HostSession, Order, Origin};
use springtwin::signal::{Gripper, PressureCommand, PressureLimits, Stamp};

/// Takes what the target needs off the front of the input.
struct Script<'a>(&'a [u8]);

impl Script<'_> {
    fn take<const N: usize>(&mut self) -> [u8; N] {
        let mut out = [0; N];
        let n = self.0.len().min(N);
        out[..n].copy_from_slice(&self.0[..n]);
        self.0 = &self.0[n..];
        out
    }

    fn u8(&mut self) -> u8 {
        self.take::<1>()[0]
    }

    fn u16(&mut self) -> u16 {
        u16::from_le_bytes(self.take())
    }

    fn u32(&mut self) -> u32 {
        u32::from_le_bytes(self.take())
    }

    fn sample(&mut self) -> Sample {
        // One byte says most of it: a sample is long, and its values are checked nowhere here.
        let (a, b) = (self.u16(), self.u8());
        Sample {
            spring_counts: [a; 12],
            spring_gate_ticks: [a.wrapping_add(1); 12],
            gyro: [[a as i16; 3]; 4],
            accel: [[i16::from(b); 3]; 4],
            pressure: [a; 6],
            present: match b & 3 {
                0 => self.u32(),
                1 => u32::MAX,
                _ => springtwin::link::wire::board_channels(usize::from(b & 1)),
            },
            status: if b & 4 == 0 { 0 } else { self.u16() },
        }
    }

    /// A sound frame of a board.
    fn packet(&mut self, config: &Config) -> Packet {
        let kind = self.u8();
        let body = match kind & 7 {
            0 | 1 => Body::Hello(Hello {
                protocol: if kind & 8 == 0 {
                    u16::from(VERSION)
                } else {
                    self.u16()
                },
                schema: if kind & 16 == 0 {
                    SCHEMA_HASH
                } else {
                    self.u32()
                },
                firmware: 1,
                tick_rate_hz: if kind & 32 == 0 {
                    2_000_000
                } else {
                    self.u32()
                },
                boot_nonce: u32::from(self.u8()),
                config_crc: if kind & 64 == 0 {
                    config.crc()
                } else {
                    self.u32()
                },
                rig: u32::from(self.u8()),
            }),
            2..=4 => Body::Sample(self.sample()),
            5 => Body::Pong {
                id: if kind & 8 == 0 {
                    u32::from(self.u8())
                } else {
                    self.u32()
                },
                t_receive: self.u32(),
            },
            6 => Body::Fault {
                code: self.u16(),
                detail: self.u32(),
            },
            _ => Body::Heartbeat,
        };
        let flags = if kind & 128 == 0 { 0 } else { self.u16() };
        Packet {
            board: self.u8() % 3,
            seq: self.u16(),
            t_ticks: self.u32(),
            flags,
            body,
        }
    }
}

fuzz_target!(|data: &[u8]| {
    let mut script = Script(data);
    let config = Config::built_in();
    let mut host = HostSession::new("fuzz", Origin::Hardware, config);
    let limits = PressureLimits {
        min_pa: -40e3,
        max_pa: 40e3,
        rate_pa_s: 1e9,
    };
    let (mut now, mut open, mut last) = (Stamp::ZERO, true, None);
    let mut sent = Decoder::default();
    while !script.0.is_empty() {
        match script.u8() % 12 {
            0..=3 => {
                let mut line = Vec::new();
                encode(&script.packet(&config), &mut line);
                host.on_port_bytes(usize::from(script.u8() % 3), now, &line);
            }
            4 => {
                let n = usize::from(script.u8()).min(script.0.len());
                let (bytes, rest) = script.0.split_at(n);
                script.0 = rest;
                host.on_port_bytes(0, now, bytes);
            }
            // The clock may stand still; a caller that turns it back is answered, too.
            5 | 6 => now = now.plus(f64::from(script.u16()) * 1e-4),
            7 => now = now.plus(-f64::from(script.u8()) * 1e-3),
            8 => {
                open = script.u8() & 1 == 0;
                if open {
                    host.reconnected(now);
                } else {
                    host.disconnected(now, "unplugged");
                }
            }
            9 => host.order(match script.u8() & 3 {
                0 => Order::Stop,
                1 => Order::CutSupply,
                2 => Order::Vent,
                _ => Order::Reset,
            }),
            10 => host.control_is_alive(script.u8() & 1 == 0),
            _ => {
                let pa = f64::from(script.u16()) * 4.0 - 100e3;
                let gripper = Gripper::Open;
                let command =
                    PressureCommand::limited(now, [pa; 6], gripper, None, &[0.0; 6], &limits);
                host.set_command(&command);
            }
        }
        let out = host.poll(now);
        assert!(open || out.is_empty(), "nothing is sent on a closed line");
        for byte in out {
            sent.push(byte);
        }
        assert_eq!(sent.counts.bad(), 0, "what is sent is sound");
        let mut frames = 0;
        while let Some(frame) = host.next_frame() {
            frames += 1;
            let order = (frame.seq, frame.stamp);
            assert!(
                last.is_none_or(|(s, t)| frame.seq > s && frame.stamp > t),
                "{last:?} {order:?}"
            );
            last = Some(order);
            let imu = frame
                .imu
                .iter()
                .flat_map(|i| i.gyro_rad_s.into_iter().chain(i.accel_m_s2));
            let ages = frame.board_age_s;
            let mut numbers = imu
                .chain(frame.chamber_pa)
                .chain(ages)
                .chain(frame.tick_rate_hz)
                .chain(frame.tick_rate_sd);
            assert!(numbers.all(f64::is_finite), "{frame:?}");
        }
        let mut events = 0;
        while host.next_event().is_some() {
            events += 1;
        }
        assert!(frames <= 64 && events <= 256);
        let status = host.status(now);
        let ratio = host.loss_ratio(now);
        assert!((0.0..=1.0).contains(&ratio), "{ratio}");
        assert!(status.board_rate_hz.iter().all(|r| r.is_finite()));
    }
});
