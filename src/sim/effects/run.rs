//! A trajectory through the arm with effects at work.
//!
//! The arm is settled (or, with damping, moved on) at every instant. Forces that depend on its
//! motion, friction F, viscoelastic branches B and the floor N, act along coordinates x (bellows
//! lengths, height of the end pad) and are found together with it by Newton's method on
//! f = w(x(f)), where the compliance ∂x/∂f is measured once and kept up to date by Broyden's rule;
//! their memory moves on once per instant:
//!
//! F_k = ±F_max + (F_{k−1} ∓ F_max) e^{−|Δx|/w},   B_k = a B_{k−1} + c (τ/Δt)(1 − a) Δx,  a = e^{−Δt/τ}

use nalgebra::{SMatrix, SVector, Vector3};

use super::{Active, Call, EffectError, Line, Operator, Plant, Simulated, Trajectory};
use crate::robot::RobotSpec;
use crate::signal::CHAMBERS;
use crate::sim::rod::PointMass;
use crate::sim::{Inputs, Model, Observation, SimError, State, creep_to, observe, settle};

/// Runs a trajectory. Effects act in the order of the table, whatever the order of `effects`.
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
    };
    for a in &ordered {
        if let Operator::Pressure(f) = a.effect.operator {
            f(&call(&model.robot, t_s, a), &mut line);
        }
    }
    let mut out = arm(model, t_s, &line.chamber_pa, payload_kg, &ordered)?;
    out.chamber_pa = line.chamber_pa;
    out.gauge_pa = line.gauge_pa;
    Ok(out)
}

/// What the gauges would read when `commanded_pa` is asked for: the pressure effects alone, no arm.
pub fn gauges(
    robot: &RobotSpec,
    t_s: &[f64],
    commanded_pa: &[[f64; CHAMBERS]],
    effects: &[Active],
) -> Vec<[f64; CHAMBERS]> {
    let mut line = Line {
        chamber_pa: commanded_pa.to_vec(),
        gauge_pa: commanded_pa.to_vec(),
    };
    for a in ordered(effects) {
        if let Operator::Pressure(f) = a.effect.operator {
            f(&call(robot, t_s, a), &mut line);
        }
    }
    line.gauge_pa
}

/// Pressures in the chambers when the gauges read `gauge_pa`: what effects between chamber and
/// gauge hide, undone. Effects that act before the gauge change nothing here.
pub fn behind_gauges(
    robot: &RobotSpec,
    t_s: &[f64],
    gauge_pa: &[[f64; CHAMBERS]],
    effects: &[Active],
) -> Vec<[f64; CHAMBERS]> {
    let mut line = Line {
        chamber_pa: gauge_pa.to_vec(),
        gauge_pa: gauge_pa.to_vec(),
    };
    for a in effects.iter().filter(|a| a.effect.id == "gauge-error") {
        let c = call(robot, t_s, a);
        for row in &mut line.chamber_pa {
            for i in (0..CHAMBERS).filter(|i| c.hits(*i)) {
                row[i] = (row[i] - a.values[1]) / a.values[0];
            }
        }
    }
    for a in effects.iter().filter(|a| a.effect.id == "pressure-lag") {
        if let Operator::Pressure(f) = a.effect.operator {
            f(&call(robot, t_s, a), &mut line);
        }
    }
    line.chamber_pa
}

/// Moves the arm through given chamber pressures with the effects of mechanics, sensors and motion
/// capture among `effects`; pressure effects are not applied. `gauge_pa` stays empty.
///
/// # Errors
/// [`EffectError::Sim`] when the arm finds no equilibrium.
pub fn arm_only(
    model: &Model,
    t_s: &[f64],
    chamber_pa: &[[f64; CHAMBERS]],
    payload_kg: f64,
    effects: &[Active],
) -> Result<Simulated, EffectError> {
    arm(model, t_s, chamber_pa, payload_kg, &ordered(effects))
}

