use super::*;
use crate::signal::ImuRaw;
use rand::SeedableRng as _;
use rand_distr::{Distribution as _, StandardNormal};
use rand_pcg::Pcg64Mcg;

fn filter() -> Filter {
    Filter::new(&RobotSpec::reference(), &Calibration::as_drawn())
}

/// A bent, moving arm.
fn bent() -> Filter {
    let mut f = filter();
    for (p, pad) in f.pads.iter_mut().enumerate() {
        let k = p as f64;
        pad.pose.translation.vector += Vector3::new(0.02 + 0.03 * k, -0.03, 0.01 * k);
        pad.pose.rotation = UnitQuaternion::from_euler_angles(0.3, -0.2 - 0.2 * k, 0.1);
        pad.velocity = Vector3::new(0.1, -0.2, 0.05);
        pad.rate = Vector3::new(0.4, 0.3, -0.6);
        pad.acceleration = Vector3::new(1.0, -2.0, 0.7);
    }
    f.level_from_base = UnitQuaternion::from_euler_angles(0.03, -0.02, 0.0);
    f.spring_bias_m = [3e-4; SPRINGS];
    f
}

/// Moves the state by a step of one error.
fn moved(f: &Filter, state: usize, step: f64) -> Filter {
    let mut moved = f.clone();
    moved.correction[state] = step;
    moved.inject();
    moved
}

/// Largest difference between a row and the finite difference of what it is the derivative of.
fn worst(f: &Filter, row: &Row, predicted: impl Fn(&Filter) -> f64) -> f64 {
    let mut dense = [0.0; STATES];
    for (state, value) in row.entries() {
        dense[state] += value;
    }
    let h = 1e-6;
    (0..STATES)
        .map(|k| {
            let slope = (predicted(&moved(f, k, h)) - predicted(&moved(f, k, -h))) / (2.0 * h);
            (slope - dense[k]).abs()
        })
        .fold(0.0, f64::max)
}

#[test]
fn rows_are_the_derivatives_of_the_measurements() {
    let mut f = bent();
    f.has_jumped[7] = true;
    for i in 0..SPRINGS {
        // The lag term's own derivative after the pose is left out: it is the lag times a rate.
        let mut slow = f.clone();
        for pad in &mut slow.pads {
            pad.velocity = Vector3::zeros();
            pad.rate = Vector3::zeros();
        }
        let (_, row, _) = slow.spring_row(i);
        let off = worst(&slow, &row, |f| f.spring_row(i).0);
        // An unopened jump is no state.
        let closed = if slow.has_jumped[i] { 1e-7 } else { 1.0 + 1e-7 };
        assert!(off < closed, "spring {i}: {off}");
    }
    for i in 0..IMUS {
        let (_, rows) = f.gyro_rows(i);
        let (_, forces) = f.accel_rows(i);
        for k in 0..3 {
            let off = worst(&f, &rows[k], |f| f.gyro_rows(i).0[k]);
            assert!(off < 1e-6, "gyro {i} {k}: {off}");
            let off = worst(&f, &forces[k], |f| f.accel_rows(i).0[k]);
            assert!(off < 1e-6, "accelerometer {i} {k}: {off}");
        }
    }
}

#[test]
fn the_covariance_moves_on_as_the_states_do() {
    let f = bent();
    let dt_s = 0.01;
    let mut after = f.clone();
    after.predict(dt_s);
    // Column of F by a finite difference of the prediction itself.
    for state in [TH, V + 1, W + 2, A, PAD + TH + 1, PAD + W] {
        let h = 1e-5;
        let mut other = moved(&f, state, h);
        other.predict(dt_s);
        let mut alone = f.clone();
        for k in 0..STATES {
            alone.isolate(k, 0.0);
        }
        alone.covariance[state][state] = 1.0;
        alone.predict(dt_s);
        for p in 0..PADS {
            let turn = (other.pads[p].pose.rotation * after.pads[p].pose.rotation.inverse())
                .scaled_axis()
                / h;
            let moved_m =
                (other.pads[p].pose.translation.vector - after.pads[p].pose.translation.vector) / h;
            for axis in 0..3 {
                let of = |k: usize| {
                    // The covariance of what became of this error with the error itself is F's column.
                    let own = alone.covariance[state][state].max(1e-12);
                    alone.covariance[PAD * p + k][state] / own.sqrt()
                };
                if PAD * p + TH + axis != state {
                    assert!(
                        (turn[axis] - of(TH + axis)).abs() < 2e-2,
                        "{state} turns {p} {axis}"
                    );
                }
                if PAD * p + P + axis != state {
                    assert!(
                        (moved_m[axis] - of(P + axis)).abs() < 2e-2,
                        "{state} moves {p} {axis}"
                    );
                }
            }
        }
    }
}

