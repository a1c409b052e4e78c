//! Where motion capture lies on the robot, and how the clocks lie on each other.

use egui::{ScrollArea, Ui};

use super::AccuracyState;
use crate::analysis::history::pose_for_display;
use crate::gui::panels::widgets::number;
use crate::gui::view::View;
use crate::sensing::registration::Registration;
use crate::signal::{Pose, TruthSource};

/// What is known about frames and clocks, one sentence each.
pub fn sentences(view: &View<'_>, registration: Option<&Registration>) -> Vec<String> {
    let mut out =
        vec!["Compared is the origin of the end pad in the robot's base frame.".to_owned()];
    let simulated = view.snapshot.truth.as_ref().map(|t| t.source) == Some(TruthSource::VirtualRig);
    match (view.replay, registration) {
        (Some(_), _) => out.push(
            "The recording keeps Vicon's poses in the base frame on the session's clock; the transform and the \
             clock offset they were made with are not in it."
                .to_owned(),
        ),
        (None, Some(r)) => {
            out.push(placed("Base from Vicon's world", &r.base_from_world.pose));
            out.push(placed("Tracked object from end pad", &r.object_from_tip.pose));
            out.push(match r.clock {
                Some(c) => format!(
                    "Vicon's clock: session time is Vicon time {} ms ± {} ms.",
                    signed(c.offset_s * 1e3, 2),
                    number(c.sigma_s * 1e3, 2)
                ),
                None => "Vicon's clock: its offset was not measured.".to_owned(),
            });
            out.push(format!(
                "Registered {} with {} poses of {}.",
                r.date, r.poses, r.object
            ));
        }
        (None, None) if simulated => out.push(
            "The simulated Vicon measures in the base frame on the session's clock: no transform, no offset."
                .to_owned(),
        ),
        (None, None) => out.push(
            "No registration is loaded: the tracked object is taken for the end pad, its world for the base, its \
             arrival for its time. Make one on the Calibrate screen, then start with --registration."
                .to_owned(),
        ),
    }
    for (i, clock) in view.snapshot.link.board_clock.iter().enumerate() {
        out.push(match clock {
            Some(c) => format!(
                "Clock of segment {}: session time is board time {} s, {} ppm {}, pings agree within {} ms.",
                i + 1,
                signed(c.offset_s, 3),
                number(c.skew_ratio.abs() * 1e6, 0),
                if c.skew_ratio > 0.0 { "slow" } else { "fast" },
                number(c.residual_s * 1e3, 3)
            ),
            None => format!("Clock of segment {}: not known here.", i + 1),
        });
    }
    out
}

fn signed(value: f64, decimals: usize) -> String {
    let text = number(value.abs(), decimals);
    if value < 0.0 {
        format!("− {text}")
    } else {
        format!("+ {text}")
    }
}

fn placed(name: &str, pose: &Pose) -> String {
    let [x, y, z, yaw, pitch, roll] = pose_for_display(pose);
    format!(
        "{name}: x {} y {} z {} mm, yaw {} pitch {} roll {} deg.",
        number(x, 1),
        number(y, 1),
        number(z, 1),
        number(yaw, 2),
        number(pitch, 2),
        number(roll, 2)
    )
}

/// The sentences.
pub fn ui(ui: &mut Ui, view: &View<'_>, state: &AccuracyState) {
    ScrollArea::vertical()
        .id_salt("frames")
        .auto_shrink(false)
        .show(ui, |ui| {
            for text in sentences(view, state.registration.as_ref()) {
                ui.label(text);
            }
        });
}
