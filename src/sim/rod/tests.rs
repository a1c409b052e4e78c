use super::assemble::Assembly;
use super::loads::Acting;
use super::*;
use crate::robot::RobotSpec;
use crate::sim::{Model, Parameters, Resolution};

fn jitter(i: usize) -> f64 {
    ((i as f64 * 12.9898).sin() * 43_758.547).fract()
}

#[test]
fn gradient_and_hessian_agree_with_differences() {
    for strains in [Strains::NoShear, Strains::All] {
        let model = Model::new(
            &RobotSpec::reference(),
            &Parameters {
                hardening: 0.3,
                ..Parameters::default()
            },
            Resolution {
                elements: 3,
                strains,
            },
        );
        let mut rod = model.rod;
        let loads = Loads {
            bellows_n: vec![200.0, -100.0, 50.0, 30.0, -200.0, 120.0],
            tip_force_n: nalgebra::Vector3::new(10.0, -7.0, 3.0),
            tip_masses: vec![PointMass {
                at_m: nalgebra::Vector3::new(0.01, 0.02, -0.1),
                kg: 0.5,
            }],
            ..Loads::default()
        };
        // Long memories of forces that are far from saturated, over a floor that is felt.
        for bellows in rod.bellows_mut() {
            bellows.friction.push(Friction {
                coulomb_force_n: 60.0,
                presliding_m: 0.08,
            });
            bellows.branches.push(Branch {
                rate_n_m: 300.0,
                tau_s: 0.2,
            });
            bellows.hinges = [true, false]
                .map(|beyond| Hinge {
                    from: 1.0,
                    beyond,
                    stiffness_n: if beyond { 150.0 } else { 80.0 },
                })
                .to_vec();
        }
        rod.floor = Some(Floor {
            surface_from_base: nalgebra::Rotation3::from_euler_angles(0.3, -0.2, 0.4),
            height_m: 1.0,
            rate_n_m: 200.0,
            friction: 0.3,
            drag: Some(Drag {
                force_n: 2.0,
                rate_n_m: 250.0,
            }),
        });
        let history = History {
            bellows: (0..6)
                .map(|i| BellowsHistory {
                    length_m: 0.12,
                    friction_n: vec![20.0 * jitter(i)],
                    branch_n: vec![30.0 * jitter(i + 7)],
                })
                .collect(),
            contact: Some(Contact {
                at_m: nalgebra::Vector3::new(0.01, -0.02, 0.2),
                grip_n: nalgebra::Vector2::new(20.0, 5.0),
                drag_n: nalgebra::Vector3::new(1.0, -0.5, 0.7),
            }),
        };
        let rod = &rod;
        let rest = rod.rest_state();
        let d = strains.indices().len();
        let q: Vec<f64> = rest
            .iter()
            .enumerate()
            .map(|(i, r)| {
                r + jitter(i)
                    * if strains.indices()[i % d] < 3 {
                        5.0
                    } else {
                        0.3
                    }
            })
            .collect();
        let n = q.len();
        let step = StepLoads {
            loads: &loads,
            viscosity: Viscosity {
                bellows: 0.2,
                core: 0.1,
            },
            history: &history,
            dt_s: 0.1,
        };
        let acting = Acting::over(&step, &rest);
        let mut at = Assembly::default();
        at.evaluate(rod, &acting, &q);
        let e0 = Assembly::energy_only(rod, &acting, &q);
        assert!(
            (at.energy - e0).abs() < 1e-9 * e0.abs().max(1.0),
            "{} {e0}",
            at.energy
        );
        let (g, h) = (at.gradient.clone(), at.hessian.clone());
        let scale = g.iter().fold(0.0f64, |m, x| m.max(x.abs()));
        let hscale = h.iter().fold(0.0f64, |m, x| m.max(x.abs()));
        for i in 0..n {
            let eps = 1e-5;
            let mut plus = q.clone();
            plus[i] += eps;
            let mut minus = q.clone();
            minus[i] -= eps;
            let num = (Assembly::energy_only(rod, &acting, &plus)
                - Assembly::energy_only(rod, &acting, &minus))
                / (2.0 * eps);
            assert!(
                (num - g[i]).abs() < 1e-6 * scale,
                "gradient {i}: {num} {}",
                g[i]
            );
            at.evaluate(rod, &acting, &plus);
            let gp = at.gradient.clone();
            at.evaluate(rod, &acting, &minus);
            for j in 0..=i {
                let num = (gp[j] - at.gradient[j]) / (2.0 * eps);
                assert!(
                    (num - h[i * n + j]).abs() < 1e-6 * hscale,
                    "{strains:?} Hessian {i} {j}: {num} {}",
                    h[i * n + j]
                );
            }
        }
    }
}