/// A world that is exactly as the filter assumes: its errors are as large as it states.
#[test]
fn errors_are_as_large_as_stated_in_a_linear_gaussian_world() {
    let mut rng = Pcg64Mcg::seed_from_u64(7);
    let mut unit = move || -> f64 { StandardNormal.sample(&mut rng) };
    let quiet = [1e-4_f64, 1e-5];
    let (mut sum, mut n) = (0.0, 0.0);
    for _ in 0..120 {
        let mut f = filter();
        let mut truth = filter();
        for p in 0..PADS {
            f.pads[p].lively = quiet;
            for k in 0..PAD {
                let sd = [1e-3, 5e-3, 1e-3, 5e-3, 1e-2][k / 3];
                f.isolate(PAD * p + k, sd * sd);
                truth.correction[PAD * p + k] = sd * unit();
            }
        }
        for state in GYRO..JUMP {
            truth.correction[state] = f.covariance[state][state].sqrt() * unit();
        }
        truth.inject();
        let dt_s = 0.01;
        for frame in 0..60 {
            truth.predict(dt_s);
            f.predict(dt_s);
            for p in 0..PADS {
                let keep = (-dt_s / ACCEL_TAU_S).exp();
                for k in 0..3 {
                    let accel = (quiet[0] * (1.0 - keep * keep)).sqrt();
                    truth.pads[p].acceleration[k] += accel * unit();
                    truth.pads[p].rate[k] += (quiet[1] * dt_s).sqrt() * unit();
                }
            }
            for i in 0..SPRINGS {
                let reading = truth.spring_row(i).0;
                let variance = 1e-8;
                f.take_all(&[Reading::Length {
                    spring: i,
                    value_m: reading + 1e-4 * unit(),
                    variance,
                }]);
            }
            for i in 0..IMUS {
                let noisy = |x: Vector3<f64>, sd: f64, unit: &mut dyn FnMut() -> f64| {
                    [x[0] + sd * unit(), x[1] + sd * unit(), x[2] + sd * unit()]
                };
                let raw = ImuRaw {
                    gyro_rad_s: noisy(truth.gyro_rows(i).0, 7e-4, &mut unit),
                    accel_m_s2: noisy(truth.accel_rows(i).0, 0.03, &mut unit),
                };
                f.take_all(&[Reading::Imu {
                    imu: i,
                    raw,
                    variance: [4.9e-7, 9e-4],
                }]);
            }
            if frame >= 20 && frame % 8 == 0 {
                sum += f.nees(&truth.poses()).expect("regular");
                n += 1.0;
            }
        }
    }
    let nees = sum / n;
    println!("NEES {nees:.3} per degree of freedom, {n} poses");
    assert!((nees - 1.0).abs() < 0.05, "{nees}");
}

#[test]
fn a_prior_taken_out_and_put_back_changes_nothing() {
    let mut f = filter();
    let readings: Vec<Reading> = (0..SPRINGS)
        .map(|spring| Reading::Length {
            spring,
            value_m: f.spring_row(spring).0 + 2e-4,
            variance: 1e-8,
        })
        .collect();
    f.start(&readings);
    // Something must be known of it beyond its prior.
    let row = Row::of(&[(SPRING + 3, 1.0)]);
    f.update(&row, 1e-4, 1e-7);
    f.inject();
    let before = f.clone();
    let spring = Channel::Spring(3);
    f.apply_flip(spring);
    assert!(f.is_open(spring) && f.covariance[SPRING + 3][SPRING + 3] > 9e-8);
    f.apply_flip(spring);
    assert!(!f.is_open(spring));
    assert!((f.spring_bias_m[3] - before.spring_bias_m[3]).abs() < 1e-9);
    for (row, was) in f.covariance.iter().zip(before.covariance.iter()) {
        for (x, y) in row.iter().zip(was) {
            assert!((x - y).abs() <= 1e-9 * (1.0 + y.abs()), "{x} {y}");
        }
    }
}
