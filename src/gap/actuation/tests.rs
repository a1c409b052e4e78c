//! The pumps and chambers of the virtual rig are other mathematics than the effects that are to be found in them.

use std::sync::OnceLock;

use super::*;
use crate::gap::{Finding, Unwatched, Verdict};
use crate::lab::session::{Excitation, SessionPlan, session};
use crate::rig::hidden::Hidden;
use crate::robot::RobotSpec;
use crate::signal::CHAMBERS;
use crate::sim::effects::{Active, table};

fn log(seed: u64, hidden: Vec<Hidden>) -> PressureLog {
    let plan = SessionPlan {
        seed,
        seconds: 60.0,
        rate_hz: 40.0,
        excitation: Excitation::Mixed,
        hidden,
        ..SessionPlan::default()
    };
    let s = session(&RobotSpec::reference(), &plan).unwrap();
    PressureLog {
        name: s.name,
        hash: String::new(),
        t_s: s.t_s,
        commanded_pa: s.commanded_pa,
        measured_pa: s.chamber_pa,
        ..PressureLog::default()
    }
}

fn found(hidden: Vec<Hidden>) -> Finding {
    let robot = RobotSpec::reference();
    static HEALTHY: OnceLock<PressureLog> = OnceLock::new();
    let healthy = HEALTHY.get_or_init(|| log(1, Vec::new())).clone();
    let healthy = PressureGrid::new(healthy).unwrap();
    let suspect = PressureGrid::new(log(2, hidden)).unwrap();
    actuation_only(&robot, &table(), Some(&healthy), &suspect, &[], &Unwatched)
        .unwrap()
        .finding
}

fn hidden(id: &str, target: Option<usize>, values: &[f64]) -> Vec<Hidden> {
    vec![Hidden::new(id, target, values).unwrap()]
}

fn names(f: &Finding) -> Vec<(&str, Option<usize>)> {
    f.effects
        .iter()
        .map(|e| (e.id.as_str(), e.target))
        .collect()
}

#[test]
fn a_healthy_supply_misses_nothing() {
    let f = found(Vec::new());
    assert_eq!(f.verdict, Verdict::NothingMissing, "{f:#?}");
}

/// A regulator that refills hides most of a leak: at rest it looks like a gauge that reads low.
#[test]
fn a_leak_is_found_in_its_chamber() {
    // More than the pump makes up for at the higher pressures.
    let f = found(hidden("leak", Some(3), &[0.15]));
    let told = [Verdict::Named, Verdict::Indistinguishable];
    assert!(
        told.contains(&f.verdict),
        "{:?} {:?}",
        f.verdict,
        f.candidates
    );
    assert!(names(&f).contains(&("leak", Some(4))), "{:?}", names(&f));
    assert!(
        f.effects.iter().all(|e| e.target == Some(4)),
        "{:?}",
        names(&f)
    );
    assert!(f.gap.closed > 0.6, "{:?}", f.gap);
}

#[test]
fn a_delay_is_found_in_all_chambers() {
    let f = found(hidden("pressure-delay", None, &[0.3]));
    // Ramps as slow as the pumps hardly tell a delay from a lag: it is in the set.
    assert!(
        names(&f).contains(&("pressure-delay", None)),
        "{:?}",
        f.candidates
    );
}

#[test]
fn a_flow_limit_is_found() {
    // About half of what the pumps of the reference robot give.
    let f = found(hidden("flow-limit", None, &[700.0, 700.0]));
    assert!(
        names(&f).contains(&("flow-limit", None)),
        "{:?}",
        f.candidates
    );
    assert!(f.gap.closed > 0.6, "{:?}", f.gap);
}

/// The regulator makes its gauge read what is commanded: only the arm shows that the pressure is another one.
#[test]
fn a_gauge_that_its_regulator_believes_is_not_seen_between_command_and_gauge() {
    let f = found(hidden("gauge-error", Some(1), &[1.08, 600.0]));
    assert_eq!(f.verdict, Verdict::NothingMissing, "{:?}", f.candidates);
}

/// A supply that sags by some hundred pascals while other chambers fill is within the regulators' own lag: nothing else
/// may be named for it.
#[test]
fn a_weak_supply_behind_slow_pumps_is_not_mistaken_for_something_else() {
    let f = found(hidden("supply-coupling", None, &[0.3, 1.0]));
    assert!(
        names(&f).iter().all(|n| *n == ("supply-coupling", None)),
        "{:?}",
        f.candidates
    );
}

