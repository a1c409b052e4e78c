//! The clock offset Δ: coarse by speeds, fine by the poses together with the frames.
//!
//! Fine: instants of the robot's track, the object's track at t − Δ; Gauss and Newton over the
//! frames and the rest of Δ (module `fit`), the tracks read again with each Δ. One sigma is the
//! jackknife over ten blocks of time, each left out in the linearised problem,
//! σ² = (m − 1)/m Σ (Δ₋ₖ − mean)² (Wu 1986, <https://doi.org/10.1214/aos/1176350142>): errors of the
//! robot's pose last for seconds, which the normal matrix would not know. By how much its poses trail behind on their way
//! ([`ClockOptions::trails_m`]) is added.

use super::correlate::{ClockOptions, HALF_S, Peak, peak};
use super::fit::{self, DELAY, Normal, Observation, State, UNITS, Unknowns, centre};
use super::held_out::fit_from_guesses;
use super::track::Track;
use super::{FitOptions, Frames, ObjectFrame, RegistrationError, is_pose};
use crate::signal::Pose;

/// Poses are lines through the samples within this of an instant, s.
pub(super) const SMOOTH_S: f64 = 0.1;
/// Instants at most.
const INSTANTS_MAX: usize = 600;
/// Fewest instants.
const INSTANTS_MIN: usize = 20;
/// Blocks of the jackknife.
const BLOCKS: usize = 10;
/// Readings of the tracks.
const ROUNDS: usize = 12;
/// Below this Δ has settled, s.
const SETTLED_S: f64 = 1e-7;
/// The fine offset may not leave the coarse one by more, s.
const ASTRAY_S: f64 = 0.5;
/// Instants this far from the others are glitches: squared residual against the median one.
const GLITCH: f64 = 36.0;

/// The clock offset: t_robot = t_mocap + offset.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClockOffset {
    /// Δ, s.
    pub offset_s: f64,
    /// One sigma, s.
    pub sigma_s: f64,
    /// Correlation of the speeds at the peak.
    pub correlation: f64,
    /// Greatest correlation outside of the peak's lobe, 0 or more.
    pub runner_up: f64,
    /// Instants that the fine offset rests on.
    pub instants: usize,
    /// Instants left out as glitches.
    pub glitches: usize,
}

/// The offset between the clocks of two streams (time in s by the stream's own clock, pose of the tip in the base
/// frame; pose of the object in its world, `None` where it was not seen; poses with numbers that are not finite count
/// as gaps). With `frames` they are held and the tip's speed is correlated too; with `None` they are fitted along.
///
/// # Errors
/// [`RegistrationError`] for times that run backwards, too little in common, motion that determines too
/// little or repeats itself.
pub fn clock_offset(
    robot: &[(f64, Pose)],
    mocap: &[(f64, Option<Pose>)],
    frames: Option<&Frames>,
    fit: &FitOptions,
    clock: &ClockOptions,
) -> Result<ClockOffset, RegistrationError> {
    fit.check()?;
    let streams = Streams::new(robot, mocap, clock)?;
    if let Some(f) = frames
        && let Some(pose) = [&f.base_from_world, &f.object_from_tip]
            .into_iter()
            .find(|p| !is_pose(p))
    {
        return Err(RegistrationError::Option {
            name: "frames, largest number",
            value: pose.translation.vector.amax(),
            must: "poses",
        });
    }
    let coarse = peak(&streams.robot, &streams.mocap, frames, clock)?;
    Ok(streams.fine(&coarse, frames, fit)?.clock)
}

/// The fine offset, and the instants of the robot's clock it rests on.
pub(super) struct Fine {
    pub clock: ClockOffset,
    pub instants: Vec<f64>,
}

/// Both streams as motions.
pub(super) struct Streams {
    pub robot: Track,
    pub mocap: Track,
    trails_m: f64,
}

