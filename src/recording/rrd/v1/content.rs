//! What is taken from a file's tables, and the snapshots made of it.

mod columns;
mod snapshots;

use std::collections::BTreeMap;

use rerun::log::Chunk;
use rerun::{ComponentIdentifier, Scalars};

use super::schema::{self as old, SPECS, table};
use crate::recording::RecordedEvent;
use crate::recording::rrd::columns::times;
use crate::recording::rrd::schema;
use crate::recording::rrd::snapshots::events;
use columns::{Rows, take_f64, take_i64};

/// Tables whose scalars snapshots are made of.
const SCALARS_USED: std::ops::RangeInclusive<usize> = table::COUNTS..=table::RAW_PRESSURE;

/// Span of one entity on the timeline.
#[derive(Clone, Copy, Debug)]
pub(super) struct Span {
    pub(super) rows: u64,
    pub(super) first: i64,
    pub(super) last: i64,
}

/// Everything taken from a file's chunks.
pub(super) struct Content {
    scalars: Vec<Rows<f64>>,
    exact: Vec<Rows<f64>>,
    ints: Vec<Rows<i64>>,
    pub(super) events: Vec<RecordedEvent>,
    pub(super) spans: BTreeMap<String, Span>,
}

impl Default for Content {
    fn default() -> Self {
        Self {
            scalars: SPECS.iter().map(|s| Rows::new(s.scalars)).collect(),
            exact: SPECS.iter().map(|s| Rows::new(s.exact)).collect(),
            ints: SPECS.iter().map(|s| Rows::new(s.ints)).collect(),
            events: Vec::new(),
            spans: BTreeMap::new(),
        }
    }
}

impl Content {
    fn add_span(&mut self, path: &str, times: &[i64]) {
        for t in times {
            let span = self.spans.entry(path.to_owned()).or_insert(Span {
                rows: 0,
                first: *t,
                last: *t,
            });
            span.rows += 1;
            span.first = span.first.min(*t);
            span.last = span.last.max(*t);
        }
    }

    /// Takes what is known of a chunk, and its extent.
    pub(super) fn take(&mut self, chunk: &Chunk) -> Result<(), String> {
        let path = chunk.entity_path().to_string();
        let Some(times) = times(chunk) else {
            return Ok(());
        };
        let times = times.as_slice();
        self.add_span(&path, times);
        if schema::LOGS.contains(&path.as_str()) {
            self.events.extend(events(chunk));
        }
        let scalars = Scalars::descriptor_scalars().component;
        let [exact, ints] = [old::EXACT, old::INTS].map(ComponentIdentifier::from);
        let place = |e: String| format!("{path}: {e}");
        let scalars_at = SPECS.iter().position(|s| s.path == path);
        if let Some(i) = scalars_at.filter(|i| SCALARS_USED.contains(i)) {
            take_f64(&mut self.scalars[i], chunk, times, scalars).map_err(place)?;
        }
        // Recordings of the first days have the exact values beside the scalars.
        let exact_at = |s: &old::Spec| s.exact_path == path || s.path == path;
        if let Some(i) = SPECS.iter().position(exact_at) {
            take_f64(&mut self.exact[i], chunk, times, exact).map_err(place)?;
            take_i64(&mut self.ints[i], chunk, times, ints).map_err(place)?;
        }
        Ok(())
    }
}
