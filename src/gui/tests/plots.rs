//! Plots with far more values than pixels.

use super::*;
use crate::analysis::history::Channel;
use crate::gui::panels::strips::StripChoice;
use egui::accesskit::Role;

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

/// Operate with a minute of signals that stand still; what is written is kept.
#[expect(clippy::type_complexity)]
fn operate() -> (Harness<'static, App>, Arc<Mutex<Vec<(PathBuf, Vec<u8>)>>>) {
    let session = fixture::session(60);
    let mut app = App::for_screenshot(
        ScreenId::Operate,
        Theme::Dark,
        RobotSpec::reference(),
        &session,
    );
    app.window.frozen_end_s = session.last().map(|s| s.stamp.seconds() - 5.0);
    let written = Arc::new(Mutex::new(Vec::new()));
    let kept = Arc::clone(&written);
    app.services.write = Box::new(move |path, _, content| {
        let bytes = content().expect("bytes");
        kept.lock()
            .expect("not poisoned")
            .push((path.into(), bytes));
        Job::ready(Ok(path.into()))
    });
    let mut h = harness(app);
    h.run();
    (h, written)
}

fn plot_of(h: &Harness<'_, App>, title: &str) -> egui::Rect {
    h.get_by_role_and_label(Role::Image, title).rect()
}

fn turn(h: &mut Harness<'_, App>, at: egui::Pos2, points: f32, modifiers: Modifiers) {
    h.hover_at(at);
    h.run_steps(2);
    let wheel = egui::Event::MouseWheel {
        unit: egui::MouseWheelUnit::Point,
        delta: egui::vec2(0.0, points),
        phase: egui::TouchPhase::Move,
        source: egui::MouseWheelSource::Unknown,
        modifiers,
    };
    h.event_modifiers(wheel, modifiers);
    h.run();
}

#[test]
fn the_wheel_zooms_time_about_the_pointer_and_with_shift_the_values() {
    let (mut h, _) = operate();
    let plot = plot_of(&h, "x / mm");
    let at = plot.left_top() + plot.size() * egui::vec2(0.25, 0.6);
    let instant = |h: &Harness<'_, App>| {
        let [from, to] = h.state().window.range_s(1e9);
        from + 0.25 * (to - from)
    };
    let before = (instant(&h), h.state().window.span_s);
    turn(&mut h, at, 120.0, Modifiers::NONE);
    assert!(
        h.state().window.span_s < 0.9 * before.1,
        "{:?}",
        h.state().window
    );
    assert!((instant(&h) - before.0).abs() < 0.02 * before.1);
    assert!(h.query_by_label("Fit y of x / mm").is_none());
    let span_s = h.state().window.span_s;
    turn(&mut h, at, 60.0, Modifiers::SHIFT);
    assert_eq!(h.state().window.span_s, span_s);
    h.get_by_label("Fit y of x / mm");
    assert!(
        h.query_by_label("Fit y of y / mm").is_none(),
        "each by itself"
    );
    press(&mut h, "Fit y of x / mm");
    assert!(h.query_by_label("Fit y of x / mm").is_none());
}

#[test]
fn a_box_of_the_right_button_is_zoomed_to_and_a_double_click_takes_it_back() {
    let (mut h, _) = operate();
    let plot = plot_of(&h, "z / mm");
    let [from, to] = h.state().window.range_s(1e9);
    let place = |u: f32, v: f32| plot.left_top() + plot.size() * egui::vec2(u, v);
    let button = |h: &mut Harness<'_, App>, pos, pressed| {
        h.event(egui::Event::PointerButton {
            pos,
            button: egui::PointerButton::Secondary,
            pressed,
            modifiers: Modifiers::NONE,
        });
        h.run_steps(2);
    };
    let (a, b) = (place(0.25, 0.3), place(0.5, 0.9));
    h.hover_at(a);
    h.run_steps(2);
    button(&mut h, a, true);
    for u in [0.3, 0.6, 1.0] {
        h.hover_at(a + u * (b - a));
        h.run_steps(2);
    }
    button(&mut h, b, false);
    h.run();
    let now = h.state().window.range_s(1e9);
    let expected = [0.25, 0.5].map(|u| from + u * (to - from));
    for k in 0..2 {
        assert!((now[k] - expected[k]).abs() < 0.01 * (to - from), "{now:?}");
    }
    h.get_by_label("Fit y of z / mm");
    // A step of the test takes a quarter of a second.
    h.ctx
        .options_mut(|o| o.input_options.max_double_click_delay = 2.0);
    for pressed in [true, false, true, false] {
        h.event(egui::Event::PointerButton {
            pos: b,
            button: egui::PointerButton::Primary,
            pressed,
            modifiers: Modifiers::NONE,
        });
    }
    h.run_steps(8);
    assert_eq!(h.state().window.frozen_end_s, None);
    assert!(h.query_by_label("Fit y of z / mm").is_none());
}

