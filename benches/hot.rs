//! The paths that run every tick, or for every sample of a dataset.

#![allow(missing_docs)]

use std::hint::black_box;

use criterion::{Criterion, criterion_group, criterion_main};
use springtwin::learn::{Model as Networks, PoseMap};
use springtwin::robot::RobotSpec;
use springtwin::signal::Goal;
use springtwin::sim::mesh::{MeshModel, MeshState, observe_mesh, settle_mesh};
use springtwin::sim::{Inputs, Model, Moving, State, observe, sensitivity, settle, swing};

const NETWORKS: &[u8] = include_bytes!("../assets/networks/reference.safetensors");

fn pressures(k: usize) -> [f64; 6] {
    std::array::from_fn(|i| 30e3 * ((k * (i + 3)) as f64 * 0.002).sin())
}

fn rod(c: &mut Criterion) {
    let model = Model::nominal(&RobotSpec::reference());
    c.bench_function("rod statics, cold", |b| {
        let mut k = 0;
        b.iter(|| {
            k += 101;
            let mut state = State::rest(&model);
            let inputs = Inputs {
                chamber_pa: pressures(k),
                ..Inputs::default()
            };
            settle(&model, &mut state, black_box(&inputs)).map(|o| o.iterations)
        });
    });
    c.bench_function("rod statics, warm (0.4 % steps)", |b| {
        let mut k = 0;
        let mut state = State::rest(&model);
        b.iter(|| {
            k += 1;
            let inputs = Inputs {
                chamber_pa: pressures(k),
                ..Inputs::default()
            };
            settle(&model, &mut state, black_box(&inputs)).map(|o| o.iterations)
        });
    });
}

fn derivatives(c: &mut Criterion) {
    let model = Model::nominal(&RobotSpec::reference());
    let mut state = State::rest(&model);
    let inputs = Inputs {
        chamber_pa: pressures(700),
        ..Inputs::default()
    };
    if settle(&model, &mut state, &inputs).is_err() {
        unreachable!("the pressures are in the box");
    }
    c.bench_function("rod sensitivity, 24 x 10", |b| {
        b.iter(|| sensitivity(&model, black_box(&state), &inputs).map(|s| s.tip));
    });
}

fn mesh(c: &mut Criterion) {
    let Ok(model) = MeshModel::new(&RobotSpec::reference()) else {
        unreachable!("the reference robot meshes: a test checks it");
    };
    let mut group = c.benchmark_group("mesh");
    group.sample_size(20);
    // Steps as between neighbouring samples of a path: each starts where the last one ended.
    group.bench_function("mesh sample, warm (0.4 % steps)", |b| {
        let mut k = 0;
        let mut state = MeshState::rest(&model);
        b.iter(|| {
            k += 1;
            let inputs = Inputs {
                chamber_pa: pressures(k),
                ..Inputs::default()
            };
            settle_mesh(&model, &mut state, black_box(&inputs))
                .map(|_| observe_mesh(&model, &state).base_from_tip)
        });
    });
    group.bench_function("mesh sample, cold", |b| {
        let mut k = 0;
        b.iter(|| {
            k += 101;
            let mut state = MeshState::rest(&model);
            let inputs = Inputs {
                chamber_pa: pressures(k),
                ..Inputs::default()
            };
            settle_mesh(&model, &mut state, black_box(&inputs))
                .map(|_| observe_mesh(&model, &state).base_from_tip)
        });
    });
    group.finish();
}

fn dynamics(c: &mut Criterion) {
    let model = Model::nominal(&RobotSpec::reference());
    c.bench_function("dynamics, 1 kHz step, driven", |b| {
        let mut k = 0;
        let mut moving = Moving::from_rest(&State::rest(&model));
        b.iter(|| {
            k += 1;
            let inputs = Inputs {
                chamber_pa: pressures(k),
                payload_kg: 0.3,
                ..Inputs::default()
            };
            swing(&model, &mut moving, black_box(&inputs), 0.02, 1e-3).map(|o| o.iterations)
        });
    });
    for (name, tau_s) in [
        ("dynamics, 1 kHz step, let go", 0.02),
        ("dynamics, 1 kHz step, let go, undamped", 0.0),
    ] {
        c.bench_function(name, |b| {
            let mut state = State::rest(&model);
            let bent = Inputs {
                chamber_pa: pressures(300),
                ..Inputs::default()
            };
            assert!(settle(&model, &mut state, &bent).is_ok());
            let rest = Inputs::default();
            let mut moving = Moving::from_rest(&state);
            b.iter(|| {
                swing(&model, &mut moving, black_box(&rest), tau_s, 1e-3).map(|o| o.iterations)
            });
        });
    }
}

fn networks(c: &mut Criterion) {
    let robot = RobotSpec::reference();
    let Ok(networks) = Networks::from_bytes(NETWORKS) else {
        unreachable!("the shipped networks load: a test checks it");
    };
    let model = Model::nominal(&robot);
    let sensors = observe(&model, &State::rest(&model)).sensors.to_vector();
    c.bench_function("pose, 6 x 24 Jacobian and covariance", |b| {
        b.iter(|| networks.cascade.pose(black_box(&sensors)).pose);
    });
    let seeds: Vec<_> = networks
        .guess
        .samples()
        .iter()
        .map(|s| {
            (
                s.chamber_pa.map(f64::from),
                [0, 1, 2].map(|k| f64::from(s.pose[k])),
            )
        })
        .collect();
    for (name, position_m) in [
        ("reach, reachable", [0.06, 0.04, -0.30]),
        ("reach, unreachable", [0.40, 0.0, -0.10]),
    ] {
        let goal = Goal::position(position_m);
        c.bench_function(name, |b| {
            b.iter(|| {
                springtwin::control::reach(
                    black_box(&goal),
                    &robot,
                    &networks.cascade,
                    &networks.plant,
                    0.0,
                    &seeds,
                    &springtwin::control::ReachConfig::default(),
                )
                .map(|r| r.distance_m)
            });
        });
    }
}

criterion_group!(benches, rod, derivatives, dynamics, mesh, networks);
criterion_main!(benches);
