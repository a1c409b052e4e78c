//! Settled samples drawn over the actuator space.
//!
//! Every sample has its own generator, seeded from (seed, index), and is solved from the state of
//! rest: the order, the number of threads and the sharding do not change a single bit.

use std::ops::ControlFlow;
use std::sync::atomic::{AtomicBool, Ordering};

use rand::Rng;
use rand_pcg::Pcg64Mcg;

use nalgebra::{UnitQuaternion, Vector3};

use super::mesh::{MeshModel, MeshState, observe_mesh, settle_mesh};
use super::sensors::pads_read;
use super::{Inputs, Model, Observation, Parameters, Resolution, SimError, State, observe, settle};
use crate::robot::RobotSpec;
use crate::signal::{CHAMBERS, Dataset, Pose, SPRINGS, Sample, stream};

/// Distribution of the pressures.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Draw {
    /// So many samples, uniform in the pressure box.
    Uniform(usize),
    /// So many samples, by the arcsine density in each pressure: dense where pressures end, so that
    /// networks need not reach beyond their samples in the corners of the box.
    Arcsine(usize),
    /// Every combination of this many evenly spaced pressures per chamber (3: 729 samples).
    Grid(usize),
}

impl Draw {
    /// Number of samples.
    pub fn len(self) -> usize {
        match self {
            Self::Uniform(n) | Self::Arcsine(n) => n,
            Self::Grid(n) => n.pow(CHAMBERS as u32),
        }
    }

    /// Whether that makes none.
    pub fn is_empty(self) -> bool {
        self.len() == 0
    }
}

/// Distribution that a data set is drawn from.
#[derive(Clone, Debug, PartialEq)]
pub struct Plan {
    /// Pressures.
    pub draw: Draw,
    /// Seed of every random choice.
    pub seed: u64,
    /// Heaviest payload; drawn uniformly from 0, kg.
    pub payload_max_kg: f64,
    /// Largest standard deviation of each component of a force on the tip, N; every disturbed sample
    /// draws its own, uniformly from 0.
    pub tip_force_sd_n: f64,
    /// Relative standard deviation of the bellows' axial stiffness; areas have half, rest lengths a fifth, bending and
    /// torsional stiffness twice of it: how much arms differ from the nominal one.
    pub deviation_sd: f64,
    /// Largest standard deviation by which both pads stand off where the model has them, each as seen
    /// from the pad above: per axis of translation, m, and per axis of rotation times the radius of the
    /// springs' ends. Every disturbed sample draws its own, uniformly from 0. What no model foresees
    /// (shear, an odd bellows, a bump) looks like this to the sensors.
    pub free_pads_sd_m: f64,
    /// Standard deviation, per axis, by which both ends of every spring of a disturbed sample are attached off the
    /// drawing, m: every such sample is a specimen of its own. The stated lengths are between the real attachments.
    pub attachment_sd_m: f64,
    /// Share of the samples that get a force and a deviation; the others are the nominal arm, from
    /// which the plant is learned.
    pub disturbed_share: f64,
}

impl Plan {
    /// Unloaded samples of the nominal arm.
    pub fn nominal(draw: Draw, seed: u64) -> Self {
        Self {
            draw,
            seed,
            payload_max_kg: 0.0,
            tip_force_sd_n: 0.0,
            deviation_sd: 0.0,
            free_pads_sd_m: 0.0,
            attachment_sd_m: 0.0,
            disturbed_share: 0.5,
        }
    }
}

/// The generator of sample `index`.
pub fn sample_rng(seed: u64, index: usize) -> Pcg64Mcg {
    stream(seed, index as u64)
}

/// A standard normal deviate (Box-Muller). The shipped networks belong to samples that are drawn with it: another method
/// would draw others from the same seeds.
pub fn normal<R: Rng + ?Sized>(rng: &mut R) -> f64 {
    let u: f64 = 1.0 - rng.random::<f64>();
    let v: f64 = rng.random();
    (-2.0 * u.ln()).sqrt() * (std::f64::consts::TAU * v).cos()
}

