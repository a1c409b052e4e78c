use nalgebra::{UnitQuaternion, Vector3};
use proptest::prelude::*;

use super::fake::{NOISE, Way, frames, generator, moving_tip, noisy, object, streams};
use super::track::Track;
use super::*;

const STATED: FitOptions = FitOptions {
    robot: NOISE,
    mocap: NOISE,
    object: ObjectFrame::Unknown,
};

fn wandering(seed: u64) -> Way {
    Way::Wandering { seed, speed: 1.0 }
}

#[test]
fn motion_on_a_track_by_finite_differences_and_never_across_a_gap() {
    let way = wandering(3);
    // Every 4 ms, with 0.3 s missing from t = 2.
    let samples = (0..2000).map(|k| 0.004 * f64::from(k)).map(|t| {
        let seen = !(2.0..2.3).contains(&t);
        (t, seen.then(|| moving_tip(way, t)))
    });
    let track = Track::new(samples, "robot", 0.1).expect("runs on");
    for t in [0.5, 1.111, 3.7, 6.2505] {
        let m = track.at(t, 0.1).expect("there");
        let h = 1e-4;
        let [a, b] = [t - h, t + h].map(|t| moving_tip(way, t));
        let v = (b.translation.vector - a.translation.vector) / (2.0 * h);
        let w = (b.rotation * a.rotation.inverse()).scaled_axis() / (2.0 * h);
        assert!((m.velocity_m_s - v).norm() < 0.01 * v.norm(), "{t}");
        assert!((m.rate_rad_s - w).norm() < 0.01 * w.norm(), "{t}");
        // The track's own slope, which the fit of the delay uses.
        let [a, b] = [t - h, t + h].map(|t| track.at(t, 0.1).expect("there").pose);
        let v = (b.translation.vector - a.translation.vector) / (2.0 * h);
        let w = (b.rotation * a.rotation.inverse()).scaled_axis() / (2.0 * h);
        assert!(
            (m.velocity_m_s - v).norm() < 0.01 * v.norm(),
            "{t} {v} {}",
            m.velocity_m_s
        );
        assert!((m.rate_rad_s - w).norm() < 0.01 * w.norm(), "{t}");
        let e = crate::signal::pose_error(&m.pose, &moving_tip(way, t));
        assert!(e.amax() < 2e-3, "{t} {e}");
    }
    for t in [1.91, 2.0, 2.15, 2.29, 2.39, 0.09, -0.001, 7.95, 7.9961] {
        assert!(track.at(t, 0.1).is_none(), "{t}");
    }
    assert!(track.at(1.89, 0.1).is_some() && track.at(2.41, 0.1).is_some());
    // A line is exact where the motion is one; of a slow stream it goes through two points.
    let line = (0..60).map(|k| {
        let t = if k < 40 { 0.01 } else { 0.09 } * f64::from(k);
        let turn = UnitQuaternion::from_scaled_axis(Vector3::new(0.1, 0.2, -0.3) * t);
        (
            t,
            Some(Pose::from_parts(Vector3::new(t, -t, 2.0 * t).into(), turn)),
        )
    });
    let track = Track::new(line, "robot", 0.1).expect("runs on");
    for t in [0.11, 0.185, 4.0, 4.234, 5.0] {
        let m = track.at(t, 0.1).expect("there");
        assert!((m.pose.translation.vector - Vector3::new(t, -t, 2.0 * t)).norm() < 1e-12);
        assert!((m.rate_rad_s - Vector3::new(0.1, 0.2, -0.3)).norm() < 1e-9);
        assert!((m.pose.rotation.scaled_axis() - Vector3::new(0.1, 0.2, -0.3) * t).norm() < 1e-9);
    }
}

#[test]
fn offset_comes_back_within_a_millisecond() {
    let (mut squares, seeds) = (0.0, 16);
    let mut worst: f64 = 0.0;
    for seed in 0..seeds {
        let truth = frames(seed);
        let offset_s = if seed % 2 == 0 { 0.8 } else { -0.8 };
        let (robot, mocap) = streams(seed, &truth, wandering(seed), 60.0, offset_s);
        let got =
            clock_offset(&robot, &mocap, None, &STATED, &ClockOptions::default()).expect("found");
        let off_s = got.offset_s - offset_s;
        worst = worst.max(off_s.abs());
        squares += (off_s / got.sigma_s).powi(2);
        println!("{seed}: off {:.3} ms, {got:?}", off_s * 1e3);
        assert!(off_s.abs() < 1e-3, "{seed}: {off_s}");
        assert!(
            got.sigma_s < 5e-4 && off_s.abs() < 5.0 * got.sigma_s,
            "{got:?}"
        );
        assert!(got.correlation > 0.9 && got.runner_up < 0.8 * got.correlation);
        let held = clock_offset(
            &robot,
            &mocap,
            Some(&truth),
            &STATED,
            &ClockOptions::default(),
        );
        assert!(
            (held.expect("found").offset_s - offset_s).abs() < 1e-3,
            "{seed}"
        );
    }
    println!(
        "worst {worst}, normalised error squared {}",
        squares / seeds as f64
    );
    // Sixteen squares of Student's t with nine degrees of freedom: their mean is 9/7.
    assert!((0.3..3.0).contains(&(squares / seeds as f64)), "{squares}");
}

