//! From a snapshot to what is drawn: parts with their places and colours, lines, section frames.

mod marks;
mod plan;
mod skin;

use std::f32::consts::TAU;
use std::ops::Range;

use glam::{Affine3A, Mat3A, Quat, Vec2, Vec3};

use super::camera::Camera;
use super::colours::{Palette, Rgb, sequential};
use super::convert;
use super::entity::Entity;
use super::input::{SceneInput, SceneOutput};
use super::mesh::{self, Part, Vertex};
use crate::robot::{PadId, RobotSpec};
use crate::signal::{ArmShape, Gripper, IMUS, OrientationGoal, Pose, SPRINGS};

/// Section frames per segment as the shader holds them.
pub const FRAMES: usize = 33;
/// Segments the shader holds: two of the arm, two of each ghost (a preview; a model that is tried, or what is measured).
pub const SEGMENTS: usize = 6;
/// Most blobs that cast the soft shadow on the floor.
pub const BLOBS: usize = 16;

/// One part at one place, as the shader reads it.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct Instance {
    /// Rows of world from mesh, or the parameters of swept and coiled parts.
    pub rows: [[f32; 4]; 3],
    /// sRGB and opacity.
    pub colour: [f32; 4],
    /// Gloss, rim light, glow, nothing.
    pub material: [f32; 4],
    /// [`Entity::id`], 0 for what cannot be picked.
    pub pick_id: u32,
}

/// A line as the shader reads it.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct Line {
    /// Start, m.
    pub from_m: [f32; 3],
    /// Width in points.
    pub width_pt: f32,
    /// End, m.
    pub to_m: [f32; 3],
    /// 1 for round ends, 0 for square ones.
    pub round: f32,
    /// Colour and opacity at the start.
    pub from_colour: [f32; 4],
    /// Colour and opacity at the end.
    pub to_colour: [f32; 4],
    /// Share of the opacity that is left where parts of the arm hide the line.
    pub through: f32,
}

/// Drawn solid, or see-through over everything solid.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Layer {
    /// Hides what is behind it.
    Solid,
    /// Lets it shine through.
    Ghost,
}

/// A surface that comes with every snapshot, in world coordinates.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SkinDrawing {
    /// Corners.
    pub vertices: Vec<Vertex>,
    /// Three per triangle.
    pub indices: Vec<u32>,
    /// Indices and look of each column.
    pub columns: Vec<(Range<u32>, Instance)>,
}

/// What one picture consists of.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Drawing {
    /// Parts; sorted by layer and part when complete.
    pub parts: Vec<(Layer, Part, Instance)>,
    /// The geometric simulator's surface; without one the bellows are swept along the sections.
    pub skin: Option<SkinDrawing>,
    /// Lines.
    pub lines: Vec<Line>,
    /// Three rows per section frame; always [`SEGMENTS`] × [`FRAMES`] × 3.
    pub frames: Vec<[f32; 4]>,
    /// Centre and radius of what darkens the floor, m.
    pub blobs: Vec<[f32; 4]>,
}

/// Look of a surface.
#[derive(Clone, Copy)]
struct Surface {
    colour: Rgb,
    gloss: f32,
    glow: f32,
}

impl Surface {
    fn matt(colour: Rgb) -> Self {
        Self {
            colour,
            gloss: 0.12,
            glow: 0.0,
        }
    }
    fn shiny(colour: Rgb) -> Self {
        Self {
            colour,
            gloss: 0.55,
            glow: 0.0,
        }
    }
}

/// Opacity of a ghost.
const GHOST_ALPHA: f32 = 0.34;

struct Composer<'a> {
    robot: &'a RobotSpec,
    palette: Palette,
    hovered: Option<Entity>,
    drawing: Drawing,
    layer: Layer,
    /// Colour of the ghost that is drawn.
    tint: Rgb,
}

