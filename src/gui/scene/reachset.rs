//! Where the tip has been able to go: a grid around settled samples of the tip, for choosing how deep a click goes.
//!
//! The samples are some millimetres apart, so the set is their closing: every place within `CLOSE_M` of a sample,
//! less what lies within `OPEN_M` of the rim. It goes `CLOSE_M` − `OPEN_M` beyond the samples. It chooses depths
//! and is drawn; whether a target can be reached is decided by the controller.

use glam::Vec3;

use super::camera::Ray;

/// Edge of a cell, m.
const CELL_M: f32 = 8e-3;
/// Gaps between samples up to twice this are closed, m.
const CLOSE_M: f32 = 36e-3;
/// Taken off again at the rim, m.
const OPEN_M: f32 = 26e-3;
/// How often each value is replaced by the mean with its neighbours.
const SMOOTHINGS: usize = 4;
/// Steps in which a ray is followed, m.
const MARCH_M: f32 = 3e-3;
/// A depth that is clamped into an interval lies this far inside of it, or in its middle, m.
const INSIDE_M: f32 = 5e-3;
/// Largest grid: samples that are further apart than any arm are not the tip's.
const CELLS_MAX: usize = 4_000_000;

/// A field on a grid: positive inside, about the depth below the rim in m.
#[derive(Clone, Debug, PartialEq)]
pub struct ReachSet {
    origin_m: Vec3,
    cells: [usize; 3],
    depth_m: Vec<f32>,
}

/// A stretch of a ray inside the set: distances from the ray's origin, m.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Interval {
    /// Where it begins.
    pub near_m: f32,
    /// Where it ends.
    pub far_m: f32,
}

impl Interval {
    /// The depth in it that is nearest to a wanted one: a little inside of the rim.
    pub fn clamp(&self, wanted_m: f32) -> f32 {
        let inset_m = INSIDE_M.min(0.5 * (self.far_m - self.near_m));
        let (near_m, far_m) = (self.near_m + inset_m, self.far_m - inset_m);
        if (self.near_m..=self.far_m).contains(&wanted_m) {
            return wanted_m;
        }
        wanted_m.max(near_m).min(far_m)
    }

    /// How far a depth is outside of it, m.
    fn misses_m(&self, wanted_m: f32) -> f32 {
        (self.near_m - wanted_m).max(wanted_m - self.far_m).max(0.0)
    }
}

/// The interval that is nearest to a depth.
pub fn nearest(intervals: &[Interval], wanted_m: f32) -> Option<Interval> {
    let misses = |i: &&Interval| i.misses_m(wanted_m);
    intervals
        .iter()
        .min_by(|a, b| misses(a).total_cmp(&misses(b)))
        .copied()
}

/// Cells around a centre within a radius, as steps along the axes, and their distance, m.
fn ball(radius_m: f32) -> Vec<([i32; 3], f32)> {
    let r = (radius_m / CELL_M).ceil() as i32;
    let mut cells = Vec::new();
    for x in -r..=r {
        for y in -r..=r {
            for z in -r..=r {
                let away_m = Vec3::new(x as f32, y as f32, z as f32).length() * CELL_M;
                if away_m <= radius_m {
                    cells.push(([x, y, z], away_m));
                }
            }
        }
    }
    cells
}

impl ReachSet {
    /// The set around samples (base frame, m); `None` without any, or with samples that are metres apart.
    pub fn new(samples_m: &[[f32; 3]]) -> Option<Self> {
        let points: Vec<Vec3> = samples_m.iter().copied().map(Vec3::from).collect();
        let points: Vec<Vec3> = points.into_iter().filter(|p| p.is_finite()).collect();
        let lo = points.iter().copied().reduce(Vec3::min)?;
        let hi = points.iter().copied().reduce(Vec3::max)?;
        let rim = Vec3::splat(CLOSE_M + 3.0 * CELL_M);
        let origin_m = lo - rim;
        let cells = ((hi - lo + 2.0 * rim) / CELL_M).ceil().to_array();
        let cells = cells.map(|n| n as usize + 1);
        let total = cells[0].checked_mul(cells[1])?.checked_mul(cells[2])?;
        if total > CELLS_MAX {
            return None;
        }
        let mut set = Self {
            origin_m,
            cells,
            depth_m: vec![0.0; total],
        };
        set.close(&points);
        Some(set)
    }

