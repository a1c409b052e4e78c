//! What the Calibrate screen asks of the program: the virtual rig's bench, logs, comparisons, and the versions in
//! the user's data folder.
//!
//! A folder holds `calibration-<n>.toml` (what `--calibration` takes), `registration-<n>.toml` where motion capture
//! was registered (what `--registration` takes), and `versions.toml`, which names them and the active one and is
//! written last: a version that it does not name is not there.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context as _, Result};
use rand::SeedableRng as _;
use rand_pcg::Pcg64Mcg;
use serde::{Deserialize, Serialize};

use super::super::read_text;
use super::services::later;
use springtwin::gui::services::{
    BenchRequest, CalibrationServices, Comparison, Kept, NewVersion, Question, Version, Worker,
};
use springtwin::recording::write_text;
use springtwin::rig::circuit::{self, BenchPlan};
use springtwin::rig::{Unit, circuit_of};
use springtwin::robot::RobotSpec;
use springtwin::sensing::Calibration;
use springtwin::sensing::bench::{BenchLog, parse_bench};
use springtwin::sensing::registration::Registration;
use springtwin::twin::Maps;

const INDEX: &str = "versions.toml";
/// Format of the list that this program writes and reads; a list without a number is of format 1.
const FORMAT: u32 = 1;
/// Empty; whoever changes the folder holds it.
const LOCK: &str = "lock";
/// Digits of the robot file's hash in the folder's name.
const HASH_DIGITS: usize = 12;

/// The list of versions as it is kept.
#[derive(Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Index {
    #[serde(default = "first_format")]
    format: u32,
    active: u32,
    #[serde(default)]
    version: Vec<Entry>,
}

fn first_format() -> u32 {
    1
}

impl Default for Index {
    fn default() -> Self {
        Self {
            format: FORMAT,
            active: 0,
            version: Vec::new(),
        }
    }
}

/// The part of any list, however new, that says how to read it.
#[derive(Deserialize)]
struct Head {
    #[serde(default = "first_format")]
    format: u32,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Entry {
    number: u32,
    date: String,
    note: String,
}

/// Saved calibrations of one robot.
#[derive(Clone, Debug, PartialEq)]
pub struct Store {
    folder: PathBuf,
}

impl Store {
    /// In the folder of the user's data, apart for every robot, and for its virtual rig and its hardware.
    ///
    /// A robot file that was copied and changed is another arm under the same name; patches make none.
    pub fn of(robot: &RobotSpec, virtual_rig: bool, data: &Path) -> Self {
        let mut name: String = robot
            .name
            .chars()
            .map(|c| match c.is_ascii_alphanumeric() {
                true => c,
                false => '-',
            })
            .collect();
        name.push('-');
        name.extend(robot.base_hash.chars().take(HASH_DIGITS));
        let kind = match virtual_rig {
            true => "virtual-rig",
            false => "hardware",
        };
        let folder = data.join("calibrations").join(name).join(kind);
        Self { folder }
    }

    fn path(&self, kind: &str, number: u32) -> PathBuf {
        self.folder.join(format!("{kind}-{number}.toml"))
    }

    fn index(&self) -> Result<Index> {
        let path = self.folder.join(INDEX);
        if !path.exists() {
            return Ok(Index::default());
        }
        let text = crate::cli::read_toml(&path)?;
        let at = || path.display().to_string();
        let Head { format } = toml::from_str(&text).with_context(at)?;
        anyhow::ensure!(
            format <= FORMAT,
            "{} was written by a newer springtwin (format {format}, this one reads up to {FORMAT}): use that version, \
             or name a calibration with --calibration",
            path.display()
        );
        toml::from_str(&text).with_context(at)
    }

    fn write_index(&self, index: &Index) -> Result<()> {
        write_text(&self.folder.join(INDEX), &toml::to_string(index)?)?;
        Ok(())
    }

    fn calibration(&self, number: u32) -> Result<Calibration> {
        let path = self.path("calibration", number);
        Calibration::from_toml(&crate::cli::read_toml(&path)?)
            .with_context(|| path.display().to_string())
    }

    fn registration(&self, number: u32) -> Result<Option<Registration>> {
        let path = self.path("registration", number);
        if !path.exists() {
            return Ok(None);
        }
        let read = Registration::from_toml(&crate::cli::read_toml(&path)?);
        read.map(Some).with_context(|| path.display().to_string())
    }

    fn kept(&self, number: u32) -> Result<Kept> {
        Ok(Kept {
            calibration: Arc::new(self.calibration(number)?),
            registration: self.registration(number)?,
        })
    }

