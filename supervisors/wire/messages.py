"""Messages to the transport and the watchdog. Times are nanoseconds of CLOCK_MONOTONIC."""

from __future__ import annotations

from typing import Any

from strands_actors.contract.driver import Reason
from strands_actors.contract.safe_state import SafeState
from strands_actors.kernel.messages import Message

# -- the transport


class Write(Message, frozen=True):
    """A setpoint that the gate has accepted. The transport checks its epoch and deadline again
    immediately before the bytes leave."""

    lane = "latest"

    epoch: int
    deadline_ns: int
    values: tuple[float, ...]
    expires_ns: int = 0  # end of re-sending; 0 if it is latched
    streamed: bool = False  # part of a stream, so the writer sends a next one


class Cycle(Message, frozen=True):
    """One control period: re-send the last setpoint and feed the firmware's watchdog, if allowed, then
    read."""

    lane = "latest"

    number: int
    resend_epoch: int = 0  # the epoch in which re-sending is allowed; 0 allows no re-sending
    feed: bool = False


class MakeSafe(Message, frozen=True):
    lane = "urgent"

    epoch: int
    safe_state: SafeState
    reason: Reason


class Arm(Message, frozen=True):
    epoch: int


class CarryOut(Message, frozen=True):
    """A service that the gate has accepted. ``number`` identifies its reply."""

    epoch: int
    number: int
    service: str
    arguments: dict[str, Any]


class HandOverAgain(Message, frozen=True):
    """A request of the root to an open wire: hand over descriptors again, for a new standby."""


# -- the watchdog


class Alive(Message, frozen=True):
    """The gate's reply to a probe. ``live`` is true while a setpoint is in force."""

    lane = "latest"

    number: int
    epoch: int
    live: bool


class Cycled(Message, frozen=True):
    """The transport's reply to ``Cycle``. ``busy_until_ns`` is the end of a bounded operation in which it does
    not reply (connecting, confirming a stop); 0 without such an operation."""

    lane = "latest"

    number: int
    busy_until_ns: int = 0


class RootGone(Message, frozen=True):
    """The link to the root has closed."""

    lane = "urgent"
