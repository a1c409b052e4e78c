//! How well the channels of a frame agree, what the estimator still needs, and the sentences about both: the same in
//! the window, in alarms and without a window.

use super::{ChannelHealth, Health, IMUS, SPRINGS, UNKNOWN_M, UNKNOWN_RAD, spring_name};

/// Segments of the arm.
const SEGMENTS: usize = 2;
/// Springs of a segment.
const LEGS: usize = SPRINGS / SEGMENTS;

/// An orientation is found when its standard deviation is below this, rad.
pub const FOUND_RAD: f64 = 1.5 * std::f64::consts::PI / 180.0;
/// A position is found when its standard deviation is below this, m.
pub const FOUND_M: f64 = 6e-3;
/// A channel is left open above this probability that it is faulty, and named above the second one.
pub const FAULT_OPEN: f64 = 0.05;
/// See [`FAULT_OPEN`].
pub const FAULT_NAMED: f64 = 0.95;
/// Normalised innovations squared above this are not explained by healthy channels.
pub const NIS_HIGH: f64 = 4.0;
/// Above this they are, on average, beyond the gate of the estimator: such readings are not used.
pub const NIS_GATE: f64 = 25.0;

/// What the estimator still needs before the pads' poses are known.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Need {
    /// Orientation of a pad (0: middle, 1: end) about the vertical: standard deviation, rad.
    Heading(usize, f64),
    /// Orientation of a pad against the vertical: standard deviation, rad.
    Inclination(usize, f64),
    /// Position of a pad: standard deviation, m.
    Position(usize, f64),
}

impl Need {
    /// One sentence: what is known, what is needed, and what to do.
    pub fn text(&self) -> String {
        let pad = |p: &usize| if *p == 0 { "middle" } else { "end" };
        let found_deg = FOUND_RAD.to_degrees();
        match self {
            Self::Heading(p, sd_rad) => format!(
                "Heading of the {} pad known to {:.1} deg, needs {found_deg:.1} deg: tilt the arm to any side.",
                pad(p),
                sd_rad.to_degrees()
            ),
            Self::Inclination(p, sd_rad) => format!(
                "Inclination of the {} pad known to {:.1} deg, needs {found_deg:.1} deg: keep the arm still for a \
                 moment, and check the pad's IMUs if this stays.",
                pad(p),
                sd_rad.to_degrees()
            ),
            Self::Position(p, sd_m) => format!(
                "Position of the {} pad known to {:.1} mm, needs {:.1} mm: move the arm, and check the springs of \
                 segment {} if this stays.",
                pad(p),
                sd_m * 1e3,
                FOUND_M * 1e3,
                p + 1
            ),
        }
    }
}

/// How well the channels agree, as the estimator finds it. Recordings do not keep it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Quality {
    /// Normalised innovation squared of each spring (1 to 12), then of each IMU (1 to 4), averaged over two seconds: 1 for
    /// noise alone.
    pub nis: [f64; SPRINGS + IMUS],
    /// Probability that each spring, then each IMU, is faulty; order of `nis`.
    pub fault_probability: [f64; SPRINGS + IMUS],
    /// How much more each spring reads than the other sensors allow, m, where it is named as faulty or has jumped; `None` for
    /// the others.
    pub spring_off_m: [Option<f64>; SPRINGS],
    /// Whether something is wrong in a segment and it is not certain which channel; upper segment first.
    pub segment_suspect: [bool; SEGMENTS],
    /// Whether geometry gives the pose of each segment from the channels that are delivered: the lengths of its springs
    /// and the inclinations of its pads are at least six.
    pub is_determined: [bool; SEGMENTS],
    /// What is most uncertain, while the pads' poses are not known; `None` once they are.
    pub need: Option<Need>,
}

impl Default for Quality {
    fn default() -> Self {
        Self {
            nis: [1.0; SPRINGS + IMUS],
            fault_probability: [0.0; SPRINGS + IMUS],
            spring_off_m: [None; SPRINGS],
            segment_suspect: [false; SEGMENTS],
            is_determined: [true; SEGMENTS],
            need: None,
        }
    }
}

