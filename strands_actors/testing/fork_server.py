"""Fork the processes of tests from one process that has imported everything, which saves time.

A simulated robot that is started from a file computes for a second before it answers.

The server has one thread and only forks. It imports the given modules before it begins, and nothing later. So a
request for a child takes only the time of a fork. This matters if a robot runs at the same time. A child imports
any further modules itself.
"""

from __future__ import annotations

import atexit
import gc
import importlib
import json
import os
import select
import signal
import socket
import subprocess
import sys
import threading
import time
import traceback
from collections.abc import Mapping, Sequence
from typing import IO, Any, NoReturn

from strands_actors.contract.loading import load
from strands_actors.kernel.actor import read_protocols
from strands_actors.kernel.processes import child
from strands_actors.kernel.processes.interpreter import PYTHON, environment
from strands_actors.kernel.processes.process import exists

START_S = 60.0
"""Seconds for the first fork, on a busy machine. The imports of the server come before it."""
_LOOK_S = 0.1
_MAX_MESSAGE = 1 << 17
_MAX_DESCRIPTORS = 16
_OF_TWINS = (
    "strands_actors.drivers.common.physics.jointed",  # imports numpy and MuJoCo
    "strands_actors.drivers.common.twin.process",
    "strands_actors.surfaces.cli.robots",
    "strands_actors.testing.every_twin",
    "strands_actors.testing.twin",
)
_PROGRAM = "import sys; from strands_actors.testing.fork_server import main; main(int(sys.argv[1]), sys.argv[2:])"


class Forked:
    """A child of the server, with the interface of ``subprocess.Popen``.

    ``stdin`` and ``stderr`` are our ends of the child's pipes.
    """

    def __init__(
        self, server: ForkServer, pid: int, stdin: IO[bytes] | None = None, stderr: IO[bytes] | None = None
    ) -> None:
        self.pid = pid
        self.stdin = stdin
        self.stderr = stderr
        self.returncode: int | None = None
        self._server = server

    def poll(self) -> int | None:
        """Return the exit code of the child as ``wait`` does; None if it still runs."""
        if self.returncode is None:
            self.returncode = self._server.code_of(self.pid, 0.0)
        return self.returncode

    def wait(self, timeout: float | None = None) -> int:
        """Wait for the end of the child, and return its exit code.

        Args:
            timeout: Longest time in seconds. None: no limit.

        Returns:
            The exit code, or the negative number of the signal that ended the child.

        Raises:
            subprocess.TimeoutExpired: The child still runs after this time.
        """
        until_s = None if timeout is None else time.monotonic() + timeout
        while self.returncode is None:
            left_s = None if until_s is None else until_s - time.monotonic()
            if timeout is not None and left_s is not None and left_s <= 0.0:
                raise subprocess.TimeoutExpired(f"process {self.pid}", timeout)
            self.returncode = self._server.code_of(self.pid, left_s)
        return self.returncode

    def communicate(self, timeout: float | None = None) -> tuple[None, bytes | None]:
        """Wait for the end of the child, and return its stderr, which must fit into a pipe."""
        self.wait(timeout)
        errors = None if self.stderr is None or self.stderr.closed else self.stderr.read()
        for pipe in (self.stdin, self.stderr):
            if pipe is not None:
                pipe.close()
        return None, errors

    def send_signal(self, number: int) -> None:
        """Send a signal to the child, if it still runs."""
        if self.poll() is None:
            os.kill(self.pid, number)

    def terminate(self) -> None:
        """Send SIGTERM to the child, if it still runs."""
        self.send_signal(signal.SIGTERM)

    def kill(self) -> None:
        """Send SIGKILL to the child, if it still runs."""
        self.send_signal(signal.SIGKILL)


class ForkServer:
    """The process that forks others. It ends when this process ends, or with ``close``. Its children continue.

    Args:
        imports: The modules that its children inherit.
    """

    def __init__(self, imports: Sequence[str] = ()) -> None:
        self._lock = threading.Lock()
        self._has_ended = False
        self._codes: dict[int, int] = {}
        self._socket, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with theirs:
            self._process = subprocess.Popen(
                [*PYTHON, "-c", _PROGRAM, str(theirs.fileno()), *imports],
                # OpenBLAS must not start threads, because a process with threads must not fork.
                env=environment(OPENBLAS_NUM_THREADS="1"),
                pass_fds=[theirs.fileno()],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
            )

    @property
    def alive(self) -> bool:
        """True while the server's process runs."""
        return self._process.poll() is None

    def fork(
        self,
        call: str,
        arguments: Mapping[str, Any],
        descriptors: tuple[int, int],
        *,
        parent: int | None = None,
        keep: Sequence[int] = (),
    ) -> int:
        """Fork a child that calls a function, in the environment and directory of this process. Return its pid.

        Args:
            call: ``module:function``.
            arguments: Keyword arguments.
            descriptors: The child's stdin and stderr.
            parent: A descriptor that the function gets as its argument ``parent_fd``.
            keep: Further descriptors that stay open in the child.

        Raises:
            RuntimeError: The server has ended.
        """
        request = {
            "call": call,
            "arguments": dict(arguments),
            "environment": dict(environment()),
            "directory": os.getcwd(),
            "path": sys.path,
            "has_parent": parent is not None,
        }
        sent = json.dumps(request).encode()
        assert len(sent) < _MAX_MESSAGE
        passed = [*descriptors, *(() if parent is None else (parent,)), *keep]
        with self._lock:
            try:
                socket.send_fds(self._socket, [sent], passed)
                while (report := self._hear(START_S)) is not None:
                    if "pid" in report:
                        return report["pid"]
            except OSError:
                pass  # the RuntimeError below reports it
        raise RuntimeError("the process that forks simulated robots has ended, or does not answer")

    def code_of(self, pid: int, within_s: float | None) -> int | None:
        """Return the exit code of a child, or the negative number of the signal that ended it.

        If the server has ended, the code is not known. Then a child that has ended counts as killed.

        Args:
            pid: The child.
            within_s: Longest time to wait, in seconds. None: no limit.

        Returns:
            None if the child has not ended within this time. Each code is returned once.
        """
        until_s = None if within_s is None else time.monotonic() + within_s
        while True:
            with self._lock:
                while pid not in self._codes and self._hear(0.0) is not None:
                    pass
                if pid in self._codes:
                    return self._codes.pop(pid)
                if self._has_ended and not exists(pid):
                    return -signal.SIGKILL
            left_s = None if until_s is None else until_s - time.monotonic()
            if left_s is not None and left_s <= 0.0:
                return None
            # Wait only briefly, because another thread may have received the code.
            step_s = _LOOK_S if left_s is None else min(_LOOK_S, left_s)
            if self._has_ended:
                time.sleep(step_s)
            else:
                select.select([self._socket], [], [], step_s)

    def close(self) -> None:
        """Kill the server, and wait for its end. Its children continue."""
        with self._lock:
            self._has_ended = True
            self._socket.close()
        self._process.kill()
        self._process.wait()

    def _hear(self, within_s: float) -> dict[str, int] | None:
        """Receive the next message of the server. Store the exit codes of children that it reports.

        Return None if no message came within ``within_s``, or if the server has ended.
        """
        if self._has_ended or not select.select([self._socket], [], [], within_s)[0]:
            return None
        try:
            data = self._socket.recv(_MAX_MESSAGE)
        except ConnectionError:
            data = b""
        if not data:
            self._has_ended = True
            return None
        message: dict[str, int] = json.loads(data)
        if "ended" in message:
            self._codes[message["ended"]] = message["code"]
        return message


