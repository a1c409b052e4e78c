//! What a twin reads its sensors and its pressures by.

use std::sync::Arc;

use nalgebra::UnitQuaternion;

use crate::control::StartSample;
use crate::learn::{self, PlantMap, PoseMap};
use crate::robot::RobotSpec;
use crate::sensing::{Calibration, Sensing};
use crate::signal::IMUS;
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
    let patched = Patched::new(robot, calibration);
    Sensing::new(&patched.geometry, patched.calibration)
}

/// What sensors are read by once the patches of a robot are applied.
pub struct Patched {
    /// The robot with the geometry that its patches state.
    pub geometry: RobotSpec,
    /// The calibration with the sensor errors of its patches.
    pub calibration: Calibration,
    /// Turn of each IMU on its pad by its patches: it reads R exp(δ) where the pad stands at R.
    pub imu: [UnitQuaternion<f64>; IMUS],
}

impl Patched {
    /// Of `robot` with a calibration.
    pub fn new(robot: &RobotSpec, calibration: &Calibration) -> Self {
        if robot.patches.is_empty() {
            return Self {
                geometry: robot.clone(),
                calibration: calibration.clone(),
                imu: [UnitQuaternion::identity(); IMUS],
            };
        }
        let errors = SensorErrors::of(robot);
        Self {
            geometry: Correction::known(robot).geometry(robot),
            calibration: calibration.clone().corrected(&errors.spring, &errors.imu),
            imu: errors.imu,
        }
    }
}
