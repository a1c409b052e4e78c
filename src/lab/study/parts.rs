//! Studies in parts: a shard does a stretch of the items of all studies asked for, in the order of the report, and
//! the merge makes the tables of what all shards found.

use std::ops::Range;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result};
use serde::{Deserialize, Serialize};
use serde_json::json;

use super::item::Found;
use super::options::{Options, Selection};
use super::report::{About, make_folder, report};
use super::setup::{DATA, Data, Setup, Sizes};
use crate::lab::Report;
use crate::lab::shards::{Part, Shard, file_hash, program_hash, read_shards, stretch, write_shard};

/// The command that shards are of.
const OF: &str = "study";

/// Findings of a shard.
#[derive(Debug, Serialize, Deserialize)]
struct Findings {
    /// Per item, in the order of studies and items.
    items: Vec<Found>,
    /// The data that were made for it.
    data: Vec<Data>,
}

/// Items of every study that belong to a part, given the number of items of each.
fn shares(counts: &[usize], part: Part) -> Vec<Range<usize>> {
    let mine = stretch(counts.iter().sum(), part);
    let mut first = 0;
    let of_study = |count: &usize| {
        let own = |item: usize| item.clamp(first, first + count) - first;
        let share = own(mine.start)..own(mine.end);
        first += count;
        share
    };
    counts.iter().map(of_study).collect()
}

/// Does the items of one shard.
pub(super) fn find(o: &Options, part: Part, setup: &mut Setup, about: &About) -> Result<Report> {
    let studies = o.selection.studies;
    let counts: Vec<usize> = studies.iter().map(|s| (s.items)(&setup.sizes)).collect();
    let mut items = Vec::new();
    for (i, (study, own)) in studies.iter().zip(shares(&counts, part)).enumerate() {
        if !own.is_empty() {
            setup.progress.stage(&o.selection.label(i), own.len());
            items.extend((study.find)(setup, own)?);
        }
    }
    let networks_hash = o.model.as_deref().map(file_hash).transpose()?;
    let options = [
        ("version", env!("CARGO_PKG_VERSION").to_owned()),
        ("program", program_hash()?),
        ("robot", setup.robot.hash.clone()),
        ("study", o.selection.name.to_owned()),
        ("seed", o.sizes.seed.to_string()),
        ("samples", o.sizes.samples.to_string()),
        ("geometric-samples", o.sizes.geometric_samples.to_string()),
        ("epochs", o.sizes.epochs.to_string()),
        ("seconds", o.sizes.seconds.to_string()),
        ("session", o.sizes.session.to_string()),
        ("candidates", o.sizes.candidates.to_string()),
        ("networks", about.networks.clone()),
        ("networks' hash", networks_hash.unwrap_or_default()),
        ("networks' samples", about.trained_on.clone()),
    ];
    let shard = Shard {
        of: OF.to_owned(),
        about: options.map(|(name, value)| (name.to_owned(), value)).into(),
        shard: part,
        found: Findings {
            items,
            data: setup.data(),
        },
    };
    let n = part.1;
    let path = o.out.join(o.shard_file(part));
    write_shard(&path, &shard)?;
    let items = shard.found.items.len();
    Ok(Report {
        text: format!(
            "what {items} simulated items gave, in {}: `springtwin study merge` makes tables of all {n} shards",
            path.display()
        ),
        json: json!({"shard": part, "items": items, "file": path, "simulated": true}),
    })
}

/// The shards of a run, ready to be merged.
pub struct Merge {
    shards: Vec<(PathBuf, Shard<Findings>)>,
    selection: Selection,
    sizes: Sizes,
}

impl Merge {
    /// Reads the shards of one run.
    ///
    /// # Errors
    /// When a file is no shard of a study, or the shards are not all parts of one run.
    pub fn read(paths: &[PathBuf]) -> Result<Self> {
        let shards: Vec<(PathBuf, Shard<Findings>)> = read_shards(OF, paths)?;
        let (path, first) = shards.first().context("no shards were given")?;
        let (selection, sizes) = run_of(first)
            .with_context(|| format!("{} is damaged: make it again", path.display()))?;
        Ok(Self {
            shards,
            selection,
            sizes,
        })
    }

