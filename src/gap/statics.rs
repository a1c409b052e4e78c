//! Arms at rest: what is missing where nothing moves but from one rest to the next.
//!
//! A rest is the mean of a steady window: six pressures and where the middle and the end pad's tracked bodies are. The calibration
//! parameters θ of the rig and the parameters e of an effect are fitted together to the healthy and the suspect rests,
//!
//! min over θ, e of ½ Σ over rests |W (measured − predicted(θ, e))|² + ½ Σ (θ/σ)²,
//!
//! with the effect at work in the suspect rests alone. W holds how well the arm repeats a rest and σ how uncertain the robot file
//! is, so the interval of a mass has all that an unknown stiffness leaves open. An effect is proved on suspect rests that were left
//! out of the fit one after the other, and on rests that had no part in it.

use std::collections::BTreeMap;

use nalgebra::{DMatrix, DVector, UnitQuaternion, Vector3};

use super::candidates::{Candidate, Table, candidates};
use super::config::CONFIG;
use super::describe::{NORMAL_95, side};
use super::find::{Found, origins, patch_of};
use super::finding::{
    ChannelError, Confirmed, Finding, FoundEffect, GapSize, Ranked, Traces, Verdict,
};
use super::law::library;
use super::patch::PatchValue;
use super::prove::TIP;
use super::replay::{
    CalibrationParameter, calibration_parameters, is_mechanical, nominal, pad_from_body,
};
use super::{GapError, Progress, Stage, parallel};
use crate::robot::{RobotSpec, Uncertainty};
use crate::signal::{CHAMBERS, Pose, pose_error};
use crate::sim::effects::{self, Active, Effect, EffectError, Law, Operator, Reach, Scene};
use crate::sim::patch::{Correction, model};

/// Mean of a steady window.
#[derive(Clone, Debug, PartialEq)]
pub struct Rest {
    /// Name of the session.
    pub session: String,
    /// Hash of its file.
    pub hash: String,
    /// Gauge pressures of chambers 1 to 6, Pa.
    pub gauge_pa: [f64; CHAMBERS],
    /// Declared mass in the gripper, kg.
    pub payload_kg: f64,
    /// The tracked bodies of the middle and the end pad, in this order, base from body; `None` for one that was not tracked.
    pub bodies: [Option<Pose>; 2],
    /// Whether they are relative to a body on the base, which was tracked too.
    pub on_base: bool,
}

/// A calibration parameter that rests show.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Unknown {
    /// A calibration parameter and its index among them.
    Rig(usize, CalibrationParameter),
    /// The tracked body on the middle pad: x, y, z (m), rotation vector (rad).
    MiddleBody(usize),
}

/// Step of a derivative, as a share of the parameter's standard deviation.
const STEP: f64 = 0.02;
/// Most steps of a fit.
const STEPS: usize = 25;
/// A fit has converged where it gains less, nats.
const CONVERGED: f64 = 1e-3;
/// Odds at which an effect cannot be excluded beside the best, nats: 20 to 1.
const RIVAL_NATS: f64 = 3.0;
/// Models of rests are inadequate: effects whose gain is within this share of the best's cannot be excluded either.
const RIVAL_SHARE: f64 = 0.1;
/// Chance that any of the candidates seems significant on healthy rests.
const FALSE_ALARM: f64 = 0.05;
/// A gain counts by this factor less: twelve channels of a rest share the arm's inadequacies.
const SHARED: f64 = 3.0;
/// Groups of channels, with their pad, first component and factor to the unit.
const GROUPS: [(&str, usize, usize, &str); 4] = [
    ("r2 middle position", 0, 0, "mm"),
    ("r2 middle rotation", 0, 3, "deg"),
    (TIP, 1, 0, "mm"),
    ("r2 tip rotation", 1, 3, "deg"),
];

/// The unknowns with their standard deviations.
fn unknowns(u: &Uncertainty) -> Vec<(Unknown, f64)> {
    let body = |k: usize| if k < 3 { u.body_m } else { u.body_rad };
    let all = calibration_parameters().into_iter().enumerate();
    let rig = all.filter_map(|(i, p)| {
        let sd = match p {
            CalibrationParameter::Stiffness(_) => u.axial_stiffness,
            CalibrationParameter::Area(_) => u.area,
            CalibrationParameter::RestLength(_) => u.rest_length,
            CalibrationParameter::Hardening => u.hardening,
            CalibrationParameter::Bending(_) => u.bending_stiffness,
            CalibrationParameter::Torsion(_) => u.torsional_stiffness,
            CalibrationParameter::Gripper => u.mass,
            CalibrationParameter::Tilt(_) => p.prior(),
            CalibrationParameter::Body(k) => body(k),
            _ => return None,
        };
        Some((Unknown::Rig(i, p), sd))
    });
    let middle = (0..6).map(|k| (Unknown::MiddleBody(k), body(k)));
    rig.chain(middle).collect()
}

