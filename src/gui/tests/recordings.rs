//! The Recordings screen: A and B, events, contents, what is missing or cut off, loading.

mod library;
mod made;
mod near;
mod notes;
mod rec;
mod rolling;

use std::path::Path;

use super::*;
use crate::analysis::pairing::{Alignment, Pairing};
use crate::analysis::recorded::{About, ChannelFacts, ChannelFault, Loaded, LoggedEvent};
use crate::gui::panels::recordings::{Compared, Detail, Quantity, Side};
use crate::gui::services::{Picked, Worker};
use crate::signal::{ChannelHealth, Trace};

/// B begins this much later in the motion than A, s.
const SHIFT_S: f64 = 3.0;
/// The tip is predicted this much higher in A than in B, mm.
const APART_MM: f64 = 5.0;

fn recording_a() -> Trace {
    fixture::trace("first", 40)
}

// The same motion from a later moment on, on another clock, with another prediction.
fn recording_b() -> Trace {
    let mut trace = fixture::trace("second", 40);
    trace
        .snapshots
        .retain(|s| s.stamp.seconds() >= 100.0 + SHIFT_S);
    for s in &mut trace.snapshots {
        s.stamp = s.stamp.plus(-100.0 - SHIFT_S);
        let estimate = s.estimate.as_mut().expect("has an estimate");
        estimate.base_from_tip.translation.vector.z -= APART_MM * 1e-3;
    }
    trace
}

fn entry(name: &str, note: Option<&str>) -> RecordingEntry {
    RecordingEntry {
        path: PathBuf::from(format!("recordings/{name}.rrd")),
        name: name.into(),
        bytes: 1_240_000,
        seconds: Some(40.0),
        simulated: Some(true),
        note: note.map(str::to_owned),
        ..RecordingEntry::default()
    }
}

fn answer(path: &Path) -> Result<Loaded, String> {
    match path.file_stem().and_then(|s| s.to_str()) {
        Some("first") => Ok(Loaded {
            trace: recording_a(),
            about: about(),
        }),
        Some("second") => Ok(recording_b().into()),
        Some("cut") => {
            let mut trace = fixture::trace("cut", 10);
            for s in &mut trace.snapshots {
                if let Some(f) = &mut s.sensors {
                    f.health.imus[2] = ChannelHealth::Missing;
                }
            }
            Ok(Loaded {
                about: About {
                    cut_at: trace.snapshots.last().map(|s| s.stamp),
                    ..About::default()
                },
                trace,
            })
        }
        _ => Err(format!(
            "{} cannot be read as a recording: it does not begin like one.",
            path.display()
        )),
    }
}

fn indexed(loaded: Loaded) -> Result<Player, String> {
    Player::loaded(loaded, &mut |_| true)
}

fn about() -> About {
    let event = |t_s: f64, log: &str, text: &str| LoggedEvent {
        stamp: Stamp::from_seconds(t_s),
        log: log.into(),
        text: text.into(),
    };
    let channel = |name: &str, unit: &str, rows, rate_hz| ChannelFacts {
        name: name.into(),
        unit: unit.into(),
        rows,
        rate_hz,
    };
    About {
        path: Some("recordings/first.rrd".into()),
        note: String::new(),
        apart_s: None,
        begun: Some("2026-11-23T14:05:12+01:00".into()),
        events: vec![
            event(100.0, "mode", "Moving"),
            event(112.5, "events", "Go was refused: preview a target first."),
            event(120.0, "alarms", "Spring 5A is stuck at 151.2 mm."),
            event(131.0, "mode", "At goal"),
        ],
        channels: vec![
            channel("/sensors/raw/pressure_pa", "Pa", 2000, 50.0),
            channel("/sensors/calibrated/spring_m", "m", 1990, 49.8),
            channel("/tip/truth", "", 2000, 50.0),
        ],
        faults: vec![ChannelFault {
            name: "spring9".into(),
            missing: 0,
            flagged: 412,
        }],
        gaps: 2,
        longest_step_s: 0.18,
        cut_at: None,
    }
}

fn services() -> Services {
    Services {
        scan: Box::new(|_| {
            Job::ready(Ok(vec![
                entry("first", None),
                entry("second", None),
                entry("cut", Some("Cut off: plays to its last whole part.")),
                entry("broken", None),
            ]))
        }),
        load: Box::new(|path| Job::ready(answer(path).and_then(indexed))),
        ..Services::none()
    }
}

