//! The gap finder from sessions on disk to verdicts: two effects at once, alternatives that only
//! another excitation distinguishes, and logs it must not believe.

use std::path::{Path, PathBuf};

use serde_json::Value;

use crate::program::{json, refusal, scratch};

/// A session of the virtual rig.
pub fn session(dir: &Path, name: &str, args: &[&str]) -> String {
    let out = dir.join(name).to_str().expect("a path").to_owned();
    let mut all = vec!["rig", "session", "--out", &out, "--json"];
    all.extend(args);
    json(&all);
    out
}

fn find(baseline: &str, suspect: &str, more: &[&str]) -> Value {
    let mut all = vec!["gap", "run", "--baseline", baseline, "--session", suspect];
    all.extend(more);
    all.push("--json");
    json(&all)
}

fn names(finding: &Value) -> Vec<(String, Option<u64>)> {
    let effects = finding["effects"].as_array().expect("a list");
    let name = |e: &Value| {
        (
            e["id"].as_str().expect("an id").to_owned(),
            e["target"].as_u64(),
        )
    };
    let mut out: Vec<_> = effects.iter().map(name).collect();
    out.sort();
    out
}

#[test]
fn two_effects_in_one_session_are_both_named() {
    let dir = scratch("gap-two");
    let healthy = session(&dir, "healthy", &["--seed", "1", "--seconds", "60"]);
    let suspect = session(
        &dir,
        "suspect",
        &[
            "--seed",
            "2",
            "--seconds",
            "60",
            "--hide",
            "payload=0.4",
            "--hide",
            "spring-calibration:4=1.06,0.002",
        ],
    );
    let found = find(&healthy, &suspect, &[]);
    assert_eq!(found["verdict"], "named", "{found}");
    let wanted = [
        ("payload".to_owned(), None),
        ("spring-calibration".to_owned(), Some(4)),
    ];
    assert_eq!(names(&found), wanted);
    assert!(found["gap"]["closed"].as_f64().unwrap() > 0.8, "{found}");
}

/// A spring's circuit changes while the arm works: the time is found beside the effect, and what follows is judged by itself. An
/// effect that is there from the start has no beginning.
#[test]
fn what_begins_within_the_session_is_named_with_its_time() {
    let dir = scratch("gap-onset");
    let made = |name: &str, seed: &str, hidden: &[&str]| {
        let mut args = vec!["--seed", seed, "--seconds", "60"];
        args.extend(hidden);
        session(&dir, name, &args)
    };
    let healthy = made("healthy", "1", &[]);
    let later = "spring-calibration:4=1.06,0.002@25";
    let suspect = made("suspect", "2", &["--hide", later]);
    let found = find(&healthy, &suspect, &[]);
    assert_eq!(found["verdict"], "named", "{found}");
    assert_eq!(names(&found), [("spring-calibration".to_owned(), Some(4))]);
    let number = |v: &Value| v.as_f64().expect("a number");
    let onset = &found["onset"];
    let [low, high] = [0, 1].map(|i| number(&onset["ci95"][i]));
    assert!(low < 25.0 && 25.0 < high && high - low < 5.0, "{onset}");
    assert!((number(&onset["t_s"]) - 25.0).abs() < 1.0, "{onset}");
    let notes = found["notes"].to_string();
    assert!(notes.contains("It begins at 2"), "{notes}");
    assert!(number(&found["gap"]["closed"]) > 0.8, "{found}");
    let whole = later.trim_end_matches("@25");
    let whole = made("whole", "3", &["--hide", whole]);
    let found = find(&healthy, &whole, &[]);
    assert_eq!(names(&found), [("spring-calibration".to_owned(), Some(4))]);
    assert!(found["onset"].is_null(), "{found}");
}

