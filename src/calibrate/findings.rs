//! Findings of a step: what was measured, the limit, and what to do.

use super::preflight;
use super::steps::{Mark, Step};
use super::wizard::Wizard;
use super::{imus, springs};
use crate::sensing::bench::HELD_OUT_LIMIT_M;
use crate::sensing::registration::{POSES_MIN, WEAKEST_M, WEAKEST_RAD};
use crate::signal::{IMUS, SPRINGS, Snapshot, capitalised};

/// Verdict on a step or on one thing that it captured.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// Captured and accepted.
    Pass,
    /// Refused: it has to be captured again.
    Redo,
    /// Not captured: what is in use is kept.
    Kept,
}

impl Verdict {
    /// The word for reports.
    pub fn word(self) -> &'static str {
        match self {
            Self::Pass => "PASS",
            Self::Redo => "REDO",
            Self::Kept => "KEPT",
        }
    }
}

impl From<Mark> for Verdict {
    fn from(mark: Mark) -> Self {
        match mark {
            Mark::Pass => Self::Pass,
            Mark::Kept => Self::Kept,
            Mark::Open | Mark::Redo | Mark::NotPassed(_) => Self::Redo,
        }
    }
}

/// One thing that a step captured, with its verdict.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Finding {
    /// What was captured, such as `Spring 7`.
    pub subject: String,
    /// The verdict.
    pub verdict: Verdict,
    /// The measured figure.
    pub measured: String,
    /// Its limit.
    pub limit: String,
    /// What to do where it was refused, one sentence; else `None`.
    pub todo: Option<String>,
}

impl Finding {
    /// Something that kept a step from being carried out.
    pub fn obstacle(subject: &str, why: &str) -> Self {
        Self {
            subject: subject.to_owned(),
            verdict: Verdict::Redo,
            measured: String::new(),
            limit: String::new(),
            todo: Some(why.to_owned()),
        }
    }
}

impl std::fmt::Display for Finding {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}  {}", self.verdict.word(), self.subject)?;
        if !self.measured.is_empty() {
            write!(f, ": {}", self.measured)?;
        }
        if !self.limit.is_empty() {
            write!(f, " ({})", self.limit)?;
        }
        match &self.todo {
            Some(todo) => write!(f, ". {todo}"),
            None => Ok(()),
        }
    }
}

/// A reason as a sentence: a capital at the beginning and a full stop.
fn sentence(why: &str) -> String {
    capitalised(why.trim_end_matches('.')) + "."
}

/// Findings of a step as it stands.
pub fn findings(wizard: &Wizard, step: Step, snapshot: &Snapshot) -> Vec<Finding> {
    match step {
        Step::Preflight => preflight::checks(snapshot)
            .into_iter()
            .map(of_check)
            .collect(),
        Step::Springs => (0..SPRINGS).map(|i| of_spring(wizard, i)).collect(),
        Step::Imus => (0..IMUS).map(|i| of_imu(wizard, i)).collect(),
        Step::Mocap => vec![of_mocap(wizard)],
        Step::Validate => vec![of_validation(wizard)],
        Step::Save | Step::Learn => Vec::new(),
    }
}

fn of_check(check: preflight::Check) -> Finding {
    Finding {
        subject: check.name.to_owned(),
        verdict: match check.verdict {
            Ok(()) => Verdict::Pass,
            Err(_) => Verdict::Redo,
        },
        measured: check.found,
        limit: check.limit,
        todo: check.verdict.err(),
    }
}