pub(super) fn app(theme: Theme) -> App {
    let mut app = App::for_screenshot(ScreenId::Recordings, theme, RobotSpec::reference(), &[]);
    app.services = services();
    app
}

pub(super) fn load(h: &mut Harness<'_, App>, name: &str, button: &str) {
    h.get_by_label(name).click();
    h.run_steps(2);
    h.get_by_label(button).click();
    h.run_steps(3);
    if let Some(player) = &mut h.state_mut().player {
        player.playing = false;
    }
    h.run_steps(2);
}

fn type_into(h: &mut Harness<'_, App>, label: &str, text: &str) {
    h.get_by_label(label).focus();
    h.run_steps(2);
    h.get_by_label(label).type_text(text);
    h.run_steps(3);
}

fn both() -> Harness<'static, App> {
    let mut h = harness(app(Theme::Dark));
    h.run_steps(3);
    load(&mut h, "first", "Load and play");
    load(&mut h, "second", "Compare as B");
    h
}

fn title(h: &Harness<'_, App>) -> String {
    let player = h.state().player.as_ref();
    player.map_or_else(String::new, |p| p.trace().name.clone())
}

#[test]
fn two_recordings_are_aligned_and_their_difference_is_shown() {
    let mut h = both();
    let pair = &h.state().screens.library.pair;
    assert_eq!(pair.compared, Compared::Both);
    let found = pair.alignment.as_ref().expect("aligned by itself");
    let shift = found.found.expect("the same motion");
    assert!((shift.offset_s - SHIFT_S).abs() < 0.02, "{shift:?}");
    h.get_by_label_contains("Aligned: 3.00");
    press(&mut h, "A − B");
    // Only z was changed.
    for title in ["z / mm, A − B: mean 5.0", "x / mm, A − B: mean 0.0"] {
        assert!(
            h.query_all_by_label_contains(title).next().is_some(),
            "{title}"
        );
    }
    // A wrong shift shows up in the difference, and Align mends it.
    h.state_mut().screens.library.pair.offset_s = 0.0;
    h.run();
    let level = "x / mm, A − B: mean 0.0";
    assert_eq!(h.query_all_by_label_contains(level).count(), 0);
    press(&mut h, "Align recordings");
    assert!(h.query_all_by_label_contains(level).count() > 0);
}

#[test]
fn b_is_played_from_the_same_moment_as_a() {
    let mut h = both();
    assert_eq!(title(&h), "first");
    h.state_mut().player.as_mut().expect("played").position_s = 20.0;
    press(&mut h, "B");
    assert_eq!(title(&h), "second");
    let at = h.state().player.as_ref().expect("played").position_s;
    assert!((at - (20.0 - SHIFT_S)).abs() < 0.02, "{at}");
    press(&mut h, "A");
    assert_eq!(title(&h), "first");
    assert_eq!(h.state().screens.library.pair.compared, Compared::One);
    // Closing one leaves the other at hand.
    press(&mut h, "Close the recording");
    h.get_by_label_contains("B is still loaded: second");
    press(&mut h, "Play B");
    assert_eq!(title(&h), "second");
}

#[test]
fn without_b_the_comparison_says_what_to_do() {
    let mut h = harness(app(Theme::Dark));
    h.run_steps(3);
    load(&mut h, "first", "Load and play");
    assert!(is_disabled(&h, "B") && is_disabled(&h, "A − B") && !is_disabled(&h, "A"));
    h.get_by_label("A − B").hover();
    h.run_steps(6);
    h.get_by_label_contains("Nothing is loaded as B");
}

