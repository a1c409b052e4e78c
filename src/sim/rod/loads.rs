//! What acts on a rod.

use nalgebra::Vector3;

use super::memory::{Floor, Memory};
use super::section::PointMass;

/// The varying part: what acts on the rod.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Loads {
    /// Pushing force p A − f of each tube, in the order of sections and tubes, N.
    pub tube_n: Vec<f64>,
    /// Force on the tip frame's origin in the base frame, N.
    pub tip_force_n: Vector3<f64>,
    /// Moment on the tip in the base frame, N m (constant direction).
    pub tip_moment_nm: Vector3<f64>,
    /// Additional masses on the tip frame.
    pub tip_masses: Vec<PointMass>,
    /// Viscous resistance to a change of strain since `previous`, as a share of each strain's
    /// rigidity (0: statics).
    pub viscosity: f64,
    /// What the tubes remember, in their order; empty when they remember nothing. Whoever takes a step moves it to the
    /// lengths reached.
    pub memory: Vec<Memory>,
    /// A floor under the last section's end. Whoever takes a step moves it to the place reached.
    pub floor: Option<Floor>,
}
