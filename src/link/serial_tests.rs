//! The link against boards behind real pseudo-terminals: what happens, and in which order. How long it takes is measured
//! on simulated time, by the integration tests.

use std::fs::File;
use std::os::fd::{AsFd, OwnedFd};
use std::path::PathBuf;

use nix::fcntl::{FcntlArg, OFlag, fcntl};
use nix::pty::openpty;
use nix::unistd::ttyname;

use super::*;
use crate::link::wire::{NO_RIG, TICK_RATE_HZ, fault};
use crate::rig::board::{Board, BoardSetup, Readings, SpringReading};
use crate::rig::clock::Clock;
use crate::signal::{Gripper, ImuRaw, PressureLimits};

/// How long anything is waited for: it measures nothing.
const PATIENCE: Duration = Duration::from_secs(120);

#[expect(
    clippy::disallowed_methods,
    reason = "a real port is waited for in real time"
)]
fn start() -> Instant {
    Instant::now()
}

/// Boards on a pseudo-terminal, run by a thread until unplugged.
struct Rig {
    device: PathBuf,
    // Open, so that the terminal exists before the link opens it. Closed when unplugged.
    slave: Option<OwnedFd>,
    stop: Arc<AtomicBool>,
    moving: Arc<AtomicBool>,
    status: Arc<AtomicU64>,
    thread: Option<JoinHandle<()>>,
}

impl Rig {
    fn plug_in(ids: &[u8], nonce: u32) -> Self {
        let pty = openpty(None, None).expect("a pseudo-terminal");
        let device = ttyname(pty.slave.as_fd()).expect("its name");
        fcntl(pty.master.as_fd(), FcntlArg::F_SETFL(OFlag::O_NONBLOCK)).expect("non-blocking");
        let mut master = File::from(pty.master);
        let mut boards: Vec<Board> = ids
            .iter()
            .map(|id| {
                Board::new(BoardSetup {
                    id: *id,
                    boot_nonce: nonce,
                    tick_rate_hz: TICK_RATE_HZ,
                    clock: Clock::steady(50e-6),
                    clock_offset_s: 7.0,
                    rig: NO_RIG,
                })
            })
            .collect();
        let (stop, moving, status) = (
            Arc::new(AtomicBool::new(false)),
            Arc::new(AtomicBool::new(false)),
            Arc::new(AtomicU64::new(0)),
        );
        let (stopped, moves, says) = (Arc::clone(&stop), Arc::clone(&moving), Arc::clone(&status));
        let t0 = start();
        let run = move || {
            let readings = Readings {
                springs: [Some(SpringReading {
                    count: 11_000,
                    gate_ticks: 16_000,
                }); 6],
                imus: [Some(ImuRaw::default()); 2],
                chamber_pa: [Some(500.0); 3],
                stop_open: false,
            };
            let mut buffer = [0; 4096];
            while !stopped.load(Ordering::Relaxed) {
                let n = master.read(&mut buffer).unwrap_or(0);
                for board in &mut boards {
                    let t_s = t0.elapsed().as_secs_f64();
                    board.on_bytes(t_s, &buffer[..n]);
                    let bytes = board.poll(t_s, &readings);
                    let _ = master.write(&bytes);
                }
                moves.store(
                    boards.iter().all(|b| b.setpoint_pa().is_some()),
                    Ordering::Relaxed,
                );
                let bits = boards.iter().fold(0, |a, b| a | b.status());
                says.store(u64::from(bits), Ordering::Relaxed);
                std::thread::sleep(Duration::from_millis(1));
            }
        };
        let thread = std::thread::Builder::new()
            .name("test rig".into())
            .spawn(run)
            .expect("a thread");
        Self {
            device,
            slave: Some(pty.slave),
            stop,
            moving,
            status,
            thread: Some(thread),
        }
    }

    fn moving(&self) -> bool {
        self.moving.load(Ordering::Relaxed)
    }

    fn has_status(&self, bit: u16) -> bool {
        self.status.load(Ordering::Relaxed) & u64::from(bit) != 0
    }

    fn unplug(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(t) = self.thread.take() {
            t.join().expect("the test rig ends");
        }
        self.slave = None;
    }

    fn name(&self) -> String {
        self.device.display().to_string()
    }
}

impl Drop for Rig {
    fn drop(&mut self) {
        self.unplug();
    }
}

fn connect(names: &str) -> SerialLink {
    open(names, start(), Config::built_in(), Origin::Simulated).expect("the link opens")
}

fn command() -> PressureCommand {
    let limits = PressureLimits {
        min_pa: -40e3,
        max_pa: 40e3,
        rate_pa_s: 12e3,
    };
    PressureCommand::limited(
        Stamp::ZERO,
        [1e3; 6],
        Gripper::Open,
        None,
        &[0.0; 6],
        &limits,
    )
}

