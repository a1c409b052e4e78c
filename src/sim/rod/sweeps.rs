//! The rod over its whole range: derivatives against differences, and solves that are checked by
//! other means than the solver's own.

use std::ops::ControlFlow;
use std::sync::LazyLock;

use nalgebra::{DMatrix, Matrix3, SVector, Vector3};
use rand::Rng;
use rand_pcg::Pcg64Mcg;

use super::assemble::Assembly;
use super::loads::Acting;
use super::se3::Frame;
use super::{Kinematics, Strains, Viscosity};
use crate::robot::RobotSpec;
use crate::signal::{CHAMBERS, SPRINGS};
use crate::sim::dataset::{normal, parallel, sample_rng};
use crate::sim::{
    GRAVITY_M_S2, INPUTS, Inputs, Model, Parameters, Resolution, Sensitivity, SimError, State,
    observe, sensitivity, settle,
};

static MODEL: LazyLock<Model> = LazyLock::new(|| Model::nominal(&RobotSpec::reference()));

const HEAVIEST_KG: f64 = 0.6;
const STRONGEST_N: f64 = 40.0;

/// Pressures in the box, in every other sample at its bounds; payload and force up to their most.
fn drawn(seed: u64, index: usize) -> (Inputs, Pcg64Mcg) {
    let mut rng = sample_rng(seed, index);
    let limits = &MODEL.robot.pressure;
    let chamber_pa = std::array::from_fn(|_| {
        let p = rng.random_range(limits.min_pa..=limits.max_pa);
        match (index.is_multiple_of(2), p < 0.0) {
            (false, _) => p,
            (true, true) => limits.min_pa,
            (true, false) => limits.max_pa,
        }
    });
    let direction = Vector3::from_fn(|_, _| normal(&mut rng)).normalize();
    let inputs = Inputs {
        chamber_pa,
        payload_kg: rng.random_range(0.0..=HEAVIEST_KG),
        tip_force_n: (direction * rng.random_range(0.0..=STRONGEST_N)).into(),
        ..Inputs::default()
    };
    (inputs, rng)
}

/// Runs `work` for every index below `n` on two threads.
fn sweep<T: Send>(n: usize, work: &(dyn Fn(usize) -> T + Sync)) -> Vec<T> {
    let out = parallel(0..n, 2, &mut |_| ControlFlow::Continue(()), work);
    assert_eq!(out.len(), n);
    out
}

/// Angle between the axes of two cross-sections, deg.
fn bend_deg(a: &Frame, b: &Frame) -> f64 {
    let cos = a.r.column(2).dot(&b.r.column(2));
    cos.clamp(-1.0, 1.0).acos().to_degrees()
}

/// f'(0) by five points: f(h), f(−h), f(2h), f(−2h).
fn slope<const N: usize>(h: f64, mut f: impl FnMut(f64) -> SVector<f64, N>) -> SVector<f64, N> {
    ((f(h) - f(-h)) * 8.0 - (f(2.0 * h) - f(-2.0 * h))) / (12.0 * h)
}

/// Bends of up to 120 deg per segment, unevenly along it, with twist, stretch and shear.
fn scattered_strains(model: &Model, rng: &mut Pcg64Mcg) -> Vec<f64> {
    let d = model.rod.strains.indices().len();
    let mut q = model.rod.rest_state();
    for section in q.chunks_mut(d * model.rod.sections[0].elements) {
        let most = 120f64.to_radians() / model.robot.rest_length_m;
        let (bend, about) = (rng.random_range(0.0..most), rng.random_range(0.0..6.3f64));
        let kappa = [bend * about.cos(), bend * about.sin(), 0.0];
        for xi in section.chunks_mut(d) {
            for (k, x) in xi.iter_mut().enumerate() {
                *x += if k < 3 {
                    kappa[k] + rng.random_range(-2.0..2.0)
                } else {
                    rng.random_range(-0.3..0.3)
                };
            }
        }
    }
    q
}

