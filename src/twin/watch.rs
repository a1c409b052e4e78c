//! The live monitor beside the twin. It judges in a thread of its own where the twin keeps to real time, and within the tick
//! where no clock waits.

use std::sync::Arc;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};

use super::command::Event;
use crate::gap::{Commissioned, GapError, Measured, Monitor};
use crate::robot::RobotSpec;
use crate::signal::{Disagreement, SensorErrors, Snapshot, Stamp};

/// Frames that wait for the thread at most: a few seconds' worth. Where it does not keep up, the monitor begins again.
const WAITING: usize = 500;
/// Findings that wait for the twin at most: one comes in a second.
const FOUND: usize = 8;
/// Twin and arm agree again below this share of the limit.
const AGREE: f64 = 0.8;

/// A monitor of the live arm.
pub struct Watch {
    place: Place,
    /// By which the readings of the twin are corrected: the model has these errors.
    corrected_by: SensorErrors,
    /// The newest frame that it has taken.
    taken: Option<Stamp>,
    newest: Option<Disagreement>,
    /// Whether it has reported that they disagree.
    reported: bool,
    /// Findings up to here are of a model that is no longer the twin's own.
    outdated: Option<Stamp>,
    /// The robot whose model the monitor has not been given yet.
    wanted: Option<Arc<RobotSpec>>,
}

/// What the monitor is given.
#[expect(
    clippy::large_enum_variant,
    reason = "nearly all of them are measured, a hundred per second"
)]
enum Given {
    Measured(Measured),
    /// The effect of this name counts no longer, or again.
    Mute(String, bool),
    /// The monitor of another model.
    Model(Arc<RobotSpec>),
}

/// A monitor, and the rig that it was made of.
struct Judge {
    monitor: Monitor,
    rig: Commissioned,
}

impl Judge {
    /// Judges by the model of this robot from now on, with what was muted; by the one before where there is none.
    fn take_model(&mut self, robot: &RobotSpec) {
        match Monitor::new(robot, &self.rig) {
            Ok(mut monitor) => {
                for name in self.monitor.muted() {
                    monitor.mute(&name, true);
                }
                self.monitor = monitor;
            }
            Err(e) => log::warn!("twin and arm are compared by the model of before: {e}"),
        }
    }
}

enum Place {
    Here(Box<Judge>),
    Beside {
        given: SyncSender<Given>,
        found: Receiver<Disagreement>,
    },
    /// It could not be started.
    Nowhere,
}

impl Watch {
    /// Of the commissioned rig that the twin of `robot` will run on.
    ///
    /// # Errors
    /// [`GapError`] when the baseline is of another robot.
    pub fn new(robot: &RobotSpec, rig: Commissioned) -> Result<Self, GapError> {
        let monitor = Monitor::new(robot, &rig)?;
        Ok(Self {
            place: Place::Here(Box::new(Judge { monitor, rig })),
            corrected_by: SensorErrors::default(),
            taken: None,
            newest: None,
            reported: false,
            outdated: None,
            wanted: None,
        })
    }

    /// The readings of the twin are corrected by these errors.
    pub(super) fn corrected_by(&mut self, errors: SensorErrors) {
        self.corrected_by = errors;
    }

    /// Compares the arm with the model of this robot from now on; it judges again once that has settled.
    pub(super) fn compare_with(&mut self, robot: &Arc<RobotSpec>) {
        self.wanted = Some(Arc::clone(robot));
        self.hand_over();
    }

    /// Gives the monitor the model that it is to compare with; one that is behind gets it with a later tick.
    fn hand_over(&mut self) {
        let Some(robot) = self.wanted.take() else {
            return;
        };
        match &mut self.place {
            Place::Here(judge) => judge.take_model(&robot),
            Place::Beside { given, .. } => {
                if given.try_send(Given::Model(Arc::clone(&robot))).is_err() {
                    self.wanted = Some(robot);
                    return;
                }
            }
            Place::Nowhere => {}
        }
        (self.newest, self.outdated) = (None, self.taken);
    }

    /// Lets a thread of its own judge. The thread ends when this is dropped.
    pub(super) fn beside(&mut self) {
        let Place::Here(mut judge) = std::mem::replace(&mut self.place, Place::Nowhere) else {
            return;
        };
        let (given, taken) = sync_channel::<Given>(WAITING);
        let (finds, found) = sync_channel(FOUND);
        let work = move || {
            for given in taken {
                match given {
                    Given::Measured(m) => {
                        if let Some(new) = judge.monitor.take(m) {
                            let _ = finds.try_send(new);
                        }
                    }
                    Given::Mute(name, muted) => {
                        judge.monitor.mute(&name, muted);
                    }
                    Given::Model(robot) => judge.take_model(&robot),
                }
            }
        };
        let thread = std::thread::Builder::new().name("monitor".to_owned());
        match thread.spawn(work) {
            Ok(_) => self.place = Place::Beside { given, found },
            Err(e) => log::warn!("twin and arm are not compared: no thread can be started ({e})"),
        }
    }

    /// The effect of this name counts no longer, or again.
    pub(super) fn mute(&mut self, name: &str, muted: bool) {
        match &mut self.place {
            Place::Here(judge) => {
                judge.monitor.mute(name, muted);
            }
            Place::Beside { given, .. } => {
                let _ = given.try_send(Given::Mute(name.to_owned(), muted));
            }
            Place::Nowhere => {}
        }
    }

