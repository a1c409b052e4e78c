//! Rests of an arm: means of steady windows of sessions and of other labs' logs.

use std::path::{Path, PathBuf};

use anyhow::Result;

use super::actuation::is_asu_arm;
use crate::gap::Rest;
use crate::recording::{self, AsuArmLog, LogMap, MappedLog};
use crate::robot::RobotSpec;
use crate::signal::{CHAMBERS, Pose, pose_error};

/// A window is steady where the mean of no pressure moves by more from its first to its last third, Pa: a regulator may hunt
/// about it.
const STEADY_PA: f64 = 3e3;
/// Fewest samples of a window.
const SAMPLES_MIN: usize = 10;
/// A body that turns by more from one sample to the next has flipped, rad.
pub(super) const FLIPPED_RAD: f64 = 1.5;

/// At rest a body that is further from the middle of its poses is another one, or a mismatch of markers, m.
const JUMPED_M: f64 = 0.03;
/// A pose that stays the same for longer is the last one of a body that is no longer tracked, s.
const STALE_S: f64 = 0.5;
/// Poses that move by less than this from one to the next are not rounded coarsely, m.
const RESOLVED_M: f64 = 5e-5;

/// A span of a session's own clock, from and to, s.
pub type Window = [f64; 2];

/// The steady window of every session. With a `map` they are logs whose columns it knows; with `None`, logs of the ASU arm
/// are known by their 38 columns.
///
/// # Errors
/// When a file cannot be read, or the window is not steady or too short; the error names it.
pub fn read_rests(
    robot: &RobotSpec,
    paths: &[PathBuf],
    window: Window,
    map: Option<&LogMap>,
) -> Result<Vec<Rest>> {
    paths
        .iter()
        .map(|path| read_rest(robot, path, window, map))
        .collect()
}

fn read_rest(robot: &RobotSpec, path: &Path, window: Window, map: Option<&LogMap>) -> Result<Rest> {
    let samples = match map {
        Some(map) if map.captured_apart() => anyhow::bail!(
            "{}: the map has motion capture in a file of its own, which is not read with a window: make a session of the two with import log",
            path.display()
        ),
        Some(map) => of_mapped(robot, map.log(path)?),
        None if is_asu_arm(path)? => of_asu(robot, &recording::read_asu_arm(path)?),
        None => of_session(path)?,
    };
    samples.mean(window)
}

/// A session sample by sample.
struct Samples {
    name: String,
    hash: String,
    payload_kg: f64,
    t_s: Vec<f64>,
    gauge_pa: Vec<[f64; CHAMBERS]>,
    bodies: [Vec<Option<Pose>>; 2],
    on_base: bool,
}

/// A log of the ASU arm with its bodies in the base frame.
fn of_asu(robot: &RobotSpec, log: &AsuArmLog) -> Samples {
    let body = |k: usize| -> Vec<Option<Pose>> {
        let poses = tracked(&log.t_s, log.bodies.iter().map(|b| b[k]).collect());
        let rows = log.bodies.iter().zip(poses);
        rows.map(|(b, pose)| Some(robot.base_from_captured(&b[0]?, &pose?)))
            .collect()
    };
    Samples {
        name: log.name.clone(),
        hash: log.hash.clone(),
        payload_kg: 0.0,
        t_s: log.t_s.clone(),
        gauge_pa: log.measured_pa.clone(),
        bodies: [body(1), body(2)],
        on_base: true,
    }
}

/// A log of another lab with its bodies in the base frame, where one on the base is tracked.
fn of_mapped(robot: &RobotSpec, log: MappedLog) -> Samples {
    let [base, middle, end] = log.bodies.poses;
    let on_base = log.bodies.tracked[0];
    let body = |poses: Vec<Option<Pose>>| -> Vec<Option<Pose>> {
        let rows = base.iter().zip(tracked(&log.t_s, poses));
        rows.map(|(base, pose)| match on_base {
            true => Some(robot.base_from_captured(&(*base)?, &pose?)),
            false => pose,
        })
        .collect()
    };
    Samples {
        name: log.name,
        hash: log.hash,
        payload_kg: 0.0,
        bodies: [body(middle), body(end)],
        on_base,
        t_s: log.t_s,
        gauge_pa: log.gauge_pa,
    }
}

fn of_session(path: &Path) -> Result<Samples> {
    let log = recording::read_log(path)?;
    Ok(Samples {
        name: log.name,
        hash: log.hash,
        payload_kg: log.payload_kg,
        bodies: [vec![None; log.t_s.len()], tracked(&log.t_s, log.truth)],
        on_base: false,
        t_s: log.t_s,
        gauge_pa: log.chamber_pa,
    })
}

