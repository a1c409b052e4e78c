//! Springs and IMUs that are out, from the start or in the course of a motion.

use std::sync::Arc;

use anyhow::Result;

use super::groups::{Bar, Results};
use super::spoil::drop_channel;
use super::watch::{Delivery, Tip, named, replay};
use super::{ONSET_S, faults_motion};
use crate::lab::motions::{Motion, Sent};
use crate::lab::study::item::Found;
use crate::lab::study::setup::Setup;
use crate::lab::units::{ALL, Lab, side_by_side};
use crate::rig::multibody::arm::RINGS;
use crate::robot::RobotSpec;
use crate::signal::{IMUS, RawFrame, SPRINGS, SensorFrame};

/// One frame in so many is given to the networks.
const EVERY: u32 = 20;

/// Kind of channels that are out.
#[derive(Clone, Copy)]
pub(super) enum Out {
    /// One spring.
    Springs,
    /// One IMU, or both of a pad.
    Imus,
}

/// When they are.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum When {
    /// Always.
    AtStart,
    /// From [`ONSET_S`] on.
    Running,
}

impl Out {
    /// Sets of channels that are out together.
    fn sets(self) -> Vec<Vec<usize>> {
        match self {
            Self::Springs => (0..SPRINGS).map(|i| vec![i]).collect(),
            Self::Imus => {
                let singles = (0..IMUS).map(|i| vec![SPRINGS + i]);
                let pads = (0..IMUS / 2).map(|p| vec![SPRINGS + 2 * p, SPRINGS + 2 * p + 1]);
                singles.chain(pads).collect()
            }
        }
    }
}

/// What a sensing did from the outage on.
pub(super) struct Watch {
    from_s: f64,
    has_to_align: bool,
    /// When it had found the pads, s of motion.
    aligned_s: Option<f64>,
    /// Longest time without the pads after that, s.
    lost_s: f64,
    lost_since_s: Option<f64>,
    frames: usize,
    blind: usize,
    /// Whether a channel that is delivered was named.
    pub healthy_named: bool,
    pub tip: Tip,
}

impl Watch {
    /// Looks from `from_s` on.
    pub fn new(from_s: f64) -> Self {
        Self {
            from_s,
            has_to_align: from_s <= 0.0,
            aligned_s: None,
            lost_s: 0.0,
            lost_since_s: None,
            frames: 0,
            blind: 0,
            healthy_named: false,
            tip: Tip::default(),
        }
    }

    /// Takes in a frame.
    pub fn add(&mut self, lab: &Lab, sent: &Sent, frame: &SensorFrame) {
        if sent.t_s < self.from_s {
            return;
        }
        let found = frame.quality.need.is_none();
        if found || !self.has_to_align {
            self.aligned_s.get_or_insert(sent.t_s);
        }
        self.healthy_named |= named(frame).contains(&true);
        if self.aligned_s.is_none() {
            return;
        }
        match found {
            true => self.lost_since_s = None,
            false => {
                let since_s = *self.lost_since_s.get_or_insert(sent.t_s);
                self.lost_s = self.lost_s.max(sent.t_s - since_s + 0.01);
            }
        }
        self.frames += 1;
        self.blind += usize::from(frame.is_blind());
        if sent.raw.seq.is_multiple_of(EVERY) {
            self.tip.add(lab, sent, frame);
        }
    }

    /// Time of motion until the pads were found, s; infinite when they never were.
    pub fn aligned_s(&self) -> f64 {
        self.aligned_s.map_or(f64::INFINITY, |t_s| t_s.max(0.0))
    }

    /// Share of blind frames after that, %.
    pub fn blind_percent(&self) -> f64 {
        100.0 * self.blind as f64 / self.frames.max(1) as f64
    }

    /// Share of the tip's positions in the stated 95 % band, %.
    pub fn inside_percent(&self) -> f64 {
        match self.tip.len() {
            0 => 0.0,
            _ => 100.0 * self.tip.coverage().translation_95,
        }
    }
}

/// An outage beside the same motion without it.
pub(super) struct Outage {
    pub label: String,
    pub watch: Watch,
    /// Mean tip error over that of the healthy sensing on the same frames.
    pub ratio: f64,
}

impl Outage {
    /// Compares two watches of one motion.
    pub fn new(label: String, watch: Watch, healthy: &Tip) -> Self {
        let ratio = match watch.tip.len() {
            0 => f64::INFINITY,
            n => watch.tip.mean_mm() / healthy.last(n).mean_mm(),
        };
        Self {
            label,
            watch,
            ratio,
        }
    }
}

