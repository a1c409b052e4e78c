//! Plant of the virtual rig: the physics of the arm, without electronics.
//!
//! It shares nothing with the twin's model: rigid rings with bellows between them ([`multibody`](super::multibody)),
//! air in every chamber, rubber that creeps and rubs, pumps that regulate on their gauges. A robot file gives nominal
//! numbers, a unit the scatter about them. There is no shortcut to a settled state: it is waited for. All figures it
//! yields are simulated.

mod loads;
mod specimen;
mod supply;

use nalgebra::{Point3, UnitQuaternion, Vector3};

use super::hidden::Defects;
use super::inertial::PadMotion;
use super::multibody::air::{Chambers, Flow};
use super::multibody::arm::RINGS;
use super::multibody::chain::{Air, Arm, Chain, Held, NoStep, Outside};
use crate::robot::RobotSpec;
use crate::signal::{CHAMBERS, Pose, SPRINGS};
use loads::Loads;
use specimen::{Circumstances, Specimen};
use supply::Supply;

/// Longest step, s.
const STEP_S: f64 = 5e-3;
/// How often a step that does not converge is halved.
const HALVINGS: usize = 4;
/// Time of a ramp to a settled state, and of the rest after it, s.
const RAMP_S: f64 = 2.0;
const REST_S: f64 = 2.0;
/// Lengths at which a fold snaps in and out, m, and the time that it takes, s.
const SNAP_M: [f64; 2] = [0.142, 0.149];
const SNAP_S: f64 = 0.08;
/// Time in which a hanging mass comes to hang plumb, s.
const PLUMB_S: f64 = 0.5;
/// Turn of the bellows' end per lateral way of the tip, rad/m.
const SLIP_RAD_M: f64 = 2.0;

/// One manufactured arm. Units differ by scatter; the same unit is always the same arm.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Unit(pub u64);

impl Default for Unit {
    /// The arm that the shipped calibration belongs to.
    fn default() -> Self {
        Self(1)
    }
}

/// Loads on the arm that the program does not command.
#[derive(Clone, Debug, PartialEq)]
pub struct Surroundings {
    /// Stiffness of bellows and central tube, as a factor on the unit's own. Fixed when the arm is made.
    pub stiffness: f64,
    /// How the base is bolted, off level: gravity is turned by the rotation vector (x, y, 0) in the base's axes, rad. Fixed
    /// when the arm is made.
    pub base_tilt_rad: [f64; 2],
    /// Mass in the gripper, kg.
    pub payload_kg: f64,
    /// Force on the end pad in the base frame, N.
    pub tip_force_n: [f64; 3],
    /// Something that the arm cannot enter, if it is there.
    pub obstacle: Option<Obstacle>,
}

/// A flat, elastic surface: middle and end pad are pushed back by it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Obstacle {
    /// A point on it, in the base frame, m.
    pub point_m: [f64; 3],
    /// Direction out of it, of any length.
    pub normal: [f64; 3],
    /// Its stiffness, N/m.
    pub stiffness_n_m: f64,
}

impl Obstacle {
    /// Stiffness of a table, N/m.
    pub const TABLE_N_M: f64 = 10e3;
}

impl Default for Surroundings {
    fn default() -> Self {
        Self {
            stiffness: 1.0,
            base_tilt_rad: [0.0; 2],
            payload_kg: 0.0,
            tip_force_n: [0.0; 3],
            obstacle: None,
        }
    }
}

/// The arm's true geometry.
#[derive(Clone, Debug, PartialEq)]
pub struct Truth {
    /// Base from top, middle and end pad.
    pub base_from_pad: [Pose; 3],
    /// Distance between the ends of each spring, m.
    pub spring_m: [f64; SPRINGS],
    /// Length of each bellows, m.
    pub bellows_m: [f64; CHAMBERS],
}

impl Truth {
    /// The end pad, whose origin is the tip.
    pub fn base_from_tip(&self) -> Pose {
        self.base_from_pad[2]
    }
}

