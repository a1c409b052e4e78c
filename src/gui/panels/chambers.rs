//! The six chambers: measured and set gauge pressure.

use egui::{RichText, Ui};

use super::plot::{Dash, swatch};
use super::widgets::{Meter, cell, dense, meter, note, number};
use crate::analysis::history::Channel;
use crate::gui::theme::{Level, Palette};
use crate::gui::view::View;
use crate::signal::CHAMBERS;

// Beyond this part of the bound a pressure is close to it.
const CLOSE_RATIO: f64 = 0.95;

/// The panel.
pub fn ui(ui: &mut Ui, view: &View<'_>) {
    let limits = &view.spec.pressure;
    let range = [limits.min_pa * 1e-3, limits.max_pa * 1e-3];
    let Some(sensors) = &view.snapshot.sensors else {
        note(ui, "No pressures yet.");
        return;
    };
    let p = *Palette::in_ui(ui);
    dense(ui);
    ui.spacing_mut().item_spacing = egui::vec2(6.0, 5.0);
    let columns = [48.0, 44.0];
    let names = 16.0 + 6.0 + 14.0;
    let bar = (ui.available_width() - columns[0] - columns[1] - names - 3.0 * 6.0).max(40.0);
    ui.horizontal(|ui| {
        let unit = RichText::new("kPa").small().color(p.weak);
        super::widgets::cell_left(ui, names, unit)
            .on_hover_text("Gauge pressure in kPa: the bar is measured, the tick is set");
        let (rect, _) = ui.allocate_exact_size(egui::vec2(bar, 14.0), egui::Sense::hover());
        for (ratio, text) in [
            (0.0, range[0]),
            (0.5, 0.5 * (range[0] + range[1])),
            (1.0, range[1]),
        ] {
            let align = [
                egui::Align2::LEFT_CENTER,
                egui::Align2::CENTER_CENTER,
                egui::Align2::RIGHT_CENTER,
            ][(ratio * 2.0) as usize];
            ui.painter().text(
                egui::pos2(rect.left() + ratio * rect.width(), rect.center().y),
                align,
                number(text, 0),
                egui::TextStyle::Small.resolve(ui.style()),
                p.weak,
            );
        }
        cell(ui, columns[0], RichText::new("meas.").small().color(p.weak));
        cell(ui, columns[1], RichText::new("set").small().color(p.weak));
    });
    for i in 0..CHAMBERS {
        let usable = sensors.health.chambers[i].usable();
        let measured = sensors.chamber_pa[i] * 1e-3;
        let set = view
            .snapshot
            .command
            .as_ref()
            .map(|c| c.chamber_pa()[i] * 1e-3);
        let over = view.spec.is_over_pressure(sensors.chamber_pa[i]);
        let level = if over || !usable {
            Level::Critical
        } else if measured > CLOSE_RATIO * range[1] || measured < CLOSE_RATIO * range[0] {
            Level::Warning
        } else {
            Level::Normal
        };
        ui.horizontal(|ui| {
            let name = format!("Chamber {}", i + 1);
            swatch(ui, p.signal(Channel::ChamberMeasured(i)), Dash::Solid);
            super::widgets::cell_left(ui, 14.0, RichText::new(format!("{}", i + 1)).color(p.text));
            let color = if level == Level::Normal {
                p.bar
            } else {
                p.level(level)
            };
            let label = format!("{name} gauge pressure in kPa");
            let response = meter(
                ui,
                bar,
                &Meter {
                    name: &label,
                    range,
                    origin: 0.0,
                    value: usable.then_some(measured),
                    mark: set,
                    color,
                },
            );
            let text = if usable {
                number(measured, 1)
            } else {
                format!("{} —", level.glyph())
            };
            let text_color = if level == Level::Normal {
                p.text
            } else {
                p.level(level)
            };
            cell(ui, columns[0], RichText::new(text).color(text_color));
            let set_text = set.map_or("—".into(), |s| number(s, 1));
            cell(ui, columns[1], RichText::new(set_text).color(p.weak));
            response.on_hover_text(match level {
                Level::Normal => format!("{name}: bar measured, tick set, kPa gauge"),
                Level::Warning => format!("{name} is close to its pressure bound"),
                Level::Critical if usable => format!("{name} is over the pressure limit"),
                Level::Critical => format!("The gauge of {name} is not usable"),
            });
        });
    }
}
