//! What is checked before anything is asked of a rig.

use anyhow::Result;

use crate::link::fault_names;
use crate::link::wire::fault;
use crate::signal::{LinkStatus, Mode, RawFrame, Snapshot};
use crate::twin::Command;

/// Time the boards have to introduce themselves, s.
pub const HELLO_S: f64 = 5.0;
/// What a board reported is of now when it is no older than this, s.
const HEARD_S: f64 = 0.1;

/// The causes for which boards that are SAFE from before may leave it (bits of [`fault`]).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Resets(u16);

impl Resets {
    /// Those after which nothing has to be looked at: an earlier program ended, or was not heard any more; and `named`.
    pub fn usual_and(named: &[u16]) -> Self {
        let usual = fault::SAFE | fault::ENDED | fault::HEARTBEAT_LOST;
        Self(named.iter().fold(usual, |all, cause| all | cause))
    }

    /// The causes among `faults` that are not to be reset.
    fn left_of(self, faults: u16) -> u16 {
        faults & fault::LATCHING & !self.0
    }
}

/// The check whether a rig is ready to be steered.
pub struct Start {
    reset: Resets,
    tried: bool,
}

impl Start {
    /// Boards that are SAFE from before may leave it for the causes of `reset`.
    pub fn new(reset: Resets) -> Self {
        Self {
            reset,
            tried: false,
        }
    }

    /// Whether something can be asked of the rig now; may add a reset to the commands.
    ///
    /// # Errors
    /// Why the rig cannot become ready.
    pub fn ready(
        &mut self,
        snapshot: &Snapshot,
        commands: &mut Vec<Command>,
    ) -> std::result::Result<bool, String> {
        if let Mode::Safe(reason) = &snapshot.mode {
            // Both boards must have said why, or the causes of one would be reset unseen.
            let heard = |r: &RawFrame| r.board_age_s.iter().all(|age_s| *age_s < HEARD_S);
            let frame = snapshot
                .raw
                .as_ref()
                .filter(|r| snapshot.link.connected && heard(r));
            let Some(faults) = frame.map(|r| r.faults).filter(|f| f & fault::SAFE != 0) else {
                return Ok(false);
            };
            let left = self.reset.left_of(faults);
            if self.reset == Resets::default() || left != 0 {
                let names = match left & !fault::SAFE & !Resets::usual_and(&[]).0 {
                    0 => String::new(),
                    named => format!(" {}", fault_names(named)),
                };
                return Err(format!(
                    "SAFE from before ({reason}): remove the cause, then start again with --reset{names}"
                ));
            }
            if self.tried {
                return Err(format!(
                    "still SAFE after a reset ({reason}): remove the cause"
                ));
            }
            self.tried = true;
            commands.push(Command::Reset);
            return Ok(false);
        }
        Ok(snapshot.has_settled())
    }
}

