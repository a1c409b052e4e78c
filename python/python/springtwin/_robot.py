"""A robot, and its model at rest."""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Literal, NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _springtwin

Array = NDArray[np.float64]
Path = str | os.PathLike[str]


class HasPatch(Protocol):
    """What a patch can be taken from."""

    @property
    def patch_toml(self) -> str:
        """The text of the patch."""
        ...


class Solved(NamedTuple):
    """The arm at rest. Arrays have a row per case, or none for a single case."""

    poses: Array
    """(n, 7): tip x, y, z in m and quaternion w, x, y, z, base from tip."""
    springs_m: Array
    """(n, 12): length of each spring."""
    imus_ypr_rad: Array
    """(n, 4, 3): yaw, pitch and roll of the pad under each IMU, base from pad."""

    @property
    def position_m(self) -> Array:
        """(n, 3): the tip in the base frame."""
        return self.poses[..., :3]

    @property
    def quaternion_wxyz(self) -> Array:
        """(n, 4): base from tip."""
        return self.poses[..., 3:]

    @property
    def solved(self) -> NDArray[np.bool_]:
        """(n,): whether there is an equilibrium (always, unless ``unsolved="nan"`` was asked for)."""
        return np.isfinite(self.poses[..., 0])


class Jacobian(NamedTuple):
    """Exact derivatives at rest. Columns: per Pa in chambers 1 to 6, per kg of payload, per N on the tip along x, y, z."""

    tip: Array
    """(n, 6, 10): x, y, z of the tip in m, then its rotation vector in rad, both in the base frame."""
    springs_m: Array
    """(n, 12, 10): lengths of the springs, of the geometry: sensor errors of a patch are not in it."""


def ypr_rad(quaternion_wxyz: ArrayLike) -> Array:
    """Yaw, pitch and roll (..., 3) of quaternions w, x, y, z (..., 4): R = Rz(yaw) Ry(pitch) Rx(roll)."""
    w, x, y, z = np.moveaxis(np.asarray(quaternion_wxyz, dtype=np.float64), -1, 0)
    yaw = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    pitch = np.arcsin(np.clip(2 * (w * y - x * z), -1, 1))
    roll = np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    return np.stack([yaw, pitch, roll], axis=-1)


