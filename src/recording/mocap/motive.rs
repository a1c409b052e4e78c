//! Tables of OptiTrack Motive, format version 1.2 and later.
//!
//! ```text
//! Format Version,1.23,Take Name,a,Export Frame Rate,120.000000,Rotation Type,Quaternion,Length Units,Meters,Coordinate Space,Global
//!
//! ,Type,Rigid Body,Rigid Body,...,Marker,Marker,Marker
//! ,Name,pad,pad,...,pad:Marker1,pad:Marker1,pad:Marker1
//! ,ID,"A1",...
//! ,,Rotation,Rotation,Rotation,Rotation,Position,Position,Position,Mean Marker Error,Position,...
//! Frame,Time (Seconds),X,Y,Z,W,X,Y,Z,,X,Y,Z
//! ```
//!
//! `Rigid Body Marker` columns are where the solved body has its markers; they are read only where the file
//! has no `Marker` of that name. Motive's y axis points up, and it stays so here.

use std::collections::BTreeSet;
use std::io::BufRead;
use std::path::Path;

use nalgebra::Vector3;

use super::columns::{Position, Turn};
use super::file::{MocapFile, MocapFormat, MocapMarker, MocapObject, RATE_MAX_HZ, unsupported};
use super::rotation::MocapRotation;
use super::table::{LINE_MAX, Row, Seen, Table, metres, unit_of};
use crate::recording::RecordingError;
use crate::recording::csv::Lines;

/// Header lines below the first one: kinds, names, identifiers, parents, quantities, axes.
const HEADER_LINES_MAX: usize = 16;
/// Cells of all of them together.
const HEADER_CELLS_MAX: usize = 1_000_000;

/// Whether a file begins like such a table.
pub(super) fn is_motive(head: &[u8]) -> bool {
    let head = head.strip_prefix(b"\xef\xbb\xbf").unwrap_or(head);
    let head = head.strip_prefix(b"\"").unwrap_or(head);
    head.starts_with(b"Format Version")
}

/// Properties in the first line.
struct About {
    rate_hz: f64,
    /// m per unit, and its name.
    to_m: f64,
    unit: &'static str,
    /// `None` when it is not stated.
    rotation: Option<MocapRotation>,
}

impl About {
    fn new(row: &Row<'_>) -> Result<Self, RecordingError> {
        // The value's column.
        let find = |key: &str| {
            (0..row.len().saturating_sub(1))
                .find(|c| row.text(*c).eq_ignore_ascii_case(key))
                .map(|c| c + 1)
        };
        let version = row.text(1);
        let newer = version
            .strip_prefix("1.")
            .is_some_and(|minor| !minor.starts_with(['0', '1']) && !minor.is_empty());
        if !newer {
            return Err(row.refuse(
                1,
                format!("format version {version:?}: export with version 1.2 or later (1.2x)"),
            ));
        }
        let rate = find("Export Frame Rate").or_else(|| find("Capture Frame Rate"));
        let Some(rate) = rate else {
            return Err(row.refuse(0, "the frame rate is missing: export with the whole header"));
        };
        let rate_hz = row.number(rate)?.unwrap_or(0.0);
        if !(rate_hz > 0.0 && rate_hz <= RATE_MAX_HZ) {
            return Err(row.refuse(rate, "the frame rate must be above 0 Hz"));
        }
        let Some(length) = find("Length Units") else {
            return Err(row.refuse(
                0,
                "the length units are missing: export with the whole header",
            ));
        };
        let Some(to_m) = metres(row.text(length)) else {
            return Err(row.refuse(
                length,
                format!(
                    "{:?}: export in Meters, Centimeters or Millimeters",
                    row.text(length)
                ),
            ));
        };
        if let Some(space) = find("Coordinate Space")
            && row.text(space).eq_ignore_ascii_case("local")
        {
            return Err(row.refuse(
                space,
                "coordinates are local: export with Coordinate Space Global",
            ));
        }
        let rotation = match find("Rotation Type") {
            None => None,
            Some(c) => Some(rotation_of(row.text(c)).ok_or_else(|| {
                row.refuse(
                    c,
                    format!(
                        "{:?} is not a rotation type: expected Quaternion or an order such as XYZ",
                        row.text(c)
                    ),
                )
            })?),
        };
        Ok(Self {
            rate_hz,
            to_m,
            unit: unit_of(to_m),
            rotation,
        })
    }
}

fn rotation_of(text: &str) -> Option<MocapRotation> {
    if text.eq_ignore_ascii_case("quaternion") {
        return Some(MocapRotation::Quaternion);
    }
    let axes: Vec<usize> = text
        .bytes()
        .map(|b| b"xyz".iter().position(|a| *a == b.to_ascii_lowercase()))
        .collect::<Option<_>>()?;
    let order: [usize; 3] = axes.try_into().ok()?;
    let all: BTreeSet<usize> = order.into_iter().collect();
    (all.len() == 3).then_some(MocapRotation::Euler(order))
}

