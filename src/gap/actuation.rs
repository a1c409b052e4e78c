//! r1, from command to measured pressure: what is wrong between the two, for sessions that log both.

mod decide;
mod healthy;
mod line;
mod search;
mod significance;
#[cfg(test)]
mod tests;

pub use decide::{Actuation, Proof, actuation_only, decide_supply, prove_supply};
pub use healthy::{LineBaseline, LineModel, PressureNoise, commission_supply, ideal_supply};
pub use line::{
    KNOBS, LINE_HZ, Lag, LineRow, PressureGrid, PressureLog, PressureUnit, Regulator,
    gauge_pressures, line_rmse_pa, line_rows,
};
pub use search::{EffectSet, Stages, supply_stages};
pub use significance::Significance;
