//! temporary
use super::candidates::*;
use super::explain::*;
use super::problem::*;
use super::*;
/// temporary
pub fn probe(
    robot: &crate::robot::RobotSpec,
    grid: &Grid,
    baseline: &Baseline,
) -> Result<(), GapError> {
    let rep = Replayed::new(robot, grid, baseline)?;
    let p = rep.problem()?;
    let r0 = p.residual(&[])?;
    eprintln!(
        "raw mean square {:.3}  cleaned {:.3} channels {} corr {:.1}",
        r0.norm_squared() / p.len() as f64,
        super::fit::cost(&p, &r0) / p.len() as f64,
        baseline.noise.channels.len(),
        baseline.noise.correlation_rows()
    );
    if let Some(h) = &baseline.healthy {
        eprintln!("healthy ms {:.3}", h.norm_squared() / h.len() as f64);
    }
    let all = admitted(grid, |_| true);
    let t = std::time::SystemTime::now();
    let cols = columns(&p, &all, &|c| starts_in(c, grid), &[])?;
    eprintln!(
        "{} candidates {} columns in {:?}",
        all.len(),
        cols.len(),
        t.elapsed()
    );
    let t = std::time::SystemTime::now();
    let found = explain(&p, &all, &cols, None, &Unwatched)?;
    eprintln!("explain {:?}", t.elapsed());
    for e in &found[1..3.min(found.len())] {
        let (g, se) = found[0].losses.gain_over(&e.losses);
        eprintln!(
            "   margin over {} {:?}: {g:.1} ± {se:.1}",
            e.candidate.effect.id,
            e.candidate.target.map(|t| t + 1)
        );
    }
    for e in &found {
        eprintln!(
            "{:20} {:?} gain {:.1} ± {:.1} cost {:.3} at {:?} {:?}",
            e.candidate.effect.id,
            e.candidate.target.map(|t| t + 1),
            e.gain,
            e.se,
            e.fit.cost / p.len() as f64,
            e.fit.parameters(),
            e.fit.on_bound
        );
    }
    Ok(())
}
