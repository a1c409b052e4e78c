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
    while tick(&[]).0 != Some(StreamState::Streaming) {}
    let mut said = tick(&[Command::StopStream]).1;
    // Longer than a stream that was stopped may take.
    for _ in 0..250 {
        said.extend(tick(&[]).1);
    }
    let told = said.iter().filter(|s| s.starts_with("Stopped streaming"));
    assert_eq!(told.count(), 1, "{said:?}");
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
