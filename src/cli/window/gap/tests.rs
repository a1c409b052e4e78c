use super::*;
use crate::cli::window::baselines::baseline_file;
use springtwin::gap::Edits;
use springtwin::robot::{PatchEffect, PatchValue, REFERENCE};

fn folder(name: &str) -> PathBuf {
    let id = std::process::id();
    std::env::temp_dir().join(format!("springtwin-gap-window-{name}-{id}"))
}

fn payload(robot: &RobotSpec) -> Patch {
    Patch {
        version: springtwin::gap::VERSION,
        name: "found in suspect".into(),
        robot: robot.hash.clone(),
        verdict: "named".into(),
        data: Default::default(),
        rig: Default::default(),
        floor: Default::default(),
        law: Vec::new(),
        effects: vec![PatchEffect {
            id: "payload".into(),
            target: None,
            params: [(
                "mass".to_owned(),
                PatchValue {
                    value: 0.2,
                    unit: "kg".into(),
                    ci95: None,
                },
            )]
            .into(),
        }],
    }
}

#[test]
fn accepted_patches_stack_on_a_copy_and_come_off_byte_for_byte() {
    let dir = folder("store");
    std::fs::create_dir_all(&dir).expect("folder");
    let file = dir.join("arm.toml");
    std::fs::write(&file, REFERENCE).expect("writes");
    let store = Store::new(Some(&file), &dir);
    let path = dir.join("arm.patched.toml");
    assert_eq!(store.path().expect("reads"), path);
    let before = store.read().expect("reads");
    assert!(before.robot.patches.is_empty() && !path.exists());
    let patch = payload(&before.robot);
    let after = store.accept(&patch).expect("accepts");
    assert_eq!(after.robot.patches.len(), 1);
    assert_eq!(store.read().expect("reads"), after);
    let [record] = &after.history[..] else {
        panic!("one patch: {:?}", after.history);
    };
    assert!(record.is_applied && record.date.is_some());
    assert_eq!(record.changes[0].text(), "Undeclared payload: 0 → 200 g");
    let twice = store.accept(&patch).expect_err("twice");
    assert!(said(twice).contains("already"));
    let other = Patch {
        name: "another on the same robot".into(),
        ..patch.clone()
    };
    let both = store.accept(&other).expect_err("corrects twice");
    assert!(said(both).contains("does not know"));
    assert_eq!(
        store.undo(Edits::Refuse).expect("undone").robot,
        before.robot
    );
    assert_eq!(read_text(&path).expect("there"), REFERENCE);
    assert_eq!(read_text(&file).expect("untouched"), REFERENCE);
    // It is in the history, undone.
    let undone = &store.read().expect("reads").history;
    assert!(undone.len() == 1 && !undone[0].is_applied, "{undone:?}");
    let nothing = store.undo(Edits::Refuse).expect_err("nothing to take back");
    assert!(said(nothing).contains("no patch"));
    // A copy of another robot is not built upon.
    std::fs::write(&path, REFERENCE.replacen("name = \"", "name = \"x", 1)).expect("writes");
    let edited = store.read().expect("reads");
    assert!(edited.edited.is_some_and(|e| e.contains("edited by hand")));
    let refused = said(store.accept(&patch).expect_err("another robot"));
    assert!(refused.contains("another robot file"), "{refused}");
    // Nor is one that was there before there was a history.
    std::fs::remove_dir_all(dir.join("arm.patched.toml.history")).expect("is there");
    let refused = said(store.read().expect_err("another robot"));
    assert!(refused.contains("another robot file"), "{refused}");
    std::fs::remove_dir_all(&dir).expect("cleans up");
}

/// Writes as where the folder `installed` belongs to somebody else.
fn as_a_user(path: &Path, text: &str) -> Result<(), recording::RecordingError> {
    if path.parent().is_some_and(|p| p.ends_with("installed")) {
        return Err(recording::RecordingError::Io {
            path: path.to_owned(),
            doing: "write",
            source: std::io::ErrorKind::PermissionDenied.into(),
        });
    }
    recording::write_text(path, text)
}

#[test]
fn a_patch_of_an_installed_robot_file_goes_to_the_users_data() {
    let dir = folder("installed");
    let (installed, data) = (dir.join("installed"), dir.join("data"));
    std::fs::create_dir_all(&installed).expect("folder");
    let file = installed.join("arm.toml");
    std::fs::write(&file, REFERENCE).expect("writes");
    let store = Store::with_writer(Some(&file), &data, as_a_user);
    let before = store.read().expect("reads");
    let after = store.accept(&payload(&before.robot)).expect("accepts");
    assert!(
        after.path.starts_with(&data) && after.path.exists(),
        "{}",
        after.path.display()
    );
    assert!(!installed.join("arm.patched.toml").exists());
    // It is what the next window reads, and takes the patch off.
    let again = Store::with_writer(Some(&file), &data, as_a_user);
    assert_eq!(again.read().expect("reads"), after);
    assert_eq!(
        again.undo(Edits::Refuse).expect("undone").robot,
        before.robot
    );
    // Another robot file of that name has a copy of its own.
    let other = REFERENCE.replacen("name = \"", "name = \"x", 1);
    std::fs::write(&file, other).expect("writes");
    let other = again.read().expect("reads");
    assert!(other.robot.patches.is_empty());
    let patched = again.accept(&payload(&other.robot)).expect("accepts");
    assert_ne!(patched.path, after.path);
    std::fs::remove_dir_all(&dir).expect("cleans up");
}

