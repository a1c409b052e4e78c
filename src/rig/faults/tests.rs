use super::*;
use crate::link::wire::{Body, Decoder, Packet, Received};
use crate::rig::{RigOptions, VirtualRig};
use crate::robot::RobotSpec;

fn rig() -> VirtualRig {
    VirtualRig::new(&RobotSpec::reference(), &RigOptions::default()).expect("settles")
}

/// What board 1 says in the seconds from `from_s` to `to_s`, decoded: frames, and how many broke.
fn listen(rig: &mut VirtualRig, from_s: f64, to_s: f64) -> (Vec<Packet>, u64) {
    let mut decoder = Decoder::default();
    let mut packets = Vec::new();
    for ms in (from_s * 1e3) as u64 + 1..=(to_s * 1e3) as u64 {
        let [said, _] = rig.advance_lines(ms as f64 * 1e-3, [&[]; BOARDS]);
        for byte in said {
            if let Some(Received::Packet(p)) = decoder.push(byte) {
                packets.push(p);
            }
        }
    }
    (packets, decoder.counts.bad())
}

fn script(text: &str) -> Script {
    Script::from_toml(text).expect("a script")
}

#[test]
fn a_script_breaks_and_mends_when_it_says() {
    let mut rig = rig();
    rig.faults.follow(script(
        "[[fault]]\nat_s = 0.2\nfor_s = 0.3\nwhere = 'spring 2'\nwhat = 'off'\n\
         [[fault]]\nat_s = 0.3\nwhere = 'imu 1'\nwhat = 'off'",
    ));
    for (until_s, spring, imu) in [(0.19, true, true), (0.4, false, false), (0.6, true, false)] {
        rig.advance(until_s, &[]);
        let r = rig.readings()[0];
        assert_eq!(r.springs[1].is_some(), spring, "{until_s}");
        assert_eq!(r.imus[0].is_some(), imu, "{until_s}");
        assert!(r.springs[0].is_some() && r.imus[1].is_some());
    }
}

#[test]
fn each_word_does_to_a_reading_what_it_says() {
    let read = |word, amount, n: usize| -> Vec<Option<f64>> {
        let mut channel = Channel::<f64>::default();
        let mut rng = Pcg64Mcg::seed_from_u64(1);
        // 100 readings 10 ms apart, each its own number.
        let all = (0..100).map(|k| {
            let fault = (k >= 50).then_some(Fault { word, amount });
            channel.pass(f64::from(k) * 0.01, Some(f64::from(k)), fault, &mut rng)
        });
        all.skip(50).take(n).collect()
    };
    assert_eq!(read(Word::Off, 0.0, 3), [None; 3]);
    assert_eq!(read(Word::Stuck, 0.0, 3), [Some(49.0); 3]);
    assert_eq!(read(Word::Wrong, 2.0, 2), [Some(2050.0), Some(2051.0)]);
    assert_eq!(
        read(Word::Slow, 0.03, 7),
        [50.0, 50.0, 50.0, 53.0, 53.0, 53.0, 56.0].map(Some)
    );
    assert_eq!(read(Word::Delayed, 0.2, 2), [Some(30.0), Some(31.0)]);
    let lost = read(Word::Intermittent, 0.5, 50);
    let lost = lost.iter().filter(|r| r.is_none()).count();
    assert!((10..40).contains(&lost), "{lost}");
    let garbage = read(Word::Garbage, 0.0, 50);
    assert!(garbage.iter().all(|r| r.is_some_and(|x| x.abs() <= 65e3)));
    assert!(garbage[0] != garbage[1]);
}

