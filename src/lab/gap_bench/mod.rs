//! Blind test of the gap finder (`gap bench`).
//!
//! Three parties that share no memory: a generator that writes sessions and, elsewhere, their answer
//! keys; a finder that is given the sessions alone; and the scoring, which reads keys and verdicts
//! once, after the last verdict is on disk. The first two are processes of their own. A shard makes and
//! solves a contiguous range of the cases and scores nothing; the merge scores all of them, once.

pub mod cases;
mod example;
mod experiments;
mod finder;
mod generator;
mod laws;
mod suite;

use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use serde_json::json;

use super::shards::{self, Shard, file_hash, read_shards, stretch, write, write_shard};
use super::{Progress, Report};
use crate::drive::read_text;
use crate::gap::score::{Key, Said, Scored, score};
use crate::robot::RobotSpec;
pub use example::{Example, example, example_command};
pub use generator::{CaseOptions, Maker, SESSIONS, make_case};
pub use suite::Part;
use suite::{Planned, Suite};

/// Options of the blind test.
#[derive(Clone, Debug)]
pub struct Options {
    /// First seed.
    pub first_seed: u64,
    /// Number of seeds.
    pub seeds: u64,
    /// Folder for cases, keys, verdicts and the report.
    pub out: PathBuf,
    /// Parts of the suite; all of them if empty.
    pub parts: Vec<Part>,
    /// Make and solve only this part of the cases, and score nothing; `None`: all of them.
    pub shard: Option<shards::Part>,
    /// Finders at a time; each uses all cores.
    pub jobs: NonZeroUsize,
    /// A finder that takes longer is ended and has failed, s.
    pub limit_s: f64,
    /// Length of the sessions, s.
    pub seconds: f64,
    /// Noise beyond that of the sensors, per cent of what each channel moves by.
    pub noise_percent: f64,
    /// Program that finds; `None`: this program.
    pub finder: Option<PathBuf>,
    /// Look for laws instead of naming effects, and prove them on a third session.
    pub discover: bool,
    /// Let the finder judge the suspect sessions without motion capture.
    pub without_cameras: bool,
    /// Let the finder drive the rig, and compare how it chooses what to drive with other ways.
    pub experiment: bool,
}

impl Options {
    /// Names of the files that a run leaves in its folder, besides cases and keys.
    pub fn files(&self) -> Vec<String> {
        match self.shard {
            Some(part) => vec![shard_name(part)],
            None => REPORT.map(str::to_owned).into(),
        }
    }
}

/// Results of a shard for the merge: neither hidden effects nor verdicts.
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

