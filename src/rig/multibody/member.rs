//! The material of one bellows member: what stands of a bellows between two neighbouring rings.
//!
//! With L the member's length and x = L − L₀ its extension, the tension is
//!
//! ```text
//! T = k x (1 + h x²/s² + β |x/L₀|^1.6) − k_c ⟨L_c − L⟩ + Σ_j k_j (x − z_j) + Σ_f F₀ y + c ẋ + T₀ − p A(L)
//! A(L) = A₀ (1 + a x / L₀)
//! ż_j = (x − z_j) / τ_j                                      generalized Maxwell
//! ẏ = (ẋ / x₀)(1 − |y|ⁿ (½ + ½ sign(ẋ y)))                    Bouc-Wen
//! ```
//!
//! Source of the friction law: Y. K. Wen, "Method for random vibration of hysteretic systems", 1976,
//! doi:10.1061/JMCEA3.0002106.

/// Number of viscoelastic branches: three of the rubber, three for what may be hidden in it.
pub const BRANCHES: usize = 6;
/// Exponent n of the friction law.
const FRICTION_POWER: f64 = 1.4;
/// Exponent of the hardening by a power law.
const STRETCH_POWER: f64 = 1.6;

/// Force of a member along its axis at a length.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Axial {
    /// Tension, N: positive pulls the ends together.
    pub tension_n: f64,
    /// Its derivative by the length, N/m.
    pub stiffness_n_m: f64,
}

/// Constants of one member.
#[derive(Clone, Debug, PartialEq)]
pub struct Member {
    /// Length without load, m.
    pub rest_m: f64,
    /// Stiffness at rest, N/m.
    pub stiffness_n_m: f64,
    /// Share by which the elastic force exceeds the linear one at `span_m`.
    pub hardening: f64,
    /// Extension at which the hardening is stated, m.
    pub span_m: f64,
    /// Length below which the folds touch, m.
    pub contact_m: f64,
    /// Stiffness of touching folds, N/m.
    pub contact_n_m: f64,
    /// Stiffness of each viscoelastic branch, N/m.
    pub branch_n_m: [f64; BRANCHES],
    /// Time constant of each branch, s.
    pub branch_s: [f64; BRANCHES],
    /// Coefficient β of hardening by a power law.
    pub stretch: f64,
    /// Tension at rest, N.
    pub pull_n: f64,
    /// Friction elements.
    pub frictions: [Friction; 2],
    /// Viscous coefficient, N s/m.
    pub damping_n_s_m: f64,
    /// Effective area at rest, m².
    pub area_m2: f64,
    /// Relative change of the area with relative extension.
    pub area_slope: f64,
}

/// A friction element.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Friction {
    /// Largest friction force, N; 0 without friction.
    pub coulomb_force_n: f64,
    /// Extension over which friction builds up, m.
    pub presliding_m: f64,
}

impl Default for Friction {
    /// None.
    fn default() -> Self {
        Self {
            coulomb_force_n: 0.0,
            presliding_m: 1e-3,
        }
    }
}

impl Friction {
    /// The friction variable after the extension changed by `dx` (m), in steps that the explicit update holds.
    fn slide(&self, y: f64, dx: f64) -> f64 {
        let steps = (dx.abs() / (0.1 * self.presliding_m)).ceil().max(1.0);
        let du = dx / self.presliding_m / steps;
        (0..steps as usize).fold(y, |y, _| {
            let loading = if du * y >= 0.0 { 1.0 } else { 0.0 };
            (y + du * (1.0 - y.abs().powf(FRICTION_POWER) * loading)).clamp(-1.0, 1.0)
        })
    }
}

/// State of a member.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Memory {
    /// Extension that each branch has relaxed to, m.
    pub relaxed_m: [f64; BRANCHES],
    /// Variable y of each friction element, -1 to 1.
    pub friction: [f64; 2],
}

impl Member {
    fn area_slope_m(&self) -> f64 {
        self.area_m2 * self.area_slope / self.rest_m
    }

    /// Air in the member at a length, ∫ A dL, m³.
    pub fn volume_m3(&self, length_m: f64) -> f64 {
        let x = length_m - self.rest_m;
        self.area_m2 * length_m + 0.5 * self.area_slope_m() * x * x
    }

