#!/usr/bin/env python3
"""The live monitor beside principal components and change points, on the same signals.

Each arm has a healthy session of 90 s, healthy sessions of ten minutes in six motions, and sessions in which something begins at
60 s. springtwin's monitor is commissioned with the 90 s and keeps its own limit. The others have two advantages: they learn from
all these healthy sessions, and their limits are set on them afterwards, just high enough that they alarm in no more of them than
springtwin does. All of it is simulated.
"""

import argparse
import json
import platform
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from importlib.metadata import version
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent.parent
sys.dont_write_bytecode = True

try:
    import numpy as np
    import ruptures
except ImportError as e:
    sys.exit(f"{e.name} is missing: run `pip install -r benches/peers/requirements.txt`")

from program import run

MOTIONS = ["mixed", "steps", "reversals", "sines", "holds", "loads"]
BEGINS_S = 60.0
EFFECTS = [
    "payload=0.2", "payload=0.4", "tip-force=0,0,-2", "tip-force=1.5,0,0", "contact=-0.28", "com-offset=0.01,0",
    "base-tilt=0.02,0", "chamber-stiffness:3=1.15", "chamber-stiffness:5=0.8", "creep=0.15,20", "hysteresis:1=4",
    "damping=0.15", "pressure-lag=0.25", "stiffening=2", "torsion:1=0.5", "gauge-error:2=1.08,0",
    "spring-calibration:4=1.05,0.002", "spring-calibration:9=1.02,0.001", "spring-drift:2=2e-5", "spring-lag=0.3",
    "spring-crosstalk:1=0.05", "imu-misalignment:2=0,0,0.03", "imu-drift:3=3e-3",
]  # fmt: skip
# All average over so long, s.
OVER_S = 30
# Share of the variance that the principal components keep.
KEPT = 0.95


def sessions(program: Path, folder: Path, arm: int, seconds: float, effects):
    """Sessions of an arm: healthy ones by motion, others by effect; those that are there already are used."""
    folder.mkdir(parents=True, exist_ok=True)
    jobs = [("healthy", 10 * arm, 90.0, "mixed", None)]
    jobs += [(m, 10 * arm + k, seconds, m, None) for k, m in enumerate(MOTIONS, 1)]
    jobs += [(f"effect-{k}", 1000 * arm + k, 180.0, "mixed", e) for k, e in enumerate(effects, 1)]

    def make(job):
        name, seed, length, motion, hidden = job
        if not (folder / name / "session.toml").exists():
            hide = ["--hide", f"{hidden}@{BEGINS_S}"] if hidden else []
            run(program, "rig", "session", "--unit", arm, "--seed", seed, "--seconds", length, "--excitation", motion,
                *hide, "--out", folder / name, option="--program")  # fmt: skip

    with ThreadPoolExecutor(2) as pool:
        list(pool.map(make, jobs))
    if not (folder / "rig.toml").exists():
        run(program, "gap", "commission", folder / "healthy", "--out", folder / "patch.toml", "--baseline",
            folder / "rig.toml", option="--program")  # fmt: skip


def signals(session: Path):
    """Means of each second: its time, and six pressures, twelve springs and twelve angles of the IMUs."""
    with (session / "log.csv").open() as f:
        head = f.readline().strip().split(",")
    wanted = [0] + [k for k, n in enumerate(head) if n.startswith(("p", "spring", "imu"))]
    data = np.genfromtxt(session / "log.csv", delimiter=",", skip_header=1, usecols=wanted)
    second = np.floor(data[:, 0]).astype(int)
    means = np.array([np.nanmean(data[second == s], axis=0) for s in range(second.max())])
    return means[:, 0], means[:, 1:]


def smoothed(x):
    """Running mean with the memory of springtwin's monitor."""
    out, mean = [], 0.0
    for value in x:
        mean += (value - mean) / OVER_S
        out.append(mean)
    return np.array(out)


class Components:
    """Principal components of pressures, springs and IMUs in a rig in order: T² within them, Q beside them."""

    name = "principal components, T² and Q"

    def __init__(self, healthy):
        _, x = healthy
        self.mean, self.sd = x.mean(0), x.std(0) + 1e-9
        z = (x - self.mean) / self.sd
        _, s, axes = np.linalg.svd(z, full_matrices=False)
        variance = s**2 / len(z)
        n = int(np.searchsorted(np.cumsum(variance) / variance.sum(), KEPT)) + 1
        self.axes, self.variance = axes[:n], variance[:n]
        self.q_healthy = ((z - z @ self.axes.T @ self.axes) ** 2).sum(1).mean()

    def course(self, session):
        t, x = session
        z = (x - self.mean) / self.sd
        inside = z @ self.axes.T
        t2 = smoothed((inside**2 / self.variance).sum(1) / len(self.variance))
        q = smoothed(((z - inside @ self.axes) ** 2).sum(1) / self.q_healthy)
        return t, np.maximum(t2, q)


