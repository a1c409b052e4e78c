//! The Sensors screen: readings, residuals, cursors, age.

use super::*;
use crate::gui::panels::sensors::Reading;
use crate::signal::UNKNOWN_M;

// Frequencies of 1 kHz and more, and spring 1A 2.5 mm longer than the model has it.
fn session() -> Vec<Snapshot> {
    let mut session = fixture::session(40);
    for s in &mut session {
        let shape = Arc::clone(s.shape.as_ref().expect("has a shape"));
        let [top, bottom] = shape.spring_ends_m[0];
        let square: f64 = (0..3).map(|k| (bottom[k] - top[k]).powi(2)).sum();
        let frame = s.sensors.as_mut().expect("has sensors");
        frame.sensors.spring_m[0] = square.sqrt() + 2.5e-3;
        let raw = s.raw.as_mut().expect("has a raw frame");
        for i in 0..12 {
            raw.spring_counts[i] = 100;
            raw.spring_gate_ticks[i] = 1_600_000 / (i as u32 + 1);
        }
    }
    session
}

fn app(session: &[Snapshot], theme: Theme) -> App {
    App::for_screenshot(ScreenId::Sensors, theme, RobotSpec::reference(), session)
}

#[test]
fn raw_calibrated_and_residual_are_one_switch() {
    let mut h = harness(app(&session(), Theme::Dark));
    h.run();
    control(&h, "Springs of segment 1 / mm");
    press(&mut h, "Raw");
    assert_eq!(h.state().screens.sensors.reading, Reading::Raw);
    control(&h, "Springs of segment 1 / kHz");
    control(&h, "IMU rate x / deg/s");
    // 100 periods in 1 600 000 / 12 ticks at 16 MHz.
    h.get_by_label("12.0");
    press(&mut h, "Residual");
    control(&h, "Springs of segment 1, measured − model / mm");
    h.get_by_label("2.50");
    press(&mut h, "Calibrated");
    assert!(h.query_by_label("2.50").is_none());
}

#[test]
fn a_recording_without_shapes_says_that_there_is_no_residual() {
    let mut trace = fixture::trace("circle", 4);
    trace.snapshots.iter_mut().for_each(|s| s.shape = None);
    let mut player = Player::new(trace).expect("not empty");
    player.playing = false;
    let mut with_player = app(&[], Theme::Dark);
    with_player.player = Some(player);
    let mut h = harness(with_player);
    h.run();
    press(&mut h, "Residual");
    h.get_by_label_contains("Recordings do not keep the model's shape");
}

#[test]
fn cursors_tell_the_difference_of_time_and_of_every_signal() {
    let session = session();
    let mut h = harness(app(&session, Theme::Dark));
    h.run();
    press(&mut h, "Cursors A and B");
    let (a, b) = (session[1000].clone(), session[1500].clone());
    let [ta, tb] = [&a, &b].map(|s| s.stamp.seconds());
    assert!(
        h.state().window.frozen_end_s.is_some(),
        "the plots stand still"
    );
    h.state_mut().window.cursors_s = Some([ta, tb]);
    h.run();
    h.get_by_label("Δt 10.00 s");
    // As the axis below counts: 120 s into the session.
    for (name, text) in [
        ("Cursor A in min:s", "2:00.00"),
        ("Cursor B in min:s", "2:10.00"),
    ] {
        let shown = control(&h, name).value();
        assert_eq!(shown.as_deref(), Some(text), "{name}");
    }
    let mm = |s: &Snapshot| s.sensors.as_ref().expect("has sensors").sensors.spring_m[7] * 1e3;
    let d = crate::gui::panels::widgets::number(mm(&b) - mm(&a), 2);
    let said = format!("4B: B − A {d} mm in 10.00 s");
    h.get_by(|n| n.label().as_deref() == Some(said.as_str()));
    // A click in a plot takes the nearer cursor there: here B.
    let plot = control(&h, "Springs of segment 1 / mm").rect();
    let at = plot.right_center() - egui::vec2(30.0, 0.0);
    h.drag_at(at);
    h.run_steps(1);
    h.drop_at(at);
    h.run();
    let [a_now, b_now] = h.state().window.cursors_s.expect("still shown");
    assert!(a_now == ta && b_now > tb, "{a_now} {b_now}");
    press(&mut h, "Cursors A and B");
    assert_eq!(h.state().window.cursors_s, None);
}

#[test]
fn doubt_blindness_age_and_a_lost_link_are_told() {
    let mut session = session();
    let last = session.last_mut().expect("not empty");
    last.link.connected = false;
    last.link.age_s = 3.2;
    let raw = last.raw.as_mut().expect("has a raw frame");
    raw.stamp = raw.stamp.plus(-3.2);
    last.sensors.as_mut().expect("has sensors").extra_sigma[2] = UNKNOWN_M;
    last.estimate
        .as_mut()
        .expect("has an estimate")
        .training_distance = 2.6;
    let mut h = harness(app(&session, Theme::Dark));
    h.run();
    h.get_by_label_contains("Not connected: these are the last values, 3.2 s old");
    h.get_by_label_contains("Blind: some signals are neither measured");
    h.get_by_label_contains("▲ Distance from the training data 2.60: far, above 2.0");
    h.get_by_label("≈");
    let last = session.last_mut().expect("not empty");
    last.estimate
        .as_mut()
        .expect("has an estimate")
        .training_distance = 0.24;
    let mut h = harness(app(&session, Theme::Dark));
    h.run();
    h.get_by_label("Distance from the training data 0.24: within 2.0");
}

#[test]
fn the_sensors_look_right() {
    let session = session();
    for (theme, name) in [(Theme::Dark, "dark"), (Theme::Light, "light")] {
        picture(
            &format!("sensors-{name}"),
            [1280.0, 720.0],
            theme,
            app(&session, theme),
        );
        let mut with_cursors = app(&session, theme);
        with_cursors.window.frozen_end_s = Some(139.0);
        with_cursors.window.cursors_s = Some([117.0, 131.0]);
        with_cursors.screens.sensors.reading = Reading::Residual;
        with_cursors.selected_spring = Some(0);
        sharp_picture(&format!("sensors-cursors-{name}-2x"), theme, with_cursors);
    }
    let mut raw = app(&session, Theme::Dark);
    raw.screens.sensors.reading = Reading::Raw;
    picture("sensors-raw-dark", [1280.0, 720.0], Theme::Dark, raw);
    picture(
        "sensors-empty",
        [1280.0, 720.0],
        Theme::Dark,
        app(&[], Theme::Dark),
    );
    let mut lost = busy_session();
    let last = lost.last_mut().expect("not empty");
    last.link.connected = false;
    last.link.age_s = 3.2;
    picture(
        "sensors-disconnected",
        [1280.0, 720.0],
        Theme::Light,
        app(&lost, Theme::Light),
    );
}
