//! Springs that contradict the IMUs over several poses.
//!
//! A spring that snags, drifts or was off before power-on makes no jump, and an estimator that follows the arm from frame
//! to frame follows such a fault as well. Some poses of the arm are therefore kept as they were read and compared as a
//! whole. With the pads' orientations by the IMUs alone, their headings followed by the gyros, a segment's lengths leave
//! three unknowns per pose, its translation. With r the lengths less those of the kept poses,
//!
//! r ~ N(0, S), ln Z = −½ (rᵀ S⁻¹ r + ln |S|),
//!
//! S = σ² I + σ_t² d dᵀ + J Σ Jᵀ + σ_e² ½ (d·d′ in the upper and the lower pad) + σ_f² (springs of the hypothesis)
//!
//! with d the directions of the springs and J the change of their lengths by a turn. Σ is the error of the orientations:
//! inclinations off by a constant and by noise, a heading that is hardly known at first and drifts with a gyro's bias. σ_e
//! stands for ends that lie beside the drawing. Hypotheses are: no fault, one spring, two springs; each off by a constant,
//! or by what changes from pose to pose.

use nalgebra::{Cholesky, SMatrix, SVector, Vector3};

use super::faults::{FIRST, FURTHER};
use super::filter::SPRING_FAULT_M;
use super::platform::{Geometry, LEGS};
use super::ways::Ways;
use crate::signal::{FAULT_NAMED, FAULT_OPEN, Pose, SPRINGS};

/// Poses of a segment that are compared.
const POSES: usize = 10;
const ROWS: usize = POSES * LEGS;
/// A pose is kept when a length has changed by this since the last one, m.
const APART_M: f64 = 4e-3;
/// What a spring is off by that does not follow its ends any more, m.
const ASTRAY_M: f64 = 0.025;
/// A spring that is off by less is not named, m.
const LEAST_M: f64 = 1.5e-3;
/// A faulty spring that is off by less at so many poses running reads right again, m.
const RIGHT_M: f64 = 1e-3;
const RIGHT_POSES: usize = 3;
/// Noise of a length, m, with what its ends do not explain.
const NOISE_M: f64 = 0.15e-3;
/// Translations are not known, m.
const TRANSLATION_M: f64 = 0.03;
/// Inclination of a segment by the IMUs: noise, and its constant error with and without a calibration, rad.
const INCLINED: f64 = 0.15 * DEG;
const INCLINED_CONSTANT: [f64; 2] = [0.2 * DEG, 2.0 * DEG];
/// Heading at the first pose, rad, and drift of the gyros, rad/s.
const HEADING: f64 = 8.0 * DEG;
const DRIFT: f64 = 0.05 * DEG;
/// A faulty spring is stuck when it should have moved by this at least, m.
const STUCK_WAY_M: f64 = 1.5e-3;
/// Sets of springs that may be faulty, and hypotheses on a segment: no fault, a set that is off by a constant, or by
/// anything.
const SETS: usize = LEGS + LEGS * (LEGS - 1) / 2;
const HYPOTHESES: usize = 1 + 2 * SETS;
const DEG: f64 = std::f64::consts::PI / 180.0;

type Covariance = SMatrix<f64, ROWS, ROWS>;
type Residuals = SVector<f64, ROWS>;

/// One pose of a segment.
#[derive(Clone, Copy, Debug, Default)]
struct Kept {
    t_s: f64,
    /// Sum over the poses so far of the largest changes of a length, squared, m².
    moved_m2: f64,
    /// Poses of one epoch have the same offsets of their headings.
    epoch: u32,
    /// Lengths as read, m.
    read_m: [Option<f64>; LEGS],
    /// The same less those of the kept pose, m.
    missed_m: [f64; LEGS],
    /// Directions in the frames of the upper and of the lower pad.
    along: [[Vector3<f64>; 2]; LEGS],
    /// Change of length by a turn of the lower pad, in the upper one's frame: horizontal part, and about the vertical, m/rad.
    inclined_m: [Vector3<f64>; LEGS],
    turned_m: [f64; LEGS],
}

/// Finding on a segment by its poses.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Finding {
    /// Probability that each spring of the segment is faulty, in the order of the springs.
    pub probability: [f64; LEGS],
    /// Whether it does not move, if it is; in the same order.
    pub is_stuck: [bool; LEGS],
    /// Something is wrong, and it is not certain what.
    pub is_suspect: bool,
}

impl Finding {
    /// Whether a spring is named as faulty.
    pub fn is_named(&self, leg: usize) -> bool {
        self.probability[leg] > FAULT_NAMED
    }
}

