//! How far twin and arm disagree, as the live monitor finds it.

/// How far twin and arm disagree.
#[derive(Clone, Debug, PartialEq)]
pub struct Disagreement {
    /// Time of the newest reading that is judged, s.
    pub t_s: f64,
    /// Root mean square error, in units of what a rig in order has, over its limit: above 1 they disagree.
    pub ratio: f64,
    /// The channel with the largest error.
    pub channel: String,
    /// When the error was last that of a rig in order, s.
    pub since_s: f64,
    /// The effects that the errors look most like, the likeliest first; no verdict.
    pub likely: Vec<String>,
    /// Effects that are known and count no longer.
    pub muted: Vec<String>,
}

impl Disagreement {
    /// Whether twin and arm disagree.
    pub fn is_off(&self) -> bool {
        self.ratio > 1.0
    }

    /// What it looks like: `" It looks like a, b or c."`; empty where nothing stands out.
    pub fn looks_like(&self) -> String {
        match self.likely.as_slice() {
            [] => String::new(),
            [one] => format!(" It looks like {one}."),
            [first @ .., last] => format!(" It looks like {} or {last}.", first.join(", ")),
        }
    }
}
