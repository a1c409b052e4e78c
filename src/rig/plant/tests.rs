use super::*;
use crate::rig::hidden::{HIDDEN, Hidden};

fn plant(payload_kg: f64) -> Plant {
    let surroundings = Surroundings {
        payload_kg,
        ..Surroundings::default()
    };
    Plant::new(&RobotSpec::reference(), Unit::default(), surroundings).expect("settles")
}

fn tip_m(p: &Plant) -> Vector3<f64> {
    p.truth().base_from_tip().translation.vector
}

#[test]
fn a_full_stroke_takes_as_long_as_the_pumps_need() {
    let mut p = plant(0.0);
    let reach = |p: &mut Plant, set_pa: f64| {
        let mut t_s = 0.0;
        while p.gauge_pa().iter().any(|g| (g - set_pa).abs() > 400.0) && t_s < 100.0 {
            p.step(&[Some(set_pa); CHAMBERS], 0.01).expect("steps");
            t_s += 0.01;
        }
        t_s
    };
    reach(&mut p, -40e3);
    let t_s = reach(&mut p, 40e3);
    // 70 to 220 mm at 53.5 cm² and 0.6 to 1.4 atmospheres through 1.8 l/min.
    assert!((25.0..60.0).contains(&t_s), "full stroke took {t_s:.1} s");
    // Pumps off: the air stays.
    let before = p.chamber_pa();
    for _ in 0..100 {
        p.step(&[None; CHAMBERS], 0.01).expect("steps");
    }
    for (a, b) in before.iter().zip(p.chamber_pa()) {
        assert!((a - b).abs() < 300.0, "{a} {b}");
    }
}

#[test]
fn hysteresis_makes_up_and_down_differ_and_the_payload_hangs_lower() {
    let mut p = plant(0.0);
    let mut height_at_rest_m = |from_pa: f64| {
        p.settle_at(&[from_pa; CHAMBERS]).expect("settles");
        p.settle_at(&[0.0; CHAMBERS]).expect("settles");
        tip_m(&p).z
    };
    let gap_mm = (height_at_rest_m(-20e3) - height_at_rest_m(20e3)) * 1e3;
    assert!((0.5..12.0).contains(&gap_mm.abs()), "gap {gap_mm:.2} mm");
    let (loaded, unloaded) = (tip_m(&plant(0.5)).z, tip_m(&plant(0.0)).z);
    assert!(loaded < unloaded - 5e-4, "{loaded} {unloaded}");
}

#[test]
fn the_same_unit_is_the_same_arm_and_another_is_not() {
    let at = |unit: u64| {
        let robot = RobotSpec::reference();
        let mut p = Plant::new(&robot, Unit(unit), Surroundings::default()).expect("settles");
        p.settle_at(&[30e3, -10e3, 5e3, -20e3, 10e3, 0.0])
            .expect("settles");
        (tip_m(&p), p.truth().spring_m)
    };
    assert_eq!(at(1), at(1));
    let (one, two) = (at(1), at(2));
    assert!((one.0 - two.0).norm() > 2e-4);
    // Springs hang between other points, too.
    let off_m = one.1.iter().zip(two.1).map(|(a, b)| (a - b).abs());
    assert!(off_m.fold(0.0, f64::max) > 3e-4);
}

#[test]
fn a_blow_excites_the_arm_which_rings_and_comes_to_rest() {
    let mut p = plant(0.0);
    let rest_m = tip_m(&p);
    let mut swing_m = Vec::new();
    for k in 0..600 {
        p.surroundings.tip_force_n = if k < 10 { [30.0, 0.0, 0.0] } else { [0.0; 3] };
        p.step(&[Some(0.0); CHAMBERS], 0.01).expect("steps");
        swing_m.push((tip_m(&p) - rest_m).x);
    }
    let crossings = swing_m[10..110].windows(2).filter(|w| w[0] * w[1] < 0.0);
    let crossings = crossings.count();
    assert!(crossings >= 3, "{crossings} crossings in a second");
    let most = |part: &[f64]| part.iter().fold(0.0_f64, |m, x| m.max(x.abs()));
    assert!(most(&swing_m[..100]) > 0.01, "{}", most(&swing_m[..100]));
    assert!(most(&swing_m[500..]) < 0.1 * most(&swing_m[..100]));
}

/// Force on the pads' IMUs at rest is gravity, tilted when the mount is.
#[test]
fn a_tilted_mount_leans_gravity_for_arm_and_imus() {
    let mut p = plant(0.0);
    let upright_m = tip_m(&p);
    let hidden: Hidden = "base-tilt=0.1,0".parse().expect("fits");
    p.hide(Defects::at(0.0, &[hidden]));
    for _ in 0..600 {
        p.step(&[Some(0.0); CHAMBERS], 0.01).expect("steps");
    }
    let up = p.pads()[1].up_in_pad;
    assert!(
        (up.norm() - 1.0).abs() < 1e-12 && up.xy().norm() > 0.05,
        "{up}"
    );
    assert!((tip_m(&p) - upright_m).xy().norm() > 2e-3);
}

/// Everything that is hidden in plant, air or pumps moves the arm or its air; nothing makes a step fail.
#[test]
fn every_hidden_effect_can_be_lived_with() {
    let set_pa = |k: usize| -> [Option<f64>; CHAMBERS] {
        std::array::from_fn(|i| Some(12e3 * (0.004 * k as f64 + i as f64).sin()))
    };
    for kind in HIDDEN {
        let hidden = Hidden::new(kind.id, None, &[]).expect("kind").from(1.0);
        let mut p = plant(0.1);
        for k in 0..800 {
            if k == 100 {
                p.hide(Defects::at(1.0, std::slice::from_ref(&hidden)));
            }
            assert!(p.step(&set_pa(k), 0.01).is_ok(), "{} at step {k}", kind.id);
        }
        assert!(tip_m(&p).norm() < 0.6, "{}", kind.id);
    }
}
