//! A patch is tried on the running twin, compared, and dropped or kept.

use super::*;
use crate::gui::tests::conduct::connected;
use crate::signal::{Predicted, SensorVec, TriedPatch};

/// What a model reads whose springs are `mm` shorter and whose pads are tilted by `deg` less than what is measured.
fn reads(s: &Snapshot, mm: f64, deg: f64) -> SensorVec {
    let mut reads = s.sensors.clone().expect("sensors").sensors;
    reads.spring_m.iter_mut().for_each(|l| *l -= mm * 1e-3);
    for ypr in &mut reads.imu_ypr_rad {
        // A heading may be anywhere.
        *ypr = [
            ypr[0] - 1.0,
            ypr[1] - deg.to_radians(),
            ypr[2] - deg.to_radians(),
        ];
    }
    reads
}

/// An arm whose model is 2 mm and 1 deg off, with the model that is tried so far off.
fn tried(t_s: f64, off: Option<[f64; 2]>) -> Snapshot {
    let mut s = connected(t_s, false, Mode::Hold);
    s.model_sensors = Some(reads(&s, 2.0, 1.0).into());
    s.tried = off.map(|[mm, deg]| TriedPatch {
        name: "undeclared payload 300 g".into(),
        robot: "abc".into(),
        since: Stamp::from_seconds(1.0),
        predicted: Some(Arc::new(Predicted {
            shape: s.shape.as_deref().cloned().expect("a shape"),
            sensors: reads(&s, mm, deg),
        })),
    });
    s
}

/// Some seconds of an arm on which a patch is tried.
pub(in crate::gui::tests) fn tried_for_seconds() -> Vec<Snapshot> {
    (0..24)
        .map(|k| tried(1.0 + 0.1 * f64::from(k), Some([0.5, 0.25])))
        .collect()
}

/// The Patch step of a window on an arm, with the finding of an undeclared payload.
fn at_patch() -> (Twin, Harness<'static, App>) {
    at_patch_of(RobotSpec::reference())
}

fn at_patch_of(robot: RobotSpec) -> (Twin, Harness<'static, App>) {
    let seen = Rc::new(RefCell::new(Seen::default()));
    let (twin, handle) = twin(tried(0.5, None));
    let mut app = App::new(Some(handle), robot, services(&seen));
    app.screen = ScreenId::Gap;
    app.screens
        .gap
        .take(with_verdict(Verdict::Named), Origin::Simulated, None);
    app.screens.gap.step = Step::Patch;
    let mut h = harness(app);
    h.run_steps(4);
    (twin, h)
}

/// Publishes some seconds of an arm on which a model that is so far off is tried.
fn seconds(twin: &Twin, h: &mut Harness<'_, App>, off: [f64; 2]) {
    for k in 0..24 {
        twin.publish(tried(1.0 + 0.1 * f64::from(k), Some(off)));
        h.run_steps(1);
    }
    h.run_steps(3);
}

#[test]
fn a_tried_patch_is_compared_and_kept_or_dropped() {
    let (twin, mut h) = at_patch();
    assert!(is_disabled(&h, "Drop the patch") && is_disabled(&h, "Keep the patch"));
    h.get_by_label_contains("Networks, sensing, reach verdicts and control keep");
    click(&mut h, "Try on the running twin");
    let orders = twin.taken();
    let [Command::TryPatch { name, robot }] = &orders[..] else {
        panic!("one order: {orders:?}");
    };
    assert!(name.starts_with("undeclared payload "), "{name}");
    assert_eq!(robot.base_hash, RobotSpec::reference().hash);
    assert_eq!(robot.patches.len(), 1);
    // Both numbers and the verdict; the headings, which are far off, count for nothing.
    seconds(&twin, &mut h, [0.5, 0.25]);
    h.get_by_label("◌ Tried: undeclared payload 300 g");
    for number in ["2.00 mm", "0.50 mm", "1.00 deg", "0.25 deg"] {
        h.get_by_label(number);
    }
    let verdicts: Vec<_> = h.query_all_by_label("● closer by 75 %").collect();
    assert_eq!(verdicts.len(), 2);
    h.get_by_label_contains("Residual of spring");
    click(&mut h, "Keep the patch");
    assert_eq!(twin.taken(), [Command::KeepPatch]);
    let mut kept = tried(4.0, None);
    kept.kept_patch = Some("undeclared payload 300 g".into());
    twin.publish(kept);
    h.run_steps(3);
    h.get_by_label("● Kept: undeclared payload 300 g");
    assert!(h.query_by_label_contains("closer by").is_none());
    click(&mut h, "Revert the kept patch");
    assert_eq!(twin.taken(), [Command::RevertPatch]);
}

#[test]
fn a_patch_that_is_no_better_is_called_so_and_is_dropped() {
    let (twin, mut h) = at_patch();
    seconds(&twin, &mut h, [3.0, 0.5]);
    h.get_by_label("3.00 mm");
    h.get_by_label("▲ not closer");
    h.get_by_label("● closer by 50 %");
    click(&mut h, "Drop the patch");
    assert_eq!(twin.taken(), [Command::DropPatch]);
}

#[test]
fn a_patch_of_another_robot_and_an_arm_that_gives_no_data_are_refused_with_the_reason() {
    let (twin, mut h) = at_patch();
    let mut off = tried(2.0, None);
    off.link.connected = false;
    twin.publish(off);
    h.run_steps(3);
    assert!(is_disabled(&h, "Try on the running twin"));
    twin.publish(tried(3.0, None));
    h.run_steps(3);
    assert!(!is_disabled(&h, "Try on the running twin"));
    assert_eq!(twin.taken(), []);
    let other = format!("{REFERENCE}\n# another\n");
    let (_twin, h) = at_patch_of(RobotSpec::from_toml(&other).expect("reads"));
    assert!(is_disabled(&h, "Try on the running twin"));
}

#[test]
fn without_a_baseline_the_light_is_grey_and_leads_to_the_way_to_get_one() {
    let (_twin, mut h) = running(connected(5.0, true, Mode::Hold));
    h.get_by_label("○ no baseline").click();
    h.run_steps(4);
    assert_eq!(h.state().screen, ScreenId::Gap);
    h.get_by_label_contains("press Keep as baseline, and connect again");
    // A monitor that has not judged yet is not none.
    let (_twin, h) = running(Snapshot {
        is_monitored: true,
        ..connected(5.0, true, Mode::Hold)
    });
    h.get_by_label("○ settling");
}
