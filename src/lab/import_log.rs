//! A log or bag of another lab becomes a session, by a map of its columns or topics.

use std::path::PathBuf;

use anyhow::{Context as _, Result};

use super::import::{COORDINATE_MAX_M, write_as};
use super::rests::FLIPPED_RAD;
use crate::recording::{BagMap, LogMap, MappedBag, MappedBodies, MappedLog, SessionLog, is_mcap};
use crate::robot::RobotSpec;
use crate::signal::Pose;

/// A pose belongs to a sample of the log that is this near, s: half of a period of slow cameras.
const NEAR_S: f64 = 0.03;
/// Clocks that are further apart than this are not brought together, s.
const SHIFT_MAX_S: f64 = 60.0;
/// Rate of the series that are correlated, Hz.
const SHIFT_HZ: f64 = 20.0;
/// Least correlation that shows how clocks lie.
const CORRELATED: f64 = 0.5;
/// Overlap of two files that shows how their clocks lie, s.
const OVERLAP_S: f64 = 10.0;

/// How the clocks of a log and of a file of motion capture lie on each other.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Shift {
    /// So many seconds are added to the times of the motion capture.
    Known(f64),
    /// That is found: where pressures change, the arm moves.
    Correlated,
}

/// What is made a session.
#[derive(Clone, Debug)]
pub struct Options {
    /// The map of columns; of topics for a bag.
    pub map: PathBuf,
    /// The log, or a bag (`.mcap`).
    pub file: PathBuf,
    /// Motion capture, where that is a file of its own, and how the clocks lie; `None`: what the log itself holds.
    pub mocap: Option<(PathBuf, Shift)>,
    /// The part that is wanted, from and to, in seconds of the log's own clock, or from the first row of a bag; `None`: all of it.
    pub window: Option<[f64; 2]>,
    /// Folder for the session.
    pub out: PathBuf,
}

/// A session that was made of a log or bag.
#[derive(Clone, Debug)]
pub struct ImportedLog {
    /// The session.
    pub log: SessionLog,
    /// What was added to the times of the motion capture, s, and how well the two agree then, where that was found.
    pub shift_s: f64,
    /// The correlation; `None` where the shift was not found by it.
    pub correlation: Option<f64>,
    /// Poses that were left out because cameras repeat them, and because the body was flipped: on base and end.
    pub left_out: [[usize; 2]; 2],
    /// What the reader should know, a sentence each.
    pub notes: Vec<String>,
}

/// Makes a session.
///
/// # Errors
/// When map or files do not read, the clocks cannot be brought together, or nothing is left; then nothing is written.
pub fn import_log(a: &Options, robot: &RobotSpec) -> Result<ImportedLog> {
    if is_mcap(&a.file) {
        anyhow::ensure!(
            a.mocap.is_none(),
            "a bag has its motion capture in itself: leave --mocap out, and name the topics of the bodies in {}",
            a.map.display()
        );
        let map = BagMap::read(&a.map).with_context(|| {
            format!(
                "{} needs a map of topics (assets/logs/ros2-bag.toml is one)",
                a.file.display()
            )
        })?;
        let MappedBag { log, notes } = map.log(&a.file)?;
        let aligned = Aligned {
            bodies: log.bodies.clone(),
            log,
            shift_s: 0.0,
            correlation: None,
            notes,
        };
        return made(a, aligned, robot);
    }
    let map = LogMap::read(&a.map)?;
    let log = map.log(&a.file)?;
    let (mut bodies, mut shift_s, mut correlation) = (log.bodies.clone(), 0.0, None);
    match (&a.mocap, map.captured_apart()) {
        (Some((path, shift)), _) => {
            bodies = map.captured(path)?;
            match *shift {
                Shift::Known(s) => shift_s = s,
                Shift::Correlated => {
                    let (s, r) = correlated(&log, &bodies)
                        .with_context(|| format!("{} and {}", a.file.display(), path.display()))?;
                    (shift_s, correlation) = (s, Some(r));
                }
            }
            bodies.t_s.iter_mut().for_each(|t| *t += shift_s);
        }
        (None, true) => anyhow::bail!(
            "{} has motion capture in a file of its own: give it with --mocap",
            a.map.display()
        ),
        (None, false) => {}
    }
    let aligned = Aligned {
        log,
        bodies,
        shift_s,
        correlation,
        notes: Vec::new(),
    };
    made(a, aligned, robot)
}

/// A log and its motion capture on one clock.
struct Aligned {
    log: MappedLog,
    bodies: MappedBodies,
    shift_s: f64,
    correlation: Option<f64>,
    notes: Vec<String>,
}

