"""Install packages for one test once into a separate folder in the user's cache. It is put on the path of a
child process, so our environment stays unchanged."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

MADE_S = 300.0


def installed(name: str, packages: Sequence[str]) -> Path:
    """Return the folder. ``packages`` are pinned and are installed without their dependencies."""
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "strands-actors-tests"
    target = cache / f"{name}-{'-'.join(packages).replace('==', '-')}-{sys.version_info[1]}"
    if not (target / "made").exists():
        install = [sys.executable, "-m", "uv", "--quiet", "--no-config", "pip", "install", "--no-deps"]
        subprocess.run([*install, "--target", str(target), *packages], check=True, timeout=MADE_S)
        (target / "made").touch()
    return target


def run_with(target: Path, program: str, *arguments: str, within_s: float) -> str:
    """Run a program that imports these packages. Return its output."""
    done = subprocess.run(
        [sys.executable, "-c", program, *arguments],
        env={**os.environ, "PYTHONPATH": str(target)},
        capture_output=True,
        text=True,
        timeout=within_s,
    )
    assert done.returncode == 0, done.stderr or done.stdout
    return done.stdout
