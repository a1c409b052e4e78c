//! Laws of friction, viscoelastic branches and the floor, as potentials over one step.

use nalgebra::{Matrix2, Matrix3, Rotation3, Vector2, Vector3};

/// Presliding friction of a bellows (Dahl).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Friction {
    /// Coulomb force, which it tends to, N.
    pub coulomb_force_n: f64,
    /// Travel over which it builds up, m.
    pub presliding_m: f64,
}

/// A spring and a damper in series beside a bellows (Maxwell).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Branch {
    /// Rate of the spring, N/m.
    pub rate_n_m: f64,
    /// Time constant, s.
    pub tau_s: f64,
}

/// An elastic half-space that the last section's end may touch, with dry friction along its surface: a floor, a wall, or one
/// that leans.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Floor {
    /// Axes of the surface, z out of it, from the base frame.
    pub surface_from_base: Rotation3<f64>,
    /// Where its surface is along its normal, from the origin of the base frame, m.
    pub height_m: f64,
    /// Its rate, N/m.
    pub rate_n_m: f64,
    /// Largest grip over push.
    pub friction: f64,
    /// What the end drags behind it, wherever it is; `None`: nothing.
    pub drag: Option<Drag>,
}

/// Dry friction against every motion of a point: it is held by a spring that slips at a largest force.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Drag {
    /// Largest force, N.
    pub force_n: f64,
    /// Rate of the spring, N/m.
    pub rate_n_m: f64,
}

impl Drag {
    /// Of a point at `p_m` that was at `contact` (Huber's potential).
    fn at(&self, p_m: &Vector3<f64>, contact: &Contact) -> Push {
        let u = p_m - (contact.at_m + contact.drag_n / self.rate_n_m);
        let (way_m, k) = (u.norm(), self.rate_n_m);
        if k * way_m <= self.force_n {
            return Push {
                energy: 0.5 * k * way_m * way_m,
                force_n: -k * u,
                stiffness_n_m: Matrix3::identity() * k,
            };
        }
        let n = u / way_m;
        Push {
            energy: self.force_n * (way_m - 0.5 * self.force_n / k),
            force_n: -self.force_n * n,
            stiffness_n_m: (Matrix3::identity() - n * n.transpose()) * (self.force_n / way_m),
        }
    }
}

/// Contact of the last section's end with the [`Floor`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Contact {
    /// Where the end is, base frame, m.
    pub at_m: Vector3<f64>,
    /// Grip along the surface's x and y, N.
    pub grip_n: Vector2<f64>,
    /// Force of the [`Drag`], base frame, N.
    pub drag_n: Vector3<f64>,
}

/// Rate at which grip builds up as the end is moved along the floor, N/m.
const GRIP_N_M: f64 = 1e3;

/// Reaction of a floor: energy (J), force on the end (N) and stiffness −∂F/∂x (N/m).
#[derive(Clone, Copy, Debug)]
pub(super) struct Push {
    pub energy: f64,
    pub force_n: Vector3<f64>,
    pub stiffness_n_m: Matrix3<f64>,
}

/// A spring that acts on one side of a stretch: a bellows that touches its neighbour, or one that is held back.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hinge {
    /// Where it begins, stretch.
    pub from: f64,
    /// Whether it acts beyond it rather than below.
    pub beyond: bool,
    /// Force per unit stretch, N.
    pub stiffness_n: f64,
}

impl Hinge {
    /// Potential per reference length at a stretch: J/m, N, N.
    pub(super) fn at(&self, stretch: f64) -> Potential {
        let x = stretch - self.from;
        if (x > 0.0) != self.beyond {
            return Potential::default();
        }
        Potential {
            energy: 0.5 * self.stiffness_n * x * x,
            force_n: self.stiffness_n * x,
            slope_n_m: self.stiffness_n,
        }
    }
}

