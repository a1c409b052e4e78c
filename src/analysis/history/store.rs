//! Columns of values over time, with the extremes of every 16, 256 and 4096 rows at hand.
//!
//! Rows lie in blocks of [`BLOCK`]; the oldest block is used again when all its rows are too old, so that
//! nothing is allocated once the store is full. A column takes memory in a block from its first value on:
//! 4 bytes a row and 1.1 for the extremes.

use std::collections::VecDeque;
use std::ops::Range;

use crate::analysis::decimate::{Slot, slot_index as index};

/// Rows (or nodes of the level below) that a node sums up.
const FAN: usize = 16;
/// Levels of nodes above the rows of a block.
const LEVELS: usize = 3;
/// Rows of a block: those of one node of the highest level.
const BLOCK: usize = FAN.pow(LEVELS as u32);
/// Stands for no row.
const NONE: u16 = u16::MAX;

/// Extremes of some successive rows of one column. Rows are counted within the block.
#[derive(Clone, Copy, Debug)]
struct Node {
    low: f32,
    high: f32,
    low_at: u16,
    high_at: u16,
    first: u16,
    last: u16,
}

impl Node {
    const EMPTY: Self = Self {
        low: 0.0,
        high: 0.0,
        low_at: NONE,
        high_at: NONE,
        first: NONE,
        last: NONE,
    };

    /// Takes the rows behind, which are summed up in `next`.
    fn add(&mut self, next: &Self) {
        if self.first == NONE {
            *self = *next;
            return;
        }
        if next.first == NONE {
            return;
        }
        self.last = next.last;
        // Of equal values the first counts.
        if next.low < self.low {
            (self.low, self.low_at) = (next.low, next.low_at);
        }
        if next.high > self.high {
            (self.high, self.high_at) = (next.high, next.high_at);
        }
    }

    fn row(row: usize, value: f32) -> Self {
        let row = row as u16;
        Self {
            low: value,
            high: value,
            low_at: row,
            high_at: row,
            first: row,
            last: row,
        }
    }
}

/// One column of a block; empty until its first value.
#[derive(Clone, Debug, Default)]
struct Column {
    values: Vec<f32>,
    levels: [Vec<Node>; LEVELS],
}

impl Column {
    fn push(&mut self, row: usize, value: f32) {
        if value.is_finite() {
            self.values.resize(row, f32::NAN);
            self.values.push(value);
        }
    }

    /// Sums up the rows (or nodes) that were completed with a block of `rows` rows.
    fn sum_up(&mut self, rows: usize) {
        if self.values.is_empty() {
            return;
        }
        let first = rows - FAN;
        let mut node = Node::EMPTY;
        for (i, value) in self.values.iter().enumerate().skip(first) {
            if value.is_finite() {
                node.add(&Node::row(i, *value));
            }
        }
        let mut complete = rows / FAN;
        for level in 0..LEVELS {
            self.levels[level].resize(complete - 1, Node::EMPTY);
            self.levels[level].push(node);
            if !complete.is_multiple_of(FAN) {
                break;
            }
            node = Node::EMPTY;
            for below in &self.levels[level][complete - FAN..] {
                node.add(below);
            }
            complete /= FAN;
        }
    }

    /// The extremes of the rows from `at` to `end`.
    fn extremes(&self, mut at: usize, end: usize) -> Node {
        if self.values.is_empty() {
            return Node::EMPTY;
        }
        let mut sum = Node::EMPTY;
        while at < end {
            // The largest node that begins here and holds nothing beyond the end.
            let fits = |l: &usize| {
                let size = FAN.pow(*l as u32);
                at.is_multiple_of(size) && at + size <= end
            };
            if let Some(l) = (1..=LEVELS).rev().find(fits) {
                if let Some(node) = self.levels[l - 1].get(at >> (4 * l)) {
                    sum.add(node);
                }
                at += FAN.pow(l as u32);
                continue;
            }
            let stop = (at + FAN - at % FAN).min(end);
            let rows = at.min(self.values.len())..stop.min(self.values.len());
            for (i, value) in rows.clone().zip(&self.values[rows]) {
                if value.is_finite() {
                    sum.add(&Node::row(i, *value));
                }
            }
            at = stop;
        }
        sum
    }

    fn clear(&mut self) {
        self.values.clear();
        for level in &mut self.levels {
            level.clear();
        }
    }
}

#[derive(Clone, Debug)]
struct Block {
    t_s: Vec<f64>,
    columns: Vec<Column>,
}

