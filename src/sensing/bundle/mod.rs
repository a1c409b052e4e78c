//! Calibration of what is constant, from recorded motion: one bundle adjustment.
//!
//! Windows of slow motion are the frames. Unknown are the poses of the middle and the end pad in every frame, and what is
//! the same in all of them, each with a prior about the calibration in use:
//!
//! | symbol | parameters | prior, one sigma |
//! |---|---|---|
//! | a_i, b_i | ends of spring i: upper and lower, in its pad's frame | 0.5 mm per axis |
//! | g_i | gain of spring i | 0.3 % |
//! | m_j | mounting of IMU j: pad from IMU = exp(m_j) times the calibrated one | 0.3 deg |
//! | β_j | bias of accelerometer j, and of gyro j | 0.03 m/s², 2 deg/s; more where no IMU was calibrated |
//! | γ_j | gains of accelerometer j and of gyro j, per axis | 0.3 %; 3 % where no IMU was calibrated |
//! | τ | base tilt | 0.15 deg; 2 deg where no IMU was calibrated |
//! | T | markers' body on the end pad, with motion capture | 1 mm, 0.5 deg |
//!
//! Measured are twelve lengths, four specific forces, the turn of each IMU from one frame to the next by its gyro, and
//! the pose of the end pad where motion capture recorded it (module `measure`). Turns couple neighbours, so the normal matrix
//! is block-tridiagonal with a border of what is constant; module `solve` eliminates the frames one after the other.
//!
//! A group of parameters is kept only where it pays on blocks of time that it was not fitted to (module `hold_out`).

mod frames;
mod hold_out;
mod measure;
mod report;
mod solve;
#[cfg(test)]
mod tests;

use nalgebra::{UnitQuaternion, Vector3};

use super::calibration::Calibration;
use super::filter::ACCEL_BIAS_SD;
use crate::robot::RobotSpec;
use crate::signal::{IMUS, SPRINGS};
pub use frames::{Frame, Link, Sample, Take, frames};
pub use hold_out::GroupVerdict;
use measure::Model;
pub use report::Parameter;
use solve::{Fit, Problem};

/// Offsets of the constant parameters.
const ENDS: usize = 0;
const GAINS: usize = ENDS + 6 * SPRINGS;
const MOUNTS: usize = GAINS + SPRINGS;
const ACCELS: usize = MOUNTS + 3 * IMUS;
const GYROS: usize = ACCELS + 3 * IMUS;
const ACCEL_GAINS: usize = GYROS + 3 * IMUS;
const GYRO_GAINS: usize = ACCEL_GAINS + 3 * IMUS;
const TILT: usize = GYRO_GAINS + 3 * IMUS;
const MARKERS: usize = TILT + 2;
/// Number of constant parameters.
pub const CONSTANTS: usize = MARKERS + 6;

/// Fewest frames of an adjustment.
pub const FRAMES_MIN: usize = 60;
/// Fewest blocks of time: two thirds are fitted to, the others judge.
pub const BLOCKS_MIN: usize = 6;

const DEG: f64 = std::f64::consts::PI / 180.0;

/// Parameters that are kept or discarded together.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Group {
    /// Ends of the springs.
    Ends,
    /// Mountings of the IMUs.
    Mountings,
    /// Base tilt.
    Tilt,
    /// Biases of accelerometers and gyros.
    Biases,
    /// Gains of the springs.
    Gains,
}

impl Group {
    /// In the order in which they are tried.
    pub const ALL: [Self; 5] = [
        Self::Ends,
        Self::Mountings,
        Self::Tilt,
        Self::Biases,
        Self::Gains,
    ];

    /// Name for reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::Ends => "spring ends",
            Self::Mountings => "mountings",
            Self::Tilt => "base tilt",
            Self::Biases => "biases",
            Self::Gains => "spring gains",
        }
    }

    /// Group of a constant parameter; none for the markers' body, which no calibration holds.
    fn of(index: usize) -> Option<Self> {
        match index {
            ENDS..GAINS => Some(Self::Ends),
            GAINS..MOUNTS => Some(Self::Gains),
            MOUNTS..ACCELS => Some(Self::Mountings),
            ACCELS..TILT => Some(Self::Biases),
            TILT..MARKERS => Some(Self::Tilt),
            _ => None,
        }
    }
}

/// Constant parameters that are free with these groups: biases and gains of the gyros and the markers' body always are.
fn free_of(groups: &[Group], with_cameras: bool) -> Vec<usize> {
    (0..CONSTANTS)
        .filter(|index| match Group::of(*index) {
            None => with_cameras,
            Some(group) => {
                let of_gyro =
                    (GYROS..ACCEL_GAINS).contains(index) || (GYRO_GAINS..TILT).contains(index);
                groups.contains(&group) || of_gyro
            }
        })
        .collect()
}

