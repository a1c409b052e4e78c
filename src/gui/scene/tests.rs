//! Whole pictures on whatever graphics driver there is, the software one included.

use std::sync::Arc;

use egui::{Event, Modifiers, PointerButton, Pos2, Rect, vec2};
use glam::{Vec2, Vec3};
use nalgebra::{Isometry3, Translation3, Unit, UnitQuaternion, Vector3};

use super::camera::{Camera, plane_hit};
use super::overlay::Stage;
use super::reachset::ReachSet;
use super::*;
use crate::gui::offscreen::Offscreen;
use crate::robot::RobotSpec;
use crate::signal::{
    ArmShape, CHAMBERS, Estimate, Goal, Gripper, GroundTruth, Health, IMUS, Matrix6, Pose,
    PressureCommand, Quality, Reach, ReachState, SIGNALS, SPRINGS, SensorFrame, SensorVec,
    Snapshot, Stamp, TruthSource,
};

const SIZE: [u32; 2] = [1280, 720];

/// An arm of two arcs at rest length, each bent by an angle (rad) towards a direction around z (rad).
pub fn bent_shape(robot: &RobotSpec, bend_rad: [f64; 2], towards_rad: [f64; 2]) -> ArmShape {
    const SECTIONS: usize = 21;
    let length_m = robot.rest_length_m;
    let lower_face = Translation3::new(0.0, 0.0, -robot.pad_thickness_m);
    let mut shape = ArmShape::default();
    let mut start = Pose::identity();
    for k in 0..2 {
        let towards = Vector3::new(towards_rad[k].cos(), towards_rad[k].sin(), 0.0);
        let axis = Unit::new_normalize((-Vector3::z()).cross(&towards));
        shape.base_from_section[k] = (0..SECTIONS)
            .map(|i| {
                let s = i as f64 / (SECTIONS - 1) as f64;
                let angle = bend_rad[k] * s;
                // An arc of curvature θ/L: aside L (1 - cos θs)/θ, down L sin θs/θ.
                let (aside, down) = if bend_rad[k].abs() < 1e-9 {
                    (0.0, s)
                } else {
                    ((1.0 - angle.cos()) / bend_rad[k], angle.sin() / bend_rad[k])
                };
                let at = towards * (aside * length_m) - Vector3::z() * (down * length_m);
                start
                    * Isometry3::from_parts(
                        Translation3::from(at),
                        UnitQuaternion::from_axis_angle(&axis, angle),
                    )
            })
            .collect();
        shape.base_from_pad[k + 1] = shape.base_from_section[k][SECTIONS - 1];
        for i in 6 * k..6 * k + 6 {
            let top = start.transform_point(&robot.spring_top_m[i].into());
            let bottom =
                shape.base_from_pad[k + 1].transform_point(&robot.spring_bottom_m[i].into());
            shape.spring_ends_m[i] = [top.coords.into(), bottom.coords.into()];
        }
        start = shape.base_from_pad[k + 1] * lower_face;
    }
    shape
}

/// A snapshot whose estimate and sensors agree with the shape and whose truth is a little off.
pub fn snapshot_of(shape: ArmShape) -> Snapshot {
    let tip = shape.base_from_pad[2];
    let mut sensors = SensorVec {
        spring_m: [0.0; SPRINGS],
        imu_ypr_rad: [[0.0; 3]; IMUS],
    };
    for (length_m, [a, b]) in sensors.spring_m.iter_mut().zip(shape.spring_ends_m) {
        *length_m = (Vector3::from(a) - Vector3::from(b)).norm();
    }
    Snapshot {
        sensors: Some(SensorFrame {
            stamp: Default::default(),
            extra_sigma: [0.0; SIGNALS],
            delivered: Default::default(),
            sensors,
            chamber_pa: [0.0; CHAMBERS],
            health: Health::default(),
            quality: Quality::default(),
        }),
        estimate: Some(Estimate {
            stamp: Default::default(),
            base_from_tip: tip,
            covariance: Matrix6::identity() * 1e-6,
            training_distance: 1.0,
        }),
        truth: Some(GroundTruth {
            stamp: Default::default(),
            base_from_tip: Translation3::new(0.009, -0.006, 0.004) * tip,
            source: TruthSource::VirtualRig,
        }),
        shape: Some(Arc::new(shape)),
        ..Snapshot::default()
    }
}

