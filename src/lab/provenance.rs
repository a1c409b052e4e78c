//! Whether recordings that are used together were made alike.

use std::path::{Path, PathBuf};

use anyhow::Result;

use crate::recording::{RecordingFile, RecordingMeta, is_rrd, is_simulated, part_of};
use crate::sensing::Calibration;
use crate::sensing::registration::Registration;
use crate::signal::{IMUS, SPRINGS};

const ROBOT_FILE: &str = "robot file";
const CALIBRATION: &str = "calibration";
const REGISTRATION: &str = "registration of motion capture";
/// Differences with which the same arm in the same pose has other readings.
const CHANGES_READINGS: [&str; 3] = [ROBOT_FILE, CALIBRATION, REGISTRATION];

/// How a recording was made; `None` for sessions from tables, which do not state it.
///
/// # Errors
/// When the recording cannot be opened.
fn provenance(path: &Path) -> Result<Option<RecordingMeta>> {
    let (path, _) = part_of(path)?;
    Ok(match is_rrd(&path) {
        true => Some(RecordingFile::open(&path)?.meta().clone()),
        false => None,
    })
}

/// Whether any of these recordings and sessions states that it is simulated.
///
/// # Errors
/// When one cannot be opened.
pub fn any_simulated<'a>(paths: impl IntoIterator<Item = &'a PathBuf>) -> Result<bool> {
    for path in paths {
        if is_simulated(path)? == Some(true) {
            return Ok(true);
        }
    }
    Ok(false)
}

/// What differs between a recording and the one that it is used with, as far as both state it. Each has a name for the
/// messages, such as `the baseline`. The task that moved the arm, its controller and the version of the program may
/// differ.
///
/// # Errors
/// When a recording cannot be opened, and when the two are not of the same arm: one is simulated, or their boards are those
/// of different arms.
fn differences(first: (&str, &Path), second: (&str, &Path)) -> Result<Vec<String>> {
    match (provenance(first.1)?, provenance(second.1)?) {
        (Some(one), Some(other)) => between((first.0, &one), (second.0, &other)),
        _ => Ok(Vec::new()),
    }
}

/// What differs between the baselines and the sessions of the gap finder, and the same as a note (`None` if nothing does).
/// Each is compared with the first baseline.
///
/// # Errors
/// When a recording cannot be opened, and when they are not of the same arm.
pub fn of_gap<'a>(
    baselines: impl IntoIterator<Item = &'a Path>,
    sessions: impl IntoIterator<Item = &'a Path>,
) -> Result<(Vec<String>, Option<String>)> {
    let mut baselines = baselines.into_iter();
    let Some(first) = baselines.next() else {
        return Ok((Vec::new(), None));
    };
    let mut found = Vec::new();
    let others = baselines.map(|b| ("another baseline", b));
    for other in others.chain(sessions.into_iter().map(|s| ("the session", s))) {
        for difference in differences(("the baseline", first), other)? {
            if !found.contains(&difference) {
                found.push(difference);
            }
        }
    }
    let note = (!found.is_empty()).then(|| {
        let mut note = format!("different in the session: {}", found.join("; "));
        if found
            .iter()
            .any(|d| CHANGES_READINGS.iter().any(|c| d.starts_with(c)))
        {
            note += ". Readings that were made differently are by themselves a gap";
        }
        note
    });
    Ok((found, note))
}

/// What differs between recordings that networks are trained on, a line for each that is unlike the first one.
///
/// # Errors
/// When a recording cannot be opened, and when they are not of the same arm and robot file.
pub fn of_training(paths: &[PathBuf]) -> Result<Vec<String>> {
    let mut first: Option<(String, RecordingMeta)> = None;
    let mut lines = Vec::new();
    for path in paths {
        let Some(meta) = provenance(path)? else {
            continue;
        };
        let name = path.display().to_string();
        let Some((first_name, first)) = &first else {
            first = Some((name, meta));
            continue;
        };
        let found = between((first_name, first), (&name, &meta))?;
        anyhow::ensure!(
            !found.iter().any(|d| d == ROBOT_FILE),
            "{first_name} and {name} were recorded with different robot files: networks belong to one robot file"
        );
        if !found.is_empty() {
            lines.push(format!(
                "different in {name} than in {first_name}: {}",
                found.join("; ")
            ));
        }
    }
    Ok(lines)
}

/// What differs between a recording and the networks that its poses are estimated with.
///
/// # Errors
/// When the recording cannot be opened.
pub fn of_estimate(session: &Path, networks: &str) -> Result<Vec<String>> {
    let recorded = provenance(session)?.map_or_else(String::new, |m| m.networks);
    let same = recorded.is_empty() || networks.is_empty() || recorded == networks;
    Ok(match same {
        true => Vec::new(),
        false => vec![networks_differ(&recorded, networks)],
    })
}

