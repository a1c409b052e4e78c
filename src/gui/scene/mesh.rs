//! The fixed meshes of the arm, built once from the robot file.
//!
//! Rigid parts are plain meshes in m. Bellows and central tube are stored in (radius, angle, s) and springs in
//! (s, angle around the wire); the vertex shader sweeps them along the section frames of the moment, so
//! that nothing is rebuilt while the arm moves. Triangles are counter-clockwise seen from outside.

mod sweeps;
mod triangles;

use triangles::vertex;
pub use triangles::{Mesh, Vertex};

use std::f32::consts::{PI, TAU};
use std::ops::Range;

use glam::{Vec2, Vec3};

use super::convert::vec3_from_vector;
use crate::robot::RobotSpec;
use sweeps::{
    Ring, angle, hull_outline, lathe, plate, plate_at, rectangle_outline, revolved, smooth_normals,
    swept,
};

/// Convolutions drawn per bellows.
pub const CONVOLUTIONS: usize = 11;
/// Turns drawn per spring: fewer and thicker than the real coil, whose wire is thinner than a pixel.
pub const SPRING_TURNS: f32 = 19.0;
/// Material around a bellows in the pads, m.
const PAD_MARGIN_M: f32 = 0.006;

/// The meshes, by what the vertex shader does with them and then by part.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Part {
    /// A bellows skin, swept.
    Bellows,
    /// The central tube, swept; radius 1 in the mesh.
    Tube,
    /// A coil spring.
    Spring,
    /// The fixed pad, upper face at z = 0.
    TopPad,
    /// The pad between the segments, upper face at z = 0.
    MiddlePad,
    /// The pad that carries the gripper, upper face at z = 0.
    EndPad,
    /// The plate at the ceiling, upper face at z = 0.
    Ceiling,
    /// A unit cylinder: radius 1, z from 0 down to -1.
    Cylinder,
    /// A unit sphere.
    Sphere,
    /// An IMU's housing, centre of its lower face at the origin.
    Imu,
    /// The gripper's palm, upper face at z = 0.
    Palm,
    /// A finger of the open gripper, bending outwards along x.
    FingerOpen,
    /// A finger of the closed gripper.
    FingerClosed,
}

/// How the vertex shader places a part.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Motion {
    /// By a transform.
    Rigid,
    /// Along a segment's frames.
    Swept,
    /// Between a spring's ends.
    Coiled,
}

impl Part {
    /// All parts, in the order of [`build`].
    pub const ALL: [Part; 13] = [
        Part::Bellows,
        Part::Tube,
        Part::Spring,
        Part::TopPad,
        Part::MiddlePad,
        Part::EndPad,
        Part::Ceiling,
        Part::Cylinder,
        Part::Sphere,
        Part::Imu,
        Part::Palm,
        Part::FingerOpen,
        Part::FingerClosed,
    ];

    /// How the vertex shader places it.
    pub fn motion(self) -> Motion {
        match self {
            Part::Bellows | Part::Tube => Motion::Swept,
            Part::Spring => Motion::Coiled,
            _ => Motion::Rigid,
        }
    }
}

/// All meshes in one, with the range of indices of each part in the order of [`Part::ALL`].
pub fn build(robot: &RobotSpec) -> (Mesh, Vec<Range<u32>>) {
    let mut all = Mesh::default();
    let ranges = Part::ALL
        .iter()
        .map(|part| {
            let mesh = part_mesh(*part, robot);
            let first_vertex = all.vertices.len() as u32;
            let first_index = all.indices.len() as u32;
            all.vertices.extend(&mesh.vertices);
            all.indices
                .extend(mesh.indices.iter().map(|i| i + first_vertex));
            first_index..all.indices.len() as u32
        })
        .collect();
    (all, ranges)
}

