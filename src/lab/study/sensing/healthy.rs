//! Healthy motion: errors of the tip, bands, and innovations.

use std::sync::Arc;

use anyhow::Result;

use super::groups::{Bar, Results};
use super::motion_seed;
use super::watch::{Tip, named};
use crate::lab::motions::{Arm, Motion, Push, each_sent};
use crate::lab::study::item::Found;
use crate::lab::study::setup::Setup;
use crate::lab::units::{ALL, Lab, side_by_side};
use crate::signal::SPRINGS;
use crate::twin::sensing_for;

/// Conditions, and the length of their motions in lengths of the usual one: errors at one stop are alike, so that it takes
/// many stops.
const CONDITIONS: [(&str, Push, f64); 3] = [
    ("healthy, in motion", Push::None, 2.0),
    ("healthy, at rest", Push::Rests, 10.0),
    ("healthy, after blows of 30 N", Push::Ringing(30.0), 10.0),
];
/// One frame in so many is given to the networks.
const EVERY: usize = 5;
/// Innovations count from here on, s of motion.
const SETTLED_S: f64 = 10.0;

/// Result of one motion.
struct Healthy {
    tip: Tip,
    /// Mean normalised innovation squared of the springs and of the IMUs.
    nis: [f64; 2],
    named: bool,
}

pub(super) fn find(setup: &mut Setup) -> Result<Found> {
    let labs = setup.labs(&ALL)?;
    let mut found = Found::default();
    for (label, push, long) in CONDITIONS {
        let seconds = long * setup.sizes.seconds;
        let jobs: Vec<(Arc<Lab>, Motion)> = labs
            .iter()
            .map(|lab| {
                let seed = motion_seed(setup.sizes.seed, lab.unit) + 100;
                let motion = Motion {
                    push,
                    ..Motion::of(lab.unit, seconds, seed)
                };
                (lab.clone(), motion)
            })
            .collect();
        let robot = &setup.robot;
        let made = side_by_side(&jobs, |(lab, motion)| {
            let mut sensing = sensing_for(robot, &lab.calibration);
            let mut tip = Tip::default();
            let (mut nis, mut frames, mut k) = ([0.0; 2], 0.0, 0);
            let mut is_named = false;
            each_sent(robot, motion, &Arm::default(), &mut |sent| {
                let frame = sensing.update(&sent.raw);
                is_named |= named(&frame).contains(&true);
                if !sent.is_scored {
                    return;
                }
                if sent.t_s > SETTLED_S {
                    let (springs, imus) = sensing.nis().split_at(SPRINGS);
                    for (sum, part) in nis.iter_mut().zip([springs, imus]) {
                        *sum += part.iter().sum::<f64>() / part.len() as f64;
                    }
                    frames += 1.0;
                }
                if k % EVERY == 0 {
                    tip.add(lab, &sent, &frame);
                }
                k += 1;
            })?;
            let result = Healthy {
                tip,
                nis: nis.map(|sum| sum / frames),
                named: is_named,
            };
            Ok((lab.unit, result))
        })?;
        let results = Results::new(made);
        let add = |found: &mut Found, what: &str, bar, of: &dyn Fn(&Healthy) -> f64| {
            results.add_mean(found, &format!("{label}: {what}"), bar, of);
        };
        add(&mut found, "tip error, mm", Bar::None, &|r| r.tip.mean_mm());
        let percent = |of: fn(&crate::learn::Coverage) -> f64| {
            move |r: &Healthy| 100.0 * of(&r.tip.coverage())
        };
        let [b68, b95] = [68.27, 95.0].map(|at| Bar::about(at, 5.0));
        add(
            &mut found,
            "position in the 68 % band, %",
            b68,
            &percent(|c| c.translation_68),
        );
        add(
            &mut found,
            "position in the 95 % band, %",
            b95,
            &percent(|c| c.translation_95),
        );
        add(
            &mut found,
            "orientation in the 68 % band, %",
            b68,
            &percent(|c| c.rotation_68),
        );
        add(
            &mut found,
            "orientation in the 95 % band, %",
            b95,
            &percent(|c| c.rotation_95),
        );
        let nis_bar = match push {
            Push::None => Bar::about(1.0, 0.1),
            _ => Bar::None,
        };
        add(&mut found, "NIS of the springs", nis_bar, &|r| r.nis[0]);
        add(&mut found, "NIS of the IMUs", nis_bar, &|r| r.nis[1]);
        let what = format!("{label}: motions with a channel named as faulty, %");
        results.add_share(&mut found, &what, Bar::AtMost(0.0), |r| r.named);
        found = found.after(jobs.len() as f64 * seconds);
    }
    let lengths_s = CONDITIONS.map(|(_, _, long)| long * setup.sizes.seconds);
    found.notes.push(format!(
        "Healthy: {lengths_s:.0?} s of each unit in motion, with rests, and with blows; at rest from 2 s after a motion on; \
         after blows: the first second after each; innovations from {SETTLED_S:.0} s of motion on."
    ));
    Ok(found)
}
