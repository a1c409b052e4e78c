//! Saved calibrations: versions of one robot in a folder of the user's data.
//!
//! A folder holds `calibration-<n>.toml` (what `--calibration` takes), `registration-<n>.toml` where motion capture
//! was registered (what `--registration` takes), `networks-<n>.safetensors` where networks were learned with it (what
//! `--networks` takes), and `versions.toml`, which lists them, names the active one and is
//! written last: a version that it does not list does not exist.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context as _, Result};

use super::list::{Entry, VersionList, lock_folder};
use super::versions::{Kept, NewVersion, Version};
use crate::drive::{Instruments, model, read_toml};
use crate::recording::{write_bytes, write_text};
use crate::robot::RobotSpec;
use crate::sensing::Calibration;
use crate::sensing::registration::Registration;

/// Digits of the robot file's hash in the folder's name.
const HASH_DIGITS: usize = 12;

/// What one can do without the list.
const OTHERWISE: &str = "name a calibration with --calibration";

/// Files of a version.
#[derive(Clone, Debug, PartialEq)]
pub struct VersionFiles {
    /// What `--calibration` takes.
    pub calibration: PathBuf,
    /// What `--registration` takes; `None` where motion capture was not registered.
    pub registration: Option<PathBuf>,
    /// What `--networks` takes; `None` where no networks were learned with it.
    pub networks: Option<PathBuf>,
}

/// Saved calibrations of one robot.
#[derive(Clone, Debug, PartialEq)]
pub struct Store {
    folder: PathBuf,
}

impl Store {
    /// The store below the user's data folder: one for each robot, and for its virtual rig and its hardware.
    ///
    /// A robot file that was copied and changed describes another arm under the same name; patches do not.
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

