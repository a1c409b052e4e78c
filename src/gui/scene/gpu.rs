//! Draws a [`Drawing`] into a texture of its own (multisampled, with depth), copies it into the window,
//! and tells which part is under the pointer.
//!
//! A picture is drawn only when something in it changed. The part under the pointer is found by drawing
//! the few pixels around it once more with the parts' numbers instead of colours; the answer is read back
//! without waiting and arrives one or two frames later.

use std::sync::mpsc::{Receiver, sync_channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use egui_wgpu::wgpu;
use glam::{Mat4, Vec2, Vec3};
use wgpu::util::DeviceExt;

use super::Entity;
use super::compose::{BLOBS, Drawing, FRAMES, Instance, Layer, Line, SEGMENTS};
use super::mesh::{self, Motion, Part, Vertex};
use crate::robot::RobotSpec;

const COLOUR: wgpu::TextureFormat = wgpu::TextureFormat::Rgba8Unorm;
const DEPTH: wgpu::TextureFormat = wgpu::TextureFormat::Depth32Float;
const PICK: wgpu::TextureFormat = wgpu::TextureFormat::R32Uint;
const SAMPLES: u32 = 4;
/// Edge of the shadow map, pixels.
pub const SHADOW_SIZE: u32 = 1024;
/// Edge of the square around the pointer that is searched for parts, pixels. Odd.
const PICK_SIZE: u32 = 9;
/// While the pointer rests, what moves under it is looked up again after so many pictures.
const REPICK_PICTURES: u32 = 8;

/// Everything the shaders share, as they read it.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct Globals {
    /// World to clip space.
    pub clip_from_world: [[f32; 4]; 4],
    /// World to the key light's clip space.
    pub light_from_world: [[f32; 4]; 4],
    /// Camera position; w is 1 for parallel projection.
    pub eye: [f32; 4],
    /// Viewing direction.
    pub forward: [f32; 4],
    /// Towards the key light; strength of its shadow.
    pub key_dir: [f32; 4],
    /// Width, height in pixels, pixels per point, 1 / shadow map size.
    pub viewport: [f32; 4],
    /// Light from above, linear.
    pub sky: [f32; 4],
    /// Light from below, linear.
    pub ground: [f32; 4],
    /// Key light, linear.
    pub key: [f32; 4],
    /// Rim light, linear.
    pub rim: [f32; 4],
    /// Backdrop, top.
    pub back_top: [f32; 4],
    /// Backdrop, bottom.
    pub back_bottom: [f32; 4],
    /// Floor lines.
    pub grid: [f32; 4],
    /// Height of the floor, its radius, strength of its shadow, number of blobs.
    pub floor: [f32; 4],
    /// Centre and radius of what darkens the floor.
    pub blobs: [[f32; 4]; BLOBS],
}

/// World to the clip space of a light that shines on a sphere from direction `to_light`.
pub fn light_from_world(centre_m: Vec3, radius_m: f32, to_light: Vec3) -> Mat4 {
    let view = Mat4::look_at_rh(centre_m + to_light * 2.0 * radius_m, centre_m, Vec3::Z);
    let r = radius_m;
    Mat4::orthographic_rh(-r, r, -r, r, r * 0.5, r * 3.5) * view
}

/// One picture, ready to draw.
#[derive(Clone, Debug, PartialEq)]
pub struct Picture {
    /// What the shaders share.
    pub globals: Globals,
    /// What is drawn.
    pub drawing: Drawing,
    /// Width and height, pixels.
    pub size_px: [u32; 2],
    /// Where to look for a part, pixels from the top left.
    pub pick_px: Option<Vec2>,
}

/// How a pipeline writes.
#[derive(Clone, Copy, PartialEq)]
enum Write {
    /// Colour and depth.
    Solid,
    /// Depth alone, multisampled.
    GhostDepth,
    /// Blended colour over the ghost's own depth.
    GhostColour,
    /// Depth alone, for the shadow map.
    Shadow,
    /// Part numbers.
    Pick,
}

