//! Energy, gradient and exact Hessian of the rod in its strains.
//!
//! Every strain component a of element e has a spatial screw S_a = (ω_a, v_a): all points x
//! downstream move with ω_a × x + v_a. For dead forces f at points x
//!
//! ∂Π/∂q_a = −(ω_a·M + v_a·F),            F = Σ f,  M = Σ x × f
//! ∂²Π/∂q_a∂q_b = −ω_a·[v_b × F + (N − tr N) ω_b],  N = Σ x fᵀ,  a upstream of b
//!
//! summed over the points downstream of b; within one element the derivative of the exponential's
//! left Jacobian is added (see [`super::se3`]). A moment M of constant direction has no energy; its
//! derivative has a skew part,
//!
//! ∂g_i/∂q_j − ∂g_j/∂q_i = −(ω_j × ω_i)·M,
//!
//! which the Hessian leaves out and [`Assembly::jacobian`] has. Tension springs span one section, so they
//! add their forces, and their stiffness through the screws, to that section alone. Forces of a
//! bellows that depend on the way have a potential W of its whole length x, which adds W″ ∇x ∇xᵀ over its section.

mod stiffness;

use nalgebra::{DMatrix, Matrix3, Vector3};

use super::kinematics::{Kinematics, screw};
use super::loads::{Acting, Loads, Viscosity};
use super::se3::{Frame, Twist};
use super::section::{Bellows, PointMass, Rod, Section, strain_of};
use stiffness::{Dead, Stiffness6};

/// Per free strain of an element: spatial screw and ad⁰e..ad⁴e.
type Screws = [(Twist, [Twist; 5]); 6];

/// Scratch memory and results of one evaluation.
#[derive(Clone, Debug, Default)]
pub(super) struct Assembly {
    pub energy: f64,
    pub gradient: Vec<f64>,
    /// Row-major, lower triangle filled.
    pub hessian: Vec<f64>,
    kinematics: Kinematics,
    elements: Vec<Screws>,
    moved: Vec<[f64; 9]>,
}

/// ∂(v + κ × r)/∂ξ: e_i × r for κ_i, e_i for v_i.
fn path_columns(bellows: &Bellows) -> [Vector3<f64>; 6] {
    let r = bellows.r_m;
    [
        Vector3::new(0.0, -r.z, r.y),
        Vector3::new(r.z, 0.0, -r.x),
        Vector3::new(-r.y, r.x, 0.0),
        Vector3::x(),
        Vector3::y(),
        Vector3::z(),
    ]
}

/// Forces of the bellows that depend on the way.
pub(super) struct WayDependent {
    energy: f64,
    /// Pushing forces of the bellows with them, N.
    pub bellows_n: Vec<f64>,
    slopes_n_m: Vec<f64>,
}

/// Forces of the bellows that depend on the way, at the strains `q`; `None` when there are none.
pub(super) fn way_dependent(rod: &Rod, acting: &Acting, q: &[f64]) -> Option<WayDependent> {
    let (history, dt_s) = acting.history.filter(|(h, _)| !h.bellows.is_empty())?;
    let mut out = WayDependent {
        energy: 0.0,
        bellows_n: acting.loads.bellows_n.clone(),
        slopes_n_m: Vec::with_capacity(history.bellows.len()),
    };
    let bellows = history.bellows.iter().zip(rod.bellows());
    for (((history, bellows), x_m), push_n) in bellows
        .zip(rod.bellows_lengths_m(q))
        .zip(&mut out.bellows_n)
    {
        let w = history.at(bellows, x_m, dt_s);
        // In the elements' energy the force at x counts as a dead one, F x in all.
        out.energy += w.energy - w.force_n * x_m;
        *push_n -= w.force_n;
        out.slopes_n_m.push(w.slope_n_m);
    }
    Some(out)
}

