//! The finder drives the arm with the window: it asks, it is recorded, and STOP and HOLD end it.

use super::*;
use crate::analysis::history::Channel;
use crate::gui::tests::conduct::{Asking, closed, connected, finished, plans};
use crate::gui::theme::Palette;
use crate::task::{Leg, Programme};

/// Where the first excitation is recorded.
const FIRST: &str = "data/experiments/1/round-1.rrd";

/// The finder's end of an experiment.
type Finder = Asking<Result<Arc<Found>, GapError>>;

fn want(finder: &Finder, name: &str) {
    let why = format!("'{name}' for 30 s: separates them");
    finder.want(name, 30.0, &why, FIRST);
}

/// A window on the Gap screen with a kept baseline, and an experiment begun; its finder.
fn begun(moves_hardware: bool) -> (Twin, Harness<'static, App>, Finder) {
    begun_in(harness, moves_hardware)
}

/// The same in a window of one's own.
fn begun_in(
    window: impl FnOnce(App) -> Harness<'static, App>,
    moves_hardware: bool,
) -> (Twin, Harness<'static, App>, Finder) {
    let seen = Rc::new(RefCell::new(Seen::default()));
    let mut services = services(&seen);
    services.gap.baseline = Box::new(|_| Job::ready(Ok(Some(KEPT.into()))));
    let made = Rc::new(RefCell::new(None));
    let make = Rc::clone(&made);
    services.gap.experiment = Box::new(move |baseline, payload_kg| {
        assert_eq!((baseline, payload_kg), (Path::new(KEPT), 0.0));
        let (finder, given) = Finder::new(FIRST);
        *make.borrow_mut() = Some(finder);
        given
    });
    let mut first = connected(1.0, moves_hardware, Mode::Hold);
    first.payload_kg = 0.0;
    let (twin, handle) = twin(first);
    let mut app = App::new(Some(handle), RobotSpec::reference(), services);
    app.screen = ScreenId::Gap;
    let mut h = window(app);
    h.run_steps(6);
    click(&mut h, "Run an experiment");
    let finder = made.borrow_mut().take().expect("an experiment");
    (twin, h, finder)
}

#[test]
fn on_the_virtual_rig_it_drives_and_records_what_the_finder_wants() {
    let (twin, mut h, finder) = begun(false);
    want(&finder, "loads");
    h.run_steps(4);
    let commands = twin.taken();
    let record = Command::StartRecording(FIRST.into());
    assert!(commands.contains(&record), "{commands:?}");
    let [plan] = plans(&commands)[..] else {
        panic!("one plan: {commands:?}");
    };
    assert!(matches!(&plan.legs[..], [Leg::Excite(p)] if p.name == "loads"));
    h.get_by_label_contains("separates them");
    // Another screen may be shown meanwhile.
    h.state_mut().screen = ScreenId::Operate;
    twin.publish(connected(2.0, false, Mode::Moving));
    h.run_steps(2);
    assert!(finder.answers.try_recv().is_err());
    finished(&twin, &mut h, "loads", connected(32.0, false, Mode::AtGoal));
    assert_eq!(twin.taken(), [Command::StopRecording]);
    let text = "Recorded round-1.rrd (3000 snapshots).";
    closed(&twin, &mut h, text, connected(32.1, false, Mode::AtGoal));
    assert_eq!(finder.answers.try_recv(), Ok(Ok(())));
}

#[test]
fn a_hold_ends_it_and_hardware_is_asked_for_every_excitation() {
    let (twin, mut h, finder) = begun(false);
    want(&finder, "steps");
    h.run_steps(4);
    twin.publish(connected(2.0, false, Mode::Moving));
    h.run_steps(2);
    twin.taken();
    twin.publish(connected(3.0, false, Mode::Hold));
    h.run_steps(3);
    assert_eq!(twin.taken(), [Command::StopRecording]);
    assert_eq!(
        finder.answers.try_recv(),
        Ok(Err("The arm was held.".to_owned()))
    );
    finder
        .worker
        .finish(Err("round 1: The arm was held.".to_owned()));
    h.run_steps(4);
    h.get_by_label_contains("ended without a verdict");

    let (twin, mut h, finder) = begun(true);
    want(&finder, "holds");
    h.run_steps(4);
    assert_eq!(plans(&twin.taken()).len(), 0);
    h.get_by_label("▶ Hold to drive it");
    click(&mut h, "Cancel the finder");
    assert!(finder.worker.cancelled());
    assert_eq!(plans(&twin.taken()).len(), 0);
}

