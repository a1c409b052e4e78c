//! Motion capture: pairs at rest, and where its world and object are on the robot.

use egui::{
    Button, Grid, Rect, RichText, Role, ScrollArea, Sense, Stroke, Ui, WidgetInfo, pos2, vec2,
};

use egui_plot::MarkerShape;

use super::scatter::{Group, Scatter};
use super::springs::left_card;
use super::{CalibrateState, capture_gate, motion};
use crate::calibrate::Wizard;
use crate::calibrate::imus::tilt;
use crate::calibrate::motion::{POSES, poses};
use crate::gui::panels::widgets::card;
use crate::gui::panels::widgets::{cell, gated, note, number, status};
use crate::gui::theme::{Level, Palette};
use crate::gui::view::View;
use crate::sensing::registration::{FrameFit, POSES_MIN, PosePair};
use crate::signal::{TruthSource, ypr_from_rotation};
use crate::task::Leg;
use crate::twin::Command;

/// The step.
pub fn ui(
    ui: &mut Ui,
    live: &View<'_>,
    wizard: &mut Wizard,
    state: &mut CalibrateState,
    commands: &mut Vec<Command>,
    height: f32,
) {
    let beside = ui.available_width() > RESIDUALS_BESIDE;
    ui.horizontal_top(|ui| {
        left_card(ui, |ui| {
            controls(ui, live, wizard, state, commands);
        });
        let width = match beside {
            true => 0.5 * (ui.available_width() - ui.spacing().item_spacing.x),
            false => ui.available_width(),
        };
        ui.allocate_ui(vec2(width, height), |ui| {
            ui.vertical(|ui| {
                ui.set_width(width);
                card(ui, |ui| {
                    ui.set_min_width(ui.available_width());
                    result(ui, live, wizard);
                });
                card(ui, |ui| {
                    ui.set_min_width(ui.available_width());
                    if ui.available_width() < BESIDE {
                        ui.horizontal_top(|ui| maps(ui, wizard.mocap.pairs()));
                        pairs(ui, wizard);
                        return;
                    }
                    ui.horizontal_top(|ui| {
                        ui.vertical(|ui| maps(ui, wizard.mocap.pairs()));
                        ui.vertical(|ui| pairs(ui, wizard));
                    });
                });
                if !beside && !wizard.mocap.pairs().is_empty() {
                    card(ui, |ui| residuals(ui, wizard, RESIDUALS));
                }
            });
        });
        if beside {
            let size = vec2(ui.available_width(), height);
            ui.allocate_ui(size, |ui| {
                card(ui, |ui| residuals(ui, wizard, height - 20.0));
            });
        }
    });
}

/// Above this width the residuals of the poses stand beside their table, points.
const RESIDUALS_BESIDE: f32 = 1500.0;
/// Height of the residuals below the table, points.
const RESIDUALS: f32 = 280.0;

/// What the other poses predict of each, against what was captured: distances and angles over the number of the pose.
fn residuals(ui: &mut Ui, wizard: &Wizard, height: f32) {
    ui.set_min_width(ui.available_width());
    let top = ui.cursor().top();
    ui.label(RichText::new("Residual of each pose, left out of the fit").strong());
    let Some(Ok(fit)) = wizard.mocap.fit() else {
        note(
            ui,
            format!("It follows from {POSES_MIN} poses on that determine the registration."),
        );
        return;
    };
    note(
        ui,
        "A pose stands out beyond six standard deviations of what the others predict; it is then not used.",
    );
    let p = *Palette::in_ui(ui);
    let rest = height - (ui.cursor().top() - top) - ui.spacing().item_spacing.y;
    for (k, (quantity, unit)) in [("Distance", "mm"), ("Angle", "deg")]
        .into_iter()
        .enumerate()
    {
        let [used, out] = per_pose(fit, k);
        let group = |name, points, color, shape| Group {
            name,
            points,
            color,
            shape: Some(shape),
        };
        let all = fit.held_out.len();
        Scatter {
            title: &format!("{quantity} / {unit} over the number of the pose"),
            name: &format!("{quantity} of {all} poses left out, {unit}"),
            units: ["(pose)", unit],
            names: true,
            x: [0.5, all as f64 + 0.5],
            x_labels: k == 1,
            groups: vec![
                group("used", used, p.series[0], MarkerShape::Circle),
                group("stands out", out, p.warning, MarkerShape::Diamond),
            ],
            least: Some(0.0),
            min_span: 0.2,
            ..Scatter::default()
        }
        .show(ui, 0.5 * rest);
    }
}

