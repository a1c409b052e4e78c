//! Pictures as SVG: the elements ([`svg`]), charts made of them, and figures at the size that they have on paper
//! ([`Figure`]), also as PDF.

mod chart;
mod figure;
pub mod svg;

pub use chart::{Axes, Bar, Bars, Chart, Line};
pub use figure::{Anchor, COLUMN_MM, FONT_PT, Figure, Mark, PT_PER_MM, Plot, Rgb};