#[test]
fn each_word_does_to_a_line_what_it_says() {
    let hear = |word, amount| {
        // Frames are counted: by clocks that are exact.
        let options = RigOptions {
            clocks: Some(Default::default()),
            ..RigOptions::default()
        };
        let mut rig = VirtualRig::new(&RobotSpec::reference(), &options).expect("settles");
        listen(&mut rig, 0.0, 0.5);
        rig.faults.begin(Place::Board(0), Fault { word, amount });
        listen(&mut rig, 0.5, 2.5)
    };
    let (sound, broken) = hear(Word::Wrong, 0.0);
    assert_eq!((sound.len(), broken), (200, 0));
    let (sound, broken) = hear(Word::Wrong, 0.2);
    assert!((20..60).contains(&broken), "{broken}");
    assert!((140..=180).contains(&sound.len()), "{}", sound.len());
    assert_eq!(hear(Word::Off, 0.0).0.len(), 0);
    assert_eq!(hear(Word::Garbage, 0.0).0.len(), 0);
    let (same, _) = hear(Word::Stuck, 0.0);
    assert!(same.len() > 190 && same.iter().all(|p| *p == same[0]));
    let (lost, broken) = hear(Word::Intermittent, 0.5);
    assert!(
        (60..140).contains(&lost.len()) && broken == 0,
        "{}",
        lost.len()
    );
    let (twice, _) = hear(Word::Twice, 1.0);
    assert!(twice.chunks_exact(2).all(|p| p[0] == p[1]));
    assert!((390..=402).contains(&twice.len()), "{}", twice.len());
    let (swapped, _) = hear(Word::Swapped, 0.3);
    let back = |p: &[Packet]| p[1].seq.wrapping_sub(p[0].seq) > 1 << 15;
    assert!(swapped.windows(2).filter(|p| back(p)).count() > 20);
    // 200 samples of 132 bytes at 5,000 bytes a second.
    let (slow, broken) = hear(Word::Slow, 5000.0);
    assert!(
        (60..=80).contains(&slow.len()) && broken == 0,
        "{}",
        slow.len()
    );
    let (late, _) = hear(Word::Delayed, 0.5);
    assert!((148..=152).contains(&late.len()), "{}", late.len());
}

#[test]
fn a_board_without_power_is_silent_drives_nothing_and_boots_when_it_is_back() {
    let mut rig = rig();
    let (first, _) = listen(&mut rig, 0.0, 0.5);
    let nonce = |packets: &[Packet]| {
        packets.iter().find_map(|p| match p.body {
            Body::Hello(h) => Some(h.boot_nonce),
            _ => None,
        })
    };
    rig.faults.begin(Place::Board(0), Fault::of(Word::Off));
    assert!(listen(&mut rig, 0.5, 1.0).0.is_empty());
    assert_eq!(rig.set_pa(), [None; CHAMBERS]);
    rig.faults.end(Place::Board(0));
    let (again, _) = listen(&mut rig, 1.0, 1.5);
    assert!(nonce(&first).is_some() && nonce(&again).is_some());
    assert_ne!(nonce(&first), nonce(&again), "it says that it has booted");
}

#[test]
fn a_leak_loses_air_and_a_wrong_supply_gives_too_much() {
    let run = |place, fault, set_pa: f64| {
        let mut rig = rig();
        let set = [Some(set_pa); CHAMBERS];
        (0..1500).for_each(|_| rig.step(&set));
        rig.faults.begin(place, fault);
        (0..1500).for_each(|_| rig.step(&set));
        rig.plant.chamber_pa()
    };
    let leak = Fault {
        word: Word::Leak,
        amount: 4.0,
    };
    let p = run(Place::Chamber(2), leak, 20e3);
    assert!(p[2] < 12e3 && p[1] > 19e3, "{p:?}");
    let over = Fault {
        word: Word::Wrong,
        amount: 50.0,
    };
    let p = run(Place::Chamber(2), over, 20e3);
    assert!(p[2] > 42e3 && p[1] < 21e3, "{p:?}");
}

