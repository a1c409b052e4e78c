//! Arms that follow measured pressures beside the live one.

use super::replay::{Row, is_mechanical, residuals};
use super::session::Grid;
use crate::robot::RobotSpec;
use crate::signal::CHAMBERS;
use crate::sim::Model;
use crate::sim::effects::{self, Active, EffectError, OnTheWay, Simulated};
use crate::sim::patch::{self, Correction, motions};

/// The arm of some calibration parameters on its way.
pub(super) struct Follower {
    pub values: Vec<f64>,
    model: Model,
    /// Effects of calibration and patches on motion, and those before the gauges.
    pub moving: Vec<Active>,
    mechanical: Vec<Active>,
    way: OnTheWay,
}

impl Follower {
    /// With `values` of the calibration parameters, in their order, and `acting` on top of the robot's own patches.
    pub fn new(robot: &RobotSpec, values: Vec<f64>, acting: &[Active]) -> Self {
        let Correction {
            values: all,
            effects: mut moving,
        } = Correction::known(robot).and(&values, acting);
        moving.extend(motions(&all));
        Self {
            model: patch::model(robot, &all),
            mechanical: moving
                .iter()
                .filter(|a| is_mechanical(a))
                .cloned()
                .collect(),
            moving,
            values,
            way: OnTheWay::default(),
        }
    }

    /// It is somewhere else.
    pub fn begin_again(&mut self) {
        self.way = OnTheWay::default();
    }

    /// Goes on through the instants of a course of times and pressures that come after the first `from`.
    ///
    /// # Errors
    /// [`EffectError`] when the arm finds no equilibrium.
    pub fn go_on(
        &mut self,
        course: (&[f64], &[[f64; CHAMBERS]]),
        from: usize,
        payload_kg: &[f64],
    ) -> Result<Simulated, EffectError> {
        effects::go_on(
            &mut self.way,
            &self.model,
            course,
            from,
            payload_kg,
            &self.mechanical,
        )
    }
}

/// What a second ended with.
pub(super) struct Moment<'a> {
    /// The last bins as they were measured and predicted, headings as expected, and the errors of the last of them.
    pub tail: (&'a Grid, &'a Simulated),
    pub last: &'a Row,
    /// Parameters of the rig.
    pub values: &'a [f64],
    /// Pressures of the last seconds, and the number of their bins up to now.
    pub pressures: (&'a Grid, usize),
    /// When the second before ended, and the pressures in the chambers then; none for the first.
    pub before: Option<(f64, [f64; CHAMBERS])>,
    /// Pressures in the chambers.
    pub chamber_pa: [f64; CHAMBERS],
    pub payload_kg: f64,
    /// The last bin alone.
    pub now: Grid,
    /// Errors of the arm that is followed in steps of a second.
    pub coarse: Row,
}

impl Moment<'_> {
    /// Errors of an arm with what acts in it, after a step to the present pressures.
    pub fn moved(&self, robot: &RobotSpec, arm: &mut Follower, acting: &[Active]) -> Option<Row> {
        let (grid, to) = self.pressures;
        let is_behind = |a: &Active| a.effect.behind_gauge.is_some();
        let chamber_pa = match acting.iter().any(is_behind) {
            true => {
                let (t_s, gauge_pa) = (&grid.session.t_s, &grid.gauge_pa);
                grid.binned(&effects::behind_gauges(robot, t_s, gauge_pa, &arm.moving))[to - 1]
            }
            false => self.chamber_pa,
        };
        let now = (grid.t_s[to - 1], chamber_pa);
        let (times, pressures): (Vec<_>, Vec<_>) = self.before.into_iter().chain([now]).unzip();
        let course = (&times[..], &pressures[..]);
        let mut moved = arm
            .go_on(course, times.len() - 1, &[self.payload_kg])
            .ok()?;
        moved.chamber_pa = vec![chamber_pa];
        Some(residuals(robot, &self.now, &moved, &arm.values, acting)[0])
    }
}
