//! What recordings are called: the local date and time at which they began.

use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use jiff::Timestamp;
use jiff::civil::DateTime;
use jiff::tz::TimeZone;

/// How many recordings may begin within a second.
const PER_SECOND: usize = 1000;

/// A new and empty file in `folder`, named after a local time: `2026-11-23_14-05-12.rrd`, the next one in the same
/// second `2026-11-23_14-05-12-2.rrd`. The folder is made when it is missing. The file keeps other windows from taking
/// the name.
pub fn fresh(folder: &Path, local: DateTime) -> Result<PathBuf, String> {
    let folder = std::path::absolute(folder).unwrap_or_else(|_| folder.to_owned());
    std::fs::create_dir_all(&folder).map_err(|e| {
        format!(
            "The folder {} for recordings cannot be made ({e}): choose another one.",
            folder.display()
        )
    })?;
    let stem = local.strftime("%Y-%m-%d_%H-%M-%S").to_string();
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
    let seconds = stem.strip_prefix("session-").and_then(|rest| {
        let digits = rest.split('-').next()?;
        digits.parse::<i64>().ok()
    });
    let at = seconds.and_then(|s| Timestamp::from_second(s).ok());
    match at {
        Some(at) => {
            let local = zone.to_datetime(at);
            format!("{} ({stem})", local.strftime("%Y-%m-%d_%H-%M-%S"))
        }
        None => stem.to_owned(),
    }
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
        let e = fresh(&file.join("recordings"), DateTime::default()).expect_err("a file's folder");
        assert!(e.contains(&*file.display().to_string()), "{e}");
        assert!(e.ends_with("choose another one."), "{e}");
    }
}
