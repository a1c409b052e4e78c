#!/usr/bin/env python3
"""Prints the libraries that are linked into the program, their licences and their notices.

Run it in the repository; it asks cargo what is linked and reads what the libraries bring along.
"""

import json
import re
import subprocess
from pathlib import Path

NOTICE = re.compile(r"(licen[cs]e|copying|notice|unlicense|copyright|ofl|ufl)", re.IGNORECASE)
TEXT = {"", ".txt", ".md", ".html"}


def cargo(*args) -> str:
    return subprocess.run(["cargo", *args, "--locked"], capture_output=True, text=True, check=True).stdout


def notices(folder: Path) -> list[str]:
    """Texts of the notices in a library's folder and those in it, in the order of their names."""
    found = [*folder.glob("*"), *folder.glob("*/*")]
    files = (f for f in found if f.is_file() and NOTICE.match(f.name) and f.suffix in TEXT)
    return [f.read_text(errors="replace").strip() for f in sorted(files)]


def main() -> None:
    # Without what only builds or tests the program.
    tree = cargo("tree", "--edges", "normal", "--prefix", "none", "--format", "{p}")
    linked = {tuple(line.split()[:2]) for line in tree.splitlines() if line}
    packages = json.loads(cargo("metadata", "--format-version", "1"))["packages"]
    users: dict[str, list[str]] = {}
    for p in sorted(packages, key=lambda p: (p["name"], p["version"])):
        if p["source"] is None or (p["name"], f"v{p['version']}") not in linked:
            continue
        licence = p["license"] or "see the text below"
        by = f" by {', '.join(a.split(' <')[0] for a in p['authors'])}" if p["authors"] else ""
        print(f"{p['name']} {p['version']}{by}: {licence}")
        for text in notices(Path(p["manifest_path"]).parent):
            users.setdefault(text, []).append(p["name"])
    for text, names in users.items():
        print(f"\n{'-' * 100}\n{', '.join(dict.fromkeys(names))}\n\n{text}")


main()
