//! Every alarm: when it comes, what follows, what to check. The guide's page of alarms and the window's hints are made of it.

use super::air::{ADRIFT_PA, ADRIFT_S, SAFE_S, WARN_S};
use super::pumps::{DIFFER_S, STILL_FED_PA};
use super::state::{BLIND_FRAMES, LATE_OVER_S, REMEDY, STALE_SAFE_S, STALE_WARN_S};
use super::watch::{LOSS_SAFE, UNSOLVED_S};
use crate::signal::{AlarmCause, ChannelHealth, Evidence, Need};

/// What an operator wants to know of an alarm.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct AlarmHelp {
    /// Its name in commands and on the guide's page.
    pub id: &'static str,
    /// When it comes.
    pub when: String,
    /// What the program does then, and what it does not.
    pub follows: String,
    /// What to look at, the likeliest first.
    pub check: &'static str,
}

/// One of each, with likely numbers; its sentence stands on the guide's page.
pub fn example_alarms() -> Vec<AlarmCause> {
    let evidence = Evidence {
        health: ChannelHealth::Suspect,
        probability: 0.97,
        ..Evidence::default()
    };
    let spring = |health| AlarmCause::Spring {
        spring: 3,
        evidence: Evidence {
            health,
            probability: 1.0,
            ..Evidence::default()
        },
    };
    let imu = |health| AlarmCause::Imu {
        imu: 2,
        evidence: Evidence {
            health,
            probability: 1.0,
            ..Evidence::default()
        },
    };
    vec![
        AlarmCause::EmergencyStop,
        AlarmCause::Safe {
            reason: "stopped by the operator".to_owned(),
            remedy: REMEDY,
        },
        AlarmCause::OverPressure {
            chamber: 1,
            measured_pa: 43.1e3,
            limit_pa: 42e3,
        },
        AlarmCause::StillFed {
            chamber: 1,
            measured_pa: 6.5e3,
        },
        AlarmCause::PumpsRun { board: 0 },
        AlarmCause::TooFewSensors,
        AlarmCause::DataOld {
            age_s: 0.12,
            busy_s: None,
        },
        AlarmCause::DataLate { late_s: 0.04 },
        AlarmCause::BoardOld {
            board: 1,
            age_s: 0.05,
        },
        AlarmCause::FramesLost {
            ratio: 0.12,
            busy_s: None,
        },
        AlarmCause::ShortOfAir {
            chamber: 1,
            measured_pa: 12.1e3,
            set_pa: 18.0e3,
        },
        spring(ChannelHealth::Missing),
        spring(ChannelHealth::Stuck),
        spring(ChannelHealth::OutOfRange),
        AlarmCause::Spring {
            spring: 3,
            evidence: Evidence {
                off_m: Some(3.1e-3),
                ..evidence
            },
        },
        imu(ChannelHealth::Missing),
        imu(ChannelHealth::Stuck),
        imu(ChannelHealth::OutOfRange),
        AlarmCause::Imu { imu: 2, evidence },
        AlarmCause::SegmentSuspect {
            segment: 0,
            suspects: vec![("spring 4".to_owned(), 0.6), ("IMU 1".to_owned(), 0.4)],
        },
        AlarmCause::PoseUnknown {
            need: Need::Position(1, 8.1e-3),
        },
        AlarmCause::Unsolved { ticks: 12 },
        AlarmCause::ContactIgnored,
        AlarmCause::NoDataYet,
    ]
}

const GO_SAFE: &str = "A held or moving arm goes SAFE: pumps off. Whether the chambers keep their air depends on the supply (`supply_off`).";
const DRIVES_ON: &str = "The arm drives on; the sensor is left out or counts less, and the band around the tip is wider.";

