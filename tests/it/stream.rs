//! The live stream against the stock Rerun viewer. Needs it: `./test peer`.

use std::ffi::OsStr;
use std::io::Read as _;
use std::net::{Ipv4Addr, SocketAddr, TcpListener, TcpStream};
use std::os::unix::process::CommandExt as _;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use nix::sys::signal::{Signal, killpg};
use nix::unistd::Pid;
use serde_json::Value;
use springtwin::recording::read_rrd;
use springtwin::signal::{Mode, Snapshot};

use crate::program::{json, scratch};

/// What a program may take on while its viewer hangs, kB: a queue of snapshots, and no more.
const GROWTH_KB: u64 = 24 << 10;

fn folder() -> PathBuf {
    std::env::var_os("SPRINGTWIN_RERUN")
        .expect("SPRINGTWIN_RERUN is the folder of the viewer: run ./test peer")
        .into()
}

/// The viewer, receiving on this machine.
struct Viewer {
    process: Child,
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
        let process = Command::new(folder().join("rerun"))
            .args(["--bind", "127.0.0.1", "--port", &address.port().to_string()])
            .args(["--memory-limit", "500MB", "--server-memory-limit", "500MB"])
            .args(more)
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            // The program starts another one: both are to hear our signals.
            .process_group(0)
            .spawn()
            .expect("the viewer starts");
        let viewer = Self { process, address };
        for _ in 0..600 {
            if TcpStream::connect(viewer.address).is_ok() {
                return viewer;
            }
            std::thread::sleep(Duration::from_millis(100));
        }
        panic!("the viewer does not listen at {}", viewer.address);
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
        let out = Command::new(folder().join("python"))
            .args(["-c", &script])
            .output()
            .expect("python");
        let said = String::from_utf8_lossy(&out.stderr).into_owned();
        assert!(out.status.success(), "{said}");
        image::open(&path).expect(&said).to_rgba8()
    }

    /// Ends it in peace, so that its file is whole.
    fn finish(mut self) {
        self.signal(Signal::SIGINT);
        self.process.wait().expect("wait");
    }
}

impl Drop for Viewer {
    fn drop(&mut self) {
        let _ = killpg(Pid::from_raw(self.process.id() as i32), Signal::SIGKILL);
        let _ = self.process.wait();
    }
}

/// The program on a rig in real time, streaming.
struct Program(Child);

impl Program {
    fn start(seconds: u32, viewer: &Viewer, more: &[&str]) -> Self {
        let process = Command::new(env!("CARGO_BIN_EXE_springtwin"))
            .args(["run", "--headless", "--rig", "pty", "--json", "--seconds"])
            .arg(seconds.to_string())
            .args(["--stream", &viewer.address.to_string()])
            .args(more)
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .expect("the program starts");
        Self(process)
    }

    /// Memory it holds now, kB.
    fn memory_kb(&self) -> u64 {
        let status = std::fs::read_to_string(format!("/proc/{}/status", self.0.id()))
            .expect("the program runs");
        let line = status.lines().find(|l| l.starts_with("VmRSS:"));
        line.and_then(|l| l.split_whitespace().nth(1)?.parse().ok())
            .expect("VmRSS")
    }

    fn finish(self) -> Value {
        self.finish_in_time().expect("a machine that keeps time")
    }

    /// What it says at the end; `None` when the machine froze for 100 ms: then the arm goes SAFE, as it must, which
    /// says nothing about the stream.
    fn finish_in_time(mut self) -> Option<Value> {
        let mut text = String::new();
        let mut said = String::new();
        let (out, err) = (self.0.stdout.take(), self.0.stderr.take());
        out.expect("stdout")
            .read_to_string(&mut text)
            .expect("utf-8");
        err.expect("stderr")
            .read_to_string(&mut said)
            .expect("utf-8");
        let status = self.0.wait().expect("wait");
        if said.contains("no data from") {
            println!("the machine stalled: {said}");
            return None;
        }
        assert!(status.success(), "{said}");
        Some(serde_json::from_str(&text).expect("one JSON object on standard output"))
    }
}

