//! Linear active disturbance rejection, six first-order channels side by side.
//!
//! Plant of a channel: y' = f + b₀ u with b₀ = 1. The input u is the *rate* at which the chamber
//! pressures change, seen in the channel's coordinates (Pa/s for a channel in virtual pressure,
//! mm/s for one in task space): the pump integrates it, so y is an integrator of u whatever the
//! static gain of the arm, and everything the model misses (load, creep, Jacobian error) is f.
//!
//! Discrete current observer with both poles at z = exp(−ω_o T):
//! l₁ = 1 − z², l₂ = (1 − z)²/T. Law: u = −(k_p ŷ + f̂)/b₀, k_p = 4/T_settle.
//!
//! Source: paper section IV-A (ADRC inner loop); J. Han, IEEE Trans. Ind. Electron. 56(3), 2009,
//! doi:10.1109/TIE.2008.2011621; Z. Gao, Proc. ACC 2003, doi:10.1109/ACC.2003.1242516 (bandwidth tuning).

use crate::signal::Vector6;

/// Tuning by two times.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AdrcGains {
    /// T_settle: 2 % settling time without saturation, s.
    pub settle_s: f64,
    /// ω_o / k_p, 3 to 10.
    pub observer_ratio: f64,
}

impl AdrcGains {
    /// k_p, 1/s.
    pub fn k_p(&self) -> f64 {
        4.0 / self.settle_s
    }

    /// (l₁, l₂) at the sample time `dt_s`; l₂ in 1/s.
    pub fn observer(&self, dt_s: f64) -> (f64, f64) {
        // z = exp(−ω_o T)
        let z = (-self.observer_ratio * self.k_p() * dt_s).exp();
        (1.0 - z * z, (1.0 - z).powi(2) / dt_s)
    }
}

/// The observers' state.
#[derive(Clone, Debug, PartialEq)]
pub struct Adrc {
    /// ŷ, estimate of the outputs, in the channels' coordinates.
    pub y: Vector6,
    /// f̂, estimate of the total disturbances, in the same per second.
    pub f: Vector6,
}

impl Adrc {
    /// Bumpless start: the outputs as measured, zero disturbance.
    pub fn new(y: &Vector6) -> Self {
        Self {
            y: *y,
            f: Vector6::zeros(),
        }
    }

    /// Moves the origin of the outputs by `delta` (new minus old value of one and the same
    /// measurement), so that a new reference is not mistaken for a disturbance.
    pub fn shift(&mut self, delta: &Vector6) {
        self.y += delta;
    }

    /// One sample: predict with the input that *was applied* since the last one (after all
    /// clipping), correct with the measured `y`.
    pub fn observe(&mut self, y: &Vector6, applied: &Vector6, dt_s: f64, gains: &AdrcGains) {
        let (l1, l2) = gains.observer(dt_s);
        // ŷ⁻ = ŷ + T (f̂ + b₀ u)
        let predicted = self.y + (self.f + applied) * dt_s;
        let innovation = y - predicted;
        // ŷ = ŷ⁻ + l₁ e,  f̂ = f̂⁻ + l₂ e
        self.y = predicted + innovation * l1;
        self.f += innovation * l2;
    }

    /// The wanted input, before any clipping.
    pub fn control(&self, gains: &AdrcGains) -> Vector6 {
        // u = −(k_p ŷ + f̂) / b₀
        -(self.y * gains.k_p() + self.f)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const DT_S: f64 = 0.02;
    const GAINS: AdrcGains = AdrcGains {
        settle_s: 4.0,
        observer_ratio: 4.0,
    };

    /// An integrator with disturbance from y = 10; returns y and the applied input over time.
    fn simulate(limit: f64, disturbance: f64, seconds: f64) -> Vec<(f64, f64)> {
        let gains = GAINS;
        let mut y = Vector6::repeat(10.0);
        let mut adrc = Adrc::new(&y);
        let mut applied = Vector6::zeros();
        let mut log = Vec::new();
        for k in 0..(seconds / DT_S) as usize {
            if k > 0 {
                adrc.observe(&y, &applied, DT_S, &gains);
            }
            applied = adrc.control(&gains).map(|u| u.clamp(-limit, limit));
            y += (applied + Vector6::repeat(disturbance)) * DT_S;
            log.push((y[0], applied[0]));
        }
        log
    }

    #[test]
    fn observer_poles_are_where_they_were_placed() {
        let g = GAINS;
        let (l1, l2) = g.observer(DT_S);
        let z = (-g.observer_ratio * g.k_p() * DT_S).exp();
        // (I − L C) A has trace 2z and determinant z².
        assert!((2.0 - l1 - l2 * DT_S - 2.0 * z).abs() < 1e-12);
        assert!((1.0 - l1 - z * z).abs() < 1e-12);
    }

    #[test]
    fn settles_in_the_time_asked_for_and_rejects_a_constant_disturbance() {
        let log = simulate(f64::INFINITY, 0.0, 8.0);
        let at = |t: f64, log: &[(f64, f64)]| log[(t / DT_S) as usize].0;
        assert!(at(4.0, &log) < 0.25 && at(2.0, &log) > 0.5);
        let log = simulate(f64::INFINITY, 3.0, 20.0);
        let (y, u) = log[log.len() - 1];
        assert!(y.abs() < 1e-3 && (u + 3.0).abs() < 1e-3, "{y} {u}");
    }

    #[test]
    fn a_saturated_input_leaves_no_windup() {
        // 10 units at 1 per second: ten seconds in saturation, then no overshoot to speak of.
        let log = simulate(1.0, 0.0, 30.0);
        let lowest = log.iter().map(|(y, _)| *y).fold(f64::INFINITY, f64::min);
        assert!(lowest > -0.2, "overshoot to {lowest}");
        assert!(log[log.len() - 1].0.abs() < 1e-3);
        let saturated = log.iter().filter(|(_, u)| *u == -1.0).count() as f64 * DT_S;
        assert!(
            saturated > 8.0,
            "the input was hardly saturated: {saturated} s"
        );
    }

    #[test]
    fn a_new_reference_is_not_taken_for_a_disturbance() {
        let gains = GAINS;
        let mut adrc = Adrc::new(&Vector6::zeros());
        adrc.shift(&Vector6::repeat(5.0));
        adrc.observe(&Vector6::repeat(5.0), &Vector6::zeros(), DT_S, &gains);
        assert!(adrc.f.norm() < 1e-12);
    }
}
