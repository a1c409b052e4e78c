//! Changes of a recording's note and marks.

use std::path::Path;

use super::notes::Notes;
use super::{Annotations, NoteChange, RecordingError, RecordingFile};

/// Note and marks of a recording as they are now.
///
/// # Errors
/// As [`RecordingFile::open`] and [`RecordingFile::marks`].
pub fn annotations(recording: &Path) -> Result<Annotations, RecordingError> {
    let file = RecordingFile::open(recording)?;
    Ok(Annotations {
        note: file.meta().note.clone(),
        marks: file.marks()?,
    })
}

/// Changes note and marks of a recording, and returns them as they are then. The recording itself is not touched.
///
/// # Errors
/// As [`annotations`]; [`RecordingError::Session`] when the notes that are there are damaged, or a mark to be removed
/// is not there; [`RecordingError::Io`] when they cannot be written.
pub fn annotate(recording: &Path, changes: &[NoteChange]) -> Result<Annotations, RecordingError> {
    let file = RecordingFile::open(recording)?;
    let mut marks = file.marks()?;
    for change in changes {
        match change {
            NoteChange::Note(_) => {}
            NoteChange::Add(mark) => marks.push(mark.clone()),
            NoteChange::Remove(mark) => {
                let Some(at) = marks.iter().position(|m| m == mark) else {
                    return Err(RecordingError::Session {
                        path: recording.to_owned(),
                        text: format!(
                            "there is no mark \"{}\" at {} s",
                            mark.text,
                            mark.stamp.seconds()
                        ),
                    });
                };
                marks.remove(at);
            }
        }
    }
    let mut notes = Notes::to_change(recording, &file.meta().id)?;
    changes.iter().for_each(|change| notes.change(change));
    notes.write(recording)?;
    annotations(recording)
}

#[cfg(all(test, feature = "rrd"))]
mod tests {
    use std::path::PathBuf;

    use super::*;
    use crate::recording::{
        MARKS, Mark, RecordingMeta, RecordingWriter, Selection, join, read_rrd,
    };
    use crate::recording::{notes_path, segment_path};
    use crate::signal::Snapshot;
    use crate::signal::Stamp;

    fn temp(name: &str) -> PathBuf {
        let name = format!("springtwin-notes-{name}-{}.rrd", std::process::id());
        std::env::temp_dir().join(name)
    }

    fn mark(at_s: f64, text: &str) -> Mark {
        Mark {
            stamp: Stamp::from_seconds(at_s),
            text: text.to_owned(),
        }
    }

    /// Ten seconds, with marks at 2 and 6 s and a note that was changed under way.
    fn record(path: &Path) {
        let meta = RecordingMeta {
            note: "as begun".to_owned(),
            ..RecordingMeta::default()
        };
        let mut writer = RecordingWriter::create(path, meta).expect("writes");
        for n in 0..1000 {
            let stamp = Stamp(n * 10_000_000);
            match n {
                200 => writer.mark(stamp, "two").expect("writes"),
                300 => writer.note("third chamber leaks").expect("writes"),
                600 => writer.mark(stamp, "six").expect("writes"),
                _ => {}
            }
            let snapshot = Snapshot {
                stamp,
                ..Snapshot::default()
            };
            writer.push(&snapshot).expect("writes");
        }
        writer.finish().expect("writes");
    }

    fn clean(paths: &[&Path]) {
        for path in paths {
            let _ = std::fs::remove_file(notes_path(path));
            std::fs::remove_file(path).expect("writes");
        }
    }

    #[test]
    fn marks_and_note_of_a_recording_change_without_a_change_of_its_file() {
        let path = temp("change");
        record(&path);
        let bytes = std::fs::read(&path).unwrap();
        let found = annotations(&path).unwrap();
        assert_eq!(found.note, "third chamber leaks");
        assert_eq!(found.marks, [mark(2.0, "two"), mark(6.0, "six")]);
        assert!(!notes_path(&path).exists());
        let changed = annotate(
            &path,
            &[
                NoteChange::Add(mark(4.25, "four")),
                NoteChange::Remove(mark(6.0, "six")),
                NoteChange::Note("repaired".to_owned()),
            ],
        );
        let changed = changed.unwrap();
        assert_eq!(changed.note, "repaired");
        assert_eq!(changed.marks, [mark(2.0, "two"), mark(4.25, "four")]);
        // What was added goes without a trace; what is in the recording comes back.
        let changed = annotate(&path, &[NoteChange::Remove(mark(4.25, "four"))]);
        assert_eq!(changed.unwrap().marks, [mark(2.0, "two")]);
        let gone = annotate(&path, &[NoteChange::Remove(mark(6.0, "six"))]);
        assert!(gone.unwrap_err().to_string().contains("no mark"));
        assert_eq!(std::fs::read(&path).unwrap(), bytes);
        let read = read_rrd(&path).unwrap();
        assert_eq!(read.meta.note, "repaired");
        let marks = read.events.iter().filter(|e| e.log == MARKS);
        assert_eq!(marks.map(|e| e.text.as_str()).collect::<Vec<_>>(), ["two"]);
        clean(&[&path]);
    }

