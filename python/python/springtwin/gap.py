"""The gap finder: where model and measurement disagree, which effect is missing, and by how much the gap shrinks with it.

Results mirror the files that ``springtwin gap run`` and ``gap discover`` write; every figure is the command's.
"""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path as FilePath
from typing import Any, Literal


from . import _springtwin
from ._robot import Array, Path, Robot
from ._session import SessionLike, _paths

__all__ = [
    "Baseline",
    "ChannelError",
    "Confirmed",
    "Discovery",
    "Effect",
    "FailedFold",
    "Finding",
    "FoldChoice",
    "FoundEffect",
    "FoundLaw",
    "FoundTerm",
    "GapSize",
    "Located",
    "Nearest",
    "Onset",
    "OwnEffect",
    "OwnParameter",
    "Parameter",
    "Ranked",
    "SeparateBy",
    "Traces",
    "commission",
    "discover",
    "effects",
    "find",
]

Progress = Callable[[str, float], object]
"""Takes what is being done, in a few words, and the share of it that is done. An exception ends the work."""


@dataclass(frozen=True)
class Parameter:
    """A number that was found."""

    value: float
    unit: str
    """SI; empty for a ratio."""
    ci95: tuple[float, float] | None
    """95 % interval, lower end first."""


@dataclass(frozen=True)
class FoundEffect:
    """An effect that was found."""

    id: str
    side: str
    """Where it sits."""
    target: int | None
    """Chamber, spring, IMU or segment, from 1; ``None`` for the whole."""
    params: dict[str, Parameter]
    instead_of: int | None = None
    """Place in the list of the effect that this one could be instead of."""
    chosen_by: float | None = None
    """Share of the held-out folds that chose it."""


@dataclass(frozen=True)
class Ranked:
    """A candidate, and how much better it predicts held-out data than the model without it."""

    id: str
    target: int | None
    gain: float
    """Gain in held-out log-likelihood, nats."""
    se: float
    """Its standard error."""


@dataclass(frozen=True)
class Located:
    """A residual that is correlated with a regressor."""

    residual: str
    channel: str
    regressor: str
    share: float
    """Share of the variance that it explains on held-out blocks."""


@dataclass(frozen=True)
class GapSize:
    """A gap, in the unit of the residual that shows it best, on held-out data."""

    before: float
    after: float
    floor: float
    """Of a healthy session."""
    closed: float
    """(before - after) / (before - floor)."""
    unit: str


@dataclass(frozen=True)
class ChannelError:
    """Error of a group of channels on held-out data."""

    name: str
    unit: str
    before: float
    after: float
    after_ci95: tuple[float, float]
    shuffled: float | None
    floor: float | None


@dataclass(frozen=True)
class Onset:
    """When what is missing began."""

    t_s: float
    ci95: tuple[float, float]


@dataclass(frozen=True)
class FoldChoice:
    """What was chosen in a fold of the held-out proof."""

    fold: int
    effects: list[tuple[str, int | None]]


@dataclass(frozen=True)
class FailedFold:
    """A fold that could not be computed; it counts against the effects."""

    fold: int
    of: int
    reason: str


@dataclass(frozen=True)
class Confirmed:
    """What the effects do in sessions that had no part in finding them."""

    sessions: list[str]
    before_mm: float | None
    after_mm: float | None
    closed: float
    gap: GapSize
    channels: list[ChannelError]


@dataclass(frozen=True)
class SeparateBy:
    """A motion under which the alternatives differ."""

    excitation: str
    effects: list[str]
    why: str


@dataclass(frozen=True)
class Traces:
    """Series for pictures, a row per instant; residuals in units of the noise floor."""

    t_s: Array
    """(n,)"""
    channels: list[str]
    measured_m: Array
    """(n, 3): measured end pad; NaN where it was not captured."""
    before_m: Array
    """(n, 3): simulated without the effects."""
    after_m: Array
    """(n, 3): simulated with them."""
    residual_before: Array
    """(channels, n)"""
    residual_after: Array
    """(channels, n)"""


@dataclass(frozen=True)
class Finding:
    """What was found: a mirror of ``finding.json``."""

    verdict: Literal["nothing-missing", "named", "indistinguishable", "unknown", "not-excited"]
    effects: list[FoundEffect]
    """What is to be added to the model; for ``indistinguishable`` the alternatives."""
    candidates: list[Ranked]
    """Everything that was fitted, best first."""
    threshold: float
    """Significance threshold of the gain (5 % false-positive rate), nats."""
    located: list[Located]
    gap: GapSize
    worse: list[ChannelError]
    """Channel groups that got worse on held-out data."""
    channels: list[ChannelError]
    embargo_s: float
    onset: Onset | None
    folds: list[FoldChoice]
    failed_folds: list[FailedFold]
    proof: Confirmed | None
    """What the effects do in the sessions of ``prove``."""
    separate_by: SeparateBy | None
    notes: list[str]
    """What limits the verdict, one sentence each."""
    data: dict[str, str]
    """Names and hashes of the data by role."""
    seconds: float
    """Wall time."""
    differences: list[str]
    """What differs between how baseline and session were recorded."""
    traces: Traces = field(repr=False, compare=False)
    patch_toml: str = field(repr=False)
    """The patch that brings it into the model."""
    json: str = field(repr=False, compare=False)
    """The same as the command prints it with ``--json``."""

    def save_patch(self, path: Path, *, overwrite: bool = False) -> None:
        """Writes the patch file."""
        _save(self.patch_toml, path, overwrite)


