//! C3D: points, their names and their frames.
//!
//! | where | |
//! |---|---|
//! | byte 1 | number of the first parameter block (512 bytes each, counted from 1) |
//! | byte 2 | 80 |
//! | words 2, 3 | points, analogue values per frame |
//! | words 4, 5 | first and last frame, at most 65535 |
//! | word 9 | first data block |
//! | words 11-12 | frames per second |
//!
//! The parameters' fourth byte is the processor: 84 Intel, 85 DEC, 86 MIPS. Of the parameters the
//! groups `POINT` and `TRIAL` are used, and take precedence over the header. A frame is, per point, x, y, z
//! and a fourth word whose negative sign marks an invalid point, then analogue values. `POINT:SCALE`
//! below 0 means floats; above 0 it multiplies integers.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use nalgebra::Vector3;

use super::columns::POSITION_MAX_M;
use super::file::{MocapFile, MocapFormat, MocapMarker, RATE_MAX_HZ, unsupported};
use super::table::metres;
use crate::recording::RecordingError;

const BLOCK: usize = 512;
/// Values of the format's 16-bit counts from here on mean "this or more".
const COUNT_MAX: u64 = 65_535;

/// Whether a file begins like C3D.
pub(super) fn is_c3d(head: &[u8]) -> bool {
    // A text has no byte below a tab in front of a 'P'.
    matches!(head, [1..=8, 0x50, ..])
        || (head.len() >= BLOCK && matches!(head, [1..=255, 0x50, ..]) && head.contains(&0))
}

#[derive(Clone, Copy, PartialEq)]
enum Order {
    Intel,
    Dec,
    Mips,
}

/// The bytes of a file and how its numbers are written.
struct Bytes<'a> {
    data: &'a [u8],
    order: Order,
    path: &'a Path,
}

impl<'a> Bytes<'a> {
    fn corrupt(&self, offset: usize, text: impl Into<String>) -> RecordingError {
        RecordingError::Corrupt {
            path: self.path.to_owned(),
            offset: offset as u64,
            text: text.into(),
        }
    }

    fn get(&self, at: usize, len: usize) -> Result<&'a [u8], RecordingError> {
        at.checked_add(len)
            .and_then(|end| self.data.get(at..end))
            .ok_or_else(|| {
                self.corrupt(
                    self.data.len(),
                    format!("the file ends, but byte {at} and {len} more are needed: copy or export it again"),
                )
            })
    }

    fn u16(&self, at: usize) -> Result<u16, RecordingError> {
        Ok(u16_of(self.get(at, 2)?, self.order))
    }

    fn f32(&self, at: usize) -> Result<f32, RecordingError> {
        Ok(f32_of(self.get(at, 4)?, self.order))
    }
}

fn u16_of(b: &[u8], order: Order) -> u16 {
    let b = [b[0], b[1]];
    match order {
        Order::Mips => u16::from_be_bytes(b),
        _ => u16::from_le_bytes(b),
    }
}

fn f32_of(b: &[u8], order: Order) -> f32 {
    match order {
        Order::Intel => f32::from_le_bytes([b[0], b[1], b[2], b[3]]),
        Order::Mips => f32::from_be_bytes([b[0], b[1], b[2], b[3]]),
        // Words swapped, and an exponent that is larger by two.
        Order::Dec => f32::from_le_bytes([b[2], b[3], b[0], b[1]]) / 4.0,
    }
}

/// A parameter section has 255 blocks at most.
const SECTION_BYTES_MAX: usize = 255 * 512;

/// One parameter.
struct Parameter<'a> {
    /// Bytes per value; -1 for text.
    kind: i8,
    dims: &'a [u8],
    data: &'a [u8],
    order: Order,
}