/// One part's mesh.
pub fn part_mesh(part: Part, robot: &RobotSpec) -> Mesh {
    let centres: Vec<Vec2> = robot
        .bellows_m
        .iter()
        .map(|b| vec3_from_vector(b).truncate())
        .collect();
    let corner_m = pad_corner_m(robot);
    let thickness_m = robot.pad_thickness_m as f32;
    match part {
        Part::Bellows => bellows(robot),
        Part::Tube => tube(),
        Part::Spring => spring(),
        Part::TopPad => plate(&hull_outline(&centres[..3], corner_m), thickness_m, 0.002),
        Part::MiddlePad => plate(&hull_outline(&centres, corner_m), thickness_m, 0.002),
        Part::EndPad => plate(&hull_outline(&centres[3..], corner_m), thickness_m, 0.002),
        Part::Ceiling => plate(&rectangle_outline(Vec2::splat(0.15), 0.02), 0.014, 0.002),
        Part::Cylinder => cylinder(),
        Part::Sphere => sphere(),
        Part::Imu => plate_at(
            &rectangle_outline(Vec2::new(0.008, 0.011), 0.0015),
            0.006,
            0.0012,
        ),
        Part::Palm => palm(),
        Part::FingerOpen => finger(FingerBend::OPEN),
        Part::FingerClosed => finger(FingerBend::CLOSED),
    }
}

/// Radius of the pads' rounded corners around each bellows, m.
pub fn pad_corner_m(robot: &RobotSpec) -> f32 {
    0.5 * robot.bellows_outer_diameter_m as f32 + PAD_MARGIN_M
}

/// Radius of a bellows at `u` from 0 to 1 along its convolutions: an accordion fold with rounded tips.
fn fold(u: f32, inner_m: f32, outer_m: f32) -> f32 {
    // r = r_in + (r_out - r_in) (1 - asin(k cos 2πnu) / asin k) / 2; k < 1 rounds the triangle's tips.
    const ROUND: f32 = 0.90;
    let wave = (ROUND * (TAU * CONVOLUTIONS as f32 * u).cos()).asin() / ROUND.asin();
    inner_m + (outer_m - inner_m) * 0.5 * (1.0 - wave)
}

fn bellows(robot: &RobotSpec) -> Mesh {
    const COLUMNS: usize = 36;
    const RINGS_PER_FOLD: usize = 10;
    /// Share of the length taken by the straight collar at each end.
    const COLLAR: f32 = 0.03;
    let inner_m = 0.5 * robot.bellows_inner_diameter_m as f32;
    let outer_m = 0.5 * robot.bellows_outer_diameter_m as f32;
    let collar_m = inner_m + 0.18 * (outer_m - inner_m);
    let flat = |radius: f32, s: f32, d_radius: f32| Ring {
        radius,
        s,
        d_radius,
        d_s: 0.0,
        shade: 0.5,
    };
    let straight = |s: f32| Ring {
        radius: collar_m,
        s,
        d_radius: 0.0,
        d_s: 1.0,
        shade: 0.6,
    };
    let mut profile = vec![flat(0.0, 0.0, 1.0), flat(collar_m, 0.0, 1.0)];
    profile.extend([straight(0.0), straight(COLLAR)]);
    let count = CONVOLUTIONS * RINGS_PER_FOLD;
    for k in 0..=count {
        let u = k as f32 / count as f32;
        let h = 1e-3;
        let radius = fold(u, inner_m, outer_m);
        let slope = (fold(u + h, inner_m, outer_m) - fold(u - h, inner_m, outer_m)) / (2.0 * h);
        let open = (radius - inner_m) / (outer_m - inner_m);
        profile.push(Ring {
            radius,
            s: COLLAR + (1.0 - 2.0 * COLLAR) * u,
            d_radius: slope,
            d_s: 1.0 - 2.0 * COLLAR,
            // Folds are dark inside.
            shade: 0.30 + 0.70 * open.powf(0.9),
        });
    }
    profile.extend([straight(1.0 - COLLAR), straight(1.0)]);
    profile.extend([flat(collar_m, 1.0, -1.0), flat(0.0, 1.0, -1.0)]);
    swept(&profile, COLUMNS)
}

fn tube() -> Mesh {
    const RINGS: usize = 33;
    let profile: Vec<Ring> = (0..RINGS)
        .map(|k| Ring {
            radius: 1.0,
            s: k as f32 / (RINGS - 1) as f32,
            d_radius: 0.0,
            d_s: 1.0,
            shade: 0.6,
        })
        .collect();
    swept(&profile, 20)
}

fn spring() -> Mesh {
    const RINGS_PER_TURN: f32 = 12.0;
    let rings = (SPRING_TURNS * RINGS_PER_TURN) as usize + 1;
    lathe(rings, 6, |i, j| {
        let s = i as f32 / (rings - 1) as f32;
        vertex(Vec3::new(s, angle(j, 6), 0.0), Vec3::X, 1.0)
    })
}

