//! What the columns of a Vicon section are, and how their cells are read.

use nalgebra::UnitQuaternion;

use super::file::MocapFormat;
use super::rotation::{FromQuaternion, MocapRotation, from_euler, from_helical, from_xyzw};
use super::table::{Row, metres, radians, unit_of};
use crate::recording::RecordingError;

/// Largest plausible distance from the origin, m.
pub(super) const POSITION_MAX_M: f64 = 1e4;
/// More turns than any cable takes, rad.
const ANGLE_MAX_RAD: f64 = 1e3;

/// The columns of a position.
pub(super) struct Position {
    pub(super) columns: [usize; 3],
    pub(super) to_m: [f64; 3],
}

impl Position {
    /// m; `None` for a gap.
    pub(super) fn read(&self, row: &Row<'_>) -> Result<Option<[f64; 3]>, RecordingError> {
        let Some(v) = row.numbers(self.columns)? else {
            return Ok(None);
        };
        let v: [f64; 3] = std::array::from_fn(|i| v[i] * self.to_m[i]);
        match v.iter().position(|x| x.abs() > POSITION_MAX_M) {
            Some(i) => Err(row.refuse(
                self.columns[i],
                format!("{:.0} m from the origin: check the units", v[i]),
            )),
            None => Ok(Some(v)),
        }
    }
}

/// The columns of a rotation.
pub(super) struct Turn {
    pub(super) form: MocapRotation,
    /// Those of x, y, z and, for a quaternion, w.
    pub(super) columns: [usize; 4],
    pub(super) to_rad: [f64; 3],
    /// Whether the file does not state the form and it was assumed.
    pub(super) taken_for_granted: bool,
}

impl Turn {
    /// `None` for a gap.
    pub(super) fn read(
        &self,
        row: &Row<'_>,
        name: &str,
    ) -> Result<Option<UnitQuaternion<f64>>, RecordingError> {
        let [x, y, z, w] = self.columns;
        if self.form == MocapRotation::Quaternion {
            let Some(q) = row.numbers([x, y, z, w])? else {
                return Ok(None);
            };
            return match from_xyzw(q) {
                FromQuaternion::Rotation(r) => Ok(Some(r)),
                FromQuaternion::Nothing => Ok(None),
                FromQuaternion::NotUnit(norm) => Err(row.refuse(
                    x,
                    format!("the quaternion of {name} has length {norm:.3}, not 1"),
                )),
            };
        }
        let Some(v) = row.numbers([x, y, z])? else {
            return Ok(None);
        };
        let v: [f64; 3] = std::array::from_fn(|i| v[i] * self.to_rad[i]);
        if let Some(i) = v.iter().position(|a| a.abs() > ANGLE_MAX_RAD) {
            return Err(row.refuse(
                self.columns[i],
                "more than a hundred turns: check the unit of rotations",
            ));
        }
        match self.form {
            MocapRotation::Euler(order) => Ok(Some(from_euler(order, v))),
            _ => {
                let turned = v.iter().map(|a| a * a).sum::<f64>().sqrt();
                if self.taken_for_granted && turned > 1.001 * std::f64::consts::PI {
                    return Err(row.refuse(
                        x,
                        format!(
                            "{name}: as a helical rotation this is more than half a turn, so these may be Euler \
                             angles, and the file does not state their form: give --rotation helical or --rotation euler-xyz"
                        ),
                    ));
                }
                Ok(Some(from_helical(v)))
            }
        }
    }
}

/// What a block of columns holds.
pub(super) enum Track {
    Marker(Position),
    Object(Position, Turn),
}

/// The columns of one marker or object.
pub(super) struct Block {
    pub(super) name: String,
    pub(super) track: Track,
}

/// What is known of a section when its units are reached.
pub(super) struct Source<'a> {
    pub(super) title: &'a str,
    pub(super) format: MocapFormat,
    pub(super) names: &'a [String],
    pub(super) columns: &'a [String],
    /// How rotations are written where the file leaves it open.
    pub(super) wanted: Option<MocapRotation>,
}

/// The parts of a heading: in `Global Angle Subject:Object` a description precedes the name.
pub(super) struct Heading<'a> {
    pub(super) name: &'a str,
    pub(super) is_global: bool,
    is_local: bool,
    description: String,
}

