//! An orbit camera: z is up, the picture plane is measured in points from its top left corner.

use std::f32::consts::{FRAC_PI_2, PI};

use glam::{Mat4, Vec2, Vec3};

/// Vertical opening angle of the perspective view, rad.
const FOV_Y_RAD: f32 = 0.50;
/// Closest and farthest distance from the target, m.
const DISTANCE_RANGE_M: [f32; 2] = [0.05, 8.0];

/// How depth is drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Projection {
    /// Far things are smaller.
    Perspective,
    /// Parallel lines stay parallel.
    Orthographic,
}

/// A standard direction of view.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum View {
    /// From -y towards +y, x to the right.
    Front,
    /// From +x, y to the right.
    Right,
    /// From above, x to the right, y up.
    Top,
    /// From below, x to the right, y down.
    Below,
}

/// Which mouse button turns the view and which one shifts it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub enum Controls {
    /// As in Blender: middle turns, Shift shifts.
    #[default]
    Blender,
    /// As in CAD programs: middle turns, right shifts.
    Cad,
}

/// What a drag does to the view.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Motion {
    /// Turns it about its target.
    Orbit,
    /// Shifts it.
    Pan,
}

impl Controls {
    /// What a drag with a button does; Shift always shifts, and the left button turns for those without a
    /// middle one.
    pub fn motion(self, button: egui::PointerButton, shift: bool) -> Option<Motion> {
        use egui::PointerButton::{Middle, Primary, Secondary};
        match (self, button) {
            (_, Primary | Middle | Secondary) if shift => Some(Motion::Pan),
            (Self::Cad, Secondary) => Some(Motion::Pan),
            (_, Primary | Middle | Secondary) => Some(Motion::Orbit),
            _ => None,
        }
    }
}

/// A half-line.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ray {
    /// Where it starts, m.
    pub origin_m: Vec3,
    /// Unit direction.
    pub direction: Vec3,
}

/// Looks from a sphere around `target_m` at its centre.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Camera {
    /// What it looks at, m.
    pub target_m: Vec3,
    /// Direction from the target to the eye around z, rad; 0 on +x.
    pub yaw_rad: f32,
    /// Height of the eye above the horizon, rad, within ±π/2.
    pub pitch_rad: f32,
    /// From target to eye, m. Also sets the scale of the orthographic view.
    pub distance_m: f32,
    /// How depth is drawn.
    pub projection: Projection,
}

impl Camera {
    /// A three-quarter view of a sphere.
    pub fn framing(centre_m: Vec3, radius_m: f32) -> Self {
        let mut camera = Self {
            target_m: centre_m,
            yaw_rad: -1.02,
            pitch_rad: 0.20,
            distance_m: 1.0,
            projection: Projection::Perspective,
        };
        camera.frame(centre_m, radius_m);
        camera
    }

    /// Moves so that a sphere fills the view; keeps the direction.
    pub fn frame(&mut self, centre_m: Vec3, radius_m: f32) {
        self.target_m = centre_m;
        self.distance_m = clamp_distance(radius_m / (0.5 * FOV_Y_RAD).sin());
    }

    /// Takes a standard direction; keeps target and distance.
    pub fn look(&mut self, view: View) {
        (self.yaw_rad, self.pitch_rad) = match view {
            View::Front => (-FRAC_PI_2, 0.0),
            View::Right => (0.0, 0.0),
            View::Top => (-FRAC_PI_2, FRAC_PI_2),
            View::Below => (-FRAC_PI_2, -FRAC_PI_2),
        };
    }

    /// Switches between perspective and parallel projection.
    pub fn toggle_projection(&mut self) {
        self.projection = match self.projection {
            Projection::Perspective => Projection::Orthographic,
            Projection::Orthographic => Projection::Perspective,
        };
    }

    /// Whether far things are smaller.
    pub fn is_perspective(&self) -> bool {
        self.projection == Projection::Perspective
    }

    /// Direction of view, unit.
    pub fn forward(&self) -> Vec3 {
        let (sp, cp) = self.pitch_rad.sin_cos();
        let (sy, cy) = self.yaw_rad.sin_cos();
        -Vec3::new(cp * cy, cp * sy, sp)
    }

    /// To the right in the picture, unit, horizontal.
    pub fn right(&self) -> Vec3 {
        let (sy, cy) = self.yaw_rad.sin_cos();
        Vec3::new(-sy, cy, 0.0)
    }

    /// Up in the picture, unit.
    pub fn up(&self) -> Vec3 {
        self.right().cross(self.forward())
    }

    /// Where the eye is, m.
    pub fn eye_m(&self) -> Vec3 {
        self.target_m - self.forward() * self.distance_m
    }

    /// Turns about the target by a drag in points.
    pub fn orbit(&mut self, drag_pt: Vec2) {
        const RAD_PER_POINT: f32 = 0.0075;
        self.yaw_rad = (self.yaw_rad - drag_pt.x * RAD_PER_POINT + PI).rem_euclid(2.0 * PI) - PI;
        self.pitch_rad = (self.pitch_rad + drag_pt.y * RAD_PER_POINT).clamp(-FRAC_PI_2, FRAC_PI_2);
    }

