//! A search of the gap finder on files: from the sessions of a rig to the folder with what was found.

use std::path::{Path, PathBuf};

use anyhow::Result;
use serde_json::{Value, json};

use super::gap_files::{
    Known, excitations, read_grids, read_known, sessions_among, write_all, write_forces,
};
use super::provenance;
use crate::drive::stopwatch;
use crate::gap::{
    self, Discovered, Found, GapError, Grid, LawVerdict, Options, Progress, ResidualForces,
};
use crate::recording::write_text;
use crate::robot::RobotSpec;
use crate::sim::effects::Effect;

/// Files that [`Search::find`] writes.
pub const FOUND: [&str; 4] = ["patch.toml", "finding.json", "report.html", "overlay.rrd"];
/// Files that [`Search::discover`] writes.
pub const DISCOVERED: [&str; 6] = [
    "patch.toml",
    "law.json",
    "forces.csv",
    "finding.json",
    "report.html",
    "overlay.rrd",
];

/// What is searched, and where the result goes.
#[derive(Clone, Debug)]
pub struct Search {
    /// Sessions of the healthy rig, or the one baseline of it that was kept; none for the factory model.
    pub baseline: Vec<PathBuf>,
    /// Sessions in which something may be missing, the same in all.
    pub sessions: Vec<PathBuf>,
    /// Sessions without a part in the search, to test the result on.
    pub prove: Vec<PathBuf>,
    /// The effects that may be found.
    pub table: Vec<&'static Effect>,
    /// Seed of the chance sessions behind the threshold.
    pub seed: u64,
    /// Leaves out what the cameras recorded in the sessions.
    pub without_cameras: bool,
    /// Folder for the files; without one nothing is written.
    pub out: Option<PathBuf>,
    /// Labels the files as simulated, as they are anyway when a session states it.
    pub simulated: bool,
}

/// A result, and what differs between how the sessions were made.
#[derive(Clone, Debug)]
pub struct Searched<T> {
    /// The result.
    pub result: T,
    /// A sentence per difference.
    pub differences: Vec<String>,
}

impl<T> Searched<T> {
    /// A part of the result as JSON, with the differences.
    ///
    /// # Errors
    /// When it does not serialise.
    pub fn json(&self, part: &impl serde::Serialize) -> Result<Value> {
        let mut json = serde_json::to_value(part)?;
        json["differences"] = json!(self.differences);
        Ok(json)
    }
}

/// What a search reads.
struct Data {
    healthy: Known,
    suspects: Vec<Grid>,
    options: Options,
    differences: Vec<String>,
    note: Option<String>,
    simulated: bool,
}

impl Search {
    fn read(&self, robot: &RobotSpec) -> Result<Data> {
        let (differences, note) = provenance::of_gap(
            sessions_among(&self.baseline),
            self.sessions.iter().map(PathBuf::as_path),
        )?;
        let healthy = read_known(&self.baseline)?;
        let mut suspects = read_grids(&self.sessions)?;
        if self.without_cameras {
            let without = |g: Grid| Grid::new(g.session.without_cameras());
            let without: Result<_, GapError> = suspects.into_iter().map(without).collect();
            suspects = without?;
        }
        Ok(Data {
            healthy,
            suspects,
            options: Options {
                seed: self.seed,
                excitations: excitations(robot),
                prove: read_grids(&self.prove)?,
                from_start: false,
            },
            differences,
            note,
            simulated: self.simulated || provenance::any_simulated(&self.sessions)?,
        })
    }

    /// Names the known effects that are missing (`gap run`).
    ///
    /// # Errors
    /// When a file cannot be read or written, or the sessions allow no verdict, or `progress` ends it.
    pub fn find(&self, robot: &RobotSpec, progress: &dyn Progress) -> Result<Searched<Found>> {
        let start = stopwatch();
        let data = self.read(robot)?;
        let healthy = data.healthy.healthy();
        let (suspects, options) = (&data.suspects, &data.options);
        let mut found = gap::find(robot, &self.table, healthy, suspects, options, progress)?;
        found.finding.seconds = (stopwatch() - start).as_secs_f64();
        found.finding.notes.extend(data.note);
        if let Some(dir) = &self.out {
            write_all(dir, &found, &found.patch, data.simulated)?;
        }
        Ok(Searched {
            result: found,
            differences: data.differences,
        })
    }

    /// Looks for what is missing as a law (`gap discover`).
    ///
    /// # Errors
    /// As [`Self::find`].
    pub fn discover(
        &self,
        robot: &RobotSpec,
        progress: &dyn Progress,
    ) -> Result<Searched<Discovered>> {
        let start = stopwatch();
        let data = self.read(robot)?;
        let healthy = data.healthy.healthy();
        let (suspects, options) = (&data.suspects, &data.options);
        let mut done = gap::discover(robot, &self.table, healthy, suspects, options, progress)?;
        done.discovery.seconds = (stopwatch() - start).as_secs_f64();
        done.discovery.notes.extend(data.note);
        done.found.finding.seconds = done.discovery.seconds;
        if let Some(dir) = &self.out {
            let grids: Vec<&Grid> = suspects.iter().chain(&options.prove).collect();
            self.write_discovered(dir, robot, &mut done, (&grids, data.simulated))?;
        }
        Ok(Searched {
            result: done,
            differences: data.differences,
        })
    }

    /// Writes a discovery, with the residual tensions of the sessions, `grids`: first those that were searched.
    fn write_discovered(
        &self,
        dir: &Path,
        robot: &RobotSpec,
        done: &mut Discovered,
        (grids, simulated): (&[&Grid], bool),
    ) -> Result<()> {
        let forces = |robot: &RobotSpec| gap::residual_forces(robot, done.rig.as_ref(), grids);
        let without: Vec<ResidualForces> = forces(robot)?;
        let with = match done.discovery.verdict {
            LawVerdict::Law => Some(forces(&robot.patched(done.found.patch.clone()))?),
            LawVerdict::NoLaw => None,
        };
        let tension = gap::strongest(&without[..self.sessions.len()]);
        if let (LawVerdict::NoLaw, Some(d)) = (done.discovery.verdict, &tension) {
            let note = format!("{}; see forces.csv.", d.text());
            done.discovery.notes.push(note);
        }
        done.found.finding.traces.tension = tension;
        write_all(dir, &done.found, &done.found.patch, simulated)?;
        let law = serde_json::to_string_pretty(&done.discovery)?;
        write_text(&dir.join("law.json"), &law)?;
        write_forces(&dir.join("forces.csv"), &without, with.as_deref())
    }
}
