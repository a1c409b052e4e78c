//! The wizard, driven as an operator would, beside a real twin on the virtual rig in simulated time.

mod troubles;

use std::sync::atomic::{AtomicBool, Ordering};

use super::*;
use crate::calibrate::imus::Phase;
use crate::calibrate::{
    BenchRequest, Comparison, DRAFT, Kept, NewVersion, Question, Step, Version, Wizard, bench, same,
};
use crate::control::Gains;
use crate::gui::services::Picked;
use crate::gui::services::calibrate::CalibrationServices;
use crate::link::wire::Config;
use crate::rig::faults::{Fault, Place, Word};
use crate::rig::{RigOptions, Unit, VirtualRig};
use crate::sensing::bench::BenchLog;
use crate::sensing::{Calibration, Sensing};
use crate::signal::ControllerKind;
use crate::twin::{Heard, InProcess, Maps, Runner};

mod learn;
mod notices;

/// The virtual rig behind a line that can be cut.
fn line(mut rig: VirtualRig, config: Config, cut: Arc<AtomicBool>) -> InProcess {
    let far_end = move |t_s: f64, to_rig: &[u8]| {
        let is_cut = cut.load(Ordering::Relaxed);
        match is_cut {
            true => rig.faults.begin(Place::Port, Fault::of(Word::Off)),
            false => rig.faults.end(Place::Port),
        }
        let bytes = rig.advance(t_s, to_rig);
        Heard {
            bytes: (!is_cut).then_some(bytes),
            truth: rig.mocap_sample(t_s),
        }
    };
    InProcess::new("virtual rig", config, Box::new(far_end))
}

fn maps() -> Maps {
    let bytes = include_bytes!("../../../assets/networks/unit-1/reference.safetensors");
    crate::learn::Model::from_bytes(bytes)
        .expect("the shipped networks load")
        .into()
}

fn drawn(request: &BenchRequest) -> BenchLog {
    bench::draw(&RobotSpec::reference(), Unit::default(), request).expect("the bench draws")
}

fn compared(q: &Question) -> Comparison {
    let (robot, maps) = (RobotSpec::reference(), maps());
    q.answer(&robot, &maps, &mut |_, _| true)
        .expect("nobody stops it")
}

pub(super) type Shelf = Arc<Mutex<Vec<Version>>>;

fn put(shelf: &Shelf, new: NewVersion) -> Vec<Version> {
    let mut list = shelf.lock().expect("not poisoned");
    for v in list.iter_mut() {
        v.active = false;
    }
    let number = list.len() as u32 + 1;
    list.insert(
        0,
        Version {
            number,
            date: "2026-03-01".into(),
            note: new.note,
            active: true,
            kept: Ok(Kept {
                calibration: Arc::new(new.calibration),
                registration: new.registration,
                networks: new.networks.map(|_| "0a".repeat(32)),
            }),
        },
    );
    list.clone()
}

/// The screen Calibrate, just opened.
fn opened(handle: Handle, outside: Services) -> Harness<'static, App> {
    let mut app = App::new(Some(handle), RobotSpec::reference(), outside);
    app.screen = ScreenId::Calibrate;
    let mut h = harness(app);
    h.run_steps(3);
    h
}

pub(super) fn services(shelf: &Shelf) -> Services {
    let (list, save, activate) = (shelf.clone(), shelf.clone(), shelf.clone());
    Services {
        calibration: CalibrationServices {
            in_use: Arc::new(Calibration::virtual_rig()),
            bench: Some(Box::new(|r| Job::ready(Ok(drawn(&r))))),
            compare: Box::new(|q| Job::ready(Ok(compared(&q)))),
            versions: Box::new(move || Job::ready(Ok(list.lock().expect("not poisoned").clone()))),
            save: Box::new(move |new| Job::ready(Ok(put(&save, new)))),
            activate: Box::new(move |number| {
                let mut list = activate.lock().expect("not poisoned");
                for v in list.iter_mut() {
                    v.active = v.number == number;
                }
                Job::ready(Ok(list.clone()))
            }),
            ..CalibrationServices::none()
        },
        ..Services::none()
    }
}

/// A twin on the virtual rig, its line, and the window.
struct Bench {
    runner: Runner,
    ticks: u64,
    cut: Arc<AtomicBool>,
    window: super::Twin,
    shelf: Shelf,
    h: Harness<'static, App>,
}

