//! What the Gap screen asks of the program around it.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::conduct::Conducted;
use crate::gap::report::Origin;
use crate::gap::score::Key;
use crate::gap::{Edits, Found, GapError, Patch, PatchRecord};
use crate::gui::job::Job;
use crate::robot::RobotSpec;
use crate::signal::Snapshot;

/// Whether a session is of the robot in use.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum RobotMatch {
    /// Recorded with this robot file.
    Same,
    /// The session does not record it.
    Silent,
    /// Recorded with another robot file: starts of the two hashes.
    Other {
        /// Of the session.
        recorded: String,
        /// In use.
        given: String,
    },
}

/// Which arm a baseline is of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Arm {
    /// A virtual rig.
    Virtual,
    /// A real one.
    Real,
}

impl Arm {
    /// The one that the window is connected to.
    pub fn of(live: &Snapshot) -> Self {
        match live.link.moves_hardware() {
            true => Self::Real,
            false => Self::Virtual,
        }
    }
}

/// A group of channels of a session.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SheetGroup {
    /// Its name.
    pub name: String,
    /// Channels with enough data.
    pub present: usize,
    /// Channels there could be.
    pub of: usize,
}

/// What is known of a session before it is used.
#[derive(Clone, Debug, PartialEq)]
pub struct SessionSheet {
    /// Where it is.
    pub path: PathBuf,
    /// Its name.
    pub name: String,
    /// Length, s.
    pub seconds: f64,
    /// Rate of its samples, Hz.
    pub rate_hz: f64,
    /// Declared payload, kg.
    pub payload_kg: f64,
    /// What was measured.
    pub groups: Vec<SheetGroup>,
    /// Whether it is of the robot in use.
    pub robot: RobotMatch,
    /// Whether its data were simulated; `None` if it is not recorded.
    pub simulated: Option<bool>,
    /// Since when there is a baseline, which has no length; `None` for a session.
    pub kept: Option<Kept>,
}

/// Since when there is a baseline.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Kept {
    /// It ships with the program.
    Shipped,
    /// It was fitted so many days ago.
    Days(f64),
}

/// What a session is chosen for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    /// The rig in order.
    Healthy,
    /// What may contain an effect.
    Suspect,
}

impl Part {
    /// All there are.
    pub const ALL: [Self; 2] = [Self::Healthy, Self::Suspect];

    /// Name on screen.
    pub fn name(self) -> &'static str {
        match self {
            Self::Healthy => "healthy",
            Self::Suspect => "suspect",
        }
    }
}

/// The sessions of a search.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Pair {
    /// Session of the healthy rig; the factory model without it.
    pub healthy: Option<PathBuf>,
    /// Session in which something may be missing.
    pub suspect: PathBuf,
}

/// A pair of sessions with a hidden effect.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ExamplePair {
    /// Session of the healthy rig.
    pub healthy: PathBuf,
    /// Session with the effect.
    pub suspect: PathBuf,
    /// Where the answer lies. It is read only when the operator asks, after the verdict.
    pub answer: PathBuf,
}

/// The robot file that carries the accepted patches.
#[derive(Clone, Debug, PartialEq)]
pub struct PatchedRobot {
    /// Where it is, or would be.
    pub path: PathBuf,
    /// The robot with its patches.
    pub robot: RobotSpec,
    /// Its patches, in the order in which they were put on, then those that were reverted.
    pub history: Vec<PatchRecord>,
    /// That it was edited by hand since it was written: one sentence without a full stop; `None` if it was not.
    pub edited: Option<String>,
}

/// Looks at a session.
pub type Look = Box<dyn FnMut(&Path) -> Job<SessionSheet>>;
/// Runs the finder on the sessions: with the effects of the table, or for a law after what was found with them. The job reports
/// the name of the stage ([`crate::gap::Stage::name`]) and the stage's share. An error of the job itself is one of reading.
pub type Find = Box<dyn FnMut(&Pair, Option<Arc<Found>>) -> Job<Result<Arc<Found>, GapError>>>;
/// Writes report, overlay, finding and the patch that was chosen into a folder of its own; answers with the
/// folder.
pub type Keep = Box<dyn FnMut(&Arc<Found>, &Patch, Origin) -> Job<PathBuf>>;

