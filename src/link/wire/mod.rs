//! The wire protocol, version 2: pure bytes in, bytes out.
//!
//! A frame on the line is `00 | COBS(header, payload, CRC-32) | 00`, all integers little-endian:
//!
//! | field | type | meaning |
//! |---|---|---|
//! | version | u8 | [`VERSION`] |
//! | type | u8 | which [`Body`] |
//! | board | u8 | sender (up) or addressee (down; [`ALL_BOARDS`] for every board), 0-based |
//! | seq | u16 | counts all frames of this sender, wraps |
//! | t_ticks | u32 | sender's clock: sampling instant of a SAMPLE, else when it goes out; 0 downwards |
//! | flags | u16 | see [`flag`] |
//! | payload | | fixed struct of the type, see [`SCHEMA`] |
//! | CRC-32 | u32 | ISO-HDLC, over everything before it |
//!
//! At 500 kbaud and 10 bits a byte (8N1) the line carries 50,000 bytes/s. A SAMPLE takes
//! [`SAMPLE_LINE_BYTES`] on the line, so two boards at 100 Hz on one line fill about 53 % of it.
//!
//! A board answers CONFIG with HELLO. Until it has accepted a CONFIG since it booted its
//! configuration CRC is 0 and it ignores set points, and it is latched from its start until a RESET: a rebooted
//! board never moves by itself.
//!
//! A set point is followed for its time-to-live, at most [`LONGEST_TTL_MS`]. One that expires latches the board; a set
//! point with a time-to-live of 0 switches the pumps off without that. The regulators are first set to the pressures
//! that the gauges show, enabled [`PRELOAD_S`] later, and moved by at most [`SLEW_PA_S`].

mod codec;
#[cfg(test)]
mod header;
pub mod objects;

pub use codec::{Decoder, DecoderCounts, Received, encode};

use crc::{CRC_32_ISO_HDLC, Crc};

use crate::signal::{CHAMBERS, IMUS, ImuRaw, PressureLimits, SPRINGS};

/// Protocol version this code speaks.
pub const VERSION: u8 = 2;
/// Symbol rate of the line, baud.
pub const BAUD: u32 = 500_000;
/// Nominal clock rate of a board, ticks/s (0.5 µs per tick).
pub const TICK_RATE_HZ: u32 = 2_000_000;
/// Rate of SAMPLE frames per board, 1/s.
pub const SAMPLE_RATE_HZ: f64 = 100.0;
/// Period of HEARTBEAT, s (20 Hz).
pub const HEARTBEAT_PERIOD_S: f64 = 0.05;
/// A board goes SAFE when it hears no HEARTBEAT for this long, ms.
pub const HEARTBEAT_TIMEOUT_MS: u16 = 200;
/// Longest time-to-live of a set point that a board accepts, ms.
pub const LONGEST_TTL_MS: u16 = 250;
/// Greatest rate at which a board changes its set pressures, Pa/s.
pub const SLEW_PA_S: f64 = 15e3;
/// Rate at which a board vents its chambers, Pa/s.
pub const VENT_PA_S: f64 = 12e3;
/// A board ends venting when every gauge shows less than this, and begins again beyond twice as much, Pa.
pub const VENTED_PA: f64 = 1e3;
/// Time for which the regulators are set to the measured pressures before they are enabled, s.
pub const PRELOAD_S: f64 = 0.05;
/// Board address that means every board.
pub const ALL_BOARDS: u8 = 0xff;
/// Bytes a SAMPLE takes on the line, both delimiters included (COBS overhead at most 1).
pub const SAMPLE_LINE_BYTES: usize = 11 + 114 + 4 + 1 + 2;

