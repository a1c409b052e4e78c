//! IMUs: their zeros at rest, then their errors and the base's tilt while the arm moves slowly.

use std::sync::Arc;
use std::sync::mpsc::{Receiver, TryRecvError};

use nalgebra::UnitQuaternion;

use super::beside::beside;
use crate::robot::RobotSpec;
use crate::sensing::Calibration;
use crate::sensing::calibration::SpringCalibration;
use crate::sensing::imu_fit::{
    self, Capture, Fit, ImuFit, RestError, RestZero, Start, WINDOW_S, Window, Windows,
};
pub use crate::sensing::imu_fit::{
    RESIDUAL_MAX_RAD, REST_S, SAMPLES_NEEDED, SECTORS, SECTORS_NEEDED, TILT_RAD, tilt,
};
use crate::signal::{IMUS, RawFrame};
use crate::twin::Patched;

/// Verdict on an IMU.
#[derive(Clone, Debug, PartialEq)]
pub enum Verdict {
    /// Not captured: its calibration in use is kept.
    Kept,
    /// Being captured.
    Open,
    /// Accepted.
    Pass(Box<ImuFit>),
    /// Refused: why, one sentence.
    Redo(String),
}

/// Samples of one IMU.
#[derive(Clone, Debug, Default)]
pub struct ImuTake {
    /// What was captured.
    pub capture: Capture,
    /// The springs' curves that the pads were read by.
    springs: Option<Arc<Vec<SpringCalibration>>>,
    open: bool,
    verdict: Option<Result<ImuFit, String>>,
    /// How often it was captured again.
    pub redone: u32,
}

impl ImuTake {
    /// The verdict.
    pub fn verdict(&self) -> Verdict {
        match &self.verdict {
            _ if self.open => Verdict::Open,
            None => Verdict::Kept,
            Some(Ok(fit)) => Verdict::Pass(Box::new(fit.clone())),
            Some(Err(why)) => Verdict::Redo(why.clone()),
        }
    }

    /// Whether it was captured against other curves of the springs than `springs`.
    pub fn outdated(&self, springs: &[SpringCalibration]) -> bool {
        self.springs.as_ref().is_some_and(|s| s[..] != *springs)
    }

    /// Samples captured.
    pub fn samples(&self) -> usize {
        self.capture.samples()
    }

    /// Directions that the pad was tilted to, by index.
    pub fn sectors(&self) -> [bool; SECTORS] {
        self.capture.sectors()
    }
}

/// Where a capture stands.
#[derive(Clone, Debug, PartialEq)]
pub enum Phase {
    /// There is none.
    Idle,
    /// The arm has to rest so much longer, s; what moved, one sentence.
    Rest(f64, Option<String>),
    /// The arm has to move slowly to all sides.
    Motion,
    /// What was captured is being judged.
    Fit,
}

/// A capture in progress.
#[derive(Clone, Debug)]
struct Running {
    robot: RobotSpec,
    windows: Windows,
    /// Turn of each IMU by the robot's patches.
    turned: [UnitQuaternion<f64>; IMUS],
    base_tilt_rad: [f64; 2],
    ends_sigma_m: f64,
    springs: Arc<Vec<SpringCalibration>>,
    /// The last [`REST_S`] until the arm has rested.
    recent: Vec<Window>,
    rest: Result<RestZero, RestError>,
}

/// All IMUs.
#[derive(Default)]
pub struct ImusTake {
    /// Per IMU, 1 to 4.
    pub imus: [ImuTake; IMUS],
    running: Option<Box<Running>>,
    /// Where the fit of an ended capture arrives: it takes longer than a tick.
    fitting: Option<Receiver<Fit>>,
    base_tilt_rad: [f64; 2],
    open: Vec<String>,
}

impl ImusTake {
    /// Whether a capture is in progress, or what it captured is being judged.
    pub fn running(&self) -> bool {
        self.running.is_some() || self.fitting.is_some()
    }

