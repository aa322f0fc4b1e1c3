"""The protocol of GR00T's policy servers (NVIDIA Isaac GR00T), in its two generations. Pure.

Each message is a map or list in msgpack. An array of numpy is a file in the NPY format, in a map:

    {"__ndarray_class__": true, "as_npy": bytes}

A request is ``{"endpoint": name, "data": {...}, "api_token": text}``. The answer is the result of the endpoint, or
``{"error": text}``. The endpoint ``get_modality_config`` describes the inputs and outputs of the policy, and shows
the generation:

    nested    GR00T N1.6 and later. The description of a modality is a map.
              request   {"observation": {"video": {key: (1, 1, height, width, 3)}, "state": {key: (1, 1, numbers)},
                        "language": {key: [[text]]}}, "options": null}
              answer    [{key: (1, rows, numbers)}, {...}]
    flat      GR00T N1.5. Its description is a text with JSON. Keys begin with the name of a modality.
              request   {"video.front": (1, height, width, 3), "state.single_arm": (1, numbers), ...: [text]}
              answer    {"action.single_arm": (rows, numbers)}

The NPY format can hold Python objects as pickles. Such an array is refused, as no array of numbers is.

Sources: ``gr00t/policy/server_client.py``, ``gr00t/policy/gr00t_policy.py`` and ``gr00t/data/types.py`` of N1.6,
``gr00t/eval/service.py`` of N1.5 [read].
"""

from __future__ import annotations

import io
import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from strands_actors.contract.shown import harmless

from .remote_errors import Misunderstood

ARRAY, NPY, CONFIG, AS_JSON = "__ndarray_class__", "as_npy", "__ModalityConfig_class__", "as_json"
STATE, VIDEO, ACTION, LANGUAGE = "state", "video", "action", "language"
GRIPPER = "gripper"
MOST_ROWS = 1000

Arrays = Mapping[str, NDArray[Any]]


class Modality(msgspec.Struct):
    """One kind of input or output: its keys, and its times relative to now."""

    modality_keys: list[str]
    delta_indices: list[int]


class Modalities(NamedTuple):
    """The inputs and outputs of a policy.

    Attributes:
        nested: True for the generation of N1.6, False for that of N1.5.
        keys: The keys of each modality, without its name before them.
    """

    nested: bool
    keys: Mapping[str, tuple[str, ...]]


def request(endpoint: str, data: Mapping[str, Any] | None = None, api_token: str = "") -> bytes:
    """Return a request. ``data`` is None for an endpoint without arguments."""
    fields: dict[str, Any] = {"endpoint": endpoint}
    if data is not None:
        fields["data"] = data
    if api_token:
        fields["api_token"] = api_token
    return msgspec.msgpack.encode(fields)


def answer_of(message: bytes) -> Any:
    """Return the content of an answer. Raise ``Misunderstood`` if it is an error or no msgpack."""
    try:
        content = msgspec.msgpack.decode(message)
    except (msgspec.DecodeError, RecursionError) as error:
        text = harmless(message[:40].decode("utf-8", "replace"))
        raise Misunderstood(f"sent a response that is not msgpack: {text} ({error})") from error
    if isinstance(content, dict) and "error" in content:
        raise Misunderstood(f"reports an error: {harmless(str(content['error'])[:400])}")
    return content


def modalities_of(content: Any) -> Modalities:
    """Return the inputs and outputs that a server describes.

    Raises:
        Misunderstood: The description is wrong, or the policy needs several readings or pictures at once.
    """
    if not isinstance(content, dict):
        raise Misunderstood("sent no description of its modalities")
    nested = True
    keys: dict[str, tuple[str, ...]] = {}
    for name in (STATE, VIDEO, ACTION, LANGUAGE):
        entry = content.get(name)
        described = entry.get(AS_JSON) if isinstance(entry, dict) else None
        if described is None and name in (VIDEO, LANGUAGE):
            keys[name] = ()
            continue
        nested = nested and not isinstance(described, str)
        try:
            if isinstance(described, str):
                modality = msgspec.json.decode(described, type=Modality)
            else:
                modality = msgspec.convert(described, type=Modality)
        except msgspec.MsgspecError as wrong:
            raise Misunderstood(f"describes its modality {name!r} wrongly: {wrong}") from wrong
        if name in (STATE, VIDEO) and len(modality.delta_indices) != 1:
            raise Misunderstood(
                f"has a policy that reads {len(modality.delta_indices)} of {name!r} at once. Use one that reads one"
            )
        keys[name] = tuple(key.removeprefix(f"{name}.") for key in modality.modality_keys)
    return Modalities(nested, keys)


