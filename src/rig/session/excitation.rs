//! Excitation of a session: seeded, piecewise linear set pressures per chamber.

use rand::Rng;
use rand_pcg::Pcg64Mcg;

use crate::signal::CHAMBERS;
use crate::sim::dataset::sample_rng;

/// A way to move the arm.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Excitation {
    /// A little of everything: ramps with reversals, steps, a hold, slow sines, rests.
    #[default]
    Mixed,
    /// Moves with long holds: separates what is slow (creep, drift) from what is not.
    Holds,
    /// Fast steps with short holds: delay, lag, flow, damping, clock.
    Steps,
    /// Slow moves to widely different orientations, held: payload, centre, tilt, force, frame.
    Loads,
    /// Small loops nested in large ones, slowly: hysteresis against lag and creep.
    Reversals,
    /// Sines of 0.02 to 0.6 Hz in all chambers.
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

    /// The one with this name.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|e| e.name() == name)
    }
}

/// Largest set pressure, Pa: short of where the arm folds.
const MOST_PA: f64 = 30e3;
/// Rest at the beginning, s.
const LEAD_S: f64 = 2.0;

/// Set pressures over time; held before the first and after the last knot.
#[derive(Clone, Debug, PartialEq)]
pub struct Drive {
    knots: [Vec<[f64; 2]>; CHAMBERS],
}

impl Drive {
    /// The commands of an excitation over `seconds`.
    pub fn new(excitation: Excitation, seed: u64, seconds: f64) -> Self {
        let mut d = Draft {
            knots: std::array::from_fn(|_| vec![[0.0, 0.0], [LEAD_S, 0.0]]),
            rng: sample_rng(seed, 0xe8c1),
        };
        while d.end_s() < seconds {
            match excitation {
                Excitation::Mixed => {
                    d.ramps(18.0, [2e3, 6e3]);
                    d.steps(4, [1.5, 3.5], MOST_PA, [10e3, 18e3]);
                    d.steps(1, [9.0, 11.0], MOST_PA, [5e3, 8e3]);
                    d.sines(14.0, 1.0);
                    d.rest(4.0);
                }
                Excitation::Holds => d.steps(1, [14.0, 20.0], MOST_PA, [8e3, 15e3]),
                Excitation::Steps => d.steps(1, [1.0, 3.0], MOST_PA, [15e3, 25e3]),
                Excitation::Loads => d.steps(1, [3.0, 5.0], MOST_PA, [4e3, 6e3]),
                Excitation::Reversals => d.nested(),
                Excitation::Sines => d.sines(seconds.min(30.0), 1.6),
                Excitation::Single => d.single(),
                Excitation::Axial => d.axial(),
                Excitation::Still => d.rest(seconds),
            }
        }
        Self { knots: d.knots }
    }

    /// Set pressures at `t_s`, Pa.
    pub fn at(&self, t_s: f64) -> [f64; CHAMBERS] {
        std::array::from_fn(|i| {
            let knots = &self.knots[i];
            let k = knots.partition_point(|p| p[0] <= t_s);
            match (k.checked_sub(1).and_then(|j| knots.get(j)), knots.get(k)) {
                (Some([t0, p0]), Some([t1, p1])) => p0 + (t_s - t0) / (t1 - t0) * (p1 - p0),
                (Some(p), None) | (None, Some(p)) => p[1],
                (None, None) => 0.0,
            }
        })
    }
}

