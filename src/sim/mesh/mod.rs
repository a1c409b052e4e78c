//! Geometric simulator: tetrahedra drawn to a shape, after the idea of the paper's simulator (section III-A).
//!
//! Per segment three bellows and a central tube, each a hollow column of tetrahedra between rigid
//! pads; the top pad is clamped. Minimised is
//!
//! Π = Σₑ ½ w Vₑ |(Fₑ − Rₑ diag(1, 1, λ)) D|² + Σ_c ½ K (λ_c − λ̂_c)² + Σ U(d) − Σ f·x
//!
//! with D² = diag(α, α, 1). Every element is drawn to the undeformed one, turned by a rotation of its own and grown by λ along
//! its chamber's axis. The local step finds rotations and growths (see `column`), the global step nodes
//! and pads from a factor made once (see `pads`); together they never raise Π. Anderson
//! acceleration (m = 6) speeds the pair up; an accelerated state of higher Π is dropped.
//!
//! | symbol | meaning | unit |
//! |---|---|---|
//! | w, V | stiffness and volume of an element; the volume makes Π independent of the mesh | J/m³, m³ |
//! | λ_c | growth of column c: its pressurised length over its rest length | – |
//! | λ̂ = 1 + (p A − f)/(k l₀) | rest growth under pressure p and extra tension f | – |
//! | K | stiffness between rest and actual growth, in series with the walls | J |
//! | α | weight of the cross-section's axes over that of the growing axis | – |
//! | β | stiffness of the walls over the bellows' axial one | – |
//!
//! **Calibration against the rod model.** In series walls (β k) and growth (K = k l₀² β/(β − 1)) have
//! the axial stiffness k of the robot file, so straight extension agrees with the rod by construction.
//! β, which alone sets the bending stiffness of the segments, is found once per robot by a secant on
//! one bend of the first segment, solved by both models. Torsion and shear follow from the mesh. On the
//! reference robot the tips are then 1.2 mm apart in the median over the pressure box, 4 mm in its
//! corners: every bellows may leave the common cross-section, which the rod's cannot.
//!
//! Of a robot's patches the mesh has the loads (payload and its place, tip force), not what they
//! change in stiffness or lengths.
//!
//! Source: G. Fang et al., "Kinematics of soft robots by geometric computing", IEEE T-RO 36,
//! 2020, 1272-1286, whose idea this is; local step, weights, growth, boundary and
//! stopping rule are ours.

mod banded;
mod column;
mod observe;
mod pads;
mod procrustes;

use nalgebra::{SMatrix, Vector3};

use super::anderson::Anderson;
use super::model::{GRAVITY_M_S2, Inputs, Model, SimError, State, check, settle};
use super::rod::se3::Frame;
use super::sensors::observe as observe_rod;
use crate::robot::RobotSpec;
use crate::signal::CHAMBERS;
use column::{Affine, Build, Column, meshed_volume_m3};
pub use observe::{Skin, observe_mesh, skin};
use pads::{Acting, Dead, Spring};
use procrustes::nearest_rotation;

/// Sectors and layers of a bellows.
const BELLOWS: [usize; 2] = [16, 10];
/// Sectors and layers of the central tube.
const TUBE: [usize; 2] = [8, 10];
/// Columns: six bellows, two central tubes.
const COLUMNS: usize = CHAMBERS + 2;
/// α: the bellows' rings hold their shape. At 1 a bellows bows sideways under its own compression and
/// large bends leave the rod by 25 mm; the larger it is, the slower the iteration.
const ACROSS: f64 = 3.0;
/// Largest out-of-balance force that counts as settled, N; leaves about 0.01 mm at the tip.
const RESIDUAL_N: f64 = 1e-2;
/// Most iterations of one settling.
const ITERATIONS: usize = 400;
/// Least and largest β that the calibration tries.
const WALL_RATIOS: [f64; 2] = [1.02, 20.0];
/// Difference of the bends of mesh and rod model at which the calibration ends, rad.
const BEND_TOLERANCE_RAD: f64 = 1e-4;
/// Most bends that the secant tries after the first.
const SECANT_STEPS: usize = 12;
/// Lever that makes angles comparable with lengths, m.
const ARM_M: f64 = 0.1;