#[test]
fn of_patches_that_are_accepted_at_the_same_time_one_holds() {
    let dir = folder("together");
    std::fs::create_dir_all(&dir).expect("folder");
    let file = dir.join("arm.toml");
    std::fs::write(&file, REFERENCE).expect("writes");
    let robot = RobotSpec::reference();
    let windows = 8;
    let together = std::sync::Barrier::new(windows);
    let accepted = std::sync::atomic::AtomicUsize::new(0);
    std::thread::scope(|scope| {
        for window in 0..windows {
            let (file, dir, robot, together, accepted) =
                (&file, &dir, &robot, &together, &accepted);
            let accepts = move || {
                let patch = Patch {
                    name: format!("of window {window}"),
                    ..payload(robot)
                };
                let store = Store::new(Some(file), dir);
                together.wait();
                if store.accept(&patch).is_ok() {
                    accepted.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
                }
            };
            let thread = std::thread::Builder::new().name("window".to_owned());
            thread.spawn_scoped(scope, accepts).expect("a thread");
        }
    });
    assert_eq!(accepted.into_inner(), 1);
    let read = Store::new(Some(&file), &dir).read().expect("reads");
    assert_eq!(read.robot.patches.len(), 1);
    std::fs::remove_dir_all(&dir).expect("cleans up");
}

#[test]
fn the_generator_is_a_process_of_its_own_with_the_answer_elsewhere() {
    let (folder, answer) = (
        Path::new("/d/gap-examples/a-1"),
        Path::new("/d/gap-answers/a-1.json"),
    );
    let command = springtwin::lab::gap_bench::example_command(
        Path::new("/bin/springtwin"),
        None,
        folder,
        answer,
        3,
    );
    let args: Vec<String> = command
        .get_args()
        .map(|a| a.to_string_lossy().into_owned())
        .collect();
    assert_eq!(
        args[..5],
        ["rig", "case", "--overwrite", "--kind", "single"]
    );
    assert!(args.contains(&"--with-parent".to_owned()));
    assert!(!answer.starts_with(folder));
    use clap::Parser as _;
    let line = std::iter::once("springtwin".to_owned()).chain(args);
    assert!(crate::cli::program::Cli::try_parse_from(line).is_ok());
}

#[test]
fn a_sheet_tells_what_a_session_holds_and_whose_it_is() {
    let robot = RobotSpec::reference();
    let n = 100;
    let session = Session {
        name: "s".into(),
        robot: "f".repeat(64),
        t_s: (0..n).map(|k| 0.1 * k as f64).collect(),
        chamber_pa: vec![[0.0; CHAMBERS]; n],
        sensors: vec![
            springtwin::signal::SensorVec {
                spring_m: std::array::from_fn(|i| if i == 3 { f64::NAN } else { 0.15 }),
                imu_ypr_rad: [[0.0; 3]; IMUS],
            };
            n
        ],
        captured: vec![None; n],
        ..Session::default()
    };
    let s = sheet_of(Path::new("s"), &session, None, &robot);
    let of = |name: &str| s.groups.iter().find(|g| g.name == name).map(|g| g.present);
    assert_eq!(of("springs"), Some(11));
    assert_eq!(of("commands"), Some(0));
    assert_eq!(of("motion capture"), Some(0));
    assert!((s.rate_hz - 10.0).abs() < 1e-6, "{}", s.rate_hz);
    assert!(matches!(s.robot, RobotMatch::Other { .. }));
    let silent = Session {
        robot: String::new(),
        ..session
    };
    let s = sheet_of(Path::new("s"), &silent, None, &robot);
    assert_eq!(s.robot, RobotMatch::Silent);
}

/// The rig in order is fitted once: the file stands for it, with its channels, until it is fitted again. What the model cannot follow
/// leaves the old one.
#[test]
fn a_baseline_is_kept_per_robot_and_read_like_a_session() {
    let dir = folder("baseline");
    let robot = RobotSpec::reference();
    let plan = springtwin::lab::session::SessionPlan {
        name: "monday".to_owned(),
        seconds: 25.0,
        rate_hz: 25.0,
        ..Default::default()
    };
    let log = springtwin::lab::session::session(&robot, &plan).expect("the rig runs");
    let session = dir.join("monday");
    let log = springtwin::lab::session::session_log(log, &robot);
    recording::write_session(&session, &log).expect("writes");
    let kept = baseline_file(&dir, &robot);
    let (_, worker) = springtwin::gui::services::Job::pair();
    assert_eq!(
        commission(&session, &robot, &kept, &worker).expect("fits"),
        kept
    );
    let shown = sheet(&kept, &robot).expect("reads");
    assert_eq!(shown.name, "Baseline of monday");
    assert!(matches!(shown.kept, Some(Kept::Days(d)) if d < 0.1));
    assert!((shown.rate_hz - 25.0).abs() < 0.1, "{}", shown.rate_hz);
    let present: Vec<usize> = shown.groups.iter().map(|g| g.present).collect();
    assert_eq!(present, [1, 12, 4, 1]);
    assert_eq!(shown.robot, RobotMatch::Same);
    let text = read_text(&kept).expect("there");
    let missing = commission(&dir.join("tuesday"), &robot, &kept, &worker);
    assert!(missing.is_err());
    assert_eq!(read_text(&kept).expect("there"), text);
    std::fs::remove_dir_all(&dir).expect("cleans up");
}

#[cfg(unix)]
#[test]
fn a_page_that_no_browser_takes_is_told() {
    let page = Path::new("report.html");
    // xdg-open ends with 3 where it finds no browser.
    assert_eq!(
        open_page(page, &["false"]).err().as_deref(),
        Some("The report cannot be shown in a browser: no browser was found.")
    );
    let none = open_page(page, &["springtwin-no-such-program"]);
    assert!(none.is_err_and(|e| e.contains("no program that opens pages")));
    assert_eq!(
        open_page(page, &["springtwin-no-such-program", "true"]),
        Ok(())
    );
}
