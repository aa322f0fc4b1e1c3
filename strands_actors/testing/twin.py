"""A robot's twin as a process that a test controls: its port, its wire log, its faults.

    with Twin("so101", tmp_path) as twin:
        arm = Robot("so101", mode="real", port=twin.port)
        twin.fault("off:3")

Control lines take effect when the twin has read them: wait for what they cause.
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
from .registering import register, where_is
from .wirelog import WireLog

PATIENCE_S = 20.0
"""For a busy machine; nothing here takes a second on a free one."""

_SERVE = "strands_actors.surfaces.cli.robots:serve_twin"
_PROBLEM = "strands_actors.surfaces.cli.errors:Problem"
_BY_HAND = "strands_actors.drivers.sim.world:move_by_hand"


class Twin:
    """Runs as long as the ``with`` block. ``fault``: one it begins with, as on the command line.
    ``driver``: its class, when that is no part of this package. ``options``: of its twin.
    ``by_hand``: its joints can be moved by hand, too."""

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
            "driver": "" if self._driver is None else where_is(self._driver),
        }
        self._port_file.unlink(missing_ok=True)  # of a twin before it, in the same directory
        theirs, self._ours = os.pipe()  # ends with this process, however that ends
        stdin, lines = os.pipe()
        self._lines = open(lines, "w")  # closed by _end
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
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._end(signal.SIGTERM)

    def fault(self, text: str) -> None:
        """``WORD`` or ``WORD:unit``, in the words of ``strands-actors twin --fault``."""
        self._command(f"fault {text}")

    def power_cycle(self) -> None:
        self._command("power-cycle")

    def unplug(self) -> None:
        """Pull the cable; returns when it is out."""
        self._command("unplug")
        self._wait(lambda: not _is_there(self.port))

    def plug(self) -> None:
        """Put the cable back; returns when the port is there."""
        self._command("plug")
        self._wait(lambda: _is_there(self.port))

    def pause(self) -> None:
        """Freeze the whole robot, until ``go_on``."""
        self.process.send_signal(signal.SIGSTOP)

    def go_on(self) -> None:
        self.process.send_signal(signal.SIGCONT)

    def move_by_hand(self, **radians: float) -> None:
        """Bring joints that the wire does not hold to angles of its model, as a hand would; those
        that were moved before stay. Returns when they are on their way."""
        self._hand = trio.run(load(_BY_HAND), str(self._control), {**self._hand, **radians})

    def order(self, line: str) -> None:
        """A control line that only this robot has."""
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
        self.go_on()  # a frozen process takes no SIGTERM
        self.process.send_signal(how)
        try:
            self.process.wait(PATIENCE_S)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
            raise
        finally:
            with contextlib.suppress(BrokenPipeError):  # half a line that it never took
                self._lines.close()
            os.close(self._ours)


def serve(driver: str, robot: str, **given: Any) -> None:
    """In its process: what ``strands-actors twin`` does. ``driver``: see ``registering``."""
    if driver:
        register(driver, robot)
    try:
        load(_SERVE)(robot, **given)
    except load(_PROBLEM) as problem:
        print(problem, file=sys.stderr)
        sys.exit(2)


def _is_there(port: str) -> bool:
    """Whether somebody could connect: to a path, or to host:port (and what stands behind a ?), by
    a stream or by datagrams."""
    host, colon, number = port.partition("?")[0].rpartition(":")
    if not colon:
        return os.path.exists(port)
    try:
        socket.create_connection((host, int(number)), PATIENCE_S).close()
    except ConnectionError:  # a listener that is being closed resets
        return _hears_datagrams(host, int(number))
    return True


def _hears_datagrams(address: str, port: int) -> bool:
    """Whether a UDP socket is bound there (proc(5), /proc/net/udp)."""
    bound = f"{int.from_bytes(socket.inet_aton(address), sys.byteorder):08X}:{port:04X}"
    with open("/proc/net/udp") as table:
        return any(line.split()[1] == bound for line in table.readlines()[1:])
