use super::*;
use crate::learn::recipe::Channels;
use crate::learn::{PlantMap, synthetic};
use crate::signal::CHAMBERS;

/// Small and short: enough to see that training works.
fn recipe() -> Recipe {
    let mut r = Recipe::default();
    r.smap.hidden = vec![32, 32];
    r.smap.epochs = 120;
    r.s2r.hidden = vec![20];
    r.s2r.epochs = 150;
    r.plant.hidden = vec![32, 32];
    r.plant.epochs = 120;
    r
}

fn go(_: Progress) -> ControlFlow<()> {
    ControlFlow::Continue(())
}

/// The same arm with its pose measured in a frame that is shifted, turned and stretched.
fn gap(data: &Dataset) -> Dataset {
    let mut real = data.clone();
    let offset = crate::signal::pose_from_ypr([3e-3, -2e-3, 4e-3], [0.02, 0.0, -0.01]);
    for s in &mut real.samples {
        s.base_from_tip.translation.vector.x *= 1.03;
        s.base_from_tip = offset * s.base_from_tip;
    }
    real
}

#[test]
fn training_learns_the_map_corrects_the_gap_and_states_its_error() {
    let data = synthetic::dataset(3000, 1);
    let recipe = recipe();
    let mut losses = Vec::new();
    let mut watch = |p: Progress| {
        losses.push((p.train_loss, p.validation_loss));
        ControlFlow::Continue(())
    };
    let (cascade, report) = train_smap(&data, &recipe, &mut watch).expect("training works");
    assert!(losses.len() <= 120 && losses[losses.len() - 1].1 < 0.05 * losses[0].0);
    // The workspace is some 200 mm wide; the noise alone leaves some tenths of a mm.
    assert!(report.test.translation_mm.mean < 3.0, "{:?}", report.test);
    assert!(report.test.rotation_deg.mean < 1.2, "{:?}", report.test);
    assert!(report.test_clean.translation_mm.mean < report.test.translation_mm.mean);
    assert_eq!(
        (report.train.n, report.validation.n, report.test.n),
        (2100, 600, 300)
    );
    // 300 test samples: 95 % come out within ± 4 %. The bulk is covered generously, because the
    // errors have heavier tails than a normal distribution.
    let c = report.coverage;
    assert!((0.91..=0.99).contains(&c.translation_95), "{c:?}");
    assert!((0.91..=0.99).contains(&c.rotation_95), "{c:?}");
    assert!((0.63..0.90).contains(&c.translation_68), "{c:?}");
    assert!((0.63..0.90).contains(&c.rotation_68), "{c:?}");

    let real = gap(&synthetic::dataset(729, 2));
    let (corrected, report) = train_s2r(&cascade, &real, &recipe, &mut go).expect("it trains");
    assert!(report.before.translation_mm.mean > 4.0);
    assert!(
        report.after.test.translation_mm.mean < 0.5 * report.before.translation_mm.mean,
        "{:?} against {:?}",
        report.after.test.translation_mm,
        report.before.translation_mm
    );
    assert!(report.after.test.rotation_deg.mean < report.before.rotation_deg.mean);
    assert!(!corrected.parts().correction.is_none());
}

#[test]
fn the_same_seed_gives_the_same_bytes() {
    let data = synthetic::dataset(300, 1);
    let real = gap(&synthetic::dataset(100, 2));
    let mut recipe = recipe();
    recipe.members = 2;
    recipe.smap.epochs = 3;
    recipe.s2r.epochs = 3;
    recipe.plant.epochs = 3;
    let bytes = |recipe: &Recipe| {
        let model = train(&data, Some(&real), recipe, &mut go).expect("it trains");
        model.to_bytes().expect("it serialises")
    };
    let first = bytes(&recipe);
    assert_eq!(first, bytes(&recipe));
    recipe.seed += 1;
    assert_ne!(first, bytes(&recipe));
}