#[test]
fn unrelated_recordings_say_so_and_are_shifted_by_hand() {
    let mut h = harness(app(Theme::Dark));
    h.state_mut().services.load = Box::new(|path| {
        let mut trace = recording_a();
        if path.ends_with("second.rrd") {
            // Another motion: pressures are gone, and the tip takes another way.
            for s in &mut trace.snapshots {
                let t = s.stamp.seconds();
                s.command = None;
                s.sensors = None;
                let at = &mut s.estimate.as_mut().expect("has an estimate").base_from_tip;
                at.translation.vector = nalgebra::Vector3::new(
                    0.05 * (0.9 * t).sin(),
                    0.05 * (0.53 * t).cos() * (1.7 * t).sin(),
                    -0.3 + 0.02 * (2.3 * t).sin(),
                );
            }
        }
        Job::ready(Player::new(trace).ok_or_else(|| "empty".into()))
    });
    h.run_steps(3);
    load(&mut h, "first", "Load and play");
    load(&mut h, "second", "Compare as B");
    h.get_by_label_contains("▲ No clear match");
    assert_eq!(h.state().screens.library.pair.offset_s, 0.0);
    h.get_by_label("Shift of B in s");
}

#[test]
fn events_are_listed_and_a_click_jumps_there() {
    let mut h = harness(app(Theme::Dark));
    h.run_steps(3);
    load(&mut h, "first", "Load and play");
    press(&mut h, "Events (4)");
    h.get_by_label_contains("0:12.5  events  Go was refused")
        .click();
    h.run_steps(3);
    let at = h.state().player.as_ref().expect("played").position_s;
    assert!((at - 12.5).abs() < 1e-9, "{at}");
}

#[test]
fn what_is_in_a_recording_and_what_is_not_is_told() {
    let mut h = harness(app(Theme::Dark));
    h.run_steps(3);
    load(&mut h, "first", "Load and play");
    h.get_by_label_contains("Contents (▲").click();
    h.run_steps(3);
    h.get_by_label_contains("2 gaps in time, the longest step is 0.180 s");
    h.get_by_label_contains("spring9: 0 of 2000 samples missing, 412 flagged");
    h.get_by_label("/sensors/calibrated/spring_m");
    load(&mut h, "cut", "Load and play");
    let cut = "▲ Cut off: plays to its last whole part, at 0:10.";
    assert!(h.query_all_by_label(cut).count() > 0);
    assert_eq!(
        h.get_all_by_label("▲ IMU 3: not in this recording").count(),
        2,
        "beside the player and among the contents"
    );
}

#[test]
fn a_recording_that_was_cut_plays_to_its_last_record() {
    let mut h = harness(app(Theme::Dark));
    h.run_steps(3);
    load(&mut h, "cut", "Load and play");
    let cut = "▲ Cut off: plays to its last whole part, at 0:10.";
    assert!(h.query_all_by_label(cut).count() > 0);
    let player = h.state_mut().player.as_mut().expect("played");
    player.position_s = 9.9;
    player.playing = true;
    h.run_steps(12);
    let player = h.state().player.as_ref().expect("played");
    assert!(!player.playing);
    let last = player.trace().snapshots.last().map(|s| s.stamp);
    assert_eq!(Some(player.snapshot().stamp), last);
    assert_eq!(player.about.cut_at, last);
}

#[test]
fn a_recording_that_cannot_be_read_says_why_what_now_and_what_to_do() {
    let mut h = harness(app(Theme::Dark));
    h.run_steps(3);
    load(&mut h, "first", "Load and play");
    load(&mut h, "broken", "Load and play");
    h.get_by_label_contains("does not begin like one");
    h.get_by_label_contains("what was shown before stays.");
    h.get_by_label_contains("Choose another recording");
    assert_eq!(title(&h), "first");
    press(&mut h, "Close the message");
    assert_eq!(h.state().screens.library.trouble, None);
}

#[test]
fn loading_shows_how_far_it_is_and_can_be_cancelled() {
    let workers = Arc::new(Mutex::new(Vec::<Worker<Player>>::new()));
    let mut app = app(Theme::Dark);
    let to = Arc::clone(&workers);
    app.services.load = Box::new(move |_| {
        let (job, worker) = Job::pair();
        worker.tell("counting frames", Some(0.4));
        to.lock().expect("not poisoned").push(worker);
        job
    });
    let mut h = harness(app);
    h.run_steps(3);
    load(&mut h, "first", "Load and play");
    h.get_by_label_contains("Loading first.rrd as A… counting frames");
    assert!(is_disabled(&h, "Load and play") && !is_disabled(&h, "Compare as B"));
    h.get_by_label("Cancel loading").click();
    h.run_steps(3);
    assert!(!h.state().screens.library.busy());
    let workers = workers.lock().expect("not poisoned");
    assert!(workers.iter().all(Worker::cancelled));
    assert!(h.state().player.is_none());
}