/// Whether the energy is smooth about `q`: no spring is about to go slack, and no bellows has
/// shrunk to a point.
fn is_smooth(model: &Model, q: &[f64]) -> bool {
    let state = State {
        strains: q.to_vec(),
        ..State::default()
    };
    let springs = observe(model, &state).sensors.spring_m;
    let d = model.rod.strains.indices().len();
    let elements = model.rod.sections[0].elements;
    let long = q.chunks(d).enumerate().all(|(e, xi)| {
        let section = &model.rod.sections[e / elements];
        let shear = if d == 6 { [xi[3], xi[4]] } else { [0.0; 2] };
        let v = Vector3::new(shear[0], shear[1], xi[d - 1]);
        let kappa = Vector3::new(xi[0], xi[1], xi[2]);
        let mut bellows = section.bellows.iter();
        bellows.all(|t| (v + kappa.cross(&t.r_m)).norm() > 0.2)
    });
    long && springs
        .iter()
        .all(|l| (l - model.robot.spring.free_length_m).abs() > 1e-3)
}

#[test]
fn derivatives_of_the_energy_agree_with_differences_everywhere() {
    const ELEMENTS: usize = 3;
    const STATES: usize = 1000;
    let model_of = |strains| {
        let hard = Parameters {
            hardening: 0.3,
            ..Parameters::default()
        };
        let resolution = Resolution {
            elements: ELEMENTS,
            strains,
        };
        Model::new(&MODEL.robot, &hard, resolution)
    };
    let models = [model_of(Strains::NoShear), model_of(Strains::All)];
    let found = sweep(STATES, &|index| {
        let rod = &models[index / 2 % 2].rod;
        let (inputs, mut rng) = drawn(11, index);
        let loads = models[index / 2 % 2].loads(&inputs);
        let rest = rod.rest_state();
        let acting = Acting {
            drag: Some((Viscosity::proportional(0.1), rest.as_slice())),
            ..Acting::at_rest(&loads)
        };
        let mut q = scattered_strains(&models[index / 2 % 2], &mut rng);
        while !is_smooth(&models[index / 2 % 2], &q) {
            q = scattered_strains(&models[index / 2 % 2], &mut rng);
        }
        let mut at = Assembly::default();
        at.evaluate(rod, &acting, &q);
        let n = q.len();
        let (exact_g, exact_h) = (at.gradient.clone(), at.hessian.clone());
        let full = |i: usize, j: usize| exact_h[i.max(j) * n + i.min(j)];
        let moved = |j: usize, by: f64| {
            let mut q = q.clone();
            q[j] += by;
            q
        };
        let (mut worst_g, mut norm_g, mut worst_h) = (0.0f64, 0.0f64, 0.0f64);
        for j in 0..n {
            let g = slope::<1>(1e-3, |by| {
                SVector::repeat(Assembly::energy_only(rod, &acting, &moved(j, by)))
            });
            worst_g += (g[0] - exact_g[j]).powi(2);
            norm_g += exact_g[j].powi(2);
            let column = slope::<36>(1e-3, |by| {
                at.evaluate(rod, &acting, &moved(j, by));
                SVector::from_fn(|i, _| at.gradient.get(i).copied().unwrap_or(0.0))
            });
            let (mut off, mut norm) = (0.0, 0.0);
            for i in 0..n {
                off += (column[i] - full(i, j)).powi(2);
                norm += full(i, j).powi(2);
            }
            worst_h = worst_h.max((off / norm).sqrt());
        }
        let at = Kinematics::at(rod, &q);
        let bend = [at.ends(0), at.ends(1)]
            .iter()
            .map(|[a, b]| bend_deg(a, b))
            .fold(0.0, f64::max);
        ((worst_g / norm_g).sqrt(), worst_h, bend)
    });
    let worst_g = found.iter().map(|f| f.0).fold(0.0, f64::max);
    let worst_h = found.iter().map(|f| f.1).fold(0.0, f64::max);
    let bent = found.iter().filter(|f| f.2 > 80.0).count();
    println!(
        "{STATES} states, {bent} bent beyond 80 deg: gradient {worst_g:.1e}, Hessian {worst_h:.1e}"
    );
    assert!(bent > STATES / 4, "only {bent} states bend beyond 80 deg");
    assert!(worst_g < 1e-6, "gradient off by {worst_g:.1e}");
    assert!(worst_h < 1e-6, "Hessian off by {worst_h:.1e}");
}

