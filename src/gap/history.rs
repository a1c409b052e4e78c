//! What patches change in the model of a robot, and when they were put on its file.

use super::replay::{CalibrationParameter, calibration_parameters};
use super::report::{effect_name, quantity};
use crate::robot::{Patch, PatchValue, RobotSpec};
use crate::sim::effects::{Active, Effect, Scene};
use crate::sim::patch::Correction;

/// A number of the model that a patch changes, in units that people read.
#[derive(Clone, Debug, PartialEq)]
pub struct Change {
    /// Which number: the effect, or the calibration parameter, with what it is of.
    pub name: String,
    /// Without the patch; `None` where the model has no such number.
    pub before: Option<String>,
    /// With the patch.
    pub after: String,
    /// Unit of both; empty for a factor.
    pub unit: String,
    /// Whether it is a calibration parameter of the rig, not part of an effect.
    pub of_rig: bool,
}

impl Change {
    /// In one phrase: `mass: 0 → 310 g`.
    pub fn text(&self) -> String {
        self.phrase(self.before.as_deref(), Some(&self.after))
    }

    /// What reverting the patch does, in one phrase: `mass: 310 → 0 g`.
    pub fn back(&self) -> String {
        self.phrase(Some(&self.after), self.before.as_deref())
    }

    fn phrase(&self, from: Option<&str>, to: Option<&str>) -> String {
        let [from, to] = [from, to].map(|end| end.unwrap_or("not in the model"));
        let text = format!("{}: {from} → {to} {}", self.name, self.unit);
        text.trim_end().to_owned()
    }
}

/// What becomes of edits by hand when a patch is reverted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Edits {
    /// Where there are any, nothing is reverted.
    Refuse,
    /// The file as it was edited is kept among its versions.
    SetAside,
}

/// A version of a robot file that a patch made.
#[derive(Clone, Debug, PartialEq)]
pub struct PatchRecord {
    /// Local time at which it was written, with its offset from UTC; `None` for a patch that was not put on by this program, or by an
    /// earlier version of it.
    pub date: Option<String>,
    /// The patch.
    pub patch: Patch,
    /// The numbers that it changes.
    pub changes: Vec<Change>,
    /// Whether the robot file has it now; it was reverted otherwise.
    pub is_applied: bool,
}

impl PatchRecord {
    /// The finding that it came from, in one phrase.
    pub fn finding(&self) -> String {
        let of = |key: &str| self.patch.data.get(key).map(String::as_str);
        let text = match (of("session"), of("baseline")) {
            (Some(session), Some(baseline)) => format!("found in {session} against {baseline}"),
            (Some(session), None) => format!("found in {session} against the factory model"),
            (None, _) => self.patch.name.clone(),
        };
        match &*self.patch.verdict {
            "" => text,
            "named" => format!("{text}: effect found"),
            other => format!("{text}: {other}"),
        }
    }
}

/// The numbers that `patch` changes in the model of `robot`, which may have others already: effects first.
pub fn changes(robot: &RobotSpec, patch: &Patch) -> Vec<Change> {
    let before = Correction::known(robot);
    let after = Correction::known(&robot.patched(patch.clone()));
    let there = &before.effects;
    let added = after.effects.iter().skip(there.len());
    let effects = added.flat_map(|active| of_effect(there, active));
    let values = before.values.iter().zip(&after.values);
    let rig = calibration_parameters().into_iter().zip(values);
    let rig = rig
        .filter(|(_, (a, b))| a != b)
        .map(|(k, (a, b))| of_rig(k, [*a, *b]));
    effects.chain(rig).collect()
}

/// The numbers of an effect that is added to those that are there.
fn of_effect<'a>(there: &'a [Active], added: &'a Active) -> impl Iterator<Item = Change> + 'a {
    let effect = added.effect;
    let sizes = sizes(effect, added.target);
    let alike = |a: &&Active| a.effect.id == effect.id && a.target == added.target;
    let alike: Vec<&Active> = there.iter().filter(alike).collect();
    let target = added.target.map(|t| t + 1);
    let named = move |name: &str| match effect.parameters.len() {
        1 => effect_name(effect.id, target),
        _ => format!("{}, {name}", effect_name(effect.id, target)),
    };
    effect.parameters.iter().enumerate().map(move |(i, p)| {
        let shown = |value: f64| {
            let value = PatchValue {
                value,
                unit: p.unit.to_owned(),
                ci95: None,
            };
            quantity(effect.id, p.name, &value)
        };
        // Sizes add up; what shapes an effect is its own.
        let is_size = sizes.contains(&i);
        let own: f64 = alike.iter().map(|a| a.values[i] - p.nominal).sum();
        let before = p.nominal + own;
        let after = match is_size {
            true => before + added.values[i] - p.nominal,
            false => added.values[i],
        };
        let q = shown(after);
        Change {
            name: named(p.name),
            before: is_size.then(|| shown(before).value),
            after: q.value,
            unit: q.unit,
            of_rig: false,
        }
    })
}

