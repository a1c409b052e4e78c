//! One manufactured arm from its drawing: a robot file gives nominal numbers, a unit's seed the scatter.
//!
//! A segment's bellows are cut by `rings` rigid rings into `rings + 1` members each; a member is as many times
//! stiffer than the bellows. The bellows' mass is shared among rings and pads. What the robot file calls the torsional
//! stiffness of a segment comes from the folds' lateral stiffness at the bellows' radius and from the central tube.

use nalgebra::{Matrix3, Vector3};
use rand::SeedableRng;
use rand_distr::{Distribution, Normal};
use rand_pcg::Pcg64Mcg;

use super::chain::{Arm, Body, Gap, Spring};
use super::gap::Elastic;
use super::member::{Friction, Member};
use crate::robot::RobotSpec;
use crate::signal::{Pose, SPRINGS};

/// Standard gravity, m/s².
pub const GRAVITY_M_S2: f64 = 9.806_65;
/// Rings per segment unless a test asks for others.
pub const RINGS: usize = 8;

/// Properties beyond the robot file: how bellows, central tube and lines behave beyond their nominal numbers.
#[derive(Clone, Debug, PartialEq)]
pub struct Character {
    /// Rings per segment.
    pub rings: usize,
    /// Stiffness of bellows and central tube over the drawing's.
    pub stiffness: f64,
    /// Relative standard deviation of a bellows' stiffness; areas have half, central tubes twice, lengths a fifth of it.
    pub scatter: f64,
    /// Standard deviation of each coordinate of a spring's end, m.
    pub attachment_m: f64,
    /// Share by which a bellows is stiffer than linear at its full stroke.
    pub hardening: f64,
    /// Relative change of the effective area with relative extension.
    pub area_slope: f64,
    /// Viscoelastic branches of the rubber: share of the stiffness, and time constant (s).
    pub branches: [(f64, f64); 3],
    /// Largest friction force of a bellows, N.
    pub friction_n: f64,
    /// Extension of a bellows over which friction builds up, m.
    pub presliding_m: f64,
    /// Structural damping: force per rate of the elastic force, s.
    pub damping_s: f64,
    /// Shear rigidity of the central tube, N.
    pub tube_shear_n: f64,
    /// Share of the torsional stiffness that the folds give.
    pub fold_torsion: f64,
    /// Air in a chamber's fittings, m³.
    pub dead_m3: f64,
}

impl Default for Character {
    fn default() -> Self {
        Self {
            rings: RINGS,
            stiffness: 1.0,
            scatter: 0.012,
            attachment_m: 0.5e-3,
            hardening: 0.15,
            area_slope: -0.1,
            branches: [(0.04, 0.06), (0.03, 1.0), (0.03, 20.0)],
            friction_n: 3.0,
            presliding_m: 6e-3,
            damping_s: 6e-3,
            tube_shear_n: 6000.0,
            fold_torsion: 0.4,
            dead_m3: 50e-6,
        }
    }
}

impl Character {
    /// Elastic and as drawn: no scatter, no hardening, no memory, no friction, an area that does not vary.
    pub fn elastic() -> Self {
        Self {
            scatter: 0.0,
            attachment_m: 0.0,
            hardening: 0.0,
            area_slope: 0.0,
            branches: [(0.0, 1.0); 3],
            friction_n: 0.0,
            ..Self::default()
        }
    }
}

/// Inertia of a disc of a radius and a height (m) about its centre.
fn disc(mass_kg: f64, radius_m: f64, height_m: f64) -> Matrix3<f64> {
    let polar = 0.5 * mass_kg * radius_m * radius_m;
    let side = 0.5 * polar + mass_kg * height_m * height_m / 12.0;
    Matrix3::from_diagonal(&Vector3::new(side, side, polar))
}

struct Maker<'a> {
    robot: &'a RobotSpec,
    character: &'a Character,
    rng: Pcg64Mcg,
}

