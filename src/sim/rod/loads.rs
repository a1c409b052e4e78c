//! Loads on a rod: at an instant, and over a time step.

use nalgebra::Vector3;

use super::history::History;
use super::laws::Contact;
use super::section::PointMass;

/// Loads at an instant: all that statics balances besides weight and springs.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Loads {
    /// Pushing force p A − f of each bellows, in the order of sections and bellows, N.
    pub bellows_n: Vec<f64>,
    /// Force on the tip frame's origin in the base frame, N.
    pub tip_force_n: Vector3<f64>,
    /// Moment on the tip in the base frame, N m (constant direction).
    pub tip_moment_nm: Vector3<f64>,
    /// Additional masses on the tip frame.
    pub tip_masses: Vec<PointMass>,
}

/// Viscous resistance to a change of strain, as shares of rigidity: time constants (s), or these over the length of a step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Viscosity {
    /// Of the bellows, of their stiffness.
    pub bellows: f64,
    /// Of what is between them, of its rigidity.
    pub core: f64,
}

impl Viscosity {
    /// Proportional to stiffness throughout.
    pub fn proportional(tau_s: f64) -> Self {
        Self {
            bellows: tau_s,
            core: tau_s,
        }
    }

    /// Beside another one.
    pub fn add(&mut self, other: Self) {
        self.bellows += other.bellows;
        self.core += other.core;
    }

    /// Over a step of `dt_s`.
    pub fn over(self, dt_s: f64) -> Self {
        Self {
            bellows: self.bellows / dt_s,
            core: self.core / dt_s,
        }
    }

    /// Whether nothing resists.
    pub fn is_none(self) -> bool {
        self.bellows <= 0.0 && self.core <= 0.0
    }
}

/// Loads over one overdamped time step: those at its end, viscous resistance, and the forces that depend on the way.
#[derive(Clone, Copy, Debug)]
pub struct StepLoads<'a> {
    /// Loads at the end of the step.
    pub loads: &'a Loads,
    /// Viscous resistance to a change of strain over the step.
    pub viscosity: Viscosity,
    /// Friction, viscoelastic branches and contact at the start of the step.
    pub history: &'a History,
    /// Length of the step, s.
    pub dt_s: f64,
}

/// Everything that one evaluation of the rod's energy takes into account.
#[derive(Clone, Copy)]
pub(super) struct Acting<'a> {
    pub loads: &'a Loads,
    /// Viscosity, and the strains that it resists to move away from.
    pub drag: Option<(Viscosity, &'a [f64])>,
    /// Friction, branches and contact, and the time since, s.
    pub history: Option<(&'a History, f64)>,
}

impl<'a> Acting<'a> {
    /// Statics.
    pub fn at_rest(loads: &'a Loads) -> Self {
        Self {
            loads,
            drag: None,
            history: None,
        }
    }

    /// Contact with the floor at the start of the step.
    pub fn contact(&self) -> Option<&'a Contact> {
        self.history
            .and_then(|(history, _)| history.contact.as_ref())
    }

    /// An overdamped step from the strains `from`.
    pub fn over(step: &StepLoads<'a>, from: &'a [f64]) -> Self {
        Self {
            loads: step.loads,
            drag: Some((step.viscosity, from)),
            history: Some((step.history, step.dt_s)),
        }
    }
}
