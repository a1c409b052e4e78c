use std::collections::BTreeMap;

use super::markup::{at, base64, escape, fixed, number, ticks, with_error};
use super::*;
use crate::gap::finding::{Dependence, GapSize, Located, Ranked, SeparateBy, Traces};
use crate::gap::patch::PatchValue;
use crate::sim::effects::{EFFECTS, Target};

const VERDICTS: [(Verdict, &str); 5] = [
    (Verdict::NothingMissing, "Nothing is missing"),
    (
        Verdict::Named,
        "Undeclared payload and Leak, chamber 3 are missing from the model. With them in it, 94 %",
    ),
    (
        Verdict::Indistinguishable,
        "does not identify which effect it is: Undeclared payload or Leak, chamber 3. Record a session with \
         the excitation “loads”",
    ),
    (
        Verdict::Unknown,
        "no effect in the table explains it. It shows in tip z of r2",
    ),
    (Verdict::NotExcited, "moves too little"),
];

fn value(value: f64, unit: &str, ci95: [f64; 2]) -> PatchValue {
    PatchValue {
        value,
        unit: unit.to_owned(),
        ci95: Some(ci95),
    }
}

fn channel(name: &str, before: f64, after: f64) -> ChannelError {
    ChannelError {
        name: name.to_owned(),
        unit: "mm".to_owned(),
        before,
        after,
        after_ci95: [0.9 * after, 1.15 * after],
        shuffled: Some(1.02 * before),
        floor: Some(0.9),
    }
}

fn traces() -> Traces {
    let t_s: Vec<f64> = (0..900).map(|i| f64::from(i) * 0.1).collect();
    let channels: Vec<String> = (0..crate::gap::CHANNELS)
        .map(crate::gap::channel_name)
        .collect();
    let wave = |t: f64, c: usize| (0.35 * t + c as f64).sin();
    let grain = |t: f64, c: usize| (97.0 * t + 31.0 * c as f64).sin();
    let rows = |size: f64| {
        (0..channels.len())
            .map(|c| {
                let of_channel = if c == 2 || c == 9 { 8.0 } else { 1.0 };
                t_s.iter()
                    .map(|&t| {
                        if (40.0..43.0).contains(&t) && c < 6 {
                            f64::NAN
                        } else {
                            size * of_channel * wave(t, c) + grain(t, c)
                        }
                    })
                    .collect()
            })
            .collect()
    };
    let tip = |dz: f64| {
        t_s.iter()
            .map(|&t| {
                let sag = dz * (1.0 + 0.3 * wave(t, 0));
                [0.05 * wave(t, 1), 0.04 * wave(2.0 * t, 2), -0.3 - sag]
            })
            .collect::<Vec<_>>()
    };
    let mut measured_m = tip(0.012);
    measured_m[400..430].fill([f64::NAN; 3]);
    let n = t_s.len();
    Traces {
        before: rows(1.0),
        after: rows(0.03),
        channels,
        measured_m,
        before_m: tip(0.0),
        after_m: tip(0.0115),
        turns: std::array::from_fn(|_| vec![[1.0, 0.0, 0.0, 0.0]; n]),
        t_s,
        tension: Some(Dependence {
            bellows: 1,
            input: "longer_m",
            share: 0.8,
            rms_n: 2.5,
            points: vec![[-0.01, 4.0], [0.0, 0.0], [0.01, 0.1]],
        }),
    }
}

