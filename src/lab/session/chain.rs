//! One specimen of the virtual rig behind the link: from set pressures to calibrated frames and captured poses.

use nalgebra::UnitQuaternion;

use super::calibration::springs_for;
use super::capture::Captured;
use super::excitation::Drive;
use super::plan::{Session, SessionError, SessionPlan};
use crate::drive::board_config;
use crate::link::wire::fault;
use crate::link::{HostSession, Origin};
use crate::rig::hidden::Hidden;
use crate::rig::{RigOptions, Surroundings, Unit, VirtualRig};
use crate::robot::RobotSpec;
use crate::sensing::Calibration;
use crate::sensing::imu::{ImuTrack, Sample, credible};
use crate::sensing::platform::Geometry;
use crate::signal::{
    CHAMBERS, Gripper, IMUS, PressureCommand, RawFrame, SensorVec, Stamp, ypr_from_rotation,
};

/// Rest before the log begins, s: the link comes up, and the orientation filters learn the gyros' biases.
pub const REST_S: f64 = 12.0;
/// The part of it, at its end, over which headings are set, s: the arm hangs straight.
const HEADING_S: f64 = 1.0;
/// Interval at which bytes are exchanged, ms, and at which commands are sent.
const LINE_MS: u64 = 1;
const COMMAND_MS: u64 = 10;
/// Effects that count time or change with it from their onset on. One of them that is there from the start begins with the
/// log. Every other effect that is there from the start is there during the rest, too, so that arm and filters have
/// settled with it.
const CHANGE_WITH_TIME: [&str; 5] = [
    "spring-drift",
    "spring-stuck",
    "imu-drift",
    "clock-skew",
    "temperature-stiffness",
];

/// Whether an effect changes in the course of a session, given constant pressures.
pub fn changes_with_time(id: &str) -> bool {
    CHANGE_WITH_TIME.contains(&id)
}

/// One manufactured rig with the calibration of its springs: makes any number of sessions.
#[derive(Clone, Debug)]
pub struct Specimen<'a> {
    robot: &'a RobotSpec,
    unit: Unit,
    calibration: Calibration,
}

impl<'a> Specimen<'a> {
    /// Specimen `number` of `robot`'s rig, its springs calibrated.
    ///
    /// # Errors
    /// [`SessionError`] when its springs cannot be calibrated.
    pub fn new(robot: &'a RobotSpec, number: u64) -> Result<Self, SessionError> {
        let unit = Unit(number);
        Ok(Self {
            robot,
            unit,
            calibration: springs_for(robot, unit)?,
        })
    }

    /// The robot.
    pub fn robot(&self) -> &'a RobotSpec {
        self.robot
    }

    /// The log of a session of this specimen, whatever specimen the plan names.
    ///
    /// # Errors
    /// [`SessionError`] when the plan makes no sense or the rig cannot carry it out.
    pub fn session(&self, plan: &SessionPlan) -> Result<Session, SessionError> {
        self.part(plan, plan.seconds)
    }

    /// The first `until_s` of a session's log: the same motion and the same noise.
    ///
    /// # Errors
    /// As [`Self::session`].
    pub fn part(&self, plan: &SessionPlan, until_s: f64) -> Result<Session, SessionError> {
        let drive = Drive::new(plan.excitation, self.robot, plan.seed, plan.seconds);
        self.moved(plan, &drive, until_s)
    }

    /// A session by the plan, but driven by these commands.
    ///
    /// # Errors
    /// As [`Self::session`].
    pub fn driven(&self, plan: &SessionPlan, drive: &Drive) -> Result<Session, SessionError> {
        self.moved(plan, drive, plan.seconds)
    }

    fn moved(
        &self,
        plan: &SessionPlan,
        drive: &Drive,
        until_s: f64,
    ) -> Result<Session, SessionError> {
        plan.check()?;
        let until_s = until_s.min(plan.seconds);
        let mut chain = Chain::new(self, plan, drive.clone())?;
        // Stamps of motion capture may be early by the largest offset and skew that can be hidden.
        let longest_s = REST_S + until_s + 2.5 + 0.05 * until_s;
        let mut ms = 0;
        while !chain.has_all(until_s) && (ms as f64) < longest_s * 1e3 {
            ms += LINE_MS;
            chain.step(ms)?;
        }
        chain.log(plan, until_s)
    }
}