/// One pipeline per [`Motion`], in its order.
type ByMotion = [wgpu::RenderPipeline; 3];

struct Pipelines {
    solid: ByMotion,
    ghost_depth: ByMotion,
    ghost_colour: ByMotion,
    shadow: ByMotion,
    pick: ByMotion,
    line: wgpu::RenderPipeline,
    line_hidden: wgpu::RenderPipeline,
    back: wgpu::RenderPipeline,
    floor: wgpu::RenderPipeline,
    blit: wgpu::RenderPipeline,
}

/// The textures of one picture size.
struct Targets {
    size_px: [u32; 2],
    colour: wgpu::TextureView,
    resolved: wgpu::TextureView,
    depth: wgpu::TextureView,
    blit_group: wgpu::BindGroup,
}

struct PickTargets {
    texture: wgpu::Texture,
    view: wgpu::TextureView,
    depth: wgpu::TextureView,
    readback: wgpu::Buffer,
    pending: Option<Receiver<bool>>,
    /// Where the last search was, and through which camera.
    last: Option<(Vec2, [[f32; 4]; 4])>,
    pictures_since: u32,
}

struct Inner {
    pipelines: Pipelines,
    targets: Option<Targets>,
    last: Option<Picture>,
    parts: Vec<std::ops::Range<u32>>,
    vertices: wgpu::Buffer,
    indices: wgpu::Buffer,
    instances: wgpu::Buffer,
    lines: wgpu::Buffer,
    globals: wgpu::Buffer,
    shadow_globals: wgpu::Buffer,
    pick_globals: wgpu::Buffer,
    frames: wgpu::Buffer,
    group: wgpu::BindGroup,
    shadow_group: wgpu::BindGroup,
    pick_group: wgpu::BindGroup,
    light_group: wgpu::BindGroup,
    shadow_view: wgpu::TextureView,
    blit_layout: wgpu::BindGroupLayout,
    sampler: wgpu::Sampler,
    pick: PickTargets,
    hovered: Option<Entity>,
}

/// The scene's share of the graphics device. Cheap to clone; clones share everything.
#[derive(Clone)]
pub struct Gpu {
    device: wgpu::Device,
    inner: Arc<Mutex<Inner>>,
}

impl Gpu {
    /// Builds pipelines and uploads the meshes.
    pub fn new(render_state: &egui_wgpu::RenderState, robot: &RobotSpec) -> Self {
        let inner = Inner::new(&render_state.device, render_state.target_format, robot);
        Self {
            device: render_state.device.clone(),
            inner: Arc::new(Mutex::new(inner)),
        }
    }

    fn lock(&self) -> MutexGuard<'_, Inner> {
        // Nothing in here is left half-changed by a panic that a later frame would not redo.
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The part found under the pointer most recently, and whether a newer answer is on its way.
    pub fn hovered(&self) -> (Option<Entity>, bool) {
        let mut inner = self.lock();
        inner.read_pick(&self.device);
        (inner.hovered, inner.pick.pending.is_some())
    }

    /// Forgets what was under the pointer.
    pub fn clear_hovered(&self) {
        let mut inner = self.lock();
        inner.hovered = None;
        inner.pick.last = None;
    }

    /// Whether drawing this picture will look for the part under the pointer.
    pub fn will_pick(&self, picture: &Picture) -> bool {
        self.lock().pick.place(picture).is_some()
    }

    /// The paint callback that draws a picture into its rectangle.
    pub fn callback(&self, picture: Picture) -> impl egui_wgpu::CallbackTrait + 'static {
        Paint {
            gpu: self.clone(),
            picture,
        }
    }
}

struct Paint {
    gpu: Gpu,
    picture: Picture,
}

impl egui_wgpu::CallbackTrait for Paint {
    fn prepare(
        &self,
        device: &wgpu::Device,
        queue: &wgpu::Queue,
        _screen: &egui_wgpu::ScreenDescriptor,
        _encoder: &mut wgpu::CommandEncoder,
        _resources: &mut egui_wgpu::CallbackResources,
    ) -> Vec<wgpu::CommandBuffer> {
        self.gpu.lock().draw(device, queue, &self.picture);
        Vec::new()
    }

