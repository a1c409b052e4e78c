//! The program is killed while it records: what is in the file, and what the rig does.

use std::collections::HashMap;
use std::fs::File;
use std::io::{Read as _, Write as _};
use std::os::fd::AsFd as _;
use std::path::{Path, PathBuf};
use std::process::Stdio;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use nix::fcntl::{FcntlArg, OFlag, fcntl};
use nix::pty::openpty;
use nix::sys::termios::{SetArg, cfmakeraw, tcgetattr, tcsetattr};
use springtwin::link::wire::{Body, Decoder, Received, pressure_code};
use springtwin::recording::{RecordingMeta, RecordingWriter, read_rrd};
use springtwin::rig::{RigOptions, VirtualRig};
use springtwin::robot::RobotSpec;
use springtwin::signal::{BOARDS, RawFrame, Stamp};
use springtwin::twin::TICK_S;

use crate::faults::{Bound, row};
use crate::lockstep::{World, runner};
use crate::process::{Running, program, until};
use crate::program::{json, scratch};

/// A second of a recording is so long, about, bytes.
const SECOND_BYTES: u64 = 240_000;

/// What a board said in a sample: its number, counts, gates and pressures.
type Words = (usize, [u16; 6], [u16; 6], [u16; 3]);

/// What the rig did.
#[derive(Default)]
struct Log {
    /// When each sample was said for the first time, s.
    said_s: HashMap<Words, Vec<f64>>,
    pumps_on: bool,
    /// When the pumps went off last, s.
    off_s: f64,
}

/// A rig in this process on a pseudo-terminal, in real time.
struct Rig {
    port: PathBuf,
    start: Instant,
    log: Arc<Mutex<Log>>,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Rig {
    fn start(seed: u64) -> Self {
        let pair = openpty(None, None).expect("a pseudo-terminal");
        let mut modes = tcgetattr(&pair.slave).expect("modes");
        cfmakeraw(&mut modes);
        tcsetattr(&pair.slave, SetArg::TCSANOW, &modes).expect("raw");
        let flags = fcntl(pair.master.as_fd(), FcntlArg::F_GETFL).expect("flags");
        let flags = OFlag::from_bits_truncate(flags) | OFlag::O_NONBLOCK;
        fcntl(pair.master.as_fd(), FcntlArg::F_SETFL(flags)).expect("non-blocking");
        let port = nix::unistd::ttyname(&pair.slave).expect("a name");
        let options = RigOptions {
            seed,
            ..RigOptions::default()
        };
        let mut rig = VirtualRig::new(&RobotSpec::reference(), &options).expect("settles");
        let log = Arc::new(Mutex::new(Log::default()));
        let stop = Arc::new(AtomicBool::new(false));
        #[expect(clippy::disallowed_methods, reason = "the rig keeps real time")]
        let start = Instant::now();
        let (noted, over) = (Arc::clone(&log), Arc::clone(&stop));
        let work = move || {
            let (mut master, _slave) = (File::from(pair.master), pair.slave);
            let (mut decoder, mut outbox, mut inbox) = (Decoder::default(), Vec::new(), [0; 4096]);
            while !over.load(Ordering::Relaxed) {
                let n = master.read(&mut inbox).unwrap_or(0);
                let t_s = start.elapsed().as_secs_f64();
                let bytes = rig.advance(t_s, &inbox[..n]);
                note(&noted, t_s, &bytes, &mut decoder, &rig);
                outbox.extend(bytes);
                let taken = master.write(&outbox).unwrap_or(0);
                outbox.drain(..taken);
                if outbox.len() > 8192 {
                    outbox.clear();
                }
                std::thread::sleep(Duration::from_millis(1));
            }
        };
        let thread = std::thread::Builder::new().name("test rig".to_owned());
        Self {
            port,
            start,
            log,
            stop,
            thread: Some(thread.spawn(work).expect("a thread")),
        }
    }

    fn t_s(&self) -> f64 {
        self.start.elapsed().as_secs_f64()
    }
}

impl Drop for Rig {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            thread.join().expect("the rig does not panic");
        }
    }
}

fn note(log: &Mutex<Log>, t_s: f64, bytes: &[u8], decoder: &mut Decoder, rig: &VirtualRig) {
    let mut log = log.lock().expect("nobody panics");
    for byte in bytes {
        let Some(Received::Packet(packet)) = decoder.push(*byte) else {
            continue;
        };
        if let Body::Sample(s) = packet.body {
            let b = usize::from(packet.board);
            let words = (
                b,
                std::array::from_fn(|k| s.spring_counts[6 * b + k]),
                std::array::from_fn(|k| s.spring_gate_ticks[6 * b + k]),
                std::array::from_fn(|k| s.pressure[3 * b + k]),
            );
            log.said_s.entry(words).or_default().push(t_s);
        }
    }
    let on = rig.set_pa().iter().any(Option::is_some);
    if log.pumps_on && !on {
        log.off_s = t_s;
    }
    log.pumps_on = on;
}

/// A recorded frame in a board's words.
fn words_of(raw: &RawFrame, b: usize) -> Words {
    let code = |v: u32| u16::try_from(v).expect("16 bits on the line");
    (
        b,
        std::array::from_fn(|k| code(raw.spring_counts[6 * b + k])),
        std::array::from_fn(|k| code(raw.spring_gate_ticks[6 * b + k])),
        std::array::from_fn(|k| pressure_code(raw.chamber_pa[3 * b + k])),
    )
}

