//! Files of the gap finder: the sessions that it reads, the finding that it writes.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::io::Read as _;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result};

use crate::gap::{self, Commissioned, Grid, Healthy, Patch, Session};
use crate::lab::session::{Drive, Excitation};
use crate::recording::{self, SessionLog, SizeLimit};
use crate::robot::RobotSpec;
use crate::sim::effects::Trajectory;

/// Reads a session log for the finder; warns of columns that look like another unit.
///
/// # Errors
/// When the file cannot be read.
pub fn read_session(path: &Path) -> Result<Session> {
    let log = recording::read_log(path)?;
    for suspicion in recording::suspected_units(&log) {
        log::warn!("{}: {suspicion}", path.display());
    }
    Ok(session_of(log))
}

/// What is known of a rig in order, read from files.
#[derive(Clone, Debug)]
pub enum Known {
    /// Its sessions; none for the factory model.
    Sessions(Vec<Grid>),
    /// A baseline that was kept.
    Commissioned(Box<Commissioned>),
}

impl Known {
    /// As the finder takes it.
    pub fn healthy(&self) -> Healthy<'_> {
        match self {
            Self::Sessions(sessions) => Healthy::Sessions(sessions),
            Self::Commissioned(rig) => Healthy::Commissioned(rig),
        }
    }
}

/// Sessions of these files.
///
/// # Errors
/// When one cannot be read or judged.
pub fn read_grids(paths: &[PathBuf]) -> Result<Vec<Grid>> {
    let grid = |p: &PathBuf| Ok(Grid::new(read_session(p)?)?);
    paths.iter().map(grid).collect()
}

/// Largest baseline that is read; ten minutes take 5 MB.
const BASELINE: SizeLimit = SizeLimit::of_kind(16 << 20, "a baseline");

/// Reads healthy sessions, or one baseline that `gap commission` kept.
///
/// # Errors
/// When a file cannot be read, or a baseline stands beside other files.
pub fn read_known(paths: &[PathBuf]) -> Result<Known> {
    let Some(path) = paths.iter().find(|p| is_baseline(p)) else {
        return Ok(Known::Sessions(read_grids(paths)?));
    };
    anyhow::ensure!(
        paths.len() == 1,
        "{} is a baseline that was fitted already: it cannot count together with other baselines. Give it alone, or give \
         the healthy sessions",
        path.display()
    );
    Ok(Known::Commissioned(Box::new(baseline_in(path)?)))
}

/// The session files among what is given as baselines: one that was kept is none.
pub fn sessions_among(paths: &[PathBuf]) -> impl Iterator<Item = &Path> {
    let paths = paths.iter().filter(|p| !is_baseline(p));
    paths.map(PathBuf::as_path)
}

/// Reads the baseline in a file; `None` where it holds none.
///
/// # Errors
/// When it cannot be read.
pub fn read_baseline(path: &Path) -> Result<Option<Commissioned>> {
    is_baseline(path).then(|| baseline_in(path)).transpose()
}

fn baseline_in(path: &Path) -> Result<Commissioned> {
    let text = BASELINE.read_text(path)?;
    Commissioned::from_toml(&text).with_context(|| path.display().to_string())
}

/// Whether a file holds a baseline: its first bytes show it.
fn is_baseline(path: &Path) -> bool {
    if path.extension().is_none_or(|e| e != "toml") || !path.is_file() {
        return false;
    }
    let Ok(file) = std::fs::File::open(path) else {
        return false;
    };
    let mut start = Vec::new();
    let read = file
        .take(gap::BASELINE_START.len() as u64)
        .read_to_end(&mut start);
    read.is_ok() && start == gap::BASELINE_START.as_bytes()
}

/// A session log as the finder's input: readings as the sensors gave them, since the model of a patched robot has their errors.
pub fn session_of(log: SessionLog) -> Session {
    let log = log.uncorrected();
    Session {
        name: log.name,
        hash: log.hash,
        robot: log.robot,
        payload_kg: log.payload_kg,
        payload_column_kg: log.payload_column_kg,
        t_s: log.t_s,
        chamber_pa: log.chamber_pa,
        commanded_pa: log.commanded_pa,
        sensors: log.sensors,
        captured: log.truth,
    }
}

/// Finding, report and overlay of a run and the patch that was chosen, in one folder.
///
/// # Errors
/// When a file cannot be written.
pub fn write_all(dir: &Path, found: &gap::Found, patch: &Patch, simulated: bool) -> Result<()> {
    let f = &found.finding;
    std::fs::create_dir_all(dir)
        .with_context(|| format!("cannot make the folder {}", dir.display()))?;
    let write = |name: &str, text: &str| recording::write_text(&dir.join(name), text);
    let patch = patch.to_toml();
    let origin = if simulated {
        gap::report::Origin::Simulated
    } else {
        gap::report::Origin::Measured
    };
    write("patch.toml", &patch)?;
    write("finding.json", &serde_json::to_string_pretty(f)?)?;
    write("report.html", &gap::report::html(f, &patch, origin))?;
    let t = &f.traces;
    let series = |position_m, turn_wxyz| recording::TipSeries {
        position_m,
        turn_wxyz,
    };
    let name = f.data.get("session").map_or("session", String::as_str);
    let overlay = recording::Overlay {
        name,
        simulated,
        t_s: &t.t_s,
        measured: series(&t.measured_m, &t.turns[0]),
        before: series(&t.before_m, &t.turns[1]),
        after: series(&t.after_m, &t.turns[2]),
        channels: &t.channels,
        residual_before: &t.before,
        residual_after: &t.after,
        residual_unit: "floors",
    };
    match recording::write_overlay(&dir.join("overlay.rrd"), &overlay) {
        // A program built without Rerun still writes everything else.
        Err(recording::RecordingError::WithoutRrd { .. }) => Ok(()),
        other => Ok(other?),
    }
}

