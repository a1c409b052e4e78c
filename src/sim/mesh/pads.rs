//! The two moving pads as rigid bodies: the global step's exact condensation.
//!
//! Once the interior nodes are eliminated the columns act on the pads' affine coordinates a (origin
//! and images of x, y, z) by a constant matrix S and a force r. The pads then minimise
//!
//! ½⟨a − a₀, S (a − a₀)⟩ − ⟨r, a − a₀⟩ + Σ ½ k (d − d₀)₊² − Σ f·x
//!
//! over rigid motions alone: twelve unknowns, solved by Newton's method with the exact Hessian. The
//! tension springs and the weights that hang below the pads are therefore never linearised.

use nalgebra::{Matrix3, Rotation3, SMatrix, SVector, Vector3};

use super::column::Affine;
use crate::sim::rod::se3::Frame;

/// A force of constant direction on a pad.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Dead {
    /// Which pad.
    pub pad: usize,
    /// Where, in the pad's frame, m.
    pub at_m: Vector3<f64>,
    /// The force in the base frame, N.
    pub force_n: Vector3<f64>,
}

/// A tension spring; its upper end is in the base frame when `upper` names no pad.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Spring {
    /// Pad of the upper end.
    pub upper: Option<usize>,
    /// Pad of the lower end.
    pub lower: usize,
    /// Upper end in its frame, m.
    pub upper_m: Vector3<f64>,
    /// Lower end in its pad's frame, m.
    pub lower_m: Vector3<f64>,
    /// Rate, N/m.
    pub rate_n_m: f64,
    /// Free length, m; slack below.
    pub free_m: f64,
}

/// Loads on the pads besides the columns.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Acting {
    pub springs: Vec<Spring>,
    pub dead: Vec<Dead>,
}

type Vec12 = SVector<f64, 12>;
type Mat12 = SMatrix<f64, 12, 12>;

/// Affine coordinates of two rigid frames.
pub(super) fn affine(pads: &[Frame; 2]) -> Affine {
    let mut a = Affine::zeros();
    for (p, f) in pads.iter().enumerate() {
        a.set_row(4 * p, &f.p.transpose());
        for k in 0..3 {
            a.set_row(4 * p + 1 + k, &f.r.column(k).transpose());
        }
    }
    a
}

/// Energy of springs and dead forces, J.
pub(super) fn energy_j(acting: &Acting, pads: &[Frame; 2]) -> f64 {
    let dead: f64 = acting
        .dead
        .iter()
        .map(|d| -d.force_n.dot(&pads[d.pad].point(&d.at_m)))
        .sum();
    let springs: f64 = acting
        .springs
        .iter()
        .map(|s| 0.5 * s.rate_n_m * stretch(s, pads).1.powi(2))
        .sum();
    dead + springs
}

/// From the upper to the lower end, and the elongation, m.
fn stretch(s: &Spring, pads: &[Frame; 2]) -> (Vector3<f64>, f64) {
    let top = s.upper.map_or(s.upper_m, |p| pads[p].point(&s.upper_m));
    let d = pads[s.lower].point(&s.lower_m) - top;
    (d, (d.norm() - s.free_m).max(0.0))
}

/// Jacobian of a point's motion by (δc, δθ) of a pad: [1, −(A x)×].
fn add_point(j: &mut SMatrix<f64, 3, 12>, sign: f64, pad: usize, arm: &Vector3<f64>) {
    let mut c = j.fixed_view_mut::<3, 3>(0, 6 * pad);
    c += Matrix3::identity() * sign;
    let mut t = j.fixed_view_mut::<3, 3>(0, 6 * pad + 3);
    t -= arm.cross_matrix() * sign;
}

