// Lit meshes: rigid parts, bellows and tubes skinned along the section frames, coil springs.
//
// Colours arrive as sRGB, are lit in linear light and leave as sRGB values in a plain unorm target,
// which is how the window's own renderer blends.

struct Globals {
    clip_from_world: mat4x4f,
    light_from_world: mat4x4f,
    eye: vec4f,          // xyz: camera position, w: 1 when orthographic
    forward: vec4f,      // xyz: viewing direction
    key_dir: vec4f,      // xyz: towards the key light, w: strength of its shadow
    viewport: vec4f,     // width, height in pixels, pixels per point, 1 / shadow map size
    sky: vec4f,
    ground: vec4f,
    key: vec4f,
    rim: vec4f,
    back_top: vec4f,
    back_bottom: vec4f,
    grid: vec4f,         // rgb and alpha of the lines
    floor: vec4f,        // height in m, fade radius in m, strength of the soft shadow, number of blobs
    blobs: array<vec4f, 16>,
}

const FRAMES: u32 = 33u;
const TAU: f32 = 6.2831853;

@group(0) @binding(0) var<uniform> globals: Globals;
// Three rows of a 3x4 transform per frame; FRAMES frames for each of segment 1, segment 2, and those of two ghosts.
@group(0) @binding(1) var<uniform> frames: array<vec4f, 594>;
@group(1) @binding(0) var shadow_map: texture_depth_2d;
@group(1) @binding(1) var shadow_sampler: sampler_comparison;

struct VertexIn {
    @location(0) position: vec3f,
    @location(1) normal: vec3f,
    @location(2) shade: f32,
    @location(3) row0: vec4f,
    @location(4) row1: vec4f,
    @location(5) row2: vec4f,
    @location(6) colour: vec4f,
    @location(7) material: vec4f,   // gloss, rim, glow, unused
    @location(8) pick_id: u32,
}

struct VertexOut {
    @invariant @builtin(position) clip: vec4f,
    @location(0) world: vec3f,
    @location(1) normal: vec3f,
    @location(2) shade: f32,
    @location(3) colour: vec4f,
    @location(4) material: vec4f,
    @location(5) @interpolate(flat) pick_id: u32,
}

fn finish(v: VertexIn, world: vec3f, normal: vec3f) -> VertexOut {
    var out: VertexOut;
    out.clip = globals.clip_from_world * vec4f(world, 1.0);
    out.world = world;
    out.normal = normal;
    out.shade = v.shade;
    out.colour = v.colour;
    out.material = v.material;
    out.pick_id = v.pick_id;
    return out;
}

// Rigid parts: the rows are world from mesh, a rotation times a scale along the mesh's axes.
@vertex
fn vs_rigid(v: VertexIn) -> VertexOut {
    let p = vec4f(v.position, 1.0);
    let world = vec3f(dot(v.row0, p), dot(v.row1, p), dot(v.row2, p));
    // Normals go with the inverse transpose: R S^-1 n = (R S)(n / s^2).
    let s2 = v.row0.xyz * v.row0.xyz + v.row1.xyz * v.row1.xyz + v.row2.xyz * v.row2.xyz;
    let n = v.normal / max(s2, vec3f(1e-12));
    let normal = vec3f(dot(v.row0.xyz, n), dot(v.row1.xyz, n), dot(v.row2.xyz, n));
    return finish(v, world, normalize(normal));
}

// A point given in the section at s (0 top, 1 bottom) of a segment.
fn along(segment: u32, s: f32, local: vec4f) -> vec3f {
    let x = clamp(s, 0.0, 1.0) * f32(FRAMES - 1u);
    let i = min(u32(x), FRAMES - 2u);
    let t = x - f32(i);
    let a = (segment * FRAMES + i) * 3u;
    let r0 = mix(frames[a], frames[a + 3u], t);
    let r1 = mix(frames[a + 1u], frames[a + 4u], t);
    let r2 = mix(frames[a + 2u], frames[a + 5u], t);
    return vec3f(dot(r0, local), dot(r1, local), dot(r2, local));
}

// Surfaces of revolution swept along a segment. Mesh position is (radius, angle, s), mesh normal
// (d radius/dt, ds/dt, 0) along the profile; row0 is (centre x, centre y, segment, radius scale).
@vertex
fn vs_skin(v: VertexIn) -> VertexOut {
    let segment = u32(v.row0.z + 0.5);
    let radius = v.position.x * v.row0.w;
    let radial = vec2f(cos(v.position.y), sin(v.position.y));
    let s = v.position.z;
    let local = vec4f(v.row0.xy + radius * radial, 0.0, 1.0);
    let world = along(segment, s, local);
    let h = 1.0 / f32(FRAMES - 1u);
    let lo = max(s - h, 0.0);
    let hi = min(s + h, 1.0);
    let d_s = (along(segment, hi, local) - along(segment, lo, local)) / (hi - lo);
    let d_r = along(segment, s, vec4f(radial, 0.0, 0.0));
    let d_angle = along(segment, s, vec4f(-radial.y, radial.x, 0.0, 0.0));
    // Tangent along the profile: dP/dt = dP/ds ds/dt + dP/dr dr/dt; the outward normal is its product with dP/dangle.
    let d_t = d_s * v.normal.y + d_r * (v.normal.x * v.row0.w);
    return finish(v, world, normalize(cross(d_t, d_angle)));
}

