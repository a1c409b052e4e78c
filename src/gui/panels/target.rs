//! Where the tip shall go: a draft, the verdict on it before anything moves, Go, and what becomes of it.

mod course;

use egui::text::{CCursor, CCursorRange};
use egui::{Button, RichText, TextEdit, Ui, vec2};

use super::readiness;
use super::widgets::{Gate, by_enter, gated, note, number};
use crate::gui::theme::{Level, Palette};
use crate::gui::view::View;
use crate::robot::RobotSpec;
use crate::signal::{
    ArmingCheck, CHAMBERS, ControllerKind, Goal, Gripper, Mode, Reach, ReachState,
};
use crate::twin::Command;
pub use course::{Course, Said};

/// How long Go is held on hardware, s.
pub(super) const HOLD_TO_GO_S: f64 = 0.8;

/// What the operator typed or clicked, not yet sent.
#[derive(Clone, Debug, Default)]
pub struct TargetDraft {
    /// x, y, z in mm as typed.
    pub text: [String; 3],
    /// The point that goes to the target, in the end pad's frame, m: zeros are the tip.
    pub point_m: [f64; 3],
    /// What has become of the target that was asked about or gone to.
    pub course: Course,
    /// Whether the arm has been moved since the window was opened: no first move is offered then.
    pub has_moved: bool,
    hold: HoldToGo,
    open: HoldToGo,
    arm: HoldToGo,
}

/// Width of the list of points to steer, points.
const STEERED: f32 = 44.0;

/// A button that moves the arm: at once on the virtual rig, held down on hardware.
#[derive(Clone, Debug, Default)]
pub struct HoldToGo {
    /// For how long it has been held down, s.
    held_s: Option<f64>,
}

/// The words of such a button.
pub struct Fire {
    /// On the virtual rig.
    pub now: &'static str,
    /// On hardware.
    pub hold: &'static str,
    /// What happens, one sentence without its full stop.
    pub hover: &'static str,
}

impl HoldToGo {
    /// Shows the button; whether the arm shall move now.
    pub fn button(
        &mut self,
        ui: &mut Ui,
        view: &View<'_>,
        gate: &Gate,
        fire: &Fire,
        size: egui::Vec2,
    ) -> bool {
        let simulated = !view.snapshot.link.moves_hardware();
        let label = if simulated {
            fire.now.to_owned()
        } else if let Some(held_s) = self.held_s {
            format!("{} {:.1} s", fire.now, (HOLD_TO_GO_S - held_s).max(0.0))
        } else {
            fire.hold.to_owned()
        };
        let hover = match simulated {
            true => format!("{}.", fire.hover),
            false => format!("{}. Hold for {HOLD_TO_GO_S} s: the arm moves.", fire.hover),
        };
        // Sensing drags keeps the button pressed for longer than a click may last.
        let sense = egui::Sense::click_and_drag();
        let button = Button::new(label).min_size(size).sense(sense);
        // An id of its own: a press is never taken over by the button that comes to stand in its place.
        let response = ui
            .push_id(fire.hold, |ui| gated(ui, gate, button, &hover))
            .inner;
        if simulated {
            return response.clicked() && gate.is_ok();
        }
        // Who slides off the button has changed their mind.
        let is_held = response.is_pointer_button_down_on() && response.contains_pointer();
        if gate.is_err() || !is_held {
            self.held_s = None;
            return false;
        }
        ui.request_repaint();
        // The time before the press does not count.
        let Some(before_s) = self.held_s else {
            self.held_s = Some(0.0);
            return false;
        };
        let held_s = before_s + f64::from(ui.input(|i| i.unstable_dt)).min(0.1);
        self.held_s = Some(held_s);
        before_s < HOLD_TO_GO_S && held_s >= HOLD_TO_GO_S
    }
}

