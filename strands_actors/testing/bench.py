"""A bench: a twin, and a caller that moves it, as separate processes, for tests that break one of them.

The twin is kept from cell to cell. So is the caller, unless it was broken itself. Then a new one is forked.
"""

from __future__ import annotations

import contextlib
import json
import os
import select
import signal
import tempfile
import time
from collections.abc import Iterable, Iterator
from pathlib import Path
from types import TracebackType
from typing import Any

from strands_actors.caller.resolve.planning import plan
from strands_actors.contract.driver import Driver
from strands_actors.kernel.processes.interpreter import environment
from strands_actors.supervisors.introspection import ALLOW_FAULTS

from .faults import Victims
from .queueing import Queue
from .recorder_process import RecorderProcess
from .registering import class_of, column, where_is
from .still_camera import SETTINGS
from .template import Template
from .twin import Twin
from .wirelog import WireLog

START_S = 60.0
"""Seconds until a caller's robot moves, on a busy machine."""
CAMERA, RECORDER = "camera/eye", "recorder"
"""Roles of processes that a robot has only on request."""
EXTRAS = frozenset({CAMERA, RECORDER})
COMPLETE_S = 20.0
"""Seconds until all processes of the tree run. A camera starts only after the robot, and starts again after it
was killed."""

SILENT_NS = 200_000_000
"""A host that has sent nothing for so long (ns) sends nothing more: no host has a longer period."""


class NotMoving(Exception):
    """The caller ended before its robot moved, or the robot cannot be brought to move."""


class Caller:
    """The script ``testing.caller`` as a process."""

    def __init__(self, directory: Path, template: Template, wanted: dict[str, Any], extras: frozenset[str]) -> None:
        """Fork a caller.

        Args:
            directory: For its files.
            template: The process that forks it.
            wanted: Its settings (``testing.caller``).
            extras: The roles from ``EXTRAS`` that its robot has.
        """
        self.extras = extras
        self._recorder: RecorderProcess | None = None
        self._roles = frozenset[str]()
        self.trigger = directory / "trigger"
        self.tree: dict[str, Any] = {}
        self.run_dir = directory / "run"
        self._errors = directory / "caller.err"
        its_input, self._input = os.pipe()
        self._output, its_output = os.pipe()
        self._said = b""
        with self._errors.open("w") as errors:
            try:
                request = {**wanted, "trigger": str(self.trigger)}
                self.process = template.fork(request, its_input, its_output, errors.fileno())
            finally:
                os.close(its_input)
                os.close(its_output)

    def pid(self, role: str) -> int:
        """Return the process id of a role. Raise ``NotMoving`` if the tree has no such process."""
        process_id = self.pids().get(role)
        if process_id is None:
            raise NotMoving(f"there is no {role} process")
        return process_id

    def pids(self) -> dict[str, int]:
        """Return the process id of each role, as of the moment when the robot began to move."""
        return {entry["role"]: entry["pid"] for entry in self.tree.get("processes", ())}

    def _living(self) -> set[str]:
        """Return the roles of processes that still run."""
        return {role for role, pid in self.pids().items() if Path(f"/proc/{pid}").exists()}

    def complete(self) -> None:
        """Wait until the tree has its extras, and every process that it ever had.

        Raises:
            NotMoving: A process is still missing after ``COMPLETE_S``.
        """
        if self._recorder is not None and not self._recorder.alive:
            self._end_recorder()
        if RECORDER in self.extras and self._recorder is None:
            self._recorder = RecorderProcess(self.tree["robot"], self.run_dir)
        deadline_s = time.monotonic() + COMPLETE_S
        while missing := (self.extras | self._roles) - self._living():
            if time.monotonic() > deadline_s:
                raise NotMoving(f"there is no {', '.join(missing)} process")
            time.sleep(0.05)
            self.tell("tree")
            self.tree = self.line()
        self._roles = frozenset(self.pids())

    def line(self) -> dict[str, Any]:
        """Return the next JSON line of the caller.

        Raises:
            NotMoving: The caller has ended, or prints nothing for ``START_S``.
        """
        deadline_s = time.monotonic() + START_S
        while not (text := self._next_line(deadline_s)).startswith(b"{"):
            pass  # vendor libraries print there, too
        message: dict[str, Any] = json.loads(text)
        return message

    def _next_line(self, deadline_s: float) -> bytes:
        while b"\n" not in self._said:
            left_s = max(0.0, deadline_s - time.monotonic())
            if not select.select([self._output], [], [], left_s)[0]:
                raise NotMoving(f"the caller said nothing for {START_S:g} s")
            data = os.read(self._output, 65536)
            if not data:
                raise NotMoving(self._errors.read_text().strip() or "the caller ended before its robot moved")
            self._said += data
        text, _, self._said = self._said.partition(b"\n")
        return text

    def tell(self, line: str) -> None:
        """Send an order to the caller (``testing.caller``), as one line. Ignore that the caller has ended."""
        # The next read notices that the caller has ended.
        with contextlib.suppress(BrokenPipeError):
            os.write(self._input, line.encode() + b"\n")

    def policy_broke_ns(self) -> int:
        """Return when the policy broke (CLOCK_MONOTONIC, ns); 0 if it has not broken."""
        note = Path(f"{self.trigger}.t")
        return int(note.read_text() or 0) if note.exists() else 0

    def forget_trigger(self) -> None:
        """Remove the files of the last fault of a policy, so that the next policy runs."""
        for path in (self.trigger, Path(f"{self.trigger}.t")):
            path.unlink(missing_ok=True)

    def end(self) -> None:
        """Kill the caller, its recorder, and every process of its tree."""
        self._end_recorder()
        self.process.end()
        for pid in self.pids().values():
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        os.close(self._input)
        os.close(self._output)

    def _end_recorder(self) -> None:
        if self._recorder is not None:
            self._recorder.end()
            self._recorder = None


