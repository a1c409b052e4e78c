use nalgebra::{SVector, UnitQuaternion, Vector3};
use proptest::prelude::*;

use super::fake::{NOISE, frames, generator, object, pairs, tip};
use super::fit::{Observation, PARAMETERS, State, Step, UNITS};
use super::*;

const STATED: FitOptions = FitOptions {
    robot: NOISE,
    mocap: NOISE,
    object: ObjectFrame::Unknown,
};

fn tips(seed: u64, n: usize) -> Vec<Pose> {
    let mut g = generator(seed);
    (0..n).map(|_| tip(&mut g)).collect()
}

fn made(seed: u64, n: usize, scale: f64) -> (Frames, Vec<PosePair>) {
    let frames = frames(seed);
    let pairs = pairs(&mut generator(seed + 1), &frames, &tips(seed, n), scale);
    (frames, pairs)
}

/// Difference of frames in the fit's parameters: φ_X, X ā, φ_Y, t_Y.
fn error(fit: &FrameFit, truth: &Frames) -> SVector<f64, 12> {
    let (x, y) = (&fit.frames.base_from_world, &fit.frames.object_from_tip);
    let centre = nalgebra::Point3::from(fit.centre_in_world_m);
    let mut e = SVector::<f64, 12>::zeros();
    let mut put = |at: usize, v: Vector3<f64>| e.fixed_rows_mut::<3>(at).copy_from(&v);
    put(
        0,
        (x.rotation * truth.base_from_world.rotation.inverse()).scaled_axis(),
    );
    put(3, x * centre - truth.base_from_world * centre);
    put(
        6,
        (truth.object_from_tip.rotation.inverse() * y.rotation).scaled_axis(),
    );
    put(
        9,
        y.translation.vector - truth.object_from_tip.translation.vector,
    );
    e
}

#[test]
fn jacobian_by_finite_differences() {
    for seed in 0..6 {
        let truth = frames(seed);
        let [a, b] = [0, 1].map(|k| tips(seed + 7, 2)[k]);
        let mut g = generator(seed);
        let o = Observation {
            // Far from each other, so that J⁻¹(r) matters.
            base_from_tip: a,
            world_from_object: object(&truth, &b),
            velocity_m_s: Vector3::from_fn(|_, _| rand::Rng::random_range(&mut g, -1.0..1.0)),
            rate_rad_s: Vector3::from_fn(|_, _| rand::Rng::random_range(&mut g, -1.0..1.0)),
        };
        let state = State {
            frames: truth,
            centre_in_world_m: Vector3::new(0.3, -0.2, 0.7),
            delay_s: 0.02,
        };
        let j = state.jacobian(&o);
        for k in 0..PARAMETERS {
            let mut step = Step::zeros();
            step[k] = 1e-6 / UNITS[k];
            let d = (state.moved(&step).residual(&o) - state.moved(&-step).residual(&o)) / 2e-6;
            assert!(
                (d - j.column(k)).norm() < 1e-7,
                "{seed} {k}\n{d}\n{}",
                j.column(k)
            );
        }
    }
}

#[test]
fn stated_noise_of_the_residual_is_what_samples_show() {
    let truth = frames(4);
    let at = tips(3, 1);
    let mut g = generator(9);
    let state = State {
        frames: truth,
        centre_in_world_m: Vector3::zeros(),
        delay_s: 0.0,
    };
    let mut sum = crate::signal::Matrix6::zeros();
    let n = 20_000;
    for _ in 0..n {
        let pair = pairs(&mut g, &truth, &at, 1.0)[0];
        let r = state.residual(&Observation::at_rest(&pair));
        sum += r * r.transpose();
    }
    let o = Observation::at_rest(&pairs(&mut g, &truth, &at, 0.0)[0]);
    let stated = state.noise(&o, &STATED);
    let scale = SVector::<f64, 6>::from_fn(|k, _| 1.0 / stated[(k, k)].sqrt());
    for a in 0..6 {
        for b in 0..6 {
            let off = (sum[(a, b)] / n as f64 - stated[(a, b)]) * scale[a] * scale[b];
            assert!(off.abs() < 0.04, "{a} {b} {off}");
        }
    }
    // The lever is long enough for the off-diagonal part to matter.
    let cross = (0..3).flat_map(|a| (3..6).map(move |b| (a, b)));
    let most = cross.map(|(a, b)| (stated[(a, b)] * scale[a] * scale[b]).abs());
    assert!(most.fold(0.0, f64::max) > 0.1);
}

