//! The springs: where points come from, and the table of the twelve.

use egui::{
    Button, ComboBox, ProgressBar, Rect, RichText, Role, Sense, TextEdit, Ui, WidgetInfo, pos2,
    vec2,
};

use super::{CalibrateState, Source, capture_gate, curve};
use crate::calibrate::springs::{CELLS, SpringTake, Verdict};
use crate::calibrate::{BenchRequest, Wizard};
use crate::gui::panels::files::Ask;
use crate::gui::panels::widgets::card;
use crate::gui::panels::widgets::{
    Gate, by_enter, cell, cell_left, gated, heading, note, number, status,
};
use crate::gui::services::{Dialog, DialogKind, Services};
use crate::gui::theme::{Level, Palette};
use crate::gui::view::View;
use crate::sensing::calibration::FitQuality;
use crate::signal::SPRINGS;
use crate::signal::spring_name;

/// Width of the card on the left, points.
const LEFT: f32 = 316.0;
/// Its width in a narrow window, points.
const LEFT_NARROW: f32 = 292.0;
/// Windows narrower than this are narrow, points.
const NARROW: f32 = 1140.0;

/// Width of the card on the left, points.
fn left_width(ui: &Ui) -> f32 {
    match ui.ctx().content_rect().width() < NARROW {
        true => LEFT_NARROW,
        false => LEFT,
    }
}

/// The card on the left of a step: what the operator does.
pub fn left_card(ui: &mut Ui, contents: impl FnOnce(&mut Ui)) {
    let width = left_width(ui);
    ui.allocate_ui(vec2(width, ui.available_height().max(0.0)), |ui| {
        card(ui, |ui| {
            ui.set_width(width - 20.0);
            contents(ui);
        });
    });
}

/// The step.
pub fn ui(
    ui: &mut Ui,
    live: &View<'_>,
    wizard: &mut Wizard,
    state: &mut CalibrateState,
    services: &mut Services,
    height: f32,
) {
    if state.source.is_none() {
        state.source = Some(match services.calibration.bench {
            Some(_) => Source::Bench,
            None => Source::Log,
        });
    }
    let beside = ui.available_width() > BESIDE;
    ui.horizontal_top(|ui| {
        ui.vertical(|ui| {
            let top = ui.cursor().top();
            left_card(ui, |ui| {
                source(ui, live, wizard, state, services);
            });
            if !beside {
                let left = height - (ui.cursor().top() - top);
                // As wide as the card above it, where that leaves space.
                let width = ui.min_rect().width();
                if left > curve::LEAST {
                    curve_card(ui, live, wizard, state, [width, left]);
                }
            }
        });
        if beside {
            ui.allocate_ui(vec2(TABLE + 20.0, height), |ui| {
                card(ui, |ui| {
                    ui.set_width(TABLE);
                    table(ui, live, wizard, state, services);
                });
            });
            let width = ui.available_width();
            curve_card(ui, live, wizard, state, [width, height]);
        } else {
            ui.vertical(|ui| {
                card(ui, |ui| {
                    ui.set_min_width(ui.available_width());
                    table(ui, live, wizard, state, services);
                });
            });
        }
    });
}

/// Above this width the curve stands beside the table, points.
const BESIDE: f32 = 1400.0;
/// Width of the table beside the curve, points.
const TABLE: f32 = 670.0;

/// The curve of the chosen spring in a card of this width and height.
fn curve_card(
    ui: &mut Ui,
    live: &View<'_>,
    wizard: &Wizard,
    state: &CalibrateState,
    [width, height]: [f32; 2],
) {
    ui.allocate_ui(vec2(width, height), |ui| {
        card(ui, |ui| {
            ui.set_width(width - 20.0);
            let inner = (height - 20.0).max(curve::LEAST);
            curve::ui(ui, live, wizard, state, inner);
        });
    });
}

