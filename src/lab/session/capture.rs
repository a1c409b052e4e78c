//! Motion capture on the frames' times: poses by their own stamps, interpolated.

use crate::signal::{Pose, pose_between};

/// Poses farther apart than this are not interpolated, s: motion capture saw nothing in between.
const GAP_S: f64 = 0.05;

/// Captured poses by their stamps.
#[derive(Clone, Debug, Default)]
pub struct Captured {
    poses: Vec<(f64, Pose)>,
    newest_s: Option<f64>,
}

impl Captured {
    /// Adds a pose, base from tip, with its stamp, s.
    pub fn push(&mut self, stamp_s: f64, pose: Pose) {
        self.newest_s = Some(self.newest_s.map_or(stamp_s, |t| t.max(stamp_s)));
        self.poses.push((stamp_s, pose));
    }

    /// Newest stamp, s; `None` before the first pose.
    pub fn newest_s(&self) -> Option<f64> {
        self.newest_s
    }

    /// The poses, base from tip, at rising times; `None` before the first, after the last and where motion capture saw
    /// nothing.
    pub fn at(mut self, t_s: &[f64]) -> Vec<Option<Pose>> {
        // Stamps that are off need not rise, and two may be the same.
        self.poses.sort_by(|a, b| a.0.total_cmp(&b.0));
        self.poses.dedup_by(|later, earlier| later.0 <= earlier.0);
        let poses = &self.poses;
        let between = |t_s: &f64| {
            let k = poses.partition_point(|(stamp_s, _)| stamp_s <= t_s);
            let (from_s, from) = poses.get(k.checked_sub(1)?)?;
            if from_s == t_s {
                return Some(*from);
            }
            let (to_s, to) = poses.get(k)?;
            if to_s - from_s > GAP_S {
                return None;
            }
            let share = (t_s - from_s) / (to_s - from_s);
            Some(pose_between(from, to, share))
        };
        t_s.iter().map(between).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::signal::pose_from_ypr;

    #[test]
    fn poses_are_interpolated_by_their_stamps_and_gaps_stay() {
        let mut c = Captured::default();
        // Unordered, one of them twice, and 80 ms in which nothing was seen.
        for stamp_s in [0.02, 0.0, 0.01, 0.02, 0.1] {
            c.push(
                stamp_s,
                pose_from_ypr([stamp_s, 0.0, 0.0], [stamp_s, 0.0, 0.0]),
            );
        }
        assert_eq!(c.newest_s(), Some(0.1));
        let at = c.at(&[-0.01, 0.0, 0.015, 0.02, 0.05, 0.1, 0.11]);
        let x = at.iter().map(|p| p.map(|p| p.translation.x));
        let wanted = [
            None,
            Some(0.0),
            Some(0.015),
            Some(0.02),
            None,
            Some(0.1),
            None,
        ];
        for (got, wanted) in x.zip(wanted) {
            assert_eq!(got.is_some(), wanted.is_some());
            assert!((got.unwrap_or_default() - wanted.unwrap_or_default()).abs() < 1e-12);
        }
        let turned = at[2].expect("seen").rotation.angle();
        assert!((turned - 0.015).abs() < 1e-9, "{turned}");
    }
}