/// Rows of a time and some values each, in order of time.
#[derive(Clone, Debug)]
pub(super) struct Store {
    columns: usize,
    blocks: VecDeque<Block>,
    /// Rows of the first block that are too old.
    skip: usize,
    len: usize,
    /// A block that is used again.
    spare: Option<Block>,
}

impl Store {
    pub(super) fn new(columns: usize) -> Self {
        Self {
            columns,
            blocks: VecDeque::new(),
            skip: 0,
            len: 0,
            spare: None,
        }
    }

    pub(super) fn len(&self) -> usize {
        self.len
    }

    /// Block and place within it.
    fn place(&self, row: usize) -> (usize, usize) {
        let row = self.skip + row;
        (row / BLOCK, row % BLOCK)
    }

    /// Time of a row.
    pub(super) fn time(&self, row: usize) -> f64 {
        let (block, at) = self.place(row);
        self.blocks[block].t_s[at]
    }

    /// The value of a column in a row; not finite when there is none.
    pub(super) fn value(&self, column: usize, row: usize) -> f32 {
        let (block, at) = self.place(row);
        let values = &self.blocks[block].columns[column].values;
        values.get(at).copied().unwrap_or(f32::NAN)
    }

    /// Appends a row; its time lies after all others. Values that are not finite are none.
    pub(super) fn push(&mut self, t_s: f64, row: &[f32]) {
        if self.blocks.back().is_none_or(|b| b.t_s.len() == BLOCK) {
            let fresh = || Block {
                t_s: Vec::new(),
                columns: vec![Column::default(); self.columns],
            };
            let block = self.spare.take().unwrap_or_else(fresh);
            self.blocks.push_back(block);
        }
        let Some(block) = self.blocks.back_mut() else {
            return;
        };
        let at = block.t_s.len();
        block.t_s.push(t_s);
        for (column, value) in block.columns.iter_mut().zip(row) {
            column.push(at, *value);
        }
        let rows = block.t_s.len();
        if rows.is_multiple_of(FAN) {
            block.columns.iter_mut().for_each(|c| c.sum_up(rows));
        }
        self.len += 1;
    }

    /// Forgets the oldest row.
    pub(super) fn pop(&mut self) {
        if self.len == 0 {
            return;
        }
        self.len -= 1;
        self.skip += 1;
        if self.skip == BLOCK
            && let Some(mut block) = self.blocks.pop_front()
        {
            self.skip = 0;
            block.t_s.clear();
            block.columns.iter_mut().for_each(Column::clear);
            self.spare = Some(block);
        }
    }

    /// The first row for which `before` does not hold of its time.
    fn partition(&self, before: impl Fn(f64) -> bool) -> usize {
        let blocks = &self.blocks;
        // The last block that begins before; the row lies in it or begins the next.
        let after = blocks.partition_point(|b| b.t_s.first().is_some_and(|t| before(*t)));
        let Some(block) = after.checked_sub(1) else {
            return 0;
        };
        let at = blocks[block].t_s.partition_point(|t| before(*t));
        (block * BLOCK + at).saturating_sub(self.skip)
    }

    /// The first row at or after a time.
    pub(super) fn row_at(&self, t_s: f64) -> usize {
        self.partition(|t| t < t_s)
    }

    /// The first row after a time.
    pub(super) fn row_after(&self, t_s: f64) -> usize {
        self.partition(|t| t <= t_s)
    }

    /// Pieces of `rows` that lie in one block each: block, first place, end.
    fn pieces(&self, rows: Range<usize>) -> impl Iterator<Item = (&Block, usize, usize)> + Clone {
        let (from, to) = (self.skip + rows.start, self.skip + rows.end);
        (from / BLOCK..to.div_ceil(BLOCK)).map(move |i| {
            let first = from.saturating_sub(i * BLOCK);
            let end = (to - i * BLOCK).min(BLOCK);
            (&self.blocks[i], first, end)
        })
    }