fn networks_differ(one: &str, other: &str) -> String {
    let [one, other] = [one, other].map(|hash| hash.chars().take(12).collect::<String>());
    format!("networks ({other}, not {one})")
}

fn between(
    (one_name, one): (&str, &RecordingMeta),
    (other_name, other): (&str, &RecordingMeta),
) -> Result<Vec<String>> {
    let origin = |simulated| match simulated {
        true => "simulated",
        false => "measured",
    };
    if let (Some(a), Some(b)) = (one.simulated, other.simulated)
        && a != b
    {
        anyhow::bail!(
            "{one_name} is {}, {other_name} is {}: use recordings of one arm",
            origin(a),
            origin(b)
        );
    }
    if let (Some(a), Some(b)) = (arm(one), arm(other))
        && a != b
    {
        anyhow::bail!(
            "{one_name} was recorded on the arm with boards {a}, {other_name} on the one with boards {b}: use recordings of \
             one arm"
        );
    }
    let mut found = Vec::new();
    let known = |of: fn(&RecordingMeta) -> &str| !of(one).is_empty() && !of(other).is_empty();
    if known(|m| &m.robot_hash) && one.robot_hash != other.robot_hash {
        found.push(ROBOT_FILE.to_owned());
    }
    if known(|m| &m.calibration) {
        found.extend(calibration(&one.calibration, &other.calibration));
    }
    if !same_registration(one, other) {
        found.push(REGISTRATION.to_owned());
    }
    if known(|m| &m.networks) && one.networks != other.networks {
        found.push(networks_differ(&one.networks, &other.networks));
    }
    if known(|m| &m.firmware) && one.firmware != other.firmware {
        found.push(format!("boards ({}, not {})", other.firmware, one.firmware));
    }
    Ok(found)
}

/// Numbers of the arm at the boards that state one: `1/1`.
fn arm(meta: &RecordingMeta) -> Option<&str> {
    let (_, arm) = meta.firmware.rsplit_once("arm ")?;
    (!arm.is_empty() && !arm.contains('-')).then_some(arm)
}

/// Which parts of two calibrations (TOML) differ; names, dates and qualities of fits do not count.
fn calibration(one: &str, other: &str) -> Option<String> {
    if one == other {
        return None;
    }
    let (Ok(a), Ok(b)) = (Calibration::from_toml(one), Calibration::from_toml(other)) else {
        return Some(CALIBRATION.to_owned());
    };
    let springs = numbers(SPRINGS, |i| {
        let [a, b] = [&a, &b].map(|c| {
            let spring = c.springs.iter().find(|s| s.spring == i + 1);
            spring.map(|s| (s.capacitance_f, s.compensation_h, &s.curve, s.ends_off_m))
        });
        a != b
    });
    let imus = numbers(IMUS, |i| {
        a.mounting(i) != b.mounting(i) || a.imu_zero(i) != b.imu_zero(i)
    });
    let mut parts = Vec::new();
    parts.extend(springs.map(|n| format!("springs {n}")));
    parts.extend(imus.map(|n| format!("IMUs {n}")));
    if a.base_tilt_rad != b.base_tilt_rad {
        parts.push("the base's tilt".to_owned());
    }
    (!parts.is_empty()).then(|| format!("{CALIBRATION} of {}", parts.join(", ")))
}

/// The numbers, from 1, of those that differ; `all` when all do.
fn numbers(of: usize, differs: impl Fn(usize) -> bool) -> Option<String> {
    let them: Vec<String> = (0..of)
        .filter(|i| differs(*i))
        .map(|i| (i + 1).to_string())
        .collect();
    match them.len() {
        0 => None,
        n if n == of => Some("(all)".to_owned()),
        _ => Some(them.join(", ")),
    }
}

