//! The window driven as an operator would, with a twin made of channels.

mod accuracy;
mod calibrate;
mod conduct;
// Its sessions come from the virtual rig, which the window itself may not import.
#[cfg(test)]
mod gap;
mod layout;
mod messages;
mod operate;
mod palette;
mod pictures;
mod plots;
mod recordings;
mod rerun;
mod scale;
mod sensors;
mod shell;
mod stopping;

use std::path::PathBuf;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Arc, Mutex};

use egui::{Key, Modifiers, Theme};
use egui_kittest::{Harness, kittest::NodeT, kittest::Queryable};

use super::app::App;
use super::screens::ScreenId;
use super::services::{Job, RecordingEntry, Services};
use crate::analysis::fixture;
use crate::analysis::player::Player;
use crate::link::StopLine;
use crate::robot::RobotSpec;
use crate::signal::{Goal, Mode, ReachState, Simulator, Snapshot, Stamp};
use crate::twin::{Command, Event, Handle, Pictures};
use pictures::{assert_drawn, busy_session, picture, save, sharp_picture};

/// The twin's end of the window's channels.
struct Twin {
    commands: Receiver<Command>,
    events: SyncSender<Event>,
    feed: SyncSender<Arc<Snapshot>>,
    latest: Arc<Mutex<Arc<Snapshot>>>,
}

impl Twin {
    fn publish(&self, snapshot: Snapshot) {
        let snapshot = Arc::new(snapshot);
        *self.latest.lock().expect("not poisoned") = Arc::clone(&snapshot);
        self.feed.try_send(snapshot).expect("room in the feed");
    }

    fn taken(&self) -> Vec<Command> {
        self.commands.try_iter().collect()
    }

    /// Whether the window has let it go.
    fn is_gone(&self) -> bool {
        let next = self.commands.try_recv();
        next == Err(std::sync::mpsc::TryRecvError::Disconnected)
    }
}

fn twin(first: Snapshot) -> (Twin, Handle) {
    let (command_tx, commands) = sync_channel(16);
    let (events, event_rx) = sync_channel(16);
    let (feed, feed_rx) = sync_channel(16);
    let latest = Arc::new(Mutex::new(Arc::new(first)));
    let twin = Twin {
        commands,
        events,
        feed,
        latest: Arc::clone(&latest),
    };
    let handle = Handle {
        commands: command_tx,
        events: event_rx,
        feed: feed_rx,
        latest,
        stop_line: StopLine::default(),
        pictures: Pictures::default(),
    };
    (twin, handle)
}

fn harness<'a>(app: App) -> Harness<'a, App> {
    Harness::builder()
        .with_size([1280.0, 720.0])
        .build_eframe(|_| app)
}

fn running(first: Snapshot) -> (Twin, Harness<'static, App>) {
    let (twin, handle) = twin(first);
    let app = App::new(Some(handle), RobotSpec::reference(), Services::none());
    let mut h = harness(app);
    h.run();
    (twin, h)
}

fn type_target(h: &mut Harness<'_, App>, text: [&str; 3]) {
    for (name, text) in ["x", "y", "z"].into_iter().zip(text) {
        let label = format!("Target {name} in mm");
        h.get_by_label(&label).focus();
        h.run();
        h.get_by_label(&label).type_text(text);
        h.run();
    }
}

// The one thing of this name that something can be done with: names of lines in plots are the same words.
fn control<'h>(h: &'h Harness<'_, App>, label: &'h str) -> egui_kittest::Node<'h> {
    let mut found: Vec<_> = h
        .query_all_by_label(label)
        .filter(|n| n.accesskit_node().role() != egui::accesskit::Role::Label)
        .collect();
    assert_eq!(found.len(), 1, "controls named “{label}”");
    found.remove(0)
}

fn press(h: &mut Harness<'_, App>, label: &str) {
    control(h, label).click();
    h.run();
}

fn is_disabled(h: &Harness<'_, App>, label: &str) -> bool {
    control(h, label).accesskit_node().is_disabled()
}