/// The simulated arm needs no arming by hand.
pub fn arm_simulated(view: &View<'_>, commands: &mut Vec<Command>) {
    if view.snapshot.mode == Mode::Disarmed && !view.snapshot.link.moves_hardware() {
        commands.push(Command::Arm);
    }
}

impl TargetDraft {
    /// Takes a point of the view and asks for its verdict. Nothing moves.
    pub fn set(&mut self, target_m: [f64; 3], commands: &mut Vec<Command>) {
        self.text = target_m.map(|v| number(v * 1e3, 1).replace('−', "-"));
        if let Ok(goal) = self.goal() {
            self.ask(goal, commands);
        }
    }

    /// The typed target for the point that is steered.
    ///
    /// # Errors
    /// As [`Self::parse`].
    pub fn goal(&self) -> Result<Goal, String> {
        Ok(Goal {
            point_m: self.point_m,
            ..Goal::position(self.parse()?)
        })
    }

    /// Steers another point from now on. Nothing moves: a target that is there is previewed for it.
    pub fn steer(&mut self, point_m: [f64; 3], commands: &mut Vec<Command>) {
        self.point_m = point_m;
        self.course.forget();
        match self.goal() {
            Ok(goal) => self.ask(goal, commands),
            Err(_) => commands.push(Command::CancelPreview),
        }
    }

    /// Takes the rest position and previews it.
    pub fn home(&mut self, spec: &RobotSpec, commands: &mut Vec<Command>) {
        let [x, y, z] = home_m(spec);
        let [px, py, pz] = self.point_m;
        self.set([x + px, y + py, z + pz], commands);
    }

    /// The typed target in m.
    ///
    /// # Errors
    /// One sentence that names the field.
    pub fn parse(&self) -> Result<[f64; 3], String> {
        let mut target_m = [0.0; 3];
        for (i, name) in ["x", "y", "z"].into_iter().enumerate() {
            let text = self.text[i].trim().replace('−', "-").replace(',', ".");
            if text.is_empty() {
                return Err(format!("{name} is empty: type a number in mm."));
            }
            match text.parse::<f64>() {
                Ok(v) if v.is_finite() => target_m[i] = v * 1e-3,
                _ => return Err(format!("{name} is not a number: “{text}”. Type mm.")),
            }
        }
        Ok(target_m)
    }

    fn ask(&mut self, goal: Goal, commands: &mut Vec<Command>) {
        self.course.ask(goal.clone());
        commands.push(Command::Preview(goal));
    }
}

/// The verdict in words.
#[derive(Clone, Debug, PartialEq)]
pub struct Verdict {
    /// A glyph that stands for the state.
    pub glyph: &'static str,
    /// How abnormal it is.
    pub level: Level,
    /// The state and the distance.
    pub title: String,
    /// What stands in the way, and what to do.
    pub detail: String,
}

/// Puts a verdict into words.
pub fn verdict(reach: &Reach) -> Verdict {
    let short_mm = reach.distance_m * 1e3;
    let chamber = reach.limiting_chamber.map(|(i, pa)| {
        let sign = if pa >= 0.0 { "+" } else { "" };
        format!("chamber {i} at {sign}{} kPa", number(pa * 1e-3, 1))
    });
    match reach.state {
        ReachState::Reachable => Verdict {
            glyph: "●",
            level: Level::Normal,
            title: "Reachable".into(),
            detail: "Within tolerance, with pressure to spare.".into(),
        },
        ReachState::Marginal => Verdict {
            glyph: "▲",
            level: Level::Warning,
            title: "Marginal".into(),
            detail: match chamber {
                Some(c) => format!("Reachable, but {c} is close to its bound."),
                None => "Reachable, but close to a pressure bound.".into(),
            },
        },
        ReachState::Unreachable => Verdict {
            glyph: "⊗",
            level: Level::Critical,
            title: format!("Unreachable: {} mm short", number(short_mm, 0)),
            detail: match chamber {
                Some(c) => format!("Limited by {c}. Use the nearest point."),
                None => {
                    "No admissible pressure brings the tip there. Use the nearest point.".into()
                }
            },
        },
        ReachState::OutsideData => Verdict {
            glyph: "?",
            level: Level::Warning,
            title: format!("Outside the data: {} mm from it", number(short_mm, 0)),
            detail: "The model was not trained there: no verdict. Use the nearest point.".into(),
        },
    }
}

