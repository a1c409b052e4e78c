//! Modules import only what ARCHITECTURE.md allows, and no file imports a file that, directly or through others,
//! imports it.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

fn root() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
}

/// The table of modules: module, what it may import.
fn table() -> BTreeMap<String, Vec<String>> {
    let text = std::fs::read_to_string(root().join("ARCHITECTURE.md")).expect("ARCHITECTURE.md");
    let mut modules = BTreeMap::new();
    for line in text.lines().filter(|l| l.starts_with("| `")) {
        let cells: Vec<&str> = line.trim_matches('|').split('|').map(str::trim).collect();
        let name = cells[0].split('`').nth(1).unwrap_or_default().to_owned();
        let words = cells[2]
            .split(|c: char| !c.is_alphanumeric() && c != '_')
            .filter(|w| !w.is_empty())
            .map(str::to_owned)
            .collect();
        modules.insert(name, words);
    }
    modules
}

/// Words and `::`, other characters one by one; without comments, texts, lifetimes and what is compiled for tests only.
fn tokens(text: &str) -> Vec<String> {
    let chars: Vec<char> = text.chars().collect();
    let at = |i: usize| chars.get(i).copied().unwrap_or('\0');
    let mut out: Vec<String> = Vec::new();
    let mut i = 0;
    while i < chars.len() {
        let c = chars[i];
        if c == '/' && at(i + 1) == '/' {
            while i < chars.len() && chars[i] != '\n' {
                i += 1;
            }
        } else if c == '/' && at(i + 1) == '*' {
            i += 2;
            while i < chars.len() && !(chars[i] == '*' && at(i + 1) == '/') {
                i += 1;
            }
            i += 2;
        } else if c == 'r' && (at(i + 1) == '"' || at(i + 1) == '#' && "#\"".contains(at(i + 2))) {
            let marks = chars[i + 1..].iter().take_while(|c| **c == '#').count();
            i += 2 + marks;
            while i < chars.len() && !(chars[i] == '"' && (1..=marks).all(|k| at(i + k) == '#')) {
                i += 1;
            }
            i += 1 + marks;
        } else if c == '"' {
            i += 1;
            while i < chars.len() && chars[i] != '"' {
                i += 1 + usize::from(chars[i] == '\\');
            }
            i += 1;
        } else if c == '\'' {
            // A character, or a lifetime.
            i += if at(i + 1) == '\\' {
                let end = (i + 3..chars.len()).find(|k| chars[*k] == '\'');
                end.map_or(1, |end| end + 1 - i)
            } else if at(i + 2) == '\'' {
                3
            } else {
                1
            };
        } else if c.is_alphanumeric() || c == '_' {
            let word: String = chars[i..]
                .iter()
                .take_while(|c| c.is_alphanumeric() || **c == '_')
                .collect();
            i += word.chars().count();
            out.push(word);
        } else if c == ':' && at(i + 1) == ':' {
            out.push("::".to_owned());
            i += 2;
        } else {
            if !c.is_whitespace() {
                out.push(c.to_string());
            }
            i += 1;
        }
    }
    without_tests(&out)
}

/// Index behind the bracket that closes the one at `open`.
fn closed(tokens: &[String], open: usize) -> usize {
    let mut depth = 0;
    for (k, token) in tokens.iter().enumerate().skip(open) {
        match token.as_str() {
            "(" | "[" | "{" => depth += 1,
            ")" | "]" | "}" => depth -= 1,
            _ => {}
        }
        if depth == 0 {
            return k + 1;
        }
    }
    tokens.len()
}

