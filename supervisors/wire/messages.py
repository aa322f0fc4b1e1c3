"""What the transport and the watchdog are told. Times are CLOCK_MONOTONIC nanoseconds."""

from __future__ import annotations

from typing import Any

from strands_actors.contract.driver import Reason
from strands_actors.contract.safe_state import SafeState
from strands_actors.kernel.messages import Message

# -- the transport


class Write(Message, frozen=True):
    """A gated setpoint. The transport checks epoch and deadline again just before the bytes
    leave."""

    lane = "latest"

    epoch: int
    deadline_ns: int
    values: tuple[float, ...]
    expires_ns: int = 0  # when a re-send is no longer allowed; 0: latched
    streamed: bool = False  # the writer sends the next one itself


class Cycle(Message, frozen=True):
    """One period of the wire: re-send the last setpoint and feed the firmware's watchdog if told
    so, then read."""

    lane = "latest"

    number: int
    resend_epoch: int = 0  # 0: read only
    feed: bool = False


class MakeSafe(Message, frozen=True):
    lane = "urgent"

    epoch: int
    safe_state: SafeState
    reason: Reason


class Arm(Message, frozen=True):
    epoch: int


class CarryOut(Message, frozen=True):
    """A service that passed the gate. ``number`` tells its answer from others."""

    epoch: int
    number: int
    service: str
    arguments: dict[str, Any]


class HandOverAgain(Message, frozen=True):
    """The root asks an open wire for another handover: there is a new standby. Not urgent: it may
    wait."""


# -- the watchdog


class Alive(Message, frozen=True):
    """The gate's answer. ``live``: there is a setpoint whose writer and lifetime still stand."""

    lane = "latest"

    number: int
    epoch: int
    live: bool


class Cycled(Message, frozen=True):
    """The transport's answer; ``busy_until_ns``: it is in a bounded operation (connecting,
    confirming)."""

    lane = "latest"

    number: int
    busy_until_ns: int = 0


class RootGone(Message, frozen=True):
    """The link to the root has closed."""

    lane = "urgent"
