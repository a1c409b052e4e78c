//! Datagrams of the motion capture's object stream: what is taken is near, finite, and survives its writer.
#![no_main]

use libfuzzer_sys::fuzz_target;
use springtwin::link::wire::objects::{encode, parse};

fuzz_target!(|data: &[u8]| {
    let Ok(frame) = parse(data) else { return };
    for o in &frame.objects {
        let p = &o.world_from_object;
        assert!(p.translation.vector.amax() < 100.0, "{p}");
        assert!((p.rotation.quaternion().norm() - 1.0).abs() < 1e-9, "{p}");
    }
    let again = parse(&encode(&frame)).expect("own bytes");
    assert_eq!(
        (again.frame, again.objects.len()),
        (frame.frame, frame.objects.len())
    );
    for (a, b) in again.objects.iter().zip(&frame.objects) {
        let d = a.world_from_object.inverse() * b.world_from_object;
        assert!(
            d.translation.vector.norm() < 1e-9 && d.rotation.angle() < 1e-6,
            "{d}"
        );
    }
});
