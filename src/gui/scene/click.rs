//! From a place on the screen to a place in space: how deep a click goes.
//!
//! 1. A part or waypoint under the pointer gives its depth.
//! 2. Otherwise the ray is followed through the reachable set; the depth of the plane that faces the viewer
//!    through the tip is clamped into the nearest stretch inside the set.
//! 3. A ray that misses the set keeps the plane's depth.

use glam::{Vec2, Vec3};

use super::camera::{Camera, Ray, plane_hit};
use super::reachset::{Interval, ReachSet, nearest};

/// What a depth was taken from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DepthBy {
    /// The part or waypoint under the pointer.
    Part,
    /// The tip's plane, which lies inside the reachable set there.
    Plane,
    /// The reachable set: the tip's plane lies outside of it there.
    Clamped,
    /// The tip's plane; the ray misses the reachable set.
    Missed,
}

/// What a click means in depth.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Anchor {
    /// Nothing is under the pointer: the plane through here, then the reachable set.
    Through(Vec3),
    /// A part is under the pointer: the plane through here.
    Part(Vec3),
    /// A waypoint is under the pointer: exactly there.
    At(Vec3),
}

/// Where a click goes.
#[derive(Clone, Debug, PartialEq)]
pub struct Landing {
    /// There, base frame, m.
    pub at_m: Vec3,
    /// Why there.
    pub by: DepthBy,
    /// The stretch of the ray inside the reachable set that it was put into.
    pub inside: Option<[Vec3; 2]>,
}

/// Where a click at a place of the picture goes; `None` when the ray does not meet the plane.
pub fn land(
    camera: &Camera,
    at_pt: Vec2,
    size_pt: Vec2,
    anchor: Anchor,
    set: Option<&ReachSet>,
) -> Option<Landing> {
    let ray = camera.ray(at_pt, size_pt);
    let (through, by) = match anchor {
        Anchor::Through(p) => (p, DepthBy::Plane),
        Anchor::Part(p) | Anchor::At(p) => (p, DepthBy::Part),
    };
    let at_m = match anchor {
        Anchor::At(p) => p,
        _ => plane_hit(&ray, through, camera.forward())?,
    };
    let wanted_m = (at_m - ray.origin_m).dot(ray.direction);
    let stretch = set.and_then(|set| nearest(&set.intervals(&ray), wanted_m));
    let inside = stretch.map(|i| [i.near_m, i.far_m].map(|t| ray.origin_m + ray.direction * t));
    let (at_m, by) = match (by, stretch) {
        (DepthBy::Part, _) => (at_m, by),
        (_, Some(stretch)) => clamped(&ray, stretch, wanted_m),
        (_, None) if set.is_some() => (at_m, DepthBy::Missed),
        (_, None) => (at_m, by),
    };
    Some(Landing { at_m, by, inside })
}

fn clamped(ray: &Ray, stretch: Interval, wanted_m: f32) -> (Vec3, DepthBy) {
    let depth_m = stretch.clamp(wanted_m);
    let by = match depth_m == wanted_m {
        true => DepthBy::Plane,
        false => DepthBy::Clamped,
    };
    (ray.origin_m + ray.direction * depth_m, by)
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: Vec2 = Vec2::new(1000.0, 700.0);

    /// Two layers of samples, in front of and behind the plane of the tip, and one that holds the tip.
    fn set() -> ReachSet {
        let mut samples = Vec::new();
        for i in -20..=20 {
            for k in -3..=3 {
                for j in -2..=2 {
                    let [x, dy, z] = [i, j, k].map(|n| n as f32 * 0.01);
                    let [lo, hi] = if x > 0.0 { [-0.15, 0.15] } else { [0.0, 0.0] };
                    samples.push([x, lo + dy, z - 0.3]);
                    samples.push([x, hi + dy, z - 0.3]);
                }
            }
        }
        ReachSet::new(&samples).expect("samples")
    }

    fn front() -> Camera {
        let mut camera = Camera::framing(Vec3::new(0.0, 0.0, -0.3), 0.4);
        camera.look(super::super::camera::View::Front);
        camera
    }

    fn click(at_m: Vec3, anchor: Anchor) -> Landing {
        let camera = front();
        let at = camera.project(at_m, SIZE).expect("in view");
        let landing = land(&camera, at, SIZE, anchor, Some(&set())).expect("lands");
        let back = camera.project(landing.at_m, SIZE).expect("in view");
        assert!(back.distance(at) < 0.05, "it stays under the pointer");
        landing
    }

    const TIP: Vec3 = Vec3::new(-0.05, 0.0, -0.3);

    #[test]
    fn a_part_gives_its_depth_and_a_waypoint_itself() {
        let part = Vec3::new(0.1, 0.04, -0.3);
        let landing = click(part + Vec3::X * 0.01, Anchor::Part(part));
        assert_eq!(landing.by, DepthBy::Part);
        assert!((landing.at_m.y - part.y).abs() < 1e-5);
        let camera = front();
        let at = camera.project(part, SIZE).expect("in view") + Vec2::splat(4.0);
        let landing = land(&camera, at, SIZE, Anchor::At(part), None).expect("lands");
        assert_eq!(landing.at_m, part);
    }

    #[test]
    fn inside_the_set_the_plane_through_the_tip_gives_the_depth() {
        let landing = click(Vec3::new(-0.1, 0.0, -0.29), Anchor::Through(TIP));
        assert_eq!(landing.by, DepthBy::Plane);
        assert!(landing.at_m.y.abs() < 1e-5 && landing.inside.is_some());
    }

    #[test]
    fn outside_of_it_the_depth_is_clamped_into_the_nearest_stretch() {
        // Over x > 0 the tip's plane runs between two layers.
        for y in [-0.15_f32, 0.15] {
            let tip = TIP + Vec3::Y * 0.3 * y;
            let landing = click(Vec3::new(0.1, tip.y, -0.3), Anchor::Through(tip));
            assert_eq!(landing.by, DepthBy::Clamped);
            assert!(set().contains(landing.at_m), "{landing:?}");
            let [near, far] = landing.inside.expect("a stretch");
            assert!(near.y < landing.at_m.y && landing.at_m.y < far.y);
            assert_eq!(landing.at_m.y.signum(), y.signum(), "{landing:?}");
        }
    }

    #[test]
    fn a_ray_that_misses_the_set_keeps_the_plane() {
        let landing = click(Vec3::new(0.0, 0.0, -0.1), Anchor::Through(TIP));
        assert_eq!((landing.by, landing.inside), (DepthBy::Missed, None));
        assert!(landing.at_m.y.abs() < 1e-5);
    }
}