#[test]
fn the_plant_is_learned_with_payload_and_bounds() {
    let mut data = synthetic::dataset(3000, 4);
    // A sample under an external force says nothing about the plant.
    data.samples[7].tip_force_n = [5.0, 0.0, 0.0];
    data.samples[7].chamber_pa = [90e3; CHAMBERS];
    // Nor does one of an arm off nominal, though no force acts on it; payload is an input.
    data.samples[8].off_nominal = true;
    data.samples[8].chamber_pa = [90e3; CHAMBERS];
    let (plant, report) = train_plant(&data, &recipe(), &mut go).expect("it trains");
    assert_eq!(report.data.samples, 2998);
    assert!(report.test.spring_mm.mean < 2.0, "{:?}", report.test);
    assert!(report.test.imu_deg.mean < 1.0, "{:?}", report.test);
    assert!(plant.bounds().chamber_pa[0][1] <= 40e3 && plant.bounds().payload_kg[1] > 0.45);
    let p = [10e3, -5e3, 0.0, 20e3, -20e3, 15e3];
    let eval = plant.sensors(&p, 0.2);
    assert_eq!(eval.sensors, plant.value(&p, 0.2));
    for i in 0..CHAMBERS {
        let at = |step: f64| {
            let mut moved = p;
            moved[i] += step;
            plant.value(&moved, 0.2)
        };
        let h = 10.0;
        let d = (8.0 * (at(h) - at(-h)) - (at(2.0 * h) - at(-2.0 * h))) / (12.0 * h);
        let scale = eval.jacobian.abs().max();
        let error = (d - eval.jacobian.column(i)).abs().max();
        assert!(error < 1e-6 * scale, "chamber {i}: {error:e}");
    }
}

#[test]
fn channels_that_are_off_have_no_influence() {
    let data = synthetic::dataset(300, 1);
    let mut recipe = recipe();
    recipe.smap.epochs = 2;
    recipe.channels = Channels::Springs;
    let (map, _) = train_smap(&data, &recipe, &mut go).expect("it trains");
    let eval = map.pose(&data.samples[0].sensors.to_vector());
    let (springs, imus) = (eval.jacobian.columns(0, 12), eval.jacobian.columns(12, 12));
    assert!(springs.abs().max() > 0.0 && imus.abs().max() == 0.0);
}

#[test]
fn training_can_be_cancelled_and_refuses_bad_data() {
    let mut data = synthetic::dataset(200, 1);
    let mut stop = |p: Progress| match p.epoch {
        3 => ControlFlow::Break(()),
        _ => ControlFlow::Continue(()),
    };
    let e = train_smap(&data, &recipe(), &mut stop).expect_err("it was cancelled");
    assert!(matches!(e, TrainError::Cancelled));
    data.samples[17].sensors.spring_m[3] = f64::NAN;
    let e = train_smap(&data, &recipe(), &mut go).expect_err("not finite");
    assert!(e.to_string().contains("sample 17"), "{e}");
    data.samples.truncate(10);
    let e = train_plant(&data, &recipe(), &mut go).expect_err("too few");
    assert!(e.to_string().contains("10 samples"), "{e}");
}

#[test]
fn a_correction_that_does_not_help_is_left_out() {
    let data = synthetic::dataset(2000, 1);
    let recipe = recipe();
    let (cascade, _) = train_smap(&data, &recipe, &mut go).expect("it trains");
    // What the training part says is not so in the others.
    let mut real = synthetic::dataset(300, 9);
    for i in split(300, &recipe.split, None, recipe.seed).train {
        real.samples[i].base_from_tip.translation.vector.x += 0.05;
    }
    let (map, report) = train_s2r(&cascade, &real, &recipe, &mut go).expect("it trains");
    assert!(!report.kept.translation && map.parts().correction.translation.is_none());
    // With a gap that can be learned it stays.
    let real = gap(&synthetic::dataset(300, 3));
    let (map, report) = train_s2r(&cascade, &real, &recipe, &mut go).expect("it trains");
    assert!(report.kept.translation && report.kept.rotation);
    let correction = &map.parts().correction;
    assert!(correction.translation.is_some() && correction.rotation.is_some());
}