/// Rows of outages.
pub(super) fn rows(found: &mut Found, label: &str, when: When, results: &Results<Outage>) {
    let row = |what: &str| format!("{label}: {what}");
    if when == When::AtStart {
        let what = row("pads found after, s of motion (worst)");
        results.add_worst(found, &what, Bar::AtMost(15.0), |o| o.watch.aligned_s());
    }
    let what = row("longest time without the pads after that, s (worst)");
    results.add_worst(found, &what, Bar::None, |o| o.watch.lost_s);
    let what = row("tip in the 95 % band, %");
    results.add(found, &what, Bar::Within(90.0, 100.0), |own| {
        let mut all = Tip::default();
        own.iter().for_each(|o| all.extend(&o.watch.tip));
        100.0 * all.coverage().translation_95
    });
    let what = row("tip in the 95 % band, % (worst case)");
    results.add(found, &what, Bar::None, |own| {
        let each = own.iter().map(|o| o.watch.inside_percent());
        each.fold(f64::INFINITY, f64::min)
    });
    let what = row("blind frames, % (worst)");
    results.add_worst(found, &what, Bar::AtMost(0.0), |o| o.watch.blind_percent());
    let what = row("tip error over healthy (worst case)");
    results.add_worst(found, &what, Bar::AtMost(1.5), |o| o.ratio);
    let what = row("tip error over healthy (mean)");
    results.add_mean(found, &what, Bar::None, |o| o.ratio);
    let what = row("tip error, mm");
    results.add_mean(found, &what, Bar::None, |o| o.watch.tip.mean_mm());
    let what = row("cases with a delivered channel named, %");
    results.add_share(found, &what, Bar::AtMost(2.0), |o| o.watch.healthy_named);
}

/// Notes on the cases that are worst in each respect.
pub(super) fn note(found: &mut Found, label: &str, outages: &[Outage]) {
    let by = |of: &dyn Fn(&Outage) -> f64| {
        let worst = outages.iter().max_by(|a, b| of(a).total_cmp(&of(b)));
        worst.map_or_else(String::new, |o| o.label.clone())
    };
    found.notes.push(format!(
        "{label}: worst cases: {} (time to find the pads), {} (error over healthy), {} (band).",
        by(&|o| o.watch.aligned_s()),
        by(&|o| o.ratio),
        by(&|o| -o.watch.inside_percent()),
    ));
}

/// One outage of a unit.
struct Job {
    lab: Arc<Lab>,
    tape: Arc<Vec<Sent>>,
    /// `None`: healthy.
    set: Vec<usize>,
}

pub(super) fn find(setup: &mut Setup, out: Out, when: When) -> Result<Found> {
    let labs = setup.labs(&ALL)?;
    let motions: Vec<Motion> = labs.iter().map(|l| faults_motion(setup, l.unit)).collect();
    let tapes = setup.tapes(&motions, RINGS)?;
    let robot = &setup.robot;
    let sets: Vec<Vec<usize>> = [Vec::new()].into_iter().chain(out.sets()).collect();
    let mut jobs = Vec::new();
    for (lab, tape) in labs.iter().zip(&tapes) {
        jobs.extend(sets.iter().map(|set| Job {
            lab: lab.clone(),
            tape: tape.clone(),
            set: set.clone(),
        }));
    }
    let from_s = match when {
        When::AtStart => 0.0,
        When::Running => ONSET_S,
    };
    let watches = side_by_side(&jobs, |job| Ok(watch(robot, job, when, from_s)))?;
    let mut watches = watches.into_iter();
    let mut all = Vec::new();
    for lab in &labs {
        let Some(healthy) = watches.next() else { break };
        for set in &sets[1..] {
            let Some(watch) = watches.next() else { break };
            let label = format!("unit {}, {}", lab.unit.0, names(set));
            all.push((lab.unit, Outage::new(label, watch, &healthy.tip)));
        }
    }
    let label = match (out, when) {
        (Out::Springs, When::AtStart) => "one spring out at start",
        (Out::Springs, When::Running) => "one spring out while running",
        (Out::Imus, When::AtStart) => "one IMU or both of a pad out at start",
        (Out::Imus, When::Running) => "one IMU or both of a pad out while running",
    };
    let mut found = Found::default();
    let (units, outages): (Vec<_>, Vec<_>) = all.into_iter().unzip();
    note(&mut found, label, &outages);
    if let Out::Imus = out {
        // Both of a pad come after the single ones in each unit.
        let (mut single, mut both) = (Vec::new(), Vec::new());
        let each = sets.len() - 1;
        for (k, (unit, outage)) in units.into_iter().zip(outages).enumerate() {
            match k % each < IMUS {
                true => single.push((unit, outage)),
                false => both.push((unit, outage)),
            }
        }
        let kind = match when {
            When::AtStart => "at start",
            When::Running => "while running",
        };
        let [one, pad] = ["one IMU out", "both IMUs of a pad out"].map(|s| format!("{s} {kind}"));
        rows(&mut found, &one, when, &Results::new(single));
        rows(&mut found, &pad, when, &Results::new(both));
    } else {
        rows(
            &mut found,
            label,
            when,
            &Results::new(units.into_iter().zip(outages)),
        );
    }
    Ok(found)
}

fn watch(robot: &RobotSpec, job: &Job, when: When, from_s: f64) -> Watch {
    let mut watch = Watch::new(from_s);
    let mut spoil = |t_s: f64, raw: &mut RawFrame| {
        if when == When::AtStart || t_s >= from_s {
            job.set.iter().for_each(|c| drop_channel(raw, *c));
        }
        Delivery::Arrives
    };
    replay(
        robot,
        &job.lab,
        &job.tape,
        &mut spoil,
        &mut |sent, _, frame| watch.add(&job.lab, sent, frame),
    );
    watch
}

/// Names of channels.
fn names(set: &[usize]) -> String {
    let name = |c: &usize| match *c {
        c if c < SPRINGS => format!("spring {}", c + 1),
        c => format!("IMU {}", c - SPRINGS + 1),
    };
    set.iter().map(name).collect::<Vec<_>>().join(" and ")
}