#[test]
fn typed_target_is_previewed_then_gone_to() {
    let (twin, mut h) = running(fixture::snapshot(1.0));
    type_target(&mut h, ["-62", "-41.5", "-268"]);
    press(&mut h, "Preview");
    let goal = Goal::position([-0.062, -0.0415, -0.268]);
    assert_eq!(twin.taken(), [Command::Preview(goal.clone())]);
    assert!(is_disabled(&h, "▶ Go"));
    let mut s = fixture::snapshot(1.1);
    s.preview = Some((
        goal.clone(),
        fixture::reach(ReachState::Reachable, goal.position_m),
    ));
    twin.publish(s);
    h.run();
    h.get_by_label("● Reachable");
    press(&mut h, "▶ Go");
    assert_eq!(twin.taken(), [Command::Go]);
    press(&mut h, "Cancel");
    assert_eq!(twin.taken(), [Command::CancelPreview]);
    h.key_press(Key::Escape);
    h.run();
    assert_eq!(twin.taken(), [Command::CancelPreview]);
    // Another coordinate: the verdict no longer belongs to it.
    h.state_mut().screens.operate.draft.text[2] = "-250".into();
    h.run();
    assert!(is_disabled(&h, "▶ Go"));
}

#[test]
fn after_go_the_panel_tells_of_the_way_and_of_the_end_and_a_click_sets_the_next_target() {
    let (twin, mut h) = running(fixture::snapshot(1.0));
    type_target(&mut h, ["-62", "-41.5", "-268"]);
    press(&mut h, "Preview");
    h.get_by_label("Checking…");
    let goal = Goal::position([-0.062, -0.0415, -0.268]);
    let mut s = fixture::snapshot(1.1);
    (s.mode, s.goal) = (Mode::Hold, None);
    let reach = fixture::reach(ReachState::Reachable, goal.position_m);
    s.preview = Some((goal.clone(), reach));
    twin.publish(s);
    h.run();
    press(&mut h, "▶ Go");
    // The twin lets the preview go as it sets out.
    let mut moving = fixture::snapshot(1.2);
    moving.goal = Some(goal.clone());
    twin.publish(moving.clone());
    h.run();
    h.get_by_label_contains("▶ Moving: ");
    assert!(h.query_by_label("Checking…").is_none());
    assert!(is_disabled(&h, "▶ Go"));
    moving.stamp = Stamp::from_seconds(9.0);
    moving.mode = Mode::AtGoal;
    if let Some(e) = &mut moving.estimate {
        e.base_from_tip.translation.vector = nalgebra::Vector3::new(-0.062, -0.0415, -0.2676);
    }
    twin.publish(moving.clone());
    h.run();
    h.get_by_label("◎ Reached: 0.4 mm from the target");
    twin.taken();
    press(&mut h, "Arm, side view");
    let commands = twin.taken();
    assert!(
        matches!(commands.as_slice(), [Command::Preview(_)]),
        "{commands:?}"
    );
    h.get_by_label("Checking…");
    // One that the arm stops short of says why.
    type_target(&mut h, ["-62", "-41.5", "-268"]);
    press(&mut h, "Preview");
    let mut s = fixture::snapshot(9.5);
    s.mode = Mode::Hold;
    let reach = fixture::reach(ReachState::Reachable, goal.position_m);
    s.preview = Some((goal.clone(), reach));
    twin.publish(s.clone());
    h.run();
    press(&mut h, "▶ Go");
    (s.mode, s.goal, s.preview) = (Mode::Moving, Some(goal), None);
    s.stamp = Stamp::from_seconds(9.6);
    twin.publish(s.clone());
    h.run();
    let reason = "The tip does not come nearer than 6 mm: chamber 3 is at +40 kPa. Holding.";
    (s.mode, s.goal) = (Mode::Hold, None);
    s.stamp = Stamp::from_seconds(12.0);
    twin.publish(s);
    let event = Event::Refused {
        stamp: Stamp::from_seconds(12.0),
        reason: reason.into(),
    };
    twin.events.try_send(event).expect("room");
    h.run();
    h.get_by_label_contains("▲ Not reached: ");
    assert!(h.query_all_by_label(reason).count() > 0);
    assert!(!is_disabled(&h, "Preview"));
}

