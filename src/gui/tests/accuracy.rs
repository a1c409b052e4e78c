//! The Accuracy screen: peaks, occlusions, bins, exports.

use super::*;
use crate::gui::panels::accuracy::{Below, Plots, Scope};
use crate::gui::services::{Existing, Picked, Worker};

/// Files that the window wrote.
type Written = Arc<Mutex<Vec<(PathBuf, Vec<u8>)>>>;

// Errors stand out at 110 s and at 130 s, and Vicon is away from 115 s to 117 s.
pub(super) fn session() -> Vec<Snapshot> {
    let mut session = fixture::session(40);
    for s in &mut session {
        let t = s.stamp.seconds();
        let estimate = s.estimate.as_mut().expect("has an estimate");
        for (peak, mm) in [(110.0, 9.0), (130.0, 12.0)] {
            let u: f64 = (t - peak) / 0.1;
            estimate.base_from_tip.translation.vector.x += 1e-3 * mm * (-u * u).exp();
        }
        if (115.0..117.0).contains(&t) {
            s.truth = None;
        }
    }
    session
}

fn app(session: &[Snapshot], theme: Theme) -> App {
    App::for_screenshot(ScreenId::Accuracy, theme, RobotSpec::reference(), session)
}

fn writing(app: &mut App) -> Written {
    let written = Written::default();
    let to = Arc::clone(&written);
    app.services.write = Box::new(move |path, _, content| {
        to.lock()
            .expect("not poisoned")
            .push((path.to_owned(), content().expect("bytes")));
        Job::ready(Ok(path.to_owned()))
    });
    written
}

fn peak_s(h: &Harness<'_, App>) -> f64 {
    h.state().screens.accuracy.peak.map_or(f64::NAN, |p| p[0])
}

#[test]
fn brackets_go_from_peak_to_peak_and_the_window_follows() {
    let mut h = harness(app(&session(), Theme::Dark));
    h.run();
    for _ in 0..40 {
        h.key_press(Key::CloseBracket);
        h.run();
        if (peak_s(&h) - 130.0).abs() < 0.1 {
            break;
        }
    }
    assert!((peak_s(&h) - 130.0).abs() < 0.1, "{}", peak_s(&h));
    assert!(h.state().screens.accuracy.peak.is_some_and(|p| p[1] > 9.0));
    let [from, to] = h.state().window.range_s(140.0);
    assert!(from < 130.0 && 130.0 < to);
    h.get_by_label_contains(" mm at 2:10 (130.");
    // The largest of all is at 130 s: those before it come with [, down to 110 s.
    for _ in 0..40 {
        h.key_press(Key::OpenBracket);
        h.run();
        if (peak_s(&h) - 110.0).abs() < 0.1 {
            break;
        }
    }
    assert!((peak_s(&h) - 110.0).abs() < 0.1, "{}", peak_s(&h));
    let at = peak_s(&h);
    press(&mut h, "Next peak");
    assert!(peak_s(&h) > at);
    press(&mut h, "Previous peak");
    assert_eq!(peak_s(&h), at);
}

#[test]
fn the_scores_of_one_recording_are_never_shown_for_another() {
    let player = |name: &str, off_m: f64| {
        let mut trace = fixture::trace(name, 20);
        for s in &mut trace.snapshots {
            let estimate = s.estimate.as_mut().expect("has an estimate");
            estimate.base_from_tip.translation.vector.x += off_m;
        }
        let mut p = Player::new(trace).expect("not empty");
        p.playing = false;
        p.position_s = 15.0;
        p
    };
    let mut app = app(&[], Theme::Dark);
    let written = writing(&mut app);
    app.services.pick = Box::new(|dialog| Job::ready(Ok(Picked::Path(dialog.name.into()))));
    app.player = Some(player("good", 0.0));
    let mut h = harness(app);
    h.run_steps(3);
    h.state_mut().player = Some(player("bad", 0.05));
    h.run_steps(3);
    h.get_by_label("CSV").click();
    h.run_steps(2);
    h.get_by_label("Browse…").click();
    h.run_steps(4);
    let written = written.lock().expect("not poisoned");
    let (path, bytes) = &written[0];
    assert!(path.display().to_string().contains("bad"), "{path:?}");
    let table = String::from_utf8(bytes.clone()).expect("text");
    let x: f64 = {
        let row = table.lines().nth(50).expect("rows");
        row.split(',').nth(1).expect("x").parse().expect("a number")
    };
    assert!(x > 40.0, "scores of the other recording: {x} mm");
}