impl Quality {
    /// Channels of a suspect segment that are in question, with their probabilities, likeliest first; named ones are not. `segment_of_imu`
    /// has the segment above each IMU's pad. `None` when the segment is not suspect.
    pub fn suspects(
        &self,
        segment: usize,
        segment_of_imu: [usize; IMUS],
    ) -> Option<Vec<(String, f64)>> {
        if !self.segment_suspect[segment] {
            return None;
        }
        let springs = (LEGS * segment..LEGS * (segment + 1)).map(|i| (spring_name(i), i));
        let imus = (0..IMUS).filter(|i| segment_of_imu[*i] == segment);
        let imus = imus.map(|i| (format!("IMU {}", i + 1), SPRINGS + i));
        let channels = springs.chain(imus);
        let mut found: Vec<_> = channels
            .map(|(name, c)| (name, self.fault_probability[c]))
            .filter(|(_, p)| (FAULT_OPEN..=FAULT_NAMED).contains(p))
            .collect();
        found.sort_by(|a, b| b.1.total_cmp(&a.1));
        Some(found)
    }
}

/// A probability in whole percent; never 100 %.
pub fn percent(probability: f64) -> String {
    match probability {
        p if p > 0.99 => "> 99 %".to_owned(),
        p => format!("{:.0} %", p * 100.0),
    }
}

/// One sentence on a segment in which something is wrong: the channels in question, the evidence and the remedy.
pub fn suspect_text(segment: usize, suspects: &[(String, f64)]) -> String {
    let each = suspects
        .iter()
        .map(|(name, p)| format!("{name} {}", percent(*p)));
    let each: Vec<String> = each.collect();
    let each = match each.is_empty() {
        true => String::new(),
        false => format!(" ({})", each.join(", ")),
    };
    format!(
        "Segment {}: a spring or IMU is wrong, not yet certain which{each}. Move the arm to all sides; the band has been \
         widened.",
        segment + 1
    )
}

/// What is known about a channel that is not in order.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Evidence {
    /// Its state.
    pub health: ChannelHealth,
    /// Probability that it is faulty.
    pub probability: f64,
    /// How much more a spring reads than the other sensors allow, m, where that is why; `None` for an IMU or another reason.
    pub off_m: Option<f64>,
    /// Standard deviation beyond the usual noise of what stands for it, m or rad; for an IMU the largest of its angles.
    pub extra_sigma: f64,
    /// Standard deviation of the heading of an IMU's pad, rad, where only that keeps the IMU from being used; else `None`.
    pub heading_sd_rad: Option<f64>,
}

impl Evidence {
    /// Whether the channel itself is not in order: it is not while only the heading of its pad is unknown.
    pub fn is_abnormal(&self) -> bool {
        self.health != ChannelHealth::Ok && self.heading_sd_rad.is_none()
    }

    fn probability(&self) -> String {
        match self.probability > FAULT_OPEN {
            true => format!(" (probability of a fault {})", percent(self.probability)),
            false => String::new(),
        }
    }

    /// One sentence on spring `i` (0-based): what, where, what to do.
    pub fn spring_text(&self, i: usize) -> String {
        let name = format!("Spring {} ({})", i + 1, spring_name(i));
        let p = self.probability();
        let what = match (self.health, self.off_m) {
            (ChannelHealth::Ok, _) => return format!("{name} is delivered and plausible."),
            (ChannelHealth::Suspect, Some(off_m)) => format!(
                "{name} reads {:.1} mm too {}, by the other sensors{p}: check its hooks and plug",
                off_m.abs() * 1e3,
                if off_m < 0.0 { "short" } else { "long" }
            ),
            (ChannelHealth::Suspect, None) => format!(
                "{name} is inconsistent with the other sensors or late{p}: check its hooks, its plug and its board"
            ),
            (ChannelHealth::Stuck, _) => {
                format!(
                    "{name} is stuck: its reading does not follow the arm{p}. Check its hooks and plug"
                )
            }
            (ChannelHealth::OutOfRange, _) => {
                format!("{name} is outside of its calibrated range: check its hooks and plug")
            }
            (ChannelHealth::Missing, _) => {
                format!("{name} is not delivering: check its plug and cable")
            }
        };
        format!(
            "{what}{}.",
            self.stand_in("its length", 1e3, "mm", UNKNOWN_M)
        )
    }

