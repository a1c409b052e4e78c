//! A channel that may be broken: one reading in, one out.

use std::collections::VecDeque;

use rand::Rng as _;
use rand_pcg::Pcg64Mcg;

use super::{Fault, Word};

/// Readings kept: the longest delay at 100 Hz.
const MEMORY: usize = 1001;

/// A value that a channel carries.
pub(super) trait Reading: Copy {
    /// Any reading that the channel can give.
    fn garbage(rng: &mut Pcg64Mcg) -> Self;
    /// The same, off by an amount in the script's unit.
    fn shifted(self, amount: f64) -> Self;
}

/// A channel with its memory.
#[derive(Clone, Debug)]
pub(super) struct Channel<T> {
    /// Newest last, with their times (s).
    past: VecDeque<(f64, Option<T>)>,
    /// Its reading while it is stuck or slow, and since when (s).
    held: Option<(f64, Option<T>)>,
}

impl<T> Default for Channel<T> {
    fn default() -> Self {
        Self {
            past: VecDeque::new(),
            held: None,
        }
    }
}

impl<T: Reading> Channel<T> {
    /// Output at `t_s` (s) for an input.
    pub fn pass(
        &mut self,
        t_s: f64,
        fresh: Option<T>,
        fault: Option<Fault>,
        rng: &mut Pcg64Mcg,
    ) -> Option<T> {
        let before = self.past.back().map_or(fresh, |(_, r)| *r);
        if self.past.len() == MEMORY {
            self.past.pop_front();
        }
        self.past.push_back((t_s, fresh));
        let Some(Fault { word, amount }) = fault else {
            self.held = None;
            return fresh;
        };
        match word {
            Word::Off => None,
            Word::Stuck => self.held.get_or_insert((t_s, before)).1,
            Word::Garbage => Some(T::garbage(rng)),
            Word::Wrong => fresh.map(|r| r.shifted(amount)),
            Word::Slow => {
                let due = self
                    .held
                    .is_none_or(|(at_s, _)| t_s - at_s >= amount - 1e-9);
                if due {
                    self.held = Some((t_s, fresh));
                }
                self.held.and_then(|(_, r)| r)
            }
            Word::Delayed => {
                let old = |(at_s, _): &&(f64, Option<T>)| *at_s <= t_s - amount + 1e-9;
                let heard = self.past.iter().rev().find(old);
                heard.or(self.past.front()).and_then(|(_, r)| *r)
            }
            Word::Intermittent => fresh.filter(|_| !rng.random_bool(amount)),
            Word::Leak
            | Word::Jump
            | Word::Twice
            | Word::Swapped
            | Word::Open
            | Word::Reboot
            | Word::Dtr
            | Word::Vents
            | Word::Exchanged => fresh,
        }
    }
}
