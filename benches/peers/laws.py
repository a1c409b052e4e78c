#!/usr/bin/env python3
"""Laws of missing tensions: springtwin's search beside PySINDy, gplearn and pyoperon.

All are given the same residual tensions of one session with the same inputs, the same time, and are scored on the same other
session by the same rule. README.md beside this file says how. All of it is simulated.
"""

import argparse
import csv
import json
import platform
import shutil
import sys
import tempfile
import time
import warnings
from importlib.metadata import version
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent.parent
sys.dont_write_bytecode = True

try:
    import numpy as np
    import pysindy
    from gplearn.genetic import SymbolicRegressor as Gplearn
    from pyoperon.sklearn import SymbolicRegressor as Operon
except ImportError as e:
    sys.exit(f"{e.name} is missing: run `pip install -r benches/peers/requirements.txt`")

from program import run

warnings.filterwarnings("ignore")  # STLSQ warns of every threshold that leaves nothing

# What is hidden at its usual size, the inputs that count as right, and whether the table has it and must do without.
CASES = [
    ("bellows-touch:2=0.145", {"longer_m"}, False),
    ("creep", {"longer_less_past_m", "pressure_less_past_pa"}, True),
    ("area-bending", {"pressure_pa", "bend_rad"}, False),
    ("chamber-stiffness:4", {"longer_m"}, True),
    ("", set(), False),
    ("hysteresis", {"way_since_turn_m"}, True),
    ("stiffening", {"longer_m"}, True),
    ("temperature-stiffness", {"t_s", "longer_m"}, False),
]
# A tension that explains less than this share of what is missing, on blocks that were not fitted, is no law.
PAYS = 0.1
FOLDS = 4


def forces(path: Path):
    """Columns of forces.csv, by session: inputs, residual without the law, residual with it, bellows."""
    with path.open() as f:
        rows = list(csv.DictReader(f))
    names = list(rows[0])[5:]
    out = {}
    for session in dict.fromkeys(r["session"] for r in rows):
        of = [r for r in rows if r["session"] == session]
        x = np.array([[float(r[n]) for n in names] for r in of])
        y = np.array([float(r["residual_n"]) for r in of])
        law = [r["with_law_n"] for r in of]
        with_law = np.array([float(v) for v in law]) if law[0] else None
        out[session] = (x, y, with_law, np.array([int(r["bellows"]) for r in of]))
    return names, out


class Sindy:
    """The sparse regression of PySINDy over constants, inputs, squares and products."""

    name = f"PySINDy {version('pysindy')}"

    def fit(self, x, y, seconds):
        self.library = pysindy.PolynomialLibrary(degree=2)
        theta = np.asarray(self.library.fit_transform(x))
        # The threshold by which blocks are predicted best that were not fitted.
        blocks = np.arange(len(y)) * 2 * FOLDS // len(y) % FOLDS
        begun, best = time.monotonic(), (np.inf, None)
        for threshold in np.logspace(-3, 1, 25):
            if time.monotonic() - begun > seconds:
                break
            error = 0.0
            for k in range(FOLDS):
                fitted = self.sparse(theta[blocks != k], y[blocks != k], threshold)
                error += np.sum((y[blocks == k] - theta[blocks == k] @ fitted) ** 2)
            if error < best[0]:
                best = (error, threshold)
        self.coefficients = self.sparse(theta, y, best[1])
        return self

    @staticmethod
    def sparse(theta, y, threshold):
        optimizer = pysindy.STLSQ(threshold=threshold, alpha=0.05)
        return np.asarray(optimizer.fit(theta, y.reshape(-1, 1)).coef_).ravel()

    def predict(self, x):
        return np.asarray(self.library.transform(x)) @ self.coefficients


