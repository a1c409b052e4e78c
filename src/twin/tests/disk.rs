//! Recordings on a disk that makes one wait: a named pipe, whose reader is the test.

use std::fs::File;
use std::io::Read as _;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::time::Duration;

use super::*;
use crate::recording::read_rrd;

/// Longer than anything here takes that does not wait for the disk.
const LONG: Duration = Duration::from_secs(60);

fn path(name: &str) -> PathBuf {
    std::env::temp_dir().join(format!("springtwin-{name}-{}.rrd", std::process::id()))
}

fn pipe(name: &str) -> PathBuf {
    let path = path(name);
    let _ = std::fs::remove_file(&path);
    nix::unistd::mkfifo(&path, nix::sys::stat::Mode::S_IRWXU).expect("a named pipe");
    path
}

/// A port that says when it is let go.
struct Reporting {
    frames: Frames,
    gone: SyncSender<()>,
}

impl Port for Reporting {
    fn clock(&self) -> Clock {
        self.frames.clock()
    }
    fn poll(&mut self, now: Stamp) -> Arrivals {
        self.frames.poll(now)
    }
    fn send(&mut self, _now: Stamp, _command: Option<&crate::signal::PressureCommand>) {}
    fn order(&mut self, _now: Stamp, _order: Order) {}
}

impl Drop for Reporting {
    fn drop(&mut self) {
        let _ = self.gone.try_send(());
    }
}

/// A twin that ticks on a thread of its own as fast as it goes, so that one that waits shows.
struct Bench {
    orders: SyncSender<(u32, Vec<Command>)>,
    done: Receiver<Vec<Event>>,
}

impl Bench {
    fn new() -> Self {
        let (orders, todo) = sync_channel::<(u32, Vec<Command>)>(1);
        let (report, done) = sync_channel(1);
        let work = move || {
            let mut runner = Runner::new(twin(), Box::new(Frames(0)), &RobotSpec::reference());
            let mut k = 0;
            while let Ok((n, mut commands)) = todo.recv() {
                let mut events = Vec::new();
                for _ in 0..n {
                    k += 1;
                    events.extend(runner.tick(at(k), &std::mem::take(&mut commands)).1);
                }
                report.send(events).expect("the test listens");
            }
        };
        let thread = std::thread::Builder::new().name("test twin".to_owned());
        thread.spawn(work).expect("a thread");
        Self { orders, done }
    }

    /// `n` ticks, the first with `commands`; what was reported.
    fn ticks(&self, n: u32, commands: &[Command]) -> Vec<String> {
        let order = (n, commands.to_vec());
        self.orders.send(order).expect("the twin lives");
        let events = self.done.recv_timeout(LONG).expect("a tick waits");
        events
            .iter()
            .filter(|e| {
                matches!(
                    e,
                    Event::Recording { .. } | Event::RecordingFailed { .. } | Event::Refused { .. }
                )
            })
            .map(Event::text)
            .collect()
    }

    /// Ticks until something is reported.
    fn until_reported(&self) -> Vec<String> {
        for _ in 0..6000 {
            let said = self.ticks(1, &[]);
            if !said.is_empty() {
                return said;
            }
            std::thread::sleep(Duration::from_millis(10));
        }
        panic!("nothing is reported");
    }
}

#[test]
fn a_slow_disk_delays_no_tick() {
    let path = pipe("slow-disk");
    let bench = Bench::new();
    // Nobody reads: the file cannot even be opened.
    let start = [Command::StartRecording(path.clone())];
    assert_eq!(bench.ticks(100, &start), [""; 0]);
    // Somebody does, until it has begun.
    let mut disk = File::open(&path).expect("the pipe");
    let mut bytes = Vec::new();
    let said = loop {
        let mut some = [0; 4096];
        let n = disk.read(&mut some).expect("what was recorded");
        bytes.extend_from_slice(&some[..n]);
        let said = bench.ticks(1, &[]);
        if !said.is_empty() {
            break said;
        }
    };
    assert_eq!(said, [format!("Recording to {}.", path.display())]);
    // From now on the disk takes nothing: the pipe is full long before seven seconds are in it.
    assert_eq!(bench.ticks(700, &[]), [""; 0]);
    assert_eq!(bench.ticks(1, &[Command::StopRecording]), [""; 0]);
    std::thread::sleep(Duration::from_millis(500));
    assert_eq!(bench.ticks(100, &[]), [""; 0]);
    let again = bench.ticks(1, &start);
    assert!(again[0].contains("still being written"), "{again:?}");
    // The disk goes on, and what became of the recording is reported.
    disk.read_to_end(&mut bytes).expect("what was recorded");
    let said = bench.until_reported();
    assert!(said[0].starts_with("Recorded"), "{said:?}");
    std::fs::remove_file(&path).expect("removed");
    std::fs::write(&path, bytes).expect("written");
    let read = read_rrd(&path).expect("a recording");
    std::fs::remove_file(&path).expect("removed");
    assert!(read.complete);
    assert!(read.trace.snapshots.len() > 100, "{said:?}");
}