/// A potential with its first two derivatives: J, N, N/m.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Potential {
    pub energy: f64,
    pub force_n: f64,
    pub slope_n_m: f64,
}

impl Potential {
    pub(super) fn and(&self, other: &Self) -> Self {
        Self {
            energy: self.energy + other.energy,
            force_n: self.force_n + other.force_n,
            slope_n_m: self.slope_n_m + other.slope_n_m,
        }
    }
}

impl Friction {
    pub(super) fn at(&self, force_n: f64, dx_m: f64) -> Potential {
        let (most, way) = (self.coulomb_force_n.copysign(dx_m), dx_m.abs());
        let left = (-way / self.presliding_m).exp();
        let over = force_n - most;
        Potential {
            // ∫ F dx from x₀ on: along the way passed, against its sign.
            energy: most * dx_m - over * self.presliding_m * (left - 1.0) * 1f64.copysign(dx_m),
            force_n: most + over * left,
            slope_n_m: over.abs() * left / self.presliding_m,
        }
    }
}

impl Branch {
    pub(super) fn at(&self, force_n: f64, dx_m: f64, dt_s: f64) -> Potential {
        let decay = (-dt_s / self.tau_s).exp();
        let rate = self.rate_n_m * (self.tau_s / dt_s) * (1.0 - decay);
        let kept = decay * force_n;
        Potential {
            energy: kept * dx_m + 0.5 * rate * dx_m * dx_m,
            force_n: kept + rate * dx_m,
            slope_n_m: rate,
        }
    }
}

impl Floor {
    /// Push on a point at `p_m`, with the grip that follows `contact`; all but the grip in the base frame.
    pub(super) fn at(&self, p_m: &Vector3<f64>, contact: Option<&Contact>) -> Push {
        let turn = self.surface_from_base;
        let drag = self.drag.zip(contact).map(|(d, c)| d.at(p_m, c));
        let contact = contact.map(|c| Contact {
            at_m: turn * c.at_m,
            ..*c
        });
        let push = self.upright(&(turn * p_m), contact.as_ref());
        let back = turn.inverse();
        let mut out = Push {
            energy: push.energy,
            force_n: back * push.force_n,
            stiffness_n_m: back.matrix() * push.stiffness_n_m * turn.matrix(),
        };
        if let Some(drag) = drag {
            out.energy += drag.energy;
            out.force_n += drag.force_n;
            out.stiffness_n_m += drag.stiffness_n_m;
        }
        out
    }

    /// The contact once the end has come to `p_m` in the base frame.
    pub(super) fn reached(&self, p_m: &Vector3<f64>, contact: &Contact) -> Contact {
        let alone = Self {
            drag: None,
            ..*self
        };
        let drag_n = self.drag.map(|d| d.at(p_m, contact).force_n);
        Contact {
            at_m: *p_m,
            grip_n: (self.surface_from_base * alone.at(p_m, Some(contact)).force_n).xy(),
            drag_n: drag_n.unwrap_or_default(),
        }
    }

    /// The same in the axes of the surface.
    fn upright(&self, p_m: &Vector3<f64>, contact: Option<&Contact>) -> Push {
        let depth_m = (self.height_m - p_m.z).max(0.0);
        let mut out = Push {
            energy: 0.5 * self.rate_n_m * depth_m * depth_m,
            force_n: Vector3::new(0.0, 0.0, self.rate_n_m * depth_m),
            stiffness_n_m: Matrix3::zeros(),
        };
        if depth_m > 0.0 {
            out.stiffness_n_m[(2, 2)] = self.rate_n_m;
        }
        let Some(contact) = contact else {
            return out;
        };
        let most_n = self.friction * self.rate_n_m * (self.height_m - contact.at_m.z).max(0.0);
        if most_n > 0.0 {
            // A spring to where the grip would be none, that slips at its largest force (Huber's
            // potential).
            let slack_m = contact.at_m.xy() + contact.grip_n / GRIP_N_M;
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
}
