//! Against counts made by hand.

use super::*;

fn hidden(id: &str, target: Option<usize>, name: &str, value: f64) -> KeyEffect {
    let none = Some(0.0);
    let unit = "u".to_owned();
    KeyEffect {
        id: id.to_owned(),
        target,
        params: [(name.to_owned(), KeyValue { value, unit, none })].into(),
        reached: Some(4.0),
        capped: false,
    }
}

fn key(kind: About, strength: f64, effects: Vec<KeyEffect>) -> Key {
    Key {
        onset_s: None,
        kind,
        strength,
        effects,
    }
}

/// The finder's JSON with these effects, each with one parameter.
/// Id, channel, parameter, value, interval.
type Heard<'a> = (&'a str, Option<usize>, &'a str, f64, [f64; 2]);

fn said(verdict: &str, effects: &[Heard]) -> Said {
    let list: Vec<_> = effects
        .iter()
        .map(|(id, target, name, value, ci95)| {
            serde_json::json!({
                "id": id, "side": "any", "target": target,
                "params": {*name: {"value": value, "unit": "u", "ci95": ci95}},
            })
        })
        .collect();
    let json = serde_json::json!({
        "verdict": verdict, "effects": list, "candidates": [], "threshold": 3.0,
        "gap": {"before": 3.0, "after": 1.2, "floor": 1.0, "closed": 0.9, "unit": "mm"},
        "separate_by": null, "seconds": 12.0,
    });
    Said::from_json(&json.to_string())
}

fn case(key: Key, said: Said) -> Scored {
    Scored {
        name: "case".to_owned(),
        key,
        said,
    }
}

fn single(strength: f64, id: &str, target: Option<usize>, said: Said) -> Scored {
    let effect = hidden(id, target, "rate", 1.0);
    case(key(About::Single, strength, vec![effect]), said)
}

#[test]
fn wilson_intervals_are_those_of_the_tables() {
    // Newcombe, Stat. Med. 17 (1998) 857, table I, method 3.
    for (hits, of, low, high) in [
        (81, 263, 0.2553, 0.3662),
        (15, 148, 0.0624, 0.1605),
        (0, 20, 0.0, 0.1611),
        (1, 29, 0.0061, 0.1718),
    ] {
        let [a, b] = wilson(hits, of).expect("cases");
        assert!((a - low).abs() < 6e-5 && (b - high).abs() < 6e-5, "{a} {b}");
    }
    assert_eq!(wilson(0, 0), None);
    assert!(wilson(7, 7).is_some_and(|[a, b]| a > 0.6 && b > 1.0 - 1e-12));
}

#[test]
fn the_median_and_its_interval_follow_the_binomial() {
    assert_eq!(median(&[3.0, 1.0, 2.0]), Some(2.0));
    assert_eq!(median(&[4.0, 1.0, 2.0, f64::NAN, 3.0]), Some(2.5));
    assert_eq!(median(&[]), None);
    let v: Vec<f64> = (1..=20).map(f64::from).collect();
    // 2 P(B < 6) = 0.0414, 2 P(B < 7) = 0.115 for 20 throws.
    assert_eq!(median_ci95(&v), Some([6.0, 15.0]));
    assert_eq!(median_ci95(&v[..6]), Some([1.0, 6.0]));
    assert_eq!(median_ci95(&v[..5]), None);
    // The normal form goes on where the exact one ends.
    let v: Vec<f64> = (1..=1000).map(f64::from).collect();
    let w: Vec<f64> = (1..=1001).map(f64::from).collect();
    let (a, b) = (median_ci95(&v), median_ci95(&w));
    let near = |i: usize| (a.expect("many")[i] - b.expect("many")[i]).abs() <= 1.5;
    assert!(near(0) && near(1), "{a:?} {b:?}");
}

