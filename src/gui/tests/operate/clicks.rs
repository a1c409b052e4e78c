//! Clicks and drags in the 3D view against the controller's own word, frame by frame with a real twin.

use egui::{Event as Input, PointerButton, Pos2, Rect};
use glam::{Vec2, Vec3};
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64;

use super::super::*;
use super::live::Bench;
use crate::control::{ReachConfig, judging_gains, reach};
use crate::gui::offscreen::Offscreen;
use crate::gui::panels::operate::Pane;
use crate::gui::panels::plans::PlanKind;
use crate::gui::scene::click::{Anchor, land};
use crate::gui::scene::overlay::{Stage, handle_at};
use crate::gui::scene::{Scene, camera::Camera, convert};
use crate::sim::Model;

const VIEW: &str = "3D view of the arm";

/// The window with its 3D view, which is laid out and asked as on a screen; only the drawing is left out.
fn with_scene() -> (Bench, Harness<'static, App>) {
    let device = Offscreen::new([64, 64], 1.0).expect("a graphics driver");
    let (bench, mut app) = Bench::new(Vec::new());
    let scene = Scene::new(device.render_state(), &RobotSpec::reference());
    app.screens.operate.view3d.scene = Some(scene);
    let mut h = harness(app);
    h.run_steps(3);
    (bench, h)
}

fn camera<'a>(h: &'a mut Harness<'_, App>) -> &'a mut Camera {
    let scene = h.state_mut().screens.operate.view3d.scene.as_mut();
    &mut scene.expect("a scene").camera
}

fn fields(h: &Harness<'_, App>) -> [String; 3] {
    h.state().screens.operate.draft.text.clone()
}

fn draft_m(h: &Harness<'_, App>) -> Vec3 {
    convert::vec3(h.state().screens.operate.draft.parse().expect("a target"))
}

fn button(h: &mut Harness<'_, App>, pos: Pos2, pressed: bool) {
    h.event(Input::PointerButton {
        pos,
        button: PointerButton::Primary,
        pressed,
        modifiers: Modifiers::NONE,
    });
    h.step();
}

fn hover(h: &mut Harness<'_, App>, at: Pos2) {
    h.hover_at(at);
    h.step();
}

/// Where a click goes by what is known at the press; nothing on a handle.
fn expected(h: &mut Harness<'_, App>, bench: &Bench, rect: Rect, at: Pos2) -> Option<[String; 3]> {
    let held = h.state().screens.operate.draft.parse().ok();
    let camera = *camera(h);
    let stage = Stage {
        camera: &camera,
        rect,
    };
    if held.is_some_and(|m| handle_at(&stage, convert::vec3(m), at).is_some()) {
        return None;
    }
    let estimate = bench.snapshot.estimate.as_ref().expect("an estimate");
    let tip = convert::vec3(estimate.base_from_tip.translation.vector.into());
    let set = h.state().screens.operate.view3d.reachable();
    let landing = land(
        &camera,
        stage.local(at),
        stage.size_pt(),
        Anchor::Through(tip),
        set,
    );
    let at_m = convert::array(landing.expect("meets the plane").at_m);
    Some(at_m.map(|v| format!("{:.1}", v * 1e3)))
}

/// The controller's own word on a target, as the panel and the view must put it.
fn controller_says(bench: &Bench, before: &Snapshot, target_m: [f64; 3]) -> (String, &'static str) {
    let robot = RobotSpec::reference();
    let config = ReachConfig {
        plant_gains: judging_gains(before.plant_gains.expect("gains")),
        ..ReachConfig::default()
    };
    let verdict = reach(
        &Goal::position(target_m),
        &robot,
        bench.maps.pose.as_ref(),
        bench.maps.plant.as_ref(),
        Model::nominal(&robot).carried_kg(before.payload_kg),
        &bench.maps.seeds,
        &config,
    )
    .expect("a verdict");
    let mm = format!("{:.0}", verdict.distance_m * 1e3);
    match verdict.state {
        ReachState::Reachable => ("● Reachable".into(), "reachable"),
        ReachState::Marginal => ("▲ Marginal".into(), "marginal"),
        ReachState::Unreachable => (format!("⊗ Unreachable: {mm} mm short"), "unreachable"),
        ReachState::OutsideData => (
            format!("? Outside the data: {mm} mm from it"),
            "outside data",
        ),
    }
}

