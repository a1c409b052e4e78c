//! The robot as a rod: which numbers of the robot file become which stiffness.

use nalgebra::Vector3;

use super::rod::se3::Frame;
use super::rod::{
    Bellows, History, Integrator, Link, Loads, Outcome, PointMass, Rod, Section, StepLoads,
    Strains, Viscosity, Workspace, solve, solve_step,
};
use crate::robot::RobotSpec;
use crate::signal::CHAMBERS;

/// Standard gravity, m/s².
pub const GRAVITY_M_S2: f64 = 9.806_65;
/// Standard atmosphere, Pa.
pub const ATMOSPHERE_PA: f64 = 101_325.0;

/// Discretisation of the rod: elements and free strains.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Resolution {
    /// Elements per segment.
    pub elements: usize,
    /// Free strains.
    pub strains: Strains,
}

impl Default for Resolution {
    /// Six elements without shear: what the twin itself uses.
    fn default() -> Self {
        Self {
            elements: 6,
            strains: Strains::NoShear,
        }
    }
}

/// Parameters that differ from arm to arm; all ones and zeros for the nominal robot.
#[derive(Clone, Debug, PartialEq)]
pub struct Parameters {
    /// Axial stiffness of each bellows, as a factor.
    pub chamber_stiffness: [f64; CHAMBERS],
    /// Effective area of each chamber, as a factor.
    pub chamber_area: [f64; CHAMBERS],
    /// Rest length of each bellows, as a factor.
    pub rest_length: [f64; CHAMBERS],
    /// Cubic hardening of every bellows relative to its linear stiffness at unit stretch.
    pub hardening: f64,
    /// Bending stiffness of each segment, as a factor.
    pub bending: [f64; 2],
    /// Torsional stiffness of each segment, as a factor.
    pub torsion: [f64; 2],
    /// Shear rigidity of each segment over its axial rigidity (used when shear is free).
    pub shear: f64,
    /// Mass of the gripper, as a factor.
    pub gripper_mass: f64,
    /// Direction of gravity tilted by these angles about the base's x and y, rad.
    pub base_tilt_rad: [f64; 2],
}

impl Default for Parameters {
    fn default() -> Self {
        Self {
            chamber_stiffness: [1.0; CHAMBERS],
            chamber_area: [1.0; CHAMBERS],
            rest_length: [1.0; CHAMBERS],
            hardening: 0.0,
            bending: [1.0; 2],
            torsion: [1.0; 2],
            shear: 0.5,
            gripper_mass: 1.0,
            base_tilt_rad: [0.0; 2],
        }
    }
}

/// Inputs of a simulation: pressures, payload and forces.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Inputs {
    /// Gauge pressure of each chamber, 1 to 6, Pa.
    pub chamber_pa: [f64; CHAMBERS],
    /// Additional tension of each bellows (hysteresis, creep), N; positive shortens it.
    pub tension_n: [f64; CHAMBERS],
    /// Mass in the gripper, kg.
    pub payload_kg: f64,
    /// Force on the end pad's origin in the base frame, N.
    pub tip_force_n: [f64; 3],
}

/// The constant part of a simulation.
#[derive(Clone, Debug)]
pub struct Model {
    /// The robot.
    pub robot: RobotSpec,
    /// Its rod.
    pub rod: Rod,
    /// Effective area of each chamber, m².
    pub area_m2: [f64; CHAMBERS],
    /// Mass that hangs on the gripper besides the payload of the inputs, kg.
    pub hidden_kg: f64,
    /// Where payload hangs, in the end pad's frame, m.
    pub payload_m: Vector3<f64>,
    /// Force on the end pad's origin besides the one of the inputs, base frame, N.
    pub hidden_force_n: Vector3<f64>,
    /// Moment on the end pad, base frame, N m.
    pub hidden_moment_nm: Vector3<f64>,
    /// Tensions that follow the pressures.
    pub pulls: Vec<Pull>,
}

/// A tension of bellows as a function of all pressures.
#[derive(Clone, Copy, Debug)]
pub struct Pull {
    /// On which chamber (0-based); `None`: on every one.
    pub on: Option<usize>,
    /// N per unit of the function.
    pub coefficient: f64,
    /// The function: of the gauge pressures (Pa) and the chamber (0-based).
    pub of: fn(&[f64; CHAMBERS], usize) -> f64,
}