    /// Takes the verdicts if they are there.
    pub fn poll(&mut self) {
        match self.fitting.as_ref().map(Receiver::try_recv) {
            None | Some(Err(TryRecvError::Empty)) => {}
            Some(Ok(fit)) => self.take_fit(fit),
            Some(Err(TryRecvError::Disconnected)) => self.give_up("the fit ended without a result"),
        }
    }

    /// Waits for the verdicts, if there will be any.
    pub fn wait(&mut self) {
        match self.fitting.as_ref().map(Receiver::recv) {
            None => {}
            Some(Ok(fit)) => self.take_fit(fit),
            Some(Err(_)) => self.give_up("the fit ended without a result"),
        }
    }

    /// No verdict on what was captured: `why`.
    fn give_up(&mut self, why: &str) {
        self.fitting = None;
        for take in self.imus.iter_mut().filter(|t| t.open) {
            take.open = false;
            take.verdict = Some(Err(why.to_owned()));
        }
    }

    /// Tilt of the base that belongs to the IMUs that passed: level from base = exp((x, y, 0)), a rotation vector in rad.
    pub fn base_tilt_rad(&self) -> [f64; 2] {
        self.base_tilt_rad
    }

    /// What the motion did not determine, one sentence each.
    pub fn not_determined(&self) -> &[String] {
        &self.open
    }

    /// Begins to capture the IMUs marked in `which` with the springs of `base`; their former samples are discarded.
    pub fn begin(&mut self, which: [bool; IMUS], robot: &RobotSpec, base: &Calibration) {
        let springs = Arc::new(base.springs.clone());
        for (take, _) in self.imus.iter_mut().zip(which).filter(|(_, w)| *w) {
            let again = u32::from(take.verdict.is_some());
            *take = ImuTake {
                open: true,
                springs: Some(Arc::clone(&springs)),
                redone: take.redone + again,
                ..ImuTake::default()
            };
        }
        let patched = Patched::new(robot, base);
        // A fit that is still under way belongs to the capture before.
        self.fitting = None;
        self.running = Some(Box::new(Running {
            windows: Windows::new(&patched.geometry, &patched.calibration),
            robot: robot.clone(),
            turned: patched.imu,
            base_tilt_rad: base.base_tilt_rad,
            ends_sigma_m: imu_fit::ends_sigma_m(base),
            springs,
            recent: Vec::new(),
            rest: Err(RestError::TooShort { span_s: 0.0 }),
        }));
    }

    /// Where the capture stands.
    pub fn phase(&self) -> Phase {
        match self.running.as_ref().map(|r| (&r.rest, r.recent.len())) {
            None if self.fitting.is_some() => Phase::Fit,
            None => Phase::Idle,
            Some((Ok(_), _)) => Phase::Motion,
            Some((Err(RestError::TooShort { .. }), windows)) => {
                Phase::Rest(REST_S - windows as f64 * WINDOW_S, None)
            }
            Some((Err(why), _)) => Phase::Rest(REST_S, Some(why.to_string())),
        }
    }

    /// Ends the capture and has the samples judged: see [`Self::poll`].
    pub fn finish(&mut self) {
        let Some(running) = self.running.take() else {
            return;
        };
        let running = *running;
        let rest = match running.rest {
            Ok(rest) => rest,
            Err(why) => return self.give_up(&format!("no rest: {why}")),
        };
        // Those that passed before take part again: they share the base's tilt.
        let takes_part = |t: &ImuTake| {
            let passed = matches!(t.verdict, Some(Ok(_)));
            (t.open || passed) && !t.outdated(&running.springs)
        };
        let captures = self
            .imus
            .each_ref()
            .map(|t| takes_part(t).then(|| t.capture.clone()));
        let start = Start {
            gyro_bias_rad_s: rest.gyro_bias_rad_s,
            base_tilt_rad: running.base_tilt_rad,
            springs_out: running.windows.springs_out(),
            ends_sigma_m: running.ends_sigma_m,
        };
        let robot = running.robot;
        let fit = move || {
            let captures = captures.each_ref().map(Option::as_ref);
            imu_fit::fit(&robot, &captures, &start)
        };
        match beside(fit) {
            Ok(fit) => self.fitting = Some(fit),
            Err(e) => self.give_up(&format!("cannot start a thread: {e}")),
        }
    }

