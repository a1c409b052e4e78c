//! The baseline that ships with the program: of the virtual rig in order, as a window without options starts with it (simulated).
//!
//! `assets/baselines/virtual-rig.toml.zst` holds the text of a [`Commissioned`] rig, compressed (Zstandard). It is what
//!
//! ```text
//! springtwin excite --seconds 90 --record healthy.rrd
//! springtwin gap commission healthy.rrd --baseline virtual-rig.toml
//! ```
//!
//! give, with a name and a hash of its session that do not depend on the day, and is made again by
//!
//! ```text
//! SPRINGTWIN_WRITE_ASSETS=1 cargo test --lib shipped_baseline
//! ```

use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result};
use sha2::{Digest, Sha256};

use crate::calibrate::same;
use crate::gap::{Commissioned, recorded_with};
use crate::recording::write_text;
use crate::rig::inertial::InertialErrors;
use crate::rig::{RigOptions, Unit};
use crate::robot::RobotSpec;
use crate::sensing::Calibration;
use crate::signal::hex;
use crate::twin::Watch;

const SHIPPED: &[u8] = include_bytes!("../../assets/baselines/virtual-rig.toml.zst");
/// Name of its session.
pub const SESSION: &str = "the virtual rig in order";

/// Whether the shipped baseline is of this virtual rig in order, read by `calibration`. What is hidden in the rig does not count:
/// the baseline is what the rig is compared with.
pub fn is_of(robot: &RobotSpec, options: &RigOptions, calibration: &Calibration) -> bool {
    recorded_with(robot, SESSION, &RobotSpec::reference().hash).is_ok()
        && options.unit == Unit::default()
        && options.inertial == InertialErrors::default()
        && same(calibration, &Calibration::virtual_rig())
}

/// The shipped baseline.
///
/// # Errors
/// When it cannot be read, which a test excludes.
pub fn shipped() -> Result<Commissioned> {
    Ok(Commissioned::from_toml(&text()?)?)
}

/// The monitor of this virtual rig with the shipped baseline; `None` where that is of another one.
///
/// # Errors
/// When the baseline cannot be read.
pub fn watch(
    robot: &RobotSpec,
    options: &RigOptions,
    calibration: &Calibration,
) -> Result<Option<Watch>> {
    match is_of(robot, options, calibration) {
        true => Ok(Some(Watch::new(robot, shipped()?)?)),
        false => Ok(None),
    }
}

/// The shipped baseline as a file in `folder`, where it is written if need be.
///
/// # Errors
/// When the file cannot be written.
pub fn shipped_file(folder: &Path) -> Result<PathBuf> {
    let hash = hex(&Sha256::digest(SHIPPED));
    let start: String = hash.chars().take(12).collect();
    let path = folder.join(format!("shipped-{start}.toml"));
    let text = text()?;
    if std::fs::read_to_string(&path).is_ok_and(|there| there == text) {
        return Ok(path);
    }
    std::fs::create_dir_all(folder)
        .with_context(|| format!("cannot make the folder {}", folder.display()))?;
    write_text(&path, &text)?;
    Ok(path)
}

fn text() -> Result<String> {
    let bytes = zstd::decode_all(SHIPPED).context("the shipped baseline does not decompress")?;
    String::from_utf8(bytes).context("the shipped baseline is no text")
}

#[cfg(test)]
mod tests {
    use std::ops::ControlFlow;
    use std::sync::Arc;

    use super::*;
    use crate::drive::{TwinBuilder, rig_options};
    use crate::gap::Patch;
    use crate::lab::gap_files;
    use crate::lab::session::{Drive, Excitation};
    use crate::rig::hidden::Hidden;
    use crate::robot::REFERENCE;
    use crate::signal::{Disagreement, Snapshot};
    use crate::task::Plan;
    use crate::twin::{Command, Event};

