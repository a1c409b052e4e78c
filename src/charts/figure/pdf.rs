//! A page of PDF (ISO 32000-1) with lines and texts, in Helvetica.

use std::fmt::Write as _;

use super::{Anchor, DASH_PT, FONT_PT, Mark, number};

/// Widths of the characters from space to tilde in Helvetica, thousandths of the font's size (Adobe's font metrics).
const WIDTHS: [u16; 95] = [
    278, 278, 355, 556, 556, 889, 667, 191, 333, 333, 389, 584, 278, 333, 278, 278, 556, 556, 556,
    556, 556, 556, 556, 556, 556, 556, 278, 278, 584, 584, 584, 556, 1015, 667, 667, 722, 722, 667,
    611, 778, 722, 278, 500, 667, 556, 833, 722, 778, 667, 778, 722, 667, 611, 722, 667, 944, 667,
    667, 611, 278, 278, 278, 469, 556, 333, 556, 556, 500, 556, 556, 278, 556, 556, 222, 222, 500,
    222, 833, 556, 556, 556, 556, 333, 500, 278, 556, 500, 722, 500, 500, 500, 334, 260, 334, 584,
];

/// Width of a text of [`FONT_PT`], points.
pub fn width_pt(text: &str) -> f64 {
    let of = |c: char| {
        let index = (c as usize).checked_sub(32);
        index.and_then(|i| WIDTHS.get(i)).copied().unwrap_or(556)
    };
    text.chars().map(|c| f64::from(of(c))).sum::<f64>() * 1e-3 * FONT_PT
}

/// A text as a string of PDF in WinAnsiEncoding. The minus sign, which that lacks, is its en dash; others that it lacks are
/// question marks.
fn string(text: &str) -> String {
    let mut out = String::from("(");
    for c in text.chars() {
        match c {
            '(' | ')' | '\\' => {
                out.push('\\');
                out.push(c);
            }
            ' '..='~' => out.push(c),
            '−' | '–' => out.push_str("\\226"),
            '…' => out.push_str("\\205"),
            '\u{a1}'..='\u{ff}' => {
                // Writing to a string does not fail.
                let _ = write!(out, "\\{:03o}", c as u32);
            }
            _ => out.push('?'),
        }
    }
    out.push(')');
    out
}

/// What is drawn. PDF counts y from below.
fn content([_, high]: [f64; 2], marks: &[Mark]) -> String {
    let mut out = String::from("1 j\n");
    for mark in marks {
        // Writing to a string does not fail.
        let _ = match mark {
            Mark::Line {
                points,
                width_pt,
                colour,
                dashed,
            } => {
                let [r, g, b] = colour.map(|c| format!("{:.3}", f64::from(c) / 255.0));
                let dash = match dashed {
                    true => format!("[{} {}] 0 d", DASH_PT[0], DASH_PT[1]),
                    false => "[] 0 d".to_owned(),
                };
                let _ = writeln!(out, "{width_pt} w {r} {g} {b} RG {dash}");
                for (k, [x, y]) in points.iter().enumerate() {
                    let sign = if k == 0 { 'm' } else { 'l' };
                    let _ = writeln!(out, "{} {} {sign}", number(*x), number(high - y));
                }
                writeln!(out, "S")
            }
            Mark::Text {
                at: [x, y],
                anchor,
                upright,
                text,
            } => {
                let back = match anchor {
                    Anchor::Start => 0.0,
                    Anchor::Middle => 0.5 * width_pt(text),
                    Anchor::End => width_pt(text),
                };
                let ([x, y], turn) = match upright {
                    true => ([*x, high - y - back], "0 1 -1 0"),
                    false => ([x - back, high - y], "1 0 0 1"),
                };
                let (x, y, text) = (number(x), number(y), string(text));
                writeln!(out, "BT /F1 {FONT_PT} Tf {turn} {x} {y} Tm {text} Tj ET")
            }
        };
    }
    out
}