/// Makes the cases, has them solved, and scores them unless they are a shard. `robot_file` is the file of `robot`; `None`: it
/// is the reference robot.
///
/// # Errors
/// When there is no case to run, or a file or process fails; a case that no rig can hold is left out.
pub fn run(
    a: &Options,
    robot_file: Option<&Path>,
    robot: &RobotSpec,
    progress: &dyn Progress,
) -> Result<Report> {
    let suite = Suite {
        first_seed: a.first_seed,
        seeds: a.seeds,
        parts: match a.discover {
            true => vec![Part::Laws],
            false if a.experiment => vec![Part::Singles, Part::Nulls],
            false => a.parts.clone(),
        },
        seconds: a.seconds,
        robot: robot.hash.clone(),
        noise_percent: a.noise_percent,
        without_cameras: a.without_cameras,
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
    if a.experiment {
        return experiment(a, &suite, &planned, (&out, robot), progress);
    }
    let places = Places::of(&out);
    for dir in [&places.cases, &places.keys] {
        std::fs::create_dir_all(dir).with_context(|| format!("cannot create {}", dir.display()))?;
    }
    let robot_file = robot_file.map(std::path::absolute).transpose()?;
    let program = std::env::current_exe().context("cannot find this program's own file")?;

    let maker = Maker {
        program: &program,
        robot_file: robot_file.as_deref(),
        seconds: a.seconds,
        noise_percent: a.noise_percent,
        proof: a.discover,
    };
    let cores = std::thread::available_parallelism().unwrap_or(NonZeroUsize::MIN);
    let made = each(progress, "making cases", &planned, cores, |p| {
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
        limit_s: a.limit_s,
        discover: a.discover,
        without_cameras: a.without_cameras,
    };
    let sought = each(progress, "finding", &ready, a.jobs, |p| {
        seeker.seek(&places.case(p), p.without)
    })?;
    // All verdicts are on disk, or there is no score.
    sought.into_iter().collect::<Result<Vec<()>>>()?;

    if let Some(part) = a.shard {
        let solved = ready.iter().map(|p| p.name.clone()).collect();
        return leave(a, &suite, &seeker.hash, part, Cases { solved, not_made });
    }
    if a.discover {
        let solved = ready.iter().map(|p| laws::read(p, &places));
        let solved: Vec<laws::Solved> = solved.collect::<Result<_>>()?;
        let head = head(&suite, &seeker.hash, not_made.len());
        return written(&out, laws::report(&solved, &head), &suite, &seeker.hash);
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

/// Experiments on all cases, kept one by one: a run that was stopped goes on where it was.
fn experiment(
    a: &Options,
    suite: &Suite,
    planned: &[Planned],
    (out, robot): (&Path, &RobotSpec),
    progress: &dyn Progress,
) -> Result<Report> {
    let program = std::env::current_exe().context("cannot find this program's own file")?;
    let finder = file_hash(&program)?;
    let weak = |p: &&Planned| p.strength <= experiments::STRENGTH_MAX;
    let planned: Vec<&Planned> = planned.iter().filter(weak).collect();
    let folder = out.join("experiments");
    std::fs::create_dir_all(&folder)
        .with_context(|| format!("cannot create {}", folder.display()))?;
    let kept = |p: &Planned| folder.join(format!("{}-{}.json", p.name, &finder[..12]));
    let made = each(progress, "experimenting", &planned, a.jobs, |p| {
        if kept(p).exists() {
            return Ok(());
        }
        let solved = experiments::solve(p, robot, suite.seconds)?;
        write(&kept(p), &serde_json::to_string_pretty(&solved)?)
    })?;
    let mut solved: Vec<experiments::Solved> = Vec::new();
    let mut not_made = 0;
    for (p, outcome) in planned.iter().zip(made) {
        match outcome {
            Ok(()) => {
                let each: Vec<experiments::Solved> = serde_json::from_str(&read_text(&kept(p))?)?;
                solved.extend(each);
            }
            Err(e) => {
                log::warn!("case {} is left out: {e:#}", p.name);
                not_made += 1;
            }
        }
    }
    let head = head(suite, &finder, not_made);
    written(out, experiments::report(&solved, &head), suite, &finder)
}

/// Files that a run of all cases, or the merge of its shards, writes.
pub const REPORT: [&str; 2] = ["report.md", "report.json"];

/// Name of a shard's file.
fn shard_name((i, n): shards::Part) -> String {
    format!("shard-{i}-of-{n}.json")
}

/// The command that shards are of.
const OF: &str = "gap bench";

/// Writes the results of a shard for the merge.
fn leave(
    a: &Options,
    suite: &Suite,
    finder: &str,
    part: shards::Part,
    cases: Cases,
) -> Result<Report> {
    let mut about = suite.about();
    about.push(("finder".to_owned(), finder.to_owned()));
    about.push(("limit".to_owned(), a.limit_s.to_string()));
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

/// Scores the cases of all shards of a run, once, into the report that one run would have made.
///
/// # Errors
/// When the shards are not all parts of one run, or a case lacks its verdict.
pub fn merge(paths: &[PathBuf], out: &Path) -> Result<Report> {
    let shards: Vec<(PathBuf, Shard<Cases>)> = read_shards(OF, paths)?;
    let (path, first) = shards.first().context("no shards were given")?;
    let suite = Suite::from_about(first)
        .with_context(|| format!("{} is damaged: make it again", path.display()))?;
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
                solved && finder::is_by(&places.case(p), finder, p, suite.without_cameras),
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

/// What a run was, in a sentence.
fn head(suite: &Suite, finder: &str, not_made: usize) -> String {
    let last = suite
        .first_seed
        .saturating_add(suite.seeds.saturating_sub(1));
    let left_out = match not_made {
        0 => String::new(),
        n => format!(" {n} more cases could not be made: the arm cannot hold what they hide."),
    };
    let noise = match suite.noise_percent > 0.0 {
        true => format!(
            ", {} % of what each channel moves by as noise beyond that of its sensor",
            suite.noise_percent
        ),
        false => String::new(),
    };
    let cameras = match suite.without_cameras {
        true => {
            " The finder had no motion capture of the suspect sessions; what acts on the cameras' frame or clock alone is not hidden."
        }
        false => "",
    };
    format!(
        "Seeds {} to {last}, {} s sessions{noise}, springtwin {}, finder {}.{cameras}{left_out}",
        suite.first_seed,
        suite.seconds,
        env!("CARGO_PKG_VERSION"),
        finder.get(..12).unwrap_or(finder),
    )
}

/// Scores a run and writes its report.
fn report(run: &Run, out: &Path) -> Result<Report> {
    let suite = run.suite;
    let score = score(&run.scored);
    let text = score.markdown(&head(suite, run.finder, run.not_made.len()));
    let json = json!({"not_made": run.not_made, "score": score});
    written(out, (text, json), suite, run.finder)
}

/// Writes a report.
fn written(
    out: &Path,
    (text, mut json): (String, serde_json::Value),
    suite: &Suite,
    finder: &str,
) -> Result<Report> {
    json["simulated"] = json!(true);
    json["first_seed"] = json!(suite.first_seed);
    json["seeds"] = json!(suite.seeds);
    json["seconds"] = json!(suite.seconds);
    json["extra_noise_percent"] = json!(suite.noise_percent);
    json["cameras"] = json!(!suite.without_cameras);
    json["version"] = json!(env!("CARGO_PKG_VERSION"));
    json["finder"] = json!(finder);
    json["robot"] = json!(suite.robot);
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
    let key: Key = serde_json::from_str(&read_text(&path)?)
        .with_context(|| format!("the key {} does not read", path.display()))?;
    let said = Said::from_json(&read_text(&places.case(planned).join(finder::VERDICT))?);
    Ok(Scored {
        name: planned.name.clone(),
        key,
        said,
    })
}

/// Does `work` on every item, `workers` at a time; results in order.
fn each<T: Sync>(
    progress: &dyn Progress,
    what: &str,
    items: &[T],
    workers: NonZeroUsize,
    work: impl Fn(&T) -> Result<()> + Sync,
) -> Result<Vec<Result<()>>> {
    progress.stage(what, items.len());
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(workers.get().min(items.len()).max(1))
        .thread_name(|i| format!("bench-{i}"))
        .build()?;
    let one = |item: &T| {
        let result = work(item);
        progress.item_done();
        result
    };
    let done = pool.install(|| items.par_iter().with_max_len(1).map(one).collect());
    progress.stage_done("");
    Ok(done)
}
