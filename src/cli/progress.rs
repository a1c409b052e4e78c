//! Progress of long work on standard error: a bar, or a line now and then.

use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressStyle};

use super::stdio;
use springtwin::lab::Progress;

/// A bar per stage.
#[derive(Default)]
pub struct Bar(Mutex<Option<ProgressBar>>);

impl Bar {
    fn with(&self, act: impl FnOnce(&mut Option<ProgressBar>)) {
        act(&mut self.0.lock().unwrap_or_else(PoisonError::into_inner));
    }
}

impl Progress for Bar {
    fn stage(&self, name: &str, items: usize) {
        let style = ProgressStyle::with_template("{msg:14} {bar:40} {pos}/{len} {eta}");
        let bar = ProgressBar::new(items as u64)
            .with_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()))
            .with_message(name.to_owned());
        bar.tick();
        self.with(|b| *b = Some(bar));
    }

    fn item_done(&self) {
        self.with(|b| b.iter().for_each(|bar| bar.inc(1)));
    }

    fn items_done(&self, count: usize) {
        self.with(|b| b.iter().for_each(|bar| bar.set_position(count as u64)));
    }

    fn stage_done(&self, _result: &str) {
        self.with(|b| b.iter().for_each(ProgressBar::finish_and_clear));
    }
}

/// Shortest time between two lines.
const EVERY: Duration = Duration::from_secs(10);

/// A line at the start of a stage, then one per piece of work that is done, at most one every ten seconds.
pub struct Lines(Mutex<State>);

struct State {
    stage: String,
    /// Items done and in all.
    items: [usize; 2],
    /// Trials of the present item, or of all of them, done and in all; none in all where there are no trials.
    trials: [usize; 2],
    begun: Instant,
    said: Instant,
}

#[expect(
    clippy::disallowed_methods,
    reason = "wall time of the command, for people"
)]
fn now() -> Instant {
    Instant::now()
}

impl Default for Lines {
    fn default() -> Self {
        Self(Mutex::new(State {
            stage: String::new(),
            items: [0, 0],
            trials: [0, 0],
            begun: now(),
            said: now(),
        }))
    }
}

impl Lines {
    fn change(&self, at_once: bool, change: impl FnOnce(&mut State)) {
        let mut s = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        change(&mut s);
        if at_once || s.said.elapsed() >= EVERY {
            s.said = now();
            stdio::complain(&line(&s, s.begun.elapsed()));
        }
    }
}

impl Progress for Lines {
    fn stage(&self, name: &str, items: usize) {
        self.change(true, |s| {
            s.stage = name.to_owned();
            s.items = [0, items];
            s.trials = [0, 0];
            s.begun = now();
        });
    }

    fn item_done(&self) {
        self.change(false, |s| {
            s.items[0] += 1;
            s.trials = [0, 0];
        });
    }

    fn trials(&self, count: usize) {
        self.change(false, |s| s.trials = [0, count]);
    }

    fn trial_done(&self) {
        self.change(false, |s| s.trials[0] += 1);
    }

    fn stage_done(&self, result: &str) {
        let s = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        stdio::complain(&format!(
            "{result}: {:.0} s",
            s.begun.elapsed().as_secs_f64()
        ));
    }
}

/// `circle: 0 of 30 items, 14 of 90 trials, 130 s`.
fn line(s: &State, elapsed: Duration) -> String {
    let count = |[done, all]: [usize; 2], what: &str| match all {
        0 => String::new(),
        _ => format!(", {done} of {all} {what}"),
    };
    let text = format!(
        "{}{}, {:.0} s",
        count(s.items, "items"),
        count(s.trials, "trials"),
        elapsed.as_secs_f64()
    );
    format!("{}: {}", s.stage, text.trim_start_matches(", "))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_says_what_is_done_of_what() {
        let progress = Lines::default();
        progress.stage("circle", 30);
        progress.trials(90);
        for _ in 0..14 {
            progress.trial_done();
        }
        let said = |p: &Lines| line(&p.0.lock().expect("whole"), Duration::from_secs(130));
        assert_eq!(
            said(&progress),
            "circle: 0 of 30 items, 14 of 90 trials, 130 s"
        );
        progress.item_done();
        assert_eq!(said(&progress), "circle: 1 of 30 items, 130 s");
    }
}