/// A model with effects in it that need no history; what others do is lost.
pub(in crate::sim) fn built_in(model: &Model, effects: &[Active]) -> Model {
    let mut plant = Plant::new(model, 0.0);
    plant.act(&[0.0], &ordered(effects));
    Model {
        hidden_kg: plant.payload_kg,
        payload_m: plant.payload_m,
        hidden_force_n: plant.tip_force_n,
        ..plant.model
    }
}

/// In the order of the table.
fn ordered(effects: &[Active]) -> Vec<&Active> {
    let place = |a: &&Active| super::EFFECTS.iter().position(|e| e.id == a.effect.id);
    let mut ordered: Vec<&Active> = effects.iter().collect();
    ordered.sort_by_key(place);
    ordered
}

fn arm(
    model: &Model,
    t_s: &[f64],
    chamber_pa: &[[f64; CHAMBERS]],
    payload_kg: f64,
    ordered: &[&Active],
) -> Result<Simulated, EffectError> {
    let robot = &model.robot;
    let mut plant = Plant::new(model, payload_kg);
    plant.act(t_s, ordered);
    let mut out = plant.run(t_s, chamber_pa)?;
    read_in_order(robot, t_s, &mut out, ordered);
    out.chamber_pa = chamber_pa.to_vec();
    Ok(out)
}

/// Applies the effects of sensors and motion capture to what a run has given.
pub fn read(robot: &RobotSpec, t_s: &[f64], run: &mut Simulated, effects: &[Active]) {
    read_in_order(robot, t_s, run, &ordered(effects));
}

fn read_in_order(robot: &RobotSpec, t_s: &[f64], run: &mut Simulated, ordered: &[&Active]) {
    for a in ordered {
        match a.effect.operator {
            Operator::Sensors(f) => f(&call(robot, t_s, a), &mut run.sensors),
            Operator::Capture(f) => f(&call(robot, t_s, a), &mut run.captured),
            Operator::Pressure(_) | Operator::Mechanics(_) => {}
        }
    }
}

fn call<'a>(robot: &'a RobotSpec, t_s: &'a [f64], a: &'a Active) -> Call<'a> {
    Call {
        robot,
        t_s,
        target: a.target,
        values: &a.values,
    }
}

/// Coordinates that reactions act along: bellows lengths 1..6 and the height of the end pad, m.
const COORDINATES: usize = CHAMBERS + 1;
type Coordinates = SVector<f64, COORDINATES>;
type Compliance = SMatrix<f64, COORDINATES, COORDINATES>;

/// What the arm remembers from the instant before.
struct Memory {
    bellows_m: [f64; CHAMBERS],
    friction_n: [f64; CHAMBERS],
    branch_n: [f64; CHAMBERS],
    t_s: f64,
}

/// Forces at one place x and how they change with it.
struct Reaction {
    friction_n: [f64; CHAMBERS],
    branch_n: [f64; CHAMBERS],
    /// All forces along the coordinates, N: tensions, then the floor's push.
    total_n: Coordinates,
    /// ∂f/∂x, N/m.
    slope_n_m: Coordinates,
}

/// A change of force below this ends the iteration, N.
const FORCE_TOLERANCE_N: f64 = 1e-4;
const MAX_FORCE_ITERATIONS: usize = 60;
/// Push with which the compliance is measured, N.
const PROBE_N: f64 = 0.2;