/// One count of a pressure code, Pa. Code 32768 is 0 Pa, so the codes span ±65.5 kPa.
pub const PRESSURE_STEP_PA: f64 = 2.0;
/// One count of a gyroscope reading, rad/s: ±500 °/s over an i16.
pub const GYRO_STEP_RAD_S: f64 = 500.0 / 32_768.0 * std::f64::consts::PI / 180.0;
/// One count of an accelerometer reading, m/s²: ±4 g over an i16.
pub const ACCEL_STEP_M_S2: f64 = 4.0 * 9.806_65 / 32_768.0;

/// Layout of every frame in words: boards and host compare its CRC-32, [`SCHEMA_HASH`].
pub const SCHEMA: &str = "\
header: version u8, type u8, board u8, seq u16, t_ticks u32, flags u16\n\
01 hello: protocol u16, schema u32, firmware u32, tick_rate_hz u32, boot_nonce u32, config_crc u32, rig u32\n\
02 sample: spring_counts u16*12, spring_gate_ticks u16*12, gyro i16*12, accel i16*12, pressure u16*6, present u32, status u16\n\
03 pong: id u32, t_receive u32\n\
04 fault: code u16, detail u32\n\
81 setpoint: pressure u16*6, ttl_ms u16\n\
82 heartbeat:\n\
83 estop: cause u16, cut u16\n\
84 reset: id u32\n\
85 config: pressure_min u16, pressure_max u16, over_pressure u16, heartbeat_timeout_ms u16\n\
86 ping: id u32, pad u32\n\
87 vent: ttl_ms u16\n\
scales: pressure 2 Pa from 32768, gyro 500/32768 deg/s, accel 4/32768 g\n";

const CRC32: Crc<u32> = Crc::<u32>::new(&CRC_32_ISO_HDLC);

/// CRC-32 of [`SCHEMA`].
pub const SCHEMA_HASH: u32 = CRC32.checksum(SCHEMA.as_bytes());

/// Bits of a packet's `flags`.
pub mod flag {
    /// Up: the board has accepted a CONFIG since it booted.
    pub const CONFIGURED: u16 = 1 << 0;
    /// Up: the pumps follow a live set point or vent; from [`super::PRELOAD_S`] before the output is enabled.
    pub const PUMPS_ON: u16 = 1 << 1;
    /// Both ways: the gripper is (shall be) closed.
    pub const GRIPPER_CLOSED: u16 = 1 << 2;
    /// Up: the arm at this board is simulated.
    pub const SIMULATED: u16 = 1 << 3;
    /// Down: the gripper shall stay as it is. Up: it has had no command since the power came.
    pub const GRIPPER_AS_IT_WAS: u16 = 1 << 4;
    /// Up: the emergency-stop input is open.
    pub const STOP_OPEN: u16 = 1 << 5;
    /// Up: the supply is cut by the second output, until a RESET or a loss of power.
    pub const SUPPLY_CUT: u16 = 1 << 6;
    /// Up: the board vents its chambers.
    pub const VENTING: u16 = 1 << 7;
}

/// Bits of a SAMPLE's `status` and of `RawFrame::faults` (there: both boards' bits or-ed).
pub mod fault {
    /// Latched: pumps off until a RESET.
    pub const SAFE: u16 = 1 << 0;
    /// Latched because the host's operator or a watch of the host stopped it.
    pub const ESTOP: u16 = 1 << 1;
    /// Latched because heartbeats stopped.
    pub const HEARTBEAT_LOST: u16 = 1 << 2;
    /// Latched because a chamber was beyond the over-pressure bound in two samples.
    pub const OVER_PRESSURE: u16 = 1 << 3;
    /// Latched because a chamber's gauge gave no value in two samples.
    pub const GAUGE_LOST: u16 = 1 << 4;
    /// Latched because the set point outlived its time-to-live.
    pub const SETPOINT_EXPIRED: u16 = 1 << 5;
    /// Not latched: a spring of this board gave no valid count.
    pub const SPRING_LOST: u16 = 1 << 6;
    /// Not latched: an IMU of this board did not answer.
    pub const IMU_LOST: u16 = 1 << 7;
    /// Latched because the board has started.
    pub const BOOTED: u16 = 1 << 8;
    /// Latched because the emergency-stop input was open.
    pub const STOP_INPUT: u16 = 1 << 9;
    /// Latched because the host's program ended.
    pub const ENDED: u16 = 1 << 10;
    /// Latched because the host's control loop stood still.
    pub const CONTROL_SILENT: u16 = 1 << 11;

