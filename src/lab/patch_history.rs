//! Versions of a robot file with patches, kept beside it: what the program wrote, and what was there before.
//!
//! Beside `NAME.toml` lies the folder `NAME.toml.history`: `robot-<n>.toml` (a version, byte for byte) and `versions.toml`, the same
//! list as that of saved calibrations, with the version that the file is. Before the file is written, what it holds is among its
//! versions: also what was edited by hand.

use std::path::{Path, PathBuf};

use anyhow::Result;

use crate::calibrate::{Entry, VersionList, lock_folder};
use crate::drive::read_toml;
use crate::gap::{Edits, PatchRecord, changes};
use crate::recording::{RecordingError, write_text};
use crate::robot::{RobotSpec, without_last_patch};

/// Note of the first version.
const FOUND: &str = "as it was found";
/// Note of a version that was edited by hand.
const EDITED: &str = "edited by hand";
/// Note of a version that is older than the history.
const REVERTED: &str = "without its last patch";
/// What one can do without the list.
const OTHERWISE: &str = "move that folder away";

/// Writes a text file.
pub type Put = fn(&Path, &str) -> Result<(), RecordingError>;

/// The versions of a robot file.
pub struct PatchHistory {
    file: PathBuf,
    folder: PathBuf,
    put: Put,
}

impl PatchHistory {
    /// Of a robot file, which need not be there yet.
    pub fn of(file: &Path) -> Self {
        Self::with_writer(file, write_text)
    }

    /// The same with another way to write files.
    pub fn with_writer(file: &Path, put: Put) -> Self {
        let mut name = file.file_name().unwrap_or_default().to_owned();
        name.push(".history");
        Self {
            file: file.to_owned(),
            folder: file.with_file_name(name),
            put,
        }
    }

    /// The folder that holds the versions.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    fn version(&self, number: u32) -> PathBuf {
        self.folder.join(format!("robot-{number}.toml"))
    }

    fn list(&self) -> Result<VersionList> {
        VersionList::read(&self.folder, OTHERWISE)
    }

    /// Number of the version of this text; `None` where no version has it.
    fn number_of(&self, list: &VersionList, text: &str) -> Option<u32> {
        let numbers = list.version.iter().map(|e| e.number);
        { numbers }.find(|n| self.text_of(*n).as_deref() == Some(text))
    }

    fn text_of(&self, number: u32) -> Option<String> {
        read_toml(&self.version(number)).ok()
    }

    /// The text that the program wrote last; `None` before it wrote any.
    ///
    /// # Errors
    /// When the list cannot be read.
    pub fn written(&self) -> Result<Option<String>> {
        Ok(self.text_of(self.list()?.active))
    }

    /// That the file, which is `now`, was edited by hand since the program wrote it: one sentence without a full stop; `None` if it was
    /// not.
    ///
    /// # Errors
    /// When the list cannot be read.
    pub fn edited(&self, now: &str) -> Result<Option<String>> {
        let list = self.list()?;
        let active = list.version.iter().find(|e| e.number == list.active);
        let Some((active, text)) = active.and_then(|e| Some((e, self.text_of(e.number)?))) else {
            return Ok(None);
        };
        Ok((text != now).then(|| {
            format!(
                "{} was edited by hand since it was written ({})",
                self.file.display(),
                active.date
            )
        }))
    }

    /// Writes `new` in the place of `now`, which is then among the versions, and so is `new`. `note` is what it is; `date` is now.
    ///
    /// # Errors
    /// When the list cannot be read, or a file cannot be written; the robot file is then as it was.
    pub fn replace(&self, now: &str, new: &str, note: String, date: &str) -> Result<()> {
        let _lock = lock_folder(&self.folder)?;
        let mut list = self.list()?;
        let keep = |list: &mut VersionList, text: &str, note: String| -> Result<()> {
            match self.number_of(list, text) {
                Some(number) => list.active = number,
                None => {
                    (self.put)(&self.version(list.next()), text)?;
                    list.add(date, note);
                }
            }
            Ok(())
        };
        let before = if list.version.is_empty() {
            FOUND
        } else {
            EDITED
        };
        keep(&mut list, now, before.to_owned())?;
        keep(&mut list, new, note)?;
        let was_there = self.file.exists();
        (self.put)(&self.file, new)?;
        let Err(e) = list.write(&self.folder) else {
            return Ok(());
        };
        // What no list knows of is not in the file either.
        match was_there {
            true => (self.put)(&self.file, now)?,
            false => std::fs::remove_file(&self.file)?,
        }
        Err(e)
    }

    /// Reverts the last patch of the file, which is `now`; the text that it then has, byte for byte as before that patch.
    ///
    /// # Errors
    /// When it has no patch, was edited by hand and `edits` refuses that, or a file cannot be written.
    pub fn revert(&self, now: &str, edits: Edits, date: &str) -> Result<String> {
        if let (Edits::Refuse, Some(edited)) = (edits, self.edited(now)?) {
            anyhow::bail!("{edited}: reverting its last patch would take these edits off, too");
        }
        let written = self.written()?.unwrap_or_else(|| now.to_owned());
        let old = without_last_patch(&written)?.to_owned();
        self.replace(now, &old, REVERTED.to_owned(), date)?;
        Ok(old)
    }

    /// The patches of the file, which is `now`, in the order in which they were put on, then those that were reverted.
    ///
    /// # Errors
    /// When the list cannot be read.
    pub fn records(&self, now: &str) -> Result<Vec<PatchRecord>> {
        let list = self.list()?;
        let versions: Vec<(&Entry, String)> = { list.version.iter() }
            .filter(|e| e.note != EDITED)
            .filter_map(|e| Some((e, self.text_of(e.number)?)))
            .collect();
        let date = |text: &str| {
            let written = versions.iter().find(|(e, t)| t == text && e.note != FOUND);
            written.map(|(e, _)| e.date.clone())
        };
        let mut applied = Vec::new();
        let mut text = now;
        while let Some((record, before)) = record(text, date(text), true) {
            applied.push(record);
            text = before;
        }
        applied.reverse();
        let reverted = versions
            .iter()
            .filter(|(_, text)| !now.starts_with(&**text));
        let reverted = reverted.filter_map(|(e, text)| {
            let date = (e.note != FOUND).then(|| e.date.clone());
            Some(record(text, date, false)?.0)
        });
        applied.extend(reverted);
        Ok(applied)
    }
}

