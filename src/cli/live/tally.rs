//! What a run without a window adds up to.

use std::collections::VecDeque;
use std::path::Path;
use std::sync::Arc;

use serde_json::{Value, json};

use super::super::Report;
use springtwin::learn::RunningStats;
use springtwin::signal::{
    BOARDS, Goal, LinkStatus, Mode, Snapshot, Stamp, StreamState, StreamStatus, pose_error,
};
use springtwin::twin::{Event, Pace};

/// The distance from the target is the mean over so long before the end, s.
const TARGET_S: f64 = 1.0;

/// What a run adds up to.
#[derive(Default)]
pub struct Tally {
    /// Errors of the estimate where motion capture saw the tip at the same time.
    tip_error_mm: RunningStats,
    rotation_error_deg: RunningStats,
    /// Distance of the true tip from the target with its time, over the last second, mm.
    target_error_mm: VecDeque<(Stamp, f64)>,
    pub refused: Option<String>,
    /// Why the recording ended before the run.
    pub recording_failed: Option<String>,
    reached: bool,
    steps: u64,
    pub last: Option<Arc<Snapshot>>,
    pub stream: Option<StreamStatus>,
}

impl Tally {
    /// Takes one tick. Its memory does not grow with the number of ticks.
    pub fn take(&mut self, snapshot: &Arc<Snapshot>, events: &[Event], target: Option<&Goal>) {
        for event in events {
            match event {
                Event::Refused { reason, .. } => self.refused = Some(reason.clone()),
                Event::RecordingFailed { reason, .. } => {
                    self.recording_failed = Some(reason.clone());
                }
                Event::Reached { steps, .. } => {
                    self.reached = true;
                    self.steps = *steps;
                }
                _ => {}
            }
        }
        // What motion capture saw before it lost the object says nothing of now.
        let truth = snapshot.fresh_truth();
        if let (Some(estimate), Some(truth)) = (&snapshot.estimate, truth) {
            let e = pose_error(&estimate.base_from_tip, &truth.base_from_tip);
            self.tip_error_mm.push(e.fixed_rows::<3>(0).norm() * 1e3);
            self.rotation_error_deg
                .push(e.fixed_rows::<3>(3).norm().to_degrees());
        }
        if let (Some(target), Some(truth)) = (target, truth) {
            let d =
                truth.base_from_tip.translation.vector - nalgebra::Vector3::from(target.position_m);
            self.target_error_mm
                .push_back((snapshot.stamp, d.norm() * 1e3));
        }
        let is_old = |(at, _): &(Stamp, f64)| snapshot.stamp.since(*at) >= TARGET_S;
        while self.target_error_mm.front().is_some_and(is_old) {
            self.target_error_mm.pop_front();
        }
        self.last = Some(Arc::clone(snapshot));
    }

    /// What is reported of the run.
    pub fn report(&self, pace: Pace, seconds: f64, record: Option<&Path>) -> Report {
        let tip = json!(self.tip_error_mm.stats());
        let rotation = json!(self.rotation_error_deg.stats());
        let off_mm = self.target_error_mm.iter().map(|(_, mm)| mm);
        let target = (!self.target_error_mm.is_empty())
            .then(|| off_mm.sum::<f64>() / self.target_error_mm.len() as f64);
        let link = self
            .last
            .as_ref()
            .map(|s| s.link.clone())
            .unwrap_or_default();
        let mode = self
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
                    if self.reached {
                        format!("settled after {} steps", self.steps)
                    } else {
                        "not settled".to_owned()
                    }
                )),
                clock_lines(&link)
                    + &record.map_or(String::new(), |p| match self.recording_failed {
                        Some(_) => format!("\nrecorded to {} in part only", p.display()),
                        None => format!("\nrecorded to {}", p.display()),
                    })
                    + &self.stream.as_ref().map_or(String::new(), stream_line),
            ),
            json: json!({
                "ticks": pace.ticks, "missed_ticks": pace.missed,
                "frames": link.frames, "frames_lost": link.frames_lost,
                "tip_error_mm": tip, "target_error_mm": target,
                "scored_ticks": self.tip_error_mm.count(),
                "rotation_error_deg": rotation, "seconds": seconds,
                "reached": self.reached, "steps": self.steps, "mode": mode,
                "unsolved_ticks": self.last.as_ref().map_or(0, |s| s.unsolved_ticks),
                "simulated": link.simulated, "boards": boards(&link),
                "recording_failed": self.recording_failed,
                "stream": self.stream.as_ref().map(stream_json),
            }),
        }
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

#[cfg(test)]
mod tests {
    use super::*;
    use springtwin::signal::{Estimate, GroundTruth, Matrix6, Pose, TruthSource};

    /// A tick of a tip that moves by 1 mm/s along x; motion capture sees it exactly until `lost_s`.
    fn tick(k: u32, lost_s: f64) -> Arc<Snapshot> {
        let at = |t_s: f64| Pose::translation(1e-3 * t_s, 0.0, -0.3);
        let t_s = f64::from(k) * 0.01;
        let seen_s = t_s.min(lost_s);
        Arc::new(Snapshot {
            stamp: Stamp::from_seconds(t_s),
            estimate: Some(Estimate {
                stamp: Stamp::from_seconds(t_s),
                base_from_tip: at(t_s),
                covariance: Matrix6::zeros(),
                training_distance: 1.0,
            }),
            truth: Some(GroundTruth {
                stamp: Stamp::from_seconds(seen_s),
                base_from_tip: at(seen_s),
                source: TruthSource::Vicon,
            }),
            ..Snapshot::default()
        })
    }

    fn json_of(tally: &Tally) -> Value {
        tally.report(Pace::default(), 20.0, None).json
    }

    #[test]
    fn a_pose_from_before_motion_capture_stopped_scores_nothing() {
        let target = Goal::position([0.0, 0.0, -0.3]);
        let mut tally = Tally::default();
        for k in 0..2000 {
            tally.take(&tick(k, 5.0), &[], Some(&target));
        }
        let v = json_of(&tally);
        // Up to 0.1 s old it is compared: 0.1 mm at 1 mm/s.
        let most_mm = v["tip_error_mm"]["max"].as_f64().expect("scored");
        assert!(most_mm <= 0.1 + 1e-9, "{v}");
        assert_eq!(v["scored_ticks"], 511, "{v}");
        assert_eq!(v["target_error_mm"], Value::Null, "15 s without: {v}");
    }

    #[test]
    fn hours_take_no_more_memory_than_seconds() {
        let target = Goal::position([0.0, 0.0, -0.3]);
        let mut tally = Tally::default();
        let bytes = |t: &Tally| {
            let queue = t.target_error_mm.capacity() * size_of::<(Stamp, f64)>();
            t.tip_error_mm.bytes() + t.rotation_error_deg.bytes() + queue
        };
        for k in 0..2000 {
            tally.take(&tick(k, f64::MAX), &[], Some(&target));
        }
        let early = bytes(&tally);
        for k in 2000..200_000 {
            tally.take(&tick(k, f64::MAX), &[], Some(&target));
        }
        assert_eq!(bytes(&tally), early);
        assert!(early < 100_000, "{early} bytes");
        let v = json_of(&tally);
        let off_mm = v["target_error_mm"].as_f64().expect("seen to the end");
        assert!((off_mm - 1999.5).abs() < 0.1, "{v}");
    }
}
