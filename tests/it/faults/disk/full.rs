//! Disks that are full or read-only, folders and files that vanish while something is recorded.

use std::io::{BufRead as _, BufReader, Write as _};
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, Command as Process, Stdio};

use springtwin::control::Gains;
use springtwin::learn::Model;
use springtwin::link::wire::Config;
use springtwin::recording::{read_rrd, write_text};
use springtwin::rig::{RigOptions, VirtualRig};
use springtwin::robot::RobotSpec;
use springtwin::sensing::{Calibration, Sensing};
use springtwin::signal::{ControllerKind, Goal, Mode, Stamp};
use springtwin::twin::{
    Command, Event, Heard, InProcess, Runner, TICK_S, Twin, run_in_real_time, run_in_simulated_time,
};

use super::{ATTEMPTS, Stalls, now, quantile};
use crate::faults::row;
use crate::program::{scratch, springtwin};

/// Room left for a recording, KiB: some seconds.
const ROOM_KIB: u64 = 1600;
/// When the recording is begun, s, and the end of the run.
const BEGIN_S: f64 = 3.0;
const END_S: f64 = 24.0;
/// A tick that begins this late is one that was missed, s.
const MISSED_S: f64 = 0.01;

/// A small disk of its own, seen by this test only. It goes with the shell that holds it.
struct SmallDisk {
    shell: Child,
    orders: Option<ChildStdin>,
    inside: PathBuf,
    path: PathBuf,
}

impl SmallDisk {
    /// Of `kib`; `None`, with a word, where the system lets nobody have one.
    fn new(name: &str, kib: u64) -> Option<Self> {
        let inside = scratch(name);
        let script = format!(
            "mount -t tmpfs -o size={kib}k none '{}' && echo ready && exec sh",
            inside.display()
        );
        for how in ["-m", "-rm"] {
            let Ok(mut shell) = Process::new("unshare")
                .args([how, "sh", "-c", &script])
                .stdin(Stdio::piped())
                .stdout(Stdio::piped())
                .stderr(Stdio::null())
                .spawn()
            else {
                continue;
            };
            let mut said = String::new();
            let out = shell.stdout.as_mut().expect("stdout");
            BufReader::new(out).read_line(&mut said).expect("text");
            let path = PathBuf::from(format!("/proc/{}/root{}", shell.id(), inside.display()));
            let disk = Self {
                orders: shell.stdin.take(),
                shell,
                inside: inside.clone(),
                path,
            };
            if said.trim() == "ready" && disk.path.is_dir() {
                return Some(disk);
            }
        }
        println!(
            "left out: {name}, because neither `unshare -m` nor `unshare -rm` gives a small disk"
        );
        None
    }

    /// Lets the shell that holds it run a command, given the disk's own path, and waits until `done`.
    fn order(&mut self, command: &str, done: impl Fn(&Path) -> bool) {
        let orders = self.orders.as_mut().expect("a shell");
        writeln!(orders, "{command} '{}'", self.inside.display()).expect("the shell listens");
        for _ in 0..1000 {
            if done(&self.path) {
                return;
            }
            std::thread::sleep(std::time::Duration::from_millis(5));
        }
        panic!("'{command}' does nothing");
    }

    /// Writes until nothing more goes in but `left_kib`.
    fn fill(&self, left_kib: u64) {
        let mut filler = std::fs::File::create(self.path.join("filler")).expect("a file");
        while filler.write_all(&[7; 1024]).is_ok() {}
        let length = filler.metadata().expect("its length").len();
        filler
            .set_len(length.saturating_sub(left_kib << 10))
            .expect("cut");
    }
}

impl Drop for SmallDisk {
    fn drop(&mut self) {
        let _ = self.shell.kill();
        let _ = self.shell.wait();
    }
}

fn runner() -> Runner {
    let robot = RobotSpec::reference();
    let network = include_bytes!("../../../../assets/networks/reference.safetensors");
    let calibration = include_str!("../../../../assets/calibration/virtual-rig.toml");
    let model = Model::from_bytes(network).expect("the shipped networks");
    let calibration = Calibration::from_toml(calibration).expect("the shipped calibration");
    let twin = Twin::new(
        &robot,
        model.into(),
        Sensing::new(&robot, calibration),
        Gains::of(ControllerKind::Ours),
    );
    let mut rig = VirtualRig::new(&robot, &RigOptions::default()).expect("settles");
    let far_end = move |t_s: f64, to_rig: &[u8]| Heard {
        bytes: Some(rig.advance(t_s, to_rig)),
        truth: None,
    };
    let port = InProcess::new("virtual rig", Config::built_in(), Box::new(far_end));
    Runner::new(twin, Box::new(port), &robot)
}

