//! Forces of a bellows that depend on how its length came about, and a floor under the tip.
//!
//! Over one step each has a convex potential in the length x reached, so they join the energy that
//! statics minimise and cost no iteration of their own. Motion with inertia takes their forces in the middle of its step,
//! where the length is halfway and half of Δt has passed:
//!
//! | | force at x = x₀ + Δ | state |
//! |---|---|---|
//! | friction (Dahl) | ±F_max + (F₀ ∓ F_max) e^{−\|Δ\|/w}, + when the bellows grows | F |
//! | branch (Maxwell) | a B₀ + c (τ/Δt) (1 − a) Δ, a = e^{−Δt/τ} | B |
//! | floor | k max(0, z_floor − z) on the tip, upwards | none |
//! | its grip | G₀ − k_g Δ sideways, no longer than μ N, N the push at the instant before | G |
//!
//! Forces pull the bellows together when positive.

use nalgebra::{Matrix2, Matrix3, Vector2, Vector3};

/// Dry friction of a bellows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Friction {
    /// Largest force, N.
    pub most_n: f64,
    /// Travel over which it builds up, m.
    pub width_m: f64,
    /// Force at the instant before, N.
    pub force_n: f64,
}

/// A spring and a damper in series beside a bellows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Branch {
    /// Rate of the spring, N/m.
    pub rate_n_m: f64,
    /// Time constant, s.
    pub tau_s: f64,
    /// Force at the instant before, N.
    pub force_n: f64,
}

/// What a bellows remembers from the instant before.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Memory {
    /// Its length then, m.
    pub length_m: f64,
    /// Time since, s.
    pub dt_s: f64,
    /// Its dry friction.
    pub friction: Vec<Friction>,
    /// Its viscoelastic branches.
    pub branches: Vec<Branch>,
}

/// An elastic floor under the last section's end, with dry friction along it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Floor {
    /// Height of its surface in the base frame, m.
    pub height_m: f64,
    /// Its rate, N/m.
    pub rate_n_m: f64,
    /// Largest grip over push.
    pub friction: f64,
    /// Where the end was at the instant before, m.
    pub at_m: Vector3<f64>,
    /// Grip at the instant before, N (x, y).
    pub grip_n: Vector2<f64>,
}

/// Rate at which grip builds up as the end is moved along the floor, N/m.
const GRIP_N_M: f64 = 1e3;

/// What a floor does: energy (J), force on the end (N) and stiffness −∂F/∂x (N/m).
#[derive(Clone, Copy, Debug)]
pub(super) struct Push {
    pub energy: f64,
    pub force_n: Vector3<f64>,
    pub stiffness_n_m: Matrix3<f64>,
}

/// A potential with its first two derivatives: J, N, N/m.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Potential {
    pub energy: f64,
    pub force_n: f64,
    pub slope_n_m: f64,
}

impl Friction {
    fn at(&self, dx_m: f64) -> Potential {
        let (most, way) = (self.most_n.copysign(dx_m), dx_m.abs());
        let left = (-way / self.width_m).exp();
        let over = self.force_n - most;
        Potential {
            // ∫ F dx from x₀ on: along the way passed, against its sign.
            energy: most * dx_m - over * self.width_m * (left - 1.0) * 1f64.copysign(dx_m),
            force_n: most + over * left,
            slope_n_m: over.abs() * left / self.width_m,
        }
    }
}

impl Branch {
    fn at(&self, dx_m: f64, dt_s: f64) -> Potential {
        let decay = (-dt_s / self.tau_s).exp();
        let rate = self.rate_n_m * (self.tau_s / dt_s) * (1.0 - decay);
        let kept = decay * self.force_n;
        Potential {
            energy: kept * dx_m + 0.5 * rate * dx_m * dx_m,
            force_n: kept + rate * dx_m,
            slope_n_m: rate,
        }
    }
}

impl Memory {
    /// All forces together at length `x_m`.
    pub(super) fn at(&self, x_m: f64) -> Potential {
        let dx_m = x_m - self.length_m;
        let friction = self.friction.iter().map(|f| f.at(dx_m));
        let branches = self.branches.iter().map(|b| b.at(dx_m, self.dt_s));
        friction
            .chain(branches)
            .fold(Potential::default(), |sum, p| Potential {
                energy: sum.energy + p.energy,
                force_n: sum.force_n + p.force_n,
                slope_n_m: sum.slope_n_m + p.slope_n_m,
            })
    }