#[test]
fn a_strip_is_enlarged_and_all_are_shown_again() {
    let (mut h, _) = operate();
    let low = plot_of(&h, "y / mm").height();
    press(&mut h, "Enlarge y / mm");
    h.run();
    assert!(plot_of(&h, "y / mm").height() > 1.8 * low);
    assert!(h.query_by_role_and_label(Role::Image, "x / mm").is_none());
    press(&mut h, "Show all plots");
    h.run();
    assert_eq!(plot_of(&h, "y / mm").height(), low);
    plot_of(&h, "x / mm");
}

#[test]
fn signals_are_chosen_by_name_and_cursors_show_their_differences_with_units() {
    let (mut h, written) = operate();
    press(&mut h, "Chosen");
    h.get_by_label("No signals are chosen");
    press(&mut h, "Choose signals");
    h.get_by_label("Filter signals").focus();
    h.run();
    h.get_by_label("Filter signals").type_text("spring 2b");
    h.run();
    press(&mut h, "Spring 2B");
    h.key_press(Key::Escape);
    h.run();
    let strips = &mut h.state_mut().screens.operate.strips;
    assert!(strips.chosen.has(Channel::Spring(3)) && strips.chosen.len() == 1);
    strips.chosen.set(Channel::Tip(4), true);
    assert_eq!(strips.choice, StripChoice::Chosen);
    h.run();
    plot_of(&h, "Chosen / mm");
    plot_of(&h, "Chosen / deg");
    let end_s = h.state().window.range_s(1e9)[1];
    h.state_mut().window.cursors_s = Some([end_s - 10.0, end_s - 5.0]);
    h.run();
    assert!(h.query_all_by_label("B − A").count() > 0);
    let differences = h.query_all_by_label_contains("Spring 2B ");
    let texts: Vec<_> = differences
        .filter_map(|n| n.accesskit_node().value())
        .collect();
    assert_eq!(texts.len(), 1, "{texts:?}");
    assert!(texts[0].ends_with(" mm"), "{texts:?}");
    h.state_mut().window.show_range([end_s - 2.0, end_s]);
    for format in ["CSV", "SVG"] {
        let format = crate::gui::panels::plot::Format::ALL
            .into_iter()
            .find(|f| f.name() == format);
        h.state_mut().screens.operate.strips.export.wanted = format;
        h.run();
        press(&mut h, "Write");
        h.run();
        h.get_by_label_contains("Wrote the ");
        press(&mut h, "Close the export");
    }
    let files = written.lock().expect("not poisoned");
    let [(csv, table), (svg, drawing)] = files.as_slice() else {
        panic!("{} files", files.len());
    };
    assert_eq!(csv, &PathBuf::from("exports/signals-live-simulated.csv"));
    assert_eq!(svg, &PathBuf::from("exports/signals-live-simulated.svg"));
    let table = String::from_utf8_lossy(table);
    assert!(
        table.starts_with("t_s,tip_pitch_deg,spring_2b_mm,origin\n"),
        "{table}"
    );
    let text = String::from_utf8_lossy(drawing);
    for text_of_it in ["Tip pitch / deg", "Spring 2B / mm", "simulated data"] {
        assert!(
            text.contains(&format!(">{text_of_it}</text>")),
            "{text_of_it}"
        );
    }
}

#[test]
fn smoothed_signals_are_drawn() {
    for (theme, name) in [(Theme::Dark, "dark"), (Theme::Light, "light")] {
        let mut app = dense(ScreenId::Sensors, theme);
        app.window.smooth = true;
        picture(
            &format!("smooth-sensors-{name}"),
            [1280.0, 720.0],
            theme,
            app,
        );
    }
}
