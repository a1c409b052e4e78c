//! A motion-capture file, or a bag that this program wrote, becomes a session.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result};

use crate::drive::read_toml;
use crate::recording::{
    MarkerBody, MocapFile, MocapObject, MocapRotation, OwnBag, SessionLog, marker_body, read_mcap,
    read_mocap, write_session,
};
use crate::sensing::registration::Registration;
use crate::signal::{CHAMBERS, IMUS, SPRINGS, SensorVec};

/// Largest coordinate that a session log takes, m.
pub(super) const COORDINATE_MAX_M: f64 = 10.0;
/// What the poses of a session without registration are.
const WORLD: &str = "poses are in the motion capture's own axes, not in the robot's base";

/// Options of an import.
#[derive(Clone, Debug, Default)]
pub struct Options {
    /// Vicon CSV, OptiTrack Motive CSV, or C3D.
    pub file: PathBuf,
    /// Folder for the session.
    pub out: PathBuf,
    /// Name of the object, where the file has several; `None`: the only one.
    pub object: Option<String>,
    /// Take the rigid body of these markers; `None`: not.
    pub markers: Option<Vec<String>>,
    /// Take the rigid body of all markers of this subject; `None`: not.
    pub subject: Option<String>,
    /// File that puts the poses into the robot's base frame; `None`: they stay in motion capture's world.
    pub registration: Option<PathBuf>,
    /// Put the session onto the clock of the robot's recording, too.
    pub robot_clock: bool,
    /// Meaning of three angles in a Vicon Tracker file that does not state it; `None`: helical.
    pub rotation: Option<MocapRotation>,
}

/// A session that was made of a motion-capture file.
#[derive(Clone, Debug)]
pub struct Imported {
    /// The file.
    pub file: MocapFile,
    /// The pose that was chosen.
    pub chosen: Chosen,
    /// The session.
    pub log: SessionLog,
    /// Frame and clock of the poses, in words.
    pub world: String,
}

/// Makes a session of a motion-capture file.
///
/// # Errors
/// When the file does not read, holds several objects and none was chosen, or the session cannot be written; then
/// nothing is left behind.
pub fn import(a: &Options) -> Result<Imported> {
    let file = read_mocap(&a.file, a.rotation)?;
    let chosen = choose(&file, a)?;
    let mut log = session(&file, chosen.object(), &a.out)?;
    let world = match &a.registration {
        None => WORLD.to_owned(),
        Some(path) => place(&mut log, &chosen, path, a.robot_clock)?,
    };
    write_as(&a.out, &log)?;
    Ok(Imported {
        file,
        chosen,
        log,
        world,
    })
}

/// Makes a session of a bag (`.mcap`) that this program wrote.
///
/// # Errors
/// When it is no such bag, or the session cannot be written; then nothing is left behind.
pub fn import_bag(file: &Path, out: &Path) -> Result<OwnBag> {
    let bag = read_mcap(file)?;
    write_as(out, &bag.log)?;
    Ok(bag)
}

/// Puts the poses into the robot's base, and on request onto its clock; returns that in words.
fn place(log: &mut SessionLog, chosen: &Chosen, path: &Path, clock: bool) -> Result<String> {
    let Chosen::Object(object) = chosen else {
        anyhow::bail!(
            "a body of markers has axes of its own in every file, and {} speaks of an object's: define the object \
             in the motion-capture program, or register this very session with springtwin calibrate mocap",
            path.display()
        );
    };
    let registration =
        Registration::from_toml(&read_toml(path)?).with_context(|| path.display().to_string())?;
    anyhow::ensure!(
        registration.object == object.name,
        "{} was made for the object '{}', not for '{}': calibrate with --object '{}'",
        path.display(),
        registration.object,
        object.name,
        object.name
    );
    for pose in log.truth.iter_mut().flatten() {
        *pose = registration.ground_truth_pose(pose);
    }
    if clock {
        for t_s in &mut log.t_s {
            *t_s = registration.robot_time_s(*t_s).with_context(|| {
                format!(
                    "{} holds no clock offset, since it rests on settled poses: leave --robot-clock out, or make \
                     one with springtwin calibrate mocap",
                    path.display()
                )
            })?;
        }
    }
    Ok(format!(
        "poses are of the end pad in the robot's base, by {}; time is {}",
        path.display(),
        if clock {
            "that of the robot's recording"
        } else {
            "counted from the first frame"
        }
    ))
}

/// The pose that was chosen.
#[derive(Clone, Debug)]
pub enum Chosen {
    /// An object of the file.
    Object(MocapObject),
    /// A body of markers.
    Body(MarkerBody),
}

impl Chosen {
    /// The object with its poses.
    pub fn object(&self) -> &MocapObject {
        match self {
            Self::Object(object) => object,
            Self::Body(body) => &body.object,
        }
    }
}

