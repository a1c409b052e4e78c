//! The program is killed while it records: what is in the file, and what the rig does.

use std::collections::HashMap;
use std::fs::File;
use std::io::{Read as _, Write as _};
use std::os::fd::AsFd as _;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use nix::fcntl::{FcntlArg, OFlag, fcntl};
use nix::pty::openpty;
use nix::sys::termios::{SetArg, cfmakeraw, tcgetattr, tcsetattr};
use rand::{Rng as _, SeedableRng as _};
use rand_pcg::Pcg64Mcg;
use springtwin::link::wire::{Body, Decoder, Received, pressure_code};
use springtwin::recording::read_rrd;
use springtwin::rig::{RigOptions, VirtualRig};
use springtwin::robot::RobotSpec;
use springtwin::signal::{BOARDS, RawFrame};

use super::{ATTEMPTS, Stalls, now, quantile};
use crate::faults::row;
use crate::program::{json, scratch};

/// Kills in the normal run, and the variable that asks for more.
const KILLS: usize = 12;
const KILLS_WANTED: &str = "SPRINGTWIN_KILLS";
/// Programs side by side.
const LANES: usize = 2;
const SEED: u64 = 14;
/// Moments after the pumps have begun to run, s.
const MOMENTS_S: std::ops::Range<f64> = 0.0..2.5;
/// A machine that lets a thread that only sleeps a millisecond wait this long has stalled, s.
const STALLED_S: f64 = 0.02;

/// What a board said in a sample: its number, counts, gates and pressures.
type Words = (usize, [u16; 6], [u16; 6], [u16; 3]);

/// What the rig did.
#[derive(Default)]
struct Log {
    /// When each sample was said for the first time, s.
    said_s: HashMap<Words, f64>,
    pumps_on: bool,
    /// When the pumps went off last, s.
    off_s: f64,
}

/// A rig in this process on a pseudo-terminal.
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
        let start = now();
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
            log.said_s.entry(words).or_insert(t_s);
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
struct Killed {
    lost_s: f64,
    /// `None` when the pumps had not run yet.
    pumps_off_s: Option<f64>,
    opened_s: f64,
    snapshots: usize,
}

struct Program(Child);

impl Drop for Program {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Why the program ended before it was killed, or what the kill led to.
fn kill_once(file: &Path, seed: u64, moment_s: f64) -> Result<Killed, String> {
    let _ = std::fs::remove_file(file);
    let rig = Rig::start(seed);
    let said = file.with_extension("txt");
    let mut program = Program(
        Command::new(env!("CARGO_BIN_EXE_springtwin"))
            .args([
                "run",
                "--headless",
                "--seconds",
                "60",
                "--reset",
                "--target",
                "60,40,-300",
            ])
            .args(["--rig".as_ref(), rig.port.as_os_str()])
            .args(["--record".as_ref(), file.as_os_str()])
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(File::create(&said).expect("a file"))
            .spawn()
            .expect("the program starts"),
    );
    let begun_s = rig.t_s();
    let runs = || file.exists() && rig.log.lock().expect("nobody panics").pumps_on;
    let mut ended = || !matches!(program.0.try_wait(), Ok(None));
    while !runs() && rig.t_s() < begun_s + 30.0 && !ended() {
        std::thread::sleep(Duration::from_millis(2));
    }
    std::thread::sleep(Duration::from_secs_f64(moment_s));
    if program.0.try_wait().expect("a state").is_some() {
        return Err(std::fs::read_to_string(said).expect("its words"));
    }
    let pumps_ran = rig.log.lock().expect("nobody panics").pumps_on;
    let killed_s = rig.t_s();
    // SIGKILL.
    program.0.kill().expect("killed");
    program.0.wait().expect("gone");
    let pumps_off_s = pumps_ran.then(|| {
        for _ in 0..2000 {
            let log = rig.log.lock().expect("nobody panics");
            if !log.pumps_on {
                return log.off_s - killed_s;
            }
            drop(log);
            std::thread::sleep(Duration::from_millis(1));
        }
        panic!("the pumps run two seconds after the program was killed");
    });
    let opening = now();
    let told = json(&["inspect", file.to_str().expect("utf-8"), "--json"]);
    let opened_s = opening.elapsed().as_secs_f64();
    assert_eq!(told["complete"], false, "{told}");
    let read = read_rrd(file).expect("it opens");
    let snapshots = &read.trace.snapshots;
    assert_eq!(told["samples"], snapshots.len(), "{told}");
    assert_eq!(read.recovered_until, snapshots.last().map(|s| s.stamp));
    let stamps: Vec<f64> = snapshots.iter().map(|s| s.stamp.seconds()).collect();
    assert!(stamps.windows(2).all(|w| w[0] < w[1]), "time rises");
    let mut steps: Vec<f64> = stamps.windows(2).map(|w| w[1] - w[0]).collect();
    steps.sort_by(f64::total_cmp);
    let usual_s = quantile(&steps, 0.5);
    assert!((usual_s - 0.01).abs() < 1e-3, "a snapshot each {usual_s} s");
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
                let said_s = *log.said_s.get(&words).expect("the rig said so");
                assert!(said_s >= *newest, "the rig said so earlier");
                *newest = said_s;
            }
        }
    }
    Ok(Killed {
        lost_s: killed_s - newest_s[0].max(newest_s[1]),
        pumps_off_s,
        opened_s,
        snapshots: snapshots.len(),
    })
}

