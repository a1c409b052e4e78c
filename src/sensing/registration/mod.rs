//! Registration of motion capture: where its world and its object are on the robot, and what its
//! clock reads.
//!
//! | symbol | | name here |
//! |---|---|---|
//! | Bᵢ | pose of the tip in the base frame, by the robot | `base_from_tip` |
//! | Aᵢ | pose of the tracked object in the motion-capture world | `world_from_object` |
//! | X | where that world is; its rotation R_X, its translation t_X | `base_from_world` |
//! | Y | where the tip is on the object; R_Y, t_Y | `object_from_tip` |
//! | Δ | t_robot = t_mocap + Δ | `offset_s` |
//! | ā | mean position of the object in its world | `centre_in_world_m` |
//! | rᵢ | residual: position (m) and rotation vector (rad), base frame | |
//! | Sᵢ | covariance of rᵢ by the stated noise | [`Noise`] |
//!
//! Bᵢ = X Aᵢ Y: the robot-world/hand-eye problem. The first guess is closed: rotations from the
//! greatest singular pair of Σ R_A ⊗ R_B, then translations by linear least squares (Shah 2013,
//! <https://doi.org/10.1115/1.4024473>), or the rotation of X from the positions (Kabsch 1976,
//! <https://doi.org/10.1107/S0567739476001873>), whichever ends lower. Levenberg and Marquardt then
//! minimise Σ rᵢᵀ Sᵢ⁻¹ rᵢ over twelve parameters (Dornaika and Horaud 1998,
//! <https://doi.org/10.1109/70.704233>).
//!
//! What the robot's poses err by alike everywhere goes into the frames, and no residual shows it: a
//! registration to the robot's own estimates is no judge of their constant part. Stated noise has to
//! be that of the robot as a whole, not its repeatability; one sigma never falls below it.
//!
//! [`register`] fits the frames to settled poses, [`clock_offset`] finds Δ between two streams,
//! [`register_streams`] does both, [`Registration`] is the file.

mod clock;
mod correlate;
mod file;
mod fit;
mod guess;
mod held_out;
mod so3;
mod streams;
mod track;

#[cfg(test)]
mod clock_tests;
#[cfg(test)]
mod fake;
#[cfg(test)]
mod tests;

pub use clock::{ClockOffset, clock_offset};
pub use correlate::ClockOptions;
pub use file::{MeasuredOffset, Placed, Registration, RegistrationFileError};
pub use held_out::{HeldOut, HeldOutSummary, register, register_blocks};
pub use streams::{StreamOptions, StreamRegistration, register_streams};

use nalgebra::{Matrix3, SMatrix, Vector3};
use sha2::{Digest as _, Sha256};

use crate::signal::{Pose, hex};

/// Fewest poses.
pub const POSES_MIN: usize = 10;
/// Refused when any direction of the two transforms is less certain than this, one sigma, m.
pub const WEAKEST_M: f64 = 5e-3;
/// As [`WEAKEST_M`], rad.
pub const WEAKEST_RAD: f64 = std::f64::consts::PI / 180.0;
/// Tips closer together than this are one place: root mean square about their mean, m.
pub const ONE_PLACE_M: f64 = 0.01;
const IDENTITY: Pose = Pose {
    rotation: nalgebra::Unit::new_unchecked(nalgebra::Quaternion::new(1.0, 0.0, 0.0, 0.0)),
    translation: nalgebra::Translation3::new(0.0, 0.0, 0.0),
};
/// Poses farther from their origin than this are not in metres, m.
const FAR_M: f64 = 1e3;

/// The two transforms that place motion capture on the robot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Frames {
    /// X, the motion-capture world in the base frame.
    pub base_from_world: Pose,
    /// Y, the end pad's frame on the tracked object.
    pub object_from_tip: Pose,
}

impl Frames {
    /// World and base the same, object and tip the same.
    pub const IDENTITY: Self = Self {
        base_from_world: IDENTITY,
        object_from_tip: IDENTITY,
    };

    /// X A Y: the tip in the base frame, by the tracked object in its world.
    pub fn base_from_tip(&self, world_from_object: &Pose) -> Pose {
        self.base_from_world * world_from_object * self.object_from_tip
    }
}

/// The robot at rest and what motion capture saw there.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PosePair {
    /// Tip in the base frame, by the robot.
    pub base_from_tip: Pose,
    /// Tracked object in the motion-capture world.
    pub world_from_object: Pose,
}

/// Standard deviations of a pose, per axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Noise {
    /// Position, m.
    pub position_m: f64,
    /// Rotation vector, rad.
    pub rotation_rad: f64,
}

/// What is known of the end pad's frame on the tracked object.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ObjectFrame {
    /// Nothing: it is fitted.
    Unknown,
    /// `object_from_tip`; the identity for an object that was defined on the end pad's frame.
    Known(Pose),
}

