//! `video`: a recording as a video, encoded by `ffmpeg` where that is installed, else as numbered pictures.

mod frame;
mod sink;

use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;

use anyhow::{Context as _, Result};
use clap::{Args, ValueEnum};
use serde_json::json;

use super::outputs::{self, Overwrite};
use super::picture::ThemeName;
use super::progress::Bar;
use super::{Report, args};
use frame::Frames;
use sink::{Ffmpeg, Sink};
use springtwin::analysis::history::History;
use springtwin::analysis::recorded::{Loaded, origin_name};
use springtwin::gui::offscreen::Offscreen;
use springtwin::lab::{Progress as _, loading};
use springtwin::robot::RobotSpec;

#[derive(Args)]
pub struct VideoArgs {
    /// Recording or session
    #[arg(value_name = "F.rrd|SESSION")]
    file: PathBuf,
    /// The video (.mp4, .mov, .mkv, .webm), or a folder for its frames as pictures
    #[arg(long, value_name = "F.mp4|DIR")]
    out: PathBuf,
    #[command(flatten)]
    overwrite: Overwrite,
    /// From this time on, s since the session's start
    #[arg(long, value_name = "S", value_parser = args::not_negative)]
    from: Option<f64>,
    /// Up to this time, s since the session's start
    #[arg(long, value_name = "S", value_parser = args::not_negative)]
    to: Option<f64>,
    /// Frames per second
    #[arg(long, value_name = "N", default_value = "30", value_parser = clap::value_parser!(u32).range(1..=240))]
    fps: u32,
    /// Size in pixels
    #[arg(long, value_name = "WxH", default_value = "1280x720", value_parser = args::size)]
    size: [u32; 2],
    /// Seconds of the recording per second of the video
    #[arg(long, value_name = "X", default_value = "1", value_parser = args::positive)]
    speed: f64,
    /// Signals below the arm; without it the error of the tip where motion capture has one, else the springs
    #[arg(long, value_enum)]
    strip: Option<Signals>,
    /// Light or dark
    #[arg(long, value_enum, default_value_t = ThemeName::Light)]
    theme: ThemeName,
}

/// What is shown over time below the arm.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Signals {
    /// Distance of the estimated tip from motion capture
    Error,
    /// Lengths of the springs
    Springs,
    /// Measured and set pressures of the chambers
    Pressures,
    /// Position of the tip
    Tip,
}

/// How a recording becomes a film.
#[derive(Clone, Copy, Debug)]
pub struct Look {
    /// Width and height, pixels.
    pub size: [u32; 2],
    /// Frames per second.
    pub fps: u32,
    /// Seconds of the recording per second of the film.
    pub speed: f64,
    /// Signals below the arm; `None` for those that fit.
    pub strip: Option<Signals>,
    /// Light or dark.
    pub theme: egui::Theme,
}

impl Default for Look {
    fn default() -> Self {
        Self {
            size: [1280, 720],
            fps: 30,
            speed: 1.0,
            strip: None,
            theme: egui::Theme::Light,
        }
    }
}

/// A film that was made.
pub struct Film {
    /// The film, or the folder of its frames.
    pub path: PathBuf,
    /// Number of frames.
    pub frames: usize,
    /// Size of the file or of all files, bytes.
    pub bytes: u64,
    /// What encoded it; `None` for frames.
    pub encoder: Option<&'static str>,
    /// Where the data come from.
    pub origin: &'static str,
    /// Why there are frames where a film was wanted: one sentence; else `None`.
    pub why_frames: Option<String>,
}

/// Rounding of the last frame's instant, as a share of the time between two frames.
const ROUNDING: f64 = 1e-6;

/// `video`.
pub fn run(a: &VideoArgs, robot: &RobotSpec) -> Result<Report> {
    // Before any other thread begins.
    let ends = super::signals::asked_to_end()?;
    anyhow::ensure!(
        a.from.zip(a.to).is_none_or(|(from, to)| from < to),
        "--from must be before --to"
    );
    let wanted = Wanted::of(&a.out)?;
    wanted.check(a.overwrite)?;
    let goes_on = || !ends.load(Ordering::Relaxed);
    let loaded = loading::load_part(robot, &a.file, [a.from, a.to], &mut |_| goes_on())
        .map_err(anyhow::Error::msg)?;
    let look = Look {
        size: a.size,
        fps: a.fps,
        speed: a.speed,
        strip: a.strip,
        theme: a.theme.theme(),
    };
    let bar = Bar::default();
    let mut step = |done: usize, all: usize| {
        match done {
            0 => bar.stage("video", all),
            _ => bar.items_done(done),
        }
        goes_on()
    };
    let film = make(robot, loaded, look, &wanted, &mut step);
    bar.stage_done("video");
    Ok(written(&film?, a))
}

