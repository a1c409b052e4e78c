//! The report of all tables of a run.

use std::path::Path;

use anyhow::{Context as _, Result};
use serde_json::{Value, json};

use super::options::{PAPER, SUMMARY, Selection};
use super::paper;
use super::setup::Data;
use crate::lab::Report;
use crate::lab::table::Table;

/// Facts of the run for the head of the report.
pub(super) struct About {
    pub seed: u64,
    /// Where the networks under test come from.
    pub networks: String,
    /// SHA-256 of the samples that they were trained on.
    pub trained_on: String,
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
         (another plant, hysteresis, manufacturing scatter, sensors with noise, lag and drift). Figures are over its test \
         units. As shipped: the shipped networks, and the curves of the unit's own springs. After the lab's \
         calibration: besides, sim-to-real networks and stated uncertainties from a motion-capture session of the unit; \
         the motions are new. The paper's figures are from its hardware. springtwin {}, seed {}; networks under test: {}, their simulated samples SHA-256 \
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
    // One study leaves the report of several as it was.
    if selection.is_several() {
        let page = paper::page(tables, about.seed)?;
        for (name, text) in [(SUMMARY, &text), (PAPER, &page)] {
            let path = out.join(name);
            std::fs::write(&path, text)
                .with_context(|| format!("cannot write {}", path.display()))?;
        }
    }
    let tables: Vec<Value> = tables.iter().map(Table::json).collect();
    Ok(Report {
        text,
        json: json!({
            "studies": tables, "data": data, "networks": about.networks, "seed": about.seed, "simulated": true,
        }),
    })
}
