//! The long run, shortened: `springtwin soak` on simulated time.

use serde_json::Value;

use crate::faults::{Bound, row};
use crate::program::{json, refusal};

#[test]
fn a_soak_keeps_its_bounds() {
    let v = json(&[
        "soak",
        "--hours",
        "0.2",
        "--accelerate",
        "--seed",
        "5",
        "--json",
    ]);
    let number = |key: &str| v[key].as_f64().unwrap_or(f64::NAN);
    assert_eq!(number("ticks"), 72_001.0, "{v}");
    assert!(
        number("goals_reached") >= 1.0 && number("recordings") >= 1.0,
        "{v}"
    );
    let faults = v["faults"].as_object().expect("faults by kind");
    let all: u64 = faults.values().filter_map(Value::as_u64).sum();
    assert!(all >= 5, "{v}");
    assert_eq!(v["handles"]["first"], v["handles"]["last"], "{v}");
    assert_eq!(v["threads"]["first"], v["threads"]["last"], "{v}");
    assert_eq!(v["simulated"], true);
    row(
        (23, 1),
        "24 h soak (time-accelerated); here 0.2 h",
        "0 panics; constant handles",
        &[
            Bound::count("panics", number("panics"), 0.0),
            Bound::count("violations", number("violations"), 0.0),
        ],
        &format!(
            "{} handles throughout, {all} faults, {} times SAFE",
            v["handles"]["last"], v["safe"]
        ),
    );
}

#[test]
fn hours_that_make_no_sense_are_refused() {
    for hours in ["0", "-1", "nan", "1e9", "x"] {
        let (code, text) = refusal(&["soak", &format!("--hours={hours}"), "--accelerate"]);
        assert!(
            code == 2 && text.contains("number of hours"),
            "{code} {text}"
        );
    }
}
