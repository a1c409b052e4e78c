//! The IMUs: live capture of a rest, then of slow motion to all sides.

use std::f32::consts::TAU;

use egui::{Button, Grid, Mesh, Pos2, RichText, Role, Sense, Stroke, Ui, WidgetInfo, pos2, vec2};

use egui_plot::MarkerShape;

use super::scatter::{Group, Scatter};
use super::springs::left_card;
use super::{CalibrateState, capture_gate, motion};
use crate::calibrate::imus::{
    ImuTake, Phase, RESIDUAL_MAX_RAD, REST_S, SAMPLES_NEEDED, SECTORS, SECTORS_NEEDED, TILT_RAD,
    Verdict,
};
use crate::calibrate::{Wizard, motion::all_sides};
use crate::gui::panels::widgets::card;
use crate::gui::panels::widgets::imu_name;
use crate::gui::panels::widgets::{gated, heading, note, number, status};
use crate::gui::theme::{Level, Palette};
use crate::gui::view::View;
use crate::sensing::imu_fit::ImuFit;
use crate::signal::IMUS;
use crate::twin::Command;

/// Outer ring of the disc, rad.
const DISC_RAD: f64 = 40.0 * std::f64::consts::PI / 180.0;

/// At most so many dots are drawn per disc.
const DOTS: usize = 300;

/// The step.
pub fn ui(
    ui: &mut Ui,
    live: &View<'_>,
    wizard: &mut Wizard,
    state: &mut CalibrateState,
    commands: &mut Vec<Command>,
    height: f32,
) {
    ui.horizontal_top(|ui| {
        left_card(ui, |ui| {
            controls(ui, live, wizard, state, commands);
        });
        ui.vertical(|ui| {
            let top = ui.cursor().top();
            let width = (ui.available_width() - ui.spacing().item_spacing.x) / 2.0;
            for pair in [[0, 1], [2, 3]] {
                ui.horizontal_top(|ui| {
                    for i in pair {
                        ui.allocate_ui(vec2(width, 0.0), |ui| {
                            card(ui, |ui| {
                                ui.set_width(width - 20.0);
                                imu(ui, live, wizard, i);
                            });
                        });
                    }
                });
            }
            let left = height - (ui.cursor().top() - top) - 20.0;
            if left >= RESIDUALS[0] {
                card(ui, |ui| {
                    ui.set_min_width(ui.available_width());
                    residuals(ui, wizard, left.min(RESIDUALS[1]));
                });
            }
        });
    });
}

/// Least and most height of the residuals below the four IMUs, points.
const RESIDUALS: [f32; 2] = [150.0, 420.0];

/// Residual of each IMU that passed, by its number, deg.
fn residuals_deg(wizard: &Wizard) -> Vec<[f64; 2]> {
    let of = |i: usize| match wizard.imu(i) {
        Verdict::Pass(fit) => Some(fit.entry.fit.residual_rad.to_degrees()),
        _ => None,
    };
    (0..IMUS)
        .filter_map(|i| Some([(i + 1) as f64, of(i)?]))
        .collect()
}

/// The residual angle of each IMU with the limit as a band: captured ones, else those of the calibration in use.
fn residuals(ui: &mut Ui, wizard: &Wizard, height: f32) {
    let p = *Palette::in_ui(ui);
    let captured = residuals_deg(wizard);
    let in_use = wizard.in_use.imus.iter();
    let in_use = in_use.map(|m| [m.imu as f64, m.fit.residual_rad.to_degrees()]);
    let limit_deg = RESIDUAL_MAX_RAD.to_degrees();
    let group = |name, points, color, shape| Group {
        name,
        points,
        color,
        shape: Some(shape),
    };
    Scatter {
        title: "Angle between gravity by the springs and by each IMU, RMS / deg",
        name: &format!(
            "Residuals of {} captured IMUs, PASS limit {} deg",
            captured.len(),
            number(limit_deg, 1)
        ),
        units: ["(IMU)", "deg"],
        names: true,
        x: [0.5, IMUS as f64 + 0.5],
        x_labels: true,
        groups: vec![
            group("in use", in_use.collect(), p.bar, MarkerShape::Circle),
            group("captured", captured, p.series[0], MarkerShape::Diamond),
        ],
        band: Some([0.0, limit_deg]),
        band_name: &format!("PASS: up to {} deg", number(limit_deg, 1)),
        min_span: 1.2 * limit_deg,
        ..Scatter::default()
    }
    .show(ui, height);
}

