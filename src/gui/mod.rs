//! The window: screens, scene, offscreen pictures.

pub mod app;
pub mod history;
pub mod offscreen;
pub mod panels;
pub mod scene;
pub mod services;
pub mod theme;

#[cfg(test)]
mod fixture;
#[cfg(test)]
mod tests;

pub use app::App;
pub use services::{RecordingEntry, Services};
