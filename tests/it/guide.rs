//! The pages that are made by the program are as it makes them; links of the guide lead somewhere; the citation
//! names this version.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use crate::program::{json, refusal, scratch, springtwin};

fn root() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
}

fn read(file: &Path) -> String {
    std::fs::read_to_string(file).unwrap_or_else(|e| panic!("{}: {e}", file.display()))
}

/// A page of the guide against the command that makes it.
fn check(page: &str, command: &[&str]) {
    let out = springtwin(command);
    assert!(out.status.success(), "{command:?}");
    let made = String::from_utf8(out.stdout).expect("UTF-8");
    let file = root().join("assets/guide").join(page);
    assert!(
        made == read(&file),
        "make {page} again: springtwin {} > assets/guide/{page}",
        command.join(" ")
    );
}

#[test]
#[cfg(all(feature = "gui", feature = "rrd"))]
fn the_page_of_commands_is_made_by_the_program() {
    check("cli.md", &["man", "--markdown"]);
}

#[test]
fn the_page_of_a_robot_files_keys_is_their_table() {
    check("robot-keys.md", &["robot", "keys", "--markdown"]);
}

#[test]
fn the_page_of_alarms_is_their_table() {
    check("alarms.md", &["alarms", "--markdown"]);
    let one = springtwin(&["alarms", "data-old"]);
    let text = String::from_utf8(one.stdout).expect("UTF-8");
    assert!(
        text.contains("older than 30 ms; critical from 100 ms on"),
        "{text}"
    );
    let (code, text) = refusal(&["alarms", "flood"]);
    assert!(
        code == 1 && text.contains("no alarm 'flood'"),
        "{code} {text}"
    );
}

/// A column without its numbers: `spring3_mm` and `spring12_mm` are one.
fn kind(column: &str) -> String {
    let mut out = String::new();
    for c in column.chars() {
        match c.is_ascii_digit() {
            true if out.ends_with('#') => {}
            true => out.push('#'),
            false => out.push(c),
        }
    }
    out
}

/// The columns in the first cells of a section's table.
fn columns_of(page: &str, section: &str) -> BTreeSet<String> {
    let rest = page.split(&format!("## {section}\n")).nth(1);
    let rest = rest.unwrap_or_else(|| panic!("there is no section {section}"));
    let part = rest.split("\n## ").next().unwrap_or_default();
    let cells = part
        .lines()
        .filter_map(|l| l.strip_prefix("| ")?.split(" |").next());
    let code = cells.flat_map(|cell| cell.split('`').skip(1).step_by(2));
    code.map(kind).collect()
}

#[test]
fn the_page_of_files_has_every_column() {
    let page = read(&root().join("assets/guide/formats.md"));
    let dir = scratch("columns");
    let out = dir.join("session");
    let session = ["rig", "session", "--seconds", "1", "--json", "--out"];
    json(&[&session[..], &[out.to_str().expect("UTF-8")]].concat());
    let log = read(&out.join("log.csv"));
    let of_line = |line: &str| -> BTreeSet<String> { line.split(',').map(kind).collect() };
    let mut session = of_line(log.lines().next().expect("a header"));
    // Written where it changes.
    session.insert("payload_kg".to_owned());
    assert_eq!(columns_of(&page, "Session log"), session);
    let dataset = springtwin::recording::dataset_columns().join(",");
    assert_eq!(columns_of(&page, "Dataset"), of_line(&dataset));
    let ticks = springtwin::lab::drive_log::columns();
    assert_eq!(columns_of(&page, "Tick log"), of_line(&ticks));
}

/// Names in a text that begin with `SPRINGTWIN_`.
fn variables(text: &str) -> BTreeSet<String> {
    let named = text.split("SPRINGTWIN_").skip(1).filter_map(|rest| {
        let end = rest.find(|c: char| !c.is_ascii_uppercase() && c != '_');
        let name = &rest[..end.unwrap_or(rest.len())];
        (!name.is_empty()).then(|| format!("SPRINGTWIN_{name}"))
    });
    named.collect()
}

#[test]
fn every_variable_is_on_the_page_of_the_environment() {
    let mut used = variables(&read(&root().join("test")));
    let mut folders = ["src", "tests", "benches"].map(|f| root().join(f)).to_vec();
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(&folder).expect("a folder") {
            let path = entry.expect("an entry").path();
            match path.extension() {
                _ if path.is_dir() => folders.push(path),
                Some(e) if e == "rs" || e == "py" => used.extend(variables(&read(&path))),
                _ => {}
            }
        }
    }
    let page = variables(&read(&root().join("assets/guide/environment.md")));
    assert_eq!(page, used);
}

#[test]
fn the_page_of_effects_is_the_table() {
    check("effects.md", &["gap", "effects", "--markdown"]);
}

