//! What the twin's thread hands to the window, without ever waiting for it.

use std::collections::VecDeque;
use std::ops::ControlFlow;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, TryRecvError, TrySendError, sync_channel};
use std::sync::{Arc, Mutex, TryLockError};
use std::thread::JoinHandle;
use std::time::Instant;

use super::command::{Command, Event, Handle, Pictures};
use super::loops::{run_in_lockstep, run_in_real_time};
use super::port::Clock;
use super::runner::Runner;
use crate::link::StopLine;
use crate::signal::{ArmingCheck, Mode, Snapshot, Stamp};

/// Snapshots that wait for the window at most: two seconds' worth.
const FEED: usize = 200;
/// Events in the window's queue at most; what does not fit waits with the twin's thread.
const EVENTS: usize = 256;
/// Notices and warnings that wait with the twin's thread at most.
const NOTICES: usize = 256;
/// Commands that wait for the twin at most.
const COMMANDS: usize = 64;
/// A window that paints nothing for so long while the arm moves on hardware: it is held, and then stopped, s.
const HOLD_AFTER_S: f64 = 2.0;
const STOP_AFTER_S: f64 = 5.0;

/// The twin's end of a [`Handle`].
pub(super) struct Publisher {
    events: SyncSender<Event>,
    feed: SyncSender<Arc<Snapshot>>,
    latest: Arc<Mutex<Arc<Snapshot>>>,
    waiting: Waiting,
}

/// Both ends, and the commands that come from the window.
pub(super) fn channel() -> (Publisher, Handle, Receiver<Command>) {
    let (command_tx, commands) = sync_channel(COMMANDS);
    let (event_tx, event_rx) = sync_channel(EVENTS);
    let (feed_tx, feed_rx) = sync_channel(FEED);
    let latest = Arc::new(Mutex::new(Arc::new(Snapshot::default())));
    let publisher = Publisher {
        events: event_tx,
        feed: feed_tx,
        latest: Arc::clone(&latest),
        waiting: Waiting::default(),
    };
    let handle = Handle {
        commands: command_tx,
        events: event_rx,
        feed: feed_rx,
        latest,
        stop_line: StopLine::default(),
        pictures: Pictures::default(),
    };
    (publisher, handle, commands)
}

impl Publisher {
    /// Hands over a snapshot and what happened. A window that does not keep up loses samples and repeated notices;
    /// what came of its commands it gets late, and in order.
    pub(super) fn publish(&mut self, now: Stamp, snapshot: &Arc<Snapshot>, events: &[Event]) {
        match self.latest.try_lock() {
            Ok(mut slot) => *slot = Arc::clone(snapshot),
            Err(TryLockError::Poisoned(poisoned)) => *poisoned.into_inner() = Arc::clone(snapshot),
            // The window is looking at the last one; the next tick's takes its place.
            Err(TryLockError::WouldBlock) => {}
        }
        let _ = self.feed.try_send(Arc::clone(snapshot));
        for event in events {
            self.waiting.push(event.clone());
        }
        if let Some(gap) = self.waiting.gap(now) {
            if self.events.try_send(gap).is_err() {
                return;
            }
            self.waiting.left_out = 0;
        }
        while let Some(event) = self.waiting.events.pop_front() {
            if let Err(TrySendError::Full(event)) = self.events.try_send(event) {
                self.waiting.events.push_front(event);
                return;
            }
        }
    }
}

/// Events on their way to the window, oldest first. Outcomes are all kept: the window asks for no more of them while it
/// does not read. Of equal notices the newest is kept, and of others the newest [`NOTICES`].
#[derive(Default)]
struct Waiting {
    events: VecDeque<Event>,
    /// Notices that were left out and have not been reported.
    left_out: u64,
}

/// The text of an event that answers nothing.
fn notice(event: &Event) -> Option<&str> {
    match event {
        Event::Notice { text, .. } | Event::Warning { text, .. } => Some(text),
        Event::Mode { .. }
        | Event::Refused { .. }
        | Event::Reached { .. }
        | Event::Finished { .. }
        | Event::Calibrated { .. }
        | Event::Recording { .. }
        | Event::RecordingFailed { .. } => None,
    }
}

