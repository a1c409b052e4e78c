//! The live monitor on sessions of the virtual rig, as `gap watch` goes through them.

use std::path::Path;

use serde_json::Value;

use crate::program::{json, refusal, scratch};

fn session(dir: &Path, name: &str, args: &[&str]) -> String {
    let out = dir.join(name).to_str().expect("a path").to_owned();
    let mut all = vec!["rig", "session", "--out", &out, "--json"];
    all.extend(args);
    json(&all);
    out
}

fn watch(baseline: &str, session: &str) -> Value {
    json(&[
        "gap",
        "watch",
        "--baseline",
        baseline,
        "--session",
        session,
        "--json",
    ])
}

/// A healthy rig may move in ways that its baseline does not have, and restart its IMUs. A load that is hung on within the session
/// is seen within half a minute.
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
    let agrees = watch(baseline, &steps);
    assert_eq!(agrees["alarm"], Value::Null, "{}", agrees["largest"]);
    assert!(agrees["judged_s"].as_f64().expect("a number") > 170.0);

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
    let found = watch(baseline, &loaded);
    let number = |key: &str| found["alarm"][key].as_f64().expect("a number");
    let (at_s, since_s) = (number("at_s"), number("since_s"));
    assert!((60.0..90.0).contains(&at_s), "seen at {at_s} s");
    assert!((50.0..75.0).contains(&since_s), "since {since_s} s");
    assert!(found["largest"].as_f64().expect("a number") > 1.5);

    let (_, no_baseline) = refusal(&["gap", "watch", "--baseline", patch, "--session", &steps]);
    assert!(no_baseline.contains("no baseline file"), "{no_baseline}");
    assert!(
        no_baseline.contains("gap commission --baseline"),
        "{no_baseline}"
    );
}