/// The calibration parameters that rests show, by their index, with the standard deviations that the robot file states.
pub fn uncertain_parameters(robot: &RobotSpec) -> Vec<(usize, f64)> {
    let all = unknowns(&robot.uncertainty).into_iter();
    let rig = all.filter_map(|(unknown, sd)| match unknown {
        Unknown::Rig(i, _) => Some((i, sd)),
        Unknown::MiddleBody(_) => None,
    });
    rig.collect()
}

/// A rig with the values of its unknowns.
#[derive(Clone, Debug)]
struct Rig {
    values: Vec<f64>,
    middle: [f64; 6],
}

impl Rig {
    fn nominal() -> Self {
        Self {
            values: nominal(),
            middle: [0.0; 6],
        }
    }

    fn set(&mut self, unknown: Unknown, value: f64) {
        match unknown {
            Unknown::Rig(i, p) => self.values[i] = (p.nominal() + value).max(p.least()),
            Unknown::MiddleBody(k) => self.middle[k] = value,
        }
    }
}

/// An effect with its start and the parameters that are fitted.
type Part = (Candidate, Vec<f64>, Vec<usize>);

/// An effect, or several that belong together, at work in the suspect rests.
#[derive(Clone, Debug)]
struct Hypothesis {
    parts: Vec<Part>,
}

impl Hypothesis {
    fn none() -> Self {
        Self { parts: Vec::new() }
    }

    /// The fitted parameters: part and index.
    fn moved(&self) -> Vec<(usize, usize)> {
        let parts = self.parts.iter().enumerate();
        parts
            .flat_map(|(k, (_, _, moves))| moves.iter().map(move |i| (k, *i)))
            .collect()
    }

    fn active(&self) -> Vec<Active> {
        self.parts.iter().map(|(c, at, _)| c.with(at)).collect()
    }

    fn leads(&self) -> Option<&Candidate> {
        self.parts.first().map(|(c, ..)| c)
    }
}

/// A fit to rests.
#[derive(Clone, Debug)]
struct Fitted {
    rig: Rig,
    /// Departures of the unknowns, in units of their standard deviations.
    theta: DVector<f64>,
    hypothesis: Hypothesis,
    /// Least value of the sum above, nats.
    cost: f64,
    /// Standard deviation of each fitted parameter of the effects.
    sd: Vec<f64>,
}

/// The search.
struct Search<'a> {
    robot: &'a RobotSpec,
    unknowns: Vec<(Unknown, f64)>,
    baseline: &'a [Rest],
}

/// Predicted tracked bodies of the middle and the end pad at a rest.
fn predicted(
    robot: &RobotSpec,
    rig: &Rig,
    rest: &Rest,
    acting: &[Active],
) -> Result<[Pose; 2], EffectError> {
    let Correction { values, effects } = Correction::known(robot).and(&rig.values, acting);
    let model = model(robot, &values);
    let chamber_pa = effects::behind_gauges(robot, &[0.0], &[rest.gauge_pa], &effects);
    let (arm, read): (Vec<Active>, Vec<Active>) = effects.into_iter().partition(is_mechanical);
    let mut at = effects::arm_only(&model, &[0.0], &chamber_pa, &[rest.payload_kg], &arm)?;
    let captured = read
        .into_iter()
        .filter(|a| matches!(a.effect.operator, Operator::Capture(_)));
    effects::read(robot, &[0.0], &mut at, &captured.collect::<Vec<_>>());
    let [middle, end] = at.captured[0];
    let m = rig.middle;
    let on_middle = Pose::from_parts(
        Vector3::new(m[0], m[1], m[2]).into(),
        UnitQuaternion::from_scaled_axis(Vector3::new(m[3], m[4], m[5])),
    );
    Ok([
        middle * robot.bodies[1] * on_middle,
        end * robot.bodies[2] * pad_from_body(&values),
    ])
}

/// Errors of a rest, measured − predicted: six of the middle and six of the end pad; NaN where nothing was measured.
fn errors(predicted: &[Pose; 2], rest: &Rest) -> [f64; 12] {
    let mut out = [f64::NAN; 12];
    for (k, (body, predicted)) in rest.bodies.iter().zip(predicted).enumerate() {
        if let Some(body) = body {
            out[6 * k..6 * k + 6].copy_from_slice(pose_error(body, predicted).as_slice());
        }
    }
    out
}

