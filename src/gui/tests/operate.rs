//! Targets, paths and tasks, driven as an operator would.

#[cfg(test)]
mod clicks;
#[cfg(test)]
mod live;

use super::*;
use crate::gui::panels::plans::{Outcome, Passing, PlanKind};
use crate::task::{Leg, Plan};

/// The plan's panel in front.
fn with_plan(first: Snapshot) -> (Twin, Harness<'static, App>) {
    let (twin, mut h) = running(first);
    press(&mut h, "Plan");
    h.run_steps(2);
    (twin, h)
}

fn set(h: &mut Harness<'_, App>, label: &str, value: f64) {
    h.get_by_label(label).set_value_accesskit(value);
    h.run();
}

/// The one plan that was started, after what else was commanded.
fn started(commands: &[Command]) -> &Plan {
    match commands {
        [.., Command::Start(plan)] => plan,
        other => panic!("no plan was started: {other:?}"),
    }
}

#[test]
fn a_speed_that_the_tip_does_not_have_is_refused_at_its_field_and_not_cut() {
    let (twin, mut h) = with_plan(fixture::snapshot(1.0));
    set(&mut h, "Speed in mm/s", 20.0);
    assert_eq!(h.state().screens.operate.plans.speed_mm_s, 20.0);
    h.get_by_label("▲ 20.0 mm/s is more than the tip's 5.0 mm/s: choose a lower speed.");
    assert!(is_disabled(&h, "▶ Start"));
    set(&mut h, "Speed in mm/s", 5.0);
    assert!(!is_disabled(&h, "▶ Start"));
    assert_eq!(twin.taken(), []);
}

#[test]
fn a_circle_is_set_by_its_numbers_and_started_once() {
    let (twin, mut h) = with_plan(fixture::snapshot(1.0));
    set(&mut h, "Radius in mm", 20.0);
    set(&mut h, "Speed in mm/s", 4.0);
    set(&mut h, "Centre z in mm", -290.0);
    set(&mut h, "Number of laps", 2.0);
    h.get_by_label_contains("60 waypoints, 251 mm, at least 63 s");
    set(&mut h, "Speed in mm/s", 5.0);
    press(&mut h, "▶ Start");
    let commands = twin.taken();
    let [.., Leg::Follow(follow)] = started(&commands).legs.as_slice() else {
        panic!("{commands:?}");
    };
    assert_eq!((follow.laps, follow.path.waypoints_m.len()), (2, 60));
    assert!((follow.speed_m_s - 5e-3).abs() < 1e-12);
    assert!((follow.path.waypoints_m[0][0] - 0.02).abs() < 1e-12);
    assert_eq!(commands.len(), 1, "it was armed already");
    h.get_by_label("Checking every stop…");
    // The twin refuses: its sentence stands here, too.
    let reason = "Not started, because of waypoint 7 of 60. Too far.";
    let refused = Event::Refused {
        stamp: Stamp::ZERO,
        reason: reason.into(),
    };
    twin.events.try_send(refused).expect("room");
    h.run();
    assert_eq!(
        h.state().screens.operate.plans.outcome,
        Outcome::Refused(reason.into())
    );
    assert_eq!(h.get_all_by_label(&format!("▲ {reason}")).count(), 2);
}

#[test]
fn a_plan_that_ends_without_a_word_is_not_looked_at_for_ever() {
    let (twin, mut h) = with_plan(fixture::snapshot(1.0));
    press(&mut h, "▶ Start");
    let name = started(&twin.taken()).name.clone();
    let mut s = fixture::snapshot(1.1);
    s.routine = Some(fixture::routine(&name));
    twin.publish(s);
    h.run_steps(2);
    // Something else is refused on the way: that is not about the plan.
    let refused = |t| Event::Refused {
        stamp: Stamp::from_seconds(t),
        reason: "Too far.".into(),
    };
    twin.events.try_send(refused(1.1)).expect("room");
    h.run_steps(2);
    assert_eq!(h.state().screens.operate.plans.outcome, Outcome::Given);
    let mut stopped = fixture::snapshot(1.2);
    stopped.mode = Mode::Safe("stopped by the operator".into());
    twin.publish(stopped);
    h.run_steps(2);
    h.get_by_label("Ended before it was done.");
    twin.events.try_send(refused(5.0)).expect("room");
    h.run_steps(2);
    h.get_by_label("Ended before it was done.");
}

