"""Measures every performance target beside its peer, in one run, and prints the table.

It builds the program, installs the peers in target/peers, and writes target/bench/report.md and report.json.
Exit code: 0 when all is well, also without peers; 1 when a bound is missed or could not be measured; 2 on bad usage.
"""

import argparse
import glob
import json
import os
import platform
import shutil
import subprocess
import sys
import time
from pathlib import Path

sys.dont_write_bytecode = True

import report
import steps
from steps import PYTHON, ROOT, STEPS, TARGET, Failure, call, say

REQUIREMENTS = ROOT / "benches/peers/requirements.txt"
KEPT = ROOT / "assets/guide/bench.md"


class Parser(argparse.ArgumentParser):
    def error(self, message):
        self.exit(2, f"error: {message}\n")


def arguments():
    first, rest = __doc__.split("\n\n", 1)
    parser = Parser("./bench", description=first, epilog=rest)
    parser.add_argument("--keep", action="store_true", help="copy the report to assets/guide/bench.md")
    parser.add_argument("--quick", action="store_true", help="few repeats, only to see that it works")
    parser.add_argument(
        "--only",
        metavar="WORD",
        nargs="+",
        help="only steps with such a word in their name: " + ", ".join(s.name for s in STEPS),
    )
    options = parser.parse_args()
    if options.keep and (options.quick or options.only):
        parser.error("--keep is for a whole run: leave out --quick and --only")
    for word in options.only or ():
        if not any(word.lower() in s.name.lower() for s in STEPS):
            parser.error(f"no step has '{word}' in its name: see --help")
    return options


def build() -> None:
    say("building the program and the benchmarks")
    for command in (
        ["build", "--release", "--bin", "springtwin"],
        ["bench", "--no-run", "--bench", "hot", "--bench", "long"],
    ):
        # Not captured: a build may take a while.
        done = subprocess.run(["cargo", *command, "--locked"], cwd=ROOT, stdout=sys.stderr)
        if done.returncode != 0:
            raise Failure(f"`cargo {command[0]}` failed: see above")


def install() -> list:
    """Installs the peers, one by one where that fails together; what could not be installed."""
    say("installing the peers in target/peers")
    if not PYTHON.exists():
        call(sys.executable, "-m", "venv", PYTHON.parent.parent)
    pip = [PYTHON, "-m", "pip", "install", "--quiet"]
    try:
        call(*pip, "-r", REQUIREMENTS, limit_s=3600)
        return []
    except Failure:
        pass
    missing = []
    for line in REQUIREMENTS.read_text().split():
        try:
            call(*pip, line, limit_s=1800)
        except Failure:
            missing.append(line)
    return missing


def run_all(options):
    """Figures and versions; for each target why it has none."""
    figures, reasons, versions = {}, {}, {}
    for step in STEPS:
        if options.only and not any(w.lower() in step.name.lower() for w in options.only):
            reasons.update(dict.fromkeys(step.targets, "left out"))
            continue
        say(step.name)
        start_s = time.monotonic()
        try:
            found = step.run(options.quick)
        except Failure as e:
            reasons.update(dict.fromkeys(step.targets, str(e)))
            say(f"{step.name}: {e}")
            continue
        except Exception as e:  # a failure of one step is not one of the others
            reasons.update(dict.fromkeys(step.targets, f"{type(e).__name__}: {e}"))
            say(f"{step.name}: {type(e).__name__}: {e}")
            continue
        versions.update(found.pop("versions", {}))
        figures.update(found)
        say(f"{step.name}: {time.monotonic() - start_s:.0f} s")
    # Peers that another step measured.
    for key in [k for k in figures if k.startswith("+")]:
        if key[1:] in figures:
            figures[key[1:]].peers += figures[key].peers
        del figures[key]
    return figures, {k.lstrip("+"): v for k, v in reasons.items()}, versions


def first_line(*command) -> str:
    try:
        return call(*command).splitlines()[0].strip()
    except (Failure, IndexError):
        return "unknown"


