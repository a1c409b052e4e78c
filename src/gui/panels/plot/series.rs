//! The lines of a plot.

use crate::analysis::history::Channel;

/// How a line of a plot is stroked.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Dash {
    /// A full line: measured or estimated.
    Solid,
    /// Dashed: ground truth, set values, the second spring of a pair.
    Dashed,
}

/// One line of a plot.
#[derive(Clone, Debug)]
pub struct Series {
    /// The signal.
    pub channel: Channel,
    /// Name in the legend.
    pub name: String,
    /// Stroke.
    pub dash: Dash,
}

impl Series {
    /// A full line.
    pub fn solid(channel: Channel, name: impl Into<String>) -> Self {
        Self {
            channel,
            name: name.into(),
            dash: Dash::Solid,
        }
    }

    /// A dashed line.
    pub fn dashed(channel: Channel, name: impl Into<String>) -> Self {
        Self {
            channel,
            name: name.into(),
            dash: Dash::Dashed,
        }
    }
}

/// A plot of a stack.
#[derive(Clone, Debug)]
pub struct Strip {
    /// Title with unit.
    pub title: String,
    /// Lines, first at the back.
    pub series: Vec<Series>,
    /// The y axis never shows less than this.
    pub min_span: f64,
}