#[test]
fn the_grip_point_is_steered_instead_of_the_tip() {
    let (twin, mut h) = running(fixture::snapshot(1.0));
    press(&mut h, "Arm, side view");
    let commands = twin.taken();
    let [Command::Preview(of_tip)] = commands.as_slice() else {
        panic!("{commands:?}");
    };
    assert!(of_tip.is_of_tip());
    let of_tip = of_tip.clone();
    let shown = |goal: &Goal| {
        let mut s = fixture::snapshot(2.0);
        let reach = fixture::reach(ReachState::Reachable, goal.position_m);
        s.preview = Some((goal.clone(), reach));
        s
    };
    twin.publish(shown(&of_tip));
    h.run_steps(3);
    assert!(!is_disabled(&h, "▶ Go"));
    press(&mut h, "Steered point");
    press(&mut h, "Grip");
    let commands = twin.taken();
    let [Command::Preview(goal)] = commands.as_slice() else {
        panic!("{commands:?}");
    };
    let wanted = Goal {
        point_m: RobotSpec::reference().grip_m(),
        ..of_tip
    };
    assert_eq!(goal, &wanted);
    // The verdict on the tip is none on the grip point.
    assert!(is_disabled(&h, "▶ Go"));
    twin.publish(shown(&wanted));
    h.run_steps(3);
    assert!(!is_disabled(&h, "▶ Go"));
}

#[test]
fn waypoints_are_clicked_while_draw_is_on_and_the_target_stays() {
    let (twin, mut h) = with_plan(fixture::snapshot(1.0));
    press(&mut h, "Points");
    assert!(is_disabled(&h, "▶ Start"));
    h.get_by_label("▶ Start").hover();
    h.run_steps(6);
    h.get_by_label_contains("There are no waypoints: switch Draw on");
    press(&mut h, "Draw");
    let view = h.get_by_label("Arm, side view").rect();
    for (dx, dy) in [(-40.0, 30.0), (10.0, 40.0), (50.0, 20.0)] {
        let at = view.center() + egui::vec2(dx, dy);
        h.hover_at(at);
        h.run();
        h.drag_at(at);
        h.drop_at(at);
        h.run();
    }
    assert_eq!(h.state().screens.operate.plans.points_m.len(), 3);
    assert_eq!(twin.taken(), [], "nothing is previewed and nothing moves");
    assert!(h.state().screens.operate.draft.parse().is_err());
    // Esc ends drawing; a click is a target again.
    h.key_press(Key::Escape);
    h.run();
    press(&mut h, "Arm, side view");
    assert!(matches!(twin.taken().as_slice(), [Command::Preview(_)]));
    assert_eq!(h.state().screens.operate.plans.points_m.len(), 3);
    // The target becomes the fourth; it is passed one place earlier, the first is deleted.
    press(&mut h, "Add target");
    press(&mut h, "Move up");
    let plans = &h.state().screens.operate.plans;
    assert_eq!((plans.points_m.len(), plans.selected), (4, Some(2)));
    assert!(!is_disabled(&h, "▶ Start"));
    h.get_by_label_contains("Waypoint 1 at").click();
    h.run();
    press(&mut h, "Delete");
    assert_eq!(h.state().screens.operate.plans.points_m.len(), 3);
    press(&mut h, "Closed line");
    press(&mut h, "▶ Start");
    let commands = twin.taken();
    let plan = started(&commands);
    assert_eq!(plan.name, "line through 3 points");
    assert_eq!(h.state().screens.operate.plans.passing, Passing::Follow);
}

