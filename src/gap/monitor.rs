//! The live monitor: whether springs and IMUs still read what the commissioned twin predicts from the pressures.
//!
//! It is causal and runs beside the arm. The commissioned model follows the measured pressures in bins of a tenth of a second. Once in a
//! second the mean error e of the 24 channels is compared with its covariance in a rig in order, S = R + N P Nᵀ: R of what the
//! baseline's session leaves, P of the calibration parameters, N their sensitivities in the present posture. eᵀ S⁻¹ e over the number
//! of channels is about 1 in a rig in order, wherever the arm is; the monitor shows its mean over the last seconds as a ratio to a
//! limit. What is missing is then a matter for [`super::find`], with the last minutes.
//!
//! Headings are not corrected by anything, so a filter with a heading and its drift follows each of them; only what the filter does
//! not expect counts, and a drift beyond what restarting a gyro explains.

use std::collections::VecDeque;

use nalgebra::{DMatrix, DVector, Matrix2, Vector2};

use super::GapError;
use super::baseline::Commissioned;
use super::commission::row_difference as difference;
use super::config::CONFIG;
use super::follow::{Follower, Moment};
use super::likely::Likely;
use super::problem::{USUAL_PA, USUAL_PA_S};
use super::replay::{CalibrationParameter, Row, calibration_parameters, residuals};
use super::session::{
    CHANNELS, GRID_HZ, Grid, IMU_0, Measured, SPRING_0, Session, channel_name, mean,
};
use crate::robot::RobotSpec;
use crate::signal::{CHAMBERS, Disagreement, IMUS, Pose, SensorVec};
use crate::sim::effects::{self, Simulated};

/// How much of the past is kept to take pressures and readings from, s.
const KEPT_S: f64 = 10.0;
/// The newest samples wait for those after them: pressures are smoothed over so long, s.
const WAITS_S: f64 = 0.5;
/// How often it judges, s.
const EVERY_S: f64 = 1.0;
/// Bins before those of the last second that are kept: readings lag.
const TAIL: usize = 5;
/// What friction and rubber remember from before it began is not known, s.
const SETTLES_S: f64 = 10.0;

/// Standard deviation of a muted effect, over its usual size.
const MUTED: f64 = 5.0;

/// Channels that it judges.
const JUDGED: usize = CHANNELS - SPRING_0;

/// A bin as it was measured and predicted.
struct Bin {
    t_s: f64,
    measured: SensorVec,
    predicted: SensorVec,
    pads: [Pose; 3],
}

/// What a second has shown.
struct Second {
    /// Mean errors.
    errors: Row,
    /// What a unit of each parameter of `changed` and `read` changes in them.
    columns: Vec<Row>,
    /// What a usual size of each effect changes in them.
    effects: Vec<Vec<Row>>,
    /// How far the pressures have moved, over what is usual.
    moved: f64,
    /// Variance of the model inadequacy, in squares of the floor.
    inadequacy: f64,
}

/// The monitor.
pub struct Monitor {
    robot: RobotSpec,
    arm: Follower,
    /// The same arm in steps of a second, and one for every parameter that changes its motion, with the parameter and its change.
    coarse: Follower,
    changed: Vec<(usize, f64, Follower)>,
    /// Parameters that change readings alone, with a change of each.
    read: Vec<(usize, f64)>,
    /// Covariance of the parameters of `changed` and `read`, in this order.
    spread: DMatrix<f64>,
    /// Covariance of the errors of a second, and the size of each.
    noise: DMatrix<f64>,
    floor: DVector<f64>,
    samples: VecDeque<Measured>,
    /// Spans without pressures among them, s.
    holes_s: Vec<[f64; 2]>,
    began_s: Option<f64>,
    /// When another load was declared last, s.
    rests_from_s: Option<f64>,
    judged_s: Option<f64>,
    before: Option<(f64, [f64; CHAMBERS])>,
    bins: VecDeque<Bin>,
    headings: [Heading; IMUS],
    all: Level,
    each: [Level; JUDGED],
    likely: Likely,
}