#[test]
fn a_recording_that_cannot_begin_is_refused_and_another_can() {
    let bench = Bench::new();
    let nowhere = Path::new("/springtwin/no/such/folder/x.rrd").to_owned();
    let mut said = bench.ticks(1, &[Command::StartRecording(nowhere)]);
    if said.is_empty() {
        said = bench.until_reported();
    }
    assert!(said[0].contains("cannot create"), "{said:?}");
    let path = path("second-try");
    let mut said = bench.ticks(1, &[Command::StartRecording(path.clone())]);
    if said.is_empty() {
        said = bench.until_reported();
    }
    assert!(said[0].starts_with("Recording to"), "{said:?}");
    bench.ticks(1, &[Command::StopRecording]);
    bench.until_reported();
    std::fs::remove_file(&path).expect("removed");
}

/// A twin as the window has it.
fn running(port: Box<dyn Port>) -> (Handle, std::thread::JoinHandle<()>) {
    let runner = Runner::new(twin(), port, &RobotSpec::reference());
    #[expect(
        clippy::disallowed_methods,
        reason = "the twin's thread keeps real time"
    )]
    let start = std::time::Instant::now();
    spawn(runner, start, Vec::new(), |_| {}).expect("a thread")
}

fn wait_until(what: &str, mut is: impl FnMut() -> bool) {
    for _ in 0..6000 {
        if is() {
            return;
        }
        std::thread::sleep(Duration::from_millis(10));
    }
    panic!("{what}");
}

#[test]
fn a_window_that_closes_leaves_a_whole_recording() {
    let path = path("closing");
    let (handle, thread) = running(Box::new(Frames(0)));
    let start = Command::StartRecording(path.clone());
    handle.send(start).expect("room");
    wait_until("it records", || handle.snapshot().recording.is_some());
    std::thread::sleep(Duration::from_millis(300));
    let last = handle.snapshot().stamp;
    drop(handle);
    thread.join().expect("it ends in peace");
    let read = read_rrd(&path).expect("a recording");
    std::fs::remove_file(&path).expect("removed");
    assert!(read.complete, "cut off at {:?}", read.recovered_until);
    assert!(read.trace.snapshots.iter().any(|s| s.stamp == last));
}

#[test]
fn the_port_is_let_go_before_the_disk_is_waited_for() {
    let path = pipe("port-first");
    let (gone, is_gone) = sync_channel(1);
    let frames = Frames(0);
    let (handle, thread) = running(Box::new(Reporting { frames, gone }));
    let start = Command::StartRecording(path.clone());
    handle.send(start).expect("room");
    wait_until("it records", || handle.snapshot().recording.is_some());
    drop(handle);
    is_gone.recv_timeout(LONG).expect("the port is free");
    assert!(!thread.is_finished(), "the disk was not waited for");
    let mut disk = File::open(&path).expect("the pipe");
    disk.read_to_end(&mut Vec::new()).expect("the recording");
    thread.join().expect("it ends in peace");
    std::fs::remove_file(&path).expect("removed");
}

/// A port whose frames all arrive when it is asked: as many as have been sampled since.
struct Lumped {
    sent: u32,
}