    /// Shifts the target so that what is at its depth follows the pointer.
    pub fn pan(&mut self, drag_pt: Vec2, size_pt: Vec2) {
        let m = self.metres_per_point(self.target_m, size_pt);
        self.target_m += (self.up() * drag_pt.y - self.right() * drag_pt.x) * m;
    }

    /// Changes the distance by `factor` (below 1 comes closer) and keeps the point under the pointer,
    /// at the target's depth, where it is.
    pub fn zoom(&mut self, factor: f32, at_pt: Vec2, size_pt: Vec2) {
        let distance_m = clamp_distance(self.distance_m * factor);
        let factor = distance_m / self.distance_m;
        if let Some(p) = plane_hit(&self.ray(at_pt, size_pt), self.target_m, self.forward()) {
            self.target_m += (p - self.target_m) * (1.0 - factor);
        }
        self.distance_m = distance_m;
    }

    /// View matrix: camera axes x right, y up, z towards the viewer.
    pub fn view_from_world(&self) -> Mat4 {
        let (r, u, f) = (self.right(), self.up(), self.forward());
        let eye = self.eye_m();
        Mat4::from_cols(
            Vec3::new(r.x, u.x, -f.x).extend(0.0),
            Vec3::new(r.y, u.y, -f.y).extend(0.0),
            Vec3::new(r.z, u.z, -f.z).extend(0.0),
            Vec3::new(-r.dot(eye), -u.dot(eye), f.dot(eye)).extend(1.0),
        )
    }

    /// World to clip space (depth 0 near, 1 far).
    pub fn clip_from_world(&self, size_pt: Vec2) -> Mat4 {
        let aspect = size_pt.x.max(1.0) / size_pt.y.max(1.0);
        let projection = match self.projection {
            Projection::Perspective => Mat4::perspective_rh(
                FOV_Y_RAD,
                aspect,
                self.distance_m * 0.05,
                self.distance_m * 4.0 + 6.0,
            ),
            Projection::Orthographic => {
                let h = self.distance_m * (0.5 * FOV_Y_RAD).tan();
                Mat4::orthographic_rh(-h * aspect, h * aspect, -h, h, -6.0, self.distance_m + 8.0)
            }
        };
        projection * self.view_from_world()
    }

    /// Where a point appears, in points from the top left; `None` behind the eye.
    pub fn project(&self, point_m: Vec3, size_pt: Vec2) -> Option<Vec2> {
        let clip = self.clip_from_world(size_pt) * point_m.extend(1.0);
        (clip.w > 1e-5).then(|| {
            let ndc = clip.truncate() / clip.w;
            Vec2::new(0.5 + 0.5 * ndc.x, 0.5 - 0.5 * ndc.y) * size_pt
        })
    }

    /// The ray through a place in the picture.
    pub fn ray(&self, at_pt: Vec2, size_pt: Vec2) -> Ray {
        let aspect = size_pt.x.max(1.0) / size_pt.y.max(1.0);
        let ndc = Vec2::new(
            2.0 * at_pt.x / size_pt.x.max(1.0) - 1.0,
            1.0 - 2.0 * at_pt.y / size_pt.y.max(1.0),
        );
        let t = (0.5 * FOV_Y_RAD).tan();
        let across = self.right() * (ndc.x * t * aspect) + self.up() * (ndc.y * t);
        match self.projection {
            Projection::Perspective => Ray {
                origin_m: self.eye_m(),
                direction: (self.forward() + across).normalize(),
            },
            Projection::Orthographic => Ray {
                origin_m: self.eye_m() + across * self.distance_m,
                direction: self.forward(),
            },
        }
    }

    /// Size of one point of the picture at the depth of `at_m`, m.
    pub fn metres_per_point(&self, at_m: Vec3, size_pt: Vec2) -> f32 {
        let depth_m = match self.projection {
            Projection::Perspective => (at_m - self.eye_m()).dot(self.forward()).max(1e-3),
            Projection::Orthographic => self.distance_m,
        };
        2.0 * depth_m * (0.5 * FOV_Y_RAD).tan() / size_pt.y.max(1.0)
    }
}

fn clamp_distance(distance_m: f32) -> f32 {
    distance_m.clamp(DISTANCE_RANGE_M[0], DISTANCE_RANGE_M[1])
}

/// Where a ray meets the plane through `point_m` with the given normal, in front of its origin.
pub fn plane_hit(ray: &Ray, point_m: Vec3, normal: Vec3) -> Option<Vec3> {
    // n · (o + t d - p) = 0
    let slope = ray.direction.dot(normal);
    if slope.abs() < 1e-6 {
        return None;
    }
    let t = (point_m - ray.origin_m).dot(normal) / slope;
    (t > 0.0).then(|| ray.origin_m + ray.direction * t)
}