/// A document of one page of this size, pt. Equal marks make equal bytes.
pub fn page(size_pt: [f64; 2], marks: &[Mark]) -> Vec<u8> {
    let [wide, high] = size_pt.map(number);
    let content = content(size_pt, marks);
    let objects = [
        "<< /Type /Catalog /Pages 2 0 R >>".to_owned(),
        "<< /Type /Pages /Kids [3 0 R] /Count 1 >>".to_owned(),
        format!(
            "<< /Type /Page /Parent 2 0 R /MediaBox [0 0 {wide} {high}] /Contents 4 0 R \
             /Resources << /Font << /F1 5 0 R >> >> >>"
        ),
        format!(
            "<< /Length {} >>\nstream\n{content}endstream",
            content.len()
        ),
        "<< /Type /Font /Subtype /Type1 /BaseFont /Helvetica /Encoding /WinAnsiEncoding >>"
            .to_owned(),
    ];
    let mut out = String::from("%PDF-1.4\n");
    let mut table = format!("xref\n0 {}\n0000000000 65535 f \n", objects.len() + 1);
    for (k, object) in objects.iter().enumerate() {
        let _ = writeln!(table, "{:010} 00000 n ", out.len());
        let _ = write!(out, "{} 0 obj\n{object}\nendobj\n", k + 1);
    }
    let start = out.len();
    let size = objects.len() + 1;
    let _ = write!(
        out,
        "{table}trailer\n<< /Size {size} /Root 1 0 R >>\nstartxref\n{start}\n%%EOF\n"
    );
    out.into_bytes()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_page_has_texts_as_text_and_a_table_that_points_at_its_objects() {
        let marks = [
            Mark::Line {
                points: vec![[10.0, 20.0], [30.0, 25.0]],
                width_pt: 0.9,
                colour: [255, 0, 51],
                dashed: true,
            },
            Mark::Text {
                at: [50.0, 40.0],
                anchor: Anchor::End,
                upright: false,
                text: "−1 (mm)".to_owned(),
            },
        ];
        let bytes = page([100.0, 60.0], &marks);
        let text = String::from_utf8(bytes).expect("ASCII");
        assert!(text.is_ascii() && text.starts_with("%PDF-1.4\n"));
        assert!(text.contains("(\\2261 \\(mm\\)) Tj"), "{text}");
        assert!(text.contains("/MediaBox [0 0 100 60]"));
        assert!(text.contains("10 40 m\n30 35 l\nS"), "{text}");
        assert!(text.contains("1.000 0.000 0.200 RG [3 2] 0 d"), "{text}");
        let start = text.split("startxref\n").nth(1).expect("a start");
        let start: usize = start
            .lines()
            .next()
            .expect("a line")
            .parse()
            .expect("a number");
        let table: Vec<&str> = text[start..].lines().collect();
        assert_eq!(table[..2], ["xref", "0 6"]);
        for (k, line) in table[3..8].iter().enumerate() {
            assert_eq!(line.len() + 1, 20, "each entry has twenty bytes");
            let at: usize = line[..10].parse().expect("a number");
            assert!(text[at..].starts_with(&format!("{} 0 obj\n", k + 1)));
        }
        let length = text.split("/Length ").nth(1).expect("a length");
        let length: usize = length
            .split(' ')
            .next()
            .expect("one")
            .parse()
            .expect("a number");
        let stream = text.split("stream\n").nth(1).expect("a stream");
        assert_eq!(stream.strip_suffix("end").expect("its end").len(), length);
    }

    #[test]
    fn widths_are_those_of_helvetica() {
        assert!((width_pt("Tip x") - 8e-3 * (611.0 + 222.0 + 556.0 + 278.0 + 500.0)).abs() < 1e-9);
        assert!((width_pt("−~") - 8e-3 * (556.0 + 584.0)).abs() < 1e-9);
    }
}