    /// All versions, newest first; one whose files are damaged says so and hides no other.
    pub fn versions(&self) -> Result<Vec<Version>> {
        let index = self.index()?;
        let version = |e: &Entry| Version {
            number: e.number,
            date: e.date.clone(),
            note: e.note.clone(),
            active: e.number == index.active,
            kept: self.kept(e.number).map_err(said),
        };
        Ok(index.version.iter().rev().map(version).collect())
    }

    /// The active version's files, if there is one; an error if they cannot be read.
    pub fn active(&self) -> Result<Option<(PathBuf, Option<PathBuf>)>> {
        let index = self.index()?;
        if !index.version.iter().any(|e| e.number == index.active) {
            return Ok(None);
        }
        self.kept(index.active)?;
        Ok(Some(self.files(index.active)))
    }

    /// The files of the newest version that can be read, where the active one cannot; nothing without one.
    pub fn last_good(&self) -> Option<(PathBuf, Option<PathBuf>)> {
        let index = self.index().ok()?;
        let mut numbers = index.version.iter().rev().map(|e| e.number);
        let good = numbers.find(|n| self.kept(*n).is_ok())?;
        Some(self.files(good))
    }

    fn files(&self, number: u32) -> (PathBuf, Option<PathBuf>) {
        let registration = self.path("registration", number);
        let calibration = self.path("calibration", number);
        (calibration, registration.exists().then_some(registration))
    }

    /// Lets nobody else change the folder while the answer is held: another window would take the same number.
    fn lock(&self) -> Result<std::fs::File> {
        std::fs::create_dir_all(&self.folder)
            .with_context(|| format!("cannot make the folder {}", self.folder.display()))?;
        let path = self.folder.join(LOCK);
        let lock = std::fs::File::create(&path)
            .and_then(|file| file.lock().map(|()| file))
            .with_context(|| format!("cannot lock {}", path.display()))?;
        Ok(lock)
    }

    /// Saves a version, which becomes the active one.
    pub fn save(&self, new: NewVersion, date: &str) -> Result<()> {
        let _lock = self.lock()?;
        let mut index = self.index()?;
        let number = index.version.iter().map(|e| e.number).max().unwrap_or(0) + 1;
        let calibration = Calibration {
            date: date.to_owned(),
            ..new.calibration
        };
        write_text(&self.path("calibration", number), &calibration.to_toml()?)?;
        let registration = self.path("registration", number);
        match new.registration {
            Some(r) => {
                let dated = Registration {
                    date: date.to_owned(),
                    ..r
                };
                write_text(&registration, &dated.to_toml()?)?;
            }
            // Of a version whose saving was cut off before the index.
            None if registration.exists() => std::fs::remove_file(&registration)?,
            None => {}
        }
        index.active = number;
        index.version.push(Entry {
            number,
            date: date.to_owned(),
            note: new.note,
        });
        self.write_index(&index)
    }

    /// Makes another version the active one.
    pub fn activate(&self, number: u32) -> Result<()> {
        let _lock = self.lock()?;
        let mut index = self.index()?;
        anyhow::ensure!(
            index.version.iter().any(|e| e.number == number),
            "there is no version {number} in {}",
            self.folder.display()
        );
        // One that does not load must not become what the program starts with.
        self.kept(number)?;
        index.active = number;
        self.write_index(&index)
    }
}

fn said(e: anyhow::Error) -> String {
    format!("{e:#}.")
}

/// Day of a time, UTC, as 2026-03-01 (H. Hinnant, chrono-compatible low-level date algorithms, `civil_from_days`).
fn day_of(seconds_since_1970: u64) -> String {
    let z = (seconds_since_1970 / 86_400) as i64 + 719_468;
    let era = z.div_euclid(146_097);
    let day_of_era = z.rem_euclid(146_097);
    let year_of_era =
        (day_of_era - day_of_era / 1460 + day_of_era / 36_524 - day_of_era / 146_096) / 365;
    let day_of_year = day_of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let m = (5 * day_of_year + 2) / 153;
    let day = day_of_year - (153 * m + 2) / 5 + 1;
    let month = if m < 10 { m + 3 } else { m - 9 };
    let year = year_of_era + era * 400 + i64::from(month <= 2);
    format!("{year:04}-{month:02}-{day:02}")
}

fn today() -> String {
    #[expect(
        clippy::disallowed_methods,
        reason = "a version tells on which day it was saved"
    )]
    let now = std::time::SystemTime::now();
    day_of(
        now.duration_since(std::time::UNIX_EPOCH)
            .map_or(0, |d| d.as_secs()),
    )
}

