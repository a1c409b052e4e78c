//! The Gap screen: select, locate, explain, patch, prove.

mod chart;
mod experiment;
mod explain;
mod heat;
mod locate;
mod patch;
mod prove;
mod select;
mod tried;
mod views;

use std::path::{Path, PathBuf};
use std::sync::Arc;

use egui::{Button, RichText, Role, Stroke, Ui, WidgetInfo};

use super::files::Saving;
pub use super::trouble::Trouble;
use super::widgets::{Gate, badge, empty, ends, gated, note, status};
use crate::gap::report::Origin;
use crate::gap::score::Key;
use crate::gap::{Found, GapError};
use crate::gui::services::gap::{Pair, Part, PatchedRobot};
use crate::gui::services::{Pending, Services};
use crate::gui::theme::{Level, Palette};
use crate::gui::view::View;
use crate::signal::capitalised;
use crate::twin::Command;
pub use tried::{drop_gate, keep_gate, phrase as patch_phrase, revert_gate};

/// A step of the search.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Step {
    /// Choose the sessions and run the finder.
    #[default]
    Select,
    /// Where simulation and measurement disagree.
    Locate,
    /// Which effect is missing.
    Explain,
    /// What is added to the model.
    Patch,
    /// What is gained on held-out data.
    Prove,
}

impl Step {
    /// All of them in order.
    pub const ALL: [Self; 5] = [
        Self::Select,
        Self::Locate,
        Self::Explain,
        Self::Patch,
        Self::Prove,
    ];

    /// Name on screen.
    pub fn name(self) -> &'static str {
        match self {
            Self::Select => "Select",
            Self::Locate => "Locate",
            Self::Explain => "Explain",
            Self::Patch => "Patch",
            Self::Prove => "Prove",
        }
    }

    /// The step before it, if there is one.
    pub fn back(self) -> Option<Self> {
        Self::ALL.get(self.index().checked_sub(1)?).copied()
    }

    /// The step after it, if there is one.
    pub fn next(self) -> Option<Self> {
        Self::ALL.get(self.index() + 1).copied()
    }

    fn purpose(self) -> &'static str {
        match self {
            Self::Select => "Choose a healthy and a suspect session of the same rig.",
            Self::Locate => "See where and when simulation and measurement disagree.",
            Self::Explain => "Which effect is missing, and how sure that is.",
            Self::Patch => "Add the effect to the model, or not.",
            Self::Prove => "What is gained on data that were not fitted.",
        }
    }

    fn index(self) -> usize {
        self as usize
    }
}

/// What the operator made of a finding.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Decision {
    /// Not decided yet.
    #[default]
    Open,
    /// The patch is on the robot file.
    Accepted,
    /// The patch is not wanted.
    Rejected,
}

/// A finding and what is being done with it.
pub struct Outcome {
    /// What was found.
    pub found: Arc<Found>,
    /// What the search before it found, of the table if this is one for a law, and the other way round.
    pub other: Option<Arc<Found>>,
    /// Where it was looked for; `None` when it came without its sessions.
    pub pair: Option<Pair>,
    /// Where the suspect session comes from.
    pub origin: Origin,
    /// What the operator decided.
    pub decision: Decision,
    /// Which alternative the patch takes, of those that cannot be distinguished.
    pub alternative: usize,
    /// Where the answer of an example lies.
    pub answer: Option<PathBuf>,
    /// What was hidden, once the operator asked.
    pub revealed: Option<Key>,
    revealing: Pending<Key>,
    // What is shown then, and of which alternative.
    keeping: Pending<PathBuf, (Show, usize)>,
    // Folder that holds the report of this finding, with the alternative it was written for.
    kept: Option<(usize, PathBuf)>,
}

impl Outcome {
    fn new(found: Arc<Found>, origin: Origin, answer: Option<PathBuf>) -> Self {
        Self {
            found,
            other: None,
            pair: None,
            origin,
            decision: Decision::Open,
            alternative: 0,
            answer,
            revealed: None,
            revealing: Pending::default(),
            keeping: Pending::default(),
            kept: None,
        }
    }

    fn patch(&self) -> crate::gap::Patch {
        patch::chosen(&self.found, self.alternative)
    }

    /// Whether there is an effect to add.
    fn adds(&self) -> bool {
        self.found.finding.verdict.has_effects()
            && !(self.found.patch.effects.is_empty() && self.found.patch.law.is_empty())
    }
}

/// A search under way.
struct Search {
    pair: Pair,
    /// Where the suspect session comes from.
    origin: Origin,
    /// Where the answer of an example lies.
    answer: Option<PathBuf>,
    /// What was found in the table, for a search for a law.
    known: Option<Arc<Found>>,
}

