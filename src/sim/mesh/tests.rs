use super::*;
use crate::robot::SegmentSpec;

const BENT_KPA: [f64; CHAMBERS] = [25.0, -10.0, -30.0, 5.0, 30.0, -20.0];

fn bent() -> Inputs {
    Inputs {
        chamber_pa: BENT_KPA.map(|p| p * 1e3),
        payload_kg: 0.2,
        ..Inputs::default()
    }
}

fn reference() -> MeshModel {
    MeshModel::with_walls(&RobotSpec::reference(), 1.95).expect("meshes")
}

fn apart_mm(model: &MeshModel, a: &MeshState, b: &MeshState) -> f64 {
    let tip = |s| observe_mesh(model, s).base_from_tip.translation.vector;
    (tip(a) - tip(b)).norm() * 1e3
}

#[test]
fn plain_pairs_never_raise_the_energy() {
    let model = reference();
    let inputs = bent();
    let aims = model.aims(&inputs);
    let mut at = MeshState::rest(&model);
    let mut before = f64::INFINITY;
    for k in 0..25 {
        let step = pair(&model, &at, &aims, &model.acting);
        assert!(step.energy_j <= before + 1e-10, "pair {k}");
        (before, at) = (step.energy_j, step.next);
    }
}

#[test]
fn node_forces_are_the_slope_of_the_energy() {
    let model = reference();
    let column = &model.columns[1];
    let n = column.rest_m.len();
    let mut x: Vec<Vector3<f64>> = column
        .rest_m
        .iter()
        .map(|p| p + Vector3::new((40.0 * p.z).sin(), (90.0 * p.y).cos(), p.x * 20.0) * 5e-3)
        .collect();
    let (mut force, mut axial) = (vec![Vector3::zeros(); n], vec![Vector3::zeros(); n]);
    // Growth at its own optimum, so that its derivative does not matter.
    let mut growth = 1.1;
    for _ in 0..200 {
        growth = column.local(&x, growth, 1.2, &mut force, &mut axial).growth;
    }
    let at = force.clone();
    for i in [3, 70, 200, n - 5] {
        for k in 0..3 {
            let eps = 1e-6;
            let mut energy = |d: f64| {
                x[i][k] += d;
                let e = column
                    .local(&x, growth, 1.2, &mut force, &mut axial)
                    .energy_j;
                x[i][k] -= d;
                e
            };
            let slope = (energy(eps) - energy(-eps)) / (2.0 * eps);
            assert!((slope + at[i][k]).abs() < 1e-4, "{slope} {}", at[i][k]);
        }
    }
}

#[test]
fn the_end_does_not_depend_on_the_start() {
    let model = reference();
    let mut cold = MeshState::rest(&model);
    settle_mesh(&model, &mut cold, &bent()).expect("settles");
    let mut warm = MeshState::rest(&model);
    let other = Inputs {
        chamber_pa: BENT_KPA.map(|p| -1e3 * p),
        ..Inputs::default()
    };
    settle_mesh(&model, &mut warm, &other).expect("settles");
    settle_mesh(&model, &mut warm, &bent()).expect("settles");
    assert!(apart_mm(&model, &cold, &warm) < 0.05);
    // Stopping on the residual stops close: compare with a much tighter one.
    let mut fine = cold.clone();
    settle_to(&model, &mut fine, &bent(), 1e-5).expect("settles");
    assert!(apart_mm(&model, &cold, &fine) < 0.03);
}

#[test]
fn stiffness_does_not_depend_on_the_mesh() {
    let robot = RobotSpec::reference();
    let origins = [
        Vector3::new(0.0, 0.0, -robot.rest_length_m),
        Vector3::zeros(),
    ];
    let axial = |sectors: usize, layers: usize| {
        let mut b = build(&robot, 2.0, 0, Vector3::zeros(), origins);
        b.weight_j_m3 *= meshed_volume_m3(&b);
        (b.sectors, b.layers) = (sectors, layers);
        b.weight_j_m3 /= meshed_volume_m3(&b);
        Column::new(&b).expect("meshes").reduced[(4, 4)]
    };
    // β k l₀²·(1/l₀)² against an axial displacement of the lower end.
    let want = 2.0 * robot.axial_stiffness_n_m[0];
    for (sectors, layers) in [(8, 4), (16, 12), (20, 16)] {
        let got = axial(sectors, layers);
        assert!((got / want - 1.0).abs() < 1e-9, "{got} {want}");
    }
}

#[test]
fn the_mesh_fits_its_budget_and_its_skin_faces_out() {
    let model = reference();
    assert!((5_000..8_000).contains(&model.tetrahedra()));
    let s = skin(&model, &MeshState::rest(&model));
    let at = |i: u32| Vector3::from(s.positions_m[i as usize]);
    // ∑ ⅙ a·(b × c) over the open side walls of a prism is two thirds of its volume about its own
    // centre: outward if positive.
    let outer = 0.5 * model.robot.bellows_outer_diameter_m;
    let first = &s.triangles[..2 * BELLOWS[0] * BELLOWS[1]];
    let centre = model.robot.bellows_m[0] - Vector3::z() * (0.5 * model.robot.rest_length_m);
    let volume: f64 = first
        .iter()
        .map(|t| {
            let [a, b, c] = t.map(|i| at(i) - centre);
            a.dot(&b.cross(&c)) / 6.0
        })
        .sum();
    let n = BELLOWS[0] as f64;
    let polygon = 0.5 * n * (std::f64::consts::TAU / n).sin() * outer * outer;
    let want = 2.0 / 3.0 * polygon * model.robot.rest_length_m;
    assert!((volume / want - 1.0).abs() < 1e-9, "{volume} {want}");
}

