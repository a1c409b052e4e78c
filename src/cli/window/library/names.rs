//! What recordings are called: the local date and time at which they began.

use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use jiff::Timestamp;
use jiff::civil::DateTime;
use jiff::tz::TimeZone;
use springtwin::gui::services::Begun;

/// Characters of a date and time in a name.
const LENGTH_OF_DATE: usize = "2026-11-23_14-05-12".len();

/// How many recordings may begin within a second.
const PER_SECOND: usize = 1000;

/// Most characters of what the operator calls a new recording.
const LONGEST: usize = 48;

/// How the date and time stand in a name.
const DATED: &str = "%Y-%m-%d_%H-%M-%S";

/// What a typed name becomes in the name of a file: letters, digits and `_` stay, everything else is a `-`.
pub fn safe(name: &str) -> String {
    let mut safe = String::new();
    for c in name.chars() {
        match c.is_alphanumeric() || c == '_' {
            true => safe.push(c),
            false if !safe.ends_with('-') => safe.push('-'),
            false => {}
        }
    }
    safe.trim_matches('-').to_owned()
}

/// A new and empty file in `folder`, named after a local time and what the operator calls it:
/// `2026-11-23_14-05-12_leak-test.rrd`, without a name `2026-11-23_14-05-12.rrd`, the next one in the same second
/// `2026-11-23_14-05-12-2.rrd`. The folder is made when it is missing. The file keeps other windows from taking the name.
pub fn fresh(folder: &Path, local: DateTime, name: &str) -> Result<PathBuf, String> {
    let folder = std::path::absolute(folder).unwrap_or_else(|_| folder.to_owned());
    std::fs::create_dir_all(&folder).map_err(|e| {
        format!(
            "The folder {} for recordings cannot be made ({e}): choose another one.",
            folder.display()
        )
    })?;
    let date = local.strftime(DATED).to_string();
    let name: String = name.trim().chars().take(LONGEST).collect();
    let stem = match safe(&name) {
        name if name.is_empty() => date,
        name => format!("{date}_{name}"),
    };
    let names = std::iter::once(format!("{stem}.rrd"))
        .chain((2..PER_SECOND).map(|n| format!("{stem}-{n}.rrd")));
    for path in names.map(|name| folder.join(name)) {
        match std::fs::File::create_new(&path) {
            Ok(_) => return Ok(path),
            Err(e) if e.kind() == ErrorKind::AlreadyExists => {}
            Err(e) => {
                return Err(format!(
                    "The recording {} cannot be made ({e}): choose another folder.",
                    path.display()
                ));
            }
        }
    }
    Err(format!(
        "{} holds too many recordings of this second: choose another folder.",
        folder.display()
    ))
}

/// The name on screen of a file. Programs before this one named recordings by seconds since 1970,
/// `session-1763906712`: those get their date in front.
pub fn shown(stem: &str, zone: &TimeZone) -> String {
    match since_1970(stem) {
        Some(at) => {
            let local = zone.to_datetime(at);
            format!("{} ({stem})", local.strftime(DATED))
        }
        None => stem.to_owned(),
    }
}

fn since_1970(stem: &str) -> Option<Timestamp> {
    let rest = stem.strip_prefix("session-")?;
    let seconds = rest.split('-').next()?.parse::<i64>().ok()?;
    Timestamp::from_second(seconds).ok()
}

/// When a recording began: as it was recorded, else by the name of its file.
pub fn begun(recorded: &str, stem: &str, zone: &TimeZone) -> Option<Begun> {
    let by_name = || {
        let date = stem.get(..LENGTH_OF_DATE)?;
        let local = DateTime::strptime(DATED, date).ok()?;
        zone.to_timestamp(local).ok()
    };
    let recorded = recorded.parse::<Timestamp>().ok();
    let at = recorded.or_else(|| since_1970(stem)).or_else(by_name)?;
    Some(Begun {
        unix_s: at.as_second(),
        local: minute(zone.to_datetime(at)),
    })
}

/// A local date and time to the minute, as lists show it.
pub fn minute(local: DateTime) -> String {
    local.strftime("%Y-%m-%d %H:%M").to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_of_seconds_since_1970_is_shown_with_its_date() {
        let zone = TimeZone::fixed(jiff::tz::offset(2));
        for (stem, name) in [
            (
                "session-1763906712",
                "2025-11-23_16-05-12 (session-1763906712)",
            ),
            (
                "session-1763906712-4711",
                "2025-11-23_16-05-12 (session-1763906712-4711)",
            ),
            ("session-a", "session-a"),
            ("point-to-point", "point-to-point"),
            ("2026-11-23_14-05-12", "2026-11-23_14-05-12"),
        ] {
            assert_eq!(shown(stem, &zone), name);
        }
    }

    #[test]
    fn a_folder_that_cannot_be_made_is_named() {
        let file = std::env::current_exe().expect("this program");
        let at = DateTime::default();
        let e = fresh(&file.join("recordings"), at, "").expect_err("a file's folder");
        assert!(e.contains(&*file.display().to_string()), "{e}");
        assert!(e.ends_with("choose another one."), "{e}");
    }

    #[test]
    fn a_typed_name_stands_behind_the_date_in_safe_characters() {
        let folder = std::env::temp_dir().join(format!("springtwin-named-{}", std::process::id()));
        let at: DateTime = "2026-11-23T14:05:12".parse().expect("a time");
        let made: Vec<String> = ["  leak test/3: ../x ", "", "../..", "", &"n".repeat(90)]
            .iter()
            .map(|name| {
                let path = fresh(&folder, at, name).expect("made");
                assert_eq!(path.parent(), Some(folder.as_path()));
                path.file_name().expect("a file").to_string_lossy().into()
            })
            .collect();
        std::fs::remove_dir_all(&folder).expect("removed");
        assert_eq!(
            made[..4],
            [
                "2026-11-23_14-05-12_leak-test-3-x.rrd",
                "2026-11-23_14-05-12.rrd",
                "2026-11-23_14-05-12-2.rrd",
                "2026-11-23_14-05-12-3.rrd",
            ]
        );
        assert_eq!(made[4].len(), "2026-11-23_14-05-12_.rrd".len() + LONGEST);
    }

    #[test]
    fn the_date_is_the_recorded_one_else_that_of_the_name() {
        let zone = TimeZone::fixed(jiff::tz::offset(2));
        let local = |recorded: &str, stem: &str| begun(recorded, stem, &zone).map(|b| b.local);
        let recorded = "2026-11-23T14:05:12+01:00";
        assert_eq!(local(recorded, "x").as_deref(), Some("2026-11-23 15:05"));
        for (stem, expected) in [
            ("2026-11-23_14-05-12_leak", Some("2026-11-23 14:05")),
            ("session-1763906712-77", Some("2025-11-23 16:05")),
            ("point-to-point", None),
            ("ünicöde-is-no-boundary", None),
        ] {
            assert_eq!(local("", stem).as_deref(), expected, "{stem}");
        }
        assert!(begun("", "2026-11-23_14-05-12", &zone) < begun("", "2026-11-23_14-05-13", &zone));
    }
}