fn made(a: &Options, aligned: Aligned, robot: &RobotSpec) -> Result<ImportedLog> {
    let Aligned {
        log,
        mut bodies,
        shift_s,
        correlation,
        mut notes,
    } = aligned;
    let mut left_out = [[0; 2]; 2];
    for (k, name, left) in [(0, "base", 0), (2, "end", 1)] {
        let repeated = without_repeats(&mut bodies.poses[k]);
        let flipped = without_flips(&mut bodies.poses[k]);
        left_out[left] = [repeated, flipped];
        if flipped > 0 {
            notes.push(format!(
                "the {name} body is flipped in {flipped} poses, which are left out"
            ));
        }
    }
    if bodies.tracked[1] {
        notes.push(
            "a session has no place for the middle body: gap run --window --map reads the log itself"
                .to_owned(),
        );
    }
    let truth = end_poses(&bodies, robot, &log.t_s);
    notes.push(
        match bodies.tracked {
            [_, _, false] => "no body on the end is tracked: the session has no poses",
            [true, ..] => "poses are of the end pad in the robot's base, relative to the base body",
            _ => "no base body is tracked: poses are in the cameras' own axes",
        }
        .to_owned(),
    );
    let session = session(a, log, truth)?;
    write_as(&a.out, &session)?;
    Ok(ImportedLog {
        log: session,
        shift_s,
        correlation,
        left_out,
        notes,
    })
}

fn session(a: &Options, log: MappedLog, truth: Vec<Option<Pose>>) -> Result<SessionLog> {
    let [from_s, to_s] = a.window.unwrap_or([f64::NEG_INFINITY, f64::INFINITY]);
    let kept: Vec<usize> = (0..log.t_s.len())
        .filter(|k| (from_s..to_s).contains(&log.t_s[*k]))
        .collect();
    anyhow::ensure!(
        kept.len() > 1,
        "{} has {} samples from {from_s} to {to_s} s: its clock runs from {:.1} to {:.1} s",
        a.file.display(),
        kept.len(),
        log.t_s.first().copied().unwrap_or(f64::NAN),
        log.t_s.last().copied().unwrap_or(f64::NAN)
    );
    for (k, pose) in truth.iter().enumerate() {
        let far_m = pose.map_or(0.0, |p| p.translation.vector.amax());
        anyhow::ensure!(
            far_m <= COORDINATE_MAX_M,
            "{}: the end is {far_m:.1} m from the base at {:.2} s; a session takes {COORDINATE_MAX_M} m: check the map's unit",
            a.file.display(),
            log.t_s[k]
        );
    }
    fn of<T: Clone>(all: &[T], kept: &[usize]) -> Vec<T> {
        kept.iter().map(|k| all[*k].clone()).collect()
    }
    let t_s = of(&log.t_s, &kept);
    let mut steps: Vec<f64> = t_s.windows(2).map(|w| w[1] - w[0]).collect();
    steps.sort_by(f64::total_cmp);
    Ok(SessionLog {
        name: log.name,
        rate_hz: 1.0 / steps[steps.len() / 2],
        payload_kg: 0.0,
        chamber_pa: of(&log.gauge_pa, &kept),
        sensors: of(&log.sensors, &kept),
        truth: of(&truth, &kept),
        commanded_pa: log.commanded_pa.map(|u| of(&u, &kept)),
        payload_column_kg: log.payload_kg.map(|m| of(&m, &kept)),
        t_s,
        ..SessionLog::default()
    })
}

/// Poses of the end pad at these times: relative to the base body, where that is tracked.
fn end_poses(bodies: &MappedBodies, robot: &RobotSpec, t_s: &[f64]) -> Vec<Option<Pose>> {
    let [_, _, end] = robot.bodies;
    let mut base = None;
    let poses: Vec<Option<Pose>> = (0..bodies.t_s.len())
        .map(|k| {
            base = bodies.poses[0][k].or(base);
            let from_body = match bodies.tracked[0] {
                true => robot.base_from_captured(&base?, &bodies.poses[2][k]?),
                false => bodies.poses[2][k]?,
            };
            Some(from_body * end.inverse())
        })
        .collect();
    let seen: Vec<usize> = (0..poses.len()).filter(|k| poses[*k].is_some()).collect();
    let at = |t: &f64| {
        let next = seen.partition_point(|k| bodies.t_s[*k] < *t);
        let near = [next.checked_sub(1), Some(next)].into_iter().flatten();
        let near = near.filter_map(|i| seen.get(i));
        let off = |k: &usize| (bodies.t_s[*k] - t).abs();
        let k = near.min_by(|a, b| off(a).total_cmp(&off(b)))?;
        (off(k) <= NEAR_S).then(|| poses[*k]).flatten()
    };
    // A pose belongs to one sample: of the log's own samples to its own.
    if bodies.t_s == t_s {
        return poses;
    }
    t_s.iter().map(at).collect()
}

