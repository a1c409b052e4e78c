"""What the scripts here share: running the program, and summing up repeats."""

import statistics
import subprocess
import sys


def run(path, *args, option: str) -> str:
    """What the program prints; `option` is how its place is given when it is not there."""
    command = [str(path), *map(str, args)]
    try:
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout
    except FileNotFoundError:
        sys.exit(
            f"there is no program at {path}: run `cargo build --release`, "
            f"or give its place with {option}"
        )
    except (OSError, subprocess.CalledProcessError) as e:
        why = (getattr(e, "stderr", None) or str(e)).strip()
        sys.exit(f"`{' '.join(command)}` failed: {why}")


def spread(values) -> dict:
    return {"median": statistics.median(values), "min": min(values), "max": max(values)}
