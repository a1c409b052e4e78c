//! The rod model against results known from elsewhere.
//!
//! | case | source |
//! |---|---|
//! | elastica | K. Mattiasson, "Numerical results from large deflection beam and frame problems analysed by means of elliptic integrals", IJNME 17, 1981, 145-153, doi:10.1002/nme.1620170113 |
//! | ring, helix, Euler's column | geometry and linear stability; L. Euler 1744 |
//! | column under its own weight | A. G. Greenhill, "Determination of the greatest height consistent with stability that a vertical pole or mast can be made", Proc. Cambridge Phil. Soc. 4, 1881 |
//! | 45° bend | K.-J. Bathe, S. Bolourchi, "Large displacement analysis of three-dimensional beam structures", IJNME 14, 1979, 961-986, doi:10.1002/nme.1620140703; the values are those of J. C. Simo, L. Vu-Quoc, "A three-dimensional finite-strain rod model, part II", CMAME 58, 1986, 79-116, doi:10.1016/0045-7825(86)90079-4 |
//! | shear | S. P. Timoshenko's cantilever, both customary shear factors |
//! | energy | conserved without damping, only lost with it |
//! | reference robot | an independent multibody model with rigid discs |

use std::f64::consts::{FRAC_PI_2, FRAC_PI_4, PI, TAU};

use nalgebra::{Rotation3, Vector3};

use super::rod::se3::Frame;
use super::rod::{Kinematics, Loads, Rod, Section, Strains, Workspace, is_stable, solve};
use super::{Inputs, Model, State, mechanical_energy, observe, settle, step_dynamics};
use crate::robot::RobotSpec;
use crate::signal::{CHAMBERS, ypr_from_rotation};

/// One comparison.
#[derive(Clone, Debug, PartialEq)]
pub struct Case {
    /// What is compared.
    pub name: String,
    /// Unit of the three numbers; empty for ratios.
    pub unit: &'static str,
    /// What should come out.
    pub expected: f64,
    /// What came out; not a number when the solver failed.
    pub got: f64,
    /// Largest absolute difference that passes.
    pub tolerance: f64,
    /// Whether it passed.
    pub ok: bool,
}

impl Case {
    fn new(
        name: impl Into<String>,
        unit: &'static str,
        expected: f64,
        got: f64,
        tolerance: f64,
    ) -> Self {
        Self {
            name: name.into(),
            unit,
            expected,
            got,
            tolerance,
            ok: (got - expected).abs() <= tolerance,
        }
    }

    fn relative(
        name: impl Into<String>,
        unit: &'static str,
        expected: f64,
        got: f64,
        share: f64,
    ) -> Self {
        Self::new(name, unit, expected, got, share * expected.abs())
    }
}

/// Every case of the validation, in a fixed order.
pub fn validate() -> Vec<Case> {
    let mut out = Vec::new();
    elastica(&mut out);
    ring(&mut out);
    helix(&mut out);
    columns(&mut out);
    bend_45(&mut out);
    timoshenko(&mut out);
    energy(&mut out);
    frame_indifference(&mut out);
    reference_robot(&mut out);
    out
}

/// Rigidity that stands for infinite where the theory has no stretch and no shear, over EI / L².
const RIGID: f64 = 1e7;

/// A plain cantilever along −z without weight.
fn cantilever(elements: usize, length_m: f64, rigidity: [f64; 6]) -> Rod {
    Rod {
        sections: vec![Section {
            elements,
            length_m,
            rigidity,
            rest: [0.0, 0.0, 0.0, 0.0, 0.0, -1.0],
            bellows: Vec::new(),
            links: Vec::new(),
            kg_per_m: 0.0,
            masses: Vec::new(),
            offset_m: Vector3::zeros(),
        }],
        strains: Strains::All,
        gravity_m_s2: Vector3::zeros(),
        base: Frame::identity(),
        floor: None,
    }
}

/// EI = L = 1, inextensible, without shear.
fn unit_cantilever(elements: usize) -> Rod {
    cantilever(elements, 1.0, [1.0, 1.0, 1.0, RIGID, RIGID, RIGID])
}

/// The settled tip; not a number when the solver fails.
fn tip(rod: &Rod, loads: &Loads) -> Frame {
    let mut q = rod.rest_state();
    if solve(rod, loads, &mut q, &mut Workspace::default()).converged {
        Kinematics::at(rod, &q).tip()
    } else {
        Frame {
            r: Frame::identity().r * f64::NAN,
            p: Vector3::repeat(f64::NAN),
        }
    }
}

