//! What is checked when hardware is armed: on the firmware, whose boards are at a port.

mod firmware {
    use springtwin::rig::faults::{Fault, Place, Word};
    use springtwin::signal::{ArmingCheck, CHAMBERS, Mode};
    use springtwin::twin::Command;

    use crate::faults::bench::{Boards, case};
    use crate::safety::Case;

    #[test]
    fn gauges_are_checked_when_hardware_is_armed() {
        case(Boards::Firmware, |b| {
            b.tell(Command::Arm);
            let mut worst_s = 0.0_f64;
            let from_s = b.t_s();
            b.until("the gauges are checked", 30.0, |b| {
                b.event_s(from_s, "all six gauges follow").is_some()
            });
            println!("first check: {:.1} s", b.t_s() - from_s);
            b.tell(Command::Disarm);
            b.run(1.0);
            let from_s = b.t_s();
            b.tell(Command::Arm);
            b.until("the gauges are checked", 30.0, |b| {
                b.event_s(from_s, "all six gauges follow").is_some()
            });
            println!("later checks: {:.1} s", b.t_s() - from_s);
            b.tell(Command::Disarm);
            b.run(1.0);
            // From when its chamber's turn has come.
            let runs = crate::safety::runs(Boards::Firmware, CHAMBERS);
            for run in 0..runs {
                let gauge = run % CHAMBERS;
                b.rig(|rig| {
                    rig.faults
                        .begin(Place::Gauge(gauge), Fault::of(Word::Stuck))
                });
                let from_s = b.t_s();
                b.tell(Command::Arm);
                b.until("its turn comes", 30.0, |b| {
                    b.now.gauge_check == ArmingCheck::Chamber(gauge)
                });
                let turn_s = b.t_s();
                b.until("it is disarmed", 30.0, |b| b.now.mode == Mode::Disarmed);
                let words = format!("gauge {}", gauge + 1);
                assert!(b.event_s(from_s, &words).is_some(), "{words}");
                worst_s = worst_s.max(b.t_s() - turn_s);
                b.rig(|rig| rig.faults.clear());
                b.run(2.0);
            }
            Case {
                of: 11,
                place: 2,
                what: "program: from the turn of a chamber whose gauge does not follow to disarmed",
                boards: "firmware",
                bound: 2100.0,
                worst: worst_s * 1e3,
                unit: "ms",
                runs,
            }
            .keep();
        });
    }

    /// A gauge whose wire is cut reads what its neighbour does.
    #[test]
    fn a_gauge_that_follows_its_neighbour_is_not_armed() {
        case(Boards::Firmware, |b| {
            b.rig(|rig| rig.faults.begin(Place::Gauge(1), Fault::of(Word::Open)));
            b.run(0.2);
            let from_s = b.t_s();
            b.tell(Command::Arm);
            b.run(0.1);
            b.until("it is disarmed", 30.0, |b| b.now.mode != Mode::Hold);
            assert!(b.event_s(from_s, "gauge 2").is_some());
        });
    }
}