#[test]
fn a_click_on_the_disagreement_leads_to_the_finder() {
    let mut s = connected(60.0, false, Mode::Moving);
    s.disagreement = Some(crate::signal::Disagreement {
        t_s: 60.0,
        ratio: 2.5,
        channel: "spring 12".to_owned(),
        since_s: 45.0,
        likely: vec!["undeclared payload".to_owned()],
        muted: vec!["spring lag".to_owned()],
    });
    let (twin, mut h) = running(s.clone());
    assert_ne!(h.state().screen, ScreenId::Gap);
    // Some readings later, so that there is a residual to show.
    s.sensors.as_mut().expect("sensors").stamp = crate::signal::Stamp::from_seconds(60.1);
    s.stamp = crate::signal::Stamp::from_seconds(60.1);
    twin.publish(s);
    h.run_steps(2);
    h.get_by_label("▲ disagrees 2.5").click();
    h.run_steps(4);
    assert_eq!(h.state().screen, ScreenId::Gap);
    assert_eq!(h.state().selected_spring, Some(11));
    h.get_by_label("Residual of spring 12, last 60 s");
    h.get_by_label("Check the last 90 s");
    h.get_by_label_contains("disagree since 15 s ago, most in spring 12. It looks like undeclared");
    // The arm moves: it is not taken over.
    assert!(is_disabled(&h, "Run an experiment"));
    // What is known is muted with a reason, and counts again on request.
    assert!(is_disabled(&h, "Mute undeclared payload"));
    h.get_by_label("Reason to mute it").click();
    h.run_steps(2);
    h.get_by_label("Reason to mute it")
        .type_text("a gripper with a camera");
    h.run_steps(2);
    h.get_by_label("Mute undeclared payload").click();
    h.run_steps(2);
    h.get_by_label("Spring lag is muted: count it again")
        .click();
    h.run_steps(2);
    let orders: Vec<Command> = twin.taken();
    let mute = Command::Mute {
        effect: "undeclared payload".to_owned(),
        reason: "a gripper with a camera".to_owned(),
    };
    assert!(orders.contains(&mute), "{orders:?}");
    assert!(orders.contains(&Command::Unmute("spring lag".to_owned())));
}

/// Lines of this colour in a shape that lie within a place.
fn lines(shape: &egui::Shape, color: egui::Color32, place: egui::Rect) -> usize {
    match shape {
        egui::Shape::Vec(shapes) => shapes.iter().map(|s| lines(s, color, place)).sum(),
        egui::Shape::Path(path) => {
            let drawn = path.stroke.color == egui::epaint::ColorMode::Solid(color);
            let within = path.points.iter().all(|p| place.contains(*p));
            usize::from(drawn && within && path.points.len() > 10)
        }
        _ => 0,
    }
}

/// An excitation in which every chamber has another peak.
fn loads() -> Programme {
    let mut programme = Programme {
        name: "loads".to_owned(),
        seconds: 30.0,
        ..Programme::default()
    };
    for (i, knots) in programme.knots.iter_mut().enumerate() {
        let peak_pa = 1e3 * (i as f64 * 5.0 - 10.0);
        *knots = (0..=60)
            .map(|k| [0.5 * f64::from(k), peak_pa * (0.1 * f64::from(k)).sin()])
            .collect();
    }
    programme
}

/// Hardware is asked: what will be set is drawn before it is driven.
#[test]
fn the_pressures_of_an_excitation_are_drawn_with_their_limits_before_it_is_driven() {
    let (twin, mut h, finder) = begun(true);
    finder.want_programme(loads(), "'loads' for 30 s: separates them", FIRST);
    h.run_steps(6);
    assert_eq!(plans(&twin.taken()).len(), 0, "nothing is driven yet");
    h.get_by_label_contains("Hold to drive it");
    for i in 1..=6 {
        h.get_by_label(&format!("chamber {i}"));
    }
    h.get_by_label_contains("“loads” takes 30 s and sets ");
    let limits = &RobotSpec::reference().pressure;
    let words = format!(
        "the limits are {:.0} and {:.0} kPa",
        1e-3 * limits.min_pa,
        1e-3 * limits.max_pa
    );
    h.get_by_label_contains(&words.replace('-', "−"));
    let place = control(&h, "Pressures that it sets / kPa (dashed: limits)").rect();
    let palette = Palette::of(Theme::Dark);
    for i in 0..6 {
        let color = palette.signal(Channel::ChamberSet(i));
        let shapes = &h.output().shapes;
        let drawn: usize = shapes.iter().map(|s| lines(&s.shape, color, place)).sum();
        assert_eq!(drawn, 1, "chamber {}", i + 1);
    }
}

/// Plot, words and the consent below them are whole in small and large windows.
#[test]
fn the_preview_of_an_excitation_leaves_its_consent_in_sight() {
    for [width, height] in [[1024.0, 700.0], [1280.0, 760.0], [2560.0, 1440.0]] {
        let window = |app| {
            Harness::builder()
                .with_size([width, height])
                .with_render_cursor(false)
                .wgpu()
                .build_eframe(|_| app)
        };
        let (_twin, mut h, finder) = begun_in(window, true);
        finder.want_programme(loads(), "'loads' for 30 s: separates them", FIRST);
        h.run_steps(6);
        let name = format!("gap-experiment-{width}x{height}");
        let image = h.render().expect("a GPU or a software renderer draws");
        save(&name, &image);
        assert_drawn(&h, &image, &name);
        let window = egui::Rect::from_min_size(egui::Pos2::ZERO, egui::vec2(width, height));
        let plot = control(&h, "Pressures that it sets / kPa (dashed: limits)").rect();
        let consent = h.get_by_label("▶ Hold to drive it").rect();
        assert!(window.contains_rect(plot) && window.contains_rect(consent));
        assert!(
            !plot.intersects(consent) && plot.height() > 60.0,
            "{plot:?}"
        );
    }
}