fn trail(radius_m: f32, wobble_m: f32) -> Vec<[f32; 3]> {
    (0..240)
        .map(|i| {
            let a = i as f32 * 0.02;
            [
                radius_m * a.cos() + wobble_m * (7.0 * a).sin(),
                radius_m * a.sin() + wobble_m,
                -0.285 + 0.012 * (2.0 * a).sin(),
            ]
        })
        .collect()
}

fn save(image: &image::RgbaImage, name: &str) {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/target/pictures");
    std::fs::create_dir_all(folder).expect("a folder for pictures");
    image
        .save(format!("{folder}/scene-{name}.png"))
        .expect("a picture on disk");
}

fn style(offscreen: &Offscreen, theme: Theme) {
    offscreen.context.set_theme(match theme {
        Theme::Dark => egui::Theme::Dark,
        Theme::Light => egui::Theme::Light,
    });
}

fn picture(
    offscreen: &mut Offscreen,
    scene: &mut Scene,
    input: &SceneInput<'_>,
) -> image::RgbaImage {
    style(offscreen, input.theme);
    offscreen
        .render(|ui| {
            egui::CentralPanel::default()
                .frame(egui::Frame::NONE)
                .show(ui, |ui| scene.ui(ui, input));
        })
        .expect("a picture")
}

/// Share of pixels, in per cent, that differ clearly between two pictures.
fn difference_percent(a: &image::RgbaImage, b: &image::RgbaImage) -> f64 {
    let differ = a
        .pixels()
        .zip(b.pixels())
        .filter(|(p, q)| (0..3).any(|c| p.0[c].abs_diff(q.0[c]) > 24))
        .count();
    100.0 * differ as f64 / (a.width() * a.height()) as f64
}

#[test]
fn the_arm_appears_in_both_themes_and_every_mark_changes_the_picture() {
    let robot = RobotSpec::reference();
    let shape = bent_shape(&robot, [0.40, 0.62], [3.3, -0.25]);
    let mut snapshot = snapshot_of(shape);
    snapshot.payload_kg = 0.2;
    snapshot.command = Some(PressureCommand::limited(
        Stamp::default(),
        [0.0; CHAMBERS],
        Gripper::Closed,
        None,
        &[0.0; CHAMBERS],
        &robot.pressure,
    ));
    let empty = Snapshot::default();
    let ghost = bent_shape(&robot, [0.45, 0.45], [-0.2, 0.3]);
    let cloud: Vec<[f32; 3]> = (0..400)
        .map(|i| {
            let (a, t) = (i as f32 * 2.4, (i as f32 / 400.0).sqrt());
            [0.17 * t * a.cos(), 0.17 * t * a.sin(), -0.33 + 0.13 * t * t]
        })
        .collect();
    let outlines = ReachSet::new(&cloud).expect("samples").contours(0.025);
    let (predicted, truth) = (trail(0.11, 0.0), trail(0.11, 0.004));
    for (theme, name) in [(Theme::Dark, "dark"), (Theme::Light, "light")] {
        let mut offscreen = Offscreen::new(SIZE, 1.0).expect("a graphics driver");
        let mut scene = Scene::new(offscreen.render_state(), &robot);
        let bare = SceneInput {
            theme,
            ..SceneInput::new(&empty)
        };
        let nothing = picture(&mut offscreen, &mut scene, &bare);
        save(&nothing, &format!("empty-{name}"));
        let arm = SceneInput {
            snapshot: &snapshot,
            ..bare
        };
        let plain = picture(&mut offscreen, &mut scene, &arm);
        save(&plain, &format!("arm-{name}"));
        let seen = difference_percent(&nothing, &plain);
        assert!(seen > 6.0, "the arm covers {seen} % of the picture");
        let full = SceneInput {
            trail_predicted: &predicted,
            trail_truth: &truth,
            selected_spring: Some(4),
            draft_target: Some([0.105, 0.005, -0.265]),
            reach: Some(ReachState::Reachable),
            ghost: Some(&ghost),
            ..arm
        };
        let hull = SceneInput {
            outlines: &outlines,
            aids: Aids {
                hull: true,
                walls: false,
            },
            ..arm
        };
        let clouded = picture(&mut offscreen, &mut scene, &hull);
        save(&clouded, &format!("cloud-{name}"));
        assert!(difference_percent(&plain, &clouded) > 0.1);
        let rich = picture(&mut offscreen, &mut scene, &full);
        save(&rich, &format!("full-{name}"));
        let seen = difference_percent(&plain, &rich);
        assert!(seen > 2.0, "marks and ghost cover {seen} % of the picture");
    }
}

