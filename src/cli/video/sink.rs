//! Where frames go: into `ffmpeg`, or into a folder. Either is whole, or not there.

use std::fs::File;
use std::io::{BufWriter, ErrorKind, Read as _, Write as _};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::thread::JoinHandle;

use anyhow::{Context as _, Result};
use image::RgbaImage;
use image::codecs::png::CompressionType;

use super::Look;
use crate::cli::picture;
use crate::cli::signals::taken_by_child;

/// Kinds of films by their ending: what ffmpeg calls them, and the encoders that suit them, best first.
const CONTAINERS: [(&str, &str, &[&str]); 4] = [
    ("mp4", "mp4", &["libx264", "libopenh264", "mpeg4"]),
    ("mov", "mov", &["libx264", "libopenh264", "mpeg4"]),
    ("mkv", "matroska", &["libx264", "libopenh264", "mpeg4"]),
    ("webm", "webm", &["libvpx-vp9", "libvpx"]),
];

/// What ffmpeg calls this kind of film, and encoders for it; `None` where it is no film.
pub fn container(path: &Path) -> Option<(&'static str, &'static [&'static str])> {
    let ending = path.extension()?.to_string_lossy().to_lowercase();
    let found = CONTAINERS.into_iter().find(|(e, ..)| *e == ending)?;
    Some((found.1, found.2))
}

/// How well each encoder shall do.
fn quality(encoder: &str) -> &'static [&'static str] {
    match encoder {
        "libx264" => &["-preset", "medium", "-crf", "18"],
        "libvpx-vp9" => &["-crf", "24", "-b:v", "0"],
        "mpeg4" => &["-q:v", "3"],
        _ => &["-b:v", "6M"],
    }
}

/// The program that encodes.
pub struct Ffmpeg {
    program: PathBuf,
    /// The list of its encoders.
    encoders: String,
}

impl Ffmpeg {
    /// The one of this computer; `None` where there is none.
    pub fn find() -> Option<Self> {
        Self::at(Path::new("ffmpeg"))
    }

    /// A program, by its name or path; `None` where it cannot be run.
    pub fn at(program: &Path) -> Option<Self> {
        let mut command = Command::new(program);
        command
            .args(["-hide_banner", "-encoders"])
            .stdin(Stdio::null())
            .stderr(Stdio::null());
        let out = taken_by_child(|| command.output()).ok()?;
        out.status.success().then(|| Self {
            program: program.to_owned(),
            encoders: String::from_utf8_lossy(&out.stdout).into_owned(),
        })
    }

    fn has(&self, encoder: &str) -> bool {
        let mut words = self.encoders.split_whitespace();
        words.any(|w| w == encoder)
    }

    /// Begins a film.
    ///
    /// # Errors
    /// None of its encoders suits the kind of film, or it cannot be started.
    pub fn begin(&self, out: &Path, look: Look) -> Result<Sink> {
        let (kind, encoders) = container(out).context("no kind of film")?;
        let encoder = encoders.iter().copied().find(|e| self.has(e));
        let encoder = encoder.with_context(|| {
            format!(
                "this ffmpeg has no encoder for {} (it needs {}): choose another ending, or name a folder for pictures",
                out.display(),
                encoders.join(" or ")
            )
        })?;
        let mut name = out.file_name().unwrap_or_default().to_owned();
        name.push(format!(".{}.part", std::process::id()));
        let part = out.with_file_name(name);
        let [w, h] = look.size;
        let mut command = Command::new(&self.program);
        command
            .args(["-hide_banner", "-loglevel", "error", "-y"])
            .args(["-f", "rawvideo", "-pixel_format", "rgba"])
            .args(["-video_size", &format!("{w}x{h}")])
            .args(["-framerate", &look.fps.to_string(), "-i", "-", "-an"])
            // Colours are stored for every second pixel of both directions.
            .args([
                "-vf",
                "pad=ceil(iw/2)*2:ceil(ih/2)*2",
                "-pix_fmt",
                "yuv420p",
            ])
            .args(["-c:v", encoder])
            .args(quality(encoder));
        if matches!(kind, "mp4" | "mov") {
            // A player may begin before it has all of it.
            command.args(["-movflags", "+faststart"]);
        }
        command.args(["-f", kind]).arg(&part);
        command
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            .stderr(Stdio::piped());
        // Ctrl+C is for this program, which ends the other one.
        #[cfg(unix)]
        std::os::unix::process::CommandExt::process_group(&mut command, 0);
        let mut child = taken_by_child(|| command.spawn()).context("ffmpeg cannot be started")?;
        let complaints = child.stderr.take().map(|mut stderr| {
            let read = move || {
                let mut text = String::new();
                // What cannot be read is not quoted.
                let _ = stderr.read_to_string(&mut text);
                text
            };
            let thread = std::thread::Builder::new().name("ffmpeg".to_owned());
            thread.spawn(read)
        });
        let complaints = complaints.transpose().context("cannot start a thread")?;
        Ok(Sink::Encoder(Encoder {
            child,
            complaints,
            encoder,
            part,
            out: out.to_owned(),
        }))
    }
}