impl Drop for Program {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn wait(seconds: u64) {
    std::thread::sleep(Duration::from_secs(seconds));
}

/// The loop waited for nobody: a single wait for a viewer that hangs takes ten seconds.
fn assert_pace(v: &Value) {
    let count = |key: &str| v[key].as_u64().expect(key);
    println!(
        "ticks {}, missed {}, stream {}",
        count("ticks"),
        count("missed_ticks"),
        v["stream"]
    );
    assert!(count("ticks") > 9 * count("missed_ticks"), "{v}");
}

/// The arm stands on the left, and springs, pressures and error are plotted on the right, one below the
/// other: as many pixels of their colours.
fn assert_laid_out(picture: &image::RgbaImage) {
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
    assert!(bellows > 2000 && springs > 100 && pressures > 100);
}

#[test]
fn the_stock_viewer_draws_the_running_twin() {
    let viewer = Viewer::drawing(&[]);
    let program = Program::start(25, &viewer, &[]);
    wait(15);
    assert_laid_out(&viewer.picture("rerun-live.png"));
    assert_pace(&program.finish());
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
    wait(10);
    assert_laid_out(&viewer.picture("rerun-file.png"));
}

#[test]
fn a_viewer_gets_every_snapshot_bit_for_bit() {
    let dir = scratch("stream-whole");
    let (ours, theirs) = (dir.join("ours.rrd"), dir.join("theirs.rrd"));
    let record = ours.to_str().expect("utf-8");
    let more = ["--record", record, "--overwrite", "--target", "60,40,-300"];
    let in_time = (0..3).find_map(|_| {
        let viewer = Viewer::to_file(&theirs);
        let v = Program::start(8, &viewer, &more).finish_in_time();
        viewer.finish();
        v
    });
    let v = in_time.expect("a machine that keeps time");
    assert_pace(&v);
    let (ours, theirs) = (
        read_rrd(&ours).expect("our file"),
        read_rrd(&theirs).expect("the viewer's file"),
    );
    let (ours, theirs) = (ours.trace.snapshots, theirs.trace.snapshots);
    assert!(ours.len() > 400, "{}", ours.len());
    assert_eq!(v["stream"]["sent"], ours.len(), "{v}");
    assert_eq!(v["stream"]["dropped"], 0, "{v}");
    assert_eq!(v["stream"]["ended"], Value::Null, "{v}");
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
    let program = Program::start(15, &viewer, &[]);
    wait(6);
    viewer.signal(Signal::SIGKILL);
    let v = program.finish();
    assert_pace(&v);
    let ended = v["stream"]["ended"].as_str().expect("it ended");
    assert!(ended.contains("went away"), "{ended}");
    let sent = v["stream"]["sent"].as_u64().expect("sent");
    assert!((100..1300).contains(&sent), "{v}");
}

#[test]
fn a_viewer_that_hangs_costs_a_bounded_queue() {
    let dir = scratch("stream-hangs");
    let viewer = Viewer::to_file(&dir.join("v.rrd"));
    let program = Program::start(40, &viewer, &[]);
    wait(6);
    let before_kb = program.memory_kb();
    viewer.signal(Signal::SIGSTOP);
    let mut most_kb = 0;
    for _ in 0..28 {
        wait(1);
        most_kb = most_kb.max(program.memory_kb());
    }
    println!("memory before {before_kb} kB, at most {most_kb} kB while the viewer hung");
    // The program ends in time, too, with a connection that hangs.
    let v = program.finish();
    viewer.signal(Signal::SIGCONT);
    assert_pace(&v);
    assert!(most_kb < before_kb + GROWTH_KB);
    let ended = v["stream"]["ended"].as_str().expect("it ended");
    assert!(ended.contains("has taken nothing"), "{ended}");
    assert!(v["stream"]["dropped"].as_u64() > Some(100), "{v}");
}

#[test]
fn without_a_viewer_the_program_runs_and_says_so() {
    let free = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).expect("a port");
    let address = free.local_addr().expect("its address").to_string();
    drop(free);
    let v = json(&[
        "run",
        "--headless",
        "--rig",
        "pty",
        "--seconds",
        "13",
        "--json",
        "--stream",
        &address,
    ]);
    assert_pace(&v);
    let ended = v["stream"]["ended"].as_str().expect("it ended");
    assert!(ended.contains("does not answer"), "{ended}");
    assert_eq!(v["stream"]["sent"], 0, "{v}");
}

#[test]
#[expect(clippy::disallowed_methods, reason = "how long the viewer is away")]
fn a_viewer_that_comes_back_gets_the_stream_again() {
    let dir = scratch("stream-again");
    let (first, second) = (dir.join("first.rrd"), dir.join("second.rrd"));
    let viewer = Viewer::to_file(&first);
    let program = Program::start(24, &viewer, &[]);
    wait(7);
    viewer.signal(Signal::SIGKILL);
    let gone = std::time::Instant::now();
    let address = viewer.address;
    drop(viewer);
    wait(4);
    let more = [OsStr::new("--save"), second.as_os_str()];
    let viewer = Viewer::start_at(address, &more);
    let away_s = gone.elapsed().as_secs_f64();
    let v = program.finish();
    viewer.finish();
    assert_pace(&v);
    assert_eq!(v["stream"]["ended"], Value::Null, "{v}");
    let dropped = v["stream"]["dropped"].as_u64().expect("dropped");
    assert!(dropped > 100, "{v}");
    let whole = |path: &Path| read_rrd(path).expect("a recording").trace;
    let (first, second) = (whole(&first), whole(&second));
    let ends = |t: &springtwin::signal::Trace| {
        let (a, b) = (t.snapshots.first(), t.snapshots.last());
        [a, b].map(|s| s.expect("snapshots").stamp.seconds())
    };
    let ([_, last_s], [back_s, _]) = (ends(&first), ends(&second));
    // Batches of 0.2 s that were on their way are lost with the viewer.
    let again_s = back_s - last_s - away_s;
    println!("away {away_s:.2} s, then streaming again after {again_s:.2} s");
    assert!(again_s < 2.5, "{again_s} s");
    assert!(second.snapshots.len() > 300, "{}", second.snapshots.len());
    let count = |key: &str| v[key].as_u64().expect(key);
    crate::faults::row(
        (19, 1),
        "Rerun viewer killed, and started again 4 s later",
        "control unaffected; bounded queue, counted drops; retry 1 Hz",
        &format!(
            "{} of {} ticks missed; {dropped} snapshots dropped and counted, {} sent; streaming again {:.1} s after the viewer listens",
            count("missed_ticks"),
            count("ticks") + count("missed_ticks"),
            count_in(&v, "sent"),
            again_s.max(0.0)
        ),
    );
}

fn count_in(v: &Value, key: &str) -> u64 {
    v["stream"][key].as_u64().expect(key)
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
    let out = Command::new(folder().join("python"))
        .arg(root.join("examples/read_results.py"))
        .arg(&data)
        .arg(&recording)
        .arg(Path::new(&found).join("finding.json"))
        .output()
        .expect("python starts");
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