fn elastica(out: &mut Vec<Case>) {
    let expected = [
        (1.0, 0.301_721, 0.943_567),
        (2.0, 0.493_457, 0.839_358),
        (5.0, 0.713_792, 0.612_372),
        (10.0, 0.810_609, 0.445_004),
    ];
    let rod = unit_cantilever(32);
    for (p, deflection, x) in expected {
        let got = tip(
            &rod,
            &Loads {
                tip_force_n: Vector3::x() * p,
                ..Loads::default()
            },
        );
        let name = |what: &str| format!("elastica P L²/EI = {p}: {what}");
        out.push(Case::relative(
            name("deflection / L"),
            "",
            deflection,
            got.p.x,
            2e-3,
        ));
        out.push(Case::relative(name("x / L"), "", x, -got.p.z, 2e-3));
    }
}

fn ring(out: &mut Vec<Case>) {
    // M = 2π EI / L bends the rod into one full circle.
    let got = tip(
        &unit_cantilever(32),
        &Loads {
            tip_moment_nm: Vector3::y() * TAU,
            ..Loads::default()
        },
    );
    out.push(Case::new(
        "pure moment closes the ring: gap / L",
        "",
        0.0,
        got.p.norm(),
        1e-6,
    ));
}

fn helix(out: &mut Vec<Case>) {
    let (kappa, tau) = (4.0, 3.0);
    let k2: f64 = kappa * kappa + tau * tau;
    // One turn has the length 2π / √(κ² + τ²).
    let elements = 32;
    let rod = cantilever(elements, TAU / k2.sqrt(), [1.0; 6]);
    let mut q = rod.rest_state();
    for xi in q.chunks_mut(6) {
        xi[0] = kappa;
        xi[2] = tau;
    }
    let at = Kinematics::at(&rod, &q);
    let nodes = at.section(0);
    let axis = Vector3::new(kappa, 0.0, tau).normalize();
    let across = |d: Vector3<f64>| (d - axis * d.dot(&axis)).norm();
    let radius = 0.5 * across(nodes[elements / 2].p - nodes[0].p);
    let pitch = (nodes[elements].p - nodes[0].p).dot(&axis).abs();
    out.push(Case::new(
        "helix from constant strain: radius",
        "m",
        kappa / k2,
        radius,
        1e-6,
    ));
    out.push(Case::new(
        "helix from constant strain: pitch",
        "m",
        TAU * tau / k2,
        pitch,
        1e-6,
    ));
}

/// The load at which the straight rod stops being stable, by bisection in (0, `upper`].
fn critical(upper: f64, mut stable_at: impl FnMut(f64) -> bool) -> f64 {
    let (mut low, mut high) = (0.0, upper);
    if !stable_at(low) || stable_at(high) {
        return f64::NAN;
    }
    while high - low > 1e-6 * upper {
        let middle = 0.5 * (low + high);
        if stable_at(middle) {
            low = middle;
        } else {
            high = middle;
        }
    }
    0.5 * (low + high)
}

fn columns(out: &mut Vec<Case>) {
    // The straight state is the state of rest: the rod is inextensible. The smallest eigenvalue
    // of the Hessian changes its sign at the critical load.
    let mut rod = unit_cantilever(32);
    let straight = rod.rest_state();
    let tip_load = critical(10.0, |p| {
        let loads = Loads {
            tip_force_n: Vector3::z() * p,
            ..Loads::default()
        };
        is_stable(&rod, &loads, &straight)
    });
    out.push(Case::relative(
        "buckling under a tip load, EI/L²",
        "",
        2.467,
        tip_load,
        1e-2,
    ));
    rod.sections[0].kg_per_m = 1.0;
    let own_weight = critical(20.0, |w| {
        rod.gravity_m_s2 = Vector3::z() * w;
        is_stable(&rod, &Loads::default(), &straight)
    });
    out.push(Case::relative(
        "buckling under its own weight, EI/L³",
        "",
        7.837,
        own_weight,
        1e-2,
    ));
}

/// Torsion constant of the bend over the fourth power of its side: the polar second moment a⁴/6,
/// which a rod without warping has and the reference values agree with (Saint-Venant's 0.1406 a⁴
/// moves the tip by about half a per cent of the length).
const SQUARE_TORSION: f64 = 1.0 / 6.0;

