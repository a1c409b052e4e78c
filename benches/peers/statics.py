#!/usr/bin/env python3
"""Times the same arm settling in springtwin, PyElastica and MuJoCo, side by side, in one run.

Everything here is simulated. README.md beside this file says what is compared and how.
"""

import argparse
import json
import os
import platform
import statistics
import sys
import tempfile
import time
from pathlib import Path

# One thread each, also for the libraries below.
for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ[variable] = "1"

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent.parent
sys.dont_write_bytecode = True

try:
    import numpy as np

    import arm as robot
    import elastica_arm
    import mujoco_arm
except ImportError as e:
    sys.exit(f"{e.name} is missing: run `pip install -r benches/peers/requirements.txt`")

from program import run, spread

# The poses of the robot's design page, kPa; more are drawn uniformly from the pressure range.
NAMED_KPA = [
    (0, 0, 0, 0, 0, 0),
    (40, 40, 40, 40, 40, 40),
    (40, -40, -40, 0, 0, 0),
    (20, -20, -20, 20, -20, -20),
]
ELEMENTS = 6  # per segment, the program's own
HORIZON_S = 3.0  # how long a pose gets to come to rest, simulated; at least 60 looks at the tip
WARM_UP = 20  # steps that compile and fill caches

# The fastest settling that `--tune` found stable at every pose; for MuJoCo also at its default step.
# With a step and damping of 1 s its motion means nothing any more: every step is one of a Newton
# method that takes the joints' stiffness for the whole.
ELASTICA = {"step_s": 4e-4, "damping_1_s": 35.0, "shear": 3.0}
MUJOCO_DEFAULT = {"step_s": 0.002, "damping_s": 0.07}
MUJOCO_RELAXED = {"step_s": 1.0, "damping_s": 1.0}


class Unstable(Exception):
    """The simulation blew up or did not come to rest."""


class Peer:
    """One way of settling the arm in somebody else's simulator."""

    def __init__(self, name: str, simulation, chunk: int):
        self.name, self.simulation, self.chunk = name, simulation, chunk
        self.steps, self.tips_m = {}, []

    def settle(self, poses_kpa, tolerances_m) -> None:
        """Untimed: the settled tip of every pose, and for every tolerance the step from which the
        tip stays that near to it."""
        self.steps = {t: [] for t in tolerances_m}
        self.tips_m = []
        s = self.simulation
        s.start(poses_kpa[0])
        s.run(WARM_UP)
        for pose in poses_kpa:
            s.start(pose)
            path_m = []
            for _ in range(max(60, round(HORIZON_S / s.step_s / self.chunk))):
                s.run(self.chunk)
                path_m.append(s.tip_m())
            path_m = np.array(path_m)
            if not np.isfinite(path_m).all() or np.abs(path_m).max() > 2.0 or s.failed():
                raise Unstable(f"{self.name} is unstable at {pose}")
            away_m = np.linalg.norm(path_m - path_m[-1], axis=1)
            for tolerance_m in tolerances_m:
                far = np.flatnonzero(away_m > tolerance_m)
                settled = far[-1] + 1 if len(far) else 0
                if settled > 0.8 * len(path_m):
                    raise Unstable(f"{self.name} does not come to rest at {pose}")
                self.steps[tolerance_m].append(int(settled + 1) * self.chunk)
            self.tips_m.append(path_m[-1])

    def seconds_per_pose(self, poses_kpa, tolerance_m: float) -> float:
        """Processor time of a settled pose, mean over the poses; no tests on the way."""
        total_s = 0.0
        for pose, steps, tip_m in zip(poses_kpa, self.steps[tolerance_m], self.tips_m):
            self.simulation.start(pose)
            start_s = time.process_time()
            self.simulation.run(steps)
            total_s += time.process_time() - start_s
            if np.linalg.norm(self.simulation.tip_m() - tip_m) > 1.1 * tolerance_m:
                raise Unstable(f"{self.name} did not repeat itself at {pose}")
        return total_s / len(poses_kpa)

    def seconds_per_simulated_second(self, pose_kpa) -> float:
        """Processor time of one second of motion."""
        self.simulation.start(pose_kpa)
        self.simulation.run(WARM_UP)
        start_s = time.process_time()
        self.simulation.run(round(1.0 / self.simulation.step_s))
        return time.process_time() - start_s


