//! The Sensors screen: springs as their X pairs, IMUs, boards, and linked plots.

mod plots;
mod side;
mod state;

pub use state::{Reading, SensorsState, axes};
use state::{channel_age_s, spring_channel};

use egui::{RichText, Sense, Stroke, Ui, vec2};

use super::plot::{TimeWindow, sparkline, sparkline_of};
use super::widgets::{
    Meter, NIS_WIDTH, age, card, cell, empty, fault_probability, heading, health, meter_of,
    nis_level, nis_meter, nis_words, number, pane, spring_sentence,
};
use crate::analysis::history::{Channel, spring_khz, spring_residual_mm};
use crate::gui::theme::{Level, Palette};
use crate::gui::view::View;
use crate::signal::{
    ChannelHealth, IMUS, SPRINGS, SensorFrame, UNKNOWN_M, spring_name, suspect_text,
};

/// The screen.
pub fn ui(ui: &mut Ui, view: &View<'_>, state: &mut SensorsState, window: &mut TimeWindow) {
    if !view.spec.has_springs && !view.spec.has_imus {
        let next = "Its pressures and poses are on Operate and Accuracy.";
        empty(ui, "This arm has no springs and no IMUs", next);
        return;
    }
    let Some(frame) = &view.snapshot.sensors else {
        let next = match view.replay {
            Some(_) => "This recording holds none up to here: play on, or load another one.",
            None => "They appear with the first frame from the boards.",
        };
        empty(ui, "No sensors yet", next);
        return;
    };
    let space = ui.available_size();
    let large = space.x >= LARGE[0] && space.y >= LARGE[1];
    let most = if large { SIDE_LARGE } else { SIDE[1] };
    let side = (space.x * 0.34).clamp(SIDE[0], most);
    let grid = space.x - side - 10.0;
    let form = match large {
        true => Form::Large,
        false => Form::within(grid),
    };
    notice(ui, view, frame, form.notices());
    let cards = form.height(space.y);
    ui.horizontal_top(|ui| {
        view.grey_if_stale(ui);
        ui.allocate_ui(vec2(grid, cards), |ui| {
            ui.vertical(|ui| springs(ui, view, frame, state, form, [grid, cards]));
        });
        ui.allocate_ui(vec2(ui.available_width(), cards), |ui| {
            pane(ui, "side", |ui| {
                magnify(ui, form.scale());
                side::ui(ui, view, frame, state.reading, form.scale());
            });
        });
    });
    ui.add_space(4.0);
    plots::ui(ui, view, state, window);
}

/// That the values shown are old, if they are.
pub fn stale(view: &View<'_>) -> Option<String> {
    view.is_stale().then(|| {
        format!(
            "{} Not connected: these are the last values, {} old.",
            Level::Warning.glyph(),
            age(view.snapshot.link.age_s)
        )
    })
}

/// What is to be read above the figures, most urgent first.
fn notices(view: &View<'_>, frame: &SensorFrame) -> Vec<(Level, String)> {
    let mut found = Vec::new();
    let raw = view.snapshot.raw.as_ref();
    if raw.is_some_and(|raw| !raw.clocks_are_known()) {
        let text = "The clocks of the boards are being measured: lengths follow in a moment.";
        found.push((Level::Warning, text.to_owned()));
    } else if frame.is_blind() {
        let text =
            "Blind: some signals are neither measured nor reconstructed. The twin does not move.";
        found.push((Level::Critical, text.to_owned()));
    }
    if let Some(text) = stale(view) {
        found.push((Level::Warning, text));
        return found;
    }
    let segment_of_imu = view.spec.pad_of_imu();
    for segment in 0..frame.quality.segment_suspect.len() {
        if let Some(suspects) = frame.quality.suspects(segment, segment_of_imu) {
            found.push((Level::Warning, suspect_text(segment, &suspects)));
        }
    }
    if let Some(need) = frame.quality.need {
        found.push((Level::Warning, need.text()));
    }
    let springs = (0..SPRINGS).map(|i| (frame.spring_evidence(i), i));
    let imus = (0..IMUS).map(|i| (frame.imu_evidence(i), i));
    let springs = springs
        .filter(|(e, _)| e.is_abnormal())
        .map(|(e, i)| (e, e.spring_text(i)));
    let imus = imus
        .filter(|(e, _)| e.is_abnormal())
        .map(|(e, i)| (e, e.imu_text(i)));
    found.extend(
        springs
            .chain(imus)
            .map(|(e, text)| (health(e.health).2, text)),
    );
    found
}

