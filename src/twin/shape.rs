//! The arm's shape by the twin's own model, and by one that is tried beside it.

use std::sync::Arc;

use nalgebra::UnitQuaternion;

use crate::robot::RobotSpec;
use crate::signal::{ArmShape, IMUS, Predicted, SensorVec, Stamp, ypr_from_rotation};
use crate::sim::patch::SensorErrors;
use crate::sim::{Inputs, Model, State, observe, settle};

/// What to settle.
#[derive(Clone, Debug, PartialEq)]
pub struct ShapeQuestion {
    /// When it was asked.
    pub stamp: Stamp,
    /// The twin's own model.
    pub own: Arc<RobotSpec>,
    /// The model that is tried beside it.
    pub tried: Option<Arc<RobotSpec>>,
    /// Measured gauge pressures and declared load.
    pub inputs: Inputs,
    /// The same at the end of the preview; `None` without a preview.
    pub preview: Option<Inputs>,
}

/// What was settled.
#[derive(Clone, Debug)]
pub struct ShapeAnswer {
    /// The twin's own model.
    pub own: Arc<RobotSpec>,
    /// The arm, and what is read of it where that is not its shape; `None` for a load that the model cannot hold.
    pub shape: Option<(Arc<ArmShape>, Option<Arc<SensorVec>>)>,
    /// The model that is tried, with what it predicts; `None` where none is, and for a load that it cannot hold.
    pub tried: Option<(Arc<RobotSpec>, Arc<Predicted>)>,
    /// What the preview was solved for, and its shape (`None` for a load that the model cannot hold); `None` without a
    /// preview.
    pub preview: Option<(Inputs, Option<Arc<ArmShape>>)>,
}

/// A model with its last state.
struct Arm {
    robot: Arc<RobotSpec>,
    model: Model,
    state: State,
    /// What it reads beyond what the sensors are corrected by.
    reads: SensorErrors,
}

impl Arm {
    fn new(robot: &Arc<RobotSpec>, corrected_by: &SensorErrors) -> Self {
        let model = Model::nominal(robot);
        Self {
            robot: Arc::clone(robot),
            state: State::rest(&model),
            model,
            reads: beyond(&SensorErrors::of(robot), corrected_by),
        }
    }

    /// Settles it from where it was.
    fn settle(&mut self, inputs: &Inputs) -> Option<Predicted> {
        settle(&self.model, &mut self.state, inputs).ok()?;
        let seen = observe(&self.model, &self.state);
        let imu_ypr_rad = std::array::from_fn(|i| {
            let pad = UnitQuaternion::from(seen.sensors.base_from_imu_pad(i));
            ypr_from_rotation(&(pad * self.reads.imu[i]))
        });
        Some(Predicted {
            sensors: SensorVec {
                spring_m: self.reads.read_springs(&seen.sensors.spring_m),
                imu_ypr_rad,
            },
            shape: seen.shape,
        })
    }

    /// Whether it reads what its shape is.
    fn reads_shape(&self) -> bool {
        let plain =
            |[gain, offset_m]: &[f64; 2]| (gain - 1.0).abs() < 1e-9 && offset_m.abs() < 1e-9;
        self.reads.spring.iter().all(plain) && self.reads.imu.iter().all(|d| d.angle() < 1e-9)
    }
}

/// What sensors with the errors `all` read where `corrected` of them were corrected.
fn beyond(all: &SensorErrors, corrected: &SensorErrors) -> SensorErrors {
    SensorErrors {
        // y = g l + o, of which l₀ = (y − o₀)/g₀ is what comes out of the correction.
        spring: std::array::from_fn(|i| {
            let ([gain, offset_m], [gain_0, offset_0_m]) = (all.spring[i], corrected.spring[i]);
            [gain / gain_0, (offset_m - offset_0_m) / gain_0]
        }),
        imu: std::array::from_fn::<_, IMUS, _>(|i| all.imu[i] * corrected.imu[i].inverse()),
    }
}

/// The twin's own model and the one that is tried, with their last states.
pub struct ShapeSolver {
    corrected_by: SensorErrors,
    own: Arm,
    tried: Option<Arm>,
    preview_state: State,
    preview: Option<(Inputs, Option<Arc<ArmShape>>)>,
}

impl ShapeSolver {
    /// A solver for a robot whose sensors are corrected by these errors.
    pub fn new(robot: &Arc<RobotSpec>, corrected_by: SensorErrors) -> Self {
        let own = Arm::new(robot, &corrected_by);
        Self {
            preview_state: State::rest(&own.model),
            preview: None,
            own,
            tried: None,
            corrected_by,
        }
    }

    /// Takes the models that are asked for. One that was tried before keeps its state.
    fn take_models(&mut self, question: &ShapeQuestion) {
        let mut before = self.tried.take();
        let mut arm = |robot: &Arc<RobotSpec>| {
            let known = before.take_if(|arm| Arc::ptr_eq(&arm.robot, robot));
            known.unwrap_or_else(|| Arm::new(robot, &self.corrected_by))
        };
        if !Arc::ptr_eq(&self.own.robot, &question.own) {
            self.own = arm(&question.own);
            self.preview_state = State::rest(&self.own.model);
            self.preview = None;
        }
        self.tried = question.tried.as_ref().map(arm);
    }

    /// Settles the arm from where it was, by its own model and by the one that is tried, and the preview if it is another
    /// than before.
    pub fn solve(&mut self, question: &ShapeQuestion) -> ShapeAnswer {
        self.take_models(question);
        let reads_shape = self.own.reads_shape();
        let shape = self.own.settle(&question.inputs).map(|p| {
            let sensors = (!reads_shape).then(|| Arc::new(p.sensors));
            (Arc::new(p.shape), sensors)
        });
        let tried = self.tried.as_mut().and_then(|arm| {
            let predicted = arm.settle(&question.inputs)?;
            Some((Arc::clone(&arm.robot), Arc::new(predicted)))
        });
        if self.preview.as_ref().map(|(inputs, _)| inputs) != question.preview.as_ref() {
            self.preview = question.preview.clone().map(|inputs| {
                let shape = settled(&self.own.model, &mut self.preview_state, &inputs);
                (inputs, shape)
            });
        }
        ShapeAnswer {
            own: Arc::clone(&self.own.robot),
            shape,
            tried,
            preview: self.preview.clone(),
        }
    }
}

fn settled(model: &Model, state: &mut State, inputs: &Inputs) -> Option<Arc<ArmShape>> {
    settle(model, state, inputs).ok()?;
    Some(Arc::new(observe(model, state).shape))
}
