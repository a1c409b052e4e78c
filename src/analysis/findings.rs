//! What a recording lacks, and its log.

use super::history::{Channel, History};
use super::player::Player;
use super::recorded::LoggedEvent;
use crate::signal::{CHAMBERS, IMUS, Mode, SPRINGS, Trace, spring_name};

/// What was found in a recording itself; looked for once.
pub struct Findings {
    name: String,
    rows: usize,
    /// What it does not hold.
    pub missing: Vec<String>,
    /// Its log; of a recording without one the changes of mode.
    pub events: Vec<LoggedEvent>,
}

/// What a recording does not hold, one sentence each.
fn missing(history: &History) -> Vec<String> {
    let has = |c: Channel| {
        let all = (f64::NEG_INFINITY, f64::INFINITY);
        history.points(c, all.0, all.1).next().is_some()
    };
    let mut out = Vec::new();
    let mut group = |names: Vec<(String, bool)>, all: &str| {
        if names.iter().all(|(_, there)| !there) {
            out.push(format!("{all}: not in this recording"));
            return;
        }
        let gone = names.into_iter().filter(|(_, there)| !there);
        out.extend(gone.map(|(name, _)| format!("{name}: not in this recording")));
    };
    let springs = (0..SPRINGS).map(|i| {
        (
            format!("Spring {}", spring_name(i)),
            has(Channel::Spring(i)),
        )
    });
    group(springs.collect(), "Springs");
    let imus = (0..IMUS).map(|i| (format!("IMU {}", i + 1), has(Channel::Imu(i, 0))));
    group(imus.collect(), "IMUs");
    let gauges = (0..CHAMBERS).map(|i| {
        let name = format!("Pressure of chamber {}", i + 1);
        (name, has(Channel::ChamberMeasured(i)))
    });
    group(gauges.collect(), "Measured pressures");
    for (channel, name) in [
        (Channel::ChamberSet(0), "Set pressures"),
        (Channel::Tip(0), "Predicted pose"),
        (Channel::Truth(0), "Vicon"),
        (Channel::SpringRaw(0), "Raw counts"),
        (Channel::SpringResidual(0), "Shape of the model"),
    ] {
        group(vec![(name.to_owned(), has(channel))], name);
    }
    out
}

// Where a recording has no log of its own.
fn mode_changes(trace: &Trace, word: fn(&Mode) -> &'static str) -> Vec<LoggedEvent> {
    let mut last = None;
    let mut events = Vec::new();
    for s in &trace.snapshots {
        if last != Some(&s.mode) {
            events.push(LoggedEvent {
                stamp: s.stamp,
                log: "mode".into(),
                text: word(&s.mode).to_owned(),
            });
            last = Some(&s.mode);
        }
    }
    events
}

impl Findings {
    /// What is found in a recording. `word` names a mode, for a recording without a log.
    pub fn of(player: &Player, word: fn(&Mode) -> &'static str) -> Self {
        Self {
            name: player.trace().name.clone(),
            rows: player.history().len(),
            missing: missing(player.history()),
            events: if player.about.events.is_empty() {
                mode_changes(player.trace(), word)
            } else {
                player.about.events.clone()
            },
        }
    }

    /// Whether these are the findings of that recording.
    pub fn are_of(&self, player: &Player) -> bool {
        self.name == player.trace().name && self.rows == player.history().len()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::analysis::fixture;
    use crate::signal::ChannelHealth;

    #[test]
    fn what_never_came_is_missing_and_what_came_once_is_not() {
        let mut session = fixture::session(2);
        for (k, s) in session.iter_mut().enumerate() {
            s.truth = None;
            let frame = s.sensors.as_mut().expect("has sensors");
            frame.health.imus[2] = ChannelHealth::Missing;
            if k > 10 {
                frame.health.springs[4] = ChannelHealth::Missing;
            }
        }
        let found = missing(&History::of(session.iter()));
        assert!(
            found.contains(&"IMU 3: not in this recording".to_owned()),
            "{found:?}"
        );
        assert!(found.contains(&"Vicon: not in this recording".to_owned()));
        assert!(!found.iter().any(|t| t.starts_with("Spring 3A")));
    }
}
