//! The live monitor on sessions of the virtual rig, as `gap watch` goes through them.

use std::path::Path;

use serde_json::Value;

use crate::gap_find::session;
use crate::program::{json, refusal, scratch};

fn watch(baseline: &str, session: &str, more: &[&str]) -> Value {
    let args = ["gap", "watch", "--baseline", baseline, "--session", session];
    json(&[&args, more, &["--json"]].concat())
}

/// A healthy rig may move in ways that its baseline does not have, and restart its IMUs. A load that is hung on within the session
/// is seen within forty seconds.
#[test]
fn a_healthy_arm_agrees_with_its_twin_and_a_load_in_the_middle_is_seen() {
    let dir = scratch("gap-watch");
    let healthy = session(&dir, "healthy", &["--seed", "1", "--seconds", "90"]);
    let [patch, baseline] = ["healthy.toml", "baseline.toml"].map(|f| dir.join(f));
    let [patch, baseline] = [&patch, &baseline].map(|f| f.to_str().expect("a path"));
    json(&[
        "gap",
        "commission",
        &healthy,
        "--out",
        patch,
        "--baseline",
        baseline,
        "--json",
    ]);
    let steps = session(
        &dir,
        "steps",
        &["--seed", "2", "--seconds", "180", "--excitation", "steps"],
    );
    let agrees = watch(baseline, &steps, &[]);
    assert_eq!(agrees["alarm"], Value::Null, "{}", agrees["largest"]);
    assert!(agrees["judged_s"].as_f64().expect("a number") > 160.0);

    // Without pressures for three seconds the arm is not judged, nor shortly after.
    let holes = dir.join("holes");
    std::fs::create_dir(&holes).expect("a folder");
    let steps_dir = Path::new(&steps);
    std::fs::copy(steps_dir.join("session.toml"), holes.join("session.toml")).expect("copies");
    let log = std::fs::read_to_string(steps_dir.join("log.csv")).expect("reads");
    let blank = |line: &str| -> String {
        let mut cells: Vec<&str> = line.split(',').collect();
        if matches!(cells[0].parse::<f64>(), Ok(t_s) if (60.0..63.0).contains(&t_s)) {
            cells[1..7].fill("");
        }
        cells.join(",")
    };
    let log: Vec<String> = log.lines().map(blank).collect();
    std::fs::write(holes.join("log.csv"), log.join("\n")).expect("writes");
    let with_holes = watch(baseline, holes.to_str().expect("a path"), &[]);
    assert_eq!(
        with_holes["alarm"],
        Value::Null,
        "{}",
        with_holes["largest"]
    );

    let loaded = session(
        &dir,
        "loaded",
        &[
            "--seed",
            "3",
            "--seconds",
            "120",
            "--hide",
            "payload=0.5@60",
        ],
    );
    let found = watch(baseline, &loaded, &[]);
    let number = |key: &str| found["alarm"][key].as_f64().expect("a number");
    let (at_s, since_s) = (number("at_s"), number("since_s"));
    assert!((60.0..100.0).contains(&at_s), "seen at {at_s} s");
    assert!((50.0..75.0).contains(&since_s), "since {since_s} s");
    // A load that is known is no disagreement.
    let known = watch(baseline, &loaded, &["--mute", "undeclared payload"]);
    let largest = |found: &Value| found["largest"].as_f64().expect("a number");
    assert!(
        largest(&known) < 0.7 * largest(&found),
        "{}",
        known["largest"]
    );
    assert_eq!(known["alarm"], Value::Null);
    let args = [
        "gap",
        "watch",
        "--baseline",
        baseline,
        "--session",
        &loaded,
        "--mute",
        "rust",
    ];
    let (_, unknown) = refusal(&args);
    assert!(unknown.contains("'rust'"), "{unknown}");

    let (_, no_baseline) = refusal(&["gap", "watch", "--baseline", patch, "--session", &steps]);
    assert!(no_baseline.contains("no baseline file"), "{no_baseline}");
    assert!(
        no_baseline.contains("gap commission --baseline"),
        "{no_baseline}"
    );
}
