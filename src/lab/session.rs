//! Sessions of the virtual rig as session logs.

use crate::recording::SessionLog;
use crate::rig::Session;
use crate::robot::RobotSpec;

/// A session of `robot`'s virtual rig as a session log.
pub fn session_log(s: Session, robot: &RobotSpec) -> SessionLog {
    SessionLog {
        name: s.name,
        rate_hz: s.rate_hz,
        payload_kg: s.payload_kg,
        t_s: s.t_s,
        chamber_pa: s.chamber_pa,
        sensors: s.sensors,
        truth: s.captured.into_iter().map(Some).collect(),
        commanded_pa: Some(s.commanded_pa),
        payload_column_kg: None,
        hash: String::new(),
        robot: robot.hash.clone(),
    }
}
