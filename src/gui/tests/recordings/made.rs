//! Recordings that are made, opened by their path, dropped, and how their time is counted.

use super::*;
use crate::gui::services::{DialogKind, Folder};

#[test]
fn time_is_counted_from_the_beginning_of_the_recording_in_player_and_plots() {
    let mut h = harness(app(Theme::Dark));
    h.run_steps(3);
    load(&mut h, "first", "Load and play");
    // Its session had lasted 100 s when it began.
    h.get_by_label_contains(" of 0:40");
    let plot = h
        .get_by_role_and_label(egui::accesskit::Role::Image, "x / mm")
        .rect();
    for part in 1..20 {
        let at = plot.left_top() + plot.size() * egui::vec2(0.9, 0.05 * part as f32);
        h.hover_at(at);
        h.run_steps(4);
        if h.query_by_label_contains(" at 0:3").is_some() {
            return;
        }
        let session_time = h.query_by_label_contains(" at 2:1").is_some();
        assert!(
            !session_time,
            "the plot counts from the session's beginning"
        );
    }
    panic!("no value was told on a vertical line through the plot");
}

#[test]
fn a_dropped_file_is_played_alone_also_while_two_were_compared() {
    let mut h = both();
    press(&mut h, "A − B");
    let file = Dropped("elsewhere/cut.rrd".into());
    h.input_mut().dropped_files.push(Arc::new(file));
    h.run_steps(4);
    assert_eq!(title(&h), "cut");
    let pair = &h.state().screens.library.pair;
    assert_eq!(
        pair.compared,
        Compared::One,
        "the plots show what was dropped"
    );
    assert!(pair.other.is_some(), "B is at hand");
}

#[test]
fn without_a_dialog_the_path_is_typed_and_that_is_said_once() {
    let mut h = harness(app(Theme::Dark));
    h.run_steps(3);
    let said = "type the path, then press Enter";
    h.get_by_label("Browse…").click();
    h.run_steps(4);
    h.get_by_label_contains(said);
    // The field waits for the path.
    h.get_by_label("Path of a recording")
        .type_text("elsewhere/first.rrd");
    h.run_steps(2);
    assert!(h.query_by_label_contains(said).is_none());
    h.key_press(Key::Enter);
    h.run_steps(4);
    assert_eq!(title(&h), "first");
    h.get_by_label("Browse…").click();
    h.run_steps(4);
    assert!(h.query_by_label_contains(said).is_none(), "once is enough");
}

#[test]
fn a_recording_gets_its_file_elsewhere_and_is_listed_when_it_has_ended() {
    let (twin, handle) = twin(fixture::snapshot(1.0));
    let found = Arc::new(Mutex::new(vec![entry("first", None)]));
    let names = Arc::new(Mutex::new(Vec::<(PathBuf, Worker<PathBuf>)>::new()));
    let (list, asked) = (Arc::clone(&found), Arc::clone(&names));
    let services = Services {
        scan: Box::new(move |_| Job::ready(Ok(list.lock().expect("not poisoned").clone()))),
        new_recording: Box::new(move |folder, _| {
            let (job, worker) = Job::pair();
            let mut asked = asked.lock().expect("not poisoned");
            asked.push((folder.to_owned(), worker));
            job
        }),
        recordings: Folder::of("/home/person/recordings".into()),
        ..Services::none()
    };
    let mut app = App::new(Some(handle), RobotSpec::reference(), services);
    app.screen = ScreenId::Recordings;
    let mut h = harness(app);
    h.run_steps(3);
    h.get_by_label("/home/person/recordings");
    h.get_by_label("● REC").click();
    // The disk takes its time; the window does not wait for it.
    h.run_steps(5);
    assert!(is_disabled(&h, "● REC"));
    assert_eq!(twin.taken(), []);
    let (folder, worker) = names.lock().expect("not poisoned").remove(0);
    assert_eq!(folder, Path::new("/home/person/recordings"));
    let path = folder.join("2026-11-23_14-05-12.rrd");
    worker.finish(Ok(path.clone()));
    h.run_steps(3);
    assert_eq!(twin.taken(), [Command::StartRecording(path.clone())]);
    let mut s = fixture::snapshot(1.1);
    s.recording = Some("2026-11-23_14-05-12".into());
    twin.publish(s);
    let say = |text: &str| {
        let event = Event::Recording {
            stamp: Stamp::ZERO,
            text: text.into(),
        };
        twin.events.try_send(event).expect("room");
    };
    say("Recording to 2026-11-23_14-05-12.rrd.");
    h.run_steps(3);
    assert!(h.query_by_label("first").is_some());
    let written = RecordingEntry {
        path,
        name: "2026-11-23_14-05-12".into(),
        ..entry("", None)
    };
    found.lock().expect("not poisoned").insert(0, written);
    twin.publish(fixture::snapshot(1.2));
    say("Recorded 2026-11-23_14-05-12.rrd (20 snapshots).");
    h.run_steps(4);
    control(&h, "2026-11-23_14-05-12");
}

#[test]
fn a_recording_without_a_file_says_why_on_every_screen() {
    let (_twin, handle) = twin(fixture::snapshot(1.0));
    let services = Services {
        new_recording: Box::new(|_, _| Job::ready(Err("The folder /x cannot be made.".into()))),
        ..Services::none()
    };
    let mut h = harness(App::new(Some(handle), RobotSpec::reference(), services));
    h.run_steps(3);
    h.state_mut().screen = ScreenId::Recordings;
    h.run_steps(2);
    h.get_by_label("● REC").click();
    h.run_steps(2);
    h.state_mut().screen = ScreenId::Sensors;
    h.run_steps(4);
    let said = "Nothing is recorded. The folder /x cannot be made.";
    assert!(h.query_all_by_label_contains(said).next().is_some());
}

#[test]
fn another_folder_is_recorded_to_and_looked_through_and_is_kept() {
    let asked = Arc::new(Mutex::new(Vec::<PathBuf>::new()));
    let mut app = app(Theme::Dark);
    let to = Arc::clone(&asked);
    app.services.scan = Box::new(move |folder| {
        to.lock().expect("not poisoned").push(folder.to_owned());
        Job::ready(Ok(Vec::new()))
    });
    app.services.pick = Box::new(|dialog| {
        assert_eq!(dialog.kind, DialogKind::Folder);
        Job::ready(Ok(Picked::Path("/disk/runs".into())))
    });
    let mut h = harness(app);
    h.run_steps(3);
    press(&mut h, "Change folder…");
    h.get_by_label("Folder for recordings");
    h.get_by_label("Browse for a folder").click();
    h.run_steps(4);
    h.get_by_label("/disk/runs");
    let folders = asked.lock().expect("not poisoned").clone();
    assert_eq!(folders, [PathBuf::from("recordings"), "/disk/runs".into()]);
    press(&mut h, "Change folder…");
    press(&mut h, "Default");
    h.get_by_label("recordings");
}
