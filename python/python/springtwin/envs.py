"""Environments for gymnasium: ``springtwin/Reach-v0`` and ``springtwin/Track-v0``, on the virtual rig; simulated.

    import gymnasium, springtwin

    env = gymnasium.make("springtwin/Reach-v0")

An action moves the six set pressures, each by at most what the robot's rate permits in one step of the environment. An
observation holds what a real arm delivers (24 signals and six measured pressures), the set pressures and the target; where the
tip truly is does not belong to it. The reward is the true distance from the target, which a real arm knows with motion capture
only; it is in ``info``, too.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from ._rig import Frame, Rig
from ._robot import Array, Robot

Observation = dict[str, Any]
Action = NDArray[np.float32]

STEPS = 10
"""Steps of the rig (10 ms) in one step of an environment."""

REWARD_MM = 10.0
"""The reward is minus the distance in units of so many millimetres."""


def register() -> None:
    """Registers the environments; once is enough."""
    for name, entry, steps in [("Reach", "ReachEnv", 150), ("Track", "TrackEnv", 300)]:
        id = f"springtwin/{name}-v0"
        if id not in gymnasium.registry:
            gymnasium.register(id, entry_point=f"springtwin.envs:{entry}", max_episode_steps=steps)


class _RigEnv(gymnasium.Env[Observation, Action]):
    """What both environments have: the rig, its spaces, and the reward."""

    metadata = {"render_modes": []}
    """Nothing is drawn: take the observations, or ``info["true_position_m"]``."""

    def __init__(
        self,
        robot: Robot | None = None,
        *,
        unit: int = 1,
        hide: Sequence[str] = (),
        payload_kg: float = 0.0,
        stiffness: float = 1.0,
        rings: int | None = 4,
    ) -> None:
        self.robot = Robot() if robot is None else robot
        self.rig = Rig(
            self.robot, unit=unit, hide=hide, payload_kg=payload_kg, stiffness=stiffness, rings=rings
        )
        self._payload_kg = payload_kg
        low, high = self.robot.pressure_range_pa
        self._low_pa, self._high_pa = low, high
        self._step_pa = self.robot.pressure_rate_pa_s * STEPS * self.rig.dt_s
        self._set_pa: Array = np.zeros(6)
        self._target_m: Array = np.zeros(3)
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (6,), np.float32)
        self._spaces: dict[str, gymnasium.spaces.Box] = {
            "springs_m": gymnasium.spaces.Box(0.0, 1.0, (12,), np.float32),
            "imus_ypr_rad": gymnasium.spaces.Box(-np.pi, np.pi, (12,), np.float32),
            "pressures_pa": _pressures(2 * low, 2 * high),
            "set_pa": _pressures(low, high),
            "target_m": gymnasium.spaces.Box(-1.0, 1.0, (3,), np.float32),
            **self._more_spaces(),
        }
        self.observation_space: gymnasium.spaces.Space[Observation] = gymnasium.spaces.Dict(dict(self._spaces))

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """A new arm at rest at 0 Pa and a new target. The seed determines both, and all noise."""
        super().reset(seed=seed)
        frame = self.rig.reset(int(self.np_random.integers(1 << 32)))
        self._set_pa = np.zeros(6)
        self._begin(options or {})
        return self._observation(frame), self._info(frame)

    def step(self, action: Action) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Moves the set pressures by ``action`` (-1 to 1: of the fastest change) and lets 0.1 s pass."""
        wanted = self._set_pa + self._step_pa * np.clip(np.asarray(action, dtype=np.float64), -1.0, 1.0)
        self._set_pa = np.clip(wanted, self._low_pa, self._high_pa)
        frame = self.rig.step(self._set_pa, STEPS)
        self._advance()
        info = self._info(frame)
        reward = -float(info["distance_m"]) * 1e3 / REWARD_MM
        return self._observation(frame), reward, False, False, info

    def _observation(self, frame: Frame) -> Observation:
        parts: dict[str, Array] = {
            "springs_m": frame.sensors.springs_m,
            "imus_ypr_rad": frame.sensors.imus_ypr_rad.ravel(),
            "pressures_pa": frame.raw.chamber_pa,
            "set_pa": self._set_pa,
            "target_m": self._target_m,
            **self._more_observed(),
        }
        return {name: self._within(name, values) for name, values in parts.items()}

    def _within(self, name: str, values: Array) -> NDArray[np.float32]:
        """Values as the space of that name has them."""
        space = self._spaces[name]
        return np.clip(values.astype(np.float32), space.low, space.high)

    def _info(self, frame: Frame) -> dict[str, Any]:
        distance = float(np.linalg.norm(frame.truth.position_m - self._target_m))
        return {"distance_m": distance, "true_position_m": frame.truth.position_m, "t_s": frame.raw.t_s}

    def _reachable_m(self) -> Array:
        """A place that the arm reaches: where the model is at rest under pressures drawn from the middle of their range."""
        middle = 0.5 * (self._low_pa + self._high_pa)
        half = 0.35 * (self._high_pa - self._low_pa)
        pressures = middle + half * self.np_random.uniform(-1.0, 1.0, 6)
        return np.asarray(self.robot.solve(pressures, self._payload_kg).position_m)

    def _begin(self, options: dict[str, Any]) -> None:
        """Sets the first target."""
        raise NotImplementedError

    def _advance(self) -> None:
        """Moves the target on."""

    def _more_spaces(self) -> dict[str, gymnasium.spaces.Box]:
        return {}

    def _more_observed(self) -> dict[str, Array]:
        return {}


