//! The Gap screen's work: sessions are read, the finder runs, an example is made by a process of its
//! own, patches go onto a copy of the robot file.

mod experiment;
mod store;

use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::time::Duration;

use anyhow::{Context as _, Result};

use super::later::later;
use super::rigs::Rigs;
use crate::cli::signals::taken_by_child;
use crate::cli::{read_text, sentence, user};
use springtwin::drive::give_way;
use springtwin::gap::report::Origin;
use springtwin::gap::score::Key;
use springtwin::gap::{
    CHANNELS, Commissioned, Found, GapError, Grid, IMU_0, Options, Patch, Progress, SPRING_0,
    Session, Stage, Unwatched, find_law,
};
use springtwin::gui::services::Worker;
use springtwin::gui::services::gap::{
    Arm, ExamplePair, GapServices, Kept, Pair, RobotMatch, SessionSheet, SheetGroup,
};
use springtwin::lab::commission::{beyond, kinds};
use springtwin::lab::gap_bench::{self, Example};
use springtwin::lab::gap_files;
use springtwin::lab::provenance;
use springtwin::lab::virtual_baseline;
use springtwin::recording;
use springtwin::robot::RobotSpec;
use springtwin::signal::{CHAMBERS, IMUS, SPRINGS};
use springtwin::sim::effects;
use store::Store;

/// How often it is looked whether the generator is done.
const LOOK: Duration = Duration::from_millis(50);

/// The services of the Gap screen for the robot of `rigs`; what they make goes to `data`, patched robots beside their own file.
pub fn services(ctx: &egui::Context, rigs: &Rigs, data: &Path) -> GapServices {
    let robot = Arc::new(rigs.robot.clone());
    let robot_file = rigs.robot_file.as_deref();
    let store = Arc::new(Store::new(robot_file, data));
    let ctx = || ctx.clone();
    let (for_look, look_robot) = (ctx(), Arc::clone(&robot));
    let (for_find, find_robot) = (ctx(), Arc::clone(&robot));
    let (for_example, example_robot) = (ctx(), Arc::clone(&robot));
    let example_file = robot_file.map(Path::to_owned);
    let (for_examples, for_reports) = (data.to_owned(), data.to_owned());
    let (for_reveal, for_keep, for_page) = (ctx(), ctx(), ctx());
    let (for_kept, kept_rigs, kept_data) = (ctx(), rigs.clone(), data.to_owned());
    let (for_commission, commissioned_rigs) = (ctx(), rigs.clone());
    let commissioned_data = data.to_owned();
    let (for_experiment, experiment_robot) = (ctx(), Arc::clone(&robot));
    let experiment_data = data.to_owned();
    let (for_patched, read_store) = (ctx(), Arc::clone(&store));
    let (for_accept, accept_store) = (ctx(), Arc::clone(&store));
    let (for_undo, undo_store) = (ctx(), Arc::clone(&store));
    GapServices {
        look: Box::new(move |path| {
            let (path, robot) = (path.to_owned(), Arc::clone(&look_robot));
            later(&for_look, "session reader", move |_| {
                sheet(&path, &robot).map_err(said)
            })
        }),
        baseline: Box::new(move |arm| {
            let (rigs, data) = (kept_rigs.clone(), kept_data.clone());
            later(&for_kept, "baseline", move |_| {
                rigs.baseline_of(arm, &data).map_err(said)
            })
        }),
        commission: Box::new(move |path| {
            let (path, rigs) = (path.to_owned(), commissioned_rigs.clone());
            let data = commissioned_data.clone();
            later(&for_commission, "commissioning", move |worker| {
                give_way();
                let kept = rigs.place_of(arm_of(&path), &data).map_err(said)?;
                commission(&path, &rigs.robot, &kept, worker).map_err(said)
            })
        }),
        find: Box::new(move |pair, known| {
            let (robot, pair) = (Arc::clone(&find_robot), pair.clone());
            later(&for_find, "gap finder", move |worker| {
                give_way();
                find(&robot, &pair, known.as_deref(), worker).map_err(said)
            })
        }),
        experiment: Box::new(move |baseline, payload_kg| {
            let robot = Arc::clone(&experiment_robot);
            experiment::begin(
                &for_experiment,
                robot,
                &experiment_data,
                baseline,
                payload_kg,
            )
        }),
        example: Box::new(move |seed| {
            let (robot, file) = (Arc::clone(&example_robot), example_file.clone());
            let data = for_examples.clone();
            later(&for_example, "example", move |worker| {
                let stage = |what: &str| worker.tell(what, None);
                let cancelled = || worker.cancelled();
                let file = file.as_deref();
                let made = gap_bench::example(&data, &robot, file, seed, &stage, &cancelled);
                made.map(pair_of).map_err(said)
            })
        }),
        reveal: Box::new(move |path| {
            let path = path.to_owned();
            later(&for_reveal, "answer", move |_| key(&path).map_err(said))
        }),
        patched: Box::new(move || {
            let store = Arc::clone(&read_store);
            later(&for_patched, "robot file", move |_| {
                store.read().map_err(said)
            })
        }),
        accept: Box::new(move |patch| {
            let (store, patch) = (Arc::clone(&accept_store), patch.clone());
            later(&for_accept, "patch", move |_| {
                store.accept(&patch).map_err(said)
            })
        }),
        undo: Box::new(move |edits| {
            let store = Arc::clone(&undo_store);
            later(&for_undo, "patch", move |_| store.undo(edits).map_err(said))
        }),
        keep: Box::new(move |found, patch, origin| {
            let (found, patch) = (Arc::clone(found), patch.clone());
            let data = for_reports.clone();
            later(&for_keep, "gap report", move |_| {
                keep(&data, &found, &patch, origin).map_err(said)
            })
        }),
        open_page: Box::new(move |path| {
            let path = path.to_owned();
            later(&for_page, "browser", move |_| open_page(&path, OPENERS))
        }),
    }
}

