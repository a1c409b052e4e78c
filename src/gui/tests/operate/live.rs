//! The window on a real twin of the virtual rig, in simulated time: every plan is driven by the labels of the
//! panel and ends in a state that the rig itself confirms.

use std::sync::{Arc, Mutex};

use super::super::*;
use crate::control::Gains;
use crate::learn::Model;
use crate::link::wire::Config;
use crate::rig::{Object, RigOptions, Surroundings, Unit, VirtualRig};
use crate::sensing::{Calibration, Sensing};
use crate::signal::{ControllerKind, Gripper};
use crate::task::circle;
use crate::twin::{Heard, InProcess, Maps, Runner, TICK_S};

const NETWORKS: &[u8] = include_bytes!("../../../../assets/networks/unit-1/reference.safetensors");
const CALIBRATION: &str = include_str!("../../../../assets/calibration/virtual-rig.toml");

/// The shipped networks.
pub fn maps() -> Maps {
    Model::from_bytes(NETWORKS).expect("networks").into()
}

/// A port to a rig in this process; the test keeps the other end.
fn wire(rig: Arc<Mutex<VirtualRig>>, config: Config) -> InProcess {
    let far_end = move |t_s: f64, to_rig: &[u8]| {
        let mut rig = rig.lock().expect("not poisoned");
        Heard {
            bytes: Some(rig.advance(t_s, to_rig)),
            truth: rig.mocap_sample(t_s),
        }
    };
    InProcess::new("virtual rig", config, Box::new(far_end))
}

/// The twin's end of the window's channels, with a real twin on a virtual rig.
pub struct Bench {
    pub twin: Twin,
    pub maps: Maps,
    runner: Runner,
    rig: Arc<Mutex<VirtualRig>>,
    ticks: u64,
    /// Everything that happened.
    pub events: Vec<Event>,
    /// The newest snapshot.
    pub snapshot: Arc<Snapshot>,
    /// True tip positions along the way with the goal of the moment, m.
    pub track: Vec<[f64; 3]>,
}

impl Bench {
    /// A rig that has answered for a second, and its window.
    pub fn new(objects: Vec<Object>) -> (Self, App) {
        let robot = RobotSpec::reference();
        let options = RigOptions {
            unit: Unit::default(),
            seed: 1,
            surroundings: Surroundings::default(),
            objects,
            ..RigOptions::default()
        };
        let rig = Arc::new(Mutex::new(
            VirtualRig::new(&robot, &options).expect("settles"),
        ));
        let config = Config::new(&robot.pressure, robot.over_pressure_pa);
        let port = wire(Arc::clone(&rig), config);
        let sensing = Sensing::new(
            &robot,
            Calibration::from_toml(CALIBRATION).expect("calibration"),
        );
        let maps = maps();
        let gains = Gains::of(ControllerKind::NullSpaceQp);
        let twin = crate::twin::Twin::new(&robot, maps.clone(), sensing, gains);
        let mut runner = Runner::new(twin, Box::new(port), &robot);
        runner.draw_shapes();
        let (twin, handle) = super::super::twin(Snapshot::default());
        let mut bench = Self {
            twin,
            maps,
            runner,
            rig,
            ticks: 0,
            events: Vec::new(),
            snapshot: Arc::default(),
            track: Vec::new(),
        };
        for _ in 0..200 {
            bench.tick(&[]);
        }
        let mut app = App::new(Some(handle), robot, Services::none());
        let samples: Vec<[f32; 3]> = bench
            .maps
            .seeds
            .iter()
            .map(|s| s.tip_m().map(|x| x as f32))
            .collect();
        app.screens.operate.view3d.set_reachable(&samples);
        (bench, app)
    }

