//! What the window asks of the program around it: files, long work, other programs. The window itself
//! does no input or output and starts no thread.

pub mod calibrate;
pub mod conduct;
pub mod gap;

use core::net::SocketAddr;
use std::path::{Path, PathBuf};

use crate::analysis::pairing::{Alignment, Pairing};
use crate::analysis::player::Player;
use crate::sensing::registration::Registration;
use crate::signal::{Annotations, NoteChange};
use crate::twin::Handle;

pub use super::job::{Job, Pending, Stage, Worker};

pub use calibrate::CalibrationServices;

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
    /// Whether it came with the program.
    pub sample: bool,
    /// The operator's note and the texts of the marks.
    pub noted: Vec<String>,
    /// When it began, if known without loading it.
    pub begun: Option<Begun>,
}

/// When a recording began.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Begun {
    /// Seconds since 1970, UTC.
    pub unix_s: i64,
    /// Local date and time of this computer, as `2026-11-23 14:05`.
    pub local: String,
}

/// What a folder for recordings has left.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Space {
    /// Bytes that may still be written there; `None` where the system does not report it.
    pub free_bytes: Option<u64>,
    /// What the recording that was named takes so far, bytes.
    pub written_bytes: u64,
    /// Local date and time now, as `2026-11-23 14:05`.
    pub local: String,
}

/// What a file dialog asks for.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Dialog {
    /// Its title.
    pub title: String,
    /// Whether a file is read or written.
    pub kind: DialogKind,
    /// Name of the kind of file and its extensions, without dots; none: any file.
    pub filter: Option<(String, Vec<String>)>,
    /// Suggested name, when a file is written.
    pub name: String,
}

/// What a [`Dialog`] chooses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DialogKind {
    /// A file that exists.
    Open,
    /// A file to write.
    Save,
    /// A folder that exists.
    Folder,
}

/// What became of a [`Dialog`].
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Picked {
    /// The operator chose a path. For a file to write, the dialog has asked whether one that exists is replaced.
    Path(PathBuf),
    /// The operator chose nothing.
    Cancelled,
    /// This computer shows no file dialogs: the path has to be typed.
    NoDialog,
}

/// What is done with a file that is there already.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Existing {
    /// It is kept: the new one gets a number behind its name.
    Kept,
    /// It is replaced, as the operator has confirmed.
    Replaced,
}

/// A folder that the operator may choose.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Folder {
    /// What is used without a choice.
    pub default: PathBuf,
    /// What the operator chose.
    pub chosen: Option<PathBuf>,
}

impl Folder {
    /// Not chosen yet.
    pub fn of(default: PathBuf) -> Self {
        Self {
            default,
            chosen: None,
        }
    }

    /// Where it is.
    pub fn path(&self) -> &Path {
        self.chosen.as_ref().unwrap_or(&self.default)
    }
}

/// Makes the bytes of a file; called by whoever writes it.
pub type Content = Box<dyn FnOnce() -> Result<Vec<u8>, String> + Send>;

/// A twin that was put on a rig, and what belongs to that rig.
pub struct Connected {
    /// The twin.
    pub handle: Handle,
    /// The rig's calibrations, and where motion capture lies on it; or why they cannot be read: one sentence.
    pub belongings: Result<(CalibrationServices, Option<Registration>), String>,
}

/// A serial port that could be connected to.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct PortEntry {
    /// What it is opened by.
    pub name: String,
    /// What is behind it, as reported by the system; may be empty.
    pub what: String,
}

/// Puts a twin on a rig: `sim`, `pty`, or the names of serial ports.
pub type Connector = Box<dyn FnMut(&str) -> Job<Connected>>;
/// Looks for recordings in a folder of the operator's, and for those that came with the program.
pub type Scanner = Box<dyn FnMut(&Path) -> Job<Vec<RecordingEntry>>>;
/// Finds a path in a folder for a new recording, which is named after the local date and time, and behind them after
/// what the operator calls it (may be empty). The folder is made when it is missing.
pub type Namer = Box<dyn FnMut(&Path, &str) -> Job<PathBuf>>;
/// Gives a recording another name, with all that belongs to it, and answers with its path then. Nothing is replaced.
pub type Renamer = Box<dyn FnMut(&Path, &str) -> Job<PathBuf>>;
/// Measures what a folder has left, and what the recording of a name in it takes (no name: none).
pub type SpaceMeter = Box<dyn FnMut(&Path, &str) -> Job<Space>>;
/// Changes note and marks of a recording, and answers with them as they are then.
pub type Annotator = Box<dyn FnMut(&Path, Vec<NoteChange>) -> Job<Annotations>>;
/// Makes a recording in a folder of the last seconds of the rolling recording that begins with a file, with a note; answers
/// with its path.
pub type Keeper = Box<dyn FnMut(&Path, &Path, f64, String) -> Job<PathBuf>>;
/// What the rolling recording takes, after its limit is changed where one is given, bytes.
pub type RollingLimit = Box<dyn FnMut(Option<u64>) -> Job<RollingUse>>;

