//! The row above a plot: its title, buttons, and the names of its lines with what they do between the cursors.

use egui::{Align, Button, Color32, Layout, Response, RichText, Stroke, Ui, vec2};

use super::axis::{Kept, Scale};
use super::{Dash, Drawn, Legend, Place, TimePlot, names, swatch};
use crate::analysis::history::Channel;
use crate::gui::panels::widgets::number;
use crate::gui::theme::Palette;
use crate::gui::view::View;

/// A name in the row.
pub(super) struct Entry {
    /// What is written.
    text: String,
    /// What it means, for screen readers, where that is not what is written.
    meaning: Option<String>,
    color: Color32,
    dash: Dash,
}

/// The names of the lines; with `cursors_s` also by how much each signal changes between them.
pub(super) fn entries(
    ui: &Ui,
    plot: &TimePlot<'_>,
    drawn: &[Drawn],
    view: &View<'_>,
    cursors_s: Option<[f64; 2]>,
) -> Vec<Entry> {
    let p = Palette::in_ui(ui);
    let named = plot.legend == Legend::Shown || plot.place.is_enlarged();
    let own = plot.series.iter();
    let own = own.filter(|s| !s.name.is_empty() || plot.series.len() == 1);
    let own = own.filter_map(|s| {
        let delta = cursors_s.map(|at| difference(view, s.channel, at));
        let name = match named && s.name != plot.title {
            true => s.name.as_str(),
            false => "",
        };
        let unit = s.channel.unit();
        let text = match (&delta, name) {
            // The unit of many is that of the title.
            (Some(delta), name) if plot.series.len() > MANY => format!("{name} {delta}"),
            (Some(delta), name) => format!("{name} {delta} {unit}").trim().to_owned(),
            (None, "") => return None,
            (None, name) => name.to_owned(),
        };
        let meaning =
            delta.map(|delta| format!("{}: B − A {delta} {unit}", names::name(s.channel)));
        Some(entry(p, text, meaning, s.channel, s.dash))
    });
    let more = drawn.iter().filter(|d| named && !d.name.is_empty());
    let more = more.map(|d| entry(p, d.name.clone(), None, d.channel, d.dash));
    own.chain(more).collect()
}

fn entry(
    p: &Palette,
    text: String,
    meaning: Option<String>,
    channel: Channel,
    dash: Dash,
) -> Entry {
    Entry {
        text,
        meaning,
        color: p.signal(channel),
        dash,
    }
}

/// Lines from which on their differences are written without a unit.
const MANY: usize = 3;

// By how much a signal changes from A to B.
fn difference(view: &View<'_>, channel: Channel, cursors_s: [f64; 2]) -> String {
    let [a, b] = cursors_s.map(|t| view.signals([t, t]).value_at(channel, t));
    let d = a.zip(b).map_or(f64::NAN, |(a, b)| b - a);
    number(d, 2)
}

/// Width of a swatch with the space around it, points.
const SWATCH: f32 = 31.0;

/// Draws the row. The axis is changed by its buttons; whether it was.
pub(super) fn row(
    ui: &mut Ui,
    title: &str,
    entries: &[Entry],
    differs: bool,
    place: Place,
    axis: &mut Kept,
    has_log: bool,
) -> bool {
    let p = Palette::in_ui(ui);
    ui.spacing_mut().item_spacing.x = 6.0;
    ui.spacing_mut().interact_size.y = 16.0;
    ui.spacing_mut().button_padding = vec2(3.0, 0.0);
    small(ui, title, p.text);
    if entries.is_empty() {
        // All on the left, over the oldest values: the newest stay in sight.
        return buttons(ui, title, place, axis, has_log);
    }
    if differs {
        small(ui, "B − A", p.weak);
    }
    let mut changed = false;
    ui.with_layout(Layout::right_to_left(Align::Center), |ui| {
        ui.spacing_mut().item_spacing.x = 5.0;
        changed = buttons(ui, title, place, axis, has_log);
        let shown = fitting(ui, entries);
        if shown < entries.len() {
            small(ui, &format!("+ {}", entries.len() - shown), p.weak);
        }
        for e in entries[..shown].iter().rev() {
            let label = small(ui, &e.text, p.weak);
            if let Some(meaning) = &e.meaning {
                label.accessible_name(meaning);
            }
            swatch(ui, e.color, e.dash);
            ui.add_space(5.0);
        }
    });
    changed
}