/// Poses without those of a body that was not tracked: its last pose repeats to the last digit for longer than slow cameras repeat
/// theirs. A log that rounds its poses coarsely shows no difference, and stays as it is.
fn tracked(t_s: &[f64], mut poses: Vec<Option<Pose>>) -> Vec<Option<Pose>> {
    let steps_m = poses.windows(2).filter_map(|w| {
        let [a, b] = [w[0]?, w[1]?];
        let step_m = (b.translation.vector - a.translation.vector).norm();
        (step_m > 0.0).then_some(step_m)
    });
    if steps_m.fold(f64::INFINITY, f64::min) > RESOLVED_M {
        return poses;
    }
    let mut first = 0;
    for k in 1..=poses.len() {
        if k < poses.len() && poses[k] == poses[first] {
            continue;
        }
        if poses[first].is_some() && t_s[k - 1] - t_s[first] > STALE_S {
            poses[first + 1..k].fill(None);
        }
        first = k;
    }
    poses
}

impl Samples {
    fn mean(&self, window: Window) -> Result<Rest> {
        let [from_s, to_s] = window;
        let within: Vec<usize> = (0..self.t_s.len())
            .filter(|k| (from_s..to_s).contains(&self.t_s[*k]))
            .collect();
        anyhow::ensure!(
            within.len() >= SAMPLES_MIN,
            "{} has {} samples from {from_s} to {to_s} s, and {SAMPLES_MIN} are needed: its clock runs from {:.1} to {:.1} s",
            self.name,
            within.len(),
            self.t_s.first().copied().unwrap_or(f64::NAN),
            self.t_s.last().copied().unwrap_or(f64::NAN)
        );
        let mut gauge_pa = [0.0; CHAMBERS];
        for (i, mean) in gauge_pa.iter_mut().enumerate() {
            let known = within.iter().map(|k| self.gauge_pa[*k][i]);
            let known: Vec<f64> = known.filter(|p| p.is_finite()).collect();
            anyhow::ensure!(
                !known.is_empty(),
                "{} has no pressure of chamber {} from {from_s} to {to_s} s",
                self.name,
                i + 1
            );
            let mean_of = |part: &[f64]| part.iter().sum::<f64>() / part.len() as f64;
            let third = known.len().div_ceil(3);
            let moves = (mean_of(&known[known.len() - third..]) - mean_of(&known[..third])).abs();
            anyhow::ensure!(
                moves <= STEADY_PA,
                "{} is not at rest from {from_s} to {to_s} s: the pressure of chamber {} moves by {:.1} kPa, and a rest by {:.1} \
                 at most; choose a steady window",
                self.name,
                i + 1,
                moves * 1e-3,
                STEADY_PA * 1e-3
            );
            *mean = mean_of(&known);
        }
        let mut bodies = [None; 2];
        for ((k, mean), body) in bodies.iter_mut().enumerate().zip(&self.bodies) {
            let poses: Vec<Pose> = within.iter().filter_map(|k| body[*k]).collect();
            let name = ["middle", "end"][k];
            let left_out = |what: &str| {
                log::warn!(
                    "{}: the {name} body {what} from {from_s} to {to_s} s",
                    self.name
                );
            };
            if poses.is_empty() && body.iter().any(Option::is_some) {
                left_out("was not tracked");
            }
            *mean = mean_pose(poses, &left_out);
        }
        Ok(Rest {
            session: self.name.clone(),
            hash: self.hash.clone(),
            gauge_pa,
            payload_kg: self.payload_kg,
            bodies,
            on_base: self.on_base,
        })
    }
}

/// Mean of the poses that differ from the one before: cameras that are slower than the log repeat theirs. Poses that are turned away
/// or far from the middle one are left out, and `left_out` is called with what.
fn mean_pose(mut all: Vec<Pose>, left_out: &dyn Fn(&str)) -> Option<Pose> {
    all.dedup();
    let alike = |p: &Pose, q: &Pose| {
        let off_m = (p.translation.vector - q.translation.vector).norm();
        p.rotation.angle_to(&q.rotation) < FLIPPED_RAD && off_m < JUMPED_M
    };
    // The one with most others near it.
    let near = |p: &Pose| all.iter().filter(|q| alike(p, q)).count();
    let stride = all.len().div_ceil(50).max(1);
    let typical = *all.iter().step_by(stride).max_by_key(|p| near(p))?;
    let (kept, off): (Vec<Pose>, Vec<Pose>) = all.iter().partition(|p| alike(p, &typical));
    if !off.is_empty() {
        left_out(&format!(
            "is flipped or elsewhere in {} of {} poses, which are left out,",
            off.len(),
            all.len()
        ));
    }
    let sum = kept
        .iter()
        .map(|p| pose_error(p, &typical))
        .fold(crate::signal::Vector6::zeros(), |a, b| a + b);
    let mean = sum / kept.len() as f64;
    let turn = nalgebra::UnitQuaternion::from_scaled_axis(mean.fixed_rows::<3>(3).into_owned());
    Some(Pose::from_parts(
        (typical.translation.vector + mean.fixed_rows::<3>(0)).into(),
        turn * typical.rotation,
    ))
}

