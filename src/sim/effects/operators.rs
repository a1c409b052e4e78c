//! Operators of the effects. The equations stand in the table.

use nalgebra::{Isometry3, Rotation3, Translation3, UnitQuaternion, Vector3};

use super::effect::{Call, Line, Plant};
use crate::signal::{CHAMBERS, Pose, SensorVec, pose_between, ypr_from_rotation};
use crate::sim::rod::{Bellows, Branch, Floor, Friction, Viscosity};

/// Pressure of the air around, Pa.
const AMBIENT_PA: f64 = 101_325.0;

/// First-order lag, y' = (x − y)/τ, over one step in which x runs straight between two values.
fn follow(dt_s: f64, [from, to]: [f64; 2], y: f64, tau_s: f64) -> f64 {
    // y runs behind x by τ dx/dt once the transient has gone.
    let behind = tau_s * (to - from) / dt_s;
    let left = if tau_s > 0.0 {
        (-dt_s / tau_s).exp()
    } else {
        0.0
    };
    to - behind + (y - from + behind) * left
}

/// First-order lag of a series that is held between instants.
fn lagged(t_s: &[f64], x: &[f64], tau_s: f64) -> Vec<f64> {
    let mut y = x.to_vec();
    for k in 1..x.len() {
        y[k] = follow(t_s[k] - t_s[k - 1], [x[k]; 2], y[k - 1], tau_s);
    }
    y
}

/// First-order lag of `tau_s` behind a series that runs straight between the instants `t_s`: what was measured, not
/// commanded.
pub fn lagged_ramps(t_s: &[f64], x: &[f64], tau_s: f64) -> Vec<f64> {
    let mut y = x.to_vec();
    for k in 1..x.len() {
        y[k] = follow(t_s[k] - t_s[k - 1], [x[k - 1], x[k]], y[k - 1], tau_s);
    }
    y
}

/// The place of time `at` among `t_s`: index of the instant before it and the share of the way to
/// the next; held at both ends.
fn place(t_s: &[f64], at: f64) -> (usize, f64) {
    let last = t_s.len() - 1;
    if at <= t_s[0] || last == 0 {
        return (0, 0.0);
    }
    if at >= t_s[last] {
        return (last - 1, 1.0);
    }
    let k = t_s.partition_point(|t| *t <= at) - 1;
    (k, (at - t_s[k]) / (t_s[k + 1] - t_s[k]))
}

fn column(series: &[[f64; CHAMBERS]], i: usize) -> Vec<f64> {
    series.iter().map(|row| row[i]).collect()
}

/// Pressures of chambers that follow their gauges with the lag of `c`.
pub(super) fn behind_lag(c: &Call, chamber_pa: &mut [[f64; CHAMBERS]]) {
    for i in (0..CHAMBERS).filter(|i| c.hits(*i)) {
        change(chamber_pa, i, |x| lagged_ramps(c.t_s, x, c.values[0]));
    }
}

/// Replaces channel `i` of a series by what `f` makes of it.
fn change(series: &mut [[f64; CHAMBERS]], i: usize, f: impl Fn(&[f64]) -> Vec<f64>) {
    let new = f(&column(series, i));
    for (row, x) in series.iter_mut().zip(new) {
        row[i] = x;
    }
}

/// Changes the channels the effect acts on, before chamber and gauge part.
fn change_both(c: &Call, line: &mut Line, f: impl Fn(&[f64]) -> Vec<f64>) {
    for i in (0..CHAMBERS).filter(|i| c.hits(*i)) {
        change(&mut line.chamber_pa, i, &f);
        change(&mut line.gauge_pa, i, &f);
    }
}

pub(super) fn pressure_delay(c: &Call, line: &mut Line) {
    change_both(c, line, |x| {
        c.t_s
            .iter()
            .map(|t| {
                let (k, share) = place(c.t_s, t - c.values[0]);
                let next = x[(k + 1).min(x.len() - 1)];
                x[k] + share * (next - x[k])
            })
            .collect()
    });
}

pub(super) fn flow_limit(c: &Call, line: &mut Line) {
    change_both(c, line, |x| limited(c.t_s, x, [c.values[0], c.values[1]]));
}

/// The series at the times `t_s`, no faster than these rates up and down, both positive, per second.
pub fn limited(t_s: &[f64], x: &[f64], [up_1_s, down_1_s]: [f64; 2]) -> Vec<f64> {
    let mut y = x.to_vec();
    for k in 1..x.len() {
        let dt_s = t_s[k] - t_s[k - 1];
        y[k] = x[k].clamp(y[k - 1] - down_1_s * dt_s, y[k - 1] + up_1_s * dt_s);
    }
    y
}

