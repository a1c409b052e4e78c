//! Findings of every verdict, in words and in pictures.

use super::*;
use crate::gap::{Finding, Located};
use crate::gui::tests::pictures::texts;
use crate::sim::effects::term;

// The real finding with another verdict: what the screen makes of it.
pub(in crate::gui::tests) fn with_verdict(verdict: Verdict) -> Arc<Found> {
    let real = found(&Unwatched).expect("found");
    let mut finding: Finding = real.finding.clone();
    let mut patch: Patch = real.patch.clone();
    finding.verdict = verdict;
    match verdict {
        Verdict::Named => {}
        Verdict::Indistinguishable => {
            let mut other = finding.effects[0].clone();
            other.id = "tip-force".into();
            other.instead_of = Some(0);
            other.params = [(
                "z".to_owned(),
                crate::gap::PatchValue {
                    value: -2.4,
                    unit: "N".into(),
                    ci95: Some([-2.9, -1.9]),
                },
            )]
            .into();
            finding.effects.push(other);
            finding.separate_by = Some(crate::gap::SeparateBy {
                excitation: "loads".into(),
                effects: vec!["payload".into(), "tip-force".into()],
                why: "under 'loads' they would be 80 nats apart, against 3 here".into(),
            });
        }
        Verdict::Unknown | Verdict::NothingMissing | Verdict::NotExcited => {
            finding.effects.clear();
            patch.effects.clear();
            finding.gap.closed = 0.0;
            finding.traces.after = finding.traces.before.clone();
        }
    }
    if verdict == Verdict::Unknown {
        finding.located.insert(
            0,
            Located {
                residual: "r1".into(),
                channel: "p3".into(),
                regressor: "pressure rate".into(),
                share: 0.7,
            },
        );
        finding
            .notes
            .push("The best effect of the table closes only 31 % of the excess.".into());
    }
    Arc::new(Found {
        finding,
        patch,
        gain: 0.0,
    })
}

#[test]
fn a_report_that_no_browser_shows_says_where_it_is_in_lines_that_can_be_read() {
    let seen = Rc::new(RefCell::new(Seen::default()));
    let mut services = services(&seen);
    services.gap.open_page = Box::new(|path| {
        assert_eq!(path, Path::new("reports/abc/report.html"));
        Job::ready(Err(
            "The report cannot be shown in a browser: no browser was found.".into(),
        ))
    });
    let mut app = gap_app(services);
    app.screens
        .gap
        .take(with_verdict(Verdict::Named), Origin::Simulated, None);
    app.screens.gap.step = Step::Prove;
    let mut h = harness(app);
    h.run_steps(4);
    click(&mut h, "Open report");
    let mut below = 0.0;
    for part in [
        "no browser was found",
        "It is written all the same: reports/abc/report.html",
        "→ Open it in a browser",
    ] {
        let line = h.get_by_label_contains(part).rect();
        assert!(line.width() > 10.0 * line.height(), "{part}: {line:?}");
        assert!(line.top() > below, "{part} stands below what comes before");
        below = line.top();
    }
    h.get_by_label("Copy path").click();
    let copied = (0..4).any(|_| {
        h.step();
        let commands = &h.output().platform_output.commands;
        commands.iter().any(
            |c| matches!(c, egui::OutputCommand::CopyText(t) if t == "reports/abc/report.html"),
        )
    });
    assert!(copied);
}

#[test]
fn every_verdict_has_its_own_words_and_only_effects_become_patches() {
    let cases = [
        (
            Verdict::NothingMissing,
            "● Nothing missing",
            "No action is needed.",
        ),
        (Verdict::Unknown, "? Unknown", "No patch is offered"),
        (
            Verdict::NotExcited,
            "∅ Not excited",
            "it may be healthy or not",
        ),
        (
            Verdict::Indistinguishable,
            "≈ Indistinguishable",
            "Run the excitation “loads”, which discriminates between Undeclared payload, Tip force",
        ),
    ];
    for (verdict, title, next) in cases {
        let seen = Rc::new(RefCell::new(Seen::default()));
        let mut app = gap_app(services(&seen));
        app.screens
            .gap
            .take(with_verdict(verdict), Origin::Measured, None);
        let mut h = harness(app);
        h.run_steps(4);
        let map = h.get_by_label("Residual heat map").rect();
        assert!(map.height() > 150.0 && map.width() > 300.0, "{map:?}");
        click(&mut h, "Step 3: Explain");
        h.get_by_label(title);
        h.get_by_label_contains(next);
        assert!(h.query_by_label("Reveal what was hidden").is_none());
        assert!(h.query_by_label("simulated").is_none());
        click(&mut h, "Step 4: Patch");
        if verdict != Verdict::Indistinguishable {
            h.get_by_label("No patch is offered");
            assert!(is_disabled(&h, "Accept patch"), "{verdict:?}");
            continue;
        }
        // A person chooses among the alternatives; the patch then holds that one.
        h.get_by_label_contains("This session cannot separate these effects");
        click(&mut h, "Tip force");
        click(&mut h, "Accept patch");
        let text = seen.borrow().robot_file.clone();
        let robot = RobotSpec::from_toml(&text).expect("reads");
        assert_eq!(robot.patches[0].patch.effects[0].id, "tip-force");
        // So does the report, which is written anew for another choice only.
        let report = |h: &mut Harness<'_, App>| {
            click(h, "Step 5: Prove");
            click(h, "Open report");
            click(h, "Open in Rerun");
        };
        report(&mut h);
        assert_eq!(seen.borrow().kept, ["tip-force"]);
        click(&mut h, "Step 4: Patch");
        click(&mut h, "Undeclared payload");
        report(&mut h);
        assert_eq!(seen.borrow().kept, ["tip-force", "payload"]);
    }
}

