//! A motion-capture file in memory.

use std::path::{Path, PathBuf};

use nalgebra::Vector3;

use super::rotation::MocapRotation;
use crate::recording::RecordingError;
use crate::signal::Pose;

/// What is accepted, for refusals.
pub(super) const ACCEPTED: &str = "expected a Vicon CSV (Trajectories, Segments or Tracker objects), an OptiTrack \
                        Motive CSV (format version 1.2 or later, with its header) or a C3D file";
/// Highest frame rate that is believed, Hz.
pub(super) const RATE_MAX_HZ: f64 = 100_000.0;
/// Longest time that a session can hold, s.
const SPAN_MAX_S: f64 = 3e9;

/// A motion-capture file in memory. Series have one entry per frame; `None` is a gap.
#[derive(Clone, Debug, PartialEq)]
pub struct MocapFile {
    /// The file it came from, for refusals.
    pub path: PathBuf,
    /// What kind of file it is.
    pub format: MocapFormat,
    /// Frames per second, Hz.
    pub rate_hz: f64,
    /// Number of the first frame in the file.
    pub first_frame: i64,
    /// Frame numbers, rising; a number that is left out is a gap of everything.
    pub frames: Vec<i64>,
    /// Time since the first frame, s: (frame − first frame) / rate.
    pub t_s: Vec<f64>,
    /// Objects with a pose.
    pub objects: Vec<MocapObject>,
    /// Markers.
    pub markers: Vec<MocapMarker>,
    /// How the file writes rotations; `None` without objects.
    pub rotation: Option<MocapRotation>,
    /// Units of lengths and, after a comma, angles in the file. In memory they are m and rad.
    pub units: String,
    /// The axis of the file that points up; `None` where the format does not settle it.
    pub up: Option<char>,
    /// Ignored sections and assumptions, one sentence each.
    pub notes: Vec<String>,
}

/// A tracked object.
#[derive(Clone, Debug, PartialEq)]
pub struct MocapObject {
    /// Name as in the file, `Subject:Object`.
    pub name: String,
    /// Motion capture's world from the object, m, per frame; `None` is a gap.
    pub poses: Vec<Option<Pose>>,
}

/// A marker.
#[derive(Clone, Debug, PartialEq)]
pub struct MocapMarker {
    /// Name as in the file, `Subject:Marker`.
    pub name: String,
    /// Position in the motion capture's world, m, per frame; `None` is a gap.
    pub positions_m: Vec<Option<Vector3<f64>>>,
}

/// Kind of file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MocapFormat {
    /// Table of markers of Vicon Nexus.
    ViconTrajectories,
    /// Table of segments of Vicon.
    ViconSegments,
    /// Table of objects of Vicon Tracker.
    ViconTracker,
    /// Table of OptiTrack Motive.
    Motive,
    /// C3D.
    C3d,
}

impl MocapFormat {
    /// Its name in reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::ViconTrajectories => "vicon-trajectories",
            Self::ViconSegments => "vicon-segments",
            Self::ViconTracker => "vicon-tracker",
            Self::Motive => "motive",
            Self::C3d => "c3d",
        }
    }
}

pub(super) fn unsupported(path: &Path, text: impl Into<String>) -> RecordingError {
    RecordingError::Unsupported {
        path: path.to_owned(),
        text: text.into(),
    }
}

impl MocapFile {
    /// A file without frames.
    pub(super) fn new(path: &Path, format: MocapFormat) -> Self {
        Self {
            path: path.to_owned(),
            format,
            rate_hz: 0.0,
            first_frame: 0,
            frames: Vec::new(),
            t_s: Vec::new(),
            objects: Vec::new(),
            markers: Vec::new(),
            rotation: None,
            units: String::new(),
            up: None,
            notes: Vec::new(),
        }
    }

