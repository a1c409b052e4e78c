//! `calibrate self`.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result};
use clap::Args;
use serde_json::{Value, json};

use crate::cli::Report;
use crate::cli::outputs::{Overwrite, replace_keeping};
use springtwin::drive::read_toml;
use springtwin::lab::self_calibration::recorded_take;
use springtwin::robot::RobotSpec;
use springtwin::sensing::Calibration;
use springtwin::sensing::bundle::{Adjustment, Parameter, adjust};

/// Most parameters that a line of the report names.
const LINES_MAX: usize = 12;

#[derive(Args)]
pub struct SelfArgs {
    /// Recordings of slow motion to all sides, five minutes or so in all; with motion capture of the end pad the
    /// springs' ends are determined best
    #[arg(value_name = "SESSION.rrd", required = true)]
    recordings: Vec<PathBuf>,
    /// Where to put the calibration: that of --calibration with what was found. A file that is replaced is kept beside
    /// it as `F.toml.~1~`, `F.toml.~2~` and so on
    #[arg(long, value_name = "F.toml")]
    out: PathBuf,
    #[command(flatten)]
    overwrite: Overwrite,
    /// The calibration that the arm has; the virtual rig's without it
    #[arg(long, value_name = "F.toml")]
    calibration: Option<PathBuf>,
    /// Do not use motion capture, although it was recorded
    #[arg(long)]
    without_mocap: bool,
}

/// `calibrate self`.
pub fn self_(a: &SelfArgs, robot: &RobotSpec) -> Result<Report> {
    a.overwrite.file(&a.out)?;
    anyhow::ensure!(
        robot.patches.is_empty(),
        "the robot file has patches, which describe the same errors: use the robot file that they were applied to"
    );
    let calibration = match &a.calibration {
        None => Calibration::virtual_rig(),
        Some(path) => {
            Calibration::from_toml(&read_toml(path)?).with_context(|| path.display().to_string())?
        }
    };
    let mut takes = Vec::new();
    let mut simulated = Some(false);
    for path in &a.recordings {
        let (take, is_simulated) = recorded_take(path, &calibration, !a.without_mocap)?;
        takes.push(take);
        simulated = match (simulated, is_simulated) {
            (Some(a), Some(b)) => Some(a || b),
            _ => None,
        };
    }
    let found = adjust(robot, &calibration, &takes)?;
    let before = match found.keeps_any() {
        false => None,
        true => replace_keeping(&a.out, &found.calibration.to_toml()?)?,
    };
    Ok(report(&found, simulated, &a.out, before.as_deref()))
}

fn report(
    found: &Adjustment,
    simulated: Option<bool>,
    out: &Path,
    before: Option<&Path>,
) -> Report {
    let label = match simulated {
        Some(true) => "simulated: ",
        Some(false) => "",
        None => "origin unknown: ",
    };
    let (unit, per_unit) = match found.with_cameras {
        true => ("mm error of the tip by springs and IMUs", 1e3),
        false => ("normalised residual", 1.0),
    };
    let [blocks, held_out] = found.blocks;
    let mut text = format!(
        "{label}{} windows of slow motion in {blocks} blocks of 10 s, {held_out} of them held out; {} motion capture",
        found.frames,
        if found.with_cameras {
            "with"
        } else {
            "without"
        }
    );
    for g in &found.groups {
        let [without, with] = g.score.map(|s| s * per_unit);
        text += &format!(
            "\n{:<12}  {}  {without:.3} -> {with:.3} {unit} on held-out blocks",
            g.group.name(),
            if g.kept { "kept     " } else { "discarded" },
        );
    }
    text += &open(&found.parameters);
    text += &match (found.keeps_any(), before) {
        (false, _) => {
            "\nnothing improves held-out blocks: the calibration in use stays, and no file was written"
                .to_owned()
        }
        (true, None) => format!("\ncalibration in {}", out.display()),
        (true, Some(before)) => format!(
            "\ncalibration in {}; the one before is kept in {}",
            out.display(),
            before.display()
        ),
    };
    if found.keeps_ends() {
        text += "\nlengths are now those of the drawing: networks from simulation fit better, but sim-to-real networks that \
                 were trained before do not fit any more: train sim-to-real networks again, or run without them";
    }
    Report {
        text,
        json: json!({
            "simulated": simulated,
            "with_mocap": found.with_cameras,
            "windows": found.frames,
            "blocks": blocks,
            "held_out_blocks": held_out,
            "misfit": found.misfit,
            "groups": found.groups.iter().map(|g| json!({
                "group": g.group.name(), "kept": g.kept,
                "score": g.score, "worst_block": g.worst_block,
            })).collect::<Vec<Value>>(),
            "parameters": found.parameters.iter().map(parameter).collect::<Vec<Value>>(),
            "out": found.keeps_any().then(|| out.display().to_string()),
            "before": before.map(|p| p.display().to_string()),
        }),
    }
}

fn parameter(p: &Parameter) -> Value {
    json!({
        "name": p.name, "group": p.group.map(|g| g.name()), "unit": p.unit,
        "value": p.value, "sigma": p.sigma, "prior": p.prior,
        "observable": p.observable, "closed_by": p.closed_by, "kept": p.kept,
    })
}

/// What the motion leaves open, by what would close it.
fn open(parameters: &[Parameter]) -> String {
    let mut by: Vec<(&str, Vec<&str>)> = Vec::new();
    for p in parameters {
        let Some(closed_by) = p.closed_by else {
            continue;
        };
        match by.iter_mut().find(|(known, _)| *known == closed_by) {
            Some((_, names)) => names.push(&p.name),
            None => by.push((closed_by, vec![&p.name])),
        }
    }
    let observable = parameters.iter().filter(|p| p.observable).count();
    let mut text = format!(
        "\nobservable: {observable} of {} parameters",
        parameters.len()
    );
    for (closed_by, names) in by {
        let more = names.len().saturating_sub(LINES_MAX);
        let shown = &names[..names.len() - more];
        text += &format!("\nopen without {closed_by}: {}", shown.join("; "));
        if more > 0 {
            text += &format!("; and {more} more (--json lists all)");
        }
    }
    text
}

#[cfg(test)]
mod tests {
    #[test]
    fn the_command_parses() {
        use clap::Parser as _;
        let line = "springtwin calibrate self a.rrd b.rrd --out c.toml --calibration d.toml";
        assert!(crate::cli::program::Cli::try_parse_from(line.split(' ')).is_ok());
        let none = "springtwin calibrate self --out c.toml";
        assert!(crate::cli::program::Cli::try_parse_from(none.split(' ')).is_err());
    }
}
