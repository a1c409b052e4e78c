//! Plans: a circle, a figure 8, pick and place, points set by hand; checked as a whole before anything moves.

mod driven;
mod form;

use egui::{RichText, Ui, vec2};

use super::target::{Fire, HoldToGo};
use super::widgets::{Gate, note, number, status};
use crate::gui::theme::{Level, Palette};
use crate::gui::view::View;
use crate::robot::RobotSpec;
use crate::signal::{Goal, Gripper, Mode, RoutineStatus, Snapshot, Stamp};
use crate::task::{Follow, Item, Leg, PATH_WAYPOINTS, Path, Plan, circle, figure_eight};
use crate::twin::{Command, Event};

/// Most points set by hand.
pub const POINTS_MAX: usize = 200;
/// Height of Start and what stands below it, points.
const FOOT_PT: f32 = 84.0;
/// Points drawn by a drag are this far apart, m.
const DRAWN_STEP_M: f64 = 5e-3;
/// A plan that was given to a disarmed arm has set out by then, or never will, s.
const SET_OUT_S: f64 = 1.0;

/// What kind of plan is being made.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum PlanKind {
    /// A level circle.
    #[default]
    Circle,
    /// A level figure 8.
    Eight,
    /// From one place to another with the gripper.
    PickPlace,
    /// Points set by hand.
    Points,
}

impl PlanKind {
    /// All kinds with their names and what they are.
    pub const ALL: [(Self, &'static str, &'static str); 4] = [
        (
            Self::Circle,
            "Circle",
            "A level circle, begun at its largest x",
        ),
        (Self::Eight, "Figure 8", "A level figure 8 along x"),
        (
            Self::PickPlace,
            "Pick and place",
            "Grasp an object here and release it there",
        ),
        (
            Self::Points,
            "Points",
            "Waypoints clicked or drawn in the 3D view",
        ),
    ];
}

/// How points set by hand are passed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Passing {
    /// The tip settles at each.
    #[default]
    Stop,
    /// The tip follows the line through them and back to the first at an even speed.
    Follow,
}

/// What became of the plan that was started last.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum Outcome {
    /// Nothing was started, or it is forgotten.
    #[default]
    Nothing,
    /// It was sent to the twin, which looks at every stop or carries it out.
    Given,
    /// Carried out: one sentence.
    Done(String),
    /// Refused or given up: one sentence.
    Refused(String),
    /// It was under way and is no more, as after a stop or another order; seen at this time.
    Ended(Stamp),
}

/// The plan being made, and what became of the last one.
pub struct PlanState {
    /// Which kind.
    pub kind: PlanKind,
    /// Middle of circle and 8, mm.
    pub centre_mm: [f64; 3],
    /// Radius of the circle, half the length of the 8, mm.
    pub size_mm: f64,
    /// Along circle, 8 or the line through the points, mm/s.
    pub speed_mm_s: f64,
    /// How many times round.
    pub laps: u32,
    /// Where the tip grasps, mm.
    pub pick_mm: [f64; 3],
    /// Where it lets go, mm.
    pub place_mm: [f64; 3],
    /// How much higher it travels, mm.
    pub lift_mm: f64,
    /// What it lifts, g.
    pub payload_g: f64,
    /// Points set by hand, m.
    pub points_m: Vec<[f64; 3]>,
    /// How they are passed.
    pub passing: Passing,
    /// Which of them is selected.
    pub selected: Option<usize>,
    /// Whether clicks and drags in the 3D view make points.
    pub drawing: bool,
    /// Whether the panel was on screen in the last frame.
    pub shown: bool,
    /// The plan that was started last.
    pub given: Option<Plan>,
    /// What became of it.
    pub outcome: Outcome,
    /// How its path is driven; `None` without one.
    pub driven: Option<driven::Driven>,
    /// What a recording that runs is to keep of the result.
    pub remark: Option<String>,
    /// When it was given.
    given_at: Stamp,
    /// When it was last seen under way.
    seen: Option<Stamp>,
    hold: HoldToGo,
}

impl Default for PlanState {
    fn default() -> Self {
        Self {
            kind: PlanKind::default(),
            centre_mm: [0.0, 0.0, -310.0],
            size_mm: 50.0,
            speed_mm_s: 3.0,
            laps: 1,
            pick_mm: [-80.0, 0.0, -320.0],
            place_mm: [90.0, 30.0, -300.0],
            lift_mm: 30.0,
            payload_g: 120.0,
            points_m: Vec::new(),
            passing: Passing::default(),
            selected: None,
            drawing: false,
            shown: false,
            given: None,
            outcome: Outcome::default(),
            driven: None,
            remark: None,
            given_at: Stamp::default(),
            seen: None,
            hold: HoldToGo::default(),
        }
    }
}

