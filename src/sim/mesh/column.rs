//! One hollow column of tetrahedra between two pads: a bellows, or the central tube.
//!
//! Energy of the column at node positions x, growth λ and rest growth λ̂:
//!
//! E = Σₑ ½ w Vₑ |(Fₑ − Rₑ diag(1, 1, λ)) D|² + ½ K (λ − λ̂)² − Σᵢ fᵢ·xᵢ,   Fₑ = Σ xᵢ gᵢᵀ
//!
//! with D² = diag(α, α, 1). Rₑ is the rotation nearest to Fₑ D² diag(1, 1, λ), λ the best common growth
//! of the column; both are the local step. The Laplacian Σ w Vₑ gᵢ·D² gⱼ is constant: it is factored once, and the column's
//! answer to its pads' motion (harmonic extension of an affine motion) is stored with it.

use nalgebra::{Matrix3, SMatrix, Vector3};

use super::banded::Banded;
use super::procrustes::nearest_rotation;

/// Affine coordinates of two pads: rows 0-3 and 4-7 are origin and the images of x, y, z.
pub(super) type Affine = SMatrix<f64, 8, 3>;

/// A tetrahedron.
#[derive(Clone, Debug, PartialEq)]
struct Tet {
    nodes: [usize; 4],
    /// Gradients of the shape functions, 1/m.
    gradients: [Vector3<f64>; 4],
    volume_m3: f64,
}

/// Construction of a column.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Build {
    /// Centre of the upper end at rest in the base frame, m.
    pub top_m: Vector3<f64>,
    /// Angle of the first radial line, rad: turns the mesh with the robot's symmetry.
    pub turned_rad: f64,
    /// Inner and outer radius, m.
    pub radii_m: [f64; 2],
    /// Length at rest, m.
    pub length_m: f64,
    /// Sectors; even, so that the alternating cut closes.
    pub sectors: usize,
    /// Layers.
    pub layers: usize,
    /// w, J/m³.
    pub weight_j_m3: f64,
    /// α: weight of the cross-section's axes over that of the axis that grows.
    pub across: f64,
    /// K, J.
    pub growth_j: f64,
    /// Weight of the column in the base frame, N.
    pub load_n: Vector3<f64>,
    /// Rest origins of the pads at its ends, m; none where the end is clamped.
    pub pads_m: [Option<Vector3<f64>>; 2],
}

/// The constant part of a column.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Column {
    /// Nodes at rest in the base frame, layer after layer from the top, m.
    pub rest_m: Vec<Vector3<f64>>,
    /// Nodes per layer; even ones lie inside, odd ones outside.
    pub ring: usize,
    tets: Vec<Tet>,
    weight_j_m3: f64,
    across: f64,
    /// Σ w Vₑ, J.
    stiffness_j: f64,
    growth_j: f64,
    load_n: Vec<Vector3<f64>>,
    factor: Banded,
    /// Per node its answer to the eight affine coordinates of the pads.
    pub harmonic: Vec<SMatrix<f64, 8, 1>>,
    /// Stiffness of the column felt by the pads' affine coordinates, N/m.
    pub reduced: SMatrix<f64, 8, 8>,
}

/// Result of the local step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Local {
    /// E, J.
    pub energy_j: f64,
    /// λ.
    pub growth: f64,
}

/// Volume of a hollow column as meshed (polygons, not circles), m³.
pub(super) fn meshed_volume_m3(b: &Build) -> f64 {
    let n = b.sectors as f64;
    let polygon = 0.5 * n * (std::f64::consts::TAU / n).sin();
    polygon * (b.radii_m[1].powi(2) - b.radii_m[0].powi(2)) * b.length_m
}

