//! The folders of the person who runs the program, and where the program's own data lie.

use std::path::PathBuf;

use directories::ProjectDirs;
use springtwin::recording::RollingFolder;

/// Where settings, calibrations, reports and recordings of this user are kept; `None` for one without a home.
///
/// `$XDG_DATA_HOME/springtwin` or `~/.local/share/springtwin`; on macOS `~/Library/Application Support/springtwin`, on
/// Windows `%APPDATA%\springtwin\data`.
pub fn data_folder() -> Option<PathBuf> {
    ProjectDirs::from("", "", "springtwin").map(|of_program| of_program.data_dir().to_owned())
}

/// Where recordings go unless another folder was chosen; `recordings` where the program was started for a user
/// without a data folder.
pub fn recordings_folder() -> PathBuf {
    match data_folder() {
        Some(data) => data.join("recordings"),
        None => PathBuf::from("recordings"),
    }
}

/// Folder of rolling recordings in that of the user's data.
pub const ROLLING: &str = "rolling";

/// Where rolling recordings go; `None` for a user without a data folder.
pub fn rolling_folder() -> Option<RollingFolder> {
    data_folder().map(|data| RollingFolder::of(data.join(ROLLING)))
}