/// The lines above the figures. They are always there, so that nothing below them moves: the most urgent notices,
/// with all of them in their tooltips.
fn notice(ui: &mut Ui, view: &View<'_>, frame: &SensorFrame, lines: usize) {
    let p = Palette::in_ui(ui);
    let mut found = notices(view, frame);
    let all: Vec<String> = found
        .iter()
        .map(|(level, text)| format!("{} {text}", level.glyph()))
        .collect();
    let more = found.len().saturating_sub(lines);
    found.truncate(lines);
    let hints = [
        "A selected spring is highlighted in the plots and in 3D.",
        "The narrow bars are normalised innovations squared (NIS): 1, at the tick, for noise alone. ± is the band.",
    ];
    ui.scope(|ui| {
        ui.spacing_mut().item_spacing.y = 1.0;
        for (line, hint) in hints.into_iter().take(lines).enumerate() {
            let text = match found.get(line) {
                Some((level, text)) => {
                    let more = match line + 1 == lines && more > 0 {
                        true => format!("(+ {more}) "),
                        false => String::new(),
                    };
                    let text = format!("{} {more}{text}", level.glyph());
                    RichText::new(text).color(p.level(*level))
                }
                None if found.is_empty() => RichText::new(hint).color(p.weak),
                None => RichText::new(""),
            };
            let response = ui.add(egui::Label::new(text).truncate());
            if line < all.len() {
                response.on_hover_text(all.join("\n"));
            }
        }
    });
}

/// Width of the card beside the springs, points.
const SIDE: [f32; 2] = [412.0, 500.0];

/// The same in a large window, points.
const SIDE_LARGE: f32 = 600.0;
/// From this width and height of the screen on, figures are larger and stand beside their words, points.
const LARGE: [f32; 2] = [1800.0, 900.0];

/// How the X pairs lie.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Form {
    /// Three beside each other: a segment is a row. With sparklines.
    Wide,
    /// Two beside each other, without sparklines.
    Narrow,
    /// Three beside each other in large type, with residual and NIS in words.
    Large,
}

/// Between two cards, points.
const GAP: f32 = 8.0;
/// Width of a row of a pair's card with everything in it, points.
const ROW: f32 = 200.0;

impl Form {
    fn within(width: f32) -> Self {
        match width >= 3.0 * (ROW + 20.0) + 2.0 * GAP {
            true => Self::Wide,
            false => Self::Narrow,
        }
    }

    fn columns(self) -> usize {
        match self {
            Self::Wide | Self::Large => 3,
            Self::Narrow => 2,
        }
    }

    /// Lines of notices above the cards, at most two.
    fn notices(self) -> usize {
        match self {
            Self::Wide | Self::Large => 2,
            Self::Narrow => 1,
        }
    }

    /// Height of all cards in a screen of this height, points.
    fn height(self, screen: f32) -> f32 {
        match self {
            Self::Wide => 238.0,
            Self::Narrow => 318.0,
            Self::Large => (0.36 * screen).clamp(400.0, 520.0),
        }
    }

    /// By how much type and columns are larger than usual.
    fn scale(self) -> f32 {
        match self {
            Self::Wide | Self::Narrow => 1.0,
            Self::Large => 1.3,
        }
    }
}

/// Makes all type larger, from here on.
fn magnify(ui: &mut Ui, scale: f32) {
    if scale != 1.0 {
        for font in ui.style_mut().text_styles.values_mut() {
            font.size *= scale;
        }
    }
}

fn springs(
    ui: &mut Ui,
    view: &View<'_>,
    frame: &SensorFrame,
    state: &mut SensorsState,
    form: Form,
    [width, height]: [f32; 2],
) {
    ui.spacing_mut().item_spacing = vec2(GAP, GAP);
    let columns = form.columns();
    let rows = SPRINGS / 2 / columns;
    let inner = (width - (columns - 1) as f32 * GAP) / columns as f32 - 20.0;
    let high = (height - (rows - 1) as f32 * GAP) / rows as f32 - 20.0;
    for row in 0..rows {
        ui.horizontal(|ui| {
            for k in 0..columns {
                card(ui, |ui| {
                    ui.set_min_size(vec2(inner, high));
                    ui.set_max_width(inner);
                    magnify(ui, form.scale());
                    pair_card(ui, view, frame, state, form, columns * row + k);
                });
            }
        });
    }
}

