//! Nothing is cut off, covered or out of reach: the rectangles of all widgets in every state of every screen.
//!
//! Sizes are in points, as the window system counts them: a window of 1024 x 700 on a display of density 2
//! has 2048 x 1400 pixels. The layout is made in points, so the density changes only what is rounded to
//! pixels: the first state of every screen is looked at in every size with the densities 1, 1.5 and 2, every
//! other state in every size with one of them in turn; `./test layouts` has all states with all of them. Sizes in
//! pixels are covered beside that where no fewer than 1024 x 660 points are left. In lesser windows, down to the
//! smallest (900 x 560, `cli/window.rs`), screens are scrolled as a whole, and STOP is what must be whole
//! (`scale.rs`).

mod audit;
mod states;
mod still;

use super::*;
use audit::{Audit, faults};
use states::{State, screens};

/// Sizes of the window, points.
const SIZES: [[f32; 2]; 4] = [
    [1024.0, 700.0],
    [1280.0, 760.0],
    [1600.0, 1000.0],
    [2560.0, 1440.0],
];
/// Pixels per point.
const DENSITIES: [f32; 3] = [1.0, 1.5, 2.0];
/// 1600 x 1000 pixels at 1.5, and 2560 x 1440 pixels at 2 and 1.5: points and pixels per point.
const IN_PIXELS: [([f32; 2], f32); 3] = [
    ([1066.5, 666.5], 1.5),
    ([1280.0, 720.0], 2.0),
    ([1706.5, 960.0], 1.5),
];

/// The windows in which the state with this number is looked at.
fn windows(number: usize) -> Vec<([f32; 2], f32)> {
    let every = number == 0 || std::env::var_os("SPRINGTWIN_ALL_RUNS").is_some();
    let mut all: Vec<([f32; 2], f32)> = Vec::new();
    for (i, size) in SIZES.into_iter().enumerate() {
        match every {
            true => all.extend(DENSITIES.map(|d| (size, d))),
            false => all.push((size, DENSITIES[(number + i) % DENSITIES.len()])),
        }
    }
    if every {
        all.extend(IN_PIXELS);
    }
    all
}

/// All states of a screen in all windows.
fn assert_fits(states: Vec<State>) {
    let (mut found, mut looked) = (Vec::new(), 0);
    for (number, mut state) in states.into_iter().enumerate() {
        for (size, density) in windows(number) {
            let h = &mut state.h;
            // The size counts in the points that the density makes.
            h.set_pixels_per_point(density);
            h.run_steps(1);
            h.set_size(size.into());
            h.run_steps(4);
            looked += 1;
            for fault in faults(h, &state.audit) {
                let [width, height] = size;
                let fault = format!("{}, {width} x {height} x {density}: {fault}", state.name);
                println!("{fault}");
                found.push(fault);
            }
        }
    }
    println!("{looked} windows");
    assert!(
        found.is_empty(),
        "{} faults\n{}",
        found.len(),
        found.join("\n")
    );
}

#[test]
fn operate_fits_in_every_window() {
    assert_fits(states::operate());
}

#[test]
fn sensors_fit_in_every_window() {
    assert_fits(states::sensors());
}

#[test]
fn accuracy_fits_in_every_window() {
    assert_fits(states::accuracy());
}

#[test]
fn calibrate_fits_in_every_window() {
    assert_fits(states::calibrate());
}

#[test]
fn recordings_fit_in_every_window() {
    assert_fits(states::recordings());
}

#[test]
fn gap_fits_in_every_window() {
    assert_fits(states::gap());
}

#[test]
fn dialogs_and_menus_fit_in_every_window() {
    assert_fits(states::dialogs());
}

#[test]
fn what_concerns_every_screen_fits_in_every_window() {
    assert_fits(screens());
}

/// The audit notices what it is there for.
#[test]
fn what_is_cut_covered_or_out_of_reach_is_noticed() {
    let found = |contents: fn(&mut egui::Ui)| {
        let mut h = Harness::builder()
            .with_size([300.0, 200.0])
            .build_ui(contents);
        h.run_steps(3);
        faults(&mut h, &Audit::default())
    };
    let sound = found(|ui| {
        egui::ScrollArea::vertical().show(ui, |ui| {
            for i in 0..20 {
                let _ = ui.button(format!("button {i}"));
            }
        });
    });
    assert!(sound.is_empty(), "{sound:?}");
    let beyond = found(|ui| {
        ui.horizontal(|ui| {
            for i in 0..20 {
                let _ = ui.button(format!("button {i}"));
            }
        });
    });
    assert!(beyond.len() > 10, "{beyond:?}");
    let over = found(|ui| {
        let at = egui::Rect::from_min_size(ui.next_widget_position(), egui::vec2(80.0, 20.0));
        let _ = ui.put(at, egui::Button::new("one"));
        let _ = ui.put(at.translate(egui::vec2(9.0, 4.0)), egui::Button::new("two"));
    });
    assert_eq!(over.len(), 1, "{over:?}");
    let number = found(|ui| {
        ui.set_max_width(30.0);
        ui.add(egui::Label::new("1234567.25").truncate());
    });
    assert_eq!(number.len(), 1, "{number:?}");
    let painted = found(|ui| {
        let clip = egui::Rect::from_min_size(egui::pos2(10.0, 10.0), egui::vec2(40.0, 30.0));
        let font = egui::FontId::proportional(14.0);
        let painter = ui.painter_at(clip);
        painter.text(
            clip.min,
            egui::Align2::LEFT_TOP,
            "a long sentence",
            font,
            egui::Color32::WHITE,
        );
    });
    assert_eq!(painted.len(), 1, "{painted:?}");
    let frame = found(|ui| {
        let at = egui::Rect::from_min_size(egui::pos2(10.0, 10.0), egui::vec2(400.0, 50.0));
        let stroke = egui::Stroke::new(1.0, egui::Color32::WHITE);
        let inside = egui::StrokeKind::Inside;
        ui.painter().rect_stroke(at, 2.0, stroke, inside);
    });
    assert_eq!(frame.len(), 1, "{frame:?}");
}
