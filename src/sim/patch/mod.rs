//! Meaning of a robot's patches: the one place where names in a patch become a model.
//!
//! A patch holds departures of one rig from the robot it was made for ([`CalibrationParameter`]s) and effects of the
//! table. They act in three places ([`Acts`]):
//!
//! | part of a patch | acts in |
//! |---|---|
//! | stiffness, area, rest length, hardening, bending, torsion, gripper mass, base tilt, spring ends; `chamber-stiffness`, `stiffening`, `payload`, `com-offset`, `base-tilt`, `tip-force`, `torsion` | every [`Model`](super::Model): twin, datasets, replay |
//! | spring gain and offset, IMU mounting; `spring-calibration`, `imu-misalignment`, and laws that are a constant gain, offset or turn | the calibration of the sensing, replay ([`SensorErrors`]); where networks have learned the rig from samples of it, only the effects act in the sensing |
//! | damping, friction, creep, lag behind the gauges, drift of the IMUs, motion capture's frame, clock and body; every other effect | replay alone: they need a history, or motion capture |
//!
//! **Stacking.** A calibration parameter of a patch departs from the robot that the patch was made for: it adds to the
//! patches below that robot and replaces the ones between. Effects add up.

mod acts;
mod correction;
mod file;
mod parameters;
mod readings;

pub use acts::Acts;
pub use correction::{Correction, SensorErrors, model};
pub use file::PatchError;
pub use parameters::{CalibrationParameter, calibration_parameters, nominal, parameters};
pub use readings::{motions, readings, unbounded};

#[cfg(test)]
mod tests;
