//! The rooms import only what ARCHITECTURE.md allows.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Room table: room, what it may import.
fn table() -> BTreeMap<String, Vec<String>> {
    let text = std::fs::read_to_string(root().join("ARCHITECTURE.md")).expect("ARCHITECTURE.md");
    let mut rooms = BTreeMap::new();
    for line in text.lines().filter(|l| l.starts_with("| `")) {
        let cells: Vec<&str> = line.trim_matches('|').split('|').map(str::trim).collect();
        let room = cells[0]
            .trim_matches('`')
            .split('`')
            .next()
            .unwrap_or("")
            .to_owned();
        let may = cells[2].to_owned();
        let words = may
            .split(|c: char| !c.is_alphanumeric() && c != '_')
            .filter(|w| !w.is_empty())
            .map(str::to_owned)
            .collect();
        rooms.insert(room, words);
    }
    rooms
}

fn root() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
}

fn sources(dir: &Path, out: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(dir).expect("source folder") {
        let path = entry.expect("entry").path();
        if path.is_dir() {
            sources(&path, out);
        } else if path.extension().is_some_and(|e| e == "rs") {
            out.push(path);
        }
    }
}

/// Whether a file is only compiled for tests: its parent module says so.
fn is_test_only(file: &Path) -> bool {
    let stem = file.file_stem().unwrap_or_default().to_string_lossy();
    let folder = file.parent().expect("inside src");
    let folder_name = folder.file_name().unwrap_or_default().to_string_lossy();
    // `a/b.rs` is declared in `a/mod.rs` or `a.rs`, or by `#[path]` in a neighbour.
    let mut neighbours = Vec::new();
    sources(folder, &mut neighbours);
    neighbours.push(folder.with_file_name(format!("{folder_name}.rs")));
    // What a file of tests declares is of tests, too.
    let parent = folder.with_file_name(format!("{folder_name}.rs"));
    if parent.exists() && is_test_only(&parent) {
        return true;
    }
    neighbours.iter().any(|n| {
        let text = std::fs::read_to_string(n).unwrap_or_default();
        let guards = ["#[cfg(test)]", "#[cfg(all(test, unix))]"];
        guards.iter().any(|guard| {
            text.contains(&format!("{guard}\nmod {stem};"))
                || text.contains(&format!("{guard}\npub(crate) mod {stem};"))
                || text.contains(&format!("{guard}\n#[path = \"{stem}.rs\"]"))
        })
    })
}

/// Rooms that a file names by `crate::<room>`, outside of its tests.
fn imports(text: &str) -> Vec<String> {
    let text = text.split("#[cfg(test)]\nmod tests {").next().unwrap_or("");
    let mut found = Vec::new();
    for (at, _) in text.match_indices("crate::") {
        let rest = &text[at + "crate::".len()..];
        if let Some(list) = rest.strip_prefix('{') {
            let list = list.split('}').next().unwrap_or("");
            found.extend(
                list.split(',')
                    .map(|w| w.trim().split("::").next().unwrap_or("").to_owned()),
            );
        } else {
            let word: String = rest
                .chars()
                .take_while(|c| c.is_alphanumeric() || *c == '_')
                .collect();
            found.push(word);
        }
    }
    found
}

#[test]
fn rooms_import_only_what_the_table_allows() {
    let table = table();
    assert!(table.len() >= 12, "the room table was not found: {table:?}");
    let rooms: Vec<&String> = table.keys().collect();
    let mut edges = 0;
    for (room, may) in &table {
        if room == "cli" {
            continue;
        }
        let mut files = Vec::new();
        sources(&root().join("src").join(room), &mut files);
        for file in files {
            if is_test_only(&file) {
                continue;
            }
            let text = std::fs::read_to_string(&file).expect("source");
            for import in imports(&text) {
                if import == *room || !rooms.contains(&&import) {
                    continue;
                }
                edges += 1;
                let everything = may.first().is_some_and(|w| w == "all");
                let allowed = if everything {
                    let excluded = may.iter().skip_while(|w| *w != "but").any(|w| *w == import);
                    !excluded
                } else {
                    may.contains(&import)
                };
                assert!(
                    allowed,
                    "{} imports {import}, which room {room} may not",
                    file.display()
                );
            }
        }
    }
    assert!(
        edges > 20,
        "only {edges} edges found: the test looks in the wrong place"
    );
}

#[test]
fn only_the_rooms_with_a_licence_for_it_do_io() {
    let mut files = Vec::new();
    sources(&root().join("src"), &mut files);
    for file in files {
        let relative = file
            .strip_prefix(root().join("src"))
            .expect("inside")
            .to_owned();
        let room = relative
            .iter()
            .next()
            .unwrap_or_default()
            .to_string_lossy()
            .into_owned();
        if [
            "link",
            "recording",
            "rig",
            "drive",
            "calibrate",
            "lab",
            "cli",
        ]
        .contains(&room.as_str())
        {
            continue;
        }
        let text = std::fs::read_to_string(&file).expect("source");
        let text = text.split("#[cfg(test)]\nmod tests {").next().unwrap_or("");
        if is_test_only(&file) {
            continue;
        }
        for word in ["std::fs", "std::net", "println!", "File::", "serialport"] {
            assert!(!text.contains(word), "{} uses {word}", file.display());
        }
    }
}