/// As [`kill_once`], within its bounds; again where the machine stalled.
fn kill(file: &Path, seed: u64, moment_s: f64, stalls: &Stalls) -> Killed {
    for attempt in 1.. {
        stalls.longest_s();
        let outcome = kill_once(file, seed, moment_s);
        let stalled_s = stalls.longest_s();
        let said = match &outcome {
            Ok(k) => format!(
                "killed after {moment_s:.3} s: lost {:.3} s, {} snapshots, opened in {:.2} s, pumps off after {:?} s",
                k.lost_s, k.snapshots, k.opened_s, k.pumps_off_s
            ),
            Err(said) => format!("ended by itself within {moment_s:.3} s: {said}"),
        };
        println!("{said}");
        match outcome {
            Ok(k)
                if k.lost_s <= 1.0
                    && k.opened_s <= 1.0
                    && k.pumps_off_s.is_none_or(|s| s <= 0.25) =>
            {
                return k;
            }
            // A program that is withheld the processor for 100 ms goes SAFE, as it must, and ends.
            outcome => assert!(
                attempt < ATTEMPTS
                    && (stalled_s > STALLED_S || outcome.is_err() && said.contains("SAFE")),
                "{said}; the machine stalled for {stalled_s:.3} s at most"
            ),
        }
    }
    unreachable!()
}

#[test]
fn a_program_that_is_killed_loses_less_than_a_second() {
    let kills = std::env::var(KILLS_WANTED).map_or(KILLS, |n| n.parse().expect("a number"));
    println!("{kills} kills, seed {SEED}");
    let dir = scratch("killed-program");
    let lane = |lane: usize| {
        let stalls = Stalls::watch();
        let seeds = (0..kills).filter(|k| k % LANES == lane);
        let one = |k: usize| {
            let mut rng = Pcg64Mcg::seed_from_u64(SEED + k as u64);
            let file = dir.join(format!("{lane}.rrd"));
            kill(&file, rng.random(), rng.random_range(MOMENTS_S), &stalls)
        };
        seeds.map(one).collect::<Vec<_>>()
    };
    let killed: Vec<Killed> = std::thread::scope(|scope| {
        let start = |n| {
            let thread = std::thread::Builder::new().name(format!("lane {n}"));
            thread
                .spawn_scoped(scope, move || lane(n))
                .expect("a thread")
        };
        let lanes: Vec<_> = (0..LANES).map(start).collect();
        let join = |l: std::thread::ScopedJoinHandle<'_, _>| l.join().expect("no lane fails");
        lanes.into_iter().flat_map(join).collect()
    });
    assert_eq!(killed.len(), kills);
    let most = |of: &dyn Fn(&Killed) -> f64| killed.iter().map(of).fold(0.0, f64::max);
    let pumps: Vec<f64> = killed.iter().filter_map(|k| k.pumps_off_s).collect();
    assert!(
        4 * pumps.len() >= kills,
        "the pumps ran in {} only",
        pumps.len()
    );
    let place = |n| (14, n);
    let fault = "SIGKILL while recording";
    row(
        place(1),
        fault,
        "<= 1 s lost",
        &format!("{:.2} s at most in {kills} kills", most(&|k| k.lost_s)),
    );
    row(
        place(2),
        fault,
        "the file opens to its last whole record",
        &format!(
            "all {kills}, in {:.2} s at most, every record as the rig sent it",
            most(&|k| k.opened_s)
        ),
    );
    row(
        place(3),
        fault,
        "rig SAFE <= 250 ms",
        &format!(
            "{:.0} ms at most in {} kills with running pumps",
            pumps.iter().copied().fold(0.0, f64::max) * 1e3,
            pumps.len()
        ),
    );
}
