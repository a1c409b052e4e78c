//! The paths that run every tick, or for every sample of a dataset.

#![allow(missing_docs)]

#[cfg(all(feature = "gui", feature = "rrd"))]
#[path = "window/frame.rs"]
mod frame;
#[cfg(all(feature = "gui", feature = "rrd"))]
#[path = "window/session.rs"]
mod session;

use std::hint::black_box;

use criterion::{Criterion, criterion_group, criterion_main};
use springtwin::control::{Controller, Gains, InitialGuess, Maps, Resolve, StartSample, StepInput};
use springtwin::lab::motions::{Arm, Motion, each_sent};
use springtwin::learn::{Model as Networks, PoseMap};
use springtwin::rig::{RigOptions, Unit, VirtualRig};
use springtwin::robot::RobotSpec;
use springtwin::sensing::{Calibration, Sensing};
use springtwin::signal::{
    CHAMBERS, ChannelHealth, ControllerKind, Goal, Health, SIGNALS, SPRINGS, SensorFrame, Stamp,
};
use springtwin::sim::mesh::{MeshModel, MeshState, observe_mesh, settle_mesh};
use springtwin::sim::{Inputs, Model, State, observe, sensitivity, settle, step_dynamics};

const NETWORKS: &[u8] = include_bytes!("../assets/networks/reference.safetensors");

/// As the program's.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

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
        let mut state = State::rest(&model);
        b.iter(|| {
            k += 1;
            let inputs = Inputs {
                chamber_pa: pressures(k),
                payload_kg: 0.3,
                ..Inputs::default()
            };
            step_dynamics(&model, &mut state, black_box(&inputs), 0.02, 1e-3).map(|o| o.iterations)
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
            b.iter(|| {
                step_dynamics(&model, &mut state, black_box(&rest), tau_s, 1e-3)
                    .map(|o| o.iterations)
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
        .map(StartSample::from)
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

/// One tick of each controller on a fresh frame: the paper's with its descent, ours with its quadratic programme.
fn controllers(c: &mut Criterion) {
    let robot = RobotSpec::reference();
    let Ok(networks) = Networks::from_bytes(NETWORKS) else {
        unreachable!("the shipped networks load: a test checks it");
    };
    let model = Model::nominal(&robot);
    let observation = observe(&model, &State::rest(&model));
    let maps = Maps {
        pose: &networks.cascade,
        plant: &networks.plant,
        samples: &[],
    };
    let eval = networks.cascade.pose(&observation.sensors.to_vector());
    for (name, kind) in [
        ("controller, ours, one tick", ControllerKind::NullSpaceQp),
        ("controller, paper's, one target", ControllerKind::PaperAdrc),
    ] {
        let gains = Gains {
            resolve: Resolve::Every(0.0),
            guess: InitialGuess::Present,
            ..Gains::of(kind)
        };
        let mut controller = Controller::new(&robot, gains);
        controller.set_goal(Goal::position([0.06, 0.04, -0.30]), None);
        let mut frame = SensorFrame {
            stamp: Stamp::ZERO,
            extra_sigma: [0.0; SIGNALS],
            delivered: Default::default(),
            sensors: observation.sensors.clone(),
            chamber_pa: [0.0; CHAMBERS],
            health: Health {
                springs: [ChannelHealth::Ok; SPRINGS],
                ..Health::default()
            },
            quality: Default::default(),
        };
        c.bench_function(name, |b| {
            b.iter(|| {
                frame.stamp = frame.stamp.plus(0.01);
                let input = StepInput {
                    frame: &frame,
                    eval: &eval,
                    payload_kg: 0.0,
                    previous: None,
                    stamp: frame.stamp,
                };
                controller.step(black_box(maps), &input).wanted_pa
            });
        });
    }
}

/// A frame of each screen with ten minutes at 1 kHz behind it and 1 kHz coming in, all of it in the plots.
#[cfg(all(feature = "gui", feature = "rrd"))]
fn frames(c: &mut Criterion) {
    use std::cell::OnceCell;
    use std::cell::RefCell;
    use std::time::Duration;
    const ROWS: u64 = 600_000;
    let window = OnceCell::new();
    let mut group = c.benchmark_group("frame");
    group.sample_size(10);
    for (screen, name) in frame::screens() {
        for span_s in [30.0, 600.0] {
            let mut worst = frame::Cost::default();
            let mut sum = [Duration::ZERO; 2];
            let mut count = 0;
            group.bench_function(format!("{name}, {span_s:.0} s"), |b| {
                b.iter_custom(|iters| {
                    let window = window.get_or_init(|| RefCell::new(frame::Window::new(ROWS)));
                    let mut window = window.borrow_mut();
                    window.app.screen = screen;
                    window.app.window.span_s = span_s;
                    let mut total = Duration::ZERO;
                    for _ in 0..iters {
                        window.publish(16);
                        let cost = window.frame();
                        total += cost.total();
                        sum[0] += cost.layout;
                        sum[1] += cost.tessellation;
                        count += 1;
                        if cost.total() > worst.total() {
                            worst = cost;
                        }
                    }
                    total
                });
            });
            if count > 0 {
                println!(
                    "mean layout {:?}, mean tessellation {:?}, worst {worst:?}",
                    sum[0] / count,
                    sum[1] / count
                );
            }
        }
    }
    group.finish();
}

/// Nothing: the window is not built.
#[cfg(not(all(feature = "gui", feature = "rrd")))]
fn frames(_: &mut Criterion) {}

/// A step of the virtual rig: physics with everything on, circuits, inertial sensors, boards' readings.
fn rig(c: &mut Criterion) {
    let options = RigOptions::default();
    c.bench_function("the virtual rig, 10 ms step, driven", |b| {
        let mut k = 0;
        let made = VirtualRig::new(&RobotSpec::reference(), &options);
        let Ok(mut rig) = made else {
            unreachable!("the reference arm carries itself");
        };
        b.iter(|| {
            k += 1;
            rig.step(&pressures(k).map(Some));
            rig.readings()[0].chamber_pa
        });
        assert_eq!(rig.refused_steps, 0);
    });
}

/// A frame through the sensing: lengths, estimator, verdicts. At most 150 us.
fn sensing(c: &mut Criterion) {
    let robot = RobotSpec::reference();
    let mut frames = Vec::new();
    let motion = Motion::of(Unit(1), 20.0, 7);
    let made = each_sent(&robot, &motion, &Arm::of_rings(2), &mut |sent| {
        frames.push(sent.raw);
    });
    assert!(made.is_ok(), "the reference arm follows its motion");
    let mut sensing = Sensing::new(&robot, Calibration::virtual_rig());
    c.bench_function("a frame through the sensing, moving", |b| {
        let mut k = 0;
        b.iter(|| {
            if k == frames.len() {
                sensing.reset();
                k = 0;
            }
            k += 1;
            sensing.update(black_box(&frames[k - 1])).sensors.spring_m[0]
        });
    });
}

criterion_group!(
    benches,
    sensing,
    frames,
    controllers,
    rod,
    derivatives,
    dynamics,
    rig,
    mesh,
    networks
);
criterion_main!(benches);
