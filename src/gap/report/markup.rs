//! Numbers with their errors, and pictures as they stand in the page.

pub use crate::charts::svg::number;
pub(super) use crate::charts::svg::{at, escape, fixed, label, line, path, rect, ticks};

/// Smaller errors are shown as below it.
const LEAST_ERROR: f64 = 1e-3;

/// `value ± error`, to two digits of the error; `value ± < 0.001` for smaller ones.
pub fn with_error(value: f64, error: f64) -> String {
    if !(error.is_finite() && error > 0.0) {
        return number(value);
    }
    if error < LEAST_ERROR {
        let value = match value.abs() < 0.5 * LEAST_ERROR {
            true => "0".to_owned(),
            false => fixed(value, 3),
        };
        return format!("{value} ± < {LEAST_ERROR}");
    }
    let decimals = decimals(error);
    format!("{} ± {}", fixed(value, decimals), fixed(error, decimals))
}

/// Decimals that show two digits of an uncertainty.
pub(super) fn decimals(uncertainty: f64) -> usize {
    (1 - uncertainty.log10().floor() as i32).clamp(0, 6) as usize
}

/// A share as percent; an en dash where there is none.
pub(super) fn percent(share: f64) -> String {
    if share.is_finite() {
        format!("{} %", fixed(100.0 * share, 0))
    } else {
        "–".to_owned()
    }
}

/// Bytes as base64 (RFC 4648, section 4).
pub(super) fn base64(bytes: &[u8]) -> String {
    const SIGNS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut out = String::with_capacity(bytes.len().div_ceil(3) * 4);
    for chunk in bytes.chunks(3) {
        let at = |i: usize| u32::from(chunk.get(i).copied().unwrap_or(0));
        let word = at(0) << 16 | at(1) << 8 | at(2);
        for i in 0..4 {
            if i <= chunk.len() {
                out.push(char::from(SIGNS[(word >> (18 - 6 * i) & 63) as usize]));
            } else {
                out.push('=');
            }
        }
    }
    out
}

/// An SVG element with a title for screen readers. `width` and `height` are in its own units.
pub(super) fn svg(width: f64, height: f64, title: &str, body: &str) -> String {
    // Wide pictures scroll on a phone before their text gets too small.
    let class = if width > 600.0 { "wide" } else { "narrow" };
    format!(
        "<div class=\"scroll\"><svg class=\"{class}\" xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {} {}\" \
         role=\"img\"><title>{}</title>\n{body}</svg></div>\n",
        at(width),
        at(height),
        escape(title)
    )
}