impl Search<'_> {
    /// Errors in units of how well a rest repeats, and the departures of the unknowns in units of theirs.
    fn residual(
        &self,
        theta: &DVector<f64>,
        hypothesis: &Hypothesis,
        suspects: &[&Rest],
    ) -> Result<DVector<f64>, EffectError> {
        let rig = self.rig(theta);
        let sds = repeats(&self.robot.uncertainty);
        let mut out = Vec::new();
        let active = hypothesis.active();
        let healthy = self.baseline.iter().map(|r| (r, &[][..]));
        let suspect = suspects.iter().map(|r| (*r, &active[..]));
        for (rest, acting) in healthy.chain(suspect) {
            let e = errors(&predicted(self.robot, &rig, rest, acting)?, rest);
            for (i, e) in e.iter().enumerate().filter(|(_, e)| e.is_finite()) {
                out.push(e / sds[i]);
            }
        }
        out.extend_from_slice(theta.as_slice());
        Ok(DVector::from_vec(out))
    }

    fn rig(&self, theta: &DVector<f64>) -> Rig {
        let mut rig = Rig::nominal();
        for ((unknown, sd), x) in self.unknowns.iter().zip(theta.iter()) {
            rig.set(*unknown, sd * x);
        }
        rig
    }

    /// The best fit of a rig with `hypothesis` in the `suspects`, from the values `theta` and those of the hypothesis on; `None` where
    /// the arm cannot stand like that.
    fn fit(
        &self,
        theta: &DVector<f64>,
        hypothesis: &Hypothesis,
        suspects: &[&Rest],
    ) -> Option<Fitted> {
        let moved = hypothesis.moved();
        let (n, k) = (self.unknowns.len(), moved.len());
        let scales: Vec<f64> = moved
            .iter()
            .map(|(part, i)| hypothesis.parts[*part].0.scale()[*i].abs().max(1e-9))
            .collect();
        let (mut theta, mut hypothesis) = (theta.clone(), hypothesis.clone());
        let of = |theta: &DVector<f64>, h: &Hypothesis| self.residual(theta, h, suspects).ok();
        let mut r = of(&theta, &hypothesis)?;
        let mut damping = 1e-3;
        let mut normal = DMatrix::zeros(n + k, n + k);
        for _ in 0..STEPS {
            let mut columns = Vec::with_capacity(n + k);
            for i in 0..n {
                let mut moved = theta.clone();
                moved[i] += STEP;
                columns.push((of(&moved, &hypothesis)? - &r) / STEP);
            }
            for (j, (part, i)) in moved.iter().enumerate() {
                let mut h = hypothesis.clone();
                let p = &h.parts[*part].0.effect.parameters[*i];
                let mut step = STEP * scales[j];
                if h.parts[*part].1[*i] + step > p.bounds[1] {
                    step = -step;
                }
                h.parts[*part].1[*i] += step;
                columns.push((of(&theta, &h)? - &r) * (scales[j] / step));
            }
            let jacobian = DMatrix::from_columns(&columns);
            normal = jacobian.transpose() * &jacobian;
            let slope = jacobian.transpose() * &r;
            let mut better = None;
            while damping < 1e6 {
                let mut damped = normal.clone();
                for i in 0..n + k {
                    damped[(i, i)] += damping * (damped[(i, i)] + 1e-9);
                }
                let step = -damped.cholesky()?.solve(&slope);
                let to = &theta + step.rows(0, n);
                let mut h = hypothesis.clone();
                for (j, (part, i)) in moved.iter().enumerate() {
                    let [low, high] = h.parts[*part].0.effect.parameters[*i].bounds;
                    let at = &mut h.parts[*part].1[*i];
                    *at = (*at + scales[j] * step[n + j]).clamp(low, high);
                }
                if let Some(then) =
                    of(&to, &h).filter(|then| then.norm_squared() < r.norm_squared())
                {
                    better = Some((to, h, then));
                    break;
                }
                damping *= 10.0;
            }
            let Some((to, h, then)) = better else { break };
            let gain = 0.5 * (r.norm_squared() - then.norm_squared());
            (theta, hypothesis, r) = (to, h, then);
            damping = (0.1 * damping).max(1e-9);
            if gain < CONVERGED {
                break;
            }
        }
        for i in 0..n + k {
            normal[(i, i)] += 1e-9;
        }
        let covariance = normal.try_inverse()?;
        let sd = (0..k).map(|j| scales[j] * covariance[(n + j, n + j)].sqrt());
        Some(Fitted {
            rig: self.rig(&theta),
            sd: sd.collect(),
            cost: 0.5 * r.norm_squared(),
            theta,
            hypothesis,
        })
    }

    /// Errors of every suspect rest by a fit to the others.
    fn without_each(&self, fitted: &Fitted, suspects: &[Rest]) -> Result<Vec<[f64; 12]>, GapError> {
        let each = (0..suspects.len()).map(|k| {
            let others = suspects.iter().enumerate().filter(|(j, _)| *j != k);
            let others: Vec<&Rest> = others.map(|(_, r)| r).collect();
            let part = self
                .fit(&fitted.theta, &fitted.hypothesis, &others)
                .ok_or(GapError::Degenerate)?;
            self.errors(&part, &suspects[k], true)
        });
        each.collect()
    }

    /// Errors of a rest that a fit predicts.
    fn errors(&self, fitted: &Fitted, rest: &Rest, acts: bool) -> Result<[f64; 12], GapError> {
        let active = if acts {
            fitted.hypothesis.active()
        } else {
            Vec::new()
        };
        Ok(errors(
            &predicted(self.robot, &fitted.rig, rest, &active)?,
            rest,
        ))
    }
}

