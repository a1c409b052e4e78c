//! Errors of the IMUs and the base's tilt from slow motion, with the springs as the reference.
//!
//! The springs alone give each pad's orientation in the base. At every pose an IMU should read gravity there, and in
//! motion the pad's rate. The fit finds, for all IMUs together, what makes both agree:
//!
//! | symbol | meaning |
//! |---|---|
//! | f = k · g M R_b u + b | raw specific force: gain k, mounting M (imu from pad), R_b pad from base by the springs, bias b |
//! | u | up in the base, exp(−τ) z with the tilt τ of the base |
//! | ω = k_g · M ω_p + b_g | raw rate: ω_p the pad's mean rate by the springs |
//!
//! Where the springs' ends lie is known to half a millimetre only, which turns a pad by up to a degree, differently at
//! every pose: their displacements are nuisance parameters of the fit.
//!
//! M is the nominal mounting behind a small correction, so a fit is absolute: it replaces what was fitted before. The
//! priors are those of data sheets of such parts as delivered, so that what a motion leaves open stays near nominal.
//! Mounting and tilt differ by 1 − cos of the pad's tilt only, bias and gain along gravity likewise: both need tilts of
//! 20 degrees and more.

mod model;
mod windows;

use std::f64::consts::TAU;

use nalgebra::{UnitQuaternion, Vector3};

use super::calibration::{CORRECTION_MAX_RAD, Calibration, ImuCalibration, ImuZero, MountingFit};
use crate::robot::{PadId, RobotSpec};
use crate::signal::{IMUS, ImuRaw};
use model::{
    ACCEL_BIAS, ACCEL_GAIN, COMMON, GYRO_BIAS, GYRO_GAIN, MOUNTING, OWN, PoseSample, Prior,
    Samples, Solved, TurnSample,
};

pub use windows::{
    FRAMES, REST_S, RestError, RestZero, SpringPad, WINDOW_S, Window, Windows, first_rest, rest,
};

#[cfg(test)]
mod tests;

/// Number of directions that tilts are counted in.
pub const SECTORS: usize = 8;
/// Least tilt towards a direction for it to count, rad.
pub const TILT_RAD: f64 = 4.0 * std::f64::consts::PI / 180.0;
/// Number of directions that have to count.
pub const SECTORS_NEEDED: usize = 7;
/// Least number of samples, one per window.
pub const SAMPLES_NEEDED: usize = 300;
/// Most samples kept: beyond them every other one is dropped, and only every other one is taken from then on.
const SAMPLES_MAX: usize = 3_000;
/// Largest RMS angle between gravity by springs and by IMU after the fit, rad.
pub const RESIDUAL_MAX_RAD: f64 = 1.0 * std::f64::consts::PI / 180.0;
/// A pad that turns faster than this is not in slow motion, rad/s.
const FAST_RAD_S: f64 = 0.5;
/// Windows whose rates are taken together: 4 s.
const BLOCK_WINDOWS: usize = 40;

/// Standard deviations before the fit: data sheet of an MPU-6050, and what hands achieve.
const MOUNTING_SIGMA_RAD: f64 = 2.0 * std::f64::consts::PI / 180.0;
const TILT_SIGMA_RAD: f64 = 2.0 * std::f64::consts::PI / 180.0;
/// Of a tilt that is kept, rad: it hardly moves.
const KEPT_TILT_SIGMA_RAD: f64 = 0.02 * std::f64::consts::PI / 180.0;
const GAIN_SIGMA: f64 = 0.03;
const GYRO_SIGMA_RAD_S: f64 = 20.0 * std::f64::consts::PI / 180.0;
/// Of a gyro that was zeroed at rest, rad/s.
const RESTED_SIGMA_RAD_S: f64 = 0.02 * std::f64::consts::PI / 180.0;
/// 50 mg, along the IMU's z axis 80 mg.
const ACCEL_SIGMA_M_S2: [f64; 3] = [
    0.05 * model::GRAVITY_M_S2,
    0.05 * model::GRAVITY_M_S2,
    0.08 * model::GRAVITY_M_S2,
];
/// A parameter is observed when its standard deviation falls below this share of the one before.
const OBSERVED_SHARE: f64 = 0.3;

