//! Orientation error against an optical reference, by the metrics of BROAD.
//!
//! D. Laidig et al., "BROAD: a benchmark for robust inertial orientation estimation", Data 6(7),
//! 2021, doi 10.3390/data6070072: the error quaternion in the earth frame is split into a turn
//! about the vertical (heading) and the rest (inclination).

use nalgebra::UnitQuaternion;

use super::imu::heading_between;

/// Root mean square errors, rad.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct OrientationScore {
    /// Whole rotation.
    pub total_rad: f64,
    /// Tilt against the vertical.
    pub inclination_rad: f64,
    /// Turn about the vertical.
    pub heading_rad: f64,
    /// Samples counted.
    pub samples: usize,
}

/// An estimate and its reference, both earth from IMU.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Judged {
    /// Orientation by the filter.
    pub estimate: UnitQuaternion<f64>,
    /// True orientation.
    pub reference: UnitQuaternion<f64>,
    /// Whether the error counts.
    pub counts: bool,
}

/// Scores estimates against references after the mean heading offset of the first `align` pairs (at least one), counted or
/// not, is taken out of all estimates (a filter without magnetometer starts anywhere). A single pair
/// would bring its own noise in.
pub fn score(pairs: &[Judged], align: usize) -> OrientationScore {
    let mut out = OrientationScore::default();
    let mut squares = [0.0; 3];
    let (sin, cos) = pairs
        .iter()
        .take(align.max(1))
        .map(|p| heading_between(&p.reference, &p.estimate).sin_cos())
        .fold((0.0, 0.0), |sum, x| (sum.0 + x.0, sum.1 + x.1));
    let turn = UnitQuaternion::from_scaled_axis(nalgebra::Vector3::z() * sin.atan2(cos));
    for Judged {
        estimate,
        reference,
        counts,
    } in pairs
    {
        if !counts {
            continue;
        }
        let error = (reference * (turn * estimate).inverse()).into_inner();
        // e_total = 2 acos |w|, e_heading = 2 atan |z / w|, e_inclination = 2 acos √(w² + z²)
        let total = 2.0 * error.imag().norm().atan2(error.w.abs());
        let heading = 2.0 * error.k.abs().atan2(error.w.abs());
        let inclination = 2.0 * error.i.hypot(error.j).atan2(error.w.hypot(error.k));
        for (sum, e) in squares.iter_mut().zip([total, inclination, heading]) {
            *sum += e * e;
        }
        out.samples += 1;
    }
    if out.samples > 0 {
        let rms = squares.map(|s| f64::sqrt(s / out.samples as f64));
        [out.total_rad, out.inclination_rad, out.heading_rad] = rms;
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tilt_and_turn_are_told_apart_and_the_first_heading_is_free() {
        let q = |roll: f64, yaw: f64| UnitQuaternion::from_euler_angles(roll, 0.0, yaw);
        // The estimate's heading starts 1 rad off and drifts by 0.2; then it tilts by 0.1.
        let judged = |pairs: &[(UnitQuaternion<f64>, UnitQuaternion<f64>)], from: usize| {
            let pairs = pairs.iter().enumerate().map(|(k, p)| Judged {
                estimate: p.0,
                reference: p.1,
                counts: k >= from,
            });
            score(&pairs.collect::<Vec<_>>(), 1)
        };
        let turned = [(q(0.0, 1.0), q(0.0, 0.0)), (q(0.0, 1.2), q(0.0, 0.0))];
        let s = judged(&turned, 0);
        assert!((s.heading_rad - 0.2 / 2.0_f64.sqrt()).abs() < 1e-12);
        assert!(s.inclination_rad < 1e-9 && s.samples == 2);
        // The first pair sets the heading even where it does not count.
        let s = judged(&turned, 1);
        assert!((s.heading_rad - 0.2).abs() < 1e-12 && s.samples == 1);
        let s = judged(&[(q(0.0, 0.0), q(0.0, 0.0)), (q(0.1, 0.0), q(0.0, 0.0))], 0);
        assert!((s.inclination_rad - 0.1 / 2.0_f64.sqrt()).abs() < 1e-12);
        assert!((s.total_rad - s.inclination_rad).abs() < 1e-12 && s.heading_rad < 1e-9);
        let pairs = turned.map(|(estimate, reference)| Judged {
            estimate,
            reference,
            counts: true,
        });
        let s = score(&pairs, 2);
        assert!(
            (s.heading_rad - 0.1).abs() < 1e-12,
            "about the mean of both"
        );
        assert_eq!(score(&[], 1), OrientationScore::default());
    }
}
