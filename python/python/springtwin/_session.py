"""Sessions: from files, from data frames, simulated; and poses estimated from them."""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path as FilePath
from typing import Any, Literal, Protocol

from . import _springtwin
from ._robot import Array, Path, Robot


class DataFrame(Protocol):
    """A pandas or polars data frame with the columns of a session log (``t_s``, ``p1_kpa``, ``spring1_mm``, ...)."""

    @property
    def columns(self) -> Any:
        """Names of the columns."""
        ...


SessionLike = str | os.PathLike[str] | DataFrame
"""A session: a folder, a ``session.toml``, a ``.csv`` file, a recording (``F.rrd``, or a part of it ``F.rrd@60..120``), or a
data frame with the columns of a session log."""


@dataclass(frozen=True)
class Session:
    """A session log in SI units, a row per sample; NaN where something is missing."""

    name: str
    rate_hz: float
    robot_hash: str
    """Hash of the robot file that it was recorded with; empty when unknown."""
    t_s: Array
    """(n,)"""
    chamber_pa: Array
    """(n, 6): measured gauge pressures."""
    commanded_pa: Array | None
    """(n, 6): commanded gauge pressures; ``None`` if they were not logged."""
    springs_m: Array
    """(n, 12)"""
    imus_ypr_rad: Array
    """(n, 4, 3): base from pad."""
    captured: Array
    """(n, 7): motion capture's pose of the end pad, base from tip."""
    payload_kg: Array
    """(n,): what the operator declared."""


@dataclass(frozen=True)
class Comparison:
    """Estimates against motion capture, as ``springtwin estimate`` prints it."""

    n: int
    mean_mm: float
    rmse_mm: float
    p95_mm: float
    max_mm: float
    yaw_deg: float
    pitch_deg: float
    roll_deg: float
    coverage_68: float
    """Share of the position's coordinates within one predicted standard deviation."""
    coverage_95: float
    """The same within 1.96."""


@dataclass(frozen=True)
class Estimates:
    """Poses estimated from springs and IMUs, a row per sample whose sensors are all there."""

    name: str
    t_s: Array
    """(n,)"""
    poses: Array
    """(n, 7): base from tip."""
    sd: Array
    """(n, 6): predicted standard deviations of x, y, z (m), then of yaw, pitch, roll (rad)."""
    residual: Array
    """(n, 6): estimated less captured: position (m), then the rotation vector (rad); NaN without motion capture."""
    comparison: Comparison | None
    """``None`` without motion capture."""
    left_out: int
    """Rows with gaps."""
    differences: list[str]
    """In what the networks differ from those of the recording."""


def read_session(session: SessionLike) -> Session:
    """Reads a session."""
    with _paths([session]) as [path]:
        return Session(**_springtwin.read_session(path))


def simulate_session(
    out: Path,
    robot: Robot | None = None,
    *,
    seconds: float = 90.0,
    rate_hz: float = 50.0,
    seed: int = 1,
    unit: int = 1,
    excitation: Literal[
        "mixed", "holds", "steps", "loads", "reversals", "sines", "single", "axial", "still"
    ] = "mixed",
    payload_kg: float = 0.0,
    hide: Sequence[str] = (),
    overwrite: bool = False,
) -> int:
    """A session of the virtual rig in the folder ``out``, as ``springtwin rig session`` writes it; simulated.

    Returns the number of samples. ``hide`` is as for :class:`springtwin.Rig`.
    """
    rig = (Robot() if robot is None else robot)._robot
    return _springtwin.simulate_session(
        rig, os.fspath(out), seconds, rate_hz, seed, unit, excitation, payload_kg, list(hide), overwrite
    )


def estimate(
    session: SessionLike,
    robot: Robot | None = None,
    *,
    networks: Path | None = None,
    any_robot: bool = False,
) -> Estimates:
    """Poses from springs and IMUs of a session by the networks, as ``springtwin estimate`` computes them.

    ``any_robot`` estimates all the same where session, networks and robot file are of different robots.
    """
    file = None if networks is None else os.fspath(networks)
    rig = (Robot() if robot is None else robot)._robot
    with _paths([session]) as [path]:
        found = dict(_springtwin.estimate(rig, path, file, any_robot))
    comparison = found.pop("comparison")
    return Estimates(**found, comparison=None if comparison is None else Comparison(**json.loads(comparison)))


@dataclass(frozen=True)
class Replay:
    """A session through the model of a robot, with its patches."""

    pos_mm: float | None
    """Root mean square of the position's residual, mm; ``None`` without motion capture."""
    ori_deg: float | None
    springs_mm: float | None
    imu_deg: float | None
    columns: dict[str, Array]
    """A row per sample: ``t_s``, the simulated pose and sensors, and residuals (measured less simulated), in mm and degrees."""


def replay(session: SessionLike, robot: Robot | None = None) -> Replay:
    """Measured pressures of a session through the model, against what was measured, as ``springtwin sim replay`` does it."""
    rig = (Robot() if robot is None else robot)._robot
    with _paths([session]) as [path]:
        columns, rmse = _springtwin.replay(rig, path)
    return Replay(**json.loads(rmse), columns=columns)


@contextmanager
def _paths(sessions: Sequence[SessionLike]) -> Iterator[list[str]]:
    """Files of the sessions; a data frame is written to a folder that is removed afterwards."""
    with ExitStack() as stack:
        out = []
        for session in sessions:
            if isinstance(session, (str, os.PathLike)):
                out.append(os.fspath(session))
            else:
                folder = stack.enter_context(tempfile.TemporaryDirectory(prefix="springtwin-"))
                out.append(str(_write(session, FilePath(folder))))
        yield out


def _write(frame: DataFrame, folder: FilePath) -> FilePath:
    """Writes a data frame as the table of a session; numbers keep all their digits."""
    file = folder / "frame.csv"
    if not hasattr(frame, "columns") or "t_s" not in list(frame.columns):
        raise _springtwin.Error(
            f"a {type(frame).__name__} is no session: give a path, or a data frame with the columns of a session log (t_s, p1_kpa, ...)"
        )
    if hasattr(frame, "write_csv"):
        frame.write_csv(file)
    elif hasattr(frame, "to_csv"):
        frame.to_csv(file, index=False)
    else:
        raise _springtwin.Error(f"a {type(frame).__name__} cannot be written as CSV: give a pandas or polars data frame")
    return file
