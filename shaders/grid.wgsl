// The backdrop and the floor: a soft gradient, a fading grid, a soft shadow below the arm.

struct Globals {
    clip_from_world: mat4x4f,
    light_from_world: mat4x4f,
    eye: vec4f,
    forward: vec4f,
    key_dir: vec4f,
    viewport: vec4f,
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

@group(0) @binding(0) var<uniform> globals: Globals;

struct BackOut {
    @builtin(position) clip: vec4f,
    @location(0) uv: vec2f,
}

@vertex
fn vs_back(@builtin(vertex_index) i: u32) -> BackOut {
    let uv = vec2f(f32((i << 1u) & 2u), f32(i & 2u));
    var out: BackOut;
    out.clip = vec4f(uv * 2.0 - 1.0, 1.0, 1.0);
    out.uv = uv;
    return out;
}

// Less than one step of an 8-bit channel, so that the gradient shows no bands.
fn dither(p: vec2f) -> f32 {
    return (fract(52.9829189 * fract(dot(p, vec2f(0.06711056, 0.00583715)))) - 0.5) / 255.0;
}

@fragment
fn fs_back(in: BackOut) -> @location(0) vec4f {
    let t = smoothstep(0.0, 1.0, in.uv.y);
    let d = length((in.uv - vec2f(0.5, 0.55)) * vec2f(1.1, 1.0));
    let vignette = 1.0 - 0.10 * smoothstep(0.25, 0.85, d);
    let c = mix(globals.back_bottom.rgb, globals.back_top.rgb, t) * vignette;
    return vec4f(c + dither(in.clip.xy), 1.0);
}

struct FloorOut {
    @builtin(position) clip: vec4f,
    @location(0) at: vec2f,
}

@vertex
fn vs_floor(@builtin(vertex_index) i: u32) -> FloorOut {
    let corner = vec2f(f32(i & 1u), f32((i >> 1u) & 1u)) * 2.0 - 1.0;
    let at = corner * globals.floor.y;
    var out: FloorOut;
    out.clip = globals.clip_from_world * vec4f(at, globals.floor.x, 1.0);
    out.at = at;
    return out;
}

fn lines(at: vec2f, step_m: f32, width_px: f32) -> f32 {
    let x = at / step_m;
    let w = max(fwidth(x), vec2f(1e-6));
    let d = abs(fract(x - 0.5) - 0.5) / w;
    let cover = clamp(vec2f(0.5 + 0.5 * width_px) - d, vec2f(0.0), vec2f(1.0));
    // Lines closer than a few pixels melt away instead of flickering.
    let density = clamp(vec2f(1.0) - (w - 0.12) / 0.35, vec2f(0.0), vec2f(1.0));
    return max(cover.x * density.x, cover.y * density.y);
}

// Soft shadow: each blob (xyz, radius) hides part of the sky above a floor point. The share of a
// cosine-weighted hemisphere that a sphere covers is r^2 cos / d^2.
fn covered(at: vec2f) -> f32 {
    var open = 1.0;
    let count = i32(globals.floor.w + 0.5);
    for (var i = 0; i < count; i++) {
        let b = globals.blobs[i];
        let to = b.xyz - vec3f(at, globals.floor.x);
        let d2 = max(dot(to, to), b.w * b.w);
        open *= 1.0 - clamp(b.w * b.w * max(to.z, 0.0) / (d2 * sqrt(d2)), 0.0, 0.9);
    }
    return 1.0 - open;
}

@fragment
fn fs_floor(in: FloorOut) -> @location(0) vec4f {
    let r = length(in.at) / globals.floor.y;
    let fade = 1.0 - smoothstep(0.15, 1.0, r);
    let fine = lines(in.at, 0.05, 1.0) * 0.35;
    let coarse = lines(in.at, 0.25, 1.2);
    let line = max(fine, coarse) * globals.grid.a * fade;
    let shadow = covered(in.at) * globals.floor.z * (1.0 - smoothstep(0.5, 1.0, r));
    // Shadow (black) below, line over it.
    let alpha = line + shadow * (1.0 - line);
    if alpha < 0.003 {
        discard;
    }
    return vec4f(globals.grid.rgb * line / alpha, alpha);
}
