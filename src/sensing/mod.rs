//! From counts to lengths, from rates to orientations, and the health of each channel.
//!
//! [`Sensing::update`] takes one [`RawFrame`] and gives one [`SensorFrame`]: twelve lengths by the
//! calibration, four pad orientations by the IMU filters with their heading anchored to the springs,
//! six pressures, and the health of every channel. Implausible channels hold their last
//! good value, or are reconstructed from the others; nothing that is not finite leaves this module.
//!
//! It imports robot and signal alone: no simulator, no rig, no clock, no I/O. Motion capture is put
//! into the robot's frame here ([`registration`]) and takes no part in a [`SensorFrame`].

pub mod bench;
pub mod calibration;
mod file;
pub mod health;
pub mod imu;
pub mod mounting;
pub mod platform;
pub mod registration;
pub mod score;
mod shape;
pub mod spring;

use nalgebra::UnitQuaternion;

pub use calibration::Calibration;
pub use file::CalibrationError;
use health::{JUDGED_RATE_RAD_S, PairMonitor, SegmentFrame, SegmentMonitor};
use imu::{ImuTrack, Sample};
use platform::{Known, LEGS, Segment, solve};
pub use shape::shape_by_sensors;
use spring::SpringReading;

use crate::robot::{PadId, RobotSpec};
use crate::signal::{
    BOARDS, CHAMBERS, ChannelHealth, Health, IMUS, Pose, RawFrame, SIGNALS, SPRINGS, SensorFrame,
    SensorVec, Stamp, UNKNOWN_M, UNKNOWN_RAD, board_of_spring, ypr_from_rotation,
};

/// A length cannot change faster than this between two frames, m/s.
const LENGTH_RATE_MAX_M_S: f64 = 2.0;
/// A length that stays away from the last good one for this many frames is accepted.
const JUMP_FRAMES: u32 = 5;
/// Gauge pressures outside of this are not pressures, Pa (a gauge cannot read below vacuum).
const GAUGE_RANGE_PA: [f64; 2] = [-101_325.0, 200_000.0];
/// A board's data older than this is suspect, and older than that is gone, s.
const BOARD_AGE_S: [f64; 2] = [0.03, 0.1];
/// A length by a clock whose rate is known less well than this is not one yet, s/s: 0.5 mm of 154 mm. The link takes half a
/// second, or two on a busy line, to measure the clock of a board of which it knows nothing.
const MAX_RATE_SD: f64 = 2.5e-4;
/// Standard deviation of an orientation that is read but inconsistent with the others, rad.
const DISPUTED_RAD: f64 = 0.05;
/// Drift rate of a heading that no spring holds: the gyro's bias, as far as it is not known,
/// rad/s.
const ASTRAY_RAD_S: f64 = 0.03 * std::f64::consts::PI / 180.0;
/// Standard deviation of a pad's orientation by the springs, or by one IMU for another, rad.
const RECONSTRUCTED_RAD: f64 = 0.005;
/// A longer gap between frames restarts the monitors, s.
const GAP_S: f64 = 1.0;

/// Last good length of one channel and its inconsistencies with others.
#[derive(Clone, Copy, Debug, Default)]
struct Length {
    good_m: Option<f64>,
    /// A length that jumped, and for how many frames it has stayed there.
    jumped: Option<(f64, u32)>,
}

impl Length {
    /// Takes in a fresh length unless it jumped; returns it when taken.
    fn take(&mut self, length_m: f64, dt_s: f64) -> Option<f64> {
        let reach_m = LENGTH_RATE_MAX_M_S * dt_s.clamp(0.005, 0.1);
        let near = |a: f64| (a - length_m).abs() <= reach_m;
        if self.good_m.is_none_or(near) {
            self.jumped = None;
        } else {
            let frames = match self.jumped {
                Some((at_m, frames)) if near(at_m) => frames + 1,
                _ => 1,
            };
            self.jumped = Some((length_m, frames));
            if frames < JUMP_FRAMES {
                return None;
            }
            self.jumped = None;
        }
        self.good_m = Some(length_m);
        Some(length_m)
    }
}

