//! The arm of a session: other elements, shear, memory forces one step behind, viscous rubber.

use nalgebra::{Point3, UnitQuaternion, Vector3};
use rand::Rng;

use super::Fineness;
use crate::rig::hidden::Defects;
use crate::robot::RobotSpec;
use crate::signal::{CHAMBERS, Pose, SPRINGS};
use crate::sim::dataset::{normal, sample_rng, scattered};
use crate::sim::rod::{PointMass, Strains};
use crate::sim::sensors::spring_lengths;
use crate::sim::{
    Inputs, Model, Observation, Parameters, Resolution, SimError, State, observe, settle,
    step_overdamped,
};

/// Shares and times of the creep's terms.
const PRONY: [[f64; 2]; 3] = [[0.45, 0.4], [0.35, 1.0], [0.2, 2.5]];
/// Rate of a dashpot's seat over the bellows' rate.
const SEAT_RATIO: f64 = 2.5;
/// Lengths at which a fold snaps in and out, m.
const SNAP_M: [f64; 2] = [0.135, 0.150];
const SNAP_S: f64 = 0.08;
const BRISTLE_N_M: f64 = 300.0;
const FLOOR_FRICTION: f64 = 0.3;
const SOFTENING_S: f64 = 40.0;
/// Turn of the bellows' end per lateral way of the tip, rad/m.
const SLIP_RAD_M: f64 = 2.0;

/// The arm at an instant.
#[derive(Clone, Debug)]
pub struct Moment {
    pub base_from_pad: [Pose; 3],
    pub spring_m: [f64; SPRINGS],
}

/// Memory of one bellows.
#[derive(Clone, Copy, Debug, Default)]
struct Bellows {
    length_m: f64,
    /// Bouc-Wen variables of the healthy bellows and of the hidden friction.
    z: [f64; 2],
    creep_n: [f64; 3],
    dashpot_n: f64,
    /// Whether a fold is in, and how far it has got.
    snapped: bool,
    snap: f64,
}

/// Ground truth of a specimen: what no two arms share.
#[derive(Clone, Debug)]
struct GroundTruth {
    viscous_s: f64,
    friction: [[f64; 2]; CHAMBERS],
    /// Scatter of whatever is hidden in each bellows.
    scatter: [f64; CHAMBERS],
    side_rad: f64,
}

pub struct Arm<'a> {
    model: Model,
    state: State,
    robot: &'a RobotSpec,
    defects: &'a Defects,
    truth: GroundTruth,
    bellows: [Bellows; CHAMBERS],
    gravity_m_s2: Vector3<f64>,
    gripper_m: Vector3<f64>,
    torsion: [f64; 2],
    plumb: Vector3<f64>,
    rest_tip_m: Vector3<f64>,
    floor_grip_n: Vector3<f64>,
    slip_rad: f64,
    payload_kg: f64,
    here: Observation,
}

impl<'a> Arm<'a> {
    /// A settled arm at 0 Pa.
    pub fn new(
        robot: &'a RobotSpec,
        specimen: u64,
        payload_kg: f64,
        defects: &'a Defects,
        fineness: Fineness,
    ) -> Result<Self, SimError> {
        let mut rng = sample_rng(specimen, 0xa12);
        let parameters = Parameters {
            hardening: 0.15,
            shear: 0.4,
            ..scattered(0.012, &mut rng)
        };
        let resolution = match fineness {
            Fineness::Full => Resolution {
                elements: 8,
                strains: Strains::All,
            },
            Fineness::Draft => Resolution {
                elements: 3,
                strains: Strains::NoShear,
            },
        };
        let truth = GroundTruth {
            viscous_s: rng.random_range(0.02..0.03),
            friction: std::array::from_fn(|_| [rng.random_range(0.8..1.6), 6e-3]),
            scatter: std::array::from_fn(|_| 1.0 + 0.08 * normal(&mut rng)),
            side_rad: rng.random_range(0.0..std::f64::consts::TAU),
        };
        let mut model = Model::new(robot, &parameters, resolution);
        let mut state = State::rest(&model);
        let inputs = Inputs {
            payload_kg,
            ..Inputs::default()
        };
        settle(&model, &mut state, &inputs)?;
        let here = observe(&model, &state);
        let torsion = std::array::from_fn(|s| model.rod.sections[s].rigidity[2]);
        // The gripper is the last mass of the last section; the hidden one follows it.
        let mut gripper_m = Vector3::zeros();
        if let Some(end) = model.rod.sections.last_mut() {
            gripper_m = end.masses.last().map_or(gripper_m, |m| m.at_m);
            end.masses.push(PointMass {
                at_m: Vector3::zeros(),
                kg: defects.payload_kg,
            });
        }
        let mut arm = Self {
            gravity_m_s2: model.rod.gravity_m_s2,
            state,
            robot,
            defects,
            truth,
            bellows: [Bellows::default(); CHAMBERS],
            gripper_m,
            torsion,
            plumb: -Vector3::z(),
            rest_tip_m: here.base_from_tip.translation.vector,
            floor_grip_n: Vector3::zeros(),
            slip_rad: 0.0,
            payload_kg,
            here,
            model,
        };
        for i in 0..CHAMBERS {
            arm.bellows[i].length_m = arm.here.bellows_m[i];
        }
        arm.come_to_rest()?;
        Ok(arm)
    }

