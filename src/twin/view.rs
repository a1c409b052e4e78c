//! What is drawn, recorded and streamed of the arm besides the twin's own state: its shapes by both simulators. It
//! decides nothing: it is settled once the tick's command is on its way, and on the host's clock by threads of its own.

use std::sync::Arc;

use super::mesh::{MeshAnswer, MeshQuestion, mesh_worker};
use super::newest::Newest;
use super::shape::{ShapeAnswer, ShapeQuestion, ShapeSolver};
use super::tried::{Refusal, Trial};
use crate::robot::RobotSpec;
use crate::signal::{ArmShape, CHAMBERS, MeshShape, SensorVec, Simulator, Snapshot, Stamp};
use crate::sim::Inputs;
use crate::sim::patch::SensorErrors;

/// The drawn shape is solved at most this often, s.
const SHAPE_PERIOD_S: f64 = 0.03;
/// The mesh is asked for at most this often, s: it takes about half of that on one core.
const MESH_PERIOD_S: f64 = 0.1;
/// A mesh older than this is called stale, s.
const MESH_STALE_S: f64 = 0.5;

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

/// The drawn shapes, and who settles them.
pub(super) struct View {
    /// The robot of the twin.
    robot: Arc<RobotSpec>,
    /// What its sensors are corrected by.
    corrected_by: SensorErrors,
    /// The robot of its own model: with a patch that was kept, if one was.
    own: Arc<RobotSpec>,
    kept: Option<Arc<str>>,
    tried: Option<Trial>,
    pub(super) drawing: Drawing,
    /// Started when the mesh is shown for the first time.
    pub(super) mesh_worker: Option<Newest<MeshQuestion, MeshAnswer>>,
    /// Whether somebody looks at the arm.
    looked_at: bool,
    simulator: Simulator,
    shape: Option<Arc<ArmShape>>,
    sensors: Option<Arc<SensorVec>>,
    shape_at: Option<Stamp>,
    /// The shape under preview with what it was solved for.
    preview_shape: Option<(Inputs, Option<Arc<ArmShape>>)>,
    mesh: Option<Arc<MeshShape>>,
    mesh_failure: Option<String>,
    mesh_at: Option<Stamp>,
}

impl View {
    /// The rod model of `robot`, looked at by nobody; its sensors are corrected by these errors.
    pub(super) fn new(robot: &RobotSpec, corrected_by: SensorErrors) -> Self {
        let robot = Arc::new(robot.clone());
        Self {
            corrected_by,
            own: Arc::clone(&robot),
            robot,
            kept: None,
            tried: None,
            drawing: Drawing::default(),
            mesh_worker: None,
            looked_at: false,
            simulator: Simulator::default(),
            shape: None,
            sensors: None,
            shape_at: None,
            preview_shape: None,
            mesh: None,
            mesh_failure: None,
            mesh_at: None,
        }
    }

    /// Settles the model of a patched robot beside the twin's own from now on.
    pub(super) fn try_patch(&mut self, trial: Trial) -> Result<(), Refusal> {
        trial.suits(&self.robot)?;
        self.tried = Some(trial);
        // At once.
        self.shape_at = None;
        Ok(())
    }

    /// Ends the trial; the name of the patch.
    pub(super) fn drop_tried(&mut self) -> Result<Arc<str>, Refusal> {
        self.tried.take().map(|t| t.name).ok_or(Refusal::NoTrial)
    }

    /// The model that is tried is the twin's own from now on: its robot, and the name of the patch.
    pub(super) fn keep_tried(&mut self) -> Result<(Arc<RobotSpec>, Arc<str>), Refusal> {
        let trial = self.tried.take().ok_or(Refusal::NoTrial)?;
        if let Some(predicted) = trial.predicted {
            self.shape = Some(Arc::new(predicted.shape.clone()));
            self.sensors = Some(Arc::new(predicted.sensors.clone()));
        }
        self.kept = Some(Arc::clone(&trial.name));
        self.take_own(trial.robot);
        Ok((Arc::clone(&self.own), trial.name))
    }