/// Index of the pad that carries IMU `i` (0-based): 0 the middle pad, 1 the end pad.
pub fn pad_index(robot: &RobotSpec, i: usize) -> usize {
    match robot.imus[i].pad {
        PadId::Middle => 0,
        PadId::End => 1,
    }
}

/// Direction in the base's plane (x, y) that the pad leans to, times the angle, rad.
pub fn tilt(base_from_pad: &UnitQuaternion<f64>) -> [f64; 2] {
    let up = base_from_pad * Vector3::z();
    let across = up.x.hypot(up.y);
    let angle_rad = across.atan2(up.z);
    if across < 1e-9 {
        return [0.0, 0.0];
    }
    [up.x / across * angle_rad, up.y / across * angle_rad]
}

/// The sector of a tilt.
fn sector(x: f64, y: f64) -> usize {
    let turn = y.atan2(x).rem_euclid(TAU) / TAU;
    ((turn * SECTORS as f64) as usize).min(SECTORS - 1)
}

/// Samples of one IMU in slow motion.
#[derive(Clone, Debug, Default)]
pub struct Capture {
    poses: Vec<PoseSample>,
    turns: Vec<TurnSample>,
    /// Windows of the block in progress: time (s), base from pad, gyro (rad/s).
    block: Vec<(f64, SpringPad, Vector3<f64>)>,
    tilts_rad: Vec<[f64; 2]>,
    sectors: [bool; SECTORS],
    /// One sample in 2 to this power is kept, and so many were offered.
    halved: u32,
    offered: u64,
}

impl Capture {
    /// Adds a window: its time (s), its pad by the springs, and the raw readings in the IMU's own axes.
    pub fn add(&mut self, t_s: f64, pad: &SpringPad, raw: &ImuRaw) {
        let (gyro, accel) = (Vector3::from(raw.gyro_rad_s), Vector3::from(raw.accel_m_s2));
        let is_slow = self.add_turn(t_s, pad, gyro);
        if !is_slow {
            return;
        }
        let lean @ [x, y] = tilt(&pad.rotation);
        if x.hypot(y) >= TILT_RAD {
            self.sectors[sector(x, y)] = true;
        }
        self.offered += 1;
        if !self.offered.is_multiple_of(1 << self.halved) {
            return;
        }
        self.poses.push(PoseSample {
            pad: pad.clone(),
            accel_m_s2: accel,
        });
        self.tilts_rad.push(lean);
        if self.poses.len() >= SAMPLES_MAX {
            self.halved += 1;
            halve(&mut self.poses);
            halve(&mut self.tilts_rad);
            halve(&mut self.turns);
        }
    }

    /// Adds a window to the block of rates; whether the pad is slow.
    fn add_turn(&mut self, t_s: f64, pad: &SpringPad, gyro_rad_s: Vector3<f64>) -> bool {
        let mut is_slow = true;
        if let Some((last_s, last, _)) = self.block.last() {
            let dt_s = t_s - last_s;
            let goes_on = dt_s > 0.0 && dt_s < 1.5 * WINDOW_S;
            is_slow = !goes_on || last.rotation.angle_to(&pad.rotation) < FAST_RAD_S * dt_s;
            if !(goes_on && is_slow) {
                self.block.clear();
            }
        }
        self.block.push((t_s, pad.clone(), gyro_rad_s));
        if self.block.len() > BLOCK_WINDOWS {
            self.turns.extend(mean_rates(&self.block));
            self.block.drain(..BLOCK_WINDOWS);
        }
        is_slow
    }

