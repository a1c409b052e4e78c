//! Sections of a Vicon table, and how they become one file.

use std::collections::BTreeMap;
use std::path::Path;

use nalgebra::Vector3;

use super::columns::{Block, Track, units_of};
use super::file::{MocapFile, MocapFormat, MocapMarker, MocapObject, unsupported};
use super::rotation::MocapRotation;
use super::table::Seen;
use crate::recording::RecordingError;
use crate::signal::Pose;

/// One value per frame, named.
type Series<T> = (String, Vec<Option<T>>);

/// A section that is read.
pub(super) struct Section {
    format: MocapFormat,
    rate_hz: f64,
    /// The line of its rate.
    line: usize,
    units: String,
    rotation: Option<MocapRotation>,
    /// Columns up to the last one that is read.
    pub(super) columns: usize,
    pub(super) has_sub_frame: bool,
    pub(super) frames: Vec<i64>,
    pub(super) markers: Vec<Series<Vector3<f64>>>,
    pub(super) objects: Vec<Series<Pose>>,
}

impl Section {
    pub(super) fn new(
        format: MocapFormat,
        (rate_hz, line): (f64, usize),
        blocks: &[Block],
        has_sub_frame: bool,
    ) -> Self {
        let mut section = Self {
            format,
            rate_hz,
            line,
            units: String::new(),
            rotation: None,
            columns: 1,
            has_sub_frame,
            frames: Vec::new(),
            markers: Vec::new(),
            objects: Vec::new(),
        };
        for block in blocks {
            let mut widen = |columns: &[usize]| {
                let last = columns.iter().max().map_or(0, |c| c + 1);
                section.columns = section.columns.max(last);
            };
            match &block.track {
                Track::Marker(at) => {
                    widen(&at.columns);
                    section.markers.push((block.name.clone(), Vec::new()));
                }
                Track::Object(at, turn) => {
                    widen(&at.columns);
                    widen(&turn.columns);
                    section.objects.push((block.name.clone(), Vec::new()));
                    section.rotation.get_or_insert(turn.form);
                }
            }
        }
        if let Some(first) = blocks.first() {
            let (length, angle) = units_of(first);
            section.units = [length, angle].join(", ");
            if angle.is_empty() {
                length.clone_into(&mut section.units);
            }
        }
        section
    }
}

/// One file of all sections, on the frames of all of them.
pub(super) fn join(
    path: &Path,
    sections: Vec<Section>,
    mut notes: Vec<String>,
    seen: &Seen,
) -> Result<MocapFile, RecordingError> {
    let format = sections
        .first()
        .map_or(MocapFormat::ViconTrajectories, |s| s.format);
    let mut file = MocapFile::new(path, format);
    let mut frames: Vec<i64> = sections
        .iter()
        .flat_map(|s| s.frames.iter().copied())
        .collect();
    frames.sort_unstable();
    frames.dedup();
    let series: usize = sections
        .iter()
        .map(|s| s.markers.len() + s.objects.len())
        .sum();
    if !seen.allows(frames.len(), series) {
        return Err(unsupported(
            path,
            "its sections are of many different frames: export them over the same range of frames",
        ));
    }
    seen.hold(path, frames.len().saturating_mul(series))?;
    let (mut markers, mut objects) = (Joint::default(), Joint::default());
    for section in sections {
        if file.rate_hz == 0.0 {
            file.rate_hz = section.rate_hz;
            file.units.clone_from(&section.units);
        }
        if section.rate_hz != file.rate_hz {
            return Err(RecordingError::Cell {
                path: path.to_owned(),
                line: section.line,
                column: 1,
                text: format!(
                    "this section has {} frames per second, the one before it {}: export them to files of their own",
                    section.rate_hz, file.rate_hz
                ),
            });
        }
        match (file.rotation, section.rotation) {
            (Some(a), Some(b)) if a != b => notes.push(format!(
                "some rotations are written as {}, some as {}: each was read as it is",
                a.name(),
                b.name()
            )),
            (None, b) => file.rotation = b,
            _ => {}
        }
        let at: Vec<usize> = section
            .frames
            .iter()
            .map(|f| frames.partition_point(|g| g < f))
            .collect();
        for (name, values) in section.markers {
            markers.take(path, &frames, name, &at, values)?;
        }
        for (name, values) in section.objects {
            objects.take(path, &frames, name, &at, values)?;
        }
    }
    file.frames = frames;
    file.markers = markers
        .series
        .into_iter()
        .map(|(name, positions_m)| MocapMarker { name, positions_m })
        .collect();
    file.objects = objects
        .series
        .into_iter()
        .map(|(name, poses)| MocapObject { name, poses })
        .collect();
    file.notes = notes;
    file.finish()
}

/// Series of several sections by name.
struct Joint<T> {
    series: Vec<Series<T>>,
    at: BTreeMap<String, usize>,
}

impl<T> Default for Joint<T> {
    fn default() -> Self {
        Self {
            series: Vec::new(),
            at: BTreeMap::new(),
        }
    }
}

impl<T: Clone + PartialEq> Joint<T> {
    /// Adds what a section holds of a name; `at` holds the places of its frames among `frames`.
    fn take(
        &mut self,
        path: &Path,
        frames: &[i64],
        name: String,
        at: &[usize],
        values: Vec<Option<T>>,
    ) -> Result<(), RecordingError> {
        let known = self.at.get(&name).copied();
        if known.is_none() && at.len() == frames.len() {
            self.at.insert(name.clone(), self.series.len());
            self.series.push((name, values));
            return Ok(());
        }
        let i = known.unwrap_or_else(|| {
            self.at.insert(name.clone(), self.series.len());
            self.series.push((name.clone(), vec![None; frames.len()]));
            self.series.len() - 1
        });
        for (value, n) in values.into_iter().zip(at) {
            let to = &mut self.series[i].1[*n];
            match (&to, value) {
                (Some(old), Some(new)) if *old != new => {
                    return Err(unsupported(
                        path,
                        format!(
                            "{name} has two different values in frame {}: a section is there twice, or two things have one name",
                            frames[*n]
                        ),
                    ));
                }
                (None, Some(new)) => *to = Some(new),
                _ => {}
            }
        }
        Ok(())
    }
}
