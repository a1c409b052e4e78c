//! What every `session.toml` that is taken keeps.

use std::path::{Component, Path};

use springtwin::recording::parse_session_file;

/// Reads `text`: what is taken has a rate and a mass, and names a table of its own folder.
pub fn check(text: &str) {
    let Ok(file) = parse_session_file(text, Path::new("session.toml")) else {
        return;
    };
    assert!(file.rate_hz > 0.0 && file.rate_hz.is_finite());
    assert!(file.payload_kg >= 0.0 && file.payload_kg.is_finite());
    let log = Path::new(&file.log);
    let leaves = |c: Component<'_>| !matches!(c, Component::Normal(_) | Component::CurDir);
    assert!(
        !file.log.is_empty() && !log.components().any(leaves),
        "{log:?}"
    );
}