fn metres(mm: [f64; 3]) -> [f64; 3] {
    mm.map(|v| v * 1e-3)
}

fn distance_m(a: &[f64; 3], b: &[f64; 3]) -> f64 {
    (nalgebra::Vector3::from(*a) - nalgebra::Vector3::from(*b)).norm()
}

/// Where a plan leads, for the eye.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Track {
    /// In order, m.
    pub waypoints_m: Vec<[f64; 3]>,
    /// Whether it leads back to the first.
    pub closed: bool,
}

impl Track {
    /// Of a plan, leg by leg.
    pub fn of(plan: &Plan) -> Self {
        let mut track = Self::default();
        for leg in &plan.legs {
            match leg {
                Leg::Move(goal) => track.push(goal.position_m),
                Leg::Follow(follow) => {
                    follow.path.waypoints_m.iter().for_each(|p| track.push(*p));
                    track.closed = true;
                }
                Leg::Grip { .. } | Leg::Excite(_) => {}
            }
        }
        track
    }

    fn push(&mut self, at_m: [f64; 3]) {
        if !self.waypoints_m.contains(&at_m) {
            self.waypoints_m.push(at_m);
        }
    }

    /// Length, the way back to the first included if there is one, m.
    pub fn length_m(&self) -> f64 {
        let points = &self.waypoints_m;
        let open: f64 = points.windows(2).map(|w| distance_m(&w[0], &w[1])).sum();
        match (self.closed, points.first(), points.last()) {
            (true, Some(a), Some(b)) => open + distance_m(a, b),
            _ => open,
        }
    }
}

impl PlanState {
    /// The plan as it stands.
    ///
    /// # Errors
    /// One sentence that names what is missing.
    pub fn plan(&self, spec: &RobotSpec) -> Result<Plan, String> {
        match self.kind {
            PlanKind::Circle | PlanKind::Eight => {
                let (centre_m, size_m) = (metres(self.centre_mm), self.size_mm * 1e-3);
                let path = match self.kind {
                    PlanKind::Circle => circle(centre_m, size_m, PATH_WAYPOINTS),
                    _ => figure_eight(centre_m, size_m, PATH_WAYPOINTS),
                };
                self.along(path, spec)
            }
            PlanKind::PickPlace => {
                let item = Item {
                    name: format!("{} g", number(self.payload_g, 0)),
                    grasp_m: metres(self.pick_mm),
                    mass_kg: self.payload_g * 1e-3,
                };
                let lift_m = self.lift_mm * 1e-3;
                Ok(Plan::pick_and_place(
                    &[item],
                    metres(self.place_mm),
                    lift_m,
                ))
            }
            PlanKind::Points if self.points_m.is_empty() => Err(
                "There are no waypoints: switch Draw on and click in the 3D view, or add the target."
                    .into(),
            ),
            PlanKind::Points => {
                let name = match self.points_m.len() {
                    1 => "1 point".to_owned(),
                    n => format!("{n} points"),
                };
                match self.passing {
                    Passing::Stop => {
                        let goals = self.points_m.iter().map(|p| Goal::position(*p));
                        let legs = goals.map(Leg::Move).collect();
                        Ok(Plan::new(name, legs))
                    }
                    Passing::Follow if self.points_m.len() < 3 => {
                        Err("A closed line needs three waypoints: add more, or stop at each.".into())
                    }
                    Passing::Follow => {
                        let name = format!("line through {name}");
                        let waypoints_m = self.points_m.clone();
                        self.along(Path { name, waypoints_m }, spec)
                    }
                }
            }
        }
    }

    /// The speed along a path, m/s, or why it is refused.
    fn speed(&self, spec: &RobotSpec) -> Result<f64, String> {
        let most_mm_s = spec.tip_speed_max_m_s * 1e3;
        if self.speed_mm_s > most_mm_s {
            let (asked, most) = (number(self.speed_mm_s, 1), number(most_mm_s, 1));
            return Err(format!(
                "{asked} mm/s is more than the tip's {most} mm/s: choose a lower speed."
            ));
        }
        Ok(self.speed_mm_s * 1e-3)
    }

