//! What each measurement of a frame should be, and its derivative.
//!
//! With p, R the pose of a pad (errors: p + δ, exp(θ) R), P = pad_from_imu, L = level_from_base, u = Lᵀ z:
//!
//! l_i = (1 + g_i) |p + R b_i − p' − R' a_i|,   f_j = (1 + γ_j) P⁻¹ Rᵀ u g + β_j,
//!
//! log(Γ⁻¹ P⁻¹ R_kᵀ R_{k+1} P) + D β + J (log Γ − D β) γ / (1 + γ) = 0 for the turn Γ of an IMU by its gyro, and R T for motion capture.

use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};

use super::frames::{Frame, Link};
use super::{
    ACCEL_GAINS, ACCELS, CONSTANTS, ENDS, GAINS, GYRO_GAINS, GYROS, MARKERS, MOUNTS, TILT,
};
use crate::robot::RobotSpec;
use crate::sensing::calibration::Calibration;
use crate::sensing::filter::G_M_S2;
use crate::sensing::platform::{Geometry, LEGS, Segment, pads};
use crate::signal::Pose;

/// Unknowns of a frame: position (m) and rotation vector (rad, base frame) of the middle pad, then of the end pad.
pub const POSES: usize = 12;
/// Standard deviations of motion capture: position, m, and orientation, rad.
pub const TIP_SD: [f64; 2] = [0.2e-3, 0.05 * super::DEG];
/// Most constant parameters that a measurement depends on.
const ENTRIES: usize = 9;

/// Constant parameters, differences from the calibration in use, in SI units: ends of the springs (six each), gains of the
/// springs, mountings, biases of accelerometers, of gyros, gains of accelerometers, of gyros (three each), tilt, markers.
pub type Constants = [f64; CONSTANTS];

/// One scalar measurement.
#[derive(Clone, Copy, Debug)]
pub struct Row {
    /// Measured less predicted, in standard deviations.
    pub residual: f64,
    /// Derivative of the prediction after the frame's poses, in standard deviations per m and rad.
    pub this: [f64; POSES],
    /// The same after the next frame's poses; `None` where they have no part in it.
    pub next: Option<[f64; POSES]>,
    constants: [(usize, f64); ENTRIES],
    count: usize,
}

impl Row {
    fn new(residual: f64) -> Self {
        Self {
            residual,
            this: [0.0; POSES],
            next: None,
            constants: [(0, 0.0); ENTRIES],
            count: 0,
        }
    }

    fn pose3(&mut self, at: usize, by: &Vector3<f64>) {
        for k in 0..3 {
            self.this[at + k] += by[k];
        }
    }

    fn next3(&mut self, at: usize, by: &Vector3<f64>) {
        let next = self.next.get_or_insert([0.0; POSES]);
        for k in 0..3 {
            next[at + k] += by[k];
        }
    }

    fn constant(&mut self, index: usize, by: f64) {
        debug_assert!(self.count < ENTRIES);
        if let Some(entry) = self.constants.get_mut(self.count) {
            *entry = (index, by);
            self.count += 1;
        }
    }

    fn constant3(&mut self, index: usize, by: &Vector3<f64>) {
        for k in 0..3 {
            self.constant(index + k, by[k]);
        }
    }

    /// Index and derivative of each constant parameter that has a part in it.
    pub fn constants(&self) -> &[(usize, f64)] {
        &self.constants[..self.count]
    }

    fn scaled(mut self, by: f64) -> Self {
        self.residual *= by;
        for x in self.this.iter_mut().chain(self.next.iter_mut().flatten()) {
            *x *= by;
        }
        for (_, x) in &mut self.constants {
            *x *= by;
        }
        self
    }
}

/// Where springs end and IMUs sit by the calibration in use.
#[derive(Clone, Debug)]
pub struct Model {
    pub(super) spec: RobotSpec,
    pub(super) geometry: Geometry,
    base_tilt_rad: [f64; 2],
}

