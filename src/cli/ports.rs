//! The two ways to the boards: a rig in this process on simulated time, and a serial port.

use springtwin::link::{HostSession, Origin};
use springtwin::rig::{RigOptions, VirtualRig};
use springtwin::robot::RobotSpec;
use springtwin::signal::{GroundTruth, PressureCommand, Stamp, TruthSource};
use springtwin::sim::SimError;
use springtwin::twin::{Arrivals, Port};
use springtwin::link::wire::Config;

/// The line is looked at this often in simulated time, s.
const LINE_STEP_S: f64 = 0.001;

/// A virtual rig in this process. Bytes still pass through the wire protocol.
pub struct InProcess {
    rig: VirtualRig,
    session: HostSession,
    line_steps: u64,
    to_rig: Vec<u8>,
}

impl InProcess {
    /// A settled rig with booting boards.
    pub fn new(robot: &RobotSpec, options: &RigOptions, config: Config) -> Result<Self, SimError> {
        Ok(Self {
            rig: VirtualRig::new(robot, options)?,
            session: HostSession::new("virtual rig", Origin::Simulated, config),
            line_steps: 0,
            to_rig: Vec::new(),
        })
    }
}

impl Port for InProcess {
    fn poll(&mut self, now: Stamp) -> Arrivals {
        let mut arrivals = Arrivals::default();
        while (self.line_steps + 1) as f64 * LINE_STEP_S <= now.seconds() + 1e-9 {
            self.line_steps += 1;
            let t_s = self.line_steps as f64 * LINE_STEP_S;
            let at = Stamp::from_seconds(t_s);
            self.to_rig.extend(self.session.poll(at));
            let from_rig = self.rig.advance(t_s, &std::mem::take(&mut self.to_rig));
            self.session.on_bytes(at, &from_rig);
            if self.line_steps.is_multiple_of(10) {
                arrivals.truths.push(GroundTruth {
                    stamp: at,
                    base_from_tip: self.rig.mocap_pose(),
                    source: TruthSource::VirtualRig,
                });
            }
        }
        arrivals.frames = std::iter::from_fn(|| self.session.next_frame()).collect();
        arrivals.notices = std::iter::from_fn(|| self.session.next_event()).map(|e| e.text()).collect();
        arrivals.status = self.session.status(now);
        arrivals
    }

    fn send(&mut self, _now: Stamp, command: Option<&PressureCommand>) {
        match command {
            Some(command) => self.session.set_command(command),
            None => self.session.clear_command(),
        }
    }

    fn estop(&mut self, _now: Stamp) {
        self.session.estop();
    }

    fn reset(&mut self, _now: Stamp) {
        self.session.reset();
    }
}
