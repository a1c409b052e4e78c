//! The tuning of a controller.

use super::adapt::Adaptation;
use super::adrc::AdrcGains;
use super::solver::SolverConfig;
use crate::signal::ControllerKind;

/// Where the ADRC (paper) starts the first solution for a goal from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum InitialGuess {
    /// The nearest sample of the training set without a saturated chamber (paper, section IV-B).
    #[default]
    Nearest,
    /// The signals as they are.
    Present,
}

/// When the ADRC (paper) solves for a new reference.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Resolve {
    /// When the inner loop has converged, as in the paper's section IV-A: every virtual output is below so many Pa, or they
    /// come no nearer.
    Converged(f64),
    /// After so many seconds.
    Every(f64),
}

/// Tuning of a controller.
#[derive(Clone, Debug, PartialEq)]
pub struct Gains {
    /// Which controller.
    pub kind: ControllerKind,
    /// Bandwidths of the inner loop.
    pub adrc: AdrcGains,
    /// When the sensor-space solver runs again (ADRC (paper) only).
    pub resolve: Resolve,
    /// Where the first solution for a goal starts (ADRC (paper) only).
    pub guess: InitialGuess,
    /// Whether a point that moves along a path leads the tip; else the waypoint ahead of it is the goal.
    pub lead: bool,
    /// When the stiffness of the arm is learned.
    pub adaptation: Adaptation,
    /// How far a set pressure may lead the measured one, Pa.
    pub lead_pa: f64,
    /// Pull towards the middle of the pressure range inside the null space, relative to the bandwidth of the loop;
    /// 0 leaves the spare pressures where they are.
    pub centring: f64,
    /// Settings of the sensor-space solver; its weights and σ hold for the whole controller.
    pub solver: SolverConfig,
}

impl Gains {
    /// The tuning of a controller, from 48 candidates each on the same tasks (`springtwin study tuning`): of the paper's the
    /// best, of ours one that is as good as the best. The aids are ours: the paper has none of them.
    pub fn of(kind: ControllerKind) -> Self {
        let (settle_s, observer_ratio, lead_pa) = match kind {
            ControllerKind::PaperAdrc => (0.39, 4.15, 2140.0),
            ControllerKind::NullSpaceQp => (1.02, 6.12, 600.0),
        };
        let is_ours = kind == ControllerKind::NullSpaceQp;
        Self {
            kind,
            adrc: AdrcGains {
                settle_s,
                observer_ratio,
            },
            resolve: Resolve::Converged(95.0),
            guess: InitialGuess::default(),
            lead: is_ours,
            adaptation: match is_ours {
                true => Adaptation::Gated,
                false => Adaptation::Off,
            },
            lead_pa,
            centring: if is_ours { 0.15 } else { 0.0 },
            solver: SolverConfig {
                max_iterations: 60,
                ..SolverConfig::default()
            },
        }
    }
}
