"""The arm in PyElastica: one Cosserat rod, pads as stiff elements of it.

Nodes from the base down: a clamped element above the base, segment 1, the middle pad (one element),
segment 2, the end pad with the gripper (one element). Pressure is the rest strain and rest curvature
that balance it, which for bellows along a rod without shear and twist is the same energy.
"""

import elastica
import numpy as np
from elastica.version import VERSION
from numba import njit

from arm import GRAVITY_M_S2, Arm

NAME = "PyElastica"
PAD_STIFFNESS = 4.0  # of a pad over a segment's, per length


class _System(
    elastica.BaseSystemCollection, elastica.Constraints, elastica.Forcing, elastica.Damping
):
    pass


class Simulation:
    """The rod and its time stepper.

    `damping_1_s` slows every speed by this rate; `shear` is the shear rigidity over the axial one
    (the program's rod has no shear: the larger, the closer, and the smaller the stable step).
    """

    def __init__(self, arm: Arm, elements: int, step_s: float, damping_1_s: float, shear: float):
        self.arm, self.n, self.step_s = arm, elements, step_s
        self.rod = rod = _rod(arm, elements, shear)
        self.unknowns = 6 * (2 * elements + 2)  # free nodes and directors
        system = _System()
        system.append(rod)
        system.constrain(rod).using(
            elastica.FixedConstraint,
            constrained_position_idx=(0, 1),
            constrained_director_idx=(0,),
        )
        system.constrain(rod).using(_Bellows)
        system.add_forcing_to(rod).using(_Loads, arm=arm, n=elements)
        if damping_1_s > 0.0:
            system.dampen(rod).using(
                elastica.AnalyticalLinearDamper,
                uniform_damping_constant=damping_1_s,
                time_step=step_s,
            )
        system.finalize()
        self.system = system
        self.stepper = elastica.PositionVerlet()
        self.position_m = rod.position_collection.copy()
        self.directors = rod.director_collection.copy()

    def start(self, pressures_kpa) -> None:
        """The unloaded arm at rest, the pressures applied at once."""
        rod, arm, n = self.rod, self.arm, self.n
        rod.position_collection[:] = self.position_m
        rod.director_collection[:] = self.directors
        rod.velocity_collection[:] = 0.0
        rod.omega_collection[:] = 0.0
        rod.rest_sigma[:] = 0.0
        rod.rest_kappa[:] = 0.0
        push_n = arm.push_n(pressures_kpa)
        length_m = arm.length_m / n
        for s in range(2):
            first = 1 + s * (n + 1)
            r1, r2 = arm.bellows_m[s, :, 0], -arm.bellows_m[s, :, 1]
            # stretch of bellows i: σ₃ + κ₁ r₂ᵢ − κ₂ r₁ᵢ; the pushes' work is linear in it
            rod.rest_sigma[2, first : first + n] = push_n[s].sum() / arm.axial_n
            kappa = np.array([push_n[s] @ r2, -push_n[s] @ r1, 0.0]) / arm.bending_nm2
            for v in range(first - 1, first + n):
                # At its ends only half of a hinge's length belongs to the segment.
                own_m = length_m if first <= v < first + n - 1 else 0.5 * length_m
                rod.rest_kappa[:, v] = kappa * own_m / rod.rest_voronoi_lengths[v]
        self.time_s = 0.0

    def run(self, steps: int) -> None:
        """So many steps."""
        time_s = self.time_s
        with np.errstate(all="ignore"):  # an unstable step is found by its result
            for _ in range(steps):
                time_s = self.stepper.step(self.system, time_s, self.step_s)
        self.time_s = time_s

    def tip_m(self) -> np.ndarray:
        """Origin of the end pad."""
        return self.rod.position_collection[:, 2 * self.n + 2].copy()

    def failed(self) -> bool:
        """An unstable rod shows in its tip."""
        return False


def _rod(arm: Arm, n: int, shear: float):
    length_m = arm.length_m / n
    lengths = np.concatenate(
        [[arm.pad_m], [length_m] * n, [arm.pad_m], [length_m] * n, [arm.gripper_com_m]]
    )
    z = arm.pad_m - np.concatenate([[0.0], np.cumsum(lengths)])
    position = np.zeros((3, len(z)))
    position[2] = z
    rod = elastica.CosseratRod.straight_rod(
        n_elements=len(lengths),
        start=position[:, 0],
        direction=np.array([0.0, 0.0, -1.0]),
        normal=np.array([1.0, 0.0, 0.0]),
        base_length=lengths.sum(),
        base_radius=arm.circle_m,
        density=1.0,
        youngs_modulus=1.0,
        shear_modulus=1.0,
        position=position,
    )
    # Every mass and stiffness is then the arm's own.
    soft = np.ones(len(lengths))
    soft[[0, n + 1, 2 * n + 2]] = PAD_STIFFNESS
    for i, factor in enumerate((shear, shear, 1.0)):
        rod.shear_matrix[i, i] = factor * arm.axial_n * soft
    # The hinge between two elements is as stiff as the segment's own length in it.
    own_m = np.full(len(lengths) - 1, length_m)
    own_m[[0, n, n + 1, 2 * n + 1]] = 0.5 * length_m
    for i, rigidity in enumerate((arm.bending_nm2, arm.bending_nm2, arm.torsion_nm2)):
        rod.bend_matrix[i, i] = rigidity * rod.rest_voronoi_lengths / own_m
    lump = arm.segment_kg / n
    rod.mass[:] = lump
    rod.mass[[1, n + 1, n + 2, 2 * n + 2]] = 0.5 * lump
    rod.mass[[n + 1, n + 2]] += 0.5 * arm.middle_pad_kg
    # The last element reaches to the gripper's centre of mass; the pad's mass is shared by lever.
    share = 0.5 * arm.pad_m / arm.gripper_com_m
    rod.mass[2 * n + 2] += (1 - share) * arm.end_pad_kg
    rod.mass[2 * n + 3] = share * arm.end_pad_kg + arm.gripper_kg
    about_axis = np.full(len(lengths), lump * arm.circle_m**2)
    about_axis[0] = 0.5 * arm.middle_pad_kg * arm.spring_circle_m**2
    about_axis[n + 1] = 0.5 * arm.middle_pad_kg * arm.spring_circle_m**2
    about_axis[-1] = 0.5 * arm.end_pad_kg * arm.spring_circle_m**2
    for i, factor in enumerate((0.5, 0.5, 1.0)):
        rod.mass_second_moment_of_inertia[i, i] = factor * about_axis
        rod.inv_mass_second_moment_of_inertia[i, i] = 1.0 / (factor * about_axis)
    return rod