/// Pose of the pads by the springs (with the IMUs where a spring is out).
#[derive(Clone, Debug, PartialEq)]
pub struct SpringPads {
    /// Middle and end pad (upper faces), base from pad.
    pub base_from_pad: [Pose; 2],
    /// Whether six healthy springs per segment above it confirm it.
    pub by_springs_alone: [bool; 2],
}

/// State of the sensing.
pub struct Sensing {
    spec: RobotSpec,
    calibration: Calibration,
    segments: [Segment; 2],
    lengths: [Length; SPRINGS],
    tracks: [ImuTrack; IMUS],
    /// Per segment: pose by all delivered springs, and by the plausible ones.
    delivered_pose: [Pose; 2],
    believed_pose: [Pose; 2],
    monitors: [SegmentMonitor; 2],
    pairs: [PairMonitor; 2],
    chamber_pa: [f64; CHAMBERS],
    pads: SpringPads,
    /// Per pad: how long the springs have not held its IMUs' headings, s.
    astray_s: [f64; 2],
    /// Per spring: length and its standard deviation as the rest of its segment has it, where the
    /// spring itself is implausible, m.
    told_m: [Option<(f64, f64)>; SPRINGS],
    last: Option<SensorFrame>,
}

/// Spring readings of one frame, before they are checked.
struct Springs {
    fresh_m: [Option<f64>; SPRINGS],
    health: [ChannelHealth; SPRINGS],
    resolution_m: [f64; SPRINGS],
}

