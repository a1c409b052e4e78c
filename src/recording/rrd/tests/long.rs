//! A recording of a working day. Takes some minutes and 5 GB of disk: `cargo test long_recording -- --ignored --nocapture`.

use super::*;

/// Memory of this process, MB.
#[cfg(target_os = "linux")]
fn memory_mb(what: &str) -> f64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap();
    let line = status.lines().find(|l| l.starts_with(what)).unwrap();
    line.split_whitespace()
        .nth(1)
        .unwrap()
        .parse::<f64>()
        .unwrap()
        / 1024.0
}

/// Ten hours at 100 Hz, made of a minute of the virtual rig again and again.
#[cfg(target_os = "linux")]
#[test]
#[ignore = "takes minutes and 5 GB of disk"]
fn long_recording() {
    use crate::recording::read_log;
    const LONG_RECORDING_MINUTE: &str = "SPRINGTWIN_MINUTE";
    let Some(minute) = std::env::var_os(LONG_RECORDING_MINUTE) else {
        panic!("{LONG_RECORDING_MINUTE} names a recording of a minute");
    };
    let minute = read_rrd(std::path::Path::new(&minute)).unwrap();
    let snapshots = &minute.trace.snapshots;
    let span = snapshots.last().unwrap().stamp.0 + 10_000_000;
    let folder = std::env::temp_dir().join(format!("springtwin-long-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let path = folder.join("long.rrd");
    let mut w = RecordingWriter::create(&path, minute.meta.clone()).unwrap();
    let mut rows = 0;
    for n in 0..600 {
        let shift = |t: Stamp| Stamp(t.0 + n * span);
        for s in snapshots {
            let mut s = s.clone();
            s.stamp = shift(s.stamp);
            if let Some(raw) = &mut s.raw {
                raw.stamp = shift(raw.stamp);
            }
            if let Some(frame) = &mut s.sensors {
                frame.stamp = shift(frame.stamp);
            }
            if let Some(e) = &mut s.estimate {
                e.stamp = shift(e.stamp);
            }
            if let Some(g) = &mut s.truth {
                g.stamp = shift(g.stamp);
            }
            w.push(&s).unwrap();
            rows += 1;
        }
        if n % 60 == 59 {
            println!(
                "hour {}: {:.0} MB in memory",
                (n + 1) / 60,
                memory_mb("VmRSS")
            );
        }
    }
    let summary = w.finish().unwrap();
    println!(
        "{rows} snapshots, {} files, {:.3} GB: {:.0} MB an hour",
        summary.segments,
        summary.bytes as f64 * 1e-9,
        summary.bytes as f64 * 1e-7
    );
    #[allow(clippy::disallowed_methods, reason = "figures for people")]
    let clock = std::time::Instant::now;
    let start = clock();
    let file = RecordingFile::open(&path).unwrap();
    println!(
        "opened in {:.2} s, {:.0} MB",
        start.elapsed().as_secs_f64(),
        memory_mb("VmRSS")
    );
    assert_eq!(file.rows(), Some(rows));
    let start = clock();
    let part = path.with_file_name("long.rrd@35400..35460");
    let log = read_log(&part).unwrap();
    println!(
        "{} rows of a minute in {:.2} s",
        log.len(),
        start.elapsed().as_secs_f64()
    );
    assert!((5900..6200).contains(&log.len()));
    let start = clock();
    let mut inspector = Inspector::default();
    let mut kept = 0;
    file.read_in_windows(&Selection::default(), &mut |_| true, &mut |window| {
        inspector.take(&window);
        kept += window.read.trace.snapshots.len() / 10;
    })
    .unwrap();
    let found = inspector.finish();
    println!(
        "looked through {} snapshots in {:.1} s; largest memory {:.0} MB ({kept})",
        found.samples,
        start.elapsed().as_secs_f64(),
        memory_mb("VmHWM")
    );
    assert_eq!(found.samples, rows);
    assert!(memory_mb("VmHWM") < 2000.0);
    std::fs::remove_dir_all(folder).unwrap();
}