/// What is tried: every effect that may show at rest, and that a tracked body has slipped. Poses relative to a tracked base do not depend
/// on the frame of the cameras.
fn hypotheses(table: Table<'_>, scene: &Scene, on_base: bool) -> Vec<Hypothesis> {
    let bodies = library()
        .into_iter()
        .filter(|e| matches!(e.operator, Operator::Capture(_)) && e.reach == Reach::Single);
    let table: Vec<&'static Effect> = table.iter().copied().chain(bodies).collect();
    let shows = |e: &Effect| {
        let acts = match e.operator {
            Operator::Mechanics(_) => true,
            Operator::Capture(_) => !on_base || e.reach == Reach::Single,
            Operator::Pressure(_) => e.behind_gauge.is_some(),
            Operator::Sensors(_) => false,
        };
        e.memory.is_none() && acts
    };
    let all = candidates(&table, shows).into_iter();
    let starts = all.flat_map(|c| c.starts(scene).into_iter().map(move |s| (c, s)));
    starts
        .map(|(c, s)| Hypothesis {
            parts: vec![(c, s.at, s.moves.to_vec())],
        })
        .collect()
}

/// What shows nothing by itself, such as the centre of a mass that is not there, on top of each effect of the whole arm that does,
/// across the axis alone: along it a weight hardly shows where it hangs.
fn pairs(tried: &[Hypothesis], shows: &[bool]) -> Vec<Hypothesis> {
    let whole = |show: bool| {
        let all = tried.iter().zip(shows).filter(move |(_, s)| **s == show);
        all.filter_map(|(h, _)| {
            let part = &h.parts[0];
            let e = part.0.effect;
            let whole = part.0.target.is_none() && e.law == Law::Definition;
            (whole && matches!(e.operator, Operator::Mechanics(_))).then_some(part)
        })
    };
    let silent: Vec<Part> = whole(false)
        .map(|(c, at, moves)| {
            let across: Vec<usize> = moves.iter().copied().take(2).collect();
            let kept = |i: usize| match across.contains(&i) {
                true => at[i],
                false => c.effect.parameters[i].nominal,
            };
            (*c, (0..at.len()).map(kept).collect(), across)
        })
        .collect();
    let mut out = Vec::new();
    for first in whole(true) {
        for second in silent.iter().cloned().flat_map(mirrored) {
            out.push(Hypothesis {
                parts: vec![first.clone(), second],
            });
        }
    }
    out
}

/// A part with its start as it is, and to other sides.
fn mirrored((c, start, moves): Part) -> impl Iterator<Item = Part> {
    // Signs of the first, second and third number.
    const SIGNS: [[f64; 3]; 4] = [
        [1.0, 1.0, 1.0],
        [-1.0, -1.0, -1.0],
        [1.0, -1.0, 1.0],
        [-1.0, 1.0, -1.0],
    ];
    SIGNS.into_iter().map(move |signs| {
        let mut at = start.clone();
        for (k, i) in moves.iter().enumerate() {
            let nominal = c.effect.parameters[*i].nominal;
            at[*i] = nominal + signs[k % signs.len()] * (at[*i] - nominal);
        }
        (c, at, moves.clone())
    })
}

