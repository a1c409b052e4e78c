//! What the window asks of the program: work on threads of their own, files, dialogs.

use std::time::Duration;

use springtwin::analysis::player::Player;
use springtwin::gui::Services;
use springtwin::gui::services::{Connected, Folder, Job, RollingUse, Scanner};
use springtwin::lab::loading;
use springtwin::recording::{annotate, keep_last};

use super::later::later;
use super::rigs::{Rigs, serial_ports};
use super::{Asks, calibrate, dialog, export, library, viewer};

/// A rolling recording is written twice a second.
const UNTIL_WRITTEN: Duration = Duration::from_millis(1200);

/// The services of a window that is open.
pub fn services(asks: Asks, rigs: Rigs, calibration: calibrate::Setting) -> Services {
    let ctx = &asks.ctx;
    let for_notes = ctx.clone();
    let for_keep = (ctx.clone(), rigs.rolling());
    let for_rolling = for_keep.clone();
    let for_model = rigs.robot.clone();
    let (for_name, for_load, for_align) = (ctx.clone(), ctx.clone(), ctx.clone());
    let (for_rename, for_space) = (ctx.clone(), ctx.clone());
    let (for_ports, for_dialog, for_write) = (ctx.clone(), ctx.clone(), ctx.clone());
    let kept = rigs.data.clone();
    let data = kept.clone().unwrap_or_default();
    let scratch = kept.unwrap_or_else(|| std::env::temp_dir().join("springtwin"));
    Services {
        recordings: Folder::of(data.join("recordings")),
        exports: data.join("exports"),
        scan: scanner(ctx, library::Places::new(&scratch)),
        load: Box::new(move |path| {
            let (path, robot) = (path.to_owned(), for_model.clone());
            later(&for_load, "loader", move |worker| {
                let what = format!("Reading {}", path.display());
                worker.tell(&what, None);
                let loaded = loading::load(&robot, &path, &mut |share| {
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
        keep: Box::new(move |first, folder, seconds, note| {
            let (first, folder) = (first.to_owned(), folder.to_owned());
            let rolling = for_keep.1.clone();
            later(&for_keep.0, "kept recording", move |_| {
                let rolling = rolling.ok_or("This user has no data folder.")?;
                // What the arm has just done is written within a second.
                std::thread::sleep(UNTIL_WRITTEN);
                let out = library::names::fresh(&folder, jiff::Zoned::now().datetime(), "")?;
                let kept = keep_last(&rolling, Some(&first), seconds, &out, &note);
                match kept {
                    Ok(_) => Ok(out),
                    Err(e) => {
                        // The name, which nothing has.
                        let _ = std::fs::remove_file(&out);
                        Err(format!("The last minutes are not kept: {e}"))
                    }
                }
            })
        }),
        rolling: Box::new(move |limit_bytes| {
            let rolling = for_rolling.1.clone();
            later(&for_rolling.0, "rolling recording", move |_| {
                let Some(rolling) = rolling else {
                    return Ok(RollingUse::default());
                };
                if let Some(limit_bytes) = limit_bytes {
                    rolling.set_limit(limit_bytes).map_err(|e| e.to_string())?;
                }
                Ok(RollingUse {
                    folder: rolling.path().to_owned(),
                    limit_bytes: rolling.limit_bytes(),
                    used_bytes: rolling.used_bytes(),
                })
            })
        }),
        annotate: Box::new(move |path, changes| {
            let path = path.to_owned();
            later(&for_notes, "notes", move |_| {
                annotate(&path, &changes).map_err(|e| e.to_string())
            })
        }),
        align: Box::new(move |pairing| {
            later(&for_align, "alignment", move |worker| {
                let found = pairing.align(&|| !worker.cancelled());
                found.ok_or_else(|| "Stopped on request.".to_owned())
            })
        }),
        film: library::film::filmer(ctx, &rigs.robot),
        open_in_rerun: viewer::opener(&asks.ctx),
        start_viewer: viewer::starter(&asks.ctx),
        new_recording: Box::new(move |folder, name| {
            let (folder, name) = (folder.to_owned(), name.to_owned());
            later(&for_name, "recording's name", move |_| {
                library::names::fresh(&folder, jiff::Zoned::now().datetime(), &name)
            })
        }),
        rename: Box::new(move |path, name| {
            let (path, name) = (path.to_owned(), name.to_owned());
            later(&for_rename, "recording's name", move |_| {
                library::rename::rename(&path, &name)
            })
        }),
        space: Box::new(move |folder, name| {
            let (folder, name) = (folder.to_owned(), name.to_owned());
            later(&for_space, "disk space", move |_| {
                Ok(library::space(&folder, &name))
            })
        }),
        pick: Box::new(move |asked| later(&for_dialog, "dialog", |_| Ok(dialog::ask(asked)))),
        calibration: calibrate::services(ctx, calibration),
        write: Box::new(move |path, existing, content| {
            let path = path.to_owned();
            later(&for_write, "export", move |_| {
                export::write(&path, existing, &content()?)
            })
        }),
        ports: Box::new(move || later(&for_ports, "ports", |_| serial_ports())),
        connect: Box::new(move |rig| {
            let (rigs, rig) = (rigs.clone(), rig.to_owned());
            let for_calibration = asks.ctx.clone();
            let repaint = match asks.repaint() {
                Ok(repaint) => repaint,
                Err(e) => {
                    return Job::ready(Err(format!("Cannot start a thread for the window: {e}.")));
                }
            };
            later(&asks.ctx, "connection", move |worker| {
                worker.tell(&format!("Connecting to {rig}"), None);
                let handle = rigs.connect(&rig, repaint)?;
                worker.tell("Reading its calibration", None);
                let belongings = rigs.belongings(&rig).map_err(|e| format!("{e:#}."));
                let belongings = belongings.map(|(setting, registration)| {
                    (calibrate::services(&for_calibration, setting), registration)
                });
                Ok(Connected { handle, belongings })
            })
        }),
        gap: springtwin::gui::services::gap::GapServices::none(),
    }
}

/// Looks for recordings in `places` and in the folder that is recorded to.
pub fn scanner(ctx: &egui::Context, places: library::Places) -> Scanner {
    let ctx = ctx.clone();
    Box::new(move |folder| {
        let (places, folder) = (places.clone(), folder.to_owned());
        later(&ctx, "scan", move |_| Ok(places.scan(&folder)))
    })
}
