//! Notes, marks and the end of a rolling recording, by command.

use crate::process;
use crate::program::{json, refusal, scratch};

#[test]
fn a_recording_is_noted_on_and_marked_and_its_parts_keep_both() {
    let dir = scratch("notes");
    let [file, part] = ["a.rrd", "b.rrd"].map(|n| dir.join(n).display().to_string());
    let note = ["--note", "new central tube", "--seconds", "3", "--json"];
    json(&[&["record", &file][..], &note].concat());
    let bytes = std::fs::read(&file).expect("a recording");
    let listed = json(&["note", &file, "--json"]);
    assert_eq!(listed["note"], "new central tube");
    let marks = ["--mark", "0.5=early", "--mark", "1.25=valve clicks"];
    json(&[&["note", &file, "--text", "worn", "--json"][..], &marks].concat());
    let now = json(&[
        "note", &file, "--remove", "0.5", "--mark", "2.5=late", "--json",
    ]);
    assert_eq!(now["note"], "worn");
    assert_eq!(now["marks"][0]["text"], "valve clicks");
    assert_eq!(now["marks"][1]["at_s"], 2.5);
    assert_eq!(std::fs::read(&file).expect("is there"), bytes);
    json(&[
        "cut", &file, "--from", "1", "--to", "2", "--out", &part, "--json",
    ]);
    std::fs::remove_file(dir.join("a.notes.toml")).expect("the notes lie beside it");
    let seen = json(&["inspect", &part, "--json"]);
    assert_eq!(seen["provenance"]["note"], "worn");
    assert_eq!(seen["marks"][0]["text"], "valve clicks");
    assert_eq!(seen["marks"].as_array().map(Vec::len), Some(1));
    let [end, both] = ["c.rrd", "d.rrd"].map(|n| dir.join(n).display().to_string());
    json(&["cut", &file, "--from", "2.2", "--out", &end, "--json"]);
    json(&["merge", &part, &end, "--out", &both, "--json"]);
    let merged = json(&["note", &both, "--json"]);
    assert_eq!(merged["note"], "worn\nnew central tube");
    assert_eq!(merged["marks"][0]["text"], "valve clicks");
    // Parts that share the sample at their ends.
    let [from, whole, all] = ["e.rrd", "f.rrd", "g.rrd"].map(|n| dir.join(n).display().to_string());
    json(&["cut", &file, "--from", "2", "--out", &from, "--json"]);
    json(&["cut", &file, "--from", "1", "--out", &whole, "--json"]);
    json(&["merge", &part, &from, "--out", &all, "--json"]);
    let samples = |file: &str| json(&["inspect", file, "--json"])["samples"].as_u64();
    let [part_n, from_n, whole_n, all_n] = [&part, &from, &whole, &all].map(|f| samples(f));
    assert_eq!(all_n, whole_n);
    assert_eq!(
        part_n.zip(from_n).map(|(a, b)| a + b),
        whole_n.map(|n| n + 1)
    );
    let (code, text) = refusal(&["merge", &from, &part, "--out", &end, "--overwrite"]);
    assert!(
        code == 1 && text.contains("before the recording in front"),
        "{text}"
    );
    let (code, text) = refusal(&["note", &file, "--remove", "1"]);
    assert!(code == 1 && text.contains("no mark at 1 s"), "{text}");
    let (code, text) = refusal(&["note", &file, "--mark", "1"]);
    assert!(code == 2 && text.contains("S=TEXT"), "{text}");
}

#[test]
fn the_end_of_a_rolling_recording_of_a_simulated_arm_is_kept() {
    let dir = scratch("keep");
    let out = dir.join("kept.rrd").display().to_string();
    let run = |args: &[&str]| {
        let mut program = process::program(args);
        process::output(program.env("XDG_DATA_HOME", &dir))
    };
    let keep = [
        "keep",
        "--out",
        &out,
        "--minutes",
        "0.05",
        "--note",
        "slipped",
    ];
    assert!(!run(&keep).status.success(), "there is none");
    let goto = ["goto", "60,40,-300", "--rolling", "--json"];
    assert!(run(&goto[..2]).status.success());
    assert!(
        !run(&keep).status.success(),
        "a simulated arm has none by itself"
    );
    assert!(run(&goto).status.success());
    let kept = run(&keep);
    assert!(
        kept.status.success(),
        "{}",
        String::from_utf8_lossy(&kept.stderr)
    );
    let seen = json(&["inspect", &out, "--json"]);
    assert_eq!(seen["provenance"]["note"], "slipped");
    let seconds = seen["seconds"].as_f64().expect("a length");
    assert!((seconds - 3.0).abs() < 0.05, "{seconds}");
}
