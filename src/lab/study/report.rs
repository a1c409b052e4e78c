//! Runs of studies, and the report of their tables.

use std::path::Path;
use std::sync::Arc;

use anyhow::{Context as _, Result};
use serde_json::{Value, json};

use super::item::Field;
use super::options::{Options, SUMMARY, Selection};
use super::parts;
use super::setup::{Data, Setup};
use crate::lab::table::Table;
use crate::lab::{Progress, Report};
use crate::robot::RobotSpec;

/// What a report says of the run beside its tables.
pub(super) struct About {
    pub seed: u64,
    /// Where the networks under test come from.
    pub networks: String,
    /// SHA-256 of the samples that they were trained on.
    pub trained_on: String,
}

/// Runs one study or all of them, or a part.
///
/// # Errors
/// When networks that the studies on control would not use are given, or a study or a file fails.
pub fn run(o: &Options, robot: &RobotSpec, progress: Arc<dyn Progress>) -> Result<Report> {
    make_folder(&o.out)?;
    let studies = o.selection.studies;
    let one_on_control = studies.len() == 1 && studies.iter().any(|s| s.field == Field::Control);
    anyhow::ensure!(
        o.model.is_none() || !one_on_control,
        "the studies on control run the twin with the networks that ship: leave out --model"
    );
    let mut setup = Setup::new(robot.clone(), o.model.as_deref(), o.sizes, progress)?;
    let about = About {
        seed: o.sizes.seed,
        networks: match &o.model {
            None => "as shipped".to_owned(),
            Some(path) => path.display().to_string(),
        },
        trained_on: setup.shipped.scores.smap.data.hash.clone(),
    };
    if let Some(part) = o.shard {
        return parts::find(o, part, &mut setup, &about);
    }
    let mut tables = Vec::new();
    for (i, study) in studies.iter().enumerate() {
        let items = (study.items)(&setup.sizes);
        setup.progress.stage(&o.selection.label(i), items);
        let table = (study.table)((study.find)(&mut setup, 0..items)?);
        table.write(&o.out)?;
        setup.progress.stage_done(table.title);
        tables.push(table);
    }
    report(&o.selection, &o.out, &tables, &setup.data(), &about)
}

pub(super) fn make_folder(out: &Path) -> Result<()> {
    std::fs::create_dir_all(out).with_context(|| format!("cannot make {}", out.display()))
}

/// The report of all tables.
pub(super) fn report(
    selection: &Selection,
    out: &Path,
    tables: &[Table],
    data: &[Data],
    about: &About,
) -> Result<Report> {
    let head = format!(
        "# Studies\n\nOur figures are simulated: networks trained on the twin's simulators, scored on the virtual rig \
         (finer elements, shear, hysteresis, scatter, sensors with noise, lag and drift). Sim-to-real networks and \
         stated uncertainties come from settled samples of the same unit of the rig; the motions are new. The paper's \
         figures are from its hardware. springtwin {}, seed {}; networks under test: {}, their simulated samples SHA-256 \
         {}.\n\nData: {}\n\n",
        env!("CARGO_PKG_VERSION"),
        about.seed,
        about.networks,
        about.trained_on,
        data.iter()
            .map(|d| format!("{} ({} samples, SHA-256 {})", d.name, d.samples, d.sha256))
            .collect::<Vec<_>>()
            .join("; ")
    );
    let body: Vec<String> = tables.iter().map(Table::markdown).collect();
    let text = head + &body.join("\n");
    // One study leaves the report of all as it was.
    if selection.is_all() {
        let path = out.join(SUMMARY);
        std::fs::write(&path, &text).with_context(|| format!("cannot write {}", path.display()))?;
    }
    let tables: Vec<Value> = tables.iter().map(Table::json).collect();
    Ok(Report {
        text,
        json: json!({
            "studies": tables, "data": data, "networks": about.networks, "seed": about.seed, "simulated": true,
        }),
    })
}