/// Parameters scattered about the nominal arm: `sd` is the relative standard deviation of axial stiffnesses, see
/// [`Plan::deviation_sd`] for the others.
pub fn scattered(sd: f64, rng: &mut Pcg64Mcg) -> Parameters {
    let mut factor = |sd: f64| 1.0 + sd * normal(rng);
    Parameters {
        chamber_stiffness: std::array::from_fn(|_| factor(sd)),
        chamber_area: std::array::from_fn(|_| factor(0.5 * sd)),
        rest_length: std::array::from_fn(|_| factor(0.2 * sd)),
        bending: std::array::from_fn(|_| factor(2.0 * sd)),
        torsion: std::array::from_fn(|_| factor(2.0 * sd)),
        ..Parameters::default()
    }
}

/// Gauge pressures of chambers 1 to 6 for sample `index` of a draw, Pa. A grid varies chamber 1 fastest.
pub fn pressures(
    draw: Draw,
    robot: &RobotSpec,
    index: usize,
    rng: &mut Pcg64Mcg,
) -> [f64; CHAMBERS] {
    let (lo, hi) = (robot.pressure.min_pa, robot.pressure.max_pa);
    match draw {
        Draw::Uniform(_) => std::array::from_fn(|_| rng.random_range(lo..=hi)),
        Draw::Arcsine(_) => std::array::from_fn(|_| {
            let angle = std::f64::consts::PI * rng.random::<f64>();
            0.5 * (lo + hi) - 0.5 * (hi - lo) * angle.cos()
        }),
        Draw::Grid(n) => std::array::from_fn(|i| {
            let level = index / n.pow(i as u32) % n;
            lo + (hi - lo) * level as f64 / (n - 1).max(1) as f64
        }),
    }
}

/// One drawn sample.
struct Drawn {
    inputs: Inputs,
    parameters: Parameters,
    /// Per segment: the lower pad where it is, in the lower pad where the model has it.
    off: Option<[Pose; 2]>,
    /// Offsets of the upper and the lower end of every spring from the drawing, m.
    ends_off_m: Option<[[Vector3<f64>; 2]; SPRINGS]>,
}

impl Drawn {
    /// Whether the arm itself is off nominal, or its pads are displaced.
    fn is_off_nominal(&self) -> bool {
        self.off.is_some() || self.ends_off_m.is_some() || self.parameters != Parameters::default()
    }
}

/// Inputs and parameters of sample `index` of a plan.
fn drawn(robot: &RobotSpec, plan: &Plan, index: usize) -> Drawn {
    let mut rng = sample_rng(plan.seed, index);
    let chamber_pa = pressures(plan.draw, robot, index, &mut rng);
    let payload_kg = plan.payload_max_kg * rng.random::<f64>();
    let disturbed = rng.random::<f64>() < plan.disturbed_share;
    let force_sd_n = if disturbed {
        plan.tip_force_sd_n * rng.random::<f64>()
    } else {
        0.0
    };
    let tip_force_n = std::array::from_fn(|_| force_sd_n * normal(&mut rng));
    let parameters = if disturbed && plan.deviation_sd > 0.0 {
        scattered(plan.deviation_sd, &mut rng)
    } else {
        Parameters::default()
    };
    let inputs = Inputs {
        chamber_pa,
        payload_kg,
        tip_force_n,
        ..Inputs::default()
    };
    let off = (disturbed && plan.free_pads_sd_m > 0.0).then(|| {
        let sd_m = plan.free_pads_sd_m * rng.random::<f64>();
        let radius_m = robot.spring_bottom_m[0].xy().norm();
        std::array::from_fn(|_| {
            let shift = Vector3::from_fn(|_, _| sd_m * normal(&mut rng));
            let turn = Vector3::from_fn(|_, _| sd_m / radius_m * normal(&mut rng));
            Pose::from_parts(shift.into(), UnitQuaternion::from_scaled_axis(turn))
        })
    });
    let sd_m = plan.attachment_sd_m;
    let ends_off_m = (disturbed && sd_m > 0.0).then(|| {
        std::array::from_fn(|_| {
            std::array::from_fn(|_| Vector3::from_fn(|_, _| sd_m * normal(&mut rng)))
        })
    });
    Drawn {
        inputs,
        parameters,
        off,
        ends_off_m,
    }
}