/// Keeps a link going until `enough` of what came in; gives all of it.
fn until(
    link: &SerialLink,
    commanding: Option<&PressureCommand>,
    mut enough: impl FnMut(&[LinkInput]) -> bool,
) -> Vec<LinkInput> {
    let t0 = start();
    let mut all = Vec::new();
    while t0.elapsed() < PATIENCE {
        while let Some(input) = link.try_recv() {
            all.push(input);
        }
        if enough(&all) {
            return all;
        }
        link.tick();
        if let Some(c) = commanding {
            // A busy computer may leave the link no time: then the next one counts.
            let _ = link.send(LinkOutput::Command(c.clone()));
        }
        std::thread::sleep(Duration::from_millis(5));
    }
    panic!("waited in vain; came in: {all:?}");
}

/// Commands until all rigs move. A computer too busy for heartbeats makes the boards SAFE, rightly:
/// then they are reset.
fn get_moving(link: &SerialLink, rigs: &[&Rig]) {
    until(link, Some(&command()), |_| {
        if rigs.iter().any(|r| r.has_status(fault::SAFE)) {
            let _ = link.send(LinkOutput::Order(Order::Reset));
        }
        rigs.iter().all(|r| r.moving())
    });
}

fn frames(all: &[LinkInput]) -> Vec<&RawFrame> {
    all.iter()
        .filter_map(|i| match i {
            LinkInput::Frame(f) => Some(f),
            _ => None,
        })
        .collect()
}

/// How many frames hold everything.
fn whole(all: &[LinkInput]) -> usize {
    let is_whole = |f: &&&RawFrame| f.present == RawFrame::ALL_PRESENT;
    frames(all).iter().filter(is_whole).count()
}

fn connected(all: &[LinkInput]) -> bool {
    let last = all.iter().rev().find_map(|i| match i {
        LinkInput::Status(s) => Some(s.connected),
        _ => None,
    });
    last == Some(true)
}

fn event(all: &[LinkInput], wanted: impl Fn(&LinkEvent) -> bool) -> bool {
    all.iter()
        .any(|i| matches!(i, LinkInput::Event(e) if wanted(e)))
}

#[test]
fn frames_and_commands_cross_a_real_terminal() {
    let rig = Rig::plug_in(&[0, 1], 1);
    let link = connect(&rig.name());
    let all = until(&link, None, |all| whole(all) >= 30 && connected(all));
    let all = frames(&all);
    let last = all.iter().rfind(|f| f.present == RawFrame::ALL_PRESENT);
    let last = last.expect("thirty of them");
    assert_eq!(last.spring_counts, [11_000; 12]);
    assert!((last.chamber_pa[4] - 500.0).abs() <= 1.0);
    get_moving(&link, &[&rig]);
    link.send(LinkOutput::Order(Order::Stop))
        .expect("a stop gets through");
    until(&link, Some(&command()), |_| rig.has_status(fault::ESTOP));
    assert!(!rig.moving());
    get_moving(&link, &[&rig]);
    link.close();
    wait_for(&rig, fault::ENDED);
    assert!(!rig.moving());
}

fn wait_for(rig: &Rig, status: u16) {
    let t0 = start();
    while !rig.has_status(status) {
        assert!(t0.elapsed() < PATIENCE, "{status:#x} in vain");
        std::thread::sleep(Duration::from_millis(1));
    }
}

/// A caller that stands still: its boards are stopped by the link, at once when STOP is pressed meanwhile.
#[test]
fn a_caller_that_stands_still_is_stopped_and_stop_goes_past_it() {
    let rig = Rig::plug_in(&[0, 1], 1);
    let link = connect(&rig.name());
    let line = link.stop_line();
    until(&link, None, connected);
    get_moving(&link, &[&rig]);
    line.press();
    wait_for(&rig, fault::ESTOP);
    assert!(!rig.moving());
    // What was ordered before the caller has heard of the press is older than it.
    for order in [Order::Reset, Order::Vent, Order::Reset] {
        link.tick();
        let _ = link.send(LinkOutput::Order(order));
        std::thread::sleep(Duration::from_millis(50));
    }
    assert!(rig.has_status(fault::ESTOP) && !rig.moving());
    link.send(LinkOutput::Order(Order::Stop))
        .expect("a stop gets through");
    get_moving(&link, &[&rig]);
    // On a busy machine the boards' own patience may end first.
    wait_for(&rig, fault::SAFE);
    assert!(!rig.moving());
    // What a caller says that has not ticked since moves nothing.
    let _ = link.send(LinkOutput::Order(Order::Reset));
    let t0 = start();
    while rig.has_status(fault::SAFE) {
        assert!(t0.elapsed() < PATIENCE, "it is not reset");
        std::thread::sleep(Duration::from_millis(1));
    }
    std::thread::sleep(Duration::from_millis(100));
    let _ = link.send(LinkOutput::Command(command()));
    std::thread::sleep(Duration::from_millis(300));
    assert!(!rig.moving());
    get_moving(&link, &[&rig]);
}

