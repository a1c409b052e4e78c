//! The tuning of a controller.

use super::adapt::Adaptation;
use super::adrc::AdrcGains;
use super::solver::SolverConfig;
use crate::signal::ControllerKind;

/// Where the ADRC (paper) starts the first solution for a goal from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum InitialGuess {
    /// The nearest sample of the training set without a saturated chamber (S11).
    #[default]
    Nearest,
    /// The signals as they are.
    Present,
}

/// Tuning of a controller.
#[derive(Clone, Debug, PartialEq)]
pub struct Gains {
    /// Which controller.
    pub kind: ControllerKind,
    /// Bandwidths of the inner loop.
    pub adrc: AdrcGains,
    /// Time between two runs of the sensor-space solver, s.
    pub outer_period_s: f64,
    /// Where the first solution for a goal starts (ADRC (paper) only).
    pub guess: InitialGuess,
    /// When the stiffness of the arm is learned (null-space QP only).
    pub adaptation: Adaptation,
    /// How far a set pressure may lead the measured one, Pa.
    pub lead_pa: f64,
    /// Pull towards the middle of the pressure range inside the null space, relative to the bandwidth of the loop
    /// (null-space QP only); 0 leaves the spare pressures where they are.
    pub centring: f64,
    /// Settings of the sensor-space solver; its weights and σ hold for the whole controller.
    pub solver: SolverConfig,
}

impl Gains {
    /// The tuning of a controller: the best of 48 candidates each, on the same tasks (`springtwin study tuning`).
    pub fn of(kind: ControllerKind) -> Self {
        let (settle_s, observer_ratio, lead_pa) = match kind {
            ControllerKind::PaperAdrc => (0.39, 4.15, 2140.0),
            ControllerKind::NullSpaceQp => (1.02, 6.12, 600.0),
        };
        Self {
            kind,
            adrc: AdrcGains {
                settle_s,
                observer_ratio,
            },
            outer_period_s: 0.05,
            guess: InitialGuess::default(),
            adaptation: match kind {
                ControllerKind::PaperAdrc => Adaptation::Off,
                ControllerKind::NullSpaceQp => Adaptation::Gated,
            },
            lead_pa,
            centring: 0.15,
            solver: SolverConfig {
                max_iterations: 60,
                ..SolverConfig::default()
            },
        }
    }
}
