//! What calipers, scales, weights and a protractor give of a virtual arm: its robot file, with the errors of those tools.

use std::fmt::Write as _;

use rand_pcg::Pcg64Mcg;

use super::Unit;
use super::multibody::arm::{Character, make};
use super::multibody::chain::Arm;
use super::multibody::member::Member;
use super::noise::normal;
use crate::robot::{REFERENCE, RobotSpec, split_comment};
use crate::signal::{SPRINGS, stream};

/// A tool: its standard error and what it shows, in the key's unit, and the source that is noted.
struct Tool {
    error: f64,
    digits: usize,
    source: &'static str,
}

impl Tool {
    fn read(&self, truth: f64, rng: &mut Pcg64Mcg) -> String {
        format!("{:.*}", self.digits, truth + self.error * normal(rng))
    }
}

const fn tool(error: f64, digits: usize, source: &'static str) -> Tool {
    Tool {
        error,
        digits,
        source,
    }
}

const CALIPERS: Tool = tool(0.1, 1, "calipers on a rigid part, 0.1 mm");
const SOFT: Tool = tool(0.3, 1, "calipers on a soft part or a hook, 0.3 mm");
const PROTRACTOR: Tool = tool(0.3, 1, "protractor, 0.3 deg");
const SCALES: Tool = tool(0.002, 3, "scales, 2 g");
const EDGE: Tool = tool(2.0, 0, "balanced on an edge, 2 mm");
const THREAD: Tool = tool(0.5, 1, "spring on two weights, 0.5 N/m");
const WEIGHTS: Tool = tool(57.0, 0, "two weights, 2 %");
const PRESS: Tool = tool(0.4, 1, "force on a scale at 20 kPa, 1 % of the area");
const BALANCE: Tool = tool(0.75, 1, "spring balance and angle, 5 %");
const MOMENT: Tool = tool(1.5, 1, "known moment and angle, 5 %");

/// The text of a robot file of the reference robot's `unit`, as somebody with these tools and no other knowledge would write it. A
/// number for all bellows or springs is the mean of theirs, for none of them is exactly as drawn. The file names the unit, so that
/// the virtual rig is that arm.
pub fn robot_file(unit: Unit, seed: u64) -> String {
    let arm = make(&RobotSpec::reference(), unit.0, 0.0, &Character::default());
    let mut rng = stream(seed, 0x9a6e);
    let mut out = format!(
        "# Unit {} of the virtual rig, measured with calipers, scales, weights and a protractor (simulated, seed {seed}).\n\
         # Lengths in mm, pressures in kPa, angles in degrees, masses in kg, stiffnesses in SI.\n\n",
        unit.0
    );
    let mut table = String::new();
    // From the name on: what comes before is about the reference robot.
    for line in REFERENCE.lines().skip_while(|l| !l.starts_with("name")) {
        let (code, _) = split_comment(line);
        let stated = code
            .split_once('=')
            .map(|(key, value)| (key.trim(), value.trim()));
        let _ = match stated {
            Some(("name", _)) => writeln!(out, "name = \"unit-{}\"", unit.0),
            Some((key, drawn)) => match measured(&table, key, drawn, &arm, &mut rng) {
                Some((value, source)) => writeln!(out, "{key} = {value} # {source}"),
                None => writeln!(out, "{line}"),
            },
            None => {
                if code.starts_with('[') {
                    code.clone_into(&mut table);
                }
                writeln!(out, "{line}")
            }
        };
    }
    let _ = writeln!(out, "\n[virtual_rig]\nunit = {}", unit.0);
    out
}