    /// What the two commands give.
    #[cfg(feature = "rrd")]
    fn made() -> Commissioned {
        use crate::drive::{Drive as Driving, Resets, drive};
        use crate::gap::{Grid, Unwatched};
        use crate::lab::commission;
        let robot = RobotSpec::reference();
        let name = format!("springtwin-shipped-baseline-{}.rrd", std::process::id());
        let record = std::env::temp_dir().join(name);
        let excited = Drive::new(Excitation::Mixed, &robot, 1, 90.0);
        let programme = excited.programme().clone();
        let plan = Driving {
            seconds: programme.seconds + 120.0,
            plan: Plan::excite(programme),
            declared_kg: 0.0,
            after_s: 2.0,
            record: Some(record.clone()),
            note: String::new(),
            reset: Resets::default(),
        };
        let driven = drive(TwinBuilder::new(&robot), &plan, None).expect("the rig is driven");
        assert!(driven.finished_s.is_some(), "{:?}", driven.refused);
        let mut session = gap_files::read_session(&record).expect("it was recorded");
        std::fs::remove_file(&record).expect("cleans up");
        SESSION.clone_into(&mut session.name);
        // The file's own hash is that of the day, too.
        session.hash = {
            let mut hash = Sha256::new();
            for (t, pa) in session.t_s.iter().zip(&session.chamber_pa) {
                hash.update(t.to_le_bytes());
                pa.iter().for_each(|p| hash.update(p.to_le_bytes()));
            }
            hex(&hash.finalize())
        };
        let grid = Grid::new(session).expect("a session");
        let rig = Commissioned::new(&robot, &[grid], &Unwatched).expect("the model follows it");
        let kinds = commission::kinds(&rig.arm.floor);
        assert_eq!(commission::beyond(&kinds, |k| k.warn), None);
        rig
    }

    #[cfg(feature = "rrd")]
    #[test]
    fn the_shipped_baseline_is_what_the_virtual_rig_gives() {
        const FILE: &str = concat!(
            env!("CARGO_MANIFEST_DIR"),
            "/assets/baselines/virtual-rig.toml.zst"
        );
        let made = made();
        if std::env::var_os("SPRINGTWIN_WRITE_ASSETS").is_some() {
            let packed = zstd::encode_all(made.to_toml().as_bytes(), 22).expect("compresses");
            std::fs::write(FILE, packed).expect("writes");
        }
        let bytes = std::fs::read(FILE).expect("is there");
        assert!(bytes.len() <= 300_000, "{} bytes", bytes.len());
        let text = zstd::decode_all(&bytes[..]).expect("decompresses");
        let shipped = Commissioned::from_toml(&String::from_utf8(text).expect("a text"));
        let shipped = shipped.expect("reads");
        assert_eq!(shipped.robot, RobotSpec::reference().hash);
        assert_eq!(shipped.present, made.present);
        assert!(shipped.present.iter().all(|p| *p) && shipped.supply.is_some());
        let count = |r: &Commissioned| r.arm.healthy.as_ref().map_or(0, Vec::len);
        assert!(count(&made) > 900, "{}", count(&made));
        assert_eq!(count(&shipped), count(&made));
        // Other processors round otherwise.
        for (i, (a, b)) in shipped.arm.values.iter().zip(&made.arm.values).enumerate() {
            let sd = made.arm.covariance[(i, i)].max(0.0).sqrt();
            assert!(
                (a - b).abs() <= 0.05 * sd + 1e-9,
                "parameter {i}: {a} for {b} ± {sd}"
            );
        }
        for (c, (a, b)) in shipped
            .arm
            .channel_floor
            .iter()
            .zip(&made.arm.channel_floor)
            .enumerate()
        {
            assert!((a - b).abs() <= 0.01 * b, "channel {c}: {a} for {b}");
        }
    }

    /// The verdicts on a rig with this hidden in it, which rests for 25 s and is then moved.
    fn watched(robot: &RobotSpec, hidden: Vec<Hidden>) -> Vec<Disagreement> {
        let mut options = rig_options(0.0, 7);
        options.hidden = hidden;
        let calibration = Calibration::virtual_rig();
        let watch = watch(robot, &options, &calibration).expect("reads");
        let twin = TwinBuilder::new(robot).rig("sim", options).watch(watch);
        let mut driver = twin.build().expect("a rig");
        let mut seen: Vec<Disagreement> = Vec::new();
        let programme = Drive::new(Excitation::Mixed, robot, 9, 45.0)
            .programme()
            .clone();
        let mut ticks = 0;
        let mut look = |s: &Arc<Snapshot>, _: &[Event], commands: &mut Vec<Command>| {
            ticks += 1;
            assert!(s.is_monitored, "from the first tick on");
            if let Some(d) = &s.disagreement
                && seen.last().is_none_or(|last| last.t_s < d.t_s)
            {
                seen.push(d.clone());
            }
            if ticks == 2500 {
                commands.extend([
                    Command::Arm,
                    Command::Start(Plan::excite(programme.clone())),
                ]);
            }
            match ticks < 7500 {
                true => ControlFlow::Continue(()),
                false => ControlFlow::Break(()),
            }
        };
        driver.run(&mut [&mut look]);
        seen
    }