/// The verdict that belongs to a target, if the twin has given it.
pub fn preview_of<'a>(view: &View<'a>, target: &Goal) -> Option<&'a Reach> {
    let (goal, reach) = view.snapshot.preview.as_ref()?;
    let near = |i: usize| (goal.position_m[i] - target.position_m[i]).abs() < 5e-5;
    (goal.point_m == target.point_m && (0..3).all(near)).then_some(reach)
}

/// Whether Go is possible, or why not.
pub fn go_gate(view: &View<'_>, draft: &TargetDraft) -> Gate {
    view.motion()?;
    let goal = draft.goal()?;
    if let Some(reason) = draft.course.refusal(&goal.position_m) {
        return Err(reason.into());
    }
    let Some(reach) = preview_of(view, &goal) else {
        return Err("Preview the target first.".into());
    };
    match reach.state {
        ReachState::Reachable | ReachState::Marginal => Ok(()),
        ReachState::Unreachable | ReachState::OutsideData => {
            let v = verdict(reach);
            Err(format!("{}. {}", v.title, v.detail))
        }
    }
}

/// Position of the tip without pressure and load, straight below the base, m.
pub fn home_m(spec: &RobotSpec) -> [f64; 3] {
    [0.0, 0.0, -(2.0 * spec.rest_length_m + spec.pad_thickness_m)]
}

/// A place to the side of the rest position that an arm reaches easily: where a newcomer sends it first, m.
pub fn first_m(spec: &RobotSpec) -> [f64; 3] {
    let [.., z] = home_m(spec);
    [-0.15 * z, -0.10 * z, z]
}

/// Whether a newcomer is offered a first move: nothing was chosen yet, and nothing can break.
pub fn offers_first(view: &View<'_>, draft: &TargetDraft) -> bool {
    let s = view.snapshot;
    let rests = matches!(s.mode, Mode::Disarmed | Mode::Hold) && s.routine.is_none();
    let empty = draft.text.iter().all(String::is_empty) && s.goal.is_none() && s.preview.is_none();
    rests && empty && !draft.has_moved && !s.link.moves_hardware() && view.motion().is_ok()
}

/// The first move, in one press.
pub fn send_first(view: &View<'_>, draft: &mut TargetDraft, commands: &mut Vec<Command>) {
    draft.point_m = [0.0; 3];
    draft.text = first_m(view.spec).map(|v| number(v * 1e3, 1).replace('−', "-"));
    if let Ok(goal) = draft.goal() {
        arm_simulated(view, commands);
        commands.push(Command::Goto(goal.clone()));
        draft.course.send(goal, view.snapshot);
    }
}

/// A button that stands out: what a newcomer presses first.
pub fn highlighted(text: &str, p: &Palette) -> Button<'static> {
    Button::new(RichText::new(text.to_owned()).color(p.window).strong()).fill(p.ready)
}