#[test]
fn indexing_a_recording_tells_its_share_and_can_be_given_up() {
    let mut shares = Vec::new();
    let whole = Player::loaded(recording_a().into(), &mut |share| {
        shares.push(share);
        true
    });
    assert!(whole.is_ok());
    assert!(shares.len() > 1 && shares.is_sorted() && shares.iter().all(|s| *s < 1.0));
    let mut asked = 0;
    let stopped = Player::loaded(recording_a().into(), &mut |_| {
        asked += 1;
        asked < 2
    });
    assert!(stopped.is_err() && asked == 2);
}

#[test]
fn the_window_goes_on_while_recordings_are_aligned() {
    let asked = Arc::new(Mutex::new(Vec::<(Pairing, Worker<Alignment>)>::new()));
    let mut app = app(Theme::Dark);
    let to = Arc::clone(&asked);
    app.services.align = Box::new(move |pairing| {
        let (job, worker) = Job::pair();
        to.lock().expect("not poisoned").push((pairing, worker));
        job
    });
    let mut h = harness(app);
    h.run_steps(3);
    load(&mut h, "first", "Load and play");
    load(&mut h, "second", "Compare as B");
    h.get_by_label_contains("Aligning…");
    assert!(h.state().screens.library.busy() && h.query_by_label("Align recordings").is_none());
    let (pairing, worker) = asked.lock().expect("not poisoned").remove(0);
    worker.finish(Ok(pairing.align(&|| true).expect("was not stopped")));
    h.run_steps(3);
    assert!(!h.state().screens.library.busy());
    assert!((h.state().screens.library.pair.offset_s - SHIFT_S).abs() < 0.05);
    h.get_by_label("Align recordings");
}

fn hold_still(h: &mut Harness<'_, App>) {
    let state = h.state_mut();
    state.window.frozen_end_s = Some(110.0);
    state.window.cursors_s = Some([105.0, 107.0]);
    state.screens.accuracy.peak = Some([106.0, 9.0]);
    h.run_steps(1);
    assert!(h.state().window.frozen_end_s.is_some() && h.state().screens.accuracy.peak.is_some());
}

fn assert_let_go(h: &mut Harness<'_, App>, what: &str) {
    h.run_steps(3);
    let state = h.state();
    assert_eq!(state.window.frozen_end_s, None, "{what}");
    assert_eq!(state.window.cursors_s, None, "{what}");
    assert_eq!(state.screens.accuracy.peak, None, "{what}");
}

#[test]
fn a_frozen_window_cursors_and_peaks_go_with_the_recording_they_were_of() {
    let mut h = both();
    hold_still(&mut h);
    press(&mut h, "B");
    assert_let_go(&mut h, "A and B change places");
    hold_still(&mut h);
    press(&mut h, "Close the recording");
    assert_let_go(&mut h, "closed");
    assert!(h.state().player.is_none());
    hold_still(&mut h);
    press(&mut h, "Play A");
    assert_let_go(&mut h, "the other one is played");
    assert!(h.state().player.is_some());
}

#[test]
fn a_recording_that_does_not_say_so_is_never_called_hardware() {
    let mut app = app(Theme::Dark);
    app.player = Player::new(Trace {
        simulated: None,
        ..recording_a()
    });
    let mut h = harness(app);
    h.run_steps(3);
    assert!(
        h.get_all_by_label_contains("first (origin unknown)")
            .next()
            .is_some()
    );
    h.state_mut().screen = ScreenId::Accuracy;
    h.run_steps(3);
    h.get_by_label("ours: origin unknown");
    assert!(h.query_by_label_contains("(hardware)").is_none());
}

#[derive(Debug)]
struct Dropped(PathBuf);

impl egui::DroppedFile for Dropped {
    fn path(&self) -> &Path {
        &self.0
    }

    fn bytes(&self) -> Result<Vec<u8>, String> {
        Err("The window loads files by their path.".into())
    }
}