/// Mean of a square over the last seconds, and when it was last that of a rig in order.
#[derive(Clone, Copy, Default)]
struct Level {
    mean: f64,
    quiet_s: f64,
}

impl Level {
    fn add(&mut self, square: f64, t_s: f64) {
        if square.is_finite() {
            // One second that is far off is a blow.
            self.mean += (square.min(CONFIG.monitor_square_max) - self.mean) / CONFIG.monitor_s;
        }
        if self.mean <= 1.0 {
            self.quiet_s = t_s;
        }
    }
}

impl Monitor {
    /// Of a commissioned rig.
    ///
    /// # Errors
    /// [`GapError`] when the baseline is of another robot.
    pub fn new(robot: &RobotSpec, rig: &Commissioned) -> Result<Self, GapError> {
        let rig = &*rig.seen_from(robot)?;
        let parameters = calibration_parameters();
        let mut values = rig.arm.values.clone();
        let (mut changed, mut read) = (Vec::new(), Vec::new());
        let mut drift = [0.0; IMUS];
        for (i, k) in parameters.iter().enumerate() {
            match *k {
                // The drift of a heading is another one in every session.
                CalibrationParameter::Drift(imu) => {
                    values[i] = 0.0;
                    drift[imu] = CONFIG.restarted_max * rig.arm.between[i].sqrt();
                }
                CalibrationParameter::Frame(_)
                | CalibrationParameter::Clock
                | CalibrationParameter::Body(_) => {}
                k if k.is_mechanical() => changed.push((i, 0.1 * k.prior())),
                k => read.push((i, 0.1 * k.prior())),
            }
        }
        let all = changed.iter().chain(&read);
        let places: Vec<usize> = all.map(|(i, _)| *i).collect();
        let spread = DMatrix::from_fn(places.len(), places.len(), |a, b| {
            let (a, b) = (places[a], places[b]);
            let between = if a == b { rig.arm.between[a] } else { 0.0 };
            rig.arm.covariance[(a, b)] + between
        });
        let with = |(i, change): (usize, f64)| {
            let mut values = values.clone();
            values[i] += change;
            (i, change, Follower::new(robot, values, &[]))
        };
        let floors = rig.arm.channel_floor;
        let (noise, floor) = of_seconds(rig.arm.healthy.as_deref().unwrap_or_default(), &floors);
        Ok(Self {
            changed: changed.into_iter().map(with).collect(),
            likely: Likely::new(robot, &effects::table(), &rig.present, &values),
            arm: Follower::new(robot, values.clone(), &[]),
            coarse: Follower::new(robot, values, &[]),
            robot: robot.clone(),
            read,
            spread,
            noise,
            floor,
            samples: VecDeque::new(),
            holes_s: Vec::new(),
            began_s: None,
            rests_from_s: None,
            judged_s: None,
            before: None,
            bins: VecDeque::new(),
            headings: std::array::from_fn(|i| Heading::new(floors[IMU_0 + 3 * i + 2], drift[i])),
            all: Level::default(),
            each: [Level::default(); JUDGED],
        })
    }

    /// An effect that is known, of the name that a [`Disagreement`] has for it, counts no longer: what it explains, whatever its size, is
    /// no error. Or it counts again. Whether there is one of this name.
    pub fn mute(&mut self, name: &str, muted: bool) -> bool {
        self.likely.mute(name, muted)
    }

    /// Effects that are known and count no longer.
    pub fn muted(&self) -> Vec<String> {
        self.likely.muted()
    }