impl Bench {
    fn new(shelf: Shelf) -> Self {
        let robot = RobotSpec::reference();
        let sensing = Sensing::new(&robot, Calibration::virtual_rig());
        let twin = crate::twin::Twin::new(
            &robot,
            maps(),
            sensing,
            Gains::of(ControllerKind::NullSpaceQp),
        );
        let cut = Arc::new(AtomicBool::new(false));
        let config = Config::new(&robot.pressure, robot.over_pressure_pa);
        let rig = VirtualRig::new(&robot, &RigOptions::default()).expect("settles");
        let line = line(rig, config, Arc::clone(&cut));
        let (command_tx, commands) = sync_channel(64);
        let (events, event_rx) = sync_channel(256);
        let (feed, feed_rx) = sync_channel(256);
        let latest = Arc::new(Mutex::new(Arc::new(Snapshot::default())));
        let window = super::Twin {
            commands,
            events,
            feed,
            latest: Arc::clone(&latest),
        };
        let handle = Handle {
            commands: command_tx,
            events: event_rx,
            feed: feed_rx,
            latest,
            stop_line: StopLine::default(),
            pictures: Pictures::default(),
        };
        let mut app = App::new(Some(handle), robot.clone(), services(&shelf));
        app.screen = ScreenId::Calibrate;
        let h = Harness::builder()
            .with_size([1280.0, 720.0])
            .with_theme(Theme::Dark)
            .with_render_cursor(false)
            .wgpu()
            .build_eframe(|_| app);
        let mut bench = Self {
            runner: Runner::new(twin, Box::new(line), &robot),
            ticks: 0,
            cut,
            window,
            shelf,
            h,
        };
        bench.runner.draw_shapes();
        bench.pass(2.0);
        bench
    }

    /// Lets `seconds` pass on the rig; the window sees every snapshot.
    fn pass(&mut self, seconds: f64) {
        let end = self.ticks + (seconds / 0.01).round() as u64;
        while self.ticks < end {
            for _ in 0..25 {
                let now = Stamp::from_seconds(self.ticks as f64 * 0.01);
                let commands = self.window.taken();
                let (snapshot, events) = self.runner.tick(now, &commands);
                self.ticks += 1;
                *self.window.latest.lock().expect("not poisoned") = Arc::clone(&snapshot);
                self.window.feed.try_send(snapshot).expect("room");
                for event in events {
                    self.window.events.try_send(event).expect("room");
                }
            }
            self.h.step();
        }
        self.h.run_steps(2);
    }

    fn press(&mut self, label: &str) {
        self.h.get_by_label(label).click();
        self.h.run_steps(3);
    }

    fn wizard(&self) -> &Wizard {
        self.h.state().screens.calibrate.wizard().expect("is shown")
    }

    fn until(&mut self, what: &str, most_s: f64, done: impl Fn(&Wizard) -> bool) {
        let start = self.ticks;
        while !done(self.wizard()) {
            let waited_s = (self.ticks - start) as f64 * 0.01;
            let now = self.runner.twin.snapshot();
            assert!(
                waited_s < most_s,
                "{what}: not after {most_s} s; {:?}, {:?}, {:?}",
                now.mode,
                now.alarms,
                now.routine
            );
            self.pass(1.0);
        }
        println!("{what}: {:.0} s", (self.ticks - start) as f64 * 0.01);
    }

    /// Pictures of the window in both themes, at 1280 × 720 and at twice the pixels.
    fn shoot(&mut self, name: &str) {
        let dir = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("target/pictures");
        std::fs::create_dir_all(&dir).expect("the target directory can be written");
        for (theme, theme_name) in [(Theme::Dark, "dark"), (Theme::Light, "light")] {
            for scale in [1.0, 2.0] {
                self.h.ctx.set_theme(theme);
                self.h.set_pixels_per_point(scale);
                self.h.remove_cursor();
                self.h.run_steps(1);
                self.h.set_size([1280.0, 720.0].into());
                self.h.run_steps(3);
                let image = self.h.render().expect("a renderer draws");
                assert_eq!(image.width(), (1280.0 * scale) as u32);
                let file = format!("calibrate-{name}-{theme_name}-{scale}x.png");
                image.save(dir.join(file)).expect("can be written");
            }
        }
        self.h.ctx.set_theme(Theme::Dark);
        self.h.set_pixels_per_point(1.0);
        self.h.run_steps(1);
        self.h.set_size([1280.0, 720.0].into());
        self.h.run_steps(2);
    }
}

fn spring_points(w: &Wizard) -> Vec<usize> {
    w.springs.springs.iter().map(|t| t.points().len()).collect()
}

