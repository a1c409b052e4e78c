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

/// `robot check` on the shipped arms and on five files that are wrong.
#[test]
fn whether_an_arm_fits_is_stated_and_a_wrong_file_refused_at_its_place() {
    let can = |file: &str, what: &str| {
        let checked = json(&["robot", "check", file, "--json"]);
        let all = checked["abilities"].as_array().expect("abilities").clone();
        let found = all.iter().find(|a| a["what"] == what).cloned();
        found.expect(what)["can"].as_bool().expect("yes or no")
    };
    assert!(can("assets/robots/reference.toml", "drive it"));
    assert!(!can("assets/robots/asu-arm.toml", "drive it"));
    assert!(can(
        "assets/robots/asu-arm.toml",
        "replay its logs, compare them at rest"
    ));
    let dir = scratch("robot-check");
    for (k, (from, to, says)) in [
        (
            "pump_flow_l_min = 1.8",
            "pump_flow = 1.8",
            "line 29, column 1",
        ),
        (
            "rest_length_mm = 145.0",
            "rest_length_mm = 0.145",
            "looks like metres",
        ),
        (
            "axial_stiffness_n_m = 2851.0",
            "axial_stiffness_n_m = -2851.0",
            "bellows.axial_stiffness_n_m",
        ),
        (
            "range_kpa = [-40.0, 40.0]",
            "range_kpa = [-60.0, 60.0]",
            "within -40 to 40 kPa",
        ),
        (
            "effective_diameter_mm = 82.5",
            "effective_diameter_mm =",
            "line 18",
        ),
    ]
    .into_iter()
    .enumerate()
    {
        let text = springtwin::robot::REFERENCE.replacen(from, to, 1);
        assert_ne!(text, springtwin::robot::REFERENCE, "{from}");
        let file = dir.join(format!("{k}.toml")).display().to_string();
        std::fs::write(&file, text).expect("writes");
        let (code, said) = refusal(&["robot", "check", &file]);
        assert!(
            code == 1 && said.contains(&file) && said.contains(says),
            "{said}"
        );
    }
}
