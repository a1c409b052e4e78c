//! A fault: its place, its kind and its amount.

use crate::signal::{BOARDS, IMUS, SPRINGS};

/// Place of a fault. Indices are 0-based.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Place {
    /// A spring's reading.
    Spring(usize),
    /// An IMU's reading.
    Imu(usize),
    /// A pressure gauge's reading.
    Gauge(usize),
    /// What supplies a chamber.
    Chamber(usize),
    /// A board and its line.
    Board(usize),
    /// The port that a program has open.
    Port,
    /// The supply of all chambers.
    Supply,
    /// The emergency stop's contact to a board.
    Stop(usize),
    /// The counter of a board's six springs.
    Counter(usize),
    /// The segments that the boards are plugged into.
    Segments,
}

/// Kind of fault.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Word {
    /// Gives no output.
    Off,
    /// Repeats its last output.
    Stuck,
    /// Gives random output.
    Garbage,
    /// Gives output with an error.
    Wrong,
    /// Gives output slowly.
    Slow,
    /// Gives output late.
    Delayed,
    /// Gives output now and then.
    Intermittent,
    /// Loses air.
    Leak,
    /// The clock jumps.
    Jump,
    /// Sends frames twice.
    Twice,
    /// Sends frames in the wrong order.
    Swapped,
    /// A contact or wire is open.
    Open,
    /// Has no power for a while.
    Reboot,
    /// Resets the boards when it is opened; their bootloader takes so long.
    Dtr,
    /// Lets the air out while it is off.
    Vents,
    /// Is plugged in where another one belongs, and that one here.
    Exchanged,
}

/// A fault with its amount.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fault {
    /// What it is.
    pub word: Word,
    /// How much of it, in the unit that [`amount`] gives.
    pub amount: f64,
}

impl Fault {
    /// A fault that has no number.
    pub fn of(word: Word) -> Self {
        Self { word, amount: 0.0 }
    }
}

/// What a number means with a fault: usual value, least, greatest, unit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Amount {
    /// Without a number in the script.
    pub usual: f64,
    /// Least.
    pub min: f64,
    /// Greatest.
    pub max: f64,
    /// What it is counted in.
    pub unit: &'static str,
}

/// Meaning of a fault's amount at a place; `None` when the place has no such fault.
pub fn amount(place: Place, word: Word) -> Option<Amount> {
    let of = |usual, min, max, unit| {
        Some(Amount {
            usual,
            min,
            max,
            unit,
        })
    };
    let none = of(0.0, 0.0, 0.0, "nothing");
    let share = |usual| of(usual, 0.0, 1.0, "share");
    match (place, word) {
        (Place::Port, Word::Off) | (Place::Supply, Word::Stuck) => none,
        (Place::Port, Word::Dtr) => of(1.0, 0.0, 10.0, "s"),
        (Place::Gauge(_) | Place::Stop(_), Word::Open) => none,
        (Place::Supply, Word::Vents) => of(20.0, 0.0, 1000.0, "l/min at 20 kPa"),
        (Place::Counter(_), Word::Stuck) | (Place::Segments, Word::Exchanged) => none,
        (Place::Spring(i), Word::Exchanged) => {
            partner(i, SPRINGS / BOARDS, "number of the other spring")
        }
        (Place::Imu(i), Word::Exchanged) => partner(i, IMUS / BOARDS, "number of the other IMU"),
        (Place::Port | Place::Supply | Place::Stop(_) | Place::Counter(_) | Place::Segments, _) => {
            None
        }
        (Place::Board(_), Word::Reboot) => of(0.05, 0.0, 60.0, "s"),
        (_, Word::Off | Word::Stuck | Word::Garbage) => none,
        (_, Word::Delayed) => of(0.1, 0.0, 10.0, "s"),
        (_, Word::Intermittent) => share(0.5),
        (Place::Spring(_), Word::Wrong) => of(10.0, -200.0, 200.0, "mm"),
        (Place::Imu(_), Word::Wrong) => of(5.0, -500.0, 500.0, "deg/s"),
        (Place::Gauge(_), Word::Wrong) => of(5.0, -100.0, 100.0, "kPa"),
        (Place::Chamber(_), Word::Wrong) => of(50.0, -100.0, 100.0, "kPa"),
        (Place::Board(_), Word::Wrong) => share(0.01),
        (Place::Chamber(_), Word::Slow) => share(0.3),
        (Place::Board(_), Word::Slow) => of(5000.0, 1.0, 1e6, "bytes/s"),
        (_, Word::Slow) => of(0.2, 0.01, 10.0, "s"),
        (Place::Chamber(_), Word::Leak) => of(2.2, 0.0, 100.0, "l/min at 20 kPa"),
        (Place::Board(_), Word::Jump) => of(1.0, -1e6, 1e6, "s"),
        (Place::Board(_), Word::Twice | Word::Swapped) => share(0.05),
        (
            _,
            Word::Leak
            | Word::Jump
            | Word::Twice
            | Word::Swapped
            | Word::Open
            | Word::Reboot
            | Word::Dtr
            | Word::Vents
            | Word::Exchanged,
        ) => None,
    }
}

/// Number of a sensor of the same board, of which each has `each`; usually the one beside channel `i` (0-based).
fn partner(i: usize, each: usize, unit: &'static str) -> Option<Amount> {
    let first = i - i % each;
    Some(Amount {
        usual: ((i ^ 1) + 1) as f64,
        min: (first + 1) as f64,
        max: (first + each) as f64,
        unit,
    })
}
