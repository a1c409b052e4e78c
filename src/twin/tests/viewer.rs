//! Streams to a viewer that hangs: one that takes a connection and then nothing.

use std::net::TcpListener;
use std::time::Duration;

use super::*;
use crate::signal::StreamState;

#[test]
fn a_viewer_that_hangs_gets_no_second_stream() {
    let hung = TcpListener::bind("127.0.0.1:0").expect("a port");
    let address = hung.local_addr().expect("its address");
    let mut runner = Runner::new(twin(), Box::new(Frames(0)), &RobotSpec::reference());
    let mut k = 0;
    let mut tick = |commands: &[Command]| {
        k += 1;
        std::thread::sleep(Duration::from_millis(10));
        let (snapshot, events) = runner.tick(at(k), commands);
        let said: Vec<String> = events.iter().map(Event::text).collect();
        (snapshot.streaming.as_ref().map(|s| s.state.clone()), said)
    };
    tick(&[Command::StreamLive(address)]);
    let line = hung.accept().expect("a connection");
    let streams = (0..6000).any(|_| tick(&[]).0 == Some(StreamState::Streaming));
    assert!(streams, "no stream in a minute");
    let mut said = tick(&[Command::StopStream]).1;
    // Longer than a stream that was stopped may take.
    for _ in 0..250 {
        said.extend(tick(&[]).1);
    }
    let stopped = said.iter().filter(|s| s.starts_with("Stopped streaming"));
    assert_eq!(stopped.count(), 1, "{said:?}");
    let (state, said) = tick(&[Command::StreamLive(address)]);
    assert_eq!(state, None);
    assert!(said.iter().any(|s| s.contains("hangs")), "{said:?}");
    // A viewer that is gone hangs no more.
    drop((line, hung));
    for _ in 0..6000 {
        if tick(&[Command::StreamLive(address)]).0 == Some(StreamState::Starting) {
            return;
        }
    }
    panic!("the stream is refused for ever");
}

/// A port where every call is taken and hung up: in four short stays at most the operator hears of it.
#[test]
fn a_viewer_that_comes_and_goes_is_not_told_of_for_ever() {
    let mut stays = crate::twin::stream::Stays::default();
    let mut said = 0;
    for s in 0..100 {
        let (comes, goes) = (at(s * 200), at(s * 200 + 100));
        said += u32::from(stays.comes(comes)) + u32::from(stays.goes(goes));
    }
    assert_eq!(said, 6);
    // One that stayed is reported again.
    assert!(stays.goes(at(99 * 200 + 2000)));
    assert!(stays.comes(at(99 * 200 + 2100)));
}

#[test]
fn a_viewer_that_is_away_is_told_once_and_can_be_given_up() {
    let address = {
        let free = TcpListener::bind("127.0.0.1:0").expect("a port");
        free.local_addr().expect("its address")
    };
    let mut runner = Runner::new(twin(), Box::new(Frames(0)), &RobotSpec::reference());
    let mut k = 0;
    let mut said = Vec::new();
    let mut tick = |commands: &[Command]| {
        k += 1;
        std::thread::sleep(Duration::from_millis(10));
        let (snapshot, events) = runner.tick(at(k), commands);
        said.extend(events.iter().map(Event::text));
        snapshot.streaming.as_ref().map(|s| s.state.clone())
    };
    let mut state = tick(&[Command::StreamLive(address)]);
    for _ in 0..6000 {
        if matches!(state, Some(StreamState::Away(_))) {
            break;
        }
        state = tick(&[]);
    }
    assert!(matches!(state, Some(StreamState::Away(_))), "{state:?}");
    // Three tries later nothing more was said.
    for _ in 0..300 {
        tick(&[]);
    }
    assert_eq!(tick(&[Command::StopStream]), None);
    for _ in 0..120 {
        assert_eq!(tick(&[]), None);
    }
    let away: Vec<_> = said.iter().filter(|s| s.contains("viewer")).collect();
    assert_eq!(away.len(), 1, "{said:?}");
    assert!(away[0].contains("Trying again every second"), "{said:?}");
    let stopped = said.iter().filter(|s| s.starts_with("Stopped streaming"));
    assert_eq!(stopped.count(), 1, "{said:?}");
}
