//! The live stream against the stock Rerun viewer. Needs it: `./test peer`.

use std::ffi::OsStr;
use std::net::{Ipv4Addr, SocketAddr, TcpListener, TcpStream};
use std::os::unix::process::CommandExt as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::Arc;
use std::time::Duration;

use nix::sys::signal::{Signal, killpg};
use nix::unistd::Pid;
use springtwin::recording::read_rrd;
use springtwin::signal::{Goal, Mode, Snapshot, Stamp, StreamState, StreamStatus};
use springtwin::twin::{Command as Order, LAST_WORDS, Runner, TICK_S};

use crate::lockstep::{World, runner};
use crate::process::{self, PATIENCE, Running, until};
use crate::program::{json, scratch};

/// What a program may take on while its viewer hangs, kB: a queue of snapshots, and no more.
const GROWTH_KB: u64 = 24 << 10;
/// Snapshots that may be on their way to a viewer that is to miss none.
const UNDER_WAY: u64 = 256;

fn folder() -> PathBuf {
    std::env::var_os("SPRINGTWIN_RERUN")
        .expect("SPRINGTWIN_RERUN is the folder of the viewer: run ./test peer")
        .into()
}

/// The viewer, receiving on this machine.
struct Viewer {
    process: Running,
    address: SocketAddr,
}

impl Viewer {
    /// One that only writes what it receives to a file.
    fn to_file(file: &Path) -> Self {
        Self::start(&[OsStr::new("--save"), file.as_os_str()])
    }

    /// One that draws, without a window.
    fn drawing(more: &[&OsStr]) -> Self {
        let size = ["--headless", "--window-size", "1500x850"].map(OsStr::new);
        Self::start(&[&size, more].concat())
    }

    fn start(more: &[&OsStr]) -> Self {
        let address = TcpListener::bind((Ipv4Addr::LOCALHOST, 0))
            .and_then(|free| free.local_addr())
            .expect("a free port");
        Self::start_at(address, more)
    }

    fn start_at(address: SocketAddr, more: &[&OsStr]) -> Self {
        // A job in the background of a script ignores the signal that ends the viewer in peace: not so the viewer.
        let mut command = Command::new("env");
        command
            .arg("--default-signal=INT")
            .arg(folder().join("rerun"))
            .args(["--bind", "127.0.0.1", "--port", &address.port().to_string()])
            .args(["--memory-limit", "500MB", "--server-memory-limit", "500MB"])
            .args(more)
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            // The program starts another one: both are to hear our signals.
            .process_group(0);
        let process = Running::start(&mut command);
        let viewer = Self { process, address };
        until("the viewer listens", || {
            TcpStream::connect(viewer.address).is_ok()
        });
        viewer
    }

    fn signal(&self, signal: Signal) {
        killpg(Pid::from_raw(self.process.id() as i32), signal).expect("the viewer runs");
    }

    /// A picture of what it shows.
    fn picture(&self, name: &str) -> image::RgbaImage {
        let pictures = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("target/pictures");
        std::fs::create_dir_all(&pictures).expect("the target directory can be written");
        let path = pictures.join(name);
        let _ = std::fs::remove_file(&path);
        let script = format!(
            "from rerun.experimental import ViewerClient\n\
             ViewerClient('rerun+http://{}/proxy').save_screenshot('{}')",
            self.address,
            path.display()
        );
        let out = process::output(Command::new(folder().join("python")).args(["-c", &script]));
        let said = String::from_utf8_lossy(&out.stderr).into_owned();
        assert!(out.status.success(), "{said}");
        image::open(&path).expect(&said).to_rgba8()
    }

    /// Whether none of its threads runs or waits for a processor or a disk.
    fn is_idle(&self) -> bool {
        let group = self.process.id().to_string();
        // After the name in brackets: state, parent, process group.
        let state_and_group = |stat: &str| {
            let (_, rest) = stat.rsplit_once(") ")?;
            let mut fields = rest.split(' ');
            Some((fields.next()?.to_owned(), fields.nth(1)?.to_owned()))
        };
        let entries = |folder: &Path| {
            let listed = std::fs::read_dir(folder).into_iter().flatten().flatten();
            listed.map(|e| e.path()).collect::<Vec<_>>()
        };
        let stats = entries(Path::new("/proc"))
            .into_iter()
            .flat_map(|process| entries(&process.join("task")))
            .filter_map(|task| std::fs::read_to_string(task.join("stat")).ok());
        stats
            .filter_map(|stat| state_and_group(&stat))
            .filter(|(_, of)| *of == group)
            .all(|(state, _)| state != "R" && state != "D")
    }

