//! The keys of a robot file: what each is, where it is used and how it is measured; and the numbers of a file with the
//! sources that its comments state.

/// A key.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Key {
    /// Table and name.
    pub key: &'static str,
    /// Unit; empty for a number without one, or what else stands there.
    pub unit: &'static str,
    /// What is taken.
    pub bounds: &'static str,
    /// What it is, and what uses it.
    pub what: &'static str,
    /// How a lab measures it.
    pub measure: &'static str,
}

const fn key(
    key: &'static str,
    unit: &'static str,
    bounds: &'static str,
    what: &'static str,
    measure: &'static str,
) -> Key {
    Key {
        key,
        unit,
        bounds,
        what,
        measure,
    }
}

const POSITIVE: &str = "above 0";
const NOT_NEGATIVE: &str = "0 or more";
const ANY: &str = "a number";
const SHARE: &str = "above 0; may be missing";
const CALIPERS: &str = "calipers, or the drawing";
const SCALES: &str = "scales";

/// All keys, in the order of the shipped file.
pub const KEYS: &[Key] = &[
    key("name", "text", "", "its name, which recordings carry", "-"),
    key(
        "base.bellows_circle_radius_mm",
        "mm",
        "above 0, at least 1",
        "distance of the bellows from the axis: lever arm of every pressure",
        CALIPERS,
    ),
    key(
        "base.bellows_angles_deg",
        "deg",
        "six numbers",
        "direction of each bellows, from x about z",
        "the drawing",
    ),
    key(
        "base.pad_thickness_mm",
        "mm",
        NOT_NEGATIVE,
        "thickness of the middle and the end pad",
        CALIPERS,
    ),
    key(
        "bellows.inner_diameter_mm",
        "mm",
        ANY,
        "of the picture and the mesh",
        CALIPERS,
    ),
    key(
        "bellows.outer_diameter_mm",
        "mm",
        ANY,
        "of the picture, the mesh and the rig's rings",
        CALIPERS,
    ),
    key(
        "bellows.wall_mm",
        "mm",
        ANY,
        "for the record: nothing uses it",
        CALIPERS,
    ),
    key(
        "bellows.rest_length_mm",
        "mm",
        "at least 1",
        "length without pressure: every simulator",
        "length of a bellows that lies on a table",
    ),
    key(
        "bellows.length_range_mm",
        "mm",
        "low, high",
        "lengths in use: speed of the pumps, the rig's folds",
        "shortest and longest length at the ends of the pressure range",
    ),
    key(
        "bellows.effective_diameter_mm",
        "mm",
        "at least 1",
        "force per pressure: every simulator",
        "force on a scale at a known pressure; else the mean of inner and outer diameter",
    ),
    key(
        "bellows.axial_stiffness_n_m",
        "N/m",
        POSITIVE,
        "force per length of one bellows: every simulator",
        "hang two known weights on a bellows and measure both lengths",
    ),
    key(
        "segment.bending_stiffness_nm_rad",
        "Nm/rad",
        POSITIVE,
        "of a segment beyond its bellows: every simulator",
        "pull a segment sideways with a spring balance and measure its angle; `gap commission` refines it",
    ),
    key(
        "segment.torsional_stiffness_nm_rad",
        "Nm/rad",
        POSITIVE,
        "of a segment about its axis",
        "twist the end pad with a known moment",
    ),
    key(
        "segment.axial_stiffness_n_m",
        "N/m",
        "0 or more; may be missing",
        "of a core on the axis: rod model and rig",
        "as that of a bellows, with the bellows cut or vented",
    ),
    key(
        "segments.bending_stiffness_nm_rad",
        "Nm/rad",
        SHARE,
        "of one segment, in the place of the common one",
        "as above",
    ),
    key(
        "segments.torsional_stiffness_nm_rad",
        "Nm/rad",
        SHARE,
        "of one segment",
        "as above",
    ),
    key(
        "segments.axial_stiffness_n_m",
        "N/m",
        "0 or more; may be missing",
        "of one segment's core",
        "as above",
    ),
    key(
        "segments.locked",
        "",
        "true or false; may be missing",
        "whether the segment is held straight",
        "-",
    ),
    key(
        "chambers.at_mm",
        "mm",
        "two numbers; may be missing",
        "centre of one chamber in the cross-section, base frame",
        CALIPERS,
    ),
    key(
        "chambers.area_mm2",
        "mm2",
        SHARE,
        "effective area of one chamber; of chambers that share a line, their sum",
        "force on a scale at a known pressure",
    ),
    key(
        "chambers.axial_stiffness_n_m",
        "N/m",
        SHARE,
        "of one chamber",
        "as that of a bellows",
    ),
    key(
        "pressure.range_kpa",
        "kPa",
        "within -40 to 40; without springs within -100 to 2000",
        "set pressures: controllers, firmware, samples",
        "what pumps and bellows bear",
    ),
    key(
        "pressure.rate_kpa_s",
        "kPa/s",
        POSITIVE,
        "fastest change of a set pressure",
        "a step of one chamber, from its gauge",
    ),
    key(
        "pressure.over_pressure_kpa",
        "kPa",
        "beyond both ends of the range",
        "pumps are off beyond it, of either sign",
        "what the bellows bear, with a margin",
    ),
    key(
        "pressure.pump_flow_l_min",
        "l/min",
        POSITIVE,
        "flow of a pump at atmospheric pressure: times and speeds",
        "time to fill a bag of known volume; data sheet",
    ),
    key(
        "pressure.supply_off",
        "text",
        "keeps or vents; may be missing",
        "what becomes of the air when the supply is off",
        "switch it off and watch the gauges",
    ),
    key(
        "mass.bellows_kg",
        "kg",
        NOT_NEGATIVE,
        "of each bellows with its fittings",
        SCALES,
    ),
    key(
        "mass.middle_pad_kg",
        "kg",
        NOT_NEGATIVE,
        "of the middle pad with what is fixed to it",
        SCALES,
    ),
    key(
        "mass.end_pad_kg",
        "kg",
        NOT_NEGATIVE,
        "of the end pad",
        SCALES,
    ),
    key(
        "mass.gripper_kg",
        "kg",
        NOT_NEGATIVE,
        "of the gripper; 0 without one",
        SCALES,
    ),
    key(
        "mass.top_fittings_kg",
        "kg",
        ANY,
        "for the record: it hangs on the ceiling, and nothing uses it",
        SCALES,
    ),
    key(
        "mass.gripper_com_mm",
        "mm",
        ANY,
        "its centre of mass below the end pad's origin",
        "balance it on an edge",
    ),
    key(
        "mass.payload_com_mm",
        "mm",
        ANY,
        "where things hang below the end pad's origin",
        CALIPERS,
    ),
    key(
        "mass.payload_max_kg",
        "kg",
        NOT_NEGATIVE,
        "heaviest payload that is taken",
        "what the arm bears at rest",
    ),
    key(
        "springs.attachment_radius_mm",
        "mm",
        "at least 1",
        "distance of the springs' ends from the axis: estimator and rig",
        "calipers; `calibrate self` refines the ends",
    ),
    key(
        "springs.pair_angles_deg",
        "deg",
        "three numbers",
        "direction of each pair, from the segment's first bellows",
        "the drawing",
    ),
    key(
        "springs.half_spread_deg",
        "deg",
        ANY,
        "half of the angle between the upper ends of a pair",
        "the drawing",
    ),
    key(
        "springs.rate_n_m",
        "N/m",
        NOT_NEGATIVE,
        "force per length of a spring",
        "hang two known weights on a spring",
    ),
    key(
        "springs.free_length_mm",
        "mm",
        "at least 1",
        "length without a load",
        CALIPERS,
    ),
    key(
        "springs.outer_diameter_mm",
        "mm",
        POSITIVE,
        "of the coil: picture and rig",
        CALIPERS,
    ),
    key(
        "springs.wire_diameter_mm",
        "mm",
        POSITIVE,
        "of the wire: rig",
        "micrometer",
    ),
    key(
        "springs.range_mm",
        "mm",
        "within 70 to 240",
        "lengths that are read",
        "the calibration's range",
    ),
    key(
        "imus.pad",
        "text",
        "middle or end",
        "which pad carries it; the first two and the last two in this order",
        "-",
    ),
    key(
        "imus.mounting_ypr_deg",
        "deg",
        "three numbers",
        "pad from IMU, R = Rz Ry Rx",
        "the drawing; `calibrate imus` refines it",
    ),
    key(
        "motion.tip_speed_max_mm_s",
        "mm/s",
        POSITIVE,
        "fastest that the tip is driven",
        "what the task and the bellows bear",
    ),
    key(
        "tracked_bodies.base",
        "mm, deg",
        "xyz_mm, ypr_deg; may be missing",
        "motion capture's body on the base, base frame",
        "calipers, or `calibrate mocap`",
    ),
    key(
        "tracked_bodies.middle",
        "mm, deg",
        "xyz_mm, ypr_deg; may be missing",
        "the same on the middle pad, in its frame",
        CALIPERS,
    ),
    key(
        "tracked_bodies.end",
        "mm, deg",
        "xyz_mm, ypr_deg; may be missing",
        "the same on the end pad, in its frame",
        CALIPERS,
    ),
    key(
        "uncertainty.area",
        "share",
        SHARE,
        "one standard deviation of an area",
        "spread of several measurements",
    ),
    key(
        "uncertainty.axial_stiffness",
        "share",
        SHARE,
        "of an axial stiffness",
        "the same",
    ),
    key(
        "uncertainty.bending_stiffness",
        "share",
        SHARE,
        "of a bending stiffness",
        "the same",
    ),
    key(
        "uncertainty.torsional_stiffness",
        "share",
        SHARE,
        "of a torsional stiffness",
        "the same",
    ),
    key(
        "uncertainty.rest_length",
        "share",
        SHARE,
        "of a rest length",
        "the same",
    ),
    key(
        "uncertainty.hardening",
        "share",
        SHARE,
        "gain in tension per squared strain",
        "the same",
    ),
    key(
        "uncertainty.mass",
        "share",
        SHARE,
        "of the gripper's mass",
        "the same",
    ),
    key(
        "uncertainty.body_mm",
        "mm",
        SHARE,
        "of the place of a tracked body",
        "the same",
    ),
    key(
        "uncertainty.body_deg",
        "deg",
        SHARE,
        "of its turn",
        "the same",
    ),
    key(
        "uncertainty.repeat_mm",
        "mm",
        SHARE,
        "how far the arm is off when it comes back to the same pressures",
        "go to a pose ten times",
    ),
    key(
        "uncertainty.repeat_deg",
        "deg",
        SHARE,
        "the same, turn",
        "the same",
    ),
    key("keep_out.name", "text", "", "what is there", "-"),
    key(
        "keep_out.point_mm",
        "mm",
        "three numbers",
        "a point on its surface, base frame",
        "a rule",
    ),
    key(
        "keep_out.outward",
        "",
        "three numbers, not all 0",
        "direction out of it",
        "a rule",
    ),
    key(
        "virtual_rig.unit",
        "",
        "a whole number; may be missing",
        "unit of the virtual rig that this file was measured on: with this file the virtual rig is that arm, whose true numbers the \
         file does not have",
        "`rig measure`",
    ),
    key(
        "patches",
        "tables",
        "may be missing",
        "what `gap apply` has added: effects and calibration parameters",
        "`gap run`",
    ),
];