/// Rotation vector of `a` against `b`, both close together.
fn turned(a: &Matrix3<f64>, b: &Matrix3<f64>) -> Vector3<f64> {
    let r = a * b.transpose();
    let v = Vector3::new(
        r[(2, 1)] - r[(1, 2)],
        r[(0, 2)] - r[(2, 0)],
        r[(1, 0)] - r[(0, 1)],
    ) * 0.5;
    let sin = v.norm();
    if sin == 0.0 {
        v
    } else {
        v * (sin.asin() / sin)
    }
}

fn nudged(inputs: &Inputs, column: usize, by: f64) -> Inputs {
    let mut out = inputs.clone();
    match column {
        i if i < CHAMBERS => out.chamber_pa[i] += by,
        CHAMBERS => out.payload_kg += by,
        i => out.tip_force_n[i - CHAMBERS - 1] += by,
    }
    out
}

#[test]
fn sensitivities_agree_with_differences_everywhere() {
    const STATES: usize = 1000;
    /// Tip twist, middle twist, springs.
    const ROWS: usize = 12 + SPRINGS;
    let found = sweep(STATES, &|index| {
        let (inputs, _) = drawn(12, index);
        let mut state = State::rest(&MODEL);
        settle(&MODEL, &mut state, &inputs).ok()?;
        let s: Sensitivity =
            sensitivity(&MODEL, &state, &inputs).expect("a settled state is stable");
        let ends = |state: &State| {
            let at = Kinematics::at(&MODEL.rod, &state.strains);
            [1, 0].map(|s| at.ends(s)[1])
        };
        let base = ends(&state);
        let mut worst = 0.0f64;
        for column in 0..INPUTS {
            let h = match column {
                i if i < CHAMBERS => 40.0,
                CHAMBERS => 5e-3,
                _ => 0.05,
            };
            let num = slope::<ROWS>(h, |by| {
                let mut near = State {
                    strains: state.strains.clone(),
                    ..State::default()
                };
                settle(&MODEL, &mut near, &nudged(&inputs, column, by)).expect("settles nearby");
                let mut out = SVector::<f64, ROWS>::zeros();
                for (k, (a, b)) in ends(&near).iter().zip(&base).enumerate() {
                    out.fixed_rows_mut::<3>(6 * k)
                        .copy_from(&turned(&a.r, &b.r));
                    out.fixed_rows_mut::<3>(6 * k + 3).copy_from(&(a.p - b.p));
                }
                let springs = observe(&MODEL, &near).sensors.spring_m;
                out.fixed_rows_mut::<SPRINGS>(12)
                    .copy_from(&SVector::from(springs));
                out
            });
            let mut exact = SVector::<f64, ROWS>::zeros();
            exact
                .fixed_rows_mut::<6>(0)
                .copy_from(&s.tip.column(column));
            exact
                .fixed_rows_mut::<6>(6)
                .copy_from(&s.middle.column(column));
            exact
                .fixed_rows_mut::<SPRINGS>(12)
                .copy_from(&s.spring.column(column));
            // Each of the three against its own size; a chamber of segment 2 hardly moves the
            // middle pad, so the column as a whole bounds what can be resolved there.
            for (from, rows) in [(0, 6), (6, 6), (12, SPRINGS)] {
                let off = (num - exact).rows(from, rows).norm();
                worst = worst.max(off / exact.rows(from, rows).norm().max(1e-2 * exact.norm()));
            }
        }
        Some((worst, bend_deg(&MODEL.rod.base, &base[0])))
    });
    let settled: Vec<_> = found.into_iter().flatten().collect();
    let worst = settled.iter().map(|f| f.0).fold(0.0, f64::max);
    let bent = settled.iter().filter(|f| f.1 > 80.0).count();
    println!(
        "{} of {STATES} states settled, {bent} bent beyond 80 deg: sensitivities {worst:.1e}",
        settled.len()
    );
    assert!(settled.len() > STATES * 9 / 10);
    assert!(bent > 20, "only {bent} states bend beyond 80 deg");
    assert!(worst < 1e-6, "off by {worst:.1e}");
}

#[test]
fn an_unstable_state_has_no_sensitivity() {
    // The straight arm, compressed along its own axis far beyond what it can hold.
    let state = State::rest(&MODEL);
    let inputs = Inputs {
        tip_force_n: [0.0, 0.0, 3000.0],
        ..Inputs::default()
    };
    assert_eq!(sensitivity(&MODEL, &state, &inputs), None);
}

