//! Finds the part under the pointer.

use std::sync::mpsc::sync_channel;

use egui_wgpu::wgpu;
use glam::{Mat4, Vec2};

use super::targets::{DEPTH, PICK, PickTargets, depth_attachment, extent, texture};
use super::{Inner, Picture};
use crate::gui::scene::compose::Layer;
use crate::gui::scene::entity::Entity;

/// Edge of the square around the pointer that is searched for parts, pixels. Odd.
const PICK_SIZE: u32 = 9;
/// While the pointer rests, what moves under it is looked up again after so many pictures.
const REPICK_PICTURES: u32 = 8;

impl PickTargets {
    /// Where to search, if pointer or camera moved since the last search or the arm has moved on.
    pub(super) fn place(&self, picture: &Picture) -> Option<Vec2> {
        let at_px = picture.pick_px?;
        let moved = self.last != Some((at_px, picture.globals.clip_from_world));
        (moved || self.pictures_since >= REPICK_PICTURES).then_some(at_px)
    }

    pub(super) fn new(device: &wgpu::Device) -> Self {
        let texture_id = texture(device, "scene pick", [PICK_SIZE; 2], PICK, 1);
        let depth = texture(device, "scene pick depth", [PICK_SIZE; 2], DEPTH, 1);
        Self {
            view: texture_id.create_view(&wgpu::TextureViewDescriptor::default()),
            texture: texture_id,
            depth: depth.create_view(&wgpu::TextureViewDescriptor::default()),
            readback: device.create_buffer(&wgpu::BufferDescriptor {
                label: Some("scene pick readback"),
                size: u64::from(PICK_SIZE * wgpu::COPY_BYTES_PER_ROW_ALIGNMENT),
                usage: wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST,
                mapped_at_creation: false,
            }),
            pending: None,
            last: None,
            pictures_since: 0,
        }
    }
}

impl Inner {
    /// Draws the square around a place with the parts' numbers and asks for the result.
    pub(super) fn start_pick(
        &mut self,
        device: &wgpu::Device,
        queue: &wgpu::Queue,
        picture: &Picture,
        at_px: Vec2,
    ) {
        let mut globals = picture.globals;
        let clip = Mat4::from_cols_array_2d(&globals.clip_from_world);
        globals.clip_from_world = (around(at_px, picture.size_px) * clip).to_cols_array_2d();
        queue.write_buffer(&self.pick_globals, 0, bytemuck::bytes_of(&globals));
        let mut encoder = device.create_command_encoder(&wgpu::CommandEncoderDescriptor {
            label: Some("scene pick"),
        });
        {
            let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
                label: Some("scene pick"),
                color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                    view: &self.pick.view,
                    depth_slice: None,
                    resolve_target: None,
                    ops: wgpu::Operations {
                        load: wgpu::LoadOp::Clear(wgpu::Color::TRANSPARENT),
                        store: wgpu::StoreOp::Store,
                    },
                })],
                depth_stencil_attachment: Some(depth_attachment(&self.pick.depth)),
                ..Default::default()
            });
            pass.set_bind_group(0, &self.pick_group, &[]);
            self.draw_parts(
                &mut pass,
                &picture.drawing,
                Layer::Solid,
                &self.pipelines.pick,
            );
        }
        encoder.copy_texture_to_buffer(
            self.pick.texture.as_image_copy(),
            wgpu::TexelCopyBufferInfo {
                buffer: &self.pick.readback,
                layout: wgpu::TexelCopyBufferLayout {
                    offset: 0,
                    bytes_per_row: Some(wgpu::COPY_BYTES_PER_ROW_ALIGNMENT),
                    rows_per_image: None,
                },
            },
            extent([PICK_SIZE; 2]),
        );
        queue.submit([encoder.finish()]);
        let (sender, receiver) = sync_channel(1);
        self.pick
            .readback
            .map_async(wgpu::MapMode::Read, .., move |result| {
                // Fails only when the scene is gone.
                let _ = sender.try_send(result.is_ok());
            });
        self.pick.pending = Some(receiver);
    }

    /// Takes the answer of the last search if it has arrived.
    pub(super) fn read_pick(&mut self, device: &wgpu::Device) {
        let Some(pending) = &self.pick.pending else {
            return;
        };
        if let Err(e) = device.poll(wgpu::PollType::Poll) {
            log::warn!("polling the graphics device failed: {e}");
        }
        let Ok(mapped) = pending.try_recv() else {
            return;
        };
        self.pick.pending = None;
        if !mapped {
            return;
        }
        if let Ok(bytes) = self.pick.readback.get_mapped_range(..) {
            self.hovered = nearest_entity(&bytes);
        }
        self.pick.readback.unmap();
    }
}

