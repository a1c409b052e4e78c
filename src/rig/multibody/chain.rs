//! Rings and pads as a chain of rigid bodies, moved by the implicit midpoint rule.
//!
//! ```text
//! P(q_m) v_m = π_n + ½ h F(q_m, v_m)      q_m = q_n ⊕ ½ h v_m      q_{n+1} = q_m ⊕ ½ h v_m
//! ```
//!
//! with P the inertia in base axes and π the momenta. Every body meets its two neighbours only, so that the Newton
//! matrix P + ¼ h² K is block-tridiagonal; the springs between the pads and the air in the chambers act at the
//! midpoint too, but are left out of the matrix (both are soft beside inertia over h²).

use nalgebra::{
    Cholesky, Matrix3, Matrix6, Point3, Translation3, U6, UnitQuaternion, Vector3, Vector6,
};

use super::gap::{Elastic, Strain, Wrench};
use super::member::{Axial, BRANCHES, Friction, Member, Memory};
use crate::signal::{CHAMBERS, Pose};

/// A ring or a pad.
#[derive(Clone, Debug, PartialEq)]
pub struct Body {
    /// Mass, kg.
    pub mass_kg: f64,
    /// Inertia about the centre of mass in the body's axes, kg m².
    pub inertia_kg_m2: Matrix3<f64>,
    /// Where the gap above is fixed, from the centre of mass, body axes, m.
    pub upper_m: Vector3<f64>,
    /// Where the gap below is fixed, from the centre of mass, body axes, m.
    pub lower_m: Vector3<f64>,
}

/// A gap: what stands between a body and the one above it.
#[derive(Clone, Debug, PartialEq)]
pub struct Gap {
    /// Constants without memory.
    pub elastic: Elastic,
    /// Its three bellows members.
    pub members: [Member; 3],
    /// Index of each bellows' chamber.
    pub chamber: [usize; 3],
    /// Damping of central tube and folds as a time, s: force is this times the rate of the elastic force.
    pub damping_s: f64,
}

/// An extension spring between two bodies; `None` is the base.
#[derive(Clone, Debug, PartialEq)]
pub struct Spring {
    /// Body of the upper end.
    pub upper: Option<usize>,
    /// Body of the lower end.
    pub lower: usize,
    /// Upper end from the body's centre of mass (from the base's origin), m.
    pub upper_m: Vector3<f64>,
    /// Lower end from the body's centre of mass, m.
    pub lower_m: Vector3<f64>,
    /// Rate, N/m.
    pub rate_n_m: f64,
    /// Length without load, m.
    pub free_m: f64,
}

/// Constant part: the arm as it was manufactured.
#[derive(Clone, Debug, PartialEq)]
pub struct Arm {
    /// From the base downwards.
    pub bodies: Vec<Body>,
    /// Gap `i` is above body `i`.
    pub gaps: Vec<Gap>,
    /// All springs.
    pub springs: Vec<Spring>,
    /// The fixed face that the first gap hangs on.
    pub base: Pose,
    /// Acceleration of free fall in the base frame, m/s².
    pub gravity_m_s2: Vector3<f64>,
    /// Air that is always in a chamber and its line, m³.
    pub dead_m3: f64,
}

/// Motion of one body.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motion {
    /// Base from body; the origin is the centre of mass.
    pub pose: Pose,
    /// Linear and angular momentum, base axes, kg m/s and kg m²/s.
    pub momentum: Vector6<f64>,
    /// Velocity and angular rate over the last step, base axes, m/s and rad/s.
    pub velocity: Vector6<f64>,
}

/// State of the arm.
#[derive(Clone, Debug)]
pub struct Chain {
    /// Motion of each body.
    pub motions: Vec<Motion>,
    /// State of the bellows members.
    pub memories: Vec<[Memory; 3]>,
    /// Length of each member, m.
    pub lengths_m: Vec<[f64; 3]>,
    strains: Vec<(Vector3<f64>, Vector3<f64>)>,
    factors: Vec<Factor>,
    factored_for_s: f64,
    /// Newton iterations of the last step.
    pub iterations: usize,
}

#[derive(Clone, Debug)]
struct Factor {
    pivot: Cholesky<f64, U6>,
    /// Coupling to the next body.
    below: Matrix6<f64>,
}

/// A step that did not converge; the state is as before.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NoStep {
    /// Largest correction of the last iteration, m or rad.
    pub correction: f64,
}