/// The constant part: mesh, factors, springs, masses.
#[derive(Clone, Debug, PartialEq)]
pub struct MeshModel {
    /// The robot.
    pub robot: RobotSpec,
    /// β: wall stiffness over the bellows' axial stiffness, from the calibration.
    pub wall_ratio: f64,
    columns: Vec<Column>,
    acting: Acting,
    /// Stiffness of all columns felt by the pads, N/m.
    reduced: SMatrix<f64, 8, 8>,
    rest_pads: [Frame; 2],
    triangles: Vec<[u32; 3]>,
    /// Mass (kg) that the robot's patches hang on the gripper, and the place of all payload (m).
    hidden: (f64, Vector3<f64>),
    /// Force of the robot's patches on the end pad's origin, N.
    hidden_force_n: Vector3<f64>,
}

/// The changing part: nodes, pads, growths.
#[derive(Clone, Debug, PartialEq)]
pub struct MeshState {
    /// Node positions of each column (six bellows, two central tubes) in the base frame, m.
    pub nodes_m: Vec<Vec<Vector3<f64>>>,
    /// Middle and end pad, base from pad.
    pub pads: [Frame; 2],
    /// λ of each column, in the order of `nodes_m`.
    pub growth: Vec<f64>,
}

/// Outcome of a settling.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MeshOutcome {
    /// Local-global pairs.
    pub iterations: usize,
    /// Accelerated states dropped because their energy was higher.
    pub dropped: usize,
    /// Out-of-balance force left, root of squares over nodes and pads, N.
    pub residual_n: f64,
}

/// Which pads a segment's columns join: the upper one is none where clamped.
fn pads_of(segment: usize) -> [Option<usize>; 2] {
    if segment == 0 {
        [None, Some(0)]
    } else {
        [Some(0), Some(1)]
    }
}

fn segment_of(column: usize) -> usize {
    if column < CHAMBERS {
        column / 3
    } else {
        column - CHAMBERS
    }
}

impl MeshModel {
    /// Meshes a robot and calibrates its walls against the rod model.
    ///
    /// # Errors
    /// [`SimError`] when the robot's dimensions leave no volume to mesh, its segments differ or have a core, the
    /// calibration's bend cannot be solved, or no walls bend like the rod model.
    pub fn new(robot: &RobotSpec) -> Result<Self, SimError> {
        let inputs = calibration_bend(robot);
        // The walls are those of the robot without its patches.
        let plain = &RobotSpec {
            patches: Vec::new(),
            ..robot.clone()
        };
        let rod = Model::nominal(plain);
        let mut state = State::rest(&rod);
        settle(&rod, &mut state, &inputs)?;
        let wanted = bend_rad(&observe_rod(&rod, &state).base_from_tip);
        // Walls as stiff in bending as hollow beams of the meshed section, the rest by secant.
        let [ri, ro] = bellows_radii_m(robot);
        let beam = 0.25 * (ri * ri + ro * ro) * robot.axial_stiffness_n_m[0];
        let guess = (robot.segments[0].bending_nm_rad / (3.0 * beam)).clamp(1.2, 18.0);
        let off_rad = |beta: f64| -> Result<f64, SimError> {
            let model = Self::with_walls(plain, beta)?;
            let mut state = MeshState::rest(&model);
            settle_mesh(&model, &mut state, &inputs)?;
            Ok(bend_rad(&observe_mesh(&model, &state).base_from_tip) - wanted)
        };
        Self::with_walls(robot, wall_ratio(guess, off_rad)?)
    }

    /// Meshes a robot with walls `wall_ratio` (β > 1) times as stiff as its bellows are axially.
    ///
    /// # Errors
    /// [`SimError::NoMesh`] when the dimensions leave no volume to mesh, [`SimError::MeshSegments`] for segments that its walls
    /// do not describe.
    pub fn with_walls(robot: &RobotSpec, wall_ratio: f64) -> Result<Self, SimError> {
        let [first, second] = robot.segments;
        if first != second || first.axial_n_m > 0.0 {
            return Err(SimError::MeshSegments);
        }
        let l0 = robot.rest_length_m;
        let t = robot.pad_thickness_m;
        let middle_m = Vector3::new(0.0, 0.0, -l0);
        let end_m = middle_m * 2.0 - Vector3::z() * t;
        let mut columns = Vec::with_capacity(COLUMNS);
        for c in 0..COLUMNS {
            let segment = segment_of(c);
            let top = if segment == 0 {
                Vector3::zeros()
            } else {
                middle_m - Vector3::z() * t
            };
            let build = build(robot, wall_ratio, c, top, [middle_m, end_m]);
            columns.push(Column::new(&build).ok_or(SimError::NoMesh)?);
        }
        let mut reduced = SMatrix::<f64, 8, 8>::zeros();
        for (c, column) in columns.iter().enumerate() {
            let pads = pads_of(segment_of(c));
            for (i, p) in pads.iter().enumerate() {
                for (j, q) in pads.iter().enumerate() {
                    if let (Some(p), Some(q)) = (p, q) {
                        let mut block = reduced.fixed_view_mut::<4, 4>(4 * p, 4 * q);
                        block += column.reduced.fixed_view::<4, 4>(4 * i, 4 * j);
                    }
                }
            }
        }
        let rest = |p: Vector3<f64>| Frame {
            p,
            ..Frame::identity()
        };
        let rod = Model::nominal(robot);
        Ok(Self {
            hidden: (rod.hidden_kg, rod.payload_m),
            hidden_force_n: rod.hidden_force_n,
            robot: robot.clone(),
            wall_ratio,
            triangles: column::triangles(&columns),
            columns,
            acting: Acting {
                springs: springs(robot),
                dead: weights(robot),
            },
            reduced,
            rest_pads: [rest(middle_m), rest(end_m)],
        })
    }

