//! What a search has to know of a rig in order, fitted to its healthy sessions. It can be kept as text: cameras and healthy
//! sessions are needed once.

use std::borrow::Cow;

use nalgebra::{DMatrix, DVector, SMatrix};
use serde::{Deserialize, Serialize};

use super::actuation::{
    KNOBS, LineBaseline, LineRow, PressureGrid, PressureLog, PressureNoise, Regulator,
    commission_supply,
};
use super::commission::{Baseline, Rmse, commission, masked, rmse};
use super::coverage::Coverage;
use super::noise::Noise;
use super::replay::{CalibrationParameter, Row, calibration_parameters};
use super::session::{
    CHANNELS, Grid, Sampled as _, at_period, common_channels, period_s, recorded_with, same_robot,
    slowest_s,
};
use super::{GapError, Progress};
use crate::robot::RobotSpec;
use crate::signal::CHAMBERS;
use crate::sim::patch::Correction;

/// What is known of the rig in order.
#[derive(Clone, Copy, Debug)]
pub enum Healthy<'a> {
    /// Its sessions; without any the factory model is the baseline.
    Sessions(&'a [Grid]),
    /// It was commissioned before.
    Commissioned(&'a Commissioned),
}

/// A rig in order: its arm and its supply.
#[derive(Clone, Debug)]
pub struct Commissioned {
    /// Hash of the robot file.
    pub robot: String,
    /// Names and hashes of its sessions.
    pub sessions: Vec<[String; 2]>,
    /// Time between their samples, s.
    pub period_s: f64,
    /// Channels (order of [`CHANNELS`]) that all of them have.
    pub present: [bool; CHANNELS],
    /// What they lack, one sentence each.
    pub notes: Vec<String>,
    /// The arm.
    pub arm: Baseline,
    /// The supply; `None` where no commands were logged.
    pub supply: Option<LineBaseline>,
    /// How its sessions moved the arm; `None` of a baseline that was kept by an earlier version, which does not hold it.
    pub coverage: Option<Coverage>,
}

impl Commissioned {
    /// Fits arm and supply to healthy sessions, all of the rate of the slowest one.
    ///
    /// # Errors
    /// [`GapError`] when nothing was measured, a session is of another robot, or the model cannot follow it.
    pub fn new(
        robot: &RobotSpec,
        healthy: &[Grid],
        progress: &dyn Progress,
    ) -> Result<Self, GapError> {
        Self::at(robot, healthy, slowest_s(healthy), progress)
    }

    /// The same of sessions thinned to about a sample per `slowest_s`.
    fn at(
        robot: &RobotSpec,
        healthy: &[Grid],
        period_s: f64,
        progress: &dyn Progress,
    ) -> Result<Self, GapError> {
        judgeable(robot, healthy)?;
        let thinned = at_period(healthy, period_s)?;
        let grids: Vec<&Grid> = thinned.iter().map(|g| &**g).collect();
        let present = common_channels(grids.iter().copied());
        if !present.contains(&true) {
            return Err(GapError::NothingCommon);
        }
        let arm = commission(robot, &grids, &present, progress)?;
        let logs = grids.iter().filter_map(|g| PressureLog::of(&g.session));
        let lines: Vec<PressureGrid> = logs.map(PressureGrid::new).collect::<Result<_, _>>()?;
        Ok(Self {
            robot: robot.hash.clone(),
            sessions: grids
                .iter()
                .map(|g| [g.session.name.clone(), g.session.hash.clone()])
                .collect(),
            period_s: slowest_s(grids.iter().copied()),
            present,
            notes: grids.iter().flat_map(|g| g.left_out()).collect(),
            arm,
            supply: match &lines[..] {
                [] => None,
                [first, others @ ..] => Some(commission_supply(robot, first, others)?),
            },
            coverage: Some(Coverage::of(&grids)),
        })
    }

    /// The same rig as seen from `robot`, which may carry patches that the robot file of the baseline did not have: what those
    /// change of the calibration parameters is not counted twice.
    ///
    /// # Errors
    /// [`GapError::OtherRobot`] for a baseline of another robot.
    pub fn seen_from(&self, robot: &RobotSpec) -> Result<Cow<'_, Self>, GapError> {
        recorded_with(robot, "the baseline", &self.robot)?;
        let Some(since) = robot.patches.iter().position(|a| a.onto == self.robot) else {
            return Ok(Cow::Borrowed(self));
        };
        let mut made_with = robot.clone();
        made_with.patches.truncate(since);
        let [then, now] = [&made_with, robot].map(|r| Correction::known(r).values);
        let mut out = self.clone();
        for ((value, then), now) in out.arm.values.iter_mut().zip(then).zip(now) {
            *value += then - now;
        }
        robot.hash.clone_into(&mut out.robot);
        Ok(Cow::Owned(out))
    }

    /// Of these channels those that the rig has shown, too.
    pub fn in_common(&self, present: [bool; CHANNELS]) -> [bool; CHANNELS] {
        std::array::from_fn(|c| present[c] && self.present[c])
    }

    /// The arm as sessions show it that have only some of its channels.
    pub fn arm_in(&self, present: &[bool; CHANNELS]) -> Baseline {
        let rows = match &self.arm.healthy {
            Some(rows) if self.present != *present => masked(rows, present),
            _ => return self.arm.clone(),
        };
        Baseline {
            noise: Noise::from_healthy(&rows, present),
            floor: rmse(&rows, |_| true),
            channel_floor: std::array::from_fn(|c| match present[c] {
                true => self.arm.channel_floor[c],
                false => f64::NAN,
            }),
            healthy: Some(rows),
            ..self.arm.clone()
        }
    }
}

