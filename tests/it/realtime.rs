//! Smoke tests against the clock of the computer, with real ports, processes and windows: `./test realtime`, by name
//! only. What they touch is held to its figures elsewhere, on simulated time; here it is seen to work at all, within
//! bounds that a busy machine keeps. A machine that withholds the processor for 100 ms makes the arm SAFE, as it must:
//! such a run is reported and counts as one that ended in SAFE, not as one that is done again.

use std::ops::ControlFlow;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::sync_channel;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use serde_json::Value;
use springtwin::link::Origin;
use springtwin::link::serial;
use springtwin::link::wire::Config;
use springtwin::rig::pty::{Lines, Pty};
use springtwin::rig::{RigOptions, VirtualRig};
use springtwin::robot::RobotSpec;
use springtwin::signal::{Mode, Snapshot};
use springtwin::twin::{Command, Runner, SerialPort, TICK_S, run_in_real_time};

#[cfg(feature = "gui")]
mod recordings;
#[cfg(feature = "gui")]
mod tour;
#[cfg(feature = "gui")]
mod walk;
#[cfg(feature = "gui")]
mod window;

use crate::faults::disk::killed;
use crate::firmware::folder_of;
use crate::lockstep::twin;
use crate::process::{self, PATIENCE, program};
use crate::program::{json, scratch};

#[expect(clippy::disallowed_methods, reason = "these tests keep real time")]
fn now() -> Instant {
    Instant::now()
}

/// How a command on a live rig is refused: its exit status and its last line. What the boards report before that is in the
/// log above it.
fn refusal(args: &[&str]) -> (i32, String) {
    let out = process::output(&mut program(args));
    let said = String::from_utf8_lossy(&out.stderr).into_owned();
    let last = said.lines().last().unwrap_or_default().to_owned();
    let errors = said.lines().filter(|l| l.starts_with("error: ")).count();
    assert!(errors == 1 && last.starts_with("error: "), "{said}");
    (out.status.code().expect("it ends by itself"), last)
}

/// What a run towards a target came to: its report, or nothing when the machine stalled and the arm went SAFE.
fn towards_a_target(args: &[&str]) -> Option<Value> {
    let target = ["--target", "20,10,-300", "--seconds", "40", "--json"];
    let out = process::output(&mut program(&[args, &target].concat()));
    let said = String::from_utf8_lossy(&out.stderr);
    // On its way, not because boards that were SAFE from before were refused.
    if said.contains("the arm went SAFE") {
        println!("the machine stalled: {said}");
        assert_eq!(out.status.code(), Some(1));
        return None;
    }
    assert!(out.status.success(), "{said}");
    Some(serde_json::from_slice(&out.stdout).expect("one JSON object"))
}

#[test]
fn a_loop_through_a_pseudo_terminal() {
    let dir = scratch("realtime-pty");
    let file = dir.join("t.rrd");
    let name = file.to_str().expect("utf-8");
    let run = ["run", "--headless", "--rig", "pty", "--record", name];
    if let Some(v) = towards_a_target(&run) {
        println!("{v}");
        assert_eq!(
            (&v["reached"], &v["simulated"]),
            (&true.into(), &true.into())
        );
        assert!(v["target_error_mm"].as_f64().expect("mm") <= 3.0, "{v}");
    }
    let v = json(&["inspect", name, "--json"]);
    assert_eq!(v["complete"], true, "{v}");
    assert!(v["samples"].as_u64() > Some(0), "{v}");
}