/// Two bellows touch each other, which no effect of the table is: the law is found, holds under another excitation, and moves the
/// arm of a robot file that has it.
#[test]
fn what_no_table_has_is_found_as_a_law() {
    let dir = scratch("gap-law");
    let made = |name: &str, seed: &str, more: &[&str]| {
        let mut args = vec!["--seed", seed, "--seconds", "45"];
        args.extend(more);
        session(&dir, name, &args)
    };
    let touch = ["--hide", "bellows-touch:2=0.145"];
    let healthy = made("healthy", "11", &[]);
    let suspect = made("suspect", "12", &touch);
    let other = made(
        "other",
        "13",
        &[&touch[..], &["--excitation", "sines"]].concat(),
    );
    let out = dir.join("found").to_str().expect("a path").to_owned();
    let args = [
        "gap",
        "discover",
        "--baseline",
        &healthy,
        "--session",
        &suspect,
    ];
    let more = ["--prove", &other, "--out", &out, "--json"];
    let found = json(&[&args[..], &more].concat());
    assert_eq!(found["verdict"], "law", "{found}");
    let law = &found["laws"][0];
    assert_eq!(law["site"], "chamber-tension", "{found}");
    assert_eq!(law["target"], 2, "{found}");
    assert_eq!(law["terms"][0]["inputs"], serde_json::json!(["length"]));
    assert_eq!(law["terms"][0]["form"], "below", "{found}");
    let closed = found["proof"]["closed"].as_f64().expect("a proof");
    assert!(closed > 0.8, "{found}");
    // The patch is a robot's, and the law a Rust item.
    let patch = format!("{out}/patch.toml");
    let text = std::fs::read_to_string(&patch).expect("written");
    assert!(
        text.contains("[[law]]") && text.contains("tension-below-length"),
        "{text}"
    );
    let solve = ["sim", "solve", "--pressures=0,-30,0,0,0,0", "--json"];
    let tips = [
        json(&solve),
        json(&[&solve[..], &["--patch", &patch]].concat()),
    ];
    assert_ne!(tips[0], tips[1]);
    let item = json(&["gap", "promote", &patch, "--json"]);
    let item = item["rust"].as_str().expect("text");
    assert!(
        item.contains("static TENSION_BELOW_LENGTH: Effect"),
        "{item}"
    );
}

/// The same spring is wrong in two sessions, and a third had no part in finding it.
#[test]
fn several_sessions_count_together_and_another_one_proves_it() {
    let dir = scratch("gap-several");
    let made = |name: &str, seed: &str, hide: &[&str]| {
        let mut args = vec!["--seed", seed, "--seconds", "30"];
        args.extend(hide);
        session(&dir, name, &args)
    };
    let wrong = ["--hide", "spring-calibration:4=1.06,0.002"];
    let healthy = [made("monday", "1", &[]), made("tuesday", "2", &[])];
    let suspects = [made("friday", "3", &wrong), made("saturday", "4", &wrong)];
    let other = made("sunday", "5", &wrong);
    let found = find(
        &healthy[0],
        &suspects[0],
        &[
            "--baseline",
            &healthy[1],
            "--session",
            &suspects[1],
            "--prove",
            &other,
        ],
    );
    assert_eq!(found["verdict"], "named", "{found}");
    assert_eq!(names(&found), [("spring-calibration".to_owned(), Some(4))]);
    assert_eq!(found["data"]["session"], "friday, saturday");
    let interval = |found: &Value| {
        let ends = &found["effects"][0]["params"]["gain"]["ci95"];
        [0, 1].map(|i| ends[i].as_f64().expect("a number"))
    };
    let [low, high] = interval(&found);
    assert!(low < 1.06 && 1.06 < high, "{low} to {high}");
    let alone = find(&healthy[0], &suspects[0], &[]);
    let [alone_low, alone_high] = interval(&alone);
    assert!(high - low < alone_high - alone_low, "{found} {alone}");
    // The rig in order is fitted once and kept.
    let kept = dir.join("rig.toml");
    let kept = kept.to_str().expect("a path");
    json(&[
        "gap",
        "commission",
        &healthy[0],
        "--baseline",
        kept,
        "--json",
    ]);
    let by_kept = find(kept, &suspects[0], &[]);
    assert_eq!(names(&by_kept), names(&alone), "{by_kept}");
    assert_eq!(by_kept["data"]["baseline"], "monday");
    for (a, b) in interval(&by_kept).into_iter().zip([alone_low, alone_high]) {
        assert!((a - b).abs() < 1e-4, "{by_kept} {alone}");
    }
    let both = ["--baseline", &healthy[1]];
    let args = ["gap", "run", "--baseline", kept, "--session", &suspects[0]];
    let (_, why) = refusal(&[&args[..], &both].concat());
    assert!(why.contains("fitted already"), "{why}");
    let proof = &found["proof"];
    assert_eq!(proof["sessions"], serde_json::json!(["sunday"]));
    assert_eq!(proof["gap"]["unit"], "mm");
    assert!(proof["closed"].as_f64().expect("a number") > 0.7, "{proof}");
    assert!(alone["proof"].is_null(), "{alone}");
}

