//! The virtual rig, step by step: what a learner reads, and apart from it the truth.

use std::sync::{Mutex, MutexGuard, PoisonError};

use anyhow::{Result, ensure};
use numpy::{PyArray1, PyReadonlyArray1};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use serde_json::json;
use springtwin::drive::rig_options;
use springtwin::lab::frames::raw_frame;
use springtwin::lab::ranges::{payload_in_range, pressures_in_range};
use springtwin::lab::session::calibration_of;
use springtwin::rig::hidden::HIDDEN;
use springtwin::rig::multibody::arm::RINGS;
use springtwin::rig::{PHYSICS_STEP_S, RigOptions, Unit, VirtualRig};
use springtwin::robot::RobotSpec;
use springtwin::sensing::Sensing;
use springtwin::signal::{
    CHAMBERS, ChannelHealth, IMUS, PressureCommand, RawFrame, SensorFrame, Stamp,
};
use springtwin::twin::sensing_for;

use crate::arrays::{flat, pose_values, shaped};
use crate::error::{Error, refused};
use crate::robot::Robot;
use crate::session::hidden;

/// Time at 0 Pa before a rig is handed over, s: the filters have settled then.
const REST_S: f64 = 2.0;

/// What can be hidden in a rig (JSON).
#[pyfunction]
pub fn hidden_effects() -> String {
    let kinds = HIDDEN.iter().map(|kind| {
        let parameters = kind.magnitudes.iter().map(|m| {
            json!({"name": m.name, "unit": m.unit, "none": m.none, "bounds": m.bounds, "usual": m.usual})
        });
        json!({
            "id": kind.id, "class": format!("{:?}", kind.class).to_lowercase(), "doc": kind.doc,
            "parameters": parameters.collect::<Vec<_>>(),
        })
    });
    serde_json::Value::from_iter(kinds).to_string()
}

/// Options of a rig as its user gives them.
#[derive(FromPyObject)]
pub struct RigChoice {
    unit: u64,
    hide: Vec<String>,
    payload_kg: f64,
    stiffness: f64,
}

impl RigChoice {
    /// Options of a rig of `robot` with a seed.
    ///
    /// # Errors
    /// When the robot does not carry the payload, or an effect cannot be hidden.
    pub fn options(&self, robot: &RobotSpec, seed: u64) -> Result<RigOptions> {
        ensure!(
            self.payload_kg >= 0.0,
            "a payload of {} kg: give 0 or more",
            self.payload_kg
        );
        payload_in_range(robot, self.payload_kg)?;
        ensure!(
            self.stiffness.is_finite() && self.stiffness > 0.0,
            "a stiffness of {} times the arm's own: give a number above 0",
            self.stiffness
        );
        let mut options = rig_options(self.payload_kg, seed);
        options.unit = match robot.virtual_unit {
            Some(own) if self.unit == own || Unit(self.unit) == Unit::default() => Unit(own),
            Some(own) => anyhow::bail!(
                "the robot file was measured on unit {own} of the virtual rig: leave unit out, or use another robot file for \
                 unit {}",
                self.unit
            ),
            None => Unit(self.unit),
        };
        options.hidden = hidden(&self.hide)?;
        options.surroundings.stiffness = self.stiffness;
        Ok(options)
    }

    /// The payload that the operator declares, kg.
    pub fn payload_kg(&self) -> f64 {
        self.payload_kg
    }
}

/// A virtual rig without boards and serial line: 100 steps per second.
#[pyclass(frozen, module = "springtwin._springtwin")]
pub struct Rig {
    robot: RobotSpec,
    choice: RigChoice,
    rings: usize,
    running: Mutex<Running>,
}

/// The rig as it is now.
struct Running {
    rig: VirtualRig,
    sensing: Sensing,
    seq: u32,
    set: Option<PressureCommand>,
    raw: RawFrame,
    sensors: Option<SensorFrame>,
}

impl Running {
    /// A rig at rest at 0 Pa.
    fn new(robot: &RobotSpec, options: &RigOptions, rings: usize) -> Result<Self> {
        let calibration = calibration_of(robot, options.unit)?;
        let mut running = Self {
            rig: VirtualRig::of_rings(robot, options, rings)?,
            sensing: sensing_for(robot, &calibration),
            seq: 0,
            set: None,
            raw: RawFrame::default(),
            sensors: None,
        };
        running.rest(robot)?;
        Ok(running)
    }

    fn rest(&mut self, robot: &RobotSpec) -> Result<()> {
        for _ in 0..(REST_S / PHYSICS_STEP_S) as usize {
            self.tick(robot, [0.0; CHAMBERS])?;
        }
        Ok(())
    }

    /// One step towards the wanted pressures, as fast as the robot's rate of change permits.
    fn tick(&mut self, robot: &RobotSpec, wanted_pa: [f64; CHAMBERS]) -> Result<()> {
        let now = Stamp::from_seconds(f64::from(self.seq) * PHYSICS_STEP_S);
        let start_pa = [0.0; CHAMBERS];
        let (before, limits) = (self.set.as_ref(), &robot.pressure);
        let set = PressureCommand::limited(now, wanted_pa, None, before, &start_pa, limits);
        let refused = self.rig.refused_steps;
        self.rig.step(&set.chamber_pa().map(Some));
        self.set = Some(set);
        ensure!(
            self.rig.refused_steps == refused,
            "the virtual arm cannot hold its load in this pose: hang less on it, or push it less"
        );
        self.seq += 1;
        self.raw = raw_frame(self.seq, &self.rig);
        self.sensors = Some(self.sensing.update(&self.raw));
        Ok(())
    }
}

