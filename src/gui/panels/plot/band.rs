//! A line with more values than pixels: for each slot of time a stretch from the smallest to the largest.
//! It looks like a line that goes up and down in every pixel, for a tenth of the work.

use std::ops::RangeInclusive;

use egui::epaint::Mesh;
use egui::{Color32, Shape, Ui, pos2};
use egui_plot::{PlotBounds, PlotGeometry, PlotItem, PlotItemBase, PlotPoint, PlotTransform};

use super::series::Dash;

/// Thickness where the values of a slot agree, points: that of a line.
const WIDTH: f32 = 1.5;
/// Slots of a dash and of the pause behind it.
const DASH: [i64; 2] = [6, 4];

/// One slot of time.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Slot {
    /// Number on the grid of time.
    index: i64,
    /// Smallest and largest value.
    range: [f64; 2],
}

/// A piece of an envelope as a band.
pub(super) struct Band {
    base: PlotItemBase,
    points: Vec<PlotPoint>,
    slots: Vec<Slot>,
    width_s: f64,
    color: Color32,
    dash: Dash,
}

impl Band {
    /// A band for a piece of an envelope with slots of `width_s`; `None` where a line does as well: when
    /// less than every other slot holds two values.
    pub(super) fn of(
        name: &str,
        piece: &[[f64; 2]],
        width_s: f64,
        color: Color32,
        dash: Dash,
    ) -> Option<Self> {
        let slots = slots(piece, width_s);
        (slots.len() > 1 && 2 * piece.len() > 3 * slots.len()).then(|| Self {
            base: PlotItemBase::new(name.to_owned()),
            points: piece.iter().map(|p| PlotPoint::new(p[0], p[1])).collect(),
            slots,
            width_s,
            color,
            dash,
        })
    }
}

fn slots(piece: &[[f64; 2]], width_s: f64) -> Vec<Slot> {
    let mut slots: Vec<Slot> = Vec::with_capacity(piece.len() / 2 + 1);
    for [t_s, value] in piece {
        // As the envelope counts them.
        let index = (t_s / width_s).floor() as i64;
        match slots.last_mut() {
            Some(s) if s.index == index => {
                s.range = [s.range[0].min(*value), s.range[1].max(*value)];
            }
            _ => slots.push(Slot {
                index,
                range: [*value; 2],
            }),
        }
    }
    slots
}

/// Where a line is drawn: all of it, or its dashes. These stand still on the grid of time, so they move
/// along with the signal.
fn strokes(slots: &[Slot], dash: Dash) -> Vec<&[Slot]> {
    match dash {
        Dash::Solid => vec![slots],
        Dash::Dashed => {
            let period = DASH[0] + DASH[1];
            slots
                .chunk_by(|a, b| a.index.div_euclid(period) == b.index.div_euclid(period))
                .map(|chunk| {
                    let on = chunk.partition_point(|s| s.index.rem_euclid(period) <= DASH[0]);
                    &chunk[..on]
                })
                .filter(|stroke| stroke.len() > 1)
                .collect()
        }
    }
}

/// A column of a stroke on screen: its x, its upper and its lower end, points.
type Column = [f32; 3];

/// The area between the ends of the columns, with edges that fade over `fade` points. Its triangles are made here: only the
/// vertical of its edges matters, since what is steep lies within a column.
fn filled(columns: impl ExactSizeIterator<Item = Column>, color: Color32, fade: f32) -> Mesh {
    let (n, half) = (columns.len(), 0.5 * fade);
    let mut mesh = Mesh::default();
    mesh.reserve_vertices(4 * n);
    mesh.reserve_triangles(6 * n.saturating_sub(1));
    for (k, [x, top, bottom]) in columns.enumerate() {
        let edges = [
            (top - half, Color32::TRANSPARENT),
            (top + half, color),
            (bottom - half, color),
            (bottom + half, Color32::TRANSPARENT),
        ];
        for (y, color) in edges {
            mesh.colored_vertex(pos2(x, y), color);
        }
        let Some(before) = k.checked_sub(1) else {
            continue;
        };
        let (a, b) = (4 * before as u32, 4 * k as u32);
        for e in 0..3 {
            mesh.add_triangle(a + e, a + e + 1, b + e);
            mesh.add_triangle(a + e + 1, b + e + 1, b + e);
        }
    }
    mesh
}