/// Significance threshold of a gain by so many parameters among so many candidates, nats: the quantile of ½χ², within 4 %.
fn threshold(parameters: usize, candidates: usize) -> f64 {
    // Wilson and Hilferty (1931), doi 10.1073/pnas.17.12.684; the normal quantile by its asymptotic form.
    let p = FALSE_ALARM / candidates.max(1) as f64;
    let t = (-2.0 * p.ln()).sqrt();
    let z = t
        - (2.515_517 + t * (0.802_853 + 0.010_328 * t))
            / (1.0 + t * (1.432_788 + t * (0.189_269 + 0.001_308 * t)));
    let k = parameters as f64;
    let c = 2.0 / (9.0 * k);
    0.5 * k * (1.0 - c + z * c.sqrt()).powi(3)
}

/// Root mean squares of a group's errors over rests, in its unit.
fn size(all: &[[f64; 12]], (_, pad, first, unit): (&str, usize, usize, &str)) -> f64 {
    let factor = if unit == "mm" {
        1e3
    } else {
        180.0 / std::f64::consts::PI
    };
    let squares = all.iter().filter_map(|e| {
        let sum: f64 = e[6 * pad + first..6 * pad + first + 3]
            .iter()
            .map(|x| x * x)
            .sum();
        sum.is_finite().then_some(sum)
    });
    let (sum, n) = squares.fold((0.0, 0), |(sum, n), x| (sum + x, n + 1));
    factor * (sum / f64::from(n)).sqrt()
}

/// Errors of every group. The floor is what healthy rests predict of each other, and no less than how well a rest repeats.
fn channels(
    before: &[[f64; 12]],
    after: &[[f64; 12]],
    floor: &[[f64; 12]],
    repeats: &[f64; 12],
) -> Vec<ChannelError> {
    let of = |g: &(&'static str, usize, usize, &'static str)| {
        let [b, a, f] = [before, after, floor].map(|all| size(all, *g));
        let f = f.max(size(&[*repeats], *g));
        b.is_finite().then(|| ChannelError {
            name: g.0.to_owned(),
            unit: g.3.to_owned(),
            before: b,
            after: a,
            after_ci95: [a, a],
            shuffled: None,
            floor: Some(f),
        })
    };
    GROUPS.iter().filter_map(of).collect()
}

fn gap(channels: &[ChannelError]) -> GapSize {
    let tip = channels.iter().find(|c| c.name == TIP);
    tip.or(channels.first())
        .map_or_else(GapSize::default, GapSize::from)
}

impl<'a> Search<'a> {
    fn new(robot: &'a RobotSpec, baseline: &'a [Rest]) -> Result<Self, GapError> {
        if baseline.iter().all(|r| r.bodies == [None; 2]) {
            return Err(GapError::NoSession);
        }
        Ok(Self {
            robot,
            unknowns: unknowns(&robot.uncertainty),
            baseline,
        })
    }

    /// The rig by its healthy rests, with the `suspects` as healthy as they.
    fn commission(&self, suspects: &[&Rest]) -> Result<Fitted, GapError> {
        let zero = DVector::zeros(self.unknowns.len());
        self.fit(&zero, &Hypothesis::none(), suspects)
            .ok_or(GapError::Degenerate)
    }

    /// Errors of every rest that the others predict.
    fn left_out(&self) -> Result<Vec<[f64; 12]>, GapError> {
        let all: Vec<usize> = (0..self.baseline.len()).collect();
        let each = parallel(&all, |&k| {
            let mut others = self.baseline.to_vec();
            let rest = others.remove(k);
            let search = Search {
                robot: self.robot,
                unknowns: self.unknowns.clone(),
                baseline: &others,
            };
            let fitted = search.commission(&[])?;
            search.errors(&fitted, &rest, false)
        });
        each.into_iter().collect()
    }
}

