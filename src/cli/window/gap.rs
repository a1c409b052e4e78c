//! The Gap screen's work: sessions are read, the finder runs, an example is made by a process of its
//! own, patches go onto a copy of the robot file.

use std::collections::BTreeMap;
use std::io::Read as _;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::time::Duration;

use anyhow::{Context as _, Result};

use super::services::later;
use crate::cli::gap_bench::Maker;
use crate::cli::{gap as finder, patch, read_text, sentence};
use springtwin::gap::report::Origin;
use springtwin::gap::score::{About, Key};
use springtwin::gap::{
    CHANNELS, Found, GapError, Grid, IMU_0, Options, Patch, Progress, SPRING_0, Session, Stage,
};
use springtwin::gui::services::Worker;
use springtwin::gui::services::gap::{
    ExamplePair, GapServices, PatchedRobot, RobotMatch, SessionSheet, SheetGroup,
};
use springtwin::recording;
use springtwin::robot::{REFERENCE, RobotSpec, without_last_patch};
use springtwin::signal::{CHAMBERS, IMUS, SPRINGS};

/// Length of the sessions of the example, s.
const EXAMPLE_S: f64 = 45.0;
/// How strong the hidden effect is, times the floor.
const EXAMPLE_STRENGTH: f64 = 8.0;
/// What may be hidden in the example.
const EXAMPLE_EFFECTS: [&str; 6] = [
    "payload",
    "spring-calibration",
    "imu-misalignment",
    "base-tilt",
    "pressure-lag",
    "chamber-stiffness",
];
/// How often it is looked whether the generator is done.
const LOOK: Duration = Duration::from_millis(50);

/// The services of the Gap screen for a robot; what they make goes to `data`, patched robots beside their own file.
pub fn services(
    ctx: &egui::Context,
    robot: &RobotSpec,
    robot_file: Option<&Path>,
    data: &Path,
) -> GapServices {
    let robot = Arc::new(robot.clone());
    let store = Arc::new(Store::new(robot_file, data));
    let ctx = || ctx.clone();
    let (for_look, look_robot) = (ctx(), Arc::clone(&robot));
    let (for_find, find_robot) = (ctx(), Arc::clone(&robot));
    let (for_example, example_robot) = (ctx(), Arc::clone(&robot));
    let example_file = robot_file.map(Path::to_owned);
    let (for_examples, for_reports) = (data.to_owned(), data.to_owned());
    let (for_reveal, for_keep) = (ctx(), ctx());
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
        find: Box::new(move |healthy, suspect| {
            let (healthy, suspect) = (healthy.map(Path::to_owned), suspect.to_owned());
            let (robot, ctx) = (Arc::clone(&find_robot), for_find.clone());
            later(&for_find, "gap finder", move |worker| {
                find(&robot, healthy.as_deref(), &suspect, worker, &ctx).map_err(said)
            })
        }),
        example: Box::new(move |seed| {
            let (robot, file) = (Arc::clone(&example_robot), example_file.clone());
            let data = for_examples.clone();
            later(&for_example, "example", move |worker| {
                example(&data, &robot, file.as_deref(), seed, worker).map_err(said)
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
        undo: Box::new(move || {
            let store = Arc::clone(&undo_store);
            later(&for_undo, "patch", move |_| store.undo().map_err(said))
        }),
        keep: Box::new(move |found, patch, origin| {
            let (found, patch) = (Arc::clone(found), patch.clone());
            let data = for_reports.clone();
            later(&for_keep, "gap report", move |_| {
                keep(&data, &found, &patch, origin).map_err(said)
            })
        }),
        open_page: Box::new(open_page),
    }
}

fn said(e: anyhow::Error) -> String {
    sentence(&e)
}

/// Where the program keeps what it makes.
pub fn data_folder() -> PathBuf {
    eframe::storage_dir("springtwin").unwrap_or_else(|| std::env::temp_dir().join("springtwin"))
}

/// What is known of a session before it is used.
fn sheet(path: &Path, robot: &RobotSpec) -> Result<SessionSheet> {
    let session = finder::read(path)?;
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
    let robot = match springtwin::gap::same_robot(robot, session) {
        _ if session.robot.is_empty() => RobotMatch::Silent,
        Err(GapError::OtherRobot {
            recorded, given, ..
        }) => RobotMatch::Other { recorded, given },
        _ => RobotMatch::Same,
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
    }
}

// The finder's channels are the sheet's, in the same order.
const _: () = assert!(SPRING_0 + SPRINGS == IMU_0 && IMU_0 + 3 * IMUS == CHANNELS);

type Answer = Result<Arc<Found>, GapError>;

/// Tells the window how far the finder is; ends it when nobody waits any more.
struct Watched<'a> {
    worker: &'a Worker<Answer>,
    ctx: &'a egui::Context,
}

impl Progress for Watched<'_> {
    fn at(&self, stage: Stage, share: f64) -> Result<(), GapError> {
        if self.worker.cancelled() {
            return Err(GapError::Stopped);
        }
        self.worker.tell(stage.name(), Some(share as f32));
        self.ctx.request_repaint();
        Ok(())
    }
}

fn find(
    robot: &RobotSpec,
    healthy: Option<&Path>,
    suspect: &Path,
    worker: &Worker<Answer>,
    ctx: &egui::Context,
) -> Result<Answer> {
    #[expect(
        clippy::disallowed_methods,
        reason = "wall time of the run, for the report"
    )]
    let start = std::time::Instant::now();
    worker.tell("Reading the sessions", None);
    let healthy = healthy.map(finder::read).transpose()?;
    let suspect = finder::read(suspect)?;
    let options = Options {
        without: Vec::new(),
        seed: 1,
        excitations: finder::excitations(),
    };
    let run = || -> Answer {
        let healthy = healthy.map(Grid::new).transpose()?;
        let suspect = Grid::new(suspect)?;
        let watched = Watched { worker, ctx };
        let mut found =
            springtwin::gap::find(robot, healthy.as_ref(), &suspect, &options, &watched)?;
        found.finding.seconds = start.elapsed().as_secs_f64();
        Ok(Arc::new(found))
    };
    Ok(run())
}

