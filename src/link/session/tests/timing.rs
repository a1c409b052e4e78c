//! One time base for both boards: clocks that differ, drift and jump, lines that delay.

use super::*;

#[test]
fn both_boards_land_on_one_time_base_at_100_hz() {
    let mut w = World::new(1);
    w.run(0.3);
    let ready = |board| move |e: &LinkEvent| matches!(e, LinkEvent::BoardReady { board: b, .. } if *b == board);
    assert!(w.has_event(ready(0)).is_some() && w.has_event(ready(1)).is_some());
    w.frames.clear();
    w.run(20.0);
    assert!(
        (1_995..=2_005).contains(&w.frames.len()),
        "{}",
        w.frames.len()
    );
    assert!(w.frames.iter().all(|f| f.present == RawFrame::ALL_PRESENT));
    // A period, the step in which boards sample here, and what the fit is off by.
    let oldest_s = 0.01 + STEP_S + 10e-6;
    assert!(
        w.frames
            .iter()
            .all(|f| f.board_age_s.iter().all(|a| *a <= oldest_s))
    );
    w.assert_monotone();
    let error_s = rms(&w.stamp_errors_s());
    assert!(error_s < 0.5e-3, "{error_s}");
    let status = w.host.status(w.now());
    assert!(status.connected && status.simulated);
    assert_eq!(status.frames_lost, 0);
    assert!(status.age_s < 0.012);
    assert!(
        status
            .board_rate_hz
            .iter()
            .all(|r| (99.0..=101.0).contains(r))
    );
    let f = w.frames.last().expect("frames");
    assert!((f.chamber_pa[5] - 1e3).abs() <= 1.0);
    assert!((f.imu[3].accel_m_s2[2] - 9.81).abs() < 1e-3);
    assert_eq!(f.faults, fault::SAFE | fault::BOOTED);
}

#[test]
fn a_clock_jump_is_found_within_a_second_and_put_right() {
    for (b, jump_s) in [(0, 0.006), (1, -0.02), (0, 1.5), (1, -90.0)] {
        let mut w = World::ready(6);
        w.run(10.0);
        w.boards[b].jump_clock(jump_s);
        let from_s = w.t_s();
        w.run(1.0);
        let found_s = w
            .has_event(|e| matches!(e, LinkEvent::ClockJump { board, jump_s: j } if *board == b && (j - jump_s).abs() < 1e-3 + 3e-3 * jump_s.abs()))
            .expect("a jump event");
        assert!(found_s - from_s < 0.3, "hurried: {}", found_s - from_s);
        w.assert_monotone();
        w.frames.clear();
        w.run(5.0);
        let worst_s = w
            .stamp_errors_s()
            .iter()
            .fold(0.0f64, |a, e| a.max(e.abs()));
        assert!(worst_s < 1e-3, "{worst_s}");
        assert_eq!(w.events.len(), 1, "{:?}", w.events);
    }
}

/// Everything at once: crystals that differ and drift, a line that delays and garbles, clocks that
/// jump. Only the second after a jump is not counted.
#[test]
fn skew_drift_jitter_and_jumps_leave_half_a_millisecond_between_boards_and_time_base() {
    let mut w = World::new(21);
    w.boards = [(0, 90e-6, 2e-7), (1, -2e-3, -3e-7)].map(|(id, skew, drift)| {
        let mut setup = board_setup(id, skew);
        setup.clock.drift = drift * WARM_UP_S;
        Board::new(setup)
    });
    w.faults = Faults {
        drop: 0.01,
        corrupt: 0.01,
        twice: 0.01,
        late: 0.01,
        jitter_s: 1e-3,
    };
    w.run(2.0);
    let mut errors_s = Vec::new();
    for (b, jump_s) in [(0, 0.0), (0, 0.006), (1, -0.5), (1, 0.02), (0, -0.008)] {
        w.boards[b].jump_clock(jump_s);
        w.run(1.0);
        w.frames.clear();
        w.run(40.0);
        errors_s.extend(w.stamp_errors_s());
        w.assert_monotone();
    }
    let jumps = w
        .events
        .iter()
        .filter(|(_, e)| matches!(e, LinkEvent::ClockJump { .. }));
    assert_eq!(jumps.count(), 4, "{:?}", w.events);
    let worst_s = errors_s.iter().fold(0.0f64, |a, e| a.max(e.abs()));
    println!(
        "{} samples of two boards: {:.3} ms RMS, {:.3} ms at worst",
        errors_s.len(),
        rms(&errors_s) * 1e3,
        worst_s * 1e3
    );
    assert!(errors_s.len() > 38_000);
    assert!(rms(&errors_s) < 0.5e-3, "{}", rms(&errors_s));

    // The offsets shown are the clocks' own: session time less board time.
    let clocks = w
        .host
        .status(w.now())
        .board_clock
        .map(|c| c.expect("a fit"));
    for (b, c) in clocks.iter().enumerate() {
        let known_s = w.t_s() - w.boards[b].clock_s(w.t_s());
        let skew = -[90e-6, -2e-3][b];
        // Board time is known up to whole wraps of its counter.
        let off_s = (c.offset_s - known_s).rem_euclid(2f64.powi(32) / 2e6);
        let off_s = off_s.min(2f64.powi(32) / 2e6 - off_s);
        assert!(off_s < 3e-3, "board {b}: {c:?}, {off_s}");
        assert!((c.skew_ratio - skew).abs() < 1e-4, "board {b}: {c:?}");
        assert!(c.residual_s < 0.5e-3 && c.round_trip_s < 4e-3, "{c:?}");
    }
}