/// The firmware under simavr behind two ports; the boards are SAFE once the program has ended, refuse the next run, and
/// take it with `--reset`.
#[test]
fn two_ports_to_the_firmware() {
    let folder = folder_of("");
    let folder = folder.to_str().expect("utf-8");
    let (_rig, ports) = process::rig(&["--firmware", folder]);
    assert_eq!(ports.split(',').count(), 2, "{ports}");
    let accept = "--accept-simulated-boards";
    let run = ["run", "--headless", "--rig", &ports, accept];
    // Boards that have just started are reset by name, and simulated ones armed by an explicit word.
    let target = ["--target", "20,10,-300", "--seconds", "20"];
    let (code, said) = refusal(&[&run[..], &target].concat());
    assert!(code == 1 && said.contains("--reset booted"), "{said}");
    let unasked = ["--reset", "booted"];
    let (code, said) = refusal(&[&run[..4], &unasked, &target].concat());
    assert!(code == 1 && said.contains(accept), "{said}");
    if let Some(first) = towards_a_target(&[&run[..], &["--reset", "booted"]].concat()) {
        println!("{first}");
        assert_eq!(
            (&first["reached"], &first["simulated"]),
            (&true.into(), &true.into())
        );
    }
    std::thread::sleep(Duration::from_secs(1));
    let (code, said) = refusal(&[&run[..], &target].concat());
    assert!(code == 1 && said.contains("SAFE from before"), "{said}");
    if let Some(again) = towards_a_target(&[&run[..], &["--reset"]].concat()) {
        assert_eq!(again["reached"], true, "{again}");
    }
}

#[test]
fn firmware_that_does_not_match_is_named_by_the_program() {
    for (variant, words) in [
        ("version", "protocol version 1"),
        ("config", "does not accept the pressure limits"),
    ] {
        let folder = folder_of(variant);
        let (_rig, ports) = process::rig(&["--firmware", folder.to_str().expect("utf-8")]);
        let run = ["run", "--headless", "--rig", &ports, "--seconds", "20"];
        let (code, said) = refusal(&[&run[..], &["--target", "20,10,-300"]].concat());
        assert!(code == 1 && said.contains(words), "{said}");
    }
}