class Bench:
    """A twin and a caller of one robot. Use it as a context manager.

    Args:
        robot: Its name, or ``robot:level`` for one that can be commanded in two ways.
        driver_class: The driver of a robot that is no part of this package.
        far: How far the first joint moves, in the driver's units. By default 10 degrees, or 0.1 of another
            unit.
    """

    def __init__(self, robot: str, driver_class: type[Driver] | None = None, far: float | None = None) -> None:
        self.robot, where = column(robot)
        self._driver_class = driver_class or class_of(where)
        self.driver = driver_of(self.robot, self._driver_class)
        self.far = far if far is not None else 10.0 if "degrees" in self.driver.unit else 0.1
        self._caller: Caller | None = None

    def __enter__(self) -> Bench:
        with contextlib.ExitStack() as stack:
            self._directory = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="sa-")))
            self._twins = stack.enter_context(contextlib.ExitStack())
            self._begin_twin()
            self.template = self._make_template()
            stack.callback(self.template.close)
            self._stack = stack.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.drop()
        self._stack.close()

    @property
    def log(self) -> WireLog:
        """The twin's log of the wire."""
        return self.twin.log

    def drop(self) -> None:
        """End the caller and its tree."""
        if self._caller is not None:
            self._caller.end()
            self._caller = None

    def moving(self, motion: str, extras: frozenset[str] = frozenset()) -> Caller:
        """Return a caller whose robot moves: the present one, or a new one.

        Args:
            motion: ``loop``, ``task`` or ``rollout`` (``testing.caller``).
            extras: The roles from ``EXTRAS`` that its tree must have.

        Raises:
            NotMoving: The robot cannot be brought to move.
        """
        self.twin.go_on()
        self.twin.fault("ok")
        self.twin.plug()
        caller = self._caller
        if caller is not None and caller.process.alive and caller.extras == extras:
            caller.forget_trigger()
            # The log is read again and again, so it is kept short.
            os.truncate(self.log.path, 0)
            caller.tell(f"again {motion}")
            try:
                caller.tree = caller.line()
                caller.complete()
                return caller
            except NotMoving:
                pass
        self.drop()
        self._wait_for_silence()
        os.truncate(self.log.path, 0)
        caller = self._caller = Caller(self._directory, self.template, self._wanted(motion, extras), extras)
        caller.forget_trigger()
        try:
            caller.tree = caller.line()
            caller.complete()
        except NotMoving:
            self.drop()
            # A hold with wrong readings may have left a joint at a position in which it cannot be armed.
            self._begin_twin()
            raise
        return caller

    def _begin_twin(self) -> None:
        """Start a twin in place of the previous one."""
        self._twins.close()
        self.twin = self._twins.enter_context(Twin(self.robot, self._directory, driver=self._driver_class))

    @property
    def _where(self) -> str:
        return "" if self._driver_class is None else where_is(self._driver_class)

    def _make_template(self) -> Template:
        theirs = environment(
            STRANDS_ACTORS_RUN=str(self._directory / "run"),
            STRANDS_ACTORS_DATA=str(self._directory / "data"),
            **{ALLOW_FAULTS: "1"},
        )
        return Template(theirs, self.robot, self._where, self._directory / "template.err")

    def _wanted(self, motion: str, extras: frozenset[str]) -> dict[str, Any]:
        return {
            "robot": self.robot,
            "port": self.twin.port,
            "driver": self._where,
            "motion": motion,
            "far": str(self.far),
            "cameras": {"eye": SETTINGS} if CAMERA in extras else {},
        }

    def processes(self) -> Iterator[int]:
        """Yield the ids of all running processes with the environment of this bench's callers.

        The callers are among them. Linux only.
        """
        mark = f"STRANDS_ACTORS_RUN={self._directory / 'run'}".encode()
        for entry in os.listdir("/proc"):
            if not entry.isdigit() or int(entry) == self.template.pid:
                continue
            with contextlib.suppress(OSError):  # it has just ended, or belongs to another user
                if mark in Path("/proc", entry, "environ").read_bytes().split(b"\0"):
                    yield int(entry)

    def queue(self, caller: Caller, victim: int = 0) -> Queue:
        """Measure from now on how long the tree, its caller, the robot and this process wait for a processor."""
        return Queue([*caller.pids().values(), self.twin.process.pid, os.getpid()], victim)

    def _wait_for_silence(self) -> None:
        """Wait until no process of the previous tree writes any more.

        Its processes were killed one after the other.
        """
        deadline_s, tail, last_ns = time.monotonic() + 2.0, self.log.tail(), 0
        while time.monotonic() < deadline_s:
            last_ns = max((entry.t_ns for entry in tail.new() if entry.sender == "host"), default=last_ns)
            if time.monotonic_ns() - last_ns > SILENT_NS:
                return
            time.sleep(0.02)


