//! The stretch of time that plots share.

use egui::Ui;

use crate::gui::panels::widgets::age;
use crate::gui::view::View;

/// The window of time that all plots show.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TimeWindow {
    /// Length, s.
    pub span_s: f64,
    /// End of a frozen window; `None` follows the newest value.
    pub frozen_end_s: Option<f64>,
    /// Instants of the cursors A and B, s, while they are shown.
    pub cursors_s: Option<[f64; 2]>,
}

/// Spans that can be chosen, s.
const SPANS: [(f64, &str); 5] = [
    (10.0, "10 s"),
    (30.0, "30 s"),
    (60.0, "1 min"),
    (300.0, "5 min"),
    (600.0, "10 min"),
];

impl Default for TimeWindow {
    fn default() -> Self {
        Self {
            span_s: 30.0,
            frozen_end_s: None,
            cursors_s: None,
        }
    }
}

impl TimeWindow {
    /// First and last instant, s.
    pub fn range_s(&self, now_s: f64) -> [f64; 2] {
        let end = self.frozen_end_s.unwrap_or(now_s);
        [end - self.span_s, end]
    }

    /// How old the newest data are when none come any more: the plots stand still until they do. Else empty.
    pub fn said(view: &View<'_>) -> String {
        let stale_s = view.stale_s();
        stale_s.map_or_else(String::new, |s| format!("last data {} ago", age(s)))
    }

    /// The row of controls: span and freeze.
    pub fn controls(&mut self, ui: &mut Ui, view: &View<'_>) {
        let now_s = view.now_s;
        let shown = SPANS
            .iter()
            .find(|(s, _)| *s == self.span_s)
            .map_or_else(|| format!("{:.1} s", self.span_s), |(_, t)| (*t).into());
        let combo = egui::ComboBox::from_id_salt("time window")
            .selected_text(shown)
            .width(76.0)
            .show_ui(ui, |ui| {
                for (span, text) in SPANS {
                    ui.selectable_value(&mut self.span_s, span, text);
                }
            });
        combo
            .response
            .accessible_name("Time window")
            .on_hover_text("How much time all plots show. Scroll over a plot to zoom.");
        let mut frozen = self.frozen_end_s.is_some();
        let text = if frozen {
            "▶ Follow"
        } else {
            "▮▮ Freeze"
        };
        let hover = if frozen {
            "Show the newest values again"
        } else {
            "Hold the plots still; drag them to look back"
        };
        if ui
            .add(egui::Button::selectable(frozen, text).frame_when_inactive(true))
            .on_hover_text(hover)
            .clicked()
        {
            frozen = !frozen;
            self.frozen_end_s = frozen.then_some(now_s);
        }
    }
}
