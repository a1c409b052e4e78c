use rand::{Rng as _, SeedableRng as _};
use rand_pcg::Pcg64Mcg;

/// The random numbers of a seed for one purpose, or for one sample of many.
pub fn stream(seed: u64, purpose: u64) -> Pcg64Mcg {
    let mut rng = Pcg64Mcg::new((u128::from(seed) << 64) | (u128::from(purpose) << 1) | 1);
    // The first outputs of neighbouring states are related: skip them by reseeding.
    Pcg64Mcg::seed_from_u64(rng.random())
}
