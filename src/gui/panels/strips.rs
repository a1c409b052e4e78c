//! Signals over time, for the Operate screen: position, orientation, pressures, or what the operator chooses.

use egui::{Align, Layout, Popup, PopupCloseBehavior, RichText, ScrollArea, TextEdit, Ui, vec2};
use serde::{Deserialize, Serialize};

use super::plot::{
    self, Chosen, Export, Extras, Fit, Legend, Series, Strip, TimePlot, TimeWindow, stack, tools,
};
use super::widgets::{empty, ends, note};
use crate::analysis::history::{Channel, POSE_NAMES};
use crate::gui::view::View;
use crate::signal::CHAMBERS;

/// What the strips show.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum StripChoice {
    /// x, y, z of the tip, predicted and measured.
    #[default]
    Position,
    /// Yaw, pitch, roll of the tip, predicted and measured.
    Orientation,
    /// Measured and set pressures.
    Pressure,
    /// The signals that the operator chose.
    Chosen,
}

impl StripChoice {
    /// All of them.
    pub const ALL: [Self; 4] = [
        Self::Position,
        Self::Orientation,
        Self::Pressure,
        Self::Chosen,
    ];

    /// Name on its tab.
    pub fn name(self) -> &'static str {
        match self {
            Self::Position => "Position",
            Self::Orientation => "Orientation",
            Self::Pressure => "Pressure",
            Self::Chosen => "Chosen",
        }
    }

    fn hover(self) -> &'static str {
        match self {
            Self::Position => "x, y, z of the tip in mm",
            Self::Orientation => "Yaw, pitch, roll of the tip in deg",
            Self::Pressure => "Gauge pressures in kPa, measured and set",
            Self::Chosen => "Signals chosen by name, one plot per unit",
        }
    }
}

/// What the panel keeps.
#[derive(Default)]
pub struct StripsState {
    /// What the strips show.
    pub choice: StripChoice,
    /// The signals chosen by name.
    pub chosen: Chosen,
    /// Opens the list of signals in the next frame.
    pub wants_list: bool,
    /// A file of what the strips show.
    pub export: Export,
    filter: String,
}

/// Narrower than this the controls have little width, points.
const NARROW: f32 = 470.0;
/// From this width on everything is in one row, points.
const WIDE: f32 = 650.0;
/// Least height of a strip, points.
const LEAST: f32 = 26.0;

/// The panel.
pub fn ui(ui: &mut Ui, view: &View<'_>, state: &mut StripsState, window: &mut TimeWindow) {
    let fit = match ui.available_width() {
        w if w < NARROW => Fit::Brief,
        w if w < WIDE => Fit::Menu,
        _ => Fit::Full,
    };
    state.wants_list &= state.choice == StripChoice::Chosen;
    let StripsState { choice, export, .. } = state;
    ends(
        ui,
        "strips",
        &TimeWindow::said(view),
        |ui| tabs(ui, choice, fit),
        |ui| {
            ui.spacing_mut().item_spacing.x = 4.0;
            tools(ui, view, window, export, fit);
        },
    );
    if state.choice == StripChoice::Chosen {
        chooser(ui, state);
    }
    let strips = strips(view, state);
    if strips.is_empty() {
        let next = "Press “Choose signals” and mark those that shall be shown.";
        empty(ui, "No signals are chosen", next);
        state.export.wanted = None;
        return;
    }
    let whole = ui.available_rect_before_wrap().intersect(ui.clip_rect());
    let extras = Extras {
        smooth: window.smooth,
        differences: true,
        ..Extras::default()
    };
    let chosen = state.choice == StripChoice::Chosen;
    ui.push_id(state.choice.name(), |ui| {
        ui.spacing_mut().item_spacing.y = 2.0;
        stack(ui, strips.len(), LEAST, |ui, i, height, place| {
            let strip = &strips[i];
            let legend = match i == 0 || chosen {
                true => Legend::Shown,
                false => Legend::Hidden,
            };
            TimePlot {
                title: &strip.title,
                series: &strip.series,
                min_span: strip.min_span,
                emphasis: &[],
                place,
                legend,
                playhead_s: None,
            }
            .show_with(ui, view, window, height, extras);
        });
    });
    state.export.gather(view, window, &strips, "signals", whole);
}

fn tabs(ui: &mut Ui, choice: &mut StripChoice, fit: Fit) {
    ui.spacing_mut().item_spacing.x = 3.0;
    ui.spacing_mut().button_padding.x = 6.0;
    for value in StripChoice::ALL {
        let text = RichText::new(value.name());
        let text = match fit {
            Fit::Brief => text.small(),
            Fit::Menu | Fit::Cursors | Fit::Full => text,
        };
        ui.selectable_value(choice, value, text)
            .on_hover_text(value.hover());
    }
}