/// Steps of two chambers (four are missing), unevenly sampled.
fn steps() -> PressureLog {
    let mut out = PressureLog {
        name: "steps".to_owned(),
        ..PressureLog::default()
    };
    let mut t_s = 0.0;
    for k in 0..1500_u32 {
        t_s += 0.01 + 0.04 * f64::from((k * 7919) % 13) / 12.0;
        let mut u = [f64::NAN; CHAMBERS];
        u[1] = if ((t_s / 5.0) as u32).is_multiple_of(2) {
            20e3
        } else {
            0.0
        };
        u[4] = if ((t_s / 3.7) as u32).is_multiple_of(3) {
            15e3
        } else {
            -5e3
        };
        out.t_s.push(t_s);
        out.commanded_pa.push(u);
        out.measured_pa.push(u);
    }
    out
}

#[test]
fn an_ideal_supply_leaves_nothing_over_however_it_is_sampled() {
    let grid = PressureGrid::new(steps()).unwrap();
    assert_eq!(grid.chambers(), [1, 4]);
    let robot = RobotSpec::reference();
    let ideal = [Regulator::default(); CHAMBERS];
    let p = gauge_pressures(&robot, &grid, &ideal, &[], Lag::BeforeGauge);
    assert!(line_rmse_pa(&grid, &line_rows(&grid, &p), |_| true) < 1e-9);
}

#[test]
fn lag_before_the_gauge_is_the_regulators_lag() {
    let grid = PressureGrid::new(steps()).unwrap();
    let robot = RobotSpec::reference();
    let slow = [Regulator([0.0, 0.4, 1.0, 0.0, 0.0, 0.0]); CHAMBERS];
    let ideal = [Regulator::default(); CHAMBERS];
    let lag = Active::new("pressure-lag", None, &[0.4, 0.0]).unwrap();
    let a = gauge_pressures(&robot, &grid, &slow, &[], Lag::BeforeGauge);
    let effects = std::slice::from_ref(&lag);
    let b = gauge_pressures(&robot, &grid, &ideal, effects, Lag::BeforeGauge);
    let behind = gauge_pressures(&robot, &grid, &ideal, effects, Lag::BehindGauge);
    for k in 0..grid.len() {
        assert!((a[k][1] - b[k][1]).abs() < 1e-6);
        assert!((behind[k][1] - grid.commanded_pa[k][1]).abs() < 1e-6);
    }
    assert!(line_rmse_pa(&grid, &line_rows(&grid, &a), |_| true) > 1e3);
}

#[test]
fn regulators_are_recovered() {
    let robot = RobotSpec::reference();
    let truth = [Regulator([0.04, 0.15, 1.03, 400.0, 0.0, 0.0]); CHAMBERS];
    let mut log = steps();
    let clean = PressureGrid::new(log.clone()).unwrap();
    let p = gauge_pressures(&robot, &clean, &truth, &[], Lag::BeforeGauge);
    // Back to the samples: each takes the value of its bin.
    for (t, row) in log.t_s.iter().zip(&mut log.measured_pa) {
        let bin = (((t - clean.log.t_s[0]) * LINE_HZ) as usize).min(clean.len() - 1);
        *row = p[bin];
    }
    let grid = PressureGrid::new(log).unwrap();
    let base = commission_supply(&robot, &grid, &[]).unwrap();
    for i in grid.chambers() {
        let r = base.regulators[i].0;
        assert!((r[0] + r[1] - 0.19).abs() < 0.03, "{r:?}");
        assert!(
            (r[2] - 1.03).abs() < 5e-3 && (r[3] - 400.0).abs() < 60.0,
            "{r:?}"
        );
    }
}

#[test]
fn what_cannot_be_judged_is_refused_or_said() {
    let mut none = steps();
    for row in &mut none.commanded_pa {
        *row = [f64::NAN; CHAMBERS];
    }
    let refusal = PressureGrid::new(none).unwrap_err().to_string();
    assert!(refusal.contains("u1_kpa"), "{refusal}");
    let mut rest = steps();
    for (u, p) in rest.commanded_pa.iter_mut().zip(&mut rest.measured_pa) {
        (*u, *p) = ([5e3; CHAMBERS], [5e3; CHAMBERS]);
    }
    let grid = PressureGrid::new(rest).unwrap();
    let a = actuation_only(
        &RobotSpec::reference(),
        &table(),
        None,
        &grid,
        &[],
        &Unwatched,
    )
    .unwrap();
    assert_eq!(a.finding.verdict, Verdict::NotExcited);
}
