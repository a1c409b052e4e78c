//! The robot in motion: [`rod::step`] with the robot's inputs.

use super::model::{Inputs, Model, SimError, State, check, inside_out};
use super::rod::{self, Energy, Motion, Outcome, Stride};

/// A state that moves.
#[derive(Clone, Debug)]
pub struct Moving {
    /// Strains and momenta.
    pub motion: Motion,
    /// Integrator memory; holds no result.
    pub work: Stride,
}

impl Moving {
    /// At rest in `state`.
    pub fn from_rest(state: &State) -> Self {
        Self {
            motion: Motion::at_rest(state.strains.clone()),
            work: Stride::default(),
        }
    }

    /// The momentary shape, to [`super::observe`] it.
    pub fn state(&self) -> State {
        State {
            strains: self.motion.q.clone(),
            ..State::default()
        }
    }
}

/// One step of `dt_s` with inertia and stiffness-proportional damping `tau_s` (s).
///
/// # Errors
/// [`SimError`] when an input is not finite, the step does not converge, or it ends with a bellows pressed through
/// itself; `moving` is then left as it was.
pub fn swing(
    model: &Model,
    moving: &mut Moving,
    inputs: &Inputs,
    tau_s: f64,
    dt_s: f64,
) -> Result<Outcome, SimError> {
    check(inputs)?;
    let loads = model.loads(inputs, 0.0);
    let before = moving.motion.clone();
    let Moving { motion, work } = moving;
    let outcome = rod::step(&model.rod, &loads, motion, dt_s, tau_s, work);
    if !outcome.converged {
        return Err(SimError::NoEquilibrium {
            iterations: outcome.iterations,
            last_step: outcome.last_step,
        });
    }
    if let Some(segment) = inside_out(model, &motion.q) {
        // What the step handed on to the next one leads there, too.
        *moving = Moving {
            motion: before,
            work: Stride::default(),
        };
        return Err(SimError::InsideOut { segment });
    }
    Ok(outcome)
}

/// Kinetic and potential energy under `inputs`, work of the pressures included, J.
pub fn mechanical_energy(model: &Model, moving: &Moving, inputs: &Inputs) -> Energy {
    rod::energy(&model.rod, &model.loads(inputs, 0.0), &moving.motion)
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
        let mut moving = Moving::from_rest(&settled);
        settle(&model, &mut settled, &inputs).expect("settles");
        let wanted = observe(&model, &settled).base_from_tip;
        let off_m = |moving: &Moving| {
            let at = observe(&model, &moving.state()).base_from_tip;
            (at.translation.vector - wanted.translation.vector).norm()
        };
        assert!(off_m(&moving) > 0.02);
        for _ in 0..600 {
            swing(&model, &mut moving, &inputs, 0.03, 0.01).expect("moves");
        }
        assert!(off_m(&moving) < 1e-6, "{}", off_m(&moving));
    }

    #[test]
    fn a_step_that_cannot_be_made_leaves_the_motion_alone() {
        let model = Model::nominal(&RobotSpec::reference());
        let mut moving = Moving::from_rest(&State::rest(&model));
        let before = moving.motion.clone();
        let inputs = Inputs {
            payload_kg: f64::NAN,
            ..Inputs::default()
        };
        assert!(swing(&model, &mut moving, &inputs, 0.0, 1e-3).is_err());
        assert_eq!(moving.motion, before);
    }

    #[test]
    fn a_step_that_ends_inside_out_is_refused_and_leaves_the_motion_alone() {
        let model = Model::nominal(&RobotSpec::reference());
        let inputs = Inputs::default();
        let d = model.rod.strains.indices().len();
        // The second segment pressed through zero length: its bellows are as long as at rest, upwards.
        let mut moving = Moving::from_rest(&State::rest(&model));
        let second = moving.motion.q.len() / 2;
        for xi in moving.motion.q[second..].chunks_exact_mut(d) {
            xi[d - 1] = -xi[d - 1];
        }
        let before = moving.motion.clone();
        let found = swing(&model, &mut moving, &inputs, 0.02, 1e-4);
        assert_eq!(found, Err(SimError::InsideOut { segment: 2 }));
        assert_eq!(moving.motion, before);
    }
}
