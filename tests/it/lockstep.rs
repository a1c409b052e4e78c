//! A virtual rig and the host's end of the link in lockstep, on simulated time: no thread, no port, no clock of the
//! computer. What is measured here is the same on an idle and on a busy machine.

use std::path::Path;
use std::sync::{Arc, Mutex};

use springtwin::control::Gains;
use springtwin::learn::Model;
use springtwin::link::serial::{ALIVE_S, REOPEN_PERIOD_S};
use springtwin::link::wire::Config;
use springtwin::link::{HostSession, LinkEvent, Order, Origin};
use springtwin::rig::{RigOptions, VirtualRig};
use springtwin::robot::RobotSpec;
use springtwin::sensing::{Calibration, Sensing};
use springtwin::signal::{BOARDS, CHAMBERS, ControllerKind, GroundTruth, PressureCommand, Stamp};
use springtwin::twin::{Arrivals, Clock, Port, Runner, Twin};

/// The line is looked at this often, s.
pub const LINE_STEP_S: f64 = 0.001;

/// The rig at one of its steps.
#[derive(Clone, Copy, Debug)]
pub struct Moment {
    /// When, s.
    pub t_s: f64,
    /// Whether a pump of each board runs.
    pub pumps: [bool; BOARDS],
    /// What the gauges read, Pa; NaN where one reads nothing.
    pub gauge_pa: [f64; CHAMBERS],
    /// Frames that a fault has hit.
    pub hits: u64,
}

/// The host's end of a link to boards that nobody stands beside.
pub fn simulated_host() -> HostSession {
    HostSession::new("lockstep", Origin::Simulated, Config::built_in())
}

/// A rig and a host's end of the link.
pub struct World {
    pub rig: VirtualRig,
    pub host: HostSession,
    pub events: Vec<LinkEvent>,
    /// How wide a step is, s.
    pub step_s: f64,
    /// The host's program hangs, or is dead: it neither hears nor speaks.
    pub frozen: bool,
    /// When the twin last asked for its input, s; nobody minds where no twin is.
    ticked_s: Option<f64>,
    /// Every step, when it is wanted.
    pub moments: Option<Vec<Moment>>,
    /// Motion capture, when it is wanted.
    pub truths: Option<Vec<GroundTruth>>,
    steps: u64,
    to_rig: Vec<u8>,
    /// While the port is gone: when it is tried next, s.
    retry_s: Option<f64>,
}

impl World {
    /// With emulated boards, or with those that run the firmware in a folder.
    pub fn new(firmware: Option<&Path>) -> Self {
        Self::of(&RigOptions::default(), firmware)
    }

    /// The same, of a rig that is not the default one.
    pub fn of(options: &RigOptions, firmware: Option<&Path>) -> Self {
        let robot = RobotSpec::reference();
        let mut rig = VirtualRig::new(&robot, options).expect("settles");
        let host = match firmware {
            Some(folder) => {
                rig.use_firmware(folder).expect("the firmware starts");
                HostSession::new("lockstep", Origin::Hardware, Config::built_in())
            }
            None => simulated_host(),
        };
        Self {
            rig,
            host,
            events: Vec::new(),
            step_s: LINE_STEP_S,
            frozen: false,
            ticked_s: None,
            moments: None,
            truths: None,
            steps: 0,
            to_rig: Vec::new(),
            retry_s: None,
        }
    }

    pub fn t_s(&self) -> f64 {
        self.steps as f64 * self.step_s
    }