    #[test]
    fn a_fresh_start_agrees_and_a_hidden_effect_disagrees_with_the_same_baseline() {
        let robot = RobotSpec::reference();
        let seen = watched(&robot, Vec::new());
        assert!(seen.len() > 50, "{}", seen.len());
        assert!(seen[0].t_s < 16.0, "{}", seen[0].t_s);
        let worst = seen.iter().map(|d| d.ratio).fold(0.0, f64::max);
        assert!(worst < 1.0, "{worst}");
        let load = Hidden::new("payload", None, &[0.5, 0.0]).expect("can be hidden");
        let seen = watched(&robot, vec![load]);
        let last = seen.last().expect("verdicts");
        assert!(last.is_off(), "{last:?}");
    }

    /// Its readings are corrected by the patch, and the model has the error, too: it must not count twice.
    #[test]
    fn a_sensor_error_that_is_patched_disagrees_no_longer() {
        let robot = RobotSpec::reference();
        let wrong = Hidden::new("spring-calibration", Some(3), &[1.06, 2e-3]);
        let hidden = vec![wrong.expect("can be hidden")];
        let before = watched(&robot, hidden.clone());
        assert!(before.last().expect("verdicts").is_off());
        let patch = format!(
            "version = 1\nname = \"spring 4\"\nrobot = \"{}\"\n[[effects]]\nid = \"spring-calibration\"\ntarget = 4\n\
             [effects.params]\ngain = {{ value = 1.06, unit = \"\" }}\noffset = {{ value = 0.002, unit = \"m\" }}\n",
            robot.hash
        );
        let patch = Patch::from_toml(&patch).expect("reads");
        let after = watched(&robot.patched(patch), hidden);
        let worst = after.iter().map(|d| d.ratio).fold(0.0, f64::max);
        assert!(after.len() > 50 && worst < 1.0, "{} {worst}", after.len());
    }

    #[test]
    fn it_is_of_no_other_robot_unit_or_calibration() {
        let (robot, calibration) = (RobotSpec::reference(), Calibration::virtual_rig());
        let options = rig_options(0.0, 1);
        assert!(is_of(&robot, &options, &calibration));
        // A name and a date read nothing.
        let renamed = Calibration {
            name: "mine".to_owned(),
            date: "2026-01-01".to_owned(),
            ..calibration.clone()
        };
        assert!(is_of(&robot, &rig_options(0.2, 5), &renamed));
        let mut other = calibration.clone();
        other.base_tilt_rad[0] += 1e-3;
        assert!(!is_of(&robot, &options, &other));
        let mut unit = options.clone();
        unit.unit = Unit(2);
        assert!(!is_of(&robot, &unit, &calibration));
        let text = REFERENCE.replace("rest_length_mm = 145.0", "rest_length_mm = 146.0");
        let longer = RobotSpec::from_toml(&text).expect("reads");
        assert!(!is_of(&longer, &options, &calibration));
    }

    #[test]
    fn it_is_a_file_where_one_is_needed() {
        let id = std::process::id();
        let folder = std::env::temp_dir().join(format!("springtwin-shipped-{id}"));
        let path = shipped_file(&folder).expect("writes");
        let read = gap_files::read_baseline(&path)
            .expect("reads")
            .expect("a baseline");
        assert_eq!(read.to_toml(), shipped().expect("reads").to_toml());
        std::fs::write(&path, "cut").expect("writes");
        assert_eq!(shipped_file(&folder).expect("again"), path);
        assert!(gap_files::read_baseline(&path).expect("reads").is_some());
        std::fs::remove_dir_all(&folder).expect("cleans up");
    }
}