#[test]
fn a_thousand_clicks_freeze_at_the_press_and_show_the_controllers_verdict() {
    const CLICKS: usize = 1000;
    let (mut bench, mut h) = with_scene();
    // The arm is on its way all the while, with something in its gripper.
    bench.tick(&[
        Command::DeclarePayload(0.1),
        Command::Goto(Goal::position([0.05, 0.03, -0.30])),
    ]);
    bench.run(&mut h, 20);
    let rect = h.get_by_label(VIEW).rect();
    let mut rng = Pcg64::seed_from_u64(20_260_101);
    let mut seen = std::collections::BTreeMap::<&str, usize>::new();
    let (mut taken, mut on_handle) = (0, 0);
    for k in 0..CLICKS {
        if k % 20 == 0 {
            let view = camera(&mut h);
            view.yaw_rad = rng.random_range(-3.1..3.1);
            view.pitch_rad = rng.random_range(-0.5..1.4);
        }
        let span = rect.shrink(12.0);
        let at = egui::pos2(
            rng.random_range(span.x_range().min..span.x_range().max),
            rng.random_range(span.y_range().min..span.y_range().max),
        );
        hover(&mut h, at);
        let before = fields(&h);
        let wanted = expected(&mut h, &bench, rect, at);
        button(&mut h, at, true);
        // Under the pressed button the arm moves on and the view turns.
        (0..3).for_each(|_| bench.tick(&[]));
        camera(&mut h).orbit(Vec2::new(9.0, -4.0));
        button(&mut h, at, false);
        match &wanted {
            Some(wanted) => assert_eq!(&fields(&h), wanted, "click {k} at {at}"),
            None => assert_eq!(fields(&h), before, "click {k} on a handle"),
        }
        if wanted.is_none() {
            on_handle += 1;
            continue;
        }
        taken += 1;
        let before = Arc::clone(&bench.snapshot);
        bench.tick(&bench.twin.taken());
        h.step();
        let target_m = h.state().screens.operate.draft.parse().expect("a target");
        let (title, name) = controller_says(&bench, &before, target_m);
        h.get_by_label(&title);
        h.get_by_label_contains(&format!("draft target, {name}, at x"));
        *seen.entry(name).or_default() += 1;
    }
    println!("{taken} targets, {on_handle} on handles: {seen:?}");
    assert!(taken > 950 && seen.len() >= 3, "{seen:?}");
}

/// A target with its handles in the middle of the view; the place of the middle handle.
fn holding(h: &mut Harness<'_, App>, bench: &mut Bench, target_mm: [f64; 3]) -> (Rect, Pos2) {
    h.state_mut().screens.operate.draft.text = target_mm.map(|v| v.to_string());
    bench.run(h, 1);
    let rect = h.get_by_label(VIEW).rect();
    let (camera, target) = (*camera(h), draft_m(h));
    let stage = Stage {
        camera: &camera,
        rect,
    };
    (rect, stage.place(target).expect("in view"))
}

#[test]
fn a_dragged_target_follows_the_pointer_without_jumps_whatever_happens_around_it() {
    let (mut bench, mut h) = with_scene();
    bench.tick(&[Command::Goto(Goal::position([0.05, 0.03, -0.30]))]);
    let mut rng = Pcg64::seed_from_u64(7);
    for round in 0..12 {
        let view = camera(&mut h);
        view.yaw_rad = rng.random_range(-3.1..3.1);
        view.pitch_rad = rng.random_range(-1.2..1.2);
        let (rect, start) = holding(&mut h, &mut bench, [40.0, -30.0, -280.0]);
        // The middle handle, or one along an axis.
        let grip = match round % 4 {
            0 => Some(start),
            k => {
                let axis = Vec3::AXES[k - 1];
                let view = *camera(&mut h);
                let stage = Stage {
                    camera: &view,
                    rect,
                };
                let m = view.metres_per_point(draft_m(&h), stage.size_pt());
                stage.place(draft_m(&h) + axis * (45.0 * m))
            }
        };
        let mut at = grip.expect("in view");
        hover(&mut h, at);
        let view = *camera(&mut h);
        button(&mut h, at, true);
        for step in 0..60 {
            let to = at + egui::vec2(rng.random_range(-14.0..14.0), rng.random_range(-14.0..14.0));
            let to = rect.shrink(4.0).clamp(to);
            let before = draft_m(&h);
            match step {
                // The arm moves on, the wheel turns, keys lock an axis or frame the arm.
                10 => bench.run(&mut h, 40),
                20 => h.key_down(Key::Y),
                30 => h.key_up(Key::Y),
                40 => h.key_press(Key::F),
                45 => h.event(Input::MouseWheel {
                    unit: egui::MouseWheelUnit::Line,
                    delta: egui::vec2(0.0, 2.0),
                    phase: egui::TouchPhase::Move,
                    source: egui::MouseWheelSource::Unknown,
                    modifiers: Modifiers::NONE,
                }),
                _ => {}
            }
            h.step();
            assert_eq!(
                draft_m(&h),
                before,
                "the pointer did not move: round {round}, step {step}"
            );
            hover(&mut h, to);
            let size = Vec2::new(rect.width(), rect.height());
            let scale = view.metres_per_point(before, size);
            let (moved, most) = (draft_m(&h).distance(before), 6.0 * scale * at.distance(to));
            // The fields have a decimal of a millimetre.
            assert!(
                moved <= most + 0.2e-3,
                "round {round}, step {step}: {moved} {most}"
            );
            at = to;
            let _ = bench.twin.taken();
        }
        assert_eq!(
            *camera(&mut h),
            view,
            "the view stays while something is held"
        );
        if round % 4 == 0 {
            // The lock to y for ten steps left it off the pointer, along y alone.
            let moved = draft_m(&h) - Vec3::new(0.04, -0.03, -0.28);
            assert!(moved.length() > 1e-3);
        }
        button(&mut h, at, false);
    }
}

