//! MCAP by the program: a recording out and back, a map, and what is refused. Foreign readers and writers: `tests/mcap`.

use crate::program::{json, refusal, scratch};

/// The table that `path` is as a session.
fn table(path: &str, out: &str) -> String {
    json(&["convert", path, out, "--json"]);
    std::fs::read_to_string(out).expect("a table")
}

#[test]
fn a_recording_goes_out_as_ros_2_messages_and_comes_back() {
    let dir = scratch("mcap");
    let at = |name: &str| dir.join(name).display().to_string();
    let recording = "recordings/point-to-point.rrd@2..6";
    let (bag, session) = (at("bag.mcap"), at("session"));
    let written = json(&["convert", recording, &bag, "--json"]);
    assert!(written["messages"].as_u64() > written["rows"].as_u64());
    let read = json(&["import", &bag, "--out", &session, "--json"]);
    assert_eq!(
        (&read["samples"], &read["simulated"]),
        (&written["rows"], &true.into())
    );
    assert_eq!(
        table(recording, &at("recording.csv")),
        table(&session, &at("session.csv"))
    );

    assert_eq!(json(&["inspect", &session, "--json"])["simulated"], true);
    let again = at("again.mcap");
    json(&["convert", &session, &again, "--json"]);
    let bytes = std::fs::read(&again).expect("a bag");
    let has = |topic: &[u8]| bytes.windows(topic.len()).any(|w| w == topic);
    assert!(has(b"/simulated_mocap/pose"));

    // The map of these topics; motion capture of the virtual rig has its own.
    let map = std::fs::read_to_string("assets/logs/ros2-bag.toml").expect("a map");
    let simulated = map.replace("\"/mocap/pose.pose\"", "\"/simulated_mocap/pose.pose\"");
    let own = at("map.toml");
    std::fs::write(&own, simulated).expect("writes");
    let mapped = at("mapped");
    let read = json(&["import", "log", &own, &bag, "--out", &mapped, "--json"]);
    assert_eq!(read["samples"], written["rows"]);

    let none = at("none");
    for (args, wrong) in [
        (
            vec!["import", "log", "assets/logs/ros2-bag.toml", &bag],
            "the topic /mocap/pose, and its topics are",
        ),
        (vec!["import", &bag, "--object", "x"], "leave them out"),
        (
            vec!["import", "log", &own, &bag, "--mocap", "m.csv"],
            "leave --mocap out",
        ),
        (vec!["import", "tests/it/none.mcap"], "tests/it/none.mcap"),
    ] {
        let args = [&args[..], &["--out", &none]].concat();
        let (code, text) = refusal(&args);
        assert!(code == 1 && text.contains(wrong), "{code} {text}");
        assert!(!dir.join("none").exists());
    }
    let (code, text) = refusal(&["convert", recording, &bag]);
    assert!(code == 1 && text.contains("exists already"), "{text}");
}