    /// The folder that holds the versions.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    fn path(&self, kind: &str, number: u32) -> PathBuf {
        self.folder.join(format!("{kind}-{number}.toml"))
    }

    fn networks_path(&self, number: u32) -> PathBuf {
        self.folder.join(format!("networks-{number}.safetensors"))
    }

    fn index(&self) -> Result<VersionList> {
        VersionList::read(&self.folder, OTHERWISE)
    }

    fn calibration(&self, number: u32) -> Result<Calibration> {
        let path = self.path("calibration", number);
        Calibration::from_toml(&read_toml(&path)?).with_context(|| path.display().to_string())
    }

    fn registration(&self, number: u32) -> Result<Option<Registration>> {
        let path = self.path("registration", number);
        if !path.exists() {
            return Ok(None);
        }
        let read = Registration::from_toml(&read_toml(&path)?);
        read.map(Some).with_context(|| path.display().to_string())
    }

    fn kept(&self, number: u32) -> Result<Kept> {
        let networks = self.networks_path(number);
        let networks = networks.exists().then(|| model::model(Some(&networks)));
        Ok(Kept {
            calibration: Arc::new(self.calibration(number)?),
            registration: self.registration(number)?,
            networks: networks.transpose()?.map(|m| m.hash),
        })
    }

    /// All versions, newest first; a damaged one holds the reason and does not affect the others.
    ///
    /// # Errors
    /// When the list cannot be read.
    pub fn versions(&self) -> Result<Vec<Version>> {
        let index = self.index()?;
        let version = |e: &Entry| Version {
            number: e.number,
            date: e.date.clone(),
            note: e.note.clone(),
            active: e.number == index.active,
            kept: self.kept(e.number).map_err(sentence),
        };
        Ok(index.version.iter().rev().map(version).collect())
    }

    /// Files of the active version; `None` if there is none.
    ///
    /// # Errors
    /// When the list or the files cannot be read.
    pub fn active(&self) -> Result<Option<VersionFiles>> {
        let index = self.index()?;
        if !index.version.iter().any(|e| e.number == index.active) {
            return Ok(None);
        }
        self.kept(index.active)?;
        Ok(Some(self.files(index.active)))
    }

    /// The registration of the active version; `None` if there is none.
    ///
    /// # Errors
    /// When the list or the file cannot be read.
    pub fn active_registration(&self) -> Result<Option<Registration>> {
        self.registration(self.index()?.active)
    }

    /// Files of the newest version that can be read; `None` if there is none.
    pub fn last_good(&self) -> Option<VersionFiles> {
        let index = self.index().ok()?;
        let mut numbers = index.version.iter().rev().map(|e| e.number);
        let good = numbers.find(|n| self.kept(*n).is_ok())?;
        Some(self.files(good))
    }

    /// Files to start with: those of the active version; where they cannot be read, those of the newest version that
    /// can, and the reason.
    fn usable(&self) -> (Option<VersionFiles>, Option<String>) {
        let e = match self.active() {
            Ok(active) => return (active, None),
            Err(e) => e,
        };
        let good = self.last_good();
        let instead = good.as_ref().map_or_else(
            || "no saved calibration is used".to_owned(),
            |files| format!("{} is used instead", files.calibration.display()),
        );
        log::warn!(
            "the active calibration cannot be read, {instead}; save a new one, or choose one on the Calibrate screen: \
             {e:#}"
        );
        let why = format!("the active calibration cannot be read, {instead}: {e:#}");
        (good, Some(why))
    }

    /// Files of a version.
    pub fn files(&self, number: u32) -> VersionFiles {
        let if_there = |path: PathBuf| path.exists().then_some(path);
        VersionFiles {
            calibration: self.path("calibration", number),
            registration: if_there(self.path("registration", number)),
            networks: if_there(self.networks_path(number)),
        }
    }

    /// The instruments that were `named`; without a calibration among them, with that of the active version and what was
    /// saved with it. And why the active version is not used; `None` if it is, or there is none.
    pub fn complete(&self, named: Instruments, is_virtual: bool) -> (Instruments, Option<String>) {
        let mut out = named;
        if out.calibration.is_some() {
            return (out, None);
        }
        let (saved, trouble) = self.usable();
        if let Some(saved) = saved {
            log::info!("calibration: {}", saved.calibration.display());
            out.calibration = Some(saved.calibration);
            out.networks = out.networks.or(saved.networks);
            // The virtual rig's motion capture is in its base already.
            if !is_virtual && out.registration.is_none() {
                out.registration = saved.registration;
            }
        }
        (out, trouble)
    }

    /// Saves a version of `date` and makes it the active one; its number.
    ///
    /// # Errors
    /// When the list cannot be read, or a file cannot be written.
    pub fn save(&self, new: NewVersion, date: &str) -> Result<u32> {
        let _lock = lock_folder(&self.folder)?;
        let mut index = self.index()?;
        let number = index.next();
        let mut calibration = Calibration {
            date: date.to_owned(),
            ..new.calibration
        };
        // Zeros that were taken for this version.
        for imu in calibration.imus.iter_mut().filter(|m| m.date.is_empty()) {
            date.clone_into(&mut imu.date);
        }
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
            None => remove_left(&registration)?,
        }
        let networks = self.networks_path(number);
        match new.networks {
            Some(bytes) => write_bytes(&networks, &bytes)?,
            None => remove_left(&networks)?,
        }
        index.add(date, new.note);
        index.write(&self.folder)?;
        Ok(number)
    }

    /// Makes another version the active one.
    ///
    /// # Errors
    /// When there is no such version, or it cannot be read, or the list cannot be written.
    pub fn activate(&self, number: u32) -> Result<()> {
        let _lock = lock_folder(&self.folder)?;
        let mut index = self.index()?;
        anyhow::ensure!(
            index.version.iter().any(|e| e.number == number),
            "there is no version {number} in {}",
            self.folder.display()
        );
        // A version that does not load must not become the one that the program starts with.
        self.kept(number)?;
        index.active = number;
        index.write(&self.folder)
    }
}

/// Removes what was left by a version whose saving was interrupted before the list was written.
fn remove_left(path: &Path) -> Result<()> {
    match path.exists() {
        true => std::fs::remove_file(path).with_context(|| path.display().to_string()),
        false => Ok(()),
    }
}

