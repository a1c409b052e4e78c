//! `gap bench`: the blind test of the gap finder.
//!
//! Three parties that share no memory: a generator that writes sessions and, elsewhere, their answer
//! keys; a finder that is given the sessions alone; and the scoring, which reads keys and verdicts
//! once, after the last verdict is on disk. The first two are processes of their own. A shard makes and
//! solves a stretch of the cases and scores nothing; the merge scores all of them, once.

mod finder;
mod generator;
mod suite;

use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};

use anyhow::{Context as _, Result};
use clap::{Args, Subcommand};
use indicatif::{ProgressBar, ProgressStyle};
use serde::{Deserialize, Serialize};
use serde_json::json;

use super::outputs::Overwrite;
use super::shards::{self, Shard, file_hash, read_shards, stretch, write, write_shard};
use super::{Report, args};
pub use generator::{CaseArgs, Maker, run as rig_case};
use springtwin::gap::score::{Key, Said, Scored, score};
use springtwin::robot::RobotSpec;
use suite::{Planned, Suite};

/// The suite, per seed S (all figures: RMS change in the most sensitive channel over the floor):
///
///   singles  three effects of the table at 2, 4 and 8 times the floor: effects 10 S, 10 S + 9 and
///            10 S + 18 (modulo the number of effects); nine seeds in a row have every effect once,
///            27 have every effect at each of the strengths
///   ladder   every third seed one more single, at 0.5 and 1 times the floor in turn
///   nulls    one session without an effect (every case is another rig, with its own scatter)
///   aliens   even seeds: one of five effects that the table does not have; odd seeds: one of the
///            table, which the finder has to do without (`gap run --without ID`); 4 times the floor
///   pairs    two effects of different sides, each 4 times the floor
///
/// 30 seeds are 190 cases. Channels, signs and sizes are drawn from the seed. An effect whose bounds
/// keep it from the strength stands on the rung that it reaches.
///
/// DIR/cases/NAME/{commissioning,suspect} are the sessions, verdict.json beside them is what the
/// finder said; DIR/keys/NAME.json is what was hidden. The finder runs with a cleared environment, in
/// another working directory, on those two folders. Scoring starts when all verdicts are written:
/// DIR/report.md and DIR/report.json. A run that was stopped goes on where it was; cases keep their
/// sessions, and their verdicts as long as the finder's program is the same file.
///
/// With --shard I/N only a stretch of the cases is made and solved, and DIR/shard-I-of-N.json says which;
/// `gap bench merge` scores the cases of all shards. Shards may share a folder or have one each.
#[derive(Args)]
#[command(verbatim_doc_comment, args_conflicts_with_subcommands = true)]
pub struct BenchArgs {
    #[command(subcommand)]
    merge: Option<BenchCommand>,
    /// Number of seeds
    #[arg(long, value_name = "N", default_value = "30")]
    seeds: u64,
    /// First seed
    #[arg(long, value_name = "S", default_value = "1")]
    first_seed: u64,
    /// Folder for cases, keys, verdicts and the report
    #[arg(long, value_name = "DIR", default_value = "gap-bench")]
    out: PathBuf,
    #[command(flatten)]
    overwrite: Overwrite,
    /// Only these parts of the suite
    #[arg(long, value_enum, value_delimiter = ',', value_name = "PART,..")]
    only: Vec<suite::Part>,
    /// Make and solve only part i of n of the cases; nothing is scored
    #[arg(long, value_name = "I/N", value_parser = args::shard)]
    shard: Option<shards::Part>,
    /// Finders at a time; each uses all cores
    #[arg(long, value_name = "N", default_value = "1")]
    jobs: NonZeroUsize,
    /// A finder that takes longer is ended and has failed, s
    #[arg(long, value_name = "S", default_value = "900", value_parser = args::not_negative)]
    limit: f64,
    /// Length of the sessions, s
    #[arg(long, value_name = "S", default_value = "90", value_parser = args::not_negative, hide = true)]
    seconds: f64,
    /// Program that finds
    #[arg(long, value_name = "FILE", hide = true)]
    finder: Option<PathBuf>,
}

#[derive(Subcommand)]
enum BenchCommand {
    /// Score the cases of all shards, once, into the report that one run would have made
    Merge {
        /// The files shard-I-of-N.json, each beside the cases and keys of its shard
        #[arg(required = true)]
        shards: Vec<PathBuf>,
        /// Folder for the report
        #[arg(long, value_name = "DIR")]
        out: PathBuf,
        #[command(flatten)]
        overwrite: Overwrite,
    },
}

/// What a shard leaves for the merge: never what was hidden, and no verdict.
#[derive(Debug, Serialize, Deserialize)]
struct Cases {
    /// Cases with sessions, a key and a verdict.
    solved: Vec<String>,
    /// Cases that no rig could hold.
    not_made: Vec<String>,
}