@dataclass(frozen=True)
class FoundTerm:
    """A term of a law with its coefficient."""

    id: str
    inputs: list[str]
    form: str
    coefficient: float
    unit: str
    ci95: tuple[float, float] | None
    stability: float
    """Share of the held-out folds that chose it."""
    parameters: dict[str, Parameter]


@dataclass(frozen=True)
class FoundLaw:
    """What is missing at one site."""

    site: str
    target: int | None
    equation: str
    words: str
    terms: list[FoundTerm]


@dataclass(frozen=True)
class Nearest:
    """The effect of the table that comes nearest to a law."""

    id: str
    target: int | None
    worse_by_nats: float


@dataclass(frozen=True)
class Discovery:
    """What was discovered: a mirror of ``law.json``."""

    verdict: Literal["law", "no-law"]
    laws: list[FoundLaw]
    alternatives: list[FoundLaw]
    nearest: Nearest | None
    gap: GapSize
    proof: dict[str, Any] | None
    located: list[Located]
    notes: list[str]
    data: dict[str, str]
    seconds: float
    differences: list[str]
    finding: Finding = field(repr=False)
    """The law with errors of every channel, as the finder gives them."""
    patch_toml: str = field(repr=False)
    """The patch that brings the law into the model."""
    json: str = field(repr=False, compare=False)
    """The same as the command prints it with ``--json``."""

    def save_patch(self, path: Path, *, overwrite: bool = False) -> None:
        """Writes the patch file."""
        _save(self.patch_toml, path, overwrite)


@dataclass(frozen=True)
class Baseline:
    """A healthy rig, commissioned: what :func:`find` takes in the place of its sessions."""

    rig: dict[str, float]
    """Departures from the robot file by calibration parameter, SI."""
    floor: dict[str, float | None]
    """Residuals on data that were not fitted: ``position_m``, ``rotation_rad``, ``spring_m``, ``imu_rad``."""
    warnings: list[str]
    patch_toml: str = field(repr=False)
    """The calibration parameters as a patch of the model."""
    baseline_toml: str = field(repr=False)
    """All that the finder has to know of it."""

    def save_patch(self, path: Path, *, overwrite: bool = False) -> None:
        """Writes the patch file."""
        _save(self.patch_toml, path, overwrite)

    def save(self, path: Path, *, overwrite: bool = False) -> None:
        """Writes the baseline file (``.toml``), which ``springtwin gap run --baseline`` takes, too."""
        if FilePath(os.fspath(path)).suffix != ".toml":
            raise _springtwin.Error(f"{os.fspath(path)} does not end in .toml: a baseline is recognised by it")
        _save(self.baseline_toml, path, overwrite)


@dataclass(frozen=True)
class Effect:
    """An effect of the table."""

    id: str
    name: str
    doc: str
    source: str
    parameters: list[dict[str, Any]]
    """Name, unit, nominal value and bounds of each parameter."""


def effects() -> list[Effect]:
    """The table of effects, as ``springtwin gap effects`` lists it."""
    return [Effect(**row) for row in json.loads(_springtwin.effects())]


@dataclass(frozen=True)
class OwnParameter:
    """A number of an effect of one's own."""

    name: str
    unit: str
    """SI; empty for a ratio."""
    nominal: float
    """Its value without the effect."""
    bounds: tuple[float, float]
    start: float
    """A usual value with the effect: where the search starts."""