/// Air in the chambers: the gauge pressure that it has at a volume.
pub trait Air {
    /// Gauge pressure of a chamber at a volume, Pa.
    fn gauge_pa(&self, chamber: usize, volume_m3: f64) -> f64;
}

/// Gauge pressures (Pa) that are kept, whatever the volume.
pub struct Held(pub [f64; CHAMBERS]);

impl Air for Held {
    fn gauge_pa(&self, chamber: usize, _volume_m3: f64) -> f64 {
        self.0[chamber]
    }
}

/// Forces from outside.
#[derive(Clone, Debug, Default)]
pub struct Outside {
    /// Wrench on the centre of mass of a body, base axes.
    pub wrenches: Vec<(usize, Wrench)>,
}

/// Largest correction of an iteration that ends a step, m or rad.
const TOLERANCE: f64 = 1e-8;
const MOST_ITERATIONS: usize = 25;
/// Below this speed of every body the arm counts as settled, m/s.
const SETTLED_M_S: f64 = 1e-5;
/// The matrix is recomputed when an iteration leaves more than this share of the correction.
const SLOW: f64 = 0.1;

/// A pose moved by a small displacement and a rotation vector, both in base axes.
fn moved(pose: &Pose, by: &Vector6<f64>) -> Pose {
    let turn = UnitQuaternion::from_scaled_axis(Vector3::new(by[3], by[4], by[5]));
    let to_m = pose.translation.vector + Vector3::new(by[0], by[1], by[2]);
    Pose::from_parts(to_m.into(), turn * pose.rotation)
}

fn point(pose: &Pose, r: &Vector3<f64>) -> Vector3<f64> {
    (pose * Point3::from(*r)).coords
}

fn at(pose: &Pose, r: &Vector3<f64>) -> Pose {
    pose * Translation3::from(*r)
}

fn add(wrench: &mut Wrench, force: &Vector3<f64>, arm: &Vector3<f64>) {
    let torque = arm.cross(force);
    for k in 0..3 {
        wrench[k] += force[k];
        wrench[3 + k] += torque[k];
    }
}

fn inertia(body: &Body, pose: &Pose) -> Matrix6<f64> {
    let r = pose.rotation.to_rotation_matrix();
    let mut out = Matrix6::zeros();
    for k in 0..3 {
        out[(k, k)] = body.mass_kg;
    }
    let turned = r.matrix() * body.inertia_kg_m2 * r.matrix().transpose();
    out.fixed_view_mut::<3, 3>(3, 3).copy_from(&turned);
    out
}

/// Shifts a Hessian block from connection points to centres of mass: δX_c = δX − ρ × δΘ.
fn shifted(block: &Matrix6<f64>, rho_row: &Vector3<f64>, rho_col: &Vector3<f64>) -> Matrix6<f64> {
    let shift = |rho: &Vector3<f64>| {
        let mut s = Matrix6::identity();
        s.fixed_view_mut::<3, 3>(0, 3)
            .copy_from(&(-rho.cross_matrix()));
        s
    };
    shift(rho_row).tr_mul(&(block * shift(rho_col)))
}

impl Arm {
    /// The same without friction and creep, damped so that it comes to rest soon.
    fn calm(&self) -> Self {
        const DAMPING_S: f64 = 0.15;
        let mut calm = self.clone();
        for gap in &mut calm.gaps {
            gap.damping_s = DAMPING_S;
            for member in &mut gap.members {
                member.frictions = [Friction::default(); 2];
                member.branch_n_m = [0.0; BRANCHES];
                member.damping_n_s_m = member.stiffness_n_m * DAMPING_S;
            }
        }
        calm
    }

    /// Exchanges the end body for one that has its centre of mass elsewhere; what is fixed to it stays where it is.
    pub fn exchange_end(&mut self, body: Body) {
        let last = self.bodies.len().wrapping_sub(1);
        let Some(end) = self.bodies.get_mut(last) else {
            return;
        };
        for spring in self.springs.iter_mut().filter(|s| s.lower == last) {
            spring.lower_m += body.upper_m - end.upper_m;
        }
        *end = body;
    }

    /// Indices of the middle and the end pad.
    pub fn pads(&self) -> [usize; 2] {
        let per_segment = self.bodies.len() / 2;
        [per_segment - 1, 2 * per_segment - 1]
    }

    fn ends_of_gap(&self, i: usize, poses: &[Pose]) -> (Pose, Pose) {
        let above = match i {
            0 => self.base,
            _ => at(&poses[i - 1], &self.bodies[i - 1].lower_m),
        };
        (above, at(&poses[i], &self.bodies[i].upper_m))
    }

