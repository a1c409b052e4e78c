//! The arm as a viewer draws it: single-precision geometry in m.

use rerun::external::arrow::array::ListArray;
use rerun::{
    AsComponents as _, ComponentDescriptor, Cylinders3D, LineStrips3D, Points3D,
    SerializedComponentBatch, SerializedComponentColumn, Transform3D,
};

use crate::recording::ArmDrawing;
use crate::signal::{ArmShape, Pose, Snapshot};

type V3 = [f32; 3];

const BELLOWS: &str = "/arm/bellows";
const SPRINGS: &str = "/arm/springs";
const PADS: &str = "/arm/pads";
const PREDICTED: &str = "/tip/predicted";
const VICON: &str = "/tip/vicon";
const GOAL: &str = "/goal/point";

/// What does not change: axes, colours, radii, an entity each.
pub(super) fn styles(
    drawing: Option<&ArmDrawing>,
) -> Vec<(&'static str, Vec<SerializedComponentBatch>)> {
    // Slimmer than they are, so that springs and axes can be seen.
    let bellows_radius = drawing.map_or(0.004, |d| 0.6 * d.bellows_radius_m) as f32;
    let pad_radius = drawing.map_or(0.09, |d| d.pad_radius_m) as f32;
    let pad_height = drawing.map_or(0.01, |d| d.pad_thickness_m) as f32;
    let colour = rerun::Color::from_u32;
    let lines = |radius: f32, rgba: u32| {
        LineStrips3D::update_fields()
            .with_radii([radius])
            .with_colors([colour(rgba)])
    };
    let pads = Cylinders3D::update_fields()
        .with_lengths([pad_height])
        .with_radii([pad_radius])
        .with_fill_mode(rerun::FillMode::Solid)
        .with_colors([colour(0xb8bc_c4ff)]);
    let goal = Points3D::update_fields()
        .with_radii([0.008f32])
        .with_colors([colour(0x4ccb_7aff)]);
    let axes = |length| rerun::TransformAxes3D::new(length).as_serialized_batches();
    vec![
        (
            "/",
            rerun::ViewCoordinates::RIGHT_HAND_Z_UP().as_serialized_batches(),
        ),
        (
            BELLOWS,
            lines(bellows_radius, 0x6b8f_b3ff).as_serialized_batches(),
        ),
        (SPRINGS, lines(0.002, 0xe0a8_3cff).as_serialized_batches()),
        (PADS, pads.as_serialized_batches()),
        (GOAL, goal.as_serialized_batches()),
        (PREDICTED, axes(0.15)),
        (VICON, axes(0.11)),
    ]
}

/// What was drawn since the last batch.
#[derive(Default)]
pub(super) struct Scene {
    arm: Timed<Drawn>,
    predicted: Timed<(V3, [f32; 4])>,
    vicon: Timed<(V3, [f32; 4])>,
    goal: Timed<Option<V3>>,
}

#[derive(Default)]
struct Drawn {
    bellows: Vec<Vec<V3>>,
    springs: Vec<Vec<V3>>,
    pads: Vec<(V3, [f32; 4])>,
}

/// Rows with their times, ns.
#[derive(Default)]
struct Timed<T> {
    times: Vec<i64>,
    rows: Vec<T>,
}

impl<T> Timed<T> {
    fn push(&mut self, t: i64, row: T) {
        self.times.push(t);
        self.rows.push(row);
    }
}

/// One entity's part of a batch.
pub(super) struct Part {
    pub(super) path: &'static str,
    pub(super) times: Vec<i64>,
    pub(super) columns: Vec<(ComponentDescriptor, ListArray)>,
}

fn point(v: &nalgebra::Vector3<f64>) -> V3 {
    [v.x as f32, v.y as f32, v.z as f32]
}

fn transform(pose: &Pose) -> (V3, [f32; 4]) {
    let q = &pose.rotation;
    (
        point(&pose.translation.vector),
        [q.i as f32, q.j as f32, q.k as f32, q.w as f32],
    )
}