#[test]
fn calibration_bends_like_the_rod() {
    let robot = RobotSpec::reference();
    let model = MeshModel::new(&robot).expect("meshes");
    let inputs = calibration_bend(&robot);
    let mut state = MeshState::rest(&model);
    settle_mesh(&model, &mut state, &inputs).expect("settles");
    let rod = Model::nominal(&robot);
    let mut rod_state = State::rest(&rod);
    settle(&rod, &mut rod_state, &inputs).expect("settles");
    let [a, b] = [
        bend_rad(&observe_mesh(&model, &state).base_from_tip),
        bend_rad(&observe_rod(&rod, &rod_state).base_from_tip),
    ];
    assert!((a - b).abs() < 5e-4, "{a} {b}");
}

#[test]
fn walls_that_cannot_bend_like_the_rod_are_refused() {
    let wanted = |beta: f64| move |b: f64| Ok(0.3 / b - 0.3 / beta);
    let found = wall_ratio(2.0, wanted(3.1)).expect("within the bounds");
    assert!((0.3 / found - 0.3 / 3.1).abs() < 1e-4, "{found}");
    for (beta, bound) in [(1.001, 1.02), (30.0, 20.0)] {
        match wall_ratio(2.0, wanted(beta)) {
            Err(SimError::MeshWalls {
                wall_ratio,
                off_rad,
            }) => {
                assert_eq!(wall_ratio, bound);
                assert!((off_rad - (0.3 / bound - 0.3 / beta)).abs() < 1e-12);
            }
            other => panic!("{beta}: {other:?}"),
        }
    }
    // No slope, and a slope that never leads there.
    assert!(wall_ratio(2.0, |_| Ok(0.1)).is_err());
    assert!(wall_ratio(2.0, |b: f64| Ok(0.1 + (50.0 * b).sin().abs())).is_err());
    let robot = RobotSpec::reference();
    let limp = RobotSpec {
        segments: robot.segments.map(|s| SegmentSpec {
            bending_nm_rad: 0.02 * s.bending_nm_rad,
            ..s
        }),
        ..robot
    };
    let refused = MeshModel::new(&limp);
    assert!(refused.is_err(), "{:?}", refused.map(|m| m.wall_ratio));
}

#[test]
#[ignore = "a measurement: prints how long samples take"]
fn how_long_samples_take() {
    use crate::sim::dataset::{Draw, pressures, sample_rng};
    #[expect(clippy::disallowed_methods, reason = "a measurement")]
    let now = std::time::Instant::now;
    let robot = RobotSpec::reference();
    let start = now();
    let model = MeshModel::new(&robot).expect("meshes");
    println!(
        "{} tetrahedra, walls {:.3}, built in {:?}",
        model.tetrahedra(),
        model.wall_ratio,
        start.elapsed()
    );
    let (mut cold, mut warm, mut step) = (Vec::new(), Vec::new(), Vec::new());
    let mut last = MeshState::rest(&model);
    let rod = Model::nominal(&robot);
    let mut apart = Vec::new();
    let mut iterations = 0;
    for i in 0..100 {
        let mut rng = sample_rng(5, i);
        let mut inputs = Inputs {
            chamber_pa: pressures(Draw::Uniform(100), &robot, i, &mut rng),
            ..Inputs::default()
        };
        let run = |times: &mut Vec<f64>, state: &mut MeshState, inputs: &Inputs| {
            let start = now();
            let outcome = settle_mesh(&model, state, inputs);
            times.push(start.elapsed().as_secs_f64() * 1e3);
            outcome.map_or_else(|e| panic!("{inputs:?}: {e}"), |o| o.iterations)
        };
        let mut state = MeshState::rest(&model);
        iterations += run(&mut cold, &mut state, &inputs);
        run(&mut warm, &mut last, &inputs);
        inputs.chamber_pa[0] -= 500.0 * inputs.chamber_pa[0].signum();
        run(&mut step, &mut last, &inputs);
        let mut rod_state = State::rest(&rod);
        settle(&rod, &mut rod_state, &inputs).expect("settles");
        let (m, r) = (observe_mesh(&model, &last), observe_rod(&rod, &rod_state));
        apart.push(
            (m.base_from_tip.translation.vector - r.base_from_tip.translation.vector).norm() * 1e3,
        );
    }
    for (name, mut t) in [
        ("cold, ms", cold),
        ("from another random state, ms", warm),
        ("after 0.5 kPa, ms", step),
        ("apart from the rod, mm", apart),
    ] {
        t.sort_by(f64::total_cmp);
        println!(
            "{name}: median {:.2}, 90 % {:.2}, most {:.2}",
            t[t.len() / 2],
            t[t.len() * 9 / 10],
            t[t.len() - 1]
        );
    }
    println!("{} iterations cold on average", iterations / 100);
}