/// Height of the floor: below the gripper of the fully stretched arm, m.
pub fn floor_m(robot: &RobotSpec) -> f32 {
    -(2.0 * robot.length_range_m[1] + robot.pad_thickness_m + robot.payload_com_m + 0.05) as f32
}

/// From ceiling to floor: centre and radius of a sphere, m.
pub fn bounds_m(robot: &RobotSpec) -> (Vec3, f32) {
    const TOP_M: f32 = 0.10;
    let floor_m = floor_m(robot);
    let centre_m = Vec3::new(0.0, 0.0, 0.5 * (TOP_M + floor_m));
    (centre_m, 0.5 * (TOP_M - floor_m))
}

/// The picture's content for an input.
pub fn compose(
    robot: &RobotSpec,
    input: &SceneInput<'_>,
    camera: &Camera,
    size_pt: Vec2,
    output: &SceneOutput,
) -> Drawing {
    let palette = Palette::of(input.theme);
    let mut c = Composer {
        robot,
        palette,
        tint: palette.predicted,
        hovered: output.hovered,
        drawing: Drawing::default(),
        layer: Layer::Solid,
    };
    c.drawing.frames = vec![[0.0; 4]; SEGMENTS * FRAMES * 3];
    c.fixture();
    let snapshot = input.snapshot;
    let gripper = snapshot
        .command
        .as_ref()
        .and_then(|command| command.gripper())
        .or(snapshot.link.gripper)
        .unwrap_or(Gripper::Open);
    if let Some(shape) = snapshot.shown_shape().filter(|s| is_drawable(s)) {
        match snapshot.shown_mesh() {
            Some(mesh) => c.skin(&mesh.skin, snapshot.mesh_trouble.is_some()),
            None => c.bellows(shape, 0),
        }
        c.pads(shape);
        c.springs(shape, input.selected_spring);
        if robot.has_imus {
            c.imus(shape);
        }
        c.gripper(&shape.base_from_pad[2], gripper, snapshot.payload_kg);
        c.blobs(shape);
    }
    if let Some((tried, _)) = input.tried.filter(|(s, _)| is_drawable(s)) {
        c.tint = c.palette.tried;
        c.ghost(tried, 4, gripper);
        c.tint = c.palette.predicted;
        c.outline(tried);
    } else if let Some(measured) = input.measured.filter(|s| is_drawable(s)) {
        c.tint = c.palette.truth;
        c.ghost(measured, 4, gripper);
        c.tint = c.palette.predicted;
    }
    if let Some(captured) = input.captured {
        c.tint = c.palette.truth;
        c.ghost_pad(captured, gripper);
        c.tint = c.palette.predicted;
    }
    if let Some(ghost) = input.ghost.filter(|s| is_drawable(s)) {
        c.ghost(ghost, 2, gripper);
    } else if let Some((goal, reach)) = &snapshot.preview {
        c.ghost_tip(&goal.orientation, reach.nearest_m, input, gripper);
    }
    if input.aids.hull {
        c.outlines(input.outlines);
    }
    if input.aids.walls {
        c.walls(input, camera, output.landing.as_ref());
    }
    if let Some(landing) = &output.landing {
        c.landing(landing);
    }
    if let Some(plan) = &input.plan {
        c.plan(plan);
    }
    c.tip_marks(input, camera, size_pt);
    c.trail(input.trail_predicted, c.palette.predicted);
    c.trail(input.trail_truth, c.palette.truth);
    c.targets(input, camera, size_pt);
    c.drawing
        .parts
        .sort_by_key(|(layer, part, _)| (*layer, *part));
    c.drawing
}

/// Whether both segments have the two sections a sweep needs.
fn is_drawable(shape: &ArmShape) -> bool {
    shape.base_from_section.iter().all(|s| s.len() >= 2)
}

