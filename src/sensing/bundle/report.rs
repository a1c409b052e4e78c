//! What is known of each constant parameter, and what would determine the others.

use super::solve::{Fit, Problem};
use super::{
    ACCEL_GAINS, BundleError, CONSTANTS, ENDS, GAINS, GYROS, Group, MARKERS, MOUNTS, TILT, free_of,
};
use crate::signal::{IMUS, Pose, SPRINGS};

/// A parameter is observable when the data leave less than this share of its prior.
pub(super) const OBSERVABLE: f64 = 0.7;

/// One constant parameter.
#[derive(Clone, Debug, PartialEq)]
pub struct Parameter {
    /// Name, such as `spring 3, upper end, x`.
    pub name: String,
    /// Its group; `None` for the markers' body of motion capture.
    pub group: Option<Group>,
    /// Unit of the numbers below.
    pub unit: &'static str,
    /// Difference from the calibration that was in use.
    pub value: f64,
    /// Standard deviation after the adjustment.
    pub sigma: f64,
    /// Standard deviation before it.
    pub prior: f64,
    /// Whether the data determine it.
    pub observable: bool,
    /// What would, where they do not; `None` where they do, or nothing is known that would.
    pub closed_by: Option<&'static str>,
    /// Whether it is in the calibration.
    pub kept: bool,
}

const BY_CAMERAS: &str = "motion capture of the end pad";
const BY_PLACES: &str =
    "poses to all sides, short and long ones, whose tips lie 50 mm and more apart";
const BY_LENGTHS: &str = "poses from the shortest to the longest springs";
const BY_TILTS: &str = "poses with the pads tilted in different directions";
const BY_TURNS: &str = "poses with the end pad tilted in different directions";
const BY_MOTION: &str = "half a minute or more without gaps of the IMU";

/// Change of the length of spring `i` at a pose by its ends, m: value, and standard deviations after and before a fit.
pub(super) fn length_by_ends(
    problem: &Problem<'_>,
    fit: &Fit,
    pads: &[Pose; 2],
    i: usize,
) -> Option<[f64; 3]> {
    let row = problem.model.length(&fit.state.constants, pads, i).1;
    let ends: Vec<(usize, usize, f64)> = row
        .constants()
        .iter()
        .filter(|(index, _)| Group::of(*index) == Some(Group::Ends))
        .filter_map(|(index, by)| Some((*index, fit.column(*index)?, *by)))
        .collect();
    if ends.is_empty() {
        return None;
    }
    let value = ends
        .iter()
        .map(|(index, _, by)| by * fit.state.constants[*index]);
    let prior = ends
        .iter()
        .map(|(index, _, by)| (by * problem.prior[*index]).powi(2));
    let pairs = ends.iter().flat_map(|a| ends.iter().map(move |b| (a, b)));
    let variance: f64 = pairs
        .map(|((_, i, a), (_, j, b))| a * b * fit.covariance[(*i, *j)])
        .sum();
    let sd = variance.max(0.0).sqrt() * fit.misfit().max(1.0);
    Some([value.sum(), sd, prior.sum::<f64>().sqrt()])
}

