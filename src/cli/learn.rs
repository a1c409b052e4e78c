//! `learn`: the networks learn one arm.

use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::{Context as _, Result};
use clap::Args;
use serde_json::json;

use super::calibrate::now;
use super::drive::rounds::{Round, RoundArgs};
use super::outputs::Overwrite;
use super::train::NETWORKS;
use super::{Report, args, user};
use springtwin::calibrate::Store;
use springtwin::drive::{Instruments, is_virtual, model};
use springtwin::lab::learning::{self, Arm, Learned};
use springtwin::lab::session::Drive;
use springtwin::recording::{RecordingFile, part_of, write_bytes, write_text};
use springtwin::rig::Unit;
use springtwin::robot::RobotSpec;
use springtwin::twin::Maps;

#[derive(Args)]
pub struct LearnArgs {
    /// Recordings with motion capture that are there already, of the rig that --rig names, read by the calibration in use: nothing is
    /// driven, and the last one is held out
    #[arg(long = "from", value_name = "F.rrd", num_args = 1.., conflicts_with = "minutes")]
    recordings: Vec<PathBuf>,
    /// Time of all excitations together, a minute each, min
    #[arg(long, value_name = "MIN", default_value_t = learning::MINUTES, value_parser = args::not_negative)]
    minutes: f64,
    /// Folder for the networks and a recording of every excitation
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    #[command(flatten)]
    overwrite: Overwrite,
    /// Save no version: the networks are written to the folder only
    #[arg(long)]
    dry_run: bool,
    #[command(flatten)]
    rounds: RoundArgs,
}

/// The file of the calibration that the networks belong to.
const CALIBRATION: &str = "calibration.toml";

/// `learn`.
pub fn run(a: &LearnArgs, robot_file: Option<&Path>, robot: &RobotSpec) -> Result<Report> {
    a.rounds.check(robot)?;
    // What is to be driven; nothing where there are recordings.
    let all = match a.recordings.is_empty() {
        true => learning::excitations(robot, a.minutes, a.rounds.seed),
        false => Vec::new(),
    };
    let mut files = vec![NETWORKS.to_owned(), CALIBRATION.to_owned()];
    files.extend((0..all.len()).map(learning::file_name));
    a.overwrite.files(&a.out, &files)?;
    a.recordings
        .iter()
        .try_for_each(|file| of_this_rig(a, file))?;
    let simulated = is_virtual(&a.rounds.rig);
    let store = user::data_folder().map(|data| Store::of(robot, simulated, &data));
    anyhow::ensure!(
        store.is_some() || a.dry_run,
        "there is no folder for the user's data: set HOME, or use --dry-run"
    );
    anyhow::ensure!(
        a.dry_run || !simulated || a.rounds.is_usual_unit(robot),
        "what another unit of the virtual rig teaches is not saved, since the window moves unit {}: give --dry-run, or a robot file \
         of `rig measure`",
        Unit::default().0
    );
    let instruments = a.rounds.instruments.with_saved(robot, &a.rounds.rig);
    let in_use = model::maps_for(robot, &a.rounds.rig, instruments.networks.as_deref())?;
    let base = model::model(instruments.networks.as_deref())?;
    std::fs::create_dir_all(&a.out)
        .with_context(|| format!("cannot make the folder {}", a.out.display()))?;
    let ends = super::signals::asked_to_end()?;
    let recordings = match a.recordings.is_empty() {
        true => drive(a, (robot_file, robot), &all, (&instruments, &in_use), &ends)?,
        false => a.recordings.clone(),
    };
    let arm = Arm {
        robot,
        calibration: &model::calibration(instruments.calibration.as_deref())?,
        in_use: &in_use,
        base: &base,
    };
    let learned = arm.learn(&recordings, &mut |_| match ends.load(Ordering::Relaxed) {
        true => ControlFlow::Break(()),
        false => ControlFlow::Continue(()),
    })?;
    anyhow::ensure!(
        !ends.load(Ordering::Relaxed),
        "learning was ended: nothing was saved, and its recordings are kept"
    );
    write_bytes(&a.out.join(NETWORKS), &learned.networks)?;
    write_text(&a.out.join(CALIBRATION), &learned.calibration.to_toml()?)?;
    let version = match &store {
        Some(store) if learned.better() && !a.dry_run => {
            Some(store.save(learned.version(instruments.registration()?), &now())?)
        }
        _ => None,
    };
    let by_itself = !simulated || robot.virtual_unit.is_some();
    Ok(report(
        &learned,
        &a.out,
        version,
        (simulated, by_itself),
        a.dry_run,
    ))
}