impl Parameter<'_> {
    fn numbers(&self) -> Vec<f64> {
        match self.kind {
            1 => self.data.iter().map(|b| f64::from(*b)).collect(),
            2 => self
                .data
                .chunks_exact(2)
                .map(|b| f64::from(u16_of(b, self.order)))
                .collect(),
            4 => self
                .data
                .chunks_exact(4)
                .map(|b| f64::from(f32_of(b, self.order)))
                .collect(),
            _ => Vec::new(),
        }
    }

    fn number(&self) -> Option<f64> {
        self.numbers().first().copied()
    }

    /// A count that is one number, or two 16-bit halves, the lower first.
    fn count(&self) -> Option<i64> {
        let n = self.numbers();
        let sound = |v: &f64| v.is_finite() && *v >= 0.0 && *v < 4.3e9;
        match (self.kind, n.as_slice()) {
            (2, [low, high, ..]) => Some(*low as i64 + ((*high as i64) << 16)),
            (_, [one, ..]) if sound(one) => Some(*one as i64),
            _ => None,
        }
    }

    /// At most so many texts.
    fn texts(&self, most: usize) -> Vec<String> {
        let length = usize::from(self.dims.first().copied().unwrap_or(0));
        if self.kind != -1 || length == 0 {
            return Vec::new();
        }
        self.data
            .chunks_exact(length)
            .take(most)
            .map(|b| {
                let text = String::from_utf8_lossy(b);
                text.trim_matches([' ', '\0', '\t']).to_owned()
            })
            .collect()
    }
}

type Parameters<'a> = BTreeMap<(String, String), Parameter<'a>>;

/// Reads such a file.
pub(super) fn parse(data: &[u8], path: &Path) -> Result<MocapFile, RecordingError> {
    let mut bytes = Bytes {
        data,
        order: Order::Intel,
        path,
    };
    let Some(before) = usize::from(bytes.get(0, 1)?[0]).checked_sub(1) else {
        return Err(bytes.corrupt(0, "the file does not state where its parameters are"));
    };
    let start = before * BLOCK;
    let processor = bytes.get(start, 4)?[3];
    bytes.order = match processor {
        84 => Order::Intel,
        85 => Order::Dec,
        86 => Order::Mips,
        other => {
            return Err(bytes.corrupt(
                start + 3,
                format!("processor {other} is unknown: expected 84 (Intel), 85 (DEC) or 86 (MIPS)"),
            ));
        }
    };
    let parameters = parameters(&bytes, start + 4)?;
    let layout = Layout::new(&bytes, &parameters)?;
    points(&bytes, &parameters, &layout)
}

/// The parameters by the names of group and parameter, in upper case.
fn parameters<'a>(bytes: &Bytes<'a>, mut at: usize) -> Result<Parameters<'a>, RecordingError> {
    let mut groups = BTreeMap::new();
    let mut found = Vec::new();
    let end = at + SECTION_BYTES_MAX;
    // A record's length moves on by two bytes at least: this ends.
    loop {
        let head = bytes.get(at, 2)?;
        let length = usize::from((head[0] as i8).unsigned_abs());
        let group = head[1] as i8;
        if length == 0 {
            break;
        }
        let name = bytes.get(at + 2, length)?;
        let name = String::from_utf8_lossy(name).trim().to_ascii_uppercase();
        let next_at = at + 2 + length;
        let next = usize::from(bytes.u16(next_at)?);
        if group < 0 {
            groups.insert(group.unsigned_abs(), name);
        } else if let Some(p) = parameter(bytes, next_at + 2)? {
            found.push((group.unsigned_abs(), name, p));
        }
        if next == 0 {
            break;
        }
        if next < 2 {
            return Err(bytes.corrupt(
                next_at,
                "a parameter points at itself: export the file again",
            ));
        }
        at = next_at + next;
        if at > end {
            return Err(bytes.corrupt(
                at,
                "the parameters go on beyond their section: export the file again",
            ));
        }
    }
    Ok(found
        .into_iter()
        .filter_map(|(group, name, p)| Some(((groups.get(&group)?.clone(), name), p)))
        .collect())
}

/// One parameter's values; `None` for a kind that does not exist.
fn parameter<'a>(bytes: &Bytes<'a>, at: usize) -> Result<Option<Parameter<'a>>, RecordingError> {
    let head = bytes.get(at, 2)?;
    let kind = head[0] as i8;
    if !matches!(kind, -1 | 1 | 2 | 4) {
        return Ok(None);
    }
    let n = usize::from(head[1]);
    let dims = bytes.get(at + 2, n)?;
    let size = dims
        .iter()
        .try_fold(usize::from(kind.unsigned_abs()), |s, d| {
            s.checked_mul(usize::from(*d))
        })
        .ok_or_else(|| {
            bytes.corrupt(
                at,
                "a parameter's size is beyond all sense: export the file again",
            )
        })?;
    Ok(Some(Parameter {
        kind,
        data: bytes.get(at + 2 + n, size)?,
        dims,
        order: bytes.order,
    }))
}

fn parameter_of<'p, 'a>(
    parameters: &'p Parameters<'a>,
    group: &str,
    name: &str,
) -> Option<&'p Parameter<'a>> {
    parameters.get(&(group.to_owned(), name.to_owned()))
}

