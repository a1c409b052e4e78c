//! Small pieces the panels share: numbers, meters, buttons that explain why they are off.

use egui::{
    Align, Button, Color32, CornerRadius, Label, Layout, Rect, Response, RichText, Role, Sense,
    Stroke, Ui, WidgetInfo, pos2, vec2,
};

use crate::gui::theme::{Level, Palette};
pub use crate::gui::view::Gate;
use crate::signal::{
    ChannelHealth, Evidence, FAULT_NAMED, FAULT_OPEN, NIS_GATE, NIS_HIGH, SensorFrame, percent,
};

/// A number with a true minus sign, or a dash when it is not finite.
pub fn number(value: f64, decimals: usize) -> String {
    if !value.is_finite() {
        return "—".into();
    }
    let text = format!("{value:.decimals$}");
    match text.strip_prefix('-') {
        Some(digits) if digits.chars().all(|c| c == '0' || c == '.') => digits.into(),
        Some(digits) => format!("−{digits}"),
        None => text,
    }
}

/// A duration as m:ss.
pub fn minutes(t_s: f64) -> String {
    let t = t_s.max(0.0).round() as u64;
    format!("{}:{:02}", t / 60, t % 60)
}

/// A time as m:ss with tenths.
pub fn tenths(t_s: f64) -> String {
    let tenths = (t_s * 10.0).floor() as u64;
    format!("{}:{:02}.{}", tenths / 600, tenths / 10 % 60, tenths % 10)
}

/// An age in ms, or in s above one.
pub fn age(age_s: f64) -> String {
    if age_s < 1.0 {
        format!("{:.0} ms", age_s * 1e3)
    } else {
        format!("{age_s:.1} s")
    }
}

/// Name of an IMU with its pad.
pub fn imu_name(i: usize) -> String {
    format!("{} {}", i + 1, if i < 2 { "middle" } else { "end" })
}

/// A heading inside a panel.
pub fn heading(ui: &mut Ui, text: &str) -> Response {
    let color = Palette::in_ui(ui).weak;
    ui.label(RichText::new(text).small().color(color))
}

/// Weak text.
pub fn note(ui: &mut Ui, text: impl Into<String>) -> Response {
    let color = Palette::in_ui(ui).weak;
    ui.label(RichText::new(text).color(color))
}

/// A right-aligned text of fixed width, so that columns stay put.
pub fn cell(ui: &mut Ui, width: f32, text: impl Into<RichText>) -> Response {
    aligned_cell(ui, width, text, Layout::right_to_left(Align::Center))
}

/// A left-aligned text of fixed width.
pub fn cell_left(ui: &mut Ui, width: f32, text: impl Into<RichText>) -> Response {
    aligned_cell(ui, width, text, Layout::left_to_right(Align::Center))
}

fn aligned_cell(ui: &mut Ui, width: f32, text: impl Into<RichText>, layout: Layout) -> Response {
    let height = ui.text_style_height(&egui::TextStyle::Body) + 2.0;
    ui.allocate_ui_with_layout(vec2(width, height), layout, |ui| {
        ui.set_min_size(vec2(width, height));
        ui.add(Label::new(text.into()).truncate())
    })
    .inner
}

/// Glyph and text of a level in its colour; normal states stay grey.
pub fn status(ui: &mut Ui, level: Level, text: &str) -> Response {
    let color = Palette::in_ui(ui).level(level);
    ui.label(RichText::new(format!("{} {text}", level.glyph())).color(color))
}

/// Glyph, word and level of a channel's health.
pub fn health(health: ChannelHealth) -> (&'static str, &'static str, Level) {
    match health {
        ChannelHealth::Ok => ("●", "ok", Level::Normal),
        ChannelHealth::Suspect => ("?", "suspect", Level::Warning),
        ChannelHealth::Stuck => ("■", "stuck", Level::Critical),
        ChannelHealth::OutOfRange => ("↕", "range", Level::Critical),
        ChannelHealth::Missing => ("∅", "missing", Level::Critical),
    }
}

/// What a channel's health means and why, for tooltips: a spring's (0-based).
pub fn spring_sentence(frame: &SensorFrame, i: usize) -> String {
    frame.spring_evidence(i).spring_text(i)
}

/// The same for an IMU (0-based).
pub fn imu_sentence(frame: &SensorFrame, i: usize) -> String {
    frame.imu_evidence(i).imu_text(i)
}

/// Level of a normalised innovation squared: 1 for noise alone.
pub fn nis_level(nis: f64) -> Level {
    match nis {
        x if x > NIS_GATE => Level::Critical,
        x if x > NIS_HIGH => Level::Warning,
        _ => Level::Normal,
    }
}

/// What a normalised innovation squared means, in two or three words.
pub fn nis_words(nis: f64) -> &'static str {
    match nis_level(nis) {
        _ if !nis.is_finite() => "not known",
        Level::Normal => "as noise",
        Level::Warning => "above noise",
        Level::Critical => "beyond the gate",
    }
}

