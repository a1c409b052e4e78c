//! What the operator asks the arm to do: go to a point, later follow a path, pick and place.
//!
//! Pure state machines over estimates and verdicts; they command no pressure and read no clock.

mod goto;
mod path;

pub use goto::{Arrival, Goto, GotoError, GotoState};
pub use path::{PATH_WAYPOINTS, Path, circle, figure_eight};
