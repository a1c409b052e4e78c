//! Manufactured units of the virtual rig: those that anything may be fitted to, those that figures are stated for, and
//! what a lab does with a unit before it works with it.

use std::ops::ControlFlow;

use anyhow::{Context as _, Result};
use rayon::prelude::*;

use super::motions::{self, Motion};
use super::self_calibration::take;
use super::session::springs_of;
use super::threads;
use crate::learn::{Model, Recipe, adapt};
use crate::rig::Unit;
use crate::robot::RobotSpec;
use crate::sensing::Calibration;
use crate::sensing::bundle::adjust;
use crate::signal::Dataset;

/// Units that networks, gains and thresholds may be fitted to.
pub const TRAINING: [Unit; 2] = [Unit(1), Unit(2)];
/// Units that figures are stated for: nothing but their own lab's calibration is fitted to them.
pub const TEST: [Unit; 3] = [Unit(3), Unit(4), Unit(5)];
/// Both, in order.
pub const ALL: [Unit; 5] = [Unit(1), Unit(2), Unit(3), Unit(4), Unit(5)];

/// Payloads of the motion-capture session, kg: half of its time each.
const SESSION_KG: [f64; 2] = [0.0, 0.25];
/// Share of the pressure range that the session uses.
const SESSION_SHARE: f64 = 0.95;
/// Rows of the session per second of motion.
const SESSION_ROWS_1_S: f64 = 5.0;
/// Motion that the calibration is adjusted to, s.
const SELF_S: f64 = 300.0;
/// Seed of the sessions of all units: no study moves a rig with it.
const SESSION_SEED: u64 = 90;

/// A unit after its lab's calibration: its springs drawn on the bench, their ends and the IMUs by `calibrate self` beside
/// motion capture, and sim-to-real networks and covariance from a motion-capture session of its own.
#[derive(Clone, Debug)]
pub struct Lab {
    /// The unit.
    pub unit: Unit,
    /// Its springs and IMUs.
    pub calibration: Calibration,
    /// Its motion-capture session.
    pub session: Dataset,
    /// Recipe by which the session is dealt and the sim-to-real networks are trained.
    pub recipe: Recipe,
    /// The networks with the unit's own correction.
    pub networks: Model,
}

impl Lab {
    /// Calibrates a unit with a session of so many seconds, on top of `base`.
    ///
    /// # Errors
    /// When a spring is refused, the arm cannot follow its motion, or training fails.
    pub fn new(robot: &RobotSpec, unit: Unit, seconds: f64, base: &Model) -> Result<Self> {
        let calibration = self_calibrated(robot, unit)?;
        let session = session(robot, unit, &calibration, seconds)?;
        let recipe = session_recipe()?;
        let networks = adapt(base, &session, &recipe, &mut |_| ControlFlow::Continue(()))?;
        Ok(Self {
            unit,
            calibration,
            session,
            recipe,
            networks,
        })
    }
}

/// A unit's springs drawn on the bench, with ends, mountings and the rest as its own motion shows them beside motion
/// capture. IMUs fitted before the ends are known would turn the arm with them.
///
/// # Errors
/// When a spring is refused, the arm cannot follow its motion, or no adjustment fits.
pub fn self_calibrated(robot: &RobotSpec, unit: Unit) -> Result<Calibration> {
    adjusted_with_cameras(robot, unit, &springs_of(robot, unit)?)
}

/// A bench calibration with ends, mountings and the rest as five minutes of the unit's own motion show them beside motion
/// capture.
///
/// # Errors
/// When the arm cannot follow its motion, or no adjustment fits.
pub fn adjusted_with_cameras(
    robot: &RobotSpec,
    unit: Unit,
    bench: &Calibration,
) -> Result<Calibration> {
    let frames = motions::raw(robot, &Motion::of(unit, SELF_S, SESSION_SEED + 2))?;
    let take = take(bench, &frames, true);
    Ok(adjust(robot, bench, &[take])?.calibration)
}

/// The recipe for a motion-capture session, `assets/networks/session.toml`.
///
/// # Errors
/// When the built-in file is damaged.
pub fn session_recipe() -> Result<Recipe> {
    Recipe::from_toml(include_str!("../../assets/networks/session.toml"))
        .context("the built-in recipe for sessions does not load")
}

/// A motion-capture session of a unit, through its workspace with and without a weight.
///
/// # Errors
/// When the arm cannot follow its motion.
pub fn session(
    robot: &RobotSpec,
    unit: Unit,
    calibration: &Calibration,
    seconds: f64,
) -> Result<Dataset> {
    let takes = side_by_side(&SESSION_KG, |payload_kg| {
        let m = Motion {
            payload_kg: *payload_kg,
            range_share: SESSION_SHARE,
            ..Motion::of(
                unit,
                seconds / SESSION_KG.len() as f64,
                SESSION_SEED + u64::from(*payload_kg > 0.0),
            )
        };
        motions::session(robot, calibration, &m, SESSION_ROWS_1_S)
    })?;
    Ok(Dataset {
        samples: takes.concat(),
        source: format!("virtual rig, session of unit {}", unit.0),
        seed: SESSION_SEED,
        robot_hash: robot.hash.clone(),
        row_s: Some(1.0 / SESSION_ROWS_1_S),
        shard: None,
    })
}

/// The same for several things at once, on all processors; results in their order.
///
/// # Errors
/// When it fails for one of them.
pub fn side_by_side<T: Sync, R: Send>(
    things: &[T],
    one: impl Fn(&T) -> Result<R> + Send + Sync,
) -> Result<Vec<R>> {
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(threads().min(things.len().max(1)))
        .thread_name(|k| format!("unit-{k}"))
        .build()?;
    pool.install(|| {
        let things = things.par_iter().with_max_len(1);
        things.map(one).collect::<Vec<Result<R>>>()
    })
    .into_iter()
    .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_unit_is_either_fitted_to_or_tested_on() {
        assert_eq!([TRAINING.as_slice(), &TEST].concat(), ALL);
    }
}
