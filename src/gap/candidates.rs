//! What is tried: every effect of the table on every channel it can sit on, with starting shapes.

use super::session::Grid;
use crate::sim::effects::{Active, EFFECTS, Effect, Target};

/// An effect on a channel (0-based; `None`: all of them, or nothing to choose).
#[derive(Clone, Copy, Debug)]
pub struct Candidate {
    /// The effect.
    pub effect: &'static Effect,
    /// The channel.
    pub target: Option<usize>,
}

impl PartialEq for Candidate {
    fn eq(&self, other: &Self) -> bool {
        self.effect.id == other.effect.id && self.target == other.target
    }
}

/// One way to start: parameter values, and the parameters whose share is looked for at first.
#[derive(Clone, Debug)]
pub struct Start {
    /// Value of every parameter.
    pub at: Vec<f64>,
    /// Parameters that are moved from nominal towards `at`, each giving one column.
    pub moves: Vec<usize>,
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

    /// Usual size of each parameter's departure, for steps and scaling.
    pub fn scale(&self) -> Vec<f64> {
        let starts = starts(self.effect.id, &[-0.3]);
        let nominal = self.nominal();
        (0..nominal.len())
            .map(|i| {
                let moved = starts
                    .iter()
                    .filter(|s| s.moves.contains(&i))
                    .map(|s| (s.at[i] - nominal[i]).abs())
                    .fold(0.0, f64::max);
                // A limit that does not limit lies far away: its distance is no size.
                if moved > 0.0 && self.effect.id != "flow-limit" {
                    moved
                } else {
                    0.3 * starts[0].at[i].abs()
                }
            })
            .collect()
    }
}

/// Whether an effect hits single channels, all at once, or either.
enum Reach {
    Single,
    Common,
    Either,
}

fn reach(effect: &Effect) -> Reach {
    match (effect.target, effect.id) {
        (Target::None, _) | (_, "spring-drift") => Reach::Common,
        (_, "chamber-stiffness" | "gauge-error" | "leak") => Reach::Single,
        (_, "spring-calibration" | "spring-stuck") | (Target::Imu, _) => Reach::Single,
        _ => Reach::Either,
    }
}

/// Every candidate that `keep` admits.
pub fn candidates(keep: impl Fn(&Effect) -> bool) -> Vec<Candidate> {
    let mut out = Vec::new();
    for effect in EFFECTS.iter().filter(|e| keep(e)) {
        let all = Candidate {
            effect,
            target: None,
        };
        let each = (0..effect.target.count()).map(|i| Candidate {
            effect,
            target: Some(i),
        });
        match reach(effect) {
            Reach::Common => out.push(all),
            Reach::Single => out.extend(each),
            Reach::Either => {
                out.push(all);
                out.extend(each);
            }
        }
    }
    out
}

/// Heights of a floor and moments of a fault that are tried come from the session.
pub fn starts_in(candidate: &Candidate, grid: &Grid) -> Vec<Start> {
    let places: Vec<f64> = match candidate.effect.id {
        "contact" => {
            let mut z: Vec<f64> = grid
                .captured
                .iter()
                .flatten()
                .map(|p| p.translation.vector.z)
                .collect();
            z.sort_by(f64::total_cmp);
            [0.05, 0.2, 0.4, 0.7]
                .iter()
                .filter_map(|q| z.get((q * z.len() as f64) as usize).copied())
                .collect()
        }
        "spring-stuck" => {
            let seconds = grid.t_s[grid.len() - 1] - grid.t_s[0];
            let throughout = (0..10).map(|k| seconds * f64::from(k) / 10.0);
            // A fault that has just begun shows for a few seconds only.
            throughout
                .chain([6.0, 4.0, 3.0, 2.0, 1.0].map(|left| seconds - left))
                .collect()
        }
        _ => vec![-0.3],
    };
    starts(candidate.effect.id, &places)
}