fn said(e: anyhow::Error) -> String {
    sentence(&e)
}

/// Where the program keeps what it makes.
pub fn data_folder() -> PathBuf {
    user::data_folder().unwrap_or_else(|| std::env::temp_dir().join("springtwin"))
}

/// Which arm a session is of, as far as it states that.
fn arm_of(path: &Path) -> Arm {
    let states = || recording::inspect(path).ok()?.simulated;
    match recording::is_rrd(path).then(states).flatten() {
        Some(true) => Arm::Virtual,
        _ => Arm::Real,
    }
}

/// Fits the rig in order to a healthy session and keeps it.
fn commission(
    path: &Path,
    robot: &RobotSpec,
    kept: &Path,
    worker: &Worker<PathBuf>,
) -> Result<PathBuf> {
    worker.tell("Fitting the healthy rig", None);
    let grids = gap_files::read_grids(&[path.to_owned()])?;
    let rig = Commissioned::new(robot, &grids, &Unwatched)?;
    if let Some(large) = beyond(&kinds(&rig.arm.floor), |k| k.refuse) {
        anyhow::bail!("{large}: the model does not follow the session, so it is no baseline");
    }
    let folder = kept.parent().unwrap_or(kept);
    std::fs::create_dir_all(folder)
        .with_context(|| format!("cannot make the folder {}", folder.display()))?;
    recording::write_text(kept, &rig.to_toml())?;
    Ok(kept.to_owned())
}

/// A baseline that was kept, as a session without samples.
fn sheet_of_baseline(path: &Path, rig: &Commissioned, robot: &RobotSpec) -> SessionSheet {
    let ships = rig
        .sessions
        .iter()
        .any(|s| s[0] == virtual_baseline::SESSION);
    let made = path.metadata().and_then(|m| m.modified()).ok();
    let age = made.and_then(|t| t.elapsed().ok()).unwrap_or_default();
    let kept = match ships {
        true => Kept::Shipped,
        false => Kept::Days(age.as_secs_f64() / 86_400.0),
    };
    let group = |name: &str, channels: std::ops::Range<usize>, each: usize| SheetGroup {
        name: name.to_owned(),
        present: channels.clone().filter(|c| rig.present[*c]).count() / each,
        of: channels.len() / each,
    };
    let commands = SheetGroup {
        name: "commands".to_owned(),
        present: usize::from(rig.supply.is_some()),
        of: 1,
    };
    let sessions: Vec<&str> = rig.sessions.iter().map(|s| s[0].as_str()).collect();
    let known = springtwin::gap::recorded_with(robot, "the baseline", &rig.robot);
    SessionSheet {
        path: path.to_owned(),
        name: format!("Baseline of {}", sessions.join(", ")),
        seconds: 0.0,
        rate_hz: 1.0 / rig.period_s,
        payload_kg: 0.0,
        groups: vec![
            commands,
            group("springs", SPRING_0..IMU_0, 1),
            group("IMUs", IMU_0..CHANNELS, 3),
            group("motion capture", 0..SPRING_0, SPRING_0),
        ],
        robot: robot_match(known),
        simulated: None,
        kept: Some(kept),
    }
}

