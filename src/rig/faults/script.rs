//! Scripts of faults: a TOML file with one `[[fault]]` each.
//!
//! ```toml
//! [[fault]]
//! at_s = 5.0          # by the rig's time
//! for_s = 2.0         # without it: to the end
//! # spring 1-12, imu 1-4, gauge 1-6, chamber 1-6, counter 1-2, board 1-2, boards, port, supply, emergency stop,
//! # contact 1-2
//! where = "spring 3"
//! what = "stuck"
//! amount = 10.0       # where the fault has one
//! ```

use serde::Deserialize;

use super::{Fault, Place, Word, amount};
use crate::signal::{BOARDS, CHAMBERS, IMUS, SPRINGS};

const WORDS: [(&str, Word); 16] = [
    ("off", Word::Off),
    ("stuck", Word::Stuck),
    ("garbage", Word::Garbage),
    ("wrong", Word::Wrong),
    ("slow", Word::Slow),
    ("delayed", Word::Delayed),
    ("intermittent", Word::Intermittent),
    ("leak", Word::Leak),
    ("jump", Word::Jump),
    ("twice", Word::Twice),
    ("swapped", Word::Swapped),
    ("open", Word::Open),
    ("reboot", Word::Reboot),
    ("dtr", Word::Dtr),
    ("vents", Word::Vents),
    ("exchanged", Word::Exchanged),
];
const PLACES: &str = "spring 1-12, imu 1-4, gauge 1-6, chamber 1-6, counter 1-2, board 1-2, boards, \
     port, supply, emergency stop or contact 1-2 (of one board)";

/// Why a fault schedule is refused.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ScriptError {
    /// Not TOML, or not of this form.
    #[error("line {line}: {what}.")]
    Form {
        /// 1-based.
        line: usize,
        /// What is wrong there.
        what: String,
    },
    /// A fault that cannot be.
    #[error("fault {number}: {what}.")]
    Fault {
        /// 1-based.
        number: usize,
        /// What is wrong with it, and what would be right.
        what: String,
    },
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    #[serde(default)]
    fault: Vec<Entry>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Entry {
    at_s: f64,
    for_s: Option<f64>,
    #[serde(rename = "where")]
    place: String,
    what: String,
    amount: Option<f64>,
}

/// Fault schedule: faults that begin and end at set times.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Script {
    /// Time (s), place, and what it has from then on; in the order of time.
    edges: Vec<(f64, Place, Option<Fault>)>,
    next: usize,
}

impl Script {
    /// Reads a script.
    ///
    /// # Errors
    /// [`ScriptError`] naming the line or the fault.
    pub fn from_toml(text: &str) -> Result<Self, ScriptError> {
        let file: File = toml::from_str(text).map_err(|e| {
            let at = e.span().map_or(0, |s| s.start);
            ScriptError::Form {
                line: text.get(..at).unwrap_or_default().matches('\n').count() + 1,
                what: e.message().replace('\n', " "),
            }
        })?;
        let mut edges = Vec::new();
        for (k, entry) in file.fault.iter().enumerate() {
            let found = check(entry).map_err(|what| ScriptError::Fault {
                number: k + 1,
                what,
            })?;
            for (place, fault) in found {
                edges.push((entry.at_s, place, Some(fault)));
                edges.extend(entry.for_s.map(|for_s| (entry.at_s + for_s, place, None)));
            }
        }
        Ok(Self::of(edges))
    }

    /// From edges: time (s), place, and what it has from then on.
    pub fn of(mut edges: Vec<(f64, Place, Option<Fault>)>) -> Self {
        // What ends at the time something else begins ends first.
        edges.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.2.is_some().cmp(&b.2.is_some())));
        Self { edges, next: 0 }
    }

    /// Edges up to `t_s` that have not been applied yet.
    pub(super) fn due(&mut self, t_s: f64) -> Vec<(Place, Option<Fault>)> {
        let rest = &self.edges[self.next..];
        let due: Vec<_> = rest
            .iter()
            .take_while(|(at_s, ..)| *at_s <= t_s)
            .map(|(_, place, fault)| (*place, *fault))
            .collect();
        self.next += due.len();
        due
    }
}

fn check(entry: &Entry) -> Result<Vec<(Place, Fault)>, String> {
    let time = |t_s: f64| t_s.is_finite() && t_s >= 0.0;
    if !time(entry.at_s) || !entry.for_s.is_none_or(time) {
        return Err("at_s and for_s are seconds, 0 or more".to_owned());
    }
    let word = WORDS.iter().find(|(text, _)| *text == entry.what);
    let Some((_, word)) = word else {
        let words: Vec<_> = WORDS.iter().map(|(text, _)| *text).collect();
        return Err(format!(
            "'{}' is no fault: it is one of {}",
            entry.what,
            words.join(", ")
        ));
    };
    let places = places(&entry.place, *word)
        .ok_or_else(|| format!("'{}' is no place: it is {PLACES}", entry.place))?;
    let with = |place: Place| {
        let Some(range) = amount(place, *word) else {
            return Err(format!("{} cannot be '{}'", entry.place, entry.what));
        };
        let value = entry.amount.unwrap_or(range.usual);
        match (range.min..=range.max).contains(&value) {
            true if *word == Word::Exchanged && !is_another(place, value) => Err(format!(
                "amount {value} is no other than {}: it is the {}",
                entry.place, range.unit
            )),
            true => Ok((
                place,
                Fault {
                    word: *word,
                    amount: value,
                },
            )),
            false if range.min == range.max => Err(format!("'{}' takes no amount", entry.what)),
            false => Err(format!(
                "amount {value} is not within {} and {} ({})",
                range.min, range.max, range.unit
            )),
        }
    };
    places.into_iter().map(with).collect()
}

/// Whether `number` (1-based) is that of another sensor than the one at `place`, which is exchanged with it.
fn is_another(place: Place, number: f64) -> bool {
    match place {
        Place::Spring(i) | Place::Imu(i) => number.fract() == 0.0 && number != (i + 1) as f64,
        _ => true,
    }
}

fn places(text: &str, word: Word) -> Option<Vec<Place>> {
    match text {
        "boards" if word == Word::Exchanged => return Some(vec![Place::Segments]),
        "port" => return Some(vec![Place::Port]),
        "supply" => return Some(vec![Place::Supply]),
        "emergency stop" => return Some((0..BOARDS).map(Place::Stop).collect()),
        "boards" => return Some((0..BOARDS).map(Place::Board).collect()),
        _ => {}
    }
    let (kind, number) = text.split_once(' ')?;
    let number: usize = number.parse().ok()?;
    let (count, place): (usize, fn(usize) -> Place) = match kind {
        "spring" => (SPRINGS, Place::Spring),
        "imu" => (IMUS, Place::Imu),
        "gauge" => (CHAMBERS, Place::Gauge),
        "chamber" => (CHAMBERS, Place::Chamber),
        "counter" => (BOARDS, Place::Counter),
        "board" => (BOARDS, Place::Board),
        "contact" => (BOARDS, Place::Stop),
        _ => return None,
    };
    (1..=count)
        .contains(&number)
        .then(|| vec![place(number - 1)])
}