// An X pair: a sketch of the crossing springs, and a row for each.
fn pair_card(
    ui: &mut Ui,
    view: &View<'_>,
    frame: &SensorFrame,
    state: &mut SensorsState,
    form: Form,
    pair: usize,
) {
    let p = *Palette::in_ui(ui);
    let angle = view.spec.spring_top_m[2 * pair] + view.spec.spring_bottom_m[2 * pair];
    let deg = angle.y.atan2(angle.x).to_degrees().rem_euclid(360.0);
    ui.spacing_mut().item_spacing = vec2(4.0, 2.0);
    ui.spacing_mut().interact_size.y = 16.0;
    ui.horizontal(|ui| {
        let (rect, _) = ui.allocate_exact_size(vec2(16.0, 16.0), Sense::hover());
        let color = p.signal(Channel::Spring(2 * pair));
        let line = |a, b, width| {
            ui.painter().line_segment([a, b], Stroke::new(width, color));
        };
        line(rect.left_top(), rect.right_bottom(), 2.0);
        line(rect.right_top(), rect.left_bottom(), 1.0);
        heading(
            ui,
            &format!(
                "Segment {}, pair {} at {deg:.0}° / {}",
                pair / 3 + 1,
                pair + 1,
                spring_channel(state.reading, 0).unit()
            ),
        )
        .on_hover_text("Angle of the X pair around the arm, from x through bellows 1");
    });
    if form == Form::Large {
        let height = 0.5 * (ui.available_height() - 4.0);
        for i in [2 * pair, 2 * pair + 1] {
            large_row(ui, view, frame, state, i, height);
        }
        return;
    }
    for i in [2 * pair, 2 * pair + 1] {
        spring_row(ui, view, frame, state, form, i);
    }
}

// Value in the unit of the reading, and its decimals.
fn spring_value(view: &View<'_>, frame: &SensorFrame, reading: Reading, i: usize) -> (f64, usize) {
    match reading {
        Reading::Calibrated => (frame.sensors.spring_m[i] * 1e3, 2),
        Reading::Raw => {
            let raw = view.snapshot.raw.as_ref();
            let raw = raw.filter(|r| r.has_spring(i) && r.spring_gate_ticks[i] > 0);
            (raw.map_or(f64::NAN, |r| spring_khz(r, i)), 1)
        }
        Reading::Residual => (spring_residual_mm(view.snapshot, i), 2),
    }
}

