//! Endurance runs (`soak`): the twin for hours on a rig with faults, with an operator who moves it, records, streams
//! and resets. The invariants are checked in every tick.

mod faults;
mod operator;
mod system;
mod watch;

use std::net::{Ipv4Addr, SocketAddr, TcpListener};
use std::ops::ControlFlow;
use std::panic::AssertUnwindSafe;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use anyhow::{Context as _, Result};
use serde_json::{Map, Value, json};

use super::Report;
use crate::drive::{SerialRig, TwinBuilder, board_config, check_link, in_process, rig_options};
use crate::rig::{RigBoard, VirtualRig};
use crate::robot::RobotSpec;
use crate::signal::{LinkStatus, Snapshot, Stamp};
use crate::twin::{Event, Pace, Port};
use faults::{FROM_OUTSIDE, FaultSchedule, IN_PROCESS, Kind};
use operator::{Done, Operator};
use system::{Use, count_panics, in_use};
use watch::{Broken, Watch, Watched};

/// Memory may grow by this much from the first look to the last, MiB: the median slope between two looks (Theil and Sen)
/// times the run. What the allocator has not given back yet after a recording comes and goes; a leak stays.
const GROWTH_MIB: f64 = 20.0;
/// Rate of a board's clock, 1/s, and the ticks after which it wraps.
const TICK_RATE_HZ: f64 = crate::link::wire::TICK_RATE_HZ as f64;
const WRAP_TICKS: f64 = (1u64 << 32) as f64;
/// Before memory is looked at, recording and stream are ended and get this long for it, s.
const QUIET_S: f64 = 20.0;
const HOUR_S: f64 = 3600.0;
/// On simulated time the disk, the network and their threads are slower than the clock: a look waits for them this
/// often, so long.
const LOOKS: u32 = 100;
const LOOK: Duration = Duration::from_millis(50);
/// Rings per segment of the rig's arm on simulated time: half of the usual number. Its arm bends a little
/// differently for that; the twin does all that it always does.
const RINGS: usize = 4;

/// Options of an endurance run.
#[derive(Clone, Debug)]
pub struct Options {
    /// Length, h.
    pub hours: f64,
    /// On simulated time in this process, as fast as it goes; else in real time against a rig process.
    pub accelerate: bool,
    /// Seed of the faults, of the operator's actions and of the rig's noise.
    pub seed: u64,
}

/// Memory, handles and threads over the run.
struct Growth {
    /// Time between two looks, s.
    every_s: f64,
    next_s: f64,
    first: Option<Use>,
    last: Option<Use>,
    /// The most beyond the first look.
    handles: u64,
    threads: u64,
    /// Memory at each look.
    each_mib: Vec<f64>,
}

impl Growth {
    /// A look after every hour, or ten in a run of less than two.
    fn new(hours: f64) -> Self {
        let every_s = if hours >= 2.0 {
            HOUR_S
        } else {
            hours * HOUR_S / 10.0
        };
        // The first look is after an hour, or after three tenths of a short run.
        Self {
            every_s,
            next_s: if hours >= 2.0 { HOUR_S } else { 3.0 * every_s },
            first: None,
            last: None,
            handles: 0,
            threads: 0,
            each_mib: Vec::with_capacity(hours as usize + 10),
        }
    }

    /// Looks at `t_s`, s; `looks` times at most, until there is no more than at first.
    fn look(&mut self, t_s: f64, looks: u32) {
        self.next_s = t_s + self.every_s;
        let mut now = in_use();
        for _ in 1..looks {
            let as_first =
                |f: Use| now.is_some_and(|n| n.handles <= f.handles && n.threads <= f.threads);
            if self.first.is_some_and(as_first) {
                break;
            }
            std::thread::sleep(LOOK);
            now = in_use();
        }
        let Some(now) = now else { return };
        let first = *self.first.get_or_insert(now);
        self.handles = self.handles.max(now.handles.saturating_sub(first.handles));
        self.threads = self.threads.max(now.threads.saturating_sub(first.threads));
        self.each_mib.push(now.memory_mib);
        self.last = Some(now);
        log::info!("{:.2} h: {now:?}", t_s / HOUR_S);
    }

    /// By how much memory grew from the first look to the last, MiB.
    fn grown_mib(&self) -> f64 {
        let looks = self.each_mib.iter().enumerate();
        let mut slopes: Vec<f64> = looks
            .clone()
            .flat_map(|(i, a)| {
                let later = looks.clone().skip(i + 1);
                later.map(move |(j, b)| (b - a) / (j - i) as f64)
            })
            .collect();
        slopes.sort_by(f64::total_cmp);
        let middle = slopes.get(slopes.len() / 2).copied().unwrap_or(0.0);
        middle * self.each_mib.len().saturating_sub(1) as f64
    }
}

