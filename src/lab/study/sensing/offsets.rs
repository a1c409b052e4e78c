//! Springs that read wrong or not at all any more.

use std::sync::Arc;

use anyhow::Result;
use rand::Rng as _;

use super::groups::{Bar, Results};
use super::spoil::{Hang, Shift};
use super::watch::{Delivery, named, replay};
use super::{ONSET_S, faults_motion};
use crate::lab::motions::{Motion, Sent};
use crate::lab::study::item::Found;
use crate::lab::study::setup::Setup;
use crate::lab::units::{ALL, Lab, side_by_side};
use crate::rig::multibody::arm::RINGS;
use crate::robot::RobotSpec;
use crate::signal::{BOARDS, ChannelHealth, RawFrame, SPRINGS, stream};

/// Springs of a segment.
const LEGS: usize = SPRINGS / 2;
/// Errors of two springs lie between these, m.
const OFF_M: [f64; 2] = [3e-3, 10e-3];
/// Draws per pair: amounts, signs and places of the motion.
const DRAWS: usize = 5;
/// Healthy motion before a pair is off, and motion with it, s.
const BEFORE_S: f64 = 10.0;
const AFTER_S: f64 = 20.0;
/// The end of that, over which verdicts are looked at, s.
const END_S: f64 = 1.0;
/// Errors of one spring, mm.
const SINGLE_MM: [f64; 3] = [3.0, 5.0, 10.0];
/// Motion within which it has to be named, s, and the gap of the link.
const NAMED_S: f64 = 30.0;
const GAP_S: f64 = 2.0;
/// Times of the motion at which a board's counters hang, and how long that is watched, s.
const HANGS: usize = 5;
const HUNG_S: f64 = 5.0;

/// Verdicts on some springs that are off.
#[derive(Clone, Default)]
struct Verdicts {
    /// Time from the fault to when all were named or their segment was suspect, s.
    first_s: Option<f64>,
    /// The same for named alone.
    named_s: Option<f64>,
    /// Share of the frames at the end in which that was so.
    end_share: f64,
    healthy_named: bool,
    healthy_named_at_end: bool,
}

/// Springs that are off in a unit's motion.
struct Job {
    lab: Arc<Lab>,
    tape: Arc<Vec<Sent>>,
    off_m: Vec<(usize, f64)>,
    /// The replay, and the fault's onset in it, s of motion.
    from_s: f64,
    onset_s: f64,
    until_s: f64,
    /// Frames that are lost, s of motion.
    gap_s: [f64; 2],
}

fn verdicts(robot: &RobotSpec, job: &Job) -> Verdicts {
    let shift = Shift::new(robot, &job.lab, job.off_m.clone());
    let segment = job.off_m[0].0 / LEGS;
    let is_off = |c: usize| job.off_m.iter().any(|(i, _)| *i == c);
    let counts_s = job.onset_s.max(job.gap_s[1]);
    let mut out = Verdicts::default();
    let (mut end, mut good) = (0.0, 0.0);
    let tape: Vec<Sent> = {
        let range = job.from_s..job.until_s;
        let inside = job.tape.iter().filter(|s| range.contains(&s.t_s));
        inside.cloned().collect()
    };
    let mut spoil = |t_s: f64, raw: &mut RawFrame| {
        if t_s >= job.onset_s {
            shift.apply(raw);
        }
        match (job.gap_s[0]..job.gap_s[1]).contains(&t_s) {
            true => Delivery::Lost,
            false => Delivery::Arrives,
        }
    };
    replay(robot, &job.lab, &tape, &mut spoil, &mut |sent, _, frame| {
        if sent.t_s < counts_s {
            return;
        }
        let named = named(frame);
        let all = job.off_m.iter().all(|(i, _)| named[*i]);
        let found = all || frame.quality.segment_suspect[segment];
        let healthy = named.iter().enumerate().any(|(c, n)| *n && !is_off(c));
        let since_s = sent.t_s - counts_s;
        if found {
            out.first_s.get_or_insert(since_s);
        }
        if all {
            out.named_s.get_or_insert(since_s);
        }
        out.healthy_named |= healthy;
        if sent.t_s >= job.until_s - END_S {
            end += 1.0;
            good += f64::from(u8::from(found));
            out.healthy_named_at_end |= healthy;
        }
    });
    out.end_share = good / f64::max(end, 1.0);
    out
}