    fn along(&self, path: Path, spec: &RobotSpec) -> Result<Plan, String> {
        let follow = Follow {
            path,
            speed_m_s: self.speed(spec)?,
            laps: self.laps,
        };
        Plan::follow(follow).ok_or_else(|| "The path has no waypoints.".into())
    }

    /// Adds a waypoint after the others.
    pub fn add(&mut self, at_m: [f64; 3]) {
        if self.points_m.len() < POINTS_MAX {
            self.points_m.push(at_m);
            self.selected = Some(self.points_m.len() - 1);
        }
    }

    /// Takes a place that a drag passes over: a waypoint every few millimetres.
    pub fn draw_to(&mut self, at_m: [f64; 3]) {
        let last = self.points_m.last();
        if last.is_none_or(|last| distance_m(last, &at_m) >= DRAWN_STEP_M) {
            self.add(at_m);
        }
    }

    /// Takes the selected waypoint out; the one that follows is selected then.
    pub fn delete_selected(&mut self) {
        if let Some(i) = self.selected.filter(|i| *i < self.points_m.len()) {
            self.points_m.remove(i);
            let last = self.points_m.len().checked_sub(1);
            self.selected = last.map(|last| i.min(last));
        }
    }

    /// Whether the selected waypoint can go one place up (earlier) or down.
    fn neighbour(&self, earlier: bool) -> Option<(usize, usize)> {
        let i = self.selected?;
        let j = if earlier { i.checked_sub(1)? } else { i + 1 };
        (i < self.points_m.len() && j < self.points_m.len()).then_some((i, j))
    }

    /// Moves the selected waypoint one place up (earlier) or down.
    pub fn reorder(&mut self, earlier: bool) {
        if let Some((i, j)) = self.neighbour(earlier) {
            self.points_m.swap(i, j);
            self.selected = Some(j);
        }
    }

    /// The waypoint that is highlighted in the 3D view.
    pub fn selected_mark(&self) -> Option<usize> {
        let editing = self.shown && self.kind == PlanKind::Points;
        self.selected.filter(|_| editing)
    }

    /// Selects the waypoint that was clicked in the 3D view.
    pub fn select_mark(&mut self, i: usize) {
        if self.shown && self.kind == PlanKind::Points && i < self.points_m.len() {
            self.selected = Some(i);
        }
    }

    /// Moves the selected waypoint.
    pub fn move_selected(&mut self, to_m: [f64; 3]) {
        if let Some(point) = self.selected.and_then(|i| self.points_m.get_mut(i)) {
            *point = to_m;
        }
    }

    /// The waypoint of a track that the tip travels to now.
    pub fn next_mark(&self, view: &View<'_>, track: &Track) -> Option<usize> {
        let (plan, routine) = self.under_way(view)?;
        let n = track.waypoints_m.len();
        match (routine.waypoint, plan.legs.get(routine.legs_done)) {
            (Some((k, _)), _) if n > 0 => Some(k % n),
            (None, Some(Leg::Move(goal))) => {
                let mut marks = track.waypoints_m.iter();
                marks.position(|m| *m == goal.position_m)
            }
            _ => None,
        }
    }

    /// Whether clicks in the 3D view make waypoints now.
    pub fn is_drawing(&self) -> bool {
        self.drawing && self.shown && self.kind == PlanKind::Points
    }

    /// What the 3D view shows: the plan under way, else the one being made while its panel is open.
    pub fn track(&self, view: &View<'_>) -> Option<Track> {
        let under_way = self.under_way(view).map(|(plan, _)| plan);
        // The way that was driven is shown beside the planned one until something else moves.
        // While another plan is being made, that one is shown.
        let done = self.given.as_ref().filter(|given| {
            let edits = self.shown && self.plan(view.spec).as_ref() != Ok(*given);
            self.driven.is_some() && view.replay.is_none() && !edits
        });
        under_way.or(done).map(Track::of).or_else(|| {
            let plan = self.shown.then(|| self.plan(view.spec).ok()).flatten();
            if self.shown && self.kind == PlanKind::Points {
                // Every point, also those that are no plan yet.
                return Some(Track {
                    waypoints_m: self.points_m.clone(),
                    closed: self.passing == Passing::Follow && self.points_m.len() > 2,
                });
            }
            plan.as_ref().map(Track::of)
        })
    }

