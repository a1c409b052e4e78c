//! Studies in parts: a shard does a stretch of the items of all studies asked for, in the order of the report, and
//! the merge makes the tables of what all shards found.

use std::ops::Range;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result};
use clap::ValueEnum as _;
use serde::{Deserialize, Serialize};
use serde_json::json;

use super::super::Report;
use super::super::outputs::Overwrite;
use super::lab::{DATA, Lab, Sizes};
use super::table::Found;
use super::{About, Data, Name, StudyArgs, make_folder, report};
use springtwin::lab::shards::{
    Part, Shard, file_hash, program_hash, read_shards, stretch, write_shard,
};

/// The command that shards are of.
const OF: &str = "study";

/// What a shard found.
#[derive(Debug, Serialize, Deserialize)]
struct Findings {
    /// Per item, in the order of studies and items.
    items: Vec<Found>,
    /// The data that were made for it.
    data: Vec<Data>,
}

/// The file of a part.
pub fn file_of(name: Name, (i, n): Part) -> String {
    format!("{}-{i}-of-{n}.json", name.word())
}

/// What one of the studies that were asked for is called while it is done.
pub fn label(name: Name, i: usize, count: usize) -> String {
    match count {
        1 => name.word(),
        _ => format!("study {} of {count}", i + 1),
    }
}

/// Which items of every study a part does, given how many each has.
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
pub fn find(
    a: &StudyArgs,
    name: Name,
    part: Part,
    out: &Path,
    lab: &mut Lab,
    about: &About,
) -> Result<Report> {
    let studies = name.studies();
    let counts: Vec<usize> = studies.iter().map(|s| (s.items)(&lab.sizes)).collect();
    let mut items = Vec::new();
    for (i, (study, own)) in studies.iter().zip(shares(&counts, part)).enumerate() {
        if !own.is_empty() {
            lab.progress.study(label(name, i, studies.len()), own.len());
            items.extend((study.find)(lab, own)?);
        }
    }
    let networks_hash = a.model.as_deref().map(file_hash).transpose()?;
    let options = [
        ("version", env!("CARGO_PKG_VERSION").to_owned()),
        ("program", program_hash()?),
        ("robot", lab.robot.hash.clone()),
        ("study", name.word()),
        ("seed", a.seed.to_string()),
        ("samples", a.samples.to_string()),
        ("geometric-samples", a.geometric_samples.to_string()),
        ("epochs", a.epochs.to_string()),
        ("seconds", a.seconds.to_string()),
        ("candidates", a.candidates.to_string()),
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
            data: lab.data(),
        },
    };
    let n = part.1;
    let path = out.join(file_of(name, part));
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

/// Makes the tables of what all shards of a run found.
pub fn merge(paths: &[PathBuf], out: &Path, overwrite: Overwrite) -> Result<Report> {
    let shards: Vec<(PathBuf, Shard<Findings>)> = read_shards(OF, paths)?;
    let (path, first) = shards.first().context("no shards were given")?;
    let (name, sizes) =
        run_of(first).with_context(|| format!("{} is damaged: make it anew", path.display()))?;
    overwrite.files(out, &name.files())?;
    let about = About {
        seed: sizes.seed,
        networks: first.option("networks").to_owned(),
        trained_on: first.option("networks' samples").to_owned(),
    };
    let studies = name.studies();
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
        let table = (study.table)(items.by_ref().take(count).collect());
        table.write(out)?;
        tables.push(table);
    }
    report(name, out, &tables, &data, &about)
}

/// What a shard is a part of.
fn run_of(shard: &Shard<Findings>) -> Option<(Name, Sizes)> {
    let number = |option: &str| shard.option(option).parse::<u32>().ok();
    let sizes = Sizes {
        seed: shard.option("seed").parse().ok()?,
        samples: number("samples")? as usize,
        geometric_samples: number("geometric-samples")? as usize,
        epochs: number("epochs")? as usize,
        seconds: f64::from(number("seconds")?),
        candidates: number("candidates")? as usize,
    };
    Some((Name::from_str(shard.option("study"), false).ok()?, sizes))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_item_of_every_study_is_done_by_one_shard() {
        let sizes = Sizes {
            seed: 1,
            samples: 20_000,
            geometric_samples: 4000,
            epochs: 200,
            seconds: 60.0,
            candidates: 48,
        };
        let studies = Name::All.studies();
        let counts: Vec<usize> = studies.iter().map(|s| (s.items)(&sizes)).collect();
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
