//! The two sessions that are chosen, and what may be done with them.

use std::path::{Path, PathBuf};

use crate::gap::SECONDS_MIN;
use crate::gap::report::Origin;
use crate::gui::panels::files::PathField;
use crate::gui::panels::gap::Trouble;
use crate::gui::panels::widgets::{Gate, number};
use crate::gui::services::gap::{Arm, ExamplePair, Part, RobotMatch, SessionSheet};
use crate::gui::services::{Pending, RecordingEntry, Services};

/// One chosen session.
#[derive(Default)]
pub(in crate::gui::panels::gap) struct Slot {
    pub(super) path: PathField,
    pub(super) looking: Pending<SessionSheet>,
    pub(super) sheet: Option<Result<SessionSheet, String>>,
    /// Whether the data are simulated, by the operator's choice where the session does not state it.
    pub(super) told: Option<bool>,
}

impl Slot {
    pub(super) fn choose(&mut self, path: &Path, services: &mut Services) {
        self.path.text = path.display().to_string();
        self.sheet = None;
        self.told = None;
        self.looking.begin((services.gap.look)(path));
    }

    pub(in crate::gui::panels::gap) fn known(&self) -> Option<&SessionSheet> {
        self.sheet.as_ref()?.as_ref().ok()
    }

    /// Whether the data are simulated, by the session or by the operator's choice; `None` when unknown.
    pub(super) fn simulated(&self) -> Option<bool> {
        self.known()?.simulated.or(self.told)
    }
}

/// What is chosen.
#[derive(Default)]
pub struct Selection {
    pub(in crate::gui::panels::gap) slots: [Slot; 2],
    pub(super) library: Vec<RecordingEntry>,
    pub(super) scanned: bool,
    pub(super) scanning: Pending<Vec<RecordingEntry>>,
    /// Where the baseline of this robot is kept.
    pub(super) kept: Pending<Option<PathBuf>>,
    /// Which arm it was asked for.
    pub(super) asked_for: Option<Arm>,
    /// The baseline that was chosen without the operator.
    by_itself: Option<PathBuf>,
    pub(super) keeping: Pending<PathBuf>,
    pub(in crate::gui::panels::gap) making: Pending<ExamplePair>,
    pub(super) example: Option<ExamplePair>,
    pub(super) examples_made: u64,
}

impl Selection {
    /// Has an example made, another one than before.
    pub fn make_example(&mut self, services: &mut Services) {
        self.examples_made += 1;
        let job = (services.gap.example)(self.examples_made);
        self.making.begin(job);
    }

    /// Chooses a session.
    pub(in crate::gui::panels::gap) fn choose(
        &mut self,
        part: Part,
        path: &Path,
        services: &mut Services,
    ) {
        self.slots[part as usize].choose(path, services);
    }

    /// Chooses a session again that has another name now.
    pub(in crate::gui::panels::gap) fn renamed(
        &mut self,
        before: &Path,
        after: &Path,
        services: &mut Services,
    ) {
        self.rescan();
        for slot in &mut self.slots {
            if Path::new(&slot.path.text) == before {
                let told = slot.told;
                slot.choose(after, services);
                slot.told = told;
            }
        }
    }

    /// Asks for the baseline of the arm that the window is on; one that was chosen without the operator for another arm is not kept.
    pub(super) fn ask_for_baseline(&mut self, arm: Arm, services: &mut Services) {
        if self.asked_for != Some(arm)
            && let Some(path) = self.by_itself.take()
            && self.slots[0].path.text == path.display().to_string()
        {
            self.slots[0] = Slot::default();
        }
        self.asked_for = Some(arm);
        self.kept.begin((services.gap.baseline)(arm));
    }

    /// Looks for sessions again, when the step is shown next.
    pub fn rescan(&mut self) {
        self.scanned = false;
    }

    pub fn busy(&self) -> bool {
        self.scanning.is_busy()
            || self.making.is_busy()
            || self.kept.is_busy()
            || self.keeping.is_busy()
            || self
                .slots
                .iter()
                .any(|s| s.looking.is_busy() || s.path.is_busy())
    }

    /// Origin of the suspect session, by the session or by the operator's choice.
    pub(in crate::gui::panels::gap) fn origin(&self) -> Option<Origin> {
        Some(match self.slots[1].simulated()? {
            true => Origin::Simulated,
            false => Origin::Measured,
        })
    }

    /// Where the answer lies, when the example is what is looked at.
    pub(in crate::gui::panels::gap) fn answer(&self) -> Option<PathBuf> {
        let example = self.example.as_ref()?;
        let suspect = &self.slots[1].known()?.path;
        (*suspect == example.suspect).then(|| example.answer.clone())
    }