impl Column {
    /// Meshes and factors a column; none when its dimensions leave no volume.
    pub fn new(b: &Build) -> Option<Self> {
        let ring = 2 * b.sectors;
        let rest_m = nodes(b);
        let tets = cut(b, &rest_m)?;
        let volume: f64 = tets.iter().map(|t| t.volume_m3).sum();
        let n = rest_m.len();
        let interior = ring..n - ring;
        let mut factor = Banded::zero(interior.len(), 2 * ring - 1);
        let mut load_n = vec![Vector3::zeros(); n];
        // Harmonic extension: L_II Y = −L_IB B.
        let mut harmonic: Vec<SMatrix<f64, 8, 1>> = vec![SMatrix::zeros(); n];
        for (end, range) in [(0, 0..ring), (1, n - ring..n)] {
            if let Some(origin) = b.pads_m[end] {
                for i in range {
                    let x = rest_m[i] - origin;
                    harmonic[i][4 * end] = 1.0;
                    for k in 0..3 {
                        harmonic[i][4 * end + 1 + k] = x[k];
                    }
                }
            }
        }
        let mut pull: Vec<SMatrix<f64, 8, 1>> = vec![SMatrix::zeros(); n];
        for t in &tets {
            let w = b.weight_j_m3 * t.volume_m3;
            for (i, gi) in t.nodes.iter().zip(&t.gradients) {
                load_n[*i] += b.load_n * (0.25 * t.volume_m3 / volume);
                if !interior.contains(i) {
                    continue;
                }
                for (j, gj) in t.nodes.iter().zip(&t.gradients) {
                    let l = w * (b.across * gi.xy().dot(&gj.xy()) + gi.z * gj.z);
                    if !interior.contains(j) {
                        pull[*i] -= harmonic[*j] * l;
                    } else if j <= i {
                        factor.add(i - ring, j - ring, l);
                    }
                }
            }
        }
        if !factor.factorise() {
            return None;
        }
        for first in [0, 3, 6] {
            let pick = |v: &SMatrix<f64, 8, 1>, k: usize| v.get(first + k).copied().unwrap_or(0.0);
            let mut y: Vec<Vector3<f64>> = pull[interior.clone()]
                .iter()
                .map(|v| Vector3::new(pick(v, 0), pick(v, 1), pick(v, 2)))
                .collect();
            factor.solve(&mut y);
            for (h, y) in harmonic[interior.clone()].iter_mut().zip(&y) {
                for k in 0..3.min(8 - first) {
                    h[first + k] = y[k];
                }
            }
        }
        // Zᵀ L Z, from the gradients of the eight fields.
        let mut reduced = SMatrix::<f64, 8, 8>::zeros();
        for t in &tets {
            let mut grad = SMatrix::<f64, 8, 3>::zeros();
            for (i, g) in t.nodes.iter().zip(&t.gradients) {
                grad += harmonic[*i] * g.transpose();
            }
            for k in 0..2 {
                grad.column_mut(k).scale_mut(b.across.sqrt());
            }
            reduced += grad * grad.transpose() * (b.weight_j_m3 * t.volume_m3);
        }
        Some(Self {
            rest_m,
            ring,
            tets,
            weight_j_m3: b.weight_j_m3,
            across: b.across,
            stiffness_j: b.weight_j_m3 * volume,
            growth_j: b.growth_j,
            load_n,
            factor,
            harmonic,
            reduced,
        })
    }

    /// Number of tetrahedra.
    pub fn tets(&self) -> usize {
        self.tets.len()
    }

    /// Nodes that belong to no pad.
    pub fn interior(&self) -> std::ops::Range<usize> {
        self.ring..self.rest_m.len() - self.ring
    }

    /// Rotations and growth that fit `x_m` best, starting from `growth`; leaves the force on every node (−∂E/∂x, N, base
    /// frame) in `force_n`. `axial_n` is scratch of the same length.
    pub fn local(
        &self,
        x_m: &[Vector3<f64>],
        growth: f64,
        aim: f64,
        force_n: &mut [Vector3<f64>],
        axial_n: &mut [Vector3<f64>],
    ) -> Local {
        force_n.fill(Vector3::zeros());
        axial_n.fill(Vector3::zeros());
        // Σ w V |F|², Σ w V (r₁·f₁ + r₂·f₂), Σ w V r₃·f₃.
        let (mut ff, mut rf, mut along) = (0.0, 0.0, 0.0);
        for t in &self.tets {
            let mut f = Matrix3::zeros();
            for (i, g) in t.nodes.iter().zip(&t.gradients) {
                f += x_m[*i] * g.transpose();
            }
            let mut aimed = f;
            aimed.column_mut(0).scale_mut(self.across);
            aimed.column_mut(1).scale_mut(self.across);
            aimed.column_mut(2).scale_mut(growth);
            let r = nearest_rotation(&aimed);
            let w = self.weight_j_m3 * t.volume_m3;
            let axis = r.column(2).into_owned();
            let (f1, f2, f3) = (f.column(0), f.column(1), f.column(2));
            ff += w * (self.across * (f1.norm_squared() + f2.norm_squared()) + f3.norm_squared());
            rf += w * self.across * (r.column(0).dot(&f1) + r.column(1).dot(&f2));
            along += w * axis.dot(&f3);
            let mut off = (f - r) * self.across;
            off.set_column(2, &f3);
            for (i, g) in t.nodes.iter().zip(&t.gradients) {
                force_n[*i] -= off * (g * w);
                axial_n[*i] += axis * (w * g.z);
            }
        }
        // ∂E/∂λ = 0: λ = (Σ w V r₃·f₃ + K λ̂) / (Σ w V + K)
        let growth = (along + self.growth_j * aim) / (self.stiffness_j + self.growth_j);
        let mut potential = 0.0;
        for (i, f) in force_n.iter_mut().enumerate() {
            *f += axial_n[i] * growth + self.load_n[i];
            potential -= self.load_n[i].dot(&x_m[i]);
        }
        let elastic = 0.5 * (ff + self.stiffness_j * (2.0 * self.across + growth * growth))
            - rf
            - growth * along;
        Local {
            energy_j: elastic + 0.5 * self.growth_j * (growth - aim).powi(2) + potential,
            growth,
        }
    }