impl Maker<'_> {
    fn normal(&mut self, sd: f64) -> f64 {
        // A standard deviation of a robot's drawing is finite and not negative.
        Normal::new(0.0, sd).map_or(0.0, |n| n.sample(&mut self.rng))
    }

    fn factor(&mut self, sd: f64) -> f64 {
        (1.0 + self.normal(sd)).max(0.1)
    }

    fn member(&mut self, chamber: usize) -> Member {
        let (r, c) = (self.robot, self.character);
        let share = (c.rings + 1) as f64;
        let stiffness_n_m =
            c.stiffness * r.axial_stiffness_n_m[chamber] * self.factor(c.scatter) * share;
        let rest_m = r.rest_length_m * self.factor(0.2 * c.scatter) / share;
        let [shortest, longest] = r.length_range_m;
        Member {
            rest_m,
            stiffness_n_m,
            hardening: c.hardening,
            span_m: (longest - r.rest_length_m) / share,
            // Folds touch a little beyond the shortest length in use.
            contact_m: 0.9 * shortest / share,
            contact_n_m: 20.0 * stiffness_n_m,
            branch_n_m: std::array::from_fn(|j| {
                c.branches.get(j).map_or(0.0, |b| b.0 * stiffness_n_m)
            }),
            branch_s: std::array::from_fn(|j| c.branches.get(j).map_or(1.0, |b| b.1)),
            stretch: 0.0,
            pull_n: 0.0,
            frictions: [
                Friction {
                    coulomb_force_n: c.friction_n,
                    presliding_m: c.presliding_m / share,
                },
                Friction::default(),
            ],
            damping_n_s_m: stiffness_n_m * c.damping_s,
            area_m2: r.area_m2[chamber] * self.factor(0.5 * c.scatter),
            area_slope: c.area_slope,
        }
    }

    fn segment(&mut self, segment: usize, arm: &mut Arm) {
        let (r, c) = (self.robot, self.character);
        let share = (c.rings + 1) as f64;
        let chamber: [usize; 3] = std::array::from_fn(|k| 3 * segment + k);
        let at_m = chamber.map(|i| r.bellows_m[i]);
        let square_m2: f64 = at_m.iter().map(Vector3::norm_squared).sum();
        let torsion =
            c.stiffness * r.segments[segment].torsional_nm_rad * self.factor(2.0 * c.scatter);
        let bending =
            c.stiffness * r.segments[segment].bending_nm_rad * self.factor(2.0 * c.scatter);
        let fold_n_m = c.fold_torsion * torsion / square_m2;
        let members: [Member; 3] = chamber.map(|i| self.member(i));
        let gap = Gap {
            elastic: Elastic {
                at_m,
                lateral_n_m: [fold_n_m * share; 3],
                tube_shear_n_m: c.stiffness * c.tube_shear_n / r.rest_length_m * share,
                core_n_m: c.stiffness * r.segments[segment].axial_n_m * share,
                core_rest_m: r.rest_length_m / share,
                tube_nm_rad: Vector3::new(bending, bending, (1.0 - c.fold_torsion) * torsion)
                    * share,
            },
            members,
            chamber,
            damping_s: c.damping_s,
        };
        let ring_kg = 3.0 * r.bellows_kg / share;
        let length_m = r.rest_length_m / share;
        let radius_m = (square_m2 / 3.0).sqrt();
        let mut inertia = disc(ring_kg, 0.5 * r.bellows_outer_diameter_m, length_m);
        let spread = ring_kg * radius_m * radius_m;
        inertia += Matrix3::from_diagonal(&Vector3::new(0.5 * spread, 0.5 * spread, spread));
        let ring = Body {
            mass_kg: ring_kg,
            inertia_kg_m2: inertia,
            upper_m: Vector3::zeros(),
            lower_m: Vector3::zeros(),
        };
        arm.gaps.extend(std::iter::repeat_n(gap, c.rings + 1));
        arm.bodies.extend(std::iter::repeat_n(ring, c.rings));
    }

    fn springs(&mut self, arm: &mut Arm) {
        let (r, sd) = (self.robot, self.character.attachment_m);
        let pads = arm.pads();
        arm.springs = (0..SPRINGS)
            .map(|i| {
                let (upper, lower) = if i < SPRINGS / 2 {
                    (None, pads[0])
                } else {
                    (Some(pads[0]), pads[1])
                };
                let mut scattered =
                    |at: Vector3<f64>| at + Vector3::from_fn(|_, _| self.normal(sd));
                let lower_face = upper.map_or(Vector3::zeros(), |b: usize| arm.bodies[b].lower_m);
                Spring {
                    upper,
                    lower,
                    upper_m: scattered(lower_face + r.spring_top_m[i]),
                    lower_m: scattered(arm.bodies[lower].upper_m + r.spring_bottom_m[i]),
                    rate_n_m: r.spring.rate_n_m,
                    free_m: r.spring.free_length_m,
                }
            })
            .collect();
    }
}