    fn paint(
        &self,
        _info: egui::PaintCallbackInfo,
        pass: &mut wgpu::RenderPass<'static>,
        _resources: &egui_wgpu::CallbackResources,
    ) {
        let inner = self.gpu.lock();
        if let Some(targets) = &inner.targets {
            pass.set_pipeline(&inner.pipelines.blit);
            pass.set_bind_group(0, &targets.blit_group, &[]);
            pass.draw(0..3, 0..1);
        }
    }
}

impl Inner {
    fn new(device: &wgpu::Device, target: wgpu::TextureFormat, robot: &RobotSpec) -> Self {
        let layouts = Layouts::new(device);
        let pipelines = Pipelines::new(device, &layouts, target);
        let (mesh, parts) = mesh::build(robot);
        let init = |label, contents: &[u8], usage| {
            device.create_buffer_init(&wgpu::util::BufferInitDescriptor {
                label: Some(label),
                contents,
                usage,
            })
        };
        let vertices = init(
            "scene vertices",
            bytemuck::cast_slice(&mesh.vertices),
            wgpu::BufferUsages::VERTEX,
        );
        let indices = init(
            "scene indices",
            bytemuck::cast_slice(&mesh.indices),
            wgpu::BufferUsages::INDEX,
        );
        let uniform = |label, size: usize| buffer(device, label, size, wgpu::BufferUsages::UNIFORM);
        let globals = uniform("scene globals", size_of::<Globals>());
        let shadow_globals = uniform("scene shadow globals", size_of::<Globals>());
        let pick_globals = uniform("scene pick globals", size_of::<Globals>());
        let frames = uniform("scene frames", SEGMENTS * FRAMES * 3 * 16);
        let group = |globals: &wgpu::Buffer| {
            device.create_bind_group(&wgpu::BindGroupDescriptor {
                label: Some("scene shared"),
                layout: &layouts.shared,
                entries: &[
                    wgpu::BindGroupEntry {
                        binding: 0,
                        resource: globals.as_entire_binding(),
                    },
                    wgpu::BindGroupEntry {
                        binding: 1,
                        resource: frames.as_entire_binding(),
                    },
                ],
            })
        };
        let shadow = texture(device, "scene shadow map", [SHADOW_SIZE; 2], DEPTH, 1);
        let shadow_view = shadow.create_view(&wgpu::TextureViewDescriptor::default());
        let compare = device.create_sampler(&wgpu::SamplerDescriptor {
            label: Some("scene shadow sampler"),
            mag_filter: wgpu::FilterMode::Linear,
            min_filter: wgpu::FilterMode::Linear,
            compare: Some(wgpu::CompareFunction::LessEqual),
            ..Default::default()
        });
        let light_group = device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("scene light"),
            layout: &layouts.light,
            entries: &[
                wgpu::BindGroupEntry {
                    binding: 0,
                    resource: wgpu::BindingResource::TextureView(&shadow_view),
                },
                wgpu::BindGroupEntry {
                    binding: 1,
                    resource: wgpu::BindingResource::Sampler(&compare),
                },
            ],
        });
        let sampler = device.create_sampler(&wgpu::SamplerDescriptor {
            label: Some("scene blit sampler"),
            mag_filter: wgpu::FilterMode::Linear,
            min_filter: wgpu::FilterMode::Linear,
            ..Default::default()
        });
        Self {
            group: group(&globals),
            shadow_group: group(&shadow_globals),
            pick_group: group(&pick_globals),
            pipelines,
            targets: None,
            last: None,
            parts,
            vertices,
            indices,
            instances: buffer(device, "scene parts", 128 * size_of::<Instance>(), VERTEX),
            lines: buffer(device, "scene lines", 4096 * size_of::<Line>(), VERTEX),
            globals,
            shadow_globals,
            pick_globals,
            frames,
            light_group,
            shadow_view,
            blit_layout: layouts.blit,
            sampler,
            pick: PickTargets::new(device),
            hovered: None,
        }
    }

    /// Uploads and draws the picture if it differs from the last one; looks for the part under the pointer.
    fn draw(&mut self, device: &wgpu::Device, queue: &wgpu::Queue, picture: &Picture) {
        let same = self.last.as_ref().is_some_and(|last| {
            last.globals == picture.globals
                && last.size_px == picture.size_px
                && last.drawing == picture.drawing
        });
        if !same {
            self.upload(device, queue, picture);
            self.resize(device, picture.size_px);
            let mut encoder = device.create_command_encoder(&wgpu::CommandEncoderDescriptor {
                label: Some("scene"),
            });
            self.encode_shadow(&mut encoder, &picture.drawing);
            self.encode_picture(&mut encoder, &picture.drawing);
            queue.submit([encoder.finish()]);
            self.last = Some(picture.clone());
        }
        self.read_pick(device);
        if !same {
            self.pick.pictures_since += 1;
        }
        if let Some(at_px) = self.pick.place(picture)
            && self.pick.pending.is_none()
        {
            self.pick.last = Some((at_px, picture.globals.clip_from_world));
            self.pick.pictures_since = 0;
            self.start_pick(device, queue, picture, at_px);
        }
    }

    fn upload(&mut self, device: &wgpu::Device, queue: &wgpu::Queue, picture: &Picture) {
        let drawing = &picture.drawing;
        let instances: Vec<Instance> = drawing.parts.iter().map(|(_, _, i)| *i).collect();
        fill(
            device,
            queue,
            &mut self.instances,
            bytemuck::cast_slice(&instances),
        );
        fill(
            device,
            queue,
            &mut self.lines,
            bytemuck::cast_slice(&drawing.lines),
        );
        queue.write_buffer(&self.frames, 0, bytemuck::cast_slice(&drawing.frames));
        queue.write_buffer(&self.globals, 0, bytemuck::bytes_of(&picture.globals));
        let mut light = picture.globals;
        light.clip_from_world = light.light_from_world;
        queue.write_buffer(&self.shadow_globals, 0, bytemuck::bytes_of(&light));
    }

    fn resize(&mut self, device: &wgpu::Device, size_px: [u32; 2]) {
        if self.targets.as_ref().is_some_and(|t| t.size_px == size_px) {
            return;
        }
        let view = |label, format, samples| {
            texture(device, label, size_px, format, samples)
                .create_view(&wgpu::TextureViewDescriptor::default())
        };
        let resolved = view("scene picture", COLOUR, 1);
        let blit_group = device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("scene blit"),
            layout: &self.blit_layout,
            entries: &[
                wgpu::BindGroupEntry {
                    binding: 0,
                    resource: wgpu::BindingResource::TextureView(&resolved),
                },
                wgpu::BindGroupEntry {
                    binding: 1,
                    resource: wgpu::BindingResource::Sampler(&self.sampler),
                },
            ],
        });
        self.targets = Some(Targets {
            size_px,
            colour: view("scene colour", COLOUR, SAMPLES),
            depth: view("scene depth", DEPTH, SAMPLES),
            resolved,
            blit_group,
        });
    }

    /// Draws the parts of one layer, runs of equal parts as instances of one mesh.
    fn draw_parts(
        &self,
        pass: &mut wgpu::RenderPass<'_>,
        drawing: &Drawing,
        layer: Layer,
        pipelines: &ByMotion,
    ) {
        pass.set_vertex_buffer(0, self.vertices.slice(..));
        pass.set_vertex_buffer(1, self.instances.slice(..));
        pass.set_index_buffer(self.indices.slice(..), wgpu::IndexFormat::Uint32);
        let mut first = 0;
        for run in drawing.parts.chunk_by(|a, b| (a.0, a.1) == (b.0, b.1)) {
            let (run_layer, part, _) = run[0];
            let last = first + run.len() as u32;
            if run_layer == layer
                && let Some(place) = Part::ALL.iter().position(|p| *p == part)
            {
                pass.set_pipeline(&pipelines[part.motion() as usize]);
                pass.draw_indexed(self.parts[place].clone(), 0, first..last);
            }
            first = last;
        }
    }

    fn encode_shadow(&self, encoder: &mut wgpu::CommandEncoder, drawing: &Drawing) {
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("scene shadow"),
            depth_stencil_attachment: Some(depth_attachment(&self.shadow_view)),
            ..Default::default()
        });
        pass.set_bind_group(0, &self.shadow_group, &[]);
        self.draw_parts(&mut pass, drawing, Layer::Solid, &self.pipelines.shadow);
    }

    fn encode_picture(&self, encoder: &mut wgpu::CommandEncoder, drawing: &Drawing) {
        let Some(targets) = &self.targets else {
            return;
        };
        let p = &self.pipelines;
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("scene picture"),
            color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                view: &targets.colour,
                depth_slice: None,
                resolve_target: Some(&targets.resolved),
                ops: wgpu::Operations {
                    load: wgpu::LoadOp::Clear(wgpu::Color::BLACK),
                    store: wgpu::StoreOp::Discard,
                },
            })],
            depth_stencil_attachment: Some(depth_attachment(&targets.depth)),
            ..Default::default()
        });
        pass.set_bind_group(0, &self.group, &[]);
        pass.set_bind_group(1, &self.light_group, &[]);
        pass.set_pipeline(&p.back);
        pass.draw(0..3, 0..1);
        self.draw_parts(&mut pass, drawing, Layer::Solid, &p.solid);
        pass.set_pipeline(&p.floor);
        pass.draw(0..4, 0..1);
        self.draw_parts(&mut pass, drawing, Layer::Ghost, &p.ghost_depth);
        self.draw_parts(&mut pass, drawing, Layer::Ghost, &p.ghost_colour);
        if !drawing.lines.is_empty() {
            pass.set_vertex_buffer(0, self.lines.slice(..));
            for pipeline in [&p.line_hidden, &p.line] {
                pass.set_pipeline(pipeline);
                pass.draw(0..4, 0..drawing.lines.len() as u32);
            }
        }
    }

    fn start_pick(
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
    fn read_pick(&mut self, device: &wgpu::Device) {
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

impl PickTargets {
    /// Where to search, if pointer or camera moved since the last search or the arm has moved on.
    fn place(&self, picture: &Picture) -> Option<Vec2> {
        let at_px = picture.pick_px?;
        let moved = self.last != Some((at_px, picture.globals.clip_from_world));
        (moved || self.pictures_since >= REPICK_PICTURES).then_some(at_px)
    }

    fn new(device: &wgpu::Device) -> Self {
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

const VERTEX: wgpu::BufferUsages = wgpu::BufferUsages::VERTEX;

fn buffer(
    device: &wgpu::Device,
    label: &str,
    size: usize,
    usage: wgpu::BufferUsages,
) -> wgpu::Buffer {
    device.create_buffer(&wgpu::BufferDescriptor {
        label: Some(label),
        size: size as u64,
        usage: usage | wgpu::BufferUsages::COPY_DST,
        mapped_at_creation: false,
    })
}

/// Writes bytes into a vertex buffer, which grows when they do not fit.
fn fill(device: &wgpu::Device, queue: &wgpu::Queue, into: &mut wgpu::Buffer, bytes: &[u8]) {
    if bytes.len() as u64 > into.size() {
        *into = buffer(
            device,
            "scene grown buffer",
            bytes.len().next_power_of_two(),
            VERTEX,
        );
    }
    queue.write_buffer(into, 0, bytes);
}

fn extent(size_px: [u32; 2]) -> wgpu::Extent3d {
    wgpu::Extent3d {
        width: size_px[0],
        height: size_px[1],
        depth_or_array_layers: 1,
    }
}

fn texture(
    device: &wgpu::Device,
    label: &str,
    size_px: [u32; 2],
    format: wgpu::TextureFormat,
    samples: u32,
) -> wgpu::Texture {
    let mut usage = wgpu::TextureUsages::RENDER_ATTACHMENT;
    if samples == 1 {
        usage |= match format {
            PICK => wgpu::TextureUsages::COPY_SRC,
            _ => wgpu::TextureUsages::TEXTURE_BINDING,
        };
    }
    device.create_texture(&wgpu::TextureDescriptor {
        label: Some(label),
        size: extent(size_px),
        mip_level_count: 1,
        sample_count: samples,
        dimension: wgpu::TextureDimension::D2,
        format,
        usage,
        view_formats: &[],
    })
}

fn depth_attachment(view: &wgpu::TextureView) -> wgpu::RenderPassDepthStencilAttachment<'_> {
    wgpu::RenderPassDepthStencilAttachment {
        view,
        depth_ops: Some(wgpu::Operations {
            load: wgpu::LoadOp::Clear(1.0),
            store: wgpu::StoreOp::Store,
        }),
        stencil_ops: None,
    }
}

struct Layouts {
    shared: wgpu::BindGroupLayout,
    light: wgpu::BindGroupLayout,
    blit: wgpu::BindGroupLayout,
    plain: wgpu::PipelineLayout,
    lit: wgpu::PipelineLayout,
    copy: wgpu::PipelineLayout,
}

impl Layouts {
    fn new(device: &wgpu::Device) -> Self {
        let group = |label, entries: &[wgpu::BindGroupLayoutEntry]| {
            device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
                label: Some(label),
                entries,
            })
        };
        let entry = |binding, visibility, ty| wgpu::BindGroupLayoutEntry {
            binding,
            visibility,
            ty,
            count: None,
        };
        let uniform = wgpu::BindingType::Buffer {
            ty: wgpu::BufferBindingType::Uniform,
            has_dynamic_offset: false,
            min_binding_size: None,
        };
        let sampled = |sample_type| wgpu::BindingType::Texture {
            sample_type,
            view_dimension: wgpu::TextureViewDimension::D2,
            multisampled: false,
        };
        let fragment = wgpu::ShaderStages::FRAGMENT;
        let shared = group(
            "scene shared",
            &[
                entry(0, wgpu::ShaderStages::VERTEX_FRAGMENT, uniform),
                entry(1, wgpu::ShaderStages::VERTEX, uniform),
            ],
        );
        let light = group(
            "scene light",
            &[
                entry(0, fragment, sampled(wgpu::TextureSampleType::Depth)),
                entry(
                    1,
                    fragment,
                    wgpu::BindingType::Sampler(wgpu::SamplerBindingType::Comparison),
                ),
            ],
        );
        let blit = group(
            "scene blit",
            &[
                entry(
                    0,
                    fragment,
                    sampled(wgpu::TextureSampleType::Float { filterable: true }),
                ),
                entry(
                    1,
                    fragment,
                    wgpu::BindingType::Sampler(wgpu::SamplerBindingType::Filtering),
                ),
            ],
        );
        let layout = |groups: &[Option<&wgpu::BindGroupLayout>]| {
            device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
                label: Some("scene"),
                bind_group_layouts: groups,
                immediate_size: 0,
            })
        };
        Self {
            plain: layout(&[Some(&shared)]),
            lit: layout(&[Some(&shared), Some(&light)]),
            copy: layout(&[Some(&blit)]),
            shared,
            light,
            blit,
        }
    }
}