fn spring_row(
    ui: &mut Ui,
    view: &View<'_>,
    frame: &SensorFrame,
    state: &mut SensorsState,
    form: Form,
    i: usize,
) {
    let p = *Palette::in_ui(ui);
    let (_, _, level) = health(frame.health.springs[i]);
    let (value, decimals) = spring_value(view, frame, state.reading, i);
    let [value_width, age_width, glyph_width] = [54.0, 48.0, 14.0];
    ui.horizontal(|ui| {
        if form == Form::Narrow {
            ui.spacing_mut().button_padding.y = 2.0;
        }
        choose(ui, state, i, vec2(34.0, 22.0));
        let fixed = value_width + age_width + glyph_width + NIS_WIDTH + 4.0 * 4.0;
        let rest = ui.available_width() - fixed;
        ui.vertical(|ui| {
            ui.spacing_mut().item_spacing.y = 0.0;
            ui.set_width(rest.max(24.0));
            if form == Form::Wide {
                sparkline(ui, view, spring_channel(state.reading, i), 10.0, 0.2);
            }
            length_bar(ui, view, frame, i, [rest.max(24.0), 14.0]);
        });
        let text = p.level_text(level);
        let unit = spring_channel(state.reading, i).unit();
        nis_meter(
            ui,
            &format!("Spring {} NIS", spring_name(i)),
            frame.quality.nis[i],
        );
        let evidence = frame.spring_evidence(i);
        let band_mm = evidence.extra_sigma * 1e3;
        stacked(ui, value_width, |ui| {
            let value = RichText::new(number(value, decimals)).color(text);
            low_cell(ui, value)
                .on_hover_text(format!("Spring {} in {unit}", spring_name(i)));
            if band_mm >= BAND_LEAST_MM {
                let color = match evidence.extra_sigma {
                    sd if sd >= UNKNOWN_M => p.critical,
                    _ => p.level(level),
                };
                let band = RichText::new(format!("± {}", number(band_mm, 2)));
                low_cell(ui, band.small().color(color)).on_hover_text(
                    "Band in mm: standard deviation beyond the usual noise. It grows with what is out",
                );
            }
        });
        let delivered = view.snapshot.raw.as_ref().is_some_and(|r| r.has_spring(i));
        let old = channel_age_s(view, delivered, i / (SPRINGS / 2), Channel::Spring(i));
        let old = old.map_or("—".into(), age);
        stacked(ui, age_width, |ui| {
            let old = RichText::new(old).small().color(p.weak);
            low_cell(ui, old)
                .on_hover_text("Age of the newest reading");
            if let Some((probability, level)) = fault_probability(&evidence) {
                let text = RichText::new(probability).small().color(p.level(level));
                low_cell(ui, text)
                    .on_hover_text("Probability that this spring is faulty");
            } else {
                let text = RichText::new(nis_text(frame.quality.nis[i])).small();
                low_cell(ui, text.color(p.weak))
                    .on_hover_text(nis_words(frame.quality.nis[i]));
            }
        });
        let (sign, hover) = condition_of(frame, i);
        cell(ui, glyph_width, RichText::new(sign).color(p.level(level))).on_hover_text(hover);
    });
}

/// The button that highlights a spring.
fn choose(ui: &mut Ui, state: &mut SensorsState, i: usize, size: egui::Vec2) {
    let selected = state.selected_spring == Some(i);
    let button = egui::Button::selectable(selected, spring_name(i)).min_size(size);
    let response = ui
        .add(button)
        .accessible_name(format!("Spring {}", spring_name(i)))
        .on_hover_text("Highlight this spring in the plots and in 3D");
    if response.clicked() {
        state.selected_spring = (!selected).then_some(i);
    }
}

/// Glyph of a spring's condition, and the sentence on it.
fn condition_of(frame: &SensorFrame, i: usize) -> (&'static str, String) {
    let condition = frame.health.springs[i];
    let (glyph, word, _) = health(condition);
    let extra_sigma = frame.spring_evidence(i).extra_sigma;
    let mut hover = format!("{word}: {}", spring_sentence(frame, i));
    if extra_sigma > 0.0 {
        hover = format!(
            "{hover}\nMay be off by ± {} mm beyond its usual noise.",
            number(extra_sigma * 1e3, 2)
        );
    }
    let sign = match condition {
        ChannelHealth::Ok if extra_sigma > BAND_SHOWN_M => "≈",
        _ => glyph,
    };
    (sign, hover)
}

/// A normalised innovation squared as a figure, as short as its column.
fn nis_text(nis: f64) -> String {
    match nis {
        x if x >= 99.5 => "NIS >99".to_owned(),
        x if x >= 9.95 => format!("NIS {}", number(x, 0)),
        x => format!("NIS {}", number(x, 1)),
    }
}