/// The folder of rolling recordings.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct RollingUse {
    /// Where it is.
    pub folder: PathBuf,
    /// What its files may take, bytes; 0 when nothing is recorded.
    pub limit_bytes: u64,
    /// What they take, bytes.
    pub used_bytes: u64,
}

/// Loads a recording.
pub type Loader = Box<dyn FnMut(&Path) -> Job<Player>>;
/// A film that was made.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Filmed {
    /// The film, or the folder of its frames.
    pub path: PathBuf,
    /// What it is, as `the video of 12.0 s`.
    pub what: String,
    /// Why there are frames instead of a film: one sentence; else `None`.
    pub why_frames: Option<String>,
}

/// Finds how two recordings lie on each other.
pub type Aligner = Box<dyn FnMut(Pairing) -> Job<Alignment>>;
/// Makes a film of a recording, at a path or at the next free name like it. Where nothing encodes films, its frames are written.
pub type Filmer = Box<dyn FnMut(&Path, &Path, Existing) -> Job<Filmed>>;
/// Shows a file in another program.
pub type Opener = Box<dyn FnMut(&Path) -> Job<()>>;
/// Writes a file and answers with its path. The folder is made when it is missing.
pub type Writer = Box<dyn FnMut(&Path, Existing, Content) -> Job<PathBuf>>;
/// Asks the operator for a path.
pub type PathPicker = Box<dyn FnMut(Dialog) -> Job<Picked>>;

/// What the window can ask for. Errors are sentences for the operator. Closures return at once;
/// whoever answers later asks the window for a repaint.
pub struct Services {
    /// Where recordings go.
    pub recordings: Folder,
    /// Default folder of tables, pictures and reports.
    pub exports: PathBuf,
    /// Looks for recordings.
    pub scan: Scanner,
    /// Loads a recording and indexes its signals.
    pub load: Loader,
    /// Makes a recording of the last seconds of a rolling one.
    pub keep: Keeper,
    /// Folder, limit and use of rolling recordings.
    pub rolling: RollingLimit,
    /// Changes note and marks of a recording.
    pub annotate: Annotator,
    /// Finds how two recordings lie on each other, by work that takes seconds on long ones.
    pub align: Aligner,
    /// Makes a film of a recording, by work that takes minutes on long ones.
    pub film: Filmer,
    /// Opens a recording in the Rerun viewer.
    pub open_in_rerun: Opener,
    /// Starts the Rerun viewer on this machine, or finds the one that it started before, and answers with where
    /// it listens.
    pub start_viewer: Box<dyn FnMut() -> Job<SocketAddr>>,
    /// Finds a path for a new recording.
    pub new_recording: Namer,
    /// Gives a recording another name.
    pub rename: Renamer,
    /// Measures the space that is left for recordings.
    pub space: SpaceMeter,
    /// A native file dialog.
    pub pick: PathPicker,
    /// Writes a small file (a table, a report) whole or not at all.
    pub write: Writer,
    /// The serial ports there are.
    pub ports: Box<dyn FnMut() -> Job<Vec<PortEntry>>>,
    /// Puts a new twin on a rig and reads what belongs to it; the one before has been let go by then.
    pub connect: Connector,
    /// What the Gap screen asks for.
    pub gap: gap::GapServices,
    /// What the Calibrate screen asks for.
    pub calibration: CalibrationServices,
}

impl Services {
    /// Services of a window without files: pictures and tests.
    pub fn none() -> Self {
        let no = |what: &str| format!("This window cannot {what}.");
        Self {
            recordings: Folder::of(PathBuf::from("recordings")),
            exports: PathBuf::from("exports"),
            scan: Box::new(|_| Job::ready(Ok(Vec::new()))),
            load: Box::new(move |_| Job::ready(Err(no("load recordings")))),
            keep: Box::new(move |_, _, _, _| Job::ready(Err(no("write files")))),
            rolling: Box::new(|_| Job::ready(Ok(RollingUse::default()))),
            annotate: Box::new(move |_, _| Job::ready(Err(no("write files")))),
            align: Box::new(move |pairing| {
                let found = pairing.align(&|| true);
                Job::ready(found.ok_or_else(|| no("align recordings")))
            }),
            film: Box::new(move |_, _, _| Job::ready(Err(no("write files")))),
            open_in_rerun: Box::new(move |_| Job::ready(Err(no("open other programs")))),
            start_viewer: Box::new(move || Job::ready(Err(no("open other programs")))),
            new_recording: Box::new(|folder, _| Job::ready(Ok(folder.join("recording.rrd")))),
            rename: Box::new(move |_, _| Job::ready(Err(no("rename files")))),
            space: Box::new(|_, _| Job::ready(Ok(Space::default()))),
            pick: Box::new(|_| Job::ready(Ok(Picked::NoDialog))),
            write: Box::new(move |_, _, _| Job::ready(Err(no("write files")))),
            ports: Box::new(|| Job::ready(Ok(Vec::new()))),
            connect: Box::new(move |_| Job::ready(Err(no("connect to a rig")))),
            gap: gap::GapServices::none(),
            calibration: CalibrationServices::none(),
        }
    }
}