// Enlarges the plot and fits its axis; whether the axis was changed.
fn buttons(ui: &mut Ui, title: &str, place: Place, axis: &mut Kept, has_log: bool) -> bool {
    let mut changed = false;
    enlarge(ui, title, place);
    if axis.manual.is_some() {
        let reset = ui
            .add(Button::new(RichText::new("auto y").small()))
            .accessible_name(format!("Fit y of {title}"))
            .on_hover_text("Fit the y axis to the signals again, as a double click does");
        if reset.clicked() {
            axis.manual = None;
            changed = true;
        }
    }
    if has_log {
        let on = axis.scale == Scale::Log;
        let button = Button::selectable(on, RichText::new("log").small());
        let log = ui
            .add(button.frame_when_inactive(true))
            .accessible_name(format!("Logarithmic y of {title}"))
            .on_hover_text("Show the values on a logarithmic axis");
        if log.clicked() {
            axis.scale = if on { Scale::Linear } else { Scale::Log };
            axis.manual = None;
            changed = true;
        }
    }
    changed
}

// Nothing here takes the pointer from the plot below.
fn small(ui: &mut Ui, text: &str, color: Color32) -> Response {
    let text = RichText::new(text).small().color(color);
    ui.add(egui::Label::new(text).selectable(false))
}

// How many names have space.
fn fitting(ui: &Ui, entries: &[Entry]) -> usize {
    let font = egui::TextStyle::Small.resolve(ui.style());
    let space = ui.available_width();
    // No character is wider than the font is high: mostly there is nothing to measure.
    let most = |e: &Entry| e.text.chars().count() as f32 * font.size + SWATCH;
    if entries.iter().map(most).sum::<f32>() <= space {
        return entries.len();
    }
    let width = |e: &Entry| {
        let text = e.text.clone();
        let galley = ui.painter().layout_no_wrap(text, font.clone(), e.color);
        galley.size().x + SWATCH
    };
    let widths: Vec<f32> = entries.iter().map(width).collect();
    if widths.iter().sum::<f32>() <= space {
        return entries.len();
    }
    // With space for how many are left out.
    let mut rest = space - 30.0;
    let fits = |w: &&f32| {
        rest -= **w;
        rest >= 0.0
    };
    widths.iter().take_while(fits).count()
}

/// A button that gives the plot all of its stack's height, or shows all plots again.
fn enlarge(ui: &mut Ui, title: &str, place: Place) {
    let Some((id, index)) = place.stack else {
        return;
    };
    let (name, hover) = match place.is_enlarged() {
        true => (
            "Show all plots".to_owned(),
            "Show all plots of the stack again",
        ),
        false => (
            format!("Enlarge {title}"),
            "Show only this plot, in the height of all",
        ),
    };
    let response = ui
        .add(
            Button::new("")
                .frame_when_inactive(false)
                .min_size(vec2(18.0, 16.0)),
        )
        .accessible_name(&name)
        .on_hover_text(hover);
    let color = match response.hovered() || response.has_focus() {
        true => Palette::in_ui(ui).text,
        false => Palette::in_ui(ui).weak,
    };
    arrows(ui, &response, color, place.is_enlarged());
    if response.clicked() {
        ui.data_mut(|d| {
            if place.is_enlarged() {
                d.remove::<usize>(id);
            } else {
                d.insert_temp(id, index);
            }
        });
        ui.ctx().request_repaint();
    }
}

// Two arrows from the middle to opposite corners, or towards the middle.
fn arrows(ui: &Ui, response: &Response, color: Color32, inwards: bool) {
    let middle = response.rect.center();
    let stroke = Stroke::new(1.3, color);
    let painter = ui.painter();
    for side in [1.0, -1.0] {
        let corner = middle + side * vec2(4.5, -4.5);
        let inner = middle + side * vec2(1.0, -1.0);
        painter.line_segment([inner, corner], stroke);
        let (tip, back) = match inwards {
            true => (inner, side * vec2(3.5, -3.5)),
            false => (corner, side * vec2(-3.5, 3.5)),
        };
        painter.line_segment([tip, tip + vec2(back.x, 0.0)], stroke);
        painter.line_segment([tip, tip + vec2(0.0, back.y)], stroke);
    }
}