    /// One sentence on IMU `i` (0-based): what, where, what to do.
    pub fn imu_text(&self, i: usize) -> String {
        let name = format!("IMU {}", i + 1);
        let p = self.probability();
        let what = match (self.health, self.heading_sd_rad) {
            (ChannelHealth::Ok, _) => return format!("{name} is delivered and plausible."),
            (ChannelHealth::Suspect, Some(sd_rad)) => {
                return format!(
                    "{name} works, but the heading of its pad is known to {:.1} deg only: tilt the arm to any side.",
                    sd_rad.to_degrees()
                );
            }
            (ChannelHealth::Suspect, None) => format!(
                "{name} is inconsistent with the other sensors or late{p}: check its mounting and its plug"
            ),
            (ChannelHealth::Stuck, _) => {
                format!(
                    "{name} is stuck: it repeats its reading while the arm moves. Check its plug and its board"
                )
            }
            (ChannelHealth::OutOfRange, _) => {
                format!("{name} is outside of its range: check its mounting")
            }
            (ChannelHealth::Missing, _) => {
                format!("{name} is not delivering: check its plug and cable")
            }
        };
        let tail = self.stand_in(
            "the orientation of its pad",
            1f64.to_degrees(),
            "deg",
            UNKNOWN_RAD,
        );
        format!("{what}{tail}.")
    }

    /// What stands for the reading, and its band; nothing where that is not known.
    fn stand_in(&self, what: &str, scale: f64, unit: &str, unknown: f64) -> String {
        match self.extra_sigma {
            sd if sd >= unknown => format!("; {what} is unknown"),
            sd if sd > 0.0 => format!("; {what} is reconstructed (±{:.1} {unit})", sd * scale),
            _ => String::new(),
        }
    }
}

