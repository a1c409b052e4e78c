//! The whole program against the boards' real firmware under simavr. Needs the firmware: `./test
//! firmware`. Times are the simulated chips' wherever something is held to a time.

use std::io::{BufRead, BufReader};
use std::ops::ControlFlow;
use std::path::PathBuf;
use std::process::{Child, Command as Process, Stdio};
use std::sync::{Arc, Mutex};

use springtwin::control::Gains;
use springtwin::learn::Model;
use springtwin::link::wire::Config;
use springtwin::link::{HostSession, LinkEvent, Origin};
use springtwin::rig::{RigBoard, RigOptions, VirtualRig};
use springtwin::robot::RobotSpec;
use springtwin::sensing::{Calibration, Sensing};
use springtwin::signal::{
    BOARDS, CHAMBERS, ControllerKind, Goal, Gripper, Mode, PressureCommand, Stamp,
};
use springtwin::twin::{
    Arrivals, Clock, Command, Event, Port, Runner, SETTLING_FRAMES, Twin, run_in_simulated_time,
};

use crate::conformance::firmware_folder;
use crate::program::json;

const LINE_STEP_S: f64 = 0.001;
/// How much too fast the rig's boards run, s/s.
const RIG_SKEWS: [f64; BOARDS] = [38e-6, -21e-6];

/// Where a variant of the firmware is; the empty one is the firmware as it is.
fn folder_of(variant: &str) -> PathBuf {
    let mut folder = firmware_folder().into_os_string();
    if !variant.is_empty() {
        folder.push(format!("-{variant}"));
    }
    PathBuf::from(folder)
}

/// A rig whose boards run the firmware in `folder`, and a host's end of the link.
struct Bench {
    rig: VirtualRig,
    host: HostSession,
    steps: u64,
    step_s: f64,
    to_rig: Vec<u8>,
    events: Vec<LinkEvent>,
}

impl Bench {
    fn new(folder: &std::path::Path) -> Self {
        let mut rig =
            VirtualRig::new(&RobotSpec::reference(), &RigOptions::default()).expect("settles");
        rig.use_firmware(folder).expect("the firmware starts");
        Self {
            rig,
            host: HostSession::new("firmware", Origin::Hardware, Config::built_in()),
            steps: 0,
            step_s: LINE_STEP_S,
            to_rig: Vec::new(),
            events: Vec::new(),
        }
    }

    fn t_s(&self) -> f64 {
        self.steps as f64 * self.step_s
    }

    /// One step; `host_runs` says whether the host does.
    fn step(&mut self, host_runs: bool) {
        self.steps += 1;
        let now = Stamp::from_seconds(self.t_s());
        if host_runs {
            self.to_rig.extend(self.host.poll(now));
        }
        let bytes = std::mem::take(&mut self.to_rig);
        let heard = self.rig.advance_lines(self.t_s(), [&bytes; BOARDS]);
        if host_runs {
            for (port, bytes) in heard.iter().enumerate() {
                self.host.on_port_bytes(port, now, bytes);
            }
            self.events
                .extend(std::iter::from_fn(|| self.host.next_event()));
        }
    }

    fn pumps(&self) -> bool {
        self.rig.set_pa().iter().any(Option::is_some)
    }
}

/// Version, layout and limits that do not match: the boards are watched, never armed, and the
/// refusal says which.
#[test]
fn firmware_that_does_not_match_is_refused_and_named() {
    for (variant, words) in [
        (
            "version",
            "speaks protocol version 2, this program version 1",
        ),
        ("schema", "uses message layout 12345678, this program"),
        ("config", "does not accept the pressure limits"),
    ] {
        let mut b = Bench::new(&folder_of(variant));
        for _ in 0..3000 {
            b.step(true);
            let limits = &RobotSpec::reference().pressure;
            let set_pa = [1e3; CHAMBERS];
            let command = PressureCommand::limited(
                Stamp::from_seconds(b.t_s()),
                set_pa,
                Gripper::Open,
                None,
                &set_pa,
                limits,
            );
            b.host.set_command(&command);
            assert!(!b.pumps(), "{variant}");
        }
        let said = b.host.refusal().expect("a refusal").to_string();
        println!("{variant}: {said}");
        assert!(said.starts_with("Board ") && said.contains(words), "{said}");
        assert!(!b.host.connected());
        let told = |e: &&LinkEvent| matches!(e, LinkEvent::Refused(_));
        assert_eq!(b.events.iter().filter(told).count(), 2, "each board once");
    }
}

