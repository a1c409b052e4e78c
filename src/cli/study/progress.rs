//! How far a study is, on standard error: a line at its start, then one per piece of work that is done, at most one
//! every ten seconds.

use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use super::super::stdio;

/// Shortest time between two lines.
const EVERY: Duration = Duration::from_secs(10);

/// Shared by all who work at a study; says nothing when it is quiet.
#[derive(Clone)]
pub struct Progress {
    state: Option<Arc<Mutex<State>>>,
}

struct State {
    study: String,
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

impl Progress {
    /// Progress that is told, unless `quiet`.
    pub fn new(quiet: bool) -> Self {
        let state = || State {
            study: String::new(),
            items: [0, 0],
            trials: [0, 0],
            begun: now(),
            said: now(),
        };
        Self {
            state: (!quiet).then(|| Arc::new(Mutex::new(state()))),
        }
    }

    /// A study begins, with so many items to do.
    pub fn study(&self, name: String, items: usize) {
        self.change(true, |s| {
            s.study = name;
            s.items = [0, items];
            s.trials = [0, 0];
            s.begun = now();
        });
    }

    /// An item is done.
    pub fn item_done(&self) {
        self.change(false, |s| {
            s.items[0] += 1;
            s.trials = [0, 0];
        });
    }

    /// So many trials begin.
    pub fn trials(&self, count: usize) {
        self.change(false, |s| s.trials = [0, count]);
    }

    /// A trial is done.
    pub fn trial_done(&self) {
        self.change(false, |s| s.trials[0] += 1);
    }

    fn change(&self, at_once: bool, change: impl FnOnce(&mut State)) {
        let Some(Ok(mut s)) = self.state.as_ref().map(|s| s.lock()) else {
            return;
        };
        change(&mut s);
        if at_once || s.said.elapsed() >= EVERY {
            s.said = now();
            stdio::complain(&line(&s, s.begun.elapsed()));
        }
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
    format!("{}: {}", s.study, text.trim_start_matches(", "))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_says_what_is_done_of_what() {
        let progress = Progress::new(false);
        progress.study("circle".to_owned(), 30);
        progress.trials(90);
        for _ in 0..14 {
            progress.trial_done();
        }
        let said = |p: &Progress| {
            let state = p.state.as_ref().expect("not quiet");
            line(&state.lock().expect("whole"), Duration::from_secs(130))
        };
        assert_eq!(
            said(&progress),
            "circle: 0 of 30 items, 14 of 90 trials, 130 s"
        );
        progress.item_done();
        assert_eq!(said(&progress), "circle: 1 of 30 items, 130 s");
        Progress::new(true).study("quiet".to_owned(), 3);
    }
}
