//! What the window asks of the program around it: files and other programs. The window itself does
//! no input or output.

use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, sync_channel};

use crate::signal::Trace;

/// A recording in the library.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RecordingEntry {
    /// Where it is.
    pub path: PathBuf,
    /// Name on screen.
    pub name: String,
    /// Size of the file.
    pub bytes: u64,
    /// Length, s, if known without loading it.
    pub seconds: Option<f64>,
    /// Whether the data were simulated, if known without loading it.
    pub simulated: Option<bool>,
    /// What is unusual about it (truncated, channels missing): one sentence.
    pub note: Option<String>,
}

/// A list of recordings that comes later: a thread of the program sends it once.
pub type PendingScan = Receiver<Result<Vec<RecordingEntry>, String>>;
/// A recording that comes later.
pub type PendingTrace = Receiver<Result<Trace, String>>;

/// Shows a file in another program.
pub type Opener = Box<dyn FnMut(&Path) -> Result<(), String>>;

/// What the window can ask for. Errors are sentences for the operator. Closures return at once;
/// whoever answers later asks the window for a repaint.
pub struct Services {
    /// Looks for recordings.
    pub scan: Box<dyn FnMut() -> PendingScan>,
    /// Loads a recording.
    pub load: Box<dyn FnMut(&Path) -> PendingTrace>,
    /// Opens a recording in the Rerun viewer.
    pub open_in_rerun: Opener,
    /// A fresh path for a new recording.
    pub default_recording: Box<dyn FnMut() -> PathBuf>,
}

/// An answer that is there already.
pub fn ready<T>(value: T) -> Receiver<T> {
    let (tx, rx) = sync_channel(1);
    // The channel holds one value and the receiver is alive: this cannot fail.
    let _ = tx.try_send(value);
    rx
}

impl Services {
    /// Services of a window without files: pictures and tests.
    pub fn none() -> Self {
        Self {
            scan: Box::new(|| ready(Ok(Vec::new()))),
            load: Box::new(|_| ready(Err("This window cannot load recordings.".into()))),
            open_in_rerun: Box::new(|_| Err("This window cannot open other programs.".into())),
            default_recording: Box::new(|| PathBuf::from("recording.rrd")),
        }
    }
}
