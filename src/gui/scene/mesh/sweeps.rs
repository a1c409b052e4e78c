//! Surfaces swept along an outline or turned about an axis.

use std::f32::consts::{FRAC_PI_2, TAU};

use glam::{Vec2, Vec3};

use super::triangles::{Mesh, Vertex, vertex};

/// Rows of `columns` vertices, joined to the next row and around: rows run down, columns counter-clockwise.
pub(super) fn lathe(rows: usize, columns: usize, at: impl Fn(usize, usize) -> Vertex) -> Mesh {
    let mut mesh = Mesh::default();
    for i in 0..rows {
        for j in 0..columns {
            mesh.vertices.push(at(i, j));
        }
    }
    let id = |i: usize, j: usize| (i * columns + j % columns) as u32;
    for i in 0..rows - 1 {
        for j in 0..columns {
            let (a, b, c, d) = (id(i, j), id(i + 1, j), id(i + 1, j + 1), id(i, j + 1));
            mesh.indices.extend([a, b, c, a, c, d]);
        }
    }
    mesh
}

pub(super) fn angle(j: usize, columns: usize) -> f32 {
    TAU * j as f32 / columns as f32
}

/// One ring of a surface of revolution: radius, place along the axis, tangent of the profile, shade.
#[derive(Clone, Copy)]
pub(super) struct Ring {
    pub(super) radius: f32,
    pub(super) s: f32,
    pub(super) d_radius: f32,
    pub(super) d_s: f32,
    pub(super) shade: f32,
}

pub(super) fn swept(profile: &[Ring], columns: usize) -> Mesh {
    lathe(profile.len(), columns, |i, j| {
        let p = profile[i];
        vertex(
            Vec3::new(p.radius, angle(j, columns), p.s),
            Vec3::new(p.d_radius, p.d_s, 0.0),
            p.shade,
        )
    })
}

/// A point of a closed outline and its outward normal.
type Outline = Vec<(Vec2, Vec2)>;

/// Convex hull of discs with a common radius around `centres`, counter-clockwise.
pub(super) fn hull_outline(centres: &[Vec2], radius_m: f32) -> Outline {
    const STEPS: usize = 72;
    let farthest = |direction: Vec2| {
        centres
            .iter()
            .copied()
            .max_by(|a, b| a.dot(direction).total_cmp(&b.dot(direction)))
            .unwrap_or_default()
    };
    let mut outline: Outline = Vec::new();
    let mut last: Option<Vec2> = None;
    // Offset by a part of a step so that no direction is exactly normal to an edge of a regular robot.
    for k in 0..=STEPS {
        let n = Vec2::from_angle(TAU * (k as f32 + 0.37) / STEPS as f32);
        let c = farthest(n);
        if let Some(before) = last
            && before.distance(c) > 1e-6
        {
            // A straight edge from one disc to the next.
            let edge = (c - before).normalize();
            let side = Vec2::new(edge.y, -edge.x);
            outline.push((before + side * radius_m, side));
            outline.push((c + side * radius_m, side));
        }
        last = Some(c);
        if k < STEPS {
            outline.push((c + n * radius_m, n));
        }
    }
    outline
}

/// A rectangle with rounded corners, given by its half size.
pub(super) fn rectangle_outline(half_m: Vec2, radius_m: f32) -> Outline {
    let c = half_m - Vec2::splat(radius_m);
    hull_outline(
        &[c, Vec2::new(-c.x, c.y), -c, Vec2::new(c.x, -c.y)],
        radius_m,
    )
}

/// A plate with rounded rims; its upper face is at z = 0.
pub(super) fn plate(outline: &Outline, thickness_m: f32, rim_m: f32) -> Mesh {
    const STEPS: usize = 4;
    // Rows: inset from the outline, height, tilt of the normal above the horizon.
    let mut rows = vec![(f32::INFINITY, 0.0, FRAC_PI_2)];
    for k in 0..=STEPS {
        let a = FRAC_PI_2 * k as f32 / STEPS as f32;
        rows.push((
            rim_m * (1.0 - a.sin()),
            -rim_m * (1.0 - a.cos()),
            FRAC_PI_2 - a,
        ));
    }
    for k in 0..=STEPS {
        let a = FRAC_PI_2 * k as f32 / STEPS as f32;
        let z = -thickness_m + rim_m * (1.0 - a.sin());
        rows.push((rim_m * (1.0 - a.cos()), z, -a));
    }
    rows.push((f32::INFINITY, -thickness_m, -FRAC_PI_2));
    let middle = outline.iter().map(|(p, _)| *p).sum::<Vec2>() / outline.len() as f32;
    lathe(rows.len(), outline.len(), |i, j| {
        let (inset, z, tilt) = rows[i];
        let (p, n) = outline[j];
        let at = if inset.is_finite() {
            p - n * inset
        } else {
            middle
        };
        vertex(at.extend(z), (n * tilt.cos()).extend(tilt.sin()), 1.0)
    })
}

/// Like [`plate`], with its lower face at z = 0.
pub(super) fn plate_at(outline: &Outline, thickness_m: f32, rim_m: f32) -> Mesh {
    let mut mesh = plate(outline, thickness_m, rim_m);
    for v in &mut mesh.vertices {
        v.position[2] += thickness_m;
    }
    mesh
}

/// A surface of revolution about z: (radius, z, normal's radial and vertical part, shade) from top to bottom.
pub(super) fn revolved(profile: &[(f32, f32, f32, f32, f32)], columns: usize) -> Mesh {
    lathe(profile.len(), columns, |i, j| {
        let (r, z, nr, nz, shade) = profile[i];
        let e = Vec2::from_angle(angle(j, columns));
        vertex((e * r).extend(z), (e * nr).extend(nz).normalize(), shade)
    })
}

/// Sets each vertex normal to the mean of its triangles' normals, weighted by area.
pub(super) fn smooth_normals(mesh: &mut Mesh) {
    let mut sum = vec![Vec3::ZERO; mesh.vertices.len()];
    for t in mesh.indices.chunks_exact(3) {
        let [a, b, c] = [t[0], t[1], t[2]].map(|i| Vec3::from(mesh.vertices[i as usize].position));
        let n = (b - a).cross(c - a);
        for i in t {
            sum[*i as usize] += n;
        }
    }
    for (v, n) in mesh.vertices.iter_mut().zip(sum) {
        v.normal = n.normalize_or(Vec3::NEG_Z).to_array();
    }
}
