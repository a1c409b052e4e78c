//! The list of messages: repeats, levels, and SAFE above all of them.

use super::*;
use crate::signal::{Alarm, AlarmCause, Severity};
use crate::twin::Event;

const REASON: &str = "over-pressure in chamber 3 (+42.6 kPa)";

fn notice(twin: &Twin, text: String) {
    let stamp = Stamp::ZERO;
    let event = Event::Notice { stamp, text };
    twin.events.try_send(event).expect("room");
}

fn safe_now(t_s: f64) -> Snapshot {
    let mut s = fixture::snapshot(t_s);
    s.mode = Mode::Safe(REASON.into());
    let cause = AlarmCause::Safe {
        reason: REASON.into(),
        remedy: "Remove the cause",
    };
    s.alarms = vec![Alarm {
        since: s.stamp,
        severity: Severity::Critical,
        cause,
    }];
    s
}

#[test]
fn repeats_are_one_line_and_safe_stays_on_top_until_it_is_reset() {
    let (twin, mut h) = running(fixture::snapshot(1.0));
    twin.publish(safe_now(1.1));
    let stamp = Stamp::from_seconds(1.1);
    let mode = Mode::Safe(REASON.into());
    twin.events
        .try_send(Event::Mode { stamp, mode })
        .expect("room");
    h.run_steps(2);
    // What came since fills the list, most of it the same sentence.
    for k in 0..40 {
        notice(&twin, "Board 2 is back.".into());
        notice(&twin, format!("Stop {k} was reached."));
        h.run_steps(1);
    }
    // The strip tells of SAFE, not of the newest notice.
    h.get_by_label(&format!(
        "⊗ SAFE: {REASON}. Remove the cause, then press Reset."
    ));
    assert!(h.query_by_label("Stop 39 was reached.").is_none());
    h.get_by_label("Messages 42 ⊗1").click();
    h.run_steps(3);
    h.get_by_label_contains("⊗ SAFE for 0:");
    h.get_by_label("×40");
    // Narrowed to nothing, SAFE is still there.
    for button in ["● Notices 41", "▲ Warnings 0", "⊗ Critical 1"] {
        h.get_by_label(button).click();
        h.run_steps(2);
    }
    assert!(h.query_by_label("×40").is_none());
    h.get_by_label("All messages are hidden: press a button above.");
    h.get_by_label_contains("⊗ SAFE for 0:");
    let mut reset = fixture::snapshot(9.0);
    reset.mode = Mode::Disarmed;
    twin.publish(reset);
    h.run_steps(3);
    assert!(h.query_by_label_contains("⊗ SAFE for").is_none());
    // What was said of it stays listed.
    h.get_by_label("⊗ Critical 1").click();
    h.run_steps(2);
    h.get_by_label(&format!("⊗ Mode: SAFE ({REASON})"));
}

/// Started from the desktop, a program has no terminal for them.
#[test]
fn warnings_of_the_log_are_messages_of_the_window() {
    let (_twin, handle) = twin(fixture::snapshot(1.0));
    let (log, warnings) = sync_channel(4);
    let mut app = App::new(Some(handle), RobotSpec::reference(), Services::none());
    app.warnings = Some(warnings);
    let mut h = harness(app);
    let text = "The window's settings are not kept: the disk is full";
    log.try_send((Severity::Warning, text.to_owned()))
        .expect("a free place");
    h.run_steps(3);
    h.get_by_label_contains(text);
}

#[test]
fn the_list_has_critical_messages_first_then_warnings_then_notices() {
    let (twin, mut h) = running(fixture::snapshot(1.0));
    let refused = |reason: &str| Event::Refused {
        stamp: Stamp::ZERO,
        reason: reason.into(),
    };
    notice(&twin, "The first notice.".into());
    twin.events
        .try_send(refused("The first refusal."))
        .expect("room");
    let mode = Mode::Safe(REASON.into());
    let stamp = Stamp::ZERO;
    twin.events
        .try_send(Event::Mode { stamp, mode })
        .expect("room");
    h.run_steps(2);
    twin.events
        .try_send(refused("The second refusal."))
        .expect("room");
    notice(&twin, "The second notice.".into());
    h.run_steps(2);
    h.get_by_label("Messages 5 ▲2 ⊗1").click();
    h.run_steps(3);
    // The list is on the right; on the left lie the warnings of the last seconds.
    let top = |label: &str| {
        let mut listed = h
            .get_all_by_label(label)
            .filter(|n| n.rect().left() > 640.0);
        listed.next().expect("is listed").rect().top()
    };
    let order = [
        "Critical".to_owned(),
        format!("⊗ Mode: SAFE ({REASON})"),
        "Warnings".to_owned(),
        "▲ The second refusal.".to_owned(),
        "▲ The first refusal.".to_owned(),
        "Notices".to_owned(),
    ];
    let tops: Vec<f32> = order.iter().map(|label| top(label)).collect();
    assert!(tops.is_sorted(), "{order:?} {tops:?}");
    let listed = |label: &str| h.query_all_by_label(label).count() > 0;
    assert!(listed("The first notice.") && listed("The second notice."));
    // A level that is hidden has no heading either.
    h.get_by_label("▲ Warnings 2").click();
    h.run_steps(2);
    assert!(h.query_by_label("Warnings").is_none());
}