class Springtwin:
    """The program, through its own commands."""

    def __init__(self, path: Path, robot_file: Path):
        self.path, self.robot_file = path, robot_file
        self.version = self._run("--version", as_json=False).split()[-1]

    def _run(self, *args, as_json=True):
        if as_json:
            args += ("--robot", self.robot_file, "--json")
        out = run(self.path, *args, option="--springtwin")
        return json.loads(out) if as_json else out

    def solve(self, pose_kpa) -> dict:
        """One settled pose from a cold start."""
        pressures = ",".join(f"{p:.6f}" for p in pose_kpa)
        return self._run("sim", "solve", f"--pressures={pressures}")

    def seconds_per_pose(self, samples: int) -> float:
        """Processor time of a settled pose in a batch from rest, less that of a batch of one."""
        return (self._batch(samples) - self._batch(1)) / (samples - 1)

    def _batch(self, samples: int) -> float:
        with tempfile.TemporaryDirectory() as folder:
            out = str(Path(folder) / "poses.parquet")
            before = os.times()
            report = self._run("dataset", "generate", "--samples", str(samples), "--out", out)
            after = os.times()
        if report["samples"] != samples:
            sys.exit(f"the program settled {report['samples']} of {samples} poses")
        spent = lambda t: t.children_user + t.children_system
        return spent(after) - spent(before)


def elastica(arm, settings) -> Peer:
    name = f"PyElastica, {settings['step_s'] * 1e3:g} ms steps"
    return Peer(name, elastica_arm.Simulation(arm, ELEMENTS, **settings), chunk=5)


def mujoco(arm, settings) -> Peer:
    name = f"MuJoCo, {settings['step_s'] * 1e3:g} ms steps"
    return Peer(name, mujoco_arm.Simulation(arm, ELEMENTS, **settings), chunk=1)


def tune(arm, poses_kpa, tolerance_m: float) -> None:
    """Prints what each setting costs."""
    trials = [
        (elastica, {"step_s": h, "damping_1_s": d, "shear": ELASTICA["shear"]})
        for h in (2e-4, 4e-4, 4.5e-4, 5e-4)
        for d in (25.0, 30.0, 35.0, 40.0, 50.0)
    ] + [
        (mujoco, {"step_s": h, "damping_s": d})
        for h in (0.002, 0.01, 0.05, 0.1, 0.2, 0.5, 1.0)
        for d in (0.05, 0.07, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.7, 1.0)
        if 0.5 * h <= d <= 0.1 + 1.5 * h
    ]
    for make, settings in trials:
        peer = make(arm, settings)
        try:
            peer.settle(poses_kpa, [tolerance_m])
            cost_s = peer.seconds_per_pose(poses_kpa, tolerance_m)
            found = f"{cost_s * 1e3:8.3f} ms, {max(peer.steps[tolerance_m])} steps at most"
        except Unstable as e:
            found = str(e)
        print(f"{make.__name__:9} {settings}: {found}", flush=True)


