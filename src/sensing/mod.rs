//! From counts to lengths, from rates to orientations, and the health of each channel.
//!
//! [`Sensing::update`] takes one [`RawFrame`] and gives one [`SensorFrame`]: twelve lengths by the
//! calibration, four pad orientations, six pressures, and the health of every channel. One estimator ([`filter`])
//! follows the pads' motion by whatever is delivered; a channel that is out is reconstructed from it, with its
//! uncertainty, and a channel whose bias is not a healthy one's is faulty ([`faults`]). Nothing that is not finite leaves
//! this module.
//!
//! Readings of healthy channels stay their own: a length is the spring's, corrected for its lag, and for ends that were
//! calibrated beside the drawing: it is what a spring of the drawing would have at the same pose. An inclination is the
//! IMU's. A heading, which no IMU can measure, is the estimator's.
//!
//! It imports robot and signal alone: no simulator, no rig, no clock, no I/O. Motion capture is put
//! into the robot's frame here ([`registration`]) and takes no part in a [`SensorFrame`].

pub mod bench;
pub mod bundle;
pub mod calibration;
mod consistency;
pub mod faults;
mod file;
pub mod filter;
pub mod imu;
pub mod imu_fit;
mod noise;
pub mod platform;
pub mod registration;
mod repeats;
pub mod score;
mod shape;
pub mod spring;
mod ways;
mod wiring;

use nalgebra::{UnitQuaternion, Vector3};

pub use calibration::Calibration;
use consistency::{Consistency, Look};
use faults::Faults;
pub use file::CalibrationError;
use filter::{Channel, Filter, LAG_S, Reading};
use imu::{ImuTrack, Sample};
use noise::Noise;
use platform::{LEGS, Segment};
use repeats::{Frozen, RawLength, Repeats};
pub use shape::{shape_by_pads, shape_by_sensors};
use spring::SpringReading;
use ways::Ways;
use wiring::Wiring;

use crate::robot::RobotSpec;
use crate::signal::{
    BOARDS, CHAMBERS, ChannelHealth, Delivered, FAULT_NAMED, FOUND_M, FOUND_RAD, Health, IMUS,
    ImuRaw, NIS_HIGH, Need, Pose, Quality, RawFrame, SIGNALS, SPRINGS, SensorFrame, SensorVec,
    Swap, UNKNOWN_M, UNKNOWN_RAD, board_of_spring, ypr_from_rotation,
};

/// Gauge pressures outside of this are not pressures, Pa (a gauge cannot read below vacuum).
const GAUGE_RANGE_PA: [f64; 2] = [-101_325.0, 200_000.0];
/// A board's data older than this is suspect, and older than that is gone, s.
const BOARD_AGE_S: [f64; 2] = [0.03, 0.1];
/// A longer gap between frames restarts the estimator, s.
const GAP_S: f64 = 0.5;
/// Longest step of the estimator, s.
const STEP_S: f64 = 0.02;
/// An innovation beyond so many standard deviations is not taken in.
const GATE: f64 = 5.0;
/// So many springs of a segment beyond it are a blow.
const BLOW_SPRINGS: usize = 3;
/// A reading that stays beyond the gate for so many frames has jumped.
const JUMP_FRAMES: u32 = 2;
const JUMP_FRAMES_IMU: u32 = 30;
/// So many frames of blows running: the estimator has lost the arm.
const LOST_FRAMES: u32 = 50;
/// Interval at which the hypotheses of a segment are compared, s.
const JUDGE_S: f64 = 0.1;
/// Averaging time of the normalised innovations squared, s.
const NIS_TAU_S: f64 = 2.0;
/// Noise of a length (m), rate (rad/s) and force (m/s²) before it is measured, and the least that is believed.
const LENGTH_NOISE_M: [f64; 2] = [0.12e-3, 0.03e-3];
const RATE_NOISE: [f64; 2] = [1e-3, 1e-4];
const FORCE_NOISE: [f64; 2] = [0.04, 0.005];
/// Errors of gain and alignment: a share of the rate and of the acceleration.
const RATE_GAIN: f64 = 0.003;
const FORCE_GAIN: f64 = 0.01;
/// Beyond the springs' range by this, a reconstructed length is none, m.
const BEYOND_M: f64 = 8e-3;
/// A spring under suspicion is stuck when it should have moved by this at least, m.
const STUCK_WAY_M: f64 = 1e-3;

/// Averaging time of the gyros' biases, s.
const BIAS_TAU_S: f64 = 20.0;
/// Poses whose headings are off by more than this are not compared, rad.
const HEADING_CHANGE_RAD: f64 = 0.1;
/// Pads that turn faster than this are not compared at rest, rad/s.
const SLOW_RAD_S: f64 = 0.35;