/// Plant: the arm with its air and pumps.
#[derive(Clone, Debug)]
pub struct Plant {
    specimen: Specimen,
    /// The specimen with what is hidden in it.
    arm: Arm,
    chain: Chain,
    air: Chambers,
    supply: Supply,
    loads: Loads,
    defects: Defects,
    /// External loads.
    pub surroundings: Surroundings,
    /// Share of its nominal flow that each chamber's supply gives.
    pub flow_share: [f64; CHAMBERS],
    /// Leak of each chamber, m³/s at atmospheric pressure per Pa of gauge pressure.
    pub leak_m3_s_pa: [f64; CHAMBERS],
    t_s: f64,
    payload_kg: f64,
    folded: [bool; CHAMBERS],
    snapped: [f64; CHAMBERS],
    plumb: Vector3<f64>,
    slip_rad: f64,
    truth: Truth,
    pads: [PadMotion; 2],
    velocity_m_s: [Vector3<f64>; 2],
}

impl Plant {
    /// A settled arm at 0 Pa.
    ///
    /// # Errors
    /// [`NoStep`] when the arm cannot carry what hangs on it.
    pub fn new(robot: &RobotSpec, unit: Unit, surroundings: Surroundings) -> Result<Self, NoStep> {
        Self::of_rings(robot, unit, surroundings, RINGS)
    }