impl Model {
    /// The arm as a rod, without the patches of its file.
    pub fn bare(robot: &RobotSpec, parameters: &Parameters, resolution: Resolution) -> Self {
        let sections = (0..2)
            .map(|s| section(robot, parameters, resolution, s))
            .collect();
        let [tx, ty] = parameters.base_tilt_rad;
        let down = nalgebra::Rotation3::from_euler_angles(tx, ty, 0.0) * -Vector3::z();
        Self {
            robot: robot.clone(),
            rod: Rod {
                sections,
                strains: resolution.strains,
                gravity_m_s2: down * GRAVITY_M_S2,
                base: Frame::identity(),
                floor: None,
            },
            area_m2: std::array::from_fn(|i| robot.area_m2[i] * parameters.chamber_area[i]),
            hidden_kg: 0.0,
            payload_m: Vector3::new(0.0, 0.0, -robot.payload_com_m),
            hidden_force_n: Vector3::zeros(),
            hidden_moment_nm: Vector3::zeros(),
            pulls: Vec::new(),
        }
    }

    /// Pushing force of a bellows (0-based) at these pressures, N.
    fn push_n(&self, chamber_pa: &[f64; CHAMBERS], i: usize) -> f64 {
        let pulls = self.pulls.iter().filter(|p| p.on.is_none_or(|on| on == i));
        let pull_n: f64 = pulls.map(|p| p.coefficient * (p.of)(chamber_pa, i)).sum();
        chamber_pa[i] * self.area_m2[i] - pull_n
    }

    /// Derivatives of the pushing forces of all bellows after the pressure of one chamber (0-based), N/Pa.
    pub(super) fn push_per_pa(
        &self,
        chamber_pa: &[f64; CHAMBERS],
        chamber: usize,
    ) -> [f64; CHAMBERS] {
        // Exact for forces of at most the second power.
        const STEP_PA: f64 = 100.0;
        let moved = |by_pa: f64| {
            let mut p = *chamber_pa;
            p[chamber] += by_pa;
            p
        };
        let (less, more) = (moved(-STEP_PA), moved(STEP_PA));
        std::array::from_fn(|i| match self.pulls.is_empty() {
            true if i == chamber => self.area_m2[i],
            true => 0.0,
            false => (self.push_n(&more, i) - self.push_n(&less, i)) / (2.0 * STEP_PA),
        })
    }

    /// Payload as the plant's network is to know it, kg: `held_kg` and what the robot's patches hang on the gripper,
    /// within what the network has seen.
    pub fn carried_kg(&self, held_kg: f64) -> f64 {
        (held_kg + self.hidden_kg).clamp(0.0, self.robot.payload_max_kg)
    }

    pub(super) fn loads(&self, inputs: &Inputs) -> Loads {
        let payload = PointMass {
            at_m: self.payload_m,
            kg: inputs.payload_kg + self.hidden_kg,
        };
        Loads {
            bellows_n: (0..CHAMBERS)
                .map(|i| self.push_n(&inputs.chamber_pa, i) - inputs.tension_n[i])
                .collect(),
            tip_force_n: Vector3::from(inputs.tip_force_n) + self.hidden_force_n,
            tip_moment_nm: self.hidden_moment_nm,
            tip_masses: vec![payload],
        }
    }
}