fn controls(
    ui: &mut Ui,
    live: &View<'_>,
    wizard: &mut Wizard,
    state: &mut CalibrateState,
    commands: &mut Vec<Command>,
) {
    ui.heading("Capture the IMUs");
    ui.label(format!(
        "First the arm rests for {REST_S:.0} s: the gyros are zeroed. Then it moves slowly to all sides: mountings, \
         accelerometers and the base's tilt follow from the pads' orientations by the springs. An IMU is done after \
         {SAMPLES_NEEDED} samples with the pad tilted by {:.0}° to {SECTORS_NEEDED} of {SECTORS} sides; about two \
         minutes.",
        TILT_RAD.to_degrees()
    ));
    ui.add_space(4.0);
    let gate = match wizard.imus.running() {
        true => Err("IMUs are being captured.".to_owned()),
        false => capture_gate(live),
    };
    let wide = vec2(ui.available_width(), 30.0);
    if wizard.imus.running() {
        let hover = "Judge what has been captured so far";
        let finish = Button::new("■ Finish capture").min_size(wide);
        let judged = match wizard.imus.phase() {
            Phase::Fit => Err("What was captured is being judged.".to_owned()),
            _ => Ok(()),
        };
        if gated(ui, &judged, finish, hover).clicked() {
            wizard.imus.finish();
        }
        match wizard.imus.phase() {
            _ if !live.snapshot.link.connected => note(ui, "◌ Paused until the boards answer."),
            Phase::Rest(_, Some(why)) => note(ui, format!("◌ No rest yet: {why}.")),
            Phase::Rest(left_s, None) => {
                note(ui, format!("◌ Hold the arm still: {left_s:.0} s more."))
            }
            Phase::Motion => note(
                ui,
                "◌ Gyros zeroed. Move the arm: it ends by itself when every IMU is done.",
            ),
            Phase::Fit => note(
                ui,
                "◌ Mountings and tilt are computed from what was captured.",
            ),
            Phase::Idle => note(ui, "◌ Waiting for frames."),
        };
    } else {
        let hover = "Zero the gyros, then compare springs and IMUs; what was captured is replaced";
        let begin = Button::new("● Capture all four IMUs").min_size(wide);
        if gated(ui, &gate, begin, hover).clicked() {
            let base = wizard.base();
            wizard.imus.begin([true; IMUS], live.spec, &base);
        }
    }
    ui.separator();
    note(
        ui,
        "After the rest the arm has to move; the button, or any motion from Operate:",
    );
    let label = [
        "▶ Move slowly to all sides",
        "▶ Move slowly to all sides (hold 0.8 s)",
    ];
    let plan = all_sides();
    match wizard.imus.phase() {
        Phase::Rest(..) => {
            note(ui, "◌ The arm rests first.");
        }
        Phase::Idle | Phase::Motion | Phase::Fit => {
            motion::button(ui, live, label, plan, &mut state.hold, commands);
        }
    }
    motion::under_way(ui, live);
    for sentence in wizard.imus.not_determined() {
        note(ui, format!("○ {sentence}."));
    }
    let captured = wizard
        .imus
        .imus
        .iter()
        .any(|t| t.verdict() != Verdict::Kept);
    if captured && !wizard.imus.running() {
        ui.separator();
        let button = Button::new("Discard the captures and skip").min_size(wide);
        let hover = "Forget what was captured of all IMUs; their former calibration is kept";
        if gated(ui, &Ok(()), button, hover).clicked() {
            wizard.imus = Default::default();
        }
    }
    if !captured {
        ui.separator();
        let name = &wizard.before.name;
        note(
            ui,
            format!("Nothing captured: Next keeps the IMUs of “{name}”."),
        );
    }
}

fn imu(ui: &mut Ui, live: &View<'_>, wizard: &mut Wizard, i: usize) {
    let p = *Palette::in_ui(ui);
    let take = &wizard.imus.imus[i];
    let verdict = wizard.imu(i);
    let gate = match (wizard.imus.running(), &verdict) {
        (true, _) => Err("IMUs are being captured.".to_owned()),
        (_, Verdict::Kept) => Err("Nothing has been captured of this IMU.".into()),
        _ => capture_gate(live),
    };
    let mut again = false;
    ui.horizontal_top(|ui| {
        disc(ui, take, i);
        ui.vertical(|ui| {
            ui.label(RichText::new(format!("IMU {}", imu_name(i))).strong());
            match &verdict {
                Verdict::Kept => note(ui, "○ kept as it is"),
                Verdict::Open => note(ui, "◌ capturing"),
                Verdict::Pass(_) => ui.label("● PASS"),
                Verdict::Redo(_) => status(ui, Level::Warning, "REDO"),
            };
            note(ui, format!("{} samples", take.samples()));
            let sides = take.sectors().iter().filter(|s| **s).count();
            note(ui, format!("{sides} of {SECTORS} sides"));
            if let Verdict::Pass(fit) = &verdict {
                ui.label(format!(
                    "{}° off nominal",
                    number(fit.entry.fit.correction_rad.norm().to_degrees(), 2)
                ))
                .on_hover_text("Angle of the mounting to the nominal one, degrees");
                ui.label(format!(
                    "{}° residual",
                    number(fit.entry.fit.residual_rad.to_degrees(), 2)
                ))
                .on_hover_text(
                    "Root mean square of the angle between gravity by the springs and by the IMU after the fit, degrees",
                );
            }
            let response = gated(
                ui,
                &gate,
                Button::new("Redo"),
                "Discard this IMU's samples and capture it alone; the others are kept",
            )
            .accessible_name(format!("Redo IMU {}", i + 1));
            again = response.clicked();
        });
        if let Verdict::Pass(fit) = &verdict
            && ui.available_width() > PARAMETERS
        {
            parameters(ui, fit, i);
        }
    });
    if again {
        let base = wizard.base();
        let which = std::array::from_fn(|k| k == i);
        wizard.imus.begin(which, live.spec, &base);
    }
    if let Verdict::Redo(why) = &verdict {
        ui.label(RichText::new(why).color(p.text));
    }
}

