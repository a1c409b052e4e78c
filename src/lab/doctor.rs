//! Checks of robot, networks, ports, viewer and folders before work begins.

mod machine;

use std::net::SocketAddr;
use std::path::{Path, PathBuf};

use crate::calibrate::{Store, Version};
use crate::drive::model;
use crate::recording::RollingFolder;
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

impl Check {
    fn of(name: &'static str, (ok, says): (bool, String)) -> Self {
        Self { name, ok, says }
    }
}

/// What is checked besides the program itself.
#[derive(Clone, Debug)]
pub struct Places {
    /// The folder of recordings.
    pub recordings: PathBuf,
    /// The folder of rolling recordings; `None` where the user has no data folder.
    pub rolling: Option<RollingFolder>,
    /// The folder of the user's data, with saved calibrations; `None` where there is none.
    pub data: Option<PathBuf>,
    /// The window's log; `None` where the user has no data folder: that fails the check.
    pub log: Option<PathBuf>,
    /// Serial ports to open, separated by commas; `None`: the ports are only listed.
    pub rig: Option<String>,
    /// Where motion capture is received.
    pub mocap: SocketAddr,
}

/// All checks that need no screen.
pub fn checks(robot: &RobotSpec, places: &Places) -> Vec<Check> {
    let mut all = vec![patches(robot), networks(robot), calibration(robot)];
    all.extend(saved(robot, places.data.as_deref()));
    all.extend(machine::ports(places.rig.as_deref()));
    all.extend([
        machine::mocap(places.mocap),
        viewer(),
        machine::recordings(&places.recordings),
        machine::rolling(places.rolling.as_ref()),
        machine::disk(&places.recordings),
        machine::log(places.log.as_deref()),
    ]);
    all
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

/// The calibrations that were saved for this robot, of its virtual rig and of its hardware.
fn saved(robot: &RobotSpec, data: Option<&Path>) -> Vec<Check> {
    let Some(data) = data else {
        return Vec::new();
    };
    let kinds = [
        ("virtual rig", true, "the built-in one is used"),
        (
            "hardware",
            false,
            "calibrate before hardware is armed (springtwin calibrate wizard)",
        ),
    ];
    let check = |(of, is_virtual, without)| {
        let found = match Store::of(robot, is_virtual, data).versions() {
            Ok(versions) => loads(of, &versions, without),
            Err(e) => (false, format!("{of}: {e:#}")),
        };
        Check::of("saved", found)
    };
    kinds.map(check).to_vec()
}

/// Whether all versions load; `without`: what that means where there is none.
fn loads(of: &str, versions: &[Version], without: &str) -> (bool, String) {
    let damaged = versions.iter().find_map(|v| {
        let why = v.kept.as_ref().err()?;
        Some((v.number, why))
    });
    if let Some((number, why)) = damaged {
        let text = format!(
            "{of}: version {number} cannot be read ({}); save a new one, or choose another on the Calibrate screen",
            why.trim_end_matches('.')
        );
        return (false, text);
    }
    let active = versions.iter().find(|v| v.active);
    let text = match active {
        Some(v) => {
            let networks = v.kept.as_ref().ok().and_then(|k| k.with_networks());
            let with = networks.map_or_else(String::new, |text| format!(", {text}"));
            format!(
                "{of}: {} load, version {} is in use{with}",
                versions.len(),
                v.number
            )
        }
        None => format!("{of}: none is saved; {without}"),
    };
    (true, text)
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibrate::NewVersion;
    use crate::sensing::Calibration;

    #[test]
    fn a_saved_calibration_that_is_damaged_is_warned_of() {
        let name = format!("springtwin-doctor-saved-{}", std::process::id());
        let data = std::env::temp_dir().join(name);
        let robot = RobotSpec::reference();
        let store = Store::of(&robot, false, &data);
        let new = NewVersion {
            note: String::new(),
            calibration: Calibration::virtual_rig(),
            registration: None,
            networks: None,
        };
        store.save(new, "2026-03-01").expect("saves");
        let hardware = || {
            let mut checks = saved(&robot, Some(&data));
            assert!(checks[0].ok && checks[0].says.contains("none is saved"));
            checks.remove(1)
        };
        let check = hardware();
        assert!(
            check.ok && check.says.contains("version 1 is in use"),
            "{check:?}"
        );
        std::fs::write(store.files(1).calibration, "name = 3").expect("writes");
        let check = hardware();
        std::fs::remove_dir_all(&data).expect("removed");
        assert!(
            !check.ok && check.says.contains("version 1 cannot be read"),
            "{check:?}"
        );
    }
}
