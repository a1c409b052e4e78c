//! Health of the channels: which readings are plausible.
//!
//! Six lengths fix a segment's pose exactly, so springs alone can never contradict each other; the
//! IMUs can. The monitor follows the discrepancy d between the rotation across a segment by the
//! springs and by the IMUs:
//!
//! d = log(R_springs R_imuᵀ) ≈ G e, with e the errors of the six lengths and G the rotation rows of
//! the platform's inverse Jacobian (3 × 6).
//!
//! A single faulty spring i moves d along its own column g_i by e_i = g_iᵀ Δd / |g_i|². Constant
//! parts (IMU mounting, calibration) sit in a baseline and do not count.
//!
//! - A spring whose counts repeat exactly while d shows that it should have moved is stuck.
//! - A spring whose column explains a jump of d is suspect, and stuck when it did not move itself.

use std::collections::VecDeque;

use nalgebra::{UnitQuaternion, Vector3};

use super::platform::{LEGS, RotationPerLength};
use crate::signal::{ChannelHealth, ImuRaw};

/// Smoothing of the discrepancy, s.
const SMOOTH_S: f64 = 0.05;
/// Time constant of the baseline, s.
const BASELINE_S: f64 = 5.0;
/// The baseline is learned at once for this long after the start, s.
const WARM_UP_S: f64 = 2.0;
/// A run of equal counts becomes worth watching after this long, s.
const RUN_START_S: f64 = 0.08;
/// ... and can be called stuck after this long, s.
const RUN_STUCK_S: f64 = 0.2;
/// Motion that a spring with equal counts must have missed, m.
const MISSED_M: f64 = 0.25e-3;
/// The same without IMUs: how far the other springs moved at the median, m.
const OTHERS_MOVED_M: f64 = 1.0e-3;
/// Discrepancy beyond the baseline that calls for a culprit, rad.
const JUMP_RAD: f64 = 0.014;
/// A jump must last this long, s.
const JUMP_S: f64 = 0.1;
/// Smallest cosine between one column and the jump that explains it.
const BLAME_COS: f64 = 0.95;
/// Pads turning faster than this are not judged: the springs lag behind, rad/s.
pub const JUDGED_RATE_RAD_S: f64 = 0.35;
/// Own motion of a spring is looked at over this long, s.
const WINDOW_S: f64 = 0.6;
/// A flag goes when all has been well for this long, s.
const CLEAR_S: f64 = 0.5;
/// IMUs of one pad may differ by this much, rad.
const PAIR_RAD: f64 = 0.05;
/// A rotation of a pad that its IMUs must have measured, rad.
const TURNED_RAD: f64 = 0.0175;

/// One frame of one segment.
#[derive(Clone, Debug)]
pub struct SegmentFrame {
    /// Time since the last frame, s.
    pub dt_s: f64,
    /// Counts and gate ticks per leg.
    pub raw: [(u32, u32); LEGS],
    /// Length per leg if there is a fresh one in range, m.
    pub length_m: [Option<f64>; LEGS],
    /// Length that one tick stands for, m.
    pub resolution_m: [f64; LEGS],
    /// d and G, when both springs and IMUs are there and the pads turn slowly.
    pub discrepancy: Option<(Vector3<f64>, RotationPerLength)>,
}

/// State when a run of equal counts began.
#[derive(Clone, Copy, Debug)]
struct RunStart {
    smooth_rad: Option<Vector3<f64>>,
    length_m: [Option<f64>; LEGS],
}

#[derive(Clone, Debug, Default)]
struct Leg {
    last_raw: (u32, u32),
    run_s: f64,
    run_start: Option<RunStart>,
    changes: u32,
    stuck_run: bool,
    blamed: Option<ChannelHealth>,
    /// Newest lengths with their age at entry, for the leg's own motion.
    window: VecDeque<(f64, f64)>,
}

/// Watches the six springs of one segment.
#[derive(Clone, Debug, Default)]
pub struct SegmentMonitor {
    legs: [Leg; LEGS],
    smooth_rad: Option<Vector3<f64>>,
    baseline_rad: Vector3<f64>,
    warm_s: f64,
    jump_s: f64,
    calm_s: f64,
}

impl SegmentMonitor {
    /// Takes in one frame and returns the verdict per leg: `Ok`, `Suspect` or `Stuck`.
    pub fn update(&mut self, frame: &SegmentFrame) -> [ChannelHealth; LEGS] {
        self.track(frame);
        for i in 0..LEGS {
            self.watch_run(i, frame);
            self.watch_motion(i, frame);
        }
        self.judge_jump(frame);
        std::array::from_fn(|i| {
            let leg = &self.legs[i];
            if leg.stuck_run {
                ChannelHealth::Stuck
            } else {
                leg.blamed.unwrap_or_default()
            }
        })
    }