/// Finds what is missing in the model of a rig that was measured at rest.
///
/// # Errors
/// [`GapError`] when there is no rest on one of both sides, or the arm cannot stand like that.
pub fn find_at_rest(
    robot: &RobotSpec,
    table: Table<'_>,
    baseline: &[Rest],
    (suspects, prove): (&[Rest], &[Rest]),
    progress: &dyn Progress,
) -> Result<Found, GapError> {
    if suspects.iter().all(|r| r.bodies == [None; 2]) {
        return Err(GapError::NoSession);
    }
    progress.at(Stage::Commission, 0.0)?;
    let search = Search::new(robot, baseline)?;
    let healthy = search.commission(&[])?;
    let repeats = repeats(&robot.uncertainty);
    let floor = match baseline.len() {
        0 | 1 => Vec::new(),
        _ => search.left_out()?,
    };
    let all: Vec<&Rest> = suspects.iter().collect();
    let unchanged = search.commission(&all)?;
    progress.at(Stage::Explain, 0.0)?;
    let tip_m = suspects.iter().filter_map(|r| r.bodies[1]);
    let scene = Scene {
        tip_m: tip_m.map(|p| p.translation.vector.into()).collect(),
        ..Scene::default()
    };
    let on_base = suspects.iter().chain(baseline).all(|r| r.on_base);
    let mut tried = hypotheses(table, &scene, on_base);
    let fitted = |tried: &[Hypothesis]| parallel(tried, |h| search.fit(&unchanged.theta, h, &all));
    let mut fits = fitted(&tried);
    let shows = |f: &Option<Fitted>| {
        f.as_ref()
            .is_some_and(|f| unchanged.cost - f.cost > CONVERGED)
    };
    let pairs = pairs(&tried, &fits.iter().map(shows).collect::<Vec<_>>());
    fits.extend(fitted(&pairs));
    tried.extend(pairs);
    let mut fits: Vec<Fitted> = fits.into_iter().flatten().collect();
    let gain = |f: &Fitted| (unchanged.cost - f.cost) / SHARED;
    let own = |f: &Fitted| threshold(f.hypothesis.moved().len(), tried.len());
    // Every number that is fitted has its price.
    let score = |f: &Fitted| gain(f) - own(f);
    fits.sort_by(|a, b| score(b).total_cmp(&score(a)));
    // Of hypotheses that begin with the same effect the best.
    let mut leads: Vec<Option<Candidate>> = Vec::new();
    fits.retain(|f| {
        let lead = f.hypothesis.leads().copied();
        let new = !leads.contains(&lead);
        leads.push(lead);
        new
    });
    progress.at(Stage::Prove, 0.0)?;
    let before: Vec<[f64; 12]> = suspects
        .iter()
        .map(|r| search.errors(&healthy, r, false))
        .collect::<Result<_, _>>()?;
    let best = fits.first().filter(|f| score(f) > 0.0);
    let mut notes = vec![format!(
        "At rest: {} healthy and {} suspect windows; fitted together with {} calibration parameters within the uncertainty that the \
         robot file states.",
        baseline.len(),
        suspects.len(),
        search.unknowns.len()
    )];
    if on_base {
        notes.push(
            "Poses are relative to the body on the base: a moved camera frame does not show in them."
                .to_owned(),
        );
    }
    let held_out = match best {
        Some(best) if suspects.len() > 1 => search.without_each(best, suspects)?,
        Some(best) => {
            notes.push(
                "There is one suspect window: the error with the effect is not held out."
                    .to_owned(),
            );
            vec![search.errors(best, &suspects[0], true)?]
        }
        None => before.clone(),
    };
    let all_channels = channels(&before, &held_out, &floor, &repeats);
    let gap_size = gap(&all_channels);
    let shows = all_channels.iter().any(|c| {
        let floor = c.floor.unwrap_or(f64::INFINITY);
        c.name.ends_with("position") && c.before > CONFIG.at_floor * floor
    });
    let explains = gap_size.closed >= CONFIG.closed_min
        || super::finding::closed_excess(&all_channels) >= CONFIG.closed_min;
    let rivals: Vec<&Fitted> = match best {
        Some(best) => fits[1..]
            .iter()
            .filter(|f| {
                let behind = score(best) - score(f);
                behind < RIVAL_NATS.max(RIVAL_SHARE * gain(best)) && !contains(best, f)
            })
            .collect(),
        None => Vec::new(),
    };
    let verdict = match best {
        _ if !shows => Verdict::NothingMissing,
        None => Verdict::Unknown,
        Some(_) if !explains => Verdict::Unknown,
        Some(_) if rivals.is_empty() => Verdict::Named,
        Some(_) => Verdict::Indistinguishable,
    };
    if verdict == Verdict::Unknown {
        notes.push(
            "Rests exceed what the healthy ones predict, and no effect of the table explains them."
                .to_owned(),
        );
    }
    let named = best.filter(|_| verdict.has_effects());
    let mut found = Vec::new();
    if let Some(best) = named {
        found.extend(described(best, None));
        for r in &rivals {
            found.extend(described(r, Some(0)).into_iter().take(1));
        }
    }
    let proof = match named {
        Some(best) if !prove.is_empty() => Some(confirmed(&search, &healthy, best, prove, &floor)?),
        _ => None,
    };
    let gap = match named {
        Some(_) => gap_size,
        None => gap_size.left_open(),
    };
    let finding = Finding {
        verdict,
        effects: found.clone(),
        candidates: fits.iter().filter_map(|f| ranked(f, gain(f))).collect(),
        threshold: best.or(fits.first()).map_or(0.0, own),
        located: Vec::new(),
        gap,
        worse: Vec::new(),
        channels: all_channels,
        embargo_s: 0.0,
        onset: None,
        folds: Vec::new(),
        failed_folds: Vec::new(),
        proof,
        separate_by: None,
        notes,
        data: origins(named_and_hashed(baseline), named_and_hashed(suspects)),
        seconds: 0.0,
        traces: Traces::default(),
    };
    found.retain(|e| e.instead_of.is_none());
    let values = &named.unwrap_or(&healthy).rig.values;
    let mut patch = patch_of(robot, &finding, found, values);
    patch.floor = floors(&finding.channels);
    Ok(Found {
        gain: named.map_or(0.0, gain),
        finding,
        patch,
    })
}

