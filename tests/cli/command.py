"""Run the command, and a script with a robot, each as a real process."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from types import TracebackType
from typing import Any

import strands_actors
from tests.answers import until

PATIENCE_S = 60.0
"""Longest wait on a busy machine."""

ROOT = Path(strands_actors.__file__).parents[1]

MAIN = "from strands_actors.surfaces.cli import main; main()"

SCRIPT = """
import json, sys
from strands_actors import Robot
robot = Robot("so101", mode="real", transport="twin")
print(json.dumps(robot.connect_eagerly()), flush=True)
for line in sys.stdin:
    verb, arguments = json.loads(line)
    print(json.dumps(getattr(robot, verb)(*arguments)), flush=True)
robot.cleanup()
"""


class Command:
    """Runs ``strands-actors`` with a separate run directory."""

    def __init__(self, directory: Path) -> None:
        self.environment = {
            **os.environ,
            "PYTHONPATH": str(ROOT),
            "STRANDS_ACTORS_RUN": str(directory),
            "STRANDS_ACTORS_DATA": str(directory / "data"),
            "COLUMNS": "100",
        }
        self._mark = f"STRANDS_ACTORS_RUN={directory}".encode()

    def start(self, *arguments: str, **keywords: Any) -> subprocess.Popen[str]:
        streams = {"stdin": subprocess.DEVNULL, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
        return subprocess.Popen(
            [sys.executable, "-c", MAIN, *arguments],
            env=self.environment,
            text=True,
            **{**streams, **keywords},
        )

    def run(self, *arguments: str, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
        with self.start(*arguments, cwd=cwd) as process:
            try:
                out, err = process.communicate(timeout=2 * PATIENCE_S)
            finally:
                process.kill()
        return subprocess.CompletedProcess(arguments, process.returncode, out, err)

    def json(self, *arguments: str) -> Any:
        done = self.run(*arguments, "--json")
        assert done.returncode == 0, done.stderr
        return json.loads(done.stdout)

    def processes(self) -> list[int]:
        """Return all processes that were started with this run directory and have not ended."""
        found = []
        for entry in Path("/proc").iterdir():
            if entry.name.isdigit():
                try:
                    variables = (entry / "environ").read_bytes().split(b"\0")
                except OSError:  # the process has just ended
                    continue
                if self._mark in variables:
                    found.append(int(entry.name))
        return found

    def wait_until_gone(self) -> None:
        until(lambda: not self.processes(), f"{self.processes()} ended", PATIENCE_S)


class RobotProcess:
    """A user's script: it connects a robot, and calls one verb for each line of its input. ``expected`` is
    a part of its message when it cannot connect normally."""

    def __init__(self, command: Command, expected: str | None = None) -> None:
        self._environment = command.environment
        self._expected = expected

    def __enter__(self) -> RobotProcess:
        self.process = subprocess.Popen(
            [sys.executable, "-c", SCRIPT],
            env=self._environment,
            text=True,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
        )
        problem = self._answer()
        assert problem is None if self._expected is None else self._expected in problem, problem
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            self.process.communicate(timeout=PATIENCE_S)
        finally:
            self.process.kill()

    def call(self, verb: str, *arguments: Any) -> Any:
        assert self.process.stdin is not None
        self.process.stdin.write(json.dumps([verb, arguments]) + "\n")
        self.process.stdin.flush()
        return self._answer()

    def _answer(self) -> Any:
        assert self.process.stdout is not None
        return json.loads(self.process.stdout.readline())


def refusal_code(answer: dict[str, Any]) -> str | None:
    """Return the refusal code of an envelope; None if it is not a refusal."""
    refused = answer["content"][-1].get("json", {}).get("refused")
    return None if refused is None else str(refused["code"])