/// Refuses a link on which no data came.
///
/// # Errors
/// Why nothing came, and what to look at.
pub fn check_link(link: &LinkStatus, rig: &str) -> Result<()> {
    if let Some(refusal) = &link.refusal {
        anyhow::bail!("{refusal}");
    }
    if link.frames == 0
        && !link.connected
        && let Some(why) = &link.trouble
    {
        anyhow::bail!("{why}");
    }
    anyhow::ensure!(
        link.connected || link.frames > 0,
        "no data from the boards on {rig} within {HELLO_S} s: check the cable, the boards' power and the firmware"
    );
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::signal::SETTLING_FRAMES;

    fn snapshot(mode: Mode, frames: u64) -> Snapshot {
        let is_safe = matches!(mode, Mode::Safe(_));
        let latched = RawFrame {
            faults: fault::SAFE | fault::ENDED,
            ..RawFrame::default()
        };
        Snapshot {
            mode,
            raw: Some(if is_safe {
                latched
            } else {
                RawFrame::default()
            }),
            link: LinkStatus {
                connected: true,
                frames,
                ..LinkStatus::default()
            },
            ..Snapshot::default()
        }
    }

    #[test]
    fn boards_that_are_safe_from_before_are_reset_once_and_only_on_request() {
        let safe = snapshot(Mode::Safe("a leak".to_owned()), 1000);
        let mut commands = Vec::new();
        let refusal = Start::new(Resets::default()).ready(&safe, &mut commands);
        assert!(refusal.is_err_and(|why| why.contains("a leak") && why.contains("--reset")));
        assert!(commands.is_empty());
        let mut start = Start::new(Resets::usual_and(&[]));
        assert_eq!(start.ready(&safe, &mut commands), Ok(false));
        assert_eq!(commands, [Command::Reset]);
        let settled = snapshot(Mode::Disarmed, SETTLING_FRAMES + 1);
        assert_eq!(start.ready(&settled, &mut commands), Ok(true));
        assert!(start.ready(&safe, &mut commands).is_err());
        assert_eq!(commands.len(), 1);
    }

    #[test]
    fn no_board_is_reset_before_both_have_reported_why_they_are_safe() {
        let mut start = Start::new(Resets::usual_and(&[]));
        let mut commands = Vec::new();
        let whole = snapshot(Mode::Safe("ended".to_owned()), 1000);
        let with = |change: fn(&mut Snapshot)| {
            let mut one = whole.clone();
            change(&mut one);
            one
        };
        for waits in [
            with(|s| s.raw = None),
            with(|s| s.link.connected = false),
            with(|s| s.raw = Some(RawFrame::default())),
            with(|s| {
                if let Some(raw) = &mut s.raw {
                    raw.board_age_s[1] = 0.5;
                }
            }),
        ] {
            assert_eq!(start.ready(&waits, &mut commands), Ok(false));
            assert!(commands.is_empty());
        }
        assert_eq!(start.ready(&whole, &mut commands), Ok(false));
        assert_eq!(commands, [Command::Reset]);
    }

    #[test]
    fn causes_that_somebody_has_to_look_at_are_reset_by_name_only() {
        let mut safe = snapshot(Mode::Safe("over-pressure".to_owned()), 1000);
        let faults = fault::SAFE | fault::ENDED | fault::OVER_PRESSURE | fault::SPRING_LOST;
        safe.raw = Some(RawFrame {
            faults,
            ..RawFrame::default()
        });
        let ask = |resets: Resets| Start::new(resets).ready(&safe, &mut Vec::new());
        let why = ask(Resets::usual_and(&[])).expect_err("is refused");
        assert!(why.ends_with("--reset over-pressure"), "{why}");
        assert_eq!(ask(Resets::usual_and(&[fault::OVER_PRESSURE])), Ok(false));
        assert!(ask(Resets::usual_and(&[fault::BOOTED])).is_err());
    }

    #[test]
    fn nothing_is_asked_before_the_filters_have_settled() {
        let mut start = Start::new(Resets::default());
        let early = snapshot(Mode::Disarmed, SETTLING_FRAMES);
        assert_eq!(start.ready(&early, &mut Vec::new()), Ok(false));
        let mut unknown = snapshot(Mode::Disarmed, SETTLING_FRAMES + 1);
        assert_eq!(start.ready(&unknown, &mut Vec::new()), Ok(true));
        if let Some(raw) = &mut unknown.raw {
            raw.tick_rate_sd[1] = 1e-3;
        }
        assert_eq!(start.ready(&unknown, &mut Vec::new()), Ok(false));
        // Known, but not so well that a jump would leave it known.
        if let Some(raw) = &mut unknown.raw {
            raw.tick_rate_sd[1] = 2e-4;
        }
        assert_eq!(start.ready(&unknown, &mut Vec::new()), Ok(false));
        let lost = snapshot(Mode::Disarmed, 0);
        assert!(check_link(&lost.link, "sim").is_ok());
        let silent = check_link(&LinkStatus::default(), "sim").map_err(|e| e.to_string());
        assert!(silent.is_err_and(|why| why.contains("no data from the boards on sim")));
    }
}
