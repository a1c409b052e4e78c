//! Why a robot file is refused.

/// Why a robot file was refused.
#[derive(Debug, thiserror::Error)]
pub enum RobotError {
    /// Not valid TOML, or a key is missing, unknown or of the wrong type.
    #[error("the robot file is not valid at line {line}, column {column}: {message}")]
    Syntax {
        /// Line, 1-based.
        line: usize,
        /// Column, 1-based.
        column: usize,
        /// What is wrong there.
        message: String,
    },
    /// A value makes no sense.
    #[error("the robot file has {key} = {value}, but it must be {must}")]
    Value {
        /// The key, dotted.
        key: &'static str,
        /// Value in the file.
        value: String,
        /// What it must be.
        must: &'static str,
    },
    /// A length in metres where mm belong.
    #[error(
        "the robot file has {key} = {value}, which looks like metres: lengths are in mm, so write {}",
        1e3 * value
    )]
    Metres {
        /// The key, dotted.
        key: &'static str,
        /// Value in the file.
        value: f64,
    },
    /// A patch at the end of the file does not hold.
    #[error("patch {number} at the end of the robot file {why}")]
    Patch {
        /// Its number in the file, from 1.
        number: usize,
        /// What is wrong with it, and what to do.
        why: &'static str,
    },
    /// The file has no patch to revert.
    #[error("the robot file carries no patch that could be taken back")]
    NoPatch,
}
