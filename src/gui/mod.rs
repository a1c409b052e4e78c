//! The window: screens, scene, offscreen pictures.

pub mod offscreen;
pub mod scene;
