//! Closed loop on the toy arm: 5 % wrong gains, a constant disturbance, an undeclared payload,
//! pumps with lag and limited flow.

use super::*;
use crate::control::gains::InitialGuess;
use crate::control::reach::{ReachConfig, StartSample, reach};
use crate::control::residual::SignalSigma;
use crate::control::toy::{ToyArm, pump_step};
use crate::learn::{PlantMap, PoseMap};
use crate::signal::{ChannelHealth, Gripper, OrientationGoal, ReachState, SIGNALS, SPRINGS};
use nalgebra::SMatrix;
use proptest::prelude::*;
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64;

const DT_S: f64 = 0.05;

struct Loop {
    robot: RobotSpec,
    nominal: ToyArm,
    real: ToyArm,
    chamber_pa: [f64; CHAMBERS],
    payload_kg: f64,
    command: Option<PressureCommand>,
    now: Stamp,
    samples: Vec<StartSample>,
    /// What the pose map's Jacobian is multiplied by.
    steepness: f64,
}

impl Loop {
    fn new() -> Self {
        let robot = RobotSpec::reference();
        let arm = ToyArm::nominal(&robot);
        let mut rng = Pcg64::seed_from_u64(17);
        let mut sample = || {
            let q = std::array::from_fn(|_| rng.random_range(-40e3..40e3));
            StartSample::predicted(q, 0.0, (&arm, &arm))
        };
        Self {
            samples: (0..2000).map(|_| sample()).collect(),
            nominal: ToyArm::nominal(&robot),
            real: ToyArm::mismatched(&robot),
            robot,
            chamber_pa: [0.0; CHAMBERS],
            payload_kg: 0.2,
            command: None,
            now: Stamp::ZERO,
            steepness: 1.0,
        }
    }

    fn verdict(&self, goal: &Goal) -> Reach {
        let samples: [StartSample; 0] = [];
        let config = ReachConfig::default();
        reach(
            goal,
            &self.robot,
            &self.nominal,
            &self.nominal,
            0.0,
            &samples,
            &config,
        )
        .unwrap()
    }

    fn tick(&mut self, controller: &mut Controller) -> ControlOut {
        let frame = self.real.frame(self.now, self.chamber_pa, self.payload_kg);
        self.tick_with(controller, frame)
    }

    /// One tick with checks that the wish needs no further limiting.
    fn tick_with(&mut self, controller: &mut Controller, frame: SensorFrame) -> ControlOut {
        let mut eval = self.nominal.pose(&frame.sensors.to_vector());
        eval.jacobian *= self.steepness;
        let maps = Maps {
            pose: &self.nominal,
            plant: &self.nominal,
            samples: &self.samples,
        };
        let input = StepInput {
            frame: &frame,
            eval: &eval,
            payload_kg: 0.0,
            previous: self.command.as_ref(),
            stamp: self.now,
        };
        let out = controller.step(maps, &input);
        let limits = &self.robot.pressure;
        let command = PressureCommand::limited(
            self.now,
            out.wanted_pa,
            Gripper::Open,
            self.command.as_ref(),
            &frame.chamber_pa,
            limits,
        );
        for i in 0..CHAMBERS {
            let p = out.wanted_pa[i];
            assert!(p >= limits.min_pa && p <= limits.max_pa, "chamber {i}: {p}");
            let cut = (command.chamber_pa()[i] - p).abs();
            assert!(cut < 1e-6, "chamber {i} broke the rate limit by {cut} Pa");
        }
        pump_step(&mut self.chamber_pa, command.chamber_pa(), DT_S);
        self.command = Some(command);
        self.now = self.now.plus(DT_S);
        out
    }

    fn run(&mut self, controller: &mut Controller, seconds: f64) -> ControlOut {
        let n = (seconds / DT_S) as usize;
        for _ in 1..n {
            self.tick(controller);
        }
        self.tick(controller)
    }
}

/// Without an initial guess.
fn blind(kind: ControllerKind) -> Gains {
    Gains {
        guess: InitialGuess::Present,
        ..Gains::of(kind)
    }
}

