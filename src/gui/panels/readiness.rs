//! What the arm needs before it may move, and what is better there: a list that gates Go on hardware.

use egui::{Button, Popup, PopupCloseBehavior, RichText, Ui};

use super::widgets::{Gate, age, note};
use crate::gui::theme::Palette;
use crate::gui::view::View;
use crate::signal::{CHAMBERS, IMUS, RollingStatus, SPRINGS, Severity};

/// How far one thing is ready.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ready {
    /// As it should be.
    Yes,
    /// The arm may move without it.
    Without,
    /// The arm may not move without it.
    No,
}

impl Ready {
    fn glyph(self) -> &'static str {
        match self {
            Self::Yes => "●",
            Self::Without => "▲",
            Self::No => "⊗",
        }
    }

    fn color(self, p: &Palette) -> egui::Color32 {
        match self {
            Self::Yes => p.ready,
            Self::Without => p.warning,
            Self::No => p.critical,
        }
    }
}

/// One line of the list.
#[derive(Clone, Debug, PartialEq)]
pub struct Check {
    /// What is checked.
    pub name: &'static str,
    /// The result.
    pub ready: Ready,
    /// What was found; what to do where that is not as it should be.
    pub found: String,
}

/// All checks of the live twin, in the order in which they are remedied.
pub fn checks(view: &View<'_>) -> Vec<Check> {
    let s = view.snapshot;
    let link = match s.link.connected && s.link.age_s < 0.25 {
        true => (Ready::Yes, format!("frames {} old", age(s.link.age_s))),
        false => (Ready::No, "no fresh frames: check cable and power".into()),
    };
    let calibration = match &s.calibration_refusal {
        None => (Ready::Yes, "in use".into()),
        Some(why) => (Ready::No, why.clone()),
    };
    let critical = s.alarms.iter().find(|a| a.severity == Severity::Critical);
    let alarms = match critical {
        None => (Ready::Yes, "none is critical".into()),
        Some(alarm) => (Ready::No, alarm.text()),
    };
    let all = [
        ("Link", link),
        ("Sensors", sensors(view)),
        ("Calibration", calibration),
        ("Alarms", alarms),
        ("Motion capture", mocap(view)),
        ("Agreement", agreement(view)),
        ("Storage", storage(view)),
    ];
    all.into_iter()
        .map(|(name, (ready, found))| Check { name, ready, found })
        .collect()
}

fn sensors(view: &View<'_>) -> (Ready, String) {
    let Some(frame) = &view.snapshot.sensors else {
        return (Ready::No, "no reading yet".into());
    };
    let health = &frame.health;
    let gauges = health.chambers.iter().filter(|h| h.usable()).count();
    let (springs, imus) = (health.springs_usable(), health.imus_usable());
    let found =
        format!("{springs}/{SPRINGS} springs, {imus}/{IMUS} IMUs, {gauges}/{CHAMBERS} gauges");
    if gauges < CHAMBERS {
        return (
            Ready::No,
            format!("{found}: a pressure gauge is not usable"),
        );
    }
    if view.snapshot.estimate.is_none() {
        return (Ready::No, format!("{found}: no tip pose yet"));
    }
    match springs == SPRINGS && imus == IMUS {
        true => (Ready::Yes, found),
        false => (Ready::Without, format!("{found}: see Sensors")),
    }
}

fn mocap(view: &View<'_>) -> (Ready, String) {
    match (view.truth_is_fresh(), &view.snapshot.link.mocap_trouble) {
        (true, _) => (
            Ready::Yes,
            format!("{} sees the end pad", view.truth_name()),
        ),
        (false, Some(why)) => (Ready::Without, why.clone()),
        (false, None) => (
            Ready::Without,
            "none: predictions are not scored; control never uses it".into(),
        ),
    }
}

fn agreement(view: &View<'_>) -> (Ready, String) {
    match &view.snapshot.disagreement {
        None if view.snapshot.is_monitored => (
            Ready::Without,
            "settling: the first verdict comes after some seconds".into(),
        ),
        None => (
            Ready::Without,
            "no baseline: Gap fits one to a healthy session".into(),
        ),
        Some(d) if d.is_off() => (
            Ready::Without,
            format!("{:.1} × the limit, most in {}: see Gap", d.ratio, d.channel),
        ),
        Some(d) => (Ready::Yes, format!("{:.1} × the limit", d.ratio)),
    }
}

fn storage(view: &View<'_>) -> (Ready, String) {
    match &view.snapshot.rolling {
        RollingStatus::Stopped(why) => (Ready::Without, why.clone()),
        RollingStatus::Off => (Ready::Without, "no rolling recording".into()),
        RollingStatus::Waits => (Ready::Yes, "the rolling recording begins with Arm".into()),
        RollingStatus::Records(_) | RollingStatus::Paused(_) => (
            Ready::Yes,
            "the rolling recording keeps the last minutes".into(),
        ),
    }
}

/// Whether the arm may be armed, or which check stands in the way.
pub fn gate(checks: &[Check]) -> Gate {
    match checks.iter().find(|c| c.ready == Ready::No) {
        Some(c) => Err(format!(
            "The check “{}” has not passed: {}",
            c.name, c.found
        )),
        None => Ok(()),
    }
}

