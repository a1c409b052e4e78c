use proptest::prelude::*;
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;

use super::*;
use crate::analysis::decimate::join;
use crate::analysis::fixture;
use crate::signal::{Estimate, Matrix6, TruthSource, pose_from_ypr};

// x of the tip is `f(t)` in mm.
fn tip_x(rows: usize, hz: f64, f: impl Fn(f64) -> f64) -> History {
    let mut h = History::new(LIVE_ROWS);
    for i in 0..rows {
        let t = i as f64 / hz;
        h.push(&snapshot(t, f(t) * 1e-3));
    }
    h
}

fn snapshot(t_s: f64, x_m: f64) -> Snapshot {
    let stamp = Stamp::from_seconds(t_s);
    Snapshot {
        stamp,
        estimate: Some(Estimate {
            stamp,
            base_from_tip: pose_from_ypr([x_m, 0.0, 0.0], [0.0; 3]),
            covariance: Matrix6::zeros(),
            training_distance: 1.0,
        }),
        ..Snapshot::default()
    }
}

#[test]
fn envelope_has_at_most_two_points_per_pixel_and_keeps_the_extremes() {
    // A spike of one sample in noise must survive any window.
    let noise = |t: f64| (t * 1_234.567).sin() * 3.0 + if t == 7.77 { 50.0 } else { 0.0 };
    let h = tip_x(60_000, 100.0, noise);
    for (from, to) in [(0.0, 600.0), (0.0, 10.0), (5.0, 95.0), (7.7, 7.8)] {
        for pixels in [3, 100, 777] {
            let lines = h.envelope(Channel::Tip(0), from, to, pixels);
            let points: Vec<_> = lines.concat();
            assert!(points.len() <= 2 * pixels, "{} > 2·{pixels}", points.len());
            assert!(
                points.windows(2).all(|w| w[0][0] < w[1][0]),
                "in time order"
            );
            let all: Vec<_> = h.values(Channel::Tip(0), from, to).collect();
            let max = |v: &[f64]| v.iter().copied().fold(f64::MIN, f64::max);
            let min = |v: &[f64]| v.iter().copied().fold(f64::MAX, f64::min);
            let kept: Vec<_> = points.iter().map(|p| p[1]).collect();
            assert_eq!(max(&kept), max(&all));
            assert_eq!(min(&kept), min(&all));
            assert!(max(&kept) > 40.0);
        }
    }
}

#[test]
fn a_gap_breaks_the_line() {
    let mut h = tip_x(100, 100.0, |_| 1.0);
    for i in 0..100 {
        h.push(&snapshot(3.0 + f64::from(i) * 0.01, 1e-3));
    }
    assert_eq!(h.envelope(Channel::Tip(0), 0.0, 4.0, 400).len(), 2);
    assert_eq!(h.envelope(Channel::Tip(0), 0.0, 0.9, 400).len(), 1);
}

#[test]
fn ring_drops_the_oldest_and_a_new_session_clears() {
    let mut h = History::new(10);
    for i in 0..25 {
        h.push(&snapshot(f64::from(i), f64::from(i) * 1e-3));
    }
    assert_eq!(h.len(), 10);
    let [first, last] = h.range_s().expect("rows");
    assert!((first - 15.0).abs() < 1e-9 && (last - 24.0).abs() < 1e-9);
    let x: Vec<_> = h.values(Channel::Tip(0), 0.0, 100.0).collect();
    assert_eq!(x, (15..25).map(f64::from).collect::<Vec<_>>());
    // The same instant again changes nothing; an earlier one is another session.
    h.push(&snapshot(24.0, 0.5));
    assert_eq!(h.len(), 10);
    h.push(&snapshot(1.0, 0.0));
    assert_eq!(h.range_s(), Some([1.0, 1.0]));
}

#[test]
fn error_is_taken_at_the_instant_of_the_truth() {
    // The tip moves 10 mm/s; the truth comes 25 ms late but is exact.
    let mut h = History::new(1000);
    for i in 0..200 {
        let t = f64::from(i) * 0.01;
        let mut s = snapshot(t, t * 0.010);
        let then = t - 0.025;
        s.truth = Some(GroundTruth {
            stamp: Stamp::from_seconds(then),
            base_from_tip: pose_from_ypr([then * 0.010 + 1e-3, 0.0, 0.0], [0.0; 3]),
            source: TruthSource::VirtualRig,
        });
        h.push(&s);
    }
    let e: Vec<_> = h.values(Channel::Error(0), 0.0, 10.0).collect();
    assert!(e.len() > 190, "{}", e.len());
    for x in e {
        assert!((x + 1.0).abs() < 1e-4, "{x}");
    }
    // Three came before the first estimate.
    assert_eq!(h.excluded(0.0, 10.0), 3);
    assert_eq!(h.excluded(0.5, 10.0), 0);
}