fn choose(file: &MocapFile, a: &Options) -> Result<Chosen> {
    if let Some(markers) = &a.markers {
        let name = format!("markers {}", markers.join(" "));
        return Ok(Chosen::Body(marker_body(file, &name, markers)?));
    }
    if let Some(subject) = &a.subject {
        let markers: Vec<String> = file
            .markers
            .iter()
            .map(|m| &m.name)
            .filter(|n| n.split_once(':').is_some_and(|(s, _)| s == subject))
            .cloned()
            .collect();
        anyhow::ensure!(
            !markers.is_empty(),
            "{} has no markers of a subject '{subject}'; {}",
            a.file.display(),
            subjects(file)
        );
        return Ok(Chosen::Body(marker_body(file, subject, &markers)?));
    }
    let names: Vec<&str> = file.objects.iter().map(|o| o.name.as_str()).collect();
    let Some(wanted) = &a.object else {
        return match &file.objects[..] {
            [one] => Ok(Chosen::Object(one.clone())),
            [] => anyhow::bail!(
                "{} holds markers and no object: make one of three or more with --subject or --markers; {}",
                a.file.display(),
                subjects(file)
            ),
            _ => anyhow::bail!(
                "{} holds {} objects: choose one with --object; there are {}",
                a.file.display(),
                names.len(),
                names.join(", ")
            ),
        };
    };
    let is = |o: &&MocapObject| {
        o.name == *wanted || o.name.split_once(':').is_some_and(|(_, n)| n == wanted)
    };
    let exact = file.objects.iter().find(|o| o.name == *wanted);
    let mut short = file.objects.iter().filter(is);
    let found = exact.or(short.next().filter(|_| short.next().is_none()));
    found.cloned().map(Chosen::Object).with_context(|| {
        format!(
            "{} has no one object '{wanted}'; it has {}",
            a.file.display(),
            if names.is_empty() {
                "markers only".to_owned()
            } else {
                names.join(", ")
            }
        )
    })
}

fn subjects(file: &MocapFile) -> String {
    let named = file.subjects();
    if file.markers.is_empty() {
        "it holds no markers".to_owned()
    } else if named.is_empty() {
        let names: Vec<&str> = file.markers.iter().map(|m| m.name.as_str()).collect();
        format!("its markers have no subject: {}", names.join(", "))
    } else {
        format!("its subjects are {}", named.join(", "))
    }
}

/// A session of motion capture alone; every other signal is a gap.
fn session(file: &MocapFile, object: &MocapObject, out: &Path) -> Result<SessionLog> {
    anyhow::ensure!(
        object.poses.iter().any(Option::is_some),
        "{}: {} is seen in none of its {} frames",
        file.path.display(),
        object.name,
        file.frames.len()
    );
    for (frame, pose) in file.frames.iter().zip(&object.poses) {
        let far_m = pose.map_or(0.0, |p| p.translation.vector.amax());
        anyhow::ensure!(
            far_m <= COORDINATE_MAX_M,
            "{}: {} is {far_m:.1} m from the origin in frame {frame}; a session takes {COORDINATE_MAX_M} m: check the units",
            file.path.display(),
            object.name
        );
    }
    let n = file.frames.len();
    Ok(SessionLog {
        name: out
            .file_name()
            .unwrap_or_default()
            .to_string_lossy()
            .into_owned(),
        rate_hz: file.rate_hz / file.usual_step() as f64,
        payload_kg: 0.0,
        t_s: file.t_s.clone(),
        chamber_pa: vec![[f64::NAN; CHAMBERS]; n],
        sensors: vec![
            SensorVec {
                spring_m: [f64::NAN; SPRINGS],
                imu_ypr_rad: [[f64::NAN; 3]; IMUS],
            };
            n
        ],
        truth: object.poses.clone(),
        ..SessionLog::default()
    })
}

/// Writes a session into a folder, over one that is there.
pub(super) fn write_as(out: &Path, log: &SessionLog) -> Result<()> {
    match out.exists() {
        true => Ok(write_session(out, log)?),
        false => write_new(out, log),
    }
}

/// Writes a session into a folder that is whole or not there.
fn write_new(out: &Path, log: &SessionLog) -> Result<()> {
    let mut name = out.file_name().unwrap_or_default().to_owned();
    name.push(format!(".{}.part", std::process::id()));
    let part = out.with_file_name(name);
    let written = write_session(&part, log).map_err(anyhow::Error::from);
    let moved = written.and_then(|()| {
        std::fs::rename(&part, out).with_context(|| format!("cannot make {}", out.display()))
    });
    if moved.is_err() {
        // The error that matters is the first one.
        let _ = std::fs::remove_dir_all(&part);
    }
    moved
}
