//! Session logs: a folder with `session.toml` and `log.csv`, one row per sample.
//!
//! | columns of `log.csv` | unit | |
//! |---|---|---|
//! | `t_s` | s | time, strictly increasing |
//! | `p1_kpa` .. `p6_kpa` | kPa | measured gauge pressure |
//! | `spring1_mm` .. `spring12_mm` | mm | spring length |
//! | `imu1_yaw_deg`, `imu1_pitch_deg`, `imu1_roll_deg`, .. `imu4_*` | deg | pad under each IMU |
//! | `vicon_x_mm`, `vicon_y_mm`, `vicon_z_mm`, `vicon_yaw_deg`, `vicon_pitch_deg`, `vicon_roll_deg` | mm, deg | end pad in the base frame; all six or none |
//! | `u1_kpa` .. `u6_kpa` | kPa | commanded gauge pressure; all six or none |
//! | `payload_kg` | kg | optional |
//!
//! Columns come in any order, others are ignored, an empty cell is a gap. In memory everything is
//! SI and a gap is NaN (or `None` for a pose).

mod columns;
mod data;
mod read;
#[cfg(test)]
mod tests;
mod write;

#[cfg(test)]
pub(crate) use columns::column_names;
pub(crate) use columns::columns;
pub use data::SessionLog;
pub(crate) use data::median_step_s;
pub(crate) use read::not_our_header;
pub(super) use read::session_is_simulated;
pub use read::{parse_log, read_session, read_session_with};
#[cfg(test)]
pub(crate) use read::{parse_within, read_within};
pub use write::{SESSION_FILES, session_table, write_session, write_session_table};