/// State of the sensing.
pub struct Sensing {
    spec: RobotSpec,
    calibration: Calibration,
    rest_m: [f64; SPRINGS],
    filter: Filter,
    faults: Faults,
    has_started: bool,
    /// A faulty spring was found that the estimator has followed.
    is_misled: bool,
    repeats: [Repeats; BOARDS],
    frozen: [Frozen; IMUS],
    length_noise: [Noise; SPRINGS],
    /// Per IMU: of its rates and of its forces, per axis.
    imu_noise: [[[Noise; 3]; 2]; IMUS],
    tracks: [ImuTrack; IMUS],
    /// Biases of the gyros, averaged, so that a fault does not turn the IMUs' orientations as well, and for how long.
    gyro_bias: [Vector3<f64>; IMUS],
    averaged_s: f64,
    /// Last length of each spring that was taken in, m.
    good_m: [Option<f64>; SPRINGS],
    /// Frames for which each channel has been beyond the gate.
    gated: [u32; SPRINGS + IMUS],
    blows: [u32; 2],
    ways: [Option<Ways>; SPRINGS],
    nis: [f64; SPRINGS + IMUS],
    wiring: Wiring,
    consistency: Consistency,
    /// Per segment, IMUs whose orientations its newest kept poses have, with their heading offsets.
    compared: [[Option<f64>; IMUS]; 2],
    since_judged_s: f64,
    judged: usize,
    chamber_pa: [f64; CHAMBERS],
    last: Option<SensorFrame>,
}

/// Readings of one frame.
struct Frame {
    readings: [Option<Reading>; SPRINGS + IMUS],
    health: [ChannelHealth; SPRINGS + IMUS],
    resolution_m: [f64; SPRINGS],
    samples: [Sample; IMUS],
    /// Length that each spring delivered, whatever it is worth, m.
    length_m: [Option<f64>; SPRINGS],
    boards: [ChannelHealth; BOARDS],
}

impl Sensing {
    /// A fresh start. Springs that the calibration does not cover read as missing
    /// (see [`Calibration::uncovered`]).
    pub fn new(spec: &RobotSpec, calibration: Calibration) -> Self {
        let noise = |[assumed, least]: [f64; 2]| Noise::new(assumed, least);
        let filter = Filter::new(spec, &calibration);
        let segments = [0, 1].map(|k| Segment::of(spec, k));
        let rest_m = segments.each_ref().map(|s| s.lengths_m(&s.rest()));
        Self {
            tracks: std::array::from_fn(|i| {
                let nominal = UnitQuaternion::from_rotation_matrix(&spec.imus[i].pad_from_imu);
                ImuTrack::new(calibration.mounting(i) * nominal)
            }),
            consistency: Consistency::new(filter.spring_sd_m(), !calibration.imus.is_empty()),
            compared: [[None; IMUS]; 2],
            filter,
            gyro_bias: [Vector3::zeros(); IMUS],
            averaged_s: 0.0,
            faults: Faults::default(),
            has_started: false,
            is_misled: false,
            repeats: Default::default(),
            frozen: Default::default(),
            length_noise: [noise(LENGTH_NOISE_M); SPRINGS],
            imu_noise: [[[noise(RATE_NOISE); 3], [noise(FORCE_NOISE); 3]]; IMUS],
            good_m: [None; SPRINGS],
            gated: [0; SPRINGS + IMUS],
            blows: [0; 2],
            ways: [None; SPRINGS],
            nis: [1.0; SPRINGS + IMUS],
            wiring: Wiring::default(),
            since_judged_s: 0.0,
            judged: 0,
            chamber_pa: [0.0; CHAMBERS],
            last: None,
            rest_m: std::array::from_fn(|i| rest_m[i / LEGS][i % LEGS]),
            calibration,
            spec: spec.clone(),
        }
    }

    /// Forgets everything but the robot and the calibration.
    pub fn reset(&mut self) {
        *self = Self::new(&self.spec, self.calibration.clone());
    }

    /// The calibration in use.
    pub fn calibration(&self) -> &Calibration {
        &self.calibration
    }

    /// Middle and end pad (upper faces), base from pad, by all sensors, as of the last frame.
    pub fn pads(&self) -> [Pose; 2] {
        self.filter.poses()
    }