fn drawn(shape: &ArmShape, drawing: Option<&ArmDrawing>) -> Drawn {
    let mut bellows = Vec::new();
    for (k, sections) in shape.base_from_section.iter().enumerate() {
        match drawing {
            Some(d) => {
                for centre in &d.bellows_m[3 * k..3 * k + 3] {
                    let c = nalgebra::Point3::from(*centre);
                    let line = sections.iter().map(|s| point(&(s * c).coords));
                    bellows.push(line.collect());
                }
            }
            // Without sizes, the centre line alone.
            None => bellows.push(
                sections
                    .iter()
                    .map(|s| point(&s.translation.vector))
                    .collect(),
            ),
        }
    }
    let springs = shape
        .spring_ends_m
        .iter()
        .map(|ends| ends.iter().map(|p| p.map(|x| x as f32)).collect())
        .collect();
    let thickness_m = drawing.map_or(0.01, |d| d.pad_thickness_m);
    let pads = shape
        .base_from_pad
        .iter()
        .enumerate()
        .map(|(i, base_from_pad)| {
            // The top pad's frame is on its lower face, the others' on their upper face.
            let side = if i == 0 { 0.5 } else { -0.5 };
            let centre = base_from_pad * nalgebra::Point3::new(0.0, 0.0, side * thickness_m);
            (point(&centre.coords), transform(base_from_pad).1)
        })
        .collect();
    Drawn {
        bellows,
        springs,
        pads,
    }
}

impl Scene {
    /// Draws a snapshot.
    pub(super) fn push(&mut self, snapshot: &Snapshot, drawing: Option<&ArmDrawing>) {
        let t = snapshot.stamp.0;
        if let Some(shape) = &snapshot.shape {
            self.arm.push(t, drawn(shape, drawing));
        }
        if let Some(e) = &snapshot.estimate {
            self.predicted.push(t, transform(&e.base_from_tip));
        }
        if let Some(g) = &snapshot.truth {
            self.vicon.push(t, transform(&g.base_from_tip));
        }
        let goal = snapshot.goal.as_ref();
        self.goal
            .push(t, goal.map(|g| g.position_m.map(|x| x as f32)));
    }

    /// Takes what was drawn.
    pub(super) fn take(&mut self) -> Vec<Part> {
        let mut parts = Vec::new();
        let Self {
            arm,
            predicted,
            vicon,
            goal,
        } = std::mem::take(self);
        if !arm.times.is_empty() {
            let lines = |path, rows: Vec<&Vec<Vec<V3>>>| {
                let lengths: Vec<usize> = rows.iter().map(|r| r.len()).collect();
                let strips = rows.into_iter().flatten().cloned();
                let archetype = LineStrips3D::update_fields().with_strips(strips);
                part(path, arm.times.clone(), archetype.columns(lengths))
            };
            parts.extend(lines(
                BELLOWS,
                arm.rows.iter().map(|r| &r.bellows).collect(),
            ));
            parts.extend(lines(
                SPRINGS,
                arm.rows.iter().map(|r| &r.springs).collect(),
            ));
            let lengths: Vec<usize> = arm.rows.iter().map(|r| r.pads.len()).collect();
            let pads = || arm.rows.iter().flat_map(|r| &r.pads);
            let archetype = Cylinders3D::update_fields()
                .with_centers(pads().map(|p| p.0))
                .with_quaternions(pads().map(|p| rerun::Quaternion::from_xyzw(p.1)));
            let columns = archetype.columns(lengths);
            parts.extend(part(PADS, arm.times.clone(), columns));
        }
        for (path, timed) in [(PREDICTED, predicted), (VICON, vicon)] {
            if !timed.times.is_empty() {
                let archetype = Transform3D::update_fields()
                    .with_many_translation(timed.rows.iter().map(|r| r.0))
                    .with_many_quaternion(
                        timed.rows.iter().map(|r| rerun::Quaternion::from_xyzw(r.1)),
                    );
                parts.extend(part(path, timed.times, archetype.columns_of_unit_batches()));
            }
        }
        if !goal.times.is_empty() {
            let lengths: Vec<usize> = goal.rows.iter().map(|g| g.iter().count()).collect();
            let archetype =
                Points3D::update_fields().with_positions(goal.rows.iter().flatten().copied());
            parts.extend(part(GOAL, goal.times, archetype.columns(lengths)));
        }
        parts
    }
}

fn part<I>(
    path: &'static str,
    times: Vec<i64>,
    columns: rerun::SerializationResult<I>,
) -> Option<Part>
where
    I: Iterator<Item = SerializedComponentColumn>,
{
    // A picture that cannot be drawn is no reason to lose the data.
    let columns = columns
        .map_err(|e| log::warn!("the recording goes on without {path}: {e}"))
        .ok()?;
    Some(Part {
        path,
        times,
        columns: columns.map(|c| (c.descriptor, c.list_array)).collect(),
    })
}
