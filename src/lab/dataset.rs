//! Data sets of settled samples, for training.

use std::ops::{ControlFlow, Range};
use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result};

use super::session::calibration_of;
use super::shards::{Part, Shard, in_order, not_a_shard, stretch};
use super::{Progress, go_on, motions, threads, units};
use crate::recording::{
    DATASET_SAMPLE_BYTES, DatasetJournal, SessionLog, read_dataset, read_log, write_dataset,
};
use crate::rig::Unit;
use crate::robot::RobotSpec;
use crate::signal::{Dataset, Sample};
use crate::sim::dataset::{Plan, generate as by_rod, generate_mesh};
use crate::sim::mesh::MeshModel;

/// Simulator that makes the samples.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Source {
    /// Piecewise-constant-strain rods.
    Rod,
    /// Tetrahedra between rigid pads, the nominal arm.
    Mesh,
    /// The virtual rig, read through its circuits and the calibration.
    Rig,
}

/// Options of a data set.
#[derive(Clone, Debug)]
pub struct Options {
    /// Simulator that makes the samples.
    pub source: Source,
    /// Pressures, loads and scatter of the samples, and their seed.
    pub plan: Plan,
    /// The unit of the virtual rig, where that makes the samples; read by the calibration of its own springs.
    pub unit: Unit,
    /// Only this part of the samples, by rod or mesh; `None`: all of them.
    pub shard: Option<Part>,
    /// The file.
    pub out: PathBuf,
}

impl Options {
    /// Indices of the samples to be made.
    pub fn range(&self) -> Range<usize> {
        stretch(self.plan.draw.len(), self.shard.unwrap_or((1, 1)))
    }

    /// Space that the samples take on the disk while they are made, bytes: journal and data set are there together
    /// at the end.
    pub fn bytes(&self) -> u128 {
        self.range().len() as u128 * u128::from(DATASET_SAMPLE_BYTES)
    }
}

/// A data set that was made.
#[derive(Clone, Debug)]
pub struct Made {
    /// Number of samples.
    pub samples: usize,
    /// Samples without equilibrium, which are left out.
    pub left_out: usize,
    /// Samples that an earlier, interrupted run had computed.
    pub taken_over: usize,
    /// Name of the simulator.
    pub source: String,
}

/// Makes a data set. By rod or mesh an interrupted run continues where it was, to the same bytes.
///
/// # Errors
/// When the simulator cannot be set up, or the file cannot be written.
pub fn generate(o: &Options, robot: &RobotSpec, progress: &dyn Progress) -> Result<Made> {
    progress.stage("settling", o.range().len());
    let made = match o.source {
        Source::Rig => {
            let mut done = |n: usize| {
                progress.items_done(n);
                ControlFlow::Continue(())
            };
            let own = (o.unit, &calibration_of(robot, o.unit)?);
            let (data, left_out) = motions::settled(robot, own, &o.plan, o.range(), &mut done)?;
            write_dataset(&o.out, &data)?;
            Made {
                samples: data.samples.len(),
                left_out,
                taken_over: 0,
                source: data.source,
            }
        }
        Source::Rod => resumable("rod", 4, o, robot, progress, &|part| {
            by_rod(robot, &o.plan, part, threads(), &mut go_on)
        })?,
        Source::Mesh => {
            let mesh = MeshModel::new(robot)?;
            resumable("mesh", 1, o, robot, progress, &|part| {
                generate_mesh(&mesh, &o.plan, part, threads(), &mut go_on)
            })?
        }
    };
    progress.stage_done("settled");
    Ok(made)
}

/// A motion-capture session of a unit of the virtual rig; returns the number of its samples.
///
/// # Errors
/// When a spring is refused, the arm cannot follow, or the file cannot be written.
pub fn session(robot: &RobotSpec, unit: Unit, seconds: f64, out: &Path) -> Result<usize> {
    let data = units::session(robot, unit, &calibration_of(robot, unit)?, seconds)?;
    write_dataset(out, &data)?;
    Ok(data.samples.len())
}

