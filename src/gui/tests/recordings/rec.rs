//! REC in the top bar: a recording begins and ends on every screen, with its name and its note.

use super::*;
use crate::gui::panels::rec::MENU;
use crate::gui::services::Space;

/// A window onto an arm whose recordings are named as they are called.
fn window(first: Snapshot) -> (Twin, Harness<'static, App>) {
    let (twin, handle) = twin(first);
    let services = Services {
        new_recording: Box::new(|folder, name| {
            Job::ready(Ok(folder.join(format!("2026-11-23_14-05-12_{name}.rrd"))))
        }),
        space: Box::new(|_, name| {
            Job::ready(Ok(Space {
                free_bytes: Some(57_300_000_000),
                written_bytes: if name.is_empty() { 0 } else { 6_000_000 },
                local: "2026-11-23 14:05".into(),
            }))
        }),
        ..services()
    };
    let mut h = harness(App::new(Some(handle), RobotSpec::reference(), services));
    h.run_steps(3);
    (twin, h)
}

/// What the twin was ordered about recordings.
fn of_recording(twin: &Twin) -> Vec<Command> {
    use Command::{Note, StartRecording, StopRecording};
    let mut all = twin.taken();
    all.retain(|c| matches!(c, StartRecording(_) | StopRecording | Note(_)));
    all
}

fn recorded(t_s: f64) -> Snapshot {
    Snapshot {
        recording: Some("2026-11-23_14-05-12_leak".into()),
        ..fixture::snapshot(t_s)
    }
}

#[test]
fn a_recording_begins_and_ends_on_every_screen_with_name_and_note() {
    for screen in ScreenId::ALL {
        let (twin, mut h) = window(fixture::snapshot(1.0));
        h.state_mut().screen = screen;
        h.run_steps(3);
        h.get_by_label(MENU).click();
        h.run_steps(3);
        type_into(&mut h, "Recording: name", "leak");
        type_into(&mut h, "Recording: note", "third chamber");
        h.get_by_label("● REC").click();
        h.run_steps(4);
        let path = PathBuf::from("recordings/2026-11-23_14-05-12_leak.rrd");
        let note = Command::Note("third chamber".into());
        let expected = [Command::StartRecording(path), note];
        assert_eq!(of_recording(&twin), expected, "{screen:?}");
        twin.publish(recorded(1.1));
        h.run_steps(3);
        assert!(h.query_by_label("● REC").is_none(), "{screen:?}");
        h.get_by_label("■ REC").click();
        h.run_steps(3);
        assert_eq!(of_recording(&twin), [Command::StopRecording], "{screen:?}");
        // What was typed was for that one.
        twin.publish(fixture::snapshot(1.2));
        h.run_steps(3);
        h.get_by_label("● REC").click();
        h.run_steps(4);
        let unnamed = PathBuf::from("recordings/2026-11-23_14-05-12_.rrd");
        assert_eq!(of_recording(&twin), [Command::StartRecording(unnamed)]);
    }
}

#[test]
fn enter_in_the_name_begins_and_a_note_that_is_changed_under_way_is_sent_once() {
    let (twin, mut h) = window(fixture::snapshot(1.0));
    h.get_by_label(MENU).click();
    h.run_steps(3);
    type_into(&mut h, "Recording: name", "leak");
    h.key_press(Key::Enter);
    h.run_steps(4);
    assert_eq!(of_recording(&twin).len(), 1);
    twin.publish(recorded(1.1));
    h.run_steps(3);
    type_into(&mut h, "Recording: note", "third");
    assert_eq!(of_recording(&twin), [], "it is still being typed");
    h.key_press(Key::Escape);
    h.run_steps(3);
    assert_eq!(of_recording(&twin), [Command::Note("third".into())]);
}

#[test]
fn the_menu_shows_the_space_that_is_left_and_for_how_long_it_lasts() {
    let (twin, mut h) = window(fixture::snapshot(1.0));
    h.state_mut().screen = ScreenId::Recordings;
    h.run_steps(4);
    h.state_mut().screen = ScreenId::Operate;
    h.run_steps(2);
    h.get_by_label(MENU).click();
    h.run_steps(4);
    h.get_by_label_contains("2026-11-23 14:05 (local)");
    // 1.24 MB in 40 s.
    h.get_by_label("57.3 GB free: about 513 h at the rate of the last recording");
    twin.publish(recorded(2.0));
    h.run_steps(2);
    twin.publish(recorded(62.0));
    // Until it is measured again, 2 s later.
    h.run_steps(14);
    h.get_by_label("57.3 GB free: about 159 h at the present rate");
}

#[test]
fn it_fits_beside_everything_else_in_the_smallest_window() {
    let mut s = recorded(3.0);
    s.mode = Mode::Hold;
    s.link.simulated = false;
    s.link.board_simulated = [Some(false); crate::signal::BOARDS];
    let (twin, mut h) = window(fixture::snapshot(1.0));
    h.set_size([1024.0, 700.0].into());
    twin.publish(s);
    h.run_steps(4);
    let rect = |label: &str| control(&h, label).rect();
    let [source, rec, menu, hold] = ["HARDWARE", "■ REC", MENU, "▮▮ HOLD"].map(rect);
    let alarms = h.get_by_label_contains("alarms ").rect();
    assert!(rec.right() <= menu.left() && menu.right() <= alarms.left());
    assert!(alarms.right() <= hold.left());
    assert!(
        source.right() + 100.0 < rec.left(),
        "the state keeps its place: {rec:?}"
    );
}