    /// Strain of each gap with the bodies at these poses.
    fn strains(&self, poses: &[Pose]) -> Vec<Strain> {
        let gaps = self.gaps.iter().enumerate();
        gaps.map(|(i, gap)| {
            let (a, b) = self.ends_of_gap(i, poses);
            Strain::between(&a, &b, &gap.elastic)
        })
        .collect()
    }

    /// Volume of each chamber with members of these lengths, m³.
    pub fn volumes_m3(&self, lengths_m: &[[f64; 3]]) -> [f64; CHAMBERS] {
        let mut out = [self.dead_m3; CHAMBERS];
        for (gap, lengths) in self.gaps.iter().zip(lengths_m) {
            for k in 0..3 {
                out[gap.chamber[k]] += gap.members[k].volume_m3(lengths[k]);
            }
        }
        out
    }

    /// Ends of a spring, base frame, m.
    pub fn spring_ends_m(&self, spring: &Spring, poses: &[Pose]) -> [Vector3<f64>; 2] {
        let upper = match spring.upper {
            None => point(&self.base, &spring.upper_m),
            Some(i) => point(&poses[i], &spring.upper_m),
        };
        [upper, point(&poses[spring.lower], &spring.lower_m)]
    }

    fn add_springs(&self, poses: &[Pose], wrenches: &mut [Wrench]) {
        for s in &self.springs {
            let [upper, lower] = self.spring_ends_m(s, poses);
            let d = lower - upper;
            let length = d.norm();
            let force = d * (s.rate_n_m * (length - s.free_m).max(0.0) / length);
            if let Some(i) = s.upper {
                add(
                    &mut wrenches[i],
                    &force,
                    &(upper - poses[i].translation.vector),
                );
            }
            let arm = lower - poses[s.lower].translation.vector;
            add(&mut wrenches[s.lower], &-force, &arm);
        }
    }
}

impl Chain {
    /// All bodies straight below the base at the members' rest lengths, at rest.
    pub fn straight(arm: &Arm) -> Self {
        let mut above = arm.base;
        let mut motions = Vec::new();
        for (body, gap) in arm.bodies.iter().zip(&arm.gaps) {
            let down = Vector3::new(0.0, 0.0, -gap.members[0].rest_m);
            let connected = at(&above, &down);
            let pose = at(&connected, &-body.upper_m);
            motions.push(Motion {
                pose,
                momentum: Vector6::zeros(),
                velocity: Vector6::zeros(),
            });
            above = at(&pose, &body.lower_m);
        }
        let mut out = Self {
            motions,
            memories: vec![[Memory::default(); 3]; arm.gaps.len()],
            lengths_m: vec![[0.0; 3]; arm.gaps.len()],
            strains: vec![Default::default(); arm.gaps.len()],
            factors: Vec::new(),
            factored_for_s: 0.0,
            iterations: 0,
        };
        let poses = out.poses();
        for (i, strain) in arm.strains(&poses).into_iter().enumerate() {
            out.lengths_m[i] = strain.length_m;
            out.strains[i] = (strain.u_m, strain.psi);
        }
        out
    }

    /// At rest where these gauge pressures (Pa) are kept, with nothing remembered: found by waiting with an arm that is
    /// damped more, has no friction and does not creep, which stands at the same place.
    ///
    /// # Errors
    /// When a step does not converge, or the arm has not come to rest after a minute.
    pub fn settled(
        arm: &Arm,
        gauge_pa: [f64; CHAMBERS],
        outside: &Outside,
    ) -> Result<Self, NoStep> {
        const STEP_S: f64 = 5e-3;
        const STEPS: usize = 12_000;
        let calm = arm.calm();
        let mut chain = Self::straight(&calm);
        for step in 1..=STEPS {
            chain.step(&calm, &Held(gauge_pa), outside, STEP_S)?;
            // The first steps start from rest.
            if step > 20 && chain.speed_m_s() < SETTLED_M_S {
                for m in &mut chain.motions {
                    m.momentum.fill(0.0);
                    m.velocity.fill(0.0);
                }
                chain.forget(arm);
                return Ok(chain);
            }
        }
        Err(NoStep {
            correction: chain.speed_m_s() * STEP_S,
        })
    }