_servers: dict[str, tuple[int, ForkServer]] = {}
_servers_lock = threading.Lock()


def server(of: str, imports: Sequence[str]) -> ForkServer:
    """Return the fork server of this process. If no server runs, start one.

    Args:
        of: The name of the group of callers that shares a server.
        imports: The modules that a new server imports.
    """
    with _servers_lock:
        made_by, running = _servers.get(of, (0, None))
        if running is None or made_by != os.getpid() or not running.alive:
            running = ForkServer(imports)
            _servers[of] = os.getpid(), running
            atexit.register(running.close)
        return running


def twin_server() -> ForkServer:
    """Return the server that forks simulated robots. It has imported their modules."""
    return server("twins", _OF_TWINS)


# -- code that runs in the server


def main(fd: int, imports: Sequence[str]) -> None:
    """Import the modules, then fork a child for each request, and report the end of each child.

    The server ends when its parent has closed the socket.

    Args:
        fd: Descriptor of the socket to the parent.
        imports: The modules that the children inherit.
    """
    sock = socket.socket(fileno=fd)
    for name in imports:
        importlib.import_module(name)
    # Without this call each forked root process would read the protocols, which takes 6 ms.
    read_protocols()
    gc.collect()
    # Otherwise a garbage collection in a child would copy every page of memory.
    gc.freeze()
    woken, wake = os.pipe()
    os.set_blocking(woken, False)
    os.set_blocking(wake, False)
    signal.signal(signal.SIGCHLD, lambda number, frame: None)
    # Ctrl-C is meant for the test process, which then ends this server.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.set_wakeup_fd(wake, warn_on_full_buffer=False)
    while True:
        ready, _, _ = select.select([sock.fileno(), woken], [], [])
        if woken in ready:
            os.read(woken, 4096)
            _report_ends(sock)
        if sock.fileno() in ready:
            data, descriptors, _, _ = socket.recv_fds(sock, _MAX_MESSAGE, _MAX_DESCRIPTORS)
            if not data:
                os._exit(0)
            request = json.loads(data)
            pid = os.fork()
            if pid == 0:
                for ours in (sock.fileno(), woken, wake):
                    os.close(ours)
                _run(request, descriptors)
            for descriptor in descriptors:
                os.close(descriptor)
            sock.sendall(json.dumps({"pid": pid}).encode())


def _report_ends(sock: socket.socket) -> None:
    while True:
        try:
            pid, status = os.waitpid(-1, os.WNOHANG)
        except ChildProcessError:
            return
        if pid == 0:
            return
        sock.sendall(json.dumps({"ended": pid, "code": os.waitstatus_to_exitcode(status)}).encode())


def _run(request: Mapping[str, Any], descriptors: list[int]) -> NoReturn:
    """Call the requested function in the child."""
    code = 1
    try:
        signal.set_wakeup_fd(-1)
        signal.signal(signal.SIGCHLD, signal.SIG_DFL)
        signal.signal(signal.SIGINT, signal.default_int_handler)
        arguments = request["arguments"]
        for target, descriptor in zip((0, 2), descriptors[:2], strict=True):
            os.dup2(descriptor, target)
            os.close(descriptor)
        if request["has_parent"]:
            arguments["parent_fd"] = descriptors[2]
        os.chdir(request["directory"])
        os.environ.clear()
        os.environ.update(request["environment"])
        sys.path[:] = request["path"]
        load(request["call"])(**arguments)
        code = 0
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else int(end.code is not None)
        if isinstance(end.code, str):
            print(end.code, file=sys.stderr)
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stderr.flush()
        os._exit(code)


def be_child(parent_fd: int) -> None:
    """Run as a child process that was started by ``kernel.processes.process.execute``, in a new process group.

    Args:
        parent_fd: Descriptor over which the child receives the function to run and its arguments.
    """
    os.setpgid(0, 0)
    child.main(parent_fd)
