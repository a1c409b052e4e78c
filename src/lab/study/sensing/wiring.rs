//! Boards whose plugs are exchanged.

use anyhow::Result;

use super::groups::{Bar, Results};
use super::watch::{Delivery, replay};
use crate::lab::study::item::Found;
use crate::lab::study::setup::Setup;
use crate::signal::{BOARDS, CHAMBERS, IMUS, RawFrame, SPRINGS, Swap};

/// Verdicts on the wiring of one motion.
#[derive(Clone, Copy, Default)]
struct Verdict {
    /// When the boards were named, s of motion.
    named_s: Option<f64>,
    other: bool,
}

/// The frame with each board plugged into the other segment.
fn exchange(raw: &mut RawFrame) {
    raw.spring_counts.rotate_left(SPRINGS / BOARDS);
    raw.spring_gate_ticks.rotate_left(SPRINGS / BOARDS);
    raw.imu.rotate_left(IMUS / BOARDS);
    raw.chamber_pa.rotate_left(CHAMBERS / BOARDS);
    raw.tick_rate_hz.rotate_left(1);
}

pub(super) fn find(setup: &mut Setup) -> Result<Found> {
    let (labs, tapes) = super::offsets::units(setup)?;
    let robot = &setup.robot;
    let jobs: Vec<_> = labs.iter().zip(&tapes).collect();
    let watch = |is_exchanged: bool| {
        crate::lab::units::side_by_side(&jobs, |(lab, tape)| {
            let mut verdict = Verdict::default();
            replay(
                robot,
                lab,
                tape,
                &mut |_, raw| {
                    if is_exchanged {
                        exchange(raw);
                    }
                    Delivery::Arrives
                },
                &mut |sent, sensing, _| match sensing.wiring() {
                    Some(Swap::Boards) => {
                        verdict.named_s.get_or_insert(sent.t_s);
                    }
                    Some(Swap::Springs(..) | Swap::Imus(..)) => verdict.other = true,
                    None => {}
                },
            );
            Ok((lab.unit, verdict))
        })
    };
    let exchanged = Results::new(watch(true)?);
    let healthy = Results::new(watch(false)?);
    let mut found = Found::default();
    let row = |what: &str| format!("boards exchanged: {what}");
    let all = Bar::AtLeast(100.0);
    exchanged.add_share(&mut found, &row("named, %"), all, |v| v.named_s.is_some());
    let what = row("named after, s of motion (worst)");
    exchanged.add_worst(&mut found, &what, Bar::None, |v| {
        v.named_s.unwrap_or(f64::INFINITY)
    });
    let none = Bar::AtMost(0.0);
    exchanged.add_share(&mut found, &row("other plugs named, %"), none, |v| v.other);
    let what = "wired right: an exchange named, %";
    healthy.add_share(&mut found, what, none, |v| v.other || v.named_s.is_some());
    Ok(found)
}
