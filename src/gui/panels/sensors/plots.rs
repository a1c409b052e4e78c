//! The linked plots of the sensors, and what lies between two cursors.

use egui::{DragValue, RichText, ScrollArea, Ui, vec2};

use super::state::{Reading, SensorsState, axes, imu_channel, spring_channel};
use crate::analysis::history::Channel;
use crate::gui::panels::plot::{
    self, Extras, Fit, Legend, Series, Strip, TimePlot, TimeWindow, tools,
};
use crate::gui::panels::widgets::{
    card, cell, cell_left, dense, ends, imu_name, note, number, status,
};
use crate::gui::theme::{Level, Palette};
use crate::gui::view::View;
use crate::signal::{IMUS, SPRINGS, spring_name};

/// The card below the figures.
pub fn ui(ui: &mut Ui, view: &View<'_>, state: &mut SensorsState, window: &mut TimeWindow) {
    card(ui, |ui| {
        ui.set_min_size(ui.available_size());
        controls(ui, view, state, window);
        if state.reading == Reading::Residual && view.snapshot.shape.is_none() {
            let text = match view.replay {
                Some(_) => "Recordings do not keep the model's shape: no residual can be shown.",
                None => "The model has no shape yet: no residual can be shown.",
            };
            status(ui, Level::Warning, text);
        }
        let table = match window.cursors_s {
            Some(_) => 262.0,
            None => 0.0,
        };
        let plots = ui.available_width() - table;
        let height = ui.available_height();
        ui.horizontal_top(|ui| {
            ui.allocate_ui(vec2(plots, height), |ui| {
                ui.vertical(|ui| {
                    ui.set_width(plots - if table > 0.0 { 8.0 } else { 0.0 });
                    ui.push_id("sensors", |ui| stack(ui, view, state, window));
                });
            });
            if window.cursors_s.is_some() {
                ui.vertical(|ui| cursors(ui, view, state, window));
            }
        });
    });
}

/// From this width on all controls are in one row, points.
const WIDE: f32 = 1000.0;

fn controls(ui: &mut Ui, view: &View<'_>, state: &mut SensorsState, window: &mut TimeWindow) {
    let SensorsState {
        reading,
        angle,
        selected_spring,
        export,
    } = state;
    let fit = match ui.available_width() < WIDE {
        true => Fit::Cursors,
        false => Fit::Full,
    };
    ends(
        ui,
        "controls",
        &TimeWindow::said(view),
        |ui| {
            ui.spacing_mut().item_spacing.x = 4.0;
            readings(ui, reading);
            if let Some(i) = *selected_spring
                && ui
                    .button(format!("Show all, not only {}", spring_name(i)))
                    .on_hover_text("Remove the highlight")
                    .clicked()
            {
                *selected_spring = None;
            }
            note(ui, "IMU");
            for (k, name) in axes(*reading).into_iter().enumerate() {
                ui.selectable_value(angle, k, name)
                    .on_hover_text("Which figure of the IMUs is plotted");
            }
        },
        |ui| {
            ui.spacing_mut().item_spacing.x = 4.0;
            tools(ui, view, window, export, fit);
        },
    );
}

fn readings(ui: &mut Ui, reading: &mut Reading) {
    for (value, text, hover) in [
        (
            Reading::Calibrated,
            "Calibrated",
            "Lengths in mm and angles in deg",
        ),
        (
            Reading::Raw,
            "Raw",
            "Before calibration: oscillator frequency in kHz and angular rates in deg/s",
        ),
        (
            Reading::Residual,
            "Residual",
            "Measured minus the twin's own model at the measured pressures, mm and deg",
        ),
    ] {
        ui.selectable_value(reading, value, text)
            .on_hover_text(hover);
    }
    ui.separator();
}

