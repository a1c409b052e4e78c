//! Nothing moves when a banner comes or goes.

use super::audit::{Placed, placed};
use super::*;
use crate::signal::{Alarm, AlarmCause, ChannelHealth, Evidence, Severity};

/// Widgets that are there once, by role and name, with where they lie.
fn once(h: &Harness<'_, App>) -> Vec<Placed> {
    let all = placed(h);
    let same = |a: &Placed, b: &Placed| a.role == b.role && a.name == b.name;
    let single = |a: &&Placed| all.iter().filter(|b| same(a, b)).count() == 1;
    all.iter().filter(single).cloned().collect()
}

/// What lies elsewhere than before, and how many widgets were compared.
fn moved(screen: ScreenId, before: &[Placed], after: &[Placed]) -> (Vec<String>, usize) {
    let mut found = Vec::new();
    let mut compared = 0;
    for a in before {
        // In the bars texts change, and with them how wide they are; STOP and HOLD stay.
        let keeps = ["■ STOP", "▮▮ HOLD"].contains(&a.name.as_str());
        let in_a_bar = a.rect.top() < 92.0 && !keeps;
        // On Operate nothing at all moves; elsewhere lists of checks may grow and shrink.
        if screen != ScreenId::Operate && !a.is_control() && a.role != egui::accesskit::Role::Image
        {
            continue;
        }
        let Some(b) = after.iter().find(|b| b.role == a.role && b.name == a.name) else {
            continue;
        };
        let same =
            (a.rect.min - b.rect.min).length() < 0.6 && (a.rect.max - b.rect.max).length() < 0.6;
        compared += 1;
        if !same && !in_a_bar {
            found.push(format!("{} is now at {:?}", a.told(), b.rect));
        }
    }
    (found, compared)
}

type Change = fn(&Twin, &mut Harness<'_, App>);

fn publish(twin: &Twin, change: impl FnOnce(&mut Snapshot)) {
    let mut s = fixture::snapshot(1.0);
    s.stamp = s.stamp.plus(0.01);
    change(&mut s);
    twin.publish(s);
}

const CASES: [(&str, Change); 6] = [
    ("SAFE", |twin, _| {
        publish(twin, |s| s.mode = Mode::Safe("stop was pressed".into()));
    }),
    ("the link is lost", |twin, _| {
        publish(twin, |s| {
            s.link.connected = false;
            s.link.age_s = 4.2;
            s.mode = Mode::Disarmed;
        });
    }),
    ("SAFE and the link is lost", |twin, _| {
        publish(twin, |s| {
            s.link.connected = false;
            s.link.age_s = 4.2;
            s.mode = Mode::Safe("no data from the boards for 100 ms".into());
        });
    }),
    ("a recording failed", |twin, _| {
        let failed = Event::RecordingFailed {
            stamp: Stamp::ZERO,
            reason: "The recording could not be begun: the disk is full.".into(),
        };
        twin.events.try_send(failed).expect("room");
    }),
    ("an alarm", |twin, _| {
        publish(twin, |s| {
            s.alarms = vec![Alarm {
                since: Stamp::ZERO,
                severity: Severity::Critical,
                cause: AlarmCause::Spring {
                    spring: 8,
                    evidence: Evidence {
                        health: ChannelHealth::Stuck,
                        ..Evidence::default()
                    },
                },
            }];
        });
    }),
    ("connecting", |_, h| {
        let app = h.state_mut();
        app.services.connect = Box::new(|_| {
            let (job, worker) = Job::pair();
            // The work goes on for as long as the test takes.
            std::mem::forget(worker);
            job
        });
        app.connection.join("/dev/ttyACM0", &mut app.services);
    }),
];

#[test]
fn nothing_moves_when_a_banner_comes_or_goes() {
    let mut found = Vec::new();
    for screen in ScreenId::ALL {
        for size in [[1024.0, 700.0], [1280.0, 760.0]] {
            for (what, change) in CASES {
                let (twin, handle) = twin(fixture::snapshot(1.0));
                let mut app = App::new(Some(handle), RobotSpec::reference(), library_services());
                app.screen = screen;
                let mut h = harness(app);
                h.set_size(size.into());
                h.run_steps(5);
                let before = once(&h);
                change(&twin, &mut h);
                h.run_steps(4);
                let (there, compared) = moved(screen, &before, &once(&h));
                assert!(
                    compared > 20,
                    "{what} on {screen:?}: only {compared} compared"
                );
                twin.publish(fixture::snapshot(1.02));
                h.run_steps(2);
                for one in there {
                    found.push(format!("{what} on {screen:?} at {size:?}: {one}"));
                }
                let line = h.get_by_label("■ STOP").rect();
                assert!(line.height() > 35.0, "{line}");
            }
        }
    }
    assert!(
        found.is_empty(),
        "{} moved\n{}",
        found.len(),
        found.join("\n")
    );
}