/// Mean of an angle.
#[derive(Clone, Copy, Debug, Default)]
struct Angle {
    sin: f64,
    cos: f64,
}

impl Angle {
    fn add(&mut self, angle_rad: f64) {
        self.sin += angle_rad.sin();
        self.cos += angle_rad.cos();
    }

    /// The mean, rad; 0 before the first.
    fn mean(&self) -> f64 {
        self.sin.atan2(self.cos)
    }
}

/// One frame as it goes into a log.
struct Row {
    t_s: f64,
    chamber_pa: [f64; CHAMBERS],
    sensors: SensorVec,
}

/// A rig and the host's end of its link on simulated time, which begins [`REST_S`] before the log.
struct Chain<'a> {
    robot: &'a RobotSpec,
    calibration: &'a Calibration,
    geometry: Geometry,
    drive: Drive,
    rig: VirtualRig,
    host: HostSession,
    /// One filter per IMU; no spring has a say in it.
    tracks: [ImuTrack; IMUS],
    headings: [Angle; IMUS],
    last_frame_s: f64,
    /// Whether the boards, latched since they started, were let go.
    is_reset: bool,
    command: Option<PressureCommand>,
    /// Commands by the log's time.
    sent: Vec<(f64, [f64; CHAMBERS])>,
    gauge_pa: [f64; CHAMBERS],
    rows: Vec<Row>,
    captured: Captured,
}

impl<'a> Chain<'a> {
    fn new(specimen: &'a Specimen, plan: &SessionPlan, drive: Drive) -> Result<Self, SessionError> {
        let robot = specimen.robot;
        let options = RigOptions {
            unit: specimen.unit,
            seed: plan.seed,
            surroundings: Surroundings {
                payload_kg: plan.payload_kg,
                ..Surroundings::default()
            },
            hidden: plan.hidden.iter().map(in_rig_time).collect(),
            ..RigOptions::default()
        };
        let rig = VirtualRig::new(robot, &options).map_err(|e| SessionError::Rig(e.to_string()))?;
        Ok(Self {
            robot,
            calibration: &specimen.calibration,
            geometry: Geometry::calibrated(robot, &specimen.calibration),
            drive,
            rig,
            host: HostSession::new("virtual rig", Origin::Simulated, board_config(robot)),
            tracks: std::array::from_fn(|i| {
                let drawn = UnitQuaternion::from_rotation_matrix(&robot.imus[i].pad_from_imu);
                ImuTrack::new(specimen.calibration.mounting(i) * drawn)
            }),
            headings: Default::default(),
            last_frame_s: -REST_S,
            is_reset: false,
            command: None,
            sent: Vec::new(),
            gauge_pa: [0.0; CHAMBERS],
            rows: Vec::new(),
            captured: Captured::default(),
        })
    }

    /// Whether frames and captured poses reach up to `until_s`.
    fn has_all(&self, until_s: f64) -> bool {
        let frames = self.rows.last().is_some_and(|r| r.t_s >= until_s);
        frames && self.captured.newest_s().is_some_and(|t_s| t_s >= until_s)
    }

    /// One exchange of bytes at `ms` of the rig's time.
    fn step(&mut self, ms: u64) -> Result<(), SessionError> {
        let rig_s = ms as f64 * 1e-3;
        let (t_s, now) = (rig_s - REST_S, Stamp::from_seconds(rig_s));
        let to_rig = self.host.poll(now);
        let from_rig = self.rig.advance(rig_s, &to_rig);
        self.host.on_bytes(now, &from_rig);
        if let Some(seen) = self.rig.mocap_sample(rig_s) {
            let stamp_s = seen.stamp.seconds() - REST_S;
            self.captured.push(stamp_s, seen.base_from_tip);
        }
        while let Some(raw) = self.host.next_frame() {
            self.take(&raw, t_s)?;
        }
        // Nobody reads the link's notices; they must not pile up.
        while self.host.next_event().is_some() {}
        if ms.is_multiple_of(COMMAND_MS) {
            self.send(t_s, now)?;
        }
        Ok(())
    }