/// Residual, as a share of the forces and moments at play: every component of the gradient
/// per element length, forces over the largest bellows force, moments over that at its radius.
fn imbalance(gradient: &[f64]) -> f64 {
    let robot = &MODEL.robot;
    let force_n = robot.pressure.max_pa * robot.area_m2[0];
    let moment_nm = force_n * robot.bellows_m[0].norm();
    let idx = MODEL.rod.strains.indices();
    let l = robot.rest_length_m / MODEL.rod.sections[0].elements as f64;
    gradient
        .iter()
        .enumerate()
        .map(|(k, g)| {
            let of = if idx[k % idx.len()] < 3 {
                moment_nm
            } else {
                force_n
            };
            (g / l / of).abs()
        })
        .fold(0.0, f64::max)
}

/// Settles by raising all loads slowly from the unloaded arm, one small step after the other.
fn followed(inputs: &Inputs, steps: usize) -> Result<State, SimError> {
    let mut state = State::rest(&MODEL);
    for k in 0..=steps {
        let share = k as f64 / steps as f64;
        let part = Inputs {
            chamber_pa: inputs.chamber_pa.map(|p| p * share),
            payload_kg: inputs.payload_kg * share,
            tip_force_n: inputs.tip_force_n.map(|f| f * share),
            ..Inputs::default()
        };
        settle(&MODEL, &mut state, &part)?;
    }
    Ok(state)
}

/// What a solve that was not refused is worth, found without the solver's own diagnostics.
struct Verified {
    strains: Vec<f64>,
    imbalance: f64,
    /// Smallest eigenvalue of the Hessian.
    softest: f64,
}

/// Settles from rest. A refusal must give its reason and leave the arm where it was.
fn solved(inputs: &Inputs) -> Option<Verified> {
    let mut state = State::rest(&MODEL);
    let before = state.strains.clone();
    if let Err(e) = settle(&MODEL, &mut state, inputs) {
        assert!(
            matches!(
                e,
                SimError::NoEquilibrium { .. } | SimError::InsideOut { .. }
            ),
            "{e}"
        );
        assert!(e.to_string().contains("beyond what the arm can hold"));
        assert_eq!(state.strains, before, "a refusal moved the arm");
        return None;
    }
    let q = &state.strains;
    let mut at = Assembly::default();
    at.evaluate(&MODEL.rod, &Acting::at_rest(&MODEL.loads(inputs)), q);
    let n = q.len();
    let h = DMatrix::from_fn(n, n, |i, j| at.hessian[i.max(j) * n + i.min(j)]);
    let imbalance = imbalance(&at.gradient);
    let softest = h.symmetric_eigenvalues().min();
    assert!(at.gradient.iter().all(|g| g.is_finite()) && softest.is_finite());
    assert!(
        imbalance < 1e-9,
        "{inputs:?}: out of balance by {imbalance:.1e}"
    );
    assert!(
        softest > 0.0,
        "{inputs:?}: an unstable state was accepted: {softest}"
    );
    Some(Verified {
        strains: state.strains,
        imbalance,
        softest,
    })
}

fn summary(found: &[Option<Verified>]) -> String {
    let held = found.iter().flatten();
    let worst = held.clone().map(|f| f.imbalance).fold(0.0, f64::max);
    let softest = held.map(|f| f.softest).fold(f64::INFINITY, f64::min);
    let refused = found.iter().filter(|f| f.is_none()).count();
    format!(
        "{} solves: {refused} refused, imbalance {worst:.1e}, softest curvature {softest:.1e}",
        found.len()
    )
}

#[test]
fn ten_thousand_solves_are_right() {
    let found = sweep(10_000, &|index| solved(&drawn(13, index).0));
    println!("{}", summary(&found));
    assert!(
        found.iter().all(Option::is_some),
        "a load in range was refused"
    );
    // No second equilibrium was jumped to: slow loading leads to the same place.
    let apart = sweep(500, &|index| {
        let slow = followed(&drawn(13, index).0, 64).expect("held at every share of the load");
        let strains = &found[index].as_ref().expect("held").strains;
        let tip = |q: &[f64]| Kinematics::at(&MODEL.rod, q).tip().p;
        (tip(&slow.strains) - tip(strains)).norm()
    });
    assert!(apart.iter().all(|d| *d < 1e-9), "{apart:?}");
}