impl Waiting {
    fn push(&mut self, event: Event) {
        if let Some(text) = notice(&event) {
            let notices = self.events.iter().enumerate();
            let mut notices = notices.filter_map(|(i, e)| Some((i, notice(e)?)));
            let same = notices.clone().find(|(_, t)| *t == text).map(|(i, _)| i);
            let oldest = notices.next().map(|(i, _)| i);
            let many = self.events.iter().filter(|e| notice(e).is_some()).count() >= NOTICES;
            if let Some(i) = same.or(oldest.filter(|_| many)) {
                self.left_out += u64::from(same.is_none());
                self.events.remove(i);
            }
        }
        self.events.push_back(event);
    }

    /// The notice in place of those that were left out.
    fn gap(&self, now: Stamp) -> Option<Event> {
        let n = self.left_out;
        (n > 0).then(|| Event::Notice {
            stamp: now,
            text: format!("{n} messages are left out here: the window was busy for too long."),
        })
    }
}

/// Holds and stops an arm that moves on hardware while nobody could press STOP in the window.
struct WindowWatch {
    pictures: Pictures,
    seen: u64,
    since: Stamp,
    has_held: bool,
}

impl WindowWatch {
    fn new(pictures: Pictures) -> Self {
        Self {
            pictures,
            seen: 0,
            since: Stamp::ZERO,
            has_held: false,
        }
    }

    fn look(&mut self, snapshot: &Snapshot) -> Option<Command> {
        let painted = self.pictures.counted();
        let is_armed = matches!(snapshot.mode, Mode::Hold | Mode::Moving | Mode::AtGoal);
        if painted != self.seen || snapshot.link.practice || !is_armed {
            self.seen = painted;
            self.since = snapshot.stamp;
            self.has_held = false;
            return None;
        }
        // What only holds needs nobody; what sets out from there while nobody looks is held at once.
        let is_checking = matches!(snapshot.gauge_check, ArmingCheck::Chamber(_));
        let is_moving = matches!(snapshot.mode, Mode::Moving | Mode::AtGoal) || is_checking;
        if !is_moving && !self.has_held {
            return None;
        }
        let for_s = snapshot.stamp.since(self.since);
        if for_s >= STOP_AFTER_S && self.has_held {
            log::warn!("the window has not answered for {for_s:.0} s: stopped");
            self.since = snapshot.stamp;
            self.has_held = false;
            Some(Command::Stop)
        } else if for_s >= HOLD_AFTER_S && !self.has_held {
            log::warn!("the window has not answered for {for_s:.0} s: held");
            self.has_held = true;
            self.since = snapshot.stamp.plus(-HOLD_AFTER_S);
            Some(Command::Hold)
        } else {
            None
        }
    }
}

/// Starts the twin's own thread: in lockstep with simulated time where the port lives on it, in real time elsewhere.
/// `first` is commanded once a second of frames has come in: by then the orientation filters have settled. `repaint`
/// is called with every snapshot. The thread ends when the handle is dropped; whoever ends the program joins it
/// first, or the end of a recording is lost.
///
/// # Errors
/// When the thread cannot be started.
pub fn spawn(
    runner: Runner,
    start: Instant,
    first: Vec<Command>,
    repaint: impl FnMut(&Snapshot) + Send + 'static,
) -> std::io::Result<(Handle, JoinHandle<()>)> {
    spawn_until(Arc::default(), runner, start, first, repaint)
}