/// What is shown once a report is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Show {
    Page,
    Overlay,
}

impl Show {
    /// Its file in the report's folder.
    fn file(self) -> &'static str {
        match self {
            Self::Page => "report.html",
            Self::Overlay => "overlay.rrd",
        }
    }
}

/// What the screen keeps.
#[derive(Default)]
pub struct GapState {
    /// The step that is shown.
    pub step: Step,
    /// What was found last.
    pub outcome: Option<Outcome>,
    /// What went wrong last.
    pub trouble: Option<Trouble>,
    /// The robot file that carries the accepted patches.
    pub patched: Option<PatchedRobot>,
    select: select::Selection,
    running: Pending<Result<Arc<Found>, GapError>, Search>,
    unread: Option<String>,
    patching: Pending<PatchedRobot, Option<Decision>>,
    saving: Saving,
    // A report that is being shown, and where it is.
    opening: Pending<(), (Show, PathBuf)>,
    said: Option<String>,
    locate: locate::LocateState,
    asked_for_patches: bool,
    // The robot file is read again if it cannot be changed.
    rereads: bool,
    conduct: Option<super::conduct::Conduct>,
    // The last minutes are becoming a recording, which comes from there.
    keeping_last: Pending<PathBuf, Origin>,
    // Why an effect is to be muted, as it is typed.
    mute_reason: String,
    tried: tried::TriedState,
    // For the twin, with the next frame.
    orders: Vec<Command>,
}

impl GapState {
    /// Whether something is awaited.
    pub fn busy(&self) -> bool {
        let outcome = self
            .outcome
            .as_ref()
            .is_some_and(|o| o.revealing.is_busy() || o.keeping.is_busy());
        outcome
            || self.running.is_busy()
            || self.keeping_last.is_busy()
            || self.patching.is_busy()
            || self.saving.is_busy()
            || self.opening.is_busy()
            || self.select.busy()
    }

    /// Discards what lies on the graphics device; it is made again.
    pub fn forget_pictures(&mut self) {
        self.locate.forget_picture();
    }

    /// Looks for sessions again, when the screen is shown next.
    pub fn rescan(&mut self) {
        self.select.rescan();
    }

    /// Chooses a session in the first step, which is then shown.
    pub fn use_as(&mut self, part: Part, path: &Path, services: &mut Services) {
        self.step = Step::Select;
        self.select.rescan();
        self.select.choose(part, path, services);
    }

    /// A session has another name now: where it is chosen, it stays so.
    pub fn renamed(&mut self, before: &Path, after: &Path, services: &mut Services) {
        self.select.renamed(before, after, services);
    }

    /// Takes a finding, as if the finder had just made it.
    pub fn take(&mut self, found: Arc<Found>, origin: Origin, answer: Option<PathBuf>) {
        self.locate = locate::LocateState::of(&found.finding);
        self.outcome = Some(Outcome::new(found, origin, answer));
        self.trouble = None;
        self.said = None;
        self.step = Step::Locate;
    }

    // Takes the finding of a search.
    fn take_of(&mut self, search: Search, found: Arc<Found>) {
        self.take(found, search.origin, search.answer);
        if search.known.is_some() {
            self.step = Step::Explain;
        }
        if let Some(outcome) = &mut self.outcome {
            (outcome.other, outcome.pair) = (search.known, Some(search.pair));
        }
    }

    fn poll(&mut self, services: &mut Services) {
        if !self.asked_for_patches {
            self.asked_for_patches = true;
            self.patching.begin_for(None, (services.gap.patched)());
        }
        if let Some(trouble) = self.select.poll(services) {
            self.trouble = Some(trouble);
        }
        if let Some((search, answer)) = self.running.take_for() {
            let driven = self.conduct.take().is_some();
            match answer {
                Ok(Ok(found)) => self.take_of(search, found),
                Ok(Err(e)) => self.trouble = Some(trouble_of(&e)),
                Err(e) if driven => {
                    self.trouble = Some(Trouble::new(
                        e,
                        "The experiment ended without a verdict; what was recorded is kept.",
                        "Remove the cause named above, then run it again.",
                    ));
                }
                Err(e) => {
                    self.trouble = Some(Trouble::new(
                        e,
                        "There is no verdict.",
                        "Choose a session folder, a session.toml, a .csv table or a recording (.rrd).",
                    ));
                }
            }
        }
        self.poll_check(services);
        if let Some((decision, answer)) = self.patching.take_for() {
            match answer {
                Ok(robot) => {
                    self.unread = None;
                    self.patched = Some(robot);
                    if let (Some(outcome), Some(decision)) = (&mut self.outcome, decision) {
                        outcome.decision = decision;
                    }
                }
                // The step itself shows it, and reads again.
                Err(e) if decision.is_none() && self.patched.is_none() => self.unread = Some(e),
                Err(e) => {
                    self.trouble = Some(Trouble::new(
                        e,
                        "The robot file is as it was.",
                        "Remove the cause named above, then try again.",
                    ));
                    // It may be another one than was read.
                    if std::mem::take(&mut self.rereads) {
                        self.patching.begin_for(None, (services.gap.patched)());
                    }
                }
            }
        }
        prove::poll(self, services);
        explain::poll(self);
    }