/// What a run in real time with a recording that fails tells.
struct Run {
    /// When each tick began, s.
    ticks_s: Vec<f64>,
    /// When the recording was known to run, when the operator was warned of little room, and when it failed, s.
    begun_s: Option<f64>,
    warned_s: Option<f64>,
    failed: Vec<(f64, String)>,
    refused: Vec<String>,
    last_mode: Mode,
}

/// Drives the arm and records to `path`; `meanwhile` is called with the time of every tick.
fn record_and_move(path: &Path, end_s: f64, mut meanwhile: impl FnMut(f64)) -> Run {
    let mut runner = runner();
    let start = now();
    let mut run = Run {
        ticks_s: Vec::with_capacity(10_000),
        begun_s: None,
        warned_s: None,
        failed: Vec::new(),
        refused: Vec::new(),
        last_mode: Mode::Disarmed,
    };
    let goals = [[0.06, 0.04, -0.30], [-0.05, 0.03, -0.31]];
    run_in_real_time(&mut runner, start, |snapshot, events, commands| {
        let t_s = snapshot.stamp.seconds();
        let n = run.ticks_s.len();
        run.ticks_s.push(t_s);
        for event in events {
            match event {
                Event::Recording { .. } => run.begun_s = run.begun_s.or(Some(t_s)),
                Event::Warning { text, .. } if text.contains("1 GiB") => run.warned_s = Some(t_s),
                Event::RecordingFailed { reason, .. } => run.failed.push((t_s, reason.clone())),
                Event::Refused { reason, .. } => run.refused.push(reason.clone()),
                _ => {}
            }
        }
        if n == 200 {
            commands.push(Command::Arm);
        }
        if n >= 250 && n.is_multiple_of(500) {
            let goal = goals[n / 500 % 2];
            commands.push(Command::Goto(Goal::position(goal)));
        }
        if n == (BEGIN_S / TICK_S) as usize {
            commands.push(Command::StartRecording(path.to_owned()));
        }
        meanwhile(t_s);
        run.last_mode = snapshot.mode.clone();
        match t_s >= end_s {
            true => ControlFlow::Break(()),
            false => ControlFlow::Continue(()),
        }
    });
    let mut last = Vec::new();
    runner.stop_recording(Stamp::from_seconds(end_s), &mut last);
    run
}

/// How late the ticks between two times began, sorted, s, and how many were missed.
fn lateness(ticks_s: &[f64], from_s: f64, to_s: f64) -> (Vec<f64>, u64) {
    let due = |t_s: f64| ((t_s - ticks_s[0]) / TICK_S + 0.5).floor() * TICK_S + ticks_s[0];
    let within: Vec<f64> = ticks_s
        .iter()
        .copied()
        .filter(|t| (from_s..to_s).contains(t))
        .collect();
    let mut late: Vec<f64> = within.iter().map(|t| t - due(*t)).collect();
    late.sort_by(f64::total_cmp);
    // The thread that is told to sleep never wakes early: the least late one was on time.
    let least_s = late.first().copied().unwrap_or(0.0);
    late.iter_mut().for_each(|l| *l -= least_s);
    let gaps = within.windows(2).map(|w| ((w[1] - w[0]) / TICK_S).round());
    (late, gaps.map(|g| (g as u64).saturating_sub(1)).sum())
}

