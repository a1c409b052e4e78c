//! Faults we survive: a case per row of the fault matrix, each asserting its bound. What was measured is
//! kept as rows of the table in the guide (`assets/guide/faults.md`).

pub mod bench;
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
    keep(
        "faults",
        place,
        &format!("| {fault} | {expected} | {measured} |"),
    );
}

/// Keeps a part of a table of the guide.
pub fn keep(table: &str, place: (u8, u8), text: &str) {
    let dir = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join(table);
    std::fs::create_dir_all(&dir).expect("a folder for the rows");
    println!("{text}");
    let name = format!("{:02}-{:02}.md", place.0, place.1);
    std::fs::write(dir.join(name), format!("{text}\n")).expect("a row is written");
}