/// Least width for the fitted parameters, points.
const PARAMETERS: f32 = 480.0;

/// What was fitted of an IMU, with standard deviations; what the motion left open is marked.
fn parameters(ui: &mut Ui, fit: &ImuFit, i: usize) {
    ui.scope(|ui| {
        ui.spacing_mut().item_spacing = vec2(12.0, 1.0);
        ui.spacing_mut().interact_size.y = 16.0;
        Grid::new(("parameters", i)).num_columns(2).show(ui, |ui| {
            for pair in fit.parameters.chunks(2) {
                for q in pair {
                    let sign = if q.is_observed() { "●" } else { "○" };
                    let text = format!(
                        "{sign} {} {} ± {} {}",
                        q.name,
                        number(q.value, 3),
                        number(q.sigma, 3),
                        q.unit
                    );
                    heading(ui, text.trim_end()).on_hover_text(
                        "Value and standard deviation; ○: the motion did not determine it",
                    );
                }
                ui.end_row();
            }
        });
    });
}

/// Where the pad was tilted to: a sector is full once it counts.
fn disc(ui: &mut Ui, take: &ImuTake, i: usize) {
    let p = *Palette::in_ui(ui);
    let size = 148.0;
    let (rect, response) = ui.allocate_exact_size(vec2(size, size), Sense::hover());
    let (center, radius) = (rect.center(), 0.5 * size - 4.0);
    let painter = ui.painter().with_clip_rect(rect);
    painter.circle_filled(center, radius, p.sunken);
    let at = |turn: f32, share: f32| -> Pos2 {
        // x of the base to the right, y up.
        let (sin, cos) = (turn * TAU).sin_cos();
        center + radius * share * vec2(cos, -sin)
    };
    let sectors = take.sectors();
    let inner = (TILT_RAD / DISC_RAD) as f32;
    for (k, _) in sectors.iter().enumerate().filter(|(_, full)| **full) {
        let turn = |j: usize| (k as f32 + j as f32 / 12.0) / SECTORS as f32;
        // A ring segment is not convex: a strip of triangles.
        let mut ring = Mesh::default();
        for j in 0..=12 {
            ring.colored_vertex(at(turn(j), inner), p.raised);
            ring.colored_vertex(at(turn(j), 1.0), p.raised);
        }
        for v in 0..24 {
            ring.add_triangle(v, v + 1, v + 2);
        }
        painter.add(ring);
    }
    for share in [inner, 0.5, 1.0] {
        painter.circle_stroke(center, radius * share, Stroke::new(1.0, p.line));
    }
    for k in 0..SECTORS {
        let turn = k as f32 / SECTORS as f32;
        painter.line_segment([at(turn, inner), at(turn, 1.0)], Stroke::new(1.0, p.line));
    }
    for [x, y] in take
        .capture
        .tilts_rad()
        .iter()
        .step_by(1 + take.capture.tilts_rad().len() / DOTS)
    {
        let scale = f64::from(radius) / DISC_RAD;
        let dot = pos2(center.x + (x * scale) as f32, center.y - (y * scale) as f32);
        painter.circle_filled(dot, 1.5, p.bar);
    }
    let full = sectors.iter().filter(|s| **s).count();
    let text = format!("IMU {}: pad tilted to {full} of {SECTORS} sides", i + 1);
    response.widget_info(|| WidgetInfo::labeled(Role::Label, true, &text));
    response.on_hover_text(format!(
        "{text}. x of the base to the right, y up; rings at {:.0}°, 20° and 40°",
        TILT_RAD.to_degrees()
    ));
}