/// Time constant of the boards' pressure regulators, s.
const REGULATOR_S: f64 = 0.1;

/// What escapes is missing at the pump, too: a chamber fills more slowly by it, and empties faster.
pub(super) fn leak(c: &Call, line: &mut Line) {
    for i in (0..CHAMBERS).filter(|i| c.hits(*i)) {
        let pump_pa_s = line.pump_pa_s[i].take();
        let leaking = |u: &[f64]| leaked(c.t_s, u, c.values[0], pump_pa_s);
        change(&mut line.chamber_pa, i, leaking);
        change(&mut line.gauge_pa, i, leaking);
    }
}

fn leaked(t_s: &[f64], u: &[f64], rate_1_s: f64, pump_pa_s: Option<[f64; 2]>) -> Vec<f64> {
    let [fill, empty] = pump_pa_s.unwrap_or([f64::INFINITY; 2]);
    let mut y = u.to_vec();
    // Pressure lost against the set one; implicit in λ p so that any rate is stable.
    let mut lost = u[0] * REGULATOR_S * rate_1_s / (1.0 + REGULATOR_S * rate_1_s);
    y[0] = u[0] - lost;
    for k in 1..u.len() {
        let dt_s = t_s[k] - t_s[k - 1];
        let (refill, rate) = (dt_s / REGULATOR_S, dt_s * rate_1_s);
        lost = (lost + rate * u[k]) / (1.0 + refill + rate);
        let (before, escapes) = (y[k - 1], rate * y[k - 1]);
        let most = before + (fill * dt_s - escapes).max(0.0);
        let least = before - (empty * dt_s + escapes).max(0.0);
        y[k] = (u[k] - lost).clamp(least, most);
    }
    y
}

pub(super) fn supply_coupling(c: &Call, line: &mut Line) {
    let (share, tau_s) = (c.values[0], c.values[1]);
    let drawn: Vec<Vec<f64>> = (0..CHAMBERS)
        .map(|j| {
            let u = column(&line.chamber_pa, j);
            let slow = lagged(c.t_s, &u, tau_s);
            u.iter().zip(slow).map(|(u, s)| u - s).collect()
        })
        .collect();
    for k in 0..c.t_s.len() {
        let all: f64 = drawn.iter().map(|d| d[k]).sum();
        for i in (0..CHAMBERS).filter(|i| c.hits(*i)) {
            let sag_pa = share * (all - drawn[i][k]);
            line.chamber_pa[k][i] -= sag_pa;
            line.gauge_pa[k][i] -= sag_pa;
        }
    }
}

pub(super) fn pressure_lag(c: &Call, line: &mut Line) {
    for i in (0..CHAMBERS).filter(|i| c.hits(*i)) {
        change(&mut line.chamber_pa, i, |x| lagged(c.t_s, x, c.values[0]));
    }
}

/// The gas behind a lagging line is a spring that leaks through the line.
pub(super) fn gas_spring(c: &Call, plant: &mut Plant) {
    if c.values[0] > 0.0 && c.values[1] > 0.0 {
        each_bellows(c, plant, |i, bellows| {
            bellows.branches.push(Branch {
                rate_n_m: c.values[1] * AMBIENT_PA * c.robot.area_m2[i] / c.robot.rest_length_m,
                tau_s: c.values[0],
            });
        });
    }
}

pub(super) fn gauge_error(c: &Call, line: &mut Line) {
    for i in (0..CHAMBERS).filter(|i| c.hits(*i)) {
        change(&mut line.gauge_pa, i, |x| {
            x.iter().map(|p| c.values[0] * p + c.values[1]).collect()
        });
    }
}

/// Chamber pressures behind gauges that read wrong.
pub(super) fn behind_gauge(c: &Call, chamber_pa: &mut [[f64; CHAMBERS]]) {
    for i in (0..CHAMBERS).filter(|i| c.hits(*i)) {
        for row in chamber_pa.iter_mut() {
            row[i] = (row[i] - c.values[1]) / c.values[0];
        }
    }
}

pub(super) fn hysteresis(c: &Call, plant: &mut Plant) {
    if c.values[0] > 0.0 {
        each_bellows(c, plant, |_, bellows| {
            bellows.friction.push(Friction {
                coulomb_force_n: c.values[0],
                presliding_m: c.values[1],
            });
        });
    }
}