impl Sensing {
    /// A fresh start. Springs that the calibration does not cover read as missing
    /// (see [`Calibration::uncovered`]).
    pub fn new(spec: &RobotSpec, calibration: Calibration) -> Self {
        let segments = [Segment::of(spec, 0), Segment::of(spec, 1)];
        let rest = [segments[0].rest(), segments[1].rest()];
        Self {
            tracks: std::array::from_fn(|i| {
                let nominal = UnitQuaternion::from_rotation_matrix(&spec.imus[i].pad_from_imu);
                ImuTrack::new(calibration.mounting(i) * nominal)
            }),
            lengths: Default::default(),
            delivered_pose: rest,
            believed_pose: rest,
            monitors: Default::default(),
            pairs: Default::default(),
            chamber_pa: [0.0; CHAMBERS],
            pads: SpringPads {
                base_from_pad: platform::pads(spec, &rest),
                by_springs_alone: [false; 2],
            },
            astray_s: [0.0; 2],
            told_m: [None; SPRINGS],
            last: None,
            segments,
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

    /// Pose of the pads by the springs, as of the last frame.
    pub fn pads(&self) -> &SpringPads {
        &self.pads
    }

    /// Heading state of IMU `i` (0-based), for display.
    pub fn heading(&self, i: usize) -> imu::Heading {
        self.tracks[i].heading()
    }

    /// Takes in one frame. A frame that is not newer than the last one changes nothing and gives
    /// the last result again.
    pub fn update(&mut self, frame: &RawFrame) -> SensorFrame {
        let dt_s = match &self.last {
            Some(last) if frame.stamp <= last.stamp => return last.clone(),
            Some(last) => frame.stamp.since(last.stamp),
            None => 1.0 / imu::RATE_HZ,
        };
        if dt_s > GAP_S {
            self.monitors = Default::default();
            self.pairs = Default::default();
        }
        let board = std::array::from_fn(|b| board_health(frame, b));
        let mut springs = self.read_springs(frame, dt_s, &board);
        let samples = self.read_imus(frame, dt_s, &board);
        self.judge_springs(frame, dt_s, &samples, &mut springs);
        self.place_pads(&samples, &springs);
        let imus = self.judge_imus(frame, dt_s, &samples, &board);
        let chambers = self.read_chambers(frame, &board);
        let out = self.frame(
            frame.stamp,
            &samples,
            Health {
                springs: springs.health,
                imus,
                chambers,
            },
        );
        self.last = Some(out.clone());
        out
    }

    fn read_springs(
        &mut self,
        frame: &RawFrame,
        dt_s: f64,
        board: &[ChannelHealth; BOARDS],
    ) -> Springs {
        let mut springs = Springs {
            fresh_m: [None; SPRINGS],
            health: [ChannelHealth::Missing; SPRINGS],
            resolution_m: [0.0; SPRINGS],
        };
        for i in 0..SPRINGS {
            let board = board[i / LEGS];
            if !frame.has_spring(i) || board == ChannelHealth::Missing {
                continue;
            }
            if frame.tick_rate_sd[board_of_spring(i)] > MAX_RATE_SD {
                continue;
            }
            let calibration = self.calibration.spring(i);
            let (n, ticks) = (frame.spring_counts[i], frame.spring_gate_ticks[i]);
            let rate_hz = frame.spring_tick_rate_hz(i);
            springs.health[i] = match spring::read(calibration, n, ticks, rate_hz) {
                SpringReading::Nothing => ChannelHealth::Missing,
                SpringReading::OutOfRange => ChannelHealth::OutOfRange,
                SpringReading::Length(length_m) => {
                    springs.resolution_m[i] = spring::resolution_m(calibration, n, ticks, rate_hz);
                    springs.fresh_m[i] = self.lengths[i].take(length_m, dt_s);
                    match springs.fresh_m[i] {
                        Some(_) => board,
                        None => ChannelHealth::OutOfRange,
                    }
                }
            };
        }
        springs
    }

    fn read_imus(
        &mut self,
        frame: &RawFrame,
        dt_s: f64,
        board: &[ChannelHealth; BOARDS],
    ) -> [Sample; IMUS] {
        std::array::from_fn(|i| {
            let there = frame.has_imu(i) && board[board_of_imu(i)] != ChannelHealth::Missing;
            let sample = self.tracks[i].update(dt_s, there.then_some(&frame.imu[i]));
            // What was not sent is known to be missing; only a bad value gets a frame of grace.
            if there { sample } else { Sample::Lost }
        })
    }

    /// Orientation of a pad by its good IMUs.
    fn pad_by_imus(&self, pad: PadId, samples: &[Sample; IMUS]) -> Option<UnitQuaternion<f64>> {
        let last = self.last.as_ref().map(|l| l.health.imus);
        (0..IMUS)
            .filter(|i| self.spec.imus[*i].pad == pad && samples[*i] == Sample::Good)
            .filter(|i| self.tracks[*i].aligned())
            .filter(|i| {
                !last
                    .is_some_and(|h| matches!(h[*i], ChannelHealth::Stuck | ChannelHealth::Suspect))
            })
            .map(|i| self.tracks[i].base_from_pad())
            .reduce(|a, b| a.slerp(&b, 0.5))
    }

    /// Rotation upper from lower across segment `k` by the IMUs.
    fn segment_by_imus(&self, k: usize, samples: &[Sample; IMUS]) -> Option<UnitQuaternion<f64>> {
        let middle = self.pad_by_imus(PadId::Middle, samples)?;
        match k {
            0 => Some(middle),
            _ => Some(middle.inverse() * self.pad_by_imus(PadId::End, samples)?),
        }
    }

    fn judge_springs(
        &mut self,
        frame: &RawFrame,
        dt_s: f64,
        samples: &[Sample; IMUS],
        springs: &mut Springs,
    ) {
        let slow = self
            .tracks
            .iter()
            .all(|t| t.rate_rad_s() < JUDGED_RATE_RAD_S);
        for k in 0..2 {
            let at = LEGS * k;
            let length_m: [Option<f64>; LEGS] = std::array::from_fn(|i| springs.fresh_m[at + i]);
            let mut discrepancy = None;
            if length_m.iter().all(Option::is_some) {
                let known = Known {
                    length_m,
                    upper_from_lower: None,
                };
                let found = solve(&self.segments[k], &known, &self.delivered_pose[k]);
                self.delivered_pose[k] = plausible(&self.segments[k], &found);
                let by_imus = self.segment_by_imus(k, samples).filter(|_| slow);
                if let Some(by_imus) = by_imus
                    && found.converged
                    && let Some(g) = self.segments[k].rotation_per_length(&self.delivered_pose[k])
                {
                    // d = log(R_springs R_imuᵀ)
                    let d = (self.delivered_pose[k].rotation * by_imus.inverse()).scaled_axis();
                    discrepancy = Some((d, g));
                }
            }
            let verdict = self.monitors[k].update(&SegmentFrame {
                dt_s,
                raw: std::array::from_fn(|i| {
                    (frame.spring_counts[at + i], frame.spring_gate_ticks[at + i])
                }),
                length_m,
                resolution_m: std::array::from_fn(|i| springs.resolution_m[at + i]),
                discrepancy,
            });
            for (health, verdict) in springs.health[at..at + LEGS].iter_mut().zip(verdict) {
                if health.usable() && verdict != ChannelHealth::Ok {
                    *health = verdict;
                }
            }
        }
    }

    fn place_pads(&mut self, samples: &[Sample; IMUS], springs: &Springs) {
        let mut trusted = [false; 2];
        self.told_m = [None; SPRINGS];
        for (k, trusted) in trusted.iter_mut().enumerate() {
            let at = LEGS * k;
            let health = &springs.health[at..at + LEGS];
            *trusted = health.iter().all(|h| *h == ChannelHealth::Ok);
            self.believed_pose[k] = if *trusted {
                self.delivered_pose[k]
            } else {
                let known = Known {
                    length_m: std::array::from_fn(|i| {
                        springs.fresh_m[at + i].filter(|_| health[i] == ChannelHealth::Ok)
                    }),
                    upper_from_lower: self.segment_by_imus(k, samples),
                };
                let segment = &self.segments[k];
                let found = solve(segment, &known, &self.believed_pose[k]);
                let pose = plausible(segment, &found);
                // Without a pose there is no length.
                if pose == found.upper_from_lower {
                    let lengths_m = segment.lengths_m(&pose);
                    for i in (0..LEGS).filter(|i| known.length_m[*i].is_none()) {
                        self.told_m[at + i] = segment
                            .length_sd_m(&known, &pose, i)
                            .map(|sd_m| (lengths_m[i], sd_m));
                    }
                }
                pose
            };
        }
        self.pads = SpringPads {
            base_from_pad: platform::pads(&self.spec, &self.believed_pose),
            by_springs_alone: [trusted[0], trusted[0] && trusted[1]],
        };
    }

    fn judge_imus(
        &mut self,
        frame: &RawFrame,
        dt_s: f64,
        samples: &[Sample; IMUS],
        board: &[ChannelHealth; BOARDS],
    ) -> [ChannelHealth; IMUS] {
        let mut health = [ChannelHealth::Ok; IMUS];
        for (p, pad) in [PadId::Middle, PadId::End].into_iter().enumerate() {
            let by_springs =
                self.pads.by_springs_alone[p].then_some(self.pads.base_from_pad[p].rotation);
            let on_pad: Vec<usize> = (0..IMUS)
                .filter(|i| self.spec.imus[*i].pad == pad)
                .collect();
            match by_springs {
                Some(_) => self.astray_s[p] = 0.0,
                None => self.astray_s[p] += dt_s,
            }
            if let Some(by_springs) = &by_springs {
                for &i in &on_pad {
                    let track = &mut self.tracks[i];
                    if samples[i] == Sample::Good && track.rate_rad_s() < JUDGED_RATE_RAD_S {
                        track.correct_heading(dt_s, by_springs);
                    }
                }
            }
            if let [a, b] = on_pad[..] {
                let raw = [a, b].map(|i| (samples[i] == Sample::Good).then_some(&frame.imu[i]));
                let turned = [a, b].map(|i| self.tracks[i].base_from_pad());
                let verdict = self.pairs[p].update(dt_s, raw, turned, by_springs.as_ref());
                (health[a], health[b]) = (verdict[0], verdict[1]);
            }
        }
        for i in 0..IMUS {
            match samples[i] {
                Sample::Lost => health[i] = ChannelHealth::Missing,
                Sample::Held => health[i] = ChannelHealth::Suspect,
                Sample::Good => {
                    let doubtful =
                        !self.tracks[i].aligned() || board[board_of_imu(i)] != ChannelHealth::Ok;
                    if doubtful && health[i] == ChannelHealth::Ok {
                        health[i] = ChannelHealth::Suspect;
                    }
                }
            }
        }
        health
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

    fn frame(&self, stamp: Stamp, samples: &[Sample; IMUS], health: Health) -> SensorFrame {
        let rest_m = self.segments.each_ref().map(|s| s.lengths_m(&s.rest()));
        let mut extra_sigma = [0.0; SIGNALS];
        let spring_m = std::array::from_fn(|i| {
            if let Some((length_m, sd_m)) = self.told_m[i] {
                extra_sigma[i] = sd_m;
                return length_m;
            }
            if !health.springs[i].usable() {
                extra_sigma[i] = UNKNOWN_M;
            }
            // Before the first reading: the length at rest.
            self.lengths[i].good_m.unwrap_or(rest_m[i / LEGS][i % LEGS])
        });
        let imu_ypr_rad = std::array::from_fn(|i| {
            let mut turned = self.tracks[i].base_from_pad();
            if health.imus[i] != ChannelHealth::Ok {
                let (told, sd_rad) = match self.pad_without_imu(i, samples) {
                    Some(told) => (told, RECONSTRUCTED_RAD),
                    None if health.imus[i].usable() && self.tracks[i].aligned() => {
                        (turned, DISPUTED_RAD)
                    }
                    None => (turned, UNKNOWN_RAD),
                };
                turned = told;
                extra_sigma[SPRINGS + 3 * i..SPRINGS + 3 * i + 3].fill(sd_rad);
            }
            // Above all about the vertical.
            let heading = &mut extra_sigma[SPRINGS + 3 * i];
            *heading =
                heading.hypot(ASTRAY_RAD_S * self.astray_s[pad_index(self.spec.imus[i].pad)]);
            ypr_from_rotation(&turned)
        });
        SensorFrame {
            stamp,
            sensors: SensorVec {
                spring_m,
                imu_ypr_rad,
            },
            extra_sigma,
            chamber_pa: self.chamber_pa,
            health,
        }
    }

    /// Orientation of the pad under IMU `i` by the springs, or by the pad's other IMU.
    fn pad_without_imu(&self, i: usize, samples: &[Sample; IMUS]) -> Option<UnitQuaternion<f64>> {
        let pad = self.spec.imus[i].pad;
        let p = pad_index(pad);
        if self.pads.by_springs_alone[p] {
            return Some(self.pads.base_from_pad[p].rotation);
        }
        let mut others = *samples;
        others[i] = Sample::Lost;
        self.pad_by_imus(pad, &others)
    }
}

fn pad_index(pad: PadId) -> usize {
    match pad {
        PadId::Middle => 0,
        PadId::End => 1,
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

/// A solution to start the next frame from: the found one if it hangs below, else the rest pose.
fn plausible(segment: &Segment, found: &platform::Solution) -> Pose {
    let z_m = found.upper_from_lower.translation.vector.z;
    if found.converged && z_m < 0.0 && z_m > -4.0 * segment.rest_m {
        found.upper_from_lower
    } else {
        segment.rest()
    }
}

#[cfg(test)]
mod tests;
