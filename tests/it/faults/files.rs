//! Files that are cut, damaged, hostile or of the wrong units.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use springtwin::learn::Model;
use springtwin::robot::{REFERENCE, RobotSpec};
use springtwin::sensing::Calibration;

use super::samples::{self, c3d, imu_log, motive, session_log, vicon};
use super::{Bound, row};
use crate::process::output;
use crate::program::{refusal, scratch, springtwin};

const CALIBRATION: &str = include_str!("../../../assets/calibration/virtual-rig.toml");
const NETWORKS: &[u8] = include_bytes!("../../../assets/networks/reference.safetensors");
const BENCH: &str = "spring,length_mm,reading\n1,70,122.3\n1,80,130\n1,90,135\n";

fn text(path: &Path) -> &str {
    path.to_str().expect("utf-8")
}

/// The processor's time that `read` takes of this thread, s: what other programs take is not in it.
fn seconds<T>(read: impl FnOnce() -> T) -> (T, f64) {
    let used_s = || {
        let text = std::fs::read_to_string("/proc/thread-self/schedstat").expect("Linux");
        let ns = text.split(' ').next().and_then(|n| n.parse::<f64>().ok());
        ns.expect("nanoseconds") * 1e-9
    };
    let from_s = used_s();
    let answer = read();
    (answer, used_s() - from_s)
}

/// The program within a second of the processors' time; it is ended when it takes more.
fn within_a_second(args: &[&str]) -> Output {
    let mut limited = Command::new("prlimit");
    limited
        .arg("--cpu=1")
        .arg(env!("CARGO_BIN_EXE_springtwin"))
        .args(args);
    let out = output(&mut limited);
    assert!(out.status.code().is_some(), "{args:?}: over a second");
    out
}

/// Exit code and the only line on standard error of such a program.
fn refusal_within_a_second(args: &[&str]) -> (Option<i32>, String) {
    let out = within_a_second(args);
    let said = String::from_utf8_lossy(&out.stderr).trim().to_owned();
    assert_eq!(said.lines().count(), 1, "{args:?}: {said}");
    (out.status.code(), said)
}

/// Damaged copies of a file: cut at `n` places, and with a byte, eight bytes or a stretch changed at as many.
fn damaged(whole: &[u8], n: usize) -> Vec<Vec<u8>> {
    let mut out = Vec::new();
    for k in 0..n {
        let at = k * (whole.len() - 1) / n;
        out.push(whole[..at].to_vec());
        let mut changed = whole.to_vec();
        changed[at] ^= 0x55;
        out.push(changed.clone());
        let end = (at + 8).min(whole.len());
        changed[at..end].fill(0xff);
        out.push(changed.clone());
        let end = (at + 300).min(whole.len());
        changed[at..end].fill(0);
        out.push(changed);
    }
    out
}

/// What a kind of file came to: how many copies were refused and how many could be read in part or as they are.
#[derive(Default)]
struct Came {
    refused: usize,
    read: usize,
    slowest_s: f64,
}

impl Came {
    /// Reads all damaged copies; every refusal must name a place by one of `places`.
    fn of<T>(
        whole: &[u8],
        n: usize,
        places: &[&str],
        mut read: impl FnMut(&[u8]) -> Result<T, String>,
    ) -> Self {
        let mut came = Self::default();
        for bytes in damaged(whole, n) {
            let (answer, took_s) = seconds(|| read(&bytes));
            came.slowest_s = came.slowest_s.max(took_s);
            match answer {
                Ok(_) => came.read += 1,
                Err(said) => {
                    assert!(places.iter().any(|p| said.contains(p)), "{said}");
                    came.refused += 1;
                }
            }
        }
        came
    }

    fn keep(&self, number: u8, what: &str) {
        assert!(self.refused > 0, "{what}: nothing was refused");
        let slowest = (self.slowest_s > 0.0)
            .then(|| Bound::time("slowest, of the processor's time,", self.slowest_s, 1.0));
        row(
            (15, number),
            &format!("truncated or corrupt {what}"),
            "typed error <= 1 s naming the place; no panic",
            slowest.as_slice(),
            &format!(
                "{} damaged copies: {} refused with their place, {} read as far as they go{}",
                self.refused + self.read,
                self.refused,
                self.read,
                if slowest.is_some() {
                    ""
                } else {
                    "; each within a second of the processors' time"
                }
            ),
        );
    }
}

