//! Cases for a blind test: a healthy session, a suspect one, and what is hidden in it.
//!
//! Strength is the RMS change that the effect makes in its most sensitive channel, over the noise floor of that
//! channel: the residual of the nominal model in a healthy session of the same rig, noise and model error together,
//! after a regression on the pressures that stands for commissioning.
//!
//! An effect is sized by running the suspect's plan with and without it, with the same seed: motion and noise are the
//! same, and the difference is the effect. Noise that differs all the same (the effect may change how often the rig
//! draws a number) is white, so half the mean square of successive differences is its variance
//! (J. von Neumann 1941, doi:10.1214/aoms/1177731677); it is subtracted in quadrature.
//!
//! Runs with an effect that acts in the same way all the time end after `SIZING_S`: strength is then that of the
//! session's first part.

use std::ops::Range;

use nalgebra::{DMatrix, DVector};
use rand::Rng;
use rand_pcg::Pcg64Mcg;
use serde::Serialize;

use crate::lab::session::{Session, SessionError, SessionPlan, Specimen, changes_with_time};
use crate::rig::hidden::{Hidden, Kind, Magnitude, Scope, Shows, Signed};
use crate::robot::RobotSpec;
use crate::signal::{CHAMBERS, SensorVec, pose_error};
use crate::sim::dataset::sample_rng;
use crate::sim::{Inputs, Model, State, observe, settle};

/// A strength within this share of what is wanted is right.
const CLOSE_ENOUGH: f64 = 0.08;
/// Runs of the rig that size one effect, at most.
const MOST_TRIALS: usize = 8;
/// An effect below this share of a stronger one's strength has not set in.
const NEARLY_NOTHING: f64 = 0.02;
/// Sample rate of the runs that size an effect, Hz.
const SIZING_HZ: f64 = 20.0;
/// Part of the session in which an effect may begin: enough is left before and after.
const BEGINS: Range<f64> = 0.25..0.65;
/// Length of a run that sizes an effect which does not change with time, s.
const SIZING_S: f64 = 50.0;
/// Samples of the healthy session per one that is replayed for the noise floor.
const FLOOR_EVERY: usize = 2;

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
    /// One effect of the table that begins within the session.
    Begun,
}

