//! A moving average over the signals that are shown.

/// Length of the average, s. Where the plots show so much time that this is less than [`SLOTS`] pixels, it is these.
const AVERAGE_S: f64 = 0.2;
/// Least number of pixels that are averaged.
const SLOTS: f64 = 5.0;

/// Averages the pieces of an envelope with slots of `slot_s`: in the middle of each slot's extremes, over 0.2 s or five slots,
/// whichever is longer, half of it before and half behind. At the ends of a piece fewer values are averaged. A line has at most
/// one point per two slots, on the grid of time: it takes little to draw and does not flicker while the window moves.
pub(super) fn smoothed(pieces: &[Vec<[f64; 2]>], slot_s: f64) -> Vec<Vec<[f64; 2]>> {
    let half_s = 0.5 * AVERAGE_S.max(SLOTS * slot_s);
    let pieces = pieces.iter();
    pieces
        .map(|piece| average(&middles(piece, slot_s), half_s, 2.0 * slot_s))
        .collect()
}

// One point per slot: in the middle of its extremes.
fn middles(piece: &[[f64; 2]], slot_s: f64) -> Vec<[f64; 2]> {
    let slot = |t_s: f64| (t_s / slot_s).floor();
    piece
        .chunk_by(|a, b| slot(a[0]) == slot(b[0]))
        .map(|points| {
            let n = points.len() as f64;
            [0, 1].map(|k| points.iter().map(|p| p[k]).sum::<f64>() / n)
        })
        .collect()
}

fn average(points: &[[f64; 2]], half_s: f64, step_s: f64) -> Vec<[f64; 2]> {
    let Some(base) = points.first().map(|p| p[1]) else {
        return Vec::new();
    };
    // Sums of differences from the first value: those of a constant are zero.
    let mut sums = Vec::with_capacity(points.len() + 1);
    let mut sum = 0.0;
    sums.push(sum);
    for p in points {
        sum += p[1] - base;
        sums.push(sum);
    }
    let (mut first, mut end) = (0, 0);
    let mut out = Vec::with_capacity(points.len() / 2 + 2);
    let mut step = f64::NAN;
    for (i, p) in points.iter().enumerate() {
        let here = (p[0] / step_s).floor();
        if here == step && i + 1 < points.len() {
            continue;
        }
        step = here;
        while points[first][0] < p[0] - half_s {
            first += 1;
        }
        while end < points.len() && points[end][0] <= p[0] + half_s {
            end += 1;
        }
        let mean = (sums[end] - sums[first]) / (end - first) as f64;
        out.push([p[0], base + mean]);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn piece(value: impl Fn(i32) -> f64) -> Vec<[f64; 2]> {
        (0..400).map(|i| [f64::from(i) * 0.01, value(i)]).collect()
    }

    #[test]
    fn a_constant_stays_and_a_step_stays_monotone() {
        let of = |value: &dyn Fn(i32) -> f64| smoothed(&[piece(value)], 0.02).remove(0);
        let constant = of(&|_| -297.3);
        assert!(constant.iter().all(|p| p[1] == -297.3));
        let step = of(&|i| f64::from(u8::from(i >= 200)));
        assert!(step.windows(2).all(|w| w[0][1] <= w[1][1] + 1e-12));
        assert_eq!([step[0][1], step[step.len() - 1][1]], [0.0, 1.0]);
        // Over 0.2 s: the step takes as long.
        let rises: Vec<_> = step
            .iter()
            .filter(|p| p[1] > 1e-9 && p[1] < 1.0 - 1e-9)
            .collect();
        let took_s = rises[rises.len() - 1][0] - rises[0][0];
        assert!((0.1..=0.22).contains(&took_s), "{took_s}");
    }

    #[test]
    fn noise_becomes_less_and_gaps_stay() {
        let noisy = piece(|i| f64::from(i % 2));
        let spread = |points: &[[f64; 2]]| {
            let values = || points.iter().map(|p| p[1]);
            values().fold(f64::MIN, f64::max) - values().fold(f64::MAX, f64::min)
        };
        let out = smoothed(&[noisy.clone(), noisy], 0.001);
        assert_eq!(out.len(), 2, "a gap stays a gap");
        assert!(spread(&out[0]) < 0.1, "{}", spread(&out[0]));
        assert!(smoothed(&[Vec::new()], 0.02)[0].is_empty());
    }
}
