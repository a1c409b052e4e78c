//! What a plan is made of: its kind, its numbers, its waypoints.

use std::ops::RangeInclusive;

use egui::{Button, DragValue, Ui, vec2};

use super::{PATH_WAYPOINTS, POINTS_MAX, Passing, PlanKind, PlanState, Track};
use crate::gui::panels::widgets::{Gate, cell_left, gated, heading, note, number, status};
use crate::gui::theme::Level;
use crate::gui::view::View;

/// Where a point of a plan may be typed, mm.
const PLACE_MM: [RangeInclusive<f64>; 3] = [-400.0..=400.0, -400.0..=400.0, -600.0..=0.0];
/// Radius of a circle, half the length of an 8, mm.
const SIZE_MM: RangeInclusive<f64> = 1.0..=200.0;
/// Most laps.
const LAPS: RangeInclusive<f64> = 1.0..=100.0;
/// How much higher the tip travels than it grasps, mm.
const LIFT_MM: RangeInclusive<f64> = 0.0..=100.0;

/// Kind, numbers, waypoints.
pub fn ui(ui: &mut Ui, view: &View<'_>, state: &mut PlanState, target_m: Option<[f64; 3]>) {
    ui.horizontal_wrapped(|ui| {
        ui.spacing_mut().item_spacing.x = 3.0;
        ui.spacing_mut().button_padding.x = 5.0;
        for (kind, name, hover) in PlanKind::ALL {
            let button = Button::selectable(state.kind == kind, name).frame_when_inactive(true);
            if ui.add(button).on_hover_text(hover).clicked() {
                state.kind = kind;
                state.drawing &= kind == PlanKind::Points;
            }
        }
    });
    ui.add_space(2.0);
    match state.kind {
        PlanKind::Circle | PlanKind::Eight => {
            place(ui, "Centre", "centre", &mut state.centre_mm, target_m);
            ui.horizontal_wrapped(|ui| {
                let (title, name, hover) = match state.kind {
                    PlanKind::Circle => ("Radius", "Radius in mm", "Radius of the circle, mm"),
                    _ => (
                        "Half length",
                        "Half length in mm",
                        "Half the length of the 8 along x, mm; it is half as wide as long",
                    ),
                };
                field(ui, title, name, hover, &mut state.size_mm, SIZE_MM, " mm");
            });
            pace(ui, view, state);
        }
        PlanKind::PickPlace => {
            place(ui, "Pick at", "pick", &mut state.pick_mm, target_m);
            place(ui, "Place at", "place", &mut state.place_mm, target_m);
            ui.horizontal_wrapped(|ui| {
                let most_g = view.spec.payload_max_kg * 1e3;
                field(
                    ui,
                    "Payload",
                    "Payload lifted in g",
                    "Mass of what is lifted, g: the stops are checked with it",
                    &mut state.payload_g,
                    0.0..=most_g,
                    " g",
                );
                field(
                    ui,
                    "Lift",
                    "Lift in mm",
                    "How much higher than pick and place the tip travels, mm",
                    &mut state.lift_mm,
                    LIFT_MM,
                    " mm",
                );
            });
        }
        PlanKind::Points => points(ui, view, state, target_m),
    }
    summary(ui, view, state);
    // At the end, without a scroll area of its own: the form is scrolled.
    if state.kind == PlanKind::Points {
        list(ui, state);
    }
}