/// Probability that a channel is faulty with its level, where it is worth showing.
pub fn fault_probability(evidence: &Evidence) -> Option<(String, Level)> {
    let level = match evidence.probability {
        p if p > FAULT_NAMED => Level::Critical,
        p if p > FAULT_OPEN => Level::Warning,
        _ => return None,
    };
    Some((percent(evidence.probability), level))
}

/// A small upright bar of a normalised innovation squared on a logarithmic scale from 0.1 to 100, with a tick at 1.
pub fn nis_meter(ui: &mut Ui, name: &str, nis: f64) -> Response {
    let p = Palette::in_ui(ui);
    let (rect, response) = ui.allocate_exact_size(vec2(NIS_WIDTH, 18.0), Sense::hover());
    let y = |nis: f64| {
        let ratio = (nis.log10() + 1.0) / 3.0;
        rect.bottom() - rect.height() * ratio.clamp(0.0, 1.0) as f32
    };
    let painter = ui.painter();
    painter.rect_filled(rect, CornerRadius::same(1), p.raised);
    if nis.is_finite() {
        let color = match nis_level(nis) {
            Level::Normal => p.bar,
            level => p.level(level),
        };
        let fill = Rect::from_min_max(pos2(rect.left(), y(nis)), rect.max);
        painter.rect_filled(fill, CornerRadius::same(1), color);
    }
    painter.hline(rect.x_range(), y(1.0), Stroke::new(1.0, p.text));
    response.widget_info(|| {
        let mut info = WidgetInfo::labeled(Role::Meter, true, name);
        info.value = Some(nis);
        info
    });
    response.on_hover_text(format!(
        "{name} {}: squared innovation over its variance, averaged over 2 s. 1 for noise alone, above {} not explained \
         by healthy channels",
        number(nis, 1),
        number(NIS_HIGH, 0)
    ))
}

/// Width of a [`nis_meter`], points.
pub const NIS_WIDTH: f32 = 6.0;

/// A button that is on while `gate` is open and otherwise explains why it is off.
pub fn gated(ui: &mut Ui, gate: &Gate, button: Button<'_>, hover: &str) -> Response {
    match gate {
        Ok(()) => ui.add(button).on_hover_text(hover),
        Err(reason) => ui.add_enabled(false, button).on_disabled_hover_text(reason),
    }
}

/// Whether a button acts now: it does when a pointer goes down on it, however long it stays down and wherever it
/// slides, and when it is pressed by key or by an assistive technology.
pub fn goes_down(response: &Response) -> bool {
    if !response.enabled() {
        return false;
    }
    let pressed_at: Vec<egui::Pos2> = response.ctx.input(|i| {
        let at = i.events.iter().filter_map(|e| match e {
            egui::Event::PointerButton {
                pos, pressed: true, ..
            } => Some(*pos),
            // Only the first finger is a pointer.
            egui::Event::Touch {
                pos,
                phase: egui::TouchPhase::Start,
                ..
            } => Some(*pos),
            _ => None,
        });
        at.collect()
    });
    let hit = pressed_at.into_iter().any(|pos| {
        let top = response.ctx.layer_id_at(pos);
        response.interact_rect.contains(pos) && top.is_none_or(|layer| layer == response.layer_id)
    });
    // The click at the end of a press has acted already.
    let by_key = response.clicked() && !response.clicked_by(egui::PointerButton::Primary);
    hit || by_key
}

/// Whether a text field was left by Enter.
pub fn by_enter(field: &Response) -> bool {
    field.lost_focus() && field.ctx.input(|i| i.key_pressed(egui::Key::Enter))
}

/// A badge: text on a small filled box.
pub fn badge(ui: &mut Ui, text: &str, fill: Color32, color: Color32) -> Response {
    let font = egui::TextStyle::Body.resolve(ui.style());
    let galley = ui.painter().layout_no_wrap(text.to_owned(), font, color);
    let size = galley.size() + vec2(18.0, 8.0);
    let (rect, response) = ui.allocate_exact_size(size, Sense::hover());
    ui.painter().rect_filled(rect, CornerRadius::same(4), fill);
    let at = rect.center() - 0.5 * galley.size();
    ui.painter().galley(at, galley, color);
    response.widget_info(|| WidgetInfo::labeled(Role::Label, true, text));
    response
}

/// Rows as low as their text, for tables.
pub fn dense(ui: &mut Ui) {
    ui.spacing_mut().interact_size.y = 18.0;
    ui.spacing_mut().item_spacing = vec2(4.0, 3.0);
}

/// What a [`meter`] shows.
pub struct Meter<'a> {
    /// Name and unit for screen readers.
    pub name: &'a str,
    /// Lowest and highest value.
    pub range: [f64; 2],
    /// Where the fill begins.
    pub origin: f64,
    /// The value, if there is one.
    pub value: Option<f64>,
    /// A tick, for instance the set value.
    pub mark: Option<f64>,
    /// Colour of the fill.
    pub color: Color32,
}

/// A horizontal bar from `origin` to the value, with a tick.
pub fn meter(ui: &mut Ui, width: f32, m: &Meter<'_>) -> Response {
    meter_of(ui, [width, 14.0], m)
}

