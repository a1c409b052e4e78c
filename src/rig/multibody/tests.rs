use nalgebra::{Matrix3, UnitQuaternion, Vector3};
use rand::Rng as _;

use super::air::{Chambers, Flow};
use super::arm::{Character, RINGS, make};
use super::chain::{Air, Arm, Chain, Held, Outside};
use super::gap::{Strain, Wrench};
use super::member::Axial;
use super::settled_pads;
use crate::robot::RobotSpec;
use crate::signal::{CHAMBERS, Pose, stream};

/// Elastic, and damped enough to settle within seconds.
fn settling(rings: usize) -> Character {
    Character {
        rings,
        damping_s: 0.05,
        ..Character::elastic()
    }
}

fn wait(arm: &Arm, chain: &mut Chain, air: &dyn Air, seconds: f64) {
    const STEP_S: f64 = 5e-3;
    for _ in 0..(seconds / STEP_S) as usize {
        chain
            .step(arm, air, &Outside::default(), STEP_S)
            .expect("converges");
    }
}

fn settled(arm: &Arm, gauge_pa: [f64; CHAMBERS]) -> Chain {
    let mut chain = Chain::straight(arm);
    wait(arm, &mut chain, &Held(gauge_pa), 8.0);
    assert!(chain.speed_m_s() < 1e-5, "{}", chain.speed_m_s());
    chain
}

#[test]
fn wrenches_are_the_gradient_and_the_matrix_is_near_the_hessian() {
    let mut robot = RobotSpec::reference();
    robot.segments[0].axial_n_m = 800.0;
    let arm = make(&robot, 1, 0.0, &Character::default());
    let (elastic, member) = (&arm.gaps[0].elastic, &arm.gaps[0].members[0]);
    assert!(elastic.core_n_m > 800.0);
    let gauge_pa = [20e3, -30e3, 40e3];
    let turn = |s: f64| UnitQuaternion::from_scaled_axis(Vector3::new(0.3, -0.2, 0.25) * s);
    let ends = [
        Pose::from_parts(Vector3::new(0.01, 0.02, 0.3).into(), turn(2.0)),
        Pose::from_parts(Vector3::new(0.012, 0.023, 0.282).into(), turn(2.3)),
    ];
    let energy_j = |e: &[Pose; 2]| {
        let s = Strain::between(&e[0], &e[1], elastic);
        let bellows: f64 = (0..3)
            .map(|k| {
                let (l, d) = (s.length_m[k], s.chord_m[k]);
                member.energy_j(l) - gauge_pa[k] * member.volume_m3(l)
                    + 0.5 * elastic.lateral_n_m[k] * (d.x * d.x + d.y * d.y)
            })
            .sum();
        let shear = 0.5 * elastic.tube_shear_n_m * (s.u_m.x.powi(2) + s.u_m.y.powi(2));
        let core = 0.5 * elastic.core_n_m * (s.u_m.z + elastic.core_rest_m).powi(2);
        bellows + shear + core + 0.5 * s.psi.dot(&elastic.tube_nm_rad.component_mul(&s.psi))
    };
    let forces = |e: &[Pose; 2]| {
        let s = Strain::between(&e[0], &e[1], elastic);
        let axial: [Axial; 3] = std::array::from_fn(|k| member.elastic(s.length_m[k], gauge_pa[k]));
        let (f, m) = s.gradient(elastic, &axial);
        (s.wrenches(&f, &m), s.hessian(elastic, &axial))
    };
    const H: f64 = 1e-6;
    let moved = |body: usize, j: usize, by: f64| {
        let mut e = ends;
        if j < 3 {
            e[body].translation.vector[j] += by;
        } else {
            let mut w = Vector3::zeros();
            w[j - 3] = by;
            e[body].rotation = UnitQuaternion::from_scaled_axis(w) * e[body].rotation;
        }
        e
    };
    let (wrenches, hessian) = forces(&ends);
    for body in 0..2 {
        for j in 0..6 {
            let (plus, minus) = (moved(body, j, H), moved(body, j, -H));
            let slope = (energy_j(&plus) - energy_j(&minus)) / (2.0 * H);
            let got = -wrenches[body][j];
            assert!((slope - got).abs() < 1e-4, "{body} {j}: {slope} {got}");
            let (plus, minus) = (forces(&plus).0, forces(&minus).0);
            for other in 0..2 {
                for row in 0..6 {
                    let exact = (minus[other][row] - plus[other][row]) / (2.0 * H);
                    let got = hessian[other][body][(row, j)];
                    // Forces by metres, torques by radians: about 1e6 N/m and 1e3 N m/rad.
                    let scale = [[3e5, 2e4], [2e4, 2e3]][row / 3][j / 3];
                    assert!(
                        (exact - got).abs() < 0.05 * scale,
                        "{other} {row}, {body} {j}: {exact} {got}"
                    );
                }
            }
        }
    }
}

