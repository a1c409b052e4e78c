//! Events of a link.

use super::ports::PortChange;
use super::wire::{BAUD, SCHEMA_HASH, VERSION, fault};
use crate::signal::Severity;

/// Why a board is not used. The arm cannot be armed while one stands.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Refusal {
    /// Another protocol version.
    #[error(
        "Board {} speaks protocol version {theirs}, this program version {VERSION}: flash the firmware that belongs to this program.",
        board + 1
    )]
    Version {
        /// 0-based.
        board: usize,
        /// The board's version.
        theirs: u16,
    },
    /// Another layout of the same version.
    #[error(
        "Board {} uses message layout {theirs:08x}, this program {SCHEMA_HASH:08x}: flash the firmware that belongs to this program.",
        board + 1
    )]
    Schema {
        /// 0-based.
        board: usize,
        /// The board's schema hash.
        theirs: u32,
    },
    /// The board did not take our limits.
    #[error(
        "Board {} does not accept the pressure limits of the robot file (its configuration is {theirs:08x}, wanted {ours:08x}): keep within ±40 kPa and 42 kPa over-pressure, or flash other firmware.",
        board + 1
    )]
    Config {
        /// 0-based.
        board: usize,
        /// CRC of the board's configuration, 0 for none.
        theirs: u32,
        /// CRC of the wanted one.
        ours: u32,
    },
}

/// Something that happened on the link.
#[derive(Clone, Debug, PartialEq)]
pub enum LinkEvent {
    /// A board answered and everything matches.
    BoardReady {
        /// 0-based.
        board: usize,
        /// Its firmware id.
        firmware: u32,
    },
    /// A board answered, but does not match.
    Refused(Refusal),
    /// A board restarted: it must be armed again.
    BoardRebooted {
        /// 0-based.
        board: usize,
    },
    /// A board is back that was away, and has not restarted meanwhile: it must be armed again.
    BoardBack {
        /// 0-based.
        board: usize,
    },
    /// A board has sent nothing for half a second: it must be armed again.
    BoardSilent {
        /// 0-based.
        board: usize,
    },
    /// A board's clock jumped; samples are on the new fit from here on.
    ClockJump {
        /// 0-based.
        board: usize,
        /// By how much, s (positive: ahead).
        jump_s: f64,
    },
    /// A board went SAFE.
    BoardSafe {
        /// 0-based.
        board: usize,
        /// Bits of [`fault`].
        faults: u16,
    },
    /// The last command was not renewed in time; no set points are sent until the next one.
    CommandStale,
    /// More than a tenth of the last second's frames were lost; reported once until the loss is over.
    HighLoss {
        /// Lost, of all.
        ratio: f64,
    },
    /// The port is gone.
    Disconnected {
        /// Message of the operating system.
        reason: String,
    },
    /// Nothing that was received on a port is a frame; reported once until the port is opened again.
    Unheard {
        /// Its name.
        port: String,
        /// Received since it was opened.
        bytes: u64,
    },
    /// A port that is gone does not open, for another reason than that it is gone.
    NotBack {
        /// One sentence: what is in the way, and what to do.
        reason: String,
    },
    /// Motion capture is received and not used.
    MocapIgnored {
        /// One sentence: what, from whom, and what to do.
        reason: String,
    },
    /// A serial port came or went while ours is gone.
    Ports(PortChange),
    /// The port is back; boards must answer and the arm be armed again.
    Reconnected,
}

impl LinkEvent {
    /// Severity.
    pub fn severity(&self) -> Severity {
        match self {
            Self::BoardReady { .. }
            | Self::BoardBack { .. }
            | Self::Ports(_)
            | Self::Reconnected => Severity::Info,
            Self::Refused(_)
            | Self::BoardRebooted { .. }
            | Self::BoardSilent { .. }
            | Self::ClockJump { .. }
            | Self::BoardSafe { .. }
            | Self::CommandStale
            | Self::HighLoss { .. }
            | Self::Disconnected { .. }
            | Self::Unheard { .. }
            | Self::NotBack { .. }
            | Self::MocapIgnored { .. } => Severity::Warning,
        }
    }

