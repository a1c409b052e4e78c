use serde::Serialize;

use crate::signal::{CHAMBERS, SensorErrors, Stamp, Trace};

/// Whether data are simulated, as files have it as text: what `parse` does not read is unknown.
pub(super) fn simulated_text(simulated: Option<bool>) -> &'static str {
    match simulated {
        Some(true) => "true",
        Some(false) => "false",
        None => "unknown",
    }
}

/// Properties of a recorded session as a whole.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RecordingMeta {
    /// Identity of the recording: its segments, and the parts of it that viewers receive, have the same one. A writer
    /// makes one where it is empty.
    pub id: String,
    /// Name of the session.
    pub name: String,
    /// Name of the robot.
    pub robot: String,
    /// SHA-256 of the robot file, hexadecimal.
    pub robot_hash: String,
    /// Source of the data: `virtual rig`, a port name.
    pub source: String,
    /// Whether the data are simulated; `None` when unknown.
    pub simulated: Option<bool>,
    /// Mass the operator declared at the start, kg.
    pub payload_kg: f64,
    /// Local date and time at which it began, with the offset from UTC: `2026-11-23T14:05:12+01:00`. Empty when
    /// unknown; a recorder that writes a file fills it in.
    pub begun: String,
    /// Text of the calibration file that the sensors were read by (TOML); empty when unknown.
    pub calibration: String,
    /// Sensor errors of the robot's patches by which the readings were corrected; `None` for none.
    pub corrected_by: Option<SensorErrors>,
    /// Text of the registration of motion capture (TOML); empty without one.
    pub registration: String,
    /// SHA-256 of the networks' file, hexadecimal; empty when unknown.
    pub networks: String,
    /// What the boards report of their firmware; empty when unknown.
    pub firmware: String,
    /// Controller and its settings; empty when unknown.
    pub controller: String,
    /// The operator's note.
    pub note: String,
    /// Version of the program that recorded it; a writer fills it in.
    pub program: String,
    /// What this recording was made of, when it was computed from another one; empty for one that was measured.
    pub derived_from: String,
    /// Sizes to draw around the arm's centre lines; `None`: the centre lines alone, default pads. Not read back.
    pub drawing: Option<ArmDrawing>,
}

/// Sizes of the parts that a viewer shall see.
#[derive(Clone, Debug, PartialEq)]
pub struct ArmDrawing {
    /// Centre of each bellows in its segment's cross-section, in the order of the chambers, m.
    pub bellows_m: [[f64; 3]; CHAMBERS],
    /// Radius the bellows are drawn with, m.
    pub bellows_radius_m: f64,
    /// Radius of the pads, m.
    pub pad_radius_m: f64,
    /// Thickness of the pads, m.
    pub pad_thickness_m: f64,
}

/// One line of a recording's log.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct RecordedEvent {
    /// When.
    pub stamp: Stamp,
    /// Which log: `mode`, `events`, `alarms`, `marks`.
    pub log: String,
    /// What happened.
    pub text: String,
}

/// One channel of a recording or session log.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Channel {
    /// Name: a column, or the path of an entity.
    pub name: String,
    /// Unit; empty where there is none.
    pub unit: String,
    /// Number of rows that hold a value.
    pub rows: u64,
    /// Mean rate over the channel's own span, Hz; 0 below two rows.
    pub rate_hz: f64,
    /// Statistics of its values; `None` where there is none, and for entities of a recording that hold several numbers.
    #[serde(flatten)]
    pub values: Option<ChannelValues>,
}

/// Statistics of one channel's values, in the channel's unit.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ChannelValues {
    /// Smallest.
    pub min: f64,
    /// Mean.
    pub mean: f64,
    /// Largest.
    pub max: f64,
    /// Longest time from one value to the next, or from the last one to the end, s.
    pub longest_step_s: f64,
    /// When that begins, s.
    pub longest_step_at_s: f64,
}

impl Channel {
    /// A channel with `rows` values between two times.
    pub(crate) fn new(name: String, rows: u64, first: Stamp, last: Stamp) -> Self {
        let span_s = last.since(first);
        let rate_hz = if rows > 1 && span_s > 0.0 {
            (rows - 1) as f64 / span_s
        } else {
            0.0
        };
        Self {
            unit: unit_of(&name).to_owned(),
            name,
            rows,
            rate_hz,
            values: None,
        }
    }
}

