//! Snapshots as messages of a recording: what a file and a live stream have in common.

mod data;
mod opening;
mod tables;
mod view;

use std::sync::Arc;

use arrow::array::StringArray;
use rerun::log::LogMsg;
use rerun::{StoreId, TextLog};

use super::blueprint::Shown;
use super::error::BatchError;
use super::message::message;
use super::scene::Part;
use super::schema::{self, MessageKind, SAFE_PREFIX};
use crate::recording::{Mark, RecordingMeta};
use crate::signal::{AlarmKey, Mode, Severity, Snapshot, Stamp};
use data::Data;
pub(super) use opening::{noted, opening, store_id};
pub(super) use tables::text_column;
use tables::{TextRows, lists};
use view::View;

/// Rows after which a batch is due.
pub(super) const BATCH_ROWS: usize = 100;

/// Rows that wait to become a batch of messages.
pub(super) struct Rows {
    store_id: StoreId,
    /// Session time after which a batch is due, ns.
    batch_ns: i64,
    data: Data,
    view: View,
    logs: [TextRows; 3],
    marks: TextRows,
    /// Messages of the logs so far.
    log_messages: u64,
    /// Snapshots since the last batch.
    waiting: usize,
    batch_start: Option<Stamp>,
    last: Option<Stamp>,
    last_mode: Option<Mode>,
    last_alarms: Vec<(AlarmKey, Severity)>,
    /// Snapshots whose time did not advance.
    pub(super) repeated: u64,
}

impl Rows {
    /// No rows yet.
    pub(super) fn new(meta: &RecordingMeta, shown: Shown, batch_ns: i64) -> Self {
        Self {
            store_id: store_id(meta),
            batch_ns,
            data: Data::new(),
            view: View::new(meta.drawing.clone(), shown),
            logs: Default::default(),
            marks: TextRows::default(),
            log_messages: 0,
            waiting: 0,
            batch_start: None,
            last: None,
            last_mode: None,
            last_alarms: Vec::new(),
            repeated: 0,
        }
    }

    /// Takes a snapshot; returns whether a batch is due. One whose time does not advance is counted and
    /// left out; parts with values that are not finite are counted and left out.
    pub(super) fn push(&mut self, snapshot: &Snapshot) -> bool {
        let t = snapshot.stamp;
        if self.last.is_some_and(|last| t <= last) {
            self.repeated += 1;
            return false;
        }
        self.last = Some(t);
        let start = *self.batch_start.get_or_insert(t);
        self.data.push(snapshot);
        self.view.push(snapshot);
        self.push_logs(t, snapshot);
        self.waiting += 1;
        self.waiting >= BATCH_ROWS || t.0.saturating_sub(start.0) >= self.batch_ns
    }

    /// Takes one line of the event log.
    pub(super) fn event(&mut self, stamp: Stamp, text: &str) {
        self.logs[schema::log::EVENTS].push(stamp, text.to_owned(), "INFO");
    }

    /// Takes a mark of the operator.
    pub(super) fn mark(&mut self, stamp: Stamp, text: &str) {
        self.marks.push(stamp, text.to_owned(), "INFO");
    }

    /// Snapshots that wait.
    pub(super) fn waiting(&self) -> usize {
        self.waiting
    }

    /// Parts of snapshots with a value that is not finite.
    pub(super) fn rejected(&self) -> u64 {
        self.data.rejected
    }

    /// Makes messages of what waits: the data last. What viewers draw waits for larger batches, unless `all` is wanted.
    pub(super) fn take(&mut self, all: bool) -> Result<Vec<LogMsg>, BatchError> {
        self.batch_start = None;
        self.waiting = 0;
        let mut messages = Vec::new();
        if self.view.is_due() || all {
            for (i, part) in self.view.take()?.into_iter().enumerate() {
                messages.push(message(&self.store_id, MessageKind::View, i as u64, part)?);
            }
        }
        for i in 0..self.logs.len() {
            let rows = std::mem::take(&mut self.logs[i]);
            if rows.times.is_empty() {
                continue;
            }
            let part = lines(schema::LOGS[i], rows)?;
            self.log_messages += 1;
            messages.push(message(
                &self.store_id,
                MessageKind::Log,
                self.log_messages,
                part,
            )?);
        }
        let rows = std::mem::take(&mut self.marks);
        if !rows.times.is_empty() {
            self.log_messages += 1;
            messages.push(marks(&self.store_id, self.log_messages, rows)?);
        }
        let rows = self.data.waiting() as u64;
        if let Some(part) = self.data.take()? {
            messages.push(message(&self.store_id, MessageKind::Data, rows, part)?);
        }
        Ok(messages)
    }

    fn push_logs(&mut self, t: Stamp, snapshot: &Snapshot) {
        if self.last_mode.as_ref() != Some(&snapshot.mode) {
            let level = match snapshot.mode {
                Mode::Safe(_) => "CRITICAL",
                _ => "INFO",
            };
            self.logs[schema::log::MODE].push(t, mode_text(&snapshot.mode), level);
            self.last_mode = Some(snapshot.mode.clone());
        }
        // The figures of an alarm change from tick to tick: a line is written when it begins, and when it becomes
        // more or less urgent.
        let identities: Vec<_> = snapshot
            .alarms
            .iter()
            .map(|a| (a.key(), a.severity))
            .collect();
        if self.last_alarms != identities {
            let log = &mut self.logs[schema::log::ALARMS];
            for (alarm, identity) in snapshot.alarms.iter().zip(&identities) {
                if !self.last_alarms.contains(identity) {
                    let level = match alarm.severity {
                        Severity::Info => "INFO",
                        Severity::Warning => "WARN",
                        Severity::Critical => "CRITICAL",
                    };
                    log.push(t, alarm.text(), level);
                }
            }
            self.last_alarms = identities;
        }
    }
}

/// Lines of a text log as a part of a batch.
fn lines(path: &'static str, rows: TextRows) -> Result<Part, BatchError> {
    let n = rows.times.len();
    let texts = lists(Arc::new(StringArray::from(rows.texts)), 1, n)?;
    let levels = lists(Arc::new(StringArray::from(rows.levels)), 1, n)?;
    Ok(Part {
        path,
        times: rows.times,
        columns: vec![
            (TextLog::descriptor_text(), texts),
            (TextLog::descriptor_level(), levels),
        ],
    })
}

/// The message of some marks.
fn marks(store: &StoreId, number: u64, rows: TextRows) -> Result<LogMsg, BatchError> {
    message(
        store,
        MessageKind::Mark,
        number,
        lines(schema::MARKS, rows)?,
    )
}

/// The message of marks that were read, for another recording.
pub(super) fn marks_read(
    store: &StoreId,
    number: u64,
    read: &[Mark],
) -> Result<LogMsg, BatchError> {
    let mut rows = TextRows::default();
    for mark in read {
        rows.push(mark.stamp, mark.text.clone(), "INFO");
    }
    marks(store, number, rows)
}

fn mode_text(mode: &Mode) -> String {
    match mode {
        Mode::Disarmed => "Disarmed".to_owned(),
        Mode::Hold => "Hold".to_owned(),
        Mode::Moving => "Moving".to_owned(),
        Mode::AtGoal => "At goal".to_owned(),
        Mode::Safe(reason) => format!("{SAFE_PREFIX}{reason}"),
    }
}
