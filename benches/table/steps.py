"""What is run, and what is taken from it. Each step fills in figures by the ids of `targets.py`."""

import itertools
import json
import os
import re
import shutil
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path

import display

ROOT = Path(__file__).resolve().parents[2]
TARGET = ROOT / os.environ.get("CARGO_TARGET_DIR", "target")
PROGRAM = TARGET / "release/springtwin"
PACKAGED = TARGET / "dist/springtwin"
PYTHON = TARGET / "peers/bin/python"
DATA = Path(os.environ.get("SPRINGTWIN_DATA", ROOT.parent / "shared/data")).resolve()
LONGEST_S = 1500  # a command that takes longer has failed

FAR_MM = "-120,80,-240"  # the far point of `springtwin study moves`
HIDDEN = ("", "hysteresis", "payload")  # in the sessions of the gap finder


class Failure(Exception):
    """Why something could not be measured, for the table."""


@dataclass
class Figure:
    """Measured: all values in the target's unit, the middle of which is judged."""

    values: list
    note: str = ""
    source: str = "simulated"
    peers: list = field(default_factory=list)  # (name, values) in the same unit, and the middle likewise
    middle: float | None = None  # where it is not the median of the values

    def median(self) -> float:
        return statistics.median(self.values) if self.middle is None else self.middle


def say(text: str) -> None:
    print(f"== {text}", file=sys.stderr, flush=True)


def call(*command, limit_s=LONGEST_S) -> str:
    """What a command prints; with all that it started it is ended when it takes too long."""
    command = [str(c) for c in command]
    name = " ".join([Path(command[0]).name, *command[1:2]])
    try:
        process = subprocess.Popen(
            command, cwd=ROOT, text=True, process_group=0,
            stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        )  # fmt: skip
    except OSError as e:
        raise Failure(f"`{name}` cannot be run: {e.strerror}") from None
    try:
        out, errors = process.communicate(timeout=limit_s)
    except BaseException as e:
        os.killpg(process.pid, signal.SIGKILL)
        process.communicate()
        if isinstance(e, subprocess.TimeoutExpired):
            raise Failure(f"`{name}` took longer than {limit_s} s") from None
        raise
    if process.returncode != 0:
        lines = (errors or out).strip().splitlines() or ["it says nothing"]
        raise Failure(f"`{name}` failed: {lines[-1][:200]}")
    return out


def program(*arguments) -> dict:
    return json.loads(call(PROGRAM, *arguments, "--json"))


def peer(script: str, *arguments) -> dict:
    """What a script of `benches/peers` found."""
    if not PYTHON.exists():
        raise Failure("peer not installed")
    try:
        return json.loads(call(PYTHON, ROOT / "benches/peers" / script, "--json", *arguments))
    except Failure as e:
        missing = re.search(r"(\w+) is missing: run `pip", str(e))
        raise Failure(f"peer not installed ({missing.group(1)})" if missing else str(e)) from None


def values(spread: dict, factor=1.0) -> list:
    """Median and range as the peers' scripts give them."""
    return [spread[key] * factor for key in ("median", "min", "max")]


def built(_) -> dict:
    program, note = PACKAGED, "as the package has it"
    if not (PACKAGED.exists() and PACKAGED.stat().st_mtime > source_changed_s()):
        program = PROGRAM
        note = "as a release build leaves it; the package has it optimised as a whole"
    return {"binary": Figure([program.stat().st_size / 2**20], note, source="")}


def source_changed_s() -> float:
    """When the last of what the program is built of was changed, by the file's time."""
    own = [ROOT / "Cargo.toml", ROOT / "Cargo.lock"]
    folders = [folder.rglob("*") for folder in (ROOT / "src", ROOT / "shaders")]
    return max(f.stat().st_mtime for f in itertools.chain(own, *folders) if f.is_file())


# Criterion


def criterion_figures(since_s: float) -> dict:
    """Seconds per call of every benchmark that was run: the median and the range of its samples."""
    found = {}
    for file in (TARGET / "criterion").rglob("new/benchmark.json"):
        if file.stat().st_mtime < since_s:
            continue
        title = json.loads(file.read_text())["full_id"]
        sample = json.loads((file.parent / "sample.json").read_text())
        found[title] = [t / n * 1e-9 for t, n in zip(sample["times"], sample["iters"])]
    return found