/// A blind case. The sessions are made by [`crate::lab::session()`].
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
    /// When it begins, s; `None` for what is there from the start.
    pub onset_s: Option<f64>,
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
    /// Strength in times the floor, as sized; `None` where it was not sized.
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
        onset_s: (kind == CaseKind::Begun).then(|| {
            let share = sample_rng(seed, 0x0b5e).random_range(BEGINS);
            share * plan.seconds
        }),
    };
    let mut hidden = Vec::new();
    if !kinds.is_empty() {
        let mut rng = sample_rng(seed, 0xd2a3);
        let specimen = Specimen::new(robot, commissioning.specimen)?;
        let sizing = Sizing::new(&specimen, &healthy)?;
        for kind in kinds {
            let drawn = draw(kind, &mut rng);
            let sized = sizing.size(&drawn, strength);
            truth.effects.push(Answer {
                reached: Some(sized.reached),
                capped: (sized.reached / strength - 1.0).abs() > CLOSE_ENOUGH,
                ..Answer::new(&sized.hidden)
            });
            hidden.push(sized.hidden.from(truth.onset_s.unwrap_or(0.0)));
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
        from_s: 0.0,
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

/// All readings of sample `k` in a row, `b` less `a`, pose and IMUs as rotation vectors; NaN where one is missing.
fn differences(a: &Session, b: &Session, k: usize) -> [f64; CHANNELS] {
    let mut out = [f64::NAN; CHANNELS];
    for i in 0..CHAMBERS {
        out[i] = b.chamber_pa[k][i] - a.chamber_pa[k][i];
    }
    if let (Some(from), Some(to)) = (&a.captured[k], &b.captured[k]) {
        out[6..12].copy_from_slice(pose_error(to, from).as_slice());
    }
    sensor_differences(&a.sensors[k], &b.sensors[k], &mut out);
    out
}

fn sensor_differences(a: &SensorVec, b: &SensorVec, out: &mut [f64; CHANNELS]) {
    for (i, (x, y)) in a.spring_m.iter().zip(&b.spring_m).enumerate() {
        out[12 + i] = y - x;
    }
    for i in 0..a.imu_ypr_rad.len() {
        let both = a.imu_ypr_rad[i].iter().chain(&b.imu_ypr_rad[i]);
        if both.copied().all(f64::is_finite) {
            let turned = b.base_from_imu_pad(i) * a.base_from_imu_pad(i).inverse();
            out[24 + 3 * i..27 + 3 * i].copy_from_slice(turned.scaled_axis().as_slice());
        }
    }
}

/// Root mean square of the change per channel, without white noise: six pressures (Pa), the captured pose (m, then
/// rad), twelve springs (m), the rotation vectors of four IMUs (rad). Compared as far as both sessions reach; where a
/// sample is missing in either, it does not count.
pub fn change(a: &Session, b: &Session) -> Vec<f64> {
    let n = a.t_s.len().min(b.t_s.len());
    let rows: Vec<[f64; CHANNELS]> = (0..n).map(|k| differences(a, b, k)).collect();
    let channel = |c: usize| {
        let square = mean(rows.iter().map(|d| d[c] * d[c]));
        let noise = 0.5 * mean(rows.windows(2).map(|w| (w[1][c] - w[0][c]).powi(2)));
        (square - noise).max(0.0).sqrt()
    };
    (0..CHANNELS).map(channel).collect()
}

/// Mean of the finite values; 0 without any.
fn mean(values: impl Iterator<Item = f64>) -> f64 {
    let (mut sum, mut n) = (0.0, 0_usize);
    for v in values.filter(|v| v.is_finite()) {
        sum += v;
        n += 1;
    }
    sum / n.max(1) as f64
}

/// Residual of the nominal model in a healthy session, per channel as in [`change`]; infinite for a channel that was
/// not measured.
///
/// # Errors
/// [`SessionError::Model`] when the session cannot be replayed.
pub fn floor(robot: &RobotSpec, healthy: &Session) -> Result<Vec<f64>, SessionError> {
    let s = thinned(healthy, FLOOR_EVERY);
    let replayed = replay(robot, &s)?;
    let n = s.t_s.len();
    let y: Vec<[f64; CHANNELS]> = (0..n).map(|k| differences(&replayed, &s, k)).collect();
    // Pressures: the command now and some samples ago stand for the regulator.
    let lags = [0usize, 1, 2, 4];
    let column = |c: usize, k: usize, j: usize| match (c < CHAMBERS, j) {
        (_, 0) => 1.0,
        (true, j) => s.commanded_pa[k.saturating_sub(lags[j - 1])][c] / 1e4,
        (false, j) => s.chamber_pa[k][j - 1] / 1e4,
    };
    let of = |c: usize| {
        let width = 1 + if c < CHAMBERS { lags.len() } else { CHAMBERS };
        let whole =
            |k: &usize| y[*k][c].is_finite() && (0..width).all(|j| column(c, *k, j).is_finite());
        let rows: Vec<usize> = (0..n).filter(whole).collect();
        if rows.len() <= width {
            return f64::INFINITY;
        }
        let x = DMatrix::from_fn(rows.len(), width, |r, j| column(c, rows[r], j));
        let y = DVector::from_fn(rows.len(), |r, _| y[rows[r]][c]);
        unexplained(&x, &y)
    };
    Ok((0..CHANNELS).map(of).collect())
}

/// One sample in `every`.
fn thinned(s: &Session, every: usize) -> Session {
    fn of<T: Clone>(all: &[T], every: usize) -> Vec<T> {
        all.iter().step_by(every).cloned().collect()
    }
    Session {
        name: s.name.clone(),
        rate_hz: s.rate_hz / every as f64,
        payload_kg: s.payload_kg,
        t_s: of(&s.t_s, every),
        commanded_pa: of(&s.commanded_pa, every),
        chamber_pa: of(&s.chamber_pa, every),
        sensors: of(&s.sensors, every),
        captured: of(&s.captured, every),
    }
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

/// The nominal arm at the measured pressures of a session; a pressure that is missing is held.
fn replay(robot: &RobotSpec, s: &Session) -> Result<Session, SessionError> {
    let model = Model::nominal(robot);
    let mut state = State::rest(&model);
    let mut out = Session {
        chamber_pa: s.commanded_pa.clone(),
        ..s.clone()
    };
    let mut inputs = Inputs {
        payload_kg: s.payload_kg,
        ..Inputs::default()
    };
    for k in 0..s.t_s.len() {
        for (held, read) in inputs.chamber_pa.iter_mut().zip(s.chamber_pa[k]) {
            if read.is_finite() {
                *held = read;
            }
        }
        settle(&model, &mut state, &inputs).map_err(|reason| SessionError::Model {
            t_s: s.t_s[k],
            reason,
        })?;
        let o = observe(&model, &state);
        out.captured[k] = Some(o.base_from_tip);
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

/// Sizes effects against the noise floor of one rig.
pub struct Sizing<'a> {
    specimen: &'a Specimen<'a>,
    plan: SessionPlan,
    floor: Vec<f64>,
    healthy: Session,
}

impl<'a> Sizing<'a> {
    /// For effects that act in `plan`. Its healthy session gives the noise floor as well.
    ///
    /// # Errors
    /// [`SessionError`] when the healthy rig cannot be run.
    pub fn new(specimen: &'a Specimen<'a>, plan: &SessionPlan) -> Result<Self, SessionError> {
        let plan = SessionPlan {
            hidden: Vec::new(),
            rate_hz: SIZING_HZ,
            ..plan.clone()
        };
        let healthy = specimen.session(&plan)?;
        Ok(Self {
            floor: floor(specimen.robot(), &healthy)?,
            specimen,
            plan,
            healthy,
        })
    }

    /// The noise floor per channel, as in [`change`].
    pub fn floor(&self) -> &[f64] {
        &self.floor
    }

    /// The strength of an effect; infinite where the rig cannot carry out the plan with it.
    pub fn strength(&self, hidden: &Hidden) -> f64 {
        let plan = SessionPlan {
            hidden: vec![hidden.clone()],
            ..self.plan.clone()
        };
        let until_s = if changes_with_time(hidden.id) {
            plan.seconds
        } else {
            SIZING_S
        };
        let Ok(with) = self.specimen.part(&plan, until_s) else {
            return f64::INFINITY;
        };
        let moved = change(&self.healthy, &with);
        channels(hidden.kind().shows)
            .map(|c| moved[c] / self.floor[c])
            .fold(0.0, f64::max)
    }

    /// Scales an effect until it has the strength `wanted`, as far as its bounds allow.
    pub fn size(&self, drawn: &Hidden, wanted: f64) -> Sized {
        // Scales with too little and with too much, and the strengths there.
        let (mut low, mut high): ([f64; 2], Option<[f64; 2]>) = ([0.0; 2], None);
        let mut scale = 1.0;
        let mut best = Sized {
            hidden: drawn.scaled(0.0),
            reached: 0.0,
        };
        let mut trials = 0;
        while trials < MOST_TRIALS {
            let hidden = drawn.scaled(scale);
            // Beyond a bound every scale gives the same effect.
            let known = high.filter(|[s, _]| drawn.scaled(*s) == hidden);
            let reached = known.map_or_else(|| self.strength(&hidden), |[_, r]| r);
            trials += usize::from(known.is_none());
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
                Some([s, r]) if r.is_finite() && low[1] > NEARLY_NOTHING * r => {
                    let slope = (s / low[0]).ln() / (r / low[1]).ln();
                    let guess = low[0] * (slope * (wanted / low[1]).ln()).exp();
                    // Kept off the ends, so that the bracket shrinks.
                    guess.clamp(low[0] + 0.1 * (s - low[0]), s - 0.1 * (s - low[0]))
                }
                Some([s, r]) if r.is_finite() && low[0] == 0.0 => s * (wanted / r).clamp(0.1, 0.9),
                // What sets in abruptly.
                Some([s, _]) => 0.5 * (low[0] + s),
            };
        }
        best
    }
}

/// A seed for one purpose out of another one.
fn sub_seed(seed: u64, purpose: usize) -> u64 {
    sample_rng(seed, purpose).random()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rig::hidden::{Growth, HIDDEN};

    /// Sessions of 45 s: long enough for the noise floor, half the cost.
    fn case_of(
        robot: &RobotSpec,
        seed: u64,
        kind: CaseKind,
        kinds: &[&'static Kind],
        strength: f64,
    ) -> Result<Case, SessionError> {
        let plan = SessionPlan {
            seconds: 45.0,
            ..SessionPlan::default()
        };
        case_like(&plan, robot, seed, kind, kinds, strength)
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
        assert!((answer.reached.expect("sized") / 4.0 - 1.0).abs() < 1.1 * CLOSE_ENOUGH);
        assert_eq!(
            answer.params["mass"].value,
            case.suspect.hidden[0].values[0]
        );
        // Half the strength needs about half the mass.
        let half = case_of(&robot, 4, CaseKind::Single, &[kind], 2.0).expect("drawn");
        let ratio = half.suspect.hidden[0].values[0] / answer.params["mass"].value;
        assert!((0.35..0.65).contains(&ratio), "{ratio}");
    }

    /// The rig has no part in this: two sessions that differ by noise alone, and by a slow change under noise.
    #[test]
    fn the_change_between_two_sessions_is_without_their_noise() {
        let noisy = |seed: u64, slope_m: f64| {
            let mut rng = sample_rng(seed, 0);
            let n = 2000;
            let mut spring_m = move |k: usize| {
                let white = 0.3e-3 * crate::sim::dataset::normal(&mut rng);
                [0.15 + slope_m * k as f64 / n as f64 + white; 12]
            };
            Session {
                name: String::new(),
                rate_hz: 20.0,
                payload_kg: 0.0,
                t_s: (0..n).map(|k| k as f64 / 20.0).collect(),
                commanded_pa: vec![[0.0; CHAMBERS]; n],
                chamber_pa: vec![[0.0; CHAMBERS]; n],
                sensors: (0..n)
                    .map(|k| SensorVec {
                        spring_m: spring_m(k),
                        imu_ypr_rad: [[f64::NAN; 3]; 4],
                    })
                    .collect(),
                captured: vec![None; n],
            }
        };
        let same = change(&noisy(1, 0.0), &noisy(1, 0.0));
        assert!(same.iter().all(|x| *x == 0.0), "{same:?}");
        let noise_alone = change(&noisy(1, 0.0), &noisy(2, 0.0))[12];
        assert!(noise_alone < 0.15e-3, "{noise_alone}");
        // A ramp to h has the root mean square h/√3.
        let moved = change(&noisy(1, 0.0), &noisy(2, 2e-3))[12];
        assert!((moved - 2e-3 / 3f64.sqrt()).abs() < 0.05e-3, "{moved}");
    }

    /// Prints the floors of a rig and how strong usual effects are; asserts nothing.
    #[test]
    #[ignore = "prints a table"]
    fn how_strong_usual_effects_are() {
        let robot = RobotSpec::reference();
        let specimen = Specimen::new(&robot, 1).expect("calibrates");
        let sizing = Sizing::new(&specimen, &SessionPlan::default()).expect("runs");
        println!("{:.6?}", sizing.floor());
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
                    assert!(m.growth == Growth::Shape || *v == m.none);
                }
            }
        }
    }
}