    #[test]
    fn notes_of_another_recording_and_damaged_ones_are_left_alone() {
        let path = temp("other");
        record(&path);
        annotate(&path, &[NoteChange::Note("of the first".to_owned())]).unwrap();
        // Another recording takes its place.
        record(&path);
        assert_eq!(annotations(&path).unwrap().note, "third chamber leaks");
        std::fs::write(notes_path(&path), "format = \n").unwrap();
        assert_eq!(annotations(&path).unwrap().note, "third chamber leaks");
        let refused = annotate(&path, &[NoteChange::Note("x".to_owned())]);
        assert!(refused.unwrap_err().to_string().contains("line 1"));
        let kept = std::fs::read_to_string(notes_path(&path)).unwrap();
        assert_eq!(kept, "format = \n");
        clean(&[&path]);
    }

    #[test]
    fn a_part_has_the_marks_in_its_range_and_the_newest_note() {
        let [path, out, both] = ["whole", "part", "both"].map(temp);
        record(&path);
        let changes = [
            NoteChange::Add(mark(4.25, "four")),
            NoteChange::Add(mark(8.0, "eight")),
            NoteChange::Remove(mark(2.0, "two")),
            NoteChange::Note("afterwards".to_owned()),
        ];
        annotate(&path, &changes).unwrap();
        let file = RecordingFile::open(&path).unwrap();
        let meta = |id: &str| RecordingMeta {
            id: id.to_owned(),
            ..file.meta().clone()
        };
        let [first, second] =
            [(1.0, 5.0), (6.0, 7.0)].map(|(from, to)| Selection::between(Some(from), Some(to)));
        join(&[(&file, first)], &out, meta("part")).unwrap();
        let part = annotations(&out).unwrap();
        assert_eq!(part.marks, [mark(4.25, "four")]);
        assert_eq!(part.note, "afterwards");
        join(&[(&file, first), (&file, second)], &both, meta("both")).unwrap();
        let joined = annotations(&both).unwrap();
        assert_eq!(joined.marks, [mark(4.25, "four"), mark(6.0, "six")]);
        // A part that is read has them, too.
        let read = file.read(&second, &mut |_| true).unwrap();
        let marks = read.events.iter().filter(|e| e.log == MARKS);
        assert_eq!(marks.count(), 1);
        clean(&[&path, &out, &both]);
    }

    #[test]
    fn what_is_computed_from_a_recording_keeps_its_marks() {
        let [path, out] = ["read", "written"].map(temp);
        record(&path);
        annotate(&path, &[NoteChange::Add(mark(4.25, "four"))]).unwrap();
        let read = read_rrd(&path).unwrap();
        let source = RecordingFile::open(&path).unwrap();
        let mut writer = RecordingWriter::create_like(&out, read.meta.clone(), &source).unwrap();
        writer
            .push_read(read.trace.snapshots, &read.events)
            .unwrap();
        writer.finish().unwrap();
        let written = annotations(&out).unwrap();
        let marks = [mark(2.0, "two"), mark(4.25, "four"), mark(6.0, "six")];
        assert_eq!(written.marks, marks);
        clean(&[&path, &out]);
    }

    #[test]
    fn marks_and_the_newest_note_of_all_segments_are_found() {
        let path = temp("segments");
        let meta = RecordingMeta::default();
        let writer = RecordingWriter::create_in_segments(&path, meta, 2.0, u64::MAX);
        let mut writer = writer.unwrap();
        for n in 0..500 {
            let stamp = Stamp(n * 10_000_000);
            if n % 200 == 100 {
                writer.mark(stamp, "here").unwrap();
            }
            if n == 300 {
                writer.note("of the second").unwrap();
            }
            let snapshot = Snapshot {
                stamp,
                ..Snapshot::default()
            };
            writer.push(&snapshot).unwrap();
        }
        assert_eq!(writer.finish().unwrap().segments, 3);
        let found = annotations(&path).unwrap();
        assert_eq!(found.note, "of the second");
        assert_eq!(found.marks, [mark(1.0, "here"), mark(3.0, "here")]);
        let part = |number| segment_path(&path, number);
        clean(&[&path, &part(2), &part(3)]);
    }

    #[test]
    fn a_mark_is_in_the_file_at_once_and_survives_a_kill() {
        let path = temp("kill");
        let mut writer = RecordingWriter::create(&path, RecordingMeta::default()).unwrap();
        let snapshot = |n: i64| Snapshot {
            stamp: Stamp(n * 10_000_000),
            ..Snapshot::default()
        };
        for n in 0..30 {
            writer.push(&snapshot(n)).unwrap();
        }
        writer.mark(Stamp::from_seconds(0.3), "here").unwrap();
        let found = annotations(&path).unwrap();
        assert_eq!(found.marks, [mark(0.3, "here")]);
        drop(writer);
        clean(&[&path]);
    }
}