    /// Whether it holds any force.
    pub fn is_empty(&self) -> bool {
        self.friction.is_empty() && self.branches.is_empty()
    }

    /// The same bellows once it has come to length `x_m`; `dt_s` is left for the next step.
    pub fn move_to(&mut self, x_m: f64) {
        let (dx_m, dt_s) = (x_m - self.length_m, self.dt_s);
        for f in &mut self.friction {
            f.force_n = f.at(dx_m).force_n;
        }
        for b in &mut self.branches {
            b.force_n = b.at(dx_m, dt_s).force_n;
        }
        self.length_m = x_m;
    }
}

impl Floor {
    /// Push and grip on a point at `p_m`.
    pub(super) fn at(&self, p_m: &Vector3<f64>) -> Push {
        let depth_m = (self.height_m - p_m.z).max(0.0);
        let mut out = Push {
            energy: 0.5 * self.rate_n_m * depth_m * depth_m,
            force_n: Vector3::new(0.0, 0.0, self.rate_n_m * depth_m),
            stiffness_n_m: Matrix3::zeros(),
        };
        if depth_m > 0.0 {
            out.stiffness_n_m[(2, 2)] = self.rate_n_m;
        }
        let most_n = self.friction * self.rate_n_m * (self.height_m - self.at_m.z).max(0.0);
        if most_n > 0.0 {
            // A spring to where the grip would be none, that slips at its largest force (Huber's
            // potential).
            let slack_m = self.at_m.xy() + self.grip_n / GRIP_N_M;
            let u = p_m.xy() - slack_m;
            let (way, sticks) = (u.norm(), GRIP_N_M * u.norm() <= most_n);
            let pull_n = if sticks { GRIP_N_M * way } else { most_n };
            out.energy += if sticks {
                0.5 * GRIP_N_M * way * way
            } else {
                most_n * (way - 0.5 * most_n / GRIP_N_M)
            };
            if way > 0.0 {
                let n = u / way;
                let nn = n * n.transpose();
                let along = if sticks { GRIP_N_M } else { 0.0 };
                let k = nn * along + (Matrix2::identity() - nn) * (pull_n / way);
                out.force_n.fixed_rows_mut::<2>(0).copy_from(&(-n * pull_n));
                out.stiffness_n_m.fixed_view_mut::<2, 2>(0, 0).copy_from(&k);
            }
        }
        out
    }

    /// The same floor once the end has come to `p_m`.
    pub fn move_to(&mut self, p_m: &Vector3<f64>) {
        self.grip_n = self.at(p_m).force_n.xy();
        self.at_m = *p_m;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn forces_are_the_slopes_of_their_potentials() {
        let memory = Memory {
            length_m: 0.17,
            dt_s: 0.1,
            friction: vec![
                Friction {
                    most_n: 3.0,
                    width_m: 4e-3,
                    force_n: -1.2,
                },
                Friction {
                    most_n: 1.0,
                    width_m: 9e-3,
                    force_n: 0.9,
                },
            ],
            branches: vec![Branch {
                rate_n_m: 80.0,
                tau_s: 0.3,
                force_n: 0.7,
            }],
        };
        let h = 1e-7;
        for x in [0.15, 0.168, 0.1701, 0.175, 0.2] {
            let [a, here, b] = [x - h, x, x + h].map(|x| memory.at(x));
            assert!(
                ((b.energy - a.energy) / (2.0 * h) - here.force_n).abs() < 1e-6,
                "{x}"
            );
            assert!(
                ((b.force_n - a.force_n) / (2.0 * h) - here.slope_n_m).abs() < 1e-2,
                "{x}"
            );
            assert!(here.slope_n_m > 0.0);
        }
        assert!(memory.at(memory.length_m).energy.abs() < 1e-15);
    }

    #[test]
    fn a_loop_of_friction_loses_its_area() {
        let mut m = Memory {
            length_m: 0.0,
            dt_s: 0.1,
            friction: vec![Friction {
                most_n: 2.0,
                width_m: 1e-3,
                force_n: 0.0,
            }],
            branches: Vec::new(),
        };
        let mut work = 0.0;
        for (k, x) in [0.05, 0.0, 0.05, 0.0].into_iter().enumerate() {
            if k >= 2 {
                work += m.at(x).energy;
            }
            m.move_to(x);
        }
        // Of 2·2 N·50 mm, each turn keeps back about 2 F w (ln 2 when F runs from −F to F).
        assert!((work - 0.2).abs() < 0.2 * 0.05, "{work}");
    }
}