/// The real finding, as if a law explained it.
pub(in crate::gui::tests) fn as_law() -> Arc<Found> {
    let real = found(&Unwatched).expect("found");
    let (mut finding, mut patch) = (real.finding.clone(), real.patch.clone());
    let t = term("tension-constant").expect("in the library");
    let force = crate::gap::PatchValue {
        value: 3.1,
        unit: "N".into(),
        ci95: Some([2.8, 3.4]),
    };
    let e = &mut finding.effects[0];
    (e.id, e.target, e.chosen_by) = (t.effect.id.into(), Some(2), Some(1.0));
    e.params = [("force".to_owned(), force)].into();
    finding.candidates[0].id = t.effect.id.into();
    finding.candidates[0].target = Some(2);
    let law = crate::gap::patch_law(&e.id, e.target, &e.params);
    patch.law.push(law.expect("in the library"));
    patch.effects.clear();
    Arc::new(Found {
        finding,
        patch,
        gain: 0.0,
    })
}

#[test]
fn a_law_is_looked_for_where_the_table_has_no_name_and_becomes_a_patch() {
    let seen = Rc::new(RefCell::new(Seen::default()));
    let mut services = services(&seen);
    services.gap.find = Box::new(|pair, known| {
        assert_eq!(pair.suspect, Path::new(SUSPECT));
        Job::ready(Ok(Ok(match known {
            None => with_verdict(Verdict::Unknown),
            Some(known) => {
                assert_eq!(known.finding.verdict, Verdict::Unknown);
                as_law()
            }
        })))
    });
    let mut h = harness(gap_app(services));
    h.run_steps(4);
    click(&mut h, "Use the example");
    click(&mut h, "▶ Find");
    click(&mut h, "Step 3: Explain");
    h.get_by_label("? Unknown");
    click(&mut h, "Search for a law");
    h.get_by_label("▲ Effect found");
    h.get_by_label_contains("ΔT = c");
    h.get_by_label("Chosen by 100 % of the held-out folds.");
    h.get_by_label_contains("Explained part of");
    click(&mut h, "Back to the effects of the table");
    h.get_by_label("? Unknown");
    click(&mut h, "Back to the law");
    click(&mut h, "Step 4: Patch");
    click(&mut h, "Accept patch");
    let text = seen.borrow().robot_file.clone();
    let robot = RobotSpec::from_toml(&text).expect("reads");
    let law = &robot.patches[0].patch.law[0];
    assert_eq!(
        (law.term.as_str(), law.target),
        ("tension-constant", Some(2))
    );
    h.get_by_label("1. Constant tension, chamber 2");
}

#[test]
fn where_nothing_was_captured_no_place_is_invented() {
    let real = with_verdict(Verdict::Named);
    let mut finding = real.finding.clone();
    let t = &mut finding.traces;
    t.measured_m.fill([f64::NAN; 3]);
    t.turns[0].fill([f64::NAN; 4]);
    let patch = real.patch.clone();
    let mut app = gap_app(Services::none());
    let found = Arc::new(Found {
        finding,
        patch,
        gain: 0.0,
    });
    app.screens.gap.take(found, Origin::Measured, None);
    let mut h = harness(app);
    h.run_steps(4);
    h.get_by_label_contains("measured unknown: no motion capture at this instant");
    assert!(h.query_by_label_contains("NaN").is_none());
    click(&mut h, "Step 5: Prove");
    h.get_by_label_contains("No motion capture: simulated paths only.");
}

