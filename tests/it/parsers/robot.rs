//! What every robot file that is taken keeps, with the patches in it.

use springtwin::robot::{RobotSpec, without_last_patch};
use springtwin::sim::patch::Correction;

/// Reads `text`: what is refused gets one sentence, what is taken is finite, in range and in order.
pub fn check(text: &str) {
    let robot = match RobotSpec::from_toml(text) {
        Ok(robot) => robot,
        Err(e) => {
            let said = e.to_string();
            assert!(!said.is_empty() && !said.contains('\n'), "{said}");
            return;
        }
    };
    let places = robot
        .bellows_m
        .iter()
        .chain(&robot.spring_top_m)
        .chain(&robot.spring_bottom_m);
    assert!(places.flat_map(|p| p.iter()).all(|x| x.is_finite()));
    let p = &robot.pressure;
    assert!(
        p.min_pa < p.max_pa && p.min_pa >= -40e3 && p.max_pa <= 40e3,
        "{p:?}"
    );
    assert!(robot.over_pressure_pa.is_finite() && p.rate_pa_s > 0.0);
    for [low, high] in [robot.spring.range_m, robot.length_range_m] {
        assert!(
            low < high && low.is_finite() && high.is_finite(),
            "{low} {high}"
        );
    }
    assert!(robot.area_m2.iter().all(|a| *a > 0.0 && a.is_finite()));
    for m in &robot.imus {
        assert!(m.pad_from_imu.matrix().iter().all(|x| x.is_finite()));
    }
    let corrects = Correction::of(&robot).is_ok();
    assert_eq!(
        without_last_patch(text).is_ok(),
        !robot.patches.is_empty(),
        "{corrects}"
    );
}