    /// Takes what was measured; judges once in a second and gives the verdict, else `None`.
    pub fn take(&mut self, m: Measured) -> Option<Disagreement> {
        match self.samples.back() {
            Some(last) if m.t_s <= last.t_s || m.t_s - last.t_s >= EVERY_S => self.begin_again(),
            // A load is declared some seconds before or after it is there.
            Some(last) if m.payload_kg != last.payload_kg => self.rests_from_s = Some(m.t_s),
            _ => {}
        }
        let began_s = *self.began_s.get_or_insert(m.t_s);
        let settled_s = self.rests_from_s.map_or(began_s, |s| s.max(began_s)) + SETTLES_S;
        let now_s = m.t_s;
        self.samples.push_back(m);
        if now_s < self.judged_s.unwrap_or(began_s) + EVERY_S + WAITS_S {
            return None;
        }
        let old = |s: &Measured| now_s - s.t_s > KEPT_S;
        while self.samples.front().is_some_and(old) {
            self.samples.pop_front();
        }
        let until_s = now_s - WAITS_S;
        self.judged_s = Some(until_s);
        let Some(second) = self.follow(until_s) else {
            self.begin_again();
            return None;
        };
        for (i, heading) in self.headings.iter_mut().enumerate() {
            let off_rad = second.errors[IMU_0 + 3 * i + 2];
            if off_rad.is_finite() {
                heading.correct(off_rad, until_s);
            }
        }
        if until_s < settled_s {
            return None;
        }
        self.judge(&second, until_s);
        Some(self.worst(until_s))
    }

    /// Where the arm is and how it came there is no longer known.
    fn begin_again(&mut self) {
        self.samples.clear();
        self.bins.clear();
        (self.began_s, self.judged_s, self.before) = (None, None, None);
        let changed = self.changed.iter_mut().map(|(_, _, arm)| arm);
        changed
            .chain([&mut self.arm, &mut self.coarse])
            .for_each(Follower::begin_again);
        self.likely.begin_again();
        // Filters of orientation begin again after a gap, too.
        self.headings
            .iter_mut()
            .for_each(|heading| heading.at = None);
    }

    /// Follows the arm up to `until_s`. `None` where it cannot be followed.
    fn follow(&mut self, until_s: f64) -> Option<Second> {
        let grid = Grid::of_moments(&self.samples)?;
        self.holes_s.clone_from(&grid.holes_s);
        let known_s = self
            .bins
            .back()
            .map_or(f64::NEG_INFINITY, |b| b.t_s + 0.5 / GRID_HZ);
        let from = grid.t_s.iter().position(|t| *t > known_s)?;
        let to = grid
            .t_s
            .iter()
            .position(|t| *t > until_s)
            .unwrap_or(grid.len());
        if to <= from || (from == 0 && !self.bins.is_empty()) {
            return None;
        }
        let (t_s, gauge_pa) = (&grid.session.t_s, &grid.gauge_pa);
        let behind = effects::behind_gauges(&self.robot, t_s, gauge_pa, &self.arm.moving);
        let chamber_pa = grid.binned(&behind);
        let payload_kg = grid.payload_kg();
        let course = (&grid.t_s[..to], &chamber_pa[..to]);
        let moved = self.arm.go_on(course, from, &payload_kg).ok()?;
        for (k, bin) in (from..to).enumerate() {
            self.bins.push_back(Bin {
                t_s: grid.t_s[bin],
                measured: grid.sensors[bin].clone(),
                predicted: moved.sensors[k].clone(),
                pads: moved.base_from_pad[k],
            });
        }
        while self.bins.len() > to - from + TAIL {
            self.bins.pop_front();
        }
        let (own, bins) = self.tail();
        let rows = residuals(&self.robot, &own, &bins, &self.arm.values, &[]);
        let errors = mean_row(&rows[rows.len() - (to - from)..]);
        let last = &rows[rows.len() - 1];
        let mut now = own.clone();
        let before = now.len() - 1;
        now.t_s.drain(..before);
        now.sensors.drain(..before);
        now.captured.drain(..before);
        let mut moment = Moment {
            tail: (&own, &bins),
            last,
            values: &self.arm.values,
            pressures: (&grid, to),
            before: self.before.replace((grid.t_s[to - 1], chamber_pa[to - 1])),
            chamber_pa: chamber_pa[to - 1],
            payload_kg: payload_kg[to - 1],
            now,
            coarse: [f64::NAN; CHANNELS],
        };
        moment.coarse = moment.moved(&self.robot, &mut self.coarse, &[])?;
        let mut columns = Vec::new();
        for (_, change, arm) in &mut self.changed {
            let row = moment.moved(&self.robot, arm, &[])?;
            columns.push(difference(&moment.coarse, &row, *change));
        }
        for (i, change) in &self.read {
            let mut values = self.arm.values.clone();
            values[*i] += change;
            let shifted = residuals(&self.robot, &own, &bins, &values, &[]);
            columns.push(difference(last, &shifted[shifted.len() - 1], *change));
        }
        let gauge_pa = grid.binned(gauge_pa);
        let moved = moves(&gauge_pa);
        Some(Second {
            effects: self.likely.columns(&self.robot, &moment),
            errors,
            columns,
            moved,
            inadequacy: inadequacy(&gauge_pa, moved),
        })
    }

