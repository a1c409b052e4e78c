//! The state of the twin in words, and which orders it takes now.

use crate::gui::theme::Level;
use crate::gui::view::{Gate, View};
use crate::signal::{Mode, Severity, Snapshot};
use crate::twin::Event;

/// Word, glyph and level of a mode.
pub fn mode_words(mode: &Mode) -> (&'static str, &'static str, Level) {
    match mode {
        Mode::Disarmed => ("○", "DISARMED", Level::Normal),
        Mode::Hold => ("▮▮", "HOLD", Level::Normal),
        Mode::Moving => ("▶", "MOVING", Level::Normal),
        Mode::AtGoal => ("◎", "AT GOAL", Level::Normal),
        Mode::Safe(_) => ("⊗", "SAFE", Level::Critical),
    }
}

/// Whether HOLD may be pressed. It only ever holds: an arm that holds already stays so, and what is being checked
/// does not begin.
pub fn hold_gate(snapshot: &Snapshot) -> Gate {
    match snapshot.mode {
        Mode::Moving | Mode::AtGoal | Mode::Hold => Ok(()),
        Mode::Disarmed => {
            Err("Disarmed: no pressure is commanded, there is nothing to hold.".into())
        }
        Mode::Safe(_) => Err("SAFE: the pumps are off, there is nothing to hold.".into()),
    }
}

/// Level of an alarm's severity.
pub fn severity_level(severity: Severity) -> Level {
    match severity {
        Severity::Info => Level::Normal,
        Severity::Warning => Level::Warning,
        Severity::Critical => Level::Critical,
    }
}

/// Whether a recording may be started or stopped.
pub fn recording_gate(live: &View<'_>, twin_gone: bool) -> Gate {
    if twin_gone {
        return Err("No twin is running: there is nothing to record.".into());
    }
    if live.snapshot.recording.is_none() && !live.snapshot.link.connected {
        return Err("Not connected: there is nothing to record.".into());
    }
    Ok(())
}

/// Whether an event ends a recording: its file is closed, or was never written.
pub fn ends_recording(event: &Event) -> bool {
    matches!(
        event,
        Event::Recording { .. } | Event::RecordingFailed { .. }
    )
}
