//! Draws a [`Drawing`] into a texture of its own (multisampled, with depth), copies it into the window,
//! and finds the part under the pointer.
//!
//! A picture is drawn only when something in it changed. The part under the pointer is found by drawing
//! the few pixels around it once more with the parts' numbers instead of colours; the answer is read back
//! without waiting and arrives one or two frames later.

mod pick;
mod pipelines;
mod targets;

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use egui_wgpu::wgpu;
use glam::{Mat4, Vec2, Vec3};
use wgpu::util::DeviceExt;

use super::compose::{BLOBS, Drawing, FRAMES, Instance, Layer, Line, SEGMENTS};
use super::entity::Entity;
use super::mesh::{self, Motion, Part, Vertex};
use crate::robot::RobotSpec;
use pipelines::{ByMotion, Layouts, Pipelines};
use targets::{COLOUR, DEPTH, PickTargets, SAMPLES, depth_attachment, texture};

/// Edge of the shadow map, pixels.
pub const SHADOW_SIZE: u32 = 1024;
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

/// The textures of one picture size.
struct Targets {
    size_px: [u32; 2],
    colour: wgpu::TextureView,
    resolved: wgpu::TextureView,
    depth: wgpu::TextureView,
    blit_group: wgpu::BindGroup,
}

struct Inner {
    pipelines: Pipelines,
    targets: Option<Targets>,
    last: Option<Picture>,
    parts: Vec<std::ops::Range<u32>>,
    vertices: wgpu::Buffer,
    indices: wgpu::Buffer,
    skin_vertices: wgpu::Buffer,
    skin_indices: wgpu::Buffer,
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
            skin_vertices: buffer(device, "scene skin", 2048 * size_of::<Vertex>(), VERTEX),
            skin_indices: buffer(device, "scene skin indices", 4 * 8192, INDEX),
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
        let columns = drawing.skin.iter().flat_map(|skin| &skin.columns);
        let instances: Vec<Instance> = drawing
            .parts
            .iter()
            .map(|(_, _, i)| *i)
            .chain(columns.map(|(_, i)| *i))
            .collect();
        fill(
            device,
            queue,
            &mut self.instances,
            bytemuck::cast_slice(&instances),
            VERTEX,
        );
        if let Some(skin) = &drawing.skin {
            let vertices = bytemuck::cast_slice(&skin.vertices);
            fill(device, queue, &mut self.skin_vertices, vertices, VERTEX);
            let indices = bytemuck::cast_slice(&skin.indices);
            fill(device, queue, &mut self.skin_indices, indices, INDEX);
        }
        fill(
            device,
            queue,
            &mut self.lines,
            bytemuck::cast_slice(&drawing.lines),
            VERTEX,
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
        if let (Some(skin), Layer::Solid) = (&drawing.skin, layer) {
            pass.set_vertex_buffer(0, self.skin_vertices.slice(..));
            pass.set_index_buffer(self.skin_indices.slice(..), wgpu::IndexFormat::Uint32);
            pass.set_pipeline(&pipelines[Motion::Rigid as usize]);
            // Their places follow those of the parts.
            for (place, (indices, _)) in (first..).zip(&skin.columns) {
                pass.draw_indexed(indices.clone(), 0, place..place + 1);
            }
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
}

const VERTEX: wgpu::BufferUsages = wgpu::BufferUsages::VERTEX;
const INDEX: wgpu::BufferUsages = wgpu::BufferUsages::INDEX;

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

/// Writes bytes into a buffer, which grows when they do not fit.
fn fill(
    device: &wgpu::Device,
    queue: &wgpu::Queue,
    into: &mut wgpu::Buffer,
    bytes: &[u8],
    usage: wgpu::BufferUsages,
) {
    if bytes.len() as u64 > into.size() {
        *into = buffer(
            device,
            "scene grown buffer",
            bytes.len().next_power_of_two(),
            usage,
        );
    }
    queue.write_buffer(into, 0, bytes);
}