/// As [`meter`], of a width and a height.
pub fn meter_of(ui: &mut Ui, [width, height]: [f32; 2], m: &Meter<'_>) -> Response {
    let p = Palette::in_ui(ui);
    let (rect, response) = ui.allocate_exact_size(vec2(width.max(8.0), height), Sense::hover());
    let ratio = |v: f64| ((v - m.range[0]) / (m.range[1] - m.range[0])).clamp(0.0, 1.0) as f32;
    let x = |v: f64| rect.left() + rect.width() * ratio(v);
    let track = rect.shrink2(vec2(0.0, 2.0));
    let painter = ui.painter();
    painter.rect_filled(track, CornerRadius::same(2), p.raised);
    if let Some(v) = m.value.filter(|v| v.is_finite()) {
        let (a, b) = (x(m.origin), x(v));
        let fill = Rect::from_min_max(
            pos2(a.min(b), track.top()),
            pos2(a.max(b).max(a.min(b) + 2.0), track.bottom()),
        );
        painter.rect_filled(fill, CornerRadius::same(1), m.color);
    }
    if m.origin > m.range[0] {
        painter.vline(x(m.origin), rect.y_range(), Stroke::new(1.0, p.line));
    }
    if let Some(v) = m.mark.filter(|v| v.is_finite()) {
        painter.vline(x(v), rect.y_range(), Stroke::new(2.0, p.text));
    }
    response.widget_info(|| {
        let mut info = WidgetInfo::labeled(Role::Meter, true, m.name);
        info.value = m.value;
        info
    });
    response
}

/// A panel within a screen.
pub fn card(ui: &mut Ui, contents: impl FnOnce(&mut Ui)) {
    let p = Palette::in_ui(ui);
    egui::Frame::new()
        .fill(p.panel)
        .stroke(Stroke::new(1.0, p.line))
        .corner_radius(4)
        .inner_margin(9)
        .show(ui, |ui| ui.vertical(contents));
}

/// A card that fills the remaining space; contents that do not fit are scrolled.
pub fn pane(ui: &mut Ui, name: &str, contents: impl FnOnce(&mut Ui)) {
    card(ui, |ui| {
        ui.set_min_size(ui.available_size());
        egui::ScrollArea::vertical()
            .id_salt(name)
            .auto_shrink(false)
            .min_scrolled_height(0.0)
            .show(ui, contents);
    });
}

/// A row with something at its left and something at its right end; where both do not fit beside each other,
/// the right part has a line of its own. Both are laid out from left to right. The text `said` stands before the right
/// part as far as it fits, else in its tooltip, and moves nothing.
pub fn ends(
    ui: &mut Ui,
    name: &str,
    said: &str,
    left: impl FnOnce(&mut Ui),
    right: impl FnOnce(&mut Ui),
) {
    let id = ui.scope_id().with(("ends", name));
    // How wide the right part was; not known before the first frame.
    let known: f32 = ui.data(|d| d.get_temp(id)).unwrap_or(f32::INFINITY);
    ui.horizontal_wrapped(|ui| {
        left(ui);
        if ui.available_size_before_wrap().x < known {
            ui.end_row();
        }
        let rest = ui.available_size_before_wrap().x - known;
        let gap = rest - ui.spacing().item_spacing.x;
        if !said.is_empty() && gap > 30.0 {
            let size = vec2(gap, ui.spacing().interact_size.y);
            ui.allocate_ui_with_layout(size, Layout::right_to_left(Align::Center), |ui| {
                ui.set_min_size(size);
                let color = Palette::in_ui(ui).weak;
                ui.add(Label::new(RichText::new(said).color(color)).truncate());
            });
        } else if rest > 0.0 {
            ui.add_space(rest);
        }
        let from = ui.cursor().min;
        right(ui);
        let to = ui.cursor().min;
        let width = to.x - from.x - ui.spacing().item_spacing.x;
        // One that has grown and no longer fits is measured again, in a row of its own.
        let wrapped = to.y != from.y;
        let now = if wrapped { f32::INFINITY } else { width };
        if now != known && (now - known).abs() > 0.5 {
            ui.data_mut(|d| d.insert_temp(id, now));
            ui.ctx().request_repaint();
        }
    });
}

/// An empty state: what is missing and the next action, in the middle of the space left.
pub fn empty(ui: &mut Ui, title: &str, next: &str) {
    ui.vertical_centered(|ui| {
        ui.add_space((ui.available_height() * 0.35).min(120.0));
        ui.label(RichText::new(title).heading());
        note(ui, next);
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_have_one_way_to_be_written() {
        assert_eq!(number(-1.25, 1), "−1.2");
        assert_eq!(number(-0.04, 1), "0.0");
        assert_eq!(number(f64::NAN, 1), "—");
        assert_eq!(number(12.0, 0), "12");
        assert_eq!(minutes(125.4), "2:05");
        assert_eq!(tenths(75.26), "1:15.2");
    }
}