/// Three that begin: found within its interval, found outside of it, not found. One that is there from the start.
#[test]
fn beginnings_are_counted_beside_the_names() {
    let ci = [0.9, 1.2];
    let told = |onset: Option<(f64, [f64; 2])>| Said {
        onset: onset.map(|(t_s, ci95)| Onset { t_s, ci95 }),
        ..said("named", &[("leak", Some(2), "rate", 1.1, ci)])
    };
    let begun = |onset_s: f64, said: Said| {
        let effect = hidden("leak", Some(2), "rate", 1.0);
        let key = key(About::Begun, 4.0, vec![effect]);
        let onset_s = Some(onset_s);
        case(Key { onset_s, ..key }, said)
    };
    let cases = [
        begun(30.0, told(Some((31.0, [29.0, 33.0])))),
        begun(40.0, told(Some((43.0, [42.0, 44.0])))),
        begun(50.0, told(None)),
        single(4.0, "leak", Some(2), told(None)),
    ];
    let s = score(&cases);
    let shares = |x: &Share| (x.hits, x.of);
    assert_eq!(shares(&s.onsets.named), (3, 3));
    assert_eq!(shares(&s.onsets.found), (2, 3));
    assert_eq!(shares(&s.onsets.covered), (1, 2));
    assert_eq!(shares(&s.onsets.claimed), (0, 1));
    assert_eq!(
        (s.onsets.error_s.median, s.onsets.error_s.max),
        (Some(2.0), Some(3.0))
    );
    // They do not stand on the ladder.
    assert_eq!(s.ladder.iter().map(|r| r.top1.of).sum::<usize>(), 1);
    assert!(s.markdown("").contains("| - with a beginning | 2/3"));
}

#[test]
fn singles_are_counted_per_rung_channel_and_side() {
    let ci = [0.9, 1.2];
    let cases = [
        single(
            4.0,
            "leak",
            Some(2),
            said("named", &[("leak", Some(2), "rate", 1.1, ci)]),
        ),
        // Right name, wrong channel.
        single(
            4.0,
            "leak",
            Some(2),
            said("named", &[("leak", Some(3), "rate", 9.0, ci)]),
        ),
        // Right first, and one too many.
        single(
            4.0,
            "leak",
            Some(1),
            said(
                "named",
                &[
                    ("leak", Some(1), "rate", 0.7, ci),
                    ("creep", None, "share", 0.1, ci),
                ],
            ),
        ),
        // Wrong name, right side; then wrong side.
        single(
            8.0,
            "leak",
            Some(1),
            said("named", &[("flow-limit", None, "inflate", 1.0, ci)]),
        ),
        single(
            8.0,
            "leak",
            Some(1),
            said("named", &[("creep", None, "share", 1.0, ci)]),
        ),
        // Sets with and without it.
        single(
            2.0,
            "leak",
            Some(1),
            said(
                "indistinguishable",
                &[
                    ("creep", None, "share", 1.0, ci),
                    ("leak", Some(1), "rate", 1.0, ci),
                ],
            ),
        ),
        single(
            2.0,
            "leak",
            Some(1),
            said("indistinguishable", &[("creep", None, "share", 1.0, ci)]),
        ),
        single(0.5, "leak", Some(1), said("nothing-missing", &[])),
        single(
            2.0,
            "payload",
            None,
            said("named", &[("payload", None, "mass", 1.0, ci)]),
        ),
    ];
    let s = score(&cases);
    let rungs: Vec<_> = s
        .ladder
        .iter()
        .map(|r| {
            (
                r.strength,
                r.top1.hits,
                r.exact.hits,
                r.in_set.hits,
                r.right_or_in_set.hits,
                r.top1.of,
            )
        })
        .collect();
    assert_eq!(
        rungs,
        [
            (0.5, 0, 0, 0, 0, 1),
            (2.0, 1, 1, 1, 2, 3),
            (4.0, 3, 2, 0, 3, 3),
            (8.0, 0, 0, 0, 0, 2)
        ]
    );
    let count = |x: Share| (x.hits, x.of);
    assert_eq!(count(s.channel), (3, 4));
    assert_eq!(count(s.channel_of_choice), (2, 3));
    assert_eq!(count(s.side), (5, 6));
    assert_eq!(s.targets[0].measured, Some(0.6));
    assert_eq!(s.targets[0].state, State::Missed);
    assert_eq!(s.targets[1].measured, Some(0.5));
    assert_eq!(s.confusion["leak"]["leak"], 2);
    assert_eq!(s.confusion["leak"]["leak + creep"], 1);
    assert_eq!(s.confusion["leak"]["set with it"], 1);
    assert_eq!(s.confusion["leak"]["set without it"], 1);
    assert_eq!(s.confusion_weak["leak"]["nothing missing"], 1);
    // Only right channels count: |1.1 − 1|, |0.7 − 1| for rate 1; payload has no `rate`.
    assert_eq!(s.param_error.of, 2);
    assert!(
        s.param_error
            .median
            .is_some_and(|m| (m - 0.2).abs() < 1e-12)
    );
    assert_eq!(count(s.param_covered), (2, 2));
    assert_eq!(s.gap_closed.of, 6);
    assert_eq!(s.lines.iter().filter(|l| l.right).count(), 3);
}