fn check_reaches(kind: ControllerKind) {
    for position_m in [
        [0.06, 0.04, -0.30],
        [-0.05, 0.02, -0.27],
        [0.01, -0.08, -0.33],
    ] {
        let mut sim = Loop::new();
        let goal = Goal::position(position_m);
        let verdict = sim.verdict(&goal);
        assert_eq!(verdict.state, ReachState::Reachable);
        let mut controller = Controller::new(&sim.robot, Gains::of(kind));
        controller.set_goal(goal, Some(&verdict));
        sim.run(&mut controller, 40.0);
        // It must get there and stay.
        for _ in 0..40 {
            let out = sim.tick(&mut controller);
            let distance_m = out.distance_m.unwrap();
            assert!(
                distance_m <= 0.5e-3,
                "{kind:?} {position_m:?}: {distance_m} m"
            );
            assert!(out.done && out.stall.is_none());
        }
    }
}

#[test]
fn paper_adrc_reaches_three_targets_with_a_wrong_model_and_load() {
    check_reaches(ControllerKind::PaperAdrc);
}

#[test]
fn null_space_qp_reaches_three_targets_with_a_wrong_model_and_load() {
    check_reaches(ControllerKind::NullSpaceQp);
}

#[test]
fn both_reach_without_an_initial_guess() {
    for kind in [ControllerKind::PaperAdrc, ControllerKind::NullSpaceQp] {
        let mut sim = Loop::new();
        let mut controller = Controller::new(&sim.robot, blind(kind));
        controller.set_goal(Goal::position([0.03, -0.02, -0.31]), None);
        let out = sim.run(&mut controller, 40.0);
        assert!(
            out.distance_m.unwrap() <= 0.5e-3,
            "{kind:?} {:?}",
            out.distance_m
        );
    }
}

/// Chambers run into their bounds on the way; the others must take over.
#[test]
fn both_reach_the_edge_of_the_workspace_without_an_initial_guess() {
    for (kind, bound_m) in [
        (ControllerKind::PaperAdrc, 3e-3),
        (ControllerKind::NullSpaceQp, 0.5e-3),
    ] {
        for q in [
            [36e3, -36e3, -36e3, 30e3, -36e3, -36e3],
            [38e3, 38e3, -38e3, 38e3, 38e3, -10e3],
        ] {
            let mut sim = Loop::new();
            let goal = Goal::position(sim.nominal.tip_m(&q));
            let mut controller = Controller::new(&sim.robot, blind(kind));
            controller.set_goal(goal, None);
            let distance_m = sim.run(&mut controller, 60.0).distance_m.unwrap();
            assert!(distance_m <= bound_m, "{kind:?} {q:?}: {distance_m} m");
        }
    }
}

#[test]
fn both_reach_an_orientation() {
    for kind in [ControllerKind::PaperAdrc, ControllerKind::NullSpaceQp] {
        let mut sim = Loop::new();
        // The pose of known pressures: all six degrees of freedom are consistent.
        let pose = sim
            .nominal
            .pose(
                &sim.nominal
                    .sensors(&[9e3, -4e3, 2e3, -5e3, 6e3, 3e3], 0.0)
                    .sensors,
            )
            .pose;
        let target =
            crate::signal::pose_from_ypr([pose[0], pose[1], pose[2]], [pose[3], pose[4], pose[5]]);
        let goal = Goal {
            orientation: OrientationGoal::Rotation(target.rotation),
            ..Goal::position([pose[0], pose[1], pose[2]])
        };
        let verdict = sim.verdict(&goal);
        let mut controller = Controller::new(&sim.robot, Gains::of(kind));
        controller.set_goal(goal, Some(&verdict));
        let out = sim.run(&mut controller, 60.0);
        assert!(
            out.done && out.distance_m.unwrap() <= 0.5e-3,
            "{kind:?} {out:?}"
        );
    }
}