/// Strain energy of one element with its first two derivatives after the six strains.
fn local(
    section: &Section,
    l: f64,
    bellows_n: &[f64],
    xi: &[f64; 6],
) -> (f64, [f64; 6], [[f64; 6]; 6]) {
    let mut e = 0.0;
    let mut g = [0.0; 6];
    let mut h = [[0.0; 6]; 6];
    for i in 0..6 {
        let dx = xi[i] - section.rest[i];
        e += 0.5 * l * section.rigidity[i] * dx * dx;
        g[i] += l * section.rigidity[i] * dx;
        h[i][i] += l * section.rigidity[i];
    }
    for (bellows, push) in section.bellows.iter().zip(bellows_n) {
        let d = bellows.along(xi);
        let stretch = d.norm();
        let n = d / stretch;
        let elastic = bellows.elastic(stretch);
        e += l * (elastic.energy - push * stretch);
        let d1 = l * (elastic.force_n - push);
        let d2 = l * elastic.slope_n_m;
        let columns = path_columns(bellows);
        let along = columns.map(|c| n.dot(&c));
        for i in 0..6 {
            g[i] += d1 * along[i];
            for j in 0..=i {
                let across = columns[i].dot(&columns[j]) - along[i] * along[j];
                h[i][j] += d2 * along[i] * along[j] + d1 / stretch * across;
            }
        }
    }
    (e, g, h)
}

impl Assembly {
    /// Energy alone, for the line search.
    pub fn energy_only(rod: &Rod, acting: &Acting, q: &[f64]) -> f64 {
        let idx = rod.strains.indices();
        let d = idx.len();
        let loads = acting.loads;
        let at = Kinematics::at(rod, q);
        let way = way_dependent(rod, acting, q);
        let mut e = way.as_ref().map_or(0.0, |w| w.energy);
        let all_n = way.as_ref().map_or(&loads.bellows_n, |w| &w.bellows_n);
        let (mut k, mut b) = (0, 0);
        if let Some(floor) = &rod.floor {
            e += floor.at(&at.tip().p, acting.contact()).energy;
        }
        for (si, s) in rod.sections.iter().enumerate() {
            let l = s.length_m / s.elements as f64;
            let bellows_n = &all_n[b..b + s.bellows.len()];
            for _ in 0..s.elements {
                let xi = strain_of(s, idx, &q[k..k + d]);
                e += local(s, l, bellows_n, &xi).0;
                if let Some((viscosity, from)) = acting.drag {
                    for (m, &i) in idx.iter().enumerate() {
                        let dq = q[k + m] - from[k + m];
                        e += 0.5 * drag(s, l, i, viscosity) * dq * dq;
                    }
                }
                k += d;
            }
            b += s.bellows.len();
            let [start, end] = at.ends(si);
            for link in &s.links {
                let dist = (end.point(&link.bottom_m) - start.point(&link.top_m)).norm();
                let x = (dist - link.free_m).max(0.0);
                e += 0.5 * link.rate_n_m * x * x;
            }
            for_dead_forces(rod, loads, si, at.section(si), |_, x, f| e -= x.dot(f));
        }
        // A constant moment has no energy in general; its work is left out here and the line
        // search is skipped when one acts.
        e
    }