/// Section frames at equal steps of the length along the centre line.
pub fn resample(sections: &[Pose]) -> Vec<(Vec3, Quat)> {
    let nodes: Vec<(Vec3, Quat)> = sections.iter().map(convert::parts).collect();
    let mut length_m = vec![0.0_f32];
    for pair in nodes.windows(2) {
        let last = length_m[length_m.len() - 1];
        length_m.push(last + pair[0].0.distance(pair[1].0));
    }
    let total_m = length_m[length_m.len() - 1].max(1e-9);
    let mut i = 0;
    (0..FRAMES)
        .map(|k| {
            let at_m = total_m * k as f32 / (FRAMES - 1) as f32;
            while i + 2 < nodes.len() && length_m[i + 1] < at_m {
                i += 1;
            }
            let span_m = (length_m[i + 1] - length_m[i]).max(1e-9);
            let t = ((at_m - length_m[i]) / span_m).clamp(0.0, 1.0);
            let (a, b) = (nodes[i], nodes[i + 1]);
            (a.0.lerp(b.0, t), a.1.slerp(b.1, t))
        })
        .collect()
}

/// Rows of an affine transform.
fn rows(t: &Affine3A) -> [[f32; 4]; 3] {
    let m = t.matrix3.transpose();
    let p = t.translation;
    [
        m.x_axis.extend(p.x).to_array(),
        m.y_axis.extend(p.y).to_array(),
        m.z_axis.extend(p.z).to_array(),
    ]
}

fn scaled(t: Affine3A, scale: Vec3) -> Affine3A {
    t * Affine3A::from_scale(scale)
}

fn with_alpha(c: Rgb, alpha: f32) -> [f32; 4] {
    [c[0], c[1], c[2], alpha]
}

