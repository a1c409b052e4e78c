//! A small convex quadratic programme in a box: min ½ xᵀHx + gᵀx, lo ≤ x ≤ hi, six variables.
//!
//! Active-set method. Free variables go to the minimum over them; where that lies outside of the box they go as far as
//! the first bound, and the variable that meets it is held there. At the minimum over the free variables the held one
//! whose release promises most, ∇ᵢ²/2Hᵢᵢ, is set free, until none is pushed inwards. The cost falls with every set of
//! held variables that is completed, so none comes twice and the method ends; a line search over a projected step,
//! which may creep along a bound for ever, is not needed.
//! Source: P. B. Stark, R. L. Parker, "Bounded-variable least-squares", Computational Statistics 10(2), 1995; J. Nocedal,
//! S. Wright, "Numerical Optimization", 2nd ed., section 16.5.

use crate::signal::{Matrix6, Vector6};

/// The solution with its diagnostics.
#[derive(Clone, Debug, PartialEq)]
pub struct BoxQp {
    /// The minimiser; within the bounds also where the iteration did not converge.
    pub x: Vector6,
    /// Newton steps taken.
    pub iterations: usize,
    /// Whether the optimality conditions hold.
    pub converged: bool,
}

const MAX_ITERATIONS: usize = 64;
/// Optimality conditions hold within this share of the terms that they are made of.
const TOLERANCE: f64 = 1e-10;

/// Solves min ½ xᵀHx + gᵀx with lo ≤ x ≤ hi. `h` must be symmetric and positive definite; where it is not, or where a
/// number is not finite, the result is marked as not converged.
pub fn solve_box_qp(h: &Matrix6, g: &Vector6, lo: &Vector6, hi: &Vector6) -> BoxQp {
    let mut out = BoxQp {
        x: Vector6::zeros().zip_zip_map(lo, hi, |x, lo, hi| x.max(lo).min(hi)),
        iterations: 0,
        converged: false,
    };
    if !(h.iter().chain(g.iter()).chain(out.x.iter())).all(|v| v.is_finite()) {
        return out;
    }
    let gradient = h * out.x + g;
    let inside = |x: f64, i: usize| lo[i] < x && x < hi[i];
    let mut free: [bool; 6] = std::array::from_fn(|i| {
        inside(out.x[i], i) || pushed_in(&out.x, &gradient, lo, hi, i, 0.0)
    });
    while out.iterations < MAX_ITERATIONS {
        out.iterations += 1;
        let gradient = h * out.x + g;
        let Some(step) = solve_free(h, &-gradient, &free) else {
            return out;
        };
        if let Some((i, share)) = first_bound(&out.x, &step, lo, hi, &free) {
            out.x += step * share;
            out.x[i] = if step[i] > 0.0 { hi[i] } else { lo[i] };
            free[i] = false;
            continue;
        }
        out.x += step;
        let gradient = h * out.x + g;
        let size = h.abs() * out.x.abs() + g.abs();
        let promise = |i: &usize| gradient[*i] * gradient[*i] / h[(*i, *i)];
        let released = (0..6)
            .filter(|i| !free[*i])
            .filter(|i| pushed_in(&out.x, &gradient, lo, hi, *i, TOLERANCE * size[*i]))
            .max_by(|a, b| promise(a).total_cmp(&promise(b)));
        match released {
            Some(i) => free[i] = true,
            None => {
                out.converged = true;
                return out;
            }
        }
    }
    out
}

/// Whether a variable rests on a bound and the gradient pushes it inwards by more than `most`.
fn pushed_in(
    x: &Vector6,
    gradient: &Vector6,
    lo: &Vector6,
    hi: &Vector6,
    i: usize,
    most: f64,
) -> bool {
    lo[i] < hi[i] && (x[i] <= lo[i] && gradient[i] < -most || x[i] >= hi[i] && gradient[i] > most)
}

/// The free variable that meets its bound first along `step`, and after which share of it; `None` when the whole step
/// stays in the box.
fn first_bound(
    x: &Vector6,
    step: &Vector6,
    lo: &Vector6,
    hi: &Vector6,
    free: &[bool; 6],
) -> Option<(usize, f64)> {
    let leaves = |i: &usize| {
        let to = x[*i] + step[*i];
        free[*i] && !(lo[*i]..=hi[*i]).contains(&to)
    };
    let share = |i: usize| {
        let bound = if step[i] > 0.0 { hi[i] } else { lo[i] };
        ((bound - x[i]) / step[i]).clamp(0.0, 1.0)
    };
    (0..6)
        .filter(leaves)
        .map(|i| (i, share(i)))
        .min_by(|a, b| a.1.total_cmp(&b.1))
}