/// exp(v) as a matrix.
fn exp(v: &Vector3<f64>) -> Matrix3<f64> {
    Rotation3::from_scaled_axis(*v).into_inner()
}

/// J of exp(v + δ) = exp(J δ) exp(v), to second order in v.
fn left_jacobian(v: &Vector3<f64>) -> Matrix3<f64> {
    let x = v.cross_matrix();
    Matrix3::identity() + x * 0.5 + x * x / 6.0
}

fn three(x: &Constants, at: usize) -> Vector3<f64> {
    Vector3::new(x[at], x[at + 1], x[at + 2])
}

impl Model {
    /// Of a robot with the calibration in use.
    pub fn new(spec: &RobotSpec, calibration: &Calibration) -> Self {
        Self {
            geometry: Geometry::calibrated(spec, calibration),
            base_tilt_rad: calibration.base_tilt_rad,
            spec: spec.clone(),
        }
    }

    /// Middle and end pad at rest.
    pub(super) fn rest_pads(&self) -> [Pose; 2] {
        pads(
            &self.spec,
            &self.geometry.segments.each_ref().map(Segment::rest),
        )
    }

    /// Length that spring `i` reads, m, and its row, not scaled.
    pub(super) fn length(&self, x: &Constants, pads: &[Pose; 2], i: usize) -> (f64, Row) {
        let lower = i / LEGS;
        let (low, at) = (&pads[lower], ENDS + 6 * i);
        let low_arm_m = low.rotation * (self.geometry.bottom_m[i] + three(x, at + 3));
        let top_m = self.geometry.top_m[i] + three(x, at);
        let up = lower.checked_sub(1).map(|u| &pads[u]);
        let up_arm_m = up.map_or(top_m, |p| p.rotation * top_m);
        let from_m = up.map_or(up_arm_m, |p| p.translation.vector + up_arm_m);
        let d = low.translation.vector + low_arm_m - from_m;
        let length_m = d.norm();
        let along = d / length_m.max(1e-6);
        let gain = 1.0 + x[GAINS + i];
        let mut row = Row::new(0.0);
        row.pose3(6 * lower, &(along * gain));
        row.pose3(6 * lower + 3, &(low_arm_m.cross(&along) * gain));
        let mut above = along;
        if let Some(p) = up {
            row.pose3(0, &(-along * gain));
            row.pose3(3, &(-up_arm_m.cross(&along) * gain));
            above = p.rotation.inverse() * along;
        }
        row.constant3(at, &(-above * gain));
        row.constant3(at + 3, &(low.rotation.inverse() * along * gain));
        row.constant(GAINS + i, length_m);
        (gain * length_m, row)
    }

    /// Specific force that IMU `j` reads at rest, m/s², and its rows, not scaled.
    pub(super) fn force(
        &self,
        x: &Constants,
        pads: &[Pose; 2],
        j: usize,
    ) -> (Vector3<f64>, [Row; 3]) {
        let p = self.geometry.pad_of_imu[j];
        let [tx, ty] = self.base_tilt_rad;
        let tilt = Vector3::new(tx + x[TILT], ty + x[TILT + 1], 0.0);
        let base_from_level = exp(&-tilt);
        let up = base_from_level * Vector3::z() * G_M_S2;
        let mount = three(x, MOUNTS + 3 * j);
        let imu_from_pad = (exp(&mount) * self.geometry.pad_from_imu[j].matrix()).transpose();
        let pad_from_base = pads[p].rotation.inverse().to_rotation_matrix().into_inner();
        let imu_from_base = imu_from_pad * pad_from_base;
        let in_pad = pad_from_base * up;
        let by_turn = imu_from_base * up.cross_matrix();
        let by_mount = imu_from_pad * in_pad.cross_matrix() * left_jacobian(&mount);
        let by_tilt = imu_from_base
            * base_from_level
            * (Vector3::z() * G_M_S2).cross_matrix()
            * left_jacobian(&tilt);
        let felt = imu_from_base * up;
        let gain = three(x, ACCEL_GAINS + 3 * j).add_scalar(1.0);
        let rows = [0, 1, 2].map(|k| {
            let mut row = Row::new(0.0);
            row.pose3(6 * p + 3, &(by_turn.row(k).transpose() * gain[k]));
            row.constant3(MOUNTS + 3 * j, &(by_mount.row(k).transpose() * gain[k]));
            row.constant(ACCEL_GAINS + 3 * j + k, felt[k]);
            row.constant(ACCELS + 3 * j + k, 1.0);
            row.constant(TILT, by_tilt[(k, 0)] * gain[k]);
            row.constant(TILT + 1, by_tilt[(k, 1)] * gain[k]);
            row
        });
        (felt.component_mul(&gain) + three(x, ACCELS + 3 * j), rows)
    }

