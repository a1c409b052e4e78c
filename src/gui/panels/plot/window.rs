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
    /// Whether plots that offer it show a moving average over the signals.
    pub smooth: bool,
}

/// Shortest and longest window, s.
const LIMITS_S: [f64; 2] = [0.1, 600.0];

/// Spans that can be chosen, s.
pub const SPANS: [(f64, &str); 5] = [
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
            smooth: false,
        }
    }
}

impl TimeWindow {
    /// First and last instant, s.
    pub fn range_s(&self, now_s: f64) -> [f64; 2] {
        let end = self.frozen_end_s.unwrap_or(now_s);
        [end - self.span_s, end]
    }

    /// Makes the window `factor` times as long. The instant `about_s` keeps its place as far as nothing beyond `now_s` would be
    /// shown; without one the end keeps its place, and a window that follows goes on following.
    pub fn zoom(&mut self, factor: f64, about_s: Option<f64>, now_s: f64) {
        let span_s = (self.span_s * factor).clamp(LIMITS_S[0], LIMITS_S[1]);
        if let Some(about_s) = about_s {
            let [_, end] = self.range_s(now_s);
            let end = about_s + (end - about_s) * span_s / self.span_s;
            // One that follows and would show nothing else goes on following.
            if self.frozen_end_s.is_some() || end < now_s {
                self.frozen_end_s = Some(end.min(now_s));
            }
        }
        self.span_s = span_s;
    }

    /// Shows a stretch of time, frozen.
    pub fn show_range(&mut self, [from, to]: [f64; 2]) {
        self.span_s = (to - from).clamp(LIMITS_S[0], LIMITS_S[1]);
        self.frozen_end_s = Some(to);
    }

    /// Moves the window by some seconds, and freezes it; never beyond `now_s`.
    pub fn pan(&mut self, by_s: f64, now_s: f64) {
        if by_s != 0.0 {
            let [_, end] = self.range_s(now_s);
            let to_s = (end + by_s).min(now_s);
            // What follows goes on following where there is nothing newer to show.
            if self.frozen_end_s.is_some() || to_s < now_s {
                self.frozen_end_s = Some(to_s);
            }
        }
    }

    /// Shows both cursors, or takes them away.
    pub fn toggle_cursors(&mut self, view: &View<'_>) {
        if self.cursors_s.take().is_some() {
            return;
        }
        // Plots that run would carry the cursors out of sight.
        self.frozen_end_s.get_or_insert(view.now_s);
        let [from, to] = self.range_s(view.now_s);
        let from = view.history.range_s().map_or(from, |r| r[0].max(from));
        self.cursors_s = Some([0.35, 0.75].map(|u| from + u * (to - from)));
    }

    /// How old the newest data are when none come any more: the plots stand still until they do. Else empty.
    pub fn said(view: &View<'_>) -> String {
        let stale_s = view.stale_s();
        stale_s.map_or_else(String::new, |s| format!("last data {} ago", age(s)))
    }

    /// The row of controls: span and freeze.
    pub fn controls(&mut self, ui: &mut Ui, view: &View<'_>) {
        self.controls_in(ui, view, false);
    }

    /// As [`Self::controls`]; `brief`: in little width.
    pub(super) fn controls_in(&mut self, ui: &mut Ui, view: &View<'_>, brief: bool) {
        let now_s = view.now_s;
        let shown = SPANS
            .iter()
            .find(|(s, _)| *s == self.span_s)
            .map_or_else(|| format!("{:.1} s", self.span_s), |(_, t)| (*t).into());
        let combo = egui::ComboBox::from_id_salt("time window")
            .selected_text(shown)
            .width(if brief { 62.0 } else { 76.0 })
            .show_ui(ui, |ui| {
                for (span, text) in SPANS {
                    ui.selectable_value(&mut self.span_s, span, text);
                }
            });
        combo
            .response
            .accessible_name("Time window")
            .on_hover_text("How much time all plots show. Scroll over a plot to zoom, with Shift its values; drag with the right \
                 button to zoom to a box.");
        let mut frozen = self.frozen_end_s.is_some();
        let (name, text) = if frozen {
            ("▶ Follow", "▶")
        } else {
            ("▮▮ Freeze", "▮▮")
        };
        let text = if brief { text } else { name };
        let hover = if frozen {
            "Show the newest values again"
        } else {
            "Hold the plots still; drag them to look back"
        };
        if ui
            .add(egui::Button::selectable(frozen, text).frame_when_inactive(true))
            .accessible_name(name)
            .on_hover_text(hover)
            .clicked()
        {
            frozen = !frozen;
            self.frozen_end_s = frozen.then_some(now_s);
        }
    }
}