    /// Energy of the elastic part without memory, J.
    pub fn energy_j(&self, length_m: f64) -> f64 {
        let x = length_m - self.rest_m;
        let cubic = self.hardening / (self.span_m * self.span_m);
        let pressed = (self.contact_m - length_m).max(0.0);
        let strain = (x / self.rest_m).abs();
        let stretch = self.stretch * strain.powf(STRETCH_POWER) / (2.0 + STRETCH_POWER);
        self.stiffness_n_m * x * x * (0.5 + 0.25 * cubic * x * x + stretch)
            + self.pull_n * x
            + 0.5 * self.contact_n_m * pressed * pressed
    }

    /// Elastic force and that of the pressure, without memory.
    pub fn elastic(&self, length_m: f64, gauge_pa: f64) -> Axial {
        let x = length_m - self.rest_m;
        let cubic = self.hardening / (self.span_m * self.span_m);
        let slope = self.area_slope_m();
        let stretch = match self.stretch {
            0.0 => 0.0,
            b => b * (x / self.rest_m).abs().powf(STRETCH_POWER),
        };
        let mut axial = Axial {
            tension_n: self.pull_n + self.stiffness_n_m * x * (1.0 + cubic * x * x + stretch)
                - gauge_pa * (self.area_m2 + slope * x),
            stiffness_n_m: self.stiffness_n_m
                * (1.0 + 3.0 * cubic * x * x + (1.0 + STRETCH_POWER) * stretch)
                - gauge_pa * slope,
        };
        if length_m < self.contact_m {
            axial.tension_n -= self.contact_n_m * (self.contact_m - length_m);
            axial.stiffness_n_m += self.contact_n_m;
        }
        axial
    }

    /// Force after the member came from `before_m` to `length_m` within `dt_s`; `memory` is that before.
    pub fn tension(
        &self,
        memory: &Memory,
        before_m: f64,
        length_m: f64,
        gauge_pa: f64,
        dt_s: f64,
    ) -> Axial {
        let mut axial = self.elastic(length_m, gauge_pa);
        let (x, dx) = (length_m - self.rest_m, length_m - before_m);
        for j in 0..BRANCHES {
            if self.branch_n_m[j] == 0.0 {
                continue;
            }
            // Backward over the interval: z = (z₀ + a x) / (1 + a), a = dt / τ.
            let stiffness_n_m = self.branch_n_m[j] / (1.0 + dt_s / self.branch_s[j]);
            axial.tension_n += stiffness_n_m * (x - memory.relaxed_m[j]);
            axial.stiffness_n_m += stiffness_n_m;
        }
        for (f, &y) in self.frictions.iter().zip(&memory.friction) {
            if f.coulomb_force_n > 0.0 {
                let y = f.slide(y, dx);
                axial.tension_n += f.coulomb_force_n * y;
                let stuck = 1.0 - y.abs().powf(FRICTION_POWER);
                axial.stiffness_n_m += f.coulomb_force_n / f.presliding_m * stuck;
            }
        }
        let viscous_n_m = self.damping_n_s_m / dt_s;
        axial.tension_n += viscous_n_m * dx;
        axial.stiffness_n_m += viscous_n_m;
        axial
    }

    /// State of the member after a step of `dt_s` from `before_m` by `mid_m` to `after_m`.
    pub fn remember(
        &self,
        memory: &mut Memory,
        before_m: f64,
        mid_m: f64,
        after_m: f64,
        dt_s: f64,
    ) {
        for j in 0..BRANCHES {
            let a = 0.5 * dt_s / self.branch_s[j];
            let z = memory.relaxed_m[j];
            let mid = (z + a * (mid_m - self.rest_m)) / (1.0 + a);
            memory.relaxed_m[j] = 2.0 * mid - z;
        }
        for (f, y) in self.frictions.iter().zip(&mut memory.friction) {
            if f.coulomb_force_n > 0.0 {
                *y = f.slide(*y, after_m - before_m);
            }
        }
    }

    /// State of a member that has long been `length_m` long and slides nowhere.
    pub fn relaxed(&self, length_m: f64) -> Memory {
        Memory {
            relaxed_m: [length_m - self.rest_m; BRANCHES],
            friction: [0.0; 2],
        }
    }
}