    /// Number of samples.
    pub fn samples(&self) -> usize {
        self.poses.len()
    }

    /// Directions that the pad was tilted to, by index.
    pub fn sectors(&self) -> [bool; SECTORS] {
        self.sectors
    }

    /// Number of those directions.
    pub fn sides(&self) -> usize {
        self.sectors.iter().filter(|s| **s).count()
    }

    /// Tilts captured: direction in the base's plane (x, y) times the angle, rad.
    pub fn tilts_rad(&self) -> &[[f64; 2]] {
        &self.tilts_rad
    }

    /// Whether there are enough samples to enough sides.
    pub fn is_complete(&self) -> bool {
        self.check(&[]).is_ok()
    }

    /// Checks that the samples suffice; `springs_out` (1-based) gave no lengths.
    fn check(&self, springs_out: &[usize]) -> Result<(), FitError> {
        let (samples, seen) = (self.samples(), self.sides());
        match samples < SAMPLES_NEEDED {
            true if !springs_out.is_empty() => Err(FitError::Springs {
                springs: springs_out.to_vec(),
            }),
            true => Err(FitError::TooFew { samples }),
            false if seen < SECTORS_NEEDED => Err(FitError::Sides { seen }),
            false => Ok(()),
        }
    }
}

/// Drops every other one.
fn halve<T>(list: &mut Vec<T>) {
    let mut k = 0_usize;
    list.retain(|_| {
        k += 1;
        k.is_multiple_of(2)
    });
}

/// Mean rates over a block, by the springs and by the gyro.
fn mean_rates(block: &[(f64, SpringPad, Vector3<f64>)]) -> Option<TurnSample> {
    let (first, last) = (block.first()?, block.last()?);
    let span_s = last.0 - first.0;
    if span_s <= 0.0 {
        return None;
    }
    let (mut turned, mut read) = (Vector3::zeros(), Vector3::zeros());
    for pair in block.windows(2) {
        let ((before_s, before, gyro_before), (after_s, after, gyro_after)) = (&pair[0], &pair[1]);
        // ∫ω dt: small turns add up in the pad's axes.
        turned += (before.rotation.inverse() * after.rotation).scaled_axis();
        read += (gyro_before + gyro_after) * (0.5 * (after_s - before_s));
    }
    Some(TurnSample {
        rate_in_pad_rad_s: turned / span_s,
        by_ends: Box::new((*last.1.by_ends - *first.1.by_ends) / span_s),
        gyro_rad_s: read / span_s,
    })
}

/// Why an IMU was not fitted.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum FitError {
    /// Not enough samples because springs were out.
    #[error("{}: all springs above the pad have to be good", springs_out(springs))]
    Springs {
        /// Springs, 1 … 12.
        springs: Vec<usize>,
    },
    /// Not enough samples.
    #[error(
        "only {samples} samples with good springs, at least {SAMPLES_NEEDED} are needed: move slowly for {:.0} s or more",
        SAMPLES_NEEDED as f64 * WINDOW_S
    )]
    TooFew {
        /// Samples.
        samples: usize,
    },
    /// Not to all sides.
    #[error(
        "the pad was tilted by {:.0} degrees to {seen} of {SECTORS} sides only: move to all sides",
        TILT_RAD.to_degrees()
    )]
    Sides {
        /// Sides seen.
        seen: usize,
    },
    /// Springs and IMU do not agree.
    #[error(
        "springs and IMU disagree by {:.2} degrees RMS after the fit: move more slowly, and check that the IMU is fixed",
        rms_rad.to_degrees()
    )]
    Residual {
        /// Root mean square after the fit, rad.
        rms_rad: f64,
    },
    /// The correction is not small.
    #[error(
        "the IMU sits {:.1} degrees off its nominal mounting, more than 5.7; correct mounting_ypr_deg in the robot file",
        off_rad.to_degrees()
    )]
    TooLarge {
        /// Angle of the correction, rad.
        off_rad: f64,
    },
    /// A zero that no working IMU has.
    #[error("no working IMU reads so: {why}")]
    Sensor {
        /// What is out of its range.
        why: String,
    },
}

