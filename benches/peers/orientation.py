#!/usr/bin/env python3
"""The orientation filter on measured IMU data, beside VQF by its authors. README.md beside this file says how."""

import argparse
import json
import os
import platform
import sys
from importlib.metadata import version
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent.parent
sys.dont_write_bytecode = True

try:
    import numpy as np
    import pyarrow.parquet
    import vqf
except ImportError as e:
    sys.exit(f"{e.name} is missing: run `pip install -r benches/peers/requirements.txt`")

from program import run

ALIGN_S = 1.0  # the heading is free: it is set over the first second, as the program does


def conjugate(q):
    return q * [1.0, -1.0, -1.0, -1.0]


def product(a, b):
    """Of quaternions w, x, y, z."""
    aw, ax, ay, az = np.moveaxis(a, -1, 0)
    bw, bx, by, bz = np.moveaxis(b, -1, 0)
    return np.stack(
        [
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ],
        axis=-1,
    )


class Trial:
    """A log with an optical reference, earth from IMU."""

    def __init__(self, path: Path):
        table = pyarrow.parquet.read_table(path)
        columns = lambda *names: np.ascontiguousarray(
            np.stack([table[n].to_numpy().astype(float) for n in names], axis=1)
        )
        self.path = path
        t_s = table["t_s"].to_numpy()
        self.period_s = (t_s[-1] - t_s[0]) / (len(t_s) - 1)
        self.gyro = columns(*(f"gyro_{a}_rad_s" for a in "xyz"))
        self.accel = columns(*(f"accel_{a}_m_s2" for a in "xyz"))
        self.reference = columns(*(f"ref_q_{a}" for a in "wxyz"))
        self.counts = table["movement"].to_numpy(zero_copy_only=False)

    def errors_deg(self, estimate) -> dict:
        """As BROAD counts them: a turn about the vertical, and the rest."""
        known = np.isfinite(self.reference).all(axis=1)
        truth, estimate, counts = self.reference[known], estimate[known], self.counts[known]
        first = product(truth, conjugate(estimate))[: int(ALIGN_S / self.period_s)]
        headings = 2 * np.arctan2(first[:, 3], first[:, 0])
        half = 0.5 * np.arctan2(np.sin(headings).sum(), np.cos(headings).sum())
        turn = np.array([np.cos(half), 0.0, 0.0, np.sin(half)])
        e = np.abs(product(truth, conjugate(product(turn, estimate))))[counts]
        w, x, y, z = e.T
        rms = lambda angle: float(np.degrees(np.sqrt(np.mean(angle**2))))
        return {
            "total": rms(2 * np.arctan2(np.sqrt(x * x + y * y + z * z), w)),
            "inclination": rms(2 * np.arctan2(np.hypot(x, y), np.hypot(w, z))),
            "samples": int(counts.sum()),
        }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--program", type=Path, default=ROOT / "target/release/springtwin")
    usual = Path(os.environ.get("SPRINGTWIN_DATA", ROOT.parent / "shared/data"))
    parser.add_argument("--data", type=Path, default=usual / "broad", help="folder of the trials")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    files = sorted(options.data.glob("*.parquet"))
    if not files:
        sys.exit(f"there are no trials in {options.data}: give their folder with --data")
    rows = []
    for file in files:
        trial = Trial(file)
        theirs = vqf.VQF(trial.period_s).updateBatch(trial.gyro, trial.accel)["quat6D"]
        ours = json.loads(run(options.program, "imu", "eval", file, "--json", option="--program"))
        found = trial.errors_deg(theirs)
        if found["samples"] != ours["samples"]:
            sys.exit(f"{file.name}: {ours['samples']} samples scored by springtwin, {found['samples']} here")
        rows.append(
            {
                "trial": file.stem,
                "springtwin": {
                    "total": ours["total_rmse_deg"],
                    "inclination": ours["inclination_rmse_deg"],
                },
                "vqf": found,
            }
        )
    result = {
        "simulated": False,
        "versions": {
            "vqf": version("vqf"),
            "numpy": np.__version__,
            "python": platform.python_version(),
        },
        "trials": rows,
    }
    if options.json:
        print(json.dumps(result))
        return
    for r in rows:
        told = [f"{who} {r[who]['total']:.2f} ({r[who]['inclination']:.2f})" for who in ("springtwin", "vqf")]
        print(f"{r['trial']}: total (inclination) RMSE, deg: {', '.join(told)}")


if __name__ == "__main__":
    main()