    fn take(&mut self, raw: &RawFrame, t_s: f64) -> Result<(), SessionError> {
        if t_s >= 0.0 && raw.faults & fault::SAFE != 0 {
            return Err(SessionError::Safe { t_s });
        }
        let frame_s = raw.stamp.seconds() - REST_S;
        let dt_s = frame_s - self.last_frame_s;
        if dt_s <= 0.0 {
            return Ok(());
        }
        self.last_frame_s = frame_s;
        self.gauge_pa = raw.chamber_pa;
        let imu_ypr_rad = std::array::from_fn(|i| {
            let track = &mut self.tracks[i];
            let sample = track.sample(raw.has_imu(i), credible(&raw.imu[i]));
            let good = Some(&raw.imu[i]).filter(|_| sample == Sample::Good);
            let zero = self.calibration.imu_zero(i);
            track.update(dt_s, good.map(|raw| zero.remove(raw)).as_ref());
            let level = self.calibration.level_from_base().inverse();
            if (-HEADING_S..0.0).contains(&frame_s) {
                let heading_rad = track.heading_to(&level, &UnitQuaternion::identity());
                self.headings[i].add(heading_rad);
            }
            track.set_heading(&level, self.headings[i].mean());
            match sample {
                Sample::Lost => [f64::NAN; 3],
                Sample::Good | Sample::Held => ypr_from_rotation(&track.base_from_pad()),
            }
        });
        let length_m =
            std::array::from_fn(|i| self.calibration.length_m(raw, i).unwrap_or(f64::NAN));
        let turns = [0, 1].map(|pad| {
            let own = (0..IMUS).find(|i| self.geometry.pad_of_imu[*i] == pad);
            own.map_or_else(UnitQuaternion::identity, |i| self.tracks[i].base_from_pad())
        });
        self.rows.push(Row {
            t_s: frame_s,
            chamber_pa: std::array::from_fn(|i| match raw.has_chamber(i) {
                true => raw.chamber_pa[i],
                false => f64::NAN,
            }),
            sensors: SensorVec {
                spring_m: self
                    .geometry
                    .lengths_of_drawing(self.robot, &length_m, &turns),
                imu_ypr_rad,
            },
        });
        Ok(())
    }

    /// Sends the set pressures of `t_s`, through the robot's limits as the program does.
    fn send(&mut self, t_s: f64, now: Stamp) -> Result<(), SessionError> {
        if !self.host.connected() {
            return match t_s < 0.0 {
                true => Ok(()),
                false => Err(SessionError::NoLink { seconds: REST_S }),
            };
        }
        if !std::mem::replace(&mut self.is_reset, true) {
            self.host.reset();
            return Ok(());
        }
        let command = PressureCommand::limited(
            now,
            self.drive.at(t_s.max(0.0)),
            Gripper::Open,
            self.command.as_ref(),
            &self.gauge_pa,
            &self.robot.pressure,
        );
        self.host.set_command(&command);
        self.sent.push((t_s, *command.chamber_pa()));
        self.command = Some(command);
        Ok(())
    }

