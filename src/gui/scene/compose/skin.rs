//! The geometric simulator's surface: bellows and central tubes as its mesh has them, with the mesh's lines.

use glam::{Affine3A, Vec3};

use super::{Composer, SkinDrawing, Surface, rows, with_alpha};
use crate::gui::scene::entity::Entity;
use crate::gui::scene::mesh::Vertex;
use crate::signal::{CHAMBERS, Skin};

/// How far the lines lie above the surface, m: enough for the depth buffer, too little to see.
const LIFT_M: f32 = 0.0006;

impl Composer<'_> {
    /// The surface. A stale one is grey.
    pub(super) fn skin(&mut self, skin: &Skin, stale: bool) {
        let Some(vertices) = vertices(skin) else {
            return; // normals and positions do not belong together
        };
        let place = rows(&Affine3A::IDENTITY);
        let mut columns = Vec::with_capacity(skin.columns.len());
        for (c, range) in skin.columns.iter().enumerate() {
            let entity = (c < CHAMBERS).then_some(Entity::Bellows(c));
            let surface = match (entity, stale) {
                (Some(_), false) => Surface {
                    colour: self.palette.bellows,
                    gloss: 0.22,
                    glow: 0.0,
                },
                (Some(_), true) => Surface::matt(self.palette.fixture),
                (None, _) => Surface::shiny(self.palette.tube),
            };
            let instance = self.instance(place, surface, entity);
            columns.push((3 * range.start as u32..3 * range.end as u32, instance));
            if entity.is_some() {
                self.mesh_lines(skin, &vertices, range.clone());
            }
        }
        self.drawing.skin = Some(SkinDrawing {
            vertices,
            indices: skin.triangles.iter().flatten().copied().collect(),
            columns,
        });
    }

    /// Rings and rows of one column. The simulator's triangles come in pairs that share a diagonal, from the
    /// upper ring (a, b) to the lower one (d, e): (a, d, e) and (a, e, b).
    fn mesh_lines(&mut self, skin: &Skin, vertices: &[Vertex], range: std::ops::Range<usize>) {
        let colour = with_alpha(self.palette.fixture, 0.42);
        let at = |i: u32| {
            let v = &vertices[i as usize];
            Vec3::from(v.position) + Vec3::from(v.normal) * LIFT_M
        };
        for pair in skin.triangles[range].chunks_exact(2) {
            let [a, d, _] = pair[0];
            let [_, _, b] = pair[1];
            self.mark(at(a), at(b), 0.8, colour, 0.0);
            self.mark(at(a), at(d), 0.8, colour, 0.0);
        }
    }
}

fn vertices(skin: &Skin) -> Option<Vec<Vertex>> {
    let f32s = |v: &[f64; 3]| v.map(|x| x as f32);
    (skin.positions_m.len() == skin.normals.len()).then(|| {
        skin.positions_m
            .iter()
            .zip(&skin.normals)
            .map(|(p, n)| Vertex {
                position: f32s(p),
                normal: f32s(n),
                shade: 1.0,
            })
            .collect()
    })
}
