"""What mypy holds against the stubs: a use of every part of the package."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import springtwin
from springtwin import gap, patch

robot: springtwin.Robot = springtwin.Robot(Path("robot.toml"))
pressures: NDArray[np.float64] = robot.sample(10, seed=1)
poses, springs, imus = robot.solve(pressures, payload_kg=0.1, force_n=[0.0, 0.0, -1.0])
first: NDArray[np.float64] = poses[0]
there: NDArray[np.bool_] = robot.solve([[0] * 6], unsolved="nan").solved
tip: NDArray[np.float64] = robot.jacobian(np.zeros(6)).tip

frame: springtwin.Frame = springtwin.Rig(robot, unit=1, hide=["payload=0.2"]).step(np.zeros(6), 10)
counts: NDArray[np.uint32] = frame.raw.spring_counts
position: NDArray[np.float64] = frame.truth.position_m

motion: springtwin.Motion = springtwin.Twin(robot, controller="paper-adrc").goto([0.06, 0.04, -0.3])
reached: bool = motion.reached

found: gap.Finding = gap.find(["healthy", Path("healthy2")], "suspect", robot, table=["payload"])
names: list[str] = [effect.id for effect in found.effects]
low: float | None = None if found.onset is None else found.onset.ci95[0]
laws: list[gap.FoundLaw] = gap.discover(gap.commission("healthy"), "suspect").laws
patched: springtwin.Robot = patch.apply(found, robot, out="patched.toml").robot
again: springtwin.Robot = robot.patched("patch.toml").patched(found)
error: float | None = springtwin.replay("suspect", patched).pos_mm
comparison: springtwin.Comparison | None = springtwin.estimate("suspect").comparison
