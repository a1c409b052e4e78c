//! Excitation of a session: seeded, piecewise linear set pressures per chamber, as fast as the robot's pumps allow.
//!
//! A pump that moves Q at atmospheric pressure P₀ changes a chamber's gauge pressure p by
//!
//! ṗ = P₀ Q / (V + (P₀ + p) A²/k),  V = A (l₀ + p A/k)
//!
//! | symbol | meaning |
//! |---|---|
//! | A, l₀, k | effective area, rest length and axial stiffness of the bellows |
//! | A²/k | compliance of the bellows, m³/Pa |
//!
//! It is slowest at the highest pressure. Ramps stay at [`RAMP_SHARE`] of that rate; steps are set at once and saturate
//! the pumps; strokes are given in seconds of pumping, so that every motion fits into a session of 90 s.

use rand::Rng;
use rand_pcg::Pcg64Mcg;

use crate::robot::RobotSpec;
use crate::signal::CHAMBERS;
use crate::sim::ATMOSPHERE_PA;
use crate::sim::dataset::sample_rng;
use crate::task::Programme;

/// A way to move the arm.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Excitation {
    /// A little of everything: ramps with reversals, steps, a hold, slow sines, rests.
    #[default]
    Mixed,
    /// Moves with long holds: separates what is slow (creep, drift) from what is not.
    Holds,
    /// Steps that saturate the pumps, with short holds: delay, lag, flow, damping, clock.
    Steps,
    /// Slow moves to widely different orientations, held: payload, centre, tilt, force, frame.
    Loads,
    /// Small loops nested in large ones, slowly: hysteresis against lag and creep.
    Reversals,
    /// Sines of 0.02 to 0.3 Hz in all chambers.
    Sines,
    /// One chamber after the other: leak, gauge, stiffness, coupling.
    Single,
    /// Up and down along the axis: contact, stiffening.
    Axial,
    /// At rest: drift, leak.
    Still,
}

impl Excitation {
    /// All of them.
    pub const ALL: [Self; 9] = [
        Self::Mixed,
        Self::Holds,
        Self::Steps,
        Self::Loads,
        Self::Reversals,
        Self::Sines,
        Self::Single,
        Self::Axial,
        Self::Still,
    ];

    /// Its name in commands and reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::Mixed => "mixed",
            Self::Holds => "holds",
            Self::Steps => "steps",
            Self::Loads => "loads",
            Self::Reversals => "reversals",
            Self::Sines => "sines",
            Self::Single => "single",
            Self::Axial => "axial",
            Self::Still => "still",
        }
    }

    /// The one with this name; `None` if there is none.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|e| e.name() == name)
    }
}

/// Share of the robot's pressure range that is used: short of where the arm folds.
const RANGE_SHARE: f64 = 0.75;
/// Rate of a ramp over the pumps' slowest rate.
pub const RAMP_SHARE: f64 = 0.7;
/// Rest at the beginning, s.
const LEAD_S: f64 = 2.0;

/// How fast a chamber's pressure changes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pumping {
    /// Largest set pressure of a motion, Pa.
    pub most_pa: f64,
    /// Fastest change of a set pressure, Pa/s.
    command_pa_s: f64,
    /// P₀ Q, W.
    power_w: f64,
    /// A l₀, m³.
    volume_m3: f64,
    /// A²/k, m³/Pa.
    compliance_m3_pa: f64,
}

impl Pumping {
    /// Of the pumps and chambers of `robot`.
    pub fn of(robot: &RobotSpec) -> Self {
        let limits = &robot.pressure;
        Self {
            most_pa: RANGE_SHARE * limits.max_pa.min(-limits.min_pa).max(1e3),
            command_pa_s: limits.rate_pa_s,
            power_w: ATMOSPHERE_PA * robot.pump_flow_m3_s,
            volume_m3: robot.largest_area_m2() * robot.rest_length_m,
            compliance_m3_pa: (0..CHAMBERS)
                .map(|i| robot.area_m2[i].powi(2) / robot.axial_stiffness_n_m[i])
                .fold(0.0, f64::max),
        }
    }