#[pymethods]
impl Rig {
    #[new]
    fn new(
        py: Python<'_>,
        robot: &Robot,
        choice: RigChoice,
        seed: u64,
        rings: Option<usize>,
    ) -> PyResult<Self> {
        let spec = robot.spec.clone();
        let rings = rings.unwrap_or(RINGS);
        if !(2..=RINGS).contains(&rings) {
            let text = format!("{rings} rings per segment: give 2 to {RINGS}");
            return Err(Error::new_err(text));
        }
        let running = py.detach(|| Running::new(&spec, &choice.options(&spec, seed)?, rings));
        Ok(Self {
            running: Mutex::new(running.map_err(refused)?),
            robot: spec,
            choice,
            rings,
        })
    }

    /// A new arm of the same kind at rest at 0 Pa, with the noise of another seed.
    fn reset(&self, py: Python<'_>, seed: u64) -> PyResult<()> {
        let made = py.detach(|| {
            Running::new(
                &self.robot,
                &self.choice.options(&self.robot, seed)?,
                self.rings,
            )
        });
        *self.running() = made.map_err(refused)?;
        Ok(())
    }

    /// So many steps towards wanted pressures (Pa).
    fn step(
        &self,
        py: Python<'_>,
        pressures_pa: PyReadonlyArray1<'_, f64>,
        steps: usize,
    ) -> PyResult<()> {
        let wanted = pressures_pa.as_array();
        if wanted.len() != CHAMBERS {
            let text = format!("{} pressures: give {CHAMBERS}", wanted.len());
            return Err(Error::new_err(text));
        }
        let wanted: [f64; CHAMBERS] = std::array::from_fn(|i| wanted[i]);
        pressures_in_range(&self.robot, &wanted).map_err(refused)?;
        py.detach(|| -> Result<()> {
            let mut running = self.running();
            (0..steps).try_for_each(|_| running.tick(&self.robot, wanted))
        })
        .map_err(refused)
    }

    /// Force on the end pad in the base frame from the next step on, N.
    fn push(&self, force_n: [f64; 3]) -> PyResult<()> {
        if force_n.iter().any(|f| !f.is_finite()) {
            return Err(Error::new_err("a force that is not a number: correct it"));
        }
        self.running().rig.plant.surroundings.tip_force_n = force_n;
        Ok(())
    }

    /// What the boards deliver, and what is set.
    fn raw<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let running = self.running();
        let raw = &running.raw;
        let out = PyDict::new(py);
        out.set_item("t_s", raw.stamp.seconds())?;
        let set = running
            .set
            .as_ref()
            .map_or([0.0; CHAMBERS], |c| *c.chamber_pa());
        out.set_item("set_pa", PyArray1::from_slice(py, &set))?;
        out.set_item("chamber_pa", PyArray1::from_slice(py, &raw.chamber_pa))?;
        out.set_item(
            "spring_counts",
            PyArray1::from_slice(py, &raw.spring_counts),
        )?;
        out.set_item(
            "spring_gate_ticks",
            PyArray1::from_slice(py, &raw.spring_gate_ticks),
        )?;
        out.set_item("tick_rate_hz", PyArray1::from_slice(py, &raw.tick_rate_hz))?;
        let gyro = flat(raw.imu.map(|i| i.gyro_rad_s));
        let accel = flat(raw.imu.map(|i| i.accel_m_s2));
        out.set_item("gyro_rad_s", shaped(py, gyro, [IMUS, 3])?)?;
        out.set_item("accel_m_s2", shaped(py, accel, [IMUS, 3])?)?;
        Ok(out)
    }

    /// The calibrated signals: springs, IMUs, whether each was read (springs, then IMUs), and the deviations of the 24 beyond
    /// their usual noise.
    fn sensors<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let running = self.running();
        let Some(frame) = &running.sensors else {
            return Err(Error::new_err("the rig has not moved yet: take a step"));
        };
        let out = PyDict::new(py);
        out.set_item(
            "springs_m",
            PyArray1::from_slice(py, &frame.sensors.spring_m),
        )?;
        let imus = flat(frame.sensors.imu_ypr_rad);
        out.set_item("imus_ypr_rad", shaped(py, imus, [IMUS, 3])?)?;
        let health = frame.health.springs.iter().chain(&frame.health.imus);
        let read: Vec<bool> = health.map(|h| *h == ChannelHealth::Ok).collect();
        out.set_item("read", PyArray1::from_vec(py, read))?;
        out.set_item("extra_sigma", PyArray1::from_slice(py, &frame.extra_sigma))?;
        Ok(out)
    }

    /// Where the pads (3 x 7) and the springs' ends (12) truly are.
    fn truth<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let running = self.running();
        let truth = running.rig.plant.truth();
        let out = PyDict::new(py);
        let pads = flat(truth.base_from_pad.iter().map(pose_values));
        out.set_item("pads", shaped(py, pads, [3, 7])?)?;
        out.set_item("springs_m", PyArray1::from_slice(py, &truth.spring_m))?;
        out.set_item("bellows_m", PyArray1::from_slice(py, &truth.bellows_m))?;
        Ok(out)
    }
}

impl Rig {
    fn running(&self) -> MutexGuard<'_, Running> {
        self.running.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
