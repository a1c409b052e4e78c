//! Names of the signals, and which of them belong together.

use serde::{Deserialize, Serialize};

use super::series::{Dash, Series, Strip};
use crate::analysis::history::{Channel, POSE_NAMES};
use crate::signal::{CHAMBERS, IMUS, SPRINGS, spring_name};

/// Signals that are listed together.
#[derive(Clone, Debug)]
pub struct Group {
    /// Its name.
    pub name: &'static str,
    /// Its signals.
    pub channels: Vec<Channel>,
}

/// All signals by group.
pub fn groups() -> Vec<Group> {
    let of_imus = |of: fn(usize, usize) -> Channel| {
        (0..IMUS).flat_map(move |i| (0..3).map(move |k| of(i, k)))
    };
    let chambers = (0..CHAMBERS).map(Channel::ChamberMeasured);
    let residuals = (0..SPRINGS).map(Channel::SpringResidual);
    let tried = (0..SPRINGS).map(Channel::SpringTried);
    let raw = (0..SPRINGS).map(Channel::SpringRaw);
    let mut tip: Vec<Channel> = (0..6).map(Channel::Tip).collect();
    tip.push(Channel::Payload);
    [
        ("Tip", tip),
        ("Motion capture", (0..6).map(Channel::Truth).collect()),
        ("Errors", (0..8).map(Channel::Error).collect()),
        ("Springs", (0..SPRINGS).map(Channel::Spring).collect()),
        ("IMUs", of_imus(Channel::Imu).collect()),
        (
            "Chambers",
            chambers
                .chain((0..CHAMBERS).map(Channel::ChamberSet))
                .collect(),
        ),
        (
            "Residuals",
            residuals
                .chain(of_imus(Channel::ImuResidual))
                .chain([Channel::Disagreement])
                .collect(),
        ),
        (
            "Residuals of a model under trial",
            tried.chain(of_imus(Channel::ImuTried)).collect(),
        ),
        ("Raw readings", raw.chain(of_imus(Channel::Gyro)).collect()),
    ]
    .into_iter()
    .map(|(name, channels)| Group { name, channels })
    .collect()
}

const AXES: [&str; 3] = ["x", "y", "z"];

/// Name of a signal.
pub fn name(channel: Channel) -> String {
    let angle = |k: usize| POSE_NAMES[3 + k];
    match channel {
        Channel::Spring(i) => format!("Spring {}", spring_name(i)),
        Channel::SpringRaw(i) => format!("Spring {} frequency", spring_name(i)),
        Channel::SpringResidual(i) => format!("Spring {} residual", spring_name(i)),
        Channel::Imu(i, k) => format!("IMU {} {}", i + 1, angle(k)),
        Channel::ImuResidual(i, k) => format!("IMU {} {} residual", i + 1, angle(k)),
        Channel::SpringTried(i) => format!("Spring {} trial residual", spring_name(i)),
        Channel::ImuTried(i, k) => format!("IMU {} {} trial residual", i + 1, angle(k)),
        Channel::Disagreement => "Disagreement".into(),
        Channel::Gyro(i, k) => format!("IMU {} rate {}", i + 1, AXES[k]),
        Channel::ChamberMeasured(i) => format!("Chamber {} measured", i + 1),
        Channel::ChamberSet(i) => format!("Chamber {} set", i + 1),
        Channel::Tip(i) => format!("Tip {}", POSE_NAMES[i]),
        Channel::Truth(i) => format!("Vicon {}", POSE_NAMES[i]),
        Channel::Error(6) => "Translation error".into(),
        Channel::Error(7) => "Rotation error".into(),
        Channel::Error(i) => format!("Error {}", POSE_NAMES[i]),
        Channel::Payload => "Payload".into(),
    }
}

/// Name of a signal as the head of a column, with its unit: `tip_x_mm`.
pub fn column(channel: Channel) -> String {
    let text = format!("{} {}", name(channel), channel.unit());
    let text = text.trim_end().to_lowercase();
    text.replace([' ', '/'], "_")
}

/// Whether a signal is never negative.
pub(super) fn is_positive(channel: Channel) -> bool {
    matches!(channel, Channel::Error(6 | 7) | Channel::Disagreement)
}

/// Signals chosen by name, in the order of [`groups`]. Kept as the names of [`column()`]; unknown ones are left out.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(from = "Vec<String>", into = "Vec<String>")]
pub struct Chosen(Vec<Channel>);