/// An `ffmpeg` at work. Dropped, it ends and leaves nothing.
pub struct Encoder {
    child: Child,
    complaints: Option<JoinHandle<String>>,
    encoder: &'static str,
    part: PathBuf,
    out: PathBuf,
}

impl Encoder {
    /// Why it failed: the last line that it wrote.
    fn failure(&mut self) -> anyhow::Error {
        drop(self.child.stdin.take());
        let _ = self.child.wait();
        let text = self.complaints.take().and_then(|t| t.join().ok());
        let text = text.unwrap_or_default();
        let last = text.lines().map(str::trim).rfind(|l| !l.is_empty());
        let why = last.unwrap_or("it gave no reason");
        anyhow::anyhow!("ffmpeg could not make {}: {why}", self.out.display())
    }

    fn push(&mut self, pixels: &[u8]) -> Result<()> {
        let written = self.child.stdin.as_mut().map(|to| to.write_all(pixels));
        match written {
            Some(Ok(())) => Ok(()),
            _ => Err(self.failure()),
        }
    }

    fn finish(mut self) -> Result<(PathBuf, u64)> {
        // Its end is that of its input.
        drop(self.child.stdin.take());
        let status = self.child.wait().context("ffmpeg is lost")?;
        if !status.success() {
            return Err(self.failure());
        }
        let refused = || format!("cannot write {}", self.out.display());
        std::fs::rename(&self.part, &self.out).with_context(refused)?;
        let bytes = std::fs::metadata(&self.out).with_context(refused)?.len();
        Ok((self.out.clone(), bytes))
    }
}

impl Drop for Encoder {
    fn drop(&mut self) {
        // One that has ended needs neither.
        let _ = self.child.kill();
        let _ = self.child.wait();
        let _ = std::fs::remove_file(&self.part);
    }
}

/// Frames as PNG in a folder that gets its name at the end. Dropped before, it goes.
pub struct Folder {
    part: PathBuf,
    out: PathBuf,
    frames: usize,
    bytes: u64,
}

/// `frame-000001.png` and so on.
fn frame_name(number: usize) -> String {
    format!("frame-{number:06}.png")
}

fn is_frame(name: &str) -> bool {
    let number = name
        .strip_prefix("frame-")
        .and_then(|n| n.strip_suffix(".png"));
    number.is_some_and(|n| n.len() >= 6 && n.bytes().all(|b| b.is_ascii_digit()))
}

/// Removes a folder of frames that is there; one with anything else in it stays.
fn clear(folder: &Path) -> Result<()> {
    let entries = match std::fs::read_dir(folder) {
        Err(e) if e.kind() == ErrorKind::NotFound => return Ok(()),
        entries => entries.with_context(|| format!("cannot read {}", folder.display()))?,
    };
    for entry in entries {
        let name = entry?.file_name();
        anyhow::ensure!(
            is_frame(&name.to_string_lossy()),
            "{} is not replaced: {} in it is no frame of a video; name another folder",
            folder.display(),
            name.display()
        );
    }
    std::fs::remove_dir_all(folder).with_context(|| format!("cannot replace {}", folder.display()))
}

impl Folder {
    fn begin(out: &Path) -> Result<Self> {
        let mut name = out
            .file_name()
            .context("the folder has no name")?
            .to_owned();
        name.push(".part");
        let part = out.with_file_name(name);
        clear(&part)?;
        std::fs::create_dir_all(&part)
            .with_context(|| format!("cannot make the folder {}", part.display()))?;
        Ok(Self {
            part,
            out: out.to_owned(),
            frames: 0,
            bytes: 0,
        })
    }

    fn push(&mut self, picture: RgbaImage) -> Result<()> {
        self.frames += 1;
        let path = self.part.join(frame_name(self.frames));
        let refused = || format!("cannot write {}", path.display());
        let file = File::create(&path).with_context(refused)?;
        let mut to = BufWriter::new(file);
        picture::encode(picture, &mut to, CompressionType::Fast).with_context(refused)?;
        to.flush().with_context(refused)?;
        self.bytes += std::fs::metadata(&path).with_context(refused)?.len();
        Ok(())
    }

    fn finish(self) -> Result<(PathBuf, u64)> {
        clear(&self.out)?;
        std::fs::rename(&self.part, &self.out)
            .with_context(|| format!("cannot name the folder {}", self.out.display()))?;
        Ok((self.out.clone(), self.bytes))
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        // Gone once it has its name.
        let _ = std::fs::remove_dir_all(&self.part);
    }
}

/// Takes frames.
pub enum Sink {
    /// A film.
    Encoder(Encoder),
    /// Pictures.
    Folder(Folder),
}

impl Sink {
    /// Pictures in a folder.
    ///
    /// # Errors
    /// The folder cannot be made.
    pub fn folder(out: &Path) -> Result<Self> {
        Ok(Self::Folder(Folder::begin(out)?))
    }

