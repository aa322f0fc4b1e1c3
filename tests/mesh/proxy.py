"""Simulate a cable between two hosts that can be cut, by a TCP relay."""

from __future__ import annotations

import socket
import threading
from types import TracebackType


class Cable:
    """A relay from ``self.port`` to ``127.0.0.1:port``.

    After ``cut`` no data passes in either direction, and neither end is notified. ``heal`` closes the old
    connections, and new ones pass.
    """

    def __init__(self, port: int) -> None:
        self._to = port
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port: int = self._listener.getsockname()[1]
        self._whole = threading.Event()
        self._whole.set()
        self._ends: list[socket.socket] = []

    def __enter__(self) -> Cable:
        threading.Thread(target=self._accept, daemon=True).start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._listener.close()
        self._drop()

    def cut(self) -> None:
        self._whole.clear()

    def heal(self) -> None:
        self._drop()
        self._whole.set()

    def _drop(self) -> None:
        ends, self._ends = self._ends, []
        for end in ends:
            end.close()

    def _accept(self) -> None:
        while True:
            try:
                theirs, _ = self._listener.accept()
            except OSError:
                return
            if not self._whole.is_set():
                theirs.close()
                continue
            ours = socket.create_connection(("127.0.0.1", self._to))
            self._ends += [theirs, ours]
            for source, target in ((theirs, ours), (ours, theirs)):
                threading.Thread(target=self._relay, args=(source, target), daemon=True).start()

    def _relay(self, source: socket.socket, target: socket.socket) -> None:
        """Relay data until either end is closed."""
        try:
            while data := source.recv(65536):
                if self._whole.is_set():
                    target.sendall(data)
        except OSError:
            pass
        for end in (source, target):
            end.close()