#[test]
fn typing_into_a_target_field_replaces_what_stood_there_and_tab_goes_from_x_to_y_to_z() {
    let (_twin, mut h) = running(fixture::snapshot(1.0));
    h.state_mut().screens.operate.draft.text = ["60.0".into(), "40.0".into(), "-300.0".into()];
    h.run();
    h.get_by_label("Target x in mm").focus();
    h.run_steps(2);
    for (i, text) in ["12", "-7.5", "-290"].into_iter().enumerate() {
        h.event(egui::Event::Text(text.into()));
        h.run_steps(2);
        assert_eq!(h.state().screens.operate.draft.text[i], text);
        h.key_press(Key::Tab);
        h.run_steps(2);
    }
    assert!(
        h.get_by_label("Preview").is_focused(),
        "and on to what follows"
    );
    // A click into a field does the same.
    h.get_by_label("Target y in mm").click();
    h.run_steps(2);
    h.event(egui::Event::Text("5".into()));
    h.run_steps(2);
    assert_eq!(h.state().screens.operate.draft.text[1], "5");
}

#[test]
fn unreachable_target_says_why_and_offers_the_nearest() {
    let goal = Goal::position([0.2, 0.0, -0.2]);
    let reach = fixture::reach(ReachState::Unreachable, goal.position_m);
    let nearest = reach.nearest_m;
    let mut s = fixture::snapshot(1.0);
    s.preview = Some((goal, reach));
    let (twin, mut h) = running(s);
    type_target(&mut h, ["200", "0", "-200"]);
    h.get_by_label("⊗ Unreachable: 18 mm short");
    h.get_by_label_contains("chamber 4 at +40.0 kPa");
    assert!(is_disabled(&h, "▶ Go"));
    // The reason is on the button, too.
    h.get_by_label("▶ Go").hover();
    h.run_steps(6);
    h.get_by_label_contains("18 mm short. Limited by");
    h.remove_cursor();
    h.run();
    press(&mut h, "Use nearest");
    let commands = twin.taken();
    let [Command::Preview(goal)] = commands.as_slice() else {
        panic!("{commands:?}");
    };
    for (asked, near) in goal.position_m.into_iter().zip(nearest) {
        assert!((asked - near).abs() < 1e-4);
    }
}

#[test]
fn a_field_that_is_no_number_gets_one_sentence() {
    let (twin, mut h) = running(fixture::snapshot(1.0));
    type_target(&mut h, ["NaN", "1", "-300"]);
    h.get_by_label_contains("x is not a number");
    assert!(is_disabled(&h, "Preview") && is_disabled(&h, "▶ Go"));
    h.state_mut().screens.operate.draft.text[0].clear();
    h.run();
    h.get_by_label_contains("x is empty: type a number in mm.");
    assert_eq!(twin.taken(), []);
}

#[test]
fn a_click_in_the_view_drafts_and_previews_but_does_not_move() {
    let (twin, mut h) = running(fixture::snapshot(1.0));
    press(&mut h, "Arm, side view");
    let commands = twin.taken();
    assert!(matches!(commands.as_slice(), [Command::Preview(_)]));
    assert!(h.state().screens.operate.draft.parse().is_ok());
}

#[test]
fn hardware_is_armed_first_and_go_is_held() {
    let mut s = fixture::snapshot(1.0);
    s.link.simulated = false;
    s.link.board_simulated = [Some(false); crate::signal::BOARDS];
    s.mode = Mode::Disarmed;
    let goal = Goal::position([-0.06, -0.04, -0.27]);
    s.preview = Some((
        goal.clone(),
        fixture::reach(ReachState::Reachable, goal.position_m),
    ));
    let (twin, mut h) = running(s.clone());
    type_target(&mut h, ["-60", "-40", "-270"]);
    assert!(is_disabled(&h, "▶ Hold to go"));
    // A click is too short, and who slides off the button has changed their mind.
    press(&mut h, "Hold to arm");
    assert_eq!(twin.taken(), []);
    let at = h.get_by_label("Hold to arm").rect().center();
    h.drag_at(at);
    h.run_steps(2);
    h.hover_at(at + egui::vec2(0.0, 200.0));
    h.run_steps(20);
    h.drop_at(at + egui::vec2(0.0, 200.0));
    h.run();
    assert_eq!(twin.taken(), []);
    h.drag_at(at);
    h.run_steps(14);
    h.drop_at(at);
    h.run();
    assert_eq!(twin.taken(), [Command::Arm]);
    s.mode = Mode::Hold;
    s.stamp = Stamp::from_seconds(1.1);
    twin.publish(s);
    h.run();
    // A click is too short.
    press(&mut h, "▶ Hold to go");
    assert_eq!(twin.taken(), []);
    let at = h.get_by_label("▶ Hold to go").rect().center();
    h.drag_at(at);
    h.run_steps(14);
    h.drop_at(at);
    h.run();
    assert_eq!(twin.taken(), [Command::Go]);
}