    /// Zᵀ f: the force on the pads' affine coordinates once the interior has given way.
    pub fn condensed(&self, force_n: &[Vector3<f64>]) -> Affine {
        let mut sum = Affine::zeros();
        for (h, f) in self.harmonic.iter().zip(force_n) {
            sum += h * f.transpose();
        }
        sum
    }

    /// Overwrites the forces on the interior nodes by their displacements with the pads held, m.
    pub fn relax(&self, force_n: &mut [Vector3<f64>]) {
        let interior = self.interior();
        self.factor.solve(&mut force_n[interior]);
    }
}

fn nodes(b: &Build) -> Vec<Vector3<f64>> {
    let mut rest = Vec::with_capacity((b.layers + 1) * 2 * b.sectors);
    for layer in 0..=b.layers {
        let z = -b.length_m * layer as f64 / b.layers as f64;
        for j in 0..b.sectors {
            let a = b.turned_rad + std::f64::consts::TAU * j as f64 / b.sectors as f64;
            for r in b.radii_m {
                rest.push(b.top_m + Vector3::new(r * a.cos(), r * a.sin(), z));
            }
        }
    }
    rest
}

/// Cuts every six-sided cell into five tetrahedra: one through the corners of even index sum, four at
/// the others. Neighbours share their diagonals and the mesh is its own mirror image.
fn cut(b: &Build, rest: &[Vector3<f64>]) -> Option<Vec<Tet>> {
    let ring = 2 * b.sectors;
    let mut tets = Vec::with_capacity(5 * b.sectors * b.layers);
    for layer in 0..b.layers {
        for j in 0..b.sectors {
            let node = |c: [usize; 3]| (layer + c[2]) * ring + 2 * ((j + c[0]) % b.sectors) + c[1];
            let even = |c: &[usize; 3]| (j + layer + c[0] + c[1] + c[2]).is_multiple_of(2);
            let corners: [[usize; 3]; 8] = std::array::from_fn(|k| [k & 1, (k >> 1) & 1, k >> 2]);
            let inner: Vec<usize> = corners
                .iter()
                .filter(|c| even(c))
                .map(|c| node(*c))
                .collect();
            tets.push(tet([inner[0], inner[1], inner[2], inner[3]], rest)?);
            for c in corners.iter().filter(|c| !even(c)) {
                let flip = |k: usize| {
                    let mut n = *c;
                    n[k] = 1 - n[k];
                    node(n)
                };
                tets.push(tet([node(*c), flip(0), flip(1), flip(2)], rest)?);
            }
        }
    }
    Some(tets)
}

fn tet(mut nodes: [usize; 4], rest: &[Vector3<f64>]) -> Option<Tet> {
    let edges = |n: &[usize; 4]| Matrix3::from_columns(&[1, 2, 3].map(|k| rest[n[k]] - rest[n[0]]));
    if edges(&nodes).determinant() < 0.0 {
        nodes.swap(2, 3);
    }
    let d = edges(&nodes);
    let inverse = d.try_inverse()?;
    let g = [0, 1, 2].map(|k| inverse.row(k).transpose());
    Some(Tet {
        nodes,
        gradients: [-(g[0] + g[1] + g[2]), g[0], g[1], g[2]],
        volume_m3: d.determinant() / 6.0,
    })
}

/// Triangles between the outer nodes of neighbouring layers.
pub(super) fn triangles(columns: &[Column]) -> Vec<[u32; 3]> {
    let mut out = Vec::new();
    let mut first = 0;
    for c in columns {
        let sectors = c.ring / 2;
        let layers = c.rest_m.len() / c.ring - 1;
        for layer in 0..layers {
            for j in 0..sectors {
                let at = |l: usize, j: usize| (first + l * sectors + j % sectors) as u32;
                // Layers count downwards.
                let (a, b) = (at(layer, j), at(layer, j + 1));
                let (d, e) = (at(layer + 1, j), at(layer + 1, j + 1));
                out.push([a, d, e]);
                out.push([a, e, b]);
            }
        }
        first += (layers + 1) * sectors;
    }
    out
}
