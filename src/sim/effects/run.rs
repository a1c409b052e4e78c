//! A trajectory through the arm with effects at work.
//!
//! The arm is settled (or, with damping, moved on) at every instant. Friction, viscoelastic branches
//! and a floor are part of the energy that each instant minimises (see [`crate::sim::rod::History`]).

use nalgebra::Vector3;

use super::active::{Active, EffectError, Simulated, Trajectory};
use super::effect::{Call, Line, Operator, Plant, Posture};
use super::table::EFFECTS;
use crate::robot::RobotSpec;
use crate::signal::CHAMBERS;
use crate::sim::rod::{PointMass, Viscosity};
use crate::sim::sensors::bends_rad;
use crate::sim::{Inputs, Model, Observation, SimError, State, observe, settle, step_overdamped};

/// Runs a trajectory. Effects act in the order of the table, whatever the order of `effects`. `payload_kg` is the mass in the
/// gripper.
///
/// # Errors
/// [`EffectError`] when the trajectory is empty or uneven, or the arm finds no equilibrium.
pub fn simulate(
    model: &Model,
    trajectory: &Trajectory,
    payload_kg: f64,
    effects: &[Active],
) -> Result<Simulated, EffectError> {
    let t_s = &trajectory.t_s;
    let rising = t_s.windows(2).all(|w| w[1] > w[0]);
    if t_s.is_empty() || t_s.len() != trajectory.chamber_pa.len() || !rising {
        return Err(EffectError::Trajectory {
            times: t_s.len(),
            pressures: trajectory.chamber_pa.len(),
        });
    }
    let ordered = ordered(effects);
    let mut line = Line {
        chamber_pa: trajectory.chamber_pa.clone(),
        gauge_pa: trajectory.chamber_pa.clone(),
        pump_pa_s: [None; CHAMBERS],
    };
    for a in &ordered {
        if let Operator::Pressure(f) = a.effect.operator {
            f(
                &call(&model.robot, (t_s, &trajectory.chamber_pa), a),
                &mut line,
            );
        }
    }
    let mut out = arm(model, t_s, &line.chamber_pa, &[payload_kg], &ordered)?;
    read_in_order(&model.robot, t_s, &mut out, &ordered);
    out.chamber_pa = line.chamber_pa;
    out.gauge_pa = line.gauge_pa;
    Ok(out)
}

/// Gauge pressures for the commands `commanded_pa` (gauge, Pa): the pressure effects alone, no arm. The limits of the pumps,
/// Pa/s (fill, empty; `None`: none is known), are applied by effects that depend on them; those that are left in the result
/// are not applied yet.
pub fn gauges(
    robot: &RobotSpec,
    t_s: &[f64],
    commanded_pa: &[[f64; CHAMBERS]],
    effects: &[Active],
    pump_pa_s: [Option<[f64; 2]>; CHAMBERS],
) -> Line {
    let mut line = Line {
        chamber_pa: commanded_pa.to_vec(),
        gauge_pa: commanded_pa.to_vec(),
        pump_pa_s,
    };
    for a in ordered(effects) {
        if let Operator::Pressure(f) = a.effect.operator {
            f(&call(robot, (t_s, commanded_pa), a), &mut line);
        }
    }
    line
}

/// Pressures in the chambers when the gauges read `gauge_pa`: what effects between chamber and
/// gauge hide, undone. Effects that act before the gauge change nothing here.
pub fn behind_gauges(
    robot: &RobotSpec,
    t_s: &[f64],
    gauge_pa: &[[f64; CHAMBERS]],
    effects: &[Active],
) -> Vec<[f64; CHAMBERS]> {
    let mut chamber_pa = gauge_pa.to_vec();
    // Against the order in which they act: the gauge's own error first.
    for a in ordered(effects).into_iter().rev() {
        if let Some(behind) = a.effect.behind_gauge {
            behind(&call(robot, (t_s, gauge_pa), a), &mut chamber_pa);
        }
    }
    chamber_pa
}

/// Moves the arm through given chamber pressures with what `effects` change in the arm. What they change in pressures is not
/// applied, and what they change in readings comes with [`read`]. `gauge_pa` stays empty. Of the declared payloads, kg, there is
/// one per time; the last one stays.
///
/// # Errors
/// [`EffectError::Sim`] when the arm finds no equilibrium.
pub fn arm_only(
    model: &Model,
    t_s: &[f64],
    chamber_pa: &[[f64; CHAMBERS]],
    payload_kg: &[f64],
    effects: &[Active],
) -> Result<Simulated, EffectError> {
    arm(model, t_s, chamber_pa, payload_kg, &ordered(effects))
}

