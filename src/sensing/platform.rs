//! Poses of the pads by the springs alone: each segment is a six-legged platform.
//!
//! Six lengths and six degrees of freedom: the pose of the lower pad's upper face in the frame of
//! the face above it follows by Gauss-Newton from the last pose. The three X pairs make this well
//! posed: on the reference robot the Jacobian (per m, rotation times the 75 mm attachment radius)
//! has rank 6 with a condition number of 2.4, 4.3 and 6.5 at 80, 145 and 220 mm, and a length noise
//! of 0.115 mm becomes 0.06° of tilt and 0.11° of yaw at rest.
//!
//! | symbol | meaning |
//! |---|---|
//! | a_i, b_i | upper and lower end of spring i, each in its pad's frame |
//! | R, t | upper from lower |
//! | d_i | t + R b_i − a_i, so that l_i = |d_i| |

use nalgebra::{
    Matrix6, Point3, Rotation3, SMatrix, Translation3, UnitQuaternion, Vector3, Vector6,
};

use super::calibration::Calibration;
use crate::robot::RobotSpec;
use crate::signal::{IMUS, Pose};

/// Springs per segment.
pub const LEGS: usize = 6;
/// Rotations are scaled by this lever to compare with lengths, m.
const LEVER_M: f64 = 0.075;
/// Noise of a length, m.
const LENGTH_SIGMA_M: f64 = 0.15e-3;
/// Noise of an IMU's rotation across a segment, rad.
const ROTATION_SIGMA_RAD: f64 = 0.005;
const LENGTH_WEIGHT: f64 = 1.0 / (LENGTH_SIGMA_M * LENGTH_SIGMA_M);
const TURN_WEIGHT: f64 = 1.0 / (ROTATION_SIGMA_RAD * LEVER_M * ROTATION_SIGMA_RAD * LEVER_M);
/// A step is cut to this size, m.
const STEP_MAX_M: f64 = 0.03;
const ITERATIONS_MAX: usize = 25;

/// Rotation error (rotation vector in the upper frame) per length error, rad/m: rows of the inverse Jacobian, one column
/// per leg.
pub type RotationPerLength = SMatrix<f64, 3, LEGS>;

/// The six legs of one segment.
#[derive(Clone, Debug)]
pub struct Segment {
    /// Upper ends in the frame of the face above, in the order of the springs, m.
    pub top_m: [Vector3<f64>; LEGS],
    /// Lower ends in the frame of the pad below, in the order of the legs, m.
    pub bottom_m: [Vector3<f64>; LEGS],
    /// Distance of the faces at rest, m.
    pub rest_m: f64,
}

/// Measurements of a segment in one frame.
#[derive(Clone, Debug, Default)]
pub struct Known {
    /// Length per leg, m; `None` for a leg not to be used.
    pub length_m: [Option<f64>; LEGS],
    /// Rotation upper from lower by the IMUs, to make up for missing legs; `None`: the lengths alone are used.
    pub upper_from_lower: Option<UnitQuaternion<f64>>,
}

/// Where springs end and IMUs sit, by the calibration.
#[derive(Clone, Debug)]
pub struct Geometry {
    /// The segments by themselves, upper one first.
    pub segments: [Segment; 2],
    /// Upper ends of all springs, in the frame of the base or of the middle pad's upper face, m.
    pub top_m: [Vector3<f64>; 2 * LEGS],
    /// Lower ends of all springs, in the frame of the pad below, m.
    pub bottom_m: [Vector3<f64>; 2 * LEGS],
    /// Pad of each IMU: 0 the middle one, 1 the end pad.
    pub pad_of_imu: [usize; IMUS],
    /// Mounting of each IMU by the calibration, pad from IMU.
    pub pad_from_imu: [Rotation3<f64>; IMUS],
    /// By how much the calibration moved the upper and the lower ends from the drawing, m.
    off_m: [[Vector3<f64>; 2]; 2 * LEGS],
}

impl Geometry {
    /// Of a robot.
    pub fn calibrated(spec: &RobotSpec, calibration: &Calibration) -> Self {
        let segments = [0, 1].map(|k| Segment::calibrated(spec, calibration, k));
        let below = Vector3::z() * spec.pad_thickness_m;
        Self {
            top_m: std::array::from_fn(|i| match i / LEGS {
                0 => segments[0].top_m[i],
                _ => segments[1].top_m[i - LEGS] - below,
            }),
            bottom_m: std::array::from_fn(|i| segments[i / LEGS].bottom_m[i % LEGS]),
            pad_of_imu: spec.pad_of_imu(),
            pad_from_imu: std::array::from_fn(|i| {
                calibration.mounting(i).to_rotation_matrix() * spec.imus[i].pad_from_imu
            }),
            off_m: std::array::from_fn(|i| calibration.ends_off_m(i)),
            segments,
        }
    }

