//! The window: screens, scene, offscreen pictures.