fn bend_45(out: &mut Vec<Case>) {
    let (e, radius) = (1e7, 100.0);
    let g = 0.5 * e;
    let ei = e / 12.0;
    // Shear areas without reduction, ν = 0.
    let mut rod = cantilever(
        32,
        radius * FRAC_PI_4,
        [ei, ei, g * SQUARE_TORSION, g, g, e],
    );
    rod.sections[0].rest[1] = 1.0 / radius;
    for (p, expected) in [
        (300.0, [22.33, 58.84, 40.08]),
        (600.0, [15.79, 47.23, 53.37]),
    ] {
        let at = tip(
            &rod,
            &Loads {
                tip_force_n: Vector3::y() * p,
                ..Loads::default()
            },
        )
        .p;
        // Across the chord in the plane of the bend, along the clamped tangent, along the force.
        let got = [at.x.abs(), -at.z, at.y];
        for (axis, (expected, got)) in ["x", "y", "z"].iter().zip(expected.iter().zip(got)) {
            let name = format!("45° bend, P = {p}, torsion constant a⁴/6: {axis}");
            out.push(Case::relative(name, "m", *expected, got, 1e-2));
        }
    }
}

fn timoshenko(out: &mut Vec<Case>) {
    let (length, radius, e, g, force): (f64, f64, f64, f64, f64) = (3.0, 0.25, 1e6, 1e4, 15.0);
    let area = PI * radius * radius;
    let second = PI * radius.powi(4) / 4.0;
    // δ = P L³ / (3 E I) + P L / (α G A)
    for (label, factor, expected) in [("27/28", 27.0 / 28.0, 0.06777), ("4/3", 4.0 / 3.0, 0.06119)]
    {
        let shear = factor * g * area;
        let rod = cantilever(
            32,
            length,
            [
                e * second,
                e * second,
                2.0 * g * second,
                shear,
                shear,
                e * area,
            ],
        );
        let got = tip(
            &rod,
            &Loads {
                tip_force_n: Vector3::x() * force,
                ..Loads::default()
            },
        );
        let name = format!("Timoshenko tip load, shear factor {label}");
        out.push(Case::relative(name, "m", expected, got.p.x, 1e-2));
    }
}

/// Steps of 1 ms: largest departure from the energy at the start and largest gain between looks,
/// both over the energy above rest.
fn released(model: &Model, tau_s: f64) -> Option<(f64, f64)> {
    let rest = Inputs::default();
    let bent = Inputs {
        chamber_pa: [10e3, -10e3, 0.0, 5e3, 0.0, -10e3],
        ..Inputs::default()
    };
    let total = |s: &State| {
        let e = mechanical_energy(model, s, &rest);
        e.kinetic_j + e.potential_j
    };
    let mut state = State::rest(model);
    settle(model, &mut state, &rest).ok()?;
    let lowest = total(&state);
    settle(model, &mut state, &bent).ok()?;
    let start = total(&state);
    let (mut before, mut departure, mut gain) = (start, 0.0f64, 0.0f64);
    for k in 1..=10_000 {
        step_dynamics(model, &mut state, &rest, tau_s, 1e-3).ok()?;
        if k % 5 == 0 {
            let now = total(&state);
            departure = departure.max((now - start).abs());
            gain = gain.max(now - before);
            before = now;
        }
    }
    Some((departure / (start - lowest), gain / (start - lowest)))
}

fn energy(out: &mut Vec<Case>) {
    // The reference robot let go from a bent state, its stiffest modes, which the step does not
    // resolve, included.
    let model = Model::nominal(&RobotSpec::reference());
    let departure = released(&model, 0.0).map_or(f64::NAN, |r| r.0);
    let gain = released(&model, 0.01).map_or(f64::NAN, |r| r.1);
    out.push(Case::new(
        "energy, undamped, 10 s: largest departure",
        "",
        0.0,
        departure,
        1e-3,
    ));
    out.push(Case::new(
        "energy, damped, 10 s: largest gain",
        "",
        0.0,
        gain,
        1e-12,
    ));
}

fn frame_indifference(out: &mut Vec<Case>) {
    let model = Model::nominal(&RobotSpec::reference());
    let inputs = Inputs {
        chamber_pa: [20e3, -20e3, -10e3, 15e3, -5e3, -20e3],
        payload_kg: 0.3,
        ..Inputs::default()
    };
    let relative = |base: Rotation3<f64>| {
        let mut turned = model.clone();
        turned.rod.base.r = *base.matrix();
        turned.rod.base.p = Vector3::new(0.3, -0.2, 0.1);
        turned.rod.gravity_m_s2 = base * model.rod.gravity_m_s2;
        let mut state = State::rest(&turned);
        settle(&turned, &mut state, &inputs).ok()?;
        let start = turned.rod.base;
        let at = Kinematics::at(&turned.rod, &state.strains);
        Some(
            (0..2)
                .flat_map(|s| at.section(s).to_vec())
                .map(|f| {
                    (
                        start.r.transpose() * (f.p - start.p),
                        start.r.transpose() * f.r,
                    )
                })
                .collect::<Vec<_>>(),
        )
    };
    let upright = relative(Rotation3::identity());
    let turned = relative(Rotation3::from_euler_angles(0.7, -FRAC_PI_2 + 0.3, 2.0));
    let worst = match (upright, turned) {
        (Some(a), Some(b)) => a
            .iter()
            .zip(&b)
            .map(|(a, b)| (a.0 - b.0).amax().max((a.1 - b.1).amax()))
            .fold(0.0, f64::max),
        _ => f64::NAN,
    };
    out.push(Case::new(
        "base turned together with gravity: change of the relative shape",
        "",
        0.0,
        worst,
        1e-9,
    ));
}