/// Masses on the end pad that are not where the drawing has them.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Aside {
    /// Displacement of the gripper's centre of mass in the pad's axes, m.
    pub gripper_m: Vector3<f64>,
    /// A further mass, kg.
    pub kg: f64,
    /// Its displacement from the payload's place, pad axes, m.
    pub at_m: Vector3<f64>,
}

/// End pad, gripper and payload as one body; z from the pad's upper face, its origin.
pub fn end_body(robot: &RobotSpec, rings: usize, payload_kg: f64, aside: &Aside) -> Body {
    let ring_kg = 3.0 * robot.bellows_kg / (rings + 1) as f64;
    let t = robot.pad_thickness_m;
    let pad_kg = robot.end_pad_kg + 0.5 * ring_kg;
    let below = |z_m: f64| Vector3::new(0.0, 0.0, -z_m);
    let parts = [
        (pad_kg, below(0.5 * t)),
        (
            robot.gripper_kg,
            below(robot.gripper_com_m) + aside.gripper_m,
        ),
        (payload_kg, below(robot.payload_com_m)),
        (aside.kg, below(robot.payload_com_m) + aside.at_m),
    ];
    let mass_kg: f64 = parts.iter().map(|p| p.0).sum();
    let com_m = parts.iter().map(|p| p.1 * p.0).sum::<Vector3<f64>>() / mass_kg;
    let own = disc(pad_kg, pad_radius_m(robot), t) + disc(robot.gripper_kg, 0.03, 0.08);
    let spread = |(kg, at_m): &(f64, Vector3<f64>)| {
        let r = at_m - com_m;
        (Matrix3::identity() * r.norm_squared() - r * r.transpose()) * *kg
    };
    Body {
        mass_kg,
        inertia_kg_m2: own + parts.iter().map(spread).sum::<Matrix3<f64>>(),
        upper_m: -com_m,
        lower_m: Vector3::zeros(),
    }
}

fn pad_radius_m(robot: &RobotSpec) -> f64 {
    robot.bellows_m[0].norm() + 0.5 * robot.bellows_outer_diameter_m
}

/// The arm of a seed that hangs from its base and carries `payload_kg` in its gripper. The same seed is always the
/// same arm.
pub fn make(robot: &RobotSpec, seed: u64, payload_kg: f64, character: &Character) -> Arm {
    let mut arm = Arm {
        bodies: Vec::new(),
        gaps: Vec::new(),
        springs: Vec::new(),
        base: Pose::identity(),
        gravity_m_s2: Vector3::new(0.0, 0.0, -GRAVITY_M_S2),
        dead_m3: character.dead_m3,
    };
    let mut maker = Maker {
        robot,
        character,
        rng: Pcg64Mcg::seed_from_u64(seed),
    };
    let t = robot.pad_thickness_m;
    let face_m = Vector3::new(0.0, 0.0, 0.5 * t);
    let ring_kg = 3.0 * robot.bellows_kg / (character.rings + 1) as f64;
    maker.segment(0, &mut arm);
    let middle_kg = robot.middle_pad_kg + ring_kg;
    arm.bodies.push(Body {
        mass_kg: middle_kg,
        inertia_kg_m2: disc(middle_kg, pad_radius_m(robot), t),
        upper_m: face_m,
        lower_m: -face_m,
    });
    maker.segment(1, &mut arm);
    arm.bodies.push(end_body(
        robot,
        character.rings,
        payload_kg,
        &Aside::default(),
    ));
    maker.springs(&mut arm);
    arm
}