    /// Lets hidden loads and stiffness act until nothing moves; history begins afterwards.
    fn come_to_rest(&mut self) -> Result<(), SimError> {
        const STEP_S: f64 = 0.03;
        for _ in 0..80 {
            let before = self.here.base_from_tip.translation.vector;
            self.step(0.0, &[0.0; CHAMBERS], STEP_S)?;
            for b in &mut self.bellows {
                b.z = [0.0; 2];
                b.creep_n = [0.0; 3];
                b.dashpot_n = 0.0;
            }
            self.slip_rad = 0.0;
            if (self.here.base_from_tip.translation.vector - before).norm() < 1e-7 {
                break;
            }
        }
        Ok(())
    }

    /// The arm now.
    pub fn moment(&self) -> Moment {
        let mut pads = self.here.shape.base_from_pad;
        let mut spring_m = self.here.sensors.spring_m;
        if self.slip_rad != 0.0 {
            pads[2].rotation *= UnitQuaternion::from_axis_angle(&Vector3::z_axis(), self.slip_rad);
            spring_m = spring_lengths(self.robot, &pads);
        }
        Moment {
            base_from_pad: pads,
            spring_m,
        }
    }

    /// Moves on by `dt_s` to `t_s`.
    pub fn step(
        &mut self,
        t_s: f64,
        chamber_pa: &[f64; CHAMBERS],
        dt_s: f64,
    ) -> Result<(), SimError> {
        self.change_model(t_s, dt_s);
        let tension_n = std::array::from_fn(|i| self.tension_n(i, t_s, chamber_pa[i]));
        let inputs = Inputs {
            chamber_pa: *chamber_pa,
            tension_n,
            payload_kg: self.payload_kg,
            tip_force_n: (self.hose_n() + self.floor_n()).into(),
        };
        step_overdamped(
            &self.model,
            &mut self.state,
            &inputs,
            self.truth.viscous_s,
            dt_s,
        )?;
        let before_m = self.here.base_from_tip.translation.vector;
        self.here = observe(&self.model, &self.state);
        for i in 0..CHAMBERS {
            self.remember(i, dt_s);
        }
        let moved_m = self.here.base_from_tip.translation.vector - before_m;
        self.floor_grip_n -= BRISTLE_N_M * Vector3::new(moved_m.x, moved_m.y, 0.0);
        let play = self.defects.pad_play_rad;
        // A turn that the pad has not followed yet, at most the play.
        self.slip_rad = (self.slip_rad + SLIP_RAD_M * (moved_m.x + moved_m.y)).clamp(-play, play);
        Ok(())
    }

