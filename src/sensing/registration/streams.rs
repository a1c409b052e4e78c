//! Registration from two streams: the offset with the frames, then poses spread over the motion.

use super::clock::{ClockOffset, Fine, Streams};
use super::correlate::ClockOptions;
use super::correlate::peak;
use super::fit::Observation;
use super::held_out::register_blocks;
use super::{FitOptions, FrameFit, POSES_MIN, PosePair, RegistrationError};
use crate::signal::Pose;

/// Slices of time, each of which offers its slowest instant.
const SLICES: usize = 120;
/// Poses at most.
const POSES_MAX: usize = 40;
/// Poses differ by one for each of these: 10 mm, 2 degrees.
const APART_M: f64 = 0.01;
const APART_RAD: f64 = 2.0 * std::f64::consts::PI / 180.0;
/// Poses nearer to each other than this are the same pose: 3 mm, or 0.6 degrees.
const SAME: f64 = 0.3;
/// What a rate of 1 rad/s counts for against a speed, m.
const LEVER_M: f64 = 0.1;
/// Poses to a block of time, about.
const BLOCK_POSES: usize = 4;
const BLOCKS: [usize; 2] = [5, 10];

/// How streams are registered.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StreamOptions {
    /// The frames.
    pub fit: FitOptions,
    /// The clock.
    pub clock: ClockOptions,
}

/// Frames and offset from two streams.
#[derive(Clone, Debug, PartialEq)]
pub struct StreamRegistration {
    /// The clock offset, fitted together with the frames over all instants that both streams show.
    pub clock: ClockOffset,
    /// The frames by the poses picked; each is predicted from those of other blocks of time.
    pub fit: FrameFit,
    /// The poses picked, in order of time.
    pub pairs: Vec<PosePair>,
    /// When they were, by the robot's clock, s.
    pub t_s: Vec<f64>,
    /// Which block of time each belongs to.
    pub blocks: Vec<usize>,
}

/// Registers two streams (as in [`super::clock_offset`]): finds the offset, picks up to 40 poses, slow
/// ones that lie far apart in place and orientation, and fits the frames to them.
///
/// # Errors
/// [`RegistrationError`] as [`super::clock_offset`] and [`super::register`].
pub fn register_streams(
    robot: &[(f64, Pose)],
    mocap: &[(f64, Option<Pose>)],
    options: &StreamOptions,
) -> Result<StreamRegistration, RegistrationError> {
    options.fit.check()?;
    let streams = Streams::new(robot, mocap, &options.clock)?;
    let coarse = peak(&streams.robot, &streams.mocap, None, &options.clock)?;
    let Fine { clock, instants } = streams.fine(&coarse, None, &options.fit)?;
    let offered = slowest(&streams, &instants, clock.offset_s);
    let mut picked = far_apart(&offered);
    if picked.len() < POSES_MIN {
        return Err(RegistrationError::TooFew {
            poses: picked.len(),
        });
    }
    picked.sort_by(|a, b| a.0.total_cmp(&b.0));
    let pairs: Vec<PosePair> = picked
        .iter()
        .map(|(_, o)| PosePair {
            base_from_tip: o.base_from_tip,
            world_from_object: o.world_from_object,
        })
        .collect();
    let count = (pairs.len() / BLOCK_POSES).clamp(BLOCKS[0], BLOCKS[1]);
    let blocks: Vec<usize> = (0..pairs.len()).map(|i| i * count / pairs.len()).collect();
    let fit = register_blocks(&pairs, &blocks, &options.fit)?;
    Ok(StreamRegistration {
        clock,
        fit,
        t_s: picked.iter().map(|p| p.0).collect(),
        pairs,
        blocks,
    })
}

/// The slowest instant of each slice of time: there an error of the offset costs least.
fn slowest(streams: &Streams, instants: &[f64], offset_s: f64) -> Vec<(f64, Observation)> {
    let speed = |o: &Observation| o.velocity_m_s.norm() + LEVER_M * o.rate_rad_s.norm();
    let length = instants.len().div_ceil(SLICES).max(1);
    instants
        .chunks(length)
        .filter_map(|slice| {
            let seen = slice
                .iter()
                .filter_map(|t| streams.observe(*t, offset_s).map(|o| (*t, o)));
            seen.min_by(|a, b| speed(&a.1).total_cmp(&speed(&b.1)))
        })
        .collect()
}

/// Picks, one after the other, the pose that is farthest from all picked ones (Gonzalez 1985,
/// <https://doi.org/10.1016/0304-3975(85)90224-5>), until they are many or the rest are repeats.
fn far_apart(offered: &[(f64, Observation)]) -> Vec<(f64, Observation)> {
    let apart = |a: &Observation, b: &Observation| {
        let (a, b) = (&a.base_from_tip, &b.base_from_tip);
        let distance_m = (a.translation.vector - b.translation.vector).norm();
        let angle_rad = a.rotation.angle_to(&b.rotation);
        (distance_m / APART_M).hypot(angle_rad / APART_RAD)
    };
    let mut distance = vec![f64::INFINITY; offered.len()];
    let mut picked = Vec::new();
    while picked.len() < POSES_MAX {
        let farthest = (0..offered.len()).max_by(|a, b| distance[*a].total_cmp(&distance[*b]));
        let Some(next) = farthest.filter(|k| distance[*k] > SAME) else {
            break;
        };
        picked.push(offered[next]);
        for (d, o) in distance.iter_mut().zip(offered) {
            *d = d.min(apart(&o.1, &offered[next].1));
        }
    }
    picked
}