/// Whether what was recorded is of the robot in use, by the finder's own check.
fn robot_match(checked: Result<(), GapError>) -> RobotMatch {
    match checked {
        Err(GapError::OtherRobot {
            recorded, given, ..
        }) => RobotMatch::Other { recorded, given },
        _ => RobotMatch::Same,
    }
}

/// What is known of a session, or of a baseline, before it is used.
fn sheet(path: &Path, robot: &RobotSpec) -> Result<SessionSheet> {
    if let Some(rig) = gap_files::read_baseline(path)? {
        return Ok(sheet_of_baseline(path, &rig, robot));
    }
    let session = gap_files::read_session(path)?;
    let simulated = match recording::is_rrd(path) {
        true => recording::inspect(path)?.simulated,
        false => None,
    };
    Ok(sheet_of(path, &session, simulated, robot))
}

fn sheet_of(
    path: &Path,
    session: &Session,
    simulated: Option<bool>,
    robot: &RobotSpec,
) -> SessionSheet {
    let rows = session.t_s.len();
    let seconds = match (session.t_s.first(), session.t_s.last()) {
        (Some(a), Some(b)) => b - a,
        _ => 0.0,
    };
    // Half of the samples, as the finder wants it.
    let there =
        |has: &dyn Fn(usize) -> bool| rows > 0 && 2 * (0..rows).filter(|n| has(*n)).count() >= rows;
    let count = |of: usize, has: &dyn Fn(usize, usize) -> bool| {
        (0..of).filter(|i| there(&|n| has(n, *i))).count()
    };
    let group = |name: &str, present, of| SheetGroup {
        name: name.to_owned(),
        present,
        of,
    };
    let groups = vec![
        group(
            "pressures",
            count(CHAMBERS, &|n, i| session.chamber_pa[n][i].is_finite()),
            CHAMBERS,
        ),
        group(
            "commands",
            session
                .commanded_pa
                .as_ref()
                .map_or(0, |u| count(CHAMBERS, &|n, i| u[n][i].is_finite())),
            CHAMBERS,
        ),
        group(
            "springs",
            count(SPRINGS, &|n, i| session.sensors[n].spring_m[i].is_finite()),
            SPRINGS,
        ),
        group(
            "IMUs",
            count(IMUS, &|n, i| {
                session.sensors[n].imu_ypr_rad[i]
                    .iter()
                    .all(|v| v.is_finite())
            }),
            IMUS,
        ),
        group(
            "motion capture",
            count(1, &|n, _| session.captured[n].is_some()),
            1,
        ),
    ];
    let robot = match session.robot.is_empty() {
        true => RobotMatch::Silent,
        false => robot_match(springtwin::gap::same_robot(robot, session)),
    };
    SessionSheet {
        path: path.to_owned(),
        name: session.name.clone(),
        seconds,
        rate_hz: if seconds > 0.0 {
            (rows - 1) as f64 / seconds
        } else {
            0.0
        },
        payload_kg: session.payload_kg,
        groups,
        robot,
        simulated,
        kept: None,
    }
}

// The finder's channels are the sheet's, in the same order.
const _: () = assert!(SPRING_0 + SPRINGS == IMU_0 && IMU_0 + 3 * IMUS == CHANNELS);

type Answer = Result<Arc<Found>, GapError>;

/// Reports the progress of the finder to the window; stops it once it is cancelled.
struct Watched<'a> {
    worker: &'a Worker<Answer>,
}

impl Progress for Watched<'_> {
    fn at(&self, stage: Stage, share: f64) -> Result<(), GapError> {
        if self.worker.cancelled() {
            return Err(GapError::Stopped);
        }
        self.worker.tell(stage.name(), Some(share as f32));
        Ok(())
    }
}

