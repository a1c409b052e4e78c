//! What can be done with a recording of the library, in the menu of its row, beside the list and by the palette.

use std::path::Path;

use super::{Library, Side, rename};
use crate::analysis::player::Player;
use crate::gui::panels::widgets::Gate;
use crate::gui::services::gap::Part;
use crate::gui::services::{RecordingEntry, Services};

/// What can be done with a recording of the list.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Act {
    /// Load it.
    Load(Side),
    /// Use it in the Gap screen.
    Gap(Part),
    /// Give it another name.
    Rename,
    /// Make a film of it.
    Video,
    /// Show it in the Rerun viewer.
    Rerun,
}

impl Act {
    /// All there are, in the order of the menu.
    pub const ALL: [Self; 7] = [
        Self::Load(Side::A),
        Self::Load(Side::B),
        Self::Gap(Part::Healthy),
        Self::Gap(Part::Suspect),
        Self::Rename,
        Self::Video,
        Self::Rerun,
    ];

    /// Name on screen.
    pub fn name(self) -> &'static str {
        match self {
            Self::Load(Side::A) => "Load and play",
            Self::Load(Side::B) => "Compare as B",
            Self::Gap(Part::Healthy) => "Use as healthy session",
            Self::Gap(Part::Suspect) => "Use as suspect session",
            Self::Rename => "Rename…",
            Self::Video => "Video…",
            Self::Rerun => "Open in Rerun",
        }
    }

    /// What its name does not say.
    pub fn hover(self) -> &'static str {
        match self {
            Self::Load(Side::A) => "Load it as A and play it on all screens",
            Self::Load(Side::B) => "Load it as B, to compare it with A",
            Self::Gap(Part::Healthy) => "The Gap screen then takes the rig in order from it",
            Self::Gap(Part::Suspect) => {
                "The Gap screen then looks in it for what the model is missing"
            }
            Self::Rename => "Its notes and further files move along",
            Self::Video => "Make a video of the arm with its error or springs below it",
            Self::Rerun => "Show it in the Rerun viewer",
        }
    }
}

/// Whether something can be done with a recording now, or why not.
pub fn act_gate(
    library: &Library,
    entry: &RecordingEntry,
    player: Option<&Player>,
    act: Act,
) -> Gate {
    match act {
        Act::Load(side) if library.is_loading(side) => {
            Err(format!("A recording is being loaded as {}.", side.name()))
        }
        Act::Rename => rename::rename_gate(library, entry, player),
        Act::Video if library.film.is_busy() => Err("A video is being made.".into()),
        Act::Gap(_) | Act::Video if library.is_under_way(entry) => {
            Err("It is being recorded: end the recording first.".into())
        }
        _ => Ok(()),
    }
}

impl Library {
    /// Does something with a recording.
    pub fn act(&mut self, act: Act, path: &Path, services: &mut Services) {
        match act {
            Act::Load(side) => self.load(path.to_owned(), (side, side == Side::B), services),
            Act::Gap(part) => self.for_gap = Some((part, path.to_owned())),
            Act::Rename => self.ask_name(path),
            Act::Video => self.film.ask(path, services),
            Act::Rerun => self.opening.begin((services.open_in_rerun)(path)),
        }
    }
}
