//! Triangles as the shader reads them.

use glam::Vec3;

/// A vertex as the shader reads it. See the vertex entry points of `shaders/mesh.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct Vertex {
    /// Place, m, or (radius, angle, s), or (s, angle, 0).
    pub position: [f32; 3],
    /// Normal, or (d radius/dt, ds/dt, 0) along the profile.
    pub normal: [f32; 3],
    /// Share of ambient light that gets there, 0 to 1.
    pub shade: f32,
}

/// Triangles.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Mesh {
    /// Corners.
    pub vertices: Vec<Vertex>,
    /// Three per triangle.
    pub indices: Vec<u32>,
}

pub(super) fn vertex(position: Vec3, normal: Vec3, shade: f32) -> Vertex {
    Vertex {
        position: position.to_array(),
        normal: normal.to_array(),
        shade,
    }
}