def joints_of(
    modalities: Modalities, axes: Sequence[str], given: Mapping[str, Sequence[str]] | None
) -> dict[str, tuple[str, ...]]:
    """Return the axes of the robot that each key of the state and of the actions means.

    Args:
        modalities: The description of the server.
        axes: Names of the robot's axes.
        given: The user's choice; None for one key with all axes, or ``gripper`` and one key with all others.

    Raises:
        ValueError: There is no choice, it names other keys or axes, or it leaves an axis out.
    """
    keys = tuple(dict.fromkeys((*modalities.keys[ACTION], *modalities.keys[STATE])))
    if given is None:
        rest = [key for key in keys if key != GRIPPER]
        arm = tuple(axis for axis in axes if axis != GRIPPER or GRIPPER not in keys)
        if len(rest) > 1 or (GRIPPER in keys and GRIPPER not in axes):
            raise ValueError(
                f"groot: the policy has the keys {', '.join(keys)[:200]}, and the robot has {', '.join(axes)}. "
                'Give joints, such as {"single_arm": ["shoulder_pan", ...]}'
            )
        given = {**dict.fromkeys(rest, arm), **({GRIPPER: (GRIPPER,)} if GRIPPER in keys else {})}
    joints = {str(key): tuple(names) for key, names in given.items()}
    named = [name for key in modalities.keys[ACTION] for name in joints.get(key, ())]
    if set(joints) != set(keys) or not set(named) <= set(axes) or len(named) != len(set(named)):
        raise ValueError(
            f"groot: joints has {', '.join(joints)[:200]}. Give the keys {', '.join(keys)[:200]}, each with axes "
            f"of {', '.join(axes)}, and each axis once"
        )
    return joints


def observation_data(
    modalities: Modalities,
    joints: Mapping[str, Sequence[str]],
    observation: Mapping[str, float],
    pictures: Arrays,
    instruction: str,
) -> dict[str, Any]:
    """Return the data of a request for actions.

    Args:
        modalities: The description of the server.
        joints: The axes that each key means.
        observation: Position by axis, in the driver's units.
        pictures: Picture by key: uint8 (height, width, 3).
        instruction: Text for the policy.
    """
    states = {
        key: np.array([[[observation[axis] for axis in joints[key]]]], dtype=np.float32)
        for key in modalities.keys[STATE]
    }
    if modalities.nested:
        content = {
            VIDEO: {key: packed(picture[None, None]) for key, picture in pictures.items()},
            STATE: {key: packed(state) for key, state in states.items()},
            LANGUAGE: {key: [[instruction]] for key in modalities.keys[LANGUAGE]},
        }
        return {"observation": content, "options": None}
    flat: dict[str, Any] = {f"{VIDEO}.{key}": packed(picture[None]) for key, picture in pictures.items()}
    flat |= {f"{STATE}.{key}": packed(state[0]) for key, state in states.items()}
    return flat | {key: [instruction] for key in modalities.keys[LANGUAGE]}


def rows_of(modalities: Modalities, joints: Mapping[str, Sequence[str]], content: Any) -> list[dict[str, float]]:
    """Return the actions of an answer.

    Raises:
        Misunderstood: A key is missing, or its array does not fit the axes.
    """
    if modalities.nested:
        content = content[0] if isinstance(content, list) and content else None
    if not isinstance(content, dict):
        raise Misunderstood("sent a response without actions")
    rows: list[dict[str, float]] = []
    for key in modalities.keys[ACTION]:
        name = key if modalities.nested else f"{ACTION}.{key}"
        if name not in content:
            raise Misunderstood(f"sent actions without {name!r}: {', '.join(map(str, content))[:200]}")
        array = unpacked(name, content[name])
        axes = joints[key]
        table = array.reshape(-1, len(axes)) if array.size % max(1, len(axes)) == 0 else array
        sizes = [size for size in array.shape if size != 1]
        expected = [size for size in (len(table), len(axes)) if size != 1]
        if sizes != expected or not 1 <= len(table) <= MOST_ROWS or (rows and len(rows) != len(table)):
            raise Misunderstood(
                f"sent {name!r} of shape {list(array.shape)}, and the robot has {len(axes)} axes for it: "
                f"{', '.join(axes)[:200]}"
            )
        rows = rows or [{} for _ in table]
        for row, values in zip(rows, table.tolist(), strict=True):
            row.update(zip(axes, map(float, values), strict=True))
    return rows


def packed(array: NDArray[Any]) -> dict[str, Any]:
    """Return an array in GR00T's form."""
    file = io.BytesIO()
    np.save(file, array, allow_pickle=False)
    return {ARRAY: True, NPY: file.getvalue()}


def unpacked(name: str, value: Any) -> NDArray[Any]:
    """Return the array of numbers of an answer. Raise ``Misunderstood`` if it is none.

    ``numpy.load`` would reserve the memory for any shape that the file states, so the header is read first.
    """
    content = value.get(NPY) if isinstance(value, dict) else None
    if not isinstance(content, bytes):
        raise Misunderstood(f"sent {name!r} as {type(value).__name__}, not as an array")
    file = io.BytesIO(content)
    try:
        version = np.lib.format.read_magic(file)  # type: ignore[no-untyped-call]
        read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape, by_column, dtype = read(file)  # type: ignore[no-untyped-call]
    except (ValueError, EOFError, TypeError, SyntaxError) as wrong:
        raise Misunderstood(f"sent {name!r} as no array in the NPY format: {wrong}") from wrong
    data = content[file.tell() :]
    if dtype.kind not in "fiu" or by_column or len(data) != math.prod(shape) * dtype.itemsize:
        raise Misunderstood(f"sent {name!r} as {dtype} of shape {str(shape)[:60]}, not as an array of numbers")
    return np.frombuffer(data, dtype).reshape(shape)


__all__ = [
    "Modalities",
    "answer_of",
    "joints_of",
    "modalities_of",
    "observation_data",
    "packed",
    "request",
    "rows_of",
]