    /// Forgets how the bellows were moved: no friction, everything relaxed.
    pub fn forget(&mut self, arm: &Arm) {
        for (i, gap) in arm.gaps.iter().enumerate() {
            for (k, member) in gap.members.iter().enumerate() {
                self.memories[i][k] = member.relaxed(self.lengths_m[i][k]);
            }
        }
        self.factors.clear();
    }

    /// Exchanges the last body for `body`, which has its centre of mass elsewhere; the pad stays and keeps its speed.
    pub fn exchange_end(&mut self, before: &Body, body: &Body) {
        let Some(m) = self.motions.last_mut() else {
            return;
        };
        let pad = at(&m.pose, &before.upper_m);
        let speed = inertia(before, &m.pose)
            .cholesky()
            .map(|i| i.solve(&m.momentum));
        m.pose = at(&pad, &-body.upper_m);
        if let Some(speed) = speed {
            m.momentum = inertia(body, &m.pose) * speed;
        }
        self.factors.clear();
    }

    /// Velocity of a body's centre of mass and its angular rate now, base axes, m/s and rad/s.
    pub fn velocity(&self, arm: &Arm, body: usize) -> Vector6<f64> {
        let m = &self.motions[body];
        let factor = inertia(&arm.bodies[body], &m.pose).cholesky();
        factor.map_or(m.velocity, |i| i.solve(&m.momentum))
    }

    /// Base from each pad; a pad's origin is the centre of its upper face.
    pub fn pads(&self, arm: &Arm) -> [Pose; 2] {
        arm.pads()
            .map(|i| at(&self.motions[i].pose, &arm.bodies[i].upper_m))
    }

    /// Length of each bellows, m.
    pub fn bellows_m(&self, arm: &Arm) -> [f64; CHAMBERS] {
        let mut out = [0.0; CHAMBERS];
        for (gap, lengths) in arm.gaps.iter().zip(&self.lengths_m) {
            for k in 0..3 {
                out[gap.chamber[k]] += lengths[k];
            }
        }
        out
    }

    /// Largest speed of a body, m/s.
    pub fn speed_m_s(&self) -> f64 {
        let speed = |m: &Motion| m.velocity.fixed_rows::<3>(0).norm();
        self.motions.iter().map(speed).fold(0.0, f64::max)
    }

    /// Base from each body.
    pub fn poses(&self) -> Vec<Pose> {
        self.motions.iter().map(|m| m.pose).collect()
    }

    /// Moves by `h_s`.
    ///
    /// # Errors
    /// When Newton's iteration does not converge; nothing has moved.
    pub fn step(
        &mut self,
        arm: &Arm,
        air: &dyn Air,
        outside: &Outside,
        h_s: f64,
    ) -> Result<(), NoStep> {
        let n = arm.bodies.len();
        let half = 0.5 * h_s;
        let mut v: Vec<Vector6<f64>> = self.motions.iter().map(|m| m.velocity).collect();
        let mut last = f64::INFINITY;
        let mut stale = self.factored_for_s != h_s || self.factors.len() != n;
        self.iterations = 0;
        let mut poses;
        let mut strains;
        loop {
            self.iterations += 1;
            poses = (0..n)
                .map(|i| moved(&self.motions[i].pose, &(v[i] * half)))
                .collect::<Vec<_>>();
            strains = arm.strains(&poses);
            let axial = self.axial(arm, &strains, air, half);
            if stale {
                self.factor(arm, &poses, &strains, &axial, h_s);
            }
            let wrenches = self.wrenches(arm, &poses, &strains, &axial, outside, half);
            let mut r: Vec<Vector6<f64>> = (0..n)
                .map(|i| {
                    let p = inertia(&arm.bodies[i], &poses[i]) * v[i];
                    self.motions[i].momentum + wrenches[i] * half - p
                })
                .collect();
            self.solve(&mut r);
            let mut correction: f64 = 0.0;
            for i in 0..n {
                v[i] += r[i];
                correction = correction.max(r[i].amax() * half);
            }
            if correction < TOLERANCE {
                break;
            }
            if !correction.is_finite() || self.iterations >= MOST_ITERATIONS {
                self.factors.clear();
                return Err(NoStep { correction });
            }
            stale = correction > SLOW * last;
            last = correction;
        }
        self.commit(arm, &v, &poses, &strains, h_s);
        Ok(())
    }