    /// One sentence for the operator.
    pub fn text(&self) -> String {
        match self {
            Self::BoardReady { board, firmware } => {
                format!("Board {} is ready (firmware {firmware:08x}).", board + 1)
            }
            Self::Refused(refusal) => refusal.to_string(),
            Self::BoardRebooted { board } => {
                format!(
                    "Board {} restarted: check its supply, then arm again.",
                    board + 1
                )
            }
            Self::BoardBack { board } => format!(
                "Board {} is back and has not restarted: press Reset if it is SAFE, then arm.",
                board + 1
            ),
            Self::BoardSilent { board } => {
                format!("Board {} is silent: check its cable and supply.", board + 1)
            }
            Self::ClockJump { board, jump_s } => format!(
                "The clock of board {} jumped by {:.1} ms; its samples were put on a new fit.",
                board + 1,
                jump_s * 1e3
            ),
            Self::BoardSafe { board, faults } => format!(
                "Board {} switched its pumps off: {}. Remove the cause, then reset.",
                board + 1,
                fault_words(*faults)
            ),
            Self::CommandStale => {
                "The control loop stood still: the boards were stopped. Press Reset, then arm."
                    .into()
            }
            Self::HighLoss { ratio } => format!(
                "{:.0} % of the last second's frames were lost: check the cable.",
                ratio * 100.0
            ),
            Self::Disconnected { reason } => {
                format!("The link is gone ({reason}): check the cable; trying again.")
            }
            Self::Unheard { port, bytes } => unheard(port, *bytes),
            Self::NotBack { reason } => format!("The port does not come back: {reason}"),
            Self::MocapIgnored { reason } => reason.clone(),
            Self::Ports(change) => change.text(),
            Self::Reconnected => {
                "The port is back: press Reset if the boards are SAFE, then arm.".into()
            }
        }
    }
}

/// Why a port gives no frames on which so many bytes were received.
pub(super) fn unheard(port: &str, bytes: u64) -> String {
    let amount = match bytes {
        0 => {
            return format!(
                "No board is heard on {port}: nothing received. Check the boards' power and cable, and that this is \
                 their port."
            );
        }
        1..10_000 => format!("{bytes} bytes"),
        _ => format!("{} kB", bytes / 1000),
    };
    format!(
        "No board is heard on {port}: {amount} received, no frame understood. It is another device, or sends at another \
         baud rate than {BAUD}: choose the boards' port, or flash their firmware."
    )
}

/// A bit of [`fault`]: its name on the command line, and what it means to the operator.
struct Cause(u16, &'static str, &'static str);

const CAUSES: [Cause; 11] = [
    Cause(fault::BOOTED, "booted", "they have started"),
    Cause(
        fault::STOP_INPUT,
        "emergency-stop",
        "the emergency stop was pressed",
    ),
    Cause(fault::ESTOP, "stop", "a program sent a stop"),
    Cause(
        fault::ENDED,
        "ended",
        "the program that used them has ended",
    ),
    Cause(
        fault::CONTROL_SILENT,
        "control-silent",
        "the control loop stood still",
    ),
    Cause(
        fault::HEARTBEAT_LOST,
        "heartbeat-lost",
        "the program was not heard",
    ),
    Cause(fault::OVER_PRESSURE, "over-pressure", "over-pressure"),
    Cause(
        fault::GAUGE_LOST,
        "gauge-lost",
        "a pressure gauge does not answer",
    ),
    Cause(
        fault::SETPOINT_EXPIRED,
        "set-point-expired",
        "no new set point came in time",
    ),
    Cause(fault::SPRING_LOST, "spring-lost", "a spring gives no count"),
    Cause(fault::IMU_LOST, "imu-lost", "an IMU does not answer"),
];

fn among(faults: u16) -> impl Iterator<Item = &'static Cause> {
    CAUSES.iter().filter(move |c| faults & c.0 != 0)
}

/// The causes among the bits of [`fault`], in words.
pub fn fault_words(faults: u16) -> String {
    let words: Vec<_> = among(faults).map(|c| c.2).collect();
    match words.is_empty() {
        true => "no cause given".into(),
        false => words.join(", "),
    }
}

/// Names of the causes among the bits of [`fault`], separated by commas.
pub fn fault_names(faults: u16) -> String {
    let names: Vec<_> = among(faults).map(|c| c.1).collect();
    names.join(",")
}

/// The bit of [`fault`] of this name; `None` if it is not one that latches.
pub fn fault_of_name(name: &str) -> Option<u16> {
    let latching = CAUSES.iter().filter(|c| c.0 & fault::LATCHING != 0);
    latching.into_iter().find(|c| c.1 == name).map(|c| c.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stop_that_a_program_sent_is_not_said_to_be_a_button() {
        let words = fault_words(fault::ESTOP | fault::OVER_PRESSURE);
        assert_eq!(words, "a program sent a stop, over-pressure");
    }
}