    /// Fastest rate at gauge pressure `pa`, Pa/s.
    pub fn rate_pa_s(&self, pa: f64) -> f64 {
        // V + (P₀ + p) C = A l₀ + C (P₀ + 2 p)
        let stored = self.volume_m3 + self.compliance_m3_pa * (ATMOSPHERE_PA + 2.0 * pa);
        (self.power_w / stored.max(0.1 * self.volume_m3)).min(self.command_pa_s)
    }

    /// The same at the highest pressure of a motion, where it is slowest.
    pub fn slowest_pa_s(&self) -> f64 {
        self.rate_pa_s(self.most_pa)
    }

    /// Rate of the fastest ramps, Pa/s.
    pub fn ramp_pa_s(&self) -> f64 {
        RAMP_SHARE * self.slowest_pa_s()
    }

    /// Time that the pumps take from one pressure to another, s.
    fn time_s(&self, from_pa: f64, to_pa: f64) -> f64 {
        // ∫ (A l₀ + C (P₀ + 2 p)) dp = (A l₀ + C P₀) Δp + C Δ(p²)
        let linear = self.volume_m3 + self.compliance_m3_pa * ATMOSPHERE_PA;
        let work =
            linear * (to_pa - from_pa) + self.compliance_m3_pa * (to_pa.powi(2) - from_pa.powi(2));
        (work.abs() / self.power_w).max((to_pa - from_pa).abs() / self.command_pa_s)
    }
}

/// An excitation for the pumps of a robot.
#[derive(Clone, Debug, PartialEq)]
pub struct Drive {
    programme: Programme,
    pumping: Pumping,
}

impl Drive {
    /// The commands of an excitation over `seconds` for the pumps of `robot`.
    pub fn new(excitation: Excitation, robot: &RobotSpec, seed: u64, seconds: f64) -> Self {
        let pumping = Pumping::of(robot);
        let mut d = Draft {
            knots: std::array::from_fn(|_| vec![[0.0, 0.0], [LEAD_S, 0.0]]),
            rng: sample_rng(seed, 0xe8c1),
            pumping,
        };
        while d.end_s() < seconds {
            match excitation {
                Excitation::Mixed => {
                    d.ramps(22.0, [3.0, 8.0]);
                    d.steps(3, [1.5, 3.0], 4.0);
                    d.steps(1, [8.0, 10.0], 6.0);
                    d.sines(16.0, 3.0);
                    d.rest(4.0);
                }
                Excitation::Holds => d.steps(1, [14.0, 20.0], 9.0),
                Excitation::Steps => d.steps(1, [1.0, 2.5], 4.0),
                Excitation::Loads => d.poses([3.0, 5.0], 20.0),
                Excitation::Reversals => d.nested(7.5),
                Excitation::Sines => d.sines(seconds.clamp(20.0, 90.0), 1.0),
                Excitation::Single => d.single(4.0),
                Excitation::Axial => d.axial(14.0),
                Excitation::Still => d.rest(seconds),
            }
        }
        Self {
            programme: Programme {
                name: excitation.name().to_owned(),
                knots: d.knots,
                seconds,
            },
            pumping,
        }
    }

    /// The first `seconds` of it.
    pub fn until(&self, seconds: f64) -> Self {
        let mut out = self.clone();
        out.programme.seconds = seconds.min(self.programme.seconds);
        out
    }

    /// Set gauge pressures of chambers 1 to 6 at `t_s`, Pa.
    pub fn at(&self, t_s: f64) -> [f64; CHAMBERS] {
        self.programme.at(t_s)
    }

    /// The set pressures over time.
    pub fn programme(&self) -> &Programme {
        &self.programme
    }

