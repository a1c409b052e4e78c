//! What breaks during a soak: faults drawn from a seeded generator, lasting fractions of a second to minutes.

use rand::{Rng as _, SeedableRng as _};
use rand_pcg::Pcg64Mcg;

use springtwin::rig::{RigBoard, VirtualRig};
use springtwin::signal::{IMUS, SPRINGS};

/// The shortest and the longest time between the beginnings of two faults, s.
const PAUSE_S: std::ops::Range<f64> = 15.0..120.0;

/// What may break.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// A spring's reading stays as it is.
    StuckSpring,
    /// An IMU answers no more.
    DeadImu,
    /// Nothing that the boards say arrives.
    LineCut,
    /// Power of board 2 off and on again. Board 1 is left on, so that its clock wraps all the way.
    Reboot,
    /// A board's clock jumps, ahead or back.
    ClockJump,
    /// Single bytes arrive changed, in both directions.
    Corruption,
    /// Bytes arrive that nobody sent.
    Garbage,
    /// The rig's process stands still (with a rig process only).
    Frozen,
}

impl Kind {
    /// What can be done to a rig in this process.
    pub const IN_PROCESS: [Self; 7] = [
        Self::StuckSpring,
        Self::DeadImu,
        Self::LineCut,
        Self::Reboot,
        Self::ClockJump,
        Self::Corruption,
        Self::Garbage,
    ];
    /// What can be done to a rig in a process of its own.
    pub const FROM_OUTSIDE: [Self; 1] = [Self::Frozen];

    /// Its name in the report.
    pub fn key(self) -> &'static str {
        match self {
            Self::StuckSpring => "stuck_spring",
            Self::DeadImu => "dead_imu",
            Self::LineCut => "line_cut",
            Self::Reboot => "reboot",
            Self::ClockJump => "clock_jump",
            Self::Corruption => "corruption",
            Self::Garbage => "garbage",
            Self::Frozen => "frozen",
        }
    }

    /// Shortest and longest duration, s.
    fn lasts_s(self) -> (f64, f64) {
        match self {
            Self::StuckSpring | Self::DeadImu => (2.0, 180.0),
            Self::LineCut | Self::Frozen => (0.05, 10.0),
            Self::Reboot | Self::ClockJump => (0.0, 0.0),
            Self::Corruption => (1.0, 60.0),
            Self::Garbage => (0.1, 5.0),
        }
    }
}

/// A fault under way.
#[derive(Clone, Copy, Debug)]
struct Fault {
    kind: Kind,
    until_s: f64,
    /// Spring, IMU or board, 0-based.
    which: usize,
    /// Share of bytes that arrive changed.
    ratio: f64,
}

/// What breaks, and when. The same seed breaks the same at the same times.
pub struct Weather {
    kinds: &'static [Kind],
    rng: Pcg64Mcg,
    next_s: f64,
    under_way: Vec<Fault>,
    begun: Vec<u64>,
}

impl Weather {
    /// Fair weather for the first half minute.
    pub fn new(kinds: &'static [Kind], seed: u64) -> Self {
        Self {
            kinds,
            rng: Pcg64Mcg::seed_from_u64(seed ^ 0x736f_616b),
            next_s: 30.0,
            under_way: Vec::new(),
            begun: vec![0; kinds.len()],
        }
    }

