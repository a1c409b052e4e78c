//! What is painted flat over the picture: axes and scale in the corners, labels, the translate handles.

use egui::{Align2, Color32, FontId, Pos2, Rect, Stroke, StrokeKind, vec2};
use glam::{Vec2, Vec3};

use super::camera::Camera;
use super::click::{DepthBy, Landing};
use super::colours::{Palette, Rgb, Theme, sequential};
use super::convert;
use super::input::{PlanMarks, SceneInput};
use crate::gui::panels::widgets::number;
use crate::robot::RobotSpec;
use crate::signal::{ArmShape, Matrix6, ReachState};

/// Length of a handle's arrow in points.
const HANDLE_PT: f32 = 62.0;
/// An error below this is never shown as abnormal, m.
const ERROR_MIN_M: f64 = 2e-3;
/// An error beyond so many standard deviations of the prediction is abnormal.
const SIGMAS: f64 = 3.0;
/// Half the size of the goal's mark with a margin, points.
const MARK_PT: f32 = 14.0;
/// How near the pointer must come to a handle, points.
const REACH_PT: f32 = 9.0;

/// A part of the translate handles.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Handle {
    /// Along x (0), y (1) or z (2).
    Axis(usize),
    /// In the plane that faces the viewer.
    Plane,
}

/// Where the picture is on the screen.
#[derive(Clone, Copy)]
pub struct Stage<'a> {
    /// The camera.
    pub camera: &'a Camera,
    /// The viewport.
    pub rect: Rect,
}

impl Stage<'_> {
    /// Size of the viewport, points.
    pub fn size_pt(&self) -> Vec2 {
        Vec2::new(self.rect.width(), self.rect.height())
    }

    /// Where a point in the base frame appears on the screen.
    pub fn place(&self, point_m: Vec3) -> Option<Pos2> {
        let at = self.camera.project(point_m, self.size_pt())?;
        Some(self.rect.min + vec2(at.x, at.y))
    }

    /// A place on the screen in points from the viewport's corner.
    pub fn local(&self, at: Pos2) -> Vec2 {
        let d = at - self.rect.min;
        Vec2::new(d.x, d.y)
    }
}

/// A scene colour for the painter.
pub fn colour(c: Rgb) -> Color32 {
    let [r, g, b] = c.map(|x| (x.clamp(0.0, 1.0) * 255.0).round() as u8);
    Color32::from_rgb(r, g, b)
}

/// Start and end of each visible arrow on the screen, by axis.
fn arrows(stage: &Stage<'_>, at_m: Vec3) -> Vec<(usize, Pos2, Pos2)> {
    let m = stage.camera.metres_per_point(at_m, stage.size_pt());
    let mut all = Vec::new();
    for (k, axis) in Vec3::AXES.into_iter().enumerate() {
        let from = stage.place(at_m + axis * (22.0 * m));
        let to = stage.place(at_m + axis * (HANDLE_PT * m));
        if let (Some(from), Some(to)) = (from, to) {
            // An axis that points at the viewer cannot be dragged.
            if from.distance(to) > 8.0 {
                all.push((k, from, to));
            }
        }
    }
    all
}

/// The handle under the pointer.
pub fn handle_at(stage: &Stage<'_>, draft_m: Vec3, pointer: Pos2) -> Option<Handle> {
    if stage.place(draft_m)?.distance(pointer) < 13.0 {
        return Some(Handle::Plane);
    }
    arrows(stage, draft_m)
        .into_iter()
        .map(|(k, from, to)| {
            let span = to - from;
            let t = ((pointer - from).dot(span) / span.length_sq()).clamp(0.0, 1.1);
            (k, (from + span * t).distance(pointer))
        })
        .filter(|(_, distance)| *distance < REACH_PT)
        .min_by(|a, b| a.1.total_cmp(&b.1))
        .map(|(k, _)| Handle::Axis(k))
}

/// Draws the handles.
pub fn paint_handles(
    painter: &egui::Painter,
    stage: &Stage<'_>,
    palette: &Palette,
    draft_m: Vec3,
    active: Option<Handle>,
) {
    for (k, from, to) in arrows(stage, draft_m) {
        let bold = active == Some(Handle::Axis(k));
        let c = colour(palette.axis(k));
        let dir = (to - from).normalized();
        let side = dir.rot90();
        let width = if bold { 4.0 } else { 2.4 };
        painter.line_segment([from, to - dir * 8.0], Stroke::new(width, c));
        let head = if bold { 6.5 } else { 5.0 };
        painter.add(egui::Shape::convex_polygon(
            vec![
                to + dir * 4.0,
                to - dir * 8.0 + side * head,
                to - dir * 8.0 - side * head,
            ],
            c,
            Stroke::NONE,
        ));
        let name = ["x", "y", "z"][k];
        painter.text(
            to + dir * 13.0,
            Align2::CENTER_CENTER,
            name,
            FontId::proportional(12.0),
            c,
        );
    }
    if active == Some(Handle::Plane)
        && let Some(at) = stage.place(draft_m)
    {
        painter.circle_filled(at, 12.0, colour(palette.ink).gamma_multiply(0.25));
    }
}

