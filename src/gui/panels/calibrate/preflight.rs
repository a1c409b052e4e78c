//! Preflight: whether everything is there, and what the steps after it need.

use egui::{RichText, Ui};
use egui_plot::MarkerShape;

use super::curve::{line_mm, span_x};
use super::scatter::{Group, Scatter};
use super::{CalibrateState, glyph, save};
use crate::analysis::history::Channel;
use crate::calibrate::imus::{RESIDUAL_MAX_RAD, REST_S, SECTORS, SECTORS_NEEDED};
use crate::calibrate::motion::POSES;
use crate::calibrate::preflight::checks;
use crate::calibrate::{Mark, Step, TRIAL_S, Wizard};
use crate::gui::panels::widgets::{card, heading, imu_name, note, number, status};
use crate::gui::services::Services;
use crate::gui::theme::{Level, Palette};
use crate::gui::view::View;
use crate::sensing::Calibration;
use crate::sensing::bench::HELD_OUT_LIMIT_M;
use crate::sensing::registration::POSES_MIN;
use crate::signal::SPRINGS;
use crate::twin::TRIAL_SETTLING_S;

/// Above this width the curves in use stand in a column of their own, points.
const THREE: f32 = 1400.0;

/// The step.
pub fn ui(
    ui: &mut Ui,
    live: &View<'_>,
    wizard: &mut Wizard,
    state: &mut CalibrateState,
    services: &mut Services,
    height: f32,
) {
    let wide = ui.available_width() > THREE;
    ui.columns(if wide { 3 } else { 2 }, |columns| {
        let full = |ui: &mut Ui| ui.set_min_width(ui.available_width());
        card(&mut columns[0], |ui| {
            full(ui);
            rig(ui, live, wizard);
        });
        if wide {
            card(&mut columns[0], |ui| {
                full(ui);
                imus(ui, &wizard.in_use);
            });
        }
        card(&mut columns[0], |ui| {
            full(ui);
            save::versions(ui, live, wizard, state, services);
        });
        card(&mut columns[1], |ui| {
            full(ui);
            if wide {
                magnify(ui);
            }
            steps(ui, live, wizard, state);
        });
        if wide {
            let used = columns[1].cursor().top() - columns[1].max_rect().top();
            let left = height - used - 20.0;
            if left >= ERRORS {
                card(&mut columns[1], |ui| {
                    full(ui);
                    errors(ui, &wizard.in_use, left);
                });
            }
            card(&mut columns[2], |ui| {
                full(ui);
                curves(ui, &wizard.in_use, height - 20.0);
            });
        }
    });
}

/// Least height of the springs' errors below the steps, points.
const ERRORS: f32 = 130.0;

/// Larger type where there is space.
fn magnify(ui: &mut Ui) {
    for font in ui.style_mut().text_styles.values_mut() {
        font.size *= 1.25;
    }
    ui.spacing_mut().item_spacing.y *= 2.0;
}

/// The checks of the rig.
fn rig(ui: &mut Ui, live: &View<'_>, wizard: &mut Wizard) {
    ui.heading("Check the rig");
    ui.add_space(4.0);
    let checks = checks(live.snapshot);
    for c in &checks {
        match &c.verdict {
            Ok(()) => {
                note(ui, format!("● {}: {}", c.name, c.found));
            }
            Err(todo) => {
                status(ui, Level::Warning, &format!("{}: {}", c.name, c.found));
                ui.horizontal_wrapped(|ui| {
                    ui.add_space(18.0);
                    ui.label(todo);
                });
            }
        }
    }
    ui.add_space(8.0);
    let failed = checks.iter().filter(|c| c.verdict.is_err()).count();
    wizard.not_passed = Some(failed);
    let text = match failed {
        0 => format!("All checks passed ({}). Next: the springs.", live.origin()),
        n => format!(
            "{n} of {} checks did not pass. You may go on: a step whose needs are missing shows what it needs, and a \
             bench log can be read without any boards.",
            checks.len()
        ),
    };
    ui.label(text);
}