/// The rig in order and the sessions to be judged by it.
type Prepared<'a> = (Option<Cow<'a, Commissioned>>, Vec<Cow<'a, Grid>>);

/// Both, all of about one rate.
///
/// # Errors
/// [`GapError::NoSession`] without any; as [`Commissioned::new`]; [`GapError::SlowerThanBaseline`] for a session of a lower rate than the kept baseline.
pub(super) fn prepared<'a>(
    robot: &RobotSpec,
    healthy: Healthy<'a>,
    suspects: &'a [Grid],
    progress: &dyn Progress,
) -> Result<Prepared<'a>, GapError> {
    if suspects.is_empty() {
        return Err(GapError::NoSession);
    }
    judgeable(robot, suspects)?;
    let (rig, period_s) = match healthy {
        Healthy::Sessions(sessions) => {
            let period_s = slowest_s(sessions.iter().chain(suspects));
            let rig = match sessions {
                [] => None,
                _ => Some(Commissioned::at(robot, sessions, period_s, progress)?),
            };
            (rig.map(Cow::Owned), period_s)
        }
        Healthy::Commissioned(known) => {
            let rig = known.seen_from(robot)?;
            let slow = |g: &&Grid| (period_s(g.times_s()) / known.period_s).round() > 1.0;
            if let Some(grid) = suspects.iter().find(slow) {
                return Err(GapError::SlowerThanBaseline {
                    session: grid.session.name.clone(),
                    hz: 1.0 / period_s(grid.times_s()),
                    baseline_hz: 1.0 / known.period_s,
                });
            }
            (Some(rig), known.period_s)
        }
    };
    Ok((rig, at_period(suspects, period_s)?))
}

/// Refuses sessions of another robot, and those in which nothing was measured.
pub(super) fn judgeable(robot: &RobotSpec, sessions: &[Grid]) -> Result<(), GapError> {
    sessions.iter().try_for_each(|grid| {
        same_robot(robot, &grid.session)?;
        grid.ensure_measured()
    })
}

/// Why a text is no baseline.
#[derive(Debug, thiserror::Error)]
pub enum BaselineError {
    /// It does not read.
    #[error("this is no baseline of a rig: {0}")]
    Unreadable(#[from] toml::de::Error),
    /// Another program made it.
    #[error(
        "this baseline was made by another version of the program, with other calibration parameters: commission the rig again"
    )]
    OtherVersion,
    /// Its parts do not fit each other.
    #[error("this baseline is damaged: {0}. Commission the rig again")]
    Damaged(&'static str),
}