/// Orientation of the base axes, bottom left.
pub fn paint_triad(painter: &egui::Painter, stage: &Stage<'_>, palette: &Palette) {
    const ARM_PT: f32 = 26.0;
    let centre = stage.rect.left_bottom() + vec2(44.0, -44.0);
    let mut axes: Vec<(f32, usize, egui::Vec2)> = Vec3::AXES
        .into_iter()
        .enumerate()
        .map(|(k, axis)| {
            let to = vec2(axis.dot(stage.camera.right()), -axis.dot(stage.camera.up()));
            (axis.dot(stage.camera.forward()), k, to * ARM_PT)
        })
        .collect();
    // Far ones first.
    axes.sort_by(|a, b| b.0.total_cmp(&a.0));
    for (_, k, to) in axes {
        let c = colour(palette.axis(k));
        painter.line_segment([centre, centre + to], Stroke::new(2.2, c));
        // A label on top of the centre would be unreadable.
        let out = to * (1.0 + 10.0 / to.length().max(8.0));
        let name = ["x", "y", "z"][k];
        painter.text(
            centre + out,
            Align2::CENTER_CENTER,
            name,
            FontId::proportional(12.5),
            c,
        );
    }
    painter.circle_filled(centre, 2.5, colour(palette.ink));
}

/// The longest of 1, 2 or 5 times a power of ten millimetres that fits.
fn scale_mm(metres_per_point: f32, most_pt: f32) -> f32 {
    let most_mm = (metres_per_point * most_pt * 1e3).max(1e-3);
    let decade = 10_f32.powf(most_mm.log10().floor());
    [5.0, 2.0, 1.0]
        .map(|f| f * decade)
        .into_iter()
        .find(|mm| *mm <= most_mm)
        .unwrap_or(decade)
}

/// Scale bar, bottom right, and the springs' colours, top right.
pub fn paint_scale(
    painter: &egui::Painter,
    stage: &Stage<'_>,
    palette: &Palette,
    robot: &RobotSpec,
    theme: Theme,
) {
    let ink = colour(palette.ink);
    let font = FontId::proportional(11.5);
    let right = stage.rect.right_bottom() + vec2(-22.0, -22.0);
    let m = stage
        .camera
        .metres_per_point(stage.camera.target_m, stage.size_pt());
    let mm = scale_mm(m, 120.0);
    let left = right - vec2(mm * 1e-3 / m, 0.0);
    let stroke = Stroke::new(1.6, ink);
    painter.line_segment([left, right], stroke);
    for end in [left, right] {
        painter.line_segment([end - vec2(0.0, 4.0), end + vec2(0.0, 4.0)], stroke);
    }
    let middle = left.lerp(right, 0.5) - vec2(0.0, 4.0);
    painter.text(
        middle,
        Align2::CENTER_BOTTOM,
        format!("{mm} mm"),
        font.clone(),
        ink,
    );

    if !robot.has_springs {
        return;
    }
    // The top corner: the tip and its labels live further down.
    let corner = stage.rect.right_top() + vec2(-22.0 - 190.0, 26.0);
    let bar = Rect::from_min_size(corner, vec2(190.0, 7.0));
    // The ceiling plate may lie behind it.
    let behind = Rect::from_min_max(bar.min - vec2(8.0, 19.0), bar.max + vec2(8.0, 7.0));
    painter.rect_filled(behind, 4.0, plate(theme));
    let mut mesh = egui::Mesh::default();
    const STEPS: u32 = 24;
    for k in 0..=STEPS {
        let t = k as f32 / STEPS as f32;
        let x = bar.left() + t * bar.width();
        for y in [bar.top(), bar.bottom()] {
            mesh.colored_vertex(Pos2::new(x, y), colour(sequential(t)));
        }
        if k < STEPS {
            let i = 2 * k;
            mesh.add_triangle(i, i + 1, i + 2);
            mesh.add_triangle(i + 1, i + 3, i + 2);
        }
    }
    painter.add(mesh);
    painter.rect_stroke(
        bar,
        0.0,
        Stroke::new(1.0, ink.gamma_multiply(0.4)),
        StrokeKind::Outside,
    );
    let [lo, hi] = robot.spring.range_m.map(|x| x * 1e3);
    let above = bar.top() - 3.0;
    for (x, align, text) in [
        (bar.left(), Align2::LEFT_BOTTOM, format!("{lo:.0}")),
        (
            bar.center().x,
            Align2::CENTER_BOTTOM,
            "spring length".to_owned(),
        ),
        (bar.right(), Align2::RIGHT_BOTTOM, format!("{hi:.0} mm")),
    ] {
        painter.text(Pos2::new(x, above), align, text, font.clone(), ink);
    }
}