#[test]
fn a_full_calibration_with_one_spring_redone_is_saved_and_used() {
    let mut b = Bench::new(Shelf::default());
    b.h.get_by_label_contains("All checks passed (simulated)");
    b.h.get_by_label("The seven steps");
    b.h.get_by_label_contains("Takes 4 s of rest");
    b.shoot("1-preflight");
    b.press("Next ▶");

    // The loose plug is refused, and only that spring is drawn again.
    b.press("▶ Draw all twelve springs");
    b.h.get_by_label_contains("Spring 7: the curve misses held-out points");
    assert!(is_disabled(&b.h, "Next ▶"));
    assert_eq!(b.wizard().springs_to_do(), [7]);
    // The refused one is shown with a residual for each of its points; another one when it is chosen.
    let residuals = |b: &Bench, i: usize| {
        let points = b.wizard().springs.springs[i].points().len();
        assert!(points > 20, "{points}");
        format!(
            "Residuals of spring {}: {points} points, PASS limit ± 0.40 mm",
            i + 1
        )
    };
    b.h.get_by_label(&residuals(&b, 6));
    b.shoot("2-springs-redo");
    b.press("Show the curve of spring 3");
    b.h.get_by_label(&residuals(&b, 2));
    b.press("Show the curve of spring 7");
    let before: Vec<_> = b.wizard().springs.springs.to_vec();
    b.press("Redo spring 7");
    assert_eq!(b.wizard().springs_to_do(), [] as [usize; 0]);
    for (i, old) in before.iter().enumerate() {
        let now = &b.wizard().springs.springs[i];
        assert_eq!(now.points() == old.points(), i != 6, "spring {}", i + 1);
        assert_eq!(now.redone, u32::from(i == 6));
    }
    b.shoot("2-springs-pass");
    b.press("Next ▶");
    b.pass(1.0);
    assert_eq!(b.wizard().in_use.name, DRAFT);
    assert!(same(b.runner.twin.calibration(), &b.wizard().draft()));

    b.press("● Capture all four IMUs");
    b.pass(6.0);
    b.press("▶ Move slowly to all sides");
    b.pass(50.0);
    b.shoot("3-imus-open");
    b.until("IMUs", 150.0, |w| {
        matches!(w.imus.phase(), Phase::Fit | Phase::Idle)
    });
    // The fit takes the time that a busy computer gives it.
    let mut rounds = 0;
    while b.wizard().imus.running() {
        rounds += 1;
        assert!(rounds < 20_000, "the fit does not end");
        std::thread::sleep(std::time::Duration::from_millis(50));
        b.pass(0.25);
    }
    b.shoot("3-imus-pass");
    for (i, take) in b.wizard().imus.imus.iter().enumerate() {
        println!("IMU {}: {:?}", i + 1, take.verdict());
    }
    assert!(!is_disabled(&b.h, "Next ▶"));
    b.press("Next ▶");
    b.pass(1.0);
    assert_eq!(b.wizard().step, Step::Mocap);
    assert!(same(b.runner.twin.calibration(), &b.wizard().draft()));

    b.press("▶ Visit the poses");
    b.until("poses", 400.0, |w| w.mocap.pairs().len() >= 17);
    b.shoot("4-vicon");
    let fit = match b.wizard().mocap.fit() {
        Some(Ok(fit)) => fit.clone(),
        other => panic!("{other:?}"),
    };
    let (x, y) = (&fit.frames.base_from_world, &fit.frames.object_from_tip);
    println!("registration: {x} {y} {:?}", fit.summary);
    // World and base are one frame on the virtual rig: the middle of the poses stays where it is.
    let middle = nalgebra::Point3::from(fit.centre_in_world_m);
    let moved_m = (x * middle - middle).norm();
    assert!(x.rotation.angle() < 0.03 && moved_m < 5e-3, "{x} {moved_m}");
    b.press("Next ▶");

    b.press("● Record motion");
    b.press("▶ Figure 8, not used before");
    b.pass(25.0);
    b.shoot("5-validate-open");
    b.until("motion", 60.0, |w| w.comparison.is_some());
    b.shoot("5-validate");
    let (c, _) = b.wizard().comparison.clone().expect("compared");
    println!("{c:?}");
    // Motion capture lies where each calibration reads it, not where the new one does.
    let q = b.wizard().question();
    let (robot, maps) = (RobotSpec::reference(), maps());
    let poses = q.poses.as_ref().expect("were captured");
    let place = |c: &Calibration| {
        let placed = poses.place(&robot, &maps, c, &mut |_| true);
        placed.expect("nobody stops it").expect("registers")
    };
    let (by_old, by_new) = (place(&q.old), place(&q.new));
    assert_ne!(by_old, by_new);
    let off = |f: &crate::sensing::registration::Frames| {
        (f.object_from_tip.translation.vector - y.translation.vector).norm()
    };
    assert!(off(&by_new) < 0.3e-3, "{}", off(&by_new));
    let go_on = &mut |_| true;
    let with_its_own = q.trial.errors(&robot, &maps, &q.old, Some(&by_old), go_on);
    assert_eq!(with_its_own, Some(c.old));
    let judgement = b.wizard().judgement().expect("judged");
    assert!(judgement.good(), "{judgement:?}");
    assert!(
        c.new
            .position_m
            .is_some_and(|s| s.n > 1000 && s.rmse < 2e-3)
    );
    b.press("Next ▶");

    assert!(is_disabled(&b.h, "Save and apply version"));
    b.h.get_by_label("Name").focus();
    b.h.run_steps(2);
    b.h.get_by_label("Name").type_text("arm 2");
    b.h.run_steps(2);
    b.shoot("6-save");
    let draft = b.wizard().draft();
    b.press("Save and apply version");
    b.pass(0.5);
    b.shoot("6-saved");
    let saved = b.shelf.lock().expect("not poisoned").clone();
    assert_eq!(saved.len(), 1);
    let v = &saved[0];
    let kept = v.kept.as_ref().expect("reads");
    assert!(v.active && kept.registration.is_some());
    assert!(
        v.note
            .starts_with("springs 12/12, IMUs 4/4, 1 redone, Vicon"),
        "{}",
        v.note
    );
    assert!(
        v.note.contains("validated") && v.note.ends_with("simulated"),
        "{}",
        v.note
    );
    assert_eq!(
        (&*kept.calibration.name, kept.calibration.springs.len()),
        ("arm 2", 12)
    );
    assert!(same(&kept.calibration, &draft));
    // Points of two runs: neither log's own hash.
    assert_ne!(
        kept.calibration.bench_sha256,
        drawn(&BenchRequest {
            springs: vec![0],
            loose: Some(6),
            seed: 1,
        })
        .sha256
    );
    assert_eq!(b.runner.twin.calibration(), kept.calibration.as_ref());
    b.h.get_by_label_contains("Saved as version 1, “arm 2”: in use now.");
    assert!(!b.wizard().has_begun());
}