/// What a step does, what it needs, and how long it takes.
fn outline(step: Step, [low_mm, high_mm]: [f64; 2], minutes: u32) -> [String; 3] {
    let text = |words: [&str; 3]| words.map(str::to_owned);
    match step {
        Step::Preflight => text([
            "Checks link, boards, sensors, motion capture and mode",
            "the boards; a bench log does without them",
            "at once",
        ]),
        Step::Springs => [
            "Fits one curve per spring, from reading to length".to_owned(),
            format!(
                "a bench, its log, or gauge blocks: 10 lengths or more from {low_mm:.0} to {high_mm:.0} mm"
            ),
            "one run of the bench; by hand half a second per length".to_owned(),
        ],
        Step::Imus => [
            "Zeros the gyros, then fits mountings, accelerometers and the base's tilt".to_owned(),
            format!("all springs; an arm that may tilt to {SECTORS_NEEDED} of {SECTORS} sides"),
            format!("{REST_S:.0} s of rest, then about two minutes of motion"),
        ],
        Step::Mocap => [
            "Registers motion capture to the robot".to_owned(),
            format!("motion capture that sees the end pad; {POSES_MIN} poses at rest or more"),
            format!("{POSES} poses at 8 mm/s or less; may be skipped"),
        ],
        Step::Validate => [
            "Compares the former and the new calibration on held-out motion".to_owned(),
            "motion that no other step used".to_owned(),
            format!("{:.0} s", TRIAL_SETTLING_S + TRIAL_S),
        ],
        Step::Save => text([
            "Saves a version, with the way back to every former one",
            "a name",
            "at once",
        ]),
        Step::Learn => [
            "Trains networks of this arm and adjusts its calibration".to_owned(),
            "motion capture; the whole workspace free".to_owned(),
            format!("{minutes} min of motion, then the training; may be skipped"),
        ],
    }
}

/// The seven steps: what each does and needs, how long it takes, and its state.
fn steps(ui: &mut Ui, live: &View<'_>, wizard: &Wizard, state: &CalibrateState) {
    let p = *Palette::in_ui(ui);
    ui.heading("The seven steps");
    let range_mm = live.spec.spring.range_m.map(|m| m * 1e3);
    let gap = 2.0 * ui.spacing().item_spacing.y;
    for step in Step::ALL {
        let mark = wizard.mark(step);
        let (word, color) = match (step, mark) {
            (Step::Learn, _) if state.learning.is_busy() => ("◌ under way".into(), p.weak),
            (Step::Save | Step::Learn, _) | (Step::Validate, Mark::Kept) => {
                ("○ not yet".to_owned(), p.weak)
            }
            (_, Mark::Redo | Mark::NotPassed(_)) => {
                (format!("{} {}", glyph(mark), mark.word()), p.warning)
            }
            _ => (format!("{} {}", glyph(mark), mark.word()), p.weak),
        };
        let [does, needs, takes] = outline(step, range_mm, state.learning.minutes());
        ui.add_space(gap);
        ui.scope(|ui| {
            ui.spacing_mut().item_spacing.y = 1.0;
            ui.spacing_mut().interact_size.y = 18.0;
            ui.horizontal(|ui| {
                let title = format!("{} {}", step.index() + 1, step.name());
                ui.label(RichText::new(title).strong());
                ui.label(RichText::new(word).small().color(color));
            });
            ui.label(format!("{does}."));
            heading(ui, &format!("Needs {needs}. Takes {takes}."));
        });
    }
}

