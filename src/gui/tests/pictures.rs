//! Pictures of every screen.

use super::*;
use crate::signal::{Alarm, AlarmCause, ChannelHealth, Evidence, Severity, TruthSource};

// A session in which some things are abnormal.
pub(super) fn busy_session() -> Vec<Snapshot> {
    let mut session = fixture::session(40);
    let n = session.len();
    for s in session.iter_mut().skip(n / 2) {
        if let Some(f) = &mut s.sensors {
            f.health.springs[8] = ChannelHealth::Stuck;
            f.health.springs[3] = ChannelHealth::Suspect;
        }
    }
    let last = session.last_mut().expect("not empty");
    let goal = Goal::position([0.164, 0.020, -0.231]);
    last.preview = Some((
        goal.clone(),
        fixture::reach(ReachState::Unreachable, goal.position_m),
    ));
    last.alarms = vec![
        Alarm {
            since: last.stamp.plus(-20.0),
            severity: Severity::Warning,
            cause: AlarmCause::Spring {
                spring: 8,
                evidence: Evidence {
                    health: ChannelHealth::Stuck,
                    ..Evidence::default()
                },
            },
        },
        Alarm {
            since: last.stamp.plus(-20.0),
            severity: Severity::Info,
            cause: AlarmCause::Spring {
                spring: 3,
                evidence: Evidence {
                    health: ChannelHealth::Suspect,
                    ..Evidence::default()
                },
            },
        },
    ];
    last.recording = Some("session-3.rrd".into());
    session
}

pub(super) fn picture(name: &str, size: [f32; 2], theme: Theme, app: App) {
    let mut h = Harness::builder()
        .with_size(size)
        .with_theme(theme)
        .with_render_cursor(false)
        .wgpu()
        .build_eframe(|_| app);
    h.run_steps(5);
    let image = h.render().expect("a GPU or a software renderer draws");
    assert_eq!(
        [image.width() as f32, image.height() as f32],
        size,
        "{name}"
    );
    save(name, &image);
    assert_drawn(&h, &image, name);
}

/// The texts in a shape.
pub(super) fn texts<'a>(shape: &'a egui::Shape, found: &mut Vec<&'a egui::epaint::TextShape>) {
    match shape {
        egui::Shape::Text(text) => found.push(text),
        egui::Shape::Vec(shapes) => shapes.iter().for_each(|s| texts(s, found)),
        _ => {}
    }
}

/// Least difference between a text and what is behind it, of 255.
const CONTRAST: u8 = 30;

/// What was laid out is seen in the picture: of the texts that are whole within the window, nine tenths differ in their
/// place from what is behind them. The others may be covered, or pale because their control is off.
pub(super) fn assert_drawn(h: &Harness<'_, App>, image: &image::RgbaImage, name: &str) {
    let scale = h.ctx.pixels_per_point();
    let window = h.ctx.viewport_rect();
    let (mut seen, mut unseen) = (0, Vec::new());
    for clipped in &h.output().shapes {
        let mut found = Vec::new();
        texts(&clipped.shape, &mut found);
        for text in found {
            let place = text.visual_bounding_rect();
            let is_whole = clipped.clip_rect.contains_rect(place) && window.contains_rect(place);
            if text.galley.text().trim().is_empty() || !is_whole {
                continue;
            }
            let [low, high] = [place.min, place.max].map(|p| (p * scale).to_vec2());
            let columns = low.x as u32..(high.x.ceil() as u32).min(image.width());
            let pixels = (low.y as u32..(high.y.ceil() as u32).min(image.height()))
                .flat_map(|y| columns.clone().map(move |x| (x, y)));
            let (mut least, mut most) = ([255; 3], [0; 3]);
            for (x, y) in pixels {
                for (k, value) in image.get_pixel(x, y).0[..3].iter().enumerate() {
                    least[k] = least[k].min(*value);
                    most[k] = most[k].max(*value);
                }
            }
            match (0..3).any(|k| most[k].saturating_sub(least[k]) >= CONTRAST) {
                true => seen += 1,
                false => unseen.push(format!("{:?} at {place:?}", text.galley.text())),
            }
        }
    }
    assert!(
        seen > 10 && seen > 9 * unseen.len(),
        "{name}: {seen} texts are seen, not so {unseen:#?}"
    );
}

pub(super) fn save(name: &str, image: &image::RgbaImage) {
    let dir = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("target/pictures");
    std::fs::create_dir_all(&dir).expect("the target directory can be written");
    image
        .save(dir.join(format!("{name}.png")))
        .expect("the picture can be written");
}

// 2560 by 1440 pixels, two to a point.
pub(super) fn sharp_picture(name: &str, theme: Theme, app: App) {
    let mut h = Harness::builder()
        .with_size([1280.0, 720.0])
        .with_pixels_per_point(2.0)
        .with_theme(theme)
        .with_render_cursor(false)
        .wgpu()
        .build_eframe(|_| app);
    h.run_steps(5);
    let image = h.render().expect("a GPU or a software renderer draws");
    assert_eq!([image.width(), image.height()], [2560, 1440], "{name}");
    save(name, &image);
    assert_drawn(&h, &image, name);
}

#[test]
fn every_screen_renders_in_both_themes_and_sizes() {
    let session = busy_session();
    for (theme, theme_name) in [(Theme::Dark, "dark"), (Theme::Light, "light")] {
        for (size, size_name) in [([1280.0, 720.0], "720"), ([1920.0, 1080.0], "1080")] {
            for screen in ScreenId::ALL {
                let spec = RobotSpec::reference();
                let mut app = App::for_screenshot(screen, theme, spec, &session);
                app.screens.operate.draft.text = ["164", "20", "-231"].map(Into::into);
                if screen == ScreenId::Sensors && theme == Theme::Light {
                    app.selected_spring = Some(8);
                }
                if screen == ScreenId::Recordings {
                    app = recordings_app();
                    app.screen = screen;
                    let mut player =
                        Player::new(fixture::trace("circle-35g", 40)).expect("not empty");
                    player.position_s = 23.0;
                    player.playing = false;
                    app.player = Some(player);
                    app.screens.library.selected = Some("recordings/circle-35g.rrd".into());
                }
                let name = format!("panels-{}-{theme_name}-{size_name}", screen.name());
                picture(&name.to_lowercase(), size, theme, app);
            }
        }
    }
    let mut safe = fixture::session(20);
    let last = safe.last_mut().expect("not empty");
    last.mode = Mode::Safe("over-pressure in chamber 3 (42.6 kPa). Vent it, then reset.".into());
    last.truth = None;
    last.link.simulated = false;
    last.link.board_simulated = [Some(false); crate::signal::BOARDS];
    let spec = RobotSpec::reference();
    let app = App::for_screenshot(ScreenId::Operate, Theme::Dark, spec, &safe);
    picture("panels-safe", [1280.0, 720.0], Theme::Dark, app);
    assert_eq!(
        fixture::snapshot(0.0).truth.map(|t| t.source),
        Some(TruthSource::VirtualRig)
    );
}
