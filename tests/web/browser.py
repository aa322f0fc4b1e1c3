"""What a browser sends to the console, without a browser."""

from __future__ import annotations

import contextlib
import json
import ssl
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from types import TracebackType
from typing import Any
from urllib.parse import urlsplit

import httpx
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Origin

PATIENCE_S = 30.0
HAND_S = 0.033


class Visitor:
    """A browser. It opens the address that the console prints, or shows a code.

    Args:
        url: The address with the token; or that of the console, to come with a code.
        code: The code; empty with a token.
        tls: How to check the certificate.
    """

    def __init__(self, url: str, code: str = "", tls: ssl.SSLContext | None = None) -> None:
        parts = urlsplit(url)
        self.origin = f"{parts.scheme}://{parts.netloc}"
        self.http = httpx.Client(
            base_url=self.origin, headers={"Origin": self.origin}, verify=True if tls is None else tls, timeout=30.0
        )
        self._tls = tls
        answer = self.http.post("/pair", content=f"code={code}") if code else self.http.get(url)
        assert answer.status_code == 200, answer.text
        self.cookie = "; ".join(f"{name}={value}" for name, value in self.http.cookies.items())

    def __enter__(self) -> Visitor:
        return self

    def __exit__(self, *_: object) -> None:
        self.http.close()

    def order(self, path: str, **body: Any) -> Any:
        answer = self.http.post(path, content=json.dumps(body))
        assert answer.status_code == 200, (answer.status_code, answer.text)
        return answer.json()

    def page(self, robot: str = "") -> OpenPage:
        return OpenPage(self._connect("/live"), robot)

    @contextlib.contextmanager
    def command(self, **order: Any) -> Iterator[ClientConnection]:
        """Begin a command of setting up, as the page does."""
        with self._connect("/setup/run") as socket:
            socket.send(json.dumps(order))
            yield socket

    def _connect(self, path: str) -> ClientConnection:
        url = f"{self.origin.replace('http', 'ws', 1)}{path}"
        headers = {"Cookie": self.cookie}
        return connect(url, additional_headers=headers, origin=Origin(self.origin), ssl=self._tls)


class OpenPage:
    """A page that shows a robot. Its messages are received in a thread."""

    def __init__(self, connection: AbstractContextManager[ClientConnection], robot: str) -> None:
        self.messages: list[dict[str, Any]] = []
        self.closed = threading.Event()
        self._connection = connection
        self._robot = robot
        self._lock = threading.Condition()
        self._hand: threading.Thread | None = None
        self._lifted = threading.Event()
        self._thread = threading.Thread(target=self._receive, daemon=True)

    def __enter__(self) -> OpenPage:
        self._socket = self._connection.__enter__()
        self._thread.start()
        if self._robot:
            self.send(type="watch", robot=self._robot)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._lifted.set()
        self._connection.__exit__(kind, error, trace)
        self._thread.join()

    def send(self, **message: Any) -> None:
        self._socket.send(json.dumps(message))

    def send_text(self, text: str | bytes) -> None:
        self._socket.send(text)

    def until(self, found: Callable[[dict[str, Any]], bool], what: str) -> dict[str, Any]:
        """Return the first message, from the oldest on, for which ``found`` is true."""
        until, looked = time.monotonic() + PATIENCE_S, 0
        with self._lock:
            while True:
                for message in self.messages[looked:]:
                    if found(message):
                        return message
                looked = len(self.messages)
                left_s = until - time.monotonic()
                assert left_s > 0, f"{what} did not happen. The last messages: {self.messages[-3:]}"
                self._lock.wait(left_s)

    def kind(self, kind: str) -> dict[str, Any]:
        return self.until(lambda message: message["type"] == kind, kind)

    def jog(self, **rates: float) -> None:
        """Put a hand on buttons, as a page does it."""
        self.send(type="jog", held=False, at_ms=_now_ms())
        self._lifted.clear()

        def hold() -> None:
            with contextlib.suppress(ConnectionClosed):
                while not self._lifted.wait(HAND_S):
                    self.send(type="jog", held=True, at_ms=_now_ms(), rates=rates)

        self._hand = threading.Thread(target=hold, daemon=True)
        self._hand.start()

    def let_go(self) -> None:
        self.freeze()
        self.send(type="jog", held=False, at_ms=_now_ms())

    def freeze(self) -> None:
        """Send nothing any more, as a page that is blocked."""
        assert self._hand is not None
        self._lifted.set()
        self._hand.join()

    def _receive(self) -> None:
        with contextlib.suppress(ConnectionClosed):
            for text in self._socket:
                with self._lock:
                    self.messages.append(json.loads(text))
                    self._lock.notify_all()
        self.closed.set()


def _now_ms() -> float:
    return time.monotonic() * 1e3