#[test]
fn a_port_that_is_lost_stops_the_board_on_the_other() {
    let (a, mut b) = (Rig::plug_in(&[0], 1), Rig::plug_in(&[1], 2));
    let link = connect(&format!("{}, {}", a.name(), b.name()));
    until(&link, None, |all| whole(all) >= 20 && connected(all));
    get_moving(&link, &[&a, &b]);
    b.unplug();
    let t0 = start();
    wait_for(&a, fault::ENDED);
    println!(
        "the other board is off {:.0} ms after the loss",
        t0.elapsed().as_secs_f64() * 1e3
    );
    assert!(!a.moving());
}

#[test]
fn a_board_each_on_two_terminals_makes_one_stream() {
    let (a, b) = (Rig::plug_in(&[0], 1), Rig::plug_in(&[1], 2));
    let link = connect(&format!("{}, {}", a.name(), b.name()));
    until(&link, None, |all| whole(all) >= 20 && connected(all));
    get_moving(&link, &[&a, &b]);
}

#[test]
fn an_unplugged_port_is_noticed_reopened_and_does_not_move_by_itself() {
    // A name that outlives the device behind it, as udev gives.
    let folder = std::env::temp_dir().join(format!("springtwin-link-{}", std::process::id()));
    std::fs::create_dir_all(&folder).expect("a folder");
    let name = folder.join("arm");
    let _ = std::fs::remove_file(&name);
    let plug_in = |nonce| {
        let _ = std::fs::remove_file(&name);
        let rig = Rig::plug_in(&[0, 1], nonce);
        std::os::unix::fs::symlink(&rig.device, &name).expect("a link");
        rig
    };
    let mut rig = plug_in(1);
    let link = connect(&name.display().to_string());
    until(&link, None, connected);
    // Unplugged with its supply kept, then restarted meanwhile, and again.
    let mut known = 1;
    for nonce in [1, 3, 3, 4] {
        get_moving(&link, &[&rig]);
        rig.unplug();
        let gone = |e: &LinkEvent| matches!(e, LinkEvent::Disconnected { .. });
        until(&link, None, |all| event(all, gone));
        rig = plug_in(nonce);
        let all = until(&link, None, |all| connected(all) && frames(all).len() > 10);
        for board in 0..2 {
            let back = event(&all, |e| *e == LinkEvent::BoardBack { board });
            let rebooted = event(&all, |e| *e == LinkEvent::BoardRebooted { board });
            assert_eq!(
                (back, rebooted),
                (nonce == known, nonce != known),
                "board {board}"
            );
        }
        known = nonce;
        let _ = link.send(LinkOutput::ClearCommand);
    }

    get_moving(&link, &[&rig]);
    rig.unplug();
    let again = plug_in(9);
    // The old command still comes, as from a twin that has not noticed.
    let mut ready: Option<Instant> = None;
    until(&link, Some(&command()), |all| {
        assert!(!again.moving(), "moves by itself");
        if event(all, |e| matches!(e, LinkEvent::Reconnected)) && connected(all) {
            ready.get_or_insert_with(start);
        }
        ready.is_some_and(|t| t.elapsed() > Duration::from_millis(300))
    });
    let _ = link.send(LinkOutput::ClearCommand);
    get_moving(&link, &[&again]);
    drop(link);
    let _ = std::fs::remove_dir_all(&folder);
}

#[test]
fn what_nobody_fetches_is_dropped_and_counted() {
    let rig = Rig::plug_in(&[0, 1], 1);
    let link = connect(&rig.name());
    let t0 = start();
    while link.dropped() < 20 && t0.elapsed() < PATIENCE {
        std::thread::sleep(Duration::from_millis(20));
    }
    assert!(link.dropped() >= 20);
    until(&link, None, |all| all.len() >= INPUT_QUEUE);
}

#[test]
fn refusals_name_the_port_and_its_owner() {
    let e = open("", start(), Config::built_in(), Origin::Hardware).expect_err("no name");
    assert!(matches!(e, LinkError::Ports(_)), "{e}");
    let nowhere = "/dev/springtwin-none";
    let e = open(nowhere, start(), Config::built_in(), Origin::Hardware).expect_err("no such port");
    assert!(e.to_string().contains(nowhere), "{e}");
    assert!(e.to_string().contains("Check the cable"), "{e}");

    let rig = Rig::plug_in(&[0, 1], 1);
    let _first = connect(&rig.name());
    let e = open(&rig.name(), start(), Config::built_in(), Origin::Hardware).expect_err("busy");
    let said = e.to_string();
    if cfg!(target_os = "linux") {
        let own = format!("process {}", std::process::id());
        assert!(said.contains(&own), "{said}");
    }
}
