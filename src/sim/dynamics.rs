//! Motion with inertia: [`rod::step`] with the robot's inputs.

use super::model::{Inputs, Model, SimError, State, accepted, check};
use super::rod::{self, Energy, Integrator, Motion, Outcome};

impl State {
    fn motion(&self) -> Motion {
        let q = self.strains.clone();
        match self.momenta.is_empty() {
            true => Motion::at_rest(q),
            false => Motion {
                q,
                p: self.momenta.clone(),
            },
        }
    }
}

/// One step of `dt_s` with inertia, friction, viscoelastic branches and stiffness-proportional damping `tau_s` (s).
///
/// # Errors
/// [`SimError`] when an input is not finite, the step does not converge, or it ends with a bellows pressed through
/// itself; `state` is then left as it was.
pub fn step_dynamics(
    model: &Model,
    state: &mut State,
    inputs: &Inputs,
    tau_s: f64,
    dt_s: f64,
) -> Result<Outcome, SimError> {
    check(inputs)?;
    let loads = model.loads(inputs);
    let mut history = state.take_history(model);
    let mut motion = state.motion();
    let integrator = &mut state.integrator;
    let outcome = rod::step(
        &model.rod,
        &loads,
        &history,
        &mut motion,
        dt_s,
        tau_s,
        integrator,
    );
    if let Err(e) = accepted(model, &motion.q, &outcome) {
        if outcome.converged {
            // What the step handed on to the next one leads there, too.
            *integrator = Integrator::default();
        }
        state.history = Some(history);
        return Err(e);
    }
    history.advance(&model.rod, &motion.q, dt_s);
    state.history = Some(history);
    (state.strains, state.momenta) = (motion.q, motion.p);
    Ok(outcome)
}

/// Kinetic and potential energy under `inputs`, work of the pressures included, J.
pub fn mechanical_energy(model: &Model, state: &State, inputs: &Inputs) -> Energy {
    rod::energy(&model.rod, &model.loads(inputs), &state.motion())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::RobotSpec;
    use crate::sim::{Resolution, observe, settle};

    #[test]
    fn a_damped_arm_comes_to_rest_where_it_settles() {
        let model = Model::new(
            &RobotSpec::reference(),
            &Default::default(),
            Resolution {
                elements: 2,
                ..Resolution::default()
            },
        );
        let inputs = Inputs {
            chamber_pa: [20e3, -10e3, 0.0, 5e3, -15e3, 10e3],
            payload_kg: 0.3,
            ..Inputs::default()
        };
        let mut settled = State::rest(&model);
        let mut moving = State::rest(&model);
        settle(&model, &mut settled, &inputs).expect("settles");
        let wanted = observe(&model, &settled).base_from_tip;
        let off_m = |moving: &State| {
            let at = observe(&model, moving).base_from_tip;
            (at.translation.vector - wanted.translation.vector).norm()
        };
        assert!(off_m(&moving) > 0.02);
        for _ in 0..600 {
            step_dynamics(&model, &mut moving, &inputs, 0.03, 0.01).expect("moves");
        }
        assert!(off_m(&moving) < 1e-6, "{}", off_m(&moving));
    }

    #[test]
    fn a_step_that_cannot_be_made_leaves_the_motion_alone() {
        let model = Model::nominal(&RobotSpec::reference());
        let mut moving = State::rest(&model);
        let before = moving.motion();
        let inputs = Inputs {
            payload_kg: f64::NAN,
            ..Inputs::default()
        };
        assert!(step_dynamics(&model, &mut moving, &inputs, 0.0, 1e-3).is_err());
        assert_eq!(moving.motion(), before);
    }

    #[test]
    fn a_step_that_ends_inside_out_is_refused_and_leaves_the_motion_alone() {
        let model = Model::nominal(&RobotSpec::reference());
        let inputs = Inputs::default();
        let d = model.rod.strains.indices().len();
        // The second segment pressed through zero length: its bellows are as long as at rest, upwards.
        let mut moving = State::rest(&model);
        let second = moving.strains.len() / 2;
        for xi in moving.strains[second..].chunks_exact_mut(d) {
            xi[d - 1] = -xi[d - 1];
        }
        let before = moving.motion();
        let found = step_dynamics(&model, &mut moving, &inputs, 0.02, 1e-4);
        assert_eq!(found, Err(SimError::InsideOut { segment: 2 }));
        assert_eq!(moving.motion(), before);
    }
}