class Robot:
    """A robot file and the model that it describes.

    Parameters
    ----------
    path
        Robot file (TOML); the reference robot without one. Patches in the file are part of the model.
    """

    def __init__(self, path: Path | None = None) -> None:
        self._robot = _springtwin.Robot(None if path is None else os.fspath(path))

    @classmethod
    def _of(cls, robot: _springtwin.Robot) -> Robot:
        out = cls.__new__(cls)
        out._robot = robot
        return out

    @classmethod
    def from_text(cls, text: str) -> Robot:
        """The robot of a robot file's text, patches included, as :attr:`text` has it."""
        return cls._of(_springtwin.Robot.of_text(text))

    def __reduce__(self) -> tuple[Callable[[str], Robot], tuple[str]]:
        """Other processes, and :mod:`copy`, take the robot as its text."""
        return Robot.from_text, (self.text,)

    def __repr__(self) -> str:
        patches = len(self.patches)
        return f"<springtwin.Robot '{self.name}'" + (f", {patches} patches>" if patches else ">")

    @property
    def name(self) -> str:
        """Name of the robot."""
        return self._robot.name

    @property
    def text(self) -> str:
        """The robot file with all patches."""
        return self._robot.text

    @property
    def hash(self) -> str:
        """SHA-256 of the robot file, as recordings state it."""
        return self._robot.hash

    @property
    def patches(self) -> list[str]:
        """Names of the patches, in order."""
        return self._robot.patches

    @property
    def pressure_range_pa(self) -> tuple[float, float]:
        """Lowest and highest gauge pressure, Pa."""
        return self._robot.pressure_range_pa

    @property
    def pressure_rate_pa_s(self) -> float:
        """Fastest change of a chamber's set pressure, Pa/s."""
        return self._robot.pressure_rate_pa_s

    @property
    def payload_max_kg(self) -> float:
        """Heaviest payload, kg."""
        return self._robot.payload_max_kg

    @property
    def tip_speed_max_m_s(self) -> float:
        """Fastest speed along a path, m/s."""
        return self._robot.tip_speed_max_m_s

    @property
    def rest_length_m(self) -> float:
        """Length of a bellows at 0 Pa without load, m."""
        return self._robot.rest_length_m

    @property
    def spring_range_m(self) -> tuple[float, float]:
        """Shortest and longest length at which a spring is used, m."""
        return self._robot.spring_range_m

    def save(self, path: Path, *, overwrite: bool = False) -> None:
        """Writes the robot file with all patches."""
        self._robot.save(os.fspath(path), overwrite)

    def patched(self, patch: Path | HasPatch) -> Robot:
        """The robot with one more patch: a patch file, or what :func:`springtwin.gap.find` or ``commission`` gave.

        The result equals ``springtwin gap apply``.
        """
        from . import patch as patches

        return patches.apply(patch, self).robot

    def solve(
        self,
        pressures_pa: ArrayLike,
        payload_kg: ArrayLike = 0.0,
        force_n: ArrayLike | None = None,
        *,
        simulator: Literal["rod", "mesh"] = "rod",
        unsolved: Literal["raise", "nan"] = "raise",
    ) -> Solved:
        """Settles the arm: every case for itself, on all cores, without the interpreter's lock.

        Parameters
        ----------
        pressures_pa
            (n, 6) gauge pressures of chambers 1 to 6, Pa; or (6,) for one case.
        payload_kg
            Mass in the gripper, kg: one, or (n,).
        force_n
            Force on the tip in the base frame, N: (3,) or (n, 3).
        simulator
            The rod model, or the mesh.
        unsolved
            ``"raise"``: a case without equilibrium is an :class:`Error` that names its row (from 0).
            ``"nan"``: its row is NaN, and :attr:`Solved.solved` is false there.

        Equals ``springtwin sim solve`` and its ``--batch``.
        """
        if simulator not in ("rod", "mesh"):
            raise _springtwin.Error(f"there is no simulator '{simulator}': give 'rod' or 'mesh'")
        if unsolved not in ("raise", "nan"):
            raise _springtwin.Error(f"unsolved='{unsolved}': give 'raise' or 'nan'")
        cases, single = _cases(pressures_pa, payload_kg, force_n)
        poses, springs, imus, failed = self._robot.solve(*cases, simulator == "mesh")
        if failed is not None and unsolved == "raise":
            row, why = failed
            raise _springtwin.Error(why if single else f"row {row}: {why}")
        return Solved(poses[0], springs[0], imus[0]) if single else Solved(poses, springs, imus)

    def jacobian(
        self, pressures_pa: ArrayLike, payload_kg: ArrayLike = 0.0, force_n: ArrayLike | None = None
    ) -> Jacobian:
        """Derivatives of tip and springs at rest by pressures, payload and force; arguments as for :meth:`solve`."""
        cases, single = _cases(pressures_pa, payload_kg, force_n)
        tip, springs = self._robot.jacobian(*cases)
        return Jacobian(tip[0], springs[0]) if single else Jacobian(tip, springs)

    def sample(self, n: int, seed: int = 1) -> Array:
        """(n, 6) gauge pressures, Pa, drawn evenly from the robot's range: those of ``dataset generate`` with that seed."""
        return self._robot.sample(n, seed)


def _cases(
    pressures_pa: ArrayLike, payload_kg: ArrayLike, force_n: ArrayLike | None
) -> tuple[tuple[Array, Array, Array], bool]:
    """Rows of pressures, payloads and forces, and whether there is a single case without a row of its own."""
    pressures = _numbers(pressures_pa, "pressures_pa")
    payload = _numbers(payload_kg, "payload_kg")
    force = _numbers([0.0, 0.0, 0.0] if force_n is None else force_n, "force_n")
    if pressures.ndim not in (1, 2) or payload.ndim > 1 or force.ndim not in (1, 2):
        raise _springtwin.Error(
            f"pressures_pa, payload_kg and force_n have {pressures.ndim}, {payload.ndim} and {force.ndim} axes: "
            "give (n, 6) or (6,), (n,) or one number, (n, 3) or (3,)"
        )
    single = pressures.ndim == 1 and payload.ndim == 0 and force.ndim == 1
    rows = max(
        pressures.shape[0] if pressures.ndim == 2 else 1,
        payload.shape[0] if payload.ndim == 1 else 1,
        force.shape[0] if force.ndim == 2 else 1,
    )
    if pressures.ndim == 2 and pressures.shape[0] == 0:
        rows = 0
    pressures = pressures if pressures.ndim == 2 else np.broadcast_to(pressures, (rows, *pressures.shape))
    payload = payload if payload.ndim == 1 else np.broadcast_to(payload, (rows,))
    force = force if force.ndim == 2 else np.broadcast_to(force, (rows, *force.shape))
    return (pressures, payload, force), single


def _numbers(values: ArrayLike, name: str) -> Array:
    try:
        return np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError) as e:
        raise _springtwin.Error(f"{name} is no array of numbers: {e}") from e
