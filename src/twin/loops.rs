//! The loops that tick a runner: on the host's clock, on simulated time beside it, and on simulated time as fast
//! as it goes.

use std::collections::VecDeque;
use std::ops::ControlFlow;
use std::sync::Arc;
use std::time::{Duration, Instant};

use super::command::{Command, Event};
use super::port::TICK_S;
use super::runner::Runner;
use crate::signal::{Snapshot, Stamp};

const TICK: Duration = Duration::from_millis(10);
/// Simulated time that has fallen behind real time by no more than this is made up for.
const MADE_UP: Duration = Duration::from_millis(50);
/// The real-time factor is a mean over this time.
const FACTOR_OVER: Duration = Duration::from_secs(2);

/// How well a loop kept its period.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Pace {
    /// Ticks run.
    pub ticks: u64,
    /// Ticks that began more than one period late and were skipped; on simulated time there are none.
    pub missed: u64,
}

/// Ticks on the host's clock until `each` ends them. `each` sees every snapshot with its events and may
/// add commands for the next tick.
pub fn run_in_real_time(
    runner: &mut Runner,
    start: Instant,
    mut each: impl FnMut(&Arc<Snapshot>, &[Event], &mut Vec<Command>) -> ControlFlow<()>,
) -> Pace {
    runner.draw_beside();
    let mut pace = Pace::default();
    let mut due = start.elapsed();
    let mut commands = Vec::new();
    loop {
        let elapsed = start.elapsed();
        if elapsed < due {
            std::thread::sleep(due - elapsed);
        }
        let late = start.elapsed().saturating_sub(due);
        let skipped = (late.as_secs_f64() / TICK_S) as u32;
        pace.missed += u64::from(skipped);
        if skipped > 0 {
            log::debug!("{skipped} ticks missed");
        }
        due += TICK * skipped;
        let now = Stamp::from_seconds(start.elapsed().as_secs_f64());
        let (snapshot, events) = runner.tick(now, &std::mem::take(&mut commands));
        pace.ticks += 1;
        if each(&snapshot, &events, &mut commands).is_break() {
            return pace;
        }
        due += TICK;
    }
}

/// Ticks on simulated time, as fast as it goes, until `each` ends them. A recording is written whole.
pub fn run_in_simulated_time(
    runner: &mut Runner,
    each: impl FnMut(&Arc<Snapshot>, &[Event], &mut Vec<Command>) -> ControlFlow<()>,
) -> Pace {
    runner.record_whole();
    run_in_steps(runner, |_| {}, each)
}

/// Ticks on simulated time that keeps beside real time where the machine is fast enough, until `each` ends them.
/// Where it is not, or was not run for a while, simulated time falls behind; no tick is skipped.
pub fn run_in_lockstep(
    runner: &mut Runner,
    start: Instant,
    each: impl FnMut(&Arc<Snapshot>, &[Event], &mut Vec<Command>) -> ControlFlow<()>,
) -> Pace {
    runner.draw_beside();
    let mut pacer = Pacer::new(start.elapsed());
    let wait = |runner: &mut Runner| {
        std::thread::sleep(pacer.wait(start.elapsed()));
        let factor = pacer.real_time_factor(start.elapsed());
        runner.observe_real_time_factor(factor);
    };
    run_in_steps(runner, wait, each)
}

/// Ticks of one period of simulated time each; `before` is called before each.
fn run_in_steps(
    runner: &mut Runner,
    mut before: impl FnMut(&mut Runner),
    mut each: impl FnMut(&Arc<Snapshot>, &[Event], &mut Vec<Command>) -> ControlFlow<()>,
) -> Pace {
    let mut pace = Pace::default();
    let mut commands = Vec::new();
    loop {
        before(runner);
        let now = Stamp::from_seconds(pace.ticks as f64 * TICK_S);
        let (snapshot, events) = runner.tick(now, &std::mem::take(&mut commands));
        pace.ticks += 1;
        if each(&snapshot, &events, &mut commands).is_break() {
            return pace;
        }
    }
}

