//! Sessions, networks and pressures belong to a robot; what is of another is refused.

use crate::program::{json, refusal, scratch};

#[test]
fn pressures_beyond_the_range_are_refused() {
    for (pressures, what) in [
        ("--pressures=100,0,0,0,0,0", "100 kPa in chamber 1"),
        ("--pressures=0,0,0,0,0,-40.5", "-40.5 kPa in chamber 6"),
    ] {
        let (code, said) = refusal(&["sim", "solve", pressures]);
        assert_eq!(code, 1);
        assert!(
            said.contains(what) && said.contains("(-40 to 40 kPa)"),
            "{said}"
        );
    }
    json(&["sim", "solve", "--pressures=40,-40,40,-40,40,-40", "--json"]);
}

#[test]
fn a_session_of_another_robot_is_refused_wherever_it_is_read() {
    let dir = scratch("robots");
    let path = |name: &str| dir.join(name).display().to_string();
    let (other, session) = (path("other.toml"), path("session"));
    let longer =
        springtwin::robot::REFERENCE.replace("rest_length_mm = 145", "rest_length_mm = 135");
    assert_ne!(longer, springtwin::robot::REFERENCE);
    std::fs::write(&other, longer).expect("writes");
    let make = [
        "rig",
        "session",
        "--seconds",
        "25",
        "--json",
        "--out",
        &session,
    ];
    json(&[&make[..], &["--robot", &other]].concat());

    let patch = path("patch.toml");
    for args in [
        vec!["sim", "replay", &session],
        vec!["gap", "run", "--session", &session],
        vec!["gap", "commission", &session, "--out", &patch],
        vec!["estimate", &session],
    ] {
        let (code, said) = refusal(&args);
        assert_eq!(code, 1, "{args:?}");
        assert!(
            said.contains("was recorded with robot file"),
            "{args:?}: {said}"
        );
    }
    let own = json(&["sim", "replay", &session, "--robot", &other, "--json"]);
    assert!(
        own["rmse"]["pos_mm"].as_f64().expect("a figure") < 30.0,
        "{own}"
    );

    // With its own robot file, the networks that ship are still another's.
    let estimate = ["estimate", &session, "--robot", &other];
    let (code, said) = refusal(&estimate);
    assert_eq!(code, 1);
    assert!(
        said.contains("trained for another robot file") && said.contains("--any-robot"),
        "{said}"
    );
    let all_the_same = json(&[&estimate[..], &["--any-robot", "--json"]].concat());
    assert!(all_the_same["n"].as_u64().expect("a number") > 100);
    json(&["estimate", &session, "--any-robot", "--json"]);
}