    /// Number of tetrahedra.
    pub fn tetrahedra(&self) -> usize {
        self.columns.iter().map(Column::tets).sum()
    }

    /// λ̂ of every column.
    fn aims(&self, inputs: &Inputs) -> Vec<f64> {
        let r = &self.robot;
        (0..COLUMNS)
            .map(|c| {
                if c < CHAMBERS {
                    let force_n = inputs.chamber_pa[c] * r.area_m2[c] - inputs.tension_n[c];
                    1.0 + force_n / (r.axial_stiffness_n_m[c] * r.rest_length_m)
                } else {
                    1.0
                }
            })
            .collect()
    }
}

/// β at which `off_rad`, the bend of the mesh minus that of the rod model, is zero: a secant from `guess`.
///
/// # Errors
/// [`SimError::MeshWalls`] when it does not get there, at a bound of β or within its steps.
fn wall_ratio(guess: f64, off_rad: impl Fn(f64) -> Result<f64, SimError>) -> Result<f64, SimError> {
    let [least, largest] = WALL_RATIOS;
    let (mut b0, mut e0) = (guess, off_rad(guess)?);
    let mut b1 = if e0 > 0.0 { 1.1 * guess } else { 0.9 * guess };
    for _ in 0..SECANT_STEPS {
        let e1 = off_rad(b1)?;
        if e1.abs() < BEND_TOLERANCE_RAD {
            return Ok(b1);
        }
        let next = (b1 - e1 * (b1 - b0) / (e1 - e0)).clamp(least, largest);
        (b0, e0, b1) = (b1, e1, next);
        // At a bound, or without a slope to follow.
        if b1 == b0 || !b1.is_finite() {
            break;
        }
    }
    Err(SimError::MeshWalls {
        wall_ratio: b0,
        off_rad: e0,
    })
}

fn bellows_radii_m(robot: &RobotSpec) -> [f64; 2] {
    [
        0.5 * robot.bellows_inner_diameter_m,
        0.5 * robot.bellows_outer_diameter_m,
    ]
}

fn build(
    robot: &RobotSpec,
    wall_ratio: f64,
    c: usize,
    top: Vector3<f64>,
    origins: [Vector3<f64>; 2],
) -> Build {
    let l0 = robot.rest_length_m;
    let radii_m = bellows_radii_m(robot);
    let mut b = Build {
        top_m: top,
        turned_rad: 0.0,
        radii_m,
        length_m: l0,
        sectors: BELLOWS[0],
        layers: BELLOWS[1],
        weight_j_m3: 0.0,
        across: ACROSS,
        growth_j: 0.0,
        load_n: Vector3::z() * (-robot.bellows_kg * GRAVITY_M_S2),
        pads_m: pads_of(segment_of(c)).map(|p| p.map(|p| origins[p])),
    };
    // w V = β k l₀²
    let energy_j = wall_ratio * robot.axial_stiffness_n_m[c.min(CHAMBERS - 1)] * l0 * l0;
    b.weight_j_m3 = energy_j / meshed_volume_m3(&b);
    if c < CHAMBERS {
        let at = robot.bellows_m[c];
        b.top_m += at;
        b.turned_rad = at.y.atan2(at.x);
        b.growth_j = energy_j / (wall_ratio - 1.0);
    } else {
        // Of the bellows' own stuff, filling most of what they leave free; it stretches freely.
        let at = robot.bellows_m[3 * segment_of(c)];
        let free = at.norm() - radii_m[1];
        let outer = (0.9 * free).max(0.02 * at.norm());
        b.turned_rad = at.y.atan2(at.x);
        b.radii_m = [0.6 * outer, outer];
        [b.sectors, b.layers] = TUBE;
        b.load_n = Vector3::zeros();
    }
    b
}

