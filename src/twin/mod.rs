//! The twin: one tick, commands, events, and the threads around it.
//!
//! [`Twin`] joins the modules below to one loop, from a frame to a command; it reads no clock, never sleeps and
//! prints nothing. [`Runner`] puts it on a [`Port`] and gives it a view, recorders and a stream. It imports neither the
//! window nor the rig: what is at the other end of a port, it does not know.

mod command;
mod core;
mod in_process;
mod loops;
mod maps;
mod mesh;
mod newest;
mod port;
mod publish;
mod record;
mod rolling;
mod runner;
mod serial;
mod shape;
mod stream;
mod trial;
mod tried;
mod view;
mod watch;

pub use command::{Command, Event, Handle, Pictures};
pub use core::{AlarmHelp, RESUME_OFF_S, Twin, example_alarms, explain_alarm};
pub use in_process::{FarEnd, Heard, InProcess};
pub use loops::{Pace, run_in_lockstep, run_in_real_time, run_in_simulated_time};
pub use maps::{Maps, Patched, Reading, sensing_for};
pub use mesh::{MeshQuestion, MeshSolver};
pub use port::{Arrivals, Clock, Port, TICK_S};
pub use publish::{spawn, spawn_until};
pub use rolling::RollingOf;
pub use runner::Runner;
pub use serial::SerialPort;
pub use stream::LAST_WORDS;
pub use trial::{
    FrameLog, Rest, RestPoses, Spread, TRIAL_SETTLING_S, Trial, TrialErrors, mean as mean_pose,
};
pub use watch::Watch;

#[cfg(test)]
mod tests;
