//! Tables of session logs: columns of one length, times that rise, values within their bounds.
#![no_main]

use std::path::Path;

use libfuzzer_sys::fuzz_target;
use springtwin::recording::{inspect_log, parse_log};

fuzz_target!(|data: &[u8]| {
    let log = match parse_log(data, Path::new("log.csv")) {
        Ok(log) => log,
        Err(e) => {
            let said = e.to_string();
            assert!(said.contains("line ") && said.contains("column "), "{said}");
            return;
        }
    };
    let n = log.t_s.len();
    assert_eq!(
        [log.chamber_pa.len(), log.sensors.len(), log.truth.len()],
        [n; 3]
    );
    assert!(log.commanded_pa.as_ref().is_none_or(|c| c.len() == n));
    assert!(log.payload_column_kg.as_ref().is_none_or(|c| c.len() == n));
    assert!(log.t_s.iter().all(|t| t.abs() <= 3.2e9));
    assert!(log.t_s.windows(2).all(|w| w[0] < w[1]));
    let within = |v: f64, bound: f64| v.is_nan() || v.abs() <= bound;
    assert!(log.chamber_pa.iter().flatten().all(|p| within(*p, 1e6)));
    assert!(
        log.sensors
            .iter()
            .flat_map(|s| s.spring_m)
            .all(|l| within(l, 10.0))
    );
    assert!(
        log.sensors
            .iter()
            .flat_map(|s| s.imu_ypr_rad)
            .flatten()
            .all(|a| within(a, 13.0))
    );
    let trace = log.to_trace();
    assert_eq!(trace.snapshots.len(), n);
    let frames = trace.snapshots.iter().filter_map(|s| s.sensors.as_ref());
    for f in frames {
        assert!(
            f.sensors
                .to_vector()
                .iter()
                .chain(&f.chamber_pa)
                .all(|v| v.is_finite())
        );
    }
    inspect_log(&log);
});