/// Poses of one segment and the hypotheses on them.
#[derive(Clone, Debug)]
struct Segment {
    kept: [Kept; POSES],
    count: usize,
    epoch: u32,
    /// The identity beyond the kept poses.
    covariance: Box<Covariance>,
    residuals: Residuals,
    /// Hypotheses that were compared so far, and ln Z of each.
    tried: usize,
    log_z: [f64; HYPOTHESES],
    finding: Finding,
}

/// Watches both segments.
#[derive(Clone, Debug)]
pub struct Consistency {
    segments: [Segment; 2],
    spring_sd_m: [f64; SPRINGS],
    inclined_constant: f64,
}

/// A segment in one frame.
#[derive(Clone, Copy, Debug)]
pub struct Look {
    /// Time, s.
    pub t_s: f64,
    /// Lengths as read, without lag, in the order of the segment's springs, m; `None` for a spring not to be used.
    pub length_m: [Option<f64>; LEGS],
    /// The pad above (the base: at its origin), base from pad: orientation by its IMUs, place by the estimator.
    pub upper: Pose,
    /// The pad below, base from pad.
    pub lower: Pose,
}

/// Springs that are faulty.
#[derive(Clone, Copy, Debug, Default)]
struct Hypothesis {
    springs: [bool; LEGS],
    /// Whether what they are off by changes from pose to pose.
    varies: bool,
}

impl Hypothesis {
    fn nth(n: usize) -> Self {
        let mut out = Self::default();
        let Some(n) = n.checked_sub(1) else {
            return out;
        };
        out.varies = n >= SETS;
        match (n % SETS).checked_sub(LEGS) {
            None => out.springs[n % SETS] = true,
            Some(pair) => {
                let mut pairs = (0..LEGS).flat_map(|a| (a + 1..LEGS).map(move |b| (a, b)));
                if let Some((a, b)) = pairs.nth(pair) {
                    out.springs[a] = true;
                    out.springs[b] = true;
                }
            }
        }
        out
    }

    fn log_prior(&self) -> f64 {
        match self.springs.iter().filter(|s| **s).count() {
            0 => 0.0,
            n => FIRST + FURTHER * (n - 1) as f64,
        }
    }

    /// Covariance of what one of them is off by at two poses, m²: it may miss all of the motion up to the earlier one.
    fn off(&self, moved_m2: f64) -> f64 {
        match self.varies {
            true => ASTRAY_M.powi(2) + moved_m2,
            false => SPRING_FAULT_M.powi(2),
        }
    }

    fn faulty(&self) -> impl Iterator<Item = usize> + '_ {
        (0..LEGS).filter(|i| self.springs[*i])
    }
}

impl Consistency {
    /// `spring_sd_m`: how far healthy springs are off by their ends, in the order of the springs; `calibrated`: whether the
    /// IMUs were.
    pub fn new(spring_sd_m: [f64; SPRINGS], calibrated: bool) -> Self {
        let segment = Segment {
            kept: [Kept::default(); POSES],
            count: 0,
            epoch: 0,
            covariance: Box::new(Covariance::identity()),
            residuals: Residuals::zeros(),
            tried: HYPOTHESES,
            log_z: [0.0; HYPOTHESES],
            finding: Finding::default(),
        };
        Self {
            segments: [segment.clone(), segment],
            spring_sd_m,
            inclined_constant: INCLINED_CONSTANT[usize::from(!calibrated)],
        }
    }

    /// What was found in a segment (0-based).
    pub fn finding(&self, segment: usize) -> &Finding {
        &self.segments[segment].finding
    }

    /// From now on the offsets of a segment's headings are others.
    pub fn turn_headings(&mut self, segment: usize) {
        self.segments[segment].epoch += 1;
    }

    /// Takes in a frame of slow motion; keeps it if the segment is somewhere else, or compares one more hypothesis. Whether
    /// the finding is new.
    pub fn observe(&mut self, k: usize, look: &Look, geometry: &Geometry) -> bool {
        let segment = &mut self.segments[k];
        if segment.tried < HYPOTHESES {
            return segment.try_next();
        }
        let moved_m = segment.count.checked_sub(1).map(|last| {
            let ways = segment.kept[last].read_m.iter().zip(&look.length_m);
            ways.filter_map(|(a, b)| Some((a.as_ref()? - b.as_ref()?).abs()))
                .fold(0.0, f64::max)
        });
        if moved_m.is_none_or(|m| m > APART_M) {
            segment.keep(Kept::of(k, look, geometry), moved_m.unwrap_or(0.0));
            let sd_m: [f64; LEGS] = std::array::from_fn(|i| self.spring_sd_m[LEGS * k + i]);
            segment.compare(&sd_m, self.inclined_constant);
        }
        false
    }
}