fn of_spring(wizard: &Wizard, i: usize) -> Finding {
    use springs::Verdict as Spring;
    let quality = |q: &crate::sensing::calibration::FitQuality| {
        format!("{:.2} mm held-out RMSE", q.held_out_rmse_m * 1e3)
    };
    let points = || format!("{} points", wizard.springs.springs[i].points().len());
    let (verdict, measured, todo) = match wizard.spring(i) {
        Spring::Kept => (Verdict::Kept, "the curve in use is kept".to_owned(), None),
        Spring::Uncovered => {
            let todo = "Capture it: there is no curve in use.".to_owned();
            (Verdict::Redo, points(), Some(todo))
        }
        Spring::Open(missing) => (Verdict::Redo, points(), Some(sentence(&missing))),
        Spring::Pass(q) => (Verdict::Pass, quality(&q), None),
        Spring::Redo { why, quality: q } => {
            let measured = q.as_ref().map_or_else(points, quality);
            (Verdict::Redo, measured, Some(sentence(&why)))
        }
    };
    Finding {
        subject: format!("Spring {}", i + 1),
        verdict,
        measured,
        limit: match verdict {
            Verdict::Kept => String::new(),
            _ => format!("at most {:.2} mm", HELD_OUT_LIMIT_M * 1e3),
        },
        todo,
    }
}

fn of_imu(wizard: &Wizard, i: usize) -> Finding {
    use imus::{RESIDUAL_MAX_RAD, SECTORS, SECTORS_NEEDED, Verdict as Imu};
    let take = &wizard.imus.imus[i];
    let sides = take.capture.sides();
    let seen = format!("{} samples, {sides} of {SECTORS} sides", take.samples());
    let (verdict, measured, todo) = match wizard.imu(i) {
        Imu::Kept => (Verdict::Kept, "the calibration in use is kept".into(), None),
        Imu::Open => (
            Verdict::Redo,
            seen,
            Some("Finish the capture first.".into()),
        ),
        Imu::Pass(fit) => {
            let (off, residual) = (
                fit.entry.fit.correction_rad.norm(),
                fit.entry.fit.residual_rad,
            );
            let measured = format!(
                "{:.2}° RMS residual, {:.2}° off nominal, zero {:.2}°/s, {seen}",
                residual.to_degrees(),
                off.to_degrees(),
                fit.entry.zero.gyro_bias_rad_s.norm().to_degrees()
            );
            (Verdict::Pass, measured, None)
        }
        Imu::Redo(why) => (Verdict::Redo, seen, Some(sentence(&why))),
    };
    Finding {
        subject: format!("IMU {}", i + 1),
        verdict,
        measured,
        limit: match verdict {
            Verdict::Kept => String::new(),
            _ => format!(
                "at most {:.2}°, at least {SECTORS_NEEDED} sides",
                RESIDUAL_MAX_RAD.to_degrees()
            ),
        },
        todo,
    }
}

fn of_mocap(wizard: &Wizard) -> Finding {
    let n = wizard.mocap.pairs().len();
    let (measured, todo) = match wizard.mocap.fit() {
        None => ("no poses".to_owned(), None),
        Some(Err(e)) => (format!("{n} poses"), Some(sentence(&e.to_string()))),
        Some(Ok(fit)) => {
            let s = &fit.summary;
            let measured = format!(
                "{} of {n} poses used, {:.2} mm and {:.2}° held-out RMS",
                fit.used(),
                s.position_rms_m * 1e3,
                s.rotation_rms_rad.to_degrees()
            );
            let outdated = wizard.mocap.outdated(&wizard.draft());
            (
                measured,
                outdated.map(|why| format!("{} Capture the poses again.", sentence(why))),
            )
        }
    };
    Finding {
        subject: "Registration".to_owned(),
        verdict: wizard.mark(Step::Mocap).into(),
        measured,
        limit: format!(
            "at least {POSES_MIN} poses, uncertainty at most {:.0} mm and {:.0}°",
            WEAKEST_M * 1e3,
            WEAKEST_RAD.to_degrees()
        ),
        todo,
    }
}

fn of_validation(wizard: &Wizard) -> Finding {
    let judgement = wizard.judgement();
    let todo = match &judgement {
        None => Some("Record motion and compare again."),
        Some(j) => j.todo(),
    };
    Finding {
        subject: "Former and new calibration".to_owned(),
        verdict: wizard.mark(Step::Validate).into(),
        measured: judgement
            .as_ref()
            .map_or_else(|| "not compared".to_owned(), |j| j.text.clone()),
        limit: judgement.and_then(|j| j.limit).unwrap_or_default(),
        todo: todo.map(str::to_owned),
    }
}