fn utf8(bytes: &[u8]) -> Result<&str, String> {
    std::str::from_utf8(bytes).map_err(|e| format!("line unknown, {e}"))
}

#[test]
fn damaged_files_are_refused_in_time_with_their_place() {
    let robot = Came::of(REFERENCE.as_bytes(), 150, &["line ", "robot file"], |b| {
        RobotSpec::from_toml(utf8(b)?).map_err(|e| e.to_string())
    });
    robot.keep(1, "robot file");
    let places = ["line ", "spring", "IMU"];
    let calibration = Came::of(CALIBRATION.as_bytes(), 150, &places, |b| {
        Calibration::from_toml(utf8(b)?).map_err(|e| e.to_string())
    });
    calibration.keep(2, "calibration");
    let places = ["tensor", "header", "description", "safetensors file"];
    let networks = Came::of(NETWORKS, 60, &places, |b| {
        Model::from_bytes(b).map_err(|e| e.to_string())
    });
    networks.keep(3, "network");
}

/// Read by the program, whose readers are many threads.
#[cfg(feature = "rrd")]
#[test]
fn damaged_recordings_are_refused_in_time_with_their_place_or_read_up_to_it() {
    let dir = scratch("fault-recordings");
    let whole = std::fs::read(sample_recording()).expect("the sample");
    let path = dir.join("damaged.rrd");
    let mut came = Came::default();
    for bytes in damaged(&whole, 12) {
        std::fs::write(&path, &bytes).expect("writes");
        let out = within_a_second(&["inspect", text(&path), "--json"]);
        if out.status.success() {
            let v: serde_json::Value = serde_json::from_slice(&out.stdout).expect("JSON");
            let is_cut = bytes.len() < whole.len();
            assert!(!is_cut || v["complete"] == false, "{v}");
            came.read += 1;
        } else {
            let said = String::from_utf8_lossy(&out.stderr);
            assert!(said.contains("byte "), "{said}");
            came.refused += 1;
        }
    }
    came.keep(4, "recording");
}

fn sample_recording() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("recordings/point-to-point.rrd")
}

#[test]
fn the_program_names_a_damaged_file_and_keeps_what_was_there() {
    let dir = scratch("fault-kept");
    let write = |name: &str, bytes: &[u8]| {
        let path = dir.join(name);
        std::fs::write(&path, bytes).expect("writes");
        path
    };
    let half = |bytes: &[u8]| bytes[..bytes.len() / 2].to_vec();
    let robot = write("robot.toml", &half(REFERENCE.as_bytes()));
    let session = dir.join("session.csv");
    std::fs::write(&session, session_log()).expect("writes");
    let networks = write("networks.safetensors", &half(NETWORKS));
    let calibration = write("calibration.toml", &half(CALIBRATION.as_bytes()));
    let zeros = ["sim", "solve", "--pressures", "0,0,0,0,0,0"];
    let cases: [(&Path, Vec<&str>); 3] = [
        (&robot, [&["--robot", text(&robot)], &zeros[..]].concat()),
        (
            &networks,
            vec!["estimate", text(&session), "--model", text(&networks)],
        ),
        (
            &calibration,
            vec!["run", "--headless", "--calibration", text(&calibration)],
        ),
    ];
    for (path, args) in cases {
        let (code, said) = refusal_within_a_second(&args);
        assert!(code == Some(1) && said.contains(text(path)), "{said}");
    }

    // What a refused file would have replaced is there as it was.
    let kept = write("kept.toml", CALIBRATION.as_bytes());
    let bench = write("bench.csv", b"spring,length_mm,reading\n1,70,12");
    let (code, said) = refusal(&[
        "calibrate",
        "springs",
        text(&bench),
        "--overwrite",
        "--out",
        text(&kept),
    ]);
    assert!(code == 1, "{said}");
    assert_eq!(std::fs::read(&kept).expect("kept"), CALIBRATION.as_bytes());
    let names = samples::names(&dir);
    assert!(names.iter().all(|n| !n.contains("part")), "{names:?}");
    row(
        (15, 5),
        "truncated or corrupt recording, network, calibration, robot file",
        "last good kept",
        &[],
        "a refused calibration leaves the one in its place byte for byte, and the window goes on with the newest whole \
         one; the program answers within a second of the processors' time",
    );
}