    /// The same of so many rings per segment: fewer are faster, and bend a little differently.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn of_rings(
        robot: &RobotSpec,
        unit: Unit,
        surroundings: Surroundings,
        rings: usize,
    ) -> Result<Self, NoStep> {
        let specimen = Specimen::new(robot, unit.0, surroundings.stiffness, rings)
            .bolted(surroundings.base_tilt_rad);
        let defects = Defects::default();
        let now = Circumstances {
            t_s: 0.0,
            bend_rad: [0.0; 2],
            snapped: [0.0; CHAMBERS],
            plumb: -Vector3::z(),
            payload_kg: surroundings.payload_kg,
        };
        let arm = specimen.with(&defects, &now);
        let straight = Chain::straight(&arm);
        let mut loads = Loads::new(&arm, &straight);
        let outside = loads.outside(&arm, &straight, &surroundings, &defects, STEP_S);
        let chain = Chain::settled(&arm, [0.0; CHAMBERS], &outside)?;
        let air = Chambers::open(arm.volumes_m3(&chain.lengths_m));
        let loads = Loads::new(&arm, &chain);
        let truth = truth(&arm, &chain, 0.0);
        let still = |pad: &Pose| {
            let zero = Vector3::zeros();
            PadMotion::new(&pad.rotation, zero, zero, &arm.gravity_m_s2)
        };
        Ok(Self {
            pads: [
                still(&truth.base_from_pad[1]),
                still(&truth.base_from_pad[2]),
            ],
            velocity_m_s: [Vector3::zeros(); 2],
            supply: Supply::new(robot, unit.0),
            payload_kg: surroundings.payload_kg,
            specimen,
            arm,
            chain,
            air,
            loads,
            defects,
            surroundings,
            flow_share: [1.0; CHAMBERS],
            leak_m3_s_pa: [0.0; CHAMBERS],
            t_s: 0.0,
            folded: [false; CHAMBERS],
            snapped: [0.0; CHAMBERS],
            plumb: now.plumb,
            slip_rad: 0.0,
            truth,
        })
    }

    /// Hides `defects` in the arm from now on.
    pub fn hide(&mut self, defects: Defects) {
        self.defects = defects;
        self.change_arm();
    }

    /// What is hidden in it.
    pub fn defects(&self) -> &Defects {
        &self.defects
    }

    /// True gauge pressures in the chambers, Pa.
    pub fn chamber_pa(&self) -> [f64; CHAMBERS] {
        self.air.chamber_pa()
    }

    /// What the gauges read, without noise, Pa.
    pub fn gauge_pa(&self) -> [f64; CHAMBERS] {
        self.supply.gauge_pa(self.air.board_pa(), &self.defects)
    }

    /// Σ |dp/dt| over the chambers, Pa/s.
    pub fn activity_pa_s(&self) -> f64 {
        self.supply.activity_pa_s()
    }

    /// Force of the obstacle on the arm in the last step, N.
    pub fn contact_n(&self) -> f64 {
        self.loads.contact_n()
    }

    /// True geometry.
    pub fn truth(&self) -> &Truth {
        &self.truth
    }

    /// Motion of the middle and the end pad.
    pub fn pads(&self) -> &[PadMotion; 2] {
        &self.pads
    }

    /// Runs the pumps towards `set_pa` for `dt_s` (a chamber without a set point has its pumps
    /// off and keeps its air) and moves the arm.
    ///
    /// # Errors
    /// [`NoStep`] when the load is beyond what the arm can hold; it then stays where it is.
    pub fn step(&mut self, set_pa: &[Option<f64>; CHAMBERS], dt_s: f64) -> Result<(), NoStep> {
        if Specimen::varies(&self.defects) || self.payload_kg != self.surroundings.payload_kg {
            self.change_arm();
        }
        let steps = (dt_s / STEP_S - 1e-9).ceil().max(1.0);
        let h_s = dt_s / steps;
        for _ in 0..steps as usize {
            let mut flows = self.supply.flows(
                self.t_s,
                set_pa,
                self.air.board_pa(),
                &self.flow_share,
                &self.defects,
                h_s,
            );
            for (flow, leak) in flows.iter_mut().zip(self.leak_m3_s_pa) {
                flow.leak_m3_s_pa = leak;
            }
            let outside = self.outside(h_s);
            self.advance(&flows, &outside, h_s, HALVINGS)?;
        }
        self.t_s += dt_s;
        self.observe(dt_s);
        Ok(())
    }

    /// Goes to a settled state at `chamber_pa` on a supply that gives these pressures within seconds, and waits there.
    ///
    /// # Errors
    /// As [`Self::step`].
    pub fn settle_at(&mut self, chamber_pa: &[f64; CHAMBERS]) -> Result<(), NoStep> {
        let from_pa = self.chamber_pa();
        let (ramp, rest) = (RAMP_S / STEP_S, REST_S / STEP_S);
        for k in 1..=(ramp + rest) as usize {
            let share = (k as f64 / ramp).min(1.0);
            let held = std::array::from_fn(|i| from_pa[i] + share * (chamber_pa[i] - from_pa[i]));
            let outside = self.outside(STEP_S);
            self.chain.step(&self.arm, &Held(held), &outside, STEP_S)?;
        }
        self.air = Chambers::at(self.arm.volumes_m3(&self.chain.lengths_m), chamber_pa);
        self.velocity_m_s = [Vector3::zeros(); 2];
        self.observe(RAMP_S + REST_S);
        Ok(())
    }

    /// Forces from outside for a step of `h_s`.
    fn outside(&mut self, h_s: f64) -> Outside {
        let (arm, chain) = (&self.arm, &self.chain);
        self.loads
            .outside(arm, chain, &self.surroundings, &self.defects, h_s)
    }

    /// Mechanics and air of one step; a step that does not converge is made in two.
    fn advance(
        &mut self,
        flows: &[Flow; CHAMBERS],
        outside: &Outside,
        h_s: f64,
        halvings: usize,
    ) -> Result<(), NoStep> {
        let air: &dyn Air = &self.air;
        match self.chain.step(&self.arm, air, outside, h_s) {
            Ok(()) => {
                let volumes_m3 = self.arm.volumes_m3(&self.chain.lengths_m);
                self.air.flow(&volumes_m3, flows, h_s);
                Ok(())
            }
            Err(e) if halvings == 0 => Err(e),
            Err(_) => {
                self.advance(flows, outside, 0.5 * h_s, halvings - 1)?;
                self.advance(flows, outside, 0.5 * h_s, halvings - 1)
            }
        }
    }

    /// Recomputes the arm from the specimen, for what is hidden and hangs on it now.
    fn change_arm(&mut self) {
        let now = Circumstances {
            t_s: self.t_s,
            bend_rad: std::array::from_fn(|s| {
                let pads = &self.truth.base_from_pad;
                pads[s].rotation.angle_to(&pads[s + 1].rotation)
            }),
            snapped: self.snapped,
            plumb: self.plumb,
            payload_kg: self.surroundings.payload_kg,
        };
        let arm = self.specimen.with(&self.defects, &now);
        if let (Some(before), Some(end)) = (self.arm.bodies.last(), arm.bodies.last()) {
            self.chain.exchange_end(before, end);
        }
        self.payload_kg = now.payload_kg;
        self.arm = arm;
    }

    /// Takes over where the arm is after `dt_s`, and what follows from it.
    fn observe(&mut self, dt_s: f64) {
        let before_m = self.truth.base_from_tip().translation.vector;
        let mut now = truth(&self.arm, &self.chain, 0.0);
        let moved_m = now.base_from_tip().translation.vector - before_m;
        let play = self.defects.pad_play_rad;
        // A turn that the pad has not followed yet, at most the play.
        self.slip_rad = (self.slip_rad + SLIP_RAD_M * (moved_m.x + moved_m.y)).clamp(-play, play);
        if self.slip_rad != 0.0 {
            now = truth(&self.arm, &self.chain, self.slip_rad);
        }
        self.truth = now;
        for i in 0..CHAMBERS {
            let length_m = self.truth.bellows_m[i];
            self.folded[i] = length_m < SNAP_M[usize::from(self.folded[i])];
            let goal = if self.folded[i] { 1.0 } else { 0.0 };
            self.snapped[i] += -(-dt_s / SNAP_S).exp_m1() * (goal - self.snapped[i]);
        }
        let down = self.arm.gravity_m_s2.normalize();
        let down_in_pad = self.truth.base_from_tip().rotation.inverse() * down;
        self.plumb += -(-dt_s / PLUMB_S).exp_m1() * (down_in_pad - self.plumb);
        self.feel(dt_s);
    }

    /// Angular rate and specific force of the pads, the mean over the last `dt_s`.
    fn feel(&mut self, dt_s: f64) {
        for (k, body) in self.arm.pads().into_iter().enumerate() {
            let v = self.chain.velocity(&self.arm, body);
            let rate = Vector3::new(v[3], v[4], v[5]);
            let pose = &self.chain.motions[body].pose;
            let upper_m = pose.rotation * self.arm.bodies[body].upper_m;
            let velocity = Vector3::new(v[0], v[1], v[2]) + rate.cross(&upper_m);
            let acceleration = (velocity - self.velocity_m_s[k]) / dt_s;
            self.velocity_m_s[k] = velocity;
            let turn = &self.truth.base_from_pad[k + 1].rotation;
            self.pads[k] = PadMotion::new(
                turn,
                turn.inverse() * rate,
                acceleration,
                &self.arm.gravity_m_s2,
            );
        }
    }
}

/// Geometry of the arm with the end pad turned by `slip_rad` about its axis.
fn truth(arm: &Arm, chain: &Chain, slip_rad: f64) -> Truth {
    let [middle, mut end] = chain.pads(arm);
    let mut poses = chain.poses();
    if slip_rad != 0.0 {
        end.rotation *= UnitQuaternion::from_axis_angle(&Vector3::z_axis(), slip_rad);
        if let (Some(pose), Some(body)) = (poses.last_mut(), arm.bodies.last()) {
            let centre = end * Point3::from(-body.upper_m);
            *pose = Pose::from_parts(centre.coords.into(), end.rotation);
        }
    }
    Truth {
        base_from_pad: [arm.base, middle, end],
        spring_m: std::array::from_fn(|i| {
            let spring = arm.springs.get(i);
            spring.map_or(0.0, |s| {
                let [upper, lower] = arm.spring_ends_m(s, &poses);
                (lower - upper).norm()
            })
        }),
        bellows_m: chain.bellows_m(arm),
    }
}

#[cfg(test)]
mod tests;
