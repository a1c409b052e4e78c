//! What a twin reads its sensors and its pressures by.

use std::sync::Arc;

use crate::control::StartSample;
use crate::learn::{self, PlantMap, PoseMap};
use crate::robot::RobotSpec;
use crate::sensing::{Calibration, Sensing};
use crate::sim::patch::{Correction, SensorErrors};

/// The maps that a twin works with.
#[derive(Clone)]
pub struct Maps {
    /// Sensor signals to tip pose.
    pub pose: Arc<dyn PoseMap>,
    /// Pressures to sensor signals.
    pub plant: Arc<dyn PlantMap>,
    /// Settled samples (pressures in Pa, tip position in m) to start searches from.
    pub seeds: Arc<Vec<StartSample>>,
}

impl From<learn::Model> for Maps {
    fn from(model: learn::Model) -> Self {
        let seed = |s: &learn::GuessSample| {
            (
                s.chamber_pa.map(f64::from),
                std::array::from_fn(|k| f64::from(s.pose[k])),
            )
        };
        Self {
            seeds: Arc::new(model.guess.samples().iter().map(seed).collect()),
            pose: Arc::new(model.cascade),
            plant: Arc::new(model.plant),
        }
    }
}

/// Sensing for `robot` with a calibration, corrected by the sensor errors in the robot's patches.
pub fn sensing_for(robot: &RobotSpec, calibration: &Calibration) -> Sensing {
    if robot.patches.is_empty() {
        return Sensing::new(robot, calibration.clone());
    }
    let errors = SensorErrors::of(robot);
    let calibration = calibration.clone().corrected(&errors.spring, &errors.imu);
    let geometry = Correction::known(robot).geometry(robot);
    Sensing::new(&geometry, calibration)
}
