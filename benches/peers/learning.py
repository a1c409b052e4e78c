#!/usr/bin/env python3
"""Times training, and one pose with its Jacobian, in springtwin, PyTorch and ONNX Runtime.

All data are simulated. README.md beside this file says what is compared and how.
"""

import argparse
import json
import math
import os
import platform
import resource
import statistics
import subprocess
import sys
import tempfile
import time
import warnings
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent.parent
sys.dont_write_bytecode = True

try:
    import numpy as np
    import onnx
    import onnxruntime
    import pyarrow.parquet
    import torch
    from onnx import TensorProto, helper
    from safetensors import safe_open
except ImportError as e:
    sys.exit(f"{e.name} is missing: run `pip install -r benches/peers/requirements.txt`")

from program import run, spread

warnings.filterwarnings("ignore", category=FutureWarning)  # PyTorch's compiler about itself

SHIPPED = ROOT / "assets/networks/reference.safetensors"
BENCHMARK = "pose, 6 x 24 Jacobian and covariance"  # in benches/hot.rs; also criterion's folder

SAMPLES = 20_000
DATA = ["--density", "arcsine", "--payload-max", "0.5", "--force", "20", "--deviation", "0.02"]
DATA += ["--free-pads", "3"]

# What both train: the sensor map, one member.
SPRINGS, SIGNALS, POSE = 12, 24, 6
HIDDEN = [120, 120]
BATCH = 128
RATE, RATE_END = 0.002, 1e-6
SPLIT = (0.7, 0.2)
NOISE = {"spring_mm": 0.12, "imu_deg": 0.4, "imu_heading_deg": 0.4}
LONGER = (1.0, 1.5, 2.0)  # PyTorch's schedules over springtwin's, should the error not be reached

UNEVEN = 1.25  # epochs that vary more than this were disturbed

THREADS = (1, 2)
DTYPES = {"float32": torch.float32, "float64": torch.float64}
# Largest difference over the largest entry of the same block: to the reference, per type.
AGREE = {"float32": 1e-5, "float64": 1e-10}
AGREE_DIFFERENCES = 1e-6  # the reference's Jacobian to finite differences
CHECKED = 20  # samples on which every way is checked