fn finding(verdict: Verdict) -> Finding {
    let has_effects = matches!(verdict, Verdict::Named | Verdict::Indistinguishable);
    let effects = vec![
        FoundEffect {
            id: "payload".to_owned(),
            side: "mechanics".to_owned(),
            target: None,
            params: BTreeMap::from([("mass".to_owned(), value(0.4123, "kg", [0.3981, 0.4269]))]),
            instead_of: None,
            chosen_by: Some(1.0),
        },
        FoundEffect {
            id: "leak".to_owned(),
            side: "actuation".to_owned(),
            target: Some(3),
            params: BTreeMap::from([("rate".to_owned(), value(0.31, "1/s", [0.28, 0.35]))]),
            instead_of: (verdict == Verdict::Indistinguishable).then_some(0),
            chosen_by: None,
        },
    ];
    let candidates = [
        ("payload", None, 812.0, 41.0),
        ("com-offset", None, 640.0, 60.0),
        ("tip-force", None, 611.0, 52.0),
        ("chamber-stiffness", Some(2), 88.0, 20.0),
        ("leak", Some(3), 35.0, 9.0),
        ("creep", None, 9.0, 5.0),
        ("damping", None, 0.4, 1.0),
        ("hysteresis", Some(5), -6.0, 4.0),
    ];
    Finding {
        verdict,
        effects: if has_effects { effects } else { Vec::new() },
        candidates: candidates
            .into_iter()
            .map(|(id, target, gain, se)| Ranked {
                id: id.to_owned(),
                target,
                gain,
                se,
            })
            .collect(),
        threshold: 14.2,
        located: vec![Located {
            residual: "r2".to_owned(),
            channel: "tip z".to_owned(),
            regressor: "level of chamber 3".to_owned(),
            share: 0.61,
        }],
        gap: GapSize {
            before: 12.4,
            after: 1.6,
            floor: 0.9,
            closed: 0.939,
            unit: "mm".to_owned(),
        },
        worse: vec![channel("r4 IMU 2", 0.8, 0.95)],
        channels: vec![
            channel("r2 tip position", 12.4, 1.6),
            channel("r3 springs", 3.1, 1.2),
            channel("r4 IMU 2", 0.8, 0.95),
        ],
        embargo_s: 0.0,
        onset: None,
        folds: Vec::new(),
        failed_folds: Vec::new(),
        proof: None,
        separate_by: (verdict == Verdict::Indistinguishable).then(|| SeparateBy {
            excitation: "loads".to_owned(),
            effects: vec!["payload".to_owned(), "tip-force".to_owned()],
            why: "A mass turns with the pad, a force does not.".to_owned(),
        }),
        notes: vec!["No commissioning session: the factory model is the baseline.".to_owned()],
        data: BTreeMap::from([
            ("baseline".to_owned(), "ab12".repeat(16)),
            ("suspect".to_owned(), "cd34".repeat(16)),
        ]),
        seconds: 41.3,
        traces: traces(),
    }
}

const PATCH: &str = "version = 1\nname = \"a rig\"\nverdict = \"named\"\n\n[[effects]]\nid = \"payload\"\n\n\
                     [effects.params.mass]\nvalue = 0.4123\nunit = \"kg\"\nci95 = [0.3981, 0.4269]\n";

/// Every tag is closed in its order, attributes are quoted once, and ampersands begin an entity.
fn check_well_formed(page: &str) -> Result<(), String> {
    let mut rest = page
        .strip_prefix("<!DOCTYPE html>")
        .ok_or("no document type")?;
    let mut open: Vec<&str> = Vec::new();
    while let Some(start) = rest.find('<') {
        text_is_sound(&rest[..start])?;
        let mut quote = false;
        let length = rest[start..]
            .find(|c| {
                quote ^= c == '"';
                c == '>' && !quote
            })
            .ok_or("a tag does not end")?;
        let tag = &rest[start + 1..start + length];
        rest = &rest[start + length + 1..];
        if let Some(name) = tag.strip_prefix('/') {
            if open.pop() != Some(name) {
                return Err(format!("</{name}> closes nothing"));
            }
            continue;
        }
        let closed = tag.ends_with('/');
        let tag = tag.trim_end_matches('/').trim_end();
        let (name, attributes) = tag.split_once(' ').unwrap_or((tag, ""));
        if name.is_empty() || !name.chars().all(|c| c.is_ascii_alphanumeric()) {
            return Err(format!("<{tag}> is no tag"));
        }
        attributes_are_sound(attributes)?;
        if !closed {
            open.push(name);
            if name == "style" {
                // Its content is no markup, and must not look like any.
                let end = rest.find("</style>").ok_or("the style does not end")?;
                if rest[..end].contains(['<', '&']) {
                    return Err("the style holds markup".to_owned());
                }
            }
        }
    }
    text_is_sound(rest)?;
    if open.is_empty() {
        Ok(())
    } else {
        Err(format!("{open:?} stay open"))
    }
}

fn text_is_sound(text: &str) -> Result<(), String> {
    for (i, _) in text.match_indices('&') {
        let entity = text[i + 1..].split(';').next().unwrap_or_default();
        if !["amp", "lt", "gt", "quot", "#39"].contains(&entity) {
            return Err(format!("&{entity} is no entity"));
        }
    }
    Ok(())
}

fn attributes_are_sound(mut text: &str) -> Result<(), String> {
    let mut seen = Vec::new();
    loop {
        text = text.trim_start();
        if text.is_empty() {
            return Ok(());
        }
        let (name, value) = text.split_once("=\"").ok_or(format!("attribute {text}"))?;
        let (value, after) = value.split_once('"').ok_or(format!("attribute {text}"))?;
        if seen.contains(&name) || !name.chars().all(|c| c.is_ascii_alphanumeric() || c == '-') {
            return Err(format!("attribute {name}"));
        }
        text_is_sound(value)?;
        seen.push(name);
        text = after;
    }
}

