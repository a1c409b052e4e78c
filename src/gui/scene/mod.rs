//! The arm in three dimensions: camera, parts, marks, pointer.
//!
//! [`Scene::ui`] takes the space that is left in a [`egui::Ui`], paints the snapshot there and reports what
//! the pointer did. It keeps the camera and nothing else that matters: the draft of a target belongs to
//! the caller. Drawing goes through a texture of its own, so a window, a test and a screenshot without
//! any window show the same picture.
//!
//! Middle or left drag orbits, Shift pans, the wheel zooms to the pointer, F frames the arm, 1, 3 and 7 are
//! front, right and top, 5 toggles the projection; Alt + wheel moves the draft target in depth. What a click
//! means in depth is in [`click`].

mod announce;
pub mod camera;
pub mod click;
pub mod colours;
pub mod compose;
pub mod convert;
mod entity;
pub mod gpu;
mod input;
pub mod mesh;
pub mod overlay;
mod place;
mod pointer;
mod press;
pub mod reachset;
mod view;

pub use camera::Controls;
pub use colours::Theme;
pub use entity::Entity;
pub use input::{Aids, Picking, PlanMarks, SceneInput, SceneOutput, Tool};
pub use view::Scene;

#[cfg(test)]
mod tests;