fn sampled(robot: &RobotSpec, drawn: &Drawn, o: Observation) -> Sample {
    let mut pads = o.shape.base_from_pad;
    if let Some(off) = &drawn.off {
        let [top, middle, end] = pads;
        let moved = middle * off[0];
        pads = [top, moved, moved * (middle.inverse() * end) * off[1]];
    }
    let sensors = match &drawn.ends_off_m {
        None if drawn.off.is_none() => o.sensors,
        None => pads_read(robot, &pads),
        Some(ends_off_m) => {
            let mut specimen = robot.clone();
            for (i, [top, bottom]) in ends_off_m.iter().enumerate() {
                specimen.spring_top_m[i] += top;
                specimen.spring_bottom_m[i] += bottom;
            }
            pads_read(&specimen, &pads)
        }
    };
    let base_from_tip = match drawn.off {
        None => o.base_from_tip,
        Some(_) => pads[2],
    };
    Sample {
        chamber_pa: drawn.inputs.chamber_pa,
        payload_kg: drawn.inputs.payload_kg,
        tip_force_n: drawn.inputs.tip_force_n,
        off_nominal: drawn.is_off_nominal(),
        sensors,
        base_from_tip,
    }
}

/// Sample `index` of a plan, or why the model has no answer there.
///
/// # Errors
/// [`SimError`] for loads beyond what the arm can hold: no stable equilibrium, or a bellows pressed through itself.
pub fn sample(robot: &RobotSpec, plan: &Plan, index: usize) -> Result<Sample, SimError> {
    let drawn = drawn(robot, plan, index);
    let model = Model::new(robot, &drawn.parameters, Resolution::default());
    let mut state = State::rest(&model);
    settle(&model, &mut state, &drawn.inputs)?;
    Ok(sampled(robot, &drawn, observe(&model, &state)))
}

/// Sample `index` of a plan through the mesh. The mesh is the nominal arm: pressures, payload and
/// force are those of [`sample`], and so is what its pads stand off; `deviation_sd` has no effect.
///
/// # Errors
/// [`SimError::MeshUnsettled`] for loads beyond what the arm can hold.
pub fn sample_mesh(mesh: &MeshModel, plan: &Plan, index: usize) -> Result<Sample, SimError> {
    let drawn = Drawn {
        parameters: Parameters::default(),
        ..drawn(&mesh.robot, plan, index)
    };
    let mut state = MeshState::rest(mesh);
    settle_mesh(mesh, &mut state, &drawn.inputs)?;
    Ok(sampled(&mesh.robot, &drawn, observe_mesh(mesh, &state)))
}

/// Samples `range` of a plan on `threads` threads. `progress` gets how many are done and may
/// stop the run. Samples without equilibrium are left out and counted in the second result.
pub fn generate(
    robot: &RobotSpec,
    plan: &Plan,
    range: std::ops::Range<usize>,
    threads: usize,
    progress: &mut dyn FnMut(usize) -> ControlFlow<()>,
) -> (Dataset, usize) {
    let samples = parallel(range, threads, progress, &|i| sample(robot, plan, i).ok());
    collected(samples, "rod", plan, robot)
}

/// As [`generate`], through the mesh.
pub fn generate_mesh(
    mesh: &MeshModel,
    plan: &Plan,
    range: std::ops::Range<usize>,
    threads: usize,
    progress: &mut dyn FnMut(usize) -> ControlFlow<()>,
) -> (Dataset, usize) {
    let samples = parallel(range, threads, progress, &|i| {
        sample_mesh(mesh, plan, i).ok()
    });
    collected(samples, "mesh", plan, &mesh.robot)
}

fn collected(
    samples: Vec<Option<Sample>>,
    source: &str,
    plan: &Plan,
    robot: &RobotSpec,
) -> (Dataset, usize) {
    let total = samples.len();
    let kept: Vec<Sample> = samples.into_iter().flatten().collect();
    let left_out = total - kept.len();
    let data = Dataset {
        samples: kept,
        source: source.to_owned(),
        seed: plan.seed,
        robot_hash: robot.hash.clone(),
        row_s: None,
        shard: None,
    };
    (data, left_out)
}