    fn track(&mut self, frame: &SegmentFrame) {
        let Some((d, _)) = frame.discrepancy else {
            return;
        };
        let pass = |tau_s: f64| frame.dt_s / (tau_s + frame.dt_s);
        let smooth = self.smooth_rad.get_or_insert(d);
        *smooth += (d - *smooth) * pass(SMOOTH_S);
        if self.warm_s < WARM_UP_S {
            self.warm_s += frame.dt_s;
            self.baseline_rad = *smooth;
        } else if self.legs.iter().all(|l| l.blamed.is_none() && !l.stuck_run) {
            self.baseline_rad += (*smooth - self.baseline_rad) * pass(BASELINE_S);
        }
    }

    fn watch_run(&mut self, i: usize, frame: &SegmentFrame) {
        let smooth_rad = self.smooth_rad.filter(|_| frame.discrepancy.is_some());
        let leg = &mut self.legs[i];
        if frame.raw[i] != leg.last_raw || frame.length_m[i].is_none() {
            leg.last_raw = frame.raw[i];
            leg.run_s = 0.0;
            leg.run_start = None;
            leg.changes = leg.changes.saturating_add(1);
            if leg.changes >= 3 {
                leg.stuck_run = false;
            }
            return;
        }
        leg.run_s += frame.dt_s;
        if leg.run_s < RUN_START_S {
            return;
        }
        let start = *leg.run_start.get_or_insert(RunStart {
            smooth_rad,
            length_m: frame.length_m,
        });
        if leg.run_s < RUN_STUCK_S || leg.stuck_run {
            return;
        }
        let stuck = match (smooth_rad, start.smooth_rad, &frame.discrepancy) {
            (Some(now), Some(before), Some((_, g))) => {
                let column: Vector3<f64> = g.column(i).into();
                let (error_m, cos) = blame(&column, &(now - before));
                error_m.abs() >= MISSED_M.max(1.5 * frame.resolution_m[i]) && cos >= 0.7
            }
            _ => {
                let mut moved: Vec<f64> = (0..LEGS)
                    .filter(|k| *k != i)
                    .filter_map(|k| Some((frame.length_m[k]? - start.length_m[k]?).abs()))
                    .collect();
                moved.sort_by(f64::total_cmp);
                moved.len() >= 3 && moved[moved.len() / 2] >= OTHERS_MOVED_M
            }
        };
        if stuck {
            leg.stuck_run = true;
            leg.changes = 0;
        }
    }

    fn watch_motion(&mut self, i: usize, frame: &SegmentFrame) {
        let window = &mut self.legs[i].window;
        for entry in window.iter_mut() {
            entry.0 += frame.dt_s;
        }
        if let Some(length_m) = frame.length_m[i] {
            window.push_back((0.0, length_m));
        }
        while window.front().is_some_and(|e| e.0 > WINDOW_S) || window.len() > 256 {
            window.pop_front();
        }
    }

    /// Motion of leg `i` itself over the window, m.
    fn moved_m(&self, i: usize) -> f64 {
        let window = &self.legs[i].window;
        let n = (window.len() / 4).max(1);
        if window.len() < 2 {
            return 0.0;
        }
        let mean = |entries: &mut dyn Iterator<Item = &(f64, f64)>| {
            entries.take(n).map(|e| e.1).sum::<f64>() / n as f64
        };
        (mean(&mut window.iter().rev()) - mean(&mut window.iter())).abs()
    }

    fn judge_jump(&mut self, frame: &SegmentFrame) {
        let (Some((_, g)), Some(smooth)) = (&frame.discrepancy, self.smooth_rad) else {
            return;
        };
        if self.warm_s < WARM_UP_S {
            return;
        }
        let jump = smooth - self.baseline_rad;
        if jump.norm() < 0.5 * JUMP_RAD {
            self.jump_s = 0.0;
            self.calm_s += frame.dt_s;
            if self.calm_s > CLEAR_S {
                for leg in &mut self.legs {
                    leg.blamed = None;
                }
            }
            return;
        }
        self.calm_s = 0.0;
        if jump.norm() < JUMP_RAD {
            return;
        }
        self.jump_s += frame.dt_s;
        // A stuck run explains the jump already.
        if self.jump_s < JUMP_S || self.legs.iter().any(|l| l.stuck_run) {
            return;
        }
        let culprit = (0..LEGS)
            .map(|i| (i, blame(&g.column(i).into(), &jump)))
            .max_by(|a, b| a.1.1.total_cmp(&b.1.1));
        if let Some((i, (error_m, cos))) = culprit
            && cos >= BLAME_COS
            && self.legs.iter().all(|l| l.blamed.is_none())
        {
            let still = error_m.abs() > 1.0e-3 && self.moved_m(i) < 0.25 * error_m.abs();
            self.legs[i].blamed = Some(if still {
                ChannelHealth::Stuck
            } else {
                ChannelHealth::Suspect
            });
        }
    }
}