/// Whether motion capture lay on the arm alike; its file's date and quality do not count.
fn same_registration(one: &RecordingMeta, other: &RecordingMeta) -> bool {
    let [a, b] = [one, other].map(|m| Registration::from_toml(&m.registration).ok());
    match (a, b) {
        (Some(a), Some(b)) => {
            let of = |r: &Registration| (r.frames(), r.clock);
            let ((a, a_clock), (b, b_clock)) = (of(&a), of(&b));
            a.base_from_world == b.base_from_world
                && a.object_from_tip == b.object_from_tip
                && a_clock == b_clock
        }
        _ => one.registration == other.registration,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn meta() -> RecordingMeta {
        RecordingMeta {
            robot_hash: "aa".into(),
            simulated: Some(true),
            calibration: Calibration::virtual_rig().to_toml().unwrap(),
            networks: "0123456789abcdef".into(),
            firmware: "protocol 2, arm 1/1".into(),
            ..RecordingMeta::default()
        }
    }

    fn found(other: &RecordingMeta) -> Result<Vec<String>> {
        between(("the baseline", &meta()), ("the session", other))
    }

    #[test]
    fn recordings_of_different_arms_are_refused() {
        let measured = RecordingMeta {
            simulated: Some(false),
            ..meta()
        };
        let text = found(&measured).unwrap_err().to_string();
        assert!(
            text.contains("the baseline is simulated, the session is measured"),
            "{text}"
        );
        let other_arm = RecordingMeta {
            firmware: "protocol 2, arm 2/2".into(),
            ..meta()
        };
        let text = found(&other_arm).unwrap_err().to_string();
        assert!(
            text.contains("boards 1/1") && text.contains("boards 2/2"),
            "{text}"
        );
    }

    #[test]
    fn what_differs_is_listed_and_what_does_not_matter_is_not() {
        let mut calibration = Calibration::virtual_rig();
        calibration.name = "another name".into();
        calibration.date = "another day".into();
        calibration.springs[3].quality.points += 1;
        let renamed = RecordingMeta {
            calibration: calibration.to_toml().unwrap(),
            controller: "another".into(),
            program: "another".into(),
            ..meta()
        };
        assert_ne!(renamed.calibration, meta().calibration);
        assert_eq!(found(&renamed).unwrap(), Vec::<String>::new());
        calibration.springs[2].curve.coefficients_m[0] += 1e-4;
        calibration.springs[8].curve.coefficients_m[0] += 1e-4;
        let mut imu = calibration.imu_entry(1);
        imu.zero.gyro_bias_rad_s.x += 0.01;
        calibration.set_imu(imu).unwrap();
        let other = RecordingMeta {
            robot_hash: "bb".into(),
            calibration: calibration.to_toml().unwrap(),
            registration: "another".into(),
            networks: "fedcba9876543210".into(),
            firmware: "protocol 3, arm 1/-".into(),
            ..meta()
        };
        let all = found(&other).unwrap();
        assert_eq!(
            all,
            [
                "robot file",
                "calibration of springs 3, 9, IMUs 2",
                "registration of motion capture",
                "networks (fedcba987654, not 0123456789ab)",
                "boards (protocol 3, arm 1/-, not protocol 2, arm 1/1)",
            ]
        );
    }

    #[test]
    fn nothing_is_stated_of_what_is_not_known() {
        let unknown = RecordingMeta::default();
        assert_eq!(found(&unknown).unwrap(), Vec::<String>::new());
        let table = Path::new("no/such.csv");
        assert_eq!(
            differences(("a", table), ("b", table)).unwrap(),
            Vec::<String>::new()
        );
    }

    /// A recording of one snapshot.
    #[cfg(feature = "rrd")]
    fn written(name: &str, meta: RecordingMeta) -> PathBuf {
        let name = format!("springtwin-provenance-{name}-{}.rrd", std::process::id());
        let path = std::env::temp_dir().join(name);
        let mut writer = crate::recording::RecordingWriter::create(&path, meta).unwrap();
        writer.push(&crate::signal::Snapshot::default()).unwrap();
        writer.finish().unwrap();
        path
    }

    #[cfg(feature = "rrd")]
    #[test]
    fn the_provenance_of_files_is_compared() {
        let mut calibration = Calibration::virtual_rig();
        calibration.springs[3].curve.coefficients_m[0] += 1e-4;
        let recalibrated = RecordingMeta {
            calibration: calibration.to_toml().unwrap(),
            ..meta()
        };
        let patched = RecordingMeta {
            robot_hash: "bb".into(),
            ..meta()
        };
        let [one, other, patched] = [
            ("one", meta()),
            ("other", recalibrated),
            ("patched", patched),
        ]
        .map(|(name, meta)| written(name, meta));
        let (found, note) = of_gap([&*one], [&*other]).unwrap();
        assert_eq!(found, ["calibration of springs 4"]);
        let note = note.unwrap();
        assert!(
            note.contains("springs 4") && note.contains("by themselves a gap"),
            "{note}"
        );
        assert_eq!(of_gap([&*one], [&*one]).unwrap(), (Vec::new(), None));
        assert_eq!(of_gap([], [&*other]).unwrap(), (Vec::new(), None));
        let part = PathBuf::from(format!("{}@0..1", other.display()));
        let lines = of_training(&[one.clone(), "a.parquet".into(), part]).unwrap();
        assert!(
            lines.len() == 1 && lines[0].ends_with("springs 4"),
            "{lines:?}"
        );
        let text = of_training(&[one.clone(), patched.clone()]).unwrap_err();
        assert!(text.to_string().contains("different robot files"), "{text}");
        assert_eq!(
            of_estimate(&one, "0123456789abcdef").unwrap(),
            Vec::<String>::new()
        );
        let networks = of_estimate(&one, "ff").unwrap();
        assert_eq!(networks, ["networks (ff, not 0123456789ab)"]);
        for path in [one, other, patched] {
            std::fs::remove_file(path).unwrap();
        }
    }
}