fn shot(
    name: &str,
    size: [f32; 2],
    theme: Theme,
    state: impl FnOnce(&mut App),
    act: impl FnOnce(&mut Harness<'_, App>),
) {
    let seen = Rc::new(RefCell::new(Seen::default()));
    let spec = RobotSpec::reference();
    let mut app = App::for_screenshot(ScreenId::Gap, theme, spec, &fixture::session(4));
    app.services = services(&seen);
    state(&mut app);
    let mut h = Harness::builder()
        .with_size(size)
        .with_theme(theme)
        .with_render_cursor(false)
        .wgpu()
        .build_eframe(|_| app);
    h.run_steps(5);
    act(&mut h);
    h.remove_cursor();
    h.run_steps(3);
    let image = h.render().expect("a GPU or a software renderer draws");
    save(&name.to_lowercase(), &image);
    assert_drawn(&h, &image, name);
}

/// What begins within the session is marked on every time axis.
#[test]
fn a_beginning_is_marked_over_the_residuals_and_the_paths() {
    let real = with_verdict(Verdict::Named);
    let mut finding = real.finding.clone();
    let [from, to] = [0, 1].map(|end| {
        let t_s = &finding.traces.t_s;
        [t_s[0], t_s[t_s.len() - 1]][end]
    });
    let at = |share: f64| from + share * (to - from);
    finding.onset = Some(crate::gap::Onset {
        t_s: at(0.41),
        ci95: [at(0.40), at(0.42)],
    });
    let found = Arc::new(Found {
        finding,
        patch: real.patch.clone(),
        gain: 0.0,
    });
    let sizes = [
        ([1024.0, 700.0], "small"),
        ([1280.0, 760.0], "760"),
        ([2560.0, 1440.0], "1440"),
    ];
    for (size, name) in sizes {
        for step in [Step::Locate, Step::Prove] {
            let state = |app: &mut App| {
                app.screens
                    .gap
                    .take(Arc::clone(&found), Origin::Simulated, None);
                app.screens.gap.step = step;
            };
            let name = format!("gap-begins-{}-{name}", step.name());
            let mut written = 0;
            shot(&name, size, Theme::Dark, state, |h| {
                written = times_painted(h, "begins")
            });
            // The map, or each of the three paths.
            let wanted = if step == Step::Locate { 2 } else { 3 };
            assert_eq!(written, wanted, "{name}");
        }
    }
}

/// How often a text is painted.
fn times_painted(h: &Harness<'_, App>, text: &str) -> usize {
    let mut found = Vec::new();
    for clipped in &h.output().shapes {
        texts(&clipped.shape, &mut found);
    }
    let same = found.iter().filter(|t| t.galley.text().trim() == text);
    same.count()
}

#[test]
fn pictures_of_every_step() {
    let sizes = [([1280.0, 720.0], "720"), ([1920.0, 1080.0], "1080")];
    for (theme, theme_name) in [(Theme::Dark, "dark"), (Theme::Light, "light")] {
        for (size, size_name) in sizes {
            for step in Step::ALL {
                let name = format!("gap-{}-{theme_name}-{size_name}", step.name());
                let state = |app: &mut App| {
                    if step != Step::Select {
                        let found = found(&Unwatched).expect("found");
                        app.screens
                            .gap
                            .take(found, Origin::Simulated, Some(ANSWER.into()));
                        app.screens.gap.step = step;
                    }
                };
                shot(&name, size, theme, state, |h| match step {
                    Step::Select => click(h, "Use the example"),
                    Step::Locate => click(h, "Residual heat map"),
                    Step::Explain => click(h, "Reveal what was hidden"),
                    Step::Patch if theme == Theme::Dark => click(h, "Accept patch"),
                    _ => {}
                });
            }
        }
    }
    let small = [1280.0, 720.0];
    for verdict in [Verdict::Unknown, Verdict::Indistinguishable] {
        for step in [Step::Locate, Step::Explain, Step::Patch, Step::Prove] {
            let name = format!("gap-{verdict:?}-{}", step.name());
            let state = |app: &mut App| {
                app.screens
                    .gap
                    .take(with_verdict(verdict), Origin::Measured, None);
                app.screens.gap.step = step;
            };
            shot(&name, small, Theme::Light, state, |_| {});
        }
    }
    let law = |app: &mut App| {
        app.screens.gap.take(as_law(), Origin::Simulated, None);
        app.screens.gap.step = Step::Explain;
    };
    for (size, name) in [
        ([1024.0, 700.0], "small"),
        (small, "720"),
        ([2560.0, 1440.0], "1440"),
    ] {
        shot(&format!("gap-law-{name}"), size, Theme::Dark, law, |_| {});
    }
    shot("gap-empty", small, Theme::Dark, |_| {}, |_| {});
    let running = |app: &mut App| {
        app.services.gap.find = Box::new(|_, _| {
            let (job, worker) = Job::pair();
            worker.tell(Stage::Explain.name(), Some(0.5));
            // The work goes on for as long as the picture takes.
            std::mem::forget(worker);
            job
        });
    };
    shot("gap-running", small, Theme::Dark, running, |h| {
        click(h, "Use the example");
        click(h, "▶ Find");
    });
    let other = |app: &mut App| {
        app.services.gap.look = Box::new(|path| {
            let robot = RobotMatch::Other {
                recorded: "0badf00d".into(),
                given: "65c2e891".into(),
            };
            Job::ready(Ok(SessionSheet {
                robot,
                ..sheet(path)
            }))
        });
    };
    shot("gap-other-robot", small, Theme::Light, other, |h| {
        click(h, "Use circle-35g as suspect session");
    });
}