#[test]
fn the_newest_value_before_an_instant_is_found_from_behind() {
    let mut h = History::new(6_000);
    // Estimates end early, and the oldest rows have been dropped.
    for i in 0..10_000_u32 {
        let mut s = fixture::snapshot(100.0 + f64::from(i) * 0.01);
        if i > 9_000 || i % 3 != 0 {
            s.estimate = None;
        }
        h.push(&s);
    }
    let tip = Channel::Tip(0);
    for to_s in [
        0.0, 130.0, 140.0, 141.234, 163.0, 189.995, 190.0, 199.0, 1e9,
    ] {
        let walked = h.points(tip, f64::NEG_INFINITY, to_s).last();
        assert_eq!(h.last_before(tip, to_s), walked.map(|q| q[0]), "{to_s}");
    }
    assert!(h.last_before(tip, 195.0).is_some());
    assert_eq!(h.last_before(tip, 139.0), None);
}

#[test]
fn stats_have_their_anchors() {
    let s = Stats::of((1..=100).map(|i| {
        if i % 2 == 0 {
            f64::from(i)
        } else {
            -f64::from(i)
        }
    }))
    .expect("values");
    assert_eq!(
        (s.mean, s.p50, s.p95, s.max, s.n),
        (50.5, 50.0, 95.0, 100.0, 100)
    );
    // Σ i² = n (n + 1) (2n + 1) / 6
    assert!((s.rmse - 3_383.5_f64.sqrt()).abs() < 1e-9);
    assert_eq!(Stats::of(std::iter::empty()), None);
}

#[test]
fn yaw_wraps() {
    let d = display_difference(
        &[0.0, 0.0, 0.0, 179.0, 0.0, 0.0],
        &[0.0, 0.0, 0.0, -179.0, 0.0, 0.0],
    );
    assert!((d[3] + 2.0).abs() < 1e-9);
}

#[test]
fn unusable_channels_leave_no_value() {
    let mut s = fixture::snapshot(1.0);
    if let Some(sensors) = &mut s.sensors {
        sensors.health.springs[4] = crate::signal::ChannelHealth::Missing;
    }
    let h = History::of([s].iter());
    assert_eq!(h.values(Channel::Spring(4), 0.0, 2.0).count(), 0);
    assert_eq!(h.values(Channel::Spring(5), 0.0, 2.0).count(), 1);
}

/// The envelope by its definition: point after point.
fn envelope_by_points(
    points: &[[f64; 2]],
    [from_s, to_s]: [f64; 2],
    width_s: f64,
    gap_s: f64,
) -> Vec<Vec<[f64; 2]>> {
    let mut lines: Vec<Vec<Vec<[f64; 2]>>> = Vec::new();
    let mut last_s = f64::NEG_INFINITY;
    let mut slot = f64::NAN;
    for p in points.iter().filter(|p| p[0] >= from_s && p[0] <= to_s) {
        let index = (p[0] / width_s).floor();
        let broken = p[0] - last_s > gap_s;
        if broken {
            lines.push(Vec::new());
        }
        let line = lines.last_mut().expect("the first point breaks");
        if broken || index != slot {
            line.push(Vec::new());
        }
        line.last_mut().expect("not empty").push(*p);
        (last_s, slot) = (p[0], index);
    }
    let extremes = |points: &Vec<[f64; 2]>| {
        let first = |better: fn(f64, f64) -> bool| {
            let mut best = points[0];
            for p in points {
                if better(p[1], best[1]) {
                    best = *p;
                }
            }
            best
        };
        let (low, high) = (first(|a, b| a < b), first(|a, b| a > b));
        if low == high {
            vec![low]
        } else if low[0] <= high[0] {
            vec![low, high]
        } else {
            vec![high, low]
        }
    };
    let line = |slots: Vec<Vec<[f64; 2]>>| slots.iter().flat_map(extremes).collect();
    lines.into_iter().map(line).collect()
}

