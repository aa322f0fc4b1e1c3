"""Simulate a robot on a unix socket, with any number of clients.

Pulling the cable ends every connection and removes the socket's path. A frozen robot accepts connections and does
not answer.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import socket
import stat
import tempfile

from .robot import Controls
from .tcp import BACKLOG, Handler, StreamServer
from .wirelog import WireLog


class UnixServer(StreamServer):
    def __init__(self, robot: Controls, handler: Handler, log: WireLog, path: str | None = None) -> None:
        """Prepare the server. The cable is not plugged in yet.

        Args:
            path: Path of the socket; by default in a temporary directory.

        Raises:
            FileExistsError: The path exists and is not a socket.
        """
        if path and os.path.lexists(path) and not stat.S_ISSOCK(os.lstat(path).st_mode):
            raise FileExistsError(f"{path} exists and is no socket: choose another name")
        self._directory = None if path else tempfile.mkdtemp(prefix="strands-twin-")
        self._path = path or os.path.join(self._directory or "", "service.sock")
        super().__init__(robot, [handler], log)

    @property
    def address(self) -> str:
        return self._path

    def listen(self) -> list[socket.socket]:
        self.forget()
        listener = socket.socket(socket.AF_UNIX)
        try:
            listener.setblocking(False)
            listener.bind(self._path)
            os.chmod(self._path, 0o600)
            listener.listen(BACKLOG)
        except BaseException:
            listener.close()
            raise
        return [listener]

    def forget(self) -> None:
        with contextlib.suppress(FileNotFoundError):
            os.unlink(self._path)

    def close(self) -> None:
        super().close()
        if self._directory:
            shutil.rmtree(self._directory, ignore_errors=True)
