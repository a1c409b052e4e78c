//! Online estimation of the arm's stiffness: one gain per segment, learned from its own motion while that excites it.
//!
//! ∂s/∂q of the real arm ≈ g_k ∂s/∂q of the plant map, one gain g per segment k: the springs of a segment answer
//! to its own three chambers, and a linear arm of another stiffness c answers like this one at the pressures q/c.
//! Least squares over pairs of instants a second apart, z = B₀ Δq over the segment's springs:
//! g = (Σ zᵀΔs) / (Σ zᵀz), with exponential forgetting per pair, not per second.
//!
//! **Gate.** A pair counts when z is well above the noise of the springs, and when Δs looks like z: a push or
//! a new load bends the segment otherwise. At rest nothing is learned and nothing forgotten. A full Jacobian of
//! 144 numbers (Broyden) learns noise where the motion does not reach; two numbers are excited by any motion.
//!
//! Source: recursive least squares with forgetting and conditional update, as in K. J. Åström and B. Wittenmark,
//! "Adaptive Control", 2nd ed., 1995, chapters 2 and 11.

use std::collections::VecDeque;

use nalgebra::SVector;

use crate::learn::{PlantEval, PlantMap};
use crate::signal::{CHAMBERS, PressureLimits, SPRINGS, SensorFrame, Stamp};

/// Segments of the arm.
pub const SEGMENTS: usize = 2;
const CHAMBERS_EACH: usize = CHAMBERS / SEGMENTS;
const SPRINGS_EACH: usize = SPRINGS / SEGMENTS;
/// Time between the two instants of a pair, s.
const SPAN_S: f64 = 1.0;
/// Time between two pairs, s.
const PERIOD_S: f64 = 0.1;
/// Factor on a pair's weight with every later pair.
const FORGETTING: f64 = 0.98;
/// Weight of the initial gains as a sum of squares, m²: a few seconds of slow motion.
const PRIOR_M2: f64 = 1e-4;
/// Norm over the springs of a segment below which z does not excite its gain, m.
const EXCITED_M: f64 = 2e-3;
/// Largest share of Δs that may be orthogonal to z.
const UNLIKE_RATIO: f64 = 0.5;
/// Bounds of a gain.
const GAIN_RANGE: [f64; 2] = [0.3, 3.0];

/// When the gains are learned.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Adaptation {
    /// Never: the plant map is used as it is.
    Off,
    /// While the motion excites them.
    Gated,
    /// Always, for comparison.
    Always,
}

/// One instant: time stamp, spring lengths (NaN where unusable), pressures.
type Instant = (Stamp, SVector<f64, SPRINGS>, [f64; CHAMBERS]);

/// Estimated gains with the data they come from.
#[derive(Clone, Debug, PartialEq)]
pub struct PlantGain {
    when: Adaptation,
    /// Σ zᵀz and Σ zᵀΔs per segment, m².
    sums_m2: [[f64; 2]; SEGMENTS],
    past: VecDeque<Instant>,
}

impl PlantGain {
    /// Nothing learned yet.
    pub fn new(when: Adaptation) -> Self {
        Self {
            when,
            sums_m2: [[PRIOR_M2, PRIOR_M2]; SEGMENTS],
            past: VecDeque::new(),
        }
    }

    /// The present gains, upper segment first; 1 where nothing has been learned.
    pub fn gains(&self) -> [f64; SEGMENTS] {
        self.sums_m2.map(|[zz, zs]| {
            let gain = zs / zz.max(f64::MIN_POSITIVE);
            match gain.is_finite() {
                true => gain.clamp(GAIN_RANGE[0], GAIN_RANGE[1]),
                false => 1.0,
            }
        })
    }

    /// Takes note of a frame. `plant` is the unadapted map, `payload_kg` the mass in the gripper.
    pub fn learn(
        &mut self,
        frame: &SensorFrame,
        payload_kg: f64,
        plant: &dyn PlantMap,
        limits: &PressureLimits,
    ) {
        if self.when == Adaptation::Off {
            return;
        }
        if let Some((last, ..)) = self.past.back() {
            let since_s = frame.stamp.since(*last);
            if (0.0..PERIOD_S).contains(&since_s) {
                return;
            }
            if !(0.0..=2.0 * PERIOD_S).contains(&since_s) {
                self.past.clear();
            }
        }
        if frame.health.chambers.iter().any(|h| !h.usable()) {
            self.past.clear();
            return;
        }
        let springs =
            SVector::<f64, SPRINGS>::from_fn(|i, _| match frame.health.springs[i].usable() {
                true => frame.sensors.spring_m[i],
                false => f64::NAN,
            });
        self.past
            .push_back((frame.stamp, springs, frame.chamber_pa));
        let pairs = (SPAN_S / PERIOD_S) as usize;
        if self.past.len() <= pairs {
            return;
        }
        let Some((_, old_springs, old_pa)) = self.past.pop_front() else {
            return;
        };
        // Half way along the plant map is as good as its mean.
        let middle = std::array::from_fn(|i| 0.5 * (frame.chamber_pa[i] + old_pa[i]));
        let present = self.gains();
        let local = adapted(plant, present, limits, &middle, payload_kg);
        for k in 0..SEGMENTS {
            let (mut zz, mut zs, mut ss) = (0.0, 0.0, 0.0);
            for i in SPRINGS_EACH * k..SPRINGS_EACH * (k + 1) {
                let seen = springs[i] - old_springs[i];
                let expected: f64 = (CHAMBERS_EACH * k..CHAMBERS_EACH * (k + 1))
                    .map(|c| local.jacobian[(i, c)] * (frame.chamber_pa[c] - old_pa[c]))
                    .sum::<f64>()
                    / present[k];
                if seen.is_finite() && expected.is_finite() {
                    zz += expected * expected;
                    zs += expected * seen;
                    ss += seen * seen;
                }
            }
            let unlike = ss - zs * zs / zz.max(f64::MIN_POSITIVE);
            let tells = zz >= EXCITED_M.powi(2) && unlike <= UNLIKE_RATIO.powi(2) * ss && zs > 0.0;
            if tells || self.when == Adaptation::Always {
                let [old_zz, old_zs] = self.sums_m2[k];
                self.sums_m2[k] = [FORGETTING * old_zz + zz, FORGETTING * old_zs + zs];
            }
        }
    }
}

