//! The arm's shape by the twin's own model, for whoever draws, records or streams it. It decides nothing: it is
//! settled once the tick's command is on its way, and on the host's clock by a thread of its own.

use std::sync::Arc;

use super::Runner;
use super::newest::Newest;
use crate::robot::RobotSpec;
use crate::signal::{ArmShape, Stamp};
use crate::sim::{Inputs, Model, State, observe, settle};

/// What to settle.
#[derive(Clone, Debug, PartialEq)]
pub struct ShapeQuestion {
    /// When it was asked.
    pub stamp: Stamp,
    /// Measured pressures and declared load.
    pub inputs: Inputs,
    /// The same at the end of the preview, if there is one.
    pub preview: Option<Inputs>,
}

/// What was settled.
#[derive(Clone, Debug)]
pub struct ShapeAnswer {
    /// The arm; `None` for a load that the model cannot hold.
    pub shape: Option<Arc<ArmShape>>,
    /// What the preview was solved for, and its shape.
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

/// Who settles the shapes that are drawn.
#[derive(Default)]
pub(super) enum Drawing {
    /// Nobody yet.
    #[default]
    Nobody,
    /// The tick itself, on simulated time as fast as it goes: the same seed gives the same shapes.
    Tick(Box<ShapeSolver>),
    /// A thread of its own, for which no tick waits.
    Thread(Newest<ShapeQuestion, ShapeAnswer>),
    /// The thread cannot be started: nothing is drawn.
    Failed,
}

impl Runner {
    /// Somebody looks at the arm: its shape is settled from now on. A recording or a stream looks at it, too.
    pub fn draw_shapes(&mut self) {
        self.looked_at = true;
    }

    /// Lets a thread of its own settle what is drawn.
    pub(super) fn draw_beside(&mut self) {
        let mut solver = ShapeSolver::new(&self.robot);
        let work = move |question: ShapeQuestion| solver.solve(&question);
        self.drawing = match Newest::spawn("shape", work) {
            Ok(worker) => Drawing::Thread(worker),
            Err(e) => {
                log::warn!("the arm is not drawn: a thread for its shape cannot be started ({e})");
                Drawing::Failed
            }
        };
    }

    /// Has the shape settled if it is looked at and due, and fetches what was.
    pub(super) fn exchange_shape(&mut self) {
        if !(self.looked_at || self.recording.is_some() || self.stream.is_some()) {
            return;
        }
        if matches!(self.drawing, Drawing::Nobody) {
            self.drawing = Drawing::Tick(Box::new(ShapeSolver::new(&self.robot)));
        }
        let question = self.twin.shape_question();
        let answer = match (&mut self.drawing, question) {
            (Drawing::Tick(solver), Some(question)) => Some(solver.solve(&question)),
            (Drawing::Thread(worker), question) => {
                if let Some(question) = question {
                    worker.ask(question);
                }
                worker.answer()
            }
            _ => None,
        };
        if let Some(answer) = answer {
            self.twin.observe_shape(answer);
        }
    }
}