    /// Whether an example can be made now, or why not.
    pub fn example_gate(&self) -> Gate {
        if self.running.is_busy() {
            return Err("The finder is running: wait, or cancel it.".into());
        }
        match self.select.making.is_busy() {
            true => Err("An example is being made.".into()),
            false => Ok(()),
        }
    }

    /// Has two sessions made, in the second of which something is hidden.
    pub fn make_example(&mut self, services: &mut Services) {
        if self.example_gate().is_ok() {
            self.step = Step::Select;
            self.select.make_example(services);
        }
    }

    /// Whether the finder can begin, or why not.
    pub fn find_gate(&self) -> Gate {
        match self.running.is_busy() {
            true => Err("The finder is running: wait, or cancel it.".into()),
            false => self.select.gate(),
        }
    }

    /// Sets the finder to work on the sessions that are chosen.
    pub fn find(&mut self, services: &mut Services) {
        let path = |i: usize| self.select.slots[i].known().map(|s| s.path.clone());
        if let (Ok(()), healthy, Some(suspect), Some(origin)) =
            (self.find_gate(), path(0), path(1), self.select.origin())
        {
            // What is chosen may change while the finder is at work.
            let search = Search {
                pair: Pair { healthy, suspect },
                origin,
                answer: self.select.answer(),
                known: None,
            };
            self.begin(search, services);
        }
    }

    /// Sets the finder to work for a law, on the sessions of the finding that is shown.
    pub fn find_law(&mut self, services: &mut Services) {
        let Some(outcome) = &self.outcome else { return };
        if let (false, Some(pair)) = (self.running.is_busy(), &outcome.pair) {
            let search = Search {
                pair: pair.clone(),
                origin: outcome.origin,
                answer: outcome.answer.clone(),
                known: Some(Arc::clone(&outcome.found)),
            };
            self.begin(search, services);
        }
    }

    // Shows the finding of the other search.
    fn show_other(&mut self) {
        let Some(outcome) = self.outcome.take() else {
            return;
        };
        if let Some(other) = outcome.other {
            self.take(other, outcome.origin, outcome.answer);
            self.step = Step::Explain;
            if let Some(now) = &mut self.outcome {
                (now.other, now.pair) = (Some(outcome.found), outcome.pair);
                now.revealed = outcome.revealed;
            }
        }
    }

    fn begin(&mut self, search: Search, services: &mut Services) {
        self.step = Step::Select;
        self.trouble = None;
        let job = (services.gap.find)(&search.pair, search.known.clone());
        self.running.begin_for(search, job);
    }

    /// The finding, or why there is none.
    fn finding(&self) -> Result<&Outcome, String> {
        let none = || "No finding yet: choose sessions and press Find.".to_owned();
        self.outcome.as_ref().ok_or_else(none)
    }

    /// Whether a step can be shown, or why not.
    pub fn gate(&self, step: Step) -> Gate {
        if step == Step::Select {
            return Ok(());
        }
        if self.running.is_busy() {
            return Err("The finder is running: wait, or cancel it.".into());
        }
        // Patches of earlier days can be looked at and undone without a finding.
        let has_patches = |p: &PatchedRobot| !p.history.is_empty() || p.edited.is_some();
        if step == Step::Patch && self.patched.as_ref().is_some_and(has_patches) {
            return Ok(());
        }
        self.finding().map(|_| ())
    }

    // Whether a step is behind the operator.
    fn done(&self, step: Step) -> bool {
        match (&self.outcome, step) {
            (None, _) => false,
            (Some(o), Step::Patch) => o.decision != Decision::Open,
            (Some(_), Step::Select) => true,
            (Some(_), step) => self.step.index() > step.index(),
        }
    }
}

