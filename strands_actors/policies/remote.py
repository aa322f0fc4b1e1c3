"""The provider ``remote``: a policy served over WebSocket, by anything that speaks what follows.

One request a chunk, one answer a request, each one WebSocket message: msgpack in a binary message,
or JSON in a text message (``encoding="json"``). A server answers in kind.

    request   {"observation": {joint: number}, "instruction": text, "axes": [joint], "hz": control rate}
    answer    {"actions": [{joint: number}, ...]}      a chunk, in the driver's units, executed at the control rate
           or {"error": text}                          which ends the rollout

Every wait is bounded: ``timeout_s`` for connecting and for each answer. A server that is slower
than the buffered chunk lasts ends the rollout before that: the last setpoint expires and the robot
holds.
"""

from __future__ import annotations

import contextlib
from collections.abc import Mapping, Sequence
from typing import Any

import msgspec
from websockets.exceptions import WebSocketException
from websockets.sync.client import connect

MAX_BYTES = 1 << 20
CODECS: dict[str, Any] = {"msgpack": msgspec.msgpack, "json": msgspec.json}


class Chunk(msgspec.Struct):
    """An answer."""

    actions: list[dict[str, float]] = []
    error: str = ""


class Remote:
    """The client. Raise ``ConnectionError`` when the server is not there, goes away or answers
    anything else, and ``TimeoutError`` when it does not answer in time."""

    provider_name = "remote"

    def __init__(
        self,
        axes: Sequence[str],
        host: str = "localhost",
        port: int = 8000,
        path: str = "/",
        encoding: str = "msgpack",
        timeout_s: float = 5.0,
    ) -> None:
        if encoding not in CODECS:
            raise ValueError(f"remote: encoding is {encoding!r}. use one of {', '.join(CODECS)}")
        self._codec = CODECS[encoding]
        self._is_text = encoding == "json"
        self._axes = list(axes)
        self._hz = 0.0
        self._timeout_s = timeout_s
        self._where = f"ws://{host}:{port}/{path.removeprefix('/')}"
        self._opened = contextlib.ExitStack()
        try:
            # No proxy: it is a robot's policy, near by, and what the environment says is meant for
            # browsing.
            opening = connect(self._where, open_timeout=timeout_s, compression=None, max_size=MAX_BYTES, proxy=None)
            self._socket = self._opened.enter_context(opening)
        except TimeoutError as error:
            raise TimeoutError(f"{self._where} did not answer within {timeout_s:g} s") from error
        except (OSError, WebSocketException) as error:
            raise ConnectionError(f"{self._where}: {error}") from error

    def close(self) -> None:
        """Hang up."""
        self._opened.close()

    def set_control_frequency(self, hz: float) -> None:
        self._hz = hz

    def get_actions_sync(
        self, observation: Mapping[str, float], instruction: str, **_: Any
    ) -> list[dict[str, float]]:
        request = {
            "observation": dict(observation),
            "instruction": instruction,
            "axes": self._axes,
            "hz": self._hz,
        }
        try:
            self._socket.send(self._codec.encode(request), text=self._is_text)
            answer = self._socket.recv(timeout=self._timeout_s)
        except TimeoutError as error:
            raise TimeoutError(f"{self._where} did not answer within {self._timeout_s:g} s") from error
        except (OSError, WebSocketException) as error:
            raise ConnectionError(f"{self._where}: {error}") from error
        try:
            chunk = self._codec.decode(answer, type=Chunk)
        except msgspec.DecodeError as error:
            raise ConnectionError(f"{self._where} answered what is no chunk: {error}") from error
        if chunk.error:
            raise ConnectionError(f"{self._where} says: {chunk.error}")
        return list(chunk.actions)