#[test]
fn the_mesh_skin_is_drawn_in_place_of_the_bellows_and_follows_the_arm() {
    let robot = RobotSpec::reference();
    let camera = Camera::framing(Vec3::new(0.0, 0.0, -0.2), 0.3);
    let draw = |s: &Snapshot| {
        let input = SceneInput::new(s);
        let nothing = SceneOutput::default();
        compose::compose(&robot, &input, &camera, Vec2::splat(400.0), &nothing)
    };
    let swept = |d: &compose::Drawing| d.parts.iter().any(|p| p.1 == mesh::Part::Bellows);
    let mut snapshot = snapshot_of(bent_shape(&robot, [0.40, 0.62], [3.3, -0.25]));
    let rod = draw(&snapshot);
    assert!(swept(&rod) && rod.skin.is_none());
    // The mesh exists but is not what the operator wants to see.
    let fixture = crate::analysis::fixture::mesh(&snapshot);
    snapshot.mesh = Some(Arc::new(fixture.clone()));
    assert_eq!(draw(&snapshot), rod);
    snapshot.simulator = crate::signal::Simulator::Mesh;
    let bent = draw(&snapshot);
    let skin = bent.skin.as_ref().expect("a skin");
    assert!(!swept(&bent));
    assert_eq!(skin.vertices.len(), fixture.skin.positions_m.len());
    assert_eq!(skin.indices.len(), 3 * fixture.skin.triangles.len());
    let picks: Vec<u32> = skin.columns.iter().map(|c| c.1.pick_id).collect();
    let chambers = (0..CHAMBERS).map(|i| Entity::Bellows(i).id());
    assert_eq!(picks, chambers.chain([0, 0]).collect::<Vec<_>>());
    // A stale one says so by its colour.
    snapshot.mesh_trouble = Some("The mesh is 2.0 s old.".into());
    let stale = draw(&snapshot).skin.expect("a skin");
    assert_ne!(stale.columns[0].1.colour, skin.columns[0].1.colour);
    assert_eq!(stale.vertices, skin.vertices);
    snapshot.mesh_trouble = None;
    // Another pose moves it, in the drawing and in the picture.
    let mut other = snapshot_of(bent_shape(&robot, [0.0, 0.3], [0.0, 2.0]));
    other.mesh = Some(Arc::new(crate::analysis::fixture::mesh(&other)));
    other.simulator = crate::signal::Simulator::Mesh;
    assert_ne!(draw(&other).skin.as_ref(), Some(skin));
    let mut offscreen = Offscreen::new(SIZE, 1.0).expect("a graphics driver");
    let mut scene = Scene::new(offscreen.render_state(), &robot);
    let mut shot = |s: &Snapshot| picture(&mut offscreen, &mut scene, &SceneInput::new(s));
    let (a, b) = (shot(&snapshot), shot(&other));
    snapshot.simulator = crate::signal::Simulator::Rod;
    let c = shot(&snapshot);
    save(&a, "mesh");
    assert!(difference_percent(&a, &b) > 3.0);
    assert!(
        difference_percent(&a, &c) > 3.0,
        "folds against a plain skin"
    );
}

#[test]
fn each_verdict_looks_different() {
    let robot = RobotSpec::reference();
    let mut snapshot = snapshot_of(bent_shape(&robot, [0.2, 0.3], [0.0, 1.0]));
    let mut offscreen = Offscreen::new(SIZE, 1.0).expect("a graphics driver");
    let mut scene = Scene::new(offscreen.render_state(), &robot);
    let mut pictures = Vec::new();
    for (state, name) in [
        (ReachState::Reachable, "reachable"),
        (ReachState::Marginal, "marginal"),
        (ReachState::Unreachable, "unreachable"),
        (ReachState::OutsideData, "outside"),
    ] {
        snapshot.preview = Some((
            Goal::position([0.16, -0.10, -0.22]),
            Reach {
                state,
                distance_m: 0.018,
                nearest_m: [0.12, -0.07, -0.25],
                limiting_chamber: Some((4, 40e3)),
                chamber_pa: [0.0; CHAMBERS],
            },
        ));
        scene.camera.distance_m = 1.0;
        let image = picture(&mut offscreen, &mut scene, &SceneInput::new(&snapshot));
        save(&image, name);
        pictures.push(image);
    }
    for i in 0..pictures.len() {
        for j in 0..i {
            assert!(
                difference_percent(&pictures[i], &pictures[j]) > 0.01,
                "{i} {j}"
            );
        }
    }
}