fn springs(robot: &RobotSpec) -> Vec<Spring> {
    let down = Vector3::new(0.0, 0.0, -robot.pad_thickness_m);
    (0..robot.spring_top_m.len())
        .map(|i| {
            let [upper, _] = pads_of(i / 6);
            Spring {
                upper,
                lower: i / 6,
                upper_m: robot.spring_top_m[i] + upper.map_or(Vector3::zeros(), |_| down),
                lower_m: robot.spring_bottom_m[i],
                rate_n_m: robot.spring.rate_n_m,
                free_m: robot.spring.free_length_m,
            }
        })
        .collect()
}

fn hanging(pad: usize, below_m: f64, kg: f64) -> Dead {
    Dead {
        pad,
        at_m: Vector3::new(0.0, 0.0, -below_m),
        force_n: Vector3::new(0.0, 0.0, -GRAVITY_M_S2 * kg),
    }
}

fn weights(robot: &RobotSpec) -> Vec<Dead> {
    let t = robot.pad_thickness_m;
    vec![
        hanging(0, 0.5 * t, robot.middle_pad_kg),
        hanging(1, 0.5 * t, robot.end_pad_kg),
        hanging(1, robot.gripper_com_m, robot.gripper_kg),
    ]
}

/// One bend of the first segment, half the pressure range.
fn calibration_bend(robot: &RobotSpec) -> Inputs {
    let p = 0.5 * robot.pressure.max_pa;
    Inputs {
        chamber_pa: [p, -p, -p, 0.0, 0.0, 0.0],
        ..Inputs::default()
    }
}

/// Angle between the tip's and the base's z axis, rad.
fn bend_rad(base_from_tip: &crate::signal::Pose) -> f64 {
    let z = base_from_tip.rotation * Vector3::z();
    z.xy().norm().atan2(z.z)
}

impl MeshState {
    /// The undeformed mesh.
    pub fn rest(model: &MeshModel) -> Self {
        Self {
            nodes_m: model.columns.iter().map(|c| c.rest_m.clone()).collect(),
            pads: model.rest_pads,
            growth: vec![1.0; COLUMNS],
        }
    }

    /// Puts the nodes that belong to pads where the pads are.
    fn attach(&mut self, model: &MeshModel) {
        for (c, column) in model.columns.iter().enumerate() {
            let n = column.rest_m.len();
            let ends = [0..column.ring, n - column.ring..n];
            for (pad, range) in pads_of(segment_of(c)).iter().zip(ends) {
                if let Some(p) = *pad {
                    for i in range {
                        let local = column.rest_m[i] - model.rest_pads[p].p;
                        self.nodes_m[c][i] = self.pads[p].point(&local);
                    }
                }
            }
        }
    }

    /// All unknowns in metres.
    fn pack(&self, model: &MeshModel) -> Vec<f64> {
        let l0 = model.robot.rest_length_m;
        let mut v = Vec::with_capacity(3 * 2400);
        for (nodes, column) in self.nodes_m.iter().zip(&model.columns) {
            for x in &nodes[column.interior()] {
                v.extend_from_slice(x.as_slice());
            }
        }
        for pad in &self.pads {
            v.extend_from_slice(pad.p.as_slice());
            v.extend(pad.r.iter().map(|x| x * ARM_M));
        }
        v.extend(self.growth.iter().map(|g| g * l0));
        v
    }

    /// Back from [`pack`](Self::pack); pads are made rigid again.
    fn unpack(&mut self, model: &MeshModel, v: &[f64]) {
        let l0 = model.robot.rest_length_m;
        let mut from = v.iter().copied();
        let mut next = || from.next().unwrap_or(0.0);
        for (nodes, column) in self.nodes_m.iter_mut().zip(&model.columns) {
            for x in &mut nodes[column.interior()] {
                *x = Vector3::new(next(), next(), next());
            }
        }
        for pad in &mut self.pads {
            for k in 0..3 {
                pad.p[k] = next();
            }
            for k in 0..9 {
                pad.r[k] = next() / ARM_M;
            }
            pad.r = nearest_rotation(&pad.r);
        }
        for g in &mut self.growth {
            *g = next() / l0;
        }
        self.attach(model);
    }
}

