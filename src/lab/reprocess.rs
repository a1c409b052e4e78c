//! A recording computed again from its raw frames, through another calibration, other networks or newer code.

use std::path::Path;

use anyhow::{Context as _, Result};
use nalgebra::SVector;
use sha2::{Digest as _, Sha256};

use super::Progress;
use crate::learn::estimate;
use crate::recording::{
    RecordingFile, RecordingMeta, RecordingSummary, RecordingWriter, Selection, SessionLog,
    each_snapshot, read_log,
};
use crate::robot::RobotSpec;
use crate::sensing::Calibration;
use crate::signal::{Estimate, NewFrames, SensorFrame, SensorVec, Snapshot, Stamp, hex};
use crate::twin::{Maps, Reading};

/// What a recording is computed with.
pub struct Means<'a> {
    /// The arm.
    pub robot: &'a RobotSpec,
    /// Its networks.
    pub maps: &'a Maps,
    /// Text of the calibration (TOML); `None`: the one in the recording.
    pub calibration: Option<String>,
}

/// Computes sensors and poses of a recording again and writes them with all that was measured and commanded. Equal input
/// and means give equal bytes. The estimator begins with the recording's first frame.
///
/// # Errors
/// When a file cannot be read or written, and when the recording holds no calibration and none is given.
pub fn reprocess(
    input: &Path,
    out: &Path,
    means: &Means<'_>,
    progress: &dyn Progress,
) -> Result<RecordingSummary> {
    let source = RecordingFile::open(input)?;
    let text = means
        .calibration
        .clone()
        .unwrap_or_else(|| source.meta().calibration.clone());
    anyhow::ensure!(
        !text.is_empty(),
        "{} holds no calibration: name one with --calibration",
        input.display()
    );
    let calibration = Calibration::from_toml(&text)
        .with_context(|| format!("the calibration for {}", input.display()))?;
    let mut sensing = means.maps.sensing(means.robot, &calibration);
    let meta = meta(source.meta(), &text, means);
    let mut writer = RecordingWriter::create_like(out, meta, &source)?;
    let mut computed = Computed::default();
    progress.stage("reprocess", 100);
    let mut done = Ok(());
    let mut from = None;
    let mut go_on = |share: f32| {
        progress.items_done((100.0 * share) as usize);
        true
    };
    source.read_in_windows(&Selection::default(), &mut go_on, &mut |window| {
        let read = window.read;
        let to = read.trace.snapshots.last().map(|s| s.stamp);
        let part = Selection {
            from,
            to,
            at_least_apart_s: 0.0,
        };
        from = to.map(|to| Stamp(to.0 + 1));
        if done.is_ok() {
            let snapshots = read.trace.snapshots.iter();
            let snapshots = snapshots.map(|s| computed.of(s, &mut sensing, means.maps));
            done = writer
                .push_read(snapshots, &read.events)
                .and_then(|()| writer.copy_pictures(&source, &part));
        }
    })?;
    done?;
    progress.stage_done("");
    Ok(writer.finish()?)
}

/// What a recording measured, as [`read_log`] has it, with its sensors read again from the raw frames with another calibration.
///
/// # Errors
/// When the file cannot be read, or holds no raw frames.
pub fn read_again(
    path: &Path,
    robot: &RobotSpec,
    maps: &Maps,
    calibration: &Calibration,
) -> Result<SessionLog> {
    let mut log = read_log(path)?;
    // A row that is not read again has no reading.
    let none = SensorVec::from_vector(&SVector::repeat(f64::NAN));
    log.sensors.fill(none);
    log.corrected_by = maps.corrected_by(robot).stated();
    let mut sensing = maps.sensing(robot, calibration);
    let (mut frames, mut any, mut row) = (NewFrames::default(), false, 0);
    each_snapshot(path, 0, &mut |snapshot| {
        if let Some(raw) = frames.of(snapshot) {
            any = true;
            if let Reading::Whole(frame, _) = maps.read(&mut sensing, raw) {
                let t_s = frame.stamp.seconds();
                row += log.t_s[row..].partition_point(|row_s| *row_s < t_s);
                if log.t_s.get(row).is_some_and(|row_s| *row_s == t_s) {
                    log.sensors[row] = frame.measured();
                }
            }
        }
    })?;
    anyhow::ensure!(
        any,
        "{} holds no raw frames: record the boards with springtwin record",
        path.display()
    );
    Ok(log)
}

/// The new recording as a whole; its identity follows from what it is made of.
fn meta(old: &RecordingMeta, calibration: &str, means: &Means<'_>) -> RecordingMeta {
    let program = env!("CARGO_PKG_VERSION");
    let parts = [
        &old.id,
        calibration,
        &means.maps.networks,
        &means.robot.hash,
        program,
    ];
    let digest = hex(&Sha256::digest(parts.join("\n")));
    RecordingMeta {
        id: format!("{}-{}", old.id, &digest[..12]),
        robot: means.robot.name.clone(),
        robot_hash: means.robot.hash.clone(),
        calibration: calibration.to_owned(),
        corrected_by: means.maps.corrected_by(means.robot).stated(),
        networks: means.maps.networks.clone(),
        program: program.to_owned(),
        derived_from: format!(
            "{}, computed again from its raw frames ({})",
            old.name, old.id
        ),
        ..old.clone()
    }
}

