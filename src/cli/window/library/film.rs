//! Films of recordings, beside the window.

use std::path::Path;

use springtwin::gui::services::{Existing, Filmed, Filmer, Worker};
use springtwin::lab::loading::load;
use springtwin::robot::RobotSpec;

use crate::cli::video::{Look, Wanted, make};
use crate::cli::window::export;
use crate::cli::window::later::later;

/// What makes films, each on a thread of its own.
pub fn filmer(ctx: &egui::Context, robot: &RobotSpec) -> Filmer {
    let (ctx, robot) = (ctx.clone(), robot.clone());
    Box::new(move |recording, out, existing| {
        let (recording, out) = (recording.to_owned(), out.to_owned());
        let robot = robot.clone();
        later(&ctx, "video", move |worker| {
            film(&robot, &recording, (&out, existing), worker)
        })
    })
}

fn film(
    robot: &RobotSpec,
    recording: &Path,
    (out, existing): (&Path, Existing),
    worker: &Worker<Filmed>,
) -> Result<Filmed, String> {
    let sentence = |e: anyhow::Error| format!("{}.", crate::cli::sentence(&e));
    let out = std::path::absolute(out).unwrap_or_else(|_| out.to_owned());
    let out = match out.extension() {
        Some(_) => out,
        None => out.with_extension("mp4"),
    };
    if let Some(folder) = out.parent() {
        std::fs::create_dir_all(folder)
            .map_err(|e| format!("The folder {} cannot be made: {e}.", folder.display()))?;
    }
    let out = match existing {
        Existing::Replaced => out,
        Existing::Kept => export::free(&out)?,
    };
    let wanted = match Wanted::of(&out).map_err(sentence)? {
        // A dialog asks for the film alone.
        Wanted::File(film, frames) => Wanted::File(film, export::free(&frames)?),
        folder @ Wanted::Folder(_) => folder,
    };
    let loaded = load(robot, recording, &mut |share| {
        worker.tell("reading", Some(share));
        !worker.cancelled()
    })?;
    let look = Look::default();
    let mut step = |done: usize, all: usize| {
        worker.tell(
            &format!("{all} frames"),
            Some(done as f32 / all.max(1) as f32),
        );
        !worker.cancelled()
    };
    let made = make(robot, loaded, look, &wanted, &mut step).map_err(sentence)?;
    let seconds = made.frames as f64 / f64::from(look.fps);
    Ok(Filmed {
        what: match made.encoder {
            Some(_) => format!("the video of {seconds:.1} s"),
            None => format!("{} frames", made.frames),
        },
        path: made.path,
        why_frames: made.why_frames,
    })
}