class Gp:
    """Genetic programming by gplearn."""

    name = f"gplearn {version('gplearn')}"

    def fit(self, x, y, seconds):
        begun = time.monotonic()
        self.model = Gplearn(
            population_size=1000,
            generations=1,
            function_set=("add", "sub", "mul", "max", "min", "abs"),
            parsimony_coefficient=0.001,
            warm_start=True,
            random_state=1,
            n_jobs=2,
        )
        # A generation at a time until the time is over.
        while time.monotonic() - begun < seconds and self.model.generations <= 200:
            self.model.fit(x, y)
            self.model.set_params(generations=self.model.generations + 1)
        return self

    def predict(self, x):
        return self.model.predict(x)


class Pyoperon:
    """Genetic programming with fitted coefficients by pyoperon."""

    name = f"pyoperon {version('pyoperon')}"

    def fit(self, x, y, seconds):
        self.model = Operon(
            allowed_symbols="add,sub,mul,constant,variable,abs,fmin,fmax",
            objectives=["mse", "length"],
            optimizer_iterations=5,
            max_length=20,
            max_time=max(1, int(seconds)),
            generations=100_000,
            max_evaluations=10**9,
            n_threads=2,
            random_state=1,
            model_selection_criterion="minimum_description_length",
            uncertainty=[0.2],
        )
        self.model.fit(x, y)
        return self

    def predict(self, x):
        return np.asarray(self.model.predict(x)).ravel()


def driving(model, x, names):
    """The input whose shuffling changes the prediction most."""
    rng = np.random.default_rng(1)
    base = model.predict(x)
    change = []
    for i in range(x.shape[1]):
        shuffled = x.copy()
        shuffled[:, i] = rng.permutation(shuffled[:, i])
        change.append(np.mean((model.predict(shuffled) - base) ** 2))
    return names[int(np.argmax(change))] if max(change) > 0 else None


def rms(y):
    return float(np.sqrt(np.mean(np.square(y))))


def peer(kind, names, fitted, proof, seconds):
    """One method on one case: the law of each bellows' tension as one function of its inputs, the same in all or, where
    that pays less, in the bellows whose tension is largest alone."""
    (x, y, _, bellows), (px, py, _, p_bellows) = fitted, proof
    sizes = [rms(y[bellows == b]) for b in range(1, 7)]
    one = int(np.argmax(sizes)) + 1
    best = None
    begun = time.monotonic()
    for chosen in (np.ones_like(bellows, bool), bellows == one):
        cx, cy = x[chosen], y[chosen]
        mean, scale = cx.mean(0), cx.std(0)
        scale[scale == 0] = 1.0
        scaled = (cx - mean) / scale
        # Twelve blocks in turn: each half is predicted by what the other was fitted to.
        half = np.arange(len(cy)) * 12 // len(cy) % 2 == 0
        left = 0.0
        for held in (half, ~half):
            model = kind().fit(scaled[~held], cy[~held], seconds / 8)
            left += np.sum((cy[held] - model.predict(scaled[held])) ** 2) / len(cy)
        square = np.mean(cy**2)
        explained = np.sum(chosen) * (square - left)
        if best is None or explained > best[0]:
            best = (explained, 1 - left / square, chosen.all(), mean, scale)
    _, share, all_of_them, mean, scale = best
    chosen = np.ones_like(bellows, bool) if all_of_them else bellows == one
    model = kind().fit((x[chosen] - mean) / scale, y[chosen], seconds / 2)
    law = bool(share > PAYS)
    after = py.copy()
    there = np.ones_like(p_bellows, bool) if all_of_them else p_bellows == one
    after[there] -= model.predict((px[there] - mean) / scale)
    return {
        "law": law,
        "input": driving(model, (x[chosen] - mean) / scale, names) if law else None,
        "left": rms(after) / rms(py),
        "seconds": time.monotonic() - begun,
    }


INPUT = {
    "length": "longer_m",
    "pressure": "pressure_pa",
    "reversal": "way_since_turn_m",
    "length-history": "longer_less_past_m",
    "pressure-history": "pressure_less_past_pa",
    "time": "t_s",
    "length-rate": "longer_rate_m_s",
    "bending": "bend_rad",
    "neighbour-pressure": "neighbours_pa",
    "other-pressure": "other_segment_pa",
}