/// Prior standard deviations of the constant parameters about the calibration in use.
fn priors(calibration: &Calibration) -> [f64; CONSTANTS] {
    let calibrated = |i: usize| calibration.imus.iter().any(|m| m.imu == i + 1);
    let any = (0..IMUS).any(calibrated);
    std::array::from_fn(|index| match index {
        ENDS..GAINS => 0.5e-3,
        GAINS..MOUNTS => 3e-3,
        MOUNTS..ACCELS => 0.3 * DEG,
        ACCELS..GYROS if calibrated((index - ACCELS) / 3) => ACCEL_BIAS_SD,
        ACCELS..GYROS => 0.3,
        GYROS..ACCEL_GAINS if calibrated((index - GYROS) / 3) => 2.0 * DEG,
        GYROS..ACCEL_GAINS => 20.0 * DEG,
        ACCEL_GAINS..TILT if calibrated((index - ACCEL_GAINS) / 3 % IMUS) => 3e-3,
        ACCEL_GAINS..TILT => 0.03,
        TILT..MARKERS if any => 0.15 * DEG,
        TILT..MARKERS => 2.0 * DEG,
        _ if index < MARKERS + 3 => 1e-3,
        _ => 0.5 * DEG,
    })
}

/// Why there is no adjustment.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum BundleError {
    /// Too little slow motion.
    #[error(
        "only {frames} windows of slow motion in {blocks} blocks of 10 s; at least {FRAMES_MIN} in {BLOCKS_MIN} are \
         needed: record two minutes or more of slow motion to all sides"
    )]
    TooFew {
        /// Windows found.
        frames: usize,
        /// Blocks of time that they are in.
        blocks: usize,
    },
    /// The normal equations have no solution.
    #[error(
        "the adjustment does not converge: check that the springs are plugged as in the robot file"
    )]
    Diverged,
    /// A mounting beyond what a calibration file may hold.
    #[error(
        "IMU {imu} sits {:.1} degrees off its nominal mounting, more than 5.7; correct mounting_ypr_deg in the robot file",
        off_rad.to_degrees()
    )]
    Mounting {
        /// IMU, 1-based.
        imu: usize,
        /// Angle, rad.
        off_rad: f64,
    },
}

/// Result of an adjustment.
#[derive(Clone, Debug)]
pub struct Adjustment {
    /// The calibration with the groups that were kept.
    pub calibration: Calibration,
    /// Per group, whether it was kept and why.
    pub groups: Vec<GroupVerdict>,
    /// Every constant parameter.
    pub parameters: Vec<Parameter>,
    /// Frames used.
    pub frames: usize,
    /// Number of blocks of 10 s, and of those held out.
    pub blocks: [usize; 2],
    /// Whether motion capture of the end pad was used.
    pub with_cameras: bool,
    /// √(χ² per degree of freedom) of the last fit: 1 where the stated noise is what there is.
    pub misfit: f64,
}

impl Adjustment {
    /// Whether any group was kept.
    pub fn keeps_any(&self) -> bool {
        self.groups.iter().any(|g| g.kept)
    }

    /// Whether ends of springs were kept, so that lengths for the networks change.
    pub fn keeps_ends(&self) -> bool {
        self.groups.iter().any(|g| g.kept && g.group == Group::Ends)
    }
}

/// Adjusts the calibration that `takes` were read by to them.
///
/// # Errors
/// [`BundleError`] for too little motion, or where no adjustment fits.
pub fn adjust(
    spec: &RobotSpec,
    calibration: &Calibration,
    takes: &[Take],
) -> Result<Adjustment, BundleError> {
    let model = Model::new(spec, calibration);
    let mut frames = frames(&model.spec, &model.geometry.segments, takes);
    if frames.iter().all(|f| f.tip.is_none()) {
        correlate(&mut frames);
    }
    adjust_frames(&model, calibration, &frames)
}

/// Frames that count as independent where no motion capture contradicts them: what the lengths' curves and the IMUs have
/// wrong changes slowly with the pose, and hundreds of frames do not average it.
const INDEPENDENT: f64 = 20.0;

/// Widens the measurements of frames that are correlated.
fn correlate(frames: &mut [Frame]) {
    let by = (frames.len() as f64 / INDEPENDENT).sqrt().max(1.0);
    for frame in frames {
        frame.length_m.iter_mut().flatten().for_each(|l| l[1] *= by);
        frame.force.iter_mut().flatten().for_each(|f| f.1 *= by);
        frame.link.iter_mut().flatten().for_each(|l| l.sd_rad *= by);
    }
}