def compare(options, arm, program, poses_kpa) -> dict:
    tolerances_m = [t * 1e-3 for t in options.tolerance]
    peers = [elastica(arm, ELASTICA), mujoco(arm, MUJOCO_DEFAULT), mujoco(arm, MUJOCO_RELAXED)]
    solved = [program.solve(p) for p in poses_kpa]
    ours_m = np.array([s["tip_mm"] for s in solved]) * 1e-3
    for peer in peers:
        peer.settle(poses_kpa, tolerances_m)
    program.seconds_per_pose(10)
    ours_s = []
    theirs_s = [[[] for _ in tolerances_m] for _ in peers]
    for _ in range(options.repeats):  # in turn, so that a busy moment meets all
        ours_s.append(program.seconds_per_pose(options.samples))
        for peer, costs in zip(peers, theirs_s):
            for tolerance_m, seconds in zip(tolerances_m, costs):
                seconds.append(peer.seconds_per_pose(poses_kpa, tolerance_m))
    base_s = statistics.median(ours_s)
    ours = {
        "method": "springtwin",
        "unknowns": 4 * 2 * ELEMENTS,
        "tips_mm": (ours_m * 1e3).tolist(),
        "seconds_per_pose": spread(ours_s),
        "iterations": [s["iterations"] for s in solved],
    }
    rows = []
    for peer, costs in zip(peers, theirs_s):
        off_mm = np.linalg.norm(np.array(peer.tips_m) - ours_m, axis=1) * 1e3
        settled = [
            {
                "tolerance_mm": t * 1e3,
                "steps": peer.steps[t],
                "seconds_per_pose": spread(seconds),
                "ratio": statistics.median(seconds) / base_s,
            }
            for t, seconds in zip(tolerances_m, costs)
        ]
        rows.append(
            {
                "method": peer.name,
                "unknowns": peer.simulation.unknowns,
                "tips_mm": (np.array(peer.tips_m) * 1e3).tolist(),
                "differences_mm": off_mm.tolist(),
                "difference_mm": {"mean": float(off_mm.mean()), "max": float(off_mm.max())},
                "settled": settled,
            }
        )
    # Motion: cost does not depend on damping; MuJoCo at 1 kHz, PyElastica at the step it needs.
    moving = [peers[0], mujoco(arm, {"step_s": 0.001, "damping_s": MUJOCO_DEFAULT["damping_s"]})]
    dynamics = [
        {
            "method": peer.name,
            "seconds_per_simulated_second": spread(
                [peer.seconds_per_simulated_second(NAMED_KPA[3]) for _ in range(options.repeats)]
            ),
        }
        for peer in moving
    ]
    return {
        "simulated": True,
        "versions": {
            "springtwin": program.version,
            "pyelastica": elastica_arm.VERSION,
            "mujoco": mujoco_arm.VERSION,
            "python": platform.python_version(),
            "numpy": np.__version__,
        },
        "machine": {"cpus": os.cpu_count(), "cpus_used": 1, "system": platform.platform()},
        "repeats": options.repeats,
        "samples": options.samples,
        "poses_kpa": [list(map(float, p)) for p in poses_kpa],
        "cold_solve_micros": spread([s["micros"] for s in solved]),
        "springtwin": ours,
        "peers": rows,
        "dynamics": dynamics,
    }


def table(head, rows) -> str:
    cells = [head, *rows]
    width = [max(len(row[c]) for row in cells) for c in range(len(head))]
    line = lambda row: "  ".join(
        x.ljust(w) if c == 0 else x.rjust(w) for c, (x, w) in enumerate(zip(row, width))
    )
    return "\n".join([line(head), "  ".join("-" * w for w in width), *map(line, rows)])


