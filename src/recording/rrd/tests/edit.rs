//! Parts of recordings, and recordings of parts.

use super::*;
use crate::recording::join;

fn whole(n: i64, name: &str) -> (PathBuf, Vec<Snapshot>) {
    let path = temp(name);
    let mut written = snapshots(n);
    for (i, s) in written.iter_mut().enumerate() {
        // Set once, kept for long: stated in the first row of a batch only.
        s.goal = (i >= 30).then(|| Goal::position([0.01, 0.02, -0.3]));
    }
    write(&path, &written);
    (path, written)
}

fn part_of(written: &[Snapshot], from: usize, to: usize) -> Selection {
    Selection {
        from: Some(written[from].stamp),
        to: Some(written[to].stamp),
        at_least_apart_s: 0.0,
    }
}

/// A part holds the same snapshots, wherever in a batch it begins, and two of them make the whole again.
#[test]
fn parts_are_cut_and_put_together() {
    let (path, written) = whole(400, "to-cut");
    let file = RecordingFile::open(&path).unwrap();
    let out = ["cut-1", "cut-2", "joined"].map(temp);
    for (out, from, to) in [(&out[0], 0, 137), (&out[1], 138, 399)] {
        let summary = join(&[(&file, part_of(&written, from, to))], out, meta()).unwrap();
        assert_eq!(summary.rows as usize, to - from + 1);
        let read = read_rrd(out).unwrap();
        assert!(read.complete);
        assert_eq!(read.trace.snapshots.len(), to - from + 1);
        assert_same(&read.trace.snapshots, &written[from..=to]);
    }
    let parts = [&out[0], &out[1]].map(|p| RecordingFile::open(p).unwrap());
    let all = Selection::default();
    join(&[(&parts[0], all), (&parts[1], all)], &out[2], meta()).unwrap();
    let read = read_rrd(&out[2]).unwrap();
    assert_eq!(read.trace.snapshots.len(), 400);
    assert_same(&read.trace.snapshots, &written);
    assert!(read.events.iter().any(|e| e.text == "a line"));
    // What viewers draw is there once.
    let views = |path: &PathBuf| RecordingFile::open(path).unwrap().index.views.len();
    assert!(views(&out[2]) >= views(&path));

    let refused = join(&[(&parts[1], all), (&parts[0], all)], &out[2], meta());
    assert!(refused.unwrap_err().to_string().contains("in their order"));
    let behind = Selection::between(Some(1e4), None);
    let refused = join(&[(&file, behind)], &out[2], meta());
    assert!(refused.unwrap_err().to_string().contains("no snapshot"));
    for path in out.iter().chain([&path]) {
        std::fs::remove_file(path).unwrap();
    }
}

/// The same part gives the same bytes.
#[test]
fn equal_parts_are_equal_files() {
    let (path, written) = whole(200, "twice");
    let file = RecordingFile::open(&path).unwrap();
    let out = temp("twice-out");
    let bytes = || {
        join(&[(&file, part_of(&written, 20, 150))], &out, meta()).unwrap();
        std::fs::read(&out).unwrap()
    };
    assert!(bytes() == bytes());
    for path in [out, path] {
        std::fs::remove_file(path).unwrap();
    }
}

#[test]
fn a_recording_of_layout_1_is_cut() {
    let path =
        std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/it/golden/layout-1.rrd");
    let file = RecordingFile::open(&path).unwrap();
    let out = temp("cut-layout-1");
    join(
        &[(&file, Selection::between(Some(0.5), None))],
        &out,
        meta(),
    )
    .unwrap();
    let read = read_rrd(&out).unwrap().trace.snapshots;
    let whole = read_rrd(&path).unwrap().trace.snapshots;
    assert_same(&read, &whole[whole.len() - read.len()..]);
    assert!(read.len() > 90);
    std::fs::remove_file(out).unwrap();
}
