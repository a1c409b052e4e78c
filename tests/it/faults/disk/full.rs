//! Disks that are full or read-only, folders and files that vanish while something is recorded.

use std::io::{Read as _, Write as _};
use std::os::unix::fs::OpenOptionsExt as _;
use std::path::{Path, PathBuf};
use std::process::{Command as Process, Stdio};
use std::sync::mpsc::sync_channel;

use nix::fcntl::OFlag;
use nix::sys::stat::Mode as FileMode;
use springtwin::recording::{read_rrd, write_text};
use springtwin::signal::{Goal, Mode, Stamp};
use springtwin::twin::{Command, Event, Runner, TICK_S};

use crate::faults::row;
use crate::lockstep::{World, runner};
use crate::process::{PATIENCE, Running, until};
use crate::program::{scratch, springtwin};

/// Space left for a recording, KiB: some seconds.
const SPACE_KIB: u64 = 1600;
/// When the recording is begun, s, for how long the arm goes on once it has failed, s, and when it must have, s.
const BEGIN_S: f64 = 3.0;
const AFTER_S: f64 = 8.0;
const FAILS_S: f64 = 300.0;

/// A small disk of its own, seen by this test only. It goes with the shell that holds it.
struct SmallDisk {
    shell: Running,
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
            let mut shell = Process::new("unshare");
            shell
                .args([how, "sh", "-c", &script])
                .stdin(Stdio::piped())
                .stdout(Stdio::piped())
                .stderr(Stdio::null());
            let mut shell = Running::start(&mut shell);
            let said = shell.word();
            let path = PathBuf::from(format!("/proc/{}/root{}", shell.id(), inside.display()));
            let disk = Self {
                shell,
                inside: inside.clone(),
                path,
            };
            if said == "ready" && disk.path.is_dir() {
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
        self.shell
            .order(&format!("{command} '{}'", self.inside.display()));
        until(command, || done(&self.path));
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

/// Observations of a run with a recording that fails.
#[derive(Default)]
struct Run {
    ticks: u64,
    warned_s: Vec<f64>,
    failed: Vec<(f64, String)>,
    refused: Vec<String>,
    /// Whether the arm moved after the recording had failed.
    moved_on: bool,
    last_mode: Mode,
}

/// A tick of simulated time, and a nap of real time for the recorder's thread.
fn tick(runner: &mut Runner, n: u64, commands: &[Command]) -> (Mode, Vec<Event>) {
    let now = Stamp::from_seconds(n as f64 * TICK_S);
    let (snapshot, events) = runner.tick(now, commands);
    std::thread::sleep(std::time::Duration::from_millis(1));
    (snapshot.mode.clone(), events)
}

/// Drives the arm on simulated time and records to `path`, until some seconds after the recording has failed.
fn record_and_move(path: &Path) -> Run {
    let (mut runner, _world) = runner(World::new(None));
    let mut run = Run::default();
    let goals = [[0.06, 0.04, -0.30], [-0.05, 0.03, -0.31]];
    let mut commands = Vec::new();
    let end_s = |run: &Run| run.failed.first().map_or(FAILS_S, |(t_s, _)| t_s + AFTER_S);
    while (run.ticks as f64) * TICK_S < end_s(&run) {
        run.ticks += 1;
        let n = run.ticks;
        let (mode, events) = tick(&mut runner, n, &std::mem::take(&mut commands));
        for event in events {
            match event {
                Event::Warning { text, .. } if text.contains("1 GiB") => {
                    run.warned_s.push(n as f64 * TICK_S);
                }
                Event::RecordingFailed { reason, .. } => {
                    run.failed.push((n as f64 * TICK_S, reason));
                }
                Event::Refused { reason, .. } => run.refused.push(reason),
                _ => {}
            }
        }
        match n {
            200 => commands.push(Command::Arm),
            n if n >= 250 && n.is_multiple_of(500) => {
                let goal = goals[n as usize / 500 % 2];
                commands.push(Command::Goto(Goal::position(goal)));
            }
            n if n == (BEGIN_S / TICK_S) as u64 => {
                commands.push(Command::StartRecording(path.to_owned()));
            }
            _ => {}
        }
        run.moved_on |= !run.failed.is_empty() && mode == Mode::Moving;
        run.last_mode = mode;
    }
    run
}

#[test]
fn a_full_disk_ends_the_recording_and_nothing_else() {
    let Some(disk) = SmallDisk::new("small-disk", 8 << 10) else {
        return;
    };
    let other = disk.path.join("other.bin");
    let text: Vec<u8> = (0..300_000u32).map(|i| (i % 251) as u8).collect();
    std::fs::write(&other, &text).expect("there is space");
    let file = disk.path.join("full.rrd");
    disk.fill(SPACE_KIB);
    let run = record_and_move(&file);
    assert_eq!(run.refused, [""; 0]);
    assert!(
        !matches!(run.last_mode, Mode::Safe(_)) && run.moved_on,
        "{:?}",
        run.last_mode
    );
    let [(failed_s, reason)] = &run.failed[..] else {
        panic!("one report to the operator: {:?}", run.failed);
    };
    println!("{failed_s:.2} s: {reason}");
    assert!(
        reason.contains("full.rrd") && reason.contains("No space left"),
        "{reason}"
    );
    let is_early = matches!(&run.warned_s[..], [warned_s] if warned_s < failed_s);
    assert!(is_early, "low space is reported once: {:?}", run.warned_s);
    let read = read_rrd(&file).expect("it opens");
    let recorded = read.trace.snapshots.len();
    assert!(!read.complete && recorded > 100, "{recorded} snapshots");
    let last = read.trace.snapshots.last().map(|s| s.stamp);
    assert_eq!(read.recovered_until, last);
    assert_eq!(std::fs::read(&other).expect("still there"), text);
    let fault = "disk full while recording";
    row(
        (13, 1),
        fault,
        "warn below 1 GiB",
        &[],
        "reported once, before it is full",
    );
    row(
        (13, 2),
        fault,
        "recording stops cleanly",
        &[],
        &format!(
            "reported once; opens to its last whole record ({recorded} snapshots); other files as they were; the arm goes \
             to its next targets"
        ),
    );
    // What is kept in small files on the same disk keeps its last good version.
    let calibration = include_str!("../../../../assets/calibration/virtual-rig.toml");
    let kept = disk.path.join("kept.toml");
    std::fs::remove_file(disk.path.join("filler")).expect("removed");
    write_text(&kept, calibration).expect("there is space");
    disk.fill(0);
    let error = write_text(&kept, &calibration.repeat(40)).expect_err("there is no space");
    println!("{error}");
    assert!(error.to_string().contains("kept.toml"), "{error}");
    assert_eq!(std::fs::read_to_string(&kept).expect("kept"), calibration);
    assert!(!disk.path.join("kept.toml.part").exists());
}

/// A pipe stands for the disk: it takes nothing while nobody reads it. Were a tick to wait for it, the ticks would
/// never end.
#[test]
fn a_disk_that_takes_nothing_delays_no_tick() {
    const TICKS: u64 = 1500;
    let path = scratch("stuck-disk").join("pipe.rrd");
    nix::unistd::mkfifo(&path, FileMode::S_IRUSR | FileMode::S_IWUSR).expect("a pipe");
    let (tell, told) = sync_channel(1);
    let (go_on, released) = sync_channel::<()>(1);
    let file = path.clone();
    let ticking = move || {
        let (mut runner, _world) = runner(World::new(None));
        let start = [Command::StartRecording(file)];
        for n in 1..=TICKS {
            tick(&mut runner, n, if n == 100 { &start } else { &[] });
        }
        tell.send(TICKS).expect("the test waits");
        // The end waits for the disk.
        released.recv().expect("the test goes on");
    };
    let thread = std::thread::Builder::new().name("ticks".to_owned());
    let thread = thread.spawn(ticking).expect("a thread");
    // Opened, so that the recording begins; more than a pipe holds is never read.
    let mut disk = std::fs::OpenOptions::new()
        .read(true)
        .custom_flags(OFlag::O_NONBLOCK.bits())
        .open(&path)
        .expect("the pipe");
    let mut some = [0; 4096];
    let mut reads = move || disk.read(&mut some).is_ok_and(|n| n > 0);
    until("the recording begins", &mut reads);
    let ticks = told.recv_timeout(PATIENCE).expect("no tick waits");
    assert_eq!(ticks, TICKS);
    row(
        (13, 3),
        "disk takes nothing while recording",
        "control unchanged",
        &[],
        &format!("{ticks} of {TICKS} ticks ran meanwhile"),
    );
    go_on.send(()).expect("the ticks have ended");
    until("the recording ends", || {
        while reads() {}
        thread.is_finished()
    });
    thread.join().expect("it ends in peace");
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

/// Ticks of a recording to a file that vanishes.
const TICKS: u64 = 600;

/// Records on simulated time and lets `happen` act after two seconds of it; the events of the recording.
fn while_recording(file: &Path, happen: impl Fn()) -> Vec<Event> {
    let (mut runner, _world) = runner(World::new(None));
    let mut told = Vec::new();
    let start = [Command::StartRecording(file.to_owned())];
    for n in 1..=TICKS {
        let (_, events) = tick(&mut runner, n, if n == 1 { &start } else { &[] });
        told.extend(events);
        if n == 200 {
            // The recorder keeps real time: the file is there, or is refused.
            let refused = |e: &Event| matches!(e, Event::Refused { .. });
            until("it records", || file.exists() || told.iter().any(refused));
            happen();
        }
    }
    runner.stop_recording(Stamp::from_seconds(6.0), &mut told);
    told.retain(|e| matches!(e, Event::RecordingFailed { .. } | Event::Refused { .. }));
    told
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
        let events = while_recording(&file, happen);
        let [Event::RecordingFailed { stamp, reason }] = &events[..] else {
            panic!("{case}: {events:?}");
        };
        println!("{case}: {:.2} s: {reason}", stamp.seconds());
        assert!(
            reason.contains("here.rrd") && reason.contains("under way"),
            "{reason}"
        );
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
    write_text(&kept, "good = 1\n").expect("there is space");
    disk.order("mount -o remount,ro", |d| {
        std::fs::write(d.join("x"), "x").is_err()
    });
    let file = disk.path.join("never.rrd");
    let events = while_recording(&file, || {});
    let [Event::Refused { reason, .. }] = &events[..] else {
        panic!("{events:?}");
    };
    println!("{reason}");
    assert!(
        reason.contains("never.rrd") && reason.contains("Read-only"),
        "{reason}"
    );
    write_text(&kept, "good = 2\n").expect_err("nothing can be written");
    assert_eq!(std::fs::read_to_string(&kept).expect("kept"), "good = 1\n");
}