/// Distances (0, mm) or angles (1, deg) over the number of the pose: of those that are used, and of those that stand out.
fn per_pose(fit: &FrameFit, quantity: usize) -> [Vec<[f64; 2]>; 2] {
    let mut found = [Vec::new(), Vec::new()];
    for (i, held_out) in fit.held_out.iter().enumerate() {
        let value = match quantity {
            0 => held_out.distance_m() * 1e3,
            _ => held_out.angle_rad().to_degrees(),
        };
        let out = usize::from(fit.suspects.contains(&i));
        found[out].push([(i + 1) as f64, value]);
    }
    found
}

fn controls(
    ui: &mut Ui,
    live: &View<'_>,
    wizard: &mut Wizard,
    state: &mut CalibrateState,
    commands: &mut Vec<Command>,
) {
    ui.heading("Register motion capture");
    ui.label(format!(
        "Poses at rest, seen by both the robot and motion capture, register its world and its object: at \
         least {POSES_MIN}, tilted to different sides."
    ));
    let connected = capture_gate(live);
    let seen = match live.truth_is_fresh() {
        true => Ok(()),
        false => Err("Motion capture does not see the end pad.".to_owned()),
    };
    let can = connected.and(seen);
    let rested = wizard.mocap.rested();
    let gate = can.clone().and(rested.clone().map(|_| ()));
    let wide = vec2(ui.available_width(), 30.0);
    let hover = "Keep the mean of the last half second";
    let capture = Button::new("Capture this pose").min_size(wide);
    if gated(ui, &gate, capture, hover).clicked()
        && let Ok(pair) = rested
    {
        wizard.mocap.add(pair);
    }
    let mut automatic = wizard.mocap.automatic;
    let response = ui.add_enabled(
        can.is_ok(),
        egui::Checkbox::new(&mut automatic, "Capture whenever the arm rests"),
    );
    if response.changed() {
        wizard.mocap.automatic = automatic;
    }
    match &can {
        Ok(()) => response
            .on_hover_text("Poses 12 mm or 4° and more from all others are kept by themselves"),
        Err(why) => response.on_disabled_hover_text(why),
    };
    if let Err(why) = &can {
        status(ui, Level::Warning, why);
    }
    let mut known = wizard.mocap.object_is_pad();
    let response = ui.checkbox(&mut known, "The object is the end pad's own frame");
    let hover = "It was defined so in Tracker: then only where its world is remains to be found";
    if response.on_hover_text(hover).changed() {
        wizard.mocap.set_object_is_pad(known);
    }
    ui.separator();
    note(
        ui,
        format!(
            "The arm has to visit poses; the button ({} of them), or any motion from Operate:",
            POSES
        ),
    );
    let label = ["▶ Visit the poses", "▶ Visit the poses (hold 0.8 s)"];
    let plan = Some(poses());
    if motion::button(ui, live, label, plan, &mut state.hold, commands) {
        wizard.mocap.automatic = true;
    }
    if let Some(r) = &live.snapshot.routine {
        note(
            ui,
            format!("◌ {}: {} of {} done", r.name, r.legs_done, r.legs),
        );
    }
    ui.separator();
    note(
        ui,
        "Without this step predictions cannot be scored against motion capture, unless a registration is in use \
         already. Springs and IMUs do not need it.",
    );
    if !wizard.mocap.pairs().is_empty() {
        let button = Button::new("Discard the poses and skip").min_size(wide);
        let hover = "Forget all poses; the registration in use, if any, is kept";
        if gated(ui, &Ok(()), button, hover).clicked() {
            wizard.mocap = Default::default();
        }
    }
}

