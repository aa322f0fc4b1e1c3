"""A host that keeps one simulated robot, for trials in which the caller attaches itself to the robot."""

from __future__ import annotations

import json
import select
import signal
import subprocess
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from strands_actors.kernel.processes.interpreter import PYTHON

START_S = 60.0
"""Seconds until the robot of the host is up, on a busy machine."""
_COMMAND = "import sys; from strands_actors.surfaces.cli import run; sys.exit(run(sys.argv[1:]))"


class HostFailed(Exception):
    """The host has ended, or its robot does not come up."""


class HostedRobot:
    """The process ``strands-actors up`` with one robot, which has the name of its type.

    Args:
        directory: Directory for the files of the host.
        environment: The environment of the host.
        robot: The type of the robot.
        port: The port of its simulated version.
        options: Options of the driver.
        cameras: Cameras of the robot, as in ``Robot(cameras=...)``.

    Raises:
        HostFailed: The robot does not come up.
    """

    def __init__(
        self,
        directory: Path,
        environment: Mapping[str, str],
        robot: str,
        port: str,
        options: Mapping[str, Any],
        cameras: Mapping[str, Any],
    ) -> None:
        file = directory / "fleet.toml"
        settings = {"type": robot, "port": port, **options, **({"cameras": cameras} if cameras else {})}
        lines = [f"{key} = {_toml(value)}" for key, value in settings.items()]
        file.write_text("\n".join(["[host]", "metrics = false", f"[robot.{robot}]", *lines]) + "\n")
        errors = directory / "host.err"
        with errors.open("w") as stderr:
            self._process = subprocess.Popen(
                [*PYTHON, "-c", _COMMAND, "up", str(file), "--json"],
                env=environment,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=stderr,
                text=True,
            )
        assert self._process.stdout is not None
        ready = select.select([self._process.stdout], [], [], START_S)[0]
        line = self._process.stdout.readline() if ready else ""
        robots = json.loads(line)["robots"] if line else []
        if [each["phase"] for each in robots] != ["up"]:
            self.end()
            raise HostFailed(f"the host does not keep {robot}: {errors.read_text().strip() or robots}")

    def end(self) -> None:
        """Kill the host, and wait for its end."""
        self._process.send_signal(signal.SIGKILL)
        self._process.communicate()


def _toml(value: Any) -> str:
    """Return a value as TOML on one line."""
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{key} = {_toml(part)}" for key, part in value.items()) + "}"
    return json.dumps(value)
