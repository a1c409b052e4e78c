//! Cases for a blind test: a healthy session, a suspect one, and what is hidden in it.
//!
//! Strength is the RMS change that the effect makes in its most sensitive channel, over the floor of
//! that channel: what the nominal model leaves of a healthy session of the same rig, noise and
//! model error together, after a regression on the pressures that stands for commissioning.

use std::ops::Range;

use nalgebra::{DMatrix, DVector};
use rand::Rng;
use rand_pcg::Pcg64Mcg;
use serde::Serialize;

use super::{Hidden, Kind, Magnitude, Scope, Shows, Signed};
use crate::rig::session::{
    Fineness, Noise, Session, SessionError, SessionPlan, generate, sub_seed,
};
use crate::robot::RobotSpec;
use crate::signal::{CHAMBERS, SensorVec, pose_error};
use crate::sim::dataset::sample_rng;
use crate::sim::{Inputs, Model, SimError, State, observe, settle};

/// A strength within this share of what is wanted is right.
const CLOSE_ENOUGH: f64 = 0.05;
/// Sample rates of the drafts that size an effect and of the session that gives the noise floor, Hz.
const DRAFT_HZ: f64 = 25.0;
const FLOOR_HZ: f64 = 10.0;
/// Length of the healthy session that gives the noise floor, s.
const FLOOR_S: f64 = 60.0;

/// Kind of a blind case.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum CaseKind {
    /// One effect of the table.
    Single,
    /// Nothing.
    Null,
    /// One that the table does not have.
    #[serde(rename = "alien")]
    Unmodelled,
    /// Two effects of different sides.
    Pair,
}

/// A blind case. The sessions are made by [`crate::rig::session()`].
#[derive(Clone, Debug)]
pub struct Case {
    /// The rig when it was healthy.
    pub commissioning: SessionPlan,
    /// The rig later.
    pub suspect: SessionPlan,
    /// What is hidden in it.
    pub truth: Truth,
}

/// The answer key.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Truth {
    /// What the case is about.
    pub kind: CaseKind,
    /// Wanted strength, times the floor.
    pub strength: f64,
    /// What is hidden.
    pub effects: Vec<Answer>,
}

/// One hidden effect in the answer key.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Answer {
    /// Id of the effect.
    pub id: &'static str,
    /// Chamber, spring, IMU or segment, 1-based; `None`: all, or none there are.
    pub target: Option<usize>,
    /// Its parameters; same name as the candidate effect's, same meaning.
    pub params: std::collections::BTreeMap<&'static str, Value>,
    /// Strength in times the floor, as sized.
    pub reached: Option<f64>,
    /// Whether a bound kept it from the wanted strength.
    pub capped: bool,
}

/// A value with its unit.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Value {
    /// The value.
    pub value: f64,
    /// Its SI unit.
    pub unit: &'static str,
}

impl Answer {
    /// The answer for an effect whose strength was not sized.
    pub fn new(hidden: &Hidden) -> Self {
        let pairs = hidden.kind().magnitudes.iter().zip(&hidden.values);
        let params = pairs.map(|(m, &value)| {
            (
                m.name,
                Value {
                    value,
                    unit: m.unit,
                },
            )
        });
        Self {
            id: hidden.id,
            target: hidden.target.map(|i| i + 1),
            params: params.collect(),
            reached: None,
            capped: false,
        }
    }
}

