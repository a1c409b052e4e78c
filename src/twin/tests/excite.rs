//! Programmes of pressures: what is refused before anything moves, and what ends one.

use super::*;
use crate::task::Programme;

/// Chamber 2 up to `most_pa` at the given rate, and back.
fn programme(most_pa: f64, seconds: f64) -> Programme {
    let mut out = Programme {
        name: "there and back".to_owned(),
        seconds,
        ..Programme::default()
    };
    out.knots[1] = vec![[0.0, 0.0], [0.5 * seconds, most_pa], [seconds, 0.0]];
    out
}

/// Ticks the twin with gauges that follow the set pressures, from tick `from` on; what was commanded, and what happened.
fn follow(
    twin: &mut Twin,
    from: u32,
    n: u32,
    first: &[Command],
) -> (Vec<[f64; CHAMBERS]>, Vec<Event>) {
    let (mut set, mut all) = (Vec::new(), Vec::new());
    let mut gauge = [0.0; CHAMBERS];
    for k in from..from + n {
        let mut raw = frame(k);
        raw.chamber_pa = gauge;
        let commands = if k == from { first } else { &[] };
        let (command, events) = twin.tick(at(k), Some(raw), commands);
        all.extend(events);
        if let Some(command) = command {
            gauge = *command.chamber_pa();
            set.push(gauge);
        }
    }
    (set, all)
}

fn refused(events: &[Event]) -> String {
    let mut refusals = events.iter().filter(|e| matches!(e, Event::Refused { .. }));
    refusals.next().map_or(String::new(), Event::text)
}

fn excite(programme: Programme) -> [Command; 2] {
    [Command::Arm, Command::Start(Plan::excite(programme))]
}

#[test]
fn the_pressures_of_a_programme_are_set_and_the_last_ones_kept() {
    let mut twin = twin();
    feed(&mut twin, 0, 150);
    let (set, events) = follow(&mut twin, 150, 500, &excite(programme(2e3, 4.0)));
    assert_eq!(refused(&events), "");
    let most = set.iter().map(|pa| pa[1]).fold(0.0, f64::max);
    assert!((1.9e3..=2e3).contains(&most), "{most} Pa");
    assert!(set.iter().all(|pa| pa[0] == 0.0 && pa[3] == 0.0));
    let done = events
        .iter()
        .position(|e| matches!(e, Event::Finished { .. }));
    assert!(done.is_some() && twin.mode() == Mode::AtGoal);
    assert!(set[set.len() - 1][1].abs() < 20.0);
}

#[test]
fn a_chamber_that_does_not_follow_is_not_asked_for_more() {
    let mut twin = twin();
    feed(&mut twin, 0, 150);
    let commands = excite(programme(30e3, 30.0));
    twin.tick(at(150), Some(frame(150)), &commands);
    // Its gauge stays at 0; too short for the watch of the air.
    for k in 151..451 {
        let (command, _) = twin.tick(at(k), Some(frame(k)), &[]);
        let pa = command.map_or(0.0, |c| c.chamber_pa()[1]);
        assert!(pa <= 4e3, "{pa} Pa at tick {k}");
    }
}

#[test]
fn a_programme_beyond_the_limits_is_refused_before_anything_moves() {
    let mut twin = twin();
    feed(&mut twin, 0, 150);
    let (_, events) = follow(&mut twin, 150, 20, &excite(programme(45e3, 10.0)));
    let why = refused(&events);
    assert!(
        why.contains("chamber 2 to +45.0 kPa, outside of -40 to +40 kPa"),
        "{why}"
    );
    assert_ne!(twin.mode(), Mode::Moving);
    // Springs that the plant map expects beyond their range.
    let mut robot = RobotSpec::reference();
    robot.spring.range_m[1] = 0.155;
    let mut twin = twin_of(&robot, Arc::new(Crude));
    feed(&mut twin, 0, 150);
    let (_, events) = follow(&mut twin, 150, 20, &excite(programme(30e3, 10.0)));
    assert!(
        refused(&events).contains("would bring spring"),
        "{}",
        refused(&events)
    );
}

#[test]
fn a_programme_into_a_space_that_is_kept_out_of_is_refused() {
    for (z_m, is_refused) in [(-0.32, true), (-0.40, false)] {
        let mut twin = shipped_above(z_m);
        feed(&mut twin, 0, 150);
        let mut down = programme(0.0, 10.0);
        down.knots = std::array::from_fn(|_| vec![[0.0, 0.0], [10.0, 25e3]]);
        let (_, events) = follow(&mut twin, 150, 20, &excite(down));
        let why = refused(&events);
        assert_eq!(
            why.contains("keeps out of (table)"),
            is_refused,
            "{z_m}: {why}"
        );
        assert_eq!(twin.mode() == Mode::Moving, !is_refused, "{z_m}: {why}");
    }
}

#[test]
fn hold_stops_a_programme_and_resume_goes_on_where_it_was() {
    let mut twin = twin();
    feed(&mut twin, 0, 150);
    let (set, _) = follow(&mut twin, 150, 200, &excite(programme(2e3, 8.0)));
    let before = set[set.len() - 1][1];
    let (held, _) = follow(&mut twin, 350, 200, &[Command::Hold]);
    assert_eq!(twin.mode(), Mode::Hold);
    let last = held[held.len() - 1][1];
    assert!((last - before).abs() < 100.0, "{before} then {last} Pa");
    let (on, _) = follow(&mut twin, 550, 200, &[Command::Resume]);
    assert_eq!(twin.mode(), Mode::Moving);
    let later = on[on.len() - 1][1];
    assert!(later > last + 500.0, "{last} then {later} Pa");
    let (none, _) = follow(&mut twin, 750, 3, &[Command::Stop]);
    assert!(matches!(twin.mode(), Mode::Safe(_)) && none.is_empty());
}
