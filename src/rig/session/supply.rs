//! From commanded pressure to the pressure in the chambers: link, regulators, supply, lines, gauges.
//!
//! | part | equation |
//! |---|---|
//! | regulator | v' = ω² (u − p) − 2 ω v, p' = clip(v) − leak |
//! | orifice (ISO 6358) | q ∝ P_up ψ(P_down/P_up), ψ = 1 below b, √(1 − ((r − b)/(1 − b))²) above |
//! | line | x' = (p − x)/τ · (1 + x/P_atm) / √(1 + |p − x|/8 kPa), twice |

use std::collections::VecDeque;

use rand::Rng;
use rand_pcg::Pcg64Mcg;

use crate::rig::hidden::Defects;
use crate::signal::CHAMBERS;
use crate::sim::dataset::{normal, sample_rng};

const ATMOSPHERE_PA: f64 = 101_325.0;
/// Absolute pressures of the supply and of the vacuum, Pa.
const SUPPLY_PA: f64 = ATMOSPHERE_PA + 90e3;
const VACUUM_PA: f64 = ATMOSPHERE_PA - 70e3;
const CRITICAL_RATIO: f64 = 0.3;
/// Period of the set-point packets on a slow link, s.
const PACKET_S: f64 = 0.02;
/// Resolution of the gauges, Pa.
pub const GAUGE_STEP_PA: f64 = 10.0;
pub const GAUGE_NOISE_PA: f64 = 40.0;

/// Scatter of healthy supplies.
#[derive(Clone, Debug)]
pub struct Fittings {
    /// Lag 2/ω of each regulator, s.
    regulator_s: [f64; CHAMBERS],
    line_s: [f64; CHAMBERS],
    /// Gain and offset (Pa) of each gauge.
    gauge: [[f64; 2]; CHAMBERS],
}

impl Fittings {
    pub fn new(specimen: u64) -> Self {
        let mut rng = sample_rng(specimen, 0x5011);
        Self {
            regulator_s: std::array::from_fn(|_| 0.09 * (1.0 + 0.08 * normal(&mut rng))),
            line_s: std::array::from_fn(|_| rng.random_range(0.008..0.02)),
            gauge: std::array::from_fn(|_| {
                [1.0 + 1.5e-3 * normal(&mut rng), 30.0 * normal(&mut rng)]
            }),
        }
    }
}

/// The supply with its chambers' gas.
pub struct Supply<'a> {
    fittings: Fittings,
    defects: &'a Defects,
    packets: [VecDeque<[f64; 2]>; CHAMBERS],
    next_packet_s: f64,
    set_pa: [f64; CHAMBERS],
    late_pa: [f64; CHAMBERS],
    sag_pa: [f64; CHAMBERS],
    rate_pa_s: [f64; CHAMBERS],
    /// At the gauges, Pa.
    regulated_pa: [f64; CHAMBERS],
    line_pa: [[f64; 2]; CHAMBERS],
    rng: Pcg64Mcg,
}

impl<'a> Supply<'a> {
    pub fn new(fittings: Fittings, defects: &'a Defects, seed: u64) -> Self {
        Self {
            fittings,
            defects,
            packets: Default::default(),
            next_packet_s: f64::MIN,
            set_pa: [0.0; CHAMBERS],
            late_pa: [0.0; CHAMBERS],
            sag_pa: [0.0; CHAMBERS],
            rate_pa_s: [0.0; CHAMBERS],
            regulated_pa: [0.0; CHAMBERS],
            line_pa: [[0.0; 2]; CHAMBERS],
            rng: sample_rng(seed, 0x11e5),
        }
    }

    /// Pressures in the chambers, Pa.
    pub fn chamber_pa(&self) -> [f64; CHAMBERS] {
        self.line_pa.map(|x| x[1])
    }

    /// Σ |dp/dt| over the chambers, Pa/s.
    pub fn activity_pa_s(&self) -> f64 {
        self.rate_pa_s.iter().map(|r| r.abs()).sum()
    }

    /// Gauge readings without noise, Pa.
    pub fn gauge_pa(&self) -> [f64; CHAMBERS] {
        std::array::from_fn(|i| {
            let [gain, offset] = self.defects.gauge[i];
            let p = self.regulated_pa[i];
            // c = 0.15 (g − 1)/40 kPa
            let bent = 0.15 * (gain - 1.0) / 40e3;
            let [own_gain, own_offset] = self.fittings.gauge[i];
            own_offset + own_gain * (offset + gain * p + bent * p * p)
        })
    }