impl Kept {
    fn of(segment: usize, look: &Look, geometry: &Geometry) -> Self {
        let relative = look.upper.inverse() * look.lower;
        let up = look.upper.rotation.inverse() * Vector3::z();
        let mut kept = Self {
            t_s: look.t_s,
            read_m: look.length_m,
            ..Self::default()
        };
        for i in 0..LEGS {
            let at = LEGS * segment + i;
            let arm = relative.rotation * geometry.bottom_m[at];
            let d = relative.translation.vector + arm - geometry.top_m[at];
            let length_m = d.norm().max(1e-6);
            let along = d / length_m;
            kept.missed_m[i] = look.length_m[i].unwrap_or(length_m) - length_m;
            kept.along[i] = [along, relative.rotation.inverse() * along];
            let by_turn = arm.cross(&along);
            kept.turned_m[i] = by_turn.dot(&up);
            kept.inclined_m[i] = by_turn - up * kept.turned_m[i];
        }
        kept
    }
}

impl Segment {
    fn keep(&mut self, mut kept: Kept, moved_m: f64) {
        kept.epoch = self.epoch;
        let before = self
            .count
            .checked_sub(1)
            .map_or(0.0, |k| self.kept[k].moved_m2);
        kept.moved_m2 = before + moved_m * moved_m;
        if self.count == POSES {
            self.kept.rotate_left(1);
            self.count -= 1;
        }
        self.kept[self.count] = kept;
        self.count += 1;
    }

    /// What may have been missed from the oldest pose to pose `k`, m².
    fn moved_m2(&self, k: usize) -> f64 {
        self.kept[k].moved_m2 - self.kept[0].moved_m2
    }

    /// Residuals and their covariance without a fault; starts the comparison.
    fn compare(&mut self, sd_m: &[f64; LEGS], inclined_constant: f64) {
        self.residuals.fill(0.0);
        self.covariance.fill_with_identity();
        for (k, a) in self.kept[..self.count].iter().enumerate() {
            for i in 0..LEGS {
                self.residuals[LEGS * k + i] = a.missed_m[i];
            }
            for (l, b) in self.kept[..=k].iter().enumerate() {
                let same = f64::from(u8::from(k == l));
                let turned = match a.epoch == b.epoch {
                    true => {
                        let start_s = self.kept[..=l].iter().find(|p| p.epoch == b.epoch);
                        let start_s = start_s.map_or(b.t_s, |p| p.t_s);
                        let drift = DRIFT * DRIFT * (a.t_s - start_s) * (b.t_s - start_s);
                        HEADING * HEADING + drift
                    }
                    false => 0.0,
                };
                let inclined = inclined_constant.powi(2) + same * INCLINED * INCLINED;
                for i in 0..LEGS {
                    for j in 0..LEGS {
                        let mut s = turned * a.turned_m[i] * b.turned_m[j]
                            + inclined * a.inclined_m[i].dot(&b.inclined_m[j])
                            + same * TRANSLATION_M.powi(2) * a.along[i][0].dot(&b.along[j][0]);
                        if i == j {
                            let alike: f64 =
                                (0..2).map(|p| a.along[i][p].dot(&b.along[i][p])).sum();
                            s += 0.5 * sd_m[i].powi(2) * alike + same * NOISE_M * NOISE_M;
                            if a.read_m[i].is_none() {
                                s += same;
                            }
                        }
                        self.covariance[(LEGS * k + i, LEGS * l + j)] = s;
                        self.covariance[(LEGS * l + j, LEGS * k + i)] = s;
                    }
                }
            }
        }
        self.tried = 0;
    }

    /// ln Z of a hypothesis; `off_m` takes what each spring of it is off by at each pose.
    fn log_evidence(
        &self,
        hypothesis: &Hypothesis,
        off_m: Option<&mut [[f64; LEGS]; POSES]>,
    ) -> Option<f64> {
        let mut covariance = *self.covariance;
        for k in 0..self.count {
            for l in 0..self.count {
                let off = hypothesis.off(self.moved_m2(k.min(l)));
                for i in hypothesis.faulty() {
                    covariance[(LEGS * k + i, LEGS * l + i)] += off;
                }
            }
        }
        let decomposed = Cholesky::new(covariance)?;
        let solved = decomposed.solve(&self.residuals);
        let square = self.residuals.dot(&solved);
        if let Some(off_m) = off_m {
            for i in hypothesis.faulty() {
                for (k, off_m) in off_m.iter_mut().enumerate().take(self.count) {
                    off_m[i] = (0..self.count)
                        .map(|l| {
                            let off = hypothesis.off(self.moved_m2(k.min(l)));
                            off * solved[LEGS * l + i]
                        })
                        .sum();
                }
            }
        }
        Some(-0.5 * (square + decomposed.ln_determinant()))
    }