    /// Sets the times and checks the file as a whole, after frames, rate and series are set.
    pub(super) fn finish(mut self) -> Result<Self, RecordingError> {
        if self.objects.is_empty() && self.markers.is_empty() {
            let mut text = "the file holds no object and no marker".to_owned();
            for note in &self.notes {
                text.push_str("; ");
                text.push_str(note);
            }
            return Err(unsupported(&self.path, format!("{text}; {ACCEPTED}")));
        }
        let (Some(first), Some(last)) = (self.frames.first(), self.frames.last()) else {
            return Err(unsupported(
                &self.path,
                "the file holds no frame: export a range that is not empty",
            ));
        };
        let (first, last) = (*first, *last);
        let at_s = |frame: i64| (frame - first) as f64 / self.rate_hz;
        if at_s(last) > SPAN_MAX_S {
            return Err(unsupported(
                &self.path,
                format!(
                    "frames {first} to {last} are more than a lifetime apart: export the file again"
                ),
            ));
        }
        self.t_s = self.frames.iter().map(|f| at_s(*f)).collect();
        self.first_frame = first;
        unique(self.objects.iter_mut().map(|o| &mut o.name));
        unique(self.markers.iter_mut().map(|m| &mut m.name));
        self.note_zeros();
        Ok(self)
    }

    /// Notes poses and positions that are exactly zero, which some exporters write for objects that are not seen. They
    /// are kept.
    fn note_zeros(&mut self) {
        let zero = |v: &Vector3<f64>| v.amax() == 0.0;
        for o in &self.objects {
            let still = |p: &&Pose| zero(&p.translation.vector) && p.rotation.angle() == 0.0;
            let n = o.poses.iter().flatten().filter(still).count();
            if n > 0 {
                self.notes.push(format!(
                    "{} stands exactly at the origin, unturned, in {n} frames: the exporter may have meant that it was not seen",
                    o.name
                ));
            }
        }
        for m in &self.markers {
            let n = m.positions_m.iter().flatten().filter(|p| zero(p)).count();
            if n > 0 {
                self.notes.push(format!(
                    "marker {} is exactly at the origin in {n} frames: the exporter may have meant that it was not seen",
                    m.name
                ));
            }
        }
    }

    /// Subjects of the markers (what stands before the colon of their names), in the file's order.
    pub fn subjects(&self) -> Vec<&str> {
        let mut found: Vec<&str> = Vec::new();
        for m in &self.markers {
            if let Some((subject, _)) = m.name.split_once(':')
                && !found.contains(&subject)
            {
                found.push(subject);
            }
        }
        found
    }

    /// Frames from one line to the next, most of the time: an export may hold every tenth only.
    pub fn usual_step(&self) -> i64 {
        let mut steps: Vec<i64> = self.frames.windows(2).map(|w| w[1] - w[0]).collect();
        steps.sort_unstable();
        let middle = |upper: usize| steps.get((steps.len().saturating_sub(1) + upper) / 2);
        let (Some(low), Some(high)) = (middle(0), middle(1)) else {
            return 1;
        };
        // Of a few frames far apart the longer step is the one that a time column shows when it is read.
        if *high > 4 * *low { *high } else { *low }
    }

    /// Lines without a pose of `object`, those included that are left out.
    pub fn gaps(&self, object: &MocapObject) -> u64 {
        let empty = object.poses.iter().filter(|p| p.is_none()).count() as u64;
        // Two lines do not determine a step.
        let step = match self.frames.len() {
            0..=2 => 1,
            _ => self.usual_step().max(1),
        };
        let left_out = |w: &[i64]| ((w[1] - w[0]) / step - 1).max(0) as u64;
        empty + self.frames.windows(2).map(left_out).sum::<u64>()
    }
}

/// Numbers names that are there more than once.
fn unique<'a>(names: impl Iterator<Item = &'a mut String>) {
    let mut times = std::collections::BTreeMap::<String, usize>::new();
    for name in names {
        let n = times.entry(name.clone()).or_insert(0);
        *n += 1;
        if *n > 1 {
            *name = format!("{name} #{n}");
        }
    }
}
