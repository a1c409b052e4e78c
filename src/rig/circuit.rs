//! The spring oscillators of the virtual rig, from their physics.
//!
//! Each spring is a coil of steel wire in an LC oscillator whose periods the board counts. The
//! inductance comes from the coil's geometry, never from a calibration curve turned round:
//!
//! | symbol | meaning | value |
//! |---|---|---|
//! | N | turns: the free length is close-wound, N = l₀ / d | 150 |
//! | d, a | wire diameter and radius | 0.4, 0.2 mm |
//! | D | mean coil diameter, thinner as the coil is drawn out | 3.6 mm |
//! | W | length of the wire, W² = (π D N)² + l₀² | 1.70 m |
//! | k_N | Nagaoka's end correction (H. Nagaoka, J. Coll. Sci. Tokyo 27, 1909, art. 6) | 0.98 … 0.99 |
//! | ρ, µr | resistivity and relative permeability of the wire | 1.8·10⁻⁷ Ω m, 60 |
//! | L_comp, C | series inductor and capacitor (paper II-C, with the units exchanged back) | 10 µH, 1000 pF |
//!
//! The coil alone gives 4.0 µH at 70 mm and 1.2 µH at 240 mm. The current in a steel wire keeps
//! to its skin, whose internal inductance adds about 1.2 µH; f then runs from about 1.29 MHz
//! (70 mm) to 1.43 MHz (240 mm).

use std::f64::consts::{PI, TAU};
use std::fmt::Write;

use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64;

use super::noise::normal;
use crate::robot::RobotSpec;
use crate::signal::SPRINGS;

const MU0_H_M: f64 = 4.0e-7 * PI;
/// Resistivity of the wire at the bench's temperature, Ω m.
const RESISTIVITY_OHM_M: f64 = 1.8e-7;
/// Relative change of the resistivity, 1/K.
const RESISTIVITY_RISE_PER_K: f64 = 3.0e-3;
/// Relative permeability of the wire.
const PERMEABILITY: f64 = 60.0;
/// Inductance of the leads, H.
const LEAD_H: f64 = 40.0e-9;
/// Nominal series inductor, H.
const COMPENSATION_H: f64 = 10.0e-6;
/// Nominal capacitor, F.
const CAPACITANCE_F: f64 = 1000.0e-12;
/// Relative change of the capacitor (NP0), 1/K.
const CAPACITANCE_RISE_PER_K: f64 = 30.0e-6;

/// Manufacturing scatter that the shipped rig has: about 1 % on each part.
pub const USUAL_SCATTER: f64 = 0.01;

/// Complete elliptic integrals (K, E) of modulus `k` in (0, 1), by the arithmetic-geometric mean.
fn elliptic(k: f64) -> (f64, f64) {
    let (mut a, mut b, mut c) = (1.0, (1.0 - k * k).sqrt(), k);
    let mut sum = 0.5 * c * c;
    let mut weight = 0.5;
    while c.abs() > 1e-16 {
        (a, b, c) = (0.5 * (a + b), (a * b).sqrt(), 0.5 * (a - b));
        weight *= 2.0;
        sum += weight * c * c;
    }
    let first = PI / (2.0 * a);
    (first, first * (1.0 - sum))
}

/// Nagaoka's coefficient for a solenoid of the given diameter and length (same unit).
pub fn nagaoka(diameter: f64, length: f64) -> f64 {
    let hypot = diameter.hypot(length);
    let (k, k1) = (diameter / hypot, length / hypot);
    let (first, second) = elliptic(k);
    // k_N = 4/(3π k') · [k'²/k² · (K − E) + E − k]
    4.0 / (3.0 * PI * k1) * ((k1 / k).powi(2) * (first - second) + second - k)
}

/// One spring with its oscillator.
#[derive(Clone, Debug)]
struct Oscillator {
    turns: f64,
    wire_length_m: f64,
    wire_radius_m: f64,
    permeability: f64,
    /// Length between the pads that is hook, not coil, m.
    hook_m: f64,
    compensation_h: f64,
    capacitance_f: f64,
}