/// Fits a healthy session; answers with the file of the baseline.
pub type Commission = Box<dyn FnMut(&Path) -> Job<PathBuf>>;

/// Reads what was hidden in an example.
pub type KeyReader = Box<dyn FnMut(&Path) -> Job<Key>>;
/// Shows a page in another program.
pub type PageOpener = Box<dyn FnMut(&Path) -> Job<()>>;
/// Puts a patch on a robot file.
pub type Patcher = Box<dyn FnMut(&Patch) -> Job<PatchedRobot>>;

/// Begins an experiment with the baseline in a file and a declared load, kg. The job is as that of [`Find`].
pub type Experimenter =
    Box<dyn FnMut(&Path, f64) -> (Job<Result<Arc<Found>, GapError>>, Conducted)>;

/// What the Gap screen can ask for.
pub struct GapServices {
    /// Looks at a session before it is used.
    pub look: Look,
    /// Runs the finder.
    pub find: Find,
    /// Lets the finder drive the arm.
    pub experiment: Experimenter,
    /// Where the baseline of this robot is kept; nowhere before it was commissioned, unless one ships with the program.
    pub baseline: Box<dyn FnMut(Arm) -> Job<Option<PathBuf>>>,
    /// Fits the rig in order to a healthy session and keeps it as the baseline of this robot: of its virtual rig where the session is
    /// simulated.
    pub commission: Commission,
    /// Has a pair of sessions made, by a process of its own, one effect hidden in the second: which one
    /// depends on the seed.
    pub example: Box<dyn FnMut(u64) -> Job<ExamplePair>>,
    /// Reads what was hidden in an example.
    pub reveal: KeyReader,
    /// Reads the robot file that carries the accepted patches; without one the robot in use.
    pub patched: Box<dyn FnMut() -> Job<PatchedRobot>>,
    /// Puts a patch on that file.
    pub accept: Patcher,
    /// Takes the last patch back off it.
    pub undo: Box<dyn FnMut(Edits) -> Job<PatchedRobot>>,
    /// Writes report, overlay and patch of a finding.
    pub keep: Keep,
    /// Shows a page in the browser; the answer reports whether one took it.
    pub open_page: PageOpener,
}

impl GapServices {
    /// Services of a window without files.
    pub fn none() -> Self {
        let no = |what: &str| format!("This window cannot {what}.");
        Self {
            look: Box::new(move |_| Job::ready(Err(no("read sessions")))),
            find: Box::new(move |_, _| Job::ready(Err(no("read sessions")))),
            experiment: Box::new(move |_, _| {
                (Job::ready(Err(no("drive an arm"))), Conducted::by_nobody())
            }),
            baseline: Box::new(|_| Job::ready(Ok(None))),
            commission: Box::new(move |_| Job::ready(Err(no("keep baselines")))),
            example: Box::new(move |_| Job::ready(Err(no("make an example")))),
            reveal: Box::new(move |_| Job::ready(Err(no("read answers")))),
            patched: Box::new(|| {
                Job::ready(Ok(PatchedRobot {
                    path: PathBuf::new(),
                    robot: RobotSpec::reference(),
                    history: Vec::new(),
                    edited: None,
                }))
            }),
            accept: Box::new(move |_| Job::ready(Err(no("write robot files")))),
            undo: Box::new(move |_| Job::ready(Err(no("write robot files")))),
            keep: Box::new(move |_, _, _| Job::ready(Err(no("write reports")))),
            open_page: Box::new(move |_| Job::ready(Err(no("open other programs")))),
        }
    }
}