impl Port for Lumped {
    fn clock(&self) -> Clock {
        Clock::Host
    }
    fn poll(&mut self, now: Stamp) -> Arrivals {
        let due = (now.seconds() * 100.0).round() as u32;
        let frames = (self.sent + 1..=due).map(frame).collect();
        let truths = (2 * self.sent + 1..=2 * due).map(pose_of).collect();
        self.sent = due;
        Arrivals {
            status: LinkStatus {
                connected: true,
                ..LinkStatus::default()
            },
            frames,
            truths,
            ..Arrivals::default()
        }
    }
    fn send(&mut self, _now: Stamp, _command: Option<&crate::signal::PressureCommand>) {}
    fn order(&mut self, _now: Stamp, _order: Order) {}
}

/// The n-th pose of motion capture at 200 Hz.
fn pose_of(n: u32) -> crate::signal::GroundTruth {
    crate::signal::GroundTruth {
        stamp: Stamp::from_seconds(0.005 * f64::from(n)),
        base_from_tip: crate::signal::Pose::translation(0.0, 0.0, -0.3 + 1e-6 * f64::from(n)),
        source: crate::signal::TruthSource::Vicon,
    }
}

/// Ticks that come 200 ms late swallow no frame and no pose of motion capture of a recording.
#[test]
fn a_late_tick_records_every_frame_that_waited() {
    let path = path("late");
    let mut runner = Runner::new(
        twin(),
        Box::new(Lumped { sent: 0 }),
        &RobotSpec::reference(),
    );
    let mut commands = vec![Command::StartRecording(path.clone())];
    for k in (1..50).chain([70, 71, 72, 92, 93]) {
        runner.tick(at(k), &std::mem::take(&mut commands));
    }
    runner.stop_recording(at(94), &mut Vec::new());
    let snapshots = read_rrd(&path).expect("reads").trace.snapshots;
    assert!(snapshots.windows(2).all(|w| w[0].stamp < w[1].stamp));
    let raws = snapshots.iter().filter_map(|s| s.raw.as_ref());
    let mut seq: Vec<u32> = raws.map(|raw| raw.seq).collect();
    seq.dedup();
    // The recording begins with the first tick.
    let first = frame(1).seq;
    assert_eq!(seq, (first..first + 93).collect::<Vec<_>>());
    let truths = snapshots.iter().filter_map(|s| s.truth.as_ref());
    let mut stamps: Vec<Stamp> = truths.map(|t| t.stamp).collect();
    stamps.dedup();
    let expected: Vec<Stamp> = (2..=2 * 93).map(|n| pose_of(n).stamp).collect();
    assert_eq!(stamps, expected);
    // And so does a session that is made of it.
    let log = crate::recording::read_log(&path).expect("reads");
    assert!(log.len() >= 92, "{}", log.len());
    std::fs::remove_file(path).expect("is there");
}

#[test]
fn marks_and_the_note_are_in_the_recording_and_refused_without_one() {
    let path = path("marks");
    let bench = Bench::new();
    let mark = || Command::Mark("valve clicks".to_owned());
    let refused = bench.ticks(1, &[mark(), Command::Note("none".to_owned())]);
    assert!(refused[0].contains("mark is not kept") && refused[1].contains("note is not kept"));
    let note = Command::Note("new central tube".to_owned());
    bench.ticks(20, &[Command::StartRecording(path.clone()), note]);
    let marked = bench.ticks(20, &[mark(), Command::Mark(String::new())]);
    let marked: Vec<&String> = marked.iter().filter(|t| t.starts_with("Marked")).collect();
    assert!(marked[0].ends_with("s: valve clicks") && marked[1].ends_with("s: Mark"));
    let mut ended = bench.ticks(1, &[Command::StopRecording]);
    while !ended.iter().any(|t| t.starts_with("Recorded")) {
        ended = bench.until_reported();
    }
    let found = crate::recording::annotations(&path).expect("a recording");
    std::fs::remove_file(&path).expect("removed");
    assert_eq!(found.note, "new central tube");
    let texts: Vec<&str> = found.marks.iter().map(|m| m.text.as_str()).collect();
    assert_eq!(texts, ["valve clicks", "Mark"]);
    // What the marks report is not in the log of the recording besides.
    assert!(found.marks[0].stamp > Stamp::ZERO);
}
