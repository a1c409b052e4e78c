//! The Operate screen: panels that can be docked, with a layout that is kept.

use egui::{ScrollArea, Ui, WidgetText};
use egui_tiles::{
    Behavior, Container, Linear, LinearDir, SimplificationOptions, TileId, Tiles, Tree, UiResponse,
};
use serde::{Deserialize, Serialize};

use super::plot::TimeWindow;
use super::strips::StripChoice;
use super::target::TargetDraft;
use super::view3d::{View3d, scene_view};
use super::{View, chambers, dashboard, pose, simulator, strips, target};
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
}

const PANES: [Pane; 6] = [
    Pane::View3d,
    Pane::Target,
    Pane::Chambers,
    Pane::Pose,
    Pane::Sensors,
    Pane::Strips,
];

/// The layout of a first start.
pub fn default_layout() -> Tree<Pane> {
    let mut tiles = Tiles::default();
    let [view, target, chambers, pose, sensors, strips] = PANES.map(|p| {
        let pane = tiles.insert_pane(p);
        tiles.insert_tab_tile(vec![pane])
    });
    let mut split = |dir: LinearDir, parts: &[(TileId, f32)]| {
        let mut linear = Linear::new(dir, parts.iter().map(|p| p.0).collect());
        for &(tile, share) in parts {
            linear.shares.set_share(tile, share);
        }
        tiles.insert_container(Container::Linear(linear))
    };
    let left = split(LinearDir::Vertical, &[(view, 0.64), (strips, 0.36)]);
    let middle = split(LinearDir::Vertical, &[(target, 0.655), (chambers, 0.345)]);
    let right = split(LinearDir::Vertical, &[(pose, 0.46), (sensors, 0.54)]);
    let root = split(
        LinearDir::Horizontal,
        &[(left, 0.50), (middle, 0.23), (right, 0.27)],
    );
    Tree::new(egui::Id::unique("operate"), root, tiles)
}

/// Whether a kept layout has every panel exactly once.
pub fn is_complete(tree: &Tree<Pane>) -> bool {
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
    /// The target being typed.
    pub draft: TargetDraft,
    /// What the strips show.
    pub strips: StripChoice,
    /// The 3D view.
    pub view3d: View3d,
}

impl Default for OperateState {
    fn default() -> Self {
        Self {
            tree: default_layout(),
            draft: TargetDraft::default(),
            strips: StripChoice::default(),
            view3d: View3d::default(),
        }
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
    let mut panes = Panes {
        view,
        draft: &mut state.draft,
        strips: &mut state.strips,
        view3d: &mut state.view3d,
        window,
        commands,
    };
    state.tree.ui(&mut panes, ui);
}

struct Panes<'a, 'v> {
    view: &'a View<'v>,
    draft: &'a mut TargetDraft,
    strips: &'a mut StripChoice,
    view3d: &'a mut View3d,
    window: &'a mut TimeWindow,
    commands: &'a mut Vec<Command>,
}

impl Behavior<Pane> for Panes<'_, '_> {
    fn pane_ui(&mut self, ui: &mut Ui, _tile: TileId, pane: &mut Pane) -> UiResponse {
        let p = Palette::in_ui(ui);
        let margin = match pane {
            Pane::View3d => 0,
            Pane::Strips => 8,
            _ => 10,
        };
        let frame = egui::Frame::new().fill(p.panel).inner_margin(margin);
        frame.show(ui, |ui| {
            ui.set_min_size(ui.available_size());
            match pane {
                Pane::View3d => {
                    ui.spacing_mut().item_spacing.y = 0.0;
                    simulator::ui(ui, self.view, self.commands);
                    let draft_m = self.draft.parse().ok();
                    let out = scene_view(self.view3d, ui, self.view, draft_m);
                    if let (Some(target_m), None) = (out.clicked_target, self.view.replay) {
                        self.draft.set(target_m, self.commands);
                    }
                }
                Pane::Strips => strips::ui(ui, self.view, self.strips, self.window),
                Pane::Target => scroll(ui, |ui| {
                    target::ui(ui, self.view, self.draft, self.commands);
                }),
                Pane::Chambers => scroll(ui, |ui| chambers::ui(ui, self.view)),
                Pane::Pose => scroll(ui, |ui| pose::ui(ui, self.view)),
                Pane::Sensors => scroll(ui, |ui| dashboard::ui(ui, self.view)),
            }
        });
        UiResponse::None
    }

    fn tab_title_for_pane(&mut self, pane: &Pane) -> WidgetText {
        match pane {
            Pane::View3d => "3D view",
            Pane::Target => "Target",
            Pane::Chambers => "Chambers",
            Pane::Pose => "Tip pose",
            Pane::Sensors => "Springs and IMUs",
            Pane::Strips => "Signals",
        }
        .into()
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

fn scroll(ui: &mut Ui, contents: impl FnOnce(&mut Ui)) {
    ScrollArea::vertical().auto_shrink(false).show(ui, contents);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn default_layout_has_every_panel_and_survives_storage() {
        let tree = default_layout();
        assert!(is_complete(&tree));
        let text = serde_json::to_string(&tree).expect("serialises");
        let back: Tree<Pane> = serde_json::from_str(&text).expect("reads back");
        assert!(is_complete(&back));
        assert!(!is_complete(&Tree::empty(egui::Id::unique("x"))));
    }
}
