//! Jobs of the Calibrate screen: the virtual rig's bench, logs, comparisons, saved versions.

use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::Context as _;

use super::conduct::{Ask, free_folder};
use super::later::later;
use crate::cli::calibrate::now;
use springtwin::calibrate::{Comparison, Question, Store, bench, sentence};
use springtwin::drive::{Instruments, give_way, model, read_bench};
use springtwin::gui::services::calibrate::{Bench, CalibrationServices, Learnt};
use springtwin::gui::services::conduct::{Conducted, Wanted};
use springtwin::gui::services::{Job, Worker};
use springtwin::lab::learning::{self, Arm};
use springtwin::learn;
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
    /// File of the networks in use; `None`: those that ship.
    pub networks: Option<PathBuf>,
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
        networks,
    } = setting;
    let learner = Learner {
        robot: robot.clone(),
        maps: maps.clone(),
        networks,
        store: store.clone(),
        registration: registration.clone(),
        simulated: unit.is_some(),
    };
    let for_learn = ctx.clone();
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
        learn: Box::new(move |minutes, in_use| learner.begin(&for_learn, minutes, in_use)),
        folder,
    }
}

/// What learning needs to know of the arm.
#[derive(Clone)]
struct Learner {
    robot: RobotSpec,
    maps: Maps,
    networks: Option<PathBuf>,
    store: Option<Store>,
    registration: Option<Registration>,
    simulated: bool,
}

impl Learner {
    fn begin(
        &self,
        ctx: &egui::Context,
        minutes: f64,
        in_use: Arc<Calibration>,
    ) -> (Job<Learnt>, Conducted) {
        let Some(store) = self.store.clone() else {
            let why = "There is no folder for the user's data: set HOME.".to_owned();
            return (Job::ready(Err(why)), Conducted::by_nobody());
        };
        let folder = free_folder(&store.folder().join("learned"));
        let (ask, conducted) = Ask::new(folder.join(learning::file_name(0)));
        let (learner, repaint) = (self.clone(), ctx.clone());
        let job = later(ctx, "learning", move |worker| {
            give_way();
            let run = learner.run(minutes, &in_use, (&folder, &store), &ask, worker, &repaint);
            run.map_err(sentence)
        });
        (job, conducted)
    }

    /// Refuses what was saved but is not in use yet: networks, and the place of motion capture, change with the next connection.
    fn is_in_use(&self, store: &Store) -> anyhow::Result<()> {
        let saved = store.complete(Instruments::default(), self.simulated).0;
        let placed = saved.registration()?;
        anyhow::ensure!(
            saved.networks.is_none() || saved.networks == self.networks,
            "networks were saved that are not in use yet: click SIM or HARDWARE to connect again, then learn"
        );
        anyhow::ensure!(
            placed.is_none() || placed == self.registration,
            "a registration of motion capture was saved that is not in use yet: click HARDWARE to connect again, then learn"
        );
        Ok(())
    }

    fn run(
        &self,
        minutes: f64,
        in_use: &Calibration,
        (folder, store): (&Path, &Store),
        ask: &Ask,
        worker: &Worker<Learnt>,
        ctx: &egui::Context,
    ) -> anyhow::Result<Learnt> {
        const STOPPED: &str = "learning was stopped; its recordings are kept";
        self.is_in_use(store)?;
        let base = model::model(self.networks.as_deref())?;
        std::fs::create_dir_all(folder)
            .with_context(|| format!("cannot make the folder {}", folder.display()))?;
        let all = learning::excitations(&self.robot, minutes, 1);
        let recordings = learning::recorded(&all, folder, &mut |k, excitation, record| {
            let programme = excitation.programme();
            let why = format!("'{}', {} of {}", programme.name, k + 1, all.len());
            worker.tell(&why, Some(k as f32 / all.len() as f32));
            let wanted = Wanted {
                programme: programme.clone(),
                why,
                record: record.to_owned(),
            };
            anyhow::ensure!(ask.drive(wanted, worker, ctx)?, STOPPED);
            Ok(())
        })?;
        worker.tell("Adjusting the calibration", None);
        let arm = Arm {
            robot: &self.robot,
            calibration: in_use,
            in_use: &self.maps,
            base: &base,
        };
        let mut watch = |p: learn::Progress| {
            let share = p.epoch as f32 / p.epochs.max(1) as f32;
            worker.tell("Training the networks", Some(share));
            match worker.cancelled() {
                true => ControlFlow::Break(()),
                false => ControlFlow::Continue(()),
            }
        };
        let learned = arm.learn(&recordings, &mut watch)?;
        anyhow::ensure!(!worker.cancelled(), STOPPED);
        let (saved, versions) = match learned.better() {
            true => {
                let version = learned.version(self.registration.clone());
                (Some(store.save(version, &now())?), Some(store.versions()?))
            }
            false => (None, None),
        };
        let [before, after] = [learned.before, learned.after];
        Ok(Learnt {
            position_mm: [before.translation_mm, after.translation_mm],
            rotation_deg: [before.rotation_deg, after.rotation_deg],
            samples: learned.samples,
            adjusted: learned.adjusted.iter().map(|g| g.name()).collect(),
            trained: learned.trained,
            saved,
            versions,
            simulated: self.simulated,
        })
    }
}