    /// Energy, gradient and Hessian at q.
    pub fn evaluate(&mut self, rod: &Rod, acting: &Acting, q: &[f64]) {
        let idx = rod.strains.indices();
        let d = idx.len();
        let n = rod.unknowns();
        let loads = acting.loads;
        self.energy = 0.0;
        self.gradient.clear();
        self.gradient.resize(n, 0.0);
        self.hessian.clear();
        self.hessian.resize(n * n, 0.0);
        self.elements.clear();
        self.moved.clear();
        self.moved.resize(n, [0.0; 9]);

        let way = way_dependent(rod, acting, q);
        self.energy += way.as_ref().map_or(0.0, |w| w.energy);
        let bellows_n = way.as_ref().map_or(&loads.bellows_n, |w| &w.bellows_n);
        self.kinematics.place(rod, q);
        self.forward(rod, bellows_n, q, acting.drag);

        // Backward: from the tip to the base, dead loads accumulate.
        let mut dead = Dead::zero();
        dead.m += loads.tip_moment_nm;
        let mut element_end = self.elements.len();
        for (si, s) in rod.sections.iter().enumerate().rev() {
            let first = element_end - s.elements;
            let [start, end] = self.kinematics.ends(si);
            let (link, link_k) = self.links(s, &start, &end);
            let mut forces = vec![Vec::new(); s.elements + 1];
            let mut energy = 0.0;
            for_dead_forces(rod, loads, si, self.kinematics.section(si), |node, x, f| {
                energy -= x.dot(f);
                forces[node].push((*x, *f));
            });
            let floor = rod.floor.filter(|_| si + 1 == rod.sections.len());
            if let Some(floor) = floor {
                let push = floor.at(&end.p, acting.contact());
                energy += push.energy;
                forces[s.elements].push((end.p, push.force_n));
            }
            self.energy += energy;
            for e in (0..s.elements).rev() {
                for (x, f) in &forces[e + 1] {
                    dead.add(x, f);
                }
                let all = dead.sum(&link);
                let screws = &self.elements[first + e];
                let at = &self.kinematics.nodes[first + e + si];
                // Wrench on the element's end as seen from its start, paired with its twists.
                let about = all.m - at.p.cross(&all.f);
                let z = Twist {
                    w: -(at.r.transpose() * about),
                    v: -(at.r.transpose() * all.f),
                };
                let contraction = self.kinematics.maps[first + e].contraction(&z);
                let l = s.length_m / s.elements as f64;
                let base = (first + e) * d;
                let mut sections = [Vector3::zeros(); 6];
                for a in 0..d {
                    let (screw, y) = &screws[a];
                    self.gradient[base + a] -= screw.w.dot(&all.m) + screw.v.dot(&all.f);
                    let upstream = dead.moved(screw);
                    let section = all.moved(screw);
                    // K6 S_b for the springs across this section.
                    let pull = link_k.apply(screw);
                    self.moved[base + a] = [
                        upstream.x,
                        upstream.y,
                        upstream.z,
                        pull.w.x - section.x,
                        pull.w.y - section.y,
                        pull.w.z - section.z,
                        pull.v.x,
                        pull.v.y,
                        pull.v.z,
                    ];
                    let h = contraction.derivative(y);
                    sections[a] = section;
                    for b in 0..=a {
                        // ω_a·C_b is not symmetric by itself; the derivative term makes up for it.
                        let cross = pull.dot(&screws[b].0) - screw.w.dot(&sections[b]);
                        let tangent = l * l * h.get(idx[b]);
                        self.hessian[(base + a) * n + base + b] += cross + tangent;
                    }
                }
            }
            for (x, f) in &forces[0] {
                dead.add(x, f);
            }
            element_end = first;
        }
        self.couple(rod, n, d);
        if let Some(way) = &way {
            self.stiffen(rod, q, &way.slopes_n_m);
        }
        if let Some(floor) = rod.floor {
            let end = self.kinematics.tip();
            let push = floor.at(&end.p, acting.contact());
            self.rest_on(&push.stiffness_n_m, &end, d);
        }
        if loads.tip_moment_nm.norm() > 0.0 {
            self.symmetrise(&loads.tip_moment_nm, n, d);
        }
    }

    /// Spatial screws of all strains, `d` of each element, at the place last evaluated.
    pub fn screws(&self, d: usize) -> impl Iterator<Item = Twist> {
        let screws = self.elements.iter().flat_map(move |e| &e[..d]);
        screws.map(|(screw, _)| *screw)
    }

    /// Adds the stiffness of the forces that depend on the way.
    fn stiffen(&mut self, rod: &Rod, q: &[f64], slopes_n_m: &[f64]) {
        let idx = rod.strains.indices();
        let d = idx.len();
        let (mut from, mut t) = (0, 0);
        for s in &rod.sections {
            let l = s.length_m / s.elements as f64;
            let to = from + d * s.elements;
            for (bellows, slope_n_m) in s.bellows.iter().zip(&slopes_n_m[t..]) {
                let columns = path_columns(bellows);
                let longer: Vec<f64> = q[from..to]
                    .chunks_exact(d)
                    .flat_map(|xi| {
                        let n = bellows.along(&strain_of(s, idx, xi)).normalize();
                        idx.iter().map(move |&i| l * n.dot(&columns[i]))
                    })
                    .collect();
                self.add_outer(from, &longer, *slope_n_m);
            }
            from = to;
            t += s.bellows.len();
        }
    }