    /// One step of `h_s` with what is commanded at `t_s`.
    pub fn step(&mut self, t_s: f64, command_pa: &[f64; CHAMBERS], h_s: f64) {
        self.deliver(t_s, command_pa, h_s);
        let d = self.defects;
        let drawn = self.rate_pa_s.map(|v| if v > 0.0 { v } else { 0.75 * v });
        let all: f64 = drawn.iter().sum();
        for i in 0..CHAMBERS {
            // ds/dt = Σ_{j≠i} g(dp_j/dt) − s/τ
            self.sag_pa[i] += h_s * (all - drawn[i] - self.sag_pa[i] / d.sag_s);
            let p = self.regulated_pa[i];
            let sag = d.sag_ratio[i] * self.sag_pa[i] * (1.0 + p / 120e3);
            let omega = 2.0 / self.fittings.regulator_s[i];
            let v = self.rate_pa_s[i];
            let pull = omega * omega * (self.set_pa[i] - sag - p) - 2.0 * omega * v;
            let [up, down] = d.flow_pa_s[i];
            let v = (v + h_s * pull).clamp(-down * emptying(p), up * filling(p));
            self.rate_pa_s[i] = v;
            self.regulated_pa[i] = p + h_s * (v - d.leak_1_s[i] * outflow_pa(p));
            self.follow_line(i, h_s);
        }
    }

    fn deliver(&mut self, t_s: f64, command_pa: &[f64; CHAMBERS], h_s: f64) {
        let d = self.defects;
        let packet = t_s >= self.next_packet_s;
        if packet {
            self.next_packet_s = t_s + PACKET_S;
        }
        let jitter = if packet { normal(&mut self.rng) } else { 0.0 };
        for i in 0..CHAMBERS {
            let delay_s = d.delay_s[i];
            if delay_s == 0.0 {
                self.set_pa[i] = command_pa[i];
                continue;
            }
            if packet {
                let arrives_s = t_s + delay_s * (1.0 + 0.15 * jitter).max(0.0);
                self.packets[i].push_back([arrives_s, command_pa[i]]);
            }
            while let Some([_, pa]) = self.packets[i].front().filter(|p| p[0] <= t_s).copied() {
                self.late_pa[i] = pa;
                self.packets[i].pop_front();
            }
            let pass = -(-h_s / (0.125 * delay_s)).exp_m1();
            self.set_pa[i] += pass * (self.late_pa[i] - self.set_pa[i]);
        }
    }

    fn follow_line(&mut self, i: usize, h_s: f64) {
        let slow_s = self.defects.line_s[i];
        let taus = [0.75 * slow_s, 0.25 * slow_s + self.fittings.line_s[i]];
        let mut from = self.regulated_pa[i];
        for (x, tau_s) in self.line_pa[i].iter_mut().zip(taus) {
            let difference = from - *x;
            let ease = (1.0 + *x / ATMOSPHERE_PA) / (1.0 + difference.abs() / 8e3).sqrt();
            *x += if tau_s > 0.0 {
                -(-h_s * ease / tau_s).exp_m1() * difference
            } else {
                difference
            };
            from = *x;
        }
    }
}

/// ψ of ISO 6358.
fn psi(ratio: f64) -> f64 {
    let over = ((ratio - CRITICAL_RATIO) / (1.0 - CRITICAL_RATIO)).clamp(0.0, 1.0);
    (1.0 - over * over).sqrt()
}

/// Flow from the supply at gauge pressure p over that at 0 Pa.
fn filling(p: f64) -> f64 {
    psi((ATMOSPHERE_PA + p) / SUPPLY_PA) / psi(ATMOSPHERE_PA / SUPPLY_PA)
}

/// Flow to the vacuum at gauge pressure p over that at 0 Pa.
fn emptying(p: f64) -> f64 {
    let absolute = ATMOSPHERE_PA + p;
    absolute * psi(VACUUM_PA / absolute) / (ATMOSPHERE_PA * psi(VACUUM_PA / ATMOSPHERE_PA))
}

/// sign(p) √(|p| · 20 kPa), linear below 500 Pa, Pa.
fn outflow_pa(p: f64) -> f64 {
    p * (20e3 / p.abs().max(500.0)).sqrt()
}