    /// The values of a column within `[from_s, to_s]`, in order of time.
    pub(super) fn values(
        &self,
        column: usize,
        from_s: f64,
        to_s: f64,
    ) -> impl Iterator<Item = f32> + Clone + '_ {
        self.pieces(self.rows(from_s, to_s))
            .flat_map(move |(block, first, end)| {
                let values = &block.columns[column].values;
                let end = end.min(values.len());
                &values[first.min(end)..end]
            })
            .copied()
            .filter(|v| v.is_finite())
    }

    /// Times and values of a column within `[from_s, to_s]`, in order of time.
    pub(super) fn points(
        &self,
        column: usize,
        from_s: f64,
        to_s: f64,
    ) -> impl Iterator<Item = [f64; 2]> + Clone + '_ {
        self.pieces(self.rows(from_s, to_s))
            .flat_map(move |(block, first, end)| {
                let values = &block.columns[column].values;
                let end = end.min(values.len());
                let rows = first.min(end)..end;
                block.t_s[rows.clone()].iter().zip(&values[rows])
            })
            .filter(|(_, v)| v.is_finite())
            .map(|(t, v)| [*t, f64::from(*v)])
    }

    /// Time of the newest value of a column at or before a time.
    pub(super) fn last_before(&self, column: usize, to_s: f64) -> Option<f64> {
        let end = self.skip + self.row_after(to_s);
        (0..end.div_ceil(BLOCK)).rev().find_map(|i| {
            let first = if i == 0 { self.skip } else { 0 };
            let block = &self.blocks[i];
            let node = block.columns[column].extremes(first, (end - i * BLOCK).min(BLOCK));
            (node.last != NONE).then(|| block.t_s[usize::from(node.last)])
        })
    }

    /// Spans within `[from_s, to_s]` of more than `gap_s` without a value of a column.
    pub(super) fn gaps(&self, column: usize, from_s: f64, to_s: f64, gap_s: f64) -> Vec<[f64; 2]> {
        let mut gaps = Vec::new();
        let mut last_s = from_s;
        let mut seen = |first_s: f64, until_s: f64| {
            if first_s - last_s > gap_s {
                gaps.push([last_s, first_s]);
            }
            last_s = until_s;
        };
        for (block, first, end) in self.pieces(self.rows(from_s, to_s)) {
            let column = &block.columns[column];
            let time = |row: u16| block.t_s[usize::from(row)];
            let end = end.min(column.values.len());
            let mut at = first;
            while at < end {
                let next = (at + FAN - at % FAN).min(end);
                let node = column.levels[0].get(at / FAN);
                match node.filter(|_| at.is_multiple_of(FAN) && at + FAN <= end) {
                    Some(n) if n.first == NONE => {}
                    // Values that lie so close together have no gap between them.
                    Some(n) if time(n.last) - time(n.first) <= gap_s => {
                        seen(time(n.first), time(n.last));
                    }
                    _ => {
                        let rows = block.t_s[at..next].iter().zip(&column.values[at..next]);
                        for (t_s, _) in rows.filter(|(_, v)| v.is_finite()) {
                            seen(*t_s, *t_s);
                        }
                    }
                }
                at = next;
            }
        }
        seen(to_s, to_s);
        gaps
    }

    /// The rows within `[from_s, to_s]`.
    pub(super) fn rows(&self, from_s: f64, to_s: f64) -> Range<usize> {
        let first = self.row_at(from_s);
        first..self.row_after(to_s).max(first)
    }

    /// The rows of `rows` by slots of `width_s` on a fixed grid of time: the extremes of a column in each.
    pub(super) fn slots(
        &self,
        column: usize,
        rows: Range<usize>,
        width_s: f64,
        out: &mut Vec<Slot>,
    ) {
        let mut first = rows.start;
        let mut usual = 1;
        while first < rows.end {
            let index = index(self.time(first), width_s);
            let end =
                self.end_of_slot(first, rows.end, usual, |t| self::index(t, width_s) <= index);
            out.extend(self.slot(column, first..end, index));
            usual = end - first;
            first = end;
        }
    }

    /// The first row behind `first` and before `end` whose time is not `within`; looked for about `usual`
    /// rows further on.
    fn end_of_slot(
        &self,
        first: usize,
        end: usize,
        usual: usize,
        within: impl Fn(f64) -> bool,
    ) -> usize {
        // Rows up to `low` are within; `high` is not, or is the end.
        let (mut low, mut high) = (first, end);
        // First the rows around the place where rows at a steady rate would end.
        for guess in [first + usual - 1, first + usual, first + usual + 1] {
            if guess > low && guess < high {
                if within(self.time(guess)) {
                    low = guess;
                } else {
                    high = guess;
                }
            }
        }
        let mut step = 2;
        while high == end && low + step < high {
            let probe = low + step;
            if within(self.time(probe)) {
                low = probe;
                step *= 2;
            } else {
                high = probe;
            }
        }
        while low + 1 < high {
            let probe = low + (high - low) / 2;
            if within(self.time(probe)) {
                low = probe;
            } else {
                high = probe;
            }
        }
        high
    }

    fn slot(&self, column: usize, rows: Range<usize>, index: f64) -> Option<Slot> {
        let mut slot: Option<Slot> = None;
        for (block, first, end) in self.pieces(rows) {
            let node = block.columns[column].extremes(first, end);
            if node.first == NONE {
                continue;
            }
            let time = |row: u16| block.t_s[usize::from(row)];
            let low = [time(node.low_at), f64::from(node.low)];
            let high = [time(node.high_at), f64::from(node.high)];
            let slot = slot.get_or_insert(Slot {
                index,
                first_s: time(node.first),
                last_s: 0.0,
                low,
                high,
            });
            slot.last_s = time(node.last);
            if low[1] < slot.low[1] {
                slot.low = low;
            }
            if high[1] > slot.high[1] {
                slot.high = high;
            }
        }
        slot
    }

    /// The first row in a slot of at least this index.
    fn row_of_slot(&self, index: f64, width_s: f64) -> usize {
        self.partition(|t| self::index(t, width_s) < index)
    }
}