#[test]
fn only_vicon_poses_of_the_scored_scope_count_as_left_out() {
    let mut session = fixture::session(60);
    // No estimates in the first ten seconds.
    for s in &mut session {
        if s.stamp.seconds() < 110.0 {
            s.estimate = None;
        }
    }
    let mut h = harness(app(&session, Theme::Dark));
    h.run_steps(3);
    h.get_by_label_contains(" 0 Vicon poses without an estimate");
    press(&mut h, "All");
    assert!(
        h.query_by_label_contains(" 0 Vicon poses without an estimate")
            .is_none()
    );
}

#[test]
fn occlusions_are_left_out_counted_and_shown_in_both_kinds_of_plots() {
    let mut h = harness(app(&session(), Theme::Dark));
    h.run();
    h.get_by_label_contains("Left out: 1 occlusions (2.0 s)");
    control(&h, "x error / mm");
    press(&mut h, "Overlay");
    control(&h, "x / mm");
    assert_eq!(h.query_all_by_label("x error / mm").count(), 0);
    press(&mut h, "In space");
    let view = h.get_by_label("Error vectors in space").rect();
    let before = h.state().screens.accuracy.camera();
    h.drag_at(view.center());
    h.run();
    h.hover_at(view.center() + egui::vec2(60.0, 20.0));
    h.run();
    h.drop_at(view.center() + egui::vec2(60.0, 20.0));
    h.run();
    let turned = h.state().screens.accuracy.camera();
    assert!(
        before.is_some() && before != turned,
        "a drag turns the view"
    );
    press(&mut h, "3/4 view");
    assert_eq!(h.state().screens.accuracy.camera(), before);
    press(&mut h, "By bins");
    press(&mut h, "Speed");
    h.get_by_label("speed / mm/s");
    press(&mut h, "Frames");
    h.get_by_label_contains("no transform, no offset");
    h.get_by_label_contains("Clock of segment 1: session time is board time − 3.100 s");
}

#[test]
fn the_table_that_is_written_holds_as_many_rows_as_are_shown() {
    let mut app = app(&session(), Theme::Dark);
    let written = writing(&mut app);
    let mut h = harness(app);
    h.run();
    for all in [false, true] {
        if all {
            press(&mut h, "All");
        }
        press(&mut h, "CSV");
        // The path can be typed; there is no dialog.
        h.get_by_label("Path to write");
        press(&mut h, "Write");
        h.run();
        let (path, bytes) = written
            .lock()
            .expect("not poisoned")
            .pop()
            .expect("written");
        assert_eq!(path, PathBuf::from("exports/accuracy-live-simulated.csv"));
        let text = String::from_utf8(bytes).expect("text");
        let rows: Vec<Vec<f64>> = text
            .lines()
            .skip(1)
            .map(|l| {
                let cells: Vec<&str> = l.split(',').collect();
                assert_eq!(cells.last(), Some(&"simulated"));
                cells[..9]
                    .iter()
                    .map(|c| c.parse().expect("a number"))
                    .collect()
            })
            .collect();
        let shown = rows.len().to_string();
        assert_eq!(h.get_all_by_label(&shown).count(), 8, "n of all eight rows");
        assert!(rows.windows(2).all(|w| w[0][0] < w[1][0]));
        let span = rows[rows.len() - 1][0] - rows[0][0];
        assert!(if all { span > 39.0 } else { span < 30.1 }, "{span}");
        // The length of the translation error is that of its parts.
        for r in &rows {
            let length = (1..4).map(|k| r[k] * r[k]).sum::<f64>().sqrt();
            assert!((length - r[7]).abs() < 2e-4, "{r:?}");
        }
        h.get_by_label(&format!(
            "Wrote {shown} rows to exports/accuracy-live-simulated.csv."
        ));
        control(&h, "Copy path").click();
        let copied = (0..4).any(|_| {
            h.step();
            let commands = &h.output().platform_output.commands;
            commands.iter().any(|c| {
                matches!(c, egui::OutputCommand::CopyText(t) if t.ends_with("live-simulated.csv"))
            })
        });
        assert!(copied);
    }
}

