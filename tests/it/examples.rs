//! The library's examples (`examples/`) run, and what they print is so.

#[cfg(feature = "rrd")]
use std::path::Path;

#[path = "../../examples/closed_loop.rs"]
mod closed_loop;
#[path = "../../examples/estimate_pose.rs"]
mod estimate_pose;
#[path = "../../examples/fit_springs.rs"]
mod fit_springs;
#[path = "../../examples/new_effect.rs"]
#[allow(dead_code, reason = "the test looks for the new effect alone")]
mod new_effect;
#[path = "../../examples/read_recording.rs"]
#[allow(dead_code, reason = "its main reads the command line")]
mod read_recording;
#[path = "../../examples/settle_arm.rs"]
mod settle_arm;

#[test]
fn a_load_stretches_the_arm() {
    settle_arm::main().expect("two poses at rest");
    let z_m = |payload_kg| {
        let seen = settle_arm::at_rest([0.0; 6], payload_kg).expect("a pose at rest");
        seen.base_from_tip.translation.z
    };
    let sag_m = z_m(0.0) - z_m(0.2);
    assert!((1e-4..2e-3).contains(&sag_m), "{sag_m}");
}

#[test]
fn the_networks_find_the_tip_of_the_model_that_they_learned() {
    estimate_pose::main().expect("a pose");
    let (pose, estimate, sd_m) = estimate_pose::estimated([10e3; 6]).expect("a pose");
    let off_m = (pose.translation.vector - estimate.translation.vector).norm();
    println!("{:.3} mm off, standard deviations {sd_m:?} m", off_m * 1e3);
    assert!(off_m < 2e-3, "{off_m}");
    assert!(sd_m.iter().all(|sd| (1e-4..0.01).contains(sd)), "{sd_m:?}");
}

#[test]
fn the_loop_brings_the_true_tip_to_its_goal() {
    closed_loop::main().expect("the goal of the example");
    let left_m = closed_loop::go([-0.03, 0.05, -0.31], 30.0).expect("another goal");
    assert!(left_m < 0.003, "{left_m}");
    let refused = closed_loop::go([0.0, 0.0, -0.6], 5.0);
    assert!(refused.is_err(), "{refused:?} mm from a point beyond reach");
}

#[test]
fn eleven_springs_are_fitted_and_the_loose_one_is_refused() {
    fit_springs::main().expect("a bench log");
    let (calibration, verdicts) = fit_springs::fitted(&[3]).expect("a bench log");
    assert_eq!((calibration.springs.len(), verdicts.len()), (11, 12));
    let refused: Vec<usize> = verdicts
        .iter()
        .filter(|(_, v)| v.is_err())
        .map(|(id, _)| *id)
        .collect();
    assert_eq!(refused, [3]);
}

/// Mean distance between predicted and captured tip by the example, m, and over how many instants.
#[cfg(all(unix, feature = "rrd"))]
pub fn recording_error_m(file: &Path) -> (f64, usize) {
    read_recording::mean_error_m(file).expect("a recording")
}

#[test]
#[cfg(feature = "rrd")]
fn a_recording_tells_its_error() {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("recordings/point-to-point.rrd");
    let (mean_m, n) = read_recording::mean_error_m(&file).expect("a sample recording");
    assert!(
        n > 500 && (1e-5..2e-3).contains(&mean_m),
        "{mean_m} over {n}"
    );
}

/// An effect that is not in the program's table is named once it is in the one that is given.
#[test]
fn an_effect_that_is_added_to_the_table_is_found() {
    let f = new_effect::found(&new_effect::extended()).expect("a finding");
    assert_eq!(f.verdict, springtwin::gap::Verdict::Named, "{f:?}");
    let [effect] = &f.effects[..] else {
        panic!("{:?}", f.effects);
    };
    assert_eq!(
        (effect.id.as_str(), effect.target),
        ("spring-dead-band", Some(4))
    );
    let [low_m, high_m] = effect.params["play"].ci95.expect("an interval");
    assert!(low_m < 4e-3 && 4e-3 < high_m, "{low_m} to {high_m}");
    assert!(f.gap.closed > 0.5, "{:?}", f.gap);
}
