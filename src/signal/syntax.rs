//! Errors of TOML files as one line.

/// What is wrong with a TOML text and where, as `line 3, column 5: what`.
///
/// The parser's own message quotes the line on lines of its own, which no status line and no log can show.
pub fn toml_error(text: &str, e: &toml::de::Error) -> String {
    let at = e.span().map_or(0, |s| s.start).min(text.len());
    let before = text.get(..at).unwrap_or_default();
    let line = before.matches('\n').count() + 1;
    let column = before.chars().rev().take_while(|c| *c != '\n').count() + 1;
    let what = e.message().trim().replace('\n', " ");
    format!("line {line}, column {column}: {what}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_place_is_named_on_one_line() {
        let of = |text: &str| {
            let e = toml::from_str::<toml::Table>(text).expect_err(text);
            toml_error(text, &e)
        };
        let e = of("a = 1\nb = x\n");
        assert!(
            e.starts_with("line 2, column 5: ") && !e.contains('\n'),
            "{e}"
        );
        let e = of("ä = \"");
        assert!(e.starts_with("line 1, ") && !e.contains('\n'), "{e}");
    }
}