#[test]
fn at_the_speed_of_the_arm_sigma_tells_what_the_offset_is_worth() {
    let truth = frames(2);
    let way = Way::Wandering {
        seed: 2,
        speed: 0.2,
    };
    let (robot, mocap) = streams(2, &truth, way, 120.0, 0.8);
    let got = clock_offset(&robot, &mocap, None, &STATED, &ClockOptions::default()).expect("found");
    println!("slow: {got:?}");
    assert!((got.offset_s - 0.8).abs() < 5.0 * got.sigma_s, "{got:?}");
    assert!((got.offset_s - 0.8).abs() < 2e-3, "{got:?}");
}

#[test]
fn offsets_that_cannot_be_told_are_refused_with_a_reason() {
    let truth = frames(1);
    let run = |way, seconds, clock: &ClockOptions| {
        let (robot, mocap) = streams(1, &truth, way, seconds, 0.8);
        clock_offset(&robot, &mocap, None, &STATED, clock)
    };
    let usual = ClockOptions::default();
    let e = run(Way::Still, 60.0, &usual).expect_err("still");
    assert!(
        matches!(e, RegistrationError::NoPeak { correlation } if correlation < 0.5),
        "{e}"
    );
    assert!(e.to_string().contains("changing directions"), "{e}");
    let e = run(Way::Periodic, 60.0, &usual).expect_err("periodic");
    assert!(matches!(e, RegistrationError::Ambiguous { .. }), "{e}");
    assert!(e.to_string().contains("repeats itself"), "{e}");
    let near = ClockOptions {
        search_s: 0.4,
        ..usual
    };
    let e = run(wandering(1), 60.0, &near).expect_err("out of the window");
    assert!(
        matches!(
            e,
            RegistrationError::AtEdge { .. } | RegistrationError::NoPeak { .. }
        ),
        "{e}"
    );
    let about = ClockOptions {
        about_s: 0.7,
        ..near
    };
    assert!((run(wandering(1), 60.0, &about).expect("found").offset_s - 0.8).abs() < 1e-3);
    let e = run(wandering(1), 3.0, &usual).expect_err("short");
    assert!(matches!(e, RegistrationError::NoOverlap { .. }), "{e}");
    // Two motions that have nothing to do with each other.
    let (robot, _) = streams(1, &truth, wandering(1), 60.0, 0.8);
    let (_, mocap) = streams(1, &truth, wandering(9), 60.0, 0.8);
    let e = clock_offset(&robot, &mocap, None, &STATED, &usual).expect_err("two motions");
    println!("{e}");
    let (mut robot, mocap) = streams(1, &truth, wandering(1), 60.0, 0.8);
    robot[7].0 = 0.0;
    let e = clock_offset(&robot, &mocap, None, &STATED, &usual).expect_err("backwards");
    assert_eq!(
        e,
        RegistrationError::Times {
            stream: "robot",
            index: 7
        }
    );
}

#[test]
fn streams_give_frames_and_offset_and_glitches_do_no_harm() {
    for seed in 0..3 {
        let truth = frames(20 + seed);
        let (robot, mut mocap) = streams(seed, &truth, wandering(seed), 60.0, 0.8);
        // Markers swapped for 50 ms, three times.
        for at in [2000, 5000, 9000] {
            for sample in &mut mocap[at..at + 10] {
                if let Some(pose) = &mut sample.1 {
                    pose.rotation *= UnitQuaternion::from_scaled_axis(Vector3::z() * 1.0);
                }
            }
        }
        let options = StreamOptions {
            fit: STATED,
            clock: ClockOptions::default(),
        };
        let got = register_streams(&robot, &mocap, &options).expect("fits");
        let (x, y) = (
            &got.fit.frames.base_from_world,
            &got.fit.frames.object_from_tip,
        );
        let centre = nalgebra::Point3::from(got.fit.centre_in_world_m);
        let off = x * centre - truth.base_from_world * centre;
        let lever = y.translation.vector - truth.object_from_tip.translation.vector;
        println!(
            "{seed}: offset {:.3} ms, X {:.3} mm, t_Y {:.3} mm, {:?}",
            (got.clock.offset_s - 0.8) * 1e3,
            off.norm() * 1e3,
            lever.norm() * 1e3,
            got.fit.summary
        );
        assert!((got.clock.offset_s - 0.8).abs() < 1e-3, "{:?}", got.clock);
        assert!(off.norm() < 1e-4 && lever.norm() < 2e-4, "{off} {lever}");
        assert!(x.rotation.angle_to(&truth.base_from_world.rotation) < 1e-3);
        assert!(y.rotation.angle_to(&truth.object_from_tip.rotation) < 1e-3);
        assert!(got.pairs.len() >= 20 && got.pairs.len() == got.t_s.len());
        assert!(got.t_s.windows(2).all(|w| w[1] > w[0]));
        assert!(*got.blocks.last().expect("some") >= 4);
        assert!(
            got.fit.summary.position_rms_m < 2e-4,
            "{:?}",
            got.fit.summary
        );
        let known = StreamOptions {
            fit: FitOptions {
                object: ObjectFrame::Known(truth.object_from_tip),
                ..STATED
            },
            ..options
        };
        let held = register_streams(&robot, &mocap, &known).expect("fits");
        assert_eq!(held.fit.frames.object_from_tip, truth.object_from_tip);
        assert!((held.clock.offset_s - 0.8).abs() < 1e-3, "{:?}", held.clock);
        let x = held.fit.frames.base_from_world;
        assert!((x * centre - truth.base_from_world * centre).norm() < 1e-4);
        assert!(
            got.clock.glitches > 0 && got.clock.glitches < 20,
            "{:?}",
            got.clock
        );
    }
}