def machine() -> dict:
    cpu, memory_gib = platform.processor() or platform.machine(), float("nan")
    for file, key in (("/proc/cpuinfo", "model name"), ("/proc/meminfo", "MemTotal")):
        try:
            text = Path(file).read_text()
        except OSError:
            continue
        value = next((x.split(":", 1)[1].strip() for x in text.splitlines() if x.startswith(key)), None)
        if value and key == "model name":
            cpu = value
        elif value:
            memory_gib = int(value.split()[0]) / 2**20
    try:
        system = platform.freedesktop_os_release()["PRETTY_NAME"]
    except (OSError, KeyError, AttributeError):
        system = platform.platform()
    return {
        "cpu": cpu,
        "cpus": len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count(),
        "memory_gib": memory_gib,
        "system": f"{system}, {platform.system()} {platform.release().split('-')[0]}",
        "load": os.getloadavg()[0],
    }


def prepare() -> None:
    os.environ["SPRINGTWIN_DATA"] = str(steps.DATA)
    os.environ["CUDA_VISIBLE_DEVICES"] = ""  # the peers, too, run on the processor
    # Drawn in software, as in the tests.
    drivers = sorted(glob.glob("/usr/share/vulkan/icd.d/lvp_icd*.json"))
    if drivers:
        os.environ.update(VK_ICD_FILENAMES=drivers[0], WGPU_BACKEND="vulkan")


def main() -> int:
    options = arguments()
    prepare()
    start_s = time.monotonic()
    here = machine()
    revision = first_line("git", "rev-parse", "--short=12", "HEAD")
    try:
        changed = bool(call("git", "status", "--porcelain", "--untracked-files=no").strip())
    except Failure:
        changed = False
    try:
        build()
    except (Failure, OSError) as e:
        print(f"error: nothing was measured: {e}", file=sys.stderr)
        return 1
    try:
        missing = install()
    except Failure as e:
        say(str(e))
        missing = REQUIREMENTS.read_text().split()
    if missing:
        say(f"not installed: {', '.join(missing)}")
    figures, reasons, versions = run_all(options)
    here["load_end"] = os.getloadavg()[0]
    names = {"torch": "PyTorch", "pyelastica": "PyElastica", "mujoco": "MuJoCo", "pysindy": "PySINDy"}
    names |= {"onnxruntime": "ONNX Runtime", "numpy": "NumPy", "python": "Python", "vqf": "VQF"}
    result = {
        "date": time.strftime("%Y-%m-%d %H:%M"),
        "revision": revision,
        "changed": changed,
        "quick": options.quick,
        "only": options.only or [],
        "minutes": (time.monotonic() - start_s) / 60,
        "machine": here,
        "versions": {
            "springtwin": first_line(steps.PROGRAM, "--version").split()[-1],
            "rustc": first_line("rustc", "--version").removeprefix("rustc "),
            **{names.get(k, k): v for k, v in versions.items() if k != "springtwin"},
        },
        "not_installed": missing,
        "rows": report.rows(figures, reasons),
    }
    folder = TARGET / "bench"
    folder.mkdir(parents=True, exist_ok=True)
    text = report.markdown(result)
    (folder / "report.json").write_text(json.dumps(result, indent=1) + "\n")
    (folder / "report.md").write_text(text)
    print(text)
    print(report.summary(result))
    unmeasured = [r for r in result["rows"] if "failed" in r and r["bound"] != "-"]
    unmeasured = [r["target"] for r in unmeasured if not r["failed"].startswith("left out")]
    if options.keep and unmeasured:
        print(f"error: the report is not kept, because this was not measured: {unmeasured[0]}", file=sys.stderr)
    elif options.keep:
        keep(folder / "report.md")
    return 1 if unmeasured or any(r["met"] is False for r in result["rows"]) else 0


def keep(file: Path) -> None:
    """Puts the report into the guide."""
    shutil.copyfile(file, KEPT)
    summary = KEPT.with_name("SUMMARY.md")
    contents = summary.read_text()
    if KEPT.name not in contents:
        summary.write_text(f"{contents}- [Targets and peers]({KEPT.name})\n")
    print(f"kept as {KEPT.relative_to(ROOT)}")


if __name__ == "__main__":
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit("stopped: no report was written")
