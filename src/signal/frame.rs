use nalgebra::{Rotation3, SVector};
use serde::{Deserialize, Serialize};

use super::{
    CHAMBERS, ChannelHealth, Evidence, FAULT_NAMED, FOUND_RAD, Health, IMUS, Quality, SIGNALS,
    SPRINGS, Stamp, UNKNOWN_M, UNKNOWN_RAD,
};

/// Number of micro-controller boards that share the sensors: one per segment.
pub const BOARDS: usize = 2;

/// One reading of an inertial measurement unit, in its own axes (IMU frame: x, y, z).
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ImuRaw {
    /// Angular rate about x, y, z of the IMU, rad/s.
    pub gyro_rad_s: [f64; 3],
    /// Specific force along x, y, z of the IMU, m/s² (about +9.81 on the upward axis at rest).
    pub accel_m_s2: [f64; 3],
}

/// What the boards measured, on one time base, before any calibration.
///
/// A channel whose `present` bit is clear carries no information this frame
/// (its value is zero and must not be used).
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RawFrame {
    /// Counts frames since the link opened; gaps are lost frames.
    pub seq: u32,
    /// When the frame was sampled, on the session's time base.
    pub stamp: Stamp,
    /// Oscillator periods counted within its gate, per spring in the order 1A, 1B to 6A, 6B.
    pub spring_counts: [u32; SPRINGS],
    /// Length of each spring's gate in clock ticks of its board.
    pub spring_gate_ticks: [u32; SPRINGS],
    /// Ticks per second of each board's clock, on the session's time base, board 1 first.
    pub tick_rate_hz: [f64; BOARDS],
    /// Relative standard deviation of each of them, s/s; 0 where it is taken as exact.
    pub tick_rate_sd: [f64; BOARDS],
    /// Raw inertial readings of IMUs 1 to 4.
    pub imu: [ImuRaw; IMUS],
    /// Gauge pressure of each chamber, 1 to 6, Pa.
    pub chamber_pa: [f64; CHAMBERS],
    /// Bits 0-11 springs, 12-15 IMUs, 16-21 chambers: set when the channel was delivered.
    pub present: u32,
    /// How old each board's part of the frame is at `stamp`, s.
    pub board_age_s: [f64; BOARDS],
    /// Fault bits as the boards report them (see `link::wire`).
    pub faults: u16,
}

/// Largest relative standard deviation of a board's clock rate with which lengths are read, s/s.
const MAX_RATE_SD: f64 = 2.5e-4;

impl RawFrame {
    /// `present` with every channel delivered.
    pub const ALL_PRESENT: u32 = (1 << (SPRINGS + IMUS + CHAMBERS)) - 1;

    /// Whether the rate of a board's clock is known well enough for lengths: to 0.5 mm of 154 mm. The link takes half a
    /// second, or two on a busy line, to measure the clock of a board of which it knows nothing.
    pub fn clock_is_known(&self, board: usize) -> bool {
        self.tick_rate_sd[board] <= MAX_RATE_SD
    }

    /// The same for all boards.
    pub fn clocks_are_known(&self) -> bool {
        (0..BOARDS).all(|b| self.clock_is_known(b))
    }

    /// Whether all are known so well that they stay known when one jumps, which leaves its rate as it was but for 5e-5: what moves
    /// must not lose the springs of a board in its first seconds.
    pub fn clocks_have_settled(&self) -> bool {
        self.tick_rate_sd.iter().all(|sd| *sd <= 0.4 * MAX_RATE_SD)
    }

    /// Ticks per second of the clock that counts spring `i` (0-based).
    pub fn spring_tick_rate_hz(&self, i: usize) -> f64 {
        self.tick_rate_hz[board_of_spring(i)]
    }

    /// Whether spring `i` (0-based) was delivered.
    pub fn has_spring(&self, i: usize) -> bool {
        self.present & (1 << i) != 0
    }

    /// Whether IMU `i` (0-based) was delivered.
    pub fn has_imu(&self, i: usize) -> bool {
        self.present & (1 << (SPRINGS + i)) != 0
    }

    /// Whether the pressure of chamber `i` (0-based) was delivered.
    pub fn has_chamber(&self, i: usize) -> bool {
        self.present & (1 << (SPRINGS + IMUS + i)) != 0
    }
}

/// The 24 geometric sensor signals: spring lengths and pad orientations measured by the IMUs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SensorVec {
    /// Length of each spring between its two pads, in the order 1A, 1B to 6A, 6B, m.
    pub spring_m: [f64; SPRINGS],
    /// Yaw, pitch, roll of the pad under each IMU (1 to 4), base from pad, rad (nominal mounting removed).
    pub imu_ypr_rad: [[f64; 3]; IMUS],
}

impl SensorVec {
    /// The paper's 24-signal interface: twelve lengths in m, then four yaw, pitch, roll triples in rad.
    pub fn to_vector(&self) -> SVector<f64, SIGNALS> {
        let mut v = SVector::zeros();
        for (i, l) in self.spring_m.iter().enumerate() {
            v[i] = *l;
        }
        for (i, ypr) in self.imu_ypr_rad.iter().enumerate() {
            for k in 0..3 {
                v[SPRINGS + 3 * i + k] = ypr[k];
            }
        }
        v
    }

    /// The inverse of [`Self::to_vector`].
    pub fn from_vector(v: &SVector<f64, SIGNALS>) -> Self {
        Self {
            spring_m: std::array::from_fn(|i| v[i]),
            imu_ypr_rad: std::array::from_fn(|i| std::array::from_fn(|k| v[SPRINGS + 3 * i + k])),
        }
    }

