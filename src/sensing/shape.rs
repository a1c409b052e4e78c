//! The arm's shape from what springs and IMUs read at one instant: for recordings that keep no shape.

use nalgebra::{UnitQuaternion, Vector3};

use super::platform::{Known, LEGS, Segment, pads, solve};
use crate::robot::RobotSpec;
use crate::signal::{ArmShape, IMUS, Pose, SPRINGS, SensorFrame};

/// Cross-sections that a segment is drawn with, first and last included.
const SECTIONS: usize = 13;
/// Lengths that no pose fits better than this (root mean square, m) give no shape.
const RESIDUAL_MAX_M: f64 = 0.02;

/// The shape by usable springs and IMUs; `None` where they do not fix both segments. Pads are where springs and
/// IMUs have them; between two pads the backbone is the cubic that leaves and meets them at right angles.
pub fn shape_by_sensors(robot: &RobotSpec, frame: &SensorFrame) -> Option<ArmShape> {
    let turned = [pad_by_imus(frame, 0), pad_by_imus(frame, 1)];
    let between = [
        turned[0],
        turned[0]
            .zip(turned[1])
            .map(|(middle, end)| middle.inverse() * end),
    ];
    let mut upper_from_lower = [Pose::identity(); 2];
    for k in 0..2 {
        upper_from_lower[k] = segment_pose(&Segment::of(robot, k), frame, k, between[k])?;
    }
    Some(shape_by_pads(robot, pads(robot, &upper_from_lower)))
}

/// The shape of an arm whose middle and end pads (base from pad) stand there: springs between them, and backbones as in
/// [`shape_by_sensors`].
pub fn shape_by_pads(robot: &RobotSpec, [middle, end]: [Pose; 2]) -> ArmShape {
    let below = Pose::translation(0.0, 0.0, -robot.pad_thickness_m);
    let upper = [Pose::identity(), middle * below];
    let lower = [middle, end];
    let mut spring_ends_m = [[[0.0; 3]; 2]; SPRINGS];
    let springs = spring_ends_m.iter_mut().enumerate();
    for (i, ends) in springs.filter(|_| robot.has_springs) {
        let k = i / LEGS;
        let top = upper[k] * nalgebra::Point3::from(robot.spring_top_m[i]);
        let bottom = lower[k] * nalgebra::Point3::from(robot.spring_bottom_m[i]);
        *ends = [top.coords.into(), bottom.coords.into()];
    }
    ArmShape {
        base_from_section: std::array::from_fn(|k| backbone(&upper[k], &lower[k])),
        base_from_pad: [Pose::identity(), middle, end],
        spring_ends_m,
    }
}

/// Base from middle (0) or end pad (1) by the IMUs there that may be used.
fn pad_by_imus(frame: &SensorFrame, pad: usize) -> Option<UnitQuaternion<f64>> {
    let on_pad = (0..IMUS).filter(|i| i / 2 == pad && frame.health.imus[*i].usable());
    let rotation = |i| UnitQuaternion::from_rotation_matrix(&frame.sensors.base_from_imu_pad(i));
    on_pad.map(rotation).reduce(|a, b| a.slerp(&b, 0.5))
}

fn segment_pose(
    segment: &Segment,
    frame: &SensorFrame,
    k: usize,
    turned: Option<UnitQuaternion<f64>>,
) -> Option<Pose> {
    let length_m: [Option<f64>; LEGS] = std::array::from_fn(|i| {
        let i = LEGS * k + i;
        let known = frame.health.springs[i].usable();
        known.then(|| frame.sensors.spring_m[i])
    });
    let legs = length_m.iter().flatten().count();
    // With all six lengths the IMUs only give the initial guess.
    let known = Known {
        length_m,
        upper_from_lower: turned.filter(|_| legs < LEGS),
    };
    if legs < LEGS && (legs < 3 || turned.is_none()) {
        return None;
    }
    let start = turned.map_or_else(
        || segment.rest(),
        |r| {
            let half = UnitQuaternion::identity().slerp(&r, 0.5);
            let down = half * Vector3::new(0.0, 0.0, -segment.rest_m);
            Pose::from_parts(down.into(), r)
        },
    );
    let found = solve(segment, &known, &start);
    let below = found.upper_from_lower.translation.vector.z < 0.0;
    (found.converged && below && found.residual_m < RESIDUAL_MAX_M)
        .then_some(found.upper_from_lower)
}