#[test]
fn hardware_holds_to_start_a_plan_and_is_never_armed_by_it() {
    let mut s = fixture::snapshot(1.0);
    s.link.simulated = false;
    s.link.board_simulated = [Some(false); crate::signal::BOARDS];
    s.mode = Mode::Disarmed;
    let (twin, mut h) = with_plan(s.clone());
    assert!(is_disabled(&h, "▶ Hold to start"));
    s.mode = Mode::Hold;
    s.stamp = Stamp::from_seconds(1.1);
    twin.publish(s);
    h.run();
    press(&mut h, "▶ Hold to start");
    assert_eq!(twin.taken(), [], "a click is too short");
    let at = h.get_by_label("▶ Hold to start").rect().center();
    h.drag_at(at);
    h.run_steps(14);
    h.drop_at(at);
    h.run();
    let commands = twin.taken();
    assert!(
        matches!(commands.as_slice(), [Command::Start(_)]),
        "{commands:?}"
    );
}

/// An arm at rest that nothing was asked of.
fn at_rest() -> Snapshot {
    let mut s = fixture::snapshot(1.0);
    (s.mode, s.goal, s.preview, s.routine) = (Mode::Disarmed, None, None, None);
    s
}

#[test]
fn a_newcomer_is_offered_one_move_that_is_made_by_one_press_and_then_no_more() {
    let (twin, mut h) = running(at_rest());
    press(&mut h, "▶ Send it here");
    let commands = twin.taken();
    let [Command::Arm, Command::Goto(goal)] = commands.as_slice() else {
        panic!("{commands:?}");
    };
    let wanted = crate::gui::panels::target::first_m(&RobotSpec::reference());
    for (asked, wanted) in goal.position_m.into_iter().zip(wanted) {
        assert!((asked - wanted).abs() < 1e-4, "{asked} for {wanted}");
    }
    assert!(h.query_by_label("▶ Send it here").is_none());
    let mut s = at_rest();
    s.stamp = Stamp::from_seconds(1.1);
    (s.mode, s.goal) = (Mode::Moving, Some(goal.clone()));
    twin.publish(s);
    h.run_steps(2);
    h.get_by_label_contains("▶ Moving:");
    // Nor after it is cleared and the arm rests again.
    h.state_mut().screens.operate.draft.text = Default::default();
    let mut s = at_rest();
    s.stamp = Stamp::from_seconds(1.2);
    twin.publish(s);
    h.run_steps(2);
    assert!(h.query_by_label("▶ Send it here").is_none());
}

#[test]
fn hardware_is_never_sent_anywhere_by_one_press() {
    let mut s = at_rest();
    s.link.simulated = false;
    s.link.board_simulated = [Some(false); crate::signal::BOARDS];
    for mode in [Mode::Disarmed, Mode::Hold] {
        s.mode = mode;
        let (_twin, h) = running(s.clone());
        assert!(h.query_by_label("▶ Send it here").is_none());
    }
}

#[test]
fn the_readiness_list_is_one_click_away() {
    let mut s = at_rest();
    s.truth = None;
    let (_twin, mut h) = running(s);
    press(&mut h, "Readiness: Ready without 3 of 7");
    h.run_steps(2);
    for name in [
        "Link",
        "Sensors",
        "Calibration",
        "Motion capture",
        "Agreement",
        "Storage",
    ] {
        assert!(h.query_all_by_label(name).count() > 0, "{name}");
    }
    h.get_by_label_contains("predictions are not scored");
}

#[test]
fn panels_follow_the_width_of_the_window_until_they_are_arranged() {
    use crate::gui::panels::operate::Form;
    let (_twin, mut h) = running(fixture::snapshot(1.0));
    let form = |h: &Harness<'_, App>| h.state().screens.operate.form;
    assert_eq!(form(&h), Some(Form::Two));
    assert!(
        h.query_by_label_contains("Error").is_none(),
        "the pose is behind its tab"
    );
    h.set_size(egui::vec2(2560.0, 1440.0));
    h.run_steps(4);
    assert_eq!(form(&h), Some(Form::Three));
    h.get_by_label_contains("Training distance");
    // A boundary that is dragged is the operator's layout.
    let view = h.get_by_label("Arm, side view").rect();
    let from = egui::pos2(view.right() + 2.0, view.center().y);
    h.hover_at(from);
    h.run_steps(2);
    h.drag_at(from);
    h.run_steps(2);
    h.hover_at(from - egui::vec2(120.0, 0.0));
    h.run_steps(2);
    h.drop_at(from - egui::vec2(120.0, 0.0));
    h.run_steps(2);
    assert_eq!(form(&h), None);
    h.set_size(egui::vec2(1280.0, 720.0));
    h.run_steps(4);
    assert_eq!(form(&h), None);
    press(&mut h, "Reset layout");
    h.run_steps(2);
    assert_eq!(form(&h), Some(Form::Two));
}