/// The last patch of a robot file's text, and the text before it; `None` without one.
fn record(text: &str, date: Option<String>, is_applied: bool) -> Option<(PatchRecord, &str)> {
    let before = without_last_patch(text).ok()?;
    let patch = RobotSpec::from_toml(text).ok()?.patches.pop()?.patch;
    let record = PatchRecord {
        date,
        changes: changes(&RobotSpec::from_toml(before).ok()?, &patch),
        patch,
        is_applied,
    };
    Some((record, before))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::{PATCH_VERSION, Patch, PatchEffect, PatchValue, REFERENCE, with_patch};

    fn patch(robot: &str, name: &str, mass_kg: f64) -> Patch {
        let mass = PatchValue {
            value: mass_kg,
            unit: "kg".to_owned(),
            ci95: None,
        };
        Patch {
            version: PATCH_VERSION,
            name: name.to_owned(),
            robot: RobotSpec::from_toml(robot).expect("a robot").hash,
            verdict: "named".to_owned(),
            data: Default::default(),
            rig: Default::default(),
            floor: Default::default(),
            law: Vec::new(),
            effects: vec![PatchEffect {
                id: "payload".to_owned(),
                target: None,
                params: [("mass".to_owned(), mass)].into(),
            }],
        }
    }

    struct Folder(PathBuf);

    impl Folder {
        fn new(name: &str) -> Self {
            let id = std::process::id();
            let dir = std::env::temp_dir().join(format!("springtwin-history-{name}-{id}"));
            std::fs::create_dir_all(&dir).expect("a folder");
            Self(dir)
        }
    }

    impl Drop for Folder {
        fn drop(&mut self) {
            let _ = std::fs::remove_dir_all(&self.0);
        }
    }

    fn names(records: &[PatchRecord]) -> Vec<(&str, bool, Option<&str>)> {
        let one = |r: &'_ PatchRecord| {
            let name: &str = match &*r.patch.name {
                "first" => "first",
                "second" => "second",
                _ => "third",
            };
            (name, r.is_applied, r.date.is_some().then_some("dated"))
        };
        records.iter().map(one).collect()
    }

    #[test]
    fn every_version_is_kept_before_it_is_replaced_and_comes_back_byte_for_byte() {
        let dir = Folder::new("versions");
        let file = dir.0.join("arm.toml");
        std::fs::write(&file, REFERENCE).expect("writes");
        let history = PatchHistory::of(&file);
        assert_eq!(history.records(REFERENCE).expect("reads"), []);
        let one = with_patch(REFERENCE, &patch(REFERENCE, "first", 0.3));
        let two = with_patch(&one, &patch(&one, "second", 0.1));
        let now = || std::fs::read_to_string(&file).expect("is there");
        history
            .replace(&now(), &one, "first".to_owned(), "on Monday")
            .expect("writes");
        history
            .replace(&now(), &two, "second".to_owned(), "on Tuesday")
            .expect("writes");
        let records = history.records(&now()).expect("reads");
        let dated = Some("dated");
        assert_eq!(
            names(&records),
            [("first", true, dated), ("second", true, dated)]
        );
        assert_eq!(
            records[1].changes[0].text(),
            "Undeclared payload: 300 → 400 g"
        );
        assert_eq!(records[1].date.as_deref(), Some("on Tuesday"));
        // Back, and on to another one.
        assert_eq!(
            history
                .revert(&now(), Edits::Refuse, "later")
                .expect("reverts"),
            one
        );
        assert_eq!(now(), one);
        let three = with_patch(&one, &patch(&one, "third", 0.2));
        history
            .replace(&now(), &three, "third".to_owned(), "on Friday")
            .expect("writes");
        let records = history.records(&now()).expect("reads");
        assert_eq!(
            names(&records),
            [
                ("first", true, dated),
                ("third", true, dated),
                ("second", false, dated)
            ]
        );
        for text in [&one, REFERENCE] {
            history
                .revert(&now(), Edits::Refuse, "later")
                .expect("reverts");
            assert_eq!(now(), *text);
        }
        let none = history
            .revert(&now(), Edits::Refuse, "later")
            .expect_err("none is left");
        assert!(none.to_string().contains("no patch"), "{none}");
        let kept: Vec<String> = (1..=4)
            .map(|n| std::fs::read_to_string(history.version(n)).expect("is kept"))
            .collect();
        assert_eq!(kept, [REFERENCE.to_owned(), one, two, three]);
        assert!(!history.version(5).exists());
    }

    #[test]
    fn edits_by_hand_are_not_lost() {
        let dir = Folder::new("edits");
        let file = dir.0.join("arm.toml");
        let history = PatchHistory::of(&file);
        let one = with_patch(REFERENCE, &patch(REFERENCE, "first", 0.3));
        history
            .replace(REFERENCE, &one, "first".to_owned(), "on Monday")
            .expect("writes");
        assert_eq!(history.edited(&one).expect("reads"), None);
        // Above the patch, which is then void, and in it.
        for edited in [
            one.replacen("name = \"", "name = \"my ", 1),
            one.replace("value = 0.3", "value = 0.4"),
        ] {
            std::fs::write(&file, &edited).expect("writes");
            let refused = history.revert(&edited, Edits::Refuse, "later");
            let text = refused.expect_err("asks first").to_string();
            assert!(
                text.contains("was edited by hand since it was written (on Monday)"),
                "{text}"
            );
            assert_eq!(std::fs::read_to_string(&file).expect("is there"), edited);
            let old = history
                .revert(&edited, Edits::SetAside, "later")
                .expect("reverts");
            assert_eq!(old, REFERENCE);
            assert_eq!(std::fs::read_to_string(&file).expect("is there"), REFERENCE);
            let list = history.list().expect("reads");
            let kept = history.number_of(&list, &edited).expect("is kept");
            assert_eq!(
                list.version
                    .iter()
                    .find(|e| e.number == kept)
                    .map(|e| &*e.note),
                Some(EDITED)
            );
            history
                .replace(REFERENCE, &one, "first".to_owned(), "on Monday")
                .expect("again");
        }
    }

    /// A file of an earlier version of the program has patches without a date.
    #[test]
    fn patches_without_a_history_are_listed_and_reverted() {
        let dir = Folder::new("older");
        let file = dir.0.join("arm.toml");
        let one = with_patch(REFERENCE, &patch(REFERENCE, "first", 0.3));
        std::fs::write(&file, &one).expect("writes");
        let history = PatchHistory::of(&file);
        let records = history.records(&one).expect("reads");
        assert_eq!(names(&records), [("first", true, None)]);
        assert_eq!(
            history
                .revert(&one, Edits::Refuse, "today")
                .expect("reverts"),
            REFERENCE
        );
        assert_eq!(std::fs::read_to_string(&file).expect("is there"), REFERENCE);
        assert_eq!(history.text_of(1).as_deref(), Some(&*one));
    }

    fn fails_on_the_file(path: &Path, text: &str) -> Result<(), RecordingError> {
        if path.ends_with("arm.toml") {
            return Err(RecordingError::Io {
                path: path.to_owned(),
                doing: "write",
                source: std::io::ErrorKind::StorageFull.into(),
            });
        }
        write_text(path, text)
    }

    #[test]
    fn a_file_that_cannot_be_written_is_as_it_was_and_so_is_its_history() {
        let dir = Folder::new("full");
        let file = dir.0.join("arm.toml");
        std::fs::write(&file, REFERENCE).expect("writes");
        let history = PatchHistory::with_writer(&file, fails_on_the_file);
        let one = with_patch(REFERENCE, &patch(REFERENCE, "first", 0.3));
        let note = "first".to_owned();
        assert!(history.replace(REFERENCE, &one, note, "on Monday").is_err());
        assert_eq!(std::fs::read_to_string(&file).expect("is there"), REFERENCE);
        assert_eq!(history.list().expect("reads"), VersionList::default());
    }
}
