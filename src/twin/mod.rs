//! The twin: one tick, commands, events, and the threads around it.

mod command;
mod core;
mod in_process;
mod mesh;
mod newest;
mod record;
mod runner;
mod serial;
mod stream;
mod trial;

pub use command::{Command, Event, Handle};
pub use core::{Maps, Twin};
pub use in_process::{FarEnd, Heard, InProcess};
pub use mesh::{MeshAnswer, MeshQuestion, MeshSolver};
pub use runner::{
    Arrivals, Pace, Port, Runner, SETTLING_FRAMES, TICK_S, run_in_real_time, run_in_simulated_time,
    spawn,
};
pub use serial::SerialPort;
pub use stream::LAST_WORDS;
pub use trial::{
    Rest, RestPoses, Spread, TRIAL_SETTLING_S, Trial, TrialErrors, mean as mean_pose, sensing_for,
};

#[cfg(test)]
mod tests;
