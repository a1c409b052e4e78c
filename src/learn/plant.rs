//! Plant network: six pressures and the payload to 24 signals.

use nalgebra::{SMatrixView, SVector};
use serde::{Deserialize, Serialize};

use super::cascade::{ShapeError, check};
use super::kernel::Kernel;
use super::mlp::Mlp;
use super::{PlantEval, PlantMap};
use crate::signal::{CHAMBERS, SIGNALS};

/// Where the plant's training data lie.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PlantBounds {
    /// Lowest and highest gauge pressure per chamber, Pa.
    pub chamber_pa: [[f64; 2]; CHAMBERS],
    /// Lowest and highest payload, kg.
    pub payload_kg: [f64; 2],
}

impl PlantBounds {
    /// Whether gauge pressures of chambers 1 to 6 and a payload lie within the training data's bounds.
    pub fn contains(&self, chamber_pa: &[f64; CHAMBERS], payload_kg: f64) -> bool {
        let within = |x: f64, [lo, hi]: [f64; 2]| (lo..=hi).contains(&x);
        within(payload_kg, self.payload_kg)
            && chamber_pa
                .iter()
                .zip(&self.chamber_pa)
                .all(|(p, bounds)| within(*p, *bounds))
    }
}

/// The trained plant.
#[derive(Clone, Debug)]
pub struct PlantNet {
    net: Mlp,
    bounds: PlantBounds,
    kernel: Kernel,
}

impl PlantNet {
    /// Prepares a trained network 7 → 24 (pressures in Pa, payload in kg; signals).
    ///
    /// # Errors
    /// [`ShapeError`] when the network has the wrong number of inputs or outputs.
    pub fn new(net: Mlp, bounds: PlantBounds) -> Result<Self, ShapeError> {
        let want = "7 inputs and 24 outputs";
        check("the plant", &net, &[CHAMBERS + 1], SIGNALS, want)?;
        Ok(Self {
            kernel: Kernel::new(&net),
            net,
            bounds,
        })
    }

    /// The network.
    pub fn net(&self) -> &Mlp {
        &self.net
    }

    /// Where its training data lie.
    pub fn bounds(&self) -> &PlantBounds {
        &self.bounds
    }

    /// The 24 signals (m, rad) at gauge pressures of chambers 1 to 6, without their derivative.
    pub fn value(&self, chamber_pa: &[f64; CHAMBERS], payload_kg: f64) -> SVector<f64, SIGNALS> {
        SVector::from_column_slice(&self.kernel.value(&input(chamber_pa, payload_kg)))
    }
}

/// The network's input.
pub(super) fn input(chamber_pa: &[f64; CHAMBERS], payload_kg: f64) -> [f64; CHAMBERS + 1] {
    std::array::from_fn(|i| chamber_pa.get(i).copied().unwrap_or(payload_kg))
}

impl PlantMap for PlantNet {
    fn sensors(&self, chamber_pa: &[f64; CHAMBERS], payload_kg: f64) -> PlantEval {
        let x = input(chamber_pa, payload_kg);
        let (y, j) = self.kernel.value_and_jacobian(&x);
        PlantEval {
            sensors: SVector::from_column_slice(&y),
            // The derivative after the payload is the last column, which is left out.
            jacobian: SMatrixView::<f64, SIGNALS, CHAMBERS>::from_slice(&j[..SIGNALS * CHAMBERS])
                .into_owned(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bounds_hold_pressures_and_payload() {
        let bounds = PlantBounds {
            chamber_pa: [[-40e3, 40e3]; CHAMBERS],
            payload_kg: [0.0, 0.5],
        };
        assert!(bounds.contains(&[40e3; CHAMBERS], 0.5));
        assert!(!bounds.contains(&[0.0, 0.0, 0.0, 0.0, 0.0, 40.1e3], 0.0));
        assert!(!bounds.contains(&[0.0; CHAMBERS], 0.6));
        assert!(!bounds.contains(&[f64::NAN; CHAMBERS], 0.0));
    }
}
