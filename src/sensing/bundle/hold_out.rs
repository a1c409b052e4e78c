//! Which groups of parameters pay on blocks of time that they were not fitted to.

use nalgebra::UnitQuaternion;

use super::frames::Frame;
use super::measure::{Cameras, Constants};
use super::solve::Problem;
use super::{BundleError, Group, MARKERS, free_of};
use crate::signal::Pose;

/// One block in so many is held out.
const HELD_OUT: usize = 3;
/// A group has to lower the mean score by this share.
const PAYS: f64 = 0.01;
/// The same of the springs' gains, which ends along the springs imitate.
const PAYS_GAINS: f64 = 0.05;
/// No block's score may rise by more than this share.
const WORSE: f64 = 0.2;
/// Lever by which orientations count as distances, m.
const LEVER_M: f64 = 0.075;

/// Verdict on a group.
#[derive(Clone, Debug, PartialEq)]
pub struct GroupVerdict {
    /// The group.
    pub group: Group,
    /// Whether it was kept.
    pub kept: bool,
    /// Score of the held-out blocks without and with it (root mean square): with motion capture the error of the tip by
    /// springs and IMUs alone, m (orientations by a lever of 75 mm); without, the normalised residual.
    pub score: [f64; 2],
    /// Largest rise of one block's score, as a share of it; negative where all fall.
    pub worst_block: f64,
}

/// Numbers of all blocks, and those that are held out.
pub(super) fn split(frames: &[Frame]) -> (Vec<usize>, Vec<usize>) {
    let mut blocks: Vec<usize> = frames.iter().map(|f| f.block).collect();
    blocks.dedup();
    let held_out = blocks.iter().skip(1).step_by(HELD_OUT).copied().collect();
    (blocks, held_out)
}

/// Mean square of the score per held-out block, in order of the blocks.
fn scores(
    problem: &Problem<'_>,
    held_out: &[usize],
    constants: &Constants,
    with_cameras: bool,
) -> Result<Vec<f64>, BundleError> {
    let of = |block: usize| -> Vec<usize> {
        let all = 0..problem.frames.len();
        all.filter(|k| problem.frames[*k].block == block).collect()
    };
    let markers = Pose::from_parts(
        nalgebra::Vector3::from_column_slice(&constants[MARKERS..MARKERS + 3]).into(),
        UnitQuaternion::from_scaled_axis(nalgebra::Vector3::from_column_slice(
            &constants[MARKERS + 3..MARKERS + 6],
        )),
    );
    let mut out = Vec::new();
    for block in held_out {
        let which = of(*block);
        let fit = problem.fit_from(&which, &[], Cameras::Unused, *constants)?;
        let (mut sum, mut n) = (0.0, 0.0);
        if with_cameras {
            for (k, pads) in which.iter().zip(&fit.state.pads) {
                let Some(seen) = problem.frames[*k].tip else {
                    continue;
                };
                let tip = pads[1] * markers;
                let off_m = (tip.translation.vector - seen.translation.vector).norm();
                let off_rad = tip.rotation.angle_to(&seen.rotation);
                sum += off_m * off_m + (LEVER_M * off_rad).powi(2);
                n += 1.0;
            }
        } else {
            let each = problem.residuals(&which, &fit.state, Cameras::Unused);
            for [squares, rows] in each {
                sum += squares;
                n += rows;
            }
        }
        out.push(if n > 0.0 { sum / n } else { 0.0 });
    }
    Ok(out)
}

/// Tries the groups one after the other, each beside those that were kept.
pub(super) fn choose(
    problem: &Problem<'_>,
    held_out: &[usize],
    with_cameras: bool,
) -> Result<Vec<GroupVerdict>, BundleError> {
    let fitted: Vec<usize> = (0..problem.frames.len())
        .filter(|k| !held_out.contains(&problem.frames[*k].block))
        .collect();
    let score = |groups: &[Group]| -> Result<Vec<f64>, BundleError> {
        let fit = problem.fit(&fitted, &free_of(groups, with_cameras), with_cameras)?;
        scores(problem, held_out, &fit.state.constants, with_cameras)
    };
    let mut kept: Vec<Group> = Vec::new();
    let mut best = score(&kept)?;
    let mut out = Vec::new();
    for group in Group::ALL {
        let mut tried = kept.clone();
        tried.push(group);
        let with = score(&tried)?;
        let verdict = judge(group, &best, &with);
        if verdict.kept {
            kept = tried;
            best = with;
        }
        out.push(verdict);
    }
    Ok(out)
}

/// Whether a group pays: mean squares per block without and with it.
pub(super) fn judge(group: Group, without: &[f64], with: &[f64]) -> GroupVerdict {
    let root = |scores: &[f64]| (scores.iter().sum::<f64>() / scores.len().max(1) as f64).sqrt();
    let score = [root(without), root(with)];
    let pays = match group {
        Group::Gains => PAYS_GAINS,
        _ => PAYS,
    };
    let rises = without
        .iter()
        .zip(with)
        .filter(|(a, _)| **a > 0.0)
        .map(|(a, b)| (b / a).sqrt() - 1.0);
    let worst_block = rises.fold(f64::NEG_INFINITY, f64::max);
    GroupVerdict {
        group,
        kept: score[1] < (1.0 - pays) * score[0] && worst_block <= WORSE,
        score,
        worst_block,
    }
}
