//! Table of effects: errors of an arm, its pumps, its sensors and its motion capture.
//!
//! [`EFFECTS`] names every effect once, with equation, source, parameters and the operator that
//! brings it about; [`simulate`] runs a trajectory with any of them acting together.
//!
//! | residual | compares |
//! |---|---|
//! | r1 | measured with commanded pressure |
//! | r2 | motion capture with the simulation at measured pressure |
//! | r3 | spring lengths with the geometry at the captured pose |
//! | r4 | IMUs with the captured rotation |
//! | r5 | springs with IMUs |

mod active;
mod effect;
mod operators;
mod plain;
mod run;
mod table;
mod terms;

pub use crate::signal::{Side, Target};
pub use active::{Active, EffectError, Simulated, Trajectory, effect, effect_or_term, table};
pub use effect::{
    BehindGauge, Call, Effect, Inexact, Law, Line, Operator, Parameter, Plant, Posture, Reach,
    Reaction, Residual, Scene, Start,
};
pub use operators::{lagged_ramps, limited};
pub use plain::plain;
pub(super) use run::built_in;
pub use run::{OnTheWay, arm_only, behind_gauges, gauges, go_on, read, simulate};
pub use table::EFFECTS;
pub use terms::{Form, Input, Site, TERMS, Term, term};

#[cfg(test)]
mod tests;
