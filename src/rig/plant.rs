//! Plant of the virtual rig: the physics of the arm, without electronics.
//!
//! Deliberately not the twin's model: twice the strains (shear is free) on finer elements,
//! manufacturing scatter, hardening rubber, Bouc-Wen hysteresis in every bellows, pumps that
//! move air and chambers that store it. All figures it yields are simulated.
//!
//! Chamber gas (isothermal): with absolute pressure P, volume V and pump flow Q at P_atm,
//! (V + P C) ṗ = P_atm Q − P V̇_ext,  C = A²/k the bellows' own compliance and V̇_ext the volume
//! change that other chambers and loads cause.
//!
//! Hysteresis (Bouc-Wen, per bellows): f = F₀ z, ż = (ẋ/x₀)(1 − |z|ⁿ (½ + ½ sign(ẋ z))).
//! Source: Y. K. Wen, "Method for random vibration of hysteretic systems", 1976,
//! doi:10.1061/JMCEA3.0002106.

use nalgebra::Vector3;

use super::inertial::PadMotion;
use crate::robot::RobotSpec;
use crate::signal::{CHAMBERS, Pose};
use crate::sim::dataset::{sample_rng, scattered};
use crate::sim::rod::Strains;
use crate::sim::{
    ATMOSPHERE_PA, Inputs, Model, Observation, Parameters, Resolution, SimError, State, observe,
    settle, step_overdamped,
};

/// Share of full pump flow per Pa of pressure error: full flow beyond 0.5 kPa.
const PUMP_GAIN_1_PA: f64 = 1.0 / 500.0;
/// Time constant of the rubber's viscous response, s.
const VISCOUS_TAU_S: f64 = 0.06;
const HYSTERESIS_N: f64 = 3.0;
const HYSTERESIS_M: f64 = 6e-3;
const HYSTERESIS_POWER: f64 = 1.4;
/// Elements per segment.
const ELEMENTS: usize = 8;

/// One manufactured arm. Units differ by scatter; the same unit is always the same arm.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Unit(pub u64);

impl Default for Unit {
    /// The arm that the shipped calibration and networks belong to.
    fn default() -> Self {
        Self(1)
    }
}

/// Loads on the arm that the program does not command.
#[derive(Clone, Debug, PartialEq)]
pub struct Surroundings {
    /// Stiffness of bellows and central tube, as a factor on the unit's own. Fixed when the arm is made.
    pub stiffness: f64,
    /// Mass in the gripper, kg.
    pub payload_kg: f64,
    /// Force on the end pad in the base frame, N.
    pub tip_force_n: [f64; 3],
}

impl Default for Surroundings {
    fn default() -> Self {
        Self {
            stiffness: 1.0,
            payload_kg: 0.0,
            tip_force_n: [0.0; 3],
        }
    }
}

/// Plant: the arm with its pumps.
pub struct Plant {
    model: Model,
    state: State,
    /// External loads.
    pub surroundings: Surroundings,
    /// Share of its nominal flow that each chamber's supply gives.
    pub flow_share: [f64; CHAMBERS],
    /// Leak of each chamber, m³/s at atmospheric pressure per Pa of gauge pressure.
    pub leak_m3_s_pa: [f64; CHAMBERS],
    chamber_pa: [f64; CHAMBERS],
    hysteresis: [f64; CHAMBERS],
    bellows_m: [f64; CHAMBERS],
    volume_ext_m3_s: [f64; CHAMBERS],
    observation: Observation,
    pads: [PadMotion; 2],
    velocity_m_s: [Vector3<f64>; 2],
}

impl Plant {
    /// A settled arm at 0 Pa.
    ///
    /// # Errors
    /// [`SimError`] when the robot cannot carry its own weight.
    pub fn new(
        robot: &RobotSpec,
        unit: Unit,
        surroundings: Surroundings,
    ) -> Result<Self, SimError> {
        Self::of_elements(robot, unit, surroundings, ELEMENTS)
    }