    /// Adds the stiffness K of a floor at the last end: H += Jᵀ K J, J the end's motion per strain.
    fn rest_on(&mut self, k: &Matrix3<f64>, end: &Frame, d: usize) {
        if k.amax() == 0.0 {
            return;
        }
        let moved: Vec<Vector3<f64>> = self.screws(d).map(|s| s.w.cross(&end.p) + s.v).collect();
        let n = moved.len();
        for (i, a) in moved.iter().enumerate() {
            let pull = k * a;
            for (j, b) in moved[..=i].iter().enumerate() {
                self.hessian[i * n + j] += pull.dot(b);
            }
        }
    }

    /// H += k v vᵀ for the unknowns from `from` on.
    fn add_outer(&mut self, from: usize, v: &[f64], k: f64) {
        let n = self.gradient.len();
        for (i, a) in v.iter().enumerate() {
            let row = (from + i) * n + from;
            for (h, b) in self.hessian[row..=row + i].iter_mut().zip(v) {
                *h += k * a * b;
            }
        }
    }

    /// −½ (ω_j × ω_i)·M: the skew part of ∂g_i/∂q_j under a tip moment.
    fn skew(&self, moment: &Vector3<f64>, d: usize, i: usize, j: usize) -> f64 {
        let w = |k: usize| &self.elements[k / d][k % d].0.w;
        -0.5 * w(j).cross(w(i)).dot(moment)
    }

    /// Turns the one-sided moment terms of the lower triangle into their symmetric part.
    fn symmetrise(&mut self, moment: &Vector3<f64>, n: usize, d: usize) {
        for i in 0..n {
            for j in 0..i {
                // Within an element the row's derivative was stored, between elements the column's.
                let sign = if i / d == j / d { -1.0 } else { 1.0 };
                self.hessian[i * n + j] += sign * self.skew(moment, d, i, j);
            }
        }
    }

    /// The full derivative of the gradient, the skew part of a tip moment included.
    pub fn jacobian(&self, rod: &Rod, loads: &Loads) -> DMatrix<f64> {
        let (n, d) = (rod.unknowns(), rod.strains.indices().len());
        DMatrix::from_fn(n, n, |i, j| {
            let symmetric = self.hessian[i.max(j) * n + i.min(j)];
            symmetric + self.skew(&loads.tip_moment_nm, d, i, j)
        })
    }

    /// Screws and the local energy of every element.
    fn forward(
        &mut self,
        rod: &Rod,
        all_n: &[f64],
        q: &[f64],
        resists: Option<(Viscosity, &[f64])>,
    ) {
        let idx = rod.strains.indices();
        let d = idx.len();
        let n = rod.unknowns();
        let (mut k, mut b) = (0, 0);
        for (si, s) in rod.sections.iter().enumerate() {
            let l = s.length_m / s.elements as f64;
            let bellows_n = &all_n[b..b + s.bellows.len()];
            for _ in 0..s.elements {
                let element = self.elements.len();
                let at = &self.kinematics.nodes[element + si];
                let map = &self.kinematics.maps[element];
                let mut screws = [(Twist::zero(), [Twist::zero(); 5]); 6];
                for (m, &i) in idx.iter().enumerate() {
                    screws[m] = screw(at, map, i, l);
                }
                self.elements.push(screws);
                let xi = strain_of(s, idx, &q[k..k + d]);
                let (e, g, h) = local(s, l, bellows_n, &xi);
                self.energy += e;
                for (m, &i) in idx.iter().enumerate() {
                    self.gradient[k + m] += g[i];
                    for (o, &j) in idx[..=m].iter().enumerate() {
                        self.hessian[(k + m) * n + k + o] += h[i][j];
                    }
                    if let Some((viscosity, from)) = resists {
                        let dq = q[k + m] - from[k + m];
                        let drag = drag(s, l, i, viscosity);
                        self.energy += 0.5 * drag * dq * dq;
                        self.gradient[k + m] += drag * dq;
                        self.hessian[(k + m) * n + k + m] += drag;
                    }
                }
                k += d;
            }
            b += s.bellows.len();
        }
    }