impl Streams {
    pub(super) fn new(
        robot: &[(f64, Pose)],
        mocap: &[(f64, Option<Pose>)],
        clock: &ClockOptions,
    ) -> Result<Self, RegistrationError> {
        clock.check()?;
        let robot = robot.iter().map(|(t, p)| (*t, Some(*p)));
        Ok(Self {
            robot: Track::new(robot, "robot", clock.gap_max_s)?,
            mocap: Track::new(mocap.iter().copied(), "motion capture", clock.gap_max_s)?,
            trails_m: clock.trails_m,
        })
    }

    /// Instants of the robot's clock, evenly spaced.
    fn instants(&self) -> Vec<f64> {
        let Some([from, to]) = self.robot.span_s() else {
            return Vec::new();
        };
        let step = (2.0 * SMOOTH_S).max((to - from) / INSTANTS_MAX as f64);
        let count = ((to - from) / step).floor() as usize;
        (0..=count.min(INSTANTS_MAX))
            .map(|k| from + k as f64 * step)
            .collect()
    }

    /// What both show at `t_s` of the robot's clock.
    pub(super) fn observe(&self, t_s: f64, offset_s: f64) -> Option<Observation> {
        let robot = self.robot.at(t_s, SMOOTH_S)?;
        let object = self.mocap.at(t_s - offset_s, SMOOTH_S)?;
        Some(Observation {
            base_from_tip: robot.pose,
            world_from_object: object.pose,
            velocity_m_s: object.velocity_m_s,
            rate_rad_s: object.rate_rad_s,
        })
    }

    pub(super) fn fine(
        &self,
        coarse: &Peak,
        held: Option<&Frames>,
        options: &FitOptions,
    ) -> Result<Fine, RegistrationError> {
        let instants = self.instants();
        let mut settled = self.settle(&instants, coarse.offset_s, held, options)?;
        let sane = settled.without_glitches(options);
        let glitches = settled.instants.len() - sane.len();
        if glitches > 0 {
            settled = self.settle(&sane, settled.offset_s, held, options)?;
        }
        if (settled.offset_s - coarse.offset_s).abs() > ASTRAY_S {
            return Err(RegistrationError::Unsettled {
                coarse_s: coarse.offset_s,
                fine_s: settled.offset_s,
            });
        }
        let clock = ClockOffset {
            offset_s: settled.offset_s,
            sigma_s: settled
                .sigma_s(options)
                .hypot(settled.trails_s(self.trails_m)),
            correlation: coarse.correlation,
            runner_up: coarse.runner_up,
            instants: settled.instants.len(),
            glitches,
        };
        Ok(Fine {
            clock,
            instants: settled.instants,
        })
    }

    /// Gauss and Newton from `offset_s`.
    fn settle(
        &self,
        instants: &[f64],
        offset_s: f64,
        held: Option<&Frames>,
        options: &FitOptions,
    ) -> Result<Settled, RegistrationError> {
        let unknowns = match (held, &options.object) {
            (Some(_), _) => Unknowns::Delay,
            (None, ObjectFrame::Unknown) => Unknowns::FramesAndDelay,
            (None, ObjectFrame::Known(_)) => Unknowns::BaseAndDelay,
        };
        let mut now = Settled::read(self, instants, offset_s, unknowns)?;
        now.state.frames = match held {
            Some(frames) => *frames,
            None => {
                let alone = match options.object {
                    ObjectFrame::Unknown => Unknowns::Frames,
                    ObjectFrame::Known(_) => Unknowns::Base,
                };
                fit_from_guesses(&now.observations, alone, options)
                    .state
                    .frames
            }
        };
        for _ in 0..ROUNDS {
            let fitted = fit::fit(&now.observations, now.state, unknowns, options);
            let moved_s = fitted.state.delay_s;
            // A step longer than the motion's own time scale would leave the line it was made on.
            let offset_s = now.offset_s + moved_s.clamp(-HALF_S, HALF_S);
            let frames = fitted.state.frames;
            now = Settled::read(self, instants, offset_s, unknowns)?;
            now.state.frames = frames;
            if moved_s.abs() < SETTLED_S {
                break;
            }
        }
        Ok(now)
    }
}