    fn close(&mut self, points: &[Vec3]) {
        let mut inside = vec![false; self.depth_m.len()];
        let grow = ball(CLOSE_M);
        for p in points {
            let centre = ((*p - self.origin_m) / CELL_M).round().to_array();
            let centre = centre.map(|x| x as i32);
            for (step, _) in &grow {
                if let Some(i) = self.index(centre, *step) {
                    inside[i] = true;
                }
            }
        }
        // Distance to the nearest cell outside, as far as it matters.
        let most_m = OPEN_M + 2.0 * CELL_M;
        let shrink = ball(most_m);
        let beside = ball(1.01 * CELL_M);
        let mut rim_m = vec![most_m; inside.len()];
        for i in (0..inside.len()).filter(|i| !inside[*i]) {
            let at = self.place(i);
            rim_m[i] = 0.0;
            let is_rim = beside
                .iter()
                .any(|(step, _)| self.index(at, *step).is_some_and(|j| inside[j]));
            if is_rim {
                for (step, away_m) in &shrink {
                    if let Some(j) = self.index(at, *step) {
                        rim_m[j] = rim_m[j].min(*away_m);
                    }
                }
            }
        }
        self.depth_m = rim_m.iter().map(|m| m - OPEN_M).collect();
        // Rounds what the grid and lonely samples have made of it.
        for _ in 0..SMOOTHINGS {
            self.smooth();
        }
    }

    /// Each value becomes the mean with its six neighbours.
    fn smooth(&mut self) {
        let steps = ball(1.01 * CELL_M);
        let before = self.depth_m.clone();
        for i in 0..before.len() {
            let at = self.place(i);
            let around = steps.iter().filter_map(|(step, _)| self.index(at, *step));
            let (sum, n) = around.fold((0.0, 0.0), |(s, n), j| (s + before[j], n + 1.0));
            self.depth_m[i] = sum / n;
        }
    }

    fn index(&self, at: [i32; 3], step: [i32; 3]) -> Option<usize> {
        let mut of = [0; 3];
        for k in 0..3 {
            let n = at[k] + step[k];
            of[k] = usize::try_from(n).ok().filter(|n| *n < self.cells[k])?;
        }
        Some((of[2] * self.cells[1] + of[1]) * self.cells[0] + of[0])
    }

    fn place(&self, i: usize) -> [i32; 3] {
        let [nx, ny, _] = self.cells;
        [i % nx, i / nx % ny, i / (nx * ny)].map(|n| n as i32)
    }

    /// How deep a place is below the rim, m: positive inside, not above zero outside.
    pub fn depth_m(&self, at_m: Vec3) -> f32 {
        let at = (at_m - self.origin_m) / CELL_M;
        let low = at.floor();
        let t = at - low;
        let low = low.to_array().map(|x| x as i32);
        let mut sum = 0.0;
        for corner in 0..8 {
            let step = [corner & 1, (corner >> 1) & 1, corner >> 2];
            let Some(i) = self.index(low, step) else {
                return -OPEN_M;
            };
            let weight = |k: usize| if step[k] == 1 { t[k] } else { 1.0 - t[k] };
            sum += weight(0) * weight(1) * weight(2) * self.depth_m[i];
        }
        sum
    }

    /// Whether a place is inside.
    pub fn contains(&self, at_m: Vec3) -> bool {
        self.depth_m(at_m) > 0.0
    }

