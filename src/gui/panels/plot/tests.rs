use super::*;

#[test]
fn window_follows_or_stands() {
    let mut w = TimeWindow::default();
    assert_eq!(w.range_s(100.0), [70.0, 100.0]);
    w.frozen_end_s = Some(50.0);
    assert_eq!(w.range_s(100.0), [20.0, 50.0]);
}

#[test]
fn a_drawn_line_is_thinned_anew_only_for_another_window() {
    let points: Vec<[f64; 2]> = (0..5_000)
        .map(|i| [f64::from(i) * 0.01, f64::from(i % 7)])
        .collect();
    let d = Drawn::new(String::new(), Channel::Tip(0), Dash::Solid, points.clone());
    let whole = envelope_of(points.iter().copied(), 0.1);
    assert_eq!(d.envelope([0.0, 50.0], 0.1), whole);
    let kept = d.thinned.borrow().as_ref().map(|t| t.2.as_ptr());
    assert_eq!(d.envelope([0.0, 50.0], 0.1), whole);
    assert_eq!(d.thinned.borrow().as_ref().map(|t| t.2.as_ptr()), kept);
    let part = d.envelope([10.0, 20.0], 0.1);
    assert!(part.iter().flatten().all(|q| (10.0..=20.0).contains(&q[0])));
    assert_ne!(part, whole);
}

#[test]
fn marks_are_round_and_few() {
    let m = marks(-3.1, 7.2, 5.0);
    let values: Vec<_> = m.iter().map(|m| m.value).collect();
    assert_eq!(values, [0.0, 5.0]);
    assert_eq!(marks_of_time([0.0, 30.0], 0.0, 6.0).len(), 7);
    // Round since the recording began, 39 min 50 s into its session.
    let m = marks_of_time([2390.0, 2420.0], 2389.3, 6.0);
    let since: Vec<_> = m.iter().map(|m| (m.value - 2389.3).round()).collect();
    assert_eq!(since, [5.0, 10.0, 15.0, 20.0, 25.0, 30.0]);
    let off = |m: &egui_plot::GridMark| (m.value - 2389.3) - (m.value - 2389.3).round();
    assert!(m.iter().all(|m| off(m).abs() < 1e-9));
    assert!(marks(f64::NAN, 1.0, 3.0).is_empty());
}

#[test]
fn clock_counts_minutes() {
    assert_eq!(clock(75.0, 5.0), "1:15");
    assert_eq!(clock(75.25, 0.5), "1:15.2");
    assert_eq!(clock_text(59.999, 2), "1:00.00");
    assert_eq!(clock_text(-0.001, 2), "0:00.00");
    assert_eq!(clock_text(-75.5, 1), "−1:15.5");
    for (text, t_s) in [
        ("1:43.25", 103.25),
        ("103.25", 103.25),
        ("103,25", 103.25),
        ("−0:30", -30.0),
    ] {
        assert_eq!(clock_value(text), Some(t_s), "{text}");
    }
    for none in ["", "1:", "a:b", "1:2:3", "inf"] {
        assert_eq!(clock_value(none), None, "{none}");
    }
}
