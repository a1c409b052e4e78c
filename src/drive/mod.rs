//! Running a twin on a port: what it is made of, the port that a name stands for, the checks before anything is
//! asked of the boards, a plan carried out under observation, and what the drive adds up to.
//!
//! `run`, `goto`, `follow`, `pick-place`, the studies, the long run and the window all put their twins on a rig
//! through this module.

mod driver;
mod files;
mod limits;
pub mod measures;
pub mod model;
mod plan;
mod ports;
mod run;
mod start;
mod tally;
mod tasks;

/// Why a run is over that was ended from outside.
pub const ENDED: &str = "ended by a signal: the boards were stopped";

pub use driver::{Driver, Ended, Observer, TwinBuilder, stopwatch};
pub use files::{read_bench, read_text, read_toml};
pub use limits::over_limits;
pub use plan::{Drive, Driven, Row, drive, row};
pub use ports::{
    DEFAULT_RIG, Instruments, Script, SerialRig, board_config, in_process, is_virtual, rig_options,
};
pub use run::{Ran, Run, run};
pub use start::{HELLO_S, Resets, Start, check_link};
pub use tally::Tally;
pub use tasks::{
    BASKET_M, LIFT_M, PATH_CENTRE_M, PATH_SIZE_M, PickPlaceMeasures, Shape, along, fruit, goal,
    longest_s, objects, of_pick_place,
};

/// This thread, and those that it starts, leave the processor to the control loop and the link where there are too few for
/// all; elsewhere than on Linux they do not.
pub fn give_way() {
    #[cfg(target_os = "linux")]
    if let Err(e) = rustix::process::setpriority_process(None, 10) {
        log::debug!("long work runs with the priority of all threads: {e}");
    }
}