class ChangePoints:
    """What springs and IMUs read beyond a regression on the pressures, and where its mean changes (ruptures)."""

    name = f"ruptures {version('ruptures')}, mean of what a regression on the pressures leaves"

    def __init__(self, healthy):
        _, x = healthy
        self.weights = np.linalg.lstsq(self.inputs(x), x[:, 6:], rcond=None)[0]
        self.sd = (x[:, 6:] - self.inputs(x) @ self.weights).std(0) + 1e-9

    @staticmethod
    def inputs(x):
        p = x[:, :6] / 10.0
        pairs = [p[:, i] * p[:, j] for i in range(6) for j in range(i, 6)]
        return np.column_stack([np.ones(len(p)), p, *pairs])

    def course(self, session):
        t, x = session
        e = (x[:, 6:] - self.inputs(x) @ self.weights) / self.sd
        at, gains = [], []
        for end in range(40, len(t), 5):
            window = e[max(0, end - 2 * OVER_S - 30) : end]
            cost = ruptures.costs.CostL2().fit(window)
            split = ruptures.Binseg(custom_cost=ruptures.costs.CostL2(), min_size=5).fit(window).predict(n_bkps=1)[0]
            gain = cost.error(0, len(window)) - cost.error(0, split) - cost.error(split, len(window))
            at.append(t[end])
            gains.append(gain)
        return np.array(at), np.array(gains)


def first_above(course, limit):
    """Seconds from the beginning of what is hidden to the first alarm after it; none without one."""
    t, value = course
    over = t[(value > limit) & (t > BEGINS_S)]
    return float(over[0] - BEGINS_S) if len(over) else None


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--first-arm", type=int, default=1, help="first manufactured arm; from 1001 on: unseen ones")
    parser.add_argument("--arms", type=int, default=2)
    parser.add_argument("--seconds", type=float, default=600.0, help="length of a healthy session")
    parser.add_argument("--no-effects", action="store_true", help="false alarms alone")
    parser.add_argument("--program", type=Path, default=ROOT / "target/release/springtwin")
    parser.add_argument("--out", type=Path, help="folder for the sessions, to be used again")
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    out = args.out or Path(tempfile.mkdtemp())
    effects = [] if args.no_effects else EFFECTS
    healthy, begun = {}, {}

    def judged(arm):
        folder = out / str(arm)
        sessions(args.program, folder, arm, args.seconds, effects)
        # springtwin knows the first of them.
        of_all = [signals(folder / name) for name in ["healthy", *MOTIONS]]
        known = tuple(np.concatenate(part) for part in zip(*of_all, strict=True))
        peers = [Components(known), ChangePoints(known)]

        def courses(name):
            watched = run(args.program, "gap", "watch", "--baseline", folder / "rig.toml", "--session", folder / name,
                          "--json", option="--program")  # fmt: skip
            watched = json.loads(watched)
            ours = np.array([[t, ratio] for t, ratio, _ in watched["course"]]).T
            session = signals(folder / name)
            likely = (watched["alarm"] or {}).get("likely", [])
            return {"springtwin": tuple(ours), **{p.name: p.course(session) for p in peers}}, likely

        with ThreadPoolExecutor(2) as pool:
            names = [*MOTIONS, *(f"effect-{k}" for k in range(1, len(effects) + 1))]
            return dict(zip(names, pool.map(courses, names), strict=True))

    for arm in range(args.first_arm, args.first_arm + args.arms):
        print(f"arm {arm}", file=sys.stderr)
        for name, (course, likely) in judged(arm).items():
            (begun if name.startswith("effect") else healthy)[arm, name] = (course, likely)
    report = {"hours": len(healthy) * args.seconds / 3600.0, "arms": args.arms, "first_arm": args.first_arm, "monitors": {}}
    names = list(next(iter(healthy.values()))[0])
    ours = sum(bool(c["springtwin"][1].max() > 1.0) for c, _ in healthy.values())
    for name in names:
        highest = sorted((c[name][1].max() for c, _ in healthy.values()), reverse=True)
        # As many sessions with a false alarm as springtwin has.
        limit = 1.0 if name == "springtwin" else highest[ours]
        alarms = {m: sum(int(c[name][1].max() > limit) for (_, k), (c, _) in healthy.items() if k == m) for m in MOTIONS}
        delays = {}
        for k, effect in enumerate(effects, 1):
            delays[effect] = [first_above(begun[arm, f"effect-{k}"][0][name], limit)
                              for arm in range(args.first_arm, args.first_arm + args.arms)]  # fmt: skip
        noticed = [d for all_ in delays.values() for d in all_ if d is not None]
        report["monitors"][name] = {
            "limit": limit, "false_alarms": alarms, "largest": highest[0], "delays_s": delays, "noticed": len(noticed),
            "of": sum(map(len, delays.values())), "median_delay_s": float(np.median(noticed)) if noticed else None,
        }  # fmt: skip
    report["likely"] = {
        effect: [begun[arm, f"effect-{k}"][1] for arm in range(args.first_arm, args.first_arm + args.arms)]
        for k, effect in enumerate(effects, 1)
    }
    if args.json:
        print(json.dumps(report, indent=1))
        return
    print(f"{platform.machine()}, simulated. {report['hours']:.1f} h of healthy arms {args.first_arm} and on.\n")
    for name, m in report["monitors"].items():
        print(f"{name}: false alarms {sum(m['false_alarms'].values())} {m['false_alarms']}, noticed {m['noticed']} of {m['of']}, "
              f"median after {m['median_delay_s']} s")  # fmt: skip
    print("\n| hidden | " + " | ".join(names) + " | it looks like |\n" + "| --- " * (len(names) + 2) + "|")
    shown = lambda all_: ", ".join("-" if d is None else f"{d:.0f}" for d in all_)  # noqa: E731
    for effect in effects:
        cells = [shown(report["monitors"][n]["delays_s"][effect]) for n in names]
        first = ", ".join(dict.fromkeys(likely[0] for likely in report["likely"][effect] if likely))
        print(f"| {effect} | " + " | ".join(cells) + f" | {first} |")


if __name__ == "__main__":
    main()