    /// Gauge pressures that the pumps reach at rising times, from the first set pressure on, in the order of the chambers,
    /// Pa.
    pub fn pumped(&self, t_s: &[f64]) -> Vec<[f64; CHAMBERS]> {
        let mut now = self.at(t_s.first().copied().unwrap_or(0.0));
        let mut before_s = t_s.first().copied().unwrap_or(0.0);
        let mut next = |t_s: &f64| {
            let set = self.at(*t_s);
            for (p, set) in now.iter_mut().zip(set) {
                let most = self.pumping.rate_pa_s(*p) * (t_s - before_s);
                *p += (set - *p).clamp(-most, most);
            }
            before_s = *t_s;
            now
        };
        t_s.iter().map(&mut next).collect()
    }
}

struct Draft {
    knots: [Vec<[f64; 2]>; CHAMBERS],
    rng: Pcg64Mcg,
    pumping: Pumping,
}

impl Draft {
    fn end_s(&self) -> f64 {
        let last = |k: &Vec<[f64; 2]>| k.last().map_or(0.0, |p| p[0]);
        self.knots.iter().map(last).fold(0.0, f64::max)
    }

    fn last_pa(&self, i: usize) -> f64 {
        self.knots[i].last().map_or(0.0, |p| p[1])
    }

    fn push(&mut self, i: usize, t_s: f64, pa: f64) {
        let most = self.pumping.most_pa;
        let pa = pa.clamp(-most, most);
        match self.knots[i].last_mut() {
            Some(last) if t_s <= last[0] + 1e-9 => last[1] = pa,
            _ => self.knots[i].push([t_s, pa]),
        }
    }

    /// The pressure that the pumps change in so many seconds, within the range, Pa.
    fn stroke_pa(&self, pumping_s: f64) -> f64 {
        (pumping_s * self.pumping.slowest_pa_s()).min(0.95 * self.pumping.most_pa)
    }

    /// All chambers to `to_pa`, each along a line that ends when `arrives_s` has passed for it; then held until the last
    /// one has had `settles_s` and `hold_s` more.
    fn go(
        &mut self,
        to_pa: [f64; CHAMBERS],
        arrives_s: impl Fn(f64, f64) -> f64,
        settles_s: impl Fn(f64, f64) -> f64,
        hold_s: f64,
    ) {
        let start_s = self.end_s();
        let mut until_s = start_s;
        for i in 0..CHAMBERS {
            let from = self.last_pa(i);
            self.push(i, start_s, from);
            self.push(i, start_s + arrives_s(from, to_pa[i]).max(0.05), to_pa[i]);
            until_s = until_s.max(start_s + settles_s(from, to_pa[i]).max(0.05));
        }
        for i in 0..CHAMBERS {
            self.push(i, until_s + hold_s, to_pa[i]);
        }
    }

    /// A move that the pumps follow.
    fn ramp(&mut self, to_pa: [f64; CHAMBERS], hold_s: f64) {
        let rate = self.pumping.ramp_pa_s();
        let takes_s = |from: f64, to: f64| (to - from).abs() / rate;
        self.go(to_pa, takes_s, takes_s, hold_s);
    }

    /// A move that is set at once; held for `hold_s` after the pumps have arrived.
    fn step(&mut self, to_pa: [f64; CHAMBERS], hold_s: f64) {
        let pumping = self.pumping;
        let set_s = |from: f64, to: f64| (to - from).abs() / pumping.command_pa_s;
        self.go(to_pa, set_s, |from, to| pumping.time_s(from, to), hold_s);
    }

    fn within(&mut self, [low, high]: [f64; 2]) -> f64 {
        low + (high - low) * self.rng.random::<f64>()
    }

    /// Steps of up to a stroke from where each chamber is, up or down, back towards 0 beyond one and a half strokes.
    fn steps(&mut self, count: usize, hold_s: [f64; 2], pumping_s: f64) {
        let stroke = self.stroke_pa(pumping_s);
        let most = (1.5 * stroke).min(self.pumping.most_pa);
        for _ in 0..count {
            let to = std::array::from_fn(|i| {
                let here = self.last_pa(i);
                let change = stroke * self.within([0.4, 1.0]);
                let change = if self.rng.random() { change } else { -change };
                match (here + change).abs() <= most {
                    true => here + change,
                    false => here - change.abs() * here.signum(),
                }
            });
            let hold_s = self.within(hold_s);
            self.step(to, hold_s);
        }
    }