#[test]
fn malformed_tables_are_refused_with_line_and_column_and_nothing_is_half_imported() {
    let dir = scratch("fault-import");
    let out = dir.join("session");
    let c3d = c3d();
    let cases: Vec<(&str, Vec<u8>, Vec<&str>)> = vec![
        (
            "a number that is none",
            vicon().replace("-175.25", "-17x.25").into_bytes(),
            vec!["line 6, column 7"],
        ),
        (
            "a frame number that is none",
            vicon().replace("\n9,0", "\n9.5,0").into_bytes(),
            vec!["line 7, column 1"],
        ),
        (
            "a quote that is not closed",
            vicon().replace("\n9,0,", "\n9,0,\"").into_bytes(),
            vec!["line 7, column 3"],
        ),
        (
            "frames that go back",
            vicon().replace("\n9,0", "\n6,0").into_bytes(),
            vec!["line 7, column 1", "frames must rise"],
        ),
        (
            "a quaternion that is none",
            motive()
                .replace("\n30,0.25,0,0,0,1", "\n30,0.25,0,0,0,3")
                .into_bytes(),
            vec!["line 8, column"],
        ),
        (
            "a C3D file that is cut",
            c3d[..c3d.len() - 7].to_vec(),
            vec!["byte "],
        ),
        (
            "a C3D file of an unknown processor",
            [&c3d[..515], &[99], &c3d[516..]].concat(),
            vec!["byte 515"],
        ),
    ];
    let n = cases.len();
    for (what, bytes, wants) in cases {
        let file = dir.join("capture");
        std::fs::write(&file, &bytes).expect("writes");
        println!("{what}");
        let (code, said) = refusal(&["import", text(&file), "--out", text(&out)]);
        let told = wants.iter().all(|w| said.contains(w)) && said.contains(text(&file));
        assert!(code == 1 && told, "{what}: {said}");
        assert_eq!(samples::names(&dir), ["capture"], "{what}");
    }
    // The same files without the fault are taken.
    for bytes in [vicon().into_bytes(), motive().into_bytes()] {
        let file = dir.join("capture");
        std::fs::write(&file, &bytes).expect("writes");
        let out = springtwin(&["import", text(&file), "--out", text(&out)]);
        assert!(
            out.status.success(),
            "{}",
            String::from_utf8_lossy(&out.stderr)
        );
        std::fs::remove_dir_all(dir.join("session")).expect("was imported");
    }
    let log = dir.join("log.csv");
    for (from, to, want) in [
        (",150,", ",15o,", "line 2, column 8"),
        ("0.02,", "0,", "line 3, column 1"),
        ("t_s", "t", "line 1, column 1"),
    ] {
        std::fs::write(&log, session_log().replacen(from, to, 1)).expect("writes");
        let (code, said) = refusal(&["inspect", text(&log)]);
        assert!(code == 1 && said.contains(want), "{said}");
    }
    row(
        (16, 1),
        "malformed CSV, C3D, session log",
        "error with line and column; nothing half-imported",
        &[],
        &format!(
            "{n} motion-capture files and 3 session logs refused with line and column (C3D: byte); no folder and \
             no part of one is left"
        ),
    );
}