/// Takes out poses that are those before: cameras that are slower than the log repeat theirs. Their number.
fn without_repeats(poses: &mut [Option<Pose>]) -> usize {
    let (mut last, mut n) = (None, 0);
    for pose in poses.iter_mut().filter(|p| p.is_some()) {
        if *pose == last {
            *pose = None;
            n += 1;
        } else {
            last = *pose;
        }
    }
    n
}

/// Takes out poses of a body that is flipped: the fewer of two groups between which it jumps. Their number.
fn without_flips(poses: &mut [Option<Pose>]) -> usize {
    let (mut last, mut side) = (None::<Pose>, false);
    let sides: Vec<Option<bool>> = poses
        .iter()
        .map(|pose| {
            let pose = (*pose)?;
            let jumps = last.is_some_and(|l| l.rotation.angle_to(&pose.rotation) > FLIPPED_RAD);
            (side, last) = (side ^ jumps, Some(pose));
            Some(side)
        })
        .collect();
    let count = |s: bool| sides.iter().filter(|x| **x == Some(s)).count();
    let fewer = count(true) < count(false);
    for (pose, side) in poses.iter_mut().zip(&sides) {
        if *side == Some(fewer) {
            *pose = None;
        }
    }
    count(fewer)
}

/// What to add to the times of the motion capture, s, so that the arm moves where pressures change; and how well the two then
/// correlate.
fn correlated(log: &MappedLog, bodies: &MappedBodies) -> Result<(f64, f64)> {
    let pressures = (0..log.t_s.len()).map(|k| {
        let p = log.gauge_pa[k];
        (log.t_s[k], p.to_vec())
    });
    let [base, _, end] = &bodies.poses;
    let mut held = None;
    let places = (0..bodies.t_s.len()).filter_map(|k| {
        held = base[k].or(held);
        let end = end[k]?;
        let from_base = held.map_or(end, |base| base.inverse() * end);
        Some((
            bodies.t_s[k],
            from_base.translation.vector.as_slice().to_vec(),
        ))
    });
    let (pressure, place) = (speeds(pressures), speeds(places));
    let most = (SHIFT_MAX_S * SHIFT_HZ) as i64;
    // The two begin at different times.
    let between = ((place.0 - pressure.0) * SHIFT_HZ).round() as i64;
    let least = (OVERLAP_S * SHIFT_HZ) as usize;
    let at = |lag: i64| -> Option<f64> {
        // Sample i of the pressures meets sample i − lag − between of the places.
        let pairs: Vec<[f64; 2]> = (0..pressure.1.len())
            .filter_map(|i| {
                let j = usize::try_from(i as i64 - lag - between).ok()?;
                Some([pressure.1[i], *place.1.get(j)?])
            })
            .filter(|pair| pair.iter().all(|x| x.is_finite()))
            .collect();
        (pairs.len() >= least).then(|| correlation(&pairs))
    };
    let all = (-most..=most).filter_map(|lag| Some((lag, at(lag)?)));
    let best = all.max_by(|a, b| a.1.total_cmp(&b.1));
    let (lag, r) = best.with_context(|| {
        format!("the two have less than {OVERLAP_S} s in common, whatever their clocks")
    })?;
    anyhow::ensure!(
        r >= CORRELATED,
        "how the clocks lie does not show: the arm's motion correlates with the changes of pressure by {r:.2} at most, and {CORRELATED} is \
         needed; give the seconds with --shift"
    );
    // Between two samples: the top of a parabola.
    let fine = match (at(lag - 1), at(lag + 1)) {
        (Some(a), Some(b)) if a + b < 2.0 * r => 0.5 * (a - b) / (a - 2.0 * r + b),
        _ => 0.0,
    };
    Ok(((lag as f64 + fine) / SHIFT_HZ, r))
}

