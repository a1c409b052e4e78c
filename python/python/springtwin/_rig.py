"""The virtual rig, step by step."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _springtwin
from ._robot import Array, Robot, _numbers


@dataclass(frozen=True)
class Raw:
    """What the boards deliver, before any calibration."""

    t_s: float
    """Time of the rig, s; it has rested for 2 s when it is handed over."""
    set_pa: Array
    """(6,): set gauge pressures, within the robot's range and rate of change."""
    chamber_pa: Array
    """(6,): measured gauge pressures."""
    spring_counts: NDArray[np.uint32]
    """(12,): oscillator periods counted within its gate, per spring."""
    spring_gate_ticks: NDArray[np.uint32]
    """(12,): length of each gate in ticks of its board's clock."""
    tick_rate_hz: Array
    """(2,): ticks per second of each board's clock."""
    gyro_rad_s: Array
    """(4, 3): angular rates in the IMUs' own axes."""
    accel_m_s2: Array
    """(4, 3): specific forces in the IMUs' own axes."""

    @property
    def spring_hz(self) -> Array:
        """(12,): frequency of each spring's circuit."""
        rate = np.repeat(self.tick_rate_hz, 6)
        return np.asarray(self.spring_counts * rate / self.spring_gate_ticks)


@dataclass(frozen=True)
class Sensors:
    """The 24 signals, by the unit's calibration and the orientation filters."""

    springs_m: Array
    """(12,): lengths. A channel that is not read is reconstructed from the others."""
    imus_ypr_rad: Array
    """(4, 3): yaw, pitch, roll of the pad under each IMU, base from pad."""
    read: NDArray[np.bool_]
    """(16,): whether each spring and then each IMU was read; false where its signal is reconstructed or held."""
    extra_sigma: Array
    """(24,): standard deviation of each signal beyond its usual noise, m and rad."""

    @property
    def signals(self) -> Array:
        """(24,): twelve lengths in m, then four times yaw, pitch, roll in rad."""
        return np.concatenate([self.springs_m, self.imus_ypr_rad.ravel()])


@dataclass(frozen=True)
class Truth:
    """Where the arm truly is: nothing that a real arm could read."""

    pads: Array
    """(3, 7): top, middle and end pad, position in m and quaternion w, x, y, z, base from pad."""
    springs_m: Array
    """(12,): distance between the ends of each spring."""
    bellows_m: Array
    """(6,): length of each bellows."""

    @property
    def pose(self) -> Array:
        """(7,): the tip, base from tip."""
        return self.pads[2, :]

    @property
    def position_m(self) -> Array:
        """(3,): the tip in the base frame."""
        return self.pads[2, :3]


@dataclass(frozen=True)
class Frame:
    """A step of a rig. ``raw`` and ``sensors`` are what a real arm delivers; ``truth`` is apart, for scores and rewards."""

    raw: Raw
    sensors: Sensors
    truth: Truth

    @property
    def observation(self) -> Array:
        """(30,): the 24 signals and six measured pressures (Pa), without any truth."""
        return np.concatenate([self.sensors.signals, self.raw.chamber_pa])


@dataclass(frozen=True)
class Hideable:
    """Something that can be hidden in a rig."""

    id: str
    known: bool
    """Whether the gap finder's table has it."""
    doc: str
    parameters: list[dict[str, object]]
    """Name, unit, value without the effect, bounds and usual range of each parameter."""


def hidden_effects() -> list[Hideable]:
    """What can be hidden in a rig, as ``springtwin rig effects`` lists it."""
    rows = json.loads(_springtwin.hidden_effects())
    return [Hideable(r["id"], r["class"] == "known", r["doc"], r["parameters"]) for r in rows]


@dataclass(frozen=True)
class _Choice:
    """Options of a rig as the extension reads them."""

    unit: int
    hide: list[str]
    payload_kg: float
    stiffness: float


class Rig:
    """A virtual rig without boards and serial line, 100 steps per second: rigid rings with mass, air, creeping rubber.

    It shares no physics with :meth:`Robot.solve`. All of it is simulated.

    Parameters
    ----------
    robot
        The robot; the reference robot without one.
    unit
        Which manufactured arm. Another one than 1 is calibrated on its own bench first, which takes some seconds.
    hide
        Effects that are hidden in it, each as ``ID[:TARGET][=VALUE,..][@SECONDS]``; see :func:`hidden_effects`.
    payload_kg, stiffness
        Mass in the gripper, and stiffness as a factor on the arm's own.
    seed
        Seed of all noise: the same seed and the same pressures give the same frames.
    rings
        Rings per segment; fewer are faster and coarser. ``None``: those of the shipped rig.
    """

    def __init__(
        self,
        robot: Robot | None = None,
        *,
        unit: int = 1,
        hide: Sequence[str] = (),
        payload_kg: float = 0.0,
        stiffness: float = 1.0,
        seed: int = 1,
        rings: int | None = None,
    ) -> None:
        self.robot = Robot() if robot is None else robot
        choice = _Choice(unit, list(hide), payload_kg, stiffness)
        self._rig = _springtwin.Rig(self.robot._robot, choice, seed, rings)

    dt_s: float = 0.01
    """Time of a step, s."""

    def reset(self, seed: int = 1) -> Frame:
        """A new arm of the same kind at rest at 0 Pa."""
        self._rig.reset(seed)
        return self.frame()

    def step(self, pressures_pa: ArrayLike, steps: int = 1) -> Frame:
        """Drives the chambers towards these gauge pressures (Pa) for some steps of 10 ms.

        Set pressures change no faster than :attr:`Robot.pressure_rate_pa_s`, and the chambers follow as their air flows.
        """
        if steps < 1:
            raise _springtwin.Error(f"{steps} steps: give 1 or more")
        self._rig.step(np.ascontiguousarray(_numbers(pressures_pa, "pressures_pa")), steps)
        return self.frame()

    def push(self, force_n: ArrayLike) -> None:
        """A force on the tip in the base frame (N) from the next step on, until another one is given."""
        x, y, z = _numbers(force_n, "force_n")
        self._rig.push((float(x), float(y), float(z)))

    def frame(self) -> Frame:
        """The newest frame again; no time passes."""
        return Frame(Raw(**self._rig.raw()), Sensors(**self._rig.sensors()), Truth(**self._rig.truth()))