    fn axial(&self, arm: &Arm, strains: &[Strain], air: &dyn Air, dt_s: f64) -> Vec<[Axial; 3]> {
        let lengths: Vec<[f64; 3]> = strains.iter().map(|s| s.length_m).collect();
        let volumes = arm.volumes_m3(&lengths);
        let gauge: [f64; CHAMBERS] = std::array::from_fn(|c| air.gauge_pa(c, volumes[c]));
        (0..strains.len())
            .map(|i| {
                let gap = &arm.gaps[i];
                std::array::from_fn(|k| {
                    gap.members[k].tension(
                        &self.memories[i][k],
                        self.lengths_m[i][k],
                        lengths[i][k],
                        gauge[gap.chamber[k]],
                        dt_s,
                    )
                })
            })
            .collect()
    }

    fn wrenches(
        &self,
        arm: &Arm,
        poses: &[Pose],
        strains: &[Strain],
        axial: &[[Axial; 3]],
        outside: &Outside,
        dt_s: f64,
    ) -> Vec<Wrench> {
        let mut out = vec![Wrench::zeros(); poses.len()];
        for (w, body) in out.iter_mut().zip(&arm.bodies) {
            let weight = arm.gravity_m_s2 * body.mass_kg;
            add(w, &weight, &Vector3::zeros());
        }
        for (i, strain) in strains.iter().enumerate() {
            let gap = &arm.gaps[i];
            let e = &gap.elastic;
            let (mut f, mut m) = strain.gradient(e, &axial[i]);
            // Kelvin-Voigt damping of central tube and folds.
            let c = gap.damping_s / dt_s;
            let (u0, p0) = self.strains[i];
            let (du, dp) = (strain.u_m - u0, strain.psi - p0);
            let lateral = e.tube_shear_n_m + e.lateral_n_m.iter().sum::<f64>();
            f += Vector3::new(lateral * du.x, lateral * du.y, 0.0) * c;
            m += e.tube_nm_rad.component_mul(&dp) * c;
            let [upper, lower] = strain.wrenches(&f, &m);
            let mut put = |k: usize, w: &Wrench, r: &Vector3<f64>| {
                let force = Vector3::new(w[0], w[1], w[2]);
                add(&mut out[k], &force, &(poses[k].rotation * r));
                for j in 3..6 {
                    out[k][j] += w[j];
                }
            };
            if i > 0 {
                put(i - 1, &upper, &arm.bodies[i - 1].lower_m);
            }
            put(i, &lower, &arm.bodies[i].upper_m);
        }
        arm.add_springs(poses, &mut out);
        for (k, w) in &outside.wrenches {
            out[*k] += w;
        }
        out
    }

    fn factor(
        &mut self,
        arm: &Arm,
        poses: &[Pose],
        strains: &[Strain],
        axial: &[[Axial; 3]],
        h_s: f64,
    ) {
        let n = poses.len();
        let quarter = 0.25 * h_s * h_s;
        let mut diagonal: Vec<Matrix6<f64>> =
            (0..n).map(|i| inertia(&arm.bodies[i], &poses[i])).collect();
        let mut below = vec![Matrix6::zeros(); n];
        for i in 0..n {
            let gap = &arm.gaps[i];
            let damped = 1.0 + gap.damping_s / (0.5 * h_s);
            let e = Elastic {
                lateral_n_m: gap.elastic.lateral_n_m.map(|k| k * damped),
                tube_shear_n_m: gap.elastic.tube_shear_n_m * damped,
                tube_nm_rad: gap.elastic.tube_nm_rad * damped,
                ..gap.elastic.clone()
            };
            let k = strains[i].hessian(&e, &axial[i]);
            let rho_b = poses[i].rotation * arm.bodies[i].upper_m;
            diagonal[i] += shifted(&k[1][1], &rho_b, &rho_b) * quarter;
            if i > 0 {
                let rho_a = poses[i - 1].rotation * arm.bodies[i - 1].lower_m;
                diagonal[i - 1] += shifted(&k[0][0], &rho_a, &rho_a) * quarter;
                below[i - 1] = shifted(&k[0][1], &rho_a, &rho_b) * quarter;
            }
        }
        self.factors.clear();
        let mut carry = Matrix6::zeros();
        for i in 0..n {
            let d = diagonal[i] - carry;
            let d = 0.5 * (d + d.transpose());
            let Some(pivot) = Cholesky::new(d) else {
                // Buckled beyond what inertia holds within a step: the step fails.
                self.factors.clear();
                return;
            };
            carry = below[i].tr_mul(&pivot.solve(&below[i]));
            self.factors.push(Factor {
                pivot,
                below: below[i],
            });
        }
        self.factored_for_s = h_s;
    }

