// Line segments with a width in pixels, drawn as camera-facing strips with soft edges.

struct Globals {
    clip_from_world: mat4x4f,
    light_from_world: mat4x4f,
    eye: vec4f,
    forward: vec4f,
    key_dir: vec4f,
    viewport: vec4f,     // width, height in pixels, pixels per point, 1 / shadow map size
    sky: vec4f,
    ground: vec4f,
    key: vec4f,
    rim: vec4f,
    back_top: vec4f,
    back_bottom: vec4f,
    grid: vec4f,
    floor: vec4f,
    blobs: array<vec4f, 16>,
}

@group(0) @binding(0) var<uniform> globals: Globals;

struct LineIn {
    @builtin(vertex_index) corner: u32,
    @location(0) from_m: vec3f,
    @location(1) width_pt: f32,
    @location(2) to_m: vec3f,
    @location(3) round: f32,          // 1: round ends, 0: cut square so that trails have no beads
    @location(4) from_colour: vec4f,
    @location(5) to_colour: vec4f,
    @location(6) through: f32,        // share of the opacity left where the arm hides the line
}

struct LineOut {
    @builtin(position) clip: vec4f,
    @location(0) colour: vec4f,
    // Along and across in pixels, length and half width in pixels.
    @location(1) @interpolate(linear) place: vec2f,
    @location(2) @interpolate(flat) size: vec3f,
    @location(3) @interpolate(flat) through: f32,
}

@vertex
fn vs_line(v: LineIn) -> LineOut {
    var a = globals.clip_from_world * vec4f(v.from_m, 1.0);
    var b = globals.clip_from_world * vec4f(v.to_m, 1.0);
    // Cut at the near plane so that the division below stays finite.
    let near = 1e-4;
    if a.w < near && b.w > near {
        a = mix(a, b, (near - a.w) / (b.w - a.w));
    } else if b.w < near && a.w > near {
        b = mix(b, a, (near - b.w) / (a.w - b.w));
    }
    let px = globals.viewport.xy * 0.5;
    let pa = a.xy / a.w * px;
    let pb = b.xy / b.w * px;
    let span = pb - pa;
    let len = length(span);
    let dir = select(vec2f(1.0, 0.0), span / max(len, 1e-6), len > 1e-6);
    let side = vec2f(-dir.y, dir.x);
    let half_width = 0.5 * v.width_pt * globals.viewport.z;
    let grow = half_width + 1.0;
    let at_end = (v.corner & 1u) == 1u;
    let up = select(-1.0, 1.0, (v.corner & 2u) == 2u);
    let cap = select(0.0, grow, v.round > 0.5);
    let along = select(-cap, len + cap, at_end);
    let end = select(a, b, at_end);
    let offset = (dir * select(-cap, cap, at_end) + side * up * grow) / px;
    var out: LineOut;
    out.clip = vec4f(end.xy + offset * end.w, end.z, end.w);
    out.colour = select(v.from_colour, v.to_colour, at_end);
    out.place = vec2f(along, up * grow);
    out.size = vec3f(len, half_width, v.round);
    out.through = v.through;
    if a.w < near && b.w < near {
        out.clip = vec4f(2.0, 2.0, 2.0, 1.0);
    }
    return out;
}

fn coverage(in: LineOut) -> f32 {
    let beyond = max(max(-in.place.x, in.place.x - in.size.x), 0.0) * in.size.z;
    let distance = length(vec2f(beyond, in.place.y));
    return clamp(in.size.y + 0.5 - distance, 0.0, 1.0);
}

@fragment
fn fs_line(in: LineOut) -> @location(0) vec4f {
    let alpha = in.colour.a * coverage(in);
    if alpha < 0.004 {
        discard;
    }
    return vec4f(in.colour.rgb, alpha);
}

// The part hidden behind the arm shows through faintly.
@fragment
fn fs_hidden(in: LineOut) -> @location(0) vec4f {
    let alpha = in.through * in.colour.a * coverage(in);
    if alpha < 0.004 {
        discard;
    }
    return vec4f(in.colour.rgb, alpha);
}
