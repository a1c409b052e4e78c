//! Textures that pictures are drawn into.

use std::sync::mpsc::Receiver;

use egui_wgpu::wgpu;
use glam::Vec2;

pub(super) const COLOUR: wgpu::TextureFormat = wgpu::TextureFormat::Rgba8Unorm;

pub(super) const DEPTH: wgpu::TextureFormat = wgpu::TextureFormat::Depth32Float;

pub(super) const PICK: wgpu::TextureFormat = wgpu::TextureFormat::R32Uint;

pub(super) const SAMPLES: u32 = 4;

pub(super) fn extent(size_px: [u32; 2]) -> wgpu::Extent3d {
    wgpu::Extent3d {
        width: size_px[0],
        height: size_px[1],
        depth_or_array_layers: 1,
    }
}

pub(super) fn texture(
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

pub(super) fn depth_attachment(
    view: &wgpu::TextureView,
) -> wgpu::RenderPassDepthStencilAttachment<'_> {
    wgpu::RenderPassDepthStencilAttachment {
        view,
        depth_ops: Some(wgpu::Operations {
            load: wgpu::LoadOp::Clear(1.0),
            store: wgpu::StoreOp::Store,
        }),
        stencil_ops: None,
    }
}

/// Small targets for the search and where it stands.
pub(super) struct PickTargets {
    pub(super) texture: wgpu::Texture,
    pub(super) view: wgpu::TextureView,
    pub(super) depth: wgpu::TextureView,
    pub(super) readback: wgpu::Buffer,
    /// The answer on its way.
    pub(super) pending: Option<Receiver<bool>>,
    /// Where the last search was, and through which camera.
    pub(super) last: Option<(Vec2, [[f32; 4]; 4])>,
    /// Pictures drawn since.
    pub(super) pictures_since: u32,
}