#[test]
fn a_full_disk_ends_the_recording_and_nothing_else() {
    let Some(disk) = SmallDisk::new("small-disk", 8 << 10) else {
        return;
    };
    let other = disk.path.join("other.bin");
    let text: Vec<u8> = (0..300_000u32).map(|i| (i % 251) as u8).collect();
    std::fs::write(&other, &text).expect("there is room");
    let file = disk.path.join("full.rrd");
    for attempt in 1.. {
        let _ = std::fs::remove_file(&file);
        disk.fill(ROOM_KIB);
        let stalls = Stalls::watch();
        let run = record_and_move(&file, END_S, |_| {});
        let stalled_s = stalls.longest_s();
        assert_eq!(run.refused, [""; 0]);
        assert!(
            !matches!(run.last_mode, Mode::Safe(_)),
            "{:?}",
            run.last_mode
        );
        let [(failed_s, reason)] = &run.failed[..] else {
            panic!("the operator is told once: {:?}", run.failed);
        };
        println!("{failed_s:.2} s: {reason}");
        assert!(
            reason.contains("full.rrd") && reason.contains("No space left"),
            "{reason}"
        );
        let (begun_s, warned_s) = (run.begun_s.expect("begun"), run.warned_s.expect("warned"));
        let read = read_rrd(&file).expect("it opens");
        let recorded = read.trace.snapshots.len();
        assert!(!read.complete && recorded > 100, "{recorded} snapshots");
        let last_s = read.recovered_until.expect("a last record").seconds();
        assert_eq!(std::fs::read(&other).expect("still there"), text);
        let half_s = (END_S - failed_s).min(failed_s - begun_s) - 0.1;
        assert!(
            half_s > 3.0,
            "full after {failed_s} s is no time to compare"
        );
        let (before, missed_before) = lateness(&run.ticks_s, failed_s - half_s, *failed_s);
        let (after, missed_after) = lateness(&run.ticks_s, *failed_s, failed_s + half_s);
        // The ticks around the moment itself.
        let (around, _) = lateness(&run.ticks_s, failed_s - 1.5, failed_s + 0.5);
        let p99 = |late: &[f64]| quantile(late, 0.99) * 1e3;
        let worst_s = around.last().copied().unwrap_or(f64::NAN);
        let measured = format!(
            "missed {missed_before} before and {missed_after} after; late by {:.2} ms before and {:.2} ms after (p99), \
             {:.2} ms at most when it fills",
            p99(&before),
            p99(&after),
            worst_s * 1e3
        );
        println!("{measured}; the machine stalled for {stalled_s:.3} s at most");
        let unchanged = missed_after <= missed_before
            && p99(&after) <= p99(&before) + 2.0
            && worst_s < MISSED_S;
        if !unchanged && stalled_s > 0.005 && attempt < ATTEMPTS {
            continue;
        }
        assert!(unchanged, "{measured}");
        let lost_s = failed_s - last_s;
        assert!(
            warned_s - begun_s <= 0.05,
            "warned {:.3} s late",
            warned_s - begun_s
        );
        assert!(lost_s <= 2.0, "{lost_s:.2} s");
        let fault = "disk full while recording";
        row(
            (13, 1),
            fault,
            "warn below 1 GiB",
            &format!(
                "{:.0} ms after the recording began",
                (warned_s - begun_s) * 1e3
            ),
        );
        row(
            (13, 2),
            fault,
            "recording stops cleanly",
            &format!(
                "opens to its last whole record ({recorded} snapshots, {lost_s:.2} s before the end was told); other \
                 files as they were"
            ),
        );
        row((13, 3), fault, "control jitter unchanged", &measured);
        break;
    }
    // What is kept in small files on the same disk keeps its last good version.
    let calibration = include_str!("../../../../assets/calibration/virtual-rig.toml");
    let kept = disk.path.join("kept.toml");
    std::fs::remove_file(disk.path.join("filler")).expect("removed");
    write_text(&kept, calibration).expect("there is room");
    disk.fill(0);
    let error = write_text(&kept, &calibration.repeat(40)).expect_err("there is no room");
    println!("{error}");
    assert!(error.to_string().contains("kept.toml"), "{error}");
    assert_eq!(std::fs::read_to_string(&kept).expect("kept"), calibration);
    assert!(!disk.path.join("kept.toml.part").exists());
}

#[test]
fn a_headless_run_says_that_the_disk_was_full() {
    let Some(disk) = SmallDisk::new("small-disk-program", 1 << 10) else {
        return;
    };
    let file = disk.path.join("full.rrd");
    let name = file.to_str().expect("utf-8");
    let out = springtwin(&[
        "run",
        "--headless",
        "--seconds",
        "60",
        "--record",
        name,
        "--json",
    ]);
    let said = String::from_utf8_lossy(&out.stderr);
    let v: serde_json::Value =
        serde_json::from_slice(&out.stdout).expect("its report all the same");
    assert_eq!(out.status.code(), Some(1), "{said}");
    assert_eq!(v["ticks"], 6001, "{v}");
    let reason = v["recording_failed"].as_str().expect("why");
    assert!(
        reason.contains(name) && reason.contains("No space left"),
        "{reason}"
    );
    assert!(said.contains(&format!("error: {reason}")), "{said}");
    assert!(said.contains("Less than 1 GiB"), "{said}");
    assert!(!read_rrd(&file).expect("it opens").complete);
}