#[test]
fn an_effect_that_a_bound_kept_small_stands_on_the_rung_that_it_reaches() {
    let mut weak = single(8.0, "torsion", Some(1), said("nothing-missing", &[]));
    let effect = &mut weak.key.effects[0];
    (effect.capped, effect.reached) = (true, Some(0.96));
    let mut faint = weak.clone();
    faint.key.effects[0].reached = Some(0.3);
    let s = score(&[weak, faint]);
    let strengths = |l: &[Rung]| l.iter().map(|r| r.strength).collect::<Vec<_>>();
    assert_eq!(strengths(&s.ladder), [0.0, 1.0]);
    assert_eq!(strengths(&s.ladder_asked), [8.0]);
    assert_eq!(s.capped, 2);
    assert_eq!(s.targets[0].state, State::NoData);
}

#[test]
fn nulls_aliens_and_pairs_are_counted_by_what_is_claimed() {
    let ci = [0.0, 2.0];
    let leak = || said("named", &[("leak", Some(1), "rate", 1.0, ci)]);
    let null = |s: Said| case(key(About::Null, 0.0, vec![]), s);
    let alien = |id: &str, s: Said| {
        case(
            key(About::Alien, 4.0, vec![hidden(id, None, "rate", 1.0)]),
            s,
        )
    };
    let pair = |s: Said| {
        let two = vec![
            hidden("leak", Some(1), "rate", 1.0),
            hidden("payload", None, "mass", 2.0),
        ];
        case(key(About::Pair, 4.0, two), s)
    };
    let both = said(
        "named",
        &[
            ("payload", None, "mass", 2.0, ci),
            ("leak", Some(1), "rate", 1.0, ci),
        ],
    );
    let mut half = pair(both.clone());
    half.key.effects[1].capped = true;
    half.key.effects[1].reached = Some(1.0);
    let cases = [
        null(said("nothing-missing", &[])),
        null(said("unknown", &[])),
        null(leak()),
        null(said("not-excited", &[])),
        alien("pad-slip", said("unknown", &[])),
        alien("pad-slip", leak()),
        alien(
            "creep",
            said("indistinguishable", &[("leak", Some(1), "rate", 1.0, ci)]),
        ),
        alien("creep", said("nothing-missing", &[])),
        pair(both),
        pair(leak()),
        pair(said(
            "indistinguishable",
            &[("payload", None, "mass", 2.0, ci)],
        )),
        half,
        pair(Said::from_json("Killed")),
    ];
    let s = score(&cases);
    let count = |x: Share| (x.hits, x.of);
    assert_eq!(count(s.nulls.false_positive), (2, 4));
    assert_eq!(
        (count(s.nulls.named), count(s.nulls.unknown)),
        ((1, 4), (1, 4))
    );
    assert_eq!(count(s.aliens.named_wrongly), (2, 4));
    assert_eq!(
        (count(s.aliens.never_known), count(s.aliens.left_out)),
        ((1, 2), (1, 2))
    );
    assert_eq!(
        (count(s.aliens.unknown), count(s.aliens.nothing)),
        ((1, 4), (1, 4))
    );
    assert_eq!(count(s.pairs.both), (2, 5));
    assert_eq!(count(s.pairs.both_full_strength), (1, 4));
    assert_eq!(
        (count(s.pairs.one), count(s.pairs.in_set)),
        ((1, 5), (1, 5))
    );
    assert_eq!(s.failed, 1);
    assert!(
        s.lines[12]
            .error
            .as_ref()
            .is_some_and(|e| e.contains("does not read"))
    );
    // Named: the null's does not count, the wrong alien's does.
    assert_eq!(s.gap_closed.of, 4);
    assert_eq!(s.confusion["left out: creep"]["set without it"], 1);
    assert_eq!(s.confusion["unmodelled: pad-slip"]["unknown"], 1);
    assert_eq!(s.confusion["nothing"]["not excited"], 1);
}