#[test]
fn both_bring_a_point_below_the_tip_to_the_goal() {
    for kind in [ControllerKind::PaperAdrc, ControllerKind::NullSpaceQp] {
        let mut sim = Loop::new();
        let pose = |arm: &ToyArm, q: &[f64; CHAMBERS]| {
            let p = PoseMap::pose(arm, &arm.sensors(q, 0.0).sensors).pose;
            crate::signal::pose_from_ypr([p[0], p[1], p[2]], [p[3], p[4], p[5]])
        };
        let point_m = [0.0, 0.0, -sim.robot.payload_com_m];
        let there = pose(&sim.nominal, &[9e3, -4e3, 2e3, -5e3, 6e3, 3e3]);
        let goal = Goal {
            point_m,
            ..Goal::position((there * nalgebra::Point3::from(point_m)).into())
        };
        let verdict = sim.verdict(&goal);
        let mut controller = Controller::new(&sim.robot, Gains::of(kind));
        controller.set_goal(goal.clone(), Some(&verdict));
        let out = sim.run(&mut controller, 60.0);
        assert!(
            out.done && out.distance_m.unwrap() <= 0.5e-3,
            "{kind:?} {out:?}"
        );
        // The arm, too, has the point there, not the tip.
        let reached = pose(&sim.real, &sim.chamber_pa);
        let off_m = goal.error(&reached).fixed_rows::<3>(0).norm();
        let tip_off_m =
            (reached.translation.vector - nalgebra::Vector3::from(goal.position_m)).norm();
        assert!(
            off_m < 1e-3 && tip_off_m > 0.09,
            "{kind:?} {off_m} {tip_off_m}"
        );
    }
}

#[test]
fn tip_keeps_to_its_speed_limit() {
    for kind in [ControllerKind::PaperAdrc, ControllerKind::NullSpaceQp] {
        let mut sim = Loop::new();
        let goal = Goal::position([0.06, 0.04, -0.30]);
        let verdict = sim.verdict(&goal);
        let mut controller = Controller::new(&sim.robot, Gains::of(kind));
        controller.set_goal(goal, Some(&verdict));
        let mut last = None;
        for _ in 0..300 {
            sim.tick(&mut controller);
            let tip = nalgebra::Vector3::from(sim.real.tip_m(&sim.chamber_pa));
            if let Some(before) = last.replace(tip) {
                let speed_m_s = (tip - before).norm() / DT_S;
                // The model is 5 % off, and chambers that lag catch up together.
                assert!(
                    speed_m_s < 1.3 * sim.robot.tip_speed_max_m_s,
                    "{kind:?} {speed_m_s}"
                );
            }
        }
    }
}

#[test]
fn an_unreachable_goal_is_reported_within_two_seconds_of_saturation() {
    for kind in [ControllerKind::PaperAdrc, ControllerKind::NullSpaceQp] {
        let mut sim = Loop::new();
        sim.chamber_pa = [38e3; CHAMBERS];
        let goal = Goal::position([0.0, 0.0, -0.6]);
        let verdict = sim.verdict(&goal);
        let mut controller = Controller::new(&sim.robot, Gains::of(kind));
        controller.set_goal(goal, Some(&verdict));
        let mut approach = Vec::new();
        let mut reported = None;
        for _ in 0..200 {
            let out = sim.tick(&mut controller);
            let saturated = out.wanted_pa.iter().any(|p| *p > 39.95e3);
            if saturated {
                approach.push((sim.now, out.distance_m.unwrap()));
            }
            assert!(
                saturated || out.stall.is_none(),
                "stalled with pressure to spare"
            );
            if let Some(stall) = out.stall {
                reported = Some(stall);
                break;
            }
        }
        let stall = reported.expect("no stall reported");
        // Since when the saturated arm was as good as there.
        let (since, _) = approach
            .iter()
            .find(|(_, d)| *d < stall.distance_m + PROGRESS_M)
            .unwrap();
        let after_s = sim.now.since(*since);
        assert!((1.0..=2.0).contains(&after_s), "{kind:?}: {after_s} s");
        assert!(
            stall.distance_m > 0.1 && stall.chamber.1 > 39.9e3,
            "{stall:?}"
        );
    }
}