    /// The plan that this panel started, with how far it has come.
    pub fn under_way<'a>(&'a self, view: &View<'a>) -> Option<(&'a Plan, &'a RoutineStatus)> {
        let (plan, routine) = (self.given.as_ref()?, view.snapshot.routine.as_ref()?);
        let same = plan.name == routine.name && plan.legs.len() == routine.legs;
        (same && view.replay.is_none() && routine.legs_done < routine.legs)
            .then_some((plan, routine))
    }

    /// Takes note of whether the plan that was given is under way, and of its end without a word.
    pub fn follow(&mut self, live: &Snapshot) {
        let (Some(plan), Outcome::Given) = (&self.given, &self.outcome) else {
            return;
        };
        let under_way = live.routine.as_ref().is_some_and(|r| r.name == plan.name);
        let since_s = live.stamp.since(self.given_at);
        let off = match live.mode {
            Mode::Safe(_) => true,
            Mode::Disarmed => since_s > SET_OUT_S,
            _ => false,
        };
        if under_way {
            self.seen = Some(live.stamp);
        } else if self.seen.is_some() || off {
            self.outcome = Outcome::Ended(live.stamp);
        }
    }

    /// Takes a snapshot of the live twin: where the tip is on the path.
    pub fn watch(&mut self, live: &Snapshot) {
        let Some(plan) = &self.given else {
            return;
        };
        let Some(routine) = live.routine.as_ref().filter(|_| live.mode == Mode::Moving) else {
            return;
        };
        if routine.name != plan.name || routine.legs != plan.legs.len() {
            // Another motion: the way that was driven is in its way.
            self.driven = None;
            return;
        }
        match (plan.legs.get(routine.legs_done), routine.waypoint) {
            (Some(Leg::Follow(follow)), Some(_)) => {
                self.driven.get_or_insert_default().take(live, follow);
            }
            // It begins: what came before is of another run.
            _ if routine.legs_done == 0 => self.driven = None,
            _ => {}
        }
    }

    /// Where the tip was on a path that is shown, m.
    pub fn line_m(&self, view: &View<'_>, track: &Track) -> &[[f32; 3]] {
        let given = self.given.as_ref().filter(|_| view.replay.is_none());
        let is_it = given.is_some_and(|plan| Track::of(plan) == *track);
        let driven = self.driven.as_ref().filter(|_| is_it);
        driven.map_or(&[], |d| &d.line_m)
    }

    /// Gives the plan to the twin.
    pub fn set_out(&mut self, view: &View<'_>, commands: &mut Vec<Command>) {
        let Ok(plan) = self.plan(view.spec) else {
            return;
        };
        super::target::arm_simulated(view, commands);
        commands.push(Command::Start(plan.clone()));
        self.given = Some(plan);
        self.outcome = Outcome::Given;
        (self.seen, self.given_at) = (None, view.snapshot.stamp);
        (self.driven, self.remark) = (None, None);
        self.drawing = false;
    }

    /// Lets go of a plan that another twin was given.
    pub fn forget(&mut self) {
        (self.given, self.outcome) = (None, Outcome::Nothing);
        (self.driven, self.remark) = (None, None);
    }

    /// Takes an event of the twin about the plan it was given.
    pub fn observe(&mut self, event: &Event) {
        let Some(plan) = &self.given else {
            return;
        };
        match event {
            Event::Refused { stamp, reason } => {
                // A refusal while it is under way, or later, is of something else.
                let of_this = match (&self.outcome, self.seen) {
                    (Outcome::Given, None) => true,
                    (Outcome::Ended(end), seen) => seen <= Some(*stamp) && stamp <= end,
                    _ => false,
                };
                if of_this {
                    self.outcome = Outcome::Refused(reason.clone());
                }
            }
            Event::Finished { name, .. } if *name == plan.name => {
                let off = self.driven.as_ref().and_then(|d| d.text("motion capture"));
                self.remark = off.as_ref().map(|off| format!("{name}: {off}"));
                self.outcome = Outcome::Done(match off {
                    Some(off) => format!("{}. {off}.", event.text()),
                    None => event.text(),
                });
            }
            _ => {}
        }
    }
}

/// Whether the plan can be started, or why not.
pub fn start_gate(view: &View<'_>, state: &PlanState) -> Gate {
    view.motion()?;
    state.plan(view.spec).map(|_| ())
}

