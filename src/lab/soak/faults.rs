//! Fault schedule of an endurance run, drawn from a seeded generator; faults last fractions of a second to minutes.

use rand::{Rng as _, SeedableRng as _};
use rand_pcg::Pcg64Mcg;

use crate::rig::VirtualRig;
use crate::rig::faults::{Fault, Place, Word, amount};
use crate::signal::{BOARDS, CHAMBERS, IMUS, SPRINGS};

/// The shortest and the longest time between the beginnings of two faults, s.
const PAUSE_S: std::ops::Range<f64> = 15.0..120.0;

/// A kind of fault.
#[derive(Clone, Copy, Debug)]
pub struct Kind {
    /// Its name in the report.
    pub key: &'static str,
    place: fn(usize) -> Place,
    /// Number of such places.
    places: usize,
    word: Word,
    /// Shortest and longest duration, s.
    lasts_s: (f64, f64),
}

const fn kind(
    key: &'static str,
    (place, places): (fn(usize) -> Place, usize),
    word: Word,
    lasts_s: (f64, f64),
) -> Kind {
    Kind {
        key,
        place,
        places,
        word,
        lasts_s,
    }
}

const SPRING: (fn(usize) -> Place, usize) = (Place::Spring, SPRINGS);
const IMU: (fn(usize) -> Place, usize) = (Place::Imu, IMUS);
const GAUGE: (fn(usize) -> Place, usize) = (Place::Gauge, CHAMBERS);
const CHAMBER: (fn(usize) -> Place, usize) = (Place::Chamber, CHAMBERS);
const BOARD: (fn(usize) -> Place, usize) = (Place::Board, BOARDS);
/// Board 1 keeps its power, so that its clock wraps all the way.
const SECOND: (fn(usize) -> Place, usize) = (|_| Place::Board(1), 1);
const STOP: (fn(usize) -> Place, usize) = (Place::Stop, BOARDS);
const SUPPLY: (fn(usize) -> Place, usize) = (|_| Place::Supply, 1);
const PORT: (fn(usize) -> Place, usize) = (|_| Place::Port, 1);

/// Faults of a rig in this process.
pub const IN_PROCESS: [Kind; 29] = [
    kind("spring_off", SPRING, Word::Off, (1.0, 60.0)),
    kind("spring_stuck", SPRING, Word::Stuck, (2.0, 180.0)),
    kind("spring_garbage", SPRING, Word::Garbage, (0.1, 30.0)),
    kind("spring_wrong", SPRING, Word::Wrong, (1.0, 60.0)),
    kind("spring_slow", SPRING, Word::Slow, (1.0, 60.0)),
    kind(
        "spring_intermittent",
        SPRING,
        Word::Intermittent,
        (1.0, 60.0),
    ),
    kind("imu_off", IMU, Word::Off, (2.0, 180.0)),
    kind("imu_stuck", IMU, Word::Stuck, (1.0, 60.0)),
    kind("imu_garbage", IMU, Word::Garbage, (0.1, 30.0)),
    kind("imu_delayed", IMU, Word::Delayed, (1.0, 60.0)),
    kind("gauge_off", GAUGE, Word::Off, (0.05, 10.0)),
    kind("gauge_wrong", GAUGE, Word::Wrong, (0.5, 30.0)),
    kind("supply_off", CHAMBER, Word::Off, (1.0, 30.0)),
    kind("supply_wrong", CHAMBER, Word::Wrong, (1.0, 60.0)),
    kind("leak", CHAMBER, Word::Leak, (1.0, 60.0)),
    kind("power", SECOND, Word::Off, (0.05, 5.0)),
    kind("clock_jump", BOARD, Word::Jump, (0.0, 0.0)),
    kind("corruption", BOARD, Word::Wrong, (1.0, 60.0)),
    kind("garbage", BOARD, Word::Garbage, (0.02, 5.0)),
    kind("line_slow", BOARD, Word::Slow, (0.5, 10.0)),
    kind("line_delayed", BOARD, Word::Delayed, (0.5, 30.0)),
    kind("twice", BOARD, Word::Twice, (1.0, 60.0)),
    kind("swapped", BOARD, Word::Swapped, (1.0, 60.0)),
    kind("unplugged", PORT, Word::Off, (0.05, 10.0)),
    kind("emergency_stop", STOP, Word::Open, (0.1, 20.0)),
    kind("reboot", SECOND, Word::Reboot, (0.0, 0.0)),
    kind("gauge_open", GAUGE, Word::Open, (0.05, 10.0)),
    kind("supply_stuck", SUPPLY, Word::Stuck, (0.5, 60.0)),
    kind("supply_vents", SUPPLY, Word::Vents, (1.0, 120.0)),
];
/// Faults of a rig in a process of its own: the process is stopped for a while.
pub const FROM_OUTSIDE: [Kind; 1] = [kind("frozen", PORT, Word::Off, (0.05, 10.0))];

