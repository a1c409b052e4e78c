//! Lines over the arm: the tip as predicted and as measured, trails, targets.

use std::f32::consts::TAU;

use glam::{Vec2, Vec3};

use super::{Composer, Line, floor_m, with_alpha};
use crate::gui::scene::camera::Camera;
use crate::gui::scene::colours::Rgb;
use crate::gui::scene::convert;
use crate::gui::scene::input::SceneInput;
use crate::signal::ReachState;

/// How a circle is drawn.
#[derive(Clone, Copy)]
pub(super) enum Ring {
    Closed,
    Dashed,
    Dotted,
}

impl Composer<'_> {
    /// Axes of the tip, a dot where it is predicted, a ring where it is measured, the error between them.
    pub(super) fn tip_marks(&mut self, input: &SceneInput<'_>, camera: &Camera, size_pt: Vec2) {
        const THROUGH: f32 = 0.8;
        let snapshot = input.snapshot;
        let predicted = snapshot
            .estimate
            .as_ref()
            .map(|e| convert::parts(&e.base_from_tip));
        let truth = snapshot
            .fresh_truth()
            .map(|t| convert::parts(&t.base_from_tip));
        if let (Some((a, _)), Some((b, _))) = (predicted, truth) {
            self.mark(a, b, 3.5, with_alpha(self.palette.error, 1.0), THROUGH);
        }
        if let Some((p, q)) = predicted {
            self.axes(p, q, 0.050, 2.6, THROUGH);
            self.dot(p, 9.0, with_alpha(self.palette.predicted, 1.0), THROUGH);
            self.dropline(p, self.palette.predicted);
        }
        if let Some((p, q)) = truth {
            self.axes(p, q, 0.032, 1.4, THROUGH);
            let m = camera.metres_per_point(p, size_pt);
            let radii = [camera.right() * (6.0 * m), camera.up() * (6.0 * m)];
            let first = self.drawing.lines.len();
            let colour = with_alpha(self.palette.truth, 1.0);
            self.ring(p, radii, Ring::Closed, 2.4, colour);
            for line in &mut self.drawing.lines[first..] {
                line.through = THROUGH;
            }
        }
    }

    /// A dashed line down to the floor with a small ring at its foot.
    pub(super) fn dropline(&mut self, from: Vec3, colour: Rgb) {
        const DASH_M: f32 = 0.012;
        const HIGHEST_M: f32 = 2.0;
        if !from.is_finite() || from.z > HIGHEST_M {
            return; // a stray number must not become a million dashes
        }
        let floor_m = floor_m(self.robot) + 0.0005;
        let mut z = from.z;
        while z > floor_m {
            let end = (z - 0.5 * DASH_M).max(floor_m);
            self.line(
                from.with_z(z),
                from.with_z(end),
                1.2,
                with_alpha(colour, 0.6),
            );
            z -= DASH_M;
        }
        let foot = from.with_z(floor_m);
        let radius = [Vec3::X * 0.012, Vec3::Y * 0.012];
        self.ring(foot, radius, Ring::Closed, 1.5, with_alpha(colour, 0.8));
    }

    /// A circle spanned by two radii.
    pub(super) fn ring(
        &mut self,
        centre: Vec3,
        radii: [Vec3; 2],
        ring: Ring,
        width_pt: f32,
        colour: [f32; 4],
    ) {
        let (pieces, step) = match ring {
            Ring::Closed => (40, 1),
            Ring::Dashed => (12, 2),
            Ring::Dotted => (32, 2),
        };
        for k in (0..pieces).step_by(step) {
            let at = |k: usize| {
                let (s, c) = (TAU * k as f32 / pieces as f32).sin_cos();
                centre + radii[0] * c + radii[1] * s
            };
            self.line(at(k), at(k + 1), width_pt, colour);
        }
    }

    /// A path whose older end fades out.
    pub(super) fn trail(&mut self, points: &[[f32; 3]], colour: Rgb) {
        let count = points.len().max(2) as f32 - 1.0;
        for (i, pair) in points.windows(2).enumerate() {
            let alpha = |k: usize| 0.08 + 0.87 * (k as f32 / count).powf(0.8);
            self.drawing.lines.push(Line {
                from_m: pair[0],
                width_pt: 2.2,
                to_m: pair[1],
                round: 0.0,
                from_colour: with_alpha(colour, alpha(i)),
                to_colour: with_alpha(colour, alpha(i + 1)),
                through: 0.75,
            });
        }
    }

    pub(super) fn targets(&mut self, input: &SceneInput<'_>, camera: &Camera, size_pt: Vec2) {
        if let Some(goal) = &input.snapshot.goal {
            let at = convert::vec3(goal.position_m);
            self.marker(
                at,
                self.palette.goal,
                Some(ReachState::Reachable),
                camera,
                size_pt,
            );
            self.dropline(at, self.palette.goal);
        }
        let Some((draft, state)) = input.target() else {
            return;
        };
        let at = convert::vec3(draft);
        let colour = self.palette.reach(state);
        self.marker(at, colour, state, camera, size_pt);
        self.dropline(at, colour);
        // What falls short: from the wanted point to the nearest one.
        if let (Some(ReachState::Unreachable | ReachState::OutsideData), Some((_, reach))) =
            (state, &input.snapshot.preview)
        {
            let nearest = convert::vec3(reach.nearest_m);
            self.line(at, nearest, 2.0, with_alpha(colour, 0.9));
            self.dot(nearest, 9.0, with_alpha(colour, 1.0), 0.8);
        }
    }

    /// A cross-hair with a ring that faces the viewer. The verdict shows in its shape as well:
    /// closed ring, dashed ring, crossed ring, dotted ring.
    fn marker(
        &mut self,
        at: Vec3,
        colour: Rgb,
        state: Option<ReachState>,
        camera: &Camera,
        size_pt: Vec2,
    ) {
        let m = camera.metres_per_point(at, size_pt);
        let (u, v) = (camera.right() * (12.0 * m), camera.up() * (12.0 * m));
        let solid = with_alpha(colour, 1.0);
        let ring = match state {
            None | Some(ReachState::Reachable | ReachState::Unreachable) => Ring::Closed,
            Some(ReachState::Marginal) => Ring::Dashed,
            Some(ReachState::OutsideData) => Ring::Dotted,
        };
        self.ring(at, [u, v], ring, 2.4, solid);
        for axis in Vec3::AXES {
            for sign in [-1.0, 1.0] {
                let arm = axis * (sign * m);
                self.line(
                    at + arm * 4.0,
                    at + arm * 20.0,
                    1.4,
                    with_alpha(colour, 0.85),
                );
            }
        }
        if state == Some(ReachState::Unreachable) {
            for (a, b) in [(u + v, -u - v), (u - v, v - u)] {
                self.line(at + a * 0.5, at + b * 0.5, 2.4, solid);
            }
        }
    }
}