/// The chips' clocks run as they are told, and the host finds out how.
#[test]
fn the_clocks_of_the_firmware_are_fitted() {
    let mut b = Bench::new(&firmware_folder());
    // What a step is wide, the pings are uncertain by.
    b.step_s = 0.25e-3;
    while b.t_s() < 25.0 {
        b.step(true);
        while b.host.next_frame().is_some() {}
    }
    let status = b.host.status(Stamp::from_seconds(b.t_s()));
    let mut starts_s = Vec::new();
    for (skew, clock) in RIG_SKEWS.iter().zip(&status.board_clock) {
        let clock = clock.expect("a fit");
        println!("a clock {:+.0} ppm off: {clock:?}", skew * 1e6);
        assert!(
            (clock.skew_ratio + skew).abs() < 10e-6,
            "{clock:?}, wanted {skew}"
        );
        assert!(clock.residual_s < 0.25e-3, "{clock:?}");
        starts_s.push(clock.offset_s + skew * b.t_s());
    }
    // Both chips were switched on at 0 and take equally long to start their clocks.
    println!("clocks started at {starts_s:?} s");
    assert!(
        starts_s.iter().all(|s| (0.0..1e-3).contains(s)),
        "{starts_s:?}"
    );
    assert!((starts_s[0] - starts_s[1]).abs() < 0.2e-3, "{starts_s:?}");
}

/// The twin's port to such a bench; the test holds the other end of `world`.
struct Lockstep(Arc<Mutex<World>>);

struct World {
    bench: Bench,
    /// The host's program hangs.
    frozen: bool,
}

impl Lockstep {
    fn with<T>(&self, act: impl FnOnce(&mut World) -> T) -> T {
        act(&mut self.0.lock().expect("not poisoned"))
    }
}

impl Port for Lockstep {
    fn clock(&self) -> Clock {
        Clock::Lockstep
    }

    fn poll(&mut self, now: Stamp) -> Arrivals {
        self.with(|w| {
            while w.bench.t_s() + LINE_STEP_S <= now.seconds() + 1e-9 {
                let runs = !w.frozen;
                w.bench.step(runs);
            }
            Arrivals {
                frames: std::iter::from_fn(|| w.bench.host.next_frame()).collect(),
                truths: Vec::new(),
                notices: w.bench.events.drain(..).map(|e| e.text()).collect(),
                status: w.bench.host.status(now),
            }
        })
    }

    fn send(&mut self, _: Stamp, command: Option<&PressureCommand>) {
        self.with(|w| match command {
            Some(command) => w.bench.host.set_command(command),
            None => w.bench.host.clear_command(),
        });
    }

    fn estop(&mut self, _: Stamp) {
        self.with(|w| w.bench.host.estop());
    }

    fn reset(&mut self, _: Stamp) {
        self.with(|w| w.bench.host.reset());
    }
}

pub fn twin(robot: &RobotSpec) -> Twin {
    let bytes = include_bytes!("../../assets/networks/reference.safetensors");
    let model = Model::from_bytes(bytes).expect("the shipped networks");
    let sensing = Sensing::new(robot, Calibration::virtual_rig());
    Twin::new(
        robot,
        model.into(),
        sensing,
        Gains::of(ControllerKind::Ours),
    )
}

/// Connect, arm, close the loop to a target; the host hangs for 300 ms; the boards stop their pumps
/// and latch; nothing moves until somebody resets and commands anew. All in simulated time.
#[test]
fn the_loop_closes_and_a_lost_heartbeat_latches_until_a_reset() {
    let robot = RobotSpec::reference();
    let world = Arc::new(Mutex::new(World {
        bench: Bench::new(&firmware_folder()),
        frozen: false,
    }));
    let mut runner = Runner::new(twin(&robot), Box::new(Lockstep(Arc::clone(&world))), &robot);
    let goal_m = [0.02, 0.01, -0.30];
    let mut story = Vec::new();
    let mut off_after_s = None;
    let mut moved_while_safe = false;
    run_in_simulated_time(&mut runner, |snapshot, events, commands| {
        let t_s = snapshot.stamp.seconds();
        let mut w = world.lock().expect("not poisoned");
        let next = story.len();
        match next {
            // Connected and settled: arm and go.
            0 if snapshot.link.connected && snapshot.link.frames > SETTLING_FRAMES => {
                assert!(
                    snapshot.link.simulated,
                    "the firmware says that its arm is simulated"
                );
                commands.extend([Command::Arm, Command::Goto(Goal::position(goal_m))]);
                story.push(t_s);
            }
            1 if events.iter().any(|e| matches!(e, Event::Reached { .. })) => {
                let tip_m = w
                    .bench
                    .rig
                    .plant
                    .observation()
                    .base_from_tip
                    .translation
                    .vector;
                let off_mm = (tip_m - nalgebra::Vector3::from(goal_m)).norm() * 1e3;
                println!(
                    "goal reached after {:.2} s, true tip {off_mm:.2} mm off",
                    t_s - story[0]
                );
                assert!(off_mm < 1.0, "{off_mm}");
                assert!(w.bench.pumps());
                w.frozen = true;
                story.push(t_s);
            }
            2 => {
                if !w.bench.pumps() {
                    off_after_s.get_or_insert(t_s - story[1]);
                }
                if t_s - story[1] > 0.3 {
                    w.frozen = false;
                    story.push(t_s);
                }
            }
            // The host is back, and would go on: the boards do not.
            3 | 4 => {
                moved_while_safe |= w.bench.pumps();
                if next == 3 && t_s - story[2] > 1.0 {
                    assert!(
                        matches!(&snapshot.mode, Mode::Safe(_)),
                        "{:?}",
                        snapshot.mode
                    );
                    commands.extend([Command::Arm, Command::Goto(Goal::position(goal_m))]);
                    story.push(t_s);
                } else if next == 4 && t_s - story[3] > 0.5 {
                    assert!(
                        matches!(&snapshot.mode, Mode::Safe(_)),
                        "{:?}",
                        snapshot.mode
                    );
                    commands.push(Command::Reset);
                    story.push(t_s);
                }
            }
            // Reset: still nothing moves by itself.
            5 => {
                moved_while_safe |= w.bench.pumps();
                if t_s - story[4] > 1.0 {
                    assert_eq!(snapshot.mode, Mode::Disarmed);
                    commands.extend([Command::Arm, Command::Goto(Goal::position(goal_m))]);
                    story.push(t_s);
                }
            }
            6 if events.iter().any(|e| matches!(e, Event::Reached { .. })) => {
                assert!(w.bench.pumps());
                return ControlFlow::Break(());
            }
            _ => {}
        }
        assert!(t_s < 60.0, "stuck after {story:?} in {:?}", snapshot.mode);
        ControlFlow::Continue(())
    });
    let off_after_s = off_after_s.expect("the pumps went off");
    println!(
        "pumps off {:.0} ms after the host's last word",
        off_after_s * 1e3
    );
    // 200 ms after the last heartbeat, of which there is one every 50 ms; a set point lives 150 ms.
    assert!((0.1..=0.26).contains(&off_after_s), "{off_after_s}");
    assert!(!moved_while_safe);
    let mut w = world.lock().expect("not poisoned");
    for board in w.bench.rig.boards_mut() {
        let RigBoard::Firmware(board) = board else {
            panic!("not the firmware")
        };
        println!(
            "last edge of a pump enable at {:.4} s of the chip's time",
            board.pump_edge_s()
        );
    }
}