/// Leaves out every item behind `#[cfg(test)]` and the like.
fn without_tests(tokens: &[String]) -> Vec<String> {
    let mut out = Vec::new();
    let mut i = 0;
    while i < tokens.len() {
        if tokens[i] == "#" && tokens.get(i + 1).is_some_and(|t| t == "[") {
            let end = closed(tokens, i + 1);
            let words = &tokens[i + 1..end];
            let of_tests = words.get(1).is_some_and(|w| w == "cfg")
                && words.iter().any(|w| w == "test")
                && !words.iter().any(|w| w == "not");
            if of_tests {
                // To the end of the item: a block, or a semicolon before any.
                let mut k = end;
                while k < tokens.len() && tokens[k] != ";" && tokens[k] != "{" {
                    k = match tokens[k].as_str() {
                        "(" | "[" => closed(tokens, k),
                        _ => k + 1,
                    };
                }
                i = match tokens.get(k).map(String::as_str) {
                    Some("{") => closed(tokens, k),
                    _ => k + 1,
                };
                continue;
            }
        }
        out.push(tokens[i].clone());
        i += 1;
    }
    out
}

/// A module in a file of its own.
struct Module {
    file: PathBuf,
    tokens: Vec<String>,
    /// What it makes public of others: name (`*` for all), path.
    reexports: Vec<(String, Vec<String>)>,
    /// What it imports: local name, path.
    imports: Vec<(String, Vec<String>)>,
}

/// The modules of a crate by path, `["cli", "window"]`.
type Modules = BTreeMap<Vec<String>, Module>;

/// The names that a `use` brings in, with their paths. `i` is behind the word `use`.
fn used(tokens: &[String], i: usize) -> Vec<(String, Vec<String>)> {
    let end = tokens[i..]
        .iter()
        .position(|t| t == ";")
        .map_or(tokens.len(), |k| i + k);
    let mut out = Vec::new();
    tree(&tokens[i..end], &[], &mut out);
    out
}

fn tree(tokens: &[String], before: &[String], out: &mut Vec<(String, Vec<String>)>) {
    let mut path = before.to_vec();
    let mut i = 0;
    while i < tokens.len() {
        match tokens[i].as_str() {
            "::" => i += 1,
            "{" => {
                let end = closed(tokens, i) - 1;
                let inner = &tokens[i + 1..end];
                let mut from = 0;
                let mut k = 0;
                while k <= inner.len() {
                    if k == inner.len() || inner[k] == "," {
                        if from < k {
                            tree(&inner[from..k], &path, out);
                        }
                        from = k + 1;
                        k += 1;
                    } else if inner[k] == "{" {
                        k = closed(inner, k);
                    } else {
                        k += 1;
                    }
                }
                return;
            }
            "as" => {
                let name = tokens.get(i + 1).cloned().unwrap_or_default();
                out.push((name, path));
                return;
            }
            word => {
                if word != "self" || path.is_empty() {
                    path.push(word.to_owned());
                }
                i += 1;
            }
        }
    }
    let name = path.last().cloned().unwrap_or_default();
    out.push((name, path));
}

/// Reads a module's file and those of its children.
fn read(file: &Path, path: Vec<String>, modules: &mut Modules) {
    let text = std::fs::read_to_string(file).unwrap_or_else(|e| panic!("{}: {e}", file.display()));
    let tokens = tokens(&text);
    let (mut reexports, mut imports, mut children) = (Vec::new(), Vec::new(), Vec::new());
    for i in 0..tokens.len() {
        match tokens[i].as_str() {
            "use" => {
                let public = i > 0 && (tokens[i - 1] == "pub" || tokens[i - 1] == ")");
                let list = if public { &mut reexports } else { &mut imports };
                list.extend(used(&tokens, i + 1));
            }
            "mod" if tokens.get(i + 2).is_some_and(|t| t == ";") => {
                children.push(tokens[i + 1].clone());
            }
            _ => {}
        }
    }
    let stem = file.file_stem().unwrap_or_default().to_string_lossy();
    let own = ["mod", "lib", "main"].contains(&stem.as_ref());
    let folder = match own {
        true => file.with_file_name(""),
        false => file.with_extension(""),
    };
    let module = Module {
        file: file.to_owned(),
        tokens,
        reexports,
        imports,
    };
    modules.insert(path.clone(), module);
    for child in children {
        let plain = folder.join(format!("{child}.rs"));
        let deep = folder.join(&child).join("mod.rs");
        let file = [plain, deep].into_iter().find(|f| f.exists());
        let mut path = path.clone();
        path.push(child);
        if let Some(file) = file
            && !modules.contains_key(&path)
        {
            read(&file, path, modules);
        }
    }
}

