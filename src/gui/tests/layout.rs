//! Where widgets lie: nothing moves when a banner comes or goes, and what is cut, covered or out of reach is noticed.

mod audit;
mod still;

use super::*;
use audit::{Audit, faults};

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
}