    /// Length of spring `i` (0-based) with its ends as in the drawing less that with its ends as calibrated, at these poses
    /// of the middle and the end pad, m.
    ///
    /// Networks are trained on the drawing: added to a length, it gives the one that a spring of the drawing would have.
    pub fn drawing_offset_m(&self, i: usize, base_from_pad: [&Pose; 2]) -> f64 {
        let [top_off_m, bottom_off_m] = self.off_m[i];
        if self.off_m[i] == [Vector3::zeros(); 2] {
            return 0.0;
        }
        let (above, below) = match i / LEGS {
            0 => (&Pose::identity(), base_from_pad[0]),
            _ => (base_from_pad[0], base_from_pad[1]),
        };
        let distance_m = |top_m: Vector3<f64>, bottom_m: Vector3<f64>| {
            let (from_m, to_m) = (above * Point3::from(top_m), below * Point3::from(bottom_m));
            (to_m - from_m).norm()
        };
        let (top_m, bottom_m) = (self.top_m[i], self.bottom_m[i]);
        distance_m(top_m - top_off_m, bottom_m - bottom_off_m) - distance_m(top_m, bottom_m)
    }

    /// The lengths that springs of the drawing would have where those of the calibration have these, m. The middle and
    /// the end pad's orientations, base from pad, give the poses, as arcs of the median stretch: half a millimetre at an
    /// end needs no better one, and no length that is wrong has a say in another.
    pub fn lengths_of_drawing(
        &self,
        spec: &RobotSpec,
        length_m: &[f64; 2 * LEGS],
        base_from_pad: &[UnitQuaternion<f64>; 2],
    ) -> [f64; 2 * LEGS] {
        let turns = [
            base_from_pad[0],
            base_from_pad[0].inverse() * base_from_pad[1],
        ];
        let arcs = [0, 1].map(|k| {
            let rest = self.segments[k].rest();
            let rest_m = self.segments[k].lengths_m(&rest);
            let mut stretches: [f64; LEGS] = std::array::from_fn(|leg| {
                let stretch = length_m[LEGS * k + leg] / rest_m[leg];
                if stretch.is_finite() {
                    stretch
                } else {
                    f64::INFINITY
                }
            });
            stretches.sort_by(f64::total_cmp);
            let finite = stretches.partition_point(|s| s.is_finite());
            let stretch = stretches[..finite].get(finite / 2).copied().unwrap_or(1.0);
            let half = turns[k].powf(0.5);
            Pose::from_parts((half * rest.translation.vector * stretch).into(), turns[k])
        });
        let [middle, end] = pads(spec, &arcs);
        std::array::from_fn(|i| length_m[i] + self.drawing_offset_m(i, [&middle, &end]))
    }
}

/// A solved segment.
#[derive(Clone, Debug)]
pub struct Solution {
    /// Pose of the pad below in the frame of the face above.
    pub upper_from_lower: Pose,
    /// Root mean square of the length residuals, m.
    pub residual_m: f64,
    /// Whether the last step was below a tenth of a micrometre.
    pub converged: bool,
    /// Gauss-Newton steps taken.
    pub iterations: usize,
}

impl Segment {
    /// Segment `k` (0 or 1) of a robot.
    pub fn of(spec: &RobotSpec, k: usize) -> Self {
        Self {
            top_m: std::array::from_fn(|i| spec.spring_top_m[LEGS * k + i]),
            bottom_m: std::array::from_fn(|i| spec.spring_bottom_m[LEGS * k + i]),
            rest_m: spec.rest_length_m,
        }
    }

    /// The same with ends where the calibration found them.
    pub fn calibrated(spec: &RobotSpec, calibration: &Calibration, k: usize) -> Self {
        let mut segment = Self::of(spec, k);
        for i in 0..LEGS {
            let [top, bottom] = calibration.ends_off_m(LEGS * k + i);
            segment.top_m[i] += top;
            segment.bottom_m[i] += bottom;
        }
        segment
    }

    /// The pose at rest, upper from lower: straight down.
    pub fn rest(&self) -> Pose {
        Translation3::new(0.0, 0.0, -self.rest_m).into()
    }

