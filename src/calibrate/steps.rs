//! The steps of the wizard and their state.

/// A step of the wizard; the order of the variants is the order of the steps.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Step {
    /// Check link, sensors, motion capture and mode.
    #[default]
    Preflight,
    /// One curve per spring, from reading to length.
    Springs,
    /// Mounting of each IMU on its pad.
    Imus,
    /// Registration of motion capture.
    Mocap,
    /// Comparison of the former and the new calibration on motion that no other step used.
    Validate,
    /// Save the calibration as a version.
    Save,
    /// Networks and calibration learn the arm from motion under motion capture.
    Learn,
}

impl Step {
    /// All steps, in order.
    pub const ALL: [Self; 7] = [
        Self::Preflight,
        Self::Springs,
        Self::Imus,
        Self::Mocap,
        Self::Validate,
        Self::Save,
        Self::Learn,
    ];

    /// Name on screen.
    pub fn name(self) -> &'static str {
        match self {
            Self::Preflight => "Preflight",
            Self::Springs => "Springs",
            Self::Imus => "IMUs",
            Self::Mocap => "Vicon",
            Self::Validate => "Validate",
            Self::Save => "Save",
            Self::Learn => "Learn",
        }
    }

    /// Index of the step, from 0.
    pub fn index(self) -> usize {
        self as usize
    }

    /// The previous step; `None` before the first.
    pub fn back(self) -> Option<Self> {
        Self::ALL.get(self.index().checked_sub(1)?).copied()
    }

    /// The next step; `None` after the last.
    pub fn next(self) -> Option<Self> {
        Self::ALL.get(self.index() + 1).copied()
    }
}

/// State of a step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mark {
    /// Nothing was captured: what is in use is kept.
    Kept,
    /// In progress.
    Open,
    /// Captured and accepted.
    Pass,
    /// Something was refused and has to be captured again.
    Redo,
    /// Number of checks that did not pass.
    NotPassed(usize),
}

impl Mark {
    /// Word for screen readers and tooltips.
    pub fn word(self) -> String {
        match self {
            Self::Kept => "unchanged".into(),
            Self::Open => "under way".into(),
            Self::Pass => "PASS".into(),
            Self::Redo => "REDO".into(),
            Self::NotPassed(n) => format!("{n} not passed"),
        }
    }
}
