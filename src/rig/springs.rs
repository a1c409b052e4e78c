//! From the distance of a spring's ends to the length that its circuit sees: seat, lag, mutual inductance, a coil that
//! shorts, interference.

use rand::Rng as _;
use rand_pcg::Pcg64Mcg;

use super::circuit::Circuit;
use super::hidden::Defects;
use super::noise::normal;
use crate::signal::{SPRINGS, stream};

/// Shares of a hidden lag's two filters.
const LAGS: [f64; 2] = [0.65, 0.35];
/// Mean time between two releases of a shorted coil, and their length, s.
const RELEASE_S: [f64; 2] = [12.0, 0.2];
/// What a shorted coil still follows.
const SHORTED: f64 = 0.01;
/// Time in which oscillators warm up, s.
const WARM_UP_S: f64 = 150.0;

/// State of what lies between the springs' ends and their circuits.
#[derive(Clone, Debug)]
pub struct Springs {
    rest_m: f64,
    /// Warm-up of each oscillator over the mean.
    warmth: [f64; SPRINGS],
    seat_m: [f64; SPRINGS],
    lagged_m: [[f64; 2]; SPRINGS],
    held_m: [Option<f64>; SPRINGS],
    free_until_s: [f64; SPRINGS],
    rng: Pcg64Mcg,
}

impl Springs {
    /// Of a unit, at rest at `length_m`.
    pub fn new(unit: u64, rest_m: f64, length_m: &[f64; SPRINGS]) -> Self {
        let mut rng = stream(unit, 0x5e25);
        Self {
            rest_m,
            warmth: std::array::from_fn(|_| 1.0 + 0.1 * normal(&mut rng)),
            seat_m: *length_m,
            lagged_m: length_m.map(|l| [l; 2]),
            held_m: [None; SPRINGS],
            free_until_s: [f64::MIN; SPRINGS],
            rng,
        }
    }

    /// Lengths that the circuits see at `t_s`, `dt_s` after the last time, m.
    pub fn read(
        &mut self,
        t_s: f64,
        dt_s: f64,
        true_m: &[f64; SPRINGS],
        activity_pa_s: f64,
        d: &Defects,
    ) -> [f64; SPRINGS] {
        let mut felt_m = [0.0; SPRINGS];
        for i in 0..SPRINGS {
            let play = 0.5 * d.seat_play_m[i];
            self.seat_m[i] = self.seat_m[i].clamp(true_m[i] - play, true_m[i] + play);
            let mut x = self.seat_m[i];
            for (y, part) in self.lagged_m[i].iter_mut().zip(LAGS) {
                let tau_s = part * d.spring_lag_s[i];
                *y = match tau_s > 0.0 {
                    true => *y - (-dt_s / tau_s).exp_m1() * (x - *y),
                    false => x,
                };
                x = *y;
            }
            felt_m[i] = x;
        }
        std::array::from_fn(|i| {
            let l0 = self.rest_m;
            // y_A = l_A + c (l_B − l₀) (l₀/l_A)^½ (1 + 0.3 (l_B − l₀)/l₀), B the other spring of the pair
            let partner_m = true_m[i ^ 1] - l0;
            let coupling = (l0 / true_m[i]).sqrt() * (1.0 + 0.3 * partner_m / l0);
            let l = felt_m[i] + d.spring_cross[i] * partner_m * coupling;
            let [gain, offset_m] = d.spring_gain[i];
            // y = o + g l + (1 − g)/(8 l₀) (l − l₀)²
            let bent = (1.0 - gain) / (8.0 * l0) * (l - l0).powi(2);
            let l = offset_m + gain * l + bent + d.interference_m_s_pa * activity_pa_s;
            self.shorted(i, t_s, dt_s, l, d.spring_stuck_s[i])
        })
    }

    /// A coil that shorts stays where it was, follows by a hundredth, and breaks free now and then.
    fn shorted(&mut self, i: usize, t_s: f64, dt_s: f64, length_m: f64, from_s: f64) -> f64 {
        if t_s < from_s {
            self.held_m[i] = None;
            return length_m;
        }
        let at_m = *self.held_m[i].get_or_insert(length_m);
        let [every_s, for_s] = RELEASE_S;
        if self.rng.random::<f64>() < dt_s / every_s {
            self.free_until_s[i] = t_s + for_s;
        }
        match t_s < self.free_until_s[i] {
            true => length_m,
            false => at_m + SHORTED * (length_m - at_m),
        }
    }

    /// Temperatures of the oscillators at `t_s`, K above the bench.
    pub fn temperature_rise_k(&self, t_s: f64, circuit: &Circuit, d: &Defects) -> [f64; SPRINGS] {
        let warm_s = -WARM_UP_S * (-(t_s - d.drift_from_s).max(0.0) / WARM_UP_S).exp_m1();
        std::array::from_fn(|i| match d.spring_drift_m_s[i] {
            0.0 => 0.0,
            // T = r τ (1 − e^{−t/τ}) over what a kelvin does
            rate => rate * self.warmth[i] * warm_s / circuit.drift_m_k(i, self.rest_m),
        })
    }
}