/// What keeps text readable over anything.
fn plate(theme: Theme) -> Color32 {
    match theme {
        Theme::Dark => Color32::from_rgba_unmultiplied(20, 22, 25, 205),
        Theme::Light => Color32::from_rgba_unmultiplied(252, 252, 252, 215),
    }
}

/// How far to move a tag so that all of it is seen, as long as the place it names is.
fn into_view(tag: Rect, at: Pos2, view: Rect) -> egui::Vec2 {
    if !view.expand(40.0).contains(at) {
        return egui::Vec2::ZERO;
    }
    let room = view.shrink(4.0);
    let inwards = |low: f32, high: f32, from: f32, to: f32| (to - high).min(0.0).max(from - low);
    vec2(
        inwards(tag.left(), tag.right(), room.left(), room.right()),
        inwards(tag.top(), tag.bottom(), room.top(), room.bottom()),
    )
}

/// Text on a plate that keeps it readable over anything; gives where the plate is.
pub fn paint_tag(
    painter: &egui::Painter,
    at: Pos2,
    align: Align2,
    text: &str,
    c: Color32,
    theme: Theme,
) -> Rect {
    let galley = painter.layout_no_wrap(text.to_owned(), FontId::proportional(12.0), c);
    let rect = align.anchor_size(at, galley.size()).expand2(vec2(6.0, 3.0));
    let rect = rect.translate(into_view(rect, at, painter.clip_rect()));
    painter.rect_filled(rect, 4.0, plate(theme));
    painter.galley(rect.min + vec2(6.0, 3.0), galley, c);
    rect
}

/// Where a tag of `size` beside `at` covers none of `taken`: a corner around it, or the one that covers least.
fn free_corner(at: Pos2, size: egui::Vec2, taken: &[Rect]) -> (Pos2, Align2) {
    let corners = [
        (vec2(-26.0, 26.0), Align2::RIGHT_TOP),
        (vec2(-26.0, -26.0), Align2::RIGHT_BOTTOM),
        (vec2(26.0, -26.0), Align2::LEFT_BOTTOM),
        (vec2(26.0, 26.0), Align2::LEFT_TOP),
        // Beyond handles that lie around the tip itself.
        (vec2(-HANDLE_PT - 20.0, 0.0), Align2::RIGHT_CENTER),
        (vec2(HANDLE_PT + 20.0, 0.0), Align2::LEFT_CENTER),
        (vec2(0.0, HANDLE_PT + 20.0), Align2::CENTER_TOP),
        (vec2(0.0, -HANDLE_PT - 20.0), Align2::CENTER_BOTTOM),
    ];
    let covered = |(offset, align): &(egui::Vec2, Align2)| {
        let tag = align
            .anchor_size(at + *offset, size)
            .expand2(vec2(6.0, 3.0));
        let areas = taken.iter().map(|r| tag.intersect(*r));
        areas
            .filter(|r| r.is_positive())
            .map(|r| r.area())
            .sum::<f32>()
    };
    let best = corners
        .iter()
        .min_by(|a, b| covered(a).total_cmp(&covered(b)));
    let (offset, align) = best.copied().unwrap_or(corners[0]);
    (at + offset, align)
}

/// Whether prediction and measurement are further apart than the prediction's own uncertainty accounts for.
fn is_abnormal(error_m: f64, covariance: &Matrix6) -> bool {
    let variance_m2: f64 = (0..3).map(|i| covariance[(i, i)]).sum();
    error_m > ERROR_MIN_M && error_m.powi(2) > SIGMAS.powi(2) * variance_m2
}

/// What a verdict is called.
pub fn reach_name(state: ReachState) -> &'static str {
    match state {
        ReachState::Reachable => "reachable",
        ReachState::Marginal => "marginal",
        ReachState::Unreachable => "unreachable",
        ReachState::OutsideData => "outside data",
    }
}