/// The arm comes to its goal all the same, and the program says what is missing.
#[test]
fn a_drive_says_that_the_disk_was_full() {
    let Some(disk) = SmallDisk::new("small-disk-drive", 400) else {
        return;
    };
    let file = disk.path.join("full.rrd");
    let name = file.to_str().expect("utf-8");
    let out = springtwin(&["goto", "20,10,-300", "--record", name, "--json"]);
    let said = String::from_utf8_lossy(&out.stderr);
    let v: serde_json::Value =
        serde_json::from_slice(&out.stdout).expect("its report all the same");
    assert_eq!(out.status.code(), Some(1), "{said}");
    assert_eq!(v["reached"], true, "{v}");
    let reason = v["recording_failed"].as_str().expect("why");
    assert!(
        reason.contains(name) && reason.contains("No space left"),
        "{reason}"
    );
    assert!(said.contains(&format!("error: {reason}")), "{said}");
}

/// Records on simulated time and lets `happen` act after two seconds of it; what was told, and how many ticks ran.
fn while_recording(file: &Path, happen: impl Fn()) -> (Vec<Event>, u64) {
    let mut runner = runner();
    let mut told = Vec::new();
    let mut n = 0;
    let pace = run_in_simulated_time(&mut runner, |_, events, commands| {
        told.extend(events.iter().cloned());
        n += 1;
        if n == 1 {
            commands.push(Command::StartRecording(file.to_owned()));
        }
        // The recorder keeps real time: it gets some.
        std::thread::sleep(std::time::Duration::from_millis(2));
        if n == 200 {
            happen();
        }
        match n {
            600 => ControlFlow::Break(()),
            _ => ControlFlow::Continue(()),
        }
    });
    runner.stop_recording(Stamp::from_seconds(6.0), &mut told);
    told.retain(|e| matches!(e, Event::RecordingFailed { .. } | Event::Refused { .. }));
    (told, pace.ticks)
}

#[test]
fn a_file_or_folder_that_vanishes_ends_the_recording_in_words() {
    let dir = scratch("vanishing");
    let file = dir.join("in/here.rrd");
    let folder = file.parent().expect("a folder");
    let remove_file = || std::fs::remove_file(&file).expect("removed");
    let remove_folder = || std::fs::remove_dir_all(folder).expect("removed");
    let replace = || {
        remove_file();
        std::fs::write(&file, "somebody else's").expect("written");
    };
    let cases: [(&str, &dyn Fn()); 3] = [
        ("file removed", &remove_file),
        ("folder removed", &remove_folder),
        ("file replaced", &replace),
    ];
    for (case, happen) in cases {
        std::fs::create_dir_all(folder).expect("made");
        let (told, ticks) = while_recording(&file, happen);
        let [Event::RecordingFailed { stamp, reason }] = &told[..] else {
            panic!("{case}: {told:?}");
        };
        println!("{case}: {:.2} s: {reason}", stamp.seconds());
        assert!(
            reason.contains("here.rrd") && reason.contains("under way"),
            "{reason}"
        );
        assert_eq!(ticks, 600);
        if case == "file replaced" {
            let text = std::fs::read_to_string(&file).expect("theirs");
            assert_eq!(text, "somebody else's");
        }
    }
}

#[test]
fn a_read_only_disk_refuses_a_recording_in_words() {
    let Some(mut disk) = SmallDisk::new("read-only-disk", 1 << 10) else {
        return;
    };
    let kept = disk.path.join("kept.toml");
    write_text(&kept, "good = 1\n").expect("there is room");
    disk.order("mount -o remount,ro", |d| {
        std::fs::write(d.join("x"), "x").is_err()
    });
    let file = disk.path.join("never.rrd");
    let (told, ticks) = while_recording(&file, || {});
    let [Event::Refused { reason, .. }] = &told[..] else {
        panic!("{told:?}");
    };
    println!("{reason}");
    assert!(
        reason.contains("never.rrd") && reason.contains("Read-only"),
        "{reason}"
    );
    assert_eq!(ticks, 600);
    write_text(&kept, "good = 2\n").expect_err("nothing can be written");
    assert_eq!(std::fs::read_to_string(&kept).expect("kept"), "good = 1\n");
}