/// What healthy rests predict of each other at the end pad.
fn floors(channels: &[ChannelError]) -> BTreeMap<String, f64> {
    let of = |(key, name, unit): (&str, &str, f64)| {
        let c = channels.iter().find(|c| c.name == name)?;
        Some((key.to_owned(), c.floor? * unit))
    };
    [
        ("position_m", TIP, 1e-3),
        ("rotation_rad", "r2 tip rotation", 1_f64.to_radians()),
    ]
    .into_iter()
    .filter_map(of)
    .collect()
}

/// How well a rest repeats, as errors: the file has distances and angles, these are their components.
fn repeats(u: &Uncertainty) -> [f64; 12] {
    let each = [u.repeat_m, u.repeat_rad].map(|x| x / 3_f64.sqrt());
    std::array::from_fn(|i| each[usize::from(i % 6 >= 3)])
}

/// Whether the effects of one are among those of the other.
fn contains(best: &Fitted, other: &Fitted) -> bool {
    let within = |a: &Fitted, b: &Fitted| {
        let mut all = a.hypothesis.parts.iter();
        all.all(|(c, ..)| b.hypothesis.parts.iter().any(|(d, ..)| c == d))
    };
    within(other, best) || within(best, other)
}

fn described(fitted: &Fitted, instead_of: Option<usize>) -> Vec<FoundEffect> {
    let moved = fitted.hypothesis.moved();
    let of = |(k, (c, at, _)): (usize, &Part)| {
        let parameters = c.effect.parameters.iter().zip(at).enumerate();
        let params = parameters.map(|(i, (p, v))| {
            let j = moved.iter().position(|m| *m == (k, i));
            let [low, high] = p.bounds;
            let reach = |sd: f64| {
                [
                    (v - NORMAL_95 * sd).max(low),
                    (v + NORMAL_95 * sd).min(high),
                ]
            };
            let value = PatchValue {
                value: *v,
                unit: p.unit.to_owned(),
                ci95: j.map(|j| reach(fitted.sd[j])),
            };
            (p.name.to_owned(), value)
        });
        FoundEffect {
            id: c.effect.id.to_owned(),
            side: side(c.effect.side).to_owned(),
            target: c.target.map(|t| t + 1),
            params: params.collect(),
            instead_of,
            chosen_by: None,
        }
    };
    let parts = fitted.hypothesis.parts.iter().enumerate();
    parts.map(of).collect()
}

fn ranked(f: &Fitted, gain: f64) -> Option<Ranked> {
    let c = f.hypothesis.leads()?;
    Some(Ranked {
        id: c.effect.id.to_owned(),
        target: c.target.map(|t| t + 1),
        gain,
        se: 0.0,
    })
}

fn confirmed(
    search: &Search<'_>,
    healthy: &Fitted,
    best: &Fitted,
    prove: &[Rest],
    floor: &[[f64; 12]],
) -> Result<Confirmed, GapError> {
    let errors = |fitted: &Fitted, acts: bool| -> Result<Vec<[f64; 12]>, GapError> {
        prove
            .iter()
            .map(|r| search.errors(fitted, r, acts))
            .collect()
    };
    let channels = channels(
        &errors(healthy, false)?,
        &errors(best, true)?,
        floor,
        &repeats(&search.robot.uncertainty),
    );
    let sessions = prove.iter().map(|r| r.session.clone()).collect();
    Ok(Confirmed::of(sessions, gap(&channels), channels, TIP))
}

