//! Whether the chambers get and hold their air.
//!
//! The amount of gas in a chamber follows from its gauge and its length as the springs have it:
//!
//! m = (P_atm + p) A ℓ,   ṁ = P_atm (Q − Q_leak)
//!
//! A supply whose chamber is off its set pressure gives all it has, |Q| = Q_max. A chamber that gets less
//! than a third of that for seconds, towards its set pressure, leaks, or its supply fails.
//!
//! | symbol | meaning | unit |
//! |---|---|---|
//! | m | amount of gas times R T | J |
//! | A, ℓ | effective area and length of the bellows | m², m |
//! | Q, Q_max | flow of the supply, counted at P_atm | m³/s |

use std::collections::VecDeque;

use crate::robot::RobotSpec;
use crate::signal::{CHAMBERS, Pose, Stamp};
use crate::sim::ATMOSPHERE_PA;
use crate::sim::sensors::bellows_chords_m;

/// A supply works in full when its chamber is off by more than this, Pa. The controller does not ask for much
/// more than a chamber has: a leak shows as a small lag that stays.
const OFF_PA: f64 = 0.4e3;
/// Share of its full flow below which a supply does not get its chamber on.
const SHARE: f64 = 1.0 / 3.0;
/// The amount of gas is compared with that of this long ago, s.
const OVER_S: f64 = 1.0;
/// Short of air for so long: a warning, and SAFE, s.
pub(super) const WARN_S: f64 = 2.0;
pub(super) const SAFE_S: f64 = 10.0;
/// A chamber that is off by more than this, and does not move towards its set pressure at this rate, is adrift, Pa
/// and Pa/s.
pub(super) const ADRIFT_PA: f64 = 5e3;
const APPROACH_PA_S: f64 = 1e3;
/// Its approach is seen over so long, and being adrift for so long leads to SAFE, s.
const APPROACH_OVER_S: f64 = 0.3;
pub(super) const ADRIFT_S: f64 = 0.3;
/// A chamber that is well makes up for so many seconds of shortage per second.
const FORGIVEN: f64 = 2.0;

/// A chamber that is short of air.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Short {
    /// 0-based.
    pub chamber: usize,
    /// Gauge pressure that it has and that it should have, Pa.
    pub pa: [f64; 2],
    /// Whether that has lasted too long to go on.
    pub unsafe_now: bool,
}

/// The air at an instant.
#[derive(Clone, Copy, Debug)]
struct Air {
    stamp: Stamp,
    /// Amounts of gas, J.
    amount_j: [f64; CHAMBERS],
    /// Gauge pressures, Pa.
    measured_pa: [f64; CHAMBERS],
    /// Set pressures less those that are, Pa.
    off_pa: [f64; CHAMBERS],
}

/// Watches the air of all chambers.
#[derive(Clone, Debug, Default)]
pub(super) struct AirWatch {
    /// Oldest first.
    past: VecDeque<Air>,
    short_s: [f64; CHAMBERS],
    adrift_s: [f64; CHAMBERS],
}

impl AirWatch {
    /// Forgets everything: the supplies were off.
    pub fn reset(&mut self) {
        *self = Self::default();
    }

    /// Whether a chamber is far from its set pressure and does not come nearer, however short a time.
    pub fn drifts(&self) -> bool {
        self.adrift_s.iter().any(|s| *s > 0.0)
    }

    /// The chamber that is far from its set pressure and does not come nearer; `None` while none has been for long enough.
    pub fn adrift(&self) -> Option<Short> {
        let newest = self.past.back()?;
        let chamber = (0..CHAMBERS).find(|i| self.adrift_s[*i] >= ADRIFT_S)?;
        let set_pa = newest.measured_pa[chamber] + newest.off_pa[chamber];
        Some(Short {
            chamber,
            pa: [newest.measured_pa[chamber], set_pa],
            unsafe_now: true,
        })
    }