#[test]
fn without_noise_the_frames_are_exact() {
    for seed in 0..24 {
        let (truth, pairs) = made(seed, 12, 0.0);
        let fit = register(&pairs, &STATED).expect("fits");
        let e = error(&fit, &truth);
        assert!(e.amax() < 1e-9, "{seed}: {e}");
        assert!(fit.summary.position_worst_m < 1e-9 && fit.suspects.is_empty());
        let known = FitOptions {
            object: ObjectFrame::Known(truth.object_from_tip),
            ..STATED
        };
        let fit = register(&pairs, &known).expect("fits");
        assert!(error(&fit, &truth).amax() < 1e-9, "{seed}");
        assert_eq!(fit.frames.object_from_tip, truth.object_from_tip);
        assert_eq!(fit.object_from_tip_sigma().position_m, 0.0);
    }
}

#[test]
fn errors_are_what_the_covariance_says_over_many_seeds() {
    let (mut square, mut square_known, mut misfit) = (0.0, 0.0, 0.0);
    let seeds = 60;
    for seed in 0..seeds {
        let (truth, pairs) = made(100 + seed, 20, 1.0);
        let fit = register(&pairs, &STATED).expect("fits");
        let e = error(&fit, &truth);
        square += e.dot(&(fit.covariance.try_inverse().expect("regular") * e));
        assert!(fit.suspects.is_empty() && fit.converged, "{seed}");
        misfit += fit.misfit.powi(2);
        let (x, y) = (fit.base_from_world_sigma(), fit.object_from_tip_sigma());
        for (at, sigma) in [
            (0, x.rotation_rad),
            (3, x.position_m),
            (6, y.rotation_rad),
            (9, y.position_m),
        ] {
            let off = e.fixed_rows::<3>(at).norm();
            assert!(off < 5.0 * sigma, "{seed} {at}: {off} {sigma}");
        }
        let known = FitOptions {
            object: ObjectFrame::Known(truth.object_from_tip),
            ..STATED
        };
        let fit = register(&pairs, &known).expect("fits");
        let e = error(&fit, &truth).fixed_rows::<6>(0).into_owned();
        let c = fit
            .covariance
            .fixed_view::<6, 6>(0, 0)
            .try_inverse()
            .expect("regular");
        square_known += e.dot(&(c * e));
    }
    let n = seeds as f64;
    // Sums of n χ²: standard deviations of their means are √(2 k / n).
    let near = |mean: f64, k: f64| {
        assert!(
            (mean - k).abs() < 4.0 * (2.0 * k / n).sqrt(),
            "{mean} for {k}"
        );
    };
    println!(
        "normalised error squared {} of 12, {} of 6",
        square / n,
        square_known / n
    );
    near(square / n, 12.0);
    near(square_known / n, 6.0);
    assert!((misfit / n - 1.0).abs() < 4.0 * (2.0 / (108.0 * n)).sqrt());
}

#[test]
fn held_out_residuals_are_the_noise_put_in() {
    let (mut got, mut surprise, mut count) = ([0.0; 2], 0.0, 0.0);
    for seed in 0..10 {
        let (truth, pairs) = made(300 + seed, 40, 1.0);
        let fit = register(&pairs, &STATED).expect("fits");
        assert!(fit.suspects.is_empty(), "{seed} {:?}", fit.suspects);
        // Per axis: noise of both sides, and the object's rotation times the lever across it.
        let lever_m = truth.object_from_tip.translation.vector.norm();
        let position =
            6.0 * NOISE.position_m.powi(2) + 2.0 * (lever_m * NOISE.rotation_rad).powi(2);
        let rotation = 6.0 * NOISE.rotation_rad.powi(2);
        got[0] += fit.summary.position_rms_m.powi(2) / position;
        got[1] += fit.summary.rotation_rms_rad.powi(2) / rotation;
        for h in &fit.held_out {
            surprise += h.surprise[0] + h.surprise[1];
            count += 2.0;
        }
        assert!(fit.summary.position_worst_m > fit.summary.position_rms_m);
    }
    // Twelve parameters from 39 poses predict the fortieth worse by about 12/234 of the variance.
    println!(
        "held out over put in {:?}, surprise {}",
        got,
        surprise / count
    );
    assert!(
        got.iter().all(|g| (0.95..1.2).contains(&(g / 10.0))),
        "{got:?}"
    );
    assert!((surprise / count - 3.0).abs() < 0.3, "{}", surprise / count);
}