class _Bellows(elastica.ConstraintBase):
    """Holds the rigidities against PyElastica's thinning: its rod keeps its volume, bellows do not."""

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        rod = self.system
        self.shear = np.array([rod.shear_matrix[i, i] for i in range(3)])
        self.bend = np.array([rod.bend_matrix[i, i] for i in range(3)])

    def constrain_values(self, system, time):
        _hold(
            self.shear,
            self.bend,
            system.position_collection,
            system.rest_lengths,
            system.rest_voronoi_lengths,
            system.shear_matrix,
            system.bend_matrix,
        )

    def constrain_rates(self, system, time):
        pass


class _Loads(elastica.NoForces):
    """Weight and the tension springs."""

    def __init__(self, arm: Arm, n: int):
        super().__init__()
        self.n = n
        turn = np.array([1.0, -1.0])  # from the base's axes to the rod's
        self.top = np.zeros((2, 6, 3))
        self.top[..., :2] = arm.spring_top_m
        self.top[1, :, :2] *= turn
        self.bottom = np.zeros((2, 6, 3))
        self.bottom[..., :2] = arm.spring_bottom_m * turn
        self.rate, self.free = arm.spring_rate_n_m, arm.spring_free_m

    def apply_forces(self, system, time=0.0):
        _weight(system.mass, system.external_forces)
        _springs(
            self.n,
            self.top,
            self.bottom,
            self.rate,
            self.free,
            system.position_collection,
            system.director_collection,
            system.external_forces,
            system.external_torques,
        )


@njit
def _weight(mass, forces):
    for k in range(mass.shape[0]):
        forces[2, k] -= GRAVITY_M_S2 * mass[k]


@njit
def _hold(shear0, bend0, position, rest, hinge_rest, shear, bend):
    # PyElastica divides by e against stretch and shear, by e³ against bending and twist.
    before = 0.0
    for k in range(rest.shape[0]):
        x = position[0, k + 1] - position[0, k]
        y = position[1, k + 1] - position[1, k]
        z = position[2, k + 1] - position[2, k]
        length = np.sqrt(x * x + y * y + z * z)
        for i in range(3):
            shear[i, i, k] = shear0[i, k] * length / rest[k]
        if k > 0:
            hinge = 0.5 * (before + length) / hinge_rest[k - 1]
            for i in range(3):
                bend[i, i, k - 1] = bend0[i, k - 1] * hinge**3
        before = length


@njit
def _springs(n, top, bottom, rate, free, position, director, forces, torques):
    a, b, d = np.zeros(3), np.zeros(3), np.zeros(3)
    for s in range(2):
        # Base or middle pad above, middle or end pad below: node of the origin, element of the axes.
        above_node, above = (1, 0) if s == 0 else (n + 2, n + 1)
        below_node, below = (n + 1, n + 1) if s == 0 else (2 * n + 2, 2 * n + 2)
        for i in range(6):
            for c in range(3):
                a[c], b[c] = top[s, i, c], 0.0
                if s == 1:
                    a[c] = 0.0
                    for m in range(3):
                        a[c] += director[m, c, above] * top[s, i, m]
                    a[c] += position[c, above_node]
                for m in range(3):
                    b[c] += director[m, c, below] * bottom[s, i, m]
                b[c] += position[c, below_node]
                d[c] = b[c] - a[c]
            length = np.sqrt(d[0] ** 2 + d[1] ** 2 + d[2] ** 2)
            if length <= free:
                continue
            pull = rate * (length - free) / length
            for c in range(3):
                forces[c, below_node] -= pull * d[c]
                if s == 1:
                    forces[c, above_node] += pull * d[c]
            _torque(bottom[s, i], -pull, d, below, director, torques)
            if s == 1:
                _torque(top[s, i], pull, d, above, director, torques)


@njit
def _torque(arm, factor, d, element, director, torques):
    # r × Q f in the element's own axes
    f = np.zeros(3)
    for c in range(3):
        for m in range(3):
            f[c] += factor * director[c, m, element] * d[m]
    torques[0, element] += arm[1] * f[2] - arm[2] * f[1]
    torques[1, element] += arm[2] * f[0] - arm[0] * f[2]
    torques[2, element] += arm[0] * f[1] - arm[1] * f[0]