#[test]
fn the_simulator_is_switched_by_a_command_and_its_state_is_told() {
    let (twin, mut h) = running(fixture::snapshot(1.0));
    press(&mut h, "Rod");
    assert_eq!(twin.taken(), [], "the rod model is shown already");
    press(&mut h, "Mesh");
    assert_eq!(twin.taken(), [Command::Show(Simulator::Mesh)]);
    let mut s = fixture::snapshot(1.1);
    s.simulator = Simulator::Mesh;
    twin.publish(s.clone());
    h.run();
    h.get_by_label_contains("The mesh is being built");
    s.mesh = Some(Arc::new(fixture::mesh(&s)));
    twin.publish(s.clone());
    h.run();
    h.get_by_label("4.2 mm from the rod model");
    let trouble = "The mesh is 1.2 s old: this computer does not keep up with the arm.";
    s.mesh_trouble = Some(trouble.into());
    twin.publish(s);
    h.run();
    h.get_by_label(&format!("▲ {trouble}"));
    press(&mut h, "Rod");
    assert_eq!(twin.taken(), [Command::Show(Simulator::Rod)]);
    // In a replay the switch is off.
    let mut player = Player::new(fixture::trace("circle", 4)).expect("not empty");
    player.playing = false;
    h.state_mut().player = Some(player);
    h.run();
    assert!(is_disabled(&h, "Mesh"));
}

#[test]
fn refusals_and_a_lost_twin_are_told() {
    let (twin, mut h) = running(fixture::snapshot(1.0));
    let reason = "Go was refused: preview a target first.";
    twin.events
        .try_send(Event::Refused {
            stamp: Stamp::ZERO,
            reason: reason.into(),
        })
        .expect("room");
    h.run();
    h.get_by_label_contains(reason);
    drop(twin);
    h.run();
    h.get_by_label_contains("The twin has stopped");
}

#[test]
fn esc_leaves_a_text_field_and_keeps_the_preview() {
    let mut s = fixture::snapshot(1.0);
    let goal = Goal::position([0.0, 0.0, -0.3]);
    let reach = fixture::reach(ReachState::Reachable, goal.position_m);
    s.preview = Some((goal, reach));
    let (twin, mut h) = running(s);
    h.get_by_label("Target y in mm").focus();
    h.run_steps(2);
    h.key_press(Key::Escape);
    h.run_steps(2);
    assert_eq!(twin.taken(), []);
    h.key_press(Key::Escape);
    h.run_steps(2);
    assert_eq!(twin.taken(), [Command::CancelPreview]);
}

#[test]
fn the_gripper_waits_for_an_armed_arm() {
    let mut s = fixture::snapshot(1.0);
    s.mode = Mode::Disarmed;
    let (twin, mut h) = running(s);
    assert!(is_disabled(&h, "Closed"));
    twin.publish(fixture::snapshot(1.1));
    h.run_steps(2);
    press(&mut h, "Closed");
    assert_eq!(
        twin.taken(),
        [Command::Grip(crate::signal::Gripper::Closed)]
    );
}

#[test]
fn shortcuts_switch_screens_and_show_the_list() {
    let (_twin, mut h) = running(fixture::snapshot(1.0));
    for screen in ScreenId::ALL {
        h.key_press_modifiers(Modifiers::COMMAND, screen.key());
        h.run();
        assert_eq!(h.state().screen, screen);
    }
    h.event(egui::Event::Text("?".into()));
    h.run_steps(4);
    let list = h.get_by_label_contains("STOP: pumps off").rect();
    let stop = h.get_by_label("■ STOP").rect();
    assert!(!list.intersects(stop));
    h.key_press(Key::Escape);
    h.run_steps(4);
    assert!(h.query_by_label_contains("STOP: pumps off").is_none());
}

