//! A small convex quadratic programme in a box: min ½ xᵀHx + gᵀx, lo ≤ x ≤ hi, six variables.
//!
//! Projected Newton: the variables that sit on a bound and want to leave through it are frozen, the
//! others take a Newton step, the step is shortened along the projection until the cost falls.
//! Source: D. Bertsekas, SIAM J. Control Optim. 20(2), 1982, doi:10.1137/0320018.

use crate::signal::{Matrix6, Vector6};

/// The solution with its diagnostics.
#[derive(Clone, Debug, PartialEq)]
pub struct BoxQp {
    /// The minimiser.
    pub x: Vector6,
    /// Newton steps taken.
    pub iterations: usize,
    /// Whether the optimality conditions hold.
    pub converged: bool,
}

const MAX_ITERATIONS: usize = 40;

/// Solves min ½ xᵀHx + gᵀx with lo ≤ x ≤ hi. `h` must be symmetric and positive definite.
pub fn solve_box_qp(h: &Matrix6, g: &Vector6, lo: &Vector6, hi: &Vector6) -> BoxQp {
    let project = |x: &Vector6| x.zip_zip_map(lo, hi, |x, lo, hi| x.max(lo).min(hi));
    let cost = |x: &Vector6| 0.5 * x.dot(&(h * x)) + g.dot(x);
    let mut out = BoxQp {
        x: project(&Vector6::zeros()),
        iterations: 0,
        converged: false,
    };
    let scale = g.amax().max(f64::MIN_POSITIVE);
    while out.iterations < MAX_ITERATIONS {
        let gradient = h * out.x + g;
        let free: [bool; 6] = std::array::from_fn(|i| {
            !(out.x[i] <= lo[i] && gradient[i] >= 0.0 || out.x[i] >= hi[i] && gradient[i] <= 0.0)
        });
        let open = Vector6::from_fn(|i, _| if free[i] { gradient[i] } else { 0.0 });
        if open.amax() <= 1e-9 * scale {
            out.converged = true;
            break;
        }
        let Some(step) = solve_free(h, &-open, &free) else {
            break;
        };
        let before = cost(&out.x);
        let mut t = 1.0;
        let mut next = project(&(out.x + step));
        while cost(&next) > before && t > 1e-6 {
            t *= 0.5;
            next = project(&(out.x + step * t));
        }
        out.iterations += 1;
        if (next - out.x).amax() == 0.0 {
            break;
        }
        out.x = next;
    }
    out
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
}