/// A case that hides `kinds`, each `strength` times the floor strong; targets, signs and shapes are drawn.
/// Its sessions are like `plan` in length, rate, excitation and payload.
///
/// # Errors
/// [`SessionError`] when the healthy rig cannot be run.
pub fn case_like(
    plan: &SessionPlan,
    robot: &RobotSpec,
    seed: u64,
    kind: CaseKind,
    kinds: &[&'static Kind],
    strength: f64,
) -> Result<Case, SessionError> {
    let commissioning = SessionPlan {
        name: "commissioning".to_owned(),
        seed: sub_seed(seed, 1),
        specimen: sub_seed(seed, 3),
        hidden: Vec::new(),
        ..plan.clone()
    };
    let healthy = SessionPlan {
        name: "suspect".to_owned(),
        seed: sub_seed(seed, 2),
        ..commissioning.clone()
    };
    let mut truth = Truth {
        kind,
        strength: if kinds.is_empty() { 0.0 } else { strength },
        effects: Vec::new(),
    };
    let mut hidden = Vec::new();
    if !kinds.is_empty() {
        let mut rng = sample_rng(seed, 0xd2a3);
        let floor = floor(robot, &commissioning)?;
        let sizing = Sizing::new(robot, &healthy, floor)?;
        for kind in kinds {
            let drawn = draw(kind, &mut rng);
            let sized = sizing.size(&drawn, strength);
            truth.effects.push(Answer {
                reached: Some(sized.reached),
                capped: (sized.reached / strength - 1.0).abs() > CLOSE_ENOUGH,
                ..Answer::new(&sized.hidden)
            });
            hidden.push(sized.hidden);
        }
    }
    Ok(Case {
        commissioning,
        suspect: SessionPlan { hidden, ..healthy },
        truth,
    })
}

/// A usual effect of this kind.
pub fn draw(kind: &'static Kind, rng: &mut Pcg64Mcg) -> Hidden {
    let count = kind.target.count();
    let single = match kind.scope {
        Scope::Common => false,
        Scope::One => true,
        Scope::Either => rng.random(),
    };
    let target = (single && count > 0).then(|| rng.random_range(0..count));
    let value = |m: &Magnitude| {
        let [low, high] = m.usual;
        let drawn = low + (high - low) * rng.random::<f64>();
        let mirrored = m.signed == Signed::Free && rng.random::<bool>();
        if mirrored {
            2.0 * m.none - drawn
        } else {
            drawn
        }
    };
    Hidden {
        id: kind.id,
        target,
        values: kind.magnitudes.iter().map(value).collect(),
    }
}

/// Number of channels that are compared.
const CHANNELS: usize = 36;

/// Channels of a kind's readings.
fn channels(shows: Shows) -> Range<usize> {
    match shows {
        Shows::Pressure => 0..6,
        Shows::Pose => 6..12,
        Shows::Springs => 12..24,
        Shows::Imus => 24..36,
    }
}

/// All readings of a sample in a row, pose and IMUs as errors against the reference sample `k`.
fn differences(a: &Session, b: &Session, k: usize) -> [f64; CHANNELS] {
    let mut out = [0.0; CHANNELS];
    for i in 0..CHAMBERS {
        out[i] = b.chamber_pa[k][i] - a.chamber_pa[k][i];
    }
    let pose = pose_error(&b.captured[k], &a.captured[k]);
    out[6..12].copy_from_slice(pose.as_slice());
    sensor_differences(&a.sensors[k], &b.sensors[k], &mut out);
    out
}

fn sensor_differences(a: &SensorVec, b: &SensorVec, out: &mut [f64; CHANNELS]) {
    for (i, (x, y)) in a.spring_m.iter().zip(&b.spring_m).enumerate() {
        out[12 + i] = y - x;
    }
    for i in 0..a.imu_ypr_rad.len() {
        let turned = b.base_from_imu_pad(i) * a.base_from_imu_pad(i).inverse();
        out[24 + 3 * i..27 + 3 * i].copy_from_slice(turned.scaled_axis().as_slice());
    }
}

/// Root mean square of the change per channel: six pressures (Pa), the captured pose (m, then rad),
/// twelve springs (m), the rotation vectors of four IMUs (rad).
pub fn change(a: &Session, b: &Session) -> Vec<f64> {
    let n = a.t_s.len().min(b.t_s.len());
    let mut square = [0.0; CHANNELS];
    for k in 0..n {
        for (s, d) in square.iter_mut().zip(differences(a, b, k)) {
            *s += d * d;
        }
    }
    square
        .iter()
        .map(|s| (s / n.max(1) as f64).sqrt())
        .collect()
}

/// Residual of the nominal model on a healthy session, per channel as in [`change`].
///
/// # Errors
/// [`SessionError`] when the session cannot be run or replayed.
pub fn floor(robot: &RobotSpec, plan: &SessionPlan) -> Result<Vec<f64>, SessionError> {
    let healthy = SessionPlan {
        hidden: Vec::new(),
        rate_hz: FLOOR_HZ,
        seconds: plan.seconds.min(FLOOR_S),
        ..plan.clone()
    };
    let s = generate(robot, &healthy, Noise::On, Fineness::Full)?;
    let replayed = replay(robot, &s)?;
    let n = s.t_s.len();
    let y: Vec<[f64; CHANNELS]> = (0..n).map(|k| differences(&replayed, &s, k)).collect();
    // Pressures: the command now and some samples ago stand for the regulator.
    let lags = [0usize, 1, 2, 4];
    let mut out = Vec::with_capacity(CHANNELS);
    for c in 0..CHANNELS {
        let x = if c < 6 {
            DMatrix::from_fn(n, 1 + lags.len(), |k, j| match j {
                0 => 1.0,
                _ => s.commanded_pa[k.saturating_sub(lags[j - 1])][c] / 1e4,
            })
        } else {
            DMatrix::from_fn(n, 1 + CHAMBERS, |k, j| match j {
                0 => 1.0,
                _ => s.chamber_pa[k][j - 1] / 1e4,
            })
        };
        let y = DVector::from_fn(n, |k, _| y[k][c]);
        out.push(unexplained(&x, &y));
    }
    Ok(out)
}

/// RMS residual of a least-squares fit.
fn unexplained(x: &DMatrix<f64>, y: &DVector<f64>) -> f64 {
    let left = match (x.transpose() * x).cholesky() {
        Some(factor) => y - x * factor.solve(&(x.transpose() * y)),
        // Nothing was moved: only the mean can be taken off.
        None => y.add_scalar(-y.mean()),
    };
    left.norm() / (y.len() as f64).sqrt()
}

/// The nominal arm at the measured pressures of a session.
fn replay(robot: &RobotSpec, s: &Session) -> Result<Session, SessionError> {
    let model = Model::nominal(robot);
    let mut state = State::rest(&model);
    let mut out = Session {
        chamber_pa: s.commanded_pa.clone(),
        ..s.clone()
    };
    for k in 0..s.t_s.len() {
        let inputs = Inputs {
            chamber_pa: s.chamber_pa[k],
            payload_kg: s.payload_kg,
            ..Inputs::default()
        };
        let failed = |reason: SimError| SessionError::Arm {
            t_s: s.t_s[k],
            reason,
        };
        settle(&model, &mut state, &inputs).map_err(failed)?;
        let o = observe(&model, &state);
        out.captured[k] = o.base_from_tip;
        out.sensors[k] = o.sensors;
    }
    Ok(out)
}

/// An effect brought to a strength.
#[derive(Clone, Debug)]
pub struct Sized {
    /// The effect.
    pub hidden: Hidden,
    /// Its strength, times the floor.
    pub reached: f64,
}

/// Sizes effects against the floor of one rig.
pub struct Sizing<'a> {
    robot: &'a RobotSpec,
    plan: SessionPlan,
    floor: Vec<f64>,
    healthy: Session,
}

