"""A policy server that speaks first, as those of strands-robots do (JSON, version 1)."""

from __future__ import annotations

import contextlib
import json
import threading
import time
from collections.abc import Iterator
from typing import Any

from websockets.sync.server import ServerConnection, serve

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
    """Its port, and all that it was asked. ``chunk`` makes actions of an observation; what it
    raises is told."""
    heard: list[dict[str, Any]] = []

    def answer(message: str | bytes) -> dict[str, Any]:
        try:
            request = json.loads(message)
            heard.append(request)
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

    with serve(handle, "127.0.0.1", 0) as listening:
        thread = threading.Thread(target=listening.serve_forever)
        thread.start()
        try:
            yield listening.socket.getsockname()[1], heard
        finally:
            listening.shutdown()
            thread.join()
