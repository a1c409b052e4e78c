//! The scene's pipelines and what they bind.

use egui_wgpu::wgpu;

use super::targets::{COLOUR, DEPTH, PICK, SAMPLES};
use crate::gui::scene::compose::{Instance, Line};
use crate::gui::scene::mesh::{Motion, Vertex};

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
pub(super) type ByMotion = [wgpu::RenderPipeline; 3];

/// Everything the scene draws with.
pub(super) struct Pipelines {
    pub(super) solid: ByMotion,
    pub(super) ghost_depth: ByMotion,
    pub(super) ghost_colour: ByMotion,
    pub(super) shadow: ByMotion,
    pub(super) pick: ByMotion,
    pub(super) line: wgpu::RenderPipeline,
    pub(super) line_hidden: wgpu::RenderPipeline,
    pub(super) back: wgpu::RenderPipeline,
    pub(super) floor: wgpu::RenderPipeline,
    pub(super) blit: wgpu::RenderPipeline,
}

/// What the shaders bind.
pub(super) struct Layouts {
    pub(super) shared: wgpu::BindGroupLayout,
    pub(super) light: wgpu::BindGroupLayout,
    pub(super) blit: wgpu::BindGroupLayout,
    pub(super) plain: wgpu::PipelineLayout,
    pub(super) lit: wgpu::PipelineLayout,
    pub(super) copy: wgpu::PipelineLayout,
}

impl Layouts {
    pub(super) fn new(device: &wgpu::Device) -> Self {
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
    pub(super) fn new(
        device: &wgpu::Device,
        layouts: &Layouts,
        window: wgpu::TextureFormat,
    ) -> Self {
        use wgpu::CompareFunction::{Always, Greater, Less, LessEqual};
        let module = |label, source: &str| {
            device.create_shader_module(wgpu::ShaderModuleDescriptor {
                label: Some(label),
                source: wgpu::ShaderSource::Wgsl(source.into()),
            })
        };
        let mesh = module("mesh.wgsl", include_str!("../../../../shaders/mesh.wgsl"));
        let line = module("line.wgsl", include_str!("../../../../shaders/line.wgsl"));
        let grid = module("grid.wgsl", include_str!("../../../../shaders/grid.wgsl"));
        let blit = module("blit.wgsl", include_str!("../../../../shaders/blit.wgsl"));
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
