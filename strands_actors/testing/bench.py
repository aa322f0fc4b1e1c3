"""A robot to break: its twin, and a caller that moves it, as processes of their own.

The twin is kept from cell to cell, and so is the caller where it has not been broken itself.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import Any

from strands_actors.factory import plan
from strands_actors.runtime.contract import Driver
from strands_actors.supervisors.census import ALLOW_FAULTS

from .registering import where_is
from .twin import Twin
from .wirelog import WireLog

START_S = 60.0
"""Within which a caller's robot moves, on a busy machine."""


class NotMoving(Exception):
    """The caller ended before its robot moved."""


class Caller:
    """``testing.caller`` as a process."""

    def __init__(self, directory: Path, wanted: dict[str, str]) -> None:
        self.trigger = directory / "trigger"
        self.tree: dict[str, Any] = {}
        self.run_dir = directory / "run"
        self._errors = directory / "caller.err"
        environment = {
            **os.environ,
            "STRANDS_ACTORS_RUN": str(self.run_dir),
            ALLOW_FAULTS: "1",
            "PYTHONPATH": os.pathsep.join(path for path in sys.path if path),
        }
        with self._errors.open("w") as errors:
            self.process = subprocess.Popen(
                [
                    sys.executable,
                    "-m",
                    "strands_actors.testing.caller",
                    json.dumps({**wanted, "trigger": str(self.trigger)}),
                ],
                env=environment,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=errors,
                text=True,
                start_new_session=True,
            )

    def pid(self, role: str) -> int:
        """Raise ``NotMoving`` when the tree has no such process."""
        for entry in self.tree["processes"]:
            if entry["role"] == role:
                found: int = entry["pid"]
                return found
        raise NotMoving(f"there is no {role} process")

    def line(self) -> dict[str, Any]:
        """What it says next. Raise ``NotMoving`` when it has ended."""
        assert self.process.stdout is not None
        text = self.process.stdout.readline()
        if not text:
            raise NotMoving(self._errors.read_text().strip() or "the caller ended before its robot moved")
        told: dict[str, Any] = json.loads(text)
        return told

    def tell(self, line: str) -> None:
        assert self.process.stdin is not None
        with contextlib.suppress(BrokenPipeError):  # its end is seen at the next line it does not say
            self.process.stdin.write(line + "\n")
            self.process.stdin.flush()

    def policy_broke_ns(self) -> int:
        told = Path(f"{self.trigger}.t")
        return int(told.read_text() or 0) if told.exists() else 0

    def forget_trigger(self) -> None:
        for path in (self.trigger, Path(f"{self.trigger}.t")):
            path.unlink(missing_ok=True)

    def end(self) -> None:
        self.process.kill()
        for entry in self.tree.get("processes", ()):
            with contextlib.suppress(ProcessLookupError):
                os.kill(entry["pid"], signal.SIGKILL)
        self.process.communicate()


class Bench:
    """``driver_class``: of a robot that this package does not know by itself. ``far``: how far the first joint
    moves, in the driver's units."""

    def __init__(self, robot: str, driver_class: type[Driver] | None = None, far: float | None = None) -> None:
        self.robot = robot
        self._driver_class = driver_class
        self.driver = driver_of(robot, driver_class)
        self.far = far if far is not None else 10.0 if "degrees" in self.driver.unit else 0.1
        self._caller: Caller | None = None

    def __enter__(self) -> Bench:
        with contextlib.ExitStack() as stack:
            self._directory = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="sa-")))
            self.twin = stack.enter_context(Twin(self.robot, self._directory, driver=self._driver_class))
            self._stack = stack.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.drop()
        self._stack.close()

    @property
    def log(self) -> WireLog:
        return self.twin.log

    def drop(self) -> None:
        """End the caller, and its tree."""
        if self._caller is not None:
            self._caller.end()
            self._caller = None

    def moving(self, motion: str) -> Caller:
        """A caller whose robot moves: the present one again, or a new one. Raise ``NotMoving``."""
        self.twin.go_on()
        self.twin.fault("ok")
        self.twin.plug()
        caller = self._caller
        if caller is not None and caller.process.poll() is None:
            caller.forget_trigger()
            os.truncate(self.log.path, 0)  # a log that is read again and again is kept short
            caller.tell(f"again {motion}")
            try:
                caller.tree = caller.line()
                return caller
            except NotMoving:
                pass
        self.drop()
        self._wait_for_silence()
        os.truncate(self.log.path, 0)
        caller = self._caller = Caller(self._directory, self._wanted(motion))
        caller.forget_trigger()
        try:
            caller.tree = caller.line()
        except NotMoving:
            self.drop()
            raise
        return caller

    def _wanted(self, motion: str) -> dict[str, str]:
        where = "" if self._driver_class is None else where_is(self._driver_class)
        return {
            "robot": self.robot,
            "port": self.twin.port,
            "driver": where,
            "motion": motion,
            "far": str(self.far),
        }

    def _wait_for_silence(self) -> None:
        """Until nobody of the tree before writes any more: its processes were killed one after the other."""
        deadline_s = time.monotonic() + 2.0
        while time.monotonic() < deadline_s:
            since_ns = time.monotonic_ns() - 200_000_000
            if not any(entry.sender == "host" for entry in self.log.entries(since_ns)):
                return
            time.sleep(0.05)


@contextlib.contextmanager
def moving_robot(robot: str, motion: str = "loop") -> Iterator[tuple[Bench, Caller]]:
    """One bench with a moving robot on it."""
    with Bench(robot) as bench:
        yield bench, bench.moving(motion)


def driver_of(robot: str, driver_class: type[Driver] | None = None) -> Driver:
    """The driver of ``robot`` on its twin."""
    if driver_class is not None:
        return driver_class(robot, "", driver_class.resolve(robot, {}))
    wanted = plan(robot, "real", transport="twin")
    return wanted.driver_class(wanted.robot, "", wanted.options)