/// Columns of one thing.
struct Group {
    kind: String,
    name: String,
    id: String,
    /// `X`, `Y`, `Z` of the position.
    position: [Option<usize>; 3],
    /// `X`, `Y`, `Z`, `W` of the rotation.
    rotation: [Option<usize>; 4],
}

/// The header below the first line.
struct Header {
    kinds: Vec<String>,
    names: Vec<String>,
    ids: Vec<String>,
    quantities: Vec<String>,
}

impl Header {
    /// From the lines between the first one and that of the axes, which `axes` is.
    fn new(above: Vec<Vec<String>>, axes: &Row<'_>) -> Result<Self, RecordingError> {
        let labelled = |label: &str| {
            above
                .iter()
                .find(|r| r.get(1).is_some_and(|t| t.eq_ignore_ascii_case(label)))
        };
        // Older versions leave the labels out; the order is the same.
        let (Some(kinds), Some(names), Some(quantities)) = (
            labelled("Type").or(above.first()),
            labelled("Name").or(above.get(1)),
            above.last().filter(|_| above.len() >= 3),
        ) else {
            return Err(axes.refuse(
                0,
                "the lines of types, names and quantities are missing above: export with the header",
            ));
        };
        let ids = labelled("ID").or(above.get(2).filter(|_| above.len() >= 4));
        Ok(Self {
            kinds: kinds.clone(),
            names: names.clone(),
            ids: ids.cloned().unwrap_or_default(),
            quantities: quantities.clone(),
        })
    }

    fn groups(&self, axes: &Row<'_>) -> Vec<Group> {
        fn at(row: &[String], c: usize) -> &str {
            row.get(c).map_or("", String::as_str)
        }
        let mut groups: Vec<Group> = Vec::new();
        for c in 2..axes.len() {
            let kind = at(&self.kinds, c);
            let quantity = at(&self.quantities, c);
            let (is_position, is_rotation) = (
                quantity.eq_ignore_ascii_case("position"),
                quantity.eq_ignore_ascii_case("rotation"),
            );
            let axis = ["x", "y", "z", "w"]
                .iter()
                .position(|a| axes.text(c).eq_ignore_ascii_case(a));
            let Some(axis) = axis.filter(|a| is_rotation || (is_position && *a < 3)) else {
                continue;
            };
            if kind.is_empty() {
                continue;
            }
            let (name, id) = (at(&self.names, c), at(&self.ids, c));
            let same = groups.last().is_some_and(|g| {
                let taken = if is_position {
                    g.position[axis]
                } else {
                    g.rotation[axis]
                };
                g.kind == kind && g.name == name && g.id == id && taken.is_none()
            });
            if !same {
                groups.push(Group {
                    kind: kind.to_owned(),
                    name: name.to_owned(),
                    id: id.to_owned(),
                    position: [None; 3],
                    rotation: [None; 4],
                });
            }
            if let Some(g) = groups.last_mut() {
                let to = if is_position {
                    &mut g.position[axis]
                } else {
                    &mut g.rotation[axis]
                };
                *to = Some(c);
            }
        }
        groups
    }
}

/// What is read of each line.
#[derive(Default)]
struct Plan {
    objects: Vec<(Position, Turn)>,
    markers: Vec<Position>,
    columns: usize,
}

/// Reads such a table.
pub(super) fn parse(reader: impl BufRead, path: &Path) -> Result<MocapFile, RecordingError> {
    let seen = Seen::default();
    let mut tap = |bytes: &[u8]| seen.take(bytes);
    let lines = Lines::with_max(reader, path, &mut tap, LINE_MAX);
    let mut table = Table::new(lines, path, &seen);
    let Some(first) = table.next_row()? else {
        return Err(unsupported(path, "the file is empty"));
    };
    let about = About::new(&first)?;
    let mut file = MocapFile::new(path, MocapFormat::Motive);
    file.rate_hz = about.rate_hz;
    file.up = Some('y');
    let mut above = Vec::new();
    let mut cells = 0;
    let plan = loop {
        let Some(row) = table.next_row()? else {
            return Err(unsupported(
                path,
                "the file ends within its header: export it again",
            ));
        };
        if row.text(0).eq_ignore_ascii_case("frame") {
            let groups = Header::new(above, &row)?.groups(&row);
            break plan(&mut file, &about, groups, &row)?;
        }
        if row.is_blank() {
            continue;
        }
        let texts = row.to_texts();
        cells += texts.len();
        if cells > HEADER_CELLS_MAX {
            return Err(row.too_much());
        }
        if above.len() == HEADER_LINES_MAX {
            return Err(row.refuse(
                0,
                "the line 'Frame,Time (Seconds),...' is missing: export it again",
            ));
        }
        above.push(texts);
    };
    let mut start = None;
    while let Some(row) = table.next_row()? {
        if row.is_blank() {
            continue;
        }
        take_row(&mut file, &plan, &row, &mut start)?;
        let series = plan.objects.len() + plan.markers.len();
        if !seen.allows(file.frames.len(), series) {
            return Err(row.too_much());
        }
        seen.hold(path, series)?;
    }
    file.finish()
}

