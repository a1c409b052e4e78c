//! The rolling recording: its state, its limit, and a recording of its last minutes.

use super::*;
use crate::gui::services::{Folder, RollingUse};
use crate::signal::RollingStatus;

type Kept = Arc<Mutex<Vec<(PathBuf, PathBuf, f64, String)>>>;

fn first() -> Arc<Path> {
    Path::new("/home/person/rolling/rolling_2026-11-23_14-05-12_ab.rrd").into()
}

/// A window on an arm with a rolling recording of that state.
fn app_of(rolling: RollingStatus) -> (Twin, App, Kept, Arc<Mutex<Vec<u64>>>) {
    let mut s = fixture::snapshot(1.0);
    s.rolling = rolling;
    let (twin, handle) = twin(s);
    let (kept, limits) = (Kept::default(), Arc::new(Mutex::new(Vec::new())));
    let (keeps, sets) = (Arc::clone(&kept), Arc::clone(&limits));
    let services = Services {
        recordings: Folder::of("/home/person/recordings".into()),
        keep: Box::new(move |first, folder, seconds, note| {
            let mut kept = keeps.lock().expect("not poisoned");
            kept.push((first.to_owned(), folder.to_owned(), seconds, note));
            Job::ready(Ok(folder.join("2026-11-23_15-00-00.rrd")))
        }),
        rolling: Box::new(move |limit| {
            let mut limits = sets.lock().expect("not poisoned");
            limits.extend(limit);
            Job::ready(Ok(RollingUse {
                folder: "/home/person/rolling".into(),
                limit_bytes: limits.last().copied().unwrap_or(2_000_000_000),
                used_bytes: 412_000_000,
            }))
        }),
        ..Services::none()
    };
    let mut app = App::new(Some(handle), RobotSpec::reference(), services);
    app.screen = ScreenId::Recordings;
    (twin, app, kept, limits)
}

fn window(rolling: RollingStatus) -> (Twin, Harness<'static, App>, Kept, Arc<Mutex<Vec<u64>>>) {
    let (twin, app, kept, limits) = app_of(rolling);
    let mut h = harness(app);
    h.run_steps(4);
    (twin, h, kept, limits)
}

#[test]
fn it_is_drawn() {
    for size in [[1024.0, 700.0], [1280.0, 760.0]] {
        let (_twin, app, ..) = app_of(RollingStatus::Records(first()));
        let name = format!("recordings-rolling-{}", size[0]);
        pictures::picture(&name, size, Theme::Dark, app);
    }
}

#[test]
fn the_last_minutes_are_kept_by_button_and_key_with_a_note_and_reported_by_name() {
    let (_twin, mut h, kept, _) = window(RollingStatus::Records(first()));
    assert!(
        h.query_by_label_contains("Rolling: records, 412.0 MB")
            .is_some()
    );
    assert!(h.query_by_label_contains("○ rolling").is_some());
    h.get_by_label(crate::gui::panels::rec::MENU).click();
    h.run_steps(3);
    type_into(&mut h, "Recording: note", "it slipped");
    h.key_press(Key::Escape);
    h.run_steps(3);
    h.get_by_label("Keep the last 5 min").click();
    h.run_steps(4);
    let stated = "Kept the last 5 min as 2026-11-23_15-00-00.";
    assert!(h.query_all_by_label_contains(stated).next().is_some());
    // On another screen, too.
    h.state_mut().screen = ScreenId::Sensors;
    h.run_steps(3);
    h.key_press(Key::B);
    h.run_steps(4);
    let wanted = |note: &str| {
        let folder = PathBuf::from("/home/person/recordings");
        (first().to_path_buf(), folder, 300.0, note.to_owned())
    };
    let kept = kept.lock().expect("not poisoned");
    assert_eq!(*kept, [wanted("it slipped"), wanted("")]);
}

#[test]
fn before_arm_there_is_nothing_to_keep_and_a_stop_is_shown() {
    let (twin, mut h, kept, _) = window(RollingStatus::Waits);
    assert!(is_disabled(&h, "Keep the last 5 min"));
    h.key_press(Key::B);
    h.run_steps(3);
    assert!(kept.lock().expect("not poisoned").is_empty());
    let mut s = fixture::snapshot(1.1);
    s.rolling = RollingStatus::Stopped("less than 1 GiB is free".into());
    twin.publish(s);
    h.run_steps(3);
    assert!(
        h.query_by_label_contains("rolling recording stopped")
            .is_some()
    );
    assert!(is_disabled(&h, "Keep the last 5 min"));
}

#[test]
fn the_limit_is_typed() {
    let (_twin, mut h, _, limits) = window(RollingStatus::Waits);
    let field = "Limit of the rolling recording in GB";
    h.get_by_label(field).focus();
    h.run_steps(3);
    h.key_press_modifiers(egui::Modifiers::COMMAND, Key::A);
    h.get_by_label(field).type_text("5");
    h.run_steps(3);
    h.key_press(Key::Enter);
    h.run_steps(4);
    assert_eq!(*limits.lock().expect("not poisoned"), [5_000_000_000]);
}