    fn solve(&self, r: &mut [Vector6<f64>]) {
        if self.factors.len() != r.len() {
            r.iter_mut().for_each(|x| x.fill(f64::NAN));
            return;
        }
        let n = r.len();
        for i in 0..n {
            if i > 0 {
                let before = self.factors[i - 1].below.tr_mul(&r[i - 1]);
                r[i] -= before;
            }
            self.factors[i].pivot.solve_mut(&mut r[i]);
        }
        for i in (0..n - 1).rev() {
            let mut back = self.factors[i].below * r[i + 1];
            self.factors[i].pivot.solve_mut(&mut back);
            r[i] -= back;
        }
    }

    fn commit(
        &mut self,
        arm: &Arm,
        v: &[Vector6<f64>],
        mids: &[Pose],
        mid_strains: &[Strain],
        h_s: f64,
    ) {
        let half = 0.5 * h_s;
        for i in 0..v.len() {
            let m = &mut self.motions[i];
            m.pose = moved(&mids[i], &(v[i] * half));
            // π_{n+1} = 2 π_m − π_n
            m.momentum = inertia(&arm.bodies[i], &mids[i]) * v[i] * 2.0 - m.momentum;
            m.velocity = v[i];
        }
        let poses = self.poses();
        for (i, strain) in arm.strains(&poses).into_iter().enumerate() {
            for k in 0..3 {
                arm.gaps[i].members[k].remember(
                    &mut self.memories[i][k],
                    self.lengths_m[i][k],
                    mid_strains[i].length_m[k],
                    strain.length_m[k],
                    h_s,
                );
            }
            self.lengths_m[i] = strain.length_m;
            self.strains[i] = (strain.u_m, strain.psi);
        }
    }

    /// Kinetic and elastic energy with gravity and springs at held pressures, without memory and damping, J.
    pub fn energy_j(&self, arm: &Arm, gauge_pa: &[f64; CHAMBERS]) -> f64 {
        let poses = self.poses();
        let mut sum = 0.0;
        for (i, m) in self.motions.iter().enumerate() {
            let body = &arm.bodies[i];
            let p = inertia(body, &m.pose);
            let rate = p.try_inverse().unwrap_or_default() * m.momentum;
            sum += 0.5 * m.momentum.dot(&rate);
            sum -= body.mass_kg * arm.gravity_m_s2.dot(&m.pose.translation.vector);
            let gap = &arm.gaps[i];
            let (a, b) = arm.ends_of_gap(i, &poses);
            let s = Strain::between(&a, &b, &gap.elastic);
            for k in 0..3 {
                let member = &gap.members[k];
                sum += member.energy_j(s.length_m[k])
                    - gauge_pa[gap.chamber[k]] * member.volume_m3(s.length_m[k]);
                let d = s.chord_m[k];
                sum += 0.5 * gap.elastic.lateral_n_m[k] * (d.x * d.x + d.y * d.y);
            }
            sum += 0.5 * gap.elastic.tube_shear_n_m * (s.u_m.x.powi(2) + s.u_m.y.powi(2));
            sum += 0.5 * gap.elastic.core_n_m * (s.u_m.z + gap.elastic.core_rest_m).powi(2);
            sum += 0.5 * s.psi.dot(&gap.elastic.tube_nm_rad.component_mul(&s.psi));
        }
        for s in &arm.springs {
            let [a, b] = arm.spring_ends_m(s, &poses);
            sum += 0.5 * s.rate_n_m * ((b - a).norm() - s.free_m).max(0.0).powi(2);
        }
        sum
    }

    /// Wrench that the arm puts on the base, about its origin, base axes: what its gap and springs pull with.
    pub fn on_base(&self, arm: &Arm, air: &dyn Air) -> Wrench {
        let poses = self.poses();
        let strains = arm.strains(&poses);
        let axial = self.axial(arm, &strains, air, 1e-9);
        let (f, m) = strains[0].gradient(&arm.gaps[0].elastic, &axial[0]);
        let mut out = strains[0].wrenches(&f, &m)[0];
        for s in &arm.springs {
            if s.upper.is_none() {
                let [upper, lower] = arm.spring_ends_m(s, &poses);
                let d = lower - upper;
                let force = d * (s.rate_n_m * (d.norm() - s.free_m).max(0.0) / d.norm());
                add(&mut out, &force, &(upper - arm.base.translation.vector));
            }
        }
        out
    }
}