/// Starting shapes of an effect. `places`: floor heights (m) or times (s) to try.
pub fn starts(id: &str, places: &[f64]) -> Vec<Start> {
    let one = |at: &[f64], moves: &[usize]| Start {
        at: at.to_vec(),
        moves: moves.to_vec(),
    };
    match id {
        "pressure-delay" => vec![one(&[0.05], &[0]), one(&[0.4], &[0])],
        "flow-limit" => [3e3, 8e3, 20e3]
            .iter()
            .map(|r| one(&[*r, *r], &[0]))
            .collect(),
        "leak" => vec![one(&[0.5], &[0])],
        "supply-coupling" => vec![one(&[0.05, 0.1], &[0]), one(&[0.05, 0.8], &[0])],
        "pressure-lag" => vec![one(&[0.1], &[0]), one(&[0.8], &[0])],
        "gauge-error" => vec![one(&[1.03, 300.0], &[0, 1])],
        "hysteresis" => [0.003, 0.01, 0.03]
            .iter()
            .map(|w| one(&[4.0, *w], &[0]))
            .collect(),
        "creep" => [1.0, 3.0, 12.0, 60.0]
            .iter()
            .map(|t| one(&[0.1, *t], &[0]))
            .collect(),
        "stiffening" => vec![one(&[0.3], &[0])],
        "damping" => vec![one(&[0.15], &[0]), one(&[0.8], &[0])],
        "chamber-stiffness" => vec![one(&[1.05], &[0])],
        "payload" => vec![one(&[0.1], &[0])],
        "com-offset" => vec![one(&[0.02, 0.02, 0.02], &[0, 1, 2])],
        "base-tilt" => vec![one(&[0.03, 0.03], &[0, 1])],
        "tip-force" => vec![one(&[0.5, 0.5, 0.5], &[0, 1, 2])],
        "contact" => places
            .iter()
            .map(|z| one(&[*z, 300.0, 0.2], &[0]))
            .collect(),
        "torsion" => vec![one(&[1.3], &[0])],
        "spring-lag" => vec![one(&[0.1], &[0]), one(&[0.6], &[0])],
        "spring-crosstalk" => vec![one(&[0.03], &[0])],
        "spring-calibration" => vec![one(&[1.03, 1e-3], &[0, 1])],
        "spring-drift" => vec![one(&[2e-5], &[0])],
        "spring-stuck" => places.iter().map(|t| one(&[*t], &[0])).collect(),
        "imu-drift" => vec![one(&[1e-3], &[0])],
        "imu-misalignment" => vec![one(&[0.02, 0.02, 0.02], &[0, 1, 2])],
        "clock-skew" => vec![one(&[2e-3], &[0])],
        "clock-offset" => vec![one(&[0.05], &[0]), one(&[0.4], &[0])],
        "mocap-frame" => vec![one(
            &[3e-3, 3e-3, 3e-3, 0.01, 0.01, 0.01],
            &[0, 1, 2, 3, 4, 5],
        )],
        // A new effect starts half way to its upper bound until a better start is known.
        _ => {
            let Some(e) = crate::sim::effects::effect(id) else {
                return Vec::new();
            };
            let at: Vec<f64> = e
                .parameters
                .iter()
                .map(|p| p.nominal + 0.1 * (p.bounds[1] - p.nominal))
                .collect();
            let moves: Vec<usize> = (0..at.len()).collect();
            vec![one(&at, &moves)]
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_effect_is_tried_within_its_bounds() {
        for e in EFFECTS {
            let all = candidates(|x| x.id == e.id);
            assert!(!all.is_empty(), "{}", e.id);
            for s in starts(e.id, &[-0.3]) {
                assert_eq!(s.at.len(), e.parameters.len(), "{}", e.id);
                assert!(!s.moves.is_empty());
                for (p, v) in e.parameters.iter().zip(&s.at) {
                    assert!((p.bounds[0]..=p.bounds[1]).contains(v) || e.id == "spring-stuck");
                }
            }
            assert!(all[0].scale().iter().all(|s| *s > 0.0), "{}", e.id);
        }
    }
}
