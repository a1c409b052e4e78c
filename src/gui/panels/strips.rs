//! The last seconds of position and pressure, for the Operate screen.

use egui::Ui;
use serde::{Deserialize, Serialize};

use super::plot::{Legend, Series, TimePlot, TimeWindow, stack};
use super::widgets::ends;
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
}

/// The panel.
pub fn ui(ui: &mut Ui, view: &View<'_>, choice: &mut StripChoice, window: &mut TimeWindow) {
    let chooser = |ui: &mut Ui| {
        for (value, text, hover) in [
            (
                StripChoice::Position,
                "Position",
                "x, y, z of the tip in mm",
            ),
            (
                StripChoice::Orientation,
                "Orientation",
                "Yaw, pitch, roll of the tip in deg",
            ),
            (
                StripChoice::Pressure,
                "Pressure",
                "Gauge pressures in kPa, measured and set",
            ),
        ] {
            ui.selectable_value(choice, value, text)
                .on_hover_text(hover);
        }
    };
    let said = TimeWindow::said(view);
    ends(ui, "strips", &said, chooser, |ui| window.controls(ui, view));
    let pose = |first: usize| -> Vec<Vec<Series>> {
        (first..first + 3)
            .map(|i| {
                vec![
                    Series::solid(Channel::Tip(i), "predicted"),
                    Series::dashed(Channel::Truth(i), view.truth_name()),
                ]
            })
            .collect()
    };
    let stacks = match choice {
        StripChoice::Position => pose(0),
        StripChoice::Orientation => pose(3),
        StripChoice::Pressure => vec![
            (0..CHAMBERS)
                .map(|i| Series::solid(Channel::ChamberMeasured(i), (i + 1).to_string()))
                .chain((0..CHAMBERS).map(|i| Series::dashed(Channel::ChamberSet(i), "")))
                .collect(),
        ],
    };
    stack(ui, stacks.len(), 44.0, |ui, i, height, time_axis| {
        let series = &stacks[i];
        let channel = series[0].channel;
        let title = match channel {
            Channel::Tip(k) => format!("{} / {}", POSE_NAMES[k], channel.unit()),
            _ => "Chamber pressure / kPa".into(),
        };
        TimePlot {
            title: &title,
            series,
            min_span: match channel {
                Channel::Tip(k) if k < 3 => 2.0,
                _ => 1.0,
            },
            emphasis: &[],
            time_axis,
            legend: if i == 0 {
                Legend::Shown
            } else {
                Legend::Hidden
            },
            playhead_s: None,
        }
        .show(ui, view, window, height);
    });
}