    /// The same of so many elements per segment: fewer are faster, and bend a little differently.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn of_elements(
        robot: &RobotSpec,
        unit: Unit,
        surroundings: Surroundings,
        elements: usize,
    ) -> Result<Self, SimError> {
        let mut rng = sample_rng(0x5eed, unit.0 as usize);
        let mut parameters = Parameters {
            hardening: 0.15,
            shear: 0.4,
            ..scattered(0.012, &mut rng)
        };
        let factors = parameters.chamber_stiffness.iter_mut();
        let factors = factors.chain(&mut parameters.bending);
        for factor in factors.chain(&mut parameters.torsion) {
            *factor *= surroundings.stiffness;
        }
        let resolution = Resolution {
            elements,
            strains: Strains::All,
        };
        let model = Model::new(robot, &parameters, resolution);
        let mut state = State::rest(&model);
        let inputs = Inputs {
            payload_kg: surroundings.payload_kg,
            tip_force_n: surroundings.tip_force_n,
            ..Inputs::default()
        };
        settle(&model, &mut state, &inputs)?;
        let observation = observe(&model, &state);
        let rest = |p: &Pose| PadMotion::new(&p.rotation, Vector3::zeros(), Vector3::zeros());
        let pads = [
            rest(&observation.shape.base_from_pad[1]),
            rest(&observation.shape.base_from_pad[2]),
        ];
        Ok(Self {
            bellows_m: observation.bellows_m,
            model,
            state,
            surroundings,
            flow_share: [1.0; CHAMBERS],
            leak_m3_s_pa: [0.0; CHAMBERS],
            chamber_pa: [0.0; CHAMBERS],
            hysteresis: [0.0; CHAMBERS],
            volume_ext_m3_s: [0.0; CHAMBERS],
            observation,
            pads,
            velocity_m_s: [Vector3::zeros(); 2],
        })
    }

    /// True gauge pressures, Pa.
    pub fn chamber_pa(&self) -> &[f64; CHAMBERS] {
        &self.chamber_pa
    }

    /// True geometry.
    pub fn observation(&self) -> &Observation {
        &self.observation
    }

    /// Motion of the middle and the end pad.
    pub fn pads(&self) -> &[PadMotion; 2] {
        &self.pads
    }

    /// Runs the pumps towards `set_pa` for `dt_s` (a chamber without a set point has its pumps
    /// off and keeps its air) and moves the arm.
    ///
    /// # Errors
    /// [`SimError`] when the load is beyond what the arm can hold; the arm then stays where it is.
    pub fn step(&mut self, set_pa: &[Option<f64>; CHAMBERS], dt_s: f64) -> Result<(), SimError> {
        let robot = &self.model.robot;
        let stiffness_n_m = robot.axial_stiffness_n_m * self.surroundings.stiffness;
        let compliance = robot.area_m2.powi(2) / stiffness_n_m;
        let before_pa = self.chamber_pa;
        for i in 0..CHAMBERS {
            let p = before_pa[i];
            let absolute = ATMOSPHERE_PA + p;
            let volume = self.model.area_m2[i] * self.bellows_m[i];
            let pumped = set_pa[i].map_or(0.0, |set| {
                robot.pump_flow_m3_s * ((set - p) * PUMP_GAIN_1_PA).clamp(-1.0, 1.0)
            });
            let flow = self.flow_share[i] * pumped - self.leak_m3_s_pa[i] * p;
            let rate = (ATMOSPHERE_PA * flow - absolute * self.volume_ext_m3_s[i])
                / (volume + absolute * compliance);
            self.chamber_pa[i] = p + rate * dt_s;
        }
        let inputs = self.inputs();
        step_overdamped(&self.model, &mut self.state, &inputs, VISCOUS_TAU_S, dt_s)?;
        let before = std::mem::replace(&mut self.observation, observe(&self.model, &self.state));
        for i in 0..CHAMBERS {
            let dx = self.observation.bellows_m[i] - self.bellows_m[i];
            self.hysteresis[i] = bouc_wen(self.hysteresis[i], dx);
            // What the chamber's own pressure does to its volume is in `compliance` already.
            let own = compliance * (self.chamber_pa[i] - before_pa[i]);
            let ext = (self.model.area_m2[i] * dx - own) / dt_s;
            self.volume_ext_m3_s[i] += 0.3 * (ext - self.volume_ext_m3_s[i]);
            self.bellows_m[i] = self.observation.bellows_m[i];
        }
        self.feel(&before, dt_s);
        Ok(())
    }

    /// Goes straight to a settled state at `chamber_pa`, as if the pumps had had all the time they
    /// need; hysteresis follows the way.
    ///
    /// # Errors
    /// As [`Self::step`].
    pub fn settle_at(&mut self, chamber_pa: &[f64; CHAMBERS]) -> Result<(), SimError> {
        const STAGES: usize = 8;
        let from = self.chamber_pa;
        for stage in 1..=STAGES {
            let share = stage as f64 / STAGES as f64;
            self.chamber_pa = std::array::from_fn(|i| from[i] + share * (chamber_pa[i] - from[i]));
            let inputs = self.inputs();
            settle(&self.model, &mut self.state, &inputs)?;
            self.observation = observe(&self.model, &self.state);
            for i in 0..CHAMBERS {
                let dx = self.observation.bellows_m[i] - self.bellows_m[i];
                self.hysteresis[i] = bouc_wen(self.hysteresis[i], dx);
                self.bellows_m[i] = self.observation.bellows_m[i];
            }
        }
        self.volume_ext_m3_s = [0.0; CHAMBERS];
        let here = self.observation.clone();
        self.velocity_m_s = [Vector3::zeros(); 2];
        self.feel(&here, 1.0);
        Ok(())
    }

    fn inputs(&self) -> Inputs {
        Inputs {
            chamber_pa: self.chamber_pa,
            tension_n: self.hysteresis.map(|z| z * HYSTERESIS_N),
            payload_kg: self.surroundings.payload_kg,
            tip_force_n: self.surroundings.tip_force_n,
        }
    }

    /// Angular rate and specific force from the last two poses.
    fn feel(&mut self, before: &Observation, dt_s: f64) {
        for k in 0..2 {
            let (old, new) = (
                &before.shape.base_from_pad[k + 1],
                &self.observation.shape.base_from_pad[k + 1],
            );
            let velocity = (new.translation.vector - old.translation.vector) / dt_s;
            let acceleration = (velocity - self.velocity_m_s[k]) / dt_s;
            self.velocity_m_s[k] = velocity;
            let rate_rad_s = (old.rotation.inverse() * new.rotation).scaled_axis() / dt_s;
            self.pads[k] = PadMotion::new(&new.rotation, rate_rad_s, acceleration);
        }
    }
}

