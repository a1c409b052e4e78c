"""What the tests share: the program, whose figures are the reference, and sessions of the virtual rig."""

from __future__ import annotations

import json
import os
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[2]
Program = Callable[..., Any]


@pytest.fixture(scope="session")
def program() -> Program:
    """The program, called with arguments: its JSON. It is at SPRINGTWIN_PROGRAM, else where cargo builds it."""
    built = ROOT / "target" / "debug" / "springtwin"
    path = Path(os.environ.get("SPRINGTWIN_PROGRAM", built))
    assert path.is_file(), f"{path} is missing: build it with `cargo build`, or name it in SPRINGTWIN_PROGRAM"

    def run(*arguments: object, fails: bool = False) -> Any:
        words = [str(path), "--json", *map(str, arguments)]
        done = subprocess.run(words, capture_output=True, text=True, cwd=ROOT)
        assert (done.returncode != 0) == fails, done.stderr
        return done.stderr if fails else json.loads(done.stdout)

    return run


@pytest.fixture(scope="session")
def sessions(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """A healthy session, and one in which spring 4 reads 6 % and 2 mm too long: those of the README."""
    import springtwin

    folder = tmp_path_factory.mktemp("sessions")
    healthy, suspect = folder / "healthy", folder / "suspect"
    springtwin.simulate_session(healthy, seconds=45)
    springtwin.simulate_session(suspect, seconds=45, seed=2, hide=["spring-calibration:4=1.06,0.002"])
    return {"healthy": healthy, "suspect": suspect, "folder": folder}
