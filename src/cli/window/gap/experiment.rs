//! An experiment of the Gap screen: the finder on a thread of its own, the arm with the window.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context as _, Result};

use super::{Answer, Watched, said};
use crate::cli::args::commissioned;
use crate::cli::window::conduct::{Ask, free_folder};
use crate::cli::window::later::later;
use springtwin::drive::give_way;
use springtwin::gap::{GapError, Grid};
use springtwin::gui::services::conduct::{Conducted, Wanted};
use springtwin::gui::services::{Job, Worker};
use springtwin::lab::experiment::{Experiment, Strategy};
use springtwin::lab::gap_files::read_session;
use springtwin::lab::session::Drive;
use springtwin::robot::RobotSpec;
use springtwin::sim::effects;

/// Longest time of all excitations together, s.
const SECONDS: f64 = 600.0;

/// Begins one.
pub fn begin(
    ctx: &egui::Context,
    robot: Arc<RobotSpec>,
    data: &Path,
    baseline: &Path,
    payload_kg: f64,
) -> (Job<Answer>, Conducted) {
    let folder = free_folder(&data.join("experiments"));
    let (link, conducted) = Ask::new(round_file(&folder, 0));
    let baseline = baseline.to_owned();
    let repaint = ctx.clone();
    let job = later(ctx, "experiment", move |worker| {
        give_way();
        let run = || {
            conduct(
                &robot,
                &folder,
                (&baseline, payload_kg),
                &link,
                worker,
                &repaint,
            )
        };
        match run() {
            Ok(answer) => Ok(answer),
            // A finder that was stopped, or could not judge, says so itself.
            Err(e) => match e.downcast::<GapError>() {
                Ok(e) => Ok(Err(e)),
                Err(e) => Err(said(e)),
            },
        }
    });
    (job, conducted)
}

fn round_file(folder: &Path, round: usize) -> PathBuf {
    folder.join(format!("round-{}.rrd", round + 1))
}

fn conduct(
    robot: &RobotSpec,
    folder: &Path,
    (baseline, payload_kg): (&Path, f64),
    link: &Ask,
    worker: &Worker<Answer>,
    ctx: &egui::Context,
) -> Result<Answer> {
    worker.tell("Computing what to drive", None);
    let rig = commissioned(baseline)?;
    std::fs::create_dir_all(folder)
        .with_context(|| format!("cannot make the folder {}", folder.display()))?;
    let reason = std::cell::RefCell::new(String::new());
    let mut ask = |why: &str| {
        why.clone_into(&mut reason.borrow_mut());
        Ok(())
    };
    let mut arm = |round: usize, excitation: &Drive| -> Result<Grid> {
        let record = round_file(folder, round);
        worker.tell("Driving", None);
        let wanted = Wanted {
            programme: excitation.programme().clone(),
            why: reason.borrow().clone(),
            record: record.clone(),
        };
        if !link.drive(wanted, worker, ctx)? {
            return Err(GapError::Stopped.into());
        }
        worker.tell("Reading what was measured", None);
        Ok(Grid::new(read_session(&record)?)?)
    };
    let experiment = Experiment {
        robot,
        rig: &rig,
        table: &effects::table(),
        payload_kg,
        seconds: SECONDS,
        strategy: Strategy::Designed,
        seed: 1,
    };
    let out = experiment.run(&mut arm, &mut ask, &Watched { worker })?;
    let (ended, seconds) = (out.ended, out.seconds());
    let rounds = out
        .rounds
        .iter()
        .map(|r| format!("{} for {:.0} s", r.excitation, r.seconds));
    let rounds = rounds.collect::<Vec<_>>().join(", ");
    let mut found = out.found.context("no excitation fits into the time")?;
    found.finding.notes.insert(
        0,
        format!("The finder drove the arm for {seconds:.0} s: {rounds}. {ended}"),
    );
    Ok(Ok(Arc::new(found)))
}
