//! The virtual rig's bench, on which a linear motor draws the springs.

use anyhow::Result;
use rand::SeedableRng as _;
use rand_pcg::Pcg64Mcg;

use crate::rig::circuit::{self, BenchPlan};
use crate::rig::{Unit, circuit_of};
use crate::robot::RobotSpec;
use crate::sensing::bench::{BenchLog, parse_bench};
use crate::signal::SPRINGS;

/// One run of the virtual rig's bench.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BenchRequest {
    /// Springs to draw, 0-based.
    pub springs: Vec<usize>,
    /// Spring (0-based) whose plug sits loose; `None`: none.
    pub loose: Option<usize>,
    /// Seed of the noise: another one for every run.
    pub seed: u64,
}

/// State of the virtual rig's bench between two runs.
#[derive(Clone, Debug)]
pub struct PracticeBench {
    /// Spring (0-based) whose plug sits loose until it is drawn again by itself; `None`: none.
    pub loose: Option<usize>,
    runs: u64,
}

impl Default for PracticeBench {
    fn default() -> Self {
        Self::with_loose(Some(6))
    }
}

impl PracticeBench {
    /// A bench on which the plug of spring `loose` (0-based; `None`: of no spring) sits loose.
    pub fn with_loose(loose: Option<usize>) -> Self {
        Self { loose, runs: 0 }
    }

    fn request(&mut self, springs: Vec<usize>) -> BenchRequest {
        self.runs += 1;
        BenchRequest {
            springs,
            loose: self.loose,
            seed: self.runs,
        }
    }

    /// The run that draws all springs.
    pub fn draw_all(&mut self) -> BenchRequest {
        self.request((0..SPRINGS).collect())
    }

    /// The run that draws `springs` (0-based) again; a loose plug among them is pressed home first.
    pub fn redraw(&mut self, springs: Vec<usize>) -> BenchRequest {
        self.loose = self.loose.filter(|i| !springs.contains(i));
        self.request(springs)
    }
}

/// Draws the springs of `unit` up and down and returns the log of those requested. Simulated.
///
/// # Errors
/// When the log cannot be parsed.
pub fn draw(robot: &RobotSpec, unit: Unit, request: &BenchRequest) -> Result<BenchLog> {
    let mut circuit = circuit_of(robot, unit);
    let plan = BenchPlan {
        loose: request.loose.into_iter().collect(),
        ..BenchPlan::for_robot(robot)
    };
    let mut rng = Pcg64Mcg::seed_from_u64(request.seed ^ 0xbe_7c4);
    let mut log = parse_bench(&circuit::bench(&mut circuit, &plan, &mut rng))?;
    log.springs
        .retain(|(number, _)| request.springs.contains(&(number - 1)));
    Ok(log)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sensing::bench::fit;

    #[test]
    fn a_loose_plug_is_refused_and_a_redo_draws_that_spring_alone() {
        let robot = RobotSpec::reference();
        let draw = |request| draw(&robot, Unit::default(), &request).expect("draws");
        let mut bench = PracticeBench::default();
        let first = draw(bench.draw_all());
        let verdict = |log: &BenchLog, number: usize| {
            let (_, points) = log.springs.iter().find(|s| s.0 == number).expect("drawn");
            fit(points, log.quantity, robot.spring.range_m).is_ok()
        };
        let passed: Vec<usize> = (1..=12).filter(|n| verdict(&first, *n)).collect();
        assert_eq!(passed, [1, 2, 3, 4, 5, 6, 8, 9, 10, 11, 12]);
        let again = draw(bench.redraw(vec![6]));
        assert_eq!(again.springs.len(), 1);
        assert!(verdict(&again, 7));
    }
}