fn springs_out(springs: &[usize]) -> String {
    let words: Vec<String> = springs.iter().map(ToString::to_string).collect();
    match springs.len() {
        1 => format!("spring {} gave no length", words.join(", ")),
        _ => format!("springs {} gave no lengths", words.join(", ")),
    }
}

/// A fitted parameter, in the unit that people read.
#[derive(Clone, Debug, PartialEq)]
pub struct Parameter {
    /// What it is, such as `accelerometer bias x`.
    pub name: String,
    /// Unit; empty for a ratio.
    pub unit: &'static str,
    /// Value.
    pub value: f64,
    /// Its standard deviation.
    pub sigma: f64,
    /// Standard deviation before the fit.
    pub prior_sigma: f64,
    /// What to do so that it is observed; empty where nothing can be done.
    closes: &'static str,
}

impl Parameter {
    /// Whether the motion determined it.
    pub fn is_observed(&self) -> bool {
        self.sigma < OBSERVED_SHARE * self.prior_sigma
    }
}

/// The calibration of one IMU.
#[derive(Clone, Debug, PartialEq)]
pub struct ImuFit {
    /// Its entry for the file.
    pub entry: ImuCalibration,
    /// All its parameters.
    pub parameters: Vec<Parameter>,
}

/// What was fitted of one rig.
#[derive(Clone, Debug, PartialEq)]
pub struct Fit {
    /// Per IMU; `None` for one without a capture.
    pub imus: [Option<Result<ImuFit, FitError>>; IMUS],
    /// Tilt of the base: level from base = exp((x, y, 0)); `None` when it was kept.
    pub tilt: Option<[Parameter; COMMON]>,
    /// The same, rad.
    pub base_tilt_rad: [f64; COMMON],
}

impl Fit {
    /// What no motion determined yet and what to do about it, one sentence each.
    pub fn open(&self) -> Vec<String> {
        let mut out: Vec<String> = Vec::new();
        for (i, fit) in self.imus.iter().enumerate() {
            if let Some(Ok(fit)) = fit {
                out.extend(open(&fit.parameters).map(|s| format!("IMU {}: {s}", i + 1)));
            }
        }
        let tilt = self.tilt.iter().flatten().cloned().collect::<Vec<_>>();
        out.extend(open(&tilt).map(|s| format!("Base: {s}")));
        out
    }
}

/// One sentence per remedy: the parameters that are not observed.
pub fn open(parameters: &[Parameter]) -> impl Iterator<Item = String> {
    let mut by_remedy: Vec<(&str, Vec<&str>)> = Vec::new();
    // The arm does not turn about its axis: a gain that it leaves open has no remedy and no effect there.
    let has_remedy = |p: &&Parameter| !p.is_observed() && !p.closes.is_empty();
    for p in parameters.iter().filter(has_remedy) {
        match by_remedy.iter_mut().find(|(closes, _)| *closes == p.closes) {
            Some((_, names)) => names.push(&p.name),
            None => by_remedy.push((p.closes, vec![&p.name])),
        }
    }
    let sentence = |(closes, names): (&str, Vec<&str>)| {
        format!("{} not determined; {closes}", names.join(", "))
    };
    by_remedy
        .into_iter()
        .map(sentence)
        .collect::<Vec<_>>()
        .into_iter()
}

/// What the fit starts from.
#[derive(Clone, Debug, PartialEq)]
pub struct Start {
    /// Gyros that were zeroed at rest: reading there in the IMU's own axes, rad/s; `None` for one that was not.
    pub gyro_bias_rad_s: [Option<Vector3<f64>>; IMUS],
    /// Tilt of the base as it was, kept where not all IMUs are fitted, rad.
    pub base_tilt_rad: [f64; COMMON],
    /// Springs (1-based) that gave no lengths.
    pub springs_out: Vec<usize>,
    /// How well the springs' ends are known, see [`ends_sigma_m`].
    pub ends_sigma_m: f64,
}