/// The panel.
pub fn ui(ui: &mut Ui, view: &View<'_>, draft: &mut TargetDraft, commands: &mut Vec<Command>) {
    ui.spacing_mut().item_spacing.y = 5.0;
    arming(ui, view, &mut draft.arm, commands);
    let submitted = fields(ui, view, draft, commands);
    let parsed = draft.goal();
    let live = view.live();
    let preview_gate = live.clone().and(parsed.clone().map(|_| ()));
    let buttons = if is_armed(view) { 4.0 } else { 3.0 };
    let one = vec2(
        (ui.available_width() - 8.0 * (buttons - 1.0)) / buttons,
        28.0,
    );
    ui.horizontal(|ui| {
        let clicked = gated(
            ui,
            &preview_gate,
            Button::new("Preview").min_size(one),
            "Check whether the tip can get there. Nothing moves (Enter).",
        )
        .clicked();
        if let (true, Ok(goal), Ok(())) = (clicked || submitted, &parsed, &live) {
            draft.ask(goal.clone(), commands);
        }
        let cancel = if view.snapshot.preview.is_some() {
            live.clone()
        } else {
            Err("Nothing is under preview.".into())
        };
        if gated(
            ui,
            &cancel,
            Button::new("Cancel").min_size(one),
            "Forget the target under preview (Esc)",
        )
        .clicked()
        {
            draft.course.forget();
            commands.push(Command::CancelPreview);
        }
        let hover = "Take the rest position, straight below the base, as the target and preview it. Nothing moves.";
        if gated(ui, &live, Button::new("Home").min_size(one), hover).clicked() {
            draft.home(view.spec, commands);
        }
        if is_armed(view) {
            let button = Button::new("Disarm").min_size(one);
            if gated(ui, &live, button, "Stop commanding pressures").clicked() {
                commands.push(Command::Disarm);
            }
        }
    });
    let reach = parsed.as_ref().ok().and_then(|goal| preview_of(view, goal));
    card(ui, view, draft, &parsed, reach, commands);
    let half = vec2((ui.available_width() - 8.0) / 2.0, 29.0);
    ui.horizontal(|ui| {
        go(ui, view, draft, half, commands);
        let nearest = match (&live, reach) {
            (Err(e), _) => Err(e.clone()),
            (_, Some(r)) if r.distance_m > 0.0 => Ok(()),
            (_, Some(_)) => Err("The target itself is reachable.".into()),
            (_, None) => Err("Preview the target first.".into()),
        };
        if gated(
            ui,
            &nearest,
            Button::new("Use nearest").min_size(half),
            "Take the nearest reachable point as the target and preview it. Nothing moves.",
        )
        .clicked()
            && let Some(r) = reach
        {
            draft.set(r.nearest_m, commands);
        }
    });
    ui.horizontal(|ui| {
        controller(ui, view, commands);
        payload(ui, view, commands);
    });
    ui.horizontal(|ui| {
        hand(ui, view, draft, commands);
        // Hardware has the list itself above, while it is disarmed.
        readiness::button(ui, view);
    });
}

/// Which point goes to the target.
fn steered(ui: &mut Ui, view: &View<'_>, draft: &mut TargetDraft, commands: &mut Vec<Command>) {
    let points = [("Tip", [0.0; 3]), ("Grip", view.spec.grip_m())];
    let now = points.iter().find(|(_, m)| *m == draft.point_m);
    let mut chosen = draft.point_m;
    let list = egui::ComboBox::from_id_salt("steered")
        .width(STEERED)
        .selected_text(now.map_or("?", |(name, _)| name));
    let response = list
        .show_ui(ui, |ui| {
            for (name, point_m) in points {
                ui.selectable_value(&mut chosen, point_m, name);
            }
        })
        .response
        .accessible_name("Steered point");
    let below = number(view.spec.payload_com_m * 1e3, 0);
    response.on_hover_text(format!(
        "Which point goes to the target: the tip in the middle of the end pad, or the grip point {below} mm below it, where the \
         gripper holds its load"
    ));
    if chosen != draft.point_m {
        draft.steer(chosen, commands);
    }
}