/// What a store of one column holds, and the same rows in a list: some without a value, some after a pause.
fn filled(rng: &mut Pcg64Mcg, rows: usize, capacity: usize) -> (Store, Vec<(f64, f32)>) {
    let (missing, pauses) = (rng.random_range(0.0..0.9), rng.random_range(0.0..0.01));
    let mut store = Store::new(1);
    let mut list = Vec::new();
    let mut t_s = rng.random_range(-100.0..1e4);
    for _ in 0..rows {
        let value = if rng.random_bool(missing) {
            f32::NAN
        } else {
            // Few different values, so that there are ties.
            rng.random_range(-20i8..20).into()
        };
        store.push(t_s, &[value]);
        list.push((t_s, value));
        if list.len() > capacity {
            store.pop();
            list.remove(0);
        }
        t_s += if rng.random_bool(pauses) {
            rng.random_range(0.0..3.0)
        } else {
            0.001
        };
    }
    (store, list)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(60))]

    #[test]
    fn extremes_kept_at_hand_are_those_of_the_points(
        seed: u64,
        rows in 1usize..14_000,
        capacity in 1usize..14_000,
        pixels in 2usize..900,
    ) {
        let mut rng = Pcg64Mcg::seed_from_u64(seed);
        let (store, list) = filled(&mut rng, rows, capacity);
        prop_assert_eq!(store.len(), list.len());
        let points: Vec<[f64; 2]> = list
            .iter()
            .filter(|(_, v)| v.is_finite())
            .map(|(t, v)| [*t, f64::from(*v)])
            .collect();
        let [first, last] = [list[0].0, list[list.len() - 1].0];
        let mut drawn = Drawn::default();
        for _ in 0..6 {
            let a = rng.random_range(first - 1.0..=last + 1.0);
            let b = rng.random_range(first - 1.0..=last + 1.0);
            let window = if rng.random_bool(0.2) { [first, last] } else { [a.min(b), a.max(b)] };
            let width_s = (window[1] - window[0]).max(1e-3) / pixels as f64;
            let gap_s = (3.0 * width_s).max(0.05);
            let slots = drawn.slots(&store, 0, window, width_s);
            let by_points = envelope_by_points(&points, window, width_s, gap_s);
            prop_assert_eq!(join(&slots, gap_s), by_points);
            let seen = points.iter().map(|p| p[0]).filter(|t| (window[0]..=window[1]).contains(t));
            let instants: Vec<f64> = [window[0]].into_iter().chain(seen).chain([window[1]]).collect();
            let apart = |w: &&[f64]| w[1] - w[0] > gap_s;
            let gaps: Vec<[f64; 2]> =
                instants.windows(2).filter(apart).map(|w| [w[0], w[1]]).collect();
            prop_assert_eq!(store.gaps(0, window[0], window[1], gap_s), gaps);
            let within: Vec<f32> = store.values(0, window[0], window[1]).collect();
            let expected: Vec<f32> = points
                .iter()
                .filter(|p| p[0] >= window[0] && p[0] <= window[1])
                .map(|p| p[1] as f32)
                .collect();
            prop_assert_eq!(within, expected);
            let before = list.iter().filter(|(t, _)| *t < a).count();
            prop_assert_eq!(store.row_at(a), before);
        }
    }

    /// Rows come, the oldest go, the window follows, jumps back and on: what is kept from one picture to
    /// the next never shows.
    #[test]
    fn slots_that_are_kept_are_those_of_the_points(seed: u64, capacity in 50usize..9_000) {
        let mut rng = Pcg64Mcg::seed_from_u64(seed);
        let (mut store, mut list) = filled(&mut rng, 2_000, capacity);
        let mut drawn = Drawn::default();
        let width_s = rng.random_range(0.002..0.05);
        let span_s = width_s * 120.0;
        let gap_s = (3.0_f64 * width_s).max(0.05);
        for _ in 0..40 {
            for _ in 0..rng.random_range(0..400) {
                let t_s = list[list.len() - 1].0 + rng.random_range(1e-4..2e-3);
                let value = if rng.random_bool(0.3) { f32::NAN } else { rng.random_range(-5i8..5).into() };
                store.push(t_s, &[value]);
                list.push((t_s, value));
                if list.len() > capacity {
                    store.pop();
                    list.remove(0);
                }
            }
            let newest_s = list[list.len() - 1].0;
            let end_s = match rng.random_range(0..4) {
                0 => newest_s - rng.random_range(0.0..2.0),
                1 => newest_s + rng.random_range(0.0..0.1),
                _ => newest_s,
            };
            let window = [end_s - span_s, end_s];
            let points: Vec<[f64; 2]> = list
                .iter()
                .filter(|(_, v)| v.is_finite())
                .map(|(t, v)| [*t, f64::from(*v)])
                .collect();
            let slots = drawn.slots(&store, 0, window, width_s);
            prop_assert_eq!(join(&slots, gap_s), envelope_by_points(&points, window, width_s, gap_s));
        }
    }

    #[test]
    fn ranks_are_those_of_sorted_values(values in prop::collection::vec(-1e3..1e3f64, 1..300)) {
        let mut sorted: Vec<f64> = values.iter().map(|v| v.abs()).collect();
        sorted.sort_by(f64::total_cmp);
        let n = sorted.len();
        let rank = |p: f64| sorted[((p * n as f64).ceil() as usize).clamp(1, n) - 1];
        let stats = Stats::of(values.into_iter()).expect("values");
        prop_assert_eq!((stats.p50, stats.p95, stats.max, stats.n), (rank(0.5), rank(0.95), sorted[n - 1], n));
    }
}