    /// The same by the springs alone, as of the last frame: `None` below a segment with a spring that is not healthy, and
    /// before the first frame.
    pub fn pads_by_springs(&self) -> [Option<Pose>; 2] {
        let Some(last) = &self.last else {
            return [None; 2];
        };
        let [middle, end] = platform::pads_of_lengths(&self.spec, &last.sensors.spring_m);
        let ok = |k: usize| {
            let mut health = last.health.springs[LEGS * k..LEGS * (k + 1)].iter();
            health.all(|h| *h == ChannelHealth::Ok)
        };
        [ok(0).then_some(middle), (ok(0) && ok(1)).then_some(end)]
    }

    /// Normalised innovations squared of each spring, then of each IMU, averaged over two seconds; 1 for noise alone.
    pub fn nis(&self) -> &[f64; SPRINGS + IMUS] {
        &self.nis
    }

    /// Verdicts on the channels.
    pub fn faults(&self) -> &Faults {
        &self.faults
    }

    /// Plugs or boards that are exchanged; `None` while that is not certain.
    pub fn wiring(&self) -> Option<Swap> {
        self.wiring.verdict()
    }

    /// The estimator.
    pub fn filter(&self) -> &Filter {
        &self.filter
    }

    /// What is most uncertain, while the pads' poses are not known; `None` once they are.
    pub fn need(&self) -> Option<Need> {
        let mut worst: Option<(f64, Need)> = None;
        for p in 0..2 {
            let (place_m, [x, y, z]) = self.filter.pad_sd(p);
            let tilt = x.max(y);
            for (excess, need) in [
                (place_m / FOUND_M, Need::Position(p, place_m)),
                (tilt / FOUND_RAD, Need::Inclination(p, tilt)),
                (z / FOUND_RAD, Need::Heading(p, z)),
            ] {
                if excess > 1.0 && worst.is_none_or(|(most, _)| excess > most) {
                    worst = Some((excess, need));
                }
            }
        }
        worst.map(|(_, need)| need)
    }

    /// Takes in one frame. A frame that is not newer than the last one changes nothing and gives
    /// the last result again.
    pub fn update(&mut self, frame: &RawFrame) -> SensorFrame {
        let dt_s = match &self.last {
            Some(last) if frame.stamp <= last.stamp => return last.clone(),
            Some(last) => frame.stamp.since(last.stamp),
            None => 1.0 / imu::RATE_HZ,
        };
        let board = std::array::from_fn(|b| board_health(frame, b));
        let mut now = self.read(frame, &board);
        self.estimate(dt_s, frame, &mut now);
        self.judge(dt_s, &now);
        self.watch_wiring(frame, &now);
        self.orient(dt_s, frame, &mut now);
        self.compare_poses(frame, &now);
        let health = self.health(frame, &board, &now);
        let out = self.frame(frame, health, &now);
        self.last = Some(out.clone());
        out
    }

    /// Lengths and inertial readings, with their variances.
    fn read(&mut self, frame: &RawFrame, board: &[ChannelHealth; BOARDS]) -> Frame {
        let mut out = Frame {
            readings: [None; SPRINGS + IMUS],
            health: [ChannelHealth::Missing; SPRINGS + IMUS],
            resolution_m: [0.0; SPRINGS],
            samples: [Sample::Lost; IMUS],
            length_m: [None; SPRINGS],
            boards: *board,
        };
        for i in 0..SPRINGS {
            let board = board[board_of_spring(i)];
            let clock_sd = frame.tick_rate_sd[board_of_spring(i)];
            let delivered = frame.has_spring(i)
                && board != ChannelHealth::Missing
                && frame.clock_is_known(board_of_spring(i));
            let calibration = self.calibration.spring(i).filter(|_| delivered);
            let (n, ticks) = (frame.spring_counts[i], frame.spring_gate_ticks[i]);
            let rate_hz = frame.spring_tick_rate_hz(i);
            let read = spring::read(calibration, n, ticks, rate_hz);
            let length_m = read.length_m();
            self.length_noise[i].update(length_m);
            out.length_m[i] = length_m;
            out.health[i] = match read {
                SpringReading::Nothing => ChannelHealth::Missing,
                SpringReading::OutOfRange => ChannelHealth::OutOfRange,
                SpringReading::Length(_) => board,
            };
            out.resolution_m[i] = spring::resolution_m(calibration, n, ticks, rate_hz);
            // As far as the rate of the board's clock is not known.
            let clock_m = out.resolution_m[i] * f64::from(ticks) * clock_sd;
            out.readings[i] = length_m.map(|value_m| Reading::Length {
                spring: i,
                value_m,
                variance: self.length_noise[i].variance() + clock_m * clock_m,
            });
        }
        for i in 0..IMUS {
            let at = SPRINGS + i;
            let board = board[board_of_imu(i)];
            let delivered = frame.has_imu(i) && board != ChannelHealth::Missing;
            let raw = Some(&frame.imu[i]).filter(|raw| delivered && imu::credible(raw));
            out.samples[i] = self.tracks[i].sample(delivered, raw.is_some());
            out.health[at] = match out.samples[i] {
                Sample::Good => board,
                Sample::Held => ChannelHealth::Suspect,
                Sample::Lost => ChannelHealth::Missing,
            };
            let zero = self.calibration.imu_zero(i);
            let raw = raw.map(|raw| zero.remove(raw));
            out.readings[at] = raw.map(|raw| self.inertial(i, &raw));
            if raw.is_none() {
                for noise in self.imu_noise[i].iter_mut().flatten() {
                    noise.update(None);
                }
            }
        }
        out
    }

