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

/// A bound of a row: what was measured, what is expected of it at most, and what the test asserts.
pub struct Bound {
    what: &'static str,
    measured: f64,
    most: f64,
    asserted: f64,
    /// Why the asserted bound is not the expected one; empty where it is.
    because: &'static str,
    show: fn(f64) -> String,
}

impl Bound {
    /// A value with its unit by `show`. The expected bound is asserted.
    pub fn of(what: &'static str, measured: f64, most: f64, show: fn(f64) -> String) -> Self {
        Self {
            what,
            measured,
            most,
            asserted: most,
            because: "",
            show,
        }
    }

    /// A time, s.
    pub fn time(what: &'static str, measured: f64, most: f64) -> Self {
        Self::of(what, measured, most, time)
    }

    /// A number of things.
    pub fn count(what: &'static str, measured: f64, most: f64) -> Self {
        Self::of(what, measured, most, |n| n.to_string())
    }

    /// A share of 1.
    pub fn share(what: &'static str, measured: f64, most: f64) -> Self {
        Self::of(what, measured, most, |x| format!("{:.2} %", x * 1e2))
    }

    /// Asserts another bound than the expected one, for a reason; infinity asserts none.
    pub fn asserting(self, asserted: f64, because: &'static str) -> Self {
        Self {
            asserted,
            because,
            ..self
        }
    }

    /// Holds the value to the asserted bound; its part of the column `met`.
    fn met(&self, fault: &str) -> String {
        let Self {
            what,
            measured,
            most,
            asserted,
            because,
            show,
        } = *self;
        // Differences of ticks' times are rounded.
        let within = |bound: f64| measured <= bound * (1.0 + 1e-9);
        assert!(within(asserted), "{fault}: {what} {measured} > {asserted}");
        let (sign, verdict) = match within(most) {
            true => ("<=", "met"),
            false => (">", "NOT MET"),
        };
        let other = match (because, asserted) {
            ("", _) => String::new(),
            (_, f64::INFINITY) => format!(" (not asserted, because {because})"),
            _ => format!(" (asserted <= {}, because {because})", show(asserted)),
        };
        let (measured, most) = (show(measured), show(most));
        format!("{what} {measured} {sign} {most}: {verdict}{other}")
    }
}

/// A time (s) in ms, or in s from 1 s on.
pub fn time(s: f64) -> String {
    match s < 1.0 {
        true => format!("{:.0} ms", s * 1e3),
        false => format!("{s:.1} s").replace(".0 s", " s"),
    }
}

/// Keeps a row of the table: the fault, what is expected, what else was measured, whether the bounds are met. Asserts
/// the bounds; what is expected without a number is asserted by the test before. `place` orders the rows: the fault's
/// number in the matrix, and the number of the expectation within it.
pub fn row(place: (u8, u8), fault: &str, expected: &str, bounds: &[Bound], measured: &str) {
    let met: Vec<String> = bounds.iter().map(|b| b.met(fault)).collect();
    let met = match met.is_empty() {
        true => "asserted by the test".to_owned(),
        false => met.join("; "),
    };
    keep(
        "faults",
        place,
        &format!("| {fault} | {expected} | {measured} | {met} |"),
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