    /// Takes what has come.
    pub fn poll(&mut self, services: &mut Services) -> Option<Trouble> {
        let mut trouble = None;
        let Self { slots, example, .. } = self;
        for slot in slots {
            if let Some(sheet) = slot.looking.take() {
                slot.sheet = Some(sheet.map(|sheet| {
                    let made = example.as_ref();
                    let made =
                        made.is_some_and(|e| e.healthy == sheet.path || e.suspect == sheet.path);
                    SessionSheet {
                        simulated: if made { Some(true) } else { sheet.simulated },
                        ..sheet
                    }
                }));
            }
        }
        // The rig in order is known: nobody has to look for files.
        if let Some(Ok(Some(path))) = self.kept.take()
            && self.slots[0].path.text.is_empty()
        {
            self.slots[0].choose(&path, services);
            self.by_itself = Some(path);
        }
        match self.keeping.take() {
            Some(Ok(path)) => self.slots[0].choose(&path, services),
            Some(Err(e)) => {
                trouble = Some(Trouble::new(
                    e,
                    "No baseline is kept; one that was kept before stays.",
                    "Choose a session of the rig in order, or run springtwin gap commission.",
                ));
            }
            None => {}
        }
        if let Some(found) = self.scanning.take() {
            match found {
                Ok(entries) => self.library = entries,
                Err(e) => {
                    trouble = Some(Trouble::new(
                        e,
                        "The library is not shown.",
                        "Type the path of a session, or browse for it.",
                    ));
                }
            }
        }
        if let Some(made) = self.making.take() {
            match made {
                Ok(pair) => {
                    self.slots[0].choose(&pair.healthy, services);
                    self.slots[1].choose(&pair.suspect, services);
                    self.example = Some(pair);
                }
                Err(e) => {
                    trouble = Some(Trouble::new(
                        e,
                        "There is no example.",
                        "Make two sessions with springtwin rig session, or choose recordings.",
                    ));
                }
            }
        }
        trouble
    }

    /// Whether the finder can be run.
    pub(in crate::gui::panels::gap) fn gate(&self) -> Gate {
        if self.making.is_busy() {
            return Err("The example is being made.".into());
        }
        if self.keeping.is_busy() {
            return Err("The baseline is being fitted.".into());
        }
        if self.slots.iter().any(|s| s.looking.is_busy()) {
            return Err("A session is being read.".into());
        }
        for (part, slot) in Part::ALL.into_iter().zip(&self.slots) {
            match &slot.sheet {
                None if part == Part::Healthy && slot.path.text.trim().is_empty() => {}
                None => {
                    return Err(match slot.path.text.trim().is_empty() {
                        true => format!("Choose a {} session first.", part.name()),
                        false => format!("Press Enter to read the {} session.", part.name()),
                    });
                }
                Some(Err(_)) => {
                    return Err(format!("The {} session could not be read.", part.name()));
                }
                Some(Ok(sheet)) => {
                    if let Some(trouble) = trouble_with(part, sheet) {
                        return Err(format!(
                            "The {} session: {} {}",
                            part.name(),
                            trouble.cause,
                            trouble.remedy
                        ));
                    }
                }
            }
        }
        let both = (self.slots[0].known(), self.slots[1].known());
        if let (Some(a), Some(b)) = both
            && a.path == b.path
        {
            return Err("The healthy and the suspect session are the same file.".into());
        }
        if self.origin().is_none() {
            return Err("Say whether the suspect session is simulated or measured.".into());
        }
        Ok(())
    }
}

// What keeps a session from being used.
pub(super) fn trouble_with(part: Part, sheet: &SessionSheet) -> Option<Trouble> {
    if let RobotMatch::Other { recorded, given } = &sheet.robot {
        return Some(Trouble::new(
            format!("Recorded with robot file {recorded}; this twin runs with {given}."),
            "The session cannot be compared with this model.",
            "Choose a session of this robot, or start with --robot FILE.",
        ));
    }
    if sheet.kept.is_some() {
        return (part == Part::Suspect).then(|| {
            Trouble::new(
                "This is a baseline, the fit to a rig in order.".to_owned(),
                "There are no samples in it to look at.",
                "Choose a session that was recorded now.",
            )
        });
    }
    if sheet.seconds < SECONDS_MIN {
        return Some(Trouble::new(
            format!("{} s long.", number(sheet.seconds, 0)),
            "That is too short to separate an effect from noise.",
            &format!(
                "Record at least {} s; 90 s are good.",
                number(SECONDS_MIN, 0)
            ),
        ));
    }
    None
}
