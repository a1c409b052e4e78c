//! Units that maps of other labs' logs may name.

use super::asu::PSI_PA;

/// Units with their size in SI.
pub(super) type Units = [(&'static str, f64)];
/// Times.
pub(super) const TIMES: [(&str, f64); 4] = [("s", 1.0), ("ms", 1e-3), ("us", 1e-6), ("ns", 1e-9)];
/// Pressures.
pub(super) const PRESSURES: [(&str, f64); 5] = [
    ("Pa", 1.0),
    ("kPa", 1e3),
    ("psi", PSI_PA),
    ("mbar", 1e2),
    ("bar", 1e5),
];
/// Lengths.
pub(super) const LENGTHS: [(&str, f64); 2] = [("m", 1.0), ("mm", 1e-3)];
/// Angles.
pub(super) const ANGLES: [(&str, f64); 2] = [("rad", 1.0), ("deg", std::f64::consts::PI / 180.0)];
/// Masses.
pub(super) const MASSES: [(&str, f64); 2] = [("kg", 1.0), ("g", 1e-3)];

/// The size of a unit.
///
/// # Errors
/// A sentence that names the units there are.
pub(super) fn size(unit: &str, units: &Units) -> Result<f64, String> {
    let known = units.iter().find(|(name, _)| *name == unit);
    known.map(|(_, size)| *size).ok_or_else(|| {
        let names: Vec<&str> = units.iter().map(|(name, _)| *name).collect();
        format!(
            "the map has the unit '{unit}', and it can be {}",
            names.join(", ")
        )
    })
}