    /// The stretches of a ray inside the set, nearest first.
    pub fn intervals(&self, ray: &Ray) -> Vec<Interval> {
        let Some((from_m, to_m)) = self.span(ray) else {
            return Vec::new();
        };
        let depth = |t: f32| self.depth_m(ray.origin_m + ray.direction * t);
        let mut found = Vec::new();
        let (mut before_m, mut before) = (from_m, depth(from_m));
        let mut began_m = (before > 0.0).then_some(from_m);
        let steps = ((to_m - from_m) / MARCH_M).ceil() as usize;
        for k in 1..=steps {
            let at_m = (from_m + k as f32 * MARCH_M).min(to_m);
            let now = depth(at_m);
            // Linear between two steps.
            let rim_m = || before_m + (at_m - before_m) * before / (before - now);
            match (began_m, now > 0.0) {
                (None, true) => began_m = Some(rim_m()),
                (Some(near_m), false) => {
                    let far_m = rim_m();
                    found.push(Interval { near_m, far_m });
                    began_m = None;
                }
                _ => {}
            }
            (before_m, before) = (at_m, now);
        }
        if let Some(near_m) = began_m {
            let far_m = to_m;
            found.push(Interval { near_m, far_m });
        }
        found
    }

    /// Where a ray is inside the grid: distances from its origin, m.
    fn span(&self, ray: &Ray) -> Option<(f32, f32)> {
        let lo = self.origin_m.to_array();
        let (mut from_m, mut to_m) = (0.0_f32, f32::MAX);
        let (origin, direction) = (ray.origin_m.to_array(), ray.direction.to_array());
        for k in 0..3 {
            let hi = lo[k] + (self.cells[k] - 1) as f32 * CELL_M;
            if direction[k].abs() < 1e-9 {
                if !(lo[k]..=hi).contains(&origin[k]) {
                    return None;
                }
                continue;
            }
            let (a, b) = (
                (lo[k] - origin[k]) / direction[k],
                (hi - origin[k]) / direction[k],
            );
            from_m = from_m.max(a.min(b));
            to_m = to_m.min(a.max(b));
        }
        (from_m < to_m).then_some((from_m, to_m))
    }

    /// The set's outlines at equal steps of height, as short lines, m.
    pub fn contours(&self, every_m: f32) -> Vec<[[f32; 3]; 2]> {
        let mut lines = Vec::new();
        let top_m = self.origin_m.z + (self.cells[2] - 1) as f32 * CELL_M;
        let mut z_m = (self.origin_m.z / every_m).ceil() * every_m;
        while z_m < top_m {
            self.outline(z_m, &mut lines);
            z_m += every_m;
        }
        lines
    }

