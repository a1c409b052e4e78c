//! A smooth stand-in for a simulator: two segments of constant curvature, for tests only.

use nalgebra::{Translation3, UnitQuaternion, Vector3};
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;

use crate::robot::{PadId, RobotSpec};
use crate::signal::{CHAMBERS, Dataset, Pose, SPRINGS, Sample, SensorVec, ypr_from_rotation};

/// Samples at pressures drawn uniformly within the limits, payload within 0 and 0.5 kg.
pub fn dataset(samples: usize, seed: u64) -> Dataset {
    let robot = RobotSpec::reference();
    let mut rng = Pcg64Mcg::seed_from_u64(seed);
    let limits = &robot.pressure;
    let draw = |_| {
        let chamber_pa = std::array::from_fn(|_| rng.random_range(limits.min_pa..limits.max_pa));
        sample(&robot, chamber_pa, rng.random_range(0.0..0.5))
    };
    Dataset {
        samples: (0..samples).map(draw).collect(),
        source: "constant curvature".to_owned(),
        seed,
        robot_hash: robot.hash.clone(),
        row_s: None,
        shard: None,
    }
}

/// The arm at these pressures; the payload stretches and the tilt sags with it.
pub fn sample(robot: &RobotSpec, chamber_pa: [f64; CHAMBERS], payload_kg: f64) -> Sample {
    let length = |i: usize| {
        let stretch = chamber_pa[i] * robot.area_m2[i] / robot.axial_stiffness_n_m[i];
        robot.rest_length_m + stretch + 0.004 * payload_kg
    };
    let segment = |s: usize| {
        let lengths: [f64; 3] = std::array::from_fn(|i| length(3 * s + i));
        let mean = lengths.iter().sum::<f64>() / 3.0;
        let radius = robot.bellows_m[3 * s].norm();
        // Lᵢ = l − r θ cos(φ − φᵢ), so θ (cos φ, sin φ) = −2/(3r) Σ Lᵢ (cos φᵢ, sin φᵢ)
        let mut bend = Vector3::zeros();
        for (i, l) in lengths.iter().enumerate() {
            bend -= robot.bellows_m[3 * s + i] * (2.0 / (3.0 * radius * radius) * l);
        }
        // The segment's own bending stiffness takes about half of the free bend.
        arc(mean, bend * (0.5 - 0.05 * payload_kg))
    };
    let pad = Pose::translation(0.0, 0.0, -robot.pad_thickness_m);
    let (upper, lower) = (segment(0), segment(1));
    let base_from_middle = upper;
    let base_from_tip = base_from_middle * pad * lower;
    let spring = |i: usize| {
        let relative = if i < SPRINGS / 2 { &upper } else { &lower };
        let bottom = relative.transform_point(&robot.spring_bottom_m[i].into());
        (bottom.coords - robot.spring_top_m[i]).norm()
    };
    let imu = |i: usize| {
        let rotation = match robot.imus[i].pad {
            PadId::Middle => base_from_middle.rotation,
            PadId::End => base_from_tip.rotation,
        };
        ypr_from_rotation(&rotation)
    };
    Sample {
        chamber_pa,
        payload_kg,
        tip_force_n: [0.0; 3],
        off_nominal: false,
        sensors: SensorVec {
            spring_m: std::array::from_fn(spring),
            imu_ypr_rad: std::array::from_fn(imu),
        },
        base_from_tip,
    }
}

/// A circular arc hanging along −z: length in m, bend = angle times the direction it bends to, rad.
fn arc(length_m: f64, bend: Vector3<f64>) -> Pose {
    let angle = bend.norm();
    let direction = if angle > 1e-9 {
        bend / angle
    } else {
        Vector3::x()
    };
    // (1 − cos θ)/θ and sin θ/θ, by series near 0.
    let (side, down) = if angle > 1e-4 {
        ((1.0 - angle.cos()) / angle, angle.sin() / angle)
    } else {
        (0.5 * angle, 1.0 - angle * angle / 6.0)
    };
    let tip = (direction * side - Vector3::z() * down) * length_m;
    // −z turns towards the direction.
    let axis = (-Vector3::z()).cross(&direction);
    Pose::from_parts(
        Translation3::from(tip),
        UnitQuaternion::from_scaled_axis(axis * angle),
    )
}

#[test]
fn the_arc_bends_away_from_the_longer_bellows() {
    let robot = RobotSpec::reference();
    let rest = sample(&robot, [0.0; CHAMBERS], 0.0);
    let z = -(2.0 * robot.rest_length_m + robot.pad_thickness_m);
    assert!((rest.base_from_tip.translation.vector - Vector3::z() * z).norm() < 1e-12);
    assert!((rest.sensors.spring_m[7] - 0.153_80).abs() < 1e-4);
    // Chamber 1 at +x longer: the tip goes to −x, as robot.md's model has it.
    let bent = sample(&robot, [20e3, -20e3, -20e3, 0.0, 0.0, 0.0], 0.0);
    assert!(bent.base_from_tip.translation.x < -0.05);
    assert!(bent.base_from_tip.rotation.angle() > 0.2);
}