/// A number (or word) of a robot file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Number {
    /// Table and name, of several tables with its number from 1 on: `imus[2].pad`.
    pub key: String,
    /// As it stands there.
    pub value: String,
    /// The comment behind it; empty without one.
    pub source: String,
}

impl Number {
    /// The key without the numbers of tables.
    pub fn kind(&self) -> String {
        let mut out = self.key.clone();
        if let (Some(from), Some(to)) = (out.find('['), out.find(']')) {
            out.replace_range(from..=to, "");
        }
        out
    }
}

/// What a file that reads as a robot states, line by line, without its patches.
pub fn numbers(text: &str) -> Vec<Number> {
    let mut out: Vec<Number> = Vec::new();
    let mut table = String::new();
    let mut counts = std::collections::BTreeMap::new();
    for line in text.lines().map(str::trim) {
        let (code, comment) = split_comment(line);
        if let Some(name) = code.strip_prefix("[[").and_then(|c| c.strip_suffix("]]")) {
            let n = counts.entry(name.to_owned()).or_insert(0);
            *n += 1;
            table = format!("{name}[{n}].");
        } else if let Some(name) = code.strip_prefix('[').and_then(|c| c.strip_suffix(']')) {
            table = format!("{name}.");
        } else if let Some((key, value)) = code.split_once('=')
            && !table.starts_with("patches")
        {
            out.push(Number {
                key: format!("{table}{}", key.trim()),
                value: value.trim().to_owned(),
                source: comment.to_owned(),
            });
        }
    }
    out
}