def show(r: dict) -> None:
    v, ours, theirs = r["versions"], r["springtwin"], r["peers"]
    print(
        f"springtwin {v['springtwin']}, PyElastica {v['pyelastica']}, MuJoCo {v['mujoco']}, "
        f"Python {v['python']}, numpy {v['numpy']}\n"
        f"{r['machine']['cpus']} CPUs, one used, one thread each; processor time; all simulated\n"
        f"{len(r['poses_kpa'])} poses from rest, {r['repeats']} repeats; "
        f"springtwin: batches of {r['samples']} poses\n"
    )
    point = lambda tip: "(" + ", ".join(f"{x + 0.0:.1f}" for x in np.round(tip, 1)) + ")"
    rows = []
    for i, pose in enumerate(r["poses_kpa"]):
        row = [" ".join(f"{p:.0f}" for p in pose), point(ours["tips_mm"][i])]
        for t in theirs:
            row += [f"{point(t['tips_mm'][i])} {t['differences_mm'][i]:5.2f}"]
        rows.append(row)
    head = ["pressures, kPa", "springtwin", *(t["method"] for t in theirs)]
    print("settled tip, mm; for the others with the distance to springtwin's, mm")
    print(table(head, rows) + "\n")
    ms = lambda s: f"{s['median'] * 1e3:.3f} ({s['min'] * 1e3:.3f}-{s['max'] * 1e3:.3f})"
    newton = f"{statistics.mean(ours['iterations']):.1f}"
    cost = ms(ours["seconds_per_pose"])
    rows = [["springtwin", str(ours["unknowns"]), "-", "own stop", newton, cost, "1.0"]]
    for t in theirs:
        off = f"{t['difference_mm']['mean']:.2f} / {t['difference_mm']['max']:.2f}"
        for x in t["settled"]:
            steps = f"{statistics.mean(x['steps']):.1f}"
            cost = ms(x["seconds_per_pose"])
            row = [t["method"], str(t["unknowns"]), off, f"{x['tolerance_mm']:g}", steps, cost]
            rows.append([*row, f"{x['ratio']:.1f}"])
    head = ["method", "unknowns", "tip off by, mm (mean / max)", "settled to, mm", "steps"]
    print(table([*head, "ms per settled pose (range)", "ratio to springtwin"], rows))
    c = r["cold_solve_micros"]
    print(
        f"one cold `springtwin sim solve` of these poses by its own clock: {c['median'] / 1e3:.3f} ms "
        f"({c['min'] / 1e3:.3f}-{c['max'] / 1e3:.3f})\n"
    )
    rows = [[x["method"], ms(x["seconds_per_simulated_second"])] for x in r["dynamics"]]
    print(table(["motion", "ms per simulated second (range)"], rows))
    print("springtwin's motion is not timed: no command runs it alone")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--springtwin", type=Path, default=ROOT / "target/release/springtwin")
    parser.add_argument("--robot", type=Path, default=ROOT / "assets/robots/reference.toml")
    parser.add_argument("--poses", type=int, default=8, help="random poses besides the named four")
    parser.add_argument("--repeats", type=int, default=7)
    parser.add_argument("--samples", type=int, default=4000, help="poses per batch of springtwin")
    parser.add_argument(
        "--tolerance",
        type=float,
        nargs="+",
        default=[0.1, 1e-6],
        help="how near to its settled place the tip must be, mm; --tune uses the first",
    )
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--tune", action="store_true", help="try the others' settings, then stop")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    if options.poses < 0 or options.repeats < 1 or options.samples < 2 or min(options.tolerance) <= 0:
        parser.error("poses from 0, repeats from 1, samples from 2, tolerance above 0")
    if hasattr(os, "sched_setaffinity"):  # children inherit it
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    else:
        print("this system cannot pin a process: springtwin may use more cores", file=sys.stderr)
    try:
        arm = robot.read(options.robot)
    except (OSError, KeyError, ValueError) as e:
        sys.exit(f"the robot file {options.robot} cannot be used: {e}")
    rng = np.random.default_rng(options.seed)
    drawn = rng.uniform(*arm.pressure_kpa, (options.poses, 6)).round(1)
    poses_kpa = NAMED_KPA + [tuple(map(float, p)) for p in drawn]
    try:
        if options.tune:
            tune(arm, poses_kpa, options.tolerance[0] * 1e-3)
            return
        program = Springtwin(options.springtwin.resolve(), options.robot.resolve())
        result = compare(options, arm, program, poses_kpa)
    except Unstable as e:
        sys.exit(f"{e}: choose other settings with --tune")
    if options.json:
        print(json.dumps(result))
    else:
        show(result)


if __name__ == "__main__":
    main()