    /// Compares one more hypothesis. Whether it was the last one, and the finding is new.
    fn try_next(&mut self) -> bool {
        let hypothesis = Hypothesis::nth(self.tried);
        let log_z = self.log_evidence(&hypothesis, None);
        self.log_z[self.tried] = log_z.map_or(f64::MIN, |z| z + hypothesis.log_prior());
        self.tried += 1;
        if self.tried < HYPOTHESES {
            return false;
        }
        self.conclude();
        true
    }

    fn conclude(&mut self) {
        let best = self.log_z.iter().copied().fold(f64::MIN, f64::max);
        let weights = self.log_z.map(|z| (z - best).exp());
        let sum: f64 = weights.iter().sum();
        let mut finding = Finding::default();
        for (h, weight) in weights.iter().enumerate() {
            for i in Hypothesis::nth(h).faulty() {
                finding.probability[i] += weight / sum;
            }
        }
        let uncertain = finding
            .probability
            .iter()
            .any(|p| (FAULT_OPEN..=FAULT_NAMED).contains(p));
        finding.is_suspect = uncertain && weights[0] / sum < 0.5;
        let named = Hypothesis {
            springs: std::array::from_fn(|i| finding.is_named(i)),
            varies: true,
        };
        if named.springs.contains(&true) {
            let mut off_m = [[0.0; LEGS]; POSES];
            self.log_evidence(&named, Some(&mut off_m));
            for i in named.faulty() {
                finding.is_stuck[i] = self.is_stuck(i, &off_m);
                let is_less = |of: &[f64; LEGS]| of[i].abs() < LEAST_M;
                if off_m[..self.count].iter().all(is_less) {
                    finding.probability[i] = finding.probability[i].min(FAULT_NAMED);
                    finding.is_suspect = true;
                }
                let right =
                    |k: usize| off_m[k][i].abs() < RIGHT_M && self.kept[k].read_m[i].is_some();
                if self.count > RIGHT_POSES && (self.count - RIGHT_POSES..self.count).all(right) {
                    // It reads right again: what it read before is no evidence any more.
                    for kept in &mut self.kept[..self.count - RIGHT_POSES] {
                        kept.read_m[i] = None;
                    }
                }
            }
        }
        self.finding = finding;
    }

