//! What is on the disk stays there until somebody says otherwise.

use std::collections::BTreeSet;

use crate::program::{json, refusal, scratch};

/// Every command that writes, with the arguments that it needs, and a file that it would write under `OUT`.
const WRITERS: &[(&str, &str, &str)] = &[
    ("rig measure", "--out OUT/arm.toml", "arm.toml"),
    ("learn", "--out OUT", "reference.safetensors"),
    (
        "dataset generate",
        "--samples 9 --out OUT/d.parquet",
        "d.parquet",
    ),
    ("dataset session", "--out OUT/d.parquet", "d.parquet"),
    (
        "dataset merge",
        "a.parquet b.parquet --out OUT/d.parquet",
        "d.parquet",
    ),
    ("gap commission", "session --out OUT/p.toml", "p.toml"),
    ("gap run", "--session session --out OUT", "finding.json"),
    ("gap discover", "--session session --out OUT", "law.json"),
    (
        "gap experiment",
        "--baseline b.toml --out OUT",
        "experiment.json",
    ),
    (
        "gap run",
        "--session session --actuation-only --out OUT",
        "finding.json",
    ),
    ("gap apply", "p.toml --out OUT/r.toml", "r.toml"),
    ("gap bench", "--seeds 1 --out OUT", "report.json"),
    (
        "gap bench",
        "--seeds 1 --shard 1/9 --out OUT",
        "shard-1-of-9.json",
    ),
    ("gap bench merge", "a.json --out OUT", "report.md"),
    (
        "train",
        "--data d.parquet --out OUT",
        "reference.safetensors",
    ),
    ("study", "eight --out OUT", "eight.svg"),
    ("study", "all --out OUT", "README.md"),
    ("study", "eight --shard 2/3 --out OUT", "eight-2-of-3.json"),
    ("calibrate springs", "bench.csv --out OUT/c.toml", "c.toml"),
    ("calibrate imus", "m.rrd --out OUT/c.toml", "c.toml"),
    ("calibrate self", "m.rrd --out OUT/c.toml", "c.toml"),
    ("calibrate mocap", "a b --out OUT/r.toml", "r.toml"),
    ("run", "--headless --seconds 1 --record OUT/r.rrd", "r.rrd"),
    ("goto", "60,40,-300 --out OUT", "log.csv"),
    ("excite", "--record OUT/r.rrd", "r.rrd"),
    ("follow", "--path eight --record OUT/r.rrd", "r.rrd"),
    ("pick-place", "--out OUT", "springs.svg"),
    ("record", "OUT/r.rrd --seconds 1", "r.rrd"),
    ("keep", "--out OUT/r.rrd", "r.rrd"),
    ("cut", "a.rrd --from 1 --out OUT/r.rrd", "r.rrd"),
    ("merge", "a.rrd b.rrd --out OUT/r.rrd", "r.rrd"),
    ("convert", "session OUT/t.csv", "t.csv"),
    ("convert", "session OUT/t.mcap", "t.mcap"),
    ("reprocess", "a.rrd --out OUT/r.rrd", "r.rrd"),
    ("import", "m.csv --out OUT", "log.csv"),
    ("import", "b.mcap --out OUT", "log.csv"),
    ("import log", "map.toml log.csv --out OUT", "log.csv"),
    ("rig session", "--seconds 5 --out OUT", "session.toml"),
    ("rig bench", "--out OUT/b.csv", "b.csv"),
    ("man", "--out OUT", "springtwin-gap-run.1"),
    (
        "sim solve",
        "--pressures 0,0,0,0,0,0 --out OUT/s.csv",
        "s.csv",
    ),
    ("sim replay", "session --out OUT/r.csv", "r.csv"),
    (
        "figure",
        "a.rrd --signals tip_x_mm --out OUT/f.svg",
        "f.svg",
    ),
    ("estimate", "session --out OUT/e.parquet", "e.parquet"),
];