/// A pose of the reference robot, settled, by an independent rigid-disc engine.
pub(super) struct SettledPose {
    pub kpa: [f64; CHAMBERS],
    /// Position, mm, and yaw, pitch, roll, deg; to one decimal.
    pub mm: [f64; 3],
    pub ypr_deg: [f64; 3],
    /// How near the rod comes, mm and deg: what is measured, rounded up. Straight it is the same arm; where it bends, the
    /// other engine's discs and tendons give way elsewhere, and the turn agrees better than the place.
    pub rod_within: (f64, f64),
    /// How near the mesh comes.
    #[cfg_attr(
        not(test),
        allow(dead_code, reason = "the mesh is held to it by a test")
    )]
    pub mesh_within: (f64, f64),
}

/// The known poses.
pub(super) const REFERENCE_POSES: [SettledPose; 5] = [
    straight([0.0; 6], -296.6),
    straight([40.0; 6], -441.2),
    straight([-40.0; 6], -151.5),
    SettledPose {
        kpa: [40.0, -40.0, -40.0, 0.0, 0.0, 0.0],
        mm: [-143.4, 0.0, -219.9],
        ypr_deg: [0.0, 43.7, 0.0],
        rod_within: (7.1, 0.2),
        mesh_within: (7.7, 0.6),
    },
    SettledPose {
        kpa: [20.0, -20.0, -20.0, 20.0, -20.0, -20.0],
        mm: [-82.4, -17.7, -253.3],
        ypr_deg: [-2.3, 33.1, -21.1],
        rod_within: (6.7, 0.4),
        mesh_within: (5.6, 0.3),
    },
];

const fn straight(kpa: [f64; CHAMBERS], z_mm: f64) -> SettledPose {
    SettledPose {
        kpa,
        mm: [0.0, 0.0, z_mm],
        ypr_deg: [0.0; 3],
        rod_within: (0.15, 0.01),
        mesh_within: (0.15, 0.01),
    }
}

fn reference_robot(out: &mut Vec<Case>) {
    let model = Model::nominal(&RobotSpec::reference());
    for pose in REFERENCE_POSES {
        let SettledPose {
            kpa,
            mm,
            ypr_deg,
            rod_within: within,
            ..
        } = pose;
        let mut state = State::rest(&model);
        let inputs = Inputs {
            chamber_pa: kpa.map(|p| p * 1e3),
            ..Inputs::default()
        };
        let (mut off_mm, mut off_deg) = (f64::NAN, f64::NAN);
        if settle(&model, &mut state, &inputs).is_ok() {
            let pose = observe(&model, &state).base_from_tip;
            off_mm = (pose.translation.vector * 1e3 - Vector3::from(mm)).norm();
            let angles = ypr_from_rotation(&pose.rotation).map(f64::to_degrees);
            off_deg = (0..3)
                .map(|k| (angles[k] - ypr_deg[k]).abs())
                .fold(0.0, f64::max);
        }
        let name = |what: &str| {
            let list = kpa.map(|p| p.to_string()).join(", ");
            format!("reference robot at ({list}) kPa: {what} from the rigid-disc model")
        };
        out.push(Case::new(name("distance"), "mm", 0.0, off_mm, within.0));
        out.push(Case::new(
            name("largest angle"),
            "deg",
            0.0,
            off_deg,
            within.1,
        ));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_case_is_within_its_tolerance() {
        let cases = validate();
        for c in &cases {
            println!(
                "{:<80} {:>12.6} {:>12.6} {:>10.2e} {}",
                c.name, c.expected, c.got, c.tolerance, c.ok
            );
        }
        let failed: Vec<&Case> = cases.iter().filter(|c| !c.ok).collect();
        assert!(failed.is_empty(), "{failed:#?}");
        assert!(cases.len() >= 30);
    }

    #[test]
    fn a_solver_that_fails_is_a_case_that_fails() {
        assert!(!Case::new("", "", 0.0, f64::NAN, 1.0).ok);
        assert!(!Case::relative("", "", 2.0, 2.1, 0.01).ok);
    }
}