impl PlotItem for Band {
    fn shapes(&self, ui: &Ui, transform: &PlotTransform, shapes: &mut Vec<Shape>) {
        let fade = 1.0 / ui.pixels_per_point();
        let half = if self.highlighted() {
            WIDTH
        } else {
            0.5 * WIDTH
        };
        for stroke in strokes(&self.slots, self.dash) {
            let columns = stroke.iter().map(|s| {
                let x = transform.position_from_point_x((s.index as f64 + 0.5) * self.width_s);
                // Up on the screen is down in its coordinates.
                let [bottom, top] = s.range.map(|v| transform.position_from_point_y(v));
                [x, top - half, bottom + half]
            });
            shapes.push(Shape::mesh(filled(columns, self.color, fade)));
        }
    }

    fn initialize(&mut self, _x_range: RangeInclusive<f64>) {}

    fn color(&self) -> Color32 {
        self.color
    }

    fn geometry(&self) -> PlotGeometry<'_> {
        PlotGeometry::Points(&self.points)
    }

    fn bounds(&self) -> PlotBounds {
        let mut bounds = PlotBounds::NOTHING;
        for p in &self.points {
            bounds.extend_with(p);
        }
        bounds
    }

    fn base(&self) -> &PlotItemBase {
        &self.base
    }

    fn base_mut(&mut self) -> &mut PlotItemBase {
        &mut self.base
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn piece(points: impl Iterator<Item = (f64, f64)>) -> Vec<[f64; 2]> {
        points.map(|(t, v)| [t, v]).collect()
    }

    #[test]
    fn dense_pieces_are_bands_with_every_extreme_and_sparse_ones_are_not() {
        let dense = piece((0..40).map(|i| (f64::from(i) * 0.5 + 0.1, f64::from(i % 7))));
        let band = Band::of("x", &dense, 1.0, Color32::RED, Dash::Solid).expect("two per slot");
        assert_eq!(band.slots.len(), 20);
        for p in &dense {
            let slot = band.slots.iter().find(|s| s.index == p[0].floor() as i64);
            let [low, high] = slot.expect("every point has its slot").range;
            assert!(low <= p[1] && p[1] <= high);
        }
        let sparse = piece((0..40).map(|i| (f64::from(i), 1.0)));
        assert!(Band::of("x", &sparse, 1.0, Color32::RED, Dash::Solid).is_none());
    }

    #[test]
    fn columns_are_filled_between_their_ends_and_fade_beside_them() {
        let columns = [[0.0, 10.0, 14.0], [1.0, 20.0, 22.0], [2.0, 20.0, 21.5]];
        let mesh = filled(columns.into_iter(), Color32::RED, 1.0);
        assert!(mesh.is_valid());
        assert_eq!((mesh.vertices.len(), mesh.indices.len()), (12, 36));
        let area = |corners: &[u32]| {
            let [a, b, c] = [0, 1, 2].map(|k| mesh.vertices[corners[k] as usize].pos);
            0.5 * ((b - a).x * (c - a).y - (b - a).y * (c - a).x).abs()
        };
        let total: f32 = mesh.indices.chunks(3).map(area).sum();
        // Two trapezoids, each higher by the half of what fades above and below.
        assert!(
            (total - (4.0 + 2.0 + 2.0 + 1.5) / 2.0 - 2.0).abs() < 1e-4,
            "{total}"
        );
        let full = mesh.vertices.iter().filter(|v| v.color == Color32::RED);
        assert!(
            full.map(|v| v.pos.y)
                .eq([10.5, 13.5, 20.5, 21.5, 20.5, 21.0])
        );
        let single = filled([[0.0, 1.0, 2.0]].into_iter(), Color32::RED, 1.0);
        assert!(single.is_valid() && single.indices.is_empty());
    }

    #[test]
    fn dashes_stay_where_they_are_in_time() {
        let all = slots(&piece((-50..950).map(|i| (f64::from(i) + 0.5, 0.0))), 1.0);
        let on = |slots: &[Slot]| -> Vec<i64> {
            strokes(slots, Dash::Dashed)
                .concat()
                .iter()
                .map(|s| s.index)
                .collect()
        };
        let whole = on(&all);
        assert!(whole.len() > 500 && whole.len() < 800, "{}", whole.len());
        // A window that has moved on shows the same dashes; only the one at its edge is cut.
        let later: Vec<i64> = on(&all[37..]).into_iter().filter(|i| *i > 0).collect();
        let expected: Vec<i64> = whole.into_iter().filter(|i| *i > 0).collect();
        assert_eq!(later, expected);
        assert_eq!(strokes(&all, Dash::Solid).len(), 1);
    }
}