/// Version of the text.
const TEXT_VERSION: u32 = 1;

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Text {
    /// First, so that the text is known by its first line.
    springtwin_baseline: u32,
    robot: String,
    rate_hz: f64,
    sessions: Vec<[String; 2]>,
    present: Vec<bool>,
    notes: Vec<String>,
    arm: ArmText,
    supply: Option<SupplyText>,
    #[serde(default)]
    coverage: Option<Vec<Vec<f64>>>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct ArmText {
    parameters: Vec<String>,
    values: Vec<f64>,
    between: Vec<f64>,
    channel_floor: Vec<f64>,
    covariance: Vec<Vec<f64>>,
    /// What the fit leaves, by bin.
    healthy: Vec<Vec<f32>>,
    floor: Rmse,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct SupplyText {
    session: Option<[String; 2]>,
    floor_pa: Option<f64>,
    chamber_floor_pa: [f64; CHAMBERS],
    sd_pa: [f64; CHAMBERS],
    phi: [f64; CHAMBERS],
    regulators: Vec<[f64; KNOBS]>,
    covariance: Vec<Vec<f64>>,
    healthy: Vec<[f32; CHAMBERS]>,
}

impl Commissioned {
    /// As text.
    pub fn to_toml(&self) -> String {
        let arm = &self.arm;
        let rows = arm.healthy.iter().flatten();
        let text = Text {
            springtwin_baseline: TEXT_VERSION,
            robot: self.robot.clone(),
            rate_hz: 1.0 / self.period_s,
            sessions: self.sessions.clone(),
            present: self.present.to_vec(),
            notes: self.notes.clone(),
            arm: ArmText {
                parameters: ids(),
                values: arm.values.clone(),
                between: arm.between.as_slice().to_vec(),
                channel_floor: arm.channel_floor.to_vec(),
                covariance: arm
                    .covariance
                    .column_iter()
                    .map(|c| c.iter().copied().collect())
                    .collect(),
                healthy: rows
                    .map(|row| row.iter().map(|x| *x as f32).collect())
                    .collect(),
                floor: arm.floor,
            },
            supply: self.supply.as_ref().map(|s| SupplyText {
                session: s.session.clone(),
                floor_pa: s.floor_pa,
                chamber_floor_pa: s.chamber_floor_pa,
                sd_pa: s.noise.sd_pa,
                phi: s.noise.phi,
                regulators: s.regulators.iter().map(|r| r.0).collect(),
                covariance: s
                    .covariance
                    .iter()
                    .map(|c| c.iter().copied().collect())
                    .collect(),
                healthy: s
                    .healthy
                    .iter()
                    .flatten()
                    .map(|row| row.map(|x| x as f32))
                    .collect(),
            }),
            coverage: self.coverage.as_ref().map(Coverage::columns),
        };
        match toml::to_string(&text) {
            Ok(text) => text,
            // Strings, numbers and lists always have a TOML form.
            Err(e) => unreachable!("a baseline cannot be written: {e}"),
        }
    }

    /// From its text.
    ///
    /// # Errors
    /// [`BaselineError`] when it is none, or one of another version.
    pub fn from_toml(text: &str) -> Result<Self, BaselineError> {
        let text: Text = toml::from_str(text)?;
        if text.springtwin_baseline != TEXT_VERSION || text.arm.parameters != ids() {
            return Err(BaselineError::OtherVersion);
        }
        let arm = text.arm;
        let n = arm.parameters.len();
        let present: [bool; CHANNELS] = (text.present.try_into())
            .map_err(|_| BaselineError::Damaged("it has another number of channels"))?;
        let channel_floor: [f64; CHANNELS] = (arm.channel_floor.try_into())
            .map_err(|_| BaselineError::Damaged("it has another number of channels"))?;
        let row = |row: &Vec<f32>| -> Result<Row, BaselineError> {
            let row: Vec<f64> = row.iter().map(|x| f64::from(*x)).collect();
            row.try_into()
                .map_err(|_| BaselineError::Damaged("a row has another number of channels"))
        };
        let rows: Vec<Row> = arm.healthy.iter().map(row).collect::<Result<_, _>>()?;
        let square = arm.covariance.len() == n && arm.covariance.iter().all(|c| c.len() == n);
        let whole = arm.values.len() == n && arm.between.len() == n && square;
        if !whole || rows.is_empty() || text.rate_hz.is_nan() || text.rate_hz <= 0.0 {
            return Err(BaselineError::Damaged("numbers are missing"));
        }
        Ok(Self {
            robot: text.robot,
            sessions: text.sessions,
            period_s: 1.0 / text.rate_hz,
            present,
            notes: text.notes,
            arm: Baseline {
                values: arm.values,
                covariance: DMatrix::from_fn(n, n, |i, j| arm.covariance[j][i]),
                between: DVector::from_vec(arm.between),
                noise: Noise::from_healthy(&rows, &present),
                floor: arm.floor,
                channel_floor,
                healthy: Some(rows),
            },
            supply: text.supply.map(SupplyText::supply).transpose()?,
            coverage: match text.coverage {
                None => None,
                Some(columns) => Some(
                    Coverage::from_columns(&columns)
                        .ok_or(BaselineError::Damaged("its coverage has another size"))?,
                ),
            },
        })
    }
}

impl SupplyText {
    fn supply(self) -> Result<LineBaseline, BaselineError> {
        let damaged = |_| BaselineError::Damaged("the supply has another number of chambers");
        let regulators: Vec<Regulator> = self.regulators.into_iter().map(Regulator).collect();
        let covariance = self.covariance.iter().map(|c| match c.len() {
            n if n == KNOBS * KNOBS => Ok(SMatrix::from_column_slice(c)),
            _ => Err(BaselineError::Damaged("numbers of the supply are missing")),
        });
        let covariance: Vec<SMatrix<f64, KNOBS, KNOBS>> = covariance.collect::<Result<_, _>>()?;
        let rows: Vec<LineRow> = (self.healthy.iter())
            .map(|row| row.map(f64::from))
            .collect();
        Ok(LineBaseline {
            regulators: regulators
                .try_into()
                .map_err(|v: Vec<_>| damaged(v.len()))?,
            covariance: covariance
                .try_into()
                .map_err(|v: Vec<_>| damaged(v.len()))?,
            noise: PressureNoise {
                sd_pa: self.sd_pa,
                phi: self.phi,
            },
            floor_pa: self.floor_pa,
            chamber_floor_pa: self.chamber_floor_pa,
            healthy: Some(rows),
            session: self.session,
        })
    }
}

/// Ids of the calibration parameters.
fn ids() -> Vec<String> {
    calibration_parameters()
        .into_iter()
        .map(CalibrationParameter::id)
        .collect()
}

/// What the text of a baseline begins with.
pub const BASELINE_START: &str = "springtwin_baseline";

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gap::Patch;
    use crate::gap::commission::factory;

    fn rig() -> Commissioned {
        let present = std::array::from_fn(|c| c != 3);
        let value = |k: usize, c: usize| 1e-3 * ((k * 37 + c * 11) as f64 * 0.7).sin();
        let rows: Vec<Row> = (0..300)
            .map(|k| {
                std::array::from_fn(|c| match present[c] {
                    true => value(k, c),
                    false => f64::NAN,
                })
            })
            .collect();
        let factory = factory(&present);
        Commissioned {
            robot: "ab".to_owned(),
            sessions: vec![["monday".to_owned(), "12".to_owned()]],
            period_s: 0.02,
            present,
            notes: vec!["a span was left out".to_owned()],
            arm: Baseline {
                noise: Noise::from_healthy(&rows, &present),
                healthy: Some(rows),
                ..factory
            },
            supply: Some(LineBaseline {
                regulators: [Regulator::default(); CHAMBERS],
                covariance: [SMatrix::from_diagonal_element(0.1); CHAMBERS],
                noise: PressureNoise {
                    sd_pa: [120.0; CHAMBERS],
                    phi: [0.5; CHAMBERS],
                },
                floor_pa: Some(150.0),
                chamber_floor_pa: [150.0; CHAMBERS],
                healthy: Some(vec![[0.5; CHAMBERS]; 40]),
                session: None,
            }),
            coverage: None,
        }
    }

    /// The patch of a commissioned rig has the same departures as its baseline: a robot file that carries it has them already.
    #[test]
    fn a_patch_with_the_parameters_of_the_baseline_is_not_counted_twice() {
        let robot = RobotSpec::reference();
        let nominal = factory(&[true; CHANNELS]).values;
        let mut departed = nominal.clone();
        for (i, v) in departed.iter_mut().take(12).enumerate() {
            *v *= 1.0 + 0.001 * (i + 1) as f64;
        }
        let mut patch = Patch {
            version: crate::gap::VERSION,
            name: "a rig".to_owned(),
            robot: robot.hash.clone(),
            verdict: "named".to_owned(),
            data: Default::default(),
            rig: Default::default(),
            floor: Default::default(),
            law: Vec::new(),
            effects: Vec::new(),
        };
        patch.set_values(&departed);
        let text = crate::robot::with_patch(crate::robot::REFERENCE, &patch);
        let patched = RobotSpec::from_toml(&text).expect("a robot file");
        let mut kept = rig();
        kept.robot.clone_from(&robot.hash);
        kept.arm.values.clone_from(&departed);
        let same = kept.seen_from(&robot).expect("of this robot");
        assert_eq!(same.arm.values, departed);
        let seen = kept.seen_from(&patched).expect("of this robot");
        for (i, (a, b)) in seen.arm.values.iter().zip(&nominal).enumerate() {
            assert!((a - b).abs() < 1e-12, "parameter {i}: {a} for {b}");
        }
        assert_eq!(seen.robot, patched.hash);
        kept.robot = "another".to_owned();
        assert!(matches!(
            kept.seen_from(&patched),
            Err(GapError::OtherRobot { .. })
        ));
    }

    #[test]
    fn a_baseline_is_the_same_after_it_was_kept() {
        let text = rig().to_toml();
        assert!(text.starts_with(BASELINE_START));
        let again = Commissioned::from_toml(&text).expect("reads");
        assert_eq!(again.to_toml(), text);
        assert_eq!(again.present, rig().present);
        assert_eq!(again.arm.values, rig().arm.values);
        assert_eq!(again.arm.covariance, rig().arm.covariance);
        let size = |r: &Commissioned| r.arm.healthy.as_ref().map_or(0, Vec::len);
        assert_eq!(size(&again), 300);
    }

    #[test]
    fn what_is_no_baseline_is_refused_with_a_reason() {
        let text = rig().to_toml();
        let why = |text: &str| {
            Commissioned::from_toml(text)
                .expect_err("refused")
                .to_string()
        };
        assert!(why("version = 1").contains("no baseline"));
        let newer = text.replacen("springtwin_baseline = 1", "springtwin_baseline = 2", 1);
        assert!(why(&newer).contains("another version"));
        let other = text.replacen("hardening", "softening", 1);
        assert!(why(&other).contains("commission the rig again"));
        let short = text.replacen("present = [true, ", "present = [", 1);
        assert!(
            why(&short).contains("another number of channels"),
            "{}",
            why(&short)
        );
    }

    /// Cameras are there on one day: what was commissioned with them judges sessions without them.
    #[test]
    fn channels_that_a_session_lacks_do_not_count() {
        let mut without = rig().present;
        without[..6].fill(false);
        let arm = rig().arm_in(&without);
        assert_eq!(arm.noise.channels, (6..CHANNELS).collect::<Vec<_>>());
        assert!(arm.floor.position_m.is_none() && arm.floor.spring_m.is_some());
        assert!(arm.channel_floor[0].is_nan());
        assert_eq!(arm.values, rig().arm.values);
    }
}
