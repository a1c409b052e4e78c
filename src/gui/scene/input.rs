//! What is shown in the 3D view, and what the pointer did there.

use super::camera::Controls;
use super::click::Landing;
use super::colours::Theme;
use super::entity::Entity;
use super::reachset::ReachSet;
use crate::signal::{ArmShape, Pose, ReachState, Snapshot};

/// Whether the pointer may set targets and select parts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Picking {
    /// It may.
    #[default]
    Enabled,
    /// It only moves the camera.
    Disabled,
}

/// What clicks and drags of the primary button do beside the handles.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Tool {
    /// A click sets the target, a drag turns the view.
    #[default]
    Target,
    /// A click sets a waypoint, a drag draws a row of them in the plane that faces the viewer.
    Draw,
}

/// Waypoints of a plan.
#[derive(Clone, Copy, Debug)]
pub struct PlanMarks<'a> {
    /// In order, m.
    pub waypoints_m: &'a [[f64; 3]],
    /// Whether the last leads back to the first.
    pub closed: bool,
    /// The selected one.
    pub selected: Option<usize>,
    /// The one travelled to.
    pub next: Option<usize>,
    /// Where the tip was on the way, oldest first, m.
    pub driven: &'a [[f32; 3]],
}

/// What helps to judge depth and reach, and can be switched off.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Aids {
    /// Outlines of the reachable set.
    pub hull: bool,
    /// Shadows on two walls behind the arm.
    pub walls: bool,
}

/// What is shown.
#[derive(Clone, Copy)]
pub struct SceneInput<'a> {
    /// The instant.
    pub snapshot: &'a Snapshot,
    /// Past tip positions by the estimate, oldest first, m.
    pub trail_predicted: &'a [[f32; 3]],
    /// Past tip positions by motion capture, oldest first, m.
    pub trail_truth: &'a [[f32; 3]],
    /// Background.
    pub theme: Theme,
    /// Whether the pointer may set targets.
    pub picking: Picking,
    /// The spring to highlight, from 0.
    pub selected_spring: Option<usize>,
    /// The target being edited, m. Without it the preview's goal is shown.
    pub draft_target: Option<[f64; 3]>,
    /// Verdict on the draft, if there is one.
    pub reach: Option<ReachState>,
    /// Whole shape to show as a ghost, for instance of the previewed pose.
    pub ghost: Option<&'a ArmShape>,
    /// Shape of a model that is tried beside the drawn one, with the name of its patch: a second ghost.
    pub tried: Option<(&'a ArmShape, &'a str)>,
    /// The arm as its sensors measure it, shown as a ghost while no model is tried.
    pub measured: Option<&'a ArmShape>,
    /// The end pad as motion capture has it, shown as a ghost; base from tip.
    pub captured: Option<&'a Pose>,
    /// The reachable set, which helps to choose how deep a click goes.
    pub reachable: Option<&'a ReachSet>,
    /// The set's outlines, as short lines, m.
    pub outlines: &'a [[[f32; 3]; 2]],
    /// What is switched on.
    pub aids: Aids,
    /// Waypoints to show.
    pub plan: Option<PlanMarks<'a>>,
    /// What the primary button does.
    pub tool: Tool,
    /// What moves with the translate handles, m; with [`Tool::Target`] the draft, if nothing else is named.
    pub handles: Option<[f64; 3]>,
    /// The plane through here that faces the viewer gives a click its depth; without it that of the tip.
    pub depth_from: Option<[f64; 3]>,
    /// Which button turns and which one shifts the view.
    pub controls: Controls,
}

impl<'a> SceneInput<'a> {
    /// The snapshot alone, on a dark background.
    pub fn new(snapshot: &'a Snapshot) -> Self {
        Self {
            snapshot,
            trail_predicted: &[],
            trail_truth: &[],
            theme: Theme::Dark,
            picking: Picking::Enabled,
            selected_spring: None,
            draft_target: None,
            reach: None,
            ghost: None,
            tried: None,
            measured: None,
            captured: None,
            reachable: None,
            outlines: &[],
            aids: Aids::default(),
            plan: None,
            tool: Tool::Target,
            handles: None,
            depth_from: None,
            controls: Controls::default(),
        }
    }

    /// The target that is shown, with the verdict that belongs to it.
    pub(super) fn target(&self) -> Option<([f64; 3], Option<ReachState>)> {
        let preview = self.snapshot.preview.as_ref();
        match (self.draft_target, preview) {
            (Some(draft), _) => Some((draft, self.reach)),
            (None, Some((goal, reach))) => Some((goal.position_m, Some(reach.state))),
            (None, None) => None,
        }
    }

    /// What moves with the handles.
    pub(super) fn held(&self) -> Option<[f64; 3]> {
        match self.tool {
            Tool::Target => self.handles.or(self.draft_target),
            Tool::Draw => self.handles,
        }
    }
}

/// What the pointer did.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SceneOutput {
    /// A click on a place, see [`click`](super::click). As it was when the button went down. m.
    pub clicked_target: Option<[f64; 3]>,
    /// A click on a part. A click on a sensor gives no target.
    pub clicked: Option<Entity>,
    /// What is under the pointer.
    pub hovered: Option<Entity>,
    /// What the handles hold, moved by them or by Alt + wheel, m.
    pub dragged_target: Option<[f64; 3]>,
    /// With [`Tool::Draw`], a place that a drag passes over, m.
    pub drawn: Option<[f64; 3]>,
    /// Where a click would go now.
    pub landing: Option<Landing>,
}