/// Has another process of this program make a pair of sessions. The answer goes to a folder of its own,
/// and this process does not look into it.
fn example(
    data: &Path,
    robot: &RobotSpec,
    robot_file: Option<&Path>,
    seed: u64,
    worker: &Worker<ExamplePair>,
) -> Result<ExamplePair> {
    // Another robot or another version of this program makes other sessions.
    let name = format!(
        "{}-{}-{seed}",
        &robot.hash[..robot.hash.len().min(8)],
        env!("CARGO_PKG_VERSION")
    );
    let folder = data.join("gap-examples").join(&name);
    let answers = data.join("gap-answers");
    let pair = ExamplePair {
        healthy: folder.join("commissioning"),
        suspect: folder.join("suspect"),
        answer: answers.join(format!("{name}.json")),
    };
    // Where there is an answer, there is a whole pair.
    if pair.answer.is_file() && pair.suspect.join("session.toml").is_file() {
        return Ok(pair);
    }
    std::fs::create_dir_all(&answers)
        .with_context(|| format!("cannot create the folder {}", answers.display()))?;
    worker.tell("Simulating two sessions, one with a hidden effect", None);
    let program = std::env::current_exe().context("cannot tell where this program is")?;
    let mut child = generator(&program, robot_file, &folder, &pair.answer, seed)
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .context("cannot start the virtual rig")?;
    let words = listen(&mut child)?;
    loop {
        if let Some(status) = child.try_wait()? {
            let said = words.join().unwrap_or_default();
            return match (status.success(), said.trim()) {
                (true, _) => Ok(pair),
                (false, "") => Err(anyhow::anyhow!(
                    "the virtual rig ended with {status}: see springtwin rig case --help"
                )),
                (false, said) => Err(anyhow::anyhow!("the virtual rig: {said}")),
            };
        }
        if worker.cancelled() {
            child.kill()?;
            child.wait()?;
            anyhow::bail!("stopped on request");
        }
        std::thread::sleep(LOOK);
    }
}

