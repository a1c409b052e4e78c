//! Random numbers of the virtual rig.

use nalgebra::Vector3;
use rand::{Rng, SeedableRng as _};
use rand_distr::StandardNormal;
use rand_pcg::Pcg64Mcg;

/// A standard normal deviate.
pub fn normal<R: Rng + ?Sized>(rng: &mut R) -> f64 {
    rng.sample(StandardNormal)
}

/// Three of them.
pub fn normal3<R: Rng + ?Sized>(rng: &mut R) -> Vector3<f64> {
    Vector3::from_fn(|_, _| normal(rng))
}

/// The stream of a seed for one purpose.
pub fn stream(seed: u64, purpose: u64) -> Pcg64Mcg {
    let mut rng = Pcg64Mcg::new((u128::from(seed) << 64) | (u128::from(purpose) << 1) | 1);
    // The first outputs of neighbouring states are related.
    Pcg64Mcg::seed_from_u64(rng.random())
}

/// A random walk that forgets: unit variance, correlation time `tau_s`.
#[derive(Clone, Debug)]
pub struct Wander {
    value: f64,
    tau_s: f64,
}

impl Wander {
    /// At its own scatter.
    pub fn new<R: Rng + ?Sized>(tau_s: f64, rng: &mut R) -> Self {
        Self {
            value: normal(rng),
            tau_s,
        }
    }

    /// Its value after `dt_s`.
    pub fn step<R: Rng + ?Sized>(&mut self, dt_s: f64, rng: &mut R) -> f64 {
        let keep = (-dt_s / self.tau_s).exp();
        self.value = keep * self.value + (1.0 - keep * keep).sqrt() * normal(rng);
        self.value
    }
}