    /// The twin's own model is that of its robot file again: the robot, and the name of the patch.
    pub(super) fn revert_kept(&mut self) -> Result<(Arc<RobotSpec>, Arc<str>), Refusal> {
        let name = self.kept.take().ok_or(Refusal::NoneKept)?;
        self.take_own(Arc::clone(&self.robot));
        Ok((Arc::clone(&self.own), name))
    }

    fn take_own(&mut self, robot: Arc<RobotSpec>) {
        self.own = robot;
        self.shape_at = None;
        self.preview_shape = None;
        // Made again of this robot, where it is shown.
        self.mesh_worker = None;
        (self.mesh, self.mesh_failure, self.mesh_at) = (None, None, None);
    }

    /// Settles the shapes from now on.
    pub(super) fn look(&mut self) {
        self.looked_at = true;
    }

    /// Draws the arm by this simulator.
    pub(super) fn show(&mut self, simulator: Simulator) {
        self.simulator = simulator;
        self.mesh_at = None;
        self.mesh_failure = None;
        if simulator == Simulator::Rod {
            self.mesh = None;
        }
    }

    /// Lets a thread of its own settle the rod model's shapes.
    pub(super) fn draw_beside(&mut self) {
        let mut solver = self.solver();
        let work = move |question: ShapeQuestion| solver.solve(&question);
        self.drawing = match Newest::spawn("shape", work) {
            Ok(worker) => Drawing::Thread(worker),
            Err(e) => {
                log::warn!("the arm is not drawn: a thread for its shape cannot be started ({e})");
                Drawing::Failed
            }
        };
    }

    /// The robot of the twin's own model.
    #[cfg(test)]
    pub(super) fn own_robot(&self) -> Arc<RobotSpec> {
        Arc::clone(&self.own)
    }

    fn solver(&self) -> ShapeSolver {
        ShapeSolver::new(&self.own, self.corrected_by.clone())
    }

    /// Has settled what is due in a snapshot of the twin, fetches what was, and adds it. Waits for no thread.
    /// `is_kept` while it is recorded or streamed.
    pub(super) fn update(&mut self, snapshot: &mut Snapshot, is_kept: bool) {
        if self.looked_at || is_kept {
            self.update_shape(snapshot);
        }
        self.update_mesh(snapshot);
        let previewed = previewed_inputs(snapshot);
        let preview = self.preview_shape.as_ref();
        let preview = preview.filter(|(inputs, _)| previewed.as_ref() == Some(inputs));
        snapshot.preview_shape = preview.and_then(|(_, shape)| shape.clone());
        snapshot.shape.clone_from(&self.shape);
        snapshot.model_sensors.clone_from(&self.sensors);
        snapshot.kept_patch.clone_from(&self.kept);
        snapshot.tried = self.tried.as_ref().map(Trial::status);
        snapshot.simulator = self.simulator;
        snapshot.mesh.clone_from(&self.mesh);
        snapshot.mesh_trouble = self.mesh_trouble(snapshot.stamp);
    }