    /// One step of both.
    pub fn step(&mut self) {
        self.steps += 1;
        let (t_s, now) = (self.t_s(), Stamp::from_seconds(self.t_s()));
        let hears = !self.frozen && self.has_port(now);
        if hears {
            let is_alive = self.ticked_s.is_none_or(|at| t_s - at <= ALIVE_S);
            self.host.advance(now);
            self.host.control_is_alive(is_alive);
            self.to_rig.extend(self.host.poll(now));
        }
        let bytes = std::mem::take(&mut self.to_rig);
        let heard = self.rig.advance_lines(t_s, [&bytes; BOARDS]);
        if hears {
            for (port, bytes) in heard.iter().enumerate() {
                self.host.on_port_bytes(port, now, bytes);
            }
        }
        if !self.frozen {
            self.events
                .extend(std::iter::from_fn(|| self.host.next_event()));
        }
        if let Some(truths) = &mut self.truths {
            truths.extend(self.rig.mocap_sample(t_s));
        }
        if let Some(moments) = &mut self.moments {
            moments.push(Moment {
                t_s,
                pumps: std::array::from_fn(|b| self.rig.set_pa()[3 * b].is_some()),
                gauge_pa: std::array::from_fn(|i| {
                    self.rig.readings()[i / 3].chamber_pa[i % 3].unwrap_or(f64::NAN)
                }),
                hits: self.rig.faults.hits(),
            });
        }
    }

    /// Whether the host has its port. One that is gone is tried again as often as a real one is.
    fn has_port(&mut self, now: Stamp) -> bool {
        let plugged = !self.rig.faults.is_unplugged();
        match self.retry_s {
            None if !plugged => {
                self.host.disconnected(now, "unplugged");
                self.retry_s = Some(now.seconds() + REOPEN_PERIOD_S);
            }
            Some(due_s) if now.seconds() >= due_s => {
                if plugged {
                    self.host.reconnected(now);
                    self.retry_s = None;
                } else {
                    self.retry_s = Some(now.seconds() + REOPEN_PERIOD_S);
                }
            }
            _ => {}
        }
        self.retry_s.is_none()
    }

    /// Steps until `t_s`.
    pub fn run_to(&mut self, t_s: f64) {
        while self.t_s() + self.step_s <= t_s + 1e-9 {
            self.step();
        }
    }

    /// Whether any pump runs.
    pub fn pumps(&self) -> bool {
        self.rig.set_pa().iter().any(Option::is_some)
    }
}

/// The twin's port to such a world; the test holds the other end.
pub struct Lockstep(Arc<Mutex<World>>);

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
            w.run_to(now.seconds());
            w.ticked_s = Some(now.seconds());
            Arrivals {
                frames: std::iter::from_fn(|| w.host.next_frame()).collect(),
                truths: w.truths.as_mut().map(std::mem::take).unwrap_or_default(),
                notices: w.events.drain(..).collect(),
                status: w.host.status(now),
            }
        })
    }

    fn send(&mut self, _: Stamp, command: Option<&PressureCommand>) {
        self.with(|w| match command {
            Some(command) => w.host.set_command(command),
            None => w.host.clear_command(),
        });
    }

    fn order(&mut self, _: Stamp, order: Order) {
        self.with(|w| w.host.order(order));
    }
}

/// A twin of the reference robot with the shipped networks and the virtual rig's calibration.
pub fn twin(robot: &RobotSpec) -> Twin {
    let bytes = include_bytes!("../../assets/networks/unit-1/reference.safetensors");
    let model = Model::from_bytes(bytes).expect("the shipped networks");
    twin_with(robot, model, Calibration::virtual_rig())
}

/// A twin with other networks and another calibration.
pub fn twin_with(robot: &RobotSpec, model: Model, calibration: Calibration) -> Twin {
    let sensing = Sensing::new(robot, calibration);
    Twin::new(
        robot,
        model.into(),
        sensing,
        Gains::of(ControllerKind::NullSpaceQp),
    )
}

/// A twin that steers the rig of a world, and the world.
pub fn runner(world: World) -> (Runner, Arc<Mutex<World>>) {
    runner_of(world, twin(&RobotSpec::reference()))
}

/// The same with another twin.
pub fn runner_of(world: World, mut twin: Twin) -> (Runner, Arc<Mutex<World>>) {
    let robot = RobotSpec::reference();
    let world = Arc::new(Mutex::new(world));
    let port = Box::new(Lockstep(Arc::clone(&world)));
    twin.accept_simulated_boards();
    (Runner::new(twin, port, &robot), world)
}
