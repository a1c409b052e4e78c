//! `doctor`: checks the graphics adapter, ports, viewer and files.

use std::net::SocketAddr;

use anyhow::Result;
use clap::Args;
use serde_json::{Value, json};

use super::logging::log_path;
use super::{Report, user};
use springtwin::lab::doctor;
#[cfg(feature = "gui")]
use springtwin::lab::doctor::Check;
use springtwin::link::mocap;
use springtwin::robot::RobotSpec;

#[derive(Args)]
pub struct DoctorArgs {
    /// Also open these ports of boards; opening restarts a stock Arduino, and its pumps are off then
    #[arg(long, value_name = "PORT,PORT")]
    rig: Option<String>,
    /// Where motion capture is to be received; loopback, port 51001, without it
    #[arg(long, value_name = "IP:PORT")]
    mocap_listen: Option<SocketAddr>,
}

/// `doctor`: checks the graphics adapter, ports, viewer and files, each with advice.
pub fn run(a: &DoctorArgs, robot: &RobotSpec) -> Result<Report> {
    let data = user::data_folder();
    let places = doctor::Places {
        recordings: user::recordings_folder(),
        rolling: user::rolling_folder(),
        log: data.as_deref().map(log_path),
        data,
        rig: a.rig.clone(),
        mocap: a.mocap_listen.unwrap_or_else(mocap::default_address),
    };
    let mut checks = doctor::checks(robot, &places);
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