    /// The last bins as a session and as predicted, headings as expected.
    fn tail(&self) -> (Grid, Simulated) {
        let t_s: Vec<f64> = self.bins.iter().map(|b| b.t_s).collect();
        let n = t_s.len();
        let moved = Simulated {
            sensors: self.bins.iter().map(|b| b.predicted.clone()).collect(),
            base_from_pad: self.bins.iter().map(|b| b.pads).collect(),
            captured: self.bins.iter().map(|b| [b.pads[1], b.pads[2]]).collect(),
            chamber_pa: vec![[0.0; CHAMBERS]; n],
            gauge_pa: Vec::new(),
        };
        let grid = Grid {
            session: Session::default(),
            gauge_pa: Vec::new(),
            first: Vec::new(),
            sensors: self.bins.iter().map(|b| self.turned_back(b)).collect(),
            captured: vec![None; n],
            present: [true; CHANNELS],
            holes_s: self.holes_s.clone(),
            t_s,
        };
        (grid, moved)
    }

    /// What a bin measured, without what its headings are expected to be off by.
    fn turned_back(&self, bin: &Bin) -> SensorVec {
        let mut out = bin.measured.clone();
        for (ypr, heading) in out.imu_ypr_rad.iter_mut().zip(&self.headings) {
            ypr[0] -= heading.expected_rad(bin.t_s);
        }
        out
    }

    fn judge(&mut self, second: &Second, t_s: f64) {
        let Second {
            errors,
            columns,
            effects,
            moved,
            inadequacy,
        } = second;
        let known: Vec<usize> = (0..JUDGED)
            .filter(|c| errors[SPRING_0 + c].is_finite() && self.floor[*c].is_finite())
            .collect();
        let n = DMatrix::from_fn(known.len(), columns.len(), |a, k| {
            columns[k][SPRING_0 + known[a]]
        });
        let mut s = &n * &self.spread * n.transpose();
        for (a, c) in known.iter().enumerate() {
            for (b, d) in known.iter().enumerate() {
                s[(a, b)] += self.noise[(*c, *d)];
            }
            s[(a, a)] += inadequacy * self.floor[*c].powi(2);
        }
        for column in self.likely.of_muted(effects) {
            let j = known.iter().map(|c| MUTED * column[SPRING_0 + c]);
            let j = DVector::from_iterator(known.len(), j);
            s += &j * j.transpose();
        }
        let e = DVector::from_iterator(known.len(), known.iter().map(|c| errors[SPRING_0 + c]));
        let Some(inverse) = s.cholesky().map(|s| s.inverse()) else {
            return;
        };
        let weighed = &inverse * &e;
        // What one channel alone is off by, given all others.
        for (a, c) in known.iter().enumerate() {
            self.each[*c].add(weighed[a].powi(2) / inverse[(a, a)], t_s);
        }
        let square = e.dot(&weighed) / known.len().max(1) as f64;
        self.all.add(square, t_s);
        // One second that is far off is a blow.
        let least = (CONFIG.monitor_square_max / square).min(1.0).sqrt();
        let new = moved.clamp(CONFIG.monitor_at_rest, 1.0) / CONFIG.monitor_s;
        self.likely
            .add(effects, &known, (&inverse, &(weighed * least)), (t_s, new));
    }

