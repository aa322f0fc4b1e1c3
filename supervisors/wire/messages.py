"""Messages to the transport and the watchdog, in the wire process. Times are nanoseconds of CLOCK_MONOTONIC."""

from __future__ import annotations

from typing import Any

from strands_actors.contract.driver import Reason
from strands_actors.contract.safe_state import SafeState
from strands_actors.kernel.messages import Message

# -- messages to the transport


class Write(Message, frozen=True):
    """A setpoint that the gate has accepted. The transport checks its epoch (a counter of stops and holds) and
    deadline once more, immediately before the bytes are sent."""

    lane = "latest"

    epoch: int
    deadline_ns: int
    values: tuple[float, ...]
    expires_ns: int = 0  # until when the setpoint may be sent again; 0 if it has no end
    # True for a setpoint of a stream, so that another one will follow.
    streamed: bool = False


class Cycle(Message, frozen=True):
    """Do the work of one control period: send the last setpoint again and feed the robot's own watchdog, if
    allowed, then read the robot."""

    lane = "latest"

    number: int
    resend_epoch: int = 0  # the epoch whose setpoint may be sent again; 0 if no setpoint may be
    feed: bool = False


class MakeSafe(Message, frozen=True):
    lane = "urgent"

    epoch: int
    safe_state: SafeState
    reason: Reason


class Arm(Message, frozen=True):
    epoch: int
    lifts: bool = False  # True if an operator's resume arms the robot, which lifts the lock of an e-stop


class CarryOut(Message, frozen=True):
    """Run a service that the gate has accepted. ``number`` identifies the reply."""

    epoch: int
    number: int
    service: str
    arguments: dict[str, Any]


class HandOverAgain(Message, frozen=True):
    """A request of the root: hand over the open descriptors again, for a new standby."""


# -- messages to the watchdog


class Alive(Message, frozen=True):
    """The gate's reply to a probe. ``live`` is True while a setpoint is in force."""

    lane = "latest"

    number: int
    epoch: int
    live: bool


class Cycled(Message, frozen=True):
    """The transport's reply to ``Cycle``. If the transport is connecting or stopping the robot, it does not reply
    to further messages until ``busy_until_ns``. 0 means that it is not busy."""

    lane = "latest"

    number: int
    busy_until_ns: int = 0


class RootGone(Message, frozen=True):
    """The link to the root was closed, so the root process has ended."""

    lane = "urgent"
