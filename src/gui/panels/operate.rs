//! The Operate screen: panels that can be docked, with a layout that is kept.

use egui::{ScrollArea, Ui, WidgetText};
use egui_tiles::{
    Behavior, Container, EditAction, Linear, LinearDir, SimplificationOptions, TileId, Tiles, Tree,
    UiResponse,
};
use serde::{Deserialize, Serialize};

use super::plans::{self, PlanState};
use super::plot::TimeWindow;
use super::strips::StripsState;
use super::target::TargetDraft;
use super::view3d::{self, Edited, View3d, View3dOutput, scene_view};
use super::widgets::note;
use super::{View, chambers, dashboard, pose, strips, target};
use crate::gui::scene::overlay::Stage;
use crate::gui::scene::{PlanMarks, Tool};
use crate::gui::theme::Palette;
use crate::twin::Command;

/// A panel of the screen.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Pane {
    /// The arm in space.
    View3d,
    /// Where the tip shall go.
    Target,
    /// Pressures.
    Chambers,
    /// Predicted pose and motion capture.
    Pose,
    /// Springs and IMUs.
    Sensors,
    /// Signals over time.
    Strips,
    /// Circle, figure 8, pick and place, points.
    Plan,
}

impl Pane {
    /// Name on its tab.
    pub fn title(self) -> &'static str {
        match self {
            Self::View3d => "3D view",
            Self::Target => "Target",
            Self::Chambers => "Chambers",
            Self::Pose => "Tip pose",
            Self::Sensors => "Springs and IMUs",
            Self::Strips => "Signals",
            Self::Plan => "Plan",
        }
    }
}

/// All panels.
pub const PANES: [Pane; 7] = [
    Pane::View3d,
    Pane::Target,
    Pane::Chambers,
    Pane::Pose,
    Pane::Sensors,
    Pane::Strips,
    Pane::Plan,
];

/// How the panels are arranged until the operator arranges them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Form {
    /// The view above the signals, and one column with the readings behind tabs.
    Two,
    /// The view, what moves the arm above the signals, and all readings at once.
    Three,
}

impl Form {
    /// The form for so much width, points.
    pub fn of(width: f32) -> Self {
        match width < THREE_COLUMNS {
            true => Self::Two,
            false => Self::Three,
        }
    }

    /// Its layout.
    pub fn layout(self) -> Tree<Pane> {
        let mut tiles = Tiles::default();
        let mut tabs = |panes: &[Pane]| {
            let panes = panes.iter().map(|p| tiles.insert_pane(*p)).collect();
            tiles.insert_tab_tile(panes)
        };
        let (view, strips) = (tabs(&[Pane::View3d]), tabs(&[Pane::Strips]));
        let moves = tabs(&[Pane::Target, Pane::Plan]);
        let readings: Vec<TileId> = match self {
            Self::Two => vec![tabs(&[Pane::Sensors, Pane::Chambers, Pane::Pose])],
            Self::Three => [Pane::Chambers, Pane::Pose, Pane::Sensors]
                .map(|p| tabs(&[p]))
                .into(),
        };
        let mut split = |dir: LinearDir, parts: &[(TileId, f32)]| {
            let mut linear = Linear::new(dir, parts.iter().map(|p| p.0).collect());
            for &(tile, share) in parts {
                linear.shares.set_share(tile, share);
            }
            tiles.insert_container(Container::Linear(linear))
        };
        let columns = match readings.as_slice() {
            [chambers, pose, sensors] => {
                let middle = split(LinearDir::Vertical, &[(moves, 0.34), (strips, 0.66)]);
                let right = [(*pose, 0.25), (*chambers, 0.22), (*sensors, 0.53)];
                let right = split(LinearDir::Vertical, &right);
                vec![(view, 0.50), (middle, 0.28), (right, 0.22)]
            }
            all => {
                let left = split(LinearDir::Vertical, &[(view, 0.66), (strips, 0.34)]);
                let mut column = vec![(moves, 0.51)];
                column.extend(all.iter().map(|tile| (*tile, 0.49)));
                let right = split(LinearDir::Vertical, &column);
                vec![(left, 0.61), (right, 0.39)]
            }
        };
        let root = split(LinearDir::Horizontal, &columns);
        Tree::new(egui::Id::unique("operate"), root, tiles)
    }
}

/// From this width on there are three columns, points.
const THREE_COLUMNS: f32 = 1500.0;

/// Whether a kept layout has every panel exactly once.
fn is_complete(tree: &Tree<Pane>) -> bool {
    let mut found: Vec<Pane> = Vec::new();
    for tile in tree.tiles.tiles() {
        if let egui_tiles::Tile::Pane(p) = tile {
            found.push(*p);
        }
    }
    found.len() == PANES.len() && PANES.iter().all(|p| found.contains(p)) && tree.root().is_some()
}