fn fields(
    ui: &mut Ui,
    view: &View<'_>,
    draft: &mut TargetDraft,
    commands: &mut Vec<Command>,
) -> bool {
    let mut submitted = false;
    ui.horizontal(|ui| {
        ui.spacing_mut().item_spacing.x = 6.0;
        if view.spec.payload_com_m > 0.0 {
            steered(ui, view, draft, commands);
        }
        let width = (ui.available_width() - 3.0 * 20.0 - 28.0) / 3.0;
        for (i, name) in ["x", "y", "z"].into_iter().enumerate() {
            note(ui, name);
            let edit = TextEdit::singleline(&mut draft.text[i])
                .id_salt(("target", i))
                .desired_width(width)
                .align(egui::Align2::RIGHT_CENTER);
            let response = ui
                .add(edit)
                .accessible_name(format!("Target {name} in mm"))
                .on_hover_text("In the base frame: origin at the fixed top pad, z up");
            if response.gained_focus() {
                select_all(ui, response.id, draft.text[i].chars().count());
            }
            submitted |= by_enter(&response);
        }
        note(ui, "mm");
    });
    submitted
}

/// Marks a text that the focus has just come to, so that typing replaces it.
fn select_all(ui: &Ui, id: egui::Id, chars: usize) {
    if let Some(mut state) = TextEdit::load_state(ui.ctx(), id) {
        let all = CCursorRange::two(CCursor::default(), CCursor::new(chars));
        state.cursor.set_char_range(Some(all));
        state.store(ui.ctx(), id);
    }
}

/// What becomes of the target: the verdict, then the motion, then its result.
fn card(
    ui: &mut Ui,
    view: &View<'_>,
    draft: &mut TargetDraft,
    parsed: &Result<Goal, String>,
    reach: Option<&Reach>,
    commands: &mut Vec<Command>,
) {
    let p = *Palette::in_ui(ui);
    egui::Frame::new()
        .fill(p.sunken)
        .stroke(egui::Stroke::new(1.0, p.line))
        .corner_radius(4)
        .inner_margin(8)
        .show(ui, |ui| {
            ui.set_width(ui.available_width());
            // Three lines: what stands below stays where it is, whatever is typed and found, unless a reason is long.
            ui.set_min_height(60.0);
            ui.spacing_mut().item_spacing.y = 3.0;
            let target_m = parsed.as_ref().ok().map(|goal| &goal.position_m);
            let target_m = target_m.filter(|_| view.replay.is_none());
            let said = target_m.and_then(|t| draft.course.says(t, view.snapshot));
            let settled = target_m.is_some_and(|t| draft.course.is_settled(t));
            match (reach.filter(|_| !settled), said, parsed) {
                (Some(reach), ..) => verdict_lines(ui, view, reach, parsed),
                (None, Some(said), _) => progress(ui, &said),
                (None, None, Ok(_)) => {
                    note(ui, "Not checked yet: press Preview. Nothing moves.");
                }
                (None, None, Err(_)) if draft.text.iter().all(String::is_empty) => {
                    note(ui, "No target. Click in the 3D view, or type x, y and z.");
                    if offers_first(view, draft) {
                        let hover = "Move the simulated arm to the marked place: nothing can break";
                        let button = highlighted("▶ Send it here", &p);
                        if ui.add(button).on_hover_text(hover).clicked() {
                            send_first(view, draft, commands);
                        }
                    }
                }
                (None, None, Err(reason)) => {
                    ui.label(RichText::new(format!("▲ {reason}")).color(p.warning));
                }
            }
        });
}

/// The motion or its result.
fn progress(ui: &mut Ui, said: &Said) {
    let p = *Palette::in_ui(ui);
    ui.label(RichText::new(&said.title).color(p.level_text(said.level)));
    if let Some(share) = said.share {
        let bar = egui::ProgressBar::new(share)
            .desired_width(ui.available_width())
            .desired_height(8.0);
        ui.add(bar).on_hover_text("Share of the way that is done");
    }
    note(ui, &said.detail);
}