/// Shown with a true minus sign and at most one decimal; typed with either sign, point or comma.
fn typed(drag: DragValue<'_>) -> DragValue<'_> {
    drag.custom_formatter(|v, _| {
        let text = number(v, 1);
        text.strip_suffix(".0").map_or(text.clone(), str::to_owned)
    })
    .custom_parser(|text| text.trim().replace('−', "-").replace(',', ".").parse().ok())
}

/// A number with its name.
fn field(
    ui: &mut Ui,
    title: &str,
    name: &str,
    hover: &str,
    value: &mut f64,
    range: RangeInclusive<f64>,
    suffix: &str,
) {
    note(ui, title);
    let drag = typed(DragValue::new(value))
        .range(range.clone())
        .speed(0.5)
        .suffix(suffix);
    let limits = format!(
        "{hover} ({} to {})",
        number(*range.start(), 0),
        number(*range.end(), 1)
    );
    ui.add(drag).accessible_name(name).on_hover_text(limits);
}

/// The most that may be typed as a speed, mm/s: what is too fast is refused, not cut.
const TYPED_SPEED_MM_S: f64 = 1000.0;

/// A point in mm, with a button that takes the target.
fn place(ui: &mut Ui, title: &str, name: &str, at_mm: &mut [f64; 3], target_m: Option<[f64; 3]>) {
    heading(ui, &format!("{title}: x, y, z / mm"));
    ui.horizontal_wrapped(|ui| {
        ui.spacing_mut().item_spacing.x = 4.0;
        // The button takes a line of its own where the fields would become too narrow for their numbers.
        let beside = (ui.available_width() - 92.0) / 3.0 - 4.0;
        let width = match beside >= 46.0 {
            true => beside,
            false => ui.available_width() / 3.0 - 4.0,
        };
        for (i, axis) in ["x", "y", "z"].into_iter().enumerate() {
            let drag = typed(DragValue::new(&mut at_mm[i]))
                .range(PLACE_MM[i].clone())
                .speed(0.5);
            ui.add_sized(vec2(width, ui.spacing().interact_size.y), drag)
                .accessible_name(format!("{title} {axis} in mm"))
                .on_hover_text(format!("{axis} in the base frame, mm; z up"));
        }
        let gate = target_m
            .map(|_| ())
            .ok_or_else(|| "There is no target: click in the 3D view first.".into());
        let button = Button::new("Use target");
        let response = gated(ui, &gate, button, "Take the target's coordinates")
            .accessible_name(format!("Use target as {name}"));
        if let (true, Some(m)) = (response.clicked(), target_m) {
            *at_mm = m.map(|v| (v * 1e4).round() * 0.1);
        }
    });
}

/// Speed and laps.
fn pace(ui: &mut Ui, view: &View<'_>, state: &mut PlanState) {
    ui.horizontal_wrapped(|ui| {
        let most = number(view.spec.tip_speed_max_m_s * 1e3, 1);
        let hover =
            format!("Along the path, at most {most} mm/s; a tip that falls behind is waited for");
        note(ui, "Speed");
        let drag = typed(DragValue::new(&mut state.speed_mm_s))
            .range(0.1..=TYPED_SPEED_MM_S)
            .speed(0.1)
            .suffix(" mm/s");
        ui.add(drag)
            .accessible_name("Speed in mm/s")
            .on_hover_text(hover);
        let mut laps = f64::from(state.laps);
        let hover = "How many times round";
        field(ui, "Laps", "Number of laps", hover, &mut laps, LAPS, "");
        state.laps = laps.round() as u32;
    });
    if let Err(reason) = state.speed(view.spec) {
        status(ui, Level::Warning, &reason);
    }
}

fn points(ui: &mut Ui, view: &View<'_>, state: &mut PlanState, target_m: Option<[f64; 3]>) {
    let live = view.live();
    let room: Gate = if state.points_m.len() < POINTS_MAX {
        Ok(())
    } else {
        Err(format!("{POINTS_MAX} waypoints are the most."))
    };
    ui.horizontal_wrapped(|ui| {
        ui.spacing_mut().item_spacing.x = 4.0;
        let gate = live.clone().and(room.clone());
        let button = Button::selectable(state.drawing, "Draw").frame_when_inactive(true);
        let hover = "While on, a click in the 3D view adds a waypoint and a drag draws a row of them. \
                     The middle mouse button still turns the view (Esc ends it).";
        if gated(ui, &gate, button, hover).clicked() {
            state.drawing = !state.drawing;
        }
        let gate = room.and(match target_m {
            Some(_) => Ok(()),
            None => Err("There is no target: click in the 3D view first.".into()),
        });
        let hover = "Add the target as the last waypoint";
        if let (true, Some(m)) = (
            gated(ui, &gate, Button::new("Add target"), hover).clicked(),
            target_m,
        ) {
            state.add(m);
        }
        let some: Gate = if state.points_m.is_empty() {
            Err("There are no waypoints.".into())
        } else {
            Ok(())
        };
        if gated(ui, &some, Button::new("Clear"), "Delete every waypoint").clicked() {
            state.points_m.clear();
            state.selected = None;
        }
    });
    ui.horizontal_wrapped(|ui| {
        ui.spacing_mut().item_spacing.x = 4.0;
        let step = |earlier: bool| match (state.selected, state.neighbour(earlier)) {
            (None, _) => Err("Select a waypoint first.".to_owned()),
            (_, None) if earlier => Err("It is the first waypoint.".into()),
            (_, None) => Err("It is the last waypoint.".into()),
            _ => Ok(()),
        };
        let (up, down) = (step(true), step(false));
        let chosen = state.selected.map(|_| ());
        let chosen = chosen.ok_or_else(|| "Select a waypoint first.".to_owned());
        if gated(
            ui,
            &up,
            Button::new("Move up"),
            "Pass the waypoint one place earlier",
        )
        .clicked()
        {
            state.reorder(true);
        }
        if gated(
            ui,
            &down,
            Button::new("Move down"),
            "Pass the waypoint one place later",
        )
        .clicked()
        {
            state.reorder(false);
        }
        if gated(
            ui,
            &chosen,
            Button::new("Delete"),
            "Delete the selected waypoint",
        )
        .clicked()
        {
            state.delete_selected();
        }
    });
    ui.horizontal_wrapped(|ui| {
        ui.spacing_mut().item_spacing.x = 4.0;
        for (passing, name, hover) in [
            (
                Passing::Stop,
                "Stop at each",
                "The tip settles at every waypoint",
            ),
            (
                Passing::Follow,
                "Closed line",
                "The tip follows the line through them and back to the first at an even speed",
            ),
        ] {
            let button =
                Button::selectable(state.passing == passing, name).frame_when_inactive(true);
            if ui.add(button).on_hover_text(hover).clicked() {
                state.passing = passing;
            }
        }
    });
    if state.passing == Passing::Follow {
        pace(ui, view, state);
    }
}

fn list(ui: &mut Ui, state: &mut PlanState) {
    if state.points_m.is_empty() {
        note(
            ui,
            "No waypoints. Switch Draw on and click in the 3D view, or add the target.",
        );
        return;
    }
    let digits = state.points_m.len().to_string().len();
    let row_height = 20.0;
    ui.spacing_mut().item_spacing.y = 1.0;
    ui.spacing_mut().interact_size.y = row_height;
    ui.spacing_mut().button_padding.y = 1.0;
    for (i, m) in state.points_m.iter().enumerate() {
        let [x, y, z] = m.map(|v| number(v * 1e3, 1));
        let text = format!("{:>digits$}   {x}, {y}, {z} mm", i + 1);
        let button = Button::selectable(state.selected == Some(i), text)
            .min_size(vec2(ui.available_width(), row_height));
        let response = ui
            .add(button)
            .accessible_name(format!("Waypoint {} at {x}, {y}, {z} mm", i + 1))
            .on_hover_text("Select it: its handles appear in the 3D view while Draw is on");
        if response.clicked() {
            state.selected = (state.selected != Some(i)).then_some(i);
        }
    }
}

/// Length and least time.
fn summary(ui: &mut Ui, view: &View<'_>, state: &PlanState) {
    let Ok(plan) = state.plan(view.spec) else {
        return;
    };
    let track = Track::of(&plan);
    let follows = plan.legs.len() == 2 && track.closed;
    let (speed_m_s, laps) = match follows {
        true => (state.speed_mm_s * 1e-3, f64::from(state.laps)),
        false => (view.spec.tip_speed_max_m_s, 1.0),
    };
    let length_m = track.length_m() * laps;
    let stops = track.waypoints_m.len();
    let what = match state.kind {
        PlanKind::Circle | PlanKind::Eight => format!("{PATH_WAYPOINTS} waypoints"),
        PlanKind::PickPlace => format!("{} legs", plan.legs.len()),
        PlanKind::Points if stops == 1 => "1 waypoint".into(),
        PlanKind::Points => format!("{stops} waypoints"),
    };
    let text = format!(
        "{what}, {} mm, at least {} s",
        number(length_m * 1e3, 0),
        number(length_m / speed_m_s, 0)
    );
    cell_left(ui, ui.available_width(), text).on_hover_text(
        "Length of the plan without the way to its start, and how long it takes at the speed asked for",
    );
}