#[test]
fn loads_beyond_reason_are_right_or_refused() {
    // Forces and payload up to 100 times the most, and in every fourth sample pressures up to 20
    // times: nothing the arm is for.
    let found = sweep(400, &|index| {
        let (mut inputs, _) = drawn(15, index);
        inputs.payload_kg *= 100.0;
        inputs.tip_force_n = inputs.tip_force_n.map(|f| f * 100.0);
        if index.is_multiple_of(4) {
            inputs.chamber_pa = inputs.chamber_pa.map(|p| p * 20.0);
        }
        solved(&inputs)
    });
    println!("{}", summary(&found));
    let refused = found.iter().filter(|f| f.is_none()).count();
    assert!((1..300).contains(&refused), "{refused} refused");
    // What is held, the arm could do: no bellows has passed through itself.
    let d = MODEL.rod.strains.indices().len();
    for f in found.iter().flatten() {
        assert!(f.strains.chunks(d).all(|xi| xi[d - 1] < 0.0));
    }
}

fn tip(inputs: &Inputs) -> Frame {
    let mut state = State::rest(&MODEL);
    settle(&MODEL, &mut state, inputs).expect("settles");
    Kinematics::at(&MODEL.rod, &state.strains).tip()
}

fn kpa(values: [f64; CHAMBERS]) -> Inputs {
    Inputs {
        chamber_pa: values.map(|p| p * 1e3),
        ..Inputs::default()
    }
}

/// Where a push of 40 N in the direction `deg` about the vertical moves the tip, m.
fn pushed(at: &Inputs, deg: f64) -> Vector3<f64> {
    let a = deg.to_radians();
    let push = Inputs {
        tip_force_n: [STRONGEST_N * a.cos(), STRONGEST_N * a.sin(), 0.0],
        ..at.clone()
    };
    tip(&push).p - tip(at).p
}

fn about_z(deg: f64) -> Matrix3<f64> {
    *nalgebra::Rotation3::from_axis_angle(&Vector3::z_axis(), deg.to_radians()).matrix()
}

const EIGHT_DEG: [f64; 8] = [0.0, 45.0, 90.0, 135.0, 180.0, 225.0, 270.0, 315.0];

#[test]
fn forty_newtons_from_eight_sides_are_held() {
    // Straight arms: short, as built, long. They are their own mirror images in the plane of x and
    // z, and their own images after a third of a turn.
    for p in [-40.0, 0.0, 40.0] {
        let at = kpa([p; CHAMBERS]);
        for deg in EIGHT_DEG {
            let moved = pushed(&at, deg);
            let lateral = moved.xy();
            let wanted = nalgebra::Vector2::new(deg.to_radians().cos(), deg.to_radians().sin());
            let astray = lateral.angle(&wanted).to_degrees();
            println!(
                "{p} kPa, {deg} deg: {:.1} mm, {astray:.2} deg astray, {:.1} mm up",
                lateral.norm() * 1e3,
                moved.z * 1e3
            );
            assert!(lateral.norm() > 0.01 && astray < 5.0, "{deg}: {moved}");
            assert!(moved.z > 0.0, "{deg}: pushed aside the arm rises: {moved}");
            let mirrored = pushed(&at, -deg);
            let back = Vector3::new(mirrored.x, -mirrored.y, mirrored.z);
            assert!((back - moved).norm() < 1e-9, "{deg}: {moved} {mirrored}");
            let turned = about_z(120.0) * moved - pushed(&at, deg + 120.0);
            assert!(turned.norm() < 1e-9, "{deg}: {turned}");
        }
    }
    // Bent arms: the push works on the arm, and a third of a turn of all turns all.
    for p in [
        [40.0, -40.0, -40.0, 0.0, 0.0, 0.0],
        [40.0, -40.0, -40.0, 40.0, -40.0, 40.0],
        [25.0, -10.0, -30.0, 5.0, 30.0, -20.0],
    ] {
        let at = kpa(p);
        let next = kpa([p[2], p[0], p[1], p[5], p[3], p[4]]);
        for deg in EIGHT_DEG {
            let moved = pushed(&at, deg);
            let push = Vector3::new(deg.to_radians().cos(), deg.to_radians().sin(), 0.0);
            println!(
                "{p:?} kPa, {deg} deg: {:.1} mm along the push of {:.1} mm",
                moved.dot(&push) * 1e3,
                moved.norm() * 1e3
            );
            assert!(moved.dot(&push) > 0.005, "{p:?} {deg}: {moved}");
            let turned = about_z(120.0) * moved - pushed(&next, deg + 120.0);
            assert!(turned.norm() < 1e-9, "{p:?} {deg}: {turned}");
        }
    }
}