/// Count of a board clock's wraps.
#[derive(Clone, Copy, Debug, Default)]
struct Wraps {
    first: Option<f64>,
    now: f64,
}

impl Wraps {
    /// `clock_s` is the board's clock, unwrapped.
    fn see(&mut self, clock_s: f64) {
        self.now = (clock_s * TICK_RATE_HZ / WRAP_TICKS).floor();
        self.first.get_or_insert(self.now);
    }

    fn count(self) -> u64 {
        (self.now - self.first.unwrap_or(self.now)).max(0.0) as u64
    }
}

/// Figures of an endurance run.
struct Outcome {
    hours: f64,
    /// The hours that were asked for, if the run was ended before.
    ended_of_hours: Option<f64>,
    pace: Pace,
    link: LinkStatus,
    faults: Vec<(&'static str, u64)>,
    done: Done,
    sent: u64,
    broken: Broken,
    panics: u64,
    growth: Growth,
    wraps: u64,
    simulated: bool,
    wall: Duration,
}

/// A folder for recordings, removed at the end.
struct Folder(PathBuf);

impl Folder {
    fn new() -> Result<Self> {
        let path = std::env::temp_dir().join(format!("springtwin-soak-{}", std::process::id()));
        std::fs::create_dir_all(&path)
            .with_context(|| format!("cannot make the folder {}", path.display()))?;
        Ok(Self(path))
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        if let Err(e) = std::fs::remove_dir_all(&self.0) {
            log::warn!("{}: cannot be removed: {e}", self.0.display());
        }
    }
}

/// Result of an endurance run.
pub struct Endured {
    /// All figures.
    pub report: Report,
    /// The bounds that were missed, or that a signal ended the run, as one sentence; `None` if neither.
    pub missed: Option<String>,
}

/// Runs the twin against a rig with faults. `robot_file` is the file of `robot`; `None`: it is the reference robot.
///
/// # Errors
/// When the rig cannot be set up, or no data come from it.
pub fn run(
    o: &Options,
    ends: Arc<AtomicBool>,
    robot_file: Option<&Path>,
    robot: &RobotSpec,
) -> Result<Endured> {
    let outcome = soak(o, ends, robot_file, robot)?;
    Ok(Endured {
        report: report(&outcome),
        missed: missed(&outcome),
    })
}

fn soak(
    a: &Options,
    ends: Arc<AtomicBool>,
    robot_file: Option<&Path>,
    robot: &RobotSpec,
) -> Result<Outcome> {
    let twin = TwinBuilder::new(robot).ends_with(ends);
    let start = twin.start();
    let folder = Folder::new()?;
    let panics = count_panics();
    let watch = Watch::default();
    let wraps = Arc::new(Mutex::new(Wraps::default()));
    let kinds: &'static [Kind] = match a.accelerate {
        true => &IN_PROCESS,
        false => &FROM_OUTSIDE,
    };
    let schedule = Arc::new(Mutex::new(FaultSchedule::new(kinds, a.seed)));
    let options = rig_options(0.0, a.seed);
    let mut rig_process = None;
    let inner: Box<dyn Port> = if a.accelerate {
        let rig = VirtualRig::of_rings(robot, &options, RINGS)?;
        let (faults, eye, clock) = (Arc::clone(&schedule), watch.clone(), Arc::clone(&wraps));
        let script = move |t_s: f64, rig: &mut VirtualRig| {
            let mut faults = lock(&faults);
            faults.apply(t_s, rig);
            eye.set_detour(faults.detour_s(t_s));
            drop(faults);
            // What a supply does that ignores the boards is not theirs.
            let boards_pa = rig.driven_pa();
            eye.look_at_pumps(
                t_s,
                &std::array::from_fn(|i| boards_pa[i / 3].map(|pa| pa[i % 3])),
            );
            if let [RigBoard::Emulated(board), _] = rig.boards_mut() {
                lock(&clock).see(board.clock_s(t_s));
            }
        };
        Box::new(in_process(rig, board_config(robot), Some(Box::new(script))))
    } else {
        let rig = SerialRig::spawn(&options, robot_file, robot, start)?;
        rig_process = rig.process_id();
        Box::new(rig)
    };
    let watched = Watched::new(inner, robot, &watch);
    let mut driver = twin.port(Box::new(watched)).build()?;
    let mut operator = Operator::new(robot, a.seed, &folder.0, nobody()?);
    let mut growth = Growth::new(a.hours);
    let mut last: Option<Arc<Snapshot>> = None;
    let mut frozen = false;
    let end_s = a.hours * HOUR_S;
    let mut each = |snapshot: &Arc<Snapshot>, events: &[Event], commands: &mut Vec<_>| {
        let t_s = snapshot.stamp.seconds();
        watch.look_at(snapshot);
        operator.attend(snapshot, events, commands);
        if let Some(process) = rig_process {
            freeze(process, lock(&schedule).freezes(t_s), &mut frozen);
            if let Some(fit) = &snapshot.link.board_clock[0] {
                lock(&wraps).see((t_s - fit.offset_s) / (1.0 + fit.skew_ratio));
            }
        }
        if t_s >= growth.next_s - QUIET_S {
            operator.be_quiet_until(growth.next_s + 1.0);
            // On simulated time the disk is slower than the clock.
            if a.accelerate && !operator.is_quiet() {
                std::thread::sleep(Duration::from_millis(1));
            }
        }
        if t_s >= growth.next_s {
            growth.look(t_s, if a.accelerate { LOOKS } else { 1 });
        }
        last = Some(Arc::clone(snapshot));
        match t_s >= end_s {
            true => ControlFlow::Break(()),
            false => ControlFlow::Continue(()),
        }
    };
    // A panic ends the run, but not its report.
    let ticked = std::panic::catch_unwind(AssertUnwindSafe(|| driver.run(&mut [&mut each])));
    if let Some(process) = rig_process {
        freeze(process, false, &mut frozen);
    }
    let end = last.as_ref().map_or(Stamp::ZERO, |s| s.stamp);
    let was_ended = driver.was_ended();
    driver.finish(end);
    let link = last.map(|s| s.link.clone()).unwrap_or_default();
    let linked = check_link(&link, "the virtual rig");
    anyhow::ensure!(linked.is_ok() || !was_ended, crate::drive::ENDED);
    linked?;
    let mut seen = watch.seen();
    Ok(Outcome {
        hours: end.seconds() / HOUR_S,
        ended_of_hours: was_ended.then_some(a.hours),
        pace: ticked.unwrap_or_default(),
        simulated: link.simulated,
        link,
        faults: lock(&schedule).begun().collect(),
        done: operator.done,
        sent: seen.sent,
        broken: std::mem::take(&mut seen.broken),
        panics: panics.load(Ordering::Relaxed),
        growth,
        wraps: lock(&wraps).count(),
        wall: start.elapsed(),
    })
}