    /// Spring lengths at a pose, upper from lower, in the order of the legs, m.
    pub fn lengths_m(&self, upper_from_lower: &Pose) -> [f64; LEGS] {
        std::array::from_fn(|i| self.leg(upper_from_lower, i).0.norm())
    }

    /// d_i and R b_i.
    fn leg(&self, upper_from_lower: &Pose, i: usize) -> (Vector3<f64>, Vector3<f64>) {
        let arm = upper_from_lower.rotation * self.bottom_m[i];
        (
            upper_from_lower.translation.vector + arm - self.top_m[i],
            arm,
        )
    }

    /// ∂l/∂(t, ρω), one row per leg: t in m, ω a rotation vector in the upper frame times the lever ρ = 75 mm.
    pub fn jacobian(&self, upper_from_lower: &Pose) -> Matrix6<f64> {
        let mut j = Matrix6::zeros();
        for i in 0..LEGS {
            let (d, arm) = self.leg(upper_from_lower, i);
            let along = d.normalize();
            // ∂l_i/∂t = d̂ᵀ,  ∂l_i/∂ω = (R b_i × d̂)ᵀ
            j.fixed_view_mut::<1, 3>(i, 0).copy_from(&along.transpose());
            let turn = arm.cross(&along) / LEVER_M;
            j.fixed_view_mut::<1, 3>(i, 3).copy_from(&turn.transpose());
        }
        j
    }

    /// Sensitivity of the rotation found from six lengths to each length; `None` where the
    /// platform is singular.
    pub fn rotation_per_length(&self, upper_from_lower: &Pose) -> Option<RotationPerLength> {
        let inverse = self.jacobian(upper_from_lower).try_inverse()?;
        Some(inverse.fixed_view::<3, LEGS>(3, 0) / LEVER_M)
    }
}

/// Σ wᵢ Jᵢᵀ Jᵢ over what is known, as [`Segment::jacobian`] has its columns.
fn information(jacobian: &Matrix6<f64>, known: &Known) -> Matrix6<f64> {
    // Keeps the matrix regular where nothing is measured, six decades below the rest.
    let mut normal = Matrix6::from_diagonal_element(1e-6 * LENGTH_WEIGHT);
    for (i, _) in known
        .length_m
        .iter()
        .enumerate()
        .filter(|(_, l)| l.is_some())
    {
        let row = jacobian.row(i).transpose();
        normal += row * row.transpose() * LENGTH_WEIGHT;
    }
    if known.upper_from_lower.is_some() {
        for k in 3..6 {
            normal[(k, k)] += TURN_WEIGHT;
        }
    }
    normal
}

/// Finds the pose, upper from lower, that fits the known lengths (and rotation, if given), starting from `start`.
///
/// With fewer than six legs and no rotation, what is not measured stays as it was in `start`.
pub fn solve(segment: &Segment, known: &Known, start: &Pose) -> Solution {
    let mut pose = *start;
    let mut solution = Solution {
        upper_from_lower: pose,
        residual_m: f64::INFINITY,
        converged: false,
        iterations: 0,
    };
    for iteration in 1..=ITERATIONS_MAX {
        let jacobian = segment.jacobian(&pose);
        let normal = information(&jacobian, known);
        let mut right = Vector6::zeros();
        for (i, length_m) in known.length_m.iter().enumerate() {
            if let Some(length_m) = length_m {
                let row = jacobian.row(i).transpose();
                let residual = length_m - segment.leg(&pose, i).0.norm();
                right += row * residual * LENGTH_WEIGHT;
            }
        }
        if let Some(wanted) = &known.upper_from_lower {
            // log(R_imu Rᵀ) is where the rotation has to go, in the upper frame.
            let turn = (wanted * pose.rotation.inverse()).scaled_axis() * LEVER_M;
            for k in 0..3 {
                right[3 + k] += turn[k] * TURN_WEIGHT;
            }
        }
        let Some(factor) = normal.cholesky() else {
            break;
        };
        let mut step = factor.solve(&right);
        let size = step.norm();
        if !size.is_finite() {
            break;
        }
        if size > STEP_MAX_M {
            step *= STEP_MAX_M / size;
        }
        pose.translation.vector += step.fixed_rows::<3>(0);
        let turn: Vector3<f64> = step.fixed_rows::<3>(3) / LEVER_M;
        pose.rotation = UnitQuaternion::from_scaled_axis(turn) * pose.rotation;
        pose.rotation.renormalize();
        solution.iterations = iteration;
        if size < 1e-7 {
            solution.converged = true;
            break;
        }
    }
    let (mut squares, mut n) = (0.0, 0.0);
    for (length_m, wanted) in segment.lengths_m(&pose).iter().zip(&known.length_m) {
        if let Some(wanted) = wanted {
            squares += (length_m - wanted).powi(2);
            n += 1.0;
        }
    }
    solution.upper_from_lower = pose;
    solution.residual_m = if n > 0.0 { f64::sqrt(squares / n) } else { 0.0 };
    solution
}