/// Where things are.
struct Places {
    cases: PathBuf,
    keys: PathBuf,
}

impl Places {
    fn of(out: &Path) -> Self {
        Self {
            cases: out.join("cases"),
            keys: out.join("keys"),
        }
    }

    fn case(&self, planned: &Planned) -> PathBuf {
        self.cases.join(&planned.name)
    }

    fn key(&self, planned: &Planned) -> PathBuf {
        self.keys.join(format!("{}.json", planned.name))
    }
}

/// The cases of a run, as far as they were made.
struct Run<'a> {
    suite: &'a Suite,
    /// Hash of the finder.
    finder: &'a str,
    not_made: Vec<String>,
    scored: Vec<Scored>,
}

/// `gap bench`.
pub fn run(a: &BenchArgs, robot_file: Option<&Path>, robot: &RobotSpec) -> Result<Report> {
    if let Some(BenchCommand::Merge {
        shards,
        out,
        overwrite,
    }) = &a.merge
    {
        overwrite.files(out, &REPORT)?;
        return merge(shards, out);
    }
    // Cases and verdicts that are there are taken over, never replaced.
    match a.shard {
        Some(part) => a.overwrite.files(&a.out, &[shard_name(part)])?,
        None => a.overwrite.files(&a.out, &REPORT)?,
    }
    let suite = Suite {
        first_seed: a.first_seed,
        seeds: a.seeds,
        parts: a.only.clone(),
        seconds: a.seconds,
        robot: robot.hash.clone(),
    };
    let mut planned = suite.cases();
    anyhow::ensure!(
        !planned.is_empty(),
        "no case to run: --seeds or --only leaves nothing"
    );
    if let Some(part) = a.shard {
        planned = planned[stretch(planned.len(), part)].to_vec();
    }
    let out = std::path::absolute(&a.out)?;
    let places = Places::of(&out);
    for dir in [&places.cases, &places.keys] {
        std::fs::create_dir_all(dir).with_context(|| format!("cannot create {}", dir.display()))?;
    }
    let robot_file = robot_file.map(std::path::absolute).transpose()?;
    let program = std::env::current_exe().context("cannot tell where this program is")?;

    let maker = Maker {
        program: &program,
        robot_file: robot_file.as_deref(),
        seconds: a.seconds,
    };
    let cores = std::thread::available_parallelism().unwrap_or(NonZeroUsize::MIN);
    let made = each("making cases", &planned, cores, |p| {
        maker.make(p, &places.case(p), &places.key(p))
    })?;
    let mut ready = Vec::new();
    let mut not_made = Vec::new();
    for (p, outcome) in planned.iter().zip(made) {
        match outcome {
            Ok(()) => ready.push(p),
            Err(e) => {
                log::warn!("case {} is left out: {e:#}", p.name);
                not_made.push(p.name.clone());
            }
        }
    }

    let finder = match &a.finder {
        Some(path) => std::path::absolute(path)?,
        None => program.clone(),
    };
    let seeker = finder::Seeker {
        hash: file_hash(&finder)?,
        program: &finder,
        robot_file: robot_file.as_deref(),
        limit_s: a.limit,
    };
    let sought = each("finding", &ready, a.jobs, |p| {
        seeker.seek(&places.case(p), p.without)
    })?;
    // All verdicts are on disk, or there is no score.
    sought.into_iter().collect::<Result<Vec<()>>>()?;

    if let Some(part) = a.shard {
        let solved = ready.iter().map(|p| p.name.clone()).collect();
        return leave(a, &suite, &seeker.hash, part, Cases { solved, not_made });
    }
    let scored = ready.iter().map(|p| read_case(p, &places));
    let run = Run {
        suite: &suite,
        finder: &seeker.hash,
        not_made,
        scored: scored.collect::<Result<_>>()?,
    };
    report(&run, &out)
}

/// What a run of all cases, or the merge of its shards, leaves.
const REPORT: [&str; 2] = ["report.md", "report.json"];

/// What a shard leaves.
fn shard_name((i, n): shards::Part) -> String {
    format!("shard-{i}-of-{n}.json")
}

/// The command that shards are of.
const OF: &str = "gap bench";

/// Leaves for the merge what a shard has done.
fn leave(
    a: &BenchArgs,
    suite: &Suite,
    finder: &str,
    part: shards::Part,
    cases: Cases,
) -> Result<Report> {
    let mut about = suite.about();
    about.push(("finder".to_owned(), finder.to_owned()));
    about.push(("limit".to_owned(), a.limit.to_string()));
    let shard = Shard {
        of: OF.to_owned(),
        about,
        shard: part,
        found: cases,
    };
    let path = a.out.join(shard_name(part));
    write_shard(&path, &shard)?;
    let cases = shard.found.solved.len();
    Ok(Report {
        text: format!(
            "{cases} simulated cases solved, none scored: `springtwin gap bench merge` scores all {} shards, this one \
             by {}",
            part.1,
            path.display()
        ),
        json: json!({"shard": part, "cases": cases, "not_made": shard.found.not_made, "file": path, "simulated": true}),
    })
}

