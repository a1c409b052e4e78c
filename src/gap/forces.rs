//! Residual tensions: what each bellows would have to pull besides so that the arm stands as it was measured.
//!
//! At every instant the residuals e of the tip and the springs, with the sensitivities J of the arm to six constant tensions, are
//! turned into T = (Jᵀ W J + 1/s²)⁻¹ Jᵀ W e. W holds the inverse squares of the healthy errors and s is the usual size of a tension,
//! so what nothing measures stays zero with the standard deviation s. Beside every tension stand the inputs that a law may have.

use nalgebra::{SMatrix, SVector};

use super::baseline::Commissioned;
use super::commission::factory;
use super::finding::Dependence;
use super::parallel;
use super::problem::{Replayed, Run};
use super::replay::Row;
use super::session::{Grid, IMU_0, common_channels};
use super::{GapError, noise};
use crate::robot::RobotSpec;
use crate::signal::{CHAMBERS, Pose};
use crate::sim::effects::{Active, lagged_ramps};
use crate::sim::sensors::{bellows_chords_m, bends_rad};

/// Usual size of a tension, N.
const USUAL_N: f64 = 20.0;
/// Memory of the past that an input is less, s.
const PAST_S: f64 = 3.0;
/// A length that goes back by more than this has turned, m.
const TURN_M: f64 = 2e-4;
/// What a law of a tension may depend on.
pub const FORCE_INPUTS: [&str; 11] = [
    "pressure_pa",
    "pressure_rate_pa_s",
    "pressure_less_past_pa",
    "neighbours_pa",
    "other_segment_pa",
    "longer_m",
    "longer_rate_m_s",
    "longer_less_past_m",
    "way_since_turn_m",
    "bend_rad",
    "t_s",
];

/// A bellows at an instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BellowsForce {
    /// Which bellows, 0-based.
    pub bellows: usize,
    /// The tension that is missing, N.
    pub residual_n: f64,
    /// Its standard deviation by the healthy errors, N.
    pub sd_n: f64,
    /// Inputs in the order of [`FORCE_INPUTS`]. Lengths are relative to those at 0 Pa, neighbours' pressures are summed; the past is
    /// what a first-order lag of 3 s makes of an input; the way has the sign of its direction. Lengths and bending are those of the model.
    pub inputs: [f64; FORCE_INPUTS.len()],
}

/// A session's residual tensions, instant by instant, six each.
#[derive(Clone, Debug, PartialEq)]
pub struct ResidualForces {
    /// The session.
    pub session: String,
    /// Its instants.
    pub rows: Vec<BellowsForce>,
}

/// Parts with equally many instants among which a dependence is seen.
const PARTS: usize = 10;

