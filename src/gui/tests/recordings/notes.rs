//! Notes and marks: while recording, afterwards, on the time line, in the library's search.

use super::*;
use crate::gui::panels::rec::MENU;
use crate::signal::{Annotations, Mark, NoteChange};

fn marked(at_s: f64, text: &str) -> Mark {
    Mark {
        stamp: Stamp::from_seconds(at_s),
        text: text.to_owned(),
    }
}

/// A library whose first recording has a note and marks that can be changed.
fn window() -> (Harness<'static, App>, Arc<Mutex<Vec<NoteChange>>>) {
    let asked = Arc::new(Mutex::new(Vec::new()));
    let changes = Arc::clone(&asked);
    let mut now = Annotations {
        note: "third chamber leaks".into(),
        marks: vec![marked(110.0, "valve clicks")],
    };
    let first = now.clone();
    let mut app = app(Theme::Dark);
    app.services.load = Box::new(move |path| {
        let loaded = answer(path).map(|mut loaded| {
            loaded.about.annotate(first.clone());
            loaded
        });
        Job::ready(loaded.and_then(indexed))
    });
    app.services.scan = Box::new(|_| {
        let noted = vec!["third chamber leaks".to_owned(), "valve clicks".to_owned()];
        let first = RecordingEntry {
            noted,
            ..entry("first", None)
        };
        Job::ready(Ok(vec![first, entry("second", None)]))
    });
    app.services.annotate = Box::new(move |path, wanted| {
        assert_eq!(path, Path::new("recordings/first.rrd"));
        for change in &wanted {
            match change {
                NoteChange::Note(text) => now.note.clone_from(text),
                NoteChange::Add(mark) => now.marks.push(mark.clone()),
                NoteChange::Remove(mark) => now.marks.retain(|m| m != mark),
            }
        }
        changes.lock().expect("not poisoned").extend(wanted);
        Job::ready(Ok(now.clone()))
    });
    let mut h = harness(app);
    h.run_steps(3);
    load(&mut h, "first", "Load and play");
    (h, asked)
}

fn position_s(h: &Harness<'_, App>) -> f64 {
    h.state().player.as_ref().expect("is played").position_s
}

#[test]
fn marks_are_on_the_time_line_and_a_click_jumps_to_them() {
    let (mut h, _) = window();
    h.get_by_label("Jump to the mark valve clicks").click();
    h.run_steps(3);
    assert!((position_s(&h) - 10.0).abs() < 1e-9);
}

#[test]
fn marks_and_the_note_are_changed_afterwards() {
    let (mut h, asked) = window();
    h.get_by_label("Note and marks (1)").click();
    h.run_steps(3);
    h.state_mut().player.as_mut().expect("is played").position_s = 20.0;
    type_into(&mut h, "Text of the mark", "touched");
    h.get_by_label("Add mark").click();
    h.run_steps(4);
    control(&h, "Jump to the mark touched");
    h.get_by_label("Edit the mark touched").click();
    h.run_steps(2);
    type_into(&mut h, "Text of the mark", " twice");
    h.get_by_label("Save mark").click();
    h.run_steps(4);
    h.get_by_label("Remove the mark valve clicks").click();
    h.run_steps(4);
    type_into(&mut h, "Note on the recording", ", repaired");
    h.get_by_label("Save note").click();
    h.run_steps(4);
    assert!(is_disabled(&h, "Save note"), "it is saved");
    let [touched, twice] = ["touched", "touched twice"].map(|text| marked(120.0, text));
    let expected = [
        NoteChange::Add(touched.clone()),
        NoteChange::Remove(touched),
        NoteChange::Add(twice.clone()),
        NoteChange::Remove(marked(110.0, "valve clicks")),
        NoteChange::Note("third chamber leaks, repaired".into()),
    ];
    assert_eq!(*asked.lock().expect("not poisoned"), expected);
    let about = &h.state().player.as_ref().expect("is played").about;
    assert_eq!(about.marks().collect::<Vec<_>>(), [twice]);
}

#[test]
fn the_library_finds_recordings_by_note_and_mark() {
    let (mut h, _) = window();
    control(&h, "second");
    type_into(&mut h, "Search the library", "VALVE");
    h.run_steps(2);
    assert!(h.query_by_label("second").is_none());
    control(&h, "first");
    type_into(&mut h, "Search the library", "x");
    h.run_steps(2);
    assert!(h.query_by_label_contains("Nothing is found").is_some());
}

#[test]
fn a_recording_under_way_is_marked_by_key_button_and_text() {
    let (twin, handle) = twin(fixture::snapshot(1.0));
    let mut app = App::new(Some(handle), RobotSpec::reference(), Services::none());
    app.screen = ScreenId::Recordings;
    let mut h = harness(app);
    h.run_steps(3);
    h.get_by_label(MENU).click();
    h.run_steps(3);
    assert!(h.query_by_label("Mark moment").is_none());
    type_into(&mut h, "Recording: note", "new valve");
    h.get_by_label("● REC").click();
    h.run_steps(4);
    let path = PathBuf::from("recordings/recording.rrd");
    let note = Command::Note("new valve".into());
    assert_eq!(twin.taken(), [Command::StartRecording(path), note]);
    let mut s = fixture::snapshot(1.1);
    s.recording = Some("recording".into());
    twin.publish(s);
    h.run_steps(3);
    h.get_by_label(MENU).click();
    h.run_steps(3);
    type_into(&mut h, "Recording: text of the mark", "touched");
    h.get_by_label("Mark moment").click();
    h.run_steps(3);
    h.key_press(Key::Escape);
    h.run_steps(3);
    h.key_press(Key::M);
    h.run_steps(3);
    let marks = ["touched", ""].map(|text| Command::Mark(text.into()));
    assert_eq!(twin.taken(), marks);
}