/// Slots of a column that no new row changes any more.
#[derive(Clone, Debug)]
struct Kept {
    column: usize,
    width_s: f64,
    /// Indices that are covered: first, and the one behind the last.
    covered: [f64; 2],
    slots: Vec<Slot>,
}

/// Columns and widths whose slots are kept at most.
const KEPT: usize = 128;

/// The slots drawn last: from one picture to the next only the newest change.
#[derive(Clone, Debug, Default)]
pub(super) struct Drawn {
    kept: Vec<Kept>,
}

impl Drawn {
    /// The slots of a column within `[from_s, to_s]`.
    pub(super) fn slots(
        &mut self,
        store: &Store,
        column: usize,
        [from_s, to_s]: [f64; 2],
        width_s: f64,
    ) -> Vec<Slot> {
        let rows = store.rows(from_s, to_s);
        let mut out = Vec::new();
        if rows.is_empty() {
            return out;
        }
        // Slots that lie whole within the window, hold all their rows still and get no more.
        let oldest_s = from_s.max(store.time(0));
        let newest_s = to_s.min(store.time(store.len() - 1));
        let whole = [index(oldest_s, width_s) + 1.0, index(newest_s, width_s)];
        if whole[1] <= whole[0] {
            store.slots(column, rows, width_s, &mut out);
            return out;
        }
        let inner = whole.map(|i| store.row_of_slot(i, width_s));
        store.slots(column, rows.start..inner[0], width_s, &mut out);
        let kept = self.kept(column, width_s);
        kept.cover(store, whole);
        let first = kept.slots.partition_point(|s| s.index < whole[0]);
        let end = kept.slots.partition_point(|s| s.index < whole[1]);
        out.extend_from_slice(&kept.slots[first..end]);
        store.slots(column, inner[1]..rows.end, width_s, &mut out);
        out
    }

    fn kept(&mut self, column: usize, width_s: f64) -> &mut Kept {
        let same = |k: &Kept| k.column == column && k.width_s == width_s;
        let place = match self.kept.iter().position(same) {
            Some(i) => i,
            None => {
                if self.kept.len() == KEPT {
                    self.kept.clear();
                }
                self.kept.push(Kept {
                    column,
                    width_s,
                    covered: [0.0; 2],
                    slots: Vec::new(),
                });
                self.kept.len() - 1
            }
        };
        &mut self.kept[place]
    }
}

impl Kept {
    /// Covers the slots from one index to before another.
    fn cover(&mut self, store: &Store, [from, to]: [f64; 2]) {
        if from < self.covered[0] || from > self.covered[1] {
            self.slots.clear();
            self.covered = [from, from];
        }
        if to > self.covered[1] {
            let rows = self.covered[1]..to;
            let rows = store.row_of_slot(rows.start, self.width_s)
                ..store.row_of_slot(rows.end, self.width_s);
            store.slots(self.column, rows, self.width_s, &mut self.slots);
            self.covered[1] = to;
        }
        // What has left the window is dropped now and then.
        if self.covered[1] - self.covered[0] > 2.0 * (to - from) + 100.0 {
            let stale = self.slots.partition_point(|s| s.index < from);
            self.slots.drain(..stale);
            self.covered[0] = from;
        }
    }
}