def hot(quick: bool) -> dict:
    since_s = time.time()
    short = ["--warm-up-time", "0.5", "--measurement-time", "1", "--sample-size", "10"]
    call("cargo", "bench", "--locked", "--bench", "hot", "--", "--noplot", *(short if quick else []))
    found = criterion_figures(since_s)

    def take(name, factor):
        if name not in found:
            raise Failure(f"there is no benchmark `{name}`")
        return [x * factor for x in found[name]]

    motions = {n: 1e-3 / statistics.median(s) for n, s in found.items() if n.startswith("dynamics")}
    frames = {n: statistics.mean(s) for n, s in found.items() if n.startswith("frame/")}
    if not motions or not frames:
        raise Failure("benchmarks of motion or of frames are missing")
    slowest, screen = min(motions, key=motions.get), max(frames, key=frames.get)
    rest = take("rod statics, cold", 1e6)
    return {
        "rod-warm": Figure(take("rod statics, warm (0.4 % steps)", 1e6)),
        "rod-cold": Figure(rest),
        "dynamics": Figure(
            [1e-3 / s for s in found[slowest]],
            note=f"{slowest.split(', ', 2)[2]}; the peers swing, damped, into a pose",
        ),
        "rig": Figure([1e-2 / s for s in found["the virtual rig, 10 ms step, driven"]]),
        "mesh-warm": Figure(take("mesh/mesh sample, warm (0.4 % steps)", 1e3)),
        "jacobian": Figure(take("pose, 6 x 24 Jacobian and covariance", 1e6)),
        "reach-yes": Figure(take("reach, reachable", 1e6)),
        "reach-no": Figure(
            take("reach, unreachable", 1e6),
            note="from every start, and the point that is offered instead with a verdict of its own",
        ),
        "solve": Figure(
            take("controller, ours, one tick", 1e6),
            note="the paper states 17 ms for its own, on a laptop",
            peers=[("the paper's descent, corrected, as written here",
                    take("controller, paper's, one target", 1e6))],
        ),  # fmt: skip
        "frame": Figure(
            take(screen, 1e3),
            note=f"{screen.removeprefix('frame/')} of plots",
            middle=frames[screen] * 1e3,
        ),
    }


# Beside other simulators and libraries


def statics(quick: bool) -> dict:
    short = ["--poses", "1", "--repeats", "2", "--samples", "400"]
    found = peer("statics.py", "--springtwin", PROGRAM, *(short if quick else []))
    settled = [
        (f"{p['method']}, to {s['tolerance_mm']:g} mm", values(s["seconds_per_pose"], 1e6))
        for p in found["peers"]
        for s in p["settled"]
    ]
    motions = [
        (m["method"], [1 / s for s in values(m["seconds_per_simulated_second"])])
        for m in found["dynamics"]
    ]
    ours = values(found["springtwin"]["seconds_per_pose"], 1e6)
    return {
        "rod-pose": Figure(ours, peers=settled),
        "+dynamics": Figure([], peers=motions),
        "versions": found["versions"],
    }


def learning(quick: bool) -> dict:
    # Its own benchmark has been run just before.
    short = ["--quick"] if quick else ["--trainings", "3"]
    found = peer("learning.py", "--program", PROGRAM, "--no-cargo", *short)
    training, single = found["training"], found["single"]
    ours, theirs = training["springtwin"], training["pytorch"]
    of = lambda runs, key, factor=1.0: [run[key] * factor for run in runs if run[key] is not None]
    way = training["pytorch_ways"][0]
    name = f"PyTorch, {way['mode']}, threads: {way['threads']}"
    mm = training["target_mm"]
    reached = of(theirs, "seconds")
    best = {}
    for x in single["fastest"]:
        if x["group"] not in best or x["seconds"]["median"] < best[x["group"]]["seconds"]["median"]:
            best[x["group"]] = x
    peers = [(f"{g} ({x['dtype']})", values(x["seconds"], 1e6)) for g, x in best.items()]
    own = single["springtwin"]
    if own is None:
        raise Failure("criterion's figure is missing")
    figures = {
        "epoch": Figure(
            of(ours, "seconds_per_epoch", 1e3), peers=[(name, of(theirs, "seconds_per_epoch", 1e3))]
        ),
        "to-error": Figure(
            of(ours, "seconds"),
            note=f"{mm:.3f} mm on the validation part, which the peer reached in {len(reached)} of"
            f" {len(theirs)} trainings",
            peers=[(name, reached)] if reached else [],
        ),
        "jacobian": Figure(
            [own[key] * 1e6 for key in ("seconds", "low", "high")],
            note="with covariance, which the peers leave out; mean and its 95 % interval",
            peers=peers,
        ),
        "versions": found["versions"],
    }
    return figures