    /// How often each fault has begun.
    pub fn begun(&self) -> impl Iterator<Item = (Kind, u64)> + '_ {
        self.kinds.iter().copied().zip(self.begun.iter().copied())
    }

    /// Whether a fault of this kind is under way.
    pub fn is(&self, kind: Kind) -> bool {
        self.under_way.iter().any(|f| f.kind == kind)
    }

    /// Ends what is over at `t_s` (s, must not decrease) and begins what is due. Gives what just began.
    fn advance(&mut self, t_s: f64) -> Option<Fault> {
        self.under_way.retain(|f| f.until_s > t_s);
        if t_s < self.next_s {
            return None;
        }
        self.next_s = t_s + self.rng.random_range(PAUSE_S);
        let n = self.rng.random_range(0..self.kinds.len());
        let kind = self.kinds[n];
        self.begun[n] += 1;
        let (least_s, most_s) = kind.lasts_s();
        // Short ones are as frequent as long ones, on a scale of ratios.
        let lasts_s = least_s * (most_s / least_s.max(1e-9)).powf(self.rng.random_range(0.0..1.0));
        let fault = Fault {
            kind,
            until_s: t_s + lasts_s,
            which: self.rng.random_range(0..SPRINGS),
            ratio: 10f64.powf(self.rng.random_range(-4.0..-2.0)),
        };
        if lasts_s > 0.0 {
            self.under_way.push(fault);
        }
        log::debug!("{t_s:.3} s: {fault:?}");
        Some(fault)
    }

    /// Lets it act on a rig in this process at `t_s`, s.
    pub fn act(&mut self, t_s: f64, rig: &mut VirtualRig) {
        if let Some(fault) = self.advance(t_s) {
            let nonce = self.rng.random();
            match fault.kind {
                Kind::Reboot => rig.boards_mut()[1].reboot(t_s, nonce),
                Kind::ClockJump => {
                    let by_s = 10f64.powf(self.rng.random_range(-2.0..1.5));
                    let by_s = if self.rng.random() { by_s } else { -by_s };
                    if let RigBoard::Emulated(board) = &mut rig.boards_mut()[fault.which % 2] {
                        board.jump_clock(by_s);
                    }
                }
                _ => {}
            }
        }
        let mut stuck = [false; SPRINGS];
        let mut dead = [false; IMUS];
        for fault in &self.under_way {
            match fault.kind {
                Kind::StuckSpring => stuck[fault.which] = true,
                Kind::DeadImu => dead[fault.which % IMUS] = true,
                _ => {}
            }
        }
        rig.faults.stuck_springs = stuck;
        rig.faults.dead_imus = dead;
        rig.faults.line_cut = self.is(Kind::LineCut);
    }

    /// Lets it act on bytes on their way.
    pub fn pass(&mut self, bytes: &mut Vec<u8>) {
        for fault in &self.under_way {
            match fault.kind {
                Kind::Corruption => {
                    for byte in bytes.iter_mut() {
                        if self.rng.random_bool(fault.ratio) {
                            *byte ^= 1 << self.rng.random_range(0..8);
                        }
                    }
                }
                Kind::Garbage => {
                    let n = self.rng.random_range(0..24);
                    bytes.extend((0..n).map(|_| self.rng.random::<u8>()));
                }
                _ => {}
            }
        }
    }

    /// Whether the rig's process shall stand still at `t_s`, s.
    pub fn freezes(&mut self, t_s: f64) -> bool {
        self.advance(t_s);
        self.is(Kind::Frozen)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Beginnings (s, kind, duration in s) over an hour.
    fn hour(seed: u64) -> Vec<(f64, Kind, f64)> {
        let mut weather = Weather::new(&Kind::IN_PROCESS, seed);
        let at = |k: i32| f64::from(k) * 0.01;
        (0..360_000)
            .filter_map(|k| {
                let fault = weather.advance(at(k))?;
                Some((at(k), fault.kind, fault.until_s - at(k)))
            })
            .collect()
    }

    #[test]
    fn every_fault_comes_within_an_hour_and_ends() {
        let drawn = hour(1);
        for kind in Kind::IN_PROCESS {
            let (least_s, most_s) = kind.lasts_s();
            let lasted: Vec<f64> = drawn.iter().filter(|d| d.1 == kind).map(|d| d.2).collect();
            assert!(!lasted.is_empty(), "{kind:?} never came");
            let sound = least_s - 1e-9..=most_s + 1e-9;
            assert!(
                lasted.iter().all(|s| sound.contains(s)),
                "{kind:?} {lasted:?}"
            );
        }
        assert_eq!(drawn, hour(1), "the same seed breaks the same");
        assert_ne!(drawn, hour(2));
    }

    #[test]
    fn corruption_changes_as_many_bytes_as_drawn() {
        let mut weather = Weather::new(&Kind::IN_PROCESS, 1);
        let mut line = vec![0u8; 1_000_000];
        weather.pass(&mut line);
        assert!(line.iter().all(|b| *b == 0), "nothing is under way");
        weather.under_way.push(Fault {
            kind: Kind::Corruption,
            until_s: 1.0,
            which: 0,
            ratio: 1e-3,
        });
        weather.pass(&mut line);
        let changed = line.iter().filter(|b| **b != 0).count();
        assert!((900..1100).contains(&changed), "{changed}");
    }
}
