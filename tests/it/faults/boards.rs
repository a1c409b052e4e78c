//! Faults of boards and of the line to them, on simulated time: with emulated boards, and what is the boards' own with
//! the real firmware, too.

use springtwin::rig::faults::{Fault, Place, Word};
use springtwin::signal::{BOARDS, Goal, Mode};
use springtwin::twin::Command;

use super::bench::{Bench, Boards, Moment, case};
use super::{Bound, row, time};

/// Where the arm is sent: some seconds of motion of both segments.
pub(super) const FAR_M: [f64; 3] = [0.06, 0.04, -0.30];
pub(super) const NEAR_M: [f64; 3] = [0.0, 0.0, -0.31];

pub(super) fn fault(word: Word, amount: f64) -> Fault {
    Fault { word, amount }
}

/// Rows of the firmware come after those of emulated boards.
fn place(fault: u8, boards: Boards) -> (u8, u8) {
    (fault, if boards == Boards::Firmware { 1 } else { 0 })
}

fn of(boards: Boards) -> &'static str {
    match boards {
        Boards::Emulated => "emulated boards",
        Boards::Firmware => "firmware under simavr",
    }
}

macro_rules! on_both {
    ($($name:ident),* $(,)?) => {
        mod emulated {
            $(#[test] fn $name() { super::$name(super::Boards::Emulated); })*
        }
        /// Run by `./test firmware`.
        pub mod firmware {
            $(#[test] fn $name() { super::$name(super::Boards::Firmware); })*
        }
    };
}

on_both!(
    an_unplugged_port,
    garbage_on_the_line,
    broken_frames,
    a_stale_board,
    frames_twice_and_out_of_order,
    the_stop_button,
    a_program_that_dies,
    over_pressure,
    a_board_that_reboots,
);

fn an_unplugged_port(boards: Boards) {
    case(boards, |b| {
        b.go(FAR_M);
        b.run(0.5);
        let from_s = b.rig(|rig| rig.faults.begin(Place::Port, Fault::of(Word::Off)));
        b.until("the loss is reported", 1.0, |b| !b.now.link.connected);
        let flagged_s = b.t_s() - from_s;
        b.run(0.8);
        let safe_s = b.pumps_off_s(from_s).expect("the boards are SAFE") - from_s;
        let back_s = b.rig(|rig| rig.faults.end(Place::Port));
        b.until("it is connected again", 5.0, |b| b.now.link.connected);
        let reconnected_s = b.t_s() - back_s;
        b.run(2.0);
        assert!(!b.pumps_ran(from_s + 0.25, b.t_s()), "it armed by itself");
        assert!(matches!(b.now.mode, Mode::Safe(_)), "{:?}", b.now.mode);
        // And then it does as it is told again.
        b.tell(Command::Reset);
        b.until("it is reset", 2.0, |b| b.now.mode == Mode::Disarmed);
        b.run(0.6);
        b.go(NEAR_M);
        row(
            place(1, boards),
            &format!("serial unplugged ({})", of(boards)),
            "flagged <= 50 ms; firmware SAFE <= 250 ms; reconnects <= 2 s; never arms by itself",
            &[
                Bound::time("flagged", flagged_s, 0.05),
                Bound::time("pumps off", safe_s, 0.25),
                Bound::time("connected again", reconnected_s, 2.0),
            ],
            "pumps stayed off for 2 s more",
        );
    });
}

/// Garbage from both boards for 60 ms: too short for SAFE, so motion goes on.
fn garbage_on_the_line(boards: Boards) {
    case(boards, |b| {
        b.go(FAR_M);
        b.run(0.5);
        let lost = b.now.link.frames_lost;
        let both = |b: &Bench, fault: Option<Fault>| {
            b.rig(move |rig| {
                for board in 0..BOARDS {
                    match fault {
                        Some(f) => rig.faults.begin(Place::Board(board), f),
                        None => rig.faults.end(Place::Board(board)),
                    }
                }
            })
        };
        let from_s = both(b, Some(Fault::of(Word::Garbage)));
        b.run(0.05);
        let to_s = both(b, None);
        b.run(0.5);
        let next_s = b.stamps.iter().find(|s| **s > to_s).expect("frames again") - to_s;
        let lost = b.now.link.frames_lost - lost;
        let said = ((to_s - from_s) * 100.0).ceil() as u64 * BOARDS as u64;
        let more = lost.saturating_sub(said);
        assert_eq!(b.now.mode, Mode::Moving, "{:?}", b.now.mode);
        row(
            place(2, boards),
            &format!("garbage bytes for {} ({})", time(to_s - from_s), of(boards)),
            "no panic; at most 1 good frame lost after it ends; buffer <= 1 KiB",
            &[
                // The first frame that is whole is due within a period; one may be lost, then the next is heard.
                Bound::time("first frame sampled after its end", next_s, 0.021),
                Bound::count("good frames lost at most", more as f64, 1.0)
                    .asserting(BOARDS as f64, "the frames of both boards count"),
            ],
            "decoder holds 512 bytes",
        );
    });
}

fn broken_frames(boards: Boards) {
    case(boards, |b| {
        let both = |b: &Bench, share: f64| {
            b.rig(|rig| {
                for board in 0..BOARDS {
                    rig.faults
                        .begin(Place::Board(board), fault(Word::Wrong, share));
                }
            })
        };
        let before = b.now.link.clone();
        let hits = b.moments().last().expect("moments").hits;
        both(b, 0.01);
        b.go(FAR_M);
        b.run(8.0);
        let lost = b.now.link.frames_lost - before.frames_lost;
        let all = (b.now.link.frames - before.frames) * BOARDS as u64;
        let hits = b.moments().last().expect("moments").hits - hits;
        assert!(
            matches!(b.now.mode, Mode::Moving | Mode::AtGoal),
            "{:?}",
            b.now.mode
        );
        assert!(hits > 0, "{lost} lost");
        b.go(NEAR_M);
        // Few enough that no board misses four heartbeats in a row, which are hit as well.
        let from_s = both(b, 0.15);
        b.until("too many losses are SAFE", 1.5, |b| {
            matches!(b.now.mode, Mode::Safe(_))
        });
        let safe_s = b.t_s() - from_s;
        assert!(b.is_safe("frames were lost"), "{:?}", b.now.mode);
        row(
            place(3, boards),
            &format!("1 % of frames corrupted ({})", of(boards)),
            "loss <= 1.2 %, control goes on; > 10 % over 1 s -> SAFE",
            &[
                Bound::share("lost", lost as f64 / all as f64, 0.012).asserting(
                    (1.2 * hits as f64 + 1.0) / all as f64,
                    "the frames that are hit are random, and one is on its way at the end",
                ),
                Bound::time("SAFE with 15 % corrupted", safe_s, 1.0)
                    .asserting(1.5, "the frames that are hit are random"),
            ],
            &format!("{hits} of {all} frames hit, {lost} lost, moving on"),
        );
    });
}

fn a_stale_board(boards: Boards) {
    case(boards, |b| {
        b.go(FAR_M);
        b.run(0.5);
        // It says the same frame again and again: old data, freshly heard.
        let from_s = b.rig(|rig| rig.faults.begin(Place::Board(1), Fault::of(Word::Stuck)));
        b.until("it is warned", 1.0, |b| b.alarmed("Data "));
        let warned_s = b.t_s() - from_s;
        b.until("it is SAFE", 1.0, |b| matches!(b.now.mode, Mode::Safe(_)));
        let safe_s = b.t_s() - from_s;
        let raw = b.now.raw.clone().expect("frames");
        b.run(0.5);
        let later = b.now.raw.clone().expect("frames");
        assert!(
            later.board_age_s[1] > raw.board_age_s[1] + 0.4,
            "old passes as fresh"
        );
        let (new, old) = (later.stamp, b.now.sensors.as_ref().expect("sensors").stamp);
        assert!(new.since(old) > 0.4, "the estimate goes on without board 2");
        // Its last sample is up to 10 ms older than the fault; the frame that shows its age comes every 10 ms, and
        // so does the tick that sees the frame.
        let why = "sample, frame and tick are up to 10 ms each";
        assert!(warned_s >= 0.02 && safe_s >= 0.09, "{warned_s} {safe_s}");
        row(
            place(4, boards),
            &format!("a board goes stale ({})", of(boards)),
            "warn 30 ms, SAFE 100 ms; old data never passes as fresh",
            &[
                Bound::time("warned", warned_s, 0.03).asserting(0.055, why),
                Bound::time("SAFE", safe_s, 0.1).asserting(0.125, why),
            ],
            "its age grew on",
        );
    });
}

fn frames_twice_and_out_of_order(boards: Boards) {
    case(boards, |b| {
        b.go(FAR_M);
        let late = b.now.link.frames_late;
        for (word, for_s) in [(Word::Twice, 3.0), (Word::Swapped, 3.0)] {
            b.rig(move |rig| {
                for board in 0..BOARDS {
                    rig.faults.begin(Place::Board(board), fault(word, 0.04));
                }
            });
            b.run(for_s);
        }
        let late = b.now.link.frames_late - late;
        let hits = b.moments().last().expect("moments").hits;
        b.rig(|rig| rig.faults.clear());
        assert!(
            b.stamps.windows(2).all(|s| s[1] > s[0]),
            "time ran backwards"
        );
        assert!(
            late > 10 && late <= hits,
            "{late} late or double, {hits} made"
        );
        assert!(
            matches!(b.now.mode, Mode::Moving | Mode::AtGoal),
            "{:?}",
            b.now.mode
        );
        row(
            place(5, boards),
            &format!("reordered, duplicate frames ({})", of(boards)),
            "dropped and counted; output time monotone",
            &[],
            &format!(
                "{hits} made, {late} dropped; {} stamps, all rising",
                b.stamps.len()
            ),
        );
    });
}

fn the_stop_button(boards: Boards) {
    case(boards, |b| {
        b.go(FAR_M);
        b.run(0.5);
        b.tell(Command::Stop);
        let from_s = b.t_s();
        b.run(0.5);
        let off_s = b.pumps_off_s(from_s).expect("the pumps go off") - from_s;
        // Commands without a reset change nothing.
        b.tell(Command::Arm);
        b.tell(Command::Goto(Goal::position(NEAR_M)));
        b.run(0.5);
        assert!(!b.pumps_ran(from_s + off_s, b.t_s()));
        b.tell(Command::Reset);
        b.run(1.0);
        assert!(
            !b.pumps_ran(from_s + off_s, b.t_s()),
            "a reset alone moves nothing"
        );
        b.go(NEAR_M);
        b.run(0.2);
        assert!(b.pumps_ran(b.t_s() - 0.1, b.t_s()));
        row(
            place(24, boards),
            &format!("STOP pressed ({})", of(boards)),
            "pumps off <= 50 ms, latched, explicit reset",
            &[Bound::time("pumps off", off_s, 0.05)],
            "off until reset and a new command",
        );
    });
}

fn a_program_that_dies(boards: Boards) {
    case(boards, |b| {
        b.go(FAR_M);
        b.run(0.5);
        assert!(
            b.pumps_ran(b.t_s() - 0.05, b.t_s()),
            "nothing to be stopped"
        );
        let from_s = b.die();
        b.run(1.0);
        let off_s = b.pumps_off_s(from_s).expect("the boards are SAFE") - from_s;
        assert!(!b.pumps_ran(from_s + off_s, b.t_s()));
        row(
            (14, if boards == Boards::Firmware { 9 } else { 8 }),
            &format!("the program ends without a word ({})", of(boards)),
            "rig SAFE <= 250 ms",
            &[Bound::time("pumps off after its last tick", off_s, 0.25)],
            "pumps stayed off",
        );
    });
}

/// Whatever makes the gauge read it: 45 kPa more than there are.
fn over_pressure(boards: Boards) {
    case(boards, |b| {
        b.go(FAR_M);
        b.run(0.3);
        let from_s = b.rig(|rig| rig.faults.begin(Place::Gauge(4), fault(Word::Wrong, 45.0)));
        b.until("it is SAFE", 2.0, |b| matches!(b.now.mode, Mode::Safe(_)));
        b.run(0.3);
        let moments = b.moments();
        let reads = |m: &&Moment| m.t_s > from_s && m.gauge_pa[4] > 42e3;
        let over_s = moments.iter().find(reads).expect("the gauge reads it").t_s;
        // Chamber 5 is board 2's: its firmware acts by itself, the other board when the program has heard of it.
        let own = moments.iter().find(|m| m.t_s >= over_s && !m.pumps[1]);
        let off_s = own.expect("the pumps go off").t_s - over_s;
        let all_s = b.pumps_off_s(over_s).expect("all pumps go off") - over_s;
        assert!(b.is_safe("over-pressure"), "{:?}", b.now.mode);
        assert!(!b.pumps_ran(over_s + all_s, b.t_s()));
        row(
            place(10, boards),
            &format!("over-pressure > 42 kPa ({})", of(boards)),
            "pumps off <= 20 ms",
            &[
                Bound::time("pumps of its board off", off_s, 0.02),
                Bound::time("pumps of the other board off", all_s, 0.02)
                    .asserting(0.06, "it hears of it from the program"),
            ],
            "from when the gauge read it; pumps stayed off",
        );
    });
}

fn a_board_that_reboots(boards: Boards) {
    case(boards, |b| {
        b.go(FAR_M);
        b.run(0.3);
        let from_s = b.rig(|rig| rig.faults.begin(Place::Board(0), Fault::of(Word::Off)));
        b.until("it is SAFE", 1.0, |b| matches!(b.now.mode, Mode::Safe(_)));
        let safe_s = b.t_s() - from_s;
        b.run(0.5);
        let back_s = b.rig(|rig| rig.faults.end(Place::Board(0)));
        b.until("it is back", 5.0, |b| b.now.link.connected);
        let there_s = b.t_s() - back_s;
        b.run(1.0);
        assert!(!b.pumps_ran(from_s + 0.25, b.t_s()), "it armed by itself");
        row(
            place(25, boards),
            &format!("a board loses its power and boots ({})", of(boards)),
            "SAFE; known again; never arms by itself",
            &[],
            &format!(
                "SAFE {}, matched again {} after power",
                time(safe_s),
                time(there_s)
            ),
        );
    });
}

/// Emulated boards only: nobody can move the clock of a chip from outside.
#[test]
fn a_clock_that_jumps() {
    case(Boards::Emulated, |b| {
        b.go(FAR_M);
        b.run(2.0);
        let mut worst_s: f64 = 0.0;
        for by_s in [0.006, -0.006, 3.0, -3.0] {
            let from_s = b.rig(move |rig| {
                rig.faults.begin(Place::Board(1), fault(Word::Jump, by_s));
            });
            b.until("the jump is reported", 3.0, |b| {
                b.event_s(from_s, "clock").is_some()
            });
            let told_s = b.event_s(from_s, "clock").expect("told") - from_s;
            worst_s = worst_s.max(told_s);
            b.run(0.5);
            let raw = b.now.raw.as_ref().expect("frames");
            assert!(raw.board_age_s.iter().all(|age| *age < 0.02), "{raw:?}");
        }
        assert!(
            b.stamps.windows(2).all(|s| s[1] > s[0]),
            "time ran backwards"
        );
        let clock = b.now.link.board_clock[1].expect("fitted again");
        row(
            (6, 0),
            "board clock jumps by 6 ms and by 3 s, back and forth",
            "> 5 ms noticed <= 1 s, re-fitted, marked",
            &[Bound::time("noticed", worst_s, 1.0)],
            &format!(
                "the fit then leaves {:.2} ms; {} in the end",
                clock.residual_s * 1e3,
                match &b.now.mode {
                    Mode::Safe(reason) => format!("SAFE ({reason})"),
                    _ => "moving on".to_owned(),
                }
            ),
        );
    });
}

/// A line that brings everything, 150 ms late.
#[test]
fn a_line_that_is_late() {
    case(Boards::Emulated, |b| {
        // In steps: a heartbeat comes every 50 ms and a board waits 200 ms, so a line that is late by 150 ms from one
        // moment to the next may be a silent program to it.
        for late_s in [0.08, 0.15] {
            b.rig(move |rig| {
                for board in 0..BOARDS {
                    let late = fault(Word::Delayed, late_s);
                    rig.faults.begin(Place::Board(board), late);
                }
            });
            b.run(0.5);
        }
        b.run(1.0);
        b.until("it is reported", 3.0, |b| b.alarmed("Data come"));
        b.tell(Command::Arm);
        b.tell(Command::Goto(Goal::position(FAR_M)));
        let safe_s = b.until("it is SAFE", 3.0, |b| b.is_safe("late"));
        assert!(!b.pumps_ran(b.t_s() - safe_s, b.t_s()), "a pump ran");
        row(
            (4, 2),
            "a line that brings everything 150 ms late",
            "old data never passes as fresh",
            &[],
            &format!(
                "reported before anything moves; armed, SAFE {} later, no pump ran",
                time(safe_s)
            ),
        );
    });
}