/// Length error that would explain `d` through one column, m, and how well (cosine).
fn blame(column: &Vector3<f64>, d: &Vector3<f64>) -> (f64, f64) {
    let along = column.dot(d);
    let (square, size) = (column.norm_squared(), d.norm());
    if square <= 0.0 || size <= 0.0 {
        return (0.0, 0.0);
    }
    (along / square, along.abs() / (square.sqrt() * size))
}

#[derive(Clone, Debug, Default)]
struct Frozen {
    last: ImuRaw,
    run_s: f64,
    start: Option<UnitQuaternion<f64>>,
    stuck: bool,
}

/// Watches the two IMUs of one pad.
#[derive(Clone, Debug, Default)]
pub struct PairMonitor {
    units: [Frozen; 2],
}

impl PairMonitor {
    /// Verdict per IMU from their samples (`None` when there was no good one), the orientations they
    /// lead to, and the pad's orientation by the springs if that can be trusted.
    pub fn update(
        &mut self,
        dt_s: f64,
        raw: [Option<&ImuRaw>; 2],
        base_from_pad: [UnitQuaternion<f64>; 2],
        by_springs: Option<&UnitQuaternion<f64>>,
    ) -> [ChannelHealth; 2] {
        for (unit, raw) in self.units.iter_mut().zip(raw) {
            match raw {
                Some(raw) if *raw == unit.last => unit.run_s += dt_s,
                Some(raw) => {
                    *unit = Frozen {
                        last: *raw,
                        ..Frozen::default()
                    };
                }
                None => *unit = Frozen::default(),
            }
        }
        for i in 0..2 {
            let other_lives = raw[1 - i].is_some() && self.units[1 - i].run_s == 0.0;
            let unit = &mut self.units[i];
            if unit.run_s < RUN_STUCK_S {
                continue;
            }
            // Both sit on one rigid pad: they measure the same rotation.
            unit.stuck |= other_lives;
            if let Some(now) = by_springs {
                let start = unit.start.get_or_insert(*now);
                unit.stuck |= start.angle_to(now) > TURNED_RAD;
            }
        }
        let mut health = [0, 1].map(|i: usize| {
            if self.units[i].stuck {
                ChannelHealth::Stuck
            } else {
                ChannelHealth::Ok
            }
        });
        let both = raw.iter().all(Option::is_some) && health == [ChannelHealth::Ok; 2];
        if both && base_from_pad[0].angle_to(&base_from_pad[1]) > PAIR_RAD {
            let off = |i: usize| by_springs.map(|s| s.angle_to(&base_from_pad[i]));
            match (off(0), off(1)) {
                (Some(a), Some(b)) => health[usize::from(b > a)] = ChannelHealth::Suspect,
                _ => health = [ChannelHealth::Suspect; 2],
            }
        }
        health
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::RobotSpec;
    use crate::sensing::platform::Segment;

    struct Bench {
        segment: Segment,
        monitor: SegmentMonitor,
        k: u32,
        stuck_raw: [Option<(u32, u32)>; LEGS],
    }

    impl Bench {
        fn new() -> Self {
            Self {
                segment: Segment::of(&RobotSpec::reference(), 0),
                monitor: SegmentMonitor::default(),
                k: 0,
                stuck_raw: [None; LEGS],
            }
        }

        /// One frame with the given length errors (m).
        fn step(&mut self, error_m: [f64; LEGS], moving_m: f64) -> [ChannelHealth; LEGS] {
            self.k += 1;
            let g = self
                .segment
                .rotation_per_length(&self.segment.rest())
                .expect("regular");
            let d = g * nalgebra::SVector::<f64, LEGS>::from(error_m);
            let k = self.k;
            let raw =
                std::array::from_fn(|i| self.stuck_raw[i].unwrap_or((10_900, 16_000 + k % 2)));
            self.monitor.update(&SegmentFrame {
                dt_s: 0.01,
                raw,
                length_m: std::array::from_fn(|i| Some(0.15 + moving_m + error_m[i])),
                resolution_m: [0.13e-3; LEGS],
                discrepancy: Some((d, g)),
            })
        }
    }

    #[test]
    fn each_spring_has_a_column_of_its_own() {
        let segment = Segment::of(&RobotSpec::reference(), 0);
        for z in [0.08, 0.145, 0.22] {
            let pose = nalgebra::Translation3::new(0.0, 0.0, -z).into();
            let g = segment.rotation_per_length(&pose).expect("regular");
            for i in 0..LEGS {
                for j in 0..i {
                    let (_, cos) = blame(&g.column(i).into(), &g.column(j).into());
                    assert!(cos < BLAME_COS, "{i} {j} at {z}: {cos}");
                }
            }
        }
    }

    #[test]
    fn repeating_counts_are_stuck_only_once_motion_was_missed() {
        let mut b = Bench::new();
        for _ in 0..250 {
            assert_eq!(b.step([0.0; LEGS], 0.0), [ChannelHealth::Ok; LEGS]);
        }
        b.stuck_raw[2] = Some((10_900, 16_001));
        for _ in 0..300 {
            assert_eq!(b.step([0.0; LEGS], 0.0)[2], ChannelHealth::Ok);
        }
        // The arm moves spring 3 at 2 mm/s; it stays where it was.
        let mut flagged_s = f64::INFINITY;
        for k in 1..=50 {
            let t = 0.01 * f64::from(k);
            let mut e = [0.0; LEGS];
            e[2] = -2.0e-3 * t;
            let health = b.step(e, 2.0e-3 * t);
            for i in [0, 1, 3, 4, 5] {
                assert_eq!(health[i], ChannelHealth::Ok, "{i} at {t}");
            }
            if health[2] == ChannelHealth::Stuck {
                flagged_s = flagged_s.min(t);
            }
        }
        assert!(flagged_s <= 0.5, "{flagged_s}");
        // Comes back to life.
        b.stuck_raw[2] = None;
        for _ in 0..5 {
            b.step([0.0; LEGS], 1e-3);
        }
        assert_eq!(b.step([0.0; LEGS], 1e-3)[2], ChannelHealth::Ok);
    }

    #[test]
    fn a_jump_is_blamed_on_the_spring_that_explains_it_and_forgiven_when_gone() {
        for bad in 0..LEGS {
            let mut b = Bench::new();
            for _ in 0..250 {
                b.step([0.2e-3; LEGS], 0.0);
            }
            let mut health = [ChannelHealth::Ok; LEGS];
            for _ in 0..40 {
                let mut e = [0.2e-3; LEGS];
                e[bad] += 5.0e-3;
                health = b.step(e, 0.0);
            }
            for (i, h) in health.iter().enumerate() {
                let wanted = if i == bad {
                    ChannelHealth::Suspect
                } else {
                    ChannelHealth::Ok
                };
                assert_eq!(*h, wanted, "leg {i}, bad {bad}");
            }
            for _ in 0..100 {
                health = b.step([0.2e-3; LEGS], 0.0);
            }
            assert_eq!(health, [ChannelHealth::Ok; LEGS]);
        }
    }

    #[test]
    fn frozen_imu_is_seen_beside_a_living_twin_and_by_the_springs() {
        let id = UnitQuaternion::identity();
        let frozen = ImuRaw {
            gyro_rad_s: [0.0; 3],
            accel_m_s2: [0.0, 0.0, 9.81],
        };
        let mut pair = PairMonitor::default();
        // Without noise, at rest: both repeat, nothing moves.
        for _ in 0..100 {
            let h = pair.update(0.01, [Some(&frozen), Some(&frozen)], [id; 2], Some(&id));
            assert_eq!(h, [ChannelHealth::Ok; 2]);
        }
        let turned = UnitQuaternion::from_euler_angles(0.03, 0.0, 0.0);
        let h = pair.update(0.01, [Some(&frozen), Some(&frozen)], [id; 2], Some(&turned));
        assert_eq!(h, [ChannelHealth::Stuck; 2]);
        let mut pair = PairMonitor::default();
        let mut health = [ChannelHealth::Ok; 2];
        for k in 0..30 {
            let mut live = frozen;
            live.gyro_rad_s[0] = 1e-3 * f64::from(k);
            health = pair.update(0.01, [Some(&frozen), Some(&live)], [id; 2], None);
        }
        assert_eq!(health, [ChannelHealth::Stuck, ChannelHealth::Ok]);
    }

    #[test]
    fn the_imu_that_disagrees_with_twin_and_springs_is_suspect() {
        let id = UnitQuaternion::identity();
        let off = UnitQuaternion::from_euler_angles(0.1, 0.0, 0.0);
        let mut live = [ImuRaw::default(); 2];
        live[0].gyro_rad_s[0] = 0.1;
        let samples = [Some(&live[0]), Some(&live[1])];
        let mut pair = PairMonitor::default();
        let h = pair.update(0.01, samples, [off, id], Some(&id));
        assert_eq!(h, [ChannelHealth::Suspect, ChannelHealth::Ok]);
        let h = pair.update(0.01, samples, [off, id], None);
        assert_eq!(h, [ChannelHealth::Suspect; 2]);
    }
}