/// The same; the thread also ends once `ends` is set, whatever the window does meanwhile.
///
/// # Errors
/// As [`spawn`].
pub fn spawn_until(
    ends: Arc<AtomicBool>,
    mut runner: Runner,
    start: Instant,
    mut first: Vec<Command>,
    mut repaint: impl FnMut(&Snapshot) + Send + 'static,
) -> std::io::Result<(Handle, JoinHandle<()>)> {
    runner.draw_shapes();
    let (mut publisher, mut handle, asked) = channel();
    handle.stop_line = runner.stop_line();
    let mut watch = WindowWatch::new(handle.pictures.clone());
    let work = move || {
        let mut end = Stamp::ZERO;
        let each = |snapshot: &Arc<Snapshot>, events: &[Event], commands: &mut Vec<Command>| {
            end = snapshot.stamp;
            publisher.publish(end, snapshot, events);
            repaint(snapshot);
            if ends.load(Ordering::Relaxed) {
                return ControlFlow::Break(());
            }
            commands.extend(watch.look(snapshot));
            if snapshot.has_settled() {
                commands.append(&mut first);
            }
            loop {
                match asked.try_recv() {
                    Ok(command) => commands.push(command),
                    Err(TryRecvError::Empty) => return ControlFlow::Continue(()),
                    // The window is gone: nobody could press STOP any more.
                    Err(TryRecvError::Disconnected) => return ControlFlow::Break(()),
                }
            }
        };
        match runner.clock() {
            Clock::Host => run_in_real_time(&mut runner, start, each),
            Clock::Lockstep => run_in_lockstep(&mut runner, start, each),
        };
        runner.end(end);
    };
    let thread = std::thread::Builder::new().name("twin".to_owned());
    Ok((handle, thread.spawn(work)?))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::signal::LinkStatus;

    /// What is commanded, and when (s), while the window paints until `paints_s` only.
    fn commanded(practice: bool, paints_s: f64) -> Vec<(f64, Command)> {
        let pictures = Pictures::default();
        let mut watch = WindowWatch::new(pictures.clone());
        let mut mode = Mode::Moving;
        let mut all = Vec::new();
        for k in 0..1000 {
            let t_s = f64::from(k) * 0.01;
            if t_s < paints_s && k % 50 == 0 {
                pictures.count();
            }
            let snapshot = Snapshot {
                stamp: Stamp::from_seconds(t_s),
                mode: mode.clone(),
                link: LinkStatus {
                    practice,
                    ..LinkStatus::default()
                },
                ..Snapshot::default()
            };
            if let Some(command) = watch.look(&snapshot) {
                mode = match command {
                    Command::Hold => Mode::Hold,
                    _ => Mode::Safe("stopped".into()),
                };
                all.push((t_s, command));
            }
        }
        all
    }

    #[test]
    fn a_window_that_does_not_answer_holds_and_then_stops_what_moves_on_hardware() {
        assert_eq!(commanded(false, 1000.0), []);
        assert_eq!(commanded(true, 1.0), [], "nobody stands beside it");
        let found = commanded(false, 1.0);
        // The last picture is at 0.5 s.
        assert_eq!(found.len(), 2, "{found:?}");
        assert_eq!(found[0].1, Command::Hold);
        assert!((found[0].0 - 2.5).abs() < 0.02, "{found:?}");
        assert_eq!(found[1].1, Command::Stop);
        assert!((found[1].0 - 5.5).abs() < 0.02, "{found:?}");
    }

    #[test]
    fn the_check_of_the_gauges_counts_as_motion_and_what_sets_out_unseen_is_held_at_once() {
        let looks = |checks: fn(f64) -> bool, moves: fn(f64) -> bool| {
            let mut watch = WindowWatch::new(Pictures::default());
            let mut all = Vec::new();
            for k in 0..1000 {
                let t_s = f64::from(k) * 0.01;
                let held = !all.is_empty();
                let gauge_check = match checks(t_s) && !held {
                    true => ArmingCheck::Chamber(0),
                    false => ArmingCheck::NotNeeded,
                };
                let mode = match moves(t_s) && !held {
                    true => Mode::Moving,
                    false => Mode::Hold,
                };
                let snapshot = Snapshot {
                    stamp: Stamp::from_seconds(t_s),
                    mode,
                    gauge_check,
                    ..Snapshot::default()
                };
                all.extend(watch.look(&snapshot).map(|c| (t_s, c)));
            }
            all
        };
        assert_eq!(looks(|_| false, |_| false), [], "an arm that only holds");
        let found = looks(|t_s| t_s >= 0.5, |_| false);
        assert!((found[0].0 - 2.0).abs() < 0.02 && found[0].1 == Command::Hold);
        let found = looks(|_| false, |t_s| t_s >= 7.0);
        assert!((found[0].0 - 7.0).abs() < 0.02 && found[0].1 == Command::Hold);
        assert_eq!(found.len(), 1, "{found:?}: STOP would follow 3 s later");
    }
}