pub(super) fn name_of(heading: &str) -> Heading<'_> {
    const WORDS: [&str; 13] = [
        "global",
        "local",
        "angle",
        "angles",
        "rotation",
        "translation",
        "position",
        "pose",
        "helical",
        "euler",
        "xyz",
        "zyx",
        "quaternion",
    ];
    let bare = |w: &str| w.trim_matches(['(', ')', '-', ',']).to_ascii_lowercase();
    let first = bare(heading.split_whitespace().next().unwrap_or_default());
    let (is_global, is_local) = (first == "global", first == "local");
    // The name is never empty, nor is a name that merely begins with such a word cut.
    if !(is_global || is_local) || !heading.trim().contains(char::is_whitespace) {
        return Heading {
            name: heading,
            is_global: false,
            is_local: false,
            description: String::new(),
        };
    }
    let (mut name, mut description) = (heading.trim(), String::new());
    while let Some((word, rest)) = name.split_once(char::is_whitespace) {
        if !WORDS.contains(&bare(word).as_str()) {
            break;
        }
        description.push_str(&bare(word));
        description.push(' ');
        name = rest.trim_start();
    }
    Heading {
        name,
        is_global,
        is_local,
        description,
    }
}

/// Columns under one heading, by their names in lower case.
struct Group {
    name: String,
    description: String,
    is_local: bool,
    columns: Vec<(String, usize)>,
}

impl Group {
    fn find<const N: usize>(&self, names: [&str; N]) -> Option<[usize; N]> {
        let mut at = [0; N];
        for (c, name) in at.iter_mut().zip(names) {
            *c = self.columns.iter().find(|(n, _)| n == name)?.1;
        }
        Some(at)
    }

    fn has(&self, name: &str) -> bool {
        self.columns.iter().any(|(n, _)| n == name)
    }
}

/// A column's name in lower case without blanks; `Euler X`, `Helical X` and `Quaternion X` become `ex`, `hx`
/// and `qx`. Dashes stay: `X'` is a speed.
fn canonical(column: &str) -> String {
    let bare: String = column
        .to_ascii_lowercase()
        .chars()
        .filter(|c| !matches!(c, ' ' | '_' | '(' | ')'))
        .collect();
    for (word, letter) in [("euler", 'e'), ("helical", 'h'), ("quaternion", 'q')] {
        if let Some(axis @ ("x" | "y" | "z" | "w")) = bare.strip_prefix(word) {
            return format!("{letter}{axis}");
        }
    }
    bare
}

/// Columns by heading. Tracker may head angles and translations of one object apart.
fn groups(source: &Source<'_>) -> Vec<Group> {
    let has_sub_frame = has_sub_frame(source.columns);
    let mut groups: Vec<Group> = Vec::new();
    // Where the columns of each name go: a file may name thousands.
    let mut at = std::collections::BTreeMap::<String, usize>::new();
    let mut current = None;
    for (c, column) in source
        .columns
        .iter()
        .enumerate()
        .skip(1 + usize::from(has_sub_frame))
    {
        let column = canonical(column);
        if let Some(text) = source.names.get(c).filter(|t| !t.is_empty()) {
            let heading = name_of(text);
            let joins = at
                .get(heading.name)
                .copied()
                .filter(|i| !groups[*i].has(&column));
            let i = joins.unwrap_or(groups.len());
            if joins.is_none() {
                groups.push(Group {
                    name: heading.name.to_owned(),
                    description: String::new(),
                    is_local: heading.is_local,
                    columns: Vec::new(),
                });
                at.insert(heading.name.to_owned(), i);
            }
            groups[i].description.push_str(&heading.description);
            current = Some(i);
        }
        if let Some(i) = current
            && !column.is_empty()
        {
            // Of columns with one name the first counts.
            if groups[i].columns.len() < 64 && !groups[i].has(&column) {
                groups[i].columns.push((column, c));
            }
        }
    }
    groups
}

pub(super) fn has_sub_frame(columns: &[String]) -> bool {
    columns
        .get(1)
        .is_some_and(|c| c.replace(' ', "").eq_ignore_ascii_case("subframe"))
}

