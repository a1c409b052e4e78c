//! Reads a recording (`.rrd`) and prints how far the predicted tip was from motion capture.
//!
//! ```sh
//! cargo run --release --example read_recording -- recordings/payload-200g.rrd
//! ```

use std::path::Path;

use springtwin::recording::{RecordingError, read_rrd};

/// Mean distance between predicted and captured tip, m, and how many instants had both.
///
/// # Errors
/// When the file cannot be read, or is no recording.
pub fn mean_error_m(file: &Path) -> Result<(f64, usize), RecordingError> {
    let read = read_rrd(file)?;
    let errors_m: Vec<f64> = read
        .trace
        .snapshots
        .iter()
        .filter_map(|s| {
            let predicted = &s.estimate.as_ref()?.base_from_tip;
            let captured = &s.truth.as_ref()?.base_from_tip;
            Some((predicted.translation.vector - captured.translation.vector).norm())
        })
        .collect();
    let sum_m: f64 = errors_m.iter().sum();
    Ok((sum_m / errors_m.len() as f64, errors_m.len()))
}

/// Prints it for the file on the command line, or for a recording that ships with the program.
///
/// # Errors
/// As [`mean_error_m`].
pub fn main() -> Result<(), RecordingError> {
    let file = std::env::args().nth(1);
    let file = file.unwrap_or_else(|| "recordings/point-to-point.rrd".to_owned());
    let (mean_m, n) = mean_error_m(Path::new(&file))?;
    println!("{file}: {:.2} mm mean over {n} instants", mean_m * 1e3);
    Ok(())
}