/// A glyph that stands for a verdict.
pub fn reach_glyph(state: ReachState) -> &'static str {
    match state {
        ReachState::Reachable => "●",
        ReachState::Marginal => "▲",
        ReachState::Unreachable => "⊗",
        ReachState::OutsideData => "?",
    }
}

/// Where a click would go, and why there.
pub fn landing_text(landing: &Landing) -> String {
    let [x, y, z] = convert::array(landing.at_m).map(|v| number(v * 1e3, 1));
    let why = match landing.by {
        DepthBy::Part => "at the depth of this part",
        DepthBy::Plane => "at the tip's depth",
        DepthBy::Clamped => "at the nearest reachable depth",
        DepthBy::Missed => "nothing reachable under the pointer",
    };
    format!("{x}  {y}  {z} mm\n{why}")
}

/// Names of waypoints: all of them where they are few, else first and selected.
pub fn paint_waypoints(
    painter: &egui::Painter,
    stage: &Stage<'_>,
    palette: &Palette,
    plan: &PlanMarks<'_>,
    theme: Theme,
) {
    const MANY: usize = 12;
    for (i, at_m) in plan.waypoints_m.iter().enumerate() {
        let named = plan.waypoints_m.len() <= MANY || i == 0 || plan.selected == Some(i);
        let Some(at) = stage.place(convert::vec3(*at_m)).filter(|_| named) else {
            continue;
        };
        let (at, c) = (at + vec2(0.0, -8.0), colour(palette.ink));
        paint_tag(
            painter,
            at,
            Align2::CENTER_BOTTOM,
            &(i + 1).to_string(),
            c,
            theme,
        );
    }
}

/// What is drawn of a model that is tried: name of its patch, and how far its tip is from the drawn one.
pub fn tried_text(shape: &ArmShape, name: &str, drawn: Option<&ArmShape>) -> String {
    let tip = |s: &ArmShape| s.base_from_pad[2].translation.vector;
    let apart = drawn.map_or(String::new(), |drawn| {
        let mm = (tip(shape) - tip(drawn)).norm() * 1e3;
        format!("\ntip {} mm from the twin's model", number(mm, 1))
    });
    format!("◌ tried: {name}{apart}")
}

/// Label of the model that is tried, beside its middle pad.
pub fn paint_tried(
    painter: &egui::Painter,
    stage: &Stage<'_>,
    palette: &Palette,
    input: &SceneInput<'_>,
) {
    const BESIDE_PT: f32 = 96.0;
    let Some((shape, name)) = input.tried else {
        return;
    };
    let Some(at) = stage.place(convert::parts(&shape.base_from_pad[1]).0) else {
        return;
    };
    let text = tried_text(shape, name, input.snapshot.shown_shape());
    let from = at - vec2(BESIDE_PT, 0.0);
    let ink = colour(palette.ink);
    let tag = paint_tag(painter, from, Align2::RIGHT_CENTER, &text, ink, input.theme);
    let stroke = Stroke::new(1.5, colour(palette.tried));
    painter.line_segment([tag.right_center(), at], stroke);
    painter.rect_stroke(tag, 4.0, stroke, StrokeKind::Outside);
}