#[test]
fn a_live_history_forgets_what_no_window_shows() {
    let mut h = History::live();
    for i in 0..30_000 {
        h.push(&snapshot(f64::from(i) * 0.05, 0.0));
    }
    let [first, last] = h.range_s().expect("rows");
    assert!((last - first - LIVE_S).abs() < 0.051, "{first} to {last}");
    assert_eq!(
        h.values(Channel::Tip(0), f64::NEG_INFINITY, last).count(),
        h.len()
    );
    // A new session starts afresh, with the same bound.
    h.push(&snapshot(0.0, 0.0));
    assert_eq!(h.len(), 1);
    h.push(&snapshot(LIVE_S + 1.0, 0.0));
    assert_eq!(h.len(), 1);
}

#[test]
fn samples_come_once_per_step_and_complete() {
    let mut h = tip_x(2_000, 1000.0, |t| t);
    // Later on without an estimate: nothing to sample.
    for i in 2_000..3_000 {
        h.push(&Snapshot {
            stamp: Stamp::from_seconds(f64::from(i) * 1e-3),
            ..Snapshot::default()
        });
    }
    let channels = [Channel::Tip(0), Channel::Tip(1)];
    let samples = h.sampled(channels, [0.5, 3.0], 0.05);
    assert_eq!(samples.len(), 30);
    for (i, [x, y]) in samples.iter().enumerate() {
        let wanted = 0.5 + 0.05 * i as f64;
        assert!((x - wanted).abs() < 0.0011 && *y == 0.0, "{x} at {wanted}");
    }
    assert_eq!(h.value_at(Channel::Tip(0), 1.5), Some(1.5));
    // Looked for two seconds back, no further.
    assert_eq!(
        h.value_at(Channel::Tip(0), 2.9).map(|x| (x * 1e3).round()),
        Some(1999.0)
    );
    assert_eq!(h.value_at(Channel::Truth(0), 2.9), None);
}

/// What springs and IMUs read by both models, in columns of their own; what the monitor judges, once for every verdict.
#[test]
fn the_residual_of_the_model_that_is_tried_lies_beside_that_of_the_twin() {
    use crate::signal::{Disagreement, Predicted, TriedPatch};
    let reads = |s: &Snapshot, mm: f64| {
        let mut reads = s.sensors.as_ref().expect("sensors").sensors.clone();
        reads.spring_m[4] -= mm * 1e-3;
        reads.imu_ypr_rad[2][1] -= (0.1 * mm).to_radians();
        reads
    };
    let mut h = History::new(LIVE_ROWS);
    for k in 0..30 {
        let mut s = fixture::snapshot(1.0 + 0.1 * f64::from(k));
        s.model_sensors = Some(reads(&s, 2.0).into());
        s.tried = (10..20).contains(&k).then(|| TriedPatch {
            name: "payload".into(),
            robot: "abc".into(),
            since: Stamp::from_seconds(2.0),
            predicted: Some(
                Predicted {
                    shape: s.shape.as_deref().cloned().expect("a shape"),
                    sensors: reads(&s, 0.5),
                }
                .into(),
            ),
        });
        s.disagreement = Some(Disagreement {
            t_s: f64::from(k / 10),
            ratio: 1.5,
            channel: "spring 5".to_owned(),
            since_s: 0.0,
            likely: Vec::new(),
            muted: Vec::new(),
        });
        h.push(&s);
    }
    let all = |channel| h.values(channel, 0.0, 9.0).collect::<Vec<f64>>();
    for (channel, wanted, n) in [
        (Channel::SpringResidual(4), 2.0, 30),
        (Channel::SpringTried(4), 0.5, 10),
        (Channel::SpringResidual(5), 0.0, 30),
        (Channel::SpringTried(5), 0.0, 10),
        (Channel::ImuResidual(2, 1), 0.2, 30),
        (Channel::ImuTried(2, 1), 0.05, 10),
        (Channel::Disagreement, 1.5, 3),
    ] {
        let values = all(channel);
        assert_eq!(values.len(), n, "{channel:?}");
        assert!(
            values.iter().all(|v| (v - wanted).abs() < 1e-4),
            "{channel:?}: {values:?}"
        );
    }
}
