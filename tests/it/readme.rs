//! The README's walk: its commands run in order, as written, and print what the README shows.

use std::path::Path;
use std::process::Command;

use serde_json::Value;

use crate::program::{json, scratch};

/// A fenced block between the walk's marks: commands, or what they print.
struct Block {
    is_commands: bool,
    text: String,
}

/// The blocks of the walk, in order.
fn walk(readme: &str) -> Vec<Block> {
    let (_, rest) = readme.split_once("<!-- walk -->").expect("the walk begins");
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

/// A line with every number as `#`, and no space more than one.
fn without_numbers(line: &str) -> String {
    let mut out = String::new();
    for c in line.trim().chars() {
        let c = if c.is_ascii_digit() || c == '.' {
            '#'
        } else {
            c
        };
        if !(matches!(c, '#' | ' ') && out.ends_with(c)) {
            out.push(c);
        }
    }
    out
}

fn run(commands: &str, folder: &Path) -> String {
    let program = Path::new(env!("CARGO_BIN_EXE_springtwin"));
    let path = std::env::var("PATH").expect("PATH");
    let folder_of_program = program.parent().expect("a folder").display();
    let out = Command::new("sh")
        .args(["-e", "-c", commands])
        .env("PATH", format!("{folder_of_program}:{path}"))
        .current_dir(folder)
        .output()
        .expect("sh starts");
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
    let recipe = "assets/networks/quick.toml";
    std::fs::copy(root.join(recipe), clone.join(recipe)).expect("the recipe");

    let mut said = Vec::new();
    for block in walk(&readme) {
        if block.is_commands {
            said = run(&block.text, &clone)
                .lines()
                .map(without_numbers)
                .collect();
            continue;
        }
        for line in block.text.lines() {
            let shown = without_numbers(line);
            assert!(
                shown == "..." || shown == "#" || said.contains(&shown),
                "the README shows\n{shown}\nbut it printed\n{}",
                said.join("\n")
            );
        }
    }

    let file = |name: &str| clone.join("walk").join(name);
    let finding = std::fs::read(file("found/finding.json")).expect("the finding");
    let finding: Value = serde_json::from_slice(&finding).expect("JSON");
    assert_eq!(finding["verdict"], "named", "{finding}");
    assert_eq!(finding["effects"][0]["id"], "spring-calibration");
    assert_eq!(finding["effects"][0]["target"], 4);
    assert!(file("found/report.html").exists() && file("way/trajectory.svg").exists());

    let arm = std::fs::read_to_string(file("arm.toml")).expect("the calibration");
    let curves = springtwin::sensing::Calibration::from_toml(&arm).expect("a calibration");
    assert_eq!(curves.springs.len(), 12);

    let path = |name: &str| file(name).to_str().expect("UTF-8").to_owned();
    let model = path("networks/reference.safetensors");
    let scored = json(&["estimate", &path("healthy"), "--model", &model, "--json"]);
    let mean_mm = scored["error"]["mean_mm"].as_f64().expect("an error");
    assert!(mean_mm < 2.5, "{scored}");
}
