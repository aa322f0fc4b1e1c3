"""The telemetry of a robot as types. Pure.

A robot of another host may have another version of this package, so unknown fields are ignored, and fields that
were added later have defaults.
"""

from __future__ import annotations

import math
from typing import Annotated, Any, TypeVar

import msgspec

Number = float | None

Seconds = Annotated[float, msgspec.Meta(ge=0.0, le=4e9)]
"""Wall-clock time. Displays cannot show times before 1970 or after 2096."""

T = TypeVar("T")


class Task(msgspec.Struct, frozen=True):
    """The task (policy run) of a robot."""

    status: str = "idle"
    instruction: str = ""
    steps: int = 0


class LastStop(msgspec.Struct, frozen=True):
    """The result of the last stop. ``epoch`` distinguishes one stop from the next. ``written_ms`` is the time from
    its order to the first frame of the safe state, 0 if it is not known."""

    epoch: int
    reason: str
    safe_state: str
    confirmed: bool
    took_ms: float
    path: str = ""
    unconfirmed: tuple[str, ...] = ()
    written_ms: float = 0.0


class State(msgspec.Struct, frozen=True):
    """A sample of the topic ``state``. ``t`` is the robot's wall-clock time in seconds. ``age_s`` is the age of the
    positions, -1 without a reading. ``last_stop_ago_s`` is the time since the end of the last stop, -1 if it is not
    known."""

    peer_id: str
    t: Seconds
    state: str
    epoch: int
    unit: str = ""
    joints: dict[str, Any] = {}
    targets: dict[str, Any] = {}
    velocities: dict[str, Any] = {}
    age_s: float = -1.0
    task: Task = Task()
    cause: str = ""
    setpoints: int = 0
    refused: dict[str, int] = {}
    last_refusal: str = ""
    last_stop: LastStop | None = None
    last_stop_ago_s: float = -1.0


class Presence(msgspec.Struct, frozen=True):
    """A sample of the topic ``presence``. ``hw`` is the robot's type."""

    robot_id: str
    timestamp: Seconds
    hw: str
    hostname: str = ""
    connected: bool = False
    locked_by: str = ""
    lease: str = ""
    action_keys: tuple[str, ...] = ()
    model_units: dict[str, tuple[float, float]] = {}


class Health(msgspec.Struct, frozen=True):
    """A sample of the topic ``health``."""

    peer_id: str
    t: Seconds
    ok: bool
    connected: bool
    connect_error: str = ""
    faults: dict[str, str] = {}
    refusals: int = 0
    writes: int = 0
    reads: int = 0
    counts: dict[str, int] = {}
    restarts: dict[str, int] = {}
    setpoint_intervals: tuple[int, ...] = ()
    setpoint_intervals_s: float = 0.0


class SafetyEvent(msgspec.Struct, frozen=True):
    """A message on ``strands/safety/event``: a change of the state, or a stop or resume that came over the mesh.
    ``sender``, ``turn`` and ``sent_s`` are those of the order."""

    peer_id: str
    t: Seconds
    event: str
    by: str = ""
    state: str = ""
    epoch: int = 0
    cause: str = ""
    locked_by: str = ""
    outcome: str = ""
    safe_state: str = ""
    took_ms: float = 0.0
    detail: str = ""
    sender: str = ""
    turn: str = ""
    sent_s: Seconds = 0.0


class BadSample(Exception):
    """A message is not valid telemetry. The text has the reason."""


def decode(payload: bytes, sample_type: type[T]) -> T:
    """Return a message as ``sample_type``. Raise ``BadSample`` if it is not one."""
    try:
        return msgspec.json.decode(payload, type=sample_type)
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
        raise BadSample(str(error)) from None


class Joint(msgspec.Struct, frozen=True):
    """One joint in the robot's units. A value that is not known is None."""

    name: str
    measured: Number
    commanded: Number = None
    velocity: Number = None


def joints_of(state: State) -> tuple[Joint, ...]:
    """Return the joints of a sample. The telemetry has each position twice, as ``x`` and ``x.pos``. The second is
    left out."""
    return tuple(
        Joint(name, _number(value), _number(state.targets.get(name)), _number(state.velocities.get(name)))
        for name, value in state.joints.items()
        if not (name.endswith(".pos") and name.removesuffix(".pos") in state.joints)
    )


def _number(value: object) -> Number:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        return None
    return float(value)
