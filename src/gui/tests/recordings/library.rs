//! The list: its order, what can be done in a row, names, what is new, and what is shown of the selected recording.

use super::*;
use crate::gui::panels::recordings::{By, Sort};
use crate::gui::services::Begun;
use crate::signal::{Annotations, NoteChange};

fn dated(name: &str, unix_s: i64) -> RecordingEntry {
    RecordingEntry {
        begun: Some(Begun {
            unix_s,
            local: format!("2026-11-23 14:0{unix_s}"),
        }),
        ..entry(name, None)
    }
}

type Listed = Arc<Mutex<Vec<RecordingEntry>>>;

fn window() -> (Harness<'static, App>, Listed) {
    let sample = RecordingEntry {
        sample: true,
        ..dated("a-sample", 9)
    };
    let all = vec![
        dated("second", 5),
        sample,
        dated("first", 3),
        dated("cut", 7),
    ];
    let listed: Listed = Arc::new(Mutex::new(all));
    let of = Arc::clone(&listed);
    let mut app = app(Theme::Dark);
    app.services.scan = Box::new(move |_| Job::ready(Ok(of.lock().expect("not poisoned").clone())));
    let mut h = harness(app);
    h.run_steps(4);
    (h, listed)
}

/// The rows from top to bottom.
fn rows(h: &Harness<'_, App>) -> Vec<String> {
    let mut all: Vec<(f32, String)> = ["first", "second", "cut", "a-sample", "leak"]
        .iter()
        .filter(|name| h.query_by_label(name).is_some())
        .map(|name| (control(h, name).rect().top(), (*name).to_owned()))
        .collect();
    all.sort_by(|a, b| a.0.total_cmp(&b.0));
    all.into_iter().map(|(_, name)| name).collect()
}

fn choose(h: &mut Harness<'_, App>, name: &str, act: &str) {
    h.get_by_label(&format!("More for {name}")).click();
    h.run_steps(3);
    h.get_by_label(act).click();
    h.run_steps(4);
}

#[test]
fn the_newest_is_first_and_a_press_on_a_head_orders_the_list() {
    let (mut h, _) = window();
    assert_eq!(rows(&h), ["cut", "second", "first", "a-sample"]);
    h.get_by_label("2026-11-23 14:07");
    press(&mut h, "Sort by date");
    assert_eq!(rows(&h), ["first", "second", "cut", "a-sample"]);
    press(&mut h, "Sort by name");
    assert_eq!(rows(&h), ["cut", "first", "second", "a-sample"]);
    let sort = Sort {
        by: By::Name,
        reversed: true,
    };
    press(&mut h, "Sort by name");
    assert_eq!(h.state().screens.library.sort, sort);
    assert_eq!(rows(&h), ["second", "first", "cut", "a-sample"]);
}

#[test]
fn a_recording_reaches_the_gap_screen_from_its_row_and_as_the_selected_one() {
    let (mut h, _) = window();
    let asked = Arc::new(Mutex::new(Vec::<PathBuf>::new()));
    let to = Arc::clone(&asked);
    h.state_mut().services.gap.look = Box::new(move |path| {
        to.lock().expect("not poisoned").push(path.to_owned());
        Job::ready(Err("It cannot be read here.".into()))
    });
    let path = |name: &str| PathBuf::from(format!("recordings/{name}.rrd"));
    choose(&mut h, "second", "Use as healthy session");
    assert_eq!(h.state().screen, ScreenId::Gap);
    let value = |h: &Harness<'_, App>, part: &str| {
        let name = format!("Path of the {part} session");
        h.get_by_label(&name).accesskit_node().value()
    };
    assert_eq!(value(&h, "healthy").as_deref(), path("second").to_str());
    h.state_mut().screen = ScreenId::Recordings;
    h.run_steps(3);
    h.get_by_label("cut").click();
    h.run_steps(3);
    h.get_by_label("Use as suspect session").click();
    h.run_steps(4);
    assert_eq!(h.state().screen, ScreenId::Gap);
    assert_eq!(value(&h, "suspect").as_deref(), path("cut").to_str());
    let asked = asked.lock().expect("not poisoned");
    assert_eq!(*asked, [path("second"), path("cut")]);
}

