//! Checks before a calibration: link, sensors, motion capture, mode.

use crate::signal::{BOARDS, CHAMBERS, IMUS, Mode, SPRINGS, Snapshot, TruthSource};

/// Least frame rate of a board that the filters are designed for, Hz.
const RATE_MIN_HZ: f64 = 90.0;
/// Age above which frames are old, s.
const FRAME_AGE_S: f64 = 0.25;
/// Age above which motion capture counts as not seen, s.
const TRUTH_AGE_S: f64 = 0.5;
/// Name of the check of motion capture; the steps before the registration do without it.
pub const MOCAP: &str = "Motion capture";

/// A check with its result.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Check {
    /// Name of what is checked.
    pub name: &'static str,
    /// What was found, with its figure.
    pub found: String,
    /// What is needed.
    pub limit: String,
    /// Whether it passed, or what to do.
    pub verdict: Result<(), String>,
}

fn missing(what: &str, list: &[usize]) -> Result<(), String> {
    if list.is_empty() {
        return Ok(());
    }
    let words: Vec<String> = list.iter().map(|i| (i + 1).to_string()).collect();
    Err(format!(
        "{what} {}: check plug and cable.",
        words.join(", ")
    ))
}

fn check(
    name: &'static str,
    found: String,
    limit: impl Into<String>,
    verdict: Result<(), String>,
) -> Check {
    Check {
        name,
        found,
        limit: limit.into(),
        verdict,
    }
}

fn fail(ok: bool, what: &str) -> Result<(), String> {
    if ok { Ok(()) } else { Err(what.to_owned()) }
}

/// The checks of boards that answer: their rates and what they read.
fn sensors(s: &Snapshot) -> Vec<Check> {
    let raw = s.raw.as_ref();
    let mut out = Vec::new();
    for (b, name) in (0..BOARDS).zip(["Board 1 rate", "Board 2 rate"]) {
        let hz = s.link.board_rate_hz[b];
        let verdict = fail(
            hz >= RATE_MIN_HZ,
            "Less than 90 frames a second: use another USB port or hub.",
        );
        let limit = format!("at least {RATE_MIN_HZ:.0} Hz");
        out.push(check(name, format!("{hz:.1} Hz"), limit, verdict));
    }
    let silent: Vec<usize> = (0..SPRINGS)
        .filter(|i| raw.is_none_or(|r| !r.has_spring(*i) || r.spring_counts[*i] == 0))
        .collect();
    let found = format!("{} of {SPRINGS} counted", SPRINGS - silent.len());
    out.push(check(
        "Springs",
        found,
        "all",
        missing("No counts from spring", &silent),
    ));
    let dead: Vec<usize> = (0..IMUS)
        .filter(|i| raw.is_none_or(|r| !r.has_imu(*i)))
        .collect();
    let found = format!("{} of {IMUS} answer", IMUS - dead.len());
    out.push(check(
        "IMUs",
        found,
        "all",
        missing("No data from IMU", &dead),
    ));
    let health = s.sensors.as_ref().map(|f| f.health.chambers);
    let bad: Vec<usize> = (0..CHAMBERS)
        .filter(|i| raw.is_none() || health.is_none_or(|h| !h[*i].usable()))
        .collect();
    let found = format!("{} of {CHAMBERS} read", CHAMBERS - bad.len());
    out.push(check(
        "Pressure gauges",
        found,
        "all",
        missing("No pressure from gauge", &bad),
    ));
    out
}

fn link(s: &Snapshot) -> Check {
    let verdict = match (&s.link.refusal, s.link.connected) {
        (Some(why), _) => Err(why.clone()),
        (None, false) => Err(s.link.trouble.clone().unwrap_or_else(|| {
            "Plug the boards in and start with --rig PORT, or read a bench log.".into()
        })),
        (None, true) => fail(
            s.link.age_s < FRAME_AGE_S,
            "Frames are old: check the cable.",
        ),
    };
    let found = match s.link.connected {
        true => format!("{}, {:.0} ms old", s.link.source, s.link.age_s * 1e3),
        false => "no boards".into(),
    };
    let limit = format!("frames at most {:.0} ms old", FRAME_AGE_S * 1e3);
    check("Link", found, limit, verdict)
}

fn mocap(s: &Snapshot) -> Check {
    let truth = s.truth.as_ref();
    let fresh = truth.filter(|t| s.stamp.since(t.stamp) < TRUTH_AGE_S);
    let found = match fresh.map(|t| t.source) {
        Some(TruthSource::VirtualRig) => "Vicon (simulated) sees the end pad",
        Some(TruthSource::Vicon) => "Vicon sees the end pad",
        None => "not seen",
    };
    let todo = "The Vicon step will be skipped: start Tracker's stream to have predictions scored.";
    let limit = format!("the end pad seen within {TRUTH_AGE_S:.1} s");
    let todo = s.link.mocap_trouble.as_deref().unwrap_or(todo);
    check(MOCAP, found.into(), limit, fail(fresh.is_some(), todo))
}

fn at_rest(mode: &Mode) -> Check {
    let (found, verdict) = match mode {
        Mode::Safe(why) => (format!("SAFE: {why}"), Err("Press Reset first.".to_owned())),
        Mode::Moving => ("moves".into(), Err("Press HOLD first.".into())),
        Mode::Hold => ("holds".into(), Ok(())),
        Mode::AtGoal => ("rests at its goal".into(), Ok(())),
        Mode::Disarmed => ("disarmed".into(), Ok(())),
    };
    check("Arm at rest", found, "at rest, not SAFE", verdict)
}

/// The checks, in the order they are shown. Without a link there are none of the sensors.
pub fn checks(s: &Snapshot) -> Vec<Check> {
    let mut out = vec![link(s)];
    if s.link.connected {
        out.extend(sensors(s));
    }
    out.push(mocap(s));
    out.push(at_rest(&s.mode));
    out
}