    /// An IMU's reading with the variances of its noise and of its errors of gain.
    fn inertial(&mut self, i: usize, raw: &ImuRaw) -> Reading {
        let mut variance = [0.0; 2];
        let signals = [&raw.gyro_rad_s, &raw.accel_m_s2];
        for ((mean, noise), signal) in variance.iter_mut().zip(&mut self.imu_noise[i]).zip(signals)
        {
            for (noise, x) in noise.iter_mut().zip(signal) {
                noise.update(Some(*x));
                *mean += noise.variance() / 3.0;
            }
        }
        let pad = &self.filter.pads[self.spec.imus[i].pad.index()];
        variance[0] += (RATE_GAIN * pad.rate.norm()).powi(2);
        variance[1] += (FORCE_GAIN * pad.acceleration.norm()).powi(2);
        Reading::Imu {
            imu: i,
            raw: *raw,
            variance,
        }
    }

    /// Moves the estimator on and takes in what is plausible.
    fn estimate(&mut self, dt_s: f64, frame: &RawFrame, now: &mut Frame) {
        let gap = !self.has_started || dt_s > GAP_S;
        if gap || self.is_misled {
            let mut readings = [Reading::default(); SPRINGS + IMUS];
            let mut n = 0;
            for reading in now.readings.iter().flatten() {
                readings[n] = *reading;
                n += 1;
            }
            if n == 0 {
                return;
            }
            match gap {
                true => self.filter.start(&readings[..n]),
                false => {
                    self.filter.predict(dt_s.min(STEP_S));
                    self.filter.find_again(&readings[..n]);
                }
            }
            self.has_started = self.filter.is_sane();
            self.is_misled = false;
            self.compared = [[None; IMUS]; 2];
            self.gated = [0; SPRINGS + IMUS];
            self.nis = [1.0; SPRINGS + IMUS];
            return;
        }
        let steps = (dt_s / STEP_S).ceil().max(1.0);
        for _ in 0..steps as usize {
            self.filter.predict(dt_s / steps);
        }
        self.find_repeats(frame, now);
        for p in 0..2 {
            let least = self.least_innovations(p, now);
            self.filter.enliven(p, dt_s, least);
        }
        let mut beyond = self.beyond(now);
        for k in 0..2 {
            let springs = LEGS * k..LEGS * (k + 1);
            let here = springs.clone().filter(|i| beyond[*i]).count();
            let is_blow = here >= BLOW_SPRINGS;
            self.blows[k] = if is_blow { self.blows[k] + 1 } else { 0 };
            if is_blow {
                for p in k..2 {
                    self.filter.disturb(p);
                }
                beyond = self.beyond(now);
            }
        }
        if self.blows.iter().any(|n| *n > LOST_FRAMES) {
            self.has_started = false;
            self.blows = [0; 2];
        }
        self.take(dt_s, now, &beyond);
        if !self.filter.is_sane() {
            self.filter = Filter::new(&self.spec, &self.calibration);
            self.faults = Faults::default();
            self.has_started = false;
        }
    }

    /// Innovations of forces and rates of the IMU of a pad that is surprised least: mean square per axis, and its part
    /// that noise explains. One IMU alone cannot make a pad lively that another one sees at rest.
    fn least_innovations(&mut self, p: usize, now: &Frame) -> Option<[[f64; 2]; 2]> {
        let mut least: Option<[[f64; 2]; 2]> = None;
        for i in 0..IMUS {
            if self.spec.imus[i].pad.index() != p || self.filter.is_open(Channel::Imu(i)) {
                continue;
            }
            let Some(reading @ Reading::Imu { variance, .. }) = now.readings[SPRINGS + i] else {
                continue;
            };
            let (mut squares, mut n) = ([0.0; 2], 0);
            reading.rows(&mut self.filter, &mut |_, _, missed, _| {
                // Three rates, then three forces.
                squares[1 - n / 3] += missed * missed / 3.0;
                n += 1;
            });
            let own = [[squares[0], variance[1]], [squares[1], variance[0]]];
            least = Some(match least {
                None => own,
                Some(other) => [0, 1].map(|k| {
                    if own[k][0] < other[k][0] {
                        own[k]
                    } else {
                        other[k]
                    }
                }),
            });
        }
        least
    }