fn verdict_lines(ui: &mut Ui, view: &View<'_>, reach: &Reach, parsed: &Result<Goal, String>) {
    let p = *Palette::in_ui(ui);
    let v = verdict(reach);
    let title = RichText::new(format!("{} {}", v.glyph, v.title));
    ui.label(title.color(p.level_text(v.level)));
    note(ui, v.detail);
    if let (Some(e), Ok(goal)) = (&view.snapshot.estimate, parsed) {
        let d = goal.error(&e.base_from_tip).fixed_rows::<3>(0).norm();
        let text = format!(
            "{} mm to move, at least {} s",
            number(d * 1e3, 1),
            number(d / view.spec.tip_speed_max_m_s, 0)
        );
        note(ui, text).on_hover_text("At the fastest tip speed of the robot file");
    }
}

fn go(
    ui: &mut Ui,
    view: &View<'_>,
    draft: &mut TargetDraft,
    size: egui::Vec2,
    commands: &mut Vec<Command>,
) {
    let gate = go_gate(view, draft);
    let fire = Fire {
        now: "▶ Go",
        hold: "▶ Hold to go",
        hover: match draft.point_m == [0.0; 3] {
            true => "Move the tip to the target",
            false => "Move the grip point to the target",
        },
    };
    if draft.hold.button(ui, view, &gate, &fire, size) {
        arm_simulated(view, commands);
        commands.push(Command::Go);
        if let Ok(goal) = draft.goal() {
            draft.course.send(goal, view.snapshot);
        }
    }
}

fn controller(ui: &mut Ui, view: &View<'_>, commands: &mut Vec<Command>) {
    let gate = view.live();
    note(ui, "Controller");
    for (kind, name, hover) in [
        (
            ControllerKind::NullSpaceQp,
            "QP",
            "Null-space QP: a quadratic program within the pressure bounds, which keeps pressures centred",
        ),
        (
            ControllerKind::PaperAdrc,
            "ADRC",
            "ADRC (paper): the paper's sensor-space descent with an active disturbance rejection loop",
        ),
    ] {
        let chosen = view.snapshot.controller == kind;
        let button = Button::selectable(chosen, name).frame_when_inactive(true);
        if gated(ui, &gate, button, hover).clicked() && !chosen {
            commands.push(Command::Steer(kind));
        }
    }
}

/// Whether the gripper may be worked: what is asked for must be done now, not at the next arming.
pub fn gripper_gate(view: &View<'_>) -> Gate {
    view.motion()?;
    match view.snapshot.mode {
        Mode::Disarmed => Err("Disarmed: the gripper follows once the arm is armed.".into()),
        _ => Ok(()),
    }
}

fn hand(ui: &mut Ui, view: &View<'_>, draft: &mut TargetDraft, commands: &mut Vec<Command>) {
    let grip = gripper_gate(view);
    let commanded = view.snapshot.command.as_ref().and_then(|c| c.gripper());
    let now = commanded.or(view.snapshot.link.gripper);
    note(ui, "Gripper");
    // What it holds would fall.
    let drops = view.snapshot.link.moves_hardware() && view.snapshot.payload_kg > 0.0;
    if drops && now != Some(Gripper::Open) {
        let fire = Fire {
            now: "Open",
            hold: "Hold to open",
            hover: "Open the gripper: it lets its load go",
        };
        let gate = grip.clone().and(match view.snapshot.mode {
            Mode::Hold => Ok(()),
            _ => Err("The arm moves with a load: hold it first.".into()),
        });
        let size = vec2(0.0, 0.0);
        if draft.open.button(ui, view, &gate, &fire, size) {
            commands.push(Command::Grip(Gripper::Open));
        }
    }
    for (gripper, name) in [(Gripper::Open, "Open"), (Gripper::Closed, "Closed")] {
        if drops && gripper == Gripper::Open && now != Some(Gripper::Open) {
            continue;
        }
        let button = Button::selectable(now == Some(gripper), name).frame_when_inactive(true);
        if gated(ui, &grip, button, "Open or close the gripper").clicked() {
            commands.push(Command::Grip(gripper));
        }
    }
}

