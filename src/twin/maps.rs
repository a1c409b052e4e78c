//! What a twin reads its sensors and its pressures by.

use std::sync::Arc;

use nalgebra::UnitQuaternion;

use crate::control::StartSample;
use crate::learn::{self, PlantMap, PoseEval, PoseMap};
use crate::robot::RobotSpec;
use crate::sensing::{Calibration, Sensing};
use crate::signal::{IMUS, RawFrame, SensorFrame};
use crate::sim::patch::{Correction, SensorErrors};

/// The maps that a twin works with.
#[derive(Clone)]
pub struct Maps {
    /// Sensor signals to tip pose.
    pub pose: Arc<dyn PoseMap>,
    /// Pressures to sensor signals.
    pub plant: Arc<dyn PlantMap>,
    /// Settled samples to start searches from.
    pub seeds: Arc<Vec<StartSample>>,
    /// SHA-256 of the networks' file, hexadecimal; empty for maps that are from no file.
    pub networks: String,
    /// Whether the networks have learned the sensor errors of the rig in order from samples of it.
    pub know_sensors: bool,
}

/// What a frame of the boards is to a twin.
pub enum Reading {
    /// Signals and pose.
    Whole(Box<SensorFrame>, Box<PoseEval>),
    /// A board or a gauge is silent: such a frame keeps nothing alive.
    Silent,
    /// A number in it, or in what follows from it, is not finite.
    Bad,
}

impl Maps {
    /// Sensing for a twin of `robot` with these maps: as [`sensing_for`], but networks that know the sensor errors of the rig in
    /// order are not given them twice.
    pub fn sensing(&self, robot: &RobotSpec, calibration: &Calibration) -> Sensing {
        let patched = Patched::by(robot, calibration, &self.corrected_by(robot));
        Sensing::new(&patched.geometry, patched.calibration)
    }

    /// The sensor errors of a robot's patches that sensing with these maps corrects.
    pub fn corrected_by(&self, robot: &RobotSpec) -> SensorErrors {
        match self.know_sensors {
            true => SensorErrors::of_effects(robot),
            false => SensorErrors::of(robot),
        }
    }

    /// Reads a frame by what `sensing` made of those before.
    pub fn read(&self, sensing: &mut Sensing, raw: &RawFrame) -> Reading {
        let frame = sensing.update(raw);
        let vector = frame.sensors.to_vector();
        let mut values = vector.iter().chain(&frame.chamber_pa);
        if values.any(|x| !x.is_finite()) {
            return Reading::Bad;
        }
        if frame.health.chambers.iter().any(|h| !h.usable()) {
            return Reading::Silent;
        }
        let mut eval = self.pose.pose(&vector);
        eval.add_sigma(&frame.extra_sigma);
        match eval.pose.iter().all(|x| x.is_finite()) {
            true => Reading::Whole(Box::new(frame), Box::new(eval)),
            false => Reading::Bad,
        }
    }
}

impl From<learn::Model> for Maps {
    fn from(model: learn::Model) -> Self {
        Self {
            seeds: Arc::new(
                model
                    .guess
                    .samples()
                    .iter()
                    .map(StartSample::from)
                    .collect(),
            ),
            pose: Arc::new(model.cascade),
            plant: Arc::new(model.plant),
            networks: model.hash,
            know_sensors: model.scores.s2r.is_some(),
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
    /// Turn δ of each IMU on its pad by its patches: it reads R exp(δ) where the pad stands at R (base from pad).
    pub imu: [UnitQuaternion<f64>; IMUS],
}

impl Patched {
    /// Of `robot` with a calibration.
    pub fn new(robot: &RobotSpec, calibration: &Calibration) -> Self {
        Self::by(robot, calibration, &SensorErrors::of(robot))
    }

    fn by(robot: &RobotSpec, calibration: &Calibration, errors: &SensorErrors) -> Self {
        if robot.patches.is_empty() {
            return Self {
                geometry: robot.clone(),
                calibration: calibration.clone(),
                imu: [UnitQuaternion::identity(); IMUS],
            };
        }
        Self {
            geometry: Correction::known(robot).geometry(robot),
            calibration: calibration.clone().corrected(&errors.spring, &errors.imu),
            imu: errors.imu,
        }
    }
}
