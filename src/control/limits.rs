//! Limits on the rates of a tick: usable channels and the tip's speed.

use nalgebra::{SMatrix, SVector};

use super::residual::SignalSigma;
use super::tick::{Pressures, Tick};
use crate::signal::{CHAMBERS, SIGNALS, SPRINGS, SensorFrame, SensorRef, Vector6};

/// In this time a pump makes up for most of a chamber's lag, s.
const PUMP_LAG_S: f64 = 0.3;

pub(super) fn usable_gauges(frame: &SensorFrame) -> [bool; CHAMBERS] {
    std::array::from_fn(|i| frame.health.chambers[i].usable() && frame.chamber_pa[i].is_finite())
}

/// The diagonal of W with the unusable channels taken out.
pub(super) fn signal_weights(frame: &SensorFrame, sigma: &SignalSigma) -> SensorRef {
    let sigma = sigma.to_vector();
    SensorRef::from_fn(|i, _| {
        let usable = match i.checked_sub(SPRINGS) {
            None => frame.health.springs[i].usable(),
            Some(k) => frame.health.imus[k / 3].usable(),
        };
        if usable { 1.0 / sigma[i] } else { 0.0 }
    })
}

/// Slows all chambers by one factor so that the tip keeps to its speed limit, now and when chambers that lag have
/// caught up.
pub(super) fn limit_tip_speed(rate_pa_s: Vector6, tick: &Tick, pressures: &Pressures) -> Vector6 {
    let tip_from_signals: SMatrix<f64, 3, SIGNALS> =
        tick.eval.jacobian.fixed_rows::<3>(0).into_owned();
    let tip_from_pa = tip_from_signals * tick.plant.jacobian;
    // v = ∂x/∂s B₀ u
    let tip_m_s: SVector<f64, 3> = tip_from_pa * rate_pa_s;
    let excess = (tip_m_s.norm() / tick.tip_speed_max_m_s).max(1.0);
    let rate_pa_s = rate_pa_s / excess;
    // A chamber makes up for its lead over the pump's time constant: v = ∂x/∂s B₀ (q_set − q) / τ
    let ahead = Vector6::from_fn(|i, _| {
        pressures.set_pa[i] + rate_pa_s[i] * pressures.dt_s - pressures.chamber_pa[i]
    });
    let coming_m_s: SVector<f64, 3> = tip_from_pa * ahead / PUMP_LAG_S;
    let excess = coming_m_s.norm() / tick.tip_speed_max_m_s;
    if excess <= 1.0 {
        return rate_pa_s;
    }
    Vector6::from_fn(|i, _| {
        let next_pa = pressures.chamber_pa[i] + ahead[i] / excess;
        let rate = (next_pa - pressures.set_pa[i]) / pressures.dt_s.max(1e-4);
        rate.clamp(tick.lo_pa_s[i], tick.hi_pa_s[i])
    })
}