#[test]
fn the_middle_handle_stays_under_the_pointer_and_shift_makes_a_tenth_of_it() {
    let (mut bench, mut h) = with_scene();
    let (rect, start) = holding(&mut h, &mut bench, [40.0, -30.0, -280.0]);
    let from = draft_m(&h);
    hover(&mut h, start);
    button(&mut h, start, true);
    let mut at = start;
    for k in 1..=40 {
        at = start + egui::vec2(2.0 * k as f32, -k as f32);
        hover(&mut h, at);
    }
    let view = *camera(&mut h);
    let stage = Stage {
        camera: &view,
        rect,
    };
    let off = stage.place(draft_m(&h)).expect("in view").distance(at);
    assert!(off < 0.6, "{off} points beside the pointer");
    button(&mut h, at, false);
    let far_m = draft_m(&h).distance(from);
    // The same way in steps of a point each, with Shift: a step is less than the fields can show.
    let (_, start) = holding(&mut h, &mut bench, [40.0, -30.0, -280.0]);
    hover(&mut h, start);
    button(&mut h, start, true);
    h.event(Input::ModifiersChanged(Modifiers::SHIFT));
    h.step();
    for k in 1..=80 {
        let k = k as f32;
        hover(&mut h, start + egui::vec2(k, -0.5 * k));
    }
    let fine_m = draft_m(&h).distance(from);
    assert!((fine_m - 0.1 * far_m).abs() < 0.3e-3, "{fine_m} {far_m}");
}

#[test]
fn a_drag_with_draw_on_makes_a_row_of_waypoints_and_a_selected_one_is_dragged() {
    let (mut bench, mut h) = with_scene();
    h.get_by_label("Plan").click();
    h.run_steps(2);
    h.get_by_label("Points").click();
    h.run_steps(2);
    h.get_by_label("Draw").click();
    h.run_steps(2);
    let view = *camera(&mut h);
    let rect = h.get_by_label(VIEW).rect();
    let start = rect.center() + egui::vec2(-60.0, 40.0);
    hover(&mut h, start);
    button(&mut h, start, true);
    let at = |k: usize| start + egui::vec2(2.0 * k as f32, (0.1 * k as f32).sin() * 20.0);
    (1..=60).for_each(|k| hover(&mut h, at(k)));
    button(&mut h, at(60), false);
    let points = h.state().screens.operate.plans.points_m.clone();
    assert!(points.len() > 8, "{}", points.len());
    assert_eq!(*camera(&mut h), view, "drawing does not turn the view");
    let points: Vec<Vec3> = points.into_iter().map(convert::vec3).collect();
    for pair in points.windows(2) {
        let depth_m = (pair[1] - pair[0]).dot(view.forward());
        assert!(depth_m.abs() < 1e-4, "in the plane that faces the viewer");
        assert!(pair[0].distance(pair[1]) >= 5e-3 - 1e-6);
    }
    // The last one has the handles.
    let last = *points.last().expect("points");
    let stage = Stage {
        camera: &view,
        rect,
    };
    let grip = stage.place(last).expect("in view");
    hover(&mut h, grip);
    button(&mut h, grip, true);
    hover(&mut h, grip + egui::vec2(8.0, 0.0));
    hover(&mut h, grip + egui::vec2(20.0, 10.0));
    button(&mut h, grip + egui::vec2(20.0, 10.0), false);
    let plans = &h.state().screens.operate.plans;
    assert_eq!(plans.points_m.len(), points.len(), "no new one");
    let moved = convert::vec3(*plans.points_m.last().expect("points"));
    let at = stage.place(moved).expect("in view");
    assert!(at.distance(grip + egui::vec2(20.0, 10.0)) < 0.5, "{at}");
    assert!(
        h.state().screens.operate.draft.parse().is_err(),
        "the target is left alone"
    );
    bench.run(&mut h, 1);
    assert_eq!(bench.snapshot.preview, None);
}

