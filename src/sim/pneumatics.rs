//! Air between the pumps and the moving arm.
//!
//! Per chamber, an isothermal ideal gas of absolute pressure P in the volume V = A L + V_line, fed
//! through a line by a pump that gives at most Q_max, flows counted as volume at P_atm:
//!
//! d(P V)/dt = P_atm Q,   Q = clamp(G (P_cmd² − P²), ±Q_max),   G = π d⁴ / (256 μ ℓ P_atm)
//!
//! The arm does the rest: with L its bellows' own length, pulling on it lowers the pressure. Over a
//! step the balance is implicit in P; with Q a quadratic in P it is solved in closed form.
//!
//! | symbol | meaning | unit |
//! |---|---|---|
//! | A, L | effective area and length of a bellows | m², m |
//! | V_line | volume of the line (valve to chamber) | m³ |
//! | d, ℓ | inner diameter and length of the line | m |
//! | μ | dynamic viscosity of air | Pa s |
//! | P_cmd | absolute pressure the pump's regulator holds at the line's upper end | Pa |
//!
//! Source: R. B. Bird, W. E. Stewart, E. N. Lightfoot, "Transport Phenomena", 2nd ed. 2002, ch. 2
//! (laminar flow through a tube; for a gas at its mean density, hence the squares); the mass balance
//! is that of an ideal gas. Flow limit, area and lengths are the robot's; the line's are ours.

use super::dynamics::{Moving, swing};
use super::model::{Inputs, Model, SimError};
use super::sensors::bellows_lengths;
use crate::signal::CHAMBERS;

/// Standard atmosphere, Pa.
pub const ATMOSPHERE_PA: f64 = 101_325.0;
/// Dynamic viscosity of air at 20 °C, Pa s.
const AIR_VISCOSITY_PA_S: f64 = 1.81e-5;

/// The tube from a pump to its chamber.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Line {
    /// Inner diameter, m.
    pub inner_diameter_m: f64,
    /// Length, m.
    pub length_m: f64,
}

impl Default for Line {
    /// 1.5 m of 2.5 mm tube.
    fn default() -> Self {
        Self {
            inner_diameter_m: 2.5e-3,
            length_m: 1.5,
        }
    }
}

impl Line {
    /// G: flow over the difference of squared pressures, m³/(s Pa²).
    fn conductance(&self) -> f64 {
        std::f64::consts::PI * self.inner_diameter_m.powi(4)
            / (256.0 * AIR_VISCOSITY_PA_S * self.length_m * ATMOSPHERE_PA)
    }

    fn volume_m3(&self) -> f64 {
        std::f64::consts::FRAC_PI_4 * self.inner_diameter_m.powi(2) * self.length_m
    }
}

/// What a chamber is connected to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Feed {
    /// A pump regulated to this gauge pressure, Pa.
    Pump(f64),
    /// Nothing: the valve is shut and the air stays in.
    Shut,
}

/// The air in the chambers and their lines.
#[derive(Clone, Debug, PartialEq)]
pub struct Air {
    /// The lines, all alike.
    pub line: Line,
    /// P V of each chamber, its amount of gas times R T, J.
    pub amount_j: [f64; CHAMBERS],
    /// Length of each bellows a step ago, m: tells where it will be half a step on.
    before_m: [f64; CHAMBERS],
}

impl Air {
    /// Chambers at the gauge pressures `chamber_pa` in the arm's present shape.
    pub fn at(model: &Model, moving: &Moving, line: Line, chamber_pa: &[f64; CHAMBERS]) -> Self {
        let before_m = bellows_lengths(model, &moving.motion.q);
        let volume_m3 = volumes_m3(model, &line, &before_m);
        Self {
            line,
            amount_j: std::array::from_fn(|i| (chamber_pa[i] + ATMOSPHERE_PA) * volume_m3[i]),
            before_m,
        }
    }

    /// Gauge pressures in the arm's present shape, Pa.
    pub fn chamber_pa(&self, model: &Model, moving: &Moving) -> [f64; CHAMBERS] {
        let volume_m3 = volumes_m3(model, &self.line, &bellows_lengths(model, &moving.motion.q));
        std::array::from_fn(|i| self.amount_j[i] / volume_m3[i] - ATMOSPHERE_PA)
    }
}

/// V = A L + V_line.
fn volumes_m3(model: &Model, line: &Line, bellows_m: &[f64; CHAMBERS]) -> [f64; CHAMBERS] {
    std::array::from_fn(|i| model.area_m2[i] * bellows_m[i] + line.volume_m3())
}

