//! Checks of robot, networks, ports, viewer and folders before work begins.

use std::path::Path;

use crate::drive::model;
use crate::robot::RobotSpec;

/// A check and its result.
#[derive(Clone, Debug)]
pub struct Check {
    /// What was checked.
    pub name: &'static str,
    /// Whether it is in order.
    pub ok: bool,
    /// What was found, and what to do.
    pub says: String,
}

/// All checks that need no screen; recordings go to `folder`.
pub fn checks(robot: &RobotSpec, folder: &Path) -> Vec<Check> {
    vec![
        patches(robot),
        networks(robot),
        calibration(robot),
        ports(),
        viewer(),
        recordings(folder),
    ]
}

fn patches(robot: &RobotSpec) -> Check {
    let names: Vec<&str> = robot.patches.iter().map(|a| &*a.patch.name).collect();
    Check {
        name: "patches",
        ok: true,
        says: match names.len() {
            0 => "the robot file carries no patch".to_owned(),
            n => format!("the robot file carries {n}: {}", names.join("; ")),
        },
    }
}

fn networks(robot: &RobotSpec) -> Check {
    let (ok, says) = match model::model(None) {
        Ok(m) => match model::trained_for_another(&m, robot) {
            None => (true, "the networks belong to this robot file".to_owned()),
            Some(notice) => (false, notice.to_owned()),
        },
        Err(e) => (false, format!("{e:#}")),
    };
    Check {
        name: "networks",
        ok,
        says,
    }
}

fn calibration(robot: &RobotSpec) -> Check {
    let (ok, says) = match model::sensing(robot, None) {
        Ok(_) => (true, "the virtual rig's calibration loads".to_owned()),
        Err(e) => (false, format!("{e:#}")),
    };
    Check {
        name: "calibration",
        ok,
        says,
    }
}

fn ports() -> Check {
    let says = match crate::link::ports::list() {
        Err(e) => format!("the system does not list its serial ports: {e}"),
        Ok(found) if found.is_empty() => {
            "no serial port: connect the boards, or use the virtual rig".to_owned()
        }
        Ok(found) => {
            let names: Vec<&str> = found.iter().map(|p| p.name.as_str()).collect();
            names.join(", ")
        }
    };
    // The virtual rig needs none.
    Check {
        name: "ports",
        ok: true,
        says,
    }
}

fn viewer() -> Check {
    let found = std::process::Command::new("rerun")
        .arg("--version")
        .output();
    let (ok, says) = match found {
        Ok(out) => (true, String::from_utf8_lossy(&out.stdout).lines().next().unwrap_or("found").to_owned()),
        Err(_) => (false, "the Rerun viewer is not installed (only needed for Open in Rerun): pip install rerun-sdk==0.36.3".to_owned()),
    };
    Check {
        name: "viewer",
        ok,
        says,
    }
}

fn recordings(folder: &Path) -> Check {
    let (ok, says) = writable(folder);
    Check {
        name: "recordings",
        ok,
        says,
    }
}

/// Whether recordings can be made in a folder, or where it will be made.
fn writable(folder: &Path) -> (bool, String) {
    let shown = folder.display();
    let absolute = std::path::absolute(folder).unwrap_or_else(|_| folder.to_owned());
    let Some(there) = absolute.ancestors().find(|dir| dir.exists()) else {
        return (false, format!("there is no disk for the folder {shown}"));
    };
    if !may_write(there) {
        let why = match there == absolute {
            true => "it cannot be written".to_owned(),
            false => format!("it cannot be made in {}", there.display()),
        };
        return (
            false,
            format!(
                "the folder {shown}: {why}; give yourself the right to, or choose another in the window"
            ),
        );
    }
    match there == absolute {
        true => (true, format!("they go to {shown}")),
        false => (
            true,
            format!("they go to {shown}, which is made with the first one"),
        ),
    }
}

#[cfg(unix)]
fn may_write(folder: &Path) -> bool {
    use nix::unistd::{AccessFlags, access};
    folder.is_dir() && access(folder, AccessFlags::W_OK).is_ok()
}

#[cfg(not(unix))]
fn may_write(folder: &Path) -> bool {
    std::fs::metadata(folder).is_ok_and(|m| m.is_dir() && !m.permissions().readonly())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn recordings_need_a_folder_that_is_there_or_can_be_made() {
        let name = format!("springtwin-doctor-{}", std::process::id());
        let home = std::env::temp_dir().join(name);
        std::fs::create_dir_all(&home).expect("a folder");
        let (ok, says) = writable(&home);
        assert!(ok && says.ends_with(&*home.display().to_string()), "{says}");
        let (ok, says) = writable(&home.join("a/recordings"));
        assert!(
            ok && says.ends_with("which is made with the first one"),
            "{says}"
        );
        let file = home.join("file");
        std::fs::write(&file, "").expect("writes");
        let (ok, says) = writable(&file.join("recordings"));
        std::fs::remove_dir_all(&home).expect("removed");
        assert!(!ok && says.contains("it cannot be made in"), "{says}");
    }
}