#[test]
fn a_version_is_rolled_back_and_the_twin_reads_by_it() {
    let shelf = Shelf::default();
    for (name, longer_m) in [("one", 1e-3), ("two", 2e-3)] {
        let mut calibration = Calibration::virtual_rig();
        calibration.name = name.into();
        calibration.springs[0].curve.coefficients_m[0] += longer_m;
        put(
            &shelf,
            NewVersion {
                note: format!("{name}: springs 12/12"),
                calibration,
                registration: None,
                networks: None,
            },
        );
    }
    let mut b = Bench::new(shelf);
    b.press("Roll back to version 1");
    b.pass(0.5);
    let list = b.shelf.lock().expect("not poisoned").clone();
    let active: Vec<_> = list.iter().filter(|v| v.active).map(|v| v.number).collect();
    assert_eq!(active, [1]);
    assert_eq!(b.runner.twin.calibration().name, "one");
    let kept = list[1].kept.as_ref().expect("reads");
    assert_eq!(b.runner.twin.calibration(), kept.calibration.as_ref());
    b.h.get_by_label_contains("Rolled back to version 1, “one”: in use now.");
    b.shoot("9-rolled-back");
    // While captures are under way there is no way back.
    b.press("Next ▶");
    b.press("▶ Draw all twelve springs");
    b.press("◀ Back");
    assert!(is_disabled(&b.h, "Roll back to version 2"));
}

#[test]
fn a_log_is_browsed_read_and_judged_and_a_circuit_s_own_readings_are_not_used() {
    let (_twin, handle) = twin(fixture::snapshot(1.0));
    let mut outside = services(&Shelf::default());
    outside.pick = Box::new(|dialog| {
        assert_eq!(dialog.kind, crate::gui::services::DialogKind::Open);
        Job::ready(Ok(Picked::Path(PathBuf::from("logs/bench.csv"))))
    });
    outside.calibration.bench = None;
    outside.calibration.read_bench = Box::new(|path| {
        assert_eq!(path, PathBuf::from("logs/bench.csv"));
        let mut log = drawn(&BenchRequest {
            springs: (0..11).collect(),
            loose: None,
            seed: 3,
        });
        log.quantity = crate::sensing::calibration::Quantity::CircuitReading;
        Job::ready(Ok(log))
    });
    let mut h = opened(handle, outside);
    h.get_by_label("Next ▶").click();
    h.run_steps(3);
    assert!(is_disabled(&h, "Practice bench"));
    assert!(is_disabled(&h, "Read the log"));
    h.get_by_label("Browse…").click();
    h.run_steps(3);
    h.get_by_label("Read the log").click();
    h.run_steps(3);
    let w = h.state().screens.calibrate.wizard().expect("is shown");
    assert_eq!(w.springs_to_do(), (1..=11).collect::<Vec<_>>());
    h.get_by_label_contains("Spring 1: the log holds a circuit's own readings");
    h.get_by_label_contains("The log has no points of spring 12");
    assert!(is_disabled(&h, "Next ▶"));
}