#[test]
fn other_units_and_ranges_are_refused() {
    let dir = scratch("fault-units");
    let file = |name: &str, content: &str| {
        let path = dir.join(name);
        std::fs::write(&path, content).expect("writes");
        path
    };
    let said = |args: &[&str]| {
        let (code, said) = refusal(args);
        assert_eq!(code, 1, "{said}");
        said
    };
    let mut n = 0;
    let mut check = |said: String, wants: &[&str]| {
        assert!(wants.iter().all(|w| said.contains(w)), "{said} {wants:?}");
        n += 1;
    };
    let zeros = ["sim", "solve", "--pressures", "0,0,0,0,0,0"];
    for (from, to, wants) in [
        (
            "range_kpa = [-40.0, 40.0]",
            "range_kpa = [-40000.0, 40000.0]",
            "-40 to 40 kPa",
        ),
        (
            "range_mm = [70.0, 240.0]",
            "range_mm = [0.07, 0.24]",
            "70 to 240 mm",
        ),
        ("range_kpa", "range_psi", "range_psi"),
    ] {
        let robot = file("robot.toml", &REFERENCE.replacen(from, to, 1));
        check(
            said(&[&["--robot", text(&robot)], &zeros[..]].concat()),
            &[wants],
        );
    }
    let log = session_log();
    for (from, to, wants) in [
        ("spring1_mm", "spring1_m", &["spring1_mm", "wrong unit"][..]),
        ("p1_kpa", "p1", &["p1_kpa", "wrong unit"]),
        (",150,", ",0.15,", &["70-240 mm", "looks like metres"]),
        (",1,", ",10000,", &["looks like Pa"]),
    ] {
        let log = file("log.csv", &log.replace(from, to));
        check(said(&["inspect", text(&log)]), wants);
    }
    for (from, to) in [
        ("\n1,70,", "\n1,7,"),
        ("\n1,70,", "\n1,0.07,"),
        ("\n1,70,", "\n1,700,"),
    ] {
        let bench = file("bench.csv", &BENCH.replace(from, to));
        let out = dir.join("springs.toml");
        let args = ["calibrate", "springs", text(&bench), "--out", text(&out)];
        check(
            said(&args),
            &["line 2, column 2", "70-240 mm", "check the unit"],
        );
        assert!(!out.exists());
    }
    let out = dir.join("session");
    for (content, wants) in [
        (vicon().replace("mm,mm,mm", "inch,inch,inch"), "inch"),
        (vicon().replace("mm,mm,mm", ",,"), "line 5"),
        (vicon().replace("deg,deg,deg", "grad,grad,grad"), "grad"),
        (
            motive().replace("Length Units,Meters", "Length Units,Feet"),
            "Feet",
        ),
    ] {
        let capture = file("capture.csv", &content);
        check(
            said(&["import", text(&capture), "--out", text(&out)]),
            &[wants],
        );
        assert!(!out.exists());
    }
    let capture = dir.join("capture.c3d");
    let mut inches = c3d();
    let at = inches
        .windows(2)
        .position(|w| w == b"mm")
        .expect("its unit");
    inches[at..at + 2].copy_from_slice(b"in");
    std::fs::write(&capture, inches).expect("writes");
    check(
        said(&["import", text(&capture), "--out", text(&out)]),
        &["\"in\"", "mm, cm or m"],
    );
    row(
        (18, 1),
        "wrong or missing units",
        "refused; range checks 70-240 mm, ±40 kPa",
        &[],
        &format!(
            "{n} files refused with their place: robot files beyond 70-240 mm or ±40 kPa, session logs whose \
             springs or pressures are typically of another unit, bench logs beyond 35-480 mm, motion capture in \
             units that are unknown or missing"
        ),
    );
}

/// Runs the program with at most so much address space; `None` when it was ended by a signal or by the test.
fn within(limit_bytes: u64, args: &[&str]) -> Option<Output> {
    let mut limited = Command::new("prlimit");
    limited
        .arg(format!("--as={limit_bytes}"))
        // A reader that goes round in circles is ended, too.
        .arg("--cpu=60")
        .arg(env!("CARGO_BIN_EXE_springtwin"))
        .args(args)
        // Every thread would reserve a heap of its own, whatever it uses of it.
        .env("MALLOC_ARENA_MAX", "1")
        .env_remove("RUST_BACKTRACE");
    let out = output(&mut limited);
    out.status.code().map(|_| out)
}

const MIB: u64 = 1 << 20;
/// What a hostile file may take beyond four times its size, for tables and texts of refusals.
const SLACK_BYTES: u64 = 16 * MIB;

/// The least address space in which a sound file of the kind is read, to 4 MiB.
fn need(args: &[&str], out: &Path) -> u64 {
    let reads = |mib: u64| {
        let ended = within(mib * MIB, args);
        let _ = std::fs::remove_dir_all(out);
        ended.is_some_and(|o| o.status.success())
    };
    let (mut low, mut high) = (16, 4096);
    assert!(reads(high), "{args:?}: the sound file is not read");
    while high - low > 4 {
        let middle = (low + high) / 2;
        if reads(middle) {
            high = middle;
        } else {
            low = middle;
        }
    }
    high * MIB
}