/// Signals with the noise the weights assume, gauges with 30 Pa.
#[test]
fn both_stay_at_the_goal_under_sensor_noise() {
    for kind in [ControllerKind::PaperAdrc, ControllerKind::NullSpaceQp] {
        let mut rng = Pcg64::seed_from_u64(5);
        let mut sim = Loop::new();
        let goal = Goal::position([0.03, -0.02, -0.31]);
        let verdict = sim.verdict(&goal);
        let mut controller = Controller::new(&sim.robot, Gains::of(kind));
        controller.set_goal(goal.clone(), Some(&verdict));
        let mut noise = |sigma: f64| {
            // Sum of twelve uniform numbers: nearly normal.
            sigma * (0..12).map(|_| rng.random_range(-0.5..0.5)).sum::<f64>()
        };
        let sigma = SignalSigma::default();
        let mut sum_m = 0.0;
        for k in 0..1200 {
            let mut frame = sim.real.frame(sim.now, sim.chamber_pa, sim.payload_kg);
            let clean = sim.nominal.pose(&frame.sensors.to_vector()).pose;
            frame
                .sensors
                .spring_m
                .iter_mut()
                .for_each(|l| *l += noise(sigma.spring_m));
            let angles = frame.sensors.imu_ypr_rad.iter_mut().flatten();
            angles.for_each(|a| *a += noise(sigma.imu_rad));
            frame.chamber_pa.iter_mut().for_each(|p| *p += noise(30.0));
            sim.tick_with(&mut controller, frame);
            if k >= 800 {
                let tip_m = clean.fixed_rows::<3>(0).into_owned();
                sum_m += (tip_m - nalgebra::Vector3::from(goal.position_m)).norm() / 400.0;
            }
        }
        assert!(sum_m < 0.5e-3, "{kind:?}: mean true error {sum_m} m");
    }
}

/// A network's gradient also points off the manifold of feasible signals, and the real arm's
/// signals lie off the model's: no reference made from the model alone gives the right pose.
#[test]
fn both_reach_with_a_pose_map_that_is_steep_off_the_manifold() {
    for kind in [ControllerKind::PaperAdrc, ControllerKind::NullSpaceQp] {
        let mut rng = Pcg64::seed_from_u64(8);
        let mut sim = Loop::new();
        sim.nominal.off_manifold = SMatrix::from_fn(|i, j| {
            // Like the map itself: some 0.3 m per m and 0.03 m per rad.
            let scale = if j < SPRINGS { 0.3 } else { 0.03 };
            let unit = if i < 3 { 1.0 } else { 5.0 };
            scale * unit * rng.random_range(-1.0..1.0)
        });
        sim.real.bias = SensorRef::from_fn(|i, _| {
            let size = if i < SPRINGS { 2e-3 } else { 0.02 };
            size * rng.random_range(-1.0..1.0)
        });
        let goal = Goal::position([0.06, 0.04, -0.30]);
        let verdict = sim.verdict(&goal);
        let mut controller = Controller::new(&sim.robot, Gains::of(kind));
        controller.set_goal(goal, Some(&verdict));
        let out = sim.run(&mut controller, 60.0);
        assert!(
            out.distance_m.unwrap() <= 0.5e-3,
            "{kind:?} {:?}",
            out.distance_m
        );
    }
}

#[test]
fn a_dead_spring_does_not_stop_the_arm() {
    let mut sim = Loop::new();
    sim.nominal.masked_spring = Some(3);
    let goal = Goal::position([0.06, 0.04, -0.30]);
    let verdict = sim.verdict(&goal);
    let mut controller = Controller::new(&sim.robot, Gains::of(ControllerKind::PaperAdrc));
    controller.set_goal(goal, Some(&verdict));
    let held_m = sim
        .real
        .frame(sim.now, sim.chamber_pa, sim.payload_kg)
        .sensors
        .spring_m[3];
    let mut distance_m = f64::INFINITY;
    for _ in 0..1200 {
        let mut frame = sim.real.frame(sim.now, sim.chamber_pa, sim.payload_kg);
        frame.sensors.spring_m[3] = held_m;
        frame.health.springs[3] = ChannelHealth::Missing;
        distance_m = sim.tick_with(&mut controller, frame).distance_m.unwrap();
    }
    assert!(distance_m <= 0.5e-3, "{distance_m}");
}