fn source(
    ui: &mut Ui,
    live: &View<'_>,
    wizard: &mut Wizard,
    state: &mut CalibrateState,
    services: &mut Services,
) {
    ui.heading("Source of the points");
    ui.horizontal(|ui| {
        for (source, name, hover) in [
            (
                Source::Bench,
                "Practice bench",
                "The virtual rig's linear motor (simulated)",
            ),
            (
                Source::Log,
                "Bench log",
                "A CSV file that a linear motor's bench wrote",
            ),
            (
                Source::Hand,
                "By hand",
                "Gauge blocks and the live boards, one length at a time",
            ),
        ] {
            let gate: Gate = match source {
                Source::Bench if services.calibration.bench.is_none() => {
                    Err("Only the virtual rig has a bench in this program.".into())
                }
                _ => Ok(()),
            };
            let chosen = state.source == Some(source);
            let button = Button::selectable(chosen, name).frame_when_inactive(true);
            if gated(ui, &gate, button, hover).clicked() {
                state.source = Some(source);
            }
        }
    });
    ui.separator();
    let [low, high] = live.spec.spring.range_m.map(|m| m * 1e3);
    match state.source {
        Some(Source::Bench) => bench(ui, state, services, [low, high]),
        Some(Source::Log) | None => log(ui, state, services, [low, high]),
        Some(Source::Hand) => hand(ui, live, wizard, state, [low, high]),
    }
    if let Some((trouble, text)) = &wizard.springs.notice {
        ui.add_space(4.0);
        match trouble {
            true => {
                status(ui, Level::Warning, text);
            }
            false => {
                note(ui, format!("● {text}"));
            }
        }
    }
}

/// A job under way: what it does, how far it is, and a button that ends it. Whether that was pressed.
pub fn progress(ui: &mut Ui, what: &str, share: Option<f32>) -> bool {
    match share {
        Some(share) => {
            ui.add(ProgressBar::new(share).show_percentage());
        }
        None => {
            ui.spinner();
        }
    }
    let mut cancelled = false;
    ui.horizontal(|ui| {
        note(ui, what);
        cancelled = ui
            .button("Stop")
            .on_hover_text("Its result is discarded")
            .clicked();
    });
    cancelled
}

fn running(ui: &mut Ui, state: &mut CalibrateState) -> bool {
    let Some(stage) = state.bench.stage() else {
        return false;
    };
    let what = match stage.what.is_empty() {
        true => "Beginning",
        false => &stage.what,
    };
    if progress(ui, what, stage.share) {
        state.bench.cancel();
    }
    true
}

/// Starts a run of the virtual rig's bench.
fn run_bench(state: &mut CalibrateState, services: &mut Services, request: BenchRequest) {
    if let Some(bench) = &mut services.calibration.bench {
        let springs = request.springs.clone();
        state.bench.begin_for(springs, bench(request));
    }
}

fn bench(ui: &mut Ui, state: &mut CalibrateState, services: &mut Services, [low, high]: [f64; 2]) {
    ui.label(format!(
        "A linear motor draws every spring from {low:.0} to {high:.0} mm and back, and reads its circuit at each \
         stop. Simulated."
    ));
    ui.horizontal(|ui| {
        let label = note(ui, "Simulated fault");
        let name = |loose: Option<usize>| match loose {
            Some(i) => format!("loose plug at spring {}", i + 1),
            None => "none".to_owned(),
        };
        ComboBox::from_id_salt("loose plug")
            .selected_text(name(state.practice.loose))
            .width(150.0)
            .show_ui(ui, |ui| {
                for choice in std::iter::once(None).chain((0..SPRINGS).map(Some)) {
                    ui.selectable_value(&mut state.practice.loose, choice, name(choice));
                }
            })
            .response
            .labelled_by(label.id)
            .on_hover_text("For practice: this plug sits loose until its spring is redone, which presses it home");
    });
    ui.add_space(4.0);
    if running(ui, state) {
        return;
    }
    let button =
        Button::new("▶ Draw all twelve springs").min_size(vec2(ui.available_width(), 30.0));
    let hover = "Capture all springs on the practice bench; what they had is replaced";
    if gated(ui, &Ok(()), button, hover).clicked() {
        let request = state.practice.draw_all();
        run_bench(state, services, request);
    }
}