#[test]
fn the_base_carries_the_weight_and_poses_are_near_an_independent_multibody_model() {
    let robot = RobotSpec::reference();
    let arm = make(&robot, 1, 0.0, &settling(RINGS));
    let weight_n = 9.806_65 * arm.bodies.iter().map(|b| b.mass_kg).sum::<f64>();
    // Tip (mm) of a model of stacked rigid discs with the same drawing, settled.
    let cases: [([f64; CHAMBERS], [f64; 3], f64); 5] = [
        ([0.0; 6], [0.0, 0.0, -296.6], 1.0),
        ([40.0; 6], [0.0, 0.0, -441.2], 1.0),
        ([-40.0; 6], [0.0, 0.0, -151.5], 1.0),
        (
            [40.0, -40.0, -40.0, 0.0, 0.0, 0.0],
            [-143.4, 0.0, -219.9],
            10.0,
        ),
        (
            [20.0, -20.0, -20.0, 20.0, -20.0, -20.0],
            [-82.4, -17.7, -253.3],
            10.0,
        ),
    ];
    for (kpa, tip_mm, within_mm) in cases {
        let gauge_pa = kpa.map(|p| p * 1e3);
        let chain = settled(&arm, gauge_pa);
        let tip = chain.pads(&arm)[1].translation.vector * 1e3;
        assert!(
            (tip - Vector3::from(tip_mm)).norm() < within_mm,
            "{kpa:?}: {tip}"
        );
        let base = chain.on_base(&arm, &Held(gauge_pa));
        assert!(
            (base[2] + weight_n).abs() < 1e-3 * weight_n,
            "{base} {weight_n}"
        );
        assert!(base[0].hypot(base[1]) < 1e-3 * weight_n, "{base}");
    }
}

/// 200 poses over the whole range of pressures and payloads.
#[test]
fn twice_the_rings_move_the_tip_by_less_than_half_a_millimetre() {
    use rayon::prelude::*;
    const POSES: u64 = 200;
    let robot = RobotSpec::reference();
    let apart_mm = |i: u64| {
        let mut rng = stream(1, i);
        let (lo, hi) = (robot.pressure.min_pa, robot.pressure.max_pa);
        let gauge_pa: [f64; CHAMBERS] = std::array::from_fn(|_| rng.random_range(lo..=hi));
        let payload_kg = robot.payload_max_kg * i as f64 / POSES as f64;
        let tip = |rings: usize| {
            let character = Character {
                rings,
                ..Character::elastic()
            };
            let arm = make(&robot, 1, payload_kg, &character);
            let chain = Chain::settled(&arm, gauge_pa, &Outside::default()).expect("settles");
            chain.pads(&arm)[1].translation.vector
        };
        (tip(RINGS) - tip(2 * RINGS)).norm() * 1e3
    };
    let mut mm: Vec<f64> = (0..POSES).into_par_iter().map(apart_mm).collect();
    mm.sort_by(f64::total_cmp);
    let (median, most) = (mm[mm.len() / 2], mm[mm.len() - 1]);
    println!("tip apart by {median:.3} mm median, {most:.3} mm at most");
    assert!(most < 0.5, "{most} mm at most, {median} mm median");
}

#[test]
fn without_damping_energy_is_kept_for_ten_seconds() {
    let robot = RobotSpec::reference();
    let make = |damping_s: f64| {
        let character = Character {
            damping_s,
            hardening: 0.15,
            area_slope: -0.1,
            ..Character::elastic()
        };
        make(&robot, 1, 0.0, &character)
    };
    let (free, damped) = (make(0.0), make(0.05));
    let gauge_pa = [10e3, -10e3, 0.0, 0.0, 5e3, 0.0];
    let rest_j = settled(&damped, gauge_pa).energy_j(&free, &gauge_pa);
    let mut aside = damped.clone();
    aside.gravity_m_s2 = Vector3::new(3.0, 1.0, -9.3);
    let mut chain = settled(&aside, gauge_pa);
    let start_j = chain.energy_j(&free, &gauge_pa);
    assert!(start_j - rest_j > 0.01, "{start_j} {rest_j}");
    for _ in 0..10_000 {
        chain
            .step(&free, &Held(gauge_pa), &Outside::default(), 1e-3)
            .expect("converges");
    }
    let drift = (chain.energy_j(&free, &gauge_pa) - start_j) / (start_j - rest_j);
    assert!(drift.abs() < 1e-3, "{drift:e}");
}