/// Clip space to the clip space of the few pixels around a place.
fn around(at_px: Vec2, size_px: [u32; 2]) -> Mat4 {
    let size = Vec2::new(size_px[0] as f32, size_px[1] as f32);
    let scale = size / PICK_SIZE as f32;
    let ndc = Vec2::new(2.0 * at_px.x / size.x - 1.0, 1.0 - 2.0 * at_px.y / size.y);
    Mat4::from_scale(scale.extend(1.0)) * Mat4::from_translation((-ndc).extend(0.0))
}

/// The part nearest to the middle of the searched square. `bytes` are rows of u32, padded to 256 bytes.
fn nearest_entity(bytes: &[u8]) -> Option<Entity> {
    let middle = (PICK_SIZE / 2) as i32;
    let mut best: Option<(i32, u32)> = None;
    let rows = bytes.chunks(wgpu::COPY_BYTES_PER_ROW_ALIGNMENT as usize);
    for (y, row) in rows.take(PICK_SIZE as usize).enumerate() {
        for (x, id) in row.chunks_exact(4).take(PICK_SIZE as usize).enumerate() {
            let id = u32::from_le_bytes([id[0], id[1], id[2], id[3]]);
            let (dx, dy) = (x as i32 - middle, y as i32 - middle);
            // Sensors are thin: they win against the large parts beside them.
            let handicap = if Entity::from_id(id).is_some_and(Entity::is_sensor) {
                0
            } else {
                2 * middle * middle
            };
            let distance = dx * dx + dy * dy + handicap;
            let on_large = handicap > 0 && (dx, dy) != (0, 0);
            if id != 0 && !on_large && best.is_none_or(|(d, _)| distance < d) {
                best = Some((distance, id));
            }
        }
    }
    best.and_then(|(_, id)| Entity::from_id(id))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_search_square_is_centred_on_the_pointer() {
        let size = [1280, 720];
        let at = Vec2::new(321.5, 99.5);
        let ndc = Vec2::new(2.0 * at.x / 1280.0 - 1.0, 1.0 - 2.0 * at.y / 720.0);
        let m = around(at, size);
        assert!(m.project_point3(ndc.extend(0.3)).truncate().length() < 1e-4);
        // Half the square to the right is the edge of its clip space.
        let edge = ndc + Vec2::new(PICK_SIZE as f32 / 1280.0, 0.0);
        assert!((m.project_point3(edge.extend(0.3)).x - 1.0).abs() < 1e-3);
    }

    #[test]
    fn a_thin_sensor_beside_the_pointer_wins_against_the_part_under_it() {
        let row = wgpu::COPY_BYTES_PER_ROW_ALIGNMENT as usize;
        let mut bytes = vec![0_u8; row * PICK_SIZE as usize];
        let mut put = |x: usize, y: usize, entity: Entity| {
            bytes[y * row + 4 * x..][..4].copy_from_slice(&entity.id().to_le_bytes());
        };
        put(4, 4, Entity::Bellows(2));
        put(6, 4, Entity::Spring(7));
        put(1, 1, Entity::Imu(0));
        assert_eq!(nearest_entity(&bytes), Some(Entity::Spring(7)));
        let mut bytes = vec![0_u8; row * PICK_SIZE as usize];
        bytes[row * 4 + 16..][..4].copy_from_slice(&Entity::Bellows(2).id().to_le_bytes());
        assert_eq!(nearest_entity(&bytes), Some(Entity::Bellows(2)));
        // A large part that is not under the pointer itself does not count.
        bytes.rotate_right(8);
        assert_eq!(nearest_entity(&bytes), None);
    }
}
