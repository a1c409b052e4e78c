//! Noise model of a healthy rig: covariance and autocorrelation of its residuals.
//!
//! Residual rows e_t are turned into innovations of unit variance,
//! w_t = D⁻¹ (z_t − φ z_{t−1}), z_t = L⁻¹ e_t, Σ = L Lᵀ, with the healthy session's covariance Σ and
//! one autoregressive coefficient φ per combination. Sums of squares of w are then proper
//! log-likelihoods, although model errors are correlated over seconds and over many channels.

use nalgebra::{DMatrix, DVector};

use super::config::CONFIG;
use super::replay::Row;
use super::session::{CHANNELS, GRID_HZ, IMU_0, SPRING_0, START_S, bridge};

/// Quantisation and rounding that no session can undercut: tip m, rad, spring m, IMU rad.
const SMALLEST: [f64; 4] = [5e-5, 2e-4, 3e-5, 5e-4];
/// Usual size of each before anything was measured.
const USUAL: [f64; 4] = [2e-3, 1e-2, 1e-3, 1.5e-2];

fn kind(c: usize) -> usize {
    match c {
        0..3 => 0,
        3..6 => 1,
        c if (SPRING_0..IMU_0).contains(&c) => 2,
        _ => 3,
    }
}

/// The whitening of residual rows.
#[derive(Clone, Debug)]
pub struct Noise {
    /// Channels in use, by their index (see [`CHANNELS`]).
    pub channels: Vec<usize>,
    /// L⁻¹.
    whiten: DMatrix<f64>,
    phi: DVector<f64>,
    sd: DVector<f64>,
    /// Healthy size of each channel.
    size: DVector<f64>,
}

impl Noise {
    /// Independent channels of usual size: before a healthy session is known.
    pub fn usual(present: &[bool; CHANNELS]) -> Self {
        let channels: Vec<usize> = (0..CHANNELS).filter(|c| present[*c]).collect();
        let n = channels.len();
        let inverse = DVector::from_iterator(n, channels.iter().map(|c| 1.0 / USUAL[kind(*c)]));
        Self {
            channels,
            whiten: DMatrix::from_diagonal(&inverse),
            phi: DVector::zeros(n),
            sd: DVector::from_element(n, 1.0),
            size: inverse.map(f64::recip),
        }
    }

    /// From the residuals of a healthy session.
    pub fn from_healthy(rows: &[Row], present: &[bool; CHANNELS]) -> Self {
        let channels: Vec<usize> = (0..CHANNELS).filter(|c| present[*c]).collect();
        let rows = &bridged(rows)[start()..];
        let n = channels.len();
        let t = rows.len() as f64;
        // Second moments about zero: a persistent bias is part of the residual.
        let mut sigma = DMatrix::zeros(n, n);
        for row in rows {
            for (i, a) in channels.iter().enumerate() {
                for (j, b) in channels.iter().enumerate().take(i + 1) {
                    sigma[(i, j)] += row[*a] * row[*b] / t;
                }
            }
        }
        for i in 0..n {
            for j in 0..i {
                sigma[(i, j)] *= 1.0 - CONFIG.shrinkage;
                sigma[(j, i)] = sigma[(i, j)];
            }
            sigma[(i, i)] += SMALLEST[kind(channels[i])].powi(2);
        }
        let size = sigma.diagonal().map(f64::sqrt);
        let whiten = match sigma.clone().cholesky() {
            Some(l) => {
                let mut inverse = DMatrix::identity(n, n);
                l.l().solve_lower_triangular_mut(&mut inverse);
                inverse
            }
            None => DMatrix::from_diagonal(&sigma.diagonal().map(|v: f64| 1.0 / v.sqrt())),
        };
        let mut out = Self {
            channels,
            whiten,
            phi: DVector::zeros(n),
            sd: DVector::from_element(n, 1.0),
            size,
        };
        let z = out.mixed(rows);
        for i in 0..n {
            let (mut now, mut next, mut both) = (1e-12, 1e-12, 0.0);
            for k in 1..z.ncols() {
                now += z[(i, k - 1)].powi(2);
                next += z[(i, k)].powi(2);
                both += z[(i, k)] * z[(i, k - 1)];
            }
            out.phi[i] = (both / now).clamp(0.0, CONFIG.phi_max);
            let phi = out.phi[i];
            let rest = (next - 2.0 * phi * both + phi * phi * now) / (z.ncols() - 1) as f64;
            out.sd[i] = rest.max(1e-6).sqrt();
        }
        out
    }