/// The amount of gas P V after `dt_s` in the volume V, implicit in its pressure.
fn fed(amount_j: f64, volume_m3: f64, feed: Feed, line: &Line, flow_max: f64, dt_s: f64) -> f64 {
    let Feed::Pump(gauge_pa) = feed else {
        return amount_j;
    };
    // P V = (P V)₀ + h P_atm G (P_cmd² − P²), the positive root; stable for small and large a.
    let command_pa = (gauge_pa + ATMOSPHERE_PA).max(0.0);
    let a = dt_s * ATMOSPHERE_PA * line.conductance();
    let c = amount_j + a * command_pa * command_pa;
    let root = (volume_m3 * volume_m3 + 4.0 * a * c).sqrt();
    let pressure_pa = 2.0 * c / (volume_m3 + root);
    let most_j = dt_s * ATMOSPHERE_PA * flow_max;
    let gain_j = (pressure_pa * volume_m3 - amount_j).clamp(-most_j, most_j);
    (amount_j + gain_j).max(0.0)
}

/// One step of `dt_s`: the pumps feed the chambers, whose pressure moves the arm with inertia.
/// `inputs.chamber_pa` is not used. Returns the gauge pressures that acted, Pa: those at the
/// bellows lengths expected half-way, so that the air takes and gives back the same work.
///
/// # Errors
/// As [`swing`], or when a command is not finite; `air` and `moving` are then left as they were.
pub fn pump_and_swing(
    model: &Model,
    moving: &mut Moving,
    air: &mut Air,
    feeds: &[Feed; CHAMBERS],
    inputs: &Inputs,
    tau_s: f64,
    dt_s: f64,
) -> Result<[f64; CHAMBERS], SimError> {
    for (i, feed) in feeds.iter().enumerate() {
        if let Feed::Pump(value) = *feed
            && !value.is_finite()
        {
            return Err(SimError::NotFinite {
                what: format!("the command of pump {}", i + 1),
                value,
            });
        }
    }
    let line = air.line;
    let now_m = bellows_lengths(model, &moving.motion.q);
    let half_way_m = std::array::from_fn(|i| now_m[i] + 0.5 * (now_m[i] - air.before_m[i]));
    let volume_m3 = volumes_m3(model, &line, &half_way_m);
    let flow_max = model.robot.pump_flow_m3_s;
    let amount_j: [f64; CHAMBERS] = std::array::from_fn(|i| {
        fed(
            air.amount_j[i],
            volume_m3[i],
            feeds[i],
            &line,
            flow_max,
            dt_s,
        )
    });
    let inputs = Inputs {
        chamber_pa: std::array::from_fn(|i| amount_j[i] / volume_m3[i] - ATMOSPHERE_PA),
        ..inputs.clone()
    };
    swing(model, moving, &inputs, tau_s, dt_s)?;
    *air = Air {
        line,
        amount_j,
        before_m: now_m,
    };
    Ok(inputs.chamber_pa)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::RobotSpec;
    use crate::sim::{Resolution, State, mechanical_energy, observe, settle};

    fn arm() -> (Model, Moving) {
        let model = Model::new(
            &RobotSpec::reference(),
            &Default::default(),
            Resolution {
                elements: 2,
                ..Resolution::default()
            },
        );
        let mut state = State::rest(&model);
        settle(&model, &mut state, &Inputs::default()).expect("settles");
        let moving = Moving::from_rest(&state);
        (model, moving)
    }

    #[test]
    fn shut_chambers_keep_p_v_and_hold_the_arm_when_it_is_pulled() {
        let (model, mut moving) = arm();
        let line = Line::default();
        let mut air = Air::at(&model, &moving, line, &[0.0; CHAMBERS]);
        let volume_m3 = |moving: &Moving, i: usize| {
            let l_m = observe(&model, &moving.state()).bellows_m[i];
            model.robot.area_m2 * l_m + line.volume_m3()
        };
        let pulled = Inputs {
            tip_force_n: [5.0, 0.0, -40.0],
            ..Inputs::default()
        };
        let start_m3: [f64; CHAMBERS] = std::array::from_fn(|i| volume_m3(&moving, i));
        let mut open = State::rest(&model);
        settle(&model, &mut open, &pulled).expect("settles");
        let shut = [Feed::Shut; CHAMBERS];
        let mut acted_pa = [0.0; CHAMBERS];
        for _ in 0..3000 {
            acted_pa = pump_and_swing(&model, &mut moving, &mut air, &shut, &pulled, 0.03, 1e-3)
                .expect("moves");
        }
        for i in 0..CHAMBERS {
            let now_m3 = volume_m3(&moving, i);
            assert!(
                (now_m3 / start_m3[i] - 1.0).abs() > 5e-4,
                "{i} did not move"
            );
            let p_v = (acted_pa[i] + ATMOSPHERE_PA) * now_m3;
            let expected = ATMOSPHERE_PA * start_m3[i];
            assert!((p_v / expected - 1.0).abs() < 1e-6, "{i}: {p_v} {expected}");
        }
        let z_m = |state: &State| observe(&model, state).base_from_tip.translation.vector.z;
        let rest_m = z_m(&arm().1.state());
        let (free_m, held_m) = (rest_m - z_m(&open), rest_m - z_m(&moving.state()));
        assert!(
            held_m > 0.1 * free_m && held_m < 0.7 * free_m,
            "{held_m} {free_m}"
        );
    }

    #[test]
    fn pumps_give_no_more_than_their_flow() {
        let (model, mut moving) = arm();
        let mut air = Air::at(&model, &moving, Line::default(), &[0.0; CHAMBERS]);
        let mut feeds = [Feed::Shut; CHAMBERS];
        feeds[0] = Feed::Pump(30e3);
        feeds[4] = Feed::Pump(-30e3);
        let most = 1.8e-3 / 60.0 * ATMOSPHERE_PA;
        let mut before = air.clone();
        for _ in 0..500 {
            let _ = pump_and_swing(
                &model,
                &mut moving,
                &mut air,
                &feeds,
                &Inputs::default(),
                0.03,
                1e-3,
            )
            .expect("moves");
            for i in 0..CHAMBERS {
                let rate_w = (air.amount_j[i] - before.amount_j[i]) / 1e-3;
                let expected = [most, 0.0, 0.0, 0.0, -most, 0.0][i];
                assert!((rate_w - expected).abs() < 1e-6 * most, "{i}: {rate_w}");
            }
            before = air.clone();
        }
        // At a volume that stays, dp/dt = P_atm Q_max / V; the bellows that gives way slows it.
        let volume_m3 = model.robot.area_m2 * model.robot.rest_length_m;
        let pa = air.chamber_pa(&model, &moving)[0];
        assert!(
            pa > 0.1 * 0.5 * most / volume_m3 && pa < 0.5 * most / volume_m3,
            "{pa}"
        );
    }

    #[test]
    fn pressures_reach_the_command_and_the_arm_settles_there() {
        let (model, mut moving) = arm();
        let chamber_pa = [4e3, -3e3, 0.0, 2e3, -4e3, 3e3];
        let mut air = Air::at(&model, &moving, Line::default(), &[0.0; CHAMBERS]);
        let feeds = chamber_pa.map(Feed::Pump);
        for _ in 0..2500 {
            let _ = pump_and_swing(
                &model,
                &mut moving,
                &mut air,
                &feeds,
                &Inputs::default(),
                0.03,
                5e-3,
            )
            .expect("moves");
        }
        let inputs = Inputs {
            chamber_pa,
            ..Inputs::default()
        };
        let got_pa = air.chamber_pa(&model, &moving);
        for i in 0..CHAMBERS {
            assert!(
                (got_pa[i] - chamber_pa[i]).abs() < 1.0,
                "{i}: {}",
                got_pa[i]
            );
        }
        let mut state = State::rest(&model);
        settle(&model, &mut state, &inputs).expect("settles");
        let tip = |s: &State| observe(&model, s).base_from_tip.translation.vector;
        assert!((tip(&state) - tip(&moving.state())).norm() < 1e-5);
    }

    /// Largest departure of the energy, air included, over the largest kinetic energy in a second
    /// after a pull on the arm with its chambers shut and nothing to damp it.
    fn departure(dt_s: f64) -> f64 {
        let (model, mut moving) = arm();
        let line = Line::default();
        let mut air = Air::at(&model, &moving, line, &[0.0; CHAMBERS]);
        let pull = Inputs {
            tip_force_n: [0.0, 0.0, -5.0],
            ..Inputs::default()
        };
        let energy_j = |moving: &Moving, air: &Air| {
            let bellows_m = bellows_lengths(&model, &moving.motion.q);
            let volume_m3 = volumes_m3(&model, &line, &bellows_m);
            // Isothermal: −P V ln V against the atmosphere's P_atm V.
            let gas: f64 = (0..CHAMBERS)
                .map(|i| ATMOSPHERE_PA * volume_m3[i] - air.amount_j[i] * volume_m3[i].ln())
                .sum();
            let e = mechanical_energy(&model, moving, &pull);
            [e.kinetic_j, e.kinetic_j + e.potential_j + gas]
        };
        let start = energy_j(&moving, &air)[1];
        let shut = [Feed::Shut; CHAMBERS];
        let (mut kinetic, mut off) = (0.0f64, 0.0f64);
        for _ in 0..(1.0 / dt_s) as usize {
            pump_and_swing(&model, &mut moving, &mut air, &shut, &pull, 0.0, dt_s).expect("moves");
            let [k, all] = energy_j(&moving, &air);
            kinetic = kinetic.max(k);
            off = off.max((all - start).abs());
        }
        off / kinetic
    }

    #[test]
    fn shut_air_is_a_spring_that_gives_back_what_it_takes() {
        let [coarse, fine] = [1e-3, 0.5e-3].map(departure);
        assert!(coarse < 0.1, "{coarse}");
        assert!(fine < 0.3 * coarse, "{fine} {coarse}: not of second order");
    }

    #[test]
    fn a_command_that_is_no_number_is_refused() {
        let (model, mut moving) = arm();
        let mut air = Air::at(&model, &moving, Line::default(), &[0.0; CHAMBERS]);
        let before = air.clone();
        let feeds = [Feed::Pump(f64::NAN); CHAMBERS];
        let rest = Inputs::default();
        assert!(pump_and_swing(&model, &mut moving, &mut air, &feeds, &rest, 0.03, 1e-3).is_err());
        assert_eq!(air, before);
    }
}