    /// Takes in a frame of `stamp`: gauge pressures and what they should be (Pa), middle and end pad (base from pad). Gives
    /// the chamber that is short of air for the longest, if one is for long enough. Else `None`.
    pub fn update(
        &mut self,
        robot: &RobotSpec,
        stamp: Stamp,
        chamber_pa: &[f64; CHAMBERS],
        set_pa: &[f64; CHAMBERS],
        base_from_pad: &[Pose; 2],
    ) -> Option<Short> {
        let dt_s = match self.past.back() {
            Some(last) if stamp.since(last.stamp) <= 0.0 => return None,
            Some(last) => stamp.since(last.stamp),
            None => 0.0,
        };
        if dt_s > OVER_S {
            self.reset();
        }
        let length_m = lengths_m(robot, base_from_pad);
        self.past.push_back(Air {
            stamp,
            amount_j: std::array::from_fn(|i| {
                (ATMOSPHERE_PA + chamber_pa[i]) * robot.area_m2[i] * length_m[i]
            }),
            measured_pa: *chamber_pa,
            off_pa: std::array::from_fn(|i| set_pa[i] - chamber_pa[i]),
        });
        let newest = self.past.back().copied()?;
        let ago = |over_s: f64| {
            let recent = self.past.iter().rev();
            recent
                .take_while(|air| stamp.since(air.stamp) <= over_s + 1e-6)
                .last()
        };
        if let (Some(before), Some(asked)) = (ago(APPROACH_OVER_S), ago(ADRIFT_S)) {
            let over_s = stamp.since(before.stamp);
            for i in 0..CHAMBERS {
                // The controller lowers what it asks of a chamber that has lost its air: what was asked before counts.
                let off_pa = asked.measured_pa[i] + asked.off_pa[i] - newest.measured_pa[i];
                let moved_pa = newest.measured_pa[i] - before.measured_pa[i];
                let approaches = moved_pa * off_pa.signum() >= APPROACH_PA_S * over_s;
                let adrift = off_pa.abs() > ADRIFT_PA && !approaches;
                self.adrift_s[i] = if adrift { self.adrift_s[i] + dt_s } else { 0.0 };
            }
        }
        let is_old = |air: &Air| stamp.since(air.stamp) >= OVER_S;
        while self.past.get(1).is_some_and(is_old) {
            self.past.pop_front();
        }
        let before = self.past.front().copied()?;
        let over_s = stamp.since(before.stamp);
        if over_s < 0.9 * OVER_S {
            return None;
        }
        let full_w = ATMOSPHERE_PA * robot.pump_flow_m3_s;
        for i in 0..CHAMBERS {
            let off_pa = self.past.iter().map(|air| air.off_pa[i]).sum::<f64>();
            let off_pa = off_pa / self.past.len() as f64;
            let gain_w = (newest.amount_j[i] - before.amount_j[i]) / over_s * off_pa.signum();
            let short = off_pa.abs() > OFF_PA && gain_w < SHARE * full_w;
            let change_s = if short { dt_s } else { -FORGIVEN * dt_s };
            self.short_s[i] = (self.short_s[i] + change_s).clamp(0.0, SAFE_S + 1.0);
        }
        let worst = (0..CHAMBERS).max_by(|a, b| self.short_s[*a].total_cmp(&self.short_s[*b]))?;
        (self.short_s[worst] >= WARN_S).then(|| Short {
            chamber: worst,
            pa: [chamber_pa[worst], set_pa[worst]],
            unsafe_now: self.short_s[worst] >= SAFE_S,
        })
    }
}

/// Gauge pressure that the gas of a bellows of length `length_m` at `chamber_pa` would have at length `other_m`, Pa.
pub(super) fn at_lengths_pa(chamber_pa: f64, length_m: f64, other_m: f64) -> f64 {
    (ATMOSPHERE_PA + chamber_pa) * length_m / other_m - ATMOSPHERE_PA
}

/// Straight lengths of the bellows between their pads, m.
pub(super) fn lengths_m(robot: &RobotSpec, base_from_pad: &[Pose; 2]) -> [f64; CHAMBERS] {
    let [middle, end] = *base_from_pad;
    bellows_chords_m(robot, &[Pose::identity(), middle, end])
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A chamber with a supply and a leak (m³/s per Pa) for `seconds`; when it was warned of and when it was
    /// unsafe, s.
    fn run(set_pa: impl Fn(f64) -> f64, leak: f64, seconds: f64) -> [Option<f64>; 2] {
        let robot = RobotSpec::reference();
        let mut watch = AirWatch::default();
        let (mut p, mut found) = ([0.0; CHAMBERS], [None; 2]);
        for k in 0..(seconds * 100.0) as u32 {
            let t_s = f64::from(k) * 0.01;
            let mut set = [0.0; CHAMBERS];
            set[4] = set_pa(t_s);
            let flow = robot.pump_flow_m3_s * ((set[4] - p[4]) / 500.0).clamp(-1.0, 1.0);
            let lost = if t_s > 10.0 { leak * p[4] } else { 0.0 };
            let volume_m3 = robot.area_m2[4] * 0.145;
            p[4] += 0.01 * ATMOSPHERE_PA * (flow - lost) / volume_m3;
            let hang = |z_m: f64| Pose::translation(0.0, 0.0, -z_m);
            let pads = [hang(0.145), hang(0.3)];
            let short = watch.update(&robot, Stamp::from_seconds(t_s), &p, &set, &pads);
            if let Some(s) = short {
                assert_eq!(s.chamber, 4);
                found[0].get_or_insert(t_s);
                if s.unsafe_now {
                    found[1].get_or_insert(t_s);
                }
            }
        }
        found
    }

    #[test]
    fn a_leak_is_warned_of_within_5_s_and_unsafe_within_15() {
        // As much at 20 kPa as 1.2 pumps give, or 3.
        for pumps in [1.2, 3.0] {
            let leak = pumps * RobotSpec::reference().pump_flow_m3_s / 20e3;
            let [warned_s, unsafe_s] = run(|_| 20e3, leak, 40.0);
            let warned_s = warned_s.expect("warned") - 10.0;
            let unsafe_s = unsafe_s.expect("unsafe") - 10.0;
            assert!((0.0..=5.0).contains(&warned_s), "{pumps}: {warned_s}");
            assert!((5.0..=15.0).contains(&unsafe_s), "{pumps}: {unsafe_s}");
        }
    }

    #[test]
    fn a_sound_chamber_is_never_short_however_its_set_pressure_moves() {
        let moves: [fn(f64) -> f64; 4] = [
            |_| 40e3,
            |t_s| if t_s % 9.0 < 4.5 { 40e3 } else { -40e3 },
            |t_s| 20e3 * (2.0 * t_s).sin(),
            |t_s| 15e3 * (0.3 * t_s).sin() + 10e3,
        ];
        for (k, set_pa) in moves.into_iter().enumerate() {
            assert_eq!(run(set_pa, 0.0, 60.0), [None; 2], "{k}");
        }
    }

    #[test]
    fn a_leak_that_the_supply_makes_up_for_is_borne() {
        let leak = 0.5 * RobotSpec::reference().pump_flow_m3_s / 20e3;
        assert_eq!(run(|_| 20e3, leak, 40.0), [None; 2]);
    }
}
