"""The rows of a recording that people read: flat JSON, in channels that Foxglove can plot and list.

Pure: rows are derived from journal entries. The channel ``journal`` has the original entries, which a
replay needs.

The docstring of a row is the description in its JSON schema.
"""

from __future__ import annotations

from typing import Any

import msgspec


class Command(msgspec.Struct):
    """A command to the robot, and its outcome."""

    what: str  # setpoint, stop, resume, acquire or release
    by: str
    outcome: str  # accepted, refused, or later (the answer is in safe or lifecycle)
    lease: int = 0
    epoch: int = 0
    deadline_ns: int = 0
    latched: bool = False
    action: dict[str, Any] = {}
    target: dict[str, float | None] = {}  # the resulting target of all axes
    code: str = ""  # of a refusal
    reason: str = ""
    remedy: str = ""


class Refusal(msgspec.Struct):
    what: str
    code: str
    reason: str
    remedy: str
    offered: str
    limit: str


class Seen(msgspec.Struct):
    """An observation by axis, in the driver's units; null for an axis that was not read."""

    t_ns: int
    position: dict[str, float | None]
    velocity: dict[str, float | None]
    sensors: dict[str, list[float | None]]
    faults: dict[str, str]
    oldest_ns: int = 0  # when the oldest of these positions was read


class Motor(msgspec.Struct):
    axis: str
    id: int
    written: bool
    acknowledged: bool
    safe: bool
    detail: str


class Safe(msgspec.Struct):
    """The order of a safe state, or its result."""

    what: str  # ordered or done
    safe_state: str
    reason: str
    epoch: int
    path: str  # wire, or stop_channel (the connection of the root)
    confirmed: bool
    took_ms: float
    motors: list[Motor]


class Lifecycle(msgspec.Struct):
    """A change of the robot's state, its lease, its link or its processes."""

    what: str
    mode: str = ""
    epoch: int = 0
    locked_by: str = ""
    cause: str = ""
    detail: str = ""
    pid: int = 0


class Gap(msgspec.Struct):
    """A place where ``missing`` entries are missing; -1 for an unknown number."""

    source: str  # wire or root
    missing: int
    why: str


class Log(msgspec.Struct):
    """A line for Foxglove's log panel."""

    timestamp: dict[str, int]  # sec, nsec
    level: int  # 2 info, 3 warning, 4 error
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
    """Return the JSON schema of a row, with an object at its root and without references."""
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