impl From<Vec<String>> for Chosen {
    fn from(names: Vec<String>) -> Self {
        let all = groups().into_iter().flat_map(|g| g.channels);
        Self(all.filter(|c| names.contains(&column(*c))).collect())
    }
}

impl From<Chosen> for Vec<String> {
    fn from(chosen: Chosen) -> Self {
        chosen.0.into_iter().map(column).collect()
    }
}

impl Chosen {
    /// How many there are.
    pub fn len(&self) -> usize {
        self.0.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Whether a signal is one of them.
    pub fn has(&self, channel: Channel) -> bool {
        self.0.contains(&channel)
    }

    /// Adds a signal, or takes it out.
    pub fn set(&mut self, channel: Channel, is_chosen: bool) {
        let all = groups().into_iter().flat_map(|g| g.channels);
        let before = std::mem::take(&mut self.0);
        self.0 = all
            .filter(|c| match *c == channel {
                true => is_chosen,
                false => before.contains(c),
            })
            .collect();
    }

    /// Takes all of them out.
    pub fn clear(&mut self) {
        self.0.clear();
    }

    /// One plot for each unit.
    pub fn strips(&self) -> Vec<Strip> {
        let mut strips: Vec<(&str, Strip)> = Vec::new();
        for channel in &self.0 {
            let unit = channel.unit();
            let place = match strips.iter().position(|(u, _)| *u == unit) {
                Some(place) => place,
                None => {
                    let strip = Strip {
                        title: match unit {
                            "" => "Chosen".into(),
                            unit => format!("Chosen / {unit}"),
                        },
                        series: Vec::new(),
                        min_span: least_span(unit),
                    };
                    strips.push((unit, strip));
                    strips.len() - 1
                }
            };
            let series = Series {
                channel: *channel,
                name: name(*channel),
                dash: dash(*channel),
            };
            strips[place].1.series.push(series);
        }
        strips.into_iter().map(|(_, strip)| strip).collect()
    }
}

/// About the noise floor of signals in a unit.
fn least_span(unit: &str) -> f64 {
    match unit {
        "mm" | "deg" | "" => 0.5,
        "kHz" => 0.2,
        _ => 1.0,
    }
}

/// Dashed are the signals that share the colour of another one.
fn dash(channel: Channel) -> Dash {
    match channel {
        Channel::Truth(_) | Channel::ChamberSet(_) => Dash::Dashed,
        Channel::Spring(i)
        | Channel::SpringRaw(i)
        | Channel::SpringResidual(i)
        | Channel::SpringTried(i)
            if !i.is_multiple_of(2) =>
        {
            Dash::Dashed
        }
        _ => Dash::Solid,
    }
}

#[cfg(test)]
mod tests {
    use std::collections::HashSet;

    use super::*;

    #[test]
    fn every_signal_is_listed_once_with_names_of_its_own() {
        let all: Vec<Channel> = groups().into_iter().flat_map(|g| g.channels).collect();
        assert_eq!(all.len(), 130);
        assert_eq!(all.iter().collect::<HashSet<_>>().len(), all.len());
        for names in [name, column] {
            let names: HashSet<String> = all.iter().map(|c| names(*c)).collect();
            assert_eq!(names.len(), all.len());
        }
        assert_eq!(column(Channel::Tip(0)), "tip_x_mm");
        assert_eq!(column(Channel::Gyro(2, 1)), "imu_3_rate_y_deg_s");
    }

    #[test]
    fn what_is_chosen_is_stacked_by_unit_and_can_be_kept() {
        let mut chosen = Chosen::default();
        for c in [
            Channel::Imu(0, 1),
            Channel::Spring(3),
            Channel::Tip(0),
            Channel::Tip(4),
        ] {
            chosen.set(c, true);
        }
        let strips = chosen.strips();
        let titles: Vec<_> = strips.iter().map(|s| s.title.as_str()).collect();
        assert_eq!(titles, ["Chosen / mm", "Chosen / deg"]);
        let names: Vec<_> = strips[0].series.iter().map(|s| s.name.as_str()).collect();
        assert_eq!(names, ["Tip x", "Spring 2B"]);
        let text = serde_json::to_string(&chosen).expect("serialises");
        let back: Chosen = serde_json::from_str(&text).expect("reads back");
        assert_eq!(back, chosen);
        let old: Chosen = serde_json::from_str(r#"["tip_x_mm","gone"]"#).expect("reads back");
        assert_eq!(old.len(), 1);
        chosen.set(Channel::Tip(0), false);
        assert!(!chosen.has(Channel::Tip(0)) && chosen.len() == 3);
    }
}
