# %% [markdown]
# What springtwin writes, read with stock tools: datasets (Parquet) by pyarrow, recordings (.rrd) by the Rerun
# package, findings (JSON) by Python itself. Nothing of springtwin's own is needed.
#
#     pip install rerun-sdk==0.36.3        # brings pyarrow and numpy
#     python examples/read_results.py [DATASET.parquet [RECORDING.rrd [FINDING.json]]]
#
# The first and the last file come from the walk in the README. An editor that knows cells (`# %%`) runs them one by one.

# %%
import json
import sys

import numpy as np
import pyarrow.parquet as pq
from rerun.experimental import RrdReader

given = [a for a in sys.argv[1:] if not a.startswith("-")]
usual = ["walk/sim.parquet", "recordings/point-to-point.rrd", "walk/found/finding.json"]
dataset_file, recording_file, finding_file = given + usual[len(given) :]

# %% [markdown]
# A dataset: a row per settled sample, the unit in each column's name, where it came from in the file's metadata.

# %%
table = pq.read_table(dataset_file)
about = {k.decode(): v.decode() for k, v in table.schema.metadata.items() if k.startswith(b"springtwin.")}
springs_m = np.column_stack([table[f"spring{i}_m"] for i in range(1, 13)])
tip_m = np.column_stack([table[c] for c in ("x_m", "y_m", "z_m")])
reach_mm = np.hypot(tip_m[:, 0], tip_m[:, 1]).max() * 1e3
print(f"dataset: {table.num_rows} samples by {about['springtwin.source']}, seed {about['springtwin.seed']}")
print(f"  springs {springs_m.min() * 1e3:.0f} to {springs_m.max() * 1e3:.0f} mm, tip up to {reach_mm:.0f} mm off the axis")


# %% [markdown]
# A recording: each channel is an entity with a time line `session`; its rows come in chunks.


# %%
def channel(file, path):
    """Times (s) and values (one row per instant) of one channel of numbers."""
    times_s, values = [], []
    for chunk in RrdReader(file).stream():
        if chunk.entity_path != path or chunk.is_static:
            continue
        batch = chunk.to_record_batch()
        times_s.append(batch["session"].cast("int64").to_numpy() * 1e-9)
        values.append(np.array(batch["Scalars:scalars"].to_pylist()))
    if not values:
        sys.exit(f"{file} has no channel {path}: springtwin inspect {file} lists those it has")
    times_s, values = np.concatenate(times_s), np.concatenate(values)
    order = np.argsort(times_s, kind="stable")
    return times_s[order], values[order]


t_s, predicted_mm = channel(recording_file, "/tip/predicted/position_mm")
t_true_s, true_mm = channel(recording_file, "/tip/vicon/position_mm")
_, at_predicted, at_true = np.intersect1d(t_s, t_true_s, return_indices=True)
error_mm = np.linalg.norm(predicted_mm[at_predicted] - true_mm[at_true], axis=1)
print(f"recording: {t_s[-1] - t_s[0]:.1f} s, predicted against captured tip at {len(error_mm)} instants")
print(f"  mean error {error_mm.mean():.4f} mm, 95 % below {np.percentile(error_mm, 95):.4f} mm")

# %% [markdown]
# A finding of `gap run --out` (what `--json` prints), of the whole arm or of its supply alone (`--actuation-only`).

# %%
with open(finding_file, encoding="utf-8") as file:
    finding = json.load(file)
gap = finding["gap"]
print(f"finding: {finding['verdict']}")
for effect in finding["effects"]:
    for name, p in effect["params"].items():
        # A value that rests on the edge of its range has no interval.
        interval = "[{:.4g}, {:.4g}]".format(*p["ci95"]) if p.get("ci95") else "(at the edge of its range)"
        print(f"  {effect['id']} {effect['target'] or ''}: {name} {p['value']:.4g} {p['unit']} {interval}")
if all(isinstance(gap[k], float) for k in ("before", "after", "floor")):
    print(f"  error {gap['before']:.2f} -> {gap['after']:.2f} {gap['unit']}, healthy {gap['floor']:.2f} {gap['unit']}")
