//! Registration files: what is taken is finite, and its writer's text is taken again.
#![no_main]

use libfuzzer_sys::fuzz_target;
use springtwin::sensing::registration::Registration;

fuzz_target!(|data: &[u8]| {
    let Ok(text) = std::str::from_utf8(data) else {
        return;
    };
    let Ok(registration) = Registration::from_toml(text) else {
        return;
    };
    for placed in [registration.base_from_world, registration.object_from_tip] {
        assert!(placed.pose.translation.vector.iter().all(|x| x.is_finite()));
        assert!((placed.pose.rotation.quaternion().norm() - 1.0).abs() < 1e-9);
    }
    assert!(registration.robot_time_s(0.0).is_none_or(f64::is_finite));
    let written = registration
        .to_toml()
        .unwrap_or_else(|e| panic!("{e}\n{text}"));
    Registration::from_toml(&written).unwrap_or_else(|e| panic!("{e}\n{written}"));
});
