"""Every performance target of the project: what, how much, in which unit."""

from dataclasses import dataclass

SIMULATORS = "Simulators"
CONTROL = "Sensing, learning and control"
GAP = "Gap finder"
WINDOW = "Window"
PROGRAM = "Recording and program"


@dataclass(frozen=True)
class Target:
    """One line of the table. `at_most` and `at_least` are in `unit`; without either there is no bound
    and the figure stands beside its peer's. `alone` says why there is no peer."""

    id: str
    section: str
    text: str
    unit: str
    at_most: float | None = None
    at_least: float | None = None
    alone: str = ""

    def bound(self) -> str:
        if self.at_most is not None:
            return f"<= {self.at_most:g}"
        return "-" if self.at_least is None else f">= {self.at_least:g}"

    def met(self, value: float) -> bool | None:
        if self.at_most is not None:
            return value <= self.at_most
        return None if self.at_least is None else value >= self.at_least


FROM_REST = "the peers settle from rest only: see the pose from rest"
MESH = "no package to be had solves a mesh that grows along the chambers' axes between rigid pads"
OWN = "what the project alone does"

TARGETS = [
    Target("rod-warm", SIMULATORS, "rod statics, warm", "us", 100, alone=FROM_REST),
    Target("rod-cold", SIMULATORS, "rod statics, from rest", "us", 1000, alone="see the next line"),
    Target("rod-pose", SIMULATORS, "one settled pose of a batch, from rest, processor time", "us"),
    Target("rod-20000", SIMULATORS, "20,000 rod samples", "s", 10, alone="see the line above"),
    Target("python", SIMULATORS, "10,000 settled poses from Python in one call, wall time", "s"),
    Target("dynamics", SIMULATORS, "dynamics at 1 kHz on one core, the slowest of three motions",
           "x real time", at_least=20),
    Target("rig", SIMULATORS, "the virtual rig with everything on, one core", "x real time", at_least=10, alone=OWN),
    Target("mesh-warm", SIMULATORS, "mesh sample, warm", "ms", 60, alone=MESH),
    Target("mesh-20000", SIMULATORS, "20,000 mesh samples", "min", 20, alone=MESH),
    Target("solve", CONTROL, "the controller's solve per target, from nothing", "us", 100),
    Target("solve-path", CONTROL, "the controller's solve per tick on circle and 8", "us", 100),
    Target("reach-yes", CONTROL, "reachability verdict, reachable", "us", 2000, alone=OWN),
    Target("reach-no", CONTROL, "reachability verdict, unreachable", "us", 2000, alone=OWN),
    Target("jacobian", CONTROL, "pose and 6 x 24 Jacobian, 5 networks", "us"),
    Target("epoch", CONTROL, "training 24-120-120-6, one epoch", "ms"),
    Target("to-error", CONTROL, "training 24-120-120-6 to the same error", "s"),
    Target("circle-200", CONTROL, "circle with 200 g, mean error of the tip", "mm", 1),
    Target("circle-500", CONTROL, "circle with 500 g, mean error of the tip", "mm", 2),
    Target("eight-200", CONTROL, "figure 8 with 200 g, mean error of the tip", "mm", 1),
    Target("eight-500", CONTROL, "figure 8 with 500 g, mean error of the tip", "mm", 2),
    Target("far", CONTROL, "the far move (fewer than its peer)", "steps"),
    Target("imu-total", CONTROL, "IMU orientation, the mean of three trials: total", "deg RMSE"),
    Target("imu-tilt", CONTROL, "IMU orientation, the mean of three trials: inclination", "deg RMSE"),
    Target("missed", CONTROL, "ticks of 10 ms missed in 30 s against a rig on a serial line", "ticks", 0, alone=OWN),
    Target("lost", CONTROL, "frames lost meanwhile", "frames", 0, alone=OWN),
    Target("gap-90", GAP, "one session of 90 s at 50 Hz, the slowest of three", "s", 60, alone=OWN),
    Target("supply-repeat", GAP, "measured arm: free prediction of the repeat", "psi RMSE"),
    Target("supply-other", GAP, "measured arm: free prediction of another day", "psi RMSE"),
    Target("supply-seconds", GAP, "measured arm: finding the model", "s"),
    Target("frame", WINDOW, "CPU side of a frame, mean of the slowest screen", "ms", 4, alone=OWN),
    Target("hour-open", WINDOW, "a recording of an hour opens", "s", 2, alone=OWN),
    Target("hour-scrub", WINDOW, "scrubbing it, per step: 95 % on the slowest screen", "ms", 16, alone=OWN),
    Target("memory", WINDOW, "memory that an hour at 1 kHz adds after 11 min", "MB", 20, alone=OWN),
    Target("idle-operate", WINDOW, "window's thread at rest, Operate", "% of a core", 2, alone=OWN),
    Target("idle-sensors", WINDOW, "window's thread at rest, Sensors", "% of a core", 2, alone=OWN),
    Target("first-frame", WINDOW, "start to first frame, warm, software GPU", "ms", 1000, alone=OWN),
    Target("rrd-bytes", PROGRAM, "recording, per snapshot", "bytes", alone=OWN),
    Target("rrd-write", PROGRAM, "writing it, per snapshot", "us", alone=OWN),
    Target("rrd-read", PROGRAM, "reading it, per snapshot", "us", alone=OWN),
    Target("binary", PROGRAM, "the program, stripped", "MiB", 40, alone=OWN),
]

# What other commands measure, because it takes hours or fixtures of its own.
ELSEWHERE = [
    ("naming rates, false alarms and intervals of the gap finder", "springtwin gap bench --seeds 30"),
    ("times of every fault in the table of faults", "./test faults"),
    ("24 h: memory below 20 MiB after the first hour, handles, panics",
     "springtwin soak --hours 24 --accelerate"),
    ("accuracy of sensing and control over loads, speeds, stiffnesses; the far move with and without the"
     " initial guess", "springtwin study all --out DIR"),
    ("laws beside PySINDy, gplearn and pyoperon", "python benches/peers/laws.py"),
    ("the live monitor beside principal components and change points", "python benches/peers/monitor.py"),
    ("the rod model against known results", "springtwin sim validate"),
    ("60 frames per second on a graphics card, 2560 x 1440 (NVIDIA H200: 71 on the slowest screen, Sensors)",
     "cargo bench --bench long -- drawn"),
]