/// Of all bellows and inputs the dependence that explains most newtons; `None` without data.
pub fn strongest(sessions: &[ResidualForces]) -> Option<Dependence> {
    let rows = || sessions.iter().flat_map(|s| &s.rows);
    let all = (0..CHAMBERS).flat_map(|b| FORCE_INPUTS.iter().enumerate().map(move |i| (b, i)));
    let of = |(bellows, (i, input)): (usize, (usize, &&'static str))| {
        let own = rows().filter(|r| r.bellows == bellows);
        let mut points: Vec<[f64; 2]> = own.map(|r| [r.inputs[i], r.residual_n]).collect();
        points.sort_by(|a, b| a[0].total_cmp(&b[0]));
        let part = points.len().div_ceil(PARTS).max(1);
        let followed = |p: &[[f64; 2]]| {
            let sum: f64 = p.iter().map(|[_, y]| y).sum();
            sum * sum / p.len() as f64
        };
        let followed: f64 = points.chunks(part).map(followed).sum();
        let square: f64 = points.iter().map(|[_, y]| y * y).sum();
        (square > 0.0).then(|| Dependence {
            bellows,
            input,
            share: followed / square,
            rms_n: (square / points.len() as f64).sqrt(),
            points,
        })
    };
    let newtons = |d: &Dependence| d.share * d.rms_n * d.rms_n;
    all.filter_map(of)
        .max_by(|a, b| newtons(a).total_cmp(&newtons(b)))
}

/// Residual tensions of sessions on the robot as it is, patches included, with what is known of the rig in order;
/// `None`: the factory model.
///
/// # Errors
/// [`GapError`] when the arm cannot follow a session, or the baseline is of another robot.
pub fn residual_forces(
    robot: &RobotSpec,
    healthy: Option<&Commissioned>,
    grids: &[&Grid],
) -> Result<Vec<ResidualForces>, GapError> {
    let present = common_channels(grids.iter().copied());
    let baseline = match healthy {
        None => factory(&present),
        Some(rig) => rig.seen_from(robot)?.arm_in(&rig.in_common(present)),
    };
    let replayed = Replayed::new(robot, grids, &baseline)?;
    let zero = replayed.rows(&[])?;
    let pulled = parallel(&std::array::from_fn::<_, CHAMBERS, _>(|i| i), |&i| {
        replayed.rows(&[Active::new("tension-constant", Some(i), &[1.0])?])
    });
    let pulled = pulled.into_iter().collect::<Result<Vec<_>, _>>()?;
    let mut weights = [0.0; IMU_0];
    for (c, size) in baseline.noise.sizes().filter(|(c, _)| *c < IMU_0) {
        weights[c] = size.powi(-2);
    }
    let mut out = Vec::new();
    let mut first = 0;
    for run in &replayed.runs {
        let inputs = inputs(robot, run);
        let mut rows = Vec::new();
        for (k, inputs) in inputs.iter().enumerate().skip(noise::start()) {
            let at = first + k;
            let moved: [&Row; CHAMBERS] = std::array::from_fn(|i| &pulled[i][at]);
            if let Some(tensions) = tensions(&zero[at], moved, &weights) {
                rows.extend(tensions.iter().zip(inputs).enumerate().map(
                    |(bellows, (&[residual_n, sd_n], inputs))| BellowsForce {
                        bellows,
                        residual_n,
                        sd_n,
                        inputs: *inputs,
                    },
                ));
            }
        }
        first += run.grid.len();
        out.push(ResidualForces {
            session: run.grid.session.name.clone(),
            rows,
        });
    }
    Ok(out)
}

/// The six tensions with their standard deviations, N, from the residuals without and with 1 N more in each bellows; `None` where
/// nothing was measured.
fn tensions(
    zero: &Row,
    pulled: [&Row; CHAMBERS],
    weights: &[f64; IMU_0],
) -> Option<[[f64; 2]; CHAMBERS]> {
    let mut normal = SMatrix::<f64, CHAMBERS, CHAMBERS>::identity() / USUAL_N.powi(2);
    let mut right = SVector::<f64, CHAMBERS>::zeros();
    let mut any = false;
    for c in 0..IMU_0 {
        let change = SVector::<f64, CHAMBERS>::from_fn(|i, _| zero[c] - pulled[i][c]);
        if weights[c] > 0.0 && zero[c].is_finite() && change.iter().all(|x| x.is_finite()) {
            normal += weights[c] * change * change.transpose();
            right += weights[c] * zero[c] * change;
            any = true;
        }
    }
    let covariance = normal.try_inverse().filter(|_| any)?;
    let tension = covariance * right;
    Some(std::array::from_fn(|i| {
        [tension[i], covariance[(i, i)].sqrt()]
    }))
}

/// The inputs of every bellows at every instant.
fn inputs(robot: &RobotSpec, run: &Run) -> Vec<[[f64; FORCE_INPUTS.len()]; CHAMBERS]> {
    let (grid, moved) = (&run.grid, &run.healthy);
    let pressure_pa = grid.binned(&grid.gauge_pa);
    let pads = || moved.base_from_pad.iter();
    let bend_rad: Vec<[f64; 2]> = pads().map(bends_rad).collect();
    let longer_m: Vec<_> = pads().map(|pads| longer_m(robot, pads)).collect();
    let each = |of: &dyn Fn(usize) -> Vec<f64>| -> Vec<[f64; CHAMBERS]> {
        let series: [Vec<f64>; CHAMBERS] = std::array::from_fn(of);
        (0..grid.len())
            .map(|k| std::array::from_fn(|i| series[i][k]))
            .collect()
    };
    let of =
        |rows: &[[f64; CHAMBERS]], i: usize| -> Vec<f64> { rows.iter().map(|r| r[i]).collect() };
    let pressure_past = each(&|i| lagged_ramps(&grid.t_s, &of(&pressure_pa, i), PAST_S));
    let longer_past = each(&|i| lagged_ramps(&grid.t_s, &of(&longer_m, i), PAST_S));
    let way_m = each(&|i| way_since_turn(&of(&longer_m, i)));
    let at = |k: usize| {
        let p = pressure_pa[k];
        let sum = |segment: usize| -> f64 { p[3 * segment..3 * segment + 3].iter().sum() };
        std::array::from_fn(|i| {
            [
                p[i],
                grid.rate(&pressure_pa, k, i),
                p[i] - pressure_past[k][i],
                sum(i / 3) - p[i],
                sum(1 - i / 3),
                longer_m[k][i],
                grid.rate(&longer_m, k, i),
                longer_m[k][i] - longer_past[k][i],
                way_m[k][i],
                bend_rad[k][i / 3],
                grid.t_s[k] - grid.t_s[0],
            ]
        })
    };
    (0..grid.len()).map(at).collect()
}

/// How far a length has gone since it last turned, with the sign of its direction.
fn way_since_turn(lengths_m: &[f64]) -> Vec<f64> {
    let Some(&first) = lengths_m.first() else {
        return Vec::new();
    };
    // The furthest place on the present way, and where that way began.
    let (mut turn, mut furthest, mut rises) = (first, first, true);
    let step = |&l: &f64| {
        let ahead = if rises { l - furthest } else { furthest - l };
        if ahead > 0.0 {
            furthest = l;
        } else if ahead < -TURN_M {
            (turn, furthest, rises) = (furthest, l, !rises);
        }
        l - turn
    };
    lengths_m.iter().map(step).collect()
}

/// What each bellows is longer than at 0 Pa, as an arc between its ends.
fn longer_m(robot: &RobotSpec, base_from_pad: &[Pose; 3]) -> [f64; CHAMBERS] {
    let (straight_m, bend_rad) = (
        bellows_chords_m(robot, base_from_pad),
        bends_rad(base_from_pad),
    );
    std::array::from_fn(|i| {
        let half = 0.5 * bend_rad[i / 3];
        let arc = if half > 1e-6 { half / half.sin() } else { 1.0 };
        arc * straight_m[i] - robot.rest_length_m
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_way_begins_where_the_length_turned() {
        let lengths = [0.0, 1e-3, 2e-3, 1.9e-3, 1.5e-3, 1e-3, 1.1e-3, 2e-3];
        let ways = way_since_turn(&lengths);
        // 0.1 mm back and forth is no turn.
        let expected = [0.0, 1e-3, 2e-3, 1.9e-3, -0.5e-3, -1e-3, -0.9e-3, 1e-3];
        for (way, expected) in ways.iter().zip(expected) {
            assert!((way - expected).abs() < 1e-12, "{ways:?}");
        }
        assert!(way_since_turn(&[]).is_empty());
    }

    #[test]
    fn the_input_that_a_tension_follows_is_found() {
        let row = |k: usize, bellows: usize| {
            let mut inputs = [0.0; FORCE_INPUTS.len()];
            for (i, x) in inputs.iter_mut().enumerate() {
                *x = (k as f64 * (0.37 + i as f64)).sin();
            }
            BellowsForce {
                bellows,
                // Below a length, and as much of something else.
                residual_n: match bellows {
                    2 => (-inputs[5]).max(0.0) + 0.1 * inputs[0],
                    _ => 0.1 * inputs[1],
                },
                sd_n: 0.1,
                inputs,
            }
        };
        let rows = (0..400).flat_map(|k| (0..CHAMBERS).map(move |b| row(k, b)));
        let session = ResidualForces {
            session: "s".to_owned(),
            rows: rows.collect(),
        };
        let found = strongest(&[session]).expect("data");
        assert_eq!((found.bellows, found.input), (2, "longer_m"));
        assert!(found.share > 0.9, "{}", found.text());
        assert_eq!(strongest(&[]), None);
    }

    #[test]
    fn tensions_come_back_from_the_residuals_they_make() {
        let missing = [3.0, 0.0, -2.0, 0.0, 1.0, 0.0];
        // Two channels each move by 0.1 mm for every newton in a bellows.
        let of = |c: usize, i: usize| 1e-4 * f64::from(u8::from(c == i) + u8::from(c == 6 + i));
        let mut zero = [f64::NAN; crate::gap::CHANNELS];
        for (c, z) in zero.iter_mut().enumerate().take(12) {
            *z = (0..CHAMBERS).map(|i| of(c, i) * missing[i]).sum();
        }
        let pulled: [Row; CHAMBERS] = std::array::from_fn(|i| {
            let mut row = zero;
            for (c, r) in row.iter_mut().enumerate().take(12) {
                *r -= of(c, i);
            }
            row
        });
        let weights = [1e-5f64.powi(-2); IMU_0];
        let found = tensions(&zero, pulled.each_ref(), &weights).expect("measured");
        for ([tension, sd], missing) in found.into_iter().zip(missing) {
            assert!((tension - missing).abs() < 1e-3, "{tension} for {missing}");
            assert!((sd - 0.1 / 2f64.sqrt()).abs() < 1e-3, "{sd}");
        }
        // Nothing was measured.
        let nothing = [f64::NAN; crate::gap::CHANNELS];
        assert_eq!(tensions(&nothing, pulled.each_ref(), &weights), None);
    }
}