    fn tension_n(&self, i: usize, t_s: f64, chamber_pa: f64) -> f64 {
        let (d, b) = (self.defects, &self.bellows[i]);
        let (k, l0) = (self.robot.axial_stiffness_n_m, self.robot.rest_length_m);
        let scatter = self.truth.scatter[i];
        let x_m = b.length_m - l0;
        let strain = x_m / l0;
        let friction = self.truth.friction[i][0] * b.z[0] + d.friction[i][0] * scatter * b.z[1];
        let memory = b.creep_n.iter().sum::<f64>() + b.dashpot_n;
        // β k l₀ |ε|^2.6 sign(ε) · 0.25^0.4
        let side = if strain > 0.0 { 1.05 } else { 0.95 };
        let hardening = d.hardening[i]
            * side
            * k
            * l0
            * strain.abs().powf(2.6)
            * strain.signum()
            * 0.25f64.powf(0.4);
        // (f − 1) k x (1 + 0.15 x/x_max)
        let factor = d.stiffness[i] - 1.0;
        let rest_off_m = x_m - 0.4e-3;
        let stiffer = factor * k * rest_off_m * (1.0 + 0.15 * rest_off_m / 0.075);
        let softer = -d.softening * -(-t_s / SOFTENING_S).exp_m1() * k * x_m;
        let area = self.model.area_m2[i] * d.area_growth * strain;
        friction + memory + hardening + stiffer + softer - chamber_pa * area + d.snap_n[i] * b.snap
    }

    fn remember(&mut self, i: usize, dt_s: f64) {
        let d = self.defects;
        let k = self.robot.axial_stiffness_n_m * self.truth.scatter[i];
        let length_m = self.here.bellows_m[i];
        let b = &mut self.bellows[i];
        let dx = length_m - b.length_m;
        b.z[0] = bouc_wen(b.z[0], dx / self.truth.friction[i][1]);
        b.z[1] = bouc_wen(b.z[1], dx / d.friction[i][1]);
        let [share, middle_s] = d.creep[i];
        for (f, [part, pace]) in b.creep_n.iter_mut().zip(PRONY) {
            // Midpoint rule for B' = c k x' − B/τ.
            let half = 0.5 * dt_s / (pace * middle_s);
            *f = (*f * (1.0 - half) + part * share * k * dx) / (1.0 + half);
        }
        if d.dashpot_s > 0.0 {
            // A fifth of scatter where `scatter` has 8 %.
            let tau_s = d.dashpot_s / SEAT_RATIO * (1.0 + 2.5 * (self.truth.scatter[i] - 1.0));
            let decay = (-dt_s / tau_s.max(1e-3)).exp();
            let mean = if dt_s > 0.0 {
                tau_s * (1.0 - decay) / dt_s
            } else {
                1.0
            };
            b.dashpot_n =
                decay * b.dashpot_n + SEAT_RATIO * self.robot.axial_stiffness_n_m * mean * dx;
        }
        b.snapped = match b.snapped {
            true => length_m < SNAP_M[1],
            false => length_m < SNAP_M[0],
        };
        let goal = if b.snapped { 1.0 } else { 0.0 };
        b.snap += -(-dt_s / SNAP_S).exp_m1() * (goal - b.snap);
        b.length_m = length_m;
    }

    /// Gravity, masses and twist stiffness as they are at the present shape.
    fn change_model(&mut self, t_s: f64, dt_s: f64) {
        let d = self.defects;
        let tip = &self.here.base_from_tip;
        let down_in_pad = tip.rotation.inverse() * -Vector3::z();
        let lean = down_in_pad.xy().norm();
        if d.tilt_rad != [0.0; 2] {
            let reach = (tip.translation.vector.xy().norm() / 0.1).min(1.0);
            let sway = (std::f64::consts::TAU * t_s / 47.0).sin();
            let more = 1.0 + 0.05 * (reach + sway);
            let [x, y] = d.tilt_rad.map(|a| a * more);
            let tilt = nalgebra::Rotation3::from_scaled_axis(Vector3::new(x, y, 0.0));
            self.model.rod.gravity_m_s2 = tilt * self.gravity_m_s2;
        }
        self.plumb += -(-dt_s / 0.5f64).exp_m1() * (down_in_pad - self.plumb);
        if let Some(end) = self.model.rod.sections.last_mut() {
            let n = end.masses.len();
            if let Some(gripper) = end.masses.get_mut(n.wrapping_sub(2)) {
                gripper.at_m = self.gripper_m + Vector3::from(d.com_m) * (1.0 + 0.1 * lean);
            }
            if let Some(hanging) = end.masses.last_mut() {
                let (s, c) = self.truth.side_rad.sin_cos();
                let pivot = Vector3::new(
                    d.payload_off_m * c,
                    d.payload_off_m * s,
                    0.04 - self.robot.payload_com_m,
                );
                // Half of the way to the plumb line: its knot is stiff.
                hanging.at_m = pivot + 0.04 * (0.5 * self.plumb - 0.5 * Vector3::z());
            }
        }
        for s in 0..2 {
            if d.torsion[s] != 1.0 {
                let pads = &self.here.shape.base_from_pad;
                let twist = (pads[s].rotation.inverse() * pads[s + 1].rotation)
                    .scaled_axis()
                    .z;
                let harder = 1.0 + 0.3 * (twist / 0.1).powi(2).min(4.0);
                self.model.rod.sections[s].rigidity[2] = self.torsion[s] * d.torsion[s] * harder;
            }
        }
    }

