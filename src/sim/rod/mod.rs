//! Piecewise-constant-strain Cosserat rods with bellows, rigid pads and tension springs.
//!
//! A [`Rod`] is a chain of sections (segments). Each section is cut into elements of constant
//! strain ξ = (κ, v); the cross-section frame obeys R' = R κ×, p' = R v over the reference length,
//! with v = (0, 0, −1) at rest: the arm hangs along −z. Statics minimise
//!
//! Π = Σ l ψ(ξ) + Σ_i l φ_i(λ_i) + Σ U(d) − Σ f·x,   λ_i = |v + κ × r_i|,
//! φ_i(λ) = ½ k_i l₀ (λ − λ₀ᵢ)² − (p_i A_i − f_i) λ
//!
//! so a bellows' pressure acts along its own curved path and follows the deformation. The Hessian
//! is exact, geometric stiffness of pressure, weight and springs included.
//!
//! | symbol | meaning | unit |
//! |---|---|---|
//! | κ, v | curvature-twist and stretch-shear strain per reference length | 1/m, – |
//! | l | reference length of an element | m |
//! | λ_i | stretch of bellows i along its own path | – |
//! | p A − f | pressure force minus the bellows' extra tension | N |
//! | d | distance between the ends of a tension spring | m |
//!
//! Source: F. Renda et al., "Discrete Cosserat approach for multisection soft manipulator
//! dynamics", IEEE T-RO 2018, doi:10.1109/TRO.2018.2868815 (kinematics); the energy is ours.

mod assemble;
mod dense;
mod dynamics;
mod gradient;
mod history;
mod inertia;
mod kinematics;
mod laws;
mod loads;
pub mod se3;
mod section;
mod solve;
mod tangent;

pub use dense::Factor;
pub(super) use dense::dot;
pub use dynamics::{Energy, Integrator, Motion, energy, step};
pub use history::{BellowsHistory, History};
pub use kinematics::Kinematics;
pub use laws::{Branch, Contact, Drag, Floor, Friction, Hinge};
pub use loads::{Loads, StepLoads, Viscosity};
pub use section::{Bellows, Link, PointMass, Rod, Section, Strains};
pub use solve::{Outcome, Workspace, is_stable, solve, solve_step};
pub use tangent::Tangent;

#[cfg(test)]
mod sweeps;
#[cfg(test)]
mod tests;