fn lock<T>(shared: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    shared.lock().unwrap_or_else(PoisonError::into_inner)
}

/// An address of this computer where nobody listens.
fn nobody() -> Result<SocketAddr> {
    let free = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).and_then(|l| l.local_addr());
    free.context("cannot find a port of this computer where nobody listens")
}

/// Lets the rig's process stand still, or go on.
#[cfg(unix)]
fn freeze(process: u32, shall: bool, is: &mut bool) {
    use nix::sys::signal::{Signal, kill};
    if shall == *is {
        return;
    }
    *is = shall;
    let signal = if shall {
        Signal::SIGSTOP
    } else {
        Signal::SIGCONT
    };
    if let Err(e) = kill(nix::unistd::Pid::from_raw(process as i32), signal) {
        log::warn!("the rig's process takes no signal: {e}");
    }
}

#[cfg(not(unix))]
fn freeze(_process: u32, _shall: bool, _is: &mut bool) {}

/// Wraps of a clock that runs all the time.
fn wraps_due(hours: f64) -> u64 {
    (hours * HOUR_S * TICK_RATE_HZ / WRAP_TICKS).floor() as u64
}

/// Which bounds were missed, or that the run was ended before it was over, as one sentence.
fn missed(o: &Outcome) -> Option<String> {
    let g = &o.growth;
    let bounds = [
        (o.panics > 0, format!("{} panics", o.panics)),
        (
            o.broken.count > 0,
            format!(
                "{} violations of what must always hold, the first: {}",
                o.broken.count,
                o.broken.reported.first().map_or("", String::as_str)
            ),
        ),
        // Before an hour is over, the first use of everything is still to come.
        (
            o.hours >= 2.0 && g.grown_mib() >= GROWTH_MIB,
            format!("memory grew by {:.1} MiB", g.grown_mib()),
        ),
        (
            g.handles > 0,
            format!("{} more handles were open than at first", g.handles),
        ),
        (
            g.threads > 0,
            format!("{} more threads ran than at first", g.threads),
        ),
        // Jumps of a clock may take one away.
        (
            o.wraps + 1 < wraps_due(o.hours),
            format!("the clock of board 1 wrapped {} times only", o.wraps),
        ),
        (
            o.hours >= 0.1 && o.done.goals_reached == 0,
            "no goal was reached".to_owned(),
        ),
    ];
    let missed: Vec<String> = bounds
        .into_iter()
        .filter(|(is, _)| *is)
        .map(|(_, text)| text)
        .collect();
    let of_bounds = match missed.is_empty() {
        true => "no bound was missed".to_owned(),
        false => format!("bounds were missed: {}", missed.join("; ")),
    };
    match o.ended_of_hours {
        Some(asked) => Some(format!(
            "the soak was ended by a signal after {:.2} of {asked} h; until then {of_bounds}",
            o.hours
        )),
        None => {
            (!missed.is_empty()).then(|| format!("in the soak of {:.2} h {of_bounds}", o.hours))
        }
    }
}