/// One step of the hysteresis variable z for a change dx of the bellows' length.
fn bouc_wen(z: f64, dx: f64) -> f64 {
    // Substeps keep the explicit update well inside its range for large moves.
    let n = (dx.abs() / (0.05 * HYSTERESIS_M)).ceil().max(1.0);
    let du = dx / HYSTERESIS_M / n;
    (0..n as usize).fold(z, |z, _| {
        let side = if du * z >= 0.0 { 1.0 } else { 0.0 };
        (z + du * (1.0 - z.abs().powf(HYSTERESIS_POWER) * side)).clamp(-1.0, 1.0)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plant(payload_kg: f64) -> Plant {
        let surroundings = Surroundings {
            payload_kg,
            ..Surroundings::default()
        };
        Plant::new(&RobotSpec::reference(), Unit::default(), surroundings).expect("settles")
    }

    #[test]
    fn a_full_stroke_takes_as_long_as_the_pumps_need() {
        let mut p = plant(0.0);
        for _ in 0..200 {
            p.step(&[Some(-40e3); CHAMBERS], 0.1).expect("steps");
        }
        assert!(
            p.chamber_pa().iter().all(|p| (p + 40e3).abs() < 50.0),
            "{:?}",
            p.chamber_pa()
        );
        let mut t_s = 0.0;
        while p.chamber_pa()[0] < 39e3 && t_s < 100.0 {
            p.step(&[Some(40e3); CHAMBERS], 0.05).expect("steps");
            t_s += 0.05;
        }
        // Volume 150 mm · 53.5 cm² plus the gas that the pressure itself stores: 27 s and more.
        assert!((27.0..60.0).contains(&t_s), "full stroke took {t_s:.1} s");
    }

    #[test]
    fn hysteresis_makes_up_and_down_differ_and_the_payload_hangs_lower() {
        let mut p = plant(0.0);
        p.settle_at(&[20e3; CHAMBERS]).expect("settles");
        p.settle_at(&[0.0; CHAMBERS]).expect("settles");
        let down = p.observation().base_from_tip.translation.z;
        p.settle_at(&[-20e3; CHAMBERS]).expect("settles");
        p.settle_at(&[0.0; CHAMBERS]).expect("settles");
        let up = p.observation().base_from_tip.translation.z;
        let gap_mm = (up - down) * 1e3;
        assert!((0.5..12.0).contains(&gap_mm.abs()), "gap {gap_mm:.2} mm");
        let loaded = plant(0.5).observation().base_from_tip.translation.z;
        let unloaded = plant(0.0).observation().base_from_tip.translation.z;
        assert!(loaded < unloaded - 5e-4, "{loaded} {unloaded}");
    }

    #[test]
    fn the_same_unit_is_the_same_arm_and_another_is_not() {
        let at = |unit: u64| {
            let mut p = Plant::new(&RobotSpec::reference(), Unit(unit), Surroundings::default())
                .expect("settles");
            p.settle_at(&[30e3, -10e3, 5e3, -20e3, 10e3, 0.0])
                .expect("settles");
            p.observation().base_from_tip.translation.vector
        };
        assert_eq!(at(1), at(1));
        assert!((at(1) - at(2)).norm() > 2e-4);
    }
}
