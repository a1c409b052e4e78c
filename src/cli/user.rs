//! The folders of the person who runs the program, and where the program's own data lie.

use std::ffi::OsString;
use std::path::PathBuf;

/// What the program is called in the user's data folder.
const PROGRAM: &str = "springtwin";

/// Where settings, calibrations, reports and recordings of this user are kept; `None` for one without a home.
///
/// `$XDG_DATA_HOME/springtwin` or `~/.local/share/springtwin`; on macOS `~/Library/Application Support/springtwin`, on
/// Windows `%APPDATA%\springtwin\data`.
pub fn data_folder() -> Option<PathBuf> {
    data_folder_of(|name| std::env::var_os(name), std::env::home_dir())
}

fn data_folder_of(
    var: impl Fn(&str) -> Option<OsString>,
    home: Option<PathBuf>,
) -> Option<PathBuf> {
    if cfg!(windows) {
        let roaming = var("APPDATA").map(PathBuf::from);
        return roaming.map(|p| p.join(PROGRAM).join("data"));
    }
    if cfg!(target_os = "macos") {
        return home.map(|p| p.join("Library/Application Support").join(PROGRAM));
    }
    // The specification ignores a path that is relative.
    var("XDG_DATA_HOME")
        .map(PathBuf::from)
        .filter(|p| p.is_absolute())
        .or_else(|| home.map(|p| p.join(".local/share")))
        .map(|p| p.join(PROGRAM))
}

/// Where recordings go unless another folder was chosen; `recordings` where the program was started for a user
/// without a data folder.
pub fn recordings_folder() -> PathBuf {
    match data_folder() {
        Some(data) => data.join("recordings"),
        None => PathBuf::from("recordings"),
    }
}

#[cfg(all(test, unix, not(target_os = "macos")))]
mod tests {
    use super::*;

    #[test]
    fn data_go_where_the_desktop_specification_says() {
        let home = || Some(PathBuf::from("/home/person"));
        let with = |value: Option<&str>| {
            let value = value.map(OsString::from);
            data_folder_of(
                move |name| value.clone().filter(|_| name == "XDG_DATA_HOME"),
                home(),
            )
        };
        let at = |path: &str| Some(PathBuf::from(path));
        assert_eq!(with(None), at("/home/person/.local/share/springtwin"));
        assert_eq!(with(Some("/data")), at("/data/springtwin"));
        assert_eq!(
            with(Some("data")),
            at("/home/person/.local/share/springtwin")
        );
        assert_eq!(data_folder_of(|_| None, None), None);
    }
}