/// No number in a picture is NaN or infinite.
fn check_numbers(page: &str) {
    for part in page.split("<svg").skip(1) {
        let picture = part.split("</svg>").next().expect("split gives one");
        for attribute in picture.split('"').skip(1).step_by(2) {
            let data = attribute.starts_with("data:");
            let sound = data || !(attribute.contains("NaN") || attribute.contains("inf"));
            assert!(sound, "{attribute}");
        }
    }
}

#[test]
fn the_checker_finds_faults() {
    let page = |body: &str| format!("<!DOCTYPE html><p>{body}</p>");
    assert_eq!(
        check_well_formed(&page("<b a=\"1>2\">x</b> &amp; <br/>")),
        Ok(())
    );
    for bad in [
        "<b>",
        "</b>",
        "<b></p></b>",
        "a & b",
        "<b a=1></b>",
        "<b a=\"1\" a=\"2\"/>",
        "< 3",
        "<b",
    ] {
        assert!(check_well_formed(&page(bad)).is_err(), "{bad}");
    }
}

#[test]
fn every_verdict_is_a_sentence_on_a_well_formed_page() {
    for (verdict, says) in VERDICTS {
        let f = finding(verdict);
        for origin in [Origin::Simulated, Origin::Measured] {
            let page = html(&f, PATCH, origin);
            check_well_formed(&page).expect("well-formed");
            check_numbers(&page);
            assert!(sentence(&f).contains(says), "{}", sentence(&f));
            assert!(page.contains(&escape(says)), "{verdict:?}");
            assert_eq!(
                page.contains("simulated</span>"),
                origin == Origin::Simulated
            );
            assert!(
                !page.contains("http://")
                    || page.matches("http://").count()
                        == page.matches("http://www.w3.org/").count()
            );
            assert!(!page.contains("<script"));
        }
    }
}

#[test]
fn the_page_holds_what_was_found() {
    let page = html(&finding(Verdict::Named), PATCH, Origin::Measured);
    for wanted in [
        "Undeclared payload",
        "<td class=\"n\">412 g</td><td class=\"n\">398 to 427 g</td>",
        "Closed 94 %",
        "812 ± 41",
        "▲ worse",
        "Shuffled control",
        "level of chamber 3",
        "springtwin gap apply patch.toml",
        "value = 0.4123",
        &"cd34".repeat(16),
        "No commissioning session",
    ] {
        assert!(page.contains(wanted), "{wanted}");
    }
    assert_eq!(page.matches("data:image/png").count(), 2);
    let page = html(
        &finding(Verdict::Indistinguishable),
        PATCH,
        Origin::Measured,
    );
    assert!(page.contains("<code>loads</code>, which separates Undeclared payload, Tip force."));
    let page = html(&finding(Verdict::Unknown), "", Origin::Measured);
    assert!(!page.contains("gap apply") && page.matches("data:image/png").count() == 1);
}

#[test]
fn what_is_sure_is_stated_apart_from_what_is_open() {
    let mut f = finding(Verdict::Indistinguishable);
    let creep = FoundEffect {
        id: "creep".to_owned(),
        instead_of: Some(1),
        ..f.effects[0].clone()
    };
    f.effects[1].instead_of = None;
    f.effects.push(creep);
    let text = sentence(&f);
    let wanted = "Undeclared payload is missing from the model, and one more effect, which this session does not identify: \
                  Leak, chamber 3 or Creep, every chamber.";
    assert!(text.starts_with(wanted), "{text}");
    let places: Vec<Vec<&str>> = f
        .choices()
        .into_iter()
        .map(|c| c.into_iter().map(|e| e.id.as_str()).collect())
        .collect();
    assert_eq!(places, [vec!["payload"], vec!["leak", "creep"]]);
}