#[test]
fn a_recording_gets_another_name_and_a_refusal_is_shown() {
    let (mut h, listed) = window();
    let of = Arc::clone(&listed);
    h.state_mut().services.rename = Box::new(move |path, name| {
        if name == "cut" {
            return Job::ready(Err("recordings/cut.rrd is there already.".into()));
        }
        let new = path.with_file_name(format!("{name}.rrd"));
        for e in of.lock().expect("not poisoned").iter_mut() {
            if e.path == path {
                (e.path, e.name) = (new.clone(), name.to_owned());
            }
        }
        Job::ready(Ok(new))
    });
    let name = |h: &mut Harness<'_, App>, text: &str| {
        choose(h, "first", "Rename…");
        assert!(is_disabled(h, "Rename"), "it has this name already");
        h.key_press_modifiers(Modifiers::COMMAND, Key::A);
        h.run_steps(2);
        h.get_by_label("New name of the recording").type_text(text);
        h.run_steps(3);
        h.get_by_label("Rename").click();
        h.run_steps(5);
    };
    name(&mut h, "cut");
    h.get_by_label_contains("is there already");
    assert_eq!(rows(&h), ["cut", "second", "first", "a-sample"]);
    press(&mut h, "Close the message");
    press(&mut h, "Use as suspect session");
    assert_eq!(h.state().screen, ScreenId::Gap);
    h.state_mut().screen = ScreenId::Recordings;
    h.run_steps(3);
    name(&mut h, "leak");
    assert_eq!(rows(&h), ["cut", "second", "leak", "a-sample"]);
    let library = &h.state().screens.library;
    assert_eq!(library.selected, Some("recordings/leak.rrd".into()));
    assert!(h.query_by_label_contains("● new").is_none());
    // The finder's suspect session, too.
    h.state_mut().screen = ScreenId::Gap;
    h.run_steps(3);
    let suspect = h.get_by_label("Path of the suspect session");
    assert_eq!(
        suspect.accesskit_node().value().as_deref(),
        Some("recordings/leak.rrd")
    );
}

#[test]
fn what_is_played_recorded_or_a_sample_keeps_its_name() {
    let (mut h, _) = window();
    let refused = |h: &mut Harness<'_, App>, name: &str| {
        h.get_by_label(&format!("More for {name}")).click();
        h.run_steps(3);
        let refused = is_disabled(h, "Rename…");
        h.key_press(Key::Escape);
        h.run_steps(3);
        refused
    };
    assert!(refused(&mut h, "a-sample") && !refused(&mut h, "first"));
    load(&mut h, "first", "Load and play");
    assert!(refused(&mut h, "first") && !refused(&mut h, "second"));
    h.state_mut().screens.library.under_way = Some("second".into());
    h.run_steps(2);
    assert!(refused(&mut h, "second") && !refused(&mut h, "cut"));
    // In the top bar and in the row.
    for text in ["● REC", "A"] {
        assert_eq!(h.query_all_by_label(text).count(), 2, "{text}");
    }
}

#[test]
fn what_appears_is_marked_as_new_until_it_is_selected() {
    let (mut h, listed) = window();
    assert!(h.query_by_label("● new").is_none());
    h.get_by_label("cut").click();
    h.run_steps(3);
    let new = dated("leak", 8);
    listed.lock().expect("not poisoned").push(new);
    // Another program has made it: it is found as the screen is entered.
    h.state_mut().screen = ScreenId::Sensors;
    h.run_steps(3);
    h.state_mut().screen = ScreenId::Recordings;
    h.run_steps(4);
    assert_eq!(rows(&h), ["leak", "cut", "second", "first", "a-sample"]);
    h.get_by_label("● new");
    h.get_by_label("leak").click();
    h.run_steps(3);
    assert!(h.query_by_label("● new").is_none());
}

