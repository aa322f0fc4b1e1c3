"""A policy server that sends the first message, as those of strands-robots do (JSON, version 1)."""

from __future__ import annotations

import contextlib
import json
import time
from collections.abc import Iterator
from typing import Any

from websockets.sync.server import ServerConnection

from .serving import served

METADATA = {
    "provider_name": "act",
    "requires_images": False,
    "actions_per_step": 1,
    "supports_rtc": False,
    "execution_horizon": 1,
    "required_bodies": [],
}


@contextlib.contextmanager
def greeting_server(
    chunk: Any, greet_after_s: float = 0.0, version: int = 1, **metadata: Any
) -> Iterator[tuple[int, list[dict[str, Any]]]]:
    """Yield its port and the received requests. ``chunk`` makes actions from an observation. If it raises, the
    server sends the error."""
    received: list[dict[str, Any]] = []

    def answer(message: str | bytes) -> dict[str, Any]:
        try:
            request = json.loads(message)
            received.append(request)
            match request["type"]:
                case "get_actions":
                    return {"type": "actions", "actions": chunk(request["observation"])}
                case "reset":
                    return {"type": "ok", "metadata": METADATA | metadata}
                case "set_state_keys" | "set_control_frequency":
                    return {"type": "ok"}
            raise ValueError(f"unknown message type: {request['type']!r}")
        except Exception as error:
            return {"type": "error", "error": f"{type(error).__name__}: {error}", "traceback": "..."}

    def handle(connection: ServerConnection) -> None:
        time.sleep(greet_after_s)
        ready = {"type": "ready", "protocol_version": version, "metadata": METADATA | metadata}
        connection.send(json.dumps(ready))
        for message in connection:
            connection.send(json.dumps(answer(message)))

    with served(handle) as port:
        yield port, received
