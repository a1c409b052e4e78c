//! Studies on control: both controllers on the same tasks, loads, arms and seeds, with the same budget of
//! tuning. Every error is of the true tip of the virtual rig, which no controller sees.

mod adaptation;
mod aids;
mod disturbances;
mod null_space;
mod outages;
mod tasks;
mod trial;
mod tuning;

pub use adaptation::ADAPTATION;
pub use aids::AIDS;
pub use disturbances::DISTURBANCES;
pub use null_space::NULL_SPACE;
pub use outages::OUTAGES;
pub use tasks::{CIRCLE, EIGHT, MOVES, MOVES_POSITION, PICK_PLACE};
pub use tuning::TUNING;