impl Oscillator {
    fn new(spec: &RobotSpec, scatter_ratio: f64, rng: &mut Pcg64) -> Self {
        let s = &spec.spring;
        // Parts are sorted before they are built in: nothing lies beyond two sigma.
        let mut near = |share: f64| 1.0 + scatter_ratio * share * normal(rng).clamp(-2.0, 2.0);
        let turns = s.free_length_m / s.wire_diameter_m * near(0.5);
        let mean_diameter_m = (s.outer_diameter_m - s.wire_diameter_m) * near(1.0);
        Self {
            turns,
            wire_length_m: (PI * mean_diameter_m * turns).hypot(s.free_length_m),
            wire_radius_m: 0.5 * s.wire_diameter_m,
            permeability: PERMEABILITY * near(3.0),
            hook_m: s.free_length_m * (near(0.5) - 1.0),
            compensation_h: COMPENSATION_H * near(1.0),
            capacitance_f: CAPACITANCE_F * near(1.0),
        }
    }

    /// Inductance of the drawn-out coil, H.
    fn coil_h(&self, length_m: f64) -> f64 {
        let coil_m = (length_m - self.hook_m).clamp(1e-3, 0.99 * self.wire_length_m);
        // The wire keeps its length: W² = (π D N)² + l², so D shrinks by 1 % up to 240 mm.
        let diameter_m = (self.wire_length_m.powi(2) - coil_m.powi(2)).sqrt() / (PI * self.turns);
        // L = µ0 N² (π D²/4) / l · k_N
        MU0_H_M * self.turns.powi(2) * PI * 0.25 * diameter_m.powi(2) / coil_m
            * nagaoka(diameter_m, coil_m)
    }

    /// Internal inductance of the wire by the skin effect, H.
    fn skin_h(&self, frequency_hz: f64, temperature_rise_k: f64) -> f64 {
        let rho = RESISTIVITY_OHM_M * (1.0 + RESISTIVITY_RISE_PER_K * temperature_rise_k);
        // δ = √(ρ / (π f µ)), R = ρ W / (2π a δ), and in a thin skin ω L = R.
        let skin_m = (rho / (PI * frequency_hz * MU0_H_M * self.permeability)).sqrt();
        let resistance_ohm = rho * self.wire_length_m / (TAU * self.wire_radius_m * skin_m);
        resistance_ohm / (TAU * frequency_hz)
    }

    fn frequency_hz(&self, length_m: f64, temperature_rise_k: f64) -> f64 {
        let capacitance_f =
            self.capacitance_f * (1.0 + CAPACITANCE_RISE_PER_K * temperature_rise_k);
        let fixed_h = self.coil_h(length_m) + LEAD_H + self.compensation_h;
        // f = 1 / (2π √(L C)) with L(f): a fixed point that gains a factor of 40 per turn.
        let mut frequency_hz = 1.35e6;
        for _ in 0..8 {
            let total_h = fixed_h + self.skin_h(frequency_hz, temperature_rise_k);
            frequency_hz = 1.0 / (TAU * (total_h * capacitance_f).sqrt());
        }
        frequency_hz
    }
}

/// The twelve oscillators, what disturbs the springs, and the boards' counters.
#[derive(Clone, Debug)]
pub struct Circuit {
    oscillators: [Oscillator; SPRINGS],
    /// Length each spring has settled to, m; `None` before the first step.
    felt_m: Option<[f64; SPRINGS]>,
    /// Time constant of the springs' lag behind the pads, s.
    pub lag_s: f64,
    /// Standard deviation of the coils' tremble, m of length.
    pub tremble_m: f64,
    /// Standard deviation of one edge's time stamp beyond its rounding, ticks.
    pub jitter_ticks: f64,
    /// Temperature of each oscillator above that of the bench, K.
    pub temperature_rise_k: [f64; SPRINGS],
    /// Gate that the board sets, s of its clock.
    pub gate_s: f64,
    /// Nominal clock of the counters, Hz.
    pub tick_rate_hz: f64,
    /// Clock seconds per second of the counter that each spring is plugged into.
    pub clock_rate: [f64; SPRINGS],
}