/// Pumps that need ten seconds and more for a stroke make dead time and a weak pump look alike. The finder says so and
/// proposes a motion.
#[test]
fn a_delay_is_named_or_stands_in_a_set_with_a_motion_that_distinguishes() {
    let dir = scratch("gap-pair");
    let healthy = session(&dir, "healthy", &["--seed", "1", "--seconds", "60"]);
    let hidden = [
        "--seed",
        "5",
        "--seconds",
        "60",
        "--hide",
        "pressure-delay=0.3",
    ];
    let found = find(&healthy, &session(&dir, "suspect", &hidden), &[]);
    let set = names(&found);
    let delay = ("pressure-delay".to_owned(), None);
    assert!(set.contains(&delay), "{set:?}");
    if found["verdict"] == "named" {
        assert_eq!(set, [delay]);
        let ends = &found["effects"][0]["params"]["delay"]["ci95"];
        let end = |i: usize| ends[i].as_f64().expect("an interval");
        assert!(end(0) < 0.3 && 0.3 < end(1), "{ends}");
    } else {
        assert_eq!(found["verdict"], "indistinguishable", "{found}");
        assert!(set.len() >= 2, "{set:?}");
        assert!(found["separate_by"]["excitation"].is_string(), "{found}");
    }
}

#[test]
fn sessions_that_cannot_be_believed_are_refused_or_say_less() {
    let dir = scratch("gap-bad");
    let healthy = session(&dir, "healthy", &["--seed", "1", "--seconds", "30"]);
    let short = session(&dir, "short", &["--seed", "2", "--seconds", "8"]);
    let still = session(
        &dir,
        "still",
        &["--seed", "2", "--seconds", "30", "--excitation", "still"],
    );
    let run =
        |suspect: &str| refusal(&["gap", "run", "--baseline", &healthy, "--session", suspect]).1;
    assert!(run(&short).contains("8 s long: at least 20 s are needed"));
    assert!(run(&still).contains("drive the arm through its range"));

    // Recorded with another robot file.
    let other = dir.join("other");
    std::fs::create_dir_all(&other).unwrap();
    std::fs::copy(Path::new(&healthy).join("log.csv"), other.join("log.csv")).unwrap();
    let about = std::fs::read_to_string(Path::new(&healthy).join("session.toml")).unwrap();
    let robot = about
        .lines()
        .find(|l| l.starts_with("robot"))
        .expect("says its robot");
    let about = about.replace(robot, "robot = \"0123456789abcdef\"");
    std::fs::write(other.join("session.toml"), about).unwrap();
    let complaint = run(other.to_str().unwrap());
    assert!(
        complaint.contains("01234567") && complaint.contains("--robot"),
        "{complaint}"
    );

    // No springs, motion capture lost for a while: what is left is used, and it is said what is not.
    let poor = dir.join("poor");
    std::fs::create_dir_all(&poor).unwrap();
    let suspect = session(
        &dir,
        "suspect",
        &[
            "--seed",
            "3",
            "--seconds",
            "30",
            "--hide",
            "mocap-frame=0.01,0,0,0,0,0.02",
        ],
    );
    let log = std::fs::read_to_string(Path::new(&suspect).join("log.csv")).unwrap();
    let mut lines = log.lines();
    let header: Vec<&str> = lines.next().unwrap().split(',').collect();
    let mut text = header.join(",");
    for (n, line) in lines.enumerate() {
        let cells: Vec<&str> = line.split(',').collect();
        let kept: Vec<&str> = header
            .iter()
            .zip(&cells)
            .map(|(name, cell)| {
                let captured = name.starts_with("vicon");
                let lost = name.starts_with("spring") || (captured && (500..700).contains(&n));
                if lost { "" } else { cell }
            })
            .collect();
        text.push('\n');
        text.push_str(&kept.join(","));
    }
    std::fs::write(poor.join("log.csv"), text).unwrap();
    std::fs::copy(
        Path::new(&suspect).join("session.toml"),
        poor.join("session.toml"),
    )
    .unwrap();
    let found = find(&healthy, poor.to_str().unwrap(), &[]);
    let notes = found["notes"].to_string();
    assert!(
        notes.contains("Not measured: spring 1, spring 2"),
        "{notes}"
    );
    assert!(notes.contains("only the common ones count"), "{notes}");
    assert_eq!(names(&found), [("mocap-frame".to_owned(), None)], "{found}");
}

