//! What the window asks of the program: work on threads of their own, files, dialogs.

use std::path::PathBuf;

use springtwin::gui::Services;
use springtwin::gui::panels::player::Player;
use springtwin::gui::services::{Dialog, DialogKind, Job, Worker};

use super::rigs::{Rigs, serial_ports};
use super::{Asks, calibrate, library, viewer};

/// Runs `work` on a thread of its own; the window is repainted when the answer is there.
pub fn later<T: Send + 'static>(
    ctx: &egui::Context,
    name: &str,
    work: impl FnOnce(&Worker<T>) -> Result<T, String> + Send + 'static,
) -> Job<T> {
    let (job, worker) = Job::pair();
    let ctx = ctx.clone();
    let spawned = std::thread::Builder::new()
        .name(name.to_owned())
        .spawn(move || {
            let answer = work(&worker);
            worker.finish(answer);
            ctx.request_repaint();
        });
    match spawned {
        Ok(_) => job,
        Err(e) => Job::ready(Err(format!("Cannot start a thread for the {name}: {e}."))),
    }
}

/// Asks for a path in the system's own dialog.
fn ask(dialog: Dialog) -> Option<PathBuf> {
    let mut native = rfd::FileDialog::new().set_title(dialog.title);
    if let Some((name, extensions)) = dialog.filter {
        native = native.add_filter(name, &extensions);
    }
    match dialog.kind {
        DialogKind::Open => native.pick_file(),
        DialogKind::Save => native.set_file_name(dialog.name).save_file(),
    }
}

/// The services of a window that is open.
pub fn services(asks: Asks, rigs: Rigs, calibration: calibrate::Setting) -> Services {
    let ctx = &asks.ctx;
    let (for_scan, for_load, for_align) = (ctx.clone(), ctx.clone(), ctx.clone());
    let (for_ports, for_dialog, for_calibration) = (ctx.clone(), ctx.clone(), ctx.clone());
    let for_rig = rigs.clone();
    Services {
        scan: Box::new(move || {
            later(&for_scan, "scan", |_| {
                Ok(library::scan(&library::folders()))
            })
        }),
        load: Box::new(move |path| {
            let path = path.to_owned();
            later(&for_load, "loader", move |worker| {
                let what = format!("Reading {}", path.display());
                worker.tell(&what, None);
                let loaded = library::load(&path, &mut |share| {
                    worker.tell(&what, Some(share));
                    !worker.cancelled()
                })?;
                let what = format!("Indexing {}", path.display());
                Player::loaded(loaded, &mut |share| {
                    worker.tell(&what, Some(share));
                    !worker.cancelled()
                })
            })
        }),
        align: Box::new(move |pairing| {
            later(&for_align, "alignment", move |worker| {
                let found = pairing.align(&|| !worker.cancelled());
                found.ok_or_else(|| "Stopped on request.".to_owned())
            })
        }),
        open_in_rerun: Box::new(viewer::open),
        start_viewer: viewer::starter(&asks.ctx),
        default_recording: Box::new(library::default_recording),
        pick: Box::new(move |dialog| later(&for_dialog, "dialog", |_| Ok(ask(dialog)))),
        calibration: calibrate::services(ctx, calibration),
        belongings: Box::new(move |rig| {
            let found = for_rig.belongings(rig).map_err(|e| format!("{e:#}."));
            let (setting, registration) = found?;
            Ok((calibrate::services(&for_calibration, setting), registration))
        }),
        write: Box::new(|path, bytes| {
            springtwin::recording::write_bytes(path, bytes).map_err(|e| e.to_string())
        }),
        ports: Box::new(move || later(&for_ports, "ports", |_| serial_ports())),
        connect: Box::new(move |rig| {
            let (rigs, rig) = (rigs.clone(), rig.to_owned());
            let repaint = match asks.repaint() {
                Ok(repaint) => repaint,
                Err(e) => {
                    return Job::ready(Err(format!("Cannot start a thread for the window: {e}.")));
                }
            };
            later(&asks.ctx, "connection", move |worker| {
                worker.tell(&format!("Connecting to {rig}"), None);
                rigs.connect(&rig, repaint)
            })
        }),
        gap: springtwin::gui::services::gap::GapServices::none(),
    }
}