#[test]
fn scripts_that_cannot_be_are_refused_with_the_fault_named() {
    let refuse = |entry: &str| {
        Script::from_toml(&format!("[[fault]]\n{entry}"))
            .expect_err("refused")
            .to_string()
    };
    for (entry, words) in [
        (
            "at_s = 1\nwhere = 'spring 13'\nwhat = 'off'",
            "fault 1: 'spring 13' is no place",
        ),
        (
            "at_s = 1\nwhere = 'spring 1'\nwhat = 'broken'",
            "'broken' is no fault: it is one of off, stuck",
        ),
        (
            "at_s = 1\nwhere = 'spring 1'\nwhat = 'leak'",
            "spring 1 cannot be 'leak'",
        ),
        (
            "at_s = -1\nwhere = 'spring 1'\nwhat = 'off'",
            "at_s and for_s are seconds, 0 or more",
        ),
        (
            "at_s = 1\nwhere = 'board 1'\nwhat = 'wrong'\namount = 2",
            "amount 2 is not within 0 and 1 (share)",
        ),
        (
            "at_s = 1\nwhere = 'board 1'\nwhat = 'off'\namount = 2",
            "'off' takes no amount",
        ),
        (
            "at_s = 1\nwhere = 'board 1'",
            "line 1: missing field `what`",
        ),
        (
            "at_s = 1\nwhere = 'spring 3'\nwhat = 'exchanged'\namount = 8",
            "amount 8 is not within 1 and 6 (number of the other spring)",
        ),
        (
            "at_s = 1\nwhere = 'spring 3'\nwhat = 'exchanged'\namount = 3",
            "amount 3 is no other than spring 3: it is the number of the other spring",
        ),
        (
            "at_s = 1\nwhere = 'imu 1'\nwhat = 'exchanged'\namount = 3",
            "amount 3 is not within 1 and 2 (number of the other IMU)",
        ),
        (
            "at_s = 1\nwhere = 'board 1'\nwhat = 'exchanged'",
            "board 1 cannot be 'exchanged'",
        ),
        (
            "at_s = 1\nwhere = 'boards'\nwhat = 'exchanged'\namount = 2",
            "'exchanged' takes no amount",
        ),
        (
            "at_s = 1\nwhere = 'counter 1'\nwhat = 'off'",
            "counter 1 cannot be 'off'",
        ),
        ("at_s = nan\nwhere = 'port'\nwhat = 'off'", "at_s and for_s"),
        (
            "at_s = 1\nwhere = 'port'\nwhat = 'off'\nfor = 3",
            "unknown field `for`",
        ),
    ] {
        let said = refuse(entry);
        assert!(said.contains(words), "{said}");
        assert_eq!(said.lines().count(), 1, "{said}");
    }
}

/// Readings of the rig, with a bend in the arm so that springs, IMUs and chambers differ.
fn bent(text: &str) -> [[Readings; BOARDS]; 2] {
    let mut both = ["", text].map(|text| {
        let mut rig = rig();
        rig.faults.follow(script(text));
        rig.settle_at(&[18e3, -12e3, 2e3, 9e3, -15e3, 5e3])
            .expect("settles");
        // The schedule begins; the same noise in both.
        rig.advance(0.02, &[]);
        rig.settle_at(&[18e3, -12e3, 2e3, 9e3, -15e3, 5e3])
            .expect("settles");
        *rig.readings()
    });
    both.swap(0, 1);
    both
}

fn entry(place: &str, amount: &str) -> String {
    format!("[[fault]]\nat_s = 0.01\nwhere = '{place}'\nwhat = 'exchanged'\n{amount}")
}

#[test]
fn exchanged_plugs_of_springs_and_imus_swap_two_inputs_of_a_board_and_no_more() {
    let [faulty, sound] = bent(&entry("spring 9", "amount = 12"));
    let mut wanted = sound;
    wanted[1].springs.swap(2, 5);
    assert_ne!(sound[1].springs[2], sound[1].springs[5]);
    assert_eq!(faulty, wanted);
    // Without a number it is the other one of the pair.
    let [faulty, sound] = bent(&entry("spring 3", ""));
    let mut wanted = sound;
    wanted[0].springs.swap(2, 3);
    assert_eq!(faulty, wanted);
    let [faulty, sound] = bent(&entry("imu 4", "amount = 3"));
    let mut wanted = sound;
    wanted[1].imus.swap(0, 1);
    assert_ne!(sound[1].imus[0], sound[1].imus[1]);
    assert_eq!(faulty, wanted);
}