def supply(quick: bool) -> dict:
    data = DATA / "asu-arm"
    if not data.is_dir():
        raise Failure("the measured data are not there: set SPRINGTWIN_DATA")
    short = ["--quick", "--repeats", "1"] if quick else []
    found = peer("actuation.py", "--program", PROGRAM, "--data", data, *short)
    ours, theirs, seconds = found["springtwin"], found["pysindy"], found["seconds"]
    name = f"PySINDy, {theirs['settings']['library']}"
    named = f"{ours['verdict']}: {', '.join(e['id'] for e in ours['effects'])}"

    def predicted(session):
        before = ours["rmse_before_psi"][session]
        return Figure(
            [ours["rmse_psi"][session]],
            note=f"{named}; {before:.2f} with an ideal supply",
            source="measured",
            peers=[(name, [theirs["rmse_psi"][session]])],
        )

    return {
        "supply-repeat": predicted("apr18-2"),
        "supply-other": predicted("apr05-1"),
        "supply-seconds": Figure(
            values(seconds["springtwin"]),
            note="the whole finding, with its threshold and tests",
            source="measured",
            peers=[
                (f"PySINDy, {theirs['tried']} settings tried", values(seconds["pysindy_search_and_fit"])),
                ("PySINDy, its last fit alone", values(seconds["pysindy_last_fit"])),
            ],
        ),
        "versions": found["versions"],
    }


def orientation(_) -> dict:
    data = DATA / "broad"
    if not data.is_dir():
        raise Failure("the measured data are not there: set SPRINGTWIN_DATA")
    found = peer("orientation.py", "--program", PROGRAM, "--data", data)
    trials = found["trials"]

    def figure(kind, whole):
        ours, theirs = ([t[who][kind] for t in trials] for who in ("springtwin", "vqf"))
        return Figure(
            ours,
            middle=statistics.mean(ours),
            source="measured",
            note=f"range over {len(trials)} trials; the authors of the peer report {whole} for all of BROAD's",
            peers=[("VQF by its authors", theirs, statistics.mean(theirs))],
        )

    return {
        "imu-total": figure("total", 2.08),
        "imu-tilt": figure("inclination", 0.70),
        "versions": found["versions"],
    }


# The program's own commands


def datasets(quick: bool) -> dict:
    rods, meshes = [], []
    poses = 20 if quick else 300
    with tempfile.TemporaryDirectory() as folder:
        for k in range(1 if quick else 5):
            out = Path(folder) / f"rod-{k}.parquet"
            rods.append(program("dataset", "generate", "--samples", 20_000, "--out", out)["seconds"])
        for k in range(1 if quick else 3):
            out = Path(folder) / f"mesh-{k}.parquet"
            more = ["--samples", poses, "--simulator", "mesh", "--out", out]
            seconds = program("dataset", "generate", *more)["seconds"]
            meshes.append(seconds * 20_000 / poses / 60)
    return {
        "rod-20000": Figure(rods, note="the paper states 12,000 s for its own simulator"),
        "mesh-20000": Figure(meshes, note=f"{poses} samples, scaled"),
    }


