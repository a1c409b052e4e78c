//! Tests of the adjustment on frames made from known constants.

use nalgebra::{UnitQuaternion, Vector3};
use rand::SeedableRng as _;
use rand_distr::Distribution as _;
use rand_pcg::Pcg64Mcg;

use super::frames::{BLOCK_S, line};
use super::measure::{Cameras, Constants, Row};
use super::*;
use crate::signal::{Pose, pose_from_ypr};

fn white(rng: &mut Pcg64Mcg) -> f64 {
    rand_distr::StandardNormal.sample(rng)
}

fn reference() -> (RobotSpec, Calibration, Model) {
    let spec = RobotSpec::reference();
    let calibration = Calibration::as_drawn();
    let model = Model::new(&spec, &calibration);
    (spec, calibration, model)
}

/// Constants drawn from half their priors.
fn drawn(calibration: &Calibration, seed: u64) -> Constants {
    let mut rng = Pcg64Mcg::seed_from_u64(seed);
    let prior = priors(calibration);
    std::array::from_fn(|i| {
        let share = if (GYROS..ACCEL_GAINS).contains(&i) {
            0.05
        } else {
            0.7
        };
        share * prior[i] * white(&mut rng)
    })
}

/// Poses of a slow motion to all sides; `swing` scales how far the pads turn.
fn pads_at(t_s: f64, swing: f64) -> [Pose; 2] {
    let s = |rate: f64, phase: f64| (rate * t_s + phase).sin();
    let at = [0.0, 1.0].map(|k| {
        let bend = [
            0.08 * s(0.13, k),
            0.30 * s(0.31, 2.0 * k),
            0.30 * s(0.23, 1.0 + k),
        ];
        let place = [
            0.03 * s(0.19, k),
            0.03 * s(0.29, 1.0 - k),
            -0.145 + 0.035 * s(0.11, 3.0 * k),
        ];
        pose_from_ypr(place, bend.map(|x| swing * x))
    });
    crate::sensing::platform::pads(&RobotSpec::reference(), &at)
}

/// Frames of a motion whose constants are `of` a time.
fn made(
    model: &Model,
    seconds: f64,
    swing: f64,
    with_cameras: bool,
    of: &dyn Fn(f64) -> Constants,
) -> Vec<Frame> {
    let mut rng = Pcg64Mcg::seed_from_u64(5);
    let every_s = 0.8;
    let n = (seconds / every_s) as usize;
    let times: Vec<f64> = (0..n).map(|k| k as f64 * every_s).collect();
    let mut out = Vec::new();
    for (k, &t_s) in times.iter().enumerate() {
        let (x, pads) = (of(t_s), pads_at(t_s, swing));
        let length_m = std::array::from_fn(|i| {
            let sd_m = 0.08e-3;
            Some([model.length(&x, &pads, i).0 + sd_m * white(&mut rng), sd_m])
        });
        let force = std::array::from_fn(|j| {
            let noise = Vector3::from_fn(|_, _| 0.015 * white(&mut rng));
            Some((model.force(&x, &pads, j).0 + noise, 0.015))
        });
        let tip = with_cameras.then(|| {
            let markers = Pose::from_parts(
                Vector3::from_column_slice(&x[MARKERS..MARKERS + 3]).into(),
                UnitQuaternion::from_scaled_axis(Vector3::from_column_slice(&x[MARKERS + 3..])),
            );
            let off_m = Vector3::from_fn(|_, _| 0.2e-3 * white(&mut rng));
            let turn = Vector3::from_fn(|_, _| 0.05 * DEG * white(&mut rng));
            let mut seen = pads[1] * markers;
            seen.translation.vector += off_m;
            seen.rotation = UnitQuaternion::from_scaled_axis(turn) * seen.rotation;
            seen
        });
        let mut link = [None; IMUS];
        if let Some(next_s) = times.get(k + 1) {
            let next = pads_at(*next_s, swing);
            for (j, link) in link.iter_mut().enumerate() {
                let mut made = Link {
                    turn: UnitQuaternion::identity(),
                    by_bias_s: nalgebra::Matrix3::identity() * every_s,
                    sd_rad: 2e-4,
                };
                // What is off an identity is the turn itself, with the bias.
                let none = [0.0; CONSTANTS];
                let mut turned = none;
                turned[MOUNTS..ACCELS].copy_from_slice(&x[MOUNTS..ACCELS]);
                let turn = model.turn(&turned, &pads, &next, j, &made).0;
                let bias = Vector3::from_column_slice(&x[GYROS + 3 * j..GYROS + 3 * j + 3]);
                let gain =
                    Vector3::from_column_slice(&x[GYRO_GAINS + 3 * j..GYRO_GAINS + 3 * j + 3]);
                let turn = turn.component_mul(&gain.add_scalar(1.0));
                let noise = Vector3::from_fn(|_, _| 2e-4 * white(&mut rng));
                made.turn = UnitQuaternion::from_scaled_axis(turn)
                    * UnitQuaternion::from_scaled_axis(bias * every_s + noise);
                *link = Some(made);
            }
        }
        // Not where it is.
        let start = pads.map(|p| {
            Pose::from_parts(
                (p.translation.vector + Vector3::new(1e-3, -1e-3, 1e-3)).into(),
                UnitQuaternion::from_scaled_axis(Vector3::new(0.01, -0.01, 0.02)) * p.rotation,
            )
        });
        out.push(Frame {
            t_s,
            take: 0,
            block: (t_s / BLOCK_S) as usize,
            length_m,
            force,
            tip,
            link,
            start,
        });
    }
    out
}

