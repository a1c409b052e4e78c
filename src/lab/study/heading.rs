//! Headings over half an hour: gyros that drift by degrees a minute, helped by the springs.

use anyhow::Result;
use nalgebra::UnitQuaternion;

use super::item::{Found, Study};
use super::setup::{Run, Setup, all, simulated_s};
use crate::lab::motions::Motion;
use crate::lab::table::{Drawn, Table};
use crate::lab::units::{TEST, side_by_side};
use crate::rig::inertial::InertialErrors;
use crate::sensing::imu::heading_between;
use crate::signal::IMUS;

/// Length of the motion of each unit, s.
const SECONDS: f64 = 1800.0;
const SEED: u64 = 301;

/// The study; its one item are the motions of the test units.
pub const HEADING: Study = Study {
    name: "heading",
    about: "Half an hour of drifting gyros: headings with the springs' help",
    items: |_| 1,
    find: |setup, _| {
        let found = find(setup)?;
        setup.progress.item_done();
        Ok(vec![found])
    },
    table: heading,
};

fn find(setup: &mut Setup) -> Result<Found> {
    let labs = setup.labs(&TEST)?;
    let robot = &setup.robot;
    let runs = side_by_side(&labs, |lab| {
        Run::new(
            robot,
            lab,
            &Motion::of(lab.unit, SECONDS, SEED),
            &mut |_, _| (),
        )
    })?;
    let moments: Vec<_> = all(&runs).collect();
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
    let mut found = Found::default().after(simulated_s(&runs));
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
    let bias_deg_s = InertialErrors::zeroed().gyro_bias_rad_s.to_degrees();
    found.notes.push(format!(
        "{SECONDS:.0} s of motion at 5 mm/s of each test unit, {} frames scored; worst and RMS over all units. Every gyro has a bias of {bias_deg_s} deg/s about its axes, which \
         walks: some {:.0} deg of heading over the motion without help. The filter has no magnetometer; the springs' pad \
         yaw corrects the heading.",
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