fn coil(a: vec3f, b: vec3f, u: vec3f, w: vec3f, radius: f32, turns: f32, s: f32) -> vec3f {
    let taper = smoothstep(0.0, 0.05, s) * smoothstep(0.0, 0.05, 1.0 - s);
    let phase = TAU * turns * s;
    return mix(a, b, s) + radius * taper * (cos(phase) * u + sin(phase) * w);
}

// Coil springs. Mesh position is (s, angle around the wire, 0); row0 is the upper end and the coil
// radius, row1 the lower end and the wire radius, row2.x the number of turns.
@vertex
fn vs_spring(v: VertexIn) -> VertexOut {
    let a = v.row0.xyz;
    let b = v.row1.xyz;
    let axis = normalize(b - a);
    let reference = select(vec3f(1.0, 0.0, 0.0), vec3f(0.0, 1.0, 0.0), abs(axis.x) > 0.9);
    let u = normalize(cross(axis, reference));
    let w = cross(axis, u);
    let s = v.position.x;
    let centre = coil(a, b, u, w, v.row0.w, v.row2.x, s);
    let e = 0.0008;
    let tangent = normalize(coil(a, b, u, w, v.row0.w, v.row2.x, s + e) - coil(a, b, u, w, v.row0.w, v.row2.x, s - e));
    let side = normalize(cross(tangent, select(axis, u, abs(dot(tangent, axis)) > 0.95)));
    let up = cross(side, tangent);
    let normal = cos(v.position.y) * side + sin(v.position.y) * up;
    return finish(v, centre + v.row1.w * normal, normal);
}

fn linear_from_srgb(c: vec3f) -> vec3f {
    return pow(c, vec3f(2.2));
}

fn srgb_from_linear(c: vec3f) -> vec3f {
    return pow(clamp(c, vec3f(0.0), vec3f(1.0)), vec3f(1.0 / 2.2));
}

// Share of the key light that arrives, from nine comparisons in the shadow map.
fn key_share(world: vec3f, normal: vec3f) -> f32 {
    let p = globals.light_from_world * vec4f(world + normal * 0.0025, 1.0);
    let uv = vec2f(p.x * 0.5 + 0.5, 0.5 - p.y * 0.5);
    if any(uv < vec2f(0.0)) || any(uv > vec2f(1.0)) {
        return 1.0;
    }
    var sum = 0.0;
    for (var i = -1; i <= 1; i++) {
        for (var j = -1; j <= 1; j++) {
            let offset = vec2f(f32(i), f32(j)) * globals.viewport.w * 1.3;
            sum += textureSampleCompareLevel(shadow_map, shadow_sampler, uv + offset, p.z - 0.0015);
        }
    }
    return mix(1.0, sum / 9.0, globals.key_dir.w);
}

@fragment
fn fs_lit(in: VertexOut) -> @location(0) vec4f {
    let view = select(normalize(globals.eye.xyz - in.world), -globals.forward.xyz, globals.eye.w > 0.5);
    var n = normalize(in.normal);
    n = select(n, -n, dot(n, view) < 0.0);
    let albedo = linear_from_srgb(in.colour.rgb);
    let gloss = in.material.x;
    let l = globals.key_dir.xyz;
    let share = key_share(in.world, n);
    let facing = max((dot(n, l) + 0.1) / 1.1, 0.0) * share;
    let hemi = mix(globals.ground.rgb, globals.sky.rgb, n.z * 0.5 + 0.5) * in.shade;
    // A weak second light from the viewer keeps shadowed sides readable.
    let fill = 0.16 * max(dot(n, view), 0.0) * in.shade;
    let half_dir = normalize(l + view);
    let sharp = mix(10.0, 90.0, gloss);
    let spec = gloss * 0.45 * pow(max(dot(n, half_dir), 0.0), sharp) * share * in.shade;
    let edge = pow(1.0 - max(dot(n, view), 0.0), 3.0) * in.material.y * in.shade;
    var c = albedo * (hemi + fill + globals.key.rgb * facing * mix(in.shade, 1.0, 0.45));
    c += globals.key.rgb * spec + globals.rim.rgb * edge;
    c = mix(c, albedo, in.material.z);
    return vec4f(srgb_from_linear(c), in.colour.a);
}

@fragment
fn fs_pick(in: VertexOut) -> @location(0) u32 {
    return in.pick_id;
}