/// What differs between the pipelines.
struct Recipe<'a> {
    label: &'a str,
    module: &'a wgpu::ShaderModule,
    layout: &'a wgpu::PipelineLayout,
    vertex: &'a str,
    fragment: Option<&'a str>,
    buffers: &'a [Option<wgpu::VertexBufferLayout<'a>>],
    topology: wgpu::PrimitiveTopology,
    cull: Option<wgpu::Face>,
    target: Option<wgpu::ColorTargetState>,
    depth: Option<(wgpu::CompareFunction, bool)>,
    bias: wgpu::DepthBiasState,
    samples: u32,
}

impl Recipe<'_> {
    fn build(&self, device: &wgpu::Device) -> wgpu::RenderPipeline {
        let targets = [self.target.clone()];
        device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
            label: Some(self.label),
            layout: Some(self.layout),
            vertex: wgpu::VertexState {
                module: self.module,
                entry_point: Some(self.vertex),
                compilation_options: Default::default(),
                buffers: self.buffers,
            },
            primitive: wgpu::PrimitiveState {
                topology: self.topology,
                cull_mode: self.cull,
                ..Default::default()
            },
            depth_stencil: self.depth.map(|(compare, write)| wgpu::DepthStencilState {
                format: DEPTH,
                depth_write_enabled: Some(write),
                depth_compare: Some(compare),
                stencil: Default::default(),
                bias: self.bias,
            }),
            multisample: wgpu::MultisampleState {
                count: self.samples,
                ..Default::default()
            },
            fragment: self.fragment.map(|entry| wgpu::FragmentState {
                module: self.module,
                entry_point: Some(entry),
                compilation_options: Default::default(),
                targets: &targets,
            }),
            multiview_mask: None,
            cache: None,
        })
    }
}