/// A rig on a pseudo-terminal, in a thread of its own.
struct RigThread {
    unplugged: Arc<AtomicBool>,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl RigThread {
    fn start(link: &Path, start: Instant) -> Self {
        let (link, (ready, is_ready)) = (link.to_owned(), sync_channel(1));
        let (unplugged, stop) = (Arc::new(AtomicBool::new(false)), Arc::default());
        let (off, halt) = (Arc::clone(&unplugged), Arc::clone(&stop));
        let work = move || {
            use springtwin::rig::faults::{Fault, Place, Word};
            let robot = RobotSpec::reference();
            let mut rig = VirtualRig::new(&robot, &RigOptions::default()).expect("settles");
            let mut lines = Lines::Shared(Pty::open(Some(&link)).expect("a pseudo-terminal"));
            ready.send(()).expect("somebody waits for it");
            while !AtomicBool::load(&halt, Ordering::Relaxed) {
                match off.load(Ordering::Relaxed) {
                    true => rig.faults.begin(Place::Port, Fault::of(Word::Off)),
                    false => rig.faults.end(Place::Port),
                }
                lines
                    .exchange(&mut rig, || start.elapsed().as_secs_f64())
                    .expect("the line works");
                std::thread::sleep(Duration::from_millis(1));
            }
        };
        let thread = std::thread::Builder::new().name("rig".to_owned());
        let thread = thread.spawn(work).expect("a thread for the rig");
        is_ready.recv_timeout(PATIENCE).expect("the rig starts");
        Self {
            unplugged,
            stop,
            thread: Some(thread),
        }
    }
}

impl Drop for RigThread {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// Ticks until it is so; how long that took, s.
fn tick_until(
    runner: &mut Runner,
    start: Instant,
    what: &str,
    mut commands: Vec<Command>,
    is: impl Fn(&Snapshot) -> bool,
) -> f64 {
    let from = now();
    let mut mode = Mode::Disarmed;
    run_in_real_time(runner, start, |snapshot, _, next| {
        next.append(&mut commands);
        mode = snapshot.mode.clone();
        match is(snapshot) || from.elapsed() > PATIENCE {
            true => ControlFlow::Break(()),
            false => ControlFlow::Continue(()),
        }
    });
    let took = from.elapsed();
    assert!(
        took <= PATIENCE,
        "{what}: not within {PATIENCE:?}; {mode:?}"
    );
    println!("{what} after {:.3} s", took.as_secs_f64());
    took.as_secs_f64()
}

#[test]
fn a_cable_is_pulled_and_plugged_in() {
    let start = now();
    let link = scratch("realtime-unplugged").join("port");
    let rig = RigThread::start(&link, start);
    let name = link.display().to_string();
    let port = serial::open(&name, start, Config::built_in(), Origin::Simulated);
    let port = Box::new(SerialPort::new(port.expect("the port opens")));
    let robot = RobotSpec::reference();
    let mut runner = Runner::new(twin(&robot), port, &robot);
    let mut until = |what: &str, commands: Vec<Command>, is: &dyn Fn(&Snapshot) -> bool| {
        tick_until(&mut runner, start, what, commands, is)
    };
    let safe = |s: &Snapshot| matches!(s.mode, Mode::Safe(_));
    until("the boards are there", vec![], &|s| {
        s.link.connected && s.link.frames > 200
    });
    until(
        "armed, or SAFE on a machine that stalls",
        vec![Command::Arm],
        &|s| s.mode == Mode::Hold || safe(s),
    );
    rig.unplugged.store(true, Ordering::Relaxed);
    let flagged_s = until("the loss is reported", vec![], &|s| !s.link.connected);
    until("SAFE", vec![], &safe);
    rig.unplugged.store(false, Ordering::Relaxed);
    let back_s = until("connected again", vec![], &|s| s.link.connected);
    assert!(flagged_s < 10.0 && back_s < 20.0, "{flagged_s} {back_s}");
    until("it stays SAFE until a reset", vec![Command::Arm], &safe);
    until("reset", vec![Command::Reset], &|s| s.mode == Mode::Disarmed);
}

#[test]
fn the_program_is_killed_while_it_moves_and_records() {
    let dir = scratch("realtime-killed");
    let mut ran = 0;
    for seed in 0..6 {
        let file = dir.join(format!("{seed}.rrd"));
        let k = killed::kill(&file, seed, Some("60,40,-300"), 1_000_000 + 50_000 * seed);
        println!(
            "lost {:.3} s of {} snapshots, pumps off after {:?} s",
            k.lost_s, k.snapshots, k.pumps_off_s
        );
        assert!(k.lost_s < 10.0, "{} s", k.lost_s);
        assert!(
            k.pumps_off_s.is_none_or(|s| s < 10.0),
            "{:?}",
            k.pumps_off_s
        );
        ran += usize::from(k.pumps_off_s.is_some());
    }
    assert!(ran > 0, "no pump ever ran");
}

/// Ticks never come early, and those that come late do not pile up.
#[test]
fn late_ticks_are_skipped_and_counted() {
    let start = now();
    let (mut runner, _world) = crate::lockstep::runner(crate::lockstep::World::new(None));
    let mut ticks_s = Vec::new();
    let pace = run_in_real_time(&mut runner, start, |snapshot, _, _| {
        ticks_s.push(snapshot.stamp.seconds());
        // Longer than two periods.
        if ticks_s.len() == 100 {
            std::thread::sleep(Duration::from_millis(55));
        }
        match ticks_s.len() {
            500 => ControlFlow::Break(()),
            _ => ControlFlow::Continue(()),
        }
    });
    let took_s = ticks_s[ticks_s.len() - 1] - ticks_s[0];
    let mut late_s: Vec<f64> = ticks_s
        .iter()
        .map(|t| (t - ticks_s[0]).rem_euclid(TICK_S))
        .collect();
    late_s.sort_by(f64::total_cmp);
    println!(
        "{pace:?} in {took_s:.2} s, late by {:.2} ms (median), {:.2} ms (p99)",
        late_s[250] * 1e3,
        late_s[495] * 1e3
    );
    assert!(pace.ticks == 500 && pace.missed >= 4, "{pace:?}");
    // Every period was either ticked or counted as missed.
    let periods = took_s / TICK_S;
    let counted = (pace.ticks - 1 + pace.missed) as f64;
    assert!((periods - counted).abs() <= 2.0, "{periods} {counted}");
}