def note(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def first_line(e: Exception) -> str:
    return (str(e).splitlines() or [type(e).__name__])[0]


# The program


class Springtwin:
    """The program, through its own commands."""

    def __init__(self, path: Path):
        self.path = path
        self.version = self._run("--version").split()[-1]

    def _run(self, *args):
        return run(self.path, *args, option="--program")

    def generate(self, file: Path) -> None:
        self._run("dataset", "generate", "--samples", SAMPLES, *DATA, "--out", file)

    def train(self, data: Path, folder: Path, epochs: int, seed: int) -> dict:
        """Trains the sensor map, and a plant of one neuron in one epoch, which the program
        cannot leave out."""
        folder.mkdir(exist_ok=True)
        recipe = folder / "recipe.toml"
        recipe.write_text(recipe_text(epochs, seed))
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        start_s = time.perf_counter()
        out = self._run(
            "train", "--recipe", recipe, "--data", data, "--overwrite", "--out", folder, "--json"
        )
        wall_s = time.perf_counter() - start_s
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        report = json.loads(out)
        stages = report.get("seconds_by_stage", {})
        busy_s = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
        return {
            "seconds": stages.get("sensor-map", report["seconds"]),
            "whole_run": "sensor-map" not in stages,
            "busy_cpus": busy_s / wall_s,
            "validation_mm": report["scores"]["smap"]["validation"]["translation_mm"]["mean"],
        }


def recipe_text(epochs: int, seed: int) -> str:
    noise = "\n".join(f"{key} = {value}" for key, value in NOISE.items())
    schedule = lambda hidden, epochs: (
        f"hidden = {hidden}\nepochs = {epochs}\npatience = {epochs}\nbatch = {BATCH}\n"
        f"learning_rate = {RATE}\nlearning_rate_end = {RATE_END:.9f}\nweight_decay = 0.0\n"
    )
    return (
        f"seed = {seed}\nmembers = 1\n\n"
        f"[split]\ntrain = {SPLIT[0]}\nvalidation = {SPLIT[1]}\nblock = 1\n\n"
        f"[noise]\n{noise}\n\n"
        f"[smap]\n{schedule(HIDDEN, epochs)}\n[plant]\n{schedule([1], 1)}"
    )


def criterion(run_cargo: bool) -> dict | None:
    """The mean of springtwin's own benchmark, seconds per call, with its 95 % interval."""
    if run_cargo:
        command = ["cargo", "bench", "--bench", "hot", "--", BENCHMARK.split(" Jacobian")[0]]
        note(f"running `{' '.join(command)}`")
        try:
            subprocess.run(command, cwd=ROOT, stdout=sys.stderr, check=True)
        except (OSError, subprocess.CalledProcessError) as e:
            sys.exit(f"the benchmark failed ({e}); --no-cargo reads the figures of an earlier run")
    target = ROOT / os.environ.get("CARGO_TARGET_DIR", "target")
    file = target / "criterion" / BENCHMARK / "new/estimates.json"
    try:
        mean = json.loads(file.read_text())["mean"]
        measured = file.stat().st_mtime
    except FileNotFoundError:
        if run_cargo:
            sys.exit(f"the benchmark left no {file}")
        return None
    interval = mean["confidence_interval"]
    return {
        "seconds": mean["point_estimate"] * 1e-9,
        "low": interval["lower_bound"] * 1e-9,
        "high": interval["upper_bound"] * 1e-9,
        "measured": time.strftime("%Y-%m-%d %H:%M", time.localtime(measured)),
        "older_than_networks": SHIPPED.exists() and measured < SHIPPED.stat().st_mtime,
    }


# Training in PyTorch


class Samples:
    """Signals (m, rad) and poses (m, rad) of a data file."""

    def __init__(self, file: Path):
        table = pyarrow.parquet.read_table(file)
        ypr = ["yaw_rad", "pitch_rad", "roll_rad"]
        signals = [f"spring{i + 1}_m" for i in range(SPRINGS)]
        signals += [f"imu{i + 1}_{angle}" for i in range(4) for angle in ypr]
        columns = lambda names: np.stack([table[n].to_numpy() for n in names], axis=1)
        self.signals = columns(signals)
        self.poses = columns(["x_m", "y_m", "z_m", *ypr])


class Noise:
    """The noise of the program's src/learn/data.rs, and the scaling after it, on whole batches."""

    def __init__(self, mean, inverse_std):
        self.spring_m = NOISE["spring_mm"] * 1e-3
        self.imu_rad = math.radians(NOISE["imu_deg"])
        self.heading_rad = math.radians(NOISE["imu_heading_deg"])
        self.mean, self.inverse_std = mean, inverse_std

    def scaled(self, signals):
        rows = signals.shape[0]
        normal = torch.randn(rows, SPRINGS + 16)
        springs = signals[:, :SPRINGS] + self.spring_m * normal[:, :SPRINGS]
        nx, ny, nz, heading = normal[:, SPRINGS:].view(rows, 4, 4).unbind(2)
        yaw, pitch, roll = signals[:, SPRINGS:].view(rows, 4, 3).unbind(2)
        sin_roll, cos_roll = roll.sin(), roll.cos()
        turn = (ny * sin_roll + nz * cos_roll) / pitch.cos().abs().clamp(min=0.1)
        ypr = torch.stack(
            [
                yaw + self.imu_rad * turn + self.heading_rad * heading,
                pitch + self.imu_rad * (ny * cos_roll - nz * sin_roll),
                roll + self.imu_rad * (nx + turn * pitch.sin()),
            ],
            dim=2,
        )
        noisy = torch.cat([springs, ypr.view(rows, 12)], dim=1)
        return (noisy - self.mean) * self.inverse_std


def predict(params, x):
    for weight, bias in zip(params[:-2:2], params[1:-2:2]):
        x = torch.tanh(torch.nn.functional.linear(x, weight, bias))
    return torch.nn.functional.linear(x, params[-2], params[-1])


def loss_of(params, x, y):
    return torch.nn.functional.mse_loss(predict(params, x), y)


class Trainer:
    """The sensor map in PyTorch: everything in memory, float32."""

    def __init__(self, samples: Samples, seed: int):
        order = np.random.default_rng(seed).permutation(len(samples.signals))
        first, second = (round(f * len(order)) for f in (SPLIT[0], sum(SPLIT)))
        train, validation = order[:first], order[first:second]
        tensor = lambda a: torch.tensor(a, dtype=torch.float32)
        signals, poses = samples.signals[train], samples.poses[train]
        sigma = np.where(
            np.arange(SIGNALS) < SPRINGS,
            NOISE["spring_mm"] * 1e-3,
            math.radians(NOISE["imu_deg"]),
        )
        self.noise = Noise(
            tensor(signals.mean(axis=0)), tensor(1 / np.hypot(signals.std(axis=0), sigma))
        )
        self.signals = tensor(signals)
        self.pose_mean, self.pose_std = tensor(poses.mean(axis=0)), tensor(poses.std(axis=0))
        self.targets = (tensor(poses) - self.pose_mean) / self.pose_std
        torch.manual_seed(seed)
        self.validation = self.noise.scaled(tensor(samples.signals[validation]))
        self.validation_m = tensor(samples.poses[validation][:, :3])
        self.start()

    def start(self) -> None:
        """New weights."""
        sizes = [SIGNALS, *HIDDEN, POSE]
        self.params = []
        for n_in, n_out in zip(sizes, sizes[1:]):
            weight = torch.empty(n_out, n_in)
            torch.nn.init.xavier_uniform_(weight)
            self.params += [weight.requires_grad_(), torch.zeros(n_out, requires_grad=True)]
        self.adam = torch.optim.Adam(self.params, lr=RATE, fused=True)

    def epoch(self, rate: float, way: dict) -> float:
        """One pass over the training part; its wall time."""
        start_s = time.perf_counter()
        for group in self.adam.param_groups:
            group["lr"] = rate
        order = torch.randperm(len(self.signals))
        signals, targets = self.signals[order], self.targets[order]
        at_once = way["noise"] == "epoch"
        inputs = self.noise.scaled(signals) if at_once else signals
        for x, y in zip(inputs.split(BATCH), targets.split(BATCH)):
            self.adam.zero_grad()
            loss = way["loss"](self.params, x if at_once else self.noise.scaled(x), y)
            loss.backward()
            self.adam.step()
        return time.perf_counter() - start_s

    @torch.no_grad()
    def validation_mm(self) -> float:
        """Mean distance between predicted and true position, with noise on the signals."""
        pose = predict(self.params, self.validation) * self.pose_std + self.pose_mean
        return float((pose[:, :3] - self.validation_m).norm(dim=1).mean()) * 1e3

    def run(self, epochs: int, way: dict) -> dict:
        """A whole schedule from new weights; looks at the error outside of the timed part."""
        torch.set_num_threads(way["threads"])
        self.start()
        seconds, errors_mm = [], []
        busy_s = 0.0
        for e in range(epochs):
            rate = RATE_END + 0.5 * (RATE - RATE_END) * (1 + math.cos(math.pi * e / epochs))
            before_s = time.process_time()
            seconds.append(self.epoch(rate, way))
            busy_s += time.process_time() - before_s
            errors_mm.append(self.validation_mm())
        return {"seconds": seconds, "errors_mm": errors_mm, "busy_cpus": busy_s / sum(seconds)}


def ways_to_train(trainer: Trainer, try_compile: bool, epochs: int) -> list:
    """PyTorch's variants with what an epoch costs, the fastest first."""
    losses = {"eager": loss_of}
    if try_compile:
        losses["compiled"] = torch.compile(loss_of, dynamic=False)
    ways = []
    for mode, loss in losses.items():
        for noise in ("epoch", "batch"):
            for threads in THREADS:
                way = {"mode": mode, "noise": noise, "threads": threads, "loss": loss}
                try:
                    trainer.run(1, way)  # compiles, fills caches
                except Exception as e:  # whatever the compiler may raise
                    if mode == "eager":
                        raise
                    note(f"torch.compile does not work here: {first_line(e)}")
                    continue
                ways.append({**way, "seconds_per_epoch": math.inf})
    for _ in range(epochs):  # in turn, so that a busy moment meets all
        for way in ways:
            (seconds,) = trainer.run(1, way)["seconds"]
            way["seconds_per_epoch"] = min(way["seconds_per_epoch"], seconds)
    return sorted(ways, key=lambda w: w["seconds_per_epoch"])


def compare_training(options, program: Springtwin, data: Path, samples: Samples) -> dict:
    ways = None
    ours, trainers, first = [], [], []
    folder = data.parent / "networks"
    program.train(data, folder, 1, 1)  # the program and the file are in memory from here on
    for seed in range(1, options.trainings + 1):  # in turn
        note(f"training {seed} of {options.trainings}")
        one = program.train(data, folder, 1, seed)
        run = program.train(data, folder, options.epochs, seed)
        run["seconds_per_epoch"] = (run["seconds"] - one["seconds"]) / (options.epochs - 1)
        ours.append(run)
        trainers.append(Trainer(samples, seed))
        if ways is None:
            ways = ways_to_train(trainers[0], options.compile, 2 if options.quick else 5)
        first.append(trainers[-1].run(options.epochs, ways[0]))
    # Runs with other seeds end a few per cent apart: the error that all of springtwin's came to.
    target_mm = max(run["validation_mm"] for run in ours)
    base_s = statistics.median(run["seconds"] for run in ours)
    base_epoch_s = statistics.median(run["seconds_per_epoch"] for run in ours)
    theirs = []
    for trainer, run in zip(trainers, first):
        whole_s = sum(run["seconds"])
        row = {
            "schedule_epochs": options.epochs,
            "seconds": None,
            "epochs": None,
            "ratio": None,
            "seconds_same_epochs": whole_s,
            "ratio_same_epochs": whole_s / base_s,
            "seconds_per_epoch": whole_s / options.epochs,
            "ratio_per_epoch": whole_s / options.epochs / base_epoch_s,
            "validation_mm": run["errors_mm"][-1],
            "busy_cpus": run["busy_cpus"],
            "mean_over_median_epoch": whole_s / options.epochs / statistics.median(run["seconds"]),
        }
        for longer in LONGER:
            row["schedule_epochs"] = round(options.epochs * longer)
            if longer > 1:
                note(f"PyTorch again, {row['schedule_epochs']} epochs")
                run = trainer.run(row["schedule_epochs"], ways[0])
            reached = [mm <= target_mm for mm in run["errors_mm"]]
            if any(reached):
                row["epochs"] = reached.index(True) + 1
                row["seconds"] = sum(run["seconds"][: row["epochs"]])
                row["ratio"] = row["seconds"] / base_s
                break
        theirs.append(row)
    tried = [{k: v for k, v in way.items() if k != "loss"} for way in ways]
    return {
        "samples": len(samples.signals),
        "epochs": options.epochs,
        "target_mm": target_mm,
        "springtwin": ours,
        "pytorch": theirs,
        "pytorch_ways": tried,
    }


# One sample


class Net:
    """One network of a model file, float64."""

    def __init__(self, tensors: dict, name: str):
        self.layers = []
        while f"{name}.weight.{len(self.layers)}" in tensors:
            l = len(self.layers)
            parts = (tensors[f"{name}.weight.{l}"], tensors[f"{name}.bias.{l}"])
            self.layers.append(tuple(p.astype(np.float64) for p in parts))
        (self.in_mean, in_std), (self.out_mean, self.out_std) = (
            tensors[f"{name}.{which}"] for which in ("input", "output")
        )
        used = in_std > 0  # a deviation of zero switches a channel off
        self.in_inverse = np.where(used, 1 / np.where(used, in_std, 1), 0.0)
        self.widths = [w.shape[1] for w, _ in self.layers] + [len(self.layers[-1][1])]

    def value(self, x):
        a = (x - self.in_mean) * self.in_inverse
        for weight, bias in self.layers[:-1]:
            a = np.tanh(weight @ a + bias)
        weight, bias = self.layers[-1]
        return self.out_mean + self.out_std * (weight @ a + bias)


class Networks:
    """The sensor maps and the correction of a model file."""

    def __init__(self, file: Path):
        with safe_open(file, "numpy") as f:
            tensors = {name: f.get_tensor(name) for name in f.keys()}
            description = json.loads(f.metadata()["springtwin"])
        self.members = [Net(tensors, f"smap.{m}") for m in range(description["members"])]
        self.correction = []
        if description["correction"] == "yes":
            self.correction = [Net(tensors, name) for name in ("translation", "rotation")]
        for nets in (self.members, self.correction):
            if any(net.widths != nets[0].widths or len(net.widths) < 3 for net in nets):
                raise ValueError("its networks do not have the same sizes, or no hidden layer")

    def pose(self, signals):
        """As the file says it, layer by layer: the reference for everything below."""
        pose = np.mean([net.value(signals) for net in self.members], axis=0)
        if not self.correction:
            return pose
        wide = len(self.correction[0].in_mean) > POSE
        x = np.concatenate([pose, signals]) if wide else pose
        return pose + np.concatenate([net.value(x) for net in self.correction])

    def jacobian(self, signals):
        """By finite differences of the fourth order."""
        columns = []
        for j in range(SIGNALS):
            h = np.zeros(SIGNALS)
            h[j] = 1e-4
            at = lambda n: self.pose(signals + n * h)
            columns.append((8 * (at(1) - at(-1)) - (at(2) - at(-2))) / (12 * h[j]))
        return np.stack(columns, axis=1)

    def stacks(self) -> list:
        """Both parts for evaluation: the members' mean, then the two corrections."""
        n = len(self.members)
        stacks = [Stack(self.members, [(range(POSE), 1 / n)] * n)]
        if self.correction:
            stacks.append(Stack(self.correction, [(range(3), 1.0), (range(3, 6), 1.0)]))
        return stacks

    def size(self) -> str:
        shape = lambda nets: f"{len(nets)} x " + "-".join(map(str, nets[0].widths))
        parts = [nets for nets in (self.members, self.correction) if nets]
        return ", correction ".join(map(shape, parts))


class Stack:
    """Networks of the same sizes that take the same input, side by side, the scaling folded in.

    | array | shape |
    |---|---|
    | first | k h x in, and k h |
    | middle | k x out x in, and k x out, per layer |
    | last | 6 x k h, and 6: also adds up what the networks answer |
    """

    def __init__(self, nets, places):
        first, middle, last = [], [], []
        bias = np.zeros(POSE)
        for net, (rows, factor) in zip(nets, places):
            weight, b = net.layers[0]
            weight = weight * net.in_inverse
            first.append((weight, b - weight @ net.in_mean))
            middle.append(net.layers[1:-1])
            weight, b = net.layers[-1]
            block = np.zeros((POSE, weight.shape[1]))
            block[rows] = factor * net.out_std[:, None] * weight
            bias[rows] += factor * (net.out_std * b + net.out_mean)
            last.append(block)
        self.k, self.inputs = len(nets), nets[0].widths[0]
        self.first = tuple(np.concatenate(part) for part in zip(*first))
        self.middle = [tuple(map(np.stack, zip(*layer))) for layer in zip(*middle)]
        self.last = (np.concatenate(last, axis=1), bias)


class TorchStack:
    """A stack in PyTorch."""

    def __init__(self, stack: Stack, dtype):
        tensors = lambda pair: tuple(torch.tensor(a, dtype=dtype) for a in pair)
        self.k, self.inputs = stack.k, stack.inputs
        self.first, self.last = tensors(stack.first), tensors(stack.last)
        self.middle = [tensors(pair) for pair in stack.middle]
        if self.k == 1:  # plain products are faster than batches of one
            self.middle = [(w[0], b[0]) for w, b in self.middle]

    def activations(self, x) -> list:
        """After every hidden layer, all networks in one vector."""
        weight, bias = self.first
        a = [torch.tanh(torch.addmv(bias, weight, x))]
        for weight, bias in self.middle:
            if self.k == 1:
                z = torch.addmv(bias, weight, a[-1])
            else:
                z = torch.baddbmm(bias.unsqueeze(2), weight, a[-1].view(self.k, -1, 1))
            a.append(torch.tanh(z).view(-1))
        return a

    def value(self, x):
        weight, bias = self.last
        return torch.addmv(bias, weight, self.activations(x)[-1])

    def values(self, x):
        """The same for rows of inputs."""
        rows = x.shape[0]
        weight, bias = self.first
        a = torch.tanh(torch.addmm(bias, x, weight.t()))
        for weight, bias in self.middle:
            if self.k == 1:
                a = torch.tanh(torch.addmm(bias, a, weight.t()))
            else:
                a = a.view(rows, self.k, -1).transpose(0, 1)
                a = torch.tanh(torch.baddbmm(bias.unsqueeze(1), a, weight.transpose(1, 2)))
                a = a.transpose(0, 1).reshape(rows, -1)
        weight, bias = self.last
        return torch.addmm(bias, a, weight.t())

    def value_and_jacobian(self, x):
        """The chain rule written out, from the output back."""
        a = self.activations(x)
        weight, bias = self.last
        y = torch.addmv(bias, weight, a[-1])
        g = weight * (1 - a[-1] * a[-1])
        for (weight, _), before in zip(reversed(self.middle), reversed(a[:-1])):
            if self.k == 1:
                g = g @ weight
            else:
                g = g.view(POSE, self.k, -1).transpose(0, 1) @ weight
                g = g.transpose(0, 1).reshape(POSE, -1)
            g = g * (1 - before * before)
        return y, g @ self.first[0]


class TorchCascade:
    """Pose and Jacobian in PyTorch, in several ways."""

    def __init__(self, stacks, signals, dtype):
        self.smap, *rest = (TorchStack(s, dtype) for s in stacks)
        self.correction = rest[0] if rest else None
        self.signals = torch.tensor(signals, dtype=dtype)
        self.eye = torch.eye(POSE, dtype=dtype)
        self.with_pose = torch.func.jacrev(lambda s: (self.pose(s),) * 2, has_aux=True)

    def set(self, signals) -> None:
        self.signals = torch.tensor(signals, dtype=self.signals.dtype)

    def pose(self, s):
        p = self.smap.value(s)
        if self.correction is None:
            return p
        x = p if self.correction.inputs == POSE else torch.cat([p, s])
        return p + self.correction.value(x)

    def poses(self, s):
        p = self.smap.values(s)
        if self.correction is None:
            return p
        x = p if self.correction.inputs == POSE else torch.cat([p, s], dim=1)
        return p + self.correction.values(x)

    def written_out(self, s):
        p, j = self.smap.value_and_jacobian(s)
        if self.correction is None:
            return p, j
        wide = self.correction.inputs > POSE
        delta, d = self.correction.value_and_jacobian(torch.cat([p, s]) if wide else p)
        whole = torch.addmm(j, d[:, :POSE], j)  # (I + dδ/dp) J
        return p + delta, whole + d[:, POSE:] if wide else whole

    # The ways; each gives pose and Jacobian at `signals`.

    def jacrev(self):
        jacobian, pose = self.with_pose(self.signals)
        return pose, jacobian

    def six_passes(self):
        s = self.signals.detach().requires_grad_()
        pose = self.pose(s)
        rows = [torch.autograd.grad(p, s, retain_graph=True)[0] for p in pose.unbind()]
        return pose.detach(), torch.stack(rows)

    def batched_pass(self):
        s = self.signals.detach().requires_grad_()
        pose = self.pose(s)
        (jacobian,) = torch.autograd.grad(pose, s, self.eye, is_grads_batched=True)
        return pose.detach(), jacobian

    def six_copies(self):
        s = self.signals.expand(POSE, SIGNALS).detach().requires_grad_()
        poses = self.poses(s)
        (jacobian,) = torch.autograd.grad(poses, s, self.eye)
        return poses[0].detach(), jacobian

    def explicit(self):
        with torch.inference_mode():
            return self.written_out(self.signals)


class OnnxCascade:
    """Pose and Jacobian as one ONNX graph, the chain rule written out."""

    def __init__(self, stacks, dtype: str):
        self.number = np.dtype(dtype)
        self.nodes, self.constants = [], []
        p, j = self._stack(stacks[0], "s")
        if len(stacks) > 1:
            wide = stacks[1].inputs > POSE
            x = self._node("Concat", p, "s", axis=1) if wide else p
            delta, d = self._stack(stacks[1], x)
            p = self._node("Add", p, delta)
            if wide:
                d = self._node("Split", d, self._index([POSE, SIGNALS]), outputs=2, axis=1)
                j = self._node("Add", self._node("Gemm", d[0], j, j), d[1])
            else:
                j = self._node("Gemm", d, j, j)
        self._node("Identity", p, names=["pose"])
        self._node("Identity", j, names=["jacobian"])
        kind = {"float32": TensorProto.FLOAT, "float64": TensorProto.DOUBLE}[dtype]
        info = lambda name, shape: helper.make_tensor_value_info(name, kind, shape)
        graph = helper.make_graph(
            self.nodes,
            "cascade",
            [info("s", [1, SIGNALS])],
            [info("pose", [1, POSE]), info("jacobian", [POSE, SIGNALS])],
            self.constants,
        )
        opset = helper.make_opsetid("", 18)
        self.model = helper.make_model(graph, opset_imports=[opset], ir_version=10)
        onnx.checker.check_model(self.model, full_check=True)

    def _constant(self, array) -> str:
        name = f"c{len(self.constants)}"
        array = np.ascontiguousarray(array)
        self.constants.append(onnx.numpy_helper.from_array(array, name))
        return name

    def _number(self, array) -> str:
        return self._constant(np.asarray(array, dtype=self.number))

    def _index(self, values) -> str:
        return self._constant(np.asarray(values, dtype=np.int64))

    def _node(self, kind, *inputs, outputs=1, names=None, **attributes):
        names = names or [f"n{len(self.nodes)}_{i}" for i in range(outputs)]
        self.nodes.append(helper.make_node(kind, list(inputs), names, **attributes))
        return names if outputs > 1 else names[0]

    def _reshape(self, x, shape) -> str:
        return self._node("Reshape", x, self._index(shape))

    def _stack(self, stack: Stack, x):
        """Nodes for a stack at x (1 x in): its answer (1 x 6) and its Jacobian (6 x in)."""
        k, one = stack.k, self._number(1.0)
        slope = lambda a: self._node("Sub", one, self._node("Mul", a, a))
        weight, bias = stack.first
        z = self._node("Gemm", x, self._number(weight.T), self._number(bias))
        a = [self._node("Tanh", z)]  # 1 x k h each
        for weight, bias in stack.middle:
            if k == 1:
                z = self._node("Gemm", a[-1], self._number(weight[0].T), self._number(bias[0]))
            else:
                z = self._reshape(a[-1], [k, 1, -1])
                z = self._node("MatMul", z, self._number(weight.transpose(0, 2, 1)))
                z = self._node("Add", z, self._number(bias[:, None]))
                z = self._reshape(z, [1, -1])
            a.append(self._node("Tanh", z))
        weight, bias = stack.last
        y = self._node("Gemm", a[-1], self._number(weight.T), self._number(bias))
        g = self._node("Mul", self._number(weight), slope(a[-1]))  # 6 x k h
        for (weight, _), before in zip(reversed(stack.middle), reversed(a[:-1])):
            if k == 1:
                g = self._node("MatMul", g, self._number(weight[0]))
            else:
                g = self._node("Transpose", self._reshape(g, [POSE, k, -1]), perm=[1, 0, 2])
                g = self._node("MatMul", g, self._number(weight))
                g = self._node("Transpose", g, perm=[1, 0, 2])
                g = self._reshape(g, [POSE, -1])
            g = self._node("Mul", g, slope(before))
        return y, self._node("MatMul", g, self._number(stack.first[0]))


class OnnxWay:
    """A session with its own number of threads, run plainly or with bound buffers."""

    def __init__(self, graph: OnnxCascade, signals, threads: int):
        settings = onnxruntime.SessionOptions()
        settings.intra_op_num_threads = threads
        settings.inter_op_num_threads = 1
        settings.execution_mode = onnxruntime.ExecutionMode.ORT_SEQUENTIAL
        settings.graph_optimization_level = onnxruntime.GraphOptimizationLevel.ORT_ENABLE_ALL
        self.session = onnxruntime.InferenceSession(
            graph.model.SerializeToString(), settings, providers=["CPUExecutionProvider"]
        )
        self.number = graph.number
        self.set(signals)

    def set(self, signals) -> None:
        self.feed = {"s": np.asarray(signals, dtype=self.number)[None]}
        value = onnxruntime.OrtValue.ortvalue_from_numpy
        self.out = [value(np.zeros(n, self.number)) for n in ((1, POSE), (POSE, SIGNALS))]
        self.binding = self.session.io_binding()
        self.binding.bind_ortvalue_input("s", value(self.feed["s"]))
        for name, out in zip(("pose", "jacobian"), self.out):
            self.binding.bind_ortvalue_output(name, out)

    def run(self):
        return self.session.run(None, self.feed)

    def run_bound(self):
        self.session.run_with_iobinding(self.binding)
        return self.out


class Way:
    """One way of getting pose and Jacobian; `usual` marks plain autograd."""

    def __init__(self, library, name, kind, dtype, threads, call, holder, usual=False):
        self.library, self.name, self.kind = library, name, kind
        self.dtype, self.threads, self.usual = dtype, threads, usual
        self.call, self.holder = call, holder
        self.seconds = []

    def answer(self, signals):
        self.holder.set(signals)
        return [np.asarray(a.numpy() if hasattr(a, "numpy") else a, float) for a in self.call()]


def ways_to_evaluate(networks: Networks, signals, try_compile: bool) -> list:
    stacks = networks.stacks()
    ways = []
    for dtype, number in DTYPES.items():
        cascade = TorchCascade(stacks, signals, number)
        eager = [
            ("torch.func.jacrev", "autograd", cascade.jacrev, True),
            ("six backward passes", "autograd", cascade.six_passes, True),
            ("one batched backward pass", "autograd", cascade.batched_pass, False),
            ("one backward pass of six copies", "autograd", cascade.six_copies, False),
            ("written out", "explicit", cascade.explicit, False),
        ]
        if try_compile:
            jacrev = torch.compile(cascade.with_pose, dynamic=False)
            explicit = torch.no_grad()(torch.compile(cascade.written_out, dynamic=False))
            eager += [
                (
                    "torch.func.jacrev, compiled",
                    "autograd",
                    lambda c=cascade, f=jacrev: f(c.signals)[::-1],
                    False,
                ),
                (
                    "written out, compiled",
                    "explicit",
                    lambda c=cascade, f=explicit: f(c.signals),
                    False,
                ),
            ]
        for name, kind, call, usual in eager:
            for threads in THREADS:
                torch.set_num_threads(threads)
                try:
                    call()
                except Exception as e:  # whatever the compiler may raise
                    if not name.endswith("compiled"):
                        raise
                    note(f"{name} ({dtype}) does not work here: {first_line(e)}")
                    continue
                ways.append(Way("PyTorch", name, kind, dtype, threads, call, cascade, usual))
        graph = OnnxCascade(stacks, dtype)
        for threads in THREADS:
            try:
                way = OnnxWay(graph, signals, threads)
            except Exception as e:
                note(f"ONNX Runtime cannot do {dtype}: {first_line(e)}")
                break
            for name, call in (("run", way.run), ("bound buffers", way.run_bound)):
                ways.append(Way("ONNX Runtime", name, "explicit", dtype, threads, call, way))
    return ways


def off(found, reference) -> float:
    """Largest difference over the largest entry of the same block: position or orientation; for
    Jacobians also by springs or orientations."""
    columns = [slice(0, SPRINGS), slice(SPRINGS, None)] if reference.ndim == 2 else [...]
    blocks = [(rows, c) for rows in (slice(0, 3), slice(3, 6)) for c in columns]
    pick = lambda a, b: a[b[0]][..., b[1]] if reference.ndim == 2 else a[b[0]]
    return max(
        float(np.abs(pick(found, b) - pick(reference, b)).max() / np.abs(pick(reference, b)).max())
        for b in blocks
    )


def check(networks: Networks, ways: list, signals) -> dict:
    """Whether all ways answer alike; the largest differences."""
    worst = {"finite_differences": 0.0, **{dtype: 0.0 for dtype in DTYPES}}
    between = 0.0
    for s in signals:
        pose, differences = networks.pose(s), networks.jacobian(s)
        answers = []
        for way in ways:
            torch.set_num_threads(way.threads)
            p, j = way.answer(s)
            answers.append((way, p.reshape(POSE), j))
        exact = next(j for w, _, j in answers if w.dtype == "float64" and w.kind == "explicit")
        worst["finite_differences"] = max(worst["finite_differences"], off(exact, differences))
        for way, p, j in answers:
            error = max(off(p, pose), off(j, exact))
            worst[way.dtype] = max(worst[way.dtype], error)
            if not error < AGREE[way.dtype]:
                sys.exit(f"{way.library}, {way.name}, {way.dtype} is off by {error:.1e}")
        for way, p, j in answers:
            if way.library != "ONNX Runtime":
                continue
            for other, q, k in answers:
                if other.library == "PyTorch":
                    between = max(between, off(p, q), off(j, k))
    if not worst["finite_differences"] < AGREE_DIFFERENCES:
        sys.exit(f"finite differences are off by {worst['finite_differences']:.1e}")
    if not between < AGREE["float32"]:
        sys.exit(f"PyTorch and ONNX Runtime differ by {between:.1e}")
    return {"samples": len(signals), **worst, "pytorch_to_onnx_runtime": between}


def time_ways(ways: list, repeats: int, repeat_s: float) -> None:
    """Wall time of a call; the ways take turns, so that a busy moment meets all."""

    def clock(way, calls):
        start_s = time.perf_counter()
        for _ in range(calls):
            way.call()
        return (time.perf_counter() - start_s) / calls

    calls = {}
    for turn in range(repeats + 1):
        for way in ways:
            if torch.get_num_threads() != way.threads:
                torch.set_num_threads(way.threads)
            if turn == 0:  # warm-up
                clock(way, 20)
                calls[way] = max(10, round(repeat_s / clock(way, 50)))
                clock(way, calls[way])
            else:
                clock(way, 10)
                way.seconds.append(clock(way, calls[way]))
            time.sleep(0.02)  # threads that wait for work by spinning give up


def compare_single(options, samples: Samples, networks: Networks, shipped: bool) -> dict:
    note("one sample: building and checking")
    ways = ways_to_evaluate(networks, samples.signals[0], options.compile)
    agreement = check(networks, ways, samples.signals[1 : 1 + CHECKED])
    for way in ways:
        way.holder.set(samples.signals[0])
    ours = criterion(options.cargo)
    note("one sample: timing")
    time_ways(ways, options.repeats, 0.02 if options.quick else 0.1)
    comparable = ours is not None and shipped
    rows = [
        {
            "library": way.library,
            "way": way.name,
            "kind": way.kind,
            "usual": way.usual,
            "dtype": way.dtype,
            "threads": way.threads,
            "seconds": spread(way.seconds),
            "ratio": statistics.median(way.seconds) / ours["seconds"] if comparable else None,
        }
        for way in ways
    ]
    fastest = lambda accept: min(filter(accept, rows), key=lambda r: r["seconds"]["median"])
    groups = {
        "PyTorch, usual autograd (jacrev or six backward passes)": lambda r: r["usual"],
        "PyTorch, any autograd": lambda r: r["kind"] == "autograd",
        "PyTorch, written out": lambda r: r["library"] == "PyTorch" and r["kind"] == "explicit",
        "ONNX Runtime, written out": lambda r: r["library"] == "ONNX Runtime",
    }
    best = []
    for group, belongs in groups.items():
        for dtype in DTYPES:
            accept = lambda r: belongs(r) and r["dtype"] == dtype
            if any(map(accept, rows)):
                best.append({"group": group, **fastest(accept)})
    return {
        "networks": networks.size(),
        "shipped": shipped,
        "repeats": options.repeats,
        "agreement": agreement,
        "springtwin": ours,
        "ways": rows,
        "fastest": best,
    }


# The report


def cpu_name() -> str:
    try:
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()


def table(head, rows, words=1) -> str:
    """Markdown; the first columns are words, the others numbers."""
    cells = [head, ["---"] * words + ["---:"] * (len(head) - words), *rows]
    return "\n".join("| " + " | ".join(map(str, row)) + " |" for row in cells)


def ranged(values, digits: int) -> str:
    values = list(values)
    if None in values:
        return "not reached"
    middle, low, high = (f"{x:.{digits}f}" for x in spread(values).values())
    return middle if low == high else f"{middle} ({low}-{high})"


def show_training(r: dict) -> None:
    ours, theirs, ways, epochs = r["springtwin"], r["pytorch"], r["pytorch_ways"], r["epochs"]
    sizes = "-".join(map(str, [SIGNALS, *HIDDEN, POSE]))
    seeds = "one seed" if len(ours) == 1 else f"{len(ours)} seeds: median (range)"
    print(
        f"\n## Training the sensor map\n\n{sizes}, {r['samples']} samples, batches of {BATCH}, "
        f"{epochs} epochs, {seeds}\n"
    )
    of = lambda runs, key, factor=1: [x and x * factor for x in (run[key] for run in runs)]
    name = lambda w: f"{w['mode']}, noise per {w['noise']}, threads: {w['threads']}"
    columns = [
        (f"to {r['target_mm']:.3f} mm, s", "seconds", 1, 2),
        ("epochs for it", "epochs", 1, 0),
        (f"{epochs} epochs, s", "seconds_same_epochs", 1, 2),
        ("ms per epoch", "seconds_per_epoch", 1e3, 1),
        (f"validation error after {epochs}, mm", "validation_mm", 1, 3),
        ("CPUs kept busy", "busy_cpus", 1, 2),
    ]
    ours = [{**run, "epochs": epochs, "seconds_same_epochs": run["seconds"]} for run in ours]
    rows = [
        [who, *(ranged(of(runs, key, factor), digits) for _, key, factor, digits in columns)]
        for who, runs in (("springtwin", ours), (f"PyTorch, {name(ways[0])}", theirs))
    ]
    ratios = [ranged(of(theirs, k), 2) for k in ("ratio", "ratio_same_epochs", "ratio_per_epoch")]
    rows.append(["ratio, PyTorch to springtwin", ratios[0], "", *ratios[1:], "", ""])
    print(table(["", *(head for head, *_ in columns)], rows))
    basis = "its stage's own time"
    if any(of(ours, "whole_run")):
        basis = "the whole run, with a plant of one neuron (this program gives no time by stage)"
    schedules = ", ".join(map(str, sorted({run["schedule_epochs"] for run in theirs})))
    print(
        f"\nspringtwin's seconds: {basis}; per epoch without reading and scoring. "
        f"PyTorch's schedules for the error: {schedules} epochs.\n"
    )
    uneven = max(of(theirs, "mean_over_median_epoch"))
    if uneven > UNEVEN or min(of(ours, "busy_cpus")) < 1 / UNEVEN:
        print(
            f"**The machine was busy**: PyTorch's mean epoch took {uneven:.2f} times its median "
            f"one, springtwin kept {min(of(ours, 'busy_cpus')):.2f} CPUs busy. Run this on a "
            "quiet one.\n"
        )
    print("What an epoch costs in PyTorch's variants (the fastest was taken):\n")
    rows = [[name(w), f"{w['seconds_per_epoch'] * 1e3:.1f}"] for w in ways]
    print(table(["variant", "ms"], rows))


def show_single(r: dict) -> None:
    ours, a = r["springtwin"], r["agreement"]
    micros = lambda s: f"{s['median'] * 1e6:.1f} ({s['min'] * 1e6:.1f}-{s['max'] * 1e6:.1f})"
    ratio = lambda x: "-" if x is None else f"{x:.1f}"
    print(
        f"\n## Pose and 6 x 24 Jacobian of one sample\n\nNetworks: {r['networks']}. "
        f"{r['repeats']} repeats: median (range).\n"
    )
    rows = []
    if ours:
        ci = f"{ours['seconds'] * 1e6:.1f} ({ours['low'] * 1e6:.1f}-{ours['high'] * 1e6:.1f})"
        rows.append(["springtwin, with covariance (criterion's mean, 95 % interval)"])
        rows[0] += ["float64, Jacobian float32", "1", ci, "1.0" if r["shipped"] else "-"]
    for x in r["fastest"]:
        row = [f"{x['group']}: {x['way']}", x["dtype"], x["threads"], micros(x["seconds"])]
        rows.append([*row, ratio(x["ratio"])])
    head = ["type", "threads", "microseconds", "ratio to springtwin"]
    print(table(["fastest of each kind", *head], rows, words=2))
    if ours is None:
        print("\nspringtwin's benchmark has not been run: no ratios.")
    else:
        print(f"\nspringtwin's figure was measured on {ours['measured']}.")
        if not r["shipped"]:
            print("It is for the shipped networks, not for these: no ratios.")
        elif ours["older_than_networks"]:
            print("The networks' file is newer than that figure: run without --no-cargo.")
    print("\nAll of them:\n")
    rows = [
        [f"{x['library']}: {x['way']}", x["kind"], x["dtype"], x["threads"], micros(x["seconds"])]
        + [ratio(x["ratio"])]
        for x in r["ways"]
    ]
    print(table(["way", "kind", *head], rows, words=3))
    print(
        f"\nAgreement over {a['samples']} samples, largest difference over the largest entry of "
        f"the block: float64 {a['float64']:.1e}, float32 {a['float32']:.1e}, PyTorch to ONNX "
        f"Runtime {a['pytorch_to_onnx_runtime']:.1e}, Jacobian to finite differences "
        f"{a['finite_differences']:.1e}. Not checked against springtwin itself: no command prints "
        "a pose."
    )


def show(r: dict) -> None:
    v, m = r["versions"], r["machine"]
    print(
        f"{m['cpu']}, {m['cpus']} CPUs, load {m['load']:.1f} at the start; {m['system']}\n"
        f"springtwin {v['springtwin']}, PyTorch {v['torch']}, ONNX Runtime {v['onnxruntime']}, "
        f"onnx {v['onnx']}, Python {v['python']}, numpy {v['numpy']}\n"
        f"wall time; PyTorch and ONNX Runtime with {' and '.join(map(str, THREADS))} threads, "
        f"{'with' if r['compile'] else 'without'} torch.compile; all data simulated"
    )
    show_training(r["training"])
    show_single(r["single"])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--program", type=Path, default=ROOT / "target/release/springtwin")
    parser.add_argument("--model", type=Path, default=SHIPPED, help="for the single sample")
    parser.add_argument("--epochs", type=int, help="springtwin's; 200, or 6 with --quick")
    parser.add_argument("--trainings", type=int, help="with other seeds; 5, or 1 with --quick")
    parser.add_argument("--repeats", type=int, help="of the single sample; 15, or 3 with --quick")
    parser.add_argument(
        "--no-cargo",
        dest="cargo",
        action="store_false",
        help="read what an earlier `cargo bench` left instead of running it",
    )
    parser.add_argument("--no-compile", dest="compile", action="store_false")
    parser.add_argument("--quick", action="store_true", help="only to see that it works")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    for key, usual, quick in (("epochs", 200, 6), ("trainings", 5, 1), ("repeats", 15, 3)):
        if getattr(options, key) is None:
            setattr(options, key, quick if options.quick else usual)
    options.compile &= not options.quick
    if options.epochs < 2 or options.trainings < 1 or options.repeats < 1:
        parser.error("epochs from 2, trainings and repeats from 1")
    model = options.model.resolve()
    try:
        networks = Networks(model)
        shipped = SHIPPED.exists() and model.read_bytes() == SHIPPED.read_bytes()
    except Exception as e:  # safetensors has errors of its own
        sys.exit(f"the network file {options.model} cannot be used: {e}")
    program = Springtwin(options.program.resolve())
    load = os.getloadavg()[0]
    with tempfile.TemporaryDirectory() as folder:
        data = Path(folder) / "simulated.parquet"
        program.generate(data)
        samples = Samples(data)
        training = compare_training(options, program, data, samples)
    single = compare_single(options, samples, networks, shipped)
    result = {
        "simulated": True,
        "versions": {
            "springtwin": program.version,
            "torch": torch.__version__,
            "onnx": onnx.__version__,
            "onnxruntime": onnxruntime.__version__,
            "python": platform.python_version(),
            "numpy": np.__version__,
        },
        "machine": {
            "cpu": cpu_name(),
            "cpus": os.cpu_count(),
            "load": load,
            "system": platform.platform(),
        },
        "threads": THREADS,
        "compile": options.compile,
        "training": training,
        "single": single,
    }
    if options.json:
        print(json.dumps(result))
    else:
        show(result)


if __name__ == "__main__":
    main()