/// First time and how fast rows change, at [`SHIFT_HZ`].
fn speeds(rows: impl Iterator<Item = (f64, Vec<f64>)>) -> (f64, Vec<f64>) {
    let mut from_s = f64::NAN;
    let mut out: Vec<f64> = Vec::new();
    // The last row of each step of the grid, and its number.
    let mut last: Option<(usize, Vec<f64>)> = None;
    let mut newest: Option<(usize, Vec<f64>)> = None;
    for (t_s, row) in rows {
        if from_s.is_nan() {
            from_s = t_s;
        }
        let step = ((t_s - from_s) * SHIFT_HZ) as usize;
        if let Some((at, done)) = newest.take_if(|(at, _)| *at < step) {
            if let Some((before, values)) = &last {
                let changes = done.iter().zip(values).map(|(a, b)| (a - b).powi(2));
                let way = changes.filter(|x| x.is_finite()).sum::<f64>().sqrt();
                // Over a gap the speed is its mean.
                let steps = at - before;
                out.extend(std::iter::repeat_n(way / steps as f64, steps));
            }
            last = Some((at, done));
        }
        newest = Some((step, row));
    }
    // Over a third of a second to either side: pressures lead the arm by about so much.
    let n = (SHIFT_HZ / 3.0) as usize;
    let smooth = |k: usize| {
        let part = &out[k.saturating_sub(n)..(k + n + 1).min(out.len())];
        part.iter().sum::<f64>() / part.len() as f64
    };
    (from_s, (0..out.len()).map(smooth).collect())
}

/// Pearson's correlation.
fn correlation(pairs: &[[f64; 2]]) -> f64 {
    let n = pairs.len() as f64;
    let mean = [0, 1].map(|i| pairs.iter().map(|p| p[i]).sum::<f64>() / n);
    let both = |i: usize, j: usize| {
        let each = pairs.iter().map(|p| (p[i] - mean[i]) * (p[j] - mean[j]));
        each.sum::<f64>()
    };
    both(0, 1) / (both(0, 0) * both(1, 1)).sqrt().max(f64::MIN_POSITIVE)
}

#[cfg(test)]
mod tests {
    use nalgebra::{UnitQuaternion, Vector3};

    use super::*;
    use crate::signal::CHAMBERS;

    fn pose(z: f64, yaw_rad: f64) -> Option<Pose> {
        let turn = UnitQuaternion::from_euler_angles(0.0, 0.0, yaw_rad);
        Some(Pose::from_parts(Vector3::new(0.0, 0.0, z).into(), turn))
    }

    #[test]
    fn repeats_and_flips_are_left_out() {
        let half = std::f64::consts::PI;
        let mut poses = vec![
            pose(0.1, 0.0),
            pose(0.1, 0.0),
            pose(0.2, 0.01),
            None,
            pose(0.3, half),
            pose(0.4, half + 0.01),
            pose(0.5, 0.02),
        ];
        assert_eq!(without_repeats(&mut poses), 1);
        assert_eq!(without_flips(&mut poses), 2);
        let left: Vec<bool> = poses.iter().map(Option::is_some).collect();
        assert_eq!(left, [true, false, true, false, false, false, true]);
    }

    /// Steps of pressure at times that do not repeat, an arm that follows, cameras whose clock is 7.3 s behind.
    fn made(moves: bool) -> (MappedLog, MappedBodies) {
        let steps_s = [3.0, 8.0, 10.5, 18.0, 22.0, 31.0, 33.0, 41.0, 55.0];
        let level = |t: f64| steps_s.iter().filter(|s| **s < t).count() % 3;
        let mut log = MappedLog::default();
        for k in 0..6000 {
            let t = 0.01 * f64::from(k);
            log.t_s.push(t);
            let mut p = [0.0; CHAMBERS];
            p[2] = 1e4 * level(t) as f64;
            log.gauge_pa.push(p);
        }
        let mut bodies = MappedBodies {
            tracked: [false, false, true],
            ..MappedBodies::default()
        };
        for k in 0..3000 {
            let t = 0.02 * f64::from(k);
            bodies.t_s.push(t - 7.3);
            let z = match moves {
                true => 0.01 * level(t) as f64,
                false => 0.01 * (0.9 * t).sin(),
            };
            bodies.poses[2].push(pose(z, 0.0));
        }
        bodies.poses[0] = vec![None; 3000];
        (log, bodies)
    }

    #[test]
    fn clocks_are_brought_together_where_the_arm_follows_its_pressures() {
        let (log, bodies) = made(true);
        let (shift_s, r) = correlated(&log, &bodies).expect("they correlate");
        assert!((shift_s - 7.3).abs() < 0.06 && r > 0.9, "{shift_s} {r}");
        let (log, bodies) = made(false);
        let refused = correlated(&log, &bodies)
            .expect_err("they do not")
            .to_string();
        assert!(refused.contains("--shift"), "{refused}");
    }
}
