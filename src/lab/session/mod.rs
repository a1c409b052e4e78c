//! Sessions of the virtual rig: logs for the gap finder, as a lab would record them.
//!
//! Every number has passed the whole chain: plant, spring circuit, counter, wire protocol, link, calibration and
//! orientation filters. The rig runs on simulated time behind the same link as a live one, and what is hidden in it is
//! acted out by the rig itself. All of it is simulated.
//!
//! | column | source |
//! |---|---|
//! | commanded pressure | the newest [`PressureCommand`](crate::signal::PressureCommand) at the frame's stamp |
//! | measured pressure | the gauges as sent |
//! | springs | counts and gates through the unit's own calibration; never reconstructed |
//! | IMUs | each IMU's own filter, its heading set at rest; never reconstructed |
//! | motion capture | poses by their own stamps, interpolated to the frame's stamp |
//!
//! What was not sent, or lies outside of its calibration, is missing in the log (NaN or `None`).

mod calibration;
mod capture;
mod chain;
pub mod excitation;
mod imus;
mod plan;
#[cfg(test)]
mod tests;

pub use calibration::{calibration_of, springs_of};
pub use chain::{REST_S, Specimen, changes_with_time};
pub use excitation::{Drive, Excitation};
pub use imus::calibrate_imus;
pub use plan::{Session, SessionError, SessionPlan};

use crate::recording::SessionLog;
use crate::robot::RobotSpec;

/// The log of a session.
///
/// # Errors
/// [`SessionError`] when the plan makes no sense, the rig cannot be calibrated, or it cannot carry out the plan.
pub fn session(robot: &RobotSpec, plan: &SessionPlan) -> Result<Session, SessionError> {
    plan.check()?;
    Specimen::new(robot, plan.specimen)?.session(plan)
}

/// A session of `robot`'s virtual rig as a session log.
pub fn session_log(s: Session, robot: &RobotSpec) -> SessionLog {
    SessionLog {
        name: s.name,
        rate_hz: s.rate_hz,
        payload_kg: s.payload_kg,
        t_s: s.t_s,
        chamber_pa: s.chamber_pa,
        sensors: s.sensors,
        truth: s.captured,
        commanded_pa: Some(s.commanded_pa),
        payload_column_kg: None,
        cut: false,
        hash: String::new(),
        robot: robot.hash.clone(),
        corrected_by: None,
        simulated: Some(true),
    }
}