fn written(film: &Film, a: &VideoArgs) -> Report {
    let [w, h] = a.size;
    let seconds = film.frames as f64 / f64::from(a.fps);
    let what = match film.encoder {
        Some(encoder) => format!("{seconds:.1} s, {w}x{h}, {encoder}"),
        None => format!("{} frames of {w}x{h}", film.frames),
    };
    let place = film.path.display();
    let mut text = format!(
        "{place} ({what}, {}, {})",
        film.origin,
        outputs::size(film.bytes.into())
    );
    if let Some(why) = &film.why_frames {
        text = format!(
            "{why} The frames are in {text}. A film of them, once it is there: ffmpeg -framerate {} -i \
             {place}/frame-%06d.png -pix_fmt yuv420p {}",
            a.fps,
            a.out.display()
        );
    }
    Report {
        text,
        json: json!({
            "out": film.path, "frames": film.frames, "seconds": seconds, "width": w, "height": h,
            "bytes": film.bytes, "encoder": film.encoder, "origin": film.origin,
        }),
    }
}

/// Where a film shall be.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Wanted {
    /// A file, or this folder of frames without `ffmpeg`.
    File(PathBuf, PathBuf),
    /// Frames in a folder.
    Folder(PathBuf),
}

impl Wanted {
    /// By the ending of a path: none is a folder's.
    ///
    /// # Errors
    /// An ending that is no film's.
    pub fn of(out: &Path) -> Result<Self> {
        if out.extension().is_none() || out.is_dir() {
            return Ok(Self::Folder(out.to_owned()));
        }
        anyhow::ensure!(
            sink::container(out).is_some(),
            "{} ends in no kind of film: end it in .mp4, .mov, .mkv or .webm, or name a folder for pictures",
            out.display()
        );
        let mut frames = out.file_stem().unwrap_or_default().to_owned();
        frames.push("-frames");
        Ok(Self::File(out.to_owned(), out.with_file_name(frames)))
    }

    /// Refuses what is there, unless it may be replaced.
    fn check(&self, overwrite: Overwrite) -> Result<()> {
        match self {
            Self::File(file, frames) => {
                overwrite.file(file)?;
                overwrite.folder(frames)
            }
            Self::Folder(folder) => overwrite.folder(folder),
        }
    }
}

/// Makes a film. `step` receives the number of frames that are done and of all, and ends the work when it answers `false`;
/// nothing is left then.
///
/// # Errors
/// A sentence for people: nothing to show, no graphics device, a disk that is full, an encoder that fails.
pub fn make(
    robot: &RobotSpec,
    loaded: Loaded,
    look: Look,
    wanted: &Wanted,
    step: &mut dyn FnMut(usize, usize) -> bool,
) -> Result<Film> {
    make_with(Ffmpeg::find(), robot, loaded, look, wanted, step)
}

fn make_with(
    ffmpeg: Option<Ffmpeg>,
    robot: &RobotSpec,
    loaded: Loaded,
    look: Look,
    wanted: &Wanted,
    step: &mut dyn FnMut(usize, usize) -> bool,
) -> Result<Film> {
    let trace = &loaded.trace;
    let history = History::of(trace.snapshots.iter());
    let range_s = history.range_s().with_context(|| {
        format!(
            "{} holds nothing in this time: choose another one with --from and --to",
            trace.name
        )
    })?;
    let every_s = look.speed / f64::from(look.fps);
    let frames = ((range_s[1] - range_s[0]) / every_s + ROUNDING).floor() as usize + 1;
    let mut offscreen = Offscreen::new(look.size, look.size[1] as f32 / frame::HIGH)?;
    let mut drawn = Frames::new(&mut offscreen, robot, trace, &history, range_s, look)?;
    let (mut sink, why_frames) = match wanted {
        Wanted::Folder(folder) => (Sink::folder(folder)?, None),
        Wanted::File(file, folder) => match ffmpeg {
            Some(ffmpeg) => (ffmpeg.begin(file, look)?, None),
            None => {
                let why = "ffmpeg was not found, so there is no film.".to_owned();
                (Sink::folder(folder)?, Some(why))
            }
        },
    };
    for k in 0..frames {
        // A sink that is dropped leaves nothing.
        anyhow::ensure!(step(k, frames), "stopped on request: no video was made");
        let at_s = range_s[0] + k as f64 * every_s;
        sink.push(drawn.frame(&mut offscreen, at_s)?)?;
    }
    let encoder = sink.encoder();
    let (path, bytes) = sink.finish()?;
    step(frames, frames);
    Ok(Film {
        path,
        frames,
        bytes,
        encoder,
        origin: origin_name(trace.simulated),
        why_frames,
    })
}

#[cfg(test)]
mod tests;