/// ω = 3.516 √(EI / (m L³)), the first mode of a uniform cantilever (L. Euler, D. Bernoulli).
#[test]
fn a_bare_segment_rings_at_the_cantilevers_frequency() {
    let robot = RobotSpec::reference();
    const RINGS: usize = 24;
    let bare = |damping_s: f64| {
        let character = Character {
            rings: RINGS,
            damping_s,
            tube_shear_n: 1e6,
            ..Character::elastic()
        };
        let mut arm = make(&robot, 1, 0.0, &character);
        let n = RINGS + 1;
        arm.bodies.truncate(n);
        arm.gaps.truncate(n);
        arm.springs.clear();
        arm.gravity_m_s2 = Vector3::zeros();
        let ring_kg = 3.0 * robot.bellows_kg / n as f64;
        for (i, body) in arm.bodies.iter_mut().enumerate() {
            body.mass_kg = if i + 1 == n { 0.5 * ring_kg } else { ring_kg };
            body.inertia_kg_m2 = Matrix3::identity() * 1e-9;
            (body.upper_m, body.lower_m) = (Vector3::zeros(), Vector3::zeros());
        }
        arm
    };
    let radius_m = robot.bellows_m[0].norm();
    let per_segment =
        1.5 * robot.axial_stiffness_n_m[0] * radius_m * radius_m + robot.segments[0].bending_nm_rad;
    let (mass_kg, length_m) = (3.0 * robot.bellows_kg, robot.rest_length_m);
    let omega = 3.516 * (per_segment * length_m / (mass_kg * length_m.powi(3))).sqrt();
    let expected_hz = omega / std::f64::consts::TAU;
    let (free, damped) = (bare(0.0), bare(0.02));
    let mut chain = Chain::straight(&free);
    let aside = Outside {
        wrenches: vec![(RINGS, Wrench::new(0.2, 0.0, 0.0, 0.0, 0.0, 0.0))],
    };
    let air = Held([0.0; CHAMBERS]);
    for _ in 0..4000 {
        chain.step(&damped, &air, &aside, 1e-3).expect("converges");
    }
    let step_s = 0.02 / expected_hz;
    let mut before_m = 1.0;
    let mut crossings_s = Vec::new();
    for i in 0..1000 {
        chain
            .step(&free, &air, &Outside::default(), step_s)
            .expect("converges");
        let x_m = chain.motions[RINGS].pose.translation.x;
        if before_m < 0.0 && x_m >= 0.0 {
            crossings_s.push((f64::from(i) - x_m / (x_m - before_m)) * step_s);
        }
        before_m = x_m;
    }
    let (first, last) = (crossings_s[0], crossings_s[crossings_s.len() - 1]);
    let hz = (crossings_s.len() - 1) as f64 / (last - first);
    assert!((hz / expected_hz - 1.0).abs() < 0.02, "{hz} {expected_hz}");
}

#[test]
fn air_is_conserved_and_a_full_stroke_takes_what_the_pumps_need() {
    const STEP_S: f64 = 2e-3;
    let robot = RobotSpec::reference();
    let arm = make(&robot, 1, 0.0, &Character::default());
    let mut chain = Chain::straight(&arm);
    let mut air = Chambers::open(arm.volumes_m3(&chain.lengths_m));
    let before: [f64; CHAMBERS] = std::array::from_fn(|c| air.held_pa_m3(c));
    let mut supplied = [0.0; CHAMBERS];
    let mut rise_s = 0.0;
    for i in 0..30_000 {
        let rises = i >= 15_000;
        let set_pa = if rises { 40e3 } else { -40e3 };
        let flows = std::array::from_fn(|c| Flow {
            pumped_m3_s: robot.pump_flow_m3_s
                * ((set_pa - air.board_pa()[c]) / 500.0).clamp(-1.0, 1.0),
            leak_m3_s_pa: 1e-12,
            ..Flow::default()
        });
        chain
            .step(&arm, &air, &Outside::default(), STEP_S)
            .expect("converges");
        let came = air.flow(&arm.volumes_m3(&chain.lengths_m), &flows, STEP_S);
        for c in 0..CHAMBERS {
            supplied[c] += came[c];
        }
        if rises && air.chamber_pa()[0] < 39e3 {
            rise_s = f64::from(i - 15_000) * STEP_S;
        }
    }
    for c in 0..CHAMBERS {
        let lost = (air.held_pa_m3(c) - before[c] - supplied[c]) / before[c];
        assert!(lost.abs() < 1e-9, "{c}: {lost:e}");
    }
    // 70 to 220 mm at 53.5 cm² and 0.6 to 1.4 atmospheres through 1.8 l/min.
    assert!((20.0..60.0).contains(&rise_s), "{rise_s}");
}

#[test]
fn the_same_seed_is_the_same_arm_and_another_is_not() {
    let robot = RobotSpec::reference();
    let tip = |seed: u64| {
        let arm = make(
            &robot,
            seed,
            0.0,
            &Character {
                damping_s: 0.05,
                friction_n: 0.0,
                ..Character::default()
            },
        );
        let mut chain = Chain::straight(&arm);
        wait(
            &arm,
            &mut chain,
            &Held([30e3, -10e3, 5e3, -20e3, 10e3, 0.0]),
            2.0,
        );
        chain.pads(&arm)[1].translation.vector
    };
    assert_eq!(tip(1), tip(1));
    assert!((tip(1) - tip(2)).norm() > 2e-4);
}

#[test]
fn the_settled_arm_is_the_one_that_was_waited_for() {
    let robot = RobotSpec::reference();
    let gauge_pa = [40e3, -40e3, -40e3, 0.0, 20e3, 0.0];
    let soon = settled_pads(&robot, gauge_pa, 0.3).expect("settles")[1];
    let arm = make(&robot, 5, 0.3, &settling(RINGS));
    let waited = settled(&arm, gauge_pa).pads(&arm)[1];
    let apart_m = (soon.translation.vector - waited.translation.vector).norm();
    assert!(apart_m < 0.05e-3, "{apart_m:e}");
}