#[test]
fn dropped_files_are_loaded_and_a_file_can_be_chosen() {
    let mut app = app(Theme::Dark);
    app.screen = ScreenId::Sensors;
    let mut h = harness(app);
    h.run_steps(2);
    for name in ["first", "second"] {
        let file = Dropped(format!("elsewhere/{name}.rrd").into());
        h.input_mut().dropped_files.push(Arc::new(file));
    }
    h.run_steps(4);
    assert_eq!(h.state().screen, ScreenId::Recordings);
    assert_eq!(title(&h), "first");
    let other = h.state().screens.library.pair.other.as_ref();
    assert_eq!(other.map(|p| p.trace().name.as_str()), Some("second"));
    h.state_mut().services.pick = Box::new(|dialog| {
        assert!(
            dialog
                .filter
                .is_some_and(|(_, kinds)| kinds.contains(&"rrd".to_owned()))
        );
        Job::ready(Ok(Picked::Path("somewhere/cut.rrd".into())))
    });
    h.get_by_label("Browse…").click();
    h.run_steps(4);
    assert_eq!(title(&h), "cut");
}

#[test]
fn recordings_look_right() {
    let size = [1280.0, 720.0];
    let loaded = |theme: Theme, with_b: bool| {
        let mut app = app(theme);
        app.player = answer(Path::new("first.rrd")).and_then(indexed).ok();
        let p = app.player.as_mut().expect("not empty");
        p.playing = false;
        p.position_s = 17.0;
        if with_b {
            let b = Player::new(recording_b()).expect("not empty");
            let pair = &mut app.screens.library.pair;
            pair.place((Side::B, true), b, &mut app.player, &mut app.services);
        }
        app.screens.library.selected = Some("recordings/first.rrd".into());
        app
    };
    for (theme, name) in [(Theme::Dark, "dark"), (Theme::Light, "light")] {
        picture(
            &format!("recordings-one-{name}"),
            size,
            theme,
            loaded(theme, false),
        );
        picture(
            &format!("recordings-both-{name}"),
            size,
            theme,
            loaded(theme, true),
        );
        let mut app = loaded(theme, true);
        app.screens.library.pair.compared = Compared::Difference;
        app.screens.library.pair.quantity = Quantity::Position;
        app.screens.library.detail = Detail::Contents;
        sharp_picture(&format!("recordings-difference-{name}-2x"), theme, app);
    }
    let mut springs = loaded(Theme::Dark, true);
    springs.screens.library.pair.quantity = Quantity::Springs;
    picture("recordings-springs", size, Theme::Dark, springs);
    let mut empty = app(Theme::Dark);
    empty.services = Services::none();
    picture("recordings-empty", size, Theme::Dark, empty);
    let mut cut = app(Theme::Light);
    cut.player = answer(Path::new("cut.rrd")).and_then(indexed).ok();
    cut.player.as_mut().expect("not empty").playing = false;
    cut.screens.library.detail = Detail::Contents;
    picture("recordings-cut", size, Theme::Light, cut);
    let mut long = app(Theme::Dark);
    long.services.load = Box::new(|path| Job::ready(near::long(path).and_then(indexed)));
    long.player = near::long(Path::new("long.rrd")).and_then(indexed).ok();
    let player = long.player.as_mut().expect("not empty");
    (player.playing, player.position_s) = (false, 200.0);
    picture("recordings-long", [1024.0, 700.0], Theme::Dark, long);
    let mut failed = app(Theme::Dark);
    failed.screens.library.trouble = Some(crate::gui::panels::recordings::Trouble::new(
        answer(Path::new("recordings/broken.rrd")).expect_err("broken"),
        "Nothing was loaded: what was shown before stays.",
        "Choose another recording, or copy this one again from where it was made.",
    ));
    picture("recordings-error", size, Theme::Dark, failed);
    let mut loading = app(Theme::Dark);
    let workers = Arc::new(Mutex::new(Vec::<Worker<Player>>::new()));
    loading.services.load = Box::new(move |_| {
        let (job, worker) = Job::pair();
        worker.tell("Reading recordings/first.rrd", None);
        workers.lock().expect("not poisoned").push(worker);
        job
    });
    let mut h = Harness::builder()
        .with_size(size)
        .wgpu()
        .build_eframe(|_| loading);
    h.run_steps(3);
    load(&mut h, "first", "Load and play");
    save("recordings-loading", &h.render().expect("draws"));
}
