//! What must hold beside a person: each requirement of the guide's page on safety with its bound, and the worst of many
//! runs. What boards must do themselves is measured in `conformance/safety.rs`.

mod contact;
mod nuisance;
mod program;
mod scenarios;

use crate::faults::bench::Boards;
use crate::faults::keep;

/// Runs of which the worst counts.
pub const RUNS: usize = 50;

/// The same where a run takes long under simavr: fewer in every run of the tests, all of them for the guide's table.
pub fn runs(boards: Boards, in_every_test: usize) -> usize {
    let all = boards == Boards::Emulated || std::env::var_os("SPRINGTWIN_ALL_RUNS").is_some();
    if all { RUNS } else { in_every_test }
}

/// The requirements; their numbers count from 1.
const REQUIREMENTS: [&str; 12] = [
    "When no heartbeat has come for 200 ms, a board is off within 250 ms of the last one, and latched until a RESET \
     with a new id.",
    "When STOP is pressed (pointer down, or Shift+Esc), all boards are off within 50 ms plus one frame of the window, \
     whatever the control thread does.",
    "When a gauge is beyond ±42 kPa or gives no value in two checks running, its board is off within 20 ms, the other \
     within 60 ms.",
    "When a set point is not renewed for 150 ms, the board is off within 160 ms, and does not drive again before the \
     operator arms again.",
    "When the control loop has not ticked for 250 ms, or the window has not answered for 5 s while the arm moves on \
     hardware (2 s: HOLD), heartbeats cease and the boards are SAFE within a further 250 ms; the window shows \"control \
     silent\" within 0.5 s.",
    "When a board starts for any reason, it keeps its regulators off and the gripper as it was, and is latched within \
     20 ms until a RESET.",
    "When the mode shown and the boards' pumps differ for 100 ms, the program goes SAFE. When a pressure moves 2 kPa away \
     from 0 while the pumps are off, it states within 1 s that the supply is still on, and opens the second output that \
     cuts it.",
    "When VENT is held for 0.8 s, in SAFE too, the boards bring all chambers to ±2 kPa by 12 kPa/s at most, and are off \
     then.",
    "When the emergency stop's contact opens, the boards are SAFE within 20 ms, and stay so after it closes, until a \
     RESET.",
    "When the program connects or arms, the gripper stays as the boards report it. With a load declared it opens on \
     hardware only at rest and after 0.8 s of holding the button, and a plan that would open it first is refused.",
    "When a chamber is 5 kPa off its set pressure for 0.3 s and does not come nearer, SAFE within 0.5 s. When hardware is \
     armed, each gauge follows its chamber within 2 s, and no other does.",
    "When the arm is held off (pressures changed by more than 5 kPa, less than 2 mm of progress in 2 s), or its tip is \
     moved at three times the speed limit for 0.3 s, the pressures are back within 1 s at most 2 kPa above those before, \
     and held. When the distance to the target grows by 10 mm over its best for 1 s: SAFE.",
];

/// What one case of a requirement came to.
pub struct Case<'a> {
    /// The requirement's number.
    pub of: usize,
    /// The case's place among those of the requirement.
    pub place: u8,
    /// What was done and measured.
    pub what: &'a str,
    /// `emulated` or `firmware`.
    pub boards: &'a str,
    /// What is allowed, and the worst that was measured, in `unit`.
    pub bound: f64,
    pub worst: f64,
    pub unit: &'a str,
    pub runs: usize,
}

impl Case<'_> {
    /// Holds the case to its bound and keeps it for the guide.
    pub fn keep(&self) {
        let Self {
            of,
            what,
            boards,
            bound,
            worst,
            unit,
            runs,
            ..
        } = self;
        let title = REQUIREMENTS[of - 1];
        let head = format!(
            "\n**{of}.** {title}\n\n| measured | boards | bound | worst | runs |\n|---|---|---|---|---|"
        );
        keep("safety", (*of as u8, 0), &head);
        let digits = usize::from(unit.starts_with("kPa"));
        keep(
            "safety",
            (
                *of as u8,
                2 * self.place + 1 + u8::from(*boards == "firmware"),
            ),
            &format!("| {what} | {boards} | {bound} {unit} | {worst:.digits$} {unit} | {runs} |"),
        );
        assert!(worst <= bound, "{of}, {what}, {boards}: {worst} {unit}");
    }
}

/// Keeps the worst time of a requirement that a board must meet by itself, s.
pub fn requirement(of: usize, boards: &str, worst_s: f64) {
    let (what, bound) = match of {
        1 => ("board: from the last heartbeat to pumps off", 250.0),
        2 => ("board: from ESTOP on its line to pumps off", 10.0),
        3 => ("board: from the gauge's reading to its own pumps off", 20.0),
        4 => ("board: from the last set point to pumps off", 160.0),
        6 => (
            "board: from power to the first sample, which reports it latched",
            20.0,
        ),
        9 => ("board: from the open contact to pumps off", 20.0),
        _ => unreachable!("requirement {of} is none of a board alone"),
    };
    Case {
        of,
        place: 0,
        what,
        boards,
        bound,
        worst: worst_s * 1e3,
        unit: "ms",
        runs: RUNS,
    }
    .keep();
}