class OwnEffect:
    """An effect that the table does not have, as a callable, for a first try with :func:`find`.

    This is slow: the finder calls it thousands of times, one call at a time. A finding with it is complete, but its patch cannot be
    applied: the program knows the effect only while the callable is there. What proves useful belongs in the library's table.

    Parameters
    ----------
    id
        Its name in the finding.
    act
        For readings ``act(t_s, values, channel, pressures_pa, springs_m, imus_ypr_rad) -> (springs_m, imus_ypr_rad)``, for pressures
        ``act(t_s, values, channel, gauges_pa) -> pressures_pa``, called by keyword. Arrays have a row per instant: (n,), (n, 6), (n, 12),
        (n, 4, 3). ``values`` are the parameters by name; ``channel`` is the index into the arrays, from 0, or ``None`` for the whole.
        With nominal values it must change nothing.
    acts_on
        ``"readings"`` of springs and IMUs, or ``"pressures"`` between gauges and chambers.
    of
        The kind of channel that it sits on one of: ``"spring"``, ``"imu"``, ``"chamber"``, or ``"whole"``.
    """

    def __init__(
        self,
        id: str,
        act: Callable[..., Any],
        *,
        acts_on: Literal["readings", "pressures"],
        of: Literal["spring", "imu", "chamber", "whole"],
        parameters: Sequence[OwnParameter],
        doc: str = "",
    ) -> None:
        if acts_on not in ("readings", "pressures"):
            raise _springtwin.Error(f"'{acts_on}' is nothing to act on: give 'readings' or 'pressures'")
        if (of == "chamber") != (acts_on == "pressures") and of != "whole":
            raise _springtwin.Error(f"an effect on {acts_on} does not sit on one {of}")
        rows = [(p.name, p.unit, p.nominal, *p.bounds, p.start) for p in parameters]
        self._own = _springtwin.OwnEffect(id, doc, acts_on, of, rows, act)
        self.id = id

    def __repr__(self) -> str:
        return f"OwnEffect({self.id!r})"


@dataclass(frozen=True)
class _Search:
    """What a search reads and writes, as the extension reads it."""

    baseline: list[str]
    sessions: list[str]
    prove: list[str]
    table: list[str] | None
    own: list[_springtwin.OwnEffect]
    seed: int
    without_cameras: bool
    out: str | None
    overwrite: bool
    simulated: bool


Sessions = SessionLike | Sequence[SessionLike]


def commission(
    sessions: Sessions,
    robot: Robot | None = None,
    *,
    accept_residual: bool = False,
    progress: Progress | None = None,
) -> Baseline:
    """Fits a healthy rig's calibration parameters, as ``springtwin gap commission`` does.

    A residual that no healthy rig has is an :class:`springtwin.Error`, unless ``accept_residual``.
    """
    rig = (Robot() if robot is None else robot)._robot
    with _paths(_list(sessions)) as paths:
        patch, baseline, figures, large = _springtwin.commission(rig, paths, progress)
    if large is not None and not accept_residual:
        raise _springtwin.Error(
            f"{large}; the model does not follow these sessions: check the robot file, the units and the calibration with "
            "`springtwin inspect`, and record the healthy rig again, or keep it with accept_residual=True"
        )
    return Baseline(**json.loads(figures), patch_toml=patch, baseline_toml=baseline)


def find(
    baseline: Sessions | Baseline | None,
    sessions: Sessions,
    robot: Robot | None = None,
    *,
    table: Sequence[str] | None = None,
    own: Sequence[OwnEffect] = (),
    prove: Sessions = (),
    seed: int = 1,
    without_cameras: bool = False,
    out: Path | None = None,
    overwrite: bool = False,
    simulated: bool = False,
    progress: Progress | None = None,
) -> Finding:
    """Finds what is missing in the model of a rig, as ``springtwin gap run`` does.

    Parameters
    ----------
    baseline
        Healthy sessions, a :class:`Baseline` or its file; ``None`` for the factory model.
    sessions
        In which something may be wrong; of several it is the same that is missing in all.
    robot
        The robot; the reference robot without one.
    table
        Ids of the effects that are tried; all of :func:`effects` without it.
    own
        Effects of your own that are tried besides.
    prove
        Sessions that have no part in the finding, to test it on.
    without_cameras
        Leave out what motion capture recorded in ``sessions``.
    out
        Folder for ``patch.toml``, ``finding.json``, ``report.html`` and ``overlay.rrd``.
    simulated
        Label the report as simulated, also when no session states it.
    """
    rig = (Robot() if robot is None else robot)._robot
    with _searched(baseline, sessions, prove, table, own, seed, without_cameras, out, overwrite, simulated) as search:
        text, patch, series = _springtwin.find(rig, search, progress)
    return _finding(text, patch, series)


def discover(
    baseline: Sessions | Baseline | None,
    sessions: Sessions,
    robot: Robot | None = None,
    *,
    table: Sequence[str] | None = None,
    prove: Sessions = (),
    seed: int = 1,
    out: Path | None = None,
    overwrite: bool = False,
    simulated: bool = False,
    progress: Progress | None = None,
) -> Discovery:
    """Finds what is missing as a law, where no effect of the table explains it, as ``springtwin gap discover`` does.

    Arguments as for :func:`find`; ``out`` receives ``law.json`` and ``forces.csv``, too.
    """
    rig = (Robot() if robot is None else robot)._robot
    with _searched(baseline, sessions, prove, table, (), seed, False, out, overwrite, simulated) as search:
        law, found, patch, series = _springtwin.discover(rig, search, progress)
    f = json.loads(law)
    finding = _finding(found, patch, series)
    return Discovery(
        verdict=f["verdict"],
        laws=[_law(x) for x in f["laws"]],
        alternatives=[_law(x) for x in f["alternatives"]],
        nearest=None if f["nearest"] is None else Nearest(**f["nearest"]),
        gap=GapSize(**f["gap"]),
        proof=f["proof"],
        located=[Located(**x) for x in f["located"]],
        notes=f["notes"],
        data=f["data"],
        seconds=f["seconds"],
        differences=f["differences"],
        finding=finding,
        patch_toml=patch,
        json=law,
    )