    /// The causes that a host may give an ESTOP.
    pub const OF_THE_HOST: u16 = ESTOP | ENDED | CONTROL_SILENT;
    /// What latches a board.
    pub const LATCHING: u16 = !(SPRING_LOST | IMU_LOST);
}

/// One message with its header.
#[derive(Clone, Debug, PartialEq)]
pub struct Packet {
    /// Sender (up) or addressee (down), 0-based; [`ALL_BOARDS`] addresses every board.
    pub board: u8,
    /// Counts all frames of this sender, wraps.
    pub seq: u16,
    /// Sender's clock in ticks, wraps (every 35.8 min at 2 MHz).
    pub t_ticks: u32,
    /// See [`flag`].
    pub flags: u16,
    /// The message.
    pub body: Body,
}

/// Every message of the protocol.
#[derive(Clone, Debug, PartialEq)]
pub enum Body {
    /// Up: who the board is; sent at boot and in answer to CONFIG.
    Hello(Hello),
    /// Up, 100 Hz: what the board measured.
    Sample(Sample),
    /// Up: answer to PING.
    Pong {
        /// The PING's id.
        id: u32,
        /// Board clock when the PING was complete, ticks.
        t_receive: u32,
    },
    /// Up: the board went SAFE.
    Fault {
        /// A single bit of [`fault`]: the cause.
        code: u16,
        /// Chamber (0-based) for pressure faults, else 0.
        detail: u32,
    },
    /// Down: set pressures.
    Setpoint(Setpoint),
    /// Down, 20 Hz: the host is alive.
    Heartbeat,
    /// Down: pumps off, latched.
    Estop {
        /// A single bit of [`fault::OF_THE_HOST`]; anything else counts as [`fault::ESTOP`].
        cause: u16,
        /// Whether the second output cuts the supply, too.
        cut: bool,
    },
    /// Down: leave SAFE. Acts once per id (an edge, not a level).
    Reset {
        /// Differs from the previous RESET's.
        id: u32,
    },
    /// Down: limits; answered with HELLO carrying [`Config::crc`].
    Config(Config),
    /// Down: asks for the board's clock. As long as a PONG, so both ways take equally long.
    Ping {
        /// Comes back in the PONG.
        id: u32,
    },
    /// Down: bring the chambers to 0 Pa at [`VENT_PA_S`] and then be off, in SAFE too. Ends with the time-to-live, with
    /// an ESTOP and when the emergency-stop input is open.
    Vent {
        /// How long it holds without a successor, ms; at most [`LONGEST_TTL_MS`].
        ttl_ms: u16,
    },
}

impl Body {
    /// A stop by the operator or by a watch of the host; the supply stays.
    pub const STOP: Self = Self::Estop {
        cause: fault::ESTOP,
        cut: false,
    };
}

/// Identity of a board and of its present run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Hello {
    /// Protocol version.
    pub protocol: u16,
    /// [`SCHEMA_HASH`] the firmware was built with.
    pub schema: u32,
    /// Firmware id.
    pub firmware: u32,
    /// Nominal clock rate, ticks/s.
    pub tick_rate_hz: u32,
    /// Differs from one boot to the next.
    pub boot_nonce: u32,
    /// [`Config::crc`] of the accepted configuration, 0 before the first CONFIG since boot.
    pub config_crc: u32,
    /// Number of the arm that is at the board, from its EEPROM; [`NO_RIG`] where none was written.
    pub rig: u32,
}

/// An arm that was given no number: an erased EEPROM.
pub const NO_RIG: u32 = u32::MAX;

