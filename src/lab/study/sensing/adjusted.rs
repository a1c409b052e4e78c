//! What `calibrate self` changes on a unit whose ends of springs lie beside the drawing.

use anyhow::Result;

use super::groups::{Bar, Results};
use super::motion_seed;
use crate::lab::self_calibration::{Comparison, Recorded};
use crate::lab::study::item::Found;
use crate::lab::study::setup::Setup;
use crate::lab::units::{ALL, side_by_side};

/// Motion that the calibration is adjusted to, in lengths of the usual motion.
const FITTED: f64 = 5.0;

pub(super) fn find(setup: &mut Setup) -> Result<Found> {
    let (robot, sizes) = (&setup.robot, setup.sizes);
    let seconds = FITTED * sizes.seconds;
    let mut found = Found::default();
    let recorded = side_by_side(&ALL, |unit| {
        let seed = motion_seed(sizes.seed, *unit) + 600;
        Ok((*unit, Recorded::of(robot, *unit, seconds, seed)?))
    })?;
    for with_cameras in [true, false] {
        let made = side_by_side(&recorded, |(unit, own)| {
            Ok((*unit, own.compare(robot, with_cameras)?))
        })?;
        let label = match with_cameras {
            true => "`calibrate self` beside motion capture",
            false => "`calibrate self` without motion capture",
        };
        let results = Results::new(made);
        let ratio = |c: &Comparison| c.after.sensors_mm / c.before.sensors_mm;
        let bar = match with_cameras {
            true => Bar::AtMost(0.5),
            false => Bar::AtMost(1.0),
        };
        let row = |what: &str| format!("{label}: {what}");
        let what = row("tip error after over before (worst)");
        results.add_worst(&mut found, &what, bar, ratio);
        results.add_mean(&mut found, &row("the same (mean)"), Bar::None, ratio);
        let what = row("tip error before, mm");
        results.add_mean(&mut found, &what, Bar::None, |c| c.before.sensors_mm);
        let what = row("tip error after, mm");
        results.add_mean(&mut found, &what, Bar::None, |c| c.after.sensors_mm);
        let what = row("the same by the networks trained on simulation, before, mm");
        results.add_mean(&mut found, &what, Bar::None, |c| c.before.networks_mm);
        let what = row("the same after, mm");
        results.add_mean(&mut found, &what, Bar::None, |c| c.after.networks_mm);
        let what = row("parameters that stay open, of all, %");
        results.add_mean(&mut found, &what, Bar::None, |c| {
            let all = &c.adjustment.parameters;
            let open = all.iter().filter(|p| !p.observable).count();
            100.0 * open as f64 / all.len() as f64
        });
    }
    found.notes.push(format!(
        "`calibrate self`: {seconds:.0} s of motion; judged on another motion, by the pose that geometry gives from springs \
         and IMUs, and by the networks that were trained on simulation alone. Before: springs from the bench; \
         ends and IMUs as drawn."
    ));
    Ok(found.after(2.0 * seconds * ALL.len() as f64))
}