    /// By how much the turn of IMU `j` to the next frame differs from its gyro's, rad, and its rows, not scaled.
    pub(super) fn turn(
        &self,
        x: &Constants,
        pads: &[Pose; 2],
        next: &[Pose; 2],
        j: usize,
        link: &Link,
    ) -> (Vector3<f64>, [Row; 3]) {
        let p = self.geometry.pad_of_imu[j];
        let mount = three(x, MOUNTS + 3 * j);
        let pad_from_imu = exp(&mount) * self.geometry.pad_from_imu[j].matrix();
        let matrix = |pose: &Pose| pose.rotation.to_rotation_matrix().into_inner();
        let (here, there) = (matrix(&pads[p]), matrix(&next[p]));
        let pad_turn = here.transpose() * there;
        let predicted = pad_from_imu.transpose() * pad_turn * pad_from_imu;
        let measured = link.turn.to_rotation_matrix().into_inner();
        let off = Rotation3::from_matrix_unchecked(measured.transpose() * predicted);
        let off = UnitQuaternion::from_rotation_matrix(&off).scaled_axis();
        // A rate of constant direction, read (1 + γ) times: exp(−(1 + γ) r) exp(r), with (1 + γ) r measured beside the bias.
        let by_bias = link.by_bias_s * three(x, GYROS + 3 * j);
        let turn = link.turn.scaled_axis() - by_bias;
        let gain = three(x, GYRO_GAINS + 3 * j);
        let share = gain.map(|g| g / (1.0 + g));
        let along_turn = left_jacobian(&-turn);
        let over_turn = along_turn * Matrix3::from_diagonal(&turn);
        // Up to the square of the turn: J_l(−r − δ) = J_l(−r) − ½ [δ]×
        let by_rate = along_turn * Matrix3::from_diagonal(&share)
            + 0.5 * turn.component_mul(&share).cross_matrix();
        let after_bias = (Matrix3::identity() - by_rate) * link.by_bias_s;
        let by_gain = over_turn * Matrix3::from_diagonal(&gain.map(|g| (1.0 + g).powi(-2)));
        // log(exp(e) exp(η)) = e + J_r⁻¹(e) η
        let after = left_jacobian(&-off).try_inverse().unwrap_or_default();
        let by_turn = after * (there * pad_from_imu).transpose();
        let by_mount = after
            * pad_from_imu.transpose()
            * (Matrix3::identity() - pad_turn.transpose())
            * left_jacobian(&mount);
        let rows = [0, 1, 2].map(|k| {
            let mut row = Row::new(0.0);
            let by = by_turn.row(k).transpose();
            row.pose3(6 * p + 3, &-by);
            row.next3(6 * p + 3, &by);
            row.constant3(MOUNTS + 3 * j, &by_mount.row(k).transpose());
            row.constant3(GYROS + 3 * j, &after_bias.row(k).transpose());
            row.constant3(GYRO_GAINS + 3 * j, &by_gain.row(k).transpose());
            row
        });
        (off + by_bias + over_turn * share, rows)
    }