/// A channel of one number per time, as its values come.
pub(crate) struct Gauged {
    rows: u64,
    first_s: f64,
    last_s: f64,
    /// The newest time, with a value or without, s.
    until_s: f64,
    sum: f64,
    seen: ChannelValues,
}

impl Default for Gauged {
    fn default() -> Self {
        Self {
            rows: 0,
            first_s: 0.0,
            last_s: 0.0,
            until_s: 0.0,
            sum: 0.0,
            seen: ChannelValues {
                min: f64::INFINITY,
                mean: f64::NAN,
                max: f64::NEG_INFINITY,
                longest_step_s: 0.0,
                longest_step_at_s: 0.0,
            },
        }
    }
}

impl Gauged {
    /// Takes a value; what is not finite is missing.
    pub(crate) fn push(&mut self, t_s: f64, value: f64) {
        self.until_s = t_s;
        if !value.is_finite() {
            return;
        }
        if self.rows == 0 {
            self.first_s = t_s;
            self.seen.longest_step_at_s = t_s;
        } else if t_s - self.last_s > self.seen.longest_step_s {
            self.seen.longest_step_s = t_s - self.last_s;
            self.seen.longest_step_at_s = self.last_s;
        }
        self.last_s = t_s;
        self.rows += 1;
        self.sum += value;
        self.seen.min = self.seen.min.min(value);
        self.seen.max = self.seen.max.max(value);
    }

    /// The channel of all values.
    pub(crate) fn channel(mut self, name: String) -> Channel {
        self.seen.mean = self.sum / self.rows as f64;
        if self.until_s - self.last_s > self.seen.longest_step_s {
            self.seen.longest_step_s = self.until_s - self.last_s;
            self.seen.longest_step_at_s = self.last_s;
        }
        let [first, last] = [self.first_s, self.last_s].map(Stamp::from_seconds);
        Channel {
            values: (self.rows > 0).then_some(self.seen),
            ..Channel::new(name, self.rows, first, last)
        }
    }
}

/// The unit that a name's ending stands for.
fn unit_of(name: &str) -> &'static str {
    const UNITS: [(&str, &str); 15] = [
        ("_rad_s", "rad/s"),
        ("_m_s2", "m/s²"),
        ("_kpa", "kPa"),
        ("_pa", "Pa"),
        ("_mm", "mm"),
        ("_deg", "deg"),
        ("_rad", "rad"),
        ("_kg", "kg"),
        ("_hz", "Hz"),
        ("_ticks", "ticks"),
        ("_counts", "counts"),
        ("_ms", "ms"),
        ("_s", "s"),
        ("_n", "N"),
        ("_m", "m"),
    ];
    UNITS
        .iter()
        .find(|(ending, _)| name.ends_with(ending))
        .map_or("", |(_, unit)| unit)
}

/// A recording in memory.
#[derive(Clone, Debug)]
pub struct ReadRecording {
    /// The snapshots. Raw frames, sensors, estimates, ground truth, goals and commands are those that were recorded, bit
    /// for bit, but for covariances, which are kept in single precision like references of the signals; shapes, previews
    /// and alarms are not kept.
    pub trace: Trace,
    /// The session as a whole.
    pub meta: RecordingMeta,
    /// Whether the recording was ended properly.
    pub complete: bool,
    /// For a recording that was cut: the last snapshot that could be recovered; else `None`.
    pub recovered_until: Option<Stamp>,
    /// The logs, in order of time.
    pub events: Vec<RecordedEvent>,
    /// What the file holds, in order of name.
    pub channels: Vec<Channel>,
}

/// A part of a recording.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Selection {
    /// From this time on; `None`: from the beginning.
    pub from: Option<Stamp>,
    /// Up to and with this time; `None`: to the end.
    pub to: Option<Stamp>,
    /// Only snapshots that are at least as far apart, s; 0 for all.
    pub at_least_apart_s: f64,
}

