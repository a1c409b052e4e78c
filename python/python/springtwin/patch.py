"""Patches of a robot file: what was found missing, as a part of the model."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass

from . import _springtwin
from ._robot import HasPatch, Path, Robot

__all__ = ["Applied", "apply", "revert"]


@dataclass(frozen=True)
class Applied:
    """A robot with one more patch, and where the parts of the patch act."""

    robot: Robot
    arm: list[str]
    """In twin, data sets and replay."""
    sensors: list[str]
    """In the sensors of twin and replay."""
    replay_only: list[str]
    """In a replay alone: a settled arm does not show them."""


def apply(
    patch: Path | HasPatch,
    robot: Robot | None = None,
    *,
    out: Path | None = None,
    overwrite: bool = False,
) -> Applied:
    """Puts a patch on a robot, as ``springtwin gap apply`` does.

    Parameters
    ----------
    patch
        A patch file, or what :func:`springtwin.gap.find`, ``discover`` or ``commission`` gave.
    robot
        The robot; the reference robot without one.
    out
        Robot file to write; none without it.
    """
    rig = (Robot() if robot is None else robot)._robot
    file = os.fspath(patch) if isinstance(patch, (str, os.PathLike)) else None
    text = None if isinstance(patch, (str, os.PathLike)) else patch.patch_toml
    place = None if out is None else os.fspath(out)
    patched, acts = _springtwin.apply_patch(rig, file, text, place, overwrite)
    return Applied(Robot._of(patched), **json.loads(acts))


def revert(robot: Robot, *, out: Path | None = None, overwrite: bool = False) -> Robot:
    """The robot before its last patch, as ``springtwin gap apply --undo`` gives it."""
    place = None if out is None else os.fspath(out)
    return Robot._of(_springtwin.revert_patch(robot._robot, place, overwrite))