#[test]
fn a_falsified_pair_is_named_and_does_no_harm() {
    for seed in 0..12 {
        let (truth, mut pairs) = made(500 + seed, 15, 1.0);
        let which = (seed as usize * 7) % 15;
        let away = Vector3::new(0.003, -0.004, 0.0);
        pairs[which].base_from_tip.translation.vector += away;
        let fit = register(&pairs, &STATED).expect("fits");
        assert_eq!(fit.suspects, [which], "{seed}");
        assert_eq!(fit.used(), 14);
        assert!((fit.held_out[which].distance_m() - 0.005).abs() < 0.001);
        assert!(fit.summary.position_worst_m < 0.001);
        let e = error(&fit, &truth);
        let sigma = fit.base_from_world_sigma().position_m;
        assert!(e.fixed_rows::<3>(3).norm() < 5.0 * sigma, "{seed}");
        // Stated noise that is much too large hides nothing: 1 mm and half a degree of the robot.
        let fit = register(&pairs, &FitOptions::default()).expect("fits");
        assert_eq!(fit.suspects, [which], "{seed}");
    }
    // A rotation falsified, and two pairs at once.
    let (_, mut pairs) = made(600, 24, 1.0);
    pairs[3].world_from_object.rotation *=
        UnitQuaternion::from_scaled_axis(Vector3::new(0.0, 0.03, 0.0));
    pairs[17].base_from_tip.translation.vector.z += 0.005;
    assert_eq!(register(&pairs, &STATED).expect("fits").suspects, [3, 17]);
    // Among ten, the nine others are too few; the one is named, counted from 1.
    let (_, mut pairs) = made(601, 10, 1.0);
    pairs[4].base_from_tip.translation.vector.y -= 0.005;
    let e = register(&pairs, &STATED).expect_err("too few left");
    assert!(
        matches!(&e, RegistrationError::TooFewLeft { suspects, left: 9, .. } if *suspects == [4])
    );
    assert!(e.to_string().contains("counted from 1: 5"), "{e}");
}

fn refused(tips: &[Pose], options: &FitOptions, scale: f64) -> Missing {
    let mut g = generator(5);
    let pairs = pairs(&mut g, &frames(5), tips, scale);
    match register(&pairs, options) {
        Err(RegistrationError::Unobservable(missing)) => missing,
        other => panic!("{other:?}"),
    }
}

#[test]
fn motion_that_leaves_a_direction_open_is_refused_by_name() {
    for scale in [0.0, 1.0] {
        let level = |p: Pose| Pose::from_parts(p.translation, UnitQuaternion::identity());
        let upright: Vec<Pose> = tips(1, 20).into_iter().map(level).collect();
        assert_eq!(refused(&upright, &STATED, scale), Missing::Tilts);
        // A tenth of a degree is not a tilt either.
        let nearly = |(k, p): (usize, Pose)| {
            let v = Vector3::new((k as f64).sin(), (k as f64).cos(), 0.0) * 2e-3;
            Pose::from_parts(p.translation, UnitQuaternion::from_scaled_axis(v))
        };
        let nearly: Vec<Pose> = tips(1, 20).into_iter().enumerate().map(nearly).collect();
        assert_eq!(refused(&nearly, &STATED, scale), Missing::Tilts);

        let in_plane = |(k, p): (usize, Pose)| {
            let v = Vector3::y() * (0.7 * (k as f64).sin());
            Pose::from_parts(p.translation, UnitQuaternion::from_scaled_axis(v))
        };
        let in_plane: Vec<Pose> = tips(1, 20).into_iter().enumerate().map(in_plane).collect();
        match refused(&in_plane, &STATED, scale) {
            Missing::SecondAxis(axis) => {
                assert!(
                    (Vector3::from(axis) - Vector3::y()).norm() < 0.02,
                    "{axis:?}"
                );
            }
            other => panic!("{other:?}"),
        }

        let one_place = |p: Pose| Pose::from_parts(Vector3::new(0.0, 0.0, -0.3).into(), p.rotation);
        let one_place: Vec<Pose> = tips(1, 20).into_iter().map(one_place).collect();
        assert_eq!(refused(&one_place, &STATED, scale), Missing::Places);
        let same = vec![tips(1, 1)[0]; 20];
        let known = FitOptions {
            object: ObjectFrame::Known(frames(5).object_from_tip),
            ..STATED
        };
        assert_eq!(refused(&same, &STATED, scale), Missing::Places);
        assert_eq!(refused(&same, &known, scale), Missing::Places);
        // On a line, with orientations that say nothing.
        let on_line = |k: usize| Pose::translation(0.01 * k as f64, 0.0, -0.3);
        let on_line: Vec<Pose> = (0..20).map(on_line).collect();
        let deaf = FitOptions {
            robot: Noise {
                rotation_rad: 1.0,
                ..NOISE
            },
            ..known
        };
        assert_eq!(refused(&on_line, &deaf, scale), Missing::Directions);
        // With the object known, upright poses are enough.
        let pairs = pairs(&mut generator(5), &frames(5), &upright, scale);
        assert!(register(&pairs, &known).is_ok());
    }
    let e = RegistrationError::Unobservable(Missing::SecondAxis([0.0, 1.0, 0.0])).to_string();
    assert!(
        e.contains("(0.00, 1.00, 0.00)") && e.contains("another axis"),
        "{e}"
    );
}