/// Feeds events pass by pass and returns the last output that says something.
fn play(
    offscreen: &mut Offscreen,
    scene: &mut Scene,
    input: &SceneInput<'_>,
    steps: &[Vec<Event>],
) -> Vec<SceneOutput> {
    let mut outputs = Vec::new();
    for events in steps {
        offscreen.events.clone_from(events);
        offscreen
            .render(|ui| {
                egui::CentralPanel::default()
                    .frame(egui::Frame::NONE)
                    .show(ui, |ui| outputs.push(scene.ui(ui, input)));
            })
            .expect("a picture");
    }
    outputs
}

fn button(pos: Pos2, pressed: bool) -> Event {
    Event::PointerButton {
        pos,
        button: PointerButton::Primary,
        pressed,
        modifiers: Modifiers::NONE,
    }
}

fn stage_rect() -> Rect {
    Rect::from_min_size(Pos2::ZERO, vec2(SIZE[0] as f32, SIZE[1] as f32))
}

#[test]
fn the_pointer_finds_parts_and_a_click_gives_the_place_it_was_pressed_at() {
    let robot = RobotSpec::reference();
    let snapshot = snapshot_of(bent_shape(&robot, [0.0, 0.0], [0.0, 0.0]));
    let mut offscreen = Offscreen::new(SIZE, 1.0).expect("a graphics driver");
    let mut scene = Scene::new(offscreen.render_state(), &robot);
    let input = SceneInput::new(&snapshot);
    let camera = scene.camera;
    let stage = Stage {
        camera: &camera,
        rect: stage_rect(),
    };

    let tip = scene.tip_m(&snapshot);
    let palm = stage.place(tip - Vec3::Z * 0.046).expect("in view");
    let moves = vec![vec![Event::PointerMoved(palm)]; 3];
    let outputs = play(&mut offscreen, &mut scene, &input, &moves);
    assert_eq!(
        outputs.last().and_then(|o| o.hovered),
        Some(Entity::Gripper)
    );

    // Beside the arm: nothing there, and the click lands on the plane through the tip.
    let beside = palm + vec2(210.0, 30.0);
    let steps = vec![
        vec![Event::PointerMoved(beside)],
        vec![Event::PointerMoved(beside)],
        vec![button(beside, true)],
        vec![button(beside + vec2(2.0, 0.0), false)],
    ];
    let outputs = play(&mut offscreen, &mut scene, &input, &steps);
    assert!(outputs.iter().all(|o| o.clicked.is_none()));
    let mut targets: Vec<_> = outputs.iter().filter_map(|o| o.clicked_target).collect();
    let at_once = vec![vec![button(beside, true), button(beside, false)]];
    let outputs = play(&mut offscreen, &mut scene, &input, &at_once);
    targets.extend(outputs.iter().filter_map(|o| o.clicked_target));
    assert_eq!(targets.len(), 2);
    let expected = plane_hit(
        &camera.ray(stage.local(beside), stage.size_pt()),
        tip,
        camera.forward(),
    )
    .expect("meets the plane");
    for target in targets {
        assert!(convert::vec3(target).distance(expected) < 1e-5);
    }
    assert_eq!(scene.camera, camera, "a click does not move the camera");
}

#[test]
fn dragging_a_handle_moves_the_draft_along_its_axis_only() {
    let robot = RobotSpec::reference();
    let snapshot = snapshot_of(bent_shape(&robot, [0.0, 0.0], [0.0, 0.0]));
    let mut offscreen = Offscreen::new(SIZE, 1.0).expect("a graphics driver");
    let mut scene = Scene::new(offscreen.render_state(), &robot);
    let draft = [0.15, -0.10, -0.25];
    let input = SceneInput {
        draft_target: Some(draft),
        ..SceneInput::new(&snapshot)
    };
    let camera = scene.camera;
    let stage = Stage {
        camera: &camera,
        rect: stage_rect(),
    };
    let m = camera.metres_per_point(convert::vec3(draft), stage.size_pt());
    let at = stage
        .place(convert::vec3(draft) + Vec3::Z * (45.0 * m))
        .expect("in view");
    let up = |by: f32| Event::PointerMoved(at - vec2(0.0, by));
    let steps = vec![
        vec![Event::PointerMoved(at)],
        vec![button(at, true)],
        vec![up(10.0)],
        vec![up(40.0)],
        vec![button(at - vec2(0.0, 40.0), false)],
    ];
    let outputs = play(&mut offscreen, &mut scene, &input, &steps);
    let moved: Vec<_> = outputs.iter().filter_map(|o| o.dragged_target).collect();
    let [x, y, z] = *moved.last().expect("the draft moved");
    assert!(
        (x - draft[0]).abs() < 1e-6 && (y - draft[1]).abs() < 1e-6,
        "{x} {y}"
    );
    assert!(z > draft[2] + 0.01, "{z}");
    assert!(outputs.iter().all(|o| o.clicked_target.is_none()));
    assert_eq!(scene.camera, camera);
}