#[cfg(test)]
mod tests {
    use nalgebra::{UnitQuaternion, Vector3};

    use super::*;

    #[test]
    fn a_map_with_motion_capture_apart_is_refused() {
        let map = "[time]\ncolumn = 1\nunit = \"s\"\n[pressure]\ncolumns = [2, 0, 0, 0, 0, 0]\nunit = \"kPa\"\n\
                   [mocap.time]\ncolumn = 1\nunit = \"s\"\n[mocap.bodies]\n";
        let map = LogMap::from_toml(map).expect("a map");
        let robot = RobotSpec::reference();
        let read = read_rests(&robot, &["log.csv".into()], [0.0, 1.0], Some(&map));
        let refused = read.expect_err("two files").to_string();
        assert!(refused.contains("import log"), "{refused}");
    }

    fn samples(moves_pa: f64) -> Samples {
        let n = 100;
        let pose = |k: usize| {
            let flip = if k == 40 { std::f64::consts::PI } else { 0.0 };
            // Cameras at half the rate of the log.
            let z = -0.3 + 1e-3 * ((k / 2) % 2) as f64;
            Pose::from_parts(
                Vector3::new(0.0, 0.01, z).into(),
                UnitQuaternion::from_euler_angles(0.0, 0.2 + flip, 0.0),
            )
        };
        Samples {
            name: "s".to_owned(),
            hash: String::new(),
            payload_kg: 0.0,
            t_s: (0..n).map(|k| 0.1 * k as f64).collect(),
            gauge_pa: (0..n)
                .map(|k| [moves_pa * k as f64 / n as f64; CHAMBERS])
                .collect(),
            bodies: [vec![None; n], (0..n).map(|k| Some(pose(k))).collect()],
            on_base: false,
        }
    }

    #[test]
    fn a_rest_is_the_mean_of_a_steady_window_without_flips() {
        let rest = samples(1e3).mean([2.0, 8.0]).expect("steady");
        assert!(
            (rest.gauge_pa[0] - 495.0).abs() < 10.0,
            "{:?}",
            rest.gauge_pa
        );
        let end = rest.bodies[1].expect("captured");
        assert!((end.translation.vector.z + 0.2995).abs() < 5e-5, "{end}");
        assert!((end.rotation.angle() - 0.2).abs() < 1e-9);
        assert_eq!(rest.bodies[0], None);
    }

    #[test]
    fn a_body_that_jumps_counts_where_it_is_most_of_the_time_and_one_that_is_not_tracked_not_at_all()
     {
        let mut s = samples(0.0);
        for pose in s.bodies[1][60..75].iter_mut().flatten() {
            pose.translation.vector.x += 0.2;
        }
        let at = s.mean([2.0, 8.0]).expect("steady").bodies[1].expect("captured");
        assert!(at.translation.vector.x.abs() < 1e-9, "{at}");
        // Cameras resolve micrometres.
        for (k, pose) in s.bodies[1].iter_mut().flatten().enumerate() {
            pose.translation.vector.z += 2e-6 * k as f64;
        }
        let last = s.bodies[1][10];
        s.bodies[1][10..].fill(last);
        let [_, end] = s.bodies;
        s.bodies = [vec![None; end.len()], tracked(&s.t_s, end)];
        let lost = s.mean([2.0, 8.0]).expect("steady");
        assert_eq!(lost.bodies[1], None);
    }

    #[test]
    fn what_is_not_at_rest_is_refused() {
        let refused = |s: Samples, window| s.mean(window).expect_err("refused").to_string();
        let text = refused(samples(20e3), [0.0, 10.0]);
        assert!(text.contains("chamber 1 moves by"), "{text}");
        let text = refused(samples(0.0), [20.0, 30.0]);
        assert!(text.contains("0 samples from 20 to 30 s"), "{text}");
    }
}