    /// Orientation of the pad under IMU `i` (0-based), base from pad.
    pub fn base_from_imu_pad(&self, i: usize) -> Rotation3<f64> {
        let [yaw, pitch, roll] = self.imu_ypr_rad[i];
        Rotation3::from_euler_angles(roll, pitch, yaw)
    }
}

/// Plugs that are exchanged; indices are 0-based.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Swap {
    /// The boards of the two segments.
    Boards,
    /// Two springs of one segment.
    Springs(usize, usize),
    /// Two IMUs of one pad.
    Imus(usize, usize),
}

/// What channels that are not right delivered nevertheless; `None` for the others, and where nothing came.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Delivered {
    /// Length per spring, m, in the order of [`SensorVec::spring_m`]; `None` for a channel that is right or delivered
    /// nothing.
    pub spring_m: [Option<f64>; SPRINGS],
    /// Yaw, pitch, roll of the pad per IMU, base from pad, rad; `None` likewise.
    pub imu_ypr_rad: [Option<[f64; 3]>; IMUS],
}

impl Delivered {
    /// Twelve lengths, then four times yaw, pitch, roll; NaN where there is none.
    pub fn to_array(&self) -> [f64; SIGNALS] {
        let turns = self.imu_ypr_rad.map(|ypr| ypr.unwrap_or([f64::NAN; 3]));
        std::array::from_fn(|k| match k.checked_sub(SPRINGS) {
            None => self.spring_m[k].unwrap_or(f64::NAN),
            Some(k) => turns[k / 3][k % 3],
        })
    }

    /// The inverse of [`Self::to_array`].
    pub fn from_array(values: &[f64; SIGNALS]) -> Self {
        let known = |x: f64| x.is_finite().then_some(x);
        Self {
            spring_m: std::array::from_fn(|i| known(values[i])),
            imu_ypr_rad: std::array::from_fn(|i| {
                let at = SPRINGS + 3 * i;
                let [yaw, pitch, roll] = [0, 1, 2].map(|k| known(values[at + k]));
                Some([yaw?, pitch?, roll?])
            }),
        }
    }
}

/// Calibrated sensors at one instant.
#[derive(Clone, Debug, PartialEq)]
pub struct SensorFrame {
    /// When the raw frame was sampled.
    pub stamp: Stamp,
    /// The 24 signals. Those of channels that are not usable are reconstructed from the other channels; where that is
    /// impossible, the last good value is held.
    pub sensors: SensorVec,
    /// Standard deviation by which each of the 24 signals (order of [`SensorVec::to_vector`]) may be off beyond its usual
    /// noise, m and rad: because it is reconstructed, inconsistent with the others, or its heading has not been confirmed for
    /// a while; [`UNKNOWN_M`] and [`UNKNOWN_RAD`] for held ones. Recordings of the first layout and logs do not keep it: 0.
    pub extra_sigma: [f64; SIGNALS],
    /// What the channels that are not [`ChannelHealth::Ok`] delivered in place of what `sensors` has for them.
    pub delivered: Delivered,
    /// Gauge pressure of each chamber, 1 to 6, Pa.
    pub chamber_pa: [f64; CHAMBERS],
    /// Which channels may be used.
    pub health: Health,
    /// How well the channels agree. Recordings do not keep it.
    pub quality: Quality,
}

impl SensorFrame {
    /// The 24 signals as they were measured: nothing is reconstructed or held, and a channel that delivered nothing is NaN.
    pub fn measured(&self) -> SensorVec {
        let (delivered, ok) = (&self.delivered, ChannelHealth::Ok);
        SensorVec {
            spring_m: std::array::from_fn(|i| match self.health.springs[i] == ok {
                true => self.sensors.spring_m[i],
                false => delivered.spring_m[i].unwrap_or(f64::NAN),
            }),
            imu_ypr_rad: std::array::from_fn(|i| match self.health.imus[i] == ok {
                true => self.sensors.imu_ypr_rad[i],
                false => delivered.imu_ypr_rad[i].unwrap_or([f64::NAN; 3]),
            }),
        }
    }

    /// Whether there are signals that can neither be read nor reconstructed, or a segment whose pose geometry does not
    /// give from the channels that are delivered.
    pub fn is_blind(&self) -> bool {
        let (springs, imus) = self.extra_sigma.split_at(SPRINGS);
        let determined = self.quality.is_determined == [true; 2];
        !determined
            || springs.iter().any(|sd| *sd >= UNKNOWN_M)
            || imus.iter().any(|sd| *sd >= UNKNOWN_RAD)
    }
}

/// The board (0-based) that counts spring `i` (0-based).
pub fn board_of_spring(i: usize) -> usize {
    i / (SPRINGS / BOARDS)
}

impl SensorFrame {
    /// What is known about spring `i` (0-based).
    pub fn spring_evidence(&self, i: usize) -> Evidence {
        Evidence {
            health: self.health.springs[i],
            probability: self.quality.fault_probability[i],
            off_m: self.quality.spring_off_m[i],
            extra_sigma: self.extra_sigma[i],
            heading_sd_rad: None,
        }
    }

    /// What is known about IMU `i` (0-based).
    pub fn imu_evidence(&self, i: usize) -> Evidence {
        let at = SPRINGS + 3 * i;
        let sd_rad = &self.extra_sigma[at..at + 3];
        let health = self.health.imus[i];
        let probability = self.quality.fault_probability[SPRINGS + i];
        let waits =
            health == ChannelHealth::Suspect && sd_rad[0] > FOUND_RAD && probability <= FAULT_NAMED;
        Evidence {
            health,
            probability,
            off_m: None,
            extra_sigma: sd_rad.iter().fold(0.0, |most, sd| sd.max(most)),
            heading_sd_rad: waits.then_some(sd_rad[0]),
        }
    }
}
