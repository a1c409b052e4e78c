//! Comparison of a measured path with two simulated ones.

use std::path::Path;

use super::RecordingError;

/// The way of a tip: one entry per instant; entries that are not finite are gaps.
#[derive(Clone, Copy, Debug, Default)]
pub struct TipSeries<'a> {
    /// Position in the base frame, m.
    pub position_m: &'a [[f64; 3]],
    /// Orientation, base from tip: quaternion w, x, y, z. May be empty: then only points are drawn.
    pub turn_wxyz: &'a [[f64; 4]],
}

/// A comparison over time, as plain numbers.
#[derive(Clone, Copy, Debug, Default)]
pub struct Overlay<'a> {
    /// Name of the recording.
    pub name: &'a str,
    /// Whether the measured series are simulated themselves.
    pub simulated: bool,
    /// Rising times, s.
    pub t_s: &'a [f64],
    /// As measured.
    pub measured: TipSeries<'a>,
    /// As simulated before.
    pub before: TipSeries<'a>,
    /// As simulated after.
    pub after: TipSeries<'a>,
    /// Names of the residual channels; channels of the same first word share a plot.
    pub channels: &'a [String],
    /// Residuals before, in `residual_unit`: a row per channel in the order of `channels`, an entry per instant.
    pub residual_before: &'a [Vec<f64>],
    /// The same after.
    pub residual_after: &'a [Vec<f64>],
    /// Unit of the residuals.
    pub residual_unit: &'a str,
}

impl Overlay<'_> {
    /// Holds the lengths against each other.
    ///
    /// # Errors
    /// [`RecordingError::Unsupported`] naming the series that does not fit.
    pub(super) fn check(&self, path: &Path) -> Result<(), RecordingError> {
        let n = self.t_s.len();
        let wrong = |text: String| {
            Err(RecordingError::Unsupported {
                path: path.to_owned(),
                text,
            })
        };
        if !self.t_s.iter().all(|t| t.is_finite()) || !self.t_s.is_sorted_by(|a, b| a < b) {
            return wrong("the times of the comparison do not rise".to_owned());
        }
        for (name, series) in [
            ("measured", &self.measured),
            ("before", &self.before),
            ("after", &self.after),
        ] {
            let turns = series.turn_wxyz.len();
            if series.position_m.len() != n || (turns != n && turns != 0) {
                return wrong(format!(
                    "the comparison has {n} times, but {} positions and {turns} orientations of the \
                     series '{name}'",
                    series.position_m.len()
                ));
            }
        }
        for (name, rows) in [
            ("before", self.residual_before),
            ("after", self.residual_after),
        ] {
            if rows.len() != self.channels.len() || rows.iter().any(|r| r.len() != n) {
                return wrong(format!(
                    "the comparison has {} channels of {n} residuals, but not so in '{name}'",
                    self.channels.len()
                ));
            }
        }
        Ok(())
    }
}