    /// The outline at one height, by marching squares over the grid's cells.
    fn outline(&self, z_m: f32, lines: &mut Vec<[[f32; 3]; 2]>) {
        let corner = |x: usize, y: usize| {
            let flat = Vec3::new(x as f32, y as f32, 0.0) * CELL_M + self.origin_m;
            let at = flat.with_z(z_m);
            (at, self.depth_m(at))
        };
        for y in 0..self.cells[1] - 1 {
            for x in 0..self.cells[0] - 1 {
                let square = [(x, y), (x + 1, y), (x + 1, y + 1), (x, y + 1)];
                let square = square.map(|(x, y)| corner(x, y));
                let mut crossings = Vec::new();
                for k in 0..4 {
                    let ((a, da), (b, db)) = (square[k], square[(k + 1) % 4]);
                    if (da > 0.0) != (db > 0.0) {
                        crossings.push(a.lerp(b, da / (da - db)).to_array());
                    }
                }
                for pair in crossings.chunks_exact(2) {
                    lines.push([pair[0], pair[1]]);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Samples on a lattice inside a ball.
    fn ball_samples(centre: Vec3, radius_m: f32) -> Vec<[f32; 3]> {
        let n = (radius_m / 0.01).ceil() as i32;
        let mut out = Vec::new();
        for x in -n..=n {
            for y in -n..=n {
                for z in -n..=n {
                    let step = Vec3::new(x as f32, y as f32, z as f32) * 0.01;
                    if step.length() <= radius_m {
                        out.push((centre + step).to_array());
                    }
                }
            }
        }
        out
    }

    const CENTRE: Vec3 = Vec3::new(0.02, -0.03, -0.3);

    fn ray(from: Vec3, to: Vec3) -> Ray {
        Ray {
            origin_m: from,
            direction: (to - from).normalize(),
        }
    }

    #[test]
    fn a_ball_of_samples_is_a_ball_a_little_larger_without_holes() {
        let set = ReachSet::new(&ball_samples(CENTRE, 0.1)).expect("samples");
        for p in ball_samples(CENTRE, 0.1) {
            assert!(set.contains(Vec3::from(p)), "{p:?}");
        }
        for direction in [Vec3::X, Vec3::Y, Vec3::Z, Vec3::new(1.0, 1.0, 1.0)] {
            let from = CENTRE + direction.normalize() * 0.8;
            let found = set.intervals(&ray(from, CENTRE));
            assert_eq!(found.len(), 1, "{found:?}");
            let Interval { near_m, far_m } = found[0];
            // Beyond the samples by the closing, give or take a cell.
            let beyond = CLOSE_M - OPEN_M;
            for rim_m in [0.8 - near_m, far_m - 0.8] {
                let off_m = rim_m - 0.1;
                assert!((-CELL_M..beyond + CELL_M).contains(&off_m), "{off_m}");
            }
        }
        assert!(
            set.intervals(&ray(CENTRE + Vec3::X, CENTRE + Vec3::Y * 0.5))
                .is_empty()
        );
    }

    #[test]
    fn a_ray_through_two_lobes_has_two_intervals_and_the_nearer_depth_wins() {
        let other = CENTRE + Vec3::X * 0.3;
        let mut samples = ball_samples(CENTRE, 0.06);
        samples.extend(ball_samples(other, 0.06));
        let set = ReachSet::new(&samples).expect("samples");
        let from = CENTRE - Vec3::X * 0.5;
        let found = set.intervals(&ray(from, other));
        assert_eq!(found.len(), 2, "{found:?}");
        assert!((found[0].near_m - 0.44).abs() < 0.02 && (found[1].far_m - 0.86).abs() < 0.02);
        let choose = |wanted_m: f32| nearest(&found, wanted_m).map(|i| i.clamp(wanted_m));
        // Inside: as it is. In front, between and behind: a little inside the nearer rim.
        assert_eq!(choose(0.5), Some(0.5));
        assert_eq!(choose(0.1), Some(found[0].near_m + INSIDE_M));
        assert_eq!(choose(0.6), Some(found[0].far_m - INSIDE_M));
        assert_eq!(choose(0.7), Some(found[1].near_m + INSIDE_M));
        assert_eq!(choose(2.0), Some(found[1].far_m - INSIDE_M));
        assert_eq!(nearest(&[], 1.0), None);
        let thin = Interval {
            near_m: 1.0,
            far_m: 1.004,
        };
        assert!((thin.clamp(0.0) - 1.002).abs() < 1e-6 && (thin.clamp(3.0) - 1.002).abs() < 1e-6);
    }

    #[test]
    fn a_ray_that_starts_inside_begins_there() {
        let set = ReachSet::new(&ball_samples(CENTRE, 0.1)).expect("samples");
        let found = set.intervals(&ray(CENTRE, CENTRE + Vec3::Y));
        assert_eq!((found.len(), found[0].near_m), (1, 0.0));
    }

    #[test]
    fn outlines_lie_on_the_rim_at_their_heights() {
        let set = ReachSet::new(&ball_samples(CENTRE, 0.1)).expect("samples");
        let lines = set.contours(0.05);
        assert!(lines.len() > 100);
        for p in lines.iter().flatten().copied().map(Vec3::from) {
            assert!(set.depth_m(p).abs() < 2e-3, "{p} {}", set.depth_m(p));
            let steps = p.z / 0.05;
            assert!((steps - steps.round()).abs() < 1e-3, "{p}");
        }
    }

    #[test]
    fn samples_that_are_no_tip_make_no_set() {
        assert_eq!(ReachSet::new(&[]), None);
        assert_eq!(ReachSet::new(&[[f32::NAN; 3]]), None);
        assert_eq!(ReachSet::new(&[[0.0; 3], [1e6, 0.0, 0.0]]), None);
    }
}
