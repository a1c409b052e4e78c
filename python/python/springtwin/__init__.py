"""springtwin: a digital twin of a two-segment pneumatic soft arm, from Python.

    import numpy as np
    import springtwin

    robot = springtwin.Robot()
    poses, springs, imus = robot.solve(robot.sample(1000, seed=1))

Units are SI and frames are those of the guide's page of conventions: the base's frame where none is named, chambers, springs
and IMUs in the order of their numbers, gauge pressures in Pa. A pose is seven numbers: x, y, z in m, then the unit
quaternion w, x, y, z (base from pad, w not negative). Everything that a rig or a model gives is simulated.

What the library refuses is :class:`Error`, with the library's sentence.
"""

from ._springtwin import Error, __version__
from . import gap, patch
from ._robot import HasPatch, Jacobian, Robot, Solved, ypr_rad
from ._rig import Frame, Hideable, Raw, Rig, Sensors, Truth, hidden_effects
from ._session import (
    Comparison,
    Estimates,
    Replay,
    Session,
    SessionLike,
    estimate,
    read_session,
    replay,
    simulate_session,
)
from ._twin import Motion, Reach, Twin

__all__ = [
    "Comparison",
    "Error",
    "Estimates",
    "Frame",
    "HasPatch",
    "Hideable",
    "Jacobian",
    "Motion",
    "Raw",
    "Reach",
    "Replay",
    "Rig",
    "Robot",
    "Sensors",
    "Session",
    "SessionLike",
    "Solved",
    "Truth",
    "Twin",
    "__version__",
    "estimate",
    "gap",
    "hidden_effects",
    "patch",
    "read_session",
    "replay",
    "simulate_session",
    "ypr_rad",
]


def _register() -> None:
    """Registers the environments, where gymnasium is installed."""
    import importlib.util

    if importlib.util.find_spec("gymnasium") is not None:
        from .envs import register

        register()


_register()
