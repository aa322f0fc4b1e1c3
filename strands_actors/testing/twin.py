"""Run a simulated robot (twin) as a process that a test controls: its port, the log of its frames, its faults.

    with Twin("so101", tmp_path) as twin:
        arm = Robot("so101", mode="real", port=twin.port)
        twin.fault("off:3")

An order takes effect when the twin has read it. So a test must wait until it sees the effect.
"""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any

import trio

from strands_actors.contract.driver import Driver
from strands_actors.contract.loading import load

from .fork_server import Forked, twin_server
from .registering import class_path_of, register
from .wirelog import WireLog

PATIENCE_S = 20.0
"""Seconds to wait on a busy machine. On an idle one nothing here takes a second."""

_SERVE = "strands_actors.surfaces.cli.robots:serve_twin"
_PROBLEM = "strands_actors.surfaces.cli.errors:Problem"
_BY_HAND = "strands_actors.drivers.sim.world:move_by_hand"


class Twin:
    """A simulated robot that runs as long as the ``with`` block.

    Args:
        robot: The robot's name.
        directory: Directory for the files with the twin's port, log and errors.
        fault: A fault that the robot has from the start, written as for ``strands-actors twin --fault``.
        driver: The class of a driver that is no part of this package.
        options: Options of the twin.
        by_hand: True if the test moves joints by hand (``move_by_hand``).

    Attributes:
        port: The port to connect to.
        log: The log of the frames that the robot exchanges.
    """

    def __init__(
        self,
        robot: str,
        directory: Path,
        fault: str | None = None,
        driver: type[Driver] | None = None,
        options: Mapping[str, object] | None = None,
        by_hand: bool = False,
    ) -> None:
        self.robot = robot
        self.log = WireLog(directory / "wire.ndjson")
        self.port = ""
        self._port_file = directory / "port"
        self._errors = directory / "twin.err"
        self._fault = fault
        self._options = options or {}
        self._control = directory / "control" if by_hand else None
        self._hand: dict[str, float] = {}
        self._driver = driver

    def __enter__(self) -> Twin:
        arguments: dict[str, Any] = {
            "robot": self.robot,
            "port_file": str(self._port_file),
            "log": str(self.log.path),
            "fault": self._fault,
            "control": None if self._control is None else str(self._control),
            "options": [f"{name}={value}" for name, value in self._options.items()],
            "driver": "" if self._driver is None else class_path_of(self._driver),
        }
        # The directory may contain the file of an earlier twin.
        self._port_file.unlink(missing_ok=True)
        # This pipe is closed when this process ends for any reason. Then the twin ends, too.
        theirs, self._ours = os.pipe()
        stdin, lines = os.pipe()
        self._lines = open(lines, "w")  # _end closes it
        with self._errors.open("w") as errors, open(theirs, "rb") as parent, open(stdin, "rb") as reads:
            forks = twin_server()
            descriptors = reads.fileno(), errors.fileno()
            pid = forks.fork(f"{__name__}:serve", arguments, descriptors, parent=parent.fileno())
            self.process = Forked(forks, pid)
        try:
            self._wait(self._port_file.exists)
        except BaseException:
            self._end(signal.SIGKILL)
            raise
        self.port = self._port_file.read_text().strip()
        return self

    def __exit__(
        self, error_type: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._end(signal.SIGTERM)

    def fault(self, text: str) -> None:
        """Give the robot a fault. The text ``ok`` ends it.

        Args:
            text: ``WORD``, or ``WORD:number`` for a fault of one motor, as for ``strands-actors twin --fault``.
        """
        self._command(f"fault {text}")

    def power_cycle(self) -> None:
        """Switch the robot off and on again."""
        self._command("power-cycle")

    def unplug(self) -> None:
        """Pull the robot's cable, and wait until the port has disappeared."""
        self._command("unplug")
        self._wait(lambda: not _is_reachable(self.port))

    def plug(self) -> None:
        """Put the robot's cable back, and wait until the port exists."""
        self._command("plug")
        self._wait(lambda: _is_reachable(self.port))

    def pause(self) -> None:
        """Freeze the whole robot (SIGSTOP) until ``go_on``."""
        self.process.send_signal(signal.SIGSTOP)

    def go_on(self) -> None:
        """Let a frozen robot continue (SIGCONT)."""
        self.process.send_signal(signal.SIGCONT)

    def move_by_hand(self, **radians: float) -> None:
        """Move joints as a person's hand would. Joints that the motors hold do not follow.

        The positions are angles of the model (radians). Joints from earlier calls keep their angles. This function
        returns when the joints have begun to move.
        """
        self._hand = move_by_hand(str(self._control), **{**self._hand, **radians})

    def order(self, line: str) -> None:
        """Send an order that only the simulation of this robot (twin) knows, as a line of text."""
        self._command(line)

    def _command(self, line: str) -> None:
        try:
            self._lines.write(line + "\n")
            self._lines.flush()
        except BrokenPipeError:
            self.process.wait(PATIENCE_S)
            raise self._ended() from None

    def _wait(self, condition: Callable[[], bool]) -> None:
        deadline_s = time.monotonic() + PATIENCE_S
        while not condition():
            if self.process.poll() is not None:
                raise self._ended()
            if time.monotonic() > deadline_s:
                raise TimeoutError(f"the twin of {self.robot} did not do so within {PATIENCE_S:g} s")
            time.sleep(0.005)

    def _ended(self) -> RuntimeError:
        return RuntimeError(f"the twin ended with code {self.process.returncode}: {self._errors.read_text()}")

    def _end(self, how: signal.Signals) -> None:
        self.go_on()  # a frozen process does not handle SIGTERM
        self.process.send_signal(how)
        try:
            self.process.wait(PATIENCE_S)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
            raise
        finally:
            with contextlib.suppress(BrokenPipeError):  # closing sends the orders that are not sent yet
                self._lines.close()
            os.close(self._ours)


def move_by_hand(control: str | os.PathLike[str], **radians: float) -> dict[str, float]:
    """Move joints of a running twin, as a person's hand would. Joints that the motors hold do not follow.

    Args:
        control: The socket that was given to ``strands-actors twin --control``.
        radians: Angles of the model by joint. Other joints stay where they are.

    Returns:
        The target of every joint.

    Raises:
        RuntimeError: The robot has no such joint, or no twin serves the socket.
    """
    moved: dict[str, float] = trio.run(load(_BY_HAND), os.fspath(control), radians)
    return moved


def serve(driver: str, robot: str, **options: Any) -> None:
    """Run the command ``strands-actors twin`` in the process of the simulated robot.

    ``driver`` is ``module:Class``, or empty.
    """
    if driver:
        register(driver, robot)
    try:
        load(_SERVE)(robot, **options)
    except load(_PROBLEM) as problem:
        print(problem, file=sys.stderr)
        sys.exit(2)


def _is_reachable(port: str) -> bool:
    """Return True if a client could connect to this address.

    The address is a path, or host:port (with options after a ?) for TCP or UDP.
    """
    host, colon, number = port.partition("?")[0].rpartition(":")
    if not colon:
        return os.path.exists(port)
    try:
        socket.create_connection((host, int(number)), PATIENCE_S).close()
    except ConnectionError:
        # A listener that is just closing resets the connection.
        return _hears_datagrams(host, int(number))
    return True


def _hears_datagrams(address: str, port: int) -> bool:
    """Return True if a UDP socket is bound to this address (proc(5), /proc/net/udp)."""
    bound = f"{int.from_bytes(socket.inet_aton(address), sys.byteorder):08X}:{port:04X}"
    with open("/proc/net/udp") as table:
        return any(line.split()[1] == bound for line in table.readlines()[1:])