pub(super) fn creep(c: &Call, plant: &mut Plant) {
    if c.values[0] > 0.0 {
        each_bellows(c, plant, |i, bellows| {
            bellows.branches.push(Branch {
                rate_n_m: c.values[0] * c.robot.axial_stiffness_n_m[i],
                tau_s: c.values[1],
            });
        });
    }
}

pub(super) fn stiffening(c: &Call, plant: &mut Plant) {
    each_bellows(c, plant, |_, bellows| {
        bellows.cubic_n += c.values[0] * bellows.stiffness_n
    });
}

pub(super) fn chamber_stiffness(c: &Call, plant: &mut Plant) {
    each_bellows(c, plant, |_, bellows| {
        bellows.stiffness_n *= c.values[0];
        bellows.cubic_n *= c.values[0];
    });
}

/// Changes the bellows that an effect acts on, each with its index.
pub(super) fn each_bellows(c: &Call, plant: &mut Plant, mut f: impl FnMut(usize, &mut Bellows)) {
    let bellows = plant.model.rod.bellows_mut().enumerate();
    bellows
        .filter(|(i, _)| c.hits(*i))
        .for_each(|(i, b)| f(i, b));
}

pub(super) fn damping(c: &Call, plant: &mut Plant) {
    plant.viscosity.add(Viscosity {
        bellows: c.values[0],
        core: c.values[0] * c.values[1],
    });
}

pub(super) fn payload(c: &Call, plant: &mut Plant) {
    plant.payload_kg += c.values[0];
}

pub(super) fn com_offset(c: &Call, plant: &mut Plant) {
    let d_m = Vector3::from_column_slice(c.values);
    plant.payload_m += d_m;
    // The gripper is the last mass of the last section.
    if let Some(gripper) = plant
        .model
        .rod
        .sections
        .last_mut()
        .and_then(|s| s.masses.last_mut())
    {
        gripper.at_m += d_m;
    }
}

pub(super) fn base_tilt(c: &Call, plant: &mut Plant) {
    let tilt = Rotation3::from_euler_angles(c.values[0], c.values[1], 0.0);
    plant.model.rod.gravity_m_s2 = tilt * plant.model.rod.gravity_m_s2;
}

/// IMUs of a tilted base: level, which they measure against, is turned against the base.
pub(super) fn tilted_imus(c: &Call, sensors: &mut [SensorVec]) {
    let seen = c.values.get(2).copied().unwrap_or(0.0);
    let tilt = Rotation3::from_euler_angles(c.values[0], c.values[1], 0.0);
    let base_from_level = Rotation3::new(seen * tilt.scaled_axis());
    for row in sensors {
        for i in 0..crate::signal::IMUS {
            let level_from_pad = base_from_level.inverse() * row.base_from_imu_pad(i);
            row.imu_ypr_rad[i] = crate::signal::ypr_from_rotation(&level_from_pad.into());
        }
    }
}

pub(super) fn tip_force(c: &Call, plant: &mut Plant) {
    plant.tip_force_n += Vector3::from_column_slice(c.values);
}

pub(super) fn contact(c: &Call, plant: &mut Plant) {
    // The shortest turn that takes the vertical to the surface's normal, undone.
    let base_from_surface = Rotation3::new(Vector3::new(c.values[3], c.values[4], 0.0));
    plant.model.rod.floor = Some(Floor {
        surface_from_base: base_from_surface.inverse(),
        height_m: c.values[0],
        rate_n_m: c.values[1],
        friction: c.values[2],
        drag: None,
    });
}

pub(super) fn torsion(c: &Call, plant: &mut Plant) {
    for (i, s) in plant.model.rod.sections.iter_mut().enumerate() {
        if c.hits(i) {
            s.rigidity[2] *= c.values[0];
        }
    }
}

pub(super) fn spring_calibration(c: &Call, sensors: &mut [SensorVec]) {
    each_spring(c, sensors, |_, l_m| c.values[0] * l_m + c.values[1]);
}

pub(super) fn spring_drift(c: &Call, sensors: &mut [SensorVec]) {
    each_spring(c, sensors, |t_s, l_m| l_m + c.values[0] * t_s);
}

/// Maps every reading the effect acts on; the function gets the time since the start and the
/// reading.
fn each_spring(c: &Call, sensors: &mut [SensorVec], f: impl Fn(f64, f64) -> f64) {
    for (t, s) in c.t_s.iter().zip(sensors) {
        for (i, l_m) in s.spring_m.iter_mut().enumerate() {
            if c.hits(i) {
                *l_m = f(t - c.t_s[0], *l_m);
            }
        }
    }
}

