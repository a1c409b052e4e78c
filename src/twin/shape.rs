//! The arm's shape by the twin's own model.

use std::sync::Arc;

use crate::robot::RobotSpec;
use crate::signal::{ArmShape, Stamp};
use crate::sim::{Inputs, Model, State, observe, settle};

/// What to settle.
#[derive(Clone, Debug, PartialEq)]
pub struct ShapeQuestion {
    /// When it was asked.
    pub stamp: Stamp,
    /// Measured gauge pressures and declared load.
    pub inputs: Inputs,
    /// The same at the end of the preview; `None` without a preview.
    pub preview: Option<Inputs>,
}

/// What was settled.
#[derive(Clone, Debug)]
pub struct ShapeAnswer {
    /// The arm; `None` for a load that the model cannot hold.
    pub shape: Option<Arc<ArmShape>>,
    /// What the preview was solved for, and its shape (`None` for a load that the model cannot hold); `None` without a
    /// preview.
    pub preview: Option<(Inputs, Option<Arc<ArmShape>>)>,
}

/// The twin's own model with its last states.
pub struct ShapeSolver {
    model: Model,
    state: State,
    preview_state: State,
    preview: Option<(Inputs, Option<Arc<ArmShape>>)>,
}

impl ShapeSolver {
    /// A solver for a robot.
    pub fn new(robot: &RobotSpec) -> Self {
        let model = Model::nominal(robot);
        Self {
            state: State::rest(&model),
            preview_state: State::rest(&model),
            preview: None,
            model,
        }
    }

    /// Settles the arm from where it was, and the preview if it is another than before.
    pub fn solve(&mut self, question: &ShapeQuestion) -> ShapeAnswer {
        let shape = settled(&self.model, &mut self.state, &question.inputs);
        if self.preview.as_ref().map(|(inputs, _)| inputs) != question.preview.as_ref() {
            self.preview = question.preview.clone().map(|inputs| {
                let shape = settled(&self.model, &mut self.preview_state, &inputs);
                (inputs, shape)
            });
        }
        ShapeAnswer {
            shape,
            preview: self.preview.clone(),
        }
    }
}

fn settled(model: &Model, state: &mut State, inputs: &Inputs) -> Option<Arc<ArmShape>> {
    settle(model, state, inputs).ok()?;
    Some(Arc::new(observe(model, state).shape))
}