    fn update_shape(&mut self, snapshot: &Snapshot) {
        if matches!(self.drawing, Drawing::Nobody) {
            self.drawing = Drawing::Tick(Box::new(self.solver()));
        }
        let question = self.shape_question(snapshot);
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
            self.take_shapes(answer);
        }
    }

    /// Takes what was settled; of models that are used no longer, nothing.
    fn take_shapes(&mut self, answer: ShapeAnswer) {
        // Both models are compared at the same inputs, or not at all.
        let is_own = Arc::ptr_eq(&answer.own, &self.own);
        let is_settled = is_own && answer.shape.is_some();
        if is_own {
            // A load that the model cannot hold keeps the last shape.
            if let Some((shape, sensors)) = answer.shape {
                (self.shape, self.sensors) = (Some(shape), sensors);
            }
            self.preview_shape = answer.preview;
        }
        if let Some(trial) = &mut self.tried {
            let of_it = answer
                .tried
                .filter(|(robot, _)| is_settled && Arc::ptr_eq(robot, &trial.robot));
            trial.predicted = of_it.map(|(_, predicted)| predicted);
        }
    }

    /// What is to be settled by the rod model, if it is due: the shape at the measured pressures, and that of the
    /// preview.
    fn shape_question(&mut self, snapshot: &Snapshot) -> Option<ShapeQuestion> {
        let now = snapshot.stamp;
        if self.shape_at.is_some_and(|t| now.since(t) < SHAPE_PERIOD_S) {
            return None;
        }
        let inputs = drawn_inputs(snapshot)?;
        self.shape_at = Some(now);
        Some(ShapeQuestion {
            stamp: now,
            own: Arc::clone(&self.own),
            tried: self.tried.as_ref().map(|t| Arc::clone(&t.robot)),
            inputs,
            preview: previewed_inputs(snapshot),
        })
    }

    fn update_mesh(&mut self, snapshot: &Snapshot) {
        if let Some(question) = self.mesh_question(snapshot) {
            if self.mesh_worker.is_none() {
                match mesh_worker(&self.own) {
                    Ok(worker) => self.mesh_worker = Some(worker),
                    Err(e) => {
                        let reason = format!("a thread for the mesh cannot be started ({e})");
                        self.observe_mesh(Err(reason));
                    }
                }
            }
            if let Some(worker) = &self.mesh_worker {
                worker.ask(question);
            }
        }
        if let Some(answer) = self.mesh_worker.as_ref().and_then(Newest::answer) {
            self.observe_mesh(answer);
        }
    }

    /// What the geometric simulator is to settle, if it is shown and its shape is due.
    pub(super) fn mesh_question(&mut self, snapshot: &Snapshot) -> Option<MeshQuestion> {
        let now = snapshot.stamp;
        let waited_s = self.mesh_at.map(|t| now.since(t));
        if self.simulator == Simulator::Rod || waited_s.is_some_and(|t| t < MESH_PERIOD_S) {
            return None;
        }
        let inputs = drawn_inputs(snapshot)?;
        self.mesh_at = Some(now);
        Some(MeshQuestion { stamp: now, inputs })
    }

    /// Takes the geometric simulator's answer. A failure keeps the last good shape.
    pub(super) fn observe_mesh(&mut self, answer: MeshAnswer) {
        if self.simulator == Simulator::Rod {
            return;
        }
        match answer {
            Ok(mesh) => {
                self.mesh = Some(Arc::new(mesh));
                self.mesh_failure = None;
            }
            Err(reason) => self.mesh_failure = Some(reason),
        }
    }

    /// Why the mesh is missing or stale. Nothing while the first one is in work.
    fn mesh_trouble(&self, now: Stamp) -> Option<String> {
        let age_s = self.mesh.as_ref().map(|m| now.since(m.stamp));
        match (age_s, &self.mesh_failure) {
            (None, None) => None,
            (None, Some(reason)) => Some(format!("The rod model is drawn, because {reason}.")),
            (Some(age_s), Some(reason)) => {
                Some(format!("The mesh is {age_s:.1} s old, because {reason}."))
            }
            (Some(age_s), None) if age_s > MESH_STALE_S => Some(format!(
                "The mesh is {age_s:.1} s old: this computer does not keep up with the arm."
            )),
            (Some(_), None) => None,
        }
    }
}

fn inputs(chamber_pa: [f64; CHAMBERS], payload_kg: f64) -> Inputs {
    Inputs {
        chamber_pa,
        payload_kg,
        ..Inputs::default()
    }
}

/// What acts on the drawn arm: the measured pressures and the declared payload.
fn drawn_inputs(snapshot: &Snapshot) -> Option<Inputs> {
    let sensors = snapshot.sensors.as_ref()?;
    Some(inputs(sensors.chamber_pa, snapshot.payload_kg))
}

/// What would act on the arm at the end of the preview.
fn previewed_inputs(snapshot: &Snapshot) -> Option<Inputs> {
    let (_, reach) = snapshot.preview.as_ref()?;
    Some(inputs(reach.chamber_pa, snapshot.payload_kg))
}
