"""Make unix sockets of another host available here, with the system's ``ssh -L`` as a child process.

ssh ends with ``close``, and also when this process ends for any reason. It never asks the user: if the host needs a
password or has an unknown key, the connect fails with ssh's message. It shares no connection with other ssh
sessions of the user, because such a connection would outlive this process.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import shutil
import signal
import socket
import sys
import tempfile
from collections.abc import Sequence
from typing import Any

import trio

from strands_actors.contract.wire import WireDown
from strands_actors.kernel.processes.process import ChildProcess, start
from strands_actors.kernel.processes.reserve import RESERVE

from .tcp_port import TcpPort
from .unix_port import open_unix

LOOK_S = 0.02
"""Period of the check for ssh's sockets."""

_ENTRY = "strands_actors.drivers.common.ports.ssh_forward:main"
_DEATH_SIGNAL = 1
"""``PR_SET_PDEATHSIG`` of Linux."""


class SshForward:
    """One ssh process that forwards sockets of one host.

    Args:
        host: The host, in the form that ssh accepts.
        port: The port of the ssh server; 0 for ssh's default.
        remote: Paths of sockets on the host.
        program: The ssh program to run.
    """

    def __init__(self, host: str, port: int, remote: Sequence[str], program: str = "ssh") -> None:
        self._host = host
        self._port = port
        self._remote = tuple(remote)
        self._program = program
        self._directory = ""
        self._child: ChildProcess | None = None

    async def open(self, remote: str, within_s: float) -> TcpPort:
        """Connect to a socket of the host. Start ssh if it does not run.

        If the call is cancelled or takes too long, ssh continues, and the next call waits for it.

        Args:
            remote: One of the paths that were given as ``remote``.
            within_s: Longest time of the whole connect.

        Raises:
            WireDown: ssh has ended, or there is no connection in time.
        """
        child = self._child
        if child is None or not child.alive:
            child = self._start(within_s)
        local = self._local(remote)
        with trio.move_on_after(within_s):
            while child.alive:
                # The local socket may not exist yet, or ssh may not listen on it yet.
                with contextlib.suppress(WireDown):
                    return await open_unix(local)
                await trio.sleep(LOOK_S)
            raise WireDown(
                f"ssh {self._host}: {self._last_error_line()}. Run `ssh {self._host}` to find the reason"
            )
        raise WireDown(f"ssh {self._host}: no connection within {within_s:g} s. Check the host and its network")

    def close(self) -> None:
        """End ssh, and with it every connection through it."""
        child, self._child = self._child, None
        if child is not None:
            child.kill()
            child.detach()
            child.socket.close()
        if self._directory:
            shutil.rmtree(self._directory, ignore_errors=True)
            self._directory = ""

    def _start(self, within_s: float) -> ChildProcess:
        self.close()
        self._directory = tempfile.mkdtemp(prefix="strands-ssh-")
        settings = {
            "parent": os.getpid(),
            "errors": self._errors,
            "command": command(
                self._program,
                self._host,
                self._port,
                within_s,
                [(self._local(path), path) for path in self._remote],
            ),
        }
        try:
            self._child = start(_ENTRY, settings, label=f"ssh {self._host}")
        except OSError as error:
            RESERVE.lacked(error)
            raise WireDown(f"ssh {self._host}: ssh could not be started ({error.strerror})") from None
        return self._child

    def _local(self, remote: str) -> str:
        return os.path.join(self._directory, f"{self._remote.index(remote)}.sock")

    @property
    def _errors(self) -> str:
        return os.path.join(self._directory, "errors")

    def _last_error_line(self) -> str:
        try:
            with open(self._errors, "rb") as file:
                lines = file.read(4096).decode("utf-8", "replace").split("\n")
        except OSError:
            lines = []
        return next((line.strip() for line in reversed(lines) if line.strip()), "it has ended, without a word")


def command(program: str, host: str, port: int, within_s: float, forwards: Sequence[tuple[str, str]]) -> list[str]:
    """Return the command line of ssh. Each entry of ``forwards`` is a local path and a path on the host."""
    options = [
        "BatchMode=yes",
        "ExitOnForwardFailure=yes",
        "ControlMaster=no",
        "ControlPath=none",
        "StreamLocalBindMask=0177",
        f"ConnectTimeout={max(1, round(within_s))}",
        "ServerAliveInterval=1",
        "ServerAliveCountMax=2",
    ]
    return [
        program,
        "-N",
        "-T",
        *(word for option in options for word in ("-o", option)),
        *(("-p", str(port)) if port else ()),
        *(word for local, remote in forwards for word in ("-L", f"{local}:{remote}")),
        "--",
        host,
    ]


def main(args: dict[str, Any], sock: socket.socket) -> None:
    """Run in the child process: replace it by ssh, and let it end together with its parent process."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_DEATH_SIGNAL, int(signal.SIGKILL))
        if os.getppid() != args["parent"]:
            # The parent ended before the system was asked to kill this child together with it.
            os._exit(1)
    errors = os.open(args["errors"], os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600)
    os.dup2(errors, 2)
    os.dup2(errors, 1)
    sock.close()
    words: list[str] = args["command"]
    try:
        os.execvp(words[0], words)
    except OSError as error:
        os.write(2, f"{words[0]}: {error.strerror}\n".encode())
        os._exit(1)