#[test]
fn the_report_says_that_the_data_are_simulated_and_a_failure_says_what_to_do() {
    let mut app = app(&session(), Theme::Dark);
    let written = writing(&mut app);
    app.services.pick = Box::new(|dialog| {
        assert_eq!(dialog.name, "accuracy-live-simulated.html");
        Job::ready(Ok(Picked::Path(PathBuf::from("report.html"))))
    });
    let mut h = harness(app);
    h.run();
    press(&mut h, "Report");
    press(&mut h, "Browse…");
    let (path, bytes) = written
        .lock()
        .expect("not poisoned")
        .pop()
        .expect("written");
    assert_eq!(path, PathBuf::from("report.html"));
    let html = String::from_utf8(bytes).expect("text");
    assert!(html.contains("simulated data") && html.contains("1 occlusions (2.0 s)"));
    h.state_mut().services.write = Box::new(|_, _, _| Job::ready(Err("The disk is full.".into())));
    press(&mut h, "Report");
    press(&mut h, "Write");
    h.get_by_label_contains("The disk is full. Nothing was written: choose another place.");
}

#[test]
fn the_picture_shows_this_screen_alone_without_the_controls_that_made_it() {
    let mut app = app(&session(), Theme::Dark);
    let written = writing(&mut app);
    // A window that stands still: nothing else changes between two pictures.
    app.window.frozen_end_s = Some(140.0);
    app.screens.accuracy.scope = Scope::All;
    let mut h = Harness::builder()
        .with_size([1280.0, 720.0])
        .wgpu()
        .build_eframe(|_| app);
    h.run_steps(6);
    h.get_by_label("PNG").click();
    h.run_steps(2);
    h.get_by_label("Write").click();
    h.step();
    // While the picture is taken there is neither button nor spinner, but what the picture is of.
    let (mut frames, mut posed) = (0, 0);
    while written.lock().expect("not poisoned").is_empty() {
        let asked = h.state().screens.accuracy.export.is_posing();
        h.step();
        frames += 1;
        assert!(frames < 10);
        // A picture that was asked for is taken of the next frame.
        if asked && h.state().screens.accuracy.export.is_posing() {
            posed += 1;
            for control in ["CSV", "PNG", "Report", "Write", "Cancel", "Browse…"] {
                assert!(h.query_by_label(control).is_none(), "{control}");
            }
            assert!(h.query_by_label_contains("Taking").is_none());
            h.get_by_label_contains("simulated data, 100.0 to 140.0 s");
        }
    }
    assert!(posed > 0, "a frame was drawn for the picture");
    h.run_steps(3);
    h.get_by_label("PNG");
    let (_, bytes) = written
        .lock()
        .expect("not poisoned")
        .pop()
        .expect("written");
    let picture = image::load_from_memory(&bytes).expect("a PNG").to_rgba8();
    assert!((1000..1280).contains(&picture.width()) && (500..720).contains(&picture.height()));
    // It is a part of what the window shows: what stands out from its background does so there, too, but for the row that
    // says what it is of.
    let mut counts = std::collections::BTreeMap::new();
    for pixel in picture.pixels() {
        *counts.entry(pixel.0).or_insert(0u32) += 1;
    }
    let background = counts.into_iter().max_by_key(|(_, n)| *n).map(|(c, _)| c);
    let stand_out: Vec<_> = picture
        .enumerate_pixels()
        .filter(|(_, _, pixel)| Some(pixel.0) != background)
        .step_by(29)
        .collect();
    assert!(stand_out.len() > 300, "{} samples", stand_out.len());
    let shown = h.render().expect("draws");
    let right = 0..=shown.width() - picture.width();
    let mut places =
        right.flat_map(|x| (0..=shown.height() - picture.height()).map(move |y| (x, y)));
    let same = |(x, y): (u32, u32)| {
        let same = stand_out
            .iter()
            .filter(|(px, py, pixel)| shown.get_pixel(x + px, y + py) == *pixel);
        10 * same.count() > 6 * stand_out.len()
    };
    assert!(places.any(same), "the window shows something else");
}