fn log(ui: &mut Ui, state: &mut CalibrateState, services: &mut Services, [low, high]: [f64; 2]) {
    ui.label(format!(
        "CSV with a header row: spring (1 to 12), length_mm, one of frequency_hz, frequency_khz, frequency_mhz; \
         direction (up, down) if known. Log every spring on its own channel; inductance_uh needs the measured \
         capacitance_pf and compensation_uh of that channel. {low:.0} to {high:.0} mm, at least 10 lengths."
    ));
    let ask = Ask {
        name: "Path of the bench log",
        hint: "bench.csv",
        hover: "Path of the bench log; Enter reads it",
        browse: "Browse…",
        right: 0.0,
    };
    let dialog = || Dialog {
        title: "Bench log".into(),
        kind: DialogKind::Open,
        filter: Some(("CSV".into(), vec!["csv".into(), "txt".into()])),
        name: String::new(),
    };
    let mut entered = None;
    ui.horizontal(|ui| entered = state.log.ui(ui, &ask, dialog, services));
    state.log.trouble(ui);
    ui.horizontal(|ui| {
        let gate = match state.bench.is_busy() {
            true => Err("A log is being read.".into()),
            false => state.log.path(),
        };
        let can = gate.clone().map(|_| ());
        let hover = "Read the log; springs that it holds are replaced";
        let pressed = gated(ui, &can, Button::new("Read the log"), hover).clicked();
        if let Ok(path) = gate
            && (pressed || entered.is_some())
        {
            let job = (services.calibration.read_bench)(&path);
            state.bench.begin_for((0..SPRINGS).collect(), job);
        }
    });
    running(ui, state);
}

fn length_m(text: &str) -> Result<f64, String> {
    let number = text.trim().replace(',', ".");
    match number.parse::<f64>() {
        Ok(mm) if (1.0..=1000.0).contains(&mm) => Ok(mm * 1e-3),
        Ok(mm) => Err(format!("{mm} mm is no length of a spring.")),
        Err(_) if number.is_empty() => Err("Type the length in mm first.".into()),
        Err(_) => Err(format!("The length is not a number: “{}”.", text.trim())),
    }
}

fn hand(
    ui: &mut Ui,
    live: &View<'_>,
    wizard: &mut Wizard,
    state: &mut CalibrateState,
    [low, high]: [f64; 2],
) {
    ui.label(format!(
        "Set one spring to a gauge block, type its length, capture; {low:.0} to {high:.0} mm up and down, 10 lengths \
         or more. The mean of half a second is kept."
    ));
    ui.horizontal(|ui| {
        let label = note(ui, "Spring");
        let name = |i: usize| format!("{} ({})", i + 1, spring_name(i));
        ComboBox::from_id_salt("spring by hand")
            .selected_text(name(state.hand_spring))
            .show_ui(ui, |ui| {
                for i in 0..SPRINGS {
                    ui.selectable_value(&mut state.hand_spring, i, name(i));
                }
            })
            .response
            .labelled_by(label.id)
            .on_hover_text("The spring that was set to the gauge block");
    });
    let mut entered = false;
    ui.horizontal(|ui| {
        let label = note(ui, "Length / mm");
        let response = ui
            .add(TextEdit::singleline(&mut state.hand_mm).desired_width(90.0))
            .labelled_by(label.id)
            .on_hover_text("True length between the spring's ends, mm");
        entered = by_enter(&response);
    });
    if let Some(reading) = &wizard.springs.hand {
        let share = reading.share(live.snapshot.stamp);
        let what = format!("Reading spring {}", reading.spring + 1);
        if progress(ui, &what, Some(share)) {
            wizard.springs.hand = None;
        }
        return;
    }
    let length = length_m(&state.hand_mm);
    let gate = capture_gate(live).and(length.clone().map(|_| ()));
    let button = Button::new("Capture this length").min_size(vec2(ui.available_width(), 30.0));
    let pressed = gated(ui, &gate, button, "Read the spring for half a second").clicked();
    if (pressed || entered)
        && gate.is_ok()
        && let Ok(length_m) = length
    {
        state.curve_of = Some(state.hand_spring);
        wizard.springs.begin_hand(state.hand_spring, length_m);
    }
}

