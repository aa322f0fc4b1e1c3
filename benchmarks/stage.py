"""Run a side that drives a robot's twin, in a separate process. Questions about robots share this."""

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


def at_twin(robot: str, module: str, *args: str, peer: str = "", timeout_s: float = 120) -> Figures:
    """Run a side at a robot's twin.

    Args:
        robot: The robot.
        module: The side, ``benchmarks.sides.<module>``.
        *args: Its first arguments. The twin's port and the path of its wire log follow.
        peer: The peer with the interpreter; empty for ours.
        timeout_s: Longest run time, in seconds.
    """
    python = {"python": peers.python(peer)} if peer else {}
    with tempfile.TemporaryDirectory(prefix="sa-") as directory, Twin(robot, Path(directory)) as twin:
        return beside(
            f"benchmarks.sides.{module}", *args, twin.port, str(twin.log.path), timeout_s=timeout_s, **python
        )


def at_twins(robots: dict[str, str], module: str, *args: str, peer: str = "", timeout_s: float = 120) -> Side:
    """Return a side that runs ``module`` once for each robot.

    Args:
        robots: The prefix of the figures' names, by robot.
        module: As for ``at_twin``.
        *args: As for ``at_twin``; the length and the robot follow.
        peer: As for ``at_twin``.
        timeout_s: As for ``at_twin``, for each robot.
    """

    def side(short: bool) -> Figures:
        figures: Figures = {}
        for robot, prefix in robots.items():
            length = "short" if short else "long"
            found = at_twin(robot, module, *args, length, robot, peer=peer, timeout_s=timeout_s)
            figures |= {f"{prefix}_{name}": value for name, value in found.items()}
        return figures

    return side


def at_line(robot: str, module: str, *args: str, peer: str = "", timeout_s: float = 60) -> Figures:
    """Run a side as ``at_twin`` does, at a servo bus that is never late (``sides.line``) and has no log."""
    python = {"python": peers.python(peer)} if peer else {}
    with tempfile.TemporaryDirectory(prefix="sa-") as directory:
        where = Path(directory) / "port"
        with subprocess.Popen(
            [sys.executable, "-m", "benchmarks.sides.line", robot, str(where)], cwd=HOUSE.parent
        ) as line:
            try:
                while not where.exists():
                    if line.poll() is not None:
                        raise RuntimeError(f"the line of {robot} ended with {line.returncode}")
                    time.sleep(0.01)
                port = where.read_text()
                return beside(f"benchmarks.sides.{module}", *args, port, timeout_s=timeout_s, **python)
            finally:
                line.kill()


def at_home(home: str = "") -> None:
    """Keep the robots of this process, and the locks of their e-stops, apart from this user's other ones.

    Args:
        home: The directory to use; empty for a new one.
    """
    os.environ["STRANDS_ACTORS_RUN"] = home = home or tempfile.mkdtemp(prefix="sa-")
    os.environ["STRANDS_ACTORS_DATA"] = f"{home}/data"
