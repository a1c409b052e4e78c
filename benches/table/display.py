"""The real window on a virtual display: how soon it shows something, and what it costs at rest."""

import os
import statistics
import subprocess
import tempfile
import threading
import time
from contextlib import contextmanager
from pathlib import Path
from queue import Empty, Queue

LONGEST_S = 120  # for anything that is waited for
TICKS = os.sysconf("SC_CLK_TCK") if hasattr(os, "sysconf") else 100


class Trouble(Exception):
    """The window did not do what it should."""


def end(process) -> None:
    process.terminate()
    try:
        process.wait(10)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


@contextmanager
def virtual_display():
    server = subprocess.Popen(
        ["Xvfb", "-displayfd", "1", "-screen", "0", "1280x800x24", "-nolisten", "tcp"],
        stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True,
    )  # fmt: skip
    try:
        number = server.stdout.readline().strip()
        if not number:
            raise Trouble("Xvfb does not start")
        yield f":{number}"
    finally:
        end(server)


@contextmanager
def open_window(program: Path, display: str, home: str):
    """The program, when it was started, and its log: (process, seconds, queue of (seconds, line))."""
    log = "springtwin=info,springtwin::cli::window::device=debug,warn"
    environment = {**os.environ, "DISPLAY": display, "XDG_DATA_HOME": home, "RUST_LOG": log}
    environment.pop("WAYLAND_DISPLAY", None)
    started_s = time.monotonic()
    process = subprocess.Popen(
        [str(program), "run", "--rig", "sim"],
        env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    lines = Queue()

    def read():
        for line in process.stderr:
            lines.put((time.monotonic(), line))
        lines.put((time.monotonic(), ""))

    threading.Thread(target=read, name="log", daemon=True).start()
    try:
        yield process, started_s, lines
    finally:
        end(process)


def wait_for(lines: Queue, what: str) -> float:
    """When the log told it."""
    until_s = time.monotonic() + LONGEST_S
    last = ""
    while True:
        try:
            at_s, line = lines.get(timeout=max(0.0, until_s - time.monotonic()))
        except Empty:
            raise Trouble(f"the window did not say `{what}` within {LONGEST_S} s") from None
        if what in line:
            return at_s
        if not line:
            raise Trouble(f"the window closed before it said `{what}`: {last.strip()[:200]}")
        last = line


def first_frames(program: Path, starts: int) -> list:
    """Seconds from the start of the process to the first frame's paint, without the first start."""
    found = []
    with virtual_display() as display, tempfile.TemporaryDirectory() as home:
        for _ in range(starts):
            with open_window(program, display, home) as (_, started_s, lines):
                found.append(wait_for(lines, "the first frame has been painted") - started_s)
    return found[1:]


def busy_s(process, thread: int | None) -> float:
    """Processor time of a process, or of one of its threads."""
    place = f"/proc/{process.pid}" + (f"/task/{thread}" if thread else "")
    fields = Path(f"{place}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / TICKS


def watch(process, seconds: float):
    """Shares of a core over some seconds: the window's thread (the main one), the whole process."""
    before = busy_s(process, process.pid), busy_s(process, None)
    start_s = time.monotonic()
    time.sleep(seconds)
    passed_s = time.monotonic() - start_s
    return [
        (now - then) / passed_s
        for now, then in zip((busy_s(process, process.pid), busy_s(process, None)), before)
    ]


def press(display: str, *keys: str) -> None:
    # Without a window manager nobody gives the window the keyboard.
    find = ["search", "--onlyvisible", "--name", "springtwin", "windowfocus"]
    do(display, find, *(["key", key] for key in keys))


def by_name(display: str, action: str) -> None:
    """Does what the window's list of actions has by this name."""
    press(display, "ctrl+p")
    do(display, ["type", "--delay", "40", "--", action], ["key", "Return"])


def do(display: str, *inputs: list) -> None:
    environment = {**os.environ, "DISPLAY": display}
    for arguments in inputs:
        done = subprocess.run(["xdotool", *arguments], env=environment, capture_output=True, text=True)
        if done.returncode != 0:
            raise Trouble(f"xdotool failed: {done.stderr.strip()[:200]}")
        time.sleep(0.5)


def at_rest(program: Path, seconds: float, looks: int) -> dict:
    """Shares of a core that the window's thread takes while the arm rests at its goal."""
    with (
        virtual_display() as display,
        tempfile.TemporaryDirectory() as home,
        open_window(program, display, home) as (process, _, lines),
    ):
        wait_for(lines, "Board 2 is ready")
        time.sleep(5)
        by_name(display, "preview the home position")
        time.sleep(3)
        by_name(display, "go to the target")
        wait_for(lines, "Goal reached")
        time.sleep(5)
        operate = [watch(process, seconds) for _ in range(looks)]
        press(display, "ctrl+2")
        time.sleep(3)
        sensors = [watch(process, seconds) for _ in range(looks)]
    whole = 100 * statistics.median(whole for _, whole in operate)
    return {
        "operate": [thread for thread, _ in operate],
        "sensors": [thread for thread, _ in sensors],
        "note": f"the whole process with rig, twin and software GPU: {whole:.0f} %",
    }
