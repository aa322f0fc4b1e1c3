"""Start a simulated robot and a side (program) that commands it, each in a separate process."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from strands_actors.testing import Twin

from . import peers
from .house import HOUSE, Figures, Side, beside

COMMAND = "from strands_actors.surfaces.cli import main; main()"
"""What ``python -c`` runs for the command ``strands-actors``."""


def run_with_twin(robot: str, module: str, *args: str, peer: str = "", timeout_s: float = 120) -> Figures:
    """Start a simulated robot, and run a side (program) that commands it.

    Args:
        robot: The robot.
        module: The side, ``benchmarks.sides.<module>``.
        *args: The first arguments of the side. The robot's port and the path of its log are added.
        peer: The peer that has the Python interpreter; empty for the interpreter of this process.
        timeout_s: Longest run time, in seconds.
    """
    python = {"python": peers.python(peer)} if peer else {}
    with tempfile.TemporaryDirectory(prefix="sa-") as directory, Twin(robot, Path(directory)) as twin:
        return beside(
            f"benchmarks.sides.{module}", *args, twin.port, str(twin.log.path), timeout_s=timeout_s, **python
        )


def side_with_twins(
    robots: dict[str, str], module: str, *args: str, peer: str = "", timeout_s: float = 120
) -> Side:
    """Return a side (program) that runs ``module`` once for each robot.

    Args:
        robots: Robots, and the prefix for the names of their figures.
        module: As for ``run_with_twin``.
        *args: As for ``run_with_twin``. The length and the robot are added before the port.
        peer: As for ``run_with_twin``.
        timeout_s: As for ``run_with_twin``, for each robot.
    """

    def side(short: bool) -> Figures:
        figures: Figures = {}
        for robot, prefix in robots.items():
            length = "short" if short else "long"
            result = run_with_twin(robot, module, *args, length, robot, peer=peer, timeout_s=timeout_s)
            figures |= {f"{prefix}_{name}": value for name, value in result.items()}
        return figures

    return side


def run_with_line(robot: str, module: str, *args: str, peer: str = "", timeout_s: float = 60) -> Figures:
    """Run a side (program) as ``run_with_twin`` does, but with a simulated servo bus that is never late
    (``sides.line``) and has no log.
    """
    python = {"python": peers.python(peer)} if peer else {}
    with tempfile.TemporaryDirectory(prefix="sa-") as directory:
        path = Path(directory) / "port"
        with subprocess.Popen(
            [sys.executable, "-m", "benchmarks.sides.line", robot, str(path)], cwd=HOUSE.parent
        ) as line:
            try:
                while not path.exists():
                    if line.poll() is not None:
                        raise RuntimeError(f"the simulated bus of {robot} ended with code {line.returncode}")
                    time.sleep(0.01)
                port = path.read_text()
                return beside(f"benchmarks.sides.{module}", *args, port, timeout_s=timeout_s, **python)
            finally:
                line.kill()


def at_home(home: str = "") -> None:
    """Use separate directories for this process' robots and e-stop locks, so that the user's own robots are not
    affected.

    Args:
        home: The directory to use; empty for a new one.
    """
    os.environ["STRANDS_ACTORS_RUN"] = home = home or tempfile.mkdtemp(prefix="sa-")
    os.environ["STRANDS_ACTORS_DATA"] = f"{home}/data"
