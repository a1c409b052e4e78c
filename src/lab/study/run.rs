//! Runs of studies.

use std::sync::Arc;

use anyhow::Result;

use super::options::Options;
use super::parts;
use super::report::{About, make_folder, report};
use super::setup::Setup;
use crate::lab::{Progress, Report};
use crate::robot::RobotSpec;

/// Runs one study or all of them, or a part.
///
/// # Errors
/// When the networks cannot be read, or a study or a file fails.
pub fn run(o: &Options, robot: &RobotSpec, progress: Arc<dyn Progress>) -> Result<Report> {
    make_folder(&o.out)?;
    let studies = o.selection.studies;
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
        let table = study.tabulate((study.find)(&mut setup, 0..items)?);
        table.write(&o.out)?;
        setup.progress.stage_done(table.title);
        tables.push(table);
    }
    report(&o.selection, &o.out, &tables, &setup.data(), &about)
}