/// Name, unit and size of the unit of a parameter.
fn named(index: usize) -> (String, &'static str, f64) {
    const AXES: [&str; 3] = ["x", "y", "z"];
    let degree = super::DEG;
    match index {
        ENDS..GAINS => {
            let (i, k) = (index / 6, index % 6);
            let end = ["upper", "lower"][k / 3];
            let name = format!("spring {}, {end} end, {}", i + 1, AXES[k % 3]);
            (name, "mm", 1e-3)
        }
        GAINS..MOUNTS => (format!("spring {}, gain", index - GAINS + 1), "%", 1e-2),
        MOUNTS..TILT => {
            let k = index - MOUNTS;
            let (what, unit, size) = match k / (3 * IMUS) {
                0 => ("mounting", "deg", degree),
                1 => ("accelerometer bias", "m/s2", 1.0),
                2 => ("gyro bias", "deg/s", degree),
                3 => ("accelerometer gain", "%", 1e-2),
                _ => ("gyro gain", "%", 1e-2),
            };
            let imu = k % (3 * IMUS) / 3 + 1;
            (format!("IMU {imu}, {what}, {}", AXES[k % 3]), unit, size)
        }
        TILT..MARKERS => (
            format!("base tilt about {}", AXES[index - TILT]),
            "deg",
            degree,
        ),
        _ => {
            let k = index - MARKERS;
            let (what, unit, size) = match k / 3 {
                0 => ("along", "mm", 1e-3),
                _ => ("about", "deg", degree),
            };
            (format!("markers' body, {what} {}", AXES[k % 3]), unit, size)
        }
    }
}

/// What determines a parameter that motion capture of the same motion would not.
fn motion_for(index: usize) -> &'static str {
    match index {
        ENDS..GAINS => BY_PLACES,
        GAINS..MOUNTS => BY_LENGTHS,
        MOUNTS..GYROS => BY_TILTS,
        GYROS..ACCEL_GAINS => BY_MOTION,
        ACCEL_GAINS..TILT => BY_TILTS,
        TILT..MARKERS => BY_TILTS,
        _ => BY_TURNS,
    }
}

/// All parameters, by the fit of all of them (`whole`) and by the one of those that were kept (`last`).
pub(super) fn parameters(
    problem: &Problem<'_>,
    whole: &Fit,
    last: &Fit,
    kept: &[Group],
    with_cameras: bool,
) -> Result<Vec<Parameter>, BundleError> {
    let all: Vec<usize> = (0..problem.frames.len()).collect();
    // What motion capture of this motion would leave open.
    let free = free_of(&Group::ALL, true);
    let assumed = match with_cameras {
        true => None,
        false => Some(
            problem
                .covariance_with_cameras(&all, &free, &whole.state)
                .ok_or(BundleError::Diverged)?,
        ),
    };
    let with_assumed = |index: usize| -> Option<f64> {
        let at = free.iter().position(|f| *f == index)?;
        Some(assumed.as_ref()?[(at, at)].max(0.0).sqrt())
    };
    let mut out = Vec::new();
    for index in 0..CONSTANTS {
        let Some(sigma) = whole.sigma(index) else {
            continue;
        };
        let (name, unit, size) = named(index);
        let group = Group::of(index);
        let is_kept = group.is_some_and(|g| kept.contains(&g));
        let prior = problem.prior[index];
        let observable = sigma < OBSERVABLE * prior;
        let by_cameras = with_assumed(index).is_some_and(|s| s < OBSERVABLE * prior);
        let closed_by = match by_cameras {
            true => BY_CAMERAS,
            false => motion_for(index),
        };
        let from = if is_kept { last } else { whole };
        out.push(Parameter {
            name,
            group,
            unit,
            value: from.state.constants[index] / size,
            sigma: sigma / size,
            prior: prior / size,
            observable,
            closed_by: (!observable).then_some(closed_by),
            kept: is_kept,
        });
    }
    let rest = problem.model.rest_pads();
    for i in 0..SPRINGS {
        let kept = kept.contains(&Group::Ends);
        let Some([value, sigma, prior]) = length_by_ends(problem, whole, &rest, i) else {
            continue;
        };
        let observable = sigma < OBSERVABLE * prior;
        let closed_by = if with_cameras { BY_PLACES } else { BY_CAMERAS };
        out.push(Parameter {
            name: format!("spring {}, length at rest by its ends", i + 1),
            group: Some(Group::Ends),
            unit: "mm",
            value: value * 1e3,
            sigma: sigma * 1e3,
            prior: prior * 1e3,
            observable,
            closed_by: (!observable).then_some(closed_by),
            kept,
        });
    }
    Ok(out)
}