fn result(ui: &mut Ui, live: &View<'_>, wizard: &Wizard) {
    let n = wizard.mocap.pairs().len();
    match wizard.mocap.fit() {
        None => {
            note(ui, "○ No poses yet: what is in use is kept.");
        }
        Some(Err(e)) if n < POSES_MIN => {
            note(ui, format!("◌ {n} of at least {POSES_MIN} poses")).on_hover_text(e.to_string());
        }
        Some(Err(e)) => {
            status(ui, Level::Warning, &format!("REDO: {e}."));
        }
        Some(Ok(fit)) => match wizard.mocap.outdated(&wizard.draft()) {
            Some(why) => {
                let text = format!(
                    "REDO: {why}. The poses were read with a former calibration: discard them and capture new ones."
                );
                status(ui, Level::Warning, &text);
            }
            None => passed(ui, live, fit, n),
        },
    }
}

fn passed(ui: &mut Ui, live: &View<'_>, fit: &FrameFit, n: usize) {
    let s = &fit.summary;
    ui.label(format!("● PASS: {} of {n} poses used", fit.used()));
    ui.label(format!(
        "Left out, a pose is predicted to {} mm and {}° RMS, {} mm and {}° at worst.",
        number(s.position_rms_m * 1e3, 2),
        number(s.rotation_rms_rad.to_degrees(), 2),
        number(s.position_worst_m * 1e3, 2),
        number(s.rotation_worst_rad.to_degrees(), 2),
    ));
    Grid::new("frames").num_columns(3).show(ui, |ui| {
        for (name, pose) in [
            ("Base from world", &fit.frames.base_from_world),
            ("Object from tip", &fit.frames.object_from_tip),
        ] {
            let t = pose.translation.vector * 1e3;
            let ypr = ypr_from_rotation(&pose.rotation).map(|a| number(a.to_degrees(), 2));
            note(ui, name);
            ui.label(format!(
                "x {}, y {}, z {} mm",
                number(t.x, 2),
                number(t.y, 2),
                number(t.z, 2)
            ));
            ui.label(format!(
                "yaw {}°, pitch {}°, roll {}°",
                ypr[0], ypr[1], ypr[2]
            ));
            ui.end_row();
        }
    });
    let source = live.snapshot.truth.as_ref().map(|t| t.source);
    if source == Some(TruthSource::VirtualRig) {
        note(
            ui,
            "Simulated: world and base are one frame here, so both should be near zero.",
        );
    }
}

/// From this width on the maps stand beside the table, points.
const BESIDE: f32 = 650.0;

/// From this width of their card on the maps are twice as large, points.
const LARGE: f32 = 900.0;

