//! One direction of a board's line that may be broken: bytes in, bytes out.

use std::collections::VecDeque;

use rand::Rng as _;
use rand_pcg::Pcg64Mcg;

use super::{Fault, Word};

/// Bytes that wait at most; a line that is slower than its traffic loses the rest.
const MAX_WAITING: usize = 16 << 10;

/// A line with what is under way on it.
#[derive(Clone, Debug, Default)]
pub(super) struct Line {
    /// The frame that is not complete yet.
    part: Vec<u8>,
    /// Bytes with the time (s) from which they may arrive.
    waiting: VecDeque<(f64, Vec<u8>)>,
    /// The last whole frame.
    last: Vec<u8>,
    /// A frame that comes after the next one.
    held_back: Vec<u8>,
    /// When the line last passed bytes, s, and how many more it may pass now.
    passed_s: f64,
    credit: f64,
    /// Frames lost, broken, doubled or swapped.
    pub hits: u64,
}

impl Line {
    /// Output at `t_s` (s) for an input.
    pub fn pass(
        &mut self,
        t_s: f64,
        bytes: &[u8],
        fault: Option<Fault>,
        rng: &mut Pcg64Mcg,
    ) -> Vec<u8> {
        let dt_s = (t_s - self.passed_s).clamp(0.0, 1.0);
        self.passed_s = t_s;
        match fault.map(|f| (f.word, f.amount)) {
            Some((Word::Off, _)) => {
                *self = Self {
                    passed_s: t_s,
                    hits: self.hits,
                    ..Self::default()
                };
                Vec::new()
            }
            Some((Word::Garbage, _)) => bytes.iter().map(|_| rng.random()).collect(),
            Some((Word::Delayed, delay_s)) => {
                self.wait(t_s + delay_s, bytes);
                self.arrive(|due_s, _| due_s <= t_s)
            }
            Some((Word::Slow, rate)) => {
                self.credit = (self.credit + rate * dt_s).min(rate.max(1.0));
                for byte in bytes {
                    self.wait(t_s, std::slice::from_ref(byte));
                }
                let mut left = self.credit;
                let out = self.arrive(|_, n| {
                    left -= n as f64;
                    left >= 0.0
                });
                self.credit -= out.len() as f64;
                out
            }
            Some((
                word @ (Word::Stuck
                | Word::Wrong
                | Word::Intermittent
                | Word::Twice
                | Word::Swapped),
                amount,
            )) => {
                let mut out = self.arrive(|_, _| true);
                for byte in bytes {
                    self.part.push(*byte);
                    if *byte == 0 && self.part.len() > 1 {
                        let frame = std::mem::take(&mut self.part);
                        self.frame(frame, word, amount, rng, &mut out);
                    }
                }
                out
            }
            None
            | Some((
                Word::Leak
                | Word::Jump
                | Word::Open
                | Word::Reboot
                | Word::Dtr
                | Word::Vents
                | Word::Exchanged,
                _,
            )) => {
                let mut out = self.arrive(|_, _| true);
                out.append(&mut self.part);
                out.append(&mut self.held_back);
                out.extend(bytes);
                out
            }
        }
    }

    fn frame(
        &mut self,
        mut frame: Vec<u8>,
        word: Word,
        share: f64,
        rng: &mut Pcg64Mcg,
        out: &mut Vec<u8>,
    ) {
        if word == Word::Stuck {
            if self.last.is_empty() {
                self.last = frame;
            }
            out.extend(&self.last);
            return;
        }
        self.last.clear();
        let hit = rng.random_bool(share);
        self.hits += u64::from(hit);
        match word {
            Word::Intermittent if hit => {}
            Word::Twice if hit => {
                out.extend(&frame);
                out.extend(&frame);
            }
            Word::Swapped if hit && self.held_back.is_empty() => self.held_back = frame,
            _ => {
                if word == Word::Wrong && hit {
                    // Not a delimiter: that would hit two frames.
                    let at = rng.random_range(1..frame.len().max(3) - 1);
                    if let Some(byte) = frame.get_mut(at) {
                        *byte ^= 1 << rng.random_range(0..8);
                    }
                }
                out.extend(&frame);
                out.append(&mut self.held_back);
            }
        }
    }

    fn wait(&mut self, due_s: f64, bytes: &[u8]) {
        let waiting: usize = self.waiting.iter().map(|(_, b)| b.len()).sum();
        if !bytes.is_empty() && waiting + bytes.len() <= MAX_WAITING {
            self.waiting.push_back((due_s, bytes.to_vec()));
        }
    }

    /// What arrives now: the oldest for which `may` (due time, length) holds.
    fn arrive(&mut self, mut may: impl FnMut(f64, usize) -> bool) -> Vec<u8> {
        let mut out = Vec::new();
        while let Some((due_s, bytes)) = self.waiting.front() {
            if !may(*due_s, bytes.len()) {
                break;
            }
            out.extend(bytes);
            self.waiting.pop_front();
        }
        out
    }
}