/// Gains for verdicts on reachability: hysteresis makes every arm look a little stiffer on its way back than it is, so
/// small departures from the model are ignored.
pub fn judging_gains(gains: [f64; SEGMENTS]) -> [f64; SEGMENTS] {
    /// Departures up to this are the model's own error.
    const KNOWN: f64 = 0.15;
    gains.map(|g| if (g - 1.0).abs() <= KNOWN { 1.0 } else { g })
}

/// The plant map of an arm of this stiffness near `chamber_pa`: the map's signals and derivatives at the pressures
/// that bend its own arm alike, the derivatives after the true pressures. Beyond the robot's range the map knows
/// nothing: it answers as at the bound.
pub fn adapted(
    plant: &dyn PlantMap,
    gains: [f64; SEGMENTS],
    limits: &PressureLimits,
    chamber_pa: &[f64; CHAMBERS],
    payload_kg: f64,
) -> PlantEval {
    let gain = |i: usize| gains[i / CHAMBERS_EACH];
    let alike =
        std::array::from_fn(|i| (chamber_pa[i] * gain(i)).clamp(limits.min_pa, limits.max_pa));
    let mut eval = plant.sensors(&alike, payload_kg);
    for (i, mut column) in eval.jacobian.column_iter_mut().enumerate() {
        column *= gain(i);
    }
    eval
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::toy::ToyArm;
    use crate::robot::RobotSpec;
    use rand::{Rng, SeedableRng};
    use rand_pcg::Pcg64;

    /// Moves an arm whose gains are those of the map times `truth`, or lets it rest, under noise; what is learned.
    fn learned(when: Adaptation, truth: [f64; 2], moving_s: f64, rest_s: f64) -> [f64; 2] {
        let robot = RobotSpec::reference();
        let map = ToyArm::nominal(&robot);
        let mut arm = ToyArm::nominal(&robot);
        for (i, g) in arm.gain_m_pa.iter_mut().enumerate() {
            *g *= truth[i / 3];
        }
        let mut rng = Pcg64::seed_from_u64(4);
        let mut plant_gain = PlantGain::new(when);
        for k in 0..((moving_s + rest_s) * 20.0) as u32 {
            let t_s = f64::from(k) * 0.05;
            let at_s = t_s.min(moving_s);
            let q = std::array::from_fn(|i| 8e3 * (0.3 * at_s + i as f64).sin());
            let mut frame = arm.frame(Stamp::from_seconds(t_s), q, 0.0);
            for l in &mut frame.sensors.spring_m {
                *l += 0.2e-3 * rng.random_range(-1.7..1.7);
            }
            for p in &mut frame.chamber_pa {
                *p += 30.0 * rng.random_range(-1.7..1.7);
            }
            plant_gain.learn(&frame, 0.0, &map, &robot.pressure);
        }
        plant_gain.gains()
    }

    #[test]
    fn the_gains_of_another_arm_are_found_while_it_moves() {
        for truth in [[0.5, 0.5], [1.0, 1.0], [2.0, 1.4]] {
            let found = learned(Adaptation::Gated, truth, 60.0, 0.0);
            for k in 0..2 {
                assert!(
                    (found[k] / truth[k] - 1.0).abs() < 0.05,
                    "{found:?} for {truth:?}"
                );
            }
        }
    }

    #[test]
    fn rest_teaches_nothing_and_forgets_nothing_behind_the_gate() {
        let moved = learned(Adaptation::Gated, [2.0, 0.6], 60.0, 0.0);
        let rested = learned(Adaptation::Gated, [2.0, 0.6], 60.0, 600.0);
        let drifted = learned(Adaptation::Always, [2.0, 0.6], 60.0, 600.0);
        for k in 0..2 {
            assert!((rested[k] / moved[k] - 1.0).abs() < 0.03, "{rested:?}");
        }
        let off = (0..2)
            .map(|k| (drifted[k] / moved[k] - 1.0).abs())
            .fold(0.0, f64::max);
        assert!(off > 0.2, "without the gate noise is learned: {drifted:?}");
        assert_eq!(learned(Adaptation::Off, [2.0, 0.6], 60.0, 0.0), [1.0, 1.0]);
    }
}