    /// Forces and stiffness of the springs across a section.
    fn links(&mut self, s: &Section, start: &Frame, end: &Frame) -> (Dead, Stiffness6) {
        let mut dead = Dead::zero();
        let mut k6 = Stiffness6::zero();
        for link in &s.links {
            let x = end.point(&link.bottom_m);
            let d = x - start.point(&link.top_m);
            let dist = d.norm();
            let stretch = dist - link.free_m;
            if stretch <= 0.0 {
                continue;
            }
            let n = d / dist;
            let tension = link.rate_n_m * stretch;
            self.energy += 0.5 * link.rate_n_m * stretch * stretch;
            dead.add(&x, &(-n * tension));
            let nn = n * n.transpose();
            let k = nn * link.rate_n_m + (Matrix3::identity() - nn) * (tension / dist);
            k6.add(&x, &k);
        }
        (dead, k6)
    }

    /// Blocks between different elements: a upstream of b.
    fn couple(&mut self, rod: &Rod, n: usize, d: usize) {
        let mut section_of = Vec::with_capacity(self.elements.len());
        for (si, s) in rod.sections.iter().enumerate() {
            section_of.extend(std::iter::repeat_n(si, s.elements));
        }
        for eb in 1..self.elements.len() {
            for b in 0..d {
                let m = &self.moved[eb * d + b];
                let row = (eb * d + b) * n;
                for ea in 0..eb {
                    let same = section_of[ea] == section_of[eb];
                    for a in 0..d {
                        let s = &self.elements[ea][a].0;
                        let h = if same {
                            s.w.x * m[3]
                                + s.w.y * m[4]
                                + s.w.z * m[5]
                                + s.v.x * m[6]
                                + s.v.y * m[7]
                                + s.v.z * m[8]
                        } else {
                            -(s.w.x * m[0] + s.w.y * m[1] + s.w.z * m[2])
                        };
                        self.hessian[row + ea * d + a] += h;
                    }
                }
            }
        }
    }
}

/// Resistance of one strain to change.
pub(super) fn drag(s: &Section, l: f64, i: usize, viscosity: Viscosity) -> f64 {
    let bellows: f64 = s
        .bellows
        .iter()
        .map(|t| match i {
            0 => t.stiffness_n * t.r_m.y * t.r_m.y,
            1 => t.stiffness_n * t.r_m.x * t.r_m.x,
            5 => t.stiffness_n,
            _ => 0.0,
        })
        .sum();
    l * (viscosity.core * s.rigidity[i] + viscosity.bellows * bellows)
}

/// Calls `each(node, point, force)` for every dead force on a section; node 0 is its start.
pub(super) fn for_dead_forces(
    rod: &Rod,
    loads: &Loads,
    si: usize,
    nodes: &[Frame],
    mut each: impl FnMut(usize, &Vector3<f64>, &Vector3<f64>),
) {
    let s = &rod.sections[si];
    let end = s.elements;
    let lump = rod.gravity_m_s2 * (s.kg_per_m * s.length_m / end as f64);
    for (i, node) in nodes.iter().enumerate() {
        let share = if i == 0 || i == end { 0.5 } else { 1.0 };
        each(i, &node.p, &(lump * share));
    }
    let last = si + 1 == rod.sections.len();
    let extra: &[PointMass] = if last { &loads.tip_masses } else { &[] };
    for m in s.masses.iter().chain(extra) {
        each(end, &nodes[end].point(&m.at_m), &(rod.gravity_m_s2 * m.kg));
    }
    if last {
        each(end, &nodes[end].p, &loads.tip_force_n);
    }
}