/// What the screen keeps.
pub struct OperateState {
    /// Where the panels are.
    pub tree: Tree<Pane>,
    /// How they are arranged; `None` once the operator has arranged them.
    pub form: Option<Form>,
    /// The target being typed.
    pub draft: TargetDraft,
    /// What the strips show.
    pub strips: StripsState,
    /// The 3D view.
    pub view3d: View3d,
    /// The plan being made.
    pub plans: PlanState,
}

impl Default for OperateState {
    fn default() -> Self {
        Self {
            tree: Form::Two.layout(),
            form: Some(Form::Two),
            draft: TargetDraft::default(),
            strips: StripsState::default(),
            view3d: View3d::default(),
            plans: PlanState::default(),
        }
    }
}

impl OperateState {
    /// Arranges the panels by the width of the window from now on.
    pub fn reset_layout(&mut self) {
        (self.tree, self.form) = (Form::Two.layout(), Some(Form::Two));
    }

    /// Takes the layout that the operator made, if it has every panel.
    pub fn take_layout(&mut self, tree: Tree<Pane>) {
        if is_complete(&tree) {
            (self.tree, self.form) = (tree, None);
        }
    }

    /// Brings a panel to the front.
    pub fn show(&mut self, wanted: Pane) {
        self.tree.make_active(|_, tile| match tile {
            egui_tiles::Tile::Pane(pane) => *pane == wanted,
            egui_tiles::Tile::Container(_) => false,
        });
    }
}

/// The screen.
pub fn ui(
    ui: &mut Ui,
    view: &View<'_>,
    state: &mut OperateState,
    window: &mut TimeWindow,
    commands: &mut Vec<Command>,
) {
    let form = Form::of(ui.available_width());
    if state.form.is_some_and(|now| now != form) {
        (state.tree, state.form) = (form.layout(), Some(form));
    }
    let mut panes = Panes {
        arranged: false,
        view,
        draft: &mut state.draft,
        strips: &mut state.strips,
        view3d: &mut state.view3d,
        plans: &mut state.plans,
        plan_shown: false,
        window,
        commands,
    };
    state.tree.ui(&mut panes, ui);
    let (plan_shown, arranged) = (panes.plan_shown, panes.arranged);
    state.plans.shown = plan_shown;
    if arranged {
        state.form = None;
    }
}

struct Panes<'a, 'v> {
    /// Whether the operator moved or resized a panel in this frame.
    arranged: bool,
    view: &'a View<'v>,
    draft: &'a mut TargetDraft,
    strips: &'a mut StripsState,
    view3d: &'a mut View3d,
    plans: &'a mut PlanState,
    /// Whether the plan's panel is on screen in this frame.
    plan_shown: bool,
    window: &'a mut TimeWindow,
    commands: &'a mut Vec<Command>,
}

impl Panes<'_, '_> {
    fn view3d(&mut self, ui: &mut Ui) {
        ui.spacing_mut().item_spacing.y = 0.0;
        view3d::bar(ui, self.view3d, self.view, self.commands);
        // What the tip goes to is the goal: there is nothing to drag.
        let placed = self.view.replay.is_none();
        let target_m = self.draft.parse().ok();
        let target_m = target_m.filter(|t| !(placed && self.draft.course.is_settled(t)));
        let track = self.plans.track(self.view);
        let drawing = self.plans.is_drawing() && self.view.replay.is_none();
        let edited = Edited {
            target_m,
            reach: target_m
                .and_then(|_| target::preview_of(self.view, &self.draft.goal().ok()?))
                .map(|r| r.state),
            plan: track.as_ref().map(|track| PlanMarks {
                waypoints_m: &track.waypoints_m,
                closed: track.closed,
                selected: self.plans.selected_mark(),
                next: self.plans.next_mark(self.view, track),
                driven: self.plans.line_m(self.view, track),
            }),
            tool: if drawing { Tool::Draw } else { Tool::Target },
        };
        let rect = ui.available_rect_before_wrap();
        let out = scene_view(self.view3d, ui, self.view, &edited);
        if self.view.replay.is_none() {
            self.take(&out, drawing);
        }
        if !drawing && target::offers_first(self.view, self.draft) {
            self.first_move(ui, rect);
        }
    }

    /// A mark where a newcomer sends the arm first, in the picture.
    fn first_move(&mut self, ui: &Ui, rect: egui::Rect) {
        let Some(scene) = &self.view3d.scene else {
            return;
        };
        let stage = Stage {
            camera: &scene.camera,
            rect,
        };
        let at_m = target::first_m(self.view.spec).map(|v| v as f32);
        let Some(at) = stage.place(at_m.into()).filter(|at| rect.contains(*at)) else {
            return;
        };
        let p = Palette::in_ui(ui);
        let painter = ui.painter_at(rect);
        let stroke = egui::Stroke::new(2.5, p.ready);
        painter.circle_stroke(at, 11.0, stroke);
        painter.circle_filled(at, 3.0, p.ready);
        let end = at + egui::vec2(26.0, 22.0);
        painter.line_segment([at + egui::vec2(8.0, 7.0), end], stroke);
        painter.text(
            end + egui::vec2(4.0, 0.0),
            egui::Align2::LEFT_CENTER,
            "here",
            egui::TextStyle::Body.resolve(ui.style()),
            p.ready,
        );
    }

