"""The rows of a recording for people: flat JSON, in channels that Foxglove can plot and list.

The rows are derived from the entries of the robot's journal. The channel ``journal`` has the entries
themselves, which a replay needs. The docstring of a row becomes the description in its JSON schema.
"""

from __future__ import annotations

from typing import Any

import msgspec


class Command(msgspec.Struct):
    """A command to the robot, and its outcome."""

    type: str = msgspec.field(
        name="what"
    )  # The kind of command: setpoint, stop, e-stop, resume, acquire or release.
    by: str
    outcome: str  # "accepted", "refused" or "later": then the result is in a later row of "safe" or "lifecycle".
    lease: int = 0
    epoch: int = 0
    deadline_ns: int = 0
    latched: bool = False
    action: dict[str, Any] = {}
    target: dict[str, float | None] = {}  # The accepted target of each axis, in the driver's units.
    code: str = ""  # The code of the refusal. Empty if the command was not refused.
    reason: str = ""
    remedy: str = ""


class Refusal(msgspec.Struct):
    request: str = msgspec.field(name="what")
    code: str
    reason: str
    remedy: str
    offered: str
    limit: str


class Seen(msgspec.Struct):
    """A reading of all axes, in the driver's units. The value of an axis that was not read is null."""

    t_ns: int
    position: dict[str, float | None]
    velocity: dict[str, float | None]
    sensors: dict[str, list[float | None]]
    faults: dict[str, str]
    oldest_ns: int = 0  # Time at which the oldest of these positions was read.


class Motor(msgspec.Struct):
    axis: str
    id: int
    written: bool
    acknowledged: bool
    safe: bool
    detail: str


class Safe(msgspec.Struct):
    """A stop: the order to bring the robot to a safe state, or the result of the order."""

    stage: str = msgspec.field(name="what")  # "ordered" for the order, "done" for the result.
    safe_state: str
    reason: str
    epoch: int
    path: str  # The connection that was used: "wire", or "stop_channel" of the root process.
    confirmed: bool
    took_ms: float
    motors: list[Motor]


class Lifecycle(msgspec.Struct):
    """A change of the robot's state, its lease, its link or its processes."""

    event: str = msgspec.field(name="what")
    mode: str = ""
    epoch: int = 0
    locked_by: str = ""
    cause: str = ""
    detail: str = ""
    pid: int = 0


class Gap(msgspec.Struct):
    """A place where entries of the journal are missing. ``missing`` is their number, or -1 if it is not
    known."""

    source: str  # The process that sent the journal: "wire" or "root".
    missing: int
    reason: str = msgspec.field(name="why")


class Log(msgspec.Struct):
    """A line for Foxglove's log panel."""

    timestamp: dict[str, int]  # With the keys "sec" and "nsec", as Foxglove requires.
    level: int  # Foxglove's level: 2 is info, 3 is warning, 4 is error.
    message: str
    name: str
    file: str = ""
    line: int = 0


class Journal(msgspec.Struct):
    """An unchanged batch of the journal: an array of entries in msgpack."""

    source: str
    session: int
    number: int
    entries: bytes


CHANNELS: dict[str, type[msgspec.Struct]] = {
    "command": Command,
    "refusal": Refusal,
    "observation": Seen,
    "safe": Safe,
    "lifecycle": Lifecycle,
    "gap": Gap,
    "log": Log,
    "journal": Journal,
}
"""The type of the rows of each channel. The topic is ``/<robot>/<name>``."""

SCHEMA_NAMES = {"log": "foxglove.Log"}


def schema(row: type[msgspec.Struct]) -> dict[str, Any]:
    """Return the JSON schema of a row. Its root is an object, and references are replaced by their contents."""
    (root,), parts = msgspec.json.schema_components((row,), ref_template="{name}")
    plain: dict[str, Any] = _resolved(root, parts)
    return plain


def _resolved(node: Any, parts: dict[str, Any]) -> Any:
    if isinstance(node, dict):
        if "$ref" in node:
            return _resolved(parts[node["$ref"]], parts)
        return {key: _resolved(value, parts) for key, value in node.items()}
    if isinstance(node, list):
        return [_resolved(value, parts) for value in node]
    return node