/// An error with its causes as one sentence with a full stop.
pub fn sentence(e: anyhow::Error) -> String {
    format!("{e:#}.")
}

#[cfg(test)]
mod tests {
    use super::super::list::INDEX;
    use super::*;

    fn version(name: &str) -> NewVersion {
        NewVersion {
            note: format!("{name} passed"),
            calibration: Calibration {
                name: name.into(),
                ..Calibration::virtual_rig()
            },
            registration: None,
            networks: None,
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
        let listed = |store: &Store| -> Vec<_> {
            let list = store.versions().expect("lists");
            list.iter().map(|v| (v.number, v.kept.is_ok())).collect()
        };
        assert_eq!(listed(&store), [(3, true), (2, false), (1, true)]);
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
        let newer = "format = 2\nlatest = \"one\"\n";
        std::fs::write(&path, newer).expect("writes");
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
        assert!(store.activate(1).is_err());
        // Nor is a damaged one replaced, and it is named on one line.
        for kept in [newer, "format = 1\nactive = \n"] {
            std::fs::write(&path, kept).expect("writes");
            let e = store.save(version("two"), "2026-03-02").expect_err("kept");
            assert!(!format!("{e:#}").contains('\n'), "{e:#}");
            assert_eq!(std::fs::read_to_string(&path).expect("reads"), kept);
        }
        let (files, why) = store.usable();
        let why = why.expect("a reason");
        assert!(
            files.is_none() && why.contains("versions.toml is damaged: line 2"),
            "{why}"
        );
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
        let text = crate::robot::REFERENCE;
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
        let found: Vec<_> = list
            .iter()
            .map(|v| (v.number, &*kept(v).calibration.name, &*v.date, v.active))
            .collect();
        assert_eq!(
            found,
            [
                (2, "two", "2026-03-02", true),
                (1, "one", "2026-03-01", false)
            ]
        );
        assert_eq!(kept(&list[0]).calibration.date, "2026-03-02");
        store.activate(1).expect("rolls back");
        let files = store.active().expect("reads").expect("is there");
        assert!(files.calibration.ends_with("calibration-1.toml") && files.registration.is_none());
        assert!(store.activate(9).is_err());
        std::fs::remove_dir_all(store.folder).expect("cleans up");
    }

    #[test]
    fn networks_go_with_the_version_that_they_were_learned_with() {
        let store = store("networks");
        store.save(version("bench"), "2026-03-01").expect("saves");
        let networks = include_bytes!("../../assets/networks/reference.safetensors");
        let learned = NewVersion {
            networks: Some(networks.to_vec()),
            ..version("learned")
        };
        store.save(learned, "2026-03-02").expect("saves");
        let list = store.versions().expect("lists");
        let hash = kept(&list[0]).networks.clone();
        assert_eq!(hash, Some(model::model(None).expect("shipped").hash));
        assert_eq!(kept(&list[1]).networks, None);
        let networks_of = |named: Instruments| store.complete(named, true).0.networks;
        let file = store.files(2).networks.expect("is there");
        assert_eq!(networks_of(Instruments::default()), Some(file.clone()));
        // What was named goes before it, and a calibration that was named has none.
        let other = Some(PathBuf::from("other.safetensors"));
        let named = Instruments {
            networks: other.clone(),
            ..Instruments::default()
        };
        assert_eq!(networks_of(named), other);
        let named = Instruments {
            calibration: Some("bench.toml".into()),
            ..Instruments::default()
        };
        assert_eq!(networks_of(named), None);
        store.activate(1).expect("goes back");
        assert_eq!(networks_of(Instruments::default()), None);
        // Damaged ones are not used.
        std::fs::write(&file, "no networks").expect("writes");
        let e = format!("{:#}", store.activate(2).expect_err("damaged"));
        assert!(e.contains("networks-2.safetensors"), "{e}");
        std::fs::remove_dir_all(store.folder).expect("cleans up");
    }
}