@contextmanager
def _searched(
    baseline: Sessions | Baseline | None,
    sessions: Sessions,
    prove: Sessions,
    table: Sequence[str] | None,
    own: Sequence[OwnEffect],
    seed: int,
    without_cameras: bool,
    out: Path | None,
    overwrite: bool,
    simulated: bool,
) -> Iterator[_Search]:
    """The files of a search while it runs."""
    healthy = [] if baseline is None or isinstance(baseline, Baseline) else _list(baseline)
    suspect, proof = _list(sessions), _list(prove)
    with ExitStack() as stack:
        paths = stack.enter_context(_paths([*healthy, *suspect, *proof]))
        first, second = len(healthy), len(healthy) + len(suspect)
        known = paths[:first]
        if isinstance(baseline, Baseline):
            folder = stack.enter_context(tempfile.TemporaryDirectory(prefix="springtwin-"))
            file = FilePath(folder) / "baseline.toml"
            file.write_text(baseline.baseline_toml)
            known = [str(file)]
        yield _Search(
            baseline=known,
            sessions=paths[first:second],
            prove=paths[second:],
            table=None if table is None else list(table),
            own=[effect._own for effect in own],
            seed=seed,
            without_cameras=without_cameras,
            out=None if out is None else os.fspath(out),
            overwrite=overwrite,
            simulated=simulated,
        )


def _list(sessions: Sessions) -> list[SessionLike]:
    if isinstance(sessions, (str, os.PathLike)) or hasattr(sessions, "columns"):
        return [sessions]
    return list(sessions)


def _save(text: str, path: Path, overwrite: bool) -> None:
    """Writes beside the file and renames, as the program does."""
    _springtwin.write_text(os.fspath(path), text, overwrite)


def _pair(ends: list[float] | None) -> tuple[float, float] | None:
    return None if ends is None else (ends[0], ends[1])


def _parameters(values: dict[str, dict[str, Any]]) -> dict[str, Parameter]:
    return {k: Parameter(v["value"], v["unit"], _pair(v.get("ci95"))) for k, v in values.items()}


def _channel(row: dict[str, Any]) -> ChannelError:
    return ChannelError(**{**row, "after_ci95": (row["after_ci95"][0], row["after_ci95"][1])})


def _effect(row: dict[str, Any]) -> FoundEffect:
    return FoundEffect(**{**row, "params": _parameters(row["params"])})


def _law(row: dict[str, Any]) -> FoundLaw:
    terms = [
        FoundTerm(**{**t, "ci95": _pair(t["ci95"]), "parameters": _parameters(t["parameters"])}) for t in row["terms"]
    ]
    return FoundLaw(**{**row, "terms": terms})


def _confirmed(row: dict[str, Any]) -> Confirmed:
    return Confirmed(**{**row, "gap": GapSize(**row["gap"]), "channels": [_channel(c) for c in row["channels"]]})


def _finding(text: str, patch: str, series: dict[str, Any]) -> Finding:
    f = json.loads(text)
    onset = f["onset"]
    return Finding(
        verdict=f["verdict"],
        effects=[_effect(x) for x in f["effects"]],
        candidates=[Ranked(**x) for x in f["candidates"]],
        threshold=f["threshold"],
        located=[Located(**x) for x in f["located"]],
        gap=GapSize(**f["gap"]),
        worse=[_channel(x) for x in f["worse"]],
        channels=[_channel(x) for x in f["channels"]],
        embargo_s=f["embargo_s"],
        onset=None if onset is None else Onset(onset["t_s"], (onset["ci95"][0], onset["ci95"][1])),
        folds=[FoldChoice(x["fold"], [(i, t) for i, t in x["effects"]]) for x in f["folds"]],
        failed_folds=[FailedFold(**x) for x in f["failed_folds"]],
        proof=None if f["proof"] is None else _confirmed(f["proof"]),
        separate_by=None if f["separate_by"] is None else SeparateBy(**f["separate_by"]),
        notes=f["notes"],
        data=f["data"],
        seconds=f["seconds"],
        differences=f.get("differences", []),
        traces=Traces(**series),
        patch_toml=patch,
        json=text,
    )