/// Standard deviation of the springs' ends along each axis, m: smaller where the calibration holds them.
pub fn ends_sigma_m(calibration: &Calibration) -> f64 {
    let stated = calibration.springs.iter().filter_map(|s| s.ends_sd_m);
    let (n, squares) = stated.fold((0.0, 0.0), |(n, sum), sd| (n + 1.0, sum + sd * sd));
    if n > 0.0 {
        // A length errs by what two ends have along it.
        f64::sqrt(squares / n / 2.0)
    } else if calibration.ends_are_drawn() {
        0.5e-3
    } else {
        0.05e-3
    }
}

/// Fits the IMUs that were captured, the others being `None` in `captures`. The base's tilt is fitted when all of them
/// were; otherwise it is kept, since the others depend on it.
pub fn fit(robot: &RobotSpec, captures: &[Option<&Capture>; IMUS], start: &Start) -> Fit {
    let mut out = Fit {
        imus: captures.map(|c| Some(Err(c?.check(&start.springs_out).err()?))),
        tilt: None,
        base_tilt_rad: start.base_tilt_rad,
    };
    loop {
        let which: Vec<usize> = (0..IMUS)
            .filter(|i| captures[*i].is_some() && !matches!(out.imus[*i], Some(Err(_))))
            .collect();
        if which.is_empty() {
            return out;
        }
        let samples: Vec<Samples<'_>> = which
            .iter()
            .filter_map(|i| Some(samples(robot, *i, captures[*i]?, start)))
            .collect();
        let fits_tilt = captures.iter().all(Option::is_some);
        let tilt = tilt_priors(start, fits_tilt);
        let Some(solved) = model::solve(&samples, &tilt, start.ends_sigma_m) else {
            let failed = || FitError::Sensor {
                why: "the readings have no solution".to_owned(),
            };
            which
                .iter()
                .for_each(|i| out.imus[*i] = Some(Err(failed())));
            return out;
        };
        let mut refused = false;
        for (k, i) in which.iter().enumerate() {
            let found = imu_fit(*i, k, &samples[k], &solved);
            refused |= found.is_err();
            out.imus[*i] = Some(found);
        }
        if !refused {
            take_tilt(&mut out, &solved, &tilt, fits_tilt);
            return out;
        }
        // An IMU that is refused must not bend the tilt of the others.
    }
}

fn tilt_priors(start: &Start, is_fitted: bool) -> [Prior; COMMON] {
    start.base_tilt_rad.map(|kept| match is_fitted {
        true => Prior {
            mean: 0.0,
            sigma: TILT_SIGMA_RAD,
        },
        false => Prior {
            mean: kept,
            sigma: KEPT_TILT_SIGMA_RAD,
        },
    })
}

fn take_tilt(out: &mut Fit, solved: &Solved, priors: &[Prior; COMMON], is_fitted: bool) {
    if !is_fitted {
        return;
    }
    let at = solved.tilt_at;
    out.base_tilt_rad = std::array::from_fn(|a| solved.values[at + a]);
    out.tilt = Some(std::array::from_fn(|a| Parameter {
        name: format!("tilt {}", ["x", "y"][a]),
        unit: "deg",
        value: solved.values[at + a].to_degrees(),
        sigma: solved.sigmas[at + a].to_degrees(),
        prior_sigma: priors[a].sigma.to_degrees(),
        closes: FARTHER,
    }));
}

const FARTHER: &str =
    "tilt the pads by 20 degrees and more to all sides, passing upright in between";