#[test]
fn errors_of_a_vector_are_relative_to_its_longest_component() {
    let value = |value: f64, unit: &str, none: Option<f64>| KeyValue {
        value,
        unit: unit.to_owned(),
        none,
    };
    let mut effect = hidden("com-offset", None, "x", 0.001);
    effect.params = [
        ("x".to_owned(), value(0.001, "m", Some(0.0))),
        ("y".to_owned(), value(-0.04, "m", Some(0.0))),
        ("shape".to_owned(), value(10.0, "s", None)),
    ]
    .into();
    let found = r#"{"verdict": "named", "effects": [{"id": "com-offset", "side": "mechanics",
        "target": null, "params": {
            "x": {"value": 0.003, "unit": "m", "ci95": [0.002, 0.004]},
            "y": {"value": -0.03, "unit": "m", "ci95": null},
            "shape": {"value": 14.0, "unit": "s", "ci95": [9.0, 20.0]},
            "other": {"value": 1.0, "unit": "", "ci95": [0.0, 2.0]}}}]}"#;
    let s = score(&[case(
        key(About::Single, 8.0, vec![effect]),
        Said::from_json(found),
    )]);
    let lines: Vec<_> = s
        .params
        .iter()
        .map(|p| {
            (
                p.name.as_str(),
                p.error_median.expect("one"),
                p.covered.hits,
                p.covered.of,
            )
        })
        .collect();
    let near = |got: f64, wanted: f64| (got - wanted).abs() < 1e-12;
    assert_eq!(lines.len(), 3);
    assert!(lines[0].0 == "com-offset.shape" && near(lines[0].1, 0.4) && lines[0].2 == 1);
    assert!(
        lines[1].0 == "com-offset.x"
            && near(lines[1].1, 0.05)
            && (lines[1].2, lines[1].3) == (0, 1)
    );
    assert!(lines[2].0 == "com-offset.y" && near(lines[2].1, 0.25) && lines[2].3 == 0);
    assert_eq!(s.seconds.max, None);
}

#[test]
fn the_report_says_what_is_simulated_and_whether_targets_are_met() {
    let ci = [0.0, 2.0];
    let s = score(&[
        single(
            8.0,
            "leak",
            Some(2),
            said("named", &[("leak", Some(2), "rate", 1.0, ci)]),
        ),
        single(1.0, "creep", None, said("unknown", &[])),
    ]);
    let text = s.markdown("Seeds 1 to 1.");
    for wanted in [
        "simulated sessions of the virtual rig",
        "| top-1 naming from 4 x noise floor on | at least 95.0 % | 100.0 % | [20.7 %, 100.0 %] | 1 | met |",
        "| both of a pair found | at least 80.0 % | - |  | 0 | no data |",
        "| longest run of the finder | at most 60.0 s | 12.0 s |  | 2 | met |",
        "| 8 x | 1 | 1/1 = 100.0 % [20.7, 100.0] |",
        "| leak | 1 | 1 |  |",
        "| creep | 1 | 0 | 1 x unknown |",
        "| case | single | creep | 4.00 | unknown |",
    ] {
        assert!(text.contains(wanted), "{wanted}\n{text}");
    }
}
