//! Plots with far more values than pixels.

use super::*;

/// Twelve seconds at 500 Hz: about five values per pixel in a window of ten seconds.
fn dense(screen: ScreenId, theme: Theme) -> App {
    let session: Vec<_> = (0..6_000)
        .map(|i| fixture::snapshot(100.0 + f64::from(i) * 0.002))
        .collect();
    let mut app = App::for_screenshot(screen, theme, RobotSpec::reference(), &session);
    app.window.span_s = 10.0;
    app
}

#[test]
fn dense_signals_have_their_values_under_the_pointer() {
    let mut h = harness(dense(ScreenId::Sensors, Theme::Dark));
    h.run();
    let plot = h
        .get_by_role_and_label(egui::accesskit::Role::Image, "IMU yaw / deg")
        .rect();
    // The middle of a plot that fits its signals is never further from one than half its height.
    for part in 1..10 {
        let at = plot.left_top() + plot.size() * egui::vec2(0.6, 0.1 * part as f32);
        h.hover_at(at);
        h.run_steps(4);
        if h.query_by_label_contains("deg at").is_some() {
            return;
        }
    }
    panic!("no value was told anywhere on a vertical line through the plot");
}

#[test]
fn dense_signals_are_drawn() {
    for (theme, name) in [(Theme::Dark, "dark"), (Theme::Light, "light")] {
        for screen in [ScreenId::Sensors, ScreenId::Operate, ScreenId::Accuracy] {
            let name = format!("dense-{}-{name}", screen.name()).to_lowercase();
            picture(&name, [1280.0, 720.0], theme, dense(screen, theme));
        }
    }
}
