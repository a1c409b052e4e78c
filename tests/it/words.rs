//! The words of the documentation, the messages and the labels: terms that a textbook would not use are out.
//!
//! A page or comment that needs one of them as an ordinary word goes to [`ALLOWED`], with the reason.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

/// What is out, and what to write instead. Words in a row match words in a row, whatever stands between them but
/// letters; `tell*` matches any ending. A term with a capital letter matches as it stands, others in any case.
const OUT: &[(&str, &str)] = &[
    ("anew", "again, recomputed, restarted"),
    ("for good", "and stays within, until the end of the run"),
    ("left over", "residual, remaining"),
    ("leave over", "residual"),
    ("leaves over", "residual"),
    ("what lasts", "bias, persistent bias"),
    ("go along with", "correlated with"),
    ("goes along with", "correlated with"),
    ("went along with", "correlated with"),
    ("chance reaches", "significance threshold"),
    ("knob*", "calibration parameter, parameter"),
    ("doubt*", "standard deviation, uncertainty, extra_sigma"),
    ("weather", "fault schedule"),
    ("suffer*", "apply"),
    ("jolt*", "apply, disturbance"),
    ("alien*", "unmodelled effects"),
    ("nature", "plant, ground truth"),
    ("mend*", "apply (a patch), repair (a rig)"),
    ("take back off", "revert"),
    ("takes back off", "revert"),
    ("tell", "report, distinguish, show"),
    ("tells", "reports, distinguishes, shows"),
    ("telling", "reporting, distinguishing"),
    ("told", "reported, commanded, reconstructed"),
    ("says", "states, shows, prints"),
    ("said", "stated, shown, printed"),
    ("unasked", "without --overwrite, by itself"),
    ("argue* against", "is inconsistent with"),
    ("room", "module, space, capacity"),
    ("rooms", "modules"),
    ("door", "interface"),
    ("doors", "interfaces"),
    ("house", "structure, program"),
    ("deed*", "action, command"),
    ("tube*", "bellows, chamber, central tube"),
    ("up-down", "hysteresis"),
    ("LOOK", "WARN"),
    ("pull* back", "Jacobian transpose, generalized force"),
    ("swing to", "step_dynamics"),
    ("swings to", "step_dynamics"),
    ("creep to", "step_overdamped"),
    ("creeps to", "step_overdamped"),
];

/// Pages that are held to the list, besides those of the guide.
const PAGES: &[&str] = &[
    "README.md",
    "ARCHITECTURE.md",
    "CHANGELOG.md",
    "SECURITY.md",
];
/// Where a word on the list is meant as an ordinary word: the end of the file's path, words around it, why.
const ALLOWED: &[(&str, &str, &str)] = &[("", "central tube", "the backbone of a segment")];

/// A run of text and the line where it begins.
struct Text {
    line: usize,
    text: String,
}

/// The prose of a page in Markdown: no code, no targets of links, no comments.
fn prose(page: &str) -> Vec<Text> {
    let mut is_code = false;
    let mut out = Vec::new();
    for (i, line) in page.lines().enumerate() {
        if line.trim_start().starts_with("```") {
            is_code = !is_code;
            continue;
        }
        if !is_code {
            out.push(Text {
                line: i + 1,
                text: without_code(line),
            });
        }
    }
    out
}

/// A line without `code` and without the targets of links.
fn without_code(line: &str) -> String {
    let plain: String = line.split('`').step_by(2).collect::<Vec<_>>().join(" ` ");
    let mut out = String::new();
    let mut rest = plain.as_str();
    while let Some((before, after)) = rest.split_once("](") {
        out.push_str(before);
        out.push(' ');
        rest = after.split_once(')').map_or("", |(_, behind)| behind);
    }
    out.push_str(rest);
    out
}

/// Comments of documentation, and literals that a reader may see, of a source file up to its tests.
fn visible(source: &str) -> Vec<Text> {
    let source = source
        .split("#[cfg(test)]\nmod tests {")
        .next()
        .unwrap_or_default();
    let bytes = source.as_bytes();
    let (mut out, mut i, mut line) = (Vec::new(), 0, 1);
    while i < bytes.len() {
        let rest = &source[i..];
        if bytes[i] == b'\n' {
            line += 1;
            i += 1;
        } else if rest.starts_with("//") {
            let end = rest.find('\n').unwrap_or(rest.len());
            let comment = &rest[..end];
            if let Some(text) = comment
                .strip_prefix("///")
                .or_else(|| comment.strip_prefix("//!"))
            {
                let text = without_code(text);
                out.push(Text { line, text });
            }
            i += end;
        } else if let Some((literal, length)) = literal(rest, i.checked_sub(1).map(|b| bytes[b])) {
            // Names and keys have no blank and begin small; they are not prose.
            let begins_large = literal.starts_with(|c: char| c.is_uppercase());
            if literal.contains(' ') || begins_large {
                let text = without_code(&literal.replace("\\n", " \n "));
                out.push(Text { line, text });
            }
            line += rest[..length].matches('\n').count();
            i += length;
        } else if let Some(after) = rest.strip_prefix('\'') {
            // A character, so that '"' begins no literal; a lifetime otherwise.
            let is_escaped = after.starts_with('\\');
            let mut chars = after.char_indices().skip(1);
            let close = chars.find(|(at, c)| *c == '\'' && !(is_escaped && *at == 1));
            let length = close.filter(|(at, _)| *at <= 11).map(|(at, _)| at + 2);
            i += length.unwrap_or(1);
        } else {
            i += rest.chars().next().map_or(1, char::len_utf8);
        }
    }
    out
}