#[test]
fn what_is_in_the_selected_recording_is_shown_and_played_without_reading_it_again() {
    let (mut h, _) = window();
    let read = Arc::new(Mutex::new(0));
    let count = Arc::clone(&read);
    h.state_mut().services.load = Box::new(move |path| {
        *count.lock().expect("not poisoned") += 1;
        Job::ready(answer(path).and_then(indexed))
    });
    h.get_by_label_contains("Select one in the list");
    h.get_by_label("first").click();
    h.run_steps(4);
    h.get_by_label_contains("2026-11-23 14:03 (local) · length 0:40");
    h.get_by_role_and_label(egui::accesskit::Role::Image, "x / mm");
    h.get_by_label_contains("2 gaps in time");
    assert!(h.state().player.is_none(), "nothing is played");
    h.get_by_label("Load and play").click();
    h.run_steps(4);
    assert_eq!(title(&h), "first");
    assert_eq!(*read.lock().expect("not poisoned"), 1);
}

#[test]
fn the_note_on_the_selected_recording_is_changed_without_playing_it() {
    let (mut h, _) = window();
    let asked = Arc::new(Mutex::new(Vec::<String>::new()));
    let to = Arc::clone(&asked);
    h.state_mut().services.annotate = Box::new(move |path, changes| {
        let [NoteChange::Note(note)] = changes.as_slice() else {
            panic!("{changes:?}");
        };
        let mut asked = to.lock().expect("not poisoned");
        asked.push(format!("{}: {note}", path.display()));
        Job::ready(Ok(Annotations {
            note: note.clone(),
            marks: Vec::new(),
        }))
    });
    h.get_by_label("first").click();
    h.run_steps(4);
    assert!(is_disabled(&h, "Save note"), "it is as it was saved");
    type_into(&mut h, "Note on the selected recording", "leaks");
    h.get_by_label("Save note").click();
    h.run_steps(5);
    assert_eq!(
        *asked.lock().expect("not poisoned"),
        ["recordings/first.rrd: leaks"]
    );
    assert!(is_disabled(&h, "Save note"));
    // It is the note of the recording that is loaded now, too.
    h.get_by_label("Load and play").click();
    h.run_steps(4);
    let player = h.state().player.as_ref().expect("played");
    assert_eq!(player.about.note, "leaks");
}

#[test]
fn a_right_click_opens_the_menu_of_a_row() {
    let (mut h, _) = window();
    h.get_by_label("second").click_secondary();
    h.run_steps(3);
    h.get_by_label("Compare as B").click();
    h.run_steps(4);
    assert_eq!(title(&h), "second");
    assert_eq!(h.state().screens.library.pair.played, Side::B);
}

#[test]
fn of_a_long_list_only_what_is_near_sight_is_laid_out() {
    let (mut h, listed) = window();
    let many = (0..500).map(|n| entry(&format!("r{n:03}"), None));
    listed.lock().expect("not poisoned").extend(many);
    press(&mut h, "↻ Refresh");
    h.run_steps(4);
    assert_eq!(h.state().screens.library.entries.len(), 504);
    let rows = h.query_all_by_label_contains("More for r").count();
    assert!((10..60).contains(&rows), "{rows} rows");
    press(&mut h, "Sort by name");
    press(&mut h, "Sort by name");
    h.run_steps(3);
    h.get_by_label("More for r499");
}

#[test]
fn it_is_drawn() {
    for size in [[1024.0, 700.0], [1280.0, 760.0], [2560.0, 1440.0]] {
        for selected in [false, true] {
            let mut app = app(Theme::Dark);
            if selected {
                app.screens.library.selected = Some("recordings/first.rrd".into());
            }
            let name = format!("library-{}-{selected}", size[0]);
            pictures::picture(&name, size, Theme::Dark, app);
        }
    }
}
