//! Calibrates springs from the log of a bench. Here the virtual rig's bench writes it, with one loose contact.
//!
//! ```sh
//! cargo run --release --example fit_springs
//! ```

use std::error::Error;

use rand::SeedableRng as _;
use springtwin::rig::circuit::{BenchPlan, bench};
use springtwin::rig::{Unit, circuit_of};
use springtwin::robot::RobotSpec;
use springtwin::sensing::Calibration;
use springtwin::sensing::bench::{SpringVerdicts, calibrate, parse_bench};

/// A curve for every spring that deserves one, and a verdict on each. `loose`: springs (1 to 12) with a loose
/// contact.
///
/// # Errors
/// When the log is malformed, with its line and column.
pub fn fitted(loose: &[usize]) -> Result<(Calibration, SpringVerdicts), Box<dyn Error>> {
    let robot = RobotSpec::reference();
    let plan = BenchPlan {
        loose: loose.iter().map(|id| id - 1).collect(),
        ..BenchPlan::for_robot(&robot)
    };
    let mut circuit = circuit_of(&robot, Unit::default());
    let mut rng = rand_pcg::Pcg64Mcg::seed_from_u64(1);
    // With real springs this text is read from the bench's file.
    let csv = bench(&mut circuit, &plan, &mut rng);
    let log = parse_bench(&csv)?;
    Ok(calibrate(
        &log,
        "example",
        "not stated",
        robot.spring.range_m,
    ))
}

/// Prints the verdicts (simulated).
///
/// # Errors
/// As [`fitted`].
pub fn main() -> Result<(), Box<dyn Error>> {
    let (calibration, verdicts) = fitted(&[7])?;
    for (id, verdict) in &verdicts {
        match verdict {
            Ok(fit) => println!(
                "spring {id:2}: {:.3} mm off on points that were not fitted (simulated)",
                fit.held_out_rmse_m * 1e3
            ),
            Err(why) => println!("spring {id:2}: refused: {why}"),
        }
    }
    println!("{} springs calibrated", calibration.springs.len());
    Ok(())
}