/// The virtual rig's bench draws all springs; those asked for are kept.
fn bench(robot: &RobotSpec, unit: Unit, request: &BenchRequest) -> Result<BenchLog> {
    let mut circuit = circuit_of(robot, unit);
    let plan = BenchPlan {
        loose: request.loose.into_iter().collect(),
        ..BenchPlan::for_robot(robot)
    };
    let mut rng = Pcg64Mcg::seed_from_u64(request.seed ^ 0xbe_7c4);
    let mut log = parse_bench(&circuit::bench(&mut circuit, &plan, &mut rng))?;
    log.springs
        .retain(|(number, _)| request.springs.contains(&(number - 1)));
    Ok(log)
}

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

/// What the screen works with.
pub struct Setting {
    /// The robot.
    pub robot: RobotSpec,
    /// Its networks.
    pub maps: Maps,
    /// The calibration the twin starts with.
    pub in_use: Calibration,
    /// The registration that the port places motion capture by.
    pub registration: Option<Registration>,
    /// Where versions are kept; without a folder for them there are none.
    pub store: Option<Store>,
    /// Which virtual rig there is, if there is one.
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
        .map_or_else(PathBuf::new, |s| s.folder.clone());
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
        bench: unit.map(|unit| -> springtwin::gui::services::Bench {
            Box::new(move |request| {
                let robot = bench_robot.clone();
                later(&for_bench, "bench", move |worker| {
                    worker.tell("The motor draws the springs", None);
                    bench(&robot, unit, &request).map_err(said)
                })
            })
        }),
        read_bench: Box::new(move |path: &Path| {
            let path = path.to_owned();
            later(&for_log, "bench log", move |_| {
                let read =
                    || parse_bench(&read_text(&path)?).with_context(|| path.display().to_string());
                read().map_err(said)
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
                store.and_then(|s| s.versions()).map_err(said)
            })
        }),
        save: Box::new(move |new| {
            let store = save();
            later(&for_save, "versions", move |_| {
                let run = || {
                    let store = store?;
                    store.save(new, &today())?;
                    store.versions()
                };
                run().map_err(said)
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
                run().map_err(said)
            })
        }),
        folder,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn version(name: &str) -> NewVersion {
        NewVersion {
            note: format!("{name} passed"),
            calibration: Calibration {
                name: name.into(),
                ..Calibration::virtual_rig()
            },
            registration: None,
        }
    }

    fn store(name: &str) -> Store {
        let id = std::process::id();
        let folder = std::env::temp_dir().join(format!("springtwin-versions-{name}-{id}"));
        Store { folder }
    }

    fn kept(v: &Version) -> &Kept {
        v.kept.as_ref().expect("reads")
    }

    #[test]
    fn a_damaged_version_is_listed_as_such_and_breaks_no_other() {
        let store = store("damaged");
        for name in ["one", "two", "three"] {
            store.save(version(name), "2026-03-01").expect("saves");
        }
        std::fs::write(store.path("calibration", 2), "name = 3").expect("writes");
        let told = |store: &Store| -> Vec<_> {
            let list = store.versions().expect("lists");
            list.iter().map(|v| (v.number, v.kept.is_ok())).collect()
        };
        assert_eq!(told(&store), [(3, true), (2, false), (1, true)]);
        // It does not become the active one.
        let e = store.activate(2).expect_err("is damaged").to_string();
        assert!(e.contains("calibration-2.toml"), "{e}");
        store.activate(1).expect("another one is sound");
        store.save(version("four"), "2026-03-02").expect("saves");
        assert_eq!(store.versions().expect("lists").len(), 4);
        // Nor does one whose registration is damaged.
        std::fs::write(store.path("registration", 1), "format = 1").expect("writes");
        assert!(store.activate(1).is_err());
        // The program does not start with an active one that is damaged.
        std::fs::write(store.path("calibration", 4), "").expect("writes");
        let e = store.active().expect_err("is damaged").to_string();
        assert!(e.contains("calibration-4.toml"), "{e}");
        std::fs::remove_dir_all(store.folder).expect("cleans up");
    }

    #[test]
    fn a_list_of_a_newer_program_is_refused_in_one_sentence_and_older_ones_are_read() {
        let store = store("newer");
        store.save(version("one"), "2026-03-01").expect("saves");
        let path = store.folder.join(INDEX);
        let text = std::fs::read_to_string(&path).expect("reads");
        assert!(text.starts_with("format = 1\n"), "{text}");
        // From before there were numbers.
        std::fs::write(&path, text.replace("format = 1\n", "")).expect("writes");
        assert_eq!(store.versions().expect("lists").len(), 1);
        // Of a form that nobody knows yet.
        std::fs::write(&path, "format = 2\nlatest = \"one\"\n").expect("writes");
        for e in [
            store.active().expect_err("newer"),
            store.save(version("two"), "2026-03-02").expect_err("newer"),
        ] {
            let e = format!("{e:#}");
            assert!(
                e.contains("versions.toml was written by a newer springtwin (format 2")
                    && !e.contains('\n'),
                "{e}"
            );
        }
        std::fs::remove_dir_all(store.folder).expect("cleans up");
    }

