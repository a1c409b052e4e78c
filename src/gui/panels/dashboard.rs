//! Springs and IMUs in brief, for the Operate screen.

use egui::{RichText, Ui, vec2};

use super::plot::{Dash, sparkline, swatch};
use super::widgets::{
    Meter, cell, cell_left, dense, heading, health, imu_name, imu_sentence, meter, note, number,
    spring_sentence,
};
use crate::analysis::history::Channel;
use crate::gui::theme::{Level, Palette};
use crate::gui::view::View;
use crate::signal::{IMUS, SPRINGS, SensorFrame, spring_name};

/// From this height on every spring has a line of its own with its last seconds, points.
const TALL: f32 = 440.0;
/// Length of these lines, s.
const SPAN_S: f64 = 30.0;

/// The panel.
pub fn ui(ui: &mut Ui, view: &View<'_>) {
    let Some(frame) = &view.snapshot.sensors else {
        note(ui, "No sensors yet: waiting for the first frame.");
        return;
    };
    let tall = ui.available_height() > TALL;
    dense(ui);
    ui.spacing_mut().item_spacing.y = 2.0;
    match view.spec.has_springs {
        true if tall => spring_rows(ui, view, frame),
        true => springs(ui, view, frame),
        false => {
            note(ui, "This arm has no springs.");
        }
    }
    ui.add_space(2.0);
    match view.spec.has_imus {
        true => imus(ui, frame),
        false => {
            note(ui, "This arm has no IMUs.");
        }
    }
}

fn springs(ui: &mut Ui, view: &View<'_>, frame: &SensorFrame) {
    let p = *Palette::in_ui(ui);
    let range = view.spec.spring.range_m.map(|x| x * 1e3);
    heading(ui, "Springs / mm");
    // Two columns of name, bar, value and glyph with 4 between, 12 between the columns.
    let bar = (ui.available_width() - 12.0 - 2.0 * (24.0 + 44.0 + 14.0 + 3.0 * 4.0)) / 2.0;
    for row in 0..SPRINGS / 2 {
        ui.horizontal(|ui| {
            ui.spacing_mut().item_spacing.x = 4.0;
            for i in [row, row + SPRINGS / 2] {
                let state = frame.health.springs[i];
                let (glyph, word, level) = health(state);
                let mm = frame.sensors.spring_m[i] * 1e3;
                let color = if level == Level::Normal {
                    p.text
                } else {
                    p.level(level)
                };
                cell_left(ui, 24.0, RichText::new(spring_name(i)).color(p.weak));
                let name = format!("Spring {} length in mm", spring_name(i));
                meter(
                    ui,
                    bar,
                    &Meter {
                        name: &name,
                        range,
                        origin: range[0],
                        value: Some(mm),
                        mark: None,
                        color: if level == Level::Normal {
                            p.bar
                        } else {
                            p.level(level)
                        },
                    },
                )
                .on_hover_text(format!("{name}: {word}. {}", spring_sentence(frame, i)));
                cell(ui, 44.0, RichText::new(number(mm, 1)).color(color));
                cell(ui, 14.0, RichText::new(glyph).color(p.level(level)));
                if i < SPRINGS / 2 {
                    ui.add_space(8.0);
                }
            }
        });
    }
}

/// One line per spring: name, last seconds, length, health.
fn spring_rows(ui: &mut Ui, view: &View<'_>, frame: &SensorFrame) {
    let p = *Palette::in_ui(ui);
    heading(ui, &format!("Springs / mm, last {SPAN_S:.0} s"));
    for i in 0..SPRINGS {
        let (glyph, word, level) = health(frame.health.springs[i]);
        let mm = frame.sensors.spring_m[i] * 1e3;
        ui.horizontal(|ui| {
            let name = format!("Spring {} length in mm", spring_name(i));
            cell_left(ui, 24.0, RichText::new(spring_name(i)).color(p.weak));
            let width = (ui.available_width() - 52.0 - 14.0 - 8.0).max(40.0);
            ui.allocate_ui(vec2(width, 18.0), |ui| {
                sparkline(ui, view, Channel::Spring(i), SPAN_S, 2.0);
            });
            let value = RichText::new(number(mm, 1)).color(p.level_text(level));
            cell(ui, 52.0, value)
                .accessible_name(&name)
                .on_hover_text(format!("{name}: {word}. {}", spring_sentence(frame, i)));
            cell(ui, 14.0, RichText::new(glyph).color(p.level(level)));
        });
    }
}

fn imus(ui: &mut Ui, frame: &SensorFrame) {
    let p = *Palette::in_ui(ui);
    let width = ((ui.available_width() - 76.0 - 14.0 - 4.0 * 4.0) / 3.0).clamp(36.0, 80.0);
    ui.horizontal(|ui| {
        ui.spacing_mut().item_spacing.x = 4.0;
        cell_left(ui, 76.0, RichText::new("IMUs / deg").small().color(p.weak));
        for name in ["yaw", "pitch", "roll"] {
            cell(ui, width, RichText::new(name).small().color(p.weak));
        }
    });
    for i in 0..IMUS {
        let state = frame.health.imus[i];
        let (glyph, word, level) = health(state);
        let row = ui.horizontal(|ui| {
            ui.spacing_mut().item_spacing.x = 4.0;
            swatch(ui, p.signal(Channel::Imu(i, 0)), Dash::Solid);
            cell_left(ui, 56.0, RichText::new(imu_name(i)).color(p.weak));
            for k in 0..3 {
                let v = frame.sensors.imu_ypr_rad[i][k].to_degrees();
                cell(ui, width, RichText::new(number(v, 1)));
            }
            cell(ui, 14.0, RichText::new(glyph).color(p.level(level)));
        });
        row.response.on_hover_text(format!(
            "IMU {} on the {} pad, yaw, pitch, roll in deg: {word}. {}",
            i + 1,
            if i < 2 { "middle" } else { "end" },
            imu_sentence(frame, i)
        ));
    }
}