#[test]
fn leaving_saturation_is_immediate() {
    // Half a minute against the bound, then a goal inside: no windup keeps it there.
    for kind in [ControllerKind::PaperAdrc, ControllerKind::NullSpaceQp] {
        let mut sim = Loop::new();
        sim.chamber_pa = [38e3; CHAMBERS];
        let far = Goal::position([0.0, 0.0, -0.6]);
        let verdict = sim.verdict(&far);
        let mut controller = Controller::new(&sim.robot, Gains::of(kind));
        controller.set_goal(far, Some(&verdict));
        sim.run(&mut controller, 30.0);
        let near = Goal::position([0.0, 0.0, -0.40]);
        let verdict = sim.verdict(&near);
        controller.set_goal(near, Some(&verdict));
        let before: f64 = sim.chamber_pa.iter().sum();
        sim.run(&mut controller, 1.0);
        let after: f64 = sim.chamber_pa.iter().sum();
        assert!(after < before - 1e3, "{kind:?}: {before} {after}");
    }
}

#[test]
fn hold_keeps_the_set_pressures() {
    let mut sim = Loop::new();
    let mut controller = Controller::new(&sim.robot, Gains::of(ControllerKind::PaperAdrc));
    controller.set_goal(Goal::position([0.03, -0.02, -0.31]), None);
    sim.run(&mut controller, 3.0);
    controller.hold();
    let set = *sim.command.as_ref().unwrap().chamber_pa();
    let out = sim.run(&mut controller, 3.0);
    assert_eq!(out.wanted_pa, set);
    assert_eq!((out.steps, out.done, out.sensor_ref), (0, false, None));
}

#[test]
fn values_that_are_not_finite_make_it_hold_and_recover() {
    for kind in [ControllerKind::PaperAdrc, ControllerKind::NullSpaceQp] {
        let mut sim = Loop::new();
        let goal = Goal::position([0.03, -0.02, -0.31]);
        let verdict = sim.verdict(&goal);
        let mut controller = Controller::new(&sim.robot, Gains::of(kind));
        controller.set_goal(goal, Some(&verdict));
        sim.run(&mut controller, 3.0);
        let set = *sim.command.as_ref().unwrap().chamber_pa();
        let mut frame = sim.real.frame(sim.now, sim.chamber_pa, sim.payload_kg);
        frame.sensors.spring_m[4] = f64::NAN;
        assert_eq!(sim.tick_with(&mut controller, frame).wanted_pa, set);
        let out = sim.run(&mut controller, 40.0);
        assert!(out.distance_m.unwrap() <= 0.5e-3, "{kind:?}");
    }
}

#[test]
fn unusable_channels_have_no_weight() {
    let sim = Loop::new();
    let mut frame = sim.real.frame(sim.now, sim.chamber_pa, 0.0);
    frame.health.springs[3] = ChannelHealth::Stuck;
    frame.health.springs[4] = ChannelHealth::Suspect;
    frame.health.imus[1] = ChannelHealth::Missing;
    let weights = signal_weights(&frame, &SignalSigma::default());
    for i in 0..SIGNALS {
        let dead = i == 3 || (15..18).contains(&i);
        assert_eq!(weights[i] == 0.0, dead, "signal {i}");
    }
    assert!((weights[0] - 2500.0).abs() < 1e-9);
}

