use super::ticks::{marks, marks_of_decades};
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
    let (m, decimals) = marks(-3.1, 7.2, 66.0);
    let values: Vec<_> = m.iter().map(|m| m.value).collect();
    assert_eq!((values, decimals), (vec![0.0, 5.0], 0));
    assert_eq!(marks_of_time([0.0, 30.0], 0.0, 6.0).len(), 7);
    // Round since the recording began, 39 min 50 s into its session.
    let m = marks_of_time([2390.0, 2420.0], 2389.3, 6.0);
    let since: Vec<_> = m.iter().map(|m| (m.value - 2389.3).round()).collect();
    assert_eq!(since, [5.0, 10.0, 15.0, 20.0, 25.0, 30.0]);
    let off = |m: &egui_plot::GridMark| (m.value - 2389.3) - (m.value - 2389.3).round();
    assert!(m.iter().all(|m| off(m).abs() < 1e-9));
    assert!(marks(f64::NAN, 1.0, 80.0).0.is_empty());
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

#[test]
fn every_height_has_two_numbers_that_stand_apart_and_within() {
    for height in 26..=200 {
        for (low, span) in [
            (0.0, 1.0),
            (-297.8, 3.1),
            (-0.04, 0.09),
            (12.3, 700.0),
            (-49.9, 99.0),
            (0.991, 0.02),
            (-1234.5, 8.888),
        ] {
            let high = low + span;
            let (m, decimals) = marks(low, high, f64::from(height));
            let at = |m: &egui_plot::GridMark| (m.value - low) / span * f64::from(height);
            let places: Vec<f64> = m.iter().map(at).collect();
            let what = format!("{low} to {high} in {height}: {places:?}");
            assert!(places.len() >= 2, "{what}");
            assert!(places.windows(2).all(|w| w[1] - w[0] >= 11.99), "{what}");
            let edges = [places[0], f64::from(height) - places[places.len() - 1]];
            assert!(edges.iter().all(|e| *e >= 6.49), "{what}");
            // What is written is the value.
            for m in &m {
                let written: f64 = format!("{:.decimals$}", m.value).parse().expect("a number");
                assert!((written - m.value).abs() < 1e-9 * span.max(1.0), "{what}");
            }
        }
    }
}

#[test]
fn logarithmic_axes_have_powers_of_ten() {
    let values = |low: f64, high: f64, height| -> Vec<f64> {
        let marks = marks_of_decades(low, high, height).into_iter();
        marks
            .map(|m| (1e3 * 10_f64.powf(m.value)).round())
            .collect()
    };
    assert_eq!(values(-1.5, 1.5, 100.0), [100.0, 1000.0, 10_000.0]);
    assert_eq!(values(-1.1, 1.1, 60.0), [200.0, 5000.0]);
    let fine = values(-0.1, 1.1, 300.0);
    assert_eq!(fine, [1000.0, 2000.0, 5000.0, 10_000.0]);
    assert!(values(f64::NAN, 1.0, 100.0).is_empty());
}

#[test]
fn the_range_holds_all_points_and_is_never_less_than_the_least() {
    let [low, high] = span_of([1.0, f64::NAN, 3.0].into_iter(), 0.5);
    assert!(low < 1.0 && high > 3.0 && high - low < 2.3, "{low} {high}");
    assert_eq!(span_of([2.0].into_iter(), 1.0), [1.5, 2.5]);
    assert_eq!(span_of(std::iter::empty(), 1.0), [-0.5, 0.5]);
}