/// ∂/∂(δc, δθ) and second derivatives of everything, at `pads`.
fn derivatives(
    s: &SMatrix<f64, 8, 8>,
    pull: &Affine,
    from: &Affine,
    acting: &Acting,
    pads: &[Frame; 2],
) -> (Vec12, Mat12) {
    let a = affine(pads);
    let mut g = s * (a - from) - pull;
    let mut h = Mat12::zeros();
    let add = |g: &mut Affine, pad: usize, at: &Vector3<f64>, f: &Vector3<f64>| {
        let weights = [1.0, at.x, at.y, at.z];
        for (m, w) in weights.iter().enumerate() {
            for k in 0..3 {
                g[(4 * pad + m, k)] += w * f[k];
            }
        }
    };
    for d in &acting.dead {
        add(&mut g, d.pad, &d.at_m, &-d.force_n);
    }
    for sp in &acting.springs {
        let (d, x) = stretch(sp, pads);
        if x <= 0.0 {
            continue;
        }
        let length = d.norm();
        let u = d / length;
        let f = u * (sp.rate_n_m * x);
        let along = u * u.transpose();
        let k = (along + (Matrix3::identity() - along) * (x / length)) * sp.rate_n_m;
        let mut j = SMatrix::<f64, 3, 12>::zeros();
        add_point(&mut j, 1.0, sp.lower, &(pads[sp.lower].r * sp.lower_m));
        add(&mut g, sp.lower, &sp.lower_m, &f);
        if let Some(p) = sp.upper {
            add_point(&mut j, -1.0, p, &(pads[p].r * sp.upper_m));
            add(&mut g, p, &sp.upper_m, &-f);
        }
        h += j.transpose() * k * j;
    }
    let row = |m: &Affine, i: usize| Vector3::new(m[(i, 0)], m[(i, 1)], m[(i, 2)]);
    // Motion of the affine rows: origin with δc, the images of the axes with δθ × image.
    let jac: [SMatrix<f64, 3, 12>; 8] = std::array::from_fn(|i| {
        let mut j = SMatrix::<f64, 3, 12>::zeros();
        if i % 4 == 0 {
            j.fixed_view_mut::<3, 3>(0, 6 * (i / 4))
                .copy_from(&Matrix3::identity());
        } else {
            j.fixed_view_mut::<3, 3>(0, 6 * (i / 4) + 3)
                .copy_from(&-row(&a, i).cross_matrix());
        }
        j
    });
    let mut gradient = Vec12::zeros();
    for i in 0..8 {
        gradient += jac[i].transpose() * row(&g, i);
        let mut sj = SMatrix::<f64, 3, 12>::zeros();
        for k in 0..8 {
            sj += jac[k] * s[(i, k)];
        }
        h += jac[i].transpose() * sj;
    }
    // δ²(A) = δθ × (δθ × A): adds sym N − tr N, N = A Gᵀ.
    for p in 0..2 {
        let mut n = Matrix3::zeros();
        for i in 4 * p + 1..4 * p + 4 {
            n += row(&a, i) * row(&g, i).transpose();
        }
        let mut block = h.fixed_view_mut::<3, 3>(6 * p + 3, 6 * p + 3);
        block += (n + n.transpose()) * 0.5 - Matrix3::identity() * n.trace();
    }
    (gradient, h)
}

/// Result of the pads' step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Moved {
    /// Their new frames.
    pub pads: [Frame; 2],
    /// Out-of-balance force and moment (over 0.1 m) at the start, root of squares, N.
    pub residual_n: f64,
}

/// Minimises over rigid motions, starting at `pads`, whose affine coordinates are a₀.
pub(super) fn settle(
    s: &SMatrix<f64, 8, 8>,
    pull: &Affine,
    acting: &Acting,
    pads: &[Frame; 2],
) -> Moved {
    const ARM_M: f64 = 0.1;
    let from = affine(pads);
    let total = |at: &[Frame; 2]| {
        let d = affine(at) - from;
        0.5 * d.dot(&(s * d)) - pull.dot(&d) + energy_j(acting, at)
    };
    let mut at = *pads;
    let mut energy = total(&at);
    let mut residual_n = 0.0;
    for iteration in 0..20 {
        let (g, h) = derivatives(s, pull, &from, acting, &at);
        if iteration == 0 {
            residual_n = (0..12)
                .map(|i| if i % 6 < 3 { g[i] } else { g[i] / ARM_M })
                .map(|x| x * x)
                .sum::<f64>()
                .sqrt();
        }
        let mut shift = 0.0;
        let step = loop {
            if let Some(c) = (h + Mat12::identity() * shift).cholesky() {
                break -c.solve(&g);
            }
            shift = (4.0 * shift).max(1e-3 * h.norm());
        };
        let mut share = 1.0;
        let before = energy;
        for _ in 0..30 {
            let next = moved(&at, &(step * share));
            let e = total(&next);
            if e <= before + 1e-14 * before.abs() {
                (at, energy) = (next, e);
                break;
            }
            share *= 0.5;
        }
        if step.norm() * share < 1e-10 {
            break;
        }
    }
    Moved {
        pads: at,
        residual_n,
    }
}

