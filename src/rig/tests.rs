use super::*;
use crate::link::wire::{Config, TICK_RATE_HZ as WIRE_HZ};
use crate::link::{HostSession, Origin};
use crate::signal::{RawFrame, SPRINGS, Stamp};

/// A rig with a host that keeps up the link on simulated time.
struct Linked {
    rig: VirtualRig,
    host: HostSession,
    ms: u64,
}

impl Linked {
    fn new(options: &RigOptions) -> Self {
        let robot = RobotSpec::reference();
        Self {
            rig: VirtualRig::new(&robot, options).expect("settles"),
            host: HostSession::new("virtual rig", Origin::Simulated, Config::built_in()),
            ms: 0,
        }
    }

    /// Frames of the next `for_s`.
    fn run(&mut self, for_s: f64) -> Vec<RawFrame> {
        let mut frames = Vec::new();
        for _ in 0..(for_s * 1e3) as u64 {
            self.ms += 1;
            let t_s = self.ms as f64 * 1e-3;
            let to_rig = self.host.poll(Stamp::from_seconds(t_s));
            let from_rig = self.rig.advance(t_s, &to_rig);
            self.host.on_bytes(Stamp::from_seconds(t_s), &from_rig);
            frames.extend(std::iter::from_fn(|| self.host.next_frame()));
            while self.host.next_event().is_some() {}
        }
        frames
    }

    /// Mean error of each spring's length in some frames of an arm at rest, mm, with ticks counted at these rates.
    fn length_errors_mm(
        &self,
        frames: &[RawFrame],
        rate_hz: impl Fn(&RawFrame, usize) -> f64,
    ) -> [f64; SPRINGS] {
        let circuit = &self.rig.circuit;
        std::array::from_fn(|i| {
            let at_m = circuit.felt_m()[i];
            let true_hz = circuit.frequency_hz(i, at_m);
            let hz_per_m = (circuit.frequency_hz(i, at_m + 1e-4) - true_hz) / 1e-4;
            let all = frames.iter().map(|f| {
                let (n, ticks) = (f.spring_counts[i], f.spring_gate_ticks[i]);
                f64::from(n) * rate_hz(f, i) / f64::from(ticks) - true_hz
            });
            all.sum::<f64>() / frames.len() as f64 / hz_per_m * 1e3
        })
    }
}

fn options(clocks: [Clock; BOARDS]) -> RigOptions {
    RigOptions {
        clocks: Some(clocks),
        ..RigOptions::default()
    }
}

/// Mean of 200 frames: the springs' tremble of 0.09 mm leaves 0.006 mm.
#[test]
fn gates_of_clocks_that_are_off_give_right_lengths_after_seconds_and_wrong_ones_by_the_nominal_rate()
 {
    let drift = 50e-6;
    let clocks = [5e-3, -5e-3].map(|skew| Clock { skew, drift });
    let mut linked = Linked::new(&options(clocks));
    linked.run(3.0);
    let frames = linked.run(2.0);
    assert!(frames.len() > 190, "{}", frames.len());
    let measured = linked.length_errors_mm(&frames, RawFrame::spring_tick_rate_hz);
    let worst = measured.iter().fold(0.0_f64, |w, e| w.max(e.abs()));
    println!("by measured rates: {worst:.4} mm at worst");
    assert!(worst < 0.05, "{measured:?}");
    let nominal = linked.length_errors_mm(&frames, |_, _| f64::from(WIRE_HZ));
    assert!(nominal.iter().all(|e| e.abs() > 5.0), "{nominal:?}");
    assert!(nominal[0].signum() != nominal[11].signum(), "{nominal:?}");
    for f in &frames {
        for (b, clock) in clocks.iter().enumerate() {
            let off = f.tick_rate_hz[b] / f64::from(WIRE_HZ) / clock.rate(4.0) - 1.0;
            assert!(
                off.abs() < 4.0 * f.tick_rate_sd[b].max(2e-6),
                "board {b}: {off}"
            );
        }
    }
}

#[test]
fn a_gate_is_as_long_as_its_boards_clock_makes_it() {
    let clocks = [5e-3, -5e-3].map(Clock::steady);
    let rig = Linked::new(&options(clocks)).rig;
    let perfect = Linked::new(&options([Clock::default(); BOARDS])).rig;
    let counts = |rig: &VirtualRig| {
        let of = |b: usize| rig.readings()[b].springs.map(|s| s.expect("read"));
        [of(0), of(1)]
    };
    let (off, exact) = (counts(&rig), counts(&perfect));
    for b in 0..BOARDS {
        for (s, e) in off[b].iter().zip(&exact[b]) {
            // The gate has its nominal number of ticks, and so more or fewer periods.
            assert!(s.gate_ticks.abs_diff(16_000) < 8, "{s:?}");
            let more = f64::from(s.count) / f64::from(e.count) * clocks[b].rate(0.0) - 1.0;
            assert!(more.abs() < 3e-4, "board {b}: {more}");
        }
    }
}

