//! The statistics on problems whose answers are known in closed form: linear in their parameters, with Gaussian noise.

use nalgebra::{DMatrix, DVector};
use rand::SeedableRng as _;
use rand_pcg::Pcg64Mcg;

use super::candidates::Candidate;
use super::commission::between;
use super::config::CONFIG;
use super::describe::described;
use super::explain::{Column, Explained, score, significance_threshold, weak_prior};
use super::fit::fit;
use super::noise::Noise;
use super::nuisance::Nuisance;
use super::problem::{Problem, block_edges};
use super::replay::{CalibrationParameter, Row, calibration_parameters};
use super::session::CHANNELS;
use crate::sim::dataset::normal;
use crate::sim::effects::{
    Active, Effect, Law, Operator, Parameter, Reach, Residual, Side, Start, Target,
};

/// Two numbers without a law of their own: what they do is in the problem.
static LINEAR: Effect = Effect {
    id: "linear",
    name: "Linear",
    doc: "r = r₀ − J α",
    source: "definition",
    side: Side::Mechanics,
    target: Target::None,
    parameters: &[
        Parameter::new("a", "", 0.0, [-50.0, 50.0])
            .scale(10.0)
            .of_departure(0.0),
        Parameter::new("b", "", 0.0, [-50.0, 50.0])
            .scale(10.0)
            .of_departure(0.0),
    ],
    residuals: &[Residual::R2],
    operator: Operator::Mechanics(|_, _| {}),
    behind_gauge: None,
    also_read: None,
    also_moves: None,
    reach: Reach::Common,
    law: Law::Definition,
    gradual: true,
    memory: None,
    starts: |_, _| vec![Start::new(&[1.0, 1.0], &[0, 1])],
};

const CANDIDATE: Candidate = Candidate {
    effect: &LINEAR,
    target: None,
};

const BINS: usize = 120;
const PER_BIN: usize = 4;
const ROWS: usize = BINS * PER_BIN;

fn noise(n: usize, rng: &mut Pcg64Mcg) -> DVector<f64> {
    DVector::from_fn(n, |_, _| normal(rng))
}

fn matrix(rows: usize, columns: usize, seed: u64) -> DMatrix<f64> {
    let mut rng = Pcg64Mcg::seed_from_u64(seed);
    DMatrix::from_fn(rows, columns, |_, _| normal(&mut rng))
}

/// Nuisance columns and the precision of their prior.
fn nuisance() -> (DMatrix<f64>, DMatrix<f64>) {
    let lambda = DMatrix::from_diagonal(&DVector::from_vec(vec![0.5, 2.0, 8.0]));
    (matrix(ROWS, 3, 11), lambda)
}

/// Columns of the two numbers.
fn columns() -> DMatrix<f64> {
    matrix(ROWS, 2, 12)
}

/// r₀ − J α with the nuisance above.
fn problem(r0: DVector<f64>, j: DMatrix<f64>) -> Problem<'static> {
    let (n, lambda) = nuisance();
    let evaluate = move |effects: &[Active]| {
        let alpha = effects
            .first()
            .map_or(DVector::zeros(2), |a| DVector::from_column_slice(&a.values));
        Ok(&r0 - &j * alpha)
    };
    let nuisance = Nuisance::new(&n, &[], [0, PER_BIN]);
    let edges = block_edges(BINS, PER_BIN);
    Problem::new(Box::new(evaluate), nuisance, &lambda, &edges, PER_BIN).expect("regular")
}

/// M = I − N (NᵀN + Λ)⁻¹ Nᵀ.
fn projection(n: &DMatrix<f64>, lambda: &DMatrix<f64>) -> DMatrix<f64> {
    let inverse = (n.tr_mul(n) + lambda).try_inverse().expect("regular");
    DMatrix::identity(n.nrows(), n.nrows()) - n * inverse * n.transpose()
}

#[test]
fn the_nuisance_is_projected_out_as_by_the_formula() {
    let (n, lambda) = nuisance();
    let m = projection(&n, &lambda);
    let p = problem(DVector::zeros(ROWS), columns());
    let (a, b) = (matrix(ROWS, 2, 1), matrix(ROWS, 3, 2));
    assert!((p.product(&a, &b) - a.transpose() * &m * &b).amax() < 1e-9);
    assert!((p.cleaned(&b) - &m * &b).amax() < 1e-9);
}

