//! From the boards' set pressures to flows: link, regulators, pumps, lines, gauges.
//!
//! | part | equation |
//! |---|---|
//! | regulator on its gauge | q = Q clip((u − s − p_gauge)/500 Pa) |
//! | gauge | p_gauge = o + g p + c p² |
//! | shared supply | ṡ = Σ_{j≠i} g(ṗ_j) − s/τ, set pressures sag by k s (1 + p/120 kPa) |
//! | line | R = R₀ + τ P_atm / S, with S the chamber's storage V + P_atm A²/k |

use std::collections::VecDeque;

use rand_pcg::Pcg64Mcg;

use crate::rig::hidden::Defects;
use crate::rig::multibody::air::{ATMOSPHERE_PA, Flow, LINE_PA_S_M3};
use crate::rig::noise::normal;
use crate::robot::RobotSpec;
use crate::signal::{CHAMBERS, stream};

/// Pressure error beyond which a pump gives its full flow, Pa.
const FULL_FLOW_PA: f64 = 500.0;
/// Period of the set-point packets on a slow link, s.
const PACKET_S: f64 = 0.02;
/// Pressure at which a bent gauge is off by as much as is stated, Pa.
const BENT_PA: f64 = 40e3;

/// A set point on its way: when it arrives (s), and the pressure (Pa).
type Packet = (f64, Option<f64>);

/// Regulators, pumps, lines and gauges of one unit.
#[derive(Clone, Debug)]
pub struct Supply {
    pump_m3_s: [f64; CHAMBERS],
    line_pa_s_m3: [f64; CHAMBERS],
    /// Gain and offset (Pa) of each gauge.
    gauge: [[f64; 2]; CHAMBERS],
    /// Air that raises a chamber by 1 Pa, as a volume at atmospheric pressure, m³.
    storage_m3: [f64; CHAMBERS],
    packets: [VecDeque<Packet>; CHAMBERS],
    next_packet_s: f64,
    arrived: [Option<f64>; CHAMBERS],
    followed_pa: [f64; CHAMBERS],
    sag_pa: [f64; CHAMBERS],
    before_pa: [f64; CHAMBERS],
    rate_pa_s: [f64; CHAMBERS],
    rng: Pcg64Mcg,
}

impl Supply {
    /// Of a unit as manufactured.
    pub fn new(robot: &RobotSpec, unit: u64) -> Self {
        let mut rng = stream(unit, 0x5011);
        let r = &mut rng;
        let storage_m3 = |i: usize| {
            let area_m2 = robot.area_m2[i];
            area_m2 * robot.rest_length_m
                + ATMOSPHERE_PA * area_m2.powi(2) / robot.axial_stiffness_n_m[i]
        };
        Self {
            pump_m3_s: std::array::from_fn(|_| robot.pump_flow_m3_s * (1.0 + 0.03 * normal(r))),
            line_pa_s_m3: std::array::from_fn(|_| LINE_PA_S_M3 * (1.0 + 0.1 * normal(r))),
            gauge: std::array::from_fn(|_| [1.0 + 1.5e-3 * normal(r), 30.0 * normal(r)]),
            storage_m3: std::array::from_fn(storage_m3),
            packets: Default::default(),
            next_packet_s: f64::MIN,
            arrived: [None; CHAMBERS],
            followed_pa: [0.0; CHAMBERS],
            sag_pa: [0.0; CHAMBERS],
            before_pa: [0.0; CHAMBERS],
            rate_pa_s: [0.0; CHAMBERS],
            rng,
        }
    }

    /// What the gauges read of the pressures at the boards, without noise, Pa.
    pub fn gauge_pa(&self, board_pa: &[f64; CHAMBERS], d: &Defects) -> [f64; CHAMBERS] {
        std::array::from_fn(|i| {
            let [gain, offset] = d.gauge[i];
            let p = board_pa[i];
            // c = 0.15 (g − 1)/40 kPa
            let bent = 0.15 * (gain - 1.0) / BENT_PA;
            let [own_gain, own_offset] = self.gauge[i];
            own_offset + own_gain * (offset + gain * p + bent * p * p)
        })
    }

