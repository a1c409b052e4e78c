//! The panels: each is a function of what is known now and pushes commands; it keeps only
//! selection and text drafts.

pub mod accuracy;
pub mod agreement;
pub mod calibrate;
pub mod chambers;
pub mod conduct;
pub mod connect;
pub mod dashboard;
pub mod files;
pub mod gap;
pub mod operate;
pub mod operating;
pub mod palette;
pub mod picture;
pub mod plans;
pub mod plot;
pub mod pose;
pub mod readiness;
pub mod rec;
pub mod recordings;
pub mod rerun;
pub mod sensors;
pub mod shell;
pub mod strips;
pub mod target;
pub mod toasts;
pub mod trouble;
pub mod view3d;
pub mod welcome;
pub mod widgets;

pub use super::view::{View, live_until_s};
