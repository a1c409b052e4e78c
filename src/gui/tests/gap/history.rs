//! Patches of the robot file: what is changed is shown, kept with its date and finding, and undone byte for byte.

use super::*;
use crate::gap::Edits;
use crate::lab::patch_history::PatchHistory;

/// A folder with a robot file that takes patches; it goes with the test.
struct OnDisk(PathBuf);

impl OnDisk {
    fn new(name: &str) -> Self {
        let id = std::process::id();
        let dir = std::env::temp_dir().join(format!("springtwin-gui-history-{name}-{id}"));
        std::fs::create_dir_all(&dir).expect("a folder");
        Self(dir)
    }

    fn file(&self) -> PathBuf {
        self.0.join("arm.patched.toml")
    }

    fn text(&self) -> String {
        let there = std::fs::read_to_string(self.file());
        there.unwrap_or_else(|_| REFERENCE.to_owned())
    }
}

impl Drop for OnDisk {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

/// What the program around the window does with the file.
fn on_disk(disk: &Rc<OnDisk>) -> Services {
    let seen = Rc::new(RefCell::new(Seen::default()));
    let [to_read, to_accept, to_undo] = [0; 3].map(|_| Rc::clone(disk));
    let read = |disk: &OnDisk| {
        let (now, history) = (disk.text(), PatchHistory::of(&disk.file()));
        let edited = history.edited(&now).expect("reads");
        let text = match &edited {
            Some(_) => history.written().expect("reads").expect("was written"),
            None => now,
        };
        PatchedRobot {
            path: disk.file(),
            robot: RobotSpec::from_toml(&text).expect("a robot file"),
            history: history.records(&text).expect("reads"),
            edited,
        }
    };
    let mut services = services(&seen);
    services.gap.patched = Box::new(move || Job::ready(Ok(read(&to_read))));
    services.gap.accept = Box::new(move |patch| {
        let (now, name) = (to_accept.text(), patch.name.clone());
        let history = PatchHistory::of(&to_accept.file());
        let new = with_patch(&now, patch);
        history
            .replace(&now, &new, name, "2026-03-01 14:05 +01:00")
            .expect("writes");
        Job::ready(Ok(read(&to_accept)))
    });
    services.gap.undo = Box::new(move |edits| {
        let history = PatchHistory::of(&to_undo.file());
        let done = history.revert(&to_undo.text(), edits, "2026-03-02 09:00 +01:00");
        Job::ready(match done {
            Ok(_) => Ok(read(&to_undo)),
            Err(e) => Err(format!("{e}.")),
        })
    });
    services
}

fn at_patch(disk: &Rc<OnDisk>) -> Harness<'static, App> {
    let mut app = gap_app(on_disk(disk));
    app.screens
        .gap
        .take(with_verdict(Verdict::Named), Origin::Simulated, None);
    app.screens.gap.step = Step::Patch;
    let mut h = Harness::builder()
        .with_size([1280.0, 1600.0])
        .build_eframe(|_| app);
    h.run_steps(5);
    h
}

#[test]
fn a_patch_is_shown_before_it_is_accepted_listed_after_and_undone_byte_for_byte() {
    let disk = Rc::new(OnDisk::new("walk"));
    let mut h = at_patch(&disk);
    // First what changes, then the button.
    let change = h.get_by_label_contains("Undeclared payload: 0 → ").rect();
    assert!(change.bottom() < h.get_by_label("Accept patch").rect().top());
    h.get_by_label("None: the robot file is as it came.");
    click(&mut h, "Accept patch");
    assert_eq!(
        RobotSpec::from_toml(&disk.text())
            .expect("reads")
            .patches
            .len(),
        1
    );
    h.get_by_label("1. Undeclared payload");
    h.get_by_label_contains(
        "accepted 2026-03-01 14:05 +01:00; found in suspect against commissioning",
    );
    let back = h.get_by_label_contains(" → 0 g").rect();
    assert!(back.bottom() < h.get_by_label("↶ Undo the last patch").rect().top());
    click(&mut h, "↶ Undo the last patch");
    assert_eq!(
        std::fs::read_to_string(disk.file()).expect("is there"),
        REFERENCE
    );
    h.get_by_label("↶ Undeclared payload");
    h.get_by_label_contains("undone; accepted 2026-03-01");
    // It can be accepted again.
    click(&mut h, "Accept patch");
    h.get_by_label("1. Undeclared payload");
}

/// Another day, without a finding: what was accepted is there, and an edit by hand is not lost.
#[test]
fn a_file_that_was_edited_by_hand_is_not_undone_without_a_word() {
    let disk = Rc::new(OnDisk::new("edited"));
    let mut h = at_patch(&disk);
    click(&mut h, "Accept patch");
    let mine = disk.text().replacen("name = \"", "name = \"my ", 1);
    std::fs::write(disk.file(), &mine).expect("writes");
    // The window does not know yet, and the program refuses.
    click(&mut h, "↶ Undo the last patch");
    assert_eq!(disk.text(), mine);
    h.run_steps(4);
    assert!(
        h.query_all_by_label_contains("was edited by hand")
            .next()
            .is_some()
    );
    let mut h = harness(gap_app(on_disk(&disk)));
    h.run_steps(5);
    click(&mut h, "Step 4: Patch");
    h.get_by_label_contains(
        "was edited by hand since it was written (2026-03-01 14:05 +01:00): undo",
    );
    assert!(is_disabled(&h, "↶ Undo the last patch"));
    click(&mut h, "↶ Undo, edits set aside");
    assert_eq!(disk.text(), REFERENCE);
    let history = PatchHistory::of(&disk.file());
    assert_eq!(history.edited(&disk.text()).expect("reads"), None);
    let kept = std::fs::read_dir(history.folder()).expect("is there");
    let texts = kept.filter_map(|f| std::fs::read_to_string(f.expect("reads").path()).ok());
    assert!({ texts }.any(|text| text == mine), "the edits are kept");
    let undone = PatchHistory::of(&disk.file()).revert(REFERENCE, Edits::Refuse, "later");
    assert!(undone.is_err(), "there is no other patch");
}