#[test]
fn derivatives_are_those_of_finite_differences() {
    let (_, calibration, model) = reference();
    let x = drawn(&calibration, 3);
    let frames = made(&model, 2.0, 1.0, true, &|_| drawn(&calibration, 4));
    let (frame, pads, next) = (&frames[0], pads_at(0.3, 1.0), pads_at(1.0, 1.0));
    let rows = |x: &Constants, pads: &[Pose; 2], next: &[Pose; 2]| -> Vec<Row> {
        let mut out = Vec::new();
        model.rows(x, frame, pads, Some(next), Cameras::Used, &mut |row| {
            out.push(*row)
        });
        out
    };
    let at = rows(&x, &pads, &next);
    assert_eq!(at.len(), 12 + 12 + 12 + 6);
    let h = 1e-6;
    let moved = |pads: &[Pose; 2], k: usize, by: f64| {
        let mut out = *pads;
        let pad = &mut out[k / 6];
        if k % 6 < 3 {
            pad.translation.vector[k % 3] += by;
        } else {
            let turn = UnitQuaternion::from_scaled_axis(Vector3::ith(k % 3, by));
            pad.rotation = turn * pad.rotation;
        }
        out
    };
    let compare =
        |what: &str, k: usize, plus: Vec<Row>, minus: Vec<Row>, of: &dyn Fn(&Row) -> f64| {
            for (n, ((row, a), b)) in at.iter().zip(&plus).zip(&minus).enumerate() {
                // The residual is measured less predicted.
                let by_difference = (b.residual - a.residual) / (2.0 * h);
                let stated = of(row);
                let scale = 1.0 + stated.abs().max(by_difference.abs());
                assert!(
                    (by_difference - stated).abs() < 2e-3 * scale + 1.0,
                    "{what} {k}, row {n}: {by_difference} {stated}"
                );
            }
        };
    for k in 0..12 {
        let (plus, minus) = (moved(&pads, k, h), moved(&pads, k, -h));
        compare(
            "pose",
            k,
            rows(&x, &plus, &next),
            rows(&x, &minus, &next),
            &|r| r.this[k],
        );
        let (plus, minus) = (moved(&next, k, h), moved(&next, k, -h));
        compare(
            "next pose",
            k,
            rows(&x, &pads, &plus),
            rows(&x, &pads, &minus),
            &|r| r.next.map_or(0.0, |next| next[k]),
        );
    }
    for k in 0..CONSTANTS {
        let (mut plus, mut minus) = (x, x);
        plus[k] += h;
        minus[k] -= h;
        compare(
            "constant",
            k,
            rows(&plus, &pads, &next),
            rows(&minus, &pads, &next),
            &|r| r.constants().iter().filter(|c| c.0 == k).map(|c| c.1).sum(),
        );
    }
}

/// Error of the end pad's place with constants `x` instead of `truth`, from lengths and inclinations alone: mean, m.
fn tip_error_m(model: &Model, truth: &Constants, x: &Constants, calibration: &Calibration) -> f64 {
    let frames = made(model, 40.0, 1.0, false, &|_| *truth);
    let prior = priors(calibration);
    let problem = Problem::new(model, &frames, &prior);
    let all: Vec<usize> = (0..frames.len()).collect();
    let fit = problem
        .fit_from(&all, &[], Cameras::Unused, *x)
        .expect("fits");
    let off_m = fit.state.pads.iter().zip(&frames).map(|(pads, frame)| {
        (pads[1].translation.vector - pads_at(frame.t_s, 1.0)[1].translation.vector).norm()
    });
    off_m.sum::<f64>() / frames.len() as f64
}