fn find(
    robot: &RobotSpec,
    pair: &Pair,
    known: Option<&Found>,
    worker: &Worker<Answer>,
) -> Result<Answer> {
    #[expect(
        clippy::disallowed_methods,
        reason = "wall time of the run, for the report"
    )]
    let start = std::time::Instant::now();
    worker.tell("Reading the sessions", None);
    let (healthy, suspect) = (pair.healthy.as_deref(), &*pair.suspect);
    let healthy: Vec<PathBuf> = healthy.map(Path::to_path_buf).into_iter().collect();
    let (_, note) = provenance::of_gap(gap_files::sessions_among(&healthy), [suspect])?;
    let rig = gap_files::read_known(&healthy)?;
    let suspect = gap_files::read_session(suspect)?;
    let options = Options {
        seed: 1,
        excitations: gap_files::excitations(robot),
        prove: Vec::new(),
        from_start: false,
    };
    let run = || -> Answer {
        let suspect = Grid::new(suspect)?;
        let watched = Watched { worker };
        let (healthy, suspects) = (rig.healthy(), &[suspect]);
        let mut found = match known {
            Some(known) => find_law(robot, known, healthy, suspects, &options, &watched)?,
            None => {
                let table = effects::table();
                springtwin::gap::find(robot, &table, healthy, suspects, &options, &watched)?
            }
        };
        found.finding.seconds = start.elapsed().as_secs_f64();
        found.finding.notes.extend(note.clone());
        Ok(Arc::new(found))
    };
    Ok(run())
}

fn pair_of(example: Example) -> ExamplePair {
    ExamplePair {
        healthy: example.healthy,
        suspect: example.suspect,
        answer: example.answer,
    }
}

fn key(path: &Path) -> Result<Key> {
    serde_json::from_str(&read_text(path)?)
        .with_context(|| format!("the answer {} does not read", path.display()))
}

fn keep(data: &Path, found: &Found, patch: &Patch, origin: Origin) -> Result<PathBuf> {
    let mut name = gap_files::report_folder(&found.finding.data, &found.patch.robot);
    if found.finding.is_of_laws() {
        name += "-law";
    }
    let folder = data.join("gap-reports").join(name);
    gap_files::write_all(&folder, found, patch, origin == Origin::Simulated)?;
    Ok(folder)
}

/// What shows a file in the program that it belongs to.
const OPENERS: &[&str] = if cfg!(target_os = "windows") {
    &["explorer"]
} else if cfg!(target_os = "macos") {
    &["open"]
} else {
    &["xdg-open"]
};
/// A program that opens pages and still runs after this time has found a browser.
const BROWSER_FOUND: Duration = Duration::from_secs(5);

/// Shows a page in the browser: by the first of `openers` that there is. Waits until it is known whether that found
/// one.
fn open_page(path: &Path, openers: &[&str]) -> Result<(), String> {
    let start = |program: &&str| {
        let mut command = Command::new(program);
        command
            .arg(path)
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::null());
        taken_by_child(|| command.spawn()).ok()
    };
    let no = |why: &str| Err(format!("The report cannot be shown in a browser: {why}."));
    let Some(mut child) = openers.iter().find_map(start) else {
        return no("this computer has no program that opens pages");
    };
    let looks = BROWSER_FOUND.as_millis() / LOOK.as_millis();
    for _ in 0..looks {
        match child.try_wait() {
            // Windows' own opener ends with an error when all went well.
            Ok(Some(_)) if cfg!(windows) => return Ok(()),
            Ok(Some(status)) if status.success() => return Ok(()),
            Ok(Some(_)) => return no("no browser was found"),
            Ok(None) => std::thread::sleep(LOOK),
            Err(e) => return no(&e.to_string()),
        }
    }
    reap(child);
    Ok(())
}

/// Waits for a program that was started, on a thread of its own: what has ended shall not linger.
fn reap(mut child: Child) {
    let waiting = std::thread::Builder::new()
        .name("browser".to_owned())
        .spawn(move || child.wait());
    if let Err(e) = waiting {
        log::warn!("no thread waits for the browser: {e}");
    }
}

#[cfg(test)]
mod tests;