#[test]
fn no_command_replaces_a_file_unasked() {
    let dir = scratch("outputs");
    let out = dir.to_str().expect("utf-8");
    for (command, options, file) in WRITERS {
        let kept = dir.join(file);
        std::fs::write(&kept, "kept").expect("writes");
        let options = options.replace("OUT", out);
        let args: Vec<&str> = command.split(' ').chain(options.split(' ')).collect();
        let (code, said) = refusal(&args);
        assert_eq!(code, 1, "{args:?}: {said}");
        assert!(
            said.contains("exists already") && said.contains("--overwrite"),
            "{args:?}: {said}"
        );
        let is = std::fs::read_to_string(&kept).expect("is there");
        assert_eq!(is, "kept", "{args:?}");
        std::fs::remove_file(&kept).expect("removes");
        let left: Vec<_> = std::fs::read_dir(&dir).expect("folder").collect();
        assert!(left.is_empty(), "{args:?} left {left:?}");
    }
}

/// The table above has all commands that write somewhere, by the list of the program; for a merge of studies the shards show
/// what it writes (see `dataset`), pictures and films need the window's part of the program.
#[test]
fn the_table_of_writers_is_whole() {
    let page = json(&["man", "--markdown", "--json"]);
    let page = page["markdown"].as_str().expect("a page");
    let mut writers = BTreeSet::new();
    let mut command = "";
    for line in page.lines() {
        if let Some(name) = line.strip_prefix("## ").or(line.strip_prefix("### ")) {
            command = name;
        }
        let writes = ["- `--out ", "- `--record ", "- `--truth "];
        if writes.iter().any(|w| line.starts_with(w)) {
            writers.insert(command);
        }
    }
    let known: BTreeSet<&str> = WRITERS.iter().map(|(command, ..)| *command).collect();
    let others = ["study merge", "screenshot", "video"];
    let missing: Vec<_> = writers
        .iter()
        .filter(|w| !known.contains(**w) && !others.contains(w))
        .collect();
    assert!(missing.is_empty(), "without a line in WRITERS: {missing:?}");
}

#[test]
fn what_may_be_replaced_is() {
    let dir = scratch("outputs-replaced");
    let [log, session] = ["bench.csv", "session"].map(|n| dir.join(n).display().to_string());
    let read = || std::fs::read_to_string(&log).expect("a log");
    json(&["rig", "bench", "--out", &log, "--json"]);
    let first = read();
    let other = ["rig", "bench", "--out", &log, "--seed", "2", "--json"];
    refusal(&other);
    assert_eq!(read(), first);
    json(&[&other[..], &["--overwrite"]].concat());
    assert_ne!(read(), first);

    let answer = dir.join("answer.json").display().to_string();
    let make = [
        "rig",
        "session",
        "--seconds",
        "5",
        "--json",
        "--out",
        &session,
    ];
    json(&make);
    std::fs::write(&answer, "kept").expect("writes");
    let again = [&make[..], &["--truth", &answer]].concat();
    assert!(refusal(&again).1.contains("answer.json exists already"));
    json(&[&again[..], &["--overwrite"]].concat());
    assert_ne!(std::fs::read_to_string(&answer).expect("is there"), "kept");
}

/// More than any disk holds is refused before anything is written, and both sizes are said.
#[test]
#[cfg(unix)]
fn a_data_set_that_does_not_fit_is_refused() {
    let dir = scratch("outputs-size");
    let file = dir.join("d.parquet").display().to_string();
    for more in [&[][..], &["--shard", "7/9"]] {
        let args = [
            "dataset",
            "generate",
            "--samples",
            "99999999999999999",
            "--out",
            &file,
        ];
        let (code, said) = refusal(&[&args[..], more].concat());
        assert_eq!(code, 1, "{said}");
        assert!(
            said.contains(" EB, but ") && said.contains(" free: ask for less"),
            "{said}"
        );
    }
    let left = std::fs::read_dir(&dir).expect("folder").count();
    assert_eq!(left, 0, "files were begun");
}
