//! Whether an arm fits: what this program can do for the arm that a robot file describes, and what is missing.

use crate::drive::model;
use crate::robot::{Number, RobotSpec, numbers};
use crate::signal::CHAMBERS;
use crate::sim::mesh::MeshModel;
use crate::sim::{Inputs, Model, Observation, SimError, State, observe, settle};

/// Something that the program does.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Ability {
    /// What.
    pub what: &'static str,
    /// Whether it can do that for this arm.
    pub can: bool,
    /// How far, or what is missing.
    pub why: String,
}

/// What was found.
#[derive(Clone, Debug)]
pub struct Checked {
    /// In the order of a lab's work.
    pub abilities: Vec<Ability>,
    /// What the file states, with the sources that its comments give.
    pub numbers: Vec<Number>,
    /// What looks wrong, a sentence each.
    pub warnings: Vec<String>,
}

/// Whether a comment states where a number is from.
pub fn has_source(n: &Number) -> bool {
    !(n.source.is_empty() || n.source.contains("assumed"))
}

fn ability(what: &'static str, missing: Option<String>, how: impl Into<String>) -> Ability {
    Ability {
        what,
        can: missing.is_none(),
        why: missing.unwrap_or_else(|| how.into()),
    }
}

/// The arm at rest with all pressures alike (Pa) and a payload (kg).
fn at_rest(robot: &RobotSpec, gauge_pa: f64, payload_kg: f64) -> Result<Observation, SimError> {
    let arm = Model::nominal(robot);
    let mut state = State::rest(&arm);
    let inputs = Inputs {
        chamber_pa: [gauge_pa; CHAMBERS],
        payload_kg,
        ..Inputs::default()
    };
    settle(&arm, &mut state, &inputs)?;
    Ok(observe(&arm, &state))
}

