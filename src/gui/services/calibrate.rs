//! What the Calibrate screen asks of the program around it: benches, files, versions, comparisons.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::Job;
use super::conduct::Conducted;
use crate::calibrate::{BenchRequest, Comparison, NewVersion, Question, Version};
use crate::sensing::Calibration;
use crate::sensing::bench::BenchLog;
use crate::sensing::registration::Registration;

/// Draws springs on a bench.
pub type Bench = Box<dyn FnMut(BenchRequest) -> Job<BenchLog> + Send>;

/// Reads a bench's log.
pub type LogReader = Box<dyn FnMut(&Path) -> Job<BenchLog> + Send>;

/// Changes the saved versions and lists them again.
pub type Versions<T> = Box<dyn FnMut(T) -> Job<Vec<Version>> + Send>;

/// What networks and calibration learned of an arm.
#[derive(Clone, Debug)]
pub struct Learnt {
    /// Mean error of the tip's position on what was held out, before and after, mm.
    pub position_mm: [f64; 2],
    /// Mean error of yaw, pitch and roll, before and after, deg.
    pub rotation_deg: [f64; 2],
    /// Samples that were learned from, and held out.
    pub samples: [usize; 2],
    /// What of the calibration was adjusted.
    pub adjusted: Vec<&'static str>,
    /// Whether networks were trained on the model of the robot file first.
    pub trained: bool,
    /// The version that was saved; `None`: nothing was better.
    pub saved: Option<u32>,
    /// All versions after that; `None` where none was saved.
    pub versions: Option<Vec<Version>>,
    /// Whether the arm is simulated.
    pub simulated: bool,
}

/// Begins to learn the arm in so many minutes of motion, from the calibration in use.
pub type Learner = Box<dyn FnMut(f64, Arc<Calibration>) -> (Job<Learnt>, Conducted) + Send>;

/// The services of the Calibrate screen. They are made where files may be read, and sent to the window.
pub struct CalibrationServices {
    /// The calibration the twin was started with.
    pub in_use: Arc<Calibration>,
    /// The registration that the twin's motion capture was already transformed by.
    pub registration: Option<Registration>,
    /// The virtual rig's bench, where there is a virtual rig.
    pub bench: Option<Bench>,
    /// Reads a bench's log.
    pub read_bench: LogReader,
    /// Compares two calibrations on the same motion.
    pub compare: Box<dyn FnMut(Question) -> Job<Comparison> + Send>,
    /// Lists the saved versions, newest first.
    pub versions: Box<dyn FnMut() -> Job<Vec<Version>> + Send>,
    /// Saves a version, which becomes the active one, and lists all of them.
    pub save: Versions<NewVersion>,
    /// Makes another version the active one, and lists all of them.
    pub activate: Versions<u32>,
    /// Drives the arm and learns it.
    pub learn: Learner,
    /// The folder of the versions, for the operator.
    pub folder: PathBuf,
}

impl CalibrationServices {
    /// Services of a window without files and benches.
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
            learn: Box::new(move |_, _| {
                (Job::ready(Err(no("drive an arm"))), Conducted::by_nobody())
            }),
            folder: PathBuf::new(),
        }
    }
}
