//! Faults we survive: a case per row of the fault matrix, each asserting its bound. What was measured is
//! kept as rows of the table in the guide (`assets/guide/faults.md`).

mod bench;
mod boards;
pub mod disk;
mod files;
mod listeners;
mod samples;
mod sensors;
mod surroundings;

use std::path::PathBuf;

/// Keeps a row of the table: the fault, what is expected, what was measured. `place` orders the rows:
/// the fault's number in the matrix, and the number of the expectation within it.
pub fn row(place: (u8, u8), fault: &str, expected: &str, measured: &str) {
    let dir = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join("faults");
    std::fs::create_dir_all(&dir).expect("a folder for the rows");
    let line = format!("| {fault} | {expected} | {measured} |\n");
    println!("{line}");
    let name = format!("{:02}-{:02}.md", place.0, place.1);
    std::fs::write(dir.join(name), line).expect("a row is written");
}