/// A literal at the beginning of `rest`, and its length in bytes with its quotes.
fn literal(rest: &str, before: Option<u8>) -> Option<(String, usize)> {
    let is_name = before.is_some_and(|b| b.is_ascii_alphanumeric() || b == b'_');
    if let Some(after) = rest.strip_prefix('r').filter(|_| !is_name) {
        let hashes = after.len() - after.trim_start_matches('#').len();
        let body = after[hashes..].strip_prefix('"')?;
        let close = format!("\"{}", "#".repeat(hashes));
        let end = body.find(&close)?;
        return Some((body[..end].to_owned(), 1 + hashes + 1 + end + close.len()));
    }
    let body = rest.strip_prefix('"')?;
    let mut is_escaped = false;
    let end = body.find(|c| {
        let closes = c == '"' && !is_escaped;
        is_escaped = c == '\\' && !is_escaped;
        closes
    })?;
    Some((body[..end].to_owned(), end + 2))
}

/// Words of some texts in order, each with its line.
fn words(texts: &[Text]) -> Vec<(&str, usize)> {
    let mut out = Vec::new();
    for Text { line, text } in texts {
        for (n, part) in text.split('\n').enumerate() {
            let is_letter = |c: char| c.is_alphanumeric() || c == '-' || c == '_' || c == '`';
            let found = part.split(|c| !is_letter(c)).filter(|w| !w.is_empty());
            out.extend(found.map(|w| (w, line + n)));
        }
    }
    out
}

/// Whether a word is the one of a pattern.
fn is_it(pattern: &str, word: &str) -> bool {
    let word = match pattern.chars().any(char::is_uppercase) {
        true => word.to_owned(),
        false => word.to_lowercase(),
    };
    match pattern.strip_suffix('*') {
        Some(stem) => word.starts_with(stem),
        None => word == pattern,
    }
}

/// Complaints about a file: line, word, what to write instead.
fn complaints(file: &str, texts: &[Text]) -> String {
    let words = words(texts);
    let mut out = String::new();
    for (pattern, instead) in OUT {
        let pattern: Vec<&str> = pattern.split(' ').collect();
        for (at, window) in words.windows(pattern.len()).enumerate() {
            if !pattern.iter().zip(window).all(|(p, (w, _))| is_it(p, w)) {
                continue;
            }
            let around = &words[at.saturating_sub(3)..(at + pattern.len() + 3).min(words.len())];
            let around: Vec<&str> = around.iter().map(|(w, _)| *w).collect();
            let around = around.join(" ");
            let is_allowed = |(end, some, _): &&(&str, &str, &str)| {
                file.ends_with(end) && around.to_lowercase().contains(some)
            };
            if ALLOWED.iter().find(is_allowed).is_none() {
                let _ = writeln!(
                    out,
                    "{file}:{}: '{}' (... {around} ...): write {instead}",
                    window[0].1,
                    pattern.join(" ")
                );
            }
        }
    }
    out
}

fn root() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
}

/// Files with this ending in a folder and below.
fn files(folder: &Path, ending: &str, out: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(folder).expect("a folder") {
        let path = entry.expect("an entry").path();
        if path.is_dir() {
            files(&path, ending, out);
        } else if path.extension().is_some_and(|e| e == ending) {
            out.push(path);
        }
    }
}

/// Whether a source file is only compiled for tests.
fn is_of_tests(file: &Path) -> bool {
    let name = |p: &Path| {
        p.file_stem()
            .unwrap_or_default()
            .to_string_lossy()
            .into_owned()
    };
    file.ancestors()
        .any(|p| name(p) == "tests" || name(p).ends_with("_tests") || name(p) == "fixture")
}

#[test]
fn pages_and_messages_use_the_terms_of_the_textbooks() {
    let mut out = String::new();
    let mut check = |path: &Path, texts: &dyn Fn(&str) -> Vec<Text>| {
        let text = std::fs::read_to_string(path).expect("a file");
        let name = path.strip_prefix(root()).expect("inside");
        out += &complaints(&name.to_string_lossy(), &texts(&text));
    };
    for page in PAGES {
        check(&root().join(page), &prose);
    }
    let mut pages = Vec::new();
    files(&root().join("assets/guide"), "md", &mut pages);
    for page in &pages {
        check(page, &prose);
    }
    let mut sources = Vec::new();
    files(&root().join("src"), "rs", &mut sources);
    assert!(pages.len() > 12 && sources.len() > 80, "files are missing");
    for source in sources.iter().filter(|s| !is_of_tests(s)) {
        check(source, &visible);
    }
    assert!(out.is_empty(), "\n{out}");
}

#[test]
fn the_check_sees_prose_and_nothing_else() {
    let source = "/// Told by `told`.\nfn f<'a>(c: char) {\n    // told\n    let told = '\"';\n    \
                  g(\"told\", \"it is told\", r#\"Room for \"all\"\"#);\n}\n\
                  #[cfg(test)]\nmod tests {\n    const T: &str = \"it is told\";\n}\n";
    let found = complaints("f.rs", &visible(source));
    let lines: Vec<&str> = found
        .lines()
        .map(|l| l.split(": write").next().expect("one"))
        .collect();
    assert_eq!(
        lines,
        [
            "f.rs:1: 'told' (... Told by ` it ...)",
            "f.rs:5: 'told' (... ` it is told Room for all ...)",
            "f.rs:5: 'room' (... it is told Room for all ...)",
        ],
        "{found}"
    );
    let page = "It is left\nover [told](told.md) `told`\n```\ntold\n```\ntellurium\n";
    let found = complaints("p.md", &prose(page));
    assert_eq!(found.lines().count(), 2, "{found}");
    assert!(found.starts_with("p.md:1: 'left over'"), "{found}");
}
