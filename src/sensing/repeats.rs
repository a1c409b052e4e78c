//! Channels whose raw readings repeat to the last bit.
//!
//! A spring's count and gate repeat now and then: a clock's tick is a tenth of a millimetre. How often they do is learned
//! per channel, at rest and in motion. A channel, or all of a board's, that repeats for longer than chance allows, or
//! while the spring must have moved, is stuck.

use nalgebra::UnitQuaternion;

use super::platform::LEGS;
use crate::signal::ImuRaw;

/// Frames over which the share of repeats is learned, and how many it takes before it counts.
const MEMORY: f64 = 500.0;
const LEARNED: u32 = 200;
/// A run this improbable (natural logarithm) is no chance: of one channel, and of all channels of a board together.
const IMPROBABLE: f64 = 30.0;
const IMPROBABLE_TOGETHER: f64 = 45.0;
/// A single channel is not called stuck by chance alone when it repeats more often than this.
const SHARE_MAX: f64 = 0.9;
/// Faster than this is motion, m/s.
const MOTION_M_S: f64 = 1e-3;
/// Frames that a run takes before missed motion counts, and the motion, m.
const RUN: u32 = 8;
const MISSED_M: f64 = 0.4e-3;
/// Changed readings after which a stuck channel is alive again.
const ALIVE: u32 = 3;

/// Raw readings of one spring.
#[derive(Clone, Copy, Debug, Default)]
struct Leg {
    last: (u32, u32),
    run: u32,
    from_m: f64,
    /// Share of repeats and frames seen, at rest and in motion.
    share: [f64; 2],
    seen: [u32; 2],
    changes: u32,
    stuck: bool,
}

impl Leg {
    /// Improbability of the present run.
    fn improbable(&self, regime: usize) -> f64 {
        match self.seen[regime] >= LEARNED {
            true => -f64::from(self.run) * self.share[regime].clamp(0.02, 1.0).ln(),
            false => 0.0,
        }
    }
}

/// The six springs of one board.
#[derive(Clone, Copy, Debug, Default)]
pub struct Repeats {
    legs: [Leg; LEGS],
}

/// One spring's raw reading, and the length that the other sensors give it.
#[derive(Clone, Copy, Debug)]
pub struct RawLength {
    /// Count and gate, ticks.
    pub raw: (u32, u32),
    /// Length that it should have, m.
    pub expected_m: f64,
    /// Rate of that, m/s.
    pub rate_m_s: f64,
    /// Length of one tick, m.
    pub resolution_m: f64,
}

impl Repeats {
    /// Takes in one frame (`None` where a spring gave nothing) and returns which are stuck.
    pub fn update(&mut self, frame: &[Option<RawLength>; LEGS]) -> [bool; LEGS] {
        let (mut together, mut all_run) = (0.0, true);
        for (leg, reading) in self.legs.iter_mut().zip(frame) {
            let Some(now) = reading else {
                *leg = Leg {
                    share: leg.share,
                    seen: leg.seen,
                    ..Leg::default()
                };
                continue;
            };
            let regime = usize::from(now.rate_m_s.abs() > MOTION_M_S);
            let repeats = now.raw == leg.last;
            if !leg.stuck {
                let pass = (1.0 / MEMORY).max(1.0 / f64::from(leg.seen[regime] + 1));
                let value = if repeats { 1.0 } else { 0.0 };
                leg.share[regime] += pass * (value - leg.share[regime]);
                leg.seen[regime] = leg.seen[regime].saturating_add(1);
            }
            if repeats {
                leg.run = leg.run.saturating_add(1);
            } else {
                leg.last = now.raw;
                leg.run = 0;
                leg.from_m = now.expected_m;
                leg.changes = leg.changes.saturating_add(1);
                if leg.changes >= ALIVE {
                    leg.stuck = false;
                }
            }
            let improbable = leg.improbable(regime);
            let missed_m = (now.expected_m - leg.from_m).abs();
            let chance = improbable > IMPROBABLE && leg.share[regime] < SHARE_MAX;
            let moved = leg.run >= RUN && missed_m > MISSED_M.max(3.0 * now.resolution_m);
            if (chance || moved) && !leg.stuck {
                leg.stuck = true;
                leg.changes = 0;
            }
            together += improbable;
            all_run &= leg.run >= RUN;
        }
        let present = frame.iter().flatten().count();
        if present == LEGS && all_run && together > IMPROBABLE_TOGETHER {
            for leg in self.legs.iter_mut().filter(|l| !l.stuck) {
                leg.stuck = true;
                leg.changes = 0;
            }
        }
        self.legs.map(|l| l.stuck)
    }
}

