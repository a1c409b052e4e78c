//! Alarms: what is abnormal now, since when, and where.
//!
//! The identity of an alarm is its [`AlarmKey`], the kind of abnormality and its subject. The sentence for the
//! operator is derived from the [`AlarmCause`], which also carries the measured values; two alarms with the same
//! words are never confused, and one whose figures change stays the same alarm.

use serde::{Deserialize, Serialize};

use super::{ChannelHealth, Evidence, Need, Stamp, suspect_text};

/// Message when fewer sensors are usable than the tip's pose needs.
pub const TOO_FEW_SENSORS: &str = "too few sensors left to locate the arm";
/// What to do about it: the end of a sentence.
pub const ENOUGH_SENSORS: &str = "repair springs or IMUs until each segment has five springs and its pads an IMU each, or six springs";

/// How urgent an alarm is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub enum Severity {
    /// Worth knowing.
    Info,
    /// Works, but degraded.
    Warning,
    /// Motion has stopped, or must not begin.
    Critical,
}

/// Kind and subject (0-based) of an abnormality: the identity of an alarm.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum AlarmKey {
    /// No frame has come yet.
    NoDataYet,
    /// The newest frame is old.
    DataOld,
    /// Frames arrive late.
    DataLate,
    /// The newest sample of this board is old.
    BoardOld(usize),
    /// Frames are lost.
    FramesLost,
    /// This spring is in this state.
    Spring(usize, ChannelHealth),
    /// This IMU is in this state.
    Imu(usize, ChannelHealth),
    /// A spring or IMU of this segment is wrong, and it is not certain which.
    SegmentSuspect(usize),
    /// The pads' poses are not known yet.
    PoseUnknown,
    /// Too few sensors are usable.
    TooFewSensors,
    /// The pressure of this chamber is beyond the over-pressure limit.
    OverPressure(usize),
    /// This chamber does not reach its set pressure.
    ShortOfAir(usize),
    /// The pumps of this board run although they should be off.
    PumpsRun(usize),
    /// The pressure of this chamber rises although the pumps are off.
    StillFed(usize),
    /// The emergency stop is pressed.
    EmergencyStop,
    /// Contact is not detected.
    ContactIgnored,
    /// The controller finds no admissible rates.
    Unsolved,
    /// The SAFE state.
    Safe,
}

/// What is abnormal, with the values that were measured.
#[derive(Clone, Debug, PartialEq)]
pub enum AlarmCause {
    /// No frame has come yet.
    NoDataYet,
    /// The newest frame is old.
    DataOld {
        /// Its age, s.
        age_s: f64,
        /// How long this program was not run meanwhile, s, if that is why.
        busy_s: Option<f64>,
    },
    /// Frames arrive late.
    DataLate {
        /// How old they are on arrival, s.
        late_s: f64,
    },
    /// The newest sample of a board is old.
    BoardOld {
        /// 0-based.
        board: usize,
        /// Age of the sample, s.
        age_s: f64,
    },
    /// Frames are lost.
    FramesLost {
        /// Lost, of all sent in the last second.
        ratio: f64,
        /// How long this program was not run in that second, s, if that is why.
        busy_s: Option<f64>,
    },
    /// A spring is not in order.
    Spring {
        /// 0-based.
        spring: usize,
        /// Its state and the reasons.
        evidence: Evidence,
    },
    /// An IMU is not in order.
    Imu {
        /// 0-based.
        imu: usize,
        /// Its state and the reasons.
        evidence: Evidence,
    },
    /// A spring or IMU of a segment is wrong, and it is not certain which.
    SegmentSuspect {
        /// 0-based.
        segment: usize,
        /// Channels in question by name with their probabilities, likeliest first.
        suspects: Vec<(String, f64)>,
    },
    /// The pads' poses are not known yet.
    PoseUnknown {
        /// What is most uncertain.
        need: Need,
    },
    /// Too few sensors are usable.
    TooFewSensors,
    /// A chamber is beyond the over-pressure limit.
    OverPressure {
        /// 0-based.
        chamber: usize,
        /// Measured gauge pressure, Pa.
        measured_pa: f64,
        /// The limit on its magnitude, Pa.
        limit_pa: f64,
    },
    /// A chamber does not reach its set pressure.
    ShortOfAir {
        /// 0-based.
        chamber: usize,
        /// Measured gauge pressure, Pa.
        measured_pa: f64,
        /// Set gauge pressure, Pa.
        set_pa: f64,
    },
    /// The pumps of a board run although they should be off.
    PumpsRun {
        /// 0-based.
        board: usize,
    },
    /// The pressure of a chamber moves away from 0 although the pumps are off.
    StillFed {
        /// 0-based.
        chamber: usize,
        /// Its gauge pressure, Pa.
        measured_pa: f64,
    },
    /// The emergency stop is pressed.
    EmergencyStop,
    /// Contact is not detected, as was asked for.
    ContactIgnored,
    /// The controller finds no admissible rates.
    Unsolved {
        /// Ticks so far without.
        ticks: u64,
    },
    /// The SAFE state.
    Safe {
        /// Why it was entered.
        reason: String,
        /// What to do before a reset: the beginning of a sentence.
        remedy: &'static str,
    },
}