/// The list, one line per check.
pub fn list(ui: &mut Ui, checks: &[Check]) {
    let p = *Palette::in_ui(ui);
    ui.spacing_mut().item_spacing.y = 3.0;
    ui.spacing_mut().interact_size.y = 18.0;
    for c in checks {
        ui.horizontal(|ui| {
            match c.ready {
                Ready::Yes => tick(ui, p.ready),
                other => {
                    ui.label(RichText::new(other.glyph()).color(other.color(&p)));
                }
            }
            ui.label(c.name);
            let text = RichText::new(&c.found).color(p.weak);
            ui.add(egui::Label::new(text).truncate());
        });
    }
}

/// A tick as wide as the glyphs of the other lines.
fn tick(ui: &mut Ui, color: egui::Color32) {
    let (rect, response) = ui.allocate_exact_size(egui::vec2(12.0, 14.0), egui::Sense::hover());
    let at = |x: f32, y: f32| rect.min + egui::vec2(x, y);
    let line = vec![at(1.5, 7.5), at(4.5, 11.0), at(10.5, 3.0)];
    ui.painter().line(line, egui::Stroke::new(2.0, color));
    response.widget_info(|| egui::WidgetInfo::labeled(egui::Role::Image, true, "ready"));
}

/// The state of the list in one button, behind which the list opens.
pub fn button(ui: &mut Ui, view: &View<'_>) {
    let p = *Palette::in_ui(ui);
    let checks = checks(view);
    let count = |ready| checks.iter().filter(|c| c.ready == ready).count();
    let (ready, text) = match (count(Ready::No), count(Ready::Without)) {
        (0, 0) => (Ready::Yes, "Ready".to_owned()),
        (0, n) => (
            Ready::Without,
            format!("Ready without {n} of {}", checks.len()),
        ),
        (n, _) => (Ready::No, format!("Not ready: {n} of {}", checks.len())),
    };
    // The glyph alone is coloured: nothing is wrong with an arm that has no cameras.
    let mut job = egui::text::LayoutJob::default();
    let font = egui::TextStyle::Button.resolve(ui.style());
    let of = |color| egui::TextFormat::simple(font.clone(), color);
    job.append(ready.glyph(), 0.0, of(ready.color(&p)));
    let passed = count(Ready::Yes);
    let short = match ready {
        Ready::Yes => "Ready".to_owned(),
        Ready::Without => format!("Ready {passed}/{}", checks.len()),
        Ready::No => format!("Not ready {passed}/{}", checks.len()),
    };
    job.append(&short, 6.0, of(p.text));
    let response = ui
        .add(Button::new(job))
        .accessible_name(format!("Readiness: {text}"))
        .on_hover_text("What the arm needs before it moves, and what is better there");
    Popup::menu(&response)
        .accessible_name("Readiness")
        .close_behavior(PopupCloseBehavior::CloseOnClickOutside)
        .show(|ui| {
            ui.set_width(430.0);
            list(ui, &checks);
            ui.add_space(4.0);
            note(ui, "⊗ stops the arm from being armed, ▲ does not.");
        });
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::analysis::fixture;
    use crate::analysis::history::History;
    use crate::robot::RobotSpec;
    use crate::signal::{ChannelHealth, Snapshot};

    fn of(snapshot: &Snapshot) -> Vec<Check> {
        let (spec, history) = (RobotSpec::reference(), History::new(1));
        checks(&View {
            snapshot,
            history: &history,
            near: None,
            now_s: 1.0,
            replay: None,
            spec: &spec,
            simulated: None,
        })
    }

    fn ready(checks: &[Check], name: &str) -> Ready {
        let mut all = checks.iter();
        all.find(|c| c.name == name).expect("a check").ready
    }

    #[test]
    fn what_the_arm_cannot_move_without_gates_it_and_the_rest_does_not() {
        let mut s = fixture::snapshot(1.0);
        s.truth = None;
        let all = of(&s);
        assert_eq!(ready(&all, "Motion capture"), Ready::Without);
        assert_eq!(ready(&all, "Agreement"), Ready::Without);
        assert_eq!(gate(&all), Ok(()));
        let frame = s.sensors.as_mut().expect("sensors");
        frame.health.springs[3] = ChannelHealth::Missing;
        assert_eq!(ready(&of(&s), "Sensors"), Ready::Without);
        let frame = s.sensors.as_mut().expect("sensors");
        frame.health.chambers[2] = ChannelHealth::Stuck;
        let all = of(&s);
        assert_eq!(ready(&all, "Sensors"), Ready::No);
        assert!(gate(&all).expect_err("off").contains("“Sensors”"));
        s = fixture::snapshot(1.0);
        s.link.age_s = 0.4;
        assert!(gate(&of(&s)).expect_err("off").contains("“Link”"));
        s = fixture::snapshot(1.0);
        s.calibration_refusal = Some("Calibrate this arm first.".into());
        assert!(
            gate(&of(&s))
                .expect_err("off")
                .contains("Calibrate this arm first.")
        );
    }
}