/// How far along a line (from `point_m`, unit `axis`) its closest approach to a ray lies, m;
/// `None` when the two are nearly parallel.
pub fn closest_on_line(ray: &Ray, point_m: Vec3, axis: Vec3) -> Option<f32> {
    let c = axis.dot(ray.direction);
    let denominator = 1.0 - c * c;
    if denominator < 1e-4 {
        return None;
    }
    let w = point_m - ray.origin_m;
    Some((c * ray.direction.dot(w) - axis.dot(w)) / denominator)
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: Vec2 = Vec2::new(1280.0, 720.0);

    fn cameras() -> Vec<Camera> {
        let mut all = Vec::new();
        for projection in [Projection::Perspective, Projection::Orthographic] {
            let mut c = Camera::framing(Vec3::new(0.05, -0.02, -0.25), 0.4);
            c.projection = projection;
            all.push(c);
            for view in [View::Front, View::Right, View::Top] {
                c.look(view);
                all.push(c);
            }
        }
        all
    }

    #[test]
    fn a_ray_through_a_projected_point_passes_the_point() {
        for c in cameras() {
            for p in [
                Vec3::new(0.1, 0.05, -0.3),
                Vec3::new(-0.2, 0.1, 0.0),
                c.target_m,
            ] {
                let at = c.project(p, SIZE).expect("in front of the eye");
                let ray = c.ray(at, SIZE);
                let off = (p - ray.origin_m).cross(ray.direction).length();
                assert!(off < 1e-4, "{c:?} {p} missed by {off} m");
            }
        }
    }

    #[test]
    fn the_target_is_in_the_middle_and_z_points_up() {
        for c in cameras() {
            let at = c.project(c.target_m, SIZE).expect("in front");
            assert!((at - SIZE * 0.5).length() < 0.01);
            assert!(c.up().z >= -1e-6);
        }
        let mut c = Camera::framing(Vec3::ZERO, 0.3);
        c.look(View::Front);
        let x = c.project(Vec3::X * 0.1, SIZE).expect("in front");
        let z = c.project(Vec3::Z * 0.1, SIZE).expect("in front");
        assert!(x.x > SIZE.x * 0.5 + 10.0 && z.y < SIZE.y * 0.5 - 10.0);
        c.look(View::Top);
        let y = c.project(Vec3::Y * 0.1, SIZE).expect("in front");
        assert!(y.y < SIZE.y * 0.5 - 10.0);
    }

    #[test]
    fn a_click_lands_on_the_camera_facing_plane_under_the_pointer() {
        let tip = Vec3::new(0.08, -0.03, -0.31);
        for c in cameras() {
            let at = c.project(tip, SIZE).expect("in front") + Vec2::new(37.0, -52.0);
            let hit = plane_hit(&c.ray(at, SIZE), tip, c.forward()).expect("meets the plane");
            assert!((hit - tip).dot(c.forward()).abs() < 1e-5);
            let back = c.project(hit, SIZE).expect("in front");
            assert!((back - at).length() < 0.05, "{back} {at}");
            let expected = c.metres_per_point(tip, SIZE)
                * at.distance(c.project(tip, SIZE).expect("in front"));
            assert!(((hit - tip).length() - expected).abs() < 1e-4);
        }
        let ray = Ray {
            origin_m: Vec3::ZERO,
            direction: Vec3::X,
        };
        assert_eq!(plane_hit(&ray, Vec3::Y, Vec3::Y), None);
        assert_eq!(plane_hit(&ray, -Vec3::X, Vec3::X), None);
    }

    #[test]
    fn zoom_keeps_what_is_under_the_pointer() {
        for mut c in cameras() {
            let at = Vec2::new(900.0, 200.0);
            let before = plane_hit(&c.ray(at, SIZE), c.target_m, c.forward()).expect("meets");
            c.zoom(0.6, at, SIZE);
            let after = c.project(before, SIZE).expect("in front");
            assert!((after - at).length() < 0.1, "{after}");
        }
    }

    #[test]
    fn pan_follows_the_pointer_and_orbit_keeps_the_distance() {
        for mut c in cameras() {
            let grabbed = c.target_m;
            c.pan(Vec2::new(40.0, 25.0), SIZE);
            let now = c.project(grabbed, SIZE).expect("in front");
            assert!((now - SIZE * 0.5 - Vec2::new(40.0, 25.0)).length() < 0.1);
            c.orbit(Vec2::new(130.0, 4000.0));
            assert!(c.pitch_rad <= FRAC_PI_2);
            assert!(((c.eye_m() - c.target_m).length() - c.distance_m).abs() < 1e-5);
        }
    }

    #[test]
    fn closest_approach_matches_a_known_pair_of_lines() {
        // A line along z through (0.3, 0, 0) and a ray along x at height 0.7 offset in y.
        let ray = Ray {
            origin_m: Vec3::new(-1.0, 0.2, 0.7),
            direction: Vec3::X,
        };
        let t = closest_on_line(&ray, Vec3::new(0.3, 0.0, 0.0), Vec3::Z).expect("not parallel");
        assert!((t - 0.7).abs() < 1e-6);
        assert_eq!(closest_on_line(&ray, Vec3::ZERO, Vec3::X), None);
    }
}