/// Orders and reports that a line had held back have arrived this long after its fault ended, s.
const AFTERWARDS_S: f64 = 0.3;

/// Schedule of faults. The same seed gives the same faults at the same times.
pub struct FaultSchedule {
    kinds: &'static [Kind],
    rng: Pcg64Mcg,
    next_s: f64,
    /// Places with the times (s) at which they end.
    under_way: Vec<(f64, Place)>,
    /// Detours of orders and reports, with the times (s) at which they end.
    detours: Vec<(f64, f64)>,
    begun: Vec<u64>,
}

/// A fault that begins.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Drawn {
    key: &'static str,
    place: Place,
    fault: Fault,
    until_s: f64,
}

impl FaultSchedule {
    /// A schedule without faults in the first half minute.
    pub fn new(kinds: &'static [Kind], seed: u64) -> Self {
        Self {
            kinds,
            rng: Pcg64Mcg::seed_from_u64(seed ^ 0x736f_616b),
            next_s: 30.0,
            under_way: Vec::new(),
            detours: Vec::new(),
            begun: vec![0; kinds.len()],
        }
    }

    /// Number of times that each fault has begun.
    pub fn begun(&self) -> impl Iterator<Item = (&'static str, u64)> + '_ {
        let keys = self.kinds.iter().map(|k| k.key);
        keys.zip(self.begun.iter().copied())
    }

    /// The fault that begins at `t_s` (s, must not decrease).
    fn draw(&mut self, t_s: f64) -> Option<Drawn> {
        if t_s < self.next_s {
            return None;
        }
        self.next_s = t_s + self.rng.random_range(PAUSE_S);
        let n = self.rng.random_range(0..self.kinds.len());
        let kind = self.kinds[n];
        self.begun[n] += 1;
        let (least_s, most_s) = kind.lasts_s;
        // Short ones are as frequent as long ones, on a scale of ratios.
        let lasts_s = least_s * (most_s / least_s.max(1e-9)).powf(self.rng.random_range(0.0..1.0));
        let place = (kind.place)(self.rng.random_range(0..kind.places));
        let size = 10f64.powf(self.rng.random_range(-1.0..0.4));
        // A stop travels on the line, too: it must be there before the pumps must be off.
        let size = if kind.word == Word::Delayed {
            size.min(1.0)
        } else {
            size
        };
        let size = if self.rng.random() { size } else { -size };
        let amount = amount(place, kind.word).map_or(0.0, |range| {
            let size = if range.min < 0.0 { size } else { size.abs() };
            (size * range.usual).clamp(range.min, range.max)
        });
        let drawn = Drawn {
            key: kind.key,
            place,
            fault: Fault {
                word: kind.word,
                amount,
            },
            until_s: t_s + lasts_s,
        };
        log::debug!("{t_s:.3} s: {drawn:?}");
        Some(drawn)
    }

    /// How much longer than otherwise it takes a board to hear an order and to be heard, s: infinite while its line
    /// carries less than the computer sends.
    pub fn detour_s(&self, t_s: f64) -> f64 {
        let each = self.detours.iter().filter(|(until_s, _)| *until_s > t_s);
        each.map(|(_, s)| *s).fold(0.0, f64::max)
    }

    /// Applies the faults due at `t_s`, s, to a rig in this process.
    pub fn apply(&mut self, t_s: f64, rig: &mut VirtualRig) {
        self.under_way.retain(|(until_s, place)| {
            let lasts = *until_s > t_s;
            if !lasts {
                rig.faults.end(*place);
            }
            lasts
        });
        self.detours.retain(|(until_s, _)| *until_s > t_s);
        if let Some(drawn) = self.draw(t_s) {
            rig.faults.begin(drawn.place, drawn.fault);
            let detour_s = match (drawn.place, drawn.fault.word) {
                (Place::Board(_), Word::Delayed) => 2.0 * drawn.fault.amount,
                (Place::Board(_), Word::Slow) => f64::INFINITY,
                _ => 0.0,
            };
            // What is under way when it ends still arrives.
            self.detours.push((drawn.until_s + AFTERWARDS_S, detour_s));
            // What was wrong with the place before has ended with it.
            self.under_way.retain(|(_, place)| *place != drawn.place);
            self.under_way.push((drawn.until_s, drawn.place));
        }
    }

    /// Whether the rig's process shall stand still at `t_s`, s.
    pub fn freezes(&mut self, t_s: f64) -> bool {
        self.under_way.retain(|(until_s, _)| *until_s > t_s);
        if let Some(drawn) = self.draw(t_s) {
            self.under_way.push((drawn.until_s, drawn.place));
        }
        !self.under_way.is_empty()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What begins within `hours`, with its time, s.
    fn hours(hours: u32, seed: u64) -> Vec<(f64, Drawn)> {
        let mut schedule = FaultSchedule::new(&IN_PROCESS, seed);
        (0..hours * 360_000)
            .filter_map(|k| {
                let t_s = f64::from(k) * 0.01;
                Some((t_s, schedule.draw(t_s)?))
            })
            .collect()
    }

    #[test]
    fn every_fault_comes_within_a_few_hours_and_ends() {
        let drawn = hours(6, 1);
        for kind in IN_PROCESS {
            let (least_s, most_s) = kind.lasts_s;
            let all: Vec<_> = drawn.iter().filter(|d| d.1.key == kind.key).collect();
            assert!(!all.is_empty(), "{} never came", kind.key);
            for (t_s, d) in all {
                let lasts_s = d.until_s - t_s;
                assert!((least_s - 1e-9..=most_s + 1e-9).contains(&lasts_s), "{d:?}");
                assert!(amount(d.place, d.fault.word).is_some(), "{d:?}");
            }
        }
        assert_eq!(drawn, hours(6, 1), "the same seed breaks the same");
        assert_ne!(drawn, hours(6, 2));
    }

    #[test]
    fn a_line_that_holds_back_is_a_detour_there_and_back_while_it_lasts() {
        static DELAYED: [Kind; 1] = [kind("line_delayed", BOARD, Word::Delayed, (0.5, 30.0))];
        let mut schedule = FaultSchedule::new(&DELAYED, 1);
        let options = crate::rig::RigOptions::default();
        let mut rig =
            VirtualRig::new(&crate::robot::RobotSpec::reference(), &options).expect("settles");
        assert_eq!(schedule.detour_s(0.0), 0.0);
        let begins_s = schedule.next_s;
        schedule.apply(begins_s, &mut rig);
        let (until_s, _) = schedule.under_way[0];
        let detour_s = schedule.detour_s(begins_s);
        assert!(detour_s > 0.0 && detour_s <= 0.2, "{detour_s}");
        assert_eq!(
            schedule.detour_s(until_s),
            detour_s,
            "what is under way arrives"
        );
        assert_eq!(schedule.detour_s(until_s + AFTERWARDS_S), 0.0);
    }
}
