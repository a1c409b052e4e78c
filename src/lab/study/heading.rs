//! Headings over half an hour: gyros that drift by degrees a minute, helped by the springs.

use anyhow::Result;
use nalgebra::UnitQuaternion;

use super::item::{Field, Found, Study, each};
use crate::lab::motions::{Motion, Push, motion};
use crate::lab::table::{Drawn, Table};
use crate::rig::inertial::InertialErrors;
use crate::robot::RobotSpec;
use crate::sensing::imu::heading_between;
use crate::signal::IMUS;

/// Length of the motion, s, and the speed of the tip, m/s.
const SECONDS: f64 = 1800.0;
const SPEED_M_S: f64 = 5e-3;
const SEED: u64 = 301;

/// The study; its one item is the one motion.
pub const HEADING: Study = Study {
    name: "heading",
    about: "Half an hour of drifting gyros: headings with the springs' help",
    field: Field::Sensing,
    items: |_| 1,
    find: |setup, items| each(&*setup.progress.clone(), items, |_| find(&setup.robot)),
    table: heading,
};

fn find(robot: &RobotSpec) -> Result<Found> {
    let m = Motion {
        payload_kg: 0.0,
        speed_m_s: SPEED_M_S,
        push: Push::None,
        seconds: SECONDS,
        seed: SEED,
    };
    let moments = motion(robot, &m, &mut |_, _| ())?;
    let mut worst = [[0.0f64; 2]; IMUS];
    let mut squares = [[0.0f64; 2]; IMUS];
    for moment in &moments {
        for i in 0..IMUS {
            let said = moment.frame.sensors.base_from_imu_pad(i);
            let said = UnitQuaternion::from_rotation_matrix(&said);
            let truth = moment.base_from_pad[1 + i / 2].rotation;
            let off = [
                heading_between(&truth, &said).abs().to_degrees(),
                truth.angle_to(&said).to_degrees(),
            ];
            for k in 0..2 {
                worst[i][k] = worst[i][k].max(off[k]);
                squares[i][k] += off[k] * off[k];
            }
        }
    }
    let mut found = Found::default();
    let n = moments.len() as f64;
    for i in 0..IMUS {
        let rms = squares[i].map(|s| (s / n).sqrt());
        found.add(
            format!("IMU {}", i + 1),
            vec![
                Some(worst[i][0]),
                Some(rms[0]),
                Some(worst[i][1]),
                Some(rms[1]),
            ],
        );
    }
    let bias_deg_s = InertialErrors::default().gyro_bias_rad_s.to_degrees();
    found.notes.push(format!(
        "{:.0} s of motion at 5 mm/s, {} frames scored. Every gyro has a bias of {bias_deg_s} deg/s about its axes, which \
         walks: some {:.0} deg of heading over the motion without help. The filter has no magnetometer; the springs' pad \
         yaw corrects the heading.",
        moments.last().map_or(0.0, |m| m.t_s),
        moments.len(),
        bias_deg_s * SECONDS
    ));
    Ok(found)
}

fn heading(found: Vec<Found>) -> Table {
    let mut t = Table::new(
        "heading",
        "Headings over half an hour of drifting gyros",
        &[
            "worst heading error, deg",
            "RMS heading error, deg",
            "worst error of the whole orientation, deg",
            "RMS of the whole, deg",
        ],
        Drawn::Bars,
    );
    t.take(found);
    t
}