fn named_and_hashed(rests: &[Rest]) -> Vec<[String; 2]> {
    rests
        .iter()
        .map(|r| [r.session.clone(), r.hash.clone()])
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gap::Unwatched;
    use crate::sim::effects;

    /// Rests of an arm off its drawing, with a load.
    fn rests(first: usize, count: usize, load_kg: f64, robot: &RobotSpec) -> Vec<Rest> {
        let mut rig = Rig::nominal();
        let search = Search {
            robot,
            unknowns: unknowns(&robot.uncertainty),
            baseline: &[],
        };
        for (k, (unknown, sd)) in search.unknowns.iter().enumerate() {
            rig.set(*unknown, sd * (1.7 * k as f64).sin());
        }
        let load = Active::new("payload", None, &[load_kg]).expect("in the table");
        let rest = |k: usize| {
            let gauge_pa = std::array::from_fn(|i| 12e3 * (0.9 * k as f64 + 2.1 * i as f64).sin());
            let mut rest = Rest {
                session: format!("s{k}"),
                hash: String::new(),
                gauge_pa,
                payload_kg: 0.0,
                bodies: [None; 2],
                on_base: true,
            };
            let at = predicted(robot, &rig, &rest, std::slice::from_ref(&load)).expect("stands");
            // It comes back to within half a millimetre.
            let off = |p: Pose, j: usize| {
                let by = 5e-4 * (3.3 * k as f64 + j as f64).sin();
                Pose::translation(by, -by, 0.5 * by) * p
            };
            rest.bodies = [Some(off(at[0], 0)), Some(off(at[1], 1))];
            rest
        };
        (first..first + count).map(rest).collect()
    }

    fn find(load_kg: f64) -> Finding {
        let robot = RobotSpec::reference();
        let healthy = rests(0, 4, 0.0, &robot);
        let (suspects, prove) = (rests(10, 2, load_kg, &robot), rests(20, 2, load_kg, &robot));
        let table = effects::table();
        let found = find_at_rest(&robot, &table, &healthy, (&suspects, &prove), &Unwatched);
        found.expect("a finding").finding
    }

    #[test]
    fn a_load_is_found_among_rests_and_proved_on_others() {
        let f = find(1.5);
        let first = f.effects.first().unwrap_or_else(|| panic!("{f:?}"));
        assert_eq!(first.id, "payload", "{f:?}");
        let mass = &first.params["mass"];
        let [low, high] = mass.ci95.expect("fitted");
        assert!(0.8 < low && low < 1.5 && 1.5 < high, "{mass:?}");
        assert!(f.gap.closed > 0.9, "{:?}", f.gap);
        let proof = f.proof.expect("other rests");
        assert!(proof.closed > 0.9, "{proof:?}");
    }

    /// A body that slipped on its pad is a matter of that body, not of the arm, and the other one does not follow.
    #[test]
    fn a_slipped_body_is_named_with_its_pad() {
        let robot = RobotSpec::reference();
        let healthy = rests(0, 4, 0.0, &robot);
        let slipped = |k: usize| {
            let mut all = rests(10 * k, 2, 0.0, &robot);
            let turn = UnitQuaternion::from_scaled_axis(Vector3::new(0.0, 0.07, 0.0));
            let by = Pose::from_parts(Vector3::new(9e-3, 0.0, -4e-3).into(), turn);
            for rest in &mut all {
                rest.bodies[1] = rest.bodies[1].map(|p| p * by);
            }
            all
        };
        let (suspects, prove) = (slipped(1), slipped(2));
        let table = effects::table();
        let found = find_at_rest(&robot, &table, &healthy, (&suspects, &prove), &Unwatched);
        let f = found.expect("a finding").finding;
        let [e] = &f.effects[..] else { panic!("{f:?}") };
        assert_eq!(
            (e.side.as_str(), e.target),
            ("frame-and-time", Some(2)),
            "{f:?}"
        );
        let x = e.params["x"].value;
        assert!((x - 9e-3).abs() < 2e-3, "{x}");
        assert!(f.proof.is_some_and(|p| p.closed > 0.9));
    }

    #[test]
    fn healthy_rests_lack_nothing() {
        let f = find(0.0);
        assert_eq!(f.verdict, Verdict::NothingMissing, "{f:?}");
        assert!(f.effects.is_empty() && f.proof.is_none());
    }

    #[test]
    fn a_threshold_is_the_quantile_of_chi_squared() {
        // Half of χ² at 0.05 and 0.001 with 1 and 3 degrees of freedom.
        for (k, candidates, half) in [(1, 1, 1.921), (3, 1, 3.907), (1, 50, 5.414), (3, 50, 8.133)]
        {
            let found = threshold(k, candidates);
            assert!((found / half - 1.0).abs() < 0.04, "{found} for {half}");
        }
    }
}