#[test]
fn a_pump_that_does_not_deliver_winds_nothing_up() {
    for kind in [ControllerKind::PaperAdrc, ControllerKind::NullSpaceQp] {
        let mut sim = Loop::new();
        let goal = Goal::position([0.06, 0.04, -0.30]);
        let verdict = sim.verdict(&goal);
        let mut controller = Controller::new(&sim.robot, Gains::of(kind));
        controller.set_goal(goal, Some(&verdict));
        let mut longest_pa: f64 = 0.0;
        for _ in 0..400 {
            let out = sim.tick(&mut controller);
            for i in 0..CHAMBERS {
                longest_pa = longest_pa.max((out.wanted_pa[i] - sim.chamber_pa[i]).abs());
            }
            sim.chamber_pa = [0.0; CHAMBERS];
        }
        // One tick of the pump is in the measure.
        let lead_pa = controller.gains().lead_pa;
        assert!(
            longest_pa <= lead_pa + 1.0 && longest_pa > 100.0,
            "{longest_pa}"
        );
    }
}

#[test]
fn a_dead_gauge_does_not_stop_the_arm() {
    let mut sim = Loop::new();
    let goal = Goal::position([0.03, -0.02, -0.31]);
    let verdict = sim.verdict(&goal);
    let mut controller = Controller::new(&sim.robot, Gains::of(ControllerKind::PaperAdrc));
    controller.set_goal(goal, Some(&verdict));
    let mut distance_m = f64::INFINITY;
    for _ in 0..800 {
        let mut frame = sim.real.frame(sim.now, sim.chamber_pa, sim.payload_kg);
        frame.chamber_pa[2] = f64::NAN;
        frame.health.chambers[2] = ChannelHealth::Missing;
        distance_m = sim.tick_with(&mut controller, frame).distance_m.unwrap();
    }
    assert!(distance_m <= 0.5e-3, "{distance_m}");
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 24, failure_persistence: None, ..Default::default() })]

    /// [`Loop::tick_with`] holds every command against range and rate.
    #[test]
    fn limits_hold_for_any_goal_and_start(
        goal in prop::array::uniform3(-0.7..0.7f64),
        start in prop::array::uniform6(-40e3..40e3f64),
        paper in any::<bool>(),
        guess in any::<bool>(),
    ) {
        let kind = if paper { ControllerKind::PaperAdrc } else { ControllerKind::NullSpaceQp };
        let mut sim = Loop::new();
        sim.chamber_pa = start;
        let goal = Goal::position(goal);
        let verdict = guess.then(|| sim.verdict(&goal));
        let mut controller = Controller::new(&sim.robot, Gains::of(kind));
        controller.set_goal(goal, verdict.as_ref());
        sim.run(&mut controller, 3.0);
    }
}

#[test]
fn a_programme_without_a_solution_holds_the_set_pressures_and_is_counted() {
    let mut l = Loop::new();
    let mut controller = Controller::new(&l.robot, Gains::of(ControllerKind::NullSpaceQp));
    let goal = Goal::position([0.06, 0.04, -0.30]);
    let reach = l.verdict(&goal);
    controller.set_goal(goal, Some(&reach));
    l.run(&mut controller, 1.0);
    assert_eq!(controller.unsolved_ticks(), 0);
    let set_pa = |l: &Loop| *l.command.as_ref().expect("set").chamber_pa();
    // Finite, but its square is not.
    l.steepness = 1e200;
    for k in 1..=10 {
        let (before, measured) = (set_pa(&l), l.chamber_pa);
        let out = l.tick(&mut controller);
        // A set pressure that is further ahead of the measured one than allowed comes back; none goes on.
        for i in 0..CHAMBERS {
            let ahead = |pa: f64| (pa - measured[i]).abs();
            assert!(ahead(out.wanted_pa[i]) <= ahead(before[i]), "tick {k}: {i}");
        }
        assert_eq!(controller.unsolved_ticks(), k);
    }
    l.steepness = 1.0;
    let out = l.run(&mut controller, 30.0);
    assert_eq!(controller.unsolved_ticks(), 10);
    assert!(out.distance_m.is_some_and(|d| d < 2e-3), "{out:?}");
}