/// Columns that are zero before a stretch begins, each by the formula.
#[test]
fn columns_that_begin_later_are_projected_by_the_formula() {
    let (n, lambda) = nuisance();
    let m = projection(&n, &lambda);
    let (r, j) = (matrix(ROWS, 1, 6), columns());
    let p = problem(r.column(0).into(), j.clone());
    let clean = p.cleaned(&r);
    let edges = p.edges();
    let begun = p.begun_by_stretch(&j, &clean, edges);
    assert_eq!(begun.len(), edges.len() - 1);
    for ((gram, right), first) in begun.iter().zip(edges) {
        let mut later = j.clone();
        later.rows_mut(0, *first).fill(0.0);
        assert!((gram - later.transpose() * &m * &later).amax() < 1e-9);
        assert!((right - later.transpose() * &m * &r).amax() < 1e-9);
    }
}

/// Each held-out block's loss against nuisance and columns fitted to the other folds by the normal equations in full.
#[test]
fn what_folds_leave_is_a_fit_to_the_other_blocks() {
    let (n, lambda) = nuisance();
    let (r, j) = (matrix(ROWS, 1, 3), columns());
    let weak = DVector::from_vec(vec![0.1, 0.2]);
    let p = problem(r.column(0).into(), j.clone()).with_prior();
    let losses = p.held_out(&r.column(0).into(), &j, &weak);
    let edges = block_edges(BINS, PER_BIN);
    let blocks = edges.len() - 1;
    let both = DMatrix::from_fn(
        ROWS,
        5,
        |k, i| if i < 3 { n[(k, i)] } else { j[(k, i - 3)] },
    );
    let mut prior = DMatrix::zeros(5, 5);
    prior.view_mut((0, 0), (3, 3)).copy_from(&lambda);
    prior[(3, 3)] = weak[0];
    prior[(4, 4)] = weak[1];
    for block in 0..blocks {
        let rows = |b: usize| edges[b]..edges[b + 1];
        let training: Vec<usize> = (0..blocks)
            .filter(|b| b % CONFIG.folds != block % CONFIG.folds)
            .flat_map(rows)
            .collect();
        let (x, y) = (both.select_rows(&training), r.select_rows(&training));
        let fitted = (x.tr_mul(&x) + &prior).try_inverse().expect("regular") * x.tr_mul(&y);
        let held: Vec<usize> = rows(block).collect();
        let left = r.select_rows(&held) - both.select_rows(&held) * &fitted;
        let d = fitted.rows(0, 3).into_owned();
        let wanted =
            0.5 * (left.norm_squared() + (d.transpose() * &lambda * &d)[(0, 0)] / blocks as f64);
        assert!((losses.0[block] - wanted).abs() < 1e-8, "{block}");
    }
}

/// A part of a problem is the problem of those rows.
#[test]
fn a_part_contains_nothing_of_the_rest() {
    let (n, lambda) = nuisance();
    let r: DVector<f64> = matrix(ROWS, 1, 4).column(0).into();
    let whole = problem(r.clone(), columns());
    let blocks = [10..30, 30..55, 80..110];
    let part = whole.part(&blocks).expect("regular");
    let bins: Vec<usize> = blocks.iter().cloned().flatten().collect();
    let rows: Vec<usize> = bins
        .iter()
        .flat_map(|b| b * PER_BIN..(b + 1) * PER_BIN)
        .collect();
    let m = projection(&n.select_rows(&rows), &lambda);
    let here = part.residual(&[]).expect("linear");
    assert_eq!(here, r.select_rows(&rows));
    let x = DMatrix::from_column_slice(here.len(), 1, here.as_slice());
    assert!((part.product(&x, &x) - x.transpose() * m * &x).amax() < 1e-9);
    // What is outside changes nothing.
    let mut other = r;
    other.rows_mut(0, 10 * PER_BIN).fill(1e6);
    let changed = problem(other, columns());
    let changed = changed.part(&blocks).expect("regular");
    assert_eq!(changed.residual(&[]).expect("linear"), here);
}

