//! Random numbers of the virtual rig.

use nalgebra::Vector3;
use rand::Rng;
use rand_distr::StandardNormal;

/// A standard normal deviate.
pub fn normal<R: Rng + ?Sized>(rng: &mut R) -> f64 {
    rng.sample(StandardNormal)
}

/// Three of them.
pub fn normal3<R: Rng + ?Sized>(rng: &mut R) -> Vector3<f64> {
    Vector3::from_fn(|_, _| normal(rng))
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