    fn hose_n(&self) -> Vector3<f64> {
        let pull = Vector3::from(self.defects.hose_n);
        let size = pull.norm();
        if size == 0.0 {
            return pull;
        }
        let way_m =
            (self.here.base_from_tip.translation.vector - self.rest_tip_m).dot(&pull) / size;
        pull * (1.0 - 0.125 * way_m / 0.1)
    }

    fn floor_n(&mut self) -> Vector3<f64> {
        let Some([height_m, rate_n_m]) = self.defects.floor else {
            return Vector3::zeros();
        };
        let tip = self.here.base_from_tip * Point3::origin();
        let depth_m = (height_m - tip.z).max(0.0);
        // N = k δ √(δ/10 mm)
        let normal_n = rate_n_m * depth_m * (depth_m / 0.01).sqrt();
        let most_n = FLOOR_FRICTION * normal_n;
        let grip_n = self.floor_grip_n.norm();
        if grip_n > most_n {
            self.floor_grip_n *= most_n / grip_n;
        }
        self.floor_grip_n + Vector3::z() * normal_n
    }
}

/// One step of ż = u̇ (1 − |z|^1.6 (0.6 + 0.4 sign(u̇ z))), with u = x/x₀.
fn bouc_wen(z: f64, du: f64) -> f64 {
    let n = (du.abs() / 0.05).ceil().max(1.0);
    let du = du / n;
    let slope = |z: f64| 1.0 - z.abs().powf(1.6) * (0.6 + 0.4 * (du * z).signum());
    (0..n as usize).fold(z, |z, _| {
        let middle = z + 0.5 * du * slope(z);
        (z + du * slope(middle)).clamp(-1.0, 1.0)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sim::GRAVITY_M_S2;

    #[test]
    fn the_loop_of_bouc_wen_closes_and_has_area() {
        let path =
            |from: f64, to: f64| (0..200).map(move |k| from + (to - from) * k as f64 / 200.0);
        let mut z = 0.0;
        let mut x = 0.0;
        let mut area = 0.0;
        let mut ends = Vec::new();
        for _ in 0..3 {
            area = 0.0;
            for next in path(-3.0, 3.0).chain(path(3.0, -3.0)) {
                let before = z;
                z = bouc_wen(z, next - x);
                area += 0.5 * (z + before) * (next - x);
                x = next;
            }
            ends.push(z);
        }
        assert!((ends[1] - ends[2]).abs() < 1e-6, "{ends:?}");
        // A stop of the same height and travel would lose 4 (3 − 1) = 8.
        assert!((4.0..12.0).contains(&area), "{area}");
    }

    #[test]
    fn gravity_is_the_rods() {
        let robot = RobotSpec::reference();
        let healthy = Defects::default();
        let arm = Arm::new(&robot, 1, 0.0, &healthy, Fineness::Draft).expect("settles");
        assert!((arm.model.rod.gravity_m_s2.norm() - GRAVITY_M_S2).abs() < 1e-12);
        assert!((arm.moment().base_from_pad[2].translation.z + 0.2966).abs() < 0.02);
    }
}