fn section(robot: &RobotSpec, p: &Parameters, resolution: Resolution, s: usize) -> Section {
    let l0 = robot.rest_length_m;
    let chambers = 3 * s..3 * s + 3;
    let springs = 6 * s..6 * s + 6;
    let axial: f64 = chambers
        .clone()
        .map(|i| robot.axial_stiffness_n_m[i] * p.chamber_stiffness[i] * l0)
        .sum();
    let own = robot.segments[s];
    let bending = own.bending_nm_rad * p.bending[s] * l0;
    let torsion = own.torsional_nm_rad * p.torsion[s] * l0;
    let pad_com = Vector3::new(0.0, 0.0, -0.5 * robot.pad_thickness_m);
    let masses = if s == 0 {
        vec![PointMass {
            at_m: pad_com,
            kg: robot.middle_pad_kg,
        }]
    } else {
        vec![
            PointMass {
                at_m: pad_com,
                kg: robot.end_pad_kg,
            },
            PointMass {
                at_m: Vector3::new(0.0, 0.0, -robot.gripper_com_m),
                kg: robot.gripper_kg * p.gripper_mass,
            },
        ]
    };
    Section {
        elements: resolution.elements,
        length_m: l0,
        rigidity: [
            bending,
            bending,
            torsion,
            p.shear * axial,
            p.shear * axial,
            own.axial_n_m * l0,
        ],
        rest: [0.0, 0.0, 0.0, 0.0, 0.0, -1.0],
        bellows: chambers
            .map(|i| {
                let stiffness_n = robot.axial_stiffness_n_m[i] * p.chamber_stiffness[i] * l0;
                Bellows {
                    r_m: robot.bellows_m[i],
                    stiffness_n,
                    rest_stretch: p.rest_length[i],
                    cubic_n: p.hardening * stiffness_n,
                    friction: Vec::new(),
                    branches: Vec::new(),
                    hinges: Vec::new(),
                }
            })
            .collect(),
        links: springs
            .map(|i| Link {
                top_m: robot.spring_top_m[i],
                bottom_m: robot.spring_bottom_m[i],
                rate_n_m: robot.spring.rate_n_m,
                free_m: robot.spring.free_length_m,
            })
            .collect(),
        kg_per_m: 3.0 * robot.bellows_kg / l0,
        masses,
        offset_m: Vector3::new(0.0, 0.0, -robot.pad_thickness_m),
    }
}

/// The changing part of a simulation, and memory that is reused between solves.
#[derive(Default)]
pub struct State {
    /// Strains of all elements, element after element from the base to the tip: of each the free ones in the order of
    /// [`Strains::indices`] (curvatures in 1/m, stretches).
    pub strains: Vec<f64>,
    /// Momenta conjugate to the strains; empty for an arm at rest.
    pub momenta: Vec<f64>,
    /// Friction, viscoelastic branches and contact. `None`: none of their forces has built up yet.
    pub history: Option<History>,
    /// Solver memory; holds no result.
    pub work: Workspace,
    /// Integrator memory; holds no result.
    pub integrator: Integrator,
}

impl State {
    /// The unloaded arm.
    pub fn rest(model: &Model) -> Self {
        Self::at(model.rod.rest_state())
    }

    /// An arm at rest at these strains.
    pub fn at(strains: Vec<f64>) -> Self {
        Self {
            strains,
            ..Self::default()
        }
    }

    /// Friction, branches and contact as they are now.
    pub(super) fn take_history(&mut self, model: &Model) -> History {
        let starting = || History::starting(&model.rod, &self.strains);
        self.history.take().unwrap_or_else(starting)
    }
}

/// Why a state could not be computed.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum SimError {
    /// An input is not a finite number.
    #[error("{what} is {value}, which is not a finite number: give a finite value")]
    NotFinite {
        /// The input.
        what: String,
        /// Its value.
        value: f64,
    },
    /// No stable equilibrium was found.
    #[error(
        "the rod model found no stable equilibrium after {iterations} Newton iterations \
         (last step {last_step:.1e}): the load is beyond what the arm can hold"
    )]
    NoEquilibrium {
        /// Newton iterations.
        iterations: usize,
        /// Last step.
        last_step: f64,
    },
    /// The equilibrium has a bellows pressed through itself, which no arm can do.
    #[error(
        "the load presses segment {segment} through itself: it is beyond what the arm can hold"
    )]
    InsideOut {
        /// 1 or 2.
        segment: usize,
    },
    /// The mesh did not come to rest.
    #[error(
        "the mesh model is still {residual_n:.1e} N out of balance after {iterations} iterations: \
         the load is beyond what the arm can hold"
    )]
    MeshUnsettled {
        /// Local-global iterations.
        iterations: usize,
        /// Out-of-balance force, N.
        residual_n: f64,
    },
    /// No wall stiffness lets the mesh bend as the rod model does.
    #[error(
        "the mesh model cannot be calibrated: with walls {wall_ratio:.2} times as stiff as the bellows are axially it still \
         bends by {off_rad:+.1e} rad more than the rod model; check bending and axial stiffness of the robot file"
    )]
    MeshWalls {
        /// Last wall stiffness over the bellows' axial one.
        wall_ratio: f64,
        /// Bend of the mesh minus that of the rod model, rad.
        off_rad: f64,
    },
    /// The robot's segments differ, or have a core.
    #[error(
        "the mesh model has walls of one kind and no core: a robot file with [[segments]] or segment.axial_stiffness_n_m \
         needs the rod model"
    )]
    MeshSegments,
    /// The robot's dimensions leave nothing to mesh.
    #[error(
        "the bellows of this robot leave no wall to mesh: give them an outer diameter larger than the \
         inner one, and a length above zero"
    )]
    NoMesh,
}

