//! The window: screens, scene, offscreen pictures.
//!
//! It shows snapshots of the [`twin`](crate::twin) and sends commands to it; it shows plans, calibrations and
//! findings of the gap finder, too. It lies on top: no other module of the library imports it. It opens no file, port or
//! process and imports neither link, rig, recording nor sim: what it needs of them it asks of the program
//! around it ([`services`]).

pub mod app;
pub mod job;
pub mod offscreen;
pub mod pace;
pub mod panels;
pub mod scene;
pub mod screen;
pub mod screens;
pub mod services;
pub mod theme;
pub mod view;

#[cfg(test)]
mod tests;
#[cfg(test)]
mod vision;

pub use app::App;
pub use services::{RecordingEntry, Services};