impl<'a> Sizing<'a> {
    /// For effects that act in `plan`, with the floor of its rig.
    ///
    /// # Errors
    /// [`SessionError`] when the healthy rig cannot be run.
    pub fn new(
        robot: &'a RobotSpec,
        plan: &SessionPlan,
        floor: Vec<f64>,
    ) -> Result<Self, SessionError> {
        let plan = SessionPlan {
            hidden: Vec::new(),
            rate_hz: DRAFT_HZ,
            ..plan.clone()
        };
        let healthy = generate(robot, &plan, Noise::Off, Fineness::Draft)?;
        Ok(Self {
            robot,
            plan,
            floor,
            healthy,
        })
    }

    /// The strength of an effect; infinite where the arm cannot hold it.
    pub fn strength(&self, hidden: &Hidden) -> f64 {
        let plan = SessionPlan {
            hidden: vec![hidden.clone()],
            ..self.plan.clone()
        };
        let Ok(with) = generate(self.robot, &plan, Noise::Off, Fineness::Draft) else {
            return f64::INFINITY;
        };
        let moved = change(&self.healthy, &with);
        channels(hidden.kind().shows)
            .map(|c| moved[c] / self.floor[c])
            .fold(0.0, f64::max)
    }

    /// Scales an effect until it has the strength `wanted`, as far as its bounds allow.
    pub fn size(&self, drawn: &Hidden, wanted: f64) -> Sized {
        const MOST_TRIALS: usize = 14;
        // Scales with too little and with too much, and the strengths there.
        let (mut low, mut high): ([f64; 2], Option<[f64; 2]>) = ([0.0; 2], None);
        let mut scale = 1.0;
        let mut best = Sized {
            hidden: drawn.scaled(0.0),
            reached: 0.0,
        };
        for _ in 0..MOST_TRIALS {
            let hidden = drawn.scaled(scale);
            let reached = self.strength(&hidden);
            let capped = hidden == drawn.scaled(2.0 * scale);
            let off = |r: f64| (r.max(1e-3) / wanted).ln().abs();
            if off(reached) < off(best.reached) {
                best = Sized { hidden, reached };
            }
            if off(best.reached) < CLOSE_ENOUGH || (reached < wanted && capped) {
                break;
            }
            if reached < wanted {
                low = [scale, reached];
            } else {
                high = Some([scale, reached]);
            }
            scale = match high {
                // Nearly proportional: a jump by the ratio, but not too far.
                None => scale * (wanted / low[1].max(1e-9)).clamp(1.3, 4.0),
                Some([s, r]) if r.is_finite() && low[1] > 0.0 => {
                    let slope = (s / low[0]).ln() / (r / low[1]).ln();
                    let guess = low[0] * (slope * (wanted / low[1]).ln()).exp();
                    // Kept off the ends, so that the bracket shrinks.
                    guess.clamp(low[0] + 0.1 * (s - low[0]), s - 0.1 * (s - low[0]))
                }
                Some([s, r]) if r.is_finite() && low[0] == 0.0 => s * (wanted / r).clamp(0.1, 0.9),
                Some([s, _]) => 0.5 * (low[0] + s),
            };
        }
        best
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rig::hidden::HIDDEN;

    fn case_of(
        robot: &RobotSpec,
        seed: u64,
        kind: CaseKind,
        kinds: &[&'static Kind],
        strength: f64,
    ) -> Result<Case, SessionError> {
        case_like(&SessionPlan::default(), robot, seed, kind, kinds, strength)
    }

    #[test]
    fn a_single_case_has_the_strength_that_was_asked_for() {
        let robot = RobotSpec::reference();
        let kind = crate::rig::hidden::kind("payload").expect("kind");
        let case = case_of(&robot, 4, CaseKind::Single, &[kind], 4.0).expect("drawn");
        assert!(case.commissioning.hidden.is_empty());
        assert_eq!(case.commissioning.specimen, case.suspect.specimen);
        assert_ne!(case.commissioning.seed, case.suspect.seed);
        let answer = &case.truth.effects[0];
        assert!(!answer.capped, "{answer:?}");
        assert!((answer.reached.expect("sized") - 4.0).abs() < 0.25);
        assert_eq!(
            answer.params["mass"].value,
            case.suspect.hidden[0].values[0]
        );
        // Half the strength needs about half the mass.
        let half = case_of(&robot, 4, CaseKind::Single, &[kind], 2.0).expect("drawn");
        let ratio = half.suspect.hidden[0].values[0] / answer.params["mass"].value;
        assert!((0.4..0.6).contains(&ratio), "{ratio}");
    }

    /// Prints the floors of a rig and how strong usual effects are; asserts nothing.
    #[test]
    #[ignore = "prints a table"]
    fn how_strong_usual_effects_are() {
        let robot = RobotSpec::reference();
        let plan = SessionPlan::default();
        let floor = floor(&robot, &plan).expect("runs");
        println!("{floor:.6?}");
        let sizing = Sizing::new(&robot, &plan, floor).expect("runs");
        for kind in HIDDEN {
            let target = (kind.scope != Scope::Common).then_some(0);
            let usual = Hidden::new(kind.id, target, &[]).expect("kind");
            let sized = sizing.size(&usual, 4.0);
            println!(
                "{:24} usual {:.2}, at 4: {:.2} {:?}",
                kind.id,
                sizing.strength(&usual),
                sized.reached,
                sized.hidden.values
            );
        }
    }

    #[test]
    fn kinds_of_cases_hide_what_they_say() {
        let robot = RobotSpec::reference();
        let null = case_of(&robot, 1, CaseKind::Null, &[], 4.0).expect("drawn");
        assert!(null.suspect.hidden.is_empty() && null.truth.effects.is_empty());
        let mut rng = sample_rng(7, 0);
        for kind in HIDDEN {
            for _ in 0..20 {
                let h = draw(kind, &mut rng);
                assert!(Hidden::new(h.id, h.target, &h.values).is_ok(), "{h:?}");
                if kind.scope == Scope::One {
                    assert!(h.target.is_some());
                }
                let bare = h.scaled(0.0);
                for (m, v) in kind.magnitudes.iter().zip(&bare.values) {
                    assert!(m.growth == crate::rig::hidden::Growth::Shape || *v == m.none);
                }
            }
        }
    }
}