    /// What motion capture measures less what it should (m, rad, base frame), and the rows, not scaled.
    pub(super) fn tip(&self, x: &Constants, pads: &[Pose; 2], seen: &Pose) -> ([f64; 6], [Row; 6]) {
        let end = &pads[1];
        let turn = end.rotation.to_rotation_matrix().into_inner();
        let arm_m = turn * three(x, MARKERS);
        let markers = three(x, MARKERS + 3);
        let predicted = end.rotation * UnitQuaternion::from_scaled_axis(markers);
        let off_m = seen.translation.vector - end.translation.vector - arm_m;
        let off_rad = (seen.rotation * predicted.inverse()).scaled_axis();
        let by_turn = -arm_m.cross_matrix();
        // log(exp(e) exp(−η)) = e − J_r⁻¹(e) η
        let after = left_jacobian(&-off_rad).try_inverse().unwrap_or_default();
        let by_markers = after * turn * left_jacobian(&markers);
        let rows = std::array::from_fn(|k| {
            let mut row = Row::new(0.0);
            if k < 3 {
                row.pose3(6, &Vector3::ith(k, 1.0));
                row.pose3(9, &by_turn.row(k).transpose());
                row.constant3(MARKERS, &turn.row(k).transpose());
            } else {
                row.pose3(9, &after.row(k - 3).transpose());
                row.constant3(MARKERS + 3, &by_markers.row(k - 3).transpose());
            }
            row
        });
        let mut off = [0.0; 6];
        off[..3].copy_from_slice(off_m.as_slice());
        off[3..].copy_from_slice(off_rad.as_slice());
        (off, rows)
    }

    /// Gives every measurement of a frame, in standard deviations; the turn to `next` where there is one.
    pub(super) fn rows(
        &self,
        x: &Constants,
        frame: &Frame,
        pads: &[Pose; 2],
        next: Option<&[Pose; 2]>,
        cameras: Cameras,
        each: &mut dyn FnMut(&Row),
    ) {
        for (i, read) in frame.length_m.iter().enumerate() {
            if let Some([read_m, sd_m]) = read {
                let (length_m, row) = self.length(x, pads, i);
                let missed = Row {
                    residual: read_m - length_m,
                    ..row
                };
                each(&missed.scaled(1.0 / sd_m));
            }
        }
        for (j, read) in frame.force.iter().enumerate() {
            if let Some((read, sd)) = read {
                let (force, rows) = self.force(x, pads, j);
                for (k, row) in rows.into_iter().enumerate() {
                    let residual = read[k] - force[k];
                    each(&Row { residual, ..row }.scaled(1.0 / sd));
                }
            }
        }
        for (j, link) in frame.link.iter().enumerate() {
            if let (Some(link), Some(next)) = (link, next) {
                let (off, rows) = self.turn(x, pads, next, j, link);
                for (k, row) in rows.into_iter().enumerate() {
                    let residual = -off[k];
                    each(&Row { residual, ..row }.scaled(1.0 / link.sd_rad));
                }
            }
        }
        let seen = match cameras {
            Cameras::Unused => None,
            Cameras::Used => frame.tip,
            Cameras::Assumed => {
                let markers = Pose::from_parts(
                    three(x, MARKERS).into(),
                    UnitQuaternion::from_scaled_axis(three(x, MARKERS + 3)),
                );
                Some(pads[1] * markers)
            }
        };
        if let Some(seen) = seen {
            let (off, rows) = self.tip(x, pads, &seen);
            for (k, row) in rows.into_iter().enumerate() {
                let residual = off[k];
                each(&Row { residual, ..row }.scaled(1.0 / TIP_SD[k / 3]));
            }
        }
    }
}

/// Motion capture in a fit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cameras {
    /// Left out.
    Unused,
    /// As recorded.
    Used,
    /// As if every frame had it, in agreement with the fit: for what it would determine.
    Assumed,
}