fn report(o: &Outcome) -> Report {
    let g = &o.growth;
    let ends = |value: fn(&Use) -> f64| [&g.first, &g.last].map(|u| u.as_ref().map(value));
    let [memory_first, memory_last] = ends(|u| u.memory_mib);
    let [handles_first, handles_last] = ends(|u| u.handles as f64);
    let [threads_first, threads_last] = ends(|u| u.threads as f64);
    let faults: Map<String, Value> = o
        .faults
        .iter()
        .map(|(kind, n)| ((*kind).to_owned(), json!(n)))
        .collect();
    let all: u64 = o.faults.iter().map(|(_, n)| n).sum();
    let whole = |v: Option<f64>| v.map(|v| v as u64);
    let tenth = |v: f64| (v * 10.0).round() / 10.0;
    let d = &o.done;
    let shown = |v: Option<f64>| v.map_or("?".to_owned(), |v| format!("{v:.0}"));
    Report {
        text: format!(
            "{:.2} h{}, {} ticks ({} missed), {} frames, {} lost, in {:.0} s\n\
             {all} faults, {} times SAFE (longest {:.0} s), {} resets; {} motions asked for, {} goals reached, \
             {} plans carried out\n\
             {} recordings ({} failed), {} streams to nobody\n\
             {} panics, {} violations, {} wraps of board 1's clock\n\
             memory {} MiB at first, {} MiB at last, a trend of {:+.1} MiB; handles {} and {}; threads {} and {}{}",
            o.hours,
            if o.simulated { " (simulated rig)" } else { "" },
            o.pace.ticks,
            o.pace.missed,
            o.link.frames,
            o.link.frames_lost,
            o.wall.as_secs_f64(),
            d.safe,
            d.longest_safe_s,
            d.resets,
            d.motions,
            d.goals_reached,
            d.plans_finished,
            d.recordings,
            d.recordings_failed,
            d.streams,
            o.panics,
            o.broken.count,
            o.wraps,
            shown(memory_first),
            shown(memory_last),
            g.grown_mib(),
            shown(handles_first),
            shown(handles_last),
            shown(threads_first),
            shown(threads_last),
            o.broken
                .reported
                .iter()
                .map(|t| format!("\nviolation at {t}"))
                .collect::<String>(),
        ),
        json: json!({
            "hours": o.hours, "ended_of_hours": o.ended_of_hours, "ticks": o.pace.ticks, "missed_ticks": o.pace.missed,
            "frames": o.link.frames, "frames_lost": o.link.frames_lost,
            "commands": o.sent, "faults": faults,
            "safe": d.safe, "longest_safe_s": tenth(d.longest_safe_s), "resets": d.resets,
            "motions": d.motions, "goals_reached": d.goals_reached, "plans_finished": d.plans_finished,
            "refused": d.refused,
            "recordings": d.recordings, "recordings_failed": d.recordings_failed, "streams": d.streams,
            "panics": o.panics,
            "memory_mib": {
                "first_hour": memory_first.map(tenth), "last": memory_last.map(tenth),
                "growth": tenth(g.grown_mib()), "each": g.each_mib.iter().copied().map(tenth).collect::<Vec<_>>(),
            },
            "handles": {"first": whole(handles_first), "last": whole(handles_last)},
            "threads": {"first": whole(threads_first), "last": whole(threads_last)},
            "tick_wraps": o.wraps, "violations": o.broken.count, "violated": o.broken.reported,
            "simulated": o.simulated, "wall_seconds": tenth(o.wall.as_secs_f64()),
        }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_leak_shows_in_memory_that_comes_and_goes() {
        let grown = |of: fn(usize) -> f64| {
            let mut g = Growth::new(24.0);
            g.each_mib = (0..24).map(of).collect();
            g.grown_mib()
        };
        let comes_and_goes = |i: usize| 72.0 + [0.0, 1.0, 25.0, 0.0, 12.0][i % 5];
        assert!(grown(comes_and_goes).abs() < 1.0);
        assert!((grown(|i| 72.0 + i as f64) - 23.0).abs() < 1e-9);
        let leaks = |i: usize| 72.0 + i as f64 + [0.0, 1.0, 25.0, 0.0, 12.0][i % 5];
        assert!((grown(leaks) - 23.0).abs() < 3.0);
        assert_eq!(Growth::new(1.0).grown_mib(), 0.0);
    }
}