/// Widths of the columns but for the coverage, which takes what is left up to [`COVERAGE`], points.
const COLUMNS: [f32; 6] = [68.0, 44.0, 0.0, 84.0, 84.0, 74.0];
/// Most and least width of the coverage, points.
const COVERAGE: [f32; 2] = [208.0, 60.0];
/// Width of the button at the end of a row, points.
const REDO: f32 = 58.0;

/// Widths of the columns in the space there is.
fn columns(ui: &Ui) -> [f32; 6] {
    let gaps = 6.0 * ui.spacing().item_spacing.x;
    let rest = ui.available_width() - COLUMNS.iter().sum::<f32>() - REDO - gaps;
    let mut columns = COLUMNS;
    columns[2] = rest.clamp(COVERAGE[1], COVERAGE[0]);
    columns
}

fn table(
    ui: &mut Ui,
    live: &View<'_>,
    wizard: &mut Wizard,
    state: &mut CalibrateState,
    services: &mut Services,
) {
    let p = *Palette::in_ui(ui);
    ui.spacing_mut().item_spacing.y = 2.0;
    let range_m = live.spec.spring.range_m;
    let [low, high] = range_m.map(|m| m * 1e3);
    let head = |t: &str| RichText::new(t).small().color(p.weak);
    let columns = columns(ui);
    ui.horizontal(|ui| {
        cell_left(ui, columns[0], head("spring"));
        cell(ui, columns[1], head("points"));
        let text = format!("{low:.0}  lengths up, down / mm  {high:.0}");
        cell_left(ui, columns[2], head(&text));
        cell(ui, columns[3], head("held out / mm")).on_hover_text(
            "Root mean square error on points the curve has not seen, mm; at most 0.40",
        );
        cell(ui, columns[4], head("hysteresis / mm"))
            .on_hover_text("Largest difference between the way up and the way down, mm");
        cell_left(ui, columns[5], head("verdict"));
    });
    let shown = curve::shown(wizard, state);
    for i in 0..SPRINGS {
        row(ui, live, wizard, state, services, (columns, shown), i);
    }
    ui.add_space(6.0);
    for i in 0..SPRINGS {
        match wizard.spring(i) {
            Verdict::Redo { why, .. } => {
                status(ui, Level::Warning, &format!("Spring {}: {why}.", i + 1));
            }
            Verdict::Uncovered => {
                let text = format!("Spring {}: no curve in use and none captured.", i + 1);
                status(ui, Level::Warning, &text);
            }
            Verdict::Open(what) => {
                note(ui, format!("◌ Spring {}: {what}.", i + 1));
            }
            Verdict::Kept | Verdict::Pass(_) => {}
        }
    }
    if wizard.springs.springs.iter().all(|t| t.points().is_empty()) {
        let name = &wizard.before.name;
        heading(
            ui,
            &format!("Nothing captured: Next keeps the curves of “{name}”."),
        );
    }
}