def usual_motion(driver: Driver) -> str:
    """Return the motion for which a robot runs most processes: one with a policy, where it can run one."""
    return "rollout" if driver.TASKS else "loop" if driver.ROLLOUTS else "task"


def roles_of(bench: Bench) -> tuple[str, ...]:
    """Return the roles of all processes that a robot's tree can have, extras included.

    The robot itself is no process of this package. Raise ``NotMoving``.
    """
    roles = bench.moving(usual_motion(bench.driver), EXTRAS).pids()
    bench.drop()
    return tuple(dict.fromkeys((Victims.CALLER, Victims.POLICY, *roles)))


def extras_for(members: Iterable[str]) -> frozenset[str]:
    """Return those of the given roles that are extras."""
    return EXTRAS & frozenset(members)


@contextlib.contextmanager
def moving_robot(robot: str, motion: str = "loop") -> Iterator[tuple[Bench, Caller]]:
    """Open a bench with a moving robot."""
    with Bench(robot) as bench:
        yield bench, bench.moving(motion)


def driver_of(robot: str, driver_class: type[Driver] | None = None) -> Driver:
    """Return the driver of a robot, for its twin. ``robot`` is the name of a column (``registering.column``)."""
    robot, where = column(robot)
    driver_class = driver_class or class_of(where)
    if driver_class is not None:
        return driver_class(robot, "", driver_class.resolve(robot, {}))
    wanted = plan(robot, "real", transport="twin")
    return wanted.driver_class(wanted.robot, "", wanted.options)