fn crate_of(main: &str) -> Modules {
    let mut modules = Modules::new();
    read(&root().join("src").join(main), Vec::new(), &mut modules);
    modules
}

/// The module in which the last name of `path`, written in module `at`, is defined; `None` for another crate.
fn resolve(modules: &Modules, at: &[String], path: &[String], depth: usize) -> Option<Vec<String>> {
    let mut here = at.to_vec();
    let mut rest = path;
    match path.first()?.as_str() {
        "crate" => {
            here.clear();
            rest = &path[1..];
        }
        "self" => rest = &path[1..],
        "super" => {
            while rest.first().is_some_and(|w| w == "super") {
                here.pop()?;
                rest = &rest[1..];
            }
        }
        first => {
            let mut child = here.clone();
            child.push(first.to_owned());
            if !modules.contains_key(&child) {
                let import = modules.get(at)?.imports.iter().find(|(n, _)| n == first)?;
                if depth == 0 || import.1.first().is_some_and(|w| w == first) {
                    return None;
                }
                let mut whole = import.1.clone();
                whole.extend_from_slice(&path[1..]);
                return resolve(modules, at, &whole, depth - 1);
            }
        }
    }
    while let Some(name) = rest.first() {
        let mut child = here.clone();
        child.push(name.clone());
        if modules.contains_key(&child) {
            here = child;
            rest = &rest[1..];
            continue;
        }
        let module = modules.get(&here)?;
        let named = module.reexports.iter().find(|(n, _)| n == name);
        if let Some((_, from)) = named
            && depth > 0
        {
            let mut whole = from.clone();
            whole.extend_from_slice(&rest[1..]);
            return resolve(modules, &here, &whole, depth - 1);
        }
        break;
    }
    modules.contains_key(&here).then_some(here)
}

/// The files that a module's code takes something from. What it only makes public again does not count.
fn edges(modules: &Modules, at: &[String]) -> BTreeSet<Vec<String>> {
    let module = &modules[at];
    let mut found = BTreeSet::new();
    for (_, path) in &module.imports {
        found.extend(resolve(modules, at, path, 8));
    }
    let tokens = &module.tokens;
    let mut i = 0;
    while i < tokens.len() {
        if tokens[i] == "use" {
            while i < tokens.len() && tokens[i] != ";" {
                i += 1;
            }
        }
        let starts =
            tokens.get(i + 1).is_some_and(|t| t == "::") && (i == 0 || tokens[i - 1] != "::");
        if !starts {
            i += 1;
            continue;
        }
        let mut path = vec![tokens[i].clone()];
        while tokens.get(i + 1).is_some_and(|t| t == "::")
            && tokens
                .get(i + 2)
                .is_some_and(|t| t.starts_with(|c: char| c.is_alphabetic() || c == '_'))
        {
            path.push(tokens[i + 2].clone());
            i += 2;
        }
        found.extend(resolve(modules, at, &path, 8));
        i += 1;
    }
    found.remove(at);
    found
}

/// Whether one of two modules lies inside the other: a file and its own children are one unit.
fn nested(a: &[String], b: &[String]) -> bool {
    a.starts_with(b) || b.starts_with(a)
}

/// What a module takes from files other than its parents and children.
fn sideways(modules: &Modules, at: &[String]) -> BTreeSet<Vec<String>> {
    let mut found = edges(modules, at);
    found.retain(|to| !nested(at, to));
    found
}