/// A solution to start from, upper from lower: the found one if it hangs below, else the rest pose.
pub fn plausible(segment: &Segment, found: &Solution) -> Pose {
    let z_m = found.upper_from_lower.translation.vector.z;
    if found.converged && z_m < 0.0 && z_m > -4.0 * segment.rest_m {
        found.upper_from_lower
    } else {
        segment.rest()
    }
}

/// Middle and end pad, base from pad, from the lengths of all springs in their order, m.
pub fn pads_of_lengths(spec: &RobotSpec, length_m: &[f64; 2 * LEGS]) -> [Pose; 2] {
    let poses = std::array::from_fn(|k| {
        let segment = Segment::of(spec, k);
        let known = Known {
            length_m: std::array::from_fn(|i| Some(length_m[LEGS * k + i])),
            upper_from_lower: None,
        };
        solve(&segment, &known, &segment.rest()).upper_from_lower
    });
    pads(spec, &poses)
}

/// Middle and end pad, base from pad, from the two segments' poses, upper segment first.
pub fn pads(spec: &RobotSpec, upper_from_lower: &[Pose; 2]) -> [Pose; 2] {
    let base_from_middle = upper_from_lower[0];
    // The second segment hangs on the middle pad's lower face.
    let below = Translation3::new(0.0, 0.0, -spec.pad_thickness_m);
    [
        base_from_middle,
        base_from_middle * below * upper_from_lower[1],
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::signal::pose_from_ypr;
    use proptest::prelude::*;

    fn segment() -> Segment {
        Segment::of(&RobotSpec::reference(), 0)
    }

    fn bent(ypr_deg: [f64; 3], position_m: [f64; 3]) -> Pose {
        pose_from_ypr(position_m, ypr_deg.map(f64::to_radians))
    }

    #[test]
    fn lengths_are_brought_to_the_drawing_and_a_wrong_one_leaves_the_others_alone() {
        let spec = RobotSpec::reference();
        let calibration = Calibration::virtual_rig();
        let geometry = Geometry::calibrated(&spec, &calibration);
        // Arcs, displaced by some millimetres.
        let arc = |ypr_deg: [f64; 3], long_m: f64, off_m: [f64; 3]| {
            let turn = bent(ypr_deg, [0.0; 3]).rotation;
            let along_m = turn.powf(0.5) * Vector3::new(0.0, 0.0, -long_m);
            Pose::from_parts((along_m + Vector3::from(off_m)).into(), turn)
        };
        let relative = [
            arc([0.0, 14.0, -9.0], 0.165, [2e-3, -3e-3, 1e-3]),
            arc([3.0, -11.0, 6.0], 0.140, [-1e-3, 2e-3, 0.0]),
        ];
        let turns = pads(&spec, &relative).map(|pad| pad.rotation);
        let of = |calibrated: bool| -> [f64; 2 * LEGS] {
            let each = [0, 1].map(|k| match calibrated {
                true => Segment::calibrated(&spec, &calibration, k).lengths_m(&relative[k]),
                false => Segment::of(&spec, k).lengths_m(&relative[k]),
            });
            std::array::from_fn(|i| each[i / LEGS][i % LEGS])
        };
        let mut real_m = of(true);
        let brought_m = geometry.lengths_of_drawing(&spec, &real_m, &turns);
        let off_m = |a: &[f64], b: &[f64]| {
            let each = a.iter().zip(b).map(|(a, b)| (a - b).abs());
            each.fold(0.0, f64::max)
        };
        let (left_m, before_m) = (off_m(&brought_m, &of(false)), off_m(&real_m, &of(false)));
        assert!(before_m > 0.5e-3 && left_m < 0.06e-3, "{before_m} {left_m}");
        for wrong_m in [f64::NAN, real_m[7] + 20e-3] {
            real_m[7] = wrong_m;
            let others_m = geometry.lengths_of_drawing(&spec, &real_m, &turns);
            assert_eq!(others_m[..6], brought_m[..6]);
            let off_m = off_m(&others_m[8..], &brought_m[8..]);
            assert!(off_m < 0.02e-3, "{off_m}");
        }
    }

    #[test]
    fn rest_lengths_are_those_of_the_robot() {
        let lengths = segment().lengths_m(&segment().rest());
        for l in lengths {
            // √(145² + (2 · 75 · sin 20°)²) mm
            assert!((l - 0.153_808).abs() < 1e-6, "{l}");
        }
    }

    #[test]
    fn jacobian_is_the_derivative_and_well_conditioned() {
        let s = segment();
        let pose = bent([8.0, 25.0, -15.0], [0.03, -0.02, -0.13]);
        let j = s.jacobian(&pose);
        let h = 1e-6;
        for k in 0..6 {
            let mut plus = pose;
            let mut minus = pose;
            if k < 3 {
                plus.translation.vector[k] += h;
                minus.translation.vector[k] -= h;
            } else {
                let mut w = Vector3::zeros();
                w[k - 3] = h / LEVER_M;
                plus.rotation = UnitQuaternion::from_scaled_axis(w) * plus.rotation;
                minus.rotation = UnitQuaternion::from_scaled_axis(-w) * minus.rotation;
            }
            let (a, b) = (s.lengths_m(&plus), s.lengths_m(&minus));
            for i in 0..LEGS {
                let d = (a[i] - b[i]) / (2.0 * h);
                assert!((d - j[(i, k)]).abs() < 1e-7, "{i} {k}: {d} {}", j[(i, k)]);
            }
        }
        for (z, condition) in [(0.080, 2.43), (0.145, 4.29), (0.220, 6.48)] {
            let s = s
                .jacobian(&bent([0.0; 3], [0.0, 0.0, -z]))
                .singular_values();
            assert!((s.max() / s.min() - condition).abs() < 0.02, "{z}: {s}");
        }
    }

    #[test]
    fn missing_leg_is_made_up_for_by_the_imu_rotation() {
        let s = segment();
        let truth = bent([5.0, 30.0, 10.0], [0.04, 0.01, -0.14]);
        let mut known = Known {
            length_m: s.lengths_m(&truth).map(Some),
            upper_from_lower: Some(truth.rotation),
        };
        known.length_m[4] = None;
        let found = solve(&s, &known, &s.rest());
        assert!(found.converged);
        let off = found.upper_from_lower.translation.vector - truth.translation.vector;
        assert!(off.norm() < 1e-6, "{off}");
        // Nothing known: stays where it was.
        let found = solve(&s, &Known::default(), &truth);
        assert!(found.converged && found.upper_from_lower == truth);
    }

    #[test]
    fn pads_stack_with_the_middle_pad_between() {
        let spec = RobotSpec::reference();
        let rest = segment().rest();
        let [middle, end] = pads(&spec, &[rest, rest]);
        assert_eq!(middle.translation.vector.z, -0.145);
        assert!((end.translation.vector.z + 0.300).abs() < 1e-12);
    }

    proptest! {
        #[test]
        fn pose_comes_back_from_lengths(
            ypr in prop::array::uniform3(-35.0f64..35.0),
            xy in prop::array::uniform2(-0.05f64..0.05),
            z in -0.21f64..-0.09,
        ) {
            let s = segment();
            let yaw = ypr[0] * 0.5;
            let truth = bent([yaw, ypr[1], ypr[2]], [xy[0], xy[1], z]);
            // Beside a singular pose lies another one with the same lengths.
            prop_assume!(s.jacobian(&truth).singular_values().min() > 0.1);
            let near = bent([yaw + 3.0, ypr[1] - 2.0, ypr[2]], [xy[0], xy[1] + 0.005, z - 0.01]);
            let known = Known { length_m: s.lengths_m(&truth).map(Some), upper_from_lower: None };
            let found = solve(&s, &known, &near);
            prop_assert!(found.converged && found.residual_m < 1e-7);
            let off = found.upper_from_lower.translation.vector - truth.translation.vector;
            prop_assert!(off.norm() < 1e-5, "{}", off);
            prop_assert!(found.upper_from_lower.rotation.angle_to(&truth.rotation) < 1e-4);
        }

        /// Lengths that no pose has must not upset it.
        #[test]
        fn absurd_lengths_do_not_panic(lengths in prop::array::uniform6(0.0f64..10.0)) {
            let s = segment();
            let known = Known { length_m: lengths.map(Some), upper_from_lower: None };
            let found = solve(&s, &known, &s.rest());
            prop_assert!(found.upper_from_lower.translation.vector.iter().all(|x| x.is_finite()));
        }
    }
}
