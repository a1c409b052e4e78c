//! Statistics of absolute values.

/// Statistics of the absolute values of a channel.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Stats {
    /// Mean absolute value.
    pub mean: f64,
    /// Root of the mean square.
    pub rmse: f64,
    /// Median of the absolute values (nearest rank).
    pub p50: f64,
    /// 95 % of the absolute values are at or below it (nearest rank).
    pub p95: f64,
    /// Largest absolute value.
    pub max: f64,
    /// How many values.
    pub n: usize,
}

impl Stats {
    /// Statistics of absolute values; `None` without a value.
    pub fn of(values: impl Iterator<Item = f64>) -> Option<Self> {
        let mut v: Vec<f64> = values.map(f64::abs).collect();
        let n = v.len();
        let max = v.iter().copied().max_by(f64::total_cmp)?;
        let mean = v.iter().sum::<f64>() / n as f64;
        let rmse = (v.iter().map(|x| x * x).sum::<f64>() / n as f64).sqrt();
        // Nearest rank: the smallest value with at least p·n values at or below it. Both ranks without
        // sorting the rest: the upper one parts the values, the lower one lies in the lower part.
        let rank = |p: f64| ((p * n as f64).ceil() as usize).clamp(1, n) - 1;
        let (lower, p95, _) = v.select_nth_unstable_by(rank(0.95), f64::total_cmp);
        let p95 = *p95;
        let p50 = if rank(0.5) < lower.len() {
            *lower.select_nth_unstable_by(rank(0.5), f64::total_cmp).1
        } else {
            p95
        };
        Some(Self {
            mean,
            rmse,
            p50,
            p95,
            max,
            n,
        })
    }
}
