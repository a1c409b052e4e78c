//! The Sensors screen: springs as their X pairs, IMUs, boards, and linked plots.

use egui::{Align, Layout, RichText, ScrollArea, Sense, Stroke, Ui, vec2};

use super::View;
use super::dashboard::{imu_name, spring_name};
use super::plot::{AXIS, Dash, Legend, Series, TimeAxis, TimePlot, TimeWindow, sparkline, swatch};
use super::shell::age;
use super::widgets::{
    Meter, cell, cell_left, dense, empty, heading, health, health_sentence, meter, note, number,
};
use crate::gui::history::Channel;
use crate::gui::theme::{Level, Palette};
use crate::signal::{BOARDS, IMUS, SPRINGS, SensorFrame};

/// What the screen keeps.
#[derive(Clone, Copy, Debug, Default)]
pub struct SensorsState {
    /// The spring (0-based) that stands out in plots and 3D.
    pub selected_spring: Option<usize>,
    /// Which angle of the IMUs is plotted: yaw, pitch or roll.
    pub angle: usize,
}

/// The screen.
pub fn ui(ui: &mut Ui, view: &View<'_>, state: &mut SensorsState, window: &mut TimeWindow) {
    let Some(frame) = &view.snapshot.sensors else {
        empty(
            ui,
            "No sensors yet",
            "They appear with the first frame from the boards.",
        );
        return;
    };
    let cards = 214.0;
    ui.horizontal_top(|ui| {
        let side = (ui.available_width() * 0.31).clamp(356.0, 460.0);
        let grid = ui.available_width() - side - 10.0;
        ui.allocate_ui(vec2(grid, cards), |ui| {
            ui.vertical(|ui| springs(ui, view, frame, state, grid));
        });
        ui.vertical(|ui| {
            card(ui, |ui| {
                ui.set_min_size(vec2(ui.available_width(), cards - 20.0));
                imus(ui, frame);
                ui.add_space(6.0);
                boards(ui, view);
            });
        });
    });
    ui.add_space(4.0);
    plots(ui, view, state, window);
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

fn springs(
    ui: &mut Ui,
    view: &View<'_>,
    frame: &SensorFrame,
    state: &mut SensorsState,
    width: f32,
) {
    let gap = 8.0;
    let inner = (width - 2.0 * gap) / 3.0 - 20.0;
    for segment in 0..2 {
        ui.horizontal(|ui| {
            ui.spacing_mut().item_spacing.x = gap;
            for k in 0..3 {
                let pair = 3 * segment + k;
                card(ui, |ui| {
                    ui.set_width(inner);
                    pair_card(ui, view, frame, state, pair);
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
    pair: usize,
) {
    let p = *Palette::in_ui(ui);
    let angle = view.spec.spring_top_m[2 * pair] + view.spec.spring_bottom_m[2 * pair];
    let deg = angle.y.atan2(angle.x).to_degrees().rem_euclid(360.0);
    ui.spacing_mut().item_spacing = vec2(6.0, 3.0);
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
            &format!("Segment {}, pair {} at {deg:.0}°", pair / 3 + 1, pair + 1),
        )
        .on_hover_text("Angle of the X pair around the arm, from x through bellows 1");
    });
    for i in [2 * pair, 2 * pair + 1] {
        spring_row(ui, view, frame, state, i);
    }
}

fn spring_row(
    ui: &mut Ui,
    view: &View<'_>,
    frame: &SensorFrame,
    state: &mut SensorsState,
    i: usize,
) {
    let p = *Palette::in_ui(ui);
    let range = view.spec.spring.range_m.map(|x| x * 1e3);
    let mm = frame.sensors.spring_m[i] * 1e3;
    let condition = frame.health.springs[i];
    let (glyph, word, level) = health(condition);
    let selected = state.selected_spring == Some(i);
    ui.horizontal(|ui| {
        let button = egui::Button::selectable(selected, spring_name(i)).min_size(vec2(34.0, 22.0));
        if ui
            .add(button)
            .on_hover_text("Make this spring stand out")
            .clicked()
        {
            state.selected_spring = (!selected).then_some(i);
        }
        let name = format!("Spring {} length in mm", spring_name(i));
        let rest = ui.available_width() - 62.0 - 18.0 - 3.0 * 6.0;
        let color = if level == Level::Normal {
            p.bar
        } else {
            p.level(level)
        };
        meter(
            ui,
            rest * 0.45,
            &Meter {
                name: &name,
                range,
                origin: range[0],
                value: Some(mm),
                mark: None,
                color,
            },
        )
        .on_hover_text(format!(
            "{name}, bar from {} to {} mm",
            number(range[0], 0),
            number(range[1], 0)
        ));
        ui.scope(|ui| {
            ui.set_max_width(rest * 0.55);
            sparkline(ui, view, Channel::Spring(i), 10.0, 1.0);
        });
        let text = if level == Level::Normal {
            p.text
        } else {
            p.level(level)
        };
        cell(ui, 62.0, RichText::new(number(mm, 2)).color(text));
        cell(ui, 18.0, RichText::new(glyph).color(p.level(level)))
            .on_hover_text(format!("{word}: {}", health_sentence(condition)));
    });
}

fn imus(ui: &mut Ui, frame: &SensorFrame) {
    let p = *Palette::in_ui(ui);
    dense(ui);
    let width = ((ui.available_width() - 96.0 - 62.0 - 4.0 * 4.0) / 3.0).max(44.0);
    ui.horizontal(|ui| {
        cell_left(ui, 96.0, RichText::new("IMUs / deg").small().color(p.weak));
        for name in ["yaw", "pitch", "roll"] {
            cell(ui, width, RichText::new(name).small().color(p.weak));
        }
        cell(ui, 62.0, RichText::new("health").small().color(p.weak));
    });
    for i in 0..IMUS {
        let condition = frame.health.imus[i];
        let (glyph, word, level) = health(condition);
        ui.horizontal(|ui| {
            swatch(ui, p.signal(Channel::Imu(i, 0)), Dash::Solid);
            cell_left(ui, 76.0, RichText::new(imu_name(i)).color(p.weak));
            for k in 0..3 {
                let v = frame.sensors.imu_ypr_rad[i][k].to_degrees();
                cell(ui, width, RichText::new(number(v, 2)));
            }
            cell(
                ui,
                62.0,
                RichText::new(format!("{glyph} {word}")).color(p.level(level)),
            )
            .on_hover_text(health_sentence(condition));
        });
    }
}

fn boards(ui: &mut Ui, view: &View<'_>) {
    let p = *Palette::in_ui(ui);
    let link = &view.snapshot.link;
    heading(ui, "Boards");
    for i in 0..BOARDS {
        let rate = link.board_rate_hz[i];
        let late = view.snapshot.raw.as_ref().map(|r| r.board_age_s[i]);
        ui.horizontal(|ui| {
            cell_left(
                ui,
                96.0,
                RichText::new(format!("Segment {}", i + 1)).color(p.weak),
            );
            cell(ui, 70.0, format!("{} Hz", number(rate, 1)))
                .on_hover_text("Frames per second over the last second");
            let text = late.map_or("—".into(), |a| format!("{} ms", number(a * 1e3, 1)));
            cell(ui, 70.0, text).on_hover_text("Age of the board's part of the newest frame");
            let clock = link.board_clock[i];
            let offset = clock.map_or("—".into(), |c| format!("{} s", number(c.offset_s, 3)));
            cell(ui, 90.0, offset).on_hover_text(clock.map_or(
                "The board's clock has not been fitted yet".to_owned(),
                |c| {
                    format!(
                        "Session time less board time. The board's clock runs {} ppm {}; pings agree \
                         within {} ms, a round trip takes {} ms",
                        number(c.skew_ratio.abs() * 1e6, 0),
                        if c.skew_ratio > 0.0 { "slow" } else { "fast" },
                        number(c.residual_s * 1e3, 3),
                        number(c.round_trip_s * 1e3, 2)
                    )
                },
            ));
        });
    }
    note(
        ui,
        format!(
            "{} frames, {} lost, newest {} old",
            link.frames,
            link.frames_lost,
            age(link.age_s)
        ),
    );
}

fn plots(ui: &mut Ui, view: &View<'_>, state: &mut SensorsState, window: &mut TimeWindow) {
    card(ui, |ui| {
        ui.set_min_size(ui.available_size());
        ui.horizontal(|ui| {
            ui.label("Linked plots");
            if let Some(i) = state.selected_spring
                && ui
                    .button(format!("Spring {} stands out: show all", spring_name(i)))
                    .clicked()
            {
                state.selected_spring = None;
            }
            ui.with_layout(Layout::right_to_left(Align::Center), |ui| {
                window.controls(ui, view.now_s);
                ui.separator();
                for (k, name) in ["yaw", "pitch", "roll"].into_iter().enumerate().rev() {
                    ui.selectable_value(&mut state.angle, k, name)
                        .on_hover_text("Which angle of the IMUs is plotted");
                }
                note(ui, "IMU");
            });
        });
        let spring = |i: usize| {
            let name = spring_name(i);
            if i.is_multiple_of(2) {
                Series::solid(Channel::Spring(i), name)
            } else {
                Series::dashed(Channel::Spring(i), name)
            }
        };
        let emphasis: Vec<Channel> = state
            .selected_spring
            .map(Channel::Spring)
            .into_iter()
            .collect();
        let angle = ["yaw", "pitch", "roll"][state.angle];
        let stacks: [(String, Vec<Series>, &[Channel], f64); 3] = [
            (
                "Springs of segment 1 / mm".into(),
                (0..SPRINGS / 2).map(spring).collect(),
                &emphasis,
                1.0,
            ),
            (
                "Springs of segment 2 / mm".into(),
                (SPRINGS / 2..SPRINGS).map(spring).collect(),
                &emphasis,
                1.0,
            ),
            (
                format!("IMU {angle} / deg"),
                (0..IMUS)
                    .map(|i| Series::solid(Channel::Imu(i, state.angle), imu_name(i)))
                    .collect(),
                &[],
                1.0,
            ),
        ];
        let axis = AXIS;
        let height = (ui.available_height() - axis) / 3.0 - ui.spacing().item_spacing.y;
        ScrollArea::vertical().auto_shrink(false).show(ui, |ui| {
            for (n, (title, series, emphasis, min_span)) in stacks.iter().enumerate() {
                let last = n == 2;
                TimePlot {
                    title,
                    series,
                    min_span: *min_span,
                    emphasis,
                    time_axis: if last {
                        TimeAxis::Shown
                    } else {
                        TimeAxis::Hidden
                    },
                    legend: Legend::Shown,
                    playhead_s: None,
                }
                .show(
                    ui,
                    view,
                    window,
                    height.max(60.0) + if last { axis } else { 0.0 },
                );
            }
        });
    });
}