/// The markers and objects of a section, from its headings and its row of units.
pub(super) fn blocks(
    source: &Source<'_>,
    units: &Row<'_>,
    notes: &mut Vec<String>,
) -> Result<Vec<Block>, RecordingError> {
    let mut out = Vec::new();
    let mut over = Vec::new();
    let mut granted = false;
    for group in groups(source) {
        let markers = source.format == MocapFormat::ViconTrajectories;
        let found = if group.is_local {
            None
        } else if markers {
            group.find(["x", "y", "z"]).map(|at| (at, None))
        } else {
            let turn = turn(source, &group, units)?;
            group
                .find(["tx", "ty", "tz"])
                .zip(turn)
                .map(|(at, t)| (at, Some(t)))
        };
        let Some((columns, turn)) = found else {
            over.push(group.name);
            continue;
        };
        let position = position(columns, units)?;
        granted |= turn.as_ref().is_some_and(|t| t.taken_for_granted);
        out.push(Block {
            name: group.name,
            track: match turn {
                Some(turn) => Track::Object(position, turn),
                None => Track::Marker(position),
            },
        });
    }
    if granted {
        notes.push(
            "the file does not state how its three rotations are written: they were taken as helical, as Tracker's \
             default is; give --rotation euler-xyz if it was set to Euler angles"
                .to_owned(),
        );
    }
    if !over.is_empty() {
        let shown = over[..over.len().min(3)].join(", ");
        notes.push(format!(
            "{} headings without a whole global position{} were ignored ({shown}{})",
            over.len(),
            if source.format == MocapFormat::ViconTrajectories {
                ""
            } else {
                " and rotation"
            },
            if over.len() > 3 { ", ..." } else { "" },
        ));
    }
    Ok(out)
}

/// How a position's columns are read.
fn position(columns: [usize; 3], units: &Row<'_>) -> Result<Position, RecordingError> {
    let mut to_m = [0.0; 3];
    for (k, c) in to_m.iter_mut().zip(columns) {
        let unit = units.text(c);
        *k = metres(unit).ok_or_else(|| {
            units.refuse(
                c,
                format!("{unit:?} is not a unit of length: expected mm, cm or m"),
            )
        })?;
    }
    Ok(Position { columns, to_m })
}

/// How a group's rotation is written; `None` when it has none.
fn turn(
    source: &Source<'_>,
    group: &Group,
    units: &Row<'_>,
) -> Result<Option<Turn>, RecordingError> {
    let quaternion = group
        .find(["rx", "ry", "rz", "rw"])
        .or_else(|| group.find(["qx", "qy", "qz", "qw"]));
    if let Some(columns) = quaternion {
        return Ok(Some(Turn {
            form: MocapRotation::Quaternion,
            columns,
            to_rad: [1.0; 3],
            taken_for_granted: false,
        }));
    }
    let euler_columns = group.find(["ex", "ey", "ez"]);
    let helical_columns = group.find(["hx", "hy", "hz"]);
    let named = euler_columns.or(helical_columns);
    let Some([x, y, z]) = named.or_else(|| group.find(["rx", "ry", "rz"])) else {
        return Ok(None);
    };
    let description = format!("{} {}", source.title, group.description).to_ascii_lowercase();
    let names = |word: &str| description.contains(word);
    let euler = names("euler") || euler_columns.is_some();
    let helical = names("helical")
        || helical_columns.is_some()
        || source.format == MocapFormat::ViconSegments;
    if (euler && (helical || names("zyx"))) || names("quaternion") {
        return Err(units.refuse(
            x,
            format!(
                "{}: the form of the rotation is ambiguous: export it as helical, Euler XYZ or quaternion",
                group.name
            ),
        ));
    }
    let mut to_rad = [0.0; 3];
    for (k, c) in to_rad.iter_mut().zip([x, y, z]) {
        let unit = units.text(c);
        *k = radians(unit).ok_or_else(|| {
            units.refuse(
                c,
                format!("{unit:?} is not a unit of angles: expected deg or rad"),
            )
        })?;
    }
    let open = !(euler || helical);
    let form = match source.wanted {
        _ if euler => MocapRotation::EULER_XYZ,
        Some(wanted) if open => wanted,
        _ => MocapRotation::Helical,
    };
    if form == MocapRotation::Quaternion {
        return Err(units.refuse(
            x,
            "three columns are no quaternion: it has RX, RY, RZ and RW",
        ));
    }
    Ok(Some(Turn {
        form,
        columns: [x, y, z, x],
        to_rad,
        taken_for_granted: open && source.wanted.is_none(),
    }))
}

/// The units of a block, for the report: that of the position and, behind a comma, that of angles.
pub(super) fn units_of(block: &Block) -> (&'static str, &'static str) {
    match &block.track {
        Track::Marker(at) => (unit_of(at.to_m[0]), ""),
        Track::Object(at, turn) => {
            let angle = match turn.form {
                MocapRotation::Quaternion => "",
                _ if turn.to_rad[0] == 1.0 => "rad",
                _ => "deg",
            };
            (unit_of(at.to_m[0]), angle)
        }
    }
}
