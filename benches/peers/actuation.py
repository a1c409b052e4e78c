#!/usr/bin/env python3
"""The way from command to gauge of a real arm: springtwin's finder beside PySINDy with control.

Both fit one measured session and predict two others freely. README.md beside this file says how.
"""

import argparse
import csv
import json
import os
import platform
import statistics
import sys
import time
import warnings
from pathlib import Path

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[variable] = "2"

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent.parent
sys.dont_write_bytecode = True

try:
    import numpy as np
    import pysindy
except ImportError as e:
    sys.exit(f"{e.name} is missing: run `pip install -r benches/peers/requirements.txt`")

from program import run, spread

warnings.filterwarnings("ignore")  # STLSQ tells of every threshold that leaves nothing

FIT, PROVE = "apr18-1", ("apr18-2", "apr05-1")
CHAMBERS = 6
BIN_S = 0.05  # the finder's own grid, 20 Hz
SUBSTEPS = 4  # of the free run, per bin
LIMIT_PSI = 50.0  # a free run that leaves this has failed
COLUMNS = 38  # time; desired 1-3, measured 1-3, desired 4-6, measured 4-6, psi; the rest is not used

# What PySINDy may choose from, each a list of functions of pressure x and command u, psi.
ONE = ("1", lambda x, u: np.ones_like(x))
LIBRARIES = {
    "first degree": [ONE, ("x", lambda x, u: x), ("u", lambda x, u: u)],
    "second degree": [
        ONE,
        ("x", lambda x, u: x),
        ("u", lambda x, u: u),
        ("x^2", lambda x, u: x * x),
        ("x u", lambda x, u: x * u),
        ("u^2", lambda x, u: u * u),
    ],
    "third degree of u - x, second of x": [
        ONE,
        ("x", lambda x, u: x),
        ("x^2", lambda x, u: x * x),
        ("u-x", lambda x, u: u - x),
        ("(u-x)^2", lambda x, u: (u - x) ** 2),
        ("(u-x)^3", lambda x, u: (u - x) ** 3),
        ("x (u-x)", lambda x, u: x * (u - x)),
    ],
    "filling and emptying apart": [
        ONE,
        ("x", lambda x, u: x),
        ("max(u-x,0)", lambda x, u: np.maximum(u - x, 0.0)),
        ("min(u-x,0)", lambda x, u: np.minimum(u - x, 0.0)),
        ("x max(u-x,0)", lambda x, u: x * np.maximum(u - x, 0.0)),
        ("x min(u-x,0)", lambda x, u: x * np.minimum(u - x, 0.0)),
    ],
    "filling and emptying through orifices": [
        ONE,
        ("x", lambda x, u: x),
        ("sqrt(max(u-x,0))", lambda x, u: np.sqrt(np.maximum(u - x, 0.0))),
        ("sqrt(max(x-u,0))", lambda x, u: np.sqrt(np.maximum(x - u, 0.0))),
        ("max(u-x,0)", lambda x, u: np.maximum(u - x, 0.0)),
        ("min(u-x,0)", lambda x, u: np.minimum(u - x, 0.0)),
    ],
    "filling and emptying that saturate": [
        ONE,
        ("x", lambda x, u: x),
        ("fill, 1 psi", lambda x, u: np.clip(u - x, 0.0, 1.0)),
        ("fill, 3 psi", lambda x, u: np.clip((u - x) / 3.0, 0.0, 1.0)),
        ("empty, 1 psi", lambda x, u: np.clip(u - x, -1.0, 0.0)),
        ("empty, 3 psi", lambda x, u: np.clip((u - x) / 3.0, -1.0, 0.0)),
        ("max(u-x,0)", lambda x, u: np.maximum(u - x, 0.0)),
        ("min(u-x,0)", lambda x, u: np.minimum(u - x, 0.0)),
    ],
}
THRESHOLDS = (0.0, 0.1, 0.3, 1.0)
RIDGE = 0.05  # the optimiser's own
DELAYS_S = tuple(round(0.025 * k, 3) for k in range(13))
WINDOWS = (5, 11)  # of the smoothed derivative, bins