/// Maps indices to results on several threads, in order. Stops early when `progress` breaks; the
/// result is then the longest finished prefix.
pub fn parallel<T: Send>(
    range: std::ops::Range<usize>,
    threads: usize,
    progress: &mut dyn FnMut(usize) -> ControlFlow<()>,
    work: &(dyn Fn(usize) -> T + Sync),
) -> Vec<T> {
    const BLOCK: usize = 64;
    let mut blocks: Vec<Option<Vec<T>>> = Vec::new();
    blocks.resize_with(range.len().div_ceil(BLOCK), || None);
    let stop = AtomicBool::new(false);
    // The threads end with the pool.
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(threads.max(1))
        .thread_name(|_| "data set".to_owned())
        .build()
        .expect("threads");
    let (send, receive) = std::sync::mpsc::sync_channel::<usize>(64);
    pool.in_place_scope_fifo(|scope| {
        for (b, block) in blocks.iter_mut().enumerate() {
            let (send, stop) = (send.clone(), &stop);
            let from = range.start + b * BLOCK;
            let indices = from..(from + BLOCK).min(range.end);
            scope.spawn_fifo(move |_| {
                if !stop.load(Ordering::Relaxed) {
                    let done: Vec<T> = indices.map(work).collect();
                    let count = done.len();
                    *block = Some(done);
                    // Nobody counts once `progress` has panicked.
                    let _ = send.send(count);
                }
            });
        }
        drop(send);
        let mut count = 0;
        for more in receive {
            count += more;
            if progress(count).is_break() {
                stop.store(true, Ordering::Relaxed);
            }
        }
    });
    blocks.into_iter().map_while(|b| b).flatten().collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn threads_and_shards_do_not_change_a_bit() {
        let robot = RobotSpec::reference();
        let plan = Plan {
            payload_max_kg: 0.5,
            tip_force_sd_n: 3.0,
            deviation_sd: 0.02,
            ..Plan::nominal(Draw::Uniform(150), 7)
        };
        let mut on = |_: usize| ControlFlow::Continue(());
        let (one, left_out) = generate(&robot, &plan, 0..150, 1, &mut on);
        let (two, _) = generate(&robot, &plan, 0..150, 2, &mut on);
        assert_eq!(left_out, 0);
        assert_eq!(one, two);
        let (a, _) = generate(&robot, &plan, 0..70, 2, &mut on);
        let (b, _) = generate(&robot, &plan, 70..150, 2, &mut on);
        let joined: Vec<_> = a.samples.into_iter().chain(b.samples).collect();
        assert_eq!(one.samples, joined);
        let spread = one
            .samples
            .iter()
            .map(|s| s.chamber_pa[0])
            .fold(0.0f64, |m, p| m.max(p.abs()));
        assert!(spread > 35e3);
    }

    #[test]
    fn the_mesh_answers_the_same_questions() {
        let robot = RobotSpec::reference();
        let mesh = MeshModel::new(&robot).expect("meshes");
        let plan = Plan {
            payload_max_kg: 0.3,
            ..Plan::nominal(Draw::Uniform(6), 7)
        };
        let mut on = |_: usize| ControlFlow::Continue(());
        let (rod, _) = generate(&robot, &plan, 0..6, 1, &mut on);
        let (a, left_out) = generate_mesh(&mesh, &plan, 0..6, 2, &mut on);
        assert_eq!((left_out, a.source.as_str()), (0, "mesh"));
        let (b, _) = generate_mesh(&mesh, &plan, 3..6, 1, &mut on);
        assert_eq!(a.samples[3..], b.samples[..]);
        for (r, m) in rod.samples.iter().zip(&a.samples) {
            assert_eq!(r.chamber_pa, m.chamber_pa);
            assert_eq!(r.payload_kg, m.payload_kg);
            let apart = r.base_from_tip.translation.vector - m.base_from_tip.translation.vector;
            assert!(apart.norm() < 5e-3, "{:.1} mm apart", apart.norm() * 1e3);
        }
    }

    #[test]
    fn free_pads_move_disturbed_samples_only_and_keep_signals_and_pose_of_one_arm() {
        let robot = RobotSpec::reference();
        let plan = Plan::nominal(Draw::Uniform(200), 3);
        let free = Plan {
            free_pads_sd_m: 3e-3,
            ..plan.clone()
        };
        let mut off_mm = Vec::new();
        for i in 0..200 {
            let (a, b) = (
                sample(&robot, &plan, i).expect("settles"),
                sample(&robot, &free, i).expect("settles"),
            );
            assert_eq!(a.chamber_pa, b.chamber_pa);
            let off = b.base_from_tip.translation.vector - a.base_from_tip.translation.vector;
            if off.norm() == 0.0 {
                assert_eq!(a, b);
                continue;
            }
            assert!(b.is_disturbed() && !a.is_disturbed());
            off_mm.push(off.norm() * 1e3);
            // The IMUs of the end pad say what the pose says.
            let by_imu = b.sensors.base_from_imu_pad(2);
            let by_pose = b.base_from_tip.rotation.to_rotation_matrix();
            assert!((by_imu.matrix() - by_pose.matrix()).amax() < 1e-9);
            assert_ne!(a.sensors.spring_m, b.sensors.spring_m);
        }
        assert!((70..130).contains(&off_mm.len()), "{}", off_mm.len());
        let mean = off_mm.iter().sum::<f64>() / off_mm.len() as f64;
        assert!((2.0..8.0).contains(&mean), "{mean}");
    }

    #[test]
    fn scattered_attachments_change_the_springs_of_disturbed_samples_alone() {
        let robot = RobotSpec::reference();
        let plan = Plan::nominal(Draw::Uniform(100), 3);
        let scattered = Plan {
            attachment_sd_m: 0.5e-3,
            ..plan.clone()
        };
        let (mut squares_mm2, mut n) = (0.0, 0);
        for i in 0..100 {
            let (a, b) = (
                sample(&robot, &plan, i).expect("settles"),
                sample(&robot, &scattered, i).expect("settles"),
            );
            assert_eq!(a.base_from_tip, b.base_from_tip);
            assert_eq!(a.sensors.imu_ypr_rad, b.sensors.imu_ypr_rad);
            if a != b {
                let lengths = a.sensors.spring_m.iter().zip(&b.sensors.spring_m);
                squares_mm2 += lengths.map(|(a, b)| ((a - b) * 1e3).powi(2)).sum::<f64>();
                n += SPRINGS;
            }
        }
        assert!((30 * SPRINGS..70 * SPRINGS).contains(&n), "{n}");
        // Two ends of 0.5 mm along the spring.
        let sd_mm = (squares_mm2 / n as f64).sqrt();
        assert!((0.6..0.85).contains(&sd_mm), "{sd_mm}");
    }

    #[test]
    fn the_arcsine_density_is_dense_at_the_ends() {
        let robot = RobotSpec::reference();
        let mut rng = sample_rng(5, 5);
        let near = (0..2000)
            .map(|i| pressures(Draw::Arcsine(2000), &robot, i, &mut rng))
            .filter(|p| p[2].abs() > 0.9 * robot.pressure.max_pa)
            .count();
        // 1 − (2/π) asin 0.9 = 29 %; evenly spread it would be 10 %.
        assert!((500..660).contains(&near), "{near}");
    }

    #[test]
    fn grid_visits_every_corner_once() {
        let robot = RobotSpec::reference();
        let mut rng = sample_rng(1, 1);
        let draw = Draw::Grid(3);
        let mut seen: Vec<_> = (0..draw.len())
            .map(|i| pressures(draw, &robot, i, &mut rng).map(|p| p as i64))
            .collect();
        seen.sort_unstable();
        seen.dedup();
        assert_eq!(seen.len(), 729);
        assert_eq!(seen[0], [-40_000; 6]);
    }
}