/// How frames are fitted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FitOptions {
    /// Noise of the robot's poses: what its model or its estimate errs by.
    pub robot: Noise,
    /// Noise of the motion capture's poses, at the object's origin.
    pub mocap: Noise,
    /// The end pad's frame on the object.
    pub object: ObjectFrame,
}

impl Default for FitOptions {
    /// A robot good to 1 mm and half a degree, a motion capture good to 0.1 mm and 0.05 degrees.
    fn default() -> Self {
        Self {
            robot: Noise {
                position_m: 1e-3,
                rotation_rad: 0.5_f64.to_radians(),
            },
            mocap: Noise {
                position_m: 1e-4,
                rotation_rad: 0.05_f64.to_radians(),
            },
            object: ObjectFrame::Unknown,
        }
    }
}

/// Fitted frames and how far to believe them.
#[derive(Clone, Debug, PartialEq)]
pub struct FrameFit {
    /// The frames.
    pub frames: Frames,
    /// ā in motion capture's world, m. Uncertainty of `base_from_world` is given at this point, not at an origin far away.
    pub centre_in_world_m: Vector3<f64>,
    /// Covariance by the stated noise over φ_X (rad, base frame, R_X ← exp(φ) R_X), the image X ā
    /// (m), φ_Y (rad, tip frame, R_Y ← R_Y exp(φ)) and t_Y (m). Zero for what was held.
    pub covariance: SMatrix<f64, 12, 12>,
    /// √(χ² / degrees of freedom): 1 where the stated noise is what there is.
    pub misfit: f64,
    /// Whether the last step of the fit was negligible.
    pub converged: bool,
    /// Smallest eigenvalue of the normal matrix in units of ([`WEAKEST_M`], [`WEAKEST_RAD`]).
    pub weakest: f64,
    /// Per pair, in the order given, what the others predict of it.
    pub held_out: Vec<HeldOut>,
    /// Over the pairs that were used.
    pub summary: HeldOutSummary,
    /// Pairs (0-based) that stand out from what the others predict. They were not used for the
    /// frames; their residuals are in [`Self::held_out`].
    pub suspects: Vec<usize>,
}

impl FrameFit {
    /// How many pairs the frames rest on.
    pub fn used(&self) -> usize {
        self.held_out.len() - self.suspects.len()
    }

    /// One sigma of `base_from_world` at the centre of the data, in its worst direction.
    pub fn base_from_world_sigma(&self) -> Noise {
        self.sigma(3, 0)
    }

    /// One sigma of `object_from_tip` in its worst direction; 0 where it was held.
    pub fn object_from_tip_sigma(&self) -> Noise {
        self.sigma(9, 6)
    }

    /// Stated noise that is too small does not make the frames more certain.
    fn sigma(&self, position: usize, rotation: usize) -> Noise {
        let worst = |at: usize| {
            let block: Matrix3<f64> = self.covariance.fixed_view::<3, 3>(at, at).into();
            let greatest = block.symmetric_eigenvalues().max();
            greatest.max(0.0).sqrt() * self.misfit.max(1.0)
        };
        Noise {
            position_m: worst(position),
            rotation_rad: worst(rotation),
        }
    }
}

/// Which motion is missing.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Missing {
    /// The poses are all in one place.
    Places,
    /// They lie on one line, about which the world could turn.
    Directions,
    /// They are all turned alike.
    Tilts,
    /// They turn about one axis only (unit vector, base frame).
    SecondAxis([f64; 3]),
}

impl std::fmt::Display for Missing {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Places => f.write_str(
                "the tip is in one place in all poses: record poses whose tips lie 50 mm and more apart",
            ),
            Self::Directions => f.write_str(
                "the poses leave the turn of the motion-capture world open: record poses to all sides, not on one \
                 line",
            ),
            Self::Tilts => f.write_str(
                "the end pad is turned alike in all poses, so that the tip's place on the object cannot be \
                 seen: record poses with the end pad tilted in different directions",
            ),
            Self::SecondAxis([x, y, z]) => write!(
                f,
                "the end pad turns about one axis only, ({x:.2}, {y:.2}, {z:.2}) in the base frame, so that \
                 the tip's place along it cannot be seen: record poses tilted about another axis too"
            ),
        }
    }
}