/// The program waits for a processor again and again, up to 300 ms, and then reads all that has come at once.
#[test]
fn frames_that_are_read_late_and_together_are_no_clock_jump() {
    let mut w = World::ready(31);
    let jumps = |w: &World| {
        let told = w.events.iter().filter_map(|(_, e)| match e {
            LinkEvent::ClockJump { board, jump_s } => Some((*board, *jump_s)),
            _ => None,
        });
        told.collect::<Vec<_>>()
    };
    let busy = |w: &mut World, for_s: f64| {
        let end_s = w.t_s() + for_s;
        while w.t_s() < end_s {
            let u: f64 = w.rng.random_range(1e-9..1.0);
            w.host_alive = false;
            w.run((1e-3 * u.powf(-0.9)).min(0.3));
            w.host_alive = true;
            let slice_s = w.rng.random_range(1e-3..6e-3);
            w.run(slice_s);
        }
    };
    busy(&mut w, 120.0);
    assert_eq!(jumps(&w), []);
    w.frames.clear();
    busy(&mut w, 60.0);
    let worst_s = w
        .stamp_errors_s()
        .iter()
        .fold(0.0f64, |a, e| a.max(e.abs()));
    assert!(worst_s < 3e-3, "{worst_s}");
    w.boards[1].jump_clock(0.05);
    busy(&mut w, 60.0);
    let told = jumps(&w);
    assert_eq!(told.len(), 1, "{told:?}");
    assert!(
        told[0].0 == 1 && (told[0].1 - 0.05).abs() < 5e-3,
        "{told:?}"
    );
}

/// What was measured of an oscillator before a silence or a closed port is not measured again.
#[test]
fn a_board_that_comes_back_keeps_the_rate_of_its_clock() {
    let mut w = World::new(5);
    let skews = [4e-3, -5e-3];
    w.boards = [(0, skews[0]), (1, skews[1])].map(|(id, skew)| board(id, skew));
    w.run(8.0);
    let worst = |w: &World| {
        let of = |f: &RawFrame| {
            // A board that has not answered yet delivers nothing to be counted.
            let off = |b: usize| match f.has_spring(6 * b) {
                true => f.tick_rate_hz[b] / f64::from(TICK_RATE_HZ) - 1.0 - skews[b],
                false => 0.0,
            };
            off(0).abs().max(off(1).abs())
        };
        w.frames.iter().map(of).fold(0.0, f64::max)
    };
    let young = worst(&w);
    assert!(young > 1e-3, "nothing is known at first: {young}");
    w.frames.clear();
    w.cut = [true; 2];
    w.run(1.0);
    w.cut = [false; 2];
    w.run(2.0);
    let silent = worst(&w);
    assert!(!w.frames.is_empty() && silent < 24e-6, "{silent}");
    w.frames.clear();
    w.host.disconnected(w.now(), "unplugged");
    w.run(1.0);
    w.host.reconnected(w.now());
    w.run(2.0);
    let unplugged = worst(&w);
    assert!(!w.frames.is_empty() && unplugged < 24e-6, "{unplugged}");
    // Another board may have been plugged in: these have no arm's number.
    w.frames.clear();
    w.boards[0].reboot(w.t_s(), 4711);
    w.run(0.3);
    let sd = w
        .frames
        .iter()
        .map(|f| f.tick_rate_sd[0])
        .fold(0.0, f64::max);
    assert!(sd > 1e-3, "{sd}");
}
