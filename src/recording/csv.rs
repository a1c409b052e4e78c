//! Lines and fields of comma-separated files as instruments and spreadsheets write them.

use std::io::BufRead;
use std::path::Path;

use super::RecordingError;

/// Default limit on the length of a line, bytes. A session log's line is about 500.
const LINE_MAX: usize = 64 * 1024;

/// Reads lines with a bound on their length, counting them.
pub(crate) struct Lines<'a, R> {
    reader: R,
    path: &'a Path,
    buffer: Vec<u8>,
    /// Longest line that is accepted, bytes.
    max: usize,
    /// Number of the line that was read last, 1-based.
    pub(crate) line: usize,
    /// Called with all bytes as they stand in the file.
    tap: &'a mut dyn FnMut(&[u8]),
}

impl<'a, R: BufRead> Lines<'a, R> {
    pub(crate) fn new(reader: R, path: &'a Path, tap: &'a mut dyn FnMut(&[u8])) -> Self {
        Self::with_max(reader, path, tap, LINE_MAX)
    }

    /// As [`Lines::new`], for files whose lines may be `max` bytes long.
    pub(crate) fn with_max(
        reader: R,
        path: &'a Path,
        tap: &'a mut dyn FnMut(&[u8]),
        max: usize,
    ) -> Self {
        Self {
            reader,
            path,
            buffer: Vec::new(),
            max,
            line: 0,
            tap,
        }
    }

    /// The next line without its end (LF or CRLF) and without a leading byte-order mark;
    /// `None` at the end of the file.
    pub(crate) fn next_line(&mut self) -> Result<Option<&str>, RecordingError> {
        self.buffer.clear();
        let mut limited = std::io::Read::take(&mut self.reader, self.max as u64 + 1);
        let n = limited
            .read_until(b'\n', &mut self.buffer)
            .map_err(RecordingError::io(self.path, "read"))?;
        if n == 0 {
            return Ok(None);
        }
        self.line += 1;
        (self.tap)(&self.buffer);
        if n > self.max {
            return Err(self.error(1, format!("the line is longer than {} bytes", self.max)));
        }
        let mut bytes = self.buffer.as_slice();
        if self.line == 1 {
            bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
        }
        bytes = bytes.strip_suffix(b"\n").unwrap_or(bytes);
        bytes = bytes.strip_suffix(b"\r").unwrap_or(bytes);
        match std::str::from_utf8(bytes) {
            Ok(text) => Ok(Some(text)),
            Err(e) => {
                let before = &bytes[..e.valid_up_to()];
                let column = 1 + before.iter().filter(|b| **b == b',').count();
                Err(self.error(
                    column,
                    "the text is not UTF-8: save the file as UTF-8".to_owned(),
                ))
            }
        }
    }

    fn error(&self, column: usize, text: String) -> RecordingError {
        RecordingError::Cell {
            path: self.path.to_owned(),
            line: self.line,
            column,
            text,
        }
    }
}

/// The fields of one line: commas separate them, double quotes may enclose one (doubled inside
/// for a literal one), blanks around a field do not count.
///
/// # Errors
/// The 1-based field and a sentence, when a quote is not closed or text follows a closed one.
pub(crate) fn fields(line: &str) -> Result<Vec<std::borrow::Cow<'_, str>>, (usize, &'static str)> {
    use std::borrow::Cow;
    let mut out = Vec::new();
    let mut rest = line;
    loop {
        let start = rest.trim_start_matches([' ', '\t']);
        if let Some(mut inner) = start.strip_prefix('"') {
            let mut text = String::new();
            loop {
                let Some(end) = inner.find('"') else {
                    return Err((out.len() + 1, "the quote is not closed on this line"));
                };
                text.push_str(&inner[..end]);
                inner = &inner[end + 1..];
                match inner.strip_prefix('"') {
                    Some(after) => {
                        text.push('"');
                        inner = after;
                    }
                    None => break,
                }
            }
            out.push(Cow::Owned(text.trim().to_owned()));
            let inner = inner.trim_start_matches([' ', '\t']);
            if inner.is_empty() {
                return Ok(out);
            }
            rest = inner
                .strip_prefix(',')
                .ok_or((out.len(), "text follows the closing quote"))?;
        } else {
            let (field, after) = match start.split_once(',') {
                Some((field, after)) => (field, Some(after)),
                None => (start, None),
            };
            out.push(Cow::Borrowed(field.trim()));
            match after {
                Some(after) => rest = after,
                None => return Ok(out),
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn quotes_and_blanks() {
        assert_eq!(
            fields("1, 2 ,,\"4\",\"a\"\"b\" , ").unwrap(),
            ["1", "2", "", "4", "a\"b", ""]
        );
        assert_eq!(fields("").unwrap(), [""]);
        assert_eq!(fields("1,\"2").unwrap_err().0, 2);
        assert_eq!(fields("1,2,\"3\"4").unwrap_err().0, 3);
    }

    proptest! {
        /// What is quoted by the rule comes back, whatever it is.
        #[test]
        fn quoted_fields_come_back(cells in prop::collection::vec("[a-z\",.; 0-9]{0,8}", 1..8)) {
            let line = cells
                .iter()
                .map(|c| format!("\"{}\"", c.replace('"', "\"\"")))
                .collect::<Vec<_>>()
                .join(",");
            let back = fields(&line).unwrap();
            prop_assert_eq!(back.len(), cells.len());
            for (b, c) in back.iter().zip(&cells) {
                prop_assert_eq!(b.as_ref(), c.trim());
            }
        }

        #[test]
        fn any_line_is_taken_or_refused(line in "\\PC{0,80}") {
            let commas = line.matches(',').count();
            if let Ok(f) = fields(&line) {
                prop_assert!(f.len() <= commas + 1);
            }
        }
    }
}
