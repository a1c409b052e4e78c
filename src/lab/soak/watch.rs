//! Invariants of an endurance run: a port that checks every command on its way, and a check of every
//! snapshot.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use crate::drive::over_limits;
use crate::link::Order;
use crate::robot::RobotSpec;
use crate::signal::{CHAMBERS, Mode, PressureCommand, Snapshot, Stamp};
use crate::twin::{Arrivals, Clock, Port, TICK_S};

/// The pumps of a rig whose twin is SAFE are off after this time, s.
const PUMPS_OFF_S: f64 = 0.25;
/// The mode shown and the pumps that the boards report differ for no longer than this, and a tick, s; where a line
/// holds orders and reports back, for as much longer.
const DIFFER_S: f64 = 0.1 + TICK_S;
/// Violations that are reported in words.
const REPORTED: usize = 10;

/// Violations of the invariants.
#[derive(Debug, Default)]
pub struct Broken {
    /// Their number.
    pub count: u64,
    /// The first of them, one sentence each.
    pub reported: Vec<String>,
}

impl Broken {
    fn add(&mut self, text: impl FnOnce() -> String) {
        self.count += 1;
        if self.reported.len() < REPORTED {
            self.reported.push(text());
        }
    }
}

/// State that port, rig and loop share for the checks.
#[derive(Debug, Default)]
pub struct Seen {
    /// Violations of the invariants.
    pub broken: Broken,
    /// Since when the twin is SAFE, s.
    safe_since_s: Option<f64>,
    /// The last command sent, if nothing else came after it.
    last: Option<PressureCommand>,
    /// Pressure commands sent.
    pub sent: u64,
    last_stamp: Option<Stamp>,
    last_frame: Option<Stamp>,
    /// Whether pumps that run in SAFE were reported already.
    pumps_reported: bool,
    /// Since when the mode shown and the pumps reported differ, s; whether the boards were asked to vent.
    differ_since_s: Option<f64>,
    vents: bool,
    /// How much longer orders and reports take on the lines, s.
    detour_s: f64,
}

impl Seen {
    /// The mode shown is armed when the boards report that their pumps run, and only then.
    fn compare(&mut self, snapshot: &Snapshot) {
        let t_s = snapshot.stamp.seconds();
        let is_on = matches!(snapshot.mode, Mode::Hold | Mode::Moving | Mode::AtGoal);
        let vents = self.vents || snapshot.link.venting;
        let differs = |pumps: &Option<bool>| match pumps {
            Some(true) => !is_on && !vents,
            Some(false) => is_on,
            None => false,
        };
        if !snapshot.link.pumps.iter().any(differs) {
            self.differ_since_s = None;
            return;
        }
        let since_s = *self.differ_since_s.get_or_insert(t_s);
        if t_s - since_s > DIFFER_S + self.detour_s + 1e-6 {
            self.differ_since_s = Some(f64::INFINITY);
            let (mode, pumps) = (&snapshot.mode, snapshot.link.pumps);
            self.broken.add(|| {
                format!("{t_s:.3} s: {mode:?} is shown, but the boards report pumps {pumps:?}")
            });
        }
    }
}

/// [`Seen`], from several places.
#[derive(Clone, Default)]
pub struct Watch(Arc<Mutex<Seen>>);

impl Watch {
    /// The state so far.
    pub fn seen(&self) -> MutexGuard<'_, Seen> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Takes in how much longer orders and reports take on the lines now, s.
    pub fn set_detour(&self, detour_s: f64) {
        self.seen().detour_s = detour_s;
    }

    /// Checks the gauge pressures that the boards set at `t_s`, s, in the order of the chambers; `None`: the pump is off.
    pub fn look_at_pumps(&self, t_s: f64, set_pa: &[Option<f64>; CHAMBERS]) {
        let mut seen = self.seen();
        let late = !seen.vents && seen.safe_since_s.is_some_and(|s| t_s - s > PUMPS_OFF_S);
        let on = set_pa.iter().any(Option::is_some);
        if !(late && on) {
            seen.pumps_reported = false;
        } else if !seen.pumps_reported {
            seen.pumps_reported = true;
            seen.broken
                .add(|| format!("{t_s:.3} s: pumps run more than 250 ms after SAFE"));
        }
    }

    /// Checks a snapshot: its time increases, everything in it is finite, and its mode is what the pumps do.
    pub fn look_at(&self, snapshot: &Snapshot) {
        let mut seen = self.seen();
        seen.compare(snapshot);
        let Seen {
            broken,
            last_stamp,
            last_frame,
            ..
        } = &mut *seen;
        let t_s = snapshot.stamp.seconds();
        if last_stamp.is_some_and(|last| snapshot.stamp <= last) {
            broken.add(|| format!("{t_s:.3} s: the time of the snapshots does not go on"));
        }
        *last_stamp = Some(snapshot.stamp);
        if let Some(frame) = &snapshot.sensors {
            if last_frame.is_some_and(|last| frame.stamp < last) {
                broken.add(|| format!("{t_s:.3} s: the time of the frames goes back"));
            }
            *last_frame = Some(frame.stamp);
            let vector = frame.sensors.to_vector();
            if !vector
                .iter()
                .chain(&frame.chamber_pa)
                .all(|x| x.is_finite())
            {
                broken.add(|| format!("{t_s:.3} s: a sensor value is not finite"));
            }
        }
        if let Some(estimate) = &snapshot.estimate {
            let pose = estimate.base_from_tip.to_homogeneous();
            let mut all = pose.iter().chain(estimate.covariance.iter());
            if !all.all(|x| x.is_finite()) || !estimate.training_distance.is_finite() {
                broken.add(|| format!("{t_s:.3} s: the estimate is not finite"));
            }
        }
    }
}

