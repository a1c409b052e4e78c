"""A twin with the product's controllers on a virtual rig."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from . import _springtwin
from ._rig import _Choice
from ._robot import Array, Path, Robot, _numbers


@dataclass(frozen=True)
class Motion:
    """A motion, a row per tick of 10 ms from the moment it was given. Errors are of the true tip, which the twin never sees."""

    t_s: Array
    """(n,)"""
    truth: Array
    """(n, 7): where the tip truly was, base from tip."""
    estimate: Array
    """(n, 7): the twin's estimate of it; NaN before there is one."""
    goal_m: Array
    """(n, 3): where the tip should be now; NaN without a goal."""
    set_pa: Array
    """(n, 6): set gauge pressures; NaN before a command."""
    chamber_pa: Array
    """(n, 6): measured gauge pressures."""
    signals: Array
    """(n, 24): twelve springs in m, then four times yaw, pitch, roll in rad."""
    measures: dict[str, Any] = field(repr=False)
    """What ``springtwin goto --json`` or ``follow --json`` prints of it, by the same names."""

    @property
    def reached(self) -> bool:
        """Whether the plan was carried out in time."""
        return bool(self.measures.get("reached", True))

    @property
    def mean_mm(self) -> float:
        """True distance from the goal over the last second, or from the waypoints of a path: mean, mm."""
        return float(self.measures["mean_mm"])


@dataclass(frozen=True)
class Reach:
    """Whether a position can be reached."""

    state: Literal["reachable", "marginal", "unreachable", "outside-data"]
    distance_m: float
    """How short of it the arm stays, m."""
    nearest_m: Array
    """(3,): the nearest point with pressure to spare."""
    chamber_pa: Array
    """(6,): the pressures there."""
    limiting_chamber: tuple[int, float] | None
    """The chamber (from 1) that is at its bound, and that pressure, Pa."""


class Twin:
    """A twin on a virtual rig in this process: the wire protocol, the checks and the controllers of the program.

    It stays on its rig from one motion to the next; time is simulated and passes only while a motion is carried out.

    Parameters
    ----------
    robot
        The robot; the reference robot without one.
    controller
        ``"null-space-qp"`` (the program's own), or ``"paper-adrc"``.
    unit, hide, payload_kg, stiffness, seed
        The rig, as for :class:`springtwin.Rig`. The payload is declared to the twin, the rest is not.
    networks
        File of networks; the shipped ones of such a rig without it.
    """

    def __init__(
        self,
        robot: Robot | None = None,
        *,
        controller: Literal["null-space-qp", "paper-adrc"] = "null-space-qp",
        unit: int = 1,
        hide: Sequence[str] = (),
        payload_kg: float = 0.0,
        stiffness: float = 1.0,
        seed: int = 1,
        networks: Path | None = None,
    ) -> None:
        if controller not in ("null-space-qp", "paper-adrc"):
            raise _springtwin.Error(
                f"there is no controller '{controller}': give 'null-space-qp' or 'paper-adrc'"
            )
        self.robot = Robot() if robot is None else robot
        choice = _Choice(unit, list(hide), payload_kg, stiffness)
        file = None if networks is None else os.fspath(networks)
        self._twin = _springtwin.Twin(self.robot._robot, choice, seed, controller == "paper-adrc", file)

    @property
    def mode(self) -> str:
        """What the twin does: ``disarmed``, ``hold``, ``moving``, ``at goal``, or ``SAFE:`` with the reason."""
        return self._twin.mode

    @property
    def t_s(self) -> float:
        """Simulated time since the twin was made, s."""
        return self._twin.t_s

    def reach(self, position_m: ArrayLike, direction: ArrayLike | None = None) -> Reach:
        """Whether the tip can be sent to a position (m, base frame). Nothing moves."""
        found = json.loads(self._twin.reach(_three(position_m, "position_m"), _maybe(direction)))
        chamber = found["limiting_chamber"]
        return Reach(
            found["state"],
            found["distance_m"],
            np.array(found["nearest_m"]),
            np.array(found["chamber_pa"]),
            None if chamber is None else (chamber["chamber"], chamber["pa"]),
        )

    def goto(
        self, position_m: ArrayLike, direction: ArrayLike | None = None, *, seconds: float = 60.0
    ) -> Motion:
        """Moves the tip to a position (m, base frame), for at most so many simulated seconds.

        ``direction`` is where the gripper shall point in the base frame; ``[0, 0, -1]`` is straight down. An unreachable goal is
        refused with an :class:`Error`. The first motion of a twin equals ``springtwin goto``.
        """
        target = _three(position_m, "position_m")
        rows, measures = self._twin.goto(target, _maybe(direction), seconds)
        return Motion(**rows, measures=json.loads(measures))

    def follow(
        self,
        path: Literal["circle", "eight"] | ArrayLike = "circle",
        *,
        centre_m: ArrayLike | None = None,
        size_m: float | None = None,
        speed_m_s: float = 3e-3,
        laps: int = 1,
    ) -> Motion:
        """Follows a closed path: ``"circle"`` or ``"eight"`` about ``centre_m``, or waypoints (n, 3) in the base frame, m.

        ``size_m`` is the radius of the circle or half the length of the 8. Equals ``springtwin follow`` as the first motion.
        """
        shape = path if isinstance(path, str) else None
        own = None if isinstance(path, str) else _numbers(path, "path")
        if own is not None and own.ndim != 2:
            raise _springtwin.Error(f"a path of {own.ndim} axes: give waypoints as (n, 3)")
        centre = None if centre_m is None else _three(centre_m, "centre_m")
        rows, measures = self._twin.follow(shape, own, centre, size_m, speed_m_s, laps)
        return Motion(**rows, measures=json.loads(measures))


def _three(values: ArrayLike, name: str) -> tuple[float, float, float]:
    numbers = _numbers(values, name)
    if numbers.shape != (3,):
        raise _springtwin.Error(f"{name} has shape {numbers.shape}: give three numbers")
    return float(numbers[0]), float(numbers[1]), float(numbers[2])


def _maybe(direction: ArrayLike | None) -> tuple[float, float, float] | None:
    return None if direction is None else _three(direction, "direction")