/// The panel. `target_m` is the target of the Target panel.
pub fn ui(
    ui: &mut Ui,
    view: &View<'_>,
    state: &mut PlanState,
    target_m: Option<[f64; 3]>,
    commands: &mut Vec<Command>,
) {
    // Start and what becomes of it stay in sight, whatever the form needs.
    egui::Panel::bottom("plan start")
        .resizable(false)
        .show_separator_line(false)
        .exact_size(FOOT_PT)
        .frame(egui::Frame::NONE)
        .show(ui, |ui| start(ui, view, state, commands));
    egui::ScrollArea::vertical()
        .auto_shrink(false)
        .show(ui, |ui| form::ui(ui, view, state, target_m));
}

fn start(ui: &mut Ui, view: &View<'_>, state: &mut PlanState, commands: &mut Vec<Command>) {
    ui.add_space(6.0);
    let size = vec2(ui.available_width(), 30.0);
    let gate = start_gate(view, state);
    let fire = state.hold.button(
        ui,
        view,
        &gate,
        &Fire {
            now: "▶ Start",
            hold: "▶ Hold to start",
            hover: "Check every stop with the load it will carry, then carry the plan out",
        },
        size,
    );
    if fire {
        state.set_out(view, commands);
    }
    egui::ScrollArea::vertical()
        .id_salt("outcome")
        .auto_shrink(false)
        .min_scrolled_height(0.0)
        .show(ui, |ui| progress(ui, view, state));
}

fn progress(ui: &mut Ui, view: &View<'_>, state: &PlanState) {
    if let Some((plan, routine)) = state.under_way(view) {
        let (done, share) = share(routine);
        let width = ui.available_width();
        ui.add(
            egui::ProgressBar::new(share)
                .desired_width(width)
                .text(done),
        )
        .on_hover_text("Progress of the plan; Hold and Resume are at the top");
        if let Some(leg) = plan.legs.get(routine.legs_done) {
            let left = left_s(leg, routine)
                .map_or_else(String::new, |s| format!(" About {} s left.", number(s, 0)));
            note(ui, format!("{}{left}", leg_text(leg)));
        }
        return;
    }
    match &state.outcome {
        Outcome::Nothing => {
            note(
                ui,
                "Nothing moves before every stop has been found reachable.",
            );
        }
        Outcome::Given => {
            note(ui, "Checking every stop…");
        }
        Outcome::Ended(_) => {
            note(ui, "Ended before it was done.");
        }
        Outcome::Done(text) => {
            status(ui, Level::Normal, text);
        }
        Outcome::Refused(reason) => {
            let color = Palette::in_ui(ui).warning;
            ui.label(RichText::new(format!("▲ {reason}")).color(color));
        }
    }
}

/// How far a plan has come: in words, and its share.
fn share(routine: &RoutineStatus) -> (String, f32) {
    let leg = (routine.legs_done + 1).min(routine.legs);
    let mut text = format!("Leg {leg} of {}", routine.legs);
    let mut part = 0.0;
    if let Some((k, n)) = routine.waypoint {
        text = format!("{text}, waypoint {k} of {n}");
        part = k.saturating_sub(1) as f32 / n.max(1) as f32;
    }
    let share = (routine.legs_done as f32 + part) / routine.legs.max(1) as f32;
    (text, share.clamp(0.0, 1.0))
}

/// Time until the end of a path under way at its speed, s; `None` off a path.
fn left_s(leg: &Leg, routine: &RoutineStatus) -> Option<f64> {
    let (Leg::Follow(follow), Some((k, n))) = (leg, routine.waypoint) else {
        return None;
    };
    let lap = Track {
        waypoints_m: follow.path.waypoints_m.clone(),
        closed: true,
    };
    let whole_s = lap.length_m() * f64::from(follow.laps) / follow.speed_m_s;
    Some(whole_s * n.saturating_sub(k) as f64 / n.max(1) as f64)
}

/// A leg in words.
fn leg_text(leg: &Leg) -> String {
    match leg {
        Leg::Move(goal) => {
            let [x, y, z] = goal.position_m.map(|v| number(v * 1e3, 1));
            format!("Going to {x}, {y}, {z} mm.")
        }
        Leg::Follow(follow) => {
            let speed = number(follow.speed_m_s * 1e3, 1);
            format!("Following the {} at {speed} mm/s.", follow.path.name)
        }
        Leg::Grip {
            gripper: Gripper::Closed,
            payload_kg,
        } => format!("Closing the gripper on {} g.", number(payload_kg * 1e3, 0)),
        Leg::Grip { .. } => "Opening the gripper.".into(),
        Leg::Excite(programme) => {
            let seconds = number(programme.seconds, 0);
            format!("Excitation '{}' for {seconds} s.", programme.name)
        }
    }
}

#[cfg(test)]
mod tests;
