//! What is tried: every effect of a table on every channel it can sit on.

use super::session::Grid;
use crate::signal::CHAMBERS;
pub use crate::sim::effects::Start;
use crate::sim::effects::{Active, Effect, Reach, Scene};

/// Effects that are looked for.
pub type Table<'a> = &'a [&'static Effect];

/// An effect on a channel.
#[derive(Clone, Copy, Debug)]
pub struct Candidate {
    /// The effect.
    pub effect: &'static Effect,
    /// The channel (0-based); `None`: all of them, or nothing to choose.
    pub target: Option<usize>,
}

impl PartialEq for Candidate {
    fn eq(&self, other: &Self) -> bool {
        self.effect.id == other.effect.id && self.target == other.target
    }
}

impl Candidate {
    /// With these parameter values.
    pub fn with(&self, values: &[f64]) -> Active {
        Active {
            effect: self.effect,
            target: self.target,
            values: values.to_vec(),
        }
    }

    /// Values without the effect.
    pub fn nominal(&self) -> Vec<f64> {
        self.effect.parameters.iter().map(|p| p.nominal).collect()
    }

    /// Where a search starts in this session.
    pub fn starts(&self, scene: &Scene) -> Vec<Start> {
        (self.effect.starts)(scene, self.target)
    }

    /// Usual size of each parameter's departure, for steps and scaling.
    pub fn scale(&self) -> Vec<f64> {
        let starts = self.starts(&Scene::default());
        let from_starts = |i: usize, nominal: f64| {
            let moved = starts.iter().filter(|s| s.moves.contains(&i));
            let most = moved.map(|s| (s.at[i] - nominal).abs()).fold(0.0, f64::max);
            match starts.first() {
                Some(first) if most == 0.0 => 0.3 * first.at[i].abs(),
                _ => most,
            }
        };
        let parameters = self.effect.parameters.iter().enumerate();
        parameters
            .map(|(i, p)| p.scale.unwrap_or_else(|| from_starts(i, p.nominal)))
            .collect()
    }
}

/// Every candidate of the effects of `table` that `keep` admits.
pub fn candidates(table: Table<'_>, keep: impl Fn(&Effect) -> bool) -> Vec<Candidate> {
    let mut out = Vec::new();
    for &effect in table.iter().filter(|e| keep(e)) {
        let (common, single) = match effect.reach {
            Reach::Common => (true, false),
            Reach::Single => (false, true),
            Reach::Either => (true, true),
        };
        if common {
            out.push(Candidate {
                effect,
                target: None,
            });
        }
        if single {
            out.extend((0..effect.target.count()).map(|i| Candidate {
                effect,
                target: Some(i),
            }));
        }
    }
    out
}

/// What sessions of the arm offer to starts. Each has times of its own.
pub fn scene(grids: &[&Grid]) -> Scene {
    let captured = grids.iter().flat_map(|g| g.captured.iter().flatten());
    let lasts = |g: &&Grid| g.t_s[g.len() - 1] - g.t_s[0];
    let speeds = grids
        .iter()
        .map(|g| fastest(&g.t_s, &g.binned(&g.gauge_pa)));
    Scene {
        seconds: grids.iter().map(lasts).fold(0.0, f64::max),
        tip_m: captured.map(|p| p.translation.vector.into()).collect(),
        still_since_s: std::array::from_fn(|i| {
            let rests = |g: &&Grid| {
                let read_m: Vec<f64> = g.sensors.iter().map(|s| s.spring_m[i]).collect();
                still_since(&g.t_s, &read_m)
            };
            grids.iter().find_map(rests)
        }),
        fastest_pa_s: speeds.fold([0.0; CHAMBERS], |most, next| {
            std::array::from_fn(|i| f64::max(most[i], next[i]))
        }),
    }
}

/// A reading that stays within this share of its range is the same.
const STILL: f64 = 0.03;
/// Nor does it move where it stays within this, m.
const STILL_M: f64 = 2e-4;
/// A reading that rests for less than this at the end may just rest, s.
const STILL_S: f64 = 1.0;

/// Since when a series is the same until its end, from the start of its times; `None` where it moves.
fn still_since(t_s: &[f64], x: &[f64]) -> Option<f64> {
    let known: Vec<usize> = (0..x.len()).filter(|k| x[*k].is_finite()).collect();
    let (low, high) = known.iter().fold((f64::MAX, f64::MIN), |(l, h), k| {
        (l.min(x[*k]), h.max(x[*k]))
    });
    let last = *known.last()?;
    let within = (STILL * (high - low)).max(STILL_M);
    let moves = known
        .iter()
        .rposition(|k| (x[*k] - x[last]).abs() > within)?;
    let since_s = t_s[*known.get(moves + 1)?];
    (t_s[last] - since_s > STILL_S).then_some(since_s - t_s[0])
}

/// How fast each chamber's pressure changes over five samples, 99 % of the time at most, Pa/s.
pub fn fastest(t_s: &[f64], pressure_pa: &[[f64; CHAMBERS]]) -> [f64; CHAMBERS] {
    const APART: usize = 5;
    std::array::from_fn(|i| {
        let times = t_s.windows(APART + 1);
        let mut rates: Vec<f64> = pressure_pa
            .windows(APART + 1)
            .zip(times)
            .map(|(p, t)| (p[APART][i] - p[0][i]).abs() / (t[APART] - t[0]))
            .collect();
        rates.sort_by(f64::total_cmp);
        rates
            .get((0.99 * rates.len() as f64) as usize)
            .copied()
            .unwrap_or(0.0)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sim::effects::EFFECTS;

    #[test]
    fn a_reading_that_stays_is_found_and_one_that_moves_is_not() {
        let t_s: Vec<f64> = (0..900).map(|k| 5.0 + 0.1 * f64::from(k)).collect();
        let moving: Vec<f64> = t_s.iter().map(|t| 0.15 + 0.02 * (0.7 * t).sin()).collect();
        let stuck: Vec<f64> = t_s
            .iter()
            .map(|t| 0.15 + 0.02 * (0.7 * t.min(26.5)).sin())
            .collect();
        assert_eq!(still_since(&t_s, &moving), None);
        let since_s = still_since(&t_s, &stuck).expect("it stays to the end");
        assert!((since_s - 21.5).abs() < 0.3, "{since_s}");
        assert_eq!(still_since(&t_s, &vec![0.15; 900]), None);
    }

    #[test]
    fn every_effect_is_tried_within_its_bounds() {
        let table: Vec<&'static Effect> = EFFECTS.iter().collect();
        let scene = Scene {
            seconds: 90.0,
            tip_m: vec![[0.0, 0.0, -0.3]; 20],
            still_since_s: [Some(40.0); crate::signal::SPRINGS],
            fastest_pa_s: [10e3; CHAMBERS],
        };
        for e in EFFECTS {
            let all = candidates(&table, |x| x.id == e.id);
            assert!(!all.is_empty(), "{}", e.id);
            let starts = all[0].starts(&scene);
            assert!(!starts.is_empty(), "{}", e.id);
            for s in starts {
                assert_eq!(s.at.len(), e.parameters.len(), "{}", e.id);
                assert!(!s.moves.is_empty());
                for (p, v) in e.parameters.iter().zip(&s.at) {
                    assert!((p.bounds[0]..=p.bounds[1]).contains(v), "{}", e.id);
                }
            }
            assert!(all[0].scale().iter().all(|s| *s > 0.0), "{}", e.id);
        }
    }
}