#[test]
fn too_few_and_poses_of_another_motion_are_refused() {
    let (_, pairs) = made(1, 9, 1.0);
    let e = register(&pairs, &STATED).expect_err("nine");
    assert_eq!(e, RegistrationError::TooFew { poses: 9 });
    assert!(e.to_string().contains("only 9"), "{e}");
    let (_, mut pairs) = made(1, 20, 1.0);
    let robot: Vec<Pose> = pairs.iter().map(|p| p.base_from_tip).collect();
    for (k, p) in pairs.iter_mut().enumerate() {
        p.base_from_tip = robot[(k + 7) % 20];
    }
    let e = register(&pairs, &STATED).expect_err("another motion");
    assert!(matches!(e, RegistrationError::Disagree { .. }), "{e}");
    pairs[5].base_from_tip.translation.vector.x = f64::NAN;
    let e = register(&pairs, &STATED).expect_err("no pose");
    assert_eq!(e, RegistrationError::NotAPose { index: 5 });
    let odd = FitOptions {
        robot: Noise {
            position_m: 0.0,
            ..NOISE
        },
        ..STATED
    };
    assert!(matches!(
        register(&pairs, &odd),
        Err(RegistrationError::Option { .. })
    ));
}

#[test]
fn pairs_of_a_block_are_left_out_together() {
    // Each block of five shares an offset of 2 mm: alone, its neighbours hide it.
    let (_, mut pairs) = made(42, 30, 1.0);
    let blocks: Vec<usize> = (0..30).map(|i| i / 5).collect();
    for (p, block) in pairs.iter_mut().zip(&blocks) {
        let phase = *block as f64;
        p.base_from_tip.translation.vector +=
            Vector3::new(phase.sin(), (2.0 * phase).cos(), (3.0 * phase).sin()) * 0.002;
    }
    let alone = register(&pairs, &FitOptions::default()).expect("fits");
    let together = register_blocks(&pairs, &blocks, &FitOptions::default()).expect("fits");
    assert_eq!(alone.frames, together.frames);
    assert!(together.summary.position_rms_m > 1.1 * alone.summary.position_rms_m);
}

fn any_number() -> impl Strategy<Value = f64> {
    prop_oneof![
        8 => -1.0..1.0f64,
        1 => Just(0.0),
        1 => prop_oneof![
            Just(f64::NAN), Just(f64::INFINITY), Just(1e300), Just(1e-300), Just(900.0)
        ],
    ]
}

prop_compose! {
    fn any_pose()(v in prop::array::uniform6(any_number()), fine in any::<bool>()) -> Pose {
        let [x, y, z, a, b, c] = if fine {
            v.map(|x| if x.is_finite() && x.abs() < 1.0 { x } else { 0.0 })
        } else {
            v
        };
        Pose::from_parts(
            Vector3::new(x, y, z).into(),
            UnitQuaternion::from_scaled_axis(Vector3::new(a, b, c)),
        )
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]
    #[test]
    fn nothing_panics(
        poses in prop::collection::vec((any_pose(), any_pose()), 0..16),
        repeat in 1usize..4,
        scale in any_number(),
    ) {
        let pairs: Vec<PosePair> = poses
            .iter()
            .flat_map(|p| std::iter::repeat_n(p, repeat))
            .map(|(b, a)| PosePair { base_from_tip: *b, world_from_object: *a })
            .collect();
        for object in [ObjectFrame::Unknown, ObjectFrame::Known(Pose::identity())] {
            let options = FitOptions {
                robot: Noise { position_m: scale.abs(), ..NOISE },
                object,
                ..STATED
            };
            if let Ok(fit) = register(&pairs, &options) {
                prop_assert!(fit.covariance.iter().all(|x| x.is_finite()));
                prop_assert!(fit.summary.position_rms_m.is_finite());
            }
        }
    }
}