pub(super) fn spring_lag(c: &Call, sensors: &mut [SensorVec]) {
    for i in 0..crate::signal::SPRINGS {
        if !c.hits(i) {
            continue;
        }
        let l_m: Vec<f64> = sensors.iter().map(|s| s.spring_m[i]).collect();
        for (s, y) in sensors
            .iter_mut()
            .zip(lagged_ramps(c.t_s, &l_m, c.values[0]))
        {
            s.spring_m[i] = y;
        }
    }
}

pub(super) fn spring_crosstalk(c: &Call, sensors: &mut [SensorVec]) {
    for s in sensors {
        let clean_m = s.spring_m;
        for i in 0..clean_m.len() {
            if c.hits(i) {
                // Springs A and B of an X pair are neighbours in the order.
                s.spring_m[i] += c.values[0] * (clean_m[i ^ 1] - c.robot.rest_length_m);
            }
        }
    }
}

pub(super) fn spring_stuck(c: &Call, sensors: &mut [SensorVec]) {
    let mut held: Option<[f64; crate::signal::SPRINGS]> = None;
    for (t, s) in c.t_s.iter().zip(sensors) {
        if t - c.t_s[0] < c.values[0] {
            continue;
        }
        let held = held.get_or_insert(s.spring_m);
        for i in 0..held.len() {
            if c.hits(i) {
                s.spring_m[i] = held[i];
            }
        }
    }
}

pub(super) fn imu_drift(c: &Call, sensors: &mut [SensorVec]) {
    for (t, s) in c.t_s.iter().zip(sensors) {
        // About the vertical of the base: R = Rz(drift) R_true.
        let turned = c.values[0] * (t - c.t_s[0]);
        for (i, ypr) in s.imu_ypr_rad.iter_mut().enumerate() {
            if c.hits(i) {
                ypr[0] = wrapped(ypr[0] + turned);
            }
        }
    }
}

/// An angle into (−π, π].
fn wrapped(angle_rad: f64) -> f64 {
    use std::f64::consts::{PI, TAU};
    PI - (PI - angle_rad).rem_euclid(TAU)
}

pub(super) fn imu_misalignment(c: &Call, sensors: &mut [SensorVec]) {
    let off = UnitQuaternion::from_scaled_axis(Vector3::from_column_slice(c.values));
    for s in sensors {
        for i in (0..s.imu_ypr_rad.len()).filter(|i| c.hits(*i)) {
            let read = UnitQuaternion::from(s.base_from_imu_pad(i)) * off;
            s.imu_ypr_rad[i] = ypr_from_rotation(&read);
        }
    }
}

pub(super) fn mocap_frame(c: &Call, captured: &mut [[Pose; 2]]) {
    let moved = moved_by(c);
    for pads in captured {
        *pads = pads.map(|p| moved * p);
    }
}

pub(super) fn tracked_body(c: &Call, captured: &mut [[Pose; 2]]) {
    let moved = moved_by(c);
    let slipped = |i: usize| c.target.is_none_or(|target| target == i);
    for pads in captured {
        *pads = std::array::from_fn(|i| match slipped(i) {
            true => pads[i] * moved,
            false => pads[i],
        });
    }
}

/// Translation and rotation vector of six values.
fn moved_by(c: &Call) -> Pose {
    Isometry3::from_parts(
        Translation3::new(c.values[0], c.values[1], c.values[2]),
        UnitQuaternion::from_scaled_axis(Vector3::from_column_slice(&c.values[3..6])),
    )
}

pub(super) fn clock_offset(c: &Call, captured: &mut [[Pose; 2]]) {
    retime(c, captured, |t| t - c.values[0]);
}

pub(super) fn clock_skew(c: &Call, captured: &mut [[Pose; 2]]) {
    retime(c, captured, |t| t - c.values[0] * (t - c.t_s[0]));
}

/// Reports at every instant what was at another one.
fn retime(c: &Call, captured: &mut [[Pose; 2]], taken_s: impl Fn(f64) -> f64) {
    let clean = captured.to_vec();
    for (t, pads) in c.t_s.iter().zip(captured) {
        let (k, share) = place(c.t_s, taken_s(*t));
        let next = (k + 1).min(clean.len() - 1);
        *pads = std::array::from_fn(|p| pose_between(&clean[k][p], &clean[next][p], share));
    }
}