    /// Takes what was done in the 3D view.
    fn take(&mut self, out: &View3dOutput, drawing: bool) {
        if let Some(i) = out.waypoint {
            self.plans.select_mark(i);
        }
        match (drawing, out.dragged, out.clicked) {
            (false, Some(m), _) | (false, None, Some(m)) => self.draft.set(m, self.commands),
            (true, Some(m), _) => self.plans.move_selected(m),
            // A click on a waypoint selects it.
            (true, None, Some(m)) if out.waypoint.is_none() => self.plans.add(m),
            _ => {}
        }
        if let Some(m) = out.drawn {
            self.plans.draw_to(m);
        }
    }
}

impl Behavior<Pane> for Panes<'_, '_> {
    fn pane_ui(&mut self, ui: &mut Ui, _tile: TileId, pane: &mut Pane) -> UiResponse {
        let p = Palette::in_ui(ui);
        let margin = match pane {
            Pane::View3d => 0,
            Pane::Strips => 8,
            _ => 10,
        };
        let upright = margin.min(6);
        let margin = egui::Margin::symmetric(margin, upright);
        let frame = egui::Frame::new().fill(p.panel).inner_margin(margin);
        frame.show(ui, |ui| {
            ui.set_min_size(ui.available_size());
            if matches!(
                pane,
                Pane::View3d | Pane::Chambers | Pane::Pose | Pane::Sensors
            ) {
                self.view.grey_if_stale(ui);
            }
            if let (Pane::Plan | Pane::Target, Err(why)) = (&*pane, self.view.drivable()) {
                note(ui, why);
                return;
            }
            match pane {
                Pane::View3d => self.view3d(ui),
                Pane::Plan => {
                    self.plan_shown = true;
                    let target_m = self.draft.parse().ok();
                    plans::ui(ui, self.view, self.plans, target_m, self.commands);
                }
                Pane::Strips => scroll(ui, 240.0, |ui| {
                    strips::ui(ui, self.view, self.strips, self.window);
                }),
                Pane::Target => scroll(ui, 216.0, |ui| {
                    target::ui(ui, self.view, self.draft, self.commands);
                }),
                Pane::Chambers => scroll(ui, 190.0, |ui| chambers::ui(ui, self.view)),
                Pane::Pose => scroll(ui, 222.0, |ui| pose::ui(ui, self.view)),
                Pane::Sensors => scroll(ui, 216.0, |ui| dashboard::ui(ui, self.view)),
            }
        });
        UiResponse::None
    }

    fn on_edit(&mut self, action: EditAction) {
        // A tab that is brought to the front rearranges nothing.
        self.arranged |= matches!(action, EditAction::TileResized | EditAction::TileDropped);
    }

    fn tab_title_for_pane(&mut self, pane: &Pane) -> WidgetText {
        pane.title().into()
    }

    fn simplification_options(&self) -> SimplificationOptions {
        SimplificationOptions {
            all_panes_must_have_tabs: true,
            ..SimplificationOptions::default()
        }
    }

    fn tab_bar_height(&self, _style: &egui::Style) -> f32 {
        26.0
    }

    fn gap_width(&self, _style: &egui::Style) -> f32 {
        4.0
    }

    fn min_size(&self) -> f32 {
        120.0
    }
}

/// Contents that need a least width, points: downwards they are scrolled always, to the side in narrower panels.
fn scroll(ui: &mut Ui, least: f32, contents: impl FnOnce(&mut Ui)) {
    let narrow = ui.available_width() < least;
    ScrollArea::new([narrow, true])
        .auto_shrink(false)
        .show(ui, |ui| {
            if narrow {
                ui.set_max_width(least);
            }
            contents(ui);
        });
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn layouts_have_every_panel_and_survive_storage() {
        let tree = Form::Three.layout();
        assert!(is_complete(&Form::Two.layout()));
        assert!(is_complete(&tree));
        let text = serde_json::to_string(&tree).expect("serialises");
        let back: Tree<Pane> = serde_json::from_str(&text).expect("reads back");
        assert!(is_complete(&back));
        assert!(!is_complete(&Tree::empty(egui::Id::unique("x"))));
        // A layout that was kept before there was a panel for plans gives way to the first one.
        let mut old = Form::Two.layout();
        let is_plan = |tree: &Tree<Pane>| {
            let mut tiles = tree.tiles.iter();
            tiles.find_map(|(id, t)| matches!(t, egui_tiles::Tile::Pane(Pane::Plan)).then_some(*id))
        };
        let plan = is_plan(&old).expect("a panel for plans");
        old.tiles.remove(plan);
        assert!(!is_complete(&old));
    }
}