/// Residual tensions of sessions as text, one line per instant and bellows: without a law and, unless it is `None`, with it.
///
/// # Errors
/// When the file cannot be written.
pub fn write_forces(
    path: &Path,
    without: &[gap::ResidualForces],
    with: Option<&[gap::ResidualForces]>,
) -> Result<()> {
    let mut out = format!(
        "session,bellows,residual_n,sd_n,with_law_n,{}\n",
        gap::FORCE_INPUTS.join(",")
    );
    for (s, session) in without.iter().enumerate() {
        // A comma would be a column.
        let name = session.session.replace(',', " ");
        for (k, row) in session.rows.iter().enumerate() {
            let with = with.and_then(|w| w.get(s)?.rows.get(k));
            let with = with.map_or(String::new(), |r| format!("{:.5}", r.residual_n));
            let _ = write!(
                out,
                "{name},{},{:.5},{:.5},{with}",
                row.bellows + 1,
                row.residual_n,
                row.sd_n
            );
            for input in row.inputs {
                let _ = write!(out, ",{input:.6e}");
            }
            out.push('\n');
        }
    }
    Ok(recording::write_text(path, &out)?)
}

/// Motions of the virtual rig among which the finder looks for a discriminating excitation: the pressures that the
/// pumps of `robot` reach.
pub fn excitations(robot: &RobotSpec) -> Vec<(String, Trajectory)> {
    const SECONDS: f64 = 90.0;
    const RATE_HZ: f64 = 15.0;
    let t_s: Vec<f64> = (0..(SECONDS * RATE_HZ) as usize)
        .map(|k| k as f64 / RATE_HZ)
        .collect();
    Excitation::ALL
        .into_iter()
        .filter(|e| *e != Excitation::Still)
        .map(|e| {
            let drive = Drive::new(e, robot, 1, SECONDS);
            let trajectory = Trajectory {
                chamber_pa: drive.pumped(&t_s),
                t_s: t_s.clone(),
            };
            (e.name().to_owned(), trajectory)
        })
        .collect()
}

/// The folder of a finding's report: another session, another baseline or another robot file is another
/// finding.
pub fn report_folder(data: &BTreeMap<String, String>, robot: &str) -> String {
    let start = |hash: &str| hash.chars().take(12).collect::<String>();
    let of = |key: &str, none: &str| start(data.get(key).map_or(none, String::as_str));
    format!(
        "{}-{}-{}",
        of("session_sha256", "session"),
        of("baseline_sha256", "factory"),
        start(robot)
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_finder_gets_readings_as_the_sensors_gave_them_through_every_file() {
        let mut errors = crate::signal::SensorErrors::default();
        errors.spring[3] = [1.0625, 0.5e-3];
        let row = |length_m: f64| crate::signal::SensorVec {
            spring_m: [length_m; crate::signal::SPRINGS],
            imu_ypr_rad: Default::default(),
        };
        let log = SessionLog {
            name: "patched".to_owned(),
            rate_hz: 10.0,
            t_s: vec![0.0, 0.1],
            chamber_pa: vec![[0.0; 6]; 2],
            sensors: vec![row(0.16), row(0.128)],
            truth: vec![None; 2],
            corrected_by: Some(errors),
            ..SessionLog::default()
        };
        let id = std::process::id();
        let folder = std::env::temp_dir().join(format!("springtwin-corrected-{id}"));
        recording::write_session(&folder, &log).expect("writes");
        let read = recording::read_log(&folder).expect("reads");
        assert_eq!(read.corrected_by, log.corrected_by);
        std::fs::remove_dir_all(&folder).expect("cleans up");
        for log in [log, read] {
            let lengths = session_of(log).sensors.into_iter().map(|s| s.spring_m);
            for (got, [other, fourth]) in lengths.zip([[0.16, 0.1705], [0.128, 0.1365]]) {
                assert!((got[2] - other).abs() < 1e-9 && (got[3] - fourth).abs() < 1e-9);
            }
        }
    }

    #[test]
    fn a_report_has_a_folder_of_its_own_for_another_baseline_or_robot() {
        let found = |session: &str, baseline: Option<&str>, robot: &str| {
            let data = [
                Some(("session_sha256", session)),
                baseline.map(|b| ("baseline_sha256", b)),
            ];
            let data = data.into_iter().flatten();
            report_folder(
                &data.map(|(k, v)| (k.to_owned(), v.to_owned())).collect(),
                robot,
            )
        };
        let names = [
            found("aa", Some("bb"), "cc"),
            found("aa", Some("bd"), "cc"),
            found("aa", None, "cc"),
            found("aa", Some("bb"), "cd"),
        ];
        for (i, a) in names.iter().enumerate() {
            assert!(names[i + 1..].iter().all(|b| a != b), "{names:?}");
        }
    }
}