fn target(format: wgpu::TextureFormat, blend: Option<wgpu::BlendState>) -> wgpu::ColorTargetState {
    wgpu::ColorTargetState {
        format,
        blend,
        write_mask: wgpu::ColorWrites::ALL,
    }
}

impl Pipelines {
    fn new(device: &wgpu::Device, layouts: &Layouts, window: wgpu::TextureFormat) -> Self {
        use wgpu::CompareFunction::{Always, Greater, Less, LessEqual};
        let module = |label, source: &str| {
            device.create_shader_module(wgpu::ShaderModuleDescriptor {
                label: Some(label),
                source: wgpu::ShaderSource::Wgsl(source.into()),
            })
        };
        let mesh = module("mesh.wgsl", include_str!("../../../shaders/mesh.wgsl"));
        let line = module("line.wgsl", include_str!("../../../shaders/line.wgsl"));
        let grid = module("grid.wgsl", include_str!("../../../shaders/grid.wgsl"));
        let blit = module("blit.wgsl", include_str!("../../../shaders/blit.wgsl"));
        let blend = Some(wgpu::BlendState::ALPHA_BLENDING);
        let strips = wgpu::PrimitiveTopology::TriangleStrip;
        let triangles = wgpu::PrimitiveTopology::TriangleList;

        let line_attributes = wgpu::vertex_attr_array![
            0 => Float32x3, 1 => Float32, 2 => Float32x3, 3 => Float32, 4 => Float32x4, 5 => Float32x4,
            6 => Float32
        ];
        let line_buffers = [Some(wgpu::VertexBufferLayout {
            array_stride: size_of::<Line>() as u64,
            step_mode: wgpu::VertexStepMode::Instance,
            attributes: &line_attributes,
        })];
        let flat = |label, module, layout, vertex, fragment, topology, depth| Recipe {
            label,
            module,
            layout,
            vertex,
            fragment: Some(fragment),
            buffers: &[],
            topology,
            cull: None,
            target: Some(target(COLOUR, blend)),
            depth: Some(depth),
            bias: Default::default(),
            samples: SAMPLES,
        };
        let lines = |fragment, compare| {
            Recipe {
                buffers: &line_buffers,
                ..flat(
                    "scene lines",
                    &line,
                    &layouts.lit,
                    "vs_line",
                    fragment,
                    strips,
                    (compare, false),
                )
            }
            .build(device)
        };
        let copy = if window.is_srgb() {
            "fs_decoded"
        } else {
            "fs_plain"
        };
        let by_motion = |write| {
            [Motion::Rigid, Motion::Swept, Motion::Coiled]
                .map(|motion| part_pipeline(device, layouts, &mesh, motion, write))
        };
        Self {
            solid: by_motion(Write::Solid),
            ghost_depth: by_motion(Write::GhostDepth),
            ghost_colour: by_motion(Write::GhostColour),
            shadow: by_motion(Write::Shadow),
            pick: by_motion(Write::Pick),
            line: lines("fs_line", LessEqual),
            line_hidden: lines("fs_hidden", Greater),
            back: flat(
                "scene backdrop",
                &grid,
                &layouts.lit,
                "vs_back",
                "fs_back",
                triangles,
                (Always, false),
            )
            .build(device),
            floor: flat(
                "scene floor",
                &grid,
                &layouts.lit,
                "vs_floor",
                "fs_floor",
                strips,
                (Less, false),
            )
            .build(device),
            blit: Recipe {
                target: Some(target(window, None)),
                depth: None,
                samples: 1,
                ..flat(
                    "scene blit",
                    &blit,
                    &layouts.copy,
                    "vs_blit",
                    copy,
                    triangles,
                    (Always, false),
                )
            }
            .build(device),
        }
    }
}