def ours(law, proof):
    _, y, with_law, _ = proof
    found = law["verdict"] == "law"
    on_tension = [entry for entry in law["laws"] if entry["site"] == "chamber-tension"]
    inputs = [INPUT.get(i) for entry in on_tension for i in entry["terms"][0]["inputs"]]
    return {
        "law": found,
        "input": inputs[0] if inputs else ("another site" if found else None),
        "inputs": inputs,
        "left": rms(with_law) / rms(y) if found else 1.0,
        "seconds": law["seconds"],
    }


def solve(program, hidden, in_table, seed, folder, seconds):
    """Makes a case, lets springtwin search, and gives its residual tensions to the others."""
    def made(name, number, *more):
        hide = ["--hide", hidden] if hidden and name != "healthy" else []
        run(program, "rig", "session", "--out", folder / name, "--unit", seed, "--seed", 10 * seed + number, *hide, *more, option="--program")

    made("healthy", 1)
    made("suspect", 2)
    made("proof", 3, "--excitation", "sines")
    without = ["--without", hidden.split("=")[0].split(":")[0]] if in_table else []
    text = run(program, "gap", "discover", "--baseline", folder / "healthy", "--session", folder / "suspect", "--prove", folder / "proof",
               "--out", folder / "law", "--simulated", "--json", *without, option="--program")
    law = json.loads(text)
    names, sessions = forces(folder / "law" / "forces.csv")
    fitted, proof = list(sessions.values())
    budget = seconds or law["seconds"]
    out = {"springtwin": ours(law, proof)}
    for kind in (Sindy, Gp, Pyoperon):
        out[kind.name] = peer(kind, names, fitted, proof, budget)
    return {"missing_n": rms(proof[1]), "methods": out}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--program", type=Path, default=ROOT / "target/release/springtwin")
    parser.add_argument("--seed", type=int, default=1, help="specimen of the rig")
    parser.add_argument("--seconds", type=float, help="time for each method; without it what springtwin's search took")
    parser.add_argument("--only", help="only what is hidden with this id")
    parser.add_argument("--json", action="store_true")
    a = parser.parse_args()
    cases = []
    for k, (hidden, right, in_table) in enumerate(CASES):
        if a.only and not hidden.startswith(a.only):
            continue
        folder = Path(tempfile.mkdtemp(prefix="springtwin-laws-"))
        try:
            solved = solve(a.program, hidden, in_table, a.seed + k, folder, a.seconds)
        finally:
            shutil.rmtree(folder, ignore_errors=True)
        solved.update(hidden=hidden or "nothing", right=sorted(right))
        cases.append(solved)
        print(json.dumps(solved), file=sys.stderr, flush=True)
    result = {"simulated": True, "cpu": platform.processor(), "cases": cases}
    if a.json:
        print(json.dumps(result, indent=1))
    else:
        print(text(result))


def text(result):
    out = ["All simulated. Of each method: driving input; residual tension that is left on the other session; seconds.", ""]
    methods = list(result["cases"][0]["methods"])
    out += ["| hidden | missing there, N | " + " | ".join(methods) + " |", "|---|---|" + "---|" * len(methods)]
    right = dict.fromkeys(methods, 0)
    hidden = [c for c in result["cases"] if c["right"]]
    for c in result["cases"]:
        cells = []
        for m in methods:
            r = c["methods"][m]
            is_right = r["law"] and any(i in c["right"] for i in r.get("inputs") or [r["input"]])
            right[m] += bool(c["right"]) and is_right
            said = (r["input"] or "?") + (" (right)" if is_right else "") if r["law"] else "no law"
            cells.append(f"{said}; {100 * r['left']:.0f} %; {r['seconds']:.0f} s")
        out.append(f"| {c['hidden']} | {c['missing_n']:.2f} | " + " | ".join(cells) + " |")
    out += ["", "Driving input right: " + ", ".join(f"{m} {right[m]}/{len(hidden)}" for m in methods)]
    return "\n".join(out)


if __name__ == "__main__":
    main()