    /// Ends it in peace once it has taken in all that was sent, so that its file is whole.
    fn finish(mut self) {
        // On a busy machine it may be far behind; then it is found waiting for a processor.
        let mut looks = 0;
        until("the viewer has nothing left to do", || {
            std::thread::sleep(Duration::from_millis(20));
            looks = if self.is_idle() { looks + 1 } else { 0 };
            looks >= 50
        });
        self.signal(Signal::SIGINT);
        until("the viewer ends", || self.process.has_ended());
    }
}

impl Drop for Viewer {
    fn drop(&mut self) {
        let _ = killpg(Pid::from_raw(self.process.id() as i32), Signal::SIGKILL);
    }
}

/// A twin on simulated time that streams. Its stream keeps real time, so the ticks are slowed down; how much, decides
/// nothing.
struct Streaming {
    runner: Runner,
    ticks: u64,
    last: Arc<Snapshot>,
}

impl Streaming {
    fn to(address: SocketAddr, more: &[Order]) -> Self {
        let mut world = World::new(None);
        world.truths = Some(Vec::new());
        let (runner, _) = runner(world);
        let mut streaming = Self {
            runner,
            ticks: 0,
            last: Arc::default(),
        };
        streaming.tick(&[&[Order::StreamLive(address)], more].concat());
        streaming
    }

    fn now(&self) -> Stamp {
        Stamp::from_seconds(self.ticks as f64 * TICK_S)
    }

    fn tick(&mut self, orders: &[Order]) {
        self.ticks += 1;
        std::thread::sleep(Duration::from_millis(2));
        self.last = self.runner.tick(self.now(), orders).0;
    }

    /// How the stream is doing.
    fn status(&self) -> StreamStatus {
        self.last.streaming.clone().expect("it streams")
    }

    /// Ticks until the stream is so.
    fn until(&mut self, what: &str, is: impl Fn(&StreamStatus) -> bool) -> StreamStatus {
        until(what, || {
            self.tick(&[]);
            is(&self.status())
        });
        self.status()
    }

    /// Ticks so often, and never runs away from the viewer.
    fn run_in_step(&mut self, ticks: u64) {
        for _ in 0..ticks {
            self.tick(&[]);
            if self.ticks - self.status().sent > UNDER_WAY {
                // Only a tick shows what was sent: from here on few of them.
                let sent = self.status().sent;
                self.until("the viewer keeps up", |s| {
                    std::thread::sleep(Duration::from_millis(100));
                    s.sent > sent
                });
            }
        }
    }

    /// Ends the stream and returns its status.
    fn finish(mut self, patience: Duration) -> StreamStatus {
        let now = self.now();
        let status = self.runner.stop_stream(now, patience, &mut Vec::new());
        status.expect("it streamed")
    }
}

fn away(words: &str) -> impl Fn(&StreamStatus) -> bool {
    let words = words.to_owned();
    move |s| matches!(&s.state, StreamState::Away(why) if why.contains(&words))
}

/// Memory that this process holds now, kB.
fn memory_kb() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").expect("Linux");
    let line = status.lines().find(|l| l.starts_with("VmRSS:"));
    line.and_then(|l| l.split_whitespace().nth(1)?.parse().ok())
        .expect("VmRSS")
}

/// The arm stands on the left, and springs, pressures and error are plotted on the right, one below the
/// other: as many pixels of their colours.
fn is_laid_out(picture: &image::RgbaImage) -> bool {
    let (w, h) = picture.dimensions();
    let count = |x: std::ops::Range<u32>, y: std::ops::Range<u32>, colour: [i32; 3]| {
        let near = |p: &image::Rgba<u8>| (0..3).all(|i| (i32::from(p.0[i]) - colour[i]).abs() < 40);
        let pixels = y.flat_map(|y| x.clone().map(move |x| (x, y)));
        pixels
            .filter(|(x, y)| near(picture.get_pixel(*x, *y)))
            .count()
    };
    let (left, right) = (0..w / 2, w * 11 / 20..w);
    let bellows = count(left, h / 20..h * 3 / 4, [107, 143, 179]);
    let springs = count(right.clone(), h / 20..h / 4, [47, 191, 143]);
    let pressures = count(right, h * 6 / 20..h / 2, [76, 155, 232]);
    println!("pixels: bellows {bellows}, springs {springs}, pressures {pressures}");
    bellows > 2000 && springs > 100 && pressures > 100
}