/// Parameters of an effect (0-based) that have a value without it; the others shape it.
fn sizes(effect: &Effect, target: Option<usize>) -> Vec<usize> {
    let starts = (effect.starts)(&Scene::default(), target);
    match starts.is_empty() {
        true => (0..effect.parameters.len()).collect(),
        false => starts.into_iter().flat_map(|s| s.moves).collect(),
    }
}

fn of_rig(parameter: CalibrationParameter, values: [f64; 2]) -> Change {
    let (factor, unit) = unit(parameter);
    let [before, after] = values.map(|v| super::report::short_number(factor * v));
    Change {
        name: parameter.id().replace('-', " "),
        before: Some(before),
        after,
        unit: unit.to_owned(),
        of_rig: true,
    }
}

/// Factor from SI to the unit that people read, and that unit.
fn unit(parameter: CalibrationParameter) -> (f64, &'static str) {
    use CalibrationParameter as K;
    match parameter {
        K::Stiffness(_) | K::Area(_) | K::RestLength(_) | K::Bending(_) | K::Torsion(_) => {
            (100.0, "%")
        }
        K::Gripper | K::Creep | K::SpringGain(_) => (100.0, "%"),
        K::Hardening => (1.0, ""),
        K::Tilt(_) | K::Mounting(..) => (1f64.to_degrees(), "deg"),
        K::Damping | K::CreepTime | K::Lag | K::SpringLag | K::Clock => (1.0, "s"),
        K::Friction(_) => (1.0, "N"),
        K::FrictionTravel | K::SpringOffset(_) | K::SpringEnds(_) => (1e3, "mm"),
        K::Drift(_) => (60f64.to_degrees(), "deg/min"),
        K::Frame(k) | K::Body(k) if k < 3 => (1e3, "mm"),
        K::Frame(_) | K::Body(_) => (1f64.to_degrees(), "deg"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::{PATCH_VERSION, PatchEffect, REFERENCE, with_patch};

    fn patch(robot: &RobotSpec, mass_kg: f64) -> Patch {
        let value = |value: f64, unit: &str| PatchValue {
            value,
            unit: unit.to_owned(),
            ci95: None,
        };
        Patch {
            version: PATCH_VERSION,
            name: "of a test".to_owned(),
            robot: robot.hash.clone(),
            verdict: "named".to_owned(),
            data: [("session", "suspect"), ("baseline", "commissioning")]
                .map(|(k, v)| (k.to_owned(), v.to_owned()))
                .into(),
            rig: [("spring-4-offset".to_owned(), 1.5e-3)].into(),
            floor: Default::default(),
            law: Vec::new(),
            effects: vec![PatchEffect {
                id: "payload".to_owned(),
                target: None,
                params: [("mass".to_owned(), value(mass_kg, "kg"))].into(),
            }],
        }
    }

    #[test]
    fn a_patch_is_listed_with_what_was_before_and_adds_to_those_below() {
        let base = RobotSpec::reference();
        let first = patch(&base, 0.3);
        let texts = |robot: &RobotSpec, patch: &Patch| -> Vec<String> {
            changes(robot, patch).iter().map(Change::text).collect()
        };
        let once = texts(&base, &first);
        assert!(
            once[0].starts_with("Undeclared payload") && once[0].ends_with(": 0 → 300 g"),
            "{once:?}"
        );
        assert_eq!(
            once.last().map(String::as_str),
            Some("spring 4 offset: 0 → 1.50 mm")
        );
        let one = RobotSpec::from_toml(&with_patch(REFERENCE, &first)).expect("reads");
        let second = patch(&one, 0.1);
        let twice = texts(&one, &second);
        assert!(twice[0].ends_with(": 300 → 400 g"), "{twice:?}");
        assert_eq!(
            twice.last().map(String::as_str),
            Some("spring 4 offset: 1.50 → 3.00 mm")
        );
        let back = changes(&one, &second)[0].back();
        assert!(back.ends_with(": 400 → 300 g"), "{back}");
        let record = PatchRecord {
            date: None,
            changes: changes(&base, &first),
            patch: first,
            is_applied: true,
        };
        assert_eq!(
            record.finding(),
            "found in suspect against commissioning: effect found"
        );
    }

    /// What shapes an effect has no value without it.
    #[test]
    fn what_shapes_an_effect_was_not_in_the_model() {
        let base = RobotSpec::reference();
        let mut of = patch(&base, 0.0);
        of.rig.clear();
        let effect = crate::sim::effects::effect("hysteresis").expect("in the table");
        let params = effect.parameters.iter().map(|p| {
            let value = PatchValue {
                value: 0.5 * (p.nominal + p.bounds[1].min(10.0 * p.nominal.max(1e-3))),
                unit: p.unit.to_owned(),
                ci95: None,
            };
            (p.name.to_owned(), value)
        });
        of.effects = vec![PatchEffect {
            id: "hysteresis".to_owned(),
            target: Some(2),
            params: params.collect(),
        }];
        let all = changes(&base, &of);
        assert_eq!(all.len(), effect.parameters.len());
        let new = all.iter().filter(|c| c.before.is_none()).count();
        assert!((1..all.len()).contains(&new), "{all:?}");
        let shape = all.iter().find(|c| c.before.is_none()).expect("one");
        assert!(
            shape.text().contains("not in the model → "),
            "{}",
            shape.text()
        );
    }
}
