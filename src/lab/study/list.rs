//! The list of studies.

use super::item::Study;
use super::{conditions, control, coverage, faults, heading, networks, samples, sensing};

/// All studies, in the order of the report.
pub static STUDIES: [Study; 27] = [
    networks::MODALITY,
    networks::LAYERS,
    networks::SEQUENCES,
    networks::S2R_WIDTH,
    networks::S2R,
    samples::N_SIM,
    samples::N_REAL,
    samples::N_GRID,
    conditions::LOADS,
    conditions::SPEEDS,
    conditions::LATERAL,
    conditions::SHOCKS,
    faults::FAULTS,
    coverage::COVERAGE,
    heading::HEADING,
    sensing::SENSING,
    control::TUNING,
    control::CIRCLE,
    control::EIGHT,
    control::MOVES,
    control::MOVES_POSITION,
    control::AIDS,
    control::PICK_PLACE,
    control::ADAPTATION,
    control::NULL_SPACE,
    control::DISTURBANCES,
    control::OUTAGES,
];
