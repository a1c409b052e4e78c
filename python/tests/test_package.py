"""The package: its version, its types against what is there, its notebook."""

from __future__ import annotations

import ast
import inspect
import re
import subprocess
import sys
from pathlib import Path

import springtwin
from conftest import ROOT
from springtwin import _springtwin

HERE = Path(__file__).resolve().parent
PACKAGE = Path(springtwin.__file__).parent


def test_the_version_is_that_of_the_program() -> None:
    [version] = re.findall(r'(?m)^version = "(.*)"', (ROOT / "Cargo.toml").read_text())
    assert springtwin.__version__ == version


def test_types_hold(tmp_path: Path) -> None:
    mypy = [sys.executable, "-m", "mypy", "--strict", "--cache-dir", str(tmp_path)]
    for what in (HERE / "typed_sample.py", ROOT / "python" / "python" / "springtwin"):
        done = subprocess.run([*mypy, str(what)], capture_output=True, text=True, cwd=HERE)
        assert done.returncode == 0, done.stdout + done.stderr


def test_wrong_types_are_found(tmp_path: Path) -> None:
    wrong = tmp_path / "wrong.py"
    wrong.write_text("import springtwin\nx: int = springtwin.Robot().name\nspringtwin.Rig(unit='one')\n")
    mypy = [sys.executable, "-m", "mypy", "--strict", "--cache-dir", str(tmp_path / "cache"), str(wrong)]
    done = subprocess.run(mypy, capture_output=True, text=True, cwd=tmp_path)
    assert done.returncode == 1 and "Found 2 errors" in done.stdout, done.stdout


def test_the_stubs_have_what_the_extension_has() -> None:
    stubs = ast.parse((PACKAGE / "_springtwin.pyi").read_text())
    stated: dict[str, set[str]] = {}
    for node in stubs.body:
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
            stated[node.name] = {f.name for f in node.body if isinstance(f, ast.FunctionDef)} - {"__init__"}
        elif isinstance(node, ast.FunctionDef):
            stated[node.name] = {a.arg for a in node.args.args}
    there: dict[str, set[str]] = {}
    for name, value in vars(_springtwin).items():
        if name.startswith("__"):
            continue
        if inspect.isclass(value):
            there[name] = {m for m in vars(value) if not m.startswith("_")}
        elif callable(value):
            there[name] = set(inspect.signature(value).parameters)
    assert stated == there | {"Error": set()}


def test_all_that_is_public_is_documented() -> None:
    for name in springtwin.__all__:
        value = getattr(springtwin, name)
        if inspect.isclass(value) or inspect.isfunction(value):
            assert inspect.getdoc(value), name
            for member, method in vars(value).items() if inspect.isclass(value) else ():
                if not member.startswith("_") and (inspect.isfunction(method) or isinstance(method, property)):
                    assert inspect.getdoc(method), f"{name}.{member}"


def test_the_notebook_runs(tmp_path: Path) -> None:
    import nbformat
    from nbclient import NotebookClient

    file = ROOT / "python" / "examples" / "notebook.ipynb"
    notebook = nbformat.read(file, as_version=4)  # type: ignore[no-untyped-call]
    NotebookClient(notebook, timeout=600, resources={"metadata": {"path": str(tmp_path)}}).execute()
    outputs = [o for cell in notebook.cells if cell.cell_type == "code" for o in cell.outputs]
    pictures = [o for o in outputs if "image/png" in o.get("data", {})]
    printed = "".join(o.get("text", "") for o in outputs)
    assert len(pictures) >= 4
    assert "spring-calibration 4" in printed