#[test]
fn the_views_bar_turns_the_view_and_switches_its_parts() {
    let (_bench, mut h) = with_scene();
    let mut click = |label: &str| {
        h.get_by_label(label).click();
        h.run_steps(2);
        let view3d = &h.state().screens.operate.view3d;
        let scene = view3d.scene.as_ref().expect("a scene");
        (scene.camera, view3d.shown)
    };
    let (front, _) = click("Front");
    assert!(front.forward().distance(Vec3::Y) < 1e-6);
    let (right, _) = click("Right");
    assert!(right.forward().distance(Vec3::NEG_X) < 1e-6);
    let (top, _) = click("Top");
    assert!(top.forward().distance(Vec3::NEG_Z) < 1e-6 && top.is_perspective());
    let (below, _) = click("Below");
    assert!(below.forward().distance(Vec3::Z) < 1e-6);
    click("View ▾");
    assert!(!click("Perspective").0.is_perspective());
    let (_, shown) = click("Hull");
    assert!(!shown.hull && shown.trails && shown.ghost && shown.walls);
    let (_, shown) = click("Shadows");
    assert!(!shown.walls);
    let (_, shown) = click("CAD mouse");
    assert_eq!(shown.controls, crate::gui::scene::Controls::Cad);
    // The right button now shifts the view.
    let rect = h.get_by_label(VIEW).rect();
    let before = *camera(&mut h);
    let press = |pos, pressed| Input::PointerButton {
        pos,
        button: PointerButton::Secondary,
        pressed,
        modifiers: Modifiers::NONE,
    };
    let at = rect.center();
    hover(&mut h, at);
    h.event(press(at, true));
    h.step();
    hover(&mut h, at + egui::vec2(30.0, 0.0));
    h.event(press(at + egui::vec2(30.0, 0.0), false));
    h.step();
    let after = *camera(&mut h);
    assert_eq!(
        (after.yaw_rad, after.pitch_rad),
        (before.yaw_rad, before.pitch_rad)
    );
    assert!(after.target_m != before.target_m);
}

#[test]
fn operate_with_a_plan_a_preview_and_its_ghost_in_both_themes() {
    let (mut bench, app) = Bench::new(Vec::new());
    let (maps, robot) = (bench.maps.clone(), RobotSpec::reference());
    drop(app);
    bench.tick(&[Command::Preview(Goal::position([0.09, -0.05, -0.27]))]);
    let mut history = Vec::new();
    for _ in 0..400 {
        bench.tick(&[]);
        history.push(Snapshot::clone(&bench.snapshot));
    }
    assert!(bench.snapshot.preview_shape.is_some());
    let samples: Vec<[f32; 3]> = maps
        .seeds
        .iter()
        .map(|s| s.tip_m().map(|x| x as f32))
        .collect();
    let dir = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("target/pictures");
    std::fs::create_dir_all(&dir).expect("a folder for pictures");
    for (theme, name, size, scale) in [
        (Theme::Dark, "dark-720", [1280, 720], 1.0),
        (Theme::Light, "light-720", [1280, 720], 1.0),
        (Theme::Light, "light-1440", [2560, 1440], 2.0),
        (Theme::Dark, "dark-1080", [1920, 1080], 1.0),
    ] {
        let mut app = App::for_screenshot(ScreenId::Operate, theme, robot.clone(), &history);
        let mut offscreen = Offscreen::new(size, scale).expect("a graphics driver");
        app.set_up(&offscreen.context, None);
        app.screens.operate.view3d.set_reachable(&samples);
        app.screens.operate.draft.text = ["90", "-50", "-270"].map(Into::into);
        app.screens.operate.show(Pane::Plan);
        if theme == Theme::Light {
            app.screens.operate.plans.kind = PlanKind::PickPlace;
        } else {
            app.screens.operate.plans.size_mm = 70.0;
        }
        // The pointer rests beside the arm.
        let at = egui::pos2(360.0, 330.0);
        offscreen.events.push(Input::PointerMoved(at));
        let without = offscreen.render(|ui| app.frame(ui)).expect("a picture");
        app.screens.operate.view3d.scene = Some(Scene::new(offscreen.render_state(), &robot));
        let image = offscreen.render(|ui| app.frame(ui)).expect("a picture");
        // Arm, reachable points and waypoints.
        let pairs = image.pixels().zip(without.pixels());
        let drawn = pairs.filter(|(a, b)| a != b).count();
        let all = (size[0] * size[1]) as usize;
        println!("{name}: {drawn} of {all} pixels are the scene's");
        assert!(100 * drawn > all, "{name}: {drawn} of {all} pixels");
        let path = dir.join(format!("operate-{name}.png"));
        image.save(path).expect("the picture can be written");
    }
}