impl Plant {
    /// What the model has hidden in it becomes part of the plant, where effects can change it.
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
            tau_s: 0.0,
            friction: [[0.0, 1.0]; CHAMBERS],
            branch: [[0.0, 1.0]; CHAMBERS],
            floor: None,
        }
    }

    fn act(&mut self, t_s: &[f64], ordered: &[&Active]) {
        let robot = self.model.robot.clone();
        for a in ordered {
            if let Operator::Mechanics(f) = a.effect.operator {
                f(&call(&robot, t_s, a), self);
            }
        }
    }

    fn run(mut self, t_s: &[f64], chamber_pa: &[[f64; CHAMBERS]]) -> Result<Simulated, SimError> {
        if let Some(end) = self.model.rod.sections.last_mut() {
            end.masses.push(PointMass {
                at_m: self.payload_m,
                kg: self.payload_kg,
            });
        }
        let mut state = State::rest(&self.model);
        let mut memory: Option<Memory> = None;
        let mut compliance: Option<Compliance> = None;
        let mut force_n = Coordinates::zeros();
        let mut out = Simulated::default();
        for (t, chamber_pa) in t_s.iter().zip(chamber_pa) {
            let (o, found) = self.instant(
                &mut state,
                *t,
                chamber_pa,
                memory.as_ref(),
                force_n,
                &mut compliance,
            )?;
            force_n = found.total_n;
            memory = Some(Memory {
                bellows_m: o.bellows_m,
                friction_n: found.friction_n,
                branch_n: found.branch_n,
                t_s: *t,
            });
            let pads = o.shape.base_from_pad;
            out.sensors.push(o.sensors);
            out.base_from_pad.push(pads);
            out.captured.push([pads[1], pads[2]]);
        }
        Ok(out)
    }

    /// Whether any force depends on the motion.
    fn reacts(&self) -> bool {
        self.floor.is_some()
            || self.friction.iter().any(|f| f[0] > 0.0)
            || self.branch.iter().any(|b| b[0] > 0.0)
    }

    /// The arm and its reactions at one instant, found together.
    fn instant(
        &self,
        state: &mut State,
        t_s: f64,
        chamber_pa: &[f64; CHAMBERS],
        memory: Option<&Memory>,
        mut force_n: Coordinates,
        compliance: &mut Option<Compliance>,
    ) -> Result<(Observation, Reaction), SimError> {
        let before = state.strains.clone();
        let mut at = |force_n: &Coordinates| -> Result<Observation, SimError> {
            let mut tip_force_n = self.tip_force_n;
            tip_force_n.z += force_n[CHAMBERS];
            let inputs = Inputs {
                chamber_pa: *chamber_pa,
                tension_n: std::array::from_fn(|i| force_n[i]),
                payload_kg: 0.0,
                tip_force_n: tip_force_n.into(),
            };
            match memory {
                Some(m) if self.tau_s > 0.0 => {
                    state.strains.clone_from(&before);
                    creep_to(&self.model, state, &inputs, self.tau_s, t_s - m.t_s)?;
                }
                _ => {
                    settle(&self.model, state, &inputs)?;
                }
            }
            Ok(observe(&self.model, state))
        };
        let mut o = at(&force_n)?;
        if !self.reacts() {
            return Ok((o, Reaction::none()));
        }
        let mut x = coordinates(&o);
        let c = match compliance {
            Some(c) => c,
            None => {
                let mut c = Compliance::zeros();
                for i in 0..COORDINATES {
                    let mut pushed_n = force_n;
                    pushed_n[i] += PROBE_N;
                    c.set_column(i, &((coordinates(&at(&pushed_n)?) - x) / PROBE_N));
                }
                o = at(&force_n)?;
                compliance.insert(c)
            }
        };
        let mut best_off = f64::INFINITY;
        let mut best = (force_n, x);
        let mut share = 1.0;
        for _ in 0..MAX_FORCE_ITERATIONS {
            let wanted = self.reaction(&x, t_s, memory);
            let off = (wanted.total_n - force_n).amax();
            if off < FORCE_TOLERANCE_N {
                return Ok((o, wanted));
            }
            if off < best_off {
                best_off = off;
                best = (force_n, x);
                share = (2.0f64 * share).min(1.0);
            } else {
                // Back to the best place, with what the trial has told of the compliance.
                share *= 0.5;
                (force_n, x) = best;
            }
            let target_n = self.balance(&x, &force_n, c, t_s, memory);
            let step_n = (target_n - force_n) * share;
            let next_n = force_n + step_n;
            o = at(&next_n)?;
            let moved_m = coordinates(&o) - x;
            // C ← C + (Δx − C Δf) Δfᵀ / Δfᵀ Δf
            let size = step_n.norm_squared();
            if size > 1e-6 {
                *c += (moved_m - *c * step_n) * step_n.transpose() / size;
            }
            x += moved_m;
            force_n = next_n;
        }
        Err(SimError::NoEquilibrium {
            iterations: MAX_FORCE_ITERATIONS,
            last_step: best_off,
        })
    }

    /// The forces f = w(x + C (f − f₀)) when the arm answers linearly, by Newton's method.
    fn balance(
        &self,
        x: &Coordinates,
        force_n: &Coordinates,
        compliance: &Compliance,
        t_s: f64,
        memory: Option<&Memory>,
    ) -> Coordinates {
        let mut f = *force_n;
        for _ in 0..20 {
            let w = self.reaction(&(x + compliance * (f - force_n)), t_s, memory);
            let mut j = *compliance;
            for (i, slope) in w.slope_n_m.iter().enumerate() {
                j.row_mut(i).scale_mut(*slope);
            }
            let Some(step) = (Compliance::identity() - j).lu().solve(&(w.total_n - f)) else {
                return w.total_n;
            };
            if step.amax() < 0.1 * FORCE_TOLERANCE_N {
                break;
            }
            // The reactions bend where a motion turns round: shorten until it helps.
            let off = (w.total_n - f).norm();
            let mut part = 1.0;
            while part > 1e-3 {
                let trial = f + step * part;
                let at = x + compliance * (trial - force_n);
                if (self.reaction(&at, t_s, memory).total_n - trial).norm() < off {
                    break;
                }
                part *= 0.5;
            }
            f += step * part;
        }
        f
    }

    /// The reactions at a place.
    fn reaction(&self, x: &Coordinates, t_s: f64, memory: Option<&Memory>) -> Reaction {
        let mut out = Reaction::none();
        if let Some([height_m, rate_n_m]) = self.floor {
            // N = k max(0, z_floor − z)
            let depth_m = height_m - x[CHAMBERS];
            if depth_m > 0.0 {
                out.total_n[CHAMBERS] = rate_n_m * depth_m;
                out.slope_n_m[CHAMBERS] = -rate_n_m;
            }
        }
        let Some(m) = memory else { return out };
        let dt_s = t_s - m.t_s;
        for i in 0..CHAMBERS {
            let dx_m = x[i] - m.bellows_m[i];
            let [most_n, width_m] = self.friction[i];
            // dF/dx = (F_max − F)/w on the way up, (F_max + F)/w on the way down
            let most_n = most_n.copysign(dx_m);
            let left = (-dx_m.abs() / width_m).exp();
            out.friction_n[i] = most_n + (m.friction_n[i] - most_n) * left;
            out.slope_n_m[i] += ((most_n - m.friction_n[i]) * left / width_m).abs();
            let [rate_n_m, tau_s] = self.branch[i];
            let decay = (-dt_s / tau_s).exp();
            let rate_n_m = rate_n_m * (tau_s / dt_s) * (1.0 - decay);
            out.branch_n[i] = decay * m.branch_n[i] + rate_n_m * dx_m;
            out.slope_n_m[i] += rate_n_m;
            out.total_n[i] = out.friction_n[i] + out.branch_n[i];
        }
        out
    }
}

impl Reaction {
    fn none() -> Self {
        Self {
            friction_n: [0.0; CHAMBERS],
            branch_n: [0.0; CHAMBERS],
            total_n: Coordinates::zeros(),
            slope_n_m: Coordinates::zeros(),
        }
    }
}

fn coordinates(o: &Observation) -> Coordinates {
    let mut x = Coordinates::zeros();
    x.as_mut_slice()[..CHAMBERS].copy_from_slice(&o.bellows_m);
    x[CHAMBERS] = o.base_from_tip.translation.vector.z;
    x
}