impl Composer<'_> {
    fn push(&mut self, part: Part, place: [[f32; 4]; 3], surface: Surface, entity: Option<Entity>) {
        let instance = self.instance(place, surface, entity);
        self.drawing.parts.push((self.layer, part, instance));
    }

    /// One place of a part as the layer and the pointer make it look.
    fn instance(&self, place: [[f32; 4]; 3], surface: Surface, entity: Option<Entity>) -> Instance {
        let ghost = self.layer == Layer::Ghost;
        let hovered = entity.is_some() && entity == self.hovered && !ghost;
        let lift = if hovered { 0.16 } else { 0.0 };
        let colour = if ghost {
            std::array::from_fn(|i| 0.35 * surface.colour[i] + 0.65 * self.tint[i])
        } else {
            surface.colour.map(|x| x + (1.0 - x) * lift)
        };
        let alpha = if ghost { GHOST_ALPHA } else { 1.0 };
        Instance {
            rows: place,
            colour: with_alpha(colour, alpha),
            material: [
                surface.gloss,
                if ghost { 3.0 } else { 1.0 },
                surface.glow,
                0.0,
            ],
            pick_id: if ghost {
                0
            } else {
                entity.map_or(0, Entity::id)
            },
        }
    }

    fn rigid(&mut self, part: Part, t: Affine3A, surface: Surface, entity: Option<Entity>) {
        self.push(part, rows(&t), surface, entity);
    }

    fn line(&mut self, from: Vec3, to: Vec3, width_pt: f32, colour: [f32; 4]) {
        self.mark(from, to, width_pt, colour, 0.35);
    }

    /// A line that parts of the arm hide only in part.
    fn mark(&mut self, from: Vec3, to: Vec3, width_pt: f32, colour: [f32; 4], through: f32) {
        self.drawing.lines.push(Line {
            from_m: from.to_array(),
            width_pt,
            to_m: to.to_array(),
            round: 1.0,
            from_colour: colour,
            to_colour: colour,
            through,
        });
    }

    /// A filled circle.
    fn dot(&mut self, at: Vec3, width_pt: f32, colour: [f32; 4], through: f32) {
        self.mark(at, at, width_pt, colour, through);
    }

    /// The ceiling plate, its column and the fixed top pad.
    fn fixture(&mut self) {
        const COLUMN_M: f32 = 0.045;
        const PLATE_M: f32 = 0.014;
        let top_m = self.robot.pad_thickness_m as f32;
        let fixture = Surface::matt(self.palette.fixture);
        let pad = Surface::matt(self.palette.pad);
        let at = |z: f32| Affine3A::from_translation(Vec3::Z * z);
        self.rigid(Part::Ceiling, at(top_m + COLUMN_M + PLATE_M), fixture, None);
        for b in self.robot.bellows_m.into_iter().take(3) {
            let foot = convert::vec3_from_vector(&b) * 0.9;
            let post = at(top_m + COLUMN_M) * Affine3A::from_translation(foot);
            let size = Vec3::new(0.011, 0.011, COLUMN_M);
            self.rigid(Part::Cylinder, scaled(post, size), fixture, None);
            // The air line of the chamber below.
            let hose = at(top_m + 0.012) * Affine3A::from_translation(foot * 0.55);
            let size = Vec3::new(0.007, 0.007, 0.012);
            self.rigid(Part::Cylinder, scaled(hose, size), pad, None);
        }
        self.rigid(Part::TopPad, at(top_m), pad, Some(Entity::Pad(0)));
    }

    /// Bellows and central tubes along the sections; `slot` is the shader's first segment for them.
    fn bellows(&mut self, shape: &ArmShape, slot: usize) {
        for (k, sections) in shape.base_from_section.iter().enumerate() {
            let first = (slot + k) * FRAMES * 3;
            for (i, (position, rotation)) in resample(sections).into_iter().enumerate() {
                let frame = Affine3A::from_rotation_translation(rotation, position);
                self.drawing.frames[first + 3 * i..first + 3 * i + 3]
                    .copy_from_slice(&rows(&frame));
            }
            let segment = (slot + k) as f32;
            let skin = Surface {
                colour: self.palette.bellows,
                gloss: 0.22,
                glow: 0.0,
            };
            for j in 3 * k..3 * k + 3 {
                let b = convert::vec3_from_vector(&self.robot.bellows_m[j]);
                let place = [[b.x, b.y, segment, 1.0], [0.0; 4], [0.0; 4]];
                self.push(Part::Bellows, place, skin, Some(Entity::Bellows(j)));
            }
            let tube_m = 0.11 * self.robot.bellows_outer_diameter_m as f32;
            let place = [[0.0, 0.0, segment, tube_m], [0.0; 4], [0.0; 4]];
            self.push(Part::Tube, place, Surface::shiny(self.palette.tube), None);
        }
    }

    /// The two moving pads.
    fn pads(&mut self, shape: &ArmShape) {
        let pad = Surface::matt(self.palette.pad);
        for (i, part) in [(1, Part::MiddlePad), (2, Part::EndPad)] {
            let t = convert::affine(&shape.base_from_pad[i]);
            self.rigid(part, t, pad, Some(Entity::Pad(i)));
        }
    }

    fn springs(&mut self, shape: &ArmShape, selected: Option<usize>) {
        const COIL_M: f32 = 0.0042;
        const WIRE_M: f32 = 0.00120;
        let [shortest_m, longest_m] = self.robot.spring.range_m;
        for i in 0..SPRINGS {
            let [top, bottom] = shape.spring_ends_m[i].map(convert::vec3);
            let length_m = top.distance(bottom);
            if !length_m.is_finite() || length_m < 1e-4 {
                continue; // not filled in
            }
            let t = (f64::from(length_m) - shortest_m) / (longest_m - shortest_m);
            let is_selected = selected == Some(i);
            let thick = if is_selected || self.hovered == Some(Entity::Spring(i)) {
                1.5
            } else {
                1.0
            };
            let surface = Surface {
                colour: if is_selected {
                    self.palette.selected
                } else {
                    sequential(t as f32)
                },
                gloss: 0.5,
                glow: if is_selected { 0.7 } else { 0.45 },
            };
            let place = [
                top.extend(COIL_M * thick).to_array(),
                bottom.extend(WIRE_M * thick).to_array(),
                [mesh::SPRING_TURNS, 0.0, 0.0, 0.0],
            ];
            self.push(Part::Spring, place, surface, Some(Entity::Spring(i)));
            for end in [top, bottom] {
                let t = scaled(Affine3A::from_translation(end), Vec3::splat(0.0042));
                let bolt = Surface::shiny(self.palette.fixture);
                self.rigid(Part::Sphere, t, bolt, Some(Entity::Spring(i)));
            }
        }
    }

    /// Where IMU `i` sits: in a gap between two of the bellows that end on its pad. The robot file gives
    /// the orientation alone; the place serves the eye.
    fn imus(&mut self, shape: &ArmShape) {
        for i in 0..IMUS {
            let t = imu_place(self.robot, shape, i);
            let imu = Surface::shiny(self.palette.imu);
            self.rigid(Part::Imu, t, imu, Some(Entity::Imu(i)));
            let mount = convert::quat_from_matrix(&self.robot.imus[i].pad_from_imu);
            let origin = t.transform_point3(Vec3::Z * 0.0065);
            let (_, pad_rotation) = convert::parts(imu_pad(self.robot, shape, i));
            self.axes(origin, pad_rotation * mount, 0.022, 1.8, 0.3);
        }
    }

    fn axes(&mut self, origin: Vec3, rotation: Quat, length_m: f32, width_pt: f32, through: f32) {
        for (k, axis) in Vec3::AXES.into_iter().enumerate() {
            let colour = with_alpha(self.palette.axis(k), 1.0);
            let end = origin + rotation * axis * length_m;
            self.mark(origin, end, width_pt, colour, through);
        }
    }

    fn gripper(&mut self, base_from_end_pad: &Pose, state: Gripper, payload_kg: f64) {
        let pad = convert::affine(base_from_end_pad);
        let below =
            pad * Affine3A::from_translation(Vec3::NEG_Z * self.robot.pad_thickness_m as f32);
        let body = Surface::matt(self.palette.fixture);
        let soft = Surface {
            colour: self.palette.gripper,
            gloss: 0.25,
            glow: 0.0,
        };
        let part = match state {
            Gripper::Open => Part::FingerOpen,
            Gripper::Closed => Part::FingerClosed,
        };
        // An arm without a gripper states no mass of one.
        if self.robot.gripper_kg > 0.0 {
            self.rigid(Part::Palm, below, body, Some(Entity::Gripper));
            for k in 0..3 {
                let turn = Affine3A::from_rotation_z(TAU * (k as f32 + 0.5) / 3.0);
                self.rigid(part, below * turn, soft, Some(Entity::Gripper));
            }
        }
        if payload_kg > 0.0 {
            let centre = Vec3::NEG_Z * self.robot.payload_com_m as f32;
            let ball = scaled(pad * Affine3A::from_translation(centre), Vec3::splat(0.026));
            let payload = Surface::matt(self.palette.payload);
            self.rigid(Part::Sphere, ball, payload, Some(Entity::Payload));
        }
    }

    /// A whole arm, see-through; `slot` as for [`Self::bellows`].
    fn ghost(&mut self, shape: &ArmShape, slot: usize, gripper: Gripper) {
        self.layer = Layer::Ghost;
        self.bellows(shape, slot);
        self.pads(shape);
        self.gripper(&shape.base_from_pad[2], gripper, 0.0);
        self.layer = Layer::Solid;
    }

    /// Centre line and rims of the moving pads of a model that is tried: they are seen where its ghost lies within the arm.
    fn outline(&mut self, shape: &ArmShape) {
        const RIM: usize = 48;
        const THROUGH: f32 = 0.85;
        let colour = with_alpha(self.palette.tried, 1.0);
        for sections in &shape.base_from_section {
            for pair in resample(sections).windows(2) {
                self.mark(pair[0].0, pair[1].0, 2.2, colour, THROUGH);
            }
        }
        for (pad, bellows_m) in shape.base_from_pad[1..]
            .iter()
            .zip(self.robot.bellows_m.chunks(3))
        {
            let pad = convert::affine(pad);
            let centres: Vec<Vec3> = bellows_m.iter().map(convert::vec3_from_vector).collect();
            // The corner that lies furthest out in a direction, round by the pad's margin.
            let at = |k: usize| {
                let out = Vec2::from_angle(TAU * k as f32 / RIM as f32).extend(0.0);
                let furthest = |a: &&Vec3, b: &&Vec3| a.dot(out).total_cmp(&b.dot(out));
                let corner = centres.iter().max_by(furthest).copied().unwrap_or_default();
                pad.transform_point3(corner + out * mesh::pad_corner_m(self.robot))
            };
            let rim: Vec<Vec3> = (0..=RIM).map(at).collect();
            for pair in rim.windows(2) {
                self.mark(pair[0], pair[1], 1.8, colour, 0.5);
            }
        }
    }

    /// Ghost of the end pad and gripper where a preview ends.
    fn ghost_tip(
        &mut self,
        aim: &OrientationGoal,
        position_m: [f64; 3],
        input: &SceneInput<'_>,
        gripper: Gripper,
    ) {
        let estimate = input.snapshot.estimate.as_ref();
        let rotation =
            aim.nearest(&estimate.map_or_else(Default::default, |e| e.base_from_tip.rotation));
        let pose = Pose::from_parts(
            nalgebra::Translation3::from(nalgebra::Vector3::from(position_m)),
            rotation,
        );
        self.ghost_pad(&pose, gripper);
    }

    /// End pad and gripper, see-through.
    fn ghost_pad(&mut self, base_from_tip: &Pose, gripper: Gripper) {
        self.layer = Layer::Ghost;
        let pad = Surface::matt(self.palette.pad);
        self.rigid(Part::EndPad, convert::affine(base_from_tip), pad, None);
        self.gripper(base_from_tip, gripper, 0.0);
        self.layer = Layer::Solid;
    }

    fn blobs(&mut self, shape: &ArmShape) {
        let wide_m = 1.25 * self.robot.bellows_outer_diameter_m as f32;
        for sections in &shape.base_from_section {
            for t in [0.1, 0.5, 0.9] {
                let i = (t * (sections.len() - 1) as f64).round() as usize;
                let (p, _) = convert::parts(&sections[i]);
                self.drawing.blobs.push(p.extend(wide_m).to_array());
            }
        }
        let pad = convert::affine(&shape.base_from_pad[2]);
        for (down_m, radius_m) in [(0.03, 0.05), (0.07, 0.035), (0.10, 0.03)] {
            let p = pad.transform_point3(Vec3::NEG_Z * down_m);
            self.drawing.blobs.push(p.extend(radius_m).to_array());
        }
    }
}

