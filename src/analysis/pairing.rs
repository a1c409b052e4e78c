//! Alignment of two recordings in time, by the first group of signals that moves enough in both.

use std::sync::Arc;

use super::compare::{NoMatch, Samples, Shift, align};
use super::history::{Channel, History};
use super::player::Player;
use crate::signal::{CHAMBERS, SPRINGS};

/// The result of an alignment.
#[derive(Clone, Debug, PartialEq)]
pub struct Alignment {
    /// What was correlated.
    pub by: &'static str,
    /// The shift, or why none stands out.
    pub found: Result<Shift, NoMatch>,
}

// The signals that are correlated, the most reliable first.
fn bases() -> [(&'static str, Vec<Channel>); 4] {
    [
        (
            "set pressures",
            (0..CHAMBERS).map(Channel::ChamberSet).collect(),
        ),
        (
            "measured pressures",
            (0..CHAMBERS).map(Channel::ChamberMeasured).collect(),
        ),
        ("the tip's path", (0..3).map(Channel::Tip).collect()),
        (
            "spring lengths",
            (0..SPRINGS).map(Channel::Spring).collect(),
        ),
    ]
}

/// The signals of two recordings A and B that are to be aligned.
#[derive(Clone)]
pub struct Pairing {
    /// Signals of A and B.
    histories: [Arc<History>; 2],
    /// Where each begins on its own time base, s.
    starts_s: [f64; 2],
}

impl Pairing {
    /// The signals of two recordings, A and B.
    pub fn of(players: [&Player; 2]) -> Self {
        Self {
            histories: players.map(|p| Arc::clone(p.shared_history())),
            starts_s: players.map(Player::start_s),
        }
    }

    /// Aligns B to A. Takes seconds on long recordings; `None` when `go_on` answers `false`.
    pub fn align(&self, go_on: &dyn Fn() -> bool) -> Option<Alignment> {
        let mut last = None;
        for (by, channels) in bases() {
            if !go_on() {
                return None;
            }
            let of = |i: usize| -> Vec<Samples> {
                let all = channels.iter();
                all.map(|c| samples(&self.histories[i], self.starts_s[i], *c))
                    .collect()
            };
            let found = align(&of(0), &of(1));
            let undecided = found == Err(NoMatch::TooLittle);
            last = Some(Alignment { by, found });
            if !undecided {
                break;
            }
        }
        last
    }
}

/// A channel's samples, with time counted from `start_s`.
pub fn samples(history: &History, start_s: f64, channel: Channel) -> Samples {
    history
        .points(channel, f64::NEG_INFINITY, f64::INFINITY)
        .map(|[t, v]| [t - start_s, v])
        .collect()
}
