//! The y axis of a plot: what fits the signals, what the operator chose instead, and the numbers beside it.

use egui::{Id, TextStyle, Ui};
use egui_plot::{AxisHints, GridMark};

use super::ticks::{decimals_of, marks, marks_of_decades};
use crate::gui::panels::widgets::number;
use crate::gui::view::View;

/// How values are laid along the axis.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum Scale {
    /// Evenly.
    #[default]
    Linear,
    /// By their decimal logarithm.
    Log,
}

/// The least value on a logarithmic axis.
const LEAST_LOG: f64 = 1e-3;

impl Scale {
    /// Where a value is on the axis.
    pub(super) fn place(self, value: f64) -> f64 {
        match self {
            Self::Linear => value,
            Self::Log => value.max(LEAST_LOG).log10(),
        }
    }

    /// The value at a place on the axis.
    pub(super) fn value(self, place: f64) -> f64 {
        match self {
            Self::Linear => place,
            Self::Log => 10_f64.powf(place),
        }
    }

    /// The least span of the axis, for signals with such a noise floor.
    pub(super) fn least(self, min_span: f64) -> f64 {
        match self {
            Self::Linear => min_span,
            Self::Log => 0.5,
        }
    }
}

/// What is kept of a plot's y axis from one frame to the next.
#[derive(Clone, Copy, Debug)]
pub(super) struct Kept {
    id: Id,
    /// The values the operator chose; `None`: what fits the signals.
    pub(super) manual: Option<[f64; 2]>,
    /// The scale.
    pub(super) scale: Scale,
}

impl Kept {
    /// That of the plot `title` of a session or a recording. Without `has_log` the axis is linear.
    pub(super) fn of(ui: &Ui, title: &str, view: &View<'_>, has_log: bool) -> Self {
        let id = ui
            .scope_id()
            .with(("y axis", title, view.replay, view.history.sessions()));
        let kept = ui.data(|d| d.get_temp::<(Option<[f64; 2]>, Scale)>(id));
        // What was chosen on a logarithmic axis means nothing on a linear one.
        let kept = kept.filter(|(_, scale)| has_log || *scale == Scale::Linear);
        let (manual, scale) = kept.unwrap_or_default();
        Self { id, manual, scale }
    }

    /// Keeps it.
    pub(super) fn keep(self, ui: &Ui) {
        ui.data_mut(|d| d.insert_temp(self.id, (self.manual, self.scale)));
        ui.ctx().request_repaint();
    }
}

/// Numbers and lines of the grid beside a y axis of `height` points.
pub(super) fn grid([low, high]: [f64; 2], height: f32, scale: Scale) -> (Vec<GridMark>, usize) {
    match scale {
        Scale::Linear => marks(low, high, f64::from(height)),
        Scale::Log => (marks_of_decades(low, high, f64::from(height)), 0),
    }
}

/// The axis with numbers of so many decimals, at least `width` points wide.
pub(super) fn hints(ui: &Ui, width: f32, decimals: usize, scale: Scale) -> AxisHints<'static> {
    AxisHints::new_y()
        .min_thickness(width)
        .label_spacing(0.0..=1.0)
        .tick_label_font(TextStyle::Small.resolve(ui.style()))
        .tick_label_color(ui.visuals().text_color())
        .formatter(move |mark, _| {
            let decimals = match scale {
                Scale::Linear => decimals,
                Scale::Log => decimals_of(scale.value(mark.value)),
            };
            number(scale.value(mark.value), decimals)
        })
}
