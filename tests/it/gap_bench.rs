//! The blind test of the gap finder, with a finder that is a few lines of shell.

use std::os::unix::fs::PermissionsExt as _;
use std::path::Path;

use serde_json::Value;

use crate::process;
use crate::program::{json, refusal, scratch};

/// A finder that writes down how it was called, says `says` and ends with `code`.
fn fake(dir: &Path, says: &str, code: u8) -> String {
    let (script, asked) = (dir.join("finder.sh"), dir.join("asked.txt"));
    let text = format!(
        "#!/bin/sh\n(echo \"$@\"; export -p) >> '{}'\necho '{says}'\nexit {code}\n",
        asked.display()
    );
    std::fs::write(&script, text).expect("writes");
    std::fs::set_permissions(&script, std::fs::Permissions::from_mode(0o755)).expect("executable");
    script.to_string_lossy().into_owned()
}

/// Seed 3 has a null and a single at the strength of the floor; sessions of a few seconds.
fn bench(dir: &Path, finder: &str) -> Value {
    bench_to(&dir.join("out"), finder, &[])
}

fn bench_to(folder: &Path, finder: &str, options: &[&str]) -> Value {
    let mut program = process::program(&["gap", "bench"]);
    program
        .args(["--overwrite", "--json", "--seeds", "1", "--first-seed", "3"])
        .args([
            "--only",
            "nulls,ladder",
            "--seconds",
            "8",
            "--finder",
            finder,
        ])
        .args(options)
        .arg("--out")
        .arg(folder)
        .env("SPRINGTWIN_ANSWER", folder.join("keys"));
    let out = process::output(&mut program);
    let complaint = String::from_utf8_lossy(&out.stderr);
    assert!(out.status.success(), "{complaint}");
    serde_json::from_slice(&out.stdout).expect("one JSON object")
}

fn asked(dir: &Path) -> String {
    std::fs::read_to_string(dir.join("asked.txt")).expect("the finder was called")
}

#[test]
fn the_blind_test_shows_the_finder_no_key_scores_once_and_goes_on_where_it_was() {
    let dir = scratch("gap-bench");
    let nothing = r#"{"verdict": "nothing-missing", "effects": [], "seconds": 1.5}"#;
    let report = bench(&dir, &fake(&dir, nothing, 0));
    let score = &report["score"];
    assert_eq!((&score["cases"], &score["failed"]), (&2.into(), &0.into()));
    assert_eq!(score["nulls"]["false_positive"]["of"], 1);
    assert_eq!(score["nulls"]["false_positive"]["hits"], 0);
    assert_eq!(score["ladder_asked"][0]["strength"], 1.0);
    assert_eq!(score["ladder_asked"][0]["top1"]["hits"], 0);
    assert_eq!(score["seconds"]["max"], 1.5);
    let text = std::fs::read_to_string(dir.join("out/report.md")).expect("a report");
    assert!(
        text.contains("simulated") && text.contains("| nothing | 1 | 1 |  |"),
        "{text}"
    );

    // What the finder got: two sessions per case, no key, nothing of our environment.
    let calls = asked(&dir);
    assert_eq!(calls.matches("gap run --json --baseline").count(), 2);
    assert!(
        !calls.contains("keys") && !calls.contains("SPRINGTWIN_ANSWER"),
        "{calls}"
    );
    let keys: Vec<_> = std::fs::read_dir(dir.join("out/keys"))
        .expect("keys")
        .collect();
    assert_eq!(keys.len(), 2);
    for case in std::fs::read_dir(dir.join("out/cases")).expect("cases") {
        let case = case.expect("entry").path();
        let mut names: Vec<_> = std::fs::read_dir(&case)
            .expect("case")
            .map(|e| e.expect("entry").file_name().into_string().expect("text"))
            .collect();
        names.sort();
        assert_eq!(
            names,
            [
                "commissioning",
                "finder.log",
                "run.json",
                "suspect",
                "verdict.json"
            ]
        );
        for session in ["commissioning", "suspect"] {
            let told = std::fs::read_to_string(case.join(session).join("session.toml"));
            let told = told.expect("a session");
            assert!(!told.contains("single") && !told.contains("null"), "{told}");
        }
    }

    // Again: nothing is computed again, and the report is the same.
    assert_eq!(bench(&dir, &fake(&dir, nothing, 0)), report);
    assert_eq!(asked(&dir), calls);

    // Another finder is asked, about the same sessions; one that fails has no verdict.
    let failed = bench(&dir, &fake(&dir, nothing, 3));
    assert_eq!(failed["score"]["failed"], 2);
    assert_eq!(asked(&dir).matches("gap run --json").count(), 4);
    assert_ne!(failed["finder"], report["finder"]);
}

#[test]
fn shards_of_the_blind_test_are_scored_once_into_the_report_of_one_run() {
    let dir = scratch("gap-bench-shards");
    let nothing = r#"{"verdict": "nothing-missing", "effects": [], "seconds": 1.5}"#;
    let finder = fake(&dir, nothing, 0);
    let part = |i: usize, folder: &str| {
        let out = dir.join(folder);
        let v = bench_to(&out, &finder, &["--shard", &format!("{i}/2")]);
        assert_eq!((&v["cases"], v.get("score")), (&1.into(), None), "{v}");
        assert!(!out.join("report.json").exists(), "a shard was scored");
        out.join(format!("shard-{i}-of-2.json"))
            .display()
            .to_string()
    };
    let (one, two) = (part(1, "a"), part(2, "b"));
    let calls = asked(&dir);
    assert!(!calls.contains("keys") && !calls.contains("SPRINGTWIN_ANSWER"));

    // Merged in any order: what a run in one piece gives.
    let (whole, merged) = (dir.join("whole"), dir.join("merged"));
    let merged_arg = merged.display().to_string();
    let merge = [
        "gap",
        "bench",
        "merge",
        "--overwrite",
        "--json",
        "--out",
        &merged_arg,
    ];
    let said = json(&[merge.as_slice(), &[&two, &one]].concat());
    assert_eq!(said, bench_to(&whole, &finder, &[]));
    for name in ["report.md", "report.json"] {
        let read = |dir: &Path| std::fs::read(dir.join(name)).expect("a report");
        assert!(read(&whole) == read(&merged), "{name} differs");
    }

    // One shard away, twice, of another run, or with a verdict that another finder gave: refused in a sentence.
    let check = |shards: &[&str], words: &str| {
        let (code, text) = refusal(&[merge.as_slice(), shards].concat());
        assert!(code == 1 && text.contains(words), "{text}");
    };
    check(&[&two], "no file of shard 1/2 is given");
    check(&[&one, &two, &one], "shard 1/2 is given twice");
    let foreign = dir.join("a/foreign.json").display().to_string();
    let text = std::fs::read_to_string(&one).expect("a shard");
    std::fs::write(&foreign, text.replace("\"8\"", "\"9\"")).expect("writes");
    check(&[&foreign, &two], "(seconds 8, not 9)");
    check(
        &[&foreign.replace("foreign.json", "report.md"), &two],
        "cannot open",
    );
    bench_to(&dir.join("b"), &fake(&dir, nothing, 3), &["--shard", "2/2"]);
    std::fs::write(dir.join("old.json"), "{}").expect("writes");
    check(&[&one, &two], "comes from another run");
    check(
        &[&dir.join("old.json").display().to_string()],
        "is no shard of `gap bench`",
    );
}