    #[test]
    fn windows_that_save_at_the_same_time_lose_nothing() {
        let store = store("together");
        std::thread::scope(|scope| {
            for window in 0..4 {
                let store = &store;
                let saves = move || {
                    for i in 0..5 {
                        let new = version(&format!("{window}.{i}"));
                        store.save(new, "2026-03-01").expect("saves");
                    }
                };
                let thread = std::thread::Builder::new().name("window".to_owned());
                thread.spawn_scoped(scope, saves).expect("a thread");
            }
        });
        let versions = store.versions().expect("lists");
        let numbers: Vec<u32> = versions.iter().map(|v| v.number).collect();
        assert_eq!(numbers, (1..=20).rev().collect::<Vec<_>>());
        let names: std::collections::BTreeSet<String> = versions
            .iter()
            .map(|v| kept(v).calibration.name.clone())
            .collect();
        assert_eq!(names.len(), 20);
        assert!(versions[0].active);
        std::fs::remove_dir_all(store.folder).expect("cleans up");
    }

    #[test]
    fn a_changed_copy_of_a_robot_file_does_not_get_the_first_arm_s_curves() {
        let data = Path::new("data");
        let text = springtwin::robot::REFERENCE;
        let robot = RobotSpec::reference();
        let copy = RobotSpec::from_toml(&format!("{text}\n# longer springs\n")).expect("reads");
        assert_eq!(copy.name, robot.name);
        let of = |robot: &RobotSpec| Store::of(robot, false, data).folder;
        assert_ne!(of(&robot), of(&copy));
        assert_eq!(of(&robot), of(&RobotSpec::reference()));
        assert_ne!(of(&robot), Store::of(&robot, true, data).folder);
    }

    #[test]
    fn versions_are_kept_listed_and_taken_back() {
        let store = store("kept");
        assert_eq!(store.active().expect("empty"), None);
        assert_eq!(store.versions().expect("empty"), []);
        store.save(version("one"), "2026-03-01").expect("saves");
        store.save(version("two"), "2026-03-02").expect("saves");
        let list = store.versions().expect("lists");
        let told: Vec<_> = list
            .iter()
            .map(|v| (v.number, &*kept(v).calibration.name, &*v.date, v.active))
            .collect();
        assert_eq!(
            told,
            [
                (2, "two", "2026-03-02", true),
                (1, "one", "2026-03-01", false)
            ]
        );
        assert_eq!(kept(&list[0]).calibration.date, "2026-03-02");
        store.activate(1).expect("rolls back");
        let (path, registration) = store.active().expect("reads").expect("is there");
        assert!(path.ends_with("calibration-1.toml") && registration.is_none());
        assert!(store.activate(9).is_err());
        std::fs::remove_dir_all(store.folder).expect("cleans up");
    }

    #[test]
    fn days_have_their_anchors() {
        assert_eq!(day_of(0), "1970-01-01");
        assert_eq!(day_of(951_782_400), "2000-02-29");
        assert_eq!(day_of(1_772_323_200), "2026-03-01");
    }

    #[test]
    fn a_loose_plug_is_refused_and_a_redo_draws_that_spring_alone() {
        let robot = RobotSpec::reference();
        let ask = |springs: Vec<usize>, loose, seed| {
            let request = BenchRequest {
                springs,
                loose,
                seed,
            };
            bench(&robot, Unit::default(), &request).expect("draws")
        };
        let first = ask((0..12).collect(), Some(6), 1);
        let verdict = |log: &BenchLog, number: usize| {
            let (_, points) = log.springs.iter().find(|s| s.0 == number).expect("drawn");
            springtwin::sensing::bench::fit(points, log.quantity, robot.spring.range_m).is_ok()
        };
        let passed: Vec<usize> = (1..=12).filter(|n| verdict(&first, *n)).collect();
        assert_eq!(passed, [1, 2, 3, 4, 5, 6, 8, 9, 10, 11, 12]);
        let again = ask(vec![6], None, 2);
        assert_eq!(again.springs.len(), 1);
        assert!(verdict(&again, 7));
    }
}