impl Health {
    /// Which segments' poses geometry gives from the usable channels: a spring gives one equation, an IMU at each end
    /// of a segment (at its lower end, for the first one) gives two, and a pose has six unknowns.
    pub fn determined(&self, segment_of_imu: [usize; IMUS]) -> [bool; SEGMENTS] {
        let inclined =
            |k: usize| (0..IMUS).any(|i| segment_of_imu[i] == k && self.imus[i].usable());
        std::array::from_fn(|k| {
            let springs = &self.springs[LEGS * k..LEGS * (k + 1)];
            let lengths = springs.iter().filter(|h| h.usable()).count();
            let inclinations = if (0..=k).all(inclined) { 2 } else { 0 };
            lengths + inclinations >= LEGS
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SEGMENT_OF_IMU: [usize; IMUS] = [0, 0, 1, 1];

    #[test]
    fn needs_name_the_pad_the_figures_and_the_remedy() {
        let text = Need::Heading(1, 2.1_f64.to_radians()).text();
        assert_eq!(
            text,
            "Heading of the end pad known to 2.1 deg, needs 1.5 deg: tilt the arm to any side."
        );
        let text = Need::Position(0, 9.26e-3).text();
        assert!(
            text.starts_with("Position of the middle pad known to 9.3 mm, needs 6.0 mm:"),
            "{text}"
        );
        assert!(text.contains("springs of segment 1"), "{text}");
    }

    #[test]
    fn a_spring_is_described_by_its_evidence() {
        let mut e = Evidence {
            health: ChannelHealth::Suspect,
            probability: 0.99,
            off_m: Some(-5.2e-3),
            extra_sigma: 0.8e-3,
            heading_sd_rad: None,
        };
        assert_eq!(
            e.spring_text(2),
            "Spring 3 (2A) reads 5.2 mm too short, by the other sensors (probability of a fault 99 %): check its hooks and plug; \
             its length is reconstructed (±0.8 mm)."
        );
        // A jump that nothing has been concluded from yet; no stand-in.
        e.probability = 0.01;
        e.extra_sigma = UNKNOWN_M;
        let text = e.spring_text(2);
        assert!(
            text.contains("by the other sensors: check")
                && text.ends_with("its length is unknown."),
            "{text}"
        );
        // As read from a recording.
        e = Evidence {
            health: ChannelHealth::Missing,
            ..Evidence::default()
        };
        assert_eq!(
            e.spring_text(3),
            "Spring 4 (2B) is not delivering: check its plug and cable."
        );
    }

    #[test]
    fn the_suspects_of_a_segment_are_its_own_likeliest_first() {
        let mut quality = Quality::default();
        for (c, p) in [
            (0, 0.35),
            (1, 0.62),
            (2, 0.04),
            (4, 0.97),
            (7, 0.5),
            (SPRINGS + 1, 0.2),
            (SPRINGS + 2, 0.3),
        ] {
            quality.fault_probability[c] = p;
        }
        assert_eq!(quality.suspects(0, SEGMENT_OF_IMU), None);
        quality.segment_suspect[0] = true;
        let found = quality.suspects(0, SEGMENT_OF_IMU).expect("suspect");
        assert_eq!(
            suspect_text(0, &found),
            "Segment 1: a spring or IMU is wrong, not yet certain which (1B 62 %, 1A 35 %, IMU 2 20 %). Move the arm to \
             all sides; the band has been widened."
        );
        // An IMU counts for the pad that it sits on.
        let found = quality.suspects(0, [0, 1, 0, 1]).expect("suspect");
        assert_eq!(found[2].0, "IMU 3");
    }

    #[test]
    fn five_springs_and_two_inclinations_give_a_segment_and_five_springs_alone_do_not() {
        let mut health = Health::default();
        assert_eq!(health.determined(SEGMENT_OF_IMU), [true, true]);
        health.springs[8] = ChannelHealth::Missing;
        assert_eq!(health.determined(SEGMENT_OF_IMU), [true, true]);
        health.imus[0] = ChannelHealth::Missing;
        assert_eq!(health.determined(SEGMENT_OF_IMU), [true, true]);
        // Without the middle pad's inclination, segment 2 has none; six springs are enough for segment 1.
        health.imus[1] = ChannelHealth::Stuck;
        assert_eq!(health.determined(SEGMENT_OF_IMU), [true, false]);
        health.imus[1] = ChannelHealth::Suspect;
        for i in [0, 1, 2] {
            assert_eq!(health.determined(SEGMENT_OF_IMU), [true, true]);
            health.springs[i] = ChannelHealth::Stuck;
        }
        assert_eq!(health.determined(SEGMENT_OF_IMU), [false, true]);
    }

    #[test]
    fn an_imu_whose_heading_is_unknown_is_not_called_wrong() {
        let mut frame = super::super::SensorFrame {
            stamp: Default::default(),
            sensors: super::super::SensorVec {
                spring_m: [0.15; SPRINGS],
                imu_ypr_rad: [[0.0; 3]; IMUS],
            },
            extra_sigma: [0.0; super::super::SIGNALS],
            delivered: Default::default(),
            chamber_pa: [0.0; super::super::CHAMBERS],
            health: Health::default(),
            quality: Quality::default(),
        };
        frame.health.imus[3] = ChannelHealth::Suspect;
        frame.extra_sigma[SPRINGS + 9] = 0.05;
        let text = frame.imu_evidence(3).imu_text(3);
        assert!(
            text.contains("IMU 4 works") && text.contains("2.9 deg"),
            "{text}"
        );
        frame.quality.fault_probability[SPRINGS + 3] = 0.97;
        let text = frame.imu_evidence(3).imu_text(3);
        assert!(
            text.contains("inconsistent") && text.contains("probability of a fault 97 %"),
            "{text}"
        );
    }
}