/// What a tool shows of a key with this value in the drawing, and its source; nothing of what is taken from the drawing.
fn measured(
    table: &str,
    key: &str,
    drawn: &str,
    arm: &Arm,
    rng: &mut Pcg64Mcg,
) -> Option<(String, &'static str)> {
    let drawn = || drawn.parse().ok();
    let (tool, truth) = match (table, key) {
        ("[base]", "bellows_circle_radius_mm" | "pad_thickness_mm") => (CALIPERS, drawn()?),
        ("[bellows]", "rest_length_mm") => (SOFT, 1e3 * rest_m(arm)),
        ("[bellows]", "effective_diameter_mm") => (PRESS, 1e3 * diameter_m(arm)),
        ("[bellows]", "axial_stiffness_n_m") => (WEIGHTS, stiffness_n_m(arm)),
        ("[segment]", "bending_stiffness_nm_rad") => (BALANCE, tubes_nm_rad(arm)[0]),
        ("[segment]", "torsional_stiffness_nm_rad") => (MOMENT, tubes_nm_rad(arm)[1]),
        ("[mass]", "gripper_com_mm" | "payload_com_mm") => (EDGE, drawn()?),
        ("[mass]", "payload_max_kg") => return None,
        ("[mass]", _) if key.ends_with("_kg") => (SCALES, drawn()?),
        ("[springs]", "attachment_radius_mm") => (SOFT, 1e3 * radius_m(arm)),
        ("[springs]", "half_spread_deg") => (PROTRACTOR, drawn()?),
        ("[springs]", "rate_n_m") => (THREAD, drawn()?),
        ("[springs]", "free_length_mm") => (SOFT, drawn()?),
        _ => return None,
    };
    Some((tool.read(truth, rng), tool.source))
}

/// Mean over all bellows of what each of their members adds.
fn over_bellows(arm: &Arm, of: impl Fn(&Member) -> f64) -> f64 {
    let members = arm.gaps.iter().flat_map(|g| &g.members);
    members.map(of).sum::<f64>() / (3 * arm.gaps.len()) as f64
}

/// Members of one bellows, one behind the other.
fn share(arm: &Arm) -> f64 {
    (arm.gaps.len() / 2) as f64
}

fn rest_m(arm: &Arm) -> f64 {
    share(arm) * over_bellows(arm, |m| m.rest_m)
}

fn stiffness_n_m(arm: &Arm) -> f64 {
    over_bellows(arm, |m| m.stiffness_n_m) / share(arm)
}

fn diameter_m(arm: &Arm) -> f64 {
    (4.0 / std::f64::consts::PI * over_bellows(arm, |m| m.area_m2)).sqrt()
}

/// Mean over both segments of what resists bending and torsion beside the bellows' length, Nm/rad.
fn tubes_nm_rad(arm: &Arm) -> [f64; 2] {
    let n = arm.gaps.len() as f64 * share(arm);
    let bending: f64 = arm.gaps.iter().map(|g| g.elastic.tube_nm_rad.x).sum();
    let torsion: f64 = arm
        .gaps
        .iter()
        .map(|g| {
            let folds = g.elastic.at_m.iter().zip(g.elastic.lateral_n_m);
            g.elastic.tube_nm_rad.z + folds.map(|(at, k)| k * at.norm_squared()).sum::<f64>()
        })
        .sum();
    [bending / n, torsion / n]
}

/// Mean distance of the springs' upper ends from the axis, m.
fn radius_m(arm: &Arm) -> f64 {
    arm.springs
        .iter()
        .map(|s| s.upper_m.xy().norm())
        .sum::<f64>()
        / SPRINGS as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_measured_file_is_near_its_arm_and_off_its_drawing() {
        let text = robot_file(Unit(5), 1);
        let robot = RobotSpec::from_toml(&text).expect("a robot file");
        let drawing = RobotSpec::reference();
        assert_eq!(robot.virtual_unit, Some(5));
        assert_eq!(robot.name, "unit-5");
        assert_ne!(robot.base_hash, drawing.base_hash);
        let off = |a: f64, b: f64| (a / b - 1.0).abs();
        assert!(off(robot.rest_length_m, drawing.rest_length_m) < 0.01);
        let stiffness = [&robot, &drawing].map(|r| r.axial_stiffness_n_m[0]);
        assert!(off(stiffness[0], stiffness[1]) < 0.08, "{stiffness:?}");
        let bending = [&robot, &drawing].map(|r| r.segments[0].bending_nm_rad);
        assert!(off(bending[0], bending[1]) < 0.2, "{bending:?}");
        let torsion = [&robot, &drawing].map(|r| r.segments[0].torsional_nm_rad);
        assert!(off(torsion[0], torsion[1]) < 0.2, "{torsion:?}");
        // What is noted as measured is: every source is a tool's, and another day shows other digits.
        assert_ne!(text, robot_file(Unit(5), 2));
        assert_eq!(text.matches(SCALES.source).count(), 5);
        let rest = text.lines().find(|l| l.starts_with("rest_length_mm"));
        assert!(rest.is_some_and(|l| l.ends_with(SOFT.source)), "{text}");
    }
}