/// Refuses a recording of a simulated arm for hardware, and the other way round: what it teaches is kept with the calibration of
/// one of them.
fn of_this_rig(a: &LearnArgs, file: &Path) -> Result<()> {
    let (path, _) = part_of(file)?;
    let recorded = RecordingFile::open(&path)?.meta().simulated;
    let rig = &a.rounds.rig;
    let accepts = a.rounds.instruments.plain().accept_simulated_boards;
    match recorded {
        Some(false) if is_virtual(rig) => anyhow::bail!(
            "{} is of hardware: name its port with --rig, so that the calibration of that arm is used",
            file.display()
        ),
        Some(true) if !is_virtual(rig) && !accepts => anyhow::bail!(
            "{} is of a simulated arm, which teaches nothing of the one at {rig}: leave --rig out, or give \
             --accept-simulated-boards where simulated boards are at a port",
            file.display()
        ),
        _ => Ok(()),
    }
}

/// Drives all excitations; their recordings.
fn drive(
    a: &LearnArgs,
    of: (Option<&Path>, &RobotSpec),
    all: &[Drive],
    (instruments, in_use): (&Instruments, &Maps),
    ends: &Arc<AtomicBool>,
) -> Result<Vec<PathBuf>> {
    let seconds: f64 = all.iter().map(|d| d.programme().seconds).sum();
    let next = format!(
        "{} excitations of the whole workspace under motion capture, {:.0} min in all",
        all.len(),
        seconds / 60.0
    );
    a.rounds.permitted(&next, "learning")?;
    learning::recorded(all, &a.out, &mut |number, excitation, record| {
        let which = format!(
            "{} of {}: {}",
            number + 1,
            all.len(),
            excitation.programme().name
        );
        log::info!("{which}");
        let round = Round {
            number,
            excitation,
            note: format!("learning, {which}"),
            record,
            maps: Some(in_use),
        };
        a.rounds
            .drive(of, instruments.clone(), &round, a.overwrite, ends)
    })
}

fn report(
    learned: &Learned,
    out: &Path,
    version: Option<u32>,
    (simulated, by_itself): (bool, bool),
    dry_run: bool,
) -> Report {
    let (networks, calibration) = (out.join(NETWORKS), out.join(CALIBRATION));
    let groups: Vec<&str> = learned.adjusted.iter().map(|g| g.name()).collect();
    let mut text = format!(
        "learned from {} samples{}: {}",
        learned.samples[0],
        if simulated { " (simulated rig)" } else { "" },
        learned.errors()
    );
    text += &match groups.is_empty() {
        true => "\ncalibration: as it was".to_owned(),
        false => format!("\ncalibration: adjusted {}", groups.join(", ")),
    };
    if learned.trained {
        text += "\nnetworks: trained for this robot file first";
    }
    text += &match version {
        Some(n) if by_itself => format!(
            "\nsaved as version {n}: commands that drive this arm and the window use it from their next start on. The version before can \
             be restored on the Calibrate screen"
        ),
        Some(n) => format!(
            "\nsaved as version {n}, with which the window starts; commands on the virtual rig use it with --calibration {} --networks {}",
            calibration.display(),
            networks.display()
        ),
        None if learned.better() && dry_run => "\nno version was saved (--dry-run)".to_owned(),
        None => "\nno better than what is in use: no version was saved".to_owned(),
    };
    Report {
        text,
        json: json!({
            "samples": learned.samples[0],
            "held_out": learned.samples[1],
            "before": learned.before,
            "after": learned.after,
            "better": learned.better(),
            "adjusted": groups,
            "trained": learned.trained,
            "networks": networks,
            "calibration": calibration,
            "version": version,
            "simulated": simulated,
        }),
    }
}