    /// A slow move to pressures within a stroke of 0: a common part per segment and one per chamber, for stretching and
    /// bending.
    fn poses(&mut self, hold_s: [f64; 2], pumping_s: f64) {
        let stroke = self.stroke_pa(pumping_s);
        let common: [f64; 2] = std::array::from_fn(|_| self.within([-0.4, 0.4]));
        let to = std::array::from_fn(|i| {
            (common[i / 3] + self.within([-0.8, 0.8])).clamp(-1.0, 1.0) * stroke
        });
        let hold_s = self.within(hold_s);
        self.ramp(to, hold_s);
    }

    /// Chambers ramp on their own, each turning round at its own times.
    fn ramps(&mut self, seconds: f64, pumping_s: [f64; 2]) {
        let start_s = self.end_s();
        let most = 0.85 * self.pumping.most_pa;
        for i in 0..CHAMBERS {
            let from = self.last_pa(i);
            self.push(i, start_s, from);
            let mut t_s = start_s;
            let mut up = self.rng.random::<bool>();
            while t_s < start_s + seconds {
                let here = self.last_pa(i);
                let swing_s = self.within(pumping_s);
                let swing = self.stroke_pa(swing_s) * if up { 1.0 } else { -1.0 };
                let to = (here + swing).clamp(-most, most);
                let rate = self.within([0.5, 1.0]) * self.pumping.ramp_pa_s();
                let there_s = t_s + ((to - here).abs() / rate).max(0.1);
                // The last one is cut where the time is over.
                let end_s = there_s.min(start_s + seconds);
                let share = (end_s - t_s) / (there_s - t_s);
                self.push(i, end_s, here + share * (to - here));
                t_s = end_s;
                if self.rng.random::<f64>() < 0.3 && t_s < start_s + seconds {
                    let at = self.last_pa(i);
                    t_s = (t_s + self.within([0.5, 2.0])).min(start_s + seconds);
                    self.push(i, t_s, at);
                }
                up = !up;
            }
        }
    }

    fn sines(&mut self, seconds: f64, fastest: f64) {
        const STEP_S: f64 = 0.1;
        const RATES_HZ: [f64; 4] = [0.02, 0.05, 0.12, 0.28];
        // Each wave's share of the rate: slow ones are large, fast ones stay above the gauges' noise.
        const SHARES: [f64; 4] = [0.45, 0.25, 0.17, 0.13];
        let start_s = self.end_s();
        let ramp = self.pumping.ramp_pa_s();
        let most = ramp * STEP_S;
        for i in 0..CHAMBERS {
            let from = self.last_pa(i);
            self.push(i, start_s, from);
            let waves: [[f64; 3]; 4] = std::array::from_fn(|k| {
                let rate =
                    std::f64::consts::TAU * RATES_HZ[k] * fastest * self.within([0.85, 1.15]);
                let phase = self.within([0.0, std::f64::consts::TAU]);
                [SHARES[k] * ramp / rate, rate, phase]
            });
            let n = (seconds / STEP_S) as usize;
            for j in 1..=n {
                let t_s = j as f64 * STEP_S;
                // Fades in and out over a tenth of the time; what was there before fades out.
                let edge = (t_s.min(seconds - t_s) / (0.1 * seconds)).clamp(0.0, 1.0);
                let wave: f64 = waves
                    .iter()
                    .map(|[a, rate, phase]| a * (rate * t_s + phase).sin())
                    .sum();
                let before = from * (1.0 - t_s / (0.5 * seconds)).max(0.0);
                let here = self.last_pa(i);
                let change = (before + edge * wave - here).clamp(-most, most);
                self.push(i, start_s + t_s, here + change);
            }
        }
    }