/// What an operator wants to know of this alarm.
pub fn explain_alarm(cause: &AlarmCause) -> AlarmHelp {
    let help = |id, when: String, follows: &str, check| AlarmHelp {
        id,
        when,
        follows: follows.to_owned(),
        check,
    };
    let ms = |s: f64| format!("{:.0} ms", s * 1e3);
    match cause {
        AlarmCause::NoDataYet => help(
            "no-data-yet",
            "From the connection on until the first complete frame.".to_owned(),
            "Nothing moves until frames come.",
            "Whether the boards are powered, which port was chosen, `springtwin doctor`.",
        ),
        AlarmCause::DataOld { .. } => help(
            "data-old",
            format!(
                "The newest frame is older than {}; critical from {} on.",
                ms(STALE_WARN_S),
                ms(STALE_SAFE_S)
            ),
            &format!("From {} on: {GO_SAFE} The boards do the same by themselves when they do not hear this program.", ms(STALE_SAFE_S)),
            "The USB cable, the boards' power; where the sentence names this computer, other programs on it.",
        ),
        AlarmCause::DataLate { .. } => help(
            "data-late",
            format!(
                "All frames of the last {LATE_OVER_S} s were older than {} on arrival.",
                ms(STALE_WARN_S)
            ),
            &format!("Above {}: {GO_SAFE}", ms(STALE_SAFE_S)),
            "The USB cable and hubs between, other programs on this computer.",
        ),
        AlarmCause::BoardOld { .. } => help(
            "board-old",
            format!(
                "The newest sample of one board is older than {}; critical from {} on.",
                ms(STALE_WARN_S),
                ms(STALE_SAFE_S)
            ),
            &format!("From {} on: {GO_SAFE}", ms(STALE_SAFE_S)),
            "The cable between the boards, that board's power.",
        ),
        AlarmCause::FramesLost { .. } => help(
            "frames-lost",
            format!(
                "More than {:.0} % of the last second's frames were lost.",
                LOSS_SAFE * 100.0
            ),
            GO_SAFE,
            "The USB cable and its shield, the rate of the port; where the sentence names this computer, other programs on it.",
        ),
        AlarmCause::Spring { evidence, .. } => {
            let (id, when) = match evidence.health {
                ChannelHealth::Missing => ("spring-missing", "The board delivers no reading of the spring."),
                ChannelHealth::Stuck => ("spring-stuck", "The reading stays while the other sensors show motion."),
                ChannelHealth::OutOfRange => ("spring-range", "The reading lies outside of what the spring's curve was measured for."),
                ChannelHealth::Suspect | ChannelHealth::Ok => ("spring-suspect", "The length disagrees with the other sensors more than their errors allow, or comes late."),
            };
            help(
                id,
                when.to_owned(),
                DRIVES_ON,
                "Hooks and plug of that spring, its board; after a repair, its calibration.",
            )
        }
        AlarmCause::Imu { evidence, .. } => {
            let (id, when) = match evidence.health {
                ChannelHealth::Missing => ("imu-missing", "The board delivers no sample of the IMU."),
                ChannelHealth::Stuck => ("imu-stuck", "The IMU repeats its reading while the arm moves."),
                ChannelHealth::OutOfRange => ("imu-range", "A reading is at the end of the IMU's range."),
                ChannelHealth::Suspect | ChannelHealth::Ok => ("imu-suspect", "Its pad's orientation disagrees with the other sensors, its heading is not known well, or it comes late."),
            };
            help(
                id,
                when.to_owned(),
                DRIVES_ON,
                "Its mounting and plug; where the sentence names the heading, tilt the arm to any side.",
            )
        }
        AlarmCause::SegmentSuspect { .. } => help(
            "segment-suspect",
            "Springs and IMUs of a segment contradict each other, and none of them is certainly the one.".to_owned(),
            "The arm drives on; the band around the tip is wider.",
            "Move the arm to all sides: motion shows which; then as for that sensor.",
        ),
        AlarmCause::PoseUnknown { .. } => help(
            "pose-unknown",
            "A pad's heading, inclination or position is known less well than motion needs, as after switching on.".to_owned(),
            "The tip's pose is shown with its band; motion to a target waits for it.",
            "What the sentence asks for: tilt the arm, keep it still, or repair the springs of that segment.",
        ),
        AlarmCause::TooFewSensors => help(
            "too-few-sensors",
            format!("More than {BLIND_FRAMES} frames in a row had too few sensors for the tip's pose."),
            GO_SAFE,
            "Springs and IMUs until each segment has five springs and its pads an IMU each, or six springs.",
        ),
        AlarmCause::OverPressure { .. } => help(
            "over-pressure",
            "A gauge shows more than `over_pressure_kpa` of the robot file, up or down; looked at in every frame.".to_owned(),
            &format!("{GO_SAFE} The boards have a limit of their own and latch."),
            "Let the air out, then the regulator of that chamber, its supply pressure, its gauge.",
        ),
        AlarmCause::ShortOfAir { .. } => help(
            "short-of-air",
            format!(
                "A chamber has not reached its set pressure for {WARN_S} s although its supply works in full."
            ),
            &format!(
                "The arm drives on for {SAFE_S} s, then it goes SAFE. A chamber that is off by {:.0} kPa and does not come nearer goes \
                 SAFE after {ADRIFT_S} s.",
                ADRIFT_PA * 1e-3
            ),
            "The chamber's hose and its connections, the supply, the bellows.",
        ),
        AlarmCause::PumpsRun { .. } => help(
            "pumps-run",
            format!("A board reports pumps on for {} although they should be off.", ms(DIFFER_S)),
            "SAFE, and the supply is cut by the second output; where none is wired, nothing else can be done from here.",
            "Cut the supply by hand; then the board's firmware and its wiring.",
        ),
        AlarmCause::StillFed { .. } => help(
            "still-fed",
            format!(
                "Pumps are off, and a chamber's pressure has moved away from 0 by {:.0} kPa.",
                STILL_FED_PA * 1e-3
            ),
            "SAFE, and the supply is cut by the second output; where none is wired, nothing else can be done from here.",
            "Cut the supply by hand; then the valve of that chamber.",
        ),
        AlarmCause::EmergencyStop => help(
            "emergency-stop",
            "The loop of the emergency stop is open.".to_owned(),
            "The boards switch their regulators off by themselves and latch; the supply is cut by the button's own contact, if it is wired as the guide has it. VENT is refused meanwhile: the air leaves through the dump valve only.",
            "Who pressed it and why; then release it and press Reset. Otherwise the plug of the loop.",
        ),
        AlarmCause::ContactIgnored => help(
            "contact-ignored",
            "The program was started with `--expect-pushes` on hardware.".to_owned(),
            "No contact is detected: the arm presses on what is in its way.",
            "That nobody is in the arm's reach; start again without the option after the experiment.",
        ),
        AlarmCause::Unsolved { .. } => help(
            "unsolved",
            format!("The controller found no admissible rates within the last {UNSOLVED_S} s."),
            "The pressures are held in such a tick; the arm drives on in the next one that has rates.",
            "Another target, further inside of the reachable space; which sensors or chambers are out of order.",
        ),
        AlarmCause::Safe { .. } => help(
            "safe",
            "The program or the boards went SAFE; the sentence has the reason.".to_owned(),
            "Pumps are off. Whether the arm keeps its shape or sags depends on the supply (`supply_off` of the robot file); VENT lets the air out. Nothing moves until Reset, and then not before the next Arm.",
            "The reason in the sentence, and the alarms beside this one.",
        ),
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    #[test]
    fn every_alarm_has_an_example_and_a_name_of_its_own() {
        let examples = example_alarms();
        let ids: BTreeSet<&str> = examples.iter().map(|a| explain_alarm(a).id).collect();
        assert_eq!(ids.len(), examples.len(), "{ids:?}");
        let kinds: BTreeSet<String> = examples
            .iter()
            .map(|a| format!("{a:?}"))
            .map(|text| text.split([' ', '{']).next().unwrap_or_default().to_owned())
            .collect();
        let source = include_str!("../../signal/alarm.rs");
        let of_enum = source
            .split("pub fn key")
            .nth(1)
            .and_then(|rest| rest.split("pub fn text").next())
            .expect("the list of identities");
        assert_eq!(kinds.len(), of_enum.matches("=> AlarmKey::").count());
    }

    #[test]
    fn hints_are_sentences() {
        for alarm in example_alarms() {
            let h = explain_alarm(&alarm);
            for text in [h.when.as_str(), &h.follows, h.check] {
                assert!(
                    text.ends_with('.') && !text.contains('\n'),
                    "{}: {text}",
                    h.id
                );
            }
        }
    }
}