    /// Names of the files that [`Self::write`] writes.
    pub fn files(&self) -> Vec<String> {
        self.selection.files()
    }

    /// Makes of all shards the tables that one run would have made.
    ///
    /// # Errors
    /// When a shard lacks items, shards differ in their samples, or a file cannot be written.
    pub fn write(self, out: &Path) -> Result<Report> {
        let Self {
            shards,
            selection,
            sizes,
        } = self;
        let option = |name: &str| {
            let first = shards.first().map(|(_, s)| s.option(name));
            first.unwrap_or_default().to_owned()
        };
        let about = About {
            seed: sizes.seed,
            networks: option("networks"),
            trained_on: option("networks' samples"),
        };
        let studies = selection.studies;
        let counts: Vec<usize> = studies.iter().map(|s| (s.items)(&sizes)).collect();
        let all = counts.iter().sum();
        let mut items = Vec::with_capacity(all);
        let mut data: Vec<Data> = Vec::new();
        for (path, shard) in shards {
            let wanted = stretch(all, shard.shard).len();
            let got = shard.found.items.len();
            anyhow::ensure!(
                wanted == got,
                "{} holds {got} items where {wanted} belong: run that shard again",
                path.display()
            );
            items.extend(shard.found.items);
            for made in shard.found.data {
                match data.iter().find(|d| d.name == made.name) {
                    None => data.push(made),
                    Some(known) => anyhow::ensure!(
                        *known == made,
                        "the samples ({}) of {} differ from those of the shards before it, though they have the same seed: \
                     run all shards on processors of one kind",
                        made.name,
                        path.display()
                    ),
                }
            }
        }
        data.sort_by_key(|d| DATA.iter().position(|name| *name == d.name));
        make_folder(out)?;
        let mut items = items.into_iter();
        let mut tables = Vec::new();
        for (study, count) in studies.iter().zip(counts) {
            let table = study.tabulate(items.by_ref().take(count).collect());
            table.write(out)?;
            tables.push(table);
        }
        report(&selection, out, &tables, &data, &about)
    }
}

/// The run that a shard is a part of.
fn run_of(shard: &Shard<Findings>) -> Option<(Selection, Sizes)> {
    let number = |option: &str| shard.option(option).parse::<u32>().ok();
    let sizes = Sizes {
        seed: shard.option("seed").parse().ok()?,
        samples: number("samples")? as usize,
        geometric_samples: number("geometric-samples")? as usize,
        epochs: number("epochs")? as usize,
        seconds: f64::from(number("seconds")?),
        session: f64::from(number("session")?),
        candidates: number("candidates")? as usize,
    };
    Some((Selection::from_name(shard.option("study"))?, sizes))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lab::study::STUDIES;

    #[test]
    fn every_item_of_every_study_is_done_by_one_shard() {
        let sizes = Sizes {
            seed: 1,
            samples: 20_000,
            geometric_samples: 4000,
            epochs: 200,
            seconds: 60.0,
            session: 600.0,
            candidates: 16,
        };
        let counts: Vec<usize> = STUDIES.iter().map(|s| (s.items)(&sizes)).collect();
        assert!(counts.iter().all(|n| *n > 0), "{counts:?}");
        for n in [1, 2, 7, 20, 1000] {
            for (k, count) in counts.iter().enumerate() {
                let done = (1..=n).flat_map(|i| shares(&counts, (i, n))[k].clone());
                assert_eq!(done.collect::<Vec<_>>(), (0..*count).collect::<Vec<_>>());
            }
            let largest = (1..=n).map(|i| shares(&counts, (i, n)).iter().map(Range::len).sum());
            let total: usize = counts.iter().sum();
            assert_eq!(largest.max(), Some(total.div_ceil(n)));
        }
    }
}