#[test]
fn a_robot_that_stops_and_goes_to_a_beat_is_registered_and_one_at_rest_is_not() {
    let truth = frames(8);
    let record = || {
        let mut g = generator(77);
        // Three seconds at each stop, one on the way to the next.
        let place = |t_s: f64| {
            let (k, rest) = ((t_s / 4.0) as usize, t_s % 4.0);
            let ease = |x: f64| x * x * (3.0 - 2.0 * x);
            let at = |k: usize| moving_tip(wandering(5), 11.0 * k as f64);
            let (a, b, x) = (at(k), at(k + 1), ease((rest - 3.0).max(0.0)));
            let way = b.translation.vector - a.translation.vector;
            Pose::from_parts(
                (a.translation.vector + way * x).into(),
                a.rotation.slerp(&b.rotation, x),
            )
        };
        let robot: Vec<_> = (0..8000)
            .map(|k| 0.01 * f64::from(k))
            .map(|t| (t, noisy(&mut g, &place(t), &NOISE)))
            .collect();
        let mocap: Vec<_> = (0..16_000)
            .map(|k| 0.005 * f64::from(k))
            .map(|t| {
                (
                    t,
                    Some(noisy(&mut g, &object(&truth, &place(t + 0.8)), &NOISE)),
                )
            })
            .collect();
        register_streams(&robot, &mocap, &StreamOptions::default())
    };
    let got = record().expect("fits");
    println!("{:?} {:?}", got.clock, got.fit.summary);
    assert!((got.clock.offset_s - 0.8).abs() < 1e-3);
    let still = moving_tip(Way::Still, 0.0);
    let mut g = generator(3);
    let robot: Vec<_> = (0..6000)
        .map(|k| (0.01 * f64::from(k), noisy(&mut g, &still, &NOISE)))
        .collect();
    let mocap: Vec<_> = robot
        .iter()
        .map(|(t, p)| (*t, Some(object(&truth, p))))
        .collect();
    assert!(register_streams(&robot, &mocap, &StreamOptions::default()).is_err());
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]
    #[test]
    fn nothing_panics(
        seed in 0u64..1000,
        rates in (1.0..120.0f64, 1.0..250.0f64),
        seconds in 0.0..30.0f64,
        spoil in prop::collection::vec((0usize..4000, 0u8..6), 0..6),
        search_s in prop_oneof![Just(f64::NAN), Just(0.0), 0.1..20.0f64],
    ) {
        let truth = frames(seed);
        let way = wandering(seed);
        let times = |hz: f64| (0..(hz * seconds) as usize).map(move |k| k as f64 / hz);
        let mut robot: Vec<_> = times(rates.0).map(|t| (t, moving_tip(way, t))).collect();
        let mut mocap: Vec<_> =
            times(rates.1).map(|t| (t, Some(object(&truth, &moving_tip(way, t + 0.3))))).collect();
        for (at, how) in spoil {
            if robot.is_empty() || mocap.is_empty() {
                break;
            }
            let (r, m) = (at % robot.len(), at % mocap.len());
            match how {
                0 => robot[r].0 = f64::NAN,
                1 => robot[r].1.translation.vector.x = f64::NAN,
                2 => mocap[m].1 = None,
                3 => mocap[m].0 += 1e6,
                4 => robot[r].1.translation.vector.x = 900.0,
                _ => mocap.iter_mut().for_each(|s| s.1 = None),
            }
        }
        let options = StreamOptions {
            clock: ClockOptions { search_s, ..ClockOptions::default() },
            ..StreamOptions::default()
        };
        if let Ok(got) = register_streams(&robot, &mocap, &options) {
            prop_assert!(got.clock.offset_s.is_finite());
        }
    }
}
