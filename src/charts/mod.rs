//! Pictures as SVG: the elements ([`svg`]), and charts made of them.

mod chart;
pub mod svg;

pub use chart::{Axes, Bar, Bars, Chart, Line};