impl Circuit {
    /// Twelve springs drawn with the relative scatter `scatter_ratio` (0 for all alike,
    /// [`USUAL_SCATTER`] for a rig as built). The seed stands for the unit: the same seed is the
    /// same rig.
    pub fn new(spec: &RobotSpec, seed: u64, scatter_ratio: f64) -> Self {
        let mut rng = Pcg64::seed_from_u64(seed);
        Self {
            oscillators: std::array::from_fn(|_| Oscillator::new(spec, scatter_ratio, &mut rng)),
            felt_m: None,
            lag_s: 0.015,
            tremble_m: 0.09e-3,
            jitter_ticks: 0.1,
            temperature_rise_k: [0.0; SPRINGS],
            gate_s: 8.0e-3,
            tick_rate_hz: 2.0e6,
            clock_rate: [1.0; SPRINGS],
        }
    }

    /// Lets `dt_s` pass with the springs drawn to `true_length_m`. The first call settles at once.
    pub fn step(&mut self, dt_s: f64, true_length_m: &[f64; SPRINGS]) {
        // τ dl/dt = l_true − l
        let pass = -(-dt_s / self.lag_s).exp_m1();
        let felt_m = self.felt_m.get_or_insert(*true_length_m);
        for (felt, want) in felt_m.iter_mut().zip(true_length_m) {
            *felt += pass * (want - *felt);
        }
    }

    /// Puts the springs at `true_length_m`, settled.
    pub fn settle(&mut self, true_length_m: &[f64; SPRINGS]) {
        self.felt_m = Some(*true_length_m);
    }

    /// Lengths the springs have settled to, m (zero before the first step).
    pub fn felt_m(&self) -> [f64; SPRINGS] {
        self.felt_m.unwrap_or_default()
    }

    /// Frequency of oscillator `i` (0-based) at rest at a length, Hz, without noise.
    pub fn frequency_hz(&self, i: usize, length_m: f64) -> f64 {
        self.oscillators[i].frequency_hz(length_m, self.temperature_rise_k[i])
    }

    /// By how much spring `i` (0-based) reads longer per kelvin at a length, m/K.
    pub fn drift_m_k(&self, i: usize, length_m: f64) -> f64 {
        const STEP_M: f64 = 1e-4;
        let oscillator = &self.oscillators[i];
        let at = |length_m: f64, rise_k: f64| oscillator.frequency_hz(length_m, rise_k);
        let per_m = (at(length_m + STEP_M, 0.0) - at(length_m, 0.0)) / STEP_M;
        (at(length_m, 1.0) - at(length_m, 0.0)) / per_m
    }

    /// Inductance of coil `i` (0-based) alone, H: no leads, no skin effect.
    pub fn coil_h(&self, i: usize, length_m: f64) -> f64 {
        self.oscillators[i].coil_h(length_m)
    }

    /// One reciprocal count per spring by its board's clock: whole periods within the gate, and the ticks they took.
    /// All zero before the first [`Self::step`].
    pub fn read<R: Rng + ?Sized>(&self, rng: &mut R) -> ([u32; SPRINGS], [u32; SPRINGS]) {
        self.read_by(&self.clock_rate, rng)
    }

    /// The same by clocks that run at these rates (clock seconds per second).
    fn read_by<R: Rng + ?Sized>(
        &self,
        clock_rate: &[f64; SPRINGS],
        rng: &mut R,
    ) -> ([u32; SPRINGS], [u32; SPRINGS]) {
        let mut counts = [0; SPRINGS];
        let mut gates = [0; SPRINGS];
        let Some(felt_m) = self.felt_m else {
            return (counts, gates);
        };
        for i in 0..SPRINGS {
            let length_m = felt_m[i] + self.tremble_m * normal(rng);
            let frequency_hz = self.frequency_hz(i, length_m);
            let periods = (self.gate_s / clock_rate[i] * frequency_hz).floor();
            // Both edges are caught at the next tick: the first at a random place within its tick.
            let start = rng.random::<f64>();
            let end = start
                + periods / frequency_hz * self.tick_rate_hz * clock_rate[i]
                + self.jitter_ticks * normal(rng);
            counts[i] = periods as u32;
            gates[i] = end.floor() as u32;
        }
        (counts, gates)
    }
}

