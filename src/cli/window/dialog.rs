//! The system's own file dialogs, where there are any.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use springtwin::gui::services::{Dialog, DialogKind, Picked};

/// Nobody cancels a dialog faster than this: one that is over sooner was never shown.
const SHOWN: Duration = Duration::from_millis(400);

/// Asks for a path in the system's own dialog. Waits for the operator.
pub fn ask(dialog: Dialog) -> Picked {
    if !is_there() {
        return Picked::NoDialog;
    }
    let mut native = rfd::FileDialog::new().set_title(dialog.title);
    if let Some((name, extensions)) = dialog.filter {
        native = native.add_filter(name, &extensions);
    }
    #[expect(
        clippy::disallowed_methods,
        reason = "whether a dialog was shown follows from how long it was open"
    )]
    let begun = Instant::now();
    let chosen = match dialog.kind {
        DialogKind::Open => native.pick_file(),
        DialogKind::Save => native.set_file_name(dialog.name).save_file(),
        DialogKind::Folder => native.pick_folder(),
    };
    match chosen {
        Some(path) => Picked::Path(path),
        None if cfg!(target_os = "linux") && begun.elapsed() < SHOWN => Picked::NoDialog,
        None => Picked::Cancelled,
    }
}

/// Whether somebody could show a dialog. On Linux that is the desktop portal on the session's bus, else the program
/// zenity.
fn is_there() -> bool {
    if !cfg!(target_os = "linux") {
        return true;
    }
    let var = |name: &str| std::env::var_os(name).filter(|v| !v.is_empty());
    let folders = |list: Option<std::ffi::OsString>| -> Vec<PathBuf> {
        list.map_or_else(Vec::new, |l| std::env::split_paths(&l).collect())
    };
    let bus = var("DBUS_SESSION_BUS_ADDRESS").is_some()
        || var("XDG_RUNTIME_DIR").is_some_and(|dir| Path::new(&dir).join("bus").exists());
    let data = var("XDG_DATA_DIRS").unwrap_or_else(|| "/usr/local/share:/usr/share".into());
    let portal = "dbus-1/services/org.freedesktop.portal.Desktop.service";
    let has_portal = bus
        && folders(Some(data))
            .iter()
            .any(|dir| dir.join(portal).exists());
    has_portal
        || folders(var("PATH"))
            .iter()
            .any(|dir| dir.join("zenity").is_file())
}