    /// One tick with what the window has commanded.
    pub fn tick(&mut self, commands: &[Command]) {
        let now = Stamp::from_seconds(self.ticks as f64 * TICK_S);
        let (snapshot, events) = self.runner.tick(now, commands);
        self.ticks += 1;
        *self.twin.latest.lock().expect("not poisoned") = Arc::clone(&snapshot);
        if self.ticks.is_multiple_of(10) {
            // A window that does not keep up loses history.
            let _ = self.twin.feed.try_send(Arc::clone(&snapshot));
        }
        for event in &events {
            let _ = self.twin.events.try_send(event.clone());
        }
        self.events.extend(events);
        self.snapshot = snapshot;
        let truth = &self.snapshot.truth;
        self.track.extend(
            truth
                .iter()
                .map(|t| <[f64; 3]>::from(t.base_from_tip.translation.vector)),
        );
    }

    /// Lets the window's commands reach the twin, and `ticks` pass; then the window shows it.
    pub fn run(&mut self, h: &mut Harness<'_, App>, ticks: usize) {
        let mut commands = self.twin.taken();
        for _ in 0..ticks.max(1) {
            self.tick(&std::mem::take(&mut commands));
        }
        h.run_steps(2);
    }

    /// Runs until an event says so; the sentences of the panel on the way.
    fn run_until(
        &mut self,
        h: &mut Harness<'_, App>,
        seconds: f64,
        mut over: impl FnMut(&Self, &Harness<'_, App>) -> bool,
    ) {
        for _ in 0..(seconds / 0.25) as usize {
            self.run(h, 25);
            if over(self, h) {
                return;
            }
        }
        panic!("not over after {seconds} s: {:?}", texts(&self.events));
    }

    fn tip_m(&self) -> nalgebra::Vector3<f64> {
        let rig = self.rig.lock().expect("not poisoned");
        rig.plant.truth().base_from_tip().translation.vector
    }

    fn object(&self) -> Object {
        let rig = self.rig.lock().expect("not poisoned");
        rig.objects()[0].clone()
    }
}

fn texts(events: &[Event]) -> Vec<String> {
    events.iter().map(Event::text).collect()
}

fn open(objects: Vec<Object>) -> (Bench, Harness<'static, App>) {
    let (bench, app) = Bench::new(objects);
    let mut h = harness(app);
    h.run_steps(3);
    press(&mut h, "Plan");
    h.run_steps(2);
    (bench, h)
}

fn set(h: &mut Harness<'_, App>, label: &str, value: f64) {
    h.get_by_label(label).set_value_accesskit(value);
    h.run_steps(2);
}

fn click(h: &mut Harness<'_, App>, label: &str) {
    h.get_by_label(label).click();
    h.run_steps(2);
}

#[test]
fn a_circle_is_followed_to_its_end_and_the_true_tip_stays_on_it() {
    let (mut bench, mut h) = open(Vec::new());
    let centre_m = [0.02, 0.02, -0.30];
    for (axis, m) in ["x", "y", "z"].into_iter().zip(centre_m) {
        set(&mut h, &format!("Centre {axis} in mm"), m * 1e3);
    }
    set(&mut h, "Radius in mm", 15.0);
    set(&mut h, "Speed in mm/s", 5.0);
    click(&mut h, "▶ Start");
    bench.run_until(&mut h, 60.0, |b, _| {
        b.snapshot
            .routine
            .as_ref()
            .is_some_and(|r| r.waypoint.is_some())
    });
    h.get_by_label_contains("Leg 2 of 2, waypoint");
    h.get_by_label_contains("Following the circle, radius 15 mm at 5.0 mm/s.");
    let begun = bench.track.len();
    // Held on the way, it goes on where it was.
    bench.run(&mut h, 300);
    click(&mut h, "▮▮ HOLD");
    // RESUME is off for a second, by the window's time and by the twin's.
    for _ in 0..4 {
        bench.run(&mut h, 30);
    }
    assert_eq!(bench.snapshot.mode, Mode::Hold);
    h.get_by_label_contains("Leg 2 of 2, waypoint");
    click(&mut h, "▶ RESUME");
    let done = "Done: circle, radius 15 mm";
    bench.run_until(&mut h, 120.0, |b, _| {
        texts(&b.events).contains(&done.into())
    });
    bench.run(&mut h, 5);
    h.get_by_label_contains(&format!("● {done}. "));
    h.get_by_label_contains("mm RMS off the path");
    let path = circle(centre_m, 0.015, 60);
    let off_mm = bench.track[begun..].iter().map(|p| {
        let p = nalgebra::Vector3::from(*p);
        let to = |q: &[f64; 3]| (nalgebra::Vector3::from(*q) - p).norm() * 1e3;
        path.waypoints_m.iter().map(to).fold(f64::MAX, f64::min)
    });
    let off_mm: Vec<f64> = off_mm.collect();
    let mean_mm = off_mm.iter().sum::<f64>() / off_mm.len() as f64;
    println!("true tip from the nearest of 60 waypoints: mean {mean_mm:.2} mm (simulated)");
    // The waypoints are 1.6 mm apart and motion capture is noisy by 0.1 mm.
    assert!(mean_mm < 1.5, "{mean_mm}");
    // It went all the way round.
    for q in &path.waypoints_m {
        let q = nalgebra::Vector3::from(*q);
        let near = |p: &&[f64; 3]| (nalgebra::Vector3::from(**p) - q).norm() < 4e-3;
        assert!(bench.track[begun..].iter().find(near).is_some(), "{q}");
    }
}

#[test]
fn pick_and_place_leaves_the_object_at_the_place_with_the_gripper_open() {
    let pick_m = [-0.04, 0.01, -0.31];
    let place_m = [0.03, 0.03, -0.30];
    let (mut bench, mut h) = open(vec![Object {
        grasp_m: pick_m,
        mass_kg: 0.1,
        held: false,
    }]);
    click(&mut h, "Pick and place");
    for (i, axis) in ["x", "y", "z"].into_iter().enumerate() {
        set(&mut h, &format!("Pick at {axis} in mm"), pick_m[i] * 1e3);
        set(&mut h, &format!("Place at {axis} in mm"), place_m[i] * 1e3);
    }
    set(&mut h, "Payload lifted in g", 100.0);
    set(&mut h, "Lift in mm", 20.0);
    click(&mut h, "▶ Start");
    bench.run_until(&mut h, 120.0, |b, _| b.object().held);
    h.get_by_label_contains("Leg 4 of 9");
    bench.run(&mut h, 200);
    assert!((bench.snapshot.payload_kg - 0.1).abs() < 1e-9);
    bench.run_until(&mut h, 300.0, |b, _| {
        texts(&b.events).contains(&"Done: pick and place: 100 g".into())
    });
    bench.run(&mut h, 5);
    h.get_by_label("● Done: pick and place: 100 g");
    let object = bench.object();
    let off_m = |p: nalgebra::Vector3<f64>, q: [f64; 3]| (p - nalgebra::Vector3::from(q)).norm();
    let off_mm = off_m(object.grasp_m.into(), place_m) * 1e3;
    println!("object let go {off_mm:.2} mm from its place (simulated)");
    assert!(!object.held && off_mm < 3.0, "{object:?}");
    let command = bench.snapshot.command.as_ref().expect("it holds its place");
    assert_eq!(command.gripper(), Some(Gripper::Open));
    assert_eq!(bench.snapshot.payload_kg, 0.0);
    let over_m = [place_m[0], place_m[1], place_m[2] + 0.02];
    assert!(off_m(bench.tip_m(), over_m) < 3e-3, "{}", bench.tip_m());
}

#[test]
fn a_plan_with_a_waypoint_out_of_reach_is_refused_where_it_was_made() {
    let (mut bench, mut h) = open(Vec::new());
    set(&mut h, "Radius in mm", 200.0);
    click(&mut h, "▶ Start");
    bench.run(&mut h, 100);
    let refused = texts(&bench.events);
    let reason = refused
        .iter()
        .find(|t| t.starts_with("Not started, because of"));
    let reason = reason.expect("refused").clone();
    assert!(
        reason.contains("waypoint") || reason.contains("stop 1"),
        "{reason}"
    );
    // In the strip below and in the panel.
    assert_eq!(h.get_all_by_label(&format!("▲ {reason}")).count(), 2);
    assert_eq!(bench.snapshot.routine, None);
}