fn part_pipeline(
    device: &wgpu::Device,
    layouts: &Layouts,
    module: &wgpu::ShaderModule,
    motion: Motion,
    write: Write,
) -> wgpu::RenderPipeline {
    use wgpu::CompareFunction::{Less, LessEqual};
    let vertex_attributes = wgpu::vertex_attr_array![0 => Float32x3, 1 => Float32x3, 2 => Float32];
    let instance_attributes = wgpu::vertex_attr_array![
        3 => Float32x4, 4 => Float32x4, 5 => Float32x4, 6 => Float32x4, 7 => Float32x4, 8 => Uint32
    ];
    let buffers = [
        Some(wgpu::VertexBufferLayout {
            array_stride: size_of::<Vertex>() as u64,
            step_mode: wgpu::VertexStepMode::Vertex,
            attributes: &vertex_attributes,
        }),
        Some(wgpu::VertexBufferLayout {
            array_stride: size_of::<Instance>() as u64,
            step_mode: wgpu::VertexStepMode::Instance,
            attributes: &instance_attributes,
        }),
    ];
    let lit = Some("fs_lit");
    let (layout, fragment, target, depth, samples) = match write {
        Write::Solid => (
            &layouts.lit,
            lit,
            Some(target(COLOUR, None)),
            (Less, true),
            SAMPLES,
        ),
        Write::GhostDepth => {
            let mut none = target(COLOUR, None);
            none.write_mask = wgpu::ColorWrites::empty();
            (&layouts.lit, lit, Some(none), (Less, true), SAMPLES)
        }
        Write::GhostColour => {
            let blended = target(COLOUR, Some(wgpu::BlendState::ALPHA_BLENDING));
            (
                &layouts.lit,
                lit,
                Some(blended),
                (LessEqual, false),
                SAMPLES,
            )
        }
        Write::Shadow => (&layouts.plain, None, None, (Less, true), 1),
        Write::Pick => {
            let ids = target(PICK, None);
            (&layouts.plain, Some("fs_pick"), Some(ids), (Less, true), 1)
        }
    };
    Recipe {
        label: "scene parts",
        module,
        layout,
        vertex: match motion {
            Motion::Rigid => "vs_rigid",
            Motion::Swept => "vs_skin",
            Motion::Coiled => "vs_spring",
        },
        fragment,
        buffers: &buffers,
        topology: wgpu::PrimitiveTopology::TriangleList,
        cull: Some(wgpu::Face::Back),
        target,
        depth: Some(depth),
        bias: match write {
            // Where ghost and arm coincide the arm is in front.
            Write::GhostDepth | Write::GhostColour => wgpu::DepthBiasState {
                constant: 4096,
                slope_scale: 4.0,
                clamp: 0.0,
            },
            _ => Default::default(),
        },
        samples,
    }
    .build(device)
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