def paths(quick: bool) -> dict:
    """Both controllers on the same paths and seeds, in turn."""
    figures = {}
    solve = {"ours": [], "paper": []}
    seeds = (1,) if quick else (1, 2, 3)
    for path in ("circle", "eight"):
        for grams in (200, 500):
            errors = {"ours": [], "paper": []}
            failed = []
            for seed in seeds:
                for kind in errors:
                    more = ["--payload", grams / 1000, "--seed", seed, "--controller", kind]
                    try:
                        found = program("follow", "--path", path, *more)
                    except Failure:
                        if kind == "ours":
                            raise
                        failed.append(seed)
                        continue
                    errors[kind].append(found["mean_mm"])
                    solve[kind].append(found["solve_micros"]["median"])
            figures[f"{path}-{grams}"] = Figure(
                errors["ours"],
                note=f"the paper's controller did not finish {len(failed)}" if failed else "",
                peers=[("the paper's controller", errors["paper"])] if errors["paper"] else [],
            )
    far = {"ours": [], "paper": []}
    for seed in seeds:
        for kind in far:
            more = ["--seed", seed, "--controller", kind, "--seconds", 120]
            far[kind].append(program("goto", f"{FAR_MM}", *more)["settled_steps"])
    figures["far"] = Figure(far["ours"], peers=[("the paper's controller", far["paper"])])
    figures["solve-path"] = Figure(
        solve["ours"],
        note="the median tick of each run",
        peers=[("the paper's controller", solve["paper"])] if solve["paper"] else [],
    )
    return figures


def real_time(quick: bool) -> dict:
    found = program("run", "--headless", "--rig", "pty", "--seconds", 5 if quick else 30)
    return {
        "missed": Figure([found["missed_ticks"]], note=f"of {found['ticks']}"),
        "lost": Figure([found["frames_lost"]], note=f"of {found['frames']}"),
    }


def finder(quick: bool) -> dict:
    seconds, verdicts = [], []
    with tempfile.TemporaryDirectory() as folder:
        healthy = Path(folder) / "healthy"
        program("rig", "session", "--seconds", 90, "--rate", 50, "--seed", 1, "--out", healthy)
        for hidden in HIDDEN[:1] if quick else HIDDEN:
            out = Path(folder) / f"suspect-{hidden}"
            more = ["--hide", hidden] if hidden else []
            program("rig", "session", "--seconds", 90, "--rate", 50, "--seed", 2, "--out", out, *more)
            found = program("gap", "run", "--baseline", healthy, "--session", out)
            seconds.append(found["seconds"])
            named = ", ".join(e["id"] for e in found["effects"])
            verdicts.append(f"{hidden or 'nothing'} hidden: {found['verdict']} {named}".strip())
    return {"gap-90": Figure(seconds, note="; ".join(verdicts), middle=max(seconds))}


# Recordings and memory


def number(pattern: str, text: str) -> float:
    found = re.search(pattern, text)
    if not found:
        raise Failure(f"`cargo bench --bench long` does not tell `{pattern}` any more")
    return float(found.group(1))


def hour(quick: bool) -> dict:
    for old in (TARGET / "tmp").glob("hour-*/hour*.rrd"):
        old.unlink()  # so that this run writes it
    bench = lambda: call("cargo", "bench", "--locked", "--bench", "long", "--", "hour")
    texts = [bench() for _ in range(1 if quick else 3)]
    snapshots = number(r"inspect: Ok\((\d+)\)", texts[0])
    shown = number(r"(\d+) samples are shown", texts[0])
    size_mb = number(r"\.rrd: (\d+) MB", texts[0])
    read = [number(r"read in ([\d.]+) s", t) for t in texts]
    opened = [r + number(r"player after ([\d.]+) s", t) for r, t in zip(read, texts)]
    scrubs = {}
    for name, median, most, worst in re.findall(
        r"scrub, (.+): median ([\d.]+) ms, 95 % ([\d.]+) ms, worst ([\d.]+) ms", "\n".join(texts)
    ):
        scrubs.setdefault(name, []).append((float(median), float(most), float(worst)))
    if not scrubs:
        raise Failure("no screen was scrubbed")
    slowest = max(scrubs, key=lambda n: statistics.median(most for _, most, _ in scrubs[n]))
    medians, mosts, worsts = zip(*scrubs[slowest])
    return {
        "hour-open": Figure(opened, note=f"{snapshots:,.0f} samples are looked through and {shown:,.0f} of them shown, to the first picture's data; around the position the window reads all"),
        "hour-scrub": Figure(
            list(mosts),
            note=f"{slowest}: median {statistics.median(medians):.2f}, worst {max(worsts):.2f}",
        ),
        "rrd-bytes": Figure([size_mb * 1e6 / snapshots], note="raw, calibrated, references, estimate with covariance, truth, and the arm's shape ten times a second"),
        "rrd-write": Figure([number(r"in ([\d.]+) s\n", texts[0]) / snapshots * 1e6]),
        "rrd-read": Figure([r / snapshots * 1e6 for r in read]),
    }