/// Where the frames are.
struct Layout {
    points: usize,
    rate_hz: f64,
    /// Below 0: floats.
    scale: f64,
    to_m: f64,
    unit: String,
    first_frame: i64,
    frames: usize,
    /// First byte.
    start: usize,
    /// Bytes per frame and per point.
    stride: usize,
    point_bytes: usize,
    notes: Vec<String>,
}

impl Layout {
    fn new(bytes: &Bytes<'_>, parameters: &Parameters<'_>) -> Result<Self, RecordingError> {
        let point = |name: &str| parameter_of(parameters, "POINT", name);
        let mut notes = Vec::new();
        let points = match point("USED").and_then(Parameter::count) {
            Some(n) => usize::try_from(n).unwrap_or(0),
            None => usize::from(bytes.u16(2)?),
        };
        if points == 0 {
            return Err(unsupported(
                bytes.path,
                "the file holds no points: export it with trajectories",
            ));
        }
        let rate_hz = match point("RATE").and_then(Parameter::number) {
            Some(r) => r,
            None => f64::from(bytes.f32(20)?),
        };
        if !(rate_hz > 0.0 && rate_hz <= RATE_MAX_HZ) {
            return Err(bytes.corrupt(
                20,
                format!("{rate_hz} frames per second: export the file again"),
            ));
        }
        let scale = match point("SCALE").and_then(Parameter::number) {
            Some(s) => s,
            None => f64::from(bytes.f32(12)?),
        };
        if !scale.is_finite() || scale == 0.0 {
            return Err(bytes.corrupt(
                12,
                "the scale of the points is missing: export the file again",
            ));
        }
        let unit = point("UNITS").and_then(|p| p.texts(1).into_iter().next());
        let unit = unit.filter(|u| !u.is_empty()).unwrap_or_else(|| {
            notes.push("the file does not state its unit of length: it was taken as mm".to_owned());
            "mm".to_owned()
        });
        let to_m = metres(&unit).ok_or_else(|| {
            unsupported(
                bytes.path,
                format!("the points are in {unit:?}: export them in mm, cm or m"),
            )
        })?;
        let block = match point("DATA_START").and_then(Parameter::count) {
            Some(n) if n > 0 => usize::try_from(n).unwrap_or(0),
            _ => usize::from(bytes.u16(16)?),
        };
        if block == 0 {
            return Err(bytes.corrupt(
                16,
                "the file does not state where its data begin: export it again",
            ));
        }
        let value_bytes = if scale < 0.0 { 4 } else { 2 };
        let point_bytes = 4 * value_bytes;
        let stride = points * point_bytes + usize::from(bytes.u16(4)?) * value_bytes;
        let (first_frame, frames) = frames(bytes, parameters, &mut notes)?;
        let layout = Self {
            points,
            rate_hz,
            scale,
            to_m,
            unit,
            first_frame,
            frames: usize::try_from(frames).unwrap_or(0),
            start: (block - 1) * BLOCK,
            stride,
            point_bytes,
            notes,
        };
        // The length is checked before memory is reserved.
        let length = layout.frames.checked_mul(stride);
        let there = bytes.data.len().saturating_sub(layout.start);
        if length.is_none_or(|n| n > there) {
            return Err(bytes.corrupt(
                bytes.data.len(),
                format!(
                    "the file ends after {} of {} frames: copy or export it again",
                    there / stride,
                    layout.frames
                ),
            ));
        }
        Ok(layout)
    }
}

/// Number of the first frame, and how many there are. Long files hold it in `TRIAL`, in 32 bits.
fn frames(
    bytes: &Bytes<'_>,
    parameters: &Parameters<'_>,
    notes: &mut Vec<String>,
) -> Result<(i64, u64), RecordingError> {
    let (first, last) = (u64::from(bytes.u16(6)?), u64::from(bytes.u16(8)?));
    let by_header = (last + 1).checked_sub(first).filter(|n| *n > 0);
    let whole = last < COUNT_MAX;
    let trial = |name: &str| parameter_of(parameters, "TRIAL", name).and_then(Parameter::count);
    let by_trial = trial("ACTUAL_START_FIELD")
        .zip(trial("ACTUAL_END_FIELD"))
        .filter(|(a, b)| a <= b);
    let point = |name: &str| {
        let n = parameter_of(parameters, "POINT", name).and_then(Parameter::count)?;
        u64::try_from(n).ok().filter(|n| *n > 0)
    };
    let by_points = point("LONG_FRAMES").or(point("FRAMES").filter(|n| *n < COUNT_MAX));
    let header_first = first as i64;
    match (by_trial, by_header) {
        // Two against one: a file that was cut after it was recorded.
        (Some((a, b)), Some(n)) if whole && by_points == Some(n) && (b - a + 1) as u64 != n => {
            notes.push(format!(
                "TRIAL states {} frames, the header and POINT:FRAMES of {n}: the latter were taken",
                b - a + 1
            ));
            Ok((header_first, n))
        }
        (Some((a, b)), _) => Ok((a, (b - a + 1) as u64)),
        (None, header) => by_points
            .or(header)
            .map(|n| (header_first, n))
            .ok_or_else(|| bytes.corrupt(6, "the file does not state how many frames it has")),
    }
}