/// The five kinds of parameters: first index, name, unit, factor to the unit, what closes it.
const KINDS: [(usize, &str, &str, f64, &str); 5] = [
    (
        MOUNTING,
        "mounting",
        "deg",
        180.0 / std::f64::consts::PI,
        FARTHER,
    ),
    (ACCEL_GAIN, "accelerometer gain less 1", "", 1.0, FARTHER),
    (ACCEL_BIAS, "accelerometer bias", "m/s2", 1.0, FARTHER),
    (GYRO_GAIN, "gyro gain less 1", "", 1.0, ""),
    (
        GYRO_BIAS,
        "gyro bias",
        "deg/s",
        180.0 / std::f64::consts::PI,
        "let the arm rest for 4 s",
    ),
];

fn samples<'a>(robot: &RobotSpec, i: usize, capture: &'a Capture, start: &Start) -> Samples<'a> {
    let rested = start.gyro_bias_rad_s[i];
    let prior = |a: usize| {
        let (kind, axis) = (a - a % 3, a % 3);
        let (mean, sigma) = match kind {
            MOUNTING => (0.0, MOUNTING_SIGMA_RAD),
            ACCEL_BIAS => (0.0, ACCEL_SIGMA_M_S2[axis]),
            GYRO_BIAS => rested.map_or((0.0, GYRO_SIGMA_RAD_S), |bias| {
                (bias[axis], RESTED_SIGMA_RAD_S)
            }),
            _ => (0.0, GAIN_SIGMA),
        };
        Prior { mean, sigma }
    };
    Samples {
        pad_from_imu: UnitQuaternion::from_rotation_matrix(&robot.imus[i].pad_from_imu),
        poses: &capture.poses,
        turns: &capture.turns,
        priors: std::array::from_fn(prior),
    }
}

/// The calibration of IMU `i` (0-based), which is number `k` of those solved.
fn imu_fit(i: usize, k: usize, samples: &Samples<'_>, solved: &Solved) -> Result<ImuFit, FitError> {
    let three = |at: usize| solved.values.fixed_rows::<3>(OWN * k + at).into_owned();
    let entry = ImuCalibration {
        imu: i + 1,
        date: String::new(),
        fit: MountingFit {
            correction_rad: three(MOUNTING),
            residual_rad: solved.residual_rad[k],
            samples: samples.poses.len(),
        },
        zero: ImuZero {
            gyro_bias_rad_s: three(GYRO_BIAS),
            gyro_gain: three(GYRO_GAIN).add_scalar(1.0),
            accel_bias_m_s2: three(ACCEL_BIAS),
            accel_gain: three(ACCEL_GAIN).add_scalar(1.0),
        },
    };
    let (off_rad, rms_rad) = (entry.fit.correction_rad.norm(), entry.fit.residual_rad);
    if off_rad.is_nan() || off_rad >= CORRECTION_MAX_RAD {
        return Err(FitError::TooLarge { off_rad });
    }
    if rms_rad.is_nan() || rms_rad > RESIDUAL_MAX_RAD {
        return Err(FitError::Residual { rms_rad });
    }
    entry
        .check()
        .map_err(|e| FitError::Sensor { why: e.to_string() })?;
    let parameters = KINDS
        .iter()
        .flat_map(|(at, name, unit, per, closes)| {
            (0..3).map(move |axis| {
                let a = at + axis;
                // A zero taken at rest is observed: it is compared with the data sheet, not with itself.
                let prior_sigma = match *at {
                    GYRO_BIAS => GYRO_SIGMA_RAD_S,
                    _ => samples.priors[a].sigma,
                };
                Parameter {
                    name: format!("{name} {}", ["x", "y", "z"][axis]),
                    unit,
                    value: solved.values[OWN * k + a] * per,
                    sigma: solved.sigmas[OWN * k + a] * per,
                    prior_sigma: prior_sigma * per,
                    closes,
                }
            })
        })
        .collect();
    Ok(ImuFit { entry, parameters })
}