/// Motion of the bench's linear motor.
#[derive(Clone, Debug, PartialEq)]
pub struct BenchPlan {
    /// Shortest and longest length, m.
    pub range_m: [f64; 2],
    /// Stops per way, both ends included.
    pub stops: usize,
    /// Rest at each stop before it is read, s.
    pub dwell_s: f64,
    /// Readings averaged at each stop.
    pub readings: usize,
    /// How much longer a spring is on the way down than on the way up at the same reading of the motor, m:
    /// slack in the motor's screw.
    pub slack_m: f64,
    /// Springs (0-based) with a loose contact.
    pub loose: Vec<usize>,
}

/// Standard deviation that a loose contact adds to what a stop reads, Hz.
const LOOSE_HZ: f64 = 8e3;

impl BenchPlan {
    /// The robot's spring range with 2 mm beyond either end, so that noise at the ends stays
    /// inside the calibrated domain; 44 stops up and 44 down.
    pub fn for_robot(spec: &RobotSpec) -> Self {
        let [low_m, high_m] = spec.spring.range_m;
        Self {
            range_m: [low_m - 2.0e-3, high_m + 2.0e-3],
            stops: 44,
            dwell_s: 0.1,
            readings: 32,
            slack_m: 0.0,
            loose: Vec::new(),
        }
    }
}