/// What was made of the newest raw frame.
#[derive(Default)]
struct Computed {
    frames: NewFrames,
    sensors: Option<SensorFrame>,
    estimate: Option<Estimate>,
}

impl Computed {
    /// A snapshot with what follows from its raw frame.
    fn of(
        &mut self,
        snapshot: &Snapshot,
        sensing: &mut crate::sensing::Sensing,
        maps: &Maps,
    ) -> Snapshot {
        if let Some(raw) = self.frames.of(snapshot)
            && let Reading::Whole(frame, eval) = maps.read(sensing, raw)
        {
            self.estimate = Some(estimate(frame.stamp, &eval));
            self.sensors = Some(*frame);
        }
        Snapshot {
            sensors: self.sensors.clone(),
            estimate: self.estimate.clone(),
            ..snapshot.clone()
        }
    }
}

#[cfg(all(test, feature = "rrd"))]
mod tests {
    use super::*;
    use crate::drive::{DEFAULT_RIG, model};
    use crate::lab::Silent;
    use crate::recording::read_rrd;

    fn golden() -> std::path::PathBuf {
        Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/it/golden/layout-1.rrd")
    }

    fn computed(input: &Path, name: &str, calibration: Option<String>) -> std::path::PathBuf {
        let out = temp(name);
        let robot = RobotSpec::reference();
        let maps = model::maps_for(&robot, DEFAULT_RIG, None).expect("networks");
        let means = Means {
            robot: &robot,
            maps: &maps,
            calibration,
        };
        reprocess(input, &out, &means, &Silent).expect("computed");
        out
    }

    fn temp(name: &str) -> std::path::PathBuf {
        let name = format!("springtwin-reprocess-{name}-{}.rrd", std::process::id());
        std::env::temp_dir().join(name)
    }

    /// The same recording and the same means give the same bytes; and close to what the twin computed when it recorded.
    #[test]
    fn the_same_twice_is_the_same_file() {
        let [one, two] = ["one", "two"].map(|name| computed(&golden(), name, None));
        assert!(std::fs::read(&one).unwrap() == std::fs::read(&two).unwrap());
        let old = read_rrd(&golden()).unwrap().trace.snapshots;
        let new = read_rrd(&one).unwrap();
        assert!(new.meta.derived_from.contains("computed again"));
        assert_eq!(new.trace.snapshots.len(), old.len());
        let mut compared = 0;
        for (new, old) in new.trace.snapshots.iter().zip(&old).skip(60) {
            assert_eq!(
                (&new.raw, &new.truth, &new.mode),
                (&old.raw, &old.truth, &old.mode)
            );
            let (Some(new), Some(old)) = (&new.estimate, &old.estimate) else {
                continue;
            };
            let apart = new.base_from_tip.translation.vector - old.base_from_tip.translation.vector;
            assert!(apart.norm() < 1e-3, "{} mm", 1e3 * apart.norm());
            compared += 1;
        }
        assert!(compared > 50, "{compared}");
        for path in [one, two] {
            std::fs::remove_file(path).unwrap();
        }
    }

    /// With 0.3 mm more in the constant coefficient of spring 1's curve (eq. 2 of the paper), its length is 0.3 mm longer and
    /// the other springs' lengths stay.
    #[test]
    fn lengths_follow_from_the_calibration_that_is_given() {
        let source = RecordingFile::open(&golden()).unwrap();
        let old = source.meta().calibration.clone();
        let line = old.lines().find(|l| l.starts_with("coefficients_mm"));
        let constant = line.unwrap().split(['[', ',']).nth(1).unwrap();
        let more: f64 = constant.parse::<f64>().unwrap() + 0.3;
        let other = old.replacen(constant, &more.to_string(), 1);
        let [one, two] = [("curve", old), ("other-curve", other)]
            .map(|(name, calibration)| computed(&golden(), name, Some(calibration)));
        let [plain, longer] = [&one, &two].map(|path| read_rrd(path).unwrap().trace.snapshots);
        let mut compared = 0;
        for (plain, longer) in plain.iter().zip(&longer).skip(50) {
            let (Some(plain), Some(longer)) = (&plain.sensors, &longer.sensors) else {
                continue;
            };
            for i in 0..12 {
                let more_mm = 1e3 * (longer.sensors.spring_m[i] - plain.sensors.spring_m[i]);
                let expected_mm = if i == 0 { 0.3 } else { 0.0 };
                assert!(
                    (more_mm - expected_mm).abs() < 0.05,
                    "spring {}: {more_mm} mm",
                    i + 1
                );
            }
            compared += 1;
        }
        assert!(compared > 90, "{compared}");
        for path in [one, two] {
            std::fs::remove_file(path).unwrap();
        }
    }
}