/// Keeps simulated time beside real time: never ahead of it, and without hurry after what it has lost.
#[derive(Debug)]
struct Pacer {
    /// Real time at which the next tick is due.
    due: Duration,
    ticks: u32,
    /// Real time before some of the last ticks, with the number of ticks before it; one is older than [`FACTOR_OVER`].
    passed: VecDeque<(Duration, u32)>,
}

impl Pacer {
    /// The first tick is due at `elapsed` of real time.
    fn new(elapsed: Duration) -> Self {
        Self {
            due: elapsed,
            ticks: 0,
            passed: VecDeque::from([(elapsed, 0)]),
        }
    }

    /// How long to wait before the next tick, at `elapsed` of real time.
    fn wait(&mut self, elapsed: Duration) -> Duration {
        self.due = self.due.max(elapsed.saturating_sub(MADE_UP));
        let wait = self.due.saturating_sub(elapsed);
        self.due += TICK;
        wait
    }

    /// Simulated time per real time over the last [`FACTOR_OVER`]; to be called once before every tick. `None` until
    /// so much has passed.
    fn real_time_factor(&mut self, elapsed: Duration) -> Option<f64> {
        let before = self.ticks;
        self.passed.push_back((elapsed, before));
        self.ticks = before.wrapping_add(1);
        let old = |p: &(Duration, u32)| elapsed.saturating_sub(p.0) >= FACTOR_OVER;
        while self.passed.get(1).is_some_and(old) {
            self.passed.pop_front();
        }
        let first = self.passed.front().filter(|p| old(p))?;
        let (real, ticks) = (elapsed - first.0, before.wrapping_sub(first.1));
        Some(f64::from(ticks) * TICK_S / real.as_secs_f64())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// `n` ticks that take `busy` each, from `elapsed` on; the last factor.
    fn ticks(pacer: &mut Pacer, elapsed: &mut Duration, n: u32, busy: Duration) -> Option<f64> {
        let mut factor = None;
        for _ in 0..n {
            *elapsed += pacer.wait(*elapsed);
            factor = pacer.real_time_factor(*elapsed);
            *elapsed += busy;
        }
        factor
    }

    #[test]
    fn simulated_time_keeps_beside_real_time_and_falls_behind_where_it_must() {
        let ms = Duration::from_millis;
        let (mut pacer, mut elapsed) = (Pacer::new(ms(70)), ms(70));
        assert_eq!(ticks(&mut pacer, &mut elapsed, 100, ms(3)), None);
        // In real time: the hundredth tick began 99 periods after the first.
        assert_eq!(elapsed, ms(70 + 990 + 3));
        let factor = ticks(&mut pacer, &mut elapsed, 200, ms(3)).expect("two seconds");
        assert!((factor - 1.0).abs() < 1e-9, "{factor}");
        // A hiccup of 40 ms is made up for within a few ticks.
        elapsed += ms(40);
        ticks(&mut pacer, &mut elapsed, 20, ms(3));
        assert_eq!(elapsed, ms(70 + 3190 + 3));
        // A machine that takes 20 ms for a tick is half as fast as real time.
        let factor = ticks(&mut pacer, &mut elapsed, 300, ms(20)).expect("long since");
        assert!((factor - 0.5).abs() < 0.01, "{factor}");
        // What a minute's stop has cost is not hurried after, and is forgotten after two seconds.
        elapsed += ms(60_000);
        let woken = elapsed;
        let factor = ticks(&mut pacer, &mut elapsed, 10, ms(1)).expect("long since");
        assert!(factor < 0.1, "{factor}");
        let factor = ticks(&mut pacer, &mut elapsed, 210, ms(1)).expect("long since");
        assert!((factor - 1.0).abs() < 0.05, "{factor}");
        let behind = ms(2200) - (elapsed - woken);
        assert!(
            behind <= MADE_UP + ms(10),
            "{behind:?} were hurried through"
        );
    }
}