fn moved(pads: &[Frame; 2], step: &Vec12) -> [Frame; 2] {
    std::array::from_fn(|p| {
        let turn = Rotation3::new(step.fixed_rows::<3>(6 * p + 3).into_owned());
        Frame {
            r: turn.matrix() * pads[p].r,
            p: pads[p].p + step.fixed_rows::<3>(6 * p),
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn derivatives_agree_with_differences() {
        let root = SMatrix::<f64, 8, 8>::from_fn(|i, j| ((3 * i + 5 * j) as f64).sin());
        let s = root * root.transpose();
        let frame = |w: [f64; 3], p: [f64; 3]| Frame {
            r: *Rotation3::new(Vector3::from(w)).matrix(),
            p: Vector3::from(p),
        };
        let from = affine(&[
            frame([0.1, 0.0, 0.2], [0.0, 0.0, -0.1]),
            frame([0.0; 3], [0.1, 0.0, -0.3]),
        ]);
        let pull = Affine::from_fn(|i, j| ((i + 2 * j) as f64).cos());
        let acting = Acting {
            springs: vec![
                Spring {
                    upper: Some(0),
                    lower: 1,
                    upper_m: Vector3::new(0.05, 0.02, 0.0),
                    lower_m: Vector3::new(-0.03, 0.04, 0.01),
                    rate_n_m: 54.0,
                    free_m: 0.06,
                },
                Spring {
                    upper: None,
                    lower: 0,
                    upper_m: Vector3::new(0.05, 0.02, 0.0),
                    lower_m: Vector3::new(-0.03, 0.04, 0.01),
                    rate_n_m: 54.0,
                    free_m: 0.06,
                },
            ],
            dead: vec![Dead {
                pad: 1,
                at_m: Vector3::new(0.01, 0.02, -0.06),
                force_n: Vector3::new(1.0, 2.0, -9.0),
            }],
        };
        let at = [
            frame([0.3, -0.2, 0.4], [0.02, 0.01, -0.15]),
            frame([-0.1, 0.5, 0.2], [0.1, 0.05, -0.31]),
        ];
        let total = |x: &[Frame; 2]| {
            let d = affine(x) - from;
            0.5 * d.dot(&(s * d)) - pull.dot(&d) + energy_j(&acting, x)
        };
        let (g, h) = derivatives(&s, &pull, &from, &acting, &at);
        let eps = 1e-4;
        let unit = |i: usize| Vec12::from_fn(|k, _| if k == i { eps } else { 0.0 });
        for i in 0..12 {
            let d = (total(&moved(&at, &unit(i))) - total(&moved(&at, &-unit(i)))) / (2.0 * eps);
            assert!((d - g[i]).abs() < 1e-6 * g.norm(), "{i}: {d} {}", g[i]);
            for j in 0..12 {
                let e = |a: f64, b: f64| total(&moved(&at, &(unit(i) * a + unit(j) * b)));
                let d =
                    (e(1.0, 1.0) - e(1.0, -1.0) - e(-1.0, 1.0) + e(-1.0, -1.0)) / (4.0 * eps * eps);
                assert!(
                    (d - h[(i, j)]).abs() < 1e-5 * h.norm(),
                    "{i} {j}: {d} {}",
                    h[(i, j)]
                );
            }
        }
    }
}