#[test]
fn every_command_has_a_man_page() {
    let dir = scratch("man");
    json(&["man", "--out", dir.to_str().expect("UTF-8"), "--json"]);
    let program = read(&dir.join("springtwin.1"));
    // The program's own page refers to those of its commands.
    let mut seen = 0;
    for entry in std::fs::read_dir(&dir).expect("the folder") {
        let name = entry.expect("an entry").file_name();
        let name = name.to_str().expect("UTF-8").trim_end_matches(".1");
        let words: Vec<&str> = name.split('-').skip(1).collect();
        if words.len() == 1 {
            let link = name.replace('-', "\\-");
            assert!(program.contains(&format!("{link}(1)")), "{name}");
        }
        seen += 1;
    }
    assert!(seen > 30, "{seen} pages");
    let one = springtwin(&["man", "gap", "run"]);
    assert_eq!(
        String::from_utf8(one.stdout).expect("UTF-8"),
        read(&dir.join("springtwin-gap-run.1"))
    );
    let (code, text) = refusal(&["man", "gap", "walk"]);
    assert!(code == 1 && text.contains("'gap walk'"), "{code} {text}");
}

#[test]
fn completions_know_the_commands_under_commands() {
    for shell in ["bash", "elvish", "fish", "powershell", "zsh"] {
        let out = springtwin(&["completions", shell]);
        let text = String::from_utf8(out.stdout).expect("UTF-8");
        for word in ["commission", "springs", "baseline", "excitation"] {
            assert!(text.contains(word), "{shell} lacks {word}");
        }
    }
}

/// `(target)` of every link and picture of a page, outside of code.
fn links(text: &str) -> Vec<String> {
    let mut code = false;
    let lines = text.lines().filter(|line| {
        let fence = line.starts_with("```");
        code ^= fence;
        !code && !fence
    });
    let links_of = |line: &str| -> Vec<String> {
        let after = line.split("](").skip(1);
        after
            .filter_map(|rest| rest.split(')').next().map(str::to_owned))
            .collect()
    };
    lines.flat_map(links_of).collect()
}

/// The anchors that a page's headings get.
fn anchors(text: &str) -> Vec<String> {
    let heading = |line: &str| {
        let words = line.trim_start_matches('#').trim().to_lowercase();
        let kept = words.chars().filter_map(|c| match c {
            ' ' => Some('-'),
            c if c.is_alphanumeric() || c == '-' || c == '_' => Some(c),
            _ => None,
        });
        kept.collect()
    };
    text.lines()
        .filter(|l| l.starts_with('#'))
        .map(heading)
        .collect()
}

#[test]
fn links_lead_somewhere_and_every_page_is_in_the_summary() {
    let guide = root().join("assets/guide");
    let summary = read(&guide.join("SUMMARY.md"));
    let mut pages: Vec<PathBuf> = ["README.md", "ARCHITECTURE.md", "SECURITY.md"]
        .map(|f| root().join(f))
        .into();
    for entry in std::fs::read_dir(&guide).expect("the guide") {
        let path = entry.expect("an entry").path();
        let name = path.file_name().and_then(|n| n.to_str()).expect("a name");
        if name.ends_with(".md") {
            // The table of faults is part of a page.
            let listed = summary.contains(&format!("({name})"));
            assert!(
                listed
                    || matches!(
                        name,
                        "SUMMARY.md" | "faults-table.md" | "safety-table.md" | "contact-table.md"
                    ),
                "{name} is not in SUMMARY.md"
            );
            pages.push(path);
        }
    }
    let mut seen = 0;
    for page in &pages {
        let text = read(page);
        for link in links(&text) {
            if link.starts_with("http") {
                continue;
            }
            let (file, anchor) = link.split_once('#').unwrap_or((&link, ""));
            let target = match file {
                "" => page.clone(),
                file => page.parent().expect("a folder").join(file),
            };
            assert!(target.exists(), "{}: {link}", page.display());
            let known = anchor.is_empty() || anchors(&read(&target)).iter().any(|a| a == anchor);
            assert!(known, "{}: no heading for {link}", page.display());
            seen += 1;
        }
    }
    assert!(seen > 40, "{seen} links");
}