#[test]
fn the_stock_viewer_draws_the_running_twin() {
    let viewer = Viewer::drawing(&[]);
    let mut streaming = Streaming::to(viewer.address, &[]);
    streaming.until("some seconds are sent", |s| s.sent > 800);
    until("the viewer draws them", || {
        for _ in 0..100 {
            streaming.tick(&[]);
        }
        is_laid_out(&viewer.picture("rerun-live.png"))
    });
}

#[test]
fn the_stock_viewer_draws_a_recording() {
    let file = scratch("stream-file").join("goto.rrd");
    let record = file.to_str().expect("utf-8");
    json(&[
        "record",
        record,
        "--seconds",
        "8",
        "--target",
        "60,40,-300",
        "--json",
    ]);
    let viewer = Viewer::drawing(&[file.as_os_str()]);
    until("the viewer draws it", || {
        is_laid_out(&viewer.picture("rerun-file.png"))
    });
}

#[test]
fn a_viewer_gets_every_snapshot_bit_for_bit() {
    let dir = scratch("stream-whole");
    let (ours, theirs) = (dir.join("ours.rrd"), dir.join("theirs.rrd"));
    let viewer = Viewer::to_file(&theirs);
    let mut streaming = Streaming::to(viewer.address, &[Order::StartRecording(ours.clone())]);
    streaming.run_in_step(200);
    let goal = Goal::position([0.06, 0.04, -0.30]);
    streaming.tick(&[Order::Arm, Order::Goto(goal)]);
    streaming.run_in_step(600);
    let now = streaming.now();
    streaming.runner.stop_recording(now, &mut Vec::new());
    let ticks = streaming.ticks;
    let status = streaming.finish(PATIENCE);
    viewer.finish();
    let (ours, theirs) = (
        read_rrd(&ours).expect("our file"),
        read_rrd(&theirs).expect("the viewer's file"),
    );
    let (mut ours, theirs) = (ours.trace.snapshots, theirs.trace.snapshots);
    assert_eq!(status.sent, ticks);
    // A tick that found two frames is two rows of a recording.
    assert!((ticks..ticks + 5).contains(&(ours.len() as u64)));
    ours.retain(|s| theirs.iter().any(|t| t.stamp == s.stamp));
    assert_eq!((status.dropped, status.dropped_lines), (0, 0));
    assert_eq!(theirs.len(), ours.len());
    for (a, b) in ours.iter().zip(&theirs) {
        assert_eq!(a.stamp, b.stamp);
        assert_eq!(a.raw, b.raw, "at {:?}", a.stamp);
        assert_eq!(a.sensors, b.sensors, "at {:?}", a.stamp);
        assert_eq!(a.estimate, b.estimate, "at {:?}", a.stamp);
        assert_eq!(a.truth, b.truth, "at {:?}", a.stamp);
        assert_eq!(a.goal, b.goal, "at {:?}", a.stamp);
        assert_eq!(a.sensor_ref, b.sensor_ref, "at {:?}", a.stamp);
        assert_eq!(a.command, b.command, "at {:?}", a.stamp);
        assert_eq!(a.mode, b.mode, "at {:?}", a.stamp);
        assert_eq!(a.link, b.link, "at {:?}", a.stamp);
        assert_eq!(a.payload_kg, b.payload_kg, "at {:?}", a.stamp);
    }
    let has = |what: &dyn Fn(&Snapshot) -> bool| theirs.iter().any(what);
    assert!(has(&|s| s.estimate.is_some()) && has(&|s| s.truth.is_some()));
    assert!(has(&|s| s.goal.is_some()) && has(&|s| s.sensor_ref.is_some()));
    assert!(has(&|s| s.command.is_some()) && has(&|s| s.mode == Mode::Moving));
}

#[test]
fn a_viewer_that_is_killed_ends_the_stream_and_nothing_else() {
    let dir = scratch("stream-killed");
    let viewer = Viewer::to_file(&dir.join("v.rrd"));
    let mut streaming = Streaming::to(viewer.address, &[]);
    streaming.until("it streams", |s| s.sent > 100);
    viewer.signal(Signal::SIGKILL);
    let status = streaming.until("the loss is reported", away("went away"));
    let dropped = status.dropped;
    streaming.until("what comes is dropped", |s| s.dropped > dropped + 100);
    assert_eq!(streaming.last.mode, Mode::Disarmed);
}