#[test]
fn a_fault_stays_with_its_spring_when_plugs_are_exchanged() {
    let text =
        entry("spring 1", "amount = 4") + "\n[[fault]]\nat_s = 0\nwhere = 'spring 4'\nwhat = 'off'";
    let [faulty, sound] = bent(&text);
    assert_eq!(
        faulty[0].springs[0], None,
        "spring 4 is at the input of spring 1"
    );
    assert_eq!(faulty[0].springs[3], sound[0].springs[0]);
}

#[test]
fn exchanged_boards_read_and_drive_the_other_segment_with_their_own_clocks() {
    let [faulty, sound] = bent(&entry("boards", ""));
    let clocks = RigOptions::default().clocks();
    for b in 0..BOARDS {
        let of = 1 - b;
        assert_eq!(faulty[b].imus, sound[of].imus);
        assert_eq!(faulty[b].chamber_pa, sound[of].chamber_pa);
        for (now, before) in faulty[b].springs.iter().zip(sound[of].springs) {
            let (now, before) = (now.expect("read"), before.expect("read"));
            let hz = |r: SpringReading, by: usize| {
                f64::from(r.count) / f64::from(r.gate_ticks) * clocks[by].rate(0.0)
            };
            let off = hz(now, b) / hz(before, of) - 1.0;
            assert!(off.abs() < 2e-4, "board {b}: {off}");
        }
    }
    // What board 1 commands fills the chambers of segment 2.
    let mut rig = rig();
    rig.faults
        .begin(Place::Segments, Fault::of(Word::Exchanged));
    rig.faults.begin(Place::Board(0), Fault::of(Word::Off));
    rig.faults.begin(Place::Supply, Fault::of(Word::Stuck));
    let driven = rig.set_pa().map(|p| p.is_some());
    assert_eq!(driven, [true, true, true, false, false, false]);
}

#[test]
fn a_hung_counter_repeats_all_six_pairs_of_its_board_until_it_ends() {
    let mut rig = rig();
    rig.faults.follow(script(
        "[[fault]]\nat_s = 0.3\nfor_s = 0.5\nwhere = 'counter 2'\nwhat = 'stuck'",
    ));
    let pairs = |rig: &mut VirtualRig, t_s: f64| {
        rig.advance(t_s, &[]);
        rig.readings().map(|r| r.springs)
    };
    let before = pairs(&mut rig, 0.295);
    let imu = rig.readings()[1].imus[0];
    for k in 0..20 {
        let now = pairs(&mut rig, 0.31 + 0.02 * f64::from(k));
        assert_eq!(now[1], before[1], "all six repeat");
        assert_ne!(now[0], before[0], "the other board counts");
    }
    assert_ne!(rig.readings()[1].imus[0], imu);
    let after = pairs(&mut rig, 0.9);
    assert_ne!(after[1], before[1]);
}

/// Two faults at once on two springs of one segment.
#[test]
fn two_springs_of_a_segment_can_be_wrong_at_once() {
    let wrong =
        |n: u32| format!("[[fault]]\nat_s = 0\nwhere = 'spring {n}'\nwhat = 'wrong'\namount = 5\n");
    let [faulty, sound] = bent(&(wrong(2) + &wrong(5)));
    for k in 0..6 {
        let hz = |r: &Readings| {
            let s = r.springs[k].expect("read");
            f64::from(s.count) / f64::from(s.gate_ticks)
        };
        let off = (hz(&faulty[0]) / hz(&sound[0]) - 1.0).abs();
        // The springs' lag lets half of it through within a step.
        assert_eq!(off > 5e-4, [1, 4].contains(&k), "spring {}: {off}", k + 1);
    }
}
