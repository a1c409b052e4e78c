//! Poses and streams of an arm that is made up, with known frames.

use nalgebra::{UnitQuaternion, Vector3};
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64;

use super::{Frames, Noise, PosePair};
use crate::signal::Pose;

/// 0.1 mm and 0.05 degrees.
pub const NOISE: Noise = Noise {
    position_m: 1e-4,
    rotation_rad: 0.05 * std::f64::consts::PI / 180.0,
};

pub fn generator(seed: u64) -> Pcg64 {
    Pcg64::seed_from_u64(seed)
}

fn normal(g: &mut Pcg64) -> f64 {
    let (u, v): (f64, f64) = (1.0 - g.random::<f64>(), g.random());
    (-2.0 * u.ln()).sqrt() * (std::f64::consts::TAU * v).cos()
}

fn normals(g: &mut Pcg64) -> Vector3<f64> {
    Vector3::from_fn(|_, _| normal(g))
}

fn within(g: &mut Pcg64, bound: f64) -> f64 {
    g.random_range(-bound..=bound)
}

/// Any rotation, every third one half a turn but for a thousandth.
pub fn frames(seed: u64) -> Frames {
    let mut g = generator(seed ^ 0xf4a3);
    let turn = |g: &mut Pcg64| {
        let axis = normals(g).normalize();
        let angle = match seed % 3 {
            0 => std::f64::consts::PI - 1e-3,
            _ => g.random_range(0.0..std::f64::consts::PI),
        };
        UnitQuaternion::from_scaled_axis(axis * angle)
    };
    let (x, y) = (turn(&mut g), turn(&mut g));
    Frames {
        base_from_world: Pose::from_parts(Vector3::from_fn(|_, _| within(&mut g, 2.0)).into(), x),
        object_from_tip: Pose::from_parts(Vector3::from_fn(|_, _| within(&mut g, 0.06)).into(), y),
    }
}

/// A tip about (0, 0, −0.3) m, tilted up to 45 degrees about a horizontal axis.
pub fn tip(g: &mut Pcg64) -> Pose {
    let about = within(g, std::f64::consts::PI);
    let tilt = within(g, std::f64::consts::FRAC_PI_4);
    let axis = Vector3::new(about.cos(), about.sin(), 0.0);
    let place = Vector3::new(within(g, 0.15), within(g, 0.15), -0.3 + within(g, 0.1));
    let yaw = UnitQuaternion::from_scaled_axis(Vector3::z() * within(g, 0.1));
    Pose::from_parts(
        place.into(),
        UnitQuaternion::from_scaled_axis(axis * tilt) * yaw,
    )
}

/// The object that a tip belongs to.
pub fn object(frames: &Frames, base_from_tip: &Pose) -> Pose {
    frames.base_from_world.inverse() * base_from_tip * frames.object_from_tip.inverse()
}

/// A pose with noise: position, then rotation in the parent frame.
pub fn noisy(g: &mut Pcg64, pose: &Pose, noise: &Noise) -> Pose {
    let mut out = *pose;
    out.translation.vector += normals(g) * noise.position_m;
    out.rotation = UnitQuaternion::from_scaled_axis(normals(g) * noise.rotation_rad) * out.rotation;
    out
}

/// Pairs at `tips`, both sides with noise of `scale` times [`NOISE`].
pub fn pairs(g: &mut Pcg64, frames: &Frames, tips: &[Pose], scale: f64) -> Vec<PosePair> {
    let noise = Noise {
        position_m: NOISE.position_m * scale,
        rotation_rad: NOISE.rotation_rad * scale,
    };
    tips.iter()
        .map(|b| PosePair {
            base_from_tip: noisy(g, b, &noise),
            world_from_object: noisy(g, &object(frames, b), &noise),
        })
        .collect()
}

/// How the tip moves.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Way {
    /// Five sines that do not repeat within the hour, phases by the seed, at `speed` times the
    /// usual 50 mm/s.
    Wandering { seed: u64, speed: f64 },
    /// The same every four seconds.
    Periodic,
    /// Nowhere.
    Still,
}

/// The tip at a time of the robot's clock.
pub fn moving_tip(way: Way, t_s: f64) -> Pose {
    let wave = |channel: usize| match way {
        Way::Still => 0.3,
        Way::Periodic => (std::f64::consts::TAU * t_s / 4.0 + channel as f64).sin(),
        Way::Wandering { seed, speed } => {
            let mut g = generator(seed * 8 + channel as u64);
            let sum: f64 = (0..5)
                .map(|k| {
                    let hz = speed * (0.03 + 0.07 * f64::from(k) + 0.05 * g.random::<f64>());
                    let phase = std::f64::consts::TAU * g.random::<f64>();
                    (std::f64::consts::TAU * hz * t_s + phase).sin()
                })
                .sum();
            sum / 5.0
        }
    };
    let place = Vector3::new(0.15 * wave(0), 0.15 * wave(1), -0.3 + 0.08 * wave(2));
    let turn = Vector3::new(0.7 * wave(3), 0.7 * wave(4), 0.1 * wave(5));
    Pose::from_parts(place.into(), UnitQuaternion::from_scaled_axis(turn))
}

pub type RobotStream = Vec<(f64, Pose)>;
pub type MocapStream = Vec<(f64, Option<Pose>)>;

/// The robot at 100 Hz with 1 ms of jitter, motion capture at 200 Hz with gaps, its clock behind the
/// robot's by `offset_s`.
pub fn streams(
    seed: u64,
    frames: &Frames,
    way: Way,
    seconds: f64,
    offset_s: f64,
) -> (RobotStream, MocapStream) {
    let mut g = generator(seed ^ 0x57e4);
    let robot = (0..(100.0 * seconds) as usize)
        .map(|k| {
            let t_s = 0.01 * k as f64 + within(&mut g, 1e-3);
            (t_s, noisy(&mut g, &moving_tip(way, t_s), &NOISE))
        })
        .collect();
    let mut gap_until_s = 0.0;
    let mocap = (0..(200.0 * seconds) as usize)
        .map(|k| {
            let t_s = 0.005 * k as f64;
            // A gap of up to two seconds about every ten; single frames are lost now and then.
            if g.random::<f64>() < 0.1 * 0.005 {
                gap_until_s = t_s + 2.0 * g.random::<f64>();
            }
            let seen = t_s >= gap_until_s && g.random::<f64>() > 0.02;
            let tip = moving_tip(way, t_s + offset_s);
            let object = noisy(&mut g, &object(frames, &tip), &NOISE);
            (t_s, seen.then_some(object))
        })
        .collect();
    (robot, mocap)
}