/// Scores the cases of all shards of a run.
fn merge(paths: &[PathBuf], out: &Path) -> Result<Report> {
    let shards: Vec<(PathBuf, Shard<Cases>)> = read_shards(OF, paths)?;
    let (path, first) = shards.first().context("no shards were given")?;
    let suite = Suite::from_about(first)
        .with_context(|| format!("{} is damaged: make it anew", path.display()))?;
    let finder = first.option("finder");
    let planned = suite.cases();
    let (mut not_made, mut scored) = (Vec::new(), Vec::new());
    for (path, shard) in &shards {
        let (i, n) = shard.shard;
        let places = Places::of(path.parent().unwrap_or(Path::new("")));
        for p in &planned[stretch(planned.len(), shard.shard)] {
            if shard.found.not_made.contains(&p.name) {
                not_made.push(p.name.clone());
                continue;
            }
            let solved = shard.found.solved.contains(&p.name);
            anyhow::ensure!(
                solved && finder::is_by(&places.case(p), finder, p.without),
                "case {} of shard {i}/{n} has no verdict of its finder in {}: run that shard again",
                p.name,
                places.case(p).display()
            );
            scored.push(read_case(p, &places)?);
        }
    }
    let run = Run {
        suite: &suite,
        finder,
        not_made,
        scored,
    };
    std::fs::create_dir_all(out).with_context(|| format!("cannot create {}", out.display()))?;
    report(&run, out)
}

/// Scores a run and writes its report.
fn report(run: &Run, out: &Path) -> Result<Report> {
    let suite = run.suite;
    let score = score(&run.scored);
    let last = suite
        .first_seed
        .saturating_add(suite.seeds.saturating_sub(1));
    let left_out = match run.not_made.len() {
        0 => String::new(),
        n => format!(" {n} more cases could not be made: the arm cannot hold what they hide."),
    };
    let head = format!(
        "Seeds {} to {last}, {} s sessions, springtwin {}, finder {}.{left_out}",
        suite.first_seed,
        suite.seconds,
        env!("CARGO_PKG_VERSION"),
        run.finder.get(..12).unwrap_or(run.finder),
    );
    let text = score.markdown(&head);
    let json = json!({
        "simulated": true, "first_seed": suite.first_seed, "seeds": suite.seeds, "seconds": suite.seconds,
        "version": env!("CARGO_PKG_VERSION"), "finder": run.finder, "robot": suite.robot,
        "not_made": run.not_made, "score": score,
    });
    let paths = REPORT.map(|name| out.join(name));
    write(&paths[0], &text)?;
    write(&paths[1], &format!("{json:#}"))?;
    Ok(Report {
        text: format!("{text}\nWritten to {}", paths[0].display()),
        json,
    })
}

fn read_case(planned: &Planned, places: &Places) -> Result<Scored> {
    let path = places.key(planned);
    let key: Key = serde_json::from_str(&super::read_text(&path)?)
        .with_context(|| format!("the key {} does not read", path.display()))?;
    let said = Said::from_json(&super::read_text(
        &places.case(planned).join(finder::VERDICT),
    )?);
    Ok(Scored {
        name: planned.name.clone(),
        key,
        said,
    })
}

/// Does `work` on every item, `workers` at a time, behind a progress bar; results in order.
fn each<T: Sync>(
    what: &'static str,
    items: &[T],
    workers: NonZeroUsize,
    work: impl Fn(&T) -> Result<()> + Sync,
) -> Result<Vec<Result<()>>> {
    let style = ProgressStyle::with_template("{msg:14} {bar:40} {pos}/{len} {eta}");
    let bar = ProgressBar::new(items.len() as u64)
        .with_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()))
        .with_message(what);
    bar.tick();
    let next = AtomicUsize::new(0);
    let mine = || {
        let mut done = Vec::new();
        loop {
            let i = next.fetch_add(1, Ordering::Relaxed);
            let Some(item) = items.get(i) else { break };
            done.push((i, work(item)));
            bar.inc(1);
        }
        done
    };
    let mut done = std::thread::scope(|scope| -> Result<Vec<_>> {
        let mut hands = Vec::new();
        for i in 0..workers.get().min(items.len()) {
            let name = format!("bench-{i}");
            let hand = std::thread::Builder::new().name(name);
            hands.push(hand.spawn_scoped(scope, mine)?);
        }
        let mut done = Vec::new();
        for hand in hands {
            match hand.join() {
                Ok(some) => done.extend(some),
                Err(panic) => std::panic::resume_unwind(panic),
            }
        }
        Ok(done)
    })?;
    bar.finish_and_clear();
    done.sort_by_key(|(i, _)| *i);
    Ok(done.into_iter().map(|(_, r)| r).collect())
}