/// Checks the robot that `text`, the text of its file, describes.
pub fn check(robot: &RobotSpec, text: &str) -> Checked {
    let mut warnings = Vec::new();
    let mm = |x: f64| x * 1e3;
    let simulated = at_rest(robot, 0.0, 0.0);
    let simulation = match &simulated {
        Ok(seen) => {
            let down = -seen.base_from_tip.translation.z;
            ability(
                "simulate it (rod model)",
                None,
                format!("it hangs {:.0} mm long without pressure", mm(down)),
            )
        }
        Err(e) => ability("simulate it (rod model)", Some(e.to_string()), ""),
    };
    let mesh = MeshModel::new(robot).err().map(|e| e.to_string());
    let [shortest, longest] = robot.length_range_m;
    let within = |length: &f64| (0.95 * shortest..=1.05 * longest).contains(length);
    let loaded = match at_rest(robot, 0.0, robot.payload_max_kg) {
        Err(e) => Some(e.to_string()),
        Ok(seen) => seen.bellows_m.iter().find(|l| !within(l)).map(|l| {
            format!(
                "a bellows is {:.0} mm long then, beyond bellows.length_range_mm",
                mm(*l)
            )
        }),
    };
    let loaded = loaded.map(|e| {
        format!(
            "with mass.payload_max_kg = {} kg: {e}",
            robot.payload_max_kg
        )
    });
    for (name, pa) in [
        ("highest", robot.pressure.max_pa),
        ("lowest", robot.pressure.min_pa),
    ] {
        let Ok(seen) = at_rest(robot, pa, 0.0) else {
            warnings.push(format!(
                "the rod model finds no rest at the {name} pressure, {:.0} kPa, in all chambers",
                pa * 1e-3
            ));
            continue;
        };
        for (i, length) in seen.bellows_m.iter().enumerate() {
            if !within(length) {
                warnings.push(format!(
                    "chamber {} is {:.0} mm long at {:.0} kPa in all chambers, and bellows.length_range_mm is [{:.0}, {:.0}]: one of \
                     area, stiffness and range is off",
                    i + 1,
                    mm(*length),
                    pa * 1e-3,
                    mm(shortest),
                    mm(longest)
                ));
                break;
            }
        }
        let [least, most] = robot.spring.range_m;
        let off = seen
            .sensors
            .spring_m
            .iter()
            .position(|l| !(least..=most).contains(l));
        if let Some(i) = off.filter(|_| robot.has_springs) {
            warnings.push(format!(
                "spring {} is {:.0} mm long at {:.0} kPa in all chambers, outside of springs.range_mm [{:.0}, {:.0}]: it is not read there",
                i + 1,
                mm(seen.sensors.spring_m[i]),
                pa * 1e-3,
                mm(least),
                mm(most)
            ));
        }
    }
    let mut numbers = numbers(text);
    // Names need no source.
    numbers.retain(|n| !n.value.starts_with('"'));
    let unknown = numbers.iter().filter(|n| !has_source(n)).count();
    if unknown > 0 {
        warnings.push(format!(
            "{unknown} of {} numbers are assumed, or state no source",
            numbers.len()
        ));
    }
    let lacks = robot.lacks();
    let no_sensors = |what: &str| {
        let lacks = lacks.as_ref()?;
        Some(format!("it has {lacks}: {what}"))
    };
    // Volume of a chamber's stroke over the flow of its pump.
    let fill_s = robot.largest_area_m2() * (longest - shortest) / robot.pump_flow_m3_s;
    let networks = match model::model(None) {
        Ok(model) => model::trained_for_another(&model, robot).map(str::to_owned),
        Err(e) => Some(e.to_string()),
    };
    let abilities = vec![
        simulation,
        ability(
            "simulate it (mesh model)",
            mesh,
            "walls that bend like the rod model",
        ),
        ability(
            "hold its heaviest payload",
            loaded,
            format!("{:.0} g at rest", robot.payload_max_kg * 1e3),
        ),
        ability(
            "replay its logs, compare them at rest",
            None,
            "`import log`, `open`, `gap run --window`",
        ),
        ability(
            "estimate its pose",
            no_sensors("nothing measures its shape"),
            "by twelve springs and four IMUs, once they are calibrated",
        ),
        ability(
            "use the shipped networks",
            networks
                .filter(|_| lacks.is_none())
                .or_else(|| no_sensors("networks read springs and IMUs")),
            "they were trained for this file",
        ),
        ability(
            "drive it",
            robot.why_not_driven(),
            format!(
                "a full stroke takes {fill_s:.0} s by its pumps, the boards bear its pressures"
            ),
        ),
        ability(
            "find gaps in motion",
            no_sensors("sessions of such an arm are compared at rest"),
            "`gap commission`, then `gap run`",
        ),
    ];
    Checked {
        abilities,
        numbers,
        warnings,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::REFERENCE;

    fn checked(text: &str) -> Checked {
        check(&RobotSpec::from_toml(text).expect("reads"), text)
    }

    fn can(c: &Checked, what: &str) -> bool {
        c.abilities
            .iter()
            .find(|a| a.what.contains(what))
            .expect(what)
            .can
    }

    #[test]
    fn the_reference_can_all_and_an_arm_without_sensors_cannot_be_driven() {
        let reference = checked(REFERENCE);
        assert!(
            reference.abilities.iter().all(|a| a.can),
            "{:?}",
            reference.abilities
        );
        let asu = checked(include_str!("../../assets/robots/asu-arm.toml"));
        for what in ["rod", "replay", "payload"] {
            assert!(can(&asu, what), "{what}: {:?}", asu.abilities);
        }
        for what in ["estimate", "networks", "drive", "motion"] {
            assert!(!can(&asu, what), "{what}: {:?}", asu.abilities);
        }
    }

    #[test]
    fn numbers_that_do_not_fit_each_other_are_named() {
        let soft = REFERENCE.replace(
            "axial_stiffness_n_m = 2851.0",
            "axial_stiffness_n_m = 1400.0",
        );
        let c = checked(&soft);
        assert!(
            c.warnings
                .iter()
                .any(|w| w.contains("bellows.length_range_mm")),
            "{:?}",
            c.warnings
        );
        assert!(!can(&c, "networks"));
        let limp = REFERENCE.replace("payload_max_kg = 0.6", "payload_max_kg = 900.0");
        let c = checked(&limp);
        assert!(!can(&c, "payload"), "{:?}", c.abilities);
    }
}