/// Cross-sections from one face to the next: their centres on a cubic, their rotations in equal steps.
fn backbone(from: &Pose, to: &Pose) -> Vec<Pose> {
    let (p, q) = (from.translation.vector, to.translation.vector);
    let reach_m = (q - p).norm();
    let (out, into) = (
        from.rotation * Vector3::new(0.0, 0.0, -reach_m),
        to.rotation * Vector3::new(0.0, 0.0, -reach_m),
    );
    (0..SECTIONS)
        .map(|i| {
            let u = i as f64 / (SECTIONS - 1) as f64;
            let (u2, u3) = (u * u, u * u * u);
            // Hermite's cubic.
            let at = p * (2.0 * u3 - 3.0 * u2 + 1.0)
                + out * (u3 - 2.0 * u2 + u)
                + q * (3.0 * u2 - 2.0 * u3)
                + into * (u3 - u2);
            Pose::from_parts(at.into(), from.rotation.slerp(&to.rotation, u))
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::signal::{ChannelHealth, Health, Quality, SIGNALS, SensorVec, Stamp};
    use crate::sim::{Inputs, Model, State, observe, settle};

    fn frame(sensors: SensorVec, chamber_pa: [f64; 6]) -> SensorFrame {
        SensorFrame {
            stamp: Stamp::ZERO,
            extra_sigma: [0.0; SIGNALS],
            delivered: Default::default(),
            sensors,
            chamber_pa,
            health: Health::default(),
            quality: Quality::default(),
        }
    }

    /// The arm by the rod model, and what its sensors read.
    fn settled(chamber_pa: [f64; 6]) -> (ArmShape, SensorFrame) {
        let robot = RobotSpec::reference();
        let model = Model::nominal(&robot);
        let mut state = State::rest(&model);
        let inputs = Inputs {
            chamber_pa,
            ..Inputs::default()
        };
        settle(&model, &mut state, &inputs).expect("settles");
        let seen = observe(&model, &state);
        let frame = frame(seen.sensors, chamber_pa);
        (seen.shape, frame)
    }

    #[test]
    fn springs_and_imus_give_the_shape_that_they_were_read_on() {
        let robot = RobotSpec::reference();
        let (rod, mut frame) = settled([30e3, -20e3, -10e3, -25e3, 30e3, 0.0]);
        let near = |shape: &ArmShape, most_m: f64| {
            for (a, b) in shape.base_from_pad.iter().zip(&rod.base_from_pad) {
                let off = a.translation.vector - b.translation.vector;
                assert!(off.norm() < 1e-4, "{off}");
            }
            for (a, b) in shape.base_from_section.iter().zip(&rod.base_from_section) {
                let middle = |s: &[Pose]| s[s.len() / 2].translation.vector;
                let off = middle(a) - middle(b);
                assert!(off.norm() < most_m, "{off}");
                assert!(a.len() == SECTIONS);
            }
        };
        let tip = rod.base_from_pad[2].translation.vector;
        assert!(tip.x.hypot(tip.y) > 0.02, "it bends: {tip}");
        near(&shape_by_sensors(&robot, &frame).expect("all there"), 3e-3);
        // A spring that is out is made up for by the IMUs.
        frame.health.springs[4] = ChannelHealth::Missing;
        frame.sensors.spring_m[4] = 0.3;
        near(&shape_by_sensors(&robot, &frame).expect("enough"), 3e-3);
        frame.health.imus[0] = ChannelHealth::Missing;
        frame.health.imus[1] = ChannelHealth::Missing;
        assert_eq!(shape_by_sensors(&robot, &frame), None, "not fixed");
    }

    #[test]
    fn lengths_that_no_arm_has_give_no_shape() {
        let robot = RobotSpec::reference();
        let none = SensorVec {
            spring_m: [0.0; SPRINGS],
            imu_ypr_rad: [[0.0; 3]; IMUS],
        };
        let mut frame = frame(none, [0.0; 6]);
        assert_eq!(shape_by_sensors(&robot, &frame), None);
        for (i, length_m) in frame.sensors.spring_m.iter_mut().enumerate() {
            *length_m = if i % 2 == 0 { 0.05 } else { 0.6 };
        }
        assert_eq!(shape_by_sensors(&robot, &frame), None);
    }
}
