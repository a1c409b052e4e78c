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