/// One board's measurements in wire units. Channels of the other board are absent and 0.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Sample {
    /// Oscillator periods within the gate (about 11,000 in 8 ms), per spring 1 to 12.
    pub spring_counts: [u16; SPRINGS],
    /// Measured gate length per spring, ticks (about 16,000).
    pub spring_gate_ticks: [u16; SPRINGS],
    /// Angular rate about the IMU's own x, y, z, [`GYRO_STEP_RAD_S`].
    pub gyro: [[i16; 3]; IMUS],
    /// Specific force along the IMU's own x, y, z, [`ACCEL_STEP_M_S2`].
    pub accel: [[i16; 3]; IMUS],
    /// Gauge pressure of each chamber, 1 to 6, see [`pressure_pa`].
    pub pressure: [u16; CHAMBERS],
    /// Delivered channels, bits as `RawFrame::present`.
    pub present: u32,
    /// See [`fault`].
    pub status: u16,
}

/// Set pressures in wire units.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Setpoint {
    /// Gauge pressure of each chamber, 1 to 6, see [`pressure_pa`]. A board uses its own three.
    pub pressure: [u16; CHAMBERS],
    /// How long it holds without a successor, ms; 0: pumps off. A board ignores one beyond [`LONGEST_TTL_MS`].
    pub ttl_ms: u16,
}

impl Setpoint {
    /// Pumps off, without a latch.
    pub const OFF: Self = Self {
        pressure: [32_768; CHAMBERS],
        ttl_ms: 0,
    };
}

/// The limits a board keeps. It accepts none looser than those built into it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Config {
    /// Lowest set pressure, see [`pressure_pa`].
    pub pressure_min: u16,
    /// Highest set pressure, see [`pressure_pa`].
    pub pressure_max: u16,
    /// Pumps off beyond this pressure or below its negative, see [`pressure_pa`].
    pub over_pressure: u16,
    /// SAFE after this long without HEARTBEAT, ms.
    pub heartbeat_timeout_ms: u16,
}

impl Config {
    /// From the robot's limits (gauge, Pa).
    pub fn new(limits: &PressureLimits, over_pressure_pa: f64) -> Self {
        Self {
            pressure_min: pressure_code(limits.min_pa),
            pressure_max: pressure_code(limits.max_pa),
            over_pressure: pressure_code(over_pressure_pa),
            heartbeat_timeout_ms: HEARTBEAT_TIMEOUT_MS,
        }
    }

    /// The limits built into every board: ±40 kPa, 42 kPa, 200 ms.
    pub fn built_in() -> Self {
        Self {
            pressure_min: pressure_code(-40e3),
            pressure_max: pressure_code(40e3),
            over_pressure: pressure_code(42e3),
            heartbeat_timeout_ms: HEARTBEAT_TIMEOUT_MS,
        }
    }

    /// Whether a board accepts these limits: sound, no looser than [`Self::built_in`], and with the over-pressure
    /// bound, which holds for both signs, beyond every pressure that may be set.
    pub fn is_allowed(&self) -> bool {
        let widest = Self::built_in();
        let lowest_before_over = 65_536 - u32::from(self.over_pressure);
        self.pressure_min >= widest.pressure_min
            && self.pressure_max <= widest.pressure_max
            && self.pressure_min < self.pressure_max
            && self.over_pressure >= self.pressure_max
            && u32::from(self.pressure_min) >= lowest_before_over
            && self.over_pressure <= widest.over_pressure
            && (1..=widest.heartbeat_timeout_ms).contains(&self.heartbeat_timeout_ms)
    }

    /// The payload, field by field.
    fn words(&self) -> [u16; 4] {
        [
            self.pressure_min,
            self.pressure_max,
            self.over_pressure,
            self.heartbeat_timeout_ms,
        ]
    }