    /// IMUs of the lower pad of segment `k`.
    fn pair(&self, k: usize) -> impl Iterator<Item = usize> + Clone + use<'_> {
        (0..IMUS).filter(move |i| self.spec.imus[*i].pad.index() == k)
    }

    /// Drops readings that repeat while they should not.
    fn find_repeats(&mut self, frame: &RawFrame, now: &mut Frame) {
        for b in 0..BOARDS {
            let raw: [Option<RawLength>; LEGS] = std::array::from_fn(|leg| {
                let i = LEGS * b + leg;
                now.readings[i].as_ref()?;
                let (expected_m, _, _) = self.filter.length(i);
                Some(RawLength {
                    raw: (frame.spring_counts[i], frame.spring_gate_ticks[i]),
                    expected_m,
                    rate_m_s: self.filter.length_rate_m_s(i),
                    resolution_m: now.resolution_m[i],
                })
            });
            for (leg, stuck) in self.repeats[b].update(&raw).into_iter().enumerate() {
                if stuck {
                    now.readings[LEGS * b + leg] = None;
                    now.health[LEGS * b + leg] = ChannelHealth::Stuck;
                }
            }
        }
    }

    /// Which readings are beyond the gate.
    fn beyond(&mut self, now: &Frame) -> [bool; SPRINGS + IMUS] {
        std::array::from_fn(|c| {
            let Some(reading) = &now.readings[c] else {
                return false;
            };
            let mut beyond = false;
            reading.rows(&mut self.filter, &mut |filter, row, missed, variance| {
                let (innovation, spread) = filter.innovation(row, missed);
                beyond |= innovation * innovation > GATE * GATE * (spread + variance);
            });
            beyond
        })
    }

    fn take(&mut self, dt_s: f64, now: &Frame, beyond: &[bool; SPRINGS + IMUS]) {
        let pass = dt_s / (NIS_TAU_S + dt_s);
        for (c, &beyond) in beyond.iter().enumerate() {
            let Some(reading) = now.readings[c] else {
                self.gated[c] = 0;
                continue;
            };
            let (mut square, mut n) = (0.0, 0.0);
            reading.rows(&mut self.filter, &mut |filter, row, missed, variance| {
                square += match beyond {
                    true => {
                        let (innovation, spread) = filter.innovation(row, missed);
                        innovation * innovation / (spread + variance)
                    }
                    false => filter.update(row, missed, variance),
                };
                n += 1.0;
            });
            self.nis[c] += pass * (square / n - self.nis[c]);
            self.gated[c] = if beyond { self.gated[c] + 1 } else { 0 };
            if let (Reading::Length { value_m, .. }, false) = (reading, beyond) {
                self.good_m[c] = Some(value_m);
            }
        }
        self.filter.inject();
        for c in 0..SPRINGS + IMUS {
            let channel = Channel::at(c);
            let frames = match channel {
                Channel::Spring(_) => JUMP_FRAMES,
                Channel::Imu(_) => JUMP_FRAMES_IMU,
            };
            if self.gated[c] >= frames {
                self.filter.jump(channel);
                self.gated[c] = 0;
            }
        }
    }

    /// Compares hypotheses on the segments in turn.
    fn judge(&mut self, dt_s: f64, now: &Frame) {
        self.since_judged_s += dt_s;
        for i in 0..SPRINGS {
            let open = self.filter.is_open(Channel::Spring(i));
            let Some(Reading::Length { value_m, .. }) = now.readings[i] else {
                continue;
            };
            let (expected_m, _, _) = self.filter.length(i);
            match &mut self.ways[i] {
                _ if !open => self.ways[i] = None,
                None => self.ways[i] = Some(Ways::of(value_m, expected_m)),
                Some(ways) => ways.add(value_m, expected_m),
            }
        }
        if !self.has_started || self.since_judged_s < 0.5 * JUDGE_S {
            return;
        }
        let k = self.judged;
        self.judged = 1 - k;
        // Springs that have not jumped are compared over several poses.
        let springs = (LEGS * k..LEGS * (k + 1))
            .filter(|i| self.filter.has_jumped(*i))
            .map(Channel::Spring);
        let mut channels = [Channel::Spring(0); LEGS + IMUS];
        let mut n = 0;
        for channel in springs.chain(self.pair(k).map(Channel::Imu)) {
            if now.readings[channel.index()].is_some() {
                channels[n] = channel;
                n += 1;
            }
        }
        let channels = &channels[..n];
        self.faults
            .judge(k, 2.0 * self.since_judged_s, channels, &mut self.filter);
        self.since_judged_s = 0.0;
        let unexplained = (LEGS * k..LEGS * (k + 1)).map(|i| self.nis[i]).sum::<f64>();
        if unexplained > LEGS as f64 * NIS_HIGH {
            self.filter.doubt(k);
        }
    }

    /// Looks for exchanged plugs, once the hypotheses have been compared, while the arm moves slowly.
    fn watch_wiring(&mut self, frame: &RawFrame, now: &Frame) {
        let slow = self.filter.pads.iter().all(|p| p.rate.norm() < SLOW_RAD_S);
        if self.since_judged_s > 0.0 || !slow {
            return;
        }
        let mut length_m = [0.0; SPRINGS];
        for (length_m, reading) in length_m.iter_mut().zip(&now.readings) {
            let Some(Reading::Length { value_m, .. }) = reading else {
                return;
            };
            *length_m = *value_m;
        }
        self.wiring
            .observe(frame, &length_m, &self.spec, &self.calibration);
    }

    /// Compares the springs with the IMUs over several poses, while the arm moves slowly.
    fn compare_poses(&mut self, frame: &RawFrame, now: &Frame) {
        let slow = self.filter.pads.iter().all(|p| p.rate.norm() < SLOW_RAD_S);
        if !self.has_started || !slow || self.gated[..SPRINGS].iter().any(|n| *n > 0) {
            return;
        }
        let k = frame.seq as usize % 2;
        let base_from_level = self.calibration.level_from_base().inverse();
        let headings: [Option<f64>; IMUS] = std::array::from_fn(|i| {
            let pad = self.spec.imus[i].pad.index();
            let healthy = now.health[SPRINGS + i] == ChannelHealth::Ok
                && !self.faults.is_named(pad, Channel::Imu(i));
            (healthy && pad <= k).then(|| self.tracks[i].heading_rad())
        });
        let same = headings.iter().zip(&self.compared[k]).all(|(now, then)| {
            now.is_some() == then.is_some()
                && (now.unwrap_or(0.0) - then.unwrap_or(0.0)).abs() < HEADING_CHANGE_RAD
        });
        if !same {
            self.consistency.turn_headings(k);
            self.compared[k] = headings;
        }
        let mut pads = self.filter.poses();
        for (p, pose) in pads.iter_mut().enumerate().take(k + 1) {
            let mut turned: Option<UnitQuaternion<f64>> = None;
            for i in self.pair(p) {
                let Some(heading_rad) = self.compared[k][i] else {
                    continue;
                };
                let own = self.tracks[i].with_heading(&base_from_level, heading_rad);
                turned = Some(turned.map_or(own, |other| other.slerp(&own, 0.5)));
            }
            let Some(turned) = turned else {
                return;
            };
            pose.rotation = turned;
        }
        let look = Look {
            t_s: frame.stamp.seconds(),
            length_m: std::array::from_fn(|leg| match now.readings[LEGS * k + leg] {
                Some(Reading::Length {
                    spring, value_m, ..
                }) if !self.filter.has_jumped(spring) => {
                    Some(value_m + LAG_S[0] * self.filter.length_rate_m_s(spring))
                }
                _ => None,
            }),
            upper: match k {
                0 => Pose::identity(),
                _ => pads[0],
            },
            lower: pads[k],
        };
        if !self.consistency.observe(k, &look, self.filter.geometry()) {
            return;
        }
        let finding = self.consistency.finding(k);
        let named: [bool; LEGS] = std::array::from_fn(|leg| finding.is_named(leg));
        let differs = named.iter().enumerate().any(|(leg, &named)| {
            let i = LEGS * k + leg;
            !self.filter.has_jumped(i) && named != self.filter.is_open(Channel::Spring(i))
        });
        if differs {
            self.filter.set_faulty(k, &named);
            self.is_misled = true;
        }
    }

    /// Orientation of each pad by its IMUs alone, with the estimator's heading.
    fn orient(&mut self, dt_s: f64, frame: &RawFrame, now: &mut Frame) {
        let pads = self.filter.poses();
        self.averaged_s += dt_s;
        let base_from_level = self.calibration.level_from_base().inverse();
        let changes: [bool; IMUS] = std::array::from_fn(|i| {
            now.readings[SPRINGS + i].is_some() && self.frozen[i].changes()
        });
        for i in 0..IMUS {
            let pad = self.spec.imus[i].pad.index();
            let other = self.pair(pad).any(|j| j != i && changes[j]);
            let reading = &now.readings[SPRINGS + i];
            let raw = reading.as_ref().map(|_| &frame.imu[i]);
            if self.frozen[i].update(dt_s, raw, other, &pads[pad].rotation) {
                now.health[SPRINGS + i] = ChannelHealth::Stuck;
            }
            let steady = match reading {
                Some(Reading::Imu { raw, .. }) => {
                    let bias = &mut self.gyro_bias[i];
                    let averaged_s = self.averaged_s.min(BIAS_TAU_S);
                    *bias += (self.filter.gyro_bias(i) - *bias) * (dt_s / (averaged_s + dt_s));
                    let rate = Vector3::from(raw.gyro_rad_s) - *bias;
                    Some(ImuRaw {
                        gyro_rad_s: rate.into(),
                        accel_m_s2: raw.accel_m_s2,
                    })
                }
                _ => None,
            };
            self.tracks[i].update(dt_s, steady.as_ref());
            self.tracks[i].align(&base_from_level, &pads[pad].rotation);
        }
    }

    fn health(&mut self, frame: &RawFrame, board: &[ChannelHealth; BOARDS], now: &Frame) -> Health {
        let mut springs: [ChannelHealth; SPRINGS] = std::array::from_fn(|i| now.health[i]);
        for (i, health) in springs.iter_mut().enumerate() {
            let finding = self.consistency.finding(i / LEGS);
            let named =
                self.faults.is_named(i / LEGS, Channel::Spring(i)) || finding.is_named(i % LEGS);
            let jumped = self.gated[i] > 0;
            if health.usable() && (named || jumped) {
                let stuck = self.ways[i].is_some_and(|w| w.is_stuck(STUCK_WAY_M))
                    || finding.is_named(i % LEGS) && finding.is_stuck[i % LEGS];
                *health = match stuck {
                    true => ChannelHealth::Stuck,
                    false => ChannelHealth::Suspect,
                };
            }
        }
        let imus = std::array::from_fn(|i| {
            let health = now.health[SPRINGS + i];
            let pad = self.spec.imus[i].pad.index();
            let named = self.faults.is_named(pad, Channel::Imu(i));
            let unknown = self.filter.pad_sd(pad).1[2] > FOUND_RAD;
            match health {
                ChannelHealth::Ok if named || unknown => ChannelHealth::Suspect,
                other => other,
            }
        });
        Health {
            springs,
            imus,
            chambers: self.read_chambers(frame, board),
        }
    }

    fn read_chambers(
        &mut self,
        frame: &RawFrame,
        board: &[ChannelHealth; BOARDS],
    ) -> [ChannelHealth; CHAMBERS] {
        std::array::from_fn(|i| {
            let board = board[i / (CHAMBERS / BOARDS)];
            let pa = frame.chamber_pa[i];
            if !frame.has_chamber(i) || !pa.is_finite() || board == ChannelHealth::Missing {
                return ChannelHealth::Missing;
            }
            if !(GAUGE_RANGE_PA[0]..=GAUGE_RANGE_PA[1]).contains(&pa) {
                return ChannelHealth::OutOfRange;
            }
            self.chamber_pa[i] = pa;
            board
        })
    }

    fn frame(&self, frame: &RawFrame, health: Health, now: &Frame) -> SensorFrame {
        let quality = self.quality(&health, now);
        let mut extra_sigma = [0.0; SIGNALS];
        let spring_m = std::array::from_fn(|i| {
            let (expected_m, row, more) = self.filter.length(i);
            if health.springs[i] == ChannelHealth::Ok {
                let reading_m = self.good_m[i].unwrap_or(self.rest_m[i]);
                extra_sigma[i] = (LAG_S[1] * self.filter.length_rate_m_s(i)).abs();
                return self.now_m(i, reading_m);
            }
            let sd_m = (self.filter.variance(&row) + more).max(0.0).sqrt();
            let [low_m, high_m] = self.spec.spring.range_m;
            let possible = (low_m - BEYOND_M..high_m + BEYOND_M).contains(&expected_m);
            if !self.has_started || !possible || !sd_m.is_finite() || sd_m >= UNKNOWN_M {
                extra_sigma[i] = UNKNOWN_M;
                return self.good_m[i].unwrap_or(self.rest_m[i]);
            }
            extra_sigma[i] = sd_m;
            expected_m + self.filter.drawing_offset_m(i)
        });
        let pads = self.filter.poses();
        let imu_ypr_rad = std::array::from_fn(|i| {
            let pad = self.spec.imus[i].pad.index();
            let (_, [x, y, z]) = self.filter.pad_sd(pad);
            // Signals that are the same reconstruction are off alike.
            let alike = self
                .pair(pad)
                .filter(|j| health.imus[*j] != ChannelHealth::Ok);
            let by = f64::sqrt(alike.count().max(1) as f64);
            let sd_rad = [z, x.max(y), x.max(y)].map(|sd| match self.has_started {
                true => (by * sd).min(UNKNOWN_RAD),
                false => UNKNOWN_RAD,
            });
            let at = SPRINGS + 3 * i;
            extra_sigma[at] = sd_rad[0];
            if health.imus[i] == ChannelHealth::Ok {
                return ypr_from_rotation(&self.tracks[i].base_from_pad());
            }
            extra_sigma[at..at + 3].copy_from_slice(&sd_rad);
            ypr_from_rotation(&pads[pad].rotation)
        });
        SensorFrame {
            stamp: frame.stamp,
            delivered: self.delivered(&health, now),
            sensors: SensorVec {
                spring_m,
                imu_ypr_rad,
            },
            extra_sigma,
            chamber_pa: self.chamber_pa,
            health,
            quality,
        }
    }

    /// A reading of spring `i` without its lag and brought to the drawing, m.
    fn now_m(&self, i: usize, reading_m: f64) -> f64 {
        let lag_m = LAG_S[0] * self.filter.length_rate_m_s(i);
        reading_m + lag_m.clamp(-BEYOND_M, BEYOND_M) + self.filter.drawing_offset_m(i)
    }

    /// What channels that are not right delivered nevertheless.
    fn delivered(&self, health: &Health, now: &Frame) -> Delivered {
        // What a silent board delivered before is no reading of now.
        let ok = ChannelHealth::Ok;
        let is_fresh = |board: usize| now.boards[board] == ok;
        Delivered {
            spring_m: std::array::from_fn(|i| {
                let wanted = health.springs[i] != ok && is_fresh(board_of_spring(i));
                let length_m = now.length_m[i].filter(|_| wanted)?;
                Some(self.now_m(i, length_m))
            }),
            imu_ypr_rad: std::array::from_fn(|i| {
                let wanted = health.imus[i] != ok && is_fresh(board_of_imu(i));
                (wanted && now.samples[i] == Sample::Good)
                    .then(|| ypr_from_rotation(&self.tracks[i].base_from_pad()))
            }),
        }
    }

    /// How well the channels agree.
    fn quality(&self, health: &Health, now: &Frame) -> Quality {
        let segment_of_imu = self.spec.pad_of_imu();
        let verdict = |k: usize| self.faults.verdict(k);
        let fault_probability = std::array::from_fn(|c| match c.checked_sub(SPRINGS) {
            None => {
                let by_poses = self.consistency.finding(c / LEGS).probability[c % LEGS];
                verdict(c / LEGS).springs[c % LEGS].max(by_poses)
            }
            Some(i) => verdict(segment_of_imu[i]).imus[i],
        });
        Quality {
            nis: self.nis,
            fault_probability,
            spring_off_m: std::array::from_fn(|i| match &now.readings[i] {
                Some(Reading::Length { value_m, .. })
                    if fault_probability[i] > FAULT_NAMED || self.gated[i] > 0 =>
                {
                    let lag_m = LAG_S[0] * self.filter.length_rate_m_s(i);
                    Some(value_m + lag_m - self.filter.length(i).0)
                }
                _ => None,
            }),
            segment_suspect: [0, 1]
                .map(|k| verdict(k).is_suspect || self.consistency.finding(k).is_suspect),
            is_determined: health.determined(segment_of_imu),
            need: self.need(),
        }
    }
}

/// Each segment has a board of its own, and its lower pad's IMUs are on it.
fn board_of_imu(i: usize) -> usize {
    i / (IMUS / BOARDS)
}

/// Health of all channels of a board by its age.
fn board_health(frame: &RawFrame, board: usize) -> ChannelHealth {
    let age_s = frame.board_age_s[board];
    if age_s < BOARD_AGE_S[0] {
        ChannelHealth::Ok
    } else if age_s < BOARD_AGE_S[1] {
        ChannelHealth::Suspect
    } else {
        ChannelHealth::Missing
    }
}

#[cfg(test)]
mod tests;