struct Draft {
    knots: [Vec<[f64; 2]>; CHAMBERS],
    rng: Pcg64Mcg,
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
        let pa = pa.clamp(-MOST_PA, MOST_PA);
        match self.knots[i].last_mut() {
            Some(last) if t_s <= last[0] + 1e-9 => last[1] = pa,
            _ => self.knots[i].push([t_s, pa]),
        }
    }

    /// All chambers to `to_pa` at their rates, then until `until_s` where they are.
    fn go(&mut self, to_pa: [f64; CHAMBERS], rate_pa_s: [f64; CHAMBERS], hold_s: f64) {
        let start_s = self.end_s();
        let mut until_s = start_s;
        for i in 0..CHAMBERS {
            let from = self.last_pa(i);
            self.push(i, start_s, from);
            let there_s = start_s + ((to_pa[i] - from).abs() / rate_pa_s[i]).max(0.05);
            self.push(i, there_s, to_pa[i]);
            until_s = until_s.max(there_s);
        }
        for i in 0..CHAMBERS {
            self.push(i, until_s + hold_s, to_pa[i]);
        }
    }

    fn within(&mut self, [low, high]: [f64; 2]) -> f64 {
        low + (high - low) * self.rng.random::<f64>()
    }

    fn level(&mut self, most_pa: f64) -> [f64; CHAMBERS] {
        // Bending and stretching in turn: a common part and one per chamber.
        let common: [f64; 2] = std::array::from_fn(|_| self.within([-0.4, 0.4]));
        std::array::from_fn(|i| {
            (common[i / 3] + self.within([-0.7, 0.7])).clamp(-1.0, 1.0) * most_pa
        })
    }

    fn steps(&mut self, count: usize, hold_s: [f64; 2], most_pa: f64, rate_pa_s: [f64; 2]) {
        for _ in 0..count {
            let to = self.level(most_pa);
            let rate = std::array::from_fn(|_| self.within(rate_pa_s));
            let hold_s = self.within(hold_s);
            self.go(to, rate, hold_s);
        }
    }

    /// Chambers ramp on their own, each turning round at its own times.
    fn ramps(&mut self, seconds: f64, rate_pa_s: [f64; 2]) {
        let start_s = self.end_s();
        for i in 0..CHAMBERS {
            let from = self.last_pa(i);
            self.push(i, start_s, from);
            let mut t_s = start_s;
            let mut up = self.rng.random::<bool>();
            while t_s < start_s + seconds {
                let here = self.last_pa(i);
                let swing = self.within([6e3, 30e3]) * if up { 1.0 } else { -1.0 };
                let to = (here + swing).clamp(-0.85 * MOST_PA, 0.85 * MOST_PA);
                let rate = self.within(rate_pa_s);
                let there_s = t_s + ((to - here).abs() / rate).max(0.1);
                // The last one is cut where the time is over.
                let end_s = there_s.min(start_s + seconds);
                let share = (end_s - t_s) / (there_s - t_s);
                self.push(i, end_s, here + share * (to - here));
                t_s = end_s;
                if self.rng.random::<f64>() < 0.3 && t_s < start_s + seconds {
                    let at = self.last_pa(i);
                    t_s = (t_s + self.within([0.5, 2.5])).min(start_s + seconds);
                    self.push(i, t_s, at);
                }
                up = !up;
            }
        }
    }

    fn sines(&mut self, seconds: f64, fastest: f64) {
        const STEP_S: f64 = 0.1;
        const RATES_HZ: [f64; 4] = [0.04, 0.09, 0.19, 0.37];
        let start_s = self.end_s();
        for i in 0..CHAMBERS {
            let from = self.last_pa(i);
            self.push(i, start_s, from);
            let waves: [[f64; 3]; 4] = std::array::from_fn(|k| {
                let rate = RATES_HZ[k] * fastest * self.within([0.85, 1.15]);
                // Slower waves are larger: about the same speed for each.
                [
                    5e3 / (0.6 + k as f64),
                    rate,
                    self.within([0.0, std::f64::consts::TAU]),
                ]
            });
            let n = (seconds / STEP_S) as usize;
            for j in 1..=n {
                let t_s = j as f64 * STEP_S;
                // Fades in and out over a tenth of the time; what was there before fades out.
                let edge = (t_s.min(seconds - t_s) / (0.1 * seconds)).clamp(0.0, 1.0);
                let wave: f64 = waves
                    .iter()
                    .map(|[a, f, phase]| a * (std::f64::consts::TAU * f * t_s + phase).sin())
                    .sum();
                let before = from * (1.0 - t_s / (0.25 * seconds)).max(0.0);
                self.push(i, start_s + t_s, before + edge * 1.6 * wave);
            }
        }
    }

    fn rest(&mut self, seconds: f64) {
        self.go([0.0; CHAMBERS], [10e3; CHAMBERS], seconds);
    }

    /// Outer swings with ever smaller inner ones.
    fn nested(&mut self) {
        let outward: [f64; CHAMBERS] = std::array::from_fn(|_| self.within([-1.0, 1.0]));
        for size in [1.0, -1.0, 0.7, -0.6, 0.4, -0.3, 0.15, 0.0] {
            let to = outward.map(|x| x * size * 0.9 * MOST_PA);
            self.go(to, [5e3; CHAMBERS], 0.5);
        }
    }

    fn single(&mut self) {
        for i in 0..CHAMBERS {
            for level in [0.8, -0.8, 0.0] {
                let mut to = [0.0; CHAMBERS];
                to[i] = level * MOST_PA * self.within([0.7, 1.0]);
                self.go(to, [9e3; CHAMBERS], 1.5);
            }
        }
    }

    fn axial(&mut self) {
        for level in [0.5, 1.0, 0.3, -0.4, -1.0, -0.2] {
            let to = [level * 0.85 * MOST_PA * self.within([0.85, 1.0]); CHAMBERS];
            self.go(to, [7e3; CHAMBERS], 2.0);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_excitation_stays_in_the_box_and_within_its_speed() {
        for excitation in Excitation::ALL {
            assert_eq!(Excitation::from_name(excitation.name()), Some(excitation));
            let d = Drive::new(excitation, 5, 90.0);
            let mut most = 0.0_f64;
            let mut fastest = 0.0_f64;
            let mut before = d.at(0.0);
            assert_eq!(before, [0.0; CHAMBERS]);
            for k in 1..9000 {
                let now = d.at(k as f64 * 0.01);
                for i in 0..CHAMBERS {
                    most = most.max(now[i].abs());
                    fastest = fastest.max((now[i] - before[i]).abs() / 0.01);
                }
                before = now;
            }
            assert!(most <= MOST_PA, "{}: {most} Pa", excitation.name());
            assert!(fastest < 40e3, "{}: {fastest} Pa/s", excitation.name());
            assert_eq!(most > 15e3, excitation != Excitation::Still);
        }
    }

    #[test]
    fn the_seed_decides() {
        let at = |seed| Drive::new(Excitation::Mixed, seed, 60.0).at(30.0);
        assert_eq!(at(1), at(1));
        assert_ne!(at(1), at(2));
    }
}