class Session:
    """Measured and commanded pressures of a log in bins, psi."""

    def __init__(self, path: Path):
        with path.open(newline="") as f:
            rows = np.array([[float(x) for x in row] for row in csv.reader(f)])
        if rows.ndim != 2 or rows.shape[1] != COLUMNS:
            raise ValueError(f"it has not {COLUMNS} columns")
        self.name = path.stem
        self.time_s = rows[:, 0] - rows[0, 0]
        self.command = rows[:, [1, 2, 3, 7, 8, 9]]
        measured = rows[:, [4, 5, 6, 10, 11, 12]]
        bins = int(self.time_s[-1] / BIN_S)
        self.middle_s = (np.arange(bins) + 0.5) * BIN_S
        of = np.minimum((self.time_s / BIN_S + 1e-6).astype(int), bins - 1)
        count = np.bincount(of, minlength=bins)
        filled = count > 0
        self.measured = np.empty((bins, CHAMBERS))
        for i in range(CHAMBERS):
            total = np.bincount(of, weights=measured[:, i], minlength=bins)
            known = total[filled] / count[filled]
            self.measured[:, i] = np.interp(self.middle_s, self.middle_s[filled], known)

    def delayed(self, delay_s: float):
        """The command, held between samples, `delay_s` late, averaged over each bin."""
        at_s = self.middle_s[:, None] + (np.arange(10) - 4.5) / 10 * BIN_S - delay_s
        k = np.clip(np.searchsorted(self.time_s, at_s, side="right") - 1, 0, None)
        return self.command[k].mean(axis=1)


def fit(functions, settings, x, u) -> np.ndarray:
    """Coefficients per chamber, (6, functions). `x`, `u`: bins x 6."""
    library = pysindy.CustomLibrary(
        library_functions=[f for _, f in functions],
        function_names=[lambda x, u, name=name: name for name, _ in functions],
    )
    smoothed = pysindy.SmoothedFiniteDifference(
        smoother_kws={"window_length": settings["window"], "polyorder": 2}
    )
    groups = [range(CHAMBERS)] if settings["shared"] else [[i] for i in range(CHAMBERS)]
    found = np.empty((CHAMBERS, len(functions)))
    for group in groups:
        optimizer = pysindy.STLSQ(
            threshold=settings["threshold"], alpha=RIDGE
        )
        model = pysindy.SINDy(
            optimizer=optimizer, feature_library=library, differentiation_method=smoothed
        )
        model.fit([x[:, [i]] for i in group], t=BIN_S, u=[u[:, [i]] for i in group])
        found[list(group)] = model.coefficients()[0]
    return found