/// A⁻¹ (Σ_b s_b s_bᵀ) A⁻¹ B/(B − 1), s_b = J_bᵀ r_b behind the nuisance.
#[test]
fn the_sandwich_is_that_of_the_blocks() {
    let (n, lambda) = nuisance();
    let m = projection(&n, &lambda);
    let (r, j) = (matrix(ROWS, 1, 5), columns());
    let p = problem(r.column(0).into(), j.clone());
    let weak = DVector::from_vec(vec![0.3, 0.1]);
    let (cj, cr) = (&m * &j, &m * &r);
    let a = j.tr_mul(&cj) + DMatrix::from_diagonal(&weak);
    let edges = block_edges(BINS, PER_BIN);
    let mut meat = DMatrix::zeros(2, 2);
    for w in edges.windows(2) {
        let s = cj
            .rows(w[0], w[1] - w[0])
            .tr_mul(&cr.rows(w[0], w[1] - w[0]));
        meat += &s * s.transpose();
    }
    let inverse = a.try_inverse().expect("regular");
    let blocks = (edges.len() - 1) as f64;
    let wanted = (&inverse * meat * &inverse).diagonal() * (blocks / (blocks - 1.0));
    let got = p.sandwich(&r.column(0).into(), &j, &weak);
    assert!((got - &wanted).amax() < 1e-6 * wanted.amax());
}

/// The minimum of a quadratic, free and against a bound.
#[test]
fn a_linear_problem_is_fitted_to_its_minimum_and_to_its_bound() {
    let (n, lambda) = nuisance();
    let m = projection(&n, &lambda);
    let j = columns();
    let mut rng = Pcg64Mcg::seed_from_u64(6);
    for truth in [[3.0, -7.0], [80.0, 5.0]] {
        let r0 = &j * DVector::from_column_slice(&truth) + noise(ROWS, &mut rng);
        let start = vec![(CANDIDATE, vec![0.5, 0.5])];
        let found = fit(&problem(r0.clone(), j.clone()), start, 30).expect("linear");
        let alpha = found.parameters();
        let (cj, cr) = (&m * &j, &m * &r0);
        let free = j.tr_mul(&cj).try_inverse().expect("regular") * j.tr_mul(&cr);
        if free[0] < 50.0 {
            assert!((alpha[0] - free[0]).abs() < 1e-3 && (alpha[1] - free[1]).abs() < 1e-3);
            assert_eq!(found.on_bound, [false, false]);
        } else {
            // With a at its bound, b = J_bᵀ M (r₀ − 50 J_a)/J_bᵀ M J_b.
            let rest = &cr - cj.column(0) * 50.0;
            let b = j.column(1).dot(&rest) / j.column(1).dot(&cj.column(1));
            assert_eq!(alpha[0], 50.0);
            assert!((alpha[1] - b).abs() < 1e-3, "{} {b}", alpha[1]);
            assert_eq!(found.on_bound, [true, false]);
        }
    }
}

/// Residuals with a known covariance and autocorrelation become white and of unit variance.
#[test]
fn innovations_of_a_known_process_are_white() {
    let mut rng = Pcg64Mcg::seed_from_u64(7);
    let (phi, n) = (0.8, 20_000);
    let mut present = [false; CHANNELS];
    present[..3].fill(true);
    let mut z = [0.0; 3];
    let rows: Vec<Row> = (0..n)
        .map(|_| {
            for x in &mut z {
                *x = phi * *x + normal(&mut rng);
            }
            let mut row = [0.0; CHANNELS];
            // Mixed, and of different sizes.
            row[0] = 2e-3 * z[0];
            row[1] = 1e-3 * (z[0] + z[1]);
            row[2] = 5e-3 * (z[2] - 0.3 * z[1]);
            row
        })
        .collect();
    let w = Noise::from_healthy(&rows, &present).innovations(&rows);
    let judged = w.columns(100, n - 100);
    for i in 0..3 {
        let row = judged.row(i);
        let variance = row.iter().map(|x| x * x).sum::<f64>() / row.len() as f64;
        assert!((variance - 1.0).abs() < 0.03, "{variance}");
        let next: f64 = (1..row.len()).map(|k| row[k] * row[k - 1]).sum();
        assert!((next / row.len() as f64).abs() < 0.03, "{next}");
    }
}

