//! The README's walk and the tutorial for a lab's own arm: their commands run in order, as written, and print what is shown.

use std::path::Path;
use std::process::Command;

use serde_json::Value;

use crate::process::output;
use crate::program::{scratch, springtwin};

/// A fenced block between the walk's marks: commands, or what they print.
struct Block {
    is_commands: bool,
    text: String,
}

/// The blocks of a page's walk, in order.
fn walk(page: &str) -> Vec<Block> {
    let (_, rest) = page.split_once("<!-- walk -->").expect("the walk begins");
    let (walk, _) = rest.split_once("<!-- end of walk -->").expect("and ends");
    // Outside and inside of fences by turns.
    let fenced = walk.split("```").skip(1).step_by(2);
    fenced
        .map(|block| {
            let (language, text) = block.split_once('\n').expect("a block has lines");
            assert!(matches!(language, "sh" | "text"), "a block of {language}");
            Block {
                is_commands: language == "sh",
                text: text.to_owned(),
            }
        })
        .collect()
}

/// A number as it is printed.
#[derive(Clone, Copy, Debug)]
struct Figure {
    value: f64,
    decimals: usize,
    /// A share in per cent.
    is_share: bool,
}

impl Figure {
    /// As the README claims: whole numbers as they stand, shares to 2 points, others to 2 % or one of the last digit.
    fn agrees(self, printed: Self) -> bool {
        let last_digit = 0.1f64.powi(self.decimals as i32);
        let tolerance = match (self.is_share, self.decimals) {
            (true, _) => 2.0,
            (false, 0) => 0.0,
            (false, _) => (0.02 * self.value).max(last_digit) + 1e-9,
        };
        self.decimals == printed.decimals && (self.value - printed.value).abs() <= tolerance
    }

    /// Of something that was trained or fitted, on another computer: to a quarter, or two of the last digit.
    fn is_like(self, printed: Self) -> bool {
        let last_digit = 0.1f64.powi(self.decimals as i32);
        // Small whole numbers count or number something.
        let tolerance = match self.decimals {
            0 if self.value < 20.0 => 0.0,
            _ => (0.25 * self.value).max(2.0 * last_digit),
        };
        self.decimals == printed.decimals && (self.value - printed.value).abs() <= tolerance
    }
}

/// Whether figures of a page are those that were printed.
type Agree = fn(Figure, Figure) -> bool;

/// A line's words, no space more than one, with a `#` for each number, and the numbers.
fn read_line(line: &str) -> (String, Vec<Figure>) {
    let line = line.split_whitespace().collect::<Vec<_>>().join(" ");
    let (mut words, mut figures, mut rest) = (String::new(), Vec::new(), line.as_str());
    while let Some(at) = rest.find(|c: char| c.is_ascii_digit()) {
        words.push_str(&rest[..at]);
        words.push('#');
        let tail = &rest[at..];
        let digits = |t: &str| t.find(|c: char| !c.is_ascii_digit()).unwrap_or(t.len());
        let whole = digits(tail);
        let decimals = tail[whole..].strip_prefix('.').map_or(0, digits);
        let end = if decimals > 0 {
            whole + 1 + decimals
        } else {
            whole
        };
        rest = &tail[end..];
        figures.push(Figure {
            value: tail[..end].parse().expect("digits"),
            decimals,
            is_share: rest.starts_with(" %"),
        });
    }
    words.push_str(rest);
    (words, figures)
}

/// Whether a line was printed as it is shown.
fn is_as_shown(shown: &str, printed: &str, agree: Agree) -> bool {
    let ((words, figures), (their_words, theirs)) = (read_line(shown), read_line(printed));
    let mut pairs = figures.iter().zip(&theirs);
    words == their_words && figures.len() == theirs.len() && pairs.all(|(a, b)| agree(*a, *b))
}

/// Runs the commands of a page in a folder, and holds what they print to what it shows.
fn follow(page: &str, folder: &Path, agree: Agree) {
    let mut out = String::new();
    for block in walk(page) {
        if block.is_commands {
            out = run(&block.text, folder);
            continue;
        }
        for line in block.text.lines() {
            assert!(
                line == "..." || out.lines().any(|printed| is_as_shown(line, printed, agree)),
                "the page shows\n{line}\nbut it printed\n{out}"
            );
        }
    }
}