    fn take_fit(&mut self, fit: Fit) {
        self.fitting = None;
        self.base_tilt_rad = fit.base_tilt_rad;
        self.open = fit.open();
        for (take, found) in self.imus.iter_mut().zip(fit.imus) {
            take.open = false;
            if let Some(found) = found {
                take.verdict = Some(found.map_err(|e| e.to_string()));
            }
        }
    }

    /// Processes a live frame; ends by itself when every IMU has enough samples.
    pub fn observe(&mut self, raw: &RawFrame) {
        let window = self.running.as_mut().and_then(|r| r.windows.push(raw));
        if let Some(window) = window {
            self.take_window(window);
        }
    }

    /// Processes a window: first it has to be a rest, then motion.
    pub(super) fn take_window(&mut self, window: Window) {
        let Some(running) = &mut self.running else {
            return;
        };
        if running.rest.is_err() {
            running.recent.push(window);
            running.rest = imu_fit::rest(&running.recent, &running.robot);
            let most = (REST_S / WINDOW_S) as usize;
            if running.recent.len() >= most {
                running.recent.remove(0);
            }
            return;
        }
        for (i, take) in self.imus.iter_mut().enumerate().filter(|(_, t)| t.open) {
            let by_springs = &window.base_from_pad[running.robot.imus[i].pad.index()];
            if let (Some(by_springs), Some(raw)) = (by_springs, &window.imu[i])
                && !take.capture.is_complete()
            {
                let seat = by_springs.turned(&running.turned[i]);
                take.capture.add(window.t_s, &seat, raw);
            }
        }
        let done = |t: &ImuTake| !t.open || t.capture.is_complete();
        if self.imus.iter().all(done) {
            self.finish();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibrate::fixture::{in_use, rest_and_motion};
    use std::f64::consts::TAU;

    fn begun() -> ImusTake {
        let mut take = ImusTake::default();
        take.begin([true; IMUS], &RobotSpec::reference(), &in_use());
        assert_eq!(take.phase(), Phase::Rest(REST_S, None));
        take
    }

    #[test]
    fn a_rest_and_motion_to_all_sides_pass_and_one_side_is_to_be_redone() {
        let mut take = begun();
        rest_and_motion(&mut take, TAU);
        assert_eq!(take.phase(), Phase::Idle);
        for t in &take.imus {
            let Verdict::Pass(fit) = t.verdict() else {
                panic!("{:?}", t.verdict());
            };
            assert!(fit.entry.fit.correction_rad.norm() < 1e-3, "{fit:?}");
        }
        // One of them again, to one side: the others keep their verdicts.
        take.begin(
            [false, true, false, false],
            &RobotSpec::reference(),
            &in_use(),
        );
        rest_and_motion(&mut take, 0.5);
        assert_eq!(take.phase(), Phase::Motion);
        take.finish();
        assert_eq!(take.phase(), Phase::Fit);
        take.wait();
        let Verdict::Redo(why) = take.imus[1].verdict() else {
            panic!("{:?}", take.imus[1].verdict());
        };
        assert!(why.contains("of 8 sides"), "{why}");
        assert!(matches!(take.imus[0].verdict(), Verdict::Pass(_)));
        assert_eq!(take.imus[1].redone, 1);
    }

    #[test]
    fn nothing_is_captured_before_the_arm_has_rested() {
        let mut take = begun();
        take.finish();
        let Verdict::Redo(why) = take.imus[0].verdict() else {
            panic!("{:?}", take.imus[0].verdict());
        };
        assert!(why.starts_with("no rest"), "{why}");
        assert_eq!(take.imus[0].samples(), 0);
    }
}
