//! The list of studies.

use super::item::Study;
use super::{conditions, control, coverage, faults, heading, networks, samples, sensing};

/// All studies, in the order of the report: first those of which the paper's page is made.
pub static STUDIES: [Study; 27] = [
    networks::MODALITY,
    networks::LAYERS,
    networks::SEQUENCES,
    networks::S2R_WIDTH,
    networks::S2R,
    samples::N_GRID,
    conditions::LOADS,
    conditions::SPEEDS,
    conditions::LATERAL,
    conditions::SHOCKS,
    control::CIRCLE,
    control::EIGHT,
    control::MOVES,
    control::PICK_PLACE,
    control::TUNING,
    control::MOVES_POSITION,
    control::AIDS,
    control::ADAPTATION,
    control::NULL_SPACE,
    control::DISTURBANCES,
    control::OUTAGES,
    samples::N_SIM,
    samples::N_REAL,
    faults::FAULTS,
    coverage::COVERAGE,
    heading::HEADING,
    sensing::SENSING,
];

/// Those of the paper's page.
pub(super) fn of_paper() -> &'static [Study] {
    &STUDIES[..14]
}