fn imu_pad<'a>(robot: &RobotSpec, shape: &'a ArmShape, imu: usize) -> &'a Pose {
    match robot.imus[imu].pad {
        PadId::Middle => &shape.base_from_pad[1],
        PadId::End => &shape.base_from_pad[2],
    }
}

/// Base from the housing of an IMU (centre of its lower face, z out of the pad).
pub fn imu_place(robot: &RobotSpec, shape: &ArmShape, imu: usize) -> Affine3A {
    let first = match robot.imus[imu].pad {
        PadId::Middle => 0,
        PadId::End => 3,
    };
    let (a, b) = if imu.is_multiple_of(2) {
        (2, 0)
    } else {
        (1, 2)
    };
    let [a, b] = [a, b].map(|k| convert::vec3_from_vector(&robot.bellows_m[first + k]));
    let middle = 0.5 * (a + b);
    let out = middle.normalize_or(Vec3::X);
    let place = middle + out * (mesh::pad_corner_m(robot) - 0.012);
    // x along the rim's normal, z up.
    let turn = Mat3A::from_cols(out.into(), Vec3::Z.cross(out).into(), Vec3::Z.into());
    convert::affine(imu_pad(robot, shape, imu))
        * Affine3A::from_mat3_translation(turn.into(), place)
}

#[cfg(test)]
mod tests;
