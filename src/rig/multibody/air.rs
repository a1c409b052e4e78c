//! The air in the chambers and in the lines to them.
//!
//! A chamber holds an amount n of air, counted as p V at ambient temperature (Pa m³), at a temperature θ relative to
//! the ambient one. With κ = 1.4, for volume V and inflow ṅ:
//!
//! ```text
//! p = n θ / V − p_atm        θ̇ = −(κ−1) θ V̇/V + (κ−θ) ṅ⁺/n + (κ−1) θ ṅ⁻/n + (1−θ)/τ
//! ```
//!
//! Pump and valve of a board feed a small volume V_b, where the gauge sits; a line with a resistance R leads to the
//! chamber, which may leak, laminarly and through an orifice (flows in m³/s at atmospheric pressure):
//!
//! ```text
//! V_b ṗ_b = p_atm (q_pump − q_line)        q_line = (p_b − p) / R        ṅ = p_atm (q_line − q_leak)
//! ```

use super::chain::Air;
use crate::signal::CHAMBERS;

/// Pressure of the air around, Pa.
pub const ATMOSPHERE_PA: f64 = 101_325.0;
/// Ratio of the specific heats of air.
const HEAT_RATIO: f64 = 1.4;
/// Time in which the air takes the wall's temperature, s.
const WALL_S: f64 = 0.8;
/// Volume between pump, valve and gauge, m³.
const BOARD_M3: f64 = 20e-6;
/// Resistance of a line, Pa s/m³.
pub const LINE_PA_S_M3: f64 = 7.5e6;
/// Gauge pressure at which an orifice loses as much as a laminar leak of the same figure, Pa.
const ORIFICE_PA: f64 = 20e3;
/// Below this gauge pressure the flow through an orifice is laminar, Pa.
const LAMINAR_PA: f64 = 500.0;

/// Flows through one chamber's pump, line and leaks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Flow {
    /// Pump flow, m³/s at atmospheric pressure; negative when it evacuates.
    pub pumped_m3_s: f64,
    /// Laminar leak per Pa of gauge pressure, m³/(s Pa) at atmospheric pressure.
    pub leak_m3_s_pa: f64,
    /// Turbulent leak through an orifice, stated by its flow per Pa at 20 kPa, m³/(s Pa).
    pub orifice_m3_s_pa: f64,
    /// Resistance of the line, Pa s/m³.
    pub line_pa_s_m3: f64,
}

impl Default for Flow {
    /// Nothing is pumped, nothing leaks.
    fn default() -> Self {
        Self {
            pumped_m3_s: 0.0,
            leak_m3_s_pa: 0.0,
            orifice_m3_s_pa: 0.0,
            line_pa_s_m3: LINE_PA_S_M3,
        }
    }
}

impl Flow {
    fn leaked_m3_s(&self, gauge_pa: f64) -> f64 {
        let turbulent = gauge_pa * (ORIFICE_PA / gauge_pa.abs().max(LAMINAR_PA)).sqrt();
        self.leak_m3_s_pa * gauge_pa + self.orifice_m3_s_pa * turbulent
    }
}

/// Air of all chambers.
#[derive(Clone, Debug, PartialEq)]
pub struct Chambers {
    /// Amount in each chamber, Pa m³ at ambient temperature.
    amount_pa_m3: [f64; CHAMBERS],
    /// Temperature relative to the ambient one.
    warmth: [f64; CHAMBERS],
    board_pa: [f64; CHAMBERS],
    volume_m3: [f64; CHAMBERS],
}

impl Chambers {
    /// At atmospheric pressure with these volumes, m³.
    pub fn open(volume_m3: [f64; CHAMBERS]) -> Self {
        Self {
            amount_pa_m3: volume_m3.map(|v| v * ATMOSPHERE_PA),
            warmth: [1.0; CHAMBERS],
            board_pa: [0.0; CHAMBERS],
            volume_m3,
        }
    }

    /// The same at these gauge pressures (Pa), at ambient temperature.
    pub fn at(volume_m3: [f64; CHAMBERS], gauge_pa: &[f64; CHAMBERS]) -> Self {
        Self {
            amount_pa_m3: std::array::from_fn(|c| volume_m3[c] * (ATMOSPHERE_PA + gauge_pa[c])),
            board_pa: *gauge_pa,
            ..Self::open(volume_m3)
        }
    }

    /// Gauge pressures in the chambers, Pa.
    pub fn chamber_pa(&self) -> [f64; CHAMBERS] {
        std::array::from_fn(|c| self.gauge_pa(c, self.volume_m3[c]))
    }

    /// Gauge pressures at the boards, Pa: what their gauges see.
    pub fn board_pa(&self) -> &[f64; CHAMBERS] {
        &self.board_pa
    }

    /// Air in a chamber and at its board together, Pa m³.
    pub fn held_pa_m3(&self, chamber: usize) -> f64 {
        self.amount_pa_m3[chamber] + (ATMOSPHERE_PA + self.board_pa[chamber]) * BOARD_M3
    }

    /// Takes over the volumes (m³) that the arm has now, and lets air flow for `dt_s`. Returns what came in through
    /// pump and leak, Pa m³.
    pub fn flow(
        &mut self,
        volume_m3: &[f64; CHAMBERS],
        flows: &[Flow; CHAMBERS],
        dt_s: f64,
    ) -> [f64; CHAMBERS] {
        std::array::from_fn(|c| {
            let pressed = (self.volume_m3[c] / volume_m3[c]).powf(HEAT_RATIO - 1.0);
            self.warmth[c] *= pressed;
            self.volume_m3[c] = volume_m3[c];
            let p = self.gauge_pa(c, volume_m3[c]);
            // Backward in the board's small volume.
            let a = dt_s * ATMOSPHERE_PA / BOARD_M3;
            let (pumped, line) = (flows[c].pumped_m3_s, flows[c].line_pa_s_m3);
            self.board_pa[c] = (self.board_pa[c] + a * (pumped + p / line)) / (1.0 + a / line);
            let leaked = flows[c].leaked_m3_s(p);
            let through = (self.board_pa[c] - p) / line;
            let change = ATMOSPHERE_PA * (through - leaked) * dt_s;
            let brought = if change > 0.0 {
                HEAT_RATIO - self.warmth[c]
            } else {
                (HEAT_RATIO - 1.0) * self.warmth[c]
            };
            let warmth = self.warmth[c] + brought * change / self.amount_pa_m3[c];
            self.warmth[c] = 1.0 + (warmth - 1.0) * (-dt_s / WALL_S).exp();
            self.amount_pa_m3[c] += change;
            ATMOSPHERE_PA * (pumped - leaked) * dt_s
        })
    }
}

impl Air for Chambers {
    /// Without exchange of heat since the last flow.
    fn gauge_pa(&self, chamber: usize, volume_m3: f64) -> f64 {
        let pressed = (self.volume_m3[chamber] / volume_m3).powf(HEAT_RATIO - 1.0);
        self.amount_pa_m3[chamber] * self.warmth[chamber] * pressed / volume_m3 - ATMOSPHERE_PA
    }
}
