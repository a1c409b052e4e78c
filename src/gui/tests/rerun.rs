//! The running twin in the Rerun viewer, from the operator's side.

use core::net::SocketAddr;

use super::*;
use crate::gui::services::Worker;
use crate::signal::{StreamState, StreamStatus};

fn address() -> SocketAddr {
    SocketAddr::from(([127, 0, 0, 1], 9876))
}

fn with_stream(t_s: f64, state: Option<StreamState>, dropped: u64) -> Snapshot {
    Snapshot {
        streaming: state.map(|state| StreamStatus {
            address: address(),
            state,
            sent: 420,
            dropped,
            dropped_lines: 0,
        }),
        ..fixture::snapshot(t_s)
    }
}

/// A window whose viewer is started by hand.
fn window() -> (Twin, Receiver<Worker<SocketAddr>>, Harness<'static, App>) {
    let (started, workers) = sync_channel(4);
    let mut services = library_services();
    services.start_viewer = Box::new(move || {
        let (job, worker) = Job::pair();
        started.try_send(worker).expect("room for a worker");
        job
    });
    let (twin, handle) = twin(fixture::snapshot(1.0));
    let mut app = App::new(Some(handle), RobotSpec::reference(), services);
    app.screen = ScreenId::Recordings;
    let mut h = harness(app);
    h.run_steps(3);
    (twin, workers, h)
}

fn see(twin: &Twin, h: &mut Harness<'_, App>, snapshot: Snapshot) {
    twin.publish(snapshot);
    h.run_steps(3);
}

#[test]
fn a_viewer_is_started_streamed_to_and_left() {
    let (twin, workers, mut h) = window();
    h.get_by_label("Open live in Rerun").click();
    h.run_steps(3);
    h.get_by_label("Starting the Rerun viewer…");
    assert_eq!(twin.taken(), []);
    let worker = workers.try_recv().expect("a viewer is being started");
    worker.finish(Ok(address()));
    h.run_steps(3);
    assert_eq!(twin.taken(), [Command::StreamLive(address())]);
    see(
        &twin,
        &mut h,
        with_stream(1.1, Some(StreamState::Starting), 0),
    );
    h.get_by_label("Connecting to the viewer at 127.0.0.1:9876…");
    see(
        &twin,
        &mut h,
        with_stream(1.2, Some(StreamState::Streaming), 0),
    );
    h.get_by_label("● streaming to 127.0.0.1:9876");
    assert!(h.query_by_label_contains("dropped").is_none());
    see(
        &twin,
        &mut h,
        with_stream(1.3, Some(StreamState::Streaming), 37),
    );
    h.get_by_label_contains("37 dropped");
    h.get_by_label("■ Stop streaming").click();
    h.run_steps(3);
    assert_eq!(twin.taken(), [Command::StopStream]);
    see(&twin, &mut h, with_stream(1.4, None, 0));
    assert!(!is_disabled(&h, "Open live in Rerun"));
}

#[test]
fn a_viewer_that_is_ready_is_streamed_to_from_every_screen() {
    let (twin, workers, mut h) = window();
    h.get_by_label("Open live in Rerun").click();
    h.run_steps(3);
    h.state_mut().screen = ScreenId::Sensors;
    h.run_steps(3);
    let worker = workers.try_recv().expect("a viewer is being started");
    worker.finish(Ok(address()));
    h.run_steps(3);
    assert_eq!(twin.taken(), [Command::StreamLive(address())]);
    assert!(!h.state().busy());
}

#[test]
fn a_viewer_that_is_missing_or_goes_away_is_told_and_can_be_tried_again() {
    let (twin, workers, mut h) = window();
    h.get_by_label("Open live in Rerun").click();
    h.run_steps(3);
    let missing =
        "The Rerun viewer is not installed: pip install rerun-sdk==0.36.3, then try again.";
    let worker = workers.try_recv().expect("a viewer is being started");
    worker.finish(Err(missing.into()));
    h.run_steps(3);
    h.get_by_label_contains(missing);
    assert_eq!(twin.taken(), []);
    let gone = "The Rerun viewer at 127.0.0.1:9876 is gone, so the stream is closed.";
    h.get_by_label("Open live in Rerun").click();
    h.run_steps(3);
    assert!(h.query_by_label_contains(missing).is_none());
    let worker = workers.try_recv().expect("another viewer is being started");
    worker.finish(Ok(address()));
    let ended = StreamState::Ended(gone.into());
    see(&twin, &mut h, with_stream(1.1, Some(ended), 3));
    h.get_by_label_contains(gone);
    assert!(!is_disabled(&h, "Open live in Rerun"));
}

#[test]
fn a_viewer_that_is_away_is_told_and_can_be_given_up_or_replaced() {
    let (twin, workers, mut h) = window();
    let gone = "The Rerun viewer at 127.0.0.1:9876 went away.";
    let away = || Some(StreamState::Away(gone.into()));
    see(&twin, &mut h, with_stream(1.1, away(), 3));
    h.get_by_label("Viewer away: trying again");
    h.get_by_label_contains(gone);
    h.get_by_label("■ Stop streaming").click();
    h.run_steps(3);
    assert_eq!(twin.taken(), [Command::StopStream]);
    see(&twin, &mut h, with_stream(1.2, away(), 4));
    h.get_by_label("Open live in Rerun").click();
    h.run_steps(3);
    assert_eq!(twin.taken(), [Command::StopStream]);
    let worker = workers.try_recv().expect("another viewer is being started");
    worker.finish(Ok(address()));
    h.run_steps(3);
    assert_eq!(twin.taken(), [Command::StreamLive(address())]);
    see(
        &twin,
        &mut h,
        with_stream(1.3, Some(StreamState::Streaming), 0),
    );
    assert!(h.query_by_label("Viewer away: trying again").is_none());
}

#[test]
fn starting_a_viewer_can_be_cancelled() {
    let (twin, workers, mut h) = window();
    h.get_by_label("Open live in Rerun").click();
    h.run_steps(3);
    let worker = workers.try_recv().expect("a viewer is being started");
    h.get_by_label("Cancel starting the viewer").click();
    h.run_steps(3);
    assert!(worker.cancelled());
    worker.finish(Ok(address()));
    h.run_steps(3);
    assert_eq!(twin.taken(), []);
    h.get_by_label("Open live in Rerun");
}

#[test]
fn without_a_twin_there_is_nothing_to_stream() {
    let (twin, _workers, mut h) = window();
    drop(twin);
    h.run_steps(3);
    assert!(is_disabled(&h, "Open live in Rerun"));
}

#[test]
fn the_row_renders() {
    let states = [
        ("off", None, 0),
        ("streaming", Some(StreamState::Streaming), 37),
        (
            "gone",
            Some(StreamState::Ended(
                "The Rerun viewer at 127.0.0.1:9876 is gone, so the stream is closed.".into(),
            )),
            0,
        ),
    ];
    for (name, state, dropped) in states {
        let (_twin, handle) = twin(with_stream(1.0, state, dropped));
        let mut app = App::new(Some(handle), RobotSpec::reference(), library_services());
        app.screen = ScreenId::Recordings;
        picture(&format!("live-{name}"), [1280.0, 720.0], Theme::Dark, app);
    }
}