/// Why there is no registration.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum RegistrationError {
    /// Not enough poses.
    #[error(
        "only {poses} different poses with both robot and motion capture; a registration needs at least {POSES_MIN}"
    )]
    TooFew {
        /// Poses given.
        poses: usize,
    },
    /// Not enough poses that agree.
    #[error(
        "of {poses} poses {} not fit the others (counted from 1: {}), and the {left} that are left are fewer \
         than {POSES_MIN}; record more poses",
        if suspects.len() == 1 { "one does" } else { "some do" }, counted(suspects)
    )]
    TooFewLeft {
        /// Poses given.
        poses: usize,
        /// Which of them stand out (0-based).
        suspects: Vec<usize>,
        /// Poses that do not.
        left: usize,
    },
    /// A number that no pose has.
    #[error(
        "pose {} is not a pose: its numbers must be finite, within {FAR_M} m, and its rotation a unit quaternion",
        index + 1
    )]
    NotAPose {
        /// Which pair (0-based).
        index: usize,
    },
    /// An option that makes no sense.
    #[error("{name} = {value} makes no sense: it must be {must}")]
    Option {
        /// Which.
        name: &'static str,
        /// Its value.
        value: f64,
        /// What it must be.
        must: &'static str,
    },
    /// The poses leave a direction open.
    #[error("{0}")]
    Unobservable(Missing),
    /// No frames make the poses meet.
    #[error(
        "the poses of robot and motion capture do not fit together: {:.1} mm and {:.1} degrees are left; check that \
         both saw the same motion and that the object is fixed to the end pad",
        position_m * 1e3, rotation_rad.to_degrees()
    )]
    Disagree {
        /// Root mean square of what is left, m.
        position_m: f64,
        /// The same, rad.
        rotation_rad: f64,
    },
    /// Times run backwards or too far.
    #[error(
        "the times of the {stream} must be finite, strictly increasing and within a day; sample {} is not",
        index + 1
    )]
    Times {
        /// `robot` or `motion capture`.
        stream: &'static str,
        /// Which sample (0-based).
        index: usize,
    },
    /// The streams share too little.
    #[error(
        "robot and motion capture share only {seconds:.1} s without gaps within the offsets searched; at least \
         {} s are needed",
        correlate::OVERLAP_MIN_S
    )]
    NoOverlap {
        /// Seconds shared at best.
        seconds: f64,
    },
    /// The motion determines too little.
    #[error(
        "robot and motion capture do not turn alike at any offset (correlation {correlation:.2} at best): record \
         half a minute or more of bending in changing directions, and check that both show the same motion"
    )]
    NoPeak {
        /// Best correlation.
        correlation: f64,
    },
    /// The motion repeats itself.
    #[error(
        "the motion repeats itself: offsets of {first_s:.2} s and {second_s:.2} s fit about equally well \
         (correlations {first:.2} and {second:.2}); record a motion that does not repeat, or search fewer offsets"
    )]
    Ambiguous {
        /// Best offset, s.
        first_s: f64,
        /// Runner-up, s.
        second_s: f64,
        /// Correlation at the best.
        first: f64,
        /// Correlation at the runner-up.
        second: f64,
    },
    /// The best offset is the last one that was searched.
    #[error(
        "the best offset, {offset_s:.2} s, lies at the end of those searched: search more, or about another guess"
    )]
    AtEdge {
        /// That offset, s.
        offset_s: f64,
    },
    /// Speeds and poses give different offsets.
    #[error(
        "speeds give an offset of {coarse_s:.2} s, poses one of {fine_s:.2} s: the motion does not determine it; record \
         half a minute or more of bending in changing directions"
    )]
    Unsettled {
        /// By angular speeds, s.
        coarse_s: f64,
        /// By poses, s.
        fine_s: f64,
    },
}

/// SHA-256 of settled pairs, hexadecimal, for the registration's file.
pub fn digest(pairs: &[PosePair]) -> String {
    let numbers = pairs.iter().flat_map(|pair| {
        [&pair.base_from_tip, &pair.world_from_object].map(|p| {
            let (t, r) = (p.translation.vector, p.rotation.coords);
            [t.x, t.y, t.z, r.x, r.y, r.z, r.w]
        })
    });
    let mut hash = Sha256::new();
    for x in numbers.flatten() {
        hash.update(x.to_le_bytes());
    }
    hex(&hash.finalize())
}

fn counted(suspects: &[usize]) -> String {
    let numbers: Vec<String> = suspects.iter().map(|i| (i + 1).to_string()).collect();
    numbers.join(", ")
}

fn is_pose(pose: &Pose) -> bool {
    let t = &pose.translation.vector;
    t.iter().all(|x| x.abs() < FAR_M)
        && (pose.rotation.as_vector().norm_squared() - 1.0).abs() < 1e-6
}

impl FitOptions {
    fn check(&self) -> Result<(), RegistrationError> {
        for (name, value) in [
            ("robot position noise (m)", self.robot.position_m),
            ("robot rotation noise (rad)", self.robot.rotation_rad),
            ("motion-capture position noise (m)", self.mocap.position_m),
            (
                "motion-capture rotation noise (rad)",
                self.mocap.rotation_rad,
            ),
        ] {
            if !(1e-9..=10.0).contains(&value) {
                return Err(RegistrationError::Option {
                    name,
                    value,
                    must: "between 1e-9 and 10",
                });
            }
        }
        match &self.object {
            ObjectFrame::Known(pose) if !is_pose(pose) => Err(RegistrationError::Option {
                name: "object_from_tip, largest number",
                value: pose.translation.vector.amax(),
                must: "a pose",
            }),
            _ => Ok(()),
        }
    }
}
