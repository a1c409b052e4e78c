//! Options of a run of studies.

use std::path::PathBuf;

use super::item::Study;
use super::list::{STUDIES, of_paper};
use super::setup::Sizes;
use crate::lab::shards::Part;

/// The studies of a run: one, or several.
#[derive(Clone, Copy)]
pub struct Selection {
    /// Name of the study, [`Self::ALL`] or [`Self::PAPER`].
    pub name: &'static str,
    /// The studies, in the order of the report.
    pub(super) studies: &'static [Study],
}

/// The report of all studies.
pub(super) const SUMMARY: &str = "README.md";
/// The paper's figures beside ours.
pub(super) const PAPER: &str = "paper.md";

impl Selection {
    /// The name of all studies together.
    pub const ALL: &'static str = "all";

    /// The name of those that the paper's page is made of.
    pub const PAPER: &'static str = "paper";

    /// The study of that name, or several; `None` if there is none.
    pub fn from_name(name: &str) -> Option<Self> {
        let several: [(&str, &[Study]); 2] = [(Self::ALL, &STUDIES), (Self::PAPER, of_paper())];
        if let Some((name, studies)) = several.into_iter().find(|(n, _)| *n == name) {
            return Some(Self { name, studies });
        }
        let study = STUDIES.iter().find(|s| s.name == name)?;
        Some(Self {
            name: study.name,
            studies: std::slice::from_ref(study),
        })
    }

    /// Whether it is several studies, which have a report and the paper's page.
    pub(super) fn is_several(&self) -> bool {
        self.studies.len() > 1
    }

    /// Label of the study at that index while it is done.
    pub(super) fn label(&self, i: usize) -> String {
        match self.studies.len() {
            1 => self.name.to_owned(),
            count => format!("study {} of {count}", i + 1),
        }
    }

    /// Files that a run, or the merge of its shards, writes.
    pub(super) fn files(&self) -> Vec<String> {
        let of = |s: &Study| ["json", "md", "svg"].map(|ending| format!("{}.{ending}", s.name));
        let mut files: Vec<String> = self.studies.iter().flat_map(of).collect();
        if self.is_several() {
            files.extend([SUMMARY.to_owned(), PAPER.to_owned()]);
        }
        files
    }
}

/// Options of a run of studies.
#[derive(Clone)]
pub struct Options {
    /// The studies.
    pub selection: Selection,
    /// Folder for tables (JSON, Markdown) and pictures (SVG).
    pub out: PathBuf,
    /// Do only this part of the items, for a merge; `None`: all of them.
    pub shard: Option<Part>,
    /// Networks in the place of the shipped ones, for the studies on sensing; `None`: the shipped ones.
    pub model: Option<PathBuf>,
    /// Sizes of the studies.
    pub sizes: Sizes,
}

impl Options {
    /// Names of the files that the run writes into its folder.
    pub fn files(&self) -> Vec<String> {
        match self.shard {
            Some(part) => vec![self.shard_file(part)],
            None => self.selection.files(),
        }
    }

    /// The file of a part.
    pub(super) fn shard_file(&self, (i, n): Part) -> String {
        format!("{}-{i}-of-{n}.json", self.selection.name)
    }
}
