//! The twin's own thread beside a window that reads late or never, and on a machine that is busy.

use std::ops::ControlFlow;
use std::time::Duration;

use super::*;
use crate::link::LinkEvent;
use crate::link::wire::Config;
use crate::rig::{RigOptions, Surroundings, Unit, VirtualRig};
use crate::twin::publish::channel;

/// Longer than anything here takes.
const LONG: Duration = Duration::from_secs(120);

/// A port to a virtual rig in this process.
fn rig() -> InProcess {
    let robot = RobotSpec::reference();
    let options = RigOptions {
        unit: Unit::default(),
        seed: 1,
        surroundings: Surroundings::default(),
        ..RigOptions::default()
    };
    let mut rig = VirtualRig::new(&robot, &options).expect("settles");
    let far_end = move |t_s: f64, to_rig: &[u8]| Heard {
        bytes: Some(rig.advance(t_s, to_rig)),
        truth: None,
    };
    let config = Config::new(&robot.pressure, robot.over_pressure_pa);
    InProcess::new("virtual rig", config, Box::new(far_end))
}

#[expect(
    clippy::disallowed_methods,
    reason = "the twin's thread keeps beside real time"
)]
fn now() -> std::time::Instant {
    std::time::Instant::now()
}

/// A thread that is not run for longer than any limit of the link allows: the arm moves meanwhile.
#[test]
fn a_thread_that_is_not_run_stops_simulated_time_and_nothing_else() {
    const STALL: Duration = Duration::from_millis(1500);
    const ENDS: i64 = 400;
    let robot = RobotSpec::reference();
    let runner = Runner::new(twin(), Box::new(rig()), &robot);
    let mut ticks = 0;
    let stalls = move |_: &Snapshot| {
        ticks += 1;
        if ticks == 200 {
            std::thread::sleep(STALL);
        }
    };
    let start = now();
    let (handle, thread) = spawn(runner, start, vec![Command::Arm], stalls).expect("a thread");
    for k in 0..ENDS {
        let snapshot = handle.feed.recv_timeout(LONG).expect("a tick");
        assert_eq!(snapshot.stamp, at(k as u32), "simulated time is skipped");
        assert!(
            snapshot
                .alarms
                .iter()
                .all(|a| !matches!(a.cause, crate::signal::AlarmCause::DataOld { .. })),
            "{:?}",
            snapshot.alarms
        );
        assert!(
            !matches!(snapshot.mode, Mode::Safe(_)),
            "{:?}",
            snapshot.mode
        );
        if k > 150 {
            assert_eq!(snapshot.mode, Mode::Hold, "at tick {k}");
            assert!(snapshot.raw.as_ref().is_some_and(|r| r.faults == 0));
        }
    }
    // The first tick is due at once.
    let most = Duration::from_secs_f64((ENDS - 1) as f64 * TICK_S);
    assert!(
        start.elapsed() + Duration::from_millis(60) > most + STALL,
        "the stall was hurried after"
    );
    drop(handle);
    thread.join().expect("it ends in peace");
}

/// What the window is to know of a twin that goes on for a minute while nobody reads.
#[test]
fn outcomes_reach_a_window_that_did_not_read_for_a_minute() {
    let (mut publisher, handle, _commands) = channel();
    let port = Chatty(Frames(0));
    let mut runner = Runner::new(twin(), Box::new(port), &RobotSpec::reference());
    let calibration = Arc::new(Calibration::virtual_rig());
    let mut k = 0;
    run_in_simulated_time(&mut runner, |snapshot, events, commands| {
        publisher.publish(snapshot.stamp, snapshot, events);
        k += 1;
        match k {
            // Long after the queue is full.
            1000 => commands.push(Command::Calibrate(Arc::clone(&calibration))),
            1500 => commands.push(Command::DeclarePayload(-1.0)),
            2000 => commands.push(Command::Arm),
            2500 => commands.push(Command::Goto(Goal::position([0.0, 0.0, -0.306]))),
            6000 => return ControlFlow::Break(()),
            _ => {}
        }
        ControlFlow::Continue(())
    });
    let mut events = Vec::new();
    let mut newest = Stamp::ZERO;
    // The window wakes up, and the twin ticks on.
    for _ in 0..10 {
        events.extend(handle.events.try_iter());
        let (snapshot, more) = runner.tick(at(k), &[]);
        k += 1;
        newest = snapshot.stamp;
        publisher.publish(snapshot.stamp, &snapshot, &more);
    }
    events.extend(handle.events.try_iter());
    let outcomes: Vec<_> = events
        .iter()
        .filter(|e| !matches!(e, Event::Notice { .. } | Event::Warning { .. }))
        .map(Event::text)
        .collect();
    let expected = [
        "Calibration in use",
        "A payload of -1 kg",
        "Mode: hold",
        "Mode: moving",
    ];
    let reported = |what: &str| outcomes.iter().position(|t| t.contains(what));
    let order: Vec<_> = expected
        .iter()
        .map(|what| reported(what).unwrap_or_else(|| panic!("{what}: {outcomes:?}")))
        .collect();
    assert!(order.is_sorted(), "{outcomes:?}");
    // What was left out of 6000 different notices is reported, and everything is bounded.
    assert!(events.len() < 1000, "{} events", events.len());
    let gap = events
        .iter()
        .find(|e| e.text().contains("messages are left out"));
    let gap = gap.expect("reported").text();
    let left_out: usize = gap
        .split(' ')
        .next()
        .and_then(|n| n.parse().ok())
        .expect("a number");
    let notices = events
        .iter()
        .filter(|e| e.text().contains("(jump "))
        .count();
    assert_eq!(left_out + notices, 6010, "{gap}");
    assert_eq!(handle.snapshot().stamp, newest);
    assert!(handle.feed.try_iter().count() <= 200);
}