#[test]
fn a_file_that_takes_long_to_write_holds_no_frame_up_and_one_that_is_there_is_kept() {
    let mut app = app(&session(), Theme::Dark);
    let workers = Arc::new(Mutex::new(Vec::<(Existing, Worker<PathBuf>)>::new()));
    let to = Arc::clone(&workers);
    app.services.write = Box::new(move |_, existing, _| {
        let (job, worker) = Job::pair();
        to.lock().expect("not poisoned").push((existing, worker));
        job
    });
    let mut h = harness(app);
    h.run_steps(4);
    press(&mut h, "CSV");
    h.get_by_label("Write").click();
    // The disk does not answer; frames go on.
    h.run_steps(20);
    h.get_by_label("Writing…");
    assert!(is_disabled(&h, "CSV") && h.state().busy());
    let (existing, worker) = workers.lock().expect("not poisoned").remove(0);
    assert_eq!(existing, Existing::Kept, "nobody was asked");
    worker.finish(Ok("exports/accuracy-live-simulated-2.csv".into()));
    h.run_steps(3);
    h.get_by_label_contains("rows to exports/accuracy-live-simulated-2.csv.");
    control(&h, "Copy path");
}

#[test]
fn a_press_of_the_key_on_a_long_session_goes_through_a_slice_per_frame() {
    // As many rows as four frames go through; a press and a release are a frame each.
    let mut h = harness(app(&fixture::session(400), Theme::Dark));
    h.run_steps(6);
    assert!(h.state().screens.accuracy.peak.is_none());
    h.key_press(Key::CloseBracket);
    h.step();
    assert!(h.state().screens.accuracy.peak.is_none(), "not all at once");
    h.run_steps(6);
    assert!(h.state().screens.accuracy.peak.is_some());
}

#[test]
fn without_vicon_there_is_nothing_to_write() {
    let mut session = session();
    session.iter_mut().for_each(|s| s.truth = None);
    let mut h = harness(app(&session, Theme::Dark));
    h.run();
    h.get_by_label("Prediction only");
    assert!(h.query_by_label("CSV").is_none() && h.query_by_label("Next peak").is_none());
}

#[test]
fn accuracy_looks_right() {
    let session = session();
    for (theme, name) in [(Theme::Dark, "dark"), (Theme::Light, "light")] {
        for (below, what) in [
            (Below::Time, "time"),
            (Below::Space, "space"),
            (Below::Bins, "bins"),
            (Below::Frames, "frames"),
        ] {
            let mut app = app(&session, theme);
            app.screens.accuracy.below = below;
            app.screens.accuracy.scope = Scope::All;
            if below != Below::Time {
                app.screens.accuracy.plots = Plots::Overlay;
            }
            picture(
                &format!("accuracy-{what}-{name}"),
                [1280.0, 720.0],
                theme,
                app,
            );
        }
        let mut app = app(&session, theme);
        app.screens.accuracy.below = Below::Space;
        sharp_picture(&format!("accuracy-space-{name}-2x"), theme, app);
    }
    picture(
        "accuracy-empty",
        [1280.0, 720.0],
        Theme::Dark,
        app(&[], Theme::Dark),
    );
    let mut lost = session.clone();
    let last = lost.last_mut().expect("not empty");
    last.link.connected = false;
    last.link.age_s = 3.2;
    picture(
        "accuracy-disconnected",
        [1280.0, 720.0],
        Theme::Light,
        app(&lost, Theme::Light),
    );
    lost.iter_mut().for_each(|s| s.truth = None);
    picture(
        "accuracy-prediction",
        [1280.0, 720.0],
        Theme::Dark,
        app(&lost, Theme::Dark),
    );
}
