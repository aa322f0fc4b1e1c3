"""LeRobot's own commands, unmodified, as somebody types them."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
BIN = Path(sys.executable).parent
RUN_S = 300.0
"""Of one command: the import of torch alone takes ten seconds on a busy machine."""
SINE = ("--teleop.discover_packages_path=tests.lerobot.sine", "--teleop.type=sine")


def start(command: str, home: Path, *arguments: str) -> subprocess.Popen[str]:
    """Start ``lerobot-<command>`` with a home of its own, without the network."""
    environment = {
        **os.environ,
        "HF_HOME": str(home),
        "HF_HUB_OFFLINE": "1",
        "PYTHONPATH": str(ROOT),
        "PYTHONUNBUFFERED": "1",
    }
    return subprocess.Popen(
        [str(BIN / f"lerobot-{command}"), *arguments],
        cwd=home,
        env=environment,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )


def run(command: str, home: Path, *arguments: str) -> tuple[int, str]:
    """Run it to its end; its exit code and what it said."""
    process = start(command, home, *arguments)
    try:
        said, _ = process.communicate(timeout=RUN_S)
    finally:
        process.kill()
        process.wait()
    return process.returncode, said
