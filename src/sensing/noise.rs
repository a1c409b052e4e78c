//! Noise of a channel, from its own readings.
//!
//! The second difference of a signal that moves steadily is noise alone: e² = (y₀ − 2 y₁ + y₂)² / 6 has the noise's
//! variance as its mean.

/// Time over which the variance is averaged, in samples, and the weight of what is assumed before.
const MEMORY: f64 = 1000.0;
const ASSUMED: f64 = 200.0;
/// A second difference counts for at most this many times the present variance: motion is no noise.
const CLIP: f64 = 9.0;

/// Running variance of one signal's noise.
#[derive(Clone, Copy, Debug)]
pub struct Noise {
    past: [f64; 2],
    fresh: u8,
    samples: f64,
    variance: f64,
    least: f64,
}

impl Noise {
    /// With an assumed standard deviation, and the smallest that is believed, both in the signal's unit.
    pub fn new(assumed: f64, least: f64) -> Self {
        Self {
            past: [0.0; 2],
            fresh: 0,
            samples: ASSUMED,
            variance: assumed * assumed,
            least: least * least,
        }
    }

    /// Takes in a reading; `None`: there is none.
    pub fn update(&mut self, reading: Option<f64>) {
        let Some(y) = reading else {
            self.fresh = 0;
            return;
        };
        if self.fresh >= 2 {
            let second = y - 2.0 * self.past[0] + self.past[1];
            let square = (second * second / 6.0).min(CLIP * self.variance);
            self.samples = (self.samples + 1.0).min(MEMORY);
            self.variance += (square - self.variance) / self.samples;
            self.variance = self.variance.max(self.least);
        }
        self.past = [y, self.past[0]];
        self.fresh = (self.fresh + 1).min(2);
    }

    /// Variance of one reading, in the signal's unit squared.
    pub fn variance(&self) -> f64 {
        self.variance
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng as _;
    use rand_distr::Distribution as _;
    use rand_pcg::Pcg64Mcg;

    #[test]
    fn the_noise_is_found_under_a_steady_motion() {
        let mut rng = Pcg64Mcg::seed_from_u64(1);
        let white = rand_distr::StandardNormal;
        let mut noise = Noise::new(3e-4, 1e-5);
        for k in 0..20_000 {
            let t = 0.01 * f64::from(k);
            let white: f64 = white.sample(&mut rng);
            noise.update(Some(0.15 + 0.02 * (0.5 * t).sin() + 1e-4 * white));
        }
        let sd = noise.variance().sqrt();
        assert!((sd / 1e-4 - 1.0).abs() < 0.1, "{sd}");
    }
}
