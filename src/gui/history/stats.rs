//! Statistics of absolute values.

/// Bits of a value that do not tell its bin.
const BIN_BITS: u32 = 17;

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
    /// Statistics of absolute values; `None` without a value. As [`Self::of`], for many values: they are
    /// walked twice and not copied but for the few around the two ranks.
    pub fn of_many(values: impl Iterator<Item = f32> + Clone) -> Option<Self> {
        // Bits of positive floats are in the order of the floats.
        let bits = |v: f32| v.abs().to_bits();
        let mut counts = vec![0u32; 1 << (32 - BIN_BITS)];
        let (mut n, mut sum, mut squares, mut max) = (0usize, 0.0, 0.0, 0.0f32);
        for v in values.clone() {
            counts[(bits(v) >> BIN_BITS) as usize] += 1;
            let x = f64::from(v.abs());
            n += 1;
            sum += x;
            squares += x * x;
            max = max.max(v.abs());
        }
        if n == 0 {
            return None;
        }
        // For each rank the bin that it falls into, and how many values lie in those below.
        let find = |p: f64| {
            let rank = ((p * n as f64).ceil() as usize).clamp(1, n) - 1;
            let mut below = 0;
            for (bin, count) in counts.iter().enumerate() {
                let count = *count as usize;
                if below + count > rank {
                    return (bin, rank - below);
                }
                below += count;
            }
            (counts.len() - 1, 0)
        };
        let ranks = [find(0.5), find(0.95)];
        let mut around = ranks.map(|(bin, _)| Vec::with_capacity(counts[bin] as usize));
        for v in values {
            let bin = (bits(v) >> BIN_BITS) as usize;
            for (found, (wanted, _)) in around.iter_mut().zip(ranks) {
                if bin == wanted {
                    found.push(bits(v));
                }
            }
        }
        let [p50, p95] = [0, 1].map(|i| {
            let (_, value, _) = around[i].select_nth_unstable(ranks[i].1);
            f64::from(f32::from_bits(*value))
        });
        Some(Self {
            mean: sum / n as f64,
            rmse: (squares / n as f64).sqrt(),
            p50,
            p95,
            max: f64::from(max),
            n,
        })
    }

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
