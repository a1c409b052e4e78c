//! Gradient of the rod's energy alone, in one pass back up the chain.
//!
//! A wrench z = (M, F) about the base origin, acting on everything downstream of an element that
//! starts at (R, p), does the work z·S_a in the element's strain a. With the tangent map's
//! transpose all of them come at once:
//!
//! (S_a·z)_a = l J_lᵀ (Rᵀ (M − p × F), Rᵀ F)
//!
//! [`super::assemble`] has the Hessian too, and costs accordingly.

use nalgebra::Vector3;

use super::assemble::{for_dead_forces, way_dependent};
use super::kinematics::Kinematics;
use super::loads::Acting;
use super::se3::{Frame, Twist};
use super::section::{Rod, Section, strain_of};

impl Kinematics {
    /// Adds the generalized forces factor · Jᵀ z to `out`, for the wrenches `z` at the nodes (about the base origin)
    /// and `across` each section (between its start and its end).
    pub(super) fn add_jacobian_transpose(
        &self,
        rod: &Rod,
        z: &[Twist],
        across: &[Twist],
        factor: f64,
        out: &mut [f64],
    ) {
        let idx = rod.strains.indices();
        let d = idx.len();
        let mut dead = Twist::zero();
        let mut element = self.maps.len();
        for (si, s) in rod.sections.iter().enumerate().rev() {
            let l = s.length_m / s.elements as f64;
            for _ in 0..s.elements {
                element -= 1;
                let start = element + si;
                dead = dead.plus(1.0, &z[start + 1]);
                let all = across.get(si).map_or(dead, |a| dead.plus(1.0, a));
                let Frame { r, p } = &self.nodes[start];
                let seen = Twist {
                    w: r.tr_mul(&(all.w - p.cross(&all.v))),
                    v: r.tr_mul(&all.v),
                };
                let work = self.maps[element].tangent_transpose(&seen);
                for (o, &i) in out[element * d..][..d].iter_mut().zip(idx) {
                    *o += factor * l * work.get(i);
                }
            }
            dead = dead.plus(1.0, &z[element + si]);
        }
    }
}

/// Scratch memory of [`gradient`].
#[derive(Clone, Debug, Default)]
pub(super) struct Wrenches {
    nodes: Vec<Twist>,
    across: Vec<Twist>,
}

/// Π'(q) into `out`, with `at` placed at `q`: forces that depend on the way and the floor included, viscous drag not.
pub(super) fn gradient(
    rod: &Rod,
    acting: &Acting,
    q: &[f64],
    at: &Kinematics,
    work: &mut Wrenches,
    out: &mut [f64],
) {
    let idx = rod.strains.indices();
    let d = idx.len();
    let Wrenches { nodes, across } = work;
    nodes.clear();
    nodes.resize(at.nodes.len(), Twist::zero());
    across.clear();
    let loads = acting.loads;
    let all_n = way_dependent(rod, acting, q).map(|w| w.bellows_n);
    let all_n = all_n.as_ref().unwrap_or(&loads.bellows_n);
    let (mut element, mut bellows) = (0, 0);
    for (si, s) in rod.sections.iter().enumerate() {
        let l = s.length_m / s.elements as f64;
        let bellows_n = &all_n[bellows..bellows + s.bellows.len()];
        let first = element + si;
        for k in element * d..(element + s.elements) * d {
            if k % d == 0 {
                let slope = local_slope(s, bellows_n, &strain_of(s, idx, &q[k..k + d]));
                for (o, &i) in out[k..k + d].iter_mut().zip(idx) {
                    *o = l * slope[i];
                }
            }
        }
        let ends = &at.nodes[first..=first + s.elements];
        for_dead_forces(rod, loads, si, ends, |node, x, f| {
            add(&mut nodes[first + node], x, f);
        });
        across.push(pull_of_links(s, &ends[0], &ends[s.elements]));
        element += s.elements;
        bellows += s.bellows.len();
    }
    if let (Some(tip), Some(end)) = (nodes.last_mut(), at.nodes.last()) {
        tip.w += loads.tip_moment_nm;
        if let Some(floor) = &rod.floor {
            add(tip, &end.p, &floor.at(&end.p, acting.contact()).force_n);
        }
    }
    at.add_jacobian_transpose(rod, nodes, across, -1.0, out);
}

fn add(z: &mut Twist, x: &Vector3<f64>, f: &Vector3<f64>) {
    z.w += x.cross(f);
    z.v += f;
}

/// Slope of the strain energy per length after the six strains.
fn local_slope(section: &Section, bellows_n: &[f64], xi: &[f64; 6]) -> [f64; 6] {
    let mut g: [f64; 6] = std::array::from_fn(|i| section.rigidity[i] * (xi[i] - section.rest[i]));
    let kappa = Vector3::new(xi[0], xi[1], xi[2]);
    let v = Vector3::new(xi[3], xi[4], xi[5]);
    for (bellows, push) in section.bellows.iter().zip(bellows_n) {
        let d = v + kappa.cross(&bellows.r_m);
        let stretch = d.norm();
        let tension = bellows.elastic(stretch).force_n - push;
        // ∂λ/∂v = n, ∂λ/∂κ = r × n
        let f = d * (tension / stretch);
        let m = bellows.r_m.cross(&f);
        for i in 0..3 {
            g[i] += m[i];
            g[i + 3] += f[i];
        }
    }
    g
}

/// Wrench of a section's tension springs on its end.
fn pull_of_links(s: &Section, start: &Frame, end: &Frame) -> Twist {
    let mut z = Twist::zero();
    for link in &s.links {
        let x = end.point(&link.bottom_m);
        let d = x - start.point(&link.top_m);
        let dist = d.norm();
        let stretch = dist - link.free_m;
        if stretch > 0.0 {
            add(&mut z, &x, &(d * (-link.rate_n_m * stretch / dist)));
        }
    }
    z
}