/// Two springs of a segment off while running.
pub(super) fn pairs(setup: &mut Setup) -> Result<Found> {
    let (labs, tapes) = units(setup)?;
    let longest_s = 2.0 * setup.sizes.seconds;
    let mut jobs = Vec::new();
    for (lab, tape) in labs.iter().zip(&tapes) {
        let mut rng = stream(setup.sizes.seed, 0x0ff5_0000 + lab.unit.0);
        let mut off_m = || {
            let size_m = rng.random_range(OFF_M[0]..OFF_M[1]);
            if rng.random() { size_m } else { -size_m }
        };
        for segment in 0..2 {
            for a in 0..LEGS {
                for b in a + 1..LEGS {
                    for draw in 0..DRAWS {
                        let share = draw as f64 / (DRAWS - 1) as f64;
                        let from_s = share * (longest_s - BEFORE_S - AFTER_S);
                        let onset_s = from_s + BEFORE_S;
                        let at = |leg: usize| LEGS * segment + leg;
                        jobs.push(Job {
                            lab: lab.clone(),
                            tape: tape.clone(),
                            off_m: vec![(at(a), off_m()), (at(b), off_m())],
                            from_s,
                            onset_s,
                            until_s: onset_s + AFTER_S,
                            gap_s: [0.0; 2],
                        });
                    }
                }
            }
        }
    }
    let robot = &setup.robot;
    let made = side_by_side(&jobs, |job| Ok((job.lab.unit, verdicts(robot, job))))?;
    let missed: Vec<String> = jobs
        .iter()
        .zip(&made)
        .filter(|(_, (_, v))| v.end_share < 0.5 || v.healthy_named)
        .take(12)
        .map(|(job, (_, v))| describe(job, v))
        .collect();
    let results = Results::new(made);
    let mut found = Found::default();
    let label = "two springs of a segment off by 3 to 10 mm";
    let what = format!("{label}: both named or the segment suspect after {AFTER_S:.0} s, %");
    results.add_share(&mut found, &what, Bar::AtLeast(95.0), |v| {
        v.end_share >= 0.5
    });
    let what = format!("{label}: the same at some time, %");
    results.add_share(&mut found, &what, Bar::None, |v| v.first_s.is_some());
    let what = format!("{label}: both named at some time, %");
    results.add_share(&mut found, &what, Bar::None, |v| v.named_s.is_some());
    healthy_rows(&mut found, label, &results);
    found.notes.push(format!(
        "Two springs off: all 15 pairs of each segment, {DRAWS} draws of amounts, signs and places of the motion each, \
         after {BEFORE_S:.0} s of healthy motion. Cases that miss a bar, the first of them: {}.",
        missed.join("; ")
    ));
    Ok(found)
}

fn describe(job: &Job, v: &Verdicts) -> String {
    let springs: Vec<String> = job
        .off_m
        .iter()
        .map(|(i, off_m)| format!("spring {} {:+.1} mm", i + 1, off_m * 1e3))
        .collect();
    let what = match (v.healthy_named, v.end_share < 0.5) {
        (true, true) => "not named, and a healthy channel is",
        (true, false) => "a healthy channel named",
        (false, _) => "not named",
    };
    format!(
        "unit {}, {} at {:.0} s: {what}",
        job.lab.unit.0,
        springs.join(", "),
        job.onset_s
    )
}

fn healthy_rows(found: &mut Found, label: &str, results: &Results<Verdicts>) {
    let what = format!("{label}: a healthy channel named at some time, %");
    results.add_share(found, &what, Bar::AtMost(2.0), |v| v.healthy_named);
    let what = format!("{label}: a healthy channel named at the end, %");
    results.add_share(found, &what, Bar::None, |v| v.healthy_named_at_end);
}

/// Labs and tapes of all units.
pub(super) type Units = (Vec<Arc<Lab>>, Vec<Arc<Vec<Sent>>>);