#[test]
fn half_a_kilogram_stretches_the_straight_arm_as_by_hand() {
    let robot = &MODEL.robot;
    let m = 0.5;
    for p in [-20.0, 0.0, 20.0] {
        let at = kpa([p; CHAMBERS]);
        let loaded = Inputs {
            payload_kg: m,
            ..at.clone()
        };
        let (light, heavy) = (tip(&at).p, tip(&loaded).p);
        let sunk = light.z - heavy.z;
        // Springs: length d between ends a apart sideways, d² = L² + a²; the pull along the arm of
        // one is T L / d, its stiffness c [(L/d)² + (1 − d₀/d)(1 − (L/d)²)].
        let mut state = State::rest(&MODEL);
        settle(&MODEL, &mut state, &at).expect("settles");
        let o = observe(&MODEL, &state);
        let mut by_hand = 0.0;
        for segment in 0..2 {
            let length = o.bellows_m[3 * segment];
            let mut stiffness = 3.0 * robot.axial_stiffness_n_m[0];
            for d in &o.sensors.spring_m[6 * segment..6 * segment + 6] {
                let along = (length / d).powi(2);
                let slack = 1.0 - robot.spring.free_length_m / d;
                stiffness += robot.spring.rate_n_m * (along + slack * (1.0 - along));
            }
            by_hand += m * GRAVITY_M_S2 / stiffness;
        }
        println!(
            "{p} kPa: sinks {:.3} mm, by hand {:.3} mm",
            sunk * 1e3,
            by_hand * 1e3
        );
        assert!((sunk / by_hand - 1.0).abs() < 2e-3, "{sunk} {by_hand}");
        assert!((heavy - light).xy().norm() < 1e-9);
    }
}

#[test]
fn half_a_kilogram_bends_an_arm_down_and_settles_lowest() {
    for index in 0..200 {
        let (mut at, _) = drawn(14, index);
        at.tip_force_n = [0.0; 3];
        at.payload_kg = 0.0;
        let loaded = Inputs {
            payload_kg: 0.5,
            ..at.clone()
        };
        let settled = |inputs: &Inputs| {
            let mut state = State::rest(&MODEL);
            settle(&MODEL, &mut state, inputs).expect("settles");
            state.strains
        };
        let (light, heavy) = (settled(&at), settled(&loaded));
        let energy = |inputs: &Inputs, q: &[f64]| {
            Assembly::energy_only(&MODEL.rod, &Acting::at_rest(&MODEL.loads(inputs)), q)
        };
        // Each shape has the least energy under its own load.
        assert!(energy(&loaded, &heavy) < energy(&loaded, &light), "{index}");
        assert!(energy(&at, &light) < energy(&at, &heavy), "{index}");
        // The payload itself has come down, and with it the energy of everything it hangs on.
        let payload = |q: &[f64]| {
            let com = Vector3::new(0.0, 0.0, -MODEL.robot.payload_com_m);
            Kinematics::at(&MODEL.rod, q).tip().point(&com).z
        };
        let sunk = payload(&light) - payload(&heavy);
        assert!(sunk > 5e-4, "{index}: {sunk}");
        assert!(
            energy(&loaded, &heavy) < energy(&at, &light) + 0.5 * GRAVITY_M_S2 * payload(&light)
        );
    }
    // An arm bent to one side hangs more steeply under load.
    let bent = kpa([40.0, -40.0, -40.0, 0.0, 0.0, 0.0]);
    let loaded = Inputs {
        payload_kg: 0.5,
        ..bent.clone()
    };
    let (light, heavy) = (tip(&bent), tip(&loaded));
    assert!(heavy.p.z < light.p.z - 2e-3, "{} {}", light.p, heavy.p);
    assert!(
        heavy.p.xy().norm() < light.p.xy().norm(),
        "swings in under the base"
    );
    assert!(bend_deg(&MODEL.rod.base, &heavy) < bend_deg(&MODEL.rod.base, &light));
}
