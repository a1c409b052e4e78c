"""10,000 poses at rest: `Robot.solve`, the command once per pose, its table, and MuJoCo's Python loop; simulated.

    python python/benches/solve.py [--poses 10000] [--starts 200] [--mujoco 20] [--program target/release/springtwin] [--json]

The command is started for `--starts` of the poses and MuJoCo settles `--mujoco` of them; both are scaled to all poses, as the output
states. The arm in MuJoCo is that of `benches/peers` with its settings, until the tip moves by less than 0.1 mm between looks;
without the package it is left out.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from functools import partial
from pathlib import Path

import numpy as np
import springtwin

ROOT = Path(__file__).resolve().parents[2]


def main() -> None:
    """Measures and prints the table."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--poses", type=int, default=10_000)
    options.add_argument("--starts", type=int, default=200)
    options.add_argument("--mujoco", type=int, default=20)
    options.add_argument("--program", type=Path, default=ROOT / "target" / "release" / "springtwin")
    options.add_argument("--json", action="store_true", help="seconds of each way by its name")
    a = options.parse_args()

    robot = springtwin.Robot()
    pressures = robot.sample(a.poses, seed=1)
    robot.solve(pressures[:64])
    ours = min(seconds(lambda: robot.solve(pressures)) for _ in range(3))
    one = min(seconds(lambda: [robot.solve(p) for p in pressures[:500]]) for _ in range(3)) / 500 * a.poses
    rows = [("Robot.solve, all at once", ours, "measured, best of 3"), ("Robot.solve, pose by pose", one, "500 poses, scaled")]

    if a.program.is_file():
        some = pressures[: a.starts]
        rows.append(("the command, once per pose", seconds(lambda: commands(a.program, some)) / len(some) * a.poses, f"{len(some)} starts, scaled"))
        rows.append(("sim solve --batch, one start", table(a.program, pressures), "measured"))
    else:
        why = f"left out: the command, because {a.program} is not there (cargo build --release, or --program)"
        print(why, file=sys.stderr)
    rows += mujoco(pressures[: a.mujoco], a.poses)

    if a.json:
        json.dump({name: time_s for name, time_s, _ in rows}, sys.stdout)
        return
    print(f"{a.poses} poses at rest on {os.cpu_count()} cores, springtwin {springtwin.__version__} (simulated)")
    for name, time_s, how in rows:
        print(f"  {name:32} {time_s:10.3f} s {1e6 * time_s / a.poses:10.1f} us a pose {time_s / ours:9.1f} x   ({how})")


def seconds(work) -> float:  # type: ignore[no-untyped-def]
    """Wall time of a call."""
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def words(p: np.ndarray) -> str:
    """Pressures in kPa as the command takes them."""
    return "--pressures=" + ",".join(f"{x:.6f}" for x in p / 1e3)


def commands(program: Path, pressures: np.ndarray) -> None:
    """Starts the command for every pose."""
    for p in pressures:
        subprocess.run([program, "--json", "sim", "solve", words(p)], check=True, capture_output=True)


def table(program: Path, pressures: np.ndarray) -> float:
    """Wall time of one start for a table of all poses."""
    with tempfile.TemporaryDirectory() as folder:
        cases, out = Path(folder) / "cases.csv", Path(folder) / "out.csv"
        header = ",".join(f"p{i}_kpa" for i in range(1, 7))
        np.savetxt(cases, pressures / 1e3, delimiter=",", header=header, comments="")
        run = [program, "sim", "solve", "--batch", cases, "--out", out]
        return seconds(lambda: subprocess.run(run, check=True, capture_output=True))


# The settings of benches/peers/statics.py: MuJoCo's usual step, and steps and damping so large that each is one of a Newton method.
MUJOCO = {"2 ms": {"step_s": 0.002, "damping_s": 0.07}, "1 s": {"step_s": 1.0, "damping_s": 1.0}}
STILL_M = 1e-4
"""At rest: the tip moves by less than this between two looks."""


def mujoco(pressures: np.ndarray, poses: int) -> list[tuple[str, float, str]]:
    """Times of MuJoCo, pose by pose in a Python loop."""
    sys.path.insert(0, str(ROOT / "benches" / "peers"))
    try:
        import arm
        from mujoco_arm import Simulation
    except ImportError as e:
        print(f"left out: MuJoCo, because {e.name} is not installed", file=sys.stderr)
        return []
    robot = arm.read(ROOT / "assets" / "robots" / "reference.toml")
    rows = []
    for name, settings in MUJOCO.items():
        simulation = Simulation(robot, 6, **settings)
        chunk = max(1, round(0.1 / settings["step_s"]))

        time_s = seconds(partial(settle_all, simulation, pressures / 1e3, chunk))
        rows.append((f"MuJoCo, {name} steps", time_s / len(pressures) * poses, f"{len(pressures)} poses, scaled"))
    return rows


def settle_all(simulation, poses_kpa: np.ndarray, chunk: int) -> None:  # type: ignore[no-untyped-def]
    """Lets MuJoCo come to rest in every pose; it looks at the tip after so many steps."""
    for p in poses_kpa:
        simulation.start(p)
        before = np.full(3, np.inf)
        for _ in range(60):
            simulation.run(chunk)
            now = simulation.tip_m()
            if np.linalg.norm(now - before) < STILL_M:
                break
            before = now


if __name__ == "__main__":
    main()