/// Two recordings of one motion that are read by calibrations 1 mm apart in one spring: the finder states it, and so does
/// whatever else takes recordings. Of tables nothing is stated.
#[cfg(feature = "rrd")]
#[test]
fn recordings_that_were_made_differently_are_stated() {
    let dir = scratch("gap-provenance");
    let path = |name: &str| dir.join(name).to_str().expect("a path").to_owned();
    let [one, other, table] = ["one.rrd", "other.rrd", "table.csv"].map(path);
    let calibration = path("calibration.toml");
    let mut record = vec!["record", &one, "--rig", "sim", "--target", "-60,30,-380"];
    record.extend(["--seconds", "24", "--json"]);
    json(&record);
    let shipped = concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/assets/calibration/virtual-rig.toml"
    );
    let text = std::fs::read_to_string(shipped).expect("the calibration");
    let line = text.lines().find(|l| l.starts_with("coefficients_mm"));
    let constant = line
        .expect("a curve")
        .split(['[', ','])
        .nth(1)
        .expect("a number");
    let longer = constant.trim().parse::<f64>().expect("a number") + 1.0;
    std::fs::write(
        &calibration,
        text.replacen(constant, &longer.to_string(), 1),
    )
    .expect("written");
    json(&[
        "reprocess",
        &one,
        "--calibration",
        &calibration,
        "--out",
        &other,
        "--json",
    ]);
    json(&["convert", &other, &table, "--json"]);

    let find = [
        "gap",
        "run",
        "--actuation-only",
        "--json",
        "--baseline",
        &one,
    ];
    let with = |session: &str| json(&[&find[..], &["--session", session]].concat());
    let found = with(&other);
    assert_eq!(
        found["differences"][0], "calibration of springs 1",
        "{found}"
    );
    let notes = found["notes"].to_string();
    assert!(
        notes.contains("different in the session: calibration of springs 1"),
        "{notes}"
    );
    for same in [&one, &table] {
        assert_eq!(with(same)["differences"], serde_json::json!([]), "{same}");
    }
    let estimated = |session: &str| json(&["estimate", session, "--json"])["differences"].clone();
    assert!(estimated(&one).to_string().contains("networks ("));
    assert_eq!(estimated(&table), serde_json::json!([]));
}

/// What the finder does with an effect is in the table: no id of one is matched anywhere in it.
#[test]
fn no_id_of_an_effect_occurs_in_the_finder() {
    fn sources(folder: &Path, out: &mut Vec<PathBuf>) {
        for entry in std::fs::read_dir(folder).expect("the finder's sources") {
            let path = entry.expect("an entry").path();
            if path.is_dir() {
                sources(&path, out);
            } else if path.file_name().is_some_and(|n| n != "tests.rs") {
                out.push(path);
            }
        }
    }
    let mut files = Vec::new();
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("src/gap");
    sources(&folder, &mut files);
    assert!(files.len() > 20, "{files:?}");
    for file in files {
        let text = std::fs::read_to_string(&file).expect("UTF-8");
        let code = text.split("#[cfg(test)]").next().unwrap_or_default();
        for effect in springtwin::sim::effects::EFFECTS {
            let quoted = format!("\"{}\"", effect.id);
            assert!(!code.contains(&quoted), "{quoted} in {}", file.display());
        }
    }
}

#[test]
fn a_window_needs_a_healthy_one() {
    let run = |more: &[&str]| refusal(&[&["gap", "run", "--session", "s.csv"][..], more].concat());
    let (code, text) = run(&["--window", "22:29"]);
    assert_eq!(code, 1);
    assert!(text.contains("at least one with --baseline"), "{text}");
}
