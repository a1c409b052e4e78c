//! What the Calibrate screen asks of the program around it: benches, files, versions, comparisons.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::Job;
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
            folder: PathBuf::new(),
        }
    }
}