/// The streams read at one offset.
struct Settled {
    offset_s: f64,
    instants: Vec<f64>,
    observations: Vec<Observation>,
    state: State,
    unknowns: Unknowns,
}

impl Settled {
    fn read(
        streams: &Streams,
        instants: &[f64],
        offset_s: f64,
        unknowns: Unknowns,
    ) -> Result<Self, RegistrationError> {
        let both = |t: &f64| streams.observe(*t, offset_s).map(|o| (*t, o));
        let (instants, observations): (Vec<f64>, Vec<Observation>) =
            instants.iter().filter_map(both).unzip();
        if instants.len() < INSTANTS_MIN {
            return Err(RegistrationError::NoOverlap {
                seconds: instants.len() as f64 * 2.0 * SMOOTH_S,
            });
        }
        let state = State {
            frames: Frames::IDENTITY,
            centre_in_world_m: centre(&observations),
            delay_s: 0.0,
        };
        Ok(Self {
            offset_s,
            instants,
            observations,
            state,
            unknowns,
        })
    }

    /// The instants whose residual is like the others'.
    fn without_glitches(&self, options: &FitOptions) -> Vec<f64> {
        let factors = fit::factors(&self.state, &self.observations, options);
        let squares: Vec<f64> = self
            .observations
            .iter()
            .zip(&factors)
            .map(|(o, factor)| {
                let mut r = self.state.residual(o);
                factor.solve_lower_triangular_mut(&mut r);
                r.norm_squared()
            })
            .collect();
        let mut sorted = squares.clone();
        let middle = sorted.len() / 2;
        let median = *sorted.select_nth_unstable_by(middle, f64::total_cmp).1;
        let bound = GLITCH * median.max(1e-12);
        let pairs = self.instants.iter().zip(&squares);
        pairs
            .filter(|(_, d)| **d <= bound)
            .map(|(t, _)| *t)
            .collect()
    }

    /// The time that a way is at the motion's speed (root mean square), s.
    fn trails_s(&self, way_m: f64) -> f64 {
        let speeds = self.observations.iter().map(|o| o.velocity_m_s);
        let squares: f64 = speeds.map(|v| v.norm_squared()).sum();
        let speed_m_s = (squares / self.observations.len() as f64).sqrt();
        match way_m > 0.0 {
            true => way_m / speed_m_s,
            false => 0.0,
        }
    }

    /// Jackknife over blocks of time, linearised where the fit ended.
    fn sigma_s(&self, options: &FitOptions) -> f64 {
        let factors = fit::factors(&self.state, &self.observations, options);
        let mut blocks = [Normal::zero(); BLOCKS];
        let n = self.observations.len();
        for (k, (o, factor)) in self.observations.iter().zip(&factors).enumerate() {
            blocks[k * BLOCKS / n].add(&self.state, o, factor, self.unknowns);
        }
        let without = |left_out: usize| {
            let mut rest = Normal::zero();
            for block in blocks.iter().enumerate().filter(|(k, _)| *k != left_out) {
                rest.matrix += block.1.matrix;
                rest.gradient += block.1.gradient;
            }
            let step = rest.step(0.0, self.unknowns)?;
            Some(step[DELAY] * UNITS[DELAY])
        };
        let steps: Option<Vec<f64>> = (0..BLOCKS).map(without).collect();
        let Some(steps) = steps else {
            return f64::INFINITY;
        };
        let m = BLOCKS as f64;
        let mean = steps.iter().sum::<f64>() / m;
        let squares: f64 = steps.iter().map(|s| (s - mean).powi(2)).sum();
        ((m - 1.0) / m * squares).sqrt()
    }
}