def memory(quick: bool) -> dict:
    if quick:
        raise Failure("left out of a quick run: it takes minutes")
    text = call("cargo", "bench", "--locked", "--bench", "long", "--", "soak")
    # What is resident swings from minute to minute: ten minutes each, not two of them.
    at_mb = {m: number(rf"\n{m} min: (\d+) MB", text) for m in range(11, 61)}
    before, in_the_end = (statistics.median(at_mb[m] for m in range(first, first + 10)) for first in (11, 51))
    swing = f"{min(at_mb.values()):.0f} to {max(at_mb.values()):.0f} MB in all; medians of the first and the last ten minutes"
    return {"memory": Figure([in_the_end - before], note=swing)}


# The window


def window(quick: bool) -> dict:
    if shutil.which("Xvfb") is None or shutil.which("xdotool") is None:
        raise Failure("Xvfb and xdotool are needed: `./test` installs them")
    try:
        starts = display.first_frames(PROGRAM, 2 if quick else 6)
        rest = display.at_rest(PROGRAM, 5 if quick else 20, 1 if quick else 3)
    except display.Trouble as e:
        raise Failure(str(e)) from None
    return {
        "first-frame": Figure([s * 1e3 for s in starts], note="the first of the starts left out"),
        "idle-operate": Figure([100 * s for s in rest["operate"]], note=rest["note"]),
        "idle-sensors": Figure([100 * s for s in rest["sensors"]]),
    }


@dataclass(frozen=True)
class Step:
    """One thing to run, and the targets that it measures; `+` before those of which it gives only the peers."""

    name: str
    run: object
    targets: tuple


def python(quick: bool) -> dict:
    call(PYTHON, "-m", "pip", "install", "--quiet", ROOT / "python", limit_s=3600)
    options = ["--poses", "500", "--starts", "20", "--mujoco", "4"] if quick else []
    found = json.loads(call(PYTHON, ROOT / "python/benches/solve.py", "--program", PROGRAM, "--json", *options))
    ours = found.pop("Robot.solve, all at once")
    scaled = "scaled from some of the poses, but for those of one start"
    peers = [(name, [time_s]) for name, time_s in found.items()]
    return {"python": Figure([ours], scaled, peers=peers)}


STEPS = [
    Step("the program", built, ("binary",)),
    Step("the window on a virtual display", window, ("first-frame", "idle-operate", "idle-sensors")),
    Step("criterion's benchmarks", hot,
         ("rod-warm", "rod-cold", "dynamics", "mesh-warm", "reach-yes", "reach-no", "solve", "frame")),
    Step("PyElastica and MuJoCo", statics, ("rod-pose", "+dynamics")),
    Step("the Python package", python, ("python",)),
    Step("PyTorch and ONNX Runtime", learning, ("epoch", "to-error", "jacobian")),
    Step("real time", real_time, ("missed", "lost")),
    Step("data sets", datasets, ("rod-20000", "mesh-20000")),
    Step("paths and moves", paths,
         ("circle-200", "circle-500", "eight-200", "eight-500", "far", "solve-path")),
    Step("the gap finder", finder, ("gap-90",)),
    Step("PySINDy", supply, ("supply-repeat", "supply-other", "supply-seconds")),
    Step("VQF", orientation, ("imu-total", "imu-tilt")),
    Step("a recording of an hour", hour, ("hour-open", "hour-scrub", "rrd-bytes", "rrd-write", "rrd-read")),
    Step("an hour of the window", memory, ("memory",)),
]  # fmt: skip
