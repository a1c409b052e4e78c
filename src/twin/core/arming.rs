//! What arming and resuming depend on besides the link, and the check of gauges and chambers when hardware is armed.

use nalgebra::SVector;

use crate::sensing::Calibration;
use crate::signal::{CHAMBERS, SIGNALS, Stamp};

/// RESUME does nothing for so long after HOLD, s: a second press in a hurry restarts nothing.
pub const RESUME_OFF_S: f64 = 1.0;
/// Change of pressure by which a gauge is checked; the first time under a calibration, Pa.
pub(super) const GAUGE_STEP_PA: f64 = 1e3;
pub(super) const FIRST_STEP_PA: f64 = 2e3;
/// A gauge follows when it shows this share of the change, and no other may show more than this one.
pub(super) const FOLLOWS: f64 = 0.7;
pub(super) const OTHERS: f64 = 0.5;
/// The next chamber is checked when the one before shows no more than this share.
pub(super) const BACK: f64 = 0.2;
/// It gets so long for that, s.
pub(super) const FOLLOWS_S: f64 = 2.0;
/// The arm gets so long to come to rest before its shape is looked at, there and back, s.
pub(super) const SHAPE_S: f64 = 0.7;
/// Least cosine between the changes of the springs' lengths and those that the plant map expects.
pub(super) const ALIKE: f64 = 0.5;

/// What arming and resuming depend on besides the link.
pub(super) struct Arming {
    /// When the operator last pressed HOLD.
    pub(super) held_at: Option<Stamp>,
    /// Whether the sensors are read by the virtual rig's calibration.
    pub(super) calibration_is_virtual: bool,
    /// Whether hardware may move on it nevertheless.
    pub(super) is_accepted: bool,
    /// Whether simulated boards at a serial port may be armed.
    pub(super) accepts_simulated: bool,
    /// Why no calibration of the robot could be used, if that is known.
    pub(super) trouble: Option<String>,
    /// The same for the operator, until it is reported.
    pub(super) to_report: Option<String>,
    /// Number of the arm that the calibration belongs to, if it is known.
    pub(super) rig: Option<u32>,
    /// Whether every chamber has moved the arm as this calibration states.
    pub(super) is_proved: bool,
    /// Whether the gauges have been checked since the arm was armed, by this calibration.
    pub(super) is_checked: bool,
    /// The check under way.
    pub(super) check: Option<GaugeCheck>,
}

/// One chamber after another gets a little pressure and loses it again.
pub(super) struct GaugeCheck {
    pub(super) from_pa: [f64; CHAMBERS],
    pub(super) step_pa: f64,
    pub(super) chamber: usize,
    pub(super) since: Stamp,
    pub(super) from_signals: SVector<f64, SIGNALS>,
    /// When the gauge has followed.
    pub(super) followed: Option<Stamp>,
    /// The chamber goes back, from these signals.
    pub(super) returns_from: Option<SVector<f64, SIGNALS>>,
    /// When it had come back.
    pub(super) returned: Option<Stamp>,
}

impl Arming {
    pub(super) fn new(calibration: &Calibration) -> Self {
        Self {
            held_at: None,
            calibration_is_virtual: calibration.is_of_virtual_rig(),
            is_accepted: false,
            accepts_simulated: false,
            trouble: None,
            to_report: None,
            rig: calibration.rig,
            is_proved: false,
            is_checked: false,
            check: None,
        }
    }

    /// Takes note of whose calibration the sensors are read by.
    pub(super) fn note(&mut self, calibration: &Calibration) {
        self.calibration_is_virtual = calibration.is_of_virtual_rig();
        self.rig = calibration.rig;
        self.is_proved = false;
        self.is_checked = false;
        self.check = None;
    }

    /// Whether gauges and chambers are being checked.
    pub(super) fn is_checking(&self) -> bool {
        self.check.is_some()
    }

    /// Gives the check up.
    pub(super) fn give_up(&mut self) -> bool {
        self.check.take().is_some()
    }

    /// The check has come to its end, and nothing was found.
    pub(super) fn pass(&mut self) {
        self.check = None;
        self.is_checked = true;
        self.is_proved = true;
    }

    /// By how much each chamber is driven beyond the held pressures now, Pa.
    pub(super) fn offset_pa(&self) -> [f64; CHAMBERS] {
        let mut offset_pa = [0.0; CHAMBERS];
        if let Some(check) = self.check.as_ref().filter(|c| c.returns_from.is_none()) {
            offset_pa[check.chamber] = check.signed_pa();
        }
        offset_pa
    }
}

impl GaugeCheck {
    /// Towards 0 Pa where the chamber has pressure.
    pub(super) fn signed_pa(&self) -> f64 {
        match self.from_pa[self.chamber] > self.step_pa {
            true => -self.step_pa,
            false => self.step_pa,
        }
    }
}