fn cylinder() -> Mesh {
    revolved(
        &[
            (0.0, 0.0, 0.0, 1.0, 1.0),
            (1.0, 0.0, 0.0, 1.0, 1.0),
            (1.0, 0.0, 1.0, 0.0, 1.0),
            (1.0, -1.0, 1.0, 0.0, 1.0),
            (1.0, -1.0, 0.0, -1.0, 1.0),
            (0.0, -1.0, 0.0, -1.0, 1.0),
        ],
        28,
    )
}

fn sphere() -> Mesh {
    const ROWS: usize = 17;
    let profile: Vec<_> = (0..ROWS)
        .map(|i| {
            let (r, z) = (PI * i as f32 / (ROWS - 1) as f32).sin_cos();
            (r.max(0.0), z, r, z, 1.0)
        })
        .collect();
    revolved(&profile, 24)
}

fn palm() -> Mesh {
    // A flange, a neck and a rounded hub.
    revolved(
        &[
            (0.0, 0.0, 0.0, 1.0, 0.6),
            (0.036, 0.0, 0.0, 1.0, 0.6),
            (0.036, 0.0, 1.0, 0.0, 0.8),
            (0.036, -0.006, 1.0, 0.0, 0.9),
            (0.034, -0.008, 0.0, -1.0, 0.8),
            (0.025, -0.008, 0.0, -1.0, 0.5),
            (0.025, -0.008, 1.0, 0.0, 0.5),
            (0.025, -0.014, 1.0, 0.0, 0.6),
            (0.038, -0.020, 1.0, 0.4, 1.0),
            (0.040, -0.024, 1.0, 0.0, 1.0),
            (0.040, -0.034, 1.0, 0.0, 1.0),
            (0.038, -0.038, 0.6, -0.8, 0.9),
            (0.030, -0.040, 0.0, -1.0, 0.8),
            (0.0, -0.040, 0.0, -1.0, 0.7),
        ],
        36,
    )
}

/// The course of a finger's centre line.
#[derive(Clone, Copy)]
struct FingerBend {
    /// Lean outwards at the root, rad.
    root_rad: f32,
    /// Lean outwards at the tip, rad.
    tip_rad: f32,
}

impl FingerBend {
    const OPEN: Self = Self {
        root_rad: 0.42,
        tip_rad: 0.12,
    };
    const CLOSED: Self = Self {
        root_rad: 0.36,
        tip_rad: -0.95,
    };
}

/// A tapered soft finger with ribs on its back, rooted at (28 mm, 0, -34 mm).
fn finger(bend: FingerBend) -> Mesh {
    const ROWS: usize = 64;
    const COLUMNS: usize = 20;
    const LENGTH_M: f32 = 0.088;
    const RIBS: f32 = 8.0;
    let mut centre = Vec2::new(0.028, -0.034);
    let mut path = Vec::with_capacity(ROWS);
    for i in 0..ROWS {
        let t = i as f32 / (ROWS - 1) as f32;
        let lean = bend.root_rad + (bend.tip_rad - bend.root_rad) * t;
        let along = Vec2::new(lean.sin(), -lean.cos());
        path.push((t, centre, along));
        centre += along * LENGTH_M / (ROWS - 1) as f32;
    }
    let mut mesh = lathe(ROWS, COLUMNS, |i, j| {
        let (t, centre, along) = path[i];
        // The last tenth closes like a finger tip.
        let tip = ((1.0 - t) / 0.10).min(1.0);
        let close = (1.0 - (1.0 - tip).powi(2)).max(0.0).sqrt();
        let (sin, cos) = angle(j, COLUMNS).sin_cos();
        let rib = 0.5 - 0.5 * (TAU * RIBS * t).cos();
        let back = if cos > 0.0 { cos } else { 0.0 };
        let fade = (1.0 - t).min(0.15) / 0.15;
        let thick_m = (0.0075 - 0.0028 * t) * (1.0 + 0.34 * back * rib * fade) * close;
        let wide_m = (0.0100 - 0.0035 * t) * close;
        let out = Vec2::new(-along.y, along.x);
        let p = centre + out * (thick_m * cos);
        let shade = 1.0 - 0.45 * back * (1.0 - rib) * fade;
        vertex(Vec3::new(p.x, wide_m * sin, p.y), Vec3::ZERO, shade)
    });
    smooth_normals(&mut mesh);
    mesh
}

#[cfg(test)]
mod tests;