/// A line without its comment, and the comment without its sign.
pub fn split_comment(line: &str) -> (&str, &str) {
    let mut quoted = false;
    for (at, c) in line.char_indices() {
        match c {
            '"' => quoted = !quoted,
            '#' if !quoted => return (line[..at].trim(), line[at + 1..].trim()),
            _ => {}
        }
    }
    (line, "")
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;
    use crate::robot::{REFERENCE, RobotSpec};

    /// Everything that may be missing in a file.
    const MORE: &str = r#"
[[segments]]
bending_stiffness_nm_rad = 15.0
torsional_stiffness_nm_rad = 30.0
axial_stiffness_n_m = 0.0
locked = false
[[segments]]
[[keep_out]]
name = "a # wall" # by hand
point_mm = [0.0, 300.0, 0.0]
outward = [0.0, -1.0, 0.0]
[virtual_rig]
unit = 5
"#;

    #[test]
    fn every_key_is_in_the_table_and_the_other_way_round() {
        let asu = include_str!("../../assets/robots/asu-arm.toml");
        let reference = REFERENCE.replace(
            "[pressure]",
            "axial_stiffness_n_m = 0.0\n[pressure]\nsupply_off = \"vents\"",
        ) + MORE;
        let mut seen = BTreeSet::new();
        for text in [asu, &reference] {
            RobotSpec::from_toml(text).expect("reads");
            seen.extend(numbers(text).iter().map(Number::kind));
        }
        let known: BTreeSet<String> = KEYS.iter().map(|k| k.key.to_owned()).collect();
        let without: Vec<_> = seen.difference(&known).collect();
        let unused: Vec<_> = known.difference(&seen).collect();
        assert!(without.is_empty(), "not in the table: {without:?}");
        assert_eq!(unused, ["patches"]);
    }

    #[test]
    fn numbers_have_their_comments_as_sources() {
        let all = numbers(MORE);
        let wall = all
            .iter()
            .find(|n| n.key == "keep_out[1].name")
            .expect("there");
        assert_eq!(
            (wall.value.as_str(), wall.source.as_str()),
            ("\"a # wall\"", "by hand")
        );
        assert_eq!(wall.kind(), "keep_out.name");
    }
}