    fn worst(&self, t_s: f64) -> Disagreement {
        let largest = |rank: &dyn Fn(usize) -> f64, n: usize| {
            let best = (0..n).max_by(|a, b| rank(*a).total_cmp(&rank(*b)));
            best.map_or((0, 0.0), |i| (i, rank(i)))
        };
        let (worst, one) = largest(&|c| self.each[c].mean, JUDGED);
        let (imu, drift) = largest(&|i| self.headings[i].excess(), IMUS);
        let suspects = self.likely.best();
        let [all_max, one_max] = CONFIG.monitor_limit;
        let turns = format!("drift of IMU {}", imu + 1);
        // What was tested, over its limit, and when it was last as in a rig in order.
        let mut tests = vec![
            ((self.all.mean / all_max).sqrt(), self.all.quiet_s, None),
            ((one / one_max).sqrt(), self.each[worst].quiet_s, None),
            (drift, self.headings[imu].quiet_s, Some(turns)),
        ];
        tests.extend(suspects.first().map(|s| (s.ratio.sqrt(), s.since_s, None)));
        log::debug!(
            "{t_s:.1} s: all, one, drift, effects: {:.2?}; {suspects:.2?}",
            tests.iter().map(|test| test.0).collect::<Vec<_>>()
        );
        let most = tests.into_iter().max_by(|a, b| a.0.total_cmp(&b.0));
        let (ratio, since_s, channel) = most.unwrap_or((0.0, t_s, None));
        Disagreement {
            t_s,
            ratio,
            channel: channel.unwrap_or_else(|| channel_name(SPRING_0 + worst)),
            since_s,
            likely: suspects.into_iter().map(|s| s.name).collect(),
            muted: self.likely.muted(),
        }
    }
}

/// Covariance of the mean errors of a second in a rig in order, and the size of each.
fn of_seconds(rows: &[Row], floors: &Row) -> (DMatrix<f64>, DVector<f64>) {
    let seconds: Vec<Row> = rows.chunks(GRID_HZ as usize).map(mean_row).collect();
    let both = |a: usize, b: usize| -> f64 {
        let of = |row: &Row| row[SPRING_0 + a] * row[SPRING_0 + b];
        let products: Vec<f64> = seconds.iter().map(of).filter(|x| x.is_finite()).collect();
        products.iter().sum::<f64>() / products.len().max(1) as f64
    };
    let noise = DMatrix::from_fn(JUDGED, JUDGED, |a, b| match a == b {
        true => floors[SPRING_0 + a].powi(2).max(both(a, a)),
        false => (1.0 - CONFIG.shrinkage) * both(a, b),
    });
    let floor = DVector::from_fn(JUDGED, |c, _| floors[SPRING_0 + c]);
    (noise, floor)
}

/// Variance of the model inadequacy at the last of these pressures, which have `moved` so far, in squares of the floor.
fn inadequacy(chamber_pa: &[[f64; CHAMBERS]], moved: f64) -> f64 {
    let level = chamber_pa.last().map_or(0.0, |now| {
        now.iter().map(|p| (p / USUAL_PA).powi(2)).sum::<f64>()
    });
    CONFIG.inadequacy.powi(2) * (1.0 + level) + (CONFIG.inadequacy_rate * moved).powi(2)
}

/// How far the pressures have moved in the last second, bin by bin, over what is usual.
fn moves(chamber_pa: &[[f64; CHAMBERS]]) -> f64 {
    let second_ago = chamber_pa.len().saturating_sub(GRID_HZ as usize);
    let (Some(now), Some(then)) = (chamber_pa.last(), chamber_pa.get(second_ago)) else {
        return 0.0;
    };
    let rates = now.iter().zip(then).map(|(a, b)| (a - b) / USUAL_PA_S);
    rates.map(|r| r * r).sum::<f64>().sqrt()
}

/// Mean of every channel where it was measured.
fn mean_row(rows: &[Row]) -> Row {
    std::array::from_fn(|c| mean(rows.iter().map(|r| r[c])))
}