/// An arm on its way through a trajectory that is not known to its end.
#[derive(Default)]
pub struct OnTheWay(Option<(State, Posture)>);

/// Goes on with instants `from` on, as [`arm_only`] through all of them at once. What effects take from a course of pressures, they
/// take from what is given.
///
/// # Errors
/// As [`arm_only`]; the arm then begins again with the next call.
pub fn go_on(
    way: &mut OnTheWay,
    model: &Model,
    (t_s, chamber_pa): (&[f64], &[[f64; CHAMBERS]]),
    from: usize,
    payload_kg: &[f64],
    effects: &[Active],
) -> Result<Simulated, EffectError> {
    let mut plant = Plant::new(model, 0.0);
    plant.act((t_s, chamber_pa), &ordered(effects));
    Ok(plant.run((t_s, chamber_pa), from, payload_kg, &mut way.0)?)
}

/// A model with effects of mechanics in it; their damping is lost.
pub(in crate::sim) fn built_in(model: &Model, effects: &[Active]) -> Model {
    let mut plant = Plant::new(model, 0.0);
    plant.act((&[0.0], &[]), &ordered(effects));
    Model {
        hidden_kg: plant.payload_kg,
        payload_m: plant.payload_m,
        hidden_force_n: plant.tip_force_n,
        ..plant.model
    }
}

/// In the order of the table; what is not in it comes last.
fn ordered(effects: &[Active]) -> Vec<&Active> {
    let place = |a: &&Active| {
        let place = EFFECTS.iter().position(|e| e.id == a.effect.id);
        place.unwrap_or(EFFECTS.len())
    };
    let mut ordered: Vec<&Active> = effects.iter().collect();
    ordered.sort_by_key(place);
    ordered
}

fn arm(
    model: &Model,
    t_s: &[f64],
    chamber_pa: &[[f64; CHAMBERS]],
    payload_kg: &[f64],
    ordered: &[&Active],
) -> Result<Simulated, EffectError> {
    let first_kg = payload_kg.first().copied().unwrap_or(0.0);
    let changes_kg: Vec<f64> = payload_kg.iter().map(|kg| kg - first_kg).collect();
    let mut plant = Plant::new(model, first_kg);
    plant.act((t_s, chamber_pa), ordered);
    let mut out = plant.run((t_s, chamber_pa), 0, &changes_kg, &mut None)?;
    out.chamber_pa = chamber_pa.to_vec();
    Ok(out)
}

/// Applies the effects of sensors and motion capture to what a run has given.
pub fn read(robot: &RobotSpec, t_s: &[f64], run: &mut Simulated, effects: &[Active]) {
    read_in_order(robot, t_s, run, &ordered(effects));
}

fn read_in_order(robot: &RobotSpec, t_s: &[f64], run: &mut Simulated, ordered: &[&Active]) {
    for a in ordered {
        let call = call(robot, (t_s, &run.chamber_pa), a);
        match a.effect.operator {
            Operator::Sensors(f) => f(&call, &mut run.sensors),
            Operator::Capture(f) => f(&call, &mut run.captured),
            Operator::Pressure(_) | Operator::Mechanics(_) => {}
        }
        if let Some(f) = a.effect.also_read {
            f(&call, &mut run.sensors);
        }
    }
}

fn call<'a>(
    robot: &'a RobotSpec,
    (t_s, chamber_pa): (&'a [f64], &'a [[f64; CHAMBERS]]),
    a: &'a Active,
) -> Call<'a> {
    Call {
        robot,
        t_s,
        chamber_pa,
        target: a.target,
        values: &a.values,
    }
}

impl Plant {
    /// Hidden loads of the model become part of the plant, where effects can change them.
    fn new(model: &Model, payload_kg: f64) -> Self {
        Self {
            model: Model {
                hidden_kg: 0.0,
                hidden_force_n: Vector3::zeros(),
                ..model.clone()
            },
            payload_kg: payload_kg + model.hidden_kg,
            payload_m: model.payload_m,
            tip_force_n: model.hidden_force_n,
            viscosity: Viscosity::default(),
            tensions_n: Vec::new(),
            tip_force_n_s: Vector3::zeros(),
            reactions: Vec::new(),
        }
    }