#[test]
fn every_picture_of_the_guide_is_made_by_a_command_and_shown() {
    let guide = root().join("assets/guide");
    let make = read(&guide.join("make"));
    let words: Vec<&str> = make
        .split_whitespace()
        .map(|w| w.trim_matches(['"', ';']))
        .collect();
    let pages: String = std::fs::read_dir(&guide)
        .expect("the guide")
        .map(|e| e.expect("an entry").path())
        .filter(|p| p.extension().is_some_and(|e| e == "md"))
        .map(|p| read(&p))
        .collect();
    for entry in std::fs::read_dir(guide.join("pictures")).expect("pictures") {
        let name = entry.expect("an entry").file_name();
        let name = name.to_str().expect("UTF-8");
        let plain = name.trim_end_matches(".png").trim_end_matches(".svg");
        let stem = plain.trim_end_matches("-rod").trim_end_matches("-mesh");
        assert!(
            pages.contains(&format!("(pictures/{name})")),
            "{name} is shown nowhere"
        );
        assert!(
            words
                .iter()
                .any(|w| *w == stem || w.ends_with(&format!("/{name}"))),
            "assets/guide/make does not make {name}"
        );
    }
}

/// The lines of a diff's hunks that are in the files before it, by file.
fn before(diff: &str) -> Vec<(String, Vec<String>)> {
    let mut out: Vec<(String, Vec<String>)> = Vec::new();
    for line in diff.lines().filter(|l| !l.starts_with("+++ ")) {
        if let Some(file) = line.strip_prefix("--- ") {
            out.push((file.trim_start_matches("a/").to_owned(), Vec::new()));
        } else if let Some((_, lines)) = out.last_mut()
            && let Some(line) = line.strip_prefix([' ', '-'])
        {
            lines.push(line.to_owned());
        }
    }
    out
}

#[test]
fn worked_changes_are_about_the_tree_as_it_is() {
    let page = read(&root().join("assets/guide/worked-changes.md"));
    let fences = page.split("```").skip(1).step_by(2);
    let diffs: Vec<&str> = fences.filter_map(|f| f.strip_prefix("diff\n")).collect();
    assert_eq!(diffs.len(), 4);
    let mut seen = 0;
    for (file, lines) in diffs.iter().flat_map(|diff| before(diff)) {
        if file == "/dev/null" {
            continue;
        }
        let text = read(&root().join(&file));
        let there: BTreeSet<&str> = text.lines().collect();
        let gone: Vec<&String> = lines
            .iter()
            .filter(|l| !there.contains(l.as_str()))
            .collect();
        assert!(gone.is_empty(), "{file} has no such lines: {gone:#?}");
        seen += lines.len();
    }
    assert!(seen > 100, "{seen} lines");
}

#[test]
#[cfg(all(feature = "gui", feature = "rrd"))]
fn pictures_of_screens_show_the_screens_as_they_are() {
    let make = read(&root().join("assets/guide/make"));
    let (_, part) = make.split_once("part_screens() {").expect("the part");
    let (part, _) = part.split_once("\n}").expect("its end");
    let folder = scratch("screens");
    let mut seen = 0;
    for line in part
        .lines()
        .filter_map(|l| l.trim().strip_prefix("screen "))
    {
        // Words in quotes are one argument.
        let pieces = line.split('"').enumerate();
        let words = pieces.flat_map(|(k, piece)| match k % 2 {
            0 => piece.split_whitespace().collect(),
            _ => vec![piece],
        });
        let words: Vec<&str> = words.collect();
        let (screen, name) = (words[0], words[1]);
        let file = folder.join(format!("{name}.png"));
        let mut args = vec!["screenshot", screen, "--out", file.to_str().expect("UTF-8")];
        args.extend(&words[2..]);
        let out = springtwin(&args);
        assert!(
            out.status.success(),
            "{args:?}: {}",
            String::from_utf8_lossy(&out.stderr)
        );
        let open = |file: &Path| image::open(file).expect("a picture").to_rgb8();
        let shown = open(&root().join(format!("assets/guide/pictures/{name}.png")));
        let drawn = open(&file);
        assert_eq!(shown.dimensions(), drawn.dimensions(), "{name}");
        // Drivers differ in the last bits of a shade, and edges by a pixel.
        let differs =
            |a: &image::Rgb<u8>, b: &image::Rgb<u8>| (0..3).any(|i| a.0[i].abs_diff(b.0[i]) > 24);
        let pixels = shown.pixels().zip(drawn.pixels());
        let off = pixels.filter(|(a, b)| differs(a, b)).count();
        let share = off as f64 / f64::from(shown.width() * shown.height());
        println!("{name}: {:.2} % of the pixels differ", share * 100.0);
        assert!(
            share < 0.01,
            "{name}.png is older than its screen ({:.1} % differ): make it again with assets/guide/make screens",
            share * 100.0
        );
        seen += 1;
    }
    assert_eq!(seen, 5);
}

#[test]
fn the_citation_names_this_version() {
    let text = read(&root().join("CITATION.cff"));
    let line = format!("version: {}", env!("CARGO_PKG_VERSION"));
    assert!(
        text.lines().any(|l| l == line),
        "CITATION.cff lacks '{line}'"
    );
    assert!(text.contains("cff-version: 1.2.0"));
}