/// Generates the samples in parts of `rounds` times 64 indices per thread and keeps every part in a
/// journal beside the output.
fn resumable(
    source: &str,
    rounds: usize,
    o: &Options,
    robot: &RobotSpec,
    progress: &dyn Progress,
    part: &dyn Fn(Range<usize>) -> (Dataset, usize),
) -> Result<Made> {
    let (plan, range) = (&o.plan, o.range());
    let mut about = vec![
        ("version", env!("CARGO_PKG_VERSION").to_owned()),
        ("simulator", source.to_owned()),
        ("robot", robot.hash.clone()),
        ("draw", format!("{:?}", plan.draw)),
        ("seed", plan.seed.to_string()),
        ("payload-max", plan.payload_max_kg.to_string()),
        ("force", plan.tip_force_sd_n.to_string()),
        ("deviation", plan.deviation_sd.to_string()),
        ("free-pads", plan.free_pads_sd_m.to_string()),
        ("attachment", plan.attachment_sd_m.to_string()),
        ("disturbed-share", plan.disturbed_share.to_string()),
    ];
    let shard = o.shard.map(|part| Shard {
        of: SHARDS_OF.to_owned(),
        about: about
            .iter()
            .map(|(name, value)| ((*name).to_owned(), value.clone()))
            .collect(),
        shard: part,
        found: (),
    });
    about.push(("shard", format!("{range:?}")));
    let mut journal = DatasetJournal::open(&o.out, &about)?;
    let taken_over = journal.samples;
    let block = rounds * 64 * threads();
    while journal.done < range.len() {
        progress.items_done(journal.done);
        let from = range.start + journal.done;
        let to = (from + block).min(range.end);
        let (data, _) = part(from..to);
        journal.append(to - from, &data.samples)?;
    }
    let (samples, left_out) = (journal.samples, journal.done - journal.samples);
    journal.finish(&Dataset {
        samples: Vec::new(),
        source: source.to_owned(),
        seed: plan.seed,
        robot_hash: robot.hash.clone(),
        row_s: None,
        shard: shard.map(|s| serde_json::to_string(&s)).transpose()?,
    })?;
    Ok(Made {
        samples,
        left_out,
        taken_over,
        source: source.to_owned(),
    })
}

/// The command that shards are of.
const SHARDS_OF: &str = "dataset generate";

/// Joins shards into the file of one run; returns the number of samples and the name of their simulator.
///
/// # Errors
/// When the shards are not all parts of one run, or a file cannot be read or written.
pub fn merge(paths: &[PathBuf], out: &Path) -> Result<(usize, String)> {
    let mut shards: Vec<(PathBuf, Shard<Dataset>)> = Vec::new();
    for path in paths {
        let mut data = read_dataset(path)?;
        let about = data.shard.take();
        let about: Option<Shard<()>> = about.and_then(|t| serde_json::from_str(&t).ok());
        let about = about.with_context(|| not_a_shard(SHARDS_OF, path))?;
        shards.push((path.clone(), about.with(data)));
    }
    let shards = in_order(SHARDS_OF, shards)?;
    let mut parts = shards.into_iter().map(|(_, shard)| shard.found);
    let mut joined = parts.next().context("no shards were given")?;
    joined.samples.extend(parts.flat_map(|p| p.samples));
    write_dataset(out, &joined)?;
    Ok((joined.samples.len(), joined.source))
}

/// The samples of several files one after the other; `None` of no file. Their interval between rows is the shortest of the
/// files', so that blocks of time are nowhere shorter than stated.
///
/// # Errors
/// As [`read_samples`].
pub fn read_all_samples(paths: &[PathBuf]) -> Result<Option<Dataset>> {
    let all = paths.iter().map(|path| read_samples(path));
    Ok(joined(all.collect::<Result<Vec<_>>>()?))
}

/// Data sets one after the other as one; `None` of none.
pub fn joined(all: Vec<Dataset>) -> Option<Dataset> {
    all.into_iter().reduce(|mut all, more| {
        all.source += &format!(" + {}", more.source);
        all.row_s = [all.row_s, more.row_s]
            .into_iter()
            .flatten()
            .reduce(f64::min);
        all.samples.extend(more.samples);
        all
    })
}

