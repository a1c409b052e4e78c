//! The twin: one tick, commands, events, and the threads around it.
//!
//! [`Twin`] joins the rooms below to one loop, from a frame to a command; it reads no clock, never sleeps and
//! prints nothing. [`Runner`] puts it on a [`Port`] and gives it a recorder. It may import every room but the
//! window and the rig: what is at the other end of a port, it does not know.

mod command;
mod core;
mod in_process;
mod loops;
mod mesh;
mod newest;
mod publish;
mod record;
mod runner;
mod serial;
mod shape;
mod stream;
mod trial;

pub use command::{Command, Event, Handle};
pub use core::{Maps, RESUME_OFF_S, Twin};
pub use in_process::{FarEnd, Heard, InProcess};
pub use loops::{Clock, Pace, TICK_S, run_in_lockstep, run_in_real_time, run_in_simulated_time};
pub use mesh::{MeshAnswer, MeshQuestion, MeshSolver};
pub use publish::spawn;
pub use runner::{Arrivals, Port, Runner, SETTLING_FRAMES};
pub use serial::SerialPort;
pub use shape::{ShapeAnswer, ShapeQuestion, ShapeSolver};
pub use stream::LAST_WORDS;
pub use trial::{
    FrameLog, Rest, RestPoses, Spread, TRIAL_SETTLING_S, Trial, TrialErrors, mean as mean_pose,
    sensing_for,
};

#[cfg(test)]
mod tests;