/// A spring in a large window: curve and bar, the figure, and residual, innovations, age and health in words.
fn large_row(
    ui: &mut Ui,
    view: &View<'_>,
    frame: &SensorFrame,
    state: &mut SensorsState,
    i: usize,
    height: f32,
) {
    let p = *Palette::in_ui(ui);
    let (_, word, level) = health(frame.health.springs[i]);
    let (value, decimals) = spring_value(view, frame, state.reading, i);
    let (sign, hover) = condition_of(frame, i);
    let evidence = frame.spring_evidence(i);
    let nis = frame.quality.nis[i];
    let color = p.level_text(level);
    let [value_width, words_width] = [100.0, 200.0];
    ui.horizontal_top(|ui| {
        ui.set_height(height);
        ui.spacing_mut().item_spacing.x = 8.0;
        choose(ui, state, i, vec2(48.0, 40.0));
        let fixed = value_width + words_width + NIS_WIDTH + 3.0 * 8.0;
        let rest = (ui.available_width() - fixed).max(60.0);
        ui.vertical(|ui| {
            ui.set_width(rest);
            let line = (height - 34.0).clamp(18.0, 60.0);
            sparkline_of(
                ui,
                view,
                spring_channel(state.reading, i),
                [10.0, 0.2],
                line,
            );
            length_bar(ui, view, frame, i, [rest, 24.0]);
        });
        nis_meter(ui, &format!("Spring {} NIS", spring_name(i)), nis);
        stacked(ui, value_width, |ui| {
            let unit = spring_channel(state.reading, i).unit();
            let figure = RichText::new(number(value, decimals)).heading();
            low_cell(ui, figure.strong().color(color))
                .on_hover_text(format!("Spring {} in {unit}", spring_name(i)));
            let band_mm = evidence.extra_sigma * 1e3;
            if band_mm >= BAND_LEAST_MM {
                let color = match evidence.extra_sigma {
                    sd if sd >= UNKNOWN_M => p.critical,
                    _ => p.level(level),
                };
                let band = RichText::new(format!("± {} mm", number(band_mm, 2))).small();
                low_cell(ui, band.color(color))
                    .on_hover_text("Band: standard deviation beyond the usual noise");
            }
        });
        ui.vertical(|ui| {
            ui.spacing_mut().item_spacing.y = 0.0;
            ui.set_width(words_width);
            let delivered = view.snapshot.raw.as_ref().is_some_and(|r| r.has_spring(i));
            let old = channel_age_s(view, delivered, i / (SPRINGS / 2), Channel::Spring(i));
            let old = old.map_or("—".into(), age);
            let faulty = fault_probability(&evidence)
                .map_or(String::new(), |(p, _)| format!(", faulty {p}"));
            let residual_mm = spring_residual_mm(view.snapshot, i);
            let lines = [
                (format!("{sign} {word}{faulty}, {old} old"), p.level(level)),
                (format!("residual {} mm", number(residual_mm, 2)), p.weak),
                (
                    format!("{}: {}", nis_text(nis), nis_words(nis)),
                    p.level(nis_level(nis)),
                ),
            ];
            for (text, color) in lines {
                let text = RichText::new(text).small().color(color);
                ui.add(egui::Label::new(text).truncate())
                    .on_hover_text(&hover);
            }
        });
    });
}

/// A healthy spring with a wider band than this is marked as approximate, m.
const BAND_SHOWN_M: f64 = 0.3e-3;
/// Less than this would read as 0.00, mm.
const BAND_LEAST_MM: f64 = 0.005;

/// Height of a spring's row: a figure and a small one below it, points.
const ROW_HEIGHT: f32 = 29.0;

/// A right-aligned figure with another one below it, if there is one.
fn stacked(ui: &mut Ui, width: f32, lines: impl FnOnce(&mut Ui)) {
    let size = vec2(width, ROW_HEIGHT);
    let layout = egui::Layout::top_down(egui::Align::Max);
    ui.allocate_ui_with_layout(size, layout, |ui| {
        ui.spacing_mut().item_spacing.y = 0.0;
        ui.set_min_size(size);
        lines(ui);
    });
}

/// A figure of a stack.
fn low_cell(ui: &mut Ui, text: RichText) -> egui::Response {
    ui.add(egui::Label::new(text).truncate())
}

fn length_bar(ui: &mut Ui, view: &View<'_>, frame: &SensorFrame, i: usize, size: [f32; 2]) {
    let p = *Palette::in_ui(ui);
    let range = view.spec.spring.range_m.map(|x| x * 1e3);
    let (_, _, level) = health(frame.health.springs[i]);
    let name = format!("Spring {} length in mm", spring_name(i));
    meter_of(
        ui,
        size,
        &Meter {
            name: &name,
            range,
            origin: range[0],
            value: Some(frame.sensors.spring_m[i] * 1e3),
            mark: None,
            color: match level {
                Level::Normal => p.bar,
                _ => p.level(level),
            },
        },
    )
    .on_hover_text(format!(
        "{name}, bar from {} to {} mm",
        number(range[0], 0),
        number(range[1], 0)
    ));
}
