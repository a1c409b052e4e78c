//! `inspect`, `ports` and `doctor`: what files, ports and adapters are like.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result};
use clap::Args;
use serde_json::{Value, json};

use super::{Report, args, model, user};
use springtwin::link::ports::{PortChange, PortInfo, PortWatch};
use springtwin::recording::{Inspection, inspect};
use springtwin::robot::RobotSpec;
use springtwin::signal::Stamp;

#[derive(Args)]
pub struct InspectArgs {
    /// Recording (.rrd), session folder or session.toml
    #[arg(value_name = "F.rrd|SESSION")]
    file: PathBuf,
}

/// `inspect`.
pub fn inspect_command(a: &InspectArgs) -> Result<Report> {
    let found = inspect(&a.file)?;
    Ok(Report {
        text: inspected(&found),
        json: serde_json::to_value(&found)?,
    })
}

/// What was found in a file, for people.
fn inspected(found: &Inspection) -> String {
    let whole = match (found.complete, found.recovered_until) {
        (true, _) => "complete".to_owned(),
        (false, Some(t)) => format!("cut off: recovered up to {t:.2} s"),
        (false, None) => "cut off: nothing could be recovered".to_owned(),
    };
    let h = &found.health;
    let state = match h.gaps {
        0 => whole,
        n => format!(
            "{}{n} gap{}, the longest {:.2} s",
            if found.complete {
                String::new()
            } else {
                format!("{whole}, ")
            },
            if n == 1 { "" } else { "s" },
            h.longest_step_s
        ),
    };
    let origin = match found.simulated {
        Some(true) => " (simulated)",
        Some(false) => " (measured)",
        None => "",
    };
    let mut text = format!(
        "{}{origin}: {:.2} s, {} samples at {:.1} Hz, {state}, payload {} kg",
        found.name, found.seconds, found.samples, found.rate_hz, found.payload_kg
    );
    for gap in &h.longest_gaps {
        text.push_str(&format!(
            "\n  gap of {:.2} s after {:.2} s",
            gap.seconds, gap.from_s
        ));
    }
    for said in &found.units {
        text.push_str(&format!("\nWARN {said}"));
    }
    text.push_str(&format!(
        "\n  {:<34} {:>8} {:>8} {:>10} {:>10} {:>10}",
        "channel", "rows", "Hz", "min", "mean", "max"
    ));
    let usual_s = found.rate_hz.recip();
    for c in &found.channels {
        text.push_str(&format!(
            "\n  {:<34} {:>8} {:>8.1} ",
            c.name, c.rows, c.rate_hz
        ));
        match &c.values {
            Some(v) => text.push_str(&format!(
                "{:>10.3} {:>10.3} {:>10.3}  {}",
                v.min, v.mean, v.max, c.unit
            )),
            None => text.push_str(&format!("{:>32}  {}", "", c.unit)),
        }
        // A hole in this channel that the file as a whole does not have.
        if let Some(v) = c
            .values
            .filter(|v| v.longest_step_s > h.longest_step_s + 0.5 * usual_s)
        {
            text.push_str(&format!(
                "  (nothing for {:.2} s after {:.2} s)",
                v.longest_step_s, v.longest_step_at_s
            ));
        }
    }
    text
}

#[derive(Args)]
pub struct DoctorArgs {}

struct Check {
    name: &'static str,
    ok: bool,
    says: String,
}

/// `doctor`: checks the graphics adapter, ports, viewer and files, and says what to do.
pub fn doctor(robot: &RobotSpec) -> Result<Report> {
    let mut checks = vec![
        patches(robot),
        networks(robot),
        calibration(robot),
        ports(),
        viewer(),
        folder(),
    ];
    checks.extend(screen());
    let ok = checks.iter().all(|c| c.ok);
    let text = checks
        .iter()
        .map(|c| {
            format!(
                "{} {:<12} {}",
                if c.ok { "ok  " } else { "LOOK" },
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
    let says = match springtwin::link::ports::list() {
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

fn folder() -> Check {
    let folder = user::recordings_folder();
    let (ok, says) = writable(&folder);
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

#[cfg(not(feature = "gui"))]
fn screen() -> [Check; 0] {
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

#[derive(Args)]
pub struct PortsArgs {
    /// Go on for so many seconds and tell what comes and goes
    #[arg(long, value_name = "S", default_value = "0", value_parser = args::not_negative)]
    watch: f64,
}

/// `ports`.
pub fn ports_command(a: &PortsArgs, quiet: bool) -> Result<Report> {
    let shown = |p: &PortInfo| format!("{}  {}", p.name, p.what).trim_end().to_owned();
    let object = |p: &PortInfo| json!({"name": p.name, "what": p.what});
    let first =
        springtwin::link::ports::list().context("the system does not list its serial ports")?;
    let mut text: Vec<String> = first.iter().map(shown).collect();
    let mut watch = PortWatch::of(first);
    if text.is_empty() {
        text.push("no serial ports: plug a board in, or start `springtwin rig`".to_owned());
    }
    if a.watch > 0.0 && !quiet {
        super::stdio::line(&text.join("\n"))?;
        text.clear();
    }
    #[expect(
        clippy::disallowed_methods,
        reason = "the command owns the main thread and its time"
    )]
    let start = std::time::Instant::now();
    let mut changes: Vec<Value> = Vec::new();
    while start.elapsed().as_secs_f64() < a.watch {
        for change in watch.poll(Stamp::from_seconds(start.elapsed().as_secs_f64())) {
            if !quiet {
                super::stdio::line(&change.text())?;
            }
            changes.push(match &change {
                PortChange::Appeared(p) => json!({"appeared": object(p)}),
                PortChange::Gone(p) => json!({"gone": object(p)}),
            });
        }
        std::thread::sleep(std::time::Duration::from_millis(50));
    }
    let now: Vec<Value> = watch.known().iter().map(object).collect();
    Ok(Report {
        text: text.join("\n"),
        json: json!({"ports": now, "changes": changes}),
    })
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