/// What the operator believes is in the gripper.
fn payload(ui: &mut Ui, view: &View<'_>, commands: &mut Vec<Command>) {
    let gate = view.live();
    let label = note(ui, "Payload");
    let mut grams = view.snapshot.payload_kg * 1e3;
    let drag = egui::DragValue::new(&mut grams)
        .range(0.0..=view.spec.payload_max_kg * 1e3)
        .speed(1.0)
        .max_decimals(0)
        .update_while_editing(false)
        .suffix(" g");
    let response = ui.add_enabled(gate.is_ok(), drag).labelled_by(label.id);
    if response.changed() {
        commands.push(Command::DeclarePayload(grams * 1e-3));
    }
    match gate {
        Ok(()) => response.on_hover_text("Mass in the gripper as you believe it, g"),
        Err(reason) => response.on_disabled_hover_text(reason),
    };
}

/// Whether hardware has been armed, and may move after its check of the gauges.
fn is_armed(view: &View<'_>) -> bool {
    let s = view.snapshot;
    let off = matches!(s.mode, Mode::Disarmed | Mode::Safe(_));
    s.link.moves_hardware() && !off && s.gauge_check != ArmingCheck::Due
}

fn arming(ui: &mut Ui, view: &View<'_>, arm: &mut HoldToGo, commands: &mut Vec<Command>) {
    let s = view.snapshot;
    if !s.link.moves_hardware() || matches!(s.mode, Mode::Safe(_)) {
        return;
    }
    if let ArmingCheck::Chamber(i) = s.gauge_check {
        let text = format!("The gauges are checked: chamber {} of {CHAMBERS}", i + 1);
        super::widgets::status(ui, Level::Warning, &text);
    }
    if is_armed(view) {
        return;
    }
    let checks = readiness::checks(view);
    readiness::list(ui, &checks);
    let gate = view.live().and(readiness::gate(&checks));
    let fire = Fire {
        now: "Arm",
        hold: "Hold to arm",
        hover: "Allow motion. One after another each chamber is changed by 1 kPa, the first time by 2 kPa",
    };
    if arm.button(ui, view, &gate, &fire, vec2(0.0, 0.0)) {
        commands.push(Command::Arm);
    }
    ui.separator();
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::analysis::fixture;

    #[test]
    fn bad_fields_are_named_in_one_sentence() {
        let mut d = TargetDraft {
            text: ["10".into(), String::new(), "-300".into()],
            ..TargetDraft::default()
        };
        assert_eq!(d.parse(), Err("y is empty: type a number in mm.".into()));
        for bad in ["NaN", "inf", "1e999", "ten"] {
            d.text[1] = bad.into();
            let e = d.parse().expect_err(bad);
            assert!(e.starts_with("y is not a number") && e.contains(bad), "{e}");
        }
        d.text[1] = "−5,5".into();
        assert_eq!(d.parse(), Ok([0.01, -0.0055, -0.3]));
    }

    #[test]
    fn a_point_beside_the_axis_has_no_negative_zero() {
        let mut d = TargetDraft::default();
        d.set([-1e-6, 4e-5, -0.3], &mut Vec::new());
        assert_eq!(d.text, ["0.0", "0.0", "-300.0"]);
    }

    #[test]
    fn verdicts_say_distance_and_chamber() {
        let v = verdict(&fixture::reach(ReachState::Unreachable, [0.1, 0.0, -0.3]));
        assert_eq!(v.title, "Unreachable: 18 mm short");
        assert!(v.detail.contains("chamber 4 at +40.0 kPa"), "{}", v.detail);
        let glyphs: Vec<_> = [
            ReachState::Reachable,
            ReachState::Marginal,
            ReachState::Unreachable,
            ReachState::OutsideData,
        ]
        .map(|s| verdict(&fixture::reach(s, [0.0, 0.0, -0.3])).glyph)
        .into();
        assert_eq!(glyphs, ["●", "▲", "⊗", "?"]);
    }
}