#[test]
fn clocks_of_a_unit_are_its_own_unless_others_are_given() {
    let unit = |n| RigOptions {
        unit: Unit(n),
        ..RigOptions::default()
    };
    assert_eq!(unit(2).clocks(), Clock::of_unit(2));
    assert_ne!(unit(1).clocks(), unit(2).clocks());
    let given = [Clock::steady(1e-3), Clock::default()];
    assert_eq!(options(given).clocks(), given);
}

/// The IMUs of a rig whose base hangs off level measure it, however far the arm gives way; it may hang 17 degrees off.
#[test]
fn imus_feel_a_base_that_hangs_more_than_three_degrees_off_level() {
    for tilt_rad in [0.06_f64, 0.3] {
        let mut linked = Linked::new(&RigOptions {
            hidden: vec![format!("base-tilt={tilt_rad},0").parse().expect("fits")],
            ..RigOptions::default()
        });
        linked.run(8.0);
        let mut up = Vector3::zeros();
        for _ in 0..200 {
            linked.run(0.01);
            // IMU 3 sits on the end pad, which belongs to board 2.
            let imu = linked.rig.readings()[1].imus[0].expect("read");
            up += Vector3::from(imu.accel_m_s2);
        }
        let base_from_imu = linked.rig.plant.truth().base_from_tip().rotation
            * nalgebra::UnitQuaternion::from_rotation_matrix(&linked.rig.inertial.pad_from_imu(2));
        let up_in_base = base_from_imu * up / 200.0;
        let measured_rad = up_in_base.angle(&Vector3::z());
        // Bias and scale of a part that was zeroed; the mount gives way by a twentieth.
        assert!(
            (measured_rad - tilt_rad).abs() < 0.005 + 0.05 * tilt_rad,
            "{measured_rad}"
        );
        assert!(measured_rad > 3.0_f64.to_radians());
    }
}

#[test]
fn imus_as_delivered_reach_the_boards_off_by_degrees_per_second() {
    let worst_deg_s = |inertial: InertialErrors| {
        let rig = Linked::new(&RigOptions {
            inertial,
            ..RigOptions::default()
        })
        .rig;
        let imus = rig.readings().iter().flat_map(|r| r.imus);
        let rates = imus.flat_map(|imu| imu.expect("read").gyro_rad_s);
        rates.fold(0.0_f64, |w, r| w.max(r.to_degrees().abs()))
    };
    let delivered = worst_deg_s(InertialErrors::as_delivered());
    assert!((8.0..=20.5).contains(&delivered), "{delivered}");
    assert!(worst_deg_s(InertialErrors::zeroed()) < 0.5);
}

#[test]
fn the_gripper_takes_what_is_in_its_reach_and_leaves_the_rest() {
    let robot = RobotSpec::reference();
    let tip_m = VirtualRig::new(&robot, &RigOptions::default())
        .expect("settles")
        .plant
        .truth()
        .base_from_tip()
        .translation
        .vector;
    let object = |off_m: f64| Object {
        grasp_m: (tip_m + Vector3::x() * off_m).into(),
        mass_kg: 0.2,
        held: false,
    };
    for (off_m, held) in [(8e-3, true), (20e-3, false)] {
        let options = RigOptions {
            objects: vec![object(off_m)],
            ..RigOptions::default()
        };
        let mut rig = VirtualRig::new(&robot, &options).expect("settles");
        // 0.2 kg take 0.2 s to come onto the gripper.
        for _ in 0..30 {
            rig.grip(Gripper::Closed);
        }
        assert_eq!(rig.objects()[0].held, held, "{off_m}");
        let payload_kg = rig.plant.surroundings.payload_kg;
        assert!(
            (payload_kg - if held { 0.2 } else { 0.0 }).abs() < 1e-9,
            "{payload_kg}"
        );
        for _ in 0..30 {
            rig.grip(Gripper::Open);
        }
        assert!(rig.plant.surroundings.payload_kg.abs() < 1e-9 && !rig.objects()[0].held);
        let left_m = Vector3::from(rig.objects()[0].grasp_m);
        assert_eq!(
            left_m == tip_m,
            held,
            "what was held lies where it was let go"
        );
    }
}

#[test]
fn a_stiffer_arm_gives_way_less() {
    let robot = RobotSpec::reference();
    let bend_m = |stiffness: f64| {
        let mut options = RigOptions::default();
        options.surroundings.stiffness = stiffness;
        let mut rig = VirtualRig::new(&robot, &options).expect("settles");
        rig.settle_at(&[15e3, -15e3, -15e3, 0.0, 0.0, 0.0])
            .expect("settles");
        rig.plant.truth().base_from_tip().translation.x
    };
    let ratio = bend_m(0.5) / bend_m(1.0);
    assert!((1.5..2.5).contains(&ratio), "{ratio}");
    let ratio = bend_m(2.0) / bend_m(1.0);
    assert!((0.4..0.6).contains(&ratio), "{ratio}");
}
