//! The report of a run without a window.

use std::path::Path;

use serde_json::{Value, json};

use crate::cli::Report;
use springtwin::drive::Ran;
use springtwin::signal::{BOARDS, LinkStatus, Mode, StreamState, StreamStatus};

/// The report of a run without a window.
pub fn report(ran: &Ran, record: Option<&Path>) -> Report {
    let (tally, pace, seconds) = (&ran.tally, ran.pace, ran.seconds);
    let tip = json!(tally.tip_error_mm.stats());
    let rotation = json!(tally.rotation_error_deg.stats());
    let target = tally.target_error_mm();
    let link = tally
        .last
        .as_ref()
        .map(|s| s.link.clone())
        .unwrap_or_default();
    let mode = tally
        .last
        .as_ref()
        .map(|s| mode_word(&s.mode))
        .unwrap_or("disarmed");
    let show = |v: &Value, unit: &str| {
        v["mean"]
            .as_f64()
            .map_or("no ground truth".to_owned(), |m| {
                format!("{m:.2} {unit} mean")
            })
    };
    let simulated = if link.simulated {
        " (simulated rig)"
    } else {
        ""
    };
    Report {
        text: format!(
            "{seconds:.1} s on {}{simulated}, {} ticks, {} missed, {} frames, {} lost\n\
             predicted against motion capture: {}, {}\n\
             {}mode {mode}{}",
            link.source,
            pace.ticks,
            pace.missed,
            link.frames,
            link.frames_lost,
            show(&tip, "mm"),
            show(&rotation, "deg"),
            target.map_or(String::new(), |t| format!(
                "true tip {t:.2} mm from the target ({})\n",
                if tally.reached {
                    format!("settled after {} steps", tally.steps)
                } else {
                    "not settled".to_owned()
                }
            )),
            clock_lines(&link)
                + &record.map_or(String::new(), |p| match tally.recording_failed {
                    Some(_) => format!("\nrecorded to {} in part only", p.display()),
                    None => format!("\nrecorded to {}", p.display()),
                })
                + &tally.stream.as_ref().map_or(String::new(), stream_line),
        ),
        json: json!({
            "ticks": pace.ticks, "missed_ticks": pace.missed,
            "frames": link.frames, "frames_lost": link.frames_lost,
            "tip_error_mm": tip, "target_error_mm": target,
            "scored_ticks": tally.tip_error_mm.count(),
            "rotation_error_deg": rotation, "seconds": seconds,
            "reached": tally.reached, "steps": tally.steps, "mode": mode,
            "unsolved_ticks": tally.last.as_ref().map_or(0, |s| s.unsolved_ticks),
            "simulated": link.simulated, "boards": boards(&link),
            "recording_failed": tally.recording_failed,
            "stream": tally.stream.as_ref().map(stream_json),
        }),
    }
}

fn stream_json(status: &StreamStatus) -> Value {
    let ended = match &status.state {
        StreamState::Ended(reason) | StreamState::Away(reason) => Some(reason),
        _ => None,
    };
    json!({
        "address": status.address.to_string(), "sent": status.sent,
        "dropped": status.dropped, "dropped_lines": status.dropped_lines, "ended": ended,
    })
}

fn stream_line(status: &StreamStatus) -> String {
    let ended = match &status.state {
        StreamState::Ended(reason) | StreamState::Away(reason) => format!(": {reason}"),
        _ => String::new(),
    };
    format!(
        "\nstreamed {} snapshots to {}, {} dropped{ended}",
        status.sent, status.address, status.dropped
    )
}

/// Per board: its rate, and how its clock lies on the time base.
fn boards(link: &LinkStatus) -> Value {
    let board = |b: usize| {
        let clock = link.board_clock[b].map(|c| {
            json!({
                "offset_ms": c.offset_s * 1e3, "skew_ppm": c.skew_ratio * 1e6,
                "residual_ms": c.residual_s * 1e3, "round_trip_ms": c.round_trip_s * 1e3,
            })
        });
        json!({"rate_hz": link.board_rate_hz[b], "clock": clock})
    };
    (0..BOARDS).map(board).collect()
}

fn clock_lines(link: &LinkStatus) -> String {
    let clocks = link.board_clock.iter().enumerate();
    clocks
        .filter_map(|(b, clock)| {
            let c = (*clock)?;
            Some(format!(
                "\nclock of board {}: {:.4} s {} ours, runs {:.0} ppm {}, pings within {:.3} ms",
                b + 1,
                c.offset_s.abs(),
                if c.offset_s > 0.0 {
                    "behind"
                } else {
                    "ahead of"
                },
                c.skew_ratio.abs() * 1e6,
                if c.skew_ratio > 0.0 { "slow" } else { "fast" },
                c.residual_s * 1e3
            ))
        })
        .collect()
}

fn mode_word(mode: &Mode) -> &'static str {
    match mode {
        Mode::Disarmed => "disarmed",
        Mode::Hold => "hold",
        Mode::Moving => "moving",
        Mode::AtGoal => "at-goal",
        Mode::Safe(_) => "safe",
    }
}