/// A port that checks every command on its way.
pub struct Watched {
    inner: Box<dyn Port>,
    robot: RobotSpec,
    watch: Watch,
}

impl Watched {
    /// Puts the eye on `inner`.
    pub fn new(inner: Box<dyn Port>, robot: &RobotSpec, watch: &Watch) -> Self {
        Self {
            inner,
            robot: robot.clone(),
            watch: watch.clone(),
        }
    }
}

impl Port for Watched {
    fn clock(&self) -> Clock {
        self.inner.clock()
    }

    fn poll(&mut self, now: Stamp) -> Arrivals {
        self.inner.poll(now)
    }

    fn send(&mut self, now: Stamp, command: Option<&PressureCommand>) {
        {
            let mut seen = self.watch.seen();
            let t_s = now.seconds();
            if seen.safe_since_s.is_some() && command.is_some() {
                seen.broken
                    .add(|| format!("{t_s:.3} s: a pressure was commanded in SAFE"));
            }
            if let Some(command) = command {
                seen.sent += 1;
                let found = over_limits(&self.robot, seen.last.as_ref(), command);
                if let Some(what) = found {
                    seen.broken.add(|| format!("{t_s:.3} s: {what}"));
                }
            }
            seen.last = command.cloned();
        }
        self.inner.send(now, command);
    }

    fn order(&mut self, now: Stamp, order: Order) {
        {
            let mut seen = self.watch.seen();
            match order {
                Order::Stop | Order::CutSupply => {
                    seen.safe_since_s = Some(now.seconds());
                    seen.last = None;
                    seen.vents = false;
                }
                Order::Reset => {
                    seen.safe_since_s = None;
                    seen.vents = false;
                }
                Order::Vent => seen.vents = true,
            }
        }
        self.inner.order(now, order);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::signal::{Gripper, PressureLimits};

    struct Nothing;

    impl Port for Nothing {
        fn clock(&self) -> Clock {
            Clock::Lockstep
        }
        fn poll(&mut self, _now: Stamp) -> Arrivals {
            Arrivals::default()
        }
        fn send(&mut self, _now: Stamp, _command: Option<&PressureCommand>) {}
        fn order(&mut self, _now: Stamp, _order: Order) {}
    }

    #[test]
    fn what_is_broken_is_found() {
        let robot = RobotSpec::reference();
        let watch = Watch::default();
        let mut port = Watched::new(Box::new(Nothing), &robot, &watch);
        let at = Stamp::from_seconds;
        let wide = PressureLimits {
            min_pa: -1e6,
            max_pa: 1e6,
            rate_pa_s: 1e9,
        };
        let command = |t_s: f64, pa: f64| {
            let (all, open) = ([pa; CHAMBERS], Gripper::Open);
            PressureCommand::limited(at(t_s), all, open, None, &[pa; CHAMBERS], &wide)
        };
        let count = || watch.seen().broken.count;
        port.send(at(0.0), Some(&command(0.0, 0.0)));
        assert_eq!(count(), 0);
        // A leap, and a pressure beyond the bounds.
        port.send(at(0.01), Some(&command(0.01, 30e3)));
        assert_eq!(count(), 1);
        port.send(at(0.02), None);
        port.send(at(0.03), Some(&command(0.03, 60e3)));
        assert_eq!(count(), 2);
        // In SAFE nothing is sent, and pumps go off.
        port.order(at(1.0), Order::Stop);
        watch.look_at_pumps(1.2, &[Some(0.0); CHAMBERS]);
        assert_eq!(count(), 2);
        watch.look_at_pumps(1.3, &[Some(0.0); CHAMBERS]);
        assert_eq!(count(), 3);
        port.send(at(1.4), Some(&command(1.4, 0.0)));
        assert_eq!(count(), 4);
        port.order(at(2.0), Order::Reset);
        port.send(at(2.0), Some(&command(2.0, 0.0)));
        assert_eq!(count(), 4);
        // Time that stands still.
        let snapshot = Snapshot::default();
        watch.look_at(&snapshot);
        assert_eq!(count(), 4);
        watch.look_at(&snapshot);
        assert_eq!(count(), 5);
        assert_eq!(watch.seen().broken.reported.len(), 5);
        // Pumps that run although nothing is armed, for a tenth of a second and more.
        let runs = |t_s: f64| Snapshot {
            stamp: at(t_s),
            link: crate::signal::LinkStatus {
                pumps: [Some(false), Some(true)],
                ..Default::default()
            },
            ..Snapshot::default()
        };
        for k in 0..12 {
            watch.look_at(&runs(10.0 + 0.01 * f64::from(k)));
        }
        assert_eq!(count(), 5);
        watch.look_at(&runs(10.12));
        assert_eq!(count(), 6);
    }
}