#[test]
fn the_jacobian_under_a_tip_moment_agrees_with_differences() {
    let model = Model::new(
        &RobotSpec::reference(),
        &Parameters::default(),
        Resolution {
            elements: 2,
            strains: Strains::All,
        },
    );
    let rod = &model.rod;
    let loads = Loads {
        bellows_n: vec![100.0, -100.0, 50.0, 30.0, -200.0, 120.0],
        tip_moment_nm: nalgebra::Vector3::new(3.0, -5.0, 4.0),
        ..Loads::default()
    };
    let rest = rod.rest_state();
    let q: Vec<f64> = rest
        .iter()
        .enumerate()
        .map(|(i, r)| r + jitter(i) * if i % 6 < 3 { 5.0 } else { 0.3 })
        .collect();
    let mut at = Assembly::default();
    at.evaluate(rod, &Acting::at_rest(&loads), &q);
    let exact = at.jacobian(rod, &loads);
    let scale = exact.amax();
    for j in 0..q.len() {
        let gradient = |eps: f64| {
            let mut moved = q.clone();
            moved[j] += eps;
            let mut at = Assembly::default();
            at.evaluate(rod, &Acting::at_rest(&loads), &moved);
            at.gradient
        };
        let (plus, minus) = (gradient(1e-5), gradient(-1e-5));
        for i in 0..q.len() {
            let num = (plus[i] - minus[i]) / 2e-5;
            assert!(
                (num - exact[(i, j)]).abs() < 1e-7 * scale,
                "{i} {j}: {num} {}",
                exact[(i, j)]
            );
        }
    }
    let mut q = rest;
    let outcome = solve(rod, &loads, &mut q, &mut Workspace::default());
    assert!(outcome.converged && outcome.iterations < 20, "{outcome:?}");
}

/// Three equal pressures lengthen a segment by 3 p A / (3 k + core); a locked one stays where it is.
#[test]
fn a_core_resists_extension_alone_and_a_locked_segment_everything() {
    use crate::robot::REFERENCE;
    use crate::sim::{Inputs, State, observe, settle};
    let tables = |first: &str| format!("{REFERENCE}\n[[segments]]\n{first}\n[[segments]]\n");
    let ends = |text: &str, chamber_pa: [f64; 6]| {
        let mut robot = RobotSpec::from_toml(text).expect("reads");
        robot.spring.rate_n_m = 0.0;
        let mut model = Model::nominal(&robot);
        model.rod.gravity_m_s2 = nalgebra::Vector3::zeros();
        let mut state = State::rest(&model);
        let inputs = Inputs {
            chamber_pa,
            ..Inputs::default()
        };
        settle(&model, &mut state, &inputs).expect("settles");
        let [_, middle, tip] = observe(&model, &state).shape.base_from_pad;
        [middle, tip]
    };
    let robot = RobotSpec::reference();
    let even = [10e3, 10e3, 10e3, 0.0, 0.0, 0.0];
    let grows_m = |core_n_m: f64| {
        let k = 3.0 * robot.axial_stiffness_n_m[0] + core_n_m;
        3.0 * even[0] * robot.area_m2[0] / k
    };
    let with_core = tables("axial_stiffness_n_m = 4000.0");
    for (text, core_n_m) in [(REFERENCE, 0.0), (with_core.as_str(), 4000.0)] {
        let [middle, _] = ends(text, even);
        let grown_m = -middle.translation.z - robot.rest_length_m;
        assert!(
            (grown_m / grows_m(core_n_m) - 1.0).abs() < 1e-3,
            "{core_n_m} N/m: {grown_m}"
        );
    }
    // The core of a segment that bends without growing does nothing.
    let uneven = [20e3, -10e3, -10e3, 5e3, -10e3, 5e3];
    let ([_, plain], [_, cored]) = (ends(REFERENCE, uneven), ends(&with_core, uneven));
    let off_m = (plain.translation.vector - cored.translation.vector).norm();
    assert!(off_m < 2e-3, "{off_m}");
    let [middle, tip] = ends(&tables("locked = true"), uneven);
    let moved_m = (middle.translation.vector + nalgebra::Vector3::z() * robot.rest_length_m).norm();
    assert!(
        moved_m < 1e-4 && middle.rotation.angle() < 2e-3,
        "{moved_m} {}",
        middle.rotation.angle()
    );
    assert!(tip.rotation.angle() > 0.05, "{}", tip.rotation.angle());
}