/// Sets of modules of which each reaches each other.
fn circles(modules: &Modules) -> Vec<Vec<Vec<String>>> {
    let graph: BTreeMap<_, _> = modules.keys().map(|m| (m, sideways(modules, m))).collect();
    let reached = |from: &Vec<String>| {
        let mut seen = BTreeSet::new();
        let mut next = vec![from.clone()];
        while let Some(m) = next.pop() {
            for to in &graph[&m] {
                if seen.insert(to.clone()) {
                    next.push(to.clone());
                }
            }
        }
        seen
    };
    let all: BTreeMap<_, _> = modules.keys().map(|m| (m.clone(), reached(m))).collect();
    let mut placed = BTreeSet::new();
    let mut out = Vec::new();
    for (m, seen) in &all {
        if !seen.contains(m) || placed.contains(m) {
            continue;
        }
        let circle: Vec<_> = seen
            .iter()
            .filter(|n| all[*n].contains(m))
            .cloned()
            .collect();
        placed.extend(circle.iter().cloned());
        out.push(circle);
    }
    out
}

fn name(modules: &Modules, m: &[String]) -> String {
    let file = &modules[m].file;
    let file = file.strip_prefix(root()).unwrap_or(file);
    file.display().to_string()
}

#[test]
fn modules_import_only_what_the_table_allows() {
    let table = table();
    assert!(
        table.len() >= 12,
        "the table of modules was not found: {table:?}"
    );
    let modules = crate_of("lib.rs");
    let mut seen = 0;
    for at in modules.keys().filter(|m| !m.is_empty()) {
        let may = table.get(&at[0]);
        let may = may.unwrap_or_else(|| panic!("ARCHITECTURE.md has no row for {}", at[0]));
        for to in edges(&modules, at) {
            let Some(other) = to.first().filter(|o| **o != at[0]) else {
                continue;
            };
            seen += 1;
            let everything = may.first().is_some_and(|w| w == "all");
            let allowed = if everything {
                let mut but = may.iter().skip_while(|w| *w != "but");
                !but.any(|w| w == other)
            } else {
                may.contains(other)
            };
            let file = name(&modules, at);
            assert!(allowed, "{file} imports {other}, which {} may not", at[0]);
        }
    }
    assert!(
        seen > 100,
        "only {seen} imports found: the test looks in the wrong place"
    );
}

#[test]
fn no_file_imports_one_that_imports_it() {
    let mut found = Vec::new();
    for main in ["lib.rs", "main.rs"] {
        let modules = crate_of(main);
        assert!(modules.len() > 20, "{main} has {} modules", modules.len());
        for circle in circles(&modules) {
            let mut lines = Vec::new();
            for from in &circle {
                for to in sideways(&modules, from)
                    .iter()
                    .filter(|t| circle.contains(t))
                {
                    lines.push(format!(
                        "  {} -> {}",
                        name(&modules, from),
                        name(&modules, to)
                    ));
                }
            }
            found.push(lines.join("\n"));
        }
    }
    assert!(
        found.is_empty(),
        "{} circles:\n{}",
        found.len(),
        found.join("\n\n")
    );
}

#[test]
fn no_path_climbs_two_modules() {
    for main in ["lib.rs", "main.rs"] {
        let modules = crate_of(main);
        for (at, module) in &modules {
            let climbs = module
                .tokens
                .windows(3)
                .any(|w| w[0] == "super" && w[2] == "super");
            assert!(
                !climbs,
                "{}: write super::super as a path from crate",
                name(&modules, at)
            );
        }
    }
}

#[test]
fn only_the_modules_with_a_licence_for_it_do_io() {
    let modules = crate_of("lib.rs");
    for (at, module) in modules.iter().filter(|(m, _)| !m.is_empty()) {
        if ["calibrate", "drive", "lab", "link", "recording", "rig"].contains(&at[0].as_str()) {
            continue;
        }
        let tokens = &module.tokens;
        for words in tokens.windows(3) {
            let [a, path, c] = words else { continue };
            let does_io = a == "std" && ["fs", "net"].contains(&c.as_str())
                || ["serialport", "File"].contains(&a.as_str());
            let does_io = does_io && path == "::" || ["println", "eprintln"].contains(&a.as_str());
            assert!(!does_io, "{} uses {a}::{c}", name(&modules, at));
        }
    }
}