    /// The same sizes and combinations, every row on its own.
    pub fn without_memory(&self) -> Self {
        Self {
            phi: DVector::zeros(self.phi.len()),
            sd: DVector::from_element(self.sd.len(), 1.0),
            ..self.clone()
        }
    }

    /// Healthy size of every channel in use.
    pub fn sizes(&self) -> impl Iterator<Item = (usize, f64)> + '_ {
        self.channels.iter().copied().zip(self.size.iter().copied())
    }

    /// How many successive rows carry the information of one, on average: Σ(1+φ)/(1−φ)/n.
    pub fn correlation_rows(&self) -> f64 {
        let n = self.phi.len() as f64;
        self.phi.iter().map(|p| (1.0 + p) / (1.0 - p)).sum::<f64>() / n
    }

    fn mixed(&self, rows: &[Row]) -> DMatrix<f64> {
        let raw = DMatrix::from_fn(self.channels.len(), rows.len(), |i, k| {
            rows[k][self.channels[i]]
        });
        &self.whiten * raw
    }

    /// Innovations, one column per row of the session. The start of the session is zero.
    pub fn innovations(&self, rows: &[Row]) -> DMatrix<f64> {
        self.filtered(&self.mixed(&bridged(rows)))
    }

    /// Evidence of `rows`, one column per row of a session of `bins` rows: innovations, and below them the
    /// readings of every channel in units of its healthy size, so weighted that the sum of their
    /// squares over the session counts as two independent looks. The start of the session is zero.
    pub fn evidence(&self, rows: &[Row], bins: usize) -> DMatrix<f64> {
        let rows = bridged(rows);
        let n = self.channels.len();
        let weight = (CONFIG.looks / bins.saturating_sub(start()).max(1) as f64).sqrt();
        let w = self.filtered(&self.mixed(&rows));
        let mut out = DMatrix::zeros(2 * n, rows.len());
        for k in start()..rows.len() {
            for i in 0..n {
                out[(i, k)] = w[(i, k)];
                out[(n + i, k)] = weight * rows[k][self.channels[i]] / self.size[i];
            }
        }
        out
    }

    /// Innovations when every combination follows `shape` at its healthy size, bin by bin.
    pub fn responses(&self, shape: &[f64]) -> Vec<f64> {
        let z = DMatrix::from_fn(self.channels.len(), shape.len(), |_, k| shape[k]);
        self.filtered(&z).as_slice().to_vec()
    }

    fn filtered(&self, z: &DMatrix<f64>) -> DMatrix<f64> {
        let mut w = DMatrix::zeros(z.nrows(), z.ncols());
        for k in start().max(1)..z.ncols() {
            for i in 0..z.nrows() {
                w[(i, k)] = (z[(i, k)] - self.phi[i] * z[(i, k - 1)]) / self.sd[i];
            }
        }
        w
    }
}

/// First bin that is judged.
pub fn start() -> usize {
    (START_S * GRID_HZ) as usize
}

/// Rows with gaps bridged in time; a channel that is missing throughout becomes zero.
pub fn bridged(rows: &[Row]) -> Vec<Row> {
    let mut out = rows.to_vec();
    let t_s: Vec<f64> = (0..rows.len()).map(|k| k as f64).collect();
    for c in 0..CHANNELS {
        let known: Vec<usize> = (0..rows.len())
            .filter(|k| rows[*k][c].is_finite())
            .collect();
        if known.is_empty() {
            out.iter_mut().for_each(|r| r[c] = 0.0);
        } else if known.len() < rows.len() {
            bridge(&t_s, &known, |k| rows[k][c], |k, v| out[k][c] = v);
        }
    }
    out
}