    /// Σ |dp/dt| over the chambers, Pa/s.
    pub fn activity_pa_s(&self) -> f64 {
        self.rate_pa_s.iter().map(|r| r.abs()).sum()
    }

    /// Flows at `t_s` for `dt_s` towards the set pressures (Pa; `None`: pumps off, the air stays). `share` is the part
    /// of its flow that each pump gives.
    pub fn flows(
        &mut self,
        t_s: f64,
        set_pa: &[Option<f64>; CHAMBERS],
        board_pa: &[f64; CHAMBERS],
        share: &[f64; CHAMBERS],
        d: &Defects,
        dt_s: f64,
    ) -> [Flow; CHAMBERS] {
        let set_pa = self.deliver(t_s, set_pa, d, dt_s);
        let gauge_pa = self.gauge_pa(board_pa, d);
        for i in 0..CHAMBERS {
            let rate = (board_pa[i] - self.before_pa[i]) / dt_s;
            // The line's small volume trembles.
            self.rate_pa_s[i] += 0.2 * (rate - self.rate_pa_s[i]);
        }
        self.before_pa = *board_pa;
        let drawn = self.rate_pa_s.map(|v| if v > 0.0 { v } else { 0.75 * v });
        let all: f64 = drawn.iter().sum();
        std::array::from_fn(|i| {
            self.sag_pa[i] += dt_s * (all - drawn[i] - self.sag_pa[i] / d.sag_s);
            let pumped = set_pa[i].map_or(0.0, |set| {
                let sag = d.sag_ratio[i] * self.sag_pa[i] * (1.0 + gauge_pa[i] / 120e3);
                let missing = set - sag - gauge_pa[i];
                // A worn valve stops short when it fills.
                let missing = match missing > 0.0 {
                    true => (missing - d.short_pa).max(0.0),
                    false => missing,
                };
                let most = |rate_pa_s: f64| {
                    let own = share[i] * self.pump_m3_s[i];
                    own.min(rate_pa_s * self.storage_m3[i] / ATMOSPHERE_PA)
                };
                let [up, down] = d.flow_pa_s[i].map(most);
                let wanted = self.pump_m3_s[i] * share[i] * missing / FULL_FLOW_PA;
                wanted.clamp(-down, up)
            });
            Flow {
                pumped_m3_s: pumped,
                leak_m3_s_pa: 0.0,
                orifice_m3_s_pa: d.leak_1_s[i] * self.storage_m3[i] / ATMOSPHERE_PA,
                line_pa_s_m3: self.line_pa_s_m3[i]
                    + d.line_s[i] * ATMOSPHERE_PA / self.storage_m3[i],
            }
        })
    }

    /// Set pressures as they have arrived.
    fn deliver(
        &mut self,
        t_s: f64,
        set_pa: &[Option<f64>; CHAMBERS],
        d: &Defects,
        dt_s: f64,
    ) -> [Option<f64>; CHAMBERS] {
        if d.delay_s == [0.0; CHAMBERS] {
            return *set_pa;
        }
        let packet = t_s >= self.next_packet_s;
        if packet {
            self.next_packet_s = t_s + PACKET_S;
        }
        let jitter = if packet { normal(&mut self.rng) } else { 0.0 };
        std::array::from_fn(|i| {
            let delay_s = d.delay_s[i];
            // Pumps off is a line of its own.
            if delay_s == 0.0 || set_pa[i].is_none() {
                self.packets[i].clear();
                self.arrived[i] = set_pa[i];
                self.followed_pa[i] = set_pa[i].unwrap_or_default();
                return set_pa[i];
            }
            if packet {
                let arrives_s = t_s + delay_s * (1.0 + 0.15 * jitter).max(0.0);
                self.packets[i].push_back((arrives_s, set_pa[i]));
            }
            while let Some(&(_, pa)) = self.packets[i].front().filter(|p| p.0 <= t_s) {
                self.arrived[i] = pa;
                self.packets[i].pop_front();
            }
            let pass = -(-dt_s / (0.125 * delay_s)).exp_m1();
            let to_pa = self.arrived[i]?;
            self.followed_pa[i] += pass * (to_pa - self.followed_pa[i]);
            Some(self.followed_pa[i])
        })
    }
}
