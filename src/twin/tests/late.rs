//! Data that come too late: the messages distinguish a busy computer from silent boards.

use super::*;
use crate::signal::HostDelay;

/// An armed twin on hardware, with frames up to tick 20.
fn armed(practice: bool) -> Twin {
    let mut twin = twin();
    twin.accept_virtual_calibration();
    twin.observe_link(link(practice, None));
    feed(&mut twin, 0, 20);
    twin.tick(at(20), Some(frame(20)), &[Command::Arm]);
    assert_eq!(twin.mode(), Mode::Hold);
    twin
}

fn link(practice: bool, host_delay: Option<HostDelay>) -> LinkStatus {
    LinkStatus {
        connected: true,
        gripper: Some(Gripper::Open),
        practice,
        host_delay,
        ..LinkStatus::default()
    }
}

/// The reason and the alarm of a twin that is SAFE.
fn reported(twin: &Twin) -> (String, String) {
    let Mode::Safe(reason) = twin.mode() else {
        panic!("not SAFE but {:?}", twin.mode())
    };
    let s = twin.snapshot();
    let alarm = s.alarms.iter().find(|a| a.text().starts_with("SAFE"));
    (reason, alarm.expect("an alarm").text())
}

#[test]
fn silent_boards_are_named_while_the_program_runs() {
    let mut twin = armed(false);
    for k in 21..35 {
        twin.tick(at(k), None, &[]);
    }
    let (reason, alarm) = reported(&twin);
    assert_eq!(
        reason,
        "no data from the boards for 100 ms although this program was running"
    );
    assert_eq!(
        alarm,
        format!("SAFE: {reason}. Check their power and the USB cable, then press Reset.")
    );
    // A rig process that is not run is no cable.
    let mut twin = armed(true);
    for k in 21..35 {
        twin.tick(at(k), None, &[]);
    }
    let (reason, alarm) = reported(&twin);
    assert!(
        reason.starts_with("no data from the virtual rig for"),
        "{reason}"
    );
    assert!(!alarm.contains("cable"), "{alarm}");
}

#[test]
fn a_busy_computer_is_named_when_the_twin_was_not_run() {
    let mut twin = armed(false);
    twin.tick(at(21), Some(frame(21)), &[]);
    // Nothing ticks for 250 ms, and nothing waits when it does again.
    twin.tick(at(46), None, &[]);
    let (reason, alarm) = reported(&twin);
    assert_eq!(
        reason,
        "this computer was busy for 240 ms, so the boards' data came too late"
    );
    assert_eq!(
        alarm,
        format!("SAFE: {reason}. Close other programs, then press Reset.")
    );
    // What is said stays when the data come again.
    for k in 47..80 {
        twin.tick(at(k), Some(frame(k)), &[]);
    }
    assert_eq!(reported(&twin), (reason, alarm));
}

#[test]
fn a_busy_computer_is_named_when_the_link_was_not_run() {
    let mut twin = armed(false);
    // The twin ticks; its link says nothing, not even its own status.
    for k in 21..35 {
        let lasted_s = at(k).since(at(20));
        let delay = (lasted_s > 0.075).then_some(HostDelay {
            ended: at(k),
            lasted_s,
        });
        twin.observe_link(link(false, delay));
        twin.tick(at(k), None, &[]);
    }
    let (reason, _) = reported(&twin);
    assert_eq!(
        reason,
        "this computer was busy for 110 ms, so the boards' data came too late"
    );
    // Boards that heard no heartbeat meanwhile have switched off by themselves.
    let mut twin = armed(false);
    twin.tick(at(21), Some(frame(21)), &[]);
    let ended = at(44);
    twin.observe_link(link(
        false,
        Some(HostDelay {
            ended,
            lasted_s: 0.23,
        }),
    ));
    let mut f = frame(45);
    f.faults = crate::link::wire::fault::SAFE | crate::link::wire::fault::HEARTBEAT_LOST;
    twin.tick(at(45), Some(f), &[]);
    let (reason, alarm) = reported(&twin);
    assert_eq!(
        reason,
        "this computer was busy for 240 ms, so the boards switched their pumps off"
    );
    assert!(alarm.contains("Close other programs"), "{alarm}");
}

#[test]
fn a_short_delay_does_not_excuse_silent_boards() {
    let mut twin = armed(false);
    // 60 of the 110 ms were lost to other programs; in the rest something would have come.
    for k in [21, 22, 29, 30, 31, 32] {
        twin.tick(at(k), None, &[]);
    }
    let (reason, _) = reported(&twin);
    assert!(reason.starts_with("no data from the boards"), "{reason}");
}
