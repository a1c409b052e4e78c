//! What the Calibrate screen asks of the program around it: benches, files, versions, long sums.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use crate::gui::services::Job;
use crate::robot::RobotSpec;
use crate::sensing::Calibration;
use crate::sensing::bench::BenchLog;
use crate::sensing::registration::{Frames, Registration};
use crate::twin::{Maps, RestPoses, Trial, TrialErrors};

/// What the virtual rig's bench shall do.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BenchRequest {
    /// Springs to draw, 0-based.
    pub springs: Vec<usize>,
    /// Spring (0-based) whose plug sits loose, if one does.
    pub loose: Option<usize>,
    /// Seed of the noise: another one for every run.
    pub seed: u64,
}

/// Two calibrations on the same motion.
#[derive(Clone, Debug)]
pub struct Question {
    /// The motion.
    pub trial: Arc<Trial>,
    /// The calibration in use before.
    pub old: Arc<Calibration>,
    /// The new one.
    pub new: Arc<Calibration>,
    /// Poses at rest that tell where motion capture is on the robot; without them the twin shows it in the base.
    pub poses: Option<RestPoses>,
}

impl Question {
    /// Tries both. Motion capture is placed for each by the poses as that one reads them: frames fitted to the
    /// poses of one would flatter it. `go_on` is told what is done and the share of all, and asked whether to go
    /// on; `None` when it says no.
    pub fn answer(
        &self,
        robot: &RobotSpec,
        maps: &Maps,
        go_on: &mut dyn FnMut(&str, f32) -> bool,
    ) -> Option<Comparison> {
        let mut part = |calibration: &Calibration, from: f32, what: &str| {
            let frames = match &self.poses {
                None => Some(Frames::IDENTITY),
                Some(poses) => poses.place(robot, maps, calibration, &mut |share| {
                    go_on(what, from + 0.25 * share)
                })?,
            };
            let mut go_on = |share: f32| go_on(what, from + 0.25 + 0.25 * share);
            let trial = &*self.trial;
            trial.errors(robot, maps, calibration, frames.as_ref(), &mut go_on)
        };
        let old = part(&self.old, 0.0, "With the calibration from before")?;
        let new = part(&self.new, 0.5, "With the new one")?;
        Some(Comparison { old, new })
    }
}

/// What became of a [`Question`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Comparison {
    /// With the calibration in use before.
    pub old: TrialErrors,
    /// With the new one.
    pub new: TrialErrors,
}

/// A saved calibration.
#[derive(Clone, Debug, PartialEq)]
pub struct Version {
    /// Counts from 1.
    pub number: u32,
    /// Day it was saved (UTC).
    pub date: String,
    /// What passed, one line.
    pub note: String,
    /// Whether the program starts with it.
    pub active: bool,
    /// What it holds, or why its files cannot be read: one sentence.
    pub kept: Result<Kept, String>,
}

/// What a version holds.
#[derive(Clone, Debug, PartialEq)]
pub struct Kept {
    /// The calibration.
    pub calibration: Arc<Calibration>,
    /// The registration of motion capture saved with it, if there is one.
    pub registration: Option<Registration>,
}

/// What is to be saved; the date is put in by whoever saves it.
#[derive(Clone, Debug, PartialEq)]
pub struct NewVersion {
    /// What passed, one line.
    pub note: String,
    /// The calibration, with its name.
    pub calibration: Calibration,
    /// The registration of motion capture, if there is one.
    pub registration: Option<Registration>,
}

/// Draws springs on a bench.
pub type Bench = Box<dyn FnMut(BenchRequest) -> Job<BenchLog> + Send>;

/// Reads a bench's log.
pub type LogReader = Box<dyn FnMut(&Path) -> Job<BenchLog> + Send>;

/// Changes what was saved and lists it again.
pub type Versions<T> = Box<dyn FnMut(T) -> Job<Vec<Version>> + Send>;

/// The services of the Calibrate screen. They are made where files may be read, and sent to the window.
pub struct CalibrationServices {
    /// The calibration the twin was started with.
    pub in_use: Arc<Calibration>,
    /// The registration that the twin's motion capture went through already.
    pub registration: Option<Registration>,
    /// The virtual rig's bench, where there is a virtual rig.
    pub bench: Option<Bench>,
    /// Reads a bench's log.
    pub read_bench: LogReader,
    /// Tries two calibrations on the same motion.
    pub compare: Box<dyn FnMut(Question) -> Job<Comparison> + Send>,
    /// Lists what was saved, newest first.
    pub versions: Box<dyn FnMut() -> Job<Vec<Version>> + Send>,
    /// Saves a version, which becomes the active one; lists them anew.
    pub save: Versions<NewVersion>,
    /// Makes another version the active one; lists them anew.
    pub activate: Versions<u32>,
    /// Where versions are kept, for the operator.
    pub folder: PathBuf,
}

impl CalibrationServices {
    /// Of a window without files and benches.
    pub fn none() -> Self {
        let no = |what: &str| format!("This window cannot {what}.");
        Self {
            in_use: Arc::new(Calibration::virtual_rig()),
            registration: None,
            bench: None,
            read_bench: Box::new(move |_| Job::ready(Err(no("read bench logs")))),
            compare: Box::new(move |_| Job::ready(Err(no("compare calibrations")))),
            versions: Box::new(|| Job::ready(Ok(Vec::new()))),
            save: Box::new(move |_| Job::ready(Err(no("save calibrations")))),
            activate: Box::new(move |_| Job::ready(Err(no("change calibrations")))),
            folder: PathBuf::new(),
        }
    }
}