    /// Whether spring `i` did not move over the last poses while it should have.
    fn is_stuck(&self, i: usize, off_m: &[[f64; LEGS]; POSES]) -> bool {
        let mut ways: Option<Ways> = None;
        for k in (0..self.count).rev() {
            let Some(read_m) = self.kept[k].read_m[i] else {
                break;
            };
            let expected_m = read_m - off_m[k][i];
            let ways = ways.get_or_insert(Ways::of(read_m, expected_m));
            ways.add(read_m, expected_m);
            if ways.is_stuck(STUCK_WAY_M) {
                return true;
            }
        }
        false
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::RobotSpec;
    use crate::sensing::Calibration;
    use crate::sensing::platform::pads;
    use crate::signal::pose_from_ypr;
    use nalgebra::UnitQuaternion;
    use rand::SeedableRng as _;
    use rand_distr::Distribution as _;
    use rand_pcg::Pcg64Mcg;

    const SPRING_SD_M: f64 = 0.5e-3;

    fn white(rng: &mut Pcg64Mcg) -> f64 {
        rand_distr::StandardNormal.sample(rng)
    }

    fn about(rng: &mut Pcg64Mcg, sd: [f64; 3]) -> Vector3<f64> {
        Vector3::from(sd.map(|sd| sd * white(rng)))
    }

    /// Looks at a segment whose ends, orientations, and places are off as a healthy one's are.
    fn looks(k: usize, seed: u64, off_m: impl Fn(usize, usize) -> f64) -> Vec<Look> {
        let spec = RobotSpec::reference();
        let geometry = Geometry::calibrated(&spec, &Calibration::as_drawn());
        let mut rng = Pcg64Mcg::seed_from_u64(seed);
        let end_sd = [SPRING_SD_M * 0.5_f64.sqrt(); 3];
        let ends: Vec<[Vector3<f64>; 2]> = (0..LEGS)
            .map(|_| [0; 2].map(|_| about(&mut rng, end_sd)))
            .collect();
        let constant = INCLINED_CONSTANT[0];
        // Beyond some degrees a heading's effect is not linear.
        let turned = about(&mut rng, [constant, constant, 0.2 * HEADING]);
        let drift = DRIFT * white(&mut rng);
        (0..POSES)
            .map(|n| {
                let t_s = 1.3 * n as f64;
                let wave = |by: f64, at: f64| by * (0.5 * t_s + at + k as f64).sin();
                let relative = [0.0, 1.0].map(|at| {
                    let bend = [wave(0.05, at), wave(0.3, at + 1.0), wave(0.25, at + 2.0)];
                    let place = [
                        wave(0.02, at),
                        wave(0.02, at + 2.0),
                        -0.145 + wave(0.02, at),
                    ];
                    pose_from_ypr(place, bend)
                });
                let [middle, end] = pads(&spec, &relative);
                let (upper, lower) = match k {
                    0 => (Pose::identity(), middle),
                    _ => (middle, end),
                };
                let length_m = std::array::from_fn(|leg| {
                    let i = LEGS * k + leg;
                    let from = upper * nalgebra::Point3::from(geometry.top_m[i] + ends[leg][0]);
                    let to = lower * nalgebra::Point3::from(geometry.bottom_m[i] + ends[leg][1]);
                    Some((to - from).norm() + NOISE_M * white(&mut rng) + off_m(n, leg))
                });
                let noise = about(&mut rng, [INCLINED, INCLINED, 0.0]);
                let by = turned + noise + Vector3::z() * (drift * t_s);
                let mut found = lower;
                found.rotation = UnitQuaternion::from_scaled_axis(by) * found.rotation;
                found.translation.vector += about(&mut rng, [2e-3; 3]);
                Look {
                    t_s,
                    length_m,
                    upper,
                    lower: found,
                }
            })
            .collect()
    }

    fn watched(k: usize, looks: &[Look]) -> Consistency {
        let spec = RobotSpec::reference();
        let geometry = Geometry::calibrated(&spec, &Calibration::as_drawn());
        let mut consistency = Consistency::new([SPRING_SD_M; SPRINGS], true);
        for look in looks {
            consistency.observe(k, look, &geometry);
            while !consistency.observe(k, look, &geometry) {}
        }
        consistency
    }

    /// Without a fault rᵀ S⁻¹ r is χ² with one degree of freedom per length. Translations and the heading are drawn from
    /// less than what is assumed of them, which takes three per pose and one.
    #[test]
    fn residuals_of_a_healthy_segment_are_as_large_as_stated() {
        for k in 0..2 {
            let (mut sum, n) = (0.0, 60);
            for seed in 0..n {
                let watched = watched(k, &looks(k, seed, |_, _| 0.0));
                let segment = &watched.segments[k];
                assert_eq!(segment.count, POSES);
                let log_z = segment.log_evidence(&Hypothesis::default(), None);
                let decomposed = Cholesky::new(*segment.covariance).expect("regular");
                let log_det = decomposed.ln_determinant();
                sum += -2.0 * log_z.expect("regular") - log_det;
                assert_eq!(
                    segment.finding.probability.map(|p| p > FAULT_OPEN),
                    [false; LEGS]
                );
            }
            let per_degree = sum / f64::from(n as u32) / (3 * POSES - 1) as f64;
            assert!((0.9..1.1).contains(&per_degree), "{per_degree}");
        }
    }

    #[test]
    fn constant_and_snagged_springs_are_named_alone() {
        let mut moved = 0;
        for k in 0..2 {
            for leg in 0..LEGS {
                let named = |found: &Consistency| -> Vec<usize> {
                    let finding = found.finding(k);
                    (0..LEGS).filter(|i| finding.is_named(*i)).collect()
                };
                let off = looks(k, 7, |_, i| if i == leg { 8e-3 } else { 0.0 });
                assert_eq!(named(&watched(k, &off)), [leg]);
                let mut snagged = looks(k, 7, |_, _| 0.0);
                let held = snagged[4].length_m[leg];
                let mut missed_m = 0.0_f64;
                for look in &mut snagged[4..] {
                    let off_m = look.length_m[leg].zip(held).map_or(0.0, |(a, b)| a - b);
                    missed_m = missed_m.max(off_m.abs());
                    look.length_m[leg] = held;
                }
                let found = watched(k, &snagged);
                if missed_m < 8e-3 {
                    assert!(named(&found).iter().all(|i| *i == leg));
                    continue;
                }
                moved += 1;
                assert_eq!(named(&found), [leg], "missed {missed_m}");
                assert!(found.finding(k).is_stuck[leg]);
            }
        }
        assert!(moved >= 8, "{moved}");
    }
}