#[cfg(target_os = "linux")]
#[test]
fn files_that_claim_more_than_they_hold_do_not_get_it() {
    let dir = scratch("fault-huge");
    let (mut runs, mut failed) = (0, Vec::new());
    let mut check = |kind: &str,
                     sound: &[u8],
                     hostile: Vec<Vec<u8>>,
                     command: &dyn Fn(&Path) -> Vec<String>| {
        let path = dir.join(kind);
        let args = command(&path);
        let args: Vec<&str> = args.iter().map(String::as_str).collect();
        std::fs::write(&path, sound).expect("writes");
        let need = need(&args, &dir.join("out"));
        let _ = std::fs::remove_dir_all(dir.join("out"));
        for (k, bytes) in hostile.into_iter().enumerate() {
            std::fs::write(&path, &bytes).expect("writes");
            let limit = need + 4 * bytes.len() as u64 + SLACK_BYTES;
            runs += 1;
            let Some(out) = within(limit, &args) else {
                failed.push(format!(
                    "{kind} {k}: ended by a signal within {} MiB",
                    limit / MIB
                ));
                continue;
            };
            let said = String::from_utf8_lossy(&out.stderr).trim().to_owned();
            // Some lies are of no consequence: then the file is read.
            let sentence = said.lines().count() == 1 && out.status.code() == Some(1);
            if said.contains("panicked") || !(sentence || out.status.success()) {
                failed.push(format!("{kind} {k}: {said}"));
            }
            let _ = std::fs::remove_dir_all(dir.join("out"));
        }
        println!("{kind}: a sound file needs {} MiB", need / MIB);
    };
    let out = dir.join("out");
    let import = |p: &Path| -> Vec<String> {
        ["import", text(p), "--subject", "s", "--out", text(&out)]
            .map(str::to_owned)
            .to_vec()
    };
    let inspect = |p: &Path| vec!["inspect".to_owned(), text(p).to_owned()];
    check(
        "take.c3d",
        &samples::c3d_of_three(),
        samples::hostile_c3d(),
        &import,
    );
    check(
        "log.csv",
        session_log().as_bytes(),
        samples::hostile_logs(),
        &inspect,
    );
    let table = |p: &Path| -> Vec<String> {
        ["import", text(p), "--out", text(&out)]
            .map(str::to_owned)
            .to_vec()
    };
    check(
        "take.csv",
        vicon().as_bytes(),
        samples::hostile_tables(),
        &table,
    );
    let robot = |p: &Path| -> Vec<String> {
        [
            "--robot",
            text(p),
            "sim",
            "solve",
            "--pressures",
            "0,0,0,0,0,0",
        ]
        .map(str::to_owned)
        .to_vec()
    };
    check(
        "robot.toml",
        REFERENCE.as_bytes(),
        samples::hostile_tomls(REFERENCE),
        &robot,
    );
    let session = dir.join("truth.csv");
    std::fs::write(&session, samples::session_log_with_truth()).expect("writes");
    let estimate = |p: &Path| -> Vec<String> {
        ["estimate", text(&session), "--model", text(p)]
            .map(str::to_owned)
            .to_vec()
    };
    check(
        "net.safetensors",
        NETWORKS,
        samples::hostile_networks(NETWORKS),
        &estimate,
    );
    let imu = |p: &Path| vec!["imu".to_owned(), "eval".to_owned(), text(p).to_owned()];
    let log = imu_log();
    check("imu.parquet", &log, samples::hostile_parquet(&log), &imu);
    if cfg!(feature = "rrd") {
        let whole = std::fs::read(sample_recording()).expect("the sample");
        check(
            "take.rrd",
            &whole,
            samples::hostile_recordings(&whole),
            &inspect,
        );
    }
    println!("{}", failed.join("\n"));
    row(
        (17, 1),
        "huge lengths and counts in files",
        "checked; allocation <= 4x file size",
        &[Bound::count(
            "files that ended otherwise",
            failed.len() as f64,
            0.0,
        )],
        &format!(
            "{runs} files that claim up to 1 GiB, each within the address space that a sound one of its kind \
             needs, plus 4 x its size, plus {} MiB: one sentence or read; beyond 4 x, and bounded by other limits, are by \
             construction a Vicon table of empty cells (32 x) and TOML texts (50 x)",
            SLACK_BYTES / MIB
        ),
    );
}