/// Reads a data set, or the samples of a session that has motion capture.
///
/// # Errors
/// When the file cannot be read.
pub fn read_samples(path: &Path) -> Result<Dataset> {
    if path.extension().is_some_and(|e| e == "parquet") {
        return Ok(read_dataset(path)?);
    }
    let log = read_log(path)?;
    Ok(samples_of(&log))
}

/// The complete rows of a session, as a trajectory.
pub(super) fn samples_of(log: &SessionLog) -> Dataset {
    let complete = |k: usize| {
        let complete = log.chamber_pa[k].iter().all(|p| p.is_finite())
            && log.sensors[k].to_vector().iter().all(|x| x.is_finite());
        log.truth[k].filter(|_| complete)
    };
    let (t_s, samples): (Vec<f64>, Vec<Sample>) = (0..log.len())
        .filter_map(|k| {
            let sample = Sample {
                chamber_pa: log.chamber_pa[k],
                payload_kg: log.payload_at_kg(k),
                tip_force_n: [0.0; 3],
                off_nominal: false,
                sensors: log.sensors[k].clone(),
                base_from_tip: complete(k)?,
            };
            Some((log.t_s[k], sample))
        })
        .unzip();
    Dataset {
        samples,
        source: log.name.clone(),
        seed: 0,
        robot_hash: String::new(),
        row_s: row_interval_s(&t_s),
        shard: None,
    }
}

/// Median time between consecutive rows, s; `None` of fewer than two.
fn row_interval_s(t_s: &[f64]) -> Option<f64> {
    let mut steps_s: Vec<f64> = t_s.windows(2).map(|w| w[1] - w[0]).collect();
    steps_s.sort_by(f64::total_cmp);
    steps_s.get(steps_s.len() / 2).copied().filter(|s| *s > 0.0)
}

#[cfg(test)]
mod tests {
    use nalgebra::SVector;

    use super::*;
    use crate::signal::{CHAMBERS, Pose, SensorVec};

    /// A session of so many rows, every third one without motion capture.
    fn log(rows: usize, rate_hz: f64) -> SessionLog {
        SessionLog {
            name: "walk".to_owned(),
            rate_hz,
            payload_kg: 0.1,
            t_s: (0..rows).map(|k| k as f64 / rate_hz).collect(),
            chamber_pa: vec![[0.0; CHAMBERS]; rows],
            sensors: vec![SensorVec::from_vector(&SVector::from_element(0.1)); rows],
            truth: (0..rows)
                .map(|k| (k % 3 != 0).then(Pose::identity))
                .collect(),
            commanded_pa: None,
            payload_column_kg: None,
            cut: false,
            hash: String::new(),
            robot: String::new(),
            corrected_by: None,
            simulated: None,
        }
    }

    #[test]
    fn a_session_is_a_trajectory_with_the_time_between_its_rows() {
        let data = samples_of(&log(600, 50.0));
        assert_eq!(data.samples.len(), 400);
        let row_s = data.row_s.expect("a trajectory");
        assert!((0.0199..0.0401).contains(&row_s), "{row_s}");
        assert_eq!(samples_of(&log(2, 50.0)).row_s, None);
    }

    #[test]
    fn sessions_and_data_sets_in_files_keep_the_time_between_their_rows() {
        let dir = std::env::temp_dir().join(format!("springtwin-rows-{}", std::process::id()));
        std::fs::create_dir_all(&dir).expect("a folder");
        let paths = [
            dir.join("slow.parquet"),
            dir.join("fast.parquet"),
            dir.join("drawn.parquet"),
        ];
        for (path, row_s) in paths.iter().zip([Some(0.2), Some(0.02), None]) {
            let data = Dataset {
                row_s,
                ..samples_of(&log(30, 50.0))
            };
            write_dataset(path, &data).expect("writes");
        }
        let all = read_all_samples(&paths).expect("reads").expect("some");
        assert_eq!((all.samples.len(), all.row_s), (60, Some(0.02)));
        let drawn = read_all_samples(&paths[2..]).expect("reads").expect("some");
        assert_eq!(drawn.row_s, None);
        std::fs::remove_dir_all(dir).expect("removed");
    }
}
