//! The window: screens, scene, offscreen pictures.

pub mod app;
pub mod compare;
pub mod history;
pub mod offscreen;
pub mod pace;
pub mod panels;
pub mod scene;
pub mod score;
pub mod services;
pub mod theme;

#[cfg(test)]
mod fixture;
#[cfg(test)]
mod tests;
#[cfg(test)]
mod vision;

pub use app::App;
pub use services::{RecordingEntry, Services};
