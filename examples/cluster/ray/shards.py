#!/usr/bin/env python3
"""Runs a springtwin command in shards as Ray tasks, and merges them.

    shards.py --shards 20 --out data dataset --samples 100000 --seed 1
    shards.py --shards 60 --out studies --address auto study all
    shards.py --shards 38 --out bench --address auto gap-bench --seeds 30

What follows dataset, study or gap-bench goes to the program as it is. --out has to lie where all nodes see it. A
shard that fails is tried again, on any node; a command that was started again goes on where it was.
"""

import argparse
import hashlib
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

# Nothing is sent to anybody unless asked for.
os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")

import ray
from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy


def arguments():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--address", help="'auto' for the cluster of this node; without it this machine alone")
    parser.add_argument("--program", default="springtwin", help="the program, in the same place on all nodes")
    parser.add_argument("--shards", type=int, default=20, help="number of shards (20)")
    parser.add_argument("--retries", type=int, default=3, help="tries more for a shard that fails (3)")
    parser.add_argument("--cpus", type=int, help="processors per shard; those of the smallest node without it")
    parser.add_argument("--out", type=Path, required=True, help="folder for shards and results")
    parser.add_argument("kind", choices=["dataset", "study", "gap-bench"])
    parser.add_argument("options", nargs=argparse.REMAINDER, help="options of the command")
    return parser.parse_args()


def run(program, args, folder):
    """Runs the program in a folder; what it says as JSON. Raises with its complaint when it fails."""
    done = subprocess.run(
        [program, *args, "--json"], cwd=folder, stdin=subprocess.DEVNULL, capture_output=True, text=True
    )
    if done.returncode != 0:
        lines = done.stderr.strip().splitlines()
        told = [line for line in lines if line.startswith("error: ")] or lines[-1:]
        raise RuntimeError(told[0].removeprefix("error: ") if told else f"it ended with {done.returncode}")
    return json.loads(done.stdout)


def about(program):
    """Version of the program on this node, and the SHA-256 of its file."""
    path = shutil.which(program)
    if path is None:
        return "no program"
    version = subprocess.run([path, "--version"], capture_output=True, text=True).stdout.strip()
    return f"{version}, SHA-256 {hashlib.sha256(Path(path).read_bytes()).hexdigest()}"


def check_nodes(program, nodes):
    """Ends when the nodes do not all have the same program."""
    remote = ray.remote(num_cpus=0)(about)
    found = {}
    for node in nodes:
        there = NodeAffinitySchedulingStrategy(node["NodeID"], soft=False)
        asked = remote.options(scheduling_strategy=there).remote(program)
        found.setdefault(ray.get(asked), []).append(node["NodeManagerAddress"])
    if len(found) != 1 or "no program" in found:
        told = "; ".join(f"{who}: {', '.join(where)}" for who, where in found.items())
        sys.exit(f"error: all nodes need the same '{program}', but there is {told}")
    print(f"{len(nodes)} nodes with {next(iter(found))}", file=sys.stderr)


def shard_args(kind, options, i, n, shards):
    """Arguments of a shard. One that is tried again replaces what it wrote before."""
    part = ["--overwrite", "--shard", f"{i}/{n}", "--out"]
    match kind:
        case "dataset":
            return ["dataset", "generate", *options, *part, str(shards / f"{i}.parquet")]
        case "study":
            return ["study", *options, *part, str(shards)]
        case _:
            return ["gap", "bench", *options, *part, str(shards)]


def merge_args(kind, files, out):
    """Arguments of the merge."""
    to = ["--overwrite", "--out"]
    match kind:
        case "dataset":
            return ["dataset", "merge", *files, *to, str(out / "dataset.parquet")]
        case "study":
            return ["study", "merge", *files, *to, str(out)]
        case _:
            return ["gap", "bench", "merge", *files, *to, str(out)]


def main():
    a = arguments()
    out = a.out.resolve()
    shards = out / "shards"
    shards.mkdir(parents=True, exist_ok=True)
    # A program that is named by its path is looked for there, not in Ray's working folder.
    program = str(Path(a.program).resolve()) if os.sep in a.program else a.program
    ray.init(address=a.address, include_dashboard=None if a.address else False, log_to_driver=False)
    nodes = [node for node in ray.nodes() if node["Alive"]]
    check_nodes(program, nodes)

    # The program uses all processors that it sees: one shard per node at a time.
    with_cpus = [int(node["Resources"]["CPU"]) for node in nodes if node["Resources"].get("CPU")]
    cpus = a.cpus or min(with_cpus)
    task = ray.remote(num_cpus=cpus, max_retries=a.retries, retry_exceptions=True)(run)
    folder = os.getcwd()
    asked = {}
    for i in range(1, a.shards + 1):
        args = shard_args(a.kind, a.options, i, a.shards, shards)
        asked[task.remote(program, args, folder)] = (i, args)
    files = {}
    failed = []
    waiting = list(asked)
    while waiting:
        ready, waiting = ray.wait(waiting)
        for one in ready:
            i, args = asked[one]
            try:
                said = ray.get(one)
                # A data set's name is in its arguments; the others say where they wrote.
                files[i] = said.get("file", args[-1])
                print(f"shard {i}/{a.shards} is done", file=sys.stderr)
            except ray.exceptions.RayError as error:
                cause = getattr(error, "cause", None) or error
                failed.append(f"{i} ({cause})")
    if failed:
        sys.exit(f"error: after {a.retries + 1} tries each, these shards failed: {', '.join(failed)}")
    said = run(program, merge_args(a.kind, [files[i] for i in sorted(files)], out), folder)
    print(json.dumps(said))


if __name__ == "__main__":
    main()
