//! Closed paths through waypoints that lie uniformly along the path (paper, section V-C).

use std::f64::consts::TAU;

use nalgebra::Vector3;

use crate::signal::Goal;

/// Waypoints of the paper's circle and figure 8.
pub const PATH_WAYPOINTS: usize = 60;

/// A closed path: the tip visits the waypoints in order and ends at the first.
#[derive(Clone, Debug, PartialEq)]
pub struct Path {
    /// Name for the operator.
    pub name: String,
    /// Waypoints in the base frame, m; the first is not repeated.
    pub waypoints_m: Vec<[f64; 3]>,
}

/// Distance of a place from a closed path through waypoints, all in the base frame, m.
pub fn off_path_m(at_m: &[f64; 3], waypoints_m: &[[f64; 3]]) -> f64 {
    let at = Vector3::from(*at_m);
    let n = waypoints_m.len();
    let legs = (0..n).map(|k| {
        let [a, b] = [k, (k + 1) % n].map(|i| Vector3::from(waypoints_m[i]));
        let along = b - a;
        let share = ((at - a).dot(&along) / along.norm_squared().max(1e-18)).clamp(0.0, 1.0);
        (at - a - along * share).norm()
    });
    legs.fold(f64::INFINITY, f64::min)
}

impl Path {
    /// The waypoints as position goals, back to the first at the end.
    pub fn goals(&self) -> impl Iterator<Item = Goal> + '_ {
        self.waypoints_m
            .iter()
            .chain(self.waypoints_m.first())
            .map(|p| Goal::position(*p))
    }
}

/// A horizontal circle around `center_m` (base frame) that starts at its largest x.
pub fn circle(center_m: [f64; 3], radius_m: f64, waypoints: usize) -> Path {
    let [x, y, z] = center_m;
    let point = |k: usize| {
        let a = TAU * k as f64 / waypoints as f64;
        [x + radius_m * a.cos(), y + radius_m * a.sin(), z]
    };
    Path {
        name: format!("circle, radius {:.0} mm", radius_m * 1e3),
        waypoints_m: (0..waypoints).map(point).collect(),
    }
}

/// A horizontal figure 8 (lemniscate of Gerono) along x, crossing itself at `center_m` (base frame).
///
/// x = a sin t, y = a sin t cos t, so it is 2a long and a wide; the waypoints are at equal distances
/// along the curve.
pub fn figure_eight(center_m: [f64; 3], half_length_m: f64, waypoints: usize) -> Path {
    const FINE: usize = 20_000;
    let [x, y, z] = center_m;
    let point = |t: f64| {
        let (sin, cos) = t.sin_cos();
        [x + half_length_m * sin, y + half_length_m * sin * cos, z]
    };
    // Arc length up to each of many fine steps.
    let mut length_m = Vec::with_capacity(FINE + 1);
    length_m.push(0.0);
    let mut total_m = 0.0;
    for k in 1..=FINE {
        let a = point(TAU * (k - 1) as f64 / FINE as f64);
        let b = point(TAU * k as f64 / FINE as f64);
        total_m += (b[0] - a[0]).hypot(b[1] - a[1]);
        length_m.push(total_m);
    }
    let at = |k: usize| {
        let wanted_m = total_m * k as f64 / waypoints as f64;
        let i = length_m.partition_point(|l| *l < wanted_m);
        point(TAU * i as f64 / FINE as f64)
    };
    Path {
        name: format!("figure 8, {:.0} mm long", 2e3 * half_length_m),
        waypoints_m: (0..waypoints).map(at).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CENTER_M: [f64; 3] = [0.01, -0.02, -0.3];

    fn steps_m(path: &Path) -> Vec<f64> {
        let points: Vec<_> = path.goals().map(|g| g.position_m).collect();
        points
            .windows(2)
            .map(|w| {
                (0..3)
                    .map(|k| (w[1][k] - w[0][k]).powi(2))
                    .sum::<f64>()
                    .sqrt()
            })
            .collect()
    }

    #[test]
    fn circle_is_closed_even_and_round() {
        let path = circle(CENTER_M, 0.05, PATH_WAYPOINTS);
        let steps = steps_m(&path);
        assert_eq!(steps.len(), PATH_WAYPOINTS);
        // Chord of 6°.
        let chord_m = 2.0 * 0.05 * (TAU / 120.0).sin();
        assert!(steps.iter().all(|s| (s - chord_m).abs() < 1e-12));
        assert!(path.waypoints_m.iter().all(|p| p[2] == CENTER_M[2]));
    }

    #[test]
    fn figure_eight_is_even_symmetric_and_crosses_its_centre() {
        let path = figure_eight(CENTER_M, 0.06, PATH_WAYPOINTS);
        let steps = steps_m(&path);
        let mean_m = steps.iter().sum::<f64>() / steps.len() as f64;
        // Chords are a little shorter than arcs where the curve bends most.
        assert!(
            steps.iter().all(|s| (s / mean_m - 1.0).abs() < 0.03),
            "{steps:?}"
        );
        // Length of x = a sin t, y = a sin t cos t: 6.0972 a.
        assert!(
            (mean_m * 60.0 / 0.06 - 6.0972).abs() < 0.02,
            "{}",
            mean_m * 60.0 / 0.06
        );
        for (k, p) in path.waypoints_m.iter().enumerate() {
            let q = path.waypoints_m[(k + 30) % 60];
            assert!(
                (p[0] - CENTER_M[0] + q[0] - CENTER_M[0]).abs() < 1e-4,
                "{k}"
            );
        }
        let half = path.waypoints_m[30];
        assert!((half[0] - CENTER_M[0]).hypot(half[1] - CENTER_M[1]) < 1e-4);
        let reach_m = path
            .waypoints_m
            .iter()
            .map(|p| p[0])
            .fold(f64::MIN, f64::max);
        assert!((reach_m - CENTER_M[0] - 0.06).abs() < 1e-3);
    }
}