/// A run of equal samples becomes worth watching after this long, s.
const FROZEN_S: f64 = 0.2;
/// A rotation of the pad that its IMU must have measured, rad.
const TURNED_RAD: f64 = 0.0175;

/// Raw readings of one IMU.
#[derive(Clone, Copy, Debug, Default)]
pub struct Frozen {
    last: ImuRaw,
    run_s: f64,
    start: Option<UnitQuaternion<f64>>,
    stuck: bool,
}

impl Frozen {
    /// Takes in a sample (`None` where there is none), whether another IMU of the same pad changes, and the pad's
    /// orientation; returns whether it is stuck.
    pub fn update(
        &mut self,
        dt_s: f64,
        raw: Option<&ImuRaw>,
        other_changes: bool,
        base_from_pad: &UnitQuaternion<f64>,
    ) -> bool {
        match raw {
            Some(raw) if *raw == self.last => self.run_s += dt_s,
            Some(raw) => {
                *self = Self {
                    last: *raw,
                    ..Self::default()
                };
            }
            None => *self = Self::default(),
        }
        if self.run_s >= FROZEN_S {
            let start = self.start.get_or_insert(*base_from_pad);
            self.stuck |= other_changes || start.angle_to(base_from_pad) > TURNED_RAD;
        }
        self.stuck
    }

    /// Whether the newest sample differs from the one before it.
    pub fn changes(&self) -> bool {
        self.run_s == 0.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{Rng as _, SeedableRng as _};
    use rand_pcg::Pcg64Mcg;

    fn frame(raw: (u32, u32), expected_m: f64) -> RawLength {
        RawLength {
            raw,
            expected_m,
            rate_m_s: 0.0,
            resolution_m: 0.13e-3,
        }
    }

    #[test]
    fn a_hung_counter_is_noticed_within_half_a_second_and_healthy_ones_never_are() {
        let mut rng = Pcg64Mcg::seed_from_u64(1);
        let mut repeats = Repeats::default();
        let mut noisy = || frame((10_900, 16_000 + rng.random_range(0..3)), 0.15);
        for _ in 0..60_000 {
            let now = std::array::from_fn(|_| Some(noisy()));
            assert_eq!(repeats.update(&now), [false; LEGS]);
        }
        let hung = std::array::from_fn(|_| Some(noisy()));
        let frames = (1..=50).find(|_| repeats.update(&hung) == [true; LEGS]);
        assert!(frames.is_some_and(|n| n <= 50), "{frames:?}");
        for _ in 0..20 {
            repeats.update(&std::array::from_fn(|_| Some(noisy())));
        }
        let now = std::array::from_fn(|_| Some(noisy()));
        assert_eq!(repeats.update(&now), [false; LEGS], "alive again");
    }

    #[test]
    fn readings_without_noise_are_stuck_only_once_motion_was_missed() {
        let mut repeats = Repeats::default();
        let still = [Some(frame((10_900, 16_000), 0.15)); LEGS];
        for _ in 0..2000 {
            assert_eq!(repeats.update(&still), [false; LEGS]);
        }
        let mut moved = still;
        moved[2] = Some(frame((10_900, 16_000), 0.1506));
        let mut wanted = [false; LEGS];
        wanted[2] = true;
        assert_eq!(repeats.update(&moved), wanted);
    }

    #[test]
    fn a_frozen_imu_is_noticed_beside_a_living_one_and_when_its_pad_turns() {
        let raw = ImuRaw {
            gyro_rad_s: [0.0; 3],
            accel_m_s2: [0.0, 0.0, 9.81],
        };
        let id = UnitQuaternion::identity();
        let mut frozen = Frozen::default();
        for _ in 0..100 {
            assert!(!frozen.update(0.01, Some(&raw), false, &id));
        }
        let turned = UnitQuaternion::from_euler_angles(0.03, 0.0, 0.0);
        assert!(frozen.update(0.01, Some(&raw), false, &turned));
        let mut frozen = Frozen::default();
        let stuck = (0..30).any(|_| frozen.update(0.01, Some(&raw), true, &id));
        assert!(stuck);
    }
}