class ReachEnv(_RigEnv):
    """Moves the tip to a place drawn among those that the arm reaches; ``options={"target_m": [x, y, z]}`` names one."""

    def _begin(self, options: dict[str, Any]) -> None:
        drawn = self._reachable_m()
        given = options.get("target_m")
        self._target_m = drawn if given is None else np.asarray(given, dtype=np.float64)


class TrackEnv(_RigEnv):
    """Follows a point on a level circle about a place on the arm's axis: radius, height, sense and start are drawn.

    The observation holds the point's velocity, too (``velocity_m_s``). ``speed_m_s`` is its speed.
    """

    def __init__(self, robot: Robot | None = None, *, speed_m_s: float = 5e-3, **options: Any) -> None:
        self._speed_m_s = speed_m_s
        self._radius_m, self._height_m, self._rate_rad_s, self._angle_rad = 0.05, -0.31, 0.0, 0.0
        super().__init__(robot, **options)

    def _begin(self, options: dict[str, Any]) -> None:
        self._radius_m = float(self.np_random.uniform(0.03, 0.06))
        self._height_m = float(self.np_random.uniform(-0.32, -0.30))
        self._angle_rad = float(self.np_random.uniform(0.0, 2 * np.pi))
        sense = 1.0 if self.np_random.integers(2) else -1.0
        self._rate_rad_s = sense * self._speed_m_s / self._radius_m
        self._place()

    def _advance(self) -> None:
        self._angle_rad += self._rate_rad_s * STEPS * self.rig.dt_s
        self._place()

    def _place(self) -> None:
        x, y = self._radius_m * np.cos(self._angle_rad), self._radius_m * np.sin(self._angle_rad)
        self._target_m = np.array([x, y, self._height_m])

    def _velocity_m_s(self) -> Array:
        along = np.array([-np.sin(self._angle_rad), np.cos(self._angle_rad), 0.0])
        return np.asarray(self._radius_m * self._rate_rad_s * along)

    def _more_spaces(self) -> dict[str, gymnasium.spaces.Box]:
        return {"velocity_m_s": gymnasium.spaces.Box(-1.0, 1.0, (3,), np.float32)}

    def _more_observed(self) -> dict[str, Array]:
        return {"velocity_m_s": self._velocity_m_s()}


def _pressures(low_pa: float, high_pa: float) -> gymnasium.spaces.Box:
    return gymnasium.spaces.Box(low_pa, high_pa, (6,), np.float32)
