//! A twin runs on a rig for a while: it watches, or steers to a target.

use core::net::SocketAddr;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::Result;

use super::driver::{Observer, TwinBuilder};
use super::limits::LimitWatch;
use super::start::{HELLO_S, Resets, Start, check_link};
use super::tally::Tally;
use crate::signal::{Goal, Mode, Snapshot, Stamp};
use crate::twin::{Command, Event, Pace};

/// What is asked of a twin while it runs.
#[derive(Clone, Debug, Default)]
pub struct Run {
    /// How long, s.
    pub seconds: f64,
    /// Payload that is declared to the twin at the start, kg.
    pub declared_kg: f64,
    /// Where the tip is steered; `None`: nothing moves.
    pub target: Option<Goal>,
    /// Where to record; `None`: nowhere.
    pub record: Option<PathBuf>,
    /// The operator's note on the recording; may be empty.
    pub note: String,
    /// The viewer to stream to; `None`: none.
    pub viewer: Option<SocketAddr>,
    /// For which causes boards that are SAFE from before may leave it.
    pub reset: Resets,
}

/// How a run went.
pub struct Ran {
    /// What it adds up to.
    pub tally: Tally,
    /// Ticks run and missed.
    pub pace: Pace,
    /// How long it lasted, s.
    pub seconds: f64,
}

/// Gives the commands of a [`Run`] when their time has come.
struct Schedule<'a> {
    run: &'a Run,
    start_up: Start,
    first: bool,
    /// Whether everything was asked of the rig.
    asked: bool,
    refused: Option<String>,
}

impl Observer for Schedule<'_> {
    fn observe(
        &mut self,
        snapshot: &Arc<Snapshot>,
        events: &[Event],
        commands: &mut Vec<Command>,
    ) -> ControlFlow<()> {
        let run = self.run;
        for event in events {
            if let Event::Refused { reason, .. } = event {
                self.refused = Some(reason.clone());
            }
        }
        if std::mem::take(&mut self.first) {
            commands.push(Command::DeclarePayload(run.declared_kg));
            commands.extend(recording(run.record.as_deref(), &run.note));
            commands.extend(run.viewer.map(Command::StreamLive));
        }
        // To watch boards that are SAFE is allowed.
        if !self.asked && (run.target.is_some() || run.reset != Resets::default()) {
            match self.start_up.ready(snapshot, commands) {
                Ok(false) => {}
                Ok(true) => {
                    self.asked = true;
                    if let Some(goal) = &run.target {
                        commands.extend([Command::Arm, Command::Goto(goal.clone())]);
                    }
                }
                Err(why) => self.refused = Some(why),
            }
        }
        let t_s = snapshot.stamp.seconds();
        let late = t_s > HELLO_S && !snapshot.link.connected && !self.asked;
        match t_s >= run.seconds || self.refused.is_some() || late {
            true => ControlFlow::Break(()),
            false => ControlFlow::Continue(()),
        }
    }
}

/// The commands that begin a recording with a note.
pub(super) fn recording(path: Option<&Path>, note: &str) -> impl Iterator<Item = Command> {
    let begin = path.map(|path| Command::StartRecording(path.to_owned()));
    let noted = path.filter(|_| !note.is_empty());
    let note = noted.map(|_| Command::Note(note.to_owned()));
    begin.into_iter().chain(note)
}

/// Runs a twin for a while.
///
/// # Errors
/// When the twin cannot be put on the rig, no data come, a command is refused, a limit is violated, or the arm goes
/// SAFE on its way.
pub fn run(twin: TwinBuilder<'_>, run: &Run) -> Result<Ran> {
    let (rig, robot) = (twin.rig, twin.robot);
    let mut driver = twin.build()?;
    let mut tally = Tally::new(run.target.clone());
    let mut schedule = Schedule {
        run,
        start_up: Start::new(run.reset),
        first: true,
        asked: false,
        refused: None,
    };
    let mut limits = LimitWatch::new(robot);
    let pace = driver.run(&mut [&mut tally, &mut schedule, &mut limits]);
    let mut refused = schedule.refused;
    let end = tally.last.as_ref().map_or(Stamp::ZERO, |s| s.stamp);
    let was_ended = driver.was_ended();
    let ended = driver.finish(end);
    tally.stream = ended.stream;
    for event in &ended.events {
        match event {
            Event::Refused { reason, .. } => {
                refused.get_or_insert_with(|| reason.clone());
            }
            Event::RecordingFailed { reason, .. } => tally.recording_failed = Some(reason.clone()),
            _ => {}
        }
    }
    limits.ensure_none()?;
    anyhow::ensure!(!was_ended, super::ENDED);
    if let Some(reason) = refused {
        anyhow::bail!("{reason}");
    }
    if let Some(snapshot) = &tally.last {
        check_link(&snapshot.link, rig)?;
        if let Mode::Safe(reason) = &snapshot.mode
            && run.target.is_some()
        {
            anyhow::bail!("the arm went SAFE: {reason}");
        }
    }
    let seconds = end.seconds();
    Ok(Ran {
        tally,
        pace,
        seconds,
    })
}