    fn rest(&mut self, seconds: f64) {
        self.ramp([0.0; CHAMBERS], seconds);
    }

    /// Outer swings with ever smaller inner ones.
    fn nested(&mut self, pumping_s: f64) {
        let stroke = self.stroke_pa(pumping_s);
        let outward: [f64; CHAMBERS] = std::array::from_fn(|_| {
            let size = self.within([0.3, 1.0]);
            if self.rng.random() { size } else { -size }
        });
        for size in [1.0, -1.0, 0.7, -0.6, 0.4, -0.3, 0.15, 0.0] {
            self.ramp(outward.map(|x| x * size * stroke), 0.5);
        }
    }

    fn single(&mut self, pumping_s: f64) {
        let stroke = self.stroke_pa(pumping_s);
        for i in 0..CHAMBERS {
            for level in [1.0, -1.0, 0.0] {
                let mut to = [0.0; CHAMBERS];
                to[i] = level * stroke * self.within([0.7, 1.0]);
                self.step(to, 0.7);
            }
        }
    }

    fn axial(&mut self, pumping_s: f64) {
        let stroke = self.stroke_pa(pumping_s);
        for level in [0.5, 1.0, 0.3, -0.4, -1.0, -0.2] {
            let to = [level * stroke * self.within([0.85, 1.0]); CHAMBERS];
            self.ramp(to, 1.5);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A reference robot whose pumps are so many times as strong.
    fn pumps(times: f64) -> RobotSpec {
        let mut robot = RobotSpec::reference();
        robot.pump_flow_m3_s *= times;
        robot
    }

    fn series(excitation: Excitation, robot: &RobotSpec) -> Vec<[f64; CHAMBERS]> {
        let d = Drive::new(excitation, robot, 5, 90.0);
        (0..9000).map(|k| d.at(f64::from(k) * 0.01)).collect()
    }

    #[test]
    fn the_reference_pumps_need_tens_of_seconds_for_the_range() {
        let p = Pumping::of(&RobotSpec::reference());
        let at_rest = p.rate_pa_s(0.0);
        assert!((1.5e3..2.0e3).contains(&at_rest), "{at_rest} Pa/s");
        assert!(p.slowest_pa_s() < at_rest && p.rate_pa_s(-20e3) > at_rest);
        let stroke_s = p.time_s(-p.most_pa, p.most_pa);
        assert!((25.0..60.0).contains(&stroke_s), "{stroke_s} s");
        assert!((p.time_s(5e3, -7e3) - p.time_s(-7e3, 5e3)).abs() < 1e-9);
        // Small moves: distance over rate.
        let small = p.time_s(10e3, 10.1e3) * p.rate_pa_s(10.05e3);
        assert!((small - 100.0).abs() < 1e-6, "{small}");
    }

    #[test]
    fn ramps_stay_below_the_pumps_and_steps_saturate_them() {
        for times in [1.0, 0.5, 20.0] {
            let robot = pumps(times);
            let pumping = Pumping::of(&robot);
            for excitation in Excitation::ALL {
                let name = excitation.name();
                assert_eq!(Excitation::from_name(name), Some(excitation));
                let all = series(excitation, &robot);
                assert_eq!(all[0], [0.0; CHAMBERS]);
                let most = all
                    .as_flattened()
                    .iter()
                    .fold(0.0, |m: f64, p| m.max(p.abs()));
                assert!(most <= pumping.most_pa, "{name}: {most} Pa");
                assert_eq!(most > 1e3, excitation != Excitation::Still, "{name}");
                let change = |w: &[[f64; CHAMBERS]], i: usize| (w[1][i] - w[0][i]).abs() / 0.01;
                let rates = all
                    .windows(2)
                    .flat_map(|w| (0..CHAMBERS).map(|i| change(w, i)));
                let fastest = rates.fold(0.0, f64::max);
                let stepped = matches!(
                    excitation,
                    Excitation::Mixed | Excitation::Holds | Excitation::Steps | Excitation::Single
                );
                if stepped {
                    assert!(
                        fastest <= robot.pressure.rate_pa_s * 1.001,
                        "{name}: {fastest}"
                    );
                    assert!(
                        fastest > pumping.slowest_pa_s() * 0.999,
                        "{name}: {fastest} Pa/s"
                    );
                } else {
                    assert!(
                        fastest < pumping.ramp_pa_s() * 1.001,
                        "{name}: {fastest} Pa/s"
                    );
                }
            }
        }
    }

    /// Within 90 s of the reference pumps every excitation does what it is for.
    #[test]
    fn every_excitation_keeps_its_purpose_within_a_session() {
        let robot = RobotSpec::reference();
        let turns = |excitation| {
            let all = series(excitation, &robot);
            let one: Vec<f64> = all.iter().step_by(20).map(|p| p[1]).collect();
            let moves: Vec<f64> = one
                .windows(2)
                .map(|w| w[1] - w[0])
                .filter(|d| d.abs() > 1.0)
                .collect();
            moves.windows(2).filter(|w| w[0] * w[1] < 0.0).count()
        };
        assert!(turns(Excitation::Reversals) >= 6);
        assert!(turns(Excitation::Mixed) >= 4);
        assert!(turns(Excitation::Steps) >= 3);
        let span = |excitation| {
            let all = series(excitation, &robot);
            let least = |pick: fn(f64, f64) -> f64, from: f64| {
                let of = |i: usize| all.iter().map(|p| p[i]).fold(from, pick);
                (0..CHAMBERS).map(of).collect::<Vec<_>>()
            };
            let (high, low) = (least(f64::max, f64::MIN), least(f64::min, f64::MAX));
            (0..CHAMBERS)
                .map(|i| high[i] - low[i])
                .fold(f64::MAX, f64::min)
        };
        assert!(
            span(Excitation::Axial) > 25e3,
            "{}",
            span(Excitation::Axial)
        );
        for excitation in Excitation::ALL {
            if excitation != Excitation::Still {
                assert!(
                    span(excitation) > 3e3,
                    "{}: {}",
                    excitation.name(),
                    span(excitation)
                );
            }
        }
        // Each chamber has its turn.
        let single = series(Excitation::Single, &robot);
        assert!((0..CHAMBERS).all(|i| single.iter().any(|p| p[i] > 2e3)));
        let held = series(Excitation::Holds, &robot);
        let still = held
            .windows(1000)
            .any(|w| w[0] == w[999] && w[0] != [0.0; CHAMBERS]);
        assert!(still, "no hold of 10 s");
    }

    #[test]
    fn pumped_pressures_follow_within_the_pumps_rate() {
        let robot = RobotSpec::reference();
        let d = Drive::new(Excitation::Steps, &robot, 3, 60.0);
        let t_s: Vec<f64> = (0..1200).map(|k| f64::from(k) * 0.05).collect();
        let pumped = d.pumped(&t_s);
        let most = Pumping::of(&robot).rate_pa_s(-30e3) * 0.05;
        let off = |k: usize, i: usize| (pumped[k][i] - d.at(t_s[k])[i]).abs();
        for k in 1..t_s.len() {
            for i in 0..CHAMBERS {
                assert!((pumped[k][i] - pumped[k - 1][i]).abs() <= most);
            }
        }
        // Every step is reached before the next one.
        let late = (1..t_s.len()).filter(|k| off(*k, 0) > 500.0).count();
        assert!(late > 20 && late < t_s.len() * 9 / 10, "{late}");
        assert!(
            (0..CHAMBERS).all(|i| (1..t_s.len()).any(|k| off(k, i) < 1.0 && pumped[k][i] != 0.0))
        );
    }

    #[test]
    fn the_seed_decides() {
        let robot = RobotSpec::reference();
        let at = |seed| Drive::new(Excitation::Mixed, &robot, seed, 60.0).at(30.0);
        assert_eq!(at(1), at(1));
        assert_ne!(at(1), at(2));
    }
}