    /// Takes what a snapshot measured, adds what is known of the disagreement to it, and reports when it begins and ends.
    pub(super) fn update(&mut self, snapshot: &mut Snapshot, events: &mut Vec<Event>) {
        self.hand_over();
        if let Some(frame) = &snapshot.sensors
            && self.taken.is_none_or(|taken| frame.stamp > taken)
        {
            self.taken = Some(frame.stamp);
            let measured = Measured {
                t_s: frame.stamp.seconds(),
                chamber_pa: frame.chamber_pa,
                sensors: self.corrected_by.read(&frame.measured()),
                payload_kg: snapshot.payload_kg,
            };
            match &mut self.place {
                Place::Here(judge) => {
                    if let Some(new) = judge.monitor.take(measured) {
                        self.newest = Some(new);
                    }
                }
                Place::Beside { given, .. } => {
                    let _ = given.try_send(Given::Measured(measured));
                }
                Place::Nowhere => {}
            }
        }
        if let Place::Beside { found, .. } = &self.place {
            let until_s = self.outdated.map_or(f64::NEG_INFINITY, Stamp::seconds);
            let current = found.try_iter().filter(|d| d.t_s > until_s).last();
            self.newest = current.or(self.newest.take());
        }
        if let Some(newest) = &self.newest {
            let stamp = snapshot.stamp;
            if newest.is_off() && !self.reported {
                self.reported = true;
                let text = format!(
                    "Twin and arm disagree since {:.0} s ago, most in {}.{} What is missing in the model, Gap finds.",
                    (newest.t_s - newest.since_s).max(0.0),
                    newest.channel,
                    newest.looks_like()
                );
                events.push(Event::Warning { stamp, text });
            } else if newest.ratio < AGREE && self.reported {
                self.reported = false;
                let text = "Twin and arm agree again.".to_owned();
                events.push(Event::Notice { stamp, text });
            }
        }
        snapshot.is_monitored = !matches!(self.place, Place::Nowhere);
        snapshot.disagreement = self.newest.clone();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_disagreement_is_reported_when_it_begins_and_when_it_ends() {
        let (given, _taken) = sync_channel(1);
        let (finds, found) = sync_channel(8);
        let mut watch = Watch {
            place: Place::Beside { given, found },
            corrected_by: SensorErrors::default(),
            taken: None,
            newest: None,
            reported: false,
            outdated: None,
            wanted: None,
        };
        let mut texts = Vec::new();
        let mut shown = Vec::new();
        for (k, ratio) in [0.5, 1.2, 1.1, 0.9, 1.1, 0.7, 0.6].into_iter().enumerate() {
            let t_s = 60.0 + k as f64;
            let new = Disagreement {
                t_s,
                ratio,
                channel: "spring 4".to_owned(),
                since_s: 55.0,
                likely: vec!["creep".to_owned(), "spring lag".to_owned()],
                muted: Vec::new(),
            };
            finds.send(new).expect("waits");
            let mut snapshot = Snapshot {
                stamp: Stamp::from_seconds(t_s + 0.5),
                ..Snapshot::default()
            };
            let mut events = Vec::new();
            watch.update(&mut snapshot, &mut events);
            shown.push(snapshot.disagreement.map_or(f64::NAN, |d| d.ratio));
            texts.extend(events.iter().map(|e| (k, e.text())));
        }
        assert_eq!(shown, [0.5, 1.2, 1.1, 0.9, 1.1, 0.7, 0.6]);
        assert_eq!(texts.len(), 2, "{texts:?}");
        assert_eq!((texts[0].0, texts[1].0), (1, 5));
        assert!(
            texts[0]
                .1
                .contains("since 6 s ago, most in spring 4. It looks like creep or spring lag."),
            "{texts:?}"
        );
    }

    #[test]
    fn what_was_found_by_the_model_of_before_counts_no_longer() {
        let (given, taken) = sync_channel(1);
        let (finds, found) = sync_channel(8);
        let mut watch = Watch {
            place: Place::Beside { given, found },
            corrected_by: SensorErrors::default(),
            taken: Some(Stamp::from_seconds(60.0)),
            newest: None,
            reported: true,
            outdated: None,
            wanted: None,
        };
        let of = |t_s: f64, ratio: f64| Disagreement {
            t_s,
            ratio,
            channel: "spring 4".to_owned(),
            since_s: 0.0,
            likely: Vec::new(),
            muted: Vec::new(),
        };
        let shown = |watch: &mut Watch, found: Disagreement| {
            finds.send(found).expect("waits");
            let (mut snapshot, mut events) = (Snapshot::default(), Vec::new());
            watch.update(&mut snapshot, &mut events);
            assert!(snapshot.is_monitored);
            (snapshot.disagreement.map(|d| d.ratio), events.len())
        };
        assert_eq!(shown(&mut watch, of(59.0, 1.6)), (Some(1.6), 0));
        let robot = Arc::new(RobotSpec::reference());
        watch.compare_with(&robot);
        assert!(matches!(taken.try_recv(), Ok(Given::Model(of)) if Arc::ptr_eq(&of, &robot)));
        // It was on its way.
        assert_eq!(shown(&mut watch, of(59.5, 1.6)), (None, 0));
        // Of the new model; that they agree again is reported.
        assert_eq!(shown(&mut watch, of(71.0, 0.3)), (Some(0.3), 1));
    }
}
