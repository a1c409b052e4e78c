//! `gap`: find the missing effect, patch the model, prove it.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result};
use clap::Subcommand;
use serde_json::json;

use super::Report;
use springtwin::gap::{self, Grid, Patch, Session};
use springtwin::recording;
use springtwin::robot::RobotSpec;

#[derive(Subcommand)]
pub enum GapCommand {
    /// Fit a healthy rig's stiffnesses, offsets, frame and clock; writes a patch of the model
    Commission {
        /// Session folder or session.toml of the healthy rig
        session: PathBuf,
        /// Patch file to write
        #[arg(long, value_name = "FILE")]
        out: PathBuf,
    },
    /// What is missing between command and gauge, from pressures alone
    Actuation {
        /// Session with commands, or a 38-column log of the ASU arm
        #[arg(long, value_name = "FILE")]
        session: PathBuf,
        /// Session of the same supply in order
        #[arg(long, value_name = "FILE")]
        baseline: Option<PathBuf>,
        /// Sessions to test the result on
        #[arg(long, value_name = "FILE")]
        prove: Vec<PathBuf>,
    },
    /// probe
    Probe { baseline: PathBuf, session: PathBuf },
}

pub fn run(command: &GapCommand, robot: &RobotSpec) -> Result<Report> {
    match command {
        GapCommand::Commission { session, out } => commission(robot, session, out),
        GapCommand::Actuation {
            session,
            baseline,
            prove,
        } => super::gap_actuation::run_actuation(session, baseline.as_deref(), prove, robot),
        GapCommand::Probe { baseline, session } => {
            let b = gap::commission(robot, &Grid::new(read(baseline)?)?, &gap::Unwatched)?;
            gap::probe(robot, &Grid::new(read(session)?)?, &b)?;
            Ok(Report {
                text: String::new(),
                json: json!({}),
            })
        }
    }
}

/// Reads a session log for the finder.
pub fn read(path: &Path) -> Result<Session> {
    let log = recording::read_session(path)?;
    Ok(Session {
        name: log.name,
        hash: log.hash,
        payload_kg: log.payload_kg,
        t_s: log.t_s,
        chamber_pa: log.chamber_pa,
        commanded_pa: log.commanded_pa,
        sensors: log.sensors,
        captured: log.truth,
    })
}

fn commission(robot: &RobotSpec, session: &Path, out: &Path) -> Result<Report> {
    let grid = Grid::new(read(session)?)?;
    let baseline = gap::commission(robot, &grid, &gap::Unwatched)?;
    let mut patch = Patch {
        version: gap::VERSION,
        name: format!("commissioned on {}", grid.session.name),
        robot: robot.hash.clone(),
        verdict: String::new(),
        data: [("commissioning".to_owned(), grid.session.hash.clone())].into(),
        rig: Default::default(),
        floor: Default::default(),
        effects: Vec::new(),
    };
    patch.set_values(&baseline.values);
    std::fs::write(out, patch.to_toml())
        .with_context(|| format!("cannot write {}", out.display()))?;
    let f = baseline.floor;
    Ok(Report {
        text: format!(
            "{} knobs to {}; floor {f:?}",
            patch.rig.len(),
            out.display()
        ),
        json: json!({"out": out, "rig": patch.rig, "floor": f}),
    })
}

/// Reads a patch for `robot`.
pub fn read_patch(path: &Path, robot: &RobotSpec) -> Result<Patch> {
    let text = std::fs::read_to_string(path)
        .with_context(|| format!("cannot read the patch {}", path.display()))?;
    let patch = Patch::from_toml(&text).with_context(|| path.display().to_string())?;
    patch
        .check_robot(robot)
        .with_context(|| path.display().to_string())?;
    Ok(patch)
}