/// What came of one kill.
pub struct Killed {
    /// From the newest sample in the file to the kill, s.
    pub lost_s: f64,
    /// From the kill until the pumps were off, s; `None` when they had not run.
    pub pumps_off_s: Option<f64>,
    pub snapshots: usize,
}

/// Lets the program record so many bytes, steering to a target if one is given, and kills it. What it leaves is whole
/// to its last record, and everything in it was said by the rig.
pub fn kill(file: &Path, seed: u64, target: Option<&str>, bytes: u64) -> Killed {
    let _ = std::fs::remove_file(file);
    let rig = Rig::start(seed);
    let mut run = program(&["run", "--headless", "--seconds", "300"]);
    run.arg("--accept-simulated-boards");
    // Boards that are only watched may stay SAFE: on a busy machine they hear too few heartbeats.
    run.args(
        target
            .iter()
            .flat_map(|t| ["--reset", "booted", "--target", *t]),
    )
    .args(["--rig".as_ref(), rig.port.as_os_str()])
    .args(["--record".as_ref(), file.as_os_str()])
    .stdout(Stdio::null())
    .stderr(Stdio::null());
    let mut program = Running::start(&mut run);
    until("it records", || {
        assert!(!program.has_ended(), "ended before it could be killed");
        std::fs::metadata(file).map_or(0, |m| m.len()) >= bytes
    });
    let pumps_ran = rig.log.lock().expect("nobody panics").pumps_on;
    let killed_s = rig.t_s();
    // SIGKILL.
    program.kill();
    let pumps_off_s = pumps_ran.then(|| {
        let log = || rig.log.lock().expect("nobody panics");
        until("the pumps go off", || !log().pumps_on);
        log().off_s - killed_s
    });
    let told = json(&["inspect", file.to_str().expect("utf-8"), "--json"]);
    assert_eq!(told["complete"], false, "{told}");
    let read = read_rrd(file).expect("it opens");
    let snapshots = &read.trace.snapshots;
    assert_eq!(told["samples"], snapshots.len(), "{told}");
    assert_eq!(read.recovered_until, snapshots.last().map(|s| s.stamp));
    let stamps: Vec<f64> = snapshots.iter().map(|s| s.stamp.seconds()).collect();
    assert!(stamps.windows(2).all(|w| w[0] < w[1]), "time rises");
    // Nothing is invented: everything in the file was said by the rig, and in that order.
    let log = rig.log.lock().expect("nobody panics");
    let mut newest_s = [0.0; BOARDS];
    let mut last_seq = None;
    for raw in snapshots.iter().filter_map(|s| s.raw.as_ref()) {
        assert!(last_seq <= Some(raw.seq), "frames in order");
        last_seq = Some(raw.seq);
        for (b, newest) in newest_s.iter_mut().enumerate() {
            if (6 * b..6 * b + 6).all(|i| raw.has_spring(i)) {
                let words = words_of(raw, b);
                // Gates are whole ticks and counts vary by a few: the same words can come twice.
                let all_s = log.said_s.get(&words).expect("the rig sent it");
                let sent_s = all_s.iter().find(|t_s| *t_s >= newest);
                *newest = *sent_s.expect("sent no earlier than the frame before");
            }
        }
    }
    assert!(newest_s.iter().all(|t_s| *t_s > 0.0), "nothing of the rig");
    Killed {
        lost_s: killed_s - newest_s[0].max(newest_s[1]),
        pumps_off_s,
        snapshots: snapshots.len(),
    }
}

#[test]
fn a_program_that_is_killed_leaves_whole_records_of_what_the_rig_said() {
    let dir = scratch("killed-program");
    let mut snapshots = Vec::new();
    for seed in 0..4 {
        let file = dir.join(format!("{seed}.rrd"));
        let bytes = SECOND_BYTES * (1 + seed);
        snapshots.push(kill(&file, seed, None, bytes).snapshots);
    }
    println!("{snapshots:?} snapshots");
    assert!(snapshots.iter().all(|n| *n > 50), "{snapshots:?}");
    row(
        (14, 2),
        "SIGKILL while recording",
        "the file opens to its last whole record",
        &[],
        &format!("all {}, every record as the rig sent it", snapshots.len()),
    );
}

/// What a kill leaves is what was written: the file is looked at every 0.07 s of a session.
#[test]
fn a_recording_holds_all_but_its_last_second_at_every_moment() {
    let dir = scratch("killed-writer");
    let (file, copy) = (dir.join("session.rrd"), dir.join("copy.rrd"));
    let (mut runner, _world) = runner(World::new(None));
    let mut writer = RecordingWriter::create(&file, RecordingMeta::default()).expect("a file");
    let (mut worst_s, mut looks) = (0.0f64, 0);
    for n in 1..=600u64 {
        let now = Stamp::from_seconds(n as f64 * TICK_S);
        let (snapshot, _) = runner.tick(now, &[]);
        writer.push(&snapshot).expect("there is space");
        // Before anything is in the file there is nothing to open.
        if n < 100 || !n.is_multiple_of(7) {
            continue;
        }
        std::fs::copy(&file, &copy).expect("a copy");
        let until = read_rrd(&copy).expect("it opens").recovered_until;
        let lost_s = now.since(until.expect("records"));
        worst_s = worst_s.max(lost_s);
        looks += 1;
    }
    writer.finish().expect("it ends");
    row(
        (14, 1),
        "SIGKILL while recording",
        "<= 1 s lost",
        &[Bound::time("lost at most", worst_s, 1.0)],
        &format!("looked at {looks} moments of a recording"),
    );
}
