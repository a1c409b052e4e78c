//! `doctor`: checks the graphics adapter, ports, viewer and files.

use anyhow::Result;
use clap::Args;
use serde_json::{Value, json};

use super::{Report, user};
use springtwin::lab::doctor;
#[cfg(feature = "gui")]
use springtwin::lab::doctor::Check;
use springtwin::robot::RobotSpec;

#[derive(Args)]
pub struct DoctorArgs {}

/// `doctor`: checks the graphics adapter, ports, viewer and files, each with advice.
pub fn run(robot: &RobotSpec) -> Result<Report> {
    let mut checks = doctor::checks(robot, &user::recordings_folder());
    checks.extend(screen());
    let ok = checks.iter().all(|c| c.ok);
    let text = checks
        .iter()
        .map(|c| {
            format!(
                "{} {:<12} {}",
                if c.ok { "ok  " } else { "WARN" },
                c.name,
                c.says
            )
        })
        .collect::<Vec<_>>()
        .join("\n");
    let list: Vec<Value> = checks
        .iter()
        .map(|c| json!({"name": c.name, "ok": c.ok, "says": c.says}))
        .collect();
    Ok(Report {
        text,
        json: json!({"ok": ok, "checks": list}),
    })
}

#[cfg(not(feature = "gui"))]
fn screen() -> [doctor::Check; 0] {
    []
}

#[cfg(feature = "gui")]
fn screen() -> [Check; 2] {
    [adapter(), display()]
}

#[cfg(feature = "gui")]
fn adapter() -> Check {
    match springtwin::gui::offscreen::Offscreen::new([64, 64], 1.0) {
        Ok(o) => {
            let info = o.render_state().adapter.get_info();
            Check {
                name: "graphics",
                ok: true,
                says: format!("{} ({:?}, {:?})", info.name, info.backend, info.device_type),
            }
        }
        Err(e) => Check {
            name: "graphics",
            ok: false,
            says: e.to_string(),
        },
    }
}

#[cfg(feature = "gui")]
fn display() -> Check {
    let ok = std::env::var_os("DISPLAY").is_some()
        || std::env::var_os("WAYLAND_DISPLAY").is_some()
        || !cfg!(target_os = "linux");
    let says = if ok {
        "a display is there"
    } else {
        "no display: the window cannot open; use `springtwin run --headless`"
    };
    Check {
        name: "display",
        ok,
        says: says.to_owned(),
    }
}