/// [`Frames`] with something to say in every tick.
struct Chatty(Frames);

impl Port for Chatty {
    fn clock(&self) -> Clock {
        Clock::Lockstep
    }
    fn poll(&mut self, now: Stamp) -> Arrivals {
        let mut arrivals = self.0.poll(now);
        let reason = format!("jump {}", now.0);
        arrivals.notices.push(LinkEvent::Disconnected { reason });
        arrivals
    }
    fn send(&mut self, _now: Stamp, _command: Option<&crate::signal::PressureCommand>) {}
    fn order(&mut self, _now: Stamp, _order: Order) {}
}

/// What is drawn is settled by nobody in a run without a window, and beside the tick elsewhere.
#[test]
fn no_tick_settles_or_waits_for_what_is_drawn() {
    use crate::twin::newest::Newest;
    use crate::twin::shape::{ShapeQuestion, ShapeSolver};
    use crate::twin::view::Drawing;
    use std::sync::mpsc::sync_channel;
    let robot = RobotSpec::reference();
    let mut headless = Runner::new(twin(), Box::new(Frames(0)), &robot);
    for k in 0..200 {
        let (snapshot, _) = headless.tick(at(k), &[]);
        assert!(snapshot.shape.is_none() && matches!(headless.view.drawing, Drawing::Nobody));
    }
    // A window's: with a model that takes as long as the test wants.
    let mut runner = Runner::new(twin(), Box::new(Frames(0)), &robot);
    runner.draw_shapes();
    let (began_tx, began) = sync_channel(8);
    let (go, wait) = sync_channel::<()>(8);
    let corrected_by = crate::sim::patch::SensorErrors::of(&robot);
    let mut solver = ShapeSolver::new(&runner.view.own_robot(), corrected_by);
    let worker = Newest::spawn("test", move |question: ShapeQuestion| {
        began_tx.send(question.stamp).expect("the test listens");
        wait.recv().expect("the test lets go");
        solver.solve(&question)
    });
    runner.view.drawing = Drawing::Thread(worker.expect("a thread"));
    for k in 0..200 {
        let (snapshot, _) = runner.tick(at(k), &[]);
        assert!(snapshot.shape.is_none(), "at tick {k}");
    }
    go.send(()).expect("the worker lives");
    // Taking up the newest question means that the first answer is there.
    began.recv().expect("it began");
    assert!(at(199).since(began.recv().expect("it goes on")) < 0.04);
    let (snapshot, _) = runner.tick(at(200), &[]);
    assert!(snapshot.shape.is_some());
    go.send(()).expect("the worker lives");
    // As fast as it goes, the same ticks give the same shapes.
    let tip = |runner: &mut Runner| {
        runner.draw_shapes();
        let (snapshot, _) = runner.tick(at(1), &[]);
        let shape = snapshot.shape.clone().expect("settled in the tick");
        shape.base_from_pad[2].translation.vector
    };
    let fresh = || tip(&mut Runner::new(twin(), Box::new(Frames(0)), &robot));
    assert_eq!(fresh(), fresh());
}