    /// Takes the next frame.
    ///
    /// # Errors
    /// The encoder's own words, or a disk that is full.
    pub fn push(&mut self, picture: RgbaImage) -> Result<()> {
        match self {
            Self::Encoder(encoder) => encoder.push(picture.as_raw()),
            Self::Folder(folder) => folder.push(picture),
        }
    }

    /// What encodes; `None` for pictures.
    pub fn encoder(&self) -> Option<&'static str> {
        match self {
            Self::Encoder(encoder) => Some(encoder.encoder),
            Self::Folder(_) => None,
        }
    }

    /// Gives the film its name; its path and size, bytes.
    ///
    /// # Errors
    /// As [`Self::push`].
    pub fn finish(self) -> Result<(PathBuf, u64)> {
        match self {
            Self::Encoder(encoder) => encoder.finish(),
            Self::Folder(folder) => folder.finish(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn kinds_of_films_are_known_by_their_ending() {
        assert_eq!(container(Path::new("a.MP4")).map(|c| c.0), Some("mp4"));
        assert_eq!(container(Path::new("a.mkv")).map(|c| c.0), Some("matroska"));
        assert!(container(Path::new("a.avi")).is_none() && container(Path::new("a")).is_none());
        assert!(is_frame("frame-000001.png") && !is_frame("frame-1.png"));
        assert!(!is_frame("frame-.png") && !is_frame("notes.txt"));
        assert!(Ffmpeg::at(Path::new("/nowhere/ffmpeg")).is_none());
    }

    #[test]
    fn a_folder_of_frames_is_whole_or_not_there_and_replaces_nothing_else() {
        let name = format!("springtwin-frames-{}", std::process::id());
        let home = std::env::temp_dir().join(name);
        std::fs::create_dir_all(&home).expect("a folder");
        let out = home.join("film");
        let frame = || RgbaImage::from_pixel(8, 4, image::Rgba([1, 2, 3, 255]));
        let mut given_up = Sink::folder(&out).expect("a folder");
        given_up.push(frame()).expect("written");
        drop(given_up);
        assert_eq!(std::fs::read_dir(&home).expect("is there").count(), 0);
        for frames in [3, 1] {
            let mut sink = Sink::folder(&out).expect("a folder");
            (0..frames).for_each(|_| sink.push(frame()).expect("written"));
            let (path, bytes) = sink.finish().expect("named");
            assert!(path == out && bytes > 0);
            let there = std::fs::read_dir(&out).expect("is there").count();
            assert_eq!(there, frames);
        }
        std::fs::write(out.join("notes.txt"), "kept").expect("written");
        let mut sink = Sink::folder(&out).expect("a folder");
        sink.push(frame()).expect("written");
        let refused = sink.finish().expect_err("a note is in it").to_string();
        let kept = std::fs::read_to_string(out.join("notes.txt")).expect("is there");
        let left = std::fs::read_dir(&home).expect("is there").count();
        std::fs::remove_dir_all(&home).expect("removed");
        assert!(refused.contains("notes.txt"), "{refused}");
        assert_eq!((kept.as_str(), left), ("kept", 1));
    }

    #[cfg(unix)]
    #[test]
    fn an_encoder_that_fails_is_quoted_and_leaves_nothing() {
        use std::os::unix::fs::PermissionsExt as _;
        let name = format!("springtwin-encoder-{}", std::process::id());
        let home = std::env::temp_dir().join(name);
        std::fs::create_dir_all(&home).expect("a folder");
        let program = home.join("ffmpeg");
        let script = "#!/bin/sh\ncase \"$*\" in *-encoders*) echo ' V..... mpeg4 MPEG-4';; \
                      *) cat >/dev/null; echo >&2 'first'; echo >&2 'No space left'; exit 1;; esac\n";
        std::fs::write(&program, script).expect("written");
        let may_run = std::fs::Permissions::from_mode(0o755);
        std::fs::set_permissions(&program, may_run).expect("set");
        let ffmpeg = Ffmpeg::at(&program).expect("it runs");
        let look = Look {
            size: [8, 4],
            ..Look::default()
        };
        let out = home.join("a.mp4");
        let frame = RgbaImage::from_pixel(8, 4, image::Rgba([1, 2, 3, 255]));
        let mut sink = ffmpeg.begin(&out, look).expect("begins");
        assert_eq!(sink.encoder(), Some("mpeg4"));
        let failed = sink.push(frame).and_then(|()| sink.finish());
        let failed = failed.expect_err("it fails").to_string();
        let none = ffmpeg.begin(&home.join("a.webm"), look).err();
        let left = std::fs::read_dir(&home).expect("is there").count();
        std::fs::remove_dir_all(&home).expect("removed");
        assert!(failed.ends_with("a.mp4: No space left"), "{failed}");
        assert!(none.is_some_and(|e| e.to_string().contains("libvpx-vp9 or libvpx")));
        assert_eq!(left, 1, "the program alone");
    }
}