def free_run(functions, coefficients, start, commands):
    """Predictions of many models at once from `start` (6), by Heun's method.

    `coefficients`: models x 6 x functions; `commands`: models x bins x 6. Returns models x bins x 6.
    """
    rate = lambda x, u: sum(
        coefficients[:, :, k] * f(x, u) for k, (_, f) in enumerate(functions)
    )
    models, bins, _ = commands.shape
    x = np.broadcast_to(start, (models, CHAMBERS)).copy()
    out = np.empty(commands.shape)
    h = BIN_S / SUBSTEPS
    for b in range(bins):
        out[:, b] = x
        # From the middle of this bin to that of the next.
        for s in range(SUBSTEPS):
            u = commands[:, b if s < SUBSTEPS // 2 or b + 1 == bins else b + 1]
            first = rate(x, u)
            second = rate(x + h * first, u)
            x = np.clip(x + 0.5 * h * (first + second), -LIMIT_PSI, LIMIT_PSI)
            x = np.where(np.isfinite(x), x, LIMIT_PSI)
    return out


def rmse(predicted, measured) -> np.ndarray:
    return np.sqrt(((predicted - measured) ** 2).mean(axis=(-2, -1)))


def choose(session: Session, quick: bool):
    """The settings with the least error of free runs over the half that was not fitted, both halves in
    turn; on the session to be fitted alone."""
    delays, thresholds = (DELAYS_S[::4], THRESHOLDS[::2]) if quick else (DELAYS_S, THRESHOLDS)
    commands = {d: session.delayed(d) for d in delays}
    half = len(session.measured) // 2
    halves = [slice(0, half), slice(half, None)]
    tried = []
    for name, functions in LIBRARIES.items():
        trials = [
            {
                "library": name,
                "delay_s": d,
                "threshold": t,
                "window": w,
                "shared": shared,
            }
            for d in delays
            for t in thresholds
            for w in (WINDOWS[:1] if quick else WINDOWS)
            for shared in (True, False)
        ]
        errors = []
        for fitted, left_out in (halves, halves[::-1]):
            found = np.array(
                [
                    fit(functions, s, session.measured[fitted], commands[s["delay_s"]][fitted])
                    for s in trials
                ]
            )
            inputs = np.array([commands[s["delay_s"]][left_out] for s in trials])
            truth = session.measured[left_out]
            errors.append(rmse(free_run(functions, found, truth[0], inputs), truth))
        errors = np.sqrt((np.array(errors) ** 2).mean(axis=0))
        tried += [{**s, "held_out_psi": float(e)} for s, e in zip(trials, errors)]
    return sorted(tried, key=lambda s: s["held_out_psi"])


class Peer:
    """PySINDy: one search for settings, then as many last fits as are asked for."""

    def __init__(self, fitted: Session, quick: bool):
        self.fitted = fitted
        start_s = time.perf_counter()
        self.tried = choose(fitted, quick)
        self.search_s = time.perf_counter() - start_s
        self.chosen = self.tried[0]
        self.fits_s = []

    def fit(self, settings):
        commands = self.fitted.delayed(settings["delay_s"])
        return fit(LIBRARIES[settings["library"]], settings, self.fitted.measured, commands)

    def fit_again(self) -> None:
        start_s = time.perf_counter()
        self.fit(self.chosen)
        self.fits_s.append(time.perf_counter() - start_s)

    def errors(self, settings, sessions) -> dict:
        """Of free runs, psi."""
        functions, found = LIBRARIES[settings["library"]], self.fit(settings)[None]
        run = lambda s: free_run(functions, found, s.measured[0], s.delayed(settings["delay_s"])[None])
        return {s.name: float(rmse(run(s)[0], s.measured)) for s in sessions}

    def report(self, others) -> dict:
        functions = LIBRARIES[self.chosen["library"]]
        equation = lambda row: " + ".join(f"{c:.3g} {n}" for c, (n, _) in zip(row, functions) if c)
        best = [next(s for s in self.tried if s["library"] == name) for name in LIBRARIES]
        return {
            "settings": self.chosen,
            "tried": len(self.tried),
            "equations": [equation(row) for row in self.fit(self.chosen)],
            "rmse_psi": self.errors(self.chosen, [self.fitted, *others]),
            # For the reader: the choice fell before these sessions were looked at.
            "best_of_each_library": [{**s, "rmse_psi": self.errors(s, others)} for s in best],
        }


def ours(program: Path, data: Path) -> dict:
    command = ["gap", "run", "--actuation-only", "--json", "--session", data / f"{FIT}.csv"]
    for name in PROVE:
        command += ["--prove", data / f"{name}.csv"]
    found = json.loads(run(program, *command, option="--program"))
    return {
        "verdict": found["verdict"],
        "effects": found["effects"],
        "seconds": found["seconds"],
        "rmse_psi": {p["session"]: p["rmse_after"] for p in found["proof"]},
        "rmse_before_psi": {p["session"]: p["rmse_before"] for p in found["proof"]},
    }


def show(r: dict) -> None:
    ours, theirs, seconds = r["springtwin"], r["pysindy"], r["seconds"]
    print(f"springtwin {ours['verdict']}: {', '.join(e['id'] for e in ours['effects'])}")
    print(
        f"PySINDy {r['versions']['pysindy']}, best of {theirs['tried']} settings: {theirs['settings']}"
    )
    for i, equation in enumerate(theirs["equations"]):
        print(f"  chamber {i + 1}: x' = {equation}")
    for name in PROVE:
        print(
            f"{name}: {ours['rmse_before_psi'][name]:.3f} psi before; springtwin "
            f"{ours['rmse_psi'][name]:.3f}, PySINDy {theirs['rmse_psi'][name]:.3f}"
        )
    for name, s in seconds.items():
        print(f"seconds, {name}: {s['median']:.3f} ({s['min']:.3f}-{s['max']:.3f})")
    print("the best of each library on the half that was left out, and on the other sessions, psi:")
    for s in theirs["best_of_each_library"]:
        rmses = ", ".join(f"{n} {e:.3f}" for n, e in s["rmse_psi"].items())
        print(f"  {s['library']}: {s['held_out_psi']:.3f}; {rmses}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--program", type=Path, default=ROOT / "target/release/springtwin")
    usual = Path(os.environ.get("SPRINGTWIN_DATA", ROOT.parent / "shared/data"))
    parser.add_argument("--data", type=Path, default=usual / "asu-arm", help="folder of the logs")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--quick", action="store_true", help="fewer settings for PySINDy")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    if options.repeats < 1:
        parser.error("repeats from 1")
    try:
        fitted, *others = [Session(options.data / f"{name}.csv") for name in (FIT, *PROVE)]
    except (OSError, ValueError) as e:
        sys.exit(f"the logs of the ASU arm in {options.data} cannot be used ({e}): give their folder with --data")
    found, peer = [], Peer(fitted, options.quick)
    for _ in range(options.repeats):  # in turn
        found.append(ours(options.program.resolve(), options.data))
        peer.fit_again()
    result = {
        "simulated": False,
        "versions": {
            "pysindy": pysindy.__version__,
            "numpy": np.__version__,
            "python": platform.python_version(),
        },
        "fitted": FIT,
        "springtwin": found[0],
        "pysindy": peer.report(others),
        "seconds": {
            "springtwin": spread([r["seconds"] for r in found]),
            "pysindy_search_and_fit": spread([peer.search_s + s for s in peer.fits_s]),
            "pysindy_last_fit": spread(peer.fits_s),
        },
    }
    if options.json:
        print(json.dumps(result))
    else:
        show(result)


if __name__ == "__main__":
    main()
