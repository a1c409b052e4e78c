//! Excitations one after the other, each in a recording of its own, for commands that drive the rig themselves.

use std::io::{BufRead as _, IsTerminal as _};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use anyhow::{Context as _, Result};
use clap::Args;

use super::commands::{EXCITE_BEGIN_S, ensure_carried_out};
use crate::cli::args::{self, InstrumentArgs, RollingArgs};
use crate::cli::outputs::Overwrite;
use crate::cli::{stdio, user};
use springtwin::drive::{
    DEFAULT_RIG, Drive, Instruments, TwinBuilder, drive, is_virtual, rig_options,
};
use springtwin::lab::session as lab;
use springtwin::rig::Unit;
use springtwin::rig::hidden::Hidden;
use springtwin::robot::RobotSpec;
use springtwin::task::Plan;
use springtwin::twin::Maps;

#[derive(Args)]
pub struct RoundArgs {
    /// Where the boards are: `sim` (in this process, simulated time), `pty` (a rig process behind a
    /// pseudo-terminal), or a serial port
    #[arg(long, value_name = "sim|pty|PORT[,PORT]", default_value = DEFAULT_RIG)]
    pub rig: String,
    /// Which manufactured arm the virtual rig is
    #[arg(long, value_name = "N", default_value_t = Unit::default().0)]
    unit: u64,
    /// Begin without asking; on hardware, with nobody in reach of the arm
    #[arg(long)]
    yes: bool,
    /// Mass in the gripper, declared to the twin, kg; that of the virtual rig has it, too
    #[arg(long, value_name = "KG", default_value = "0", value_parser = args::not_negative)]
    pub payload: f64,
    /// Hide an effect in the virtual rig, as `rig --hide` does
    #[arg(long, value_name = "ID[:TARGET][=VALUE,..][@S]")]
    hide: Vec<Hidden>,
    /// Let boards that are SAFE from before leave it, at each beginning: after an earlier program has ended or was not heard any
    /// more, and for causes that are named, which must be removed first
    #[arg(long, value_name = "CAUSE,...", num_args = 0..=1, value_delimiter = ',', value_parser = args::cause)]
    reset: Option<Vec<u16>>,
    /// Seed of the excitations, and of the virtual rig's noise
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub seed: u64,
    #[command(flatten)]
    pub instruments: InstrumentArgs,
    #[command(flatten)]
    rolling: RollingArgs,
}

/// One of them.
pub struct Round<'a> {
    /// Its number, from 0.
    pub number: usize,
    /// What is driven.
    pub excitation: &'a lab::Drive,
    /// The operator's note on its recording.
    pub note: String,
    /// The recording.
    pub record: &'a Path,
    /// The networks, where they are loaded already; `None`: those of the instruments.
    pub maps: Option<&'a Maps>,
}

impl RoundArgs {
    /// Whether the virtual rig is the arm that the window moves with this robot file.
    pub fn is_usual_unit(&self, robot: &RobotSpec) -> bool {
        robot.virtual_unit.is_some() || Unit(self.unit) == Unit::default()
    }

    /// Refuses what cannot be driven, before anything is.
    pub fn check(&self, robot: &RobotSpec) -> Result<()> {
        args::payload_in_range(robot, self.payload)?;
        args::hides_in_virtual(&self.hide, &self.rig)
    }

    /// Drives one excitation on a twin of its own, with these instruments.
    pub fn drive(
        &self,
        (robot_file, robot): (Option<&Path>, &RobotSpec),
        instruments: Instruments,
        round: &Round<'_>,
        overwrite: Overwrite,
        ends: &Arc<AtomicBool>,
    ) -> Result<()> {
        overwrite.file(round.record)?;
        let mut options = rig_options(self.payload, self.seed.wrapping_add(round.number as u64));
        options.unit = args::unit_of(robot, self.unit)?;
        options.hidden.clone_from(&self.hide);
        let mut twin = TwinBuilder::new(robot)
            .robot_file(robot_file)
            .rig(&self.rig, options)
            .instruments(instruments)
            .rolling(user::rolling_folder(), self.rolling.of())
            .ends_with(Arc::clone(ends));
        if let Some(maps) = round.maps {
            twin = twin.maps(maps.clone());
        }
        let programme = round.excitation.programme().clone();
        let seconds = programme.seconds + EXCITE_BEGIN_S;
        let what = Drive {
            plan: Plan::excite(programme),
            declared_kg: self.payload,
            seconds,
            after_s: 0.5,
            record: Some(round.record.to_owned()),
            note: round.note.clone(),
            // The end of a round latches the boards, as every end of a program does: the next one may let them go.
            reset: args::resets(self.reset.as_deref().or((round.number > 0).then_some(&[]))),
        };
        let driven = drive(twin, &what, None)?;
        ensure_carried_out(&driven, seconds)
            .with_context(|| format!("round {}", round.number + 1))?;
        Ok(())
    }

    /// Asks before anything moves on hardware: whether to drive `next`; `what` ends if not.
    pub fn permitted(&self, next: &str, what: &str) -> Result<()> {
        log::info!("next: {next}");
        if self.yes || is_virtual(&self.rig) {
            return Ok(());
        }
        let stdin = std::io::stdin();
        anyhow::ensure!(
            stdin.is_terminal(),
            "nobody can be asked whether the arm may move: give --yes when nobody is in its reach"
        );
        stdio::complain(&format!(
            "Next: {next}. Ctrl-C stops the arm. Drive it? [y/N]"
        ));
        let mut line = String::new();
        stdin.lock().read_line(&mut line)?;
        anyhow::ensure!(
            line.trim().eq_ignore_ascii_case("y"),
            "{what} was ended before its next excitation"
        );
        Ok(())
    }
}
