//! STOP in windows of every size and scale.

use super::*;

/// Points, down to less than the smallest window: the largest zoom makes 180 x 112 of it, a small display
/// whose scale is large 480 x 320.
const SIZES: [[f32; 2]; 4] = [
    [1280.0, 760.0],
    [900.0, 560.0],
    [480.0, 320.0],
    [180.0, 112.0],
];
const SCALES: [f32; 6] = [0.5, 1.0, 1.5, 2.0, 3.0, 4.0];

fn window(size: [f32; 2], scale: f32) -> (Twin, Harness<'static, App>) {
    // With everything above the panels that there may be.
    let mut safe = fixture::snapshot(1.0);
    safe.mode = Mode::Safe("stopped by the operator".into());
    let (twin, handle) = twin(safe);
    let mut app = App::new(Some(handle), RobotSpec::reference(), Services::none());
    app.welcome = true;
    let mut h = Harness::builder()
        .with_size(size)
        .with_pixels_per_point(scale)
        .build_eframe(|_| app);
    h.run_steps(4);
    (twin, h)
}

fn assert_stops(twin: &Twin, h: &mut Harness<'_, App>, size: [f32; 2], what: &str) {
    let stop = h.get_by_label("■ STOP").rect();
    let screen = egui::Rect::from_min_size(egui::Pos2::ZERO, size.into());
    assert!(screen.contains_rect(stop), "{what}: {stop} in {screen}");
    assert!(
        stop.width() > 100.0 && stop.height() > 35.0,
        "{what}: {stop}"
    );
    twin.taken();
    // With the pointer, so that nothing may lie above it.
    h.get_by_label("■ STOP").click();
    h.run_steps(3);
    assert_eq!(twin.taken(), [Command::Stop], "{what}");
}

#[test]
fn stop_is_whole_and_clickable_at_every_scale_and_size() {
    for size in SIZES {
        for scale in SCALES {
            let (twin, mut h) = window(size, scale);
            assert_stops(&twin, &mut h, size, &format!("{size:?} at {scale}"));
        }
    }
}

#[test]
fn stop_is_whole_and_clickable_on_every_screen_of_a_small_window() {
    for size in &SIZES[1..] {
        let (twin, mut h) = window(*size, 1.0);
        for screen in ScreenId::ALL {
            h.state_mut().screen = screen;
            h.run_steps(3);
            assert_stops(&twin, &mut h, *size, &format!("{screen:?} in {size:?}"));
        }
    }
}

#[test]
fn nothing_that_opens_in_a_small_window_covers_stop() {
    for size in &SIZES[1..] {
        let (twin, mut h) = window(*size, 1.0);
        h.key_press(Key::Questionmark);
        h.key_press_modifiers(Modifiers::COMMAND, Key::P);
        let refused = Event::Refused {
            stamp: Stamp::ZERO,
            reason: "Go was refused, and why is a sentence that needs some room.".into(),
        };
        twin.events.try_send(refused).expect("room");
        h.run_steps(4);
        assert_stops(&twin, &mut h, *size, &format!("{size:?}"));
    }
}

/// The zoom keys change what a point is: the bar grows and STOP stays in it.
#[test]
fn zooming_in_keeps_stop() {
    let (twin, mut h) = window(SIZES[1], 1.0);
    for _ in 0..5 {
        h.key_press_modifiers(Modifiers::COMMAND, Key::Plus);
        h.run_steps(3);
    }
    let zoom = h.ctx.zoom_factor();
    assert!(zoom > 1.3, "{zoom}");
    assert_stops(&twin, &mut h, SIZES[1], &format!("zoom {zoom}"));
}