fn strips(view: &View<'_>, state: &StripsState) -> Vec<Strip> {
    let pose = |first: usize, min_span: f64| -> Vec<Strip> {
        (first..first + 3)
            .map(|i| {
                let channel = Channel::Tip(i);
                Strip {
                    title: format!("{} / {}", POSE_NAMES[i], channel.unit()),
                    series: vec![
                        Series::solid(channel, "predicted"),
                        Series::dashed(Channel::Truth(i), view.truth_name()),
                    ],
                    min_span,
                }
            })
            .collect()
    };
    match state.choice {
        StripChoice::Position => pose(0, 2.0),
        StripChoice::Orientation => pose(3, 1.0),
        StripChoice::Pressure => vec![Strip {
            title: "Chamber pressure / kPa".into(),
            series: (0..CHAMBERS)
                .map(|i| Series::solid(Channel::ChamberMeasured(i), (i + 1).to_string()))
                .chain((0..CHAMBERS).map(|i| Series::dashed(Channel::ChamberSet(i), "")))
                .collect(),
            min_span: 1.0,
        }],
        StripChoice::Chosen => state.chosen.strips(),
    }
}

// The button with the list of signals, and how many are chosen.
fn chooser(ui: &mut Ui, state: &mut StripsState) {
    ui.horizontal(|ui| {
        ui.spacing_mut().interact_size.y = 20.0;
        ui.spacing_mut().button_padding.y = 1.0;
        let response = ui
            .button("Choose signals")
            .on_hover_text("List all signals by group");
        if std::mem::take(&mut state.wants_list) {
            Popup::open_id(ui.ctx(), Popup::default_response_id(&response));
        }
        Popup::menu(&response)
            .accessible_name("Signals to show")
            .close_behavior(PopupCloseBehavior::CloseOnClickOutside)
            .show(|ui| list(ui, state));
        note(ui, format!("{} chosen", state.chosen.len()));
        if !state.chosen.is_empty()
            && ui
                .button("Clear")
                .accessible_name("Clear the chosen signals")
                .on_hover_text("Choose none")
                .clicked()
        {
            state.chosen.clear();
        }
    });
}

/// Size of the list of signals, points.
const LIST: [f32; 2] = [460.0, 300.0];

fn list(ui: &mut Ui, state: &mut StripsState) {
    ui.set_width(LIST[0]);
    let field = TextEdit::singleline(&mut state.filter)
        .hint_text("filter, as “tip” or “spring 1”")
        .desired_width(LIST[0] - 10.0);
    ui.horizontal(|ui| ui.add(field).accessible_name("Filter signals"));
    let words = state.filter.to_lowercase();
    let words: Vec<&str> = words.split_whitespace().collect();
    ScrollArea::vertical()
        .id_salt("signals")
        .max_height(LIST[1])
        .auto_shrink(false)
        .show(ui, |ui| {
            let mut any = false;
            for group in plot::groups() {
                let found: Vec<Channel> = group
                    .channels
                    .into_iter()
                    .filter(|c| is_found(&words, group.name, *c))
                    .collect();
                if found.is_empty() {
                    continue;
                }
                any = true;
                note(ui, group.name);
                rows(ui, &found, &mut state.chosen);
                ui.add_space(4.0);
            }
            if !any {
                note(ui, "No signal has this name: change the filter.");
            }
        });
}

/// Whether all words are in the name of a signal or of its group.
fn is_found(words: &[&str], group: &str, channel: Channel) -> bool {
    let text = format!("{group} {} {}", plot::name(channel), channel.unit()).to_lowercase();
    words.iter().all(|w| text.contains(w))
}

fn rows(ui: &mut Ui, channels: &[Channel], chosen: &mut Chosen) {
    const COLUMNS: usize = 3;
    let width = ui.available_width() / COLUMNS as f32;
    ui.spacing_mut().item_spacing = vec2(0.0, 2.0);
    for row in channels.chunks(COLUMNS) {
        ui.horizontal(|ui| {
            for channel in row {
                let size = vec2(width, ui.spacing().interact_size.y);
                let layout = Layout::left_to_right(Align::Center);
                ui.allocate_ui_with_layout(size, layout, |ui| {
                    ui.set_min_size(size);
                    ui.spacing_mut().icon_spacing = 5.0;
                    let mut on = chosen.has(*channel);
                    let name = RichText::new(plot::name(*channel)).small();
                    let unit = channel.unit();
                    if ui.checkbox(&mut on, name).on_hover_text(unit).changed() {
                        chosen.set(*channel, on);
                    }
                });
            }
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn signals_are_found_by_words_of_name_group_and_unit() {
        let found = |text: &str| {
            let words: Vec<&str> = text.split_whitespace().collect();
            let all = plot::groups().into_iter();
            all.flat_map(|g| g.channels.into_iter().map(move |c| (g.name, c)))
                .filter(|(group, c)| is_found(&words, group, *c))
                .count()
        };
        assert_eq!(found(""), 130);
        assert_eq!(found("spring 1a"), 4);
        assert_eq!(found("chamber set"), 6);
        assert_eq!(found("khz"), 12);
        assert_eq!(found("nothing"), 0);
    }
}
