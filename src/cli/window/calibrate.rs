//! Jobs of the Calibrate screen: the virtual rig's bench, logs, comparisons, saved versions.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::Context as _;

use super::later::later;
use crate::cli::calibrate::now;
use springtwin::calibrate::{Comparison, Question, Store, bench, sentence};
use springtwin::drive::read_bench;
use springtwin::gui::services::Worker;
use springtwin::gui::services::calibrate::{Bench, CalibrationServices};
use springtwin::rig::Unit;
use springtwin::robot::RobotSpec;
use springtwin::sensing::Calibration;
use springtwin::sensing::registration::Registration;
use springtwin::twin::Maps;

fn compare(
    robot: &RobotSpec,
    maps: &Maps,
    q: &Question,
    worker: &Worker<Comparison>,
) -> Option<Comparison> {
    q.answer(robot, maps, &mut |what, share| {
        worker.tell(what, Some(share));
        !worker.cancelled()
    })
}

/// What the screen needs of the program.
pub struct Setting {
    /// The robot.
    pub robot: RobotSpec,
    /// Its networks.
    pub maps: Maps,
    /// The calibration that the twin starts with.
    pub in_use: Calibration,
    /// The registration that the port transforms motion capture by.
    pub registration: Option<Registration>,
    /// Where versions are saved, if there is a folder for the user's data.
    pub store: Option<Store>,
    /// The virtual rig, if there is one.
    pub unit: Option<Unit>,
}

/// The services of the Calibrate screen.
pub fn services(ctx: &egui::Context, setting: Setting) -> CalibrationServices {
    let Setting {
        robot,
        maps,
        in_use,
        registration,
        store,
        unit,
    } = setting;
    let folder = store
        .as_ref()
        .map_or_else(PathBuf::new, |s| s.folder().to_owned());
    let store = move || {
        store
            .clone()
            .context("there is no folder for the user's data: set HOME")
    };
    let (for_list, for_save, for_activate) = (ctx.clone(), ctx.clone(), ctx.clone());
    let (list, save, activate) = (store.clone(), store.clone(), store);
    let (for_bench, for_log, for_compare) = (ctx.clone(), ctx.clone(), ctx.clone());
    let bench_robot = robot.clone();
    CalibrationServices {
        in_use: Arc::new(in_use),
        registration,
        bench: unit.map(|unit| -> Bench {
            Box::new(move |request| {
                let robot = bench_robot.clone();
                later(&for_bench, "bench", move |worker| {
                    worker.tell("The motor draws the springs", None);
                    bench::draw(&robot, unit, &request).map_err(sentence)
                })
            })
        }),
        read_bench: Box::new(move |path: &Path| {
            let path = path.to_owned();
            later(&for_log, "bench log", move |_| {
                read_bench(&path).map_err(sentence)
            })
        }),
        compare: Box::new(move |question| {
            let (robot, maps) = (robot.clone(), maps.clone());
            later(&for_compare, "validation", move |worker| {
                let found = compare(&robot, &maps, &question, worker);
                found.ok_or_else(|| "The comparison was stopped.".to_owned())
            })
        }),
        versions: Box::new(move || {
            let store = list();
            later(&for_list, "versions", move |_| {
                store.and_then(|s| s.versions()).map_err(sentence)
            })
        }),
        save: Box::new(move |new| {
            let store = save();
            later(&for_save, "versions", move |_| {
                let run = || {
                    let store = store?;
                    store.save(new, &now())?;
                    store.versions()
                };
                run().map_err(sentence)
            })
        }),
        activate: Box::new(move |number| {
            let store = activate();
            later(&for_activate, "versions", move |_| {
                let run = || {
                    let store = store?;
                    store.activate(number)?;
                    store.versions()
                };
                run().map_err(sentence)
            })
        }),
        folder,
    }
}