/// A heading and its drift, followed by a Kalman filter.
struct Heading {
    sd_rad: f64,
    /// Drift beyond which no restart explains it, rad/s.
    most_rad_s: f64,
    at: Option<(f64, Vector2<f64>, Matrix2<f64>)>,
    quiet_s: f64,
}

/// How uncertain heading (rad) and drift (rad/s) are at first.
const HEADING_SD: [f64; 2] = [0.1, 5e-3];

impl Heading {
    fn new(sd_rad: f64, most_rad_s: f64) -> Self {
        Self {
            sd_rad,
            most_rad_s,
            at: None,
            quiet_s: 0.0,
        }
    }

    /// What it is expected to be off by, rad.
    fn expected_rad(&self, t_s: f64) -> f64 {
        self.at
            .as_ref()
            .map_or(0.0, |(at_s, x, _)| x[0] + x[1] * (t_s - at_s))
    }

    /// Takes what it is off by beyond that in the last second.
    fn correct(&mut self, unexpected_rad: f64, t_s: f64) {
        let [heading, drift] = HEADING_SD;
        let first = Matrix2::new(heading * heading, 0.0, 0.0, drift * drift);
        let (before_s, x, p) = self.at.unwrap_or((t_s, Vector2::zeros(), first));
        let dt_s = t_s - before_s;
        let step = Matrix2::new(1.0, dt_s, 0.0, 1.0);
        let (mut x, mut p) = (step * x, step * p * step.transpose());
        p[(0, 0)] += CONFIG.heading_walk_rad.powi(2) / CONFIG.heading_bend_s * dt_s;
        p[(1, 1)] += CONFIG.heading_bend_rad_s.powi(2) / CONFIG.heading_bend_s * dt_s;
        // Errors of a few seconds are alike.
        let noise = self.sd_rad.powi(2) * CONFIG.monitor_s;
        let gain = p.column(0) / (p[(0, 0)] + noise);
        x += gain * unexpected_rad;
        p -= gain * p.row(0);
        self.at = Some((t_s, x, p));
        if self.excess() < 0.5 {
            self.quiet_s = t_s;
        }
    }

    /// Its drift, as far as it is known, over what a restart explains.
    fn excess(&self) -> f64 {
        let Some((_, x, p)) = &self.at else {
            return 0.0;
        };
        let known = (x[1].abs() - 2.0 * p[(1, 1)].sqrt()).max(0.0);
        known / self.most_rad_s
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A heading that drifts is expected where it is, and only a drift beyond what a restart explains counts.
    #[test]
    fn a_drift_is_followed_and_counts_once_no_restart_explains_it() {
        let most_rad_s = 1e-3;
        for (drift_rad_s, counts) in [(0.0, false), (8e-4, false), (-1.5e-3, true)] {
            let mut heading = Heading::new(1e-3, most_rad_s);
            for k in 0..120 {
                let t_s = f64::from(k);
                // A degree off at the beginning, and a pose that matters by a few milliradians.
                let off_rad = 0.017 + drift_rad_s * t_s + 2e-3 * (0.3 * t_s).sin();
                let unexpected_rad = off_rad - heading.expected_rad(t_s);
                if k > 20 {
                    assert!(
                        unexpected_rad.abs() < 8e-3,
                        "{drift_rad_s} at {t_s} s: {unexpected_rad:.1e}"
                    );
                }
                heading.correct(unexpected_rad, t_s);
            }
            assert_eq!(
                heading.excess() > 1.0,
                counts,
                "{drift_rad_s}: {}",
                heading.excess()
            );
        }
    }

    #[test]
    fn a_level_is_the_mean_square_of_the_last_seconds_and_a_blow_counts_little() {
        let mut level = Level::default();
        for k in 0..300 {
            level.add(1.0, f64::from(k));
        }
        assert!((level.mean - 1.0).abs() < 1e-3);
        level.add(1e9, 300.0);
        level.add(f64::NAN, 301.0);
        assert!(level.mean < 1.0 + CONFIG.monitor_square_max / CONFIG.monitor_s);
        assert_eq!(level.quiet_s, 299.0);
    }
}
