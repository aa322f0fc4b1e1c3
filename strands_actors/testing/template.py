"""Fork callers from a process with all imports, which saves a third of a second for each.

The template has one thread, no network session and no robot. It only forks. A caller is in a separate process
session, like a program that is started from a shell. Nothing else runs below it in the interpreter, so it ends as a
script does.
"""

from __future__ import annotations

import contextlib
import gc
import json
import os
import select
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NoReturn

from strands_actors.kernel.processes.interpreter import PYTHON

READY_S = 60.0
"""Seconds for the imports of the template, on a busy machine."""
_MAX_REQUEST = 65536


class Forked:
    """A child that the template process has forked.

    Nothing waits for the end of the children. So the process id of a child may be used again when the child has
    ended.
    """

    def __init__(self, pid: int) -> None:
        self.pid = pid

    @property
    def alive(self) -> bool:
        """True while the child runs."""
        try:
            os.kill(self.pid, 0)
        except ProcessLookupError:
            return False
        return True

    def end(self) -> None:
        """Kill the process, and wait for its end."""
        with contextlib.suppress(ProcessLookupError):
            os.kill(self.pid, signal.SIGKILL)
        while self.alive:
            time.sleep(0.001)


class Template:
    """The process that has imported everything and forks callers (scripts that move a robot).

    Args:
        environment: The environment of the callers.
        robot: The robot with the driver to import, or a column of the kill matrix.
        where: ``module:Class`` of the driver. Empty for a driver of this package.
        errors: The file for the stderr of the template.
    """

    def __init__(self, environment: Mapping[str, str], robot: str, class_path: str, errors: Path) -> None:
        self._errors = errors
        self._socket, theirs = socket.socketpair()
        with theirs, errors.open("w") as stderr:
            self._process = subprocess.Popen(
                [*PYTHON, "-m", "strands_actors.testing.template", str(theirs.fileno()), robot, class_path],
                env=environment,
                pass_fds=[theirs.fileno()],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=stderr,
            )
        self._hear()

    @property
    def pid(self) -> int:
        """The process id of the template."""
        return self._process.pid

    def fork(self, settings: Mapping[str, Any], stdin: int, stdout: int, stderr: int) -> Forked:
        """Fork a caller with these settings and descriptors.

        Args:
            settings: The settings (``testing.caller``).
            stdin: Descriptor from which the caller reads orders.
            stdout: Descriptor to which the caller writes its lines.
            stderr: Descriptor to which the caller writes errors.

        Raises:
            RuntimeError: The template has ended. The text is the stderr of the template.
        """
        request = json.dumps(settings).encode()
        assert len(request) < _MAX_REQUEST
        with contextlib.suppress(BrokenPipeError):
            socket.send_fds(self._socket, [request], [stdin, stdout, stderr])
        return Forked(int(self._hear()))

    def close(self) -> None:
        """Kill the template (the process that forks callers), and wait for its end."""
        self._socket.close()
        self._process.kill()
        self._process.wait()

    def _hear(self) -> bytes:
        ready, _, _ = select.select([self._socket], [], [], READY_S)
        reply = self._socket.recv(64) if ready else b""
        if not reply:
            self.close()
            raise RuntimeError(f"the template of callers ended: {self._errors.read_text().strip()}")
        return reply


def serve(sock: socket.socket) -> dict[str, Any]:
    """Fork a child for each request. This function returns in the child, with the settings of the child.

    When the parent has closed the socket, the template kills the last child and ends. A child in an endless loop
    would not notice the end of the parent.
    """
    # The system then removes ended children, so that nothing has to wait for them.
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)
    sock.sendall(b"ready")
    last = -1
    while True:
        request, descriptors, _, _ = socket.recv_fds(sock, _MAX_REQUEST, 3)
        if not request:
            _end(last)
        if last >= 0:
            os.close(last)
        pid = os.fork()
        if pid == 0:
            os.setsid()
            signal.signal(signal.SIGCHLD, signal.SIG_DFL)
            sock.close()
            for target, descriptor in enumerate(descriptors):
                os.dup2(descriptor, target)
                os.close(descriptor)
            settings: dict[str, Any] = json.loads(request)
            return settings
        for descriptor in descriptors:
            os.close(descriptor)
        last = _descriptor_of(pid)
        sock.sendall(str(pid).encode())


def _descriptor_of(pid: int) -> int:
    """Return a pidfd, a descriptor for this child. A signal to it cannot reach another process with the same id.

    It is -1 if the child has ended, or where the system has no pidfd (macOS).
    """
    try:
        return os.pidfd_open(pid)
    except (AttributeError, ProcessLookupError):
        return -1


def _end(last: int) -> NoReturn:
    if last >= 0:
        with contextlib.suppress(ProcessLookupError):
            signal.pidfd_send_signal(last, signal.SIGKILL)
    os._exit(0)


def main(fd: int, robot: str, class_path: str) -> None:
    """Import everything that a caller needs, then fork callers. Each child runs ``caller.main``.

    Args:
        fd: Descriptor of the socket to the parent.
        robot: The robot with the driver to import, or a column of the kill matrix.
        class_path: ``module:Class`` of the driver. Empty for a driver of this package.
    """
    # This import is the slow one.
    from . import caller
    from .registering import prepare

    prepare(robot, class_path)
    gc.collect()
    # Otherwise a garbage collection in a child would copy every page of memory.
    gc.freeze()
    caller.main(serve(socket.socket(fileno=fd)))


if __name__ == "__main__":
    main(int(sys.argv[1]), sys.argv[2], sys.argv[3])