impl Selection {
    /// Between two times, s since the session's start; `None`: the beginning, or the end.
    pub fn between(from_s: Option<f64>, to_s: Option<f64>) -> Self {
        Self {
            from: from_s.map(Stamp::from_seconds),
            to: to_s.map(Stamp::from_seconds),
            at_least_apart_s: 0.0,
        }
    }

    /// Whether a time (ns) is part of it.
    pub fn contains(&self, t: i64) -> bool {
        self.from.is_none_or(|from| t >= from.0) && self.reaches(t)
    }

    /// Whether a time (ns) is not behind it.
    pub(crate) fn reaches(&self, t: i64) -> bool {
        self.to.is_none_or(|to| t <= to.0)
    }

    /// Whether rows that lie behind one time and up to another (ns) may be part of it.
    #[cfg_attr(not(feature = "rrd"), allow(dead_code))]
    pub(crate) fn overlaps(&self, after: i64, last: i64) -> bool {
        self.from.is_none_or(|from| last >= from.0) && self.to.is_none_or(|to| after < to.0)
    }

    /// The part of what was read whole.
    #[cfg_attr(not(feature = "rrd"), allow(dead_code))]
    pub(crate) fn of(&self, mut read: ReadRecording) -> ReadRecording {
        let mut thinning = Thinning::new(self.at_least_apart_s);
        let snapshots = &mut read.trace.snapshots;
        snapshots.retain(|s| self.contains(s.stamp.0) && thinning.takes(s.stamp));
        read.events.retain(|e| self.contains(e.stamp.0));
        read
    }
}

/// Takes rising times that are at least so far apart.
#[derive(Clone, Copy, Debug)]
pub struct Thinning {
    step: i64,
    next: i64,
}

impl Thinning {
    /// Takes times at least `apart_s` apart; all that rise for 0.
    pub fn new(apart_s: f64) -> Self {
        Self {
            step: ((apart_s * 1e9).round() as i64).max(1),
            next: i64::MIN,
        }
    }

    /// Whether it takes a time.
    pub fn takes(&mut self, stamp: Stamp) -> bool {
        let takes = stamp.0 >= self.next;
        if takes {
            self.next = stamp.0.saturating_add(self.step);
        }
        takes
    }
}

/// How a recording ended.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct RecordingSummary {
    /// Snapshots in the file.
    pub rows: u64,
    /// Snapshots that found the queue full.
    pub dropped: u64,
    /// Snapshots whose time did not advance; not recorded.
    pub repeated: u64,
    /// Parts of snapshots with a value that is not finite; not recorded.
    pub rejected: u64,
    /// Size of all its segments, bytes.
    pub bytes: u64,
    /// Number of segments.
    pub segments: u32,
    /// Why the recording stopped before it was asked to, as one sentence; `None` if it did not.
    pub failed: Option<String>,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn units_come_from_the_longest_ending() {
        for (name, unit) in [
            ("/sensors/raw/gyro_rad_s", "rad/s"),
            ("/sensors/raw/accel_m_s2", "m/s²"),
            ("p1_kpa", "kPa"),
            ("/sensors/raw/pressure_pa", "Pa"),
            ("t_s", "s"),
            ("/mode", ""),
        ] {
            assert_eq!(unit_of(name), unit, "{name}");
        }
    }

    /// A spring that is unplugged to the end of the session has no next value.
    #[test]
    fn a_channel_that_ends_early_lacks_the_rest() {
        let mut seen = Gauged::default();
        for n in 0..100 {
            let value = if (10..40).contains(&n) { 1.0 } else { f64::NAN };
            seen.push(f64::from(n), value);
        }
        let channel = seen.channel("spring9_mm".into());
        let values = channel.values.unwrap();
        assert_eq!(
            (values.longest_step_at_s, values.longest_step_s),
            (39.0, 60.0)
        );
        assert_eq!(channel.rows, 30);
    }

    #[test]
    fn rate_is_intervals_over_span() {
        let c = Channel::new("x_mm".into(), 101, Stamp::ZERO, Stamp::from_seconds(1.0));
        assert!((c.rate_hz - 100.0).abs() < 1e-9);
        assert_eq!(
            Channel::new("x".into(), 1, Stamp::ZERO, Stamp::ZERO).rate_hz,
            0.0
        );
    }
}