#[test]
fn a_drag_beside_the_handles_orbits_and_the_wheel_zooms_or_slides_the_draft() {
    let robot = RobotSpec::reference();
    let snapshot = snapshot_of(bent_shape(&robot, [0.0, 0.0], [0.0, 0.0]));
    let mut offscreen = Offscreen::new(SIZE, 1.0).expect("a graphics driver");
    let mut scene = Scene::new(offscreen.render_state(), &robot);
    let draft = [0.15, -0.10, -0.25];
    let input = SceneInput {
        draft_target: Some(draft),
        ..SceneInput::new(&snapshot)
    };
    let before = scene.camera;
    let at = Pos2::new(200.0, 300.0);
    let steps = vec![
        vec![Event::PointerMoved(at)],
        vec![button(at, true)],
        vec![Event::PointerMoved(at + vec2(60.0, 0.0))],
        vec![button(at + vec2(60.0, 0.0), false)],
    ];
    play(&mut offscreen, &mut scene, &input, &steps);
    assert!((scene.camera.yaw_rad - before.yaw_rad).abs() > 0.2);
    assert_eq!(scene.camera.distance_m, before.distance_m);

    let wheel = |modifiers| Event::MouseWheel {
        unit: egui::MouseWheelUnit::Line,
        delta: vec2(0.0, 1.0),
        phase: egui::TouchPhase::Move,
        source: egui::MouseWheelSource::Unknown,
        modifiers,
    };
    play(
        &mut offscreen,
        &mut scene,
        &input,
        &[vec![wheel(Modifiers::NONE)]],
    );
    assert!(scene.camera.distance_m < before.distance_m);
    let distance_m = scene.camera.distance_m;
    let outputs = play(
        &mut offscreen,
        &mut scene,
        &input,
        &[vec![wheel(Modifiers::ALT)]],
    );
    let moved = outputs
        .iter()
        .find_map(|o| o.dragged_target)
        .expect("the draft moved");
    let step = convert::vec3(moved) - convert::vec3(draft);
    assert!(
        (step - scene.camera.forward() * 0.005).length() < 1e-6,
        "{step}"
    );
    assert_eq!(scene.camera.distance_m, distance_m);
}

#[test]
fn assistive_technology_hears_the_view_its_sensors_and_its_targets() {
    use egui_kittest::kittest::Queryable;
    let robot = RobotSpec::reference();
    let snapshot = snapshot_of(bent_shape(&robot, [0.0, 0.0], [0.0, 0.0]));
    let offscreen = Offscreen::new(SIZE, 1.0).expect("a graphics driver");
    let mut scene = Scene::new(offscreen.render_state(), &robot);
    let plan = [[0.0, 0.0, -0.3], [0.02, 0.0, -0.3]];
    let mut set_up = false;
    let mut harness = egui_kittest::Harness::new_ui(|ui| {
        // The glyphs need the window's fonts, which hold from the next pass on.
        if !std::mem::replace(&mut set_up, true) {
            crate::gui::theme::install(ui.ctx());
            return;
        }
        let input = SceneInput {
            plan: Some(PlanMarks {
                waypoints_m: &plan,
                closed: false,
                selected: None,
                next: None,
                driven: &[],
            }),
            draft_target: Some([0.1, 0.0, -0.25]),
            reach: Some(ReachState::Marginal),
            ..SceneInput::new(&snapshot)
        };
        scene.ui(ui, &input);
    });
    harness.run_steps(2);
    harness.get_by_label("3D view of the arm");
    for part in [
        "top pad",
        "middle pad",
        "end pad",
        "gripper",
        "chamber 6, 0.0 kPa",
    ] {
        harness.get_by_label(part);
    }
    harness.get_by_label("waypoint 2 of 2 at x 20.0, y 0.0, z -300.0 mm");
    harness.get_by_label("spring 1 (1A), 153.8 mm");
    harness.get_by_label("IMU 4, yaw 0.0, pitch 0.0, roll 0.0 deg");
    harness.get_by_label("tip at x 0.0, y 0.0, z -300.0 mm");
    harness.get_by_label("draft target, marginal, at x 100.0, y 0.0, z -250.0 mm");
}
