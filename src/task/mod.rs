//! What the operator asks the arm to do: go to a point, follow a path, pick and place, pass through a programme of pressures.
//!
//! Pure state machines over estimates and verdicts; they command no pressure and read no clock. A [`Plan`] is a
//! row of legs, a [`Routine`] is a plan under way. This module imports robot and signal alone: the
//! verdict whether a stop can be reached is an input.

mod goto;
mod path;
mod plan;
mod programme;
mod routine;

pub use goto::{Arrival, Goto, GotoError, GotoState, allowed};
pub use path::{PATH_WAYPOINTS, Path, circle, figure_eight, off_path_m};
pub use plan::{Follow, GRIP_S, Item, Leg, Plan, Stop};
pub use programme::Programme;
pub use routine::{Happening, Routine, Target};