fn row(
    ui: &mut Ui,
    live: &View<'_>,
    wizard: &mut Wizard,
    state: &mut CalibrateState,
    services: &mut Services,
    (columns, shown): ([f32; 6], usize),
    i: usize,
) {
    let p = *Palette::in_ui(ui);
    let verdict = wizard.spring(i);
    let (glyph, word, level, quality): (_, _, _, Option<FitQuality>) = match &verdict {
        Verdict::Kept => ("○", "kept", Level::Normal, None),
        Verdict::Uncovered => ("▲", "no curve", Level::Warning, None),
        Verdict::Open(_) => ("◌", "open", Level::Normal, None),
        Verdict::Pass(q) => ("●", "PASS", Level::Normal, Some(*q)),
        Verdict::Redo { quality, .. } => ("▲", "REDO", Level::Warning, *quality),
    };
    ui.horizontal(|ui| {
        ui.set_min_height(26.0);
        let name = format!("{} ({})", i + 1, spring_name(i));
        let button = Button::selectable(shown == i, name).min_size(vec2(columns[0], 24.0));
        let button = ui
            .add(button)
            .accessible_name(format!("Show the curve of spring {}", i + 1))
            .on_hover_text("Show this spring's curve and its residuals");
        if button.clicked() {
            state.curve_of = Some(i);
        }
        let take = &wizard.springs.springs[i];
        let points = take.points().len();
        cell(
            ui,
            columns[1],
            RichText::new(points.to_string()).color(p.weak),
        );
        coverage(ui, columns[2], take, live.spec.spring.range_m, i);
        let mm = |m: Option<f64>| m.map_or("—".to_owned(), |m| number(m * 1e3, 2));
        cell(ui, columns[3], mm(quality.map(|q| q.held_out_rmse_m)));
        cell(ui, columns[4], mm(quality.and_then(|q| q.hysteresis_m)));
        let color = match level {
            Level::Normal => p.text,
            level => p.level(level),
        };
        cell_left(
            ui,
            columns[5],
            RichText::new(format!("{glyph} {word}")).color(color),
        )
        .on_hover_text(match &verdict {
            Verdict::Redo { why, .. } => why.clone(),
            Verdict::Open(what) => what.clone(),
            Verdict::Kept => "The curve in use is kept".into(),
            Verdict::Uncovered => "There is no curve in use: capture it".into(),
            Verdict::Pass(q) => format!("{} points, {:.3} mm at worst", q.points, q.worst_m * 1e3),
        });
        redo(ui, wizard, state, services, i);
    });
}

fn redo(
    ui: &mut Ui,
    wizard: &mut Wizard,
    state: &mut CalibrateState,
    services: &mut Services,
    i: usize,
) {
    let gate = match wizard.springs.springs[i].points().is_empty() {
        _ if state.bench.is_busy() => Err("Springs are being captured: wait for them.".to_owned()),
        true => Err("Nothing has been captured of this spring.".into()),
        false => Ok(()),
    };
    let hover = match state.source {
        Some(Source::Bench) => {
            "Discard this spring's points, press its plug home and draw it again"
        }
        _ => "Discard this spring's points; the others are kept. Then capture it again",
    };
    let response = gated(ui, &gate, Button::new("Redo"), hover)
        .accessible_name(format!("Redo spring {}", i + 1));
    if !response.clicked() {
        return;
    }
    state.curve_of = Some(i);
    match state.source {
        Some(Source::Bench) => {
            let request = state.practice.redraw(vec![i]);
            run_bench(state, services, request);
        }
        _ => {
            wizard.springs.discard(i);
            state.hand_spring = i;
        }
    }
}

/// The range in cells: upper half on the way up, lower half on the way down; empty cells are holes.
fn coverage(ui: &mut Ui, width: f32, take: &SpringTake, range_m: [f64; 2], i: usize) {
    let p = *Palette::in_ui(ui);
    let seen = take.coverage(range_m);
    let (rect, response) = ui.allocate_exact_size(vec2(width, 18.0), Sense::hover());
    let width = rect.width() / CELLS as f32;
    for (way, cells) in seen.iter().enumerate() {
        for (k, full) in cells.iter().enumerate() {
            let at = pos2(
                rect.left() + width * k as f32,
                rect.top() + 2.0 + 7.5 * way as f32,
            );
            let cell = Rect::from_min_size(at, vec2(width - 1.0, 6.5));
            let fill = if *full { p.bar } else { p.raised };
            ui.painter().rect_filled(cell, 1.0, fill);
        }
    }
    let full = |way: usize| seen[way].iter().filter(|c| **c).count();
    let text = format!(
        "Spring {}: {} of {CELLS} parts of the range visited on the way up, {} on the way down",
        i + 1,
        full(0),
        full(1)
    );
    response.widget_info(|| WidgetInfo::labeled(Role::Label, true, &text));
    response.on_hover_text(text);
}
