use super::*;
use crate::robot::RobotSpec;
use crate::sensing::Calibration;
use crate::sensing::filter::Reading;
use nalgebra::{DMatrix, DVector};

/// Lengths of the arm at rest, some of them off, taken in again and again.
fn fed(off_m: &[(usize, f64)], frames: usize) -> Filter {
    let spec = RobotSpec::reference();
    let mut filter = Filter::new(&spec, &Calibration::as_drawn());
    let rest: Vec<f64> = (0..SPRINGS).map(|i| filter.length(i).0).collect();
    let lengths: Vec<Reading> = (0..SPRINGS)
        .map(|spring| Reading::Length {
            spring,
            value_m: rest[spring]
                + off_m
                    .iter()
                    .filter(|(i, _)| *i == spring)
                    .map(|o| o.1)
                    .sum::<f64>(),
            variance: 1e-8,
        })
        .collect();
    filter.start(&lengths);
    for _ in 0..frames {
        filter.take_all(&lengths);
    }
    filter
}

/// The formula against the likelihood itself, for a linear measurement y = H x + noise of biases x.
#[test]
fn the_evidence_is_the_exact_likelihood_ratio() {
    let (n, m) = (5, 7);
    let h = DMatrix::from_fn(m, n, |i, j| ((i * 7 + j * 3) as f64 * 0.37).sin());
    let y = DVector::from_fn(m, |i, _| 2.0 * ((i as f64) * 1.7).cos());
    let noise = 0.3;
    let old = [0.7, 0.7, 0.7, 0.02, 0.02];
    let new = [0.7, 8.0, 0.7, 0.02, 3.0];
    let log_likelihood = |sd: &[f64; 5]| {
        let prior = DMatrix::from_diagonal(&DVector::from_iterator(n, sd.iter().map(|s| s * s)));
        let s = &h * prior * h.transpose() + DMatrix::identity(m, m) * (noise * noise);
        let chol = s.cholesky().expect("positive");
        let log_det = 2.0 * chol.l().diagonal().map(f64::ln).sum();
        -0.5 * (log_det + y.dot(&chol.solve(&y)))
    };
    let prior = DMatrix::from_diagonal(&DVector::from_iterator(
        n,
        old.iter().map(|s| 1.0 / (s * s)),
    ));
    let precision = prior + h.transpose() * &h / (noise * noise);
    let a = precision.try_inverse().expect("regular");
    let mean = &a * h.transpose() * &y / (noise * noise);
    let changed = [1, 4];
    let flips: Vec<Flip> = changed
        .iter()
        .map(|&k| {
            let (from, to): (f64, f64) = (1.0 / (old[k] * old[k]), 1.0 / (new[k] * new[k]));
            Flip {
                state: k,
                estimate: mean[k],
                precision: to - from,
                log_ratio: (to / from).ln(),
            }
        })
        .collect();
    let by_formula = log_ratio(&flips, |i, j| a[(i, j)]).expect("regular");
    let exact = log_likelihood(&new) - log_likelihood(&old);
    assert!((by_formula - exact).abs() < 1e-9, "{by_formula} {exact}");
}

#[test]
fn elimination_gives_the_solution_and_the_determinant() {
    let mut m = [[0.0; BIASES + 1]; BIASES];
    let a = [[2.0, 1.0, 0.5], [1.0, 3.0, -1.0], [0.5, 0.2, 1.5]];
    let x = [1.0, -2.0, 0.5];
    for i in 0..3 {
        for j in 0..3 {
            m[i][j] = a[i][j];
            m[i][BIASES] += a[i][j] * x[j];
        }
    }
    let log_det = solve_in_place(&mut m, 3).expect("positive");
    let wanted = nalgebra::Matrix3::from_fn(|i, j| a[i][j]).determinant();
    assert!((log_det - wanted.ln()).abs() < 1e-12);
    for (row, wanted) in m.iter().zip(x) {
        assert!((row[BIASES] - wanted).abs() < 1e-12);
    }
}

#[test]
fn six_lengths_without_imus_accuse_nobody() {
    let mut filter = fed(&[(2, 10e-3)], 50);
    let mut faults = Faults::default();
    let channels: Vec<Channel> = (0..LEGS).map(Channel::Spring).collect();
    for _ in 0..20 {
        faults.judge(0, 0.1, &channels, &mut filter);
    }
    let verdict = faults.verdict(0);
    assert!(verdict.springs.iter().all(|p| *p < 0.01), "{verdict:?}");
    assert!(!verdict.is_suspect);
}

#[test]
fn a_jump_is_named_at_once_and_cleared_when_it_is_undone() {
    let mut filter = fed(&[], 200);
    let mut faults = Faults::default();
    let spring = Channel::Spring(4);
    filter.jump(spring);
    let off = |filter: &mut Filter, off_m: f64, frames: usize| {
        for _ in 0..frames {
            filter.predict(0.01);
            let value_m = filter.length(4).0 + off_m;
            let mut readings: Vec<Reading> = (0..SPRINGS)
                .map(|spring| Reading::Length {
                    spring,
                    value_m: filter.length(spring).0,
                    variance: 1e-8,
                })
                .collect();
            readings[4] = Reading::Length {
                spring: 4,
                value_m,
                variance: 1e-8,
            };
            filter.take_all(&readings);
        }
    };
    off(&mut filter, 4e-3, 20);
    let channels: Vec<Channel> = (0..LEGS).map(Channel::Spring).collect();
    faults.judge(0, 0.1, &channels, &mut filter);
    assert!(faults.is_named(0, spring), "{:?}", faults.verdict(0));
    let others = (0..LEGS).filter(|i| *i != 4).map(Channel::Spring);
    assert!(others.into_iter().all(|c| !faults.is_named(0, c)));
}
