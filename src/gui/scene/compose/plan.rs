//! What helps to choose a place: the plan's waypoints, where a click would go, outlines of the reachable set, shadows on
//! two walls behind the arm.

use glam::{Affine3A, Vec3};

use super::marks::Ring;
use super::{Composer, Surface, floor_m, scaled, with_alpha};
use crate::gui::scene::camera::Camera;
use crate::gui::scene::click::{DepthBy, Landing};
use crate::gui::scene::convert;
use crate::gui::scene::entity::Entity;
use crate::gui::scene::input::{PlanMarks, SceneInput};
use crate::gui::scene::mesh::Part;

/// Radius of a waypoint's ball, m.
const BALL_M: f32 = 0.0035;
/// Distance of the walls from the arm's axis, m.
const WALL_M: f32 = 0.30;

/// Flattens a place onto a wall.
type Wall = fn(Vec3, f32) -> Vec3;

impl Composer<'_> {
    /// The path, and a ball that can be pointed at for each waypoint.
    pub(super) fn plan(&mut self, plan: &PlanMarks<'_>) {
        let points: Vec<Vec3> = plan
            .waypoints_m
            .iter()
            .copied()
            .map(convert::vec3)
            .collect();
        let colour = self.palette.goal;
        let back = plan.closed.then(|| points.first()).flatten();
        let ends = points.iter().skip(1).chain(back);
        for (from, to) in points.iter().zip(ends) {
            self.mark(*from, *to, 2.6, with_alpha(colour, 1.0), 0.85);
        }
        for pair in plan.driven.windows(2) {
            let [from, to] = [pair[0], pair[1]].map(Vec3::from);
            self.mark(from, to, 3.4, with_alpha(self.palette.predicted, 1.0), 0.8);
        }
        for (i, at) in points.iter().enumerate() {
            let (selected, next) = (plan.selected == Some(i), plan.next == Some(i));
            let large = if selected || next { 1.6 } else { 1.0 };
            let surface = Surface {
                colour: if selected {
                    self.palette.selected
                } else {
                    colour
                },
                gloss: 0.3,
                glow: if selected { 0.8 } else { 0.5 },
            };
            let size = Vec3::splat(BALL_M * large);
            let ball = scaled(Affine3A::from_translation(*at), size);
            self.rigid(Part::Sphere, ball, surface, Some(Entity::Waypoint(i)));
            if next {
                self.dot(*at, 12.0, with_alpha(colour, 0.35), 0.6);
            }
        }
    }

    /// The reachable set's outlines.
    pub(super) fn outlines(&mut self, lines: &[[[f32; 3]; 2]]) {
        let colour = with_alpha(self.palette.predicted, 0.40);
        for [from, to] in lines {
            self.mark(Vec3::from(*from), Vec3::from(*to), 1.1, colour, 0.25);
        }
    }

    /// Where a click would go: a dot with its line down to the floor, and the reachable stretch under the pointer
    /// as its shadow on the floor.
    pub(super) fn landing(&mut self, landing: &Landing) {
        let ink = self.palette.ink;
        self.dot(landing.at_m, 7.0, with_alpha(ink, 0.95), 0.9);
        self.dropline(landing.at_m, ink);
        let Some(ends) = landing.inside.filter(|_| landing.by != DepthBy::Part) else {
            return;
        };
        let floor_m = floor_m(self.robot);
        let [near, far] = ends.map(|p| p.with_z(floor_m));
        let colour = with_alpha(self.palette.predicted, 0.9);
        self.mark(near, far, 3.0, colour, 0.5);
    }

    /// Two walls on the far side: what the arm, the target and the place under the pointer look like from two more
    /// sides.
    pub(super) fn walls(
        &mut self,
        input: &SceneInput<'_>,
        camera: &Camera,
        landing: Option<&Landing>,
    ) {
        let forward = camera.forward();
        let far = |along: f32| if along >= 0.0 { WALL_M } else { -WALL_M };
        let x: Wall = |p, at| Vec3::new(at, p.y, p.z);
        let y: Wall = |p, at| Vec3::new(p.x, at, p.z);
        // A wall seen from its edge shows nothing.
        const EDGE: f32 = 0.15;
        for (wall, along) in [(x, forward.x), (y, forward.y)] {
            if along.abs() > EDGE {
                self.wall(wall, far(along), input, landing);
            }
        }
    }

    fn wall(&mut self, wall: Wall, at_m: f32, input: &SceneInput<'_>, landing: Option<&Landing>) {
        let floor_m = floor_m(self.robot);
        let ink = self.palette.ink;
        // Its frame and height lines every 100 mm.
        let corner = |side: f32, z: f32| wall(Vec3::new(side, side, z), at_m);
        for side in [-WALL_M, WALL_M] {
            let line = with_alpha(ink, 0.20);
            self.mark(corner(side, 0.0), corner(side, floor_m), 1.0, line, 0.2);
        }
        for k in 0..=(-floor_m / 0.1) as i32 {
            let z = k as f32 * -0.1;
            let line = with_alpha(ink, if k == 0 { 0.20 } else { 0.10 });
            self.mark(corner(-WALL_M, z), corner(WALL_M, z), 1.0, line, 0.2);
        }
        if let Some(shape) = input.snapshot.shown_shape() {
            let shade = with_alpha([0.0; 3], 0.30);
            let sections = shape.base_from_section.iter().flatten();
            let line: Vec<Vec3> = sections.map(|p| wall(convert::parts(p).0, at_m)).collect();
            let first = self.drawing.lines.len();
            for pair in line.windows(2) {
                self.mark(pair[0], pair[1], 9.0, shade, 0.2);
            }
            // Round ends would be twice as dark where they meet.
            for line in &mut self.drawing.lines[first..] {
                line.round = 0.0;
            }
        }
        if let Some((target, state)) = input.target() {
            let colour = self.palette.reach(state);
            self.shadow(convert::vec3(target), wall, at_m, colour);
        }
        if let Some(landing) = landing {
            self.shadow(landing.at_m, wall, at_m, ink);
            if let Some(ends) = landing.inside.filter(|_| landing.by != DepthBy::Part) {
                let [near, far] = ends.map(|p| wall(p, at_m));
                let colour = with_alpha(self.palette.predicted, 0.9);
                self.mark(near, far, 3.0, colour, 0.5);
            }
        }
    }

    /// A small ring on a wall with a dashed line to what casts it.
    fn shadow(&mut self, at: Vec3, wall: Wall, at_m: f32, colour: super::Rgb) {
        const DASHES: i32 = 24;
        let foot = wall(at, at_m);
        let step = |k: i32| at.lerp(foot, k as f32 / DASHES as f32);
        for k in (0..DASHES).step_by(2) {
            self.mark(step(k), step(k + 1), 1.0, with_alpha(colour, 0.45), 0.3);
        }
        let across = wall(Vec3::splat(0.010), 0.0).with_z(0.0);
        let radii = [across, Vec3::Z * 0.010];
        self.ring(foot, radii, Ring::Closed, 1.5, with_alpha(colour, 0.8));
    }
}
