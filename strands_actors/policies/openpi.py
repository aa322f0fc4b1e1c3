"""The protocol of openpi's policy servers (pi0, pi0.5, pi0-FAST), over WebSocket. Pure.

Each message is a map in msgpack, with arrays of numpy in openpi's form:

    {b"__ndarray__": true, b"data": bytes, b"dtype": "<f4", b"shape": [rows, columns]}

The server sends first: the metadata of its policy, which may be an empty map. A request has the state, the pictures
and the instruction, each under the key with which the policy was trained. A response has the chunk under
``actions``, one row an action. An error is a text message with the server's traceback, and the server then closes.

Sources: ``websocket_policy_server.py``, ``websocket_client_policy.py`` and ``msgpack_numpy.py`` of openpi [read].
"""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping, Sequence
from typing import Any

import msgspec

from strands_actors.contract.shown import harmless

from .remote_errors import Misunderstood

STATE = "observation/state"
"""Default key of the state, as in openpi's configurations for LIBERO and for new robots."""
PROMPT = "prompt"
ACTIONS = "actions"
NDARRAY, DATA, DTYPE, SHAPE = b"__ndarray__", b"data", b"dtype", b"shape"
FORMATS = {"<f2": "e", "<f4": "f", "<f8": "d", "<i4": "i", "<i8": "q"}
"""The types of numbers that an answer may have, with their letter in ``struct``."""
MOST_ROWS = 1000


class OpenPi:
    """Encodes requests and decodes responses of an openpi server.

    Args:
        state_key: Key of the state in a request.
    """

    is_text = False

    def __init__(self, state_key: str = STATE) -> None:
        self._state_key = state_key
        self._keys: list[str] = []
        self.pictures: Mapping[str, Any] = {}
        """The pictures of the next request by key: arrays of uint8 (height, width, colours)."""

    def apply_setting(self, setting: str, value: Any) -> None:
        """Store the names of the joints. An openpi server has no other settings."""
        if setting == "keys":
            self._keys = list(value)

    def request(self, observation: Mapping[str, float], instruction: str) -> bytes:
        """Return the request for a chunk: the state as float32 in the order of the joints, and the pictures."""
        values = [observation[key] for key in self._keys]
        state = packed("<f4", [len(values)], struct.pack(f"<{len(values)}f", *values))
        seen = {
            key: packed("|u1", list(picture.shape), picture.tobytes()) for key, picture in self.pictures.items()
        }
        return msgspec.msgpack.encode({self._state_key: state, **seen, PROMPT: instruction})

    def chunk(self, answer: bytes | str) -> list[dict[str, float]]:
        """Return the actions of a response.

        Raises:
            Misunderstood: The response is the server's error, or its actions do not fit the robot.
        """
        if isinstance(answer, str):
            raise Misunderstood(f"reports an error: {_last_line(answer)}")
        try:
            content = msgspec.msgpack.decode(answer)
        except msgspec.DecodeError as error:
            raise Misunderstood(f"sent a response that is not msgpack: {error}") from error
        rows = _rows(content.get(ACTIONS) if isinstance(content, dict) else None)
        if any(len(row) != len(self._keys) for row in rows):
            raise Misunderstood(
                f"sent actions of {len(rows[0])} numbers, and the robot has {len(self._keys)} axes: "
                f"{', '.join(self._keys)}"
            )
        return [dict(zip(self._keys, row, strict=True)) for row in rows]


def packed(dtype: str, shape: Sequence[int], data: bytes) -> dict[bytes, Any]:
    """Return an array in openpi's form."""
    return {NDARRAY: True, DATA: data, DTYPE: dtype, SHAPE: list(shape)}


def is_metadata(message: bytes | str) -> bool:
    """Return True if a first message is the metadata of an openpi server: a map in msgpack."""
    if isinstance(message, str):
        return False
    try:
        return isinstance(msgspec.msgpack.decode(message), dict)
    except msgspec.DecodeError:
        return False


def _rows(array: object) -> list[tuple[float, ...]]:
    """Return the rows of an array of two dimensions. Raise ``Misunderstood`` if it is not one."""
    if not isinstance(array, dict) or array.get(NDARRAY) is not True:
        raise Misunderstood("sent a response without an array of actions")
    dtype, shape, data = array.get(DTYPE), array.get(SHAPE), array.get(DATA)
    letter = FORMATS.get(dtype) if isinstance(dtype, str) else None
    sizes = [size for size in shape if isinstance(size, int) and size > 0] if isinstance(shape, list) else []
    if letter is None or not isinstance(shape, list) or len(sizes) != len(shape) or len(sizes) not in (1, 2):
        raise Misunderstood(
            f"sent actions of type {str(dtype)[:20]} and shape {str(shape)[:60]}, not rows of numbers"
        )
    count, width = math.prod(sizes), sizes[-1]
    if not isinstance(data, bytes) or len(data) != count * struct.calcsize(letter) or count // width > MOST_ROWS:
        raise Misunderstood(f"sent actions of shape {str(shape)[:60]}, which do not fit their bytes")
    values = struct.unpack(f"<{count}{letter}", data)
    return [tuple(map(float, values[start : start + width])) for start in range(0, count, width)]


def _last_line(traceback: str) -> str:
    lines = [line.strip() for line in traceback.splitlines() if line.strip()]
    return harmless(lines[-1][:400]) if lines else "an empty text"


__all__ = ["OpenPi", "is_metadata"]