/// Sets up the series of a file, and notes what is ignored.
fn plan(
    file: &mut MocapFile,
    about: &About,
    groups: Vec<Group>,
    axes: &Row<'_>,
) -> Result<Plan, RecordingError> {
    let mut plan = Plan::default();
    let is = |g: &Group, kind: &str| g.kind.replace(' ', "").eq_ignore_ascii_case(kind);
    let measured: BTreeSet<String> = groups
        .iter()
        .filter(|g| is(g, "Marker"))
        .map(|g| g.name.clone())
        .collect();
    let (mut solved, mut over) = (0, BTreeSet::new());
    for g in &groups {
        let [Some(x), Some(y), Some(z)] = g.position else {
            over.insert(format!("{} without a whole position", g.kind));
            continue;
        };
        let position = Position {
            columns: [x, y, z],
            to_m: [about.to_m; 3],
        };
        if is(g, "RigidBody") {
            let turn = turn(about, g, axes)?;
            file.rotation.get_or_insert(turn.form);
            let last = turn.columns.iter().chain(&position.columns).max();
            plan.columns = plan.columns.max(last.map_or(0, |c| c + 1));
            plan.objects.push((position, turn));
            file.objects.push(MocapObject {
                name: g.name.clone(),
                poses: Vec::new(),
            });
        } else if is(g, "Marker") || (is(g, "RigidBodyMarker") && !measured.contains(&g.name)) {
            solved += usize::from(!is(g, "Marker"));
            plan.columns = plan.columns.max(x.max(y).max(z) + 1);
            plan.markers.push(position);
            file.markers.push(MocapMarker {
                name: g.name.clone(),
                positions_m: Vec::new(),
            });
        } else if !is(g, "RigidBodyMarker") {
            over.insert(g.kind.clone());
        }
    }
    file.units = match file.rotation {
        Some(MocapRotation::Euler(_)) => format!("{}, deg", about.unit),
        _ => about.unit.to_owned(),
    };
    file.notes
        .push("the y axis points up, as it does in Motive".to_owned());
    if matches!(file.rotation, Some(MocapRotation::Euler(_))) {
        file.notes
            .push("Euler angles were taken as turning about the body's own moving axes".to_owned());
    }
    if solved > 0 {
        file.notes.push(format!(
            "{solved} markers stand where the solved body has them, not where they were seen: the file has no others of these names"
        ));
    }
    if !over.is_empty() {
        let kinds: Vec<String> = over.into_iter().collect();
        file.notes.push(format!("ignored: {}", kinds.join(", ")));
    }
    Ok(plan)
}

/// How a rigid body's rotation is read; angles are in degrees.
fn turn(about: &About, g: &Group, axes: &Row<'_>) -> Result<Turn, RecordingError> {
    let form = match (about.rotation, g.rotation[3]) {
        (Some(form), _) => form,
        (None, Some(_)) => MocapRotation::Quaternion,
        (None, None) => {
            return Err(axes.refuse(
                0,
                "the rotation type is missing in the first line: export with the whole header",
            ));
        }
    };
    let columns = match (form, g.rotation) {
        (MocapRotation::Quaternion, [Some(x), Some(y), Some(z), Some(w)]) => [x, y, z, w],
        (MocapRotation::Euler(_), [Some(x), Some(y), Some(z), None]) => [x, y, z, x],
        _ => {
            return Err(axes.refuse(
                g.position[0].unwrap_or(0),
                format!(
                    "the rotation columns of {} do not fit the rotation type {}",
                    g.name,
                    form.name()
                ),
            ));
        }
    };
    Ok(Turn {
        form,
        columns,
        to_rad: [std::f64::consts::PI / 180.0; 3],
        taken_for_granted: false,
    })
}

/// Frame and time of the first line.
type Start = Option<(i64, f64)>;

fn take_row(
    file: &mut MocapFile,
    plan: &Plan,
    row: &Row<'_>,
    start: &mut Start,
) -> Result<(), RecordingError> {
    row.check_whole(plan.columns)?;
    let frame = row.frame(file.frames.last().copied())?;
    if let Some(t_s) = row.number(1)? {
        let (frame0, t0_s) = *start.get_or_insert((frame, t_s));
        let expected_s = (frame - frame0) as f64 / file.rate_hz;
        // Times are written to the microsecond; frames numbered at another rate are off by far more.
        let off = ((t_s - t0_s) - expected_s).abs();
        if off > (0.6 / file.rate_hz).max(1e-4 * expected_s) {
            return Err(row.refuse(
                1,
                format!(
                    "{t_s} s does not fit frame {frame} at {} frames per second: export at the rate of the capture",
                    file.rate_hz
                ),
            ));
        }
    }
    for ((position, turn), object) in plan.objects.iter().zip(&mut file.objects) {
        let pose = match (position.read(row)?, turn.read(row, &object.name)?) {
            (Some(at_m), Some(rotation)) => Some(super::rotation::pose(at_m, rotation)),
            _ => None,
        };
        object.poses.push(pose);
    }
    for (position, marker) in plan.markers.iter().zip(&mut file.markers) {
        marker
            .positions_m
            .push(position.read(row)?.map(Vector3::from));
    }
    file.frames.push(frame);
    Ok(())
}