/// Most of a process's complaints that is kept, bytes.
const WORDS_MAX: u64 = 4096;

/// Hears what a process complains of, to its end.
fn listen(child: &mut Child) -> Result<std::thread::JoinHandle<String>> {
    let stderr = child.stderr.take().context("the virtual rig is mute")?;
    std::thread::Builder::new()
        .name("example's words".to_owned())
        .spawn(move || {
            let mut said = Vec::new();
            let mut stderr = stderr;
            let read = std::io::Read::by_ref(&mut stderr)
                .take(WORDS_MAX)
                .read_to_end(&mut said);
            // The rest must flow, or the process would wait for ever.
            if read.is_ok() {
                let _ = std::io::copy(&mut stderr, &mut std::io::sink());
            }
            String::from_utf8_lossy(&said).into_owned()
        })
        .context("cannot start a thread for the virtual rig")
}

fn generator(
    program: &Path,
    robot_file: Option<&Path>,
    folder: &Path,
    answer: &Path,
    seed: u64,
) -> Command {
    let maker = Maker {
        program,
        robot_file,
        seconds: EXAMPLE_S,
    };
    let mut command = maker.command(About::Single, seed, EXAMPLE_STRENGTH, folder, answer);
    // A closed window leaves no generator behind.
    command.arg("--with-parent");
    for id in EXAMPLE_EFFECTS {
        command.args(["--one-of", id]);
    }
    command
}

fn key(path: &Path) -> Result<Key> {
    serde_json::from_str(&read_text(path)?)
        .with_context(|| format!("the answer {} does not read", path.display()))
}

fn keep(data: &Path, found: &Found, patch: &Patch, origin: Origin) -> Result<PathBuf> {
    let folder = data
        .join("gap-reports")
        .join(data_name(&found.finding.data, &found.patch.robot));
    finder::write_all(&folder, found, patch, origin == Origin::Simulated)?;
    Ok(folder)
}

/// The folder of a finding's report: another session, another baseline or another robot file is another
/// finding.
fn data_name(data: &BTreeMap<String, String>, robot: &str) -> String {
    let start = |hash: &str| hash.chars().take(12).collect::<String>();
    let of = |key: &str, none: &str| start(data.get(key).map_or(none, String::as_str));
    format!(
        "{}-{}-{}",
        of("session_sha256", "session"),
        of("baseline_sha256", "factory"),
        start(robot)
    )
}