/// Settles the arm under `inputs`, starting from `state`.
///
/// # Errors
/// [`SimError`] when an input is not finite or the mesh does not come to rest; `state` is then left as
/// it was.
pub fn settle_mesh(
    model: &MeshModel,
    state: &mut MeshState,
    inputs: &Inputs,
) -> Result<MeshOutcome, SimError> {
    check(inputs)?;
    settle_to(model, state, inputs, RESIDUAL_N)
}

fn settle_to(
    model: &MeshModel,
    state: &mut MeshState,
    inputs: &Inputs,
    residual_n: f64,
) -> Result<MeshOutcome, SimError> {
    let aims = model.aims(inputs);
    let mut acting = model.acting.clone();
    let (hidden_kg, payload_m) = model.hidden;
    acting.dead.push(Dead {
        at_m: payload_m,
        ..hanging(1, 0.0, inputs.payload_kg + hidden_kg)
    });
    acting.dead.push(Dead {
        pad: 1,
        at_m: Vector3::zeros(),
        force_n: Vector3::from(inputs.tip_force_n) + model.hidden_force_n,
    });
    let mut at = state.clone();
    let mut plain: Option<MeshState> = None;
    let mut anderson = Anderson::default();
    let (mut energy_j, mut dropped, mut left_n) = (f64::INFINITY, 0, f64::INFINITY);
    for iteration in 1..=ITERATIONS {
        let mut step = pair(model, &at, &aims, &acting);
        if step.energy_j > energy_j + 1e-12 * energy_j.abs()
            && let Some(p) = plain.take()
        {
            at = p;
            dropped += 1;
            step = pair(model, &at, &aims, &acting);
        }
        energy_j = step.energy_j;
        left_n = step.residual_n;
        if left_n < residual_n {
            *state = step.next;
            return Ok(MeshOutcome {
                iterations: iteration,
                dropped,
                residual_n: left_n,
            });
        }
        let mut v = step.next.pack(model);
        anderson.accelerate(&at.pack(model), &mut v);
        at.unpack(model, &v);
        plain = Some(step.next);
    }
    Err(SimError::MeshUnsettled {
        iterations: ITERATIONS,
        residual_n: left_n,
    })
}

/// Result of one local and global step.
struct Pair {
    /// Π before the global step, J.
    energy_j: f64,
    residual_n: f64,
    next: MeshState,
}

/// Local step at `at`, then the global step from it.
fn pair(model: &MeshModel, at: &MeshState, aims: &[f64], acting: &Acting) -> Pair {
    let mut next = at.clone();
    let mut energy_j = pads::energy_j(acting, &at.pads);
    let mut pull = Affine::zeros();
    let mut residual2 = 0.0;
    let mut axial = Vec::new();
    let mut moves = Vec::with_capacity(COLUMNS);
    for (c, column) in model.columns.iter().enumerate() {
        let n = column.rest_m.len();
        let mut force = vec![Vector3::zeros(); n];
        axial.resize(n, Vector3::zeros());
        let local = column.local(
            &at.nodes_m[c],
            at.growth[c],
            aims[c],
            &mut force,
            &mut axial[..n],
        );
        energy_j += local.energy_j;
        next.growth[c] = local.growth;
        residual2 += force[column.interior()]
            .iter()
            .map(Vector3::norm_squared)
            .sum::<f64>();
        let felt = column.condensed(&force);
        for (end, pad) in pads_of(segment_of(c)).iter().enumerate() {
            if let Some(p) = pad {
                let mut rows = pull.fixed_rows_mut::<4>(4 * p);
                rows += felt.fixed_rows::<4>(4 * end);
            }
        }
        column.relax(&mut force);
        moves.push(force);
    }
    let moved = pads::settle(&model.reduced, &pull, acting, &at.pads);
    residual2 += moved.residual_n.powi(2);
    let delta = pads::affine(&moved.pads) - pads::affine(&at.pads);
    for (c, column) in model.columns.iter().enumerate() {
        // The column's own view of the pads' motion: rows 0-3 upper end, 4-7 lower end.
        let mut ends = Affine::zeros();
        for (end, pad) in pads_of(segment_of(c)).iter().enumerate() {
            if let Some(p) = pad {
                ends.fixed_rows_mut::<4>(4 * end)
                    .copy_from(&delta.fixed_rows::<4>(4 * p));
            }
        }
        for i in column.interior() {
            next.nodes_m[c][i] += moves[c][i] + ends.tr_mul(&column.harmonic[i]);
        }
    }
    next.pads = moved.pads;
    next.attach(model);
    Pair {
        energy_j,
        residual_n: residual2.sqrt(),
        next,
    }
}

#[cfg(test)]
mod tests;
