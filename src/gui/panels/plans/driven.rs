//! How a path is driven: where the tip was, and how far off the path.

use crate::signal::Snapshot;
use crate::task::{Follow, off_path_m};

/// Places of the line are at least so far apart, m.
const STEP_M: f32 = 1e-3;
/// Most places of the line.
const PLACES: usize = 8000;

/// Distances from a path.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Off {
    count: u32,
    square_sum_m2: f64,
    largest_m: f64,
}

impl Off {
    fn take(&mut self, off_m: f64) {
        self.count += 1;
        self.square_sum_m2 += off_m * off_m;
        self.largest_m = self.largest_m.max(off_m);
    }

    fn rms_m(&self) -> f64 {
        (self.square_sum_m2 / f64::from(self.count.max(1))).sqrt()
    }
}

/// The driven way beside the planned one.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Driven {
    /// Where the tip was, by motion capture where it sees the end pad, else by the estimate, base frame, m.
    pub line_m: Vec<[f32; 3]>,
    by_truth: Off,
    by_estimate: Off,
}

impl Driven {
    /// Takes where the tip is while it follows a path.
    pub fn take(&mut self, live: &Snapshot, follow: &Follow) {
        let waypoints_m = &follow.path.waypoints_m;
        let estimate = live.estimate.as_ref().map(|e| &e.base_from_tip);
        let truth = live.fresh_truth().map(|t| &t.base_from_tip);
        for (pose, off) in [
            (truth, &mut self.by_truth),
            (estimate, &mut self.by_estimate),
        ] {
            if let Some(pose) = pose {
                off.take(off_path_m(&pose.translation.vector.into(), waypoints_m));
            }
        }
        let Some(pose) = truth.or(estimate) else {
            return;
        };
        let at: [f32; 3] = <[f64; 3]>::from(pose.translation.vector).map(|x| x as f32);
        let far = |last: &[f32; 3]| {
            (0..3).map(|k| (at[k] - last[k]).powi(2)).sum::<f32>() > STEP_M * STEP_M
        };
        if self.line_m.len() < PLACES && self.line_m.last().is_none_or(far) {
            self.line_m.push(at);
        }
    }

    /// RMS and largest distance from the path, with what measured them; nothing before the first sample. `origin`: name of
    /// the ground truth.
    pub fn text(&self, origin: &str) -> Option<String> {
        // Where motion capture lost sight of the end pad most of the time, the estimate has the whole path.
        let truth = 2 * self.by_truth.count > self.by_estimate.count;
        let (off, by) = match truth {
            true => (&self.by_truth, origin),
            false => (&self.by_estimate, "the estimate"),
        };
        (off.count > 0).then(|| {
            format!(
                "{:.2} mm RMS off the path, {:.2} mm at most, by {by}",
                off.rms_m() * 1e3,
                off.largest_m * 1e3
            )
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::analysis::fixture;
    use crate::task::circle;

    #[test]
    fn distances_are_from_the_path_and_not_from_its_waypoints() {
        let centre_m = [0.0, 0.0, -0.3];
        let follow = Follow {
            path: circle(centre_m, 0.05, 60),
            speed_m_s: 3e-3,
            laps: 1,
        };
        let mut driven = Driven::default();
        assert_eq!(driven.text("Vicon"), None);
        // Around the circle, 1 mm above it, and once 3 mm.
        for k in 0..600 {
            let phi = f64::from(k) / 600.0 * std::f64::consts::TAU;
            let mut s = fixture::snapshot(f64::from(k) * 0.1);
            let above_m = if k == 300 { 3e-3 } else { 1e-3 };
            let at = nalgebra::Vector3::new(0.05 * phi.cos(), 0.05 * phi.sin(), -0.3 + above_m);
            s.truth = None;
            let e = s.estimate.as_mut().expect("an estimate");
            e.base_from_tip.translation.vector = at;
            driven.take(&s, &follow);
        }
        // The 60 chords lie up to 0.07 mm inside of the circle.
        assert_eq!(
            driven.text("Vicon").as_deref(),
            Some("1.01 mm RMS off the path, 3.00 mm at most, by the estimate")
        );
        assert!(driven.line_m.len() > 250, "{}", driven.line_m.len());
    }
}