#[test]
fn constants_come_back_with_cameras() {
    let (_, calibration, model) = reference();
    let mut truth = drawn(&calibration, 11);
    // What is off on the end pad as a whole cannot be separated from where the markers are.
    truth[MARKERS..].fill(0.0);
    let frames = made(&model, 240.0, 1.0, true, &|_| truth);
    let result = adjust_frames(&model, &calibration, &frames).expect("adjusts");
    for g in &result.groups {
        println!("{g:?}");
    }
    assert!(result.keeps_ends() && result.with_cameras);
    assert!((0.8..1.2).contains(&result.misfit), "{}", result.misfit);
    // Each is where its sigma has it.
    let prior = priors(&calibration);
    let problem = Problem::new(&model, &frames, &prior);
    let all: Vec<usize> = (0..frames.len()).collect();
    let fit = problem
        .fit(&all, &free_of(&Group::ALL, true), true)
        .expect("fits");
    let mut squares = 0.0;
    for k in 0..CONSTANTS {
        let z = (fit.state.constants[k] - truth[k]) / fit.sigma(k).expect("free");
        assert!(z.abs() < 4.5, "constant {k}: {z} sigma");
        squares += z * z / CONSTANTS as f64;
    }
    assert!(squares < 1.6, "{squares}");
    // Mountings and gyro biases are determined well.
    for p in &result.parameters {
        let clear = p.name.contains("mounting") || p.name.contains("gyro");
        assert!(!clear || p.observable, "{p:?}");
    }
    let none = [0.0; CONSTANTS];
    let before_m = tip_error_m(&model, &truth, &none, &calibration);
    let after_m = tip_error_m(&model, &truth, &fit.state.constants, &calibration);
    println!("{before_m} {after_m}");
    assert!(after_m < 0.4 * before_m, "{before_m} {after_m}");
}

#[test]
fn what_the_motion_does_not_determine_is_reported() {
    let (_, calibration, model) = reference();
    let truth = drawn(&calibration, 11);
    let without = made(&model, 120.0, 1.0, false, &|_| truth);
    let result = adjust_frames(&model, &calibration, &without).expect("adjusts");
    let by_cameras = result
        .parameters
        .iter()
        .filter(|p| !p.observable && p.closed_by == Some("motion capture of the end pad"));
    assert!(by_cameras.count() >= 6, "{:?}", result.parameters);
    assert!(!result.parameters.iter().any(|p| p.name.contains("markers")));
    // A motion in which the pads hardly turn leaves the mountings about the vertical open.
    let upright = made(&model, 120.0, 0.02, true, &|_| truth);
    let result = adjust_frames(&model, &calibration, &upright).expect("adjusts");
    let z = |p: &&Parameter| p.name == "IMU 1, mounting, z";
    let found = result.parameters.iter().find(z).expect("is listed");
    assert!(!found.observable, "{found:?}");
    assert!(
        found.closed_by.is_some_and(|by| by.contains("tilted")),
        "{found:?}"
    );
}

#[test]
fn a_held_out_block_that_gets_worse_rejects_the_group() {
    let (_, calibration, model) = reference();
    let mut truth = drawn(&calibration, 11);
    truth[MARKERS..].fill(0.0);
    let none = [0.0; CONSTANTS];
    // In the blocks that are held out the springs hang as in the calibration.
    let frames = made(
        &model,
        120.0,
        1.0,
        true,
        &|t_s| match (t_s / BLOCK_S) as usize % 3 {
            1 => none,
            _ => truth,
        },
    );
    let result = adjust_frames(&model, &calibration, &frames).expect("adjusts");
    assert!(!result.keeps_ends(), "{:?}", result.groups);
    assert_eq!(result.calibration.springs, calibration.springs);
    // One block alone does, too.
    let good = hold_out::judge(Group::Ends, &[4.0, 4.0, 4.0], &[1.0, 1.0, 1.0]);
    assert!(good.kept && (good.worst_block + 0.5).abs() < 1e-12);
    assert!(!hold_out::judge(Group::Ends, &[4.0, 4.0, 4.0], &[1.0, 1.0, 6.0]).kept);
    assert!(!hold_out::judge(Group::Ends, &[4.0, 4.0, 4.0], &[4.0, 4.0, 3.97]).kept);
}

#[test]
fn too_little_motion_is_refused_with_what_is_needed() {
    let (spec, calibration, _) = reference();
    let e = adjust(&spec, &calibration, &[Take::default()]).expect_err("nothing");
    assert!(e.to_string().contains("slow motion to all sides"), "{e}");
}