fn stack(ui: &mut Ui, view: &View<'_>, state: &mut SensorsState, window: &mut TimeWindow) {
    let reading = state.reading;
    let spring = |i: usize| {
        let (channel, name) = (spring_channel(reading, i), spring_name(i));
        if i.is_multiple_of(2) {
            Series::solid(channel, name)
        } else {
            Series::dashed(channel, name)
        }
    };
    let emphasis: Vec<Channel> = state
        .selected_spring
        .map(|i| spring_channel(reading, i))
        .into_iter()
        .collect();
    let what = match reading {
        Reading::Residual => ", measured − model",
        Reading::Calibrated | Reading::Raw => "",
    };
    let unit = spring_channel(reading, 0).unit();
    let imu = (0..IMUS).map(|i| Series::solid(imu_channel(reading, i, state.angle), imu_name(i)));
    // About the peak to peak noise of each.
    let [spring_floor, imu_floor] = match reading {
        Reading::Calibrated | Reading::Residual => [0.3, 0.5],
        Reading::Raw => [0.2, 1.0],
    };
    let strips = [
        Strip {
            title: format!("Springs of segment 1{what} / {unit}"),
            series: (0..SPRINGS / 2).map(spring).collect(),
            min_span: spring_floor,
        },
        Strip {
            title: format!("Springs of segment 2{what} / {unit}"),
            series: (SPRINGS / 2..SPRINGS).map(spring).collect(),
            min_span: spring_floor,
        },
        Strip {
            title: format!(
                "IMU {}{what} / {}",
                axes(reading)[state.angle],
                imu_channel(reading, 0, 0).unit()
            ),
            series: imu.collect(),
            min_span: imu_floor,
        },
    ];
    let extras = Extras {
        smooth: window.smooth,
        ..Extras::default()
    };
    let whole = ui.available_rect_before_wrap().intersect(ui.clip_rect());
    ui.spacing_mut().item_spacing.y = 3.0;
    plot::stack(ui, strips.len(), 52.0, |ui, i, height, place| {
        let strip = &strips[i];
        TimePlot {
            title: &strip.title,
            series: &strip.series,
            min_span: strip.min_span,
            // Springs alone are selected.
            emphasis: if i < 2 { &emphasis } else { &[] },
            place,
            legend: Legend::Shown,
            playhead_s: None,
        }
        .show_with(ui, view, window, height, extras);
    });
    state.export.gather(view, window, &strips, "sensors", whole);
}

// Instants of the cursors, and what each signal does between them.
fn cursors(ui: &mut Ui, view: &View<'_>, state: &SensorsState, window: &mut TimeWindow) {
    let p = *Palette::in_ui(ui);
    let Some([a, b]) = &mut window.cursors_s else {
        return;
    };
    dense(ui);
    let zero_s = view.history.zero_s();
    let head = |t: &str| RichText::new(t).small().color(p.weak);
    ui.horizontal(|ui| {
        for (name, t) in [("A", &mut *a), ("B", &mut *b)] {
            ui.label(name);
            // As the axis below counts.
            let drag = DragValue::new(t)
                .speed(0.01)
                .custom_formatter(move |t, _| plot::clock_text(t - zero_s, 2))
                .custom_parser(move |text| Some(plot::clock_value(text)? + zero_s));
            ui.add(drag)
                .accessible_name(format!("Cursor {name} in min:s"))
                .on_hover_text(
                    "Instant since the session or the recording began, min:s, as on the axis of the plots",
                );
        }
        let dt = format!("Δt {} s", number(*b - *a, 2));
        ui.label(dt).on_hover_text("B minus A");
    });
    let [a, b] = [*a, *b];
    let columns = [70.0, 56.0, 56.0, 56.0];
    ui.horizontal(|ui| {
        cell_left(ui, columns[0], head("signal"));
        for (t, w) in ["A", "B", "B − A"].into_iter().zip(&columns[1..]) {
            cell(ui, *w, head(t));
        }
    });
    let springs = (0..SPRINGS).map(|i| (spring_channel(state.reading, i), spring_name(i)));
    let imus = (0..IMUS).map(|i| {
        let name = format!("IMU {}", i + 1);
        (imu_channel(state.reading, i, state.angle), name)
    });
    ScrollArea::vertical()
        .id_salt("cursors")
        .auto_shrink(false)
        .show(ui, |ui| {
            for (channel, name) in springs.chain(imus) {
                let at = |t| view.signals([t, t]).value_at(channel, t);
                let [va, vb] = [at(a), at(b)];
                let d = va.zip(vb).map(|(x, y)| y - x);
                let texts = [va, vb, d].map(|v| v.map_or("—".into(), |v| number(v, 2)));
                let said = format!(
                    "{name}: B − A {} {} in {} s",
                    texts[2],
                    channel.unit(),
                    number(b - a, 2)
                );
                ui.horizontal(|ui| {
                    let text = format!("{name} / {}", channel.unit());
                    cell_left(ui, columns[0], RichText::new(text).small().color(p.weak));
                    for (k, text) in texts.iter().enumerate() {
                        let r = cell(ui, columns[k + 1], text.as_str());
                        if k == 2 {
                            r.accessible_name(&said).on_hover_text(&said);
                        }
                    }
                });
            }
        });
}