fn trouble_of(e: &GapError) -> Trouble {
    let remedy = match e {
        GapError::TooShort { .. } => "Record a longer session: 90 s are a good length.",
        GapError::Still { .. } => "Drive the arm through its range and record again.",
        GapError::NoPressure { .. } | GapError::NoCommand { .. } => {
            "Record the measured pressures of all chambers."
        }
        GapError::NothingMeasured { .. } => {
            "Choose a session with springs, IMUs or whole poses of the motion capture."
        }
        GapError::SlowerThanBaseline { .. } => {
            "Choose the healthy session itself, or record at the rate of the baseline."
        }
        GapError::NoSession => "Choose a session in which something may be missing.",
        GapError::NothingCommon => "Choose two sessions in which the same sensors were measured.",
        GapError::OtherRobot { .. } => {
            "Choose a session of this robot, or start with the robot file it was recorded with (--robot)."
        }
        GapError::Degenerate | GapError::Sim(_) => {
            "Look into the session with springtwin inspect, and leave out what is damaged."
        }
        GapError::Stopped => "Press Find to begin again.",
    };
    Trouble::new(
        capitalised(&e.to_string()),
        "There is no verdict, and nothing was changed.",
        remedy,
    )
}

/// The screen.
pub fn ui(
    ui: &mut Ui,
    state: &mut GapState,
    live: &View<'_>,
    services: &mut Services,
    commands: &mut Vec<Command>,
) {
    state.poll(services);
    stepper(ui, state);
    Trouble::show_until_closed(&mut state.trouble, ui);
    match state.step {
        Step::Select => select::ui(ui, state, live, services, commands),
        step if state.outcome.is_none() && step != Step::Patch => {
            empty(ui, "No finding yet", "Go back to Select and press Find.")
        }
        Step::Locate => locate::ui(ui, state),
        Step::Explain => explain::ui(ui, state, services),
        Step::Patch => patch::ui(ui, state, live, services, commands),
        Step::Prove => prove::ui(ui, state, services),
    }
}

fn stepper(ui: &mut Ui, state: &mut GapState) {
    let (mut pressed, mut turned) = (None, None);
    ui.scope(|ui| {
        ui.spacing_mut().item_spacing.x = 4.0;
        ends(
            ui,
            "steps",
            "",
            |ui| pressed = steps(ui, state),
            |ui| turned = back_and_next(ui, state),
        );
    });
    if let Some(step) = turned.or(pressed) {
        state.step = step;
    }
    ui.add_space(2.0);
}

/// The steps, and what the finding is of; gives the step that was pressed.
fn steps(ui: &mut Ui, state: &GapState) -> Option<Step> {
    let p = *Palette::in_ui(ui);
    let mut pressed = None;
    for step in Step::ALL {
        if step != Step::Select {
            ui.label(RichText::new("›").color(p.weak));
        }
        let glyph = if state.done(step) { "●" } else { "○" };
        let current = state.step == step;
        let text = format!("{glyph} {} {}", step.index() + 1, step.name());
        let mut button = Button::new(RichText::new(text).color(p.text));
        if current {
            button = button.fill(p.selected).stroke(Stroke::new(1.0, p.text));
        }
        let gate = state.gate(step);
        let response = gated(ui, &gate, button, step.purpose());
        response.widget_info(|| {
            WidgetInfo::selected(
                Role::Button,
                gate.is_ok(),
                current,
                format!("Step {}: {}", step.index() + 1, step.name()),
            )
        });
        if response.clicked() {
            pressed = Some(step);
        }
    }
    if let Some(outcome) = &state.outcome {
        ui.add_space(10.0);
        let data = &outcome.found.finding.data;
        let of = |key: &str| data.get(key).map_or("factory model", String::as_str);
        if outcome.origin == Origin::Simulated {
            badge(ui, "simulated", p.raised, p.text)
                .on_hover_text("All figures of this finding come from a virtual rig");
        }
        note(ui, format!("{} → {}", of("baseline"), of("session")))
            .on_hover_text("The healthy and the suspect session of this finding");
    }
    pressed
}

/// One step back or on, and whether the finder is at work; gives the step that is to be shown.
fn back_and_next(ui: &mut Ui, state: &GapState) -> Option<Step> {
    if state.running.is_busy() {
        // No spinner: a minute of painting would take the finder's time where pictures are made in software.
        status(ui, Level::Normal, "finder at work");
    }
    let (back, next) = (state.step.back(), state.step.next());
    let mut pressed = None;
    for (text, step, none) in [
        ("‹ Back", back, "This is the first step."),
        ("Next ›", next, "This is the last step."),
    ] {
        let gate = match step {
            Some(step) => state.gate(step),
            None => Err(none.to_owned()),
        };
        let hover = step.map_or("", Step::purpose);
        if gated(ui, &gate, Button::new(text), hover).clicked() {
            pressed = step;
        }
    }
    pressed
}
