//! Calibration files: what is taken is monotone and finite, and its writer's text is taken again.
#![no_main]

use libfuzzer_sys::fuzz_target;
use springtwin::sensing::Calibration;

fuzz_target!(|data: &[u8]| {
    let Ok(text) = std::str::from_utf8(data) else {
        return;
    };
    let Ok(calibration) = Calibration::from_toml(text) else {
        return;
    };
    for s in &calibration.springs {
        assert!((1..=12).contains(&s.spring));
        assert!(s.capacitance_f.is_finite() && s.compensation_h.is_finite());
        assert!(s.curve.is_monotone());
        let [low, high] = s.curve.domain;
        for reading in [low, 0.5 * low + 0.5 * high, high] {
            let length_m = s.curve.length_m(reading);
            assert!(
                length_m.is_none_or(f64::is_finite),
                "{reading} {length_m:?}"
            );
        }
    }
    for m in &calibration.imus {
        assert!((1..=4).contains(&m.imu) && m.fit.correction_rad.norm().is_finite());
    }
    let written = calibration.to_toml().expect("writes");
    Calibration::from_toml(&written).unwrap_or_else(|e| panic!("{e}\n{written}"));
});