    /// CRC-32 of the payload as sent; never 0, which means "no configuration yet".
    pub fn crc(&self) -> u32 {
        let mut payload = Vec::with_capacity(8);
        for word in self.words() {
            payload.extend(word.to_le_bytes());
        }
        CRC32.checksum(&payload).max(1)
    }
}

/// Pressure code of a gauge pressure in Pa, rounded and saturated; 0 Pa for a NaN.
pub fn pressure_code(gauge_pa: f64) -> u16 {
    let pa = if gauge_pa.is_nan() { 0.0 } else { gauge_pa };
    // A float to integer cast saturates.
    (pa / PRESSURE_STEP_PA + 32_768.0).round() as u16
}

/// Gauge pressure of a code, Pa: p = 2 Pa · (code − 32768).
pub fn pressure_pa(code: u16) -> f64 {
    (f64::from(code) - 32_768.0) * PRESSURE_STEP_PA
}

/// Gyroscope and accelerometer counts of a reading, rounded and saturated; axes x, y, z of the IMU.
pub fn imu_codes(imu: &ImuRaw) -> ([i16; 3], [i16; 3]) {
    (
        imu.gyro_rad_s.map(|w| (w / GYRO_STEP_RAD_S).round() as i16),
        imu.accel_m_s2.map(|a| (a / ACCEL_STEP_M_S2).round() as i16),
    )
}

/// A reading in SI units from its counts.
pub fn imu_reading(gyro: [i16; 3], accel: [i16; 3]) -> ImuRaw {
    ImuRaw {
        gyro_rad_s: gyro.map(|c| f64::from(c) * GYRO_STEP_RAD_S),
        accel_m_s2: accel.map(|c| f64::from(c) * ACCEL_STEP_M_S2),
    }
}

/// The channels a board (0-based) delivers, bits as `RawFrame::present`: board 0 segment 1, board 1 segment 2.
pub const fn board_channels(board: usize) -> u32 {
    let springs = 0x3f << (6 * board);
    let imus = 0x3 << (SPRINGS + 2 * board);
    let chambers = 0x7 << (SPRINGS + IMUS + 3 * board);
    springs | imus | chambers
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::signal::RawFrame;

    #[test]
    fn the_two_boards_share_out_all_channels() {
        assert_eq!(board_channels(0) & board_channels(1), 0);
        assert_eq!(board_channels(0) | board_channels(1), RawFrame::ALL_PRESENT);
    }

    #[test]
    fn pressure_codes_span_the_range_at_two_pascals() {
        for pa in [-60e3, -40e3, -1.0, 0.0, 1e3, 42e3, 60e3] {
            assert!((pressure_pa(pressure_code(pa)) - pa).abs() <= 1.0);
        }
        assert_eq!(pressure_code(f64::NAN), 32_768);
        assert_eq!(pressure_code(1e9), u16::MAX);
        assert_eq!(pressure_code(f64::NEG_INFINITY), 0);
    }

    #[test]
    fn imu_counts_saturate_and_return_within_half_a_step() {
        let reading = ImuRaw {
            gyro_rad_s: [0.5, -8.0, 100.0],
            accel_m_s2: [9.81, -0.3, -1e3],
        };
        let (gyro, accel) = imu_codes(&reading);
        let back = imu_reading(gyro, accel);
        for k in 0..2 {
            assert!((back.gyro_rad_s[k] - reading.gyro_rad_s[k]).abs() <= GYRO_STEP_RAD_S / 2.0);
            assert!((back.accel_m_s2[k] - reading.accel_m_s2[k]).abs() <= ACCEL_STEP_M_S2 / 2.0);
        }
        assert_eq!((gyro[2], accel[2]), (i16::MAX, i16::MIN));
    }

    #[test]
    fn configurations_differ_in_their_crc() {
        let built_in = Config::built_in();
        let other = Config {
            over_pressure: pressure_code(41e3),
            ..built_in
        };
        assert_ne!(built_in.crc(), 0);
        assert_ne!(built_in.crc(), other.crc());
    }
}