#[test]
fn figures_are_held_to_what_the_readme_claims() {
    for (shown, printed, agree) in [
        (
            "0.21 mm after 1534 steps",
            "0.22 mm   after 1534 steps",
            true,
        ),
        (
            "0.21 mm after 1534 steps",
            "0.23 mm after 1534 steps",
            false,
        ),
        (
            "0.21 mm after 1534 steps",
            "0.21 mm after 1535 steps",
            false,
        ),
        ("45 % / 87 %", "47 % / 86 %", true),
        ("45 % / 87 %", "48 % / 87 %", false),
        ("11.11 -> 0.07", "11.30 -> 0.07", true),
        ("11.11 -> 0.07", "11.40 -> 0.07", false),
        ("reached 3", "missed 3", false),
    ] {
        assert_eq!(
            is_as_shown(shown, printed, Figure::agrees),
            agree,
            "{shown} / {printed}"
        );
    }
}

fn run(commands: &str, folder: &Path) -> String {
    let program = Path::new(env!("CARGO_BIN_EXE_springtwin"));
    let path = std::env::var("PATH").expect("PATH");
    let folder_of_program = program.parent().expect("a folder").display();
    let mut shell = Command::new("sh");
    shell
        .args(["-e", "-c", commands])
        .env("PATH", format!("{folder_of_program}:{path}"))
        .env("XDG_DATA_HOME", folder.join("home"))
        .env("RIG", "sim")
        .current_dir(folder);
    let out = output(&mut shell);
    let said = String::from_utf8_lossy(&out.stdout).into_owned();
    let complaint = String::from_utf8_lossy(&out.stderr);
    assert!(out.status.success(), "{commands}{said}{complaint}");
    said
}

#[test]
fn the_walk_of_the_readme_goes_as_it_says() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let readme = std::fs::read_to_string(root.join("README.md")).expect("README.md");
    let clone = scratch("readme");
    // What of the clone the walk may use.
    std::fs::create_dir_all(clone.join("assets/networks")).expect("a folder");
    std::fs::create_dir_all(clone.join("assets/calibration")).expect("a folder");
    for file in [
        "assets/networks/quick.toml",
        "assets/calibration/virtual-rig.toml",
    ] {
        std::fs::copy(root.join(file), clone.join(file)).expect("a file of the walk");
    }

    follow(&readme, &clone, Figure::agrees);

    let file = |name: &str| clone.join("walk").join(name);
    let finding = json_of(&file("found/finding.json"));
    assert_eq!(finding["verdict"], "named", "{finding}");
    assert_eq!(finding["effects"][0]["id"], "spring-calibration");
    assert_eq!(finding["effects"][0]["target"], 4);
    assert!(file("way/trajectory.svg").exists());
    let report = std::fs::read_to_string(file("found/report.html")).expect("a report");
    assert!(report.contains("all its figures are simulated"));

    let arm = std::fs::read_to_string(file("arm.toml")).expect("the calibration");
    let curves = springtwin::sensing::Calibration::from_toml(&arm).expect("a calibration");
    assert_eq!(curves.springs.len(), 12);
}

/// What a file of JSON in a folder holds.
fn json_of(file: &Path) -> Value {
    let bytes = std::fs::read(file).unwrap_or_else(|e| panic!("{}: {e}", file.display()));
    serde_json::from_slice(&bytes).expect("JSON")
}

/// Errors of the tip that the tutorial shows before and after an arm was learned, mm.
fn learned_mm(page: &str) -> [f64; 2] {
    let line = page
        .lines()
        .find(|l| l.starts_with("learned from"))
        .expect("the line");
    let figures = read_line(line).1;
    [figures[1].value, figures[2].value]
}

#[test]
fn a_lab_brings_up_its_own_arm_as_the_tutorial_has_it() {
    let page = Path::new(env!("CARGO_MANIFEST_DIR")).join("assets/guide/bring-up.md");
    let page = std::fs::read_to_string(page).expect("the tutorial");
    let folder = scratch("bring-up");
    follow(&page, &folder, Figure::is_like);

    let finding = json_of(&folder.join("found/finding.json"));
    assert_eq!(finding["verdict"], "named", "{finding}");
    assert_eq!(finding["effects"][0]["id"], "payload");
    assert_eq!(finding["effects"].as_array().map(Vec::len), Some(1));

    // What was printed is within a quarter of what the page shows.
    let [before, after] = learned_mm(&page);
    assert!(
        1.25 * after <= 0.9,
        "{before} -> {after} mm, and a quarter more"
    );

    // Of two recordings one is held out, and of one alone nothing general is learned.
    let path = |name: &str| folder.join(name).display().to_string();
    let (arm, out) = (path("arm.toml"), path("few"));
    let few = [path("learned/learn-1.rrd"), path("learned/learn-2.rrd")];
    let args = [
        "--robot",
        &arm,
        "learn",
        "--dry-run",
        "--out",
        &out,
        "--from",
        &few[0],
        &few[1],
    ];
    let refused = springtwin(&args);
    let text = String::from_utf8_lossy(&refused.stderr);
    assert!(
        !refused.status.success() && text.contains("2 recordings are too few"),
        "{text}"
    );
}