#[test]
fn a_viewer_that_hangs_costs_a_bounded_queue() {
    let dir = scratch("stream-hangs");
    let viewer = Viewer::to_file(&dir.join("v.rrd"));
    let mut streaming = Streaming::to(viewer.address, &[]);
    streaming.until("it streams", |s| s.sent > 500);
    let before_kb = memory_kb();
    viewer.signal(Signal::SIGSTOP);
    streaming.until("the stop is reported", away("has taken nothing"));
    let status = streaming.until("what comes is dropped", |s| s.dropped > 3000);
    let after_kb = memory_kb();
    println!("memory before {before_kb} kB, {after_kb} kB while the viewer hangs: {status:?}");
    assert!(after_kb < before_kb + GROWTH_KB);
    // It ends with a connection that hangs, too: this returns.
    streaming.finish(LAST_WORDS);
    viewer.signal(Signal::SIGCONT);
}

#[test]
fn without_a_viewer_the_twin_runs_and_says_so() {
    let free = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).expect("a port");
    let address = free.local_addr().expect("its address");
    drop(free);
    let mut streaming = Streaming::to(address, &[]);
    let status = streaming.until("it is reported", away("does not answer"));
    assert_eq!(status.sent, 0, "{status:?}");
}

#[test]
fn a_viewer_that_comes_back_gets_the_stream_again() {
    let dir = scratch("stream-again");
    let second = dir.join("second.rrd");
    let viewer = Viewer::to_file(&dir.join("first.rrd"));
    let address = viewer.address;
    let mut streaming = Streaming::to(address, &[]);
    streaming.until("it streams", |s| s.sent > 300);
    viewer.signal(Signal::SIGKILL);
    drop(viewer);
    let status = streaming.until("the loss is reported", away("went away"));
    let dropped = status.dropped;
    streaming.until("what comes is dropped", |s| s.dropped > dropped + 300);
    let viewer = Viewer::start_at(address, &[OsStr::new("--save"), second.as_os_str()]);
    let status = streaming.until("it streams again", |s| s.state == StreamState::Streaming);
    let sent = status.sent;
    streaming.until("the second is sent, too", |s| s.sent > sent + 400);
    let ticks = streaming.ticks;
    let status = streaming.finish(PATIENCE);
    viewer.finish();
    assert_eq!(status.sent + status.dropped, ticks, "{status:?}");
    let second = read_rrd(&second).expect("a recording").trace.snapshots;
    assert!(second.len() > 400, "{}", second.len());
    assert!(second.windows(2).all(|s| s[0].stamp < s[1].stamp));
    crate::faults::row(
        (19, 1),
        "Rerun viewer killed, and started again",
        "control unaffected; bounded queue, counted drops; retry 1 Hz",
        &[],
        &format!(
            "of {ticks} ticks' snapshots {} sent, {} dropped and counted, no other; streaming again once it listens",
            status.sent, status.dropped
        ),
    );
}

/// `examples/read_results.py` reads our datasets, recordings and findings with stock packages alone, and finds
/// in the recording what this program finds.
#[test]
fn python_reads_our_files_with_stock_packages() {
    let dir = scratch("python");
    let path = |name: &str| dir.join(name).to_str().expect("UTF-8").to_owned();
    let (data, found) = (path("sim.parquet"), path("found"));
    json(&[
        "dataset",
        "generate",
        "--samples",
        "200",
        "--out",
        &data,
        "--json",
    ]);
    let (healthy, suspect) = (path("healthy"), path("suspect"));
    let session = ["rig", "session", "--seconds", "30", "--json", "--out"];
    json(&[&session[..], &[&healthy]].concat());
    let hidden = ["--seed", "2", "--hide", "spring-calibration:4=1.06,0.002"];
    json(&[&session[..], &[&suspect], &hidden].concat());
    let find = ["gap", "run", "--baseline", &healthy, "--session", &suspect];
    json(&[&find[..], &["--out", &found, "--json"]].concat());

    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let recording = root.join("recordings/point-to-point.rrd");
    let mut python = Command::new(folder().join("python"));
    python
        .arg(root.join("examples/read_results.py"))
        .arg(&data)
        .arg(&recording)
        .arg(Path::new(&found).join("finding.json"));
    let out = process::output(&mut python);
    let said = String::from_utf8_lossy(&out.stdout);
    let complaint = String::from_utf8_lossy(&out.stderr);
    assert!(out.status.success(), "{said}{complaint}");
    println!("{said}");
    assert!(said.contains("200 samples by rod, seed 1"), "{said}");
    assert!(said.contains("spring-calibration 4: gain 1.0"), "{said}");
    let (_, mean) = said.split_once("mean error ").expect("a mean error");
    let mean_mm: f64 = mean
        .split(' ')
        .next()
        .expect("a number")
        .parse()
        .expect("a number");
    let (ours_m, n) = crate::examples::recording_error_m(&recording);
    assert!(
        n > 500 && (mean_mm - ours_m * 1e3).abs() < 0.01,
        "{mean_mm} mm, {ours_m} m"
    );
}