#[test]
fn a_line_has_the_value_between_its_points() {
    let points: Vec<(f64, f64)> = (0..20)
        .map(|k| (f64::from(k), 3.0 + 0.5 * f64::from(k)))
        .collect();
    let [value, slope, sd] = line(&points, 4.25).expect("is one");
    assert!((value - 5.125).abs() < 1e-12 && (slope - 0.5).abs() < 1e-12 && sd < 1e-9);
    assert_eq!(line(&points[..5], 1.0), None);
}

#[test]
fn lengths_for_networks_are_those_of_the_drawing() {
    use crate::sensing::filter::Filter;
    use crate::sensing::platform::Segment;
    let (spec, mut calibration, _) = reference();
    let drawn = Filter::new(&spec, &calibration);
    assert!((0..SPRINGS).all(|i| drawn.drawing_offset_m(i) == 0.0));
    for s in &mut calibration.springs {
        let by = s.spring as f64 * 1e-4;
        s.ends_off_m = [Vector3::new(by, 0.0, -2.0 * by), Vector3::new(0.0, by, by)];
    }
    let filter = Filter::new(&spec, &calibration);
    for k in 0..2 {
        // The estimator starts at rest.
        let rest = Segment::of(&spec, k).rest();
        let as_drawn = Segment::of(&spec, k).lengths_m(&rest);
        let as_found = Segment::calibrated(&spec, &calibration, k).lengths_m(&rest);
        for (leg, (drawn_m, found_m)) in as_drawn.iter().zip(as_found).enumerate() {
            let off_m = filter.drawing_offset_m(6 * k + leg);
            assert!(
                (off_m - (drawn_m - found_m)).abs() < 1e-12,
                "{k} {leg}: {off_m}"
            );
            assert!(off_m.abs() > 1e-5);
        }
    }
}

#[test]
fn kept_groups_are_in_the_calibration_with_their_sigma() {
    let (_, calibration, model) = reference();
    let mut truth = drawn(&calibration, 11);
    truth[MARKERS..].fill(0.0);
    let frames = made(&model, 240.0, 1.0, true, &|_| truth);
    let found = adjust_frames(&model, &calibration, &frames).expect("adjusts");
    assert!(found.keeps_ends());
    for (a, b) in found.calibration.springs.iter().zip(&calibration.springs) {
        assert!(a.ends_off_m != b.ends_off_m);
        assert!(
            a.ends_sd_m.is_some_and(|sd| (1e-5..0.7e-3).contains(&sd)),
            "{a:?}"
        );
    }
    let again =
        Calibration::from_toml(&found.calibration.to_toml().expect("writes")).expect("reads");
    assert!(again.springs[4].ends_sd_m.is_some());
    let lengths = found
        .parameters
        .iter()
        .filter(|p| p.name.contains("length at rest"));
    assert_eq!(lengths.count(), SPRINGS);
}

#[test]
fn an_imu_that_needs_no_correction_counts_as_calibrated_and_a_silent_one_does_not() {
    let (spec, mut calibration, _) = reference();
    calibration.imus.clear();
    let model = Model::new(&spec, &calibration);
    // Zeroed by their maker: nothing is off but the springs' ends and the rates at rest.
    let mut truth = drawn(&calibration, 12);
    truth[GAINS..GYROS].fill(0.0);
    truth[ACCEL_GAINS..].fill(0.0);
    let mut frames = made(&model, 240.0, 1.0, true, &|_| truth);
    for frame in &mut frames {
        frame.force[2] = None;
    }
    let found = adjust_frames(&model, &calibration, &frames).expect("adjusts");
    let kept = |group: Group| found.groups.iter().any(|g| g.group == group && g.kept);
    assert!(!kept(Group::Mountings) && !kept(Group::Biases));
    let has = |n: usize| found.calibration.imus.iter().any(|m| m.imu == n);
    assert_eq!([1, 2, 3, 4].map(has), [true, true, false, true]);
    for imu in &found.calibration.imus {
        assert_eq!(imu.fit.correction_rad, Vector3::zeros());
        assert_eq!(imu.zero.accel_bias_m_s2, Vector3::zeros());
        let at = GYROS + 3 * (imu.imu - 1);
        let rate_off = imu.zero.gyro_bias_rad_s - Vector3::from_column_slice(&truth[at..at + 3]);
        assert!(rate_off.norm() < 0.01 * DEG, "{rate_off}");
    }
    // One that is off is not taken as it is.
    let mut far = truth;
    far[ACCELS] = 0.25;
    let frames = made(&model, 240.0, 1.0, true, &|_| far);
    let found = adjust_frames(&model, &calibration, &frames).expect("adjusts");
    let first = found.calibration.imus.iter().find(|m| m.imu == 1);
    assert!(first.is_none_or(|m| m.zero.accel_bias_m_s2.x.abs() > 0.1));
}