/// Draws all springs up and down on the bench and returns its log as CSV: `spring, direction,
/// length_mm, frequency_hz` (mean of the readings at the stop). The bench is an instrument whose own clock is exact. The
/// circuit is left at the last stop.
pub fn bench<R: Rng + ?Sized>(circuit: &mut Circuit, plan: &BenchPlan, rng: &mut R) -> String {
    let [low_m, high_m] = plan.range_m;
    let step_m = (high_m - low_m) / (plan.stops.max(2) - 1) as f64;
    let mut text = String::from("spring,direction,length_mm,frequency_hz\n");
    circuit.settle(&[low_m; SPRINGS]);
    for direction in ["up", "down"] {
        for stop in 0..plan.stops {
            let along = match direction {
                "up" => stop,
                _ => plan.stops - 1 - stop,
            };
            let length_m = low_m + step_m * along as f64;
            let slack_m = match direction {
                "up" => -0.5 * plan.slack_m,
                _ => 0.5 * plan.slack_m,
            };
            circuit.step(plan.dwell_s, &[length_m + slack_m; SPRINGS]);
            let mut sum_hz = [0.0; SPRINGS];
            for _ in 0..plan.readings {
                let (counts, gates) = circuit.read_by(&[1.0; SPRINGS], rng);
                for i in 0..SPRINGS {
                    sum_hz[i] += f64::from(counts[i]) * circuit.tick_rate_hz / f64::from(gates[i]);
                }
            }
            for (i, sum) in sum_hz.iter().enumerate() {
                let loose_hz = match plan.loose.contains(&i) {
                    true => LOOSE_HZ * normal(rng),
                    false => 0.0,
                };
                let mean_hz = sum / plan.readings as f64 + loose_hz;
                // Writing to a String cannot fail.
                let _ = writeln!(
                    text,
                    "{},{direction},{:.3},{mean_hz:.1}",
                    i + 1,
                    length_m * 1e3
                );
            }
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    fn circuit() -> Circuit {
        Circuit::new(&RobotSpec::reference(), 1, 0.0)
    }

    /// Grover's table of Nagaoka's coefficient.
    #[test]
    fn nagaoka_matches_the_printed_table() {
        for (ratio, k) in [
            (0.2, 0.9201),
            (0.5, 0.8181),
            (1.0, 0.6884),
            (2.0, 0.5255),
            (10.0, 0.2033),
        ] {
            let ours = nagaoka(ratio, 1.0);
            assert!((ours - k).abs() < 1e-4, "D/l = {ratio}: {ours}");
        }
        // Long coil: 1 − 4/(3π) D/l.
        let thin = nagaoka(1e-3, 1.0);
        assert!((thin - (1.0 - 4.0e-3 / (3.0 * PI))).abs() < 1e-6, "{thin}");
    }

    #[test]
    fn coil_and_frequency_are_where_the_paper_puts_them() {
        let c = circuit();
        assert!(
            (c.coil_h(0, 0.070) - 4.0e-6).abs() < 0.05e-6,
            "{}",
            c.coil_h(0, 0.070)
        );
        assert!(
            (c.coil_h(0, 0.240) - 1.2e-6).abs() < 0.05e-6,
            "{}",
            c.coil_h(0, 0.240)
        );
        let (low, high) = (c.frequency_hz(0, 0.070), c.frequency_hz(0, 0.240));
        assert!((low - 1.28e6).abs() < 0.02e6, "{low}");
        assert!((high - 1.43e6).abs() < 0.02e6, "{high}");
    }

    #[test]
    fn count_over_gate_is_the_frequency_and_its_noise_is_a_tenth_of_a_millimetre() {
        let mut c = circuit();
        let mut rng = Pcg64::seed_from_u64(5);
        for length_m in [0.075, 0.153, 0.230] {
            c.settle(&[length_m; SPRINGS]);
            let wanted_hz = c.frequency_hz(0, length_m);
            let per_m = (c.frequency_hz(0, length_m + 1e-4) - wanted_hz) / 1e-4;
            let mut errors_m = Vec::new();
            for _ in 0..200 {
                let (n, g) = c.read(&mut rng);
                assert!((f64::from(g[0]) - 16_000.0).abs() < 5.0);
                for i in 0..SPRINGS {
                    let f = f64::from(n[i]) * c.tick_rate_hz / f64::from(g[i]);
                    errors_m.push((f - wanted_hz) / per_m);
                }
            }
            let n = errors_m.len() as f64;
            let mean = errors_m.iter().sum::<f64>() / n;
            let sigma = (errors_m.iter().map(|e| (e - mean).powi(2)).sum::<f64>() / n).sqrt();
            assert!(mean.abs() < 0.02e-3, "{length_m}: bias {mean}");
            assert!((0.08e-3..0.17e-3).contains(&sigma), "{length_m}: {sigma}");
        }
    }

    #[test]
    fn lag_follows_a_step_with_its_time_constant() {
        let mut c = circuit();
        c.step(0.01, &[0.100; SPRINGS]);
        assert_eq!(c.felt_m(), [0.100; SPRINGS]);
        for _ in 0..15 {
            c.step(0.001, &[0.200; SPRINGS]);
        }
        let expected = 0.200 - 0.100 * (-1.0f64).exp();
        assert!((c.felt_m()[3] - expected).abs() < 1e-12);
    }

    #[test]
    fn same_seed_same_rig_other_seed_other_rig() {
        let spec = RobotSpec::reference();
        let f = |seed| Circuit::new(&spec, seed, USUAL_SCATTER).frequency_hz(4, 0.15);
        assert_eq!(f(1), f(1));
        assert!((f(1) - f(2)).abs() > 100.0);
    }

    #[test]
    fn warmth_shortens_the_reading_by_some_tenths_per_kelvin() {
        let mut c = circuit();
        let cold = c.frequency_hz(0, 0.150);
        let per_m = (c.frequency_hz(0, 0.1501) - cold) / 1e-4;
        c.temperature_rise_k = [1.0; SPRINGS];
        let shift_m = (c.frequency_hz(0, 0.150) - cold) / per_m;
        assert!((-0.5e-3..-0.05e-3).contains(&shift_m), "{shift_m}");
    }
}
