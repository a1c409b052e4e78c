//! The figures of a verdict on a pressure log: the gap, channel by channel, where it lies, its traces.

use crate::gap::actuation::healthy::LineBaseline;
use crate::gap::actuation::line::{LineRow, PressureGrid, line_rmse_pa};
use crate::gap::config::CONFIG;
use crate::gap::describe::T_95;
use crate::gap::finding::{ChannelError, GapSize, Located, Traces};
use crate::signal::CHAMBERS;

/// How much gauges scatter while their commands rest: about the mean of each rest, from 4 s after
/// the last change on, Pa.
pub(super) fn scatter_pa(grid: &PressureGrid) -> f64 {
    const SETTLED: usize = (4.0 * crate::gap::actuation::line::LINE_HZ) as usize;
    let (mut sum, mut n) = (0.0, 0usize);
    for i in grid.chambers() {
        let mut rest: Vec<f64> = Vec::new();
        let mut since = 0;
        let mut close = |rest: &mut Vec<f64>| {
            let mean = rest.iter().sum::<f64>() / rest.len().max(1) as f64;
            sum += rest.iter().map(|p| (p - mean).powi(2)).sum::<f64>();
            n += rest.len();
            rest.clear();
        };
        for k in 1..grid.len() {
            if (grid.commanded_pa[k][i] - grid.commanded_pa[k - 1][i]).abs() > 1.0 {
                since = k;
                close(&mut rest);
            } else if k - since > SETTLED {
                rest.push(grid.measured_pa[k][i]);
            }
        }
        close(&mut rest);
    }
    (sum / n.max(1) as f64).sqrt()
}

pub(super) fn gap_size(
    grid: &PressureGrid,
    before: &[LineRow],
    after: &[LineRow],
    floor_pa: f64,
) -> GapSize {
    let [before, after, floor] = [
        line_rmse_pa(grid, before, |_| true),
        line_rmse_pa(grid, after, |_| true),
        floor_pa,
    ]
    .map(|pa| pa / 1e3);
    GapSize::of([before, after, floor], "kPa")
}

pub(super) fn channels(
    grid: &PressureGrid,
    before: &[LineRow],
    after: &[LineRow],
    baseline: &LineBaseline,
) -> Vec<ChannelError> {
    let bins = grid.len();
    let rms = |rows: &[LineRow], i: usize| {
        (rows.iter().map(|r| r[i] * r[i]).sum::<f64>() / rows.len().max(1) as f64).sqrt() / 1e3
    };
    grid.chambers()
        .into_iter()
        .map(|i| {
            let squares: Vec<f64> = (0..CONFIG.blocks)
                .map(|b| {
                    rms(
                        &after[b * bins / CONFIG.blocks..(b + 1) * bins / CONFIG.blocks],
                        i,
                    )
                    .powi(2)
                })
                .collect();
            let mean = squares.iter().sum::<f64>() / CONFIG.blocks as f64;
            let var = squares.iter().map(|s| (s - mean).powi(2)).sum::<f64>()
                / (CONFIG.blocks * (CONFIG.blocks - 1)) as f64;
            let half = T_95 * var.sqrt();
            // The same corrections, half a session late: must not help.
            let shuffled: Vec<LineRow> = (0..bins)
                .map(|k| {
                    let other = (k + bins / 2) % bins;
                    let mut row = [0.0; CHAMBERS];
                    row[i] = before[k][i] - (before[other][i] - after[other][i]);
                    row
                })
                .collect();
            ChannelError {
                name: format!("r1 chamber {}", i + 1),
                unit: "kPa".to_owned(),
                before: rms(before, i),
                after: rms(after, i),
                after_ci95: [(mean - half).max(0.0).sqrt(), (mean + half).sqrt()],
                shuffled: Some(rms(&shuffled, i)),
                floor: baseline
                    .healthy
                    .is_some()
                    .then(|| baseline.chamber_floor_pa[i] / 1e3),
            }
        })
        .collect()
}

/// Correlation of each chamber's residual with regressors: share of variance of a straight line fitted to
/// the even blocks, on the odd ones.
pub(super) fn located(grid: &PressureGrid, rows: &[LineRow]) -> Vec<Located> {
    let bins = grid.len();
    let second = crate::gap::actuation::line::LINE_HZ as usize;
    let u = &grid.commanded_pa;
    let chambers = grid.chambers();
    let mut out = Vec::new();
    for &i in &chambers {
        let rate = |k: usize, j: usize| u[k][j] - u[k.saturating_sub(second)][j];
        let regressors: [(&str, Vec<f64>); 3] = [
            ("level", (0..bins).map(|k| u[k][i]).collect()),
            ("rate", (0..bins).map(|k| rate(k, i)).collect()),
            (
                "rate of the others",
                (0..bins)
                    .map(|k| {
                        let others = chambers.iter().filter(|j| **j != i);
                        others.map(|j| rate(k, *j)).sum()
                    })
                    .collect(),
            ),
        ];
        for (name, x) in regressors {
            let even = |k: &usize| (k * CONFIG.blocks / bins).is_multiple_of(2);
            let (mut n, mut sx, mut sy, mut sxx, mut sxy) = (0.0, 0.0, 0.0, 0.0, 0.0);
            for k in (0..bins).filter(even) {
                let (x, y) = (x[k], rows[k][i]);
                n += 1.0;
                sx += x;
                sy += y;
                sxx += x * x;
                sxy += x * y;
            }
            let spread = sxx - sx * sx / n;
            if spread < 1.0 {
                continue;
            }
            let slope = (sxy - sx * sy / n) / spread;
            let (mut left, mut whole) = (0.0, 1e-9);
            for k in (0..bins).filter(|k| !even(k)) {
                let y = rows[k][i] - sy / n;
                left += (y - slope * (x[k] - sx / n)).powi(2);
                whole += y * y;
            }
            out.push(Located {
                residual: "r1".to_owned(),
                channel: format!("chamber {}", i + 1),
                regressor: name.to_owned(),
                share: (1.0 - left / whole).clamp(0.0, 1.0),
            });
        }
    }
    out.sort_by(|a, b| b.share.total_cmp(&a.share));
    out
}

pub(super) fn traces(
    grid: &PressureGrid,
    before: &[LineRow],
    after: &[LineRow],
    floor_pa: f64,
) -> Traces {
    let scale = floor_pa.max(1.0);
    let series = |rows: &[LineRow]| {
        let one = |i: usize| rows.iter().map(|r| r[i] / scale).collect();
        grid.chambers().into_iter().map(one).collect()
    };
    Traces {
        t_s: grid.t_s.clone(),
        channels: grid
            .chambers()
            .iter()
            .map(|i| format!("pressure {}", i + 1))
            .collect(),
        before: series(before),
        after: series(after),
        ..Traces::default()
    }
}