#[test]
fn names_cannot_break_out() {
    let evil = "<script>alert('&\"x')</script>\u{1}";
    let mut f = finding(Verdict::Indistinguishable);
    f.effects[0].id = evil.to_owned();
    f.effects[0].side = evil.to_owned();
    f.effects[1].params = BTreeMap::from([(evil.to_owned(), value(1.0, evil, [0.0, 2.0]))]);
    f.candidates[0].id = evil.to_owned();
    f.located[0] = Located {
        residual: evil.to_owned(),
        channel: evil.to_owned(),
        regressor: evil.to_owned(),
        share: 0.5,
    };
    f.gap.unit = evil.to_owned();
    f.worse[0].name = evil.to_owned();
    f.channels[0].unit = evil.to_owned();
    f.channels[1].name = evil.to_owned();
    f.separate_by = Some(SeparateBy {
        excitation: evil.to_owned(),
        effects: vec![evil.to_owned()],
        why: evil.to_owned(),
    });
    f.notes.push(evil.to_owned());
    f.data.insert(evil.to_owned(), evil.to_owned());
    f.traces.channels[3] = evil.to_owned();
    for verdict in VERDICTS.map(|(v, _)| v) {
        f.verdict = verdict;
        let page = html(&f, evil, Origin::Simulated);
        check_well_formed(&page).expect("well-formed");
        assert!(!page.contains("<script") && !page.contains('\u{1}'));
        assert!(page.contains("&lt;script&gt;"));
    }
}

#[test]
fn numbers_that_are_none_do_not_reach_the_pictures() {
    let mut f = finding(Verdict::Named);
    for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        f.gap.after = bad;
        f.gap.floor = bad;
        f.gap.closed = bad;
        f.threshold = bad;
        f.candidates[0].gain = bad;
        f.candidates[1].se = bad;
        f.channels[0].after_ci95 = [bad, bad];
        f.channels[1].shuffled = Some(bad);
        f.channels[2].floor = Some(bad);
        f.traces.before[4].fill(bad);
        f.traces.after_m[17] = [bad; 3];
        f.located[0].share = bad;
        f.seconds = bad;
        if let Some(p) = f.effects[0].params.get_mut("mass") {
            p.value = bad;
            p.ci95 = Some([bad, 1.0]);
        }
        let page = html(&f, PATCH, Origin::Measured);
        check_well_formed(&page).expect("well-formed");
        check_numbers(&page);
        let words = page
            .split("data:")
            .map(|p| p.split_once('"').map_or(p, |(_, rest)| rest));
        assert!(words.into_iter().all(|w| !w.contains("NaN")));
    }
    // Nothing at all is a page too.
    f.traces = Traces::default();
    f.gap = GapSize::default();
    f.candidates.clear();
    f.channels.clear();
    f.located.clear();
    f.data.clear();
    check_well_formed(&html(&f, "", Origin::Measured)).expect("well-formed");
    // One instant makes no axis.
    f.traces = traces();
    f.traces.t_s = vec![3.0; 900];
    check_numbers(&html(&f, "", Origin::Measured));
}

#[test]
fn parameters_are_told_in_units_a_person_thinks_in() {
    for (id, name, v, says) in [
        (
            "gauge-error",
            "offset",
            value(-2100.0, "Pa", [-2350.0, -1850.0]),
            "offset −2.10 kPa (−2.35 to −1.85)",
        ),
        (
            "spring-calibration",
            "offset",
            value(0.00312, "m", [0.0030, 0.0033]),
            "offset 3.12 mm (3.00 to 3.30)",
        ),
        (
            "base-tilt",
            "x",
            value(0.0349, "rad", [0.030, 0.040]),
            "x 2.00 deg (1.72 to 2.29)",
        ),
        (
            "imu-drift",
            "rate",
            value(0.001, "rad/s", [0.0008, 0.0012]),
            "rate 3.44 deg/min (2.75 to 4.13)",
        ),
        (
            "supply-coupling",
            "share",
            value(0.12, "", [0.10, 0.14]),
            "share 12.0 % (10.0 to 14.0)",
        ),
        (
            "chamber-stiffness",
            "factor",
            value(0.8, "", [0.78, 0.82]),
            "factor 0.800 (0.780 to 0.820)",
        ),
        (
            "tip-force",
            "z",
            value(3.0, "N", [-20.0, 30.0]),
            "z 3 N (−20 to 30)",
        ),
        (
            "novel",
            "speed",
            value(3.0, "m/h", [3.0, 3.0]),
            "speed 3.00 m/h",
        ),
    ] {
        assert_eq!(parameter(id, name, &v), says);
    }
    // Every unit of the table is known.
    for e in EFFECTS {
        for p in e.parameters {
            let q = words::quantity(e.id, p.name, &value(1.0, p.unit, [0.5, 1.5]));
            assert!(
                [
                    "", "%", "‰", "mm", "kPa", "kPa/s", "deg", "deg/min", "mm/min", "g", "N",
                    "N/m", "s", "1/s"
                ]
                .contains(&q.unit.as_str()),
                "{} {}",
                e.id,
                q.unit
            );
        }
    }
}

