//! The Sensors screen: readings, residuals, cursors, age.

use super::*;
use crate::gui::panels::sensors::Reading;
use crate::signal::{ChannelHealth, FOUND_RAD, Need, SPRINGS, UNKNOWN_M};

/// The last frame of a session, to be changed.
fn last_frame(session: &mut [Snapshot]) -> &mut crate::signal::SensorFrame {
    let last = session.last_mut().expect("not empty");
    last.sensors.as_mut().expect("has sensors")
}

/// A session at whose end segment 1 is suspect, the heading is not known, spring 2A is named and IMU 3 as well.
pub(super) fn troubled() -> Vec<Snapshot> {
    let mut session = session();
    let frame = last_frame(&mut session);
    let q = &mut frame.quality;
    q.segment_suspect[0] = true;
    for (c, p) in [(0, 0.62), (1, 0.35), (2, 0.994), (SPRINGS + 2, 0.97)] {
        q.fault_probability[c] = p;
    }
    q.nis = std::array::from_fn(|c| 0.7 + 0.04 * c as f64);
    (q.nis[0], q.nis[2], q.nis[SPRINGS + 2]) = (6.3, 31.0, 9.0);
    q.spring_off_m[2] = Some(5.2e-3);
    q.need = Some(Need::Heading(1, 2.1_f64.to_radians()));
    frame.health.springs[2] = ChannelHealth::Suspect;
    frame.health.imus[2] = ChannelHealth::Suspect;
    for (i, sd_m) in [(0, 1.4e-3), (1, 1.1e-3), (2, 0.8e-3), (3, 0.05e-3)] {
        frame.extra_sigma[i] = sd_m;
    }
    for i in 0..4 {
        frame.extra_sigma[SPRINGS + 3 * i] = 0.4_f64.to_radians() * (i + 1) as f64;
    }
    session
}

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
fn what_the_estimator_still_needs_and_a_suspect_segment_are_shown_on_top() {
    let mut session = session();
    let mut h = harness(app(&session, Theme::Dark));
    h.run();
    h.get_by_label_contains("normalised innovations squared (NIS)");
    last_frame(&mut session).quality.need = Some(Need::Heading(1, 1.4 * FOUND_RAD));
    let mut h = harness(app(&session, Theme::Dark));
    h.run();
    h.get_by_label(
        "▲ Heading of the end pad known to 2.1 deg, needs 1.5 deg: tilt the arm to any side.",
    );
    assert!(
        h.query_by_label_contains("highlighted in the plots")
            .is_none()
    );
    let frame = last_frame(&mut session);
    frame.quality.segment_suspect[0] = true;
    frame.quality.fault_probability[..2].copy_from_slice(&[0.62, 0.35]);
    let mut h = harness(app(&session, Theme::Dark));
    h.run();
    h.get_by_label_contains(
        "▲ Segment 1: a spring or IMU is wrong, not yet certain which (1A 62 %, 1B 35 %). Move the arm",
    );
    // The other notice is the second line.
    h.get_by_label_contains("Heading of the end pad");
    // As shown on the rows of the springs in question.
    h.get_by_label("62 %");
    h.get_by_label("35 %");
}

#[test]
fn a_named_spring_shows_its_evidence_its_band_and_its_innovations() {
    let mut session = session();
    let mut h = harness(app(&session, Theme::Dark));
    h.run();
    assert!(h.query_by_label("> 99 %").is_none() && h.query_by_label("± 0.80").is_none());
    let frame = last_frame(&mut session);
    frame.health.springs[2] = ChannelHealth::Suspect;
    frame.extra_sigma[2] = 0.8e-3;
    frame.quality.fault_probability[2] = 0.994;
    frame.quality.spring_off_m[2] = Some(5.2e-3);
    frame.quality.nis[2] = 31.0;
    let mut h = harness(app(&session, Theme::Dark));
    h.run();
    h.get_by_label_contains(
        "▲ Spring 3 (2A) reads 5.2 mm too long, by the other sensors (probability of a fault > 99 %): check its hooks",
    );
    h.get_by_label("> 99 %");
    h.get_by_label("± 0.80");
    let meter = |name: &str| {
        let node = h.get_by_label(name);
        node.accesskit_node().numeric_value()
    };
    assert_eq!(meter("Spring 2A NIS"), Some(31.0));
    assert_eq!(meter("IMU 4 NIS"), Some(1.0));
}

#[test]
fn a_large_window_has_residual_and_innovations_in_words() {
    let mut session = session();
    last_frame(&mut session).quality.nis[2] = 31.0;
    let mut small = harness(app(&session, Theme::Dark));
    small.run();
    small.get_by_label("NIS 31");
    assert!(small.query_by_label("residual 2.50 mm").is_none());
    let mut h = Harness::builder()
        .with_size([2560.0, 1440.0])
        .build_eframe(|_| app(&session, Theme::Dark));
    h.run();
    h.get_by_label("residual 2.50 mm");
    h.get_by_label("NIS 31: beyond the gate");
    let height = |h: &Harness<'_, App>| h.get_by_label("Spring 1A").rect().height();
    assert!(height(&h) > 1.5 * height(&small));
}

#[test]
fn notices_beyond_the_second_are_counted_and_an_old_frame_has_none_of_them() {
    let mut session = troubled();
    let mut h = harness(app(&session, Theme::Dark));
    h.run();
    // Of the suspect segment, the heading, the spring and the IMU.
    h.get_by_label_contains("(+ 2) Heading of the end pad");
    let last = session.last_mut().expect("not empty");
    last.link.connected = false;
    last.link.age_s = 3.2;
    let mut h = harness(app(&session, Theme::Dark));
    h.run();
    h.get_by_label_contains("Not connected: these are the last values");
    assert!(
        h.query_by_label_contains("Heading of the end pad")
            .is_none()
    );
}

#[test]
fn the_sensors_look_right_in_every_size() {
    for (size, name) in [
        ([1024.0, 700.0], "1024"),
        ([1280.0, 760.0], "1280"),
        ([2560.0, 1440.0], "2560"),
    ] {
        for (theme, theme_name) in [(Theme::Dark, "dark"), (Theme::Light, "light")] {
            let name = format!("sensors-troubled-{theme_name}-{name}");
            picture(&name, size, theme, app(&troubled(), theme));
        }
        let name = format!("sensors-quiet-dark-{name}");
        picture(&name, size, Theme::Dark, app(&session(), Theme::Dark));
    }
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