impl AlarmCause {
    /// Kind and subject, without the measured values.
    pub fn key(&self) -> AlarmKey {
        match *self {
            Self::NoDataYet => AlarmKey::NoDataYet,
            Self::DataOld { .. } => AlarmKey::DataOld,
            Self::DataLate { .. } => AlarmKey::DataLate,
            Self::BoardOld { board, .. } => AlarmKey::BoardOld(board),
            Self::FramesLost { .. } => AlarmKey::FramesLost,
            Self::Spring { spring, evidence } => AlarmKey::Spring(spring, evidence.health),
            Self::Imu { imu, evidence } => AlarmKey::Imu(imu, evidence.health),
            Self::SegmentSuspect { segment, .. } => AlarmKey::SegmentSuspect(segment),
            Self::PoseUnknown { .. } => AlarmKey::PoseUnknown,
            Self::TooFewSensors => AlarmKey::TooFewSensors,
            Self::OverPressure { chamber, .. } => AlarmKey::OverPressure(chamber),
            Self::ShortOfAir { chamber, .. } => AlarmKey::ShortOfAir(chamber),
            Self::PumpsRun { board } => AlarmKey::PumpsRun(board),
            Self::StillFed { chamber, .. } => AlarmKey::StillFed(chamber),
            Self::EmergencyStop => AlarmKey::EmergencyStop,
            Self::ContactIgnored => AlarmKey::ContactIgnored,
            Self::Unsolved { .. } => AlarmKey::Unsolved,
            Self::Safe { .. } => AlarmKey::Safe,
        }
    }

    /// One sentence for the operator: what, where, what to do.
    pub fn text(&self) -> String {
        match self {
            Self::NoDataYet => "Waiting for the first data.".to_owned(),
            Self::DataOld {
                busy_s: Some(busy_s),
                ..
            } => format!(
                "This computer was busy for {:.0} ms, so the boards' data come too late: close other programs.",
                busy_s * 1e3
            ),
            Self::DataOld { age_s, .. } => format!(
                "No data from the boards for {:.0} ms: check the cable and the boards' power.",
                age_s * 1e3
            ),
            Self::DataLate { late_s } => {
                format!("Data come {:.0} ms late: check the cable.", late_s * 1e3)
            }
            Self::BoardOld { board, age_s } => format!(
                "Data of board {} are {:.0} ms old: check its cable and power.",
                board + 1,
                age_s * 1e3
            ),
            Self::FramesLost {
                ratio,
                busy_s: Some(busy_s),
            } => format!(
                "This computer was busy for {:.0} ms, so {:.0} % of the last second's frames were lost: close other \
                 programs.",
                busy_s * 1e3,
                ratio * 100.0
            ),
            Self::FramesLost { ratio, .. } => format!(
                "{:.0} % of the last second's frames were lost: check the cable.",
                ratio * 100.0
            ),
            Self::Spring { spring, evidence } => evidence.spring_text(*spring),
            Self::Imu { imu, evidence } => evidence.imu_text(*imu),
            Self::SegmentSuspect { segment, suspects } => suspect_text(*segment, suspects),
            Self::PoseUnknown { need } => need.text(),
            Self::TooFewSensors => format!("There are {TOO_FEW_SENSORS}: {ENOUGH_SENSORS}."),
            Self::OverPressure {
                chamber,
                measured_pa,
                limit_pa,
            } => format!(
                "Over-pressure in chamber {}: {:+.1} kPa, the limit is ±{:.0} kPa. Let its air out, then look at \
                 its supply and its gauge.",
                chamber + 1,
                measured_pa * 1e-3,
                limit_pa * 1e-3
            ),
            Self::ShortOfAir {
                chamber,
                measured_pa,
                set_pa,
            } => format!(
                "Chamber {} does not hold its pressure ({:+.1} instead of {:+.1} kPa): look for a leak in its line, \
                 and whether its supply runs.",
                chamber + 1,
                measured_pa * 1e-3,
                set_pa * 1e-3
            ),
            Self::PumpsRun { board } => format!(
                "The pumps of board {} run although they should be off: cut the supply by hand.",
                board + 1
            ),
            Self::StillFed {
                chamber,
                measured_pa,
            } => format!(
                "The supply is still on: chamber {} is at {:+.1} kPa and moves away from 0 although its pump is off. Cut \
                 the supply by hand.",
                chamber + 1,
                measured_pa * 1e-3
            ),
            Self::EmergencyStop => {
                "The emergency stop is pressed: nothing moves until it is released and reset."
                    .to_owned()
            }
            Self::ContactIgnored => {
                "Contact is not detected (--expect-pushes): keep everybody out of the arm's reach."
                    .to_owned()
            }
            Self::Unsolved { ticks } => format!(
                "The controller found no admissible rates in {ticks} ticks so far and held the pressures in them: \
                 press HOLD and choose another target."
            ),
            Self::Safe { reason, remedy } => {
                format!("SAFE: {reason}. {remedy}, then press Reset.")
            }
        }
    }
}

/// Something abnormal that holds now.
#[derive(Clone, Debug, PartialEq)]
pub struct Alarm {
    /// Since when this kind of abnormality has held for this subject.
    pub since: Stamp,
    /// How urgent.
    pub severity: Severity,
    /// What and where, with the values that were measured.
    pub cause: AlarmCause,
}

impl Alarm {
    /// Its identity.
    pub fn key(&self) -> AlarmKey {
        self.cause.key()
    }

    /// One sentence: what, where, what to do.
    pub fn text(&self) -> String {
        self.cause.text()
    }
}