#[test]
fn a_replay_is_announced_and_disables_motion() {
    let mut rests = fixture::snapshot(1.0);
    rests.mode = Mode::AtGoal;
    let (twin, mut h) = running(rests);
    let mut player = Player::new(fixture::trace("circle", 4)).expect("not empty");
    player.playing = false;
    h.state_mut().player = Some(player);
    h.run();
    h.get_by_label("▶ Replay: circle (simulated)");
    type_target(&mut h, ["-60", "-40", "-270"]);
    assert!(is_disabled(&h, "Preview") && is_disabled(&h, "▶ Go"));
    // Enter must not get around the disabled button.
    h.get_by_label("Target z in mm").focus();
    h.run();
    h.key_press(Key::Enter);
    h.run();
    assert_eq!(twin.taken(), []);
    // P plays; STOP still reaches the live twin.
    h.key_press_modifiers(Modifiers::COMMAND, Key::Num3);
    h.run();
    h.key_press(Key::P);
    h.run_steps(4);
    assert!(
        h.state()
            .player
            .as_ref()
            .is_some_and(|p| p.position_s > 0.1)
    );
    h.get_by_label("■ STOP").click();
    h.run_steps(2);
    assert_eq!(twin.taken(), [Command::Stop]);
    h.get_by_label("Close replay").click();
    h.run_steps(3);
    assert!(h.state().player.is_none());
}

#[test]
fn recordings_are_listed_loaded_and_made() {
    let mut app = recordings_app();
    app.screen = ScreenId::Recordings;
    let (twin, handle) = twin(fixture::snapshot(1.0));
    app = {
        let mut with_twin = App::new(Some(handle), RobotSpec::reference(), library_services());
        with_twin.screen = app.screen;
        with_twin
    };
    let mut h = harness(app);
    h.run_steps(3);
    assert!(h.query_by_label("Load and play").is_none());
    h.get_by_label("circle-35g").click();
    h.run_steps(2);
    h.get_by_label("Load and play").click();
    h.run_steps(3);
    assert!(h.state().player.is_some());
    h.get_by_label("● REC").click();
    h.run_steps(2);
    assert_eq!(
        twin.taken(),
        [Command::StartRecording(PathBuf::from(
            "recordings/recording.rrd"
        ))]
    );
}

#[test]
fn no_truth_means_prediction_only_and_no_score() {
    let snapshots: Vec<_> = fixture::session(4)
        .into_iter()
        .map(|mut s| {
            s.truth = None;
            s
        })
        .collect();
    let app = App::for_screenshot(
        ScreenId::Accuracy,
        Theme::Dark,
        RobotSpec::reference(),
        &snapshots,
    );
    let mut h = harness(app);
    h.run();
    h.get_by_label("Prediction only");
    assert!(h.query_by_label("RMSE").is_none());
}

#[test]
fn nothing_live_means_no_repaint() {
    let app = App::for_screenshot(
        ScreenId::Sensors,
        Theme::Dark,
        RobotSpec::reference(),
        &fixture::session(4),
    );
    let mut h = harness(app);
    h.run();
    let delay = h.output().viewport_output[&egui::ViewportId::ROOT].repaint_delay;
    assert!(delay > std::time::Duration::from_secs(60), "{delay:?}");
}

#[test]
fn an_empty_start_shows_every_screen() {
    for screen in ScreenId::ALL {
        let mut h = harness(App::for_screenshot(
            screen,
            Theme::Light,
            RobotSpec::reference(),
            &[],
        ));
        h.run_steps(3);
        h.get_by_label("OFFLINE");
    }
}

fn library_services() -> Services {
    let entry = |name: &str, bytes, seconds, note: Option<&str>| RecordingEntry {
        path: PathBuf::from(format!("recordings/{name}.rrd")),
        name: name.into(),
        bytes,
        seconds: Some(seconds),
        simulated: Some(true),
        note: note.map(str::to_owned),
        ..RecordingEntry::default()
    };
    Services {
        scan: Box::new(move |_| {
            Job::ready(Ok(vec![
                entry("circle-35g", 1_240_000, 126.0, None),
                entry("figure-8-115g", 1_310_000, 131.0, None),
                entry(
                    "pick-and-place-tomato",
                    2_870_000,
                    244.0,
                    Some("Truncated: readable up to 4:04, the end is missing."),
                ),
                entry("point-to-point", 412_000, 48.0, None),
            ]))
        }),
        load: Box::new(|_| {
            Job::ready(Player::loaded(
                fixture::trace("circle-35g", 40).into(),
                &mut |_| true,
            ))
        }),
        ..Services::none()
    }
}

fn recordings_app() -> App {
    App::new(None, RobotSpec::reference(), library_services())
}