/// Shows a page in the browser.
fn open_page(path: &Path) -> Result<(), String> {
    let (program, before): (&str, &[&str]) = if cfg!(target_os = "windows") {
        ("explorer", &[])
    } else if cfg!(target_os = "macos") {
        ("open", &[])
    } else {
        ("xdg-open", &[])
    };
    Command::new(program)
        .args(before)
        .arg(path)
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .map(reap)
        .map_err(|_| {
            format!(
                "No browser could be started: open {} by hand.",
                path.display()
            )
        })
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

/// The copy of the robot file that carries the accepted patches.
struct Store {
    /// The file the program was started with; the reference robot without one.
    original: Option<PathBuf>,
    /// The copy.
    path: PathBuf,
}

impl Store {
    fn new(robot_file: Option<&Path>, data: &Path) -> Self {
        let path = match robot_file {
            None => data.join("reference.patched.toml"),
            Some(file) => {
                let name = file.file_name().unwrap_or_default().to_string_lossy();
                if name.ends_with(".patched.toml") {
                    file.to_owned()
                } else {
                    file.with_extension("patched.toml")
                }
            }
        };
        Self {
            original: robot_file.map(Path::to_owned),
            path: std::path::absolute(&path).unwrap_or(path),
        }
    }

    fn original_text(&self) -> Result<String> {
        match &self.original {
            Some(file) => read_text(file),
            None => Ok(REFERENCE.to_owned()),
        }
    }

    /// The text of the copy; of the original where there is no copy yet.
    fn text(&self) -> Result<String> {
        let original = self.original_text()?;
        if !self.path.exists() {
            return Ok(original);
        }
        let text = read_text(&self.path)?;
        let base = |text: &str| -> Result<String> { Ok(RobotSpec::from_toml(text)?.base_hash) };
        anyhow::ensure!(
            base(&text)? == base(&original)?,
            "{} was made from another robot file: move it away, and patches can be accepted again",
            self.path.display()
        );
        Ok(text)
    }

    fn robot(&self, text: &str) -> Result<PatchedRobot> {
        Ok(PatchedRobot {
            path: self.path.clone(),
            robot: RobotSpec::from_toml(text)?,
        })
    }

    fn read(&self) -> Result<PatchedRobot> {
        self.robot(&self.text()?)
    }

    fn accept(&self, patch: &Patch) -> Result<PatchedRobot> {
        let text = self.text()?;
        let (new, robot) = patch::text_with(&text, patch)?;
        // Two findings on the same robot would correct the rig twice.
        let now = RobotSpec::from_toml(&text)?.patches.len();
        anyhow::ensure!(
            RobotSpec::from_toml(&text)?.hash == patch.robot,
            "{} carries {now} patch(es) that this finding does not know: take them back, or start with \
             that file and look again",
            self.path.display()
        );
        if let Some(folder) = self.path.parent() {
            std::fs::create_dir_all(folder)
                .with_context(|| format!("cannot create the folder {}", folder.display()))?;
        }
        recording::write_text(&self.path, &new)?;
        Ok(PatchedRobot {
            path: self.path.clone(),
            robot,
        })
    }

    fn undo(&self) -> Result<PatchedRobot> {
        let text = self.text()?;
        let old = without_last_patch(&text)?;
        recording::write_text(&self.path, old)?;
        self.robot(old)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use springtwin::robot::{PatchEffect, PatchValue};

    fn folder(name: &str) -> PathBuf {
        let id = std::process::id();
        std::env::temp_dir().join(format!("springtwin-gap-window-{name}-{id}"))
    }

    fn payload(robot: &RobotSpec) -> Patch {
        Patch {
            version: springtwin::gap::VERSION,
            name: "found in suspect".into(),
            robot: robot.hash.clone(),
            verdict: "named".into(),
            data: Default::default(),
            rig: Default::default(),
            floor: Default::default(),
            effects: vec![PatchEffect {
                id: "payload".into(),
                target: None,
                params: [(
                    "mass".to_owned(),
                    PatchValue {
                        value: 0.2,
                        unit: "kg".into(),
                        ci95: None,
                    },
                )]
                .into(),
            }],
        }
    }

    #[test]
    fn accepted_patches_stack_on_a_copy_and_come_off_byte_for_byte() {
        let dir = folder("store");
        std::fs::create_dir_all(&dir).expect("folder");
        let file = dir.join("arm.toml");
        std::fs::write(&file, REFERENCE).expect("writes");
        let store = Store::new(Some(&file), &dir);
        assert_eq!(store.path, dir.join("arm.patched.toml"));
        let before = store.read().expect("reads");
        assert!(before.robot.patches.is_empty() && !store.path.exists());
        let patch = payload(&before.robot);
        let after = store.accept(&patch).expect("accepts");
        assert_eq!(after.robot.patches.len(), 1);
        assert_eq!(store.read().expect("reads").robot, after.robot);
        let twice = store.accept(&patch).expect_err("twice");
        assert!(said(twice).contains("already"));
        let other = Patch {
            name: "another on the same robot".into(),
            ..patch.clone()
        };
        let both = store.accept(&other).expect_err("corrects twice");
        assert!(said(both).contains("does not know"));
        assert_eq!(store.undo().expect("undone").robot, before.robot);
        assert_eq!(read_text(&store.path).expect("there"), REFERENCE);
        assert_eq!(read_text(&file).expect("untouched"), REFERENCE);
        let nothing = store.undo().expect_err("nothing to take back");
        assert!(said(nothing).contains("no patch"));
        // A copy of another robot is not built upon.
        std::fs::write(
            &store.path,
            REFERENCE.replacen("name = \"", "name = \"x", 1),
        )
        .expect("writes");
        let refused = said(store.read().expect_err("another robot"));
        assert!(refused.contains("another robot file"), "{refused}");
        std::fs::remove_dir_all(&dir).expect("cleans up");
    }

    #[test]
    fn the_generator_is_a_process_of_its_own_with_the_answer_elsewhere() {
        let (folder, answer) = (
            Path::new("/d/gap-examples/a-1"),
            Path::new("/d/gap-answers/a-1.json"),
        );
        let command = generator(Path::new("/bin/springtwin"), None, folder, answer, 3);
        let args: Vec<String> = command
            .get_args()
            .map(|a| a.to_string_lossy().into_owned())
            .collect();
        assert_eq!(args[..4], ["rig", "case", "--kind", "single"]);
        assert!(args.contains(&"--with-parent".to_owned()));
        assert!(!answer.starts_with(folder));
        use clap::Parser as _;
        let line = std::iter::once("springtwin".to_owned()).chain(args);
        assert!(crate::cli::Cli::try_parse_from(line).is_ok());
    }

    #[cfg(unix)]
    #[test]
    fn what_the_generator_complains_of_is_heard() {
        let mut child = Command::new("sh")
            .args([
                "-c",
                "echo 'the disk is full' >&2; yes | head -c 300000 >&2; exit 3",
            ])
            .stderr(Stdio::piped())
            .spawn()
            .expect("a shell");
        let words = listen(&mut child).expect("listens");
        assert!(!child.wait().expect("ends").success());
        let said = words.join().expect("heard");
        assert!(said.starts_with("the disk is full") && said.len() as u64 == WORDS_MAX);
    }

    #[test]
    fn a_report_has_a_folder_of_its_own_for_another_baseline_or_robot() {
        let found = |session: &str, baseline: Option<&str>, robot: &str| {
            let data = [
                Some(("session_sha256", session)),
                baseline.map(|b| ("baseline_sha256", b)),
            ];
            let data = data.into_iter().flatten();
            data_name(
                &data.map(|(k, v)| (k.to_owned(), v.to_owned())).collect(),
                robot,
            )
        };
        let names = [
            found("aa", Some("bb"), "cc"),
            found("aa", Some("bd"), "cc"),
            found("aa", None, "cc"),
            found("aa", Some("bb"), "cd"),
        ];
        for (i, a) in names.iter().enumerate() {
            assert!(names[i + 1..].iter().all(|b| a != b), "{names:?}");
        }
    }

    #[test]
    fn a_sheet_tells_what_a_session_holds_and_whose_it_is() {
        let robot = RobotSpec::reference();
        let n = 100;
        let session = Session {
            name: "s".into(),
            robot: "f".repeat(64),
            t_s: (0..n).map(|k| 0.1 * k as f64).collect(),
            chamber_pa: vec![[0.0; CHAMBERS]; n],
            sensors: vec![
                springtwin::signal::SensorVec {
                    spring_m: std::array::from_fn(|i| if i == 3 { f64::NAN } else { 0.15 }),
                    imu_ypr_rad: [[0.0; 3]; IMUS],
                };
                n
            ],
            captured: vec![None; n],
            ..Session::default()
        };
        let s = sheet_of(Path::new("s"), &session, None, &robot);
        let of = |name: &str| s.groups.iter().find(|g| g.name == name).map(|g| g.present);
        assert_eq!(of("springs"), Some(11));
        assert_eq!(of("commands"), Some(0));
        assert_eq!(of("motion capture"), Some(0));
        assert!((s.rate_hz - 10.0).abs() < 1e-6, "{}", s.rate_hz);
        assert!(matches!(s.robot, RobotMatch::Other { .. }));
        let silent = Session {
            robot: String::new(),
            ..session
        };
        let s = sheet_of(Path::new("s"), &silent, None, &robot);
        assert_eq!(s.robot, RobotMatch::Silent);
    }
}
