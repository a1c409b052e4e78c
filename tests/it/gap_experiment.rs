//! An excitation that is driven and recorded, a baseline of it, and an experiment of the finder's own.

use serde_json::Value;

use crate::program::{json, refusal, scratch, springtwin};

/// Effects that are looked for: few, which keeps the experiment short.
const LOOKED_FOR: [&str; 3] = ["payload", "base-tilt", "creep"];

#[test]
fn the_finder_drives_the_rig_until_a_hidden_load_is_named() {
    let dir = scratch("gap-experiment");
    let [healthy, patch, baseline, out] =
        ["healthy.rrd", "patch.toml", "baseline.toml", "found"].map(|f| dir.join(f));
    let [healthy, patch, baseline, out] =
        [&healthy, &patch, &baseline, &out].map(|f| f.to_str().expect("a path"));
    let driven = json(&["excite", "--seconds", "60", "--record", healthy, "--json"]);
    assert_eq!(driven["simulated"], true);
    let [low, high] = [0, 1].map(|k| driven["pressures_kpa"][k].as_f64().expect("a number"));
    assert!(low < -4.0 && high > 4.0, "{low} to {high} kPa");
    json(&[
        "gap",
        "commission",
        healthy,
        "--out",
        patch,
        "--baseline",
        baseline,
        "--json",
    ]);

    let known = json(&["gap", "effects", "--json"]);
    let ids = known["effects"].as_array().expect("effects").iter();
    let others = ids
        .filter_map(|e| e["id"].as_str())
        .filter(|id| !LOOKED_FOR.contains(id));
    let mut args = vec![
        "gap",
        "experiment",
        "--json",
        "--baseline",
        baseline,
        "--out",
        out,
        "--hide",
        "payload=0.5",
    ];
    for id in others {
        args.extend(["--without", id]);
    }
    let found = json(&args);
    assert_eq!(found["ended"], "The effect is named.", "{found}");
    assert_eq!(found["finding"]["effects"][0]["id"], "payload");
    assert_eq!(found["simulated"], true);
    let rounds = found["rounds"].as_array().expect("rounds");
    let why = rounds[0]["why"].as_str().expect("a reason");
    assert!(why.contains("would show after it"), "{why}");
    let took = |r: &Value| r["seconds"].as_f64().expect("a time");
    assert_eq!(
        found["seconds"].as_f64(),
        Some(rounds.iter().map(took).sum())
    );
    for name in [
        "round-1.rrd",
        "experiment.json",
        "patch.toml",
        "report.html",
        "finding.json",
    ] {
        assert!(dir.join("found").join(name).is_file(), "no {name}");
    }
    let (code, said) = refusal(&args);
    assert_eq!(code, 1);
    assert!(said.contains("exists already"), "{said}");

    // The monitor notices the load, and with the patch no more.
    let [loaded, patched] = ["loaded.rrd", "patched.toml"].map(|f| dir.join(f));
    let [loaded, patched] = [&loaded, &patched].map(|f| f.to_str().expect("a path"));
    json(&[
        "excite",
        "--kind",
        "loads",
        "--seconds",
        "120",
        "--seed",
        "7",
        "--hide",
        "payload=0.5",
        "--record",
        loaded,
        "--json",
    ]);
    let patch = format!("{out}/patch.toml");
    json(&["gap", "apply", &patch, "--out", patched, "--json"]);
    let watch = |robot: &[&str]| {
        let args = [
            "gap",
            "watch",
            "--json",
            "--baseline",
            baseline,
            "--session",
            loaded,
        ];
        json(&[robot, &args].concat())
    };
    let before = watch(&[]);
    assert!(before["alarm"].is_object(), "{}", before["largest"]);
    let after = watch(&["--robot", patched]);
    assert!(after["alarm"].is_null(), "{}", after["largest"]);
}

#[test]
fn what_an_excitation_would_do_beyond_the_arm_is_refused() {
    let dir = scratch("excite-refused");
    let robot = dir.join("robot.toml");
    let text = std::fs::read_to_string("assets/robots/reference.toml").expect("reads");
    let table =
        "\n[[keep_out]]\nname = \"the table\"\npoint_mm = [0, 0, -299]\noutward = [0, 0, 1]\n";
    std::fs::write(&robot, text + table).expect("writes");
    let robot = robot.to_str().expect("a path");
    // The shipped networks are of another robot file, which a warning states first.
    let out = springtwin(&[
        "excite",
        "--robot",
        robot,
        "--kind",
        "axial",
        "--seconds",
        "30",
    ]);
    let said = String::from_utf8_lossy(&out.stderr);
    assert_eq!(out.status.code(), Some(1), "{said}");
    assert!(
        said.contains("keeps out of (the table)") && said.contains("Nothing was started"),
        "{said}"
    );
    let (code, said) = refusal(&["excite", "--kind", "wild"]);
    assert_eq!(code, 2);
    assert!(said.contains("there is no excitation 'wild'"), "{said}");
}