/// Intervals hold the truth in 95 % of 2,000 draws, within 2 points.
#[test]
fn intervals_cover_as_often_as_they_state() {
    let j = columns();
    let (n, lambda) = nuisance();
    let truth = [2.0, -1.0];
    let prior = lambda.clone().cholesky().expect("positive");
    let mut rng = Pcg64Mcg::seed_from_u64(8);
    let (mut held, mut all) = (0u32, 0u32);
    for _ in 0..2000 {
        let delta = prior
            .l()
            .tr_solve_lower_triangular(&noise(3, &mut rng))
            .expect("regular");
        let r0 = &j * DVector::from_column_slice(&truth) + &n * delta + noise(ROWS, &mut rng);
        let p = problem(r0, j.clone());
        let start = vec![(CANDIDATE, vec![0.5, 0.5])];
        let fit = fit(&p, start, 10).expect("linear");
        let losses = p.held_out(&fit.residual, &fit.columns, &weak_prior(&fit));
        let e = Explained {
            candidate: CANDIDATE,
            fit,
            losses,
            gain: 0.0,
            se: 0.0,
            firm: true,
        };
        for found in described(&p, &e) {
            for (name, t) in ["a", "b"].into_iter().zip(truth) {
                let [low, high] = found.params[name].ci95.expect("an interval");
                held += u32::from((low..=high).contains(&t));
                all += 1;
            }
        }
    }
    let covered = f64::from(held) / f64::from(all);
    println!("{:.1} % of the intervals hold the truth", 100.0 * covered);
    assert!((0.93..=0.97).contains(&covered), "{covered}");
}

/// Of 2,000 sessions without any effect 5 % exceed the threshold, within 1.5 points.
#[test]
fn the_threshold_is_exceeded_as_often_as_it_states() {
    let bins = 600;
    let (n, count) = (bins * PER_BIN, 12);
    let lambda = DMatrix::identity(2, 2);
    let nuisance = Nuisance::new(&matrix(n, 2, 21), &[], [0, PER_BIN]);
    let edges = block_edges(bins, PER_BIN);
    let p = Problem::new(
        Box::new(move |_| Ok(DVector::zeros(n))),
        nuisance,
        &lambda,
        &edges,
        PER_BIN,
    )
    .expect("regular");
    let ready: Vec<Column> = (0..count)
        .map(|c| {
            let columns = matrix(n, 1 + c % 2, 30 + c as u64);
            let cleaned = p.cleaned(&columns);
            Column {
                candidate: c,
                start: Start::new(&[1.0], &[0]),
                gram: columns.tr_mul(&cleaned),
                cleaned,
                begun: Vec::new(),
            }
        })
        .collect();
    let mut rng = Pcg64Mcg::seed_from_u64(9);
    let mut exceeds = 0u32;
    // One session determines its threshold to a few points; on average over sessions it is right.
    for _ in 0..20 {
        let healthy = DMatrix::from_fn(PER_BIN, bins, |_, _| normal(&mut rng));
        let threshold = significance_threshold(&p, &ready, &healthy, &mut rng, CONFIG.draws);
        for _ in 0..100 {
            let mut r = noise(n, &mut rng);
            r.rows_mut(0, super::noise::start() * PER_BIN).fill(0.0);
            let exceeded = ready.iter().any(|c| {
                let b: DVector<f64> = c.cleaned.tr_mul(&r);
                score(&c.gram, &b).0 > threshold
            });
            exceeds += u32::from(exceeded);
        }
    }
    let rate = f64::from(exceeds) / 2000.0;
    println!(
        "{:.1} % of the sessions without an effect exceed the threshold",
        100.0 * rate
    );
    assert!((0.035..=0.065).contains(&rate), "{rate}");
}

/// What sessions show of their spread counts for all parameters of a kind, in units of their priors; of the others little is
/// assumed, and no spread is smaller.
#[test]
fn the_spread_from_session_to_session_is_that_of_the_kind() {
    let parameters = calibration_parameters();
    let square = |i: usize| match parameters[i] {
        CalibrationParameter::Drift(k) => Some(2e-8 * (k + 1) as f64),
        CalibrationParameter::Clock => Some(-1.0),
        _ => None,
    };
    for (k, found) in parameters.iter().zip(between(&parameters, square).iter()) {
        let wanted = match k {
            CalibrationParameter::Drift(_) => 2e-8 * (1.0 + 2.0 + 3.0 + 4.0) / 4.0,
            CalibrationParameter::Mounting(_, 2) => CONFIG.heading_walk_rad.powi(2),
            _ => (0.01 * k.prior()).powi(2),
        };
        assert!((found / wanted - 1.0).abs() < 1e-9, "{k:?} {found:.3e}");
    }
}