/// Labels of the draft target and of the error between prediction and measurement.
pub fn paint_labels(
    painter: &egui::Painter,
    stage: &Stage<'_>,
    palette: &Palette,
    input: &SceneInput<'_>,
) {
    let snapshot = input.snapshot;
    // What the label of the error must leave free.
    let mut taken = Vec::new();
    if let Some((draft, state)) = input.target()
        && let Some(at) = stage.place(convert::vec3(draft))
    {
        let [x, y, z] = draft.map(|v| number(v * 1e3, 1));
        let numbers = format!("{x}  {y}  {z} mm");
        let text = match state {
            Some(state) => format!("{} {}   {numbers}", reach_glyph(state), reach_name(state)),
            None => format!("not checked   {numbers}"),
        };
        let c = colour(palette.reach(state));
        let tag = paint_tag(
            painter,
            at + vec2(30.0, 30.0),
            Align2::LEFT_TOP,
            &text,
            c,
            input.theme,
        );
        taken.push(tag);
        taken.push(Rect::from_center_size(at, vec2(2.0, 2.0) * HANDLE_PT));
    } else if let Some(goal) = &snapshot.goal
        && let Some(at) = stage.place(convert::vec3(goal.position_m))
    {
        let c = colour(palette.goal);
        let tag = paint_tag(
            painter,
            at + vec2(26.0, 0.0),
            Align2::LEFT_CENTER,
            "goal",
            c,
            input.theme,
        );
        taken.push(tag);
        taken.push(Rect::from_center_size(at, vec2(2.0, 2.0) * MARK_PT));
    }
    // A film has the error of the same instant below the view.
    if let (Some(estimate), Some(truth)) = (&snapshot.estimate, snapshot.fresh_truth())
        && input.captured.is_none()
    {
        let error_m = crate::signal::pose_error(&estimate.base_from_tip, &truth.base_from_tip)
            .fixed_rows::<3>(0)
            .norm();
        let (a, _) = convert::parts(&estimate.base_from_tip);
        if let Some(at) = stage.place(a) {
            let text = format!("error {} mm", number(error_m * 1e3, 1));
            let c = colour(match is_abnormal(error_m, &estimate.covariance) {
                true => palette.error,
                false => palette.ink,
            });
            let font = FontId::proportional(12.0);
            let size = painter.layout_no_wrap(text.clone(), font, c).size();
            let (at, align) = free_corner(at, size, &taken);
            paint_tag(painter, at, align, &text, c, input.theme);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scale_bars_are_round_and_fit() {
        for (m_per_pt, mm) in [
            (1e-3, 100.0),
            (0.5e-3, 50.0),
            (1.8e-3, 200.0),
            (5e-3, 500.0),
        ] {
            assert_eq!(scale_mm(m_per_pt, 120.0), mm);
        }
    }

    #[test]
    fn a_tag_at_the_rim_is_moved_into_the_view() {
        let view = Rect::from_min_size(Pos2::ZERO, vec2(500.0, 300.0));
        let tag = |x: f32, y: f32| Rect::from_min_size(Pos2::new(x, y), vec2(100.0, 20.0));
        let moved = |x, y| into_view(tag(x, y), Pos2::new(x, y), view);
        assert_eq!(moved(200.0, 100.0), egui::Vec2::ZERO);
        assert_eq!(moved(450.0, 290.0), vec2(-54.0, -14.0));
        assert_eq!(moved(-30.0, -10.0), vec2(34.0, 14.0));
        // What it names is out of sight: it stays with it.
        assert_eq!(moved(700.0, 100.0), egui::Vec2::ZERO);
    }

    #[test]
    fn the_label_of_the_error_leaves_the_target_free() {
        let (tip, size) = (Pos2::new(300.0, 200.0), vec2(80.0, 14.0));
        let covers = |taken: &[Rect]| {
            let (at, align) = free_corner(tip, size, taken);
            let tag = align.anchor_size(at, size).expand2(vec2(6.0, 3.0));
            taken.iter().any(|r| tag.intersects(*r))
        };
        for angle in 0..36 {
            let (y, x) = (10.0 * angle as f32).to_radians().sin_cos();
            for distance in [0.0, 20.0, 40.0, 60.0, 120.0] {
                let target = tip + distance * vec2(x, y);
                let handles = Rect::from_center_size(target, vec2(2.0, 2.0) * HANDLE_PT);
                let tag = Rect::from_min_size(target + vec2(24.0, 27.0), vec2(170.0, 20.0));
                assert!(
                    !covers(&[handles, tag]),
                    "target {distance} pt away at {angle}0 deg"
                );
            }
        }
    }

    #[test]
    fn an_error_is_abnormal_beyond_the_predictions_own_doubt_and_two_millimetres() {
        let sigma_m = |s: f64| Matrix6::identity() * (s * s / 3.0);
        assert!(!is_abnormal(0.3e-3, &sigma_m(0.05e-3)));
        assert!(!is_abnormal(5e-3, &sigma_m(2e-3)));
        assert!(is_abnormal(5e-3, &sigma_m(0.7e-3)));
    }

    #[test]
    fn handles_are_found_where_they_are_drawn() {
        let camera = Camera::framing(Vec3::new(0.0, 0.0, -0.25), 0.3);
        let rect = Rect::from_min_size(Pos2::new(200.0, 40.0), vec2(800.0, 600.0));
        let stage = Stage {
            camera: &camera,
            rect,
        };
        let draft = Vec3::new(0.05, 0.02, -0.3);
        let at = stage.place(draft).expect("in view");
        assert_eq!(handle_at(&stage, draft, at), Some(Handle::Plane));
        for (k, from, to) in arrows(&stage, draft) {
            assert_eq!(
                handle_at(&stage, draft, from.lerp(to, 0.8)),
                Some(Handle::Axis(k))
            );
        }
        assert_eq!(handle_at(&stage, draft, at + vec2(-150.0, 90.0)), None);
    }
}
