//! The limits that every pressure command obeys.

use std::ops::ControlFlow;
use std::sync::Arc;

use super::driver::Observer;
use crate::robot::RobotSpec;
use crate::signal::{CHAMBERS, PressureCommand, Snapshot};
use crate::twin::{Command, Event};

/// The limit that a command violates after the one before it (`last`), in range or rate; `None` where it obeys them. Without
/// a `last` command (`None`) only the range is checked.
pub fn over_limits(
    robot: &RobotSpec,
    last: Option<&PressureCommand>,
    command: &PressureCommand,
) -> Option<String> {
    let limits = &robot.pressure;
    (0..CHAMBERS).find_map(|i| {
        let pa = command.chamber_pa()[i];
        if !(limits.min_pa..=limits.max_pa).contains(&pa) {
            return Some(format!("chamber {} was commanded to {pa} Pa", i + 1));
        }
        let last = last?;
        let dt_s = command.stamp().since(last.stamp());
        let step_pa = (pa - last.chamber_pa()[i]).abs();
        (step_pa > limits.rate_pa_s * dt_s + 1e-6).then(|| {
            format!(
                "chamber {} was commanded by {step_pa} Pa within {dt_s} s",
                i + 1
            )
        })
    })
}

/// Ends a run whose twin commands a pressure beyond its limits, whoever asked for it.
pub(super) struct LimitWatch<'a> {
    robot: &'a RobotSpec,
    last: Option<PressureCommand>,
    /// The first violation; `None` without one.
    pub violation: Option<String>,
}

impl<'a> LimitWatch<'a> {
    pub(super) fn new(robot: &'a RobotSpec) -> Self {
        Self {
            robot,
            last: None,
            violation: None,
        }
    }

    /// Checks the command of a snapshot against the one before it.
    pub(super) fn check(&mut self, snapshot: &Snapshot) {
        if let (Some(command), None) = (&snapshot.command, &self.violation) {
            self.violation = over_limits(self.robot, self.last.as_ref(), command);
        }
        self.last.clone_from(&snapshot.command);
    }

    /// The first violation as an error.
    ///
    /// # Errors
    /// When a limit was violated.
    pub(super) fn ensure_none(self) -> anyhow::Result<()> {
        match self.violation {
            Some(what) => anyhow::bail!("a limit was violated: {what}"),
            None => Ok(()),
        }
    }
}

impl Observer for LimitWatch<'_> {
    fn observe(
        &mut self,
        snapshot: &Arc<Snapshot>,
        _events: &[Event],
        _commands: &mut Vec<Command>,
    ) -> ControlFlow<()> {
        self.check(snapshot);
        match self.violation {
            Some(_) => ControlFlow::Break(()),
            None => ControlFlow::Continue(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::signal::{Gripper, PressureLimits, Stamp};

    #[test]
    fn a_leap_ends_the_run_and_is_an_error() {
        let robot = RobotSpec::reference();
        let wide = PressureLimits {
            min_pa: -1e6,
            max_pa: 1e6,
            rate_pa_s: 1e9,
        };
        let at = |t_s: f64, pa: f64| {
            let (stamp, all) = (Stamp::from_seconds(t_s), [pa; CHAMBERS]);
            let command = PressureCommand::limited(stamp, all, Gripper::Open, None, &all, &wide);
            Arc::new(Snapshot {
                stamp,
                command: Some(command),
                ..Snapshot::default()
            })
        };
        let mut watch = LimitWatch::new(&robot);
        let mut sees = |s: Arc<Snapshot>| watch.observe(&s, &[], &mut Vec::new());
        assert!(sees(at(0.0, 0.0)).is_continue());
        assert!(sees(at(0.01, robot.pressure.rate_pa_s * 0.01)).is_continue());
        assert!(sees(at(0.02, robot.pressure.max_pa)).is_break());
        let what = watch.ensure_none().map_err(|e| e.to_string());
        assert!(what.is_err_and(|what| what.contains("chamber 1 was commanded by")));
    }
}