#[test]
fn effects_are_named_with_their_place() {
    assert_eq!(effect_name("spring-lag", Some(5)), "Spring lag, spring 5");
    assert_eq!(effect_name("creep", None), "Creep, every chamber");
    assert_eq!(effect_name("payload", None), "Undeclared payload");
    assert_eq!(effect_name("gremlin", Some(2)), "gremlin, channel 2");
}

#[test]
fn base64_of_rfc_4648() {
    for (plain, coded) in [
        ("", ""),
        ("f", "Zg=="),
        ("fo", "Zm8="),
        ("foo", "Zm9v"),
        ("foobar", "Zm9vYmFy"),
    ] {
        assert_eq!(base64(plain.as_bytes()), coded);
    }
    assert_eq!(base64(&[0xfb, 0xff, 0xfe]), "+//+");
}

#[test]
fn numbers_read_well() {
    for (x, says) in [
        (0.0, "0"),
        (12.44, "12.4"),
        (812.0, "812"),
        (9.996, "10.0"),
        (-0.031, "−0.0310"),
        (1234.5, "1234"),
        (1e-9, "1.0e−9"),
        (f64::NAN, "–"),
        (f64::INFINITY, "–"),
    ] {
        assert_eq!(number(x), says);
    }
    assert_eq!(with_error(812.3, 41.2), "812 ± 41");
    assert_eq!(with_error(0.4, 1.04), "0.4 ± 1.0");
    assert_eq!(with_error(-6.0, f64::NAN), "−6.00");
    // Never a row of zeros.
    assert_eq!(with_error(3.1e-8, 2.2e-7), "0 ± < 0.001");
    assert_eq!(with_error(-812.3, 4e-9), "−812.300 ± < 0.001");
    assert_eq!(with_error(0.0123, 0.0021), "0.0123 ± 0.0021");
    assert_eq!(number(-2.04e-9), "−2.0e−9");
    assert_eq!(fixed(-0.04, 1), "0.0");
    assert_eq!(at(f64::NAN), "0");
    assert_eq!(at(-0.01), "0");
    assert_eq!(at(12.0), "12");
    assert_eq!(ticks(0.0, 90.0, 8), [0.0, 20.0, 40.0, 60.0, 80.0]);
    assert_eq!(ticks(-1.0, 1.0, 4), [-1.0, -0.5, 0.0, 0.5, 1.0]);
    assert!(ticks(1.0, 1.0, 4).is_empty() && ticks(0.0, f64::NAN, 4).is_empty());
}

/// The guide's table of effects.
fn guide_table() -> String {
    let mut out =
        String::from("| id | name | what it is | sits on | shows in |\n|---|---|---|---|---|\n");
    for e in EFFECTS {
        // The meaning without the equation before it.
        let meaning = match e.doc.split_once(": ") {
            Some((equation, meaning)) if equation.contains(['=', '≤', '→']) => meaning,
            _ => e.doc,
        };
        let on = match e.target {
            Target::Chamber => "chamber",
            Target::Spring => "spring",
            Target::Imu => "IMU",
            Target::Segment => "segment",
            Target::None => "–",
        };
        let shows: Vec<String> = e
            .residuals
            .iter()
            .map(|r| format!("{r:?}").to_lowercase())
            .collect();
        out += &format!(
            "| `{}` | {} | {meaning} | {on} | {} |\n",
            e.id,
            e.name,
            shows.join(", ")
        );
    }
    out
}

#[test]
fn the_guide_has_every_effect_and_verdict() {
    const GUIDE: &str = include_str!("../../../assets/guide/finding-a-gap.md");
    let table = guide_table();
    assert!(
        GUIDE.contains(&table),
        "the guide's table should be\n{table}"
    );
    for verdict in VERDICTS.map(|(v, _)| v) {
        let name = verdict_name(verdict).to_lowercase();
        assert!(GUIDE.contains(&format!("| **{name}**")), "{name}");
    }
    assert!(include_str!("../../../assets/guide/SUMMARY.md").contains("(finding-a-gap.md)"));
}

/// Writes the pages, to be looked at: `REPORT_PAGES=DIR cargo test -- --ignored pages_to_look_at`.
#[test]
#[ignore = "writes files for the eye"]
fn pages_to_look_at() {
    let folder = std::env::var("REPORT_PAGES").expect("REPORT_PAGES names a folder");
    for (verdict, _) in VERDICTS {
        let path = format!("{folder}/{verdict:?}.html");
        std::fs::write(path, html(&finding(verdict), PATCH, Origin::Simulated)).expect("writes");
    }
}