/// What is known of each point: its label, unless it is no marker.
fn labels(
    parameters: &Parameters<'_>,
    points: usize,
    notes: &mut Vec<String>,
) -> Vec<Option<String>> {
    let point = |name: &str, most| parameter_of(parameters, "POINT", name).map(|p| p.texts(most));
    let mut labels: Vec<Option<String>> = Vec::new();
    for n in 1.. {
        let name = if n == 1 {
            "LABELS".to_owned()
        } else {
            format!("LABELS{n}")
        };
        let left = points - labels.len();
        let Some(more) = point(&name, left).filter(|_| left > 0) else {
            break;
        };
        labels.extend(more.into_iter().map(|l| Some(l).filter(|l| !l.is_empty())));
    }
    labels.resize(points, None);
    let nameless = points - labels.iter().flatten().count();
    if nameless > 0 {
        notes.push(format!("{nameless} points without a label were ignored"));
    }
    // Models write their results among the points.
    let kinds = ["ANGLES", "FORCES", "MOMENTS", "POWERS", "SCALARS"];
    let results: BTreeSet<String> = kinds
        .iter()
        .filter_map(|k| point(k, points))
        .flatten()
        .collect();
    let mut over = 0;
    for label in &mut labels {
        if label.as_ref().is_some_and(|l| results.contains(l)) {
            *label = None;
            over += 1;
        }
    }
    if over > 0 {
        notes.push(format!(
            "{over} points that are angles, forces or the like were ignored"
        ));
    }
    labels
}

fn points(
    bytes: &Bytes<'_>,
    parameters: &Parameters<'_>,
    layout: &Layout,
) -> Result<MocapFile, RecordingError> {
    let mut file = MocapFile::new(bytes.path, MocapFormat::C3d);
    file.rate_hz = layout.rate_hz;
    file.units.clone_from(&layout.unit);
    file.notes.clone_from(&layout.notes);
    file.frames = (0..layout.frames as i64)
        .map(|n| layout.first_frame + n)
        .collect();
    let labels = labels(parameters, layout.points, &mut file.notes);
    for (i, label) in labels.into_iter().enumerate() {
        let Some(name) = label else { continue };
        let mut positions_m = Vec::with_capacity(layout.frames);
        for n in 0..layout.frames {
            let at = layout.start + n * layout.stride + i * layout.point_bytes;
            let raw = bytes.get(at, layout.point_bytes)?;
            let position = position_m(raw, bytes.order, layout);
            if let Some(p) = position
                && p.amax() > POSITION_MAX_M
            {
                return Err(bytes.corrupt(
                    at,
                    format!(
                        "{name} is {:.0} m from the origin: check units and scale",
                        p.amax()
                    ),
                ));
            }
            positions_m.push(position);
        }
        file.markers.push(MocapMarker { name, positions_m });
    }
    file.finish()
}

/// A point in m; `None` when its fourth word is below 0 or a number is none.
fn position_m(raw: &[u8], order: Order, layout: &Layout) -> Option<Vector3<f64>> {
    let v: [f64; 4] = if layout.scale < 0.0 {
        std::array::from_fn(|k| f64::from(f32_of(&raw[4 * k..], order)))
    } else {
        std::array::from_fn(|k| {
            let v = f64::from(u16_of(&raw[2 * k..], order) as i16);
            if k < 3 { v * layout.scale } else { v }
        })
    };
    let sound = v.iter().all(|x| x.is_finite()) && v[3] >= 0.0;
    sound.then(|| Vector3::new(v[0], v[1], v[2]) * layout.to_m)
}