/// A gap in the whole session in one part of the pose, and in the training part alone in the other one: the product of
/// both errors falls, and so it does when one of them gets worse.
#[test]
fn each_correction_is_kept_by_its_own_held_out_error_alone() {
    let data = synthetic::dataset(2000, 1);
    let recipe = recipe();
    let (cascade, _) = train_smap(&data, &recipe, &mut go).expect("it trains");
    for translation in [true, false] {
        let mut real = synthetic::dataset(300, 9);
        let training = split(300, &recipe.split, None, recipe.seed).train;
        for (i, s) in real.samples.iter_mut().enumerate() {
            let [everywhere, in_training] = [1.0, f64::from(u8::from(training.contains(&i)))];
            let [by_m, by_rad] = match translation {
                true => [0.1 * everywhere, 0.04 * in_training],
                false => [0.01 * in_training, 0.5 * everywhere],
            };
            s.base_from_tip.translation.vector.x += by_m;
            let turn = nalgebra::UnitQuaternion::from_euler_angles(0.0, 0.0, by_rad);
            s.base_from_tip.rotation = turn * s.base_from_tip.rotation;
        }
        let (map, report) = train_s2r(&cascade, &real, &recipe, &mut go).expect("it trains");
        let kept = report.kept;
        assert_eq!(
            (kept.translation, kept.rotation),
            (translation, !translation)
        );
        let correction = &map.parts().correction;
        assert_eq!(correction.translation.is_some(), translation);
        assert_eq!(correction.rotation.is_some(), !translation);
        let (before, after) = (&report.before, &report.after.test);
        let errors = [
            (
                before.translation_mm.rmse,
                after.translation_mm.rmse,
                translation,
            ),
            (
                before.rotation_deg.rmse,
                after.rotation_deg.rmse,
                !translation,
            ),
        ];
        for (before, after, kept) in errors {
            match kept {
                true => assert!(after < 0.5 * before, "{before} {after}"),
                false => assert!((after - before).abs() < 1e-9, "{before} {after}"),
            }
        }
    }
}

#[test]
fn a_trajectory_is_held_out_in_blocks_of_time_by_every_recipe() {
    let recipe = recipe();
    assert_eq!(recipe.split.block, 1);
    let base = train(&synthetic::dataset(600, 1), None, &recipe, &mut go).expect("it trains");
    let mut real = gap(&synthetic::dataset(1000, 3));
    real.row_s = Some(0.1);
    let parts = dealt(&real, &recipe, "the session").expect("ten blocks");
    let sizes = [&parts.train, &parts.validation, &parts.test].map(Vec::len);
    assert_eq!(sizes, [700, 200, 100]);
    assert!(
        parts.test.windows(2).all(|w| w[1] == w[0] + 1),
        "{:?}",
        parts.test
    );
    let own = adapt(&base, &real, &recipe, &mut go).expect("it trains");
    assert_eq!(own.scores.s2r.expect("scores").after.test.n, 100);
    real.row_s = Some(0.02);
    let e = dealt(&real, &recipe, "the session")
        .expect_err("two blocks")
        .to_string();
    assert!(e.contains("split.block_s"), "{e}");
}

#[test]
fn an_arm_of_its_own_keeps_the_sensor_map_and_the_plant() {
    let recipe = recipe();
    let base = train(&synthetic::dataset(600, 1), None, &recipe, &mut go).expect("it trains");
    let mut session = recipe.clone();
    session.split.block = 20;
    let real = gap(&synthetic::dataset(300, 3));
    let own = adapt(&base, &real, &session, &mut go).expect("it trains");
    let (a, b) = (base.cascade.parts(), own.cascade.parts());
    assert!(a.smap == b.smap && base.plant.net() == own.plant.net());
    assert!(own.scores.s2r.is_some() && own.recipe.split == session.split);
    assert_eq!(own.scores.smap, base.scores.smap);
}

#[test]
fn blocks_that_leave_a_part_empty_are_refused() {
    let data = synthetic::dataset(300, 1);
    let mut recipe = recipe();
    recipe.split.block = 200;
    let e = train_smap(&data, &recipe, &mut go).expect_err("two blocks for three parts");
    assert!(e.to_string().contains("split.block"), "{e}");
}