    /// The log: of every nominal sample the nearest frame, with its own stamp.
    fn log(self, plan: &SessionPlan, until_s: f64) -> Result<Session, SessionError> {
        if self.rig.refused_steps > 0 {
            return Err(SessionError::Arm {
                steps: self.rig.refused_steps,
            });
        }
        let samples = (until_s * plan.rate_hz).round() as usize;
        let rows = nearest(&self.rows, samples, plan.rate_hz);
        if rows.is_empty() {
            return Err(SessionError::NoLink { seconds: REST_S });
        }
        let t_s: Vec<f64> = rows.iter().map(|r| r.t_s).collect();
        let commanded = |t_s: &f64| {
            let k = self.sent.partition_point(|(sent_s, _)| sent_s <= t_s);
            k.checked_sub(1).map_or([0.0; CHAMBERS], |k| self.sent[k].1)
        };
        Ok(Session {
            name: plan.name.clone(),
            rate_hz: plan.rate_hz,
            payload_kg: plan.payload_kg,
            commanded_pa: t_s.iter().map(commanded).collect(),
            chamber_pa: rows.iter().map(|r| r.chamber_pa).collect(),
            sensors: rows.iter().map(|r| r.sensors.clone()).collect(),
            captured: self.captured.at(&t_s),
            t_s,
        })
    }
}

/// The rows nearest to `samples` times at `rate_hz` from 0 on, each once and not before 0.
fn nearest(rows: &[Row], samples: usize, rate_hz: f64) -> Vec<&Row> {
    let start = rows.partition_point(|r| r.t_s < 0.0);
    let rows = &rows[start..];
    let mut out = Vec::with_capacity(samples);
    let mut free = 0;
    for k in 0..samples {
        let wanted_s = k as f64 / rate_hz;
        let after = rows.partition_point(|r| r.t_s < wanted_s);
        let before = after.saturating_sub(1);
        let off_s = |k: usize| rows.get(k).map_or(f64::MAX, |r| (r.t_s - wanted_s).abs());
        let best = if off_s(before) <= off_s(after) {
            before
        } else {
            after
        };
        // A frame is used once; one that is half a period off belongs to a neighbour.
        let best = best.max(free);
        if off_s(best) <= 0.5 / rate_hz + 1e-3 {
            out.extend(rows.get(best));
            free = best + 1;
        }
    }
    out
}

/// The effect with its onset on the rig's clock.
fn in_rig_time(hidden: &Hidden) -> Hidden {
    let from_start = hidden.from_s == 0.0 && !changes_with_time(hidden.id);
    let from_s = if from_start {
        0.0
    } else {
        hidden.from_s + REST_S
    };
    hidden.clone().from(from_s)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::signal::IMUS;

    fn rows(t_s: impl Iterator<Item = f64>) -> Vec<Row> {
        let row = |t_s| Row {
            t_s,
            chamber_pa: [0.0; CHAMBERS],
            sensors: SensorVec {
                spring_m: [0.1; 12],
                imu_ypr_rad: [[0.0; 3]; IMUS],
            },
        };
        t_s.map(row).collect()
    }

    #[test]
    fn rows_are_the_frames_nearest_to_the_samples_each_once() {
        // 100 frames per second from before the log, out of phase; one lost.
        let all = rows(
            (0..200)
                .filter(|k| *k != 50)
                .map(|k| f64::from(k) * 0.01 - 0.2967),
        );
        for (rate_hz, samples, wanted) in [(50.0, 60, 60), (40.0, 48, 48), (100.0, 120, 119)] {
            let found = nearest(&all, samples, rate_hz);
            assert_eq!(found.len(), wanted, "{rate_hz} Hz");
            assert!(found[0].t_s >= 0.0);
            for pair in found.windows(2) {
                assert!(pair[1].t_s > pair[0].t_s);
            }
        }
    }

    #[test]
    fn an_onset_counts_from_the_log_and_what_is_settled_was_there_before() {
        let of = |text: &str| in_rig_time(&text.parse::<Hidden>().expect("an effect")).from_s;
        assert_eq!(of("payload=0.2"), 0.0);
        assert_eq!(of("payload=0.2@20"), 20.0 + REST_S);
        assert_eq!(of("clock-skew=0.01"), REST_S);
        for id in CHANGE_WITH_TIME {
            assert!(crate::rig::hidden::kind(id).is_some(), "{id}");
        }
    }
}
