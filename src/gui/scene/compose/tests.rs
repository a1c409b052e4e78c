use super::*;
use crate::gui::scene::tests::bent_shape;

#[test]
fn resampled_frames_are_evenly_spaced_and_keep_the_ends() {
    let robot = RobotSpec::reference();
    let shape = bent_shape(&robot, [0.9, -0.6], [0.4, 2.0]);
    for sections in &shape.base_from_section {
        let frames = resample(sections);
        assert_eq!(frames.len(), FRAMES);
        let (first, _) = convert::parts(&sections[0]);
        let (last, _) = convert::parts(&sections[sections.len() - 1]);
        assert!(frames[0].0.distance(first) < 1e-6);
        assert!(frames[FRAMES - 1].0.distance(last) < 1e-6);
        let step: Vec<f32> = frames.windows(2).map(|w| w[0].0.distance(w[1].0)).collect();
        let (lo, hi) = step
            .iter()
            .fold((f32::MAX, 0.0_f32), |(l, h), s| (l.min(*s), h.max(*s)));
        assert!(hi / lo < 1.02, "{lo} {hi}");
    }
}

#[test]
fn a_truth_that_is_older_than_the_estimate_draws_no_ring_and_no_error() {
    let robot = RobotSpec::reference();
    let camera = Camera::framing(Vec3::ZERO, 0.4);
    let lines = |truth_s: Option<f64>| {
        let shape = bent_shape(&robot, [0.9, -0.6], [0.4, 2.0]);
        let mut snapshot = crate::gui::scene::tests::snapshot_of(shape);
        let at = crate::signal::Stamp::from_seconds;
        if let Some(e) = &mut snapshot.estimate {
            e.stamp = at(10.0);
        }
        snapshot.truth = snapshot.truth.zip(truth_s).map(|(mut t, s)| {
            t.stamp = at(s);
            t
        });
        let input = SceneInput::new(&snapshot);
        let size = Vec2::splat(400.0);
        compose(&robot, &input, &camera, size, &SceneOutput::default())
            .lines
            .len()
    };
    assert!(lines(Some(9.95)) > lines(None));
    assert_eq!(lines(Some(9.5)), lines(None));
}

#[test]
fn an_empty_shape_draws_the_fixture_alone() {
    let robot = RobotSpec::reference();
    let snapshot = crate::signal::Snapshot {
        shape: Some(std::sync::Arc::default()),
        ..Default::default()
    };
    let camera = Camera::framing(Vec3::ZERO, 0.4);
    let drawing = compose(
        &robot,
        &SceneInput::new(&snapshot),
        &camera,
        Vec2::splat(400.0),
        &SceneOutput::default(),
    );
    assert!(
        drawing
            .parts
            .iter()
            .all(|(_, part, _)| *part != Part::Bellows)
    );
    assert!(
        drawing
            .parts
            .iter()
            .any(|(_, part, _)| *part == Part::TopPad)
    );
}

#[test]
fn every_sensor_and_chamber_can_be_picked() {
    let robot = RobotSpec::reference();
    let snapshot = crate::signal::Snapshot {
        shape: Some(std::sync::Arc::new(bent_shape(
            &robot,
            [0.3, 0.3],
            [0.0, 1.0],
        ))),
        ..Default::default()
    };
    let camera = Camera::framing(Vec3::ZERO, 0.4);
    let drawing = compose(
        &robot,
        &SceneInput::new(&snapshot),
        &camera,
        Vec2::splat(400.0),
        &SceneOutput::default(),
    );
    let ids: Vec<u32> = drawing.parts.iter().map(|(_, _, i)| i.pick_id).collect();
    let wanted = (0..SPRINGS)
        .map(Entity::Spring)
        .chain((0..IMUS).map(Entity::Imu))
        .chain((0..crate::signal::CHAMBERS).map(Entity::Bellows));
    for entity in wanted {
        assert!(ids.contains(&entity.id()), "{entity:?}");
        assert_eq!(Entity::from_id(entity.id()), Some(entity));
    }
}

#[test]
fn a_model_that_is_tried_is_a_second_ghost_in_a_colour_of_its_own() {
    let robot = RobotSpec::reference();
    let snapshot =
        crate::gui::scene::tests::snapshot_of(bent_shape(&robot, [0.3, 0.3], [0.0, 1.0]));
    let [preview, tried] = [0.5, 0.4].map(|bend| bent_shape(&robot, [bend, 0.3], [0.0, 1.0]));
    let camera = Camera::framing(Vec3::ZERO, 0.4);
    let drawn = |ghost, tried| {
        let input = SceneInput {
            ghost,
            tried,
            ..SceneInput::new(&snapshot)
        };
        let size = Vec2::splat(400.0);
        compose(&robot, &input, &camera, size, &SceneOutput::default())
    };
    let ghosts = |d: &Drawing| {
        let bellows = d
            .parts
            .iter()
            .filter(|(l, p, _)| (*l, *p) == (Layer::Ghost, Part::Bellows));
        let mut colours: Vec<[f32; 4]> = bellows.map(|(_, _, i)| i.colour).collect();
        colours.dedup();
        colours
    };
    let both = drawn(Some(&preview), Some((&tried, "payload")));
    assert_eq!(ghosts(&both).len(), 2, "each with a colour");
    let one = drawn(Some(&preview), None);
    assert_eq!(ghosts(&one).len(), 1);
    assert!(both.lines.len() > one.lines.len(), "its outline");
    // Each has section frames of its own.
    let frames =
        |d: &Drawing, slot: usize| d.frames[slot * FRAMES * 3..(slot + 1) * FRAMES * 3].to_vec();
    assert_eq!(frames(&both, 2), frames(&one, 2));
    assert_ne!(frames(&both, 2), frames(&both, 4));
    assert!(frames(&one, 4).iter().all(|row| *row == [0.0; 4]));
}
