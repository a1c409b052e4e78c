//! Commissioning of a healthy rig: its patch, and the bounds of its residuals.

use crate::gap::{self, Commissioned, Patch, Rmse};

/// The calibration parameters of a healthy rig as a patch.
pub fn patch_of(rig: &Commissioned) -> Patch {
    let all = |k: usize| {
        let all: Vec<&str> = rig.sessions.iter().map(|s| s[k].as_str()).collect();
        all.join(", ")
    };
    let mut patch = Patch {
        version: gap::VERSION,
        name: format!("commissioned on {}", all(0)),
        robot: rig.robot.clone(),
        verdict: String::new(),
        data: [("commissioning".to_owned(), all(1))].into(),
        rig: Default::default(),
        floor: Default::default(),
        law: Vec::new(),
        effects: Vec::new(),
    };
    patch.set_values(&rig.arm.values);
    patch
}

/// A kind of residual with its bounds.
#[derive(Clone, Debug)]
pub struct Kind {
    /// Its name.
    pub name: &'static str,
    /// Root mean square, SI; `None` where nothing of the kind was measured.
    pub rms: Option<f64>,
    /// A warning above this, SI. The healthy sessions at hand leave 0.4 to 1.5 mm at the end pad.
    pub warn: f64,
    /// No patch is written above this, SI.
    pub refuse: f64,
    /// Unit of the report, and its number per SI unit.
    pub unit: (&'static str, f64),
    /// Unit of a warning.
    pub warn_unit: (&'static str, f64),
}

const DEG: (&str, f64) = ("deg", 180.0 / std::f64::consts::PI);
const MM: (&str, f64) = ("mm", 1e3);
const CM: (&str, f64) = ("cm", 1e2);

/// The residuals of a healthy session with their bounds.
pub fn kinds(f: &Rmse) -> [Kind; 4] {
    let length = |name, rms, warn, refuse| Kind {
        name,
        rms,
        warn,
        refuse,
        unit: MM,
        warn_unit: CM,
    };
    let angle = |name, rms: Option<f64>| Kind {
        name,
        rms,
        warn: 5f64.to_radians(),
        refuse: 15f64.to_radians(),
        unit: DEG,
        warn_unit: DEG,
    };
    [
        length("end pad", f.position_m, 10e-3, 30e-3),
        angle("its rotation", f.rotation_rad),
        length("springs", f.spring_m, 5e-3, 15e-3),
        angle("IMUs", f.imu_rad),
    ]
}

/// The kinds of residual that are above a bound; `None` if there are none.
pub fn beyond(kinds: &[Kind], bound: impl Fn(&Kind) -> f64) -> Option<String> {
    let large: Vec<String> = kinds
        .iter()
        .filter_map(|k| {
            let (unit, factor) = k.warn_unit;
            let rms = k.rms.filter(|v| *v > bound(k))?;
            Some(format!(
                "{} {:.1} {unit} (at most {:.1} {unit} for a healthy rig)",
                k.name,
                rms * factor,
                bound(k) * factor
            ))
        })
        .collect();
    (!large.is_empty()).then(|| format!("large residual: {}", large.join(", ")))
}

/// All residuals, for people.
pub fn residuals(kinds: &[Kind]) -> String {
    let parts: Vec<String> = kinds
        .iter()
        .filter_map(|k| Some(format!("{} {:.2} {}", k.name, k.rms? * k.unit.1, k.unit.0)))
        .collect();
    parts.join(", ")
}
