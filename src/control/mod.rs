//! From a goal to chamber pressures: the sensor-space solver, ADRC, reachability, the controllers.
//!
//! Source: the paper, section IV, in the reading that each file states where it cannot be meant as printed, and the
//! null-space QP beside it.
//! Everything here works on the learned maps ([`PoseMap`](crate::learn::PoseMap),
//! [`PlantMap`](crate::learn::PlantMap)) and on measured signals. Absent by design: simulators,
//! motion capture, clocks, I/O.
//!
//! | symbol | meaning | unit |
//! |---|---|---|
//! | s | the 24 sensor signals | m, rad |
//! | q | the six gauge pressures | Pa |
//! | f | sensor map, s → pose | m, rad |
//! | B₀ | ∂s/∂q of the plant map, 24 × 6 | per Pa |
//! | W | diag(1/σ) of the signals | 1/m, 1/rad |
//! | r | task residual, weighted so that 1 = 1 mm = 1° | mm, ° |
//! | g | how much more a segment gives way to pressure than the plant map has it | 1 |

mod adapt;
mod adrc;
mod aids;
mod box_qp;
mod controller;
mod gains;
mod limits;
mod null_space_qp;
mod paper_adrc;
mod reach;
mod residual;
mod solver;
mod tick;
#[cfg(test)]
mod toy;

pub use adapt::{Adaptation, SEGMENTS, judging_gains};
pub use adrc::{Adrc, AdrcGains};
pub use box_qp::{BoxQp, solve_box_qp};
pub use controller::{ControlOut, Controller, Stall, StepInput, Stopwatch};
pub use gains::{Gains, InitialGuess, Resolve};
pub use paper_adrc::virtual_output;
pub use reach::{ReachConfig, ReachError, StartSample, reach};
pub use residual::{
    SignalSigma, TaskWeights, goal_residual, rotation_rate_from_ypr, task_jacobian, within,
};
pub use solver::{SolverConfig, SolverOut, objective, objective_gradient, solve};
pub use tick::Maps;