/// As [`adjust`], from the frames.
fn adjust_frames(
    model: &Model,
    calibration: &Calibration,
    frames: &[Frame],
) -> Result<Adjustment, BundleError> {
    let (blocks, held_out) = hold_out::split(frames);
    if frames.len() < FRAMES_MIN || blocks.len() < BLOCKS_MIN {
        return Err(BundleError::TooFew {
            frames: frames.len(),
            blocks: blocks.len(),
        });
    }
    let with_cameras = frames.iter().any(|f| f.tip.is_some());
    let prior = priors(calibration);
    let problem = Problem::new(model, frames, &prior);
    let groups = hold_out::choose(&problem, &held_out, with_cameras)?;
    let all: Vec<usize> = (0..frames.len()).collect();
    let whole = problem.fit(&all, &free_of(&Group::ALL, with_cameras), with_cameras)?;
    let kept: Vec<Group> = groups.iter().filter(|g| g.kept).map(|g| g.group).collect();
    let last = problem.fit(&all, &free_of(&kept, with_cameras), with_cameras)?;
    let parameters = report::parameters(&problem, &whole, &last, &kept, with_cameras)?;
    Ok(Adjustment {
        calibration: applied(&problem, calibration, [&whole, &last], &kept)?,
        groups,
        parameters,
        frames: frames.len(),
        blocks: [blocks.len(), held_out.len()],
        with_cameras,
        misfit: last.misfit(),
    })
}

/// Whether the fit of everything (`whole`) finds the biases of accelerometer `i` within what is assumed of a calibrated one.
fn is_confirmed(problem: &Problem<'_>, whole: &Fit, i: usize) -> bool {
    (ACCELS + 3 * i..ACCELS + 3 * i + 3).all(|index| {
        let is_known = |sigma: f64| sigma < report::OBSERVABLE * problem.prior[index];
        whole.state.constants[index].abs() < 3.0 * ACCEL_BIAS_SD
            && whole.sigma(index).is_some_and(is_known)
    })
}

/// The calibration with these groups of the last of two fits; `whole` has all of them. An IMU that nothing was known of and
/// that needs no correction gets an entry without one: from now on it is a calibrated IMU.
fn applied(
    problem: &Problem<'_>,
    calibration: &Calibration,
    [whole, fit]: [&Fit; 2],
    kept: &[Group],
) -> Result<Calibration, BundleError> {
    let x = &fit.state.constants;
    let three = |at: usize| Vector3::new(x[at], x[at + 1], x[at + 2]);
    let mut out = calibration.clone();
    let (rest, samples) = (problem.model.rest_pads(), problem.frames.len());
    if kept.contains(&Group::Ends) {
        for s in &mut out.springs {
            if let Some(i) = s.spring.checked_sub(1).filter(|i| *i < SPRINGS) {
                s.ends_off_m[0] += three(ENDS + 6 * i);
                s.ends_off_m[1] += three(ENDS + 6 * i + 3);
                let known = report::length_by_ends(problem, fit, &rest, i);
                s.ends_sd_m = known.map(|[_, sd_m, _]| sd_m);
            }
        }
    }
    if kept.contains(&Group::Gains) {
        let gains = std::array::from_fn(|i| [1.0 + x[GAINS + i], 0.0]);
        out = out.corrected(&gains, &[UnitQuaternion::identity(); IMUS]);
    }
    if kept.contains(&Group::Tilt) {
        for (tilt, more) in out.base_tilt_rad.iter_mut().zip(&x[TILT..MARKERS]) {
            *tilt += more;
        }
    }
    let (mountings, biases) = (
        kept.contains(&Group::Mountings),
        kept.contains(&Group::Biases),
    );
    for i in 0..IMUS {
        let fresh = !out.imus.iter().any(|m| m.imu == i + 1);
        if !(mountings || biases || fresh && is_confirmed(problem, whole, i)) {
            continue;
        }
        if mountings || fresh {
            let turn = match mountings {
                true => three(MOUNTS + 3 * i),
                false => Vector3::zeros(),
            };
            let mut entry = out.imu_entry(i);
            let turned = UnitQuaternion::from_scaled_axis(turn) * out.mounting(i);
            entry.fit.correction_rad = turned.scaled_axis();
            entry.fit.samples = samples;
            let off_rad = entry.fit.correction_rad.norm();
            out.set_imu(entry).map_err(|_| BundleError::Mounting {
                imu: i + 1,
                off_rad,
            })?;
        }
        let Some(entry) = out.imus.iter_mut().find(|m| m.imu == i + 1) else {
            continue;
        };
        // An IMU without an entry before had no zero of its gyro.
        if biases || fresh {
            entry.zero.gyro_bias_rad_s += three(GYROS + 3 * i);
        }
        if biases {
            let more = three(ACCELS + 3 * i).component_mul(&entry.zero.accel_gain);
            entry.zero.accel_bias_m_s2 += more;
            let gains = three(ACCEL_GAINS + 3 * i).add_scalar(1.0);
            entry.zero.accel_gain.component_mul_assign(&gains);
        }
    }
    Ok(out)
}