    fn act(&mut self, over: (&[f64], &[[f64; CHAMBERS]]), ordered: &[&Active]) {
        let robot = self.model.robot.clone();
        for a in ordered {
            if let Operator::Mechanics(f) = a.effect.operator {
                f(&call(&robot, over, a), self);
            }
            if let Some(f) = a.effect.also_moves {
                f(&call(&robot, over, a), self);
            }
        }
    }

    /// The instants from `from` on, from where the arm is `at`; where it is nowhere yet, it comes to rest at the first of them.
    /// `changes_kg`: what the payload differs by at each time; the last one stays.
    fn run(
        mut self,
        (t_s, chamber_pa): (&[f64], &[[f64; CHAMBERS]]),
        from: usize,
        changes_kg: &[f64],
        at: &mut Option<(State, Posture)>,
    ) -> Result<Simulated, SimError> {
        if let Some(end) = self.model.rod.sections.last_mut() {
            end.masses.push(PointMass {
                at_m: self.payload_m,
                kg: self.payload_kg,
            });
        }
        let before = at.take();
        let mut rests = before.is_none();
        let (mut state, mut posture) =
            before.unwrap_or_else(|| (State::rest(&self.model), Posture::default()));
        let mut out = Simulated::default();
        for (k, now_pa) in chamber_pa.iter().enumerate().skip(from) {
            let change_kg = changes_kg.get(k).or(changes_kg.last());
            let end = self.model.rod.sections.last_mut();
            if let (Some(payload), Some(change_kg)) =
                (end.and_then(|end| end.masses.last_mut()), change_kg)
            {
                payload.kg = self.payload_kg + change_kg;
            }
            let t_since_s = t_s[k] - t_s[0];
            let before = (!self.reactions.is_empty())
                .then(|| (state.strains.clone(), state.history.clone()));
            // At rest nothing pulls yet.
            let dt_s = (!rests).then(|| t_s[k] - t_s[k - 1]);
            rests = false;
            let mut o = self.step(&mut state, k, (t_s, chamber_pa), dt_s, &posture)?;
            // What follows the posture is taken from the one before, and then from the one that it leads to.
            if let Some((strains, history)) = before {
                posture = self.posture(&o, t_since_s, now_pa);
                (state.strains, state.history) = (strains, history);
                o = self.step(&mut state, k, (t_s, chamber_pa), dt_s, &posture)?;
                posture = self.posture(&o, t_since_s, now_pa);
            }
            let pads = o.shape.base_from_pad;
            out.sensors.push(o.sensors);
            out.base_from_pad.push(pads);
            out.captured.push([pads[1], pads[2]]);
        }
        *at = Some((state, posture));
        Ok(out)
    }

    /// The instant `k` of a trajectory, `dt_s` after the one before; without one before the arm rests.
    fn step(
        &self,
        state: &mut State,
        k: usize,
        (t_s, chamber_pa): (&[f64], &[[f64; CHAMBERS]]),
        dt_s: Option<f64>,
        posture: &Posture,
    ) -> Result<Observation, SimError> {
        let tension = |i: usize| -> f64 {
            let series = self.tensions_n.iter().filter_map(|s| Some(s.get(k)?[i]));
            let of_posture = self.reactions.iter();
            let of_posture = of_posture.filter(|r| r.on.is_none_or(|on| on == i));
            series.sum::<f64>()
                + of_posture
                    .map(|r| r.coefficient * (r.of)(posture, i))
                    .sum::<f64>()
        };
        let inputs = Inputs {
            chamber_pa: chamber_pa[k],
            tension_n: std::array::from_fn(tension),
            tip_force_n: (self.tip_force_n + (t_s[k] - t_s[0]) * self.tip_force_n_s).into(),
            ..Inputs::default()
        };
        match dt_s {
            None => settle(&self.model, state, &inputs)?,
            Some(dt_s) => step_overdamped(&self.model, state, &inputs, self.viscosity, dt_s)?,
        };
        Ok(observe(&self.model, state))
    }

    fn posture(&self, o: &Observation, t_s: f64, chamber_pa: &[f64; CHAMBERS]) -> Posture {
        Posture {
            t_s,
            chamber_pa: *chamber_pa,
            longer_m: o.bellows_m.map(|l| l - self.model.robot.rest_length_m),
            bend_rad: bends_rad(&o.shape.base_from_pad),
        }
    }
}