/// Solves H_ff x_f = b_f over the free variables; the others stay zero. `None` if H is not positive
/// definite there.
pub(super) fn solve_free(h: &Matrix6, b: &Vector6, free: &[bool; 6]) -> Option<Vector6> {
    let m = Matrix6::from_fn(|i, j| match (free[i] && free[j], i == j) {
        (true, _) => h[(i, j)],
        (false, true) => 1.0,
        (false, false) => 0.0,
    });
    let b = Vector6::from_fn(|i, _| if free[i] { b[i] } else { 0.0 });
    Some(m.cholesky()?.solve(&b))
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{Rng, SeedableRng};
    use rand_pcg::Pcg64;

    #[test]
    fn agrees_with_trying_every_set_of_active_bounds() {
        let mut rng = Pcg64::seed_from_u64(3);
        for case in 0..50 {
            let a = Matrix6::from_fn(|_, _| rng.random_range(-1.0..1.0));
            let h = a.transpose() * a + Matrix6::identity() * 1e-2;
            let g = Vector6::from_fn(|_, _| rng.random_range(-3.0..3.0));
            let lo = Vector6::from_fn(|_, _| rng.random_range(-1.0..0.2));
            let hi = lo + Vector6::from_fn(|_, _| rng.random_range(0.0..1.5));
            let cost = |x: &Vector6| 0.5 * x.dot(&(h * x)) + g.dot(x);
            let mut best = f64::INFINITY;
            for code in 0..729 {
                // Each variable: free, at its lower or at its upper bound.
                let state: [usize; 6] = std::array::from_fn(|i| code / 3usize.pow(i as u32) % 3);
                let fixed = Vector6::from_fn(|i, _| match state[i] {
                    1 => lo[i],
                    2 => hi[i],
                    _ => 0.0,
                });
                let free = state.map(|s| s == 0);
                let x = fixed + solve_free(&h, &-(g + h * fixed), &free).unwrap();
                let inside = (0..6).all(|i| x[i] >= lo[i] - 1e-9 && x[i] <= hi[i] + 1e-9);
                if inside {
                    best = best.min(cost(&x));
                }
            }
            let out = solve_box_qp(&h, &g, &lo, &hi);
            assert!(out.converged, "case {case}: {out:?}");
            assert!(
                (0..6).all(|i| out.x[i] >= lo[i] && out.x[i] <= hi[i]),
                "case {case}"
            );
            assert!((cost(&out.x) - best).abs() < 1e-7, "case {case}");
        }
    }

    /// A valley along which the cost falls by 10¹⁰ less than across it.
    fn valley() -> (Matrix6, [Vector6; 3]) {
        #[rustfmt::skip]
        let h = Matrix6::from_row_slice(&[
            1.34902063168e-2, 3.19612891863e-2, 6.54767377038e-2, 2.18798085019e-3, 5.82717345713e-2, -5.66104623140e-2,
            3.19612891863e-2, 9.55734770387e-2, 1.78373444957e-1, 1.00605741819e-2, 1.55328800305e-1, -1.65568540253e-1,
            6.54767377038e-2, 1.78373444957e-1, 3.45113198838e-1, 1.62772619022e-2, 3.03157272270e-1, -3.11494157823e-1,
            2.18798085019e-3, 1.00605741819e-2, 1.62772619022e-2, 1.58581496430e-3, 1.36345320725e-2, -1.69680606944e-2,
            5.82717345713e-2, 1.55328800305e-1, 3.03157272270e-1, 1.36345320725e-2, 2.66848892247e-1, -2.71782930426e-1,
            -5.66104623140e-2, -1.65568540253e-1, -3.11494157823e-1, -1.69680606944e-2, -2.71782930426e-1, 2.87489420695e-1,
        ]);
        let g = [
            0.0978836, -0.0855459, 0.145933, 0.811886, 0.0528422, 0.138666,
        ];
        let lo = [
            -0.0275643, -0.583547, -0.425097, -0.174449, -0.743919, -0.968369,
        ];
        let hi = [0.309205, 0.567074, 0.957261, 0.664270, 0.366726, 0.448533];
        (h, [g, lo, hi].map(Vector6::from))
    }

    /// A step that is projected onto the box and shortened until the cost falls creeps along a bound here: after 40
    /// steps it is at a cost of -0.28, the least is -0.42.
    #[test]
    fn a_narrow_valley_across_the_box_is_followed_to_its_end() {
        let (h, [g0, lo, hi]) = valley();
        let mut rng = Pcg64::seed_from_u64(17);
        for case in 0..200 {
            let g = g0.map(|g| g * rng.random_range(0.95..1.05));
            let out = solve_box_qp(&h, &g, &lo, &hi);
            assert!(out.converged, "case {case}: {out:?}");
            let gradient = h * out.x + g;
            for i in 0..6 {
                let at = (out.x[i] <= lo[i], out.x[i] >= hi[i]);
                let optimal = match at {
                    (true, _) => gradient[i] > -1e-9,
                    (_, true) => gradient[i] < 1e-9,
                    _ => gradient[i].abs() < 1e-9,
                };
                assert!(optimal, "case {case}, variable {i}: {out:?} {gradient:?}");
            }
        }
    }

    #[test]
    fn the_units_of_the_variables_change_nothing() {
        let (h, [g, lo, hi]) = valley();
        let plain = solve_box_qp(&h, &g, &lo, &hi);
        let unit = Vector6::from([1e-4, 1e4, 1.0, 1e-2, 1e3, 1e-3]);
        let scaled = Matrix6::from_fn(|i, j| h[(i, j)] * unit[i] * unit[j]);
        let per = |v: &Vector6| v.component_div(&unit);
        let out = solve_box_qp(&scaled, &g.component_mul(&unit), &per(&lo), &per(&hi));
        assert!(out.converged);
        assert!((out.x.component_mul(&unit) - plain.x).amax() < 1e-6);
    }

    #[test]
    fn what_has_no_minimum_says_so_and_stays_in_the_box() {
        let (h, [g, lo, hi]) = valley();
        let not_finite = Vector6::repeat(f64::NAN);
        for (h, g) in [(-h, g), (h, not_finite), (h * f64::INFINITY, g)] {
            let out = solve_box_qp(&h, &g, &lo, &hi);
            assert!(!out.converged, "{out:?}");
            assert!((0..6).all(|i| out.x[i] >= lo[i] && out.x[i] <= hi[i]));
        }
        // Nothing to do, and a box without room.
        let still = solve_box_qp(&h, &Vector6::zeros(), &lo, &hi);
        assert!(still.converged && still.x == Vector6::zeros());
        let fixed = solve_box_qp(&h, &g, &hi, &hi);
        assert!(fixed.converged && fixed.x == hi);
    }
}