/// The poses as points: places from above, and tilts.
fn maps(ui: &mut Ui, pairs: &[PosePair]) {
    let p = *Palette::in_ui(ui);
    let scale = match ui.available_width() > LARGE {
        true => 2.0,
        false => 1.0,
    };
    let mut map =
        |name: &str, unit: &str, span: f64, points: Vec<[f64; 2]>, planned: &[[f64; 2]]| {
            ui.vertical(|ui| {
                note(ui, name);
                let size = scale * vec2(150.0, 118.0);
                let (rect, response) = ui.allocate_exact_size(size, Sense::hover());
                let painter = ui.painter().with_clip_rect(rect);
                painter.rect_filled(rect, 2.0, p.sunken);
                painter.rect_stroke(
                    rect,
                    2.0,
                    Stroke::new(1.0, p.line),
                    egui::StrokeKind::Inside,
                );
                painter.hline(rect.x_range(), rect.center().y, Stroke::new(1.0, p.line));
                painter.vline(rect.center().x, rect.y_range(), Stroke::new(1.0, p.line));
                let scale = 0.5 * f64::from(rect.height()) / span;
                let place = |[x, y]: &[f64; 2]| {
                    pos2(
                        rect.center().x + (x * scale) as f32,
                        rect.center().y - (y * scale) as f32,
                    )
                };
                for at in planned.iter().map(place) {
                    painter.circle_stroke(at, 4.0, Stroke::new(1.0, p.weak));
                }
                for at in points.iter().map(place) {
                    painter.rect_filled(Rect::from_center_size(at, vec2(5.0, 5.0)), 1.0, p.bar);
                }
                let text = format!(
                    "{name}: {} poses, {span:.0} {unit} from the middle to the edge",
                    points.len()
                );
                response.widget_info(|| WidgetInfo::labeled(Role::Label, true, &text));
                let rings = if planned.is_empty() {
                    ""
                } else {
                    "; rings: the poses that the button visits"
                };
                response.on_hover_text(format!("{text}. x of the base to the right, y up{rings}"));
            });
        };
    let place = |q: &PosePair| {
        let t = q.base_from_tip.translation.vector * 1e3;
        [t.x, t.y]
    };
    map(
        "Places from above",
        "mm",
        115.0,
        pairs.iter().map(place).collect(),
        &planned_mm(),
    );
    let lean = |q: &PosePair| tilt(&q.base_from_tip.rotation).map(f64::to_degrees);
    map(
        "Tilts",
        "degrees",
        30.0,
        pairs.iter().map(lean).collect(),
        &[],
    );
}

/// Places of the poses that the button visits, x and y of the base, mm.
fn planned_mm() -> Vec<[f64; 2]> {
    let legs = poses().legs.into_iter();
    legs.filter_map(|leg| match leg {
        Leg::Move(goal) => Some([goal.position_m[0] * 1e3, goal.position_m[1] * 1e3]),
        _ => None,
    })
    .collect()
}

fn pairs(ui: &mut Ui, wizard: &mut Wizard) {
    let p = *Palette::in_ui(ui);
    let widths = [44.0, 58.0, 58.0, 58.0, 84.0, 72.0];
    let head = |t: &str| RichText::new(t).small().color(p.weak);
    ui.spacing_mut().item_spacing.y = 2.0;
    ui.horizontal(|ui| {
        for (width, t) in widths.into_iter().zip([
            "pose",
            "x / mm",
            "y / mm",
            "z / mm",
            "left out / mm",
            "/ deg",
        ]) {
            cell(ui, width, head(t));
        }
    });
    let fit = wizard.mocap.fit().and_then(|f| f.as_ref().ok()).cloned();
    let mut removed = None;
    ScrollArea::vertical()
        .id_salt("pairs")
        .max_height(264.0)
        .auto_shrink(false)
        .show(ui, |ui| {
            for (i, pair) in wizard.mocap.pairs().iter().enumerate() {
                let held_out = fit.as_ref().and_then(|f| f.held_out.get(i));
                let suspect = fit.as_ref().is_some_and(|f| f.suspects.contains(&i));
                let t = pair.base_from_tip.translation.vector * 1e3;
                ui.horizontal(|ui| {
                    cell(ui, widths[0], (i + 1).to_string());
                    for (k, x) in [t.x, t.y, t.z].into_iter().enumerate() {
                        cell(ui, widths[k + 1], number(x, 1));
                    }
                    let off = held_out.map(|h| (h.distance_m() * 1e3, h.angle_rad().to_degrees()));
                    cell(ui, widths[4], off.map_or("—".into(), |o| number(o.0, 2)));
                    cell(ui, widths[5], off.map_or("—".into(), |o| number(o.1, 2)));
                    let remove = ui
                        .small_button("Remove")
                        .on_hover_text("Take this pose out; capture another in its place")
                        .accessible_name(format!("Remove pose {}", i + 1));
                    if remove.clicked() {
                        removed = Some(i);
                    }
                });
                if suspect {
                    status(ui, Level::Warning, "It stands out: not used")
                        .on_hover_text("It does not fit what the others predict: remove it");
                }
            }
        });
    if let Some(i) = removed {
        wizard.mocap.remove(i);
    }
}
