"""A policy server that speaks as GR00T's do, in both generations.

``python -m tests.agents.groot_server`` serves an SO-101 at port 5555, to try ``strands-actors run`` with.
"""

from __future__ import annotations

import contextlib
import io
import json
import threading
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import msgspec
import numpy as np
import zmq

Act = Callable[[dict[str, Any]], Any]

STATE = {"modality_keys": ["single_arm", "gripper"], "delta_indices": [0]}
MODALITIES: dict[str, dict[str, Any]] = {
    "state": STATE,
    "action": {"modality_keys": ["single_arm", "gripper"], "delta_indices": list(range(16))},
    "language": {"modality_keys": ["annotation.human.task_description"], "delta_indices": [0]},
}
ROWS = 16


def packed(array: Any) -> dict[str, Any]:
    file = io.BytesIO()
    np.save(file, np.asarray(array), allow_pickle=False)
    return {"__ndarray_class__": True, "as_npy": file.getvalue()}


def numbers(value: Mapping[str, Any]) -> Any:
    """Return the array that a client has sent."""
    return np.load(io.BytesIO(value["as_npy"]), allow_pickle=False)


def nested(data: dict[str, Any]) -> Any:
    """Return 16 rows that move the first joint by 0.2 degrees a step, as N1.6 does."""
    arm = numbers(data["observation"]["state"]["single_arm"])[0, 0]
    gripper = numbers(data["observation"]["state"]["gripper"])[0]
    rows = [[arm[0] + 0.2 * row, *arm[1:]] for row in range(1, ROWS + 1)]
    arrays = {"single_arm": [rows], "gripper": [np.repeat(gripper, ROWS, 0)]}
    return [{key: packed(np.asarray(array, np.float32)) for key, array in arrays.items()}, {}]


def flat(data: dict[str, Any]) -> Any:
    """Return the same as N1.5 does."""
    arm, gripper = numbers(data["state.single_arm"])[0], numbers(data["state.gripper"])[0]
    rows = np.asarray([[arm[0] + 0.2 * row, *arm[1:]] for row in range(1, ROWS + 1)])
    return {"action.single_arm": packed(rows), "action.gripper": packed(np.repeat(gripper, ROWS))}


def described(modalities: Mapping[str, Mapping[str, Any]], as_text: bool) -> dict[str, Any]:
    """Return the answer to ``get_modality_config``. In N1.5 the keys begin with the modality's name."""
    answer = {}
    for name, modality in modalities.items():
        prefix = f"{name}." if as_text and name != "language" else ""
        keys = [f"{prefix}{key}" if prefix else key for key in modality["modality_keys"]]
        content = {**modality, "modality_keys": keys}
        answer[name] = {
            "__ModalityConfig_class__": True,
            "as_json": json.dumps(content) if as_text else content,
        }
    return answer


@contextlib.contextmanager
def groot_server(
    act: Act = nested,
    modalities: Mapping[str, Mapping[str, Any]] = MODALITIES,
    token: str = "",
    port: int | None = None,
) -> Iterator[tuple[int, list[dict[str, Any]]]]:
    """Yield its port and the received requests. ``act`` returns the answer to ``get_action``, or raw bytes."""
    received: list[dict[str, Any]] = []
    context = zmq.Context()
    socket = context.socket(zmq.REP)
    socket.setsockopt(zmq.LINGER, 0)
    at = socket.bind_to_random_port("tcp://127.0.0.1") if port is None else port
    if port is not None:
        socket.bind(f"tcp://127.0.0.1:{port}")
    ends = threading.Event()

    def answer(request: dict[str, Any]) -> Any:
        if token and request.get("api_token") != token:
            return {"error": "Unauthorized: Invalid API token"}
        match request["endpoint"]:
            case "get_modality_config":
                return described(modalities, act is flat)
            case "get_action":
                return act(request["data"])
            case "reset":
                return {}
        return {"error": f"Unknown endpoint: {request['endpoint']}"}

    def serve() -> None:
        while not ends.is_set():
            if not socket.poll(50):
                continue
            received.append(msgspec.msgpack.decode(socket.recv()))
            try:
                content = answer(received[-1])
            except Exception as error:
                content = {"error": str(error)}
            socket.send(content if isinstance(content, bytes) else msgspec.msgpack.encode(content))

    thread = threading.Thread(target=serve)
    thread.start()
    try:
        yield at, received
    finally:
        ends.set()
        thread.join()
        socket.close(0)
        context.term()


if __name__ == "__main__":
    with groot_server(port=5555), contextlib.suppress(KeyboardInterrupt):
        threading.Event().wait()
