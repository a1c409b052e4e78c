//! Trained networks: what is taken answers, and its writer's bytes are taken again.
#![no_main]

use libfuzzer_sys::fuzz_target;
use nalgebra::SVector;
use springtwin::learn::{Model, PlantMap, PoseMap};

fuzz_target!(|data: &[u8]| {
    let Ok(model) = Model::from_bytes(data) else {
        return;
    };
    let _ = model.cascade.pose(&SVector::repeat(0.1));
    let _ = model.plant.sensors(&[1e3; 6], 0.1);
    let bytes = model.to_bytes().expect("writes");
    let again = Model::from_bytes(&bytes).unwrap_or_else(|e| panic!("{e}"));
    assert_eq!(again.plant.bounds(), model.plant.bounds());
});