#[test]
fn the_driven_way_is_measured_against_the_path_and_marked_in_the_recording() {
    let (twin, mut h) = with_plan(fixture::snapshot(1.0));
    press(&mut h, "▶ Start");
    let commands = twin.taken();
    let plan = started(&commands).clone();
    let Some(Leg::Follow(follow)) = plan.legs.last() else {
        panic!("a path");
    };
    let at = |t_s: f64, off_m: f64| {
        let mut s = fixture::snapshot(t_s);
        let mut routine = fixture::routine(&plan.name);
        (routine.legs, routine.legs_done) = (plan.legs.len(), plan.legs.len() - 1);
        routine.waypoint = Some((3, 60));
        (s.routine, s.mode, s.truth) = (Some(routine), Mode::Moving, None);
        s.recording = Some("circle".into());
        let mut tip = nalgebra::Vector3::from(follow.path.waypoints_m[3]);
        tip.z += off_m;
        if let Some(e) = &mut s.estimate {
            e.base_from_tip.translation.vector = tip;
        }
        s
    };
    for (k, off_m) in [3e-4, 4e-4].into_iter().enumerate() {
        twin.publish(at(1.1 + 0.1 * k as f64, off_m));
        h.run_steps(2);
    }
    let finished = Event::Finished {
        stamp: Stamp::from_seconds(1.3),
        name: plan.name.clone(),
    };
    twin.events.try_send(finished).expect("room");
    let mut rests = at(1.3, 0.0);
    (rests.routine, rests.mode) = (None, Mode::AtGoal);
    twin.publish(rests);
    h.run_steps(3);
    // The root of the mean of 0.3² and 0.4².
    let result = "0.35 mm RMS off the path, 0.40 mm at most, by the estimate";
    h.get_by_label_contains(result);
    let marks: Vec<Command> = twin.taken();
    assert_eq!(marks, [Command::Mark(format!("{}: {result}", plan.name))]);
}

#[test]
fn in_a_replay_nothing_is_started_and_nothing_is_drawn() {
    let (twin, mut h) = with_plan(fixture::snapshot(1.0));
    press(&mut h, "Points");
    press(&mut h, "Draw");
    let mut player = Player::new(fixture::trace("circle", 4)).expect("not empty");
    player.playing = false;
    h.state_mut().player = Some(player);
    h.run();
    assert!(is_disabled(&h, "▶ Start") && is_disabled(&h, "Draw"));
    press(&mut h, "Arm, side view");
    assert_eq!(h.state().screens.operate.plans.points_m.len(), 0);
    assert_eq!(twin.taken(), []);
}

#[test]
fn a_plan_in_both_themes_and_sizes() {
    for (theme, theme_name) in [(Theme::Dark, "dark"), (Theme::Light, "light")] {
        for (kind, kind_name) in [
            (PlanKind::Circle, "circle"),
            (PlanKind::PickPlace, "pick"),
            (PlanKind::Points, "points"),
        ] {
            let (twin, handle) = twin(fixture::snapshot(1.0));
            let mut app = App::new(Some(handle), RobotSpec::reference(), Services::none());
            app.screens.operate.plans.kind = kind;
            for k in 0..7 {
                let x = 0.02 * f64::from(k) - 0.06;
                app.screens.operate.plans.add([x, 0.5 * x, -0.31 + x * x]);
            }
            app.screens
                .operate
                .show(crate::gui::panels::operate::Pane::Plan);
            app.screens.operate.plans.drawing = kind == PlanKind::Points;
            let name = format!("operate-plan-{kind_name}-{theme_name}-720");
            picture(&name, [1280.0, 720.0], theme, app);
            drop(twin);
        }
    }
}
