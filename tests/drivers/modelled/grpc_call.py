"""A client's gRPC call without a network."""

from __future__ import annotations


class GrpcCall:
    """A client's call, as the twin's service sees it."""

    def __init__(self, path: str) -> None:
        self.path = path
        self.is_open = self.has_room = True
        self.sent: list[bytes] = []

    def log_received(self, t_ns: int, kind: str, message: bytes, safe_state: str | None = None) -> None: ...

    def send(self, message: bytes) -> None:
        self.sent.append(message)

    answer = send

    def end(self, status: object = None, text: str = "") -> None:
        self.is_open = False
