"""A bench for tests that break one process of a moving robot.

A bench has a simulated robot (twin), and a caller. The caller is a script in another process, which moves the
robot. The robot is kept from test to test. The caller is kept, too, unless the test broke it; then a new caller is
forked.
"""

from __future__ import annotations

import contextlib
import json
import os
import select
import signal
import tempfile
import time
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any

from strands_actors.caller.resolve.planning import plan
from strands_actors.contract.driver import Driver
from strands_actors.drivers import get_native_driver_class
from strands_actors.kernel.processes.interpreter import environment
from strands_actors.supervisors.introspection import ALLOW_FAULTS

from .faults import Victims
from .hosted import HostedRobot, HostFailed
from .queueing import Queue
from .recorder_process import RecorderProcess
from .registering import HOSTED, LOWERING, carried, class_of, class_path_of, column, end_of
from .still_camera import SETTINGS
from .template import Template
from .twin import Twin
from .wirelog import WireLog

TWIN_OPTIONS: Mapping[str, Mapping[str, object]] = {"spot": {"haste": 5.0}}
"""Options of the simulated robots in trials. A Spot stands up in four seconds, which every trial would wait for."""

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
    """The caller (the script) ended before its robot moved, or the robot cannot be made to move."""


class Caller:
    """The script ``testing.caller`` as a process. It moves the robot of a bench."""

    def __init__(
        self, directory: Path, template: Template, settings: dict[str, Any], extras: frozenset[str]
    ) -> None:
        """Fork a caller (a script that moves a robot).

        Args:
            directory: Directory for the files of the caller.
            template: The process ``testing.template``, which forks the caller.
            settings: The settings of the caller (``testing.caller``).
            extras: The extra processes that the caller's robot has, by role (``EXTRAS``).
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
        self._received = b""
        with self._errors.open("w") as errors:
            try:
                request = {**settings, "trigger": str(self.trigger)}
                self.process = template.fork(request, its_input, its_output, errors.fileno())
            finally:
                os.close(its_input)
                os.close(its_output)

    def pid(self, role: str) -> int:
        """Return the process id of the process with this role. Raise ``NotMoving`` if there is no such process."""
        process_id = self.pids().get(role)
        if process_id is None:
            raise NotMoving(f"there is no {role} process")
        return process_id

    def pids(self) -> dict[str, int]:
        """Return the process id for each role, as the script reported it when the robot began to move."""
        return {entry["role"]: entry["pid"] for entry in self.tree.get("processes", ())}

    def _living(self) -> set[str]:
        """Return the roles of the robot's processes that still run."""
        return {role for role, pid in self.pids().items() if Path(f"/proc/{pid}").exists()}

    def complete(self) -> None:
        """Wait until the extra processes (on request) run, and every process that the robot has had before.

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
            self.send_order("tree")
            self.tree = self.line()
        self._roles = frozenset(self.pids())

    def line(self) -> dict[str, Any]:
        """Return the next JSON line that the caller (the script that moves the robot) has printed.

        Raises:
            NotMoving: The caller has ended, or prints nothing for ``START_S``.
        """
        deadline_s = time.monotonic() + START_S
        while not (text := self._next_line(deadline_s)).startswith(b"{"):
            pass  # skip lines that vendors' libraries print
        message: dict[str, Any] = json.loads(text)
        return message

    def _next_line(self, deadline_s: float) -> bytes:
        while b"\n" not in self._received:
            left_s = max(0.0, deadline_s - time.monotonic())
            if not select.select([self._output], [], [], left_s)[0]:
                raise NotMoving(f"the caller said nothing for {START_S:g} s")
            data = os.read(self._output, 65536)
            if not data:
                raise NotMoving(self._errors.read_text().strip() or "the caller ended before its robot moved")
            self._received += data
        text, _, self._received = self._received.partition(b"\n")
        return text

    def send_order(self, line: str) -> None:
        """Send an order to the caller (the script ``testing.caller``), as one line.

        If the caller has ended, do nothing.
        """
        # If the caller has ended, the next read notices it.
        with contextlib.suppress(BrokenPipeError):
            os.write(self._input, line.encode() + b"\n")

    def policy_broke_ns(self) -> int:
        """Return the time at which the policy broke (CLOCK_MONOTONIC, ns); 0 if it has not broken."""
        note = Path(f"{self.trigger}.t")
        return int(note.read_text() or 0) if note.exists() else 0

    def forget_trigger(self) -> None:
        """Remove the files that made the last policy fail, so that the next policy runs."""
        for path in (self.trigger, Path(f"{self.trigger}.t")):
            path.unlink(missing_ok=True)

    def end(self) -> None:
        """Kill the caller (the script that moves the robot), its recorder, and every process of its robot."""
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
    """A simulated robot, and a caller (a script in another process) that moves it, as a context manager.

    Args:
        robot: The robot's name, or another name of a column (``registering.column``).
        driver_class: The driver of a robot that is no part of this package.
        far: How far the first joint moves, in the driver's units. By default 10 degrees, or 0.1 in any
            other unit.
    """

    def __init__(self, robot: str, driver_class: type[Driver] | None = None, far: float | None = None) -> None:
        self.robot, class_path = column(robot)
        self.hosted = robot.endswith(HOSTED)
        """True if a host keeps the robot, and the caller attaches itself to it."""
        self._host: HostedRobot | None = None
        self._driver_class = driver_class or class_of(class_path)
        self.driver = driver_of(robot, self._driver_class)
        self._carried = carried(robot)
        self._options = self._carried | end_of(self.robot, type(self.driver), lowered=robot.endswith(LOWERING))
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
        self, error_type: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.drop()
        self._stack.close()

    @property
    def log(self) -> WireLog:
        """The log of all frames that the simulated robot has exchanged."""
        return self.twin.log

    def drop(self) -> None:
        """End the caller (the script that moves the robot) and the other processes of its robot."""
        if self._caller is not None:
            self._caller.end()
            self._caller = None
        if self._host is not None:
            self._host.end()
            self._host = None
        # A caller that ended before its robot moved has not reported the processes of its robot. Its root would try
        # for a minute to stop a simulated robot that is gone.
        for pid in self.processes():
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)

    def moving(self, motion: str, extras: frozenset[str] = frozenset()) -> Caller:
        """Return a caller that moves its robot. It is the present caller or a new one.

        Args:
            motion: ``loop``, ``task``, ``rollout`` or ``raise`` (``testing.caller``).
            extras: The extra processes that must run, by role (``EXTRAS``).

        Raises:
            NotMoving: The robot cannot be made to move.
        """
        self.twin.go_on()
        self.twin.fault("ok")
        self.twin.plug()
        caller = self._caller
        if caller is not None and caller.process.alive and caller.extras == extras:
            caller.forget_trigger()
            # The whole log is read many times, so it is kept short.
            os.truncate(self.log.path, 0)
            caller.send_order(f"again {motion}")
            try:
                caller.tree = caller.line()
                caller.complete()
                return caller
            except NotMoving:
                pass
        self.drop()
        self._wait_for_silence()
        if self.hosted:
            cameras = {"eye": SETTINGS} if CAMERA in extras else {}
            try:
                self._host = HostedRobot(
                    self._directory, self._environment, self.robot, self.twin.port, self._options, cameras
                )
            except HostFailed as failed:
                raise NotMoving(str(failed)) from None
        os.truncate(self.log.path, 0)
        caller = self._caller = Caller(self._directory, self.template, self._settings(motion, extras), extras)
        caller.forget_trigger()
        try:
            caller.tree = caller.line()
            caller.complete()
        except NotMoving:
            self.drop()
            # A hold that used wrong readings may have moved a joint to a position in which the robot cannot be
            # armed.
            self._begin_twin()
            raise
        return caller

    def _begin_twin(self) -> None:
        """Start a simulated robot in place of the previous one."""
        self._twins.close()
        options = {**TWIN_OPTIONS.get(self.robot, {}), **self._carried}
        twin = Twin(self.robot, self._directory, driver=self._driver_class, options=options)
        self.twin = self._twins.enter_context(twin)

    @property
    def _class_path(self) -> str:
        return "" if self._driver_class is None else class_path_of(self._driver_class)

    @property
    def _environment(self) -> Mapping[str, str]:
        return environment(
            STRANDS_ACTORS_RUN=str(self._directory / "run"),
            STRANDS_ACTORS_DATA=str(self._directory / "data"),
            **{ALLOW_FAULTS: "1"},
        )

    def _make_template(self) -> Template:
        return Template(self._environment, self.robot, self._class_path, self._directory / "template.err")

    def _settings(self, motion: str, extras: frozenset[str]) -> dict[str, Any]:
        return {
            "robot": self.robot,
            "port": self.twin.port,
            "attach": self.hosted,
            "driver": self._class_path,
            "options": self._options,
            "motion": motion,
            "far": str(self.far),
            "cameras": {"eye": SETTINGS} if CAMERA in extras else {},
        }

    def processes(self) -> Iterator[int]:
        """Yield the ids of all running processes that have the environment variables of this bench's callers.

        The callers themselves are among them. Linux only.
        """
        mark = f"STRANDS_ACTORS_RUN={self._directory / 'run'}".encode()
        for entry in os.listdir("/proc"):
            if not entry.isdigit() or int(entry) == self.template.pid:
                continue
            with contextlib.suppress(OSError):  # the process has just ended, or belongs to another user
                if mark in Path("/proc", entry, "environ").read_bytes().split(b"\0"):
                    yield int(entry)

    def queue(self, caller: Caller, victim: int = 0) -> Queue:
        """Return a measurement of how long processes wait for a processor, which begins now.

        It includes the processes of the robot, the caller, the simulated robot, and this process.
        """
        return Queue([*caller.pids().values(), self.twin.process.pid, os.getpid()], victim)

    def _wait_for_silence(self) -> None:
        """Wait until no process of the previous caller's robot writes any more.

        Its processes were killed one after the other.
        """
        deadline_s, tail, last_ns = time.monotonic() + 2.0, self.log.tail(), 0
        while time.monotonic() < deadline_s:
            last_ns = max((entry.t_ns for entry in tail.new() if entry.sender == "host"), default=last_ns)
            if time.monotonic_ns() - last_ns > SILENT_NS:
                return
            time.sleep(0.02)


def usual_motion(driver: Driver) -> str:
    """Return the kind of motion in which most processes of a robot run.

    This is a policy run, if the robot can run a policy.
    """
    return "rollout" if driver.TASKS else "loop" if driver.ROLLOUTS else "task"


def roles_of(bench: Bench) -> tuple[str, ...]:
    """Return the roles of all processes that a robot can have.

    Extras (processes that run only on request) are included, and the process of the simulated robot is not. Raise
    ``NotMoving`` if the robot cannot be made to move.
    """
    roles = bench.moving(usual_motion(bench.driver), EXTRAS).pids()
    bench.drop()
    return tuple(dict.fromkeys((Victims.CALLER, Victims.POLICY, *roles)))


def extras_for(members: Iterable[str]) -> frozenset[str]:
    """Return those of ``members`` (roles of processes) that are extras. Extras run only on request."""
    return EXTRAS & frozenset(members)


@contextlib.contextmanager
def moving_robot(robot: str, motion: str = "loop") -> Iterator[tuple[Bench, Caller]]:
    """Open a bench, make its simulated robot move, and yield the bench and the script that moves it (caller)."""
    with Bench(robot) as bench:
        yield bench, bench.moving(motion)


def driver_of(robot: str, driver_class: type[Driver] | None = None) -> Driver:
    """Return the driver of a robot, for commanding its simulated version.

    ``robot`` is the name of a column of the kill matrix (``registering.column``).
    """
    lowered, gripper = robot.endswith(LOWERING), carried(robot)
    robot, class_path = column(robot)
    driver_class = driver_class or class_of(class_path)
    options = gripper | end_of(robot, driver_class or get_native_driver_class(robot), lowered=lowered)
    if driver_class is not None:
        return driver_class(robot, "", driver_class.resolve(robot, options))
    planned = plan(robot, "real", transport="twin", **options)
    return planned.driver_class(planned.robot, "", planned.options)