/// The program says it in one sentence, too, and does not end as if all were well.
#[test]
fn the_program_says_which_mismatch_it_is() {
    for (variant, words) in [
        ("version", "protocol version 2"),
        ("config", "does not accept the pressure limits"),
    ] {
        let rig = RigProcess::start(variant);
        let run = [
            "run",
            "--headless",
            "--rig",
            &rig.ports,
            "--seconds",
            "9",
            "--target",
            "20,10,-300",
        ];
        let (code, said) = crate::program::refusal(&run);
        assert_eq!(code, 1);
        assert!(said.contains(words), "{said}");
    }
}

/// A rig process with the firmware behind two pseudo-terminals.
struct RigProcess {
    child: Child,
    ports: String,
}

impl RigProcess {
    /// With the firmware as it is, or a variant of it.
    fn start(variant: &str) -> Self {
        let mut child = Process::new(env!("CARGO_BIN_EXE_springtwin"))
            .args(["rig", "--with-parent", "--firmware"])
            .arg(folder_of(variant))
            .stdout(Stdio::piped())
            .spawn()
            .expect("the rig starts");
        let mut ports = String::new();
        let out = child.stdout.take().expect("its output");
        BufReader::new(out)
            .read_line(&mut ports)
            .expect("its ports");
        Self {
            child,
            ports: ports.trim().to_owned(),
        }
    }
}

impl Drop for RigProcess {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// The program as its users run it: two serial ports, a target; the boards are SAFE once it has
/// ended, refuse the next run, and take it with `--reset`.
#[test]
fn the_program_steers_the_firmware_over_two_ports() {
    let rig = RigProcess::start("");
    assert_eq!(rig.ports.split(',').count(), 2, "{}", rig.ports);
    let run = [
        "run",
        "--headless",
        "--rig",
        &rig.ports,
        "--seconds",
        "12",
        "--target",
        "20,10,-300",
        "--json",
    ];
    let first = json(&run);
    println!("{first}");
    assert_eq!(first["reached"], true);
    assert_eq!(first["simulated"], true);
    assert_eq!(first["frames_lost"], 0);
    for board in first["boards"].as_array().expect("boards") {
        assert!(board["rate_hz"].as_f64().expect("a rate") > 95.0);
        // How well clocks are fitted is asserted in lockstep, above: here an emulated board's clock
        // stands still for as long as the machine lets the board wait. It must not look like a jump.
        let residual_ms = board["clock"]["residual_ms"].as_f64().expect("a fit");
        assert!(residual_ms < 3.0, "{residual_ms}");
    }
    std::thread::sleep(std::time::Duration::from_millis(400));
    let (code, said) = crate::program::refusal(&run);
    assert_eq!(code, 1);
    assert!(
        said.contains("SAFE from before") && said.contains("the program was not heard"),
        "{said}"
    );
    let mut again = run.to_vec();
    again.push("--reset");
    assert_eq!(json(&again)["reached"], true);
}