/// What is known of the IMUs: how they sit, and how well that fits.
fn imus(ui: &mut Ui, calibration: &Calibration) {
    ui.heading(format!("IMUs by “{}”", calibration.name));
    if calibration.imus.is_empty() {
        note(ui, "Nominal mountings: none was calibrated.");
        return;
    }
    for imu in &calibration.imus {
        let (fit, date) = (&imu.fit, imu.date.as_str());
        let mut text = format!(
            "IMU {}: {}° off nominal, {}° residual (limit {}°), {} samples",
            imu_name(imu.imu.saturating_sub(1)),
            number(fit.correction_rad.norm().to_degrees(), 2),
            number(fit.residual_rad.to_degrees(), 2),
            number(RESIDUAL_MAX_RAD.to_degrees(), 1),
            fit.samples
        );
        if !date.is_empty() {
            text += &format!(", zeroed {date}");
        }
        note(ui, text);
    }
    let [x, y] = calibration
        .base_tilt_rad
        .map(|rad| number(rad.to_degrees(), 2));
    note(ui, format!("Tilt of the base: {x}° about x, {y}° about y"));
}

/// The curves that the springs are read with, over their readings.
fn curves(ui: &mut Ui, calibration: &Calibration, height: f32) {
    let p = *Palette::in_ui(ui);
    let top = ui.cursor().top();
    ui.heading(format!("Springs by “{}”", calibration.name));
    let springs = &calibration.springs;
    if springs.is_empty() {
        note(ui, "It holds no curve of a spring.");
        return;
    }
    let text = format!(
        "{} curves in use. A step that captures nothing keeps them.",
        springs.len()
    );
    note(ui, text);
    let rest = height - (ui.cursor().top() - top) - ui.spacing().item_spacing.y;
    let groups: Vec<Group> = springs
        .iter()
        .map(|s| Group {
            name: "",
            points: line_mm(&s.curve),
            color: p.signal(Channel::Spring(s.spring.saturating_sub(1))),
            shape: None,
        })
        .collect();
    let all: Vec<[f64; 2]> = groups.iter().flat_map(|g| g.points.clone()).collect();
    let Some(x) = span_x(&all) else {
        return;
    };
    Scatter {
        title: "Length / mm over the reading of each spring",
        name: &format!("Curves in use of {} springs", springs.len()),
        units: ["", "mm"],
        x,
        x_labels: true,
        groups,
        min_span: 10.0,
        ..Scatter::default()
    }
    .show(ui, rest);
}

/// The held-out errors of the springs in use, with the limit as a band.
fn errors(ui: &mut Ui, calibration: &Calibration, height: f32) {
    let p = *Palette::in_ui(ui);
    let limit_mm = HELD_OUT_LIMIT_M * 1e3;
    let springs = &calibration.springs;
    let errors = springs.iter();
    let errors = errors.map(|s| [s.spring as f64, s.quality.held_out_rmse_m * 1e3]);
    Scatter {
        title: "Held-out RMSE / mm over the number of the spring",
        name: &format!("Held-out errors of {} springs", springs.len()),
        units: ["(spring)", "mm"],
        names: true,
        x: [0.5, SPRINGS as f64 + 0.5],
        x_labels: true,
        groups: vec![Group {
            name: "curve in use",
            points: errors.collect(),
            color: p.series[0],
            shape: Some(MarkerShape::Diamond),
        }],
        band: Some([0.0, limit_mm]),
        band_name: &format!("PASS: up to {} mm", number(limit_mm, 2)),
        min_span: 1.2 * limit_mm,
        ..Scatter::default()
    }
    .show(ui, height);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_step_states_what_it_does_needs_and_takes() {
        for step in Step::ALL {
            let words = outline(step, [70.0, 240.0], 10);
            assert!(words.iter().all(|w| w.len() > 3), "{step:?}: {words:?}");
        }
        let [_, _, takes] = outline(Step::Validate, [70.0, 240.0], 10);
        assert_eq!(takes, format!("{:.0} s", TRIAL_S + TRIAL_SETTLING_S));
        let [_, needs, _] = outline(Step::Springs, [70.0, 240.0], 10);
        assert!(needs.ends_with("from 70 to 240 mm"), "{needs}");
    }
}