pub(super) fn check(inputs: &Inputs) -> Result<(), SimError> {
    let bad = |what: &str, value: f64| {
        Err(SimError::NotFinite {
            what: what.to_owned(),
            value,
        })
    };
    for (i, p) in inputs.chamber_pa.iter().enumerate() {
        if !p.is_finite() {
            return bad(&format!("the pressure of chamber {}", i + 1), *p);
        }
    }
    if !inputs.payload_kg.is_finite() {
        return bad("the payload", inputs.payload_kg);
    }
    for f in inputs.tip_force_n.iter().chain(&inputs.tension_n) {
        if !f.is_finite() {
            return bad("a force", *f);
        }
    }
    Ok(())
}

/// Settles the arm under `inputs`, starting from `state`. Friction and viscoelastic branches exert no force in a settled
/// arm: they build up from there.
///
/// # Errors
/// [`SimError`] when an input is not finite, no stable equilibrium is found, or the one found has a
/// bellows pressed through itself; `state` is then left as it was.
pub fn settle(model: &Model, state: &mut State, inputs: &Inputs) -> Result<Outcome, SimError> {
    check(inputs)?;
    let loads = model.loads(inputs);
    let mut q = state.strains.clone();
    let outcome = solve(&model.rod, &loads, &mut q, &mut state.work);
    accepted(model, &q, &outcome)?;
    state.history = None;
    state.momenta.clear();
    state.strains = q;
    Ok(outcome)
}

/// One implicit step of overdamped motion: strains relax towards equilibrium with the time
/// constants of `viscosity`, against friction and viscoelastic branches.
///
/// # Errors
/// As [`settle`].
pub fn step_overdamped(
    model: &Model,
    state: &mut State,
    inputs: &Inputs,
    viscosity: Viscosity,
    dt_s: f64,
) -> Result<Outcome, SimError> {
    check(inputs)?;
    let loads = model.loads(inputs);
    let mut history = state.take_history(model);
    let mut q = state.strains.clone();
    let step = StepLoads {
        loads: &loads,
        viscosity: viscosity.over(dt_s),
        history: &history,
        dt_s,
    };
    let outcome = solve_step(&model.rod, &step, &mut q, &mut state.work);
    if let Err(e) = accepted(model, &q, &outcome) {
        state.history = Some(history);
        return Err(e);
    }
    history.advance(&model.rod, &q, dt_s);
    state.history = Some(history);
    state.momenta.clear();
    state.strains = q;
    Ok(outcome)
}

/// Whether the strains `q` that a solver ended at are those of an arm.
pub(super) fn accepted(model: &Model, q: &[f64], outcome: &Outcome) -> Result<(), SimError> {
    if !outcome.converged {
        return Err(SimError::NoEquilibrium {
            iterations: outcome.iterations,
            last_step: outcome.last_step,
        });
    }
    match inside_out(model, q) {
        Some(segment) => Err(SimError::InsideOut { segment }),
        None => Ok(()),
    }
}

/// The first segment (1, 2) in which a bellows no longer points downstream: it would have passed
/// through zero length, where its energy has another, meaningless, branch.
fn inside_out(model: &Model, q: &[f64]) -> Option<usize> {
    let d = model.rod.strains.indices().len();
    let mut elements = q.chunks_exact(d);
    for (s, section) in model.rod.sections.iter().enumerate() {
        for xi in elements.by_ref().take(section.elements) {
            // v + κ × r along the axis, −z at rest; κx, κy come first and vz last in both choices.
            let through = |r: &Vector3<f64>| xi[d - 1] + xi[0] * r.y - xi[1] * r.x >= 0.0;
            if section.bellows.iter().any(|t| through(&t.r_m)) {
                return Some(s + 1);
            }
        }
    }
    None
}
