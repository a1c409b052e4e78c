//! What goes into the twin besides frames and commands, and what it shows of itself.

use super::state::{Phase, Twin};
use crate::control::Stopwatch;
use crate::link::Order;
use crate::sensing::Calibration;
use crate::signal::{GroundTruth, LinkStatus, Mode, RoutineStatus, Snapshot};
use crate::sim::patch::SensorErrors;
use crate::task::Target;

impl Twin {
    /// Times the controller from now on: the figures are shown and decide nothing.
    pub fn time_with(&mut self, stopwatch: Stopwatch) {
        self.controller.time_with(stopwatch);
    }

    /// The calibration that the sensors are read by.
    pub fn calibration(&self) -> &Calibration {
        self.sensing.calibration()
    }

    /// The sensor errors that the readings are corrected by.
    pub fn corrected_by(&self) -> SensorErrors {
        self.maps.corrected_by(&self.robot)
    }

    /// The networks' file, by its SHA-256; empty for maps that are from no file.
    pub fn networks(&self) -> &str {
        &self.maps.networks
    }

    /// Name and tuning of the controller.
    pub fn controller(&self) -> String {
        format!("{:?}", self.controller.gains())
    }

    /// Takes motion capture: it ends in the snapshot, never in control.
    pub fn observe_truth(&mut self, truth: GroundTruth) {
        self.truth = Some(truth);
    }

    /// Takes the state of the link.
    pub fn observe_link(&mut self, link: LinkStatus) {
        self.link = link;
    }

    /// Orders to the boards, oldest first; taken once.
    pub fn take_orders(&mut self) -> Vec<Order> {
        std::mem::take(&mut self.orders)
    }

    /// Whether the boards must stop.
    pub fn is_safe(&self) -> bool {
        matches!(self.phase, Phase::Safe(_))
    }

    /// Everything the twin knows now. What is drawn, recorded and streamed is added by whoever runs it.
    pub fn snapshot(&self) -> Snapshot {
        let goal = match self.target() {
            Some(Target::Goal(goal, _)) => Some(goal.clone()),
            Some(Target::Along(goal, _)) => Some(goal),
            Some(Target::Pressures(_)) | None => None,
        };
        Snapshot {
            stamp: self.now,
            mode: self.mode(),
            controller: self.controller.gains().kind,
            link: self.link.clone(),
            raw: self.raw.clone(),
            sensors: self.sensors.clone(),
            estimate: self.estimate.clone(),
            truth: self.truth.clone(),
            goal,
            routine: self.routine_status(),
            preview: self.preview.clone(),
            sensor_ref: self.sensor_ref,
            solve_s: self.solve_s,
            unsolved_ticks: self.controller.unsolved_ticks(),
            plant_gains: Some(self.controller.plant_gains()),
            command: self.command.clone(),
            alarms: self.alarms.clone(),
            payload_kg: self.payload_kg,
            calibration_refusal: self.calibration_refusal(),
            gauge_check: self.gauge_check(),
            ..Snapshot::default()
        }
    }

    /// What the twin is doing.
    pub fn mode(&self) -> Mode {
        match &self.phase {
            Phase::Disarmed => Mode::Disarmed,
            Phase::Hold => Mode::Hold,
            Phase::Moving { routine, .. } if routine.is_at_end() => Mode::AtGoal,
            Phase::Moving { .. } => Mode::Moving,
            Phase::Safe(reason) => Mode::Safe(reason.clone()),
        }
    }

    fn target(&self) -> Option<Target<'_>> {
        match &self.phase {
            Phase::Moving { routine, .. } => routine.target(),
            Phase::Disarmed | Phase::Hold | Phase::Safe(_) => None,
        }
    }

    fn routine_status(&self) -> Option<RoutineStatus> {
        let routine = match &self.phase {
            Phase::Moving { routine, .. } => routine,
            _ => self.paused.as_ref()?,
        };
        Some(RoutineStatus {
            name: routine.plan().name.clone(),
            legs_done: routine.legs_done(),
            legs: routine.plan().legs.len(),
            waypoint: routine.waypoint(),
            via: match routine.target() {
                Some(Target::Along(_, via)) => Some(via),
                _ => None,
            },
        })
    }
}