pub(super) fn units(setup: &mut Setup) -> Result<Units> {
    let labs = setup.labs(&ALL)?;
    let motions: Vec<Motion> = labs.iter().map(|l| faults_motion(setup, l.unit)).collect();
    let tapes = setup.tapes(&motions, RINGS)?;
    Ok((labs, tapes))
}

/// One spring off before power-on, and across a gap of the link.
pub(super) fn single(setup: &mut Setup) -> Result<Found> {
    let (labs, tapes) = units(setup)?;
    let robot = &setup.robot;
    let mut found = Found::default();
    for (label, is_gap) in [
        ("before power-on", false),
        ("in a gap of the link of 2 s", true),
    ] {
        for mm in SINGLE_MM {
            let mut jobs = Vec::new();
            for (lab, tape) in labs.iter().zip(&tapes) {
                for i in 0..SPRINGS {
                    let sign = if (i + lab.unit.0 as usize).is_multiple_of(2) {
                        1.0
                    } else {
                        -1.0
                    };
                    let (onset_s, counts_s, gap_s) = match is_gap {
                        false => (-f64::INFINITY, 0.0, [0.0; 2]),
                        true => {
                            let end_s = ONSET_S + GAP_S;
                            (ONSET_S + 0.5 * GAP_S, end_s, [ONSET_S, end_s])
                        }
                    };
                    jobs.push(Job {
                        lab: lab.clone(),
                        tape: tape.clone(),
                        off_m: vec![(i, sign * mm * 1e-3)],
                        from_s: -f64::INFINITY,
                        onset_s,
                        until_s: counts_s + NAMED_S,
                        gap_s,
                    });
                }
            }
            let made = side_by_side(&jobs, |job| Ok((job.lab.unit, verdicts(robot, job))))?;
            let results = Results::new(made);
            let label = format!("one spring off by {mm:.0} mm {label}");
            let what = format!("{label}: named or the segment suspect within {NAMED_S:.0} s, %");
            results.add_share(&mut found, &what, Bar::AtLeast(95.0), |v| {
                v.first_s.is_some()
            });
            let what = format!("{label}: named, %");
            results.add_share(&mut found, &what, Bar::None, |v| v.named_s.is_some());
            healthy_rows(&mut found, &label, &results);
        }
    }
    Ok(found)
}

/// The counters of a board hang.
pub(super) fn hung(setup: &mut Setup) -> Result<Found> {
    let (labs, tapes) = units(setup)?;
    let span_s = 2.0 * setup.sizes.seconds - ONSET_S - HUNG_S;
    let mut jobs = Vec::new();
    for (lab, tape) in labs.iter().zip(&tapes) {
        for board in 0..BOARDS {
            for k in 0..HANGS {
                let at_s = ONSET_S + span_s * k as f64 / (HANGS - 1) as f64;
                jobs.push((lab.clone(), tape.clone(), board, at_s));
            }
        }
    }
    let robot = &setup.robot;
    let made = side_by_side(&jobs, |(lab, tape, board, at_s)| {
        let mut hang = Hang::default();
        let mut stuck_s = None;
        let range = (at_s - ONSET_S)..(at_s + HUNG_S);
        let inside = tape.iter().filter(|s| range.contains(&s.t_s));
        let part: Vec<Sent> = inside.cloned().collect();
        replay(
            robot,
            lab,
            &part,
            &mut |t_s, raw| {
                if t_s >= *at_s {
                    hang.apply(*board, raw);
                }
                Delivery::Arrives
            },
            &mut |sent, _, frame| {
                let springs = &frame.health.springs[LEGS * board..LEGS * (board + 1)];
                let all = springs.iter().all(|h| *h == ChannelHealth::Stuck);
                if sent.t_s >= *at_s && all {
                    stuck_s.get_or_insert(sent.t_s - at_s);
                }
            },
        );
        Ok((lab.unit, stuck_s.unwrap_or(f64::INFINITY)))
    })?;
    let results = Results::new(made);
    let mut found = Found::default();
    let label = "counters of a board hung";
    let what = format!("{label}: all six springs stuck after, s (worst)");
    results.add_worst(&mut found, &what, Bar::AtMost(0.5), |s| *s);
    let what = format!("{label}: the same, s (mean)");
    results.add_mean(&mut found, &what, Bar::None, |s| *s);
    Ok(found)
}
